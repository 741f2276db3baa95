"""The windscreen against sums over all reflections, and against rays that are traced through a wedge."""

import math

import numpy as np
import pytest

from synfog_usd.base import photometry
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.windscreen import GREEN_NM, GREEN_T, fresnel, second_image_rad, windscreen

BANDS = tuple(photometry.band_name(centre) for centre in np.arange(405.0, 700.0, 10.0))


def radiance(pixels, channels=("R", "G", "B")):
    return Image(np.asarray(pixels, dtype=np.float32), channels, Quantity.RADIANCE)


def even(channels=("R", "G", "B")):
    return radiance(np.ones((4, 6, len(channels))), channels)


def test_what_passes_across_the_surface_is_the_table():
    """Of even light through parallel faces, first and second image: the table, but for what is reflected four times
    and more, which is below R^4.
    """
    seen = windscreen(even(BANDS), rake_deg=0.0, wedge_mrad=0.0).pixels[0, 0]
    wanted = [
        np.interp(np.arange(centre - 4.5, centre + 5.0), GREEN_NM, GREEN_T).mean()
        for centre in np.arange(405.0, 700.0, 10.0)
    ]
    np.testing.assert_allclose(seen[1:-1], wanted[1:-1], rtol=2 * fresnel(0.0, 1.52) ** 4 + 2e-4)


@pytest.mark.parametrize("rake_deg", [0.0, 60.0])
def test_clear_glass_loses_what_its_faces_reflect(rake_deg):
    """A pane that absorbs nothing lets (1 - R) / (1 + R) pass, all reflections summed; two images are all but R^4."""
    faces = fresnel(0.0, 1.52)
    clear = (1 - faces) / (1 + faces)
    seen = windscreen(
        even(), rake_deg=rake_deg, wedge_mrad=0.0, wavelength_nm=(380.0, 780.0), transmittance=(clear, clear)
    ).pixels
    own = fresnel(rake_deg, 1.52)
    np.testing.assert_allclose(seen, (1 - own) / (1 + own), rtol=1.2 * own**4 + 1e-6)


@pytest.mark.parametrize("angle_deg", [0.0, 70.0])
def test_a_face_reflects_what_fresnel_says(angle_deg):
    """In Fresnel's own form, by the angles: (sin^2(a - b) / sin^2(a + b) + tan^2(a - b) / tan^2(a + b)) / 2."""
    a = math.radians(max(angle_deg, 1e-4))
    b = math.asin(math.sin(a) / 1.52)
    wanted = 0.5 * ((math.sin(a - b) / math.sin(a + b)) ** 2 + (math.tan(a - b) / math.tan(a + b)) ** 2)
    assert fresnel(math.degrees(a), 1.52) == pytest.approx(wanted, rel=1e-6)


def refracted(direction, normal, ratio):
    """Snell's law for unit vectors; `normal` looks against the ray."""
    cosine = -direction @ normal
    return ratio * direction + (ratio * cosine - math.sqrt(1 - ratio**2 * (1 - cosine**2))) * normal


def mirrored(direction, normal):
    return direction - 2 * (direction @ normal) * normal


@pytest.mark.parametrize("rake_deg", [0.0, 62.0])
def test_the_second_image_stands_where_rays_go(rake_deg):
    """Directions (z, y) of a ray through two faces that part by a hundredth of a degree, more at the top, straight and
    reflected twice within the glass.
    """
    wedge, index = math.radians(0.01), 1.52
    rake = math.radians(rake_deg)
    outer = np.array([-math.cos(rake), math.sin(rake)])  # normals towards the light that comes along +z
    inner = np.array([-math.cos(rake + wedge), math.sin(rake + wedge)])
    within = refracted(np.array([1.0, 0.0]), outer, 1 / index)
    straight = refracted(within, inner, index)
    back = mirrored(mirrored(within, inner), -outer)
    second = refracted(back, inner, index)
    apart = math.atan2(*straight[::-1]) - math.atan2(*second[::-1])
    assert -apart == pytest.approx(second_image_rad(rake_deg, wedge, index), rel=0.01)  # it comes from lower down


def test_a_lamp_has_a_second_image_below_it():
    """A lamp in the middle of 60 degrees: the second one is lower by the focal length times the angle (to a hundredth
    of a pixel, by its centre of mass), of (R t)^2 of its light, and nothing else is lit.
    """
    pixels = np.zeros((201, 300, 3))
    pixels[100, 150] = 1000.0
    grey = {"wavelength_nm": (380.0, 780.0), "transmittance": (0.8, 0.8)}
    made = windscreen(radiance(pixels), rake_deg=60.0, wedge_mrad=1.3, fov_x_deg=60.0, **grey)
    seen = made.pixels[..., 1].astype(float)
    first, rest = seen[100, 150], seen.copy()
    rest[100, 150] = 0.0
    rows = rest.sum(axis=1)
    focal = 150.0 / math.tan(math.radians(30.0))
    apart = second_image_rad(60.0, 1.3e-3, 1.52)
    assert rows @ np.arange(201) / rows.sum() - 100.0 == pytest.approx(focal * math.tan(apart), abs=0.01)
    own = fresnel(60.0, 1.52)
    inside = math.sqrt(rest.sum() / first) / own
    assert first == pytest.approx(1000.0 * (1 - own) ** 2 * inside, rel=0.01)  # the same t by both
    assert np.count_nonzero(rest[:, :150]) == np.count_nonzero(rest[:, 151:]) == 0


def test_tables_and_angles_that_make_no_sense_are_refused():
    with pytest.raises(ImageError, match="wavelength_nm rising"):
        windscreen(even(), wavelength_nm=(500.0, 400.0), transmittance=(0.5, 0.5))
    with pytest.raises(ImageError, match="that absorbs nothing lets"):
        windscreen(even(), wavelength_nm=(400.0, 500.0), transmittance=(0.5, 0.99))
    with pytest.raises(ImageError, match="needs the angle of view"):
        windscreen(even())

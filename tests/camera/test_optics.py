"""Light on the sensor against closed forms and direct integrals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from synfog_usd.base import resources
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import optics
from synfog_usd.camera.profiles import load_lens


def radiance(pixels, channels=("R", "G", "B")) -> Image:
    return Image(np.asarray(pixels, dtype=np.float32), channels, Quantity.RADIANCE)


@pytest.mark.parametrize(("f_number", "m"), [(1.73, 0.0), (2.0, -0.1)])
def test_irradiance_on_the_axis(f_number, m):
    """E = tau pi L / (1 + 4 (N (1 - m))^2) with m <= 0, as ISETCam writes it (a positive sign of m would be a
    fault).
    """
    image = optics.irradiance(
        radiance(np.full((2, 2, 3), 7.0)), f_number=f_number, transmission=0.9, magnification=m, falloff="none"
    )
    np.testing.assert_allclose(image.pixels, 0.9 * math.pi * 7.0 / (1 + 4 * (f_number * (1 - m)) ** 2), rtol=1e-6)
    assert image.quantity is Quantity.IRRADIANCE


@pytest.mark.parametrize("f_number", [0.6, 8.0])
def test_the_sine_condition_is_that_of_iso_12232(f_number):
    """E = tau pi L / (4 N^2); with tau = 0.9 and 0.92 of vignetting and falloff that is the standard's 0.65 L / N^2."""
    image = optics.irradiance(
        radiance(np.full((2, 2, 3), 7.0)), f_number=f_number, transmission=0.9, aperture="sine", falloff="none"
    )
    np.testing.assert_allclose(image.pixels, 0.9 * math.pi * 7.0 / (4 * f_number**2), rtol=1e-6)
    np.testing.assert_allclose(image.pixels * 0.92, 0.65 * 7.0 / f_number**2, rtol=2e-3)


def test_corners_fade_by_the_fourth_power_of_the_cosine():
    """The angle of the corner pixel from the geometry of a pinhole: 101 x 51 pixels, 70 degrees."""
    image = optics.irradiance(
        radiance(np.ones((51, 101, 3))), f_number=4.0, transmission=1.0, falloff="cos4", fov_x_deg=70.0
    )
    focal = 50.5 / math.tan(math.radians(35.0))
    phi = math.atan(math.hypot(50.0, 25.0) / focal)
    assert image.pixels[0, 0, 0] / image.pixels[25, 50, 0] == pytest.approx(math.cos(phi) ** 4, rel=1e-6)


@pytest.mark.parametrize("f_number", [1.0, 4.0])
def test_foote_equals_the_integral_over_the_exit_pupil(f_number):
    """E = integral of L cos^2 / d^2 dA over a disc at distance 1 whose half angle has sin^2 = 1 / (1 + 4 N^2)."""
    sin2 = 1 / (1 + 4 * f_number**2)
    radius = math.sqrt(sin2 / (1 - sin2))
    r, angle = np.meshgrid((np.arange(400) + 0.5) / 400 * radius, (np.arange(400) + 0.5) / 400 * 2 * math.pi)
    area = r * (radius / 400) * (2 * math.pi / 400)
    offset = math.tan(math.radians(30.0))
    distance2 = 1 + (r * np.cos(angle) - offset) ** 2 + (r * np.sin(angle)) ** 2
    expected = np.sum(area / distance2**2)  # cos at both ends is 1 / distance
    image = optics.irradiance(
        radiance(np.ones((1, 401, 3))), f_number=f_number, transmission=1.0, falloff="foote", fov_x_deg=90.0
    )
    column = np.interp(offset, (np.arange(401) - 200) / 200.5, np.arange(401))
    found = np.interp(column, np.arange(401), image.pixels[0, :, 0].astype(np.float64))
    assert found / math.pi == pytest.approx(expected / math.pi, rel=2e-4)  # 160,000 cells; linear between pixels


TABLE = {"field_deg": (0.0, 10.0, 30.0), "relative_illumination": (1.0, 0.9, 0.5)}


def test_a_table_is_read_at_the_angle_of_each_pixel():
    """The 41 columns of a row over 50 degrees, by a pinhole's geometry; straight lines between the entries, by hand."""
    image = optics.irradiance(
        radiance(np.ones((1, 41, 3))),
        f_number=2.0,
        transmission=1.0,
        falloff="table",
        fov_x_deg=50.0,
        lens=replace(load_lens("pixel4a"), **TABLE),
    )
    focal = 20.5 / math.tan(math.radians(25.0))
    angle = np.degrees(np.arctan(np.abs(np.arange(41) - 20) / focal))
    expected = np.where(angle < 10.0, 1.0 - 0.01 * angle, 0.9 - 0.02 * (angle - 10.0))
    np.testing.assert_allclose(image.pixels[0, :, 1] / image.pixels[0, 20, 1], expected, rtol=1e-6)
    assert image.provenance["relative_illumination"] == [list(TABLE["field_deg"]), list(TABLE["relative_illumination"])]


LENS = (resources.folder("assets") / "lenses" / "pixel4a.yaml").read_text().partition("sources:")


def own_lens(folder, *lines):
    (folder / "own.yaml").write_text("\n".join([LENS[0].partition("blades:")[0], *lines, LENS[1] + LENS[2]]))
    return load_lens("own.yaml", folder)


def test_a_lens_may_have_a_table_a_distortion_and_blades(tmp_path):
    plain = own_lens(tmp_path)
    assert (plain.distortion, plain.field_deg, plain.relative_illumination, plain.blades) == ((), (), (), 0)
    lens = own_lens(
        tmp_path,
        "distortion: {value: [-0.3, 0.1, 0, 0.001, 0.01], source: exif}",
        "relative_illumination: {field_deg: [0, 10, 30], value: [1, 0.9, 0.5], source: exif}",
        "blades: {value: 6, source: estimate}",
    )
    assert lens.distortion == (-0.3, 0.1, 0.0, 0.001, 0.01) and lens.blades == 6
    assert {"field_deg": lens.field_deg, "relative_illumination": lens.relative_illumination} == TABLE
    assert {"distortion", "relative_illumination", "blades"} <= {name for name, _ in lens.sources}
    assert lens.content_hash != plain.content_hash

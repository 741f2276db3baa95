"""Spots by field and wavelength: their moments against the table, at any place and in every channel."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base import photometry
from synfog_usd.base.errors import ImageError, ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.aberrations import COLUMNS, aberrations
from synfog_usd.camera.blur import spectral_weights
from synfog_usd.camera.profiles import load_lens, load_sensor

SENSOR = load_sensor("ar0132at")
SIZE = (400, 300)
FOV = 80.0
FOCAL = SIZE[0] / 2 / math.tan(math.radians(FOV) / 2)
ANGLES = (0.0, 20.0, 45.0)


def lit(points, channels=("R", "G", "B")) -> Image:
    pixels = np.zeros((SIZE[1], SIZE[0], len(channels)), np.float32)
    for x, y in points:
        pixels[y, x] = 1000.0
    return Image(pixels, channels, Quantity.IRRADIANCE, provenance={"fov_x_deg": FOV})


def lens_of(field_deg=ANGLES, **table):
    """A lens with a table; columns that are not named are 0."""
    return replace(
        load_lens("pixel4a"), aberration_field_deg=field_deg, **dict.fromkeys(COLUMNS, (0.0,) * len(field_deg)) | table
    )


def blurred(image, **table):
    return aberrations(image, lens=lens_of(**table), pixel_pitch_um=1.0, sensor=SENSOR, fov_x_deg=FOV).pixels


def moments(plane, x, y, reach=30):
    """Light, centre from (x, y), and covariance of what lies around it."""
    part = plane[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1].astype(np.float64)
    down, right = np.mgrid[: part.shape[0], : part.shape[1]]
    right, down = right + max(0, x - reach) - x, down + max(0, y - reach) - y
    light = part.sum()
    cx, cy = (part * right).sum() / light, (part * down).sum() / light
    return (
        light,
        (cx, cy),
        np.array(
            [
                [(part * (right - cx) ** 2).sum(), (part * (right - cx) * (down - cy)).sum()],
                [(part * (right - cx) * (down - cy)).sum(), (part * (down - cy) ** 2).sum()],
            ]
        )
        / light,
    )


def at(x, y):
    """Angle [degrees] of a pixel's centre, and the unit vector from the axis to it."""
    away = np.array([x - (SIZE[0] - 1) / 2, y - (SIZE[1] - 1) / 2])
    return np.degrees(np.arctan(np.linalg.norm(away) / FOCAL)), away / np.linalg.norm(away)


@pytest.mark.parametrize("place", [(320, 190), (66, 250)])
def test_a_spot_is_as_wide_as_the_table_says(place):
    """Variances along the radius and across it: those of the table's straight lines within 4 %, mixed between places
    25 pixels apart; no light is lost, and none moves.
    """
    tangential, sagittal = (np.sqrt(1.0 + np.array(ANGLES) * part) for part in (0.18, 0.07))
    plane = blurred(lit([place]), tangential_um=tuple(tangential), sagittal_um=tuple(sagittal))[..., 1]
    light, centre, found = moments(plane, *place)
    angle, out = at(*place)
    across = np.array([-out[1], out[0]])
    assert light == pytest.approx(1000.0, rel=1e-4)
    np.testing.assert_allclose(centre, 0.0, atol=0.03)
    wanted = [np.interp(angle, ANGLES, np.square(values)) for values in (tangential, sagittal)]
    np.testing.assert_allclose([out @ found @ out, across @ found @ across], wanted, rtol=0.04)
    assert plane.min() >= 0.0


def test_colours_part_and_widen_by_the_wavelength():
    """Bands from 450 to 650 nm: shifts of -2, -1, 0, 0.75 and 1.5 pixels along the radius at the table's end, and
    the axial blur's share of the variance.
    """
    channels = tuple(map(photometry.band_name, (450.0, 500.0, 550.0, 600.0, 650.0)))
    x, y = 380, 149
    angle, out = at(x, y)
    share = np.interp(angle, ANGLES, (0.0, 0.0, 1.0))
    pixels = blurred(
        lit([(x, y)], channels),
        tangential_um=(1.0,) * 3,
        sagittal_um=(1.0,) * 3,
        axial_450_um=(1.5,) * 3,
        axial_650_um=(1.0,) * 3,
        lateral_450_um=(0.0, 0.0, -2.0),
        lateral_650_um=(0.0, 0.0, 1.5),
    )
    nm = spectral_weights(SENSOR, channels) @ photometry.WAVELENGTHS_NM
    for band, (wanted, wider) in enumerate(((-2.0, 2.25), (-1.0, 1.125), (0.0, 0.0), (0.75, 0.5), (1.5, 1.0))):
        assert abs(nm[band] - (450.0, 500.0, 550.0, 600.0, 650.0)[band]) < 10.0
        _, centre, found = moments(pixels[..., band], x, y, reach=12)
        assert np.dot(centre, out) == pytest.approx(wanted * share, abs=0.15)
        assert found[1, 1] == pytest.approx(1.0 + wider, abs=0.1)


def test_an_even_picture_stays_and_a_lens_without_a_table_does_nothing():
    flat = lit([]).with_pixels(np.full((150, 210, 3), 7.0, np.float32))
    found = blurred(flat, tangential_um=(1.0, 2.0, 3.0), sagittal_um=(1.0, 1.5, 2.0))
    np.testing.assert_allclose(found, 7.0, rtol=0.04)  # light gathers where widths have a corner, as here on the axis
    np.testing.assert_allclose(blurred(flat, tangential_um=(2.0,) * 3, sagittal_um=(2.0,) * 3), 7.0, rtol=1e-6)
    same = aberrations(flat, lens=load_lens("pixel4a"), pixel_pitch_um=1.0, sensor=SENSOR)
    assert same is flat


def test_tables_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(ImageError, match="100 pixels; 64 are the most"):
        blurred(lit([]), sagittal_um=(1.0, 1.0, 100.0))
    with pytest.raises(ImageError, match="the angle of view is not known"):
        aberrations(lit([]), lens=lens_of(), pixel_pitch_um=1.0, sensor=SENSOR)
    lens = load_lens("surround_190")
    assert lens.tangential_um[0] == 0.8 and lens.aberration_field_deg[-1] == 95.0
    assert dict(lens.sources)["aberrations"].startswith("Estimate")
    text = (camera.profiles.resources.folder("assets") / "lenses" / "surround_190.yaml").read_text()
    (tmp_path / "lens.yaml").write_text(text.replace("[0.0, 40.0, 70.0, 95.0]", "[0.0, 40.0, 30.0, 95.0]"))
    with pytest.raises(ParameterError, match=r"lens.yaml:\d+:\d+: field_deg is .*; it rises from 0"):
        load_lens("lens.yaml", tmp_path)

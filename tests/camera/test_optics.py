"""Lens ops against closed forms, direct integrals and the Airy pattern."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import j1

from synfog_usd import photometry
from synfog_usd.camera import optics
from synfog_usd.camera.profiles import load_sensor
from synfog_usd.errors import ImageError
from synfog_usd.image import Image, Quantity

SENSOR = load_sensor("imx363")
GREEN = tuple(photometry.band_name(centre) for centre in (549.0, 550.0, 551.0))


def radiance(pixels, channels=("R", "G", "B")) -> Image:
    return Image(np.asarray(pixels, dtype=np.float32), channels, Quantity.RADIANCE)


def through(plane, *, f_number: float, pitch_um: float) -> np.ndarray:
    """A plane of 550 nm light through `optics.diffraction`."""
    image = Image(np.repeat(np.asarray(plane, np.float32)[..., None], 3, axis=2), GREEN, Quantity.IRRADIANCE)
    return optics.diffraction(image, f_number=f_number, pixel_pitch_um=pitch_um, sensor=SENSOR).pixels[..., 1].astype(np.float64)


@pytest.mark.parametrize(("f_number", "m"), [(1.73, 0.0), (4.0, 0.0), (2.0, -0.1)])
def test_irradiance_on_the_axis(f_number, m):
    """E = tau pi L / (1 + 4 (N (1 - m))^2) with m <= 0, as ISETCam writes it (a positive sign of m would be a fault)."""
    image = optics.irradiance(radiance(np.full((2, 2, 3), 7.0)), f_number=f_number, transmission=0.9, magnification=m, falloff="none")
    np.testing.assert_allclose(image.pixels, 0.9 * math.pi * 7.0 / (1 + 4 * (f_number * (1 - m)) ** 2), rtol=1e-6)
    assert image.quantity is Quantity.IRRADIANCE


def test_corners_fade_by_the_fourth_power_of_the_cosine():
    """The angle of the corner pixel from the geometry of a pinhole: 101 x 51 pixels, 70 degrees."""
    image = optics.irradiance(radiance(np.ones((51, 101, 3))), f_number=4.0, transmission=1.0, falloff="cos4", fov_x_deg=70.0)
    focal = 50.5 / math.tan(math.radians(35.0))
    phi = math.atan(math.hypot(50.0, 25.0) / focal)
    assert image.pixels[0, 0, 0] / image.pixels[25, 50, 0] == pytest.approx(math.cos(phi) ** 4, rel=1e-6)


def test_a_shifted_lens_has_its_axis_where_the_shift_says():
    """Right and up are positive: with a quarter of each, the brightest pixel stands there."""
    image = optics.irradiance(radiance(np.ones((80, 160, 3))), f_number=4.0, transmission=1.0, fov_x_deg=70.0, shift_x=0.25, shift_y=0.25)
    row, column = np.unravel_index(image.pixels[..., 0].argmax(), (80, 160))
    assert abs(column - 119.5) <= 0.5 and abs(row - 19.5) <= 0.5


@pytest.mark.parametrize("f_number", [1.0, 1.69, 4.0])
def test_foote_equals_the_integral_over_the_exit_pupil(f_number):
    """E = integral of L cos^2 / d^2 dA over a disc at distance 1 whose half angle has sin^2 = 1 / (1 + 4 N^2)."""
    sin2 = 1 / (1 + 4 * f_number**2)
    radius = math.sqrt(sin2 / (1 - sin2))
    r, angle = np.meshgrid((np.arange(400) + 0.5) / 400 * radius, (np.arange(400) + 0.5) / 400 * 2 * math.pi)
    area = r * (radius / 400) * (2 * math.pi / 400)
    offset = math.tan(math.radians(30.0))
    distance2 = 1 + (r * np.cos(angle) - offset) ** 2 + (r * np.sin(angle)) ** 2
    expected = np.sum(area / distance2**2)  # cos at both ends is 1 / distance
    image = optics.irradiance(radiance(np.ones((1, 401, 3))), f_number=f_number, transmission=1.0, falloff="foote", fov_x_deg=90.0)
    column = np.interp(offset, (np.arange(401) - 200) / 200.5, np.arange(401))
    found = np.interp(column, np.arange(401), image.pixels[0, :, 0].astype(np.float64))
    assert found / math.pi == pytest.approx(expected / math.pi, rel=2e-4)  # 160,000 cells; linear between pixels


def test_falloff_without_an_angle_of_view_is_refused():
    with pytest.raises(ImageError, match="falloff needs the angle of view"):
        optics.irradiance(radiance(np.ones((2, 2, 3))), f_number=2.0, transmission=1.0)


@pytest.mark.parametrize(("f_number", "pitch_um"), [(1.8, 1.4), (4.0, 3.0), (8.0, 3.0)])
@pytest.mark.parametrize("cycles", [8, 32, 64, 96])
def test_contrast_of_a_grating_follows_the_diffraction_limit(f_number, pitch_um, cycles):
    """A cosine of `cycles` per 256 pixels keeps 2/pi (acos v - v sqrt(1 - v^2)) of its contrast.

    Measured in the middle, away from the edges; 0.002 is left of their tails.
    """
    frequency = cycles / 256
    wave = np.cos(2 * math.pi * frequency * (np.arange(256) + 0.5))
    out = through(np.tile(1 + 0.5 * wave, (256, 1)), f_number=f_number, pitch_um=pitch_um)[128]
    v = min(frequency * 0.550 * f_number / pitch_um, 1.0)
    expected = 2 / math.pi * (math.acos(v) - v * math.sqrt(1 - v * v))
    contrast = 2 * np.mean((out * wave)[64:192]) / np.mean(out[64:192]) / 0.5
    assert contrast == pytest.approx(expected, abs=0.002)


def test_an_even_picture_stays_even_up_to_its_edges():
    np.testing.assert_allclose(through(np.full((37, 61), 3.0), f_number=8.0, pitch_um=1.4), 3.0, rtol=1e-5)


@pytest.mark.parametrize(("f_number", "pitch_um"), [(1.73, 1.4), (4.0, 2.0)])
def test_a_lamp_becomes_the_airy_disc_integrated_over_pixels(f_number, pitch_um):
    """(pi / 4 q^2) (2 J1(x) / x)^2, x = pi r / q, averaged over 40 x 40 points per pixel; off the grid's axes as well as on them."""
    q = 0.550 * f_number / pitch_um
    plane = np.zeros((151, 151))
    plane[75, 75] = 1e6
    out = through(plane, f_number=f_number, pitch_um=pitch_um) / 1e6
    fine = (np.arange(40) + 0.5) / 40 - 0.5
    for row, column in [(0, 0), (1, 0), (1, 1), (3, 0), (2, 2), (8, 0), (6, 5), (20, 0)]:
        x = math.pi / q * np.hypot(row + fine[:, None], column + fine[None, :])
        expected = np.mean(math.pi / (4 * q * q) * (2 * j1(x) / x) ** 2)
        assert out[75 + row, 75 + column] == pytest.approx(expected, rel=0.05, abs=2e-6), (row, column)
    assert (out >= 0.0).all()
    assert out.sum() == pytest.approx(1.0, abs=0.01)  # what lies outside 75 pixels


def test_glare_keeps_an_even_picture_and_all_of_the_light():
    even = Image(np.full((90, 160, 3), 5.0, np.float32), ("R", "G", "B"), Quantity.IRRADIANCE)
    np.testing.assert_allclose(optics.glare(even, fraction=0.1).pixels, 5.0, rtol=1e-5)
    lamp = even.pixels * 0
    lamp[40:44, 80:84] = 1000.0
    out = optics.glare(even.with_pixels(lamp), fraction=0.1).pixels
    np.testing.assert_allclose(out.sum(axis=(0, 1)), lamp.sum(axis=(0, 1)), rtol=1e-3)
    np.testing.assert_allclose(out[41, 81], 900.0, rtol=0.05)
    assert 0 < out[10, 10, 0] < out[40, 60, 0] < out[40, 75, 0]


def test_blocks_average_their_pixels_also_where_they_are_cut():
    pixels = np.arange(5 * 7 * 1, dtype=np.float32).reshape(5, 7, 1)
    means = optics.block_means(pixels, 3)
    expected = [[pixels[r : r + 3, c : c + 3].mean() for c in (0, 3, 6)] for r in (0, 3)]
    np.testing.assert_allclose(means[..., 0], expected, rtol=1e-6)


def test_lights_add_with_their_weights():
    one, two = radiance(np.full((2, 2, 3), 3.0)), radiance(np.full((2, 2, 3), 5.0))
    np.testing.assert_array_equal(optics.mix(one, two, weights=(2.0, 0.5)).pixels, np.full((2, 2, 3), 8.5))
    with pytest.raises(ImageError, match="2 images, but 1 weights"):
        optics.mix(one, two, weights=(1.0,))
    with pytest.raises(ImageError, match="cannot be added"):
        optics.mix(one, radiance(np.ones((2, 3, 3))), weights=(1.0, 1.0))

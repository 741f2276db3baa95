"""Diffraction against closed forms and the Airy pattern."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import j1

from synfog_usd.base import photometry, seeds
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import blur, spread
from synfog_usd.camera.profiles import load_sensor

SENSOR = load_sensor("imx363")


def bands(*centres_nm):
    return tuple(photometry.band_name(centre) for centre in centres_nm)


GREEN = bands(549.0, 550.0, 551.0)


def light(plane, channels=GREEN) -> Image:
    return Image(
        np.repeat(np.asarray(plane, np.float32)[..., None], len(channels), axis=2), channels, Quantity.IRRADIANCE
    )


def through(plane, *, f_number: float, pitch_um: float, mode="band") -> np.ndarray:
    """A plane of 550 nm light through `optics.diffraction`."""
    return (
        blur.diffraction(light(plane), mode=mode, f_number=f_number, pixel_pitch_um=pitch_um, sensor=SENSOR)
        .pixels[..., 1]
        .astype(np.float64)
    )


def texture(contrast, shape=(256, 256), mean=100.0):
    """Noise whose amplitude falls as 1 / frequency, with that RMS contrast."""
    f = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])
    f[0, 0] = np.inf
    plane = np.fft.irfft2(np.fft.rfft2(seeds.stream(0, "texture").standard_normal(shape)) / f, s=shape)
    return mean * (1.0 + contrast * plane / plane.std())


@pytest.mark.parametrize(("f_number", "pitch_um"), [(1.8, 1.4), (8.0, 3.0)])
@pytest.mark.parametrize("cycles", [8, 64])
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


@pytest.mark.parametrize("spot_um", [0.3, 1.4])
def test_a_lens_with_errors_takes_contrast_as_a_gaussian_spot_does(spot_um):
    """Times exp(-2 (pi s f)^2) of what diffraction leaves, for a grating within 0.002; and a lamp's spot, seen as a
    line, has that contrast too times that of the pixels' area, within 0.005 of its light.
    """
    pitch_um, f_number = 1.4, 1.8
    q = 0.550 * f_number / pitch_um
    whole = spread.aperture(q, 1, spot_um / pitch_um)
    assert whole.spot.min() >= 0.0
    for cycles in (16, 64, 110):
        frequency = cycles / 256
        wave = np.cos(2 * math.pi * frequency * (np.arange(256) + 0.5))
        image = light(np.tile(1 + 0.5 * wave, (256, 1)))
        out = blur.diffraction(
            image, mode="band", f_number=f_number, pixel_pitch_um=pitch_um, sensor=SENSOR, spot_um=spot_um
        ).pixels[128, :, 1]
        v = q * frequency
        expected = 2 / math.pi * (math.acos(v) - v * math.sqrt(1 - v * v))
        expected *= math.exp(-2 * (math.pi * spot_um / pitch_um * frequency) ** 2)
        assert 2 * np.mean((out * wave)[64:192]) / np.mean(out[64:192]) / 0.5 == pytest.approx(expected, abs=0.002)
        folded = 0.0
        for f in frequency + np.arange(-3, 4):  # what lies beyond the Nyquist frequency folds back
            v = min(q * abs(f), 1.0)
            left = 2 / math.pi * (math.acos(v) - v * math.sqrt(1 - v * v))
            folded += left * math.exp(-2 * (math.pi * spot_um / pitch_um * f) ** 2) * np.sinc(f)
        line = whole.spot.sum(axis=0)
        seen = line @ np.cos(2 * math.pi * frequency * (np.arange(line.size) - line.size // 2))
        seen += whole.tail * spread.tail_transfer(np.array([frequency]), whole.tail_scale)[0]
        assert seen == pytest.approx(folded, abs=0.005)


@pytest.mark.parametrize("shape", [(37, 61), (1, 1)])
def test_an_even_picture_stays_even_up_to_its_edges(shape):
    np.testing.assert_allclose(through(np.full(shape, 3.0), f_number=8.0, pitch_um=1.4), 3.0, rtol=1e-5)


@pytest.mark.parametrize(("f_number", "pitch_um"), [(1.73, 1.4), (8.0, 2.0)])
def test_a_lamp_becomes_the_airy_disc_integrated_over_pixels(f_number, pitch_um):
    """(pi / 4 q^2) (2 J1(x) / x)^2, x = pi r / q, averaged over 40 x 40 points per pixel; off the grid's axes as well
    as on them.
    """
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
    assert out.sum() == pytest.approx(1.0, abs=0.01 * max(q, 1.0))  # 2 q / (pi^2 r) lies outside r = 75 pixels


def test_the_tail_of_a_headlight_is_the_discs_and_not_the_transforms_noise():
    """q / (pi^3 r^3) of 1e9 over a background of 1: at r = 150 that is 1.2e-10 q of the lamp.

    The lamp has mirror images every 601 pixels, which add an eighth there; those beyond the fortieth add 0.3 %.
    """
    plane = np.ones((601, 601))
    plane[300, 300] = 1e9
    out = through(plane, f_number=2.0, pitch_um=3.0)
    y, x = np.mgrid[-300:301:7, -300:301:7]
    r = np.hypot(y, x)
    ring = (r > 32) & (r < 150)
    images = 601 * np.arange(-40, 41)
    r3 = ((y[ring, None, None] + images[:, None]) ** 2 + (x[ring, None, None] + images) ** 2) ** 1.5
    expected = 0.550 * 2.0 / 3.0 * 1e9 / math.pi**3 * (1.0 / r3).sum(axis=(1, 2))
    np.testing.assert_allclose((out - 1.0)[::7, ::7][ring], expected, rtol=0.02)


def test_thick_fog_is_left_alone_and_a_lamp_in_it_is_not():
    """Contrast 0.002 at q = 0.73: 0.002 * 0.134 * 0.73 = 0.0002 is below 0.001; with contrast 0.02 it is not."""
    fog = texture(0.002, (300, 400))
    kept = blur.diffraction(light(fog), f_number=4.0, pixel_pitch_um=3.0, sensor=SENSOR)
    assert kept.provenance["diffraction_mode"] == "none" and 0.0 < kept.provenance["diffraction_error"] < 0.001
    np.testing.assert_array_equal(kept.pixels, light(fog).pixels)
    for plane in (
        texture(0.02, (300, 400)),
        np.where(np.arange(400) == 37, np.where(np.arange(300) == 50, 1e4, 1.0)[:, None], 1.0) * fog,
    ):
        assert (
            blur.diffraction(light(plane), f_number=4.0, pixel_pitch_um=3.0, sensor=SENSOR).provenance[
                "diffraction_mode"
            ]
            == "band"
        )

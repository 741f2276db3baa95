"""Noise and sharpness: what goes, and what it costs in contrast."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from synfog_usd.base import seeds
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.cfa import sites
from synfog_usd.camera.cleanup import denoise, false_colour, sharpen
from synfog_usd.camera.demosaic import demosaic

WELL_E, READ_E = 6000.0, 5.0
SHOT, DARK = 1.0 / WELL_E, (READ_E / WELL_E) ** 2
"""Of the test sensor: a signal x of the well has the variance SHOT x + DARK."""


def mosaic(pixels, pattern="RGGB") -> Image:
    return Image(
        np.asarray(pixels, np.float32)[..., None],
        ("CFA",),
        Quantity.LINEAR_RGB,
        provenance={"cfa_pattern": pattern, "noise_profile": [SHOT, DARK]},
    )


def sigma(level):
    return np.sqrt(SHOT * level + DARK)


def frame(mean, seed) -> np.ndarray:
    """Counted light: Poisson and read noise on a mean signal (H, W), 1 = full well."""
    rng = seeds.stream(seed, "cleanup")
    return ((rng.poisson(mean * WELL_E) + READ_E * rng.standard_normal(np.shape(mean))) / WELL_E).astype(np.float32)


# ---- denoise


@pytest.mark.parametrize("pattern, level", [("RGGB", 0.02), ("RGIB", 0.4)])
def test_noise_falls_and_the_mean_stays(level, pattern):
    """Flat grey: noise below a fifth; the mean within 4 standard errors of the input's own."""
    clean = frame(np.full((400, 400), level), 4)
    out = denoise(mosaic(clean, pattern)).pixels[..., 0]
    assert out[20:-20, 20:-20].std() < 0.2 * clean.std()
    assert abs(out.mean(dtype=np.float64) - clean.mean(dtype=np.float64)) < 4 * sigma(level) / 400


def test_contrast_above_the_noise_stays_and_below_it_goes():
    """Vertical edges of 40 and of 1 sigma: 97 % of the first is kept two pixels off the edge, and the mean over its
    halves exactly.

    The step's largest detail is 0.3 of its height in level 1, where T is 2.7 sigma: it loses T^2 / w = 0.6 of 12 sigma.
    """
    level = 0.3
    for height, low, high in ((40.0, 0.97, 1.02), (1.0, 0.0, 1.2)):
        mean = np.full((400, 400), level)
        mean[:, 200:] += height * sigma(level)
        out = denoise(mosaic(frame(mean, 5), "MONO")).pixels[..., 0]
        step = (out[:, 202].mean() - out[:, 197].mean()) / (height * sigma(level))
        assert low < step < high
    bump = np.full((400, 400), level)
    bump[50::100, 50::100] += 2.0 * sigma(level)  # single pixels of 2 sigma: gone with the noise
    out = denoise(mosaic(frame(bump, 6), "MONO")).pixels[..., 0]
    assert abs(out[50::100, 50::100].mean() - level) < 0.5 * sigma(level)


# ---- false colours


def picture(pixels) -> Image:
    return Image(np.asarray(pixels, np.float32), ("R", "G", "B"), Quantity.LINEAR_RGB)


def test_colour_differences_become_medians_as_scipy_takes_them():
    """Over rows of a strip and of the next; within three pixels of the rim the order of the four passes shows."""
    from scipy.ndimage import median_filter

    pixels = np.float32(0.9) * seeds.stream(2, "false colour").random((140, 33, 3), dtype=np.float32)
    out = false_colour(picture(pixels)).pixels
    np.testing.assert_array_equal(out[..., 1], pixels[..., 1])
    for channel in (0, 2):
        expected = pixels[..., channel] - pixels[..., 1]
        for reach in (1, 2):
            for shape in ((2 * reach + 1, 1), (1, 2 * reach + 1)):
                three = np.zeros(shape, dtype=bool)
                three.flat[::reach] = True
                expected = median_filter(expected, footprint=three)
        inside = (slice(6, -6), slice(6, -6))
        np.testing.assert_array_equal(out[..., channel][inside], (pixels[..., 1] + expected)[inside])


def lamp(colour, side_px, at) -> np.ndarray:
    """R - G and B - G (20, 20, 2) of a lamp before a grey of 0.1 as a sensor of RGGB takes it, cut at 1."""
    light = np.full((20, 20, 3), 0.1)
    light[at[0] : at[0] + side_px, at[1] : at[1] + side_px] += colour
    light = gaussian_filter(light, (0.6, 0.6, 0.0))
    cells = np.empty((20, 20))
    for where, number in sites("RGGB"):
        cells[where] = light[(*where, number)]
    out = false_colour(demosaic(mosaic(np.minimum(cells, 1.0)))).pixels
    return out[..., [0, 2]] - out[..., 1:2]


@pytest.mark.parametrize("at", [(9, 9), (9, 10), (10, 9), (10, 10)])
@pytest.mark.parametrize("brightness", [10.0, 30.0, 1000.0])
def test_a_far_white_lamp_is_white_whichever_filter_it_falls_on(at, brightness):
    """Of one pixel, 2 to 200 times what saturates one: else red, green or purple of up to 0.2."""
    assert np.abs(lamp(np.full(3, brightness), 1, at)).max() < 0.04


@pytest.mark.parametrize("colour, sign", [((10.0, 0.6, 0.2), 1.0), ((0.2, 10.0, 5.0), -1.0)])
def test_a_lamp_of_several_pixels_keeps_its_colour(colour, sign):
    """Ten times what saturates its own filter: red is red, and green is green, in the middle and nowhere else."""
    tinted = np.argwhere(lamp(colour, 5, (8, 8))[..., 0] * sign > 0.3)
    assert len(tinted) and tinted.min() >= 6 and tinted.max() <= 14


# ---- sharpen


def wave(period_px, amplitude=0.1) -> Image:
    line = 0.5 + amplitude * np.sin(2 * np.pi * np.arange(400) / period_px)
    return Image(
        np.broadcast_to(line.astype(np.float32)[None, :, None], (20, 400, 3)).copy(),
        ("R", "G", "B"),
        Quantity.DISPLAY_RGB,
    )


@pytest.mark.parametrize("radius_px, period_px", [(0.8, 4.0), (2.0, 10.0)])
def test_waves_rise_as_the_unsharp_mask_says(radius_px, period_px):
    """Amplitude times 1 + amount (1 - exp(-2 pi^2 r^2 / P^2)); 1 % for a kernel cut at 3 r and sampled at pixels."""
    out = sharpen(wave(period_px), radius_px=radius_px, amount=0.8, threshold=0.0).pixels[10, 100:300, 0]
    expected = 0.1 * (1 + 0.8 * (1 - np.exp(-2 * (np.pi * radius_px / period_px) ** 2)))
    carrier = np.sin(2 * np.pi * np.arange(100, 300) / period_px)
    assert 2 * np.mean((out - 0.5) * carrier) == pytest.approx(expected, rel=0.01)

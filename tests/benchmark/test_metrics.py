"""Metrics against definitions written out, their papers' published values and the reference implementations."""

from __future__ import annotations

import flip_evaluator
import numpy as np
import pytest
from scipy import ndimage
from skimage.color import deltaE_ciede2000, rgb2lab

from synfog_usd.base import seeds
from synfog_usd.base.errors import ParameterError
from synfog_usd.lab.benchmark import metrics


def pictures(noise: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """A smooth picture of 48 x 64 and the same with uniform noise of some levels."""
    rng = seeds.stream(4, "metrics")
    truth = ndimage.gaussian_filter(rng.integers(0, 256, (48, 64, 3)).astype(float), (3, 3, 0))
    truth = np.interp(truth, (truth.min(), truth.max()), (20, 230))
    other = truth + rng.integers(-noise, noise + 1, truth.shape)
    return np.rint(np.clip(other, 0, 255)).astype(np.uint8), np.rint(truth).astype(np.uint8)


def test_psnr_is_its_definition():
    """Equal pictures have the highest value that is told; one level everywhere has 20 log10 255."""
    truth = np.full((4, 5, 3), 100, np.uint8)
    assert metrics.psnr(truth, truth) == 100.0
    assert metrics.psnr(truth + np.uint8(1), truth) == pytest.approx(20 * np.log10(255), abs=1e-4)
    picture, truth = pictures()
    error = sum((int(a) - int(b)) ** 2 for a, b in zip(picture.ravel(), truth.ravel(), strict=True)) / truth.size
    assert metrics.psnr(picture, truth) == pytest.approx(10 * np.log10(255**2 / error), abs=1e-4)


def test_ssim_is_the_papers_formula():
    """Equation 13 of the paper with Gaussian windows of 11 x 11, sigma 1.5, K 0.01 and 0.03, away from the edges."""
    picture, truth = (image.astype(np.float64) for image in pictures())
    reach = np.arange(-5, 6)
    kernel = np.exp(-(reach**2) / (2 * 1.5**2))
    kernel /= kernel.sum()

    def mean(values: np.ndarray) -> np.ndarray:
        return ndimage.convolve1d(ndimage.convolve1d(values, kernel, axis=0), kernel, axis=1)[5:-5, 5:-5]

    channels = []
    for x, y in zip(np.moveaxis(picture, 2, 0), np.moveaxis(truth, 2, 0), strict=True):
        mx, my = mean(x), mean(y)
        vx, vy, both = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
        c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
        channels.append(((2 * mx * my + c1) * (2 * both + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))).mean())
    found = metrics.ssim(picture.astype(np.uint8), truth.astype(np.uint8))
    assert found == pytest.approx(np.mean(channels), abs=1e-4)


def test_the_colour_difference_of_greys_is_that_of_their_lightness():
    """Levels 119 and 118: L* by IEC 61966-2-1 and CIE 15, their difference over S_L of CIE 142."""
    lightness = []
    for level in (119, 118):
        y = ((level / 255 + 0.055) / 1.055) ** 2.4
        lightness.append(116 * y ** (1 / 3) - 16)
    middle = np.mean(lightness)
    wanted = (lightness[0] - lightness[1]) / (1 + 0.015 * (middle - 50) ** 2 / np.sqrt(20 + (middle - 50) ** 2))
    grey = np.full((3, 3, 3), 119, np.uint8)
    assert metrics.delta_e(grey, np.full_like(grey, 118)) == pytest.approx(wanted, abs=1e-3)


def test_every_pixel_gets_its_own_colours_difference():
    """Each colour is converted once; against skimage, which converts every pixel with its own matrices (1e-3)."""
    picture, truth = pictures(60)
    theirs = deltaE_ciede2000(rgb2lab(truth), rgb2lab(picture)).mean()
    assert metrics.delta_e(picture, truth) == pytest.approx(theirs, abs=1e-3)


def test_flip_is_the_reference_implementations_mean_and_knows_which_is_the_truth():
    picture, truth = pictures()
    assert metrics.flip(truth, truth) == 0.0
    ours = metrics.flip(picture, truth)
    theirs = flip_evaluator.evaluate(truth.astype(np.float32) / 255, picture.astype(np.float32) / 255, "LDR")[1]
    assert ours == pytest.approx(theirs, abs=1e-6) and 0.02 < ours < 0.5
    black, white = np.zeros((32, 32, 3), np.uint8), np.full((32, 32, 3), 255, np.uint8)
    assert metrics.flip(white, black) > 0.95


def test_another_size_is_refused():
    with pytest.raises(ParameterError, match="64 x 48 cannot be compared with one of 64 x 47"):
        metrics.measure(pictures()[0], pictures()[1][:47])

"""What is left after denoising, told from two halves: against truths that are known, by any denoiser.

The pictures are made here: a truth, noise, and filters with faults of every kind in the place of a denoiser.
"""

import numpy as np
import pytest
from scipy import ndimage

from synfog_usd.render import dualbuffer
from synfog_usd.render.dualbuffer import error_of, towards_truth

GREY = np.full(3, 1.0 / 3.0, dtype=np.float32)
SHAPE = (120, 160)


def truth():
    """Fields and edges, 0.2 to 2.2."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 20.0
    fields = (
        1.0
        + 0.5 * np.sin(3.0 * x) * np.cos(2.0 * y)
        + np.where(x + y > 7.0, 0.7, 0.0)
        - np.where((x % 2 < 0.3), 0.3, 0.0)
    )
    return np.repeat(fields[..., None], 3, axis=2).astype(np.float32)


def halves(noise, seed):
    """(2, H, W, 3) the truth with noise of each half that has the long tail of light's and no mean."""
    random = np.random.default_rng(seed)
    grain = random.gamma(0.5, 2.0, (2, *SHAPE, 1)) - 1.0  # mean 0, variance 2
    return (truth() * (1.0 + noise * grain / np.sqrt(2.0))).astype(np.float32)


def blurred(image, sigma=2.0):
    return ndimage.gaussian_filter(image, (sigma, sigma, 0.0), mode="nearest")


FILTERS = {
    "blurs": blurred,
    "does nothing": lambda image: image,
    "loses a tenth": lambda image: 0.9 * blurred(image, 1.0),
    "cuts what stands out": lambda image: blurred(np.minimum(image, 1.5 * blurred(image, 4.0)), 1.5),
}


def rms(values):
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("noise", [0.1, 0.4])
def test_the_error_that_is_told_is_the_error_that_is_there(name, noise):
    """Relative RMS over the picture, five seeds pooled: within 15 % (measured 6 %); noise of 19 200 pixels leaves 4
    %.
    """
    told, there = [], []
    for seed in range(5):
        noisy = halves(noise, seed)
        clean = np.stack([FILTERS[name](half) for half in noisy])
        error = error_of(noisy @ GREY, clean @ GREY)
        told.append(rms(error.rms / (truth() @ GREY)))
        there.append(rms((clean.mean(axis=0) - truth()) @ GREY / (truth() @ GREY)))
    assert rms(told) == pytest.approx(rms(there), rel=0.15)


def test_a_quiet_pixel_is_not_told_the_error_of_noisy_ones_beside_it():
    """Posts of 3 pixels with eight times the noise, every 16: the median pixel's error within a factor of 1.5."""
    noise = np.where(np.arange(SHAPE[1]) % 16 < 3, 0.8, 0.1)[:, None]
    told, squares = [], []
    for seed in range(12):
        noisy = halves(noise, seed)
        clean = np.stack([blurred(half, 0.7) for half in noisy])
        told.append(error_of(noisy @ GREY, clean @ GREY).rms / (truth() @ GREY))
        squares.append(((clean.mean(axis=0) - truth()) @ GREY / (truth() @ GREY)) ** 2)
    there = np.median(np.sqrt(np.mean(squares, axis=0)))
    assert 1 / 1.5 < np.median(told) / there < 1.5


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("noise", [0.01, 0.1, 1.0])
def test_going_back_to_the_samples_never_costs_much_and_ends_at_the_truth(name, noise):
    """Never over 1.15 times the error of the better of samples and filter: of the samples where those are good, of the
    filter where they are not.
    """
    before, samples, after = [], [], []
    for seed in range(3):
        noisy = halves(noise, seed)
        clean = np.stack([FILTERS[name](half) for half in noisy])
        before.append(rms(clean.mean(axis=0) - truth()))
        samples.append(rms(noisy.mean(axis=0) - truth()))
        after.append(rms(towards_truth(noisy, clean, GREY).mean(axis=0) - truth()))
    assert rms(after) < 1.15 * min(rms(before), rms(samples))


def test_light_of_rare_bright_samples_comes_back_where_it_was_and_not_elsewhere():
    """A tenth of the light of one side lies in one sample of 400, which the filter takes for outliers: on the mean of
    eight seeds both sides have their light, known to 0.5 % and 0.1 %.  Lost here and given back all over the picture,
    it would be 5 % too little and 4 % too much.
    """
    sides = []
    for seed in range(8):
        random = np.random.default_rng(seed)
        noisy = 1.0 + 0.05 * random.standard_normal((2, 64, 128, 1)).repeat(3, axis=3)
        noisy[:, :, :64] += 40.0 * (random.random((2, 64, 64, 1)) < 1 / 400) - 0.1
        clean = np.ones_like(noisy)
        clean[:, :, :64] = 0.9
        done = towards_truth(noisy.astype(np.float32), clean.astype(np.float32), GREY).mean(axis=0)
        sides.append([done[:, :64].mean(), done[:, 64:].mean()])
    assert np.mean(sides, axis=0) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("shape", [(1, 1), (16, 2048)])
@pytest.mark.parametrize("light", ["none", "one pixel", "noise", "below zero"])
def test_odd_pictures_stay_finite(shape, light):
    """Any size, no light at all, one bright pixel of one half, light below 0: finite, and not negative."""
    random = np.random.default_rng(1)
    noisy = np.zeros((2, *shape, 3), dtype=np.float32)
    if light == "one pixel":
        noisy[0, 0, 0] = 1e6
    elif light != "none":
        noisy += random.exponential(1.0, noisy.shape).astype(np.float32) - (0.9 if light == "below zero" else 0.0)
    clean = np.stack([blurred(np.maximum(half, 0.0)) for half in noisy])
    done = towards_truth(noisy, clean, GREY)
    assert done.shape == noisy.shape and np.isfinite(done).all() and done.min() >= 0.0
    error = error_of(noisy @ GREY, done @ GREY)
    assert np.isfinite(error.rms).all() and np.all(error.rms >= error.scatter) and error.scatter.min() >= 0.0


def test_mottle_is_what_white_noise_leaves_under_a_blur():
    """Of white noise of standard deviation s in each half, (a - b) / 2 has s / sqrt(2), and a Gaussian blur of w px
    leaves 1 / (2 w sqrt(pi)) of it; where it mirrors at a border, twice the variance, on average over a length L
    1 + w sqrt(pi) / L times.  24 pictures of some 100 independent patches: known to 1.5 %, four of which are allowed.
    """
    height, width, noise = 320, 400, 0.1
    draw = np.random.default_rng(3)
    pictures = (1.0 + noise * draw.standard_normal((24, 2, height, width))).astype(np.float32)
    blur_px = width / dualbuffer.MOTTLE_WIDTHS
    borders = (1.0 + blur_px * np.sqrt(np.pi) / width) * (1.0 + blur_px * np.sqrt(np.pi) / height)
    seen = np.sqrt(np.mean([dualbuffer.mottle(halves) ** 2 for halves in pictures]))
    assert seen == pytest.approx(noise * np.sqrt(borders / 2.0) / (2.0 * blur_px * np.sqrt(np.pi)), rel=0.06)
    by_variance = dualbuffer.mottle_of_noise(np.ones((height, width)), np.full((height, width), noise**2 / 2.0))
    assert by_variance == pytest.approx(noise / np.sqrt(2.0) / (2.0 * blur_px * np.sqrt(np.pi)), rel=1e-4)

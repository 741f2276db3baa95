"""Pixels that differ from the rest: statistics of closed form, the same pixels in every frame."""

from __future__ import annotations

import math

import numpy as np
import pytest

from synfog_usd.base import seeds
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import specimen

SERIAL = "test-1"
SIGMAS = 4.5


def electrons(pixels, **provenance) -> Image:
    return Image(
        np.asarray(pixels, np.float32)[..., None],
        ("CFA",),
        Quantity.ELECTRONS,
        provenance={"dark_e": 4.0, **provenance},
    )


def flat(level: float, side: int = 1000) -> Image:
    return electrons(np.full((side, side), level))


@pytest.mark.parametrize("frequency", [1 / 16, 1 / 4])
def test_crosstalk_has_the_contrast_of_its_formula(frequency):
    """A sine along a row keeps 1 - c / 2 (1 - cos 2 pi f) of its swing, c = 0.12, found by its Fourier coefficient."""
    columns = np.arange(256)
    wave = 100.0 + 50.0 * np.cos(2 * np.pi * frequency * columns)
    out = specimen.crosstalk(electrons(np.tile(wave, (8, 1))), crosstalk_percent=12.0).pixels[4, 64:192, 0]
    swing = 2.0 * abs(np.mean(out * np.exp(-2j * np.pi * frequency * columns[64:192])))
    assert swing / 50.0 == pytest.approx(1.0 - 0.06 * (1.0 - math.cos(2 * math.pi * frequency)), abs=1e-5)


def test_dark_current_spreads_about_its_mean_and_some_pixels_are_hot():
    """10^6 pixels: mean 4 e- and deviation 30 % without hot ones; 500 ppm of 100 times add 0.2 e- to the mean.

    A log-normal of deviation 0.3 has kurtosis 4.7, so its deviation is known to 0.1 %; the number of hot pixels is
    binomial, and their exponential excess has a deviation as large as its mean.
    """
    image = flat(4.0)
    spread = specimen.dark_nonuniformity(image, spread_percent=30.0, hot_ppm=0.0, hot_times=1.0, serial=SERIAL).pixels
    assert spread.mean(dtype=np.float64) == pytest.approx(4.0, abs=SIGMAS * 1.2 / 1000)
    assert spread.std(dtype=np.float64) == pytest.approx(1.2, rel=SIGMAS * 1e-3)
    hot = specimen.dark_nonuniformity(image, spread_percent=0.0, hot_ppm=500.0, hot_times=100.0, serial=SERIAL).pixels
    lit = hot[hot > 4.0] - 4.0
    assert abs(lit.size - 500) < SIGMAS * math.sqrt(500)
    assert abs(lit.mean() - 400.0) < SIGMAS * 400.0 / math.sqrt(lit.size)
    assert abs((lit > 400.0 * math.log(2)).mean() - 0.5) < SIGMAS * 0.5 / math.sqrt(lit.size)


def test_dead_and_stuck_pixels_are_as_many_as_asked_and_stay():
    """Binomial counts at two levels of light, the same pixels in both, and a crop has those of the larger picture."""
    frames = [
        specimen.dead_pixels(flat(level), dead_ppm=300.0, stuck_ppm=600.0, full_well_e=9000.0, serial=SERIAL).pixels
        for level in (100.0, 5000.0)
    ]
    for held, expected in ((0.0, 300), (9000.0, 600)):
        assert np.array_equal(frames[0] == held, frames[1] == held)
        assert abs((frames[0] == held).sum() - expected) < SIGMAS * math.sqrt(expected)
    crop = specimen.dead_pixels(
        flat(100.0, 300), dead_ppm=300.0, stuck_ppm=600.0, full_well_e=9000.0, serial=SERIAL
    ).pixels
    assert np.array_equal(crop, frames[0][:300, :300])
    other = specimen.dead_pixels(flat(100.0), full_well_e=9000.0, serial="another").pixels
    assert not np.array_equal(other == 0.0, frames[0] == 0.0)


def test_telegraph_pixels_blink_by_their_own_step():
    """Of one pixel, 4000 frames show A, -A and 0 with chances 1/4, 1/4, 1/2; A is exponential, mean 20."""
    rng = seeds.stream(1, "telegraph")
    frames = np.stack(
        [
            specimen.telegraph_noise(
                electrons(np.zeros((40, 40))), rng=rng, telegraph_ppm=20_000.0, telegraph_e=20.0, serial=SERIAL
            ).pixels[..., 0]
            for _ in range(4000)
        ]
    )
    rows, columns = np.nonzero(frames.any(axis=0))
    assert abs(rows.size - 32) < SIGMAS * math.sqrt(32)
    seen = frames[:, rows, columns]
    step = np.abs(seen).max(axis=0)
    assert np.isin(seen, np.stack([-step, np.zeros_like(step), step])).all()
    for value, chance in ((1.0, 0.25), (-1.0, 0.25), (0.0, 0.5)):
        part = np.isclose(seen, value * step).mean()
        assert abs(part - chance) < SIGMAS * math.sqrt(chance * (1 - chance) / seen.size)
    wide = specimen.telegraph_noise(
        electrons(np.zeros((1000, 1000))), rng=rng, telegraph_ppm=10_000.0, telegraph_e=20.0, serial=SERIAL
    ).pixels
    assert wide.var(dtype=np.float64) == pytest.approx(0.01 * 2 * 20.0**2 / 2, rel=0.12), "E A^2 / 2, A exponential"


def test_nonlinearity_is_as_large_as_it_says_and_never_falls():
    """Largest deviation from the line through the ends: 3 DN at a quarter and three quarters; beyond the ends none."""
    ramp = np.linspace(-50.0, 1200.0, 5001)
    image = Image(ramp[None, :, None].astype(np.float32), ("CFA",), Quantity.DN)
    out = specimen.nonlinearity(image, inl_dn=3.0, black_level_dn=64, white_level_dn=1023).pixels[0, :, 0]
    deviation = out - ramp
    assert deviation.max() == pytest.approx(3.0, abs=1e-3)
    assert ramp[deviation.argmax()] == pytest.approx(959 / 4, abs=5.0)
    assert deviation.min() == pytest.approx(-3.0, abs=1e-3)
    assert np.abs(deviation[(ramp < 0) | (ramp > 959)]).max() < 1e-3
    assert (np.diff(out) > 0).all()
    with pytest.raises(ImageError, match="fewer DN for more light"):
        specimen.nonlinearity(image, inl_dn=200.0, black_level_dn=64, white_level_dn=1023)

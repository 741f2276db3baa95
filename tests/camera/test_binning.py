"""Binning against sums by hand and the statistics of independent pixels."""

import numpy as np
import pytest

from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa, sensor


def electrons(pixels, pattern="RGGB", **more):
    facts = {"cfa_pattern": pattern, "pixel_pitch_um": 2.0, "gathered_um2_s": 0.04} | more
    return Image(np.asarray(pixels, dtype=np.float32)[..., None], ("CFA",), Quantity.ELECTRONS, provenance=facts)


@pytest.mark.parametrize("pattern, factor", [("RGGB", 2), ("RGIB", 3), ("MONO", 2)])
def test_each_colour_is_added_to_its_own(pattern, factor):
    """A mosaic in which each filter has a number of its own keeps them, times factor^2, in the same pattern."""
    values = {"R": 1.0, "G": 10.0, "B": 100.0, "C": 1000.0, "I": 1e4}
    rows = cfa.PATTERNS[pattern]
    made = [[values[rows[y % len(rows)][x % len(rows[0])]] for x in range(24)] for y in range(12)]
    seen = sensor.binning(electrons(made, pattern), factor=factor)
    wanted = np.array(made)[: seen.height_px, : seen.width_px] * factor**2
    assert seen.pixels.shape == (12 // factor, 24 // factor, 1)
    np.testing.assert_array_equal(seen.pixels[..., 0], wanted)
    assert seen.provenance["pixel_pitch_um"] == 2.0 * factor
    assert seen.provenance["gathered_um2_s"] == pytest.approx(0.04 * factor**2)


def test_charge_is_read_once_and_read_pixels_four_times():
    """Variance of 2 x 2 pixels of mean mu and read noise s: 4 mu + s^2 of charge, 4 mu + 4 s^2 behind the reading; the
    provenance says the noise that a clamp and a RAW file need.
    """
    mu, sigma = 5.0, 6.0
    even = electrons(np.full((400, 400), mu), "MONO")
    for seed, order in enumerate(("before", "behind")):
        rng = np.random.default_rng(seed)
        counted = sensor.shot_noise(even, rng=rng)
        if order == "before":
            seen = sensor.read_noise(sensor.binning(counted), rng=rng, sigma_e=sigma)
        else:
            seen = sensor.binning(sensor.read_noise(counted, rng=rng, sigma_e=sigma))
        wanted = 4.0 * mu + (sigma if order == "before" else 2.0 * sigma) ** 2
        spread = seen.pixels.var(dtype=np.float64)
        assert spread == pytest.approx(wanted, rel=5 * np.sqrt(2 / seen.pixels.size))
        assert seen.pixels.mean(dtype=np.float64) == pytest.approx(4.0 * mu, abs=5 * np.sqrt(wanted / seen.pixels.size))
        assert seen.provenance["read_noise_e"] == (sigma if order == "before" else 2.0 * sigma)

"""Binning against sums by hand and the statistics of independent pixels."""

import numpy as np
import pytest

from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa, sensor


def electrons(pixels, pattern="RGGB", **more):
    facts = {"cfa_pattern": pattern, "pixel_pitch_um": 2.0, "gathered_um2_s": 0.04} | more
    return Image(np.asarray(pixels, dtype=np.float32)[..., None], ("CFA",), Quantity.ELECTRONS, provenance=facts)


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG", "RCCB", "RGIB", "MONO"])
@pytest.mark.parametrize("factor", [2, 3])
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


def test_neighbours_of_one_colour_are_added_by_hand():
    """Rows of 8 with the numbers 0 to 63: red of the first block is 0 + 2 + 16 + 18, its green neighbour 1 + 3 + 17 +
    19.
    """
    seen = sensor.binning(electrons(np.arange(64.0).reshape(8, 8))).pixels[..., 0]
    assert seen.shape == (4, 4)
    assert seen[0, 0] == 0 + 2 + 16 + 18 and seen[0, 1] == 1 + 3 + 17 + 19 and seen[1, 0] == 8 + 10 + 24 + 26
    assert seen.sum() == np.arange(64).sum()


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


def test_dark_current_and_wells_grow_with_the_pixels():
    seen = sensor.binning(electrons(np.ones((8, 8)), dark_e=3.0, full_well_e=5000.0), factor=2)
    assert (seen.provenance["dark_e"], seen.provenance["full_well_e"]) == (12.0, 20000.0)


def test_a_picture_smaller_than_a_block_is_refused():
    with pytest.raises(ImageError, match="a picture of 8 x 3 has no block of 2 x 2"):
        sensor.binning(electrons(np.ones((3, 8))))

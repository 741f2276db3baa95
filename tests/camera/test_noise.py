"""The random numbers of the sensor against their distributions, by SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from synfog_usd.base import seeds
from synfog_usd.camera import noise

COUNT = 1 << 20


def stream():
    return seeds.stream(0, "noise")


@pytest.mark.parametrize("mean", [0.0, 3.0, 63.5, 200.0])
def test_counts_are_poisson_numbers(mean):
    """Pearson's chi-squared over all counts of which ten or more are expected."""
    counts = noise.poisson(stream(), np.full((8, COUNT // 8), mean, np.float32))
    assert counts.shape == (8, COUNT // 8) and counts.dtype == np.float32
    found = np.bincount(counts.astype(int).ravel(), minlength=1)
    expected = stats.poisson.pmf(np.arange(found.size), mean) * COUNT
    many = expected >= 10.0
    found, expected = (
        np.append(found[many], found[~many].sum()),
        np.append(expected[many], COUNT - expected[many].sum()),
    )
    assert stats.chi2.sf(((found - expected) ** 2 / np.maximum(expected, 1.0)).sum(), max(found.size - 1, 1)) > 1e-3


def test_a_count_follows_its_own_mean_and_the_stream():
    """Dark and bright pixels side by side; another size of a picture begins alike; the same stream gives the same."""
    mean = np.tile(np.float32([0.0, 10.0, 100.0, 1e4]), 100_000)
    counts = noise.poisson(stream(), mean).astype(np.float64)
    for level in (0.0, 10.0, 100.0, 1e4):
        own = counts[mean == level]
        assert own.mean() == pytest.approx(level, abs=5.0 * (level / own.size) ** 0.5)
        assert own.var() == pytest.approx(level, rel=5.0 * (3.0 / own.size) ** 0.5)
    np.testing.assert_array_equal(noise.poisson(stream(), mean), counts)


def test_counts_of_one_stream_rise_together():
    """As normal numbers do: at a third of the light the noise of a bright pixel is correlated by 0.99 and more."""
    full, less = (noise.poisson(stream(), np.full(100_000, mean, np.float32)) for mean in (900.0, 300.0))
    assert np.corrcoef(full, less)[0, 1] > 0.99

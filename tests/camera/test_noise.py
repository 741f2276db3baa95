"""The random numbers of the sensor against their distributions, by SciPy's."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from scipy import stats

from synfog_usd.base import seeds
from synfog_usd.camera import noise

COUNT = 1 << 20


def stream():
    return seeds.stream(0, "noise")


def test_normal_numbers_are_normal_and_know_nothing_of_each_other():
    """Kolmogorov and Smirnov's test resolves 0.0016 of a probability; beyond 4 are 66.4 +- 8.2.  Numbers of one pair
    share a radius: their squares must not be correlated, to within 5 / sqrt(n).
    """
    drawn = noise.normal(stream(), np.zeros(COUNT, np.float32)).astype(np.float64)
    assert stats.kstest(drawn, "norm").pvalue > 1e-3
    assert abs(np.count_nonzero(np.abs(drawn) > 4.0) - 2.0 * stats.norm.sf(4.0) * COUNT) < 5.0 * 8.2
    pairs = drawn.reshape(-1, 2, noise.CHUNK // 2)
    for first, second in ((pairs[:, 0], pairs[:, 1]), (drawn[:-1], drawn[1:])):
        for power in (1, 2):
            assert abs(np.corrcoef(first.ravel() ** power, second.ravel() ** power)[0, 1]) < 5.0 / first.size**0.5


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
    np.testing.assert_array_equal(noise.normal(stream(), mean), noise.normal(stream(), mean))


def test_an_arm_processor_draws_the_same_numbers():
    """SHA-256 of what Debian's Python with NumPy 2.4 drew on aarch64, in QEMU."""
    normal = noise.normal(np.random.default_rng(3), np.zeros(100_000, np.float32))
    counts = noise.poisson(np.random.default_rng(4), np.linspace(0.0, 5000.0, 100_000, dtype=np.float32))
    assert hashlib.sha256(normal).hexdigest() == "bf2f09b0af101f64c0d1b9193428dcbde9e941cede119cf593617935442dcd0b"
    assert hashlib.sha256(counts).hexdigest() == "735bf95828a843ae8b25bdfb6d7f9b84cb2cefc53c05cad193a05bb6d1a27ff7"

"""Tests of a mean against a truth that say what they can resolve."""

from __future__ import annotations

import numpy as np
from scipy import stats


def assert_mean(means, truth, *, resolves, alpha=1e-4, truth_within=5e-6):
    """Fail unless `means` (K,), one per independent seed, are centred on `truth`.

    resolves: relative bias the test must be able to see; too noisy is a failure.
    truth_within: relative error of the truth itself and of float32, for estimators without noise.
    """
    means = np.asarray(means, dtype=np.float64)
    sem = means.std(ddof=1) / np.sqrt(means.size)
    limit = stats.t.isf(alpha / 2, means.size - 1)
    assert 2 * limit * sem <= resolves * abs(truth), f"cannot see {resolves:.1%}: error is {sem / truth:.2%}; add seeds or samples"
    distance = (means.mean() - truth) / max(sem, truth_within * abs(truth) / limit)
    assert abs(distance) <= limit, f"mean {means.mean():.6g}, truth {truth:.6g}: {distance:+.1f} standard errors (limit {limit:.1f})"

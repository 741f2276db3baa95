"""Counts of electrons that stay alike from one fog to the next: Poisson numbers that rise with normal ones.

numpy's own are drawn by rejection.  Of one stream they are as good as independent where the mean differs, so that fogs
could not have the noise of their clear frame.
"""

from __future__ import annotations

import numpy as np

from synfog_usd.base.arrays import FloatArray, at_least

SERIES_FROM = 64.0
"""Mean from which counts come from a series.  It is off by one in 3e-5 of them there, and in 4e-7 at a mean of 1000."""


def poisson(rng: np.random.Generator, mean: FloatArray) -> FloatArray:
    """Poisson numbers of each mean, float32, shape of `mean`, which is 0 to 1e15.

    Below `SERIES_FROM` numpy's, which are exact; above, the whole part of a series for the inverse of the distribution
    at a normal number.

    Source: Giles, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function", ACM
    Transactions on Mathematical Software 42 (2016), eq. 6.
    """
    means = np.asarray(mean, dtype=np.float32)
    counts = _by_series(rng.standard_normal(means.shape, dtype=np.float32), at_least(means, SERIES_FROM))
    few = means < SERIES_FROM
    counts[few] = rng.poisson(means[few])
    return counts


def _by_series(w: FloatArray, mean: FloatArray) -> FloatArray:
    """Giles's series for the inverse of the distribution with a mean m, at a normal number w, rounded down.

    m + s w + (2+w^2)/6 - (2w+w^3)/(72s) + (9w^4+21w^2-48)/(2430m),    s = sqrt(m)
    """
    s = np.sqrt(mean)
    w2 = w * w
    term = w2 * np.float32(9.0 / 2430.0)
    term += np.float32(21.0 / 2430.0)
    term *= w2
    term -= np.float32(48.0 / 2430.0)
    term /= mean
    w2 += np.float32(2.0)
    term += w2 * np.float32(1.0 / 6.0)
    w2 *= w
    w2 *= np.float32(1.0 / 72.0)
    w2 /= s
    term -= w2
    s *= w
    term += s
    term += mean
    return np.floor(term, out=term)

"""Random numbers by the million: normal ones and counts, several times as fast as numpy draws them.

By whole arrays that a processor's cache holds, so that logarithms and sines are vector code.  x86 and Arm processors
draw the same numbers.
"""

from __future__ import annotations

import math

import numpy as np

from synfog_usd.base.arrays import FloatArray, at_least

CHUNK = 1 << 14
"""Numbers that are drawn at a time; the numbers depend on it."""

SERIES_FROM = 64.0
"""Mean from which counts come from a series.  It is off by one in 3e-5 of them there, and in 4e-7 at a mean of 1000."""


def normal(rng: np.random.Generator, mean: FloatArray, sigma: float = 1.0) -> FloatArray:
    """Normal numbers around each mean, float32, shape of `mean`, up to 6.8 standard deviations `sigma` either way.

    Source: Box and Muller, "A note on the generation of random normal deviates" (1958).
    """
    means = np.ascontiguousarray(mean, dtype=np.float32).reshape(-1)
    result = np.empty_like(means)
    for begin in range(0, result.size, CHUNK):
        middle = means[begin : begin + CHUNK]
        draws = _normal(rng, middle.size)
        draws *= np.float32(sigma)
        np.add(draws, middle, out=result[begin : begin + CHUNK])
    return result.reshape(mean.shape)


def poisson(rng: np.random.Generator, mean: FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Poisson numbers of each mean, float32, shape of `mean`, which is 0 to 1e15; in `out`, where that is given, whose
    rows lie one behind the other in memory.

    Below `SERIES_FROM` numpy's, which are exact; above, the whole part of a series for the inverse of the distribution
    at a normal number.

    Source: Giles, "Algorithm 955: approximation of the inverse Poisson cumulative distribution function", ACM
    Transactions on Mathematical Software 42 (2016), eq. 6.
    """
    means = np.ascontiguousarray(mean, dtype=np.float32).reshape(-1)
    counts = np.empty_like(means) if out is None else out.reshape(-1)
    for begin in range(0, means.size, CHUNK):
        level, count = means[begin : begin + CHUNK], counts[begin : begin + CHUNK]
        few = np.flatnonzero(level < SERIES_FROM)
        if few.size < level.size:
            _by_series(_normal(rng, level.size), at_least(level, SERIES_FROM) if few.size else level, count)
        if few.size:
            count[few] = rng.poisson(level[few].astype(np.float64))
    return counts.reshape(mean.shape)


def _normal(rng: np.random.Generator, count: int) -> FloatArray:
    pairs = (count + 1) // 2
    bits = rng.bit_generator.random_raw(pairs).view(np.uint32).astype(np.float32)
    radius, angle = bits[:pairs], bits[pairs:]
    radius += np.float32(0.5)  # of 2^32, so that none is 0
    radius *= np.float32(2.0**-32)
    radius[...] = np.log(radius, dtype=np.float64)  # in float32 processors differ in the last bit
    radius *= np.float32(-2.0)
    np.sqrt(radius, out=radius)
    angle *= np.float32(2.0 * math.pi * 2.0**-32)
    across = np.cos(angle)
    across *= radius
    np.sin(angle, out=angle)
    angle *= radius
    bits[:pairs] = across
    return bits[:count]


def _by_series(w: FloatArray, mean: FloatArray, out: FloatArray) -> None:
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
    np.floor(term, out=out)

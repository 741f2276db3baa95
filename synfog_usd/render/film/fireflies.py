"""Fireflies: the few paths in fog that carry a large share of its light, and where that light goes instead.

A path that meets a surface beside a lamp is rare and very bright: at the crossing at dusk one in ten thousand carries
6 % of the light of its estimator and nine tenths of its variance.  What fog scatters to the eye is smooth, so their
light may come from further around.  Here light of a lane of paths beyond a limit is kept apart.  It is spread over its
surroundings in the shape that the other light of the lamps has in the fog there.  None is lost.  The limit grows with
the number of paths, and with it the bias vanishes.  Reference images are made without.  The denoiser sees the samples
as they are, and is judged by this light: of a firefly that was cut it leaves a speck.

Light of surfaces has edges and small bright things.  There only that counts as a firefly which one half of the samples
has, and the other has not nearby.

In kind: Zirr, Hanika and Dachsbacher 2018, "Reweighting firefly samples for improved finite-sample Monte Carlo
estimates", who keep more of the light that neighbouring pixels confirm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from synfog_usd.base.arrays import Pixels as Array
from synfog_usd.render.dualbuffer import binned, spread

TIMES = 20.0
"""Mean light of a path that a lane may bring beyond that of all its paths."""

GROWS_FROM = 16
"""Paths of a pixel from which on the limit grows, as their square root."""

WIDTHS = 8
"""Width of the picture over the standard deviation of the blur that spreads the light."""

SHAPE_PX = 1.0
"""Standard deviation [px] of the blur of the light whose shape it takes."""

NEARBY_PX = 5
"""Side [px] of the squares in which the other half may confirm what is bright."""

ROUNDS = 4
"""Times that the mean of light below its own limit is taken anew."""


def limit(level: float, count: int, paths: int) -> float:
    """Most light that a lane's paths may bring together; what is beyond is a firefly's.

    Args:
        level: mean light of a path.
        count: paths of the lane.
        paths: those that the pixel has had before.
    """
    return level * (count + TIMES * math.sqrt(max(1.0, paths / GROWS_FROM)))


def mean_below(light: Array, count: int) -> float:
    """Mean light of a path, of lanes (N,) with `count` paths each, where none brings more than its limit."""
    level = float(light.mean(dtype=np.float64)) / count
    for _ in range(ROUNDS):
        level = float(np.minimum(light, limit(level, count, 0)).mean(dtype=np.float64)) / count
    return level


def confirmed(halves: Array, weights: Array, paths: int) -> Array:
    """(2, H, W, C) light of two halves of the samples as far as it is no firefly: where a half is brighter than the
    limit and than all that the other has nearby, it keeps as much.

    Args:
        halves: (2, H, W, C), means of a half of `paths` each.
        weights: (C,) of the channels in luminance.
    """
    from scipy import ndimage

    luminance = np.maximum(halves @ np.asarray(weights, dtype=halves.dtype), 0.0)
    count = max(1, paths // 2)
    least = limit(mean_below(luminance, 1), count, paths) / count
    nearby = np.stack([ndimage.maximum_filter(other, NEARBY_PX, mode="nearest") for other in luminance[::-1]])
    return np.asarray(halves * np.minimum(np.maximum(nearby, least) / np.maximum(luminance, 1e-30), 1.0)[..., None])


def spread_out(fireflies: Array, like: Array, shape: tuple[int, int]) -> Array:
    """(P, C) the same light, wide around where it was, in the shape of other light.

    Args:
        fireflies: (P, C).
        like: (P,) other light of the same lamps, as smooth as theirs.
        shape: (H, W).
    """
    from scipy import ndimage

    sigma = shape[1] / WIDTHS
    step = max(1, int(sigma / 4))
    fine = ndimage.gaussian_filter(np.maximum(like, 0.0).reshape(shape), SHAPE_PX, mode="nearest")[..., None]
    fine += np.float32(1e-6 * fine.mean() + 1e-30)

    def wide(picture: Array) -> Array:
        blur: Sequence[float] = (sigma / step, sigma / step, 0.0)
        return ndimage.gaussian_filter(binned(picture, step), blur, mode="nearest", truncate=3.0)

    ratio = wide(fireflies.reshape(*shape, -1)) / wide(fine)
    light = np.asarray(fine * spread(ratio, step, shape), dtype=np.float32).reshape(fireflies.shape)
    before, after = (picture.sum(axis=0, dtype=np.float64) for picture in (fireflies, light))
    return light * np.where(after > 0.0, before / np.maximum(after, 1e-30), 1.0).astype(np.float32)

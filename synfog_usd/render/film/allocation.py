"""How many samples each estimator of a picture gets: more of the one whose noise they lower most for what they cost."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from synfog_usd.base.arrays import Indices
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.render.dualbuffer import mottle
from synfog_usd.render.film.accumulator import (
    CHUNK,
    HALVES,
    Accumulator,
    Traces,
    new_accumulator,
)
from synfog_usd.render.film.launches import add_samples


def accumulate_by_estimator(
    integrator: Traces, *, samples: int, seed: int, denoised: bool = False, progress: Progress = silent
) -> Accumulator:
    """Average `samples` paths through every pixel, with a box filter one pixel wide.

    Args:
        integrator: what traces them.
        samples: paths per pixel, >= 2 (one has no variance), on the average of the estimators, weighted by what they
            cost: more of the one that is noisier.
        seed: of this image; the same gives the same numbers in the same variant.
        denoised: whether it will be; then light groups are kept in squares, and rounds may be short.
        progress: told after each pass.
    """
    pixels = integrator.loaded.source.camera.width_px * integrator.loaded.source.camera.height_px
    accumulated, everywhere = new_accumulator(integrator, pixels, denoised=denoised), np.arange(pixels)
    before = 0.0
    for number in rounds(samples, denoised=denoised):
        more = more_samples(accumulated, number, denoised=denoised)
        add_samples(accumulated, integrator, everywhere, more, seed, within(progress, before, number / samples))
        before = number / samples
    return accumulated


def rounds(samples: int, *, denoised: bool = False) -> tuple[int, ...]:
    """Samples after each round of an image that gets `samples`: the first is spread evenly, and shows which estimator
    is noisy.  Of a picture that is not denoised rounds are whole runs of CHUNK, so that its variance is right.
    """
    first = min(max(samples // 4 // HALVES * HALVES, HALVES), CHUNK) if denoised else CHUNK
    return (first, samples) if samples >= (2 * HALVES if denoised else 3 * CHUNK) else (samples,)


def more_samples(
    accumulated: Accumulator, samples: float, *, denoised: bool = False, pixels: Indices | None = None
) -> dict[str, int]:
    """How many more samples each estimator gets: n ~ sqrt(variance / cost), by which a second spent on any of them
    lowers the picture's variance as much (Neyman's allocation).

    The variance is that of a pixel relative to its light; of a picture that will be denoised, that at low frequencies.

    Args:
        accumulated: the samples so far.
        samples: the budget, those so far included: what so many samples of every estimator cost.
        denoised: whether the picture will be.
        pixels: (N,) those that count; all of them where None.

    Returns:
        estimator -> samples: the same for all until there is a variance, then whole pairs or runs of CHUNK.
    """
    have = _samples_so_far(accumulated, pixels)
    if len(have) == 1 or min(have.values()) < HALVES:
        return {name: max(round(samples) - count, 0) for name, count in have.items()}
    cost = accumulated.costs()
    variances = _coarse_variances(accumulated) if denoised else _relative_variances(accumulated, pixels)
    weight = {name: max(math.sqrt(variance / cost[name]), 1e-6) for name, variance in variances.items()}
    budget = samples * sum(cost.values())
    goal = _shared_out(budget, weight, cost, have)
    missing = {name: count - have[name] for name, count in goal.items()}
    step = HALVES if denoised and samples < 3 * CHUNK else CHUNK
    more = {name: max(round(missing[name] / step) * step, 0) for name in have}
    spent = sum(cost[name] * count for name, count in have.items())
    if budget > spent and not any(more.values()):
        more[max(missing, key=missing.__getitem__)] = step
    return more


def _samples_so_far(accumulated: Accumulator, pixels: Indices | None) -> dict[str, int]:
    """Samples of each estimator in the picture's first pixel, or their median over `pixels`."""
    if pixels is None:
        return {name: int(estimator.counts[:, 0].sum()) for name, estimator in accumulated.estimators.items()}
    counts = {name: estimator.counts.sum(axis=0) for name, estimator in accumulated.estimators.items()}
    return {name: int(np.median(of_pixels[pixels])) for name, of_pixels in counts.items()}


def _shared_out(
    budget: float, weight: Mapping[str, float], cost: Mapping[str, float], have: Mapping[str, int]
) -> dict[str, float]:
    """Samples in proportion to `weight` that cost `budget` in all; no estimator gets fewer than it has."""
    fixed: set[str] = set()
    while True:
        rest = budget - sum(cost[name] * have[name] for name in fixed)
        free = [name for name in weight if name not in fixed]
        unit = max(rest, 0.0) / max(sum(cost[name] * weight[name] for name in free), 1e-30)
        over = {name for name in free if unit * weight[name] < have[name]}
        if not over:
            return {name: float(have[name]) if name in fixed else unit * weight[name] for name in weight}
        fixed |= over


def _coarse_variances(accumulated: Accumulator) -> dict[str, float]:
    """Relative variance of one sample of each estimator at low frequencies, which denoising leaves; by both halves."""
    shape = accumulated.shape
    level = np.maximum(accumulated.luminance(), 0.0).reshape(shape)
    variances = {}
    for name, estimator in accumulated.estimators.items():
        halves = accumulated.luminance_halves(name)
        variances[name] = mottle(halves, level) ** 2 * float(estimator.counts.sum(axis=0).mean())
    return variances


def _relative_variances(accumulated: Accumulator, pixels: Indices | None) -> dict[str, float]:
    """Mean relative variance of one sample of each estimator, without the noisiest hundredth of the pixels."""
    some = slice(None) if pixels is None else pixels
    level = accumulated.luminance()[some]
    scale = np.maximum(level, 0.05 * level.mean() + 1e-30)
    variances = {}
    for name, estimator in accumulated.estimators.items():
        spread = estimator.variance()[some] @ accumulated.weights * accumulated.weights.sum()
        relative = spread * estimator.counts.sum(axis=0)[some] / scale**2
        variances[name] = float(np.sort(relative)[: max(1, int(0.99 * len(relative)))].mean())
    return variances

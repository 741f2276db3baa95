"""Paths traced and added up: launches of an integrator's estimators, some under way while others are waited for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from synfog_usd.base import numbers
from synfog_usd.base.arrays import Indices, Pixels, total
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.seeds import seed32
from synfog_usd.render import backend
from synfog_usd.render.film import fireflies
from synfog_usd.render.film.accumulator import (
    CHUNK,
    ESTIMATOR_COST,
    HALF_STRIDE,
    HALVES,
    SHARE_PX,
    Accumulator,
    Estimator,
    Moments,
    Squares,
    Traces,
)

if TYPE_CHECKING:
    import numpy.typing as npt

    from synfog_usd.render.spectra.bands import SampledSpectrum

CHUNKED_LANES = 1 << 18
"""Lanes of a launch where each traces a chunk: 0.1 s between two progress reports, and sums of a few hundred MB."""

SHORT_LANES = 2 * CHUNKED_LANES
"""The same where each traces half a chunk at most: to have a kernel made ready costs 0.2 s, however little it does."""

AHEAD = 1 << 22
"""Paths that are under way at least before any are waited for: meanwhile the next estimator's kernel is made ready."""

AHEAD_LANES = 1 << 20
"""The same in lanes, each of which takes some 80 B with four light groups."""

CUDA_TIMES = 16
"""How many times more of all of these a graphics processor gets: it is done with `CHUNKED_LANES` in less time than
Python takes to describe the next ones, some 0.2 s.
"""


def add_samples(
    accumulated: Accumulator,
    integrator: Traces,
    pixels: Indices,
    samples: Mapping[str, int],
    seed: int,
    progress: Progress = silent,
) -> None:
    """Add samples to each of some pixels; to all of them where paths are those of squares.

    Args:
        pixels: (N,) their numbers, ascending.
        samples: estimator -> paths in a pixel or square; half of them, or one more, go to the first half.
    """
    accumulated.rounds.append(dict(samples))
    costs = accumulated.costs()
    whole_cost = max(len(pixels) * sum(count * costs[name] for name, count in samples.items()), 1.0)
    cost = 0.0
    for launches in _batches(_launches(accumulated, integrator, pixels, samples, seed), _times(integrator)):
        for launch in launches:  # to wait for one is to wait for all
            _add(accumulated, launch)
            cost += launch.paths * ESTIMATOR_COST[launch.name]
        progress("rendering", min(cost / whole_cost, 1.0))


def _launches(
    accumulated: Accumulator, integrator: Traces, pixels: Indices, samples: Mapping[str, int], seed: int
) -> Iterator[_Launch]:
    """Paths that `add_samples` asks for, each launch traced as soon as it is taken; arguments as there."""
    times = _times(integrator)
    for name, count in samples.items():
        estimator, estimator_seed = accumulated.estimators[name], seed32(seed, name)
        targets = list(_targets(accumulated, estimator, pixels, times * CHUNKED_LANES))
        counts = [estimator.counts[:, target.corners].copy() for target in targets]
        of_chunk = [int(half[0]) % CHUNK for half in counts[0]] if targets else [0] * HALVES
        for length, chunks in _chunks(count, sum(len(target.corners) for target in targets), of_chunk, times):
            halves = [half for half, _ in chunks]
            for target, before in zip(targets, counts, strict=True):
                numbers = np.stack([before[half] + offset for half, offset in chunks])
                lanes = np.concatenate([target.eye(number, half) for number, half in zip(numbers, halves, strict=True)])
                first = (numbers + HALF_STRIDE * np.array(halves)[:, None]).ravel()
                yield _launched(integrator, name, target, (lanes, first), length, halves, estimator_seed)


@dataclass(frozen=True)
class _Target:
    """Pixels that get the light of a launch.

    Attributes:
        pixels: (P,) ascending.
        corners: (N,) a pixel of each lane's square; `pixels` where lanes are those of pixels.
        lane_of: (P,) number of each one's lane, where lanes are those of squares.
        squares: of which they are then.
    """

    pixels: Indices
    corners: Indices
    lane_of: Indices | None = None
    squares: Squares | None = None

    @property
    def at(self) -> slice | Indices:
        """The pixels; neighbours, which are added up faster, as a slice."""
        low, high = (int(self.pixels[0]), int(self.pixels[-1]) + 1) if len(self.pixels) else (0, 0)
        return slice(low, high) if high - low == len(self.pixels) else self.pixels

    def eye(self, number: Indices, half: int) -> Indices:
        """(N,) the pixel through which each lane looks, of which path (N,) `number` of a half comes next: each pixel of
        a square in its turn.
        """
        if self.squares is None:
            return self.pixels
        squares = self.squares.of(self.corners)
        return self.squares.pixel(squares, squares + number + HALVES * half)

    def fine(self, lanes: Pixels) -> Pixels:
        """(..., P, C) of (..., N, C)."""
        return lanes if self.lane_of is None else np.take(lanes, self.lane_of, axis=-2, mode="clip")


def _targets(accumulated: Accumulator, estimator: Estimator, pixels: Indices, lanes: int) -> Iterator[_Target]:
    """Pixels, as many together as `lanes` are, or rows of squares."""
    height, width = accumulated.shape
    if estimator.opacity is None:
        yield from (_Target(some, some) for some in (pixels[low : low + lanes] for low in range(0, len(pixels), lanes)))
        return
    squares = Squares(width, height)
    rows, columns = squares.shape
    step = max(1, lanes // columns)
    for row in range(0, rows, step):
        inside = np.arange(SHARE_PX * row * width, min(SHARE_PX * (row + step), height) * width)
        some = np.arange(row * columns, min(row + step, rows) * columns)
        yield _Target(inside, squares.pixel(some, np.zeros_like(some)), squares.of(inside) - row * columns, squares)


def _batches(launches: Iterable[_Launch], times: int) -> Iterator[list[_Launch]]:
    """Launches that are under way together."""
    batch: list[_Launch] = []
    for launch in launches:
        batch.append(launch)
        many_lanes = sum(launched.lanes for launched in batch) >= times * AHEAD_LANES
        if many_lanes or sum(launched.paths for launched in batch) >= times * AHEAD:
            yield batch
            batch = []
    if batch:
        yield batch


def _times(integrator: Traces) -> int:
    """How many times `CHUNKED_LANES` are traced together: of more bands fewer, in the same memory."""
    return max(1, CUDA_TIMES * numbers.RGB // integrator.bands.count) if backend.is_cuda() else 1


def _chunks(count: int, pixels: int, of_chunk: Sequence[int], times: int) -> list[tuple[int, list[tuple[int, int]]]]:
    """How `count` paths of each of some pixels are traced: (paths a lane, [(half, paths of this call before), ...] of a
    pixel's lanes in one launch, `times` the usual number).  Each half ends the chunk first of which it has `of_chunk`
    paths, so that no lane lies in two.
    """
    by_length: dict[int, list[tuple[int, int]]] = {}
    for half in range(HALVES):
        paths, offset = (count + 1 - half) // HALVES, 0
        while offset < paths:
            length = min(CHUNK - (of_chunk[half] + offset) % CHUNK, paths - offset)
            by_length.setdefault(length, []).append((half, offset))
            offset += length
    launches = []
    for length, chunks in by_length.items():
        rows = max(1, times * (SHORT_LANES if 2 * length <= CHUNK else CHUNKED_LANES) // max(pixels, 1))
        launches += [(length, chunks[low : low + rows]) for low in range(0, len(chunks), rows)]
    return launches


@dataclass(frozen=True)
class _Launch:
    """Paths of an estimator that are being traced: `count` in each lane, lanes of each of `halves` for `target`."""

    name: str
    target: _Target
    count: int
    halves: Sequence[int]
    moments: Moments

    @property
    def lanes(self) -> int:
        """How many."""
        return len(self.target.corners) * len(self.halves)

    @property
    def paths(self) -> int:
        """Of all lanes."""
        return self.lanes * self.count


def _launched(
    integrator: Traces,
    name: str,
    target: _Target,
    lanes: tuple[Indices, Indices],
    count: int,
    halves: Sequence[int],
    seed: int,
) -> _Launch:
    """Begin it: `lanes` are the pixel of each and the number of its first path."""
    pixel, first = (backend.numbers(numbers) for numbers in lanes)
    moments = integrator.trace(name, pixel, first, count, seed)
    dr.eval(moments.aovs, moments.groups, moments.lost)  # which does not wait for it
    return _Launch(name, target, count, halves, moments)


def _add(accumulated: Accumulator, launch: _Launch) -> None:
    """Wait for paths, and add them up."""
    target, count, halves, moments = launch.target, launch.count, launch.halves, launch.moments
    estimator, at = accumulated.estimators[launch.name], launch.target.at
    opacity = None if estimator.opacity is None else estimator.opacity[at, None]

    def lanes(colour: SampledSpectrum, kind: npt.DTypeLike) -> Pixels:
        light = target.fine(backend.rows(colour, kind).reshape(len(halves), len(target.corners), -1))
        return light if opacity is None else light * opacity

    light = {
        aov: lanes(colour, estimator.aovs[aov].dtype) for aov, colour in zip(estimator.aovs, moments.aovs, strict=True)
    }
    for lane in total(light.values()):
        estimator.squares[at] += lane**2 / count
    if estimator.fireflies:
        within_limit = _within_limit(accumulated, estimator, total(light.values()), count, target.pixels)
    for aov, lit in light.items():  # chunk by chunk: the order of the sum is fixed
        for number, half in enumerate(halves):
            if estimator.fireflies:
                limited = lit[number] * within_limit[number]
                estimator.fireflies[aov][half, at] += lit[number] - limited
                estimator.aovs[aov][half, at] += limited
            else:
                estimator.aovs[aov][half, at] += lit[number]
    for sums, colour in zip(estimator.groups, moments.groups, strict=True):
        for lane in lanes(colour, sums.dtype):
            if estimator.cut:
                estimator.cut.add(sums, target.pixels, lane)
            else:
                sums[at] += lane
    if estimator.lanes is not None:
        estimator.lanes[at] += len(halves)
    for half in halves:
        estimator.counts[half, at] += count
    accumulated.lost += int(np.array(moments.lost).sum())


def _within_limit(accumulated: Accumulator, estimator: Estimator, light: Pixels, count: int, pixels: Indices) -> Pixels:
    """(lanes, P, 1) share of the light of lanes (lanes, P, C), each of `count` paths, that is no firefly."""
    luminance = np.maximum(light @ np.asarray(accumulated.weights, dtype=light.dtype), 0.0)
    level = fireflies.mean_below(luminance, count)  # of these lanes alone: a dark sky says nothing of the street below
    limit = fireflies.limit(level, count, int(estimator.counts[:, pixels[0]].sum()))
    return np.minimum(limit / np.maximum(luminance, max(limit, 1e-30)), 1.0)[..., None].astype(light.dtype)

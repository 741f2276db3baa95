"""Samples spent and counted: the mean of each pixel and how well it is known.

Rays are made here and summed in a fixed order.  Mitsuba's own film adds samples
with atomics, whose order changes from run to run; this sum does not, so the same
seed gives the same bytes.  With `FogPath` a sample's random numbers depend on its
pixel and its number alone, and samples are summed in chunks of CHUNK: how many
pixels or chunks are in flight at once makes no difference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from synfog_usd.arrays import Array, Indices
from synfog_usd.progress import Progress, silent
from synfog_usd.render import backend
from synfog_usd.render.integrators.path import AOVS, INSCATTERED, LAMPS, SURFACE, FogPath
from synfog_usd.render.load import MitsubaScene, make_sensor
from synfog_usd.render.motion import moved
from synfog_usd.seeds import seed32

LANES_PER_PASS = 1 << 21
"""Paths in flight at once; measured 0.2 GB above the scene in `volpath`."""

CHUNK = 16
"""Paths that one lane traces one after the other, and that are summed in float32."""

CHUNKED_LANES = 1 << 18
"""Lanes at once where each traces a chunk: 0.1 s between two progress reports, and sums of a few hundred MB."""

SCALAR_PASSES = 8

ALL = "all"
"""The one estimator and AOV of an integrator that tells none apart."""

ESTIMATOR_COST = {SURFACE: 1.0, LAMPS: 0.25, INSCATTERED: 1.8}
"""Seconds of a path of each estimator, relative; measured in the bench stages within a factor of two, and fixed, so that the same seed gives the same bytes."""


@dataclass
class Estimator:
    """Sums of one estimator of an image (of all of it, where an integrator has only one).

    Attributes:
        aovs: name -> (P, C) sum of the samples.
        squares: (P, C) sum of their squares.
        groups: G sums (P, C) by light group.
        counts: (P,) samples of each pixel.
    """

    aovs: dict[str, Array]
    squares: Array
    groups: list[Array]
    counts: Indices

    def number(self) -> Array:
        """(P, 1) samples, 1 at least, as the sums' type."""
        return np.maximum(self.counts, 1)[:, None].astype(self.squares.dtype)

    def mean(self) -> Array:
        """(P, C)."""
        return sum(self.aovs.values()) / self.number()

    def variance(self) -> Array:
        """(P, C) variance of the mean; infinite with fewer than two samples."""
        number = self.number()
        spread = self.squares / number
        spread -= self.mean() ** 2
        np.maximum(spread, 0.0, out=spread)
        spread /= np.maximum(number - 1.0, 1.0)
        spread[self.counts < 2] = np.inf
        return spread


@dataclass
class Accumulator:
    """An image as the sum of its estimators, each with samples of its own.

    Attributes:
        estimators: name -> sums; estimators are independent of each other.
        lost: samples that were not finite and count as zero.
        weights: (C,) of the channels in a pixel's luminance [cd m-2]; R, G and B count alike.
        radiance_cache: froxels from which the estimator INSCATTERED is looked up, or None where it is sampled pixel by pixel.
            Its `counts` are then of paths in each froxel.
    """

    estimators: dict[str, Estimator]
    lost: int = 0
    weights: Array = field(default_factory=lambda: np.full(3, 1.0 / 3.0))
    radiance_cache: Any = None

    def mean(self) -> Array:
        """(P, C) all light."""
        return sum(estimator.mean() for estimator in self.estimators.values())

    def variance(self) -> Array:
        """(P, C) variance of the mean."""
        return sum(estimator.variance() for estimator in self.estimators.values())

    def luminance(self) -> Array:
        """(P,) of all light [cd m-2], 0 at least."""
        return np.maximum(self.mean() @ self.weights, 0.0)

    def luminance_variance(self) -> Array:
        """(P,) variance of its mean, as if the channels rose and fell together, as those of one path do."""
        return np.asarray(self.variance() @ self.weights * self.weights.sum())

    def aov(self, name: str) -> Array | None:
        """(P, C) mean of an AOV, or None where the integrator does not tell it apart."""
        found = [estimator.aovs[name] / estimator.number() for estimator in self.estimators.values() if name in estimator.aovs]
        if found:
            return sum(found)
        pixels = len(next(iter(self.estimators.values())).counts)
        return None if ALL in self.estimators else np.zeros((pixels, len(self.weights)))

    def take_aov(self, name: str) -> Array | None:
        """The same, and its sums are let go."""
        mean = self.aov(name)
        for estimator in self.estimators.values():
            estimator.aovs.pop(name, None)
        return mean

    def take_group(self) -> Array:
        """(P, C) mean of the first light group that is left; its sums are let go."""
        return sum(estimator.groups.pop(0) / estimator.number() for estimator in self.estimators.values())

    @property
    def samples(self) -> int:
        """Of all estimators and pixels, and of cells."""
        own = sum(estimator.counts.sum() for name, estimator in self.estimators.items() if self.radiance_cache is None or name != INSCATTERED)
        return int(own + (self.radiance_cache.paths if self.radiance_cache is not None else 0))

    def cost(self, name: str) -> float:
        """Seconds of one more sample of an estimator, relative."""
        return self.radiance_cache.cost if self.radiance_cache is not None and name == INSCATTERED else ESTIMATOR_COST[name]

    def even(self, samples: int) -> dict[str, int]:
        """As many samples of each estimator; in the cells what costs the same, four times as many at most."""
        found = dict.fromkeys(self.estimators, samples)
        if self.radiance_cache is not None:
            found[INSCATTERED] = max(2, min(round(samples * ESTIMATOR_COST[INSCATTERED] / self.radiance_cache.cost), 4 * samples))
        return found


def accumulate(loaded: MitsubaScene, integrator: Any, *, samples: int, seed: int, progress: Progress = silent) -> Accumulator:
    """Average `samples` paths through every pixel, with a box filter one pixel wide.

    Args:
        loaded: scene and sensor.
        integrator: a Mitsuba `SamplingIntegrator`, a `FogPath`, or anything with an `accumulate` of its own.
        samples: paths per pixel, >= 2 (one has no variance).  A `FogPath` takes as many on the average of
            its estimators, weighted by what they cost: more of the estimator that is noisier.
        seed: of this image; the same gives the same numbers in the same variant.
        progress: told after each pass.
    """
    if hasattr(integrator, "accumulate"):
        return integrator.accumulate(samples=samples, seed=seed, progress=progress)
    pixels = loaded.source.camera.width_px * loaded.source.camera.height_px
    if isinstance(integrator, FogPath):
        accumulated, everywhere = new_accumulator(integrator, pixels), np.arange(pixels)
        if samples < 3 * CHUNK or len(integrator.estimators) == 1:
            add_samples(accumulated, integrator, everywhere, accumulated.even(samples), seed, progress)
            return accumulated
        first = accumulated.even(CHUNK)
        add_samples(accumulated, integrator, everywhere, first, seed, lambda what, fraction: progress(what, fraction * CHUNK / samples))
        more = {estimator: max(count - first[estimator], 0) for estimator, count in neyman_allocation(accumulated, samples).items()}
        add_samples(accumulated, integrator, everywhere, more, seed, lambda what, fraction: progress(what, (CHUNK + fraction * (samples - CHUNK)) / samples))
        return accumulated
    if backend.is_scalar():
        return _accumulate_scalar(loaded, integrator, samples, seed, progress)
    total, squares, lost, done = np.zeros((pixels, 3)), np.zeros((pixels, 3)), 0, 0
    while done < samples:
        count = min(samples - done, max(1, LANES_PER_PASS // pixels))
        summed, squared, broken = _side_by_side(loaded, integrator, count, seed32(seed, "pass", done))
        total, squares, lost, done = total + summed, squares + squared, lost + broken, done + count
        progress("rendering", done / samples)
    return undivided(total, squares, samples, lost)


def undivided(total: Array, squares: Array, samples: int, lost: int = 0) -> Accumulator:
    """An image of one estimator alone, from sums over its samples."""
    return Accumulator({ALL: Estimator({ALL: total}, squares, [], np.full(len(total), samples, dtype=np.int64))}, lost)


def neyman_allocation(accumulated: Accumulator, samples: int) -> dict[str, int]:
    """How many samples each estimator should have, in multiples of CHUNK, at the cost of `samples` of each.

    Variance per sample over cost is evened out: n ~ sqrt(variance / cost), as in
    Neyman's allocation.  Pixels count by their relative variance, the noisiest
    hundredth left out, so that one firefly decides nothing.
    """
    level = accumulated.luminance()
    scale = np.maximum(level, 0.05 * level.mean() + 1e-30)
    noise = {}
    for name, estimator in accumulated.estimators.items():
        relative = estimator.variance() @ accumulated.weights * accumulated.weights.sum() * estimator.counts / scale**2
        noise[name] = float(np.sort(relative)[: max(1, int(0.99 * len(relative)))].mean())
    weight = {name: max(np.sqrt(value / accumulated.cost(name)), 1e-6) for name, value in noise.items()}
    unit = samples * sum(ESTIMATOR_COST[name] for name in weight) / sum(accumulated.cost(name) * value for name, value in weight.items())
    return {name: max(CHUNK, round(unit * value / CHUNK) * CHUNK) for name, value in weight.items()}


def new_accumulator(integrator: FogPath, pixels: int) -> Accumulator:
    """An image of no samples yet; sums over many bands are in float32, which holds 10^4 chunks to 1e-5 and half the memory."""
    groups, bands = integrator.groups if integrator.groups > 1 else 0, integrator.bands
    shape, kind = (pixels, bands.count), np.float64 if bands.is_rgb else np.float32

    def empty(estimator: str) -> Estimator:
        aovs = {name: np.zeros(shape, dtype=kind) for name in AOVS[estimator]}
        return Estimator(aovs, np.zeros(shape, dtype=kind), [np.zeros(shape, dtype=kind) for _ in range(groups)], np.zeros(pixels, dtype=np.int64))

    return Accumulator({estimator: empty(estimator) for estimator in integrator.estimators}, weights=bands.weights, radiance_cache=integrator.radiance_cache())


def add_samples(accumulated: Accumulator, integrator: FogPath, pixels: Indices, samples: Mapping[str, int], seed: int, progress: Progress = silent) -> None:
    """Add samples to each of some pixels.

    Args:
        pixels: (N,) their numbers, ascending.
        samples: estimator -> paths a pixel, or in each cell; a pixel's samples so far must be a multiple of CHUNK.
    """
    if accumulated.radiance_cache is not None and samples.get(INSCATTERED, 0) > 0:
        own = {name: count for name, count in samples.items() if name != INSCATTERED}
        if own:
            add_samples(accumulated, integrator, pixels, own, seed, lambda what, fraction: progress(what, 0.6 * fraction))
        _read_cache(accumulated, samples[INSCATTERED], seed, lambda what, fraction: progress(what, 0.6 + 0.4 * fraction))
        return
    rows = max(1, CHUNKED_LANES // max(len(pixels), 1))  # chunks of all the pixels at once
    all_of_it, done = max(len(pixels) * sum(samples.values()), 1), 0
    for name, count in samples.items():
        full, rest = divmod(count, CHUNK)
        started, estimator_seed = accumulated.estimators[name].counts[pixels].copy(), seed32(seed, name)
        work = [(CHUNK, list(range(low, min(low + rows, full)))) for low in range(0, full, rows)] + ([(rest, [full])] if rest else [])
        for length, chunks in work:
            for low in range(0, len(pixels), CHUNKED_LANES):
                some, start = pixels[low : low + CHUNKED_LANES], started[low : low + CHUNKED_LANES]
                _add(accumulated, integrator, name, some, np.concatenate([start + index * CHUNK for index in chunks]), length, len(chunks), estimator_seed)
                done += len(some) * length * len(chunks)
                progress("rendering", done / all_of_it)


def _read_cache(accumulated: Accumulator, count: int, seed: int, progress: Progress) -> None:
    """Begin paths in the cells, and look the airlight of every pixel up anew."""
    cache, estimator = accumulated.radiance_cache, accumulated.estimators[INSCATTERED]
    before = cache.lost
    cache.add_samples(count, seed32(seed, INSCATTERED), progress)
    accumulated.lost += cache.lost - before
    rays = math.isqrt(int(np.median(accumulated.estimators[SURFACE].counts))) if SURFACE in accumulated.estimators else 1
    aovs, groups, noise = cache.airlight(rays, seed32(seed, "rays"))
    number = max(cache.count, 2)
    estimator.squares = (noise * (number - 1) + sum(aovs) ** 2) * number
    estimator.aovs = {name: aov * number for name, aov in zip(estimator.aovs, aovs, strict=True)}
    estimator.groups = [group * number for group in groups]
    estimator.counts = np.full(len(estimator.counts), number, dtype=np.int64)


def _add(accumulated: Accumulator, integrator: FogPath, name: str, pixels: Indices, first: Indices, count: int, chunks: int, seed: int) -> None:
    import drjit as dr

    moments = integrator.trace(name, backend.numbers(np.tile(pixels, chunks)), backend.numbers(first), count, seed)
    dr.eval(moments.aovs, moments.squares, moments.groups, moments.lost)
    estimator = accumulated.estimators[name]

    def add(target: Array, colour: Any) -> None:
        for lane in np.array(colour, dtype=target.dtype).T.reshape(chunks, len(pixels), -1):  # chunk by chunk: the order of the sum is fixed
            target[pixels] += lane

    for target, aov in zip(estimator.aovs.values(), moments.aovs, strict=True):
        add(target, aov)
    for target, group in zip(estimator.groups, moments.groups, strict=True):
        add(target, group)
    add(estimator.squares, moments.squares)
    estimator.counts[pixels] += count * chunks
    accumulated.lost += int(np.array(moments.lost).sum())


def _side_by_side(loaded: MitsubaScene, integrator: Any, count: int, seed: int) -> tuple[Array, Array, int]:
    """One lane a path, a contiguous run of them a pixel."""
    mi = backend.mitsuba()
    import drjit as dr

    camera = loaded.source.camera
    lanes = camera.width_px * camera.height_px * count
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), lanes)  # opaque: a literal would compile a kernel per seed
    index = dr.arange(mi.UInt32, lanes) // dr.opaque(mi.UInt32, count)
    corner = mi.Point2f(mi.Float(index % camera.width_px), mi.Float(index // camera.width_px))
    place = (corner + mi.Point2f(sampler.next_2d())) / mi.Point2f(camera.width_px, camera.height_px) + mi.Point2f(*loaded.offset)
    ray, weight = loaded.sensor.sample_ray_differential(0.0, 0.5, place, mi.Point2f(sampler.next_2d()))
    if camera.moves:
        ray = moved(ray, camera, sampler.next_1d())
    radiance, _, _ = integrator.sample(loaded.scene, sampler, ray, loaded.camera_medium, True)
    radiance = mi.Color3f(radiance * weight)
    finite = dr.all(dr.isfinite(radiance))
    radiance = dr.select(finite, radiance, 0.0)
    summed = [dr.block_sum(channel, count) for channel in radiance]
    squared = [dr.block_sum(channel * channel, count) for channel in radiance]
    lost = dr.count(~finite)
    dr.eval(summed, squared, lost)
    return np.array(summed, dtype=np.float64).T, np.array(squared, dtype=np.float64).T, int(lost[0])


def _accumulate_scalar(loaded: MitsubaScene, integrator: Any, samples: int, seed: int, progress: Progress) -> Accumulator:
    """Whole renders with seeds of their own; their scatter gives the variance.

    A thin lens off its axis is drawn as a pinhole: here Mitsuba makes the rays.
    """
    sensor = loaded.sensor if loaded.offset == (0.0, 0.0) else make_sensor(loaded.source.camera, loaded.camera_medium, pinhole=True)
    passes = min(SCALAR_PASSES, samples)
    counts = [samples // passes + (index < samples % passes) for index in range(passes)]
    images, broken = [], 0
    for index, count in enumerate(counts):
        image = np.array(integrator.render(loaded.scene, sensor, seed32(seed, "pass", index), count), dtype=np.float64)[:, :, :3]
        broken += int(np.count_nonzero(~np.isfinite(image).all(axis=2)))
        images.append(np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0).reshape(-1, 3))
        progress("rendering", (index + 1) / passes)
    weights = np.array(counts, dtype=np.float64)[:, None, None] / samples
    stack = np.stack(images)
    mean = (weights * stack).sum(axis=0)
    variance = (weights * (stack - mean) ** 2).sum(axis=0) / (passes - 1)
    return undivided(mean * samples, (variance * (samples - 1) + mean**2) * samples, samples, broken)

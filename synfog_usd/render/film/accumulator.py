"""Samples spent and counted: the mean of each pixel and how well it is known.

Samples are summed in a fixed order.  Mitsuba's own film adds samples
with atomics, whose order changes from run to run; this sum does not, so the same
seed gives the same bytes.  With our path tracers a sample's random numbers depend on its
pixel and its number alone, and samples are summed in chunks of CHUNK: how many
pixels or chunks are in flight together makes no difference but to where a firefly begins (`fireflies`).

Samples go to two halves in turn, with random numbers of their own: two pictures that know
nothing of each other, from which `dualbuffer` tells what denoising leaves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import drjit as dr
import numpy as np

from synfog_usd.base import numbers
from synfog_usd.base.arrays import FloatArray, Indices, Pixels, total
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.base.seeds import seed32
from synfog_usd.render import backend
from synfog_usd.render.dualbuffer import mottle
from synfog_usd.render.film import fireflies
from synfog_usd.render.load import MitsubaScene

if TYPE_CHECKING:
    import numpy.typing as npt
    from drjit.auto.ad import UInt32

    from synfog_usd.render.spectra.bands import Bands, SampledSpectrum

CHUNK = 16
"""Paths that one lane traces one after the other, and that are summed in float32."""

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

HALVES = 2

HALF_STRIDE = 1 << 30
"""Paths of the second half are numbered from here on: never reached by those of the first."""

ALL = "all"
"""The one estimator and AOV of an integrator that tells none apart."""

SURFACE, INSCATTERED = "surface", "air"
"""Two estimators of what the eye sees: surfaces through the fog, and in-scattered radiance; of all light but lamps'.
Their words seed streams of random numbers: another word would be another picture."""

LAMPS, SURFACE_OF_LAMPS, INSCATTERED_OF_LAMPS = "lamps", "surface_of_lamps", "air_of_lamps"
"""Three estimators of lamps' light: scattered once into the line of sight; on surfaces; all else that is in-scattered.
"""

SINGLE, MULTIPLE = "airlight_single", "airlight_multiple"

DIRECT = "lamps_direct"
"""Faces of lamps as the eye sees them, an estimator and an AOV of its own; it is not part of `SURFACE`."""

LIT = "surface_lit"
"""Lamps' light on the first surface, where many lamps are drawn by importance; it adds to the AOV of `SURFACE`.  Images
of lamps in paint and glass are smaller than a pixel: it takes many eye rays, and a short path each."""

COMPONENTS = (SURFACE, SINGLE, MULTIPLE, DIRECT)
"""AOVs that add up to the picture; the last is there only where lamps' faces are seen."""

AOVS = {
    SURFACE: (SURFACE,),
    LIT: (SURFACE,),
    LAMPS: (SINGLE,),
    INSCATTERED: (SINGLE, MULTIPLE),
    SURFACE_OF_LAMPS: (SURFACE,),
    INSCATTERED_OF_LAMPS: (SINGLE, MULTIPLE),
    DIRECT: (DIRECT,),
}
"""Which AOVs each estimator adds to."""

WITH_FIREFLIES = (INSCATTERED_OF_LAMPS,)
"""Estimators whose fireflies are kept apart in a picture that will be denoised, see `fireflies`."""

ON_SURFACES = (SURFACE, SURFACE_OF_LAMPS)
"""Estimators whose fireflies are what one half of the samples has and the other has not."""

ESTIMATOR_COST = {
    SURFACE: 1.0,
    INSCATTERED: 1.2,
    SURFACE_OF_LAMPS: 3.0,
    INSCATTERED_OF_LAMPS: 4.0,
    LIT: 0.4,
    LAMPS: 0.25,
    DIRECT: 0.03,
}
"""Seconds of a path of each estimator, relative; measured at dusk within a factor of 2 (motorway, residential street,
crossing), and fixed, so that the same seed gives the same bytes."""

SHARE_PX = 2
"""Side [px] of the squares in which light groups are kept and denoised, and airlight of few samples is sampled."""

IN_SQUARES = (INSCATTERED, INSCATTERED_OF_LAMPS)
"""Estimators whose paths may be those of a square.  Light that the fog scatters, over its opacity, is smooth: it needs
paths by area, and a pixel of a large picture has paths of its own to no use."""


@dataclass(frozen=True)
class Squares:
    """A picture cut into squares of `SHARE_PX`, those at its right and lower border smaller; numbered as pixels are.

    Attributes:
        width, height: of the picture [px].
    """

    width: int
    height: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of squares."""
        return -(-self.height // SHARE_PX), -(-self.width // SHARE_PX)

    def of(self, pixels: Indices) -> Indices:
        """(N,) squares in which pixels (N,) are."""
        return pixels // self.width // SHARE_PX * self.shape[1] + pixels % self.width // SHARE_PX

    def pixel(self, squares: Indices, turn: Indices) -> Indices:
        """(N,) a pixel of each of some squares (N,): of `turn` 0 and 2, 1 and 3 those that face each other."""
        row, column = np.divmod(squares, self.shape[1])
        row, column = SHARE_PX * row + turn % 4 // 2, SHARE_PX * column + (turn + 1) % 4 // 2
        return np.asarray(np.minimum(row, self.height - 1) * self.width + np.minimum(column, self.width - 1))

    def add(self, target: Pixels, pixels: Indices, values: Pixels) -> None:
        """Add (N, C) values of pixels (N,) to the sums (S, C) of their squares."""
        squares = self.of(pixels)
        low = int(squares.min(initial=0))
        squares -= low
        for channel in range(values.shape[1]):
            sums = np.bincount(squares, weights=values[:, channel])
            target[low : low + len(sums), channel] += sums.astype(target.dtype)

    def sums(self, values: Pixels) -> Pixels:
        """(S, C) of values (P, C) of all pixels."""
        sums = np.zeros((math.prod(self.shape), values.shape[1]), dtype=values.dtype)
        self.add(sums, np.arange(len(values)), values)
        return sums


@dataclass(frozen=True)
class Moments:
    """Sums over the paths of each lane.

    Attributes:
        aovs: light in all bands (R, G and B, or more) for each of the estimator's `AOVS`.
        groups: light by light group; empty where there is only one.
        lost: paths that were not finite and count as zero.
    """

    aovs: tuple[SampledSpectrum, ...]
    groups: tuple[SampledSpectrum, ...]
    lost: UInt32


class Integrator(Protocol):
    """A model, ready to render one scene."""

    def accumulate(self, *, samples: int, seed: int, progress: Progress = silent) -> Accumulator:
        """An image of `samples` >= 2 paths per pixel; the same seed gives the same numbers in the same variant."""


@runtime_checkable
class Traces(Integrator, Protocol):
    """An integrator whose estimators can be given samples of their own.

    Attributes:
        loaded: scene and sensor.
        estimators: their names.
        group_names: the light groups.
        bands: what a path carries.
    """

    loaded: MitsubaScene
    estimators: tuple[str, ...]
    group_names: tuple[str, ...]
    bands: Bands

    def trace(
        self, estimator: str, pixel: UInt32, first: UInt32, count: int, seed: int, *, over_opacity: bool = False
    ) -> Moments:
        """`count` paths of an estimator in each lane; (N,) `pixel`, and (N,) `first` the number of a lane's first
        path.  `over_opacity`: light of `IN_SQUARES` over the opacity of the fog before what a path sees.
        """


@dataclass
class Estimator:
    """Sums of one estimator of an image (of all of it, where an integrator has only one).

    Attributes:
        aovs: name -> (H, P, C) sum of the samples in each half; H is 1 where they are not kept apart.
        squares: (P, C) sum over lanes of the square of their sum, over their samples; a lane is one sample where
            samples are independent one by one.
        groups: G sums (P, C) by light group; (S, C) in squares.
        counts: (H, P) samples of each half of each pixel.
        lanes: (P,) of each pixel; None where they are as many as the samples.
        cut: the squares in which groups are kept, or None.
        opacity: (P,) of the fog before what each pixel shows, where paths are those of a square and `counts` as well;
            None where each pixel has paths of its own.
        fireflies: name -> (H, P, C) what lanes brought beyond their limit; empty where there is none.
    """

    aovs: dict[str, Pixels]
    squares: Pixels
    groups: list[Pixels]
    counts: Pixels
    lanes: Pixels | None = None
    cut: Squares | None = None
    opacity: FloatArray | None = None
    fireflies: dict[str, Pixels] = field(default_factory=dict)

    def number(self) -> Pixels:
        """(P, 1) samples, 1 at least, as the type of `squares`."""
        return np.maximum(self.counts.sum(axis=0), 1)[:, None].astype(self.squares.dtype)

    def total(self, name: str) -> Pixels:
        """(P, C) sum of an AOV over both halves, fireflies and all, as the type of `squares`."""
        sums = self.aovs[name].sum(axis=0, dtype=self.squares.dtype)
        if name in self.fireflies:
            sums += self.fireflies[name].sum(axis=0, dtype=self.squares.dtype)
        return sums

    def mean(self) -> Pixels:
        """(P, C)."""
        return total(self.total(name) for name in self.aovs) / self.number()

    def group(self, index: int, cut: Squares | None) -> Pixels:
        """Mean of a light group, (P, C), or (S, C) where it is kept or asked for in squares."""
        sums, number = self.groups[index], self.number()
        if cut and not self.cut:
            sums = cut.sums(sums)
        return np.asarray(sums / (cut.sums(number) if cut else number))

    def variance(self) -> Pixels:
        """(P, C) variance of the mean; infinite with fewer than two samples.

        Samples of a lane are stratified (`sampling.sobol`), so their scatter is larger than their error.  The scatter
        of lanes is right where each is a run of its own, and else a little too large.
        """
        number, square = self.number(), self.mean() ** 2
        draws = number if self.lanes is None else self.lanes[:, None]
        spread = self.squares / number
        spread -= square
        np.maximum(spread, 0.0, out=spread)
        spread /= np.maximum(draws - 1.0, 1.0).astype(spread.dtype)
        spread[self.counts.sum(axis=0) < 2] = np.inf
        return spread


@dataclass
class Accumulator:
    """An image as the sum of its estimators, each with samples of its own.

    Attributes:
        estimators: name -> sums; estimators are independent of each other.
        lost: samples that were not finite and count as zero.
        shape: (H, W) of the picture.
        weights: (C,) of the channels in a pixel's luminance [cd m-2]; R, G and B count alike.
        rounds: of `add_samples`: estimator -> samples of a pixel.
    """

    estimators: dict[str, Estimator]
    lost: int = 0
    shape: tuple[int, int] = (0, 0)
    weights: Pixels = field(default_factory=lambda: np.full(3, 1.0 / 3.0))
    rounds: list[dict[str, int]] = field(default_factory=list)

    def mean(self) -> Pixels:
        """(P, C) all light."""
        return total(estimator.mean() for estimator in self.estimators.values())

    def variance(self) -> Pixels:
        """(P, C) variance of the mean."""
        return total(estimator.variance() for estimator in self.estimators.values())

    def luminance(self) -> Pixels:
        """(P,) of all light [cd m-2], 0 at least."""
        return np.maximum(self.mean() @ self.weights, 0.0)

    def coarse_variance(self) -> Pixels:
        """(P,) the same of pixels that would give sums the variance that they have if each had noise of its own."""
        parts = self.estimators.values()
        variance = total(part.variance() * (1 if part.opacity is None else SHARE_PX**2) for part in parts)
        return np.asarray(variance @ self.weights * self.weights.sum())

    def luminance_variance(self) -> Pixels:
        """(P,) variance of its mean, as if the channels rose and fell together, as those of one path do."""
        return np.asarray(self.variance() @ self.weights * self.weights.sum())

    def aov(self, name: str) -> Pixels | None:
        """(P, C) mean of an AOV, or None where the integrator does not tell it apart."""
        means = [
            estimator.total(name) / estimator.number()
            for estimator in self.estimators.values()
            if name in estimator.aovs
        ]
        if means:
            return total(means)
        return None if ALL in self.estimators or name == DIRECT else np.zeros((self.pixels, len(self.weights)))

    def halves(self, component: str) -> FloatArray:
        """(2, H, W, C) mean of one of `component_names` in each half; fireflies spread out."""
        halves = np.zeros((HALVES, self.pixels, len(self.weights)), dtype=np.float32)
        for name, estimator in self.estimators.items():
            for aov, sums in estimator.aovs.items():
                if component == (LIT if name == LIT else aov):
                    number = np.maximum(estimator.counts, 1)[:, :, None].astype(np.float32)
                    light = np.asarray(sums / number, dtype=np.float32)
                    halves += self._without_fireflies(name, light) if name in ON_SURFACES else light
                    if aov in estimator.fireflies:
                        halves += self._spread_out(name, estimator.fireflies[aov] / number)
        return halves.reshape(HALVES, *self.shape, -1)

    def _without_fireflies(self, name: str, light: FloatArray) -> FloatArray:
        """(2, P, C) light of an estimator of surfaces, of which one half alone has what is spread out."""
        paths = int(self.estimators[name].counts[:, 0].sum())
        kept = fireflies.confirmed(light.reshape(HALVES, *self.shape, -1), self.weights, paths).reshape(light.shape)
        weights = np.asarray(self.weights, dtype=np.float32)
        wide = [
            fireflies.spread_out(half, more @ weights, self.shape)
            for half, more in zip(light - kept, kept, strict=True)
        ]
        return kept + np.stack(wide)

    def _spread_out(self, name: str, light: Pixels) -> FloatArray:
        """(2, P, C) fireflies of an estimator, in the shape of all light of its lamps that the fog scatters."""
        like = self._smooth(name)
        if LAMPS in self.estimators:
            like += self._smooth(LAMPS)
        return np.stack([fireflies.spread_out(*half, self.shape) for half in zip(light, like, strict=True)])

    def _smooth(self, name: str) -> FloatArray:
        """(2, P) luminance of an estimator in each half, without its fireflies."""
        estimator, weights = self.estimators[name], np.asarray(self.weights, dtype=np.float32)
        number = np.maximum(estimator.counts, 1).astype(np.float32)
        return np.asarray(total(sums @ weights for sums in estimator.aovs.values()) / number)

    def luminance_halves(self, *names: str) -> FloatArray:
        """(2, H, W) luminance of some estimators' light in each half; of all where none is named."""
        halves = np.zeros((HALVES, self.pixels), dtype=np.float32)
        weights = np.asarray(self.weights, dtype=np.float32)
        for name in names or self.estimators:
            halves += self._smooth(name)
            estimator = self.estimators[name]
            if estimator.fireflies:
                number = np.maximum(estimator.counts, 1)[:, :, None].astype(np.float32)
                halves += self._spread_out(name, total(estimator.fireflies.values()) / number) @ weights
        return halves.reshape(HALVES, *self.shape)

    @property
    def component_names(self) -> tuple[str, ...]:
        """`COMPONENTS`, and `LIT` apart from the surfaces' other light; empty where halves are not kept apart."""
        if ALL in self.estimators:
            return ()
        return tuple(name for name in (LIT, *COMPONENTS) if name not in (LIT, DIRECT) or name in self.estimators)

    @property
    def pixels(self) -> int:
        """P."""
        return next(iter(self.estimators.values())).counts.shape[1]

    def group(self, index: int) -> Pixels:
        """(P, C) mean of a light group."""
        return total(estimator.group(index, None) for estimator in self.estimators.values())

    def group_in_squares(self, index: int) -> dict[str, Pixels]:
        """(h, w, C) mean of a light group by estimator, in squares; of DIRECT, which needs no denoising, (H, W, C)."""
        height, width = self.shape
        cut = Squares(width, height)
        return {
            name: estimator.group(index, None).reshape(height, width, -1)
            if name == DIRECT
            else estimator.group(index, cut).reshape(*cut.shape, -1)
            for name, estimator in self.estimators.items()
        }

    @property
    def samples(self) -> int:
        """Of all estimators and pixels."""
        return int(sum(estimator.counts.sum() for estimator in self.estimators.values()))

    @property
    def samples_per_pixel(self) -> float:
        """Mean over the estimators, weighted by what a sample costs: as many samples of each cost the same."""
        return self._mean_cost({name: float(part.counts.sum(axis=0).mean()) for name, part in self.estimators.items()})

    def samples_of(self, pixels: Indices) -> float:
        """The same, of the median one of some pixels (N,)."""
        counts = {name: part.counts.sum(axis=0)[pixels] for name, part in self.estimators.items()}
        return self._mean_cost({name: float(np.median(count)) for name, count in counts.items()})

    def _mean_cost(self, counts: Mapping[str, float]) -> float:
        cost = self.costs()
        return sum(cost[name] * count for name, count in counts.items()) / sum(cost.values())

    def costs(self) -> dict[str, float]:
        """Seconds of a path in each pixel or square, for each estimator: relative, by pixel."""
        return {
            name: ESTIMATOR_COST.get(name, 1.0) / (1 if part.opacity is None else SHARE_PX**2)
            for name, part in self.estimators.items()
        }

    def even(self, samples: int) -> dict[str, int]:
        """As many samples of each estimator."""
        return dict.fromkeys(self.estimators, samples)


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
        more = allocation(accumulated, number, denoised=denoised)
        add_samples(accumulated, integrator, everywhere, more, seed, within(progress, before, number / samples))
        before = number / samples
    return accumulated


def rounds(samples: int, *, denoised: bool = False) -> tuple[int, ...]:
    """Samples after each round of an image that gets `samples`: the first is spread evenly, and shows which estimator
    is noisy.  Of a picture that is not denoised rounds are whole runs of CHUNK, so that its variance is right.
    """
    first = min(max(samples // 4 // HALVES * HALVES, HALVES), CHUNK) if denoised else CHUNK
    return (first, samples) if samples >= (2 * HALVES if denoised else 3 * CHUNK) else (samples,)


def undivided(total: Pixels, squares: Pixels, samples: int, lost: int = 0) -> Accumulator:
    """An image of one estimator alone, from sums over its samples."""
    return Accumulator(
        {ALL: Estimator({ALL: total[None]}, squares, [], np.full((1, len(total)), samples, dtype=np.int64))}, lost
    )


def allocation(
    accumulated: Accumulator, samples: float, *, denoised: bool = False, pixels: Indices | None = None
) -> dict[str, int]:
    """How many more samples each estimator should get, at the cost of `samples` of each in all.

    n ~ sqrt(variance / cost) evens out variance per second (Neyman's allocation).  Pixels count by their relative
    variance, the noisiest hundredth left out, so that no single firefly decides; what will be denoised counts by its
    variance at low frequencies.  The first samples are spread evenly,
    and later ones come in whole pairs or runs of CHUNK.

    Args:
        pixels: (N,) those that count; all of them where None.
    """
    have = {name: int(estimator.counts[:, 0].sum()) for name, estimator in accumulated.estimators.items()}
    if pixels is not None:
        have = {name: int(np.median(e.counts.sum(axis=0)[pixels])) for name, e in accumulated.estimators.items()}
    if len(have) == 1 or min(have.values()) < HALVES:
        return {name: max(round(samples) - count, 0) for name, count in have.items()}
    cost = accumulated.costs()
    weight = {
        name: max(math.sqrt(value / cost[name]), 1e-6)
        for name, value in (
            _coarse_variances(accumulated) if denoised else _relative_variances(accumulated, pixels)
        ).items()
    }
    budget = samples * sum(cost.values())
    spent = sum(cost[name] * count for name, count in have.items())
    share = _filled(weight, cost, have, budget)
    step = HALVES if denoised and samples < 3 * CHUNK else CHUNK
    more = {name: max(round((share[name] - count) / step) * step, 0) for name, count in have.items()}
    if budget > spent and not any(more.values()):
        more[max(share, key=lambda name: share[name] - have[name])] = step
    return more


def _filled(
    weight: Mapping[str, float], cost: Mapping[str, float], have: Mapping[str, int], budget: float
) -> dict[str, float]:
    """Samples in proportion to `weight`, none fewer than there are, that cost `budget` in all."""
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


def new_accumulator(
    integrator: Traces, pixels: int, *, denoised: bool = False, opacity: FloatArray | None = None
) -> Accumulator:
    """An image of no samples yet.

    Sums are in float32, which holds 10^4 chunks to 1e-5 in half the memory; so a standard error below 3e-4 of the light
    is not resolved.

    Args:
        denoised: whether it will be: then light groups are kept in squares, but for those of DIRECT, and fireflies
            apart.
        opacity: (P,) see `Estimator`, for paths in squares; None for paths in each pixel.
    """
    groups, bands = len(integrator.group_names), integrator.bands
    groups = groups if groups > 1 else 0
    shape, camera = (pixels, bands.count), integrator.loaded.source.camera

    def empty(estimator: str) -> Estimator:
        cut = Squares(camera.width_px, camera.height_px) if denoised and groups and estimator != DIRECT else None
        lit = (math.prod(cut.shape), bands.count) if cut else shape
        apart = denoised and estimator in WITH_FIREFLIES
        return Estimator(
            {name: np.zeros((HALVES, *shape), dtype=np.float32) for name in AOVS[estimator]},
            np.zeros(shape, dtype=np.float32),
            [np.zeros(lit, dtype=np.float32) for _ in range(groups)],
            np.zeros((HALVES, pixels), dtype=np.int32),
            np.zeros(pixels, dtype=np.int32),
            cut,
            opacity if estimator in IN_SQUARES else None,
            {name: np.zeros((HALVES, *shape), dtype=np.float32) for name in AOVS[estimator]} if apart else {},
        )

    return Accumulator(
        {estimator: empty(estimator) for estimator in integrator.estimators},
        shape=(camera.height_px, camera.width_px),
        weights=bands.weights,
    )


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
        return lanes if self.lane_of is None else lanes[..., self.lane_of, :]


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
    moments = integrator.trace(name, pixel, first, count, seed, over_opacity=target.squares is not None)
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

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
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from synfog_usd.base.arrays import FloatArray, Indices, Pixels, total
from synfog_usd.base.progress import Progress, silent
from synfog_usd.render.film import fireflies
from synfog_usd.render.load import MitsubaScene

if TYPE_CHECKING:
    from drjit.auto.ad import UInt32

    from synfog_usd.render.spectra.bands import Bands, SampledSpectrum

CHUNK = 16
"""Paths that one lane traces one after the other, and that are summed in float32."""

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
    SURFACE_OF_LAMPS: 1.6,
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
        """(N,) a pixel of each of some squares (N,).  Those of `turn` 0 and 2 touch at a corner, as do 1 and 3."""
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

    def over_mean(self, values: FloatArray) -> FloatArray:
        """(P,) values >= 0 of all pixels over the mean of their squares, 1 where that is 0."""
        both = np.stack([values, np.ones_like(values)], axis=1).astype(np.float64)
        total, count = self.sums(both)[self.of(np.arange(len(values)))].T
        return np.where(total > 0.0, values * count / np.maximum(total, 1e-30), 1.0).astype(np.float32)


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

    def trace(self, estimator: str, pixel: UInt32, first: UInt32, count: int, seed: int) -> Moments:
        """`count` paths of an estimator in each lane; (N,) `pixel`, and (N,) `first` the number of a lane's first
        path.
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
        opacity: (P,) of the fog before what each pixel shows, over the mean of its square, where paths are those of a
            square and `counts` as well; None where each pixel has paths of its own.
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

    def noise(self) -> tuple[FloatArray, FloatArray]:
        """What both halves differ in.  First the variance of the mean luminance, (H, W), as if each pixel had noise of
        its own; then half of the difference of fireflies, spread out, (H, W).
        """
        variance, wide = np.zeros((2, self.pixels), dtype=np.float32)
        for name, part in self.estimators.items():
            kept, spread = (np.subtract(*halves) / HALVES for halves in self._luminance_of(name))
            variance += kept**2 * (1 if part.opacity is None else SHARE_PX**2)
            wide += spread
        return variance.reshape(self.shape), wide.reshape(self.shape)

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

    def halves(self, component: str) -> tuple[FloatArray, FloatArray]:
        """Mean of one of `component_names` in each half, (2, H, W, C): as it was sampled, and with fireflies spread
        out.
        """
        sampled, spread = np.zeros((2, HALVES, self.pixels, len(self.weights)), dtype=np.float32)
        for name, estimator in self.estimators.items():
            for aov, sums in estimator.aovs.items():
                if component == (LIT if name == LIT else aov):
                    number = np.maximum(estimator.counts, 1)[:, :, None].astype(np.float32)
                    light = np.asarray(sums / number, dtype=np.float32)
                    kept = self._kept(name, light) if name in ON_SURFACES else light
                    sampled += light
                    spread += kept
                    if aov in estimator.fireflies:
                        beyond = estimator.fireflies[aov] / number
                        sampled += beyond
                        spread += self._spread_out(name, beyond)
                    elif kept is not light:
                        spread += self._spread_out(name, light - kept)
        height, width = self.shape
        return sampled.reshape(HALVES, height, width, -1), spread.reshape(HALVES, height, width, -1)

    def _kept(self, name: str, light: FloatArray) -> FloatArray:
        """What is no firefly of light of surfaces (2, P, C), or of its luminance (2, P, 1)."""
        paths, channels = int(self.estimators[name].counts[:, 0].sum()), light.shape[-1]
        weights = np.asarray(self.weights if channels > 1 else [1.0], dtype=np.float32)
        return fireflies.confirmed(light.reshape(HALVES, *self.shape, channels), weights, paths).reshape(light.shape)

    def _spread_out(self, name: str, light: Pixels) -> FloatArray:
        """(2, P, C) fireflies of an estimator: in fog in the shape of all light of its lamps that is scattered there,
        on surfaces in that of its other light.
        """
        like = self._smooth(name)
        if name in ON_SURFACES:
            like = self._kept(name, like[..., None])[..., 0]
        elif LAMPS in self.estimators:
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
        for name in names or self.estimators:
            for part in self._luminance_of(name):
                halves += part
        return halves.reshape(HALVES, *self.shape)

    def _luminance_of(self, name: str) -> tuple[FloatArray, FloatArray]:
        """(2, P) luminance of an estimator in each half without its fireflies, and that of these, spread out."""
        estimator, light = self.estimators[name], self._smooth(name)
        if name in ON_SURFACES:
            kept = self._kept(name, light[..., None])
            return kept[..., 0], self._spread_out(name, light[..., None] - kept)[..., 0]
        if not estimator.fireflies:
            return light, np.zeros_like(light)
        number = np.maximum(estimator.counts, 1)[:, :, None].astype(np.float32)
        wide = self._spread_out(name, total(estimator.fireflies.values()) / number)
        return light, wide @ np.asarray(self.weights, dtype=np.float32)

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


def undivided(total: Pixels, squares: Pixels, samples: int, lost: int = 0) -> Accumulator:
    """An image of one estimator alone, from sums over its samples."""
    return Accumulator(
        {ALL: Estimator({ALL: total[None]}, squares, [], np.full((1, len(total)), samples, dtype=np.int64))}, lost
    )


def new_accumulator(
    integrator: Traces, pixels: int, *, denoised: bool = False, opacity: FloatArray | None = None
) -> Accumulator:
    """An image of no samples yet.

    Sums are in float32, which holds 10^4 chunks to 1e-5 in half the memory; so a standard error below 3e-4 of the light
    is not resolved.

    Args:
        denoised: whether it will be: then light groups are kept in squares, but for those of DIRECT, and fireflies
            apart.
        opacity: (P,) of the fog before what each pixel shows, for paths in squares; None for paths in each pixel.
    """
    groups, bands = len(integrator.group_names), integrator.bands
    groups = groups if groups > 1 else 0
    shape, camera = (pixels, bands.count), integrator.loaded.source.camera
    over_mean = None if opacity is None else Squares(camera.width_px, camera.height_px).over_mean(opacity)

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
            over_mean if estimator in IN_SQUARES else None,
            {name: np.zeros((HALVES, *shape), dtype=np.float32) for name in AOVS[estimator]} if apart else {},
        )

    return Accumulator(
        {estimator: empty(estimator) for estimator in integrator.estimators},
        shape=(camera.height_px, camera.width_px),
        weights=bands.weights,
    )

"""A picture of things that move while the camera exposes, moment by moment.

Mitsuba's shapes stand still (3.9).  So the exposure is cut into even parts, and the scene is drawn as it stands in the
middle of each: by rows that expose then, with samples of their own, and with all that moves put to its place in the
scene that is loaded.  The mean over the parts, each by its share of a row's exposure, is the picture.  The camera's own
motion goes on within a part (see `motion`).  Each part costs a search tree, guides of the denoiser and an integrator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array, Flags, Pixels, total
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.base.seeds import seed32
from synfog_usd.render import backend
from synfog_usd.render.denoise import Guides, guides
from synfog_usd.render.film.accumulator import (
    ALL,
    Accumulator,
    Estimator,
    Integrator,
    Traces,
    new_accumulator,
)
from synfog_usd.render.film.launches import add_samples
from synfog_usd.render.lights import photometric
from synfog_usd.render.load import MitsubaScene
from synfog_usd.scene import Camera, SceneDict

STEP_PX = 1.0
"""Way of what moves fastest in the picture from one part of the exposure to the next, where samples allow."""

STILL_PX = 0.05
"""Way in the whole exposure below which nothing is seen of it."""

MOST = 256
"""Parts of an exposure."""

LEAST = 2
"""Samples of a pixel in a part, one for each half."""

WARNED_PX = 3.0
"""Way from part to part from which on a warning is given."""


@dataclass(frozen=True)
class Interval:
    """A part of the exposure.

    Attributes:
        begin, end: of the time from the first row's beginning to the last row's end, 0 to 1.
        share: (H,) of each row's exposure that lies in it.
    """

    begin: float
    end: float
    share: Array


@dataclass(frozen=True)
class Intervals:
    """How an exposure is cut.

    Attributes:
        parts: in order.
        samples: of a pixel in each part that its row exposes in.
        way_px: what moves fastest goes in the whole exposure [px].
    """

    parts: tuple[Interval, ...]
    samples: int
    way_px: float

    def warnings(self) -> list[str]:
        """What a user should know."""
        step = self.way_px / len(self.parts)
        if step <= WARNED_PX:
            return []
        return [
            f"things move by up to {step:.1f} pixels from one of {len(self.parts)} moments of the exposure to the "
            f"next; more samples give more moments"
        ]


def cut(source: SceneDict, samples: int) -> Intervals | None:
    """The parts of a scene's exposure, or None where nothing is seen to move.

    Args:
        source: what is drawn.
        samples: of a pixel, in all parts together; a few more where they are fewer than two for each part.
    """
    way = _way_px(source)
    if way < STILL_PX:
        return None
    camera = source.camera
    first, last = camera.exposed(0.0)[0], camera.exposed(1.0)[1]
    longest, whole = last - camera.exposed(1.0)[0], last - first  # of the bottom row, and of all of them
    way *= whole
    most = samples // LEAST if longest == whole else math.floor((samples // LEAST - 2) * whole / longest)
    count = max(2, min(math.ceil(way / STEP_PX), most, MOST))
    begins, ends = camera.exposed((np.arange(camera.height_px) + 0.5) / camera.height_px)
    intervals = []
    for number in range(count):
        begin, end = (first + whole * edge / count for edge in (number, number + 1))
        share = np.minimum(ends, end) - np.maximum(begins, begin)
        intervals.append(Interval(begin, end, np.maximum(share, 0.0) / (ends - begins)))
    busiest = int(total((part.share > 0.0).astype(int) for part in intervals).max())
    return Intervals(tuple(intervals), max(LEAST, samples // busiest // LEAST * LEAST), way)


def _way_px(source: SceneDict) -> float:
    """The longest way in the picture [px] of a corner of a box around what moves, as long as it is seen."""
    longest = 0.0
    for key, ways in source.motion_of.items():
        part = source.world.get(key)
        if part is None:
            continue
        for way, corners in zip(ways, _boxes(part, len(ways)), strict=True):
            if corners is None:
                continue
            there = np.einsum("kij,cj->kci", way, np.c_[corners, np.ones(len(corners))])[..., :3]
            place, ahead = _projected(there, source.camera)
            steps = np.linalg.norm(np.diff(place, axis=0), axis=2) * (ahead[1:] & ahead[:-1])
            longest = max(longest, float(steps.sum(axis=0).max()))
    return longest


def _boxes(part: Mapping[str, Any], ways: int) -> list[Array | None]:
    """(8, 3) corners of the box around what goes each way; a point where the part has a place and no size."""
    if "positions" not in part:
        if "center" in part:
            centre, reach = np.asarray(part["center"], dtype=np.float64), float(part["radius"])
            return [_corners(centre - reach, centre + reach)]
        if "to_world" not in part:
            return [np.asarray(part["position"], dtype=np.float64)[None]] if "position" in part else [None]
        matrix = np.asarray(part["to_world"], dtype=np.float64)
        reach = np.abs(matrix[:3, :3]).sum(axis=1)
        return [_corners(matrix[:3, 3] - reach, matrix[:3, 3] + reach)]
    positions = np.asarray(part["positions"], dtype=np.float64)
    which = part.get("motion")
    boxes: list[Array | None] = []
    for number in range(ways):
        points = positions if which is None else positions[np.asarray(which) == number]
        boxes.append(_corners(points.min(axis=0), points.max(axis=0)) if len(points) else None)
    return boxes


def _corners(low: Array, high: Array) -> Array:
    return np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)


def _projected(points: Array, camera: Camera) -> tuple[Array, Flags]:
    """(..., 2) place in the picture [px], brought to its edge, and whether points are before the camera."""
    local = (points - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    depth = -local[..., 2]
    ahead = depth > camera.near_m
    scale: Any
    if camera.fisheye is not None:
        local, ahead = local * (1.0, -1.0, -1.0), np.ones_like(ahead)
        local, scale = camera.fisheye.places(local) * (1.0, -1.0), camera.width_px
    elif camera.width_m > 0.0:
        scale = camera.width_px / camera.width_m
    else:
        scale = 1.0 / (camera.pixel_rad * np.where(ahead, depth, 1.0)[..., None])
    place = local[..., :2] * (1.0, -1.0) * scale
    half = 0.5 * np.array([camera.width_px, camera.height_px])
    middle = np.array(camera.shift) * (1.0, -1.0) * 2.0 * half
    return np.clip(place - middle, -half, half), ahead


class Movables:
    """What moves in a loaded scene, put to where it stands at a moment.

    Args:
        loaded: as it stands in mid-exposure; it is changed by `at` and given back by `back`.
    """

    def __init__(self, loaded: MitsubaScene) -> None:
        self.loaded = loaded
        self._ways = {key: ways for key, ways in loaded.source.motion_of.items() if key in loaded.parts}
        self._began: dict[str, Array] = {}

    def at(self, moment: float) -> MitsubaScene:
        """The scene at a moment, 0 to 1 of the exposure."""
        return self._stand({key: _between(ways, moment) for key, ways in self._ways.items()})

    def back(self) -> None:
        """Put all to where it stands in mid-exposure."""
        self._stand({key: np.broadcast_to(np.eye(4), (ways.shape[0], 4, 4)) for key, ways in self._ways.items()})

    def _stand(self, places: Mapping[str, Array]) -> MitsubaScene:
        mi, world = backend.mitsuba(), dict(self.loaded.source.world)
        for key, matrices in places.items():
            part, there = world[key], self.loaded.parts[key]
            world[key] = _placed(part, matrices)
            if part["type"] == photometric.TYPE:
                there.stand(np.asarray(world[key]["to_world"]))
                continue
            parameters = mi.traverse(there)
            if part["type"] == "mesh":
                parameters["vertex_positions"] = world[key]["positions"].astype(np.float32).ravel()
                if "normals" in part:
                    parameters["vertex_normals"] = world[key]["normals"].astype(np.float32).ravel()
            elif "to_world" in parameters:
                kind = type(parameters["to_world"])
                if key not in self._began:
                    self._began[key] = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
                parameters["to_world"] = kind(matrices[0] @ self._began[key])
            elif "position" in parameters:
                place = world[key]["position"] if "position" in part else world[key]["to_world"][:3, 3].tolist()
                parameters["position"] = type(parameters["position"])(place)
            parameters.update()
        self.loaded.scene.parameters_changed()
        return replace(self.loaded, source=replace(self.loaded.source, world=world))


def _between(ways: Array, moment: float) -> Array:
    """Matrices of M ways at a moment, between their K time samples (M, K, 4, 4)."""
    step = moment * (ways.shape[1] - 1)
    first = min(int(step), ways.shape[1] - 2)
    return ways[:, first] + (step - first) * (ways[:, first + 1] - ways[:, first])


def _placed(part: Mapping[str, Any], matrices: Array) -> dict[str, Any]:
    """A part of a scene moved by (M, 4, 4)."""
    moved = dict(part)
    if "positions" in part:
        which = np.asarray(part["motion"]) if "motion" in part else np.zeros(len(part["positions"]), dtype=np.int64)
        points = np.asarray(part["positions"], dtype=np.float64)
        moved["positions"] = np.einsum("nij,nj->ni", matrices[which, :3, :3], points) + matrices[which, :3, 3]
        if "normals" in part:
            turn = np.linalg.inv(matrices[:, :3, :3])
            moved["normals"] = np.einsum("nji,nj->ni", turn[which], np.asarray(part["normals"], dtype=np.float64))
    for name in ("center", "position"):
        if name in part:
            moved[name] = (matrices[0] @ [*part[name], 1.0])[:3].tolist()
    if "to_world" in part:
        moved["to_world"] = matrices[0] @ np.asarray(part["to_world"], dtype=np.float64)
    return moved


def accumulate(
    movables: Movables,
    parts: Intervals,
    make: Callable[[MitsubaScene], Integrator],
    *,
    seed: int,
    rays: int = 0,
    progress: Progress = silent,
) -> tuple[Accumulator, Guides | None]:
    """The picture of all parts, and what a denoiser may know of them.

    Args:
        movables: what moves; it is put back in the end.
        parts: of the exposure.
        make: an integrator of a scene.
        seed: of the image.
        rays: of a pixel for the guides, in all; 0 makes none, and so does a model that tells no components apart.
        progress: told after each part.
    """
    camera, merged, looked = movables.loaded.source.camera, _Merged(), _MeanGuides()
    pixels = camera.width_px * camera.height_px
    try:
        for number, part in enumerate(parts.parts):
            loaded = movables.at(0.5 * (part.begin + part.end))
            eye = replace(loaded.source.camera, during=(part.begin, part.end))
            exposed = replace(loaded, source=replace(loaded.source, camera=eye))
            integrator = make(exposed)
            of_part = within(progress, number / len(parts.parts), (number + 1) / len(parts.parts))
            if isinstance(integrator, Traces):
                before = number * parts.samples // 2  # numbers of paths go on from part to part, so does their order
                sampled = new_accumulator(integrator, pixels)
                for estimator in sampled.estimators.values():
                    estimator.counts += before
                rows = np.flatnonzero(np.repeat(part.share > 0.0, camera.width_px))
                add_samples(sampled, integrator, rows, sampled.even(parts.samples), seed, of_part)
                for estimator in sampled.estimators.values():
                    estimator.counts -= before
            else:
                moment_seed = seed32(seed, "moment", number)
                sampled = integrator.accumulate(samples=parts.samples, seed=moment_seed, progress=of_part)
            merged.add(sampled, np.repeat(part.share, camera.width_px))
            if rays and ALL not in sampled.estimators:
                looked.add(guides(exposed, rays=max(LEAST, rays // len(parts.parts))), part.share)
    finally:
        movables.back()
    return merged.all(), looked.all()


class _Merged:
    """The mean of accumulators by each one's share, and its variance."""

    def __init__(self) -> None:
        self.means: dict[str, dict[str, Pixels]] = {}
        self.variance: dict[str, Pixels] = {}
        self.groups: dict[str, list[Pixels]] = {}
        self.counts: dict[str, Pixels] = {}
        self.lost, self.weights, self.shape = 0, np.zeros(0), (0, 0)

    def add(self, sampled: Accumulator, share: Array) -> None:
        """One with a share (P,) of each pixel."""
        exposed, by_pixel = share > 0.0, share[:, None]
        self.lost, self.weights, self.shape = self.lost + sampled.lost, sampled.weights, sampled.shape
        for name, estimator in sampled.estimators.items():
            count = np.maximum(estimator.counts, 1)[:, :, None]
            means = self.means.setdefault(name, {})
            for aov, sums in estimator.aovs.items():
                mean = (by_pixel * (sums / count)).astype(np.float32)
                means[aov] = means[aov] + mean if aov in means else mean
            spread = np.where(exposed[:, None], estimator.variance(), 0.0) * by_pixel**2
            groups = [by_pixel * (group / estimator.number()) for group in estimator.groups]
            counts = estimator.counts * exposed
            if name in self.variance:
                spread, counts = spread + self.variance[name], counts + self.counts[name]
                groups = [before + now for before, now in zip(self.groups[name], groups, strict=True)]
            self.variance[name], self.groups[name], self.counts[name] = spread, groups, counts

    def all(self) -> Accumulator:
        """Sums that have this mean and this variance."""
        estimators = {}
        for name, means in self.means.items():
            counts = self.counts[name]
            aovs = {aov: (mean * counts[:, :, None]).astype(np.float32) for aov, mean in means.items()}
            number = np.maximum(counts.sum(axis=0), 1)[:, None]
            mean = total(sums.sum(axis=0, dtype=np.float64) for sums in aovs.values()) / number
            squares = (self.variance[name] * np.maximum(number - 1.0, 1.0) + mean**2) * number
            estimators[name] = Estimator(aovs, squares, [group * number for group in self.groups[name]], counts)
        return Accumulator(estimators, self.lost, self.shape, self.weights)


class _MeanGuides:
    """The mean of guides by each one's share of the rows."""

    def __init__(self) -> None:
        self.sums: list[Pixels] = []

    def add(self, guides: Guides, share: Array) -> None:
        """One with a share (H,) of each row."""
        rows = share.astype(np.float32)[:, None]
        part = [guides.albedo * rows[..., None], guides.normal * rows[..., None], guides.transmittance * rows]
        self.sums = [before + now for before, now in zip(self.sums, part, strict=True)] if self.sums else part

    def all(self) -> Guides | None:
        """None where there were none."""
        if not self.sums:
            return None
        albedo, normal, transmittance = self.sums
        return Guides(albedo, normal, np.minimum(transmittance, np.float32(1.0)))  # shares add up to 1 but for rounding

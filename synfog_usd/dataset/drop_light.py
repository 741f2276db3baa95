"""What lamps send to a camera by way of drops: each by its place, its beam, what is in its way and the drop's phase
function.

Takes what falls and the lamps of a scene; gives the radiance of drops at places, and its mean along lines of sight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import KDTree

from synfog_usd.base.arrays import Array, Flags, FloatArray, Indices
from synfog_usd.fog.falling import NEAR_M, SizeClasses
from synfog_usd.fog.kinds import medium_of
from synfog_usd.fog.medium import FogMedium
from synfog_usd.fog.volume import FogVolume
from synfog_usd.scene import Camera, SceneDict

if TYPE_CHECKING:
    from synfog_usd.render.load import MitsubaScene

SMALL_M = 1.0
"""Width of a lit surface up to which it is taken for a lamp; lit windows count as the light around."""

LEAST_M = 0.3
"""Distance from a lamp below which its light does not grow."""

EVERY_PX, FARTHEST_M, STEPS = 8, 300.0, 48
"""Pixels from one line of sight to the next, how far the longest goes [m], and its steps."""

SHADE_AT = 12, 8, 10
"""Columns, rows and distances of the places at which lamps are asked for."""

NEIGHBOURS, SIDEWAYS = 4, 8.0
"""How many of these count for a place between them, and what a radian counts beside a factor e of distance."""

BATCH = 1 << 18


@dataclass(frozen=True)
class PointLamp:
    """A lamp as a point.

    Attributes:
        place: (3,) [m].
        sent: from (N, 3) unit directions away from it to (N, 3) intensity [cd].
        half_m: half of its width [m].
    """

    place: Array
    sent: Callable[[Array], Array]
    half_m: float = 0.0


def lamps_of(scene: SceneDict) -> list[PointLamp]:
    """Spots, points, lamps with photometry and small lit surfaces of a scene."""
    from synfog_usd.render.lights import photometric, rows

    lamps = []
    for part in scene.world.values():
        if not rows.is_sampled_light(part):
            continue
        block, half_m = rows.lamp_rows(part), 0.0
        if part["type"] == "mesh":
            points = np.asarray(part["positions"], dtype=np.float64)
            block, half_m = _as_one(block, points), 0.5 * float(np.ptp(points, axis=0).max())
        table = photometric.table_of(part) if part["type"] == photometric.TYPE else None
        if len(block):
            lamps.append(PointLamp(block["position"][0].copy(), _sender(block, table), half_m))
    return lamps


def _as_one(faces: np.ndarray, points: Array) -> np.ndarray:
    """One row for the faces of a small surface; none for a large or a dark one."""
    weight = faces["colour"].sum(axis=1)
    if not weight.sum() > 0.0 or np.ptp(points, axis=0).max() > SMALL_M:
        return faces[:0]
    row = faces[:1].copy()
    row["position"] = np.average(faces["position"] + (faces["edge_u"] + faces["edge_v"]) / 3.0, axis=0, weights=weight)
    axis = np.average(faces["axis"], axis=0, weights=weight)
    lean = float(np.linalg.norm(axis))
    if lean < 0.5:  # it shines all around
        row["colour"], row["is_beam"], row["cutoff"], row["slope"] = faces["colour"].sum(axis=0) / 4.0, 1.0, 1e9, 1.0
    else:
        row["colour"], row["axis"] = faces["colour"].sum(axis=0), axis / lean
    return row


def _sender(rows: np.ndarray, table: Array | None) -> Callable[[Array], Array]:
    from scipy.ndimage import map_coordinates

    first, colours = rows[0], rows["colour"]

    def sent(ways: Array) -> Array:
        cosine = np.clip(ways @ first["axis"], -1.0, 1.0)
        if table is not None:
            across = np.cross(first["axis"], first["table_x"])
            around = np.arctan2(ways @ across, ways @ first["table_x"]) / (2.0 * np.pi) % 1.0
            at = np.stack([np.arccos(cosine) / np.pi * (len(table) - 1), around * table.shape[1]])
            closed = np.concatenate([table, table[:, :1]], axis=1)
            parts = np.moveaxis(closed, 2, 0)
            factor = np.stack([map_coordinates(part, at, order=1, mode="nearest") for part in parts], axis=1)
            return np.asarray(factor / np.maximum(table.max(axis=(0, 1)), 1e-30) @ colours)
        if first["is_beam"] > 0.5:
            beam = np.clip((first["cutoff"] - np.arccos(cosine)) * first["slope"], 0.0, 1.0)
            return np.asarray(beam[:, None] * colours[0])
        return np.asarray(np.maximum(cosine, 0.0)[:, None] * colours[0])

    return sent


@dataclass(frozen=True)
class Shade:
    """Which lamps shine on what is before a camera: asked for by rays from some places, and a mean of the nearest ones
    elsewhere.

    Attributes:
        eye: (3,) the camera's place [m].
        places: search tree of (P, 4) directions from there, times `SIDEWAYS`, and logarithms of distances.
        free: (L, P) 1 where nothing is between a lamp and a place, else 0.
    """

    eye: Array
    places: KDTree
    free: FloatArray

    @classmethod
    def of(cls, loaded: MitsubaScene, lamps: Sequence[PointLamp]) -> Shade:
        """That of a loaded scene.  What the camera does not see is left out; a lamp's glass and housing, within
        `LEAST_M`, shade nothing.
        """
        camera = loaded.source.camera
        columns, rows, steps = ((np.arange(count) + 0.5) / count for count in SHADE_AT)
        grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
        ways = camera.directions(grid)
        ways = ways[~np.isnan(ways).any(axis=1)]
        far = NEAR_M * (FARTHEST_M / NEAR_M) ** steps
        eye = camera.to_world[:3, 3]
        ways, far = np.repeat(ways, len(far), axis=0), np.tile(far, len(ways))
        places = eye + ways * far[:, None]
        in_sight = (far < NEAR_M * 4.0) | ~_meet(loaded, np.broadcast_to(eye, places.shape), places)
        places, key = places[in_sight], cls._key(ways[in_sight], far[in_sight])
        free = np.ones((len(lamps), len(places)), np.float32)
        for lamp, row in zip(lamps, free, strict=True):
            way = lamp.place - places
            away = np.linalg.norm(way, axis=1)
            until = np.maximum(away - lamp.half_m - LEAST_M, 0.0) / np.maximum(away, 1e-9)
            row[:] = ~_meet(loaded, places, places + way * until[:, None])
        return cls(eye, KDTree(key), free)

    @staticmethod
    def _key(ways: Array, far_m: Array) -> Array:
        return np.concatenate([SIDEWAYS * ways, np.log(far_m)[:, None]], axis=1)

    def near(self, places: Array) -> tuple[Indices, FloatArray]:
        """(N, `NEIGHBOURS`) which places were asked for near (N, 3) others, and the weight of each."""
        way = places - self.eye
        far = np.maximum(np.linalg.norm(way, axis=1), 1e-6)
        apart, index = self.places.query(self._key(way / far[:, None], far), k=NEIGHBOURS)
        index = np.minimum(index, self.free.shape[1] - 1)
        weight = 1.0 / np.maximum(apart, 1e-6) ** 2
        return index, (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)


def _meet(loaded: MitsubaScene, begin: Array, end: Array) -> Flags:
    """Whether something is between (N, 3) points and others."""
    from synfog_usd.render import backend

    mi = backend.mitsuba()
    far = np.linalg.norm(end - begin, axis=1)
    way = (end - begin) / np.maximum(far, 1e-9)[:, None]
    ray = mi.Ray3f(backend.points(begin), mi.Vector3f(backend.points(way)))
    ray.maxt = backend.floats(far)
    return np.asarray(loaded.tree.ray_test(ray, mi.Bool(True)).numpy(), dtype=bool)


def scattered(
    lamps: Sequence[PointLamp], places: Array, to_eye: Array, medium: FogMedium, shade: Shade | None = None
) -> Array:
    """(N, 3) radiance [cd m-2] of what stops all light at places: each lamp's, once scattered.

    A drop of cross-section A sends A p(angle) E, E = I / r^2 exp(-sigma_t r), and covers A of what is behind it.

    Args:
        places: (N, 3) in the scene [m].
        to_eye: (N, 3) unit directions to the camera.
        medium: whose phase function p [1/sr] and extinction sigma_t [1/m] are taken, as of an even one.
        shade: of these lamps; None where nothing shades them.
    """
    result = np.zeros((len(places), 3))
    for begin in range(0, len(places), BATCH):
        some = slice(begin, begin + BATCH)
        index, weight = shade.near(places[some]) if shade else (None, None)
        for number, lamp in enumerate(lamps):
            way = places[some] - lamp.place
            far = np.linalg.norm(way, axis=1)
            way /= np.maximum(far, 1e-9)[:, None]
            part = medium.phase_function.value(np.einsum("ij,ij->i", way, to_eye[some]))
            part *= np.exp(-medium.sigma_t_per_m * far) / np.maximum(far, LEAST_M) ** 2
            if shade is not None:
                part *= (shade.free[number][index] * weight).sum(axis=1)
            result[some] += lamp.sent(way) * part[:, None]
    return result


@dataclass(frozen=True)
class Sightlines:
    """Lines of sight through a picture, coarser than its pixels, and what lamps send along them.

    Attributes:
        ends_m: (K + 1,) distances between which the steps lie [m].
        light: (h, w, K, 3) radiance of drops in the middle of each step [cd m-2].
        shape: (H, W) of the picture.
    """

    ends_m: Array
    light: Array
    shape: tuple[int, int]

    @classmethod
    def of(
        cls,
        camera: Camera,
        lamps: Sequence[PointLamp],
        medium: FogMedium,
        reach_m: float,
        shade: Shade | None = None,
    ) -> Sightlines:
        """Those of a camera, up to a distance, see `scattered`."""
        height, width = camera.height_px, camera.width_px
        rows, columns = (max(2, -(-count // EVERY_PX)) for count in (height, width))
        grid = np.stack(np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows), axis=-1)
        steps = math.ceil(STEPS * math.log(reach_m / NEAR_M) / math.log(FARTHEST_M / NEAR_M))
        ends = np.geomspace(NEAR_M, reach_m, steps + 1)
        middle = 0.5 * (ends[1:] + ends[:-1])
        ways = np.nan_to_num(camera.directions(grid))
        places = camera.to_world[:3, 3] + ways[:, :, None, :] * middle[:, None]
        to_eye = np.broadcast_to(-ways[:, :, None, :], places.shape).reshape(-1, 3)
        light = scattered(lamps, places.reshape(-1, 3), to_eye, medium, shade)
        return cls(ends, light.reshape(*places.shape), (height, width))

    def sum(self, depth: Array, distance_m: Array | FloatArray) -> FloatArray:
        """(H, W, 3) sum of light over steps, each times its part of a (K + 1,) `depth` that grows with the distances
        `ends_m`, up to what each pixel shows.
        """
        from scipy.ndimage import map_coordinates

        until = np.cumsum(self.light * np.diff(depth)[:, None], axis=2)
        until = np.concatenate([np.zeros_like(until[:, :, :1]), until], axis=2)
        rows, columns = until.shape[:2]
        height, width = self.shape
        row, column = np.mgrid[:height, :width] + 0.5
        deep = np.interp(distance_m, self.ends_m, np.arange(len(self.ends_m)))
        at = np.stack([row * rows / height - 0.5, column * columns / width - 0.5, deep])
        planes = [map_coordinates(part, at, order=1, mode="nearest") for part in np.moveaxis(until, 3, 0)]
        return np.stack(planes, axis=2).astype(np.float32)


def shade_of(scene: SceneDict, loaded: MitsubaScene) -> Shade | None:
    """Of the lamps that light a scene's drops; None where none fall, or none shine, or rays end at fog's boundaries."""
    from synfog_usd.render import backend

    if loaded.boundaries or backend.is_scalar() or not falling_in(scene):
        return None
    lamps = lamps_of(scene)
    return Shade.of(loaded, lamps) if lamps else None


def falling_in(scene: SceneDict) -> list[tuple[SizeClasses, FogMedium, Array]]:
    """What falls where the camera is, with the medium of it alone and the wind (3,) [m/s]; nothing in a density grid,
    whose rain is of no one rate.
    """
    of_kind = {"rain": SizeClasses.of_rain, "snow": SizeClasses.of_snow}
    return [
        (of_kind[kind](sizes), medium_of(kind, sizes=sizes), np.array(volume.wind_m_s))
        for volume in volumes_around(scene)
        for kind, sizes in volume.medium.falls
    ]


def volumes_around(scene: SceneDict) -> list[FogVolume]:
    """The innermost volumes in which the camera is, without density grids."""
    eye_m = scene.camera.to_world[:3, 3]
    inside = {index: volume for index, volume in enumerate(scene.fog) if volume.boundary.contains(eye_m)[0]}
    around = {volume.parent for volume in inside.values()}
    return [volume for index, volume in inside.items() if index not in around and volume.medium.grid is None]

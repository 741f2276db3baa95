"""What the ray through each pixel's centre meets: depth, normal, instance, transmittance.

No samples and no filter: a label is true for one point of the pixel.  Fog
boundaries and holes in cut-out materials are passed through; the optical depth on
the way is integrated in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import drjit as dr
import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Flags, Indices, distinct
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.progress import Progress, silent
from synfog_usd.render import backend
from synfog_usd.render.load import MitsubaScene, camera_fog
from synfog_usd.render.media.medium import measured_depth
from synfog_usd.render.placed import PlacedScene
from synfog_usd.scene import Camera, prototype_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drjit.auto.ad import Bool, Float64, UInt32
    from mitsuba import Point3f, Ray3f, Shape, SurfaceInteraction3f, Vector3f

Float = TypeVar("Float", float, "Float64")
"""A number, or one of each lane."""

MAX_CROSSINGS = 256

RAYS = 1 << 18
"""Rays of a batch."""

MAX_PIERCED = 1024
"""Surfaces that a ray goes through when all instances on its way are asked for."""

STEP = 1e-5
"""Least way [1] by which a ray goes on behind a surface, in terms of 1 m and its length; float32 tells 1e-7 of it."""

REACH = 1e-4
"""A surface that lies so much [1] of its distance, and 0.1 mm, before a point is that point's own."""

NUDGE = (1.3e-5, -0.7e-5, 0.9e-5)
"""Change of direction [1] that takes a ray off an edge; 1 mm at 60 m."""


@dataclass(frozen=True)
class Hits:
    """Where rays meet the scene, one row a ray.

    Attributes:
        valid: (N,) whether anything was met.
        position: (N, 3) [m].
        onward: (N, 3) origin from which the same ray goes on behind the surface.
        normal: (N, 3) shading normal, as the surface has it.
        front: (N,) whether the ray came from the outer side of the geometry.
        instance_id: (N,) label id, 0 for none.
        part_id: (N,) id of what moves by itself in it, 0 for none.
        fog: (N,) index of the fog volume whose boundary it is, -1 for a surface.
        see_through: (N,) share of light that passes unhindered (cut-out materials).
    """

    valid: Flags
    position: Array
    onward: Array
    normal: Array
    front: Flags
    instance_id: Indices
    part_id: Indices
    fog: Indices
    see_through: Array


@dataclass(frozen=True)
class Aovs:
    """What each pixel sees, all (H, W) or (H, W, 3).

    Attributes:
        distance_m: along the ray from the camera, inf at the sky.
        depth_m: along the optical axis (planar), inf at the sky.
        normal: world frame (Z up), turned to the camera, 0 at the sky.
        instance_id: label id, 0 for sky and unknown.
        part_id: id of what moves by itself within the instance, 0 for none.
        transmittance: of the fog between camera and surface (or the end of the fog).
    """

    distance_m: Array
    depth_m: Array
    normal: Array
    instance_id: Indices
    part_id: Indices
    transmittance: Array

    def transmittance_image(self) -> Image:
        """The transmittance as a one-channel image."""
        return Image(self.transmittance[:, :, None].astype(np.float32), ("transmittance.Y",), Quantity.DATA)


def measure(loaded: MitsubaScene, *, batch: int = RAYS, progress: Progress = silent) -> Aovs:
    """Trace one ray through the centre of every pixel.

    Args:
        loaded: the scene.
        batch: rays of a batch; memory goes with it, the result does not.
        progress: told before each batch.
    """
    camera, tracer = loaded.source.camera, _Tracer(loaded)
    shape = (camera.height_px, camera.width_px)
    count = camera.width_px * camera.height_px
    parts = []
    for low in range(0, count, batch):
        progress("what is seen", low / count)
        parts.append(_measured(tracer, np.arange(low, min(low + batch, count))))
    distance, depth, normal, instance, part, through = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    distance, depth, instance, part, through = (
        plane.reshape(shape) for plane in (distance, depth, instance, part, through)
    )
    return Aovs(distance, depth, normal.reshape(*shape, 3), instance, part, through)


def _measured(tracer: _Tracer, pixels: Indices) -> tuple[Array, Array, Array, Indices, Indices, Array]:
    """What some pixels see, as rows of `Aovs`."""
    loaded = tracer.loaded
    camera, fog = loaded.source.camera, loaded.source.fog
    origin, direction = tracer.centre_rays(pixels)
    forward = -camera.to_world[:3, 2]
    count = len(origin)
    eye = np.broadcast_to(camera.to_world[:3, 3], origin.shape)
    if camera.width_m > 0.0:  # each ray begins at a place of its own, in the plane of the lens
        eye = origin - ((origin - eye) @ forward)[:, None] * forward

    distance, normal = np.full(count, np.inf), np.zeros((count, 3))
    instance, part = np.zeros((2, count), dtype=np.int64)
    tau = np.zeros(count)
    surrounding = camera_fog(loaded.source) if loaded.boundaries else None
    medium = np.full(count, -1 if surrounding is None else surrounding)
    parents = np.array([-1 if volume.parent is None else volume.parent for volume in fog] + [-1])
    start = eye.copy()
    alive = np.arange(count)
    for _ in range(MAX_CROSSINGS):
        if not alive.size:
            break
        hits = tracer.trace(origin[alive], direction[alive])
        leaked = ~hits.valid & (medium[alive] >= 0)
        if leaked.any():  # through an edge between two triangles of a boundary: it must leave the fog somewhere
            _replace_rows(hits, leaked, tracer.trace(origin[alive[leaked]], direction[alive[leaked]] + NUDGE))
        alive, hits = alive[hits.valid], _rows(hits, hits.valid)
        for index, volume in enumerate(fog):
            inside = medium[alive] == index
            begin, end = start[alive][inside], hits.position[inside]
            tau[alive[inside]] += volume.optical_depth(begin, end)
        start[alive], origin[alive] = hits.position, hits.onward
        crossed = hits.fog >= 0
        entering = np.where(hits.front, hits.fog, parents[hits.fog])
        medium[alive[crossed]] = entering[crossed]
        stopped = ~crossed & (hits.see_through < 0.5)
        rays = alive[stopped]
        distance[rays] = np.linalg.norm(hits.position[stopped] - eye[rays], axis=1)
        facing = np.where(np.sum(hits.normal * direction[alive], axis=1) > 0.0, -1.0, 1.0)
        normal[rays] = (hits.normal * facing[:, None])[stopped]
        instance[rays], part[rays] = hits.instance_id[stopped], hits.part_id[stopped]
        alive = alive[~stopped]

    if fog and not loaded.boundaries:
        tau = measured_depth(fog, eye, direction, distance)
    near = np.isfinite(distance)
    depth = np.where(near, np.where(near, distance, 0.0) * (direction @ forward), np.inf)
    return distance, depth, normal, instance, part, np.exp(-tau)


def pierced(loaded: MitsubaScene, *, batch: int = RAYS, progress: Progress = silent) -> tuple[Indices, Indices]:
    """Every instance that the ray through each pixel's centre meets, whatever stands in front of it.

    The rays of `measure` go on behind each surface until they leave the scene, or after `MAX_PIERCED` surfaces.  So one
    pass gives the amodal masks of all instances.  They go on from themselves: the renderer's own place to go on is
    off the surface, 5 mm at 60 m, and behind a tree's leaves that would be another ray.

    Args:
        loaded: the scene.
        batch: rays of a batch; memory goes with it, the result does not.
        progress: told before each batch.

    Returns:
        instance ids and pixels (row by row from the top left), both (M,), sorted by id, then by pixel; each pair once.
    """
    camera = loaded.source.camera
    count = camera.width_px * camera.height_px
    tracer = _Tracer(loaded)
    codes = [np.zeros(0, dtype=np.int64)]
    for first in range(0, count, batch):
        progress("what stands behind", first / count)
        pixels, met, gone = np.arange(first, min(first + batch, count)), [np.zeros(0, dtype=np.int64)], 0
        rays = (*tracer.centre_rays(pixels), np.zeros(len(pixels)), np.ones(len(pixels)))
        while pixels.size and gone < MAX_PIERCED:
            steps = 1 if tracer.scalar else min(batch // len(pixels), MAX_PIERCED - gone)
            ids, began, growth, alive = tracer.pierced(*rays, steps)
            met += [some[some > 0] * count + pixels[some > 0] for some in ids]
            pixels, rays = pixels[alive], (rays[0][alive], rays[1][alive], began[alive], growth[alive])
            gone += steps
        codes.append(distinct(np.concatenate(met)))
    ids, pixels = np.divmod(np.sort(np.concatenate(codes)), count)
    return ids, pixels


def centre_rays(loaded: MitsubaScene) -> tuple[Array, Array]:
    """(P, 3) origins and unit directions of the rays through the pixels' centres, row by row from the top left."""
    camera = loaded.source.camera
    return _Tracer(loaded).centre_rays(np.arange(camera.width_px * camera.height_px))


def reached(loaded: MitsubaScene, camera: Camera, distance_m: Array) -> Flags:
    """(N,) whether another camera sees what the pixels' rays meet, wherever its own picture ends.

    Args:
        loaded: the scene, without boundaries of fog, from a camera that is a pinhole.
        camera: the other one, whose near plane counts.
        distance_m: (N,) from the first one to what its pixels see, row by row from the top left; inf at the sky.
    """
    tracer, free = _Tracer(loaded), list[Flags]()
    for low in range(0, len(distance_m), RAYS):
        pixels = np.arange(low, min(low + RAYS, len(distance_m)))
        free.append(_reached(tracer, camera, tracer.centre_rays(pixels)[1], distance_m[pixels]))
    return np.concatenate(free)


def _reached(tracer: _Tracer, camera: Camera, direction: Array, distance_m: Array) -> Flags:
    eye = tracer.loaded.source.camera.to_world[:3, 3]
    place, forward = camera.to_world[:3, 3], -camera.to_world[:3, 2]
    near = np.isfinite(distance_m)
    way = np.where(near[:, None], eye + direction * np.where(near, distance_m, 0.0)[:, None] - place, direction)
    length = np.linalg.norm(way, axis=1)
    onward = way / np.maximum(length, 1e-12)[:, None]
    least = np.where(near, length * (1.0 - REACH) - REACH, np.inf)
    ahead = np.maximum(onward @ forward, 1e-6)
    origin, free = place + onward * (camera.near_m / ahead)[:, None], np.ones(len(way), dtype=bool)
    alive = np.arange(len(way))
    for _ in range(MAX_CROSSINGS):
        if not alive.size:
            break
        hits = tracer.trace(origin[alive], onward[alive])
        nearer = hits.valid & (np.linalg.norm(hits.position - place, axis=1) < least[alive])
        stopped = nearer & (hits.fog < 0) & (hits.see_through < 0.5)
        free[alive[stopped]] = False
        origin[alive] = hits.onward
        alive = alive[nearer & ~stopped]
    return free


def seen_through(loaded: MitsubaScene, clear: Aovs) -> Aovs:
    """The AOVs of a whole scene, through the fog of one that has less in it.

    Args:
        loaded: the scene with its fog, in boxes and balls, and a camera of the size of `clear`.
        clear: what the same rays meet in clear air.
    """
    tracer, distance, through = _Tracer(loaded), clear.distance_m.ravel(), np.ones(clear.distance_m.size)
    for low in range(0, len(distance) if loaded.source.fog else 0, RAYS):
        some = slice(low, low + RAYS)
        _, direction = tracer.centre_rays(np.arange(low, min(low + RAYS, len(distance))))
        eye = np.broadcast_to(loaded.source.camera.to_world[:3, 3], direction.shape)
        through[some] = np.exp(-measured_depth(loaded.source.fog, eye, direction, distance[some]))
    return replace(clear, transmittance=through.reshape(clear.distance_m.shape))


def _rows(hits: Hits, keep: Flags) -> Hits:
    return Hits(**{name: getattr(hits, name)[keep] for name in Hits.__dataclass_fields__})


def _replace_rows(hits: Hits, at: Flags, better: Hits) -> None:
    for name in Hits.__dataclass_fields__:
        getattr(hits, name)[at] = getattr(better, name)


def _behind(began: Float, growth: Float, at: Float, leaves: Float) -> tuple[Float, Float]:
    """Where a ray goes on behind a surface, see `_Tracer.pierced`.

    Args:
        began, growth: of its way to the surface.
        at: way [m] from the eye to the surface; leaves: to where the renderer would go on.
    """
    least = STEP * (1.0 + at)
    growth = dr.select(at - began < 4.0 * growth * least, 2.0 * growth, 1.0)
    further = at + growth * least
    return dr.select(leaves > further, leaves, further), growth


class _Tracer:
    """Rays in, numpy rows out, in any variant."""

    def __init__(self, loaded: MitsubaScene) -> None:
        self.mi, self.loaded = backend.mitsuba(), loaded
        self.scalar = backend.is_scalar()
        self.rank: dict[int, int] = {}
        for shape in [*loaded.shapes.values(), *loaded.boundaries.values()]:
            self.rank.setdefault(self.identity(shape), len(self.rank) + 1)  # 0 stands for no shape
        size = len(self.rank) + 1
        self.fog_of = np.full(size, -1, dtype=np.int64)
        for index, shape in loaded.boundaries.items():
            self.fog_of[self.rank[self.identity(shape)]] = index
        instances: dict[int, int] = {}
        for key in loaded.source.instance_of:
            instance = loaded.source.number_of(key)
            if len(key) == 1:
                instances[self.rank[self.identity(loaded.shapes[key])]] = instance
            else:
                placed, inner = loaded.shapes[key[:1]], loaded.shapes[prototype_of(loaded.source.world[key[0]]), key[1]]
                instances[self.rank[self.identity(placed)] * size + self.rank[self.identity(inner)]] = instance
        self.size = size
        self.instance_keys = np.array(sorted(instances), dtype=np.int64)
        self.instance_values = np.array([instances[key] for key in sorted(instances)], dtype=np.int64)
        if not self.scalar:
            self.lookup = np.zeros(max(self.rank, default=0) + 1, dtype=np.int64)
            for registry, rank in self.rank.items():
                self.lookup[registry] = rank
        self.first_face = np.full(size, -1, dtype=np.int64)
        lists, start = [np.zeros(0, dtype=np.int32)], 0
        for joined, faces in loaded.face_instances.items():
            self.first_face[self.rank[self.identity(loaded.shapes[joined,])]] = start
            lists.append(faces)
            start += len(faces)
        self.face_instances = np.concatenate(lists)
        self.label_of = loaded.tree.label_of if isinstance(loaded.tree, PlacedScene) else np.array([-1])

    def identity(self, shape: Shape) -> int:
        return id(shape) if self.scalar else backend.index_of(self.mi.ShapePtr(shape))

    def centre_rays(self, pixels: Indices) -> tuple[Array, Array]:
        """(N, 3) origins and directions of pixels (N,), numbered row by row from the top left."""
        mi, width, height = self.mi, self.loaded.source.camera.width_px, self.loaded.source.camera.height_px
        y, x = np.divmod(pixels, width)
        u, v = (x + 0.5) / width + self.loaded.offset[0], (y + 0.5) / height + self.loaded.offset[1]
        if not self.scalar:
            ray, _ = self.loaded.sensor.sample_ray(
                0.0, 0.5, mi.Point2f(backend.floats(u), backend.floats(v)), mi.Point2f(0.5)
            )
            dr.eval(ray)
            origin = backend.rows(ray.o)
            return origin, np.array(np.broadcast_to(backend.rows(ray.d), origin.shape))  # parallel rays come as one
        rays = [
            self.loaded.sensor.sample_ray(0.0, 0.5, mi.Point2f(a, b), mi.Point2f(0.5))[0]
            for a, b in zip(u, v, strict=True)
        ]
        return np.array([ray.o for ray in rays], dtype=np.float64), np.array([ray.d for ray in rays], dtype=np.float64)

    def trace(self, origin: Array, direction: Array) -> Hits:
        rows = self._trace_scalar(origin, direction) if self.scalar else self._trace_jit(origin, direction)
        valid, position, onward, normal, front, rank, placed, face, see_through, row = rows
        instance, part = self._labels(rank, placed, face, row)
        return Hits(valid, position, onward, normal, front, instance, part, self.fog_of[rank], see_through)

    def _labels(self, rank: Indices, placed: Indices, face: Indices, row: Indices) -> tuple[Indices, Indices]:
        """Label ids of what was met, and the ids of its parts that move by themselves; 0 for none."""
        code = np.where(placed > 0, placed * self.size + rank, rank)
        at = np.minimum(np.searchsorted(self.instance_keys, code), max(len(self.instance_keys) - 1, 0))
        labelled = (self.instance_keys[at] == code) if len(self.instance_keys) else np.zeros(len(code), dtype=bool)
        instance = np.where(labelled, self.instance_values[at] if len(self.instance_keys) else 0, 0)
        joined = self.first_face[rank] >= 0
        instance[joined] = self.face_instances[self.first_face[rank[joined]] + face[joined]]
        instance = np.where(self.label_of[row] >= 0, self.label_of[row], instance)
        source, part = self.loaded.source, np.zeros_like(instance)
        if source.parts:
            part = np.maximum(instance - len(source.instances), 0)
            owner = np.array([0, *(one.instance for one in source.parts)])
            instance = np.where(part > 0, owner[part], instance)
        return instance, part

    def pierced(
        self, eye: Array, direction: Array, began: Array, growth: Array, steps: int
    ) -> tuple[Indices, Array, Array, Flags]:
        """The label ids (steps, N) of what rays meet next, and where they go on; in a scalar variant of one step.

        Args:
            eye, direction: (N, 3) of the rays.
            began: (N,) way [m] from the eye from which on they look.
            growth: (N,) how many times `STEP` they went at least; a ray within a surface leaves it.
            steps: surfaces that they go through at most.

        Returns:
            ids, `began` and `growth` behind the last surface, and whether there was one.
        """
        if self.scalar:
            hits = self.trace(eye + began[:, None] * direction, direction)
            ids = np.where(hits.see_through < 0.5, hits.instance_id, 0)
            at, leaves = (np.sum((place - eye) * direction, axis=1) for place in (hits.position, hits.onward))
            further = np.array([_behind(*row) for row in np.stack([began, growth, at, leaves], axis=1).tolist()])
            return ids[None], *further.T, hits.valid
        mi = self.mi
        met = [dr.zeros(mi.UInt32, steps * len(eye)) for _ in range(4)]
        rays = backend.points(eye), mi.Vector3f(backend.points(direction)), mi.Float64(began), mi.Float64(growth)
        state = self._walk(*rays, dr.opaque(mi.UInt32, steps), dr.opaque(mi.UInt32, len(eye)), met)
        dr.eval(*state, *met)
        shape, placed, face, row = (np.array(part, dtype=np.int64) for part in met)
        ids, _ = self._labels(self.lookup[shape], self.lookup[placed], face, row)
        began, growth, alive = (np.array(part) for part in state)
        return ids.reshape(steps, len(eye)), began, growth, alive

    @dr.syntax
    def _walk(
        self,
        eye: Point3f,
        direction: Vector3f,
        began: Float64,
        growth: Float64,
        steps: UInt32,
        lanes: UInt32,
        met: Sequence[UInt32],
    ) -> tuple[Float64, Float64, Bool]:
        """As `pierced`; shape, instance, face and row of what lane n meets in its step k go to place k * lanes + n."""
        mi = self.mi
        from_eye, along = mi.Point3d(eye), mi.Vector3d(direction)
        place, end, alive = dr.arange(mi.UInt32, dr.width(eye)), lanes * steps, mi.Bool(True)
        while alive & (place < end):
            ray = mi.Ray3f(mi.Point3f(from_eye + began * along), direction)
            si, row = self._hits(ray, alive)
            alive &= si.is_valid()
            solid = alive & (backend.channel_mean(mi.Color3f(si.bsdf().eval_null_transmission(si, alive))) < 0.5)
            numbers = backend.indices_of(si.shape), backend.indices_of(si.instance), si.prim_index, row
            for target, number in zip(met, numbers, strict=True):
                dr.scatter(target, number, place, solid)
            at = dr.dot(mi.Point3d(si.p) - from_eye, along)
            leaves = dr.dot(mi.Point3d(si.spawn_ray(direction).o) - from_eye, along)
            further, grown = _behind(began, growth, at, leaves)
            began, growth = dr.select(alive, further, began), dr.select(alive, grown, growth)
            place += lanes
        return began, growth, alive

    def _hits(self, ray: Ray3f, active: Bool) -> tuple[SurfaceInteraction3f, UInt32]:
        tree = self.loaded.tree
        if isinstance(tree, PlacedScene):
            return tree.hits(ray, active=active)
        return tree.ray_intersect(ray, active=active), self.mi.UInt32(0)

    def _trace_jit(self, origin: Array, direction: Array) -> tuple[npt.NDArray[Any], ...]:
        mi = self.mi
        ray = mi.Ray3f(backend.points(origin), mi.Vector3f(backend.points(direction)))
        si, row = self._hits(ray, mi.Bool(True))
        valid = si.is_valid()
        passing = backend.channel_mean(mi.Color3f(si.bsdf().eval_null_transmission(si, valid)))
        shape, instance = backend.indices_of(si.shape), backend.indices_of(si.instance)
        front, vectors = dr.dot(si.n, ray.d) < 0.0, (si.p, si.spawn_ray(ray.d).o, si.sh_frame.n)
        # together: else each would trace the rays again
        dr.eval(valid, passing, shape, instance, front, vectors, si.prim_index, row)
        rank, placed = self.lookup[np.array(shape)], self.lookup[np.array(instance)]
        face, see_through = np.array(si.prim_index, dtype=np.int64), np.array(passing, dtype=np.float64)
        places = (backend.rows(item) for item in vectors)
        return np.array(valid), *places, np.array(front), rank, placed, face, see_through, np.array(row)

    def _trace_scalar(self, origin: Array, direction: Array) -> tuple[npt.NDArray[Any], ...]:
        mi, rows = self.mi, list[tuple[Any, ...]]()
        for o, d in zip(origin, direction, strict=True):
            si = self.loaded.tree.ray_intersect(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)))
            if not si.is_valid():
                rows.append((False, o, o, d, False, 0, 0, 0, 0.0, 0))
                continue
            passing = float(np.mean(np.array(si.bsdf().eval_null_transmission(si, mi.Bool(True)))))
            rank, placed = self.rank.get(id(si.shape), 0), self.rank.get(id(si.instance), 0)
            facing = float(np.dot(np.array(si.n), d)) < 0.0
            vectors = np.array(si.p), np.array(si.spawn_ray(mi.Vector3f(d)).o), np.array(si.sh_frame.n)
            rows.append((True, *vectors, facing, rank, placed, si.prim_index, passing, 0))
        return tuple(np.array([row[index] for row in rows]) for index in range(10))

"""Prototypes that stand in many places: the search tree has each once, and what a ray meets is put to its place.

Mitsuba's own instances cost 12 to 20 ms in every kernel each: Dr.Jit records all shapes that a ray may meet, and for
an instance all shapes again.  So what is traced is made in a variant of its own (`TRACED`), whose shapes no kernel
records, and which tells what is met by numbers alone.  A table knows which face of which mesh of the variant in force
that is, and where it stands.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array, Pixels
from synfog_usd.render import backend

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import (
        Mesh,
        Normal3f,
        Object,
        Point3f,
        PreliminaryIntersection3f,
        Ray3f,
        RayFlags,
        Scene,
        Shape,
        SurfaceInteraction3f,
        Vector3f,
    )

TRACED = "llvm_ad_mono"


@dataclass(frozen=True)
class Piece:
    """A mesh of a prototype, in the coordinates of the prototype.

    Attributes:
        key: of the joined mesh that has it.
        first_face, first_vertex: of it in that mesh.
        faces, vertices: their number.
    """

    key: str
    first_face: int
    first_vertex: int
    faces: int
    vertices: int


@dataclass(frozen=True)
class Standing:
    """Where a prototype stands.

    Attributes:
        prototype: its key.
        to_world: (4, 4).
        labels: label id of each of its pieces.
    """

    prototype: str
    to_world: Array
    labels: tuple[int, ...]


@dataclass(frozen=True)
class Prototypes:
    """All prototypes of a scene, and where they stand.

    Attributes:
        pieces: key of a prototype -> its meshes; those are the last that the joined meshes have.
        places: in the order of the scene.
    """

    pieces: Mapping[str, tuple[Piece, ...]]
    places: tuple[Standing, ...]


class PlacedScene:
    """What rays meet, asked for as Mitsuba's scenes are.

    What stands while other things move from frame to frame is a prototype too, whose search tree is made once.

    Args:
        shapes: (key,) -> shape of the variant in force.
        world: what they were made of, by key.
        prototypes: which of their faces stand where.
        moving: keys of what moves from frame to frame; where there are none, nothing is kept for another frame.
        groups: of another frame's scene; what consists of the same parts is taken from them, and they become those of
            this one.

    Attributes:
        label_of: (R,) label id of what has a row in the table, -1 where each face has its own.
    """

    def __init__(
        self,
        shapes: Mapping[tuple[str, ...], Shape],
        world: Mapping[str, Any],
        prototypes: Prototypes,
        moving: Collection[str] = (),
        groups: Groups | None = None,
    ) -> None:
        mi = backend.mitsuba()
        numbers = {key: backend.index_of(mi.ShapePtr(shape)) for (key,), shape in shapes.items()}
        vertices = {
            key: mi.traverse(shape)["vertex_positions"]
            for (key,), shape in shapes.items()
            if world[key]["type"] == "mesh"
        }
        traced_mi = importlib.import_module(f"mitsuba.{TRACED}")
        self._ray, tracer = traced_mi.Ray3f, _Traced(traced_mi, vertices, world, {} if groups is None else groups)
        traced, still = tracer.all(prototypes, moving)
        self.scene = cast("Scene", _loaded({"type": "scene", **traced}))
        traced_numbers = {
            key: backend.index_of(traced_mi.ShapePtr(shape))
            for key, shape in traced.items()
            if not key.startswith("group_")
        }
        shape, first, labels, matrices = [0], [0], [-1], [np.eye(4)]  # row 0 is of nothing
        row_of = np.zeros(max(traced_numbers.values()) + 1, dtype=np.uint32)
        for key in (key for key in numbers if key in traced_numbers):
            row_of[traced_numbers[key]] = len(shape)
            shape, first, labels, matrices = [*shape, numbers[key]], [*first, 0], [*labels, -1], [*matrices, np.eye(4)]
        if still:
            row_of[traced_numbers[STILL]] = len(shape)
            shape += [numbers[key] for key in still]
            first, labels = [*first, *(0 for _ in still)], [*labels, *(-1 for _ in still)]
            matrices += [np.eye(4)] * len(still)
        for k, place in enumerate(prototypes.places):
            row_of[traced_numbers[f"place_{k}"]] = len(shape)
            for piece, label in zip(prototypes.pieces[place.prototype], place.labels, strict=True):
                shape.append(numbers[piece.key])
                first.append(piece.first_face)
                labels.append(label)
                matrices.append(place.to_world)
        self.label_of = np.array(labels, dtype=np.int64)
        self._row_of, self._shape, self._first = _column(row_of), _column(shape), _column(first)
        self._is_placed = _column(self.label_of >= 0)
        self._matrix = backend.floats(np.array(matrices)[:, :3].ravel())
        dr.make_opaque(self._row_of, self._shape, self._first, self._is_placed, self._matrix)

    def ray_test(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        """As that of `mi.Scene`."""
        return self.scene.ray_test(self._as_traced(ray), backend.mitsuba().Bool(active))

    def ray_intersect_preliminary(
        self, ray: Ray3f, coherent: bool = False, active: Bool | bool = True
    ) -> PreliminaryIntersection3f:
        """As that of `mi.Scene`; the surface that it computes is where its prototype was made, if it is of one."""
        return self._hit(ray, coherent, active)[0]

    def ray_intersect(
        self, ray: Ray3f, _ray_flags: RayFlags | None = None, coherent: bool = False, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """As that of `mi.Scene`, with all flags; its `instance` stays empty."""
        return self.hits(ray, coherent, active)[0]

    def hits(
        self, ray: Ray3f, coherent: bool = False, active: Bool | bool = True
    ) -> tuple[SurfaceInteraction3f, UInt32]:
        """What rays meet, and the rows by which `label_of` knows it; 0 of nothing."""
        mi = backend.mitsuba()
        hit, row = self._hit(ray, coherent, active)
        si = hit.compute_surface_interaction(ray, mi.RayFlags.All, hit.valid)
        si.t = dr.select(hit.valid, hit.t, dr.inf)
        self._put_to_place(si, ray, row, hit.valid & (dr.gather(mi.UInt32, self._is_placed, row, hit.valid) > 0))
        return si, row

    def _hit(self, ray: Ray3f, coherent: bool, active: Bool | bool) -> tuple[PreliminaryIntersection3f, UInt32]:
        """The face that a ray meets, of the variant in force, and its row."""
        mi = backend.mitsuba()
        hit = self.scene.ray_intersect_preliminary(self._as_traced(ray), mi.Bool(coherent), mi.Bool(active))
        some = active & hit.is_valid()
        shape, instance = backend.indices_of(hit.shape), backend.indices_of(hit.instance)
        row = dr.gather(mi.UInt32, self._row_of, dr.select(instance > 0, instance, shape), some)
        row += dr.select(some & (instance > 0), hit.shape_index, 0)
        face = dr.zeros(mi.PreliminaryIntersection3f)
        face.t, face.prim_uv, face.valid = hit.t, hit.prim_uv, some
        face.prim_index = hit.prim_index + dr.gather(mi.UInt32, self._first, row, some)
        face.shape = dr.reinterpret_array(mi.ShapePtr, dr.gather(mi.UInt32, self._shape, row, some))
        return face, row

    def _put_to_place(self, si: SurfaceInteraction3f, ray: Ray3f, row: UInt32, placed: Bool) -> None:
        """Move surfaces from the coordinates of their prototypes to where these stand."""
        mi = backend.mitsuba()
        x, y, z = (dr.gather(mi.Vector4f, self._matrix, row * 3 + k, placed) for k in range(3))
        a, b, c = mi.Vector3f(x.x, y.x, z.x), mi.Vector3f(x.y, y.y, z.y), mi.Vector3f(x.z, y.z, z.z)
        across = dr.cross(b, c), dr.cross(c, a), dr.cross(a, b)  # the inverse transposed, times the determinant
        side = dr.sign(dr.dot(a, across[0]))

        def along(v: Point3f | Vector3f) -> Vector3f:
            return a * v.x + b * v.y + c * v.z

        def upright(n: Normal3f) -> Normal3f:
            return mi.Normal3f(dr.normalize((across[0] * n.x + across[1] * n.y + across[2] * n.z) * side))

        si.p = dr.select(placed, mi.Point3f(along(si.p) + mi.Vector3f(x.w, y.w, z.w)), si.p)
        si.n = dr.select(placed, upright(si.n), si.n)
        si.dp_du, si.dp_dv = (dr.select(placed, along(v), v) for v in (si.dp_du, si.dp_dv))
        unmoved = mi.Frame3f(si.sh_frame)
        si.sh_frame.n = upright(si.sh_frame.n)
        si.initialize_sh_frame()
        si.sh_frame = dr.select(placed, si.sh_frame, unmoved)
        si.wi = dr.select(placed, si.sh_frame.to_local(-ray.d), si.wi)

    def _as_traced(self, ray: Ray3f) -> Ray3f:
        traced: Ray3f = dr.zeros(self._ray)
        traced.o, traced.d, traced.maxt, traced.time = ray.o, ray.d, ray.maxt, ray.time
        return traced


STILL, STILL_GROUP = "place_still", "group_still"
"""What stands while other things move, as one prototype, and where that stands."""

Groups: TypeAlias = dict[tuple[Any, ...], tuple[tuple[Any, ...], Any]]
"""By what a group was made of: that itself, so that no other part gets its id, and the group."""


class _Traced:
    """Makes shapes without their surfaces, and groups of these once for all frames in which they are the same."""

    def __init__(self, mi: ModuleType, vertices: Mapping[str, Float], world: Mapping[str, Any], groups: Groups) -> None:
        self._mi, self._vertices, self._world, self._groups = mi, vertices, world, groups

    def all(self, prototypes: Prototypes, moving: Collection[str]) -> tuple[dict[str, Object], list[str]]:
        """All shapes under their keys, as 'group_K' the prototypes, as 'place_K' the places; and the keys of the meshes
        that are together in `STILL_GROUP`.
        """
        mi, world, asked = self._mi, self._world, Groups()
        counts = {key: len(world[key]["faces"]) for key in self._vertices}
        for piece in (piece for pieces in prototypes.pieces.values() for piece in pieces):
            counts[piece.key] = min(counts[piece.key], piece.first_face)
        counts = {key: count for key, count in counts.items() if count}
        still = [key for key in counts if key not in moving] if moving else []
        shapes: dict[str, Object] = {key: self._part(key, count) for key, count in counts.items() if key not in still}
        for key, part in world.items():
            if key.startswith("shape_") and key not in self._vertices:
                form = {name: value for name, value in part.items() if name not in ("bsdf", "emitter")}
                if "to_world" in form:
                    form["to_world"] = mi.ScalarTransform4f(np.asarray(form["to_world"], dtype=np.float64))
                shapes[key] = _loaded(form)
        groups = {}
        for k, (prototype, pieces) in enumerate(prototypes.pieces.items()):
            make = functools.partial(self._pieces, pieces)
            groups[prototype] = shapes[f"group_{k}"] = self._group(asked, (pieces,), [p.key for p in pieces], make)
        for k, place in enumerate(prototypes.places):
            shapes[f"place_{k}"] = self._place(place.to_world, groups[place.prototype])
        if still:
            of_still = tuple((key, counts[key]) for key in still)
            make = functools.partial(self._whole, of_still)
            shapes[STILL_GROUP] = self._group(asked, of_still, still, make)
            shapes[STILL] = self._place(np.eye(4), shapes[STILL_GROUP])
        self._groups.clear()
        if moving:
            self._groups.update(asked)
        return shapes, still

    def _group(
        self, asked: Groups, of: tuple[Any, ...], keys: Sequence[str], make: Callable[[], dict[str, Object]]
    ) -> Object:
        parts = tuple(self._world[key] for key in keys)
        key = (of, *map(id, parts))
        asked[key] = self._groups.get(key) or (parts, _loaded({"type": "shapegroup", **make()}))
        return asked[key][1]

    def _pieces(self, pieces: Sequence[Piece]) -> dict[str, Object]:
        return {f"piece_{n:06}": _piece(self._mi, self._world[piece.key], piece) for n, piece in enumerate(pieces)}

    def _whole(self, still: Sequence[tuple[str, int]]) -> dict[str, Object]:
        return {f"piece_{n:06}": self._part(key, count) for n, (key, count) in enumerate(still)}

    def _part(self, key: str, count: int) -> Object:
        """The first faces of a mesh."""
        return _mesh(self._mi, self._vertices[key], np.asarray(self._world[key]["faces"])[:count])

    def _place(self, to_world: Array, group: Object) -> Object:
        return _loaded({"type": "instance", "to_world": self._mi.ScalarTransform4f(to_world), "group": group})


def _loaded(parts: dict[str, Any]) -> Object:
    """As `mi.load_dict`, in `TRACED`; to choose that variant for a moment takes 0.1 s, in which Mitsuba reads all its
    integrators anew.
    """
    parser = backend.mitsuba().parser
    config = parser.ParserConfig(TRACED)
    state = parser.parse_dict(config, parts)
    parser.transform_all(config, state)
    return parser.instantiate(config, state)


def _piece(mi: ModuleType, part: Mapping[str, Any], piece: Piece) -> Mesh:
    """A mesh of a prototype by itself."""
    faces = np.asarray(part["faces"])[piece.first_face : piece.first_face + piece.faces] - np.uint32(piece.first_vertex)
    corners = np.asarray(part["positions"])[piece.first_vertex : piece.first_vertex + piece.vertices]
    return _mesh(mi, backend.floats(corners.ravel()), faces)


def _mesh(mi: ModuleType, vertices: Float, faces: Pixels) -> Mesh:
    """Positions (3 V,) of the variant in force lie where they are."""
    mesh: Mesh = mi.Mesh("traced", dr.width(vertices) // 3, len(faces))
    parameters = backend.mitsuba().traverse(mesh)
    parameters["vertex_positions"], parameters["faces"] = vertices, backend.numbers(faces.ravel())
    parameters.update()
    return mesh


def _column(numbers: Sequence[int] | Pixels) -> UInt32:
    """A column of the table, in memory of at least four numbers."""
    padded = np.zeros(max(len(numbers), 4), dtype=np.uint32)
    padded[: len(numbers)] = numbers
    return backend.numbers(padded)

"""Prototypes that stand in many places: the search tree has each once, and what a ray meets is put to its place.

Mitsuba's own instances cost 12 to 20 ms in every kernel each: Dr.Jit records all shapes that a ray may meet, and for
an instance all shapes again.  So what is traced is made in a variant of its own (`TRACED`), whose shapes no kernel
records, and which tells what is met by numbers alone.  A table knows which face of which mesh of the variant in force
that is, and where it stands.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, cast

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

    Args:
        shapes: (key,) -> shape of the variant in force.
        world: what they were made of, by key.
        prototypes: which of their faces stand where.

    Attributes:
        label_of: (R,) label id of what has a row in the table, -1 where each face has its own.
    """

    def __init__(
        self, shapes: Mapping[tuple[str, ...], Shape], world: Mapping[str, Any], prototypes: Prototypes
    ) -> None:
        mi = backend.mitsuba()
        numbers = {key: backend.index_of(mi.ShapePtr(shape)) for (key,), shape in shapes.items()}
        vertices = {
            key: mi.traverse(shape)["vertex_positions"]
            for (key,), shape in shapes.items()
            if world[key]["type"] == "mesh"
        }
        traced_mi = importlib.import_module(f"mitsuba.{TRACED}")
        self._ray, traced = traced_mi.Ray3f, _traced(traced_mi, vertices, world, prototypes)
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


def _traced(
    mi: ModuleType, vertices: Mapping[str, Float], world: Mapping[str, Any], prototypes: Prototypes
) -> dict[str, Object]:
    """All shapes without their surfaces: under their keys, as 'group_K' the prototypes, as 'place_K' the places."""
    standing = {key: len(world[key]["faces"]) for key in vertices}
    for piece in (piece for pieces in prototypes.pieces.values() for piece in pieces):
        standing[piece.key] = min(standing[piece.key], piece.first_face)
    shapes: dict[str, Object] = {
        key: _mesh(mi, vertices[key], np.asarray(world[key]["faces"])[:count])
        for key, count in standing.items()
        if count
    }
    for key, part in world.items():
        if key.startswith("shape_") and key not in vertices:
            form = {name: value for name, value in part.items() if name not in ("bsdf", "emitter")}
            if "to_world" in form:
                form["to_world"] = mi.ScalarTransform4f(np.asarray(form["to_world"], dtype=np.float64))
            shapes[key] = _loaded(form)
    groups = {}
    for k, (prototype, pieces) in enumerate(prototypes.pieces.items()):
        meshes = {f"piece_{n:06}": _piece(mi, world[piece.key], piece) for n, piece in enumerate(pieces)}
        groups[prototype] = shapes[f"group_{k}"] = _loaded({"type": "shapegroup", **meshes})
    for k, place in enumerate(prototypes.places):
        to_world = mi.ScalarTransform4f(place.to_world)
        shapes[f"place_{k}"] = _loaded({"type": "instance", "to_world": to_world, "group": groups[place.prototype]})
    return shapes


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

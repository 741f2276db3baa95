"""Prototypes that stand in many places: the search tree has each once, and what a ray meets is put to its place.

Mitsuba's own instances cost 12 to 20 ms in every kernel each: Dr.Jit records all shapes that a ray may meet, and for
an instance all shapes again.  So what is traced is made in a variant of its own (`TRACED`), whose shapes no kernel
records, and which tells what is met by numbers alone.  A table knows which face of which mesh of the variant in force
that is, and where it stands.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.render import backend

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

    def __init__(self, shapes: Mapping[tuple[str, ...], Any], world: Mapping[str, Any], prototypes: Prototypes) -> None:
        mi = backend.mitsuba()
        numbers = {key: number_of(shape, mi) for (key,), shape in shapes.items()}
        vertices = {
            key: mi.traverse(shape)["vertex_positions"]
            for (key,), shape in shapes.items()
            if world[key]["type"] == "mesh"
        }
        own_mi = importlib.import_module(f"mitsuba.{TRACED}")
        self._ray, traced = own_mi.Ray3f, _traced(own_mi, vertices, world, prototypes)
        self.scene = _made({"type": "scene", **traced})
        traced_numbers = {
            key: number_of(shape, own_mi) for key, shape in traced.items() if not key.startswith("group_")
        }
        own, first, labels, matrices = [0], [0], [-1], [np.eye(4)]  # row 0 is of nothing
        row_of = np.zeros(max(traced_numbers.values()) + 1, dtype=np.uint32)
        for key in (key for key in numbers if key in traced_numbers):
            row_of[traced_numbers[key]] = len(own)
            own, first, labels, matrices = [*own, numbers[key]], [*first, 0], [*labels, -1], [*matrices, np.eye(4)]
        for k, place in enumerate(prototypes.places):
            row_of[traced_numbers[f"place_{k}"]] = len(own)
            for piece, label in zip(prototypes.pieces[place.prototype], place.labels, strict=True):
                own.append(numbers[piece.key])
                first.append(piece.first_face)
                labels.append(label)
                matrices.append(place.to_world)
        self.label_of = np.array(labels, dtype=np.int64)
        self._row_of, self._own, self._first = _column(row_of), _column(own), _column(first)
        self._is_placed = _column(self.label_of >= 0)
        self._matrix = backend.floats(np.array(matrices)[:, :3].ravel())
        dr.make_opaque(self._row_of, self._own, self._first, self._is_placed, self._matrix)

    def ray_test(self, ray: Any, active: Any = True) -> Any:
        """As that of `mi.Scene`."""
        return self.scene.ray_test(self._as_traced(ray), active)

    def ray_intersect_preliminary(self, ray: Any, coherent: bool = False, active: Any = True) -> Any:
        """As that of `mi.Scene`; the surface that it computes is where its prototype was made, if it is of one."""
        return self._hit(ray, coherent, active)[0]

    def ray_intersect(self, ray: Any, _ray_flags: Any = None, coherent: bool = False, active: Any = True) -> Any:
        """As that of `mi.Scene`, with all flags; no instance is told."""
        return self.met(ray, coherent, active)[0]

    def met(self, ray: Any, coherent: bool = False, active: Any = True) -> tuple[Any, Any]:
        """What rays meet, and the rows by which `label_of` knows it; 0 of nothing."""
        mi = backend.mitsuba()
        hit, row = self._hit(ray, coherent, active)
        si = hit.compute_surface_interaction(ray, mi.RayFlags.All, hit.valid)
        si.t = dr.select(hit.valid, hit.t, dr.inf)
        self._put_to_place(si, ray, row, hit.valid & (dr.gather(mi.UInt32, self._is_placed, row, hit.valid) > 0))
        return si, row

    def _hit(self, ray: Any, coherent: bool, active: Any) -> tuple[Any, Any]:
        """The face that a ray meets, of the variant in force, and its row."""
        mi = backend.mitsuba()
        hit = self.scene.ray_intersect_preliminary(self._as_traced(ray), coherent, active)
        some = active & hit.is_valid()
        shape, instance = (dr.reinterpret_array(mi.UInt32, one) for one in (hit.shape, hit.instance))
        row = dr.gather(mi.UInt32, self._row_of, dr.select(instance > 0, instance, shape), some)
        row += dr.select(some & (instance > 0), hit.shape_index, 0)
        found = dr.zeros(mi.PreliminaryIntersection3f)
        found.t, found.prim_uv, found.valid = hit.t, hit.prim_uv, some
        found.prim_index = hit.prim_index + dr.gather(mi.UInt32, self._first, row, some)
        found.shape = dr.reinterpret_array(mi.ShapePtr, dr.gather(mi.UInt32, self._own, row, some))
        return found, row

    def _put_to_place(self, si: Any, ray: Any, row: Any, placed: Any) -> None:
        """Move surfaces from the coordinates of their prototypes to where these stand."""
        mi = backend.mitsuba()
        x, y, z = (dr.gather(mi.Vector4f, self._matrix, row * 3 + k, placed) for k in range(3))
        a, b, c = mi.Vector3f(x.x, y.x, z.x), mi.Vector3f(x.y, y.y, z.y), mi.Vector3f(x.z, y.z, z.z)
        across = dr.cross(b, c), dr.cross(c, a), dr.cross(a, b)  # the inverse transposed, times the determinant
        side = dr.sign(dr.dot(a, across[0]))

        def along(v: Any) -> Any:
            return a * v.x + b * v.y + c * v.z

        def upright(n: Any) -> Any:
            return mi.Normal3f(dr.normalize((across[0] * n.x + across[1] * n.y + across[2] * n.z) * side))

        si.p = dr.select(placed, mi.Point3f(along(si.p) + mi.Vector3f(x.w, y.w, z.w)), si.p)
        si.n = dr.select(placed, upright(si.n), si.n)
        si.dp_du, si.dp_dv = (dr.select(placed, along(v), v) for v in (si.dp_du, si.dp_dv))
        unmoved = mi.Frame3f(si.sh_frame)
        si.sh_frame.n = upright(si.sh_frame.n)
        si.initialize_sh_frame()
        si.sh_frame = dr.select(placed, si.sh_frame, unmoved)
        si.wi = dr.select(placed, si.sh_frame.to_local(-ray.d), si.wi)

    def _as_traced(self, ray: Any) -> Any:
        found = dr.zeros(self._ray)
        found.o, found.d, found.maxt, found.time = ray.o, ray.d, ray.maxt, ray.time
        return found


def _traced(mi: Any, vertices: Mapping[str, Any], world: Mapping[str, Any], prototypes: Prototypes) -> dict[str, Any]:
    """All shapes without their surfaces: under their keys, as 'group_K' the prototypes, as 'place_K' the places."""
    standing = {key: len(world[key]["faces"]) for key in vertices}
    for piece in (piece for pieces in prototypes.pieces.values() for piece in pieces):
        standing[piece.key] = min(standing[piece.key], piece.first_face)
    found = {
        key: _mesh(mi, vertices[key], np.asarray(world[key]["faces"])[:count])
        for key, count in standing.items()
        if count
    }
    for key, part in world.items():
        if key.startswith("shape_") and key not in vertices:
            form = {name: value for name, value in part.items() if name not in ("bsdf", "emitter")}
            if "to_world" in form:
                form["to_world"] = mi.ScalarTransform4f(np.asarray(form["to_world"], dtype=np.float64))
            found[key] = _made(form)
    groups = {}
    for k, (prototype, pieces) in enumerate(prototypes.pieces.items()):
        meshes = {f"piece_{n:06}": _piece(mi, world[piece.key], piece) for n, piece in enumerate(pieces)}
        groups[prototype] = found[f"group_{k}"] = _made({"type": "shapegroup", **meshes})
    for k, place in enumerate(prototypes.places):
        to_world = mi.ScalarTransform4f(place.to_world)
        found[f"place_{k}"] = _made({"type": "instance", "to_world": to_world, "group": groups[place.prototype]})
    return found


def _made(parts: dict[str, Any]) -> Any:
    """As `mi.load_dict`, in `TRACED`; to choose that variant for a moment takes 0.1 s, in which Mitsuba reads all its
    integrators anew.
    """
    parser = backend.mitsuba().parser
    config = parser.ParserConfig(TRACED)
    state = parser.parse_dict(config, parts)
    parser.transform_all(config, state)
    return parser.instantiate(config, state)


def _piece(mi: Any, part: Mapping[str, Any], piece: Piece) -> Any:
    """A mesh of a prototype by itself."""
    faces = np.asarray(part["faces"])[piece.first_face : piece.first_face + piece.faces] - np.uint32(piece.first_vertex)
    corners = np.asarray(part["positions"])[piece.first_vertex : piece.first_vertex + piece.vertices]
    return _mesh(mi, backend.floats(corners.ravel()), faces)


def _mesh(mi: Any, vertices: Any, faces: Any) -> Any:
    """Positions (3 V,) of the variant in force lie where they are."""
    made = mi.Mesh("traced", dr.width(vertices) // 3, len(faces))
    parameters = backend.mitsuba().traverse(made)
    parameters["vertex_positions"], parameters["faces"] = vertices, backend.numbers(faces.ravel())
    parameters.update()
    return made


def number_of(shape: Any, mi: Any) -> int:
    """Number of a shape in the renderer, of the variant `mi`."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def _column(numbers: Any) -> Any:
    """A column of the table, in memory of at least four numbers."""
    found = np.zeros(max(len(numbers), 4), dtype=np.uint32)
    found[: len(numbers)] = numbers
    return backend.numbers(found)

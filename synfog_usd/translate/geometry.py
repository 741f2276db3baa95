"""Meshes: polygons with primvars as triangles with vertex attributes.

Takes mesh prims and implicit shapes; gives triangles in the prim's own
coordinates, and parts of it by face.  Knows nothing of materials or Mitsuba.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from synfog_usd.translate.notes import Notebook
from synfog_usd.translate.subdivide import Cage, boundary_faces, levels, subdivided
from synfog_usd.translate.texture import UvSource

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

ROUND = 48
"""Segments around a cylinder, cone or capsule; its radius errs by 0.2 %."""


@dataclass(frozen=True)
class Attribute:
    """A primvar on triangle corners.

    Attributes:
        values: (K, C) float64.
        corner: (C,) index into `values` for each corner of the polygons, or None
            where it goes with the points.
    """

    values: Array
    corner: Indices | None


@dataclass(frozen=True)
class Polygons:
    """Polygons of a mesh prim, checked.

    Attributes:
        points: (N, 3) float64, prim coordinates.
        indices: point of each corner.
        triangles: (M, 3) corner numbers, counter-clockwise from outside.
        face_of: (M,) face that each triangle comes from.
        attributes: 'normals', 'st', 'color' where there are.
        smooth: whether normals are to be made from neighbours.
    """

    points: Array
    indices: Indices
    triangles: Indices
    face_of: Indices
    attributes: dict[str, Attribute]
    smooth: bool


@dataclass(frozen=True)
class Triangles:
    """Triangles with vertex attributes, ready to be placed.

    Attributes:
        positions: (N, 3) float64.
        faces: (M, 3) int64, counter-clockwise from outside.
        normals, texcoords, colors: (N, 3), (N, 2), (N, 3) or None.
    """

    positions: Array
    faces: Indices
    normals: Array | None = None
    texcoords: Array | None = None
    colors: Array | None = None


def read_mesh(prim: Usd.Prim, time: Usd.TimeCode, notes: Notebook, uv: UvSource | None = None) -> Polygons | None:
    """A mesh prim, or None with a note where it cannot be drawn.

    Args:
        uv: the primvar that the material's textures read, or None for none.
    """
    mesh, authored = UsdGeom.Mesh(prim), frozenset(prim.GetAuthoredPropertyNames())
    raw_points, raw_counts, raw_indices = (_get(prim.GetAttribute(name), time) for name in ("points", "faceVertexCounts", "faceVertexIndices"))
    if raw_points is None or raw_counts is None or raw_indices is None or not len(raw_counts):
        notes.warn(prim.GetPath(), "mesh without points or faces is left out")
        return None
    try:
        points = np.asarray(raw_points, dtype=np.float64).reshape(-1, 3)
        counts, indices = np.asarray(raw_counts, dtype=np.int64), np.asarray(raw_indices, dtype=np.int64)
    except (ValueError, TypeError):
        notes.warn(prim.GetPath(), "mesh whose points or faces are of a wrong type is left out")
        return None
    fan = _fan(counts.tobytes(), indices.tobytes()) if len(indices) <= _SMALL else None
    if fan.highest >= len(points) if fan is not None else not _fits(counts, indices, len(points)):
        notes.warn(prim.GetPath(), f"mesh whose faces name points outside of its {len(points)}, or whose counts do not fit, is left out")
        return None
    if not np.isfinite(points).all():
        notes.warn(prim.GetPath(), "mesh with points that are no finite numbers is left out")
        return None
    holes = _get(mesh.GetHoleIndicesAttr(), time) if "holeIndices" in authored else None
    keep = np.ones(len(counts), dtype=bool)
    if holes is not None and len(holes):
        numbers = np.asarray(holes, dtype=np.int64)
        keep[numbers[(numbers >= 0) & (numbers < len(counts))]] = False
    attributes: dict[str, Attribute] = {}
    wanted = {"normals", "primvars:normals", "primvars:displayColor"} | ({f"primvars:{uv.primvar}"} if uv is not None else set())
    if not authored.isdisjoint(wanted):
        reader = _PrimvarReader(prim, time, notes, indices, np.repeat(np.arange(len(counts)), counts), len(points))
        normals, color = reader.normals(mesh), reader.primvar("displayColor", 3)
        st = reader.primvar(uv.primvar, 2) if uv is not None else None
        if normals is not None:
            attributes["normals"] = normals
        if uv is not None and st is not None:
            matrix = np.array(uv.matrix)
            attributes["st"] = Attribute(st.values @ matrix[:, :2].T + matrix[:, 2], st.corner)
        if color is not None and len(color.values) > 1:
            attributes["color"] = color
    scheme = prim.GetAttribute("subdivisionScheme").Get()
    left_handed = "orientation" in authored and mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    if scheme == UsdGeom.Tokens.catmullClark and "normals" not in attributes and (counts[keep] >= 3).any():
        level = levels(len(counts))
        notes.info(prim.GetPath(), f"subdivision surface (catmullClark) is divided {level} times and lies on its limit")
        fine = _subdivided(mesh, time, points, counts, indices, keep, attributes, level, left_handed=left_handed)
        if not len(fine.triangles):
            notes.warn(prim.GetPath(), "subdivision surface of which no face is drawn (interpolateBoundary 'none', or holes) is left out")
        return fine if len(fine.triangles) else None
    if fan is not None and keep.all():
        if fan.triangles is not None and fan.face_of is not None and (fan.quads is None or _are_easy(points[fan.quads])):
            triangles, face_of = fan.triangles, fan.face_of
        else:
            triangles, face_of = _triangulate_small(points.tobytes(), counts.tobytes(), indices.tobytes())
    else:
        triangles, face_of = triangulate(points, counts, np.cumsum(counts) - counts, indices, keep)
    if not len(triangles):
        notes.warn(prim.GetPath(), "mesh without a face of three or more corners is left out")
        return None
    if left_handed:
        triangles = triangles[:, ::-1]
    smooth = scheme == UsdGeom.Tokens.loop and "normals" not in attributes
    if smooth:
        notes.info(prim.GetPath(), f"subdivision surface ({scheme}) is drawn as its control cage with smooth normals")
    elif scheme == UsdGeom.Tokens.catmullClark and "subdivisionScheme" in authored and "normals" in attributes:
        notes.info(prim.GetPath(), "subdivision surface (catmullClark) with normals of its own is drawn as its control cage with these")
    return Polygons(points, indices, triangles, face_of, attributes, smooth)


def _subdivided(
    mesh: UsdGeom.Mesh,
    time: Usd.TimeCode,
    points: Array,
    counts: Indices,
    indices: Indices,
    keep: npt.NDArray[np.bool_],
    attributes: dict[str, Attribute],
    level: int,
    *,
    left_handed: bool,
) -> Polygons:
    """A Catmull-Clark cage as triangles on its limit surface, with normals that creases part."""
    whole = counts >= 3
    corners = np.flatnonzero(np.repeat(whole, counts))
    cage = Cage(counts[whole], indices[corners], **_sharp(mesh, time, len(points)))
    rule = mesh.GetInterpolateBoundaryAttr().Get()
    cage = replace(cage, sharp_ends=rule == UsdGeom.Tokens.edgeAndCorner)
    drawn = keep[whole]
    if rule == UsdGeom.Tokens.none:
        drawn = drawn & ~boundary_faces(cage, len(points))
    fine = subdivided(points, cage, level)
    face_of = np.flatnonzero(whole)[fine.face_of]
    first = 4 * np.flatnonzero(drawn[fine.face_of])
    triangles = np.stack([first, first + 1, first + 2, first, first + 2, first + 3], axis=1).reshape(-1, 3)
    if left_handed:
        triangles = triangles[:, ::-1]
    islands = mesh.GetFaceVaryingLinearInterpolationAttr().Get() == UsdGeom.Tokens.all
    spread: dict[str, Attribute] = {}
    for name, attribute in attributes.items():
        if attribute.corner is None:
            spread[name] = Attribute(subdivided(attribute.values, cage, level).points, None)
            continue
        values = attribute.values[attribute.corner[corners]]
        with_point = np.column_stack([np.arange(len(corners)) if islands else cage.indices, values])
        _, chosen, index = np.unique(with_point, axis=0, return_index=True, return_inverse=True)
        own = subdivided(values[chosen], Cage(cage.counts, index.reshape(-1)), level)
        spread[name] = Attribute(own.points, own.indices)
    a, b, c = (fine.points[fine.indices[triangles[:, k]]] for k in range(3))
    weighted, total = cross(b - a, c - a), np.zeros((int(fine.smooth_of.max()) + 1, 3))
    for k in range(3):
        np.add.at(total, fine.smooth_of[triangles[:, k]], weighted)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    spread["normals"] = Attribute(total, None if fine.smooth_of is fine.indices else fine.smooth_of)
    return Polygons(fine.points, fine.indices, triangles, np.repeat(face_of[first // 4], 2), spread, smooth=False)


def _sharp(mesh: UsdGeom.Mesh, time: Usd.TimeCode, point_count: int) -> dict[str, Any]:
    """Creases and corners of a mesh, as `Cage` names them; what does not fit is left out."""

    def array(attribute: Usd.Attribute, kind: Any) -> Any:
        return np.asarray([] if (value := _get(attribute, time)) is None else value, dtype=kind)

    corners, at_corner = array(mesh.GetCornerIndicesAttr(), np.int64), array(mesh.GetCornerSharpnessesAttr(), np.float64)
    count = min(len(corners), len(at_corner))
    fits = (corners[:count] >= 0) & (corners[:count] < point_count)
    found: dict[str, Any] = {"corners": corners[:count][fits], "corner_sharpness": at_corner[:count][fits]}
    chain, lengths, given = (
        array(mesh.GetCreaseIndicesAttr(), np.int64),
        array(mesh.GetCreaseLengthsAttr(), np.int64),
        array(mesh.GetCreaseSharpnessesAttr(), np.float64),
    )
    edges = int((lengths - 1).sum()) if len(lengths) else 0
    if not len(chain) or (lengths < 2).any() or lengths.sum() != len(chain) or len(given) not in (len(lengths), edges):
        return found
    last = np.cumsum(lengths) - 1
    begin = np.delete(np.arange(len(chain)), last)
    pairs = np.stack([chain[begin], chain[begin + 1]], axis=1)
    sharpness = given if len(given) == edges and len(given) != len(lengths) else np.repeat(given, lengths - 1)
    fits = (pairs >= 0).all(axis=1) & (pairs < point_count).all(axis=1)
    return found | {"creases": pairs[fits], "crease_sharpness": np.maximum(sharpness[fits], 0.0)}


def triangulate(points: Array, counts: Indices, starts: Indices, indices: Indices, keep: npt.NDArray[np.bool_]) -> tuple[Indices, Indices]:
    """Triangles of simple polygons, also concave ones.

    Args:
        points: (N, 3).
        counts, starts: corners of each face, and its first corner.
        indices: point of each corner.
        keep: (F,) faces to take.

    Returns:
        (M, 3) corner numbers in the order of the faces, and (M,) the face of each.
    """
    found: list[tuple[Indices, Indices]] = []
    sizes = [int(counts[0])] if counts.min() == counts.max() else np.unique(counts[keep])
    for n in sizes:
        if n < 3:
            continue
        faces = np.flatnonzero(keep & (counts == n))
        corners = starts[faces][:, None] + np.arange(n)
        if n == 3:
            found.append((corners, faces))
            continue
        if n == 4 and _are_easy(points[indices[corners]]):
            found.append((corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), np.repeat(faces, 2)))
            continue
        reflex = _turning(points[indices[corners]]) < 0.0
        fan, easy, hard = corners, faces, faces[:0]
        if reflex.any():
            concave = reflex.any(axis=1)
            if n == 4:  # its one reflex corner sees both others
                order = (np.arange(n) + np.where(concave, reflex.argmax(axis=1), 0)[:, None]) % n
                fan = np.take_along_axis(corners, order, axis=1)
            else:
                fan, easy, hard = corners[~concave], faces[~concave], np.flatnonzero(concave)
        fans = np.stack([np.repeat(fan[:, :1], n - 2, axis=1), fan[:, 1:-1], fan[:, 2:]], axis=-1).reshape(-1, 3)
        found.append((fans, np.repeat(easy, n - 2)))
        for number in hard:
            ears = corners[number][_ears(points[indices[corners[number]]])]
            found.append((ears, np.full(len(ears), faces[number])))
    if not found:
        return np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=np.int64)
    if len(found) == 1:
        return found[0]
    triangles, face_of = np.concatenate([t for t, _ in found]), np.concatenate([f for _, f in found])
    order = np.argsort(face_of, kind="stable")
    return triangles[order], face_of[order]


_SMALL = 512
"""Corners of a mesh up to which its triangles are remembered: props come in many copies."""


@dataclass(frozen=True)
class _Fan:
    """What follows from the counts and indices of a mesh alone.

    Attributes:
        highest: highest point that a face names; no mesh has as many points where counts and indices do not fit.
        triangles, face_of: as `triangulate` gives them where no quad is concave; None for faces of other sizes.
        quads: (Q, 4) points of the quads, which must be looked at; None where there is none.
    """

    highest: int
    triangles: Indices | None = None
    face_of: Indices | None = None
    quads: Indices | None = None


def _fits(counts: Indices, indices: Indices, point_count: int) -> bool:
    return bool(len(indices) and counts.min() >= 0 and counts.sum() == len(indices) and indices.min() >= 0 and indices.max() < point_count)


@functools.lru_cache(maxsize=1024)
def _fan(counts: bytes, indices: bytes) -> _Fan:
    """The same for all meshes of one topology, given by the bytes of its arrays."""
    sizes, points = np.frombuffer(counts, dtype=np.int64), np.frombuffer(indices, dtype=np.int64)
    if not _fits(sizes, points, 1 << 62):
        return _Fan(1 << 62)
    highest = int(points.max())
    if not (sizes == sizes[0]).all() or sizes[0] not in (3, 4):
        return _Fan(highest)
    corners = np.arange(len(points)).reshape(-1, int(sizes[0]))
    if sizes[0] == 3:
        return _Fan(highest, corners, np.arange(len(sizes)))
    return _Fan(highest, corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), np.repeat(np.arange(len(sizes)), 2), points.reshape(-1, 4))


@functools.lru_cache(maxsize=1024)
def _triangulate_small(points: bytes, counts: bytes, indices: bytes) -> tuple[Indices, Indices]:
    """`triangulate` of all faces of a mesh, given by the bytes of its arrays."""
    numbers = np.frombuffer(counts, dtype=np.int64)
    keep = np.ones(len(numbers), dtype=bool)
    return triangulate(np.frombuffer(points).reshape(-1, 3), numbers, np.cumsum(numbers) - numbers, np.frombuffer(indices, dtype=np.int64), keep)


def _are_easy(quads: Array) -> bool:
    """Whether all (F, 4, 3) quads are convex without doubt: each corner turns the way of the others."""
    edges = quads[:, _NEXT] - quads
    turn = cross(edges[:, _BEFORE], edges)
    return bool((np.einsum("fi,fki->fk", turn[:, 0] + turn[:, 2], turn) > 0.0).all())


_NEXT, _BEFORE = [1, 2, 3, 0], [3, 0, 1, 2]


def _turning(polygons: Array) -> Array:
    """(F, n): how far each corner turns to the left as seen from the face's normal (Newell); < 0 is reflex."""
    order = np.arange(polygons.shape[1])
    edges = polygons[:, np.append(order[1:], 0)] - polygons
    arms = polygons - polygons[:, :1]
    normal = cross(arms[:, 1:-1], arms[:, 2:]).sum(axis=1)
    turn = np.einsum("fni,fi->fn", cross(edges[:, order - 1], edges), normal)
    limit = 1e-9 * np.einsum("fi,fi->f", normal, normal)
    return np.where(np.abs(turn) <= limit[:, None], 0.0, turn)


def _ears(polygon: Array) -> Indices:
    """Ear clipping of one simple polygon (n, 3); (n - 2, 3) corner numbers."""
    arms = polygon - polygon[0]
    normal = cross(arms[1:-1], arms[2:]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(polygon, axis, axis=1)
    if (normal[axis] < 0) != (axis == 1):
        flat = flat * [-1.0, 1.0]
    left, triangles = list(range(len(flat))), []
    while len(left) > 3:
        best, best_quality = None, -np.inf
        for place, middle in enumerate(left):
            before, after = left[place - 1], left[(place + 1) % len(left)]
            a, b, c = flat[before], flat[middle], flat[after]
            area = _cross2(b - a, c - b)
            if area <= 0.0:
                continue
            others = flat[[k for k in left if k not in (before, middle, after)]]
            inside = (_cross2(b - a, others - a) >= 0) & (_cross2(c - b, others - b) >= 0) & (_cross2(a - c, others - c) >= 0)
            same = (np.abs(others[:, None] - np.array([a, b, c])[None]).max(axis=2) == 0).any(axis=1)
            if not (inside & ~same).any():
                quality = area / max(np.sum((b - a) ** 2), np.sum((c - b) ** 2), np.sum((a - c) ** 2))
                if quality > best_quality:
                    best, best_quality = place, quality
        place = best if best is not None else 0  # no ear: the polygon cuts itself or has no area
        triangles.append((left[place - 1], left[place], left[(place + 1) % len(left)]))
        del left[place]
    return np.array([*triangles, tuple(left)], dtype=np.int64)


def cross(u: Array, v: Array) -> Array:
    """Cross product along the last axis; five times faster than numpy's on small arrays."""
    result = np.empty(u.shape if u.shape == v.shape else np.broadcast_shapes(u.shape, v.shape))
    x, y, z, a, b, c = u[..., 0], u[..., 1], u[..., 2], v[..., 0], v[..., 1], v[..., 2]
    result[..., 0], result[..., 1], result[..., 2] = y * c - z * b, z * a - x * c, x * b - y * a
    return result


def determinant(matrix: Array) -> float:
    """Determinant of the linear part of a matrix; ten times faster than numpy's."""
    (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3].tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def _cross2(u: Array, v: Array) -> Any:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def part(polygons: Polygons, faces: npt.NDArray[np.bool_] | None, *, smooth_normals: Array | None = None) -> Triangles | None:
    """The triangles of some faces, with one set of vertices for all attributes.

    Args:
        polygons: the mesh.
        faces: (F,) which faces; None for all.
        smooth_normals: (N, 3) normals of the points, from `point_normals`.
    """
    triangles = polygons.triangles
    if faces is not None:
        triangles = triangles[faces[polygons.face_of]]
    if not len(triangles):
        return None
    corners = triangles.reshape(-1)
    point = polygons.indices[corners]
    split = [a.corner[corners] for a in polygons.attributes.values() if a.corner is not None]
    if not split and faces is None:
        chosen, vertex = None, point
    else:
        key = point
        for index in split:
            key = key * (int(index.max()) + 1) + index if int(key.max()) < 2**62 // (int(index.max()) + 1) else np.arange(len(key))
        _, chosen, vertex = np.unique(key, return_index=True, return_inverse=True)
        vertex = vertex.reshape(-1)

    def at_vertices(attribute: Attribute) -> Array:
        if attribute.corner is None:
            return attribute.values if chosen is None else attribute.values[point[chosen]]
        assert chosen is not None
        return attribute.values[attribute.corner[corners][chosen]]

    values = {name: at_vertices(attribute) for name, attribute in polygons.attributes.items()}
    positions = polygons.points if chosen is None else polygons.points[point[chosen]]
    normals = values.get("normals")
    if normals is None and smooth_normals is not None:
        normals = smooth_normals if chosen is None else smooth_normals[point[chosen]]
    return Triangles(positions, vertex.reshape(-1, 3), normals, values.get("st"), values.get("color"))


def point_normals(polygons: Polygons) -> Array:
    """(N, 3) unit normals of the points: mean of the faces around, by area."""
    faces = polygons.indices[polygons.triangles]
    a, b, c = (polygons.points[faces[:, k]] for k in range(3))
    weighted = cross(b - a, c - a)
    total = np.zeros_like(polygons.points)
    for k in range(3):
        np.add.at(total, faces[:, k], weighted)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)


class _PrimvarReader:
    def __init__(self, prim: Usd.Prim, time: Usd.TimeCode, notes: Notebook, indices: Indices, corner_face: Indices, point_count: int) -> None:
        self.prim, self.time, self.notes = prim, time, notes
        self.indices, self.corner_face, self.point_count = indices, corner_face, point_count
        self.api = UsdGeom.PrimvarsAPI(prim)

    def normals(self, mesh: UsdGeom.Mesh) -> Attribute | None:
        found = self.primvar("normals", 3)
        if found is None:
            attribute = mesh.GetNormalsAttr()
            values = _get(attribute, self.time) if attribute.HasAuthoredValue() else None
            if values is not None and len(values):
                found = self.spread("normals", values, mesh.GetNormalsInterpolation(), None, 3)
        if found is None or not np.isfinite(found.values).all():
            return None
        lengths = np.linalg.norm(found.values, axis=1, keepdims=True)
        return None if not (lengths > 1e-12).all() else Attribute(found.values / lengths, found.corner)

    def primvar(self, name: str, width: int) -> Attribute | None:
        if not self.prim.HasAttribute(f"primvars:{name}"):
            return None
        primvar = self.api.GetPrimvar(name)
        if not primvar.HasAuthoredValue():
            return None
        values = _get(primvar.GetAttr(), self.time)
        if values is None or not len(values):
            return None
        indices = primvar.GetIndices(self.time) if primvar.IsIndexed() else None
        return self.spread(name, values, primvar.GetInterpolation(), indices, width)

    def spread(self, name: str, values: Any, interpolation: str, indices: Any, width: int) -> Attribute | None:
        array = _columns(values, width)
        if array is None:
            self.notes.warn(self.prim.GetPath(), f"primvar {name} does not hold {width} numbers each; it is not used")
            return None
        corner: Indices | None
        if interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
            corner, wanted = None, self.point_count
        elif interpolation == UsdGeom.Tokens.faceVarying:
            corner, wanted = np.arange(len(self.indices)), len(self.indices)
        elif interpolation == UsdGeom.Tokens.uniform:
            corner, wanted = self.corner_face, int(self.corner_face[-1]) + 1
        else:
            corner, wanted = np.zeros(len(self.indices), dtype=np.int64), 1
        if indices is not None:
            numbers = np.asarray(indices, dtype=np.int64)
            fits = len(numbers) >= wanted and (not len(numbers) or (numbers.min() >= 0 and numbers.max() < len(array)))
            corner = numbers[self.indices if corner is None else corner] if fits else corner
        else:
            fits = len(array) >= wanted
        if not fits:
            self.notes.warn(self.prim.GetPath(), f"primvar {name} has too few values for its interpolation {interpolation!r}; it is not used")
            return None
        return Attribute(array[:wanted] if corner is None else array, corner)


def _columns(values: Any, width: int) -> Array | None:
    """(K, width) of an array of tuples that are at least as wide, or of plain numbers in groups of `width`; else None."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError):
        return None
    if array.ndim == 2 and array.shape[1] >= width:
        return array[:, :width]
    if array.ndim == 1 and array.size % width == 0:
        return array.reshape(-1, width)
    return None


def _get(attribute: Usd.Attribute, time: Usd.TimeCode) -> Any:
    """A value at a time; where only time samples exist and none is asked for, the first."""
    value = attribute.Get(time)
    return attribute.Get(Usd.TimeCode.EarliestTime()) if value is None and attribute.GetNumTimeSamples() else value


# -- implicit shapes -------------------------------------------------------------------------------------------------


def read_implicit(prim: Usd.Prim, kind: str, time: Usd.TimeCode) -> Triangles:
    """A Cube, Sphere, Cylinder, Cone, Capsule or Plane as triangles in its own coordinates."""

    def number(name: str, default: float) -> float:
        attribute = prim.GetAttribute(name)
        value = attribute.Get(time) if attribute else None
        return float(default if value is None else value)

    if kind == "Cube":
        return cube(number("size", 2.0) / 2.0)
    if kind == "Sphere":
        return ball(number("radius", 1.0))
    axis = prim.GetAttribute("axis").Get() if prim.HasAttribute("axis") else "Z"
    if kind == "Plane":
        width, length = number("width", 2.0), number("length", 2.0)
        corners = np.array([[-width / 2, -length / 2, 0], [width / 2, -length / 2, 0], [width / 2, length / 2, 0], [-width / 2, length / 2, 0]])
        made = Triangles(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0.0, 0.0, 1.0], (4, 1)))
    else:
        height = number("height", 2.0 if kind in ("Cylinder", "Cylinder_1", "Cone") else 1.0)
        radius = number("radius", 0.5 if kind.startswith("Capsule") else 1.0)
        if kind == "Cone":
            bottom, top = radius, 0.0
        elif kind.endswith("_1"):
            bottom, top = number("radiusBottom", radius), number("radiusTop", radius)
        else:
            bottom = top = radius
        made = capsule(height, bottom, top) if kind.startswith("Capsule") else frustum(height, bottom, top)
    turn = (_PLANE_TURN if kind == "Plane" else _AXIS_TURN).get(str(axis), np.eye(3))
    return Triangles(made.positions @ turn.T, made.faces, None if made.normals is None else made.normals @ turn.T)


_AXIS_TURN = {"X": np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]), "Y": np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])}
_PLANE_TURN = {"X": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), "Y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])}
"""From Z to the axis; a plane about X has its width along Z, about Y its length."""


def cube(half: float) -> Triangles:
    """A cube of half size `half`, flat."""
    corners = np.array([[x, y, z] for x in (-half, half) for y in (-half, half) for z in (-half, half)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return Triangles(corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def ball(radius: float) -> Triangles:
    """A sphere of revolution about Z with exact normals."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, ROUND // 2 + 1)
    made = _revolved(np.cos(angles), np.sin(angles), np.cos(angles), np.sin(angles))
    return Triangles(made.positions * radius, made.faces, made.normals)


def frustum(height: float, bottom: float, top: float) -> Triangles:
    """A cylinder or cone along Z, centred, with flat caps."""
    slope = np.array([height, bottom - top]) / max(np.hypot(height, bottom - top), 1e-300)
    rings = [
        _revolved(np.array([0.0, bottom]), np.array([-height / 2] * 2), np.zeros(2), -np.ones(2)),
        _revolved(np.array([bottom, top]), np.array([-height / 2, height / 2]), np.full(2, slope[0]), np.full(2, slope[1])),
        _revolved(np.array([top, 0.0]), np.array([height / 2] * 2), np.zeros(2), np.ones(2)),
    ]
    return _joined(rings)


def capsule(height: float, bottom: float, top: float) -> Triangles:
    """A cylinder along Z of length `height` with half balls on its ends."""
    low, high = np.linspace(-np.pi / 2, 0.0, ROUND // 4 + 1), np.linspace(0.0, np.pi / 2, ROUND // 4 + 1)
    radius = np.concatenate([bottom * np.cos(low), top * np.cos(high)])
    z = np.concatenate([bottom * np.sin(low) - height / 2, top * np.sin(high) + height / 2])
    angle = np.concatenate([low, high])
    return _revolved(radius, z, np.cos(angle), np.sin(angle))


def _revolved(radius: Array, z: Array, normal_r: Array, normal_z: Array) -> Triangles:
    """A profile (from low to high) turned about Z; triangles of no area left out."""
    around = np.arange(ROUND) * (2 * np.pi / ROUND)
    x, y = np.cos(around), np.sin(around)
    positions = np.stack([np.outer(radius, x), np.outer(radius, y), np.repeat(z[:, None], ROUND, axis=1)], axis=-1)
    normals = np.stack([np.outer(normal_r, x), np.outer(normal_r, y), np.repeat(normal_z[:, None], ROUND, axis=1)], axis=-1)
    row, column = np.meshgrid(np.arange(len(z) - 1), np.arange(ROUND), indexing="ij")
    a, b = row * ROUND + column, row * ROUND + (column + 1) % ROUND
    c, d = b + ROUND, a + ROUND
    small = 1e-12 * max(float(np.abs(radius).max()), 1e-300)
    lower, upper = radius[:-1][row] > small, radius[1:][row] > small
    faces = np.concatenate([np.stack([a, b, c], axis=-1)[lower], np.stack([a, c, d], axis=-1)[upper]])
    return Triangles(positions.reshape(-1, 3), faces.astype(np.int64), normals.reshape(-1, 3))


def _joined(parts: list[Triangles]) -> Triangles:
    offsets = np.cumsum([0, *[len(p.positions) for p in parts[:-1]]])
    return Triangles(
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=True)]),
        np.concatenate([p.normals for p in parts if p.normals is not None]),
    )


# -- placing ---------------------------------------------------------------------------------------------------------


def placed(triangles: Triangles, matrix: Array) -> Triangles:
    """Triangles under a matrix; a mirroring one turns the winding, so that outside stays outside."""
    linear = matrix[:3, :3]
    positions = triangles.positions @ linear.T + matrix[:3, 3]
    size = determinant(matrix)
    faces = triangles.faces[:, ::-1] if size < 0.0 else triangles.faces
    normals = None
    if triangles.normals is not None and size != 0.0:
        normals = triangles.normals @ np.linalg.inv(linear)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return Triangles(positions, faces, normals, triangles.texcoords, triangles.colors)


def area(triangles: Triangles) -> float:
    """Total area of the triangles."""
    a, b, c = (triangles.positions[triangles.faces[:, k]] for k in range(3))
    return float(np.linalg.norm(cross(b - a, c - a), axis=1).sum() / 2.0)


def mesh_shape(triangles: Triangles, bsdf: str, *, textured: bool, colored: bool) -> dict[str, Any]:
    """The scene's word for triangles: float32 vertices, a reference to a material."""
    shape: dict[str, Any] = {
        "type": "mesh",
        "positions": triangles.positions.astype(np.float32),
        "faces": np.ascontiguousarray(triangles.faces, dtype=np.uint32),
        "face_normals": triangles.normals is None,
        "bsdf": {"type": "ref", "id": bsdf},
    }
    if triangles.normals is not None:
        shape["normals"] = triangles.normals.astype(np.float32)
    if textured and triangles.texcoords is not None:
        shape["texcoords"] = triangles.texcoords.astype(np.float32)
    if colored and triangles.colors is not None:
        shape["vertex_color"] = triangles.colors.astype(np.float32)
    return shape

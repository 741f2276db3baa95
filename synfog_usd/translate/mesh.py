"""Meshes: polygons with primvars, and subdivision surfaces, as triangles.

Takes mesh prims; gives `Polygons` in the prim's own coordinates.  Knows nothing of
materials or Mitsuba.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np
from pxr import Usd

from synfog_usd.base.arrays import Array, Flags, Indices, distinct
from synfog_usd.translate import finite
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Attribute, Polygons, cross
from synfog_usd.translate.polygons import SMALL, Topology, are_easy, topology, triangulate, triangulate_small
from synfog_usd.translate.primvars import ORIENTATIONS, PrimvarReader, value_at
from synfog_usd.translate.space import FAR_POINT
from synfog_usd.translate.subdivide import INFINITE, Cage, Fine, boundary_faces, cut_apart, levels, subdivided
from synfog_usd.translate.texture import UvSource


@dataclass(slots=True)
class Arrays:
    """Points and faces of a mesh prim.

    Attributes:
        authored: names of its authored properties.
        points: (N, 3) float64, prim coordinates.
        topology: its faces.
        fault: why it cannot be drawn; '' where it can.
        easy: whether its quads are all convex.
    """

    authored: frozenset[str]
    points: Array
    topology: Topology
    fault: str = ""
    easy: bool = False


_NOTHING = np.empty((0, 3)), topology(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))


_ARRAYS = ("points", "faceVertexCounts", "faceVertexIndices")


def read_arrays(prim: Usd.Prim, time: Usd.TimeCode, authored: frozenset[str] | None = None) -> Arrays:
    """The points and faces of a mesh prim.

    Args:
        authored: names of its authored properties, where they are at hand.
    """
    names = frozenset(prim.GetAuthoredPropertyNames()) if authored is None else authored
    raw_points, raw_counts, raw_indices = (value_at(prim.GetAttribute(name), time) for name in _ARRAYS)
    if raw_points is None or raw_counts is None or raw_indices is None or not len(raw_counts):
        return Arrays(names, *_NOTHING, "mesh without points or faces is left out")
    try:
        points = np.asarray(raw_points, dtype=np.float64).reshape(-1, 3)
        faces = topology(np.asarray(raw_counts, dtype=np.int64), np.asarray(raw_indices, dtype=np.int64))
    except (ValueError, TypeError):
        return Arrays(names, *_NOTHING, "mesh whose points or faces are of a wrong type is left out")
    fault = ""
    if faces.highest >= len(points):
        fault = f"mesh whose faces name points outside of its {len(points)}, or whose counts do not fit, is left out"
    elif not (len(points) == 0 or max(points.max(), -points.min()) <= FAR_POINT):
        fault = "mesh with points that are no finite numbers, or of more than 12 digits, is left out"
    return Arrays(names, points, faces, fault)


def look_at_quads(meshes: Iterable[Arrays]) -> None:
    """Mark the meshes all of whose quads are convex; those of one topology are tested together."""
    by_topology: dict[tuple[Topology, int], list[Arrays]] = {}
    for mesh in meshes:
        if mesh.topology.quads is not None and not mesh.fault:
            by_topology.setdefault((mesh.topology, len(mesh.points)), []).append(mesh)
    for (faces, _), some in by_topology.items():
        quads = np.stack([mesh.points for mesh in some])[:, faces.quads]
        easy = np.all(are_easy(quads.reshape(-1, 4, 3)).reshape(len(some), -1), axis=1)
        for mesh, verdict in zip(some, easy, strict=True):
            mesh.easy = bool(verdict)


_NORMALS = frozenset({"normals", "primvars:normals"})

_SCHEMES = ("none", "catmullClark", "loop", "bilinear")

_SEAMS = ("all", "none", "boundaries", "cornersOnly", "cornersPlus1", "cornersPlus2")


def read_mesh(
    prim: Usd.Prim,
    time: Usd.TimeCode,
    notes: Diagnostics,
    uv: UvSource | None = None,
    *,
    color: str | None = "displayColor",
    arrays: Arrays | None = None,
) -> Polygons | None:
    """A mesh prim, or None with a note where it cannot be drawn.

    Args:
        uv: the primvar that the material's textures read, or None for none.
        color: the primvar of its colours, or None for none.
        arrays: of this prim at this time, where they are at hand.
    """
    if arrays is None:
        arrays = read_arrays(prim, time)
        look_at_quads([arrays])
    if arrays.fault:
        notes.warn(prim.GetPath(), arrays.fault)
        return None
    return _MeshReader(prim, time, notes, arrays).read(uv, color)


class _MeshReader:
    """Polygons of one mesh prim whose points and faces fit."""

    def __init__(self, prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics, arrays: Arrays) -> None:
        self.prim, self.time, self.notes, self.arrays = prim, time, notes, arrays
        self.counts, self.indices = arrays.topology.counts, arrays.topology.indices
        self.keep = self._kept_faces()
        self.left_handed = False

    def read(self, uv: UvSource | None, color: str | None) -> Polygons | None:
        attributes = self._attributes(uv, color)
        self.left_handed = self._token("orientation", ORIENTATIONS, "rightHanded") == "leftHanded"
        scheme = self._token("subdivisionScheme", _SCHEMES, "catmullClark", "none")
        named = "subdivisionScheme" in self.arrays.authored
        whole = self.counts >= 3 if self.keep is None else self.keep & (self.counts >= 3)
        divided = ("normals" not in attributes or named) and scheme != "none" and bool(whole.any())
        if divided and scheme == "catmullClark":
            return self._subdivided(attributes)
        if divided:
            how = "with smooth normals" if scheme == "loop" else "as it stands"
            self.notes.warn(self.prim.GetPath(), f"subdivision surface ({scheme}) is drawn as its control cage {how}")
        polygons = self._polygons(attributes, smooth=divided and scheme == "loop")
        if polygons is not None and not named and "normals" in attributes:
            self.notes.info(
                self.prim.GetPath(),
                "names no subdivisionScheme, whose fallback is catmullClark, and has normals, which only polygons "
                "have: it is drawn as polygons",
            )
        return polygons

    def _token(self, name: str, allowed: Collection[str], default: str, fallback: str = "") -> str:
        """A token of the prim: the default where none is authored, the fallback for one that is not allowed."""
        value = self.prim.GetAttribute(name).Get() if name in self.arrays.authored else default
        return self.notes.token(self.prim.GetPath(), name, value, allowed, fallback or default)

    def _kept_faces(self) -> Flags | None:
        """(F,) faces that are no holes; None for a mesh without holes."""
        authored = "holeIndices" in self.arrays.authored
        holes = value_at(self.prim.GetAttribute("holeIndices"), self.time) if authored else None
        if holes is None or not len(holes):
            return None
        keep, numbers = np.ones(len(self.counts), dtype=bool), np.asarray(holes, dtype=np.int64)
        there = (numbers >= 0) & (numbers < len(self.counts))
        keep[numbers[there]] = False
        if not there.all():
            self.notes.warn(
                self.prim.GetPath(),
                f"{int((~there).sum())} of its {len(there)} holes name no face of its {len(self.counts)}",
            )
        return keep

    def _attributes(self, uv: UvSource | None, color: str | None) -> dict[str, Attribute]:
        """Normals, texture coordinates and colours, as far as there are any."""
        names = _NORMALS | {f"primvars:{color}"} | ({f"primvars:{uv.primvar}"} if uv is not None else set())
        if self.arrays.authored.isdisjoint(names):
            return {}
        path, counts = self.prim.GetPath(), self.counts
        corner_face = np.repeat(np.arange(len(counts)), counts)
        points = len(self.arrays.points)
        reader = PrimvarReader(self.prim, self.time, self.notes, self.indices, corner_face, points)
        normals, colors = reader.normals(), reader.primvar(color, 3) if color is not None else None
        st = reader.primvar(uv.primvar, 2) if uv is not None else None
        attributes: dict[str, Attribute] = {}
        if normals is not None:
            attributes["normals"] = normals
        if uv is not None and st is not None:
            matrix = np.array(uv.matrix)
            values = finite.of_array(st.values, "texcoords", path, self.notes)
            attributes["st"] = replace(st, values=values @ matrix[:, :2].T + matrix[:, 2])
        if colors is not None:
            values = finite.of_array(colors.values, "vertex_color", path, self.notes)
            attributes["color"] = replace(colors, values=values)
        return attributes

    def _polygons(self, attributes: dict[str, Attribute], *, smooth: bool) -> Polygons | None:
        """The faces as triangles, or None with a note where there are none."""
        arrays, fan, counts, indices = self.arrays, self.arrays.topology, self.counts, self.indices
        faces, crossed = None, indices[:0]
        if self.keep is None and len(indices) <= SMALL:
            if fan.triangles is not None and fan.face_of is not None and (fan.quads is None or arrays.easy):
                triangles, face_of, faces = fan.triangles, fan.face_of, fan.faces
            else:
                triangles, face_of, crossed = triangulate_small(
                    arrays.points.tobytes(), counts.tobytes(), indices.tobytes()
                )
        else:
            chosen = np.ones(len(counts), dtype=bool) if self.keep is None else self.keep
            starts = np.cumsum(counts) - counts
            triangles, face_of, crossed = triangulate(arrays.points, counts, starts, indices, chosen)
        path = self.prim.GetPath()
        if len(crossed):
            self.notes.warn(
                path,
                f"{len(crossed)} of its faces, number {crossed[0]} first, have edges that cross; what they cover is a "
                f"guess: cut them in two",
            )
        if not len(triangles):
            self.notes.warn(path, "mesh without a face of three or more corners is left out")
            return None
        if self.left_handed:
            triangles, faces = triangles[:, ::-1], None
        if "normals" in attributes and not (with_length := attributes["normals"].values.any(axis=1)).all():
            self.notes.info(
                path,
                f"{int((~with_length).sum())} of its normals have no length; those are made from the faces around",
            )
            attributes["normals"] = _mended(attributes["normals"], arrays.points, indices, triangles)
        return Polygons(arrays.points, indices, triangles, face_of, attributes, smooth, faces)

    def _subdivided(self, attributes: dict[str, Attribute]) -> Polygons | None:
        """The cage as triangles on its limit surface, with normals that creases part; None with a note where no face is
        drawn.
        """
        counts, notes, path = self.counts, self.notes, self.prim.GetPath()
        level = levels(len(counts), even=bool((counts[counts >= 3] == 4).all()))
        unused = ""
        if attributes.pop("normals", None) is not None:
            unused = "; normals of its own are not used, as UsdGeom says of what is divided"
        how = f"is divided {level} times" if level else f"has {len(counts)} faces, is not divided further"
        notes.info(path, f"subdivision surface (catmullClark) {how} and lies on its limit{unused}")
        whole = counts >= 3
        corners = np.flatnonzero(np.repeat(whole, counts))
        cage = self._cage(counts[whole], self.indices[corners])
        rule = self._token("interpolateBoundary", ("none", "edgeOnly", "edgeAndCorner"), "edgeAndCorner")
        smooth = self._token("triangleSubdivisionRule", ("catmullClark", "smooth"), "catmullClark")
        cage = replace(cage, sharp_ends=rule == "edgeAndCorner", smooth_triangles=smooth == "smooth")
        visible = np.ones(int(whole.sum()), dtype=bool) if self.keep is None else self.keep[whole]
        if rule == "none":
            visible = visible & ~boundary_faces(cage, len(self.arrays.points))
        fine = subdivided(self.arrays.points, cage, level)
        chosen = np.flatnonzero(visible[fine.face_of])
        if not len(chosen):
            notes.warn(
                path,
                "subdivision surface of which no face is drawn (interpolateBoundary 'none', or holes) is left out",
            )
            return None
        triangles: Indices = (4 * chosen[:, None] + np.array([0, 1, 2, 0, 2, 3])).reshape(-1, 3)
        if self.left_handed:
            triangles = triangles[:, ::-1]
        seams = self._token("faceVaryingLinearInterpolation", _SEAMS, "cornersPlus1")
        spread = {
            name: _divided_attribute(attribute, cage, corners, level, seams) for name, attribute in attributes.items()
        }
        spread["normals"] = _limit_normals(fine, triangles)
        face_of = np.flatnonzero(whole)[fine.face_of]
        return Polygons(fine.points, fine.indices, triangles, np.repeat(face_of[chosen], 2), spread, smooth=False)

    def _cage(self, counts: Indices, indices: Indices) -> Cage:
        """The control cage with its creases and corners; what does not fit is left out, with a note."""
        corners, corner_sharpness = self._corners()
        creases, crease_sharpness = self._creases()
        cage = Cage(counts, indices, creases, crease_sharpness, corners, corner_sharpness)
        if stray := _strays(cage, len(self.arrays.points)):
            self.notes.warn(
                self.prim.GetPath(), f"{stray} edges of its creases are no edges of its faces; they are left out"
            )
        return cage

    def _integers(self, name: str) -> Indices:
        value = value_at(self.prim.GetAttribute(name), self.time)
        return np.asarray([] if value is None else value, dtype=np.int64)

    def _sharpness(self, name: str) -> Array:
        value = value_at(self.prim.GetAttribute(name), self.time)
        return np.asarray([] if value is None else value, dtype=np.float64)

    def _corners(self) -> tuple[Indices, Array]:
        """Sharp points and their sharpness."""
        corners, sharpness = self._integers("cornerIndices"), self._sharpness("cornerSharpnesses")
        count = min(len(corners), len(sharpness))
        fits = (corners[:count] >= 0) & (corners[:count] < len(self.arrays.points))
        if not fits.all() or len(corners) != len(sharpness):
            lost = len(corners) - int(fits.sum())
            self.notes.warn(
                self.prim.GetPath(),
                f"{lost} of its {len(corners)} sharp corners name no point or have no sharpness",
            )
        return corners[:count][fits], self._at_least_smooth(sharpness[:count][fits], "cornerSharpnesses")

    def _creases(self) -> tuple[Indices, Array]:
        """(K, 2) points of sharp edges and their sharpness."""
        chain, lengths = self._integers("creaseIndices"), self._integers("creaseLengths")
        sharpness, path = self._sharpness("creaseSharpnesses"), self.prim.GetPath()
        none = np.empty((0, 2), dtype=np.int64), np.empty(0)
        edges = int((lengths - 1).sum()) if len(lengths) else 0
        if not len(chain):
            return none
        if (lengths < 2).any() or lengths.sum() != len(chain) or len(sharpness) not in (len(lengths), edges):
            self.notes.warn(
                path, "its creases' indices, lengths and sharpnesses do not fit each other; no crease is drawn"
            )
            return none
        last = np.cumsum(lengths) - 1
        begin = np.delete(np.arange(len(chain)), last)
        pairs = np.stack([chain[begin], chain[begin + 1]], axis=1)
        if len(sharpness) != edges or len(sharpness) == len(lengths):
            sharpness = np.repeat(sharpness, lengths - 1)
        points = len(self.arrays.points)
        fits = (pairs >= 0).all(axis=1) & (pairs < points).all(axis=1)
        if not fits.all():
            self.notes.warn(
                path,
                f"{int((~fits).sum())} edges of its creases name points outside of its {points}; they are left out",
            )
        return pairs[fits], self._at_least_smooth(sharpness, "creaseSharpnesses")[fits]

    def _at_least_smooth(self, sharpness: Array, name: str) -> Array:
        """Sharpnesses with 0 where one is negative or no number, and a note."""
        fits = sharpness >= 0.0
        if not fits.all():
            self.notes.warn(
                self.prim.GetPath(),
                f"{int((~fits).sum())} of its {name} are no sharpness, {sharpness[~fits][0]:g} first; 0 is taken",
            )
        return np.where(fits, sharpness, 0.0)


def _mended(normals: Attribute, points: Array, indices: Indices, triangles: Indices) -> Attribute:
    """Normals with those of no length made from the faces that use them, by area; up where there is none."""
    user = (indices if normals.corner is None else normals.corner)[triangles]
    a, b, c = (points[indices[triangles[:, k]]] for k in range(3))
    weighted, total = cross(b - a, c - a), np.zeros_like(normals.values)
    for k in range(3):
        np.add.at(total, user[:, k], weighted)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    from_faces = np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
    return Attribute(np.where(normals.values.any(axis=1, keepdims=True), normals.values, from_faces), normals.corner)


def _divided_attribute(attribute: Attribute, cage: Cage, corners: Indices, level: int, seams: str) -> Attribute:
    """A primvar on a divided cage.

    Args:
        corners: those of the mesh that the cage's corners are.
        seams: UsdGeom's faceVaryingLinearInterpolation.
    """
    if attribute.corner is None:
        return Attribute(subdivided(attribute.values, _unbent(cage) if attribute.linear else cage, level).points, None)
    values = attribute.values[attribute.corner[corners]]
    islands = np.arange(len(corners)) if seams == "all" else 0 * cage.indices
    with_point = np.column_stack([cage.indices, islands, values])
    _, unique, index = np.unique(with_point, axis=0, return_index=True, return_inverse=True)
    cut = cut_apart(cage, index.reshape(-1), seams)
    fine = subdivided(values[unique], _unbent(cut) if attribute.linear else cut, level)
    return Attribute(fine.points, fine.indices)


def _limit_normals(fine: Fine, triangles: Indices) -> Attribute:
    """Normals of a limit surface, by the area of the triangles around, that creases part."""
    a, b, c = (fine.points[fine.indices[triangles[:, k]]] for k in range(3))
    weighted, total = cross(b - a, c - a), np.zeros((int(fine.smooth_of.max()) + 1, 3))
    for k in range(3):
        np.add.at(total, fine.smooth_of[triangles[:, k]], weighted)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    return Attribute(total, None if fine.smooth_of is fine.indices else fine.smooth_of)


def _unbent(cage: Cage) -> Cage:
    """A cage on which everything is sharp for ever, so that values run evenly within its faces."""
    points = distinct(cage.indices)
    return replace(
        cage,
        creases=_edges(cage),
        crease_sharpness=np.full(len(cage.indices), INFINITE),
        corners=points,
        corner_sharpness=np.full(len(points), INFINITE),
    )


def _edges(cage: Cage) -> Indices:
    """(K, 2) points of the edge from each corner of a cage to the next."""
    following = np.arange(len(cage.indices)) + 1
    last = np.cumsum(cage.counts) - 1
    following[last] = last + 1 - cage.counts
    return np.stack([cage.indices, cage.indices[following]], axis=1)


def _strays(cage: Cage, point_count: int) -> int:
    """How many creases of a cage are no edges of it."""
    if not len(cage.creases):
        return 0
    edges, creases = (np.sort(pairs, axis=1) @ np.array([point_count, 1]) for pairs in (_edges(cage), cage.creases))
    return int((~np.isin(creases, edges)).sum())

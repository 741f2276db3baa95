"""Meshes: polygons with primvars, and subdivision surfaces, as triangles.

Takes mesh prims; gives `Polygons` in the prim's own coordinates.  Knows nothing of
materials or Mitsuba.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from synfog_usd.base.arrays import Array, Indices, distinct
from synfog_usd.translate import finite, loop
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Attribute, Polygons, cross
from synfog_usd.translate.polygons import SMALL, Topology, are_easy, topology, triangulate, triangulate_small
from synfog_usd.translate.primvars import ORIENTATIONS, PrimvarReader, value_at
from synfog_usd.translate.space import FAR_POINT
from synfog_usd.translate.subdivide import INFINITE, Cage, bilinear, boundary_faces, cut_apart, levels, subdivided
from synfog_usd.translate.texture import UvSource


@dataclass(slots=True)
class Arrays:
    """What a mesh prim's attributes hold, as far as it can be drawn.

    Attributes:
        authored: names of its authored properties.
        points: (N, 3) float64, prim coordinates.
        topology: its faces.
        fault: what hinders, as a note says it; '' for nothing.
        easy: whether its quads are known to be convex.
    """

    authored: frozenset[str]
    points: Array
    topology: Topology
    fault: str = ""
    easy: bool = False


_NOTHING = np.empty((0, 3)), topology(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))


_ARRAYS = ("points", "faceVertexCounts", "faceVertexIndices")


def _outside_of_tetrahedra(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[Indices | None, Indices | None]:
    """Counts and indices of the faces around a TetMesh: as authored, else those that only one tetrahedron has."""
    faces = value_at(prim.GetAttribute("surfaceFaceVertexIndices"), time)
    if faces is None or not len(faces):
        cells = value_at(prim.GetAttribute("tetVertexIndices"), time)
        moment = Usd.TimeCode.EarliestTime() if time.IsDefault() else time
        faces = (
            UsdGeom.TetMesh.ComputeSurfaceFaces(UsdGeom.TetMesh(prim), moment)
            if cells is not None and len(cells)
            else None
        )
    if faces is None or not len(faces):
        return None, None
    corners = np.asarray(faces, dtype=np.int64).reshape(-1)  # also where plain numbers stand in the place of threes
    return np.full(len(corners) // 3, 3, dtype=np.int64), corners


def read_arrays(prim: Usd.Prim, time: Usd.TimeCode, authored: frozenset[str] | None = None) -> Arrays:
    """The points and faces of a mesh prim.

    Args:
        authored: names of its authored properties, where they are at hand.
    """
    names = frozenset(prim.GetAuthoredPropertyNames()) if authored is None else authored
    if prim.GetTypeName() == "TetMesh":
        raw_points, (raw_counts, raw_indices) = (
            value_at(prim.GetAttribute("points"), time),
            _outside_of_tetrahedra(prim, time),
        )
    else:
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
    """Tell which meshes have convex quads alone: those of one topology are looked at together."""
    alike: dict[tuple[Topology, int], list[Arrays]] = {}
    for mesh in meshes:
        if mesh.topology.quads is not None and not mesh.fault:
            alike.setdefault((mesh.topology, len(mesh.points)), []).append(mesh)
    for (faces, _), some in alike.items():
        quads = np.stack([mesh.points for mesh in some])[:, faces.quads]
        easy = np.all(are_easy(quads.reshape(-1, 4, 3)).reshape(len(some), -1), axis=1)
        for mesh, verdict in zip(some, easy, strict=True):
            mesh.easy = bool(verdict)


_CARRIED = frozenset({"normals", "primvars:normals"})


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
    authored, points, fan = arrays.authored, arrays.points, arrays.topology
    counts, indices = fan.counts, fan.indices
    holes = value_at(prim.GetAttribute("holeIndices"), time) if "holeIndices" in authored else None
    keep: npt.NDArray[np.bool_] | None = None
    if holes is not None and len(holes):
        keep = np.ones(len(counts), dtype=bool)
        numbers = np.asarray(holes, dtype=np.int64)
        there = (numbers >= 0) & (numbers < len(counts))
        keep[numbers[there]] = False
        if not there.all():
            notes.warn(
                prim.GetPath(), f"{int((~there).sum())} of its {len(there)} holes name no face of its {len(counts)}"
            )
    attributes: dict[str, Attribute] = {}
    if (
        not authored.isdisjoint(_CARRIED)
        or f"primvars:{color}" in authored
        or (uv is not None and f"primvars:{uv.primvar}" in authored)
    ):
        reader = PrimvarReader(prim, time, notes, indices, np.repeat(np.arange(len(counts)), counts), len(points))
        normals, colors = reader.normals(), reader.primvar(color, 3) if color is not None else None
        st = reader.primvar(uv.primvar, 2) if uv is not None else None
        if normals is not None:
            attributes["normals"] = normals
        if uv is not None and st is not None:
            matrix = np.array(uv.matrix)
            own = finite.of_array(st.values, "texcoords", prim.GetPath(), notes)
            attributes["st"] = replace(st, values=own @ matrix[:, :2].T + matrix[:, 2])
        if colors is not None:
            own = finite.of_array(colors.values, "vertex_color", prim.GetPath(), notes)
            attributes["color"] = replace(colors, values=own)
    is_mesh = prim.GetTypeName() == "Mesh"

    def token(name: str, known: Collection[str], fallback: str, taken: str = "") -> str:
        given = prim.GetAttribute(name).Get() if name in authored else fallback
        return notes.token(prim.GetPath(), name, given, known, taken or fallback)

    scheme = token("subdivisionScheme", ("none", *_DIVIDED), "catmullClark", "none") if is_mesh else "none"
    smooth = False
    left_handed = token("orientation", ORIENTATIONS, "rightHanded") == "leftHanded"
    whole = counts >= 3 if keep is None else keep & (counts >= 3)
    told = "subdivisionScheme" in authored
    bent = ("normals" not in attributes or told) and scheme != UsdGeom.Tokens.none and bool(whole.any())
    if bent and scheme == UsdGeom.Tokens.loop and (counts[counts >= 3] != 3).any():
        notes.warn(
            prim.GetPath(),
            "subdivision surface (loop) with faces of more than three corners is drawn as its control cage with "
            "smooth normals",
        )
        smooth, bent = True, False
    if bent and scheme == UsdGeom.Tokens.bilinear:
        bent = _has_bent_quads(points, counts, indices)
    if bent and scheme in (UsdGeom.Tokens.catmullClark, UsdGeom.Tokens.loop, UsdGeom.Tokens.bilinear):
        level = levels(len(counts), even=bool((counts[counts >= 3] == _DIVIDED[scheme][1]).all()))
        if scheme != UsdGeom.Tokens.bilinear:
            unused = (
                "; normals of its own are not used, as UsdGeom says of what is divided"
                if attributes.pop("normals", None) is not None
                else ""
            )
            how = f"is divided {level} times" if level else f"has {len(counts)} faces, is not divided further"
            notes.info(prim.GetPath(), f"subdivision surface ({scheme}) {how} and lies on its limit{unused}")
        fine = _subdivided(
            UsdGeom.Mesh(prim),
            scheme,
            time,
            points,
            counts,
            indices,
            keep,
            attributes,
            level,
            notes,
            left_handed=left_handed,
        )
        if not len(fine.triangles):
            notes.warn(
                prim.GetPath(),
                "subdivision surface of which no face is drawn (interpolateBoundary 'none', or holes) is left out",
            )
        return fine if len(fine.triangles) else None
    faces, crossed = None, indices[:0]
    if keep is None and len(indices) <= SMALL:
        if fan.triangles is not None and fan.face_of is not None and (fan.quads is None or arrays.easy):
            triangles, face_of, faces = fan.triangles, fan.face_of, fan.faces
        else:
            triangles, face_of, crossed = triangulate_small(points.tobytes(), counts.tobytes(), indices.tobytes())
    else:
        taken = np.ones(len(counts), dtype=bool) if keep is None else keep
        triangles, face_of, crossed = triangulate(points, counts, np.cumsum(counts) - counts, indices, taken)
    if len(crossed):
        notes.warn(
            prim.GetPath(),
            f"{len(crossed)} of its faces, number {crossed[0]} first, have edges that cross; what they cover is a "
            f"guess: cut them in two",
        )
    if not len(triangles):
        notes.warn(prim.GetPath(), "mesh without a face of three or more corners is left out")
        return None
    if left_handed:
        triangles, faces = triangles[:, ::-1], None
    if "normals" in attributes and not (whole_ones := attributes["normals"].values.any(axis=1)).all():
        notes.info(
            prim.GetPath(),
            f"{int((~whole_ones).sum())} of its normals have no length; those are made from the faces around",
        )
        attributes["normals"] = _mended(attributes["normals"], points, indices, triangles)
    if not told and is_mesh and "normals" in attributes:
        notes.info(
            prim.GetPath(),
            "names no subdivisionScheme, whose fallback is catmullClark, and has normals, which only polygons have: "
            "it is drawn as polygons",
        )
    return Polygons(points, indices, triangles, face_of, attributes, smooth, faces)


def _mended(normals: Attribute, points: Array, indices: Indices, triangles: Indices) -> Attribute:
    """Normals with those of no length made from the faces that use them, by area; up where there is none."""
    user = (indices if normals.corner is None else normals.corner)[triangles]
    a, b, c = (points[indices[triangles[:, k]]] for k in range(3))
    weighted, total = cross(b - a, c - a), np.zeros_like(normals.values)
    for k in range(3):
        np.add.at(total, user[:, k], weighted)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    made = np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
    return Attribute(np.where(normals.values.any(axis=1, keepdims=True), normals.values, made), normals.corner)


def _has_bent_quads(points: Array, counts: Indices, indices: Indices) -> bool:
    """Whether any face but parallelograms and triangles is there: on others, values spread otherwise than over two
    triangles.
    """
    if not np.isin(counts, (3, 4)).all():
        return True
    starts = (np.cumsum(counts) - counts)[counts == 4]
    a, b, c, d = (points[indices[starts + k]] for k in range(4))
    return bool((np.abs(a - b + c - d) > 1e-6 * np.abs(points).max(initial=0.0)).any())


def _subdivided(
    mesh: UsdGeom.Mesh,
    scheme: str,
    time: Usd.TimeCode,
    points: Array,
    counts: Indices,
    indices: Indices,
    keep: npt.NDArray[np.bool_] | None,
    attributes: dict[str, Attribute],
    level: int,
    notes: Diagnostics,
    *,
    left_handed: bool,
) -> Polygons:
    """A cage as triangles on its limit surface, with normals that creases part."""
    divide, size = _DIVIDED[scheme]
    whole = counts >= 3
    corners = np.flatnonzero(np.repeat(whole, counts))
    cage = Cage(counts[whole], indices[corners], **_sharp(mesh, time, len(points), notes))
    if stray := _strays(cage, len(points)):
        notes.warn(mesh.GetPath(), f"{stray} edges of its creases are no edges of its faces; they are left out")

    def token(attribute: Usd.Attribute, known: Collection[str], taken: str) -> str:
        return notes.token(mesh.GetPath(), attribute.GetName(), attribute.Get(), known, taken)

    rule = token(mesh.GetInterpolateBoundaryAttr(), ("none", "edgeOnly", "edgeAndCorner"), "edgeAndCorner")
    smooth_triangles = token(mesh.GetTriangleSubdivisionRuleAttr(), ("catmullClark", "smooth"), "catmullClark")
    cage = replace(cage, sharp_ends=rule == "edgeAndCorner", smooth_triangles=smooth_triangles == "smooth")
    drawn = np.ones(int(whole.sum()), dtype=bool) if keep is None else keep[whole]
    if rule == UsdGeom.Tokens.none and scheme != UsdGeom.Tokens.bilinear:
        drawn = drawn & ~boundary_faces(cage, len(points))
    fine = divide(points, cage, level)
    face_of = np.flatnonzero(whole)[fine.face_of]
    chosen = np.flatnonzero(drawn[fine.face_of])
    triangles: Indices = (size * chosen[:, None] + np.array([0, 1, 2, 0, 2, 3] if size == 4 else [0, 1, 2])).reshape(
        -1, 3
    )
    if left_handed:
        triangles = triangles[:, ::-1]
    seams = token(mesh.GetFaceVaryingLinearInterpolationAttr(), _SEAMS, "cornersPlus1")
    islands = seams == UsdGeom.Tokens.all
    spread: dict[str, Attribute] = {}
    for name, attribute in attributes.items():
        if attribute.corner is None:
            spread[name] = Attribute(
                divide(attribute.values, _unbent(cage) if attribute.linear else cage, level).points, None
            )
            continue
        values = attribute.values[attribute.corner[corners]]
        with_point = np.column_stack([cage.indices, np.arange(len(corners)) if islands else 0 * cage.indices, values])
        _, unique, index = np.unique(with_point, axis=0, return_index=True, return_inverse=True)
        cut = cut_apart(cage, index.reshape(-1), seams)
        own = divide(values[unique], _unbent(cut) if attribute.linear else cut, level)
        spread[name] = Attribute(own.points, own.indices)
    if scheme == UsdGeom.Tokens.bilinear:
        return Polygons(fine.points, fine.indices, triangles, np.repeat(face_of[chosen], 2), spread, smooth=False)
    a, b, c = (fine.points[fine.indices[triangles[:, k]]] for k in range(3))
    weighted, total = cross(b - a, c - a), np.zeros((int(fine.smooth_of.max()) + 1, 3))
    for k in range(3):
        np.add.at(total, fine.smooth_of[triangles[:, k]], weighted)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
    spread["normals"] = Attribute(total, None if fine.smooth_of is fine.indices else fine.smooth_of)
    return Polygons(fine.points, fine.indices, triangles, np.repeat(face_of[chosen], size - 2), spread, smooth=False)


_SEAMS = ("all", "none", "boundaries", "cornersOnly", "cornersPlus1", "cornersPlus2")

_DIVIDED = {"catmullClark": (subdivided, 4), "loop": (loop.subdivided, 3), "bilinear": (bilinear, 4)}
"""How a scheme divides, and corners of its faces."""


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


def _sharp(mesh: UsdGeom.Mesh, time: Usd.TimeCode, point_count: int, notes: Diagnostics) -> dict[str, Any]:
    """Creases and corners of a mesh, as `Cage` names them; what does not fit is left out, with a note."""

    def array(attribute: Usd.Attribute, kind: Any) -> Any:
        return np.asarray([] if (value := value_at(attribute, time)) is None else value, dtype=kind)

    corners, at_corner = (
        array(mesh.GetCornerIndicesAttr(), np.int64),
        array(mesh.GetCornerSharpnessesAttr(), np.float64),
    )
    count = min(len(corners), len(at_corner))
    fits = (corners[:count] >= 0) & (corners[:count] < point_count)
    if not fits.all() or len(corners) != len(at_corner):
        notes.warn(
            mesh.GetPath(),
            f"{len(corners) - int(fits.sum())} of its {len(corners)} sharp corners name no point or have no sharpness",
        )
    found: dict[str, Any] = {
        "corners": corners[:count][fits],
        "corner_sharpness": _at_least_smooth(at_corner[:count][fits], "cornerSharpnesses", mesh, notes),
    }
    chain, lengths, given = (
        array(mesh.GetCreaseIndicesAttr(), np.int64),
        array(mesh.GetCreaseLengthsAttr(), np.int64),
        array(mesh.GetCreaseSharpnessesAttr(), np.float64),
    )
    edges = int((lengths - 1).sum()) if len(lengths) else 0
    if not len(chain) or (lengths < 2).any() or lengths.sum() != len(chain) or len(given) not in (len(lengths), edges):
        if len(chain):
            notes.warn(
                mesh.GetPath(),
                "its creases' indices, lengths and sharpnesses do not fit each other; no crease is drawn",
            )
        return found
    last = np.cumsum(lengths) - 1
    begin = np.delete(np.arange(len(chain)), last)
    pairs = np.stack([chain[begin], chain[begin + 1]], axis=1)
    sharpness = given if len(given) == edges and len(given) != len(lengths) else np.repeat(given, lengths - 1)
    fits = (pairs >= 0).all(axis=1) & (pairs < point_count).all(axis=1)
    if not fits.all():
        notes.warn(
            mesh.GetPath(),
            f"{int((~fits).sum())} edges of its creases name points outside of its {point_count}; they are left out",
        )
    return found | {
        "creases": pairs[fits],
        "crease_sharpness": _at_least_smooth(sharpness, "creaseSharpnesses", mesh, notes)[fits],
    }


def _at_least_smooth(sharpness: Array, name: str, mesh: UsdGeom.Mesh, notes: Diagnostics) -> Array:
    """Sharpnesses with 0 where one is negative or no number, and a note."""
    fits = sharpness >= 0.0
    if not fits.all():
        notes.warn(
            mesh.GetPath(),
            f"{int((~fits).sum())} of its {name} are no sharpness, {sharpness[~fits][0]:g} first; 0 is taken",
        )
    return np.where(fits, sharpness, 0.0)

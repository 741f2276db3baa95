"""Triangles with vertex attributes: what all shapes become, and how they are placed.

Takes polygons with primvars; gives parts of them by face, under a matrix, and in the
scene's words.  Knows nothing of USD, materials or Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Indices


@dataclass(frozen=True)
class Attribute:
    """A primvar on triangle corners.

    Attributes:
        values: (K, C) float64.
        corner: (C,) index into `values` for each corner of the polygons, or None
            where it goes with the points.
        linear: whether it runs evenly within each face of a subdivision surface ('varying').
    """

    values: Array
    corner: Indices | None
    linear: bool = False


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
        faces: (M, 3) the triangles by point, where they are at hand.
    """

    points: Array
    indices: Indices
    triangles: Indices
    face_of: Indices
    attributes: dict[str, Attribute]
    smooth: bool
    faces: npt.NDArray[Any] | None = None


@dataclass(frozen=True)
class Triangles:
    """Triangles with vertex attributes, ready to be placed.

    Attributes:
        positions: (N, 3) float64.
        faces: (M, 3) whole numbers, counter-clockwise from outside.
        normals, texcoords, colors: (N, 3), (N, 2), (N, 3) or None.
    """

    positions: Array
    faces: npt.NDArray[Any]
    normals: Array | None = None
    texcoords: Array | None = None
    colors: Array | None = None


def part(
    polygons: Polygons, faces: npt.NDArray[np.bool_] | None, *, smooth_normals: Array | None = None
) -> Triangles | None:
    """The triangles of some faces, with one set of vertices for all attributes.

    Args:
        polygons: the mesh.
        faces: (F,) which faces; None for all.
        smooth_normals: (N, 3) normals of the points, from `point_normals`.
    """
    triangles = polygons.triangles
    if (
        faces is None
        and polygons.faces is not None
        and all(attribute.corner is None for attribute in polygons.attributes.values())
    ):
        values = {name: attribute.values for name, attribute in polygons.attributes.items()}
        normals = values.get("normals", smooth_normals)
        return Triangles(polygons.points, polygons.faces, normals, values.get("st"), values.get("color"))
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
            key = (
                key * (int(index.max()) + 1) + index
                if int(key.max()) < 2**62 // (int(index.max()) + 1)
                else np.arange(len(key))
            )
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


def backs(triangles: Triangles) -> Triangles | None:
    """The backs of an open surface as a surface of their own, just behind it; None of a closed one, whose backs nobody
    sees.
    """
    a, b, c = (triangles.positions[triangles.faces[:, k]] for k in range(3))
    vectors = cross(b - a, c - a) / 2.0
    whole, ahead = float(np.linalg.norm(vectors, axis=1).sum()), vectors.sum(axis=0)
    length = float(np.linalg.norm(ahead))
    if not length > _OPEN * whole:
        return None
    behind = triangles.positions - ahead / length * (_BEHIND * np.sqrt(whole))
    normals = None if triangles.normals is None else -triangles.normals
    return Triangles(behind, triangles.faces[:, ::-1], normals, triangles.texcoords, triangles.colors)


_OPEN = 1e-3
"""Sum of the area vectors over the area, from which on a surface is open; 0 of any that is closed."""

_BEHIND = 1e-4
"""How far behind a surface its back is, over the root of its area."""


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

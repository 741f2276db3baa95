"""Level of detail: instances that are far away, with their vertices merged below a fraction of a pixel.

Takes a scene and which of its instances there is no room for in full; gives meshes that take
less.  Vertices within a cell of a grid, whose normals look the same way, become their mean; faces that lose a corner
are left out.  No vertex moves by more than the cell's diagonal.
Source: Rossignac and Borrel (1993), multi-resolution 3D approximations for rendering complex scenes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.scene import Camera

MOVED_PX = 0.5
"""Pixels by which a vertex may move at most."""

_UNSEEN = 4.0
"""How much longer a cell may be outside of the picture, where only mirrors and shadows show it."""

FEWEST = 100
"""Faces of a mesh up to which it stays as it is."""

_FEWEST_CELLS = 4
"""Cells along a prototype's box, however far it is: a thousand of them that cover a pixel together must not vanish."""

_FINEST = 40
"""Largest power of two of a cell's length, and smallest."""


def levels(camera: Camera, matrices: Array, low: Array, high: Array) -> Array:
    """(N,) power of two of the cell [in units of the prototype] that each instance may have.

    Args:
        camera: by whose picture a vertex may move by `MOVED_PX`.
        matrices: (N, 4, 4) of the instances.
        low, high: (3,) corners of the prototype's box.
    """
    eye = camera.to_world[:3, 3]
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    scale = np.linalg.norm(matrices[:, :3, :3], ord=2, axis=(1, 2))
    center = matrices[:, :3, :3] @ middle + matrices[:, :3, 3]
    away = np.maximum(np.linalg.norm(center - eye, axis=1), 1e-6)
    distance = np.maximum(away - scale * radius, 1e-6)
    corner, pixel_rad = _view(camera)
    across = camera.width_m / camera.width_px or distance * pixel_rad
    cell = MOVED_PX * across / math.sqrt(3.0) / np.maximum(scale, 1e-12)
    if not camera.width_m:
        ahead = np.clip((center - eye) @ -camera.to_world[:3, 2] / away, -1.0, 1.0)
        wide = np.arcsin(np.minimum(scale * radius / away, 1.0))
        cell = np.where(np.arccos(ahead) > corner + wide, _UNSEEN * cell, cell)
    cell = np.minimum(cell, float((high - low).max(initial=1e-6)) / _FEWEST_CELLS)
    return np.clip(np.floor(np.log2(cell)), -_FINEST, _FINEST).astype(np.int64)


def _view(camera: Camera) -> tuple[float, float]:
    """Angle to the axis [rad] beyond which nothing is seen, with a margin, and the smallest angle of a pixel."""
    tall = 0.5 * camera.height_px / camera.width_px
    if camera.fisheye is not None:
        far = math.hypot(0.5 + abs(camera.shift[0]), tall + abs(camera.shift[1]) * 2.0 * tall)
        corner = float(camera.fisheye.angle(np.minimum(far, camera.fisheye.table[1])))
        return 1.05 * corner + 0.05, camera.fisheye.finest_rad(far) / camera.width_px
    wide = 2.0 * math.tan(math.radians(camera.fov_x_deg) / 2.0)
    return 1.2 * math.atan(wide * math.hypot(0.5, tall)) + 0.05, camera.pixel_rad


def merged(mesh: Mapping[str, Any], level: int) -> Mapping[str, Any]:
    """A mesh whose vertices are merged in cells of 2^level; the same mesh where that saves less than a tenth.

    Args:
        mesh: of a `SceneDict`.
        level: power of two of the cell's length.
    """
    points = np.asarray(mesh["positions"], dtype=np.float64)
    faces = np.asarray(mesh["faces"], dtype=np.int64)
    if len(faces) <= FEWEST:
        return mesh
    normals = np.asarray(mesh["normals"]) if "normals" in mesh else _normals(points, faces)
    cells = np.floor((points - points.min(axis=0)) / 2.0**level).astype(np.int64)
    side = (normals > 0.0) @ np.array([1, 2, 4])
    size = cells.max(axis=0) + 1
    if float(np.prod(size.astype(np.float64))) > 2.0**58:
        return mesh  # cells so small that nothing is merged
    key = ((cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2]) * 8 + side
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    group = group.reshape(-1)
    corners = group[faces]
    whole = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])
    corners = corners[whole]
    _, once = np.unique(np.sort(corners, axis=1), axis=0, return_index=True)
    corners = corners[np.sort(once)]
    if len(corners) > 0.9 * len(faces):
        return mesh
    count = np.bincount(group, minlength=len(first))[:, None]
    places = np.stack([np.bincount(group, points[:, k], len(first)) for k in range(3)], axis=1) / count
    arrays = {name: np.asarray(mesh[name])[first] for name in ("normals", "texcoords", "vertex_color") if name in mesh}
    return {**mesh, **arrays, "positions": places, "faces": corners.astype(np.uint32)}


def _normals(points: Array, faces: Indices) -> Array:
    """Directions of the vertices, by the faces around."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    across, total = np.cross(b - a, c - a), np.zeros_like(points)
    for k in range(3):
        np.add.at(total, faces[:, k], across)
    return total

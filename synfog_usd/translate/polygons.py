"""Triangulation of polygons, also of concave polygons.

Takes points and faces; gives corner numbers.  Knows nothing of USD.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import mapbox_earcut
import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.translate.geometry import cross


def triangulate(
    points: Array, counts: Indices, starts: Indices, indices: Indices, keep: npt.NDArray[np.bool_]
) -> tuple[Indices, Indices, Indices]:
    """Triangles of polygons, also of concave polygons.

    Args:
        points: (N, 3).
        counts, starts: corners of each face, and its first corner.
        indices: point of each corner.
        keep: (F,) faces to take.

    Returns:
        Corner numbers (M, 3) in the order of the faces, the face of each (M,), and the faces whose edges cross:
        no triangles have just their area.
    """
    parts: list[tuple[Indices, Indices]] = []
    tangled: list[Indices] = []
    sizes = [int(counts[0])] if counts.min() == counts.max() else np.unique(counts[keep])
    for n in sizes:
        if n < 3:
            continue
        faces = np.flatnonzero(keep & (counts == n))
        corners = starts[faces][:, None] + np.arange(n)
        if n == 3:
            parts.append((corners, faces))
            continue
        if n == 4 and are_easy(points[indices[corners]]).all():
            parts.append((corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), np.repeat(faces, 2)))
            continue
        polygons = points[indices[corners]]
        reflex = _turning(polygons) < 0.0
        fan, easy, hard = corners, faces, faces[:0]
        if n == 4:  # its one reflex corner sees both others
            order = (np.arange(n) + np.where(reflex.any(axis=1), reflex.argmax(axis=1), 0)[:, None]) % n
            fan = np.take_along_axis(corners, order, axis=1)
            tangled.append(faces[(reflex.sum(axis=1) > 1) | _balanced(polygons)])
        else:
            concave = reflex.any(axis=1) | ~_winds_once(polygons) | _balanced(polygons)
            fan, easy, hard = corners[~concave], faces[~concave], np.flatnonzero(concave)
        fans = np.stack([np.repeat(fan[:, :1], n - 2, axis=1), fan[:, 1:-1], fan[:, 2:]], axis=-1).reshape(-1, 3)
        parts.append((fans, np.repeat(easy, n - 2)))
        for number in hard:
            ears, whole = _ears(polygons[number])
            parts.append((corners[number][ears], np.full(len(ears), faces[number])))
            if not whole:
                tangled.append(faces[[number]])
    crossed = np.sort(np.concatenate([np.empty(0, dtype=np.int64), *tangled]))
    if not parts:
        return np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=np.int64), crossed
    if len(parts) == 1:
        return *parts[0], crossed
    triangles, face_of = np.concatenate([t for t, _ in parts]), np.concatenate([f for _, f in parts])
    order = np.argsort(face_of, kind="stable")
    return triangles[order], face_of[order], crossed


SMALL = 512
"""Corners of a mesh up to which its topology is remembered, for props in many copies."""


@dataclass(frozen=True, eq=False)
class Topology:
    """The faces of a mesh, and what follows from them whatever its points are.

    Attributes:
        counts, indices: int64, corners of each face and point of each corner.
        highest: highest point that a face names; no mesh has as many points where counts and indices do not fit.
        triangles, face_of: as `triangulate` gives them where no quad is concave; None for faces of other sizes.
        faces: (M, 3) uint32, the triangles by point; None with them.
        quads: (Q, 4) points of the quads, which must be looked at; None where there is none.
    """

    counts: Indices
    indices: Indices
    highest: int
    triangles: Indices | None = None
    face_of: Indices | None = None
    faces: npt.NDArray[np.uint32] | None = None
    quads: Indices | None = None


_NO_MESH = 1 << 62


def topology(counts: Indices, indices: Indices) -> Topology:
    """What a mesh's counts and indices say; one object for all small meshes that share them."""
    return (
        _remembered(counts.tobytes(), indices.tobytes())
        if len(indices) <= SMALL
        else Topology(counts, indices, _highest(counts, indices))
    )


def _highest(counts: Indices, indices: Indices) -> int:
    fits = len(indices) and counts.min() >= 0 and counts.sum() == len(indices) and indices.min() >= 0
    return int(indices.max()) if fits else _NO_MESH


@functools.lru_cache(maxsize=1024)
def _remembered(count_bytes: bytes, index_bytes: bytes) -> Topology:
    counts, indices = np.frombuffer(count_bytes, dtype=np.int64), np.frombuffer(index_bytes, dtype=np.int64)
    highest = _highest(counts, indices)
    if highest == _NO_MESH or not (counts == counts[0]).all() or counts[0] not in (3, 4):
        return Topology(counts, indices, highest)
    corners = np.arange(len(indices)).reshape(-1, int(counts[0]))
    if counts[0] == 3:
        return Topology(
            counts, indices, highest, corners, np.arange(len(counts)), indices.reshape(-1, 3).astype(np.uint32)
        )
    triangles = corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return Topology(
        counts,
        indices,
        highest,
        triangles,
        np.repeat(np.arange(len(counts)), 2),
        indices[triangles].astype(np.uint32),
        indices.reshape(-1, 4),
    )


@functools.lru_cache(maxsize=1024)
def triangulate_small(points: bytes, counts: bytes, indices: bytes) -> tuple[Indices, Indices, Indices]:
    """`triangulate` of all faces of a mesh, given by the bytes of its arrays."""
    numbers = np.frombuffer(counts, dtype=np.int64)
    keep = np.ones(len(numbers), dtype=bool)
    return triangulate(
        np.frombuffer(points).reshape(-1, 3),
        numbers,
        np.cumsum(numbers) - numbers,
        np.frombuffer(indices, dtype=np.int64),
        keep,
    )


def are_easy(quads: Array) -> npt.NDArray[np.bool_]:
    """(F,) whether quads (F, 4, 3) are convex without doubt: each corner turns the way of the others."""
    edges = quads[:, _NEXT] - quads
    turn = cross(edges[:, _BEFORE], edges)
    return np.asarray((np.einsum("fi,fki->fk", turn[:, 0] + turn[:, 2], turn) > 0.0).all(axis=1))


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


def _winds_once(polygons: Array) -> npt.NDArray[np.bool_]:
    """(F,) whether the fan of each polygon (F, n, 3) from its first corner turns one way only; that of a pentagram does
    not.
    """
    arms = polygons - polygons[:, :1]
    turn = cross(arms[:, 1:-1], arms[:, 2:])
    normal = turn.sum(axis=1)
    side = np.einsum("fni,fi->fn", turn, normal)
    return np.asarray((side >= -1e-9 * np.einsum("fi,fi->f", normal, normal)[:, None]).all(axis=1))


def _balanced(polygons: Array) -> npt.NDArray[np.bool_]:
    """(F,) whether the parts of each polygon turn both ways by as much, as in an even bow tie."""
    arms = polygons - polygons[:, :1]
    turn = cross(arms[:, 1:-1], arms[:, 2:])
    return np.asarray(np.linalg.norm(turn.sum(axis=1), axis=1) < 1e-9 * np.linalg.norm(turn, axis=2).max(axis=1))


def _ears(polygon: Array) -> tuple[Indices, bool]:
    """Triangles of one polygon (n, 3): (M, 3) corner numbers that turn its way, and whether they have just its area."""
    arms = polygon - polygon[0]
    normal = cross(arms[1:-1], arms[2:]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(arms, axis, axis=1)
    flip = (normal[axis] < 0) != (axis == 1)
    ears = _cut(flat)
    a, b, c = (flat[ears[:, k]] for k in range(3))
    areas = _cross2(b - a, c - a)
    if (areas.sum() < 0.0) != flip:
        ears = ears[:, ::-1]
    outline = abs(_cross2(flat, np.roll(flat, -1, axis=0)).sum())
    rounding = 1e-15 * len(flat) * np.abs(flat).max() ** 2
    return ears, bool(abs(np.abs(areas).sum() - outline) <= 1e-9 * outline + rounding)


def _cut(flat: Array) -> Indices:
    """Ears of an outline (n, 2), (M, 3).

    Source: mapbox earcut, which looks for what lies in an ear along a z-order curve.
    """
    # Stretched until edges are as long in x as in y: on a fine comb the curve's cells would all hold the same corners.
    # By powers of two, so that no corner is rounded.
    steps = np.abs(np.roll(flat, -1, axis=0) - flat).mean(axis=0)
    wide = flat * np.exp2(-np.round(np.log2(np.where(steps > 0.0, steps, 1.0))))
    ears = mapbox_earcut.triangulate_float64(np.ascontiguousarray(wide), np.array([len(wide)], dtype=np.uint32))
    return ears.astype(np.int64).reshape(-1, 3)


def _cross2(u: Array, v: Array) -> Array:
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

"""Subdivision by Loop: a control cage of triangles as fine ones that lie on the limit surface.

Takes what `subdivide` takes; gives triangles.  Sharp edges, corners and boundaries are
as there.
Source: Loop (1987); creases: Hoppe et al. (1994); limit masks: Hoppe et al. and
OpenSubdiv's documentation of Loop surfaces.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from synfog_usd.base.arrays import Array
from synfog_usd.translate.subdivide import (
    INFINITE,
    Cage,
    Edges,
    Fine,
    Moved,
    between,
    is_fractional,
    neighbours,
    rules,
    smooth_patches,
    softened,
)


def subdivided(points: Array, cage: Cage, level: int) -> Fine:
    """A cage of triangles divided `level` times, and moved onto the limit surface.

    Args:
        points: (N, C) positions, or any other values of the points.
        cage: triangles and sharpness.
        level: >= 0.
    """
    values, face_of = np.asarray(points, dtype=np.float64), np.arange(len(cage.counts))
    corner_sharpness = np.zeros(len(values))
    np.maximum.at(corner_sharpness, cage.corners, cage.corner_sharpness)
    for _ in range(level):
        values, cage, corner_sharpness = _divided(values, cage, corner_sharpness)
        face_of = np.repeat(face_of, 4)
    edges = Edges(cage)
    sharp = edges.sharpness(cage)
    return Fine(
        _on_limit(values, cage, edges, sharp, corner_sharpness),
        cage.indices,
        face_of,
        smooth_patches(cage, edges, sharp),
    )


def _divided(values: Array, cage: Cage, corner_sharpness: Array) -> tuple[Array, Cage, Array]:
    edges = Edges(cage)
    points, count = len(values), len(edges.keys)
    sharp = edges.sharpness(cage)
    across = cage.indices[edges.previous]  # the point that an edge of a triangle looks at
    opposite = sparse.csr_array((np.ones(len(across)), (edges.of_corner, across)), shape=(count, points)) @ values
    middles = values[edges.ends].mean(axis=1)
    hard = np.minimum(sharp, 1.0)[:, None]
    edge_points = hard * middles + (1.0 - hard) * (0.75 * middles + 0.125 * opposite)

    later_sharp, later_corner = softened(sharp), softened(corner_sharpness)
    now = _vertex_points(values, cage, edges, sharp, corner_sharpness)
    vertex_points = now.values
    if is_fractional(sharp, corner_sharpness):
        vertex_points = between(
            now, _vertex_points(values, cage, edges, later_sharp, later_corner), edges.ends, sharp, corner_sharpness
        )

    a, b, c = cage.indices.reshape(-1, 3).T
    ab, bc, ca = points + edges.of_corner.reshape(-1, 3).T
    triangles = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1)
    lasting = np.flatnonzero(later_sharp > 0.0)
    finer = Cage(
        counts=np.full(len(triangles) // 3, 3, dtype=np.int64),
        indices=triangles,
        creases=np.concatenate([np.stack([edges.ends[lasting, side], points + lasting], axis=1) for side in (0, 1)]),
        crease_sharpness=np.tile(later_sharp[lasting], 2),
        sharp_ends=cage.sharp_ends,
    )
    return np.concatenate([vertex_points, edge_points]), finer, np.concatenate([later_corner, np.zeros(count)])


def _ring_weight(degree: Array) -> Array:
    """Weight of each neighbour in the next level's point (Loop's own)."""
    return np.asarray((0.625 - (0.375 + 0.25 * np.cos(2.0 * np.pi / degree)) ** 2) / degree)


def _moved(
    values: Array, cage: Cage, edges: Edges, sharp: Array, corner_sharpness: Array, weight: Array, along: float
) -> Moved:
    """Points as means of themselves and their neighbours: `weight` (N,) for each of these where it is smooth, `along`
    for the two of a crease.
    """
    points = len(values)
    degree = np.bincount(edges.ends.reshape(-1), minlength=points)
    rule = rules(cage, edges, sharp, corner_sharpness)
    around = neighbours(edges.ends, np.ones(len(edges.ends), dtype=bool), values)
    smooth = (1.0 - degree * weight)[:, None] * values + weight[:, None] * around
    crease = (1.0 - 2.0 * along) * values + along * neighbours(edges.ends, sharp > 0.0, values)
    free = (rule == 0) & (degree > 0)
    return Moved(np.where(free[:, None], smooth, np.where((rule == 1)[:, None], crease, values)), rule)


def _vertex_points(values: Array, cage: Cage, edges: Edges, sharp: Array, corner_sharpness: Array) -> Moved:
    degree = np.maximum(np.bincount(edges.ends.reshape(-1), minlength=len(values)), 1).astype(np.float64)
    return _moved(values, cage, edges, sharp, corner_sharpness, _ring_weight(degree), 0.125)


def _on_limit(values: Array, cage: Cage, edges: Edges, sharp: Array, corner_sharpness: Array) -> Array:
    degree = np.maximum(np.bincount(edges.ends.reshape(-1), minlength=len(values)), 1).astype(np.float64)
    weight = 1.0 / (degree + 0.375 / _ring_weight(degree))
    half_sharp = (corner_sharpness > 0.0) & (corner_sharpness < INFINITE)
    half_sharp[edges.ends[(sharp > 0.0) & (sharp < INFINITE)]] = True
    limit = _moved(values, cage, edges, sharp, corner_sharpness, weight, 1.0 / 6.0).values
    return np.where(half_sharp[:, None], values, limit)

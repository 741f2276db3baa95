"""Subdivision by Catmull and Clark: a control cage as fine quads that lie on the limit surface.

Takes points, faces, creases, corners and the boundary rule; gives quads, and the
same for whatever else goes with the points.  Knows nothing of USD or materials.
Source: Catmull and Clark (1978); semi-sharp creases: DeRose, Kass and Truong (1998),
with the fractions of OpenSubdiv's uniform creasing; limit masks: Halstead, Kass and
DeRose (1993).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from synfog_usd.base.arrays import Array, Flags, Indices

INFINITE = 10.0
"""Sharpness from which an edge or corner stays sharp at all levels; USD's SHARPNESS_INFINITE."""

MOST_FACES = 20_000
"""Faces of a mesh up to which another level is added."""

MOST_LEVELS = 3

FINE_ENOUGH = 250_000
"""Faces beyond which a mesh of quads is not divided: another level takes four times the memory, below a pixel."""


@dataclass(frozen=True)
class Cage:
    """Faces of a control cage and what is sharp on it.

    Attributes:
        counts: corners of each face, >= 3.
        indices: point of each corner.
        creases: (K, 2) points of each sharp edge.
        crease_sharpness: (K,) >= 0.
        corners: (C,) sharp points.
        corner_sharpness: (C,) >= 0.
        sharp_ends: whether a boundary point of a single face is a corner
            (interpolateBoundary 'edgeAndCorner').
        smooth_triangles: whether edges of triangles lean more on their faces
            (triangleSubdivisionRule 'smooth').
    """

    counts: Indices
    indices: Indices
    creases: Indices = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    crease_sharpness: Array = field(default_factory=lambda: np.empty(0))
    corners: Indices = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    corner_sharpness: Array = field(default_factory=lambda: np.empty(0))
    sharp_ends: bool = True
    smooth_triangles: bool = False


@dataclass(frozen=True)
class Fine:
    """Fine faces of a cage.

    Attributes:
        points: (N, C) float64.
        indices: point of each corner, four to a quad.
        face_of: (Q,) face of the cage that each one comes from.
        smooth_of: smooth patch of each corner: corners of one point that no sharp edge parts.
    """

    points: Array
    indices: Indices
    face_of: Indices
    smooth_of: Indices


_TRIANGLE = 0.47
"""Weight of a triangle's centre in its edges' points by the rule 'smooth'; OpenSubdiv's seam_edges."""


def levels(face_count: int, *, even: bool = False) -> int:
    """How often a cage is divided: 1 to `MOST_LEVELS`, by its number of faces; 0 where it is fine enough as it is.

    Args:
        face_count: its faces.
        even: whether all of them are quads.
    """
    if even and face_count > FINE_ENOUGH:
        return 0
    level = 1
    while level < MOST_LEVELS and face_count * 4 ** (level + 1) <= MOST_FACES:
        level += 1
    return level


def boundary_faces(cage: Cage, point_count: int) -> Flags:
    """(F,) faces that touch the boundary; the rule 'none' does not draw them."""
    edges = _Edges(cage)
    outer = np.zeros(point_count, dtype=bool)
    outer[edges.ends[edges.faces_around == 1]] = True
    return np.bincount(edges.face_of_corner, weights=outer[cage.indices], minlength=len(cage.counts)) > 0


def subdivided(points: Array, cage: Cage, level: int) -> Fine:
    """A cage divided `level` times, and moved onto the limit surface.

    Args:
        points: (N, C) positions, or any other values of the points.
        cage: faces and sharpness.
        level: >= 1, or 0 of a cage of quads.

    A point on a crease that is still half sharp after the last level stays where
    that level puts it.
    """
    values, face_of = np.asarray(points, dtype=np.float64), np.arange(len(cage.counts))
    corner_sharpness = np.zeros(len(values))
    np.maximum.at(corner_sharpness, cage.corners, cage.corner_sharpness)
    for _ in range(level):
        values, cage, corner_sharpness, face_of = _divided(values, cage, corner_sharpness, face_of)
    edges = _Edges(cage)
    sharp = edges.sharpness(cage)
    return Fine(
        _on_limit(values, cage, edges, sharp, corner_sharpness),
        cage.indices,
        face_of,
        _smooth_patches(cage, edges, sharp),
    )


class _Edges:
    """The edges of a cage, each once.

    Attributes:
        keys: (E,) a number for each.
        ends: (E, 2) its points, the lower one first.
        faces_around: (E,) how many faces meet at it.
        face_of_corner: face of each corner of the cage.
        of_corner: edge from each corner to the one after it.
        following, previous: the corners after and before each one.
    """

    def __init__(self, cage: Cage) -> None:
        starts = np.cumsum(cage.counts) - cage.counts
        self.face_of_corner = np.repeat(np.arange(len(cage.counts)), cage.counts)
        following = np.arange(len(cage.indices)) + 1
        last = starts + cage.counts - 1
        following[last] = starts
        self.following = following
        self.previous = np.empty_like(following)
        self.previous[following] = np.arange(len(following))
        pairs = np.sort(np.stack([cage.indices, cage.indices[following]], axis=1), axis=1)
        self.size = int(cage.indices.max()) + 1
        keys, self.of_corner, self.faces_around = np.unique(
            pairs[:, 0] * self.size + pairs[:, 1], return_inverse=True, return_counts=True
        )
        self.of_corner = self.of_corner.reshape(-1)
        self.keys, self.ends = keys, np.stack([keys // self.size, keys % self.size], axis=1)

    def sharpness(self, cage: Cage) -> Array:
        """(E,) sharpness of every edge; those at a boundary, or of more than two faces, never soften."""
        sharp = np.zeros(len(self.keys))
        if len(cage.creases):
            pairs = np.sort(cage.creases, axis=1)
            keys = pairs[:, 0] * self.size + pairs[:, 1]
            edge = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
            exists = (self.keys[edge] == keys) & (pairs[:, 1] < self.size)
            np.maximum.at(sharp, edge[exists], cage.crease_sharpness[exists])
        sharp[self.faces_around != 2] = INFINITE
        return sharp


def _softened(sharpness: Array) -> Array:
    """Sharpness one level further."""
    return np.where(sharpness >= INFINITE, sharpness, np.maximum(sharpness - 1.0, 0.0))


def _divided(
    values: Array, cage: Cage, corner_sharpness: Array, face_of: Indices
) -> tuple[Array, Cage, Array, Indices]:
    edges = _Edges(cage)
    points, faces, count = len(values), len(cage.counts), len(edges.keys)
    sharp = edges.sharpness(cage)
    per_corner = (1.0 / cage.counts)[edges.face_of_corner]
    to_face = sparse.csr_array((per_corner, (edges.face_of_corner, cage.indices)), shape=(faces, points))
    to_middle = sparse.csr_array(
        (np.full(2 * count, 0.5), (np.repeat(np.arange(count), 2), edges.ends.reshape(-1))), shape=(count, points)
    )
    to_edge = sparse.csr_array(
        (np.ones(len(cage.indices)), (edges.of_corner, edges.face_of_corner)), shape=(count, faces)
    )
    hard = np.minimum(sharp, 1.0)
    face_points, middles = to_face @ values, to_middle @ values
    lean = np.full((count, 1), 0.25)
    if cage.smooth_triangles:
        weight = np.where(cage.counts == 3, _TRIANGLE, 0.25)
        lean[edges.faces_around == 2] = (0.5 * (to_edge @ weight))[edges.faces_around == 2, None]
    soft = (1.0 - 2.0 * lean) * middles + lean * (to_edge @ face_points)
    edge_points = hard[:, None] * middles + (1.0 - hard)[:, None] * soft

    ends, degree = edges.ends, np.bincount(edges.ends.reshape(-1), minlength=points)
    now = _vertex_points(values, cage, edges, sharp, corner_sharpness, face_points, degree)
    later_sharp, later_corner = _softened(sharp), _softened(corner_sharpness)
    vertex_points = now.values
    if _is_fractional(sharp, corner_sharpness):
        after = _vertex_points(values, cage, edges, later_sharp, later_corner, face_points, degree)
        vertex_points = _between(now, after, ends, sharp, corner_sharpness)

    corners = np.arange(len(cage.indices))
    quads = np.stack(
        [
            cage.indices,
            points + edges.of_corner,
            points + count + edges.face_of_corner,
            points + edges.of_corner[edges.previous],
        ],
        axis=1,
    )
    lasting = np.flatnonzero(later_sharp > 0.0)
    creases = np.concatenate([np.stack([ends[lasting, side], points + lasting], axis=1) for side in (0, 1)])
    finer = Cage(
        counts=np.full(len(corners), 4, dtype=np.int64),
        indices=quads.reshape(-1),
        creases=creases,
        crease_sharpness=np.tile(later_sharp[lasting], 2),
        sharp_ends=cage.sharp_ends,
    )
    result = np.concatenate([vertex_points, edge_points, face_points])
    return result, finer, np.concatenate([later_corner, np.zeros(count + faces)]), face_of[edges.face_of_corner]


@dataclass(frozen=True)
class _Moved:
    """Points of a cage, one level on.

    Attributes:
        values: (N, C) where they go.
        rule: (N,) by which of `_rules`.
    """

    values: Array
    rule: Indices


def _is_fractional(sharp: Array, corner_sharpness: Array) -> bool:
    """Whether anything stops being sharp within the next level."""
    return bool(((sharp > 0.0) & (sharp < 1.0)).any() or ((corner_sharpness > 0.0) & (corner_sharpness < 1.0)).any())


def _between(now: _Moved, after: _Moved, ends: Indices, sharp: Array, corner_sharpness: Array) -> Array:
    """Points where something stops being sharp: between the rules of this level and of the next, by the mean of the
    fractions.
    """
    ending = (sharp > 0.0) & (_softened(sharp) <= 0.0)
    total, number = np.zeros(len(now.rule)), np.zeros(len(now.rule))
    for side in (0, 1):
        np.add.at(total, ends[ending, side], sharp[ending])
        np.add.at(number, ends[ending, side], 1.0)
    falling = (corner_sharpness > 0.0) & (_softened(corner_sharpness) <= 0.0)
    total[falling] += corner_sharpness[falling]
    number[falling] += 1.0
    share = np.where(now.rule == after.rule, 1.0, np.minimum(total / np.maximum(number, 1.0), 1.0))[:, None]
    return np.asarray(share * now.values + (1.0 - share) * after.values)


def _rules(cage: Cage, edges: _Edges, sharp: Array, corner_sharpness: Array) -> Indices:
    """(N,) how each point moves: 0 smooth, 1 along its crease, 2 not at all."""
    points = len(corner_sharpness)
    hard = np.bincount(edges.ends[sharp > 0.0].reshape(-1), minlength=points)
    rule = np.where((hard > 2) | (corner_sharpness > 0.0), 2, np.where(hard == 2, 1, 0))
    if cage.sharp_ends:
        rule[np.bincount(cage.indices, minlength=points) == 1] = 2
    return rule


def _neighbours(ends: Indices, chosen: Flags, values: Array) -> Array:
    """Sum of the values at the other ends of the chosen edges, for each point."""
    a, b = ends[chosen, 0], ends[chosen, 1]
    weights = np.ones(2 * len(a))
    return np.asarray(
        sparse.csr_array((weights, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(len(values), len(values)))
        @ values
    )


def _vertex_points(
    values: Array,
    cage: Cage,
    edges: _Edges,
    sharp: Array,
    corner_sharpness: Array,
    face_points: Array,
    degree: Indices,
) -> _Moved:
    rule = _rules(cage, edges, sharp, corner_sharpness)
    n = np.maximum(degree, 1)[:, None].astype(np.float64)
    around = _neighbours(edges.ends, np.ones(len(edges.ends), dtype=bool), values)
    weights = np.ones(len(cage.indices))
    faces = (
        sparse.csr_array((weights, (cage.indices, edges.face_of_corner)), shape=(len(values), len(cage.counts)))
        @ face_points
    )
    smooth = (n - 2.0) / n * values + (around + faces) / n**2
    crease = 0.75 * values + 0.125 * _neighbours(edges.ends, sharp > 0.0, values)
    free = (rule == 0) & (degree > 0)
    return _Moved(np.where(free[:, None], smooth, np.where((rule == 1)[:, None], crease, values)), rule)


def _on_limit(values: Array, cage: Cage, edges: _Edges, sharp: Array, corner_sharpness: Array) -> Array:
    points = len(values)
    degree = np.bincount(edges.ends.reshape(-1), minlength=points)
    rule = _rules(cage, edges, sharp, corner_sharpness)
    n = np.maximum(degree, 1)[:, None].astype(np.float64)
    across = cage.indices[edges.following[edges.following]]
    opposite = sparse.csr_array((np.ones(len(across)), (cage.indices, across)), shape=(points, points)) @ values
    around = _neighbours(edges.ends, np.ones(len(edges.ends), dtype=bool), values)
    smooth = (n**2 * values + 4.0 * around + opposite) / (n * (n + 5.0))
    crease = (4.0 * values + _neighbours(edges.ends, sharp > 0.0, values)) / 6.0
    half_sharp = np.zeros(points, dtype=bool)
    half_sharp[edges.ends[(sharp > 0.0) & (sharp < INFINITE)]] = True
    half_sharp |= (corner_sharpness > 0.0) & (corner_sharpness < INFINITE)
    free = (rule == 0) & (degree > 0) & ~half_sharp
    return np.where(free[:, None], smooth, np.where(((rule == 1) & ~half_sharp)[:, None], crease, values))


def cut_apart(cage: Cage, values: Indices, rule: str) -> Cage:
    """The cage of a face-varying primvar: seams are its boundaries, and what is sharp on the mesh is sharp on it.

    Args:
        cage: of the points.
        values: number of each corner's value; two points have none in common.
        rule: UsdGeom's faceVaryingLinearInterpolation: which values stay where they are.  'none' none; 'cornersOnly'
            those of one face; 'cornersPlus1' also where three regions meet; 'cornersPlus2' also ends of seams, and
            the other side of a corner; 'boundaries' all at seams.
    """
    edges = _Edges(cage)
    sharp = edges.sharpness(cage)[edges.of_corner]
    inner = np.flatnonzero((sharp > 0.0) & (edges.faces_around == 2)[edges.of_corner])
    count = int(values.max()) + 1
    at_point = np.zeros(edges.size)
    np.maximum.at(at_point, cage.corners[cage.corners < edges.size], cage.corner_sharpness[cage.corners < edges.size])
    point_of = np.zeros(count, dtype=np.int64)
    point_of[values] = cage.indices
    pinned = at_point[point_of]
    seamed = Cage(
        cage.counts,
        values,
        np.stack([values[inner], values[edges.following[inner]]], axis=1),
        sharp[inner],
        sharp_ends=rule != "none",
        smooth_triangles=cage.smooth_triangles,
    )
    seam_edges = _Edges(seamed)
    at_seam = np.zeros(count, dtype=bool)
    at_seam[seam_edges.ends[seam_edges.faces_around == 1]] = True
    regions = np.bincount(point_of, minlength=edges.size)[point_of]
    if rule == "boundaries":
        pinned[at_seam] = INFINITE
    elif rule in ("cornersPlus1", "cornersPlus2"):
        pinned[regions >= 3] = INFINITE
    if rule == "cornersPlus2":
        single = np.bincount(values, minlength=count) == 1
        beside_corner = np.zeros(edges.size, dtype=bool)
        beside_corner[point_of[single]] = True
        pinned[(regions == 2) & beside_corner[point_of]] = INFINITE
        torn = np.bincount(edges.of_corner, minlength=len(edges.keys)) == 2
        lone = seam_edges.faces_around[seam_edges.of_corner] == 1
        ends = np.flatnonzero(torn[edges.of_corner] & lone)
        dart = np.zeros(count, dtype=bool)
        dart[values[ends]] = dart[values[edges.following[ends]]] = True
        pinned[dart & (regions == 1)] = INFINITE
    hard = np.flatnonzero(pinned > 0.0)
    return replace(seamed, corners=hard, corner_sharpness=pinned[hard])


def _smooth_patches(cage: Cage, edges: _Edges, sharp: Array) -> Indices:
    """Number of the smooth patch of each corner: its point, where nothing around it is sharp for good."""
    if not (sharp[edges.faces_around == 2] >= INFINITE).any():
        return cage.indices
    order = np.argsort(edges.of_corner, kind="stable")
    inner = np.flatnonzero((edges.faces_around == 2) & (sharp < INFINITE))
    first = (np.cumsum(edges.faces_around) - edges.faces_around)[inner]
    a, b = order[first], order[first + 1]  # the two corners whose edges these are
    begins, ends = edges.following[a], edges.following[b]
    same = cage.indices[a] == cage.indices[b]  # two faces that turn against each other begin their edge at one point
    starts, stops = np.concatenate([a, begins]), np.concatenate([np.where(same, b, ends), np.where(same, ends, b)])
    size = len(cage.indices)
    joined = sparse.csr_array((np.ones(len(starts)), (starts, stops)), shape=(size, size))
    return np.asarray(csgraph.connected_components(joined, directed=False)[1], dtype=np.int64)

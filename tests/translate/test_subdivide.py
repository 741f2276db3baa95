"""Catmull-Clark: limit positions against splines and against masks worked out by hand."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from synfog_usd.translate import subdivide
from synfog_usd.translate.subdivide import Cage, cut_apart, subdivided

BOX = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
EDGES = np.unique(np.sort(np.stack([QUADS, np.roll(QUADS, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1), axis=0)


def cube(**sharp):
    return Cage(np.full(6, 4), QUADS.reshape(-1), **sharp)


def sheet(size, heights):
    """A size x size grid of points with given heights, and its cage's arrays."""
    y, x = np.mgrid[:size, :size]
    points = np.stack([x.ravel(), y.ravel(), heights.ravel()], axis=1).astype(float)
    first = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    return (
        points,
        np.full(len(first), 4),
        np.stack([first, first + 1, first + size + 1, first + size], axis=1).reshape(-1),
    )


def spline(values):
    """The uniform cubic B-spline whose control points are the values at 0, 1, 2, ..."""
    return BSpline(np.arange(-2.0, len(values) + 2.0), values, 3)


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_a_regular_sheet_is_a_bicubic_spline(level):
    """Away from the boundary every point lies on the tensor product of cubic B-splines."""
    heights = np.random.default_rng(2).normal(size=(8, 8))
    points, counts, indices = sheet(8, heights)
    fine = subdivided(points, Cage(counts, indices), level).points
    x, y, z = fine[((fine[:, :2] > 1.99) & (fine[:, :2] < 5.01)).all(axis=1)].T
    assert len(z) == (3 * 2**level + 1) ** 2
    along = spline(heights)(y)  # (N, 8): every column's spline at y
    wanted = [spline(row)(at) for row, at in zip(along, x, strict=True)]
    np.testing.assert_allclose(z, wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("level", [1, 2, 4])
@pytest.mark.parametrize("sharpness, corner", [(0.0, 12 / 24), (0.5, 15 / 24), (1.0, 18 / 24), (10.0, 1.0)])
def test_corners_of_a_cube_by_sharpness(level, sharpness, corner):
    """Smooth: (9 + 4 - 1) / 24. Sharpness 1: after one hard step v = 1, sum(e) = 2, sum(f) = 1, so (9 + 8 + 1) / 24."""
    fine = subdivided(BOX, cube(creases=EDGES, crease_sharpness=np.full(12, sharpness)), level)
    np.testing.assert_allclose(fine.points[:8], BOX * corner, rtol=1e-12)


def test_a_sharp_corner_stays(level=3):
    """One infinitely sharp point of a cube is met; the opposite one is as smooth as without it."""
    fine = subdivided(BOX, cube(corners=np.array([7]), corner_sharpness=np.array([10.0])), level)
    np.testing.assert_allclose(fine.points[7], [1, 1, 1], rtol=1e-12)
    np.testing.assert_allclose(fine.points[0], [-0.5, -0.5, -0.5], rtol=1e-12)


@pytest.mark.parametrize("sharp_ends, wanted", [(True, 0.0), (False, 1 / 6)])
def test_ends_of_a_sheet_follow_the_boundary_rule(sharp_ends, wanted):
    """edgeAndCorner keeps the corner; edgeOnly rounds it to (4 v + a + b) / 6."""
    points, counts, indices = sheet(4, np.zeros((4, 4)))
    fine = subdivided(points, Cage(counts, indices, sharp_ends=sharp_ends), 2).points
    np.testing.assert_allclose(fine[0], [wanted, wanted, 0.0], atol=1e-12)


@pytest.mark.parametrize("level", [1, 3])
@pytest.mark.parametrize("where", ["boundary", "crease"])
def test_boundaries_and_creases_are_cubic_splines(level, where):
    """They forget what lies beside them: the row's own points are the control points of a curve."""
    heights = np.random.default_rng(3).normal(size=(9, 9))
    points, counts, indices = sheet(9, heights)
    row = 0 if where == "boundary" else 4
    chain = np.arange(9) + 9 * row
    pairs = np.stack([chain[:-1], chain[1:]], axis=1)
    sharp = {"creases": pairs, "crease_sharpness": np.full(8, 10.0)} if where == "crease" else {}
    fine = subdivided(points, Cage(counts, indices, **sharp), level).points
    x, _, z = fine[(np.abs(fine[:, 1] - row) < 1e-12) & (fine[:, 0] > 1.99) & (fine[:, 0] < 6.01)].T
    assert len(z) == 4 * 2**level + 1
    np.testing.assert_allclose(z, spline(heights[row])(x), rtol=0, atol=1e-12)


ROOF = np.array([(-1, -1, -1), (-1, -1, 1.2), (-1.1, 1, -1), (-1, 1.3, 1), (1, -1, -1.4), (1.2, -1, 1)])
ROOF = np.vstack([ROOF, [(1, 1.1, -1), (1, 1, 1), (0.1, 0, 2)]])
ROOF_QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4]]
ROOF_FACES = [*ROOF_QUADS, [1, 5, 8], [5, 7, 8], [7, 3, 8], [3, 1, 8]]
OPENSUBDIV = [
    [-0.518056, -0.493519, -0.542593], [-0.563314, -0.561686, 0.899219], [-0.547454, 0.575926, -0.51713],
    [-0.594727, 0.745475, 0.83431], [0.538657, -0.492593, -0.654167], [0.70651, -0.593913, 0.791341],
    [0.500463, 0.559259, -0.575926], [0.629395, 0.641764, 0.801432], [0.07526, 0.037109, 1.529948],
]  # fmt: skip
"""Where OpenSubdiv 3.5 puts the points of this house of quads and triangles after two levels (float32)."""


def divided(points, cage, level):
    """Points and cage after some levels, not on the limit."""
    corner = np.zeros(len(points))
    np.maximum.at(corner, cage.corners, cage.corner_sharpness)
    face_of = np.arange(len(cage.counts))
    for _ in range(level):
        points, cage, corner, face_of = subdivide._divided(points, cage, corner, face_of)
    return points, cage


def test_two_levels_are_opensubdivs():
    cage = Cage(np.array([len(face) for face in ROOF_FACES]), np.concatenate(ROOF_FACES))
    points, finer = divided(ROOF, cage, 2)
    assert len(points) == 130 and len(finer.counts) == 128
    np.testing.assert_allclose(points[:9], OPENSUBDIV, rtol=0, atol=2e-6)


def test_edges_of_triangles_lean_on_their_faces():
    """By the rule 'smooth' a triangle's centre weighs 0.47, a quad's 0.25; an edge's points weigh what is left."""
    cage = Cage(np.array([len(face) for face in ROOF_FACES]), np.concatenate(ROOF_FACES), smooth_triangles=True)
    points, _ = divided(ROOF, cage, 1)
    edges = subdivide._Edges(cage)
    centers = {tuple(sorted(face)): ROOF[face].mean(axis=0) for face in ROOF_FACES}

    def edge_point(a, b, *faces):
        weight = np.mean([0.47 if len(face) == 3 else 0.25 for face in faces])
        return (0.5 - weight) * (ROOF[a] + ROOF[b]) + weight * sum(centers[tuple(sorted(face))] for face in faces)

    for (a, b), faces in (
        ((5, 8), ([1, 5, 8], [5, 7, 8])),
        ((1, 5), ([1, 5, 8], [0, 4, 5, 1])),
        ((0, 1), ([0, 1, 3, 2], [0, 4, 5, 1])),
    ):
        place = 9 + int(np.flatnonzero((edges.ends == sorted((a, b))).all(axis=1))[0])
        np.testing.assert_allclose(points[place], edge_point(a, b, *faces), atol=1e-12)
    plain, _ = divided(ROOF, subdivide.replace(cage, smooth_triangles=False), 2)
    assert not np.allclose(divided(ROOF, cage, 2)[0], plain)


def torn(size, where):
    """A sheet's cage and values of its corners: those of faces in different regions differ; `where` gives a face's."""
    points, counts, indices = sheet(size, np.zeros((size, size)))
    face = np.arange(len(counts))
    region = where(face % (size - 1), face // (size - 1))
    keys = indices + len(points) * np.repeat(region, 4)
    _, first, values = np.unique(keys, return_index=True, return_inverse=True)
    return Cage(counts, indices), values.reshape(-1), points[indices[first]] ** 2, indices[first]


HALVES = (5, lambda x, y: (x >= 2).astype(int))
TEE = (5, lambda x, y: (y >= 2) * (1 + (x >= 2)))


@pytest.mark.parametrize(
    "rule, pinned",
    [("none", False), ("cornersOnly", False), ("cornersPlus1", False), ("cornersPlus2", False), ("boundaries", True)],
)
def test_a_seam_is_a_curve_or_stays_piecewise_straight(rule, pinned):
    """In the middle of a seam values follow the cubic B-spline along it, (a + 4 b + c) / 6, or stay where they are."""
    cage, values, st, point = torn(*HALVES)
    fine = subdivided(st, cut_apart(cage, values, rule), 2).points[: len(st)]
    for value in np.flatnonzero(point == 12):  # of the middle point, on both sides
        along = [float(st[np.flatnonzero(point == other)[0], 1]) for other in (7, 12, 17)]
        wanted = along[1] if pinned else np.dot(along, [1, 4, 1]) / 6
        assert fine[value, 1] == pytest.approx(wanted)


@pytest.mark.parametrize(
    "rule, pinned", [("none", False), ("cornersOnly", False), ("cornersPlus1", True), ("cornersPlus2", True)]
)
def test_junctions_of_three_regions_and_more_stay_from_plus_one_on(rule, pinned):
    cage, values, st, point = torn(*TEE)
    fine = subdivided(st, cut_apart(cage, values, rule), 2).points[: len(st)]
    (value,) = np.flatnonzero((point == 12) & (np.bincount(values) == 2))  # of the region that goes straight through
    assert np.allclose(fine[value], st[value]) == pinned


@pytest.mark.parametrize("rule, pinned", [("none", False), ("cornersOnly", True), ("cornersPlus1", True)])
def test_values_of_a_single_face_stay_but_by_none(rule, pinned):
    cage, values, st, point = torn(*HALVES)
    fine = subdivided(st, cut_apart(cage, values, rule), 2).points[: len(st)]
    assert np.allclose(fine[np.flatnonzero(point == 0)], st[point == 0]) == pinned

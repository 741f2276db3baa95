"""Catmull-Clark and Loop: limit positions against splines and against masks worked out by hand."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from synfog_usd.translate import loop
from synfog_usd.translate.subdivide import Cage, boundary_faces, levels, subdivided

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


@pytest.mark.parametrize("level", [1, 2, 3])
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


@pytest.mark.parametrize("level", [1, 3])
@pytest.mark.parametrize("where", ["boundary", "crease"])
def test_boundaries_and_creases_are_cubic_splines(level, where):
    """They forget what lies beside them: the row's own points are the control points of a curve."""
    heights = np.random.default_rng(3).normal(size=(9, 9))
    points, counts, indices = sheet(9, heights)
    row = 0 if where == "boundary" else 4
    chain = np.arange(9) + 9 * row
    pairs = np.stack([chain[:-1], chain[1:]], axis=1)
    cage = (
        Cage(counts, indices, creases=pairs, crease_sharpness=np.full(8, 10.0))
        if where == "crease"
        else Cage(counts, indices)
    )
    fine = subdivided(points, cage, level).points
    x, _, z = fine[(np.abs(fine[:, 1] - row) < 1e-12) & (fine[:, 0] > 1.99) & (fine[:, 0] < 6.01)].T
    assert len(z) == 4 * 2**level + 1
    np.testing.assert_allclose(z, spline(heights[row])(x), rtol=0, atol=1e-12)


@pytest.mark.parametrize("level", [1, 2, 4])
@pytest.mark.parametrize("sharpness, corner", [(0.0, 12 / 24), (0.5, 15 / 24), (1.0, 18 / 24), (10.0, 1.0)])
def test_corners_of_a_cube_by_sharpness(level, sharpness, corner):
    """Smooth: (9 + 4 - 1) / 24.  Sharpness 1: after one hard step v = 1, sum(e) = 2, sum(f) = 1, so (9 + 8 + 1) / 24; a
    half lies midway.
    """
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


def test_faces_at_the_boundary_are_known():
    """Of 3 x 3 faces only the middle one touches no boundary."""
    points, counts, indices = sheet(4, np.zeros((4, 4)))
    np.testing.assert_array_equal(boundary_faces(Cage(counts, indices), len(points)), np.arange(9) != 4)


def test_patches_part_at_creases_alone():
    """A cube with sharp edges has 6 sides of 25 corner points after two steps; a smooth one shares all 98."""
    assert len(np.unique(subdivided(BOX, cube(creases=EDGES, crease_sharpness=np.full(12, 10.0)), 2).smooth_of)) == 150
    assert len(np.unique(subdivided(BOX, cube(), 2).smooth_of)) == 98


def test_levels_shrink_with_faces():
    """At most 20 000 faces are made beyond the first level."""
    assert [levels(n) for n in (6, 300, 1000, 2000, 50_000)] == [3, 3, 2, 1, 1]


def triangles(size, heights):
    """A size x size grid of points, each square of it cut from its lower left to its upper right: six edges at every
    inner point.
    """
    points, counts, indices = sheet(size, heights)
    a, b, c, d = indices.reshape(-1, 4).T
    return points, np.full(2 * len(counts), 3), np.stack([a, b, c, a, c, d], axis=1).reshape(-1)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_regular_loop_sheet_keeps_a_parabola(level):
    """Where six triangles meet, heights x^2 become x^2 + 1/3: half of a point and a twelfth of each neighbour, four of
    which lie 1 aside.
    """
    points, counts, indices = triangles(8, np.broadcast_to(np.arange(8.0) ** 2, (8, 8)))
    fine = loop.subdivided(points, Cage(counts, indices), level).points
    x, _, z = fine[((fine[:, :2] > 1.99) & (fine[:, :2] < 5.01)).all(axis=1)].T
    assert len(z) == (3 * 2**level + 1) ** 2
    np.testing.assert_allclose(z, x**2 + 1 / 3, rtol=0, atol=1e-12)


@pytest.mark.parametrize("valence", [3, 4, 5, 6, 7, 12])
def test_a_loop_point_has_one_limit_at_every_level(valence):
    """The limit mask of the cage's own point gives what it gives after four divisions, for any number of neighbours."""
    angle = 2 * np.pi * np.arange(valence) / valence
    inner, outer = (np.stack([r * np.cos(angle), r * np.sin(angle), np.zeros(valence)], axis=1) for r in (1.0, 2.0))
    points = (
        np.concatenate([[[0, 0, 0]], inner, outer])
        + np.random.default_rng(valence).normal(size=(2 * valence + 1, 3)) * 0.2
    )
    k = np.arange(valence)
    following = (k + 1) % valence
    faces = np.concatenate(
        [
            np.stack([k * 0, 1 + k, 1 + following], 1),
            np.stack([1 + k, 1 + valence + k, 1 + valence + following], 1),
            np.stack([1 + k, 1 + valence + following, 1 + following], 1),
        ]
    )
    cage = Cage(np.full(len(faces), 3), faces.reshape(-1))
    once, often = (loop.subdivided(points, cage, level).points[: 1 + valence] for level in (1, 4))
    np.testing.assert_allclose(once, often, rtol=0, atol=1e-12)
    assert np.abs(once[0] - points[0]).max() > 1e-3  # it moved


@pytest.mark.parametrize("level", [1, 3])
@pytest.mark.parametrize("where", ["boundary", "crease"])
def test_boundaries_and_creases_of_loop_are_cubic_splines(level, where):
    """As with Catmull-Clark: the row's own points are the control points of a curve."""
    heights = np.random.default_rng(3).normal(size=(9, 9))
    points, counts, indices = triangles(9, heights)
    row = 0 if where == "boundary" else 4
    chain = np.arange(9) + 9 * row
    pairs = np.stack([chain[:-1], chain[1:]], axis=1)
    cage = (
        Cage(counts, indices, creases=pairs, crease_sharpness=np.full(8, 10.0))
        if where == "crease"
        else Cage(counts, indices)
    )
    fine = loop.subdivided(points, cage, level).points
    x, _, z = fine[(np.abs(fine[:, 1] - row) < 1e-12) & (fine[:, 0] > 1.99) & (fine[:, 0] < 6.01)].T
    assert len(z) == 4 * 2**level + 1
    np.testing.assert_allclose(z, spline(heights[row])(x), rtol=0, atol=1e-12)


@pytest.mark.parametrize("sharpness", [0.5, 1.0, 2.0])
def test_a_half_sharp_loop_corner_lies_between(sharpness):
    """A corner of sharpness s: 1 after s hard steps, 24 / 55 without; a half lies midway between none and one."""
    tips = np.concatenate([np.eye(3), -np.eye(3)])
    sides = np.array([(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)])

    def limit(s):
        cage = Cage(np.full(8, 3), sides.reshape(-1), corners=np.array([2]), corner_sharpness=np.array([s]))
        return loop.subdivided(tips, cage, 4).points[2, 2]

    # one hard step leaves the tip at 1 and its neighbours at (3/8)(1 + 0) + (1/8)(0 + 0), summed 4 x 3/8: 24/55 +
    # (31/55)(3/8)
    hard = 24 / 55 + 31 / 55 * 3 / 8
    wanted = {0.5: (24 / 55 + hard) / 2, 1.0: hard}
    if sharpness in wanted:
        np.testing.assert_allclose(limit(sharpness), wanted[sharpness], rtol=1e-12)
    else:
        assert hard < limit(sharpness) < 1.0

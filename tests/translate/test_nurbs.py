"""NURBS: conics that they hold exactly, and splines against SciPy and Bernstein."""

from math import comb

import numpy as np
import pytest
from pxr import UsdGeom
from scipy.interpolate import BSpline
from support.looks import fill

from synfog_usd.translate import translate

HALF = 0.5**0.5
CIRCLE = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0)], dtype=float)
WEIGHTS = np.array([1, HALF] * 4 + [1])
KNOTS = [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4]
"""A full circle as nine weighted points (Piegl and Tiller, The NURBS Book, 7.5)."""


def area_vectors(shape):
    a, b, c = (shape["positions"].astype(float)[shape["faces"][:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


def curve(stage, points, order, knots, **more):
    curves = UsdGeom.NurbsCurves.Define(stage, "/Curves")
    fill(curves, points=[tuple(map(float, point)) for point in points])
    fill(curves, curveVertexCounts=more.pop("counts", [len(points)]), order=order, knots=list(map(float, knots)))
    fill(curves, widths=[0.02])
    curves.SetWidthsInterpolation("constant")
    for name, value in more.items():
        curves.GetPrim().GetAttribute(name).Set(value)


def middles(shape):
    return shape["positions"].astype(float).reshape(-1, 8, 3).mean(axis=1)


def test_a_weighted_curve_is_a_circle(empty, only_shape):
    """All 25 samples stand 1 away from the middle, and the first where the last does."""
    stage = empty()
    curve(stage, [(x, 5, z) for x, z in CIRCLE], [3], KNOTS, pointWeights=list(map(float, WEIGHTS)))
    middle = middles(only_shape(translate(stage)))
    assert len(middle) == 4 * 6 + 1
    np.testing.assert_allclose(np.linalg.norm(middle - [0, 5, 0], axis=1), 1.0, atol=1e-5)
    np.testing.assert_allclose(middle[0], middle[-1], atol=1e-5)
    assert np.ptp(middle[:, 0]) == pytest.approx(2.0, abs=1e-5)


def test_two_curves_run_along_scipys_splines_within_their_ranges(empty, only_shape):
    """Orders 4 and 2, knots of their own; the first is cut to [0.5, 2]."""
    stage = empty()
    rng = np.random.default_rng(1)
    one, two = np.array([0, 5, 0]) + rng.uniform(-1, 1, (5, 3)), np.array([0, 9, 0]) + rng.uniform(-1, 1, (3, 3))
    knots = [0, 0, 0, 0, 1, 2, 2, 2, 2], [0, 0, 1, 3, 3]
    curve(stage, [*one, *two], [4, 2], [*knots[0], *knots[1]], counts=[5, 3], ranges=[(0.5, 2.0), (0.0, 3.0)])
    middle = middles(only_shape(translate(stage)))
    u = np.concatenate([np.linspace(0.5, 1, 7)[:-1], np.linspace(1, 2, 7)])
    v = np.concatenate([np.linspace(0, 1, 7)[:-1], np.linspace(1, 3, 7)])
    np.testing.assert_allclose(middle[:13], BSpline(knots[0], one, 3)(u), atol=1e-5)
    np.testing.assert_allclose(middle[13:], BSpline(knots[1], two, 1)(v), atol=1e-5)


@pytest.mark.parametrize("more, found", [
    ({"knots": [0.0, 0.0, 1.0]}, "knots"),
    ({"knots": [0.0, 0.0, 2.0, 1.0, 1.0]}, "rise"),
    ({"pointWeights": [1.0, -1.0, 1.0]}, "weights"),
    ({"order": [1]}, "knots"),
])  # fmt: skip
def test_broken_curves_are_left_out_with_a_note(empty, more, found):
    stage = empty()
    curve(stage, [(0, 5, 0), (1, 5, 0), (2, 5, 0)], **{"order": [2], "knots": [0, 0, 1, 2, 2]} | more)
    scene = translate(stage)
    assert not any(key.startswith("shape_") for key in scene.world)
    assert [found in note.text for note in scene.notes if note.path == "/Curves"] == [True]


def patch(stage, points, shape, orders, knots, weights=None):
    prim = UsdGeom.NurbsPatch.Define(stage, "/Patch")
    fill(prim, points=[tuple(map(float, point)) for point in points], uVertexCount=shape[0], vVertexCount=shape[1])
    fill(prim, uOrder=orders[0], vOrder=orders[1], uKnots=list(map(float, knots[0])), vKnots=list(map(float, knots[1])))
    if weights is not None:
        prim.CreatePointWeightsAttr(list(map(float, weights)))
    return prim


@pytest.mark.parametrize("left_handed", [False, True])
def test_a_weighted_patch_is_a_cylinder(empty, only_shape, left_handed):
    """Points 1 away from the axis, normals straight away from it, and a prism's area between 32 of them: 2 * 32 sin(pi
    / 32) to 2e-2.
    """
    stage = empty()
    points = [(x, 5 + y, z) for z in (0.0, 1.0) for x, y in CIRCLE]
    prim = patch(stage, points, (9, 2), (3, 2), (KNOTS, [0, 0, 1, 1]), np.tile(WEIGHTS, 2))
    if left_handed:
        prim.CreateOrientationAttr("leftHanded")
    shape = only_shape(translate(stage))
    away = shape["positions"].astype(float) - [0, 5, 0]
    away[:, 2] = 0
    sign = -1 if left_handed else 1
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(shape["normals"], sign * away, atol=1e-5)
    areas = area_vectors(shape)
    assert (sign * np.einsum("ij,ij->i", areas, away[shape["faces"][:, 0]]) > 0).all()
    np.testing.assert_allclose(
        np.linalg.norm(areas, axis=1).sum(), 2 * np.pi, rtol=2e-3
    )  # (pi / 32)^2 / 6, unevenly spaced


def test_a_cubic_patch_is_bernsteins(empty, only_shape):
    """4 x 4 points without inner knots: sum of B_i(u) B_j(v) P_ij, U running fastest; coordinates are u and v."""
    stage = empty()
    rng = np.random.default_rng(4)
    grid = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0)), axis=-1)
    points = np.concatenate([grid, rng.uniform(-1, 1, (4, 4, 1))], axis=2)[..., [0, 2, 1]] + [0, 5, 0]
    patch(stage, points.reshape(-1, 3), (4, 4), (4, 4), ([0] * 4 + [1] * 4,) * 2)
    shape = only_shape(translate(stage))
    t = np.linspace(0, 1, 9)
    basis = np.array([comb(3, k) * t**k * (1 - t) ** (3 - k) for k in range(4)])
    wanted = np.einsum("iu,jv,jic->vuc", basis, basis, points)
    np.testing.assert_allclose(shape["positions"], wanted.reshape(-1, 3), atol=1e-5)


def test_a_patch_that_does_not_fit_or_is_trimmed_is_told(empty):
    stage = empty()
    points = [(x, 5, z) for z in (0, 1) for x in (0, 1)]
    prim = patch(stage, points, (2, 2), (2, 2), ([0, 0, 1, 1], [0, 0, 1]))
    assert any("vKnots" in note.text for note in translate(stage).notes if note.path == "/Patch")
    prim.GetVKnotsAttr().Set([0.0, 0.0, 1.0, 1.0])
    prim.CreateTrimCurveCountsAttr([1])
    scene = translate(stage)
    assert any("trim" in note.text for note in scene.notes if note.path == "/Patch")
    assert len(scene.world["shape_0"]["faces"]) == 2


@pytest.mark.parametrize("authored", [False, True])
@pytest.mark.parametrize("orientation", ["rightHanded", "leftHanded"])
def test_tetrahedra_are_drawn_by_their_outside(empty, only_shape, authored, orientation):
    """A unit cube of five tetrahedra, one of them inside: twelve faces, volume 1 by the divergence theorem."""
    stage = empty()
    mesh = UsdGeom.TetMesh.Define(stage, "/Tets")
    corners = [(x, 5 + y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
    mesh.CreatePointsAttr(corners)
    cells = [(0, 1, 2, 4), (3, 2, 1, 7), (5, 4, 7, 1), (6, 7, 4, 2), (1, 2, 4, 7)]
    cells = [
        c if np.linalg.det(np.array([corners[k] for k in c[1:]]) - corners[c[0]]) > 0 else (c[0], c[2], c[1], c[3])
        for c in cells
    ]
    if orientation == "leftHanded":
        cells = [(a, c, b, d) for a, b, c, d in cells]
    fill(mesh, tetVertexIndices=cells, orientation=orientation)
    if authored:
        mesh.CreateSurfaceFaceVertexIndicesAttr(UsdGeom.TetMesh.ComputeSurfaceFaces(mesh))
    mesh.CreateDisplayColorPrimvar("vertex").Set([(k / 7, 0, 0) for k in range(8)])
    shape = only_shape(translate(stage))
    p = shape["positions"].astype(float) - [0, 5, 0]
    assert len(shape["faces"]) == 12
    np.testing.assert_allclose(np.einsum("ij,ij->", p[shape["faces"][:, 0]], area_vectors(shape)) / 3, 1.0, rtol=1e-6)
    np.testing.assert_allclose(shape["vertex_color"][:, 0], p @ [1, 2, 4] / 7, atol=1e-6)

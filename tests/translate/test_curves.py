"""Curves and points: lengths, widths and volumes by closed forms."""

from math import comb

import numpy as np
import pytest
from pxr import Sdf, UsdGeom
from scipy.interpolate import BSpline
from support.looks import fill, painted, shade

from synfog_usd.translate import translate


def area_vectors(positions, faces):
    a, b, c = (np.asarray(positions, dtype=float)[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


def rings(shape, sides):
    """Middles and mean radii of a tube's rings."""
    points = shape["positions"].astype(float).reshape(-1, sides, 3)
    middle = points.mean(axis=1)
    return middle, np.linalg.norm(points - middle[:, None], axis=2).mean(axis=1)


def define(stage, points, counts, **more):
    curves = UsdGeom.BasisCurves.Define(stage, "/Curves")
    fill(curves, points=points, curveVertexCounts=counts, widths=more.pop("widths", [0.2]))
    curves.SetWidthsInterpolation(more.pop("interpolation", "constant"))
    for name, value in more.items():
        curves.GetPrim().GetAttribute(name).Set(value)
    return curves


def test_a_straight_wire_has_its_diameter(empty, only_shape):
    """Widths are diameters: a tube of 8 sides has 2 pi r L of side, as the circle whose outline it keeps."""
    stage = empty()
    define(stage, [(0, 5, 0), (3, 5, 0)], [2], type="linear")
    shape = only_shape(translate(stage))
    np.testing.assert_allclose(
        np.linalg.norm(area_vectors(shape["positions"], shape["faces"]), axis=1).sum(), 2 * np.pi * 0.1 * 3, rtol=1e-5
    )
    outward = shape["positions"].astype(float) - [0, 5, 0]
    outward[:, 0] = 0
    np.testing.assert_allclose(shape["normals"], outward / np.linalg.norm(outward, axis=1, keepdims=True), atol=1e-5)
    areas = area_vectors(shape["positions"], shape["faces"])
    assert (np.einsum("ij,ij->i", areas, shape["normals"][shape["faces"][:, 0]]) > 0).all()


ARCH = np.array([(0, 5, 0), (1, 5, 2), (3, 6, 2), (4, 5, 0)], dtype=float)


def bernstein(t):
    return sum(comb(3, k) * t[:, None] ** k * (1 - t[:, None]) ** (3 - k) * ARCH[k] for k in range(4))


def straight(t):
    return np.stack([2 * t, 5 + 0 * t, 0 * t], axis=1)


@pytest.mark.parametrize("basis, wrap, points, wanted", [
    ("bezier", "nonperiodic", ARCH, bernstein),
    ("bspline", "nonperiodic", ARCH, BSpline(np.arange(-3.0, 5.0), ARCH, 3)),
    ("catmullRom", "pinned", [(0, 5, 0), (2, 5, 0)], straight),
    ("bspline", "pinned", [(0, 5, 0), (2, 5, 0)], straight),
])  # fmt: skip
def test_cubic_curves_run_along_their_splines(empty, only_shape, basis, wrap, points, wanted):
    """Six steps of one segment: Bernstein's polynomials, SciPy's B-spline; pinned ends meet the end points."""
    stage = empty()
    define(stage, [tuple(map(float, point)) for point in points], [len(points)], type="cubic", basis=basis, wrap=wrap)
    middle, radius = rings(only_shape(translate(stage)), 8)
    np.testing.assert_allclose(middle, wanted(np.linspace(0, 1, 7)), atol=1e-6)
    np.testing.assert_allclose(radius, 0.1 * (np.pi / 8) / np.sin(np.pi / 8), rtol=1e-4)


@pytest.mark.parametrize("basis", ["bspline", "catmullRom"])
def test_periodic_curves_close(empty, only_shape, basis):
    """A ring of 12 points is as many segments."""
    stage = empty()
    angle = np.arange(12) * 2 * np.pi / 12
    define(
        stage, [(float(np.cos(a)), 5.0, float(np.sin(a))) for a in angle], [12], type="cubic", basis=basis,
        wrap="periodic", widths=[0.02],
    )  # fmt: skip
    middle, _ = rings(only_shape(translate(stage)), 8)
    assert len(middle) == 12 * 6 + 1
    np.testing.assert_allclose(middle[0], middle[-1], atol=1e-6)
    spread = np.linalg.norm(middle - [0, 5, 0], axis=1)
    assert np.ptp(spread) < 0.003 and spread.min() > 0.94


@pytest.mark.parametrize("interpolation, widths, wanted", [
    ("vertex", [0.2, 0.4, 0.2, 0.1, 0.1], [0.1, 0.2, 0.1, 0.05, 0.05]),
    ("varying", [0.2, 0.4, 0.2, 0.1, 0.1], [0.1, 0.2, 0.1, 0.05, 0.05]),
    ("uniform", [0.2, 0.4], [0.1, 0.1, 0.1, 0.2, 0.2]),
    ("vertex", [0.2, 0.4], [0.1, 0.1, 0.1, 0.2, 0.2]),
    ("vertex", [0.2], [0.1] * 5),
])  # fmt: skip
def test_widths_of_every_interpolation(empty, only_shape, interpolation, widths, wanted):
    stage = empty()
    define(
        stage, [(0, 5, 0), (1, 5, 0), (2, 5, 0), (0, 5, 2), (1, 5, 2)], [3, 2], type="linear", widths=widths,
        interpolation=interpolation,
    )  # fmt: skip
    middle, radius = rings(only_shape(translate(stage)), 8)
    order = np.lexsort((middle[:, 0], middle[:, 2].round(3)))
    np.testing.assert_allclose(radius[order] * np.sin(np.pi / 8) / (np.pi / 8), wanted, rtol=1e-4)


def test_points_are_balls_of_their_width(empty, only_shape):
    """A ball of 80 faces keeps the sphere's surface pi d^2; a point without width is not drawn."""
    stage = empty()
    cloud = UsdGeom.Points.Define(stage, "/Points")
    fill(cloud, points=[(0, 5, 0), (2, 5, 0), (4, 5, 0)], widths=[0.2, 0.0, 0.6])
    cloud.SetWidthsInterpolation("vertex")
    UsdGeom.PrimvarsAPI(cloud).CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "vertex").Set(
        [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
    )
    shape = only_shape(translate(stage))
    left = shape["positions"][shape["faces"][:, 0], 0] < 2
    areas = np.linalg.norm(area_vectors(shape["positions"], shape["faces"]), axis=1)
    np.testing.assert_allclose([areas[left].sum(), areas[~left].sum()], [np.pi * 0.04, np.pi * 0.36], rtol=1e-5)
    np.testing.assert_array_equal(shape["vertex_color"][shape["positions"][:, 0] < 2], [[1, 0, 0]] * 42)
    np.testing.assert_array_equal(shape["vertex_color"][shape["positions"][:, 0] > 2], [[0, 0, 1]] * 42)


@pytest.mark.parametrize("change", [{"curveVertexCounts": [-1, 3]}, {"widths": []}, {"type": "cubic"}])
def test_broken_curves_are_left_out_with_a_note(empty, change):
    stage = empty()
    curves = define(stage, [(0, 5, 0), (1, 5, 0)], [2], type="linear")
    for name, value in change.items():
        curves.GetPrim().GetAttribute(name).Set(value)
    scene = translate(stage)
    assert not any(key.startswith("shape_") for key in scene.world)
    assert [note.severity for note in scene.notes if note.path == "/Curves"] == ["warning"]


@pytest.mark.parametrize("name", ["normals", "primvars:normals"])
def test_curves_with_normals_are_flat_ribbons(empty, only_shape, name, facing=(0.8, -1, 0)):
    """A strip of width 0.2 and length 3 has an area of 0.6 and looks along what of its normal stands at right angles to
    it.
    """
    stage = empty()
    curves = define(stage, [(0, 5, 0), (1, 5, 0), (3, 5, 0)], [3], type="linear")
    if name == "normals":
        curves.CreateNormalsAttr([facing] * 3)
        curves.SetNormalsInterpolation("vertex")
    else:
        UsdGeom.PrimvarsAPI(curves).CreatePrimvar("normals", Sdf.ValueTypeNames.Normal3fArray, "constant").Set([facing])
    shape = only_shape(translate(stage))
    areas = area_vectors(shape["positions"], shape["faces"])
    np.testing.assert_allclose(areas.sum(axis=0), [0, -0.6, 0], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(areas, axis=1).sum(), 0.6, rtol=1e-6)
    np.testing.assert_allclose(shape["normals"], [[0, -1, 0]] * 6, atol=1e-6)


def test_a_ribbon_turns_with_its_normals(empty, only_shape):
    """Between two normals a quarter apart the strip stands across their mean: after a share t it has turned by atan(t /
    (1 - t)), and keeps its width.
    """
    stage = empty()
    curves = define(
        stage, [(0, 5, 0), (1, 5, 0), (2, 5, 0), (3, 5, 0)], [4], type="cubic", basis="bezier", widths=[1.0]
    )
    angle = np.radians([0.0, 90.0])
    curves.CreateNormalsAttr([(0.0, float(np.cos(a)), float(np.sin(a))) for a in angle])
    curves.SetNormalsInterpolation("varying")
    shape = only_shape(translate(stage))
    p = shape["positions"].astype(float).reshape(-1, 2, 3)
    across, t = p[:, 0] - p[:, 1], np.linspace(0, 1, 7)
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(p.mean(axis=1), np.stack([3 * t, 5 + 0 * t, 0 * t], axis=1), atol=1e-6)
    np.testing.assert_allclose(np.arctan2(np.abs(across[:, 1]), np.abs(across[:, 2])), np.arctan2(t, 1 - t), atol=1e-6)
    np.testing.assert_allclose(
        np.einsum("ij,ij->i", np.cross([1, 0, 0], across), shape["normals"][::2]), 1.0, rtol=1e-6
    )


@pytest.mark.parametrize("name", ["displayColor", "tint"])
def test_colours_run_along_a_curve(empty, only_shape, name, interpolation="vertex"):
    """Red at its left end, blue at its right one; also where a reader names them."""
    stage = empty()
    curves = define(stage, [(0, 5, 0), (3, 5, 0)], [2], type="linear")
    colors = UsdGeom.PrimvarsAPI(curves).CreatePrimvar(name, Sdf.ValueTypeNames.Color3fArray, interpolation)
    colors.Set([(1, 0, 0), (0, 0, 1)])
    if name != "displayColor":
        reading(stage, curves, name)
    shape = only_shape(translate(stage))
    right = shape["positions"][:, 0] > 1.5
    np.testing.assert_allclose(shape["vertex_color"][~right], [[1, 0, 0]] * 8)
    np.testing.assert_allclose(shape["vertex_color"][right], [[0, 0, 1]] * 8)


def reading(stage, curves, name):
    color = shade(stage, "/M/Reader", "UsdPrimvarReader_float3", "result", Sdf.ValueTypeNames.Float3, varname=name)
    painted(curves.GetPrim(), "/M", diffuseColor=color)


@pytest.mark.parametrize("kind", ["BasisCurves", "Points"])
@pytest.mark.parametrize("own, wanted_m", [(None, 0.4), ([2.0], 2.0)])
def test_constant_widths_come_from_above_where_a_prim_has_none(empty, only_shape, kind, own, wanted_m):
    """As any constant primvar; a width of the prim's own comes first."""
    stage = empty()
    prim = stage.DefinePrim("/Scope/Curves", kind)
    prim.GetAttribute("points").Set([(0, 5, 0), (3, 5, 0)])
    if kind == "BasisCurves":
        prim.GetAttribute("curveVertexCounts").Set([2])
        prim.GetAttribute("type").Set("linear")
        UsdGeom.BasisCurves(prim).SetWidthsInterpolation("constant")
    if own is not None:
        prim.GetAttribute("widths").Set(own)
    above = UsdGeom.PrimvarsAPI(prim.GetParent()).CreatePrimvar("widths", Sdf.ValueTypeNames.HalfArray, "constant")
    above.Set([0.4])
    assert np.ptp(only_shape(translate(stage))["positions"][:, 2]) == pytest.approx(wanted_m, rel=0.1)

"""NURBS: curves as sampled lines, patches as triangles.

Takes NurbsCurves and NurbsPatch prims; gives points exactly on them.  Source of the
evaluation: de Boor's recurrence, as scipy has it; derivatives of a quotient.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd
from scipy.interpolate import BSpline

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles, cross
from synfog_usd.translate.primvars import ORIENTATIONS, array_at, value_at

_STEPS = 8
"""Steps of a patch within each span of its knots, where it is bent."""

_MOST = 1_000_000
"""Points of a patch."""


@dataclass(frozen=True)
class Nurbs:
    """NurbsCurves, checked.

    Attributes:
        points: (N, 3) control points of all curves.
        sizes, segments: control points and spans of each curve.
        orders: of each curve.
        knots: of each curve.
        breaks: ends of the spans of each curve, (segments + 1,).
        weights: (N,).
    """

    points: Array
    sizes: Indices
    segments: Indices
    orders: Indices
    knots: list[Array]
    breaks: list[Array]
    weights: Array
    closed = False

    @property
    def cubic(self) -> bool:
        """Whether any segment is bent."""
        return bool((self.orders > 2).any())

    def alike(self) -> list[Indices]:
        """Numbers of the curves that can be sampled together: one by one, for each has knots of its own."""
        return [np.array([number]) for number in np.flatnonzero(self.segments >= 1)]

    def line(self, chosen: Indices, steps: int) -> Array:
        """(1, S, 3) points along a curve."""
        return self.sampled(self.points, chosen, steps)

    def sampled(self, values: Array, chosen: Indices, steps: int) -> Array:
        """(1, S, C) of values that go with the points."""
        number = int(chosen[0])
        start = int(self.sizes[:number].sum())
        own, weights = values[start : start + self.sizes[number]], self.weights[start : start + self.sizes[number]]
        spline = BSpline(
            self.knots[number], np.column_stack([own * weights[:, None], weights]), int(self.orders[number]) - 1
        )
        found = spline(_within(self.breaks[number], steps))
        return np.asarray(found[:, :-1] / found[:, -1:])[None]


def nurbs_curves(prim: Usd.Prim, time: Usd.TimeCode, points: Array, sizes: Indices) -> Nurbs | str:
    """The curves of a NurbsCurves prim, or what is wrong with them."""
    orders, knots = array_at(prim, "order", time, 1), array_at(prim, "knots", time, 1)
    if orders is None or knots is None or len(orders) not in (1, len(sizes)):
        return "NURBS curves without an order each and knots"
    order = np.broadcast_to(orders[:, 0].astype(np.int64), (len(sizes),))
    lengths = sizes + order
    if (order < 2).any() or lengths.sum() != len(knots):
        return (
            f"NURBS curves have {len(knots)} knots, which are not their points and orders together "
            f"({int(lengths.sum())})"
        )
    ranges, weights = array_at(prim, "ranges", time, 2), array_at(prim, "pointWeights", time, 1)
    weight = np.ones(len(points)) if weights is None or len(weights) != len(points) else weights[:, 0]
    if not (np.isfinite(weight).all() and (weight > 0.0).all()):
        return "NURBS curves with weights that are not above 0"
    own = np.split(knots[:, 0], np.cumsum(lengths)[:-1])
    breaks = []
    for number, line in enumerate(own):
        found = _breaks(
            line,
            int(sizes[number]),
            int(order[number]),
            ranges[number] if ranges is not None and len(ranges) == len(sizes) else None,
        )
        if isinstance(found, str):
            return f"NURBS curve {number} with {found}"
        breaks.append(found)
    return Nurbs(points, sizes, np.array([len(line) - 1 for line in breaks]), order, own, breaks, weight)


def _breaks(knots: Array, size: int, order: int, over: Array | None) -> Array | str:
    """Ends of the spans between the knots, over which a spline of so many points is defined."""
    if not np.isfinite(knots).all() or (np.diff(knots) < 0.0).any():
        return "knots that do not rise"
    if size < order:
        return np.zeros(1)
    low, high = knots[order - 1], knots[size]
    if over is not None and np.isfinite(over).all() and over[0] < over[1]:
        low, high = max(low, float(over[0])), min(high, float(over[1]))
    if not low < high:
        return "knots that span nothing"
    inner = np.unique(knots[(knots > low) & (knots < high)])
    return np.array([low, *inner, high])


def _within(breaks: Array, steps: int) -> Array:
    """`steps` parameters to a span, ends included."""
    share = np.arange(steps) / steps
    return np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * share).reshape(-1), breaks[-1])


def read_patch(prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics) -> Triangles | None:
    """A NurbsPatch as triangles whose points lie on it, with its normals; or None with a note.

    Coordinates are the parameters from 0 to 1 along U and V, unless it has `st` for each control point.
    """
    path = prim.GetPath()
    fault, columns = "", 0
    axes: list[tuple[int, int, Array, Array]] = []
    points, weights = array_at(prim, "points", time, 3), array_at(prim, "pointWeights", time, 1)
    for axis in "uv":
        count, order = (int(value_at(prim.GetAttribute(axis + name), time) or 0) for name in ("VertexCount", "Order"))
        knots, over = array_at(prim, f"{axis}Knots", time, 1), array_at(prim, f"{axis}Range", time, 2)
        if order < 2 or count < order or knots is None or len(knots) != count + order:
            fault = (
                f"its {axis}Knots are not as many as its {axis}VertexCount and {axis}Order together, or its points "
                f"fewer than its order"
            )
            break
        breaks = _breaks(knots[:, 0], count, order, over[0] if over is not None else None)
        if isinstance(breaks, str):
            fault = f"it has {axis}-{breaks}"
            break
        axes.append((count, order, knots[:, 0], _within(breaks, _STEPS if order > 2 else 1)))
    if not fault and (points is None or len(points) != axes[0][0] * axes[1][0] or not np.isfinite(points).all()):
        fault = "its points are not uVertexCount x vVertexCount finite ones"
    weight = (
        np.ones(0 if points is None else len(points))
        if weights is None or points is None or len(weights) != len(points)
        else weights[:, 0]
    )
    if not fault and not (np.isfinite(weight).all() and (weight > 0.0).all()):
        fault = "its weights are not above 0"
    if not fault and len(axes[0][3]) * len(axes[1][3]) > _MOST:
        fault = f"it would take {len(axes[0][3])} x {len(axes[1][3])} points, of at most {_MOST}"
    if fault or points is None:
        notes.warn(path, f"a NurbsPatch is left out: {fault}")
        return None
    if value_at(prim.GetAttribute("trimCurve:counts"), time):
        notes.warn(
            path, "trim curves of a NurbsPatch are not drawn: the whole patch is; export it as a mesh to have it cut"
        )
    grid = np.column_stack([points * weight[:, None], weight]).reshape(axes[1][0], axes[0][0], 4)  # U runs fastest

    def at(values: Array, u_derivative: int, v_derivative: int) -> Array:
        for axis, derivative in ((1, u_derivative), (0, v_derivative)):
            _, order, knots, places = axes[1 - axis]
            spline = BSpline(knots, values, order - 1, axis=axis)
            values = (spline.derivative(derivative) if derivative else spline)(places)
        return values.reshape(-1, values.shape[-1])

    whole, along_u, along_v = at(grid, 0, 0), at(grid, 1, 0), at(grid, 0, 1)
    positions = whole[:, :3] / whole[:, 3:]
    du, dv = ((along[:, :3] - positions * along[:, 3:]) / whole[:, 3:] for along in (along_u, along_v))
    normals = cross(du, dv)
    columns = len(axes[0][3])
    a = (np.arange(len(axes[1][3]) - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
    faces = np.concatenate(
        [np.stack([a, a + 1, a + columns + 1], axis=1), np.stack([a, a + columns + 1, a + columns], axis=1)]
    )
    side = value_at(prim.GetAttribute("orientation"), time)
    if notes.token(path, "orientation", side, ORIENTATIONS, "rightHanded") == "leftHanded":
        normals, faces = -normals, faces[:, ::-1]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    flat = not (length > 1e-12 * length.max(initial=0.0)).all()  # at a pole one derivative is nothing
    st = _coordinates(prim, time, len(points))
    if st is None:
        u, v = ((places - places[0]) / (places[-1] - places[0]) for _, _, _, places in axes)
        texcoords = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    else:
        of_points = np.column_stack([st * weight[:, None], weight]).reshape(axes[1][0], axes[0][0], 3)
        found = at(of_points, 0, 0)
        texcoords = found[:, :2] / found[:, 2:]
    return Triangles(positions, faces, None if flat else normals / length, texcoords)


def _coordinates(prim: Usd.Prim, time: Usd.TimeCode, count: int) -> Array | None:
    """(N, 2) `st` of the control points, or None."""
    st = array_at(prim, "primvars:st", time, 2)
    return st if st is not None and len(st) == count else None

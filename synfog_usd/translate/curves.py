"""Curves as tubes or ribbons, and points as balls: meshes in the prim's own coordinates.

Takes BasisCurves, HermiteCurves, NurbsCurves and Points; gives triangles.  `widths` are diameters.  Knows
nothing of materials or Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.translate import finite
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles
from synfog_usd.translate.implicit import ball
from synfog_usd.translate.nurbs import Nurbs, nurbs_curves
from synfog_usd.translate.primvars import array_at, columns_of, flattened
from synfog_usd.translate.sweep import ribbons, tubes

MOST_TRIANGLES = 4_000_000
"""Triangles of one prim; about 0.5 GB with the renderer's copy."""

_COARSE_TO_FINE = ((3, 1), (4, 2), (6, 4), (8, 6))
"""(sides of a tube, steps of a cubic segment); the finest that stays within the budget is taken."""

_FEW_TRIANGLES = 400_000

# rows: weights of the four control points for 1, t, t^2, t^3
_BASES = {
    "bezier": np.array([[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], dtype=np.float64),
    "bspline": np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], dtype=np.float64) / 6.0,
    "catmullRom": np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]], dtype=np.float64) / 2.0,
}


def read_curves(
    prim: Usd.Prim, kind: str, time: Usd.TimeCode, notes: Diagnostics, color: str | None = "displayColor"
) -> Triangles | None:
    """Curves as tubes whose mean width is theirs, or as flat ribbons where they have normals; None with a note.

    Args:
        prim: a BasisCurves, HermiteCurves or NurbsCurves.
        kind: which of these.
        color: the primvar of their colours, or None for none.

    Ends are open.
    """
    path = prim.GetPath()
    points, counts = array_at(prim, "points", time, 3), array_at(prim, "curveVertexCounts", time, 1)
    if points is None or counts is None or not len(counts):
        notes.warn(path, "curves without points are left out")
        return None
    sizes = counts[:, 0].astype(np.int64)
    if (sizes < 0).any() or sizes.sum() != len(points) or not np.isfinite(points).all():
        notes.warn(
            path,
            f"curves whose counts do not fit their {len(points)} points, or whose points are no finite numbers, are "
            f"left out",
        )
        return None
    api = UsdGeom.Curves(prim)
    widths, spread_widths = _widths(prim, time, str(api.GetWidthsInterpolation()))
    if widths is None or not np.isfinite(widths).all() or not widths.max() > 0.0:
        notes.warn(path, "curves without widths are left out; author widths (diameters)")
        return None
    shape = _shape(prim, kind, time, points, sizes, notes)
    if shape is None:
        return None
    facing, spread = array_at(prim, "primvars:normals", time, 3), api.GetNormalsInterpolation()
    if facing is None:
        facing = array_at(prim, "normals", time, 3)
    else:
        spread = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals").GetInterpolation()
    if facing is not None and not np.isfinite(facing).all():
        notes.warn(path, "normals that are no finite numbers are not used; the curves are tubes")
        facing = None
    total = int(shape.segments.sum())
    fits = [
        (sides, steps)
        for sides, steps in _COARSE_TO_FINE
        if 2 * sides * total * (steps if shape.cubic else 1) <= _FEW_TRIANGLES
    ]
    sides, steps = fits[-1] if fits else _COARSE_TO_FINE[0]
    sides = 1 if facing is not None else sides
    steps = steps if shape.cubic else 1
    if 2 * sides * total * steps > MOST_TRIANGLES:
        notes.warn(
            path,
            f"{len(sizes)} curves would take {2 * sides * total * steps} triangles, of at most {MOST_TRIANGLES}; they "
            f"are left out",
        )
        return None
    width_of = Spread(widths, spread_widths, shape)
    if not width_of.fits:
        notes.warn(path, f"widths are too few for their interpolation {spread_widths!r}; the curves take the mean")
    color_of = _curve_colors(prim, time, color, shape, notes) if color is not None else None
    facing_of = None if facing is None else Spread(facing, str(spread), shape)
    made: list[tuple[Array, Indices, Array]] = []
    colors: list[Array] = []
    for chosen in shape.alike():
        line = shape.line(chosen, steps)
        radius = 0.5 * np.maximum(width_of.along(chosen, steps)[..., 0], 0.0)
        made.append(
            tubes(line, radius, sides) if facing_of is None else ribbons(line, radius, facing_of.along(chosen, steps))
        )
        if color_of is not None:
            along = np.broadcast_to(color_of.along(chosen, steps), line.shape)
            colors.append(np.repeat(along.reshape(-1, 3), len(made[-1][0]) // (line.shape[0] * line.shape[1]), axis=0))
    if not made:
        notes.warn(path, "curves of too few points for one segment are left out")
        return None
    offsets = np.cumsum([0, *[len(positions) for positions, _, _ in made[:-1]]])
    return Triangles(
        np.concatenate([positions for positions, _, _ in made]),
        np.concatenate([faces + offset for (_, faces, _), offset in zip(made, offsets, strict=True)]),
        np.concatenate([normals for _, _, normals in made]),
        colors=np.concatenate(colors) if colors else None,
    )


def _widths(prim: Usd.Prim, time: Usd.TimeCode, interpolation: str) -> tuple[Array | None, str]:
    """(K, 1) widths and their interpolation: primvars:widths before widths, as UsdGeom has it, and where neither is
    there, a constant primvar from above.
    """
    api = UsdGeom.PrimvarsAPI(prim)
    own = array_at(prim, "widths", time, 1)
    primvar = api.GetPrimvar("widths") if own is not None else api.FindPrimvarWithInheritance("widths")
    found = flattened(primvar, time) if primvar else None
    if isinstance(found, np.ndarray) and found.shape[1] == 1:
        return found, str(primvar.GetInterpolation())
    return own, interpolation


def _curve_colors(
    prim: Usd.Prim, time: Usd.TimeCode, name: str, shape: Cubics | Hermite | Nurbs, notes: Diagnostics
) -> Spread | None:
    """A primvar of curves as colours at their samples; None where it has none."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
    values = _colors(prim, time, name, notes)
    if values is None:
        return None
    interpolation = str(primvar.GetInterpolation())
    spread = Spread(values, "varying" if interpolation == "faceVarying" else interpolation, shape)
    if not spread.fits:
        notes.warn(prim.GetPath(), f"primvar {name} has too few values for {interpolation!r}; the curves take the mean")
    return spread


def _colors(prim: Usd.Prim, time: Usd.TimeCode, name: str, notes: Diagnostics) -> Array | None:
    """(K, 3) colours of a primvar; None with a note where it holds none."""
    values = flattened(UsdGeom.PrimvarsAPI(prim).GetPrimvar(name), time)
    array = None if values is None or isinstance(values, str) else columns_of(values, 3, len(values))
    if values is not None and array is None:
        notes.warn(prim.GetPath(), f"primvar {name} holds no colours; it is not used")
    return None if array is None else finite.of_array(array, "vertex_color", prim.GetPath(), notes)


def _shape(
    prim: Usd.Prim, kind: str, time: Usd.TimeCode, points: Array, sizes: Indices, notes: Diagnostics
) -> Cubics | Hermite | Nurbs | None:
    """How curves run, or None with a note."""
    path = prim.GetPath()
    if kind == "NurbsCurves":
        found = nurbs_curves(prim, time, points, sizes)
        if isinstance(found, str):
            notes.warn(path, f"{found}; the curves are left out")
            return None
        return found
    if kind == "HermiteCurves":
        tangent = array_at(prim, "tangents", time, 3)
        if tangent is None or len(tangent) != len(points) or not np.isfinite(tangent).all():
            notes.warn(path, f"Hermite curves of {len(points)} points without as many tangents are left out")
            return None
        return Hermite(points, sizes, np.maximum(sizes - 1, 0), tangent)
    curves = UsdGeom.BasisCurves(prim)
    wrap = notes.token(path, "wrap", curves.GetWrapAttr().Get(), ("nonperiodic", "periodic", "pinned"), "nonperiodic")
    degree = notes.token(path, "type", curves.GetTypeAttr().Get(), ("linear", "cubic"), "cubic")
    basis = "linear" if degree == "linear" else str(curves.GetBasisAttr().Get())
    if basis not in (*_BASES, "linear"):
        notes.warn(
            path, f"curves of basis {basis!r} are not known; they are drawn as straight lines between their points"
        )
        basis = "linear"
    return Cubics(points, sizes, np.array([_segments(int(n), basis, wrap) for n in sizes]), basis, wrap)


@dataclass(frozen=True)
class Cubics:
    """BasisCurves.

    Attributes:
        points: (N, 3) control points of all curves.
        sizes, segments: how many of each a curve has.
        basis, wrap: as UsdGeomBasisCurves names them; 'linear' is a basis too.
    """

    points: Array
    sizes: Indices
    segments: Indices
    basis: str
    wrap: str

    @property
    def cubic(self) -> bool:
        """Whether segments are bent."""
        return self.basis != "linear"

    @property
    def closed(self) -> bool:
        """Whether the end of a curve is its beginning."""
        return self.wrap == "periodic"

    def alike(self) -> list[Indices]:
        """Numbers of the curves that can be sampled together."""
        return [np.flatnonzero(self.sizes == size) for size in np.unique(self.sizes[self.segments >= 1])]

    def line(self, chosen: Indices, steps: int) -> Array:
        """(F, S, 3) points along some curves."""
        return self.sampled(self.points, chosen, steps)

    def sampled(self, values: Array, chosen: Indices, steps: int) -> Array:
        """(F, S, C) of values that go with the points."""
        return _sampled(_of_curves(values, self.sizes, chosen), self.basis, self.wrap, steps)


@dataclass(frozen=True)
class Hermite:
    """HermiteCurves: cubic between points, with a tangent at each of these.

    Attributes:
        points: (N, 3).
        sizes, segments: how many of each a curve has.
        tangent: (N, 3), for a parameter from 0 to 1 on each segment.
    """

    points: Array
    sizes: Indices
    segments: Indices
    tangent: Array
    cubic = True
    closed = False

    def alike(self) -> list[Indices]:
        """Numbers of the curves that can be sampled together."""
        return [np.flatnonzero(self.sizes == size) for size in np.unique(self.sizes[self.segments >= 1])]

    def line(self, chosen: Indices, steps: int) -> Array:
        """(F, S, 3) points along some curves: Bezier curves whose inner points lie a third of the tangents away."""
        point, tangent = (_of_curves(values, self.sizes, chosen) for values in (self.points, self.tangent))
        inner = np.stack(
            [point[:, :-1], point[:, :-1] + tangent[:, :-1] / 3.0, point[:, 1:] - tangent[:, 1:] / 3.0], axis=2
        )
        control = np.concatenate([inner.reshape(len(chosen), -1, 3), point[:, -1:]], axis=1)
        return _sampled(control, "bezier", "nonperiodic", steps)

    def sampled(self, values: Array, chosen: Indices, steps: int) -> Array:
        """(F, S, C) of values that go with the points: even between these, for they have no tangents."""
        return _evenly(_of_curves(values, self.sizes, chosen), steps)


def read_points(
    prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics, color: str | None = "displayColor"
) -> Triangles | None:
    """Points as balls whose silhouette has the area of a sphere's, in the mean over directions; or None with a note."""
    path = prim.GetPath()
    points, (widths, _) = array_at(prim, "points", time, 3), _widths(prim, time, "vertex")
    if points is None or not len(points):
        notes.warn(path, "points without positions are left out")
        return None
    if widths is None or len(widths) not in (1, len(points)):
        notes.warn(path, "points without a width each are left out; author widths (diameters)")
        return None
    radius = 0.5 * np.broadcast_to(widths[:, 0], (len(points),))
    shown = np.isfinite(points).all(axis=1) & np.isfinite(radius) & (radius > 0.0)
    if shown.any() and not (np.isfinite(points).all() and np.isfinite(radius).all()):
        notes.warn(
            path, f"{int((~shown).sum())} of its points are no finite numbers or have no width; they are left out"
        )
    normals, faces, fit = ball(1 if 80 * len(points) <= _FEW_TRIANGLES else 0)
    if len(faces) * int(shown.sum()) > MOST_TRIANGLES:
        notes.warn(
            path,
            f"{int(shown.sum())} points would take {len(faces) * int(shown.sum())} triangles, of at most "
            f"{MOST_TRIANGLES}; they are left out",
        )
        return None
    if not shown.any():
        notes.warn(path, "points that are no finite numbers or have no width are left out")
        return None
    centers, radius = points[shown], radius[shown] * fit
    positions = centers[:, None] + radius[:, None, None] * normals
    index = faces + (np.arange(len(centers)) * len(normals))[:, None, None]
    colors = _colors(prim, time, color, notes) if color is not None else None
    if colors is not None and len(colors) not in (1, len(points)):
        notes.warn(path, f"primvar {color} has {len(colors)} values for {len(points)} points; it is not used")
        colors = None
    if colors is not None:
        colors = np.repeat(np.broadcast_to(colors, points.shape)[shown], len(normals), axis=0)
    return Triangles(positions.reshape(-1, 3), index.reshape(-1, 3), np.tile(normals, (len(centers), 1)), colors=colors)


def _segments(points: int, basis: str, wrap: str) -> int:
    """Segments of a curve of so many points, by UsdGeomBasisCurves."""
    if basis == "linear":
        return points if wrap == "periodic" and points > 2 else points - 1
    if basis == "bezier":
        return points // 3 if wrap == "periodic" else (points - 4) // 3 + 1 if points >= 4 else 0
    if wrap == "periodic":
        return points if points >= 3 else 0
    return points - 1 if wrap == "pinned" and points >= 2 else max(points - 3, 0)


def _sampled(control: Array, basis: str, wrap: str, steps: int) -> Array:
    """(F, S, C) values along curves of (F, n, C) control values, `steps` to a segment, ends included."""
    n = control.shape[1]
    closed = wrap == "periodic"
    if basis == "linear":
        return np.concatenate([control, control[:, :1]], axis=1) if closed and n > 2 else control
    if closed:
        control = np.concatenate([control, control[:, : 1 if basis == "bezier" else 3]], axis=1)
    elif wrap == "pinned" and basis != "bezier":
        control = np.concatenate(
            [2 * control[:, :1] - control[:, 1:2], control, 2 * control[:, -1:] - control[:, -2:-1]], axis=1
        )
    stride = 3 if basis == "bezier" else 1
    first = np.arange(_segments(n, basis, wrap)) * stride
    t = np.arange(steps) / steps
    weights = np.stack([np.ones_like(t), t, t**2, t**3], axis=1) @ _BASES[basis]  # (steps, 4)
    pieces = control[:, first[:, None] + np.arange(4)]  # (F, segments, 4, C)
    inner = np.einsum("sk,fgkc->fgsc", weights, pieces).reshape(len(control), -1, control.shape[2])
    end = np.einsum("k,fkc->fc", np.ones(4) @ _BASES[basis], pieces[:, -1])
    return np.concatenate([inner, end[:, None]], axis=1)


def _of_curves(values: Array, sizes: Indices, chosen: Indices) -> Array:
    """(F, n, C) values of the points of some curves of one size."""
    starts = np.cumsum(sizes) - sizes
    return values[starts[chosen][:, None] + np.arange(sizes[chosen[0]])]


def _evenly(values: Array, steps: int) -> Array:
    """(F, S, C) of (F, n, C) values, `steps` to each stretch between two."""
    place = np.arange((values.shape[1] - 1) * steps + 1) / steps
    low = np.minimum(place.astype(np.int64), values.shape[1] - 2)
    share = (place - low)[:, None]
    return np.asarray((1.0 - share) * values[:, low] + share * values[:, low + 1])


class Spread:
    """Widths or normals of curves at their samples.

    Args:
        values: (K, C).
        interpolation: of the primvar.
        shape: the curves.
    """

    def __init__(self, values: Array, interpolation: str, shape: Cubics | Hermite | Nurbs) -> None:
        ends = shape.segments + (0 if shape.closed else 1)
        per_curve = {"constant": None, "uniform": None, "vertex": shape.sizes, "varying": ends}.get(
            interpolation, shape.sizes
        )
        wanted = 1 if interpolation == "constant" else len(shape.sizes) if per_curve is None else int(per_curve.sum())
        if len(values) < wanted and len(values) in (
            1,
            len(shape.sizes),
        ):  # as many exporters mean it that leave the word out
            interpolation, per_curve, wanted = ("constant" if len(values) == 1 else "uniform"), None, len(values)
        self.fits = len(values) >= wanted
        self.values, self.kind, self.shape, self.per_curve = (
            values,
            interpolation if self.fits else "mean",
            shape,
            per_curve,
        )

    def along(self, chosen: Indices, steps: int) -> Array:
        """(F, S, C) or (F, 1, C) values at the samples of curves that are sampled together."""
        if self.kind in ("constant", "mean"):
            value = self.values[0] if self.kind == "constant" else self.values.mean(axis=0)
            return np.broadcast_to(value, (len(chosen), 1, len(value)))
        if self.per_curve is None:
            return self.values[chosen][:, None]
        if self.kind == "vertex" and self.shape.cubic:
            return self.shape.sampled(self.values, chosen, steps)
        values = _of_curves(self.values, self.per_curve, chosen)
        return _evenly(np.concatenate([values, values[:, :1]], axis=1) if self.shape.closed else values, steps)

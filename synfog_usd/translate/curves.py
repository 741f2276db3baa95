"""Curves as tubes or ribbons, and points as balls: meshes in the prim's own coordinates.

Takes BasisCurves and Points; gives triangles.  `widths` are diameters.  Knows nothing of materials or
Mitsuba.
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
from synfog_usd.translate.primvars import array_at, columns_of, flattened
from synfog_usd.translate.sweep import ribbons, tubes

MOST_TRIANGLES = 4_000_000
"""Most triangles of one prim; they take 0.5 GB with the renderer's copy."""

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
    prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics, color: str | None = "displayColor"
) -> Triangles | None:
    """BasisCurves as tubes whose mean width is theirs, or as flat ribbons where they have normals; None with a note.

    Args:
        prim: a BasisCurves.
        color: the primvar of their colours, or None for none.

    Ends are open.
    """
    path = prim.GetPath()
    shape = _shape(prim, time, notes)
    if shape is None:
        return None
    widths, interpolation = _widths(prim, time, str(UsdGeom.Curves(prim).GetWidthsInterpolation()))
    if widths is None or not np.isfinite(widths).all() or not widths.max() > 0.0:
        notes.warn(path, "curves without widths are left out; author widths (diameters)")
        return None
    width_of = Spread(widths, interpolation, shape)
    if not width_of.fits:
        notes.warn(path, f"widths are too few for their interpolation {interpolation!r}; the curves take the mean")
    facing = _facing(prim, time, shape, notes)
    colors = _curve_colors(prim, time, color, shape, notes) if color is not None else None
    sides, steps = _fineness(shape)
    sides = 1 if facing is not None else sides
    total = 2 * sides * int(shape.segments.sum()) * steps
    if total > MOST_TRIANGLES:
        text = f"{len(shape.sizes)} curves would take {total} triangles, of at most {MOST_TRIANGLES}; they are left out"
        notes.warn(path, text)
        return None
    parts = [_swept(shape, chosen, steps, sides, width_of, facing, colors) for chosen in shape.by_size()]
    if not parts:
        notes.warn(path, "curves of too few points for one segment are left out")
        return None
    offsets = np.cumsum([0, *[len(part.positions) for part in parts[:-1]]])
    return Triangles(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
        np.concatenate([part.normals for part in parts if part.normals is not None]),
        colors=np.concatenate([part.colors for part in parts if part.colors is not None]) if colors else None,
    )


def _fineness(shape: Cubics) -> tuple[int, int]:
    """(sides of a tube, steps of a segment): the finest that stay within the budget, else the coarsest."""
    segments = int(shape.segments.sum())
    fits = [
        (sides, steps)
        for sides, steps in _COARSE_TO_FINE
        if 2 * sides * segments * (steps if shape.cubic else 1) <= _FEW_TRIANGLES
    ]
    sides, steps = fits[-1] if fits else _COARSE_TO_FINE[0]
    return sides, steps if shape.cubic else 1


def _swept(
    shape: Cubics, chosen: Indices, steps: int, sides: int, widths: Spread, facing: Spread | None, colors: Spread | None
) -> Triangles:
    """Some curves of one size as tubes, or as ribbons where they have a facing."""
    line = shape.sampled(shape.points, chosen, steps)
    radius = 0.5 * np.maximum(widths.along(chosen, steps)[..., 0], 0.0)
    if facing is None:
        positions, faces, normals = tubes(line, radius, sides)
    else:
        positions, faces, normals = ribbons(line, radius, facing.along(chosen, steps))
    if colors is None:
        return Triangles(positions, faces, normals)
    along = np.broadcast_to(colors.along(chosen, steps), line.shape)
    around = len(positions) // (line.shape[0] * line.shape[1])
    return Triangles(positions, faces, normals, colors=np.repeat(along.reshape(-1, 3), around, axis=0))


def _facing(prim: Usd.Prim, time: Usd.TimeCode, shape: Cubics, notes: Diagnostics) -> Spread | None:
    """Normals of flat curves, primvars:normals before normals; None for round ones."""
    normals = array_at(prim, "primvars:normals", time, 3)
    if normals is None:
        normals, interpolation = array_at(prim, "normals", time, 3), UsdGeom.Curves(prim).GetNormalsInterpolation()
    else:
        interpolation = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals").GetInterpolation()
    if normals is not None and not np.isfinite(normals).all():
        notes.warn(prim.GetPath(), "normals that are no finite numbers are not used; the curves are tubes")
        return None
    return None if normals is None else Spread(normals, str(interpolation), shape)


def _widths(prim: Usd.Prim, time: Usd.TimeCode, interpolation: str) -> tuple[Array | None, str]:
    """(K, 1) widths and their interpolation: primvars:widths before widths, as UsdGeom has it, and where neither is
    there, a constant primvar from above.
    """
    api = UsdGeom.PrimvarsAPI(prim)
    widths = array_at(prim, "widths", time, 1)
    primvar = api.GetPrimvar("widths") if widths is not None else api.FindPrimvarWithInheritance("widths")
    values = flattened(primvar, time) if primvar else None
    if isinstance(values, np.ndarray) and values.shape[1] == 1:
        return values, str(primvar.GetInterpolation())
    return widths, interpolation


def _curve_colors(prim: Usd.Prim, time: Usd.TimeCode, name: str, shape: Cubics, notes: Diagnostics) -> Spread | None:
    """A primvar of curves as colours at their samples; None where it has none."""
    values = _colors(prim, time, name, notes)
    if values is None:
        return None
    interpolation = str(UsdGeom.PrimvarsAPI(prim).GetPrimvar(name).GetInterpolation())
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


def _shape(prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics) -> Cubics | None:
    """The curves without their widths, or None with a note."""
    path, curves = prim.GetPath(), UsdGeom.BasisCurves(prim)
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

    def by_size(self) -> list[Indices]:
        """Numbers of the curves of one size each, which are sampled together."""
        return [np.flatnonzero(self.sizes == size) for size in np.unique(self.sizes[self.segments >= 1])]

    def sampled(self, values: Array, chosen: Indices, steps: int) -> Array:
        """(F, S, C) of values that go with the points."""
        return _sampled(_of_curves(values, self.sizes, chosen), self.basis, self.wrap, steps)


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
    at = np.arange((values.shape[1] - 1) * steps + 1) / steps
    low = np.minimum(at.astype(np.int64), values.shape[1] - 2)
    share = (at - low)[:, None]
    return np.asarray((1.0 - share) * values[:, low] + share * values[:, low + 1])


class Spread:
    """Widths or normals of curves at their samples.

    Args:
        values: (K, C).
        interpolation: of the primvar.
        shape: the curves.
    """

    def __init__(self, values: Array, interpolation: str, shape: Cubics) -> None:
        ends = shape.segments + (0 if shape.closed else 1)
        per_curve = {"constant": None, "uniform": None, "vertex": shape.sizes, "varying": ends}.get(
            interpolation, shape.sizes
        )
        least = 1 if interpolation == "constant" else len(shape.sizes) if per_curve is None else int(per_curve.sum())
        if len(values) < least and len(values) in (1, len(shape.sizes)):  # of exporters that leave the word out
            interpolation, per_curve, least = ("constant" if len(values) == 1 else "uniform"), None, len(values)
        self.fits = len(values) >= least
        self.kind = interpolation if self.fits else "mean"
        self.values, self.shape, self.per_curve = values, shape, per_curve

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

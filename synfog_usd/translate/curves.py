"""Curves as tubes and points as balls: meshes in the prim's own coordinates.

Takes BasisCurves and Points; gives triangles.  `widths` are diameters.  Knows
nothing of materials or Mitsuba.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt
from pxr import Usd, UsdGeom

from synfog_usd.translate.geometry import Triangles, cross
from synfog_usd.translate.notes import Notebook

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

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


def read_curves(prim: Usd.Prim, time: Usd.TimeCode, notes: Notebook) -> Triangles | None:
    """BasisCurves as tubes whose mean width is that of the curves, or None with a note.

    Ends are open.  A colour that varies along a curve becomes its mean.
    """
    path, curves = prim.GetPath(), UsdGeom.BasisCurves(prim)
    points, counts = _array(curves.GetPointsAttr(), time, 3), _array(curves.GetCurveVertexCountsAttr(), time, 1)
    if points is None or counts is None or not len(counts):
        notes.warn(path, "curves without points are left out")
        return None
    sizes = counts[:, 0].astype(np.int64)
    if (sizes < 0).any() or sizes.sum() != len(points) or not np.isfinite(points).all():
        notes.warn(path, f"curves whose counts do not fit their {len(points)} points, or whose points are no finite numbers, are left out")
        return None
    kind, wrap = str(curves.GetTypeAttr().Get()), str(curves.GetWrapAttr().Get())
    basis = "linear" if kind == "linear" else str(curves.GetBasisAttr().Get())
    if basis not in (*_BASES, "linear"):
        notes.warn(path, f"curves of basis {basis!r} are not known; they are drawn as straight lines between their points")
        basis = "linear"
    widths = _array(curves.GetWidthsAttr(), time, 1)
    if widths is None or not np.isfinite(widths).all() or not widths.max() > 0.0:
        notes.warn(path, "curves without widths are left out; author widths (diameters)")
        return None
    segments = np.array([_segments(int(n), basis, wrap) for n in sizes])
    if prim.GetAttribute("normals").HasAuthoredValue():
        notes.info(path, "curves with normals are ribbons; they are drawn as tubes")
    cubic, total = basis != "linear", int(segments.sum())
    fits = [(sides, steps) for sides, steps in _COARSE_TO_FINE if 2 * sides * total * (steps if cubic else 1) <= _FEW_TRIANGLES]
    sides, steps = fits[-1] if fits else _COARSE_TO_FINE[0]
    steps = steps if cubic else 1
    if 2 * sides * total * steps > MOST_TRIANGLES:
        notes.warn(path, f"{len(sizes)} curves would take {2 * sides * total * steps} triangles, of at most {MOST_TRIANGLES}; they are left out")
        return None
    closed = wrap == "periodic"
    width_of = _Spread(widths[:, 0], str(curves.GetWidthsInterpolation()), sizes, segments, closed=closed)
    if not width_of.fits:
        notes.warn(path, f"widths are too few for their interpolation {curves.GetWidthsInterpolation()!r}; the curves take the mean")
    starts = np.cumsum(sizes) - sizes
    made: list[tuple[Array, Indices, Array]] = []
    owners: list[Indices] = []
    for size in np.unique(sizes[segments >= 1]):
        chosen = np.flatnonzero(sizes == size)
        control = points[starts[chosen][:, None] + np.arange(size)]
        line = _sampled(control, basis, wrap, steps)
        radius = 0.5 * np.maximum(width_of.along(chosen, basis, wrap, steps), 0.0)
        made.append(_tubes(line, radius, sides))
        owners.append(np.repeat(chosen, line.shape[1] * sides))
    if not made:
        notes.warn(path, "curves of too few points for one segment are left out")
        return None
    offsets = np.cumsum([0, *[len(positions) for positions, _, _ in made[:-1]]])
    return Triangles(
        np.concatenate([positions for positions, _, _ in made]),
        np.concatenate([faces + offset for (_, faces, _), offset in zip(made, offsets, strict=True)]),
        np.concatenate([normals for _, _, normals in made]),
        colors=_colors(prim, time, sizes, np.concatenate(owners)),
    )


def read_points(prim: Usd.Prim, time: Usd.TimeCode, notes: Notebook) -> Triangles | None:
    """Points as balls whose silhouette has the area of a sphere's, in the mean over directions; or None with a note."""
    path, cloud = prim.GetPath(), UsdGeom.Points(prim)
    points, widths = _array(cloud.GetPointsAttr(), time, 3), _array(cloud.GetWidthsAttr(), time, 1)
    if points is None or not len(points):
        notes.warn(path, "points without positions are left out")
        return None
    if widths is None or len(widths) not in (1, len(points)):
        notes.warn(path, "points without a width each are left out; author widths (diameters)")
        return None
    radius = 0.5 * np.broadcast_to(widths[:, 0], (len(points),))
    shown = np.isfinite(points).all(axis=1) & np.isfinite(radius) & (radius > 0.0)
    normals, faces, fit = _ball(1 if 80 * len(points) <= _FEW_TRIANGLES else 0)
    if len(faces) * int(shown.sum()) > MOST_TRIANGLES:
        notes.warn(path, f"{int(shown.sum())} points would take {len(faces) * int(shown.sum())} triangles, of at most {MOST_TRIANGLES}; they are left out")
        return None
    if not shown.any():
        notes.warn(path, "points that are no finite numbers or have no width are left out")
        return None
    centers, radius = points[shown], radius[shown] * fit
    positions = centers[:, None] + radius[:, None, None] * normals
    index = faces + (np.arange(len(centers)) * len(normals))[:, None, None]
    owner = np.repeat(np.flatnonzero(shown), len(normals))
    colors = _colors(prim, time, np.ones(len(points), dtype=np.int64), owner)
    return Triangles(positions.reshape(-1, 3), index.reshape(-1, 3), np.tile(normals, (len(centers), 1)), colors=colors)


@functools.cache
def _ball(divisions: int) -> tuple[Array, Indices, float]:
    """An icosphere: (N, 3) unit vertices, (M, 3) faces, and the factor that gives it the surface of the sphere."""
    import trimesh

    made = trimesh.creation.icosphere(subdivisions=divisions)
    vertices = np.asarray(made.vertices, dtype=np.float64)
    return vertices, np.asarray(made.faces, dtype=np.int64), float(np.sqrt(4.0 * np.pi / made.area))


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
        control = np.concatenate([2 * control[:, :1] - control[:, 1:2], control, 2 * control[:, -1:] - control[:, -2:-1]], axis=1)
    stride = 3 if basis == "bezier" else 1
    first = np.arange(_segments(n, basis, wrap)) * stride
    t = np.arange(steps) / steps
    weights = np.stack([np.ones_like(t), t, t**2, t**3], axis=1) @ _BASES[basis]  # (steps, 4)
    pieces = control[:, first[:, None] + np.arange(4)]  # (F, segments, 4, C)
    inner = np.einsum("sk,fgkc->fgsc", weights, pieces).reshape(len(control), -1, control.shape[2])
    end = np.einsum("k,fkc->fc", np.ones(4) @ _BASES[basis], pieces[:, -1])
    return np.concatenate([inner, end[:, None]], axis=1)


class _Spread:
    """Widths of curves at their samples."""

    def __init__(self, values: Array, interpolation: str, sizes: Indices, segments: Indices, *, closed: bool) -> None:
        per_curve = {"constant": None, "uniform": None, "vertex": sizes, "varying": segments + (0 if closed else 1)}.get(interpolation, sizes)
        wanted = 1 if interpolation == "constant" else len(sizes) if per_curve is None else int(per_curve.sum())
        self.fits = len(values) >= wanted
        self.values, self.kind, self.closed = values, interpolation if self.fits else "mean", closed
        self.starts = np.cumsum(per_curve) - per_curve if per_curve is not None else np.arange(len(sizes))
        self.per_curve = per_curve
        self.segments = segments

    def along(self, chosen: Indices, basis: str, wrap: str, steps: int) -> Array:
        """(F, S) or (F, 1) values at the samples of curves of one size."""
        if self.kind in ("constant", "mean"):
            value = self.values[0] if self.kind == "constant" else self.values.mean()
            return np.full((len(chosen), 1), value)
        if self.per_curve is None:
            return self.values[chosen][:, None]
        count = int(self.per_curve[chosen[0]])
        control = self.values[self.starts[chosen][:, None] + np.arange(count)][..., None]
        if self.kind == "vertex" and basis != "linear":
            return _sampled(control, basis, wrap, steps)[..., 0]
        ends = np.concatenate([control, control[:, :1]], axis=1) if self.closed else control
        place = np.arange((ends.shape[1] - 1) * steps + 1) / steps
        low = np.minimum(place.astype(np.int64), ends.shape[1] - 2)
        share = (place - low)[:, None]
        return np.asarray(((1.0 - share) * ends[:, low] + share * ends[:, low + 1])[..., 0])


def _tubes(line: Array, radius: Array, sides: int) -> tuple[Array, Indices, Array]:
    """Tubes around (F, S, 3) lines: positions, faces, normals; outside is outside.

    The frame is carried along without twist, by double reflection (Wang et al. 2008).
    """
    count, samples, _ = line.shape
    ahead = np.diff(line, axis=1)
    tangent = np.concatenate([ahead[:, :1], ahead[:, 1:] + ahead[:, :-1], ahead[:, -1:]], axis=1)
    length = np.linalg.norm(tangent, axis=2, keepdims=True)
    tangent = np.where(length > 0.0, tangent / np.maximum(length, 1e-300), [1.0, 0.0, 0.0])
    axis = np.eye(3)[np.abs(tangent[:, 0]).argmin(axis=1)]
    side = cross(tangent[:, 0], axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    sideways = [side]
    for k in range(samples - 1):
        step = line[:, k + 1] - line[:, k]
        square = np.maximum(np.einsum("fi,fi->f", step, step), 1e-300)[:, None]
        turned = side - (2.0 / square) * np.einsum("fi,fi->f", step, side)[:, None] * step
        mirrored = tangent[:, k] - (2.0 / square) * np.einsum("fi,fi->f", step, tangent[:, k])[:, None] * step
        second = tangent[:, k + 1] - mirrored
        square = np.einsum("fi,fi->f", second, second)[:, None]
        side = np.where(square > 1e-24, turned - 2.0 / np.maximum(square, 1e-300) * np.einsum("fi,fi->f", second, turned)[:, None] * second, turned)
        side = side - np.einsum("fi,fi->f", side, tangent[:, k + 1])[:, None] * tangent[:, k + 1]
        side = side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-300)
        sideways.append(side)
    u = np.stack(sideways, axis=1)
    v = cross(tangent, u)
    angle = np.arange(sides) * (2.0 * np.pi / sides)
    around = u[:, :, None] * np.cos(angle)[:, None] + v[:, :, None] * np.sin(angle)[:, None]  # (F, S, sides, 3)
    fit = (np.pi / sides) / np.sin(np.pi / sides)  # the mean width of a convex outline is its length over pi (Cauchy)
    positions = line[:, :, None] + around * (radius * fit)[:, :, None, None]
    ring = np.arange(count * samples).reshape(count, samples) * sides
    a = ring[:, :-1, None] + np.arange(sides)
    b = ring[:, :-1, None] + np.roll(np.arange(sides), -1)
    c, d = b + sides, a + sides
    faces = np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)])
    return positions.reshape(-1, 3), faces, around.reshape(-1, 3)


def _colors(prim: Usd.Prim, time: Usd.TimeCode, sizes: Indices, owner: Indices) -> Array | None:
    """(N, 3) displayColor of each vertex, by the curve or point it belongs to; None where there is one colour at most."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
    values = primvar.ComputeFlattened(time) if primvar and primvar.HasAuthoredValue() else None
    if values is None or primvar.GetInterpolation() == UsdGeom.Tokens.constant:
        return None
    array = np.asarray(values, dtype=np.float64).reshape(-1, 3)
    if len(array) == len(sizes):
        return array[owner]
    if len(array) == sizes.sum() and (sizes > 0).all():
        return (np.add.reduceat(array, np.cumsum(sizes) - sizes, axis=0) / sizes[:, None])[owner]
    return np.tile(array.mean(axis=0), (len(owner), 1)) if len(array) else None


def _array(attribute: Usd.Attribute, time: Usd.TimeCode, width: int) -> Array | None:
    value: Any = attribute.Get(time)
    if value is None and attribute.GetNumTimeSamples():
        value = attribute.Get(Usd.TimeCode.EarliestTime())
    if value is None or not len(value):
        return None
    try:
        return np.asarray(value, dtype=np.float64).reshape(-1, width)
    except (ValueError, TypeError):
        return None

"""Draw modes: what stands for a model that is not to be drawn itself.

Takes a model; gives cards with pictures, the edges of its box, or the axes of its origin, in its own space.
Source: UsdGeomModelAPI, draw modes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom

from synfog_usd.base.arrays import Array
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles
from synfog_usd.translate.space import FAR

MODES = ("cards", "bounds", "origin")
"""Draw modes that replace a model."""

_THIN = 1.0 / 200.0
"""Width of an edge, in lengths of the box's diagonal; viewports draw lines a pixel wide."""

_APART = 1e-4
"""Distance of the two faces of a card that bisects its model, in lengths of the diagonal."""


@dataclass(frozen=True)
class StandIn:
    """A part of what stands for a model.

    Attributes:
        triangles: in the model's own space.
        color: where it has no picture.
        picture: resolved path, or ''.
    """

    triangles: Triangles
    color: tuple[float, float, float]
    picture: str = ""


def replaces(prim: Usd.Prim, mode: str) -> bool:
    """Whether a prim under a draw mode is replaced: a model that applies it, or a component that says nothing."""
    if mode not in MODES or not prim.IsModel() or prim.IsPseudoRoot():
        return False
    applies = prim.GetAttribute("model:applyDrawMode")
    if applies and applies.HasAuthoredValue():
        return bool(applies.Get())
    return bool(prim.IsComponent())


def stand_ins(prim: Usd.Prim, mode: str, time: Usd.TimeCode, notes: Diagnostics) -> list[StandIn]:
    """What is drawn for a model, empty with a note where its bounds are not known."""
    attribute = prim.GetAttribute("model:drawModeColor")
    given = attribute.Get() if attribute else None
    values = [float(c) for c in given] if given is not None and len(given) == 3 else [0.18] * 3
    color = (values[0], values[1], values[2])
    if mode == "origin":
        size = np.eye(3)
        return [
            StandIn(_bar(np.zeros(3), size[axis], _THIN), (float(axis == 0), float(axis == 1), float(axis == 2)))
            for axis in range(3)
        ]
    bound = (
        UsdGeom.BBoxCache(time, ["default", "render", "proxy"], True)
        .ComputeUntransformedBound(prim)
        .ComputeAlignedRange()
    )
    low, high = np.array(bound.GetMin()), np.array(bound.GetMax())
    if bound.IsEmpty() or not max(np.abs(low).max(), np.abs(high).max()) <= FAR:
        notes.warn(prim.GetPath(), f"draw mode {mode!r} of a model without bounds: nothing is drawn for it")
        return []
    if mode == "bounds":
        return [StandIn(_edges(low, high), color)]
    geometry = prim.GetAttribute("model:cardGeometry")
    given = geometry.Get() if geometry else None
    kind = notes.token(prim.GetPath(), "model:cardGeometry", given, ("cross", "box", "fromTexture"), "cross")
    if kind == "fromTexture":
        notes.warn(prim.GetPath(), "cardGeometry 'fromTexture' is drawn as 'cross'")
    return _cards(prim, low, high, color, is_box=kind == "box")


def _bar(begin: Array, end: Array, width: float) -> Triangles:
    """A box of square section around a line along an axis."""
    half = np.where(np.abs(end - begin) > 0.0, 0.0, width / 2.0)
    low, high = np.minimum(begin, end) - half, np.maximum(begin, end) + half
    corners = np.array([[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i, j, k in np.ndindex(2, 2, 2)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return Triangles(corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def _edges(low: Array, high: Array) -> Triangles:
    width = _THIN * float(np.linalg.norm(high - low))
    bars = []
    for axis in range(3):
        for first in (0, 1):
            for second in (0, 1):
                begin = low.copy()
                begin[(axis + 1) % 3] = (low, high)[first][(axis + 1) % 3]
                begin[(axis + 2) % 3] = (low, high)[second][(axis + 2) % 3]
                end = begin.copy()
                end[axis] = high[axis]
                bars.append(_bar(begin, end, width))
    return Triangles(
        np.concatenate([bar.positions for bar in bars]),
        np.concatenate([bar.faces + 8 * number for number, bar in enumerate(bars)]),
    )


_ACROSS = {  # axis, sign -> model axes of the picture's right and up, seen from outside
    (0, 1): ((0, 1, 0), (0, 0, 1)),
    (0, -1): ((0, -1, 0), (0, 0, 1)),
    (1, 1): ((-1, 0, 0), (0, 0, 1)),
    (1, -1): ((1, 0, 0), (0, 0, 1)),
    (2, 1): ((1, 0, 0), (0, 1, 0)),
    (2, -1): ((-1, 0, 0), (0, 1, 0)),
}


def _cards(
    prim: Usd.Prim, low: Array, high: Array, color: tuple[float, float, float], *, is_box: bool
) -> list[StandIn]:
    """Quads across the model, or on the faces of its box; axes without a picture are left out where others have one."""
    pictures = {}
    for axis, name in enumerate("XYZ"):
        for sign, word in ((1, "Pos"), (-1, "Neg")):
            attribute = prim.GetAttribute(f"model:cardTexture{name}{word}")
            asset = attribute.Get() if attribute else None
            pictures[axis, sign] = getattr(asset, "resolvedPath", "") or getattr(asset, "path", "") or ""
    some = any(pictures.values())
    made = []
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    apart = _APART * float(np.linalg.norm(high - low))
    for (axis, sign), own in pictures.items():
        other = pictures[axis, -sign]
        if some and not (own or other):
            continue
        right, up = (np.array(direction, dtype=np.float64) for direction in _ACROSS[axis, sign])
        outward = np.eye(3)[axis] * sign
        center = middle + outward * (half[axis] if is_box else apart / 2.0)
        corners = np.array([center + (u * right + v * up) * half for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        st = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
        if not own:  # the opposite picture, seen through from behind
            st[:, 0] = 1.0 - st[:, 0]
        quad = Triangles(corners, np.array([[0, 1, 2], [0, 2, 3]]), texcoords=st)
        made.append(StandIn(quad, color, own or other))
    return made

"""Wheels and indicators of a model as meshes of their own, cut out of the meshes of its materials.

A model has one mesh for each material, with all its wheels in it.  Takes a layer of such meshes; gives each wheel with
its axle, what is left of the meshes, and the indicators of each side.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf

from synfog_usd.base.arrays import Indices
from synfog_usd.world.shapes import Part
from synfog_usd.world.traffic.cutting import pieces, read_part, subset

TURNING = ("tyre", "rim", "chrome")
"""Materials of which wheels have parts: of chrome are spokes."""
NARROW_M = 0.09
"""Half the width of wheels with spokes; broader wheels have no chrome."""
WITHIN_M = 0.03
"""By which pieces of a mesh with fewer triangles leave the circle of their tyre."""


@dataclass(frozen=True)
class Wheel:
    """A wheel of a model.

    Attributes:
        name: of its prim, as 'Front_Left'.
        axle: its middle in the model's axes [m].
        radius: of its tyre [m].
        parts: by material, in the model's axes.
    """

    name: str
    axle: tuple[float, float, float]
    radius: float
    parts: Mapping[str, Part]


@dataclass(frozen=True)
class Wheels:
    """All wheels of a model.

    Attributes:
        wheels: from front to rear, left before right.
        rest: by material what of its mesh is no wheel, None where nothing is.
        wheelbase: from the rearmost axle to the front one [m].
    """

    wheels: tuple[Wheel, ...]
    rest: Mapping[str, Part | None]
    wheelbase: float


@functools.cache
def wheels_of(geometry: Path) -> Wheels | None:
    """The wheels in a layer of meshes, or None where it has no tyres or is no file."""
    layer = Sdf.Layer.FindOrOpen(str(geometry)) if geometry.exists() else None
    parts = {name: read_part(layer, name) for name in TURNING} if layer else {}
    tyre = parts.get("tyre")
    if tyre is None:
        return None
    discs = _discs(tyre)
    narrow = all(abs(x) < NARROW_M for x, _, _, _ in discs)
    result: list[dict[str, Part]] = [{} for _ in discs]
    rest: dict[str, Part | None] = {}
    for name, part in parts.items():
        if part is None or (name == "chrome" and not narrow):
            continue
        owner = _owners(part, discs)
        for number, item in enumerate(result):
            if (owner == number).any():
                item[name] = subset(part, owner == number)
        rest[name] = subset(part, owner < 0) if (owner < 0).any() else None
    middles = [y for _, y, _, _ in discs]
    rows = sorted(set(middles), reverse=True)
    wheels = []
    for (x, y, z, radius), item in zip(discs, result, strict=True):
        axle = ("Front", "Rear")[min(rows.index(y), 1)] if len(rows) < 3 else ("Front", "Middle", "Rear")[rows.index(y)]
        side = "" if abs(x) < NARROW_M else ("_Left" if x < 0 else "_Right")
        wheels.append(Wheel(f"{axle}{side}", (x, y, z), radius, item))
    wheels.sort(key=lambda item: (-item.axle[1], item.axle[0]))
    return Wheels(tuple(wheels), rest, max(middles) - min(middles))


@functools.cache
def sides_of(geometry: Path, name: str) -> dict[str, Part]:
    """The mesh of a material in its halves 'left' and 'right'; empty where a layer has none, or is no file."""
    layer = Sdf.Layer.FindOrOpen(str(geometry)) if geometry.exists() else None
    part = read_part(layer, name) if layer else None
    if part is None:
        return {}
    negative = part.points[part.faces, 0].mean(axis=1) < 0.0
    return {side: subset(part, half) for side, half in (("left", negative), ("right", ~negative)) if half.any()}


def _discs(tyre: Part) -> list[tuple[float, float, float, float]]:
    """Middle and radius [m] of each wheel: of every piece of tyre that touches the ground, near ones as one."""
    count, piece = pieces(tyre)
    boxes = [(tyre.points[piece == k].min(axis=0), tyre.points[piece == k].max(axis=0)) for k in range(count)]
    largest = max(high[2] for _, high in boxes)
    discs: list[tuple[float, float, float, float]] = []
    for low, high in boxes:
        x, y, z = (round(float(v), 3) for v in (low + high) / 2)
        radius = float(high[2] - low[2]) / 2
        same = next((item for item in discs if np.hypot(item[0] - x, item[1] - y) < 0.8 * radius), None)
        if radius < 0.4 * largest or same:
            continue
        row = next((item[1] for item in discs if abs(item[1] - y) < 0.02), y)
        discs.append((x, row, z, radius))
    return discs


def _owners(part: Part, discs: list[tuple[float, float, float, float]]) -> Indices:
    """(M,) number of the wheel that each face turns with, -1 for none: the wheel that holds all of its piece."""
    count, piece = pieces(part)
    owner = np.full(count, -1)
    for number, (x, y, z, radius) in enumerate(discs):
        out = (np.hypot(part.points[:, 1] - y, part.points[:, 2] - z) > radius + WITHIN_M) | (
            np.abs(part.points[:, 0] - x) > max(NARROW_M, 0.7 * radius * (abs(x) > NARROW_M))
        )
        owner[np.bincount(piece, weights=out, minlength=count) == 0] = number
    return np.asarray(owner[piece[part.faces[:, 0]]])

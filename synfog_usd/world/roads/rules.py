"""Where things may stand at a road: footprints, what stands already, and what the camera sees.

Knows the sizes of models, nothing of recipes.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt
import shapely

from synfog_usd.base.arrays import Array
from synfog_usd.world import library
from synfog_usd.world.roads.network import Road
from synfog_usd.world.spec import Placement, View

USERS = ("person", "rider", "car", "truck", "bus", "motorcycle", "bicycle")
GROUPS = {"vehicle": "Vehicles", "person": "People", "rider": "People", "building": "Buildings", "plant": "Plants"}
"""Group of the library -> group prim; all others are furniture."""
FOOT_M = {"lamp": 0.3, "sign": 0.3, "person": 0.3, "rider": 0.3}
"""Half the side of what a thing takes up on the ground, where its box is wider than its foot."""
LONG_M = 1.05
"""People on wheels, with a pram or at a run take up their box."""
TRUNK_M, TREE_HEIGHT_M = 0.4, 3.0
LAMP_CLEAR_M = 4.6
"""Between a lamp and the trunk of a tree: no lamp hangs in a crown."""
SHARE_SEEN = 0.3
RAYS = ((-0.4, 0.5), (0.0, 0.5), (0.4, 0.5), (-0.4, 0.9), (0.0, 0.9), (0.4, 0.9))
"""Across the width and up the height of a thing, as shares of both."""


def prim_group(kind: library.LibraryModel) -> str:
    """Name of the group prim that a model goes to."""
    return GROUPS.get(kind.group, "Furniture")


def facing(heading: float) -> float:
    """A heading within half a turn [degrees], to a hundredth."""
    return round((heading + 180.0) % 360.0 - 180.0, 2)


@functools.cache
def foot(name: str) -> tuple[float, float, float, float]:
    """Box that a model takes up on the ground in its own axes: low x, low y, high x, high y [m]."""
    kind = library.model(name)
    half = FOOT_M.get(kind.group) if kind.length < LONG_M or kind.group in ("lamp", "sign") else None
    if _is_tree(kind):
        half = TRUNK_M
    if half is not None:
        return -half, -half, half, half
    return kind.low[0], kind.low[1], kind.high[0], kind.high[1]


def _is_tree(kind: library.LibraryModel) -> bool:
    return kind.group == "plant" and kind.high[2] > TREE_HEIGHT_M


def footprint(p: Placement) -> Array:
    """(4, 2) corners of a placement on the ground [m]."""
    x0, y0, x1, y1 = (p.size * v for v in foot(p.asset))
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    c, s = math.cos(math.radians(p.heading)), math.sin(math.radians(p.heading))
    return corners @ np.array([[c, s], [-s, c]]) + (p.x, p.y)


class Room(Protocol):
    """What stands already, as those ask who come to stand beside it."""

    def take(self, p: Placement, margin: float = 0.1) -> bool:
        """Take the place of a placement, where it keeps `margin` [m] from all others."""

    def add(self, p: Placement) -> None:
        """Take the place of a placement, whatever stands there."""

    def copy(self) -> Room:
        """Another that goes on from here."""


@dataclass
class CollisionSet:
    """What stands already; asks whether something more has room."""

    prints: list[shapely.Polygon] = field(default_factory=list)
    lamps: list[tuple[float, float]] = field(default_factory=list)
    trunks: list[tuple[float, float]] = field(default_factory=list)

    def free(self, p: Placement, margin: float = 0.1) -> bool:
        """Whether a placement keeps `margin` [m] from all others."""
        kind = library.model(p.asset)
        apart = self.trunks if kind.group == "lamp" else self.lamps if _is_tree(kind) else []
        if any(math.hypot(p.x - x, p.y - y) < LAMP_CLEAR_M for x, y in apart):
            return False
        return self.free_outline(footprint(p), margin)

    def free_outline(self, corners: Array, margin: float) -> bool:
        """Whether a rectangle of (4, 2) corners keeps `margin` [m] from all others."""
        # all at a time: an STRtree would have to be built anew for each question
        return not bool(shapely.dwithin(shapely.Polygon(corners), self.prints, margin).any())

    def take(self, p: Placement, margin: float = 0.1) -> bool:
        """Take the place of a placement, where it keeps `margin` [m] from all others."""
        if not self.free(p, margin):
            return False
        self.add(p)
        return True

    def add(self, p: Placement) -> None:
        """Take the place of a placement, whatever stands there."""
        self.add_outline(footprint(p))
        kind = library.model(p.asset)
        if kind.group == "lamp":
            self.lamps.append((p.x, p.y))
        elif _is_tree(kind):
            self.trunks.append((p.x, p.y))

    def add_outline(self, corners: Array) -> None:
        """Take the place of a rectangle of (4, 2) corners."""
        self.prints.append(shapely.Polygon(corners))

    def copy(self) -> CollisionSet:
        """Another that goes on from here."""
        return CollisionSet(list(self.prints), list(self.lamps), list(self.trunks))


# -- sight


@dataclass(frozen=True)
class _Blocks:
    """What blocks sight: placements, their (4, 2) outlines [m], heights from and to [m], and for a quick look the
    outlines' middles seen from the eye (N, 2) and radii (N,) [m].
    """

    placed: list[Placement]
    outlines: list[Array]
    heights: list[tuple[float, float]]
    middles: Array
    radii: Array

    @classmethod
    def of(cls, placed: list[Placement], eye: Array) -> _Blocks:
        outlines = [footprint(p) for p in placed]
        heights = [(p.z, p.z + library.model(p.asset).high[2] * p.size) for p in placed]
        middles = np.array([outline.mean(axis=0) - eye[:2] for outline in outlines]).reshape(-1, 2)
        radii = np.array([np.hypot(*(outline - outline.mean(axis=0)).T).max() for outline in outlines])
        return cls(placed, outlines, heights, middles, radii)


def visible_shares(
    view: View, fov_x_deg: float, placed: Sequence[Placement], road: Road, *, within_m: float
) -> dict[str, float]:
    """Share of each road user in view that nothing stands before.

    Rays from the camera to a few places of each; buildings, vehicles, people and the
    ground block them.  Leaves do not count, nor do poles.

    Returns:
        {name: share 0 to 1} of users within `within_m` whose middle is inside the picture's width.
    """
    eye = np.array([view.x, view.y, view.z])
    forward = math.radians(view.heading)
    ahead, right = np.array([-math.sin(forward), math.cos(forward)]), np.array([math.cos(forward), math.sin(forward)])
    users, blocking = [], []
    for p in placed:
        away = np.array([p.x, p.y]) - eye[:2]
        distance = float(np.hypot(*away))
        if distance > within_m + 20:
            continue
        kind = library.model(p.asset)
        if kind.label in (*USERS, "building", "wall") or (kind.group == "furniture" and kind.width > 1.5):
            blocking.append(p)
        if kind.label in USERS and distance <= within_m:
            depth, side = float(away @ ahead), float(away @ right)
            if depth > 2.0 and abs(side) < depth * math.tan(math.radians(fov_x_deg) / 2):
                users.append(p)
    blocks = _Blocks.of(blocking, eye)
    return {p.name: _visible_share(p, eye, blocks, road) for p in users}


def _visible_share(p: Placement, eye: Array, blocks: _Blocks, road: Road) -> float:
    """Share of the rays from the eye to a road user that nothing blocks."""
    user = library.model(p.asset)
    away = np.array([p.x - eye[0], p.y - eye[1]])
    distance = float(np.hypot(*away))
    across = np.array([-away[1], away[0]]) / distance
    half = float(np.abs((footprint(p) - (p.x, p.y)) @ across).max())
    ends = np.array(
        [(p.x + u * half * across[0], p.y + u * half * across[1], p.z + v * user.high[2] * p.size) for u, v in RAYS]
    )
    clear = np.ones(len(ends), dtype=bool)
    sight = away / distance
    near = np.abs(blocks.middles @ np.array([-sight[1], sight[0]])) < blocks.radii + half + 0.1
    for index in np.flatnonzero(near & (blocks.middles @ sight < distance + blocks.radii)):
        block = blocks.placed[index]
        if block is p or {user.label, library.model(block.asset).label} == {"rider", "bicycle"}:
            continue
        clear &= ~_blocked(eye, ends, blocks.outlines[index], *blocks.heights[index])
        if not clear.any():
            return 0.0
    share = np.linspace(0.05, 0.93, 14)
    points = eye + share[None, :, None] * (ends - eye)[:, None, :]
    ground = road.height(points[..., 0], points[..., 1])
    clear &= ~(points[..., 2] < ground - 0.02).any(axis=1)
    return float(clear.mean())


def _blocked(eye: Array, ends: Array, corners: Array, low: float, high: float) -> npt.NDArray[np.bool_]:
    """Which of the segments from the eye to (N, 3) ends pass through an upright box."""
    origin = corners[0]
    u, v = corners[1] - origin, corners[3] - origin
    lu, lv = math.hypot(*u), math.hypot(*v)
    a = np.array([(eye[:2] - origin) @ u / lu, (eye[:2] - origin) @ v / lv, eye[2]])
    b = np.stack([(ends[:, :2] - origin) @ u / lu, (ends[:, :2] - origin) @ v / lv, ends[:, 2]], axis=1)
    d = b - a
    d = np.where(np.abs(d) < 1e-12, 1e-12, d)
    t0, t1 = (np.array([0.0, 0.0, low]) - a) / d, (np.array([lu, lv, high]) - a) / d
    enter, leave = np.minimum(t0, t1).max(axis=1), np.maximum(t0, t1).min(axis=1)
    return (enter < leave) & (enter < 0.995) & (leave > 0.0)

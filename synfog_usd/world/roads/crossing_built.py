"""What a stage of the crossing has beside its models: bollards round the corners, and leaves below the street trees."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from synfog_usd.base.seeds import stream
from synfog_usd.world.library import nominal
from synfog_usd.world.roads import lanes
from synfog_usd.world.roads.crossing import (
    BAYS_Y,
    CORNER,
    LANE_M,
    MAIN_HALF,
    NORTH,
    SIDE,
    SIDE_HALF,
    SOUTH,
    TREE_X,
    WALL_X,
    Crossing,
    ground_height,
)
from synfog_usd.world.roads.horizon import Scatter
from synfog_usd.world.roads.structures import Built, Instanced, LitPanes
from synfog_usd.world.shapes import Part
from synfog_usd.world.spec import Placement, View, WorldSpec


def _lit(p: Placement, view: View) -> bool:
    """Houses that the camera can see lit, up the main street."""
    return -60 <= p.y <= 190 and "facade_windows" in nominal().get(p.asset, {})


PANES = LitPanes("crossroads", {"window": 0.36, "shop_glass": 0.85}, _lit, facades=True)


WET_MATERIALS = {
    "/World/Ground/Road/Materials": (
        "asphalt_lane", "asphalt", "asphalt_old", "tar", "asphalt_patch", "iron", "marking",
    ),
    "/World/Ground/Pavement/Materials": ("paving", "kerb"),
}  # fmt: skip
"""Scope -> materials in it that rain wets."""


def water(spec: WorldSpec, crossing: Crossing, rate_mm_h: float) -> list[Part]:
    """No water stands on it."""
    return []


def built(spec: WorldSpec, crossing: Crossing) -> list[Built]:
    """Nothing is made for it alone: its ground is a model."""
    return []


def scatters(spec: WorldSpec, crossing: Crossing) -> Sequence[Scatter | None]:
    """Nothing is sown."""
    return ()


def edged_lanes(crossing: Crossing) -> list[lanes.EdgedLane]:
    """The lanes of both streets, through the crossing, the bays of the main street, and the turns to the right."""
    north, west = np.array([0.0, 1.0]), np.array([-1.0, 0.0])
    edged = []
    for ahead, begin, end, inner, outer, kind in (
        (north, -SOUTH, NORTH, 0.0, LANE_M, "lane"),
        (-north, -NORTH, SOUTH, 0.0, LANE_M, "lane"),
        (west, -SIDE, SIDE, 0.0, SIDE_HALF, "lane"),
        (-west, -SIDE, SIDE, 0.0, SIDE_HALF, "lane"),
        *((north, low, high, LANE_M, MAIN_HALF, "parking") for low, high in BAYS_Y),
        *((-north, -high, -low, LANE_M, MAIN_HALF, "parking") for low, high in BAYS_Y),
    ):
        right = np.array([ahead[1], -ahead[0]])
        left_edge, right_edge = (
            np.array([(*(s * ahead + aside * right), 0.0) for s in (begin, end)]) for aside in (inner, outer)
        )
        edged.append(lanes.EdgedLane(lanes.TYPES[kind], left_edge, right_edge))
    return [*edged, *_turns()]


def _turns() -> list[lanes.EdgedLane]:
    """A lane round each kerb."""
    result = []
    for x, y, begin in ((1, -1, 180.0), (1, 1, 270.0), (-1, 1, 0.0), (-1, -1, 90.0)):
        middle = x * (MAIN_HALF + CORNER), y * (SIDE_HALF + CORNER), 0.0
        angle = np.radians(np.linspace(begin, begin - 90.0, 13))
        round_it = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
        edges = (middle + radius * round_it for radius in (CORNER + LANE_M, CORNER))
        result.append(lanes.EdgedLane(lanes.TYPES["lane"], *edges))
    return result


def instanced(spec: WorldSpec, crossing: Crossing) -> list[Instanced]:
    """Bollards and leaves."""
    below = [p for p in spec.placed if p.group == "Plants" and abs(p.x) == TREE_X and p.y < 60]
    return [_bollards(), _leaves(below, spec.scatter)]


def _bollards() -> Instanced:
    points = []
    angle = np.deg2rad(np.array([200, 212, 224, 236, 248]))
    for sx in (-1, 1):
        for sy in (-1, 1):
            radius = CORNER - 0.45
            points += [
                (sx * (MAIN_HALF + CORNER + radius * np.cos(a)), sy * (SIDE_HALF + CORNER + radius * np.sin(a)), 0.12)
                for a in angle
            ]
        for y in (-31.0, -29.4, -27.8, 32.0, 33.6, 35.2):
            points.append((sx * 6.0, y, 0.12))
    return Instanced("/World/Furniture/Bollards", "bollard", "pole", np.array(points), np.zeros(len(points)))


def _leaves(below: Iterable[Placement], scatter: int) -> Instanced:
    rng = stream(scatter, "crossroads", "leaves")
    points, turns = [], []
    for tree in below:
        count = 55 if tree.y > -50 else 15
        for _ in range(count):
            x, y = tree.x + rng.normal(0, 1.5), tree.y + rng.normal(0, 2.6)
            if abs(x) > WALL_X - 0.15:
                continue
            if abs(x) < MAIN_HALF and rng.random() < 0.8:  # wind gathers them in the gutter
                x = np.sign(tree.x) * (MAIN_HALF - abs(rng.normal(0, 0.12)) - 0.04)
            if abs(abs(x) - MAIN_HALF) < 0.01:
                continue
            points.append((x, y, ground_height(x, y)))
            turns.append(rng.uniform(0, 360))
    return Instanced("/World/Plants/Fallen_Leaves", "fallen_leaf", "vegetation", np.array(points), np.array(turns))

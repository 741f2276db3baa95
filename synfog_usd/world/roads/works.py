"""Works beside the carriageway: boards round a hole, a heap of soil, cones, and who works there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synfog_usd.world import library
from synfog_usd.world.language import Draws
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.props import look
from synfog_usd.world.roads.road_props import in_structure
from synfog_usd.world.roads.structures import Built
from synfog_usd.world.roads.surface import bend
from synfog_usd.world.shapes import Part, ball, box, fan, tube, untextured
from synfog_usd.world.spec import Placement

WIDE_M, FROM_LANE_M = 1.5, 0.35
"""Width of a site, and its distance from the edge of what is driven on."""
CLEAR_ZEBRA_M = 7.0
BOARD_M = 0.5
"""Length of a red or white field of a board."""
TRIES = 12


@dataclass(frozen=True)
class Works:
    """A site of works.

    Attributes:
        s, length: where it begins and how long it is along the road [m].
        low, high: offsets of its sides [m].
        side: 1 where the road lies to its left, -1 where it lies to its right.
    """

    s: float
    length: float
    low: float
    high: float
    side: int


def site(
    road: Road, draws: Draws, station: float, occupied: rules.CollisionSet
) -> tuple[Works | None, list[Placement]]:
    """Works on the side that the recipe names, with workers; none where no strip is wide enough, or has no room."""
    where = draws.word("works.where")
    strips = [
        lane
        for lane in road.lane_section.of("shoulder", "pavement", "verge")
        if lane.width >= WIDE_M + FROM_LANE_M + 0.15
    ]
    strips = [lane for lane in strips if (lane.middle > 0) == (where == "right")]
    if where == "none" or not strips:
        return None, []
    side = 1 if where == "right" else -1
    lane = strips[0] if side > 0 else strips[-1]
    low, high = sorted((inner := (lane.low if side > 0 else lane.high) + side * FROM_LANE_M, inner + side * WIDE_M))
    rng = draws.stream("works")
    begin, length = station + draws.number("works.ahead_m"), float(rng.uniform(4.0, 7.0))
    for attempt in range(TRIES):
        works = Works(round(begin + 2.0 * attempt, 3), round(length, 3), round(low, 3), round(high, 3), side)
        end = works.s + length
        if end > road.reference_line.length - 5.0 or any(
            works.s - CLEAR_ZEBRA_M < zebra < end + CLEAR_ZEBRA_M for zebra in road.zebras
        ):
            continue
        if in_structure(road, works.s, works.low) or in_structure(road, end, works.high):
            continue
        corners = np.stack(
            road.reference_line.place(
                [works.s - 0.4, works.s - 0.4, end + 0.4, end + 0.4], [low - 0.1, high + 0.1, high + 0.1, low - 0.1]
            ),
            axis=-1,
        )
        if not occupied.free_outline(corners, 0.1):
            continue
        workers = []
        for place in rng.permutation(3)[: int(rng.integers(1, 3))]:
            at, t = works.s + (0.2 + 0.3 * int(place)) * length, (low + high) / 2 + side * 0.35
            x, y, z, heading, _ = road.pose(at, t)
            turn = rules.facing(heading + float(rng.uniform(0, 360)))
            workers.append(Placement("People", "", "worker", x, y, turn, look(rng, library.model("worker")), z=z))
        occupied.add_outline(corners)
        return works, workers
    return None, []


def built(road: Road, works: Works) -> Built:
    """Boards, hole, heap and cones of a site."""
    a, b, low, high = works.s, works.s + works.length, works.low, works.high
    inner, outer = (low, high) if works.side > 0 else (high, low)
    base = float(road.lane_section.height((low + high) / 2))
    parts: list[Part] = [*_board(low, a, high - low, base, across=True), *_board(low, b, high - low, base, across=True)]
    for t in (inner, outer):
        for s in np.arange(a + 0.15, b - 2.0, 2.2):
            parts += _board(t, float(s), 2.0, base, across=False)
    hole = np.array([(0.62, 0.3), (0.72, 0.9), (1.3, 1.0), (1.35, 0.35)])
    outline = [
        (inner + works.side * u * 0.9 - works.side * 0.35, a + v * works.length * 0.5, base + 0.006) for u, v in hole
    ]
    parts.append(fan(outline if works.side > 0 else outline[::-1], "soil"))
    parts.append(
        ball(
            ((low + high) / 2 - works.side * 0.2, a + works.length * 0.72, base - 0.06),
            (0.45, 0.7, 0.46),
            "soil",
            sides=16,
        )
    )
    for s in np.linspace(a - 0.25, b + 0.25, 4):
        parts += _cone(inner - works.side * 0.22, float(s), float(road.lane_section.height(inner - works.side * 0.22)))
    return Built("Works", "static", tuple(untextured(bend(part, road)) for part in parts))


def _board(t: float, s: float, long: float, base: float, *, across: bool) -> list[Part]:
    """A barrier board 25 cm high with its top at 1 m, red and white, on two feet; across the road or along it."""
    parts = []

    def put(begin: float, end: float, half: float, z0: float, z1: float, material: str) -> None:
        low, high = (
            ((t + begin, s - half, z0), (t + end, s + half, z1))
            if across
            else ((t - half, s + begin, z0), (t + half, s + end, z1))
        )
        parts.append(box(low, high, material))

    fields = max(2, round(long / BOARD_M))
    for k in range(fields):
        put(
            long * k / fields,
            long * (k + 1) / fields,
            0.012,
            base + 0.75,
            base + 1.0,
            "sign_red" if k % 2 == 0 else "sign_white",
        )
    for at in (0.2, long - 0.2):
        put(at - 0.02, at + 0.02, 0.02, base + 0.03, base + 0.75, "galvanised")
        put(at - 0.1, at + 0.1, 0.13, base, base + 0.06, "black_plastic")
    return parts


def _cone(t: float, s: float, base: float) -> list[Part]:
    """A traffic cone 50 cm high with a white band."""
    radii = {0.03: 0.125, 0.20: 0.085, 0.34: 0.055, 0.50: 0.02}
    heights = list(radii)
    parts = [box((t - 0.16, s - 0.16, base), (t + 0.16, s + 0.16, base + 0.03), "black_plastic")]
    for low, high, material in zip(
        heights[:-1], heights[1:], ("hi_vis_orange", "sign_white", "hi_vis_orange"), strict=True
    ):
        parts.append(tube([(t, s, base + low), (t, s, base + high)], [radii[low], radii[high]], material, sides=12))
    return parts

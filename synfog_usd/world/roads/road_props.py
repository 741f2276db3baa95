"""Where things may stand along a road: beside its lanes and zebras, not on a bridge or in a tunnel's hill."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from synfog_usd.world import library
from synfog_usd.world.language import Draws, Row
from synfog_usd.world.roads import props, rules
from synfog_usd.world.roads.lane_section import PAVED
from synfog_usd.world.roads.network import Road
from synfog_usd.world.spec import Placement

BEHIND_M = 70.0
JOINT_M = 0.005
BESIDE_ZEBRA_M = 2.3
FRONT_GARDEN_M = 3.0
"""Buildings farther off than this stand on the land, not at the height of the road's edge."""
DUG_IN_M = 1.5
"""Nobody builds where a house would stand deeper in the slope."""
BOARD_M, BOARD_READ_M = 4.0, 110.0
"""A sign higher than this is a board that is read from so far, and no tree stands between."""
ORDER = ("out", "any_way", "looks")


def rows(draws: Draws, road: Road, station: float, occupied: rules.CollisionSet) -> list[Placement]:
    """Rows in their order, on the sides that they name."""
    placed: list[Placement] = []
    length = road.reference_line.length
    for number, row in enumerate(draws.recipe.rows):
        side = row.distributions["side"].word(draws.stream("rows", number, "side"))
        for sign in {"left": (-1,), "right": (1,)}.get(side, (-1, 1)):
            rng = draws.stream("rows", number, sign)
            step = props.optional(row.distributions["step_m"], rng)
            start = float(row.distributions["start_m"].number(rng)) + station
            if side == "alternate" and sign > 0 and step:
                start += step / 2
            end_m = props.optional(row.distributions["end_m"], rng)
            end = length if end_m is None else min(end_m + station, length)
            if row.distributions["at"].word(rng) == "zebras":
                placed += _at_zebras(road, row, rng, sign, occupied)
                continue
            front = props.Front(_places(road, row, rng, sign), end, start, JOINT_M, ORDER)
            placed += props.row(row.distributions, front, rng, occupied)
    return placed


def unhidden(road: Road, placed: Sequence[Placement], gantries: Sequence[float]) -> list[Placement]:
    """Without the trees through which a driver looks at a board high beside the road, or over it at one of some
    stations.
    """
    boards = [(s, lane.middle, lane.width / 2, 1) for s in gantries for lane in road.driving_lanes if lane.way > 0]
    for p in placed:
        model = library.model(p.asset)
        if model.group == "sign" and model.height * p.size > BOARD_M:
            s, t = (float(v) for v in road.reference_line.nearest(p.x, p.y))
            boards.append((s, t, model.width * p.size / 2, 1 if t > 0 else -1))
    hidden = np.zeros(len(placed), dtype=bool)
    trees = [library.model(p.asset) if library.model(p.asset).group == "plant" else None for p in placed]
    middles = np.array([(p.x, p.y) for p in placed]).reshape(-1, 2)
    reach = np.array(
        [0.0 if m is None else max(m.length, m.width) * p.size / 2 for m, p in zip(trees, placed, strict=True)]
    )
    for s, t, half, way in boards:
        board = np.array(road.reference_line.place(s, t))
        lanes = [lane.middle for lane in road.driving_lanes if lane.way == way]
        for eye_s in s - way * np.arange(10.0, BOARD_READ_M, 5.0):
            for eye_t in lanes:
                eye = np.array(road.reference_line.place(eye_s, eye_t))
                sight = board - eye
                share = (middles - eye) @ sight / (sight @ sight)
                aside = np.hypot(*(middles - eye - share[:, None] * sight).T)
                hidden |= (reach > 0) & (share > 0) & (share < 1) & (aside < reach + half)
    return [p for p, gone in zip(placed, hidden, strict=True) if not gone]


def _places(road: Road, row: Row, rng: np.random.Generator, sign: int) -> props.Places:
    """Along an offset on one side of the road."""

    def places(prop: props.Prop, stations: Sequence[float]) -> Iterator[tuple[float, Placement]]:
        if not 0.0 <= stations[0] <= road.reference_line.length:
            return
        t = _counted_from(road, row.distributions["from"].word(rng), sign) + sign * prop.out
        angle = _turn(prop.turned, sign, prop.any_way)
        for s in stations:
            p = _stood(road, prop.asset, s, t, angle, prop.looks, prop.size)
            if p is not None:
                yield s, p

    return places


def _at_zebras(
    road: Road, row: Row, rng: np.random.Generator, sign: int, occupied: rules.CollisionSet
) -> list[Placement]:
    """A thing beside each zebra, where the traffic of that side comes to it."""
    placed = []
    for zebra in road.zebras:
        asset = row.distributions["models"].word(rng)
        base = _counted_from(road, row.distributions["from"].word(rng), sign)
        t = base + sign * float(row.distributions["out_m"].number(rng))
        looks = props.look(rng, library.model(asset))
        angle = _turn(row.distributions["turn"].word(rng), sign, 0.0)
        p = _stood(road, asset, zebra - sign * BESIDE_ZEBRA_M, t, angle, looks, 1.0, at_zebra=True)
        if p is not None and occupied.take(p):
            placed.append(p)
    return placed


def _turn(name: str, sign: int, any_way: float) -> float:
    """Degrees from the road's direction at which a thing stands on one side of it."""
    return {
        "road": 90.0 * sign,
        "back": -90.0 * sign,
        "traffic": 180.0 if sign > 0 else 0.0,
        "along": 0.0 if sign > 0 else 180.0,
    }.get(name, any_way)


def _stood(
    road: Road,
    asset: str,
    s: float,
    t: float,
    angle: float,
    looks: dict[str, str],
    size: float,
    *,
    at_zebra: bool = False,
) -> Placement | None:
    """A thing beside the road, or None where the road has no place for it."""
    model = library.model(asset)
    near_kerb = (
        not at_zebra and model.group != "building" and road.lane_section.low - 3.0 < t < road.lane_section.high + 3.0
    )
    if (
        s > road.reference_line.length
        or in_structure(road, s, t)
        or (near_kerb and any(abs(s - zebra) < 4.5 for zebra in road.zebras))
    ):
        return None
    x, y, z, heading, _ = road.pose(s, t)
    if model.group == "building":  # stands as high as the ground before it, or in the slope
        z = round(float(road.ground(s, road.lane_section.high if t > 0 else road.lane_section.low)), 4) - 0.005
        if max(t - road.lane_section.high, road.lane_section.low - t) - model.length / 2 > FRONT_GARDEN_M:
            corners = rules.footprint(Placement("", "", asset, x, y, heading + angle, size=size))
            ground = road.height(corners[:, 0], corners[:, 1])
            if np.ptp(ground) > DUG_IN_M:
                return None
            z = round(float(np.min(ground)), 4) - 0.005
    return props.standing(asset, (x, y, z), rules.facing(heading + angle), looks, size)


def _counted_from(road: Road, where: str, sign: int) -> float:
    """Offset that a row counts outwards from."""
    if where == "line":
        return 0.0
    if where == "edge":
        return road.lane_section.high if sign > 0 else road.lane_section.low
    paved = [lane for lane in road.lane_section.lanes if lane.kind in PAVED]
    return paved[-1].high if sign > 0 else paved[0].low


def in_structure(road: Road, s: float, t: float) -> bool:
    """Whether a place beside the road is off a bridge, or in a tunnel's hill."""
    outside = t > road.lane_section.high or t < road.lane_section.low
    if road.land.valley and outside and road.land.valley[0] - 6.0 < s < road.land.valley[1] + 6.0:
        return True
    return bool(road.land.hill and s > road.land.hill[0] - (10.0 if outside else 2.0))

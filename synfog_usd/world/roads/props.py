"""What stands along a road: rows of things, and parked cars, each where there is room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from synfog_usd.seeds import stream
from synfog_usd.world.language import Recipe, Row
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.lane_section import PAVED
from synfog_usd.world.roads.markings import BAY_M, bay_length, bays
from synfog_usd.world.roads.network import Road
from synfog_usd.world.spec import Placement

BEHIND_M = 70.0
NUDGES, NUDGE_M = 16, 0.3
JOINT_M = 0.005
BESIDE_ZEBRA_M = 2.3
FRONT_GARDEN_M = 3.0
"""Buildings farther off than this stand on the land, not at the height of the road's edge."""
DUG_IN_M = 1.5
"""Nobody builds where a house would stand deeper in the slope."""


def rows_placed(recipe: Recipe, road: Road, seed: int, station: float, taken: rules.CollisionSet) -> list[Placement]:
    """Rows in their order; what has no room is left out."""
    placed: list[Placement] = []
    for number, row in enumerate(recipe.rows):
        side = row.distributions["side"](stream(seed, "recipe", "rows", number, "side"))
        sides = {"left": (-1,), "right": (1,)}.get(side, (-1, 1))
        for sign in sides:
            rng = stream(seed, "recipe", "rows", number, sign)
            step0 = row.distributions["step_m"](rng)
            s = float(row.distributions["start_m"](rng)) + station
            if side == "alternate" and sign > 0 and step0:
                s += step0 / 2
            end = row.distributions["end_m"](rng)
            end = road.reference_line.length if end is None else min(float(end) + station, road.reference_line.length)
            if row.distributions["at"](rng) == "zebras":
                placed += _at_zebras(road, row, rng, sign, taken)
                continue
            while s < end:
                asset = row.distributions["models"](rng)
                found = rules.model(asset)
                turned = row.distributions["turn"](rng)
                size = round(float(row.distributions["size"](rng)), 3)
                extent = (found.width if turned in ("road", "back") else found.length) * size
                step = row.distributions["step_m"](rng)
                gap = float(row.distributions["gap_m"](rng))
                middle = s if step is not None else s + extent / 2
                s += float(step) if step is not None else extent + gap
                there = rng.random() < row.distributions["share"](rng)
                out = float(row.distributions["out_m"](rng))
                random_turn = rng.uniform(0, 360)
                looks = look(rng, found)
                if not there or middle < 0.0 or middle > road.reference_line.length:
                    continue
                t = _reference(road, row.distributions["from"](rng), sign) + sign * out
                angle = _turn(turned, sign, random_turn)
                for nudge in range(
                    NUDGES if step is None else 1
                ):  # rows that stand end to end need more room inside a bend
                    at = middle + NUDGE_M * nudge
                    p = _stood(road, asset, at, t, angle, looks, size)
                    if p is not None and taken.free(
                        p, 0.02 if found.group == "building" else 0.1 if step is not None else JOINT_M
                    ):
                        taken.add(p)
                        placed.append(p)
                        s += NUDGE_M * nudge if step is None else 0.0
                        break
    return placed


def _at_zebras(road: Road, row: Row, rng: np.random.Generator, sign: int, taken: rules.CollisionSet) -> list[Placement]:
    """A thing beside each zebra, where the traffic of that side comes to it."""
    placed = []
    for zebra in road.zebras:
        asset = row.distributions["models"](rng)
        t = _reference(road, row.distributions["from"](rng), sign) + sign * float(row.distributions["out_m"](rng))
        looks = look(rng, rules.model(asset))
        p = _stood(
            road,
            asset,
            zebra - sign * BESIDE_ZEBRA_M,
            t,
            _turn(row.distributions["turn"](rng), sign, 0.0),
            looks,
            1.0,
            at_zebra=True,
        )
        if p is not None and taken.free(p):
            taken.add(p)
            placed.append(p)
    return placed


def _turn(name: str, sign: int, other: float) -> float:
    """Degrees from the road's direction at which a thing stands on one side of it."""
    return {
        "road": 90.0 * sign,
        "back": -90.0 * sign,
        "traffic": 180.0 if sign > 0 else 0.0,
        "along": 0.0 if sign > 0 else 180.0,
    }.get(name, other)


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
    found = rules.model(asset)
    near_kerb = (
        not at_zebra and found.group != "building" and road.lane_section.low - 3.0 < t < road.lane_section.high + 3.0
    )
    if (
        s > road.reference_line.length
        or in_structure(road, s, t)
        or (near_kerb and any(abs(s - zebra) < 4.5 for zebra in road.zebras))
    ):
        return None
    x, y, z, heading, _ = road.pose(s, t)
    if found.group == "building":  # stands as high as the ground before it, or in the slope
        z = round(float(road.ground(s, road.lane_section.high if t > 0 else road.lane_section.low)), 4) - 0.005
        if max(t - road.lane_section.high, road.lane_section.low - t) - found.length / 2 > FRONT_GARDEN_M:
            corners = rules.footprint(Placement("", "", asset, x, y, heading + angle, size=size))
            ground = road.height(corners[:, 0], corners[:, 1])
            if np.ptp(ground) > DUG_IN_M:
                return None
            z = round(float(np.min(ground)), 4) - 0.005
    return Placement(
        rules.prim_group(found),
        "",
        asset,
        x,
        y,
        round((heading + angle + 180.0) % 360.0 - 180.0, 2),
        looks,
        z=z,
        size=size,
    )


def _reference(road: Road, where: str, sign: int) -> float:
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


UNDRAWN = ("lamps", "signal", "lod", "driver")


def look(rng: np.random.Generator, found: Any) -> dict[str, str]:
    """A choice of each variant set but those of lamps, signals, detail and drivers, whom traffic has."""
    return {
        name: choices[int(rng.integers(len(choices)))]
        for name, choices in sorted(found.variants.items())
        if name not in UNDRAWN
    }


def draw_car(
    recipe: Recipe, section: str, rng: np.random.Generator, among: Sequence[str] | None = None
) -> tuple[str, dict[str, str]]:
    """A vehicle and its paint, of what a section of the recipe chooses among."""
    body = recipe.distributions[f"{section}.bodies"](rng, among)
    paints = rules.model(body).variants.get("paint", ())
    paint = recipe.distributions[f"{section}.paints"](rng, paints) if paints else ""
    return body, ({"paint": paint} if paint else {})


def parked(
    recipe: Recipe, road: Road, seed: int, station: float, share: float, taken: rules.CollisionSet
) -> list[Placement]:
    """One car to a bay, looking the way of the lane beside."""
    placed = []
    for number, (lane, middle) in enumerate(bays(road)):
        rng = stream(seed, "recipe", "parked", number)
        there = rng.random() < share
        body, looks = draw_car(recipe, "parked", rng)
        t = lane.middle + float(np.clip(rng.normal(0, 0.05), -0.1, 0.1))
        s = middle + float(rng.uniform(-0.15, 0.15))
        across, nose_in = bay_length(lane) != BAY_M, rng.random() < 0.7
        room_m = lane.width - 0.15 if across else BAY_M - 0.3
        if not there or s < station - BEHIND_M or rules.model(body).length > room_m or in_structure(road, s, t):
            continue
        way = 1 if lane.middle > 0 else -1
        x, y, z, heading, pitch = road.pose(s, t, way=way)
        if across:
            heading, pitch = heading + (-90.0 if nose_in else 90.0), 0.0
        p = Placement(
            "Vehicles", "", body, x, y, round(heading + float(rng.normal(0, 0.5)), 3), looks, z=z, pitch=pitch
        )
        if taken.free(p):
            taken.add(p)
            placed.append(p)
    return placed


def numbered(placed: Sequence[Placement]) -> list[Placement]:
    """With prim names of model and number."""
    counts: dict[str, int] = {}
    result = []
    for p in placed:
        counts[p.asset] = counts.get(p.asset, 0) + 1
        result.append(replace(p, name=f"{p.asset.title()}_{counts[p.asset]:02d}"))
    return result

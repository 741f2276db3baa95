"""Where traffic, parked cars and people may be at a road: its lanes, bays, pavements and zebras."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from synfog_usd.base.errors import RecipeError
from synfog_usd.world import library
from synfog_usd.world.language import Draws
from synfog_usd.world.roads import people, rules, traffic
from synfog_usd.world.roads.lane_section import RAISED, Lane
from synfog_usd.world.roads.markings import BAY_M, bay_length, bays, zebra_span
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.road_props import BEHIND_M, in_structure
from synfog_usd.world.spec import Placement

AHEAD_M = 260.0
ON_A_BUS_LANE = ("bus", "taxi", "coach", "minibus")
ABREAST_M = ((0.0, 0.0), (0.70, 0.0), (0.35, 0.95))
"""How far to the side of the first, and behind, those walk who go together."""
ZEBRA_WALK_M = 1.2
NEAREST_M, NEAR_SIDE = 8.0, 0.35
"""From the camera to the first who is in the picture; how many are put on the camera's own side before the side is
drawn.
"""


def moving(
    draws: Draws, road: Road, attempt: int, ego_lane: Lane, station: float, room: rules.CollisionSet
) -> list[Placement]:
    """Traffic and people of an attempt.

    Raises:
        RecipeError: there is no room for so many people.
    """
    return [*_traffic(draws, road, attempt, ego_lane, station, room), *_people(draws, road, attempt, station, room)]


def _traffic(
    draws: Draws, road: Road, attempt: int, ego_lane: Lane, station: float, room: rules.CollisionSet
) -> list[Placement]:
    """Vehicles in their lanes: as many as the flow at that hour, no nearer to each other than they can stop."""
    least, density = traffic.flow(draws, attempt)
    low, high = max(station - BEHIND_M, 4.0), min(station + AHEAD_M, road.reference_line.length - 4.0)
    total = draws.optional("traffic.count")
    lanes = road.driving_lanes
    if total is None:
        counts = [
            int(draws.stream("traffic", attempt, "number", index).poisson(density * (high - low)))
            for index in range(len(lanes))
        ]
    else:
        chosen = draws.stream("traffic", attempt, "number").choice(range(len(lanes)), int(total))
        counts = [int((chosen == index).sum()) for index in range(len(lanes))]
    behind, before = traffic.OWN_CAR_M
    speed = traffic.speed_m_s(draws)
    placed: list[Placement] = []
    for index, lane in enumerate(lanes):
        rng = draws.stream("traffic", attempt, "lane", index)
        blocked = [(station - behind - least, station + before + max(least, 4.0))] if lane is ego_lane else []
        free = traffic.spans(road, low, high, blocked)
        among = [name for name in ON_A_BUS_LANE if name in library.names()] if lane.kind == "bus" else None
        vehicles = traffic.flowing(draws.recipe, rng, free, counts[index], least, among)
        placed += traffic.fill(_lane(road, lane, speed), vehicles, rng, room)
    for number in range(draws.whole("traffic.cyclists")):
        placed += _cyclist(road, draws.stream("cyclist", attempt, number), station, room)
    return placed


def _lane(road: Road, lane: Lane, speed_m_s: float) -> traffic.TrafficLane:
    """A lane where who comes to a zebra brakes, and some anywhere, of whose speed nothing is known."""

    def pose(s: float, aside: float) -> traffic.Pose:
        return road.pose(s, lane.middle + aside, way=lane.way)

    def brakes(rng: np.random.Generator, s: float) -> bool:
        before_zebra = any(0.0 < (zebra - s) * lane.way < traffic.BRAKING_M for zebra in road.zebras)
        return before_zebra or rng.random() < traffic.BRAKING

    def speed(s: float, length: float, braking: bool) -> float | None:
        ahead = [(zebra - s) * lane.way for zebra in road.zebras if 0.0 < (zebra - s) * lane.way < traffic.BRAKING_M]
        if ahead:
            return traffic.slowed(speed_m_s, min(ahead) - traffic.ZEBRA_FREE_M, length=length)
        return None if braking else speed_m_s

    return traffic.TrafficLane(pose, traffic.offsets_in_lane(lane.width), brakes, speed_m_s=speed)


def _cyclist(road: Road, rng: np.random.Generator, station: float, room: rules.CollisionSet) -> list[Placement]:
    """At the right edge of the rightmost lane of its way, or on the cycle lane."""
    way = 1 if rng.random() < 0.6 else -1
    lanes = [lane for lane in road.driving_lanes if lane.way == way]
    if not lanes:
        return []
    outer = lanes[-1] if way > 0 else lanes[0]
    cycle = [lane for lane in road.lane_section.of("cycle") if lane.middle * way > 0]
    t = cycle[0].middle if cycle else outer.middle + way * (outer.width / 2 - 0.65)

    def place(rng: np.random.Generator) -> traffic.Pose | None:
        s = station + float(rng.uniform(12.0, 80.0))
        if s > road.reference_line.length - 5.0 or any(abs(s - zebra) < 4.0 for zebra in road.zebras):
            return None
        return road.pose(s, t, way=way)

    return traffic.cyclist(rng, place, room)


def parked(draws: Draws, road: Road, station: float, occupied: rules.CollisionSet) -> list[Placement]:
    """One car to a bay, looking the way of the lane beside."""
    numbered = enumerate(bays(road))
    places = ((_bay(road, lane, middle, station), draws.stream("parked", i)) for i, (lane, middle) in numbered)
    return traffic.park(draws.recipe, places, draws.number("parked.share"), occupied)


def _bay(road: Road, lane: Lane, middle: float, station: float) -> traffic.Bay:
    crosswise = bay_length(lane) != BAY_M

    def pose(along: float, aside: float) -> traffic.Pose | None:
        s, t = middle + along, lane.middle + aside
        if s < station - BEHIND_M or in_structure(road, s, t):
            return None
        return road.pose(s, t, way=1 if lane.middle > 0 else -1)

    return traffic.Bay(pose, lane.width - 0.15 if crosswise else BAY_M - 0.3, crosswise)


def _people(draws: Draws, road: Road, attempt: int, station: float, room: rules.CollisionSet) -> list[Placement]:
    """On pavements, denser near the camera, and on zebra crossings."""
    count = draws.whole("people.count")
    walks = list(road.lane_section.of("pavement"))
    if count and not walks:
        raise RecipeError(f"{draws.recipe.name}: people.count {count}: the lane section has no pavement for them")

    def places(rng: np.random.Generator, crosses: bool, walks_on: bool) -> people.Places:
        if crosses:
            return _on_zebra(road, rng)
        return _on_pavement(road, rng, station, walks, walks_on)

    return people.walking(
        draws.recipe,
        people.Footways(places, zebras=bool(road.zebras)),
        lambda number: draws.stream("person", attempt, number),
        room,
        count=count,
        crossing_share=draws.number("people.crossing_share"),
        company=draws.number("people.company"),
    )


def _on_zebra(road: Road, rng: np.random.Generator) -> people.Places:
    """Somewhere on a zebra, to the left or to the right."""
    way = int(rng.choice((-1, 1)))
    low, high = zebra_span(road)
    s = road.zebras[int(rng.integers(len(road.zebras)))] + float(rng.uniform(-ZEBRA_WALK_M, ZEBRA_WALK_M))
    middle = float(rng.uniform(low + 0.4, high - 0.4))
    turn = 90.0 * way + float(rng.normal(0, 4))
    for at, t, deviation in _abreast(rng, s, middle, (0.0, -way)):
        here = road.lane_section.at(t)
        near = min(abs(at - zebra) for zebra in road.zebras) <= ZEBRA_WALK_M + 0.2
        stands = here is not None and here.kind not in RAISED and near
        yield _stands(road, rng, at, t, turn, deviation) if stands else None


def _on_pavement(
    road: Road, rng: np.random.Generator, station: float, walks: Sequence[Lane], walks_on: bool
) -> people.Places:
    """On a pavement ahead of the camera, most on its own side; who does not walk looks anywhere."""
    way = int(rng.choice((-1, 1)))
    near = [lane for lane in walks if lane.middle > 0]
    chosen = near if near and rng.random() < NEAR_SIDE else list(walks)
    lane = chosen[int(rng.integers(len(chosen)))]
    s = station + NEAREST_M + (road.reference_line.length - station) * 0.5 * float(rng.random()) ** 1.8
    middle = float(rng.uniform(lane.low + 0.55, lane.high - 0.45))
    if s > road.reference_line.length - 3.0:
        return
    turn = 90.0 - 90.0 * way + float(rng.normal(0, 5)) if walks_on else float(rng.uniform(0, 360))
    for at, t, deviation in _abreast(rng, s, middle, (way, 0.0)):
        stands = road.lane_section.at(t) is lane and lane.low + 0.45 <= t <= lane.high - 0.4
        yield _stands(road, rng, at, t, turn, deviation) if stands else None


def _abreast(
    rng: np.random.Generator, s: float, t: float, ahead: tuple[float, float]
) -> Iterator[tuple[float, float, float]]:
    """Stations, offsets [m] and deviations of the heading [degrees] of two or three side by side, the third behind."""
    side = float(rng.choice((-1.0, 1.0)))
    for number, (across, back) in enumerate(ABREAST_M):
        across = side * across * float(rng.uniform(1.0, 1.15))
        back += float(rng.uniform(-0.15, 0.15)) if number else 0.0
        yield s - back * ahead[0] + across * ahead[1], t - back * ahead[1] + across * ahead[0], 2.0 if number else 0.0


def _stands(
    road: Road, rng: np.random.Generator, s: float, t: float, turn: float, deviation: float
) -> tuple[float, float, float, float] | None:
    if not 0.0 < s < road.reference_line.length - 3.0:
        return None
    x, y, z, heading, _ = road.pose(s, t)
    return x, y, z, rules.facing(heading + turn + (float(rng.normal(0, deviation)) if deviation else 0.0))

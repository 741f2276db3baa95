"""Where traffic and people may be at a roundabout: its arms, the ring, pavements and zebras."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from synfog_usd.world import library
from synfog_usd.world.language import Draws
from synfog_usd.world.library import LibraryModel
from synfog_usd.world.roads import people, rules, traffic
from synfog_usd.world.roads.lane_section import KERB_M
from synfog_usd.world.roads.roundabout import ZEBRA_HALF_M, Roundabout
from synfog_usd.world.spec import Placement, View

AHEAD_M = 150.0
WAITS = 0.45
"""Chance that a car waits at a give-way line."""
WAIT_M = 0.7
"""Between its bumper and the circle."""
RING_LEAST_M, RING_APART_M = 4.0, 0.4
RING_ACROSS = (0.5, 0.58, 0.64)
"""Shares of the ring's width at which a vehicle is tried."""
NEAR_M = 26.0
"""People are e times rarer this much farther from the camera."""
BEHIND_M = 6.0
FROM_EDGE_M = 0.4
FULL_M = KERB_M - 1e-3
ABREAST_M = 0.75
"""Between two who walk side by side."""
ABREAST = 2


def moving(
    draws: Draws, junction: Roundabout, attempt: int, before: float, view: View, room: rules.CollisionSet
) -> list[Placement]:
    """Traffic and people of an attempt.

    Raises:
        RecipeError: there is no room for so many people.
    """
    return [*_traffic(draws, junction, attempt, before, room), *_people(draws, junction, attempt, view, room)]


def _traffic(
    draws: Draws, junction: Roundabout, attempt: int, before: float, room: rules.CollisionSet
) -> list[Placement]:
    """Vehicles round the circle, waiting at its entries, and on the arms as many as the flow at that hour."""
    least, density = traffic.flow(draws, attempt)
    speed = traffic.speed_m_s(draws)
    ring_speed = min(speed, ring_speed_m_s((junction.radius + junction.inner) / 2))
    rng = draws.stream("traffic", attempt, "ring")
    placed = _ring(draws, junction, rng, ring_speed, room)
    for number in range(draws.whole("traffic.cyclists")):
        placed += _cyclist(junction, draws.stream("cyclist", attempt, number), before, room)
    total = draws.optional("traffic.count")
    lanes = [(arm, way) for arm in range(len(junction.arms)) for way in (-1, 1)]
    chosen = draws.stream("traffic", attempt, "number").integers(len(lanes), size=int(total or 0))
    ego_behind, ego_before = traffic.OWN_CAR_M
    for index, (arm, way) in enumerate(lanes):
        rng = draws.stream("traffic", attempt, "arm", arm, way + 1)
        road = junction.arms[arm]
        low, high = junction.radius + 1.0, min(junction.radius + AHEAD_M, road.reference_line.length - 6.0)
        ego = [(before - ego_before - max(least, 4.0), before + ego_behind + least)] if (arm, way) == (0, -1) else []
        count = int((chosen == index).sum()) if total is not None else int(rng.poisson(density * (high - low)))
        vehicles: list[traffic.Vehicle] = []
        waits = rng.random() < WAITS
        body, looks = traffic.draw_car(draws.recipe, "traffic", rng)
        if waits and way < 0 and count and _waits(junction, arm, body) and not (ego and ego[0][0] < road.zebras[0]):
            vehicles.append((body, looks, junction.radius + WAIT_M + library.model(body).length / 2))
            count -= 1
        free = traffic.spans(road, road.zebras[0] + ZEBRA_HALF_M, high, ego)
        vehicles += traffic.flowing(draws.recipe, rng, free, count, least)
        placed += traffic.fill(_lane(junction, arm, way, speed), vehicles, rng, room)
    return placed


def _lane(junction: Roundabout, arm: int, way: int, speed_m_s: float) -> traffic.TrafficLane:
    """The lane of an arm, outwards (1) or inwards (-1); before the zebra and the circle who comes in brakes."""

    def pose(s: float, aside: float) -> traffic.Pose:
        return *junction.lane_pose(arm, s, way, aside), 0.0

    def brakes(rng: np.random.Generator, s: float) -> bool:
        arrives = way < 0 and s < junction.arms[arm].zebras[0] + traffic.BRAKING_M
        return arrives or rng.random() < traffic.BRAKING

    def speed(s: float, length: float, braking: bool) -> float | None:
        to_zebra = s - junction.arms[arm].zebras[0]
        if way < 0 and to_zebra < 0.0:
            return 0.0  # it waits at the circle
        if way < 0 and to_zebra < traffic.BRAKING_M:
            return traffic.slowed(speed_m_s, to_zebra - ZEBRA_HALF_M, length=length)
        return None if braking else speed_m_s

    return traffic.TrafficLane(pose, traffic.offsets_in_lane(junction.lane_width), brakes, speed_m_s=speed)


def _waits(junction: Roundabout, arm: int, body: str) -> bool:
    """Whether a vehicle finds room between the circle and the zebra."""
    return junction.radius + WAIT_M + library.model(body).length < junction.arms[arm].zebras[0] - ZEBRA_HALF_M - 0.2


def fits_ring(junction: Roundabout, p: Placement) -> bool:
    """Whether a vehicle's corners and sides stay between the apron's kerb and the circle."""
    corners = rules.footprint(p)
    outer = float(np.hypot(*corners.T).max())
    sides = np.concatenate([corners, (corners + np.roll(corners, 1, axis=0)) / 2])
    return outer < junction.radius - 0.15 and float(np.hypot(*sides.T).min()) > junction.inner + 0.1


def ring_speed_m_s(radius_m: float) -> float:
    """What drivers go at on a circle, at 2 % of cross slope outwards; NCHRP Report 672, equation 6-2: in mph,
    3.4614 times the radius in feet to the power 0.3673.
    """
    return 0.44704 * 3.4614 * (radius_m / 0.3048) ** 0.3673


def _ring(
    draws: Draws, junction: Roundabout, rng: np.random.Generator, speed_m_s: float, room: rules.CollisionSet
) -> list[Placement]:
    """Vehicles that go round, at random with a car's nose between them; bodies too long for the circle stay away."""
    width, length = junction.radius - junction.inner, junction.ring.reference_line.length
    stretch = junction.inner / (junction.inner + width / 2)  # stations are counted along the inner edge
    cars = [traffic.draw_car(draws.recipe, "traffic", rng) for _ in range(draws.whole("traffic.ring"))]
    lengths = [library.model(body).length * 1.1 * stretch for body, _ in cars]
    places = list(traffic.queue(rng, (0.0, length - RING_LEAST_M), lengths, RING_LEAST_M * stretch))
    begin = float(rng.uniform(0.0, length))

    def pose(s: float, aside: float) -> traffic.Pose:
        return *junction.ring_pose(begin + s, aside), 0.0

    def across(rng: np.random.Generator, model: LibraryModel) -> Iterator[float]:
        for share in RING_ACROSS:
            yield share * width + float(rng.normal(0, 0.1))

    lane = traffic.TrafficLane(
        pose,
        across,
        fits=lambda p: fits_ring(junction, p),
        margin=RING_APART_M,
        speed_m_s=lambda s, length, brakes: speed_m_s,
    )
    vehicles = [(body, looks, s) for (body, looks), s in zip(cars, places, strict=False)]
    return traffic.fill(lane, vehicles, rng, room)


def _cyclist(
    junction: Roundabout, rng: np.random.Generator, before: float, room: rules.CollisionSet
) -> list[Placement]:
    """At the right edge of an arm's lane, or on the ring's outer side."""
    ahead = before - traffic.OWN_CAR_M[1]

    def place(rng: np.random.Generator) -> traffic.Pose | None:
        where, arm, way = rng.random(), int(rng.integers(len(junction.arms))), int(rng.choice((-1, 1)))
        if where < 0.35:
            s = float(rng.uniform(0, junction.ring.reference_line.length))
            return *junction.ring_pose(s, junction.radius - junction.inner - 1.0), 0.0
        arm = 0 if where < 0.75 else arm
        zebra = junction.arms[arm].zebras[0]
        s = float(rng.uniform(zebra + 3.5, zebra + 30.0))
        if arm == 0 and way < 0:
            s = float(rng.uniform(zebra + 3.5, max(ahead - 3.0, zebra + 4.0)))
            if s > ahead - 2.0:
                return None
        return *junction.lane_pose(arm, s, way, junction.lane_width / 2 - 0.65), 0.0

    return traffic.cyclist(rng, place, room)


def _people(draws: Draws, junction: Roundabout, attempt: int, view: View, room: rules.CollisionSet) -> list[Placement]:
    """On pavements, denser near the camera, and on the zebras."""
    forward = math.radians(view.heading)
    line = junction.outline
    away = line.points - (view.x, view.y)
    ahead = away @ np.array([-math.sin(forward), math.cos(forward)])
    weight = np.where(ahead > -BEHIND_M, np.exp(-np.hypot(*away.T) / NEAR_M), 0.0) * (line.kerb > FULL_M)
    zebras = np.array([road.reference_line.place(road.zebras[0], 0.0) for road in junction.arms]) - (view.x, view.y)
    near = np.exp(-np.hypot(*zebras.T) / NEAR_M)

    def places(rng: np.random.Generator, crosses: bool, walks_on: bool) -> people.Places:
        way = int(rng.choice((-1, 1)))
        if crosses:
            arm = int(rng.choice(len(junction.arms), p=near / near.sum()))
            road, side = junction.arms[arm], int(rng.choice((-1, 1)))
            s = road.zebras[0] + float(rng.uniform(-1.1, 1.1))
            t = side * float(rng.uniform(0.3, float(junction.edge(arm, side, s)) - 0.4))
            x, y = road.reference_line.place(s, t)
            heading = road.reference_line.origin[2] + 90.0 * way + float(rng.normal(0, 4))
        else:
            k = int(rng.choice(len(weight), p=weight / weight.sum()))
            (nx, ny), u = line.normals[k], float(rng.uniform(0.55, junction.pavement - 0.5))
            x, y = line.points[k] + u * line.normals[k]
            along = math.degrees(math.atan2(ny, nx)) + (180.0 if way < 0 else 0.0)
            heading = along + float(rng.normal(0, 5)) if walks_on else float(rng.uniform(0, 360))
        return _abreast(junction, rng, float(x), float(y), heading)

    return people.walking(
        draws.recipe,
        people.Footways(places, most=ABREAST, redressed=True),
        lambda number: draws.stream("person", attempt, number),
        room,
        count=draws.whole("people.count"),
        crossing_share=draws.number("people.crossing_share"),
        company=draws.number("people.company"),
    )


def may_stand(junction: Roundabout, x: float, y: float) -> bool:
    """Whether people may be at a place: on a pavement, off what is lowered for the zebras, or on a zebra between the
    kerbs.
    """
    u, kerb = junction.across(x, y)
    if u > 0.0:
        return bool(FROM_EDGE_M < u < junction.pavement - FROM_EDGE_M and kerb > FULL_M)
    for road in junction.arms:
        s, t = road.reference_line.nearest(x, y)
        if abs(float(s) - road.zebras[0]) < ZEBRA_HALF_M - 0.2 and abs(float(t)) < junction.radius and u < -0.3:
            return True
    return False


def _abreast(junction: Roundabout, rng: np.random.Generator, x: float, y: float, heading: float) -> people.Places:
    """Places of two side by side."""
    side, back = float(rng.choice((-1.0, 1.0))) * ABREAST_M, float(rng.uniform(-0.15, 0.15))
    for _ in range(ABREAST):
        px, py, z = junction.stand(x, y)
        yield (px, py, z, rules.facing(heading)) if may_stand(junction, px, py) else None
        h = math.radians(heading)
        x, y = x + side * math.cos(h) + back * math.sin(h), y + side * math.sin(h) - back * math.cos(h)
        heading += float(rng.normal(0, 2))

"""Who moves at a roundabout: traffic on the arms and round the circle, cyclists, people on pavements and zebras."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from synfog_usd.errors import RecipeError
from synfog_usd.seeds import stream
from synfog_usd.world.language import Recipe
from synfog_usd.world.parameters import WALKERS
from synfog_usd.world.roads import actors as roads
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.actors import BRAKING, BRAKING_M, COMPANY, OWN_CAR_M, TRIES
from synfog_usd.world.roads.lane_section import KERB_M
from synfog_usd.world.roads.props import draw_car, look
from synfog_usd.world.roads.roundabout import ZEBRA_HALF_M, Roundabout
from synfog_usd.world.spec import Placement, View

AHEAD_M = 150.0
WAITS = 0.45
"""Chance that a car waits at a give-way line."""
WAIT_M = 0.7
"""Between its bumper and the circle."""
RING_LEAST_M = 4.0
NEAR_M = 26.0
"""People are e times rarer this much farther from the camera."""
BEHIND_M = 6.0
FROM_EDGE_M = 0.4
FULL_M = KERB_M - 1e-3
ABREAST_M = 0.75
"""Between two who walk side by side."""


def in_sight(
    recipe: Recipe,
    junction: Roundabout,
    seed: int,
    before: float,
    value: Any,
    view: View,
    fov: float,
    fixed: list[Placement],
    taken: rules.CollisionSet,
) -> tuple[list[Placement] | None, str, int]:
    """Traffic and people that meet the rules of sight; None with the rule that failed and the most that was reached."""

    def drawn(attempt: int, room: rules.CollisionSet) -> list[Placement]:
        return [
            *_traffic(recipe, junction, seed, attempt, before, value, room),
            *_people(recipe, junction, seed, attempt, view, value, room),
        ]

    return roads.in_sight(drawn, junction, value, view, fov, fixed, taken)


def _traffic(
    recipe: Recipe, junction: Roundabout, seed: int, attempt: int, before: float, value: Any, room: rules.CollisionSet
) -> list[Placement]:
    """Vehicles round the circle, waiting at its entries, and on the arms as many as the flow at that hour."""
    least, density = roads.flow(value, attempt)
    placed: list[Placement] = []
    placed += _ring(recipe, junction, stream(seed, "recipe", "traffic", attempt, "ring"), value("traffic.ring"), room)
    total = value("traffic.count")
    lanes = [(arm, way) for arm in range(len(junction.arms)) for way in (-1, 1)]
    for number in range(value("traffic.cyclists")):
        placed += _cyclist(junction, stream(seed, "recipe", "cyclist", attempt, number), before, room)
    chosen = stream(seed, "recipe", "traffic", attempt, "number").integers(len(lanes), size=total or 0)
    for index, (arm, way) in enumerate(lanes):
        rng = stream(seed, "recipe", "traffic", attempt, "arm", arm, way + 1)
        road = junction.arms[arm]
        low, high = junction.radius + 1.0, min(junction.radius + AHEAD_M, road.reference_line.length - 6.0)
        own = (
            [(before - OWN_CAR_M[1] - max(least, 4.0), before + OWN_CAR_M[0] + least)] if (arm, way) == (0, -1) else []
        )
        count = int((chosen == index).sum()) if total is not None else int(rng.poisson(density * (high - low)))
        places: list[tuple[str, dict[str, str], float]] = []
        waits = rng.random() < WAITS
        body, looks = draw_car(recipe, "traffic", rng)
        if waits and way < 0 and count and _waits(junction, arm, body) and not (own and own[0][0] < road.zebras[0]):
            places.append((body, looks, junction.radius + WAIT_M + rules.model(body).length / 2))
            count -= 1
        free = rules.spans(road, road.zebras[0] + ZEBRA_HALF_M, high, own)
        long = np.array([b - a for a, b in free])
        if len(long) and count:
            share = rng.choice(len(free), count, p=long / long.sum())
            for number, span in enumerate(free):
                cars = [draw_car(recipe, "traffic", rng) for _ in range(int((share == number).sum()))]
                at = rules.queue(rng, span, [rules.model(name).length for name, _ in cars], least)
                places += [(name, paint, s) for (name, paint), s in zip(cars, at, strict=False)]
        for name, paint, s in places:
            sway = min(0.2, max(0.0, (junction.lane_width - rules.model(name).width) / 2 - 0.15))
            x, y, z, heading = junction.lane_pose(arm, s, way, float(np.clip(rng.normal(0, 0.08), -sway, sway)))
            slows = (way < 0 and s < road.zebras[0] + BRAKING_M) or rng.random() < BRAKING
            roads.add(
                Placement("Vehicles", "", name, x, y, heading, paint, {"lamps": "brake" if slows else "glow"}, z=z),
                room,
                placed,
                0.15,
            )
    return placed


def _waits(junction: Roundabout, arm: int, body: str) -> bool:
    """Whether a vehicle finds room between the circle and the zebra."""
    return junction.radius + WAIT_M + rules.model(body).length < junction.arms[arm].zebras[0] - ZEBRA_HALF_M - 0.2


def fits_ring(junction: Roundabout, p: Placement) -> bool:
    """Whether a vehicle's corners and sides stay between the apron's kerb and the circle."""
    corners = rules.footprint(p)
    outer = float(np.hypot(*corners.T).max())
    sides = np.concatenate([corners, (corners + np.roll(corners, 1, axis=0)) / 2])
    return outer < junction.radius - 0.15 and float(np.hypot(*sides.T).min()) > junction.inner + 0.1


def _ring(
    recipe: Recipe, junction: Roundabout, rng: np.random.Generator, count: int, room: rules.CollisionSet
) -> list[Placement]:
    """Vehicles that go round, at random with a car's nose between them; bodies too long for the circle stay away."""
    width, length = junction.radius - junction.inner, junction.ring.reference_line.length
    cars = [draw_car(recipe, "traffic", rng) for _ in range(count)]
    stretch = junction.inner / (junction.inner + width / 2)  # stations are counted along the inner edge
    places = rules.queue(
        rng,
        (0.0, length - RING_LEAST_M),
        [rules.model(name).length * 1.1 * stretch for name, _ in cars],
        RING_LEAST_M * stretch,
    )
    begin = float(rng.uniform(0.0, length))
    placed: list[Placement] = []
    for (name, paint), s in zip(cars, places, strict=False):
        for aside in (0.5, 0.58, 0.64):
            x, y, z, heading = junction.ring_pose(begin + s, aside * width + float(rng.normal(0, 0.1)))
            p = Placement("Vehicles", "", name, x, y, heading, paint, {"lamps": "glow"}, z=z)
            if fits_ring(junction, p) and roads.add(p, room, placed, 0.4):
                break
    return placed


def _cyclist(
    junction: Roundabout, rng: np.random.Generator, before: float, room: rules.CollisionSet
) -> list[Placement]:
    """At the right edge of an arm's lane, or on the ring's outer side."""
    placed: list[Placement] = []
    looks = look(rng, rules.model("cyclist"))
    for _ in range(20):
        where, arm, way = rng.random(), int(rng.integers(len(junction.arms))), int(rng.choice((-1, 1)))
        if where < 0.35:
            x, y, z, heading = junction.ring_pose(
                float(rng.uniform(0, junction.ring.reference_line.length)), junction.radius - junction.inner - 1.0
            )
        else:
            arm = 0 if where < 0.75 else arm
            zebra = junction.arms[arm].zebras[0]
            s = float(rng.uniform(zebra + 3.5, zebra + 30.0))
            if arm == 0 and way < 0:
                s = float(rng.uniform(zebra + 3.5, max(before - OWN_CAR_M[1] - 3.0, zebra + 4.0)))
                if s > before - OWN_CAR_M[1] - 2.0:
                    continue
            x, y, z, heading = junction.lane_pose(arm, s, way, junction.lane_width / 2 - 0.65)
        p = Placement("Vehicles", "", "cyclist", x, y, heading, looks, z=z)
        if roads.add(p, room, placed, 0.4):
            break
    return placed


def _people(
    recipe: Recipe, junction: Roundabout, seed: int, attempt: int, view: View, value: Any, room: rules.CollisionSet
) -> list[Placement]:
    """On pavements, denser near the camera, and on the zebras; some walk in company, side by side."""
    count, share, company = value("people.count"), value("people.crossing_share"), value("people.company")
    line = junction.outline
    forward = math.radians(view.heading)
    away = line.points - (view.x, view.y)
    ahead = away @ np.array([-math.sin(forward), math.cos(forward)])
    weight = np.where(ahead > -BEHIND_M, np.exp(-np.hypot(*away.T) / NEAR_M), 0.0) * (line.kerb > FULL_M)
    zebras = np.array([road.reference_line.place(road.zebras[0], 0.0) for road in junction.arms]) - (view.x, view.y)
    near = np.exp(-np.hypot(*zebras.T) / NEAR_M)
    kinds = recipe.distributions["people.kinds"]
    walkers = [name for name in WALKERS if name in kinds.values]
    placed: list[Placement] = []
    number = 0
    while len(placed) < count:
        rng = stream(seed, "recipe", "person", attempt, number)
        number += 1
        crosses = rng.random() < share
        names = [kinds(rng, walkers or None) if crosses else kinds(rng)]
        if names[0] in COMPANY and rng.random() < company and len(placed) + 1 < count:
            names.append(kinds(rng, [name for name in walkers if name in COMPANY]))
        for turn in range(2 * TRIES):
            way = int(rng.choice((-1, 1)))
            if crosses:
                arm = int(rng.choice(len(junction.arms), p=near / near.sum()))
                road, side = junction.arms[arm], int(rng.choice((-1, 1)))
                s = road.zebras[0] + float(rng.uniform(-1.1, 1.1))
                x, y = road.reference_line.place(
                    s, side * float(rng.uniform(0.3, float(junction.edge(arm, side, s)) - 0.4))
                )
                facing = road.reference_line.origin[2] + 90.0 * way + float(rng.normal(0, 4))
            else:
                k = int(rng.choice(len(weight), p=weight / weight.sum()))
                (nx, ny), u = line.normals[k], float(rng.uniform(0.55, junction.pavement - 0.5))
                x, y = line.points[k] + u * line.normals[k]
                along = math.degrees(math.atan2(ny, nx)) + (180.0 if way < 0 else 0.0)
                facing = along + float(rng.normal(0, 5)) if names[0] in WALKERS else float(rng.uniform(0, 360))
            group = names if turn < TRIES else names[:1]  # where two find no room, one walks alone
            found = _together(junction, rng, float(x), float(y), facing, group, room)
            if found:
                placed += found
                break
        else:
            raise RecipeError(
                f"{recipe.name}: people.count {count}: no room for more than {len(placed)} after {2 * TRIES} tries"
            )
    return placed


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


def _together(
    junction: Roundabout,
    rng: np.random.Generator,
    x: float,
    y: float,
    facing: float,
    names: Sequence[str],
    room: rules.CollisionSet,
) -> list[Placement]:
    """One, or two abreast; nobody where one of them has no room."""
    found: list[Placement] = []
    trial = room.copy() if len(names) > 1 else room
    side, back = float(rng.choice((-1.0, 1.0))) * ABREAST_M, float(rng.uniform(-0.15, 0.15))
    for name in names:
        looks, h = look(rng, rules.model(name)), math.radians(facing)
        px, py, z = junction.stand(x, y)
        p = Placement("People", "", name, px, py, round((facing + 180.0) % 360.0 - 180.0, 2), looks, z=z)
        if not may_stand(junction, px, py) or not trial.free(p, 0.03 if found else 0.12):
            return []
        trial.add(p)
        found.append(p)
        x, y = x + side * math.cos(h) + back * math.sin(h), y + side * math.sin(h) - back * math.cos(h)
        facing += float(rng.normal(0, 2))
    if trial is not room:
        for p in found:
            room.add(p)
    return found

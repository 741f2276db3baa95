"""Who moves on a road: traffic in its lanes, cyclists, and people on pavements and zebras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from synfog_usd.errors import RecipeError
from synfog_usd.seeds import stream
from synfog_usd.world.language import Recipe
from synfog_usd.world.parameters import WALKERS
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.lane_section import RAISED, Lane
from synfog_usd.world.roads.markings import zebra_span
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.props import BEHIND_M, draw_car, look, numbered
from synfog_usd.world.spec import Placement, View

TRIES = 60
TRIES_ALIKE, DENSER = 5, 1.3
"""A world whose traffic is too thin for the rules of sight is tried again with denser traffic, after every few
tries.
"""
CHOICES, ENOUGH, HIDDEN_COSTS = 4, 12, 0.5
"""Of so many draws that keep the rules, among the first ENOUGH, the one is taken that shows most road users; one that
is hidden takes half of one away.
"""
AHEAD_M = 260.0
OWN_CAR_M = (4.5, 2.6)
"""Free lane behind and before the lens: the camera's own car."""
BRAKING_M, BRAKING = 30.0, 0.1
"""Before a zebra vehicles brake; so do some anywhere."""
COMPANY = ("man_walking", "woman_walking", "student", "child", "schoolgirl", "old_man", "woman_pram")
"""Who walks in company at times."""
ABREAST_M = ((0.0, 0.0), (0.70, 0.0), (0.35, 0.95))
"""How far to the side of the first, and behind, those walk who go together."""
ZEBRA_WALK_M = 1.2
NEAREST_M, NEAR_SIDE = 8.0, 0.35
"""From the camera to the first who is in the picture; how many are put on the camera's own side before the side is
drawn.
"""


def actors_in_sight(
    recipe: Recipe,
    road: Road,
    seed: int,
    own: Lane,
    station: float,
    value: Any,
    view: View,
    fov: float,
    fixed: list[Placement],
    taken: rules.CollisionSet,
    hour: float,
) -> tuple[list[Placement] | None, str, int]:
    """Traffic and people that meet the rules of sight; None with the rule that failed and the most that was reached."""

    def drawn(attempt: int, room: rules.CollisionSet) -> list[Placement]:
        return [
            *_traffic(recipe, road, seed, attempt, own, station, value, room),
            *_people(recipe, road, seed, attempt, station, value, room),
        ]

    return in_sight(drawn, road, value, view, fov, fixed, taken)


def in_sight(
    drawn: Callable[[int, rules.CollisionSet], list[Placement]],
    road: Road,
    value: Any,
    view: View,
    fov: float,
    fixed: list[Placement],
    taken: rules.CollisionSet,
) -> tuple[list[Placement] | None, str, int]:
    """Of the actors that attempt after attempt draws, those that meet the rules of sight best; `drawn` takes the
    attempt's number and what stands already.
    """
    users, in_view, within = value("rules.users"), value("rules.in_view"), value("rules.within_m")
    best = {"users": 0, "in_view": 0}
    chosen: tuple[float, list[Placement]] | None = None
    met = 0
    for attempt in range(TRIES):
        room = taken.copy()
        actors = drawn(attempt, room)
        every = numbered([*fixed, *actors])
        count = sum(rules.model(p.asset).label in rules.USERS for p in every)
        best["users"] = max(best["users"], count)
        if count < users:
            continue
        shares = rules.visible_shares(view, fov, every, road, within_m=within).values()
        seen = sum(share >= rules.SHARE_SEEN for share in shares)
        best["in_view"] = max(best["in_view"], seen)
        if seen >= in_view:
            met += 1
            score = seen - HIDDEN_COSTS * (len(shares) - seen)
            if chosen is None or score > chosen[0]:
                chosen = score, actors
            if met == CHOICES:
                break
        if chosen is not None and attempt + 1 >= ENOUGH:
            break
    if chosen is not None:
        return chosen[1], "", 0
    failed = "users" if best["users"] < users else "in_view"
    return None, f"{failed} {users if failed == 'users' else in_view}", best[failed]


def flow(value: Any, attempt: int) -> tuple[float, float]:
    """Least distance between bumpers [m] and vehicles per length of lane [1/m], denser after tries that failed."""
    speed = value("traffic.speed_kmh") / 3.6
    return 1.5 + speed * value("traffic.headway_s"), value("traffic.per_hour") / 3600.0 / speed * DENSER ** (
        attempt // TRIES_ALIKE
    )


def add(p: Placement, room: rules.CollisionSet, placed: list[Placement], margin: float) -> bool:
    """Put somebody where there is room."""
    if not room.free(p, margin):
        return False
    room.add(p)
    placed.append(p)
    return True


def _traffic(
    recipe: Recipe, road: Road, seed: int, attempt: int, own: Lane, station: float, value: Any, room: rules.CollisionSet
) -> list[Placement]:
    """Vehicles in their lanes: as many as the flow at that hour (more after tries that failed), no nearer to each other
    than they can stop.
    """
    least, density = flow(value, attempt)
    low, high = max(station - BEHIND_M, 4.0), min(station + AHEAD_M, road.reference_line.length - 4.0)
    total = value("traffic.count")
    lanes = road.driving_lanes
    if total is None:
        counts = [
            int(stream(seed, "recipe", "traffic", attempt, "number", index).poisson(density * (high - low)))
            for index in range(len(lanes))
        ]
    else:
        chosen = stream(seed, "recipe", "traffic", attempt, "number").choice(range(len(lanes)), total)
        counts = [int((chosen == index).sum()) for index in range(len(lanes))]
    placed: list[Placement] = []
    for index, lane in enumerate(lanes):
        rng = stream(seed, "recipe", "traffic", attempt, "lane", index)
        blocked = [(station - OWN_CAR_M[0] - least, station + OWN_CAR_M[1] + max(least, 4.0))] if lane is own else []
        free = rules.spans(road, low, high, blocked)
        long = np.array([b - a for a, b in free])
        if not len(long):
            continue
        share = rng.choice(len(free), counts[index], p=long / long.sum())
        for number, span in enumerate(free):
            cars = []
            for _ in range(int((share == number).sum())):
                among = (
                    [b for b in ("bus", "taxi", "coach", "minibus") if b in rules.names()]
                    if lane.kind == "bus"
                    else None
                )
                cars.append(draw_car(recipe, "traffic", rng, among))
            places = rules.queue(rng, span, [rules.model(body).length for body, _ in cars], least)
            for (body, looks), s in zip(cars, places, strict=False):
                narrow = rules.model(body).group == "rider"
                sway = min(0.9 if narrow else 0.2, max(0.0, (lane.width - rules.model(body).width) / 2 - 0.15))
                t = lane.middle + float(np.clip(rng.normal(0, 0.45 if narrow else 0.08), -sway, sway))
                x, y, z, heading, pitch = road.pose(s, t, way=lane.way)
                slows = any(0.0 < (zebra - s) * lane.way < BRAKING_M for zebra in road.zebras) or rng.random() < BRAKING
                lit = "brake" if slows and "brake" in rules.model(body).variants.get("lamps", ()) else "glow"
                p = Placement("Vehicles", "", body, x, y, heading, looks, {"lamps": lit}, z=z, pitch=pitch)
                add(p, room, placed, 0.15)
    for number in range(value("traffic.cyclists")):
        rng = stream(seed, "recipe", "cyclist", attempt, number)
        placed += _cyclist(road, rng, station, room)
    return placed


def _cyclist(road: Road, rng: np.random.Generator, station: float, room: rules.CollisionSet) -> list[Placement]:
    """At the right edge of the rightmost lane of its way, or on the cycle lane."""
    way = 1 if rng.random() < 0.6 else -1
    lanes = [lane for lane in road.driving_lanes if lane.way == way]
    if not lanes:
        return []
    outer = lanes[-1] if way > 0 else lanes[0]
    cycle = [lane for lane in road.lane_section.of("cycle") if lane.middle * way > 0]
    t = cycle[0].middle if cycle else outer.middle + way * (outer.width / 2 - 0.65)
    looks = look(rng, rules.model("cyclist"))
    for _ in range(20):
        s = station + float(rng.uniform(12.0, 80.0))
        if s > road.reference_line.length - 5.0 or any(abs(s - zebra) < 4.0 for zebra in road.zebras):
            continue
        x, y, z, heading, pitch = road.pose(s, t, way=way)
        p = Placement("Vehicles", "", "cyclist", x, y, heading, looks, z=z, pitch=pitch)
        if room.free(p, 0.4):
            room.add(p)
            return [p]
    return []


@dataclass(frozen=True)
class _Spot:
    """Where somebody stands or walks: station and offset [m], turn from the road [degrees], and the direction of
    walking in (s, t).
    """

    s: float
    t: float
    turn: float
    ahead: tuple[float, float]


def _people(
    recipe: Recipe, road: Road, seed: int, attempt: int, station: float, value: Any, room: rules.CollisionSet
) -> list[Placement]:
    """On pavements, denser near the camera, and on zebra crossings; some walk in company, side by side."""
    count, share, company = value("people.count"), value("people.crossing_share"), value("people.company")
    walks = [lane for lane in road.lane_section.of("pavement")]
    if count and not walks:
        raise RecipeError(f"{recipe.name}: people.count {count}: the lane section has no pavement for them")
    placed: list[Placement] = []
    kinds = recipe.distributions["people.kinds"]
    walkers = [name for name in WALKERS if name in kinds.values]
    number = 0
    while len(placed) < count:
        rng = stream(seed, "recipe", "person", attempt, number)
        number += 1
        crosses = bool(road.zebras) and rng.random() < share
        names = [kinds(rng, walkers or None) if crosses else kinds(rng)]
        if names[0] in COMPANY and rng.random() < company:
            friends = [name for name in walkers if name in COMPANY]
            names += [kinds(rng, friends) for _ in range(min(2 if rng.random() < 0.25 else 1, count - len(placed) - 1))]
        looks = [look(rng, rules.model(name)) for name in names]
        for attempt_here in range(2 * TRIES):
            spot = _crossing(road, rng) if crosses else _on_pavement(road, rng, station, walks, names[0] in WALKERS)
            group = names if attempt_here < TRIES else names[:1]  # where a group finds no room, one walks alone
            found = _together(road, rng, spot, group, looks, room, crosses) if spot else []
            if found:
                placed += found
                break
        else:
            raise RecipeError(
                f"{recipe.name}: people.count {count}: no room for more than {len(placed)} after {2 * TRIES} tries"
            )
    return placed


def _crossing(road: Road, rng: np.random.Generator) -> _Spot | None:
    """Somewhere on a zebra, to the left or to the right."""
    way = int(rng.choice((-1, 1)))
    low, high = zebra_span(road)
    s = road.zebras[int(rng.integers(len(road.zebras)))] + float(rng.uniform(-ZEBRA_WALK_M, ZEBRA_WALK_M))
    return _Spot(s, float(rng.uniform(low + 0.4, high - 0.4)), 90.0 * way + float(rng.normal(0, 4)), (0.0, -way))


def _on_pavement(
    road: Road, rng: np.random.Generator, station: float, walks: Sequence[Lane], walking: bool
) -> _Spot | None:
    """On a pavement ahead of the camera, most on its own side; who does not walk looks anywhere."""
    way = int(rng.choice((-1, 1)))
    near = [lane for lane in walks if lane.middle > 0]
    chosen = near if near and rng.random() < NEAR_SIDE else list(walks)
    lane = chosen[int(rng.integers(len(chosen)))]
    s = station + NEAREST_M + (road.reference_line.length - station) * 0.5 * float(rng.random()) ** 1.8
    t = float(rng.uniform(lane.low + 0.55, lane.high - 0.45))
    if s > road.reference_line.length - 3.0:
        return None
    return _Spot(
        s, t, 90.0 - 90.0 * way + float(rng.normal(0, 5)) if walking else float(rng.uniform(0, 360)), (way, 0.0)
    )


def _together(
    road: Road,
    rng: np.random.Generator,
    spot: _Spot,
    names: Sequence[str],
    looks: Sequence[dict[str, str]],
    room: rules.CollisionSet,
    crosses: bool,
) -> list[Placement]:
    """One, or two or three abreast, the third behind; nobody where one of them has no room."""
    side = float(rng.choice((-1.0, 1.0)))
    found: list[Placement] = []
    trial = room.copy() if len(names) > 1 else room
    lane = road.lane_section.at(spot.t)
    for name, looked, (across, back) in zip(names, looks, ABREAST_M, strict=False):
        across, back = (
            side * across * float(rng.uniform(1.0, 1.15)),
            back + (float(rng.uniform(-0.15, 0.15)) if found else 0.0),
        )
        s = spot.s - back * spot.ahead[0] + across * spot.ahead[1]
        t = spot.t - back * spot.ahead[1] + across * spot.ahead[0]
        here = road.lane_section.at(t)
        if here is None or not 0.0 < s < road.reference_line.length - 3.0:
            return []
        if crosses and (here.kind in RAISED or min(abs(s - zebra) for zebra in road.zebras) > ZEBRA_WALK_M + 0.2):
            return []
        if not crosses and (here is not lane or not here.low + 0.45 <= t <= here.high - 0.4):
            return []
        x, y, z, heading, _ = road.pose(s, t)
        turn = spot.turn + (float(rng.normal(0, 2)) if found else 0.0)
        p = Placement("People", "", name, x, y, round((heading + turn + 180.0) % 360.0 - 180.0, 2), dict(looked), z=z)
        if not trial.free(p, 0.03 if found else 0.12):
            return []
        trial.add(p)
        found.append(p)
    if trial is not room:
        for p in found:
            room.add(p)
    return found

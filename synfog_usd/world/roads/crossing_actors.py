"""Where traffic, parked cars and people may be at the crossing: its lanes by the phase of the signals, bays, pavements.

Every lane and pavement is straight and level, so places are coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from synfog_usd.world.language import Draws, weighted
from synfog_usd.world.library import LibraryModel, nominal
from synfog_usd.world.roads import crossing_props, people, rules, traffic
from synfog_usd.world.roads.crossing import BAY_M, MAIN_HALF, ZEBRA, ZEBRA_DEPTH, ZEBRA_SIDE, ground_height
from synfog_usd.world.roads.crossing_props import LIT_Y, standing
from synfog_usd.world.spec import Placement

WIDE = ("bus", "lorry")
"""Bodies that keep nearer to the middle of the street, away from parked cars' mirrors."""
PARKED_X = 4.5
CARE = traffic.Care(across=0.04, most=0.08, along=0.12, turn=0.0)
NEAREST_LIT = 8
"""Cars in traffic whose headlights are lights; the others' lenses glow.  Each light costs noise in every pixel."""
CROSSING_SHARE = 0.3
"""Share of the people who are on the zebra crossings of the street that waits."""
ROOM_M = {"bench": 1.4, "advertising_column": 1.3, "cabinet": 1.1, "bicycle": 1.3}
"""How far people keep from the middle of a thing; from all others ROOM_ELSE_M."""
ROOM_ELSE_M = 0.75
TRIES = 400
GAP_M = 4.0
QUEUE = 3
"""So many wait nose to tail."""


@dataclass(frozen=True)
class _Stretch:
    """A straight piece of lane.

    Attributes:
        along: 'y' or 'x'; across: the other coordinate [m].
        start, end: between which cars may be [m], in the direction in which they are put there.
        heading: degrees.
        weight: share of the traffic.
        waits: whether the first cars stand at `start`, nose to tail.
    """

    along: str
    across: float
    start: float
    end: float
    heading: float
    weight: float
    waits: bool = False

    @property
    def length(self) -> float:
        """[m]."""
        return abs(self.end - self.start)

    def lane(self, speed_m_s: Callable[[float], float]) -> traffic.TrafficLane:
        """The lane as traffic fills it; stations count from `start`, and `speed_m_s` gives the speed at one."""
        way = math.copysign(1.0, self.end - self.start)

        def pose(s: float, across: float) -> traffic.Pose:
            middle = way * s + self.start
            x, y = (across, middle) if self.along == "y" else (middle, across)
            return _place(x, y, self.heading)

        def across(rng: np.random.Generator, model: LibraryModel) -> Iterator[float]:
            near, sway = (0.9, 0.04) if model.name in WIDE else (1.0, 0.1)
            yield near * self.across + float(rng.uniform(-sway, sway))

        return traffic.TrafficLane(pose, across, speed_m_s=lambda s, length, brakes: speed_m_s(s))


STOP = ZEBRA + ZEBRA_DEPTH + 1.9
STOP_SIDE = ZEBRA_SIDE + ZEBRA_DEPTH + 1.9
LANES = {
    "waits": (
        _Stretch("y", 1.76, STOP, 235.0, 0.0, 3),
        _Stretch("y", -1.8, STOP, 235.0, 180.0, 4, waits=True),
        _Stretch("y", -1.85, -STOP, -62.0, 180.0, 1),
        _Stretch("x", -2.08, -60.0, 60.0, -90.0, 1.5),
        _Stretch("x", 2.12, -60.0, 60.0, 90.0, 1.5),
    ),
    "goes": (
        _Stretch("y", 1.76, -8.0, 235.0, 0.0, 4),
        _Stretch("y", -1.8, -62.0, 235.0, 180.0, 4),
        _Stretch("x", -2.08, -STOP_SIDE, -60.0, -90.0, 1, waits=True),
        _Stretch("x", 2.12, STOP_SIDE, 60.0, 90.0, 1, waits=True),
    ),
}
"""Where traffic may be while the main street waits or goes.  The camera's own lane stays free up to the crossing."""


def _place(x: float, y: float, heading: float) -> traffic.Pose:
    x, y = round(float(x), 3), round(float(y), 3)
    return x, y, ground_height(x, y), heading, 0.0


def parked(draws: Draws, room: rules.Room) -> list[Placement]:
    """One car to a bay of the markings, on both sides of the main street, from behind the camera to the far end."""
    first = 20.0 + BAY_M / 2
    bays = [*np.arange(-first, -60.0, -BAY_M), *np.arange(first, 238.0, BAY_M)]

    def bay(side: int, y: float) -> traffic.Bay:
        def pose(along: float, aside: float) -> traffic.Pose:
            return _place(side * PARKED_X + aside, y + along, 180.0 if side < 0 else 0.0)

        return traffic.Bay(pose, BAY_M)

    numbered = [(side, index, y) for side in (-1, 1) for index, y in enumerate(bays)]
    places = ((bay(side, y), draws.stream("parked", side, index)) for side, index, y in numbered)
    return traffic.park(draws.recipe, places, draws.number("parked.share"), room, CARE)


def driving(draws: Draws, waits: bool, room: rules.Room) -> list[Placement]:
    """Vehicles in the lanes of the phase; the nearest have their lamps on.

    Who comes to a queue brakes to its end, which is where all before stand nose to tail.
    """
    stretches = LANES["waits" if waits else "goes"]
    rng, speed_m_s = draws.stream("traffic", "lanes"), traffic.speed_m_s(draws)
    bound: list[list[tuple[str, float, dict[str, str]]]] = [[] for _ in stretches]
    for index in range(draws.whole("traffic.count")):
        body, looks = traffic.draw_car(draws.recipe, "traffic", draws.stream("traffic", "car", index))
        car = (body, nominal()[body]["length_m"], looks)
        fitting = [
            (cars, stretch.weight)
            for stretch, cars in zip(stretches, bound, strict=True)
            if sum(length + GAP_M for _, length, _ in [*cars, car]) <= stretch.length
        ]
        if not fitting:
            raise AssertionError("the limit of traffic.count leaves room for as many buses")
        weighted(rng, *zip(*fitting, strict=True)).append(car)
    placed: list[Placement] = []
    for number, (stretch, cars) in enumerate(zip(stretches, bound, strict=True)):
        rng = draws.stream("traffic", "lane", number)
        free = (0.0, stretch.length - GAP_M) if stretch.waits else (GAP_M, stretch.length)
        lengths = [length for _, length, _ in cars]
        stations = traffic.queue(rng, free, lengths, GAP_M, close=QUEUE if stretch.waits else 0)
        speeds: dict[float, float] = {}
        vehicles = _bound(stretch, cars, stations, speed_m_s, speeds)
        placed += traffic.fill(stretch.lane(speeds.__getitem__), vehicles, rng, room)
    view = crossing_props.VIEW
    near = sorted((p for p in placed if p.y < LIT_Y), key=lambda p: (math.hypot(p.x - view.x, p.y - view.y), p.x))
    return [replace(p, lit={"lamps": "on"}) if p in near[:NEAREST_LIT] else p for p in placed]


def _bound(
    lane: _Stretch,
    cars: Sequence[tuple[str, float, dict[str, str]]],
    stations: Iterable[float],
    speed_m_s: float,
    speeds: dict[float, float],
) -> Iterator[traffic.Vehicle]:
    """The vehicles of a lane, one at a time; their speeds are left by station."""
    end = 0.0
    for index, ((body, length, looks), s) in enumerate(zip(cars, stations, strict=True)):
        speeds[s] = speed_m_s
        if lane.waits:
            speeds[s] = 0.0 if index < QUEUE else traffic.slowed(speed_m_s, s - end, length=length)
        end += length + sum(traffic.CLOSE_M) / 2
        yield body, looks, s


@dataclass
class _Apart:
    """Room for people between middles: (x, y, least distance) [m] of everything that stands there; and what has an
    outline that nobody may be in.
    """

    middles: list[tuple[float, float, float]]
    fixed: rules.CollisionSet

    def take(self, p: Placement, margin: float = 0.0) -> bool:
        """Take a place that keeps its distance from all others."""
        free = all(math.hypot(p.x - x, p.y - y) >= least for x, y, least in self.middles)
        if free := free and self.fixed.free(p, 0.0):
            self.add(p)
        return free

    def add(self, p: Placement) -> None:
        """Take a place, whatever stands there."""
        self.middles.append((p.x, p.y, ROOM_ELSE_M))

    def copy(self) -> _Apart:
        """Another that goes on from here."""
        return _Apart(list(self.middles), self.fixed)


def walking(draws: Draws, waits: bool, fixed: Sequence[Placement]) -> list[Placement]:
    """People on the pavements of the main street, and on the zebras of the street that waits."""

    def places(rng: np.random.Generator, crosses: bool, walks_on: bool) -> people.Places:
        x, y, heading = _on_zebra(rng, waits) if crosses else _on_pavement(rng, walks_on)
        x, y, z, _, _ = _place(x, y, 0.0)
        yield x, y, z, round(float(heading), 1)

    outlines = rules.CollisionSet()
    for p in fixed:
        outlines.add(p)
    walkers = people.walking(
        draws.recipe,
        people.Footways(places, most=1, tries=TRIES),
        lambda number: draws.stream("person", number),
        _Apart([(p.x, p.y, ROOM_M.get(p.asset, ROOM_ELSE_M)) for p in fixed], outlines),
        count=draws.whole("people.count"),
        crossing_share=CROSSING_SHARE,
        company=0.0,
    )
    return [replace(p, name=f"Person_{index + 1:02d}") for index, p in enumerate(walkers)]


def _on_zebra(rng: np.random.Generator, waits: bool) -> tuple[float, float, float]:
    """On a zebra of the street that waits; walkers look along it, one way or the other."""
    side, way = (int(sign) for sign in rng.choice((-1, 1), 2))
    turn = float(rng.normal(0, 3))
    if waits:
        x = rng.uniform(-MAIN_HALF + 0.8, MAIN_HALF - 0.8)
        return x, side * rng.uniform(ZEBRA + 0.4, ZEBRA + ZEBRA_DEPTH - 0.4), 90.0 * way + turn
    x = side * rng.uniform(ZEBRA_SIDE + 0.4, ZEBRA_SIDE + ZEBRA_DEPTH - 0.4)
    return x, rng.uniform(-3.6, 3.6), 90.0 * (1 - way) + turn


def _on_pavement(rng: np.random.Generator, walks_on: bool) -> tuple[float, float, float]:
    """Beside the main street, denser where the camera looks from near; walkers along it, the others any way."""
    side, way = (int(sign) for sign in rng.choice((-1, 1), 2))
    y = -30.0 + 150.0 * rng.random() ** 1.5
    if abs(y) < ZEBRA:
        y = math.copysign(ZEBRA + 4.0 * rng.random(), y)
    x = side * rng.uniform(7.3, 8.7)
    return x, y, 90.0 - 90.0 * way + rng.normal(0, 4) if walks_on else rng.uniform(0, 360)


def cyclist(draws: Draws) -> list[Placement]:
    """A cyclist ahead of the camera, at the kerb side of its lane: rider and bicycle are models of their own."""
    rng = draws.stream("cyclist")
    x, y = round(float(rng.uniform(2.5, 2.8)), 3), round(float(rng.uniform(-27.0, -18.5)), 3)
    heading = round(float(rng.normal(0, 1)), 1)
    outfit, colour = "ab"[int(rng.integers(2))], ("teal", "black", "red")[int(rng.integers(3))]
    return [
        standing("People", "Rider_1", "rider", (x, y, heading), {"outfit": outfit}),
        standing("Vehicles", "Bicycle_1", "bicycle", (x, y, heading), {"colour": colour}),
    ]

"""Vehicles in lanes and bays, and cyclists: one code for every road and junction.

A road or junction says where its lanes and bays are and how dense its traffic is; what drives or parks there is
drawn and placed here.  Numbers are drawn only as vehicles are asked for, so what a seed draws depends on the order in
which a caller asks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from synfog_usd.world import library
from synfog_usd.world.language import Draws, Recipe
from synfog_usd.world.library import LibraryModel
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.props import look
from synfog_usd.world.spec import Placement

Pose = tuple[float, float, float, float, float]
"""x, y, z [m], heading and pitch [degrees]."""
Vehicle = tuple[str, dict[str, str], float]
"""Model, looks, and the station of its middle [m]."""
TRIES_ALIKE, DENSER = 5, 1.3
"""Where traffic is too thin for the rules of sight it becomes denser by a factor, after every few tries.
"""
OWN_CAR_M = (4.5, 2.6)
"""Free lane behind and before the lens: the camera's own car."""
BRAKING_M, BRAKING = 30.0, 0.1
"""Before a zebra vehicles brake; so do some anywhere."""
ZEBRA_FREE_M = 3.6
APART_M = 0.15
CLOSE_M = (1.2, 2.5)
"""Between vehicles that wait nose to tail."""
CYCLIST_TRIES, CYCLIST_APART_M = 20, 0.4


def draw_car(
    recipe: Recipe, section: str, rng: np.random.Generator, among: Sequence[str] | None = None
) -> tuple[str, dict[str, str]]:
    """A vehicle and its paint, of what a section of the recipe chooses among."""
    body = recipe.distributions[f"{section}.bodies"].word(rng, among)
    paints = library.model(body).variants.get("paint", ())
    paint = recipe.distributions[f"{section}.paints"].word(rng, paints) if paints else ""
    return body, ({"paint": paint} if paint else {})


# -- how fast, how many, and where along a lane


def speed_m_s(draws: Draws) -> float:
    """Of traffic that neither waits nor brakes."""
    return float(draws.number("traffic.speed_kmh")) / 3.6


def slowed(speed_m_s: float, left_m: float, *, length: float) -> float:
    """Of a vehicle that brakes evenly from its lane's speed, `BRAKING_M` before where it stops, to nothing there.

    Args:
        speed_m_s: of its lane.
        left_m: from its middle to where its front stops.
        length: of it [m].
    """
    return speed_m_s * math.sqrt(min(max(left_m - length / 2, 0.0) / BRAKING_M, 1.0))


def flow(draws: Draws, attempt: int) -> tuple[float, float]:
    """Least distance between bumpers [m] and vehicles per length of lane [1/m], denser after tries that failed."""
    speed = speed_m_s(draws)
    density = draws.number("traffic.per_hour") / 3600.0 / speed * DENSER ** (attempt // TRIES_ALIKE)
    return 1.5 + speed * draws.number("traffic.headway_s"), density


def spans(road: Road, low: float, high: float, blocked: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Stretches of a lane between two stations that are free of zebras and of what is blocked."""
    cuts = sorted([*blocked, *((s - ZEBRA_FREE_M, s + ZEBRA_FREE_M) for s in road.zebras)])
    stretches, at = [], low
    for a, b in cuts:
        if a > at:
            stretches.append((at, min(a, high)))
        at = max(at, b)
    return [(a, b) for a, b in [*stretches, (at, high)] if b - a > 3.0]


def queue(
    rng: np.random.Generator, span: tuple[float, float], lengths: Sequence[float], least: float, *, close: int = 0
) -> Iterator[float]:
    """Middles of vehicles in a stretch of lane, in order, with at least `least` [m] between them.

    Uniform among all ways to stand there: gaps beyond the least are the spacings of
    uniform points, as in free traffic.  Vehicles that do not fit are left out.

    Args:
        rng: draws all slack first, and each gap between waiting vehicles when its vehicle is asked for.
        span: where the first bumper and the last may be [m].
        lengths: of the vehicles [m].
        least: between bumpers [m].
        close: so many wait nose to tail at the beginning.
    """
    lengths = list(lengths)
    while lengths and sum(lengths) + least * (len(lengths) - 1) > span[1] - span[0]:
        lengths.pop()
    spare = span[1] - span[0] - sum(lengths) - least * max(len(lengths) - 1, 0)
    slack = np.sort(rng.uniform(0.0, max(spare, 0.0), len(lengths)))
    at = span[0]  # where the next one may begin
    for index, (length, before) in enumerate(zip(lengths, slack, strict=True)):
        if index < close:
            gap = float(rng.uniform(*CLOSE_M))
            at += gap - least if index else 0.0
            before = 0.0
        yield float(at + before + length / 2)
        at += length + least


def flowing(
    recipe: Recipe,
    rng: np.random.Generator,
    free: Sequence[tuple[float, float]],
    count: int,
    least: float,
    among: Sequence[str] | None = None,
) -> Iterator[Vehicle]:
    """So many vehicles over the free stretches of a lane, by their length, no nearer to each other than `least` [m];
    of the models in `among`, or of any.
    """
    long = np.array([b - a for a, b in free])
    if not len(long):
        return
    share = rng.choice(len(free), count, p=long / long.sum())
    for number, span in enumerate(free):
        cars = [draw_car(recipe, "traffic", rng, among) for _ in range(int((share == number).sum()))]
        places = queue(rng, span, [library.model(body).length for body, _ in cars], least)
        for (body, looks), s in zip(cars, places, strict=False):
            yield body, looks, s


# -- into the lane


@dataclass(frozen=True)
class TrafficLane:
    """A lane that vehicles are put in.

    Attributes:
        pose: station and offset from its middle [m] -> where that is.
        across: (numbers, model) -> offsets to try, one after the other [m].
        brakes: (numbers, station) -> whether who is there brakes.
        fits: whether a vehicle keeps within it; what is straight needs no question.
        margin: room on all sides [m].
        speed_m_s: (station, length [m], whether it brakes) -> of a vehicle, or None where nothing says.
    """

    pose: Callable[[float, float], Pose]
    across: Callable[[np.random.Generator, LibraryModel], Iterator[float]]
    brakes: Callable[[np.random.Generator, float], bool] = lambda rng, s: False
    fits: Callable[[Placement], bool] = lambda p: True
    margin: float = APART_M
    speed_m_s: Callable[[float, float, bool], float | None] = lambda s, length, brakes: None


def offsets_in_lane(width: float) -> Callable[[np.random.Generator, LibraryModel], Iterator[float]]:
    """Offsets from the middle of a lane of a width [m]; who is narrow rides anywhere within it."""

    def across(rng: np.random.Generator, model: LibraryModel) -> Iterator[float]:
        narrow = model.group == "rider"
        most = min(0.9 if narrow else 0.2, max(0.0, (width - model.width) / 2 - 0.15))
        yield float(np.clip(rng.normal(0, 0.45 if narrow else 0.08), -most, most))

    return across


def fill(lane: TrafficLane, vehicles: Iterable[Vehicle], rng: np.random.Generator, room: rules.Room) -> list[Placement]:
    """Those vehicles that find room in a lane, lamps glowing or braking."""
    placed: list[Placement] = []
    for body, looks, s in vehicles:
        model = library.model(body)
        for aside in lane.across(rng, model):
            x, y, z, heading, pitch = lane.pose(s, aside)
            lit = "brake" if lane.brakes(rng, s) and "brake" in model.variants.get("lamps", ()) else "glow"
            speed = lane.speed_m_s(s, model.length, lit == "brake")
            p = Placement("Vehicles", "", body, x, y, heading, looks, {"lamps": lit}, z=z, pitch=pitch, speed_m_s=speed)
            if lane.fits(p) and room.take(p, lane.margin):
                placed.append(p)
                break
    return placed


def cyclist(
    rng: np.random.Generator, place: Callable[[np.random.Generator], Pose | None], room: rules.Room
) -> list[Placement]:
    """One cyclist at the first place that has room; `place` draws one, or None where that is none."""
    looks = look(rng, library.model("cyclist"))
    for _ in range(CYCLIST_TRIES):
        pose = place(rng)
        if pose is None:
            continue
        x, y, z, heading, pitch = pose
        p = Placement("Vehicles", "", "cyclist", x, y, heading, looks, z=z, pitch=pitch)
        if room.take(p, CYCLIST_APART_M):
            return [p]
    return []


# -- beside it


@dataclass(frozen=True)
class Bay:
    """Where one vehicle parks.

    Attributes:
        pose: offsets along and across the road from its middle [m] -> where that is, or None where nobody may stand.
        room_m: the longest vehicle that it takes [m].
        crosswise: whether vehicles stand across the road, most nose in.
    """

    pose: Callable[[float, float], Pose | None]
    room_m: float
    crosswise: bool = False


@dataclass(frozen=True)
class Care:
    """How exactly people park: deviation and most across the road [m], most along it [m], degrees of deviation."""

    across: float = 0.05
    most: float = 0.1
    along: float = 0.15
    turn: float = 0.5


def park(
    recipe: Recipe, bays: Iterable[tuple[Bay, np.random.Generator]], share: float, room: rules.Room, care: Care = Care()
) -> list[Placement]:
    """One vehicle to a bay, in a share of the bays; each bay has numbers of its own."""
    placed = []
    for bay, rng in bays:
        there = rng.random() < share
        body, looks = draw_car(recipe, "parked", rng)
        aside = float(np.clip(rng.normal(0, care.across), -care.most, care.most))
        along = float(rng.uniform(-care.along, care.along))
        nose_in = rng.random() < 0.7
        pose = bay.pose(along, aside) if there and library.model(body).length <= bay.room_m else None
        if pose is None:
            continue
        x, y, z, heading, pitch = pose
        if bay.crosswise:
            heading, pitch = heading + (-90.0 if nose_in else 90.0), 0.0
        turned = round(heading + float(rng.normal(0, care.turn)), 3)
        p = Placement("Vehicles", "", body, x, y, turned, looks, z=z, pitch=pitch, speed_m_s=0.0)
        if room.take(p):
            placed.append(p)
    return placed

"""A clip of a drawn street: where everything that moves is at each frame.

Takes a street in numbers and how fast its traffic goes; gives tracks, frame by frame.  Frame 0 is the street as it was
drawn.  Knows nothing of USD.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely

from synfog_usd.base.arrays import Array, Flags, Indices
from synfog_usd.base.errors import RecipeError
from synfog_usd.base.seeds import stream
from synfog_usd.world import library
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.props import look
from synfog_usd.world.roads.stage import KINDS
from synfog_usd.world.roads.traffic import OWN_CAR_M
from synfog_usd.world.spec import Placement, Site, WorldSpec
from synfog_usd.world.traffic import walk
from synfog_usd.world.traffic.changing import TAKES_S
from synfog_usd.world.traffic.follow import LOOK_S, STEP_S, Run, Street, Trip, Vehicle, drive, eased, near_routes
from synfog_usd.world.traffic.idm import Driver
from synfog_usd.world.traffic.paths import Route, crosswalks, footways, routes
from synfog_usd.world.traffic.signals import MAIN, SIDE, Programme, programme
from synfog_usd.world.traffic.suspension import lean

OWN_WIDTH_M = 1.9
PEDALS_M_S = (3.8, 5.2)
"""Speed of cyclists."""
LIGHT, HEAVY = (0.95, 1.2), (0.75, 0.85)
"""Speed over the recipe's that drivers of cars, and of lorries and buses, wish for where lanes can be changed."""
SLOWS = 0.75
"""Who brakes where nothing asks for it goes on at this share of the speed."""
BESIDE_LANE_M, RIDES_M = 0.3, 1.0
"""By which a vehicle, or who rides, may be off the lane that it is in."""
TURNED = math.radians(40.0)
BRAKES_M_S2, STANDS_M_S = -0.6, 0.1
"""Brake lights are on below this acceleration, and go on when one stops."""
BLINKS_HZ = 1.5
LONG_M, WIDE_M = 6.5, 20.0
"""Vehicles longer than this take bends of less than this radius only where they have to."""
TOO_FAST = 1.5
"""Over the speed at which a bend ahead is approached: who is faster takes another way."""
FASTEST, LEAD_M = 1.3, 40.0
"""Speed over the recipe's of the fastest, and way beyond what they go in a clip, for the lanes' ways outside."""
LEAST_SPAN_M, APART_M, MOST_INCOMING = 200.0, 4.0, 100
"""Length of lane in which traffic was drawn, at least; between incoming vehicles, beyond their headway; of them."""
RIDDEN = ("cyclist", "bicycle", "motorcyclist")
PASSED = ("Ground", "Buildings")
"""What nobody has to go round: eaves of houses hang over the pavement."""
LEAN_STEP_S = 0.02
OUTLINE_M = 0.5
"""Between points of an outline, at most."""


@dataclass(frozen=True)
class Pace:
    """How traffic goes.

    Attributes:
        speed_m_s: of who neither waits nor brakes.
        headway_s: least time between bumpers.
        seed: of routes, and of how people walk.
    """

    speed_m_s: float
    headway_s: float
    seed: int


@dataclass(frozen=True)
class Track:
    """Where one thing is: (F,) by frames.

    Attributes:
        x, y, z: of its origin [m].
        heading, pitch, roll: degrees as a `Placement` has them, headings without jumps of a turn.
        speed: [m/s]; travel: way since frame 0 [m]; bend: of its path [1/m], positive to the left.
        brakes: whether brake lights are on; blinks: 1 where the left indicator is lit, -1 the right one, 0 neither.
        shown: whether it is within the drawn road.
    """

    x: Array
    y: Array
    z: Array
    heading: Array
    pitch: Array
    roll: Array
    speed: Array
    travel: Array
    bend: Array
    brakes: Flags
    blinks: Indices
    shown: Flags

    @property
    def moves(self) -> bool:
        """Whether it is anywhere else than at frame 0."""
        return bool(np.abs(self.travel).max() > 1e-4)


@dataclass(frozen=True)
class Clip:
    """A street over time.

    Attributes:
        fps: frames a second.
        codes: (F,) frames, from -1 to one behind the last: so that shutters open before the first and close after it.
        tracks: what moves, and who waits on foot, by its number in `WorldSpec.placed`.
        ego: the lens.
        signals: of each signal that changes, by its number in `WorldSpec.placed`: (F,) whether each lens is lit.
    """

    fps: float
    codes: Array
    tracks: Mapping[int, Track]
    ego: Track
    signals: Mapping[int, Mapping[str, Flags]] = field(default_factory=dict)


def clip_of(spec: WorldSpec, pace: Pace, *, frames: int, fps: float) -> tuple[WorldSpec, Clip]:
    """Let a street go on for some frames.

    Args:
        spec: the street at frame 0.
        pace: of its traffic.
        frames: how many, from 0.
        fps: of them a second.

    Returns:
        the street with those who come in during the clip, and its clip.

    Raises:
        RecipeError: the camera's car would leave the drawn road.
    """
    codes = np.arange(-1.0, frames + 1.0)
    t = codes / fps
    ways = [way.led(FASTEST * pace.speed_m_s * float(t[-1]) + LEAD_M) for way in routes(spec.road)]
    who, vehicles = _vehicles(spec, ways, pace)
    walkers = _walkers(spec)
    count = len(spec.placed)
    spec, coming = _incoming(spec, ways, who, vehicles, pace, float(t[-1]))
    who, vehicles = [*who, *range(count, len(spec.placed))], [*vehicles, *coming]
    steps = np.arange(0.0, t[-1] + LOOK_S + 2 * STEP_S, STEP_S)
    move = {*walkers, *who, *(rider for rider, _ in _ridden(spec))}
    still = (p for i, p in enumerate(spec.placed) if i not in move and p.group not in PASSED)
    fixed = [rules.footprint(p) for p in still]
    phases = _programme(spec, pace.seed)
    openings = [
        walk.Opening(way.begin, way.end, phases.walks(way.street, float(steps[-1]))) for way in crosswalks(spec.road)
    ]
    obstacles = [*fixed, *_posts(spec)]
    places = walk.plan(list(walkers.values()), footways(spec.road), obstacles, steps, pace.seed, openings)
    outline = shapely.get_coordinates([shapely.segmentize(shapely.Polygon(corners), OUTLINE_M) for corners in fixed])
    driven = {vehicle.route for vehicle in vehicles}
    still_at = near_routes(ways, driven | {number for number, route in enumerate(ways) if _reached(route)}, outline)
    vehicles = [
        replace(car, until=eased(ways[car.route].path, car, still_at[car.route], car.v0 * float(t[-1]) + 10.0))
        for car in vehicles
    ]
    stops = np.stack([~phases.lit(street, steps)["green"] for street in (MAIN, SIDE)], axis=1)
    street = Street(ways, vehicles, places[..., :2], still_at, Driver(pace.headway_s, 1.5), stops)
    run = drive(street, float(t[-1]) + STEP_S)
    tracks: dict[int, Track] = {}
    for number, index in enumerate(who):
        tracks[index] = _driven(spec, street, run, number, t, index)
    for column, index in enumerate(walkers):
        tracks[index] = _walked(spec, places[:, column], steps, t, spec.placed[index])
    ego = tracks.pop(-1)
    if not ego.shown.all():
        raise RecipeError(
            f"--seconds {frames / fps:g}: the camera's car leaves the drawn road at frame "
            f"{int(codes[np.argmin(ego.shown)])}; ask for fewer, or raise road.length_m or arms.length_m"
        )
    for index, bicycle in _ridden(spec):
        if bicycle in tracks:
            tracks[index] = tracks[bicycle]
    moving = {i: track for i, track in tracks.items() if (track.moves or i in walkers) and track.shown.any()}
    spec, moving = _shown(spec, count, moving)
    return spec, Clip(fps, codes, moving, ego, _signals(spec, phases, t))


def _shown(spec: WorldSpec, count: int, tracks: Mapping[int, Track]) -> tuple[WorldSpec, dict[int, Track]]:
    """A street without those behind the first `count` who have no track, and the tracks by its numbers."""
    numbers = [index for index in range(len(spec.placed)) if index < count or index in tracks]
    placed = tuple(spec.placed[index] for index in numbers)
    return replace(spec, placed=placed), {k: tracks[index] for k, index in enumerate(numbers) if index in tracks}


# -- who there is


def _signal_street(p: Placement) -> int:
    """The street whose traffic a signal of the crossing is for."""
    return MAIN if abs(p.x) < abs(p.y) else SIDE


def _programme(spec: WorldSpec, seed: int) -> Programme:
    """The cycle of the signals, which begins as they were drawn; without signals it stops nobody."""
    green = {_signal_street(p) for p in spec.placed if p.variants.get("signal") == "green"}
    return programme(SIDE if SIDE in green else MAIN, seed)


def _signals(spec: WorldSpec, phases: Programme, t: Array) -> dict[int, Mapping[str, Flags]]:
    """What each signal shows at times [s], where that changes."""
    signals = [i for i, p in enumerate(spec.placed) if "signal" in p.variants]
    lit = {i: phases.lit(_signal_street(spec.placed[i]), t) for i in signals}
    return {i: lenses for i, lenses in lit.items() if any(on.any() and not on.all() for on in lenses.values())}


def _vehicles(spec: WorldSpec, ways: Sequence[Route], pace: Pace) -> tuple[list[int], list[Vehicle]]:
    """Numbers of who is in a lane, -1 of the camera's car, and how each begins."""
    view = spec.view
    behind, before = OWN_CAR_M
    rng = stream(pace.seed, "traffic", "route", "ego")
    ego_lane = _in_lane(ways, (view.x, view.y, view.heading - view.yaw), 0.5, np.inf, pace.speed_m_s, rng)
    if ego_lane is None:
        raise RecipeError("the camera is in no lane, so that nothing can be put in motion around it")
    result = [
        Vehicle(*ego_lane, before, behind, OWN_WIDTH_M, pace.speed_m_s, pace.speed_m_s, takes=rng.uniform(*TAKES_S))
    ]
    who = [-1]
    ridden = {bicycle for _, bicycle in _ridden(spec)}
    for index, p in enumerate(spec.placed):
        model = library.model(p.asset)
        if p.group != "Vehicles" or (model.label == "bicycle" and index not in ridden):
            continue
        rng = stream(pace.seed, "traffic", "route", p.name)
        rides = model.label in ("rider", "bicycle", "motorcycle")
        most_m, length = (RIDES_M, np.inf) if rides else (BESIDE_LANE_M, model.length)
        speed = pace.speed_m_s if p.speed_m_s is None else p.speed_m_s
        lane = _in_lane(ways, (p.x, p.y, p.heading), most_m, length, speed, rng)
        if lane is None:
            continue
        pedals = p.asset in ("cyclist", "bicycle")
        speed = float(rng.uniform(*PEDALS_M_S)) if pedals else pace.speed_m_s
        v = speed if p.speed_m_s is None else p.speed_m_s
        v0 = speed * (SLOWS if p.lit.get("lamps") == "brake" and p.speed_m_s is None else 1.0)
        if _reached(ways[lane[0]]):
            v0 *= float(rng.uniform(*(HEAVY if model.label in ("truck", "bus") else LIGHT)))
        x0, y0, x1, y1 = rules.foot(p.asset)
        takes = float(rng.uniform(*TAKES_S))
        result.append(Vehicle(*lane, y1, -y0, x1 - x0, v, max(v0, 1.0), takes=takes))
        who.append(index)
    return who, result


def _reached(route: Route) -> bool:
    """Whether others may change to it."""
    return route.left >= 0 or route.right >= 0


def _in_lane(
    ways: Sequence[Route],
    place: tuple[float, float, float],
    most_m: float,
    length: float,
    v: float,
    rng: np.random.Generator,
) -> tuple[int, float, float, float] | None:
    """Route, station, offset [m] and turn [rad] of who is at a place, drawn among routes that begin there.

    Args:
        ways: all routes.
        place: x, y [m] and heading [degrees].
        most_m: by which who is in a lane may be beside it.
        length: of the vehicle [m]; long ones take no tight bend where there is another way.
        v: speed [m/s]; who is too fast for a bend goes straight on where there is another way.
        rng: draws the route.
    """
    x, y, heading = place
    result = []
    for number, route in enumerate(ways):
        s, aside = (float(v) for v in route.path.nearest(np.array([x, y])))
        turn = math.remainder(math.radians(heading) - float(route.path.at(s)[2]), 2 * math.pi)
        if abs(aside) < route.path.width / 2 + most_m and abs(turn) < TURNED:
            result.append((number, s, aside, turn))
    if not result:
        return None
    least = min(abs(aside) for _, _, aside, _ in result)
    candidates = [vehicle for vehicle in result if abs(vehicle[2]) < least + 0.3]
    return candidates[_drawn(rng, [(ways[number], s) for number, s, _, _ in candidates], length, v)]


def _drawn(rng: np.random.Generator, ways: Sequence[tuple[Route, float]], length: float, v: float) -> int:
    """Number of the one among routes from stations that a vehicle of a length [m] and speed [m/s] takes."""
    easy = [
        (length < LONG_M or route.tight > WIDE_M) and v < TOO_FAST * np.interp(s, route.path.s, route.path.limit)
        for route, s in ways
    ]
    share = np.array([route.share * (fits or not any(easy)) for (route, _), fits in zip(ways, easy, strict=True)])
    return int(rng.choice(len(ways), p=share / share.sum()))


def _incoming(
    spec: WorldSpec, ways: Sequence[Route], who: Sequence[int], vehicles: Sequence[Vehicle], pace: Pace, seconds: float
) -> tuple[WorldSpec, list[Vehicle]]:
    """The street with vehicles that come in at the ends of its lanes, as dense as those that were drawn, and how these
    begin: on the way there.  None comes behind the camera where nobody can overtake it.
    """
    models = [
        spec.placed[index].asset
        for index, vehicle in zip(who, vehicles, strict=True)
        if index >= 0 and ways[vehicle.route].kind == "lane" and spec.placed[index].asset not in RIDDEN
    ]
    entries: dict[tuple[float, ...], list[int]] = {}
    for number, way in enumerate(ways):
        if way.kind == "lane":
            entries.setdefault(tuple(np.round(way.path.points[0], 3).tolist()), []).append(number)
    stations = [[vehicle.s for vehicle in vehicles if vehicle.route == number] for number in range(len(ways))]
    span = max(LEAST_SPAN_M, *(float(np.ptp(of_way)) for of_way in stations if of_way))
    per_s = len(models) / len(entries) / span * pace.speed_m_s
    placed, coming = list(spec.placed), list[Vehicle]()
    for entry, numbers in enumerate(entries.values()):
        if not models or (vehicles[0].route in numbers and not _reached(ways[numbers[0]])):
            continue
        rng, at = stream(pace.seed, "traffic", "incoming", entry), 0.0
        while (at := at + float(rng.exponential(1.0 / per_s))) < seconds and len(coming) < MOST_INCOMING:
            model = library.model(models[int(rng.integers(len(models)))])
            heavy = model.label in ("truck", "bus")
            v = pace.speed_m_s * (
                float(rng.uniform(*(HEAVY if heavy else LIGHT))) if _reached(ways[numbers[0]]) else 1.0
            )
            x0, y0, x1, y1 = rules.foot(model.name)
            number = numbers[_drawn(rng, [(ways[k], 0.0) for k in numbers], model.length, v)]
            s = ways[number].begins - v * at - y1
            takes = float(rng.uniform(*TAKES_S))
            coming.append(Vehicle(number, s, 0.0, 0.0, y1, -y0, x1 - x0, v, v, takes=takes))
            x, y, h = (np.array([float(value)]) for value in ways[number].path.at(s))
            pitch, roll = slopes(spec.road, x, y, h)
            plates = model.variants.get("plate", ())
            looks = look(rng, model) | ({"plate": plates[int(rng.integers(len(plates)))]} if plates else {})
            lit = {"lamps": "glow"} if "glow" in model.variants.get("lamps", ()) else {}
            placed.append(
                Placement(
                    "Vehicles", f"{model.name.title()}_In_{len(coming):02d}", model.name, float(x[0]), float(y[0]),
                    math.degrees(float(h[0])), looks, lit, z=float(ground(spec.road, x, y)[0]), pitch=float(pitch[0]),
                    roll=float(roll[0]), speed_m_s=v,
                )
            )  # fmt: skip
            at += pace.headway_s + (y1 - y0 + APART_M) / v
    return replace(spec, placed=tuple(placed)), coming


def _ridden(spec: WorldSpec) -> list[tuple[int, int]]:
    """Numbers of each rider and of the bicycle below, where these are two."""
    bicycles = {(p.x, p.y): i for i, p in enumerate(spec.placed) if p.asset == "bicycle"}
    return [(i, bicycles[p.x, p.y]) for i, p in enumerate(spec.placed) if p.asset == "rider" and (p.x, p.y) in bicycles]


def _walkers(spec: WorldSpec) -> dict[int, walk.Walker]:
    return {
        i: walk.Walker(p.name, p.x, p.y, math.radians(p.heading), rules.foot(p.asset), walk.SPEED_M_S[p.asset])
        for i, p in enumerate(spec.placed)
        if p.group == "People" and p.asset in walk.SPEED_M_S
    }


def _posts(spec: WorldSpec) -> list[Array]:
    """Outlines of what stands in numbers without being placed one by one: bollards."""
    return [
        rules.footprint(Placement("", "", "bollard", *point[:2]))
        for many in KINDS[type(spec.road)].instanced(spec, spec.road)
        if many.asset == "bollard"
        for point in many.points
    ]


# -- where they are


def ground(site: Site, x: Array, y: Array) -> Array:
    """Height of the ground [m] at places."""
    return np.asarray(site.height(x, y), dtype=np.float64)


def slopes(site: Site, x: Array, y: Array, heading: Array) -> tuple[Array, Array]:
    """Pitch and roll [degrees] of what stands at places and looks to headings [rad], over a metre each way."""
    angles = []
    for right, ahead in ((0.0, 0.5), (0.5, 0.0)):
        dx, dy = right * np.cos(heading) - ahead * np.sin(heading), right * np.sin(heading) + ahead * np.cos(heading)
        angles.append(np.degrees(np.arctan(ground(site, x + dx, y + dy) - ground(site, x - dx, y - dy))))
    return angles[0], -angles[1]


def _driven(spec: WorldSpec, street: Street, run: Run, number: int, t: Array, index: int) -> Track:
    """The track of a vehicle, or with index -1 of the lens in its car; it begins exactly where it was drawn."""
    trip = street.trip(run, number, t)
    x, y = trip.x, trip.y
    z = ground(spec.road, x, y)
    pitch, roll = slopes(spec.road, x, y, trip.heading)
    heading = np.degrees(np.unwrap(trip.heading))
    if index < 0:
        first = spec.view.x, spec.view.y, spec.view.z, spec.view.heading - spec.view.yaw, 0.0, 0.0
        dive, roll = _leaning(street, run, number, t)
        pitch = pitch + dive
    else:
        p = spec.placed[index]
        first = p.x, p.y, p.z, p.heading, p.pitch, p.roll
        if library.model(p.asset).label in ("rider", "bicycle", "motorcycle"):
            roll = roll * 0.0
    x, y, z, heading, pitch, roll = (
        column + (initial - column[1]) for column, initial in zip((x, y, z, heading, pitch, roll), first, strict=True)
    )
    travel = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]  # not along the middle of the lane
    braked = index >= 0 and spec.placed[index].lit.get("lamps") == "brake"
    return Track(
        x=x, y=y, z=z, heading=heading, pitch=pitch, roll=roll,
        speed=np.gradient(travel, t),
        travel=travel - travel[1],
        bend=trip.bend,
        brakes=_brake_lights(trip, braked),
        blinks=np.where((t * BLINKS_HZ) % 1.0 >= 0.5, trip.blinks, 0),
        shown=trip.inside,
    )  # fmt: skip


def _leaning(street: Street, run: Run, number: int, t: Array) -> tuple[Array, Array]:
    """Pitch and roll of a vehicle on its springs at times [degrees]."""
    fine = np.arange(0.0, max(float(t[-1]), 0.1) + LEAN_STEP_S, LEAN_STEP_S)
    trip = street.trip(run, number, fine)
    turning = np.gradient(np.unwrap(trip.heading), fine)
    pitch, roll = lean(fine, trip.a, trip.v * turning)
    return np.interp(t, fine, pitch), np.interp(t, fine, roll)


def _brake_lights(trip: Trip, on: bool) -> Flags:
    """Frame by frame whether they are on: while somebody brakes, and while they stand after that."""
    result = []
    for frame in range(len(trip.v)):
        if frame > 1:
            stands, waited = (trip.v[k] < STANDS_M_S for k in (frame, frame - 1))
            on = bool(trip.a[frame] < BRAKES_M_S2 or (stands and (on or not waited)))
        result.append(on)
    return np.array(result)


def _walked(spec: WorldSpec, places: Array, steps: Array, t: Array, p: Placement) -> Track:
    """The track of one who walks; on kerbs the feet go up and down over half a metre."""
    before = places[:1] - (places[1:2] - places[:1]) * (-t[0] / STEP_S)
    rows, at = np.concatenate([before, places]), np.r_[t[0], steps]
    x, y, heading, _ = (np.interp(t, at, column) for column in rows.T)
    dx, dy = -np.sin(heading), np.cos(heading)
    z = np.mean([ground(spec.road, x + d * dx, y + d * dy) for d in (-0.25, -0.12, 0.0, 0.12, 0.25)], axis=0)
    heading = np.degrees(heading)
    travel = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]  # not along the middle of the pavement
    travel = travel - travel[1]
    none = np.zeros(len(t))
    speed = np.gradient(travel, t)
    x, y, z, heading = (
        column + (initial - column[1])
        for column, initial in zip((x, y, z, heading), (p.x, p.y, p.z, p.heading), strict=True)
    )
    return Track(
        x=x, y=y, z=z, heading=heading, pitch=none, roll=none, speed=speed, travel=travel, bend=none,
        brakes=none > 0, blinks=none.astype(np.int64), shown=none == 0,
    )  # fmt: skip

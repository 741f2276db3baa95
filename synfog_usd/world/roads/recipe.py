"""Draws of roads.

A recipe gives the reference line, the lane section, rows of things along it, traffic,
people, sky and camera.  What stands where obeys the rules of `rules`; a draw that cannot is
tried again, so often, before the rule is named.  What a recipe can say stands in `world.parameters`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from synfog_usd.base.errors import RecipeError
from synfog_usd.base.seeds import seed32
from synfog_usd.world import library
from synfog_usd.world.authoring import focal_length
from synfog_usd.world.language import Draws
from synfog_usd.world.library import nominal
from synfog_usd.world.roads import actors, road_actors, road_props, rules, works
from synfog_usd.world.roads.asphalt import Asphalt
from synfog_usd.world.roads.lane_section import Lane, LaneSection
from synfog_usd.world.roads.network import Land, Road
from synfog_usd.world.roads.props import numbered
from synfog_usd.world.roads.reference_line import ReferenceLine, bends
from synfog_usd.world.skies import OVERCAST
from synfog_usd.world.spec import Placement, RigCamera, SkyDome, View, WorldSpec, falls

NEAREST_LIT, NEAREST_LAMPS = 6, 8
"""Vehicles and street lamps that are lights at dusk; those beyond glow.  Each light costs noise in every pixel."""
LIT_M = 110.0
LOW_M = 60.0
TOGETHER_M = 4.0
"""People so near each other are seen together."""
SURROUND = (
    ("Front_Left", -0.48, -0.18, 55.0, 70.0),
    ("Front_Right", 0.50, -0.15, -55.0, 70.0),
    ("Back_Left", -0.47, -0.67, 110.0, 70.0),
    ("Back_Right", 0.50, -0.69, -110.0, 70.0),
    ("Back", 0.0, -1.67, 180.0, 110.0),
)
"""Cameras beside the front one: right and ahead of it [m], degrees to the left, width of view [degrees].  Source: rig
of nuScenes (Caesar et al. 2020).
"""


def draw(draws: Draws) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: a rule cannot be met; says which.
    """
    station = round(draws.number("camera.station_m"), 2)
    road, built = _road(draws, station)
    if station + 60.0 > road.reference_line.length:
        raise RecipeError(
            f"{draws.recipe.name}: camera.station_m {station:g} leaves less than 60 m of the road's "
            f"{road.reference_line.length:g} m ahead"
        )
    ego_lane = _ego_lane(draws, road)
    fov_x_deg = draws.number("camera.fov_x_deg")
    view = _view(road, ego_lane, station, draws.number("camera.height_m"), fov_x_deg)
    occupied = rules.CollisionSet()
    digging, workers = works.site(road, draws, station, occupied)
    rows = road_props.rows(draws, road, station, occupied)
    fixed = [*workers, *road_props.unhidden(road, rows, built["gantries"])]
    fixed += road_actors.parked(draws, road, station, occupied)

    def attempt_of(attempt: int, room: rules.CollisionSet) -> list[Placement]:
        return road_actors.moving(draws, road, attempt, ego_lane, station, room)

    moving = actors.in_sight(draws, attempt_of, road, view, fov_x_deg, fixed, occupied)
    laid = _laid(road, round(draws.number("road.crossfall"), 4), view, [*fixed, *moving])
    return assembled(draws, *laid, {**built, "station": station, "works": digging})


def _laid(level: Road, crossfall: float, view: View, placed: Sequence[Placement]) -> tuple[Road, View, list[Placement]]:
    """What was drawn for a road level across, with a crossfall: lower beside the crown, and vehicles of four wheels
    and more as they stand on the slopes below them.
    """
    road = replace(level, crossfall=crossfall)
    standing: list[View | Placement] = [view, *placed]
    x, y, heading = np.array([(p.x, p.y, math.radians(p.heading)) for p in standing]).T
    drop = road.height(x, y) - level.height(x, y)
    slopes = []
    for right, ahead in ((0.5, 0.0), (0.0, 0.5)):  # over a metre
        dx, dy = right * np.cos(heading) - ahead * np.sin(heading), right * np.sin(heading) + ahead * np.cos(heading)
        slopes.append(road.height(x + dx, y + dy) - road.height(x - dx, y - dy))
    roll, pitch = np.round(np.degrees(np.arctan(slopes)), 3) * [[-1.0], [1.0]] + 0.0
    result = []
    for i, p in enumerate(placed, 1):
        p = replace(p, z=round(p.z + float(drop[i]), 4))
        if p.group == "Vehicles" and library.model(p.asset).group != "rider":
            p = replace(p, pitch=float(pitch[i]), roll=float(roll[i]))
        result.append(p)
    return road, replace(view, z=round(view.z + float(drop[0]), 3)), result


def assembled(
    draws: Draws, road: Road, view: View, placements: Sequence[Placement], built: Mapping[str, Any]
) -> WorldSpec:
    """The world of a road and what stands at it, with sky, fog and the lamps that are lights."""
    heading, gain = round(draws.number("sky.heading_deg"), 1), round(draws.number("sky.gain"), 3)
    placed = plated(numbered([_coarser(p, view) for p in _lit(placements, view)]), draws.stream("plates"))
    placed = signed(posed(placed, draws.stream("individuals")), view, draws.stream("shops"))
    fogs = draws.recipe.fog_variants(draws.seed)
    day, dusk = skies_of(draws, fogs)
    return WorldSpec(
        about=f"{draws.recipe.about} Drawn from {draws.recipe.name} with seed {draws.seed}.",
        placed=tuple(placed),
        view=view,
        fog=fogs,
        fog_selected=selected(fogs),
        day=SkyDome(day, gain, heading),
        dusk=SkyDome(dusk, gain, heading),
        scatter=seed32(draws.seed, "recipe", "scatter"),
        origin={"recipe": draws.recipe.name, "seed": str(draws.seed)},
        road=road,
        rig=_rig(draws.word("camera.rig"), round(draws.number("camera.baseline_m"), 4), view),
        built={
            **built,
            "trees": draws.whole("land.trees"),
            "trees_from_m": draws.number("land.trees_from_m"),
            "grass": draws.word("land.grass"),
            "horizon": draws.word("land.horizon"),
            "headlights": draws.word("camera.headlights"),
            "asphalt": Asphalt(
                draws.word("road.asphalt"), "wet" if day == "rain" and not falls(fogs) else draws.word("road.wet")
            ),
        },
    )


def skies_of(draws: Draws, fogs: Mapping[str, float | str | None]) -> tuple[str, str]:
    """Skies by day and at dusk: where rain or snow falls in one of the fogs, overcast ones if the recipe has any."""

    def sky(time: str) -> str:
        offered = draws.recipe.distributions[f"sky.{time}"].values
        return draws.word(f"sky.{time}", OVERCAST[time] if falls(fogs) and set(offered) & set(OVERCAST[time]) else None)

    return sky("day"), sky("dusk")


def selected(fogs: Mapping[str, float | str | None]) -> str:
    """The variant of the fog that an opened stage shows, whose dry road others that it has no variant for have too."""
    dry = [name for name in fogs if name not in falls(fogs)]
    return dry[len(dry) // 2] if len(dry) > 1 else next(iter(falls(fogs)), dry[0])


def plated(placed: Sequence[Placement], rng: np.random.Generator) -> list[Placement]:
    """With a number plate for each vehicle that has one."""
    result = []
    for p in placed:
        choices = library.model(p.asset).variants.get("plate", ())
        if choices:
            p = replace(p, variants={**p.variants, "plate": choices[int(rng.integers(len(choices)))]})
        result.append(p)
    return result


def signed(placed: Sequence[Placement], view: View, rng: np.random.Generator) -> list[Placement]:
    """With names over the shops of each house that has some: no name twice while there are others, beginning with the
    house nearest the camera.
    """
    shown: set[tuple[str, int]] = set()
    result = list(placed)
    for p in sorted(placed, key=lambda p: math.hypot(p.x - view.x, p.y - view.y)):
        choices = library.model(p.asset).variants.get("shops", ())
        if choices:
            rows = nominal().get(p.asset, {}).get("shops", ())
            order = [choices[i] for i in rng.permutation(len(choices))]
            unused = [names for names in order if shown.isdisjoint((names, row) for row in rows)]
            chosen = (unused or order)[0]
            shown.update((chosen, row) for row in rows)
            result[placed.index(p)] = replace(p, variants={**p.variants, "shops": chosen})
    return result


def posed(placed: Sequence[Placement], rng: np.random.Generator) -> list[Placement]:
    """With one of several individuals for each person: no two of a kind who come one after the other are the same.  Of
    those who stand within `TOGETHER_M` no two are at one moment of the step while there are others, and no two of a
    kind wear the same.
    """
    result: list[Placement] = []
    people: list[Placement] = []
    last: dict[str, str] = {}
    for p in placed:
        model = library.model(p.asset)
        choices = model.variants.get("individual", ()) if model.group == "person" else ()
        if choices:
            near = [q for q in people if math.hypot(p.x - q.x, p.y - q.y) < TOGETHER_M]
            free = _unlike([name for name in choices if name != last.get(p.asset)], near, "individual")
            last[p.asset] = free[int(rng.integers(len(free)))]
            worn = {**p.variants, "individual": last[p.asset]}
            twins = [q for q in near if q.asset == p.asset]
            if "outfit" in worn and any(q.variants["outfit"] == worn["outfit"] for q in twins):
                clothes = _unlike(model.variants["outfit"], twins, "outfit")
                worn["outfit"] = clothes[int(rng.integers(len(clothes)))]
            p = replace(p, variants=worn)
            people.append(p)
        result.append(p)
    return result


def _unlike(choices: Sequence[str], placed: Sequence[Placement], variant_set: str) -> Sequence[str]:
    """Choices that none of some placements has; all of them where nothing would be left."""
    return [name for name in choices if all(q.variants[variant_set] != name for q in placed)] or choices


def _rig(kind: str, baseline_m: float, view: View) -> tuple[RigCamera, ...]:
    """Cameras beside the ego's: the right eye, or five that look to the sides and back."""
    if kind == "stereo":
        return (RigCamera("Right", baseline_m, 0.0, 0.0, view.focal_length),)
    if kind == "surround":
        return tuple(RigCamera(name, right, ahead, yaw, focal_length(fov)) for name, right, ahead, yaw, fov in SURROUND)
    return ()


def _road(draws: Draws, station: float) -> tuple[Road, dict[str, Any]]:
    """The road, and what is built at it."""
    length = round(draws.number("road.length_m"), 1)
    widths = tuple(
        (kind, round(float(width.number(draws.stream("section", i))), 3), way)
        for i, (kind, width, way) in enumerate(draws.recipe.lanes)
    )
    gantries: list[float] = []
    first_gantry = draws.optional("rails.gantry_ahead_m")
    if first_gantry is not None:
        first = station + first_gantry
        gantries = [round(s, 2) for s in (first, first + 160.0) if s < length - 20.0]
    zebras, at = [], station
    for i in range(draws.whole("road.zebras")):
        at += float(draws.number("road.zebra_ahead_m", i))
        zebras.append(round(at, 2))
    road = Road(
        _reference_line(draws, station, length),
        LaneSection.from_widths(widths),
        _land(draws, station, length),
        tuple(s for s in zebras if s < length - 10.0),
        draws.word("road.centre"),
        (draws.number("road.dash_m"), draws.number("road.dash_gap_m")),
    )
    rails, delineators = draws.word("rails.where"), draws.word("rails.delineators")
    return road, {"rails": rails, "delineators": delineators, "gantries": gantries}


def _reference_line(draws: Draws, station: float, length: float) -> ReferenceLine:
    """Bends, of which the first lies ahead of the camera, and slopes, which begin before it."""
    pieces = []
    for i in range(40):
        straight, radius, turn = (
            float(draws.number(f"road.{key}", i)) for key in ("straight_m", "radius_m", "turn_deg")
        )
        pieces.append((straight, radius, turn))
    pieces[0] = (pieces[0][0] + station * 0.6, *pieces[0][1:])
    slopes = [(0.0, 0.0), (0.75 * station, 0.0)]
    every = draws.number("road.slope_every_m")
    while slopes[-1][0] < length:
        slope = round(float(draws.number("road.slope", len(slopes) - 2)), 6)
        slopes.append((round(slopes[-1][0] + every, 3), slope))
    flat = all(grade == 0.0 for _, grade in slopes)
    return ReferenceLine(length, bends(pieces, length=length), ((0.0, 0.0),) if flat else tuple(slopes))


def _land(draws: Draws, station: float, length: float) -> Land:
    """Hills, ditches, and the valley or hill that a bridge or tunnel needs."""
    valley = hill = None
    if draws.number("bridge.length_m"):
        begin = station + draws.number("bridge.ahead_m")
        end = min(begin + draws.number("bridge.length_m"), length - 10.0)
        valley = (round(begin, 2), round(end, 2), round(draws.number("bridge.depth_m"), 2))
    portal = draws.optional("tunnel.ahead_m")
    if portal is not None:
        hill = (round(station + portal, 2), round(draws.number("tunnel.height_m"), 2))
    seed, ditch_m = seed32(draws.seed, "recipe", "land"), round(draws.number("road.ditch_m"), 3)
    return Land(round(draws.number("land.hills_m"), 2), seed, valley, hill, ditch_m)


def _ego_lane(draws: Draws, road: Road) -> Lane:
    number = draws.whole("camera.lane")
    lanes = [lane for lane in road.driving_lanes if lane.way > 0 and lane.kind == "lane"]
    if number >= len(lanes):
        raise RecipeError(
            f"{draws.recipe.name}: camera.lane {number}: the road has {len(lanes)} lanes that go its way; lanes count "
            f"from 0 at the right"
        )
    return lanes[-1 - number]


def _view(road: Road, lane: Lane, station: float, height_m: float, fov_x_deg: float) -> View:
    t = lane.middle - 0.15
    x, y = road.reference_line.place(station, t)
    heading = math.degrees(float(road.reference_line.heading(station)))
    pitch = math.degrees(math.atan(float(road.reference_line.grade(station))))
    z = float(road.ground(station, t)) + height_m
    return View(
        round(float(x), 3),
        round(float(y), 3),
        round(z, 3),
        round(90.6 + pitch, 3),
        round(heading + 0.8, 3),
        focal_length(fov_x_deg),
    )


def _lit(placed: Sequence[Placement], view: View) -> list[Placement]:
    """Which lamps are lights at dusk: the nearest of vehicles and of street lamps."""

    def distance(p: Placement) -> float:
        return math.hypot(p.x - view.x, p.y - view.y)

    lamps = sorted((p for p in placed if library.model(p.asset).group == "lamp"), key=distance)
    cars = sorted((p for p in placed if p.lit), key=distance)
    near = {id(p) for p in [*lamps[:NEAREST_LAMPS], *cars[:NEAREST_LIT]] if distance(p) < LIT_M}
    result = []
    for p in placed:
        choices = library.model(p.asset).variants.get("lamps", ())
        if (library.model(p.asset).group == "lamp" or p.lit) and choices:
            state = "brake" if p.lit.get("lamps") == "brake" else "on"
            p = replace(p, lit={"lamps": state if id(p) in near or "glow" not in choices else "glow"})
        elif p.lit:
            p = replace(p, lit={})
        result.append(p)
    return result


def _coarser(p: Placement, view: View) -> Placement:
    """With the coarse geometry of its model, where it has one and is far: 2 cm are half a pixel at LOW_M."""
    if "low" not in library.model(p.asset).variants.get("lod", ()) or math.hypot(p.x - view.x, p.y - view.y) < LOW_M:
        return p
    return replace(p, variants={**p.variants, "lod": "low"})

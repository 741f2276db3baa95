"""Draws of roads.

A recipe gives the reference line, the lane section, rows of things along it, traffic,
people, sky and camera.  Every parameter draws from a stream of its own name; what
stands where obeys the rules of `rules`, and a draw that cannot is tried again a
bounded number of times before the rule is named.  What a recipe can say stands in
`world.parameters`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from synfog_usd.base.errors import RecipeError
from synfog_usd.base.seeds import seed32, stream
from synfog_usd.world.authoring import focal_length
from synfog_usd.world.language import Recipe
from synfog_usd.world.library import nominal
from synfog_usd.world.roads import actors, road_actors, road_props, rules, works
from synfog_usd.world.roads.asphalt import Asphalt
from synfog_usd.world.roads.lane_section import Lane, LaneSection
from synfog_usd.world.roads.network import Land, Road
from synfog_usd.world.roads.props import numbered
from synfog_usd.world.roads.reference_line import ReferenceLine, bends
from synfog_usd.world.spec import Placement, RigCamera, SkyDome, View, WorldSpec

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


def draw(recipe: Recipe, *, seed: int) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: a rule cannot be met; says which.
    """
    hour = float(recipe.distributions["traffic.hour"](stream(seed, "recipe", "traffic.hour")))

    def value(name: str) -> Any:
        return recipe.distributions[name](stream(seed, "recipe", name), hour=hour)

    station = round(value("camera.station_m"), 2)
    road, built = _road(recipe, seed, station, value)
    if station + 60.0 > road.reference_line.length:
        raise RecipeError(
            f"{recipe.name}: camera.station_m {station:g} leaves less than 60 m of the road's "
            f"{road.reference_line.length:g} m ahead"
        )
    own = _own_lane(recipe, road, value("camera.lane"))
    fov = value("camera.fov_x_deg")
    view = _view(road, own, station, value("camera.height_m"), fov)
    taken = rules.CollisionSet()
    digging, workers = works.site(road, seed, station, value, taken)
    beside = road_props.rows(recipe, road, seed, station, taken)
    fixed = [*workers, *road_props.unhidden(road, beside, built["gantries"])]
    fixed += road_actors.parked(recipe, road, seed, station, value("parked.share"), taken)

    def drawn(attempt: int, room: rules.CollisionSet) -> list[Placement]:
        return road_actors.drawn(recipe, road, seed, attempt, own, station, value, room)

    moving = actors.in_sight(recipe, drawn, road, value, view, fov, fixed, taken)
    laid = _laid(road, round(value("road.crossfall"), 4), view, [*fixed, *moving])
    return assembled(recipe, seed, value, *laid, {**built, "station": station, "works": digging})


def _laid(level: Road, crossfall: float, view: View, placed: Sequence[Placement]) -> tuple[Road, View, list[Placement]]:
    """What was drawn for a road level across, with a crossfall: lower beside the crown, and vehicles of four wheels
    and more as they stand on the slopes below them.
    """
    road = replace(level, crossfall=crossfall)
    x, y, heading = np.array([(p.x, p.y, math.radians(p.heading)) for p in (view, *placed)]).T
    drop = road.height(x, y) - level.height(x, y)
    slopes = []
    for right, ahead in ((0.5, 0.0), (0.0, 0.5)):  # over a metre
        dx, dy = right * np.cos(heading) - ahead * np.sin(heading), right * np.sin(heading) + ahead * np.cos(heading)
        slopes.append(road.height(x + dx, y + dy) - road.height(x - dx, y - dy))
    roll, pitch = np.round(np.degrees(np.arctan(slopes)), 3) * [[-1.0], [1.0]] + 0.0
    result = []
    for i, p in enumerate(placed, 1):
        p = replace(p, z=round(p.z + float(drop[i]), 4))
        if p.group == "Vehicles" and rules.model(p.asset).group != "rider":
            p = replace(p, pitch=float(pitch[i]), roll=float(roll[i]))
        result.append(p)
    return road, replace(view, z=round(view.z + float(drop[0]), 3)), result


def assembled(
    recipe: Recipe,
    seed: int,
    value: Any,
    road: Road,
    view: View,
    placements: Sequence[Placement],
    built: Mapping[str, Any],
) -> WorldSpec:
    """The world of a road and what stands at it, with sky, fog and the lamps that are lights."""
    heading = round(value("sky.heading_deg"), 1)
    placed = posed(plated(numbered([_coarser(p, view) for p in _lit(placements, view)]), seed), seed)
    placed = signed(placed, view, seed)
    fogs = recipe.fog_variants(seed)
    return WorldSpec(
        about=f"{recipe.about} Drawn from {recipe.name} with seed {seed}.",
        placed=tuple(placed),
        view=view,
        fog=fogs,
        fog_selected=list(fogs)[len(fogs) // 2],
        day=SkyDome(value("sky.day"), round(value("sky.gain"), 3), heading),
        dusk=SkyDome(value("sky.dusk"), round(value("sky.gain"), 3), heading),
        scatter=seed32(seed, "recipe", "scatter"),
        origin={"recipe": recipe.name, "seed": str(seed)},
        road=road,
        rig=_rig(value("camera.rig"), round(value("camera.baseline_m"), 4), view),
        built={
            **built,
            "trees": value("land.trees"),
            "trees_from_m": value("land.trees_from_m"),
            "grass": value("land.grass"),
            "horizon": value("land.horizon"),
            "headlights": value("camera.headlights"),
            "asphalt": Asphalt(value("road.asphalt"), "wet" if value("sky.day") == "rain" else value("road.wet")),
        },
    )


def plated(placed: Sequence[Placement], seed: int) -> list[Placement]:
    """With a number plate for each vehicle that has one."""
    rng = stream(seed, "recipe", "plates")
    result = []
    for p in placed:
        choices = rules.model(p.asset).variants.get("plate", ())
        if choices:
            p = replace(p, variants={**p.variants, "plate": choices[int(rng.integers(len(choices)))]})
        result.append(p)
    return result


def signed(placed: Sequence[Placement], view: View, seed: int) -> list[Placement]:
    """With names over the shops of each house that has some: no name twice while there are others, beginning with the
    house nearest the camera.
    """
    rng = stream(seed, "recipe", "shops")
    taken: set[tuple[str, int]] = set()
    result = list(placed)
    for p in sorted(placed, key=lambda p: math.hypot(p.x - view.x, p.y - view.y)):
        choices = rules.model(p.asset).variants.get("shops", ())
        if choices:
            rows = nominal().get(p.asset, {}).get("shops", ())
            order = [choices[i] for i in rng.permutation(len(choices))]
            unused = [one for one in order if taken.isdisjoint((one, row) for row in rows)]
            chosen = (unused or order)[0]
            taken.update((chosen, row) for row in rows)
            result[placed.index(p)] = replace(p, variants={**p.variants, "shops": chosen})
    return result


def posed(placed: Sequence[Placement], seed: int) -> list[Placement]:
    """With one of several individuals for each person: no two of a kind who come one after the other are the same.  Of
    those who stand within `TOGETHER_M` no two are at one moment of the step while there are others, and no two of a
    kind wear the same.
    """
    rng = stream(seed, "recipe", "individuals")
    result: list[Placement] = []
    people: list[Placement] = []
    last: dict[str, str] = {}
    for p in placed:
        found = rules.model(p.asset)
        choices = found.variants.get("individual", ()) if found.group == "person" else ()
        if choices:
            near = [q for q in people if math.hypot(p.x - q.x, p.y - q.y) < TOGETHER_M]
            others = _but([one for one in choices if one != last.get(p.asset)], near, "individual")
            last[p.asset] = others[int(rng.integers(len(others)))]
            worn = {**p.variants, "individual": last[p.asset]}
            twins = [q for q in near if q.asset == p.asset]
            if "outfit" in worn and any(q.variants["outfit"] == worn["outfit"] for q in twins):
                clothes = _but(found.variants["outfit"], twins, "outfit")
                worn["outfit"] = clothes[int(rng.integers(len(clothes)))]
            p = replace(p, variants=worn)
            people.append(p)
        result.append(p)
    return result


def _but(choices: Sequence[str], taken: Sequence[Placement], variant_set: str) -> Sequence[str]:
    """Choices that none of some placements has; all of them where nothing would be left."""
    return [one for one in choices if all(q.variants[variant_set] != one for q in taken)] or choices


def _rig(kind: str, baseline_m: float, view: View) -> tuple[RigCamera, ...]:
    """Cameras beside the ego's: the right eye, or five that look to the sides and back."""
    if kind == "stereo":
        return (RigCamera("Right", baseline_m, 0.0, 0.0, view.focal_length),)
    if kind == "surround":
        return tuple(RigCamera(name, right, ahead, yaw, focal_length(fov)) for name, right, ahead, yaw, fov in SURROUND)
    return ()


def _road(recipe: Recipe, seed: int, station: float, value: Any) -> tuple[Road, dict[str, Any]]:
    length = round(value("road.length_m"), 1)
    pieces = []
    for i in range(40):
        parts = [
            recipe.distributions[f"road.{key}"](stream(seed, "recipe", f"road.{key}", i))
            for key in ("straight_m", "radius_m", "turn_deg")
        ]
        pieces.append((float(parts[0]), float(parts[1]), float(parts[2])))
    pieces[0] = (pieces[0][0] + station * 0.6, *pieces[0][1:])
    slopes = [(0.0, 0.0), (0.75 * station, 0.0)]
    every, i = value("road.slope_every_m"), 0
    while slopes[-1][0] < length:
        slopes.append(
            (
                round(slopes[-1][0] + every, 3),
                round(float(recipe.distributions["road.slope"](stream(seed, "recipe", "road.slope", i))), 6),
            )
        )
        i += 1
    flat = all(grade == 0.0 for _, grade in slopes)
    line = ReferenceLine(length, bends(pieces, length=length), ((0.0, 0.0),) if flat else tuple(slopes))
    widths = tuple(
        (kind, round(float(w(stream(seed, "recipe", "section", i))), 3), way)
        for i, (kind, w, way) in enumerate(recipe.lanes)
    )
    built: dict[str, Any] = {"rails": value("rails.where"), "delineators": value("rails.delineators"), "gantries": []}
    valley = hill = None
    if value("bridge.length_m"):
        begin = station + value("bridge.ahead_m")
        valley = (
            round(begin, 2),
            round(min(begin + value("bridge.length_m"), length - 10.0), 2),
            round(value("bridge.depth_m"), 2),
        )
    if value("tunnel.ahead_m") is not None:
        hill = (round(station + value("tunnel.ahead_m"), 2), round(value("tunnel.height_m"), 2))
    if value("rails.gantry_ahead_m") is not None:
        first = station + value("rails.gantry_ahead_m")
        built["gantries"] = [round(s, 2) for s in (first, first + 160.0) if s < length - 20.0]
    zebras, at = [], station
    for i in range(value("road.zebras")):
        at += float(recipe.distributions["road.zebra_ahead_m"](stream(seed, "recipe", "road.zebra_ahead_m", i)))
        zebras.append(round(at, 2))
    land = Land(
        round(value("land.hills_m"), 2), seed32(seed, "recipe", "land"), valley, hill, round(value("road.ditch_m"), 3)
    )
    dash = (value("road.dash_m"), value("road.dash_gap_m"))
    return Road(
        line,
        LaneSection.from_widths(widths),
        land,
        tuple(s for s in zebras if s < length - 10.0),
        value("road.centre"),
        dash,
    ), built


def _own_lane(recipe: Recipe, road: Road, number: int) -> Lane:
    lanes = [lane for lane in road.driving_lanes if lane.way > 0 and lane.kind == "lane"]
    if number >= len(lanes):
        raise RecipeError(
            f"{recipe.name}: camera.lane {number}: the road has {len(lanes)} lanes that go its way; lanes count from 0 "
            f"at the right"
        )
    return lanes[-1 - number]


def _view(road: Road, own: Lane, station: float, height_m: float, fov_x_deg: float) -> View:
    t = own.middle - 0.15
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

    lamps = sorted((p for p in placed if rules.model(p.asset).group == "lamp"), key=distance)
    cars = sorted((p for p in placed if p.lit), key=distance)
    near = {id(p) for p in [*lamps[:NEAREST_LAMPS], *cars[:NEAREST_LIT]] if distance(p) < LIT_M}
    result = []
    for p in placed:
        choices = rules.model(p.asset).variants.get("lamps", ())
        if (rules.model(p.asset).group == "lamp" or p.lit) and choices:
            state = (
                ("brake" if p.lit.get("lamps") == "brake" else "on")
                if id(p) in near or "glow" not in choices
                else "glow"
            )
            p = replace(p, lit={"lamps": state})
        elif p.lit:
            p = replace(p, lit={})
        result.append(p)
    return result


def _coarser(p: Placement, view: View) -> Placement:
    """With the coarse geometry of its model, where it has one and is far: 2 cm are half a pixel at LOW_M."""
    if "low" not in rules.model(p.asset).variants.get("lod", ()) or math.hypot(p.x - view.x, p.y - view.y) < LOW_M:
        return p
    return replace(p, variants={**p.variants, "lod": "low"})

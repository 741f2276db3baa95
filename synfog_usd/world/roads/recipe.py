"""Recipes of roads: what may differ between draws, and one draw of it all.

A recipe gives the line, the cross-section, rows of things along it, traffic,
people, sky and camera.  Every parameter draws from a stream of its own name; what
stands where obeys the rules of `rules`, and a draw that cannot is tried again a
bounded number of times before the rule is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synfog_usd.errors import RecipeError, did_you_mean
from synfog_usd.seeds import seed32, stream
from synfog_usd.world.authoring import APERTURE
from synfog_usd.world.draws import Amount, Draw, Names, check_schema, mapping, read_draw, read_draws, read_fog, sections
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.line import Line, bends
from synfog_usd.world.roads.markings import BAY_M, bay_length, bays, zebra_span
from synfog_usd.world.roads.network import Land, Lane, Road
from synfog_usd.world.roads.section import DRIVEN, KINDS, PAVED, RAISED, Band, Section
from synfog_usd.world.spec import Placement, View, WorldSpec
from synfog_usd.yamlio import Located

TRIES = 60
TRIES_ALIKE, DENSER = 5, 1.3
"""A world whose traffic is too thin for the rules of sight is tried again with denser traffic, after every few tries."""
CAR = {"hatchback": 3, "saloon": 3, "estate": 2, "offroader": 2, "van": 1}
PAINTS = ("white", "silver", "grey", "black", "blue", "red", "green", "sand", "yellow")
WALKERS = ("man_walking", "woman_walking", "student", "child", "old_man", "jogger", "woman_pram", "wheelchair_user")
AHEAD_M, BEHIND_M = 260.0, 70.0
NEAREST_LIT, NEAREST_LAMPS = 6, 8
"""Vehicles and street lamps that are lights at dusk; those beyond glow.  Each light costs noise in every pixel."""
LIT_M = 110.0
LOW_M = 60.0
NUDGES, NUDGE_M = 16, 0.3
OWN_CAR_M = (4.5, 2.6)
"""Free lane behind and before the lens: the camera's own car."""

PARAMETERS: dict[str, Amount | Names] = {
    "road.length_m": Amount(150.0, 1500.0, 460.0),
    "road.straight_m": Amount(0.0, 1000.0, 80.0),
    "road.radius_m": Amount(30.0, 10000.0, 400.0),
    "road.turn_deg": Amount(-90.0, 90.0, 0.0),
    "road.slope": Amount(-0.12, 0.12, 0.0),
    "road.slope_every_m": Amount(60.0, 1000.0, 110.0),
    "road.centre": Names(("dashed", "solid", "double", "none"), "dashed"),
    "road.dash_m": Amount(1.0, 12.0, 3.0),
    "road.dash_gap_m": Amount(1.0, 18.0, 6.0),
    "road.zebras": Amount(0, 3, 0, whole=True),
    "road.zebra_ahead_m": Amount(12.0, 150.0, 30.0),
    "land.hills_m": Amount(0.0, 40.0, 0.0),
    "land.trees": Amount(0, 600, 120, whole=True),
    "land.trees_from_m": Amount(20.0, 200.0, 60.0),
    "land.grass": Names(("tufts", "none"), "tufts"),
    "bridge.ahead_m": Amount(-60.0, 200.0, 20.0),
    "bridge.length_m": Amount(20.0, 400.0, 0.0),
    "bridge.depth_m": Amount(4.0, 60.0, 12.0),
    "tunnel.ahead_m": Amount(10.0, 200.0, None),
    "tunnel.height_m": Amount(13.0, 40.0, 15.0),
    "rails.where": Names(("none", "outer", "median", "all"), "none"),
    "rails.delineators": Names(("none", "both"), "none"),
    "rails.gantry_ahead_m": Amount(20.0, 200.0, None),
    "parked.share": Amount(0.0, 1.0, 0.7),
    "parked.bodies": Names(("*vehicle",), CAR),
    "parked.paints": Names(PAINTS, dict.fromkeys(PAINTS, 1)),
    "traffic.hour": Amount(0.0, 24.0, 12.0),
    "traffic.per_hour": Amount(0.0, 2400.0, 500.0),
    "traffic.speed_kmh": Amount(5.0, 130.0, 50.0),
    "traffic.headway_s": Amount(0.3, 5.0, 0.9),
    "traffic.count": Amount(0, 120, None, whole=True),
    "traffic.bodies": Names(("*vehicle",), {**CAR, "bus": 0.3, "lorry": 0.6}),
    "traffic.paints": Names(PAINTS, dict.fromkeys(PAINTS, 1)),
    "traffic.cyclists": Amount(0, 6, 0, whole=True),
    "people.count": Amount(0, 80, 0, whole=True),
    "people.kinds": Names(("*person",), dict.fromkeys(("man_walking", "woman_walking", "student", "child", "old_man", "man_waiting", "woman_phone"), 1)),
    "people.crossing_share": Amount(0.0, 1.0, 0.3),
    "sky.overcast_nits": Amount(200.0, 20000.0, 5000.0),
    "sky.dusk_nits": Amount(0.1, 200.0, 5.0),
    "camera.station_m": Amount(10.0, 400.0, 90.0),
    "camera.lane": Amount(0, 5, 0, whole=True),
    "camera.height_m": Amount(1.0, 3.5, 1.45),
    "camera.fov_x_deg": Amount(20.0, 100.0, 55.1),
    "rules.users": Amount(0, 50, 5, whole=True),
    "rules.in_view": Amount(0, 20, 3, whole=True),
    "rules.within_m": Amount(20.0, 300.0, 100.0),
}
"""What a recipe can say, by section and key, with what holds where it says nothing.  camera.lane counts from the right."""

SIDES = ("left", "right", "both", "alternate")
FROM = ("kerb", "edge", "line")
TURNS = ("road", "traffic", "along", "back", "any")
ROW: dict[str, Amount | Names] = {
    "models": Names(("*",), None),
    "side": Names(SIDES, "both"),
    "from": Names(FROM, "edge"),
    "out_m": Amount(-30.0, 200.0, 1.0),
    "step_m": Amount(0.5, 500.0, None),
    "gap_m": Amount(0.0, 200.0, 0.0),
    "start_m": Amount(-100.0, 1500.0, 0.0),
    "end_m": Amount(-100.0, 2000.0, None),
    "share": Amount(0.0, 1.0, 1.0),
    "turn": Names(TURNS, "road"),
    "size": Amount(0.3, 3.0, 1.0),
}
"""Keys of one row of things along the road."""


@dataclass(frozen=True)
class Row:
    """Things along the road, with the place in the recipe for errors."""

    place: str
    draws: Mapping[str, Draw]


@dataclass(frozen=True)
class Recipe:
    """A recipe of a road that was read and checked.

    Attributes:
        name: of its file; about: one sentence.
        draws: one for each of PARAMETERS.
        bands: (kind, width, way) from left to right.
        rows: what stands along the road, in the order of precedence.
        fog: one for each fog variant, MOR [m].
    """

    name: str
    about: str
    draws: Mapping[str, Draw]
    bands: tuple[tuple[str, Draw, int], ...]
    rows: tuple[Row, ...]
    fog: tuple[Draw, ...]


def read(root: Located, name: str) -> Recipe:
    """A recipe of a road from its YAML.

    Raises:
        RecipeError: with its place.
    """
    parameters = {key: _named(parameter) for key, parameter in PARAMETERS.items()}
    items = mapping(root, "a recipe", ("synfog", "world", "about", "section", "rows", "fog", *sections(parameters)))
    check_schema(items, root)
    about = items.get("about")
    if about is not None and not isinstance(about.value, str):
        raise RecipeError(f"{about.place}: about is {about.plain()!r}; it takes one sentence")
    if "section" not in items:
        raise RecipeError(f"{root.place}: a road needs 'section': its bands from left to right, as in [{{lane: 3.5, way: -1}}, {{lane: 3.5, way: 1}}]")
    bands = _bands(items["section"])
    rows = _rows(items["rows"]) if "rows" in items else ()
    return Recipe(name, about.value if about else "A road.", read_draws(items, parameters), bands, rows, read_fog(items))


def _named(parameter: Amount | Names) -> Amount | Names:
    """Names that stand for models of the library become those models."""
    if isinstance(parameter, Names) and parameter.allowed[0].startswith("*"):
        group = parameter.allowed[0][1:]
        found = rules.names() if not group else tuple(name for name in rules.names() if rules.model(name).group == group)
        kept = parameter.default if parameter.default is None else {key: weight for key, weight in parameter.default.items() if key in found}
        return Names(found, kept)
    return parameter


def _bands(item: Located) -> tuple[tuple[str, Draw, int], ...]:
    if not isinstance(item.value, list) or not item.value:
        raise RecipeError(f"{item.place}: section is {item.plain()!r}; it takes a list of bands from left to right, as in [{{lane: 3.5, way: 1}}]")
    bands = []
    for band in item.value:
        if not isinstance(band.value, dict) or not band.value:
            raise RecipeError(f"{band.place}: a band is {band.plain()!r}; it takes {{KIND: width, way: 1 or -1}} with KIND one of {', '.join(KINDS)}")
        kinds = [key for key in band.value if key != "way"]
        for key in kinds:
            if key not in KINDS:
                raise RecipeError(f"{band.value[key].key_place}: no band {key!r}; there are {', '.join(KINDS)}.{did_you_mean(key, KINDS)}")
        if len(kinds) != 1:
            raise RecipeError(f"{band.place}: a band has one kind, found {', '.join(kinds) or 'none'}")
        kind, way = kinds[0], 0
        if "way" in band.value:
            way = band.value["way"].value
            if way not in (1, -1) or isinstance(way, bool):
                raise RecipeError(f"{band.value['way'].place}: way is {band.value['way'].plain()!r}; it takes 1 (away from the camera) or -1")
        elif kind in DRIVEN:
            raise RecipeError(f"{band.place}: {kind} needs its way: 1 (away from the camera) or -1")
        bands.append((kind, read_draw(band.value[kind], f"section: {kind}", Amount(0.3, 30.0, None)), way if kind in DRIVEN else 0))
    ways = [way for _, _, way in bands if way]
    if 1 not in ways:
        raise RecipeError(f"{item.place}: no lane has way 1, in which the camera drives")
    if ways != sorted(ways):
        raise RecipeError(f"{item.place}: lanes of way -1 lie left of those of way 1: traffic keeps to the right")
    return tuple(bands)


def _rows(item: Located) -> tuple[Row, ...]:
    if not isinstance(item.value, list):
        raise RecipeError(f"{item.place}: rows is {item.plain()!r}; it takes a list of {{models: ..., side: ..., out_m: ..., step_m: ...}}")
    rows = []
    for row in item.value:
        items = mapping(row, "a row", tuple(ROW))
        if "models" not in items:
            raise RecipeError(f"{row.place}: a row needs 'models', one name or {{choice: {{name: weight, ...}}}}")
        draws = {}
        for key, parameter in ROW.items():
            if key in items:
                draws[key] = read_draw(items[key], f"rows: {key}", _named(parameter))
            elif key != "models":
                draws[key] = Draw("fixed", (parameter.default,))
        rows.append(Row(str(row.place), draws))
    return tuple(rows)


# -- drawing


def draw(recipe: Recipe, *, seed: int) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: a rule cannot be met; says which, after TRIES tries.
    """
    hour = float(recipe.draws["traffic.hour"](stream(seed, "recipe", "traffic.hour")))

    def value(name: str) -> Any:
        return recipe.draws[name](stream(seed, "recipe", name), hour=hour)

    station = round(value("camera.station_m"), 2)
    road, built = _road(recipe, seed, station, value)
    if station + 60.0 > road.line.length:
        raise RecipeError(f"{recipe.name}: camera.station_m {station:g} leaves less than 60 m of the road's {road.line.length:g} m ahead")
    own = _own_lane(recipe, road, value("camera.lane"))
    fov = value("camera.fov_x_deg")
    view = _view(road, own, station, value("camera.height_m"), fov)
    taken = rules.Occupied()
    fixed = _rows_placed(recipe, road, seed, station, taken)
    fixed += _parked(recipe, road, seed, station, value("parked.share"), taken)
    movers, least, seen = _movers(recipe, road, seed, own, station, value, view, fov, fixed, taken, hour)
    if movers is None:
        raise RecipeError(
            f"{recipe.name}: rules.{least} cannot be met: {TRIES} tries gave at most {seen}; "
            "ask for less, or raise traffic.per_hour, traffic.count, people.count or parked.share"
        )
    placed = [_coarser(p, view) for p in _lit([*fixed, *movers], view)]
    visibilities = sorted({fog(stream(seed, "recipe", "fog", i)) for i, fog in enumerate(recipe.fog)}, reverse=True)
    fogs = {"clear": None, **{f"mor{mor}": float(mor) for mor in visibilities}}
    return WorldSpec(
        about=f"{recipe.about} Drawn from {recipe.name} with seed {seed}.",
        placed=tuple(_numbered(placed)),
        view=view,
        fog=fogs,
        fog_selected=list(fogs)[len(fogs) // 2],
        overcast_nits=round(value("sky.overcast_nits"), 1),
        dusk_nits=round(value("sky.dusk_nits"), 3),
        scatter=seed32(seed, "recipe", "scatter"),
        origin={"recipe": recipe.name, "seed": str(seed)},
        road=road,
        built={**built, "station": station, "trees": value("land.trees"), "trees_from_m": value("land.trees_from_m"), "grass": value("land.grass")},
    )


def _road(recipe: Recipe, seed: int, station: float, value: Any) -> tuple[Road, dict[str, Any]]:
    length = round(value("road.length_m"), 1)
    pieces = []
    for i in range(40):
        parts = [recipe.draws[f"road.{key}"](stream(seed, "recipe", f"road.{key}", i)) for key in ("straight_m", "radius_m", "turn_deg")]
        pieces.append((float(parts[0]), float(parts[1]), float(parts[2])))
    pieces[0] = (pieces[0][0] + station * 0.6, *pieces[0][1:])
    slopes = [(0.0, 0.0), (0.75 * station, 0.0)]
    every, i = value("road.slope_every_m"), 0
    while slopes[-1][0] < length:
        slopes.append((round(slopes[-1][0] + every, 3), round(float(recipe.draws["road.slope"](stream(seed, "recipe", "road.slope", i))), 6)))
        i += 1
    flat = all(grade == 0.0 for _, grade in slopes)
    line = Line(length, bends(pieces, length=length), ((0.0, 0.0),) if flat else tuple(slopes))
    bands = tuple(Band(kind, round(float(w(stream(seed, "recipe", "section", i))), 3), way) for i, (kind, w, way) in enumerate(recipe.bands))
    built: dict[str, Any] = {"rails": value("rails.where"), "delineators": value("rails.delineators"), "gantries": []}
    valley = hill = None
    if value("bridge.length_m"):
        begin = station + value("bridge.ahead_m")
        valley = (round(begin, 2), round(min(begin + value("bridge.length_m"), length - 10.0), 2), round(value("bridge.depth_m"), 2))
    if value("tunnel.ahead_m") is not None:
        hill = (round(station + value("tunnel.ahead_m"), 2), round(value("tunnel.height_m"), 2))
    if value("rails.gantry_ahead_m") is not None:
        first = station + value("rails.gantry_ahead_m")
        built["gantries"] = [round(s, 2) for s in (first, first + 160.0) if s < length - 20.0]
    zebras, at = [], station
    for i in range(value("road.zebras")):
        at += float(recipe.draws["road.zebra_ahead_m"](stream(seed, "recipe", "road.zebra_ahead_m", i)))
        zebras.append(round(at, 2))
    land = Land(round(value("land.hills_m"), 2), seed32(seed, "recipe", "land"), valley, hill)
    dash = (value("road.dash_m"), value("road.dash_gap_m"))
    return Road(line, Section(bands), land, tuple(s for s in zebras if s < length - 10.0), value("road.centre"), dash), built


def _own_lane(recipe: Recipe, road: Road, number: int) -> Lane:
    lanes = [lane for lane in road.lanes if lane.way > 0 and lane.kind == "lane"]
    if number >= len(lanes):
        raise RecipeError(f"{recipe.name}: camera.lane {number}: the road has {len(lanes)} lanes that go its way; lanes count from 0 at the right")
    return lanes[-1 - number]


def _view(road: Road, own: Lane, station: float, height_m: float, fov_x_deg: float) -> View:
    t = own.middle - 0.15
    x, y = road.line.place(station, t)
    heading = math.degrees(float(road.line.heading(station)))
    pitch = math.degrees(math.atan(float(road.line.grade(station))))
    z = float(road.ground(station, t)) + height_m
    focal = round(APERTURE / 2 / math.tan(math.radians(fov_x_deg) / 2), 6)
    return View(round(float(x), 3), round(float(y), 3), round(z, 3), round(90.6 + pitch, 3), round(heading + 0.8, 3), focal)


def _rows_placed(recipe: Recipe, road: Road, seed: int, station: float, taken: rules.Occupied) -> list[Placement]:
    """Rows in their order; what has no room is left out."""
    placed: list[Placement] = []
    for number, row in enumerate(recipe.rows):
        side = row.draws["side"](stream(seed, "recipe", "rows", number, "side"))
        sides = {"left": (-1,), "right": (1,)}.get(side, (-1, 1))
        for sign in sides:
            rng = stream(seed, "recipe", "rows", number, sign)
            step0 = row.draws["step_m"](rng)
            s = float(row.draws["start_m"](rng)) + station
            if side == "alternate" and sign > 0 and step0:
                s += step0 / 2
            end = row.draws["end_m"](rng)
            end = road.line.length if end is None else min(float(end) + station, road.line.length)
            while s < end:
                asset = row.draws["models"](rng)
                found = rules.model(asset)
                turned = row.draws["turn"](rng)
                size = round(float(row.draws["size"](rng)), 3)
                extent = (found.width if turned in ("road", "back") else found.length) * size
                step = row.draws["step_m"](rng)
                gap = float(row.draws["gap_m"](rng))
                middle = s if step is not None else s + extent / 2
                s += float(step) if step is not None else extent + gap
                there = rng.random() < row.draws["share"](rng)
                out = float(row.draws["out_m"](rng))
                random_turn = rng.uniform(0, 360)
                looks = _look(rng, found)
                if not there or middle < 0.0 or middle > road.line.length:
                    continue
                t = _reference(road, row.draws["from"](rng), sign) + sign * out
                angle = {"road": 90.0 * sign, "back": -90.0 * sign, "traffic": 180.0 if sign > 0 else 0.0, "along": 0.0 if sign > 0 else 180.0}.get(
                    turned, random_turn
                )
                for nudge in range(NUDGES if step is None else 1):  # rows that stand end to end need more room inside a bend
                    at = middle + NUDGE_M * nudge
                    p = _stood(road, asset, at, t, angle, looks, size)
                    if p is not None and taken.free(p, 0.02 if found.group == "building" else 0.1):
                        taken.add(p)
                        placed.append(p)
                        s += NUDGE_M * nudge if step is None else 0.0
                        break
    return placed


def _stood(road: Road, asset: str, s: float, t: float, angle: float, looks: dict[str, str], size: float) -> Placement | None:
    """A thing beside the road, or None where the road has no place for it."""
    found = rules.model(asset)
    near_kerb = found.group != "building" and road.section.low - 3.0 < t < road.section.high + 3.0
    if s > road.line.length or _in_structure(road, s, t) or (near_kerb and any(abs(s - zebra) < 4.5 for zebra in road.zebras)):
        return None
    x, y, z, heading, _ = road.pose(s, t)
    if found.group == "building":  # stands as high as the ground before it
        z = round(float(road.ground(s, road.section.high if t > 0 else road.section.low)), 4) - 0.005
    return Placement(rules.prim_group(found), "", asset, x, y, round((heading + angle + 180.0) % 360.0 - 180.0, 2), looks, z=z, size=size)


def _reference(road: Road, where: str, sign: int) -> float:
    """Offset that a row counts outwards from."""
    if where == "line":
        return 0.0
    if where == "edge":
        return road.section.high if sign > 0 else road.section.low
    paved = [strip for strip in road.section.strips if strip.band.kind in PAVED]
    return paved[-1].high if sign > 0 else paved[0].low


def _in_structure(road: Road, s: float, t: float) -> bool:
    """Whether a place beside the road is off a bridge, or in a tunnel's hill."""
    outside = t > road.section.high or t < road.section.low
    if road.land.valley and outside and road.land.valley[0] - 6.0 < s < road.land.valley[1] + 6.0:
        return True
    return bool(road.land.hill and s > road.land.hill[0] - (10.0 if outside else 2.0))


def _look(rng: np.random.Generator, found: Any) -> dict[str, str]:
    """A choice of each variant set but those of lamps, signals and detail."""
    return {name: choices[int(rng.integers(len(choices)))] for name, choices in sorted(found.variants.items()) if name not in ("lamps", "signal", "lod")}


def _car(recipe: Recipe, section: str, rng: np.random.Generator, among: Sequence[str] | None = None) -> tuple[str, dict[str, str]]:
    body = recipe.draws[f"{section}.bodies"](rng, among)
    paints = rules.model(body).variants.get("paint", ())
    paint = recipe.draws[f"{section}.paints"](rng, paints) if paints else ""
    return body, ({"paint": paint} if paint else {})


def _parked(recipe: Recipe, road: Road, seed: int, station: float, share: float, taken: rules.Occupied) -> list[Placement]:
    """One car to a bay, looking the way of the lane beside."""
    placed = []
    for number, (strip, middle) in enumerate(bays(road)):
        rng = stream(seed, "recipe", "parked", number)
        there = rng.random() < share
        body, looks = _car(recipe, "parked", rng)
        t = strip.middle + float(np.clip(rng.normal(0, 0.05), -0.1, 0.1))
        s = middle + float(rng.uniform(-0.15, 0.15))
        across, nose_in = bay_length(strip) != BAY_M, rng.random() < 0.7
        room_m = strip.band.width - 0.15 if across else BAY_M - 0.3
        if not there or s < station - BEHIND_M or rules.model(body).length > room_m or _in_structure(road, s, t):
            continue
        way = 1 if strip.middle > 0 else -1
        x, y, z, heading, pitch = road.pose(s, t, way=way)
        if across:
            heading, pitch = heading + (-90.0 if nose_in else 90.0), 0.0
        p = Placement("Vehicles", "", body, x, y, round(heading + float(rng.normal(0, 0.5)), 3), looks, z=z, pitch=pitch)
        if taken.free(p):
            taken.add(p)
            placed.append(p)
    return placed


def _movers(
    recipe: Recipe, road: Road, seed: int, own: Lane, station: float, value: Any, view: View, fov: float, fixed: list[Placement], taken: rules.Occupied,
    hour: float,
) -> tuple[list[Placement] | None, str, int]:  # fmt: skip
    """Traffic and people that meet the rules of sight; None with the rule that failed and the most that was reached."""
    users, in_view, within = value("rules.users"), value("rules.in_view"), value("rules.within_m")
    best = {"users": 0, "in_view": 0}
    for attempt in range(TRIES):
        room = taken.copy()
        movers = [*_traffic(recipe, road, seed, attempt, own, station, value, room), *_people(recipe, road, seed, attempt, station, value, room)]
        every = _numbered([*fixed, *movers])
        count = sum(rules.model(p.asset).label in rules.USERS for p in every)
        best["users"] = max(best["users"], count)
        if count < users:
            continue
        seen = sum(share >= rules.SHARE_SEEN for share in rules.visible(view, fov, every, road, within_m=within).values()) if in_view else 0
        best["in_view"] = max(best["in_view"], seen)
        if seen >= in_view:
            return movers, "", 0
    failed = "users" if best["users"] < users else "in_view"
    return None, f"{failed} {users if failed == 'users' else in_view}", best[failed]


def _traffic(recipe: Recipe, road: Road, seed: int, attempt: int, own: Lane, station: float, value: Any, room: rules.Occupied) -> list[Placement]:
    """Vehicles in their lanes: as many as the flow at that hour (more after tries that failed), no nearer to each other than they can stop."""
    speed = value("traffic.speed_kmh") / 3.6
    least = 1.5 + speed * value("traffic.headway_s")
    low, high = max(station - BEHIND_M, 4.0), min(station + AHEAD_M, road.line.length - 4.0)
    total = value("traffic.count")
    lengths = {lane.index: high - low for lane in road.lanes}
    if total is None:
        density = value("traffic.per_hour") / 3600.0 / speed * DENSER ** (attempt // TRIES_ALIKE)
        counts = {
            lane.index: int(stream(seed, "recipe", "traffic", attempt, "number", lane.index).poisson(density * lengths[lane.index])) for lane in road.lanes
        }
    else:
        rng = stream(seed, "recipe", "traffic", attempt, "number")
        chosen = rng.choice([lane.index for lane in road.lanes], total)
        counts = {lane.index: int((chosen == lane.index).sum()) for lane in road.lanes}
    placed: list[Placement] = []
    for lane in road.lanes:
        rng = stream(seed, "recipe", "traffic", attempt, "lane", lane.index)
        blocked = [(station - OWN_CAR_M[0] - least, station + OWN_CAR_M[1] + max(least, 4.0))] if lane is own else []
        free = rules.spans(road, low, high, blocked)
        long = np.array([b - a for a, b in free])
        if not len(long):
            continue
        share = rng.choice(len(free), counts[lane.index], p=long / long.sum())
        for number, span in enumerate(free):
            cars = []
            for _ in range(int((share == number).sum())):
                among = [b for b in ("bus", "taxi", "coach", "minibus") if b in rules.names()] if lane.kind == "bus" else None
                cars.append(_car(recipe, "traffic", rng, among))
            places = rules.queue(rng, span, [rules.model(body).length for body, _ in cars], least)
            for (body, looks), s in zip(cars, places, strict=False):
                sway = min(0.2, max(0.0, (lane.width - rules.model(body).width) / 2 - 0.15))
                t = lane.middle + float(np.clip(rng.normal(0, 0.08), -sway, sway))
                x, y, z, heading, pitch = road.pose(s, t, way=lane.way)
                p = Placement("Vehicles", "", body, x, y, heading, looks, {"lamps": "glow"}, z=z, pitch=pitch)
                if room.free(p, 0.15):
                    room.add(p)
                    placed.append(p)
    for number in range(value("traffic.cyclists")):
        rng = stream(seed, "recipe", "cyclist", attempt, number)
        placed += _cyclist(road, rng, station, room)
    return placed


def _cyclist(road: Road, rng: np.random.Generator, station: float, room: rules.Occupied) -> list[Placement]:
    """At the right edge of the rightmost lane of its way, or on the cycle lane."""
    way = 1 if rng.random() < 0.6 else -1
    lanes = [lane for lane in road.lanes if lane.way == way]
    if not lanes:
        return []
    outer = lanes[-1] if way > 0 else lanes[0]
    cycle = [strip for strip in road.section.of("cycle") if strip.middle * way > 0]
    t = cycle[0].middle if cycle else outer.middle + way * (outer.width / 2 - 0.65)
    looks, colours = rules.model("rider").variants.get("outfit", ("a",)), rules.model("bicycle").variants.get("colour", ("black",))
    for _ in range(20):
        s = station + float(rng.uniform(12.0, 80.0))
        if s > road.line.length - 5.0 or any(abs(s - zebra) < 4.0 for zebra in road.zebras):
            continue
        x, y, z, heading, pitch = road.pose(s, t, way=way)
        bicycle = Placement("Vehicles", "", "bicycle", x, y, heading, {"colour": colours[int(rng.integers(len(colours)))]}, z=z, pitch=pitch)
        if room.free(bicycle, 0.4):
            room.add(bicycle)
            rider = Placement("People", "", "rider", x, y, heading, {"outfit": looks[int(rng.integers(len(looks)))]}, z=z, pitch=pitch)
            return [bicycle, rider]
    return []


def _people(recipe: Recipe, road: Road, seed: int, attempt: int, station: float, value: Any, room: rules.Occupied) -> list[Placement]:
    """On pavements, denser near the camera, and on zebra crossings."""
    count, share = value("people.count"), value("people.crossing_share")
    walks = [strip for strip in road.section.of("pavement")]
    if count and not walks:
        raise RecipeError(f"{recipe.name}: people.count {count}: the section has no pavement for them")
    placed: list[Placement] = []
    kinds = recipe.draws["people.kinds"]
    for number in range(count):
        rng = stream(seed, "recipe", "person", attempt, number)
        crosses = bool(road.zebras) and rng.random() < share
        kind = kinds(rng, [name for name in WALKERS if name in kinds.values] or None) if crosses else kinds(rng)
        looks = _look(rng, rules.model(kind))
        for _ in range(TRIES):
            way = int(rng.choice((-1, 1)))
            if crosses:
                low, high = zebra_span(road)
                s = road.zebras[int(rng.integers(len(road.zebras)))] + float(rng.uniform(-1.2, 1.2))
                t, turn = float(rng.uniform(low + 0.4, high - 0.4)), 90.0 * way + float(rng.normal(0, 4))
                if road.section.at(t).band.kind in RAISED:  # type: ignore[union-attr]
                    continue
            else:
                strip = walks[int(rng.integers(len(walks)))]
                s = station - 15.0 + (road.line.length - station) * 0.6 * float(rng.random()) ** 1.8
                t = float(rng.uniform(strip.low + 0.55, strip.high - 0.45))
                turn = (90.0 - 90.0 * way + float(rng.normal(0, 5))) if kind in WALKERS else float(rng.uniform(0, 360))
            if s > road.line.length - 3.0:
                continue
            x, y, z, heading, _ = road.pose(s, t)
            p = Placement("People", "", kind, x, y, round((heading + turn + 180.0) % 360.0 - 180.0, 2), looks, z=z)
            if room.free(p, 0.12):
                room.add(p)
                placed.append(p)
                break
        else:
            raise RecipeError(f"{recipe.name}: people.count {count}: no room for more than {number} after {TRIES} tries")
    return placed


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
            state = "on" if id(p) in near or "glow" not in choices else "glow"
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


def _numbered(placed: Sequence[Placement]) -> list[Placement]:
    """With prim names of model and number."""
    counts: dict[str, int] = {}
    result = []
    for p in placed:
        counts[p.asset] = counts.get(p.asset, 0) + 1
        result.append(replace(p, name=f"{p.asset.title()}_{counts[p.asset]:02d}"))
    return result

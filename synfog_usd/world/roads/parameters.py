"""What a recipe of a road can say: its parameters with their limits, and how it is read.

Knows nothing of how a road is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping

from synfog_usd.errors import RecipeError, did_you_mean
from synfog_usd.world.language import (
    Categorical,
    Continuous,
    Distribution,
    Recipe,
    Row,
    check_schema,
    mapping,
    read_distribution,
    read_distributions,
    read_fog,
    sections,
)
from synfog_usd.world.roads import rules
from synfog_usd.world.roads.asphalt import KINDS as KINDS_OF_ASPHALT
from synfog_usd.world.roads.asphalt import WETNESS
from synfog_usd.world.roads.lane_section import DRIVEN, KINDS
from synfog_usd.world.skies import skies
from synfog_usd.yamlio import Located

CAR = {"hatchback": 3, "saloon": 3, "estate": 2, "offroader": 2, "van": 1}
PAINTS = ("white", "silver", "grey", "black", "blue", "red", "green", "sand", "yellow")
PEOPLE = {"man_walking": 3, "woman_walking": 3, "student": 2, "schoolgirl": 1, "child": 1, "old_man": 1, "man_waiting": 1, "woman_phone": 1,
          "woman_pram": 0.5, "jogger": 0.5, "wheelchair_user": 0.3}  # fmt: skip
WALKERS = ("man_walking", "woman_walking", "student", "child", "schoolgirl", "old_man", "jogger", "woman_pram", "wheelchair_user")

PARAMETERS: dict[str, Continuous | Categorical] = {
    "road.length_m": Continuous(150.0, 1500.0, 460.0),
    "road.straight_m": Continuous(0.0, 1000.0, 80.0),
    "road.radius_m": Continuous(30.0, 10000.0, 400.0),
    "road.turn_deg": Continuous(-90.0, 90.0, 0.0),
    "road.slope": Continuous(-0.12, 0.12, 0.0),
    "road.slope_every_m": Continuous(60.0, 1000.0, 110.0),
    "road.centre": Categorical(("dashed", "solid", "double", "none"), "dashed"),
    "road.dash_m": Continuous(1.0, 12.0, 3.0),
    "road.dash_gap_m": Continuous(1.0, 18.0, 6.0),
    "road.asphalt": Categorical(KINDS_OF_ASPHALT, "worn"),
    "road.wet": Categorical(tuple(WETNESS), "dry"),
    "road.zebras": Continuous(0, 3, 0, whole=True),
    "road.zebra_ahead_m": Continuous(12.0, 150.0, 30.0),
    "land.hills_m": Continuous(0.0, 40.0, 0.0),
    "land.trees": Continuous(0, 600, 120, whole=True),
    "land.trees_from_m": Continuous(20.0, 200.0, 60.0),
    "land.grass": Categorical(("tufts", "none"), "tufts"),
    "bridge.ahead_m": Continuous(-60.0, 200.0, 20.0),
    "bridge.length_m": Continuous(20.0, 400.0, 0.0),
    "bridge.depth_m": Continuous(4.0, 60.0, 12.0),
    "tunnel.ahead_m": Continuous(10.0, 200.0, None),
    "tunnel.height_m": Continuous(13.0, 40.0, 15.0),
    "rails.where": Categorical(("none", "outer", "median", "all"), "none"),
    "rails.delineators": Categorical(("none", "both"), "none"),
    "rails.gantry_ahead_m": Continuous(20.0, 200.0, None),
    "works.where": Categorical(("none", "left", "right"), "none"),
    "works.ahead_m": Continuous(5.0, 200.0, 30.0),
    "parked.share": Continuous(0.0, 1.0, 0.7),
    "parked.bodies": Categorical(("*vehicle",), CAR),
    "parked.paints": Categorical(PAINTS, dict.fromkeys(PAINTS, 1)),
    "traffic.hour": Continuous(0.0, 24.0, 12.0),
    "traffic.per_hour": Continuous(0.0, 2400.0, 500.0),
    "traffic.speed_kmh": Continuous(5.0, 130.0, 50.0),
    "traffic.headway_s": Continuous(0.3, 5.0, 0.9),
    "traffic.count": Continuous(0, 120, None, whole=True),
    "traffic.bodies": Categorical(("*vehicle motorcyclist",), {**CAR, "bus": 0.3, "lorry": 0.6, "motorcyclist": 0.3}),
    "traffic.paints": Categorical(PAINTS, dict.fromkeys(PAINTS, 1)),
    "traffic.cyclists": Continuous(0, 6, 0, whole=True),
    "people.count": Continuous(0, 80, 0, whole=True),
    "people.kinds": Categorical(("*person",), PEOPLE),
    "people.company": Continuous(0.0, 1.0, 0.4),
    "people.crossing_share": Continuous(0.0, 1.0, 0.3),
    "sky.day": Categorical(("*sky",), "overcast_noon"),
    "sky.dusk": Categorical(("*sky",), "dusk_overcast"),
    "sky.heading_deg": Continuous(0.0, 360.0, 0.0),
    "sky.gain": Continuous(0.1, 10.0, 1.0),
    "camera.station_m": Continuous(10.0, 400.0, 90.0),
    "camera.lane": Continuous(0, 5, 0, whole=True),
    "camera.height_m": Continuous(1.0, 3.5, 1.45),
    "camera.headlights": Categorical(("low_beam_halogen", "low_beam_led"), {"low_beam_halogen": 1, "low_beam_led": 1}),
    "camera.rig": Categorical(("single", "stereo", "surround"), "single"),
    "camera.baseline_m": Continuous(0.05, 1.0, 0.3),
    "camera.fov_x_deg": Continuous(20.0, 100.0, 55.1),
    "rules.users": Continuous(0, 50, 5, whole=True),
    "rules.in_view": Continuous(0, 20, 3, whole=True),
    "rules.within_m": Continuous(20.0, 300.0, 100.0),
}
"""What a recipe can say, by section and key, with what holds where it says nothing.  camera.lane counts from the right."""

SIDES = ("left", "right", "both", "alternate")
FROM = ("kerb", "edge", "line")
TURNS = ("road", "traffic", "along", "back", "any")
ROW: dict[str, Continuous | Categorical] = {
    "models": Categorical(("*",), None),
    "side": Categorical(SIDES, "both"),
    "from": Categorical(FROM, "edge"),
    "out_m": Continuous(-30.0, 200.0, 1.0),
    "step_m": Continuous(0.5, 500.0, None),
    "gap_m": Continuous(0.0, 200.0, 0.0),
    "start_m": Continuous(-100.0, 1500.0, 0.0),
    "end_m": Continuous(-100.0, 2000.0, None),
    "share": Continuous(0.0, 1.0, 1.0),
    "at": Categorical(("steps", "zebras"), "steps"),
    "turn": Categorical(TURNS, "road"),
    "size": Continuous(0.3, 3.0, 1.0),
}
"""Keys of one row of things along the road."""


def read(root: Located, name: str) -> Recipe:
    """A recipe of a road from its YAML.

    Raises:
        RecipeError: with its place.
    """
    parameters = {key: named(parameter) for key, parameter in PARAMETERS.items()}
    items = mapping(root, "a recipe", ("synfog", "world", "about", "lane_section", "rows", "fog", *sections(parameters)))
    check_schema(items, root)
    about = items.get("about")
    if about is not None and not isinstance(about.value, str):
        raise RecipeError(f"{about.place}: about is {about.plain()!r}; it takes one sentence")
    if "lane_section" not in items:
        raise RecipeError(f"{root.place}: a road needs 'lane_section': its lanes from left to right, as in [{{lane: 3.5, way: -1}}, {{lane: 3.5, way: 1}}]")
    lanes = _lanes(items["lane_section"])
    rows = read_rows(items["rows"]) if "rows" in items else ()
    return Recipe(name, about.value if about else "A road.", read_distributions(items, parameters), read_fog(items), rows, lanes)


def named(parameter: Continuous | Categorical) -> Continuous | Categorical:
    """Names that stand for what the library holds become its names: '*sky' its skies, '*GROUP' its models of a group, '*' all models."""
    if not isinstance(parameter, Categorical) or not any(name.startswith("*") for name in parameter.allowed):
        return parameter
    found: list[str] = []
    for name in parameter.allowed:
        if not name.startswith("*"):
            found.append(name)
        elif name == "*sky":
            found += skies()
        else:
            words = name[1:].split()
            found += [one for one in rules.names() if not words or rules.model(one).group in words or one in words]
    default = parameter.default
    return Categorical(tuple(found), {key: weight for key, weight in default.items() if key in found} if isinstance(default, dict) else default)


def _lanes(item: Located) -> tuple[tuple[str, Distribution, int], ...]:
    if not isinstance(item.value, list) or not item.value:
        raise RecipeError(f"{item.place}: lane_section is {item.plain()!r}; it takes a list of lanes from left to right, as in [{{lane: 3.5, way: 1}}]")
    lanes = []
    for lane in item.value:
        if not isinstance(lane.value, dict) or not lane.value:
            raise RecipeError(f"{lane.place}: a lane is {lane.plain()!r}; it takes {{KIND: width, way: 1 or -1}} with KIND one of {', '.join(KINDS)}")
        kinds = [key for key in lane.value if key != "way"]
        for key in kinds:
            if key not in KINDS:
                raise RecipeError(f"{lane.value[key].key_place}: no lane {key!r}; there are {', '.join(KINDS)}.{did_you_mean(key, KINDS)}")
        if len(kinds) != 1:
            raise RecipeError(f"{lane.place}: a lane has one kind, found {', '.join(kinds) or 'none'}")
        kind, way = kinds[0], 0
        if "way" in lane.value:
            way = lane.value["way"].value
            if way not in (1, -1) or isinstance(way, bool):
                raise RecipeError(f"{lane.value['way'].place}: way is {lane.value['way'].plain()!r}; it takes 1 (away from the camera) or -1")
        elif kind in DRIVEN:
            raise RecipeError(f"{lane.place}: {kind} needs its way: 1 (away from the camera) or -1")
        lanes.append((kind, read_distribution(lane.value[kind], f"lane_section: {kind}", Continuous(0.3, 30.0, None)), way if kind in DRIVEN else 0))
    ways = [way for _, _, way in lanes if way]
    if 1 not in ways:
        raise RecipeError(f"{item.place}: no lane has way 1, in which the camera drives")
    if ways != sorted(ways):
        raise RecipeError(f"{item.place}: lanes of way -1 lie left of those of way 1: traffic keeps to the right")
    return tuple(lanes)


def read_rows(item: Located, keys: Mapping[str, Continuous | Categorical] = ROW) -> tuple[Row, ...]:
    """Rows of a recipe, each of whose keys is one of `keys`."""
    if not isinstance(item.value, list):
        raise RecipeError(f"{item.place}: rows is {item.plain()!r}; it takes a list of {{models: ..., side: ..., out_m: ..., step_m: ...}}")
    rows = []
    for row in item.value:
        items = mapping(row, "a row", tuple(keys))
        if "models" not in items:
            raise RecipeError(f"{row.place}: a row needs 'models', one name or {{choice: {{name: weight, ...}}}}")
        found = {}
        for key, parameter in keys.items():
            if key in items:
                found[key] = read_distribution(items[key], f"rows: {key}", named(parameter))
            elif key != "models":
                found[key] = Distribution("fixed", (parameter.default,))
        rows.append(Row(str(row.place), found))
    return tuple(rows)

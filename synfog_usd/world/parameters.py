"""What recipes can say, world by world: every parameter with its limits and what holds without it, and how a recipe is
read.

One language for the crossing, roads and roundabouts: a world takes a set of parameters of it.  Knows nothing of how
a world is drawn.  `reference` makes a page and a JSON Schema of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from synfog_usd.base.errors import RecipeError, did_you_mean
from synfog_usd.base.yamlio import Located
from synfog_usd.world import library
from synfog_usd.world.language import (
    Categorical,
    Continuous,
    Distribution,
    Parameter,
    Recipe,
    Row,
    check_schema,
    mapping,
    read_distribution,
    read_distributions,
    read_fog,
    sections,
)
from synfog_usd.world.roads.asphalt import KINDS as KINDS_OF_ASPHALT
from synfog_usd.world.roads.asphalt import WETNESS
from synfog_usd.world.roads.horizon import KINDS as HORIZONS
from synfog_usd.world.roads.lane_section import DRIVEN, KINDS
from synfog_usd.world.roads.roundabout_markings import GIVE_WAY
from synfog_usd.world.skies import skies

CAR = {"hatchback": 3, "saloon": 3, "estate": 2, "offroader": 2, "van": 1}
PAINTS = ("white", "silver", "grey", "black", "blue", "red", "green", "sand", "yellow")
PEOPLE = {
    "man_walking": 3,
    "woman_walking": 3,
    "student": 2,
    "schoolgirl": 1,
    "child": 1,
    "old_man": 1,
    "man_waiting": 1,
    "woman_phone": 1,
    "woman_pram": 0.5,
    "jogger": 0.5,
    "wheelchair_user": 0.3,
}
WALKERS = (
    "man_walking", "woman_walking", "student", "child", "schoolgirl", "old_man", "jogger", "woman_pram",
    "wheelchair_user",
)  # fmt: skip
LANE = Continuous(0.3, 30.0, None, "width of a lane [m]")

PARKED: dict[str, Parameter] = {
    "parked.share": Continuous(0.0, 1.0, 0.7, "share of the bays that are taken"),
    "parked.bodies": Categorical(("*vehicle",), CAR, "models that park"),
    "parked.paints": Categorical(
        PAINTS, dict.fromkeys(PAINTS, 1), "their paints; a body that comes in none of them takes its own"
    ),
}
TRAFFIC: dict[str, Parameter] = {
    "traffic.hour": Continuous(0.0, 24.0, 12.0, "time of day [h], by which by_hour is read"),
    "traffic.per_hour": Continuous(0.0, 2400.0, 500.0, "flow of a lane [vehicles per hour]"),
    "traffic.speed_kmh": Continuous(5.0, 130.0, 50.0, "speed [km/h]; density is flow over speed"),
    "traffic.headway_s": Continuous(0.3, 5.0, 0.9, "least time between bumpers [s]; 1.5 m come on top"),
    "traffic.count": Continuous(0, 120, None, "vehicles in all, in place of the flow", whole=True),
    "traffic.bodies": Categorical(
        ("*vehicle motorcyclist",), {**CAR, "bus": 0.3, "lorry": 0.6, "motorcyclist": 0.3}, "models that drive"
    ),
    "traffic.paints": Categorical(
        PAINTS, dict.fromkeys(PAINTS, 1), "their paints; a body that comes in none of them takes its own"
    ),
    "traffic.cyclists": Continuous(0, 6, 0, "cyclists ahead of the camera", whole=True),
}
ON_FOOT: dict[str, Parameter] = {
    "people.count": Continuous(0, 80, 0, "people on pavements and zebras", whole=True),
    "people.kinds": Categorical(("*person",), PEOPLE, "models of people"),
    "people.company": Continuous(0.0, 1.0, 0.4, "share of those who can that walk side by side with others"),
    "people.crossing_share": Continuous(0.0, 1.0, 0.3, "share who are on a zebra, where there is one"),
}
SKY: dict[str, Parameter] = {
    "sky.day": Categorical(("*sky",), "overcast_noon", "sky of the lighting `sky`; under `rain` the road is wet"),
    "sky.dusk": Categorical(("*sky",), "dusk_overcast", "sky of the lighting `active`, with lamps"),
    "sky.heading_deg": Continuous(0.0, 360.0, 0.0, "turns the sky clockwise seen from above [degrees]"),
    "sky.gain": Continuous(0.1, 10.0, 1.0, "factor on the luminance of both skies"),
}
LAND: dict[str, Parameter] = {
    "land.hills_m": Continuous(0.0, 40.0, 0.0, "height of the hills around [m]"),
    "land.trees": Continuous(0, 600, 120, "distant trees", whole=True),
    "land.trees_from_m": Continuous(20.0, 200.0, 60.0, "least distance of distant trees from the road [m]"),
    "land.horizon": Categorical(
        HORIZONS, "country", "what closes the view: fields, woods and villages, or a town; and a skyline by seed"
    ),
    "land.grass": Categorical(("tufts", "none"), "tufts", "tall grass where the camera is near"),
}
SURFACE: dict[str, Parameter] = {
    "road.asphalt": Categorical(KINDS_OF_ASPHALT, "worn", "kind and age of the asphalt"),
    "road.wet": Categorical(tuple(WETNESS), "dry", "water on the road"),
}
EGO: dict[str, Parameter] = {
    "camera.height_m": Continuous(1.0, 3.5, 1.45, "height of the lens over the road [m]"),
    "camera.headlights": Categorical(
        ("low_beam_halogen", "low_beam_led", "off"),
        {"low_beam_halogen": 1, "low_beam_led": 1},
        "dipped beams of the camera's car",
    ),
    "camera.rig": Categorical(("single", "stereo", "surround"), "single", "cameras beside the ego's"),
    "camera.baseline_m": Continuous(0.05, 1.0, 0.3, "distance of the right eye of a stereo rig [m]"),
    "camera.fov_x_deg": Continuous(20.0, 100.0, 55.1, "horizontal angle of view [degrees]"),
}
TIME: dict[str, Parameter] = {
    "time.seconds": Continuous(0.0, 120.0, 0.0, "of a clip, in which traffic and people move [s]; 0 for a still"),
    "time.fps": Continuous(1.0, 240.0, 10.0, "its frames a second"),
    "time.wind_m_s": Continuous(
        0.0, 5.0, 0.0, "speed of the wind, with which rain, snow and patches of fog drift [m/s]"
    ),
    "time.wind_deg": Continuous(0.0, 360.0, 90.0, "where the wind blows to, clockwise from north, +Y [degrees]"),
}
RULES: dict[str, Parameter] = {
    "rules.users": Continuous(0, 50, 5, "least number of road users", whole=True),
    "rules.in_view": Continuous(0, 20, 3, "least number of them in view", whole=True),
    "rules.within_m": Continuous(20.0, 300.0, 100.0, "distance that counts as in view [m]"),
}
ROAD: dict[str, Parameter] = {
    "road.length_m": Continuous(150.0, 1500.0, 460.0, "length of the reference line [m]"),
    "road.straight_m": Continuous(0.0, 1000.0, 80.0, "straight before each bend [m]"),
    "road.radius_m": Continuous(30.0, 10000.0, 400.0, "radius of a bend [m]"),
    "road.turn_deg": Continuous(-90.0, 90.0, 0.0, "angle of a bend, positive to the left [degrees]"),
    "road.slope": Continuous(-0.12, 0.12, 0.0, "rise per length at each knot"),
    "road.slope_every_m": Continuous(60.0, 1000.0, 110.0, "distance between knots of the slope [m]"),
    "road.crossfall": Continuous(0.0, 0.07, 0.025, "fall of the carriageway per width, from its crown to the gutters"),
    "road.centre": Categorical(("dashed", "solid", "double", "none"), "dashed", "marking between the directions"),
    "road.dash_m": Continuous(1.0, 12.0, 3.0, "mark of a dashed line [m]"),
    "road.dash_gap_m": Continuous(1.0, 18.0, 6.0, "gap of a dashed line [m]"),
    **SURFACE,
    "road.ditch_m": Continuous(0.0, 1.2, 0.0, "depth of a ditch beyond each edge [m]"),
    "road.zebras": Continuous(0, 3, 0, "zebra crossings", whole=True),
    "road.zebra_ahead_m": Continuous(12.0, 150.0, 30.0, "from the camera, or from one zebra, to the next [m]"),
    **LAND,
    "bridge.ahead_m": Continuous(-60.0, 200.0, 20.0, "from the camera to the valley [m]"),
    "bridge.length_m": Continuous(20.0, 400.0, 0.0, "of the bridge [m]; none without it"),
    "bridge.depth_m": Continuous(4.0, 60.0, 12.0, "of the valley [m]"),
    "tunnel.ahead_m": Continuous(10.0, 200.0, None, "from the camera to the portal [m]; no tunnel without it"),
    "tunnel.height_m": Continuous(13.0, 40.0, 15.0, "of the hill [m]"),
    "rails.where": Categorical(("none", "outer", "median", "all"), "none", "guard rails"),
    "rails.delineators": Categorical(("none", "both"), "none", "white posts every 50 m"),
    "rails.gantry_ahead_m": Continuous(
        20.0, 200.0, None, "from the camera to the first sign gantry [m]; none without it"
    ),
    "works.where": Categorical(("none", "left", "right"), "none", "side of the works beside the carriageway"),
    "works.ahead_m": Continuous(5.0, 200.0, 30.0, "from the camera to the works [m]"),
    **PARKED,
    **TRAFFIC,
    **ON_FOOT,
    **SKY,
    "camera.station_m": Continuous(10.0, 400.0, 90.0, "where the camera is on the reference line [m]"),
    "camera.lane": Continuous(0, 5, 0, "its lane, counted from the right", whole=True),
    **EGO,
    **RULES,
    **TIME,
}
ROUNDABOUT: dict[str, Parameter] = {
    "circle.diameter_m": Continuous(26.0, 60.0, 36.0, "of the inscribed circle [m]"),
    "circle.ring_m": Continuous(4.5, 9.0, 6.0, "width of the lane that goes round [m]"),
    "circle.apron_m": Continuous(0.0, 4.0, 1.5, "width of the truck apron [m]; below 0.8 there is none"),
    "circle.mound_m": Continuous(0.0, 2.5, 0.8, "height of the middle island's grass over its kerb [m]"),
    "circle.corner_m": Continuous(7.0, 25.0, 15.0, "wished radius of the entry and exit arcs [m]"),
    "circle.give_way": Categorical(GIVE_WAY, "teeth", "give-way line"),
    "circle.shrubs": Continuous(0, 120, 30, "shrubs on the middle island", whole=True),
    "circle.trees": Continuous(0, 6, 1, "trees on the middle island", whole=True),
    "circle.tree_models": Categorical(
        ("*plant",), {"birch_tree": 1, "conifer": 1, "maple_tree": 1}, "models of these trees"
    ),
    "arms.count": Continuous(3, 5, 4, "number of arms", whole=True),
    "arms.apart_deg": Continuous(40.0, 120.0, 62.0, "least angle between neighbouring arms [degrees]"),
    "arms.length_m": Continuous(110.0, 600.0, 240.0, "length from the middle [m]"),
    "arms.lane_m": Continuous(2.9, 4.2, 3.4, "width of a lane [m]"),
    "arms.island_m": Continuous(2.0, 5.0, 3.2, "width of the splitter island [m]"),
    "arms.pavement_m": Continuous(1.8, 4.5, 2.6, "width of the pavements [m]"),
    "arms.zebra_m": Continuous(7.2, 11.0, 8.2, "from the circle to the middle of each zebra [m]"),
    "arms.radius_m": Continuous(60.0, 10000.0, 260.0, "radius of a bend of an arm [m]"),
    "arms.turn_deg": Continuous(-60.0, 60.0, 0.0, "angle of a bend of an arm, positive to the left [degrees]"),
    "traffic.ring": Continuous(0, 8, 2, "vehicles that go round", whole=True),
    "camera.before_m": Continuous(14.0, 80.0, 28.0, "from the circle to the camera [m]"),
    **SURFACE,
    **LAND,
    **TRAFFIC,
    **ON_FOOT,
    **SKY,
    **EGO,
    **RULES,
    **TIME,
}
CARS, CROSSING_PEOPLE = (
    tuple(CAR),
    ("man_walking", "woman_walking", "man_waiting", "woman_phone", "student", "child", "old_man"),
)
CROSSROADS: dict[str, Parameter] = {
    "parked.share": PARKED["parked.share"],
    "parked.bodies": Categorical(
        CARS, {"hatchback": 3, "saloon": 2, "estate": 2, "offroader": 2, "van": 1}, "models that park"
    ),
    "parked.paints": replace(PARKED["parked.paints"], default=dict.fromkeys(PAINTS[:-1], 1)),
    "traffic.count": Continuous(0, 24, 10, "vehicles in all", whole=True),
    "traffic.bodies": Categorical((*CARS, "bus", "lorry"), {**CAR, "bus": 1, "lorry": 1}, "models that drive"),
    "traffic.paints": replace(TRAFFIC["traffic.paints"], default=dict.fromkeys(PAINTS[:6], 1)),
    "traffic.speed_kmh": Continuous(5.0, 130.0, 50.0, "speed of who neither waits nor brakes [km/h]"),
    "traffic.main_street": Categorical(
        ("waits", "goes"), {"waits": 1, "goes": 1}, "signals, who drives and who crosses follow"
    ),
    "people.count": Continuous(0, 60, 30, "people on pavements and zebras", whole=True),
    "people.kinds": Categorical(CROSSING_PEOPLE, dict.fromkeys(CROSSING_PEOPLE, 1), "models of people"),
    "people.cyclists": Continuous(0, 1, 1, "cyclists ahead of the camera", whole=True),
    "sky.day": Categorical(("overcast", "*sky"), "overcast", "sky of the lighting `sky`"),
    "sky.dusk": Categorical(("dusk", "*sky"), "dusk", "sky of the lighting `active`, with lamps"),
    "sky.heading_deg": SKY["sky.heading_deg"],
    "sky.overcast_nits": Continuous(200.0, 20000.0, 5000.0, "luminance of `overcast` at the zenith [cd m-2]"),
    "sky.dusk_nits": Continuous(0.1, 200.0, 5.0, "luminance of `dusk` at the zenith [cd m-2]"),
    "camera.height_m": Continuous(1.0, 2.5, 1.45, "height of the lens over the road [m]"),
    "camera.fov_x_deg": EGO["camera.fov_x_deg"],
    **TIME,
}

SIDES = ("left", "right", "both", "alternate")
FROM = ("kerb", "edge", "line")
TURNS = ("road", "traffic", "along", "back", "any")
ROW: dict[str, Parameter] = {
    "models": Categorical(("*",), None, "models of the library, drawn one after the other; needed"),
    "side": Categorical(SIDES, "both", "of the road"),
    "from": Categorical(FROM, "edge", "what `out_m` counts from: the kerb, the section's edge, the reference line"),
    "out_m": Continuous(-30.0, 200.0, 1.0, "how far out the front of each stands [m]"),
    "step_m": Continuous(0.5, 500.0, None, "from one to the next [m]; end to end without it"),
    "gap_m": Continuous(0.0, 200.0, 0.0, "between those that stand end to end [m]"),
    "start_m": Continuous(-100.0, 1500.0, 0.0, "where the row begins, from the camera [m]"),
    "end_m": Continuous(-100.0, 2000.0, None, "where the row ends, from the camera [m]; the road's end without it"),
    "share": Continuous(0.0, 1.0, 1.0, "of the places that are taken"),
    "at": Categorical(("steps", "zebras"), "steps", "where: step by step, or before each zebra"),
    "turn": Categorical(TURNS, "road", "which way each looks: to the road, to who arrives, along, away, anywhere"),
    "size": Continuous(0.3, 3.0, 1.0, "uniform scale"),
}
ROUNDABOUT_ROW: dict[str, Parameter] = {
    **{key: value for key, value in ROW.items() if key not in ("side", "start_m", "end_m", "from", "at")},
    "from": Categorical(("kerb", "edge"), "edge", "what `out_m` counts from: the kerb, or the pavement's edge"),
    "beyond_m": Continuous(0.0, 300.0, 0.0, "stands only where the circle is farther than this [m]"),
    "until_m": Continuous(0.0, 600.0, 600.0, "stands only where the circle is nearer than this [m]"),
}


@dataclass(frozen=True)
class World:
    """What recipes of one world can say.

    Attributes:
        about: what a recipe is about that does not say.
        parameters: by 'section.key'.
        row: keys of one row of props; none where the world takes no rows.
        lanes: whether it needs a lane section.
    """

    about: str
    parameters: Mapping[str, Parameter]
    row: Mapping[str, Parameter]
    lanes: bool = False

    @property
    def keys(self) -> tuple[str, ...]:
        """What may stand at the top of a recipe."""
        more = (*(("lane_section",) if self.lanes else ()), *(("rows",) if self.row else ()))
        return ("synfog", "world", "about", *more, "fog", *sections(self.parameters))


WORLDS: Mapping[str, World] = {
    "crossroads": World("A crossing of two city streets.", CROSSROADS, {}),
    "road": World("A road.", ROAD, ROW, lanes=True),
    "roundabout": World("A roundabout.", ROUNDABOUT, ROUNDABOUT_ROW),
}
"""World -> what its recipes can say; the first is meant where a recipe names none."""


def world_of(root: Located) -> str:
    """Which of WORLDS a recipe is of.

    Raises:
        RecipeError: none of them.
    """
    item = root.value.get("world") if isinstance(root.value, dict) else None
    if item is None:
        return next(iter(WORLDS))
    if item.value not in WORLDS:
        raise RecipeError(
            f"{item.place}: world is {item.plain()!r}; it takes "
            f"{', '.join(WORLDS)}.{did_you_mean(str(item.plain()), WORLDS)}"
        )
    return str(item.value)


def read(root: Located, name: str) -> Recipe:
    """A recipe from its YAML.

    Raises:
        RecipeError: a section, key or value that is not known, with its place.
    """
    world = WORLDS[world_of(root)]
    items = mapping(root, "a recipe", world.keys)
    check_schema(items, root)
    about = items.get("about")
    if about is not None and not isinstance(about.value, str):
        raise RecipeError(f"{about.place}: about is {about.plain()!r}; it takes one sentence")
    if world.lanes and "lane_section" not in items:
        raise RecipeError(
            f"{root.place}: a road needs 'lane_section': its lanes from left to right, as in [{{lane: 3.5, way: -1}}, "
            f"{{lane: 3.5, way: 1}}]"
        )
    parameters = {key: named(parameter) for key, parameter in world.parameters.items()}
    return Recipe(
        name,
        world_of(root),
        about.value if about else world.about,
        read_distributions(items, parameters),
        read_fog(items),
        _rows(items["rows"], world.row) if "rows" in items else (),
        _lanes(items["lane_section"]) if world.lanes else (),
    )


def named(parameter: Parameter) -> Parameter:
    """Names that stand for what the library holds become its names: '*sky' its skies, '*GROUP' its models of a group,
    '*' all models.
    """
    if not isinstance(parameter, Categorical) or not any(name.startswith("*") for name in parameter.allowed):
        return parameter
    names: list[str] = []
    for name in parameter.allowed:
        if not name.startswith("*"):
            names.append(name)
        elif name == "*sky":
            names += skies()
        else:
            words = name[1:].split()
            names += [
                model for model in library.names() if not words or library.model(model).group in words or model in words
            ]
    default = parameter.default
    weights = {key: weight for key, weight in default.items() if key in names} if isinstance(default, dict) else default
    return replace(parameter, allowed=tuple(names), default=weights)


def _lanes(item: Located) -> tuple[tuple[str, Distribution, int], ...]:
    if not isinstance(item.value, list) or not item.value:
        raise RecipeError(
            f"{item.place}: lane_section is {item.plain()!r}; it takes a list of lanes from left to right, as in "
            f"[{{lane: 3.5, way: 1}}]"
        )
    lanes = tuple(map(_lane, item.value))
    ways = [way for _, _, way in lanes if way]
    if 1 not in ways:
        raise RecipeError(f"{item.place}: no lane has way 1, in which the camera drives")
    if ways != sorted(ways):
        raise RecipeError(f"{item.place}: lanes of way -1 lie left of those of way 1: traffic keeps to the right")
    return lanes


def _lane(item: Located) -> tuple[str, Distribution, int]:
    """A lane's kind, width, and way: 1, -1, or 0 where nobody drives."""
    if not isinstance(item.value, dict) or not item.value:
        raise RecipeError(
            f"{item.place}: a lane is {item.plain()!r}; it takes {{KIND: width, way: 1 or -1}} with KIND one of "
            f"{', '.join(KINDS)}"
        )
    kinds = [key for key in item.value if key != "way"]
    for kind in kinds:
        if kind not in KINDS:
            raise RecipeError(
                f"{item.value[kind].key_place}: no lane {kind!r}; there are "
                f"{', '.join(KINDS)}.{did_you_mean(kind, KINDS)}"
            )
    if len(kinds) != 1:
        raise RecipeError(f"{item.place}: a lane has one kind, found {', '.join(kinds) or 'none'}")
    way = _way(item, kinds[0])
    return kinds[0], read_distribution(item.value[kinds[0]], f"lane_section: {kinds[0]}", LANE), way


def _way(lane: Located, kind: str) -> int:
    if "way" not in lane.value:
        if kind in DRIVEN:
            raise RecipeError(f"{lane.place}: {kind} needs its way: 1 (away from the camera) or -1")
        return 0
    way = lane.value["way"]
    if way.value not in (1, -1) or isinstance(way.value, bool):
        raise RecipeError(f"{way.place}: way is {way.plain()!r}; it takes 1 (away from the camera) or -1")
    return int(way.value) if kind in DRIVEN else 0


def _rows(item: Located, keys: Mapping[str, Parameter]) -> tuple[Row, ...]:
    """Rows of a recipe, each of whose keys is one of `keys`."""
    if not isinstance(item.value, list):
        raise RecipeError(
            f"{item.place}: rows is {item.plain()!r}; it takes a list of {{models: ..., side: ..., out_m: ..., step_m: "
            f"...}}"
        )
    rows = []
    for row in item.value:
        items = mapping(row, "a row", tuple(keys))
        if "models" not in items:
            raise RecipeError(f"{row.place}: a row needs 'models', one name or {{choice: {{name: weight, ...}}}}")
        distributions = {}
        for key, parameter in keys.items():
            if key in items:
                distributions[key] = read_distribution(items[key], f"rows: {key}", named(parameter))
            elif key != "models":
                distributions[key] = Distribution("fixed", (parameter.default,))
        rows.append(Row(str(row.place), distributions))
    return tuple(rows)

"""Draws of the crossing: who drives, parks and walks on its streets, and in which light and fog.

Every parameter draws from a stream of its own name, so that changing one leaves
what the others draw as it was.  Nothing stands in anything else: cars follow each
other in lanes and stand one to a bay, and people look for a free spot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synfog_usd.errors import RecipeError
from synfog_usd.seeds import seed32, stream
from synfog_usd.world.authoring import focal_length
from synfog_usd.world.language import Distribution, Recipe
from synfog_usd.world.library import nominal
from synfog_usd.world.parameters import WALKERS
from synfog_usd.world.roads import crossing_props, rules
from synfog_usd.world.roads.crossing import MAIN_HALF, ZEBRA, ZEBRA_DEPTH, ZEBRA_SIDE, Crossing
from synfog_usd.world.roads.crossing_props import stood
from synfog_usd.world.roads.props import draw_car, look
from synfog_usd.world.spec import Placement, SkyDome, WorldSpec

WIDE = ("bus", "lorry")
"""Bodies that keep nearer to the middle of the street, away from parked cars' mirrors."""
BAY_M = 5.8
PARKED_X = 4.5
NEAREST_LIT = 8
"""Cars in traffic whose headlights are lights; the others' lenses glow.  Each light costs noise in every pixel."""
LIT_Y = 80.0
CROSSING_SHARE = 0.3
"""Share of the people who are on the zebra crossings of the street that waits."""
ROOM_M = {"bench": 1.4, "advertising_column": 1.3, "cabinet": 1.1, "bicycle": 1.3}
"""How far people keep from the middle of a thing; from all others ROOM_ELSE_M."""
ROOM_ELSE_M = 0.75
TRIES = 400


def draw(recipe: Recipe, *, seed: int) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: more people than there is room for.
    """

    def value(name: str) -> Any:
        return recipe.distributions[name](stream(seed, "recipe", name))

    waits = value("traffic.main_street") == "waits"
    cars = [*_parked(recipe, seed, value("parked.share")), *_traffic(recipe, seed, value("traffic.count"), waits)]
    cars = [replace(car, name=f"{car.asset.title()}_{index + 1:02d}") for index, car in enumerate(cars)]
    fixed = [
        *crossing_props.ground(),
        *crossing_props.houses(),
        *_furniture(waits),
        *crossing_props.trees(),
        *crossing_props.parked_bicycles(),
    ]
    people = _people(
        recipe, seed, value("people.count"), waits, [p for p in fixed if p.group not in ("Ground", "Buildings")]
    )
    riders = _cyclist(seed) if value("people.cyclists") else []
    fog = recipe.fog_variants(seed)
    lens = focal_length(value("camera.fov_x_deg"))
    return WorldSpec(
        about=f"{recipe.about.removesuffix('.')}, drawn from {recipe.name} with seed {seed}.",
        placed=(*fixed, *cars, *people, *riders),
        view=replace(crossing_props.VIEW, z=round(value("camera.height_m"), 3), focal_length=lens),
        fog=fog,
        fog_selected=list(fog)[len(fog) // 2],
        day=_dome(value("sky.day"), "overcast", round(value("sky.overcast_nits"), 1), value("sky.heading_deg")),
        dusk=_dome(value("sky.dusk"), "dusk", round(value("sky.dusk_nits"), 3), value("sky.heading_deg")),
        road=Crossing(),
        scatter=seed32(seed, "recipe", "scatter"),
        origin={"recipe": recipe.name, "seed": str(seed)},
        built=crossing_props.BUILT,
        products=False,
    )


def _dome(sky: str, relative: str, nits: float, heading_deg: float) -> SkyDome:
    """The crossing's own sky, with its luminance at the zenith, or one of `skies`, which has its own."""
    return SkyDome(sky, nits) if sky == relative else SkyDome(sky, 1.0, round(heading_deg, 1))


# -- placing


@dataclass(frozen=True)
class _Lane:
    """A straight piece of lane that cars fill from `start` on.

    Attributes:
        along: 'y' or 'x'; across: the other coordinate [m].
        start, end: where the first car's near bumper and the last one's far bumper may be [m].
        heading: degrees.
        weight: share of the traffic.
        queue: whether the first cars stand close, nose to tail.
    """

    along: str
    across: float
    start: float
    end: float
    heading: float
    weight: float
    queue: bool = False


_STOP = ZEBRA + ZEBRA_DEPTH + 1.9
_STOP_SIDE = ZEBRA_SIDE + ZEBRA_DEPTH + 1.9
_LANES = {
    "waits": (
        _Lane("y", 1.76, _STOP, 235.0, 0.0, 3),
        _Lane("y", -1.8, _STOP, 235.0, 180.0, 4, queue=True),
        _Lane("y", -1.85, -_STOP, -62.0, 180.0, 1),
        _Lane("x", -2.08, -60.0, 60.0, -90.0, 1.5),
        _Lane("x", 2.12, -60.0, 60.0, 90.0, 1.5),
    ),
    "goes": (
        _Lane("y", 1.76, -8.0, 235.0, 0.0, 4),
        _Lane("y", -1.8, -62.0, 235.0, 180.0, 4),
        _Lane("x", -2.08, -_STOP_SIDE, -60.0, -90.0, 1, queue=True),
        _Lane("x", 2.12, _STOP_SIDE, 60.0, 90.0, 1, queue=True),
    ),
}
"""Where traffic may be while the main street waits or goes.  The camera's own lane stays free up to the crossing."""
_GAP_M = 4.0
_QUEUE = 3
_QUEUE_GAP_M = (1.2, 2.5)


def _parked(recipe: Recipe, seed: int, share: float) -> list[Placement]:
    """One car to a bay of the markings, on both sides of the main street, from behind the camera to the far end."""
    placed = []
    first = 20.0 + BAY_M / 2
    bays = [*np.arange(-first, -60.0, -BAY_M), *np.arange(first, 238.0, BAY_M)]
    for side in (-1, 1):
        for index, y in enumerate(bays):
            rng = stream(seed, "recipe", "parked", side, index)
            taken = rng.random() < share
            body, looks = draw_car(recipe, "parked", rng)
            x, y = side * PARKED_X + np.clip(rng.normal(0, 0.04), -0.08, 0.08), y + rng.uniform(-0.12, 0.12)
            if taken:
                placed.append(
                    stood(
                        "Vehicles", "", body, round(float(x), 3), round(float(y), 3), 180.0 if side < 0 else 0.0, looks
                    )
                )
    return placed


def _traffic(recipe: Recipe, seed: int, count: int, waits: bool) -> list[Placement]:
    lanes = _LANES["waits" if waits else "goes"]
    choice = Distribution("choice", tuple(range(len(lanes))), tuple(lane.weight for lane in lanes))
    rng = stream(seed, "recipe", "traffic", "lanes")
    bound: list[list[tuple[str, float, dict[str, str]]]] = [[] for _ in lanes]
    for index in range(count):
        body, looks = draw_car(recipe, "traffic", stream(seed, "recipe", "traffic", "car", index))
        car = (body, nominal()[body]["length_m"], looks)
        fitting = [
            n
            for n, lane in enumerate(lanes)
            if sum(length + _GAP_M for _, length, _ in [*bound[n], car]) <= abs(lane.end - lane.start)
        ]
        if not fitting:
            raise AssertionError("the limit of traffic.count leaves room for as many buses")
        bound[choice(rng, fitting)].append(car)  # type: ignore[arg-type]
    placed = []
    for number, (lane, cars) in enumerate(zip(lanes, bound, strict=True)):
        rng = stream(seed, "recipe", "traffic", "lane", number)
        free = abs(lane.end - lane.start) - sum(length + _GAP_M for _, length, _ in cars)
        slack = np.sort(rng.uniform(0.0, free, len(cars)))
        at, before = 0.0, 0.0
        for index, (body, length, looks) in enumerate(cars):
            queued = lane.queue and index < _QUEUE
            gap = float(rng.uniform(*_QUEUE_GAP_M)) * (index > 0) if queued else float(slack[index] - before) + _GAP_M
            before = 0.0 if queued else float(slack[index])
            middle = math.copysign(1.0, lane.end - lane.start) * (at + gap + length / 2) + lane.start
            at += gap + length
            near, sway = (0.9, 0.04) if body in WIDE else (1.0, 0.1)
            across = near * lane.across + float(rng.uniform(-sway, sway))
            x, y = (across, middle) if lane.along == "y" else (middle, across)
            placed.append(stood("Vehicles", "", body, round(x, 3), round(y, 3), lane.heading, looks, {"lamps": "glow"}))
    view = crossing_props.VIEW
    nearest = sorted((p for p in placed if p.y < LIT_Y), key=lambda p: (math.hypot(p.x - view.x, p.y - view.y), p.x))[
        :NEAREST_LIT
    ]
    return [replace(p, lit={"lamps": "on"}) if p in nearest else p for p in placed]


def _furniture(waits: bool) -> list[Placement]:
    """The shipped furniture with the signals of the phase."""
    placed = []
    for p in crossing_props.furniture():
        if "signal" in p.variants:
            main = abs(p.x) < abs(p.y)
            p = replace(p, variants={"signal": "red" if main == waits else "green"})
        placed.append(p)
    return placed


def _people(recipe: Recipe, seed: int, count: int, waits: bool, props: Sequence[Placement]) -> list[Placement]:
    kinds = recipe.distributions["people.kinds"]
    walkers = [kind for kind in kinds.values if kind in WALKERS]
    keep = [(p.x, p.y, ROOM_M.get(p.asset, ROOM_ELSE_M)) for p in props]
    placed: list[Placement] = []
    for index in range(count):
        rng = stream(seed, "recipe", "person", index)
        crosses = bool(walkers) and rng.random() < CROSSING_SHARE
        kind = kinds(rng, walkers if crosses else None)
        looks = look(rng, rules.model(kind))
        for _ in range(TRIES):
            x, y, heading = _crossing(rng, waits) if crosses else _on_pavement(rng, kind)
            if all(math.hypot(x - a, y - b) >= room for a, b, room in keep):
                break
        else:
            raise RecipeError(f"{recipe.name}: people.count {count}: no room for more than {index}")
        keep.append((x, y, ROOM_ELSE_M))
        placed.append(stood("People", f"Person_{index + 1:02d}", kind, x, y, heading, looks))
    return placed


def _crossing(rng: np.random.Generator, waits: bool) -> tuple[float, float, float]:
    """On a zebra of the street that waits; walkers look along it, one way or the other."""
    side, way = (int(sign) for sign in rng.choice((-1, 1), 2))
    turn = float(rng.normal(0, 3))
    if waits:
        x, y, heading = (
            rng.uniform(-MAIN_HALF + 0.8, MAIN_HALF - 0.8),
            side * rng.uniform(ZEBRA + 0.4, ZEBRA + ZEBRA_DEPTH - 0.4),
            90.0 * way,
        )
    else:
        x, y, heading = (
            side * rng.uniform(ZEBRA_SIDE + 0.4, ZEBRA_SIDE + ZEBRA_DEPTH - 0.4),
            rng.uniform(-3.6, 3.6),
            90.0 * (1 - way),
        )
    return round(float(x), 3), round(float(y), 3), round(heading + turn, 1)


def _on_pavement(rng: np.random.Generator, kind: str) -> tuple[float, float, float]:
    """Beside the main street, denser where the camera looks from near; walkers along it, the others any way."""
    side, way = (int(sign) for sign in rng.choice((-1, 1), 2))
    y = -30.0 + 150.0 * rng.random() ** 1.5
    if abs(y) < ZEBRA:
        y = math.copysign(ZEBRA + 4.0 * rng.random(), y)
    x = side * rng.uniform(7.3, 8.7)
    heading = 90.0 - 90.0 * way + rng.normal(0, 4) if kind in WALKERS else rng.uniform(0, 360)
    return round(float(x), 3), round(float(y), 3), round(float(heading), 1)


def _cyclist(seed: int) -> list[Placement]:
    """One ahead of the camera, at the kerb side of its lane."""
    rng = stream(seed, "recipe", "cyclist")
    x, y, heading = (
        round(float(rng.uniform(2.5, 2.8)), 3),
        round(float(rng.uniform(-27.0, -18.5)), 3),
        round(float(rng.normal(0, 1)), 1),
    )
    outfit, colour = "ab"[int(rng.integers(2))], ("teal", "black", "red")[int(rng.integers(3))]
    return [
        stood("People", "Rider_1", "rider", x, y, heading, {"outfit": outfit}),
        stood("Vehicles", "Bicycle_1", "bicycle", x, y, heading, {"colour": colour}),
    ]

"""Draws of roundabouts.

Rows stand along the kerbs: in along one arm, round the circle, out along the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from synfog_usd.base.errors import RecipeError
from synfog_usd.base.seeds import seed32, stream
from synfog_usd.world.authoring import focal_length
from synfog_usd.world.language import Distribution, Recipe
from synfog_usd.world.roads import actors, props, roundabout_actors, rules
from synfog_usd.world.roads import recipe as roads
from synfog_usd.world.roads.network import Land
from synfog_usd.world.roads.reference_line import ReferenceLine, bends
from synfog_usd.world.roads.roundabout import STRAIGHT_M, Roundabout, roundabout
from synfog_usd.world.spec import Placement, View, WorldSpec

TRIES = 60
APRON_LEAST_M = 0.8
"""An apron narrower than that is none: no wheel would find it."""


def draw(recipe: Recipe, *, seed: int) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: a rule cannot be met, or the arms find no room at the circle; says which.
    """
    hour = float(recipe.distributions["traffic.hour"](stream(seed, "recipe", "traffic.hour")))

    def value(name: str) -> Any:
        return recipe.distributions[name](stream(seed, "recipe", name), hour=hour)

    junction = _junction(recipe, seed)
    before = round(junction.radius + value("camera.before_m"), 2)
    if before + 30.0 > junction.reference_line.length:
        raise RecipeError(
            f"{recipe.name}: camera.before_m leaves less than 30 m of the arm's {junction.reference_line.length:g} m "
            f"behind the camera; raise arms.length_m"
        )
    fov = value("camera.fov_x_deg")
    x, y, z, heading = junction.lane_pose(0, before, -1, -0.15)
    view = View(x, y, round(z + value("camera.height_m"), 3), 90.6, round(heading + 0.8, 3), focal_length(fov))
    taken = rules.CollisionSet()
    fixed = [
        *_island(recipe, junction, seed, value("circle.trees"), taken),
        *_signs(junction, taken),
        *_rows(recipe, junction, seed, taken),
    ]

    def drawn(attempt: int, room: rules.CollisionSet) -> list[Placement]:
        return roundabout_actors.drawn(recipe, junction, seed, attempt, before, value, view, room)

    moving = actors.in_sight(recipe, drawn, junction, value, view, fov, fixed, taken)
    built = {"station": before, "give_way": value("circle.give_way"), "shrubs": value("circle.shrubs")}
    return roads.assembled(recipe, seed, value, junction, view, [*fixed, *moving], built)


def _junction(recipe: Recipe, seed: int) -> Roundabout:
    """The circle and its arms; arms that find no room at it are drawn again."""
    failed: RecipeError | None = None
    for attempt in range(TRIES):

        def value(name: str, *more: int, attempt: int = attempt) -> Any:
            return recipe.distributions[name](stream(seed, "recipe", name, *more, *([attempt] if attempt else [])))

        count, apart = value("arms.count"), value("arms.apart_deg")
        spare = 360.0 - count * apart
        if spare < 0:
            failed = RecipeError(
                f"arms.apart_deg {apart:.3g}: {count} arms do not find it in a circle; draw a smaller one or fewer "
                f"arms.count"
            )
            continue
        gaps = apart + spare * stream(seed, "recipe", "arms", "angles", attempt).dirichlet(np.full(count, 4.0))
        headings = 180.0 + np.r_[0.0, np.cumsum(gaps)[:-1]]
        length = round(value("arms.length_m"), 1)
        lines = []
        for arm, heading in enumerate(headings):
            pieces = [
                (STRAIGHT_M if i == 0 else 15.0, value("arms.radius_m", arm, i), value("arms.turn_deg", arm, i))
                for i in range(5)
            ]
            lines.append(
                ReferenceLine(length, bends(pieces, length=length), origin=(0.0, 0.0, round(float(heading), 3)))
            )
        try:
            return roundabout(
                lines,
                radius=round(value("circle.diameter_m") / 2, 3),
                ring_m=round(value("circle.ring_m"), 3),
                apron=round(value("circle.apron_m"), 3) if value("circle.apron_m") >= APRON_LEAST_M else 0.0,
                mound=round(value("circle.mound_m"), 3),
                lane_m=round(value("arms.lane_m"), 3),
                half_island=round(value("arms.island_m") / 2, 3),
                pavement=round(value("arms.pavement_m"), 3),
                zebra_m=round(value("arms.zebra_m"), 3),
                corner_m=round(value("circle.corner_m"), 3),
                land=Land(round(value("land.hills_m"), 2), seed32(seed, "recipe", "land")),
            )
        except RecipeError as error:
            failed = error
    raise RecipeError(f"{recipe.name}: {failed}; {TRIES} tries")


def _island(recipe: Recipe, junction: Roundabout, seed: int, trees: int, taken: rules.CollisionSet) -> list[Placement]:
    """Chevron boards on the middle island that face each arm, and trees on its top."""
    found = []
    for arm in junction.arms:
        heading, r = arm.reference_line.origin[2], junction.island - 0.75
        h = math.radians(heading)
        place = junction.stand(-r * math.sin(h), r * math.cos(h))
        found.append(props.stood("sign_chevron", place, rules.facing(heading), {}))
    for number in range(trees):
        rng = stream(seed, "recipe", "circle.tree", number)
        asset = recipe.distributions["circle.tree_models"](rng)
        r, a = 0.45 * junction.island * math.sqrt(rng.random()), rng.uniform(0, 2 * math.pi)
        size = min(1.0, 0.1 + junction.island / 12.0) * float(rng.uniform(0.55, 0.8))
        found.append(
            props.stood(
                asset,
                junction.stand(r * math.cos(a), r * math.sin(a)),
                rules.facing(float(rng.uniform(0, 360))),
                props.look(rng, rules.model(asset)),
                round(size, 3),
            )
        )
    return [p for p in found if taken.take(p, 0.3)]


def _signs(junction: Roundabout, taken: rules.CollisionSet) -> list[Placement]:
    """Give way at every entry, and the zebra's sign before it, on the right as one arrives; both face who does."""
    found = []
    for arm, road in enumerate(junction.arms):
        for asset, s in (("sign_give_way", junction.radius + 3.6), ("sign_crossing", road.zebras[0] + 2.9)):
            t = -(float(junction.edge(arm, -1, s)) + 0.6)
            x, y = road.reference_line.place(s, t)
            u, _ = junction.across(x, y)
            shift = 0.55 - float(u)  # the arc comes in at a slant
            x, y = road.reference_line.place(s, t - shift)
            found.append(props.stood(asset, junction.stand(x, y), rules.facing(road.reference_line.origin[2]), {}))
    return [p for p in found if taken.take(p)]


def _rows(recipe: Recipe, junction: Roundabout, seed: int, taken: rules.CollisionSet) -> list[Placement]:
    """Rows in their order, corner after corner; what has no room is left out."""
    placed: list[Placement] = []
    for number, row in enumerate(recipe.rows):
        for corner in range(len(junction.arms)):
            rng = stream(seed, "recipe", "rows", number, corner)
            placed += _row(junction, corner, row.distributions, rng, taken)
    return placed


def _row(
    junction: Roundabout,
    corner: int,
    distributions: Mapping[str, Distribution],
    rng: np.random.Generator,
    taken: rules.CollisionSet,
) -> list[Placement]:
    line, span = junction.outline, junction.outline.span(corner)
    base, normals = line.points[span], line.normals[span]
    behind = junction.pavement if distributions["from"](rng) == "edge" else 0.0
    beyond = junction.radius + float(distributions["beyond_m"](rng))
    until = junction.radius + float(distributions["until_m"](rng))
    out = behind + float(distributions["out_m"](rng))
    front = base + out * normals  # what stands end to end is measured where its front is
    at = np.r_[0.0, np.cumsum(np.hypot(*np.diff(front, axis=0).T))]

    def places(prop: props.Prop, stations: Sequence[float]) -> Iterator[tuple[float, Placement]]:
        for s in stations:
            k = int(np.searchsorted(at, s))
            if k >= len(at) or not beyond <= math.hypot(*base[k]) <= until:
                return
            nx, ny = normals[k]
            x, y = (round(float(v), 3) + 0.0 for v in base[k] + (behind + prop.out) * normals[k])  # no -0.0
            angle = {
                "road": math.atan2(nx, -ny),
                "back": math.atan2(-nx, ny),
                "traffic": math.atan2(-ny, -nx),
                "along": math.atan2(ny, nx),
            }
            heading = math.degrees(angle[prop.turned]) if prop.turned in angle else prop.any_way
            p = props.stood(prop.asset, (x, y, 0.0), round(heading, 2), prop.looks, prop.size)
            if _beside(junction, p, behind + prop.out):
                yield s, replace(p, z=junction.stand(x, y)[2])

    return props.row(distributions, props.Front(places, float(at[-1])), rng, taken)


def _beside(junction: Roundabout, p: Placement, out: float) -> bool:
    """Whether a thing keeps off the carriageways, off the pavements where it stands behind them, and off what is
    lowered for who crosses.
    """
    corners = rules.footprint(p)
    edges = np.concatenate([corners, (corners + np.roll(corners, 1, axis=0)) / 2])
    u, kerb = junction.across(edges[:, 0], edges[:, 1])
    if out >= junction.pavement:
        return bool((u > junction.pavement + 0.02).all())
    return bool((u > 0.12).all() and (kerb > 0.119).all())

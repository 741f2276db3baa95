"""Draws of roundabouts.

Rows stand along the kerbs: in along one arm, round the circle, out along the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from synfog_usd.base.errors import RecipeError
from synfog_usd.base.seeds import seed32
from synfog_usd.world import library
from synfog_usd.world.authoring import focal_length
from synfog_usd.world.language import Distribution, Draws
from synfog_usd.world.roads import actors, props, roundabout_actors, rules
from synfog_usd.world.roads import recipe as roads
from synfog_usd.world.roads.network import Land
from synfog_usd.world.roads.reference_line import ReferenceLine, bends
from synfog_usd.world.roads.roundabout import STRAIGHT_M, Arm, Circle, Roundabout, roundabout
from synfog_usd.world.spec import Placement, View, WorldSpec

TRIES = 60
APRON_LEAST_M = 0.8
"""An apron narrower than that is none: no wheel would find it."""


def draw(draws: Draws) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: a rule cannot be met, or the arms find no room at the circle; says which.
    """
    junction = _junction(draws)
    before = round(junction.radius + draws.number("camera.before_m"), 2)
    if before + 30.0 > junction.reference_line.length:
        raise RecipeError(
            f"{draws.recipe.name}: camera.before_m leaves less than 30 m of the arm's "
            f"{junction.reference_line.length:g} m behind the camera; raise arms.length_m"
        )
    fov_x_deg = draws.number("camera.fov_x_deg")
    x, y, z, heading = junction.lane_pose(0, before, -1, -0.15)
    lens_z = round(z + draws.number("camera.height_m"), 3)
    view = View(x, y, lens_z, 90.6, round(heading + 0.8, 3), focal_length(fov_x_deg))
    occupied = rules.CollisionSet()
    fixed = [*_island(draws, junction, occupied), *_signs(junction, occupied), *_rows(draws, junction, occupied)]

    def attempt_of(attempt: int, room: rules.CollisionSet) -> list[Placement]:
        return roundabout_actors.moving(draws, junction, attempt, before, view, room)

    moving = actors.in_sight(draws, attempt_of, junction, view, fov_x_deg, fixed, occupied)
    shrubs = draws.whole("circle.shrubs")
    built = {"station": before, "give_way": draws.word("circle.give_way"), "shrubs": shrubs}
    return roads.assembled(draws, junction, view, [*fixed, *moving], built)


def _junction(draws: Draws) -> Roundabout:
    """The circle and its arms; arms that find no room at it are drawn again."""
    failed: RecipeError | None = None
    for attempt in range(TRIES):
        try:
            return _attempt(draws, (attempt,) if attempt else ())
        except RecipeError as error:
            failed = error
    raise RecipeError(f"{draws.recipe.name}: {failed}; {TRIES} tries")


def _attempt(draws: Draws, again: tuple[int, ...]) -> Roundabout:
    """One attempt at a circle and its arms.

    Args:
        draws: what is drawn.
        again: number of the attempt, for its streams; () for the first.

    Raises:
        RecipeError: the arms find no room.
    """

    def metres(name: str, digits: int = 3) -> float:
        return round(draws.number(name, *again), digits)

    count, apart = draws.whole("arms.count", *again), draws.number("arms.apart_deg", *again)
    spare = 360.0 - count * apart
    if spare < 0:
        raise RecipeError(
            f"arms.apart_deg {apart:.3g}: {count} arms do not find it in a circle; draw a smaller one or fewer "
            f"arms.count"
        )
    angles = draws.stream("arms", "angles", *(again or (0,)))
    gaps = apart + spare * angles.dirichlet(np.full(count, 4.0))
    headings = 180.0 + np.r_[0.0, np.cumsum(gaps)[:-1]]
    length = metres("arms.length_m", 1)
    lines = []
    for arm, heading in enumerate(headings):
        radii = [draws.number("arms.radius_m", arm, i, *again) for i in range(5)]
        turns = [draws.number("arms.turn_deg", arm, i, *again) for i in range(5)]
        pieces = list(zip((STRAIGHT_M, 15.0, 15.0, 15.0, 15.0), radii, turns, strict=True))
        origin = (0.0, 0.0, round(float(heading), 3))
        lines.append(ReferenceLine(length, bends(pieces, length=length), origin=origin))
    apron = metres("circle.apron_m")
    return roundabout(
        lines,
        Circle(
            radius=round(draws.number("circle.diameter_m", *again) / 2, 3),
            ring=metres("circle.ring_m"),
            apron=apron if draws.number("circle.apron_m", *again) >= APRON_LEAST_M else 0.0,
            mound=metres("circle.mound_m"),
            corner=metres("circle.corner_m"),
        ),
        Arm(
            lane=metres("arms.lane_m"),
            half_island=round(draws.number("arms.island_m", *again) / 2, 3),
            pavement=metres("arms.pavement_m"),
            zebra=metres("arms.zebra_m"),
        ),
        Land(metres("land.hills_m", 2), seed32(draws.seed, "recipe", "land")),
    )


def _island(draws: Draws, junction: Roundabout, occupied: rules.CollisionSet) -> list[Placement]:
    """Chevron boards on the middle island that face each arm, and trees on its top."""
    placed = []
    for arm in junction.arms:
        heading, r = arm.reference_line.origin[2], junction.island - 0.75
        h = math.radians(heading)
        place = junction.stand(-r * math.sin(h), r * math.cos(h))
        placed.append(props.standing("sign_chevron", place, rules.facing(heading), {}))
    for number in range(draws.whole("circle.trees")):
        rng = draws.stream("circle.tree", number)
        asset = draws.recipe.distributions["circle.tree_models"].word(rng)
        r, a = 0.45 * junction.island * math.sqrt(rng.random()), rng.uniform(0, 2 * math.pi)
        size = min(1.0, 0.1 + junction.island / 12.0) * float(rng.uniform(0.55, 0.8))
        place = junction.stand(r * math.cos(a), r * math.sin(a))
        heading = rules.facing(float(rng.uniform(0, 360)))
        placed.append(props.standing(asset, place, heading, props.look(rng, library.model(asset)), round(size, 3)))
    return [p for p in placed if occupied.take(p, 0.3)]


def _signs(junction: Roundabout, occupied: rules.CollisionSet) -> list[Placement]:
    """Give way at every entry, and the zebra's sign before it, on the right as one arrives; both face who does."""
    placed = []
    for arm, road in enumerate(junction.arms):
        for asset, s in (("sign_give_way", junction.radius + 3.6), ("sign_crossing", road.zebras[0] + 2.9)):
            t = -(float(junction.edge(arm, -1, s)) + 0.6)
            x, y = road.reference_line.place(s, t)
            u, _ = junction.across(x, y)
            shift = 0.55 - float(u)  # the arc comes in at a slant
            x, y = road.reference_line.place(s, t - shift)
            placed.append(props.standing(asset, junction.stand(x, y), rules.facing(road.reference_line.origin[2]), {}))
    return [p for p in placed if occupied.take(p)]


def _rows(draws: Draws, junction: Roundabout, occupied: rules.CollisionSet) -> list[Placement]:
    """Rows in their order, corner after corner; what has no room is left out."""
    placed: list[Placement] = []
    for number, row in enumerate(draws.recipe.rows):
        for corner in range(len(junction.arms)):
            rng = draws.stream("rows", number, corner)
            placed += _row(junction, corner, row.distributions, rng, occupied)
    return placed


def _row(
    junction: Roundabout,
    corner: int,
    distributions: Mapping[str, Distribution],
    rng: np.random.Generator,
    occupied: rules.CollisionSet,
) -> list[Placement]:
    line, span = junction.outline, junction.outline.span(corner)
    base, normals = line.points[span], line.normals[span]
    behind = junction.pavement if distributions["from"](rng) == "edge" else 0.0
    beyond = junction.radius + float(distributions["beyond_m"].number(rng))
    until = junction.radius + float(distributions["until_m"].number(rng))
    out = behind + float(distributions["out_m"].number(rng))
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
            p = props.standing(prop.asset, (x, y, 0.0), round(heading, 2), prop.looks, prop.size)
            if _clear(junction, p, behind + prop.out):
                yield s, replace(p, z=junction.stand(x, y)[2])

    return props.row(distributions, props.Front(places, float(at[-1])), rng, occupied)


def _clear(junction: Roundabout, p: Placement, out: float) -> bool:
    """Whether a thing keeps off the carriageways, off the pavements where it stands behind them, and off what is
    lowered for who crosses.
    """
    corners = rules.footprint(p)
    edges = np.concatenate([corners, (corners + np.roll(corners, 1, axis=0)) / 2])
    u, kerb = junction.across(edges[:, 0], edges[:, 1])
    if out >= junction.pavement:
        return bool((u > junction.pavement + 0.02).all())
    return bool((u > 0.12).all() and (kerb > 0.119).all())

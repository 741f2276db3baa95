"""Draws of the crossing: who drives, parks and walks on its streets, and in which light and fog.

Every parameter draws from a stream of its own name, so that changing one leaves
what the others draw as it was.  Nothing stands in anything else: cars follow each
other in lanes and stand one to a bay, and people look for a free spot.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from synfog_usd.base.seeds import seed32, stream
from synfog_usd.world.authoring import focal_length
from synfog_usd.world.language import Recipe
from synfog_usd.world.roads import crossing_actors, crossing_props, rules, traffic
from synfog_usd.world.roads.crossing import Crossing
from synfog_usd.world.roads.recipe import plated, posed, signed
from synfog_usd.world.spec import Placement, SkyDome, WorldSpec


def draw(recipe: Recipe, *, seed: int) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: more people than there is room for.
    """

    def value(name: str) -> Any:
        return recipe.distributions[name](stream(seed, "recipe", name))

    waits = value("traffic.main_street") == "waits"
    room = rules.CollisionSet()
    cars = crossing_actors.parked(recipe, seed, value("parked.share"), room)
    cars += crossing_actors.driving(recipe, seed, value("traffic.count"), waits, traffic.speed_m_s(value), room)
    cars = [replace(car, name=f"{car.asset.title()}_{index + 1:02d}") for index, car in enumerate(cars)]
    fixed = [
        *crossing_props.ground(),
        *crossing_props.houses(),
        *_furniture(waits),
        *crossing_props.trees(),
        *crossing_props.parked_bicycles(),
    ]
    beside = [p for p in fixed if p.group not in ("Ground", "Buildings")]
    people = crossing_actors.walking(recipe, seed, value("people.count"), waits, beside)
    riders = crossing_actors.cyclist(seed) if value("people.cyclists") else []
    fog = recipe.fog_variants(seed)
    lens = focal_length(value("camera.fov_x_deg"))
    return WorldSpec(
        about=f"{recipe.about.removesuffix('.')}, drawn from {recipe.name} with seed {seed}.",
        placed=(*signed(fixed, crossing_props.VIEW, seed), *plated(cars, seed), *posed(people, seed), *riders),
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


def _furniture(waits: bool) -> list[Placement]:
    """The shipped furniture with the signals of the phase."""
    placed = []
    for p in crossing_props.furniture():
        if "signal" in p.variants:
            main = abs(p.x) < abs(p.y)
            p = replace(p, variants={"signal": "red" if main == waits else "green"})
        placed.append(p)
    return placed

"""Draws of the crossing: who drives, parks and walks on its streets, and in which light and fog.

Nothing stands in anything else: cars follow each other in lanes and stand one to a bay,
and people look for a free spot.
"""

from __future__ import annotations

from dataclasses import replace

from synfog_usd.base.seeds import seed32
from synfog_usd.world.authoring import focal_length
from synfog_usd.world.language import Draws
from synfog_usd.world.roads import crossing_actors, crossing_props, rules
from synfog_usd.world.roads.crossing import Crossing
from synfog_usd.world.roads.recipe import plated, posed, selected, signed, skies_of
from synfog_usd.world.spec import Placement, SkyDome, WorldSpec


def draw(draws: Draws) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: more people than there is room for.
    """
    waits = draws.word("traffic.main_street") == "waits"
    room = rules.CollisionSet()
    cars = [*crossing_actors.parked(draws, room), *crossing_actors.driving(draws, waits, room)]
    cars = [replace(car, name=f"{car.asset.title()}_{index + 1:02d}") for index, car in enumerate(cars)]
    fixed = [
        *crossing_props.ground(),
        *crossing_props.houses(),
        *_furniture(waits),
        *crossing_props.trees(),
        *crossing_props.parked_bicycles(),
    ]
    on_pavements = [p for p in fixed if p.group not in ("Ground", "Buildings")]
    people = crossing_actors.walking(draws, waits, on_pavements)
    riders = crossing_actors.cyclist(draws) if draws.whole("people.cyclists") else []
    fog = draws.recipe.fog_variants(draws.seed)
    day, dusk = skies_of(draws, fog)
    heading_deg = round(draws.number("sky.heading_deg"), 1)
    lens_z, lens = round(draws.number("camera.height_m"), 3), focal_length(draws.number("camera.fov_x_deg"))
    return WorldSpec(
        about=f"{draws.recipe.about.removesuffix('.')}, drawn from {draws.recipe.name} with seed {draws.seed}.",
        placed=(
            *signed(fixed, crossing_props.VIEW, draws.stream("shops")),
            *plated(cars, draws.stream("plates")),
            *posed(people, draws.stream("individuals")),
            *riders,
        ),
        view=replace(crossing_props.VIEW, z=lens_z, focal_length=lens),
        fog=fog,
        fog_selected=selected(fog),
        day=_dome(day, "overcast", round(draws.number("sky.overcast_nits"), 1), heading_deg),
        dusk=_dome(dusk, "dusk", round(draws.number("sky.dusk_nits"), 3), heading_deg),
        road=Crossing(),
        scatter=seed32(draws.seed, "recipe", "scatter"),
        origin={"recipe": draws.recipe.name, "seed": str(draws.seed)},
        built=crossing_props.BUILT,
        products=False,
    )


def _dome(sky: str, relative: str, nits: float, heading_deg: float) -> SkyDome:
    """The crossing's own sky, with its luminance at the zenith, or one of `skies`, which has its own."""
    return SkyDome(sky, nits) if sky == relative else SkyDome(sky, 1.0, heading_deg)


def _furniture(waits: bool) -> list[Placement]:
    """The shipped furniture with the signals of the phase."""
    placed = []
    for p in crossing_props.furniture():
        if "signal" in p.variants:
            main = abs(p.x) < abs(p.y)
            p = replace(p, variants={"signal": "red" if main == waits else "green"})
        placed.append(p)
    return placed

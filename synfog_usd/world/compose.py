"""From a recipe and a seed to a stage, whichever world the recipe is of."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from synfog_usd.base import resources, values
from synfog_usd.base.errors import RecipeError
from synfog_usd.world import parameters
from synfog_usd.world.departments import write_layers
from synfog_usd.world.language import Recipe, load_root
from synfog_usd.world.roads import crossing_recipe, recipe, roundabout_recipe, stage
from synfog_usd.world.spec import WorldSpec

DRAWS: Mapping[str, Callable[..., WorldSpec]] = {
    "crossroads": crossing_recipe.draw,
    "road": recipe.draw,
    "roundabout": roundabout_recipe.draw,
}
"""World -> what draws one of a recipe."""


def load(path: Path, changes: Sequence[str] = ()) -> Recipe:
    """Read a recipe.

    Args:
        path: the file, or the name of a recipe that ships: 'residential'.
        changes: 'section.key=value' each, over what stands in the file.

    Raises:
        RecipeError: not YAML, or a section, key or value that is not known, with its place.
    """
    path = resources.named(path, "recipe")
    return parameters.read(load_root(path, changes), path.name)


def draw(found: Recipe, *, seed: int) -> WorldSpec:
    """One world of a recipe; the same seed gives the same.

    Raises:
        RecipeError: a rule cannot be met, or there is no room for so many people.
    """
    return DRAWS[found.world](found, seed=seed)


def compose(
    recipe: str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    seed: int = 0,
    change: Mapping[str, Any] | Sequence[str] = (),
) -> WorldSpec:
    """Draw a world and write it as a stage: the file, and a layer for each department beside it.

    References to the shipped assets are relative where the file lies in the folder that
    holds them, so that the folder can move, and absolute elsewhere.

    Args:
        recipe: a name of `recipes`, or a YAML file.
        path: the stage, .usda, .usdc or .usd.
        seed: the same gives the same bytes in the same place.
        change: {'section.key': value}, or 'section.key=value' each, over what stands in the recipe.

    Returns:
        what was drawn, all numbers.

    Raises:
        SynfogError: with its place; or the stage cannot be written.
    """
    out, seed = values.path_of(path, "-o"), values.count(seed, "--seed")
    if isinstance(change, Mapping):
        change = [f"{key}={json.dumps(value)}" for key, value in change.items()]
    if out.suffix not in (".usda", ".usdc", ".usd"):
        raise RecipeError(f"-o {out}: not a USD file by its name; it ends in .usda, .usdc or .usd")
    spec = draw(load(values.path_of(recipe, "recipe"), change), seed=seed)
    assets = asset_folder(out.resolve().parent, resources.folder("assets").resolve())
    write_layers(out, lambda place: stage.author(place, spec, assets=assets))
    return spec


def asset_folder(stage_folder: Path, assets: Path) -> str:
    """How a stage names the folder of assets: relative within the folder that holds it, absolute elsewhere."""
    if not stage_folder.is_relative_to(assets.parent):
        return assets.as_posix()
    steps = Path(os.path.relpath(assets, stage_folder)).as_posix()
    return steps if steps.startswith("..") else f"./{steps}"


def recipes() -> list[str]:
    """Names of the recipes that ship, as `compose` takes them."""
    return list(resources.shipped("recipe"))

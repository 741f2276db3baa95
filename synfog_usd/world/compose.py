"""From a recipe and a seed to a stage, whichever world the recipe is of."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from synfog_usd import resources
from synfog_usd.errors import RecipeError
from synfog_usd.world.departments import write_layers
from synfog_usd.world.language import load_root, world_of
from synfog_usd.world.spec import WorldSpec


def compose(path: Path, out: Path, *, seed: int, changes: Sequence[str] = ()) -> WorldSpec:
    """Draw a world and write it as a stage: `out`, and a layer for each department beside it.

    References to the shipped assets are relative where `out` lies in the folder that
    holds them, so that the folder can move, and absolute elsewhere.

    Args:
        path: the recipe.
        out: the stage, .usda, .usdc or .usd.
        seed: the same gives the same bytes in the same place.
        changes: 'section.key=value' each, over what stands in the recipe.

    Raises:
        RecipeError: with its place.
        OutputError: the stage cannot be written.
    """
    if out.suffix not in (".usda", ".usdc", ".usd"):
        raise RecipeError(f"-o {out}: not a USD file by its name; it ends in .usda, .usdc or .usd")
    root = load_root(path, changes)
    assets = asset_folder(out.resolve().parent, resources.folder("assets").resolve())
    if world_of(root) in ("road", "roundabout"):
        from synfog_usd.world.roads import recipe as roads
        from synfog_usd.world.roads import roundabout_recipe, stage

        language = roads if world_of(root) == "road" else roundabout_recipe
        spec = language.draw(language.read(root, path.name), seed=seed)
        write_layers(out, lambda place: stage.author(place, spec, assets=assets))
        return spec
    from synfog_usd.world import crossroads, recipe

    spec = recipe.draw(recipe.read(root, path.name), seed=seed)
    write_layers(out, lambda place: crossroads.author_stage(place, spec, assets=assets))
    return spec


def asset_folder(stage_folder: Path, assets: Path) -> str:
    """How a stage names the folder of assets: relative within the folder that holds it, absolute elsewhere."""
    if not stage_folder.is_relative_to(assets.parent):
        return assets.as_posix()
    steps = Path(os.path.relpath(assets, stage_folder)).as_posix()
    return steps if steps.startswith("..") else f"./{steps}"

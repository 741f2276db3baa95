"""What ships is drawn as it was meant: its translation has nothing to tell."""

from __future__ import annotations

from pathlib import Path

import pytest

from synfog_usd.stage import open_stage, select, variants
from synfog_usd.translate import translate
from synfog_usd.world.compose import compose

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ("crossroads", "rural", "roundabout", "bridge")


def told(path: Path, fog: str) -> set[str]:
    """All notes of a stage in one of its fogs."""
    stage = open_stage(path, allow=[ROOT / "assets"])
    select(stage, fog=fog)
    return {f"{note.path}: {note.text}" for note in translate(stage).notes}


@pytest.mark.slow
def test_the_crossing_is_translated_without_a_remark():
    """A model that says less than what is drawn of it (a pane, a normal without length) would be told of."""
    assert told(ROOT / "stages" / "crossroads.usda", "mor150") == set()


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_a_world_of_a_shipped_recipe_is_translated_without_a_remark(name, tmp_path):
    """In its thickest fog, as `synfog-usd compose stages/recipes/NAME.yaml --seed 5` draws it."""
    path = tmp_path / f"{name}.usda"
    compose(ROOT / "stages" / "recipes" / f"{name}.yaml", path, seed=5)
    fogs = [fog for fog in variants(open_stage(path, allow=[ROOT / "assets"]))["fog"] if fog != "clear"]
    assert told(path, min(fogs, key=lambda fog: float(fog.removeprefix("mor")))) == set()

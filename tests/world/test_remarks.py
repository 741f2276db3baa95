"""What ships is drawn as it was meant: its translation has nothing to remark."""

from __future__ import annotations

from pathlib import Path

import pytest

from synfog_usd.stage import open_stage, select, variants
from synfog_usd.translate import translate
from synfog_usd.world.compose import compose

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stages/crossroads.usda", "crossroads", "rural", "roundabout", "bridge"])
def test_what_ships_is_translated_without_a_remark(name, tmp_path):
    """The shipped crossing, and recipes with seed 5, each in its thickest fog."""
    path = ROOT / name
    if not path.suffix:
        path = tmp_path / f"{name}.usda"
        compose(name, path, seed=5)
    stage = open_stage(path, allow=[ROOT / "assets"])
    fogs = [fog for fog in variants(stage)["fog"] if fog != "clear"]
    select(stage, fog=min(fogs, key=lambda fog: float(fog.removeprefix("mor"))))
    assert [f"{note.path}: {note.text}" for note in translate(stage).notes] == []

"""The stages on which renderers are compared: they are as written, whole, and say what shines and what stands where."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd

from assets.builders import bench_stages
from synfog_usd.stage import cameras, check, open_stage, select, variants
from synfog_usd.stage.schema import read_fog

FOLDER = Path(__file__).resolve().parents[2] / "stages" / "bench"
STAGES = sorted(path.stem for path in FOLDER.glob("*.usda"))
MAX_BYTES = 100_000


def opened(name: str) -> Usd.Stage:
    return open_stage(FOLDER / f"{name}.usda")


def test_the_committed_files_are_what_write_makes_and_small(tmp_path: Path):
    """Same bytes every time, and nothing else lies there."""
    made = {path.name: path.read_bytes() for path in bench_stages.write(tmp_path)}
    assert made == {path.name: path.read_bytes() for path in FOLDER.iterdir()}
    assert max(map(len, made.values())) < MAX_BYTES


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_is_sound_and_has_a_camera_fog_and_labels(name: str):
    stage = opened(name)
    assert [note for note in check(stage) if note.severity == "warning" or "label" in note.text] == []
    assert cameras(stage) == ["/World/Ego"]
    assert "clear" in variants(stage)["fog"]


@pytest.mark.parametrize("name, fog, mor_m", [
    ("overcast_street", None, {150.0}),
    ("canyon", "mor600", {600.0}),
    ("dense_mor50", None, {50.0}),
    ("dense_mor50", "mor300", {300.0}),
    ("haze_mor2000", None, {2000.0}),
    ("fog_bank", None, {400.0, 40.0}),
    ("fog_bank", "clear", set()),
])  # fmt: skip
def test_a_variant_sets_the_visibility(name: str, fog: str | None, mor_m: set[float]):
    stage = opened(name)
    select(stage, fog=fog)
    found = [read_fog(prim, Usd.TimeCode.Default()) for prim in stage.Traverse()]
    assert {one.values["mor"] for one in found if one is not None} == mor_m

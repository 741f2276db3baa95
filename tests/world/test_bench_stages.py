"""The stages on which renderers are compared: they are as written, whole, and say what shines and what stands where."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd

from assets.builders import bench_stages
from synfog_usd.stage import cameras, check, open_stage, variants

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


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if n % 3 else ()) for n, name in enumerate(STAGES)]
)
def test_a_stage_is_sound_and_has_a_camera_fog_and_labels(name: str):
    stage = opened(name)
    assert [note for note in check(stage) if note.severity == "warning" or "label" in note.text] == []
    assert cameras(stage) == ["/World/Ego"]
    assert "clear" in variants(stage)["fog"]

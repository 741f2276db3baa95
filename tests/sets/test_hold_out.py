"""Nothing of the test split was seen in training: read from what a real set left on disk."""

import json
import re
import subprocess
from collections import defaultdict

import pytest
from support.cli import command

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

SET = """\
synfog: set/1
about: Roads whose test split has a recipe, two models and a sky of its own.
seed: 3
scenes: 2
recipes: [rural, tunnel]
lightings: [sky]
fogs: [clear]
pipelines: [synfog]
size: [32, 18]
quality: {word: reference, samples: 2, model: single}
splits:
  train: 1
  test: {share: 1, recipes: [rural], models: [hatchback, saloon], skies: [altocumulus_morning]}
"""
HELD = {"Hatchback", "Saloon"}


@pytest.mark.slow
def test_labels_of_training_name_nothing_of_the_tests(tmp_path):
    """Prims are called after their models, so labels.json tells them whatever unit.json says; skies and recipes are the
    manifests'.
    """
    (tmp_path / "held.yaml").write_text(SET)
    words = command("dataset", "run", tmp_path / "held.yaml", "-o", tmp_path / "out", "--workers", "1")
    done = subprocess.run(words, capture_output=True, text=True, timeout=3000)
    assert done.returncode == 0, done.stderr
    shown, skies, sources, seeds = (defaultdict(set) for _ in range(4))
    for path in (tmp_path / "out").rglob("unit.json"):
        unit = json.loads(path.read_text())
        split = "test" if unit["split"] == "test" else "training"
        for row in json.loads((path.parent / "labels.json").read_text())["instances"]:
            name = re.sub(r"(_\d+)?(\[\d+\])?$", "", row["path"].rpartition("/")[2])
            shown[split].add(name)
        skies[split].update(unit["skies"])
        sources[split].add(unit["source"])
        seeds[split].add(unit["seed"])
    assert shown["test"] >= HELD and not HELD & shown["training"]
    assert {"City_Car", "Van"} & shown["training"]  # names are read as they are written
    assert "altocumulus_morning" in skies["test"] and "altocumulus_morning" not in skies["training"]
    assert "rural" in sources["test"] and "rural" not in sources["training"]
    assert len(seeds["test"] | seeds["training"]) == 2

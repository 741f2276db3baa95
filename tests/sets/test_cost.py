"""What a set holds, and how long a unit may take."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.cli import process, run

from synfog_usd.dataset.sets.cost import count
from synfog_usd.dataset.sets.load import load_set


@pytest.mark.slow
def test_the_set_of_the_paper_is_counted():
    """500 scenes x 2 x 4 shots through 2 cameras, the foggy ones by a third; 3 files of a shot, 2 of each camera, 5 of
    a scene in a lighting.  In rain and snow the second camera has light of its own.
    """
    paper, weather = (load_set(Path(name)) for name in ("synfog", "weather"))
    found, rained_on = count(paper), count(replace(weather, pipelines=paper.pipelines))
    assert (found.scenes, found.shots, found.pictures) == (500, 4000, 11_000)
    assert found.units == {"sky": 500, "active": 500} and found.splits == {"train": 450, "test": 50}
    assert found.files == 4000 * (3 + 2 * 2) + 3000 * 2 + 1000 * 5
    assert rained_on.files == 2000 * (3 + 2 * 2) + 200 * 3 + 200 * 5
    assert sum(found.sources.values()) == 500


def test_the_verb_counts():
    done = run("dataset", "plan", "mini", "--json")
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout)
    assert (printed["scenes"], printed["shots"]) == (6, 48)
    told = run("dataset", "plan", "mini").stdout
    assert "48, as 48 pictures in 300 files" in told and "dataset status" in told


def test_a_set_that_does_not_ship_is_told():
    done = process("dataset", "plan", "minni")
    assert done.returncode == 2 and "minni" in done.stderr and "Did you mean 'mini'?" in done.stderr

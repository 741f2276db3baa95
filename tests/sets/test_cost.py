"""What a set holds, and how long a unit may take."""

import json
from pathlib import Path

import pytest
from support.cli import process, run

from synfog_usd.dataset.sets.cost import count
from synfog_usd.dataset.sets.load import load_set


def test_the_set_of_the_paper_is_counted():
    """500 scenes x 2 x 4 shots through 2 cameras, the foggy ones by a third; 3 files of a shot, 2 of each camera, 5 of
    a scene in a lighting.
    """
    found = count(load_set(Path("synfog")))
    assert (found.scenes, found.shots, found.pictures) == (500, 4000, 11_000)
    assert found.units == {"sky": 500, "active": 500} and found.splits == {"train": 450, "test": 50}
    assert found.files == 4000 * (3 + 2 * 2) + 3000 * 2 + 1000 * 5
    assert sum(found.sources.values()) == 500


@pytest.mark.slow
def test_the_plan_of_a_million_shots_is_quick_and_small():
    """In processor time 60 s at most, and below 1 GB, both of a process of its own; measured 6 s and 0.25 GB."""
    code = (
        "import time; from synfog_usd.dataset.sets.cost import count; "
        "from synfog_usd.dataset.sets.load import define_set\n"
        "words = dict(recipes=['rural', 'tunnel'], splits={'train': 9, 'test': 1})\n"
        "fogs = ['clear', {'integer': [300, 900]}, {'integer': [100, 300]}, 50]\n"
        "found = count(define_set(scenes=125_000, fogs=fogs, **words))\n"
        "lines = open('/proc/self/status').read().splitlines()\n"  # maxrss has the parent's, too
        "peak = next(int(line.split()[1]) for line in lines if line.startswith('VmHWM'))\n"
        "print(found.shots, time.process_time(), peak / 1024)"
    )
    import subprocess
    import sys

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    shots, cpu_s, peak_mb = map(float, done.stdout.split())
    assert shots > 999_000 and cpu_s < 60 and peak_mb < 1000


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

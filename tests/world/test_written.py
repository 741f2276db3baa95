"""Where a composed stage cannot be written."""

from __future__ import annotations

import functools
import resource
from pathlib import Path

import pytest
from support import cli

from synfog_usd.world.compose import compose

RECIPE = Path(__file__).resolve().parents[2] / "stages" / "recipes" / "rural.yaml"


@pytest.mark.slow
@pytest.mark.parametrize("place", ["/proc/s.usda", "full"])
def test_a_place_that_takes_no_stage_is_one_line(tmp_path, place):
    """An unwritable folder, and a disk that is full: the stage that was there before stays as it was."""
    compose(RECIPE, tmp_path / "s.usda", seed=2)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    out = tmp_path / "s.usda" if place == "full" else Path(place)
    limits = (lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))) if place == "full" else None
    run = functools.partial(cli.process, preexec_fn=limits) if limits else cli.run
    done = run("compose", RECIPE, "--seed", "1", "-o", out)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert "cannot be written" in done.stderr
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before

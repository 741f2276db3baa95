"""What a seed draws stays what it was, whatever order the code is put in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from synfog_usd.base import resources
from synfog_usd.world.compose import draw, load

RECIPES = sorted((resources.folder("stages") / "recipes").glob("*.yaml"))
GOLDEN = Path(__file__).with_name("golden_draws.json")
SEED = 4


def sums(path: Path) -> dict[str, list[float]]:
    """Of each group of a drawn world: how many stand there, and the sums of their x, y [m] and headings [degrees],
    each with another weight.
    """
    placed = draw(load(path), seed=SEED).placed
    found = {}
    for group in sorted({p.group for p in placed}):
        rows = np.array([(p.x, p.y, p.heading) for p in placed if p.group == group])
        weights = np.cos(np.arange(len(rows)))  # who changes places is seen too
        found[group] = [len(rows), *(round(float(v), 3) for v in weights @ rows)]
    return found


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_a_seed_draws_the_same_world_for_ever(path):
    """Within what rounding makes of the sums on another processor."""
    wanted, found = json.loads(GOLDEN.read_text())[path.stem], sums(path)
    assert found.keys() == wanted.keys()
    for group, row in found.items():
        assert row == pytest.approx(wanted[group], abs=0.02), group


if __name__ == "__main__":  # writes them anew; say so in CHANGELOG
    GOLDEN.write_text(json.dumps({path.stem: sums(path) for path in RECIPES}, indent=1) + "\n")

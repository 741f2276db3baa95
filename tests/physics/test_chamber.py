"""The chart of the fog chamber by two programs: our path tracer and Mitsuba's `volpath`, which share no line of it."""

from __future__ import annotations

import pytest
from support.renders import by_seed
from support.stats import assert_agree

from docs.studies.chamber import chamber
from synfog_usd.base import resources

pytestmark = pytest.mark.physics


@pytest.mark.parametrize(("fog", "walls"), [("fog05", "black"), ("fog08", "black"), ("fog05", "white")])
def test_the_chart_is_that_of_volpath(fog, walls):
    """Optical depth 2 and 5 to the chart, walls that give back 4 % and 85 %: the picture's mean, to 1.5 %."""
    scene = chamber(resources.folder("stages") / "chamber.usda").scene(fog, walls)
    ours = [run.radiance.pixels for run in by_seed(scene, range(8), model="path", samples=128)]
    theirs = [run.radiance.pixels for run in by_seed(scene, range(8), model="volpath", samples=128)]
    assert_agree(ours, theirs, resolves=0.03)

"""The chart of the fog chamber by two programs: our path tracer and Mitsuba's `volpath`, which share no line of it."""

from __future__ import annotations

import numpy as np
import pytest
from support.renders import by_seed
from support.stats import assert_agree

from docs.studies.chamber import chamber, patch_mean, patch_pixels, sample_patches
from synfog_usd.base import resources
from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load

pytestmark = pytest.mark.physics


@pytest.mark.parametrize(("fog", "walls"), [("fog05", "black"), ("fog08", "black"), ("fog05", "white")])
def test_the_chart_is_that_of_volpath(fog, walls):
    """Optical depth 2 and 5 to the chart, walls that give back 4 % and 85 %: the picture's mean, to 1.5 %."""
    scene = chamber(resources.folder("stages") / "chamber.usda").scene(fog, walls)
    ours = [run.radiance.pixels for run in by_seed(scene, range(8), model="path", samples=128)]
    theirs = [run.radiance.pixels for run in by_seed(scene, range(8), model="volpath", samples=128)]
    assert_agree(ours, theirs, resolves=0.03)


@pytest.mark.parametrize(("fog", "walls"), [("fog01", "black"), ("fog05", "black")])
def test_patches_that_are_sampled_until_they_are_known_are_those_of_an_even_picture(fog, walls):
    """To stop where noise looks small could lower the mean, and few bright paths could be missed by intervals: over 12
    seeds the mean is that of pictures of which every pixel has 256 paths, to 1 %, and means lie as far from each other
    as their intervals say: 24 x 3 x 12 errors in units of the interval, mean square 1 to a third (patches share light).
    """
    scene = chamber(resources.folder("stages") / "chamber.usda").scene(fog, walls)
    loaded = load(scene, boundaries=False)
    places = patch_pixels(scene, aovs.measure(loaded).instance_id, "chamber")
    found = []
    for seed in range(12):
        light = sample_patches(loaded, "path", places, error=0.05, most_samples=1 << 16, seed=seed)
        found.append([patch_mean(light, where) for where in places.values()])
    ours, half = np.moveaxis(np.array(found), 2, 0)
    even = [run.radiance.pixels for run in by_seed(scene, range(20, 32), model="path", samples=256)]
    theirs = [[picture[where].mean(axis=0, dtype=np.float64) for where in places.values()] for picture in even]
    assert_agree(ours, theirs, resolves=0.02)
    off = (ours - ours.mean(axis=0)) / (half / 1.96)
    assert (off**2).sum() / (off.size - off[0].size) == pytest.approx(1.0, rel=1.0 / 3.0)

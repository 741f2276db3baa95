"""The white furnace: albedo 1 everywhere, radiance 1 from everywhere, so every pixel is 1."""

from dataclasses import replace

import numpy as np
import pytest
from support import renders

from synfog_usd.fog import Fog, FogMedium, FogVolume
from synfog_usd.scene.testing import box, scene, sky, uniform_fog

SEEDS = 16


def furnace(fog):
    return scene(sky(), [fog], fov_x_deg=60.0)


def ratio(world, model, samples):
    """Mean over the seeds and its standard error."""
    means = renders.means(world, SEEDS, model=model, samples=samples)
    return float(np.mean(means)), float(np.std(means, ddof=1) / np.sqrt(SEEDS))


@pytest.mark.physics
@pytest.mark.parametrize("model, samples", [("path", 16384)])
def test_fog_of_50_m_is_invisible(model, samples):
    """MOR 50, 60 m to every side, paths of any length: within 0.05 %, and five standard errors are less than that."""
    mean, error = ratio(furnace(uniform_fog(60.0, visibility_m=50.0)), model, samples)
    assert 5 * error < 5e-4, f"cannot see 0.05 %: error {error:.2%}"
    assert abs(mean - 1.0) < 5e-4


@pytest.mark.physics
@pytest.mark.parametrize("depth", [30.0, 100.0])
def test_unlimited_depth_loses_nothing(depth):
    """Optical depths of 30 and 100 to every side: paths of thousands of events, within 1 %."""
    mean, error = ratio(furnace(FogVolume("/Fog", box(60.0), FogMedium(depth / 60.0))), "path", 256)
    assert 5 * error < 1e-2, f"cannot see 1 %: error {error:.2%}"
    assert abs(mean - 1.0) < 1e-2


@pytest.mark.physics
@pytest.mark.parametrize("name", ["haze50", "mist50", "spray50", "snow25", "rain100+mor60", "smoke200", "dust90+rain9"])
def test_weather_is_invisible(name):
    """Media with their own phase functions and colours, and an albedo of 1: within 0.1 %."""
    fog = Fog.named(name).over(FogMedium(1.0))
    if fog.colours is not None:
        fog = replace(fog, albedo=1.0, colours=replace(fog.colours, albedo=(1.0,) * len(fog.colours.albedo)))
    mean, error = ratio(furnace(FogVolume("/Fog", box(60.0), fog)), "path", 4096)
    assert 4 * error < 1e-3, f"cannot see 0.1 %: error {error:.2%}"
    assert abs(mean - 1.0) < 1e-3

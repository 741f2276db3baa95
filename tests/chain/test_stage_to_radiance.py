"""From a stage's text to radiance: units, axes and fog mean what they say."""

import numpy as np
from support.renders import pictures
from support.stages import street
from support.stats import assert_mean

from synfog_usd import stage as usd
from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load, render
from synfog_usd.translate import translate

UNITS = [(1.0, "Z"), (1.0, "Y"), (0.01, "Z")]


def scene(folder, *, fog="mor150", size=(32, 18), **more):
    """The translated street."""
    path = folder / f"street_{abs(hash(tuple(sorted(more.items()))))}.usda"
    path.write_text(street(**more))
    stage = usd.open_stage(path)
    usd.select(stage, fog=fog, lighting="sky")
    return translate(stage, resolution=size)


def test_a_wall_at_50_m_in_mor_150_dims_by_beer_and_lambert(tmp_path):
    """A wall of 1 nit in absorbing fog arrives as exp(-2.996 / 150 * 50), on a stage in centimetres with Y up."""
    world = scene(tmp_path, meters_per_unit=0.01, up="Y", albedo=0.0, emission=1.0, sky=0.0, fov_x_deg=1.0)
    assert_mean(
        pictures(world, 8, samples=256), 0.05 ** (50.0 / 150.0), resolves=0.03, truth_within=4e-5
    )  # rays half a degree off the axis have 2e-5 more way
    seen = aovs.measure(load(world))
    np.testing.assert_allclose(seen.transmittance, 0.05 ** (seen.distance_m / 150.0), rtol=1e-5)  # float32 distances
    np.testing.assert_allclose(seen.depth_m, 50.0, rtol=1e-5)


def test_the_same_world_in_other_units_gives_the_same_radiance(tmp_path):
    """Metres and centimetres, Z up and Y up: same picture with the same random numbers, and none differs by more than
    rounding can.
    """
    pictures = [
        render(scene(tmp_path, meters_per_unit=unit, up=up, lamp=True), samples=64, seed=1)
        .radiance.pixels.astype(np.float64)
        .mean(axis=2)
        for unit, up in UNITS
    ]
    for other in pictures[1:]:
        # Rounding in float32 turns some paths onto other ways, so pixels differ by noise and means by much less.
        np.testing.assert_allclose(other.mean(), pictures[0].mean(), rtol=0.005)
        assert np.corrcoef(other.ravel(), pictures[0].ravel())[0, 1] > 0.99


def airlight_before_the_wall(visibility_m, *, distance_m=50.0, half_size_m=10.0, g=0.87):
    """Radiance [part of the sky's] that fog sends from before a black wall under a uniform sky.

    In a uniform sky every direction that the wall does not block brings the sky's own
    radiance, scattered or not; the blocked ones are taken as black.  The share of the
    phase function that the wall blocks is that of a disc of the wall's area.
    """
    sigma = -np.log(0.05) / visibility_m
    t = (np.arange(4000) + 0.5) / 4000 * distance_m
    cosine = np.cos(np.arctan(half_size_m * np.sqrt(4 / np.pi) / (distance_m - t)))
    blocked = (1 - g * g) / (2 * g) * (1 / (1 - g) - 1 / np.sqrt(1 + g * g - 2 * g * cosine))
    return np.mean(sigma * np.exp(-sigma * t) * (1 - blocked)) * distance_m


def test_fog_thickens_with_distance_and_with_density(tmp_path):
    """A black wall in scattering fog brightens from clear to MOR 600 to MOR 150.

    The estimate above ignores what scatters in before the wall and the wall's shadow in the
    fog beside it, which nearly cancel in thin fog; a third is allowed for them.
    """
    wall = [
        render(scene(tmp_path, fog=fog, fov_x_deg=5.0), samples=256).radiance.pixels.mean()
        for fog in ("clear", "mor600", "mor150")
    ]
    assert wall[0] < 0.001  # the specular lobe at an index of 1 leaves 1e-7
    np.testing.assert_allclose(wall[1], 1000 * airlight_before_the_wall(600.0), rtol=0.33)
    np.testing.assert_allclose(wall[2], 1000 * airlight_before_the_wall(150.0), rtol=0.33)
    assert wall[2] < 1000 * (1 - 0.05 ** (50.0 / 150.0))  # no more than without the wall


def test_the_input_is_never_written(tmp_path):
    """Choosing variants and translating leave the file's bytes and the root layer as they were."""
    path = tmp_path / "street.usda"
    path.write_text(street())
    before = path.read_bytes()
    stage = usd.open_stage(path)
    text = stage.GetRootLayer().ExportToString()
    for fog in ("clear", "mor600"):
        usd.select(stage, fog=fog, lighting="active")
        translate(stage)
    assert not stage.GetRootLayer().dirty
    assert stage.GetRootLayer().ExportToString() == text
    assert path.read_bytes() == before

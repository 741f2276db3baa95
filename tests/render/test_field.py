"""Airlight from a grid: against `path`, the white furnace and itself."""

import numpy as np
import pytest
from support.renders import by_seed, pictures
from support.stats import assert_agree, assert_mean

from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render import models
from synfog_usd.render.shot import load, render
from synfog_usd.testing import box, scene, uniform_fog, wall

SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}}
GREY = {
    "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.4, 0.4, 0.4]}}}
}
LAMP = {
    "light_lamp": {"type": "point", "position": [5.0, 25.0, 4.0], "intensity": {"type": "rgb", "value": [100.0] * 3}}
}
GROUND = {
    "type": "mesh",
    "positions": np.array([[-100, -100, -2], [100, -100, -2], [100, 100, -2], [-100, 100, -2.0]]),
    "faces": np.array([[0, 1, 2], [0, 2, 3]]),
    **GREY,
}
STREET = {"shape_ground": GROUND, "shape_ball": {"type": "sphere", "center": [-1.0, 15.0, 0.0], "radius": 2.0, **GREY}}
FOG = FogVolume("/Fog", box((90.0, 90.0, 40.0), (0.0, 0.0, 38.0)), FogMedium(0.03, albedo=0.98))


def view(world, width_px=48):
    return scene(world, [FOG], width_px=width_px, height_px=width_px * 9 // 16, fov_x_deg=60.0)


def test_the_white_furnace_stays_white():
    """Albedo 1, radiance 1 from everywhere: the grid holds 1 in every cell, and no pixel can tell."""
    world = scene(SKY, [uniform_fog(visibility_m=50.0, half_size=60.0)], fov_x_deg=60.0)
    assert_mean(pictures(world, 6, model="field", samples=128), 1.0, resolves=0.01)


@pytest.mark.parametrize(
    "world, model, seeds, samples, resolves",
    [
        pytest.param({**STREET, **LAMP}, "field", 12, 512, 0.04, marks=pytest.mark.slow),
        ({**SKY, **STREET}, "field", 6, 32, 0.02),
        pytest.param({**SKY, **STREET}, "field", 6, 128, 0.01, marks=pytest.mark.slow),
        pytest.param({**SKY, **STREET}, "field+slab", 6, 128, 0.01, marks=pytest.mark.slow),
    ],
    ids=["lamp", "sky", "sky closely", "slab"],
)
def test_the_mean_is_that_of_path(world, model, seeds, samples, resolves):
    """Beside a lamp and under a sky, with an object in front: within five standard errors of both."""
    ours = pictures(view(world), seeds, model=model, samples=samples)
    theirs = pictures(view(world), seeds, model="path", samples=2 * samples)
    assert_agree(ours, theirs, resolves=resolves)


@pytest.mark.slow
def test_pixels_are_right_one_by_one_and_quieter_than_those_of_path():
    """RMS error over the pixels beside a lamp: at the same cost in paths under two thirds of `path`'s, the reference's
    own left in both.
    """
    world = view({**STREET, **LAMP}, width_px=160)
    right = render(world, model="path", samples=4096, seed=99).radiance.pixels.mean(axis=2)
    scale = np.maximum(right, 0.05 * right.mean())
    error = {
        model: np.sqrt(
            np.median(((render(world, model=model, samples=64).radiance.pixels.mean(axis=2) - right) / scale) ** 2)
        )
        for model in ("field", "path")
    }
    assert error["field"] < 0.67 * error["path"]


def test_aovs_and_groups_add_up():
    """As in `path`: three AOVs, and the groups of lamps, each sum to all light."""
    world = view({**SKY, **STREET, **LAMP})
    world = type(world)(
        world.world,
        world.camera,
        world.fog,
        world.instances,
        world.instance_of,
        group_of={"light_lamp": "headlights", "light_sky": "sky"},
    )
    done = render(world, model="field", samples=64)
    np.testing.assert_allclose(sum(done.components.values()), done.radiance.pixels, rtol=1e-3, atol=1e-5)
    assert set(done.groups) == {"headlights", "sky"}
    np.testing.assert_allclose(sum(done.groups.values()), done.radiance.pixels, rtol=1e-3, atol=1e-4)


@pytest.mark.slow
def test_the_stated_variance_is_near_that_of_the_mean():
    """Neighbours share noise, but each pixel's own scatter between seeds is what is stated, to a factor of two on the
    median.
    """
    world = view({**STREET, **LAMP})
    seen = [run.radiance for run in by_seed(world, range(12), model="field", samples=32)]
    scatter = np.var([image.pixels.mean(axis=2) for image in seen], axis=0, ddof=1)
    stated = np.mean([image.variance.mean(axis=2) for image in seen], axis=0)
    assert 0.5 < np.median(scatter / stated) < 2.0


def test_the_same_seed_gives_the_same_bytes_whatever_is_in_flight(monkeypatch):
    """Lanes of cells and of pixels cut small change nothing."""
    world = view({**STREET, **LAMP})
    first = render(world, model="field", samples=64, seed=5).radiance.pixels.tobytes()
    monkeypatch.setattr("synfog_usd.render.film.accumulator.CHUNKED_LANES", 1000)
    monkeypatch.setattr("synfog_usd.render.integrators.froxels.LOOKUPS", 500)
    assert render(world, model="field", samples=64, seed=5).radiance.pixels.tobytes() == first


def test_sampling_stops_at_the_target():
    """Rounds add paths to pixels and cells until the error that is asked for is met."""
    done = render(view({**SKY, **STREET}), model="field", samples=4096, target_error=0.05, seed=1)
    assert done.met == 1.0 and done.samples < 4096


def test_clear_air_has_no_grid():
    """Without fog it is `path`."""
    world = scene({**SKY, "shape_wall": wall(20.0, **GREY)})
    loaded = load(world, boundaries=False)
    assert models.make("field", loaded).radiance_cache() is None
    np.testing.assert_array_equal(
        render(world, model="field", samples=16).radiance.pixels,
        render(world, model="path", samples=16).radiance.pixels,
    )


@pytest.mark.slow
def test_bands_go_through_the_grid():
    """White light in grey fog: each of 8 bands is the white spectrum times what R, G and B see."""
    from synfog_usd.render.spectra import bands

    world = view({**SKY, **STREET})
    plain, banded = (
        render(world, model="field", samples=32, bands=count).radiance.pixels.mean(axis=(0, 1)) for count in (3, 8)
    )
    np.testing.assert_allclose(banded / bands.matrices(8)[0].sum(axis=0), plain.mean(), rtol=0.005)

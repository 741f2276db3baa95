"""The atmospheric scattering model: exact where it is, and how far off it is where it is not."""

import numpy as np
import pytest
from support.stats import assert_mean

from synfog_usd.errors import ParameterError
from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.render import models
from synfog_usd.render.film import aovs
from synfog_usd.render.integrators.asm import (
    PATCH_PX,
    asm_refuses,
    dark_channel,
    estimated_airlight,
    make_asm,
    physical_airlight,
)
from synfog_usd.render.shot import load
from synfog_usd.testing import black, box, scene, uniform_fog, wall

SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}}
BLUE_SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.5, 0.8, 1.2]}}}


def picture(world, *, airlight="physical", samples=16, seed=0):
    """(H, W, C) of the model."""
    loaded = load(world, boundaries=False)
    mean = make_asm(loaded, airlight).accumulate(samples=samples, seed=seed).mean()
    return mean.reshape(world.camera.height_px, world.camera.width_px, -1)


def ground(albedo=0.15, size=1400.0):
    """A plane at height 0, seen from the camera's own height of 1.5 m."""
    corners = np.array([[-size, -size, -1.5], [size, -size, -1.5], [size, size, -1.5], [-size, size, -1.5]])
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [albedo] * 3}}
    return {"type": "mesh", "positions": corners, "faces": np.array([[0, 1, 2], [0, 2, 3]]), "bsdf": bsdf}


def test_a_wall_in_absorbing_fog_dims_by_beer_and_lambert_along_each_ray():
    """No noise and no airlight: a wall of radiance 1 at 50 m shows exp(-sigma * 50 / cos), 1.15 times farther at 30
    degrees; float32 distances, 1e-5.
    """
    fog = uniform_fog(visibility_m=150.0, albedo=0.0)
    world = scene({"shape_wall": wall(50.0, **black(1.0))}, [fog], fov_x_deg=60.0)
    x, y = np.meshgrid((np.arange(16) + 0.5) / 8.0 - 1.0, ((np.arange(9) + 0.5) - 4.5) / 8.0)
    length = 50.0 * np.sqrt(1.0 + np.tan(np.radians(30.0)) ** 2 * (x**2 + y**2))
    np.testing.assert_allclose(picture(world)[:, :, 0], 0.05 ** (length / 150.0), rtol=1e-5)


def test_under_an_even_sky_a_white_world_stays_white():
    """J = 1 and A = 1 (white furnace of the slab, albedo 1 and white ground): every pixel is 1, to float32's 1e-5 and
    the noise of J, which is 0.
    """
    fog = FogVolume("/Fog", box((500.0, 500.0, 60.0)), FogMedium(0.02))
    world = scene(
        {**SKY, "shape_wall": wall(30.0, 5.0, **black(1.0)), "shape_ground": ground(1.0)}, [fog], fov_x_deg=60.0
    )
    loaded = load(world, boundaries=False)
    np.testing.assert_allclose(
        physical_airlight(loaded), 1.0, atol=2e-3
    )  # the probes of the ground see its edge and the wall
    assert np.abs(np.median(picture(world)) - 1.0) < 2e-3


def test_towards_the_horizon_of_an_overcast_slab_it_is_what_path_sees():
    """Fog 60 m deep, sigma_t 0.02, ground 0.15: along the horizon nothing but airlight is left, and A is exact; `path`
    resolves 2 %.
    """
    fog = FogVolume("/Fog", box((1400.0, 1400.0, 30.0), (0.0, 0.0, 28.5)), FogMedium(0.02))
    world = scene({**BLUE_SKY, "shape_ground": ground()}, [fog], fov_x_deg=0.2)
    truth = picture(world).mean(axis=(0, 1))
    loaded = load(world, boundaries=False)
    path = models.MODELS["path"].make(loaded)
    seen = np.array([path.accumulate(samples=128, seed=seed).mean().mean(axis=0) for seed in range(12)])
    for channel in range(3):
        assert_mean(seen[:, channel], truth[channel], resolves=0.03)


def test_a_lamp_by_night_has_no_glow():
    """The known failure: a bulb in fog, seen from 30 m against the dark; `path` shows its glow, the model nothing but
    the lamp's dimmed surroundings.
    """
    bulb = {
        "light_bulb": {
            "type": "point",
            "position": [0.0, 30.0, 0.0],
            "intensity": {"type": "rgb", "value": [100.0] * 3},
        }
    }
    world = scene(bulb, [uniform_fog(visibility_m=150.0)], fov_x_deg=60.0)
    loaded = load(world, boundaries=False)
    path = models.MODELS["path"].make(loaded).accumulate(samples=64, seed=0).mean()
    assert path.mean() > 1e-3
    np.testing.assert_array_equal(picture(world), 0.0)


def test_aovs_and_variance_are_those_of_the_sum():
    """surface + airlight is the picture; its variance is t^2 that of clear air, to rounding."""
    fog = FogVolume("/Fog", box((500.0, 500.0, 60.0)), FogMedium(0.02))
    world = scene(
        {**BLUE_SKY, "shape_wall": wall(30.0, 5.0, bsdf={"type": "diffuse"}), "shape_ground": ground()},
        [fog],
        fov_x_deg=60.0,
    )
    loaded = load(world, boundaries=False)
    model = make_asm(loaded)
    foggy = model.accumulate(samples=16, seed=1)
    clear = model.path.accumulate(samples=16, seed=1)
    t = aovs.measure(loaded).transmittance.reshape(-1, 1)
    np.testing.assert_allclose(foggy.aov("surface"), t * clear.mean(), rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(
        foggy.aov("surface") + foggy.aov("airlight_single") + foggy.aov("airlight_multiple"), foggy.mean(), rtol=1e-6
    )
    np.testing.assert_allclose(foggy.mean(), t * clear.mean() + (1.0 - t) * physical_airlight(loaded), rtol=1e-6)
    rounding = 1e-6 * clear.mean() ** 2  # of sums in float32, whose mean's square is taken off
    assert (abs(foggy.variance() - t * t * clear.variance()) <= 1e-6 * clear.variance() + rounding).all()


def test_where_no_slab_fits_the_airlight_is_the_skys_mean():
    """A ball of fog under a sky of one colour."""
    world = scene(BLUE_SKY, [FogVolume("/Fog", Boundary("sphere", np.diag([50.0, 50.0, 50.0, 1.0])), FogMedium(0.02))])
    np.testing.assert_allclose(physical_airlight(load(world, boundaries=False)), [0.5, 0.8, 1.2], rtol=1e-5)


def test_the_estimated_airlight_is_a_sky_that_is_seen_and_never_a_lamp():
    """Of a flat sky its colour; a white pixel in it has a dark square around it and is passed over."""
    clear = np.full((60, 80, 3), 0.1)
    clear[:30] = [0.5, 0.8, 1.2]
    clear[50, 40] = 100.0
    t = np.full((60, 80, 1), 0.4)
    t[:30] = 0.0
    np.testing.assert_allclose(estimated_airlight(clear, t), [0.5, 0.8, 1.2], rtol=1e-12)


def test_the_dark_channel_is_the_least_of_a_square():
    """One dark pixel in one channel darkens the 15 x 15 pixels around it, fewer at the border."""
    clear = np.ones((40, 40, 3))
    clear[20, 3, 1] = 0.25
    dark = dark_channel(clear)
    assert (dark == 0.25).sum() == PATCH_PX * (3 + 1 + PATCH_PX // 2)
    assert set(np.unique(dark)) == {0.25, 1.0}


def test_the_same_seed_gives_the_same_bytes():
    """And the estimated airlight differs from the physical one."""
    world = scene(
        {**BLUE_SKY, "shape_wall": wall(50.0, 20.0, bsdf={"type": "diffuse"})}, [uniform_fog()], fov_x_deg=60.0
    )
    assert picture(world, seed=3).tobytes() == picture(world, seed=3).tobytes()
    assert not np.array_equal(picture(world, seed=3), picture(world, seed=3, airlight="estimated"))


def test_what_it_cannot_take_is_refused():
    """An airlight that is not known; fog in a mesh is named."""
    with pytest.raises(ParameterError, match="estimated"):
        make_asm(load(scene(SKY, [uniform_fog()]), boundaries=False), "guessed")
    corners, faces = (
        np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9.0]]),
        np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    )
    assert "/Bank" in asm_refuses(
        scene(SKY, [FogVolume("/Bank", Boundary("mesh", np.eye(4), corners, faces), FogMedium(0.02))])
    )

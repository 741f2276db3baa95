"""Lamps from the table against `path`, which knows nothing of it."""

import numpy as np
import pytest
from support.stats import assert_agree

from synfog_usd.errors import ParameterError
from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.render import models
from synfog_usd.render.integrators.glow import PART, _AxialLight, glow_refuses, make_glow
from synfog_usd.render.shot import load
from synfog_usd.testing import LOOK_NORTH, black, box, scene, uniform_fog, wall

SIGMA = 0.05
DIM_SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1e-5] * 3}}}


def bulb(*place, cd=1000.0):
    return {"type": "point", "position": list(place), "intensity": {"type": "rgb", "value": [cd, 0.5 * cd, 0.25 * cd]}}


def ball(albedo=0.9, g=0.87):
    """Fog as if without end: 40 optical depths to its edge; it absorbs a little, for a path of `path` may live long,
    but not for ever.
    """
    return FogVolume(
        "/Fog", Boundary("sphere", np.diag([800.0, 800.0, 800.0, 1.0])), FogMedium(SIGMA, albedo=albedo, g=g)
    )


def all_aov_means(world, make, *, samples, seeds, names):
    """(N, K) pooled red of each AOV, one per seed."""
    loaded = load(world, boundaries=False)
    integrator = make(loaded)
    runs = [integrator.accumulate(samples=samples, seed=seed) for seed in range(seeds)]
    return np.array([[run.aov(name)[:, 0].mean() for run in runs] for name in names])


def aov_means(world, make, *, samples, seeds, name):
    """(K,) pooled red of an AOV, one per seed."""
    return all_aov_means(world, make, samples=samples, seeds=seeds, names=[name])[0]


@pytest.mark.slow
def test_a_bulb_in_fog_without_end_glows_as_in_path():
    """One point lamp beside the view at optical distance 1; of light scattered once 8 % is resolved, of the rest 25 %.

    The lamp itself is not in the picture, so that `path` has few fireflies.
    """
    world = scene({"light_bulb": bulb(-16.0, 12.0, 0.0)}, [ball()], width_px=12, height_px=12, fov_x_deg=60.0)
    resolves = {"airlight_single": 0.08, "airlight_multiple": 0.25}
    ours = all_aov_means(world, lambda loaded: make_glow(loaded, single="table"), samples=4, seeds=2, names=resolves)
    theirs = all_aov_means(world, models.MODELS["path"].make, samples=1024, seeds=5, names=resolves)
    for here, there, seen in zip(ours, theirs, resolves.values(), strict=True):
        assert_agree(here, there, systematic=2e-3, resolves=seen)


@pytest.mark.physics
@pytest.mark.parametrize("g", [0.87, 0.0])
@pytest.mark.parametrize("tau", [0.3, 1.0, 3.0])
def test_a_bulb_in_fog_without_end_glows_as_in_path_closely(g, tau):
    """The same at three distances and two phase functions; 15 % is resolved."""
    away = tau / SIGMA
    world = scene(
        {"light_bulb": bulb(-0.8 * away, 0.6 * away, 0.0)}, [ball(g=g)], width_px=16, height_px=16, fov_x_deg=60.0
    )
    ours = aov_means(
        world, lambda loaded: make_glow(loaded, single="table"), samples=4, seeds=2, name="airlight_multiple"
    )
    theirs = aov_means(world, models.MODELS["path"].make, samples=2000, seeds=12, name="airlight_multiple")
    assert_agree(ours, theirs, systematic=2e-3, resolves=0.15)


@pytest.mark.slow
def test_what_lies_behind_a_wall_is_not_seen():
    """A black wall 15 m away cuts the ray off: the table at the eye less the table at the wall is what `path` traces,
    to 3 %.

    Lamp and eye stand on the same side, so that the wall throws no shadow on what is seen.
    """
    world = scene(
        {"light_bulb": bulb(-8.0, 6.0, 0.0), "shape_wall": wall(15.0)},
        [ball()],
        width_px=12,
        height_px=12,
        fov_x_deg=40.0,
    )
    ours = aov_means(
        world, lambda loaded: make_glow(loaded, single="table"), samples=16, seeds=2, name="airlight_single"
    )
    theirs = aov_means(world, models.MODELS["path"].make, samples=128, seeds=8, name="airlight_single")
    assert_agree(ours, theirs, systematic=2e-3, resolves=0.03)


@pytest.mark.slow
def test_a_grey_wall_receives_the_scattered_light():
    """A white diffuse wall lit through three optical depths: `path` finds there what model 'single' lacks; glow comes
    to within 30 % of the difference.

    The table knows fog without end; the wall takes half of it away.
    """
    world = scene(
        {"light_bulb": bulb(0.0, -40.0, 0.0, cd=1e5), "shape_wall": wall(20.0, bsdf={"type": "diffuse"})},
        [ball()],
        fov_x_deg=40.0,
    )
    makers = (make_glow, models.MODELS["path"].make, models.MODELS["single"].make)
    glow, path, single = (aov_means(world, make, samples=64, seeds=4, name="surface").mean() for make in makers)
    assert single < 0.7 * path
    assert abs(glow - path) < 0.3 * (path - single), (glow / path, single / path)


def test_light_of_spots_and_panels_is_counted_whole():
    """Flux over peak: a cone of 1 - cos, a panel pi, a ball and a bulb 4 pi; the blurred intensity keeps it."""
    spot = {
        "type": "spot",
        "to_world": LOOK_NORTH,
        "cutoff_angle": 30.0,
        "beam_width": 29.999,
        "intensity": {"type": "rgb", "value": [7.0] * 3},
    }
    panel, globe = (
        wall(5.0, 0.5, **black(3.0)),
        {"type": "sphere", "center": [1.0, 2.0, 3.0], "radius": 0.5, "emitter": black(2.0)["emitter"]},
    )
    disk = {"type": "disk", "to_world": np.diag([2.0, 2.0, 1.0, 1.0]), "emitter": black(2.0)["emitter"]}
    wanted = {"spot": (spot, 2.0 * np.pi * (1.0 - np.cos(np.pi / 6.0)), 7.0), "panel": (panel, np.pi, 3.0)}
    wanted |= {
        "globe": (globe, 4.0 * np.pi, 2.0 * np.pi * 0.25),
        "bulb": (bulb(0, 0, 0), 4.0 * np.pi, 1000.0),
        "disk": (disk, np.pi, 8.0 * np.pi),
    }
    for name, (part, flux, peak) in wanted.items():
        lamp = _AxialLight(part, 64)
        np.testing.assert_allclose(lamp.moments[0], flux, rtol=1e-3, err_msg=name)
        np.testing.assert_allclose(lamp.colour[0], peak, rtol=1e-6, err_msg=name)
        theta = np.linspace(0.0, np.pi, 129)
        whole = 2.0 * np.pi * np.trapezoid(lamp.blurred(0.87 ** np.arange(64.0)) * np.sin(theta), theta)
        np.testing.assert_allclose(whole, flux, rtol=5e-3, err_msg=name)  # the trapezoid, and what was clipped at 0
    np.testing.assert_allclose(_AxialLight(panel, 4).position, [0.0, 5.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(_AxialLight(globe, 4).position, [1.0, 2.0, 3.0])


@pytest.mark.slow
def test_the_picture_is_the_sum_of_its_aovs_and_repeats():
    """The same seed gives the same bytes; the part from the table is known almost exactly."""
    world = scene(
        {"light_bulb": bulb(-5.0, 20.0, 0.0), "shape_wall": wall(40.0, bsdf={"type": "diffuse"})},
        [uniform_fog()],
        fov_x_deg=60.0,
    )
    loaded = load(world, boundaries=False)
    model = make_glow(loaded)
    one, two, other = (model.accumulate(samples=16, seed=seed) for seed in (1, 1, 2))
    assert one.mean().tobytes() == two.mean().tobytes() != other.mean().tobytes()
    aovs = [one.aov(name) for name in ("surface", "airlight_single", "airlight_multiple")]
    np.testing.assert_allclose(sum(aovs), one.mean(), rtol=1e-6)  # sums are float32
    table = one.estimators[PART]
    assert (
        np.median(np.sqrt(table.variance()[:, 0]) / table.mean()[:, 0]) < 0.05
    )  # 16 rays through pixels 4 degrees wide
    np.testing.assert_allclose(one.mean()[:, 1], 0.5 * one.mean()[:, 0], rtol=1e-4)  # the colour of the lamp


def nested():
    bank = FogVolume("/Bank", box(5.0), FogMedium(0.1), priority=1, parent=0)
    return [uniform_fog(), bank]


@pytest.mark.parametrize(
    "world, fog, words",
    [
        ({"light_bulb": bulb(0, 9, 0)}, nested(), "one fog volume"),
        ({"light_bulb": bulb(0, 9, 0)}, [], "one fog volume"),
        (
            {"light_bulb": bulb(0, 9, 0)},
            [FogVolume("/Fog", box(50.0), FogMedium(0.1, profile="exponential"))],
            "not uniform",
        ),
        (
            {"light_bulb": bulb(0, 9, 0)},
            [FogVolume("/Fog", box(5.0, (0.0, 30.0, 0.0)), FogMedium(0.1))],
            "outside of the fog",
        ),
        ({"shape_wall": wall(50.0)}, [uniform_fog()], "no lamp"),
        (
            {"light_sun": {"type": "directional", "irradiance": {"type": "rgb", "value": [1.0] * 3}}},
            [uniform_fog()],
            "light_sun",
        ),
        (
            {
                "light_bulb": bulb(0, 9, 0),
                "light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0] * 3}},
            },
            [uniform_fog()],
            "the sky gives",
        ),
    ],
)
def test_what_is_outside_of_its_domain_is_refused_with_the_reason(world, fog, words):
    """Told before anything is loaded, and by `make_glow` as well."""
    assert words in glow_refuses(scene(world, fog))
    with pytest.raises(ParameterError, match=words):
        make_glow(load(scene(world, fog), boundaries=False))


def test_a_night_sky_is_let_pass():
    """A sky of 1e-5 beside a bulb of 1000."""
    assert glow_refuses(scene({"light_bulb": bulb(0, 9, 0), **DIM_SKY}, [uniform_fog()])) == ""

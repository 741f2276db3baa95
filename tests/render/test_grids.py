"""Fog on density grids in our own integrator: against exact optical depths, closed forms and Mitsuba's `volpath`."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support import renders
from support.parts import bulb, rgb, squares
from support.stats import assert_agree, assert_mean

from synfog_usd.fog import Fog, FogMedium, FogVolume
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.fog.patchy import patchy
from synfog_usd.fog.phase import Tabulated
from synfog_usd.fog.volume import optical_depth
from synfog_usd.render import backend
from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import black, box, pixel_rays, scene, sky

SIZE_M = (30.0, 40.0, 10.0)
RAYS, DRAWS = 12, 1 << 15


def cloud(albedo=0.9, sigma_t=0.15, g=0.6, **where):
    """Ragged fog with holes: densities of 0 to 1, a quarter of them 0."""
    draw = np.random.default_rng(3)
    values = np.maximum(draw.random((9, 22, 31)) - 0.25, 0.0) ** 2 * 16 / 9
    medium = FogMedium(sigma_t, albedo=albedo, g=g, profile="grid", grid=DensityGrid(values))
    return FogVolume("/Cloud", box(SIZE_M, (0.0, 30.0, 2.0)), medium, **where)


HAZE = FogVolume("/Haze", box(100.0), FogMedium(0.01, albedo=0.9, g=0.6))
HOLE = FogVolume("/Hole", box(6.0, (0.0, 30.0, 2.0)), FogMedium(0.0, g=0.6), parent=0)
PATCHES = FogMedium(0.02, albedo=0.9, g=0.6, profile="grid", grid=patchy(6.0, 0.8, seed=1))
WORLDS = {
    "alone": [cloud()],
    "in haze": [HAZE, cloud(parent=0)],
    "with a hole": [cloud(), HOLE],
    "patchy": [FogVolume("/Patches", box(SIZE_M, (0.0, 30.0, 2.0)), PATCHES, origin_m=(3.0, -2.0, 1.0))],
}


@pytest.fixture(scope="module")
def rays():
    """(RAYS, 3) origins and directions from within and without."""
    draw = np.random.default_rng(1)
    origin = draw.uniform(-1.0, 1.0, (RAYS, 3)) * SIZE_M * np.array(1.5) + (0.0, 30.0, 2.0)
    towards = draw.uniform(-0.8, 0.8, (RAYS, 3)) * SIZE_M + (0.0, 30.0, 2.0) - origin
    towards[0] *= (0.0, 1.0, 0.0)  # along an axis
    return origin, towards / np.linalg.norm(towards, axis=1, keepdims=True)


@pytest.mark.parametrize("name", WORLDS)
def test_flights_and_transmittances_are_those_of_the_exact_optical_depth(name, rays):
    """Cubics between voxel planes in double precision against 32768 draws a ray: means within 5 standard errors, which
    are 0.5 % of what comes through; a scattering before half of the ray's way, and one anywhere.
    """
    from synfog_usd.render.media.medium import Medium
    from synfog_usd.render.sampling.sobol import Sobol

    if backend.is_scalar():
        pytest.skip("vectorised tests")
    mi, fog = backend.mitsuba(), WORLDS[name]
    import drjit as dr

    medium = Medium(fog)
    lane = dr.arange(mi.UInt32, RAYS * DRAWS)
    ray = lane // DRAWS
    origin, direction = (dr.gather(mi.Point3f, backend.points(points), ray) for points in rays)
    direction = mi.Vector3f(direction)
    sampler, everywhere = Sobol(5, ray, lane % DRAWS), mi.Bool(True)
    near, far = medium.intersect(origin, direction)
    through, _ = medium.transmittance(origin, direction, near, far, sampler, everywhere)
    flight = medium.sample_flight(origin, direction, near, far, sampler.next_1d(), sampler, everywhere)
    share, place = medium.sample_inside(origin, direction, near, far, sampler.next_1d(), sampler, everywhere)
    draws = {
        key: np.array(values, dtype=np.float64).reshape(RAYS, DRAWS)
        for key, values in {"T": through, "flight": flight, "share": share, "place": place, "far": far}.items()
    }
    half = 0.5 * draws["far"][:, 0]
    exact, before = (np.exp(-optical_depth(fog, *rays, length)) for length in (np.full(RAYS, np.inf), half))
    kernels = medium.optical_depth(origin, direction, near, far)
    np.testing.assert_allclose(np.array(kernels)[::DRAWS], -np.log(exact), rtol=2e-5, atol=1e-6)

    def agree(estimates, truth):
        error = estimates.std(axis=1, ddof=1) / np.sqrt(DRAWS)
        assert np.all(error < 0.005)
        assert np.all(np.abs(estimates.mean(axis=1) - truth) <= 5.0 * error + 1e-6)

    agree(draws["T"], exact)
    agree(np.isinf(draws["flight"]), exact)
    agree(1.0 - draws["share"], exact)
    agree(draws["flight"] > half[:, None], before)
    agree(1.0 - np.where(draws["place"] <= half[:, None], draws["share"], 0.0), before)


@pytest.mark.parametrize("kind", ["mor50", "haze50", "mist50", "smoke50", "dust50", "spray50", "rain100", "snow9"])
def test_light_goes_back_the_way_it_came(kind):
    """From one point to another by way of a third, scattered there, and back: through a grid in smoke that thins
    with height, in kernels, the same within 0.1 %.
    """
    from synfog_usd.render.media.medium import Medium

    if backend.is_scalar():
        pytest.skip("vectorised tests")
    mi, draw = backend.mitsuba(), np.random.default_rng(4)
    of_kind = Fog.named(kind).over(FogMedium(1.0))
    smoke = Fog.named("smoke50").over(FogMedium(1.0))
    even = replace(smoke, profile="exponential", base_height_m=-5.0, scale_height_m=8.0)
    grid = replace(of_kind, profile="grid", grid=cloud().medium.grid)
    medium = Medium([replace(HAZE, medium=even), replace(cloud(parent=0), medium=grid)])
    a, x, b = (draw.uniform(-1.0, 1.0, (4000, 3)) * SIZE_M + (0.0, 30.0, 2.0) for _ in range(3))

    def sent(*points):
        share, ways = 1.0, []
        for start, end in pairwise(points):
            length = np.linalg.norm(end - start, axis=1, keepdims=True)
            ways.append((end - start) / length)
            rays = backend.points(start), mi.Vector3f(backend.points(ways[-1]))
            share *= np.exp(-np.array(medium.optical_depth(*rays, 0.0, backend.floats(length.ravel()))))
        cosine = backend.floats((ways[0] * ways[1]).sum(axis=1))
        place = backend.points(points[1])
        return share * np.array(medium.scattering(place) * medium.phase_value(place, cosine))

    there, back = sent(a, x, b), sent(b, x, a)
    assert there.max() > 1e3 * there[there > 0.0].min()
    np.testing.assert_allclose(back, there, rtol=1e-3)


PLUME = replace(cloud(albedo=1.0, sigma_t=20.0), boundary=box(2.0))
"""Around the camera, with a MOR of 15 cm at its densest."""


@pytest.mark.parametrize("fog", [cloud(albedo=1.0), PLUME], ids=["cloud", "plume"])
def test_scattering_fog_on_a_grid_is_invisible_in_a_uniform_sky(fog):
    """White furnace: albedo 1, radiance 1 from everywhere; 1 %, within the plume 5 %, are resolved."""
    world = scene(sky(), [fog], fov_x_deg=60.0)
    assert_mean(renders.pictures(world, 8, samples=128, model="path"), 1.0, resolves=0.05 if fog is PLUME else 0.01)


def street(fog, *, lamps=True):
    """Ground, ball, sky, sun and two lamps, from within the fog."""
    grey = {"bsdf": {"type": "twosided", "bsdf": {"type": "preview_surface", "base_color": rgb(0.4), "roughness": 0.4}}}
    world = {
        **sky(),
        "light_sun": {"type": "directional", "direction": [0.3, 0.4, -0.8], "irradiance": rgb(2.0)},
        "shape_ground": squares([[-40, -15, -2], [40, -15, -2], [40, 75, -2], [-40, 75, -2]], **grey),
        "shape_ball": {"type": "sphere", "center": [-1.0, 15.0, 0.0], "radius": 2.0, **grey},
    }
    panel = squares([[-6, 22, 2], [-6, 24, 2], [-6, 24, 4], [-6, 22, 4]], **black(30.0))
    world |= {"shape_panel": panel, "light_bulb": bulb([0.0, 30.0, 6.0], 25.0)} if lamps else {}
    return scene(world, fog, fov_x_deg=70.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", WORLDS)
def test_a_street_in_it_is_that_of_volpath(name):
    """Two programs that share no line of the transport, sun, sky and lamps: 3 % of the mean is
    resolved.
    """
    world = street(WORLDS[name])
    ours = renders.pictures(world, 8, samples=256, model="path", regularize=False)
    theirs = renders.pictures(world, 8, samples=1024, model="volpath")
    assert_agree(ours, theirs, resolves=0.03)


@pytest.mark.parametrize("names", ["dust60+haze90", pytest.param("rain100+mor60", marks=pytest.mark.slow)])
def test_a_street_in_two_media_is_that_in_one_of_their_sum(names):
    """Against an extinction, an albedo and a phase function that are added up here, in a table of other rows: by the
    same random numbers, so that means agree within 0.1 % where others' noise is 1 %.
    """
    parts = [Fog.named(name).over(FogMedium(1.0)) for name in names.split("+")]
    stops = np.array([part.sigma_t_per_m for part in parts])
    scatters = stops * [part.albedo for part in parts]
    cosines = np.cos(np.radians(np.r_[180.0:10.0:1201j, np.geomspace(9.99, 0.01, 1200), 0.0]))
    phase = scatters @ [part.phase_function.value(cosines) for part in parts] / scatters.sum()
    by_hand = FogMedium(stops.sum(), scatters.sum() / stops.sum(), phase=Tabulated(cosines, phase, "a sum"))
    pair = [Fog.named(names).over(FogMedium(1.0)), by_hand]
    both, one = (
        renders.pictures(
            street([FogVolume("/Fog", box(60.0, (0.0, 20.0, 55.0)), replace(medium, colours=None))], lamps=False),
            2,
            samples=64,
            model="path",
        )
        for medium in pair
    )
    assert one.mean() == pytest.approx(both.mean(), rel=1e-3)


@pytest.mark.parametrize("name", WORLDS)
def test_labels_tell_the_transmittance_of_the_same_field(name):
    """By a kernel in single precision, and by the formula in double along the ray through each pixel's centre."""
    world = street(WORLDS[name])
    seen = aovs.measure(load(world, boundaries=False))
    direction = pixel_rays(world, nodes=1)[0].reshape(-1, 3)
    eye = np.broadcast_to(world.camera.to_world[:3, 3], direction.shape)
    exact = np.exp(-optical_depth(world.fog, eye, direction, seen.distance_m.ravel()))
    assert exact.min() < 0.8
    np.testing.assert_allclose(seen.transmittance.ravel(), exact, atol=2e-5)

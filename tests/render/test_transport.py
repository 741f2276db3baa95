"""Volumetric path tracing against exact truths."""

import numpy as np
import pytest
from support.stats import assert_mean

from synfog_usd.errors import ParameterError
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render.shot import render
from synfog_usd.study.truths import black, box, scene, uniform_fog, wall

SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}}


def means(world_scene, *, samples=64, seeds=16):
    """One pooled mean per seed."""
    return np.array([render(world_scene, samples=samples, seed=seed).radiance.pixels.mean(dtype=np.float64) for seed in range(seeds)])


@pytest.mark.parametrize("visibility_m, resolves", [(600.0, 0.01), (150.0, 0.01), (50.0, 0.03)])
def test_a_wall_in_absorbing_fog_dims_by_beer_and_lambert(visibility_m, resolves):
    """With nothing scattered, a wall of radiance 1 at 50 m reaches the camera as exp(-2.996 / MOR * 50)."""
    fog = uniform_fog(visibility_m=visibility_m, albedo=0.0)
    world = scene({"shape_wall": wall(50.0, **black(1.0))}, [fog], fov_x_deg=1.0)
    assert_mean(means(world, samples=1024), 0.05 ** (50.0 / visibility_m), resolves=resolves)


def test_scattering_fog_in_a_uniform_sky_is_invisible():
    """White furnace: albedo 1, radiance 1 from everywhere, MOR 50: every pixel is 1."""
    world = scene(SKY, [uniform_fog(visibility_m=50.0, half_size=60.0)], fov_x_deg=60.0)
    assert_mean(means(world), 1.0, resolves=0.01)


def test_fog_of_no_density_is_clear_air():
    """sigma_t 0 gives the numbers of the scene without fog, within rounding."""
    world = {**SKY, "shape_ground": wall(30.0, 5.0, bsdf={"type": "diffuse"})}
    clear, empty = render(scene(world), samples=64), render(scene(world, [FogVolume("/Fog", box(100.0), FogMedium(0.0))]), samples=64)
    sigma = np.sqrt(clear.radiance.variance.mean() / clear.radiance.pixels.size + empty.radiance.variance.mean() / empty.radiance.pixels.size)
    assert abs(clear.radiance.pixels.mean() - empty.radiance.pixels.mean()) < 5 * sigma + 1e-6


def test_a_bank_inside_fog_dims_with_both():
    """0.3 per metre inside 0.03 per metre: without the outer fog behind the bank the wall would be 29 % too bright."""
    outer = FogVolume("/Outer", box(200.0), FogMedium(0.03, albedo=0.0))
    bank = FogVolume("/Bank", box((50, 2.5, 50), (0, 10, 0)), FogMedium(0.3, albedo=0.0), priority=1, parent=0)
    world = scene({"shape_wall": wall(20.0, **black(1.0))}, [outer, bank], fov_x_deg=1.0)
    assert_mean(means(world, samples=1024), np.exp(-(0.03 * 15 + 0.3 * 5)), resolves=0.03)


def test_the_same_seed_gives_the_same_bytes():
    """And another seed does not."""
    world = scene({**SKY, "shape_wall": wall(50.0, bsdf={"type": "diffuse"})}, [uniform_fog()])
    first, again, other = (render(world, samples=32, seed=seed) for seed in (1, 1, 2))
    assert first.radiance.pixels.tobytes() == again.radiance.pixels.tobytes()
    assert first.radiance.variance.tobytes() == again.radiance.variance.tobytes()
    assert first.radiance.pixels.tobytes() != other.radiance.pixels.tobytes()


def test_the_variance_is_that_of_the_mean():
    """The stated variance equals the scatter over seeds: ratio 1 within 5 sigma of a chi-squared of 24 renders x 144 pixels."""
    world = scene({**SKY, "shape_wall": wall(50.0)}, [uniform_fog()])
    runs = [render(world, samples=32, seed=seed).radiance for seed in range(24)]
    scatter = np.var([run.pixels[:, :, 0] for run in runs], axis=0, ddof=1, dtype=np.float64).mean()
    stated = np.mean([run.variance[:, :, 0] for run in runs], dtype=np.float64)
    assert abs(scatter / stated - 1.0) < 5 * np.sqrt(2 / (23 * 144)) * 1.5  # 1.5: the tails of path tracing are heavier than a normal's


def test_an_unknown_model_is_refused_with_the_known_ones():
    """The message names what exists."""
    with pytest.raises(ParameterError, match="volpath"):
        render(scene(SKY), model="volpth")


@pytest.mark.parametrize("samples", [0, 1, -5, 1 << 21])
def test_a_number_of_samples_out_of_range_is_refused(samples):
    """One sample has no variance; two million are a slip of the keyboard."""
    with pytest.raises(ParameterError, match="--samples"):
        render(scene(SKY), samples=samples)

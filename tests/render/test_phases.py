"""Phase functions in kernels and in Mitsuba, and grids of fog, against records, Mitsuba's own and each other."""

import drjit as dr
import numpy as np
import pytest
from scipy import stats
from support.parts import rgb
from support.stats import assert_agree

from synfog_usd.fog import Fog, FogMedium, FogVolume
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.fog.kinds import joined
from synfog_usd.fog.phase import Droplets, HenyeyGreenstein, Tabulated
from synfog_usd.render import backend
from synfog_usd.render.load import to_mitsuba
from synfog_usd.render.media.phases import kernel_phase, plugin
from synfog_usd.scene.testing import black, box, scene

FORWARD = (0.36, -0.48, 0.8)


def notched():
    """Dark to the side, two humps: nothing that a closed form could stand in for."""
    angles = np.linspace(np.pi, 0.0, 181)
    return Tabulated(np.cos(angles), np.cos(angles) ** 2 + 4.0 * np.exp(-((angles / 0.3) ** 2)), "two humps")


RECORDS = [HenyeyGreenstein(g) for g in (-0.99, 0.0, 0.87)] + [Droplets(8.0), notched()]
NAMES = ["hg-0.99", "hg0", "hg0.87", "droplets8", "table"]
every = pytest.mark.parametrize("record", RECORDS, ids=NAMES)


def sampled(mi, record, count, seed):
    """(cosines (N,), turns about the direction before in 0 to 1 (N,), densities (N,)) of drawn directions, in double
    precision.
    """
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    direction, density = kernel_phase(record).sample(mi.Vector3f(*FORWARD), sampler.next_2d())
    direction = np.array(direction, dtype=np.float64).T
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    forward = np.array(FORWARD)
    side = np.cross(forward, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    turn = np.arctan2(direction @ np.cross(forward, side), direction @ side) / (2 * np.pi) % 1.0
    return direction @ forward, turn, np.array(density, dtype=np.float64)


def cumulated(record, rows=200_001):
    """(cosines, share of light below each), by the trapezoid on rows that are even in the angle and many."""
    mu = np.cos(np.linspace(np.pi, 0.0, rows))
    values = record.value(mu)
    below = np.r_[0.0, np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(mu)) * 2 * np.pi]
    return mu, below / below[-1]


@every
def test_values_are_those_of_the_record(mi, record):
    """At cosines as single precision has them, down to the last beside the peak: within 0.1 %."""
    cosines = np.concatenate(
        [np.linspace(-1, 1, 4001), 1 - np.geomspace(1e-7, 1, 400), np.geomspace(1e-7, 1, 400) - 1]
    ).astype(np.float32)
    found = np.array(kernel_phase(record).value(mi.Float(cosines)))
    np.testing.assert_allclose(found, record.value(cosines.astype(np.float64)), rtol=1e-3, atol=1e-7)


def test_two_media_scatter_as_one_of_their_sum(mi):
    """The kernel's phase function of rain in fog, times all that is scattered, is theirs: within 0.1 %."""
    parts = [Fog.named(name).over(FogMedium(1.0)) for name in ("rain10", "dust5000", "mor9000")]
    both = joined(parts)
    cosines = np.concatenate([np.linspace(-1, 1, 4001), 1 - np.geomspace(1e-7, 1, 400)]).astype(np.float32)
    found = both.sigma_t_per_m * both.albedo * np.array(kernel_phase(both.phase_function).value(mi.Float(cosines)))
    wanted = sum(part.sigma_t_per_m * part.albedo * part.phase_function.value(cosines.astype(float)) for part in parts)
    np.testing.assert_allclose(found, wanted, rtol=1e-3)


@every
def test_directions_are_drawn_in_proportion_to_the_record(mi, record):
    """Chi-squared over 40 x 10 cells of equal probability (angle to the forward direction, turn about it), 400 000
    draws, alpha 1e-4.

    A thousand draws a cell: a density wrong by 1 % over half of the sphere gives a
    chi-squared of 40 more on 399 +- 28, one wrong by 2 % is found 19 times in 20.
    """
    cosine, turn, _ = sampled(mi, record, 400_000, 7)
    mu, below = cumulated(record)
    edges = np.interp(np.linspace(0, 1, 41), below, mu)
    edges[0], edges[-1] = -1.1, 1.1
    counts, _, _ = np.histogram2d(cosine, turn, bins=[edges, np.linspace(0, 1, 11)])
    assert counts.sum() == 400_000
    chance = stats.chi2.sf(((counts - 1000.0) ** 2 / 1000.0).sum(), 399)
    assert chance > 1e-4, f"chi-squared says {chance:.2g}"


@every
def test_a_draw_comes_with_the_value_of_its_direction(mi, record):
    """value(cosine) of a drawn direction is the density that came with it, to what single precision makes of a dot
    product.

    The product is off by 2.5e-7 at most, and the logarithm of p goes no faster than
    3 g / (1 - g)^2 with the cosine.
    """
    cosine, _, density = sampled(mi, record, 100_000, 3)
    slope = {
        HenyeyGreenstein: lambda: 3 * abs(record.g) / (1 - abs(record.g)) ** 2,
        Droplets: lambda: 3 / (1 - record.parameters()[0]) ** 2,
    }
    steepest = slope.get(type(record), lambda: 1e3)()
    np.testing.assert_allclose(density, record.value(cosine), rtol=1e-3 + 2.5e-7 * steepest, atol=1e-6)


@pytest.mark.parametrize("g, table", [(-0.99, False), (0.5, False), (0.87, True)])
def test_the_plugin_is_mitsubas_own_hg(mi, g, table):
    """The same density in every direction, also as a table.

    Mitsuba computes 1 + g^2 - 2 g cos as it stands: with g = 0.99 its rounding alone
    is 1.2e-7 / (1 - g)^2, times 1.5 for the power.
    """
    record = HenyeyGreenstein(g)
    ours = plugin(Tabulated(*record.table(), "hg") if table else record)
    theirs = mi.load_dict({"type": "hg", "g": g})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 100_000)
    mei = dr.zeros(mi.MediumInteraction3f, 100_000)
    mei.wi = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    mei.sh_frame = mi.Frame3f(mei.wi)
    context = mi.PhaseFunctionContext()
    towards, _, _ = theirs.sample(context, mei, 0.5, sampler.next_2d())
    for wo in (towards, mi.warp.square_to_uniform_sphere(sampler.next_2d())):
        (value, density), (wanted, _) = ours.eval_pdf(context, mei, wo), theirs.eval_pdf(context, mei, wo)
        tolerance = (1e-3 if table else 1e-5) + 4 * 1.5 * 1.2e-7 / (1 - abs(g)) ** 2
        np.testing.assert_allclose(np.array(value)[0], np.array(wanted)[0], rtol=tolerance)
        np.testing.assert_array_equal(np.array(density), np.array(value)[0])
    wo, weight, _ = ours.sample(context, mei, 0.5, sampler.next_2d())
    assert np.all(np.array(weight) == 1.0)
    cosine = -np.sum(np.array(wo) * np.array(mei.wi), axis=0)
    assert abs(cosine.mean() - g) < 5 * cosine.std() / np.sqrt(cosine.size) + 1e-4


# -- in Mitsuba's integrators

WORLD = {
    "light_sky": {"type": "constant", "radiance": rgb(0.2, 0.2, 0.2)},
    "shape_moon": {"type": "sphere", "center": [25.0, 20.0, 0.0], "radius": 9.0, **black(3.0)},
    "shape_ball": {"type": "sphere", "center": [-1.0, 15.0, 0.0], "radius": 4.0, "bsdf": {"type": "diffuse"}},
}


def pictures(fog, integrator="volpath", samples=512, seeds=6):
    """One picture a seed, by Mitsuba's own film."""
    mi = backend.mitsuba()
    loaded = to_mitsuba(scene(WORLD, fog, fov_x_deg=60.0))
    tracer = mi.load_dict({"type": integrator, "max_depth": -1, "rr_depth": 8})
    return np.array(
        [np.array(tracer.render(loaded.scene, loaded.sensor, seed, samples), dtype=np.float64) for seed in range(seeds)]
    )


ROOM = box((10.0, 30.0, 10.0), (0.0, 5.0, 0.0))
UNIFORM = FogVolume("/Fog", ROOM, FogMedium(0.05, albedo=0.9, g=0.8))


def gridded(boundary, values, path="/Fog", sigma_t=0.05):
    return FogVolume(path, boundary, FogMedium(sigma_t, albedo=0.9, g=0.8, profile="grid", grid=DensityGrid(values)))


@pytest.fixture(scope="module")
def uniform():
    """Of fog that is even by its formula."""
    if backend.is_scalar():
        pytest.skip("vectorised tests")
    return pictures([UNIFORM])


@pytest.mark.slow
def test_a_grid_of_equal_voxels_is_uniform_fog(uniform):
    """Delta tracking against closed-form distances, half as dense as sigma_t says; 2 % is resolved."""
    assert_agree(uniform, pictures([gridded(ROOM, np.full((3, 2, 4), 0.5), sigma_t=0.1)]), sigmas=4.5, resolves=0.02)


def test_a_tabulated_phase_draws_the_picture_of_its_closed_form(uniform):
    """`volpath` with a table of Henyey-Greenstein against its own; 2 % is resolved."""
    table = Tabulated(*HenyeyGreenstein(0.8).table(), "hg")
    tabulated = FogVolume("/Fog", ROOM, FogMedium(0.05, albedo=0.9, phase=table))
    assert_agree(uniform, pictures([tabulated]), sigmas=4.5, resolves=0.02)


def test_the_scalar_variant_draws_the_same():
    """In a child with Mitsuba's scalar variant: value, draw and plugin give the numbers of the record and a finite
    picture.
    """
    import subprocess
    import sys

    code = """
import numpy as np
from synfog_usd.render import backend
backend.start("scalar")
mi = backend.mitsuba()
from synfog_usd.fog import Fog, FogMedium, FogVolume
from synfog_usd.fog.kinds import joined
from synfog_usd.fog.phase import Droplets, HenyeyGreenstein
from synfog_usd.render.load import to_mitsuba
from synfog_usd.render.media.phases import kernel_phase
from synfog_usd.scene.testing import box, scene
draw = np.random.default_rng(1)
for record in (Droplets(10.0), HenyeyGreenstein(-0.6)):
    phase = kernel_phase(record)
    for cosine in (-1.0, -0.2, 0.5, 0.999, 1.0):
        assert abs(phase.value(cosine) / float(record.value(cosine)) - 1) < 1e-3
    cosines = np.array([phase.sample(mi.Vector3f(0, 0, 1), mi.Point2f(*draw.random(2)))[0].z for _ in range(4000)])
    assert abs(cosines.mean() - record.mean_cosine) < 4 * cosines.std() / 4000**0.5 + 1e-4
world = scene({"light_sky": {"type": "constant"}}, [FogVolume("/Fog", box(20.0), FogMedium(0.05, phase=Droplets(10.0)))])
loaded = to_mitsuba(world)
picture = np.array(mi.load_dict({"type": "volpath", "max_depth": -1, "rr_depth": 8}).render(loaded.scene, loaded.sensor, 0, 4))
assert abs(picture.mean() - 1.0) < 0.02  # white furnace
print("same")
"""  # noqa: E501
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert child.stdout.strip() == "same", child.stderr

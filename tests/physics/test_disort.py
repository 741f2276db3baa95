"""An empty slab of fog against discrete ordinates, from the ground, zenith 0 to 87 degrees.

Rationale: `fog.slab.solve` shares no code with path tracing, and is itself tested
against PythonicDISORT, which wants an albedo below 1: compared here directly where it
is stable, with fog that absorbs.
"""

import warnings

import numpy as np
import pytest
from support import renders
from support.renders import by_seed
from support.stats import assert_mean

from synfog_usd.fog.medium import FogMedium, extinction_from_visibility
from synfog_usd.scene.testing import empty_slab

SEEDS = 12
BANDS = 4
"""Groups of rows from the zenith to the horizon, each compared alone."""

SAMPLES = 24576
"""A standard error of 0.02 % in the noisiest band."""

CASES = [(visibility_m, ground) for visibility_m in (600.0, 300.0, 150.0) for ground in (0.0, 0.15, 0.5)]


def bands(world, samples):
    """(SEEDS, BANDS) radiance over truth."""
    truth = world.truth.reshape(BANDS, -1).mean(axis=1)
    runs = [
        run.radiance.pixels.mean(axis=2, dtype=np.float64)
        for run in by_seed(world.scene, range(SEEDS), model="path", samples=samples)
    ]
    return np.array([run.reshape(BANDS, -1).mean(axis=1) for run in runs]) / truth


@pytest.mark.physics
@pytest.mark.parametrize("visibility_m, ground", CASES)
def test_an_empty_slab_is_that_of_discrete_ordinates(visibility_m, ground):
    """Each quarter of the sky's arc is within 0.1 %, and five standard errors are less than that."""
    world = empty_slab(FogMedium(float(extinction_from_visibility(visibility_m))), ground)
    ratio = bands(world, SAMPLES)
    error = ratio.std(axis=0, ddof=1) / np.sqrt(SEEDS)
    assert np.all(5 * error < 1e-3), f"cannot see 0.1 %: {error}"
    assert np.all(np.abs(ratio.mean(axis=0) - 1.0) < 1e-3), ratio.mean(axis=0) - 1.0


@pytest.mark.physics
@pytest.mark.parametrize("sunk_m", [0.0, 1.0], ids=["floor on the ground", "floor under the ground"])
def test_the_fog_may_end_on_the_ground_or_under_it(sunk_m):
    """A box of fog whose floor is the ground itself, as artists draw it, gives the same light; 1 % is resolved."""
    world = empty_slab(FogMedium(0.02), 0.5, sunk_m=sunk_m)
    assert_mean(bands(world, 128).mean(axis=1), 1.0, resolves=0.01)


@pytest.mark.physics
@pytest.mark.parametrize("ground", [0.0, 0.5])
def test_fog_that_absorbs_is_that_of_the_library(ground):
    """PythonicDISORT, albedo 0.9, 64 streams: `path` within 0.25 %, five of its standard errors, on four of the nodes
    and half a degree around.
    """
    pydisort = pytest.importorskip("PythonicDISORT").pydisort
    medium = FogMedium(0.02, albedo=0.9)
    streams, top, eye = 64, 60.0, 1.5
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mu, _, _, u0 = pydisort(
            np.array([0.02 * top]),
            np.array([0.9]),
            streams,
            0.87 ** np.arange(streams + 1)[None],
            1.0,
            0.0,
            0.0,
            NLeg=streams,
            NFourier=1,
            b_neg=1.0,
            f_arr=0.87**streams,
            BDRF_Fourier_modes=[ground] if ground else [],
            only_flux=True,
        )
        seen = u0(0.02 * (top - np.array([eye, 0.0])))[:, 0]
    upward = np.flatnonzero(mu < 0.0)
    upward = upward[np.argsort(-mu[upward])]
    for index in upward[[6, 12, 20, 28]]:
        zenith = np.degrees(np.arccos(-mu[index]))
        world = empty_slab(medium, ground, zenith_deg=(zenith - 0.5, zenith + 0.5), width_px=8, height_px=8)
        np.testing.assert_allclose(world.truth.mean(), seen[index], rtol=1e-3)
        means = renders.means(world.scene, SEEDS, model="path", samples=8192)
        assert np.std(means, ddof=1) / np.sqrt(SEEDS) < 5e-4 * seen[index]
        assert abs(np.mean(means) / seen[index] - 1.0) < 2.5e-3

"""The plane-parallel solution, against truths that need no discrete ordinates, and against a library of them.

Rationale: path tracing is judged by the slab, so what counts is its radiance at any height and up to the horizon.
Bounds are measured values times 3 or so, unless a line says more.
"""

import warnings

import numpy as np
import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.fog.medium import FogMedium, extinction_from_visibility
from synfog_usd.fog.slab import solve

TOP = 60.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
UP = ((NODES + 1.0) / 2.0) ** 2
"""Cosines that crowd the horizon, for an integral over the hemisphere."""


def solved(fog, *, ground=0.15, **more):
    """A 60 m slab."""
    return solve(fog, bottom_m=0.0, top_m=TOP, ground=ground, **more)


def flux(slab, height, sign):
    """Irradiance over pi on a surface that faces the sky (sign 1) or the ground (-1)."""
    return float(slab.radiance(np.full(UP.size, height), sign * UP) * UP**1.5 @ WEIGHTS) * 2.0


def anywhere(count, seed=0):
    """Heights and directions; a third of them crowd the boundaries and the horizon."""
    rng = np.random.default_rng(seed)
    height, up = rng.uniform(0.0, TOP, count), rng.uniform(-1.0, 1.0, count)
    crowd = count // 3
    edge = 10.0 ** rng.uniform(-6.0, 0.0, crowd)
    height[:crowd] = TOP * np.where(rng.random(crowd) < 0.5, edge, 1.0 - edge)
    up[:crowd] = rng.choice([-1.0, 1.0], crowd) * 10.0 ** rng.uniform(-5.0, 0.0, crowd)
    return height, up


@pytest.mark.parametrize("g", [0.87, -0.5])
@pytest.mark.parametrize("tau", [1e-9, 1.2, 1000.0])
def test_white_furnace_is_white(tau, g):
    """Sky 1, ground 1, albedo 1: radiance is 1 everywhere.  Measured 6e-11."""
    slab = solved(FogMedium(tau / TOP, g=g), ground=1.0)
    np.testing.assert_allclose(slab.radiance(*anywhere(600)), 1.0, atol=1e-9)


def test_path_traced_radiance_from_the_ground():
    """Path tracing of an empty slab; its noise is below 0.1 %."""
    radiance = solved(FogMedium(0.02)).radiance(np.zeros(5), np.cos(np.radians([0.0, 30.0, 60.0, 75.0, 85.0])))
    np.testing.assert_allclose(radiance, [0.96190, 0.94773, 0.85108, 0.68555, 0.50335], rtol=1e-3)


def disort(tau, albedo, ground, height, streams=64):
    """u (directions, heights) of PythonicDISORT and the `up` of its directions."""
    from PythonicDISORT import pydisort

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an albedo near 1
        mu, _, _, u0 = pydisort(
            np.array([tau]),
            np.array([albedo]),
            streams,
            0.87 ** np.arange(streams + 1)[None],
            1.0,
            0.0,
            0.0,
            NLeg=streams,
            NFourier=1,
            b_neg=np.ones(streams // 2),
            f_arr=0.87**streams,
            BDRF_Fourier_modes=[ground] if ground else [],
            only_flux=True,
        )
        return u0(tau * (1.0 - height / TOP)), -mu


@pytest.mark.parametrize("visibility_m, ground", [(600.0, 0.5), (150.0, 0.0)])
@pytest.mark.parametrize(
    "albedo, library_albedo, streams, rtol",
    [
        (0.9, 0.9, 64, 1e-9),  # the same equations: rounding
        (0.9, 0.9, 128, 1e-3),  # other streams: 64 of them are good to 4e-4 at the horizon
        (1.0, 1.0 - 1e-6, 128, 1e-3),  # nearer to 1 the library loses its digits
    ],
)
def test_library_of_discrete_ordinates_agrees(visibility_m, ground, albedo, library_albedo, streams, rtol):
    """PythonicDISORT at its 64 nodes, six heights."""
    fog = FogMedium(float(extinction_from_visibility(visibility_m)), albedo=albedo)
    slab = solved(fog, ground=ground, streams=streams)
    height = np.array([59.99, 59.0, 30.0, 10.0, 1.0, 0.001])
    truth, up = disort(slab.optical_depth, library_albedo, ground, height)
    radiance = slab.radiance(np.tile(height, up.size), np.repeat(up, height.size)).reshape(up.size, height.size)
    np.testing.assert_allclose(radiance, truth, rtol=rtol, atol=1e-9)


@pytest.mark.parametrize("ground", [0.0, 0.15, 1.0])
def test_nothing_is_lost_without_absorption(ground, tau=1.2):
    """Albedo 1: the net flux is the same at every height; with ground 1 it is zero.  Bound: the quadrature's error."""
    slab = solved(FogMedium(tau / TOP), ground=ground)
    down, up = np.array([[flux(slab, height, sign) for height in (0.0, 0.01, 5.0, 30.0, 60.0)] for sign in (1, -1)])
    np.testing.assert_allclose(down - up, (down - up)[0] if ground < 1.0 else 0.0, atol=3e-5 * down.max())
    np.testing.assert_allclose(up[0], ground * down[0], rtol=1e-4, atol=1e-12)


@pytest.mark.parametrize("g, tau, rtol", [(0.0, 10.0, 1e-6), (0.0, 100.0, 1e-6), (0.87, 1000.0, 1e-4)])
def test_thick_fog_lets_through_what_diffusion_says(g, tau, rtol):
    """Of a uniform sky over black ground (4/3) / ((1 - g) tau + 2 q), q of Milne's problem; q is 0.7104461 for g = 0
    and changes with g, which counts for 1 % / ((1 - g) tau).

    Source: van de Hulst, Multiple Light Scattering (1980).
    """
    slab = solved(FogMedium(tau / TOP, g=g), ground=0.0)
    truth = (4.0 / 3.0) / ((1.0 - g) * tau + 2.0 * 0.7104461)
    np.testing.assert_allclose(flux(slab, 0.0, 1), truth, rtol=rtol)


@pytest.mark.parametrize("sigma_t", [0.0, 0.02])
def test_fog_that_only_absorbs_obeys_beer_lambert(sigma_t):
    """Albedo 0, or clear air: L = exp(-tau / |up|) times the boundary; the ground is lit by 2 E3(tau)."""
    from scipy.special import expn

    slab = solved(FogMedium(sigma_t, albedo=0.0), ground=0.5)
    np.testing.assert_allclose(slab.ground_radiance, 0.5 * 2.0 * expn(3, sigma_t * TOP), rtol=1e-5)
    height, up = anywhere(1000)
    tau = sigma_t * np.where(up >= 0.0, TOP - height, height)
    edge = np.where(up >= 0.0, 1.0, slab.ground_radiance)
    np.testing.assert_allclose(slab.radiance(height, up), edge * np.exp(-tau / np.abs(up)), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    "change, words", [({"top_m": 0.0}, "bottom below the top"), ({"ground": 1.1}, "ground albedo")]
)
def test_what_no_slab_can_be_is_refused(change, words):
    """One clear line each."""
    with pytest.raises(ParameterError, match=words):
        solve(FogMedium(0.02), **{"bottom_m": 0.0, "top_m": TOP, "ground": 0.15} | change)

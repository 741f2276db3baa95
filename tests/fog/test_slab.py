"""The plane-parallel solution, against truths that need no discrete ordinates, and against a library of them.

Rationale: path tracing is judged by the slab, so what counts is that radiance
and source satisfy the transfer equation between them, at any height and up to
the horizon.  Bounds are measured values times 3 or so, unless a line says more.
"""

import warnings

import numpy as np
import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.fog.medium import FogMedium, extinction_from_visibility
from synfog_usd.fog.slab import solve

TOP = 60.0
RINGS = np.linspace(1e-12, 1.0, 90)
OVERCAST = ((1.0 + 2.0 * RINGS) / 3.0)[:, None]


def solved(fog, *, ground=0.15, sky=OVERCAST, **more):
    """A 60 m slab with one channel."""
    return solve(
        fog, bottom_m=0.0, top_m=TOP, ground=[ground], sky_up=RINGS if len(sky) > 1 else [1.0], sky=sky, **more
    )


def anywhere(count, seed=0):
    """Heights and directions; a third of them crowd the boundaries and the horizon."""
    rng = np.random.default_rng(seed)
    height, up = rng.uniform(0.0, TOP, count), rng.uniform(-1.0, 1.0, count)
    crowd = count // 3
    edge = 10.0 ** rng.uniform(-6.0, 0.0, crowd)
    height[:crowd] = TOP * np.where(rng.random(crowd) < 0.5, edge, 1.0 - edge)
    up[:crowd] = rng.choice([-1.0, 1.0], crowd) * 10.0 ** rng.uniform(-5.0, 0.0, crowd)
    return height, up


def directions():
    """Nodes and weights over up in (-1, 1): 6 Gauss nodes from ring to ring, and finer toward 0 from both sides."""
    s, w = np.polynomial.legendre.leggauss(6)
    edge = np.concatenate([[0.0], np.geomspace(1e-6, RINGS[1], 12)[:-1], RINGS[1:]])
    v = (edge[:-1, None] + np.diff(edge)[:, None] * (s + 1.0) / 2.0).ravel()
    dv = (np.diff(edge)[:, None] * w / 2.0).ravel()
    return np.concatenate([-v, v]), np.concatenate([dv, dv])


@pytest.mark.parametrize("g", [0.87, -0.5])
@pytest.mark.parametrize("tau", [1e-9, 1.2, 1000.0])
def test_white_furnace_is_white(tau, g):
    """Sky 1, ground 1, albedo 1: radiance is 1 everywhere.  Measured 6e-11; irradiance 3e-9 (its quadrature)."""
    slab = solved(FogMedium(tau / TOP, g=g), ground=1.0, sky=[[1.0]])
    height, up = anywhere(600)
    np.testing.assert_allclose(slab.radiance(height, up), 1.0, atol=1e-9)
    np.testing.assert_allclose(slab.source(height, up), 1.0, atol=1e-9)
    np.testing.assert_allclose(slab.irradiance(height[:50], up[:50]), np.pi, rtol=1e-8)
    np.testing.assert_allclose(slab.table(16, 16), 1.0, rtol=1e-6)


def test_path_traced_radiance_from_the_ground():
    """Path tracing of an empty slab, physics notes section 2; its noise is below 0.1 %."""
    slab = solved(FogMedium(0.02), sky=[[1.0]])
    seen = slab.radiance(np.zeros(5), np.cos(np.radians([0.0, 30.0, 60.0, 75.0, 85.0])))[:, 0]
    np.testing.assert_allclose(seen, [0.96190, 0.94773, 0.85108, 0.68555, 0.50335], rtol=1e-3)


def disort(tau, albedo, ground, height, streams=64):
    """u (directions, heights) of PythonicDISORT and the `up` of its directions."""
    from PythonicDISORT import pydisort

    node = (np.polynomial.legendre.leggauss(streams // 2)[0] + 1.0) / 2.0
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
            b_neg=np.interp(node, RINGS, OVERCAST[:, 0]),
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
    seen = slab.radiance(np.tile(height, up.size), np.repeat(up, height.size))[:, 0].reshape(up.size, height.size)
    np.testing.assert_allclose(seen, truth, rtol=rtol, atol=1e-9)


@pytest.mark.parametrize("g", [0.87, -0.5])
def test_source_is_the_integral_of_phase_and_radiance(g):
    """J = integral of p L over the sphere, with HG itself (no Legendre series) and other nodes; the target of a control
    variate.
    """
    slab = solved(FogMedium(0.02, g=g), sky=np.where(RINGS < 0.3, 2.0, 0.2)[:, None])
    node, weight = directions()
    phi = (np.arange(200) + 0.5) * np.pi / 200.0
    for height in (0.0, 1e-3, 0.5, 20.0, 59.9, 59.999, 60.0):
        L = slab.radiance(np.full(node.size, height), node)[:, 0]
        up = np.array([-1.0, -0.6, -0.03, 0.0, 0.01, 0.3, 0.97])
        cosine = up[:, None, None] * node[:, None] + np.sqrt(
            (1.0 - up**2)[:, None, None] * (1.0 - node**2)[:, None]
        ) * np.cos(phi)
        phase = (0.5 * (1.0 - g * g) / (1.0 + g * g - 2.0 * g * cosine) ** 1.5).mean(axis=-1)
        # Subtract and add L at `up` itself where the peak is sharp: the phase integrates to 1.
        own = slab.radiance(np.full(up.size, height), up)
        truth = own[:, 0] + np.einsum("un,n,un->u", phase, weight, L - own)
        np.testing.assert_allclose(slab.source(np.full(up.size, height), up)[:, 0], truth, rtol=2e-4)


def test_nothing_is_lost_without_absorption(tau=1.2):
    """Albedo 1: the net flux is the same at every height; with ground 1 it is zero.  Bound: the irradiance's
    quadrature, 1e-6.
    """
    height = np.array([0.0, 0.01, 5.0, 30.0, 59.0, 60.0])
    for ground in (0.0, 0.15, 1.0):
        slab = solved(FogMedium(tau / TOP), ground=ground)
        down, up = slab.irradiance(height, np.ones(6))[:, 0], slab.irradiance(height, -np.ones(6))[:, 0]
        np.testing.assert_allclose(down - up, (down - up)[0] if ground < 1.0 else 0.0, atol=3e-5 * down.max())
        np.testing.assert_allclose(up[0], ground * down[0], rtol=1e-4, atol=1e-12)


@pytest.mark.parametrize("g, tau, rtol", [(0.0, 10.0, 1e-6), (0.0, 100.0, 1e-6), (0.87, 1000.0, 1e-4)])
def test_thick_fog_lets_through_what_diffusion_says(g, tau, rtol):
    """Of a uniform sky over black ground (4/3) / ((1 - g) tau + 2 q), q of Milne's problem; q is 0.7104461 for g = 0
    and changes with g, which counts for 1 % / ((1 - g) tau).

    Source: van de Hulst, Multiple Light Scattering (1980).
    """
    slab = solved(FogMedium(tau / TOP, g=g), ground=0.0, sky=[[1.0]])
    truth = (4.0 / 3.0) / ((1.0 - g) * tau + 2.0 * 0.7104461)
    np.testing.assert_allclose(slab.irradiance(np.zeros(1), np.ones(1))[0, 0] / np.pi, truth, rtol=rtol)


def test_fog_that_only_absorbs_obeys_beer_lambert():
    """Albedo 0: L = exp(-tau / |up|) times the boundary."""
    slab = solved(FogMedium(0.02, albedo=0.0), ground=0.5)
    height, up = anywhere(1000)
    tau = 0.02 * np.where(up >= 0.0, TOP - height, height)
    edge = np.where(up >= 0.0, np.interp(np.abs(up), RINGS, OVERCAST[:, 0]), slab.ground_radiance)
    np.testing.assert_allclose(slab.radiance(height, up)[:, 0], edge * np.exp(-tau / np.abs(up)), rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(slab.source(height, up), 0.0)


def test_clear_air_shows_sky_and_ground():
    """No fog: the sky above, and ground lit by it, 0.15 / pi times the irradiance 7 pi / 9 of an overcast sky."""
    slab = solved(FogMedium(0.0))
    height, up = anywhere(200)
    truth = np.where(up >= 0.0, np.interp(np.abs(up), RINGS, OVERCAST[:, 0]), 0.15 * 7.0 / 9.0)
    np.testing.assert_allclose(
        slab.radiance(height, up)[:, 0], truth, rtol=1e-5
    )  # the sky is flat below its lowest ring
    assert slab.optical_depth == 0.0 and np.all(np.isfinite(slab.table(8, 8)))


def test_tables_hold_the_radiance(sigma_t=0.02):
    """Bilinear lookup at the default size: median error < 1e-4, 99th percentile < 1e-3, at random heights and
    directions.
    """
    slab = solved(FogMedium(sigma_t))
    rng = np.random.default_rng(2)
    height, up = rng.uniform(0.0, TOP, 8000), rng.uniform(-1.0, 1.0, 8000)
    error = np.abs(slab.lookup(slab.table(), height, up) / slab.radiance(height, up) - 1.0)
    assert np.median(error) < 1e-4 and np.quantile(error, 0.99) < 1e-3, (np.median(error), np.quantile(error, 0.99))
    height, normal = height[:1000], up[:1000]
    error = np.abs(
        slab.lookup_irradiance(slab.irradiance_table(), height, normal) / slab.irradiance(height, normal) - 1.0
    )
    assert np.median(error) < 1e-4 and np.quantile(error, 0.99) < 1e-3, (np.median(error), np.quantile(error, 0.99))


@pytest.mark.parametrize(
    "change, words",
    [
        ({"top_m": 0.0}, "bottom below the top"),
        ({"ground": [1.1]}, "ground albedo"),
        ({"sky_up": [0.5, 0.4]}, "ascending"),
        ({"sky": [[-1.0], [1.0]]}, "negative"),
        ({"streams": 7}, "even number"),
        ({"moments": np.ones(200)}, "moments"),
    ],
)
def test_what_no_slab_can_be_is_refused(change, words):
    """One clear line each."""
    given = {"bottom_m": 0.0, "top_m": TOP, "ground": [0.15], "sky_up": [0.5, 1.0], "sky": [[1.0], [1.0]]} | change
    with pytest.raises(ParameterError, match=words):
        solve(FogMedium(0.02), **given)

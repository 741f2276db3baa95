"""Patchy fog: mean, deviation and spectrum of its field, and optical depths where it repeats."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.fog.patchy import VOXELS, patchy
from synfog_usd.fog.volume import optical_depth
from synfog_usd.scene.testing import box


def test_mean_and_deviation_are_kept():
    """Mean 1 to single precision, deviation to 0.1 %, nothing negative; another seed is another field."""
    for deviation in (0.0, 0.5, 1.5):
        values = patchy(8.0, deviation).values.astype(np.float64)
        np.testing.assert_allclose(values.mean(), 1.0, rtol=1e-6)
        np.testing.assert_allclose(values.std(), deviation, rtol=1e-3, atol=1e-6)
        assert values.min() > 0.0
    np.testing.assert_array_equal(patchy(8.0, 0.5).values, patchy(20.0, 0.5).values)
    assert abs(np.corrcoef(patchy(8.0, 0.5).values.ravel(), patchy(8.0, 0.5, seed=1).values.ravel())[0, 1]) < 0.02


def test_the_spectrum_is_von_karmans():
    """Power in ten shells of wave number against (k^2 + k0^2)^(-11/6), of an outer scale of 8 m in a cube of 128 m: two
    fields have at least 4000 waves a shell, so 2.2 % of scatter; 8 % is allowed.
    """
    k = 2.0 * np.pi * np.fft.fftfreq(VOXELS)  # [1/m]: a voxel is one metre
    k = np.sqrt(k[:, None, None] ** 2 + k[:, None] ** 2 + k**2)
    wanted = np.where(k > 0.0, (k**2 + (2.0 * np.pi / 8.0) ** 2) ** (-11.0 / 6.0), 0.0)
    wanted *= 0.5**2 / wanted.sum()
    grids = [patchy(8.0, 0.5, seed=seed) for seed in range(2)]
    assert grids[0].period_m == 128.0
    power = np.mean([np.abs(np.fft.fftn(grid.values) / grid.values.size) ** 2 for grid in grids], axis=0)
    shells = np.linspace(0.25, np.pi, 11)
    for low, high in itertools.pairwise(shells):
        shell = (k > low) & (k <= high)
        assert power[shell].sum() == pytest.approx(wanted[shell].sum(), rel=0.08)


@pytest.fixture(scope="module")
def repeated():
    """A field of 4 voxels that repeats every 8 m, the same one written out over 40 m, and rays through both."""
    values = np.random.default_rng(0).random((4, 4, 4)) + 0.5
    many = np.tile(values / 2.0, (5, 5, 5))
    medium = FogMedium(0.05, profile="grid", grid=DensityGrid(values, period_m=8.0))
    even = FogVolume("/Fog", box(20.0), FogMedium(0.1, profile="grid", grid=DensityGrid(many)))
    draw = np.random.default_rng(1)
    direction = draw.normal(size=(30, 3))
    rays = draw.uniform(-14.0, 14.0, (30, 3)), direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return FogVolume("/Fog", box(19.0), medium), even, rays


def test_a_field_that_repeats_is_that_of_its_copies(repeated):
    """Over 5 m within them, whose outer voxels have no neighbours."""
    patches, even, rays = repeated
    length = np.full(30, 5.0)
    np.testing.assert_allclose(optical_depth([patches], *rays, length), optical_depth([even], *rays, length), rtol=1e-6)


def test_the_field_moves_with_its_origin(repeated):
    """A camera that moves along sees the same; after a whole period all is as before."""
    patches, _, (origin, direction) = repeated
    wind, length = np.array([1.5, -2.5, 0.25]), np.full(30, 3.0)
    drifted = replace(patches, origin_m=tuple(wind))
    still = optical_depth([patches], origin, direction, length)
    np.testing.assert_allclose(optical_depth([drifted], origin + wind, direction, length), still, rtol=1e-9)
    assert np.abs(optical_depth([drifted], origin, direction, length) / still - 1.0).max() > 0.05
    round_again = replace(patches, origin_m=(8.0, -16.0, 0.0))
    np.testing.assert_allclose(optical_depth([round_again], origin, direction, length), still, rtol=1e-9)


def test_what_a_renderer_without_repeats_holds_is_the_same_field(repeated):
    """Written out over the boundary, with the drift in it."""
    patches, _, (origin, direction) = repeated
    patches, length = replace(patches, origin_m=(1.0, 2.5, -3.0)), np.full(30, 4.0)
    values, frame = patches.covered()
    written = replace(
        patches,
        boundary=replace(patches.boundary, to_world=frame),
        medium=FogMedium(0.1, profile="grid", grid=DensityGrid(values / 2.0)),
    )
    np.testing.assert_allclose(
        optical_depth([written], origin, direction, length),
        optical_depth([patches], origin, direction, length),
        rtol=1e-6,
    )
    with pytest.raises(ParameterError, match=r"/Fog: its patchy fog fills .* voxels.*--model path"):
        replace(patches, boundary=box(3000.0)).covered()


def test_the_mean_visibility_is_that_of_the_medium():
    """Along 2 km the optical depth is that of even fog, within the scatter of 125 correlated patches."""
    fog = FogVolume("/Fog", box(2000.0), FogMedium(0.002, profile="grid", grid=patchy(8.0, 0.5)))
    tau = optical_depth([fog], np.zeros((1, 3)), np.array([[0.6, 0.64, 0.48]]), np.array([2000.0]))
    np.testing.assert_allclose(tau, 4.0, rtol=0.1)


@pytest.mark.parametrize("values", [(0.1, 0.5, 0), (8.0, 3.0, 0), (8.0, -0.5, 0), (8.0, 0.5, -1), (np.nan, 0.5, 0)])
def test_impossible_fields_are_refused(values):
    scale, deviation, seed = values
    with pytest.raises(ParameterError):
        patchy(scale, deviation, seed=seed)

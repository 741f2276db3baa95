"""Density grids: what is refused, and optical depths against brute force and closed forms."""

import numpy as np
import pytest
import trimesh

from synfog_usd.base.errors import ParameterError
from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.fog.volume import optical_depth
from synfog_usd.scene.testing import box


def cloud(boundary, values, sigma_t=0.1):
    return FogVolume("/Cloud", boundary, FogMedium(sigma_t, profile="grid", grid=DensityGrid(values)))


def test_the_mean_along_a_line_is_that_of_many_points_on_it():
    """Random voxels and lines: two Gauss points a piece against 50 000 midpoints, whose own error is 2e-8."""
    draw = np.random.default_rng(0)
    values = draw.random((5, 4, 7))
    begin, end = draw.uniform(-1, 1, (2, 20, 3))
    begin[0, 1:] = end[0, 1:]  # along an axis
    begin[1, 0] = end[1, 0]  # within a plane of voxel centres
    begin[1, 0] = end[1, 0] = (2 * 3 + 1) / 7 - 1

    def density(points):
        place = (points + 1) / 2 * values.shape[::-1] - 0.5
        total = np.zeros(len(points))
        for corner in np.ndindex(2, 2, 2):
            low = np.floor(place).astype(int)
            weight = np.prod(np.where(corner, place - low, 1 - place + low), axis=1)
            x, y, z = np.clip(low + corner, 0, np.array(values.shape[::-1]) - 1).T
            total += weight * values[z, y, x]
        return total

    steps = (np.arange(50_000) + 0.5)[:, None] / 50_000
    wanted = [density(a + steps * (b - a)).mean() for a, b in zip(begin, end, strict=True)]
    np.testing.assert_allclose(
        DensityGrid(values).mean(begin, end), wanted, rtol=1e-7
    )  # voxels in single precision: 6e-8


def test_equal_voxels_are_uniform_fog():
    """In a turned and stretched box, from inside and outside, seen from 50 random places."""
    matrix = np.eye(4)
    matrix[:3, :3] = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.5, 0.9]))[:3, :3] @ np.diag(
        [30.0, 5.0, 12.0]
    )
    draw = np.random.default_rng(1)
    origin, direction = draw.uniform(-12, 12, (50, 3)), draw.normal(size=(50, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    uniform = FogVolume("/Fog", Boundary("box", matrix), FogMedium(0.05))
    wanted = optical_depth([uniform], origin, direction, np.full(50, np.inf))
    assert np.count_nonzero(wanted) > 10
    found = optical_depth(
        [cloud(Boundary("box", matrix), np.full((3, 2, 4), 0.5))], origin, direction, np.full(50, np.inf)
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)


def test_axes_are_z_y_x():
    """A voxel that is dense at high z, low y and the middle of x is met only there."""
    values = np.zeros((2, 3, 5))
    values[1, 0, 2] = 1.0
    grid = DensityGrid(values)
    at = np.array([[0.0, -2 / 3, 0.5]])
    assert grid.mean(at, at) == 1.0
    assert (
        grid.mean(at * [[1, -1, 1]], at * [[1, -1, 1]]) == 0.0
        and grid.mean(at * [[1, 1, -1]], at * [[1, 1, -1]]) == 0.0
    )


def test_a_bank_with_a_grid_takes_the_place_of_the_fog_around_it():
    """0.02 per metre outside, 0.1 x 0.5 inside for 10 m of 30."""
    around = FogVolume("/Fog", box(100.0), FogMedium(0.02))
    bank = FogVolume(
        "/Bank",
        box(5.0, (0, 15, 0)),
        FogMedium(0.1, profile="grid", grid=DensityGrid(np.full((2, 2, 2), 0.5))),
        parent=0,
    )
    found = optical_depth([around, bank], np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]]), np.array([30.0]))
    np.testing.assert_allclose(found, 0.02 * 20 + 0.05 * 10, rtol=1e-9)


@pytest.mark.parametrize(
    "values, words",
    [
        (np.full((2, 2, 2), np.nan), r"nan at \(0, 0, 0\)"),
        (np.full((2, 2, 2), 1.5), "divide by the largest"),
        (np.ones((2, 2)), "three axes"),
        (np.full((1, 1, 1), "a"), "real numbers"),
    ],
)
def test_impossible_grids_are_refused(values, words):
    with pytest.raises(ParameterError, match=words):
        DensityGrid(values)


@pytest.mark.parametrize(
    "parts",
    [{"profile": "grid"}, {"grid": DensityGrid(np.ones((1, 1, 1)))}, {"angstrom": 9.0}, {"angstrom": float("nan")}],
)
def test_a_grid_belongs_to_its_profile(parts):
    with pytest.raises(ParameterError):
        FogMedium(0.1, **parts)

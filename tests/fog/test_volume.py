"""Containment of points and of boundaries."""

import numpy as np
import pytest
import trimesh

from synfog_usd.errors import ParameterError
from synfog_usd.fog import Boundary
from synfog_usd.fog.volume import crosses, is_inside
from synfog_usd.study.truths import box


def test_a_mesh_contains_what_its_box_contains():
    """The winding number of a tessellated box agrees with the box itself, whichever way its faces turn."""
    points = np.random.default_rng(0).uniform(-2, 2, (200, 3))
    solid = trimesh.creation.box(extents=(2, 2, 2))
    for faces in (solid.faces, solid.faces[:, ::-1]):
        mesh = Boundary("mesh", np.eye(4), solid.vertices, faces)
        np.testing.assert_array_equal(mesh.contains(points), box(1.0).contains(points))


def test_a_sphere_contains_points_within_its_radius():
    """An ellipsoid is a sphere under its matrix."""
    ball = Boundary("sphere", np.diag([3.0, 2.0, 1.0, 1.0]))
    assert ball.contains([[2.9, 0, 0], [0, 1.9, 0], [0, 0, 0.9]]).all()
    assert not ball.contains([[3.1, 0, 0], [0, 2.1, 0], [0, 0, 1.1], [2.5, 1.5, 0]]).any()


def test_nested_apart_and_crossing_boundaries_are_told_apart():
    """A bank within a layer is nested, two far boxes are apart, two that overlap cross."""
    outer, bank, far, across = box(10.0), box(1.0, (3, 0, 0)), box(1.0, (30, 0, 0)), box(4.0, (9, 0, 0))
    assert is_inside(bank, outer) and not crosses(bank, outer)
    assert not is_inside(far, outer) and not crosses(far, outer)
    assert crosses(across, outer) and not is_inside(across, outer)


def test_a_boundary_without_volume_is_refused():
    """A flat box or an open triangle holds no fog."""
    with pytest.raises(ParameterError):
        box((1.0, 1.0, 0.0))
    with pytest.raises(ParameterError):
        Boundary("mesh", np.eye(4), np.eye(3), np.array([[0, 1, 2]]))

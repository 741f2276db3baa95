"""Containment of points and of boundaries."""

import numpy as np
import pytest
import trimesh

from synfog_usd.fog import Boundary
from synfog_usd.scene.testing import box


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


def view(near, *, tan=0.5, turn=None):
    """Corners (5, 3) of what lies between a camera at the origin and its near plane, along -Z or turned."""
    points = near * np.array([(0, 0, 0), (-tan, -tan, -1), (tan, -tan, -1), (-tan, tan, -1), (tan, tan, -1.0)])
    return points if turn is None else points @ turn.T


@pytest.mark.parametrize("centre, radius, meets", [
    ((0, 0, -1.05), 1.0, True),  # touches the axis 5 cm ahead
    ((0, 0, -1.11), 1.0, False),
    ((0, 0, 0), 1.0, False),  # all of the view is inside
    ((0, 0, 0), 0.11, True),  # only the corners, at 0.1225 m, are outside
    ((0, 0, 0), 0.123, False),
    ((0, 0, -0.08), 0.001, True),  # wholly within the view
    ((1.0499, 0, -0.1), 1.0, True),  # reaches 0.1 mm over the right edge
    ((1.0501, 0, -0.1), 1.0, False),  # ends 0.1 mm before it
])  # fmt: skip
def test_a_ball_before_the_near_plane_is_found(centre, radius, meets):
    """The nearest and the farthest point of the view from the centre say it, in closed form."""
    matrix = np.diag([radius, radius, radius, 1.0])
    matrix[:3, 3] = centre
    assert Boundary("sphere", matrix).meets(view(0.1)) == meets


def clipped(polygon, planes):
    """Whether anything of a polygon is left behind all planes (Sutherland and Hodgman 1974)."""
    for normal, offset in planes:
        sides = polygon @ normal - offset
        kept = []
        for index in range(len(polygon)):
            a, b = sides[index - 1], sides[index]
            if (a <= 0) != (b <= 0):
                kept.append(polygon[index - 1] + (polygon[index] - polygon[index - 1]) * a / (a - b))
            if b <= 0:
                kept.append(polygon[index])
        if not kept:
            return False
        polygon = np.array(kept)
    return True


def planes_of(pyramid):
    eye, corners, centre = pyramid[0], pyramid[[1, 2, 4, 3]], pyramid.mean(axis=0)
    for a, b, c in [*[(eye, corners[k - 1], corners[k]) for k in range(4)], tuple(corners[:3])]:
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        yield (normal, normal @ a) if normal @ (centre - a) < 0 else (-normal, -normal @ a)


def test_boxes_and_meshes_meet_what_clipping_their_faces_leaves():
    """300 random boxes, 3 mm to 10 km, beside random views: the same answer as cutting each triangle with each
    plane.
    """
    draw = np.random.default_rng(3)
    solid = trimesh.creation.box(extents=(2, 2, 2))
    answers = []
    for _ in range(300):
        near = 10 ** draw.uniform(-2, 0)
        pyramid = view(
            near, tan=draw.uniform(0.1, 2), turn=trimesh.transformations.random_rotation_matrix(draw.random(3))[:3, :3]
        )
        matrix = trimesh.transformations.random_rotation_matrix(draw.random(3))
        matrix[:3, :3] *= near * 10 ** draw.uniform(-0.5, 4, 3)
        on_face = draw.uniform(-1, 1, 3)
        on_face[draw.integers(3)] = draw.choice([-1, 1])
        matrix[:3, 3] = pyramid.mean(axis=0) + near * draw.normal(size=3) - matrix[:3, :3] @ on_face
        vertices = solid.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        planes = list(planes_of(pyramid))
        answers.append(any(clipped(triangle, planes) for triangle in vertices[solid.faces]))
        assert Boundary("box", matrix).meets(pyramid) == answers[-1]
        assert Boundary("mesh", np.eye(4), vertices, solid.faces).meets(pyramid) == answers[-1]
    assert 50 < sum(answers) < 250

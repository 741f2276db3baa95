"""Instances that there is no room for are drawn with less: within half a pixel, and none vanishes."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from synfog_usd.render import detail, flatten
from synfog_usd.scene.testing import scene


def ball(subdivisions=5):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return {
        "type": "mesh",
        "positions": np.asarray(mesh.vertices),
        "faces": np.asarray(mesh.faces),
        "normals": np.asarray(mesh.vertex_normals),
        "bsdf": {"type": "ref", "id": "mat_a"},
    }


def cloud(count, faces=5):
    """Balls of radius 1 in a row that goes away from the camera, 20 m apart."""
    world = {"mat_a": {"type": "twosided", "bsdf": {"type": "diffuse"}}}
    world["group_0"] = {"type": "shapegroup", "shape_0": ball(faces)}
    for number in range(count):
        place = np.eye(4)
        place[:3, 3] = (0.0, 20.0 * (number + 1), 0.0)
        world[f"instance_{number}"] = {
            "type": "instance",
            "to_world": place,
            "shapegroup": {"type": "ref", "id": "group_0"},
        }
    made = scene(world)
    look = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)  # along +Y
    return replace(made, camera=replace(made.camera, to_world=look, width_px=1000, height_px=500, fov_x_deg=60.0))


@pytest.mark.parametrize("level", [-4, -3, -1])
def test_no_vertex_moves_beyond_its_cell(level):
    """And the area of a ball stays, to what a polyhedron of such cells can keep."""
    mesh = ball()
    made = detail.merged(mesh, level)
    assert len(made["faces"]) < len(mesh["faces"])
    moved, _ = cKDTree(mesh["positions"]).query(made["positions"])
    assert moved.max() <= 2.0**level * np.sqrt(3)
    area = trimesh.Trimesh(made["positions"], made["faces"]).area / (4 * np.pi)
    assert 1.0 - 2.0**level < area < 1.01
    outward = trimesh.Trimesh(made["positions"], made["faces"], process=False)
    assert (np.einsum("ij,ij->i", outward.face_normals, outward.triangles_center) > 0.0).mean() > 0.9


def test_a_level_is_half_a_pixel_at_its_distance():
    """A pixel at 100 m is 2 tan(30 degrees) 100 / 1000 m = 0.1155 m: half of it is the diagonal of a cell of 0.0333 m,
    and 2^-5 is the power below.
    """
    places = np.stack([np.eye(4)] * 3)
    places[:, 1, 3] = 101.0, 100.0 + 2.0 * 1.0, 1e9
    places[1, :3, :3] *= 2.0
    camera = cloud(1).camera
    found = detail.levels(camera, places, np.full(3, -1 / np.sqrt(3)), np.full(3, 1 / np.sqrt(3)))
    assert found.tolist() == [-5, -6, -2]  # twice as large: half the cell; very far: four cells across the box
    behind = places.copy()
    behind[:, 1, 3] *= -1.0
    assert detail.levels(camera, behind, np.full(3, -0.5), np.full(3, 0.5))[:2].tolist() == [-3, -4]


def test_what_has_room_stays_as_it_is(monkeypatch):
    """Byte by byte; where there is none, near balls keep all faces, and far ones some, and no instance is left."""
    source = cloud(30)
    whole, _, _ = flatten.flatten(source)
    (mesh,) = [part for key, part in whole.world.items() if key.startswith("shape_joined")]
    full = len(source.world["group_0"]["shape_0"]["faces"])
    assert len(mesh["faces"]) == 30 * full
    monkeypatch.setattr(flatten, "MAX_TRIANGLES", 15 * full)
    less, faces, _ = flatten.flatten(source)
    assert not any(key.startswith("instance_") for key in less.world)
    (key,) = [key for key in less.world if key.startswith("shape_joined")]
    triangles = less.world[key]["positions"][less.world[key]["faces"]]
    ball_of = np.rint(triangles[:, :, 1].mean(axis=1) / 20.0).astype(int)
    counts = np.bincount(ball_of)[1:]
    assert counts[0] == full and (np.diff(counts) <= 0).all() and 100 < counts[-1] < full / 4
    assert len(faces[key]) == len(triangles)


def test_a_mesh_of_few_faces_stays_at_any_distance():
    assert detail.merged(box := ball(0), 10) is box

"""Instances that there is no room for are drawn with less: within half a pixel, and none vanishes."""

from dataclasses import replace

import numpy as np
import trimesh

from synfog_usd.render import flatten
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

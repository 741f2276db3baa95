"""Small worlds with known answers, as `SceneDict`s."""

from __future__ import annotations

import numpy as np

from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.scene import Camera, SceneDict, Thing

LOOK_NORTH = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Camera at the origin looking along +Y with Z up."""


def box(half_size, centre=(0.0, 0.0, 0.0)):
    """A box boundary with half sizes [m] along x, y, z."""
    matrix = np.diag([*np.broadcast_to(half_size, 3).astype(float), 1.0])
    matrix[:3, 3] = centre
    return Boundary("box", matrix)


def black(radiance=None):
    """A surface that reflects nothing, and sends out `radiance` if it is given."""
    parts = {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}}
    if radiance is not None:
        parts["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": [float(radiance)] * 3}}
    return parts


def wall(distance_m, half_size_m=1000.0, **parts):
    """A square across the +Y axis, facing the origin."""
    s = half_size_m
    corners = np.array([[-s, distance_m, -s], [s, distance_m, -s], [s, distance_m, s], [-s, distance_m, s]])
    return {"type": "mesh", "positions": corners, "faces": np.array([[0, 1, 2], [0, 2, 3]]), **(parts or black())}


def scene(world, fog=(), *, width_px=16, height_px=9, fov_x_deg=10.0, to_world=LOOK_NORTH, **more):
    """A `SceneDict` around `world`; every shape is a thing of its own."""
    names = [key for key in world if key.startswith("shape_")]
    things = tuple(Thing(index + 1, "/" + name, "unlabeled") for index, name in enumerate(names))
    thing_of = {(name,): index + 1 for index, name in enumerate(names)}
    camera = Camera("/Camera", to_world, width_px, height_px, fov_x_deg)
    return SceneDict({"type": "scene", **world}, camera, tuple(fog), things, thing_of, **more)


def uniform_fog(half_size=200.0, *, visibility_m=150.0, albedo=1.0, g=0.87):
    """One big box of uniform fog around the camera."""
    return FogVolume("/Fog", box(half_size), FogMedium.from_visibility(visibility_m, albedo=albedo, g=g))

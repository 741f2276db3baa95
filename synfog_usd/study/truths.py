"""Small worlds with known answers, as `SceneDict`s: for the tests and for `synfog-usd selftest`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.scene import Camera, SceneDict, Thing

LOOK_NORTH = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Camera at the origin looking along +Y with Z up."""


def box(half_size: npt.ArrayLike, centre: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Boundary:
    """A box boundary with half sizes [m] along x, y, z."""
    matrix = np.diag([*np.broadcast_to(np.asarray(half_size, dtype=float), 3), 1.0])
    matrix[:3, 3] = centre
    return Boundary("box", matrix)


def black(radiance: float | None = None) -> dict[str, Any]:
    """A surface that reflects nothing, and sends out `radiance` if it is given."""
    parts: dict[str, Any] = {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}}
    if radiance is not None:
        parts["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": [float(radiance)] * 3}}
    return parts


def wall(distance_m: float, half_size_m: float = 1000.0, **parts: Any) -> dict[str, Any]:
    """A square across the +Y axis, facing the origin."""
    s = half_size_m
    corners = np.array([[-s, distance_m, -s], [s, distance_m, -s], [s, distance_m, s], [-s, distance_m, s]])
    return {"type": "mesh", "positions": corners, "faces": np.array([[0, 1, 2], [0, 2, 3]]), **(parts or black())}


def scene(
    world: Mapping[str, Any],
    fog: Iterable[FogVolume] = (),
    *,
    width_px: int = 16,
    height_px: int = 9,
    fov_x_deg: float = 10.0,
    to_world: npt.NDArray[np.float64] = LOOK_NORTH,
) -> SceneDict:
    """A `SceneDict` around `world`; every shape is a thing of its own."""
    names = [key for key in world if key.startswith("shape_")]
    things = tuple(Thing(index + 1, "/" + name, "unlabeled") for index, name in enumerate(names))
    thing_of = {(name,): index + 1 for index, name in enumerate(names)}
    camera = Camera("/Camera", to_world, width_px, height_px, fov_x_deg)
    return SceneDict({"type": "scene", **world}, camera, tuple(fog), things, thing_of)


def uniform_fog(half_size: float = 200.0, *, visibility_m: float = 150.0, albedo: float = 1.0, g: float = 0.87) -> FogVolume:
    """One big box of uniform fog around the camera."""
    return FogVolume("/Fog", box(half_size), FogMedium.from_visibility(visibility_m, albedo=albedo, g=g))

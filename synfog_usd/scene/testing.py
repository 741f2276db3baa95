"""Small worlds with known answers, for tests of ours and of yours.

`scene` makes a `SceneDict` of a few Mitsuba dictionaries; `black`, `wall`, `sky`, `box` and `uniform_fog` are what most
worlds are made of.  Truths are closed forms (`lamp_in_endless_fog`) or discrete ordinates (`empty_slab`), which share
no code with any renderer.  `synfog-usd selftest` runs the same worlds on a user's machine.  Knows nothing of Mitsuba.

>>> source = scene({"shape_wall": wall(50.0, **black(1.0))}, [uniform_fog(200.0, visibility_m=150.0)], fov_x_deg=0.1)
>>> import numpy as np
>>> round(float(np.exp(-50.0 * source.fog[0].medium.sigma_t_per_m)), 4)  # what any unbiased model sees, beside the airlight
0.3684
"""  # noqa: E501

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.fog.slab import solve
from synfog_usd.scene import Camera, Instance, SceneDict

LOOK_NORTH = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""Camera at the origin looking along +Y with Z up."""

HALF_WIDTH_M = 5000.0
"""Of an empty slab.  Light from its sides has crossed so much fog, exp(-25) of it in MOR 600, or comes in under 0.7
degrees.
"""


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
    """A `SceneDict` around `world`; every shape is an instance of its own."""
    names = [key for key in world if key.startswith("shape_")]
    instances = tuple(Instance(index + 1, "/" + name, "unlabeled") for index, name in enumerate(names))
    instance_of = {(name,): index + 1 for index, name in enumerate(names)}
    camera = Camera("/Camera", to_world, width_px, height_px, fov_x_deg)
    return SceneDict({"type": "scene", **world}, camera, tuple(fog), instances, instance_of)


def uniform_fog(
    half_size: float = 200.0, *, visibility_m: float = 150.0, albedo: float = 1.0, g: float = 0.87
) -> FogVolume:
    """One big box of uniform fog around the camera."""
    return FogVolume("/Fog", box(half_size), FogMedium.from_visibility(visibility_m, albedo=albedo, g=g))


def sky(radiance: float = 1.0) -> dict[str, Any]:
    """A sky of the same radiance everywhere, as a part of a scene's world."""
    return {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [float(radiance)] * 3}}}


def tilted(zenith_deg: float) -> npt.NDArray[np.float64]:
    """Camera at the origin whose axis leans from the zenith towards +Y by an angle [deg]; 90 is `LOOK_NORTH`."""
    z = np.radians(zenith_deg)
    matrix = np.eye(4)
    matrix[:3, 1], matrix[:3, 2] = (0.0, -np.cos(z), np.sin(z)), (0.0, -np.sin(z), -np.cos(z))
    return matrix


def pixel_rays(source: SceneDict, nodes: int = 6) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Directions (H, W, nodes^2, 3) through each pixel of a camera without shift, and the weights (nodes^2,) of their
    mean (Gauss and Legendre).
    """
    camera = source.camera
    width, height = camera.width_px, camera.height_px
    node, weight = np.polynomial.legendre.leggauss(nodes)
    edge = np.tan(np.radians(camera.fov_x_deg) / 2)
    x = (2 * (np.arange(width)[:, None] + (node + 1) / 2) / width - 1) * edge
    y = (1 - 2 * (np.arange(height)[:, None] + (node + 1) / 2) / height) * edge * height / width
    local = np.stack(np.broadcast_arrays(x[None, :, None, :], y[:, None, :, None], -1.0), axis=-1).reshape(
        height, width, -1, 3
    )
    return local @ camera.to_world[:3, :3].T / np.linalg.norm(local, axis=-1, keepdims=True), np.outer(
        weight, weight
    ).ravel() / 4


def lamp_in_endless_fog(
    medium: FogMedium, lamp_m: npt.ArrayLike, directions: npt.NDArray[np.float64], intensity: float = 1.0
) -> npt.NDArray[np.float64]:
    """Light of a point lamp that endless fog scattered once, seen from the origin.

    h is the distance of the ray from the lamp, and t = D cos(theta) + h tan(eta) a place along it.  So
    dt / r^2 = d(eta) / h.
    L = albedo sigma I / (4 pi h) * integral of exp(-sigma (t + h / cos(eta))) over eta from theta - pi/2 to pi/2.

    Args:
        medium: uniform, and scattering light to every side alike (g = 0).
        lamp_m: (3,) [m].
        directions: (..., 3) unit vectors that do not meet the lamp.
        intensity: of the lamp, W/sr or whatever `radiance` is to be in, times m^2.
    """
    lamp, sigma = np.asarray(lamp_m, dtype=np.float64), medium.sigma_t_per_m
    along = directions @ lamp
    h = np.linalg.norm(np.cross(directions, lamp), axis=-1)
    low = -np.arctan2(along, h)
    node, weight = np.polynomial.legendre.leggauss(96)
    half = (np.pi / 2 - low) / 2
    eta = low[..., None] + half[..., None] * (node + 1)
    tau = sigma * (along[..., None] + h[..., None] * (np.tan(eta) + 1 / np.cos(eta)))
    return medium.albedo * sigma * intensity / (4 * np.pi * h) * half * (np.exp(-tau) @ weight)


@dataclass(frozen=True)
class EmptySlab:
    """A slab of fog over Lambertian ground under a sky of radiance 1, seen from within.

    Attributes:
        scene: what is rendered.
        truth: (H, W) the plane-parallel solution, averaged over each pixel.
    """

    scene: SceneDict
    truth: npt.NDArray[np.float64]


def empty_slab(
    medium: FogMedium,
    ground: float,
    *,
    top_m: float = 60.0,
    eye_m: float = 1.5,
    sunk_m: float = 1.0,
    zenith_deg: tuple[float, float] = (0.0, 87.0),
    width_px: int = 4,
    height_px: int = 64,
) -> EmptySlab:
    """An empty slab and the strip of it between two zenith angles.

    Args:
        medium: the fog.
        ground: albedo of the ground, 0 to 1.
        top_m: height of the slab above the ground [m]; eye_m: that of the camera.
        sunk_m: how far the fog's box reaches below the ground; 0 puts its floor on the ground.
        zenith_deg: of the strip's ends [degrees].
        width_px, height_px: of the picture.
    """
    low, high = zenith_deg
    bottom, top = -eye_m, top_m - eye_m
    s = HALF_WIDTH_M
    floor = np.array([[-s, -s, bottom], [s, -s, bottom], [s, s, bottom], [-s, s, bottom]])
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [ground] * 3}}
    world = {
        **sky(),
        "shape_ground": {"type": "mesh", "positions": floor, "faces": np.array([[0, 1, 2], [0, 2, 3]]), "bsdf": grey},
    }
    fog = FogVolume("/Fog", box((s, s, (top_m + sunk_m) / 2), (0, 0, (top + bottom - sunk_m) / 2)), medium)
    matrix = tilted((low + high) / 2)
    edge = np.tan(np.radians(high - low) / 2)
    fov_x_deg = float(np.degrees(2 * np.arctan(edge * width_px / height_px)))
    world_scene = scene(world, [fog], width_px=width_px, height_px=height_px, fov_x_deg=fov_x_deg, to_world=matrix)
    directions, weights = pixel_rays(world_scene)
    up = directions[..., 2]
    slab = solve(medium, bottom_m=bottom, top_m=top, ground=ground)
    radiance = slab.radiance(np.zeros(up.size), up.ravel()).reshape(up.shape)
    return EmptySlab(world_scene, radiance @ weights)

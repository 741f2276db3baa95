"""How much of each instance's light the fog lets through to the eye.

Takes a scene; gives a transmittance for each label id.  Renders nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array, extent
from synfog_usd.fog.volume import FogVolume, optical_depth
from synfog_usd.scene import SceneDict, boxes, placements, shapes_of


@dataclass(frozen=True)
class PartBoxes:
    """Boxes of all meshes and instances of a world.

    Attributes:
        keys: of `SceneDict.world`, N of them.
        low, high: (N, 3) corners [m].
    """

    keys: list[str]
    low: Array
    high: Array


def of_instances(
    scene: SceneDict, parts: PartBoxes | None = None, depth: Callable[..., Array] = optical_depth
) -> dict[int, float]:
    """Label id -> the fog's transmittance between the eye and an instance, the largest over the boxes of its parts [1].

    Args:
        scene: what `translate` made.
        parts: of the scene's world where they are known, see `boxes_of`: they are the same in every fog.
        depth: another `fog.volume.optical_depth`, which may be faster.

    Returns:
        Nothing where it is not known: the fog has no closed form, or the camera is orthographic and its rays do not
        part at one point.
    """
    if any(volume.boundary.kind == "mesh" for volume in scene.fog) or (scene.fog and scene.camera.width_m > 0.0):
        return {}
    parts = parts or boxes_of(scene.world)
    clear = dict.fromkeys(parts.keys, 1.0)
    if scene.fog and parts.keys:
        through = _to_boxes(depth, scene.fog, scene.camera.to_world[:3, 3], parts.low, parts.high)
        clear = dict(zip(parts.keys, through.tolist(), strict=True))
    result: dict[int, float] = {}
    for names, instance in scene.instance_of.items():
        result[instance] = max(result.get(instance, 0.0), clear.get(names[0], 1.0))
    return result


def boxes_of(world: Mapping[str, Any]) -> PartBoxes:
    """The boxes of a world's meshes and instances; it looks at every point of them."""
    standing = placements(world)
    keys = [
        key
        for key, part in world.items()
        if key.startswith("instance_") or (key.startswith("shape_") and part.get("type") == "mesh")
    ]
    placed = np.array([key.startswith("instance_") for key in keys], dtype=bool)
    low, high = np.zeros((2, len(keys), 3))
    for row in np.flatnonzero(~placed):
        low[row], high[row] = _box([world[keys[row]]])
    of_instances = np.flatnonzero(placed)
    for group, rows in standing.rows.items():
        places = of_instances[rows]
        low[places], high[places] = boxes(*_box(list(shapes_of(world, group).values())), standing.to_world[rows])
    return PartBoxes(keys, low, high)


def _box(shapes: list[Mapping[str, Any]]) -> tuple[Array, Array]:
    """Corners [m] of the box about all meshes of a list."""
    meshes = [np.asarray(shape["positions"], dtype=np.float64) for shape in shapes if shape.get("type") == "mesh"]
    return extent(*([points for points in meshes if len(points)] or [np.zeros((1, 3))]))


def _to_boxes(depth: Callable[..., Array], fog: tuple[FogVolume, ...], eye: Array, low: Array, high: Array) -> Array:
    """Largest transmittance from the eye to a box: at its nearest point, or at one of 27 all over it, where the fog may
    be thinner.
    """
    grid = np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * 3), axis=-1).reshape(-1, 3)
    places = np.concatenate([low[:, None] + grid * (high - low)[:, None], np.clip(eye, low, high)[:, None]], axis=1)
    offsets = (places - eye).reshape(-1, 3)
    tau = depth(fog, np.broadcast_to(eye, offsets.shape), *_rays(offsets)) * _clearest(fog)
    return np.asarray(np.exp(-tau.reshape(len(low), -1).min(axis=1)))


def _rays(offsets: Array) -> tuple[Array, Array]:
    """Directions and lengths of (N, 3) offsets [m]; up for one that is zero."""
    length = np.linalg.norm(offsets, axis=1)
    return np.where(
        length[:, None] > 0.0, offsets / np.where(length > 0.0, length, 1.0)[:, None], [0.0, 0.0, 1.0]
    ), length


def _clearest(fog: tuple[FogVolume, ...]) -> float:
    """Extinction in the clearest colour over that at 550 nm."""
    ratios = [
        np.min(volume.medium.extinction_at(np.linspace(390.0, 710.0, 9)))
        for volume in fog
        if volume.medium.sigma_t_per_m
    ]
    return float(min([1.0, *ratios]))

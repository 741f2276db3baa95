"""Why a picture would be black: found in the scene, before or after it was rendered.

Takes a `SceneDict`; gives a sentence.  Renders nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array, extent
from synfog_usd.scene import SceneDict, placements, shapes_of
from synfog_usd.translate.geometry import cross

_ALL_AROUND = ("constant", "envmap")
_SEEN_THROUGH = ("mask", "thindielectric", "dielectric", "roughdielectric", "blendbsdf", "null")
_CUBE = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(-1, 3)


def why_black(scene: SceneDict) -> str | None:
    """What keeps all light from the camera: no light at all, a solid around it, a near plane beyond everything, or
    nothing before it.

    Returns:
        one sentence with the fix; None where none of these is so, as in nearly every scene.
    """
    lights = [
        part
        for part in scene.world.values()
        if isinstance(part, dict)
        and (part["type"] in (*_ALL_AROUND, "directional") or "emitter" in part or _is_lamp(part))
    ]
    if not lights:
        return "the picture is black: the stage has no light that shines; add a DomeLight, or a lamp"
    eye = scene.camera.to_world[:3, 3]
    for shape, names, matrices, corners in _boxes(scene.world):
        inside = ((corners.min(axis=1) < eye) & (eye < corners.max(axis=1))).all(axis=1)
        for number in np.flatnonzero(inside) if _opaque(scene.world, shape) else ():
            matrix, name = matrices[number], names[number]
            if _surrounds(shape, matrix, eye) and not any(
                _surrounds(shape, matrix, place) for place in _places(lights)
            ):
                who = scene.instances[scene.instance_of[name] - 1].path if name in scene.instance_of else name[-1]
                return (
                    f"the picture is black: the camera stands inside of {who}, a closed solid without a light in it; "
                    f"move the camera"
                )
    if any(part["type"] in _ALL_AROUND for part in lights):
        return None  # the sky itself is seen
    ahead = [float(((corners - eye) @ -scene.camera.to_world[:3, 2]).max()) for *_, corners in _boxes(scene.world)]
    if not ahead or max(ahead) <= 0.0:
        return (
            "the picture is black: everything lies behind the camera, and there is no sky; turn the camera, which "
            "looks along its -Z"
        )
    if max(ahead) <= scene.camera.near_m:
        return (
            f"the picture is black: the camera's near clipping of {scene.camera.near_m:g} m lies beyond everything "
            f"before it, "
            f"which ends at {max(ahead):.3g} m, and there is no sky; lower clippingRange"
        )
    return None


def _is_lamp(part: Mapping[str, Any]) -> bool:
    return part["type"] in ("point", "spot", "photometric")


def _boxes(world: Mapping[str, Any]) -> Iterator[tuple[Mapping[str, Any], list[tuple[str, ...]], Array, Array]]:
    """Every shape, its names in all places where it stands, the matrices (n, 4, 4) that put it there, and the corners
    (n, 8, 3) of the box around it in each.
    """
    for key, part in world.items():
        if key.startswith("shape_"):
            yield part, [(key,)], np.eye(4)[None], _corners(part)[None]
    standing = placements(world)
    for group, rows in standing.rows.items():
        keys, matrices = [standing.keys[row] for row in rows], standing.to_world[rows]
        for name, shape in shapes_of(world, group).items():
            turned = np.einsum("nij,kj->nki", matrices[:, :3, :3], _corners(shape))
            yield shape, [(key, name) for key in keys], matrices, turned + matrices[:, None, :3, 3]


def _opaque(world: Mapping[str, Any], shape: Mapping[str, Any]) -> bool:
    bsdf = world.get(shape["bsdf"].get("id", ""), shape["bsdf"])
    return bsdf["type"] not in _SEEN_THROUGH and not bsdf.get("spec_trans")


def _places(lights: list[Any]) -> Iterator[Array]:
    """Where lamps stand; sun and sky are nowhere."""
    for part in lights:
        if "position" in part:
            yield np.asarray(part["position"], dtype=np.float64)
        elif "emitter" in part:
            yield _corners(part).mean(axis=0)
        elif _is_lamp(part):
            yield np.asarray(part["to_world"])[:3, 3]


def _corners(shape: Mapping[str, Any]) -> Array:
    """(8, 3) corners of a box around a shape, before it is put in a place."""
    kind = shape["type"]
    if "positions" in shape:
        low, high = (corner.astype(np.float64) for corner in extent(shape["positions"]))
    elif kind == "sphere":
        low, high = np.asarray(shape["center"]) - shape["radius"], np.asarray(shape["center"]) + shape["radius"]
    elif kind == "cylinder":
        ends = np.array([shape["p0"], shape["p1"]], dtype=np.float64)
        low, high = ends.min(axis=0) - shape["radius"], ends.max(axis=0) + shape["radius"]
    elif "control_points" in shape:
        points = np.asarray(shape["control_points"], dtype=np.float64)[:, :3]
        low, high = extent(points)
    else:
        low, high = np.full(3, -1.0), np.full(3, 1.0)
    corners = np.where(_CUBE < 0.0, low, high)
    matrix = np.asarray(shape.get("to_world", np.eye(4)))
    return np.asarray(corners @ matrix[:3, :3].T + matrix[:3, 3])


def _surrounds(shape: Mapping[str, Any], matrix: Array, point: Array) -> bool:
    """Whether a closed shape goes around a point: by the solid angle that its triangles fill.

    Source: Van Oosterom and Strackee (1983).
    """
    kind = shape["type"]
    if kind not in ("mesh", "sphere", "cube"):
        return False
    corners = _corners(shape) @ matrix[:3, :3].T + matrix[:3, 3]
    if not ((corners.min(axis=0) < point).all() and (point < corners.max(axis=0)).all()):
        return False
    whole = matrix @ shape["to_world"] if "to_world" in shape else matrix
    local = np.linalg.solve(whole, [*point, 1.0])[:3]
    if kind == "sphere":
        return bool(np.linalg.norm(local - np.asarray(shape.get("center", (0.0, 0.0, 0.0)))) < shape.get("radius", 1.0))
    if kind == "cube":
        return bool((np.abs(local) < 1.0).all())
    a, b, c = (shape["positions"][shape["faces"][:, k]] - local for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    top = np.einsum("ij,ij->i", a, cross(b, c))
    bottom = (
        la * lb * lc
        + np.einsum("ij,ij->i", a, b) * lc
        + np.einsum("ij,ij->i", b, c) * la
        + np.einsum("ij,ij->i", c, a) * lb
    )
    turns = float(np.arctan2(top, bottom).sum()) / (2.0 * np.pi)
    return abs(turns) > 0.99

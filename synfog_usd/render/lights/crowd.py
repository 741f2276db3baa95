"""Lit surfaces by the thousand: those that are alike and stand beside each other, as one mesh.

Each surface that shines by itself costs every kernel 2 to 11 ms and 0.1 MB, since Dr.Jit traces each alone; a lit mesh
costs nothing of the kind but by the triangle.  Where there are more than `MANY_LIT`, the `NEAREST` to the camera stay
as they are.  The others are triangles of the same area, so that their flux stays, joined by kind and place: blocks of
neighbours, so that the choice of a light by its place still knows where they are.

Takes a `SceneDict`; gives meshes and which of them belong together.  `flatten` joins them.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.scene import MANY_LIT, SceneDict, lit_kind

NEAREST = 96
"""Of more, those that stay as they are."""

BLOCKS = 56
"""Meshes that the others become, and one for each further kind."""

ROUND = 24
"""Corners of a disk; a ball has 80 faces."""

SPARE = ("type", "bsdf", "emitter", "center", "radius", "to_world")
"""What a ball, disk or rectangle may have that is drawn as a mesh."""


def crowded(source: SceneDict) -> dict[str, tuple[Mapping[str, Any], int]]:
    """Key of each lit shape that is joined with others -> its mesh and the number of its block; none where there are
    few, or where a shape is of a kind that cannot be joined.
    """
    kinds = {key: kind for key in source.world if (kind := lit_kind(source, key)) is not None and _known(source, key)}
    if len(kinds) <= MANY_LIT:
        return {}
    keys = list(kinds)
    place = np.array([_middle(source.world[key]) for key in keys])
    far = np.sort(np.argsort(source.away_m(place), kind="stable")[NEAREST:])
    by_kind: dict[tuple[Any, ...], list[int]] = {}
    for number in far:
        by_kind.setdefault(kinds[keys[number]], []).append(int(number))
    crowd, block = {}, 0
    for members in by_kind.values():
        for numbers in _blocks(np.array(members), place, max(1, BLOCKS * len(members) // len(far))):
            for number in numbers:
                crowd[keys[number]] = _as_mesh(source.world[keys[number]]), block
            block += 1
    return crowd


def _known(source: SceneDict, key: str) -> bool:
    """Whether a lit shape stands still and is of a form that is known here."""
    part = source.world[key]
    plain = part["type"] == "mesh" or (part["type"] in ("sphere", "disk", "rectangle") and not set(part) - set(SPARE))
    return plain and key not in source.motion_of and part.get("bsdf", {}).get("type") == "ref"


def _middle(part: Mapping[str, Any]) -> Array:
    if part["type"] == "mesh":
        return np.asarray(part["positions"], dtype=np.float64).mean(axis=0)
    if "center" in part:
        return np.asarray(part["center"], dtype=np.float64)
    return np.asarray(part["to_world"], dtype=np.float64)[:3, 3]


def _blocks(numbers: Indices, place: Array, count: int) -> list[Indices]:
    """`count` parts of almost the same size, of neighbours: cut across the longer side again and again."""
    if count <= 1 or len(numbers) <= 1:
        return [numbers]
    here = place[numbers]
    ordered = numbers[np.argsort(here[:, np.ptp(here, axis=0).argmax()], kind="stable")]
    cut = len(numbers) * (count // 2) // count
    return [*_blocks(ordered[:cut], place, count // 2), *_blocks(ordered[cut:], place, count - count // 2)]


def _as_mesh(part: Mapping[str, Any]) -> Mapping[str, Any]:
    """The same surface in triangles, of the same area."""
    if part["type"] == "mesh":
        return part
    points, faces = {"sphere": _ball, "disk": _disk, "rectangle": _rectangle}[part["type"]]()
    matrix = np.asarray(part.get("to_world", np.eye(4)), dtype=np.float64)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        faces = faces[:, ::-1]
    local = points * part.get("radius", 1.0) + np.asarray(part.get("center", np.zeros(3)), dtype=np.float64)
    return {
        "type": "mesh",
        "positions": (local @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32),
        "faces": faces,
        "bsdf": part["bsdf"],
        "emitter": part["emitter"],
    }


@functools.cache
def _ball() -> tuple[Array, Indices]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    return np.asarray(ball.vertices) * np.sqrt(4.0 * np.pi / ball.area), np.asarray(ball.faces)


@functools.cache
def _disk() -> tuple[Array, Indices]:
    angle = 2.0 * np.pi * np.arange(ROUND) / ROUND
    radius = np.sqrt(np.pi / (0.5 * ROUND * np.sin(2.0 * np.pi / ROUND)))
    points = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1) * radius
    corner = np.arange(1, ROUND - 1)
    return points, np.stack([0 * corner, corner, corner + 1], axis=1)


@functools.cache
def _rectangle() -> tuple[Array, Indices]:
    points = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return points, np.array([[0, 1, 2], [0, 2, 3]])

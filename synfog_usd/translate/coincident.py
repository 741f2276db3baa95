"""Faces of different materials that lie in one another, so that a renderer's rounding decides which is seen.

Takes a translated scene; gives pairs of prims that have such faces.  Knows nothing of what stands before
them: faces that nobody can see count, too.  Faces back to back, as of a box that stands on the ground, do not.  Small
faces 100 m from the origin are missed: their planes are known too badly.  Where things stand in more places than
`MOST_PLACED` they are not looked at.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.arrays import Array
from synfog_usd.scene import SceneDict, prototype_of, shapes_of

APART_M = 5e-5
"""Faces nearer than this are one for a ray in single precision 100 m away."""

LEAST_M = 2e-3
"""Overlap narrower than this in any direction is an edge that two parts share."""

SLANT = 64.0
"""Steps of a normal's components that tell planes apart."""

STEP_M = 2e-3
"""Of a plane's distance."""


MOST_PLACED = 100_000
"""Instances of a scene up to which their faces count; 750 000 cubes took 17 s and 4 GB."""


@dataclass(frozen=True)
class Overlap:
    """Two prims that share faces.

    Attributes:
        one, other: prim paths.
        faces: pairs of triangles.
        place: (x, y, z) in the stage's metres, of one of them.
    """

    one: str
    other: str
    faces: int
    place: tuple[float, float, float]


def coincident(scene: SceneDict) -> list[Overlap]:
    """Pairs of prims with faces of different materials in one another, those with most faces first."""
    corners, material, thing = _triangles(scene)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    solid = length > LEAST_M**2
    corners, material, thing = corners[solid], material[solid], thing[solid]
    normal = cross[solid] / length[solid, None]
    found: dict[tuple[int, int], dict[tuple[int, int], Array]] = {}
    for members in _planes(normal, corners, material):
        axis = normal[members[0]]
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        frame = np.stack([side, np.cross(axis, side)], axis=1)
        for one, other in _pairs(corners[members] @ frame, (corners[members] @ axis), material[members]):
            a, b = sorted((members[one], members[other]))
            key = (min(thing[a], thing[b]), max(thing[a], thing[b]))
            found.setdefault(key, {})[a, b] = corners[a].mean(axis=0)
    names = {0: "", **{instance.id: instance.path for instance in scene.instances}}
    origin = np.array(scene.origin_m)
    told = [
        Overlap(names[one], names[other], len(pairs), tuple(float(x) for x in next(iter(pairs.values())) + origin))
        for (one, other), pairs in found.items()
    ]
    return sorted(told, key=lambda overlap: (-overlap.faces, overlap.one, overlap.other))


def _triangles(scene: SceneDict) -> tuple[Array, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """(corners (N, 3, 3) of all faces in place, number of their materials, label ids of their instances)."""
    corners: list[Array] = [np.zeros((0, 3, 3))]
    materials: dict[str, int] = {}
    material: list[npt.NDArray[np.int64]] = []
    thing: list[npt.NDArray[np.int64]] = []

    def take(mesh: Mapping[str, Any], matrix: Array | None, label: int) -> None:
        if mesh.get("type") != "mesh":
            return
        points = np.asarray(mesh["positions"], dtype=np.float64)
        faces = np.asarray(mesh["faces"], dtype=np.int64)
        if matrix is not None:
            points = points @ matrix[:3, :3].T + matrix[:3, 3]
            faces = faces[:, ::-1] if np.linalg.det(matrix[:3, :3]) < 0.0 else faces
        corners.append(points[faces])
        name = str(mesh["bsdf"].get("id", "")) if mesh["bsdf"].get("type") == "ref" else f"own {len(corners)}"
        material.append(np.full(len(faces), materials.setdefault(name, len(materials))))
        thing.append(np.full(len(faces), label))

    many = sum(key.startswith("instance_") for key in scene.world) > MOST_PLACED
    for key, value in scene.world.items():
        if key.startswith("shape_"):
            take(value, None, scene.instance_of.get((key,), 0))
        elif key.startswith("instance_") and not many:
            matrix = np.asarray(value["to_world"], dtype=np.float64)
            for name, shape in shapes_of(scene.world, prototype_of(value)).items():
                take(shape, matrix, scene.instance_of.get((key, name), 0))
    none = [np.zeros(0, dtype=np.int64)]
    return np.concatenate(corners), np.concatenate(material or none), np.concatenate(thing or none)


def _planes(normal: Array, corners: Array, material: npt.NDArray[np.int64]) -> Iterator[npt.NDArray[np.int64]]:
    """Triangles in about the same plane, where there is more than one material; some come twice."""
    away = (normal * corners.mean(axis=1)).sum(axis=1)
    # the 0.377 keeps what is upright or level off the border between two steps
    slant = np.floor(normal * SLANT + 0.377).astype(np.int64) + int(SLANT) + 2
    for shift in (0.0, 0.5):
        key = np.floor(away / STEP_M + shift + 0.123).astype(np.int64)
        for axis in range(3):
            key = key * 256 + slant[:, axis]
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.r_[True, np.diff(key[order]) != 0, True])
        kind = material[order]
        for begin, end in itertools.pairwise(starts):
            if end - begin > 1 and (kind[begin:end] != kind[begin]).any():
                yield order[begin:end]


def _pairs(flat: Array, away: Array, material: npt.NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Pairs of triangles (n, 3, 2) of one plane's axes that overlap, are nearer than `APART_M` (their corners' `away`
    (n, 3)) and differ in material.
    """
    low, high = flat.min(axis=1) + LEAST_M, flat.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    for rank, one in enumerate(order):
        rest = order[rank + 1 : np.searchsorted(low[order, 0], high[one, 0])]
        rest = rest[(material[rest] != material[one]) & (low[rest, 1] < high[one, 1]) & (low[one, 1] < high[rest, 1])]
        rest = rest[
            (away[rest].min(axis=1) < away[one].max() + APART_M) & (away[one].min() < away[rest].max(axis=1) + APART_M)
        ]
        for other in rest:
            if _overlap(flat[one], flat[other]):
                yield int(one), int(other)


def _overlap(one: Array, other: Array) -> bool:
    """Whether two triangles (3, 2) overlap by more than `LEAST_M` along every edge's normal (theorem of the separating
    axis).
    """
    edges = np.concatenate([one - np.roll(one, 1, axis=0), other - np.roll(other, 1, axis=0)])
    across = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    a, b = across @ one.T, across @ other.T
    return bool((np.minimum(a.max(axis=1), b.max(axis=1)) - np.maximum(a.min(axis=1), b.min(axis=1)) > LEAST_M).all())

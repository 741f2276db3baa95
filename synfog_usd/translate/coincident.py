"""Faces of different materials that lie in one another, so that a renderer's rounding decides which is seen.

Takes a translated scene; gives pairs of prims that have such faces.  Knows nothing of what stands before
them: faces that nobody can see count, too.  Faces back to back, as of a box that stands on the ground, do not.  Small
faces 100 m from the origin are missed: their planes are known too badly.  Where things stand in more places than
`MOST_PLACED` they are not looked at.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.scene import SceneDict, placements, shapes_of
from synfog_usd.translate.geometry import cross, determinant

APART_M = 5e-5
"""Faces nearer than this are one for a ray in single precision 100 m away."""

LEAST_M, LEAST_RAD = 2e-3, 1e-3
"""Overlap narrower than this in any direction, or under a smaller angle from the camera, is an edge that two parts
share, and below a pixel.
"""

SLANT = 64.0
"""Steps of a normal's components that tell planes apart."""

STEP_M = 2e-3
"""Of a plane's distance."""


AT_ONCE = 1 << 20
"""Pairs that are looked at together."""

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
    eye = scene.camera.to_world[:3, 3]
    corners, material, thing = _triangles(scene, eye)
    normal, width = _normals(corners)
    wide = width > np.maximum(LEAST_M, LEAST_RAD * np.linalg.norm(corners.mean(axis=1) - eye, axis=1))
    corners, material, thing, normal = corners[wide], material[wide], thing[wide], normal[wide]
    found: dict[tuple[int, int], dict[tuple[int, int], Array]] = {}
    for one, other in _pairs(normal, corners, material, eye):
        for a, b in zip(np.minimum(one, other).tolist(), np.maximum(one, other).tolist(), strict=True):
            key = (min(thing[a], thing[b]), max(thing[a], thing[b]))
            found.setdefault(key, {})[a, b] = corners[a].mean(axis=0)
    names = {0: "", **{instance.id: instance.path for instance in scene.instances}}
    origin = np.array(scene.origin_m)
    told = [
        Overlap(names[one], names[other], len(pairs), tuple(float(x) for x in next(iter(pairs.values())) + origin))
        for (one, other), pairs in found.items()
    ]
    return sorted(told, key=lambda overlap: (-overlap.faces, overlap.one, overlap.other))


def _normals(corners: Array) -> tuple[Array, Array]:
    """(N, 3) unit normals of triangles (N, 3, 3), and (N,) how wide each is where it is narrowest."""
    edges = np.roll(corners, -1, axis=1) - corners
    crossed = cross(edges[:, 0], edges[:, 1])
    length = np.linalg.norm(crossed, axis=1)
    longest = np.sqrt((edges**2).sum(axis=2).max(axis=1, initial=0.0))
    return crossed / np.maximum(length, 1e-300)[:, None], length / np.maximum(longest, 1e-300)


@dataclass(frozen=True)
class _Prototype:
    """A mesh as it is modelled: its triangles (N, 3, 3), the widest's width, and the ball around them."""

    corners: Array
    widest: float
    centre: Array
    radius: float


def _prototype(mesh: Mapping[str, Any]) -> _Prototype:
    points = np.asarray(mesh["positions"], dtype=np.float64)
    corners = points[np.asarray(mesh["faces"], dtype=np.int64)]
    if not len(corners):
        return _Prototype(corners, 0.0, np.zeros(3), 0.0)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    return _Prototype(corners, float(_normals(corners)[1].max()), centre, radius)


def _triangles(scene: SceneDict, eye: Array) -> tuple[Array, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """(corners (N, 3, 3) of faces in place, number of their materials, label ids of their instances); without meshes
    all faces of which are too narrow where they stand.
    """
    corners: list[Array] = [np.zeros((0, 3, 3))]
    materials: dict[str, int] = {}
    material: list[npt.NDArray[np.int64]] = []
    thing: list[npt.NDArray[np.int64]] = []

    def take(mesh: Mapping[str, Any], matrices: Array, labels: list[int]) -> None:
        if mesh.get("type") != "mesh":
            return
        made, linear = _prototype(mesh), matrices[:, :3, :3]
        scale = np.linalg.norm(linear, axis=1).max(axis=1)
        near = np.linalg.norm(linear @ made.centre + matrices[:, :3, 3] - eye, axis=1) - scale * made.radius
        name = str(mesh["bsdf"].get("id", "")) if mesh["bsdf"].get("type") == "ref" else f"own {len(corners)}"
        number = materials.setdefault(name, len(materials))
        for place in np.flatnonzero(scale * made.widest > np.maximum(LEAST_M, LEAST_RAD * near)):
            found = made.corners @ linear[place].T + matrices[place, :3, 3]
            corners.append(found[:, ::-1] if determinant(matrices[place]) < 0.0 else found)
            material.append(np.full(len(found), number))
            thing.append(np.full(len(found), labels[place]))

    for key, value in scene.world.items():
        if key.startswith("shape_"):
            take(value, np.eye(4)[None], [scene.instance_of.get((key,), 0)])
    standing = placements(scene.world)
    for group, rows in standing.rows.items() if len(standing.keys) <= MOST_PLACED else ():
        for name, shape in shapes_of(scene.world, group).items():
            labels = [scene.instance_of.get((standing.keys[row], name), 0) for row in rows]
            take(shape, standing.to_world[rows], labels)
    none = [np.zeros(0, dtype=np.int64)]
    return np.concatenate(corners), np.concatenate(material or none), np.concatenate(thing or none)


def _pairs(
    normal: Array, corners: Array, material: npt.NDArray[np.int64], eye: Array
) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]]:
    """Numbers of triangles, of the one and of the other, that lie in one another and differ in material; some pairs
    come twice.
    """
    for members, plane in _planes(normal, corners, material):
        first = members[np.r_[True, np.diff(plane) != 0]]  # of each plane: its axes are all the plane's
        axis = normal[first]
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        number = np.cumsum(np.r_[0, np.diff(plane) != 0])
        frame = np.stack([side, np.cross(axis, side), axis], axis=2)[number]
        local = corners[members] @ frame
        flat, away = local[..., :2], local[..., 2]
        low, high = flat.min(axis=1) + LEAST_M, flat.max(axis=1)
        nearest, farthest, kind = away.min(axis=1), away.max(axis=1) + APART_M, material[members]
        for one, other in _beside(low[:, 0], high[:, 0], number):
            near = (
                (kind[one] != kind[other])
                & (low[other, 1] < high[one, 1])
                & (low[one, 1] < high[other, 1])
                & (nearest[other] < farthest[one])
                & (nearest[one] < farthest[other])
            )
            one, other = one[near], other[near]
            wide = _overlap(flat[one], flat[other])
            one, other, wide = one[wide > LEAST_M], other[wide > LEAST_M], wide[wide > LEAST_M]
            shared, there = _shared(flat[one], flat[other])
            gap = np.abs(_height(flat[one], away[one], shared) - _height(flat[other], away[other], shared))
            far = np.linalg.norm(corners[members[one]].mean(axis=1) - eye, axis=1)
            hit = (np.where(there, gap, 0.0).max(axis=1) < APART_M) & (wide > LEAST_RAD * far)
            yield members[one[hit]], members[other[hit]]


def _planes(
    normal: Array, corners: Array, material: npt.NDArray[np.int64]
) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]]:
    """Triangles in about the same plane as one of another material, and a number of that plane for each, rising; twice,
    with other borders between planes.
    """
    away = (normal * corners.mean(axis=1)).sum(axis=1)
    # the 0.377 keeps what is upright or level off the border between two steps
    slant = np.floor(normal * SLANT + 0.377).astype(np.int64) + int(SLANT) + 2
    facing = (slant[:, 0] * 256 + slant[:, 1]) * 256 + slant[:, 2]
    kinds = int(material.max(initial=0)) + 1
    for shift in (0.0, 0.5):
        key = np.floor(away / STEP_M + shift + 0.123).astype(np.int64) * 256**3 + facing
        both = np.sort(key * kinds + material)
        mixed = np.unique((both // kinds)[1:][(np.diff(both) > 0) & (np.diff(both // kinds) == 0)])
        if not len(mixed):
            continue
        plane = np.minimum(np.searchsorted(mixed, key), len(mixed) - 1)
        (chosen,) = np.nonzero(mixed[plane] == key)
        order = chosen[np.argsort(plane[chosen], kind="stable")]
        yield order, plane[order]


def _beside(
    low: Array, high: Array, plane: npt.NDArray[np.int64]
) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]]:
    """All pairs within a plane whose ranges from `low` to `high` overlap, at most `AT_ONCE` or one with all of its own
    at a time.
    """
    shift = plane * (float(high.max() - low.min()) + 1.0)  # so that one row sorts the ranges of all planes
    order = np.argsort(low + shift, kind="stable")
    begin = (low + shift)[order]
    ends = np.maximum(np.searchsorted(begin, (high + shift)[order]), np.arange(len(order)) + 1)
    counts = ends - np.arange(len(order)) - 1
    total = np.cumsum(counts)
    start = 0
    while start < len(order):
        stop = max(int(np.searchsorted(total, (total[start - 1] if start else 0) + AT_ONCE)), start + 1)
        some = counts[start:stop]
        one = np.repeat(np.arange(start, stop), some)
        other = np.arange(len(one)) - np.repeat(np.cumsum(some) - some, some) + one + 1
        yield order[one], order[other]
        start = stop


def _overlap(one: Array, other: Array) -> Array:
    """(n,) how far triangles (n, 3, 2) overlap along that edge's normal along which they do so least (theorem of the
    separating axis); below 0 where they do not.
    """
    edges = np.concatenate([one - np.roll(one, 1, axis=1), other - np.roll(other, 1, axis=1)], axis=1)
    across = np.stack([-edges[..., 1], edges[..., 0]], axis=2)
    across /= np.maximum(np.linalg.norm(across, axis=2, keepdims=True), 1e-12)
    a, b = across @ one.transpose(0, 2, 1), across @ other.transpose(0, 2, 1)
    wide = np.minimum(a.max(axis=2), b.max(axis=2)) - np.maximum(a.min(axis=2), b.min(axis=2))
    return np.asarray(wide.min(axis=1))


def _shared(one: Array, other: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """(n, 15, 2) corners of what triangles (n, 3, 2) share, and whether each is one: corners of the one in the other,
    and where edges cross.
    """
    r, s = (np.roll(tri, -1, axis=1) - tri for tri in (one, other))
    between = other[:, None] - one[:, :, None]
    turn = _cross(r[:, :, None], s[:, None])
    with np.errstate(divide="ignore", invalid="ignore"):
        t, u = _cross(between, s[:, None]) / turn, _cross(between, r[:, :, None]) / turn
        crossing = (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0)
    met = one[:, :, None] + np.where(crossing, t, 0.0)[..., None] * r[:, :, None]
    places = np.concatenate([one, other, met.reshape(len(one), 9, 2)], axis=1)
    return places, np.concatenate([_within(one, other), _within(other, one), crossing.reshape(len(one), 9)], axis=1)


def _within(places: Array, triangle: Array) -> npt.NDArray[np.bool_]:
    """(n, k) whether places (n, k, 2) lie in triangles (n, 3, 2)."""
    edges = np.roll(triangle, -1, axis=1) - triangle
    sides = _cross(edges[:, None], places[:, :, None] - triangle[:, None])
    return np.asarray((sides >= 0.0).all(axis=2) | (sides <= 0.0).all(axis=2))


def _height(flat: Array, away: Array, places: Array) -> Array:
    """(n, k) height at places (n, k, 2) of the planes of triangles: corners (n, 3, 2) at the heights (n, 3)."""
    edges, rise = flat[:, 1:] - flat[:, :1], away[:, 1:] - away[:, :1]
    slope = np.linalg.solve(edges, rise[..., None])
    return np.asarray(away[:, :1] + ((places - flat[:, :1]) @ slope)[..., 0])


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])

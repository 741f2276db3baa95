"""Cubes, spheres, cylinders, cones, capsules and planes as triangles.

Takes the prims, or their sizes; gives triangles in their own coordinates.
"""

from __future__ import annotations

import functools

import numpy as np
from pxr import Usd

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Triangles

ROUND = 48
"""Segments around a cylinder, cone or capsule; its radius errs by 0.2 %."""

_BALLS_TRIANGLES = 8_000_000
"""Triangles that a Sphere may have in all places together."""


def read_implicit(prim: Usd.Prim, kind: str, time: Usd.TimeCode, notes: Diagnostics, places: int = 0) -> Triangles:
    """A Cube, Sphere, Cylinder, Cone, Capsule or Plane as triangles in its own coordinates; a Sphere that stands in
    many places has fewer of them.
    """

    def number(name: str, default: float) -> float:
        attribute = prim.GetAttribute(name)
        value = attribute.Get(time) if attribute else None
        return float(default if value is None else value)

    if kind == "Cube":
        return cube(number("size", 2.0) / 2.0)
    if kind == "Sphere":
        if not places:
            return sphere_mesh(number("radius", 1.0))
        divisions = next((fine for fine in (4, 3, 2) if 20 * 4**fine * places <= _BALLS_TRIANGLES), 1)
        normals, faces, fit = ball(divisions)
        radius = number("radius", 1.0)
        return Triangles(normals * (fit * radius), faces, normals)
    axis = notes.token(prim.GetPath(), "axis", prim.GetAttribute("axis").Get(), "XYZ", "Z")
    if kind == "Plane":
        width, length = number("width", 2.0), number("length", 2.0)
        corners = np.array(
            [
                [-width / 2, -length / 2, 0],
                [width / 2, -length / 2, 0],
                [width / 2, length / 2, 0],
                [-width / 2, length / 2, 0],
            ]
        )
        upright = Triangles(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0.0, 0.0, 1.0], (4, 1)))
    else:
        height = number("height", 2.0 if kind in ("Cylinder", "Cylinder_1", "Cone") else 1.0)
        radius = number("radius", 0.5 if kind.startswith("Capsule") else 1.0)
        if kind == "Cone":
            bottom, top = radius, 0.0
        elif kind.endswith("_1"):
            bottom, top = number("radiusBottom", radius), number("radiusTop", radius)
        else:
            bottom = top = radius
        upright = capsule(height, bottom, top) if kind.startswith("Capsule") else frustum(height, bottom, top)
    turn = (_PLANE_TURN if kind == "Plane" else _AXIS_TURN).get(axis, np.eye(3))
    turned = None if upright.normals is None else upright.normals @ turn.T
    return Triangles(upright.positions @ turn.T, upright.faces, turned)


_AXIS_TURN = {"X": np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]), "Y": np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])}
_PLANE_TURN = {"X": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), "Y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])}
"""From Z to the axis; a plane about X has its width along Z, about Y its length."""


def cube(half: float) -> Triangles:
    """A cube of half size `half`, flat."""
    corners = np.array([[x, y, z] for x in (-half, half) for y in (-half, half) for z in (-half, half)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return Triangles(corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def sphere_mesh(radius: float) -> Triangles:
    """A sphere of revolution about Z with exact normals."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, ROUND // 2 + 1)
    unit = _revolved(np.cos(angles), np.sin(angles), np.cos(angles), np.sin(angles))
    return Triangles(unit.positions * radius, unit.faces, unit.normals)


@functools.cache
def ball(divisions: int) -> tuple[Array, Indices, float]:
    """An icosphere: (N, 3) unit vertices, (M, 3) faces, and the factor that gives it the surface of the sphere."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=divisions)
    vertices = np.asarray(sphere.vertices, dtype=np.float64)
    return vertices, np.asarray(sphere.faces, dtype=np.int64), float(np.sqrt(4.0 * np.pi / sphere.area))


def frustum(height: float, bottom: float, top: float) -> Triangles:
    """A cylinder or cone along Z, centred, with flat caps."""
    slope = np.array([height, bottom - top]) / max(np.hypot(height, bottom - top), 1e-300)
    rings = [
        _revolved(np.array([0.0, bottom]), np.array([-height / 2] * 2), np.zeros(2), -np.ones(2)),
        _revolved(
            np.array([bottom, top]), np.array([-height / 2, height / 2]), np.full(2, slope[0]), np.full(2, slope[1])
        ),
        _revolved(np.array([top, 0.0]), np.array([height / 2] * 2), np.zeros(2), np.ones(2)),
    ]
    return _joined(rings)


def capsule(height: float, bottom: float, top: float) -> Triangles:
    """A cylinder along Z of length `height` with half balls on its ends."""
    low, high = np.linspace(-np.pi / 2, 0.0, ROUND // 4 + 1), np.linspace(0.0, np.pi / 2, ROUND // 4 + 1)
    radius = np.concatenate([bottom * np.cos(low), top * np.cos(high)])
    z = np.concatenate([bottom * np.sin(low) - height / 2, top * np.sin(high) + height / 2])
    angle = np.concatenate([low, high])
    return _revolved(radius, z, np.cos(angle), np.sin(angle))


def _revolved(radius: Array, z: Array, normal_r: Array, normal_z: Array) -> Triangles:
    """A profile (from low to high) turned about Z; triangles of no area left out."""
    around = np.arange(ROUND) * (2 * np.pi / ROUND)
    x, y = np.cos(around), np.sin(around)
    positions = np.stack([np.outer(radius, x), np.outer(radius, y), np.repeat(z[:, None], ROUND, axis=1)], axis=-1)
    normals = np.stack(
        [np.outer(normal_r, x), np.outer(normal_r, y), np.repeat(normal_z[:, None], ROUND, axis=1)], axis=-1
    )
    row, column = np.meshgrid(np.arange(len(z) - 1), np.arange(ROUND), indexing="ij")
    a, b = row * ROUND + column, row * ROUND + (column + 1) % ROUND
    c, d = b + ROUND, a + ROUND
    small = 1e-12 * max(float(np.abs(radius).max()), 1e-300)
    lower, upper = radius[:-1][row] > small, radius[1:][row] > small
    faces = np.concatenate([np.stack([a, b, c], axis=-1)[lower], np.stack([a, c, d], axis=-1)[upper]])
    return Triangles(positions.reshape(-1, 3), faces.astype(np.int64), normals.reshape(-1, 3))


def _joined(parts: list[Triangles]) -> Triangles:
    offsets = np.cumsum([0, *[len(p.positions) for p in parts[:-1]]])
    return Triangles(
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=True)]),
        np.concatenate([p.normals for p in parts if p.normals is not None]),
    )

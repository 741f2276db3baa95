"""Tubes and ribbons along lines.

Takes sampled lines with radii, and for ribbons which way they face; gives positions,
faces and normals.  Knows nothing of USD.
"""

from __future__ import annotations

import numpy as np

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.translate.geometry import cross


def ribbons(line: Array, radius: Array, facing: Array) -> tuple[Array, Indices, Array]:
    """Flat strips along (F, S, 3) lines: positions, faces, normals; two points to a sample.

    Args:
        line: (F, S, 3).
        radius: (F, S) or (F, 1) half of the width.
        facing: (F, S, 3) or (F, 1, 3) which way the strip looks; only what stands at right angles to the line counts.
    """
    count, samples, _ = line.shape
    tangent = tangents(line)
    side = cross(np.broadcast_to(facing, line.shape), tangent)
    length = np.linalg.norm(side, axis=2, keepdims=True)
    axis = np.eye(3)[np.abs(tangent).argmin(axis=2)]  # where the strip looks along its line, it has no side of its own
    side = np.where(length > 1e-12, side, cross(axis, tangent))
    side /= np.maximum(np.linalg.norm(side, axis=2, keepdims=True), 1e-300)
    reach = side * radius[:, :, None]
    positions = np.stack([line + reach, line - reach], axis=2)
    normals = np.repeat(cross(tangent, side)[:, :, None], 2, axis=2)
    a = (2 * np.arange(count * samples).reshape(count, samples)[:, :-1]).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 3, a + 2], axis=1), np.stack([a, a + 1, a + 3], axis=1)])
    return positions.reshape(-1, 3), faces, normals.reshape(-1, 3)


def tangents(line: Array) -> Array:
    """(F, S, 3) unit directions of lines at their points."""
    ahead = np.diff(line, axis=1)
    tangent = np.concatenate([ahead[:, :1], ahead[:, 1:] + ahead[:, :-1], ahead[:, -1:]], axis=1)
    length = np.linalg.norm(tangent, axis=2, keepdims=True)
    return np.where(length > 0.0, tangent / np.maximum(length, 1e-300), [1.0, 0.0, 0.0])


def tubes(line: Array, radius: Array, sides: int) -> tuple[Array, Indices, Array]:
    """Tubes around (F, S, 3) lines: positions, faces, normals; outside is outside.

    The frame is carried along without twist, by double reflection (Wang et al. 2008).
    """
    count, samples, _ = line.shape
    tangent = tangents(line)
    axis = np.eye(3)[np.abs(tangent[:, 0]).argmin(axis=1)]
    side = cross(tangent[:, 0], axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    sideways = [side]
    for k in range(samples - 1):
        step = line[:, k + 1] - line[:, k]
        square = np.maximum(np.einsum("fi,fi->f", step, step), 1e-300)[:, None]
        turned = side - (2.0 / square) * np.einsum("fi,fi->f", step, side)[:, None] * step
        mirrored = tangent[:, k] - (2.0 / square) * np.einsum("fi,fi->f", step, tangent[:, k])[:, None] * step
        second = tangent[:, k + 1] - mirrored
        square = np.einsum("fi,fi->f", second, second)[:, None]
        side = np.where(
            square > 1e-24,
            turned - 2.0 / np.maximum(square, 1e-300) * np.einsum("fi,fi->f", second, turned)[:, None] * second,
            turned,
        )
        side = side - np.einsum("fi,fi->f", side, tangent[:, k + 1])[:, None] * tangent[:, k + 1]
        side = side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-300)
        sideways.append(side)
    u = np.stack(sideways, axis=1)
    v = cross(tangent, u)
    angle = np.arange(sides) * (2.0 * np.pi / sides)
    around = u[:, :, None] * np.cos(angle)[:, None] + v[:, :, None] * np.sin(angle)[:, None]  # (F, S, sides, 3)
    fit = (np.pi / sides) / np.sin(np.pi / sides)  # the mean width of a convex outline is its length over pi (Cauchy)
    positions = line[:, :, None] + around * (radius * fit)[:, :, None, None]
    ring = np.arange(count * samples).reshape(count, samples) * sides
    a = ring[:, :-1, None] + np.arange(sides)
    b = ring[:, :-1, None] + np.roll(np.arange(sides), -1)
    c, d = b + sides, a + sides
    faces = np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)])
    return positions.reshape(-1, 3), faces, around.reshape(-1, 3)

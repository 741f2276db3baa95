"""The sky as surfaces ask it: by what it sends and by their normal.

The renderer's own choice of a direction knows the sky's picture alone.  So a wall would ask
half of its directions behind itself, and as many at a flat angle as at a steep one.  Here the chance of a direction is
its light times the cosine.  A table has it by normal and by direction, both in cells of equal solid angle.  Rows are
drawn first and cells within them (the warping of Clarberg et al. 2005, in two levels), so that points which fill the
square evenly stay even on the sphere.  A sky with a sun is left to the renderer.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.render import backend
from synfog_usd.render.load import MitsubaScene

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Emitter, Normal3f, Point2f, Spectrum, Vector3f

STEPS = 16
"""Cells by the height z of a direction, and by its azimuth; a power of 2."""

WITHIN = 4
"""Points of a cell, along each side, from which its light and its cosines are known."""

MOST_UNEVEN = 1.5
"""Second moment of the light of directions that are drawn by cells: 1 of a sky that is even within each.

The shipped ones have 1.01 to 1.23; a cell with a sun has far more.
"""

EVEN_SHARE = 0.05
"""Of the directions, drawn by the light alone: a rounded normal and a leaf that light shines through see some of what
their cell does not.
"""


class SkyTable:
    """Directions to a sky, by its light and the cosine.

    Args:
        environment: the renderer's.
    """

    def __init__(self, environment: Emitter) -> None:
        mi = backend.mitsuba()
        self.environment = environment
        chances = _chances(environment)
        heights = chances.sum(axis=2)
        within = chances / np.maximum(heights, 1e-30)[..., None]
        self._chance = mi.Float(chances.ravel().astype(np.float32))
        self._heights, self._within = (mi.Float(_cumulated(shares).ravel()) for shares in (heights, within))

    @staticmethod
    def of(loaded: MitsubaScene) -> SkyTable | None:
        """The sky of a scene; None where there is none, or where one of its cells holds a sun."""
        environment = loaded.scene.environment()
        return None if environment is None or _unevenness(environment) > MOST_UNEVEN else SkyTable(environment)

    def row(self, normal: Normal3f) -> UInt32:
        """The table's row for a normal."""
        height, azimuth = _cell(normal)
        return height * STEPS + azimuth

    def draw(self, row: UInt32, u: Point2f) -> tuple[Vector3f, Float]:
        """A direction for a point of the unit square, and its density [1/sr]."""
        mi = backend.mitsuba()
        height, up = _step_of(self._heights, row, u.x)
        azimuth, along = _step_of(self._within, row * STEPS + height, u.y)
        z = (mi.Float(height) + up) * (2.0 / STEPS) - 1.0
        sine, cosine = dr.sincos((mi.Float(azimuth) + along) * (2.0 * np.pi / STEPS))
        ring = dr.safe_sqrt(1.0 - z * z)
        return mi.Vector3f(ring * cosine, ring * sine, z), self._density(row, height, azimuth)

    def density(self, row: UInt32, direction: Vector3f) -> Float:
        """Density [1/sr] with which `draw` has a direction."""
        return self._density(row, *_cell(direction))

    def radiance(self, direction: Vector3f, active: Bool | bool = True) -> Spectrum:
        """Radiance [cd m-2] of the sky in a direction."""
        mi = backend.mitsuba()
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = -direction
        return self.environment.eval(si, mi.Bool(active))

    def _density(self, row: UInt32, height: UInt32, azimuth: UInt32) -> Float:
        mi = backend.mitsuba()
        chance = dr.gather(mi.Float, self._chance, (row * STEPS + height) * STEPS + azimuth)
        return chance * (STEPS * STEPS / (4.0 * np.pi))


def _cell(direction: Vector3f | Normal3f) -> tuple[UInt32, UInt32]:
    """Numbers of a direction's cell, by height and by azimuth."""
    mi = backend.mitsuba()
    turned = dr.atan2(direction.y, direction.x) * (0.5 / np.pi)
    turned = dr.select(turned < 0.0, turned + 1.0, turned)
    height = mi.UInt32(dr.maximum((direction.z * 0.5 + 0.5) * STEPS, 0.0))
    return dr.minimum(height, STEPS - 1), dr.minimum(mi.UInt32(turned * STEPS), STEPS - 1)


def _step_of(cumulated: Float, row: UInt32, u: Float) -> tuple[UInt32, Float]:
    """Which of a row's steps a number below 1 falls into, and where in it, as a share."""
    mi = backend.mitsuba()
    begin, step = row * (STEPS + 1), STEPS // 2
    at = mi.UInt32(0)
    while step:
        beyond = dr.gather(mi.Float, cumulated, begin + at + step) <= u
        at = dr.select(beyond, at + step, at)
        step //= 2
    low, high = dr.gather(mi.Float, cumulated, begin + at), dr.gather(mi.Float, cumulated, begin + at + 1)
    return at, dr.clip((u - low) / dr.maximum(high - low, 1e-12), 0.0, 1.0)


def _cumulated(shares: Array) -> Array:
    """(..., STEPS + 1) sums of shares (..., STEPS) from 0 to 1."""
    sums = np.concatenate([np.zeros((*shares.shape[:-1], 1)), np.cumsum(shares, axis=-1)], axis=-1)
    sums[..., -1] = 1.0
    return sums.astype(np.float32)


def _directions(within: int) -> Array:
    """(STEPS, STEPS, within^2, 3) directions spread evenly over each cell."""
    place = (np.arange(STEPS * within) + 0.5) / (STEPS * within)
    z, turned = np.meshgrid(2.0 * place - 1.0, 2.0 * np.pi * place, indexing="ij")
    ring = np.sqrt(1.0 - z**2)
    grid = np.stack([ring * np.cos(turned), ring * np.sin(turned), z], axis=-1)
    cells = grid.reshape(STEPS, within, STEPS, within, 3).swapaxes(1, 2)
    return cells.reshape(STEPS, STEPS, within * within, 3)


@functools.cache
def _cosines() -> Array:
    """(STEPS^2, (STEPS * WITHIN)^2) cosines between normals, by their rows, and directions: the same for every sky."""
    directions = _directions(WITHIN).reshape(-1, 3)
    normals = _directions(2).reshape(STEPS * STEPS, -1, 3)
    return np.mean([np.maximum(some @ directions.T, 0.0) for some in normals.swapaxes(0, 1)], axis=0)


def _chances(environment: Emitter) -> Array:
    """(STEPS^2, STEPS, STEPS) chance of each cell by the row of the normal; of each row they add up to 1."""
    mi = backend.mitsuba()
    directions = _directions(WITHIN).reshape(-1, 3)
    si = dr.zeros(mi.SurfaceInteraction3f, len(directions))
    si.wi = -mi.Vector3f(*(np.ascontiguousarray(axis, dtype=np.float32) for axis in directions.T))
    light = _numbers(mi.luminance(environment.eval(si)), len(directions))

    def shares(weights: Array) -> Array:
        """Of the cells, for weights (..., directions)."""
        of_cells = weights.reshape(len(weights), STEPS, STEPS, -1).sum(axis=3)
        return of_cells / np.maximum(of_cells.sum(axis=(1, 2), keepdims=True), 1e-30)

    mixed = (1.0 - EVEN_SHARE) * shares(_cosines() * light) + EVEN_SHARE * shares(light[None])
    return mixed / np.maximum(mixed.sum(axis=(1, 2), keepdims=True), 1e-30)


def _unevenness(environment: Emitter, side: int = 128) -> float:
    """Second moment of the light over its density where directions are drawn by the light of their cells: 1 at best.

    From `side`^2 directions that the renderer draws by the light, so that a sun is among them.
    """
    mi = backend.mitsuba()
    place = (np.arange(side, dtype=np.float32) + 0.5) / side
    x, y = (mi.Float(axis.ravel()) for axis in np.meshgrid(place, place))
    sent, weight = environment.sample_direction(dr.zeros(mi.Interaction3f, side * side), mi.Point2f(x, y))
    light_of_ray, density = (_numbers(part, side * side) for part in (mi.luminance(weight), sent.pdf))
    height, azimuth = (np.asarray(part) for part in _cell(sent.d))
    cell, number = height * STEPS + azimuth, STEPS * STEPS
    light, squares = (
        np.bincount(cell, part, minlength=number) for part in (light_of_ray, light_of_ray * light_of_ray * density)
    )
    lit = light > 0.0
    even = light[lit] / side**2 / (4.0 * np.pi / number)  # radiance of each cell, if it were the same all over it
    return float(np.sum(squares[lit] / even) / light.sum()) if lit.any() else 1.0


def _numbers(values: Float, count: int) -> Array:
    """(count,) traced numbers, of which there may be one for all."""
    return np.broadcast_to(np.asarray(values, dtype=np.float64), count)

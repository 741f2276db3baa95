"""Fog on a grid of densities as a kernel sees it: flights and transmittances by tracking, optical depths exactly.

Takes a fog volume with a `DensityGrid`; gives, for stretches of rays, where the fog scatters and what it lets through.

**Tracking.**  Fog that does nothing is added until a cell of `block`^3 voxels is as dense as its densest point, the
majorant.  A ray then meets tentative collisions in closed form, cell by cell, and each is a true one with the chance
density / majorant (Woodcock et al. 1965; local majorants: Szirmay-Kalos et al. 2011).  For a transmittance, each
collision multiplies what is left by 1 - density / majorant instead (ratio tracking, Novak et al. 2014).  Both are
unbiased.

The field is trilinear between voxel centres, the same as of `DensityGrid.mean` and of Mitsuba's `gridvolume`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import drjit as dr
import numpy as np
from scipy import ndimage

from synfog_usd.base.arrays import Array
from synfog_usd.fog import FogVolume
from synfog_usd.fog.grid import GAUSS, DensityGrid
from synfog_usd.render import backend
from synfog_usd.render.sampling.sobol import hashed, unit

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Point3f, Vector3f

MOST_CELLS = 64
"""Cells of the majorants along an axis."""

LEAST_BLOCK = 8
"""Voxels along a cell's side at least; smaller cells fit better and cost more steps."""

NUDGE = 1e-3
"""How far beyond a side a ray goes on, in cells or voxels: a majorant holds two voxels beyond its cell."""

ROUNDING = 2.4e-7
"""Least step as a share of the distance, so that it is one in single precision."""

FAINT = 0.1
"""Transmittance below which a collision ends the ray or does nothing: else it would creep on behind dense fog."""


class Volume(Protocol):
    """A part of space."""

    def contains(self, place: Point3f) -> Bool:
        """Whether points are inside."""


class GridTracker:
    """The densities of one volume.

    Args:
        volume: fog with a grid.
        sigma_t: extinction [1/m] where the density is 1, out of the compiler's sight.

    Attributes:
        mean_sigma_t: mean extinction of the grid [1/m].
        holes: where there is nothing.
    """

    def __init__(self, volume: FogVolume, sigma_t: Float) -> None:
        mi, grid = backend.mitsuba(), volume.medium.grid
        assert grid is not None
        counts = np.array(grid.values.shape[::-1])
        block = max(LEAST_BLOCK, -(-int(counts.max()) // MOST_CELLS))
        most = majorants(grid, block)
        matrix = mi.ScalarTransform4f(cells_from_world(volume, block))
        self.to_cells = mi.Transform4f(matrix)
        self.block = dr.opaque(mi.Float, block)
        self.counts = mi.Vector3i(*(dr.opaque(mi.Int32, int(count)) for count in counts))
        self.cells = mi.Vector3i(*(dr.opaque(mi.Int32, int(count)) for count in most.shape[::-1]))
        self.densities, self.majorants = backend.floats(grid.values.ravel()), backend.floats(most.ravel())
        self.holes: list[Volume] = []
        self.sigma_t, self.repeats = sigma_t, grid.period_m is not None
        self.mean_sigma_t = sigma_t * dr.opaque(mi.Float, float(grid.values.mean(dtype=np.float64)))
        dr.make_opaque(self.to_cells)

    def extinction(self, place: Point3f) -> Float:
        """Extinction [1/m] at points in the grid's box."""
        return self.sigma_t * self._density(
            backend.mitsuba().Vector3f(self.to_cells @ backend.mitsuba().Point3f(place)), True
        )

    @dr.syntax
    def track(
        self,
        origin: Point3f,
        direction: Vector3f,
        begin: Float,
        end: Float,
        u: Float,
        key: UInt32,
        active: Bool,
        until_scattered: bool,
    ) -> tuple[Float, Float]:
        """How much of a stretch's light comes through, and where the rest is scattered.

        Args:
            origin, direction: rays, of unit direction.
            begin, end: the stretch in the grid's box, as distances [m].
            u: the number in [0, 1) that draws the first collision.
            key: of the random numbers for all others.
            until_scattered: whether a true collision ends the ray, so that the transmittance is 0 or 1; else all of
                them weigh it, with less noise.

        Returns:
            transmittance T, unbiased; and a distance [m], infinite where T is 1: with the weight 1 - T it is drawn in
            proportion to transmittance x extinction.
        """
        mi = backend.mitsuba()
        faint = 2.0 if until_scattered else FAINT
        at, along = mi.Vector3f(self.to_cells @ mi.Point3f(origin)), mi.Vector3f(self.to_cells @ mi.Vector3f(direction))
        safe = mi.Vector3f([dr.select(dr.abs(x) < 1e-12, dr.copysign(mi.Float(1e-12), x), x) for x in along])
        per_cell, side = dr.rcp(safe), dr.select(safe > 0.0, mi.Vector3f(1.0), mi.Vector3f(0.0))
        nudge = NUDGE / dr.max(dr.abs(safe))

        distance, through, place = mi.Float(begin), mi.Float(1.0), mi.Float(dr.inf)
        depth = -dr.log(1.0 - u)  # of the majorants until the next collision
        number = mi.UInt32(0)
        flies = active & (end > begin)
        while flies:
            here = at + along * distance
            cell = dr.floor(here)
            most = self.sigma_t * dr.gather(mi.Float, self.majorants, self._index(mi.Vector3i(cell), self.cells), flies)
            leap = dr.maximum(dr.min((cell + side - here) * per_cell), 0.0) + nudge + ROUNDING * distance
            leaves = distance + leap >= end
            leap = dr.minimum(leap, end - distance)
            collides = flies & (most * leap > depth)
            distance += dr.select(collides, depth / most, leap)
            depth -= most * leap

            true = dr.minimum(self.sigma_t * self._density(at + along * distance, collides) / most, 1.0)
            for hole in self.holes:
                true = dr.select(hole.contains(origin + direction * distance), 0.0, true)
            number += 1
            bits = hashed(key, number)
            chance = unit(hashed(bits, 0))
            is_faint = through < faint
            after = dr.select(is_faint, dr.select(chance < true, 0.0, through), through * (1.0 - true))
            chance = dr.select(is_faint, chance / true, chance)  # as good as new below the chance of a true one
            scatters = collides & (chance * (1.0 - after) < through - after)
            place = dr.select(scatters, distance, place)
            through = dr.select(collides, after, through)
            depth = dr.select(collides, -dr.log(1.0 - unit(bits)), depth)
            flies &= (collides | ~leaves) & (through > 0.0)
        return through, place

    @dr.syntax
    def optical_depth(self, origin: Point3f, direction: Vector3f, begin: Float, end: Float, most: float) -> Float:
        """Optical depth of a stretch in the grid's box, or any number above `most`; other arguments as in `track`.

        Between planes of voxel centres the density is a cubic, of which two Gauss points give the mean.
        """
        mi = backend.mitsuba()
        at = mi.Vector3f(self.to_cells @ mi.Point3f(origin)) * self.block - 0.5  # centres are whole numbers
        along = mi.Vector3f(self.to_cells @ mi.Vector3f(direction)) * self.block
        safe = mi.Vector3f([dr.select(dr.abs(x) < 1e-12, dr.copysign(mi.Float(1e-12), x), x) for x in along])
        per_voxel, side = dr.rcp(safe), dr.select(safe > 0.0, mi.Vector3f(1.0), mi.Vector3f(0.0))
        nudge = NUDGE / dr.max(dr.abs(safe))
        distance, total = mi.Float(begin), mi.Float(0.0)
        flies = end > begin
        while flies:
            here = at + along * distance
            voxel = dr.floor(here + nudge * along)
            leap = dr.maximum(dr.min((voxel + side - here) * per_voxel), nudge + ROUNDING * distance)
            leaves = distance + leap >= end
            leap = dr.minimum(leap, end - distance)
            corners = self._corners(mi.Vector3i(voxel), flies)
            mean = mi.Float(0.0)
            for share in (GAUSS, 1.0 - GAUSS):
                mean += 0.5 * _between(corners, here + along * (share * leap) - voxel)
            total += dr.select(flies, self.sigma_t * mean * leap, 0.0)
            distance += leap
            flies &= ~leaves & (total < most)
        return total

    def _density(self, place: Vector3f, active: Bool | bool) -> Float:
        """Density at a place in cells."""
        mi = backend.mitsuba()
        voxel = place * self.block - 0.5
        low = dr.floor(voxel)
        return _between(self._corners(mi.Vector3i(low), active), voxel - low)

    def _corners(self, low: Vector3f, active: Bool | bool) -> list[Float]:
        """Densities at eight voxel centres from `low` on, x fastest."""
        mi = backend.mitsuba()
        return [
            dr.gather(mi.Float, self.densities, self._index(low + mi.Vector3i(x, y, z), self.counts), active)
            for z in (0, 1)
            for y in (0, 1)
            for x in (0, 1)
        ]

    def _index(self, place: Vector3f, counts: Vector3f) -> UInt32:
        """Where a voxel or a cell stands in its array; beyond the outermost one that goes on, or the grid repeats."""
        mi = backend.mitsuba()
        if self.repeats:
            x, y, z = (place[axis] & (counts[axis] - 1) for axis in range(3))
        else:
            x, y, z = (dr.clip(place[axis], 0, counts[axis] - 1) for axis in range(3))
        return mi.UInt32((z * counts[1] + y) * counts[0] + x)


def _between(corners: list[Float], share: Vector3f) -> Float:
    """Trilinear mean of eight corners, x fastest."""
    for axis in range(3):
        corners = [dr.lerp(low, high, share[axis]) for low, high in zip(corners[::2], corners[1::2], strict=True)]
    return corners[0]


def majorants(grid: DensityGrid, block: int) -> Array:
    """(Z, Y, X) float32 largest density of each cell of `block`^3 voxels and of two voxels around it."""
    most, reach, mode = np.asarray(grid.values), block + 4, "nearest" if grid.period_m is None else "wrap"
    for axis, count in enumerate(most.shape):
        middle = np.minimum(np.arange(0, count, block) - 2 + reach // 2, count - 1)
        most = ndimage.maximum_filter1d(most, reach, axis=axis, mode=mode).take(middle, axis=axis)
    return np.ascontiguousarray(most)


def cells_from_world(volume: FogVolume, block: int) -> Array:
    """Matrix (4, 4) from world metres to the cells of a volume's grid."""
    assert volume.medium.grid is not None
    counts = np.array(volume.medium.grid.values.shape[::-1])
    to_cells = np.diag([*(counts / (2.0 * block)), 1.0])
    to_cells[:3, 3] = counts / (2.0 * block)
    return to_cells @ np.linalg.inv(volume.grid_frame())

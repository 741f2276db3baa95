"""Airlight from a froxel grid, a radiance cache: what fog scatters towards the camera is smooth, and need not be
sampled anew for each pixel.

The view is cut into cells, columns of a few degrees and slices of equal share of the
fog's own opacity (Wronski 2014, "froxels").  In each cell paths begin where nothing hides
it from the camera, and their mean is the light that this fog sends; a pixel's airlight is
the sum over the cells in front of its surface.  A hundred neighbours share every path.

Everything that is not smooth is done pixel by pixel, as in `path`: surfaces, and lamps that
the fog scatters once.  With a `ControlVariate` the slab's light is, too, and the cache holds the
difference to it.

Valid where light that was scattered more than once changes little over a cell, 1.5 degrees
and a twelfth of the fog's opacity.  What errs: the glow within a cell's width of a lamp, and the
shade of an object seen through clear air beside it.  Noise of the grid is soft blotches; a cell
that one path made far brighter than its neighbours shares with them.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from synfog_usd.arrays import Array
from synfog_usd.progress import Progress, silent
from synfog_usd.render import backend
from synfog_usd.render.film.accumulator import AOVS, INSCATTERED
from synfog_usd.render.integrators.eye import FroxelGrid
from synfog_usd.render.integrators.path import FogPath
from synfog_usd.render.media.medium import transmittance
from synfog_usd.render.sampling.sobol import Sobol

COLUMN_DEG = 1.5
COLUMNS_PARALLEL = 40
"""Of an orthographic camera's view."""

SLICES = 12
SIDE = 8
"""Most rays along each side of a pixel whose ends are looked up in the grid; jittered, their noise falls by their
number to the power 1.5 (Mitchell 1996).
"""

CELL_COST = 1.6
"""Seconds of a path that begins in a cell, over one that begins at a surface; measured, and fixed so that the same seed
gives the same bytes.
"""

BETWEEN = 4.0 / 9.0
"""What is left of the variance of cells between four of them, in the mean over all places."""

LEAST = 2
"""Paths of a cell that make it known."""

LOUD = 0.4
"""Standard error of a cell over its light from which on it is one path's chance, and seen as a ball of light."""

OUTLYING = 2.0
"""Times the median of its neighbours that such a cell may have; the rest is theirs."""

SHARED_WITH = (3, 9, 9)
"""Slices, rows and columns of those."""

LOOKUPS = CELL_LANES = 1 << 18
"""Pixels, and paths' lanes, at once."""

LENGTH = 16
"""Paths that one lane traces one after the other, as `film.accumulator.CHUNK`."""


class FroxelPath(FogPath):
    """One scene's integrator; a `FogPath` whose estimator INSCATTERED is looked up in a radiance cache."""

    @property
    def cells(self) -> FroxelGrid:
        """How the view is cut; never finer than its pixels."""
        camera = self.loaded.source.camera
        wanted = COLUMNS_PARALLEL if camera.width_m > 0.0 else round(camera.fov_x_deg / COLUMN_DEG)
        columns = max(2, min(wanted, camera.width_px))
        return FroxelGrid(
            columns, max(2, min(round(columns * camera.height_px / camera.width_px), camera.height_px)), SLICES
        )

    def radiance_cache(self) -> RadianceCache | None:
        """A cache without paths yet; None where the air is clear."""
        return RadianceCache(self) if INSCATTERED in self.estimators else None


class RadianceCache:
    """Sums over the paths of each cell, slice by slice from the camera on.

    Attributes:
        count: paths that were begun in each cell.
        paths: in all cells.
        cost: seconds of a path in every cell over those of a path to the surface of every pixel.
        lost: paths that were not finite and count as zero.
    """

    def __init__(self, field: FroxelPath) -> None:
        self.field, self.cells, self.count, self.lost = field, field.cells, 0, 0
        camera, shape = field.loaded.source.camera, (self.cells.count, field.bands.count)
        self.cost = CELL_COST * self.cells.count / (camera.width_px * camera.height_px)
        self.aovs, self.squares = [np.zeros(shape) for _ in AOVS[INSCATTERED]], np.zeros(shape)
        self.groups = [np.zeros(shape) for _ in range(field.groups if field.groups > 1 else 0)]
        self.seen = np.zeros(self.cells.count, dtype=np.int64)

    @property
    def paths(self) -> int:
        """In all cells."""
        return self.count * self.cells.count

    def add_samples(self, count: int, seed: int, progress: Progress = silent) -> None:
        """Begin `count` more paths in every cell."""
        cells, everywhere = self.cells, np.arange(self.cells.count)
        rows, done = max(1, CELL_LANES // cells.count), 0
        full, rest = divmod(count, LENGTH)
        work = [(LENGTH, min(rows, full - low)) for low in range(0, full, rows)] + ([(rest, 1)] if rest else [])
        for length, chunks in work:
            first = np.repeat(self.count + np.arange(chunks) * length, cells.count)
            sums = self.field.trace_froxels(
                cells, backend.numbers(np.tile(everywhere, chunks)), backend.numbers(first), length, seed
            )
            dr.eval(sums.aovs, sums.squares, sums.groups, sums.lost, sums.seen)
            for target, light in zip(
                (*self.aovs, self.squares, *self.groups), (*sums.aovs, sums.squares, *sums.groups), strict=True
            ):
                target += backend.rows(light).reshape(chunks, *target.shape).sum(axis=0)
            self.seen += np.array(sums.seen, dtype=np.int64).reshape(chunks, -1).sum(axis=0)
            self.lost += int(np.array(sums.lost).sum())
            self.count += length * chunks
            done += length * chunks
            progress("rendering", done / count)

    def airlight(self, side: int, seed: int) -> tuple[list[Array], list[Array], Array]:
        """What lies before each pixel's surfaces, as the mean over rays.

        Args:
            side: rays along each side of a pixel, up to SIDE.
            seed: of the rays.

        Returns:
            a mean (P, C) for each of the estimator's AOVs, for each light group, and the variance (P, C) of all light.
        """
        bands, camera = self.field.bands, self.field.loaded.source.camera
        side = max(1, min(side, SIDE))
        seen = np.maximum(self.seen, 1)[:, None]
        spread = (
            np.maximum(self.squares / seen - (sum(self.aovs) / seen) ** 2, 0.0)
            / np.maximum(seen - 1, 1)
            * BETWEEN
            / self.cells.slices
        )
        kept = self._kept(spread)
        values = [*(self._shared(sums / seen, kept) for sums in (*self.aovs, *self.groups)), spread * kept**2]
        table = _texture(np.concatenate([self._summed(value) for value in values], axis=3))
        pixels, kind = camera.width_px * camera.height_px, np.float64 if bands.is_rgb else np.float32
        found = [np.zeros((pixels, bands.count), dtype=kind) for _ in (*values, None)]
        for low in range(0, pixels, LOOKUPS):
            some = np.arange(low, min(low + LOOKUPS, pixels))
            sums = self._look(table, len(values), backend.numbers(some), side, seed)
            dr.eval(sums)
            for index, target in enumerate(found):
                target[some] = backend.rows(sums[index * bands.count : (index + 1) * bands.count], kind) / side**2
        aovs, groups, (noise, squares) = found[: len(self.aovs)], found[len(self.aovs) : -2], found[-2:]
        noise += np.maximum(squares - sum(aovs) ** 2, 0.0) / side**3
        return aovs, groups, noise

    def _kept(self, spread: Array) -> Array:
        """(cells, 1) part of its light that a cell keeps: 1, but where chance made it far brighter than its
        neighbours.
        """
        from scipy import ndimage

        shape = (self.cells.slices, self.cells.rows, self.cells.columns)
        light = (sum(self.aovs) / np.maximum(self.seen, 1)[:, None]) @ self.field.bands.weights
        error = np.sqrt(spread / BETWEEN * self.cells.slices) @ self.field.bands.weights
        around = ndimage.median_filter(np.abs(light).reshape(shape), size=(3, 3, 3), mode="nearest").ravel()
        most = np.maximum(OUTLYING * around, 1e-30)
        return np.where(
            (error > LOUD * np.abs(light)) & (np.abs(light) > most), most / np.maximum(np.abs(light), 1e-30), 1.0
        )[:, None]

    def _shared(self, values: Array, kept: Array) -> Array:
        """(cells, C) values, of which each cell gives its neighbours what it does not keep."""
        from scipy import ndimage

        given = (values * (1.0 - kept)).reshape(self.cells.slices, self.cells.rows, self.cells.columns, -1)
        return values * kept + ndimage.uniform_filter(given, (*SHARED_WITH, 1), mode="nearest").reshape(values.shape)

    @dr.syntax
    def _look(self, table: Any, names: int, pixel: Any, side: int, seed: int) -> list[Any]:
        """Sums over a pixel's rays of the table's channels, and of the squares of all light."""
        mi, field, count = backend.mitsuba(), self.field, self.field.bands.count
        along, image_seed, slices = dr.opaque(mi.UInt32, side), dr.opaque(mi.UInt32, seed), float(self.cells.slices)
        corner, aovs, sky = field.eye.raster.corner(pixel), len(self.aovs), len(self.aovs) + field.sky_group
        grouped = bool(self.groups)
        sums = [mi.Float(0.0) for _ in range((names + 1) * count)]
        begun = mi.UInt32(0)
        while begun < along * along:
            sampler = Sobol(image_seed, pixel, begun)
            square = mi.Point2f(mi.Float(begun % along), mi.Float(begun // along))
            place = (corner + (square + mi.Point2f(sampler.next_2d())) / mi.Float(along)) / field.eye.raster.size
            ray, _weight = field.eye.ray_through(place, sampler, mi.Bool(True))
            si = field.loaded.tree.ray_intersect_preliminary(ray, False)
            end = dr.select(si.is_valid(), si.t, dr.inf)
            near, far = field.medium.intersect(ray.o, ray.d)
            opaque = transmittance(
                field.medium.optical_depth_inside(ray.o, ray.d, near, dr.maximum(dr.minimum(end, far), near))
            )[1]
            values = table.eval(mi.Point3f(place.x, place.y, (opaque * slices + 0.5) / (slices + 1.0)))
            if dr.hint(field.control is not None, mode="scalar"):
                known = field.control.airlight(ray, end, field.medium, mi.Bool(True))
                values = _with(values, known, (aovs - 1) * count)
                if dr.hint(grouped, mode="scalar"):
                    values = _with(values, known, sky * count)
            sums = _added(sums, values, count, aovs)
            begun += 1
        return sums

    def _summed(self, values: Array) -> Array:
        """(slices + 1, rows, columns, C): sums of values (cells, C) over the slices before; a cell that is never seen
        is as the nearest that is.
        """
        from scipy import ndimage

        shape = (self.cells.slices, self.cells.rows, self.cells.columns)
        unseen = (self.seen < LEAST).reshape(shape)
        volume = values.reshape(*shape, -1)
        if unseen.all():
            volume = np.zeros_like(volume)
        elif unseen.any():
            nearest = ndimage.distance_transform_edt(
                unseen, sampling=(2.0, 1.0, 1.0), return_distances=False, return_indices=True
            )
            volume = volume[tuple(nearest)]
        summed = np.cumsum(volume, axis=0) / self.cells.slices
        return np.concatenate([np.zeros_like(summed[:1]), summed])


def _with(values: list[Any], known: Any, begin: int) -> list[Any]:
    return [
        *values[:begin],
        *(values[begin + index] + light for index, light in enumerate(known)),
        *values[begin + len(known) :],
    ]


def _added(sums: list[Any], values: list[Any], count: int, aovs: int) -> list[Any]:
    """Sums with one ray's values, and the squares of its light behind them."""
    light = [sum(values[aov * count + band] for aov in range(aovs)) for band in range(count)]
    return [total + value for total, value in zip(sums, (*values, *(value * value for value in light)), strict=True)]


def _texture(volume: Array) -> Any:
    mi = backend.mitsuba()
    return mi.Texture3f(
        mi.TensorXf(np.ascontiguousarray(volume, dtype=np.float32)),
        filter_mode=dr.FilterMode.Linear,
        wrap_mode=dr.WrapMode.Clamp,
    )

"""Which of many lamps to ask: those that matter where a path is, and where the camera looks.

Takes the lamps and the fog; gives, for a point or a part of the view, chances for
each lamp.  Space around the camera is cut into cells, the view into tiles; what each
lamp sends to a few places in them, dimmed by the fog, is its weight there (as in the
light grids of Conty Estevez and Kulla 2018, without their tree: a street has a
hundred lamps, not a million).  No chance is below `FLOOR` times that of a choice
that does not know the place, so that whatever the few places have missed stays
unbiased, and rare.  Shadows are not known to it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from synfog_usd.arrays import Array
from synfog_usd.render import backend
from synfog_usd.render.lights.rows import EVERYWHERE, LAMP, Columns, LampRow

FLOOR = 0.15
"""Share of the draws that do not know the place."""

CELLS = 40_000
"""Most cells; with 100 lamps 32 MB."""

WEIGHTS = 4_000_000
"""Most cells times lamps; above 100 lamps cells grow with their number."""

CELL_M = 4.0
"""Least side of a cell, and its height."""

REACH_M = 150.0
"""Half the side of the cells' square; places outside of it count as the nearest cell."""

POINTS = 8
"""Places in a cell that are looked at."""

NEAR_M = 0.5
"""Lights are taken to be this far at least."""

TILES = (32, 18)
"""Columns and rows of the view."""

RAYS = 4
"""Rays of a tile, one where lamps are more than `CROWD`; along each, every lamp is asked at `NODES` places."""

CROWD = 1000

NODES = 24

LANES = 1 << 20
"""Places and lamps that are looked at together at most."""


class LightDistribution:
    """Chances of N lamps in each of R rows.

    Args:
        weights: (R, N) >= 0; a row of zeros knows nothing.
        even: (N,) chances without knowledge.
    """

    def __init__(self, weights: Array, even: Array) -> None:
        total = weights.sum(axis=1, keepdims=True)
        known = np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), even)
        chances = (1.0 - FLOOR) * known + FLOOR * even
        below = np.cumsum(chances, axis=1)
        below[:, -1] = 2.0  # rounding leaves no gap at the end
        self.count = weights.shape[1]
        self.below, self.chance = (backend.floats(values.ravel()) for values in (below, chances))
        dr.make_opaque(self.below, self.chance)

    def sample(self, row: Any, u: Any, active: Any) -> tuple[Any, Any]:
        """(a lamp, its chance)."""
        mi = backend.mitsuba()
        begin, index = row * self.count, mi.UInt32(0)
        for step in (1 << bit for bit in reversed(range((self.count - 1).bit_length()))):
            probe = index + step
            above = active & (probe < self.count)
            index = dr.select(above & (dr.gather(mi.Float, self.below, begin + probe - 1, above) <= u), probe, index)
        return index, dr.gather(mi.Float, self.chance, begin + index, active)


class LightGrid:
    """Lights by place.

    Args:
        lights: the scene's, see `LightSampler`.
        sigma_t: extinction [1/m] of the fog, 0 in clear medium.
        eye: (3,) position of the camera [m].
        near: whether chances by cell are asked for.
    """

    def __init__(self, lights: Any, sigma_t: float, eye: Array, *, near: bool = True) -> None:
        mi = backend.mitsuba()
        self.lights, self.sigma_t, self.eye = lights, sigma_t, eye
        rows = [_representative(block) for block in lights.rows]
        places = np.array([row["position"] for row in rows])
        self.columns = Columns(np.array(rows, dtype=LAMP), LampRow, tabled=lights.photometric)
        low, high = eye - REACH_M, eye + REACH_M
        low[:2], high[:2] = (
            np.maximum(low[:2], places[:, :2].min(axis=0) - 20.0),
            np.minimum(high[:2], places[:, :2].max(axis=0) + 20.0),
        )
        low[2], high[2] = places[:, 2].min() - CELL_M, places[:, 2].max() + CELL_M
        high = np.maximum(high, low + CELL_M)
        height = max(CELL_M, (high[2] - low[2]) / 8.0)
        cells = min(CELLS, max(WEIGHTS // lights.count, 1))
        side = max(CELL_M, np.sqrt(np.prod((high - low)[:2]) * np.ceil((high[2] - low[2]) / height) / cells))
        self.size = np.array([side, side, height])
        self.shape = np.maximum(np.ceil((high - low) / self.size), 1.0).astype(int)
        self.low = low
        self._low, self._scale = mi.Point3f(low.tolist()), mi.Vector3f((1.0 / self.size).tolist())
        self._most = mi.Vector3f((self.shape - 1).astype(float).tolist())
        self._stride = mi.UInt32(int(self.shape[0])), mi.UInt32(int(self.shape[0] * self.shape[1]))
        dr.make_opaque(self._low, self._scale, self._most, self._stride)
        self.near = LightDistribution(self._weights(), lights.even) if near else None

    def cell(self, place: Any) -> Any:
        """Row of `near` for points."""
        mi = backend.mitsuba()
        at = dr.clip(mi.Vector3f(place - self._low) * self._scale, 0.0, self._most)
        return mi.UInt32(at.x) + self._stride[0] * mi.UInt32(at.y) + self._stride[1] * mi.UInt32(at.z)

    def _weights(self) -> Array:
        """(cells, N) mean of what each lamp sends to places in each cell."""
        mi = backend.mitsuba()
        count = int(np.prod(self.shape))
        index = np.arange(count)
        corner = np.stack(
            [index % self.shape[0], index // self.shape[0] % self.shape[1], index // (self.shape[0] * self.shape[1])],
            axis=1,
        )
        bits = np.arange(POINTS)[:, None] >> np.arange(3) & 1
        within = 0.25 + 0.5 * bits  # of the cell's eighths, the middle
        points = self.low + (corner[:, None] + within[None]) * self.size
        place = backend.points(points.reshape(-1, 3))
        light = self._of_all(count * POINTS, lambda number, at: self._sent(number, dr.gather(mi.Point3f, place, at)))
        return np.ascontiguousarray(light.reshape(self.lights.count, count, POINTS).mean(axis=2).T)

    def _of_all(self, count: int, light: Callable[[Any, Any], Any]) -> Array:
        """(lamps, count) `light(number of a lamp, number of a place)`, some lamps at once: a kernel for each would take
        longer to be made ready than to run.
        """
        mi = backend.mitsuba()
        each, of_all = dr.opaque(mi.UInt32, count), max(1, LANES // count)
        found = []
        for low in range(0, self.lights.count, of_all):
            lane = backend.numbers(np.arange(min(of_all, self.lights.count - low) * count))
            begin = dr.opaque(mi.UInt32, low)
            found.append(np.array(light(begin + lane // each, lane % each), dtype=np.float64))
        return np.concatenate(found).reshape(self.lights.count, count)

    def _sent(self, number: Any, place: Any) -> Any:
        """Luminance-weighted irradiance of one lamp at points, without shadows."""
        mi = backend.mitsuba()
        row = self.columns.at(number)
        between = place - row.position
        square = dr.maximum(dr.squared_norm(between), NEAR_M**2)
        away = dr.sqrt(square)
        light = mi.luminance(row.colour)
        return (
            light * self.lights.sent(row, between / away) * dr.exp(-dr.opaque(mi.Float, self.sigma_t) * away) / square
        )

    def seen(self, eye: Any, medium: Any) -> LightDistribution:
        """Chances by tile of the view: what each lamp sends along rays through it, scattered once.

        Args:
            eye: the camera, an `integrators.eye.Eye`.
            medium: the fog.
        """
        mi = backend.mitsuba()
        columns, rows = TILES
        rays = RAYS if self.lights.count <= CROWD else 1
        count = columns * rows * rays
        index = np.arange(count)
        tile, ray_number = index // rays, index % rays
        jitter = np.stack([ray_number % 2, ray_number // 2], axis=1) * 0.5 + 0.25
        u, v = (tile % columns + jitter[:, 0]) / columns, (tile // columns + jitter[:, 1]) / rows
        place = mi.Point2f(backend.floats(u), backend.floats(v))
        ray, _ = eye.ray_through(place, _Middle(), mi.Bool(True))
        si = eye.loaded.tree.ray_intersect_preliminary(ray, False)
        near, far = medium.intersect(ray.o, ray.d)
        stop = dr.maximum(dr.minimum(dr.select(si.is_valid(), si.t, dr.inf), far), near)
        dr.eval(ray, near, stop)

        def along(number: Any, at: Any) -> Any:
            one = mi.Ray3f(dr.gather(mi.Point3f, ray.o, at), dr.gather(mi.Vector3f, ray.d, at))
            return self._along(number, one, dr.gather(mi.Float, near, at), dr.gather(mi.Float, stop, at), medium)

        light = self._of_all(count, along).reshape(self.lights.count, columns * rows, rays)
        return LightDistribution(np.ascontiguousarray(light.mean(axis=2).T), self.lights.even)

    @dr.syntax
    def _along(self, number: Any, ray: Any, begin: Any, end: Any, medium: Any) -> Any:
        """One lamp's light scattered once into rays, by midpoints that are even in the angle at the lamp."""
        mi = backend.mitsuba()
        lamp = self.columns.at(number).position
        nearest = dr.dot(lamp - ray.o, ray.d)
        height = dr.maximum(dr.norm(lamp - (ray.o + ray.d * nearest)), 0.1)
        low, high = dr.atan((begin - nearest) / height), dr.atan((end - nearest) / height)
        total, step = mi.Float(0.0), mi.UInt32(0)
        while step < dr.opaque(mi.UInt32, NODES):
            angle = dr.lerp(low, high, (mi.Float(step) + 0.5) / NODES)
            distance = dr.clip(nearest + height * dr.tan(angle), begin, end)
            place = ray.o + ray.d * distance
            towards = dr.normalize(place - lamp)
            jacobian = (height * height + dr.square(distance - nearest)) / height
            dimmed = dr.exp(-medium.optical_depth_inside(ray.o, ray.d, begin, distance)) * medium.phase.value(
                -dr.dot(towards, ray.d)
            )
            total += self._sent(number, place) * dimmed * jacobian
            step += 1
        return total * (high - low)


class _Middle:
    """A sampler that always says one half."""

    def next_2d(self, active: Any = True) -> Any:  # a sampler's signature
        return backend.mitsuba().Point2f(0.5)


def _representative(block: np.ndarray) -> np.ndarray:
    """One row for all rows of a lamp."""
    light = block["colour"].sum(axis=1)
    row = block[int(np.argmax(light))].copy()
    if len(block) == 1:
        return row
    row["colour"] = block["colour"].sum(axis=0)
    if row["is_beam"] > 0.5:  # the channels of one table
        return row
    share = light / light.sum()
    row["position"] = share @ (block["position"] + (block["edge_u"] + block["edge_v"]) / 3.0)
    axis = share @ block["axis"]
    lean = float(np.linalg.norm(axis))
    if lean < 0.5:  # it shines all around
        row["axis"], row["colour"], row["cutoff"], row["slope"], row["is_beam"] = (
            (0.0, 0.0, 1.0),
            row["colour"] / 4.0,
            *EVERYWHERE,
            1.0,
        )
    else:
        row["axis"] = axis / lean
    return row

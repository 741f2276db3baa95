"""Where light that was scattered more than once comes from: the neighbourhood of lamps.

A path towards the dark that the fog scatters into a beam by chance is the firefly of
every foggy night.  So distances on the eye's segment and directions after a
scattering are drawn, half of them, towards lamps: distances equiangularly (Kulla
and Fajardo 2012), directions with the density that light scattered once more has
around a lamp, 1 / sin(theta) times the share of the phase function beyond theta.
The other half is drawn as ever; the weight is that of the mixture (Veach and
Guibas 1995, one-sample balance heuristic), so nothing is ever brighter than twice.
A lamp with a table of its light sends what the table has, or what the fog scatters out of
its brightest parts, whichever is more; like a cone, in nodes of 6 degrees.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from synfog_usd.render import backend
from synfog_usd.render.lights import photometric
from synfog_usd.render.lights.rows import Columns, SummaryRow, summaries
from synfog_usd.render.media.medium import Medium

if TYPE_CHECKING:
    from synfog_usd.render.lights.sampler import LightSampler

MOST = 10
"""Lights that are aimed at; the brightest as seen from the camera where there are more."""

GUIDE_PROBABILITY = 0.5
"""Share of distances and directions that are drawn towards lamps."""

EVENLY = 0.3
"""Share of the draws towards lamps that take any lamp alike: whatever hides or dims the favourite."""

FLOOR = 1e-3
"""Least part of a lamp's peak that it is taken to send anywhere."""

NEAR_M = 0.3
"""Lights are taken to be this far at least."""

ANGLES = 512

NODES = (31, 60)
"""Of a table: angles off a lamp's axis, and around it."""


class LightGuide:
    """The lamps of a scene, one row each.

    Args:
        lights: the scene's.
        medium: the fog.
        eye: (3,) position of the camera [m].
    """

    def __init__(self, lights: LightSampler, medium: Medium, eye: np.ndarray) -> None:
        rows = summaries(lights.rows)
        rows = rows[rows["peak"] > 0.0]
        apart = ((rows["position"] - eye) ** 2).sum(axis=1) + 25.0
        rows = rows[np.argsort(-rows["peak"] / apart, kind="stable")[:MOST]]
        self.count = len(rows) if medium.foggy else 0
        if not self.count:
            return
        mi = backend.mitsuba()
        self.number = dr.opaque(mi.UInt32, self.count)
        nodes = np.concatenate([[0.0], np.geomspace(1e-3, np.pi, ANGLES - 1)])
        value = np.array(medium.phase.value(backend.floats(np.cos(nodes))), dtype=np.float64)
        steps = 0.5 * (value[1:] + value[:-1]) * np.diff(nodes)
        beyond = np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
        beyond = np.maximum(beyond, 1e-3 * beyond[0])
        self.around = mi.IrregularContinuousDistribution(
            mi.Float(nodes.astype(np.float32)), mi.Float(beyond.astype(np.float32))
        )
        has_table = rows["table"] >= 0.0
        self.tabled = lights.photometric and bool(has_table.any())
        if self.tabled:
            used = np.unique(rows["table"][has_table]).astype(int)
            share = np.interp(np.clip(_between_nodes(), 0.05, np.pi), nodes, beyond) / np.interp(0.05, nodes, beyond)
            self.light = photometric.Tables([_spread(lights.tables[number], share) for number in used])
            rows["table"][has_table] = np.searchsorted(used, rows["table"][has_table])
        self.lamps = Columns(rows, SummaryRow, tabled=self.tabled)
        self.scattered_scale = 1.0 / self.around.eval_pdf_normalized(mi.Float(0.05))
        dr.make_opaque(self.scattered_scale)

    def _sent(self, lamp: SummaryRow, towards: Any) -> Any:
        """Peak of a lamp times its share in a direction away from it, and beside its beam what the fog scatters out of
        it.
        """
        mi = backend.mitsuba()
        cosine = dr.dot(lamp.axis, towards)
        beside = dr.acos(dr.clip(cosine, -1.0, 1.0)) - lamp.cutoff
        beam = dr.clip(-beside * lamp.slope, 0.0, 1.0)
        scattered = self.around.eval_pdf_normalized(dr.clip(beside, 0.05, dr.pi)) * self.scattered_scale
        sent = dr.select(lamp.is_beam > 0.5, dr.maximum(beam, scattered), dr.maximum(cosine, 0.05))
        if self.tabled:
            axis, x = lamp.axis, lamp.table_x
            local = mi.Vector3f(dr.dot(x, towards), dr.dot(dr.cross(axis, x), towards), cosine)
            known = lamp.table >= 0.0
            sent = dr.select(known, self.light.at(mi.UInt32(dr.maximum(lamp.table, 0.0)), local, known), sent)
        return lamp.peak * (FLOOR + sent)

    @dr.syntax
    def distance(
        self, origin: Any, direction: Any, begin: Any, end: Any, sigma: Any, u_which: Any, u_along: Any
    ) -> Any:
        """A distance [m] on a stretch, drawn towards a lamp."""
        mi = backend.mitsuba()
        even, u = _evenly(u_which)
        index, total, kept = mi.UInt32(0), mi.Float(0.0), mi.Float(0.0)
        while index < self.number:
            lamp = self.lamps.at(index)
            nearest, height, low, high = _angles(lamp.position, origin, direction, begin, end)
            weight = dr.select(
                even, 1.0, self._along(lamp, origin, direction, nearest, height, low, high, begin, end, sigma)
            )
            total += weight
            share = weight / dr.maximum(total, 1e-30)
            taken = u < share
            u = dr.clip(
                dr.select(taken, u / dr.maximum(share, 1e-30), (u - share) / dr.maximum(1.0 - share, 1e-30)),
                0.0,
                0.9999999,
            )
            kept = dr.select(taken, nearest + height * dr.tan(dr.lerp(low, high, u_along)), kept)
            index += 1
        return dr.clip(kept, begin, end)

    @dr.syntax
    def distance_density(self, origin: Any, direction: Any, begin: Any, end: Any, sigma: Any, distance: Any) -> Any:
        """Density [1/m] of `distance`."""
        mi = backend.mitsuba()
        index, total, density, alike = mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
        while index < self.number:
            lamp = self.lamps.at(index)
            nearest, height, low, high = _angles(lamp.position, origin, direction, begin, end)
            weight = self._along(lamp, origin, direction, nearest, height, low, high, begin, end, sigma)
            total += weight
            step = distance - nearest
            one = height / (dr.maximum(high - low, 1e-9) * (height * height + step * step))
            density += weight * one
            alike += one
            index += 1
        return (1.0 - EVENLY) * density / dr.maximum(total, 1e-30) + EVENLY * alike / self.number

    def _along(
        self,
        lamp: SummaryRow,
        origin: Any,
        direction: Any,
        nearest: Any,
        height: Any,
        low: Any,
        high: Any,
        begin: Any,
        end: Any,
        sigma: Any,
    ) -> Any:
        """How much a lamp matters on a stretch: its light at the nearest point, times the stretch's angle."""
        place = origin + direction * dr.clip(nearest, begin, end)
        between = place - lamp.position
        away = dr.maximum(dr.norm(between), NEAR_M)
        return (
            self._sent(lamp, between / away)
            * (high - low)
            / height
            * dr.exp(-sigma * (away + dr.clip(nearest, begin, end) - begin))
        )

    @dr.syntax
    def direction(self, place: Any, sigma: Any, u_which: Any, u: Any) -> Any:
        """A direction from a point, drawn towards a lamp."""
        mi = backend.mitsuba()
        even, v = _evenly(u_which)
        index, total = mi.UInt32(0), mi.Float(0.0)
        axis = mi.Vector3f(0.0, 0.0, 1.0)
        while index < self.number:
            weight, towards = self._seen(self.lamps.at(index), place, sigma)
            weight = dr.select(even, 1.0, weight)
            total += weight
            share = weight / dr.maximum(total, 1e-30)
            taken = v < share
            v = dr.clip(
                dr.select(taken, v / dr.maximum(share, 1e-30), (v - share) / dr.maximum(1.0 - share, 1e-30)),
                0.0,
                0.9999999,
            )
            axis = dr.select(taken, towards, axis)
            index += 1
        angle = self.around.sample(u.x)
        sine, cosine = dr.sincos(angle)
        sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * u.y)
        return mi.Frame3f(axis).to_world(mi.Vector3f(sine * cos_phi, sine * sin_phi, cosine))

    @dr.syntax
    def direction_density(self, place: Any, sigma: Any, direction: Any) -> Any:
        """Density [1/sr] of `direction`."""
        mi = backend.mitsuba()
        index, total, density, alike = mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
        while index < self.number:
            weight, towards = self._seen(self.lamps.at(index), place, sigma)
            total += weight
            sine = dr.norm(dr.cross(towards, direction))
            angle = dr.atan2(sine, dr.dot(towards, direction))
            one = self.around.eval_pdf_normalized(angle) / (2.0 * dr.pi * dr.maximum(sine, 1e-6))
            density += weight * one
            alike += one
            index += 1
        return (1.0 - EVENLY) * density / dr.maximum(total, 1e-30) + EVENLY * alike / self.number

    def _seen(self, lamp: SummaryRow, place: Any, sigma: Any) -> tuple[Any, Any]:
        between = lamp.position - place
        away = dr.maximum(dr.norm(between), 1e-4)
        towards = between / away
        far = dr.maximum(away, NEAR_M)
        return self._sent(lamp, -towards) * dr.exp(-sigma * far) / (far * far), towards


def _evenly(u: Any) -> tuple[Any, Any]:
    """(whether to take any lamp alike, the random number anew)."""
    even = u < EVENLY
    return even, dr.select(even, u / EVENLY, (u - EVENLY) / (1.0 - EVENLY))


def _angles(lamp: Any, origin: Any, direction: Any, begin: Any, end: Any) -> tuple[Any, Any, Any, Any]:
    """Nearest point and distance of a ray to a lamp, and the angles under which it sees both ends of a stretch."""
    nearest = dr.dot(lamp - origin, direction)
    height = dr.maximum(dr.norm(lamp - (origin + direction * nearest)), 1e-3)
    return nearest, height, dr.atan((begin - nearest) / height), dr.atan((end - nearest) / height)


def _between_nodes() -> np.ndarray:
    """(N, N) angles [rad] between the directions of all nodes of a table."""
    rows, columns = NODES
    polar, around = np.arange(rows)[:, None] * np.pi / (rows - 1), np.arange(columns)[None] * 2.0 * np.pi / columns
    way = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar) + 0.0 * around], axis=-1
    ).reshape(-1, 3)
    return np.arccos(np.clip(way @ way.T, -1.0, 1.0))


def _spread(table: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A table at `NODES`: the most that it has up to the next nodes, or (N, N) `share` of what it has elsewhere,
    whichever is more.
    """
    rows, columns = NODES
    high = np.empty(NODES)
    polar, around = np.linspace(0.0, rows - 1.0, table.shape[0]), np.arange(table.shape[1]) * columns / table.shape[1]
    for row in range(rows):
        ring = table[np.abs(polar - row) <= 1.0].max(axis=0)
        for column in range(columns):
            apart = np.abs((around - column + columns / 2) % columns - columns / 2)
            high[row, column] = ring[apart <= 1.0].max() if table.shape[1] >= columns else ring.max()
    high[0], high[-1] = high[0].max(), high[-1].max()
    return np.asarray((high.ravel()[None] * share).max(axis=1).reshape(NODES))

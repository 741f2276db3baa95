"""The light sampler: which lamp, and where on it, a point or a segment of a path asks for light.

Resampled importance sampling (Talbot et al. 2005): every lamp gives candidates, one of them is kept in proportion to
what it would send, and only that one costs a shadow ray.  On a segment in fog a lamp gives two candidates.  One
scatters at a distance drawn evenly over the angle at the lamp (Kulla and Fajardo 2012), the other at one drawn by the
forward peak of the phase function; their density is that of the mixture.  So the 1/r^2 beside a lamp, transmittance,
phase function and choice of the lamp add no noise; what is left is shadow.  Unbiased.  Lamps are rows of numbers, see
`rows`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.render import backend
from synfog_usd.render.lights import photometric
from synfog_usd.render.lights.rows import (
    Columns,
    LampRow,
    channels,
    is_sampled_light,
    lamp_rows,
    luminous_peak,
    middles,
)
from synfog_usd.render.sampling.reservoir import PICKS, Candidate, Picks, Reservoir

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Color3f, Point3f, Vector3f

    from synfog_usd.render.media.medium import Medium
    from synfog_usd.render.sampling.sobol import Sobol

MOST = 12
"""Lights that are all asked."""

MOST_WEIGHED = 240
"""Lamps that are all weighed for each stretch and point; of more, some are drawn by flux and peak."""

LONGEST_M = 6.0
"""Extent of a lit mesh [m] from which on it is several lamps: beside one end of it, its middle tells nothing."""


class LightSampler:
    """Every spot, point and evenly lit mesh face of a scene.

    Args:
        world: a scene's parts, see `SceneDict.world`.
        groups: key -> number of the light group; 0 where it is not there.
        mean_cosine: of the phase function of the fog.
    """

    def __init__(self, world: Mapping[str, Any], groups: Mapping[str, int], mean_cosine: float = 0.87) -> None:
        self.tables: list[np.ndarray] = []
        numbers: dict[tuple[Any, ...], int] = {}
        blocks: dict[str, np.ndarray] = {}
        for key, part in world.items():
            if is_sampled_light(part):
                blocks[key] = block = lamp_rows(part)
                block["group"] = groups.get(key, 0)
                if part["type"] == photometric.TYPE:
                    block["table"] = [self._number_of(table, numbers) for table in channels(part)]
        parts = _cut_long({key: block for key, block in blocks.items() if luminous_peak(block).any()})
        self.keys = [key for key, _ in parts]
        self.row_numbers = [numbers for _, numbers in parts]
        self.rows = rows = [blocks[key][numbers] for key, numbers in parts]
        self.count = len(rows)
        if not self.count:
            return
        mi = backend.mitsuba()
        self.faces = mi.DiscreteDistribution(
            backend.floats(np.concatenate([luminous_peak(block) / luminous_peak(block).sum() for block in rows]))
        )
        self.photometric = bool(self.tables)
        self.columns = Columns(np.concatenate(rows), LampRow, tabled=self.photometric)
        self.light = photometric.Tables(self.tables) if self.photometric else None
        self.begin = backend.floats(np.arange(self.count) / self.count)  # each lamp's share of the faces' distribution
        self.share = dr.opaque(mi.Float, 1.0 / self.count)
        weights = np.array([luminous_peak(block).max() * np.sqrt(block["solid_angle"][0]) for block in rows])
        self.choice = mi.DiscreteDistribution(backend.floats(weights))
        g = min(max(abs(mean_cosine), 0.2), 0.99)
        self.width = dr.opaque(mi.Float, (1.0 - g) / np.sqrt(g))  # of Henyey and Greenstein's peak [rad]
        self.many = self.count > MOST
        self.asked = dr.opaque(mi.UInt32, PICKS if self.many else self.count)
        dr.make_opaque(self.begin)

    def _number_of(self, table: np.ndarray, numbers: dict[tuple[Any, ...], int]) -> int:
        """Number of a table among all; lamps of one make share one."""
        key = (table.shape, hashlib.sha256(table.tobytes()).digest())
        if key not in numbers:
            numbers[key] = len(self.tables)
            self.tables.append(table)
        return numbers[key]

    def _candidate(
        self, number: UInt32, sampler: Sobol, active: Bool, picks: Picks | None = None
    ) -> tuple[Point3f, LampRow, Float]:
        """A point on a lamp: (position, its row, its probability among all that could have been asked)."""
        mi = backend.mitsuba()
        probability = mi.Float(1.0)
        if self.many:
            number, probability = self._pick(number, sampler, active, picks)
            probability = probability * self.asked
        at = (
            dr.gather(mi.Float, self.begin, number, active)
            + dr.clip(sampler.next_1d(active), 1e-5, 0.99999) * self.share
        )
        index = self.faces.sample(at, active)
        probability = probability * self.faces.eval_pmf_normalized(index, active) / self.share
        row = self.columns.at(index, active)
        u = sampler.next_2d(active)
        root = dr.sqrt(u.x)
        position = mi.Point3f(row.position) + row.edge_u * (1.0 - root) + row.edge_v * (u.y * root)
        return position, row, probability

    def _pick(self, number: UInt32, sampler: Sobol, active: Bool, picks: Picks | None) -> tuple[UInt32, Float]:
        """One of many lamps, and its probability."""
        if picks is not None:
            return picks.at(number)
        return self.choice.sample_pmf(sampler.next_1d(active), active)

    def sent(self, row: LampRow, direction: Vector3f) -> Float:
        """Intensity in a direction away from the lamp, as a share of the row's colour."""
        mi = backend.mitsuba()
        cosine = dr.dot(row.axis, direction)
        beam = dr.clip((row.cutoff - dr.acos(dr.clip(cosine, -1.0, 1.0))) * row.slope, 0.0, 1.0)
        sent = dr.select(row.is_beam > 0.5, beam, dr.maximum(cosine, 0.0))
        if self.light is None or row.table is None or row.table_x is None:
            return sent
        tabled = row.table >= 0.0
        axis, x = row.axis, row.table_x
        local = mi.Vector3f(dr.dot(x, direction), dr.dot(dr.cross(axis, x), direction), cosine)
        return dr.select(tabled, self.light.at(mi.UInt32(dr.maximum(row.table, 0.0)), local, tabled), sent)

    @dr.syntax
    def along(
        self,
        origin: Point3f,
        direction: Vector3f,
        begin: Float,
        end: Float,
        medium: Medium,
        sampler: Sobol,
        active: Bool,
        picks: Picks | None = None,
    ) -> tuple[Point3f, Point3f, Color3f, UInt32]:
        """One lamp's light scattered once along a stretch of a ray.

        Args:
            origin, direction: the ray.
            begin, end: the stretch, as distances [m].
            medium: the fog.
            picks: where there are many, those that are drawn (`Importance`); None to draw by flux and peak.

        Returns:
            where it scatters, where the lamp is, colour such that colour x transmittance
            to the lamp x visibility estimates the integral over the stretch, and the lamp's group.
        """
        mi = backend.mitsuba()
        active = active & (end > begin)
        reservoir, index = Reservoir(), mi.UInt32(0)
        while active & (index < self.asked):
            lamp, row, probability = self._candidate(index, sampler, active, picks)
            nearest = dr.dot(mi.Vector3f(lamp - origin), direction)
            height = dr.maximum(dr.norm(lamp - (origin + direction * nearest)), 1e-4)
            # the angle by which light must turn grows along the ray from 0 to pi
            low, high = (0.5 * dr.pi + dr.atan((edge - nearest) / height) for edge in (begin, end))
            low_share, high_share = _peak_share(low, self.width), _peak_share(high, self.width)
            for by_angle in (True, False):
                u = sampler.next_1d(active)
                angle = (
                    dr.lerp(low, high, u) if by_angle else _of_peak_share(dr.lerp(low_share, high_share, u), self.width)
                )
                distance = dr.clip(nearest + height * dr.tan(angle - 0.5 * dr.pi), begin, end)
                step = distance - nearest
                turn = 0.5 * dr.pi + dr.atan(step / height)
                even = 1.0 / dr.maximum(high - low, 1e-9)
                peaked = _peak_density(turn, self.width) / dr.maximum(high_share - low_share, 1e-12)
                density = (even + peaked) * height / (height * height + step * step)
                place = origin + direction * distance
                between = mi.Vector3f(place - lamp)
                square = dr.maximum(dr.squared_norm(between), 1e-8)
                towards = between * dr.rsqrt(square)
                through = dr.exp(-medium.optical_depth_inside(origin, direction, begin, distance))
                strength = self.sent(row, towards) * medium.phase_value(place, -dr.dot(towards, direction))
                value = row.colour * (strength * through * medium.scattering(place) / square)
                dimmed = mi.luminance(value) * dr.exp(-medium.media[0].mean_sigma_t * dr.sqrt(square))
                candidate = Candidate(place, lamp, value, row.group, dimmed)
                reservoir = reservoir.update(candidate, density * probability, sampler, active)
            index += 1
        return reservoir.place, reservoir.lamp, reservoir.estimate(), mi.UInt32(reservoir.group)

    @dr.syntax
    def at(
        self,
        place: Point3f,
        response: Callable[[Vector3f], Float],
        sampler: Sobol,
        active: Bool,
        picks: Picks | None = None,
    ) -> tuple[Point3f, Color3f, UInt32, Float]:
        """One lamp's light on a point.

        Args:
            place: the point.
            response: what a surface there makes of light from a unit direction towards it, in short.
            picks: as in `along`.

        Returns:
            where the lamp is; its irradiance across the ray (no cosine at the point) over its probability, without
            visibility and fog; its group; and how many points of a lit face were to be expected per solid angle [1/sr]
            around this one, 0 for a lamp that is a point.
        """
        mi = backend.mitsuba()
        reservoir, index = Reservoir(), mi.UInt32(0)
        while active & (index < self.asked):
            lamp, row, probability = self._candidate(index, sampler, active, picks)
            between = mi.Vector3f(place - lamp)
            square = dr.maximum(dr.squared_norm(between), 1e-8)
            towards = between * dr.rsqrt(square)
            value = row.colour * (self.sent(row, towards) / square)
            double_area, cosine = dr.norm(dr.cross(row.edge_u, row.edge_v)), dr.dot(row.axis, towards)
            pdf = dr.select(
                (row.is_beam > 0.5) | (cosine <= 1e-6),
                0.0,
                probability * 2.0 * square / dr.maximum(double_area * cosine, 1e-20),
            )
            candidate = Candidate(place, lamp, value, row.group, mi.luminance(value) * response(-towards), pdf)
            reservoir = reservoir.update(candidate, probability, sampler, active)
            index += 1
        return reservoir.lamp, reservoir.estimate(), mi.UInt32(reservoir.group), reservoir.pdf


def _cut_long(blocks: Mapping[str, np.ndarray]) -> list[tuple[str, Indices]]:
    """(key, numbers of rows that shine) of each lamp: a long mesh of many, such as the lights of a tunnel, is several,
    as long as they are few enough to be weighed; the brightest first.
    """
    parts = {key: [np.flatnonzero(luminous_peak(block) > 0.0)] for key, block in blocks.items()}
    room = MOST_WEIGHED - len(parts)
    for key in sorted(blocks, key=lambda key: -float(luminous_peak(blocks[key]).sum())):
        several = _halves(middles(blocks[key]), *parts[key])
        if len(several) - 1 <= room:
            parts[key], room = several, room - len(several) + 1
    return [(key, numbers) for key in blocks for numbers in parts[key]]


def _halves(middle: Array, numbers: Indices) -> list[Indices]:
    """Faces, by their middles (F, 3) and numbers (N,), cut in the middle until none of the parts is too long."""
    low, high = middle[numbers].min(axis=0), middle[numbers].max(axis=0)
    axis = int((high - low).argmax())
    behind = middle[numbers, axis] > 0.5 * (low + high)[axis]
    if not high[axis] - low[axis] > LONGEST_M or not behind.any():  # which holds of places that are no numbers too
        return [numbers]
    return [*_halves(middle, numbers[~behind]), *_halves(middle, numbers[behind])]


def _peak_density(angle: Float, width: Float) -> Float:
    """Density over an angle that falls like a forward peak, (width^2 + angle^2)^-1.5; over 0 to infinity it is 1."""
    square = width * width + angle * angle
    return width * width / (square * dr.sqrt(square))


def _peak_share(angle: Float, width: Float) -> Float:
    """Its integral from 0 on."""
    return angle * dr.rsqrt(width * width + angle * angle)


def _of_peak_share(share: Float, width: Float) -> Float:
    return width * share * dr.rsqrt(dr.maximum(1.0 - share * share, 1e-7))

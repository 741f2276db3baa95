"""Lamps as a path tracer wants them: by where they matter, not one in a hundred by chance.

Spots, points and lit mesh faces are held as arrays.  For a stretch of a ray in fog,
or a point on a surface, a few candidates are drawn, weighed by the light that they
would send there if nothing stood between, and one of them is kept (resampled
importance sampling, Talbot et al. 2005).  Along a ray the distance of a candidate is
drawn equiangularly (Kulla and Fajardo 2012), which takes the 1/r^2 beside a lamp
out of the noise.  Both are unbiased.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import numpy as np

from synfog_usd.constants import LUMINANCE_WEIGHTS_REC709
from synfog_usd.render import backend

CANDIDATES = 4
"""Measured at dusk in the shipped crossing, 1 / (variance x time): 1, 2 and 4 alike, 8 a tenth worse."""

SPOT_BEAM = 0.75
"""Mitsuba's share of the cutoff within which a spot is even, where none is given."""


def is_handled(part: Any) -> bool:
    """Whether a shape or light of a scene is one that `Lamps` holds."""
    if not isinstance(part, Mapping):
        return False
    if part.get("type") in ("spot", "point"):
        return "texture" not in part
    emitter = part.get("emitter")
    return part.get("type") == "mesh" and isinstance(emitter, Mapping) and emitter.get("radiance", {}).get("type") == "rgb"


class Lamps:
    """Every spot, point and evenly lit mesh face of a scene.

    Args:
        world: a scene's parts, see `SceneDict.world`.
    """

    def __init__(self, world: Mapping[str, Any]) -> None:
        rows: list[np.ndarray] = []
        for part in world.values():
            if is_handled(part):
                rows.append(_faces(part) if part["type"] == "mesh" else _beam(part))
        table = np.concatenate(rows) if rows else np.zeros((0, _COLUMNS))
        weight = np.concatenate([_weights(block) for block in rows]) if rows else np.zeros(0)
        table = table[weight > 0.0]
        self.count = len(table)
        if not self.count:
            return
        mi = backend.mitsuba()
        self.choice = mi.DiscreteDistribution(mi.Float(weight[weight > 0.0].astype(np.float32)))
        self.table = [mi.Float(column.astype(np.float32)) for column in table.T[:18]]
        dr.make_opaque(self.table)

    def _row(self, index: Any, active: Any) -> list[Any]:
        return [dr.gather(type(column), column, index, active) for column in self.table]

    def _candidate(self, sampler: Any, active: Any) -> tuple[Any, Any, Any, Any]:
        """A point on a lamp: (position, its row, probability of its lamp, whether it is there)."""
        mi = backend.mitsuba()
        index, probability = self.choice.sample_pmf(sampler.next_1d(active), active)
        row = self._row(index, active)
        u = sampler.next_2d(active)
        root = dr.sqrt(u.x)
        position = mi.Point3f(*row[0:3]) + mi.Vector3f(*row[3:6]) * (1.0 - root) + mi.Vector3f(*row[6:9]) * (u.y * root)
        return position, row, probability, active

    def _sent(self, row: list[Any], direction: Any) -> Any:
        """Intensity in a direction away from the lamp, as a share of the row's colour."""
        mi = backend.mitsuba()
        cosine = dr.dot(mi.Vector3f(*row[9:12]), direction)
        beam = dr.clip((row[15] - dr.acos(dr.clip(cosine, -1.0, 1.0))) * row[16], 0.0, 1.0)
        return dr.select(row[17] > 0.5, beam, dr.maximum(cosine, 0.0))

    def along(self, origin: Any, direction: Any, begin: Any, end: Any, phase: Any, sigma_t: Any, sampler: Any, active: Any) -> tuple[Any, Any, Any]:
        """One lamp's light scattered once along a stretch of a ray.

        Args:
            origin, direction: the ray.
            begin, end: the stretch, as distances [m].
            phase: function of the cosine between the directions of travel [1/sr].
            sigma_t: extinction [1/m], for the weighing only.

        Returns:
            where it scatters, where the lamp is, and colour such that colour x sigma_s x
            transmittance to the lamp x visibility estimates the integral over the stretch.
        """
        mi = backend.mitsuba()
        active = active & (end > begin)
        kept = _Reservoir(mi)
        for _ in range(CANDIDATES):
            lamp, row, probability, ok = self._candidate(sampler, active)
            nearest = dr.dot(lamp - origin, direction)
            height = dr.maximum(dr.norm(lamp - (origin + direction * nearest)), 1e-4)
            low, high = dr.atan((begin - nearest) / height), dr.atan((end - nearest) / height)
            step = height * dr.tan(dr.lerp(low, high, sampler.next_1d(active)))
            distance = dr.clip(nearest + step, begin, end)
            density = height / ((high - low) * (height * height + step * step))
            place = origin + direction * distance
            between = place - lamp
            square = dr.maximum(dr.squared_norm(between), 1e-8)
            towards = between * dr.rsqrt(square)
            strength = self._sent(row, towards) * phase(-dr.dot(towards, direction)) / square
            value = mi.Color3f(*row[12:15]) * strength
            kept.offer(place, lamp, value, mi.luminance(value) * dr.exp(-sigma_t * dr.sqrt(square)), density * probability, sampler, ok)
        return kept.place, kept.lamp, kept.result()

    def at(self, place: Any, normal: Any, sampler: Any, active: Any) -> tuple[Any, Any]:
        """One lamp's light on a point.

        Returns:
            where the lamp is, and its irradiance across the ray (no cosine at the
            point) divided by its probability, without visibility and fog.
        """
        mi = backend.mitsuba()
        kept = _Reservoir(mi)
        for _ in range(CANDIDATES):
            lamp, row, probability, ok = self._candidate(sampler, active)
            between = place - lamp
            square = dr.maximum(dr.squared_norm(between), 1e-8)
            towards = between * dr.rsqrt(square)
            value = mi.Color3f(*row[12:15]) * (self._sent(row, towards) / square)
            kept.offer(place, lamp, value, mi.luminance(value) * (dr.abs(dr.dot(towards, normal)) + 1e-3), probability, sampler, ok)
        return kept.lamp, kept.result()


def _weights(rows: np.ndarray) -> np.ndarray:
    """How often the faces of one lamp are drawn: by its flux and its peak, shared among its faces by their light."""
    peak = np.maximum(rows[:, 12:15] @ LUMINANCE_WEIGHTS_REC709, 0.0)
    return peak * np.sqrt(rows[0, 18])


class _Reservoir:
    """One of several weighted candidates, as they come."""

    def __init__(self, mi: Any) -> None:
        self.place, self.lamp, self.value = mi.Point3f(0.0), mi.Point3f(0.0), mi.Color3f(0.0)
        self.target, self.sum = mi.Float(0.0), mi.Float(0.0)

    def offer(self, place: Any, lamp: Any, value: Any, target: Any, density: Any, sampler: Any, active: Any) -> None:
        weight = dr.select(active & (density > 0.0) & (target > 0.0), target / density, 0.0)
        self.sum = self.sum + weight
        taken = sampler.next_1d(active) * self.sum < weight
        self.place, self.lamp, self.value = dr.select(taken, place, self.place), dr.select(taken, lamp, self.lamp), dr.select(taken, value, self.value)
        self.target = dr.select(taken, target, self.target)

    def result(self) -> Any:
        return dr.select(self.target > 0.0, self.value * (self.sum / (CANDIDATES * self.target)), 0.0)


_COLUMNS = 19
"""0-2 corner, 3-5 and 6-8 edges, 9-11 axis or normal, 12-14 colour [cd] (radiance x area of a face), 15 cutoff [rad], 16 1 / transition [1/rad], 17 is a spot,
18 solid angle that it shines into."""


def _faces(mesh: Mapping[str, Any]) -> np.ndarray:
    corners = np.asarray(mesh["positions"], dtype=np.float64)[np.asarray(mesh["faces"], dtype=np.int64)]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    double_area = np.linalg.norm(normal, axis=1)
    rows = np.zeros((len(corners), _COLUMNS))
    rows[:, 0:3], rows[:, 3:6], rows[:, 6:9] = corners[:, 0], one, other
    rows[:, 9:12] = normal / np.maximum(double_area, 1e-30)[:, None]
    rows[:, 12:15] = 0.5 * double_area[:, None] * np.asarray(mesh["emitter"]["radiance"]["value"], dtype=np.float64)
    rows[:, 18] = np.pi
    return rows


def _beam(light: Mapping[str, Any]) -> np.ndarray:
    row = np.zeros((1, _COLUMNS))
    matrix = np.asarray(light.get("to_world", np.eye(4)), dtype=np.float64)
    row[0, 0:3] = light["position"] if "position" in light else matrix[:3, 3]
    row[0, 9:12] = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    row[0, 12:15] = light["intensity"]["value"]
    if light["type"] == "spot":
        cutoff = np.radians(light.get("cutoff_angle", 20.0))
        beam = np.radians(light["beam_width"]) if "beam_width" in light else SPOT_BEAM * cutoff
        row[0, 15:17] = cutoff, 1.0 / max(cutoff - beam, 1e-6)
        row[0, 18] = 2.0 * np.pi * (1.0 - np.cos(0.5 * (cutoff + beam)))
    else:
        row[0, 15:17], row[0, 18] = 1e9, 1.0
        row[0, 18] = 4.0 * np.pi
    row[0, 17] = 1.0
    return row

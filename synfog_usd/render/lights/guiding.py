"""Where light that was scattered more than once comes from: the neighbourhood of lamps.

A path towards the dark that the fog scatters into a beam by chance is the firefly of
every foggy night.  So some distances on the eye's segment and some directions after a
scattering are drawn towards lamps: distances equiangularly (Kulla
and Fajardo 2012), directions with the density that light scattered once more has
around a lamp, 1 / sin(theta) times the share of the phase function beyond theta.
The others are drawn as ever; the weight is that of the mixture (Veach and
Guibas 1995, one-sample balance heuristic), so it never grows much.
How much a lamp matters to a place, `importance` tells.  The density is that of all lamps that are aimed at:
given only a few that were drawn first, a path that passed another one by chance weighed up to 100 times too much.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from synfog_usd.render import backend
from synfog_usd.render.lights.importance import ABREAST, Importance
from synfog_usd.render.media.medium import Medium

ANGLES, LEAST_RAD = 512, 1e-3
"""Nodes of a table over the angle, 0 and from the least on in equal ratios."""

MOST_GUIDED = 16
"""Lights that are aimed at; the brightest as seen from the camera where there are more."""

GUIDE_PROBABILITY = 0.5
"""Share of distances on the eye's segment that are drawn towards lamps."""

EVENLY = 0.3
"""Share of the draws towards lamps that take any lamp alike: whatever hides or dims the favourite."""


class LightGuide:
    """Distances and directions towards lamps.

    Args:
        importance: the lamps that are aimed at.
        medium: the fog.
    """

    def __init__(self, importance: Importance, medium: Medium) -> None:
        mi = backend.mitsuba()
        self.importance, self.count = importance, importance.count
        nodes = np.concatenate([[0.0], np.geomspace(LEAST_RAD, np.pi, ANGLES - 1)]).astype(np.float32)
        value = np.array(medium.phase.value(backend.floats(np.cos(nodes))), dtype=np.float64)
        steps = 0.5 * (value[1:] + value[:-1]) * np.diff(nodes)
        beyond = np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
        beyond = np.maximum(beyond, 1e-3 * beyond[0])
        density = beyond / np.sum(0.5 * (beyond[1:] + beyond[:-1]) * np.diff(nodes))
        self.around = mi.IrregularContinuousDistribution(backend.floats(nodes), backend.floats(density))
        self.lines = backend.floats(  # by interval: density = first + second x angle
            np.stack([density[:-1] - nodes[:-1] * (rise := np.diff(density) / np.diff(nodes)), rise], axis=1).ravel()
        )
        self.per_interval = dr.opaque(mi.Float, (ANGLES - 2) / np.log2(np.pi / LEAST_RAD))

    @dr.syntax
    def distance(self, origin: Any, direction: Any, begin: Any, end: Any, u_which: Any, u_along: Any) -> Any:
        """A distance [m] on a stretch, drawn towards a lamp."""
        mi = backend.mitsuba()
        even, u = _evenly(u_which)
        index, total, kept = mi.UInt32(0), mi.Float(0.0), mi.UInt32(0)
        while index < self.count:
            for number, there in self.importance.abreast(index):
                weight = dr.select(even, 1.0, self.importance.along(number, origin, direction, begin, end))
                total, kept, u = _drawn(number, dr.select(there, weight, 0.0), total, kept, u)
            index += ABREAST
        nearest, height, low, high = _angles(self.importance.place(kept), origin, direction, begin, end)
        return dr.clip(nearest + height * dr.tan(dr.lerp(low, high, u_along)), begin, end)

    @dr.syntax
    def distance_density(self, origin: Any, direction: Any, begin: Any, end: Any, distance: Any) -> Any:
        """Density [1/m] of `distance`."""
        mi = backend.mitsuba()
        index, total, density, alike = mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
        while index < self.count:
            for number, there in self.importance.abreast(index):
                weight = dr.select(there, self.importance.along(number, origin, direction, begin, end), 0.0)
                total += weight
                nearest, height, low, high = _angles(self.importance.place(number), origin, direction, begin, end)
                step = distance - nearest
                one = height / (dr.maximum(high - low, 1e-9) * (height * height + step * step))
                density += weight * one
                alike += dr.select(there, one, 0.0)
            index += ABREAST
        return (1.0 - EVENLY) * density / dr.maximum(total, 1e-30) + EVENLY * alike / self.count

    @dr.syntax
    def direction(self, place: Any, u_which: Any, u: Any) -> Any:
        """A direction from a point, drawn towards a lamp."""
        mi = backend.mitsuba()
        even, v = _evenly(u_which)
        index, total, kept = mi.UInt32(0), mi.Float(0.0), mi.UInt32(0)
        while index < self.count:
            for number, there in self.importance.abreast(index):
                weight = dr.select(even, 1.0, self._seen(number, place))
                total, kept, v = _drawn(number, dr.select(there, weight, 0.0), total, kept, v)
            index += ABREAST
        sine, cosine = dr.sincos(self.around.sample(u.x))
        sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * u.y)
        towards = _towards(self.importance.place(kept), place)
        return mi.Frame3f(towards).to_world(mi.Vector3f(sine * cos_phi, sine * sin_phi, cosine))

    @dr.syntax
    def direction_density(self, place: Any, direction: Any) -> Any:
        """Density [1/sr] of `direction`."""
        mi = backend.mitsuba()
        index, total, density, alike = mi.UInt32(0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
        while index < self.count:
            for number, there in self.importance.abreast(index):
                weight = dr.select(there, self._seen(number, place), 0.0)
                total += weight
                half = dr.clip(0.5 * dr.norm(direction - _towards(self.importance.place(number), place)), 1e-6, 1.0)
                angle, sine = 2.0 * dr.asin(half), 2.0 * half * dr.safe_sqrt(1.0 - half * half)
                nearest = mi.Int32(dr.log2(angle * (1.0 / LEAST_RAD)) * self.per_interval + 1.0)
                line = dr.gather(mi.Vector2f, self.lines, mi.UInt32(dr.clip(nearest, 0, ANGLES - 2)))
                one = (line.x + line.y * angle) / dr.maximum(sine, 1e-6)
                density += weight * one
                alike += dr.select(there, one, 0.0)
            index += ABREAST
        mixture = (1.0 - EVENLY) * density / dr.maximum(total, 1e-30) + EVENLY * alike / self.count
        return mixture * (0.5 * dr.inv_pi)

    def _seen(self, index: Any, place: Any) -> Any:
        return self.importance.at(index, place, lambda way: 1.0, True)


def _evenly(u: Any) -> tuple[Any, Any]:
    """(whether to take any lamp alike, the random number anew)."""
    even = u < EVENLY
    return even, dr.select(even, u / EVENLY, (u - EVENLY) / (1.0 - EVENLY))


def _drawn(index: Any, weight: Any, total: Any, kept: Any, u: Any) -> tuple[Any, Any, Any]:
    """(sum of weights, lamp that is kept, what is left of the random number) after one more lamp."""
    total = total + weight
    share = weight / dr.maximum(total, 1e-30)
    taken = u < share
    left = dr.select(taken, u / dr.maximum(share, 1e-30), (u - share) / dr.maximum(1.0 - share, 1e-30))
    return total, dr.select(taken, index, kept), dr.clip(left, 0.0, 0.9999999)


def _towards(lamp: Any, place: Any) -> Any:
    between = lamp - place
    return between / dr.maximum(dr.norm(between), 1e-4)


def _angles(lamp: Any, origin: Any, direction: Any, begin: Any, end: Any) -> tuple[Any, Any, Any, Any]:
    """Nearest point and distance of a ray to a lamp, and the angles under which it sees both ends of a stretch."""
    nearest = dr.dot(lamp - origin, direction)
    height = dr.maximum(dr.norm(lamp - (origin + direction * nearest)), 1e-3)
    return nearest, height, dr.atan((begin - nearest) / height), dr.atan((end - nearest) / height)

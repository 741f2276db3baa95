"""Single drops and flakes in the air near a camera: where each is, how fast and which way it goes.

Takes numbers by size and fall speeds; gives drops of a Poisson process that fall with time.  Knows nothing of pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.base.seeds import stream
from synfog_usd.fog.drops import FLAKE_DENSITY, Sizes, flake_diameter, rain_speed, snow_speed

NEAR_M, FAR_M = 0.25, 12.0
"""Distances between which drops are drawn [m]: nearer ones are wide veils out of focus, farther ones a veil of many."""

MARGIN_M = 0.4
"""How far beyond the edge of the view drops are kept, of which an exposure carries a part into it."""


CLASSES, SMALLEST_MM, LARGEST_MM = 48, 0.1, 6.0
"""Classes of size, and the drops of water between which they lie: smaller ones are mist, and larger ones break."""

LARGEST_FLAKE_MM = 10.0
"""Flakes up to which Locatelli and Hobbs measured, see `snow_speed`; what a distribution has beyond stays a veil."""

SWAY = 0.3
"""Speed to the side of a flake in terms of its fall speed: an estimate by films of unrimed flakes."""


@dataclass(frozen=True)
class SizeClasses:
    """How many drops of each size are in the air, and how they fall.

    Attributes:
        edges_m: (K + 1,) rising diameters between which the classes lie, as a camera sees them [m].
        per_m3: (K,) drops of each class [1/m3].
        speed_m_s: (K + 1,) fall speed of the diameters `edges_m` [m/s].
        sway: speed to the side in terms of the fall speed [1]; 0 for drops.
    """

    edges_m: Array
    per_m3: Array
    speed_m_s: Array
    sway: float = 0.0

    @classmethod
    def of_rain(cls, sizes: Sizes) -> SizeClasses:
        """Drops of rain."""
        edges, per_m3 = _numbers(sizes, LARGEST_MM)
        return cls(1e-3 * edges, per_m3, rain_speed(edges))

    @classmethod
    def of_snow(cls, sizes: Sizes) -> SizeClasses:
        """Flakes of dry snow, by the drops that they melt to."""
        edges, per_m3 = _numbers(sizes, (FLAKE_DENSITY * LARGEST_FLAKE_MM**2) ** (1.0 / 3.0))
        flakes = flake_diameter(edges)
        return cls(1e-3 * flakes, per_m3, snow_speed(flakes), SWAY)

    @property
    def area_m2(self) -> Array:
        """(K,) mean cross-section, of diameters that are even within a class."""
        low, high = self.edges_m[:-1], self.edges_m[1:]
        return np.asarray(math.pi / 12.0 * (low * low + low * high + high * high))

    def optical_depth(self, reach_m: Array, length_m: Array) -> Array:
        """What drops between `NEAR_M` and their reach cover of a line of sight, as an optical depth [1].

        Args:
            reach_m: (K,) distance within which a class is drawn.
            length_m: of the line of sight [m], any shape; infinite where nothing ends it.
        """
        total = np.zeros(np.shape(length_m))
        for reach, cover in zip(reach_m, self.per_m3 * self.area_m2, strict=True):
            total += cover * np.maximum(np.minimum(length_m, reach) - NEAR_M, 0.0)
        return total


@dataclass(frozen=True)
class Drops:
    """Drops at one moment.

    Attributes:
        place_m: (N, 3) from the camera, in the scene's axes with Z up [m].
        velocity_m_s: (N, 3) of the air's axes [m/s].
        diameter_m: (N,) [m].
        share: (N,) of the mean cross-section that a tumbling flake shows [1]; 1 for drops.
        turn_rad: (N,) of a flake about the line of sight [rad]; 0 for drops.
    """

    place_m: Array
    velocity_m_s: Array
    diameter_m: Array
    share: Array
    turn_rad: Array

    def __getitem__(self, keep: Flags) -> Drops:
        """Those for which (N,) `keep` holds."""
        return Drops(*(values[keep] for values in vars(self).values()))


@dataclass(frozen=True)
class Cone:
    """What part of space a camera looks into.

    Attributes:
        eye_m: (3,) its place on the stage [m], Z up.
        axis: (3,) unit direction of the middle of its picture.
        half_rad: angle from there to the farthest corner [rad].
    """

    eye_m: Array
    axis: Array
    half_rad: float

    def ball(self, reach_m: float) -> tuple[Array, float]:
        """Centre (3,) from the eye and radius [m] of a ball around all that is seen within a distance."""
        if self.half_rad < math.pi / 4.0:
            radius = 0.5 * reach_m / math.cos(self.half_rad)
            return self.axis * radius, radius
        if self.half_rad < math.pi / 2.0:
            return self.axis * (reach_m * math.cos(self.half_rad)), reach_m * math.sin(self.half_rad)
        return np.zeros(3), reach_m


def falling(sizes: SizeClasses, reach_m: Array, view: Cone, *, time_s: float, wind_m_s: Array, seed: int) -> Drops:
    """Drops in a view at a moment.

    Each class fills space with a Poisson process that repeats after the width of the view's ball, so that each place
    in the view is of one drop alone.  Every drop goes its own straight way, flakes in a spiral about it, so what is
    seen at one moment and at the next are the same drops.

    Args:
        sizes: how many there are.
        reach_m: (K,) distance within which a class is drawn [m].
        view: of the camera.
        time_s: the moment [s].
        wind_m_s: (3,) of the air [m/s].
        seed: of all cameras and all moments of a stage.

    Returns:
        Drops between `NEAR_M` and their reach, a margin around the view among them.
    """
    parts = [
        _of_class(sizes, index, reach, view, time_s, wind_m_s, seed)
        for index, reach in enumerate(reach_m)
        if reach > NEAR_M
    ]
    empty = Drops(np.zeros((0, 3)), np.zeros((0, 3)), *np.zeros((3, 0)))
    return replace(
        empty, **{name: np.concatenate([getattr(part, name) for part in [empty, *parts]]) for name in vars(empty)}
    )


def _of_class(
    sizes: SizeClasses, index: int, reach_m: float, view: Cone, time_s: float, wind_m_s: Array, seed: int
) -> Drops:
    centre, radius = view.ball(reach_m)
    period = 2.0 * (radius + MARGIN_M)
    rng = stream(seed, "drops", index)
    count = int(rng.poisson(sizes.per_m3[index] * period**3))
    place = rng.random((count, 3)) * period
    diameter = rng.uniform(sizes.edges_m[index], sizes.edges_m[index + 1], count)
    speed = np.interp(diameter, sizes.edges_m, sizes.speed_m_s)
    velocity = np.zeros((count, 3)) + wind_m_s
    velocity[:, 2] -= speed
    place += velocity * time_s
    share, turn = np.ones(count), np.zeros(count)
    if sizes.sway:
        rate, phase = rng.uniform(4.0, 12.0, count), rng.uniform(0.0, 2.0 * math.pi, count)
        angle = rate * time_s + phase
        aside = sizes.sway * speed
        place[:, 0] += aside / rate * np.sin(angle)
        place[:, 1] -= aside / rate * np.cos(angle)
        velocity[:, 0] += aside * np.cos(angle)
        velocity[:, 1] += aside * np.sin(angle)
        share += 0.4 * np.sin(2.0 * angle + rng.uniform(0.0, 2.0 * math.pi, count))
        turn = rng.uniform(0.0, math.pi, count)
    low = view.eye_m + centre - 0.5 * period
    place = (place - low) % period + (centre - 0.5 * period)
    distance = np.sqrt(np.einsum("ij,ij->i", place, place))
    ahead = place @ view.axis
    aside_m = np.sqrt(np.maximum(distance * distance - ahead * ahead, 0.0))
    in_view = aside_m * math.cos(view.half_rad) - ahead * math.sin(view.half_rad) < MARGIN_M
    drops = Drops(place, velocity, diameter, share, turn)
    return drops[(distance >= NEAR_M) & (distance < reach_m) & in_view]


def _numbers(sizes: Sizes, largest_mm: float) -> tuple[Array, Array]:
    """(K + 1,) diameters of water [mm] between the classes, and (K,) drops in each [1/m3], by Simpson's rule."""
    edges = np.geomspace(SMALLEST_MM, largest_mm, CLASSES + 1)
    ends, middles = sizes.density(edges), sizes.density(0.5 * (edges[1:] + edges[:-1]))
    return edges, np.diff(edges) * (ends[:-1] + 4.0 * middles + ends[1:]) / 6.0

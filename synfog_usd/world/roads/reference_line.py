"""The reference line of a road: straights, arcs and clothoids, with slopes.

Curvature is linear in length between knots: constant on straights and arcs,
growing on clothoids (Euler spirals).  The slope is linear between knots too, so
that crests and sags are parabolas, as roads are built.  Places are given by the
station s [m] along the line and the offset t [m], positive to its right (OpenDRIVE's t is
positive to the left); the line begins at the origin and goes to +Y.  Knows nothing of lanes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import spatial

from synfog_usd.base.arrays import Array

STEP_M = 0.25


@dataclass(frozen=True)
class ReferenceLine:
    """A reference line.

    Attributes:
        length: [m].
        curvature: (station [m], curvature [1/m]) knots; positive bends to the left.
        slope: (station [m], rise per length [1]) knots.
        start: height of its beginning [m].
        origin: (x, y) [m] and heading [degrees counter-clockwise from +Y] of its beginning.
    """

    length: float
    curvature: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    slope: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    start: float = 0.0
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @cached_property
    def _table(self) -> tuple[Array, Array, Array, Array, Array]:
        """Stations with x, y, heading [rad] and height there."""
        n = max(2, round(self.length / STEP_M) + 1)
        s = np.linspace(0.0, self.length, n)
        h = s[1] - s[0]

        def integral(ends: Array, middles: Array) -> Array:
            """Simpson's rule, cumulated."""
            return np.concatenate([[0.0], np.cumsum(h / 6 * (ends[:-1] + 4 * middles + ends[1:]))])

        middle = (s[:-1] + s[1:]) / 2
        at, value = np.array(self.curvature).T
        k, k_middle = np.interp(s, at, value), np.interp(middle, at, value)
        heading = np.deg2rad(self.origin[2]) + integral(k, k_middle)
        heading_middle = heading[:-1] + h / 24 * (5 * k[:-1] + 8 * k_middle - k[1:])
        x = self.origin[0] + integral(-np.sin(heading), -np.sin(heading_middle))
        y = self.origin[1] + integral(np.cos(heading), np.cos(heading_middle))
        at, value = np.array(self.slope).T
        z = self.start + integral(np.interp(s, at, value), np.interp(middle, at, value))
        return s, x, y, heading, z

    @cached_property
    def _tree(self) -> spatial.cKDTree:
        _, x, y, _, _ = self._table
        return spatial.cKDTree(np.c_[x, y])

    @property
    def tightest(self) -> float:
        """Radius of the sharpest bend [m], inf on a straight line."""
        most = max(abs(k) for _, k in self.curvature)
        return 1.0 / most if most else float("inf")

    def heading(self, s: npt.ArrayLike) -> Array:
        """Direction at stations [rad], counter-clockwise from +Y."""
        table = self._table
        return np.interp(np.asarray(s, dtype=np.float64), table[0], table[3])

    def height(self, s: npt.ArrayLike) -> Array:
        """Height of the line [m] at stations."""
        table = self._table
        return np.interp(np.asarray(s, dtype=np.float64), table[0], table[4])

    def grade(self, s: npt.ArrayLike) -> Array:
        """Rise per length [1] at stations."""
        at, value = np.array(self.slope).T
        return np.interp(np.asarray(s, dtype=np.float64), at, value)

    def place(self, s: npt.ArrayLike, t: npt.ArrayLike) -> tuple[Array, Array]:
        """(x, y) [m] of stations and offsets to the right; straight on beyond the ends."""
        s, t = np.broadcast_arrays(np.asarray(s, dtype=np.float64), np.asarray(t, dtype=np.float64))
        table = self._table
        within = np.clip(s, 0.0, self.length)
        over = s - within
        heading = self.heading(within)
        x = np.interp(within, table[0], table[1]) + t * np.cos(heading) - over * np.sin(heading)
        y = np.interp(within, table[0], table[2]) + t * np.sin(heading) + over * np.cos(heading)
        return x, y

    def nearest(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Array, Array]:
        """Station and offset of the nearest place of the line.

        Args:
            x, y: [m], equal shapes.

        Returns:
            s within the line, and t: its size is the distance, beyond the ends too.
        """
        points = np.stack(
            np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)), axis=-1
        )
        _, index = self._tree.query(points)
        s = self._table[0][index]
        knots, curvature = np.array(self.curvature).T
        for _ in range(3):  # Newton's method; one step along the line moves the foot by 1 + k t
            heading = self.heading(s)
            fx, fy = self.place(s, 0.0)
            dx, dy = points[..., 0] - fx, points[..., 1] - fy
            stretch = np.maximum(
                1.0 + np.interp(s, knots, curvature) * (dx * np.cos(heading) + dy * np.sin(heading)), 0.2
            )
            s = np.clip(
                s + np.clip((dy * np.cos(heading) - dx * np.sin(heading)) / stretch, -STEP_M, STEP_M), 0.0, self.length
            )
        heading = self.heading(s)
        fx, fy = self.place(s, 0.0)
        dx, dy = points[..., 0] - fx, points[..., 1] - fy
        side = np.where(dx * np.cos(heading) + dy * np.sin(heading) >= 0, 1.0, -1.0)
        return s, side * np.hypot(dx, dy)


def bends(pieces: list[tuple[float, float, float]], *, length: float) -> tuple[tuple[float, float], ...]:
    """Knots of curvature from bends, each entered and left on a clothoid.

    Args:
        pieces: (straight before it [m], radius [m], angle [degrees], positive to the left).
        length: of the whole line [m].  A clothoid is a third as long as its radius asks
            (A = R / 2 to R is usual), and an angle too small for it makes two clothoids.
    """
    knots, at = [(0.0, 0.0)], 0.0
    for straight, radius, degrees in pieces:
        if not degrees:
            at += straight
            continue
        angle = abs(np.deg2rad(degrees))
        k = np.sign(degrees) / radius
        spiral = min(radius / 4, radius * angle)  # each turns by spiral / (2 radius)
        arc = max(radius * angle - spiral, 0.0)
        at += straight
        for step, value in ((0.0, 0.0), (spiral, k), (arc, k), (spiral, 0.0)):
            at += step
            if at > knots[-1][0]:
                knots.append((round(float(at), 3), round(float(value), 9)))
            else:
                knots[-1] = (knots[-1][0], round(float(value), 9))
        if at > length:
            break
    return tuple(knots)

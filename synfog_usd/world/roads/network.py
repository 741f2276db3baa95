"""A road as one record: reference line, lane section, crossings and structures; its lanes, and the ground around it.

Everything that stands at the road is placed here: from a station and an offset to
x, y, z, heading and pitch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import stream
from synfog_usd.world.roads.lane_section import DRIVEN, Lane, LaneSection
from synfog_usd.world.roads.reference_line import ReferenceLine

BLEND_M = 55.0
"""Over which the land leaves the height of the road."""
WAVES = 9
VALLEY_SIDE_M, VALLEY_SIDES, RIVER = 14.0, 0.13, 0.68
"""A valley's slopes are so long at least, or this share of its length; its river is so broad a share."""
DITCH_M = (0.4, 1.6, 2.2, 4.2)
"""Where a ditch begins, its bottom from and to, and its end, beyond the road's edge."""
BEHIND_WALL_M = 0.35
CUTTING_M = 8.5
AT_PORTAL = 0.55
"""A hill stands behind the wall of its portal, at this share of its height; before it the road lies in a cutting with
slopes so wide.
"""


@dataclass(frozen=True)
class Land:
    """The land around.

    Attributes:
        hills_m: height of its hills, 0 for level land.
        seed: of the hills.
        valley: (from, to, depth) [m]: the road bridges a valley between two stations, or None.
        hill: (from, height) [m]: a hill begins at a station, into which the road goes, or None.
        ditch_m: depth of the ditch beyond each edge of the road.
    """

    hills_m: float = 0.0
    seed: int = 0
    valley: tuple[float, float, float] | None = None
    hill: tuple[float, float] | None = None
    ditch_m: float = 0.0


@dataclass(frozen=True)
class Road:
    """A road and the land around it.

    Attributes:
        reference_line, lane_section: where it runs and what lies across it.
        land: what lies beyond its edges.
        zebras: stations of the zebra crossings' middles [m].
        centre: marking between the directions: 'dashed', 'solid', 'double' or 'none'.
        dash: (mark, gap) of a dashed line [m].
        crossfall: fall per width [1] of what is paved, from the crown to the gutters.
    """

    reference_line: ReferenceLine
    lane_section: LaneSection
    land: Land = field(default_factory=Land)
    zebras: tuple[float, ...] = ()
    centre: str = "dashed"
    dash: tuple[float, float] = (3.0, 6.0)
    crossfall: float = 0.0

    @cached_property
    def driving_lanes(self) -> tuple[Lane, ...]:
        """Lanes that are driven on, from left to right."""
        return tuple(self.lane_section.of(*DRIVEN))

    def pose(self, s: float, t: float, *, way: int = 1) -> tuple[float, float, float, float, float]:
        """x, y, z [m], heading and pitch [degrees] of what stands at (s, t) and looks along the road, or against it."""
        x, y = self.reference_line.place(s, t)
        heading = math.degrees(float(self.reference_line.heading(s))) + (180.0 if way < 0 else 0.0)
        pitch = math.degrees(math.atan(float(self.reference_line.grade(s)))) * way
        return (
            round(float(x), 3),
            round(float(y), 3),
            round(float(self.ground(s, t)), 4),
            round((heading + 180.0) % 360.0 - 180.0, 3),
            round(pitch, 3),
        )

    def over_line(self, t: npt.ArrayLike, h: npt.ArrayLike = 0.0) -> Array:
        """Height over the reference line [m] of what lies h [m] over a carriageway level across."""
        return np.asarray(np.asarray(h, dtype=np.float64) - self.crossfall * self.lane_section.from_crown(t))

    def ground(self, s: npt.ArrayLike, t: npt.ArrayLike) -> Array:
        """Height of the ground [m] at stations and offsets, broadcast."""
        s, t = np.broadcast_arrays(np.asarray(s, dtype=np.float64), np.asarray(t, dtype=np.float64))
        out = np.maximum(t - self.lane_section.high, self.lane_section.low - t)
        on = self.reference_line.height(s) + self.over_line(t, self.lane_section.height(t))
        if np.all(out <= 0):
            return on
        x, y = self.reference_line.place(s, t)
        return np.where(out <= 0, on, self._beside(s, t, x, y))

    def height(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Height of the ground [m] at places."""
        s, t = self.reference_line.nearest(x, y)
        return self.ground(s, t)

    def _beside(self, s: Array, t: Array, x: Array, y: Array) -> Array:
        """Height of the land: the road's at its edge, hills far away."""
        out = np.maximum(np.maximum(t - self.lane_section.high, self.lane_section.low - t), 0.0)
        edge = self.reference_line.height(s) + self.over_line(t, self.lane_section.height(t))
        share = np.clip(out / BLEND_M, 0.0, 1.0)
        share = share * share * (3 - 2 * share)
        result = edge + share * (self.hills(x, y) - edge)
        if self.land.ditch_m:
            result = result - self.land.ditch_m * np.interp(out, DITCH_M, (0.0, 1.0, 1.0, 0.0))
        if self.land.valley:
            low, high = self._banks
            along = self.along_bridge(x, y)
            steep = max(VALLEY_SIDE_M, VALLEY_SIDES * (high - low))
            inside = np.clip(np.minimum(along - low, high - along) / steep, 0.0, 1.0)
            share = inside * inside * (3 - 2 * inside) * np.clip(out / 1.5, 0.0, 1.0)
            result = result + share * (self.valley_floor - result)
        if self.land.hill:
            begin, high = self.land.hill[0] + BEHIND_WALL_M, self.land.hill[1]
            cutting = np.clip(out / CUTTING_M, 0.0, 1.0) * np.clip((s - begin + 70.0) / 70.0, 0.0, 1.0)
            result = result + high * np.where(
                s < begin, AT_PORTAL * cutting, np.clip(AT_PORTAL + (s - begin) / 90.0, 0.0, 1.0)
            )
        return result

    @cached_property
    def valley_floor(self) -> float:
        """Height of the level bottom of the valley that the road bridges [m]."""
        assert self.land.valley is not None
        a, b, depth = self.land.valley
        return float(self.reference_line.height((a + b) / 2)) - depth

    def flooded(self, x: Array, y: Array) -> npt.NDArray[np.bool_]:
        """Whether places lie in the river at the bottom of the valley, or a few steps from it."""
        if self.land.valley is None:
            return np.zeros(np.shape(x), dtype=bool)
        low, high = self._banks
        return np.asarray(np.abs(self.along_bridge(x, y)) < 0.7 * RIVER * (high - low))

    def along_bridge(self, x: Array, y: Array) -> Array:
        """How far places are beyond the bridge's middle [m], along the road's direction there: a valley is straight
        where the road bends.
        """
        assert self.land.valley is not None
        middle = sum(self.land.valley[:2]) / 2
        heading = self.reference_line.heading(middle)
        x0, y0 = self.reference_line.place(middle, 0.0)
        return np.asarray((y - y0) * np.cos(heading) - (x - x0) * np.sin(heading))

    @cached_property
    def _banks(self) -> tuple[float, float]:
        """Where the road leaves the land and reaches it again, as `along_bridge` counts [m]."""
        assert self.land.valley is not None
        low, high = self.along_bridge(*self.reference_line.place(np.array(self.land.valley[:2]), 0.0))
        return float(low), float(high)

    @cached_property
    def _waves(self) -> Array:
        """(5, WAVES): height of each wave, cosine and sine of its direction, length [m] and phase [rad]."""
        rng = stream(self.land.seed, "land", "hills")
        rows = [(rng.uniform(110, 600), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)) for _ in range(WAVES)]
        length, angle, phase = np.array(rows).T
        return np.stack([length / 600, np.cos(angle), np.sin(angle), length, phase])

    def hills(self, x: Array, y: Array) -> Array:
        """Height of the open land [m]: a few long waves."""
        if not self.land.hills_m:
            return np.zeros(np.shape(x))
        broadness, cosine, sine, length, phase = self._waves[(..., *(None,) * np.ndim(x))]
        total = np.zeros(np.shape(x))
        for wave in broadness * np.sin((x * cosine + y * sine) * 2 * np.pi / length + phase):
            total = total + wave
        return self.land.hills_m * (total / 2.2 + 0.35)

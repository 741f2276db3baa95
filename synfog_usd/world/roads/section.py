"""The cross-section of a road: bands from left to right, and the ground's height across them.

Offsets t [m] count to the right of the line between the two directions, or of the
middle of what parts them.  Knows nothing of where the road runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
KERB_M = 0.12
PAVED = ("lane", "bus", "parking", "shoulder", "cycle")
RAISED = ("pavement", "garden", "island")
SOFT = ("verge", "reserve")
KINDS = (*PAVED, *RAISED, *SOFT)
DRIVEN = ("lane", "bus")
VERGE_DROP = 0.03
VERGE_FALL = 0.06


@dataclass(frozen=True)
class Band:
    """One strip of the road.

    Attributes:
        kind: one of KINDS.
        width: [m].
        way: 1 where it is driven along the line, -1 against it, 0 else.
    """

    kind: str
    width: float
    way: int = 0


@dataclass(frozen=True)
class Strip:
    """A band in its place, from offset `low` to `high` [m]."""

    band: Band
    low: float
    high: float

    @property
    def middle(self) -> float:
        """Offset of its middle [m]."""
        return (self.low + self.high) / 2


@dataclass(frozen=True)
class Section:
    """Bands from left to right."""

    bands: tuple[Band, ...]

    @cached_property
    def strips(self) -> tuple[Strip, ...]:
        """The bands in their places."""
        edges = np.concatenate([[0.0], np.cumsum([band.width for band in self.bands])])
        against = [i for i, band in enumerate(self.bands) if band.way < 0]
        along = [i for i, band in enumerate(self.bands) if band.way > 0]
        axis = (edges[max(against) + 1] + edges[min(along)]) / 2 if against and along else edges[min(along or against)]
        edges = np.round(edges - axis, 4)
        return tuple(Strip(band, float(a), float(b)) for band, a, b in zip(self.bands, edges[:-1], edges[1:], strict=True))

    @property
    def low(self) -> float:
        """Offset of the left edge [m]."""
        return self.strips[0].low

    @property
    def high(self) -> float:
        """Offset of the right edge [m]."""
        return self.strips[-1].high

    def of(self, *kinds: str) -> Iterator[Strip]:
        """Strips of some kinds, from left to right."""
        return (strip for strip in self.strips if strip.band.kind in kinds)

    def kerbs(self) -> Iterator[tuple[float, int]]:
        """(offset, side): where a kerb is; the raised side lies to the right if `side` is 1, else to the left."""
        for one, other in zip(self.strips[:-1], self.strips[1:], strict=True):
            if (one.band.kind in RAISED) != (other.band.kind in RAISED):
                yield other.low, 1 if other.band.kind in RAISED else -1

    def ends(self, strip: Strip) -> tuple[float, float]:
        """Heights of a strip at its two edges, over the line [m]."""
        kind = strip.band.kind
        if kind in RAISED:
            return KERB_M, KERB_M
        if kind == "verge":
            fall = VERGE_DROP + VERGE_FALL * strip.band.width
            return (-fall, -VERGE_DROP) if strip.middle < 0 else (-VERGE_DROP, -fall)
        if kind == "reserve":
            return -VERGE_DROP, -VERGE_DROP
        return 0.0, 0.0

    def height(self, t: npt.ArrayLike) -> Array:
        """Height of the ground over the line [m] at offsets; beyond the edges as at the edge."""
        t = np.clip(np.asarray(t, dtype=np.float64), self.low, self.high)
        result = np.zeros(t.shape)
        for strip in self.strips:
            inside = (t >= strip.low) & (t <= strip.high)
            low, high = self.ends(strip)
            result = np.where(inside, low + (high - low) * (t - strip.low) / strip.band.width, result)
        return result

    def at(self, t: float) -> Strip | None:
        """The strip at an offset, or None beyond the edges."""
        return next((strip for strip in self.strips if strip.low <= t <= strip.high), None)

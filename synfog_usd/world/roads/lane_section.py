"""The cross-section of a road: its lanes from left to right, and the ground's height across them.

As in OpenDRIVE every strip is a lane, pavements and verges too.  Unlike OpenDRIVE, whose t
is positive to the left of the reference line, offsets t [m] here are positive to its right.
The reference line (t = 0) lies between the two directions, or in the middle of what parts
them.  Knows nothing of where the road runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array

KERB_M = 0.12
PAVED = ("lane", "bus", "parking", "shoulder", "cycle")
RAISED = ("pavement", "garden", "island")
SOFT = ("verge", "reserve")
KINDS = (*PAVED, *RAISED, *SOFT)
DRIVEN = ("lane", "bus")
EDGE_M = 1e-6
VERGE_DROP = 0.03
VERGE_FALL = 0.06


@dataclass(frozen=True)
class Lane:
    """One strip of the road in its place.

    Attributes:
        kind: one of KINDS.
        width: [m].
        way: 1 where it is driven along the reference line, -1 against it, 0 else.
        low, high: offsets t of its left and right edge [m].
    """

    kind: str
    width: float
    way: int
    low: float
    high: float

    @property
    def middle(self) -> float:
        """Offset of its middle [m]."""
        return (self.low + self.high) / 2


@dataclass(frozen=True)
class LaneSection:
    """Lanes from left to right."""

    lanes: tuple[Lane, ...]

    @classmethod
    def from_widths(cls, rows: Sequence[tuple[str, float, int]]) -> LaneSection:
        """The section of (kind, width [m], way) rows from left to right, with t = 0 between the directions."""
        edges = np.concatenate([[0.0], np.cumsum([width for _, width, _ in rows])])
        against = [i for i, (_, _, way) in enumerate(rows) if way < 0]
        along = [i for i, (_, _, way) in enumerate(rows) if way > 0]
        axis = (edges[max(against) + 1] + edges[min(along)]) / 2 if against and along else edges[min(along or against)]
        edges = np.round(edges - axis, 4)
        return cls(tuple(Lane(*row, float(a), float(b)) for row, a, b in zip(rows, edges[:-1], edges[1:], strict=True)))

    @property
    def low(self) -> float:
        """Offset of the left edge [m]."""
        return self.lanes[0].low

    @property
    def high(self) -> float:
        """Offset of the right edge [m]."""
        return self.lanes[-1].high

    def of(self, *kinds: str) -> Iterator[Lane]:
        """Lanes of some kinds, from left to right."""
        return (lane for lane in self.lanes if lane.kind in kinds)

    def kerbs(self) -> Iterator[tuple[float, int]]:
        """(offset, side): where a kerb is; the raised side lies to the right if `side` is 1, else to the left."""
        for lane, following in zip(self.lanes[:-1], self.lanes[1:], strict=True):
            if (lane.kind in RAISED) != (following.kind in RAISED):
                yield following.low, 1 if following.kind in RAISED else -1

    def ends(self, lane: Lane) -> tuple[float, float]:
        """Heights of a lane at its two edges, over the reference line [m]."""
        kind = lane.kind
        if kind in RAISED:
            return KERB_M, KERB_M
        if kind == "verge":
            fall = VERGE_DROP + VERGE_FALL * lane.width
            return (-fall, -VERGE_DROP) if lane.middle < 0 else (-VERGE_DROP, -fall)
        if kind == "reserve":
            return -VERGE_DROP, -VERGE_DROP
        return 0.0, 0.0

    def height(self, t: npt.ArrayLike) -> Array:
        """Height of the ground over the reference line [m] at offsets; beyond the edges as at the edge."""
        t = np.clip(np.asarray(t, dtype=np.float64), self.low, self.high)
        result = np.zeros(t.shape)
        for lane in self.lanes:
            inside = (t >= lane.low) & (t <= lane.high)
            low, high = self.ends(lane)
            result = np.where(inside, low + (high - low) * (t - lane.low) / lane.width, result)
        return result

    @cached_property
    def falling(self) -> tuple[float, float, float, float]:
        """Offsets of the left gutter, of the crown from and to, and of the right gutter [m].

        The crown lies between the two directions; gutters end what is paved beside it.
        """
        against = [lane.high for lane in self.of(*DRIVEN) if lane.way < 0]
        along = [lane.low for lane in self.of(*DRIVEN) if lane.way > 0]
        from_, to = max(against or along[:1]), min(along or against[-1:])
        low, high = from_, to
        for lane in reversed(self.lanes):
            if lane.high <= low + EDGE_M and lane.kind in PAVED:
                low = lane.low
            elif lane.high <= low + EDGE_M:
                break
        for lane in self.lanes:
            if lane.low >= high - EDGE_M and lane.kind in PAVED:
                high = lane.high
            elif lane.low >= high - EDGE_M:
                break
        return low, from_, to, high

    def from_crown(self, t: npt.ArrayLike) -> Array:
        """How far offsets are from the crown [m]; beyond a gutter as at the gutter."""
        low, from_, to, high = self.falling
        t = np.clip(np.asarray(t, dtype=np.float64), low, high)
        return np.maximum(np.maximum(from_ - t, t - to), 0.0)

    def at(self, t: float) -> Lane | None:
        """The lane at an offset, or None beyond the edges."""
        return next((lane for lane in self.lanes if lane.low <= t <= lane.high), None)

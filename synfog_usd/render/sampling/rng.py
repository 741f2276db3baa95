"""Random numbers of a path, from the number of its pixel and its own number alone.

How many paths are in flight, and on which lane a path lands, changes none of them.
Source: PCG32, O'Neill (2014), seeded by Mitsuba's `sample_tea_32`.
"""

from __future__ import annotations

from typing import Any, ClassVar

from synfog_usd.render import backend

PCG32_MULTIPLIER = 0x5851F42D4C957F2D
"""O'Neill (2014)."""


class Random:
    """Random numbers of one path after the other, the same whatever else is in flight.

    Args:
        seed: of the image.
        pixel: number of the pixel.
    """

    DRJIT_STRUCT: ClassVar[dict[str, type]] = {}

    def __init__(self, seed: Any = None, pixel: Any = None, path: Any = None) -> None:
        mi = backend.mitsuba()
        type(self).DRJIT_STRUCT = {"state": mi.PCG32}  # what a loop carries; known only once a variant is use_nee
        self.state = mi.PCG32()
        if pixel is not None:
            mixed, stream = mi.sample_tea_32(mi.UInt32(pixel), mi.UInt32(path) ^ mi.UInt32(seed))
            # as PCG32.seed does, but for the number of the lane, which must not matter
            self.state.inc = (mi.UInt64(stream) << 1) | 1
            self.state.state = (self.state.inc + mi.UInt64(mixed)) * PCG32_MULTIPLIER + self.state.inc

    def next_1d(self, active: Any = True) -> Any:
        """A number in [0, 1)."""
        return self.state.next_float32(active)

    def next_2d(self, active: Any = True) -> Any:
        """A point in [0, 1)^2."""
        mi = backend.mitsuba()
        first = self.state.next_float32(active)
        return mi.Point2f(first, self.state.next_float32(active))

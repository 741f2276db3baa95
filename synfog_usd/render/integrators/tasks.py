"""Many short tasks in few lanes: a lane goes on with the next when one is done.

A vector unit works on 16 lanes in step, which wait for the one whose paths are longest; and the fewer paths a lane has,
the more lengths differ.  A task's result is written to a place of its own, so which lane did it makes no difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr

from synfog_usd.render import backend

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32

PATHS = 32
"""Paths of a lane that even out their lengths."""

LEAST_LANES = 1 << 15
"""Lanes that keep a processor's cores busy alike."""

LEAST_LANES_CUDA = 1 << 20
"""Lanes that keep a graphics processor busy; it hides the waiting by other lanes' work."""


class Tasks:
    """The paths of pixels, and where their sums go.

    Args:
        pixel: (N,) number of each task's pixel.
        first: (N,) number of its first path.
        paths: of a task.
        floats, counts: how many numbers of either kind come of a task.
    """

    def __init__(self, pixel: UInt32, first: UInt32, paths: int, floats: int, counts: int) -> None:
        mi = backend.mitsuba()
        number = max(dr.width(pixel), dr.width(first))
        least = LEAST_LANES_CUDA if backend.is_cuda() else LEAST_LANES
        each = max(1, min(PATHS // max(paths, 1), number // least))
        self._pixel, self._first = mi.UInt32(pixel), mi.UInt32(first)
        self._lanes = -(-number // each)
        self._stride, self._number = dr.opaque(mi.UInt32, self._lanes), dr.opaque(mi.UInt32, number)
        self.floats = [dr.empty(mi.Float, number) for _ in range(floats)]
        self.counts = [dr.empty(mi.UInt32, number) for _ in range(counts)]

    def first_tasks(self) -> UInt32:
        """Each lane's first task; kept from the compiler, which makes another kernel where every lane has but one."""
        first = dr.arange(backend.mitsuba().UInt32, self._lanes)
        dr.make_opaque(first)
        return first

    def after(self, task: UInt32) -> UInt32:
        """The same lane's next one; neighbours stay neighbours."""
        return task + self._stride

    def there(self, task: UInt32) -> Bool:
        """Whether there is one of this number."""
        return task < self._number

    def of(self, task: UInt32, active: Bool) -> tuple[UInt32, UInt32]:
        """Its pixel and the number of its first path."""
        mi = backend.mitsuba()
        return dr.gather(mi.UInt32, self._pixel, task, active), dr.gather(mi.UInt32, self._first, task, active)

    def deliver(self, task: UInt32, done: Bool, floats: Sequence[Float], counts: Sequence[UInt32]) -> None:
        """Write what came of it."""
        for target, value in zip((*self.floats, *self.counts), (*floats, *counts), strict=True):
            dr.scatter(target, value, task, done)

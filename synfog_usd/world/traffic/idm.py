"""The Intelligent Driver Model: how a driver speeds up or brakes behind another.

Takes speeds and gaps; gives accelerations.  Knows nothing of roads.
Source: Treiber, Hennecke, Helbing (2000), Phys. Rev. E 62, 1805, doi 10.1103/PhysRevE.62.1805.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array

HARDEST = 8.0
"""Most that brakes give [m/s2]: 0.82 g, dry asphalt."""
SLOWING = 2.0
"""Most that a driver brakes who is too fast for the road alone [m/s2]."""


@dataclass(frozen=True)
class Driver:
    """How somebody drives.

    Attributes:
        headway_s: time gap T to the car ahead [s].
        standstill_m: gap s0 between bumpers at rest [m].
        speeding_up: greatest acceleration a [m/s2].
        braking: comfortable deceleration b [m/s2].
    """

    headway_s: float = 1.5
    standstill_m: float = 2.0
    speeding_up: float = 1.4
    braking: float = 2.0


def acceleration(
    driver: Driver, v: npt.ArrayLike, v0: npt.ArrayLike, gap: npt.ArrayLike, ahead: npt.ArrayLike
) -> Array:
    """Acceleration of drivers, within what their brakes give.

    a (1 - (v / v0)^4 - (s* / s)^2), s* = s0 + max(0, v T + v (v - v_ahead) / (2 sqrt(a b))); of the free term
    no more than `SLOWING` brakes.

    Args:
        driver: of all of them.
        v: speeds [m/s], >= 0, any shape.
        v0: speeds that they wish for [m/s], > 0.
        gap: to the bumper ahead [m]; inf for none.
        ahead: its speed [m/s].

    Returns:
        [m/s2], float64, of the common shape; -HARDEST to driver.speeding_up.
    """
    v, v0, gap, ahead = (np.asarray(value, dtype=np.float64) for value in (v, v0, gap, ahead))
    a, b = driver.speeding_up, driver.braking
    wished = driver.standstill_m + np.maximum(0.0, v * driver.headway_s + v * (v - ahead) / (2.0 * np.sqrt(a * b)))
    free = np.maximum(a * (1.0 - (v / v0) ** 4), -SLOWING)
    return np.asarray(np.clip(free - a * (wished / np.maximum(gap, 0.05)) ** 2, -HARDEST, a))


def safe_speed(gap: npt.ArrayLike, ahead: npt.ArrayLike, braking: float) -> Array:
    """Speed [m/s] from which one stops behind another who brakes as hard: sqrt(v_ahead^2 + 2 b gap)."""
    gap, ahead = np.asarray(gap, dtype=np.float64), np.asarray(ahead, dtype=np.float64)
    return np.asarray(np.sqrt(ahead**2 + 2.0 * braking * np.maximum(gap, 0.0)))

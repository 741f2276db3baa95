"""Changes of lane by MOBIL: who gains more by another lane than others lose, and in safety, goes over.

Takes where everybody is on a road of several lanes, and laws of following; gives who begins to change, and whereto.
Knows nothing of models or stages.
Source: Kesting, Treiber, Helbing (2007), "General Lane-Changing Model MOBIL for Car-Following Models".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.world.traffic.idm import Driver, acceleration

POLITE = 0.2
"""Share of what others lose that counts with one's own gain."""
GAIN, KEEPS_RIGHT = 0.2, 0.3
"""Least gain for a change [m/s2], and what is added to the left and taken off to the right."""
SAFE = 2.0
"""Nobody is made to brake harder than this by a change [m/s2]."""
SLOWEST = 8.0
"""Below this speed nobody changes lanes [m/s]."""
INDICATES_S = 1.0
"""From the first blink until the vehicle goes over."""
TAKES_S = (3.5, 5.0)
"""How long it goes over."""


@dataclass(frozen=True)
class Neighbours:
    """Vehicles on a lane, seen from one who is on it or beside it.

    Attributes:
        s: stations along the lane [m]; v, v0: speeds and those wished for [m/s]; all (N,).
        nose, tail: from origins to bumpers [m]; on: (N,) who is on the lane or goes over to it.
    """

    s: Array
    v: Array
    v0: Array
    nose: Array
    tail: Array
    on: Flags

    def ahead(self, who: int, s: float) -> int:
        """Number of the next vehicle ahead of one at a station, -1 for none."""
        before = self.on & (self.s > s)
        before[who] = False
        return int(np.argmin(np.where(before, self.s, np.inf))) if before.any() else -1

    def behind(self, who: int, s: float) -> int:
        """Number of the next vehicle behind one at a station, -1 for none."""
        after = self.on & (self.s <= s)
        after[who] = False
        return int(np.argmax(np.where(after, self.s, -np.inf))) if after.any() else -1

    def follows(self, driver: Driver, who: int, leader: int) -> float:
        """Acceleration of one behind another [m/s2]; -1 for nobody ahead."""
        gap = np.inf if leader < 0 else self.s[leader] - self.tail[leader] - self.s[who] - self.nose[who]
        speed = 0.0 if leader < 0 else self.v[leader]
        return float(acceleration(driver, self.v[who], self.v0[who], gap, speed))


def gain(driver: Driver, who: int, now: Neighbours, then: Neighbours, *, leftwards: bool) -> float:
    """By how much a change of lane is worth more than it has to be [m/s2]; -inf where it is not safe.

    Args:
        driver: as all drive.
        who: number of who may change.
        now, then: the lane that they are on, and the other one.
        leftwards: whether that lies to the left.
    """
    lead, follow = then.ahead(who, then.s[who]), then.behind(who, then.s[who])
    after = then.follows(driver, who, lead)
    forced = then.follows(driver, follow, who) if follow >= 0 else 0.0
    if min(after, forced) < -SAFE:
        return -np.inf
    lost = forced - then.follows(driver, follow, lead) if follow >= 0 else 0.0
    leader, last = now.ahead(who, now.s[who]), now.behind(who, now.s[who])
    freed = now.follows(driver, last, leader) - now.follows(driver, last, who) if last >= 0 else 0.0
    least = GAIN + (KEEPS_RIGHT if leftwards else -KEEPS_RIGHT)
    return after - now.follows(driver, who, leader) + POLITE * (lost + freed) - least


def over(clock: Array, takes: Array) -> tuple[Array, Array]:
    """Share of a change that is left to do so long after it began [s], 1 to 0, and its rate [1/s].

    It is the way with the least jerk, after the indicator has been on for a while.
    """
    u = np.clip((clock - INDICATES_S) / takes, 0.0, 1.0)
    return 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2), -30.0 * u**2 * (1.0 - u) ** 2 / takes

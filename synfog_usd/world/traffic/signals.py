"""The signals of a crossing over time: what each of its two streets sees, and when people may set out over them.

Takes which street goes at the beginning, and a seed; gives states at times.  Knows nothing of lamps or stages.
Source of the times: RiLSA (FGSV, 2015), 2.5 and 2.6: at 50 km/h amber lasts 3 s, red with amber 1 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.base.seeds import stream

MAIN, SIDE = 0, 1
"""Streets of a crossing."""
GREEN_S = (14.0, 26.0)
AMBER_S, RED_AMBER_S = 3.0, 1.0
CLEARING_S = 5.0
"""From the end of one street's amber to the other street's green: red on both sides."""
LAST_WALK_S = 4.0
"""Before the end of the other street's green, nobody sets out any more."""
LENSES = ("red", "amber", "green")


@dataclass(frozen=True)
class Programme:
    """A fixed cycle: green for the main street, then for the side street.

    Attributes:
        greens: how long MAIN and SIDE are green [s].
        elapsed: of the cycle at time 0, which begins with the main street's green [s].
    """

    greens: tuple[float, float]
    elapsed: float

    @property
    def cycle(self) -> float:
        """[s]."""
        return sum(self.greens) + 2.0 * (AMBER_S + CLEARING_S)

    def _begin(self, street: int) -> float:
        """Of a street's green in the cycle [s]."""
        return 0.0 if street == MAIN else self.greens[MAIN] + AMBER_S + CLEARING_S

    def lit(self, street: int, t: Array) -> dict[str, Flags]:
        """Which of LENSES are lit for a street at times [s]; before 0 as at 0."""
        since = (np.maximum(t, 0.0) + self.elapsed - self._begin(street)) % self.cycle
        green = since < self.greens[street]
        amber = ~green & (since < self.greens[street] + AMBER_S)
        return {"red": ~green & ~amber, "amber": amber | (since >= self.cycle - RED_AMBER_S), "green": green}

    def walks(self, street: int, until: float) -> list[tuple[float, float]]:
        """From when to when [s] people may set out over a street, up to a time: while the other one is green."""
        green_street = SIDE if street == MAIN else MAIN
        first = self._begin(green_street) - self.elapsed
        begins = first + self.cycle * np.arange(-1, int(until / self.cycle) + 2)
        return [(float(begin), float(begin) + self.greens[green_street] - LAST_WALK_S) for begin in begins]


def programme(street: int, seed: int) -> Programme:
    """A cycle by seed, in which a street is green at time 0."""
    rng = stream(seed, "traffic", "signals")
    main, side, share = rng.uniform(*GREEN_S), rng.uniform(*GREEN_S), rng.random()
    result = Programme((main, side), 0.0)
    return Programme(result.greens, result._begin(street) + share * result.greens[street])

"""What a set costs: seconds, bytes and memory of a unit, measured on a few, told of all.

The seconds of a unit are those of setting it up (drawing, translating, loading, compiling, metering) and those of its
pixels; bytes are by pixel.  A probe is a small unit that tells both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from synfog_usd.sets.definition import SetDefinition
from synfog_usd.sets.journal import Tally

UNKNOWN_S = 3600.0
"""Limit of a unit while nothing is known of its cost."""
PATIENCE = 10.0
"""A unit may take this many times what was expected of it."""
LEAST_LIMIT_S = 600.0


@dataclass(frozen=True)
class Cost:
    """What units cost on the machine at hand.

    Attributes:
        seconds: of a unit, by lighting; the most that was seen.
    """

    seconds: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def known(cls, found: SetDefinition, tally: Tally) -> Cost:
        """From what was made already."""
        mean = tally.seconds / tally.units if tally.units else None
        return cls({} if mean is None else {"": mean})

    def seen(self, lighting: str, seconds: float) -> Cost:
        """With one unit more."""
        return replace(self, seconds={**self.seconds, lighting: max(seconds, self.seconds.get(lighting, 0.0))})

    def limit_s(self, lighting: str) -> float:
        """Seconds after which a unit is taken to hang."""
        expected = max(self.seconds.get(lighting, 0.0), self.seconds.get("", 0.0))
        return max(LEAST_LIMIT_S, PATIENCE * expected) if expected else UNKNOWN_S

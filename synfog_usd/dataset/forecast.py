"""How much of a bake is done, as a share of its time.

A shot is set up and then rendered.  The first of a lighting is translated, loaded and
metered, and the first in fog may compile kernels; fog costs more than clear air.  What
earlier shots took tells what the next will take: those of the same kind, else all, by
rough weights.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

SET_UP = 0.03
"""Fraction of a shot up to which it is set up; rendering reports from there on."""

FOGGY = 2.5
"""Seconds of a foggy shot's rendering over those of a clear one's, about."""

FIRST_OF_LIGHTING, FIRST_FOGGY, ANY = 3.0, 2.5, 0.3
"""Seconds of setting up, relative."""


@dataclass(frozen=True)
class Kind:
    """What makes shots alike.

    Attributes:
        first: of its lighting.
        foggy: whether there is fog.
        first_foggy: of its lighting.
    """

    first: bool
    foggy: bool
    first_foggy: bool

    @property
    def weights(self) -> tuple[float, float]:
        """Of setting it up and of rendering it."""
        return ANY + FIRST_OF_LIGHTING * self.first + FIRST_FOGGY * self.first_foggy, FOGGY if self.foggy else 1.0


def kinds(shots: Sequence[tuple[str, bool]]) -> list[Kind]:
    """The kind of each shot of a bake, in order, from its lighting and whether it is foggy."""
    found, seen = [], set[tuple[str, bool]]()
    for lighting, foggy in shots:
        first = not {(lighting, True), (lighting, False)} & seen
        found.append(Kind(first, foggy, foggy and (lighting, True) not in seen))
        seen.add((lighting, foggy))
    return found


class Forecast:
    """Shares of a bake's time; they never become smaller.

    Args:
        shots: kinds, in order.
        now: seconds on any clock.
    """

    def __init__(self, shots: Sequence[Kind], now: Callable[[], float] = time.monotonic) -> None:
        self._shots, self._now = list(shots), now
        self._began = self._shot_began = now()
        self._rendering: float | None = None
        self._seen: list[tuple[Kind, float, float]] = []
        self._shown = 0.0

    def at(self, index: int, fraction: float) -> float:
        """Share that is done where shot `index` is done by a fraction, 0 to 1."""
        now = self._now()
        while len(self._seen) < index:
            begun = now if self._rendering is None else self._rendering
            self._seen.append((self._shots[len(self._seen)], begun - self._shot_began, now - begun))
            self._shot_began, self._rendering = now, None
        if fraction > SET_UP and self._rendering is None:
            self._rendering = now
        rest = self._own(index, fraction, now) + sum(
            sum(self._expected(kind, now)) for kind in self._shots[index + 1 :]
        )
        elapsed = now - self._began
        self._shown = max(self._shown, elapsed / (elapsed + rest) if elapsed + rest > 0.0 else 0.0)
        return self._shown

    def _own(self, index: int, fraction: float, now: float) -> float:
        """Seconds that the shot under way still takes."""
        if fraction >= 1.0:
            return 0.0
        setting_up, rendering = self._expected(self._shots[index], now)
        if self._rendering is None:
            return max(setting_up - (now - self._shot_began), 0.0) + rendering
        done = (fraction - SET_UP) / (1.0 - SET_UP)
        spent = now - self._rendering
        return spent * (1.0 - done) / done if done > 0.1 else max(rendering - spent, 0.0)

    def _expected(self, kind: Kind, now: float) -> tuple[float, float]:
        """Seconds of setting up and of rendering a shot: the means of its kind, else by the weights of all that were
        seen.
        """
        alike = [(setting_up, rendering) for other, setting_up, rendering in self._seen if other == kind]
        if alike:
            return sum(one for one, _ in alike) / len(alike), sum(two for _, two in alike) / len(alike)
        seen = self._seen or [(self._shots[0], now - self._shot_began, 0.3 * (now - self._shot_began))]
        set_up = sum(one for _, one, _ in seen) / sum(other.weights[0] for other, _, _ in seen)
        render = sum(two for _, _, two in seen) / sum(other.weights[1] for other, _, _ in seen)
        return kind.weights[0] * set_up, kind.weights[1] * render

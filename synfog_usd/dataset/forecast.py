"""How much of a bake is done, as a share of its time.

A shot is set up and then sampled, and its picture is made while the next is sampled.  The first of a lighting is
translated, loaded and metered, and the first in fog may compile kernels; a sample costs more in fog than in clear air,
and more before lamps than under a sky, and making the picture costs what it costs.  What earlier shots took tells what
the next will take: those most alike, by rough weights.  Seconds in which kernels were compiled say nothing of a shot's
pace and are kept apart: they tell what the kernels to come will take.  How far a shot's own fraction runs ahead of its
time, or behind, is learned from earlier ones too where samples are given, and else how many samples a shot needs.
Nobody knows that before, so shots that tell much of others are made first.
"""

from __future__ import annotations

import bisect
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from synfog_usd import numbers
from synfog_usd.dataset.plan import CLEAR

if TYPE_CHECKING:
    from synfog_usd.dataset.plan import Shot

SET_UP = 0.03
"""Fraction of a shot up to which it is set up; rendering reports from there on."""

Lights = Literal["sky", "surfaces", "lamps"]
"""What shines: the sky alone, surfaces too, or lamps."""


@dataclass(frozen=True)
class _Cost:
    """What lights cost.

    Attributes:
        clear: seconds of a sample in clear air over those under a sky alone, with all that is done meanwhile.
        in_fog: those of its surfaces, and of its air.
        thicker: power of the inverse of the visibility with which a sample takes longer, from `REFERENCE_MOR_M` on.
        kernels: seconds of compiling kernels for the first shot, and for the first in fog.
    """

    clear: float
    in_fog: tuple[float, float]
    thicker: float
    kernels: tuple[float, float]


COSTS: dict[Lights, _Cost] = {
    "sky": _Cost(1.0, (1.3, 1.3), 0.0, (1.0, 1.6)),
    "surfaces": _Cost(1.45, (1.9, 1.9), 0.0, (1.4, 2.8)),
    "lamps": _Cost(2.4, (7.1, 7.1), 0.28, (3.1, 5.7)),
}
"""About: like what follows fitted to recorded bakes of several streets, see `tests/dataset/test_forecast.py`."""

REFERENCE_MOR_M = 150.0

GUIDING = 6.0
"""Such samples that take as long as what every picture asks of the renderer: guides, AOVs, kernels made ready."""

USUAL = {(False, False): 130, (True, False): 70, (False, True): 20, (True, True): 15}
"""Samples by fog and lamps with which a shot is as good as its sensor wants it, until shots have told: on seven streets
at 320x180 by day 8 to 300 and at dusk 6 to 260; in fog about half as many by day, and two thirds at dusk.
"""

OTHERS, NEARBY = 0.5, 0.2
"""How much shots tell of those with other lights, as a power; and what is added to the difference of two visibilities'
logarithms, over whose square shots are weighed that are alike: in fog of half the visibility some streets need twice
the samples, and others as many.
"""

LOOKED_AT = 0.09
"""Of the rendering of a shot that stops by itself: before that it was not looked at, and says how much it has done of
the most that it may.
"""

OVERDUE = 0.5
"""Of what is expected of such a shot's rendering, for all that it says is left, where that time is nearly over."""

SURE = 32
"""Samples that nearly every shot spends that may have no more."""

MAKING = 5.8
"""Such samples by which the renderer waits longer for what denoises, develops and writes the picture before meanwhile;
that of a bake's first is made beside its labels, and of a lighting's last beside the metering of the next.
"""

FIRST_OF_ALL, FIRST_OF_LIGHTING, ANY = 3.0, 3.0, 0.1
"""Seconds of setting up: those of the first shot come to those of a lighting's, and any to both."""

ALONE = 0.7
"""Share of the seconds of compiling by which a shot takes longer: pictures are made and paths traced beside it."""

LAST = 0.3
"""Of a shot's rendering, for making the last picture, when nothing is sampled any more; until others were made."""


@dataclass(frozen=True)
class Kind:
    """What makes shots alike.

    Attributes:
        first: of its lighting.
        foggy: whether there is fog.
        first_foggy: of its lighting.
        lights: what shines.
        samples: paths of a pixel, as many as are expected or were spent.
        air: paths in the air for each that meets surfaces.
        mor_m: visibility in the fog [m].
        beside: what the picture before takes that is made while this one is sampled, in samples.
        first_of_all: shots.
    """

    first: bool
    foggy: bool
    first_foggy: bool
    lights: Lights = "sky"
    samples: float = field(default=numbers.QUALITIES["sensor"].samples, compare=False)
    air: float = 1.0
    mor_m: float = field(default=REFERENCE_MOR_M, compare=False)
    beside: float = field(default=0.0, compare=False)
    first_of_all: bool = field(default=False, compare=False)

    @property
    def weights(self) -> tuple[float, float]:
        """Of setting it up and of rendering it."""
        setting_up = ANY + FIRST_OF_LIGHTING * self.first + FIRST_OF_ALL * self.first_of_all
        cost = COSTS[self.lights]
        each = cost.in_fog[0] + self.air * cost.in_fog[1] if self.foggy else cost.clear
        turns = (REFERENCE_MOR_M / self.mor_m) ** cost.thicker if self.foggy else 1.0
        return setting_up, self.samples * turns * each + GUIDING + self.beside

    @property
    def kernels(self) -> tuple[float, float]:
        """Weights of compiling while it is set up and while it is rendered."""
        clear, in_fog = COSTS[self.lights].kernels
        return clear * self.first, in_fog * self.first_foggy


def kinds(
    shots: Sequence[tuple[str, float | None, Lights]],
    samples: int = numbers.QUALITIES["sensor"].samples,
    air: float = 1.0,
) -> list[Kind]:
    """The kind of each shot of a bake, in order, from its lighting, the visibility in its fog [m] or None in clear air,
    and what shines; at most so many samples of a pixel, and air as in `Kind`.
    """
    found, seen = [], set[tuple[str, bool]]()
    for lighting, mor_m, lights in shots:
        foggy = mor_m is not None
        first = not {(lighting, True), (lighting, False)} & seen
        beside = 0.0 if first or len(found) < 2 else MAKING
        spent = min(samples, USUAL[foggy, lights == "lamps"]) if samples > SURE else samples
        first_foggy = foggy and (lighting, True) not in seen
        thick = mor_m or REFERENCE_MOR_M
        found.append(Kind(first, foggy, first_foggy, lights, spent, air, thick, beside, not found))
        seen.add((lighting, foggy))
    return found


def least_known_first(todo: Sequence[Shot], lights: Callable[[str], Lights]) -> list[Shot]:
    """Shots in the order in which the time left is told truly soonest, where they stop by themselves.  Before lamps
    nobody knows after how many samples, so those are made first; and before them, since it tells much of the others,
    one of each lighting without lamps, whose scene is loaded twice then: the middle one in fog, of which most are.
    """
    lit = {shot.lighting for shot in todo if lights(shot.lighting) == "lamps"}
    by_lighting: dict[str, list[Shot]] = {}
    for shot in todo:
        if lit and shot.lighting not in lit:
            by_lighting.setdefault(shot.lighting, []).append(shot)
    foggy = [[shot for shot in alike if shot.fog != CLEAR] or alike for alike in by_lighting.values()]
    firsts = [alike[len(alike) // 2] for alike in foggy]
    return sorted(todo, key=lambda shot: 0 if shot in firsts else 1 if shot.lighting in lit else 2)


@dataclass
class _Taken:
    """What a shot took, compiling apart: seconds of setting up and of rendering, and when its rendering said which
    fraction.
    """

    kind: Kind
    setting_up: float = 0.0
    rendering: float = 0.0
    said: list[tuple[float, float]] = field(default_factory=list)

    def share(self, fraction: float) -> float:
        """Share of the time of rendering at which it was done by a fraction."""
        index = bisect.bisect_right(self.said, (fraction, float("inf")))
        low = self.said[index - 1] if index else (0.0, 0.0)
        high = self.said[index] if index < len(self.said) else (1.0, self.rendering)
        part = (fraction - low[0]) / (high[0] - low[0]) if high[0] > low[0] else 1.0
        return (low[1] + part * (high[1] - low[1])) / self.rendering if self.rendering > 0.0 else fraction


@dataclass
class _Sums:
    """Of shots that are alike: seconds and weights of setting up and of rendering; and the last of them."""

    setting_up: tuple[float, float] = (0.0, 0.0)
    rendering: tuple[float, float] = (0.0, 0.0)
    last: _Taken | None = None

    def add(self, taken: _Taken) -> None:
        (seconds, weight), (own, of_rendering) = self.setting_up, taken.kind.weights
        self.setting_up = seconds + taken.setting_up, weight + own
        seconds, weight = self.rendering
        self.rendering = seconds + taken.rendering, weight + of_rendering
        self.last = taken


class Forecast:
    """Shares of a bake's time; they never become smaller.

    Args:
        shots: kinds, in order.
        now: seconds on any clock.
        began: when on it the bake began; what was done before the first shot counts as done.
        most: samples of a pixel that a shot may spend.
    """

    def __init__(
        self,
        shots: Sequence[Kind],
        now: Callable[[], float] = time.monotonic,
        began: float | None = None,
        most: int = numbers.QUALITIES["sensor"].samples,
    ) -> None:
        self._shots, self._now, self._most = list(shots), now, most
        self._shot_began: float | None = now()
        self._began = self._shot_began if began is None else began
        self._rendering: float | None = None
        self._seen = 0  # shots
        self._sums: dict[Any, _Sums] = {}  # by kind, by (foggy, lights), by lights, and of all as None
        self._after: tuple[int, list[tuple[Kind, int]]] = -1, []  # a shot; the kinds that come after it, and how many
        self._said: list[tuple[float, float]] = []
        self._shown = 0.0
        self._compiled = [0.0, 0.0]  # seconds within setting up and rendering of the shot under way
        self._kernels = 0.0, 0.0  # of shots that have ended: seconds of compiling, and weights
        self._made: list[float] = []
        self._spent: dict[int, float] = {}  # samples of the shots that told
        self._needs: dict[tuple[Lights, bool], dict[int, float]] = {}  # by lights and fog: samples over those usual

    def expect(self, shots: Sequence[Kind]) -> None:
        """What the shots are after all."""
        self._shots, self._after = list(shots), (-1, [])

    def compiled(self, seconds: float) -> None:
        """Kernels were compiled for so long since this was last told."""
        if self._shot_began is not None:
            self._compiled[self._rendering is not None] += ALONE * seconds

    def made(self, seconds: float) -> None:
        """The picture of a shot took so long beside the sampling of the next."""
        self._made.append(seconds)

    def spent(self, index: int, samples: float) -> None:
        """Shot `index`, which is under way, has spent all its samples, so many of a pixel; nothing new where they are
        given.
        """
        if self._most > SURE:
            self._spent[index] = samples
            self.needed(index, samples)

    def needed(self, index: int, samples: float) -> None:
        """It needed so many after all, which may be more than it may have."""
        if self._most > SURE:
            kind = self._shots[index]
            self._needs.setdefault((kind.lights, kind.foggy), {})[index] = samples / max(kind.samples, 1)

    def ended(self) -> None:
        """The shot under way has ended; what is done until the next begins is part of neither."""
        self._end(self._now())
        self._shot_began = None

    def _end(self, now: float) -> None:
        begun = now if self._rendering is None else self._rendering
        set_up = begun - (begun if self._shot_began is None else self._shot_began)
        kind = self._shots[self._seen]
        kind = replace(kind, samples=self._spent.get(self._seen, self._likely(kind).samples))
        compiled, weights = self._kernels
        self._kernels = compiled + sum(self._compiled), weights + sum(kind.kernels)
        taken = _Taken(kind, set_up - self._compiled[0], now - begun - self._compiled[1], self._said)
        for key in _keys(kind):
            self._sums.setdefault(key, _Sums()).add(taken)
        self._seen += 1
        self._shot_began, self._rendering, self._said, self._compiled = now, None, [], [0.0, 0.0]

    def at(self, index: int, fraction: float) -> float:
        """Share that is done where shot `index` is done by a fraction, 0 to 1."""
        now = self._now()
        while self._seen < index:
            self._end(now)
        self._shot_began = now if self._shot_began is None else self._shot_began
        if fraction >= SET_UP:
            self._rendering = now if self._rendering is None else self._rendering
            self._said.append((_rendered(fraction), now - self._rendering - self._compiled[1]))
        rest = self._own(index, fraction, now)
        longer = self._longer(index, rest, now)
        for kind, count in self._coming(index):
            setting_up, rendering = self._expected(kind, now)
            rendering *= longer.get((kind.foggy, kind.lights), 1.0)
            rest += count * (setting_up + rendering + self._compiling(kind))
        rest += sum(self._made) / len(self._made) if self._made else LAST * self._expected(self._shots[-1], now)[1]
        elapsed = now - self._began
        self._shown = max(self._shown, elapsed / (elapsed + rest) if elapsed + rest > 0.0 else 0.0)
        return self._shown

    def _coming(self, index: int) -> list[tuple[Kind, int]]:
        """Kinds of the shots after one, and how many there are of each; counted once for all that a shot says."""
        if self._after[0] != index:
            counts = Counter((kind, kind.beside, kind.mor_m) for kind in self._shots[index + 1 :])
            self._after = index, [(kind, count) for (kind, *_), count in counts.items()]
        return self._after[1]

    def _own(self, index: int, fraction: float, now: float) -> float:
        """Seconds that the shot under way still takes: by what is expected of it at first, and the more it has done the
        more by its own pace.
        """
        setting_up, rendering = self._expected(self._shots[index], now)
        compiling = max(self._compiling(self._shots[index]) - sum(self._compiled), 0.0)
        if self._rendering is None:
            spent = now - (self._shot_began or 0.0) - self._compiled[0]
            return max(setting_up - spent, 0.0) + rendering + compiling
        alike = self._alike(self._shots[index]) if self._most <= SURE else None
        done = alike.last.share(_rendered(fraction)) if alike and alike.last else _rendered(fraction)
        spent = now - self._rendering - self._compiled[1]
        paced = spent * (1.0 - done) / done if done > 0.0 else rendering
        known, overdue = done, 1.0
        if self._most > SURE:
            known, overdue = max(done - LOOKED_AT, 0.0) / (1.0 - LOOKED_AT), OVERDUE
        left = max(rendering - spent, overdue * (1.0 - done) * rendering)
        return known * paced + (1.0 - known) * (left + compiling)

    def _longer(self, index: int, left: float, now: float) -> dict[Any, float]:
        """How many times longer the rendering of the shot under way takes than was expected, for those by fog and
        lights of which it tells first, where shots stop by themselves.
        """
        kind = self._shots[index]
        if self._most <= SURE or self._rendering is None or (kind.foggy, kind.lights) in self._sums:
            return {}
        foggy = {kind.foggy} if kind.lights in self._sums else {True, False}
        spent = now - self._rendering - self._compiled[1]
        longer = (spent + left) / max(self._expected(kind, now)[1], 1e-9)
        return {(one, kind.lights): longer for one in foggy}

    def _compiling(self, kind: Kind) -> float:
        """Seconds for which kernels of a shot are compiled: by those before, none where they needed none."""
        seconds, weights = self._kernels
        if not weights and self._rendering is not None:
            seconds, weights = self._compiled[0], self._shots[self._seen].kernels[0]
        return sum(kind.kernels) * seconds / weights if weights else 0.0

    def _alike(self, kind: Kind) -> _Sums | None:
        return next((self._sums[key] for key in _keys(kind)[:-1] if key in self._sums), None)

    def _likely(self, kind: Kind) -> Kind:
        """With as many samples as are likely: by what others of its lights were found to need, in fog where it is, else
        by the rest; most by those in fog like its own.
        """
        alike = self._needs.get((kind.lights, kind.foggy)) or self._needs.get((kind.lights, not kind.foggy))
        found = alike or {index: need for needs in self._needs.values() for index, need in needs.items()}
        if not found:
            return kind
        weights = [(abs(math.log(self._shots[index].mor_m / kind.mor_m)) + NEARBY) ** -2 for index in found]
        more = sum(weight * math.log(need) for weight, need in zip(weights, found.values(), strict=True)) / sum(weights)
        return replace(kind, samples=min(kind.samples * math.exp(more if alike else OTHERS * more), self._most))

    def _expected(self, kind: Kind, now: float) -> tuple[float, float]:
        """Seconds of setting up and of rendering a shot: the means of those most alike, by weights; before any
        was seen, the first one's parts are taken to be half of what has passed.
        """
        seen = self._sums.get(None)
        if seen is None:
            own, seen = 0.5 * max(now - self._began - sum(self._compiled), 0.0), _Sums()
            seen.add(_Taken(self._shots[0], own, own))
        set_up, of = (self._sums.get(kind) or seen).setting_up
        render, of_rendering = (self._alike(kind) or seen).rendering
        return kind.weights[0] * set_up / of, self._likely(kind).weights[1] * render / of_rendering


def _keys(kind: Kind) -> tuple[Any, ...]:
    """By which the sums of a shot are kept."""
    return kind, (kind.foggy, kind.lights), kind.lights, None


def _rendered(fraction: float) -> float:
    """Fraction of the rendering where a shot is done by a fraction."""
    return (fraction - SET_UP) / (1.0 - SET_UP)

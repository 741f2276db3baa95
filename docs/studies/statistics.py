"""Means with intervals over scenes, and ranks in which what chance may have made is a tie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base import seeds

RESAMPLES = 2000
LEVEL = 0.95
FEWEST_SCENES = 3
"""Below that nothing can be said of other scenes."""


@dataclass(frozen=True)
class Mean:
    """A mean over pairs.

    Attributes:
        value: the mean.
        low, high: interval at 95 %, by bootstrap over scenes; None of fewer than three scenes.
        count: of pairs.
        scenes: of scenes.
    """

    value: float
    low: float | None
    high: float | None
    count: int
    scenes: int


def mean(values: Sequence[float], scenes: Sequence[str], *, seed: int = 0) -> Mean:
    """Mean of values that belong to scenes.

    Scenes are drawn with replacement, each with all its values, because fogs and lightings of one scene are not
    independent.

    Args:
        values: at least one.
        scenes: whose value each is.
        seed: of the resampling.

    Source: Davison and Hinkley, "Bootstrap Methods and their Application" (1997), sections 2.4 and 3.8 (clusters).
    """
    names, place = np.unique(np.asarray(scenes), return_inverse=True)
    numbers = np.asarray(values, dtype=np.float64)
    if names.size < FEWEST_SCENES:
        return Mean(float(numbers.mean()), None, None, numbers.size, names.size)
    sums, counts = np.bincount(place, numbers), np.bincount(place)
    weights = draws(names.size, seed)
    return Mean(float(numbers.mean()), *interval((weights @ sums) / (weights @ counts)), numbers.size, names.size)


def interval(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Ends of the interval at 95 % of a statistic's values over draws; those that are not defined are left out."""
    low, high = np.nanquantile(values, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    return float(low), float(high)


def ranks(
    values: Mapping[str, Mapping[str, float]], scenes: Mapping[str, str], *, higher: bool, seed: int = 0
) -> dict[str, int]:
    """Rank of each method: one more than the number of methods that are better beyond chance.

    Two methods are compared on the pairs that both answered; one is better where the interval of the mean difference
    does not hold 0.

    Args:
        values: method -> pair -> number.
        scenes: pair -> scene.
        higher: whether more is better.
    """
    better = dict.fromkeys(values, 0)
    for name, mine in values.items():
        for rival, theirs in values.items():
            shared = sorted(mine.keys() & theirs.keys())
            if name == rival or not shared:
                continue
            sign = 1.0 if higher else -1.0
            gain = mean(
                [sign * (theirs[pair] - mine[pair]) for pair in shared], [scenes[pair] for pair in shared], seed=seed
            )
            better[name] += gain.low is not None and gain.low > 0.0
    return {name: 1 + count for name, count in better.items()}


def draws(scenes: int, seed: int = 0) -> npt.NDArray[np.float64]:
    """(RESAMPLES, scenes) how often each scene is drawn."""
    return (
        seeds.stream(seed, "bootstrap", scenes)
        .multinomial(scenes, np.full(scenes, 1.0 / scenes), size=RESAMPLES)
        .astype(np.float64)
    )

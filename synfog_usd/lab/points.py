"""What a chart measured, as a table, and what follows from it: the Pareto front, and seconds to an error.

A point is one model at one number of samples.  Points of one model are a line, those by
words of quality another.  Renders and draws nothing.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from synfog_usd.render.models import having

ERROR, MOTTLE = "error", "mottle"

TARGETS = ((ERROR, 0.01), (ERROR, 0.03), (ERROR, 0.10), (MOTTLE, 0.01))
"""What the summary tells the seconds of: total errors, and clouds."""


@dataclass(frozen=True)
class Point:
    """One model at one number of samples: a row of `chart.csv`.

    Attributes:
        line: model, and whether it is by words of quality.
        model, quality, samples: what was run; an empty cell of `quality` is no word but so many samples.
        unbiased: whether the model has no bias by its making, and nothing was smoothed.
        seconds: wall time of a render on a loaded scene whose kernel is there already, with what the model prepares for
            itself: the least of RUNS - 1, since other work on the machine only adds to it.
        first_call_s: wall time of the line's first render; what it has over `seconds` is the making of the kernel, or
            reading it from Dr.Jit's cache on disk.  Once a line, at its fewest samples; later points repeat no kernel.
        relative_mse, relative_rms: mean square of the relative error of luminance over the pixels, and its root; the
            reference's variance is taken off.
        noise_rms, bias_rms: what of it differs from seed to seed, and what stays; squares add up to `relative_mse`.
        bias_limit: bias of a pixel, RMS, that two standard errors leave room for; above it, none.
        bias_is_seen: whether `bias_rms` is more than three standard errors from none.
        p95: 95th percentile over the pixels of the absolute relative difference.
        mottle: what of the noise the eye takes for clouds, relative, see `accuracy.mottle`.
        flip: mean HDR-FLIP of a run; NaN where OpenImageIO has none.
        bias, bias_error: difference of the means over the reference's, and its standard error.
        mean_nits: mean luminance of the renders.
        on_front: whether no point is both faster and closer.
        enough: whether it is the point of `auto` with the fewest samples that reach the error asked for.
        reference_rms, reference_flip, reference_model, reference_samples: see `accuracy.Reference`.
        width, height: of the picture in pixels.
        variant, machine: where it ran.
    """

    line: str
    model: str
    quality: str
    unbiased: bool
    samples: int
    seconds: float
    first_call_s: float
    relative_mse: float
    relative_rms: float
    noise_rms: float
    bias_rms: float
    bias_limit: float
    bias_is_seen: bool
    p95: float
    mottle: float
    flip: float
    bias: float
    bias_error: float
    mean_nits: float
    on_front: bool
    enough: bool
    reference_rms: float
    reference_flip: float
    reference_model: str
    reference_samples: int
    width: int
    height: int
    variant: str
    machine: str

    def counts(self, measure: str) -> bool:
        """Whether it may be the best: what leaves light out is smooth and wrong, so no clouds in it are no merit."""
        return measure == ERROR or self.model in having("unbiased")

    def amount(self, measure: str) -> float:
        """Its total error or its mottle."""
        return self.mottle if measure == MOTTLE else self.relative_rms

    @property
    def mark(self) -> str:
        """What is written beside it: its word, or its number of samples."""
        return self.quality or str(self.samples)


def line_name(model: str, *, quality: bool) -> str:
    """What a line is called: its model, and whether its points are words of quality."""
    return f"{model}, by quality" if quality else model


def lines(points: Iterable[Point]) -> dict[str, list[Point]]:
    """Points by line, each by rising samples, in the order in which the lines first stand."""
    by_line: dict[str, list[Point]] = {}
    for point in points:
        by_line.setdefault(point.line, []).append(point)
    return {name: sorted(line, key=lambda point: point.samples) for name, line in by_line.items()}


def front(costs: Sequence[tuple[float, float]]) -> list[int]:
    """Which of (seconds, error) no other beats in both, by rising seconds.

    >>> front([(1.0, 0.5), (2.0, 0.6), (3.0, 0.1), (3.0, 0.2)])
    [0, 2]
    """
    indices, best = [], math.inf
    for index in sorted(range(len(costs)), key=lambda index: costs[index]):
        if costs[index][1] < best:
            indices.append(index)
            best = costs[index][1]
    return indices


@dataclass(frozen=True)
class Price:
    """What a line takes to a stated error.

    Attributes:
        line, samples, seconds: of the render that has it.
        beyond: samples over the most that were measured; above 1 the price is extrapolated.
    """

    line: str
    samples: float
    seconds: float
    beyond: float


def price(line: Sequence[Point], target: float, measure: str = ERROR) -> Price | None:
    """Seconds to a total error or a mottle, or None where bias alone is more.

    Noise and mottle fall with the square root of samples: the square times samples, averaged over
    the line's points, is a constant of the line.  Words of quality do not: of these it is the
    fastest that has it.  Bias is that of the most samples: where
    none is seen it is 0 for a model that has none by its making, and the limit of what
    could be there for any other.  Seconds are interpolated between points, never less than the
    least that was measured, and go on beyond them with the last slope.

    Args:
        line: points of one line, by rising samples.
    """
    last = line[-1]
    if last.quality:
        there = [point for point in line if point.amount(measure) <= target]
        cheapest = min(there, key=lambda point: point.seconds, default=None)
        return Price(last.line, cheapest.samples, cheapest.seconds, 1.0) if cheapest else None
    if measure == MOTTLE:
        clouds = sum(point.mottle**2 * point.samples for point in line) / len(line)
        samples = max(clouds / target**2, float(line[0].samples))
        return Price(last.line, samples, _seconds(line, samples), samples / last.samples)
    bias = 0.0 if last.unbiased else last.bias_rms if last.bias_is_seen else last.bias_limit
    room = target**2 - bias**2
    if room <= 0.0:
        return None
    noise = sum(point.noise_rms**2 * point.samples for point in line) / len(line)
    samples = max(noise / room, float(line[0].samples))
    return Price(last.line, samples, _seconds(line, samples), samples / last.samples)


def _seconds(line: Sequence[Point], samples: float) -> float:
    if samples <= line[0].samples:
        return line[0].seconds
    last = line[-1]
    if samples > last.samples:
        slope = (last.seconds - line[-2].seconds) / (last.samples - line[-2].samples) if len(line) > 1 else 0.0
        if slope <= 0.0:
            slope = last.seconds / last.samples
        return last.seconds + slope * (samples - last.samples)
    for earlier, right in itertools.pairwise(line):
        if samples <= right.samples:
            share = (samples - earlier.samples) / (right.samples - earlier.samples)
            return earlier.seconds + share * (right.seconds - earlier.seconds)
    raise AssertionError("a line's points rise in samples")


def summary(points: Sequence[Point]) -> list[dict[str, Any]]:
    """One row a target: the cheapest line of ours, the cheapest unbiased one, the best peer, and how much faster than
    the peer.
    """
    rows, peers = [], having("peer")
    by_line = lines(points)
    for measure, target in TARGETS:
        prices = {name: cost for name, line in by_line.items() if (cost := price(line, target, measure))}
        may = {name: cost for name, cost in prices.items() if by_line[name][0].counts(measure)}
        ours = [cost for name, cost in may.items() if by_line[name][0].model not in peers]
        fair = [cost for cost in ours if by_line[cost.line][0].unbiased]
        theirs = [cost for name, cost in prices.items() if by_line[name][0].model in peers]
        best, unbiased, peer = (
            min(group, key=lambda cost: cost.seconds, default=None) for group in (ours, fair, theirs)
        )
        row: dict[str, Any] = {"measure": measure, "target": target}
        for name, cost in (("best", best), ("unbiased", unbiased), ("peer", peer)):
            row |= {name: cost.line if cost else "", f"{name}_samples": math.ceil(cost.samples) if cost else ""}
            row |= {f"{name}_seconds": cost.seconds if cost else "", f"{name}_beyond": cost.beyond if cost else ""}
        for name, cost in (("best", best), ("unbiased", unbiased)):
            row[f"{name}_speedup"] = peer.seconds / cost.seconds if peer and cost else ""
        rows.append(row)
    return rows


def table(points: Iterable[Point]) -> str:
    """Points as CSV with a header; numbers have five digits, truths are 0 and 1, what is not there is empty."""
    plain = [asdict(point) for point in points]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(plain[0]), lineterminator="\n")
    writer.writeheader()
    for row in plain:
        writer.writerow({name: _cell(value) for name, value in row.items()})
    return text.getvalue()


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return int(value)
    return f"{value:.5g}" if isinstance(value, float) else "" if value is None else value

"""A suite's tables into a page of the documentation, so that no number is typed by hand.

From a shell: `python -m docs.studies.report OUT docs/speed-accuracy.md`.  Charts
each stage of `stages/bench` that has no `OUT/<stage>/chart.csv` yet, and replaces
what stands between the page's two marks.
"""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from synfog_usd.base import files, resources
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.numbers import QUALITIES
from synfog_usd.base.progress import duration
from synfog_usd.lab import verdicts
from synfog_usd.lab.chart import ChartPlan, chart
from synfog_usd.lab.points import TARGETS, Point, summary

SIZE_PX, LIMIT_S = (96, 54), 60.0
"""Of each chart: its picture, and its time limit [s]."""

SHOWN = (TARGETS[1], TARGETS[3])
"""Targets that have a table on the page: 3 % total error, and 1 % mottle."""

BEGIN, END = "<!-- suite: written by docs.studies.report; do not edit -->", "<!-- end of suite -->"


def report(out: Path, document: Path) -> None:
    """Bring `document` up to what lies in `out`.

    Raises:
        ParameterError: no marks in `document`.
    """
    before, begin, rest = document.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ParameterError(f"{document}: has not the two marks {BEGIN!r} and {END!r}, between which the numbers go")
    for stage in sorted((resources.folder("stages") / "bench").glob("*.usda")):
        if not (out / stage.stem / "chart.csv").exists():
            chart(ChartPlan(stage, out / stage.stem, size=SIZE_PX, time_limit=LIMIT_S))
    points = {path.parent.name: read(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*/chart.csv"))}
    text = f"{before}{BEGIN}\n\n{section(points)}\n{END}{after}"
    files.write_bytes(document, text.encode())


def section(points: Mapping[str, Sequence[Point]]) -> str:
    """What stands between the marks, in Markdown."""
    rows = {name: summary(line) for name, line in points.items()}
    first = next(iter(points.values()))[0]
    own = [line[0].reference_rms for line in points.values()]
    parts = [
        f"{len(points)} stages, {first.width} x {first.height}, `{first.variant}` on {first.machine}. References are "
        f"known to {percent(min(own))} to {percent(max(own))}.",
        "### The words of quality\n\nSeconds, paths of a pixel, total error, mottle.\n\n" + _words(points),
        *(_table(TARGETS.index(target), *target, rows) for target in SHOWN),
    ]
    return "\n\n".join(parts) + "\n"


def _words(points: Mapping[str, Sequence[Point]]) -> str:
    text = f"| stage | {' | '.join(f'`{word}`' for word in QUALITIES)} |\n|---|{'---|' * len(QUALITIES)}\n"
    for name, line in points.items():
        by_word = {point.quality: point for point in line if point.quality}
        cells = []
        for word in QUALITIES:
            point = by_word.get(word)
            cells.append(
                f"{duration(point.seconds)}, {point.samples}, {percent(point.relative_rms)}, {percent(point.mottle)}"
                if point
                else "not run"
            )
        text += f"| {name} | {' | '.join(cells)} |\n"
    return text.rstrip()


def _table(index: int, measure: str, target: float, rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    text = f"### Seconds to {verdicts.target_words(measure, target)}\n\n"
    text += (
        "| stage | fastest | seconds | without bias | seconds | best peer | seconds | peer / fastest | peer / without "
        "bias |\n"
    )
    text += "|---|---|---|---|---|---|---|---|---|\n"
    for name, all_targets in rows.items():
        row = all_targets[index]
        cells = [name]
        for who in ("best", "unbiased", "peer"):
            cells += [str(row[who]) or "none", verdicts.seconds(row, who)]
        cells += [verdicts.ratio(row), verdicts.ratio(row, "unbiased")]
        text += f"| {' | '.join(cells)} |\n"
    return text.rstrip()


def read(text: str) -> list[Point]:
    """The points of a `chart.csv`."""
    kinds = {field.name: str(field.type) for field in fields(Point)}
    readers: dict[str, Callable[[str], Any]] = {
        "str": str,
        "int": int,
        "float": float,
        "bool": lambda cell: cell == "1",
    }
    return [
        Point(**{name: readers[kind](row[name]) for name, kind in kinds.items()})
        for row in csv.DictReader(io.StringIO(text))
    ]


def percent(value: float) -> str:
    """Three digits: '0.52 %', '12.3 %', '2440 %'."""
    return f"{100 * value:.0f} %" if abs(value) >= 1.0 else f"{100 * value:.3g} %"


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m docs.studies.report OUT docs/speed-accuracy.md")
    report(Path(sys.argv[1]), Path(sys.argv[2]))

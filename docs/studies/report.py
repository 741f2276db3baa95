"""A suite's table and drawings into a page of the documentation, so that no number is typed by hand.

From a shell: `python -m docs.studies.report OUT docs/speed-accuracy.md`.  Reads
each `OUT/<stage>/chart.csv`, writes the table and the drawings over all
anew, copies the drawings to `images/` beside the page, and replaces
what stands between the page's two marks.  Renders nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from synfog_usd.base import files
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.numbers import QUALITIES
from synfog_usd.lab.study import verdicts
from synfog_usd.lab.study.chart import write_suite
from synfog_usd.lab.study.points import TARGETS, Point, read, summary

SHOWN = (TARGETS[1], TARGETS[3])
"""Targets that have a table on the page: 3 % total error, and 1 % mottle."""

BEGIN, END = "<!-- suite: written by docs.studies.report; do not edit -->", "<!-- end of suite -->"


def report(out: Path, document: Path) -> None:
    """Bring `document` up to what lies in `out`.

    Raises:
        ParameterError: no chart in `out`, or no marks in `document`.
    """
    found = sorted(out.glob("*/chart.csv"))
    if not found:
        raise ParameterError(f"{out}: no <stage>/chart.csv in it; make it with synfog-usd chart --suite -o {out}")
    before, begin, rest = document.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ParameterError(f"{document}: has not the two marks {BEGIN!r} and {END!r}, between which the numbers go")
    points = {path.parent.name: read(path.read_text(encoding="utf-8")) for path in found}
    write_suite(points, out)
    images = document.parent / "images"
    for name in ("suite", "mottle"):
        files.write_bytes(images / f"chart_{name}.png", (out / f"{name}.png").read_bytes())
    text = f"{before}{BEGIN}\n\n{section(points)}\n{END}{after}"
    files.write_bytes(document, text.encode())


def section(points: Mapping[str, Sequence[Point]]) -> str:
    """What stands between the marks, in Markdown."""
    rows = {name: summary(name, line) for name, line in points.items()}
    first = next(iter(points.values()))[0]
    own = [line[0].reference_rms for line in points.values()]
    parts = [
        f"{len(points)} stages, {first.width} x {first.height}, `{first.variant}` on {first.machine}. References are "
        f"known to {verdicts.percent(min(own))} to {verdicts.percent(max(own))}.",
        "![Seconds against error on each stage](images/chart_suite.png)",
        "![Seconds against mottle on each stage](images/chart_mottle.png)",
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
                f"{verdicts.duration(point.seconds)}, {point.samples}, {verdicts.percent(point.relative_rms)}, "
                f"{verdicts.percent(point.mottle)}"
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


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m docs.studies.report OUT docs/speed-accuracy.md")
    report(Path(sys.argv[1]), Path(sys.argv[2]))

"""A suite's table and drawings into a page of the documentation, so that no number is typed by hand.

From a shell: `python -m synfog_usd.study.pages.report OUT docs/speed-accuracy.md`.  Reads
each `OUT/<stage>/chart.csv`, writes `OUT/summary.csv`, `OUT/suite.svg` and
`OUT/suite.png` anew, copies the drawings to `images/` beside the page, and replaces
what stands between the page's two marks.  Renders nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from synfog_usd import files
from synfog_usd.errors import ParameterError
from synfog_usd.study import drawing, page
from synfog_usd.study.chart import write_suite
from synfog_usd.study.points import TARGETS, Point, lines, read, summary

BEGIN, END = "<!-- suite: written by synfog_usd.study.pages.report; do not edit -->", "<!-- end of suite -->"


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
    files.write_bytes(images / "chart_suite.png", (out / "suite.png").read_bytes())
    for name, line in points.items():
        title = f"{name}, {line[0].width} x {line[0].height}"
        files.write_bytes(images / f"chart_{name}.png", drawing.draw_chart(line, title=title)[1])
    text = f"{before}{BEGIN}\n\n{section(points)}\n{END}{after}"
    files.write_bytes(document, text.encode())


def section(points: Mapping[str, Sequence[Point]]) -> str:
    """What stands between the marks, in Markdown."""
    rows = {name: summary(name, line) for name, line in points.items()}
    first = next(iter(points.values()))[0]
    parts = [
        f"{len(points)} stages, {first.width} x {first.height}, `{first.variant}` on {first.machine}.",
        "![Seconds against error on each stage](images/chart_suite.png)",
        *(_table(index, target, rows) for index, target in enumerate(TARGETS)),
        "### Noise and bias at the most samples\n\n" + _errors(points),
    ]
    for name, line in points.items():
        said = "\n".join(f"- {page.sentence(row)}" for row in rows[name])
        own = (
            f"Reference: `{line[0].reference_model}`, {line[0].reference_samples} samples, itself known to "
            f"{drawing.percent(line[0].reference_rms)}."
        )
        parts.append(f"### {name}\n\n{said}\n- {own}\n\n![Seconds against error, {name}](images/chart_{name}.png)")
    return "\n\n".join(parts) + "\n"


def _table(index: int, target: float, rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    text = f"### To a total error of {100 * target:g} %\n\n"
    text += (
        "| stage | fastest | seconds | without bias | seconds | best peer | seconds | peer / fastest | peer / without "
        "bias |\n"
    )
    text += "|---|---|---|---|---|---|---|---|---|\n"
    for name, all_targets in rows.items():
        row = all_targets[index]
        cells = [name]
        for who in ("best", "unbiased", "peer"):
            cells += [str(row[who]) or "none", page.seconds(row, who)]
        cells += [page.ratio(row), page.ratio(row, "unbiased")]
        text += f"| {' | '.join(cells)} |\n"
    return text.rstrip()


def _errors(points: Mapping[str, Sequence[Point]]) -> str:
    names = list(dict.fromkeys(point.line for line in points.values() for point in line))
    text = f"| stage | {' | '.join(names)} |\n|---|{'---|' * len(names)}\n"
    for name, line in points.items():
        last = {key: found[-1] for key, found in lines(line).items()}
        cells = []
        for key in names:
            point = last.get(key)
            bias = (
                ""
                if point is None
                else drawing.percent(point.bias_rms)
                if point.bias_is_seen
                else f"< {drawing.percent(point.bias_limit)}"
            )
            cells.append("" if point is None else f"{drawing.percent(point.noise_rms)}, {bias}")
        text += f"| {name} | {' | '.join(cells)} |\n"
    return text.rstrip()


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m synfog_usd.study.pages.report OUT docs/speed-accuracy.md")
    report(Path(sys.argv[1]), Path(sys.argv[2]))

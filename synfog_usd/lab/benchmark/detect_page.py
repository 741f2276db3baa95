"""What the detection bench leaves for people: tables in Markdown, CSV and LaTeX, and pictures with boxes."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from synfog_usd.base import files
from synfog_usd.lab.benchmark import page
from synfog_usd.lab.benchmark.bench import Bench
from synfog_usd.lab.benchmark.detect import ALL, LEFT, STATES, DetectionScore, DetectionScores, FoggedView, fogs

COLOURS = {"visible": "#2f9e6e", "faint": "#e5a00d", "invisible": "#d6404a", "": "#9aa4ad"}
"""Of true boxes, as the gallery has them."""

FOUND = "#38b6ff"
SURE = 0.3
"""Boxes of a lower score are not drawn."""

METRICS = ("AP", "AP50", "AP75", "AR")

Scored = Mapping[str, DetectionScores]
"""By the name of the detector."""


def write(bench: Bench, scored: Scored, ranks: Mapping[str, int], out: Path) -> None:
    """Write table.md, table.csv and pictures.png.

    Raises:
        OutputError: the folder cannot be written.
    """
    files.write_bytes(out / "table.md", markdown(bench, scored, ranks).encode())
    files.write_bytes(out / "table.csv", _csv(scored, ranks).encode())
    _pictures(bench, out / "pictures.png")


def markdown(bench: Bench, scored: Scored, ranks: Mapping[str, int]) -> str:
    """The tables, and what they rest on."""
    views: Sequence[FoggedView] = bench.items
    names = sorted(ranks, key=lambda name: (ranks[name], -_value(scored[name].score(ALL, "AP"))))
    lines = [
        "# Detection bench",
        "",
        f"{len(views)} pictures of {len({view.scene for view in views})} scenes. COCO's average precision (AP, the "
        "mean over overlaps of 0.50 to 0.95) and recall (AR, of 100 boxes of a class), means over classes; in brackets "
        "the interval at 95 % over scenes. Detectors share a rank where the difference in AP of all things may be "
        "chance.",
        "",
        f"**{LEFT.capitalize()}:** things that no camera can see (`invisible`) are regions in which boxes are neither "
        "right nor wrong.",
        "",
        f"| rank | detector | counts | {' | '.join(METRICS)} | things | pictures |",
        f"|---|---|---|{'---|' * len(METRICS)}---|---|",
    ]
    for name in names:
        for counts in (ALL, LEFT):
            scores = " | ".join(_cell(scored[name].score(counts, metric)) for metric in METRICS)
            count = getattr(scored[name].score(counts, "AP"), "things", 0)
            answered = f"{scored[name].pictures} of {len(views)}"
            lines.append(f"| {ranks[name]} | {name} | {counts} | {scores} | {count} | {answered} |")
    for title, by, groups in (
        ("AP by visibility (MOR)", "fog", fogs(views)),
        ("AP by distance", "distance", _groups(scored, "distance")),
    ):
        rows = [
            [name, counts, *(_cell(scored[name].score(counts, "AP", by, group)) for group in groups)]
            for name in names
            for counts in (ALL, LEFT)
        ]
        lines += ["", f"## {title}", "", *_table(["detector", "counts", *groups], rows)]
    lines += ["", "## AR by what fog leaves of a thing", ""]
    rows = [
        [name, *(_counted(scored[name].score(ALL, "AR", "visibility", visibility)) for visibility in STATES)]
        for name in names
    ]
    lines += _table(["detector", *STATES], rows)
    lines += page.unanswered(bench)
    return "\n".join([*lines, ""])


def _groups(scored: Scored, by: str) -> list[str]:
    return list(dict.fromkeys(row.group for scores in scored.values() for row in scores.rows if row.by == by))


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


def _value(score: DetectionScore | None) -> float:
    return math.nan if score is None else score.value


def _cell(score: DetectionScore | None) -> str:
    if score is None or not math.isfinite(score.value):
        return "-"
    text = f"{score.value:.3f}"
    return text if score.low is None else f"{text} ({score.low:.3f} to {score.high:.3f})"


def _counted(score: DetectionScore | None) -> str:
    return f"{_cell(score)}, {score.things} things" if score is not None else "-"


def _csv(scored: Scored, ranks: Mapping[str, int]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["detector", "rank", "counts", "by", "group", "metric", "value", "low", "high", "things"])
    for name, scores in scored.items():
        for row in scores.rows:
            numbers = [
                "" if number is None or math.isnan(number) else f"{number:.6g}"
                for number in (row.value, row.low, row.high)
            ]
            table.writerow([name, ranks[name], row.counts, row.by, row.group, row.metric, *numbers, row.things])
    return text.getvalue()


def _pictures(bench: Bench, path: Path) -> None:
    """A row a picture: what is there, coloured by what fog leaves of it, and what each detector finds."""
    foggy = [view for view in bench.items if not view.source.clear] or list(bench.items)
    strips = []
    for view in page.spread(foggy):
        true = [(item.box, COLOURS[item.visibility]) for item in view.things]
        strip = [_boxed(view, view.name, true)]
        for method in bench.methods:
            row = bench.row(method, view)
            if "boxes" in row:
                strip.append(_boxed(view, method.name, [(box[:4], FOUND) for box in row["boxes"] if box[4] >= SURE]))
            else:
                strip.append(page.no_answer(method.name))
        strips.append(strip)
    page.sheet(strips, path)


def _boxed(view: FoggedView, caption: str, boxes: Sequence[tuple[Sequence[float], str]]) -> page.Tile:
    from PIL import ImageDraw

    picture, caption = page.tile(view.picture, caption)
    scale = page.TILE_PX / view.source.labels.size_px[0]
    draw = ImageDraw.Draw(picture)
    for (left_px, top, width, height), colour in boxes:
        draw.rectangle(
            [scale * left_px, scale * top, scale * (left_px + width), scale * (top + height)], outline=colour
        )
    return picture, caption

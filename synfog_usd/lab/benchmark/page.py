"""What a bench leaves for people: tables in Markdown, CSV and LaTeX, and pictures side by side."""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from synfog_usd.base import files
from synfog_usd.base.errors import ParameterError
from synfog_usd.lab.benchmark import defog, metrics
from synfog_usd.lab.benchmark.bench import Bench
from synfog_usd.lab.benchmark.child import picture
from synfog_usd.lab.benchmark.methods import PNG, Defogger
from synfog_usd.lab.benchmark.pairs import Pair
from synfog_usd.lab.benchmark.statistics import Mean, mean, ranks
from synfog_usd.lab.benchmark.worker import MethodError, MethodWorker

if TYPE_CHECKING:
    from PIL import Image

Item = TypeVar("Item")
SHOWN = 6
"""Pairs in the sheet of pictures."""

TILE_PX, GAP_PX, CAPTION_PX = 320, 6, 22


Row = tuple[Defogger, int, dict[str, Mean]]
"""A method, its rank, and its mean by metric."""

Tile = tuple["Image.Image", str]
"""A picture, and its caption."""


def write(bench: Bench, rows: Sequence[Row], out: Path) -> None:
    """Write table.md, table.csv and pictures.png.

    Args:
        bench: what was measured.
        rows: from `rows`.
        out: folder.

    Raises:
        OutputError: the folder cannot be written.
    """
    files.write_bytes(out / "table.md", markdown(bench, rows).encode())
    files.write_bytes(out / "table.csv", _csv(rows).encode())
    _pictures(bench, out / "pictures.png")


def rows(bench: Bench) -> list[Row]:
    """A row a method, the best first; one without an answer is left out."""
    scenes = {pair.name: pair.scene for pair in bench.items}
    first = metrics.usable()[0]
    answered = {method.name: values for method in bench.methods if (values := defog.values(bench, method, first))}
    order = ranks(answered, scenes, higher=metrics.METRICS[first].higher)
    found_rows: list[Row] = []
    for method in bench.methods:
        if method.name in answered:
            means = {}
            for name in metrics.usable():
                if not (values := defog.values(bench, method, name)):
                    continue
                means[name] = mean(list(values.values()), [scenes[pair] for pair in values])
            found_rows.append((method, order[method.name], means))
    sign = -1.0 if metrics.METRICS[first].higher else 1.0
    return sorted(found_rows, key=lambda row: (row[1], sign * row[2][first].value))


def _common_metrics(rows: Sequence[Row]) -> list[str]:
    """Names of the metrics that every method has."""
    return [name for name in metrics.usable() if all(name in means for _, _, means in rows)]


def markdown(bench: Bench, rows: Sequence[Row]) -> str:
    """The tables, and under them what they rest on."""
    names = _common_metrics(rows)
    titles = [_title(name) for name in names]
    scenes = len({pair.scene for pair in bench.items})
    lines = [
        "# Defogging bench",
        "",
        f"{len(bench.items)} pairs of {scenes} scenes. Means over pairs; in brackets the "
        f"interval at 95 % over scenes. Methods share a rank where the difference in {_title(names[0])} may be chance.",
        "",
        f"| rank | method | {' | '.join(titles)} | pictures |",
        f"|---|---|{'---|' * len(names)}---|",
    ]
    for method, rank, means in rows:
        cells = " | ".join(_cell(name, means[name]) for name in names)
        lines.append(f"| {rank} | {method.name} | {cells} | {means[names[0]].count} of {len(bench.items)} |")
    if fogs := defog.fogs(bench.items):
        title = _title(names[0])
        lines += ["", f"{title} by fog:", "", f"| method | {' | '.join(fogs)} |", f"|---|{'---|' * len(fogs)}"]
        scene_of = {pair.name: pair.scene for pair in bench.items}
        for method, _, _ in rows:
            by_fog = []
            for fog in fogs:
                values = defog.values(bench, method, names[0], fog)
                average = mean(list(values.values()), [scene_of[pair] for pair in values]) if values else None
                by_fog.append(_cell(names[0], average) if average else "-")
            lines.append(f"| {method.name} | {' | '.join(by_fog)} |")
    lines += unanswered(bench)
    missing = [name for name in metrics.METRICS if name not in metrics.usable()]
    lines += ["", "Metrics: " + "; ".join(f"{_title(n)} ({metrics.METRICS[n].source})" for n in names) + "."]
    for name in missing:
        package = metrics.PACKAGES[metrics.METRICS[name].module]
        lines.append(f"{name}: not measured; pip install {package} brings it.")
    lines += [f"{metrics.LPIPS_WANTING}.", ""]
    return "\n".join(lines)


def unanswered(bench: Bench) -> list[str]:
    """A line for each method that failed somewhere, with its first reason."""
    lines = []
    for method in bench.methods:
        if failed := bench.failures(method):
            name, why = next(iter(failed.items()))
            lines += [
                "",
                f"`{method.name}` gave no answer for {len(failed)} of {len(bench.items)} pictures; {name}: {why}",
            ]
    return lines


def _title(name: str) -> str:
    metric = metrics.METRICS[name]
    return f"{metric.title} {'up' if metric.higher else 'down'}"


def _cell(name: str, average: Mean) -> str:
    decimals = metrics.METRICS[name].decimals
    text = f"{average.value:.{decimals}f}"
    return text if average.low is None else f"{text} ({average.low:.{decimals}f} to {average.high:.{decimals}f})"


def _csv(rows: Sequence[Row]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["method", "rank", "metric", "mean", "low", "high", "pairs", "scenes"])
    for method, rank, means in rows:
        for name, average in means.items():
            ends = ["" if end is None else f"{end:.6g}" for end in (average.low, average.high)]
            table.writerow([method.name, rank, name, f"{average.value:.6g}", *ends, average.count, average.scenes])
    return text.getvalue()


def _pictures(bench: Bench, path: Path) -> None:
    """A row a pair: foggy, each method's answer, clear."""
    methods = [method for method in bench.methods if method.target != "none"]
    strips = []
    with tempfile.TemporaryDirectory(prefix="synfog-usd-") as folder:
        workers = [MethodWorker(method, Path(folder)) for method in methods]
        try:
            for pair in spread(bench.items):
                row = [tile(pair.foggy, pair.name)]
                for method, worker in zip(methods, workers, strict=True):
                    row.append(_answer(bench, pair, method, worker))
                strips.append([*row, tile(pair.clear, "clear")])
        finally:
            for worker in workers:
                worker.close()
    sheet(strips, path)


def _answer(bench: Bench, pair: Pair, method: Defogger, worker: MethodWorker) -> Tile:
    row = bench.row(method, pair)
    source = pair.foggy if method.takes == PNG else pair.files.get(method.takes)
    if "error" not in row and source is not None:
        try:
            return tile(worker.ask(source), f"{method.name}  {row.get('psnr', 0.0):.1f} dB")
        except MethodError:
            pass
    return no_answer(method.name)


def spread(items: Sequence[Item]) -> list[Item]:
    """At most `SHOWN` of them, spread over all."""
    count = min(SHOWN, len(items))  # one more each time, so that not every row is of one fog
    return [items[place] for place in sorted({(n * len(items) // count + n) % len(items) for n in range(count)})]


def tile(path: Path, caption: str) -> Tile:
    """A picture in the sheet's width, with its caption; a dark tile where it cannot be read."""
    from PIL import Image

    try:
        return fitted(Image.fromarray(picture(path))), caption
    except ParameterError:
        return no_answer(caption, "cannot be read")


def fitted(picture: Image.Image) -> Image.Image:
    """A picture in the sheet's width."""
    return picture.resize((TILE_PX, max(1, round(TILE_PX * picture.height / picture.width))))


def no_answer(name: str, why: str = "no answer") -> Tile:
    """In the place of a picture."""
    from PIL import Image

    return Image.new("RGB", (TILE_PX, TILE_PX // 2), (60, 24, 24)), f"{name}: {why}"


def sheet(strips: Sequence[Sequence[Tile]], path: Path) -> None:
    """Write rows of tiles as one PNG."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(size=14)
    wide = max(tile[0].width for row in strips for tile in row) + GAP_PX
    high = [max(tile[0].height for tile in row) + CAPTION_PX + GAP_PX for row in strips]
    whole = Image.new("RGB", (GAP_PX + wide * max(map(len, strips)), GAP_PX + sum(high)), (24, 24, 26))
    draw, top = ImageDraw.Draw(whole), GAP_PX
    for row, height in zip(strips, high, strict=True):
        for column, (shown, caption) in enumerate(row):
            draw.text((GAP_PX + column * wide, top), caption[:40], fill=(225, 225, 225), font=font)
            whole.paste(shown, (GAP_PX + column * wide, top + CAPTION_PX))
        top += height
    files.write_whole(path, lambda temporary: whole.save(temporary, "PNG"))

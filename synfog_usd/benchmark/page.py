"""What a bench leaves for people: tables in Markdown, CSV and LaTeX, and pictures side by side."""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from synfog_usd import files
from synfog_usd.benchmark import defog, metrics
from synfog_usd.benchmark.methods import PNG, Defogger
from synfog_usd.benchmark.pairs import Pair
from synfog_usd.benchmark.statistics import Mean, mean, ranks
from synfog_usd.benchmark.worker import MethodError, MethodWorker

SHOWN = 6
"""Pairs in the sheet of pictures."""

TILE_PX, GAP_PX, CAPTION_PX = 320, 6, 22


Row = tuple[Defogger, int, dict[str, Mean]]
"""A method, its rank, and its mean by metric."""


def write(bench: defog.DefogBench, rows: Sequence[Row], out: Path) -> None:
    """Write table.md, table.csv, table.tex and pictures.png.

    Args:
        bench: what was measured.
        rows: from `rows`.
        out: folder.

    Raises:
        OutputError: the folder cannot be written.
    """
    files.write_bytes(out / "table.md", markdown(bench, rows).encode())
    files.write_bytes(out / "table.csv", _csv(rows).encode())
    files.write_bytes(out / "table.tex", _latex(rows).encode())
    _pictures(bench, out / "pictures.png")


def rows(bench: defog.DefogBench) -> list[Row]:
    """A row a method, the best first; one without an answer is left out."""
    scenes = {pair.name: pair.scene for pair in bench.pairs}
    first = metrics.usable()[0]
    answered = {method.name: values for method in bench.methods if (values := bench.values(method, first))}
    order = ranks(answered, scenes, higher=metrics.METRICS[first].higher)
    found_rows: list[Row] = []
    for method in bench.methods:
        if method.name in answered:
            found = {}
            for name in metrics.usable():
                values = bench.values(method, name)
                found[name] = mean(list(values.values()), [scenes[pair] for pair in values])
            found_rows.append((method, order[method.name], found))
    sign = -1.0 if metrics.METRICS[first].higher else 1.0
    return sorted(found_rows, key=lambda row: (row[1], sign * row[2][first].value))


def markdown(bench: defog.DefogBench, rows: Sequence[Row]) -> str:
    """The tables, and under them what they rest on."""
    names = metrics.usable()
    titles = [_title(name) for name in names]
    scenes = len({pair.scene for pair in bench.pairs})
    lines = [
        "# Defogging bench",
        "",
        f"{len(bench.pairs)} pairs of {scenes} scenes. Means over pairs; in brackets the "
        f"interval at 95 % over scenes. Methods share a rank where the difference in {_title(names[0])} may be chance.",
        "",
        f"| rank | method | {' | '.join(titles)} | pictures |",
        f"|---|---|{'---|' * len(names)}---|",
    ]
    for method, rank, found in rows:
        cells = " | ".join(_cell(name, found[name]) for name in names)
        lines.append(f"| {rank} | {method.name} | {cells} | {found[names[0]].count} of {len(bench.pairs)} |")
    if fogs := defog.fogs(bench.pairs):
        title = _title(names[0])
        lines += ["", f"{title} by fog:", "", f"| method | {' | '.join(fogs)} |", f"|---|{'---|' * len(fogs)}"]
        decimals = metrics.METRICS[names[0]].decimals
        for method, _, _ in rows:
            cells = []
            for fog in fogs:
                values = list(bench.values(method, names[0], fog).values())
                cells.append(f"{sum(values) / len(values):.{decimals}f}" if values else "-")
            lines.append(f"| {method.name} | {' | '.join(cells)} |")
    for method in bench.methods:
        if failed := bench.failures(method):
            name, why = next(iter(failed.items()))
            lines += [
                "",
                f"`{method.name}` gave no answer for {len(failed)} of {len(bench.pairs)} pictures; {name}: {why}",
            ]
    missing = [name for name in metrics.METRICS if name not in names]
    lines += ["", "Metrics: " + "; ".join(f"{_title(n)} ({metrics.METRICS[n].source})" for n in names) + "."]
    lines += [f"{', '.join(missing)}: not measured; pip install 'synfog-usd[benchmark]' brings them."] * bool(missing)
    lines += [f"{metrics.LPIPS_WANTING}.", ""]
    return "\n".join(lines)


def _title(name: str) -> str:
    metric = metrics.METRICS[name]
    return f"{metric.title} {'up' if metric.higher else 'down'}"


def _cell(name: str, found: Mean) -> str:
    decimals = metrics.METRICS[name].decimals
    text = f"{found.value:.{decimals}f}"
    return text if found.low is None else f"{text} ({found.low:.{decimals}f} to {found.high:.{decimals}f})"


def _csv(rows: Sequence[Row]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["method", "rank", "metric", "mean", "low", "high", "pairs", "scenes"])
    for method, rank, found in rows:
        for name, one in found.items():
            ends = ["" if end is None else f"{end:.6g}" for end in (one.low, one.high)]
            table.writerow([method.name, rank, name, f"{one.value:.6g}", *ends, one.count, one.scenes])
    return text.getvalue()


def _latex(rows: Sequence[Row]) -> str:
    names = metrics.usable()
    best = {
        name: (max if metrics.METRICS[name].higher else min)(found[name].value for _, _, found in rows)
        for name in names
        if rows
    }
    titles = [f"{metrics.METRICS[n].title} $\\{'up' if metrics.METRICS[n].higher else 'down'}arrow$" for n in names]
    lines = [
        f"\\begin{{tabular}}{{l{'r' * len(names)}}}",
        "\\hline",
        f"Defogger & {' & '.join(titles)} \\\\",
        "\\hline",
    ]
    for method, _, found in rows:
        cells = []
        for name in names:
            text = f"{found[name].value:.{metrics.METRICS[name].decimals}f}"
            cells.append(f"\\textbf{{{text}}}" if found[name].value == best[name] else text)
        lines.append(f"{_escaped(method.name)} & {' & '.join(cells)} \\\\")
    return "\n".join([*lines, "\\hline", "\\end{tabular}", ""])


def _escaped(text: str) -> str:
    return "".join(f"\\{letter}" if letter in "_&%$#{}" else letter for letter in text if letter not in "\\^~")


def _pictures(bench: defog.DefogBench, path: Path) -> None:
    """A row a pair: foggy, each method's answer, clear."""
    from PIL import Image, ImageDraw, ImageFont

    step = max(1, len(bench.pairs) // SHOWN)
    pairs = list(bench.pairs)[::step][:SHOWN]
    methods = [method for method in bench.methods if method.target != "none"]
    font = ImageFont.load_default(size=14)
    strips = []
    with tempfile.TemporaryDirectory(prefix="synfog-usd-") as folder:
        workers = [MethodWorker(method, Path(folder)) for method in methods]
        try:
            for pair in pairs:
                row = [_tile(pair.foggy, pair.name)]
                for method, worker in zip(methods, workers, strict=True):
                    row.append(_answer(bench, pair, method, worker))
                strips.append([*row, _tile(pair.clear, "clear")])
        finally:
            for worker in workers:
                worker.close()
    wide = max(tile[0].width for row in strips for tile in row) + GAP_PX
    high = [max(tile[0].height for tile in row) + CAPTION_PX + GAP_PX for row in strips]
    sheet = Image.new("RGB", (GAP_PX + wide * len(strips[0]), GAP_PX + sum(high)), (24, 24, 26))
    draw, top = ImageDraw.Draw(sheet), GAP_PX
    for row, height in zip(strips, high, strict=True):
        for column, (tile, caption) in enumerate(row):
            draw.text((GAP_PX + column * wide, top), caption[:40], fill=(225, 225, 225), font=font)
            sheet.paste(tile, (GAP_PX + column * wide, top + CAPTION_PX))
        top += height
    files.write_whole(path, lambda temporary: sheet.save(temporary, "PNG"))


def _answer(bench: defog.DefogBench, pair: Pair, method: Defogger, worker: MethodWorker) -> tuple[Any, str]:
    from PIL import Image

    row = bench.rows.get((method.version, pair.name), {})
    taken = pair.foggy if method.takes == PNG else pair.files.get(method.takes)
    if "error" not in row and taken is not None:
        try:
            return _tile(worker.restore(taken), f"{method.name}  {row.get('psnr', 0.0):.1f} dB")
        except MethodError:
            pass
    return Image.new("RGB", (TILE_PX, TILE_PX // 2), (60, 24, 24)), f"{method.name}: no answer"


def _tile(path: Path, caption: str) -> tuple[Any, str]:
    from PIL import Image

    with Image.open(path) as image:
        picture = image.convert("RGB")
    return picture.resize((TILE_PX, max(1, round(TILE_PX * picture.height / picture.width)))), caption

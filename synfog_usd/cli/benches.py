"""What the verbs of `synfog-usd benchmark` do and print."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import typer

from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown
from synfog_usd.lab.benchmark import defog as bench_of
from synfog_usd.lab.benchmark import detect as detection
from synfog_usd.lab.benchmark import detect_page, detectors, metrics, page
from synfog_usd.lab.benchmark.bench import Bench
from synfog_usd.lab.benchmark.bench import picture as picture_of
from synfog_usd.lab.benchmark.methods import chosen
from synfog_usd.lab.benchmark.pairs import find, truth_of

Item = TypeVar("Item")


def defog(
    source: Path,
    out: Path,
    *,
    words: Sequence[str],
    picture: str,
    clear: str,
    split: str,
    limit: int | None,
    retry: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Run the bench; the exit code is 1 where a method gave no answer at all, 130 after Ctrl-C."""
    methods = chosen(words)
    pairs = find(source, picture=picture, clear=clear, split=split)
    pairs = _spread(pairs, limit)
    with _kept_in(out), shown(quiet) as (progress, log):
        bench = bench_of.run(pairs, methods, out, retry=retry, progress=progress, log=log)
    rows = page.rows(bench)
    page.write(bench, rows, out)
    if as_json:
        found = [
            {"method": method.name, "rank": rank, **{name: dataclasses.asdict(one) for name, one in means.items()}}
            for method, rank, means in rows
        ]
        print(json.dumps(found, indent=2))
    elif not quiet:
        print(page.markdown(bench, rows))
        print(f"{out / 'pictures.png'} shows them side by side")
    _refuse_silence(bench, out)


def compare(mine: Path, shot: Path, *, picture: str, clear: str, as_json: bool) -> None:
    """Print how far a picture is from the one without fog."""
    truth = truth_of(shot, picture=picture, clear=clear)
    found = metrics.measure(picture_of(mine), picture_of(truth))
    if as_json:
        print(json.dumps({"picture": str(mine), "truth": str(truth), **found}, indent=2))
        return
    print(f"{mine} against {truth}:")
    for name, value in found.items():
        print(f"{metrics.METRICS[name].title:10} {value:.{metrics.METRICS[name].decimals}f}")


def detect(
    source: Path,
    out: Path,
    *,
    models: Sequence[str],
    before: Sequence[str],
    picture: str,
    split: str,
    limit: int | None,
    least_px: int,
    retry: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Run the bench; exit codes as `defog` has them."""
    found = detectors.chosen(models)
    defoggers = [None, *(chosen(before) if before else ())]
    runs = [detection.DetectorRun(one, first) for one in found for first in defoggers]
    views = _spread(detection.find(source, picture=picture, split=split), limit)
    with _kept_in(out), shown(quiet) as (progress, log):
        bench = detection.run(views, runs, out, retry=retry, progress=progress, log=log)
    scored = {one.name: detection.scores(bench, one, least_px=least_px) for one in runs}
    answered = [one for one in runs if scored[one.name].pictures]
    ranks = detection.ranks(bench, answered, least_px=least_px)
    for name, rows in detection.gains(bench, answered, least_px=least_px).items():
        scored[name].rows += rows
    scored = {name: scored[name] for name in ranks}
    detect_page.write(bench, scored, ranks, out)
    if as_json:
        rows = [
            {"detector": name, "rank": ranks[name], **dataclasses.asdict(row), "value": _number(row.value)}
            for name, scores in scored.items()
            for row in scores.rows
        ]
        print(json.dumps(rows, indent=2))
    elif not quiet:
        print(detect_page.markdown(bench, scored, ranks))
        print(f"{out / 'pictures.png'} shows boxes")
    _refuse_silence(bench, out)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _spread(items: list[Item], limit: int | None) -> list[Item]:
    if limit is None or limit >= len(items):
        return items
    return [items[number * len(items) // limit] for number in range(limit)]


@contextlib.contextmanager
def _kept_in(out: Path) -> Iterator[None]:
    """Say after Ctrl-C that nothing is lost."""
    try:
        yield
    except KeyboardInterrupt:
        print(f"synfog-usd: stopped. What was measured is kept in {out}; the same command goes on", file=sys.stderr)
        raise typer.Exit(worker.INTERRUPTED) from None


def _refuse_silence(bench: Bench, out: Path) -> None:
    """Exit code 1 where a method gave no answer at all."""
    silent = [method.name for method in bench.methods if len(bench.failures(method)) == len(bench.items)]
    if silent:
        print(f"synfog-usd: {', '.join(silent)} gave no answer at all; see {out / 'table.md'}", file=sys.stderr)
        raise typer.Exit(1)

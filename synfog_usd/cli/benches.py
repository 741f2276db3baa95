"""What the verbs of `synfog-usd benchmark` do and print."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown
from synfog_usd.lab.benchmark import defog as bench_of
from synfog_usd.lab.benchmark import detect as detection
from synfog_usd.lab.benchmark import detect_page, detectors, metrics, page
from synfog_usd.lab.benchmark.bench import Bench
from synfog_usd.lab.benchmark.child import picture as picture_of
from synfog_usd.lab.benchmark.methods import chosen
from synfog_usd.lab.benchmark.pairs import find, truth_of

if TYPE_CHECKING:
    from synfog_usd.cli.benchmark import DefogWords, DetectWords

Item = TypeVar("Item")


def defog(words: DefogWords) -> None:
    """Run the bench; the exit code is 1 where a method gave no answer at all, 130 after Ctrl-C."""
    methods = chosen(_names(words.methods))
    pairs = find(words.source, picture=words.picture, clear=words.clear, split=words.split)
    pairs = _spread(pairs, words.limit)
    with _kept_in(words.out), shown(words.quiet) as (progress, log):
        bench = bench_of.run(pairs, methods, words.out, retry=words.retry, progress=progress, log=log)
    rows = page.rows(bench)
    page.write(bench, rows, words.out)
    if words.as_json:
        table = [
            {"method": method.name, "rank": rank, **{name: dataclasses.asdict(mean) for name, mean in means.items()}}
            for method, rank, means in rows
        ]
        print(json.dumps(table, indent=2))
    elif not words.quiet:
        print(page.markdown(bench, rows))
        print(f"{words.out / 'pictures.png'} shows them side by side")
    _refuse_silence(bench, words.out)


def compare(mine: Path, shot: Path, *, picture: str, clear: str, as_json: bool) -> None:
    """Print how far a picture is from the one without fog."""
    truth = truth_of(shot, picture=picture, clear=clear)
    distances = metrics.measure(picture_of(mine), picture_of(truth))
    if as_json:
        print(json.dumps({"picture": str(mine), "truth": str(truth), **distances}, indent=2))
        return
    print(f"{mine} against {truth}:")
    for name, value in distances.items():
        print(f"{metrics.METRICS[name].title:10} {value:.{metrics.METRICS[name].decimals}f}")


def detect(words: DetectWords) -> None:
    """Run the bench; exit codes as `defog` has them."""
    models = detectors.chosen(words.model)
    defoggers = [None, *(chosen(names) if (names := _names(words.before)) else ())]
    runs = [detection.DetectorRun(model, defogger) for model in models for defogger in defoggers]
    views = _spread(detection.find(words.source, picture=words.picture, split=words.split), words.limit)
    with _kept_in(words.out), shown(words.quiet) as (progress, log):
        bench = detection.run(views, runs, words.out, retry=words.retry, progress=progress, log=log)
    least_px = words.least_px
    scored = {run.name: detection.scores(bench, run, least_px=least_px) for run in runs}
    answered = [run for run in runs if scored[run.name].pictures]
    ranks = detection.ranks(bench, answered, least_px=least_px)
    scored = {name: scored[name] for name in ranks}
    detect_page.write(bench, scored, ranks, words.out)
    if words.as_json:
        table = [
            {"detector": name, "rank": ranks[name], **dataclasses.asdict(row), "value": _number(row.value)}
            for name, scores in scored.items()
            for row in scores.rows
        ]
        print(json.dumps(table, indent=2))
    elif not words.quiet:
        print(detect_page.markdown(bench, scored, ranks))
        print(f"{words.out / 'pictures.png'} shows boxes")
    _refuse_silence(bench, words.out)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


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

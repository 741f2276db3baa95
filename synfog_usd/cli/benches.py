"""What the verbs of `synfog-usd benchmark` do and print."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import typer

from synfog_usd.benchmark import defog as bench_of
from synfog_usd.benchmark import page
from synfog_usd.benchmark.methods import chosen
from synfog_usd.benchmark.pairs import find
from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown


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
    if limit is not None and limit < len(pairs):
        pairs = [pairs[number * len(pairs) // limit] for number in range(limit)]
    try:
        with shown(quiet) as (progress, log):
            bench = bench_of.run(pairs, methods, out, retry=retry, progress=progress, log=log)
    except KeyboardInterrupt:
        print(f"synfog-usd: stopped. What was measured is kept in {out}; the same command goes on", file=sys.stderr)
        raise typer.Exit(worker.INTERRUPTED) from None
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
    silent = [method.name for method in methods if len(bench.failures(method)) == len(pairs)]
    if silent:
        print(f"synfog-usd: {', '.join(silent)} gave no answer at all; see {out / 'table.md'}", file=sys.stderr)
        raise typer.Exit(1)

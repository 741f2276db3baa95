"""What the verbs of `synfog-usd dataset` that make and check sets do and print."""

from __future__ import annotations

import dataclasses
import json
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import typer

from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown
from synfog_usd.sets import journal
from synfog_usd.sets.definition import load_set
from synfog_usd.sets.run import Outcome, RunPlan, numbers_of
from synfog_usd.sets.run import run as make
from synfog_usd.sets.scenes import Unit
from synfog_usd.sets.work import Child, told

CHILD = Child(("-m", "synfog_usd.cli.main", "dataset", "unit"), worker.MARK, worker.FOREIGN)


def run(file: Path | None, out: Path, *, only: str | None, quiet: bool, as_json: bool, **more: Any) -> None:
    """Make a set; the exit code is 1 where units were set aside or a budget stopped it, 130 after Ctrl-C."""
    found = load_set(file) if file is not None else journal.kept_definition(out)
    numbers = numbers_of(only, found.scenes) if only is not None else None
    plan = RunPlan(out=out, child=CHILD, only=numbers, **more)

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, stop)
    try:
        with shown(quiet) as (progress, log):
            outcome = make(found, plan, progress=progress, log=log)
    except KeyboardInterrupt:
        again = f"synfog-usd dataset run {file} -o {out}" if file else f"synfog-usd dataset retry {out}"
        print(f"synfog-usd: stopped. Finished units are kept in {out}; {again} goes on from there", file=sys.stderr)
        raise typer.Exit(worker.INTERRUPTED) from None
    _report(outcome, out, quiet=quiet, as_json=as_json)


def _report(outcome: Outcome, out: Path, *, quiet: bool, as_json: bool) -> None:
    if as_json:
        print(json.dumps(dataclasses.asdict(outcome), indent=2))
    elif not quiet:
        print(f"{out}: {outcome.made} units made, {outcome.kept} were there, {len(outcome.aside)} set aside")
    for name, line in outcome.aside.items():
        print(f"synfog-usd: {name} (seed {line['seed']}) is set aside: {line['error']}", file=sys.stderr)
    if outcome.aside:
        print(f"synfog-usd: synfog-usd dataset retry {out} takes them up", file=sys.stderr)
    if outcome.stopped:
        print(f"synfog-usd: {outcome.stopped}", file=sys.stderr)
    if outcome.aside or outcome.stopped:
        raise typer.Exit(1)


def unit(out: Path, number: int, lighting: str, camera: str, *, repair: bool, variant: str) -> None:
    """Make one unit; in a worker's child, the child itself."""
    if not worker.is_worker():
        code = worker.run(sys.argv[1:])
        raise typer.Exit(2 if code < 0 else code)
    worker.follow_parent()
    from synfog_usd.render import backend
    from synfog_usd.sets import identity
    from synfog_usd.sets.unit import make as make_unit

    def made() -> dict[str, Any]:
        found = journal.kept_definition(out)
        identity.check(out, identity.identity(found, backend.choose(variant).variant))  # type: ignore[arg-type]
        which = Unit(number, lighting, camera)
        return make_unit(found, out, which, variant=variant, repair=repair, reading=worker.reading_limits)

    result, code = told(made)
    print(json.dumps(result))
    raise typer.Exit(code)

"""`synfog-usd bake`: the parent that waits and the child that shows progress."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown
from synfog_usd.dataset.plan import BakePlan

if TYPE_CHECKING:
    from synfog_usd.scene import Note

REMARKS = 5
"""How many remarks are printed; warnings all are."""


def run(plan: dict[str, Any], *, quiet: bool, as_json: bool) -> None:
    """Bake as the command line asked for; raises `typer.Exit` where the code is not 0."""
    asked = BakePlan(**plan)  # numbers that make no sense are refused before a process is begun or anything is written
    if not worker.is_worker():
        code = worker.run(sys.argv[1:])
        if code == worker.INTERRUPTED or code < 0:
            _tidy(plan["out"], code, plan["stage"])
        raise typer.Exit(2 if code < 0 else code)
    worker.follow_parent()
    from synfog_usd.dataset.bake import bake

    with shown(quiet) as (progress, log):
        baked = bake(asked, progress=progress, log=log, reading=worker.reading_limits)
        if not quiet:
            _report(baked.notes, plan["stage"], log)
    if as_json:
        print(json.dumps({**baked.manifest, "seconds": baked.seconds, "kept": baked.kept}, indent=2))
    elif not quiet:
        print(f"{len(baked.manifest['shots'])} shots in {plan['out']}: look at {plan['out'] / 'contact.png'}")


def _report(notes: Sequence[Note], stage: Path, log: Callable[[str], None]) -> None:
    """Every warning, and the first few remarks; all of them stand in `bake.json`."""
    remarks = [note for note in notes if note.severity != "warning"]
    for note in [*(note for note in notes if note.severity == "warning"), *remarks[:REMARKS]]:
        log(f"{note.severity}: {note.path or stage}: {note.text}")
    if len(remarks) > REMARKS:
        log(f"and {len(remarks) - REMARKS} more remarks, see 'notes' in bake.json")


def _tidy(out: Path, code: int, stage: Path) -> None:
    from synfog_usd import files

    finished = 0
    with contextlib.suppress(OSError, ValueError, KeyError):
        files.remove_leftovers(out)
        finished = len(json.loads((out / "bake.json").read_bytes())["shots"])
    kept = f"{finished} finished shots are kept in {out}; the same command goes on from there"
    if code == worker.INTERRUPTED:
        print(f"synfog-usd: stopped. {kept}", file=sys.stderr)
    else:
        print(f"{worker.crash_line(code, stage, 'read and rendered it')}. {kept}", file=sys.stderr)

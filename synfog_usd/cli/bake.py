"""`synfog-usd bake`: the parent that waits and the child that shows progress."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown


def run(plan: dict[str, Any], *, quiet: bool, as_json: bool) -> None:
    """Bake as the command line asked for; raises `typer.Exit` where the code is not 0."""
    if not worker.is_worker():
        code = worker.run(sys.argv[1:])
        if code == worker.INTERRUPTED or code < 0:
            _tidy(plan["out"], code, plan["stage"])
        raise typer.Exit(2 if code < 0 else code)
    worker.follow_parent()
    from synfog_usd.dataset.bake import BakePlan, bake

    with shown(quiet) as (progress, tell):
        baked = bake(BakePlan(**plan), progress=progress, tell=tell)
        if not quiet:
            for note in baked.notes:
                tell(f"{note.severity}: {note.path or plan['stage']}: {note.text}")
    if as_json:
        print(json.dumps({**baked.manifest, "seconds": baked.seconds, "kept": baked.kept, "notes": [asdict(note) for note in baked.notes]}, indent=2))
    elif not quiet:
        print(f"{len(baked.manifest['shots'])} shots in {plan['out']}: look at {plan['out'] / 'contact.png'}")


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
        print(
            f"synfog-usd: {stage}: the process that read and rendered it died of signal {-code} (9: out of memory, 11: damaged stage). {kept}", file=sys.stderr
        )

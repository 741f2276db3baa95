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
from synfog_usd.dataset.job import BakeJob, job_of
from synfog_usd.dataset.job import run as make

if TYPE_CHECKING:
    from synfog_usd.base.notes import Note
    from synfog_usd.dataset.bake import Baked

REMARKS = 5
"""How many remarks are printed; warnings all are."""


def run(options: dict[str, Any]) -> None:
    """Bake as the command line asked for; raises `typer.Exit` where the code is not 0.

    Args:
        options: for `job_of`.
    """
    job = job_of(**options)  # what makes no sense is refused before a process is begun or anything is written
    plan = job.plan
    if not worker.is_worker():
        code = worker.run(sys.argv[1:])
        if code == worker.INTERRUPTED or code < 0:
            _tidy(plan.out, code, plan.stage, frames=job.codes is not None)
        raise typer.Exit(2 if code < 0 else code)
    worker.follow_parent()
    with shown(quiet=False) as (progress, log):
        baked = make(job, progress=progress, log=log, reading=worker.reading_limits)
        _report(baked.notes, plan.stage, log)
    print(_summary(job, baked))


def _summary(job: BakeJob, baked: Baked) -> str:
    """How many shots, cameras or frames there are now, and where."""
    out, manifest = job.plan.out, baked.manifest
    if job.codes is not None:
        frames = f"{len(job.codes)} frame{'s' * (len(job.codes) > 1)}"
        if isinstance(manifest, list):
            return f"{frames} of each of {len(manifest)} cameras in {out}: rig.json lists their folders"
        return f"{frames} in {out}: {', '.join(manifest['clips'])}"
    if "cameras" in manifest:
        sheets = ", ".join(str(out / row["folder"] / "contact.png") for row in manifest["cameras"])
        return f"{len(manifest['cameras'])} cameras in {out}: look at {sheets}"
    return f"{len(manifest['shots'])} shots in {out}: look at {out / 'contact.png'}"


def _report(notes: Sequence[Note], stage: Path, log: Callable[[str], None]) -> None:
    """Every warning, and the first few remarks; all of them stand in `bake.json`."""
    remarks = [note for note in notes if note.severity != "warning"]
    for note in [*(note for note in notes if note.severity == "warning"), *remarks[:REMARKS]]:
        log(f"{note.severity}: {note.path or stage}: {note.text}")
    if len(remarks) > REMARKS:
        log(f"and {len(remarks) - REMARKS} more remarks, see 'notes' in bake.json")


def _tidy(out: Path, code: int, stage: Path, *, frames: bool) -> None:
    from synfog_usd.base import files

    kinds, finished = "shots", 0
    with contextlib.suppress(OSError, ValueError, KeyError):
        files.remove_leftovers(out)
        manifests = [path for path in (out / "bake.json", *sorted(out.glob("*/bake.json"))) if path.is_file()]
        finished = sum(len(json.loads(path.read_bytes())["shots"]) for path in manifests)
    if frames:
        kinds, finished = "frames", sum(1 for _ in out.glob("[0-9]*/bake.json"))
    ending = f"{finished} finished {kinds} are kept in {out}; the same command goes on from there"
    if code == worker.INTERRUPTED:
        print(f"synfog-usd: stopped. {ending}", file=sys.stderr)
    else:
        print(f"{worker.crash_line(code, stage, 'read and rendered it')}. {ending}", file=sys.stderr)

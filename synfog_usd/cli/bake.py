"""`synfog-usd bake`: the parent that waits and the child that shows progress."""

from __future__ import annotations

import contextlib
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown
from synfog_usd.dataset.plan import BakePlan, frame_codes
from synfog_usd.errors import ParameterError

if TYPE_CHECKING:
    from synfog_usd.scene import Note

REMARKS = 5
"""How many remarks are printed; warnings all are."""


def run(
    plan: dict[str, Any],
    *,
    cameras: Sequence[str] | None,
    frames: str | None,
    adaptation_s: float,
    quiet: bool,
    as_json: bool,
) -> None:
    """Bake as the command line asked for; raises `typer.Exit` where the code is not 0."""
    asked = BakePlan(**plan)  # numbers that make no sense are refused before a process is begun or anything is written
    codes = None if frames is None else frame_codes(frames)
    if codes is not None and asked.frame is not None:
        raise ParameterError("--frame and --frames: either one time code or several; leave one out")
    if not 0.0 <= adaptation_s < math.inf:
        raise ParameterError(f"--adaptation {adaptation_s:g}: it takes seconds, 0 and more")
    if not worker.is_worker():
        code = worker.run(sys.argv[1:])
        if code == worker.INTERRUPTED or code < 0:
            _tidy(plan["out"], code, plan["stage"], frames=codes is not None)
        raise typer.Exit(2 if code < 0 else code)
    worker.follow_parent()
    if codes is not None:
        _sequence(asked, cameras, codes, adaptation_s, quiet=quiet, as_json=as_json)
        return
    from synfog_usd.dataset.bake import bake
    from synfog_usd.dataset.rig import bake_cameras

    rig = None
    with shown(quiet) as (progress, log):
        if cameras is None:
            baked = bake(asked, progress=progress, log=log, reading=worker.reading_limits)
        else:
            rig, baked = bake_cameras(asked, cameras, progress=progress, log=log, reading=worker.reading_limits)
        if not quiet:
            _report(baked.notes, plan["stage"], log)
    if rig is not None:
        _tell_rig(rig, asked, quiet=quiet, as_json=as_json)
    elif as_json:
        print(json.dumps({**baked.manifest, "seconds": baked.seconds, "kept": baked.kept}, indent=2))
    elif not quiet:
        print(f"{len(baked.manifest['shots'])} shots in {plan['out']}: look at {plan['out'] / 'contact.png'}")


def _tell_rig(rig: dict[str, Any], plan: BakePlan, *, quiet: bool, as_json: bool) -> None:
    if as_json:
        print(json.dumps(rig, indent=2))
    elif not quiet:
        sheets = ", ".join(str(plan.out / row["folder"] / "contact.png") for row in rig["cameras"])
        print(f"{len(rig['cameras'])} cameras in {plan.out}: look at {sheets}")


def _sequence(
    plan: BakePlan,
    names: Sequence[str] | None,
    codes: Sequence[float],
    adaptation_s: float,
    *,
    quiet: bool,
    as_json: bool,
) -> None:
    """A sequence, or one for each of several cameras."""
    from synfog_usd.dataset.rig import apart
    from synfog_usd.dataset.sequence import bake_sequence

    plans = [plan] if names is None else apart(plan, names, reading=worker.reading_limits)
    found = []
    for number, one in enumerate(plans):
        with shown(quiet) as (progress, log):
            told, first = bake_sequence(
                one, codes, adaptation_s=adaptation_s, progress=progress, log=log, reading=worker.reading_limits
            )
            if not quiet and not number:
                _report(first.notes, plan.stage, log)
        found.append(told)
        if not quiet and not as_json:
            print(f"{len(codes)} frames in {one.out}: {', '.join(told['clips'])}")
    if as_json:
        print(json.dumps(found[0] if len(found) == 1 else found, indent=2))


def _report(notes: Sequence[Note], stage: Path, log: Callable[[str], None]) -> None:
    """Every warning, and the first few remarks; all of them stand in `bake.json`."""
    remarks = [note for note in notes if note.severity != "warning"]
    for note in [*(note for note in notes if note.severity == "warning"), *remarks[:REMARKS]]:
        log(f"{note.severity}: {note.path or stage}: {note.text}")
    if len(remarks) > REMARKS:
        log(f"and {len(remarks) - REMARKS} more remarks, see 'notes' in bake.json")


def _tidy(out: Path, code: int, stage: Path, *, frames: bool) -> None:
    from synfog_usd import files

    kinds, finished = "shots", 0
    with contextlib.suppress(OSError, ValueError, KeyError):
        files.remove_leftovers(out)
        made = [path for path in (out / "bake.json", *sorted(out.glob("*/bake.json"))) if path.is_file()]
        finished = sum(len(json.loads(path.read_bytes())["shots"]) for path in made)
    if frames:
        kinds, finished = "frames", sum(1 for _ in out.glob("[0-9]*/bake.json"))
    kept = f"{finished} finished {kinds} are kept in {out}; the same command goes on from there"
    if code == worker.INTERRUPTED:
        print(f"synfog-usd: stopped. {kept}", file=sys.stderr)
    else:
        print(f"{worker.crash_line(code, stage, 'read and rendered it')}. {kept}", file=sys.stderr)

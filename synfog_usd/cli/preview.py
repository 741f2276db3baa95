"""`synfog-usd preview`: a small clean bake, its pictures in the terminal, and again on each save."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import typer

from synfog_usd.base import resources
from synfog_usd.base.errors import SynfogError
from synfog_usd.base.fence import LAYERS
from synfog_usd.cli import terminal, worker
from synfog_usd.cli.progress import shown
from synfog_usd.dataset.asked import plan_of
from synfog_usd.dataset.plan import BakePlan

LOOK_EVERY_S = 0.5
"""Between two looks at the files; a save is taken up once nothing has changed from one look to the next."""

MOST_BESIDE = 10_000
"""Files of the stage's folder that are looked through where the stage cannot list its own files."""

State = dict[Path, tuple[int, int, int]]


def run(plan: dict[str, Any], *, watch: bool, how: terminal.Kind | None, quiet: bool) -> None:
    """Bake small as the command line asked for, and show it; with `watch` until Ctrl-C.

    Args:
        plan: for `plan_of`.
        watch: bake again on every save of a file that the stage is made of.
        how: how the terminal draws; None asks it.
        quiet: print errors only.
    """
    bake_plan = plan_of(**plan)
    if not worker.is_worker():
        raise typer.Exit(_waited_for(bake_plan, watch))
    worker.follow_parent()
    how = how or terminal.kind()
    while True:
        before = _state(_made_of(bake_plan)) if watch else {}
        try:
            _once(bake_plan, how, quiet)
        except SynfogError as error:
            if not watch:
                raise
            print(f"synfog-usd: {error}", file=sys.stderr, flush=True)
        if not watch:
            return
        changed = _next_save(before)
        if not quiet:
            print(f"{', '.join(path.name for path in changed)} saved", file=sys.stderr, flush=True)


def _once(plan: BakePlan, how: terminal.Kind, quiet: bool) -> None:
    """One bake, shown."""
    from PIL import Image

    from synfog_usd.dataset.bake import bake

    began = time.monotonic()
    with shown(quiet) as (progress, log):
        baked = bake(plan, progress=progress, log=log, reading=worker.reading_limits)
    for shot in baked.manifest["shots"] if how != "none" else ():
        folder = plan.out / shot["folder"]
        for name in [name for name in shot["files"] if name.endswith(".png")][:1]:
            with Image.open(folder / name) as picture:
                print(
                    f"{shot['lighting']} / {shot['fog']}\n{terminal.as_text(picture, how, terminal.columns())}", end=""
                )
    if not quiet:
        print(
            f"{len(baked.manifest['shots'])} pictures in {time.monotonic() - began:.0f} s: {plan.out / 'contact.png'}",
            flush=True,
        )


def _waited_for(plan: BakePlan, watch: bool) -> int:
    """In the parent: the child's exit code; where a file kills the child, another begins at the next save."""
    from synfog_usd.base import files

    while True:
        before = _state(_beside(plan.stage)) if watch else {}
        code = worker.run(sys.argv[1:])
        if code == worker.INTERRUPTED or code < 0:
            with contextlib.suppress(OSError):
                files.remove_leftovers(plan.out)
        if code >= 0:
            return code
        print(worker.crash_line(code, plan.stage, "drew it"), file=sys.stderr)
        if not watch:
            return 2
        _next_save(before)


def _made_of(plan: BakePlan) -> list[Path]:
    """Files that a save of which may change the pictures: those that the stage tells, or all layers beside it."""
    from synfog_usd import stage as usd

    mine = [plan.stage, resources.named(plan.pipeline or Path("phone"), "pipeline")]
    try:
        with worker.reading_limits():
            return [*mine, *usd.dependencies(usd.open_stage(plan.stage, allow=plan.allow))]
    except SynfogError:
        return [*mine, *_beside(plan.stage)]


def _beside(stage: Path) -> list[Path]:
    """The stage, and the layers in its folder and below."""
    below = islice(stage.parent.rglob("*"), MOST_BESIDE)
    return [stage, *(path for path in below if path.suffix.lower() in LAYERS)]


def _state(paths: Iterable[Path]) -> State:
    """What of a file changes with each save, however an editor saves; zeros where it is not there."""
    state: State = {}
    for path in paths:
        state[path] = (0, 0, 0)
        with contextlib.suppress(OSError):
            status = path.stat()
            state[path] = (status.st_mtime_ns, status.st_size, status.st_ino)
    return state


def _next_save(before: State) -> list[Path]:
    """Wait for another state of any of the files, and until it stays; the files that differ."""
    last = before
    while True:
        time.sleep(LOOK_EVERY_S)
        now = _state(before)
        if now == last and now != before:
            return [path for path in now if now[path] != before[path]]
        last = now

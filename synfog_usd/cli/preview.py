"""`synfog-usd preview`: a small clean bake, and again on each save."""

from __future__ import annotations

import contextlib
import sys
import time
from itertools import islice
from pathlib import Path
from typing import Any

import typer

from synfog_usd.base import files, resources
from synfog_usd.base.fence import LAYERS
from synfog_usd.cli import worker
from synfog_usd.cli.progress import shown
from synfog_usd.dataset.asked import plan_of
from synfog_usd.dataset.plan import BakePlan

LOOK_EVERY_S = 0.5
"""Between two looks at the files; a save is taken up when nothing has changed from one look to the next."""

MOST_FILES = 10_000
"""Files of the stage's folder that are looked through."""

State = dict[Path, tuple[int, int, int]]


def run(options: dict[str, Any], *, watch: bool, quiet: bool) -> None:
    """Bake small as the command line says; raises `typer.Exit` where the code is not 0.

    Args:
        options: for `plan_of`.
        watch: bake again on each save of a layer in the stage's folder, or of the node graph, until Ctrl-C.
        quiet: print errors only.
    """
    plan = plan_of(**options)
    if worker.is_worker():
        worker.follow_parent()
        _bake(plan, quiet)
        return
    while True:
        before = _state(plan)
        code = worker.run(sys.argv[1:])
        if code < 0 or code == worker.INTERRUPTED:
            with contextlib.suppress(OSError):
                files.remove_leftovers(plan.out)
        if code < 0:
            print(worker.crash_line(code, plan.stage, "drew it"), file=sys.stderr)
        if not watch or code == worker.INTERRUPTED:
            raise typer.Exit(2 if code < 0 else code)
        saved = _next_save(plan, before)
        if not quiet:
            print(f"{', '.join(path.name for path in saved)} saved", file=sys.stderr, flush=True)


def _bake(plan: BakePlan, quiet: bool) -> None:
    from synfog_usd.dataset.bake import bake

    began = time.monotonic()
    with shown(quiet) as (progress, log):
        baked = bake(plan, progress=progress, log=log, reading=worker.reading_limits)
    if not quiet:
        seconds = time.monotonic() - began
        print(f"{len(baked.manifest['shots'])} pictures in {seconds:.0f} s: {plan.out / 'contact.png'}", flush=True)


def _state(plan: BakePlan) -> State:
    """Per layer in the stage's folder and below, and of the node graph, what changes with each save."""
    below = islice(plan.stage.parent.rglob("*"), MOST_FILES)
    layers = [path for path in below if path.suffix.lower() in LAYERS]
    state: State = {}
    for path in (plan.stage, resources.named(plan.pipeline or Path("phone"), "pipeline"), *layers):
        state[path] = (0, 0, 0)
        with contextlib.suppress(OSError):
            status = path.stat()
            state[path] = (status.st_mtime_ns, status.st_size, status.st_ino)
    return state


def _next_save(plan: BakePlan, before: State) -> list[Path]:
    """Wait for another state of any of the files, and until it stays; the files that differ."""
    last = before
    while True:
        time.sleep(LOOK_EVERY_S)
        now = _state(plan)
        if now == last and now != before:
            return [path for path in now if now[path] != before.get(path)]
        last = now

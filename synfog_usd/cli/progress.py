"""Progress on standard error: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

PLAIN_INTERVAL_S = 5.0

LEAST_DONE = 0.05
"""Share of the work that is done before a bar estimates the time that is left."""


@contextlib.contextmanager
def shown(quiet: bool) -> Iterator[tuple[Callable[[str, float], None], Callable[[str], None]]]:
    """Whom to tell the fraction that is done, and a log that takes a line; a bar shows the time left."""
    if quiet:
        yield (lambda what, fraction: None), (lambda text: None)
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, highlight=False, soft_wrap=True)
    if not console.is_terminal:
        yield _plain_progress(), lambda text: print(text, file=sys.stderr, flush=True)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task, began = bar.add_task("starting", total=1.0, left=""), time.monotonic()

        def progress(what: str, fraction: float) -> None:
            bar.update(
                task, description=escape(what), completed=fraction, left=_left(time.monotonic() - began, fraction)
            )

        yield progress, (lambda text: console.print(escape(text)))


def _left(spent_s: float, fraction: float) -> str:
    """Estimate of the remaining time."""
    return f"about {spent_s / fraction - spent_s:.0f} s left" if LEAST_DONE <= fraction < 1.0 else ""


def _plain_progress() -> Callable[[str, float], None]:
    began, last = time.monotonic(), [0.0]

    def progress(what: str, fraction: float) -> None:
        now = time.monotonic() - began
        if now - last[0] < PLAIN_INTERVAL_S:
            return
        last[0] = now
        print(
            f"{fraction:4.0%}  {what}  {now:.0f} s" + (f", {remaining}" if (remaining := _left(now, fraction)) else ""),
            file=sys.stderr,
            flush=True,
        )

    return progress

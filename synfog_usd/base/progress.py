"""Progress as a small protocol, so that no room below the command line knows a terminal."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction of it that is done, 0 to 1."""


def silent(what: str, fraction: float) -> None:
    """Tell nobody."""


def within(progress: Progress, low: float, high: float) -> Progress:
    """Progress of a part that goes from one fraction of the whole to another."""
    return lambda what, fraction: progress(what, low + (high - low) * fraction)


def named(progress: Progress, name: str) -> Progress:
    """Progress of one part, with the part's name before what it does."""
    return lambda what, fraction: progress(f"{name}: {what}", fraction)

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


def duration(value: float) -> str:
    """Seconds with two or three digits in the unit that fits.

    >>> duration(7200.0), duration(449.0), duration(0.432)
    ('2.0 h', '7.5 min', '0.43 s')
    """
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if value >= 2.0 * size:
            return f"{value / size:,.0f} {unit}" if value >= 10.0 * size else f"{value / size:.1f} {unit}"
    return f"{value:.0f} s" if value >= 9.95 else f"{value:.2g} s"

"""What a chart says in words: seconds to a target, and how much sooner than the best peer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from synfog_usd.base.progress import duration
from synfog_usd.lab.points import Point, summary


def verdicts(points: Sequence[Point]) -> list[str]:
    """A sentence a target: what gets there first, and how much sooner than the best peer."""
    return [sentence(row) for row in summary(points)]


def sentence(row: Mapping[str, Any]) -> str:
    """A row of the summary in words."""
    target = target_words(row["measure"], float(row["target"]))
    if not row["best"]:
        return f"{target}: none of our models." + (
            f" {row['peer']} takes {seconds(row, 'peer')}." if row["peer"] else ""
        )
    text = f"{target}: {row['best']} in {seconds(row, 'best')}"
    if row["unbiased"] and row["unbiased"] != row["best"]:
        text += f", without bias {row['unbiased']} in {seconds(row, 'unbiased')}"
    if row["peer"]:
        text += f"; {row['peer']} takes {seconds(row, 'peer')}, {times(row, 'best')}"
    return text + "."


def target_words(measure: str, target: float) -> str:
    """'1 % error', '1 % mottle'."""
    return f"{100 * target:g} % {measure}"


def seconds(row: Mapping[str, Any], who: str) -> str:
    """'1.2 s', '~1.2 s' where it is extrapolated, '' where there is none."""
    if row[f"{who}_seconds"] == "":
        return ""
    value, beyond = float(row[f"{who}_seconds"]), float(row[f"{who}_beyond"])
    return f"~{duration(value)}" if beyond > 1.0 else duration(value)


def times(row: Mapping[str, Any], who: str) -> str:
    """'12 times as long', of the best peer over one of ours; '' where one of them is missing."""
    return f"{ratio(row, who)[:-1]} times as long" if row[f"{who}_speedup"] != "" else ""


def ratio(row: Mapping[str, Any], who: str = "best") -> str:
    """'12x', '' where there is no ratio."""
    if row[f"{who}_speedup"] == "":
        return ""
    value = float(row[f"{who}_speedup"])
    return f"{value:.0f}x" if value >= 9.95 else f"{value:.1f}x"

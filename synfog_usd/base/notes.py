"""What is said about a stage beside errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Note:
    """Something that the translation left out or made simpler.

    Attributes:
        severity: 'info' (a choice that was made), 'warning' (the picture differs
            from what the author meant).
        path: prim path, or '' for the stage.
        text: what was found and what became of it.
    """

    severity: Literal["info", "warning"]
    path: str
    text: str

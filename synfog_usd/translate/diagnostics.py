"""Notes on what the translation leaves out or makes simpler, collected while it runs."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Literal

from synfog_usd.base.notes import Note

MAX_SAME = 10
"""Notes of the same text that are listed; the rest is counted."""


class Diagnostics:
    """Notes in the order in which they came, each (path, text) once."""

    def __init__(self) -> None:
        self._by_text: dict[tuple[Literal["info", "warning"], str], dict[str, None]] = {}

    @property
    def count(self) -> int:
        """Number of notes."""
        return sum(map(len, self._by_text.values()))

    def info(self, path: object, text: str) -> None:
        """A choice that was made."""
        self._by_text.setdefault(("info", text), {})[str(path)] = None

    def warn(self, path: object, text: str) -> None:
        """The picture differs from what the author meant."""
        self._by_text.setdefault(("warning", text), {})[str(path)] = None

    def token(self, path: object, name: str, value: object, allowed: Collection[str], fallback: str) -> str:
        """A token if it is allowed; the fallback for None, and with a warning for any other."""
        if value is None or str(value) in allowed:
            return fallback if value is None else str(value)
        words = ", ".join(allowed)
        self.warn(path, f"{name} is {str(value)[:40]!r}, which is none of {words}; {fallback!r} is taken")
        return fallback

    def extend(self, notes: list[Note]) -> None:
        """Take over notes of another room."""
        for note in notes:
            self._by_text.setdefault((note.severity, note.text), {})[note.path] = None

    def closed(self, authored: Callable[[str], str] = str) -> tuple[Note, ...]:
        """All notes; of one text at most `MAX_SAME` and a count of the rest.

        Args:
            authored: from the path of a prim to where its author finds it.
        """
        notes = []
        for (severity, text), paths in self._by_text.items():
            listed = list(dict.fromkeys(authored(path) for path in paths))
            notes += [Note(severity, path, text) for path in listed[:MAX_SAME]]
            if len(listed) > MAX_SAME:
                notes.append(Note(severity, listed[MAX_SAME], f"{text} (and {len(listed) - MAX_SAME - 1} more prims)"))
        return tuple(notes)

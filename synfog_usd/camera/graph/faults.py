"""Everything that is wrong with a file, reported together."""

from __future__ import annotations

from synfog_usd.base.errors import GraphError, SynfogError
from synfog_usd.base.yamlio import Place

MOST = 50
"""More faults than this in one file have one cause; the rest are only counted."""


class Faults:
    """Errors found so far, each with the place that it is about.

    Attributes:
        file: the file that is read; its faults are listed before those of files that it includes.
        error: kind of what is raised.
    """

    def __init__(self, file: str, error: type[SynfogError] = GraphError) -> None:
        self.file, self.error = file, error
        self._found: dict[str, tuple[Place, SynfogError]] = {}

    def add(self, place: Place, text: str) -> None:
        """Note a fault."""
        self.take(place, self.error(f"{place}: {text}"))

    def take(self, place: Place, error: SynfogError) -> None:
        """Note an error that was raised elsewhere and says its place itself."""
        self._found.setdefault(str(error), (place, error))

    def check(self) -> None:
        """Go on only where nothing is wrong.

        Raises:
            SynfogError: the one error, as it is; or an `error` with a line for
                each of several, in the order of the file.
        """
        errors = [
            error
            for _, error in sorted(
                self._found.values(),
                key=lambda item: (item[0].file != self.file, item[0].file, item[0].line, item[0].column),
            )
        ]
        if len(errors) == 1:
            raise errors[0]
        if errors:
            more = [f"... and {len(errors) - MOST} more"] if len(errors) > MOST else []
            raise self.error("\n".join([f"{self.file}: {len(errors)} errors", *map(str, errors[:MOST]), *more]))

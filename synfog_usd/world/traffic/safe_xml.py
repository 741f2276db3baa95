"""XML of strangers: parsed in pieces, without document types and so without entities, within bounds.

Takes a file and what is to be done with its elements; faults are one line with the place.  Knows nothing of what
elements mean.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Protocol
from xml.parsers import expat

from synfog_usd.base.errors import RecipeError

MOST_BYTES, MOST_OF_A_TAG = 1 << 30, 1 << 20
"""Of a file, and of one element's start or of a comment."""


class Elements(Protocol):
    """What is done with a file's elements as they are parsed."""

    def start(self, place: ParserPlace, tag: str, attributes: dict[str, str]) -> None:
        """An element opens."""

    def end(self, place: ParserPlace, tag: str) -> None:
        """An element closes."""


class ParserPlace:
    """Where the parser is, and the numbers that it finds there.

    Args:
        path: of the file.
        kind: what the file is called in faults, as 'FCD'.
    """

    def __init__(self, path: Path, kind: str) -> None:
        self.path, self.kind = path, kind
        self.parser = expat.ParserCreate()
        self.parser.StartDoctypeDeclHandler = self._doctype

    def fault(self, text: str) -> RecipeError:
        """An error here."""
        return RecipeError(f"{self.path}:{self.parser.CurrentLineNumber}:{self.parser.CurrentColumnNumber + 1}: {text}")

    def _doctype(self, *_: object) -> None:
        """Refuse what may hold entities, before they are read."""
        raise self.fault(f"has a document type, which {self.kind} has not; remove it")

    def number(self, attributes: dict[str, str], key: str, label: str, fix: str = "add it") -> float:
        """An attribute that is finite, of an element that is called `label` in a fault."""
        if key not in attributes:
            raise self.fault(f"{label} has no {key}; {fix}")
        try:
            value = float(attributes[key])
        except ValueError:
            value = math.nan
        if not abs(value) < 1e7:
            raise self.fault(f"{label}: {key} is {attributes[key][:40]!r}; it takes a number between -1e7 and 1e7")
        return value


def parse(path: Path, kind: str, elements: Elements) -> None:
    """Hand a file's elements over, in their order.

    Raises:
        RecipeError: it cannot be read, is no XML, or is too large; says where.
    """
    place = ParserPlace(path, kind)
    place.parser.StartElementHandler = lambda tag, attributes: elements.start(place, tag, attributes)
    place.parser.EndElementHandler = lambda tag: elements.end(place, tag)
    try:
        with path.open("rb") as file:
            size = 0
            while chunk := file.read(1 << 16):
                size += len(chunk)
                place.parser.Parse(chunk)
                if size > MOST_BYTES or size - max(place.parser.CurrentByteIndex, 0) > MOST_OF_A_TAG:
                    raise place.fault(f"an element or the file is too long for {kind}; cut out a part")
            place.parser.Parse(b"", True)
    except OSError as error:
        raise RecipeError(f"{path}: cannot be read ({error.strerror})") from error
    except expat.ExpatError as error:
        text = expat.ErrorString(error.code)
        raise RecipeError(f"{path}:{error.lineno}:{error.offset + 1}: no XML: {text}; write it anew") from error
    except (LookupError, ValueError) as error:
        raise place.fault(f"no XML that can be read ({error}); write it in UTF-8") from error

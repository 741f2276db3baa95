"""Values that somebody gives in Python, where the command line has text: looked at, and refused in its words.

Takes any object; gives what was meant.  Imports nothing heavy.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from synfog_usd.base import numbers
from synfog_usd.base.errors import ParameterError, did_you_mean


def check_words(options: Mapping[str, Any], allowed: Mapping[str, Any]) -> None:
    """Refuse options that are not known.

    Raises:
        ParameterError: with those that are.
    """
    for word in options:
        if word not in allowed:
            raise ParameterError(f"no option {word!r}; it takes {', '.join(allowed)}.{did_you_mean(word, allowed)}")


def path_of(value: object, option: str) -> Path:
    """A path from text or a path.

    Raises:
        ParameterError: it is neither, or empty.
    """
    if not isinstance(value, (str, os.PathLike)) or not str(value).strip():
        raise ParameterError(f"{option} {value!r}: not the name of a file or folder")
    return Path(value)


def names(value: object, option: str) -> tuple[str, ...]:
    """Names from text with commas, or a list of text."""
    if isinstance(value, str):
        return numbers.names_of(value, option) or ()
    if not isinstance(value, (list, tuple)) or not value or not all(isinstance(name, str) for name in value):
        raise ParameterError(f"{option} {value!r}: it takes a name, or a list of names")
    return tuple(value)


def number(value: object, option: str) -> float:
    """A number, not text."""
    try:
        if isinstance(value, (str, bytes, bool)):
            raise TypeError
        return float(value)  # type: ignore[arg-type]
    except TypeError:
        raise ParameterError(f"{option} {value!r}: not a number") from None


def count(value: object, option: str) -> int:
    """A whole number, not text."""
    try:
        if isinstance(value, bool):
            raise TypeError
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise ParameterError(f"{option} {value!r}: not a whole number") from None


def word(value: object, option: str) -> str:
    """Text."""
    if not isinstance(value, str):
        raise ParameterError(f"{option} {value!r}: it takes a word")
    return value


def seconds(value: object, option: str) -> float:
    """Seconds, as a number or as 1/200."""
    return numbers.seconds_of(value, option) if isinstance(value, str) else number(value, option)


def switch(value: object, option: str) -> bool:
    """True or False."""
    if not isinstance(value, bool):
        raise ParameterError(f"{option} {value!r}: it takes True or False")
    return value

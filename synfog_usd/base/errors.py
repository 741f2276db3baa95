"""What goes wrong for a user, as exceptions that read as one clear line.

Every error says where, what was found, what is allowed and the likely fix.  The
command line prints the message and leaves with `exit_code`; nothing else is
caught there, so any other exception is a fault of ours and keeps its trace.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class SynfogError(Exception):
    """What a user can cause and mend: where, what was found, what is allowed, and the likely fix."""

    exit_code = 2


class ParameterError(SynfogError):
    """A value outside the range that the physics or the format allows."""


class StageError(SynfogError):
    """A USD stage that cannot be opened, or holds what cannot be rendered."""


class GraphError(SynfogError):
    """A node graph that does not load, or cannot run on what it was given."""


class RecipeError(SynfogError):
    """A recipe that does not load, or asks for what the world has no room for."""


class SetError(SynfogError):
    """A data set whose file does not load, or whose folder is not that set's."""


class ImageError(SynfogError):
    """An image file that cannot be read, or holds what no camera can see."""


class OutputError(SynfogError):
    """A place that cannot be written."""


class BackendError(SynfogError):
    """A Mitsuba variant that this machine does not run."""


def did_you_mean(word: str, allowed: Iterable[str]) -> str:
    """' Did you mean 'x'?' for the nearest of `allowed`, or '' where none is near."""
    near = difflib.get_close_matches(word, list(allowed), n=1, cutoff=0.55)
    return f" Did you mean {near[0]!r}?" if near else ""

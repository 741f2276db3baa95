"""The one import of colour-science: a quarter of a second, and with drawings that nobody asks for twice that."""

from __future__ import annotations

import sys
from types import ModuleType

_DRAWINGS = "colour.plotting"


def colour_science() -> ModuleType:
    """The module `colour`, imported on the first call; its `plotting`, which brings Matplotlib, stays out."""
    if "colour" in sys.modules:
        return sys.modules["colour"]
    sys.modules[_DRAWINGS] = ModuleType(_DRAWINGS)  # which `colour` looks for, and nothing in it
    try:
        import colour
    finally:
        del sys.modules[_DRAWINGS]
    return colour

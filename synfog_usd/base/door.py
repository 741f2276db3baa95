"""Names of a package that are imported when they are used.

Takes the name of a package, and of each name the module that has it; imports none of them.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from types import ModuleType
from typing import Any


class Door(ModuleType):
    """A package whose names are looked up in other modules.

    Python puts each imported module beside them, and one may have a name of theirs, as `render`: the name stays.
    """

    _places: Mapping[str, str] = {}
    """Name -> the module that has it."""

    def __getattr__(self, name: str) -> Any:
        if name not in self._places:
            raise AttributeError(
                f"module {self.__name__!r} has no attribute {name!r}; it has {', '.join(self._places)}"
            )
        value = getattr(importlib.import_module(self._places[name]), name)
        vars(self)[name] = value
        return value

    def __dir__(self) -> list[str]:
        return [*self._places, "__version__"]

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self._places or not isinstance(value, ModuleType):
            super().__setattr__(name, value)


def open_door(package: str, places: Mapping[str, str]) -> list[str]:
    """Offer names of other modules at a package.

    Args:
        package: `__name__` of the package.
        places: name -> the module that has it.

    Returns:
        `__all__` of the package.
    """
    door = sys.modules[package]
    door.__class__ = Door
    vars(door)["_places"] = places
    return sorted(places)

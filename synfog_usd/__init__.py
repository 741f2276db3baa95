"""What a real camera would have recorded of a USD scene in fog.

    import synfog_usd as sf

    scene = sf.load("street.usda", lighting="sky", fog=150)
    frame = sf.render(scene, quality="draft", seed=1)
    photo = sf.develop(frame, camera="phone")

Nothing is imported before a name is used.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synfog_usd.base.errors import SynfogError as SynfogError
    from synfog_usd.dataset.check import check as check
    from synfog_usd.dataset.frames import load as load
    from synfog_usd.dataset.frames import render as render
    from synfog_usd.dataset.job import bake as bake
    from synfog_usd.dataset.photo import develop as develop
    from synfog_usd.dataset.photo import shipped as cameras
    from synfog_usd.dataset.sets.index import pictures as pictures
    from synfog_usd.dataset.sets.run import make_set as make_set
    from synfog_usd.fog import Fog as Fog
    from synfog_usd.world.compose import compose as compose
    from synfog_usd.world.compose import recipes as recipes

__version__ = "0.1.0"

_PLACES = {
    "load": "dataset.frames",
    "Fog": "fog",
    "render": "dataset.frames",
    "develop": "dataset.photo",
    "cameras": "dataset.photo:shipped",
    "bake": "dataset.job",
    "check": "dataset.check",
    "compose": "world.compose",
    "recipes": "world.compose",
    "make_set": "dataset.sets.run",
    "pictures": "dataset.sets.index",
    "SynfogError": "base.errors",
}
"""Name -> module, and the name there where it is another."""

__all__ = [
    "Fog",
    "SynfogError",
    "bake",
    "cameras",
    "check",
    "compose",
    "develop",
    "load",
    "make_set",
    "pictures",
    "recipes",
    "render",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(_PLACES)}")
    module, _, inner = _PLACES[name].partition(":")
    value = getattr(importlib.import_module(f"{__name__}.{module}"), inner or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*_PLACES, "__version__"]


class _Door(ModuleType):
    """Python puts each imported package beside these names, and there is one called `render`: the function stays."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in _PLACES or not isinstance(value, ModuleType):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Door

"""What a real camera would have recorded of a USD scene in fog.

    import synfog_usd as sf
    photo = sf.develop(sf.render(sf.load("street.usda", fog=150), seed=1, quality="draft"), camera="phone")

Nothing is imported before a name is used.
"""

from typing import TYPE_CHECKING

from synfog_usd.base.door import open_door
from synfog_usd.base.version import __version__ as __version__

if TYPE_CHECKING:
    from synfog_usd.base.errors import SynfogError as SynfogError
    from synfog_usd.dataset.check import check as check
    from synfog_usd.dataset.frames import load as load
    from synfog_usd.dataset.frames import render as render
    from synfog_usd.dataset.job import bake as bake
    from synfog_usd.dataset.photo import cameras as cameras
    from synfog_usd.dataset.photo import develop as develop
    from synfog_usd.dataset.sets.index import pictures as pictures
    from synfog_usd.dataset.sets.run import make_set as make_set
    from synfog_usd.fog import Fog as Fog
    from synfog_usd.world.compose import compose as compose
    from synfog_usd.world.compose import recipes as recipes

__all__ = open_door(
    __name__,
    {
        "load": "synfog_usd.dataset.frames",
        "render": "synfog_usd.dataset.frames",
        "develop": "synfog_usd.dataset.photo",
        "cameras": "synfog_usd.dataset.photo",
        "Fog": "synfog_usd.fog",
        "bake": "synfog_usd.dataset.job",
        "check": "synfog_usd.dataset.check",
        "compose": "synfog_usd.world.compose",
        "recipes": "synfog_usd.world.compose",
        "make_set": "synfog_usd.dataset.sets.run",
        "pictures": "synfog_usd.dataset.sets.index",
        "SynfogError": "synfog_usd.base.errors",
    },
)

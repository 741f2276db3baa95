"""The models of the library beside those of the crossing, and the command that writes them.

    python -m synfog_usd.world.stock [folder [name ...]]

writes `assets/models/<name>/` below a folder; the same code gives the same bytes.
Their thumbnails come from `python -m synfog_usd.study.library --thumbnails assets/models`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from synfog_usd.world.cars import build_more_cars
from synfog_usd.world.components import Component, write_component
from synfog_usd.world.homesteads import build_homesteads
from synfog_usd.world.lod import with_low
from synfog_usd.world.plants import build_country_trees
from synfog_usd.world.roadside import build_roadside
from synfog_usd.world.trucks import build_trucks
from synfog_usd.world.wayfarers import build_wayfarers

BUILDERS: tuple[Callable[[], list[Component]], ...] = (
    build_more_cars,
    build_trucks,
    build_wayfarers,
    build_roadside,
    build_country_trees,
    build_homesteads,
)


def components() -> list[Component]:
    """Every component of this stock; those with many triangles in two levels of detail."""
    return [with_low(component) for build in BUILDERS for component in build()]


def write(folder: Path, names: Sequence[str] = ()) -> list[Path]:
    """Write the stock, or only `names` of it, below `folder`; gives the files to reference."""
    return [write_component(c, folder / "assets" / "models") for c in components() if not names or c.name in names]


if __name__ == "__main__":
    for written in write(Path(sys.argv[1]) if len(sys.argv) > 1 else Path.cwd(), sys.argv[2:]):
        print(written)

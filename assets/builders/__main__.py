"""The command of `assets.builders`: every shipped asset that is made by code, or some of them."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

if __name__ == "__main__":  # before numpy is loaded, which rounds otherwise with AVX-512; decimation turns on that
    os.environ.setdefault("NPY_DISABLE_CPU_FEATURES", "X86_V4 AVX512_ICL AVX512_SPR AVX512F AVX512_SKX")

from assets.builders import bench_stages, chambers, crossing, lamps, skies
from assets.builders.cars import build_more_cars
from assets.builders.coachwork import plated
from assets.builders.homesteads import build_homesteads
from assets.builders.joints import joints
from assets.builders.plants import build_country_trees
from assets.builders.roadside import build_roadside
from assets.builders.textures import write_textures
from assets.builders.trucks import build_trucks
from assets.builders.wayfarers import build_wayfarers
from synfog_usd.base.errors import SynfogError
from synfog_usd.base.files import write_bytes
from synfog_usd.world.components import Component, write_component
from synfog_usd.world.lod import bare, with_low

BUILDERS: tuple[Callable[[], list[Component]], ...] = (
    build_more_cars,
    build_trucks,
    build_wayfarers,
    build_roadside,
    build_country_trees,
    build_homesteads,
)
WHAT = ("textures", "lamps", "models", "stages", "skies")
"""Skies come last: their clouds take minutes."""


def components() -> Iterator[Component]:
    """Every model; those with many triangles in two levels of detail."""
    for component in (*crossing.components(), *(with_low(one) for build in BUILDERS for one in build())):
        yield bare(plated(component))


def write(what: str, folder: Path, only: Sequence[str] = ()) -> Iterator[Path]:
    """Write one of WHAT below `folder`, of models and skies only those named, if any are; gives the files that stages
    refer to.
    """
    assets = folder / "assets"
    if what == "textures":
        yield from write_textures(assets / "textures")
    elif what == "lamps":
        yield from lamps.write_lamps(assets / "lamps")
    elif what == "models":
        yield from (write_component(one, assets / "models") for one in components() if not only or one.name in only)
        yield write_nominal(assets / "models")
    elif what == "stages":
        yield crossing.write_stage(folder / "stages" / "crossroads.usda")
        yield from bench_stages.write(folder / "stages" / "bench")
        yield from chambers.write(folder / "stages")
    else:
        yield from skies.write_skies(assets / "skies")
        yield from skies.write_cloudy(assets / "skies", only)


def write_nominal(models: Path) -> Path:
    """Write `nominal.json`, one model a line."""
    of_people = {name: {"joints": places} for name, places in joints().items()}
    sizes = crossing.nominal() | of_people
    rows = [f"  {json.dumps(name)}: {json.dumps(values)}" for name, values in sizes.items()]
    write_bytes(models / "nominal.json", ("{\n" + ",\n".join(rows) + "\n}\n").encode())
    return models / "nominal.json"


def main(arguments: Sequence[str] | None = None) -> int:
    """Gives the exit code."""
    parser = argparse.ArgumentParser(prog="python -m assets.builders", description=__doc__)
    parser.add_argument(
        "what",
        nargs="*",
        metavar="WHAT",
        help=f"{', '.join(WHAT)}: all of them if left out; or sheet, the picture of all skies",
    )
    parser.add_argument(
        "--out", type=Path, default=Path.cwd(), help="the folder that holds, or will hold, assets and stages [this one]"
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="of models and skies")
    asked = parser.parse_args(arguments)
    for what in asked.what:
        if what not in (*WHAT, "sheet"):
            parser.error(f"{what!r} is none of {', '.join((*WHAT, 'sheet'))}")
    try:
        for what in asked.what or WHAT:
            for path in (
                [skies.sheet(asked.out / "docs" / "images" / "skies.png", asked.out / "assets" / "skies")]
                if what == "sheet"
                else write(what, asked.out, asked.only)
            ):
                print(path, flush=True)
    except SynfogError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())

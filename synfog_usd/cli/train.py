"""`synfog-usd train`: networks on pairs of a set.  Parses; the work is in modules that a verb imports."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from synfog_usd.cli import options

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Small networks that learn from a set.")


class Taken(str, Enum):
    """What a network takes."""

    srgb = "srgb"
    raw = "raw"


@app.callback()
def training() -> None:
    """Small networks that learn from a set."""


@app.command()
def defog(
    source: options.Source,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the network, its YAML and its losses.")],
    taken: Annotated[Taken, typer.Option("--input", help="What it takes: developed pictures, or RAW.")] = Taken.srgb,
    pipeline: Annotated[
        str, typer.Option(help="Whose pictures in fog; asm_srgb.NAME mixes fog into the clear ones of NAME.")
    ] = "synfog",
    target: Annotated[
        str, typer.Option(help="Whose clear pictures it is to give; the same pipeline's if left out.")
    ] = "",
    split: Annotated[str, typer.Option(help="Split of a set; all if left out.")] = "",
    seed: Annotated[int, typer.Option(min=0, help="Of the first weights, and of what is drawn.")] = 0,
    steps: Annotated[int, typer.Option(min=1, help="Batches of four squares of 96 pixels.")] = 2000,
    quiet: options.Quiet = False,
) -> None:
    """Train a network of 0.15 million weights to see through fog, for `benchmark defog --methods OUT/methods.yaml`."""
    from synfog_usd.cli.progress import shown
    from synfog_usd.lab.study import networks
    from synfog_usd.lab.study import training as work

    networks.torch_library()
    raw = taken is Taken.raw
    found = work.pairs(source, pipeline, target=target, split=split, raw=raw)
    with shown(quiet) as (progress, _):
        trained = work.train(found, seed=seed, steps=steps, progress=progress)
    work.write(trained, out)
    if not quiet:
        last = trained.losses[-max(1, steps // 20) :]
        print(f"{len(found)} pairs; mean absolute error {sum(last) / len(last):.4f} of the last {len(last)} steps")
        print(f"{out / 'methods.yaml'} is for synfog-usd benchmark defog --methods")


class Seen(str, Enum):
    """Pictures that are learned from."""

    all = "all"
    clear = "clear"
    foggy = "foggy"


@app.command()
def detect(
    source: options.Source,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the network, its YAML and its losses.")],
    classes: Annotated[
        str, typer.Option(help="Cityscapes' classes of things, comma-separated; + makes one class of several.")
    ] = "car,person",
    pipeline: Annotated[str, typer.Option(help="Whose pictures; all if left out.")] = "",
    fogs: Annotated[Seen, typer.Option(help="Pictures in clear air, in fog, or both.")] = Seen.all,
    split: Annotated[str, typer.Option(help="Split of a set; all if left out.")] = "",
    seed: Annotated[int, typer.Option(min=0, help="Of the first weights, and of what is drawn.")] = 0,
    steps: Annotated[int, typer.Option(min=1, help="Batches of four squares of 160 pixels.")] = 8000,
    quiet: options.Quiet = False,
) -> None:
    """Train a network of 0.9 million weights to find things, for `benchmark detect --model OUT/detectors.yaml`."""
    from synfog_usd.cli.progress import shown
    from synfog_usd.lab.study import finder, networks

    networks.torch_library()
    names = tuple(dict.fromkeys(name.strip() for name in classes.split(",") if name.strip()))
    found = finder.views(source, names, pipeline=pipeline, fogs=fogs.value, split=split)
    with shown(quiet) as (progress, _):
        trained = finder.train(found, names, seed=seed, steps=steps, progress=progress)
    finder.write(trained, out)
    if not quiet:
        last = trained.losses[-max(1, steps // 20) :]
        print(f"{len(found)} pictures; loss {sum(last) / len(last):.3f} of the last {len(last)} steps")
        print(f"{out / 'detectors.yaml'} is for synfog-usd benchmark detect --model")

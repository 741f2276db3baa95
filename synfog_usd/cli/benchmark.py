"""`synfog-usd benchmark`: what methods make of foggy pictures.  Parses; the work is in modules that a verb imports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from synfog_usd.cli import options

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="How well methods see through fog.")


@dataclass(kw_only=True)
class DefogWords:
    """Options of `benchmark defog`."""

    source: Annotated[
        Path, typer.Argument(help="Folder of a set, of a bake, or with pictures in hazy/ and gt/ (RESIDE, O-HAZE).")
    ]
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for results, tables and pictures.")]
    methods: Annotated[
        str, typer.Option(help="Names (none, dcp, cap, fvr) and YAML files of own methods, with commas.")
    ] = "none,dcp,cap,fvr"
    picture: Annotated[str, typer.Option(help="Which output of a set or bake is compared.")] = "srgb.png"
    clear: Annotated[str, typer.Option(help="The fog that counts as none.")] = "clear"
    split: Annotated[str, typer.Option(help="Split of a set; all if left out.")] = ""
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many pairs, spread over all.")] = None
    retry: Annotated[bool, typer.Option("--retry", help="Take up what failed, too.")] = False
    quiet: options.Quiet = False
    as_json: Annotated[bool, typer.Option("--json", help="Print the means as JSON on standard output.")] = False


@app.command()
@options.spread
def defog(words: DefogWords) -> None:
    """Compare what METHODS make of foggy pictures with the same views in clear air."""
    from synfog_usd.cli import benches

    benches.defog(words)


@dataclass(kw_only=True)
class DetectWords:
    """Options of `benchmark detect`."""

    source: options.Source
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for results, tables and pictures.")]
    model: Annotated[list[str], typer.Option("--model", help="YAML file that declares detectors; once for each file.")]
    before: Annotated[
        str,
        typer.Option(
            help="Also after defoggers: names (dcp, cap, fvr) and YAML files of own methods, with commas.",
            show_default=False,
        ),
    ] = ""
    picture: Annotated[str, typer.Option(help="Which output of a set or bake is looked at.")] = "srgb.png"
    split: Annotated[str, typer.Option(help="Split of a set; all if left out.")] = ""
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many pictures, spread over all.")] = None
    least_px: Annotated[
        int, typer.Option("--least-px", min=0, help="Things of fewer visible pixels are neither found nor missed.")
    ] = 0
    retry: Annotated[bool, typer.Option("--retry", help="Take up what failed, too.")] = False
    quiet: options.Quiet = False
    as_json: Annotated[bool, typer.Option("--json", help="Print the scores as JSON on standard output.")] = False


@app.command()
@options.spread
def detect(words: DetectWords) -> None:
    """Score what detectors find in fog, with and without what no camera can see."""
    from synfog_usd.cli import benches

    benches.detect(words)

"""`synfog-usd study`: what sets and bakes show.  Parses; the work is in modules that a verb imports."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="What sets and bakes show of fog and its models.")


@app.callback()
def studies() -> None:
    """What sets and bakes show of fog and its models."""


@app.command()
def asm(
    source: Annotated[Path, typer.Argument(help="Folder of a set or of a bake.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the findings.")],
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many shots, spread over all.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Map where the atmospheric scattering model errs by more than the sensor's noise."""
    from synfog_usd.cli.progress import shown
    from synfog_usd.study import scattering_model

    with shown(quiet) as (progress, _):
        found = scattering_model.study(source, limit=limit, progress=progress)
    scattering_model.write(found, out)
    if not quiet:
        print(scattering_model.markdown(found))

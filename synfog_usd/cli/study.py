"""`synfog-usd study`: what sets and bakes show.  Parses; the work is in modules that a verb imports."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from synfog_usd.base.errors import OutputError, ParameterError, did_you_mean
from synfog_usd.cli import options

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="What sets and bakes show of fog and its models.")


@app.callback()
def studies() -> None:
    """What sets and bakes show of fog and its models."""


def _can_hold(out: Path) -> None:
    """Refuse what can be no folder, or none that can be written, before minutes of work."""
    there = next((place for place in (out, *out.absolute().parents) if place.exists()), out)
    if not there.is_dir():
        raise OutputError(f"--out {out}: {there} is a file; give a folder")
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise OutputError(f"--out {out}: {there} cannot be written ({error.strerror}); choose another folder") from None


@app.command()
def asm(
    source: Annotated[
        Path, typer.Argument(help="Folder of a set or of a bake; or SET, a YAML file or a name, made in OUT/set first.")
    ],
    out: options.Findings,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many shots, drawn from all.")] = None,
    quiet: options.Quiet = False,
) -> None:
    """Map where the atmospheric scattering model errs by more than the sensor's noise."""
    _can_hold(out)
    from synfog_usd.cli.progress import shown
    from synfog_usd.dataset.sets.load import shipped
    from synfog_usd.lab.study import scattering_model

    if source.suffix == ".yaml" or (str(source) in shipped() and not source.exists()):
        from synfog_usd.cli import sets

        sets.run(source, out / "set", quiet=quiet, as_json=False)
        source = out / "set"
    elif not source.exists():
        raise ParameterError(
            f"{source}: no such folder, and no set of this name ships; there are {', '.join(shipped())}."
            f"{did_you_mean(str(source), shipped())}"
        )
    with shown(quiet) as (progress, _):
        study_result = scattering_model.study(source, limit=limit, progress=progress)
    scattering_model.write(study_result, out)
    if not quiet:
        print(scattering_model.markdown(study_result))

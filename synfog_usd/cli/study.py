"""`synfog-usd study`: what sets and bakes show.  Parses; the work is in modules that a verb imports."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from synfog_usd.base.errors import OutputError, ParameterError, did_you_mean
from synfog_usd.cli import options, worker

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

        sets.run(source, out / "set", only=None, quiet=quiet, as_json=False)
        source = out / "set"
    elif not source.exists():
        raise ParameterError(
            f"{source}: no such folder, and no set of this name ships; there are {', '.join(shipped())}."
            f"{did_you_mean(str(source), shipped())}"
        )
    with shown(quiet) as (progress, _):
        found = scattering_model.study(source, limit=limit, progress=progress)
    scattering_model.write(found, out)
    if not quiet:
        print(scattering_model.markdown(found))


@app.command()
def noise(
    source: options.Source,
    out: options.Findings,
    cameras: Annotated[
        str, typer.Option(help="Shipped graphs or YAML files, comma-separated.")
    ] = "synfog,phone,dashcam",
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many foggy shots, drawn from all.")] = None,
    quiet: options.Quiet = False,
) -> None:
    """Measure noise against fog: of RAW, of developed pictures, and after defogging."""
    _can_hold(out)
    from synfog_usd.cli.progress import shown
    from synfog_usd.lab.study import noise as measured

    names = [name.strip() for name in cameras.split(",") if name.strip()]
    with shown(quiet) as (progress, _):
        found = measured.study(source, cameras=names or measured.CAMERAS, limit=limit, progress=progress)
    measured.write(found, out)
    if not quiet:
        print(measured.markdown(found))


@app.command()
def chamber(
    stage: Annotated[
        Path | None, typer.Argument(help="USD file of a fog chamber; the shipped stages/chamber.usda if left out.")
    ] = None,
    out: options.Findings = ...,  # type: ignore[assignment]
    error: Annotated[
        float, typer.Option(min=1e-4, max=1.0, help="Relative error to which each patch of the chart is rendered.")
    ] = 0.01,
    laser_error: Annotated[
        float, typer.Option(min=1e-5, max=1.0, help="Relative error to which the laser's extinction is drawn.")
    ] = 0.001,
    quiet: options.Quiet = False,
) -> None:
    """Measure a fog chamber: a laser's extinction, what falls into its meter, and a chart by every model."""
    _can_hold(out)
    if stage is None:
        from synfog_usd.base.resources import folder

        stage = folder("stages") / "chamber.usda"
    if not worker.is_worker():
        code = worker.run(sys.argv[1:])
        if code < 0:
            print(worker.crash_line(code, stage, "read and rendered it"), file=sys.stderr)
        raise typer.Exit(2 if code < 0 else code)
    worker.follow_parent()
    from synfog_usd.cli.progress import shown
    from synfog_usd.lab.study import chamber as room
    from synfog_usd.lab.study import chamber_page

    with shown(quiet) as (progress, _):
        found = room.study(stage, error=error, laser_error=laser_error, progress=progress)
    chamber_page.write(found, out)
    if not quiet:
        print(chamber_page.markdown(found))


@app.command()
def sources(
    source: Annotated[
        Path, typer.Argument(help="Folder of a set with pipelines synfog and noise_free, and asm_estimated.")
    ],
    out: options.Findings,
    seeds: Annotated[int, typer.Option(min=1, help="Networks for each kind of fog and fold.")] = 3,
    folds: Annotated[
        int, typer.Option(min=2, help="Parts of the scenes; each is tested by networks of the others.")
    ] = 3,
    steps: Annotated[int, typer.Option(min=1, help="Of each training.")] = 400,
    also: Annotated[
        Path | None, typer.Option(help="Another set, on which all are tested: other sensors, fogs and recipes.")
    ] = None,
    quiet: options.Quiet = False,
) -> None:
    """Train on four kinds of fog and on RAW, and test each: what noise, multiple scattering and RAW are worth."""
    _can_hold(out)
    from synfog_usd.cli.progress import shown
    from synfog_usd.lab.study import sources as work

    with shown(quiet) as (progress, _):
        found = work.study(source, out, seeds_count=seeds, folds=folds, steps=steps, also=also, progress=progress)
    if not quiet:
        print(work.markdown(found))

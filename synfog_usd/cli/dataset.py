"""`synfog-usd dataset`: sets of shots, as verbs.  Parses; each verb's work is in a module that it imports itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from synfog_usd.cli import options

app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Sets of shots: planned, made, checked and exported."
)
Set = Annotated[Path, typer.Argument(metavar="SET", help="YAML of a set, or the name of one that ships, as mini.")]
Folder = Annotated[Path, typer.Argument(help="Folder of a set.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print as JSON on standard output.")]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Units at a time on this machine; what its memory allows if left out.")
]
Scheduler = Annotated[str | None, typer.Option(help="Address of a running Dask scheduler, as tcp://host:8786.")]
Limit = Annotated[
    float | None,
    typer.Option(min=1.0, help="Seconds after which a unit is ended; ten times what others took if left out."),
]
Variant = Annotated[str, typer.Option(help="auto, cuda, llvm or scalar.")]


@app.command()
def plan(
    file: Set,
    as_json: AsJson = False,
) -> None:
    """Tell what the SET holds before anything is made; once the first units are, 'dataset status' tells hours."""
    from synfog_usd.cli import sets as verb

    verb.plan(file, as_json=as_json)


@dataclass(kw_only=True)
class RetryWords:
    """Options of `dataset retry`."""

    out: Folder
    workers: Workers = None
    scheduler: Scheduler = None
    limit: Limit = None
    variant: Variant = "auto"
    gpu: options.Gpu = None
    quiet: Quiet = False
    as_json: AsJson = False

    def where(self) -> dict[str, Any]:
        """On what machines units are made, and for how long, as `make_set` takes it."""
        machines = {"workers": self.workers, "scheduler": self.scheduler}
        return {**machines, "limit_s": self.limit, "variant": options.device(self.variant, self.gpu)}


@dataclass(kw_only=True)
class RunWords(RetryWords):
    """Options of `dataset run`."""

    file: Set
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the set.")]
    only: Annotated[str | None, typer.Option(help="Scenes by number, as in 17,40-60.")] = None
    budget_gb: Annotated[float | None, typer.Option(min=0.0, help="Size at which no more is begun [GB].")] = None
    repair: Annotated[bool, typer.Option("--repair", help="Look at every file, and make again what was changed.")] = (
        False
    )


@app.command()
@options.spread
def run(words: RunWords) -> None:
    """Make the SET, or go on with it: what is finished is kept."""
    from synfog_usd.cli import sets as verb

    limits = {"only": words.only, "budget_gb": words.budget_gb, "repair": words.repair}
    verb.run(words.file, words.out, quiet=words.quiet, as_json=words.as_json, **limits, **words.where())


@app.command()
def status(
    out: Folder,
    watch: Annotated[
        bool, typer.Option("--watch", help="Tell again whenever something is new, until the run ends.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Tell how far a set is, what it takes, and what was set aside."""
    from synfog_usd.cli import sets as verb

    verb.status(out, watch=watch, as_json=as_json)


@app.command()
def verify(out: Folder, quiet: Quiet = False, as_json: AsJson = False) -> None:
    """Look at every file of a set: its hash, and labels against pictures; exit code 1 where something is wrong."""
    from synfog_usd.cli import sets as verb

    verb.verify(out, quiet=quiet, as_json=as_json)


@app.command()
@options.spread
def retry(words: RetryWords) -> None:
    """Take up what was set aside after three tries, and whatever else is missing."""
    from synfog_usd.cli import sets as verb

    verb.run(None, words.out, quiet=words.quiet, as_json=words.as_json, retry=True, **words.where())


@app.command()
def unit(
    out: Folder,
    number: Annotated[int, typer.Argument(min=0, help="Of the scene.")],
    lighting: Annotated[str, typer.Argument(help="Name of the lighting.")],
    camera: Annotated[str, typer.Option(help="Prim path; the stage's own if left out.")] = "",
    repair: Annotated[bool, typer.Option("--repair", help="Look at every file first.")] = False,
    variant: Variant = "auto",
    gpu: options.Gpu = None,
) -> None:
    """Make one scene in one lighting of a set that was begun, as the workers of run do, and print what it took."""
    from synfog_usd.cli import sets as verb

    verb.unit(out, number, lighting, camera, repair=repair, variant=options.device(variant, gpu))


@app.command(hidden=True)
def offers() -> None:
    """Print what the stages on standard input offer, a line of JSON each: for plan and run, as a child of theirs."""
    from synfog_usd.cli import sets as verb

    verb.print_offers()


@app.command()
def export(
    out: options.SetOrBake,
    form: Annotated[
        str,
        typer.Option(
            "--as",
            help="coco, kitti, yolo, cityscapes, foggy-cityscapes, vkitti2, reside, webdataset or huggingface; of "
            "clips also kitti-tracking, nuscenes or mcap.",
        ),
    ],
    to: Annotated[
        str | None, typer.Option(help="Folder to fill, or a URL of fsspec for webdataset; OUT-<format> if left out.")
    ] = None,
    drop: Annotated[
        str, typer.Option(help="Things that get no box: none, invisible, or faint (and invisible) ones.")
    ] = "invisible",
    classes: Annotated[
        str,
        typer.Option(help="Classes of things that get boxes, as car,truck; all if left out.", show_default=False),
    ] = "",
    licence: Annotated[str, typer.Option(help="Licence of the pictures, as an SPDX name or URL.")] = "not stated",
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Write a set for other people's loaders, with a data card and a Croissant record."""
    from synfog_usd.cli import exports as verb

    verb.export(out, form, to, drop=drop, classes=classes, licence=licence, quiet=quiet, as_json=as_json)


@app.command()
def gallery(
    out: options.SetOrBake,
    to: Annotated[Path | None, typer.Option(help="Folder to fill; OUT-gallery if left out.")] = None,
    quiet: Quiet = False,
) -> None:
    """Write pages that show a set; they open from disk, offline."""
    from synfog_usd.cli import exports as verb

    verb.gallery(out, to, quiet=quiet)


@app.command()
def stats(
    out: options.SetOrBake,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Print figures of a set, beside published ones."""
    from synfog_usd.cli import exports as verb

    verb.stats(out, quiet=quiet, as_json=as_json)

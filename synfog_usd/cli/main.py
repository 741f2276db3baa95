"""synfog-usd: the verbs."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from synfog_usd.base import isolated, numbers
from synfog_usd.base.errors import SynfogError
from synfog_usd.base.version import __version__
from synfog_usd.cli import dataset, options, worker

# Plain help: drawing it with rich costs as long again as everything else that help does.
app = typer.Typer(
    add_completion=True,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="What a real camera would have recorded of a USD scene in fog.",
)
graph_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Node graphs: from radiance to RAW and sRGB.")
app.add_typer(graph_app, name="graph")
asset_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="The library of models.")
app.add_typer(asset_app, name="asset")
app.add_typer(dataset.app, name="dataset")


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        print(f"synfog-usd {__version__}")
        raise typer.Exit


@dataclass(kw_only=True)
class BakeWords(options.ViewWords):
    """Options of `bake`."""

    frames: Annotated[
        str | None,
        typer.Option(
            help=(
                "One time code, as 12; or FIRST:LAST or FIRST:LASTxSTEP, as 0:90x2: a folder for each, and clips in "
                "OUT/clips."
            )
        ),
    ] = None
    resolution: Annotated[str | None, typer.Option(help="WIDTHxHEIGHT in pixels, as in 640x360.")] = None
    quality: options.Quality = numbers.STANDARD
    samples: options.Samples = None
    seed: Annotated[int, typer.Option(help="The same seed gives the same bytes.")] = 0


@app.command()
@options.spread
def bake(words: BakeWords) -> None:
    """Bake STAGE: every lighting in every fog, to radiance, RAW and sRGB."""
    from synfog_usd.cli import bake as verb

    verb.run(words.as_words())


@dataclass(kw_only=True)
class PreviewWords(options.ViewWords):
    """Options of `preview`."""

    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            parser=options.folder,
            help="Folder for the pictures and contact.png; out/preview/<name of the stage> if left out.",
            show_default=False,
        ),
    ] = None
    camera: options.Camera = None
    watch: Annotated[
        bool,
        typer.Option(
            "--watch", help="Draw again on each save of a layer in STAGE's folder, or of the graph, until Ctrl-C."
        ),
    ] = False
    resolution: options.Resolution = "320x180"
    samples: options.Samples = 2
    frame: Annotated[float | None, typer.Option("--frames", help="Time code.")] = None
    variant: options.Variant = "auto"
    gpu: options.Gpu = None
    quiet: options.Quiet = False


@app.command()
@options.spread
def preview(words: PreviewWords) -> None:
    """Draw STAGE small and clean, every lighting in every fog, as a bake's files."""
    from synfog_usd.cli import preview as verb

    asked_for = {
        **words.as_words(),
        "out": words.out or Path("out") / "preview" / words.stage.stem,
        "variant": options.device(words.variant, words.gpu),
        "draft": True,
    }
    for name in ("watch", "gpu", "quiet"):
        del asked_for[name]
    verb.run(asked_for, watch=words.watch, quiet=words.quiet)


@app.command()
def check(
    stage: options.Stage,
    strict: Annotated[bool, typer.Option("--strict", help="Exit code 1 if there is a warning.")] = False,
    choices: options.Choices = None,
    allow: options.Allow = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Tell what in STAGE is wrong or unusual, how to mend it, and what a bake makes simpler; exit code 2 where a bake
    would stop.
    """
    if not worker.is_worker():
        raise typer.Exit(_crash_line(worker.run(sys.argv[1:]), stage))
    worker.follow_parent()
    from synfog_usd.dataset import check as verb

    with worker.reading_limits():
        findings, notes, light = verb.look(stage, allow=allow or [], choices=choices or [])
    code = verb.exit_code(findings, notes, strict=strict)
    if as_json:
        print(verb.as_json(stage, findings, notes, code, light))
    else:
        print(verb.as_text(stage, findings, notes, light))
    raise typer.Exit(code)


@dataclass(kw_only=True)
class ChartWords:
    """Options of `chart`."""

    stage: options.Stage
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for chart.csv, .svg, .png and notes.txt.")]
    fog: Annotated[
        str | None,
        typer.Option(help="One fog: a variant of the stage, clear, mor150, rain10; as the stage has it if left out."),
    ] = None
    lighting: Annotated[str | None, typer.Option(help="One lighting; as the stage has it if left out.")] = None
    camera: options.Camera = None
    resolution: options.Resolution = "160x90"
    samples: Annotated[
        str | None,
        typer.Option(help="Paths per pixel to try, comma-separated; 8,32,128,512 and for peers 8,32,128 if left out."),
    ] = None
    models: Annotated[
        str | None, typer.Option(help="Models to compare, comma-separated; all that hold for the shot if left out.")
    ] = None
    quality: Annotated[
        str, typer.Option(help="Words of bake's --quality to show beside the models, comma-separated, or none.")
    ] = ",".join(numbers.QUALITIES)
    reference: Annotated[
        int | None, typer.Option(help="Paths per pixel of the reference; by the sweep and the time limit if left out.")
    ] = None
    time_limit: Annotated[
        float | None,
        typer.Option(
            help=(
                "Seconds of rendering a stage, a model's first point not counted; 90 if left out, or none where "
                "--samples is given."
            )
        ),
    ] = None
    target: Annotated[float, typer.Option(help="Total error; the fewest samples of auto that reach it are ringed.")] = (
        0.03
    )
    seed: Annotated[int, typer.Option(help="The same seed gives the same errors; seconds differ.")] = 0
    variant: options.Variant = "auto"
    gpu: options.Gpu = None
    allow: options.Allow = None
    quiet: options.Quiet = False


@app.command()
@options.spread
def chart(words: ChartWords) -> None:
    """Chart what accuracy costs: seconds against error and mottle of every model and quality on one shot of STAGE."""
    plan = dict(
        stage=words.stage,
        out=words.out,
        fog=words.fog,
        lighting=words.lighting,
        camera=words.camera,
        size=numbers.size_of(words.resolution),
        samples=numbers.counts_of(words.samples, "--samples") if words.samples is not None else None,
        models=numbers.names_of(words.models, "--models"),
        quality=() if words.quality == "none" else numbers.names_of(words.quality, "--quality"),
        reference_samples=words.reference,
        time_limit=words.time_limit,
        target=words.target,
        seed=words.seed,
        variant=options.device(words.variant, words.gpu),
        allow=tuple(words.allow or ()),
    )
    if not worker.is_worker():
        raise typer.Exit(_crash_line(worker.run(sys.argv[1:]), words.stage))
    worker.follow_parent()
    from synfog_usd.cli import chart as verb

    verb.run(plan, quiet=words.quiet)


@dataclass(kw_only=True)
class ComposeWords:
    """Options of `compose`."""

    recipe: Annotated[Path, typer.Argument(help="YAML recipe, or the name of one that ships, as residential.")]
    seed: Annotated[int, typer.Option(help="The same seed gives the same stage.")]
    out: Annotated[Path, typer.Option("--out", "-o", help="Stage to write (.usda, .usdc, .usd).")]
    change: options.Changes = None
    fog: Annotated[
        str, typer.Option(help="Fogs and weather instead of the recipe's, comma-separated: 600, rain10, snow2+mor400.")
    ] = ""
    seconds: Annotated[
        float | None, typer.Option(help="Length of a clip in which traffic and people move [s]; 0 for a still.")
    ] = None
    fps: Annotated[float | None, typer.Option(help="Frames of the clip a second, 10 if left out.")] = None
    traffic: Annotated[
        Path | None, typer.Option(help="FCD of SUMO (.xml) that drives, in place of the traffic that is drawn.")
    ] = None
    fcd: Annotated[Path | None, typer.Option(help="File for the traffic of the clip as FCD (.xml).")] = None
    environment: Annotated[
        Path | None, typer.Option(help="OpenSCENARIO (.xosc) whose fog, sun and time of day are taken.")
    ] = None
    opendrive: Annotated[Path | None, typer.Option(help="File for the roads as OpenDRIVE 1.8 (.xodr).")] = None
    as_json: Annotated[bool, typer.Option("--json", help="Print what stands where as JSON.")] = False


@app.command()
@options.spread
def compose(words: ComposeWords) -> None:
    """Draw a stage from RECIPE: another road, other cars, people, fogs and skies for each seed."""
    from collections import Counter

    from synfog_usd.world.compose import compose as draw

    values = dataclasses.asdict(words)
    as_json, recipe, out = (values.pop(name) for name in ("as_json", "recipe", "out"))
    spec = draw(recipe, out, **{**values, "change": words.change or []})
    if as_json:
        print(json.dumps(spec.plain(), indent=2))
        return
    groups = Counter(placement.group for placement in spec.placed)
    print(f"{out}: {groups['Vehicles']} vehicles and bicycles, {groups['People']} people, fogs {', '.join(spec.fog)}")


@app.command()
def info(
    variant: options.Variant = "auto",
    gpu: options.Gpu = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Tell which backend renders here and why, and the versions of what it stands on."""
    import importlib.metadata
    import platform

    from synfog_usd.render import backend

    chosen = backend.choose(options.device(variant, gpu))  # type: ignore[arg-type]
    names = (
        "usd-core",
        "mitsuba",
        "drjit",
        "OpenImageIO",
        "colour-science",
        "trimesh",
        "pymeshlab",
        "numpy",
        "scipy",
        "tifffile",
    )
    versions = dict.fromkeys(names, "not installed")
    for name in names:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    if as_json:
        print(
            json.dumps(
                {
                    "backend": chosen.name,
                    "variant": chosen.variant,
                    "llvm": chosen.llvm_library,
                    "why": chosen.why,
                    "versions": versions,
                },
                indent=2,
            )
        )
        return
    print(f"synfog-usd {__version__}, Python {platform.python_version()}, {platform.platform()}")
    print(f"backend: {chosen.name} ({chosen.variant})")
    for line in chosen.why:
        print(f"  {line}")
    print("versions: " + ", ".join(f"{name} {version}" for name, version in versions.items()))


@app.command("plugin-path")
def plugin_path(
    bare: Annotated[bool, typer.Option("--bare", help="Print the schema's folder alone, for scripts.")] = False,
    blender: Annotated[
        Path | None, typer.Option(help="Write Blender's extension to this .zip.", show_default=False)
    ] = None,
) -> None:
    """Tell what to set so that usdview, Houdini, Omniverse and Blender know the fog schema."""
    from synfog_usd.cli import plugins

    if blender is not None:
        plugins.pack_extension(blender)
        print(f"{blender}: install it in Blender under Edit > Preferences > Get Extensions > Install from Disk")
        return
    print(plugins.SCHEMA if bare else plugins.advice())


@app.command()
def selftest(
    variant: options.Variant = "auto",
    gpu: options.Gpu = None,
    quick: Annotated[bool, typer.Option("--quick", help="A few of the cases; under 40 s.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON on standard output.")] = False,
) -> None:
    """Measure known answers with every model on this machine; exit code 1 if one is missed."""
    import time

    from synfog_usd.lab import selftest as tests
    from synfog_usd.render import backend

    chosen = backend.start(options.device(variant, gpu)).variant  # type: ignore[arg-type]
    print(f"backend: {chosen}", file=sys.stderr if as_json else sys.stdout, flush=True)
    cases, rows, start = tests.select(quick), [], time.monotonic()
    for index, row in enumerate(tests.run(cases), 1):
        rows.append(row)
        print(f"{index:3}/{len(cases)}  {time.monotonic() - start:5.0f} s  {row[0].case}", file=sys.stderr, flush=True)
    if as_json:
        print(json.dumps({"variant": chosen, "cases": [result.as_dict() for row in rows for result in row]}, indent=2))
    else:
        print(tests.table(rows))
        print(
            "!: missed and counted; (): outside the model's stated domain; NaN: paths that were not finite; volpath "
            "and volpathmis are shown, not counted"
        )
        print(tests.summary(rows))
    raise typer.Exit(1 if any(result.failed for row in rows for result in row) else 0)


@graph_app.command("check")
def graph_check(pipeline: options.Graph) -> None:
    """Check a graph as a whole: nodes, parameters, units, quantities."""
    from synfog_usd import camera

    graph = camera.load_graph(pipeline)
    print(f"{pipeline}: {len(graph.nodes)} nodes, writes {', '.join(graph.outputs)}")


@graph_app.command("show")
def graph_show(
    pipeline: options.Graph,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As Mermaid text, for a drawing.")] = False,
    change: options.Overrides = None,
) -> None:
    """Show every node with its parameters and where each value comes from."""
    from synfog_usd.cli import graph as verb

    verb.show(pipeline, changes=change or [], mermaid=mermaid)


@graph_app.command("run")
@options.spread
def graph_run(words: options.GraphWords) -> None:
    """Run a graph on radiance of one's own."""
    from synfog_usd.cli import graph as verb

    verb.run(words)


@graph_app.command("explain")
def graph_explain(
    op: Annotated[str | None, typer.Argument(help="Name of an op, as sensor.gain; a list of all if left out.")] = None,
) -> None:
    """Print the page of an op: what it computes, takes and gives, its parameters, units and ranges."""
    from synfog_usd.cli import graph as verb

    verb.explain(op)


@graph_app.command("schema")
def graph_schema() -> None:
    """Print the JSON Schema of the format, by which editors complete and underline."""
    from synfog_usd.cli import graph as verb

    print(verb.schema_text(), end="")


@graph_app.command("profile")
def graph_profile(kind: Annotated[str, typer.Argument(help="sensor or lens.")]) -> None:
    """Print a sensor or lens to be filled in: every key with its meaning and range, as YAML that loads as it stands."""
    from synfog_usd.cli import graph as verb

    print(verb.profile_text(kind), end="")


@dataclass(kw_only=True)
class ImportWords:
    """Options of `asset import`."""

    file: Annotated[Path, typer.Argument(help="Model: .glb, .gltf, .obj, .ply, .usd, .usda, .usdc or .usdz.")]
    label: Annotated[str, typer.Option("--class", help="Cityscapes class, as car, person, 'traffic sign'.")]
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Library folder; the model becomes <out>/<name>/<name>.usda.")
    ] = Path("models")
    name: Annotated[str | None, typer.Option(help="Name of the model; from the file's name if left out.")] = None
    length: Annotated[
        float | None, typer.Option(help="Its length in metres, the way it looks; scales the model to it.")
    ] = None
    unit: Annotated[
        str | None, typer.Option(help="Unit of the file: m, cm, mm, in, ft or dm; the file's, or m, if left out.")
    ] = None
    up: Annotated[str | None, typer.Option(help="Axis of the file that points up, as +Z.")] = None
    front: Annotated[str | None, typer.Option(help="Axis of the file that it looks along, as -Y.")] = None
    as_json: Annotated[bool, typer.Option("--json", help="Print the model's figures as JSON.")] = False


@asset_app.command("import")
@options.spread
def asset_import(words: ImportWords) -> None:
    """Import FILE as a model of the library: in metres, Z up, front +Y, on the ground, labelled, in two levels of
    detail.
    """
    file = words.file
    if not worker.is_worker():
        raise typer.Exit(_crash_line(worker.run(sys.argv[1:]), file))
    worker.follow_parent()
    from synfog_usd.base import system
    from synfog_usd.base.fence import LAYERS
    from synfog_usd.stage import open_stage
    from synfog_usd.world.importer import import_asset

    with worker.reading_limits():
        system.allow(system.PER_BYTE * file.stat().st_size if file.is_file() else 0)
        if file.suffix.lower() in LAYERS:
            open_stage(file, whole=True)  # counted, and with no file from elsewhere, before the importer unfolds it
        axes = {"unit": words.unit, "up": words.up, "front": words.front}
        imported = import_asset(file, words.label, out=words.out, name=words.name, length_m=words.length, **axes)
    model, (full, low) = imported.model, imported.triangles
    size_m = (model.length, model.width, model.height)
    if words.as_json:
        summary = {
            "name": model.name,
            "class": model.label,
            "path": str(model.path),
            **dict(zip(("length_m", "width_m", "height_m"), (round(side, 4) for side in size_m), strict=True)),
            "triangles": full,
            "triangles_low": low,
            "notes": list(imported.notes),
        }
        print(json.dumps(summary, indent=2))
        return
    for note in imported.notes:
        print(note)
    levels = f"{full} triangles" + (f", {low} from afar" if low else "")
    print(f"{model.path}: {model.label}, {' x '.join(f'{side:.2f}' for side in size_m)} m, {levels}")


def _crash_line(code: int, stage: Path) -> int:
    """The exit code for the user, after a line for a child that died."""
    if code < 0:
        print(worker.crash_line(code, stage, "read it"), file=sys.stderr)
        return 2
    return code


def main(arguments: list[str] | None = None) -> None:
    """Run one command line; the way out is always an exit code."""
    isolated.forget_foreign()
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        with worker.printed():
            app(args=arguments)
    except SynfogError as error:
        print(f"synfog-usd: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except MemoryError:
        print(
            "synfog-usd: this machine's memory does not suffice; make the stage, its textures or the picture smaller",
            file=sys.stderr,
        )
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(worker.INTERRUPTED)


if __name__ == "__main__":
    worker.end_with(main)

"""Options and arguments that more than one verb takes."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from synfog_usd.base import numbers
from synfog_usd.base.errors import ParameterError, SynfogError


def _variants_of_stage(ctx: typer.Context, incomplete: str) -> list[str]:
    """What --choose takes for the stage that is typed before it, for a shell to complete; of a bad one nothing."""
    from synfog_usd import stage as usd

    try:
        # A line that is not whole is not parsed: its first word without a dash is among the rest.
        typed = ctx.params.get("stage") or next(word for word in ctx.args if not word.startswith("-"))
        choices = usd.variant_choices(usd.open_stage(typed))
    except (SynfogError, StopIteration):
        return []
    return [choice for choice in choices if choice.startswith(incomplete)]


Options = TypeVar("Options")


def spread(verb: Callable[[Options], None]) -> Callable[..., None]:
    """A verb of one dataclass, as typer wants it: each field of the dataclass is a parameter of its own."""
    (kind,) = (hint for name, hint in get_type_hints(verb).items() if name != "return")
    hints = get_type_hints(kind, include_extras=True)

    @functools.wraps(verb)
    def with_words(**words: Any) -> None:
        verb(kind(**words))

    parameters = []
    for field in dataclasses.fields(kind):
        default = inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default
        annotation = hints[field.name]
        parameters.append(
            inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        )
    del with_words.__wrapped__
    with_words.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    with_words.__annotations__ = hints
    return with_words


def folder(text: str) -> Path:
    """A path that is typed as a folder's.

    Raises:
        ParameterError: it is empty.
    """
    if not text.strip():
        raise ParameterError(f"--out {text!r}: no name of a folder; . is this one")
    return Path(text)


Stage = Annotated[Path, typer.Argument(help="USD file (.usda, .usdc, .usd, .usdz), or crossroads, which ships.")]
Pipeline = Annotated[
    Path | None, typer.Option(help="YAML node graph, or one that ships by its name; phone if left out.")
]
Lightings = Annotated[str | None, typer.Option(help="Lightings, comma-separated; all that the stage has if left out.")]
Fogs = Annotated[
    str | None,
    typer.Option(
        help="Fogs, comma-separated: variants of the stage, clear, or weather by name, as mor150, rain10, dust500, "
        "snow2+mor400."
    ),
]
Camera = Annotated[str | None, typer.Option(help="Prim path of the camera.")]
Choices = Annotated[
    list[str] | None,
    typer.Option(
        "--choose",
        help="Variant of any prim, PRIM:SET=VARIANT, as /World/Car:paint=red; may be given again.",
        autocompletion=_variants_of_stage,
    ),
]
Changes = Annotated[
    list[str] | None,
    typer.Option("--change", help="SECTION.KEY=VALUE over what a recipe says, as in traffic.count=20."),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", help="NODE.PARAMETER=VALUE, or sensor.iso=400 for every node that it fits."),
]
Exposure = Annotated[
    str | None,
    typer.Option(help="Exposure time in seconds, as 1/200, instead of the meter's."),
]
Iso = Annotated[float | None, typer.Option(help="ISO speed instead of the meter's.")]
Ev = Annotated[float, typer.Option(help="Stops by which the meter exposes brighter, as -1 for half of the light.")]
LightScale = Annotated[float, typer.Option(help="Multiply all lights by this.")]
Quality = Annotated[
    str,
    typer.Option(
        help="; ".join(f"{word}: {quality.promise}" for word, quality in numbers.QUALITIES.items()) + ".",
    ),
]
Samples = Annotated[int | None, typer.Option(help="Most paths per pixel, on average; those of --quality if left out.")]
Variant = Annotated[str, typer.Option(help="auto, cuda, llvm or scalar.")]
Gpu = Annotated[
    int | None,
    typer.Option("--gpu", min=0, help="Which of several NVIDIA GPUs renders, by its number in nvidia-smi -L."),
]
Allow = Annotated[
    list[Path] | None,
    typer.Option(help="Folder outside the stage's own in which its files may lie; may be given again."),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
Resolution = Annotated[str, typer.Option(help="WIDTHxHEIGHT in pixels.")]
Graph = Annotated[Path, typer.Argument(help="YAML node graph, or the name of one that ships, as phone.")]
SetOrBake = Annotated[Path, typer.Argument(help="Folder of a set, or of a single bake.")]


@dataclass(kw_only=True)
class ViewWords:
    """Options of `bake` and `preview`: a stage, what is made of it and where, and how it is exposed."""

    stage: Stage
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            parser=folder,
            help="Folder for everything that is written; out/<name of the stage> if left out.",
            show_default=False,
        ),
    ] = None
    pipeline: Pipeline = None
    lighting: Lightings = None
    fog: Fogs = None
    camera: Annotated[
        str | None,
        typer.Option(
            help="Cameras by path or name, comma-separated, or a prim above them; of several each has a folder."
        ),
    ] = None
    choose: Choices = None
    exposure: Exposure = None
    iso: Iso = None
    ev: Ev = 0.0
    light_scale: LightScale = 1.0
    allow: Allow = None

    def as_words(self) -> dict[str, Any]:
        """Values by option, as `plan_of` takes them."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}


def device(variant: str, gpu: int | None) -> str:
    """What --variant and --gpu ask for together, as `render.backend.choose` takes it.

    Raises:
        ParameterError: a GPU is named for a variant that uses none.
    """
    if gpu is None:
        return variant
    if variant not in ("auto", "cuda"):
        raise ParameterError(f"--gpu {gpu}: --variant {variant} renders on no GPU; leave one of them out")
    return f"cuda:{gpu}"


@dataclass(kw_only=True)
class GraphWords:
    """Options of `graph run`."""

    pipeline: Graph
    source: Annotated[list[str], typer.Option("--in", help="NAME=FILE.exr, or FILE.exr for a graph with one input.")]
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the graph's outputs.")] = Path()
    meter: Annotated[Path | None, typer.Option(help="EXR to meter on; the input itself if left out.")] = None
    change: Overrides = None
    until: Annotated[
        str | None,
        typer.Option(help="Run no further than this node, written as EXR, or this output, as raw or raw.dng."),
    ] = None
    seed: Annotated[int, typer.Option(help="The same seed gives the same bytes.")] = 0
    repair: Annotated[
        bool, typer.Option("--repair", help="Mend radiance that is negative or not finite, instead of refusing it.")
    ] = False
    fov: Annotated[
        float | None,
        typer.Option(help="Horizontal field of view of the inputs [degrees]; else what they say, or lens and sensor."),
    ] = None

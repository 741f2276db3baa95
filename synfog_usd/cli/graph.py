"""`synfog-usd graph`: graphs on files, drawn, and explained."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from synfog_usd import camera
from synfog_usd.base import resources
from synfog_usd.base.errors import GraphError, ParameterError, did_you_mean
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import template, writers
from synfog_usd.camera.graph import NodeGraph, drawing, reference
from synfog_usd.camera.graph.op import Port
from synfog_usd.camera.graph.schema import schema
from synfog_usd.camera.profiles import LensProfile, SensorProfile, shipped
from synfog_usd.cli.options import GraphWords
from synfog_usd.cli.worker import unheard

DEPTH = "depth"
"""Input, of data, that a bake's labels or the picture's own file can fill."""


def run(words: GraphWords) -> None:
    """Read the inputs, run, write the outputs, and print where they are and what each node took."""
    graph = _changed(camera.load_graph(words.pipeline), words.change or [])
    nodes = _files(graph, words.until)
    images = _inputs(words.source, graph, words.repair, words.fov)
    exposure = (
        camera.meter(_viewed(_read(words.meter, words.repair), graph, words.fov), graph)
        if words.meter
        else camera.metered(graph, images)
    )
    results = camera.develop(
        graph,
        images,
        seed=words.seed,
        exposure=exposure,
        until=words.until,
        keep=list(nodes.values()),
    )
    for name, node in nodes.items():
        options = graph.options_of(name) if graph.outputs.get(name) == node else {}
        print(writers.write_output(name, results[node], words.out, options=options))
    if exposure is not None:
        print(f"exposure: {exposure}", file=sys.stderr)
    settings = exposure.settings if exposure else None
    print(drawing.table(graph, results, settings, width=_columns(), whole=False), file=sys.stderr)


def show(pipeline: Path, *, changes: Sequence[str], mermaid: bool) -> None:
    """Print the graph as a table or as Mermaid text."""
    graph = _changed(camera.load_graph(pipeline), changes)
    print(drawing.mermaid(graph) if mermaid else drawing.table(graph, width=_columns()))


def _columns() -> int:
    """Characters of a line: of the terminal, 80 where there is none."""
    return max(40, shutil.get_terminal_size((80, 24)).columns)


def explain(op: str | None) -> None:
    """Print the page of an op, or the list of ops."""
    if op is not None:
        print(reference.page(camera.OPS, op))
    else:
        width = max(len(item.name) for item in camera.OPS)
        print("\n".join(f"{item.name:{width}}  {item.summary}" for item in camera.OPS))


def schema_text() -> str:
    """The JSON Schema of a graph of camera ops."""
    graphs = sorted(path.stem for path in resources.folder("pipeline").glob("*.yaml"))
    return (
        json.dumps(
            schema(camera.OPS, profiles={"sensor": shipped("sensors"), "lens": shipped("lenses")}, graphs=graphs),
            indent=1,
            ensure_ascii=False,
        )
        + "\n"
    )


def profile_text(kind: str) -> str:
    """A commented profile to be filled in.

    Raises:
        ParameterError: neither a sensor nor a lens.
    """
    written = {"sensor": template.sensor_template, "lens": template.lens_template}
    if kind not in written:
        raise ParameterError(f"no profile {kind!r}; there are {', '.join(written)}.{did_you_mean(kind, written)}")
    return written[kind]()


def _changed(graph: NodeGraph, changes: Sequence[str]) -> NodeGraph:
    return (
        graph.with_overrides(dict(_pair(change, "--set", "NODE.PARAMETER=VALUE") for change in changes))
        if changes
        else graph
    )


def _files(graph: NodeGraph, until: str | None) -> dict[str, str]:
    """File name -> node of what a run writes: the outputs that `until` names, or the node itself as EXR."""
    if until is None:
        return dict(graph.outputs)
    return {f"{until}.exr": until} if until in graph.nodes else graph.outputs_of(until) or {f"{until}.exr": until}


def _inputs(sources: Sequence[str], graph: NodeGraph, repair: bool, fov_x_deg: float | None) -> dict[str, Image]:
    """Images by input; depth that is not named is looked for beside the picture."""
    pictures = [name for name, port in graph.inputs.items() if port.quantity is not Quantity.DATA]
    images: dict[str, Image] = {}
    paths: dict[str, Path] = {}
    for text in sources:
        if "=" not in text and len(pictures) == 1:
            name, path = pictures[0], text
        else:
            name, path = _pair(text, "--in", "NAME=FILE.exr")
        if name not in graph.inputs:
            raise GraphError(f"--in {text}: the graph has no input {name!r}; it has {', '.join(graph.inputs)}")
        paths[name], data = Path(path), name not in pictures
        image = _read(paths[name], repair, graph.inputs[name].quantity)
        images[name] = replace(image, quantity=Quantity.DATA) if data else _viewed(image, graph, fov_x_deg)
    if graph.inputs.get(DEPTH) == Port(Quantity.DATA) and DEPTH not in images and paths:
        images[DEPTH] = _depth_beside(next(iter(paths.values())))
    return images


def _depth_beside(path: Path) -> Image:
    """Depth in the picture's own file, or in the labels of the bake that made it."""
    files = [path, path.absolute().parent.parent.parent / "labels.exr"]
    for file in files:
        for channel in camera.DEPTHS:
            if file.suffix.lower() == ".exr" and file.is_file() and channel in writers.channels_of(file):
                print(f"depth: {channel} of {file}", file=sys.stderr)
                return writers.read_exr(file, quantity=Quantity.DATA, channels=[channel])
    raise GraphError(
        f"the graph reads depth, and neither {files[0]} nor {files[1]} has a channel {' or '.join(camera.DEPTHS)}; "
        f"give --in {DEPTH}=FILE.exr"
    )


def _viewed(image: Image, graph: NodeGraph, fov_x_deg: float | None) -> Image:
    """The image with a field of view, and a word where the lens that the graph names has another."""
    image = camera.field_of_view(image, graph, fov_x_deg=fov_x_deg)
    lens, chip, recorded = graph.profiles.get("lens"), graph.profiles.get("sensor"), image.provenance.get("fov_x_deg")
    if not isinstance(lens, LensProfile) or not isinstance(chip, SensorProfile) or recorded is None:
        return image
    fov_deg = camera.lens_fov_deg(lens, chip, image.width_px)
    if "fov_from" in image.provenance:
        print(
            f"field of view: {fov_deg:.4g} degrees, of {image.width_px} pixels behind {lens.name}; --fov says another",
            file=sys.stderr,
        )
    elif abs(recorded - fov_deg) > 0.02 * fov_deg:
        print(
            f"field of view: {recorded:.4g} degrees, as {'the picture' if fov_x_deg is None else '--fov'} says; "
            f"{image.width_px} pixels behind {lens.name} would see {fov_deg:.4g}",
            file=sys.stderr,
        )
    return image


def _read(path: Path, repair: bool = False, quantity: Quantity | None = None) -> Image:
    with unheard():  # LibRaw writes a line of its own of each damage
        image = writers.read(path, declared=quantity, repair=repair)
    if count := image.provenance.get("repaired_values", 0):
        print(f"{path}: {count} values that light cannot have were mended", file=sys.stderr)
    return image


def _pair(text: str, option: str, form: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise GraphError(f"{option} {text}: not {form}")
    return name, value

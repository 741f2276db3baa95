"""`synfog-usd graph run`: a graph on files."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from synfog_usd import camera, writers
from synfog_usd.errors import GraphError
from synfog_usd.graph import NodeGraph
from synfog_usd.image import Image, Quantity


def run(pipeline: Path, sources: Sequence[str], out: Path, *, meter_on: Path | None, changes: Sequence[str], until: str | None, seed: int) -> None:
    """Read the inputs, run, write the outputs, and print where they are and what each node took."""
    graph = camera.load_graph(pipeline)
    if changes:
        graph = graph.with_overrides(dict(_pair(change, "--set", "NODE.PARAMETER=VALUE") for change in changes))
    images = dict(_input(source, graph) for source in sources)
    exposure = camera.meter(_read(meter_on), graph) if meter_on else None
    wanted = {f"{until}.exr": until} if until else dict(graph.outputs)
    results = camera.develop(graph, images, seed=seed, exposure=exposure, until=until, keep=list(wanted.values()))
    for name, node in wanted.items():
        print(writers.write_output(name, results[node], out))
    print(graph.table(results.milliseconds), file=sys.stderr)


def _input(text: str, graph: NodeGraph) -> tuple[str, Image]:
    if "=" not in text and len(graph.inputs) == 1:
        return next(iter(graph.inputs)), _read(Path(text))
    name, path = _pair(text, "--in", "NAME=FILE.exr")
    if name not in graph.inputs:
        raise GraphError(f"--in {text}: the graph has no input {name!r}; it has {', '.join(graph.inputs)}")
    return name, _read(Path(path))


def _read(path: Path) -> Image:
    image = writers.read_exr(path)
    if image.quantity is Quantity.RADIANCE:
        writers.check_radiance(image, str(path))
    return image


def _pair(text: str, option: str, form: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise GraphError(f"{option} {text}: not {form}")
    return name, value

"""From a radiance image to pictures: load a graph of camera ops, meter, run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from synfog_usd import graph as engine
from synfog_usd.camera import blur, cleanup, demosaic, distortion, flare, hdr, isp, optics, sensor  # noqa: F401  (their ops register themselves)
from synfog_usd.camera.exposure import Exposure, meter
from synfog_usd.camera.registry import OPS
from synfog_usd.graph import Cache, GraphRun, NodeGraph, Registry
from synfog_usd.image import Image, Quantity
from synfog_usd.progress import Progress, silent


def load_graph(path: Path, *, registry: Registry = OPS) -> NodeGraph:
    """Read and check a graph of camera ops.

    Args:
        path: the YAML file.
        registry: `OPS`, or an own one that started from it.

    Raises:
        GraphError: with file, line and column.
        ParameterError: a fault in a sensor or lens profile.
    """
    return engine.load_graph(path, registry)


def develop(
    graph: NodeGraph,
    images: Mapping[str, Image],
    *,
    seed: int,
    exposure: Exposure | None = None,
    overrides: Mapping[str, Any] | None = None,
    until: str | None = None,
    keep: Sequence[str] | None = None,
    progress: Progress = silent,
    cache: Cache | None = None,
) -> GraphRun:
    """Run a graph, metering first where it leaves the exposure to the camera.

    For the frames of a pair, meter the clear one and hand its exposure to all: a
    frame metered by itself would hide part of the fog's light.

    Args:
        graph: from `load_graph`.
        images: one per input.
        seed: of all random streams.
        exposure: from `meter`; metered on the radiance given here unless said.
        overrides, until, keep, progress, cache: see `NodeGraph.run`.

    Raises:
        GraphError: see `NodeGraph.run` and `meter`.
    """
    if overrides:
        graph = graph.with_overrides(overrides)
    if exposure is None:
        exposure = metered(graph, images)
    return graph.run(images, seed=seed, settings=exposure.settings if exposure else None, until=until, keep=keep, progress=progress, cache=cache)


def metered(graph: NodeGraph, images: Mapping[str, Image]) -> Exposure | None:
    """Exposure for the radiance among some images; None where graph and images say how to expose, or there is none.

    Raises:
        GraphError: see `meter`.
    """
    known = set[str]().union(*(image.provenance for image in images.values()))
    radiance = next((image for image in images.values() if image.quantity is Quantity.RADIANCE), None)
    return meter(radiance, graph) if radiance is not None and not exposure_left_open(graph) <= known else None


def exposure_left_open(graph: NodeGraph) -> set[str]:
    """What a graph leaves to the camera, of exposure time and ISO."""
    return {"exposure_s", "iso"} & set(graph.settings_needed)

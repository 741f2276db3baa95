"""From a radiance image to pictures: load a graph of camera ops, meter, run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from synfog_usd.base import resources
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.seeds import seed32
from synfog_usd.camera import aberrations as aberration  # noqa: F401
from synfog_usd.camera import blur, cleanup, demosaic, distortion, flare, flicker, hdr, isp, optics, sensor  # noqa: F401  (their ops register themselves)
from synfog_usd.camera import fisheye as fisheyes
from synfog_usd.camera import focus as focused  # noqa: F401
from synfog_usd.camera import ghosts as ghost  # noqa: F401
from synfog_usd.camera import graph as engine
from synfog_usd.camera import wet_glass as wet  # noqa: F401
from synfog_usd.camera import windscreen as windscreens  # noqa: F401
from synfog_usd.camera.exposure import Exposure, meter
from synfog_usd.camera.graph import GraphRun, NodeGraph
from synfog_usd.camera.profiles import LensProfile, SensorProfile
from synfog_usd.camera.registry import OPS


def load_graph(path: Path) -> NodeGraph:
    """Read and check a graph of camera ops.

    Args:
        path: the YAML file, or the name of a shipped graph: 'phone'.

    Raises:
        GraphError: with file, line and column.
        ParameterError: a fault in a sensor or lens profile.
    """
    return engine.load_graph(resources.named(path, "pipeline"), OPS)


def field_of_view(image: Image, graph: NodeGraph, *, fov_x_deg: float | None = None) -> Image:
    """The image, with a field of view that a lens needs to know.

    Args:
        image: any; its provenance may say `fov_x_deg`.
        graph: whose lens and sensor say one where nothing else does: 2 atan(w p / (2 f)),
            of w pixels of pitch p behind the focal length f.
        fov_x_deg: what counts instead [degrees].

    Raises:
        ImageError: an angle that no plane picture has, or one for a fisheye.
    """
    curved = "fisheye_coefficients" in image.provenance or bool(graph.nodes_with(fisheyes.OP))
    if fov_x_deg is not None:
        if curved:
            raise ImageError("a field of view is a pinhole's; a fisheye has its own, which its lens tells")
        if not 0.0 < fov_x_deg <= 179.0:
            raise ImageError(f"a field of view of {fov_x_deg:g} degrees is not above 0 and at most 179")
        return image.with_metadata(fov_x_deg=fov_x_deg)
    lens, chip = graph.profiles.get("lens"), graph.profiles.get("sensor")
    if (
        curved
        or "fov_x_deg" in image.provenance
        or not isinstance(lens, LensProfile)
        or not isinstance(chip, SensorProfile)
    ):
        return image
    return image.with_metadata(
        fov_x_deg=lens_fov_deg(lens, chip, image.width_px),
        fov_from="focal length of the lens, pitch and number of the pixels",
    )


def lens_fov_deg(lens: LensProfile, chip: SensorProfile, width_px: int) -> float:
    """Horizontal angle [degrees] that so many pixels of a sensor see behind a lens, distortion left out."""
    return math.degrees(2.0 * math.atan(width_px * chip.pixel_pitch_um * 1e-3 / 2.0 / lens.focal_length_mm))


def develop(
    graph: NodeGraph,
    images: Mapping[str, Image],
    *,
    seed: int,
    exposure: Exposure | None = None,
    until: str | None = None,
    keep: Sequence[str] | None = None,
) -> GraphRun:
    """Run a graph, metering first where it leaves the exposure to the camera.

    For the frames of a pair, meter the clear one and hand its exposure to all: a
    frame metered by itself would hide part of the fog's light.

    Args:
        graph: from `load_graph`.
        images: one per input; see `field_of_view` for those that do not say theirs.
        seed: of all random streams; each specimen of a rig has its own, by the `specimen` that an image's provenance
            tells.
        exposure: from `meter`; metered on the radiance given here unless said.
        until, keep: see `NodeGraph.run`.

    Raises:
        GraphError: see `NodeGraph.run` and `meter`.
    """
    images = {name: field_of_view(image, graph) for name, image in images.items()}
    if exposure is None:
        exposure = metered(graph, images)
    taken_by = next(
        (specimen_of_image for image in images.values() if (specimen_of_image := image.provenance.get("specimen"))),
        None,
    )
    return graph.run(
        images,
        seed=seed if taken_by is None else seed32(seed, "specimen", str(taken_by)),
        settings=exposure.settings if exposure else None,
        until=until,
        keep=keep,
    )


def metered(graph: NodeGraph, images: Mapping[str, Image], *, compensation_ev: float = 0.0) -> Exposure | None:
    """Exposure for the radiance among some images; None where graph and images say how to expose, or there is none.

    Raises:
        GraphError: see `meter`.
    """
    recorded = set[str]().union(*(image.provenance for image in images.values()))
    radiance = next((image for image in images.values() if image.quantity is Quantity.RADIANCE), None)
    if radiance is None or exposure_left_open(graph) <= recorded:
        return None
    return meter(radiance, graph, compensation_ev=compensation_ev)


def exposure_left_open(graph: NodeGraph) -> set[str]:
    """What a graph leaves to the camera, of exposure time and ISO."""
    return {"exposure_s", "iso"} & set(graph.settings_needed)

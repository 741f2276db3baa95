"""What a camera makes of light: of a frame, of a numpy array, or of a picture in a file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from synfog_usd import camera as camera_room
from synfog_usd.base import resources
from synfog_usd.base.errors import GraphError, ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.values import count, number, path_of, seconds
from synfog_usd.camera import writers
from synfog_usd.camera.exposure import Exposure, moments_of
from synfog_usd.camera.graph import NodeGraph, make_graph
from synfog_usd.camera.graph.outputs import suffix_of
from synfog_usd.dataset.frames import Frame
from synfog_usd.dataset.session import check_compensation
from synfog_usd.dataset.shot_files import inputs_of

if TYPE_CHECKING:
    Camera = str | os.PathLike[str] | Mapping[str, Any] | NodeGraph | None
    Light = Frame | npt.ArrayLike | str | os.PathLike[str] | Mapping[str, npt.ArrayLike | str | os.PathLike[str]]

PHONE = "phone"


@dataclass(frozen=True, eq=False)
class Photo:
    """What a camera took; `develop` makes it.

    Attributes:
        outputs: file name of the graph -> `Image`, with `pixels`, `channels` and `provenance`.
        exposure: `exposure_s` and `iso` as metered; None where the graph says them.
        graph: the node graph.
    """

    outputs: Mapping[str, Image]
    exposure: Exposure | None
    graph: NodeGraph
    _linear: Image | None

    def __repr__(self) -> str:
        metered = f", {self.exposure}" if self.exposure else ""
        return f"<Photo by {self.graph.name}{metered}: {', '.join(self.outputs)}>"

    @property
    def raw(self) -> npt.NDArray[Any]:
        """(H, W) uint16, or uint32 beyond 16 bits: what the sensor counted [DN], black level and colour filters in it.

        Raises:
            GraphError: the graph gives none.
        """
        pixels = self._of(Quantity.DN).pixels[:, :, 0]
        return pixels.astype(np.uint16 if pixels.max() < 2**16 else np.uint32)

    @property
    def linear(self) -> npt.NDArray[np.float32]:
        """(H, W, 3) float32: linear Rec.709, white-balanced, before the tone curve; 1 is the sensor's white.

        Raises:
            GraphError: the graph gives none.
        """
        return self._of(Quantity.LINEAR_RGB).pixels

    @property
    def srgb(self) -> npt.NDArray[np.uint8]:
        """(H, W, 3) uint8, sRGB; of a grey camera (H, W, 1).

        Raises:
            GraphError: the graph gives none.
        """
        return np.rint(np.clip(self._of(Quantity.DISPLAY_RGB).pixels, 0.0, 1.0) * np.float32(255)).astype(np.uint8)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write what a file's name asks for: .dng the RAW, .png or .jpg the picture, .exr linear light.

        A name of `outputs` is that output; another is the first output of its suffix, where the graph has one.

        Returns:
            the path.

        Raises:
            SynfogError: the graph gives nothing for this suffix, or it cannot be written.
        """
        path = path_of(path, "save")
        suffix = suffix_of(path.name)
        same_kind = [name for name in self.outputs if suffix_of(name) == suffix]
        name = path.name if path.name in same_kind else next(iter(same_kind), "")
        if name:
            image, options = self.outputs[name], self.graph.options_of(name)
        else:
            kinds = {".dng": Quantity.DN, ".exr": Quantity.LINEAR_RGB}
            image, options = self._of(kinds.get(suffix, Quantity.DISPLAY_RGB)), {}
        return writers.write_output(path.name, image, path.parent, options=options)

    def _of(self, quantity: Quantity) -> Image:
        images = [*([self._linear] if self._linear and quantity is Quantity.LINEAR_RGB else []), *self.outputs.values()]
        for image in images:
            if image.quantity is quantity:
                return image
        raise GraphError(
            f"graph {self.graph.name!r} gives no {quantity.value}; its outputs are {', '.join(self.outputs)}"
        )


def develop(
    light: Light,
    camera: Camera = None,
    *,
    meter: Light | None = None,
    exposure: float | str | None = None,
    iso: float | None = None,
    ev: float | None = None,
    change: Mapping[str, Any] | None = None,
    seed: int | None = None,
    fov_x_deg: float | None = None,
) -> Photo:
    """Take light with a simulated camera: lens, sensor and image processing.

    Args:
        light: a `Frame`; an array (H, W, 3), linear Rec.709 in cd m-2; a file (.exr, or a RAW for cameras that begin
            with one); or a mapping of these by the graph's inputs.
        camera: a name of `cameras`, a YAML graph, or its words as a mapping ({'extends': 'phone', 'nodes': [...]});
            that for which the frame's scene was loaded, else the phone, if left out.
        meter: light on which the exposure is metered; of a frame its view in clear air, else the light itself, if left
            out.
        exposure: time [s], or text as '1/200', instead of the meter's.
        iso: ISO speed instead of the meter's.
        ev: stops by which it is exposed brighter than the meter says.
        change: 'node.parameter' -> value, as `synfog-usd graph run --set` has it.
        seed: of the temporal noise; that of a bake's shot for a frame, else 0, if left out.
        fov_x_deg: horizontal field of view of arrays and files that say none [deg]; by the lens if left out.

    Raises:
        SynfogError: with place and fix.
    """
    graph = _graph_of(light, camera)
    fixed = {
        "exposure_s": None if exposure is None else seconds(exposure, "--exposure"),
        "iso": None if iso is None else number(iso, "--iso"),
    }
    graph = camera_room.exposed(graph.with_overrides(dict(change)) if change else graph, **fixed)
    frame = light if isinstance(light, Frame) else None
    if ev is None:
        ev = frame._taken.ev if frame else 0.0
    check_compensation(graph, number(ev, "--ev"))
    images = _inputs(light, graph, fov_x_deg)
    on = _inputs(meter, graph, fov_x_deg) if meter is not None and not isinstance(meter, Frame) else images
    metering_frame = meter if isinstance(meter, Frame) else frame if meter is None else None
    if metering_frame is not None:
        metered = camera_room.meter(metering_frame._taken.clear, graph, compensation_ev=ev) if _open(graph) else None
    else:
        metered = camera_room.metered(graph, on, compensation_ev=ev)
    if seed is None:
        seed = frame._taken.seed if frame else 0
    linear = _linear_node(graph)
    names = [*graph.outputs.values(), *([linear] if linear else [])]
    results = camera_room.develop(graph, images, seed=count(seed, "--seed"), exposure=metered, keep=names)
    outputs = {name: results[node] for name, node in graph.outputs.items()}
    return Photo(outputs, metered, graph, results[linear] if linear else None)


def cameras() -> list[str]:
    """Names of the simulated cameras that ship, as `develop`, `load` and `bake` take them."""
    return list(resources.shipped("pipeline"))


def _open(graph: NodeGraph) -> bool:
    return bool(camera_room.exposure_left_open(graph))


def _graph_of(light: Light, camera: Camera) -> NodeGraph:
    if camera is None and isinstance(light, Frame):
        graph: NodeGraph = light._taken.graph
        return graph
    if isinstance(camera, NodeGraph):
        return camera
    if isinstance(camera, Mapping):
        return make_graph(camera_room.OPS, **camera)
    return camera_room.load_graph(path_of(PHONE if camera is None else camera, "camera"))


def _linear_node(graph: NodeGraph) -> str | None:
    """The node that gives linear light before the tone curve: the last that corrects colours, else the last of its
    kind.
    """
    linear = [node for node in graph.nodes.values() if node.gives.quantity is Quantity.LINEAR_RGB]
    corrected = [node for node in linear if node.op.name == "isp.colour_correct"]
    return next((node.name for node in reversed(corrected or linear)), None)


def _inputs(light: Light, graph: NodeGraph, fov_x_deg: float | None) -> dict[str, Image]:
    """The graph's inputs from what was given."""
    if isinstance(light, Frame):
        return _of_frame(light, graph)
    named = light if isinstance(light, Mapping) else dict.fromkeys(graph.inputs, light)
    for name in named:
        if name not in graph.inputs:
            raise GraphError(f"graph {graph.name!r} has no input {name!r}; it has {', '.join(graph.inputs)}")
    images = {}
    for name, source in named.items():
        image = _image(source, graph.inputs[name].quantity or Quantity.RADIANCE, name)
        picture = image.quantity is not Quantity.DATA
        images[name] = camera_room.field_of_view(image, graph, fov_x_deg=fov_x_deg) if picture else image
    return images


def _of_frame(frame: Frame, graph: NodeGraph) -> dict[str, Image]:
    result, radiance = frame._taken.shot, frame._taken.image
    moves = bool(result.scene.camera.moves or result.scene.motion_of)
    exposures = {}
    for name in moments_of(graph):
        if moves and name not in result.exposures:
            raise GraphError(
                f"graph {graph.name!r} sees the exposure in parts, and things move in this frame; render it anew from "
                f"load(..., pipeline={graph.name!r})"
            )
        part = result.exposures.get(name, radiance)
        exposures[name] = radiance.with_pixels(part.pixels)
    inputs = inputs_of(graph, result.rendered, radiance, exposures)
    depth = Image(frame.depth_m[:, :, None], ("depth.Z",), Quantity.DATA)
    return inputs | {name: depth for name, port in graph.inputs.items() if port.quantity is Quantity.DATA}


def _image(light: npt.ArrayLike | Image | str | os.PathLike[str], quantity: Quantity, name: str) -> Image:
    if isinstance(light, Image):
        return light
    if isinstance(light, (str, os.PathLike)):
        return writers.read(Path(light), declared=quantity)
    try:
        pixels = np.asarray(light, dtype=np.float32)
    except (TypeError, ValueError):
        raise ImageError(f"{name}: {type(light).__name__}: it takes a frame, an array or the path of a file") from None
    mono = quantity in (Quantity.DATA, Quantity.DN)
    pixels = pixels[:, :, None] if mono and pixels.ndim == 2 else pixels
    channels = ("Y",) if mono else ("R", "G", "B")
    if pixels.ndim != 3 or 0 in pixels.shape or pixels.shape[2] != len(channels):
        takes = "(H, W)" if mono else "(H, W, 3), linear Rec.709 in cd m-2"
        raise ImageError(f"{name}: an array of shape {np.shape(light)}; it takes {takes}")
    image = Image(pixels, channels, quantity)
    if quantity is Quantity.RADIANCE:
        writers.check_radiance(image, name)
    return image

"""Op that says that a picture is a fisheye's: rendered by the rays of the lens, not bent afterwards.

Takes radiance that was rendered so, or of another program's fisheye; what follows finds the lens in the provenance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import GraphError, ImageError
from synfog_usd.base.fisheye import Fisheye
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import FromProfile, NodeGraph, Range
from synfog_usd.camera.registry import OPS

OP = "optics.fisheye"


@OPS.op(OP, takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)
def fisheye(
    image: Image,
    *,
    coefficients: Annotated[tuple[float, ...], Range(-1e6, 1e6), FromProfile("lens.fisheye")],
    fov_x_deg: Annotated[float, Range(1.0, 360.0), FromProfile("lens.fisheye_fov_x_deg")],
) -> Image:
    """The picture is a fisheye's: the distance from its axis is c1 t + c2 t^2 + ... of the angle t to the axis.

    A bake of a graph with this node renders by these rays, whatever focal length the stage's camera has, and labels
    are of the same rays.  Pixels stay as they are: a pinhole's picture is no fisheye's, and is refused.  A picture of
    another program that tells no angle of view is taken for one of this lens.

    Args:
        image: radiance of a fisheye.
        coefficients: c1, c2 ... to any common scale, as calibrated in pixels, in millimetres or in focal lengths.
            OpenCV's k1 to k4 are c3, c5, c7 and c9, with c1 = 1 and the rest 0.
        fov_x_deg: horizontal angle of view through the axis [degrees]; it sets the scale.

    Raises:
        ImageError: a radius that falls within the angle of view, a pinhole's picture, or one of another fisheye.

    Source: Kannala and Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
    fish-eye lenses" (2006), equation 6.
    """
    lens = _lens(tuple(coefficients), fov_x_deg)
    if "fov_x_deg" in image.provenance:
        raise ImageError(
            f"the picture is a pinhole's of {float(image.provenance['fov_x_deg']):g} degrees, and this lens a fisheye; "
            f"render by its rays: bake a stage with this graph"
        )
    if (recorded := of_picture(image.provenance)) is not None and recorded != lens:
        raise ImageError("the picture was rendered by the rays of another fisheye; bake it again with this graph")
    return image.with_metadata(fisheye_coefficients=list(lens.coefficients), fisheye_fov_x_deg=fov_x_deg)


def of_picture(metadata: Mapping[str, Any]) -> Fisheye | None:
    """The lens of a picture, by its provenance; None for one that is no fisheye's."""
    if "fisheye_coefficients" not in metadata:
        return None
    return _lens(tuple(map(float, metadata["fisheye_coefficients"])), float(metadata["fisheye_fov_x_deg"]))


def of_graph(graph: NodeGraph) -> Fisheye | None:
    """The lens by whose rays a picture for a graph has to be rendered; None where a pinhole's do.

    Raises:
        GraphError: several such nodes, one beside a lens that distorts, or a radius that falls.
    """
    nodes = graph.nodes_with(OP)
    if not nodes:
        return None
    for extra in (*nodes[1:], *graph.nodes_with("optics.distortion")):
        if extra.op.name == OP or extra.params["coefficients"].value:
            raise GraphError(
                f"{extra.place}: graph {graph.name!r} has a fisheye already, which no second lens can bend"
            )
    params = nodes[0].params
    try:
        return _lens(tuple(params["coefficients"].value), float(params["fov_x_deg"].value))
    except ImageError as problem:
        raise GraphError(f"{nodes[0].place}: {problem}") from problem


def angles_rad(lens: Fisheye, height: int, width: int, shift: tuple[float, float]) -> Array:
    """(H, W) angle between each pixel's centre and the axis [rad].

    Raises:
        ImageError: corners beyond what the lens shows.
    """
    x = (np.arange(width) + 0.5) / width - 0.5 - shift[0]
    y = (np.arange(height) + 0.5 - height / 2.0 + shift[1] * height) / width
    theta = lens.angle(np.hypot(x[None, :], y[:, None]))
    if np.isnan(theta).any():
        raise ImageError(
            f"{np.isnan(theta).mean():.1%} of the pixels lie beyond the picture of the fisheye, which ends at "
            f"{np.degrees(lens.reach_rad):.1f} degrees; take a picture of fewer rows, or a larger fov_x_deg"
        )
    return np.asarray(theta)


def _lens(coefficients: tuple[float, ...], fov_x_deg: float) -> Fisheye:
    try:
        return Fisheye(coefficients, fov_x_deg)
    except ValueError as problem:
        raise ImageError(f"the fisheye's coefficients: {problem}") from problem

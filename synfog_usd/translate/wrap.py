"""What a picture is beyond its square, as pictures that one mode for both directions can repeat.

Takes pixels and a mode for each direction; gives pixels, one mode and the map that
takes the coordinates to them.  Source of the modes: UsdPreviewSurface specification,
UsdUVTexture, wrapS and wrapT.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[Any]

MODES = ("repeat", "mirror", "clamp", "black")

_EDGE = 2
"""Texels around a picture that is black beyond its square: one of its own, so that its rim stays as it is, and a black one."""


@dataclass(frozen=True)
class Wrapped:
    """A picture to be looked up with one mode.

    Attributes:
        pixels: (H, W, C), row 0 at the top.
        mode: 'repeat', 'mirror' or 'clamp'.
        scale, shift: (u, v) of the map from the picture's own coordinates.
    """

    pixels: Pixels
    mode: str
    scale: tuple[float, float] = (1.0, 1.0)
    shift: tuple[float, float] = (0.0, 0.0)


def wrapped(pixels: Pixels, wraps: tuple[str, str], outside: Pixels) -> Wrapped:
    """A picture with a mode for each direction as one that has a single mode.

    Where one direction ends and the other goes on, the picture ends a whole length of
    itself beyond its square.

    Args:
        pixels: (H, W, C).
        wraps: modes along u and v, of `MODES`.
        outside: (C,) what 'black' shows.
    """
    if wraps[0] == wraps[1] and wraps[0] != "black":
        return Wrapped(pixels, wraps[0])
    ends = [wrap in ("clamp", "black") for wrap in wraps]
    scale, shift = [1.0, 1.0], [0.0, 0.0]
    for direction, (axis, wrap) in enumerate(zip((1, 0), wraps, strict=True)):
        size = pixels.shape[axis]
        if wrap == "mirror" and wraps[1 - direction] != "mirror":
            turned = np.flip(pixels, axis)
            pixels = np.concatenate([pixels, turned] if axis else [turned, pixels], axis=axis)
            scale[direction] = 0.5
        elif ends[direction] and (wrap == "black" or not all(ends)):
            rim = _EDGE if all(ends) else size + 1
            pixels = _framed(pixels, axis, rim, outside if wrap == "black" else None)
            scale[direction], shift[direction] = size / (size + 2 * rim), rim / (size + 2 * rim)
    return Wrapped(np.ascontiguousarray(pixels), "clamp" if all(ends) else "repeat", (scale[0], scale[1]), (shift[0], shift[1]))


def _framed(pixels: Pixels, axis: int, rim: int, outside: Pixels | None) -> Pixels:
    """A picture with a rim of `rim` texels at both ends: its last texel once, then `outside`, or its last texel throughout."""
    margins = [(0, 0)] * 3
    margins[axis] = (rim, rim)
    result: Pixels = np.pad(pixels, margins, mode="edge")
    if outside is not None:
        along = np.moveaxis(result, axis, 0)
        along[: rim - 1] = outside
        along[len(along) - rim + 1 :] = outside
    return result

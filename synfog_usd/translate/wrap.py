"""Texture wrap modes: two of USD's, one for u and one for v, as the single one that Mitsuba's bitmap texture has.

USD wraps u and v apart ('repeat', 'mirror', 'clamp', 'black'); Mitsuba takes one mode for both and knows no 'black'.
Where the
two differ, texels are added until one mode does: a mirrored copy beside the picture for 'mirror', a rim for 'clamp' and
'black'. Takes pixels and the two modes; gives pixels, one mode, and the scale and shift of (u, v) that find the old
texels in them.
Source of the modes: UsdPreviewSurface specification, UsdUVTexture, inputs wrapS and wrapT.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synfog_usd.base.arrays import Pixels

MODES = ("repeat", "mirror", "clamp", "black")

_EDGE = 2
"""Texels around a picture that is black beyond its square: one of its own, so that its rim stays as it is, and a black
one.
"""


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
    """A texture with a wrap mode for each direction, as one with a single mode.

    Where one direction is clamped and the other repeats, the clamped one repeats, too, but with a rim of its own
    length: it is right up to one whole picture beyond [0, 1].

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
    return Wrapped(
        np.ascontiguousarray(pixels), "clamp" if all(ends) else "repeat", (scale[0], scale[1]), (shift[0], shift[1])
    )


def _framed(pixels: Pixels, axis: int, rim: int, outside: Pixels | None) -> Pixels:
    """A picture with a rim of `rim` texels at both ends: its last texel once, then `outside`, or its last texel
    throughout.
    """
    margins = [(0, 0)] * 3
    margins[axis] = (rim, rim)
    result: Pixels = np.pad(pixels, margins, mode="edge")
    if outside is not None:
        along = np.moveaxis(result, axis, 0)
        along[: rim - 1] = outside
        along[len(along) - rim + 1 :] = outside
    return result

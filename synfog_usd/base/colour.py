"""Linear Rec.709 and sRGB: the one transfer function, and the one set of luminance weights.

Arrays in, arrays out, of the same type.  In numpy: colour-science takes a second to
import, and OpenImageIO's conversion is four times slower, depends on the environment
variable OCIO, and is off by 1e-5.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array

Floats = TypeVar("Floats", npt.NDArray[np.float32], npt.NDArray[np.float64])

LUMINANCE: Array = np.array([0.2126729, 0.7151522, 0.0721750])
"""Luminance of linear Rec.709: second row of its matrix to CIE XYZ, for the primaries of ITU-R BT.709 and a white of
(0.95047, 1, 1.08883).
"""

TO_XYZ: Array = np.array(
    [
        [0.41239080, 0.35758434, 0.18048079],
        [0.21263901, 0.71516868, 0.07219232],
        [0.01933082, 0.11919478, 0.95053215],
    ]
)
"""Linear Rec.709 to CIE XYZ, for the primaries and the white of ITU-R BT.709 in four digits."""

PRIMARIES_NM = (611.0, 549.0, 464.0)
"""Dominant wavelengths [nm] of its primaries, at which R, G and B see a medium that is coloured."""


def srgb_encode(linear: Floats, out: Floats | None = None) -> Floats:
    """sRGB codes of linear values of any shape, cut to the range of a screen; of the type of `linear`.

    The codes are in `out` where that is given.

    Source: IEC 61966-2-1.

    >>> [round(float(value), 4) for value in srgb_encode(np.array([0.0, 0.18, 1.0, 7.0]))]
    [0.0, 0.4614, 1.0, 1.0]
    """
    kind = linear.dtype.type
    encoded = np.clip(linear, kind(0.0031308), kind(1.0))
    clipped = np.clip(linear, kind(0.0), kind(1.0), out=out)
    np.log2(encoded, out=encoded)  # a power in two steps, each vector code, takes half the time of `np.power`
    encoded *= kind(1.0 / 2.4)
    np.exp2(encoded, out=encoded)
    encoded *= kind(1.055)
    encoded -= kind(0.055)
    clipped *= kind(12.92)
    return np.minimum(encoded, clipped, out=out)  # the straight line is the lower one up to 0.0031308


def srgb_decode(code: Floats) -> Floats:
    """Linear values of sRGB codes of any shape; the inverse of `srgb_encode`, which goes on above 1 and, straight,
    below 0.

    >>> [round(float(value), 4) for value in srgb_decode(np.array([0.0, 0.02, 0.4614, 1.0]))]
    [0.0, 0.0015, 0.18, 1.0]
    """
    kind = code.dtype.type
    linear = np.maximum(code, kind(0.0))
    linear += kind(0.055)
    linear /= kind(1.055)
    np.power(linear, kind(2.4), out=linear)
    np.copyto(linear, code / kind(12.92), where=code <= 0.04045)
    return linear


SRGB_TO_LINEAR: npt.NDArray[np.float32] = srgb_decode(np.arange(256) / 255.0).astype(np.float32)
"""Linear value of each 8-bit sRGB code."""

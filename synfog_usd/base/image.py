"""The picture that passes between rooms: pixels, what they measure, and how well.

`Quantity` is the type system of the node graph; `Image` is the one thing that
`render`, `graph`, `camera` and `writers` have in common.  Knows no file format.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ImageError

PARALLEL_DEG = 1e-3
"""Angle of view that an orthographic camera is said to have: its rays are parallel, and a lens has nothing to bend or
to dim.
"""


class Quantity(enum.Enum):
    """What a pixel's number measures.

    RADIANCE is in W m-2 sr-1 nm-1 for bands; a three-channel R, G, B radiance is
    linear Rec.709 in cd m-2, so that (1, 1, 1) has a luminance of one nit.
    """

    RADIANCE = "radiance"
    IRRADIANCE = "irradiance"
    ELECTRONS = "electrons"
    DN = "dn"
    LINEAR_RGB = "linear_rgb"
    DISPLAY_RGB = "display_rgb"
    DATA = "data"
    """Not light: depth, ids, transmittance, variance."""


@dataclass(frozen=True)
class Image:
    """Pixels with their meaning.

    Attributes:
        pixels: (H, W, C) float32, row 0 at the top; the order in memory is free (`arrays.planar`).
        channels: C names, for example ('R', 'G', 'B') or ('transmittance.Y',).
        quantity: what the numbers measure.
        variance: (H, W, C) float32, variance of the mean of each pixel, or None.
        provenance: metadata that travels with the picture (exposure, sensor, shot);
            keys are lower_snake_case with a unit suffix, values are JSON-like.
    """

    pixels: FloatArray
    channels: tuple[str, ...]
    quantity: Quantity
    variance: FloatArray | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = self.pixels.shape
        if len(shape) != 3 or shape[2] != len(self.channels) or 0 in shape:
            raise ImageError(f"pixels of shape {shape} do not fit {len(self.channels)} channels {self.channels}")
        if self.pixels.dtype != np.float32:
            raise ImageError(f"pixels are {self.pixels.dtype}; an Image holds float32")
        if self.variance is not None and self.variance.shape != shape:
            raise ImageError(f"variance of shape {self.variance.shape} does not fit pixels of shape {shape}")

    @property
    def height_px(self) -> int:
        """Rows."""
        return int(self.pixels.shape[0])

    @property
    def width_px(self) -> int:
        """Columns."""
        return int(self.pixels.shape[1])

    def with_pixels(self, pixels: FloatArray, **changes: Any) -> Image:
        """A copy with other pixels; the variance is dropped unless it is given."""
        changes.setdefault("variance", None)
        return replace(self, pixels=np.asarray(pixels, dtype=np.float32), **changes)

    def with_metadata(self, **metadata: Any) -> Image:
        """A copy whose provenance also holds `metadata`."""
        return replace(self, provenance={**self.provenance, **metadata})

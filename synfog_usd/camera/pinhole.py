"""The geometry of a picture without distortion: its size, angle of view, and where its axis is."""

from __future__ import annotations

import math
from typing import NamedTuple

from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image

MOST_SHIFT = 10.0
"""Offset of the axis, in pictures."""


class Pinhole(NamedTuple):
    """A picture without distortion: its size, angle of view [degrees], and offset of the axis in widths and heights,
    right and up.
    """

    height_px: int
    width_px: int
    fov_x_deg: float
    shift: tuple[float, float]

    @classmethod
    def of(cls, image: Image, fov_x_deg: float) -> Pinhole:
        """That of an image, whose provenance may say an offset of the axis (`shift_x`, `shift_y`).

        Raises:
            ImageError: an offset that is none.
        """
        return cls(image.height_px, image.width_px, fov_x_deg, shift_of(image))

    @property
    def focal_px(self) -> float:
        """Focal length [px]."""
        return self.width_px / 2 / math.tan(math.radians(self.fov_x_deg) / 2)

    @property
    def axis_px(self) -> tuple[float, float]:
        """Column and row of the axis [px]."""
        return (self.width_px - 1) / 2 + self.shift[0] * self.width_px, (self.height_px - 1) / 2 - self.shift[
            1
        ] * self.height_px


def shift_of(image: Image) -> tuple[float, float]:
    """Offset of the axis from a picture's centre, in widths and heights, right and up; 0 where it says none.

    Raises:
        ImageError: it says no number within 10.
    """
    offset = image.provenance.get("shift_x", 0.0), image.provenance.get("shift_y", 0.0)
    try:
        right, up = float(offset[0]), float(offset[1])
    except (TypeError, ValueError):
        right = up = math.nan
    if not (abs(right) <= MOST_SHIFT and abs(up) <= MOST_SHIFT):
        raise ImageError(f"the image's shift_x and shift_y are {offset[0]!r} and {offset[1]!r}; each is from -10 to 10")
    return right, up

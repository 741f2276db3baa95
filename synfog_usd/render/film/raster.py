"""A picture's pixels as a kernel sees them.

Its size stays out of the kernel's text, so that a pilot, the metered frame and the
picture share their kernels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from synfog_usd.render import backend
from synfog_usd.scene import Camera

if TYPE_CHECKING:
    from drjit.auto.ad import UInt32
    from mitsuba import Point2f


class Raster:
    """The size of a camera's picture, out of the compiler's sight.

    Attributes:
        width, height: whole numbers of pixels.
        size: both as floats.
    """

    def __init__(self, camera: Camera) -> None:
        mi = backend.mitsuba()
        self.width, self.height = dr.opaque(mi.UInt32, camera.width_px), dr.opaque(mi.UInt32, camera.height_px)
        self.size = mi.Point2f(mi.Float(self.width), mi.Float(self.height))
        dr.make_opaque(self.size)

    def corner(self, pixel: UInt32) -> Point2f:
        """(u, v) of the top left corners of pixels, numbered row by row from the top left, in pixels."""
        mi = backend.mitsuba()
        return mi.Point2f(mi.Float(pixel % self.width), mi.Float(pixel // self.width))

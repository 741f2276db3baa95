"""The one door between an `Image` and OpenImageIO's `ImageBuf`.

OpenImageIO is imported when a door is used.  Shapes are always (H, W, C): a
two-dimensional array would be stored as garbage by `set_pixels`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image

if TYPE_CHECKING:
    import OpenImageIO


def to_buf(image: Image) -> OpenImageIO.ImageBuf:
    """An ImageBuf with the pixels and channel names of `image`, float32."""
    import OpenImageIO

    buf = OpenImageIO.ImageBuf(np.ascontiguousarray(image.pixels))
    buf.specmod().channelnames = image.channels
    return checked(buf, "make an ImageBuf")


def from_buf(buf: OpenImageIO.ImageBuf, like: Image, **changes: Any) -> Image:
    """The Image in `buf`, with the meaning and provenance of `like` unless `changes` says otherwise."""
    return like.with_pixels(pixels_of(buf), **changes)


def pixels_of(buf: OpenImageIO.ImageBuf) -> FloatArray:
    """(H, W, C) float32 pixels of an ImageBuf."""
    import OpenImageIO

    spec = checked(buf, "read an ImageBuf").spec()
    return np.asarray(buf.get_pixels(OpenImageIO.FLOAT), dtype=np.float32).reshape(
        spec.height, spec.width, spec.nchannels
    )


def checked(buf: OpenImageIO.ImageBuf, what: str) -> OpenImageIO.ImageBuf:
    """`buf` itself, or an ImageError where OpenImageIO failed: a failed call returns an empty buffer.

    Raises:
        ImageError: with OpenImageIO's own words.
    """
    if buf.has_error:
        raise ImageError(f"OpenImageIO could not {what}: {buf.geterror()}")
    if not buf.initialized:
        raise ImageError(f"OpenImageIO could not {what}: the result is empty")
    return buf

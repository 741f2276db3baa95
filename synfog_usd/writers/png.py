"""PNG files: 8-bit sRGB for screens.  OpenImageIO is imported on first use."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from synfog_usd.errors import ImageError
from synfog_usd.files import write_whole
from synfog_usd.image import Image, Quantity
from synfog_usd.writers.exr import _save


def write_png(path: Path, image: Image) -> None:
    """Write a picture for a screen: 0 to 1 becomes 0 to 255, rounded.

    Args:
        path: where to.
        image: DISPLAY_RGB with one or three channels, already coded as sRGB.

    Raises:
        ImageError: another quantity, or NaN.
        OutputError: it cannot be written.
    """
    if image.quantity is not Quantity.DISPLAY_RGB:
        raise ImageError(f"{path}: a PNG takes display_rgb; this image is {image.quantity.value}. Put isp.gamma before it")
    if len(image.channels) not in (1, 3):
        raise ImageError(f"{path}: a PNG takes 1 or 3 channels; this image has {', '.join(image.channels)}")
    if np.isnan(image.pixels).any():
        raise ImageError(f"{path}: the image holds NaN")
    coded = np.rint(np.clip(image.pixels, 0.0, 1.0) * np.float32(255.0)).astype(np.uint8)
    write_whole(path, lambda temporary: _write(temporary, path, coded))


def _write(temporary: Path, path: Path, coded: np.ndarray) -> None:
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(coded.shape[1], coded.shape[0], coded.shape[2], OpenImageIO.UINT8)
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("png:compressionLevel", 4)
    _save(temporary, path, spec, coded)

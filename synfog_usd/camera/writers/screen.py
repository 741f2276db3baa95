"""PNG and JPEG: pictures for screens.

The same bytes for the same image.  OpenImageIO is imported on first use.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from synfog_usd.base.errors import ImageError
from synfog_usd.base.files import write_whole
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers.exr import save


def write_png(path: Path, image: Image, *, bits: Literal[8, 16] = 8) -> None:
    """Write a picture for a screen, rounded to whole numbers.

    Args:
        path: where to.
        image: DISPLAY_RGB with one or three channels, already coded as sRGB.
        bits: of each channel.

    Raises:
        ImageError: another quantity, or NaN.
        OutputError: it cannot be written.
    """
    _write(path, _coded(path, "PNG", image, bits), {"oiio:ColorSpace": "sRGB", "png:compressionLevel": 4})


def png16(pixels: np.ndarray) -> bytes:
    """(H, W, 3) uint16 as PNG: numbers, not colours."""
    import imagecodecs

    return bytes(imagecodecs.png_encode(np.ascontiguousarray(pixels), level=4))


def write_jpeg(
    path: Path, image: Image, *, quality: int = 95, subsampling: Literal["4:2:0", "4:2:2", "4:4:4"] = "4:2:0"
) -> None:
    """Write a picture for a screen as JPEG, with the loss that files of real cameras have.

    Args:
        path: where to.
        image: DISPLAY_RGB with one or three channels, already coded as sRGB.
        quality: libjpeg's, 1 to 100; cameras write 90 to 98, recordings of data sets often 75.
        subsampling: of colour; 4:2:0 keeps one value for four pixels.

    Raises:
        ImageError: another quantity, or NaN.
        OutputError: it cannot be written.
    """
    _write(
        path,
        _coded(path, "JPEG", image, 8),
        {
            "oiio:ColorSpace": "sRGB",
            "Compression": f"jpeg:{quality}",
            "jpeg:subsampling": subsampling,
        },
    )


def _coded(path: Path, kind: str, image: Image, bits: int) -> np.ndarray:
    """(H, W, C) whole numbers of a picture for a screen; what is below 0 or above 1 is clipped."""
    if image.quantity is not Quantity.DISPLAY_RGB:
        raise ImageError(
            f"{path}: a {kind} takes display_rgb; this image is {image.quantity.value}. Put isp.gamma before it"
        )
    if len(image.channels) not in (1, 3):
        raise ImageError(f"{path}: a {kind} takes 1 or 3 channels; this image has {', '.join(image.channels)}")
    if np.isnan(image.pixels).any():
        raise ImageError(f"{path}: the image holds NaN")
    return np.rint(np.clip(image.pixels, 0.0, 1.0) * np.float32(2**bits - 1)).astype(
        np.uint8 if bits == 8 else np.uint16
    )


def _write(path: Path, numbers: np.ndarray, metadata: Mapping[str, str | int]) -> None:
    import OpenImageIO

    height, width, channels = numbers.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, numbers.dtype.name)
    for name, value in metadata.items():
        spec.attribute(name, value)
    write_whole(path, lambda temporary: save(temporary, path, spec, numbers))

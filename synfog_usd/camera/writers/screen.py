"""PNG, JPEG, JPEG XL and TIFF: pictures for screens and print, and floats where no EXR is wanted.

The same bytes for the same image.  OpenImageIO is imported on first use.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from synfog_usd import __version__
from synfog_usd.base.errors import ImageError, OutputError
from synfog_usd.base.files import write_whole
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers.exr import FIXED_DATE, check_finite, save

JXL_EFFORT = 1
"""Of 1 to 9.  The usual 7 takes a hundred times as long as 1 without loss, and saves an eighth of the size."""


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


def write_jxl(path: Path, image: Image, *, bits: Literal[8, 16] = 8, lossless: bool = True) -> None:
    """Write a picture for a screen as JPEG XL.

    Args:
        path: where to.
        image: DISPLAY_RGB with one or three channels, already coded as sRGB; one
            is written three times, because OpenImageIO 3.2 fails at grey ones.
        bits: of each channel.
        lossless: exact numbers; else a butteraugli distance of 1, meant not to be seen.

    Raises:
        ImageError: another quantity, or NaN.
        OutputError: it cannot be written.
    """
    if not isinstance(lossless, bool):
        raise OutputError(f"{path}: lossless is {lossless!r}; it takes true or false")
    numbers = _coded(path, "JPEG XL", image, bits)
    if numbers.shape[2] == 1:
        numbers = numbers.repeat(3, axis=2)
    _write(
        path,
        numbers,
        {"oiio:ColorSpace": "sRGB", "jpegxl:distance": 0.0 if lossless else 1.0, "jpegxl:effort": JXL_EFFORT},
    )


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
        OutputError: it cannot be written, or the option does not fit.
    """
    if type(quality) is not int or not 1 <= quality <= 100:
        raise OutputError(f"{path}: quality is {quality!r}; it takes a whole number from 1 to 100")
    if subsampling not in ("4:2:0", "4:2:2", "4:4:4"):
        raise OutputError(f"{path}: subsampling is {subsampling!r}; it takes 4:2:0, 4:2:2 or 4:4:4")
    _write(
        path,
        _coded(path, "JPEG", image, 8),
        {
            "oiio:ColorSpace": "sRGB",
            "Compression": f"jpeg:{quality}",
            "jpeg:subsampling": subsampling,
        },
    )


def write_tiff(path: Path, image: Image, *, bits: Literal[8, 16, 32] | None = None) -> None:
    """Write a TIFF: whole numbers for a screen, or 32-bit floats of anything.

    Compressed without loss (deflate); ImageDescription is JSON with the image's
    quantity, channels and provenance.

    Args:
        path: where to.
        image: DISPLAY_RGB for 8 and 16 bits; any, a mosaic too, for 32.
        bits: of each channel; by default 16 for DISPLAY_RGB and 32 for the rest.

    Raises:
        ImageError: the image does not fit the bits, or is light that is not finite.
        OutputError: it cannot be written.
    """
    screen = image.quantity is Quantity.DISPLAY_RGB
    bits = bits if bits is not None else 16 if screen else 32
    metadata = {
        "compression": "zip",
        "DateTime": FIXED_DATE,  # OpenImageIO writes the clock's unless one is given
        "Software": f"synfog-usd {__version__}",
        "ImageDescription": json.dumps(
            {"quantity": image.quantity.value, "channels": image.channels, "provenance": dict(image.provenance)},
            sort_keys=True,
            default=str,
        ),
    }
    if screen:
        metadata["oiio:ColorSpace"] = "sRGB"
    if bits == 32:
        check_finite(image, str(path))
        _write(path, image.pixels, metadata)
    elif screen or bits not in (8, 16):
        _write(path, _coded(path, "TIFF", image, bits), metadata)
    else:
        raise ImageError(
            f"{path}: a TIFF of {bits} bits takes display_rgb; this image is {image.quantity.value}. Write 32 bits, or "
            f"put isp.gamma before it"
        )


def _coded(path: Path, kind: str, image: Image, bits: int) -> np.ndarray:
    """(H, W, C) whole numbers of a picture for a screen; what is below 0 or above 1 is clipped."""
    if bits not in (8, 16):
        raise OutputError(f"{path}: bits is {bits!r}; a {kind} takes {'8, 16 or 32' if kind == 'TIFF' else '8 or 16'}")
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


def _write(path: Path, numbers: np.ndarray, metadata: Mapping[str, Any]) -> None:
    write_whole(path, lambda temporary: _put(temporary, path, numbers, metadata))


def _put(temporary: Path, path: Path, numbers: np.ndarray, metadata: Mapping[str, Any]) -> None:
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(
        numbers.shape[1], numbers.shape[0], numbers.shape[2], numbers.dtype.name.replace("float32", "float")
    )
    for name, value in metadata.items():
        spec.attribute(name, value)
    save(temporary, path, spec, numbers)

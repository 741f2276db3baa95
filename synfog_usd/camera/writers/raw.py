"""RAW files of cameras: the sensor's numbers and what the file says of them, decoded by LibRaw.

A DNG's black, white and active area are read from its tags.  A DNG of JPEG XL, which LibRaw does not decode, is handed
to it with its numbers laid bare.

Gives what `sensor.adc` gives, so that the second half of a graph serves real pictures
too.  rawpy is imported on first use.
"""

from __future__ import annotations

import io
import logging
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers import dng_levels
from synfog_usd.camera.writers.tiff_tags import Directory

if TYPE_CHECKING:
    import rawpy
    import tifffile

BAYER = ("RGGB", "GRBG", "GBRG", "BGGR")

JPEG_XL = 52546
"""DNG's number of it as a compression (1.7)."""

EXIF = {
    "exposure_s": "ExposureTime",
    "iso": "ISOSpeedRatings",
    "f_number": "FNumber",
    "focal_length_mm": "FocalLength",
}

MOST_PIXELS = 1 << 28
"""Of a mosaic that is decoded here."""

KEPT_TAGS = (
    *(271, 272, 274, 33421, 33422, 50708, *range(50710, 50718)),  # camera, filters, their levels
    *(*range(50721, 50733), 50778, 50779, 50829, 50964, 50965, 51041),  # colours, active area, noise
)
"""Tags of a DNG that say what its numbers mean, but for how they are packed."""


def read_raw(path: Path) -> Image:
    """Read the mosaic of a RAW file: DNG, and whatever LibRaw opens.

    Args:
        path: the file.

    Returns:
        DN, one channel, not turned.  The provenance has `cfa_pattern`, `black_level_dn`, `white_level_dn`,
        `as_shot_neutral` (R, G, B), `camera_to_rec709` where the file or LibRaw's table of cameras has a matrix; and as
        far as the file says them `noise_profile`, `exposure_s`, `iso`, `f_number` and `focal_length_mm`.  Blacks that
        differ by place are made one: a DNG's the greatest, from which its white is counted; others' their mean.

    Raises:
        ImageError: missing, no RAW file, damaged, or no Bayer mosaic of one number a pixel.

    Source: Adobe, "Digital Negative (DNG) Specification" 1.7.1.0.
    """
    import rawpy

    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    try:
        directories = dng_levels.directories_of_dng(path)
        source, more = _bare(path, directories) or (str(path), {})
        with rawpy.imread(source) as raw:
            pixels, metadata = _mosaic(path, raw, directories)
    except ImageError:
        raise
    except Exception as error:  # a damaged file can fail anywhere
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else error
        raise ImageError(
            f"{path}: cannot be read as RAW ({str(reason) or type(error).__name__}); an EXR, a DNG or another camera's "
            f"RAW file is needed"
        ) from error
    metadata |= more | dng_levels.noise_profile(directories)
    return Image(pixels[..., None], ("CFA",), Quantity.DN, provenance=metadata)


def _mosaic(path: Path, raw: rawpy.RawPy, directories: list[Directory]) -> tuple[FloatArray, dict[str, Any]]:
    """(H, W) numbers above one black, and the provenance."""
    import rawpy

    if raw.sizes.raw_height * raw.sizes.raw_width > MOST_PIXELS:
        raise ImageError(f"{path}: {raw.sizes.raw_width} x {raw.sizes.raw_height} pixels; at most {MOST_PIXELS}")
    if raw.raw_type is not rawpy.RawType.Flat or raw.raw_image_visible is None:
        raise ImageError(f"{path}: holds no mosaic of one number a pixel")
    shape = (raw.sizes.raw_height, raw.sizes.raw_width)
    mosaic = next(
        (directory for directory in dng_levels.mosaics(directories) if dng_levels.shape_of(directory) == shape), None
    )
    if directories and mosaic is None:
        raise ImageError(f"{path}: LibRaw finds a mosaic of {shape[1]} x {shape[0]} pixels; the DNG's tags have none")
    if mosaic is None or dng_levels.of_floats(mosaic):  # LibRaw makes whole numbers of floats, and levels that fit
        filters = raw.raw_colors_visible
        metadata = _metadata(path, raw, filters)
        blacks = np.array(raw.black_level_per_channel, dtype=np.float32)
        black = float(blacks[filters[:2, :2].ravel()].mean())
        pixels = raw.raw_image_visible.astype(np.float32) - (blacks - np.float32(black))[filters]
        return pixels, metadata | {"black_level_dn": black, "white_level_dn": float(raw.white_level)}
    levels = dng_levels.levels(mosaic)
    top, x0, bottom, right = levels.active
    metadata = _metadata(path, raw, raw.raw_colors[top:bottom, x0:right])
    black = float(levels.black.max())
    pixels = raw.raw_image[top:bottom, x0:right].astype(np.float32) + (np.float32(black) - levels.black)
    return pixels, metadata | {"black_level_dn": black, "white_level_dn": levels.white}


def _bare(path: Path, directories: list[Directory]) -> tuple[io.BytesIO, dict[str, Any]] | None:
    """A DNG whose mosaic is of JPEG XL as one without compression, and how it was taken; None for any other file.

    Fields of rows and columns that stand side by side in it are put to their places.
    """
    if not any(dng_levels.compression_of(mosaic) == JPEG_XL for mosaic in dng_levels.mosaics(directories)):
        return None
    import tifffile

    logging.getLogger("tifffile").addHandler(logging.NullHandler())  # what it finds wrong is one line of ours
    mosaics = []
    try:
        with tifffile.TiffFile(path) as file:
            first: Any = file.pages[0]
            mosaics = [
                page
                for page in (first, *(first.pages or ()))
                if (page.compression, page.photometric) == (JPEG_XL, 32803)
                and max(page.size, math.prod(page.chunks)) <= MOST_PIXELS
            ]
            if not mosaics:
                return None
            stored = _decoded(mosaics[0])
            tags = {tag.code: tag for page in (first, mosaics[0]) for tag in page.tags.values()}
            places = [
                np.concatenate([np.arange(field, length, fields) for field in range(fields)])
                for length, fields in zip(
                    stored.shape, (int(tags[code].value) if code in tags else 1 for code in (50975, 52547)), strict=True
                )
            ]
            pixels = np.empty_like(stored)
            pixels[np.ix_(*places)] = stored
            tags_kept = [
                (tag.code, int(tag.dtype), tag.count, tag.value, True)
                for code, tag in sorted(tags.items())
                if code in KEPT_TAGS
            ]
            exif = {**dict.fromkeys(EXIF.values(), 0), **(tags[34665].value if 34665 in tags else {})}
        bare = io.BytesIO()
        with tifffile.TiffWriter(bare) as writer:
            version = (50706, 1, 4, bytes((1, 4, 0, 0)), True)
            writer.write(pixels, photometric=32803, metadata=None, extratags=[version, *tags_kept])
        bare.seek(0)
        values = {name: np.atleast_1d(exif[key]).astype(float) for name, key in EXIF.items()}
        return bare, {name: float(part[0] / part[1:].prod()) for name, part in values.items() if (part > 0.0).all()}
    except Exception as error:  # a damaged file can fail anywhere in its decoders
        if not mosaics:
            return None  # LibRaw says what is wrong with it
        raise ImageError(f"{path}: its JPEG XL cannot be decoded ({error or type(error).__name__})") from error


def _decoded(page: tifffile.TiffPage) -> np.ndarray:
    """(H, W) numbers of a page of JPEG XL.

    A tile of another size than the page says is refused before it is decoded: a few bytes may declare any.
    """
    import imagecodecs

    decoded = np.empty(page.shape, page.dtype)
    (rows, columns), file = page.chunks, page.parent.filehandle
    corners = [
        (row, column) for row in range(0, decoded.shape[0], rows) for column in range(0, decoded.shape[1], columns)
    ]
    for (row, column), offset, length in zip(corners, page.dataoffsets, page.databytecounts, strict=True):
        file.seek(offset)
        place = decoded[row : row + rows, column : column + columns]
        tile = np.empty((rows if page.is_tiled else place.shape[0], columns), page.dtype)
        place[:] = imagecodecs.jpegxl_decode(file.read(length), out=tile)[: place.shape[0], : place.shape[1]]
    return decoded


def _metadata(path: Path, raw: rawpy.RawPy, filters: np.ndarray) -> dict[str, Any]:
    """Provenance of a mosaic with these filters, (H, W) in LibRaw's numbers, but for its levels."""
    letters = raw.color_desc.decode()
    corner = filters[:2, :2]
    if corner.shape != (2, 2):
        raise ImageError(f"{path}: {filters.shape[1]} x {filters.shape[0]} pixels; a mosaic needs 2 x 2 at least")
    if raw.num_colors < 3 or corner.max() >= len(letters):
        raise ImageError(f"{path}: has {raw.num_colors} kind of filter; only Bayer patterns of R, G and B are read")
    pattern = "".join(letters[number] for number in corner.ravel())
    repeats = all(
        np.array_equal(there := filters[down : down + 2, right : right + 2], corner[: there.shape[0], : there.shape[1]])
        for down in (0, 2, 4)
        for right in (0, 2, 4)
    )
    if pattern not in BAYER or not repeats:
        raise ImageError(f"{path}: its filters are no Bayer pattern of 2 x 2 but {pattern}...; only those are read")
    gains = next(
        (
            balance
            for balance in (raw.camera_whitebalance, raw.daylight_whitebalance)
            if min(balance[:3]) > 0.0 and max(balance[:3]) < math.inf
        ),
        None,
    )
    if gains is None:
        raise ImageError(f"{path}: neither the file nor LibRaw says its white balance")
    neutral = 1.0 / np.array(gains[:3], dtype=np.float64)
    metadata: dict[str, Any] = {
        "cfa_pattern": pattern,
        "as_shot_neutral": [float(value) for value in neutral / neutral.max()],
        "raw_orientation": int(raw.sizes.flip),
    }
    matrix = np.array(raw.color_matrix, dtype=np.float64)[:, :3]
    if np.allclose(matrix.sum(axis=1), 1.0, atol=1e-3):
        metadata["camera_to_rec709"] = matrix.tolist()
    recorded = {
        "exposure_s": "shutter_speed",
        "iso": "iso_speed",
        "f_number": "aperture",
        "focal_length_mm": "focal_length",
    }
    metadata |= {
        name: float(value)
        for name, key in recorded.items()
        if (value := getattr(getattr(raw, "other", None), key, 0.0)) and 0.0 < value < math.inf
    }
    return metadata

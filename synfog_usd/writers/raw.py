"""RAW files of cameras: the sensor's numbers and what the file says of them, read by LibRaw.

Gives what `sensor.adc` gives, so that the second half of a graph serves real pictures
too.  rawpy is imported on first use.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.errors import ImageError
from synfog_usd.image import Image, Quantity

BAYER = ("RGGB", "GRBG", "GBRG", "BGGR")

NOISE_PROFILE_TAG = 51041
"""DNG's NoiseProfile: slope and offset of the variance, black 0 and white 1."""


def read_raw(path: Path) -> Image:
    """Read the mosaic of a RAW file: DNG, and whatever LibRaw opens.

    Args:
        path: the file.

    Returns:
        DN, one channel, not turned.  The provenance has `cfa_pattern`, `black_level_dn`, `white_level_dn`,
        `as_shot_neutral` (R, G, B), `camera_to_rec709` where the file or LibRaw's table of cameras has a matrix; and as
        far as the file says them `noise_profile`, `exposure_s`, `iso`, `f_number` and `focal_length_mm`.  Blacks that
        differ by filter are made one.

    Raises:
        ImageError: missing, no RAW file, or no Bayer mosaic of one number a pixel.
    """
    import rawpy

    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    try:
        with rawpy.imread(str(path)) as raw:
            if raw.raw_type is not rawpy.RawType.Flat or raw.raw_image_visible is None:
                raise ImageError(f"{path}: holds no mosaic of one number a pixel")
            metadata, offsets = _metadata(path, raw)
            pixels = raw.raw_image_visible.astype(np.float32) - offsets[raw.raw_colors_visible]
    except rawpy.LibRawError as error:
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else error
        raise ImageError(
            f"{path}: cannot be read as RAW ({reason}); an EXR, a DNG or another camera's RAW file is needed"
        ) from error
    return Image(pixels[..., None], ("CFA",), Quantity.DN, provenance=metadata | _noise(path))


def _metadata(path: Path, raw: Any) -> tuple[dict[str, Any], np.ndarray]:
    """Provenance, and by how much each filter's black lies above their mean [DN]."""
    letters = raw.color_desc.decode()
    corner = raw.raw_colors_visible[:2, :2]
    if raw.num_colors < 3 or corner.max() >= len(letters):
        raise ImageError(f"{path}: has {raw.num_colors} kind of filter; only Bayer patterns of R, G and B are read")
    pattern = "".join(letters[number] for number in corner.ravel())
    repeats = all(
        np.array_equal(raw.raw_colors_visible[down : down + 2, right : right + 2], corner)
        for down in (0, 2, 4)
        for right in (0, 2, 4)
    )
    if pattern not in BAYER or not repeats:
        raise ImageError(f"{path}: its filters are no Bayer pattern of 2 x 2 but {pattern}...; only those are read")
    blacks = np.array(raw.black_level_per_channel, dtype=np.float32)
    black = float(blacks[corner.ravel()].mean())
    gains = next(
        (found for found in (raw.camera_whitebalance, raw.daylight_whitebalance) if min(found[:3]) > 0.0), None
    )
    if gains is None:
        raise ImageError(f"{path}: neither the file nor LibRaw says its white balance")
    neutral = 1.0 / np.array(gains[:3], dtype=np.float64)
    metadata: dict[str, Any] = {
        "cfa_pattern": pattern,
        "black_level_dn": black,
        "white_level_dn": float(raw.white_level),
        "as_shot_neutral": [float(value) for value in neutral / neutral.max()],
        "raw_orientation": int(raw.sizes.flip),
    }
    matrix = np.array(raw.color_matrix, dtype=np.float64)[:, :3]
    if np.allclose(matrix.sum(axis=1), 1.0, atol=1e-3):
        metadata["camera_to_rec709"] = matrix.tolist()
    taken = {
        "exposure_s": "shutter_speed",
        "iso": "iso_speed",
        "f_number": "aperture",
        "focal_length_mm": "focal_length",
    }
    metadata |= {
        name: float(value)
        for name, key in taken.items()
        if (value := getattr(getattr(raw, "other", None), key, 0.0)) and value > 0.0
    }
    return metadata, blacks - black


def _noise(path: Path) -> dict[str, Any]:
    """The noise profile of a DNG's green, or nothing."""
    if path.suffix.lower() != ".dng":
        return {}
    import tifffile

    with tifffile.TiffFile(path) as file:
        pages = [page for first in file.pages for page in (first, *(first.pages or ()))]  # type: ignore[union-attr]
        profile = next((page.tags[NOISE_PROFILE_TAG].value for page in pages if NOISE_PROFILE_TAG in page.tags), ())
    return {"noise_profile": [float(value) for value in profile[2:4] or profile[:2]]} if len(profile) >= 2 else {}

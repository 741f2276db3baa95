"""Writers: images into files that other programs read.

`write_output` picks the format by the file's suffix and refuses what does not fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from synfog_usd.base.errors import OutputError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers.dng import write_dng
from synfog_usd.camera.writers.exr import channels_of, check_radiance, read_exr, write_exr
from synfog_usd.camera.writers.mipi import write_mipi
from synfog_usd.camera.writers.raw import read_raw
from synfog_usd.camera.writers.screen import write_jpeg, write_png

WRITERS: dict[str, Callable[..., None]] = {
    ".dng": write_dng,
    ".exr": write_exr,
    ".png": write_png,
    ".jpg": write_jpeg,
    ".raw10": write_mipi,
    ".raw12": write_mipi,
    ".raw14": write_mipi,
}
"""File suffix -> what writes it: f(path, image, *, options)."""


def write_output(name: str, image: Image, folder: Path, *, options: Mapping[str, Any] | None = None) -> Path:
    """Write one output of a graph.

    Args:
        name: plain file name; its suffix says the format.
        image: what the graph gave.
        folder: where to; made if need be.
        options: how, as the graph was checked for: {'compression': 'lossless'} for a DNG, {'bits': 16} for a PNG.

    Returns:
        The file's path.

    Raises:
        OutputError: no plain name, no such format, or it cannot be written.
        ImageError: the image does not fit the format.
    """
    if not name or name in (".", "..") or Path(name).name != name or "\\" in name:
        raise OutputError(f"output {name!r} is not a plain file name")
    suffix = Path(name).suffix.lower()
    if suffix not in WRITERS:
        raise OutputError(f"output {name!r}: format {suffix!r} is not known; it can be {', '.join(WRITERS)}")
    path = folder / name
    WRITERS[suffix](path, image, **(options or {}))
    return path


def read(path: Path, *, declared: Quantity | None = None, repair: bool = False) -> Image:
    """Read a picture: OpenEXR, or the mosaic of a RAW file.

    Args:
        path: the file.
        declared, repair: of an EXR, see `read_exr`.

    Raises:
        ImageError: missing, damaged, or none of both.
    """
    if path.suffix.lower() == ".exr":
        return read_exr(path, declared=declared, repair=repair)
    return read_raw(path)

"""Writers: images into files that other programs read.

`write_output` picks the format by the file's suffix and refuses what does not fit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from synfog_usd.errors import OutputError
from synfog_usd.image import Image
from synfog_usd.writers.dng import write_dng
from synfog_usd.writers.exr import check_radiance, read_exr, write_exr
from synfog_usd.writers.png import write_png

WRITERS: dict[str, Callable[[Path, Image], None]] = {".dng": write_dng, ".exr": write_exr, ".png": write_png}
"""File suffix -> what writes it."""


def write_output(name: str, image: Image, folder: Path) -> Path:
    """Write one output of a graph.

    Args:
        name: plain file name; its suffix says the format.
        image: what the graph gave.
        folder: where to; made if need be.

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
    WRITERS[suffix](path, image)
    return path


__all__ = ["WRITERS", "check_radiance", "read_exr", "write_dng", "write_exr", "write_output", "write_png"]

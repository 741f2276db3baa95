"""Black and white of a DNG's mosaic, pixel by pixel, from its tags.

Adobe, "Digital Negative (DNG) Specification" 1.7.1.0, chapter 5: numbers are looked up in the LinearizationTable, black
is taken off, and what is left is divided by white less the greatest black.  LibRaw looks up; of the rest it knows
whole numbers of one black for each filter, and it moves an ActiveArea to even places.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ImageError
from synfog_usd.camera.writers.tiff_tags import DNG_VERSION, Directory, directories

SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES = 254, 256, 257, 258, 259, 262, 277
REPEAT, BLACK, DELTA_H, DELTA_V, WHITE, ACTIVE_AREA, NOISE = 50713, 50714, 50715, 50716, 50717, 50829, 51041
SAMPLE_FORMAT, FLOATS = 339, 3
CFA = 32803
"""PhotometricInterpretation of a mosaic."""

MOST_NOISE = 1.0
"""Of the slope and offset of the variance, on a scale from black to white of 1."""

CODES = (
    *(SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES, SAMPLE_FORMAT, DNG_VERSION),
    *(REPEAT, BLACK, DELTA_H, DELTA_V, WHITE, ACTIVE_AREA, NOISE),
)


@dataclass(frozen=True)
class Levels:
    """What a DNG says of its mosaic's numbers.

    Attributes:
        active: first row, first column, row and column behind the last, of the pixels that see light.
        black: (h, w) of the active area, float32 [DN].
        white: [DN].
    """

    active: tuple[int, int, int, int]
    black: FloatArray
    white: float


def directories_of_dng(path: Path) -> list[Directory]:
    """Directories of a DNG, with the tags that this module reads; none of any other file."""
    result = directories(path, CODES)
    return result if any(DNG_VERSION in directory for directory in result) else []


def mosaics(all_directories: list[Directory]) -> list[Directory]:
    """Directories that hold a mosaic of one number a pixel, the main ones before smaller copies."""
    result = []
    for directory in all_directories:
        try:
            if directory.whole(PHOTOMETRIC, "kind of image") == CFA and directory.whole(SAMPLES, "samples", 1) == 1:
                result.append((directory.whole(SUBFILE, "NewSubfileType", 0) != 0, directory))
        except ImageError:  # an image that nobody can tell is none
            continue
    return [directory for _, directory in sorted(result, key=lambda one: one[0])]


def shape_of(mosaic: Directory) -> tuple[int, int]:
    """Rows and columns, those behind masks among them."""
    return mosaic.whole(HEIGHT, "ImageLength"), mosaic.whole(WIDTH, "ImageWidth")


def compression_of(mosaic: Directory) -> int:
    """TIFF's number of how the pixels are packed; 1 is not at all."""
    return mosaic.whole(COMPRESSION, "Compression", 1)


def of_floats(mosaic: Directory) -> bool:
    """Whether its numbers are floats."""
    return mosaic.whole(SAMPLE_FORMAT, "SampleFormat", 1) == FLOATS


def levels(mosaic: Directory) -> Levels:
    """Black and white of a mosaic, and where its pixels see light.

    Raises:
        ImageError: tags that contradict one another or cannot be read.
    """
    path, (height, width) = mosaic.path, shape_of(mosaic)
    active = (0, 0, height, width)
    if ACTIVE_AREA in mosaic:
        top, x0, bottom, right = (int(side) for side in mosaic.numbers(ACTIVE_AREA, "ActiveArea", 4))
        if not (0 <= top < bottom <= height and 0 <= x0 < right <= width):
            raise ImageError(
                f"{path}: its ActiveArea goes from row {top}, column {x0} to row {bottom}, column {right}; the image "
                f"has {height} rows and {width} columns. The file is damaged"
            )
        active = (top, x0, bottom, right)
    black = _black(mosaic, active[2] - active[0], active[3] - active[1])
    white = 2.0 ** mosaic.whole(BITS, "BitsPerSample") - 1.0
    if WHITE in mosaic:
        white = float(mosaic.numbers(WHITE, "WhiteLevel")[0])
    if not float(black.max()) < white:
        raise ImageError(f"{path}: its black goes up to {float(black.max()):g} and its WhiteLevel is {white:g}")
    return Levels(active, black, white)


def _black(mosaic: Directory, height: int, width: int) -> FloatArray:
    """(height, width) black of the active area: a pattern that repeats from its corner, and what rows and columns add.

    A single BlackLevel holds for the whole pattern.
    """
    rows, columns = (1, 1)
    if REPEAT in mosaic:
        rows, columns = (int(side) for side in mosaic.numbers(REPEAT, "BlackLevelRepeatDim", 2))
        if rows < 1 or columns < 1:
            raise ImageError(f"{mosaic.path}: its BlackLevelRepeatDim is {rows} x {columns}. The file is damaged")
    black = np.zeros((height, width), dtype=np.float32)
    if BLACK in mosaic:
        values = mosaic.numbers(BLACK, "BlackLevel")
        if values.size > 1:
            values = mosaic.numbers(BLACK, "BlackLevel", rows * columns)
            pattern = values.reshape(rows, columns)
            black += pattern[np.ix_(np.arange(height) % rows, np.arange(width) % columns)]
        else:
            black += values
    if DELTA_H in mosaic:
        black += mosaic.numbers(DELTA_H, "BlackLevelDeltaH", width)
    if DELTA_V in mosaic:
        black += mosaic.numbers(DELTA_V, "BlackLevelDeltaV", height)[:, None]
    return black


def noise_profile(all_directories: list[Directory]) -> dict[str, Any]:
    """The noise of a DNG's green, or nothing where the file does not say it or says what no noise can be."""
    directory = next((directory for directory in all_directories if NOISE in directory), None)
    if directory is None:
        return {}
    try:
        values = [float(value) for value in directory.numbers(NOISE, "NoiseProfile")]
    except ImageError:
        return {}
    green = values[2:4] if len(values) >= 4 else values[:2]
    return {"noise_profile": green} if len(green) == 2 and min(green) >= 0.0 and max(green) < MOST_NOISE else {}

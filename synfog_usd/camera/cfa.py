"""Colour filter arrays: which filter each pixel of a mosaic stands behind.

A pattern is a name; it repeats over the sensor from the top left pixel.  Filters are
letters: R, G, B; C lets all visible light through; I all but visible light.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, get_args

import numpy as np

from synfog_usd.base.arrays import Array, FloatArray

Pattern = Literal["RGGB", "GRBG", "GBRG", "BGGR", "RCCB", "RCCC", "RGIB", "MONO"]

PATTERNS: dict[str, tuple[str, ...]] = {name: (name[:2], name[2:]) for name in get_args(Pattern) if name != "MONO"} | {
    "MONO": ("C",)
}
"""Pattern -> its rows, a letter per pixel."""

BAYER = ("RGGB", "GRBG", "GBRG", "BGGR")
"""Patterns that any demosaicing takes."""

ORDER = "RGBCI"
"""Order of filters: that of the planes of a demosaiced picture."""


def filters(pattern: str) -> tuple[str, ...]:
    """The filters of a pattern, each once.

    >>> filters("GRBG"), filters("RCCB"), filters("RGIB"), filters("MONO")
    (('R', 'G', 'B'), ('R', 'B', 'C'), ('R', 'G', 'B', 'I'), ('C',))
    """
    return tuple(letter for letter in ORDER if any(letter in row for row in PATTERNS[pattern]))


def sites(pattern: str) -> Iterator[tuple[tuple[slice, slice], int]]:
    """The pixels of a mosaic, a grid at a time: where they are, and the number of their filter in `filters`.

    >>> mosaic = np.zeros((4, 6))
    >>> for where, number in sites("RGGB"):
    ...     mosaic[where] = number
    >>> mosaic[:2, :2].tolist()
    [[0.0, 1.0], [1.0, 2.0]]
    """
    rows, letters = PATTERNS[pattern], filters(pattern)
    for row, line in enumerate(rows):
        for column, letter in enumerate(line):
            yield (slice(row, None, len(rows)), slice(column, None, len(line))), letters.index(letter)


def factors(pattern: str, values: Sequence[float] | Array, height: int, width: int) -> FloatArray:
    """(H, W) the value of each pixel's filter, from a row on with which the pattern begins.

    >>> factors("RGGB", (1.0, 2.0, 3.0), 2, 3).tolist()
    [[1.0, 2.0, 1.0], [2.0, 3.0, 2.0]]
    """
    by_filter = dict(zip(filters(pattern), values, strict=True))
    cell = np.array([[by_filter[letter] for letter in row] for row in PATTERNS[pattern]], dtype=np.float32)
    down, across = (np.arange(size) % period for size, period in zip((height, width), cell.shape, strict=True))
    return cell[down[:, None], across]

"""Masks as text: COCO's compressed run lengths, which pycocotools and most viewers read.

Runs of 0 and 1 go down the columns, 0 first; a run is written as its difference to the one before the last, in
groups of five bits.  Source: Lin et al., Microsoft COCO (2014), and its published mask interface.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Flags, Indices

_DIGITS = 8
"""Groups of five bits that a run can need: 40 bits."""


def encode(pixels: Indices, height: int, width: int) -> str:
    """The text of a mask.

    Args:
        pixels: (N,) numbers of its pixels, row by row from the top left, each once.
        height, width: of the picture [px].

    >>> encode(np.array([0, 1, 3]), 2, 2)  # 1 1 above 0 1: the runs down the columns begin with one of no length
    '0111'
    """
    y, x = np.divmod(np.asarray(pixels, dtype=np.int64), width)
    order = np.sort(x * height + y)
    breaks = np.flatnonzero(np.diff(order) > 1)
    if order.size:
        begins = np.concatenate([order[:1], order[breaks + 1]])
        ends = np.concatenate([order[breaks], order[-1:]]) + 1
        edges = np.concatenate([[0], np.stack([begins, ends], axis=1).ravel(), [height * width]])
        runs = np.diff(edges)
        runs = runs[:-1] if runs[-1] == 0 else runs
    else:
        runs = np.array([height * width])
    rest = runs.copy()
    rest[3:] -= runs[1:-2]
    text = np.zeros((len(runs), _DIGITS), dtype=np.uint8)
    going = np.ones(len(runs), dtype=bool)
    for digit in range(_DIGITS):
        low = rest & 31
        rest = rest >> 5
        more = np.where(low & 16, rest != -1, rest != 0)
        text[:, digit] = np.where(going, low + 32 * more + 48, 0)
        going &= more
    return text[text > 0].tobytes().decode("ascii")


def decode(text: str, height: int, width: int) -> Flags:
    """The (H, W) mask of a text.

    Raises:
        ValueError: runs that do not add up to the picture.
    """
    runs: list[int] = []
    value, shift = 0, 0
    for letter in text.encode("ascii"):
        bits = letter - 48
        value |= (bits & 31) << shift
        shift += 5
        if bits & 32:
            continue
        if bits & 16:
            value -= 1 << shift
        runs.append(value + (runs[-2] if len(runs) > 2 else 0))
        value, shift = 0, 0
    if min(runs, default=0) < 0 or sum(runs) != height * width or shift:
        raise ValueError(f"the runs of a mask make {sum(runs)} pixels, not {height} x {width}")
    inside: npt.NDArray[np.bool_] = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    return inside.reshape(width, height).T

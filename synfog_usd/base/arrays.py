"""Names of the array types that pass between functions, and how a picture is gone through."""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
FloatArray = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
Pixels = npt.NDArray[Any]


STRIP_ROWS = 32
"""As many rows as a chain of steps is done for at a time."""


def strips(height: int, rows: int = STRIP_ROWS) -> Iterator[slice]:
    """Few rows of a picture at a time, which the processor's cache holds through a chain of steps."""
    return (slice(top, top + rows) for top in range(0, height, rows))


def planar(shape: tuple[int, ...]) -> FloatArray:
    """A new picture (H, W, C), not yet filled, whose channels lie one behind the other in memory: numpy is slow where
    the innermost axis is short.
    """
    height, width, count = shape
    return np.moveaxis(np.empty((count, height, width), dtype=np.float32), 0, 2)


def at_least(values: FloatArray, least: float | np.float32, out: FloatArray | None = None) -> FloatArray:
    """`np.maximum` of values and one number in half its time: numpy has vector code for clipping, and for the larger of
    two arrays.
    """
    return np.clip(values, np.float32(least), np.float32(np.inf), out=out)


def at_most(values: FloatArray, most: float | np.float32, out: FloatArray | None = None) -> FloatArray:
    """`np.minimum` of values and one number, as `at_least`."""
    return np.clip(values, np.float32(-np.inf), np.float32(most), out=out)


def total(arrays: Iterable[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """Sum of one or more arrays, element by element, in their order."""
    return functools.reduce(operator.add, arrays)


def extent(*clouds: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """(C,) least and largest of points (N, C) of one or more clouds, by each coordinate; a twentieth of the time of
    `min(axis=0)`, since numpy is slow where the innermost axis is short.
    """
    columns = [np.ascontiguousarray(points.T) for points in clouds]
    return np.min([column.min(axis=1) for column in columns], axis=0), np.max(
        [column.max(axis=1) for column in columns], axis=0
    )


def distinct(numbers: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(M,) the distinct ones, ascending, as `np.unique` gives them; since numpy 2.3 that has a hash table, and takes 90
    times as long for millions.
    """
    ordered = np.sort(numbers, axis=None)
    return ordered[np.concatenate([np.ones(min(ordered.size, 1), dtype=bool), ordered[1:] != ordered[:-1]])]

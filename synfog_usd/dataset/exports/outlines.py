"""Regions of a picture as polygons that paint it again.

Regions hang together by the sides of their pixels.  Each polygon goes round one of them through the middles of its
outermost pixels, holes included; painted from the largest to the smallest, what lies in holes comes on top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

STEPS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])
"""Rows and columns of a step to the right, down, left and up: the order of a walk around a pixel."""


@dataclass(frozen=True)
class RegionOutline:
    """A region's.

    Attributes:
        value: of its pixels.
        points: (N, 2) column and row of corners [px], 0 the middle of the first pixel.
        area: pixels within, those in holes too.
    """

    value: int
    points: npt.NDArray[np.int64]
    area: int


def outlines(values: npt.NDArray[np.int64]) -> list[RegionOutline]:
    """Those of all regions of equal values in a picture (H, W), the largest first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    height, width = values.shape
    number = np.arange(height * width).reshape(height, width)
    pairs = [(number[:, :-1][right], number[:, 1:][right]) for right in [values[:, :-1] == values[:, 1:]]] + [
        (number[:-1][down], number[1:][down]) for down in [values[:-1] == values[1:]]
    ]
    starts, ends_of = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    graph = coo_array((np.ones(len(starts), dtype=np.int8), (starts, ends_of)), shape=(number.size, number.size))
    _, region = connected_components(graph, directed=False)
    onward = _walk(region.reshape(height, width)).tolist()
    rings = []
    for first in np.unique(region, return_index=True)[1].tolist():  # its upper side is part of the outer edge
        path, state = [first], onward[first]
        while state != first:
            path.append(state)
            state = onward[state]
        row, column = np.divmod(np.array(path) % number.size, width)
        way = np.array(path) // number.size
        # of the corner at which each side begins: the sum over steps to the right and left is the area within
        area = int(np.sum(np.where(way == 2, row + 1, 0)) - np.sum(np.where(way == 0, row, 0)))
        rings.append(RegionOutline(int(values.flat[first]), _corners(column, row), area))
    return sorted(rings, key=lambda outline: -outline.area)


def _walk(region: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """(4 H W,) of each side of a pixel that is an edge of its region the next side, with the region on the right hand.

    A side is its pixel's number plus H W times the way that it is walked: to the right along the upper one, down along
    the right one, and so on.
    """
    height, width = region.shape
    around = np.full((height + 2, width + 2), -1, dtype=np.int64)
    around[1:-1, 1:-1] = region

    def there(step: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Whether the pixel a step away is of the same region."""
        return around[1 + step[0] : 1 + step[0] + height, 1 + step[1] : 1 + step[1] + width] == region

    number = np.arange(height * width).reshape(height, width)
    onward = np.zeros((4, height, width), dtype=np.int64)
    for way, ahead in enumerate(STEPS):
        turn_left = STEPS[way - 1]
        straight = number + ahead[0] * width + ahead[1] + way * number.size
        turned = number + (ahead + turn_left)[0] * width + (ahead + turn_left)[1] + (way - 1) % 4 * number.size
        here = number + (way + 1) % 4 * number.size
        onward[way] = np.where(there(ahead), np.where(there(ahead + turn_left), turned, straight), here)
    return onward.ravel()


def _corners(column: npt.NDArray[np.int64], row: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """(N, 2) a closed walk over pixels without those that it passes straight."""
    points = np.stack([column, row], axis=1)
    points = points[np.any(points != np.roll(points, 1, axis=0), axis=1)] if len(points) > 1 else points
    if len(points) < 3:
        return points if len(points) else np.stack([column, row], axis=1)[:1]
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    return points[np.any(before != after, axis=1)]

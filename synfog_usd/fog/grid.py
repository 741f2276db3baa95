"""Fog that varies from place to place: relative densities on a grid.

Takes an array; gives the mean along straight segments.  Knows nothing of metres,
files or Mitsuba.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError

MAX_VOXELS = 1 << 26
"""400^3, or 256 MiB."""

GAUSS = 0.5 - 0.5 / 3.0**0.5
"""First of two places on a stretch, as a share of it, whose mean is that of a cubic; the other is its mirror image."""

_AT_ONCE = 1 << 22


@dataclass(frozen=True, eq=False)
class DensityGrid:
    """Relative densities in the box [-1, 1]^3, linear between the voxels' centres.

    Attributes:
        values: (Z, Y, X) float32 [1], 0 to 1, of the voxels; in the outer half of
            an outer voxel its value goes on.  Copied, and not to be written.
        period_m: edge [m] of a cube along the world's axes that repeats for ever; None for a grid that fills its
            volume's box.  Its densities may be above 1, and each axis has a power of 2 of voxels.

    Two of them are the same only where they are one object.
    """

    values: npt.NDArray[np.float32]
    period_m: float | None = None

    def __post_init__(self) -> None:
        densities = np.asarray(self.values)
        if densities.ndim != 3 or densities.dtype.kind not in "fiu" or not 0 < densities.size <= MAX_VOXELS:
            raise ParameterError(
                f"a density grid of shape {densities.shape} and type {densities.dtype}; it has three axes (Z, Y, X), "
                f"real numbers, 1 to {MAX_VOXELS} voxels"
            )
        wrong = ~((densities >= 0.0) & (densities <= (1.0 if self.period_m is None else np.inf)))
        if wrong.any():
            place = tuple(int(index) for index in np.argwhere(wrong)[0])
            raise ParameterError(
                f"a density grid with {densities[place]!s} at {place}, the first of {np.count_nonzero(wrong)} values "
                f"outside 0 to 1; "
                f"divide by the largest and multiply the extinction by it"
            )
        values = densities.astype(np.float32)
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    def mean(self, begin: Array, end: Array) -> Array:
        """Mean density (N,) [1] along segments between (N, 3) points (x, y, z) of the box.

        A segment is cut wherever it crosses a plane of voxel centres.  Each piece is
        a cubic, whose integral two Gauss points give exactly: rounding is all that
        is lost.
        """
        counts = np.array(self.values.shape[::-1], dtype=np.float64)
        begin, end = ((points + 1.0) / 2.0 * counts - 0.5 for points in (begin, end))  # centres are whole numbers
        planes = counts.max() if self.period_m is None else np.abs(end - begin).max(initial=0.0)
        step = max(1, _AT_ONCE // (3 * int(planes) + 8))
        return np.concatenate(
            [
                np.zeros(0),
                *[self._mean(begin[at : at + step], end[at : at + step]) for at in range(0, len(begin), step)],
            ]
        )

    def _mean(self, begin: Array, end: Array) -> Array:
        along = end - begin
        cuts = [np.zeros((len(begin), 1)), np.ones((len(begin), 1))]
        for axis, count in enumerate(self.values.shape[::-1]):
            run = along[:, axis, None]
            planes = np.arange(count) - begin[:, axis, None]
            if self.period_m is not None:
                low = np.floor(np.minimum(begin[:, axis], end[:, axis]))[:, None]
                planes = low + np.arange(int(np.abs(run).max()) + 2) - begin[:, axis, None]
            cuts.append(np.clip(np.divide(planes, run, out=np.zeros_like(planes), where=run != 0.0), 0.0, 1.0))
        ends = np.sort(np.hstack(cuts), axis=1)
        widths = np.diff(ends, axis=1)
        ray, piece = np.nonzero(widths)
        width, start = widths[ray, piece], ends[ray, piece]
        total, mode = np.zeros(len(ray)), "nearest" if self.period_m is None else "grid-wrap"
        for share in (GAUSS, 1.0 - GAUSS):
            points = begin[ray] + (start + share * width)[:, None] * along[ray]
            total += ndimage.map_coordinates(self.values, points.T[::-1], output=np.float64, order=1, mode=mode)
        return np.asarray(np.bincount(ray, weights=0.5 * width * total, minlength=len(begin)), dtype=np.float64)

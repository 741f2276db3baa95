"""Fog in patches: a seeded field of densities with a stated spectrum.

Takes an outer scale, a deviation and a seed; gives a `DensityGrid` that repeats.  Knows nothing of USD or Mitsuba.
"""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from synfog_usd.base.errors import ParameterError
from synfog_usd.fog.grid import DensityGrid

VOXELS = 128
"""Along each edge of the cube that repeats, a power of 2."""

VOXELS_PER_SCALE = 8
"""The finest waves are a quarter of the outer scale long, and the cube is 16 outer scales wide."""

SCALES_M = 0.5, 1000.0
"""Outer scales [m]."""

MOST_DEVIATION = 2.0
"""Standard deviation over mean; cumulus edges have about 1."""


@functools.lru_cache(maxsize=4)
def patchy(outer_scale_m: float, deviation: float, *, seed: int = 0) -> DensityGrid:
    """Densities of turbulent fog, whose mean is exactly 1.

    The spectrum of the density is von Karman's: Kolmogorov's k^(-11/3) below the outer scale, level above it.  It
    is cut off at waves of a quarter of the outer scale.  The densities are lognormal, so
    that none is negative.

    Args:
        outer_scale_m: L0 [m], 0.5 to 1000: the largest patches are about half as wide.
        deviation: standard deviation of the density over its mean, 0 to 2, exact to 0.1 %.
        seed: 0 or more; another one gives another field.

    Raises:
        ParameterError: a value outside these ranges.

    Source: von Karman (1948); Tatarskii (1971), section 16; Coles and Jones (1991) for lognormal fields.
    """
    if not SCALES_M[0] <= outer_scale_m <= SCALES_M[1]:
        raise ParameterError(f"an outer scale of {outer_scale_m:g} m is outside {SCALES_M[0]:g} to {SCALES_M[1]:g}")
    if not 0.0 <= deviation <= MOST_DEVIATION:
        raise ParameterError(f"a relative deviation of {deviation:g} is outside 0 to {MOST_DEVIATION:g}")
    if seed < 0:
        raise ParameterError(f"a seed of {seed} is below 0")
    return DensityGrid(_field(deviation, seed), period_m=outer_scale_m * VOXELS / VOXELS_PER_SCALE)


@functools.lru_cache(maxsize=4)
def _field(deviation: float, seed: int) -> npt.NDArray[np.float32]:
    """(VOXELS,) * 3 densities; waves are counted in voxels."""
    white = np.random.default_rng(seed).standard_normal((VOXELS,) * 3)
    k = 2.0 * np.pi * np.fft.fftfreq(VOXELS)
    k2 = k[:, None, None] ** 2 + k[:, None] ** 2 + (2.0 * np.pi * np.fft.rfftfreq(VOXELS)) ** 2
    spectrum = (k2 + (2.0 * np.pi / VOXELS_PER_SCALE) ** 2) ** (-11.0 / 6.0)
    spectrum[0, 0, 0] = 0.0
    covariance = np.fft.irfftn(spectrum)
    # of the logarithm: exp of it then has the covariance above
    logarithm = np.log1p(covariance * deviation**2 / covariance[0, 0, 0])
    filtered = np.sqrt(np.maximum(np.fft.rfftn(logarithm).real, 0.0))
    filtered[0, 0, 0] = 0.0
    waves = np.fft.irfftn(np.fft.rfftn(white) * filtered)
    for _ in range(4 if deviation > 0.0 else 0):  # a finite field has not quite the deviation of an endless one
        density = np.exp(waves)
        waves *= np.sqrt(np.log1p(deviation**2) / np.log1p((density.std() / density.mean()) ** 2))
    density = np.exp(waves)
    return np.asarray(density / density.mean(), dtype=np.float32)

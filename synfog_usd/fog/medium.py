"""Fog as a participating medium: how strongly, and where to, it scatters light.

Takes a visibility or an extinction; gives sigma_t(height), albedo and phase, and
the optical depth along rays in closed form.  What varies sideways too is a
`DensityGrid`.  Knows nothing of USD, Mitsuba or files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.fog.drops import Sizes
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.fog.phase import HenyeyGreenstein, Phase

Profile = Literal["uniform", "exponential", "grid"]

WMO_CONTRAST = 0.05
"""Contrast threshold of the meteorological optical range, WMO-No. 8, vol. I, ch. 9."""

MAX_EXTINCTION_PER_M = 100.0
"""MOR of 3 cm; denser than any cloud, and a sign of wrong units."""

REFERENCE_NM = 550.0
"""Wavelength [nm] at which extinctions and visibilities are stated."""

ANGSTROM = (-1.0, 5.0)
"""Range of Angstrom exponents [1]: about 0 for fog, 4.1 for air itself."""


def extinction_from_visibility(visibility_m: npt.ArrayLike, *, contrast: float = WMO_CONTRAST) -> Array:
    """Extinction coefficient of fog seen through to a given visibility.

    Koschmieder's law: a black target at distance V keeps `contrast` of its
    contrast against the horizon, so exp(-sigma_t * V) = contrast.

    Args:
        visibility_m: meteorological optical range V [m], > 0, any shape.
        contrast: threshold [1], 0 < contrast < 1.  0.05 is the WMO's; the
            classical 0.02 gives a sigma_t 31 % larger.

    Returns:
        sigma_t at 550 nm [1/m], float64, shape of `visibility_m`.

    Raises:
        ParameterError: a value outside the ranges above.

    Valid for a uniform medium under a uniform sky; not for lamps at night.
    Source: Koschmieder (1924); threshold: WMO-No. 8, vol. I, ch. 9.

    >>> round(float(extinction_from_visibility(100.0)), 5)
    0.02996
    """
    visibility = np.asarray(visibility_m, dtype=np.float64)
    if not 0.0 < contrast < 1.0:
        raise ParameterError(f"contrast {contrast} is outside (0, 1); the WMO's is 0.05")
    if not np.all(visibility > 0.0):
        raise ParameterError(f"visibility {visibility_m!r} m is not above 0")
    return np.asarray(-np.log(contrast) / visibility)


@dataclass(frozen=True)
class Colours:
    """How a medium depends on wavelength; straight lines between the rows.

    Attributes:
        wavelengths_nm: (N,) [nm], ascending.
        extinction: (N,) over that at 550 nm [1].
        albedo: (N,) single-scattering albedo [1], 0 to 1.
    """

    wavelengths_nm: tuple[float, ...]
    extinction: tuple[float, ...]
    albedo: tuple[float, ...]

    def extinction_at(self, wavelength_nm: npt.ArrayLike) -> Array:
        """Extinction at wavelengths [nm], any shape, over that at 550 nm [1]."""
        return np.asarray(np.interp(np.asarray(wavelength_nm, np.float64), self.wavelengths_nm, self.extinction))

    def albedo_at(self, wavelength_nm: npt.ArrayLike) -> Array:
        """Albedo [1] at wavelengths [nm], any shape."""
        return np.asarray(np.interp(np.asarray(wavelength_nm, np.float64), self.wavelengths_nm, self.albedo))


@dataclass(frozen=True)
class FogMedium:
    """One kind of fog.

    Attributes:
        sigma_t_per_m: extinction [1/m] at 550 nm, >= 0: at `base_height_m`, or where a grid's density is 1.
        albedo: single-scattering albedo at 550 nm, 0 to 1; fog absorbs next to nothing.
        g: mean cosine of the phase function, -1 < g < 1.  Where `phase` is given
            it is taken from there, whatever is passed.
        profile: 'uniform', 'exponential' in height above `base_height_m`, or 'grid'.
        base_height_m: height [m] at which `sigma_t_per_m` holds.
        scale_height_m: height [m] over which an exponential fog thins by e, > 0.
        phase: phase function; None for Henyey-Greenstein's with `g`.
        angstrom: exponent [1] of the extinction over wavelength, -1 to 5; fog is grey, 0.
        grid: relative densities in the boundary's box; with profile 'grid' and only then.
        contrast: threshold [1] at which its visibility is stated.
        colours: extinction and albedo by wavelength, instead of `angstrom`; None for what is grey.
        falls: kind and sizes of the rain and snow in it, where its density is 1.
    """

    sigma_t_per_m: float
    albedo: float = 1.0
    g: float = 0.87
    profile: Profile = "uniform"
    base_height_m: float = 0.0
    scale_height_m: float = 50.0
    phase: Phase | None = None
    angstrom: float = 0.0
    grid: DensityGrid | None = None
    contrast: float = WMO_CONTRAST
    colours: Colours | None = None
    falls: tuple[tuple[str, Sizes], ...] = ()

    def __post_init__(self) -> None:
        if self.phase is not None:
            object.__setattr__(self, "g", self.phase.mean_cosine)
        if not 0.0 <= self.sigma_t_per_m <= MAX_EXTINCTION_PER_M:
            raise ParameterError(f"sigma_t {self.sigma_t_per_m} 1/m is outside 0 to {MAX_EXTINCTION_PER_M:g}")
        if not 0.0 <= self.albedo <= 1.0:
            raise ParameterError(f"albedo {self.albedo} is outside 0 to 1")
        if not 0.0 < self.contrast < 1.0:
            raise ParameterError(f"contrast {self.contrast} is outside (0, 1); the WMO's is 0.05")
        if not -1.0 < self.g < 1.0:
            raise ParameterError(f"g {self.g} is outside (-1, 1)")
        if self.profile not in ("uniform", "exponential", "grid"):
            raise ParameterError(f"profile {self.profile!r} is not known; it takes 'uniform', 'exponential' or 'grid'")
        if not (self.scale_height_m > 0.0 and math.isfinite(self.scale_height_m)):
            raise ParameterError(f"scale height {self.scale_height_m} m is not above 0")
        if not math.isfinite(self.base_height_m):
            raise ParameterError(f"base height {self.base_height_m} m is not finite")
        if not ANGSTROM[0] <= self.angstrom <= ANGSTROM[1]:
            raise ParameterError(f"Angstrom exponent {self.angstrom} is outside {ANGSTROM[0]:g} to {ANGSTROM[1]:g}")
        if (self.grid is not None) != (self.profile == "grid"):
            raise ParameterError(
                f"profile {self.profile!r} {'with' if self.grid is not None else 'without'} a density grid; 'grid' "
                f"needs one, and no other takes one"
            )

    @classmethod
    def from_visibility(
        cls, visibility_m: float, *, contrast: float = WMO_CONTRAST, albedo: float = 1.0, g: float = 0.87
    ) -> FogMedium:
        """Uniform fog of a stated meteorological optical range [m]."""
        return cls(
            float(extinction_from_visibility(visibility_m, contrast=contrast)), albedo=albedo, g=g, contrast=contrast
        )

    @property
    def visibility_m(self) -> float:
        """Visibility [m] at the base height, at its own contrast threshold: the meteorological optical range at the
        WMO's 0.05.
        """
        return -math.log(self.contrast) / self.sigma_t_per_m if self.sigma_t_per_m > 0 else math.inf

    @property
    def mean_sigma_t_per_m(self) -> float:
        """Extinction [1/m] at the base height, or a grid's mean."""
        return self.sigma_t_per_m * (1.0 if self.grid is None else float(self.grid.values.mean(dtype=np.float64)))

    @property
    def phase_function(self) -> Phase:
        """The phase function, Henyey-Greenstein's where no other was given."""
        return self.phase if self.phase is not None else HenyeyGreenstein(self.g)

    def extinction_at(self, wavelength_nm: npt.ArrayLike) -> Array:
        """Extinction at wavelengths [nm], any shape, over that at 550 nm [1]: (lambda / 550)^-angstrom or `colours`."""
        wavelength = np.asarray(wavelength_nm, dtype=np.float64)
        if not np.all(wavelength > 0.0):
            raise ParameterError(f"wavelength {wavelength_nm!r} nm is not above 0")
        if self.colours is not None:
            return self.colours.extinction_at(wavelength)
        return np.asarray((wavelength / REFERENCE_NM) ** -self.angstrom)

    def albedo_at(self, wavelength_nm: npt.ArrayLike) -> Array:
        """Albedo [1] at wavelengths [nm], any shape."""
        wavelength = np.asarray(wavelength_nm, dtype=np.float64)
        return np.full(wavelength.shape, self.albedo) if self.colours is None else self.colours.albedo_at(wavelength)

    def sigma_t(self, height_m: npt.ArrayLike) -> Array:
        """Extinction [1/m] at heights [m]; constant below the base height.

        Raises:
            ParameterError: a grid, which is no function of height.
        """
        self._must_depend_on_height_alone()
        height = np.asarray(height_m, dtype=np.float64)
        if self.profile == "uniform":
            return np.full(height.shape, self.sigma_t_per_m)
        return self.sigma_t_per_m * np.exp(-np.maximum(height - self.base_height_m, 0.0) / self.scale_height_m)

    def optical_depth(
        self, start_height_m: npt.ArrayLike, end_height_m: npt.ArrayLike, length_m: npt.ArrayLike
    ) -> Array:
        """Optical depth [1] of straight segments.

        Args:
            start_height_m, end_height_m: heights [m] of both ends, any shape.
            length_m: lengths [m], >= 0, the same shape.

        Returns:
            Integral of sigma_t along each segment, in closed form.

        Raises:
            ParameterError: a grid, which is no function of height; `FogVolume.optical_depth` takes any.
        """
        self._must_depend_on_height_alone()
        length = np.asarray(length_m, dtype=np.float64)
        if self.profile == "uniform":
            return self.sigma_t_per_m * length
        h0 = np.asarray(start_height_m, dtype=np.float64) - self.base_height_m
        h1 = np.asarray(end_height_m, dtype=np.float64) - self.base_height_m
        climb = h1 - h0
        steep = np.abs(climb) > 1e-9 * self.scale_height_m
        mean = np.where(
            steep,
            (_density_integral(h1, self.scale_height_m) - _density_integral(h0, self.scale_height_m))
            / np.where(steep, climb, 1.0),
            np.exp(-np.maximum(h0, 0.0) / self.scale_height_m),
        )
        return self.sigma_t_per_m * length * mean

    def _must_depend_on_height_alone(self) -> None:
        if self.grid is not None:
            raise ParameterError(
                "the density of a grid is no function of height alone; ask the FogVolume, which knows where the grid "
                "lies"
            )


def _density_integral(height: Array, scale: float) -> Array:
    """Integral from 0 to `height` of exp(-max(h, 0)/scale): -expm1 above 0, linear below."""
    return np.where(height > 0.0, -scale * np.expm1(-np.maximum(height, 0.0) / scale), height)

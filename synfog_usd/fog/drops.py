"""Sizes of what floats and falls in air: how many by diameter, how fast they fall, how much light they stop.

Takes a rate of rain or snow, or the numbers of a published distribution; gives number densities, moments in closed
form, terminal speeds and extinctions.  Diameters are millimetres, densities 1/m^3 or 1/(m^3 mm).  Knows nothing of
wavelengths.

>>> round(float(rain_sizes(10.0).density(1.0)), 1), round(float(rain_speed(1.0)), 2)
(638.5, 4.0)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import gamma

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.base.numbers import RATES_MM_H

HEAVIEST_MM_H = {"rain": 100.0, "snow": 10.0}
"""Rates [mm/h] up to which the distributions were measured: Marshall and Palmer's, and Sekhon and Srivastava's."""

BEAM, PICTURE = 2.0, 1.0
"""Extinction of what is much larger than the wavelength, over its cross section.

A narrow beam loses 2: one is hit, one is bent round the edge by diffraction (van de Hulst 1957, 8.22).  A picture loses
1: a drop of 1 mm bends light by 0.03 degrees, which is within a pixel."""

FLAKE_DENSITY = 0.17
"""Density [g/cm^3] of a dry flake of 1 mm; it falls as 1/D.  Holroyd (1971), in Rasmussen et al., J. Appl. Meteor. 38,
1542 (1999)."""

_FORMULA_FROM_MM = 0.6
_SLOW_MM = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, _FORMULA_FROM_MM)
_SLOW_M_S = (0.0, 0.07, 0.27, 0.72, 1.17, 1.62, 2.06, 2.464)
"""Terminal speeds below the formula's range: Gunn and Kinzer's table from 0.1 mm, and Stokes' square below."""


@dataclass(frozen=True)
class GammaSizes:
    """Modified gamma distribution (Deirmendjian 1969): N(D) = scale D^shape exp(-slope D^power).

    An exponential distribution has shape 0 and power 1.

    Attributes:
        scale: N0 [1/(m^3 mm) mm^-shape], > 0.
        shape: [1], > -1, or the number has no end.
        slope: [mm^-power], > 0.
        power: [1], > 0.

    Raises:
        ParameterError: a value outside these ranges, whose integral does not exist.
    """

    scale: float
    shape: float
    slope: float
    power: float = 1.0

    def __post_init__(self) -> None:
        values = (self.scale, self.shape + 1.0, self.slope, self.power)
        if not all(math.isfinite(value) and value > 0.0 for value in values):
            raise ParameterError(f"{self}: has no finite integral; scale, slope and power are above 0, shape above -1")

    @classmethod
    def of_radii(cls, number_per_cm3: float, alpha: float, power: float, mode_um: float) -> GammaSizes:
        """The same in the words of fog and haze: n(r) ~ r^alpha exp(-(alpha / power) (r / mode)^power).

        Args:
            number_per_cm3: particles [1/cm^3].
            alpha, power: [1].
            mode_um: radius [um] of which there are most.
        """
        mode_mm = 2e-3 * mode_um
        if not (alpha > 0.0 and power > 0.0 and mode_mm > 0.0):
            raise ParameterError(f"alpha {alpha:g}, power {power:g}, mode {mode_um:g} um: all are above 0")
        shape = cls(1.0, alpha, alpha / power / mode_mm**power, power)
        return cls(1e6 * number_per_cm3 / shape.moment(0.0), alpha, shape.slope, power)

    def density(self, diameter_mm: npt.ArrayLike) -> Array:
        """N(D) [1/(m^3 mm)] at diameters [mm], >= 0, any shape."""
        D = np.asarray(diameter_mm, dtype=np.float64)
        return np.asarray(self.scale * D**self.shape * np.exp(-self.slope * D**self.power))

    def moment(self, order: float) -> float:
        """Integral of D^order N(D) over all diameters [mm^order / m^3]; of order 0 the number."""
        k = (order + self.shape + 1.0) / self.power
        return float(self.scale / self.power * self.slope**-k * gamma(k))


@dataclass(frozen=True)
class LogNormalSizes:
    """Log-normal distribution of a number of particles.

    Attributes:
        number_per_m3: > 0.
        median_mm: median diameter [mm], > 0.
        spread: geometric standard deviation [1], > 1.

    Raises:
        ParameterError: a value outside these ranges.
    """

    number_per_m3: float
    median_mm: float
    spread: float

    def __post_init__(self) -> None:
        values = (self.number_per_m3, self.median_mm, self.spread - 1.0)
        if not all(math.isfinite(value) and value > 0.0 for value in values):
            raise ParameterError(f"{self}: has no finite integral; number and median are above 0, spread above 1")

    def density(self, diameter_mm: npt.ArrayLike) -> Array:
        """N(D) [1/(m^3 mm)] at diameters [mm], > 0, any shape."""
        D, width = np.asarray(diameter_mm, dtype=np.float64), math.log(self.spread)
        steps = np.log(D / self.median_mm) / width
        return np.asarray(self.number_per_m3 * np.exp(-(steps**2) / 2.0) / (math.sqrt(2.0 * math.pi) * width * D))

    def moment(self, order: float) -> float:
        """Integral of D^order N(D) over all diameters [mm^order / m^3]; of order 0 the number."""
        width = math.log(self.spread)
        return self.number_per_m3 * self.median_mm**order * math.exp((order * width) ** 2 / 2.0)


Sizes = GammaSizes | LogNormalSizes


def rain_sizes(rate_mm_h: float) -> GammaSizes:
    """Drops of rain by diameter: Marshall and Palmer, J. Meteor. 5, 165 (1948).

    At 1 to 30 mm/h its drops carry up to 19 % more water than the rate, by `rain_speed`: too many are below 1 mm.
    """
    return GammaSizes(8000.0, 0.0, 4.1 * _checked("rain", rate_mm_h) ** -0.21)


def snow_sizes(rate_mm_h: float) -> GammaSizes:
    """Flakes of snow by the drop that each melts to: Sekhon and Srivastava, J. Atmos. Sci. 27, 299 (1970).

    Args:
        rate_mm_h: of water.
    """
    rate = _checked("snow", rate_mm_h)
    return GammaSizes(2500.0 * rate**-0.94, 0.0, 2.29 * rate**-0.45)


def gunn_marshall_sizes(rate_mm_h: float) -> GammaSizes:
    """The same of Gunn and Marshall, J. Meteor. 15, 452 (1958)."""
    rate = _checked("snow", rate_mm_h)
    return GammaSizes(3800.0 * rate**-0.87, 0.0, 2.55 * rate**-0.48)


RATED_SIZES: Mapping[str, tuple[str, Callable[[float], GammaSizes]]] = {
    "marshall-palmer": ("rain", rain_sizes),
    "sekhon-srivastava": ("snow", snow_sizes),
    "gunn-marshall": ("snow", gunn_marshall_sizes),
}
"""Name -> the kind that it is of, and its sizes at a rate [mm/h]; of a kind the first is usual."""

DROPLETS: Mapping[str, tuple[float, float, float, float]] = {
    "heavy-advection-fog": (20.0, 3.0, 1.0, 10.0),
    "moderate-advection-fog": (20.0, 3.0, 1.0, 8.0),
    "chu-hogg-fog": (20.0, 2.0, 0.5, 1.0),
    "strong-spray": (100.0, 6.0, 1.0, 4.0),
    "moderate-spray": (100.0, 6.0, 1.0, 2.0),
    "coastal-haze": (100.0, 1.0, 0.5, 0.05),
    "continental-haze": (100.0, 2.0, 0.5, 0.07),
}
"""Name -> number [1/cm^3], alpha, power and mode [um] of `GammaSizes.of_radii`: Rasshofer, Spies and Spies, Adv. Radio
Sci. 9 (2011), table 1."""

PARAMETERS = {"gamma": ("number", "alpha", "power", "mode"), "lognormal": ("number", "median", "spread")}
"""Shapes of a distribution of radii -> their numbers: particles [1/cm^3], alpha and power [1], most frequent or median
radius [um], geometric standard deviation [1]."""

SIZES = (*RATED_SIZES, *DROPLETS, *PARAMETERS)


def sizes_of(name: str, kind: str, rate_mm_h: float | None = None, **numbers: float) -> Sizes:
    """Sizes by the name of a distribution; of flakes by the drop that each melts to.

    Args:
        name: one of `SIZES`.
        kind: of medium.
        rate_mm_h: of rain or snow [mm/h of water], for `RATED_SIZES`.
        numbers: what `PARAMETERS` has for the name.

    Raises:
        ParameterError: no such name, one of another kind, a number that is missing, too much or without a meaning.
    """
    if name not in SIZES:
        raise ParameterError(f"sizes {name!r}: they are {', '.join(SIZES)}.{did_you_mean(name, SIZES)}")
    wanted = PARAMETERS.get(name, ())
    if wrong := sorted(set(wanted) ^ set(numbers)):
        raise ParameterError(f"sizes {name!r} take {', '.join(wanted) or 'no numbers'}; see {', '.join(wrong)}")
    if name in RATED_SIZES:
        of_kind, at_rate = RATED_SIZES[name]
        if kind != of_kind or rate_mm_h is None:
            raise ParameterError(f"sizes {name!r} are those of {of_kind} of a rate [mm/h]")
        return at_rate(rate_mm_h)
    if rate_mm_h is not None:
        raise ParameterError(f"sizes {name!r} have a number of their own, and no rate; leave one of them out")
    if name in DROPLETS:
        if kind not in ("fog", "haze", "mist", "spray"):
            raise ParameterError(f"sizes {name!r} are of droplets, and {kind} has none")
        return GammaSizes.of_radii(*DROPLETS[name])
    if name == "gamma":
        return GammaSizes.of_radii(*(numbers[word] for word in wanted))
    return LogNormalSizes(1e6 * numbers["number"], 2e-3 * numbers["median"], numbers["spread"])


def rain_speed(diameter_mm: npt.ArrayLike) -> Array:
    """Terminal speed [m/s] of drops of diameters [mm], >= 0, any shape, at sea level.

    Gunn and Kinzer, J. Meteor. 6, 243 (1949); above 0.6 mm as Atlas, Srivastava and Sekhon fit them, Rev. Geophys. 11,
    1 (1973), eq. 24.  Drops above 6 mm break.
    """
    D = np.asarray(diameter_mm, dtype=np.float64)
    return np.where(D < _FORMULA_FROM_MM, np.interp(D, _SLOW_MM, _SLOW_M_S), 9.65 - 10.3 * np.exp(-0.6 * D))


def flake_diameter(melted_mm: npt.ArrayLike) -> Array:
    """Diameter [mm] of the dry flake that melts to drops of given diameters [mm], any shape, by `FLAKE_DENSITY`."""
    return np.asarray(np.sqrt(np.asarray(melted_mm, dtype=np.float64) ** 3 / FLAKE_DENSITY))


def snow_speed(flake_mm: npt.ArrayLike) -> Array:
    """Terminal speed [m/s] of flakes of diameters [mm], any shape.

    Aggregates of unrimed dendrites: Locatelli and Hobbs, J. Geophys. Res. 79 (1974), table 1; for 2 to 10 mm.
    """
    return np.asarray(0.8 * np.asarray(flake_mm, dtype=np.float64) ** 0.16)


def water(sizes: Sizes) -> float:
    """Liquid water [g/m^3] in drops of given sizes, or in flakes by their melted ones."""
    return 1e-3 * math.pi / 6.0 * sizes.moment(3.0)


def extinction(kind: str, sizes: Sizes, efficiency: float = BEAM) -> float:
    """Extinction [1/m] of 'rain' or dry 'snow' of given sizes: its cross sections, times `BEAM` or `PICTURE`.

    A flake's cross section goes with the water in it, by `flake_diameter`, so snow's extinction goes with its water.
    Measured snow of one rate differs tenfold (Rasmussen et al. 1999).
    """
    area_mm2 = sizes.moment(2.0) if kind == "rain" else sizes.moment(3.0) / FLAKE_DENSITY
    return 1e-6 * efficiency * math.pi / 4.0 * area_mm2


def _checked(kind: str, rate_mm_h: float) -> float:
    low, high = RATES_MM_H
    if not low <= rate_mm_h <= high:
        raise ParameterError(
            f"{kind} of {rate_mm_h:g} mm/h: a rate is {low:g} to {high:g} mm/h; leave out what is none"
        )
    return rate_mm_h

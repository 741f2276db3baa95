"""Phase functions of fog: which way a droplet sends light on.

Takes a mean cosine, a droplet diameter or a table; gives the density per solid
angle, its Legendre moments and a table of it.  Knows nothing of Mitsuba or files.

The cosine is everywhere the one between the directions of travel before and after:
1 is straight on, and a mean cosine above 0 is forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.fog import mie

DROPLETS_UM = (5.0, 50.0)
"""Open range of diameters [um] that the fit of Jendersie and d'Eon is for."""

MIE_UM = (0.1, 100.0)
"""Range of diameters [um] whose Lorenz-Mie series is summed; it takes seconds at the upper end."""

MIE_NM = (400.0, 700.0)
"""Range of wavelengths [nm] of a droplet's phase function."""

PEAK_NODES, BROAD_NODES = 513, 257
"""Nodes of a closed form's table: a geometric row into the peak, and an even one for the rest.
Linear between them errs by (step)^2 / 8 times the relative curvature: 0.04 % and 0.05 % at most."""


@dataclass(frozen=True)
class HenyeyGreenstein:
    """The phase function of Henyey and Greenstein (1941).

    Attributes:
        g: mean cosine [1], -1 < g < 1.

    >>> HenyeyGreenstein(0.5).moments(3).tolist()
    [1.0, 0.5, 0.25]
    """

    g: float

    def __post_init__(self) -> None:
        if not -1.0 < self.g < 1.0:
            raise ParameterError(f"g {self.g} is outside (-1, 1)")

    @property
    def mean_cosine(self) -> float:
        """Mean cosine [1]."""
        return self.g

    def value(self, cosine: npt.ArrayLike) -> Array:
        """Density [1/sr] at cosines [1], any shape."""
        g = abs(self.g)
        away = 1.0 - math.copysign(1.0, self.g) * np.asarray(
            cosine, dtype=np.float64
        )  # 0 in the peak, and exact beside it
        return np.asarray((1.0 - g * g) / (4.0 * np.pi * ((1.0 - g) ** 2 + 2.0 * g * away) ** 1.5))

    def moments(self, count: int) -> Array:
        """Legendre moments chi_0 .. chi_(count-1) [1]: g^l."""
        return np.asarray(self.g ** np.arange(count, dtype=np.float64))

    def table(self) -> tuple[Array, Array]:
        """(cosines, ascending from -1 to 1; densities [1/sr]), 0.05 % from linear."""
        cosines = _toward_peak(abs(self.g))
        cosines = cosines if self.g >= 0.0 else -cosines[::-1]
        return cosines, self.value(cosines)


@dataclass(frozen=True)
class Droplets:
    """Water droplets of one diameter: a mixture of Henyey-Greenstein's and Draine's function.

    Attributes:
        diameter_um: droplet diameter d [um], 5 < d < 50.  Radiation fog has 6 to
            10, advection fog 15 to 25.

    Fogbow and glory are one broad bulge, and the first degree is a cusp; see `Tabulated.mie`.
    Source: Jendersie and d'Eon (2023), An approximate Mie scattering function for
    fog and cloud rendering; Draine (2003), ApJ 598, 1017.
    """

    diameter_um: float

    def __post_init__(self) -> None:
        low, high = DROPLETS_UM
        if not low < self.diameter_um < high:
            raise ParameterError(
                f"droplet diameter {self.diameter_um} um is outside ({low:g}, {high:g}), for which the droplet phase "
                f"function was fitted"
            )

    def parameters(self) -> tuple[float, float, float, float]:
        """g of Henyey-Greenstein, g and alpha of Draine, and the share of Draine, all [1]."""
        d = self.diameter_um
        return (
            math.exp(-0.0990567 / (d - 1.67154)),
            math.exp(-2.20679 / (d + 3.91029) - 0.428934),
            math.exp(3.62489 - 8.29288 / (d + 5.52825)),
            math.exp(-0.599085 / (d - 0.641583) - 0.665888),
        )

    @property
    def mean_cosine(self) -> float:
        """Mean cosine [1]."""
        return float(self.moments(2)[1])

    def value(self, cosine: npt.ArrayLike) -> Array:
        """Density [1/sr] at cosines [1], any shape."""
        peak, g, alpha, share = self.parameters()
        mu = np.asarray(cosine, dtype=np.float64)
        draine = HenyeyGreenstein(g).value(mu) * (1.0 + alpha * mu * mu) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
        return np.asarray((1.0 - share) * HenyeyGreenstein(peak).value(mu) + share * draine)

    def moments(self, count: int) -> Array:
        """Legendre moments chi_0 .. chi_(count-1) [1], in closed form.

        Draine's are those of Henyey-Greenstein times 1 + alpha mu^2, by
        mu P_l = ((l + 1) P_(l+1) + l P_(l-1)) / (2 l + 1), twice.
        """
        peak, g, alpha, share = self.parameters()
        h = HenyeyGreenstein(g).moments(count + 2)
        order = np.arange(count + 1, dtype=np.float64)
        once = ((order + 1.0) * h[1:] + order * np.r_[0.0, h[:count]]) / (2.0 * order + 1.0)
        order = order[:count]
        twice = ((order + 1.0) * once[1:] + order * np.r_[0.0, once[: count - 1]]) / (2.0 * order + 1.0)
        draine = (h[:count] + alpha * twice) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
        return (1.0 - share) * HenyeyGreenstein(peak).moments(count) + share * draine

    def table(self) -> tuple[Array, Array]:
        """(cosines, ascending from -1 to 1; densities [1/sr]), 0.05 % from linear; the same number of rows for every
        diameter.
        """
        peak = _toward_peak(self.parameters()[0])
        cosines = np.sort(np.r_[peak, np.linspace(-1.0, 1.0, BROAD_NODES)[1:-1]])
        return cosines, self.value(cosines)


@dataclass(frozen=True, eq=False)
class Tabulated:
    """A measured or computed phase function, linear in the cosine between its rows.

    Attributes:
        cosines: (N,) [1], ascending from -1 to 1.
        values: (N,) densities [1/sr], >= 0, to any scale; kept with integral 1.
        source: where they are from.
    """

    cosines: Array
    values: Array
    source: str

    def __post_init__(self) -> None:
        cosines, values = np.array(self.cosines, dtype=np.float64), np.array(self.values, dtype=np.float64)
        if cosines.ndim != 1 or cosines.shape != values.shape or len(cosines) < 2:
            raise ParameterError(
                f"a phase function's table has one value for each cosine, and at least two; it has {values.shape} for "
                f"{cosines.shape}"
            )
        if not (
            np.all(np.diff(cosines) > 0.0)
            and np.isclose(cosines[0], -1.0, atol=1e-9)
            and np.isclose(cosines[-1], 1.0, atol=1e-9)
        ):
            raise ParameterError(
                f"the cosines of a phase function run from -1 up to 1, each once; these from {cosines[0]:g} to "
                f"{cosines[-1]:g}"
            )
        if not (np.all(np.isfinite(values)) and np.all(values >= 0.0) and np.any(values > 0.0)):
            raise ParameterError("the values of a phase function are finite, 0 or more, and not all 0")
        cosines[0], cosines[-1] = -1.0, 1.0
        values /= 2.0 * np.pi * np.trapezoid(values, cosines)
        cosines.flags.writeable = values.flags.writeable = False
        object.__setattr__(self, "cosines", cosines)
        object.__setattr__(self, "values", values)

    def __eq__(self, table: object) -> bool:
        return (
            isinstance(table, Tabulated)
            and np.array_equal(self.cosines, table.cosines)
            and np.array_equal(self.values, table.values)
        )

    def __hash__(self) -> int:
        return hash(self.values.tobytes())

    @classmethod
    def mie(cls, diameter_um: float, *, wavelength_nm: float = 550.0, spread: float = 1.1) -> Tabulated:
        """Lorenz-Mie theory for unpolarised light on water droplets, with fogbow and glory.

        Args:
            diameter_um: median diameter of a log-normal number distribution [um], 0.1 to 100.
            wavelength_nm: in air [nm], 400 to 700.
            spread: geometric standard deviation [1], 1 to 2.  1 is one size, whose
                curve is all ripples; 1.1 is narrow and smooths all but the first ones.

        Returns:
            25 rows a unit of the size parameter pi d / lambda, even in angle, at
            least 721; a ring of the diffraction peak has 80.

        Raises:
            ParameterError: a value outside its range, or miepython is missing.

        Source: Bohren and Huffman (1983), eq. 4.74 to 4.77; coefficients a_n and b_n by
        `miepython`; refractive index: Hale and Querry (1973).
        """
        for name, value, unit, (low, high) in (
            ("droplet diameter", diameter_um, " um", MIE_UM),
            ("wavelength", wavelength_nm, " nm", MIE_NM),
            ("spread", spread, "", (1.0, 2.0)),
        ):
            if not low <= value <= high:
                raise ParameterError(f"{name} {value}{unit} is outside {low:g} to {high:g}")
        size = np.pi * diameter_um * 1e3 / wavelength_nm
        sizes, numbers = _log_normal(size, spread)
        theta = np.linspace(np.pi, 0.0, max(721, math.ceil(25.0 * size)))
        cosines = np.cos(theta)
        cosines[0], cosines[-1] = -1.0, 1.0
        index = mie.index("water", wavelength_nm).real  # it absorbs less than 1e-5 in a droplet of 100 um
        return cls(
            cosines,
            mie.intensity(index, sizes, numbers, cosines),
            f"Lorenz-Mie, water droplets of {diameter_um:g} um, {wavelength_nm:g} nm",
        )

    @property
    def mean_cosine(self) -> float:
        """Mean cosine [1]."""
        return float(self.moments(2)[1])

    def value(self, cosine: npt.ArrayLike) -> Array:
        """Density [1/sr] at cosines [1], any shape."""
        return np.asarray(np.interp(np.asarray(cosine, dtype=np.float64), self.cosines, self.values))

    def moments(self, count: int) -> Array:
        """Legendre moments chi_0 .. chi_(count-1) [1], to 1e-6.

        Gauss-Legendre with 6 nodes in every interval, long ones cut so that no
        polynomial turns by more than 2 rad within a piece.
        """
        theta = np.arccos(self.cosines)
        pieces = np.maximum(np.ceil(-np.diff(theta) * count / 2.0), 1.0).astype(np.int64)
        ends = np.cos(np.interp(np.r_[0.0, np.arange(1, pieces.sum() + 1)], np.r_[0, np.cumsum(pieces)], theta))
        ends = np.unique(np.r_[ends, self.cosines])
        nodes, weights = np.polynomial.legendre.leggauss(6)
        half = np.diff(ends)[:, None] / 2.0
        mu = (ends[:-1, None] + half + half * nodes).ravel()
        share = 2.0 * np.pi * self.value(mu) * (half * weights).ravel()
        before, now, chi = np.zeros_like(mu), np.ones_like(mu), np.empty(count)
        for order in range(count):
            chi[order] = share @ now
            before, now = now, ((2 * order + 1) * mu * now - order * before) / (order + 1)
        return chi

    def table(self) -> tuple[Array, Array]:
        """(cosines, ascending from -1 to 1; densities [1/sr])."""
        return self.cosines, self.values


Phase = HenyeyGreenstein | Droplets | Tabulated


def _toward_peak(g: float) -> Array:
    """Cosines, ascending, whose denominators in Henyey-Greenstein's function are a geometric row; even for g = 0."""
    g = max(g, 1e-3)
    row = np.linspace(2.0 * math.log((1.0 + g) / (1.0 - g)), 0.0, PEAK_NODES)
    cosines = 1.0 - (1.0 - g) ** 2 / (2.0 * g) * np.expm1(row)
    cosines[0], cosines[-1] = -1.0, 1.0
    return np.asarray(cosines)


def _log_normal(median: float, spread: float) -> tuple[Array, Array]:
    """Size parameters within three deviations, close enough for the narrow resonances to average out, and how many
    droplets have each.
    """
    if spread == 1.0:
        return np.array([median]), np.array([1.0])
    width = math.log(spread)
    count = max(401, math.ceil(median * (spread**3 - spread**-3) / 0.7))
    steps = np.linspace(-3.0, 3.0, count)
    return median * np.exp(width * steps), np.exp(-(steps**2) / 2.0)

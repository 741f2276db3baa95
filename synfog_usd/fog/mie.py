"""Light on spheres by the theory of Lorenz and Mie: how much they stop, how much of it they scatter, and where to.

Takes refractive indices and size parameters; gives efficiencies and intensities.  Coefficients a_n and b_n are
`miepython`'s, which is an extra: what ships has tables (`fog.kinds`).
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from synfog_usd.base import tables
from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.fog.drops import Sizes

SIZES = 400
"""Radii of a distribution, even in the logarithm: with more of them extinctions move by 0.3 % at most."""


LARGEST_UM = 100.0
"""Radius [um] of spheres whose series is summed; larger ones take minutes, and are drops of rain."""


@dataclass(frozen=True)
class Optics:
    """What a medium does with light of one wavelength.

    Attributes:
        extinction_per_m: [1/m].
        albedo: share of it that is scattered [1].
        g: mean cosine of the scattering angle [1].
    """

    extinction_per_m: float
    albedo: float
    g: float


def optics(sizes: Sizes, index: complex, wavelength_nm: float, radii_um: tuple[float, float]) -> Optics:
    """Optics of spheres of a size distribution.

    Args:
        index: n - ik of the spheres; k >= 0 absorbs.
        radii_um: least and largest radius [um] that count.

    Raises:
        ParameterError: miepython is missing.

    Source: Bohren and Huffman (1983), eq. 4.61, 4.62; mean cosine: section 4.5.
    """
    x, numbers = weighted(sizes, wavelength_nm, radii_um)
    extinction, scattering, g = np.array([efficiencies(index, size) for size in x]).T
    area = numbers * np.pi * (x * wavelength_nm * 1e-9 / (2.0 * np.pi)) ** 2
    total, scattered = float(area @ extinction), float(area @ scattering)
    return Optics(total, scattered / total, float(area @ (scattering * g)) / scattered)


def index(material: str, wavelength_nm: float) -> complex:
    """n - ik of 'water', 'soot' or 'mineral' at a wavelength [nm], 350 to 1750; straight lines between the rows.

    Source: d'Almeida, Koepke and Shettle (1991), as OPAC has them (Hess, Koepke and Schult, Bull. Amer. Meteor. Soc.
    79, 831 (1998)); water's is Hale and Querry's (1973).
    """
    table = tables.table("refractive")
    n, k = (float(np.interp(wavelength_nm, table["wavelength_nm"], table[f"{material}_{part}"])) for part in "nk")
    return complex(n, -k)


def radii_of(sizes: Sizes) -> tuple[float, float]:
    """Radii [um] between which nearly all of the cross section is, 1e-6 of it aside at either end.

    Raises:
        ParameterError: the largest are above `LARGEST_UM`.
    """
    radii = np.geomspace(1e-3, 1e4, 4001)
    area = np.cumsum(radii**3 * sizes.density(2e-3 * radii))
    low, high = np.interp([1e-6, 1.0 - 1e-6], area / area[-1], radii)
    if not high <= LARGEST_UM:
        raise ParameterError(f"spheres of up to {high:.3g} um radius: the series is summed up to {LARGEST_UM:g} um")
    return float(low), float(high)


def weighted(sizes: Sizes, wavelength_nm: float, radii_um: tuple[float, float]) -> tuple[Array, Array]:
    """(size parameters (N,) [1], number [1/m^3] of spheres that each stands for (N,))."""
    radii = np.geomspace(*radii_um, SIZES)
    step = math.log(radii_um[1] / radii_um[0]) / (SIZES - 1)
    diameters_mm = 2e-3 * radii
    numbers = sizes.density(diameters_mm) * diameters_mm * step
    numbers[[0, -1]] /= 2.0
    return 2e3 * np.pi * radii / wavelength_nm, numbers


def efficiencies(index: complex, size: float) -> tuple[float, float, float]:
    """(extinction, scattering) over the cross section, and mean cosine [1], of a sphere of a size parameter."""
    extinction, scattering, _, g = _miepython().efficiencies_mx(index, size)
    return float(extinction), float(scattering), float(g)


def intensity(index: complex, sizes: Array, numbers: Array, cosines: Array) -> Array:
    """|S1|^2 + |S2|^2, summed over spheres of several sizes, at each cosine, to any scale.

    Source: Bohren and Huffman (1983), eq. 4.74 to 4.77.

    Raises:
        ParameterError: miepython is missing.
    """
    miepython = _miepython()
    a_n, b_n = zip(*[miepython.coefficients(index, size) for size in sizes], strict=True)
    terms = max(len(row) for row in a_n)
    orders = np.arange(1, terms + 1)
    scale = (2.0 * orders + 1.0) / (orders * (orders + 1.0))
    a, b = (np.stack([np.r_[row, np.zeros(terms - len(row))] for row in rows]) * scale for rows in (a_n, b_n))
    pi, tau = np.empty((terms, len(cosines))), np.empty((terms, len(cosines)))
    before, now = np.zeros_like(cosines), np.ones_like(cosines)
    for n in orders:
        pi[n - 1], tau[n - 1] = now, n * cosines * now - (n + 1) * before
        before, now = now, ((2 * n + 1) * cosines * now - (n + 1) * before) / n
    total = np.zeros_like(cosines)
    for of_a, of_b in ((pi, tau), (tau, pi)):
        for a_part, b_part in ((a.real, b.real), (a.imag, b.imag)):  # real matrices: half the work
            total += numbers @ (a_part @ of_a + b_part @ of_b) ** 2
    return total


def _miepython() -> ModuleType:
    try:
        return importlib.import_module("miepython")
    except ImportError as missing:
        raise ParameterError(
            'the phase function of Lorenz and Mie needs miepython; pip install miepython, or use phase "droplets"'
        ) from missing

"""Daylight without clouds in it: the CIE general skies, and the colour of light from the sky.

Takes angles; gives relative luminances, illuminances per zenith luminance, and
linear Rec.709 tints of luminance 1.  Knows nothing of pictures, clouds or USD.

The fifteen standard skies of ISO 15469:2004 (CIE S 011/E:2003) are

    L(Z, chi) / L(0, Zs) = f(chi) phi(Z) / (f(Zs) phi(0))
    phi(Z) = 1 + a exp(b / cos Z)
    f(chi) = 1 + c (exp(d chi) - exp(d pi / 2)) + e cos^2 chi

with Z the angle from the zenith, chi the angle from the sun, Zs the sun's Z.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.science import colour_science

LUMINANCE: Array = np.array([0.2126390058715104, 0.7151686787677559, 0.0721923153607337])  # of linear Rec.709


@dataclass(frozen=True)
class CieSky:
    """One of the fifteen standard skies: a, b grade from zenith to horizon; c, d, e scatter about the sun."""

    a: float
    b: float
    c: float
    d: float
    e: float
    about: str


CIE_SKIES = {
    1: CieSky(4.0, -0.70, 0.0, -1.0, 0.00, "overcast, steep gradation, the same all round"),
    2: CieSky(4.0, -0.70, 2.0, -1.5, 0.15, "overcast, steep gradation, slightly brighter towards the sun"),
    3: CieSky(1.1, -0.80, 0.0, -1.0, 0.00, "overcast, moderate gradation, the same all round"),
    4: CieSky(1.1, -0.80, 2.0, -1.5, 0.15, "overcast, moderate gradation, slightly brighter towards the sun"),
    5: CieSky(0.0, -1.00, 0.0, -1.0, 0.00, "uniform"),
    6: CieSky(0.0, -1.00, 2.0, -1.5, 0.15, "partly cloudy, no gradation, slightly brighter towards the sun"),
    7: CieSky(0.0, -1.00, 5.0, -2.5, 0.30, "partly cloudy, no gradation, brighter around the sun"),
    8: CieSky(0.0, -1.00, 10.0, -3.0, 0.45, "partly cloudy, no gradation, a clear aureole"),
    9: CieSky(-1.0, -0.55, 2.0, -1.5, 0.15, "partly cloudy, the sun hidden"),
    10: CieSky(-1.0, -0.55, 5.0, -2.5, 0.30, "partly cloudy, brighter around the sun"),
    11: CieSky(-1.0, -0.55, 10.0, -3.0, 0.45, "white-blue, a clear aureole"),
    12: CieSky(-1.0, -0.32, 10.0, -3.0, 0.45, "clear, little turbidity"),
    13: CieSky(-1.0, -0.32, 16.0, -3.0, 0.30, "clear, polluted air"),
    14: CieSky(-1.0, -0.15, 16.0, -3.0, 0.30, "cloudless, turbid, a broad aureole"),
    15: CieSky(-1.0, -0.15, 24.0, -2.8, 0.15, "white-blue, turbid, a broad aureole"),
}
"""Type -> parameters, ISO 15469:2004 table 1."""


def relative_luminance(
    kind: int, zenith_angle: npt.ArrayLike, sun_distance: npt.ArrayLike, sun_zenith_angle: float
) -> Array:
    """Luminance of a standard sky over that of its zenith.

    Args:
        kind: type, 1 to 15.
        zenith_angle: Z [rad], 0 to pi / 2; at pi / 2 the gradation is at its limit 1.
        sun_distance: chi [rad], 0 to pi, shape of `zenith_angle`.
        sun_zenith_angle: Zs [rad], 0 to pi / 2.

    Returns:
        L / Lz, float64, shape of `zenith_angle`.

    Raises:
        ParameterError: another type.
    """
    if kind not in CIE_SKIES:
        raise ParameterError(f"CIE sky {kind!r} does not exist; a type is a whole number from 1 to 15")
    sky = CIE_SKIES[kind]

    def graded(angle: npt.ArrayLike) -> Array:
        return 1.0 + sky.a * np.exp(sky.b / np.maximum(np.cos(angle), 1e-6))

    def scattered(angle: npt.ArrayLike) -> Array:
        chi = np.asarray(angle, dtype=np.float64)
        return 1.0 + sky.c * (np.exp(sky.d * chi) - np.exp(sky.d * np.pi / 2)) + sky.e * np.cos(chi) ** 2

    return scattered(sun_distance) * graded(zenith_angle) / (scattered(sun_zenith_angle) * graded(0.0))


@functools.lru_cache(maxsize=64)
def illuminance_per_zenith(kind: int, sun_height_deg: float) -> float:
    """Horizontal illuminance [lx] of a standard sky whose zenith has 1 cd m-2.

    Midpoint rule over 400 heights and 720 azimuths; 1e-4 against the closed form of type 1.
    """
    height = (np.arange(400) + 0.5) / 400 * np.pi / 2
    azimuth = (np.arange(720) + 0.5) / 720 * 2 * np.pi
    h, a = np.meshgrid(height, azimuth, indexing="ij")
    sun = np.deg2rad(sun_height_deg)
    chi = np.arccos(np.clip(np.sin(h) * np.sin(sun) + np.cos(h) * np.cos(sun) * np.cos(a), -1, 1))
    L = relative_luminance(kind, np.pi / 2 - h, chi, np.pi / 2 - sun)
    return float(np.sum(L * np.sin(h) * np.cos(h)) * (np.pi / 800) * (2 * np.pi / 720))


@functools.lru_cache(maxsize=256)
def tint(cct_k: float) -> tuple[float, float, float]:
    """Linear Rec.709 of luminance 1 and a correlated colour temperature.

    On the CIE daylight locus from 4000 K up, on the Planckian locus below (a street
    lamp, or a sun so low that no daylight table holds it).

    Args:
        cct_k: 1667 to 25000 K.

    Raises:
        ParameterError: a temperature outside.

    Source: CIE 015:2018 for daylight, Kang et al. (2002) for Planck, from colour-science.
    """
    if not 1667.0 <= cct_k <= 25000.0:
        raise ParameterError(
            f"colour temperature {cct_k:g} K is outside 1667 to 25000 K, where chromaticities are tabulated"
        )
    colour = colour_science()
    x, y = (
        colour.temperature.CCT_to_xy_CIE_D(cct_k) if cct_k >= 4000.0 else colour.temperature.CCT_to_xy_Kang2002(cct_k)
    )
    rgb = np.linalg.inv(colour.RGB_COLOURSPACES["ITU-R BT.709"].matrix_RGB_to_XYZ) @ np.array(
        [x / y, 1.0, (1 - x - y) / y]
    )
    r, g, b = (max(float(c), 0.0) for c in rgb)
    return r, g, b


def colour_temperature(sun_height_deg: float, *, cover: float, through: float = 0.0) -> float:
    """Correlated colour temperature of the light that a cloudy sky sends to the ground.

    Three lights mix by their share, in reciprocal megakelvins: blue sky between the
    clouds, light that many droplets have mixed (nearly that of the sun and sky above),
    and sun that shows through thin cloud, redder the longer its way through the air.
    After sunset ozone makes all of it bluer.

    Args:
        sun_height_deg: -18 to 90.
        cover: share of the light that comes from clouds, 0 to 1.
        through: share of the light that is sun seen through thin cloud, 0 to 1.

    Returns:
        CCT [K], to the nearest 50.

    The knots are a reading of measured skies, good to some hundred kelvins: overcast
    days 5800 to 7500 K, mean near 6400 K (Lee and Hernandez-Andres 2005); all
    daylight at Granada 3800 K to above 30000 K (Hernandez-Andres et al. 2001).
    >>> colour_temperature(45.0, cover=1.0)
    6350.0
    """
    heights = [-18.0, -12.0, -6.0, -3.0, 0.0, 5.0, 20.0, 90.0]
    cloud = np.interp(sun_height_deg, heights, [82.0, 82.0, 94.0, 112.0, 137.0, 151.0, 157.5, 157.5])
    blue = np.interp(sun_height_deg, heights, [62.0, 62.0, 62.0, 68.0, 80.0, 82.0, 80.0, 80.0])
    beam = np.interp(sun_height_deg, heights, [420.0, 420.0, 420.0, 420.0, 420.0, 305.0, 205.0, 180.0])
    mired = (1 - through) * (cover * cloud + (1 - cover) * blue) + through * beam
    return float(round(1e6 / mired / 50) * 50)

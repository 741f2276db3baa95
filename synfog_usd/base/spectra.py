"""Spectra of lights and surfaces by name: what `synfog:spectrum:emission` and `synfog:spectrum:reflectance` may hold.

Takes a name, or wavelengths with values; gives a spectrum on `photometry.WAVELENGTHS_NM`.
Reflectances are formulas with measured coefficients (`TABLE`, `assets/spectra`): pigments in leaves and
skin, minerals, dyed sheeting.  Knows nothing of USD and of rendering.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from synfog_usd.base import tables
from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.base.photometry import ILLUMINANTS, WAVELENGTHS_NM, channel_spectra, illuminant, luminance_of, observer
from synfog_usd.base.science import colour_science

EMISSION, REFLECTANCE = "synfog:spectrum:emission", "synfog:spectrum:reflectance"
"""The attributes: a name, or pairs (wavelength [nm], value)."""

LEDS: Mapping[str, tuple[float, float]] = MappingProxyType({"LED 625 nm": (625.0, 18.0), "LED 592 nm": (592.0, 15.0)})
"""Single LEDs: peak and half width [nm], as catalogues of red and amber signal LEDs give them."""

PAINT = "paint"
"""A reflectance without a curve of its own: the smooth one of the material's colour."""

COVERS_NM = (400.0, 700.0)
"""What an authored spectrum must cover at least; it goes on as it ends."""


@dataclass(frozen=True)
class Reflectance:
    """One spectrum of the table.

    Attributes:
        about: of what.
        source: of its figures.
        curve: wavelengths [nm] -> reflectance, 0 to 1.
    """

    about: str
    source: str
    curve: Callable[[Array], Array]


def _layer(absorbed: Array, scattered: Array | float) -> Array:
    """Diffuse reflectance of a layer on black by its optical thicknesses, 2 x absorption and scattering (Kubelka and
    Munk 1931).
    """
    a = 1.0 + absorbed / scattered
    b = np.sqrt(a * a - 1.0)
    return np.asarray(1.0 / (a + b / np.tanh(b * scattered)))


def _step(wavelength: Array, edge_nm: float, width_nm: float) -> Array:
    """0 below an edge, 1 above it."""
    return np.asarray(1.0 / (1.0 + np.exp(-(wavelength - edge_nm) / width_nm)))


def _columns(name: str, wavelength: Array) -> list[Array]:
    """The columns of a table at wavelengths [nm], on straight lines.

    `leaf_pigments`: specific absorption of chlorophyll and carotenes [cm2 per microgram] (Feret et al. 2008,
    PROSPECT-5).  `haemoglobin`: molar extinction with oxygen and without [1/(cm mol/l)] (Prahl 1998, after Gratzer and
    Kollias).
    """
    wavelength_nm, *columns = tables.table(name).values()
    return [np.interp(wavelength, wavelength_nm, column) for column in columns]


LEAF_SCATTERING = 0.9
"""Scattering thickness of a leaf: 46 % of near infrared come back, as PROSPECT gives for broad leaves."""

LEAF_PATH = 1.42**2
"""How much farther diffuse light goes in a leaf than its thickness says: its skin of index 1.42 turns most of it back
inside.
"""


LEAF_SURFACE = 0.015
"""What the rough wax of a leaf sends back in all directions, before light gets inside."""


def leaf(wavelength: Array, *, chlorophyll: float, carotene: float, brown: float = 0.0) -> Array:
    """Diffuse reflectance of a leaf by its pigments.

    Two fluxes of light in a layer that scatters alike at all wavelengths and absorbs as the pigments do.  Between the
    red that chlorophyll takes and the near infrared that nothing takes lies the red edge.

    Args:
        chlorophyll, carotene: [micrograms per cm2]; a green leaf has 20 to 80, and a fifth of it in carotenes.
        brown: absorption of what a dead leaf turns to at 500 nm, falling to half each 55 nm.
    """
    green, yellow = _columns("leaf_pigments", wavelength)
    tan = brown * 2.0 ** (-(wavelength - 500.0) / 55.0)
    return LEAF_SURFACE + (1.0 - LEAF_SURFACE) * _layer(
        2.0 * LEAF_PATH * (chlorophyll * green + carotene * yellow + tan + 0.008), LEAF_SCATTERING
    )


def skin(wavelength: Array, *, melanin: float, blood: float = 0.02, oxygen: float = 0.75) -> Array:
    """Diffuse reflectance of skin: dermis with blood, seen twice through the melanin of the epidermis.

    Args:
        melanin: share of the epidermis that is melanosomes; 0.01 to 0.06 light, 0.1 and more dark.
        blood: share of the dermis; oxygen: share of its haemoglobin that carries oxygen.
    """
    with_oxygen, without = _columns("haemoglobin", wavelength)
    haemoglobin = oxygen * with_oxygen + (1.0 - oxygen) * without
    per_cm = blood * 2.303 * haemoglobin * 150.0 / 64_500.0 + 0.25  # 150 g/l of blood; 64 500 g/mol; bloodless tissue
    scattering = 46.0 * (wavelength / 500.0) ** -1.421
    ratio = 2.0 * per_cm / (0.75 * scattering)
    dermis = 1.0 + ratio - np.sqrt(ratio * ratio + 2.0 * ratio)
    twice = np.exp(
        -2.0 * 2.0 * 0.006 * melanin * 6.6e11 * wavelength**-3.33
    )  # 60 micrometres, twice as long for diffuse light
    return np.asarray(dermis * twice)


def _asphalt(level: float, rise: float) -> Callable[[Array], Array]:
    return lambda wavelength: level * (1.0 + rise * (wavelength - 550.0) / 100.0)


def _mineral(low: float, high: float, edge_nm: float, width_nm: float, rise: float) -> Callable[[Array], Array]:
    """Iron oxides: dark below an edge, then a slow rise."""
    return lambda wavelength: (
        (low + (high - low) * _step(wavelength, edge_nm, width_nm)) * (1.0 + rise * (wavelength - 550.0) / 100.0)
    )


def _sheeting(low: float, high: float, edge_nm: float, width_nm: float) -> Callable[[Array], Array]:
    return lambda wavelength: low + (high - low) * _step(wavelength, edge_nm, width_nm)


def _between(low: float, high: float, from_nm: float, to_nm: float, width_nm: float) -> Callable[[Array], Array]:
    return lambda wavelength: (
        low + (high - low) * _step(wavelength, from_nm, width_nm) * (1.0 - _step(wavelength, to_nm, width_nm))
    )


_PROSPECT = "pigments: Feret et al. (2008), PROSPECT-5; two fluxes: Kubelka and Munk (1931)"
_JACQUES = "melanin: Jacques (1998); scattering: Jacques (2013); haemoglobin: Prahl (1998)"
_HEROLD = "estimate; slow rise that grows with age as in Herold et al. (2004)"
_SIGNS = "edges such that the colour lies in the daylight box of EN 12899-1"

TABLE: Mapping[str, Reflectance] = MappingProxyType(
    {
        "leaf": Reflectance(
            "a broad leaf, 40 micrograms of chlorophyll per cm2",
            _PROSPECT,
            lambda w: leaf(w, chlorophyll=40.0, carotene=8.0),
        ),
        "leaf_olive": Reflectance(
            "a leaf that begins to turn", _PROSPECT, lambda w: leaf(w, chlorophyll=14.0, carotene=7.0, brown=0.12)
        ),
        "leaf_gold": Reflectance(
            "a yellow leaf in autumn: carotenes alone",
            _PROSPECT,
            lambda w: leaf(w, chlorophyll=1.0, carotene=10.0, brown=0.15),
        ),
        "leaf_dry": Reflectance(
            "a dead, brown leaf", _PROSPECT, lambda w: leaf(w, chlorophyll=0.5, carotene=4.0, brown=1.3)
        ),
        "needle": Reflectance("conifer needles, dark", _PROSPECT, lambda w: leaf(w, chlorophyll=70.0, carotene=12.0)),
        "grass": Reflectance(
            "a lawn: green blades over some dry ones",
            _PROSPECT,
            lambda w: leaf(w, chlorophyll=28.0, carotene=7.0, brown=0.12),
        ),
        "asphalt": Reflectance("asphalt in use", _HEROLD, _asphalt(0.10, 0.08)),
        "asphalt_new": Reflectance("new asphalt: bitumen, nearly black and flat", _HEROLD, _asphalt(0.05, 0.03)),
        "asphalt_old": Reflectance("old asphalt: the stone shows", _HEROLD, _asphalt(0.16, 0.12)),
        "concrete": Reflectance(
            "concrete and cement render",
            "estimate; falls towards blue as cement does",
            _mineral(0.20, 0.33, 430.0, 40.0, 0.03),
        ),
        "soil": Reflectance(
            "moist brown soil",
            "estimate; soft edge of iron oxides as in Stoner and Baumgardner (1981)",
            _mineral(0.06, 0.14, 550.0, 60.0, 0.10),
        ),
        "brick": Reflectance(
            "red brick: haematite",
            "estimate; edge of haematite near 575 nm as in Morris et al. (1985)",
            _mineral(0.10, 0.30, 578.0, 20.0, 0.05),
        ),
        "skin": Reflectance("light skin", _JACQUES, lambda w: skin(w, melanin=0.025)),
        "skin_brown": Reflectance("brown skin", _JACQUES, lambda w: skin(w, melanin=0.06)),
        "sheeting_white": Reflectance("white retro-reflective sheeting", _SIGNS, _sheeting(0.04, 0.40, 408.0, 8.0)),
        "sheeting_yellow": Reflectance("yellow retro-reflective sheeting", _SIGNS, _sheeting(0.02, 0.42, 513.0, 9.0)),
        "sheeting_red": Reflectance("red retro-reflective sheeting", _SIGNS, _sheeting(0.012, 0.30, 608.0, 9.0)),
        "sheeting_blue": Reflectance(
            "blue retro-reflective sheeting", _SIGNS, _between(0.008, 0.17, 405.0, 490.0, 12.0)
        ),
    }
)
"""Reflectances by name.  Each stands for all of its kind: a material that names one has it `tinted` to its own
colour.
"""


def reflectance(name: str) -> Array:
    """(401,) reflectance of a spectrum of the table.

    Raises:
        ParameterError: another name; says which exist.
    """
    if name not in TABLE:
        names = (PAINT, *TABLE)
        raise ParameterError(
            f"there is no spectrum {name!r}; it can be {', '.join(names)}, or pairs (nm, "
            f"reflectance).{did_you_mean(name, names)}"
        )
    return np.clip(TABLE[name].curve(WAVELENGTHS_NM), 0.0, 1.0)


@functools.lru_cache(maxsize=64)
def emission(name: str) -> Array:
    """(401,) relative power of a light: of `ILLUMINANTS`, any other CIE illuminant, or of `LEDS`.

    Raises:
        ParameterError: another name; says which exist.

    Source: CIE 015:2018; single LEDs by the model of Ohno (2005); both from colour-science.
    """
    if name in ILLUMINANTS:
        return illuminant(name)
    if name in tables.LIGHTS or name in LEDS:
        return tables.table(tables.STANDARD)[name]
    standard = colour_science().SDS_ILLUMINANTS
    if name not in standard:
        names = (*ILLUMINANTS, *LEDS, *standard)
        some = (*ILLUMINANTS, *LEDS, "HP1 to HP5", "LED-B1 to LED-B5", "FL1 to FL12")
        raise ParameterError(
            f"there is no light {name!r}; it can be {', '.join(some)} or another illuminant of the "
            f"CIE.{did_you_mean(name, names)}"
        )
    return np.interp(WAVELENGTHS_NM, standard[name].wavelengths, standard[name].values)


def spectrum_of_pairs(pairs: npt.ArrayLike, *, most: float = np.inf) -> Array:
    """(401,) spectrum through (N, 2) pairs of wavelength [nm] and value, straight between them.

    Args:
        pairs: wavelengths rising, from 400 nm or below to 700 nm or above; values 0 to `most`, not all 0.

    Raises:
        ParameterError: anything else.
    """
    table = np.asarray(pairs, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2:
        raise ParameterError(f"an array of shape {table.shape} is no spectrum; it takes two or more pairs (nm, value)")
    wavelength, value = table.T
    if not np.isfinite(table).all() or (np.diff(wavelength) <= 0.0).any():
        raise ParameterError(
            "its wavelengths do not rise, or a number is not finite; it takes pairs (nm, value) from short to long "
            "wavelengths"
        )
    if wavelength[0] > COVERS_NM[0] or wavelength[-1] < COVERS_NM[1]:
        raise ParameterError(
            f"it covers {wavelength[0]:g} to {wavelength[-1]:g} nm; it must reach from {COVERS_NM[0]:g} to "
            f"{COVERS_NM[1]:g} nm (not micrometres)"
        )
    if value.min() < 0.0 or value.max() > most * (1.0 + 1e-6) or not value.max() > 0.0:
        upper = f" to {most:g}" if np.isfinite(most) else " and above"
        raise ParameterError(f"its values go from {value.min():g} to {value.max():g}; they are 0{upper}, and not all 0")
    return np.interp(WAVELENGTHS_NM, wavelength, np.minimum(value, most))


@functools.lru_cache(maxsize=1)
def _to_rgb() -> Array:
    """(3, 401) such that it @ reflectance is what D65 shows of it in linear Rec.709; white gives (1, 1, 1)."""
    primaries = observer() @ channel_spectra(("R", "G", "B")).T
    white = illuminant("D65") / luminance_of(illuminant("D65"))
    return np.asarray(np.linalg.inv(primaries) @ (observer() * white))


def rgb_of(reflectance: Array) -> Array:
    """(..., 3) linear Rec.709 under D65 of (..., 401) reflectances.

    >>> [round(float(c), 6) for c in rgb_of(np.full(401, 0.25))]
    [0.25, 0.25, 0.25]
    """
    return np.asarray(reflectance @ _to_rgb().T)


def brightness(rgb: npt.ArrayLike) -> float:
    """Luminance of linear Rec.709."""
    return float(np.asarray(rgb, dtype=np.float64) @ LUMINANCE)


def scaled(shape: Array, rgb: npt.ArrayLike) -> Array:
    """A reflectance of this shape that is as bright as a colour under D65, at most 1 anywhere."""
    luminance = brightness(rgb_of(shape))
    return np.minimum(shape * (brightness(rgb) / max(luminance, 1e-12)), 1.0)


@functools.lru_cache(maxsize=256)
def smooth(rgb: tuple[float, float, float]) -> Array:
    """(401,) the smoothest reflectance of a colour: a sigmoid of a parabola over wavelength.

    Pigments in paint have one broad edge or bump.

    Args:
        rgb: linear Rec.709 that D65 shows; 0.002 to 0.998 is reached to 1e-6 wherever a reflectance can.

    Source: Jakob and Hanika, "A Low-Dimensional Function Space for Efficient Spectral Upsampling" (2019).
    """
    level = 2.0 * brightness(np.clip(rgb, *_REACHED)) - 1.0

    def curve(t: Array) -> tuple[Array, Array]:
        return 0.5 + 0.5 * t / np.sqrt(1.0 + t * t), 0.5 * (1.0 + t * t) ** -1.5

    return _solved(curve, level / np.sqrt(1.0 - level * level), rgb)


def tinted(reflectance: Array, rgb: tuple[float, float, float]) -> Array:
    """A reflectance times a factor, exp of a parabola from 430 to 650 nm and even beyond, such that D65 shows a colour;
    at most 1 anywhere.

    So a spectrum that stands for all of its kind becomes that of one of them: its bands and edges stay, its tint is the
    material's.

    Args:
        reflectance: (401,) of the whole kind.
        rgb: as `smooth` takes it.
    """
    start = np.log(brightness(np.clip(rgb, *_REACHED)) / max(brightness(rgb_of(reflectance)), 1e-12))

    def curve(t: Array) -> tuple[Array, Array]:
        value = reflectance * np.exp(np.clip(t, -30.0, 30.0))
        return value, value

    return np.minimum(_solved(curve, start, rgb, SEEN_NM), 1.0)


_REACHED = (2e-3, 0.998)

SEEN_NM = (430.0, 650.0)
"""Outside of it a colour says next to nothing of a spectrum, and a tint does not change."""


def _solved(
    curve: Callable[[Array], tuple[Array, Array]],
    start: float,
    rgb: npt.ArrayLike,
    reach_nm: tuple[float, float] = (0.0, np.inf),
) -> Array:
    """The curve of a parabola, by Newton's method on its three coefficients, of which D65 shows a colour; the nearest
    found where there is none.

    Args:
        curve: a parabola on `WAVELENGTHS_NM` -> the curve and how fast it changes with it.
        start: value of the flat parabola to begin with.
        reach_nm: wavelengths between which it is a parabola; it goes on as it ends.
    """
    target = np.clip(np.asarray(rgb, dtype=np.float64), *_REACHED)
    x = (np.clip(WAVELENGTHS_NM, *reach_nm) - 580.0) / 200.0
    basis = np.stack([np.ones_like(x), x, x * x])
    c = np.array([start, 0.0, 0.0])
    error = rgb_of(curve(c @ basis)[0]) - target
    for _ in range(200):
        if np.abs(error).max() < 1e-7:
            break
        slope = _to_rgb() @ (curve(c @ basis)[1] * basis).T
        step = np.linalg.solve(slope.T @ slope + 1e-12 * np.eye(3), slope.T @ error)
        for halving in range(20):  # a full step may overshoot
            tried = c - step * 0.5**halving
            after = rgb_of(curve(tried @ basis)[0]) - target
            if np.abs(after).sum() < np.abs(error).sum():
                c, error = tried, after
                break
        else:
            break
    return curve(c @ basis)[0]

"""What the channels of a radiance image are made of: one spectrum per channel.

An R, G, B picture is linear Rec.709 in cd m-2; its channels get the spectra that
Mallett and Yuksel fitted to sRGB, lit by D65.  Bands are boxes around their
centres.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from synfog_usd.base import tables
from synfog_usd.base.arrays import Array
from synfog_usd.base.constants import LUMINOUS_EFFICACY_LM_W
from synfog_usd.base.errors import ImageError, ParameterError, did_you_mean
from synfog_usd.base.image import Image

WAVELENGTHS_NM: Array = tables.GRID_NM
"""The grid of every spectral integral here: 380 to 780 nm in steps of 1 nm."""

ILLUMINANTS = {"D65": "D65", "A": "A", "HPS": "HP1", "LED": "LED-B3"}
"""Lights by name: daylight, tungsten, high-pressure sodium, a white LED; and what CIE 015:2018 calls them."""

_BAND = re.compile(r"S0\.(\d+)(?:,(\d+))?nm")


def band_name(centre_nm: float) -> str:
    """Channel name of a band, after Fichet et al. (2021).

    >>> band_name(550.0)
    'S0.550,000000nm'
    """
    return "S0." + f"{centre_nm:.6f}".replace(".", ",") + "nm"


def band_centre_nm(channel: str) -> float | None:
    """Centre [nm] of a band by its channel name; None where the name is not a band's."""
    match = _BAND.fullmatch(channel)
    return float(f"{match[1]}.{match[2] or 0}") if match else None


def is_rgb(channels: Sequence[str]) -> bool:
    """Whether the channels are linear Rec.709."""
    return tuple(channels) == ("R", "G", "B")


def spectra_of(channels: Sequence[str]) -> str:
    """Where the spectra of a picture come from, in words.

    >>> spectra_of(("R", "G", "B"))
    'upsampled from linear Rec.709 (Mallett and Yuksel 2019, times D65)'
    """
    return (
        "upsampled from linear Rec.709 (Mallett and Yuksel 2019, times D65)"
        if is_rgb(channels)
        else f"{len(channels)} bands"
    )


@functools.lru_cache(maxsize=16)
def channel_spectra(channels: tuple[str, ...]) -> Array:
    """Spectrum of one unit of each channel.

    R, G, B: basis(lambda) * D65(lambda), scaled so that (1, 1, 1) has a luminance
    of 1 cd m-2; then (1, 1, 1) has the colour of D65.  Bands: a box of height 1
    that ends half-way to the next band.

    Args:
        channels: ('R', 'G', 'B'), or two and more bands in rising order.

    Returns:
        A row for each channel on `WAVELENGTHS_NM`, float64, W m-2 sr-1 nm-1 per unit of the channel.

    Raises:
        ImageError: other channels.

    Source: Mallett and Yuksel, "Spectral Primary Decomposition for Rendering with
    sRGB Reflectance" (2019), from colour-science.
    """
    if is_rgb(channels):
        shapes = np.array([tables.table(tables.STANDARD)[f"basis_{letter}"] for letter in "rgb"])
        lit = shapes * illuminant("D65")
        return lit / luminance_of(lit.sum(axis=0))
    centres = [band_centre_nm(name) for name in channels]
    bands = [centre for centre in centres if centre is not None]
    if len(bands) < 2 or len(bands) < len(centres) or any(a >= b for a, b in itertools.pairwise(bands)):
        raise ImageError(
            f"channels {', '.join(channels)} are neither R, G, B nor two or more rising bands such as "
            f"{band_name(550.0)}"
        )
    centre = np.array(bands)
    middle = (centre[:-1] + centre[1:]) / 2
    edges = np.concatenate([[2 * centre[0] - middle[0]], middle, [2 * centre[-1] - middle[-1]]])
    below = np.clip(
        edges[1:, None] - (WAVELENGTHS_NM - 0.5), 0.0, 1.0
    )  # a sample stands for its own nanometre: partly covered at an edge
    return np.asarray(np.minimum(below, np.clip(WAVELENGTHS_NM + 0.5 - edges[:-1, None], 0.0, 1.0)))


@functools.lru_cache(maxsize=len(ILLUMINANTS))
def illuminant(name: str) -> Array:
    """Relative spectral power of a light of `ILLUMINANTS` on `WAVELENGTHS_NM`.

    Raises:
        ParameterError: another name.

    Source: CIE 015:2018, from colour-science.
    """
    if name not in ILLUMINANTS:
        raise ParameterError(
            f"illuminant {name!r} is not known; it can be {', '.join(ILLUMINANTS)}.{did_you_mean(name, ILLUMINANTS)}"
        )
    return tables.table(tables.STANDARD)[ILLUMINANTS[name]]


@functools.lru_cache(maxsize=1)
def observer() -> Array:
    """Rows x, y and z of the colour matching functions of the CIE 1931 observer on `WAVELENGTHS_NM`."""
    return np.array([tables.table(tables.STANDARD)[f"{axis}_bar"] for axis in "xyz"])


def luminance_of(spectrum: Array) -> float:
    """Luminance in nits of a spectral radiance [W m-2 sr-1 nm-1] on `WAVELENGTHS_NM`."""
    return LUMINOUS_EFFICACY_LM_W * float(np.sum(spectrum * observer()[1]))


def luminance(image: Image) -> npt.NDArray[np.float32]:
    """(H, W) luminance [cd m-2] of a radiance image."""
    weights = [luminance_of(spectrum) for spectrum in channel_spectra(image.channels)]
    return np.asarray(image.pixels @ np.array(weights, dtype=np.float32))

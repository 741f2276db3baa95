"""Spectra that are authored on lights and materials as `synfog:spectrum:*`.

Takes a prim; gives a spectrum on `photometry.WAVELENGTHS_NM`, or None with a
warning on a value that is no spectrum.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pxr import Usd

from synfog_usd.base import spectra
from synfog_usd.base.arrays import Array, Pixels
from synfog_usd.base.errors import ParameterError
from synfog_usd.scene import base_colour
from synfog_usd.translate.diagnostics import Diagnostics


def emission(prim: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics) -> Array | None:
    """Relative power of a light that names its spectrum, or None: its colour counts."""
    return _authored(prim, spectra.EMISSION, time, notes, spectra.emission, most=np.inf)


def reflectance(
    prim: Usd.Prim,
    bsdf: dict[str, Any],
    time: Usd.TimeCode,
    notes: Diagnostics,
    mean: Callable[[Mapping[str, Any]], tuple[float, float, float]],
) -> Array | None:
    """Reflectance of a material that names its spectrum, or None: the colour counts.

    Args:
        prim: the material.
        bsdf: as it is drawn; a spectrum takes the place of its base colour.  One that is named gets its tint, pairs are
            taken as they are.
        mean: `mean_colour`, or what remembers it.
    """
    if _value(prim, spectra.REFLECTANCE, time) is None:
        return None
    colour = base_colour(bsdf)
    if colour is None:
        notes.warn(
            prim.GetPath(),
            f"{spectra.REFLECTANCE} is not used: the material has no base colour of its own that is drawn",
        )
        return None

    return _authored(
        prim,
        spectra.REFLECTANCE,
        time,
        notes,
        lambda name: _named(name, mean(colour)),
        most=1.0,
    )


@functools.lru_cache(maxsize=1024)
def _named(name: str, colour: tuple[float, float, float]) -> Array:
    """A named reflectance in a material's own colour; solved once for all instances of a model."""
    curve = spectra.smooth(colour) if name == spectra.PAINT else spectra.tinted(spectra.reflectance(name), colour)
    curve.flags.writeable = False
    return curve


def _value(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> str | Pixels | None:
    """The authored value: a word, (N, 2) numbers, or an array of anything else; None for none."""
    attribute = prim.GetAttribute(name) or prim.GetAttribute(f"userProperties:{name}")
    value = attribute.Get(time) if attribute and attribute.HasAuthoredValue() else None
    if value is None or isinstance(value, str):
        return value or None
    return np.array(value)


def _authored(
    prim: Usd.Prim, name: str, time: Usd.TimeCode, notes: Diagnostics, named: Callable[[str], Array], *, most: float
) -> Array | None:
    value = _value(prim, name, time)
    if value is None:
        return None
    try:
        if isinstance(value, str):
            return named(value)
        if value.dtype.kind not in "fiu":
            raise ParameterError(f"{str(value)[:40]} is neither a name nor numbers")
        return spectra.spectrum_of_pairs(value, most=most)
    except ParameterError as error:
        notes.warn(
            prim.GetPath(),
            f"{name}: {error} Its colour is used instead."
            if str(error).endswith("?")
            else f"{name}: {error}; its colour is used instead",
        )
        return None

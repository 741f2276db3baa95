"""NaN and infinity on a stage, and colours that reflect more than all light, noted by prim and kept from the renderer.

Takes shapes, materials and emissions in the scene's words; gives the same with numbers that can be drawn.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from pxr import Usd

from synfog_usd.base.arrays import Array, FloatArray
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.shading import GREY

W = TypeVar("W")
Numbers = TypeVar("Numbers", Array, FloatArray)
ROUNDED = 1e-3
"""Distance of a share of light from 0 to 1 that is rounding, as of one colour space into another."""

_REPLACED: Mapping[str, tuple[str, tuple[float, ...]]] = MappingProxyType(
    {
        "normals": ("normals", (0.0, 0.0, 1.0)),
        "texcoords": ("texture coordinates", (0.0, 0.0)),
        "vertex_color": ("colours", GREY),
    }
)
"""Attributes of vertices, their names in notes, and what replaces a value that is not finite."""


def is_finite(value: object) -> bool:
    """Whether a value of USD holds no NaN and no infinity: a number, or several.

    >>> is_finite(1.0), is_finite((0.5, float("nan"))), is_finite("nan"), is_finite(None)
    (True, False, True, True)
    """
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, (bool, int, str)) or not hasattr(value, "__len__"):
        return True
    try:
        return bool(np.isfinite(np.asarray(value, dtype=np.float64)).all())
    except (TypeError, ValueError):  # of words
        return True


def tell_inputs(material: Usd.Prim, time: Usd.TimeCode, notes: Diagnostics) -> None:
    """Note each input of a material and of its shaders that is no number; `shader.value_of` takes its default."""
    for prim in Usd.PrimRange(material):
        for attribute in prim.GetAuthoredAttributes():
            value = attribute.Get(time)
            value = attribute.Get(Usd.TimeCode.EarliestTime()) if value is None else value
            if not is_finite(value):
                notes.warn(prim.GetPath(), f"{attribute.GetName()} is {value}, no finite number; its default is taken")


def of_shape(shape: dict[str, Any], path: str, notes: Diagnostics) -> dict[str, Any]:
    """A shape with finite numbers on its vertices."""
    return shape | {name: of_array(shape[name], name, path, notes) for name in _REPLACED if shape.get(name) is not None}


def of_array(values: Numbers, name: str, path: object, notes: Diagnostics) -> Numbers:
    """(N, C) of a shape's normals, texture coordinates or colours with finite numbers; the same array where all are."""
    if math.isfinite(float(np.sum(values, dtype=np.float64))):
        return reflected(values, path, notes) if name == "vertex_color" else values
    words, replacement = _REPLACED[name]
    bad = ~np.asarray(np.isfinite(values).all(axis=1))
    notes.warn(path, f"{int(bad.sum())} of its {words} are no finite numbers; {replacement} is taken")
    return np.where(bad[:, None], np.array(replacement, dtype=values.dtype), values)


def reflected(colours: Numbers, path: object, notes: Diagnostics) -> Numbers:
    """(N, 3) colours from 0 to 1, since nothing reflects more than it gets; the same array where all are."""
    least, most = (float(end) for end in (colours.min(initial=0.0), colours.max(initial=1.0)))
    if least >= 0.0 and most <= 1.0:
        return colours
    if least < -ROUNDED or most > 1.0 + ROUNDED:
        text = f"its colours go from {least:.4g} to {most:.4g}, and 0 to 1 can be drawn; what is outside is taken as 0 "
        notes.warn(path, f"{text}or 1")
    return np.clip(colours, 0.0, 1.0)


def of_words(part: W, number: float) -> W:
    """A BSDF or an emission in the scene's words, with `number` for NaN and infinity; the same object where there is
    neither.
    """
    result: Any = part
    if isinstance(part, dict):
        mended = {name: of_words(value, number) for name, value in part.items()}
        result = part if all(mended[name] is part[name] for name in part) else mended
    elif isinstance(part, list):
        listed = [of_words(value, number) for value in part]
        result = part if all(map(operator.is_, listed, part)) else listed
    elif isinstance(part, float) and not math.isfinite(part):
        result = number
    elif isinstance(part, np.ndarray) and part.dtype.kind == "f" and not np.isfinite(part.sum(dtype=np.float64)):
        result = np.where(np.isfinite(part), part, np.array(number, dtype=part.dtype))
    mended_part: W = result
    return mended_part

"""Shader prims: their kinds, the values of their inputs, and the outputs that feed these.

Takes shader prims; gives numbers, words and files.  A value that does not fit, is not finite
or is not there becomes the default that the caller names.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import Usd, UsdShade

from synfog_usd.translate.finite import is_finite


def shader_id(prim: Usd.Prim) -> str:
    """The node type of a shader prim, or ''."""
    attribute = prim.GetAttribute("info:id")
    return str(attribute.Get() or "") if attribute else ""


def producer(shader: UsdShade.Shader, name: str) -> Usd.Attribute | None:
    """The shader output that feeds an input, or None where it is a constant."""
    source = shader.GetInput(name)
    if not source:
        return None
    for attribute in UsdShade.Utils.GetValueProducingAttributes(source):
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Output:
            return attribute
    return None


def value_of(shader: UsdShade.Shader, name: str, time: Usd.TimeCode) -> Any:
    """Constant value of an input through its connections, whatever it is; None where there is none, or it holds NaN or
    infinity.
    """
    source = shader.GetInput(name)
    for attribute in UsdShade.Utils.GetValueProducingAttributes(source) if source else ():
        if UsdShade.Utils.GetType(attribute.GetName()) == UsdShade.AttributeType.Input:
            value = attribute.Get(time)
            if value is None:
                value = attribute.Get(Usd.TimeCode.EarliestTime())
            if value is not None:
                return value if is_finite(value) else None
    return None


def number_of(shader: UsdShade.Shader, name: str, time: Usd.TimeCode, default: float) -> float:
    """A number; of several their mean."""
    numbers = numbers_in(value_of(shader, name, time))
    return default if numbers is None else sum(numbers) / len(numbers)


def flag_of(shader: UsdShade.Shader, name: str, time: Usd.TimeCode) -> bool:
    """Whether a switch is on; off where nothing is authored."""
    value = value_of(shader, name, time)
    return isinstance(value, (str, int, float)) and bool(value)


def word_of(shader: UsdShade.Shader, name: str, time: Usd.TimeCode, default: str) -> str:
    """A word, or a whole number as a word."""
    value = value_of(shader, name, time)
    return str(value) if isinstance(value, (str, int)) else default


def file_of(shader: UsdShade.Shader, name: str, time: Usd.TimeCode) -> tuple[str, str]:
    """The file of an asset input as it is authored, and where it was found; '' for none."""
    asset = value_of(shader, name, time)
    return getattr(asset, "path", "") or "", getattr(asset, "resolvedPath", "") or ""


def numbers_of(shader: UsdShade.Shader, name: str, time: Usd.TimeCode, default: Sequence[float]) -> tuple[float, ...]:
    """As many numbers as the default has, see `fitted`."""
    return fitted(numbers_in(value_of(shader, name, time)), tuple(default))


def fitted(numbers: tuple[float, ...] | None, default: tuple[float, ...]) -> tuple[float, ...]:
    """As many numbers as `default` has: one stands for the first three, a missing alpha is the default's; fewer than
    three do not fit.

    >>> fitted((0.5, 0.25, 0.75, 1.0), (0.0, 0.0, 0.0)), fitted((0.5,), (0.0, 0.0, 0.0, 1.0)), fitted(None, (2.0,))
    ((0.5, 0.25, 0.75), (0.5, 0.5, 0.5, 1.0), (2.0,))
    """
    if numbers is None:
        return default
    count = len(default)
    if len(numbers) == 1:
        numbers = numbers * min(count, 3)
    if len(numbers) < min(count, 3):
        return default
    return numbers[:count] + default[len(numbers) :]


def numbers_in(value: Any) -> tuple[float, ...] | None:
    """The numbers of a value of USD in their order; None of what holds none."""
    if isinstance(value, str) or value is None:
        return None
    try:
        numbers = np.asarray(value, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        return None
    return tuple(numbers.tolist()) if len(numbers) else None

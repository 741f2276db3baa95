"""Inputs of a light as numbers, words and files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pxr import Sdf, Usd


class LightInputs:
    """Inputs of a light, also without the 'inputs:' of files before 21.02."""

    def __init__(self, prim: Usd.Prim, time: Usd.TimeCode) -> None:
        self.prim, self.time = prim, time
        self._positive: dict[str, float] = {}

    def turn_positive(self, names: Sequence[str], warn: Callable[[Sdf.Path, str], None]) -> None:
        """Take the amounts of sizes that are negative, with a warning each."""
        for name in names:
            if (value := self.number(name, 0.0)) < 0.0:
                self._positive[name] = -value
                warn(self.prim.GetPath(), f"inputs:{name} is {value:g}, which is no size; {-value:g} is taken")

    def value(self, name: str) -> Any:
        """What is authored, whatever it is; None for nothing."""
        for full_name in (f"inputs:{name}", name):
            attribute = self.prim.GetAttribute(full_name)
            if attribute and attribute.HasAuthoredValue():
                value = attribute.Get(self.time)
                value = attribute.Get(Usd.TimeCode.EarliestTime()) if value is None else value
                if value is not None:
                    return value
        return None

    def number(self, name: str, default: float) -> float:
        """One number; of a wrong type raises TypeError, which names the attribute."""
        if name in self._positive:
            return self._positive[name]
        value = self.value(name)
        return default if value is None else float(value)

    def numbers(self, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """Several numbers, as of a colour."""
        value = self.value(name)
        return default if value is None else tuple(float(part) for part in value)

    def flag(self, name: str, *, default: bool = False) -> bool:
        """Whether a switch is on."""
        value = self.value(name)
        return default if value is None else bool(value)

    def word(self, name: str, default: str) -> str:
        """A word."""
        value = self.value(name)
        return default if value is None else str(value)

    def file(self, name: str) -> tuple[str, str]:
        """A file as it is authored, and where it was found; '' for none."""
        asset = self.value(name)
        return getattr(asset, "path", "") or "", getattr(asset, "resolvedPath", "") or ""

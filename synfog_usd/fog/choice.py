"""Fog that somebody asks for, over what a stage has.

A `Fog` and its name say the same: `Fog(150, g=0.8)` is `mor150_g0.8`, as the command line, sets and folders have it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

from synfog_usd.base import numbers
from synfog_usd.base.errors import ParameterError
from synfog_usd.fog.medium import WMO_CONTRAST, FogMedium, extinction_from_visibility
from synfog_usd.fog.phase import Droplets, Phase, Tabulated

CLEAR = "clear"
PHASES = ("hg", "droplets", "mie")
PROFILES = ("uniform", "exponential")
WORDS = {
    word: {"diameter": "droplet_diameter_um", "scale": "scale_height_m"}.get(word, word) for word in numbers.FOG_WORDS
}
"""What stands in a name -> attribute of `Fog`."""


@dataclass(frozen=True)
class Fog:
    """Fog in which one sees `mor_m` metres.

    What is left out stays as the stage's outermost fog has it, or is the fog schema's default where the stage has none.

    Attributes:
        mor_m: meteorological optical range [m], 0.03 and more; infinite for clear air.
        albedo: single-scattering albedo [1], 0 to 1.
        g: mean cosine of the phase function `hg` [1], -1 to 1, forward positive.
        phase: 'hg' (Henyey-Greenstein), 'droplets' (Jendersie and d'Eon 2023) or 'mie' (needs miepython).
        droplet_diameter_um: diameter of the droplets [um], within `DROPLETS_UM` or `MIE_UM` of `fog.phase`.
        angstrom: exponent [1] by which fog is thinner for longer wavelengths, -1 to 5.
        profile: 'uniform', or 'exponential' in height; exponential where a scale height is given.
        scale_height_m: height [m] over which the fog thins by e.

    Raises:
        ParameterError: a value outside these ranges, or values that do not go together.

    >>> Fog(150, g=0.8).name, Fog.named("mor150_g0.8") == Fog(150, g=0.8)
    ('mor150_g0.8', True)
    """

    mor_m: float
    albedo: float | None = None
    g: float | None = None
    phase: Literal["hg", "droplets", "mie"] | None = None
    droplet_diameter_um: float | None = None
    angstrom: float | None = None
    profile: Literal["uniform", "exponential"] | None = None
    scale_height_m: float | None = None

    def __post_init__(self) -> None:
        for word, name in {"mor": "mor_m", **WORDS}.items():
            if name not in ("phase", "profile") and getattr(self, name) is not None:
                object.__setattr__(self, name, _number(f"fog: {name}", getattr(self, name), inf=word == "mor"))
        for name, allowed in (("phase", PHASES), ("profile", PROFILES)):
            if getattr(self, name) not in (None, *allowed):
                raise ParameterError(f"fog: {name} {getattr(self, name)!r}: it takes {', '.join(allowed)}")
        numbers.check_visibility(f"mor{self.mor_m:g}", self.mor_m)
        if (self.phase in ("droplets", "mie")) != (self.droplet_diameter_um is not None):
            raise ParameterError("fog: phase 'droplets' and 'mie' need droplet_diameter_um [um], and no other takes it")
        if self.g is not None and self.phase not in (None, "hg"):
            raise ParameterError(f"fog: g is Henyey-Greenstein's; phase {self.phase!r} is shaped by its droplets")
        if not self.clear:
            self.over(FogMedium(1.0))

    @property
    def clear(self) -> bool:
        """Whether it is clear air."""
        return math.isinf(self.mor_m)

    @property
    def name(self) -> str:
        """Its name: 'clear', 'mor150', 'mor150_g0.8'."""
        values = {word: getattr(self, name) for word, name in WORDS.items()}
        more = (f"_{word}{_plain(value)}" for word, value in values.items() if value is not None)
        return CLEAR if self.clear else f"mor{_plain(self.mor_m)}{''.join(more)}"

    @classmethod
    def named(cls, name: str) -> Fog | None:
        """The fog of a name; None where it is no such name.

        Raises:
            ParameterError: as `Fog` does.
        """
        if name == CLEAR:
            return cls(math.inf)
        if (parts := numbers.fog_words(name)) is None:
            return None
        mor_m, words = parts
        values: dict[str, Any] = {WORDS[word]: value for word, value in words.items()}
        for key, value in values.items():
            values[key] = value if key in ("phase", "profile") else _number(f"--fog {name}:", value)
        return cls(mor_m, **values)

    def over(self, medium: FogMedium) -> FogMedium:
        """The fog in a boundary whose own is `medium`; it is not clear air."""
        values = {name: getattr(self, name) for name in ("albedo", "g", "angstrom", "profile", "scale_height_m")}
        changes: dict[str, Any] = {name: value for name, value in values.items() if value is not None}
        if self.scale_height_m is not None:
            changes["profile"] = self.profile or "exponential"
        if self.phase is not None or self.g is not None:
            changes["phase"] = self._phase
        if "profile" in changes:
            changes["grid"] = None
        sigma_t = float(extinction_from_visibility(self.mor_m))
        return replace(medium, sigma_t_per_m=sigma_t, contrast=WMO_CONTRAST, **changes)

    @property
    def _phase(self) -> Phase | None:
        if self.droplet_diameter_um is None:
            return None
        if self.phase == "droplets":
            return Droplets(self.droplet_diameter_um)
        return Tabulated.mie(self.droplet_diameter_um)


def _number(what: str, value: float | str, *, inf: bool = False) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if math.isnan(number) or (math.isinf(number) and not inf):
        raise ParameterError(f"{what} {value!r}: not a number")
    return number


def _plain(value: float | str) -> str:
    """Digits without an exponent, as names of folders have them."""
    if isinstance(value, str):
        return value
    return f"{value:.10f}".rstrip("0").rstrip(".")

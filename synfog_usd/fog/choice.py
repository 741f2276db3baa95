"""Fog, or other weather, that somebody asks for, over what a stage has.

A `Fog` and its name say the same: `Fog(150, g=0.8)` is `mor150_g0.8`, as the command line, sets and folders have it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

from synfog_usd.base import numbers
from synfog_usd.base.errors import ParameterError
from synfog_usd.fog.kinds import FOG, KINDS, joined, medium_of
from synfog_usd.fog.medium import WMO_CONTRAST, FogMedium, extinction_from_visibility
from synfog_usd.fog.patchy import patchy
from synfog_usd.fog.phase import Droplets, Phase, Tabulated

CLEAR = "clear"
PHASES = ("hg", "droplets", "mie")
PROFILES = ("uniform", "exponential")
_LONGER = {"diameter": "droplet_diameter_um", "scale": "scale_height_m", "patch": "outer_scale_m"}
WORDS = {word: _LONGER.get(word, word) for word in numbers.FOG_WORDS}
"""What stands in a name -> attribute of `Fog`."""


@dataclass(frozen=True)
class Fog:
    """Fog in which one sees `mor_m` metres, or another medium, or several in one place.

    What is left out stays as the stage's outermost fog has it, or is the fog schema's default where the stage has none.

    Attributes:
        mor_m: meteorological optical range [m], 0.03 and more; infinite for clear air, None for rain and snow.
        albedo: single-scattering albedo [1], 0 to 1.
        g: mean cosine of the phase function `hg` [1], -1 to 1, forward positive.
        phase: 'hg' (Henyey-Greenstein), 'droplets' (Jendersie and d'Eon 2023) or 'mie' (needs miepython).
        droplet_diameter_um: diameter of the droplets [um], within `DROPLETS_UM` or `MIE_UM` of `fog.phase`.
        angstrom: exponent [1] by which fog is thinner for longer wavelengths, -1 to 5.
        profile: 'uniform', or 'exponential' in height; exponential where a scale height is given.
        scale_height_m: height [m] over which the fog thins by e.
        outer_scale_m: of patches [m], 0.5 to 1000, see `fog.patchy`; `mor_m` is then the mean fog's.
        deviation: of patches, standard deviation of the density over its mean [1], 0 to 2; 0.5 where left out.
        seed: of patches, 0 or more; 0 where left out.
        kind: 'haze', 'mist', 'smoke', 'dust', 'spray', 'rain' or 'snow', whose tables say where it sends light; None
            for fog.
        rate_mm_h: of rain or snow [mm/h of water], 0.01 to 1000.
        also: what else is in the same place, as rain in haze.

    Raises:
        ParameterError: a value outside these ranges, or values that do not go together.

    >>> Fog(150, g=0.8).name, Fog.named("mor150_g0.8") == Fog(150, g=0.8)
    ('mor150_g0.8', True)
    >>> Fog(kind="rain", rate_mm_h=10, also=(Fog(400),)).name
    'rain10+mor400'
    """

    mor_m: float | None = None
    albedo: float | None = None
    g: float | None = None
    phase: Literal["hg", "droplets", "mie"] | None = None
    droplet_diameter_um: float | None = None
    angstrom: float | None = None
    profile: Literal["uniform", "exponential"] | None = None
    scale_height_m: float | None = None
    outer_scale_m: float | None = None
    deviation: float | None = None
    seed: int | None = None
    kind: Literal["haze", "mist", "smoke", "dust", "spray", "rain", "snow"] | None = None
    rate_mm_h: float | None = None
    also: tuple[Fog, ...] = ()

    def __post_init__(self) -> None:
        self._check_kind()
        for word, name in {"mor": "mor_m", "rate": "rate_mm_h", **WORDS}.items():
            if name not in ("phase", "profile") and getattr(self, name) is not None:
                object.__setattr__(self, name, _number(f"fog: {name}", getattr(self, name), inf=word == "mor"))
        for name, allowed in (("phase", PHASES), ("profile", PROFILES)):
            if getattr(self, name) not in (None, *allowed):
                raise ParameterError(f"fog: {name} {getattr(self, name)!r}: it takes {', '.join(allowed)}")
        if self.mor_m is not None:
            numbers.check_visibility(f"mor{self.mor_m:g}", self.mor_m)
        if (self.phase in ("droplets", "mie")) != (self.droplet_diameter_um is not None):
            raise ParameterError("fog: phase 'droplets' and 'mie' need droplet_diameter_um [um], and no other takes it")
        if self.g is not None and self.phase not in (None, "hg"):
            raise ParameterError(f"fog: g is Henyey-Greenstein's; phase {self.phase!r} is shaped by its droplets")
        self._check_patches()
        if not self.clear:
            self.over(FogMedium(1.0))

    def _check_patches(self) -> None:
        if self.outer_scale_m is None and (self.deviation, self.seed) != (None, None):
            raise ParameterError(
                "fog: deviation and seed are of patches, which have an outer scale, as in mor150_patch8"
            )
        if self.outer_scale_m is not None and (self.profile, self.scale_height_m) != (None, None):
            raise ParameterError("fog: patches are the same at all heights; leave out the profile and the scale height")
        if self.seed is not None:
            if self.seed != int(self.seed):
                raise ParameterError(f"fog: seed {self.seed:g}: not a whole number")
            object.__setattr__(self, "seed", int(self.seed))

    def _check_kind(self) -> None:
        if self.kind not in (None, *KINDS) or self.kind == FOG:
            kinds = ", ".join(name for name in KINDS if name != FOG)
            raise ParameterError(f"fog: kind {self.kind!r}: it takes {kinds}, or None for fog")
        rated = self.kind is not None and KINDS[self.kind].rated
        if (self.mor_m is None) != rated or (self.rate_mm_h is None) == rated:
            raise ParameterError("fog: rain and snow take rate_mm_h [mm/h], and all else takes mor_m [m]")
        shaped = [name for name in ("albedo", "g", "phase", "angstrom") if getattr(self, name) is not None]
        if self.kind is not None and shaped:
            raise ParameterError(f"fog: {shaped[0]} is fog's; {self.kind} takes it from its table")
        if any(fog.clear or fog.also for fog in self.also) or (self.also and self.clear):
            raise ParameterError("fog: `also` has media that are not clear, each alone")

    @property
    def clear(self) -> bool:
        """Whether it is clear air."""
        return self.mor_m is not None and math.isinf(self.mor_m)

    @property
    def kinds(self) -> list[tuple[str | None, float | None]]:
        """Kind and rate [mm/h] of each medium in it."""
        return [(medium.kind, medium.rate_mm_h) for medium in (self, *self.also)]

    @property
    def rates(self) -> dict[str, float]:
        """'rain', 'snow' -> rate of what falls [mm/h of water]."""
        return {fog.kind: fog.rate_mm_h for fog in (self, *self.also) if fog.kind and fog.rate_mm_h is not None}

    @property
    def name(self) -> str:
        """Its name: 'clear', 'mor150', 'mor150_g0.8', 'rain10+mor400'."""
        if self.clear:
            return CLEAR
        values = {word: getattr(self, name) for word, name in WORDS.items()}
        more = "".join(f"_{word}{_plain(value)}" for word, value in values.items() if value is not None)
        number = self.mor_m if self.rate_mm_h is None else self.rate_mm_h
        assert number is not None
        return "+".join([f"{self.kind or 'mor'}{_plain(number)}{more}", *(fog.name for fog in self.also)])

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
        media = []
        for kind, number, words in parts:
            values: dict[str, Any] = {WORDS[word]: value for word, value in words.items()}
            for key, value in values.items():
                values[key] = value if key in ("phase", "profile") else _number(f"--fog {name}:", value)
            values["rate_mm_h" if kind in numbers.RATED else "mor_m"] = number
            media.append(cls(kind=None if kind == "mor" else kind, **values))  # type: ignore[arg-type]
        try:
            return replace(media[0], also=tuple(media[1:]))
        except ParameterError as problem:
            raise ParameterError(f"--fog {name}: {problem}") from problem

    def over(self, medium: FogMedium) -> FogMedium:
        """The fog in a boundary whose own is `medium`; it is not clear air."""
        return joined([fog._alone(medium) for fog in (self, *self.also)])

    def _alone(self, medium: FogMedium) -> FogMedium:
        values = {name: getattr(self, name) for name in ("albedo", "g", "angstrom", "profile", "scale_height_m")}
        changes: dict[str, Any] = {name: value for name, value in values.items() if value is not None}
        if self.scale_height_m is not None:
            changes["profile"] = self.profile or "exponential"
        if self.phase is not None or self.g is not None:
            changes["phase"] = self._phase
        if "profile" in changes:
            changes["grid"] = None
        if self.outer_scale_m is not None:
            deviation = 0.5 if self.deviation is None else self.deviation
            changes |= {"profile": "grid", "grid": patchy(self.outer_scale_m, deviation, seed=self.seed or 0)}
        if "albedo" in changes or "angstrom" in changes:
            changes["colours"] = None
        if self.kind is None:
            assert self.mor_m is not None
            sigma_t = float(extinction_from_visibility(self.mor_m))
            return replace(medium, sigma_t_per_m=sigma_t, contrast=WMO_CONTRAST, falls=(), **changes)
        of_kind = medium_of(self.kind, mor_m=self.mor_m, rate_mm_h=self.rate_mm_h)
        names = ("sigma_t_per_m", "albedo", "phase", "colours", "angstrom", "contrast", "falls")
        return replace(medium, **{name: getattr(of_kind, name) for name in names}, **changes)

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

"""What a bake will make: one shot for every lighting and fog."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

from synfog_usd.base import numbers
from synfog_usd.base.errors import ParameterError, did_you_mean

if TYPE_CHECKING:
    from synfog_usd.fog import Fog

AS_AUTHORED = "authored"
"""Name of the lighting or fog that a stage has where none of its variants is chosen, as where it has none."""

CLEAR = "clear"

TOGETHER, EACH = METERS = ("together", "each")
"""How the cameras of a rig are exposed."""


MOST_FRAMES = 100_000
"""Of a sequence."""

MOST_UNASKED = 1000
"""Shots of a stage whose lightings or fogs nobody has named: an hour and more, if each took but four seconds."""


class Metered(TypedDict):
    """What was metered on a frame of a clip, as `bake.json` has it: the frame's number, and `camera.Exposure`."""

    frame: int
    exposure_s: float
    iso: float
    mean_cd_m2: float
    limit: Literal["none", "bright", "dark"]


@dataclass(frozen=True)
class ClipFrame:
    """A frame of a sequence.

    Attributes:
        number: of the frame, from 0 on.
        per_s: frames a second.
        adaptation_s: time constant of the automatic exposure [s]; 0 for one that follows without delay.
        before: lighting -> (exposure time [s], ISO) of the frame before; empty for the first.
        metered: lighting -> what was metered last; empty for a frame that is metered itself.
        kept: folder of a shot -> rounds of samples of the frame before, see `Settings.kept`; empty for the first.
    """

    number: int
    per_s: float
    adaptation_s: float
    before: Mapping[str, tuple[float, float]]
    metered: Mapping[str, Metered]
    kept: Mapping[str, Sequence[Mapping[str, int]]]


def frame_codes(text: str) -> tuple[float, ...]:
    """Time codes of FIRST, FIRST:LAST or FIRST:LASTxSTEP, both ends included, as usdrecord takes them.

    Raises:
        ParameterError: the text is none of these, or stands for more than `MOST_FRAMES`.

    >>> frame_codes("0:3"), frame_codes("10:11x0.5"), frame_codes("2:0x-1"), frame_codes("12")
    ((0.0, 1.0, 2.0, 3.0), (10.0, 10.5, 11.0), (2.0, 1.0, 0.0), (12.0,))
    """
    number = r"(-?\d+(?:\.\d+)?)"
    match = re.fullmatch(f"{number}(?::{number}(?:x{number})?)?", text.strip())
    if match is None:
        raise ParameterError(
            f"--frames {text}: it takes one time code, FIRST:LAST or FIRST:LASTxSTEP, as in 12, 0:90 or 0:90x2"
        )
    first = float(match[1])
    last = float(match[2] or first)
    step = float(match[3] or (1 if last >= first else -1))
    count = int((last - first) / step + 1e-9) + 1 if step else 0
    if not 1 <= count <= MOST_FRAMES or (last - first) * step < 0.0:
        raise ParameterError(f"--frames {text}: this is no frame, or more than {MOST_FRAMES}")
    return tuple(first + step * index for index in range(count))


@dataclass(frozen=True, kw_only=True)
class StageReading:
    """How a stage is read otherwise than it says of itself.

    Attributes:
        lights: how the stage's intensities are meant, see `translate.translate`.
        light_scale: what all lights are multiplied by.
        shutter_s: time [s] for which the shutter is open, about the frame's own; None is the camera's.
        choices, metres_per_unit, up: see `stage.override`.
        allow: folders outside the stage's own in which its files may lie.
    """

    lights: str = "auto"
    light_scale: float = 1.0
    shutter_s: float | None = None
    choices: tuple[str, ...] = ()
    metres_per_unit: float | None = None
    up: str | None = None
    allow: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        numbers.check_range("--light-scale", self.light_scale)
        numbers.check_space(metres_per_unit=self.metres_per_unit, up=self.up)
        numbers.check_range("--shutter", self.shutter_s)


@dataclass(frozen=True, kw_only=True)
class Exposing:
    """How a camera is exposed.

    Attributes:
        exposure_s, iso: exposure time [s] and ISO speed instead of what the camera's graph has or its meter finds.
        ev: by how many stops the pictures are exposed brighter than the meter says.
        meter: whether a rig's cameras are exposed `together`, by what all of them see, or `each` by itself.
        meter_for: further node graphs that are to develop the radiance: how they would expose stands in `bake.json`,
            and where drops fall, light with their streaks in `<name>/radiance.exr`.
    """

    exposure_s: float | None = None
    iso: float | None = None
    ev: float = 0.0
    meter: str = TOGETHER
    meter_for: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        if self.meter not in METERS:
            raise ParameterError(f"--meter {self.meter}: takes {' or '.join(METERS)}")
        numbers.check_exposure(exposure_s=self.exposure_s, iso=self.iso, ev=self.ev)

    @property
    def is_said(self) -> bool:
        """Whether exposure time or ISO speed is given."""
        return (self.exposure_s, self.iso) != (None, None)


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How good pictures are to be.

    Attributes:
        quality: a word of `numbers.QUALITIES`: when sampling stops, and whether pictures are denoised.
        model, samples, target_error, bands: see `render.shot.Settings`. Samples are the quality's where None; a target
            error replaces its target.
        variant: Mitsuba backend, see `render.backend.choose`.
        draft: for a look alone: without labels or what is left of errors, metered on half of the paths, as they are,
            and denoised in a part of the time, see `render.denoise.denoise_draft`.
    """

    quality: str = numbers.STANDARD
    model: str = "auto"
    samples: int | None = None
    target_error: float | None = None
    bands: int = numbers.RGB
    variant: str = "auto"
    draft: bool = False

    def __post_init__(self) -> None:
        numbers.check_quality(self.quality)
        if self.samples is None:  # the record is frozen, and is whole from here on
            object.__setattr__(self, "samples", self.promise.samples)
        numbers.check_range("--samples", self.samples)
        numbers.check_range("--target-error", self.target_error)
        numbers.check_bands(self.bands)

    @property
    def promise(self) -> numbers.Quality:
        """What its quality promises."""
        return numbers.QUALITIES[self.quality]


@dataclass(frozen=True)
class BakePlan:
    """Everything that decides what a bake writes; its numbers are checked when it is made.

    Attributes:
        stage: the USD file.
        out: folder that receives everything.
        pipeline: YAML node graph; None is the shipped phone.
        lighting, fog: names to bake; None is all that the stage offers, and AS_AUTHORED what it has without a choice.
        camera: prim path or name; None is the stage's own choice.
        rig: paths or names of the cameras of the rig to which it belongs, itself among them, '' for the stage's own:
            they see one world, about the place of the first.  Empty for a camera by itself.
        frame: time code; None is the stage's start.
        size: (width, height) in pixels; None is the stage's own.
        sampling, reads, exposes: how good the pictures are, how the stage is read, how the camera is exposed.
        seed: of all that is drawn.
        sampling_seed: of the light's paths, which all frames of a stage have in common, so that what sampling leaves of
            noise does not flicker; None for `seed`.
        strict: whether a warning of the translation stops the bake.
        clip: what frame of a sequence it is, or None.
        by_lighting: whether each lighting has a folder for its fogs; without, fogs lie in `out` itself.
        same_noise: whether all fogs of a lighting have the temporal noise of its clear frame, instead of their own.
    """

    stage: Path
    out: Path
    pipeline: Path | None = None
    lighting: tuple[str, ...] | None = None
    fog: tuple[str, ...] | None = None
    camera: str | None = None
    frame: float | None = None
    size: tuple[int, int] | None = None
    sampling: Sampling = Sampling()
    reads: StageReading = StageReading()
    exposes: Exposing = Exposing()
    seed: int = 0
    sampling_seed: int | None = None
    strict: bool = False
    clip: ClipFrame | None = None
    by_lighting: bool = True
    same_noise: bool = False
    rig: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        numbers.check_range("--frame", self.frame)
        for name in self.fog or ():
            if (metres := visibility_of(name)) is not None:
                numbers.check_visibility(name, metres)

    @property
    def paths(self) -> int:
        """Seed of the light's paths."""
        return self.seed if self.sampling_seed is None else self.sampling_seed


def noise_seed(seed: int, lighting: str, fog: str, *, same_noise: bool = False) -> int:
    """Seed of a shot's temporal noise; one for all fogs of a lighting where they are to have the same."""
    from synfog_usd.base.seeds import seed32  # numpy, which a plan that is refused does without

    return seed32(seed, lighting, CLEAR if same_noise else fog)


@dataclass(frozen=True)
class Shot:
    """One lighting in one fog.

    Attributes:
        lighting, fog: variant names, or AS_AUTHORED.
        lighting_variant, fog_variant: the stage's variants to select, or None.
        fog_override: fog over the stage's own, or None.
        by_lighting: see `BakePlan`.
    """

    lighting: str
    fog: str
    lighting_variant: str | None
    fog_variant: str | None
    fog_override: Fog | None = None
    by_lighting: bool = True

    @property
    def folder(self) -> str:
        """Where its files lie, relative to the output folder."""
        return f"{self.lighting}/{self.fog}" if self.by_lighting else self.fog


def shots(plan: BakePlan, variants: Mapping[str, Sequence[str]]) -> tuple[Shot, ...]:
    """Every lighting x fog of a plan.

    Args:
        plan: what was asked for.
        variants: names that the stage offers, by set ('fog', 'lighting').

    Raises:
        ParameterError: a name that neither the stage nor the tool knows, several lightings in one folder, or more than
            `MOST_UNASKED` shots.
    """
    from synfog_usd.fog import Fog  # numpy, which a plan that is refused does without

    lights = _chosen("lighting", plan.lighting, variants.get("lighting", ()))
    if len(lights) > 1 and not plan.by_lighting:
        raise ParameterError(f"{plan.out}: {len(lights)} lightings need folders of their own")
    fogs = _chosen("fog", plan.fog, variants.get("fog", ()))
    if None in (plan.lighting, plan.fog) and len(lights) * len(fogs) > MOST_UNASKED:
        named = f"--lighting {lights[0]} --fog {fogs[0]}"
        raise ParameterError(
            f"{plan.stage}: {len(lights)} lightings in {len(fogs)} fogs are {len(lights) * len(fogs)} shots, and more "
            f"than {MOST_UNASKED} are made only where all are named: say which, as in {named}"
        )
    result = []
    for lighting in lights:
        for fog in fogs:
            lit = lighting in variants.get("lighting", ())
            variant = next((name for name in (fog, numbers.variant_of(fog)) if name in variants.get("fog", ())), None)
            override = None if variant else Fog.named(fog)
            result.append(Shot(lighting, fog, lighting if lit else None, variant, override, plan.by_lighting))
    folders: dict[str, str] = {}
    for shot in result:
        if folders.setdefault(shot.folder.casefold(), shot.folder) != shot.folder:
            raise ParameterError(
                f"{plan.stage}: {folders[shot.folder.casefold()]} and {shot.folder} differ by case alone, and on some "
                f"systems lie in one folder; rename a variant, or bake them apart by --fog and --lighting"
            )
    return tuple(result)


def _chosen(kind: str, names: Sequence[str] | None, offered: Sequence[str]) -> list[str]:
    if names is None:
        return offered_names(offered)
    for name in names:
        if name in (*offered, AS_AUTHORED) or (kind == "fog" and visibility_of(name) is not None):
            continue
        fault = f"{why}; " if kind == "fog" and (why := numbers.fog_fault(name)) else ""
        allowed = ", ".join(offered) or f"no variant set {kind!r}"
        extra = ", clear, mor<metres>, rain<mm/h>, or others of docs/weather.md" if kind == "fog" else ""
        raise ParameterError(
            f"--{kind} {name}: {fault}the stage has {allowed}; it also takes {AS_AUTHORED}, for what it has "
            f"without a choice{extra}.{did_you_mean(name, (*offered, AS_AUTHORED))}"
        )
    return list(dict.fromkeys(names))


def offered_names(variants: Sequence[str]) -> list[str]:
    """The lightings or fogs of a stage in a bake's order: its variants, or AS_AUTHORED where it has none.

    >>> offered_names(["active", "sky"]), offered_names([])
    (['sky', 'active'], ['authored'])
    """
    return sorted(variants, key=_thinnest_first) or [AS_AUTHORED]


def _thinnest_first(name: str) -> tuple[float, bool, str]:
    """Clear air, then fog from thin to dense, then what has no visibility in its name; sky light before other light."""
    visibility = visibility_of(name)
    return (-visibility if visibility else 0.0, name != "sky", name)


def visibility_of(name: str) -> float | None:
    """Least visibility [m] that a fog's name says to any stage, inf for clear air or rain; None of a variant's name.

    >>> visibility_of("mor150"), visibility_of("clear"), visibility_of("dense")
    (150.0, inf, None)
    """
    if name == CLEAR:
        return float("inf")
    if (parts := numbers.fog_words(name)) is None:
        return None
    return min((number for kind, number, _ in parts if kind not in numbers.RATED), default=float("inf"))

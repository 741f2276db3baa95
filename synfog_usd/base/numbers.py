"""Ranges of what a render may be asked for, for the command line and for the renderer.

Takes numbers, or the text in which they are typed; raises for those out of range, in the words of the command line.
Imports nothing heavy.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from synfog_usd.base.errors import ParameterError, did_you_mean

SAMPLES = (2, 1 << 20)
"""Paths per pixel; one has no variance."""


@dataclass(frozen=True)
class Quality:
    """What a bake promises of its pictures.

    Attributes:
        promise: in words.
        samples: paths per pixel at most.
        error: relative error of the median pixel to stop at; None where samples or the sensor alone decide.
        mottle: clouds that may be left, see `render.dualbuffer.mottle`; None likewise.
        sensor: whether to stop where the sensor's noise hides what is left.
        clean: whether pictures are denoised and mirrors before lamps regularized, see `render.shot.Settings`; without
            both a picture converges to the truth.
    """

    promise: str
    samples: int
    error: float | None = None
    mottle: float | None = None
    sensor: bool = False
    clean: bool = True


QUALITIES = {
    "draft": Quality("composition and light can be judged", samples=4, mottle=0.02),
    "standard": Quality("nothing that a person sees at full size", samples=64, error=0.06, mottle=0.01),
    "sensor": Quality("a RAW deviates at most 1.15 times what its sensor does", samples=128, sensor=True),
    "reference": Quality("neither denoised nor regularized: it converges to the truth", samples=1024, clean=False),
}
"""By name, cheapest first."""

STANDARD = "standard"

RGB = 3
"""Channels of a path that carries no wavelength bands."""

BANDS = (8, 16, 31)
"""Numbers of wavelength bands that there are."""

LEAST_MOR_M = 0.03
"""Visibility [m] of the densest fog, with an extinction of 100 1/m."""

RATES_MM_H = (0.01, 1000.0)
"""Rates [mm/h of water] of rain and snow: from drizzle's edge to three times the heaviest rain in an hour."""

FOG_WORDS = ("albedo", "g", "phase", "diameter", "angstrom", "profile", "scale", "patch", "deviation", "seed")
"""What may stand behind the visibility in a fog's name, as in mor150_g0.8."""

MEDIA = ("mor", "haze", "mist", "smoke", "dust", "spray", "rain", "snow")
"""How the name of a medium begins, before its visibility [m]; mor is fog."""

RATED = ("rain", "snow")
"""Media whose names have a rate [mm/h of water] instead."""

_FOG = re.compile(rf"({'|'.join(MEDIA)})(\d+(?:\.\d+)?)((?:_(?:{'|'.join(FOG_WORDS)})-?[a-z\d.]+)*)")
_LIKE_FOG = re.compile(r"([A-Za-z]+)([-.\d][^_]*)?((?:_.*)?)")

UNITS_M = (1e-6, 1e3)
"""Lengths of a stage's unit [m]: from micrometres to kilometres."""

MOST_EV = 10.0
"""Of stops by which a meter's exposure is changed."""

RANGES = {
    "--samples": (*SAMPLES, "16 are a draft, 1024 are clean in dense fog"),
    "--target-error": (0.0, 1.0, "0.01 is 1 %"),
    "--light-scale": (0.0, 1e12, "leave it out for the lights as they are"),
    "--shutter": (0.0, 60.0, "it takes seconds"),
    "--fps": (1.0, 240.0, "10 frames a second are usual"),
    "--seconds": (0.0, 120.0, "each second is 10 frames, if --fps is left out"),
    "--frame": (-1e300, 1e300, "it takes a time code of the stage"),
}
"""Option -> its least, its most, and what helps to choose."""


def check_range(option: str, value: float | None) -> None:
    """Refuse a number out of `RANGES`, and 0 where 0 is the least; None is an option that is left out.

    Raises:
        ParameterError: with the range.
    """
    low, high, advice = RANGES[option]
    if value is not None and not (low <= value <= high and (value or low)):
        raise ParameterError(f"{option} {value:.9g}: outside {low:.9g} to {high:.9g}; {advice}")


def check_quality(name: object, option: str = "--quality") -> None:
    """Refuse a quality that does not exist.

    Raises:
        ParameterError: with those that do.
    """
    if not isinstance(name, str) or name not in QUALITIES:
        raise ParameterError(
            f"{option} {name}: not known; it takes {', '.join(QUALITIES)}.{did_you_mean(str(name), tuple(QUALITIES))}"
        )


def check_bands(count: int) -> None:
    """Refuse a number of bands that does not exist.

    Raises:
        ParameterError: with those that do.
    """
    if count not in (RGB, *BANDS):
        raise ParameterError(f"--bands {count}: it takes {RGB} (R, G and B), {', '.join(map(str, BANDS))}")


def fog_words(name: str) -> list[tuple[str, float, dict[str, str]]] | None:
    """What a fog's name says to any stage: of each of its media how its name begins, its visibility [m] or rate
    [mm/h], and what else there is; None of a variant's name.

    >>> fog_words("mor75.5_g0.8_scale20"), fog_words("rain10+mor400"), fog_words("dense")
    ([('mor', 75.5, {'g': '0.8', 'scale': '20'})], [('rain', 10.0, {}), ('mor', 400.0, {})], None)
    """
    parts: list[tuple[str, float, dict[str, str]]] = []
    for part in name.split("+"):
        if (match := _FOG.fullmatch(part)) is None or fog_fault(part):
            return None
        words = re.findall(rf"_({'|'.join(FOG_WORDS)})(-?[a-z\d.]+)", match[3])
        parts.append((match[1], float(match[2]), dict(words)))
    return parts


def fog_fault(name: str) -> str:
    """Why a name that begins as a medium's does is none, and what to write; '' of a good one, and of a variant's name.

    >>> fog_fault("rain0"), fog_fault("dense")
    ('a rate is 0.01 to 1000 mm/h, as in rain10; no rain is clear', '')
    """
    parts = name.split("+")
    for part in parts:
        if part == "":
            return "+ stands between two media, as in rain10+mor400"
        if (match := _LIKE_FOG.fullmatch(part)) is None:
            return ""
        kind, number, more = match.groups()
        if kind not in MEDIA:
            if number is None and len(parts) == 1:
                return ""
            return f"{kind!r} is no medium; they are {', '.join(MEDIA)}.{did_you_mean(kind.lower(), MEDIA)}"
        if fault := _fault_of(kind, number, more):
            return fault
    return ""


def _fault_of(kind: str, number: str | None, more: str) -> str:
    """`fog_fault` of one medium, by its parts."""
    what, example = ("a rate [mm/h]", f"{kind}10") if kind in RATED else ("a visibility [m]", f"{kind}150")
    if number is None:
        return f"{kind} has {what} behind it, as in {example}"
    try:
        value = float(number)
    except ValueError:
        return f"{number!r} is no number; {kind} has {what} behind it, as in {example}"
    if kind in RATED and not RATES_MM_H[0] <= value <= RATES_MM_H[1]:
        return f"a rate is {RATES_MM_H[0]:g} to {RATES_MM_H[1]:g} mm/h, as in {example}; no {kind} is clear"
    if kind not in RATED and not value > 0.0:
        return f"a visibility is above 0 m, as in {example}"
    if not re.fullmatch(r"\d+(\.\d+)?", number):
        return f"{number!r} is written in digits, as in {example}"
    for word in more.split("_")[1:]:
        near = next((name for name in FOG_WORDS if word.startswith(name)), None)
        if near is None:
            begin = word.rstrip("-.0123456789")
            return f"{begin!r} is none of {', '.join(FOG_WORDS)}.{did_you_mean(begin, FOG_WORDS)}"
        if word == near:
            return f"{near!r} has a value behind it"
    return ""


def variant_of(name: str) -> str:
    """The variant of a stage that is a fog's, whose name USD could not take.

    >>> variant_of("rain2.5+mor300"), variant_of("mor150")
    ('rain2_5-mor300', 'mor150')
    """
    return name.replace("+", "-").replace(".", "_")


def check_visibility(name: str, metres: float) -> None:
    """Refuse a fog that is denser than any.

    Args:
        name: as it was typed.
        metres: what it means, inf for clear air.

    Raises:
        ParameterError: with the least.
    """
    if not metres >= LEAST_MOR_M:
        raise ParameterError(
            f"--fog {name}: a visibility below {LEAST_MOR_M:g} m is a wall; the densest is mor{LEAST_MOR_M:g}"
        )


def check_space(*, metres_per_unit: float | None, up: str | None) -> None:
    """Refuse a unit of no length, or an axis that is none.

    Raises:
        ParameterError: with the range.
    """
    if metres_per_unit is not None and not UNITS_M[0] <= metres_per_unit <= UNITS_M[1]:
        raise ParameterError(
            f"--meters-per-unit {metres_per_unit:g}: outside {UNITS_M[0]:g} to {UNITS_M[1]:g}; 1 is metres, 0.01 "
            f"centimetres, 0.0254 inches"
        )
    if up is not None and up not in ("X", "Y", "Z"):
        raise ParameterError(f"--up {up}: it takes X, Y or Z")


def seconds_of(text: str, option: str = "--exposure") -> float:
    """Seconds of 1/200 or 0.005.

    Raises:
        ParameterError: it is neither, or not above 0.

    >>> seconds_of("1/200")
    0.005
    """
    above, slash, below = text.partition("/")
    try:
        seconds = float(above) / (float(below) if slash else 1.0)
    except (ValueError, ZeroDivisionError):
        seconds = math.nan
    if not 0.0 < seconds < math.inf:
        raise ParameterError(f"{option} {text}: it takes seconds above 0, as 1/200 or 0.005")
    return seconds


def names_of(text: str | None, option: str) -> tuple[str, ...] | None:
    """Names that stand between commas; None of None.

    Raises:
        ParameterError: there is none.

    >>> names_of("clear, mor150", "--fog")
    ('clear', 'mor150')
    """
    if text is None:
        return None
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise ParameterError(f"{option} {text!r}: no name in it; separate names by commas")
    return names


def counts_of(text: str, option: str) -> tuple[int, ...]:
    """Whole numbers that stand between commas.

    Raises:
        ParameterError: they are none.
    """
    names = names_of(text, option) or ()
    if not all(name.isdecimal() for name in names):
        raise ParameterError(f"{option} {text}: not whole numbers separated by commas, as in 4,16,64")
    return tuple(int(name) for name in names)


def size_of(text: str | None) -> tuple[int, int] | None:
    """Width and height [px] of 640x360; None of None.

    Raises:
        ParameterError: it is none.
    """
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and 1 <= int(width) <= 16384 and 1 <= int(height) <= 16384):
        raise ParameterError(f"--resolution {text}: not WIDTHxHEIGHT with both from 1 to 16384, as in 640x360")
    return int(width), int(height)


def check_exposure(*, exposure_s: float | None, iso: float | None, ev: float) -> None:
    """Refuse an exposure that no camera has; what its sensor does not do is refused once that is known.

    Raises:
        ParameterError: with the range.
    """
    for option, value in (("--exposure", exposure_s), ("--iso", iso)):
        if value is not None and not 0.0 < value < math.inf:
            raise ParameterError(f"{option} {value:g}: it takes a number above 0")
    if not abs(ev) <= MOST_EV:
        raise ParameterError(f"--ev {ev:g}: outside -{MOST_EV:g} to {MOST_EV:g} stops; -1 is half of the light")
    if ev != 0.0 and None not in (exposure_s, iso):
        raise ParameterError(f"--ev {ev:g}: --exposure and --iso leave nothing to the meter; leave one of them out")


def check_frames(codes: Sequence[float]) -> None:
    """Refuse time codes that are no video.

    Raises:
        ParameterError: none, one that is no finite number, or steps that differ.

    >>> check_frames((2.0, 1.0, 0.0))
    """
    if not codes or not all(math.isfinite(code) for code in codes):
        raise ParameterError(f"--frames: {len(codes)} time codes, of which a clip takes one at least, all finite")
    steps = [after - before for before, after in itertools.pairwise(codes)]
    if steps and (0.0 in steps or max(steps) - min(steps) > 1e-6 * abs(steps[0])):
        raise ParameterError(
            f"--frames: steps from {min(steps):g} to {max(steps):g}; a clip has even ones, as FIRST:LASTxSTEP"
        )

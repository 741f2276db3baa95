"""What is asked of a bake, in the words of the command line or as Python's values, as a plan.

`--resolution 640x360` and `resolution=(640, 360)` are the same; so are `--fog clear,mor150` and `fog=["clear", 150]`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synfog_usd.base import numbers, resources
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.values import check_words, count, names, number, path_of, seconds, switch, word
from synfog_usd.dataset.plan import BakePlan, Exposing, Sampling, StageReading

if TYPE_CHECKING:
    from synfog_usd.fog import Fog

    FogLike = str | float | Fog

Reader = Callable[[Any, str], Any]
"""Reads a value; the second argument is the option's name, for what is wrong."""


def plan_of(stage: object, out: object = None, **asked: Any) -> BakePlan:
    """A plan from options of `synfog-usd bake`, with _ for -.

    Args:
        stage: USD file, or the name of a stage that ships.
        out: folder that receives everything; out/<name of the stage> if left out.
        asked: values by option, as typed or as Python has them; None is an option that is left out.

    Raises:
        ParameterError: an option that is not known, or a value that it does not take.
    """
    stage = resources.stage(path_of(stage, "stage"))
    out = Path("out") / stage.stem if out is None else path_of(out, "--out")
    check_words(asked, OPTIONS)
    values = {word: value for word, value in asked.items() if value is not None}
    attributes = {_ATTRIBUTE.get(word, word): OPTIONS[word](value, _option(word)) for word, value in values.items()}
    groups = {name: kind(**_of(kind, attributes)) for name, kind in _GROUPS.items()}
    return BakePlan(stage, out, **_of(BakePlan, attributes), **groups)


_GROUPS = {"sampling": Sampling, "reads": StageReading, "exposes": Exposing}


def _of(kind: type, attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {field.name: attributes[field.name] for field in fields(kind) if field.name in attributes}


def fog_names(value: object, option: str = "--fog") -> tuple[str, ...]:
    """Names of fogs from a name, metres, a `Fog`, or several of them."""
    several = value if isinstance(value, (list, tuple)) else [value]
    return tuple(name for item in several for name in _fog_name(item, option))


def _fog_name(value: object, option: str) -> tuple[str, ...]:
    if isinstance(value, str):
        return names(value, option)
    from synfog_usd.fog import Fog  # numpy, which a line of text does without

    if isinstance(value, Fog):
        return (value.name,)
    try:
        metres = number(value, option)
    except ParameterError:
        takes = "clear, a visibility [m], mor150, rain10, a Fog, or a variant of the stage"
        raise ParameterError(f"{option} {value!r}: it takes {takes}") from None
    if not metres > 0.0:
        raise ParameterError(f"{option} {metres:g}: a visibility is above 0 m")
    return (Fog(metres).name,)


def _size(value: object, option: str) -> tuple[int, int] | None:
    if isinstance(value, (list, tuple)) and len(value) == 2:
        value = "x".join(str(count(side, option)) for side in value)
    return numbers.size_of(value if isinstance(value, str) else repr(value))


def _folders(value: object, option: str) -> tuple[Path, ...]:
    several = value if isinstance(value, (list, tuple)) else [value]
    return tuple(path_of(folder, option) for folder in several)


def _choices(value: object, option: str) -> tuple[str, ...]:
    return names([value] if isinstance(value, str) else value, option) if value else ()


OPTIONS: dict[str, Reader] = {
    "pipeline": path_of,
    "lighting": names,
    "fog": fog_names,
    "camera": word,
    "meter": word,
    "frame": number,
    "lights": word,
    "light_scale": number,
    "choose": _choices,
    "meters_per_unit": number,
    "up": word,
    "shutter": number,
    "exposure": seconds,
    "iso": number,
    "ev": number,
    "resolution": _size,
    "model": word,
    "quality": lambda value, option: value,  # the plan itself looks at it
    "samples": count,
    "target_error": number,
    "bands": count,
    "seed": count,
    "same_noise": switch,
    "variant": word,
    "allow": _folders,
    "strict": switch,
    "draft": switch,
}
"""Option -> what reads it."""

_ATTRIBUTE = {
    "choose": "choices",
    "exposure": "exposure_s",
    "meters_per_unit": "metres_per_unit",
    "resolution": "size",
    "shutter": "shutter_s",
}
"""Option -> attribute of `BakePlan` or of a record in it, where they differ."""

assert {_ATTRIBUTE.get(option, option) for option in OPTIONS} <= {
    field.name for kind in (BakePlan, *_GROUPS.values()) for field in fields(kind)
}


def _option(word: str) -> str:
    return f"--{word.replace('_', '-')}"

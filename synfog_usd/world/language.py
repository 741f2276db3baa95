"""The language of recipes: values that may differ, how they are drawn, and how they are read from YAML.

A number is fixed, {uniform: [low, high]}, {normal: {mean, deviation, low, high}} or
{by_hour: [[hour, value], ...]}; a whole number {integer: [low, high]}; a name is
fixed or {choice: {name: weight, ...}}.  Every mistake has its file, line and column.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy import special

from synfog_usd.base.errors import ParameterError, RecipeError, did_you_mean
from synfog_usd.base.numbers import fog_words, variant_of
from synfog_usd.base.seeds import stream
from synfog_usd.base.yamlio import Located, Place, load_file, load_text
from synfog_usd.fog import Fog

SCHEMA = "recipe/1"
FOG_DEFAULT = (600, 300, 150)
Option = TypeVar("Option")


@dataclass(frozen=True)
class Continuous:
    """A parameter that is a number, within limits."""

    low: float
    high: float
    default: Any
    about: str = ""
    whole: bool = False


@dataclass(frozen=True)
class Categorical:
    """A parameter that is one of several names."""

    allowed: tuple[str, ...]
    default: Any
    about: str = ""


Parameter = Continuous | Categorical
Value = float | str | None
"""Of a parameter; None where a recipe does without."""

FOG = Continuous(10, 20000, None, "visibility (MOR) [m]", whole=True)
WEATHER = "a visibility [m], weather by name as rain10, or {choice: {rain10: 2, snow2: 1}}"


def weighted(rng: np.random.Generator, options: Sequence[Option], weights: Sequence[float]) -> Option:
    """One of some options, each as often as it weighs."""
    edges = np.cumsum(weights)
    return options[int(np.searchsorted(edges, rng.random() * edges[-1], side="right"))]


@dataclass(frozen=True)
class Distribution:
    """How one value comes about.

    Attributes:
        kind: 'fixed', 'uniform', 'integer' (both ends included), 'normal', 'by_hour' or 'choice'.
        values: the one value, the two ends, (mean, deviation, low, high), (hour, value) pairs, or the names.
        weights: of the names, positive.
        whole: a whole number is wanted.
    """

    kind: str
    values: tuple[Any, ...]
    weights: tuple[float, ...] = ()
    whole: bool = False

    def __call__(self, rng: np.random.Generator, among: Sequence[str] | None = None, *, hour: float = 12.0) -> Value:
        """One value; of a choice only names in `among`, whose first it is where none of them is in the choice."""
        if self.kind == "choice":
            pairs = [(v, w) for v, w in zip(self.values, self.weights, strict=True) if among is None or v in among]
            return weighted(rng, *zip(*pairs, strict=True)) if pairs else (among or self.values)[0]
        if self.kind == "uniform":
            return float(rng.uniform(*self.values))
        if self.kind == "integer":
            return int(rng.integers(self.values[0], self.values[1] + 1))
        if self.kind == "normal":
            mean, deviation, low, high = self.values
            a, b = special.ndtr((np.array([low, high]) - mean) / deviation)
            value = float(np.clip(mean + deviation * special.ndtri(a + (b - a) * rng.random()), low, high))
            return round(value) if self.whole else value
        if self.kind == "by_hour":
            hours, values = np.array(self.values, dtype=np.float64).T
            value = float(np.interp(hour, hours, values, period=24.0))
            return round(value) if self.whole else value
        fixed: Value = self.values[0]
        return fixed

    def word(self, rng: np.random.Generator, among: Sequence[str] | None = None) -> str:
        """One value that is a name, see `__call__`."""
        value = self(rng, among)
        assert isinstance(value, str)
        return value

    def number(self, rng: np.random.Generator, *, hour: float = 12.0) -> float:
        """One value that is a number."""
        value = self(rng, hour=hour)
        assert isinstance(value, int | float)
        return value


@dataclass(frozen=True)
class Row:
    """Props along a road, with the place in the recipe for errors."""

    place: str
    distributions: Mapping[str, Distribution]


@dataclass(frozen=True)
class Recipe:
    """A recipe that was read and checked.

    Attributes:
        name: of its file; world: one of `parameters.WORLDS`; about: one sentence.
        distributions: one for each parameter of its world.
        fog: one for each fog variant, MOR [m] or the name of weather; clear air is always there.
        rows: props, in the order of precedence.
        lanes: (kind, width [m], way) of a road's lane section from left to right.
    """

    name: str
    world: str
    about: str
    distributions: Mapping[str, Distribution]
    fog: tuple[Distribution, ...]
    rows: tuple[Row, ...] = ()
    lanes: tuple[tuple[str, Distribution, int], ...] = ()

    def fog_variants(self, seed: int) -> dict[str, float | str | None]:
        """Variant -> MOR [m], the clearest first, and then the names of other weather; None is clear air."""
        values = [fog(stream(seed, "recipe", "fog", index)) for index, fog in enumerate(self.fog)]
        mors = {value for value in values if isinstance(value, int | float)}
        named = {variant_of(value): value for value in values if isinstance(value, str)}
        return {"clear": None, **{f"mor{mor}": float(mor) for mor in sorted(mors, reverse=True)}, **named}


@dataclass(frozen=True)
class Draws:
    """What one seed draws of a recipe.

    Every parameter has a random stream of its own name, so that changing one leaves what the others draw as it was.
    """

    recipe: Recipe
    seed: int

    def stream(self, *names: str | int) -> np.random.Generator:
        """The random numbers of these names."""
        return stream(self.seed, "recipe", *names)

    @cached_property
    def hour(self) -> float:
        """Time of day [h] by which `by_hour` is read; noon in worlds without one."""
        hour = self.recipe.distributions.get("traffic.hour")
        return 12.0 if hour is None else float(hour.number(self.stream("traffic.hour")))

    def optional(self, name: str, *index: int) -> float | None:
        """A parameter that is a number, or None where the recipe does without; the index-th of several draws of it."""
        value = self.recipe.distributions[name](self.stream(name, *index), hour=self.hour)
        assert not isinstance(value, str)
        return value

    def number(self, name: str, *index: int) -> float:
        """A parameter that is a number."""
        value = self.optional(name, *index)
        assert value is not None
        return value

    def whole(self, name: str, *index: int) -> int:
        """A parameter that is a whole number."""
        return int(self.number(name, *index))

    def word(self, name: str, among: Sequence[str] | None = None) -> str:
        """A parameter that is a name, of those in `among` where some are, see `Distribution`."""
        return self.recipe.distributions[name].word(self.stream(name), among)


def load_root(path: Path, changes: Sequence[str] = ()) -> Located:
    """The YAML of a recipe with changes of the command line in it.

    Raises:
        RecipeError: not YAML, or a change that is not 'section.key=value'.
    """
    root = load_file(path, error=RecipeError)
    for change in changes:
        name, sign, text = change.partition("=")
        section, dot, key = name.strip().partition(".")
        if not sign or not dot or not section or not key or not isinstance(root.value, dict):
            raise RecipeError(f"--change {change}: takes SECTION.KEY=VALUE, as in traffic.count=20")
        place = Place(f"--change {change}", 1, 1)
        value = replace(load_text(text, name=f"--change {change}", error=RecipeError), key_place=place)
        old = root.value.get(section)
        items = dict(old.value) if old is not None and isinstance(old.value, dict) else {}
        items[key] = value
        root = replace(
            root,
            value={**root.value, section: Located(items, old.place if old else place, old.key_place if old else place)},
        )
    return root


def check_schema(items: Mapping[str, Located], root: Located) -> None:
    """Whether this program reads the recipe."""
    mark = items.get("synfog")
    if mark is None or mark.value != SCHEMA:
        raise RecipeError(
            f"{(mark or root).place}: synfog is {mark.plain() if mark else 'missing'}; this program reads {SCHEMA!r}"
        )


def sections(parameters: Mapping[str, Parameter]) -> tuple[str, ...]:
    """Names of the sections of 'section.key' parameters."""
    return tuple(dict.fromkeys(name.partition(".")[0] for name in parameters))


def read_distributions(items: Mapping[str, Located], parameters: Mapping[str, Parameter]) -> dict[str, Distribution]:
    """One draw for each parameter, from the sections of a recipe."""
    distributions = {name: default(parameter) for name, parameter in parameters.items()}
    for section in sections(parameters):
        if section in items:
            keys = tuple(name.partition(".")[2] for name in parameters if name.startswith(section + "."))
            for key, item in mapping(items[section], section, keys).items():
                name = f"{section}.{key}"
                distributions[name] = read_distribution(item, name, parameters[name])
    return distributions


def read_fog(items: Mapping[str, Located]) -> tuple[Distribution, ...]:
    """One draw for each fog variant."""
    if "fog" not in items:
        return tuple(Distribution("fixed", (mor,)) for mor in FOG_DEFAULT)
    listed = items["fog"]
    if not isinstance(listed.value, list) or not listed.value:
        raise RecipeError(
            f"{listed.place}: fog is {listed.plain()!r}; it takes a list of visibilities in metres and names of "
            f"weather, as in [600, 150, rain10]"
        )
    return tuple(_read_fog(item) for item in listed.value)


def _read_fog(item: Located) -> Distribution:
    """One draw of fog or other weather."""
    choice = isinstance(item.value, dict) and "choice" in item.value
    if not choice and not isinstance(item.value, str):
        return read_distribution(item, "fog", FOG)
    names = item.value["choice"].value if choice else {item.value: item}
    for name in names if isinstance(names, dict) else ():
        words = fog_words(name) if isinstance(name, str) else None
        if words is None or any(more for *_, more in words):
            raise RecipeError(f"{item.place}: fog has no {name!r}; it takes {WEATHER}")
        try:
            Fog.named(name)
        except ParameterError as problem:
            raise RecipeError(f"{item.place}: {problem}") from problem
    return read_distribution(item, "fog", Categorical(tuple(names), None))


def mapping(item: Located, what: str, allowed: Sequence[str]) -> dict[str, Located]:
    """The items of a mapping whose keys are all known."""
    if not isinstance(item.value, dict):
        raise RecipeError(f"{item.place}: {what} is {item.plain()!r}; it takes a mapping of {', '.join(allowed)}")
    for key, value in item.value.items():
        if key not in allowed:
            raise RecipeError(
                f"{value.key_place}: {what} has no {key!r}; it takes {', '.join(allowed)}.{did_you_mean(key, allowed)}"
            )
    return item.value


def default(parameter: Parameter) -> Distribution:
    """What holds where a recipe says nothing."""
    if isinstance(parameter, Continuous):
        return Distribution("fixed", (parameter.default,))
    if isinstance(parameter.default, str):
        return Distribution("choice", (parameter.default,), (1.0,))
    return Distribution(
        "choice", tuple(parameter.default), tuple(float(weight) for weight in parameter.default.values())
    )


def read_distribution(item: Located, name: str, parameter: Parameter) -> Distribution:
    """One value of a recipe.

    Raises:
        RecipeError: not a form that the parameter takes, or outside its limits.
    """
    if isinstance(parameter, Categorical):
        return _choice(item, name, parameter)
    kind = "integer" if parameter.whole else "uniform"
    number = "a whole number" if parameter.whole else "a number"
    form = (
        f"{number}, {{{kind}: [low, high]}}, {{normal: {{mean, deviation, low, high}}}} or {{by_hour: [[hour, value], "
        f"...]}}"
    )
    if not isinstance(item.value, dict):
        return Distribution("fixed", (_number(item, name, parameter, form),))
    (word, ends), *more = item.value.items() or [("", item)]
    if more:
        raise RecipeError(f"{item.place}: {name} is {item.plain()!r}; it takes {form}")
    if word == "normal":
        return _normal(ends, name, parameter, form)
    if word == "by_hour":
        return _by_hour(ends, name, parameter, form)
    if word != kind or not isinstance(ends.value, list) or len(ends.value) != 2:
        raise RecipeError(f"{item.place}: {name} is {item.plain()!r}; it takes {form}")
    low, high = (_number(end, name, parameter, form) for end in ends.value)
    if low > high:
        raise RecipeError(f"{ends.place}: {name} runs from {low:g} to {high:g}; the first end is the lower one")
    return Distribution(kind, (low, high))


def _normal(item: Located, name: str, parameter: Continuous, form: str) -> Distribution:
    keys = ("mean", "deviation", "low", "high")
    items = mapping(item, f"{name}: normal", keys)
    missing = [key for key in keys if key not in items]
    if missing:
        raise RecipeError(f"{item.place}: {name}: normal lacks {', '.join(missing)}; it takes {form}")
    free = replace(parameter, whole=False)
    low, high = _number(items["low"], name, free, form), _number(items["high"], name, free, form)
    loose = Continuous(-math.inf, math.inf, None)
    mean, deviation = _number(items["mean"], name, loose, form), _number(items["deviation"], name, loose, form)
    if low >= high:
        raise RecipeError(f"{items['low'].place}: {name} runs from {low:g} to {high:g}; low is below high")
    if (
        not deviation > 0
        or not math.isfinite(mean)
        or special.ndtr((high - mean) / deviation) - special.ndtr((low - mean) / deviation) < 1e-9
    ):
        raise RecipeError(
            f"{item.place}: {name}: a normal of mean {mean:g} and deviation {deviation:g} has nothing from {low:g} to "
            f"{high:g}"
        )
    return Distribution("normal", (mean, deviation, low, high), whole=parameter.whole)


def _by_hour(item: Located, name: str, parameter: Continuous, form: str) -> Distribution:
    if not isinstance(item.value, list) or not item.value:
        raise RecipeError(f"{item.place}: {name}: by_hour is {item.plain()!r}; it takes {form}")
    pairs = []
    for pair in item.value:
        if not isinstance(pair.value, list) or len(pair.value) != 2:
            raise RecipeError(f"{pair.place}: {name}: {pair.plain()!r} is not [hour, value]")
        hour = _number(pair.value[0], f"{name}: hour", Continuous(0, 24, None), "an hour")
        pairs.append((hour, _number(pair.value[1], name, parameter, form)))
    return Distribution("by_hour", tuple(sorted(pairs)), whole=parameter.whole)


def _number(item: Located, name: str, parameter: Continuous, form: str) -> float:
    value = item.value
    right = isinstance(value, int) if parameter.whole else isinstance(value, int | float)
    if not right or isinstance(value, bool):
        raise RecipeError(f"{item.place}: {name} is {item.plain()!r}; it takes {form}")
    if not parameter.low <= value <= parameter.high:
        raise RecipeError(f"{item.place}: {name} {value:g} is outside {parameter.low:g} to {parameter.high:g}")
    return value if parameter.whole else float(value)


def _choice(item: Located, name: str, parameter: Categorical) -> Distribution:
    form = "a name or {choice: {name: weight, ...}}"
    choice = item
    if isinstance(item.value, dict):
        if set(item.value) != {"choice"}:
            raise RecipeError(f"{item.place}: {name} is {item.plain()!r}; it takes {form}")
        choice = item.value["choice"]
        if not isinstance(choice.value, dict) or not choice.value:
            raise RecipeError(
                f"{choice.place}: {name} chooses among {choice.plain()!r}; it takes {{name: weight, ...}}"
            )
    named = (
        [(key, weight.key_place) for key, weight in choice.value.items()]
        if isinstance(choice.value, dict)
        else [(choice.plain(), item.place)]
    )
    for key, place in named:
        if key not in parameter.allowed:
            raise RecipeError(
                f"{place}: {name} has no {key!r}; it takes "
                f"{', '.join(parameter.allowed)}.{did_you_mean(str(key), parameter.allowed)}"
            )
    if not isinstance(choice.value, dict):
        return Distribution("choice", (choice.value,), (1.0,))
    for key, weight in choice.value.items():
        if (
            isinstance(weight.value, bool)
            or not isinstance(weight.value, int | float)
            or not 0 < weight.value < math.inf
        ):
            raise RecipeError(
                f"{weight.place}: {name}: the weight of {key!r} is {weight.plain()!r}; it takes a number above 0"
            )
    return Distribution("choice", tuple(choice.value), tuple(float(weight.value) for weight in choice.value.values()))

"""Operations of a node graph: plain functions that say what they take and give.

An op is declared once, as a function.  Its keyword-only parameters are the
parameters of the YAML node: type, limits, unit, default and where a missing value
comes from are read from the signature, what it means from the docstring.  Knows no
op and no physics.

    @ops.op("sensor.read_noise", takes=Quantity.ELECTRONS, gives=Quantity.ELECTRONS)
    def read_noise(image, *, rng, sigma_e: Annotated[float, Range(0.0), FromProfile("sensor.read_noise_e")]):
        ...
"""

from __future__ import annotations

import inspect
import math
import re
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.yamlio import switch

F = TypeVar("F", bound=Callable[..., Image])

Setting = float | int | bool | str | tuple[float, ...] | None
"""Value of a parameter that a file can give."""

RESERVED = frozenset({"name", "op", "in", "rng", "include", "before", "after", "remove"})
"""Words of the YAML node itself; no parameter can be called so."""

UNITS = {
    "e": "e-",
    "e_s": "e-/s",
    "dn": "DN",
    "dn_e": "DN/e-",
    "s": "s",
    "m": "m",
    "mm": "mm",
    "um": "um",
    "nm": "nm",
    "px": "px",
    "deg": "degrees",
    "c": "degrees C",
    "k": "K",
    "ev": "EV",
    "percent": "%",
}
"""Unit of a parameter by the end of its name."""

NUMBER = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"
FRACTION = rf"({NUMBER})\s*/\s*({NUMBER})"
_NUMBER = re.compile(NUMBER)
_FRACTION = re.compile(FRACTION)
_ENTRY = re.compile(r"    ([*\w]+(?:, [*\w]+)*): (.*)")
_BRACKETS = re.compile(r"\[([^\[\],]+)\]")


class _Missing:
    def __repr__(self) -> str:
        return "MISSING"


MISSING = _Missing()
"""Stands where a parameter has no default."""


@dataclass(frozen=True)
class Range:
    """Limits of a number, both included unless `above` shuts the lower one out."""

    low: float | None = None
    high: float | None = None
    above: bool = False

    def holds(self, value: float) -> bool:
        """Whether `value` lies inside."""
        if self.low is not None and (value < self.low or (self.above and value == self.low)):
            return False
        return self.high is None or value <= self.high

    def __str__(self) -> str:
        low = None if self.low is None else f"{self.low:g}"
        high = None if self.high is None else f"{self.high:g}"
        if low is not None and high is not None:
            return f"above {low}, up to {high}" if self.above else f"from {low} to {high}"
        if low is not None:
            return f"above {low}" if self.above else f">= {low}"
        return f"<= {high}" if high is not None else ""


@dataclass(frozen=True)
class FromProfile:
    """A value that the file may leave out: 'sensor.read_noise_e', or a whole profile: 'sensor'."""

    path: str

    @property
    def kind(self) -> str:
        """Which profile: the first part of the path."""
        return self.path.partition(".")[0]


@dataclass(frozen=True)
class Auto:
    """A value that the file may leave to the run by writing `auto`.

    It is looked up under `key` (the parameter's own name unless given) in the
    run's settings, then in the provenance of the node's first image.  `hint` tells
    people how to say it where both are silent.
    """

    key: str = ""
    hint: str = ""


@dataclass(frozen=True)
class Port:
    """What flows along an edge: a quantity, how its channels are laid out, and what was done to it.

    `None` and () mean any on the side that takes, and "as it came" on the side that
    gives.  Layouts and stages are words that the ops agree on, such as 'mosaic' and
    'with shot noise'; what takes may name several stages.
    """

    quantity: Quantity | None = None
    layout: str | None = None
    stages: tuple[str, ...] = ()

    def accepts(self, port: Port) -> bool:
        """Whether `port` may flow in here; what is unknown about it is let through."""
        return (
            (self.quantity is None or port.quantity in (None, self.quantity))
            and (self.layout is None or port.layout in (None, self.layout))
            and (not self.stages or set(port.stages) <= set(self.stages))
        )

    def __str__(self) -> str:
        details = ", ".join(filter(None, (self.layout, " or ".join(self.stages))))
        words = [self.quantity.value if self.quantity else "", f"({details})" if details else ""]
        return " ".join(word for word in words if word) or "anything"


@dataclass(frozen=True)
class Parameter:
    """One parameter of an op, as its function declares it.

    Attributes:
        name: as in the YAML.
        kind: 'number', 'integer', 'switch', 'text', 'choice', 'numbers' or 'profile'.
        choices: what a 'choice' may be.
        length: how many 'numbers', or None for any count of at least one.
        optional: whether None is a value.
        limits: range of numbers.
        default: the function's default, or MISSING.
        profile: where a missing value comes from, or None.
        auto: how `auto` is looked up, or None.
        help: what the docstring says of it.
    """

    name: str
    kind: str
    choices: tuple[str, ...] = ()
    length: int | None = None
    optional: bool = False
    limits: Range = Range()
    default: Any = MISSING
    profile: FromProfile | None = None
    auto: Auto | None = None
    help: str = ""

    @property
    def unit(self) -> str:
        """Unit by the end of the name, else by the docstring; '' where there is none."""
        return _unit_of_name(self.name) or _unit_of_text(self.help)

    @property
    def can_be_set(self) -> bool:
        """Whether a file may give it a value; a whole profile is named at the top instead."""
        return self.kind != "profile"

    @property
    def auto_key(self) -> str:
        """Name under which `auto` is looked up; '' where `auto` is not allowed."""
        return "" if self.auto is None else self.auto.key or self.name

    def __str__(self) -> str:
        if self.kind == "choice":
            words = "one of " + ", ".join(repr(choice) for choice in self.choices)
        elif self.kind == "numbers":
            words = f"a list of {self.length} numbers" if self.length else "a list of numbers"
        else:
            words = {
                "number": "a number",
                "integer": "a whole number",
                "switch": "true or false",
                "text": "a text",
                "profile": "a profile",
            }[self.kind]
        limits = str(self.limits)
        words += (f" {limits}" if limits else "") + (f" [{self.unit}]" if self.unit else "")
        return words + (" or auto" if self.auto else "")

    def read(self, value: object) -> Setting:
        """The value as the function wants it.

        Numbers may be written as text that Python or a photographer would read as
        one, '1e-3' and '1/60'; and true and false as on and off, yes and no.

        Raises:
            ValueError: it is of another type or outside the limits.
        """
        if value is None:
            if self.optional:
                return None
            raise ValueError("is empty")
        if self.kind == "number":
            return self._limited(_number(value))
        if self.kind == "integer":
            number = _number(value)
            if number != int(number):
                raise ValueError(f"is {value!r}")
            return int(self._limited(number))
        if self.kind == "switch":
            if isinstance(flag := switch(value), bool):
                return flag
        elif self.kind == "choice":
            if value in self.choices:
                return value
        elif self.kind == "text":
            if isinstance(value, str):
                return value
        elif self.kind == "numbers":
            if isinstance(value, list | tuple) and value and self.length in (None, len(value)):
                return tuple(self._limited(_number(item)) for item in value)
        else:
            raise ValueError(
                f"comes from the {self.profile.kind if self.profile else ''} profile and cannot be set here"
            )
        raise ValueError(f"is {value!r}")

    def _limited(self, value: float) -> float:
        if not self.limits.holds(value):
            raise ValueError(f"is {value:g}")
        return value


def _number(value: object) -> float:
    if isinstance(value, str):
        text = value.strip()
        if _FRACTION.fullmatch(text):
            above, below = (float(part) for part in text.split("/"))
            if below == 0.0:
                raise ValueError(f"is {value!r}, a division by zero")
            return above / below
        if _NUMBER.fullmatch(text):
            value = float(text)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"is {value!r}")
    try:
        number = float(value)
    except OverflowError:
        raise ValueError("is too large") from None
    if not math.isfinite(number):
        raise ValueError(f"is {value!r}")
    return number


@dataclass(frozen=True)
class Op:
    """A function with its declaration.

    Attributes:
        name: as in the YAML, 'family.verb'.
        function: f(image, ..., *, rng, parameters) -> Image.
        takes: one port per image, or one for all where `variadic`.
        gives: what comes out; what it leaves open is as in the first image.
        parameters: by name, in the order of the signature.
        draws: whether it wants a random stream `rng`.
        variadic: whether it takes any count of images.
        doc: the docstring, without its indentation.
        fault: what is wrong with parameters that are right one by one, or ''; called
            with those that it names, as keywords.
    """

    name: str
    function: Callable[..., Image]
    takes: tuple[Port, ...]
    gives: Port
    parameters: Mapping[str, Parameter]
    draws: bool
    variadic: bool
    doc: str
    fault: Callable[..., str] | None = None

    @property
    def summary(self) -> str:
        """First line of the docstring."""
        return self.doc.partition("\n")[0]

    @property
    def family(self) -> str:
        """What stands before the dot of the name."""
        return self.name.partition(".")[0]

    def port(self, index: int) -> Port:
        """What the image at `index` must be."""
        return self.takes[0] if self.variadic else self.takes[index]

    def result(self, first: Port) -> Port:
        """What comes out when `first` is what the first image is."""
        stages = first.stages if self.gives.quantity in (None, first.quantity) else ()
        return Port(
            self.gives.quantity or first.quantity, self.gives.layout or first.layout, self.gives.stages or stages
        )


class Profile(Protocol):
    """Measured constants of a device, as the engine sees them."""

    @property
    def name(self) -> str:
        """Short name."""

    @property
    def content_hash(self) -> str:
        """SHA-256 of everything that changes a picture."""


ProfileLoader = Callable[[str, Path], Profile]
"""Called with a reference (a shipped name, or a path that ends in .yaml) and the folder that paths start from."""


@dataclass
class Registry:
    """The ops and kinds of profile that a graph may name.

    A registry is filled when the modules that own its ops are imported, and only
    read after that.  `Registry(other)` starts with what `other` holds, so that own
    ops can be added without touching it.
    """

    base: Registry | None = None
    ops: dict[str, Op] = field(default_factory=dict)
    profiles: dict[str, ProfileLoader] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.base is not None:
            self.ops = {**self.base.ops, **self.ops}
            self.profiles = {**self.base.profiles, **self.profiles}

    def __iter__(self) -> Iterator[Op]:
        return iter(self.ops.values())

    def op(
        self,
        name: str,
        *,
        takes: Port | Quantity | Iterable[Port | Quantity] | None,
        gives: Port | Quantity | None,
        fault: Callable[..., str] | None = None,
    ) -> Callable[[F], F]:
        """Declare the function below as the op `name`.

        Args:
            name: 'family.verb', lower case.
            takes: what the images must be: one for each positional parameter, or
                one for `*images`; None for anything.
            gives: what comes out; None for what came in.
            fault: f(**some of the parameters) -> what is wrong with them together, or '';
                asked when a graph is read, so that it is not found in the run.

        Raises:
            TypeError: the function cannot be an op; the text says why.
        """
        ports = (
            (_port(takes),)
            if takes is None or isinstance(takes, Port | Quantity)
            else tuple(_port(item) for item in takes)
        )

        def declare(function: F) -> F:
            if not re.fullmatch(r"[a-z][a-z0-9_]*\.[a-z][a-z0-9_]*", name):
                raise TypeError(f"op name {name!r} is not of the form family.verb")
            if name in self.ops:
                raise TypeError(f"op {name!r} is declared twice")
            self.ops[name] = _declared(name, function, ports, _port(gives), fault)
            return function

        return declare

    def profile(self, kind: str, loader: ProfileLoader) -> None:
        """Declare the header word `kind`, such as 'sensor', and what reads the profile that it names."""
        self.profiles[kind] = loader


def _port(value: Port | Quantity | None) -> Port:
    return value if isinstance(value, Port) else Port(value)


def _declared(
    name: str, function: Callable[..., Image], takes: tuple[Port, ...], gives: Port, fault: Callable[..., str] | None
) -> Op:
    signature = inspect.signature(function)
    doc = inspect.getdoc(function) or ""
    texts = documented(doc)
    hints = typing.get_type_hints(function, include_extras=True)
    images, variadic, parameters, draws = 0, False, {}, False
    for item in signature.parameters.values():
        if item.kind is item.VAR_POSITIONAL:
            variadic = True
        elif item.kind in (item.POSITIONAL_ONLY, item.POSITIONAL_OR_KEYWORD):
            images += 1
        elif item.kind is item.VAR_KEYWORD:
            raise TypeError(f"op {name!r}: **{item.name} hides its parameters")
        elif item.name == "rng":
            draws = True
        elif item.name in RESERVED:
            raise TypeError(f"op {name!r}: a parameter cannot be called {item.name!r}")
        else:
            parameters[item.name] = _parameter(name, item, hints.get(item.name), texts.get(item.name, ""))
    if (variadic and images) or (not variadic and images != len(takes)) or (variadic and len(takes) != 1):
        raise TypeError(f"op {name!r}: {images} images, but {len(takes)} entries in `takes`")
    return Op(name, function, takes, gives, types.MappingProxyType(parameters), draws, variadic, doc, fault)


def documented(doc: str) -> dict[str, str]:
    """What the 'Args:' of a docstring say, by name, each as one line.

    >>> documented("Blurs.\\n\\nArgs:\\n    low, high: ends of\\n        the band [nm].\\n\\nSource: none")
    {'low': 'ends of the band [nm].', 'high': 'ends of the band [nm].'}
    """
    texts: dict[str, str] = {}
    names: list[str] = []
    inside = False
    for line in doc.splitlines():
        if not line.startswith(" "):
            inside = line == "Args:" or (inside and not line)
        elif inside and (entry := _ENTRY.fullmatch(line)):
            names = [name.strip().lstrip("*") for name in entry[1].split(",")]
            texts |= dict.fromkeys(names, entry[2])
        elif inside:
            texts |= {name: f"{texts[name]} {line.strip()}" for name in names}
    return texts


def _unit_of_name(name: str) -> str:
    parts = name.split("_")
    return next((UNITS[end] for start in range(1, len(parts)) if (end := "_".join(parts[start:])) in UNITS), "")


def _unit_of_text(text: str) -> str:
    """What stands in square brackets; [1] is no unit."""
    match = _BRACKETS.search(text)
    return match[1] if match and not match[1].isdigit() else ""


def _parameter(op: str, item: inspect.Parameter, hint: type | None, text: str) -> Parameter:
    if (named := _unit_of_name(item.name)) and (unit_in_text := _unit_of_text(text)) and named != unit_in_text:
        raise TypeError(
            f"op {op!r}: parameter {item.name!r} is in {named} by its name, but in {unit_in_text} by the docstring"
        )
    default = MISSING if item.default is item.empty else item.default
    limits, profile, auto = Range(), None, None
    hint, optional = _without_none(hint)  # Python 3.10 wraps a hint whose default is None once more
    if typing.get_origin(hint) is typing.Annotated:
        hint, *marks = typing.get_args(hint)
        for mark in marks:
            if isinstance(mark, Range):
                limits = mark
            elif isinstance(mark, FromProfile):
                profile = mark
            elif isinstance(mark, Auto):
                auto = mark
    hint, inner = _without_none(hint)
    optional = optional or inner
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        raise TypeError(f"op {op!r}: parameter {item.name!r} is of several types")
    choices: tuple[str, ...] = ()
    length: int | None = None
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        kind, choices = "choice", args
    elif origin is tuple and set(args) <= {float, Ellipsis}:
        kind, length = "numbers", None if Ellipsis in args else len(args)
    elif hint in (float, int, bool, str):
        kind = {float: "number", int: "integer", bool: "switch", str: "text"}[hint]
    elif profile is not None and "." not in profile.path:
        kind = "profile"
    else:
        raise TypeError(f"op {op!r}: parameter {item.name!r} is of type {hint!r}, which no YAML node can hold")
    return Parameter(item.name, kind, choices, length, optional, limits, default, profile, auto, text)


def _without_none(hint: type | None) -> tuple[type | None, bool]:
    """`X` and True for `X | None`; any other hint as it is."""
    if typing.get_origin(hint) not in (typing.Union, types.UnionType):
        return hint, False
    kinds = [kind for kind in typing.get_args(hint) if kind is not type(None)]
    return (kinds[0], True) if len(kinds) == 1 else (hint, False)

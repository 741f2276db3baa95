"""YAML with places: every value knows the file, line and column it came from.

Safe by construction: only plain scalars, lists and mappings are built; tags that
name Python objects, anchors that multiply into a bomb and duplicate keys are
refused.  On, off, yes and no are words and 1e-5 is a number, as YAML 1.2 has it:
`switch` takes those words where true or false is wanted.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from synfog_usd.base.errors import GraphError, SynfogError

T = TypeVar("T")

MAX_BYTES = 1 << 20
MAX_NODES = 20_000
MAX_DEPTH = 50

WITH_EXPONENT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+")
"""Numbers that YAML 1.1 takes for text, where they have no dot or no sign in the exponent."""

SWITCHES = {"true": True, "on": True, "yes": True, "false": False, "off": False, "no": False}
"""What can be written for true and false, in any case."""


@dataclass(frozen=True)
class Place:
    """Where a value stands, 1-based, printed as file:line:column."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


@dataclass(frozen=True)
class Located:
    """A YAML value with its place; mappings hold {str: Located}, lists [Located]."""

    value: Any
    place: Place
    key_place: Place | None = None

    def plain(self) -> Any:
        """The value without places."""
        if isinstance(self.value, dict):
            return {key: item.plain() for key, item in self.value.items()}
        if isinstance(self.value, list):
            return [item.plain() for item in self.value]
        return self.value


def switch(value: T) -> T | bool:
    """True or false for a word that means it, in a file or behind --set; any other value as it is."""
    return SWITCHES.get(value.lower(), value) if isinstance(value, str) else value


def load_file(path: Path, *, error: type[SynfogError] = GraphError) -> Located:
    """Read one YAML file.

    Raises:
        `error`: missing, too large, not YAML, or not plain data; with its place.
    """
    if path.exists() and not path.is_file():
        raise error(f"{path}: cannot be read (it is no regular file)")
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from problem
    if len(data) > MAX_BYTES:
        raise error(f"{path}: {path.stat().st_size} bytes; at most {MAX_BYTES} are read")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as problem:
        raise error(f"{path}: not UTF-8 text (byte {problem.start})") from problem
    return load_text(text, name=str(path), error=error)


def load_text(text: str, *, name: str = "<text>", error: type[SynfogError] = GraphError) -> Located:
    """Read YAML from a string; see `load_file`."""
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark or problem.context_mark
        place = f"{name}:{mark.line + 1}:{mark.column + 1}" if mark else name
        raise error(f"{place}: not valid YAML: {problem.problem or problem.context}") from problem
    except (yaml.YAMLError, RecursionError) as problem:
        raise error(f"{name}: not valid YAML: {problem}") from problem
    if root is None:
        raise error(f"{name}: the file is empty")
    return _Builder(name, error).build(root)


def from_python(value: object, *, name: str) -> Located:
    """Plain data of Python's with places such as 'nodes[3].shoulder'; `name` is what errors call the whole."""
    return _PythonPlaces(name).located(value, "")


@dataclass(frozen=True)
class _PythonPlace(Place):
    """A place in Python's data; `line` counts the values that stand before it."""

    label: str = ""

    def __str__(self) -> str:
        return self.label


class _PythonPlaces:
    """Gives every value of plain data a place."""

    def __init__(self, name: str) -> None:
        self.name, self.count = name, 0

    def located(self, value: object, label: str) -> Located:
        self.count += 1
        spot = _PythonPlace(self.name, self.count, 0, label or self.name)
        if isinstance(value, Mapping):
            value = {
                str(key): self.located(item, f"{label}.{key}" if label else str(key)) for key, item in value.items()
            }
        elif isinstance(value, list | tuple):
            value = [self.located(item, f"{label}[{index}]") for index, item in enumerate(value)]
        return Located(value, spot, spot)


class _Builder:
    def __init__(self, name: str, error: type[SynfogError]) -> None:
        self.name, self.error, self.count = name, error, 0
        self.scalars = yaml.SafeLoader("")

    def place(self, node: yaml.Node) -> Place:
        return Place(self.name, node.start_mark.line + 1, node.start_mark.column + 1)

    def build(self, node: yaml.Node, depth: int = 0, key_place: Place | None = None) -> Located:
        place = self.place(node)
        self.count += 1  # an alias is built again each time it is used, so a bomb runs into this limit
        if self.count > MAX_NODES or depth > MAX_DEPTH:
            raise self.error(
                f"{place}: too many or too deeply nested values; at most {MAX_NODES} and {MAX_DEPTH} levels"
            )
        if not node.tag.startswith("tag:yaml.org,2002:") or ":python" in node.tag:
            raise self.error(f"{place}: tag {node.tag!r} is not allowed; use plain values only")
        value: Any
        if isinstance(node, yaml.MappingNode):
            value = {}
            for key_node, value_node in node.value:
                key = self.build(key_node, depth + 1)
                if not isinstance(key.value, str):
                    raise self.error(f"{key.place}: key {key.value!r} is not text; put it in quotes")
                if key.value in value:
                    raise self.error(f"{key.place}: key {key.value!r} stands here twice")
                value[key.value] = self.build(value_node, depth + 1, key.place)
        elif isinstance(node, yaml.SequenceNode):
            value = [self.build(item, depth + 1) for item in node.value]
        else:
            try:
                value = self.scalar(node)  # type: ignore[arg-type]
            except (yaml.YAMLError, ValueError) as problem:
                raise self.error(
                    f"{place}: {node.value!r} cannot be read as {node.tag.rsplit(':', 1)[-1]}"
                ) from problem
        return Located(value, place, key_place)

    def scalar(self, node: yaml.ScalarNode) -> str | int | float | bool | None:
        kind = node.tag.rsplit(":", 1)[-1]
        if kind == "bool" and node.value.lower() not in ("true", "false"):
            return node.value
        if kind == "str" and not node.style and WITH_EXPONENT.fullmatch(node.value):
            return float(node.value)
        return self.scalars.construct_object(node)

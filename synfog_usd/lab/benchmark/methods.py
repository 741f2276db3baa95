"""Which methods are compared: the classics by name, and others' own, declared in YAML.

    synfog: benchmark/1
    methods:
      - none
      - dcp
      - {name: mine, onnx: mine.onnx, multiple: 8}
      - {name: theirs, command: [python, run.py, --in, "{in}", --out, "{out}"], takes: srgb.png, timeout_s: 60}

An ONNX network takes and gives R, G and B of (1, 3, H, W).  Values go from 0 to 1; by `range: [-1, 1]` from -1.  A
command reads the file {in} and writes a PNG of the same size to {out}; `takes: raw.dng` hands it the RAW file.  Both
work on one picture at a time, and have all cores, unless `at_once` allows more.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.base.yamlio import Located, load_file
from synfog_usd.lab.benchmark.classics import CLASSICS

SCHEMA = "benchmark/1"
TIMEOUT_S = 60.0
PNG = "srgb.png"
OF_ALL = ("name", "onnx", "command", "takes", "timeout_s", "memory_gb", "at_once")
"""What methods of every kind are declared by."""

FIELDS = (*OF_ALL, "range", "multiple")


@dataclass(frozen=True)
class Method:
    """What is asked about pictures, in a child with limits.

    Attributes:
        name: for tables.
        kind: 'classic', 'onnx' or 'command'.
        target: the classic's name, the network's path or the command's folder.
        command: words, with {in} and {out}.
        takes: name of the file that it is given.
        timeout_s: for one picture [s].
        memory_gb: address space that each of its children may have [GB].
        at_once: pictures that it may work on in parallel, each in a child of its own; 0 for as many as there are cores.
        version: hash of all that decides its answers, so that old results are not taken for new ones.
    """

    suffix: ClassVar[str] = ""
    """Of the file with its answer."""

    name: str
    kind: str
    target: str = ""
    command: tuple[str, ...] = ()
    takes: str = PNG
    timeout_s: float = TIMEOUT_S
    memory_gb: float = 8.0
    at_once: int = 1
    version: str = ""


@dataclass(frozen=True)
class Defogger(Method):
    """One way to see through fog; its answer is a picture.

    Attributes:
        range: smallest and largest number of a network's pictures.
        multiple: a network's sides must be multiples of this [px]; pictures are padded by their mirror image.
    """

    suffix: ClassVar[str] = ".png"

    range: tuple[float, float] = (0.0, 1.0)
    multiple: int = 1


@dataclass(frozen=True)
class Measurer(Method):
    """What measures answers, in children as well: its answer is a number by metric."""

    suffix: ClassVar[str] = ".json"


def chosen(words: Sequence[str]) -> tuple[Defogger, ...]:
    """Methods by name, or from YAML files.

    Args:
        words: names of classics, and paths that end in .yaml.

    Raises:
        ParameterError: an unknown name, or a fault in a file, with its place.
    """
    result: list[Defogger] = []
    for word in words:
        if is_file(word):
            result += [_method(entry, Path(word).parent) for entry in listed(Path(word), "methods")]
        else:
            result.append(_classic(word, ""))
    refuse_twins(result)
    if not result:
        raise ParameterError(f"no method is named; it can be {', '.join(CLASSICS)}, or a YAML file")
    return tuple(result)


def is_file(word: str) -> bool:
    """Whether a word names a file of methods."""
    return word.endswith((".yaml", ".yml"))


def refuse_twins(methods: Sequence[Method]) -> None:
    """Raise ParameterError where two have one name."""
    names = [method.name for method in methods]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ParameterError(f"two methods are called {twice!r}; give one another name")


def _classic(name: str, place: str) -> Defogger:
    if name not in CLASSICS:
        raise ParameterError(
            f"{place}method {name!r} is not known; it can be {', '.join(CLASSICS)}, or a YAML file."
            f"{did_you_mean(name, list(CLASSICS))}"
        )
    return Defogger(name, "classic", target=name, at_once=0, version=_hash("classic", name, "1"))


def listed(path: Path, kind: str) -> list[Located]:
    """What stands under `kind`, 'methods' or 'detectors', of a file.

    Raises:
        ParameterError: it is no file of methods, or it names no method.
    """
    root = load_file(path, error=ParameterError)
    fields = mapping(root, "a file of methods", ("synfog", "methods", "detectors"))
    if "synfog" not in fields or fields["synfog"].plain() != SCHEMA:
        raise ParameterError(f"{root.place}: a file of methods begins with 'synfog: {SCHEMA}'")
    value = fields.get(kind)
    if value is None or not isinstance(value.value, list) or not value.value:
        raise ParameterError(f"{root.place}: {kind} is a list of names and mappings, and has at least one")
    return list(value.value)


def _method(entry: Located, folder: Path) -> Defogger:
    if isinstance(entry.value, str):
        return _classic(entry.value, f"{entry.place}: ")
    fields = mapping(entry, "a method", FIELDS)
    more: dict[str, Any] = {}
    if "multiple" in fields:
        more["multiple"] = int(number(fields["multiple"], "multiple", 1, 4096))
    if "range" in fields:
        value = fields["range"].plain()
        if value not in ([0, 1], [-1, 1]):
            raise ParameterError(f"{fields['range'].place}: range is {value!r}; it takes [0, 1] or [-1, 1]")
        more["range"] = (float(value[0]), float(value[1]))
    return Defogger(**declared(entry, fields, folder, more), **more)


def declared(entry: Located, fields: dict[str, Located], folder: Path, more: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of `Method` that an entry declares.

    Args:
        entry, fields: the entry, and what stands in it.
        folder: to which its paths are relative.
        more: what else decides its answers.

    Raises:
        ParameterError: a fault, with its place.
    """
    name = fields["name"].plain() if "name" in fields else None
    if not isinstance(name, str) or not name:
        raise ParameterError(f"{entry.place}: a method needs a name")
    if ("onnx" in fields) == ("command" in fields):
        raise ParameterError(f"{entry.place}: method {name!r} needs one of onnx: FILE and command: [WORDS]")
    values: dict[str, Any] = {}
    for key, low, high in (("timeout_s", 0.1, 86400.0), ("memory_gb", 0.1, 4096.0)):
        if key in fields:
            values[key] = float(number(fields[key], key, low, high))
    if "takes" in fields:
        value = fields["takes"].plain()
        if not isinstance(value, str) or Path(value).name != value or "onnx" in fields:
            raise ParameterError(
                f"{fields['takes'].place}: takes is {value!r}; it is the plain name of an output, for a command"
            )
        values["takes"] = value
    decides = {**values, **more}
    if "at_once" in fields:
        values["at_once"] = int(number(fields["at_once"], "at_once", 1, 1024))
    if "onnx" in fields:
        value = fields["onnx"].plain()
        path = folder / str(value)
        if not isinstance(value, str) or not path.is_file():
            raise ParameterError(f"{fields['onnx'].place}: {path}: no such file")
        version = _hash("onnx", hashlib.sha256(path.read_bytes()).hexdigest(), decides)
        return {"name": name, "kind": "onnx", "target": str(path.resolve()), "version": version, **values}
    words = fields["command"].plain()
    place = fields["command"].place
    if not isinstance(words, list) or not words or not all(isinstance(word, str) for word in words):
        raise ParameterError(f"{place}: command is a list of words")
    if not any("{in}" in word for word in words) or not any("{out}" in word for word in words):
        raise ParameterError(f"{place}: a command names {{in}}, the picture, and {{out}}, the file that it writes")
    if shutil.which(words[0]) is None:
        raise ParameterError(f"{place}: {words[0]}: no such program")
    hashes = [hashlib.sha256((folder / w).read_bytes()).hexdigest() for w in words if (folder / w).is_file()]
    version = _hash("command", words, hashes, decides)
    target = str(folder.resolve())
    return {"name": name, "kind": "command", "target": target, "command": tuple(words), "version": version, **values}


def number(node: Located, key: str, low: float, high: float) -> float:
    """A number of an entry.

    Raises:
        ParameterError: it is none, or outside of its range.
    """
    value = node.plain()
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ParameterError(f"{node.place}: {key} is {value!r}; it takes a number, {low} to {high}")
    return value


def mapping(node: Located, what: str, keys: Sequence[str]) -> dict[str, Located]:
    """The entries of a mapping; what is not `keys` is refused."""
    if not isinstance(node.value, dict):
        raise ParameterError(f"{node.place}: {what} is a mapping")
    fields: dict[str, Located] = node.value
    for key in fields:
        if key not in keys:
            raise ParameterError(
                f"{fields[key].place}: {what} has no {key!r}; it takes {', '.join(keys)}."
                f"{did_you_mean(key, list(keys))}"
            )
    return fields


def _hash(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]

"""Which methods are compared: the classics by name, and others' own, declared in YAML.

    synfog: benchmark/1
    methods:
      - none
      - dcp
      - {name: mine, onnx: mine.onnx, multiple: 8}
      - {name: theirs, command: [python, run.py, --in, "{in}", --out, "{out}"], takes: srgb.png, timeout_s: 60}

An ONNX network takes and gives R, G and B of (1, 3, H, W), `range: [0, 1]` unless it says [-1, 1].  A command reads the
file {in} and writes a PNG of the same size to {out}; `takes: raw.dng` hands it the RAW file.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synfog_usd.benchmark.classics import CLASSICS
from synfog_usd.errors import ParameterError, did_you_mean
from synfog_usd.yamlio import Located, load_file

SCHEMA = "benchmark/1"
TIMEOUT_S = 60.0
PNG = "srgb.png"
FIELDS = ("name", "onnx", "command", "takes", "range", "multiple", "timeout_s", "memory_gb")


@dataclass(frozen=True)
class Defogger:
    """One way to see through fog.

    Attributes:
        name: for tables.
        kind: 'classic', 'onnx' or 'command'.
        target: the classic's name or the network's path.
        command: words, with {in} and {out}.
        takes: name of the file that it is given.
        range: smallest and largest number of a network's pictures.
        multiple: a network's sides must be multiples of this [px]; pictures are padded by their mirror image.
        timeout_s: for one picture [s].
        memory_gb: address space that it may have [GB].
        version: hash of all that decides its answers, so that old results are not taken for new ones.
    """

    name: str
    kind: str
    target: str = ""
    command: tuple[str, ...] = ()
    takes: str = PNG
    range: tuple[float, float] = (0.0, 1.0)
    multiple: int = 1
    timeout_s: float = TIMEOUT_S
    memory_gb: float = 8.0
    version: str = ""


def chosen(words: Sequence[str]) -> tuple[Defogger, ...]:
    """Methods by name, or from YAML files.

    Args:
        words: names of classics, and paths that end in .yaml.

    Raises:
        ParameterError: an unknown name, or a fault in a file, with its place.
    """
    found: list[Defogger] = []
    for word in words:
        found += _from_file(Path(word)) if word.endswith((".yaml", ".yml")) else [_classic(word, "")]
    names = [method.name for method in found]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ParameterError(f"two methods are called {twice!r}; give one another name")
    if not found:
        raise ParameterError(f"no method is named; it can be {', '.join(CLASSICS)}, or a YAML file")
    return tuple(found)


def _classic(name: str, place: str) -> Defogger:
    if name not in CLASSICS:
        raise ParameterError(
            f"{place}method {name!r} is not known; it can be {', '.join(CLASSICS)}, or a YAML file."
            f"{did_you_mean(name, list(CLASSICS))}"
        )
    return Defogger(name, "classic", target=name, version=_hash("classic", name, "1"))


def _from_file(path: Path) -> list[Defogger]:
    root = load_file(path, error=ParameterError)
    fields = _mapping(root, "a file of methods", ("synfog", "methods"))
    if "synfog" not in fields or fields["synfog"].plain() != SCHEMA:
        raise ParameterError(f"{root.place}: a file of methods begins with 'synfog: {SCHEMA}'")
    listed = fields.get("methods")
    if listed is None or not isinstance(listed.value, list) or not listed.value:
        raise ParameterError(f"{root.place}: methods is a list of names and mappings, and has at least one")
    return [_method(entry, path.parent) for entry in listed.value]


def _method(entry: Located, folder: Path) -> Defogger:
    if isinstance(entry.value, str):
        return _classic(entry.value, f"{entry.place}: ")
    fields = _mapping(entry, "a method", FIELDS)
    name = fields["name"].plain() if "name" in fields else None
    if not isinstance(name, str) or not name:
        raise ParameterError(f"{entry.place}: a method needs a name")
    ways = [way for way in ("onnx", "command") if way in fields]
    if len(ways) != 1:
        raise ParameterError(f"{entry.place}: method {name!r} needs one of onnx: FILE and command: [WORDS]")
    more: dict[str, Any] = {}
    for key, low, high in (("timeout_s", 0.1, 86400.0), ("memory_gb", 0.1, 4096.0), ("multiple", 1, 4096)):
        if key in fields:
            value = fields[key].plain()
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
                raise ParameterError(f"{fields[key].place}: {key} is {value!r}; it takes a number, {low} to {high}")
            more[key] = int(value) if key == "multiple" else float(value)
    if "range" in fields:
        value = fields["range"].plain()
        if value not in ([0, 1], [-1, 1]):
            raise ParameterError(f"{fields['range'].place}: range is {value!r}; it takes [0, 1] or [-1, 1]")
        more["range"] = (float(value[0]), float(value[1]))
    if "takes" in fields:
        value = fields["takes"].plain()
        if not isinstance(value, str) or Path(value).name != value or ways == ["onnx"]:
            raise ParameterError(
                f"{fields['takes'].place}: takes is {value!r}; it is the plain name of an output, for a command"
            )
        more["takes"] = value
    if ways == ["onnx"]:
        value = fields["onnx"].plain()
        path = folder / str(value)
        if not isinstance(value, str) or not path.is_file():
            raise ParameterError(f"{fields['onnx'].place}: {path}: no such file")
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        return Defogger(name, "onnx", target=str(path.resolve()), version=_hash("onnx", digest, more), **more)
    words = fields["command"].plain()
    place = fields["command"].place
    if not isinstance(words, list) or not words or not all(isinstance(word, str) for word in words):
        raise ParameterError(f"{place}: command is a list of words")
    if not any("{in}" in word for word in words) or not any("{out}" in word for word in words):
        raise ParameterError(f"{place}: a command names {{in}}, the foggy picture, and {{out}}, the PNG that it writes")
    if shutil.which(words[0]) is None:
        raise ParameterError(f"{place}: {words[0]}: no such program")
    own = [hashlib.sha256((folder / w).read_bytes()).hexdigest() for w in words if (folder / w).is_file()]
    return Defogger(
        name,
        "command",
        target=str(folder.resolve()),
        command=tuple(words),
        version=_hash("command", words, own, more),
        **more,
    )


def _mapping(node: Located, what: str, known: Sequence[str]) -> dict[str, Located]:
    if not isinstance(node.value, dict):
        raise ParameterError(f"{node.place}: {what} is a mapping")
    fields: dict[str, Located] = node.value
    for key in fields:
        if key not in known:
            raise ParameterError(
                f"{fields[key].place}: {what} has no {key!r}; it takes {', '.join(known)}."
                f"{did_you_mean(key, list(known))}"
            )
    return fields


def _hash(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]

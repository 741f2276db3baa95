"""How a set was made so far: a line for each unit that ended, and one holder at a time.

`OUT/.run` is no part of the set: its bytes depend on when and where a set was made.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from synfog_usd.base import files, system
from synfog_usd.base.errors import OutputError, SetError
from synfog_usd.dataset.sets import layout
from synfog_usd.dataset.sets.definition import SetDefinition
from synfog_usd.dataset.sets.load import define_set

JOURNAL, LOCK, DEFINITION = "journal.jsonl", "lock", "definition.json"


@dataclass
class Tally:
    """What a journal says, added up.

    Attributes:
        units, shots, bytes: that were made.
        seconds, cpu_s: that they took, added up.
        peak_mb: the most memory that one took.
        aside: unit that failed too often -> its last error.
    """

    units: int = 0
    shots: int = 0
    bytes: int = 0
    seconds: float = 0.0
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    aside: dict[str, dict[str, Any]] = field(default_factory=dict)

    def add(self, line: Mapping[str, Any]) -> None:
        """One line more."""
        if line.get("retry"):
            self.aside.clear()
        elif line.get("aside"):
            self.aside[line["unit"]] = dict(line)
        elif line.get("ok"):
            self.aside.pop(line["unit"], None)
            if not line["made"]:
                return
            self.units += 1
            self.shots += line["shots"]
            self.bytes += line["bytes"]
            self.seconds += line["seconds"]
            self.cpu_s += line["cpu_s"]
            self.peak_mb = max(self.peak_mb, line["peak_mb"])


def lines(out: Path) -> Iterator[dict[str, Any]]:
    """The lines of a journal; a last one that a killed process left half-written is no line."""
    try:
        with (out / layout.RUN / JOURNAL).open(encoding="utf-8", errors="replace") as file:
            for line in file:
                with contextlib.suppress(ValueError):
                    entry = json.loads(line)
                    if isinstance(entry, dict):
                        yield entry
    except FileNotFoundError:
        return
    except OSError as error:
        raise OutputError(f"{out / layout.RUN / JOURNAL}: cannot be read ({error.strerror})") from error


def tally(out: Path) -> Tally:
    """All that a journal says, added up."""
    total = Tally()
    for line in lines(out):
        total.add(line)
    return total


def write(out: Path, line: Mapping[str, Any]) -> None:
    """Add a line; the client alone does.

    Raises:
        OutputError: the folder cannot be written.
    """
    path = out / layout.RUN / JOURNAL
    try:
        with path.open("ab") as file:
            if file.tell():
                with path.open("rb") as before:
                    before.seek(-1, os.SEEK_END)
                    if before.read(1) != b"\n":
                        file.write(b"\n")
            file.write((json.dumps(dict(line)) + "\n").encode())
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}); free some space") from error


@contextlib.contextmanager
def held(out: Path) -> Iterator[None]:
    """Hold a set's folder for this process.

    Raises:
        SetError: another run holds it; says which.
        OutputError: the folder cannot be written.
    """
    path = out / layout.RUN / LOCK
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise OutputError(f"{out}: cannot be used as folder of a set ({error.strerror})") from error
    try:
        try:
            system.lock(handle)
        except OSError as error:
            holder = path.read_bytes()[:200].decode(errors="replace").strip()
            raise SetError(
                f"{out}: another run works here ({holder or 'just begun'}); wait for it, or look with "
                f"synfog-usd dataset status {out}"
            ) from error
        os.ftruncate(handle, 0)
        os.lseek(handle, 0, os.SEEK_SET)
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()}".encode())
        yield
    finally:
        os.close(handle)


def under_way(out: Path) -> bool:
    """Whether a run holds the folder."""
    try:
        handle = os.open(out / layout.RUN / LOCK, os.O_RDWR)
    except OSError:
        return False
    try:
        system.lock(handle)
        return False
    except OSError:
        return True
    finally:
        os.close(handle)


def keep_definition(out: Path, definition: SetDefinition) -> None:
    """Write down what is made, for workers and for `retry`."""
    offers = {
        str(path): {kind: list(names) for kind, names in offer.items()} for path, offer in definition.offers.items()
    }
    words = {
        "name": definition.name,
        "folder": str(definition.folder),
        "words": dict(definition.words),
        "offers": offers,
    }
    files.write_json(out / layout.RUN / DEFINITION, words)


def kept_definition(out: Path) -> SetDefinition:
    """What was last made here.

    Raises:
        SetError: nothing was.
    """
    path = out / layout.RUN / DEFINITION
    try:
        content = json.loads(path.read_bytes())
        words, name, folder = dict(content["words"]), str(content["name"]), Path(content["folder"])
        offers = {Path(path): dict(offer) for path, offer in content.get("offers", {}).items()}
    except FileNotFoundError as error:
        raise SetError(f"{out}: no set was begun here; synfog-usd dataset run SET.yaml -o {out} begins one") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SetError(f"{path}: damaged ({error}); dataset run SET.yaml -o {out} writes it again") from error
    return replace(define_set(name, folder=folder, **words), offers=offers)

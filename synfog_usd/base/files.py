"""Files that appear whole or not at all.

A file is written beside its place under a temporary name and renamed into it, so
a killed run leaves nothing half-written under a name that anyone would open.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

from synfog_usd.base.errors import OutputError

TEMPORARY_PREFIX = ".synfog-part-"

_FICLONE = 0x40049409
"""Linux's request for a reflink: two files that share their blocks until one is changed."""


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Call `write(temporary)` and rename the result to `path`.

    The temporary name keeps the suffix of `path`, because image libraries choose
    their format by it.

    Raises:
        OutputError: the folder cannot be written or the disk is full.
    """
    temporary = path.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()  # libraries that write say less well than the system why they cannot
        write(temporary)
        with temporary.open("r+b") as handle:  # Windows writes through only what may be written
            os.fsync(handle.fileno())
        temporary.replace(path)
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror or error}); choose another output folder or free some space"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path`, whole."""
    write_whole(path, lambda temporary: _put(temporary, data))


def write_json(path: Path, value: object) -> None:
    """Write `value` as indented JSON with a final newline, whole."""
    write_bytes(path, (json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode())


def place_file(source: Path, target: Path) -> bool:
    """A file under another name: a hard link, else a reflink, else a copy; tells whether it is a hard link.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() and target.samefile(source):
            return True
        target.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            os.link(source, target)
            return True
    except OSError as error:
        raise OutputError(f"{target}: cannot be written ({error.strerror})") from error

    def copy(temporary: Path) -> None:
        if not _cloned(source, temporary):
            shutil.copyfile(source, temporary)

    write_whole(target, copy)
    return False


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as handle:
        return (
            hashlib.file_digest(handle, "sha256").hexdigest()
            if hasattr(hashlib, "file_digest")
            else hashlib.sha256(handle.read()).hexdigest()
        )


def remove_leftovers(folder: Path) -> None:
    """Delete the temporary files that a killed run left below `folder`."""
    for leftover in folder.rglob(TEMPORARY_PREFIX + "*"):
        leftover.unlink(missing_ok=True)


def _put(path: Path, data: bytes) -> None:
    with path.open("wb") as handle:
        handle.write(data)


def _cloned(source: Path, target: Path) -> bool:
    try:
        import fcntl
    except ImportError:  # Windows
        return False
    try:
        with source.open("rb") as reader, target.open("wb") as writer:
            fcntl.ioctl(writer.fileno(), _FICLONE, reader.fileno())
    except OSError:
        return False
    return True

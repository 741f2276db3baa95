"""Results of nodes, kept on disk under the hash of everything that they depend on.

What a node gives depends on its op, the op's source, its parameters, its random
stream and the images that it reads: a key is the hash of those, and the key of an
image that a node made stands for the image.  So one node that changes has another
key, and so has all that follows it, and nothing else.

A file that is broken is one that is not there; the folder keeps to its limit (each
run that writes at the same time may exceed it by an eighth); a folder that cannot be
written makes a run slower, not wrong.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import inspect
import json
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd import __version__
from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ImageError, OutputError
from synfog_usd.base.files import TEMPORARY_PREFIX
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph.op import Op

FORMAT = "synfog-node/1"
LIMIT_BYTES = 2 << 30
MOST_FILES = 10_000
LEFTOVER_S = 3600.0
"""A part of a file this old was left by a run that was killed."""

WAITING = 3
"""Images that may wait to be written: at 1920 x 1080 with three channels 75 MB."""

_ENTRY = re.compile(r"[0-9a-f]{64}\.node")
_LIBRARIES = ("numpy", "scipy", "OpenImageIO", "colour-science", "colour-demosaicing")


def default_folder() -> Path:
    """Where the desktop wants caches: $XDG_CACHE_HOME/synfog-usd, else ~/.cache/synfog-usd."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(home) if Path(home).is_absolute() else Path.home() / ".cache") / "synfog-usd"


class Cache:
    """A folder of results.

    Args:
        folder: made when something is kept; several runs may share it.
        limit_bytes: the folder's size [byte] beyond which the files used longest ago go.

    Raises:
        OutputError: the folder cannot be made.
    """

    def __init__(self, folder: Path, *, limit_bytes: int = LIMIT_BYTES) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"{folder}: results cannot be kept there ({error.strerror}); name another folder, or keep none"
            ) from error
        self.folder, self.limit_bytes = folder, limit_bytes
        self._size, self._count = self._tidied()
        self._unseen = 0
        """Bytes written since the folder was looked at; others may write there too."""
        self._writer = ThreadPoolExecutor(1, "synfog-cache")
        self._room = threading.Semaphore(WAITING)
        self._pending: list[Future[None]] = []

    def has(self, key: str) -> bool:
        """Whether there is a result; whether it is whole shows when it is read."""
        return self._path(key).is_file()

    def get(self, key: str) -> Image | None:
        """A result, or None where there is none; a file that is not whole is deleted."""
        path = self._path(key)
        try:
            image = _read(path, key)
            os.utime(path)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, ImageError):
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        return image

    def put(self, key: str, image: Image) -> None:
        """Keep a result; it is written beside the run, which `flush` waits for.

        One that would not come back as it is (what its provenance holds is not
        JSON), or is larger than the folder may be, is not kept.
        """
        head = _head(key, image)
        if head is None or len(head) + _bytes_of(image) > self.limit_bytes:
            return
        self._room.acquire()
        self._pending.append(self._writer.submit(self._write, key, head, image))

    def flush(self) -> None:
        """Wait until everything is written."""
        for future in self._pending:
            future.result()
        self._pending.clear()

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.node"

    def _write(self, key: str, head: bytes, image: Image) -> None:
        temporary = self.folder / f"{TEMPORARY_PREFIX}{os.getpid()}-{key}.node"
        try:
            with temporary.open("wb") as handle:
                handle.write(head)
                for plane in _planes(image):
                    handle.write(plane.data)
            temporary.replace(self._path(key))
            length = len(head) + _bytes_of(image)
            self._size, self._count, self._unseen = self._size + length, self._count + 1, self._unseen + length
            if self._size > self.limit_bytes or self._count > MOST_FILES or self._unseen > self.limit_bytes // 8:
                self._size, self._count = self._tidied()
                self._unseen = 0
        except OSError:  # full, or not ours to write: the next run computes what is missing
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        finally:
            self._room.release()

    def _tidied(self) -> tuple[int, int]:
        """Size [byte] and count of the files that stay; those used longest ago go first, down to four fifths of the
        limits.
        """
        entries = []
        with contextlib.suppress(OSError), os.scandir(self.folder) as items:
            for item in items:
                with contextlib.suppress(OSError):
                    status = item.stat(follow_symlinks=False)
                    if _ENTRY.fullmatch(item.name):
                        entries.append((status.st_mtime_ns, status.st_size, item.path))
                    elif item.name.startswith(TEMPORARY_PREFIX) and time.time() - status.st_mtime > LEFTOVER_S:
                        Path(item.path).unlink()
        size, count = sum(entry[1] for entry in entries), len(entries)
        over = size > self.limit_bytes or count > MOST_FILES
        for _, length, path in sorted(entries):
            if not over or (size <= 0.8 * self.limit_bytes and count <= 0.8 * MOST_FILES):
                break
            with contextlib.suppress(OSError):
                Path(path).unlink(missing_ok=True)
                size, count = size - length, count - 1
        return size, count


def image_key(image: Image, unsaid: Iterable[str] = ()) -> str | None:
    """SHA-256 of an image, pixels, meaning and provenance; None where that is not JSON.

    Args:
        image: any.
        unsaid: keys of the provenance that do not count.
    """
    head = _metadata(
        image.with_pixels(
            image.pixels,
            variance=image.variance,
            provenance={k: v for k, v in image.provenance.items() if k not in set(unsaid)},
        )
    )
    if head is None:
        return None
    digest = hashlib.sha256(head.encode())
    for plane in _planes(image):
        digest.update(plane.data)
    return digest.hexdigest()


def node_key(
    op: Op, params: Mapping[str, Any], stream: tuple[int, str] | None, sources: Iterable[str | None]
) -> str | None:
    """Key of what a node gives; None where something that it depends on has no hash.

    Args:
        op: what it does.
        params: by name, plain values.
        stream: seed and name of the node, where it draws.
        sources: keys of the images that it reads.
    """
    source, images = op_version(op.function), list(sources)
    if source is None or None in images:
        return None
    try:
        text = json.dumps([FORMAT, op.name, source, params, stream, images], sort_keys=True)
    except (TypeError, ValueError):
        return None
    return hashlib.sha256(text.encode()).hexdigest()


def op_version(function: Callable[..., Image]) -> str | None:
    """Hash of an op's source: its folder and what the package shares, or, for an own op, its file.

    None for a function without a file, and for one that holds variables of the
    function around it, which the file does not tell.
    """
    try:
        file = inspect.getsourcefile(function)
    except TypeError:
        return None
    if file is None or not Path(file).is_file() or getattr(function, "__closure__", None):
        return None
    return _source_hash(Path(file))


@functools.cache
def _source_hash(file: Path) -> str:
    package = Path(__file__).resolve().parents[2]
    folders = (package, package / "graph", file.parent) if file.resolve().is_relative_to(package) else ()
    digest = hashlib.sha256(f"{__version__} {sys.version} {_library_versions()}".encode())
    for folder in folders:
        digest.update(_folder_hash(folder))
    digest.update(file.read_bytes())
    return digest.hexdigest()


@functools.cache
def _folder_hash(folder: Path) -> bytes:
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()


@functools.cache
def _library_versions() -> str:
    versions = []
    for name in _LIBRARIES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            text = importlib.metadata.distribution(name).read_text("METADATA") or ""  # `version` parses it as a mail
            versions.append(f"{name} {next((line for line in text.splitlines() if line.startswith('Version:')), '')}")
    return ", ".join(versions)


def _planes(image: Image) -> list[FloatArray]:
    return [np.ascontiguousarray(plane) for plane in (image.pixels, image.variance) if plane is not None]


def _bytes_of(image: Image) -> int:
    return image.pixels.nbytes * (1 if image.variance is None else 2)


def _metadata(image: Image) -> str | None:
    """Everything of an image but its numbers, as JSON; None where JSON would change it."""
    provenance = dict(image.provenance)
    metadata = {
        "shape": list(image.pixels.shape),
        "channels": list(image.channels),
        "quantity": image.quantity.value,
        "variance": image.variance is not None,
        "provenance": provenance,
    }
    try:
        text = json.dumps(metadata)
        return text if json.loads(text)["provenance"] == provenance else None
    except (TypeError, ValueError):
        return None


def _head(key: str, image: Image) -> bytes | None:
    """First line: format, key and hash of the rest; second line: metadata as JSON."""
    metadata = _metadata(image)
    if metadata is None:
        return None
    body = f"{metadata}\n".encode()
    digest = hashlib.sha256(body)
    for plane in _planes(image):
        digest.update(plane.data)
    return f"{FORMAT} {key} {digest.hexdigest()}\n".encode() + body


def _read(path: Path, key: str) -> Image:
    """The image in a file.

    Raises:
        OSError, ValueError, KeyError, TypeError, ImageError: it is not there, or not what was written.
    """
    with path.open("rb") as handle:
        label, name, digest = handle.readline(200).decode("ascii").split()
        body = handle.readline(1 << 20)
        numbers = np.fromfile(handle, dtype=np.float32)
    checked = hashlib.sha256(body)
    checked.update(numbers.data)
    if (label, name, digest) != (FORMAT, key, checked.hexdigest()):
        raise ValueError("not what was written")
    metadata = json.loads(body)
    shape = tuple(metadata["shape"])
    planes = numbers.reshape((2 if metadata["variance"] else 1, *shape))
    return Image(
        planes[0],
        tuple(metadata["channels"]),
        Quantity(metadata["quantity"]),
        planes[1] if metadata["variance"] else None,
        metadata["provenance"],
    )

"""Numbers in the tags of a TIFF file (DNG is one), as far as the file can be read.

Takes any bytes, damaged ones too.  A directory that cannot be read ends its chain; a tag that cannot be is an error
only for who asks for it.  tifffile leaves such a tag out, so a black level would be missed without a word.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from synfog_usd.base.errors import ImageError

MOST_DIRECTORIES = 256
MOST_ENTRIES = 4096
"""Of a directory; cameras write some hundred."""

MOST_BYTES = 1 << 20
"""Of one tag's value; a row of 65 535 fractions has half of it."""

SUB_IFDS, DNG_VERSION = 330, 50706

_NUMBERS = {1: "u1", 3: "u2", 4: "u4", 5: "u4", 6: "i1", 8: "i2", 9: "i4", 10: "i4", 11: "f4", 12: "f8", 13: "u4"} | {
    16: "u8",
    17: "i8",
    18: "u8",
}
"""TIFF's type -> numpy's, less the byte order; those of `_FRACTIONS` come in pairs."""

_FRACTIONS = (5, 10)
_BYTES = {2: 1, 7: 1} | {kind: int(name[1]) * (2 if kind in (5, 10) else 1) for kind, name in _NUMBERS.items()}


@dataclass(frozen=True)
class _Entry:
    kind: int
    count: int
    data: bytes  # shorter than it should be where the file ends


@dataclass(frozen=True)
class Directory:
    """One directory of a TIFF file, with the tags that were asked for."""

    path: Path
    order: str
    entries: dict[int, _Entry]

    def __contains__(self, code: int) -> bool:
        return code in self.entries

    def numbers(self, code: int, name: str, count: int | None = None) -> npt.NDArray[np.float64]:
        """The finite numbers of a tag, float64, one dimension, at least one.

        Args:
            code: the tag's.
            name: its name, for errors.
            count: how many there must be; None: any.

        Raises:
            ImageError: no such tag, another count, no numbers, not finite, or the file ends before them.
        """
        if code not in self.entries:
            raise ImageError(f"{self.path}: its main image has no {name} (tag {code})")
        entry = self.entries[code]
        where = f"{self.path}: its {name} (tag {code})"
        if entry.kind not in _NUMBERS:
            raise ImageError(f"{where} is of TIFF's type {entry.kind}; numbers are needed. The file is damaged")
        if entry.count < 1 or (count is not None and entry.count != count):
            raise ImageError(f"{where} has {entry.count} numbers; {'some' if count is None else count} are needed")
        if len(entry.data) < entry.count * _BYTES[entry.kind]:
            raise ImageError(f"{where} has {entry.count} numbers, more than can be read. The file is damaged")
        values = np.frombuffer(entry.data, self.order + _NUMBERS[entry.kind]).astype(np.float64)
        if entry.kind in _FRACTIONS:
            with np.errstate(divide="ignore", invalid="ignore"):
                values = values[::2] / values[1::2]
        if not np.isfinite(values).all():
            raise ImageError(f"{where} has a number that is not finite. The file is damaged")
        return values

    def whole(self, code: int, name: str, default: int | None = None) -> int:
        """The first number of a tag, cut to a whole one."""
        if default is not None and code not in self.entries:
            return default
        return int(self.numbers(code, name)[0])


def directories(path: Path, codes: Collection[int]) -> list[Directory]:
    """Directories of a TIFF file: the chain from the header, each followed by its sub-directories.

    Args:
        path: any file.
        codes: tags whose values are wanted.

    Returns:
        Those that can be read; none of a file that is no TIFF.  A chain that leads back into itself ends there.
    """
    with path.open("rb") as file:
        head = file.read(16)
        order = {b"II": "<", b"MM": ">"}.get(head[:2], "")
        if not order or len(head) < 16:
            return []
        version = struct.unpack(order + "H", head[2:4])[0]
        if version not in (42, 43):
            return []
        big = version == 43
        first = struct.unpack(order + ("Q" if big else "I"), head[8:16] if big else head[4:8])[0]
        return list(_walk(file, path, first, order, big, {SUB_IFDS, *codes}, set()))


def _walk(
    file: BinaryIO, path: Path, offset: int, order: str, big: bool, codes: Collection[int], visited: set[int]
) -> Iterator[Directory]:
    while offset and offset not in visited and len(visited) < MOST_DIRECTORIES:
        visited.add(offset)
        entries, offset = _directory(file, offset, order, big, codes)
        if entries is None:
            return
        directory = Directory(path, order, entries)
        yield directory
        if SUB_IFDS in entries and len(visited) < MOST_DIRECTORIES:
            try:
                places = directory.numbers(SUB_IFDS, "SubIFDs")
            except ImageError:
                continue
            for place in places[:MOST_DIRECTORIES]:
                yield from _walk(file, path, int(place), order, big, codes, visited)


def _directory(
    file: BinaryIO, offset: int, order: str, big: bool, codes: Collection[int]
) -> tuple[dict[int, _Entry] | None, int]:
    """Wanted entries of the directory at an offset, and where the next one is; None, 0 where it cannot be read."""
    count_form, entry_form, link_form = ("Q", "HHQ8s", "Q") if big else ("H", "HHI4s", "I")
    count_bytes, entry_bytes = struct.calcsize(order + count_form), struct.calcsize(order + entry_form)
    counted = _bytes_at(file, offset, count_bytes)
    if len(counted) < count_bytes:
        return None, 0
    count = struct.unpack(order + count_form, counted)[0]
    if not 0 < count <= MOST_ENTRIES:
        return None, 0
    table = file.read(count * entry_bytes)
    if len(table) < count * entry_bytes:
        return None, 0
    link = file.read(struct.calcsize(order + link_form))
    following = struct.unpack(order + link_form, link)[0] if len(link) == struct.calcsize(order + link_form) else 0
    entries: dict[int, _Entry] = {}
    for code, kind, number, value in struct.iter_unpack(order + entry_form, table):
        if code not in codes or code in entries:
            continue
        size = number * _BYTES.get(kind, 0)
        place = struct.unpack(order + link_form, value)[0]
        data = value[:size] if size <= len(value) else _bytes_at(file, place, min(size, MOST_BYTES + 1))
        entries[code] = _Entry(kind, number, data if size <= MOST_BYTES else b"")
    return entries, following


def _bytes_at(file: BinaryIO, offset: int, size: int) -> bytes:
    if offset >= 1 << 62:
        return b""
    file.seek(offset)
    return file.read(size)

"""Binary layers (.usdc), as far as sizes go: what a file unpacks to, before it is unpacked.

Takes a file; gives the number of elements of its arrays, and of rows of its own tables.  A list of equal numbers packs
four thousand to one, so that 0.6 MB ask for gigabytes.  Damage is left for the USD library to tell, but for that of
the table of paths, in which the library walks without end, and of lengths of lists, for which it takes memory at once.
Source: layout of crate files as in OpenUSD's crateFile.h, crateDataTypes.h and integerCoding.h, versions 0.4 to 0.13.
"""

from __future__ import annotations

import contextlib
import mmap
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import imagecodecs
import numpy as np

_Told = TypeVar("_Told")

_MAGIC = b"PXR-USDC"
_TIME_SAMPLES = 46
"""Number of the type that holds the values of an attribute over time."""

_OF_ARRAYS = {
    **dict.fromkeys((1, 2), 1),
    **dict.fromkeys((3, 4, 8, 10, 11, 12, 21, 57), 4),
    **dict.fromkeys((5, 6, 9, 18, 20, 22, 29, 56), 8),
    **{7: 2, 13: 32, 14: 72, 15: 128, 16: 32, 17: 16, 19: 16, 23: 24, 24: 12, 25: 6, 26: 12, 27: 32, 28: 16, 30: 16},
}
"""Bytes of an element of an array that is not packed, by the number of its type."""

_OF_LISTS = {40: 4, 41: 4, 45: 8, 48: 8, 49: 16, 50: 4}
"""Bytes of an element of lists of paths, words, chosen variants, numbers, offsets of layers, and strings."""

_OF_LIST_OPS = {32: 4, 33: 4, 34: 4, 36: 4, 37: 8, 38: 4, 39: 8, 35: None, 54: None, 55: None}
"""The same of lists that are edited; None where elements are not of one size, and have four bytes at least."""

_DICTIONARY = 31
_LONG = frozenset((*_OF_LISTS, *_OF_LIST_OPS, _DICTIONARY, _TIME_SAMPLES))
"""Types of values that say how long they are, beside arrays."""

_ENTRY = 12
"""Bytes of a dictionary's entry, at least: its name, and how far on its value is."""

_DEEPEST = 64
"""Dictionaries within dictionaries that are looked into."""

_TABLES = {b"TOKENS": 2, b"STRINGS": 1, b"FIELDS": 1, b"FIELDSETS": 1, b"PATHS": 2, b"SPECS": 1}
"""Sections, and how many numbers at their begin say what USD makes room for before it reads on: rows, and of tokens
letters too; of paths the rows twice.
"""

_WITH_PACKED_PATHS = (0, 4), (0, 13)
"""First and last version whose paths are read here; a later one is left to the library."""

_LEAF = -2
"""In the table of jumps: neither children nor siblings that follow.  -1 are children only, 0 siblings only, and a
greater number both, the siblings so many rows on.
"""

_AT_ONCE = 1 << 20
"""Packed numbers that are unpacked in one go, which bounds what lies between; a multiple of four."""

_MOST_SAMPLES = 1_000_000
_MOST_FIELDS = 1 << 28


def array_sizes(path: Path) -> Iterator[int]:
    """Elements of each array of a binary layer that is packed, those of time samples too; nothing for any other file.

    Of a package those of all its layers.  Arrays that are not packed cannot be larger
    than their file.  Of a damaged file as many as can be found.
    """
    yield from _of_layers(path, _array_sizes)


def table_sizes(path: Path) -> Iterator[int]:
    """Rows that the tables of a binary layer say that they have, and letters of its words; nothing for any other file.

    One wrong byte makes some hundred rows billions, for which USD takes memory at once.  Packages and damage as for
    `array_sizes`.
    """
    yield from _of_layers(path, _table_sizes)


def faults_of_paths(path: Path) -> Iterator[str]:
    """What is wrong with the table of paths of a binary layer, each in some words; nothing for any other file.

    One wrong byte in it lets the library come by the same rows again and again, for a minute and gigabytes.  Takes
    0.1 s for a million paths.  Packages as for `array_sizes`.
    """
    yield from _of_layers(path, _faults_of_paths)


def impossible_lengths(path: Path) -> Iterator[int]:
    """Elements of each list and array of a binary layer that says it is longer than the file, but of arrays that are
    packed; nothing for any other file.

    One wrong byte in the length of a list of seven words lets the library take 16 GB.  Packages as for `array_sizes`.
    """
    yield from _of_layers(path, _impossible_lengths)


def _of_layers(path: Path, told: Callable[[Any], Iterator[_Told]]) -> Iterator[_Told]:
    with path.open("rb") as file:
        try:
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:  # an empty file
            return
        with data, memoryview(data) as whole:
            for begin, end in _layers(path, whole):
                with whole[begin:end] as layer, contextlib.suppress(*_DAMAGE):
                    if layer[:8] == _MAGIC:
                        yield from told(layer)


_DAMAGE = (struct.error, ValueError, IndexError, OverflowError, zipfile.BadZipFile, imagecodecs.Lz4Error)


def _layers(path: Path, whole: Any) -> Iterator[tuple[int, int]]:
    """Where the bytes of a file begin and end, or of the files within a package, which packs nothing."""
    if whole[:2] != b"PK":
        yield 0, len(whole)
        return
    with contextlib.suppress(*_DAMAGE), zipfile.ZipFile(path) as package:
        for found in package.infolist():
            name, extra = struct.unpack_from("<HH", whole, found.header_offset + 26)
            begin = found.header_offset + 30 + name + extra
            yield begin, begin + found.file_size


def _sections(data: Any) -> dict[bytes, int]:
    """Where each begins."""
    (contents,) = struct.unpack_from("<q", data, 16)
    (count,) = struct.unpack_from("<Q", data, contents)
    sections = {}
    for number in range(min(count, 64)):
        name, start, _ = struct.unpack_from("<16sqq", data, contents + 8 + 32 * number)
        sections[name.rstrip(b"\0")] = start
    return sections


def _table_sizes(data: Any) -> Iterator[int]:
    sections = _sections(data)
    for name, numbers in _TABLES.items():
        if name in sections:
            yield from struct.unpack_from(f"<{numbers}Q", data, sections[name])


def _faults_of_paths(data: Any) -> Iterator[str]:
    first, last = _WITH_PACKED_PATHS
    sections = _sections(data)
    if not first <= (data[8], data[9]) <= last or b"PATHS" not in sections or b"TOKENS" not in sections:
        return
    at = sections[b"PATHS"]
    paths, rows = struct.unpack_from("<QQ", data, at)
    (words,) = struct.unpack_from("<Q", data, sections[b"TOKENS"])
    at += 16
    columns = []
    for _ in range(3 if rows else 0):
        (packed,) = struct.unpack_from("<Q", data, at)
        try:
            columns.append(_integers(bytes(data[at + 8 : at + 8 + packed]), rows))
        except (imagecodecs.Lz4Error, IndexError):
            yield "cannot be unpacked"
            return
        at += 8 + packed
    if columns:
        numbers, elements, jumps = columns
        if int(numbers.min()) < 0 or int(numbers.max()) >= paths:
            yield "numbers a path that is not there"
        elif int(np.bincount(numbers).max()) > 1:
            yield "numbers a path twice"
        elif max(int(elements.max()), -int(elements.min())) >= words:
            yield "names a word that is not there"
        elif not _is_tree(jumps):
            yield "is no tree"


def _is_tree(jumps: Any) -> bool:
    """Whether a walk by the jumps (rows,) comes by each row once.

    A row stands before its children, and they before the siblings that follow it: so the siblings of a row that has
    children too stand behind the leaf that ends those children, as a bracket that opens is closed.
    """
    (at,) = np.nonzero((jumps > 0) | (jumps == _LEAF))
    opens = jumps[at] > 0
    level = np.cumsum(np.where(opens, 1, -1), dtype=np.int32)
    if int(jumps.min()) < _LEAF or not len(at) or at[-1] != len(jumps) - 1:
        return False
    if level[-1] != -1 or int(level[:-1].min(initial=0)) < 0:
        return False
    order = at[np.argsort(level + ~opens, kind="stable")]  # the last leaf, then by level, each that opens and its end
    opened, closed = order[1::2], order[2::2]
    return bool(np.all(opened + jumps[opened] == closed + 1))


def _integers(packed: bytes, count: int) -> Any:
    """Whole numbers int32 (count,): LZ4 of the commonest difference, two bits for each difference that say in how many
    bytes it follows, and those bytes.

    Raises:
        Lz4Error, IndexError: it is cut short or damaged.
    """
    begin = 4 + (2 * count + 7) // 8
    raw = np.frombuffer(_unpacked(packed, begin + 4 * count), np.uint8)
    if len(raw) < begin:
        raise IndexError
    differences = np.empty(count, np.int32)
    differences[:] = raw[:4].view("<i4")[0]
    at = begin
    for first in range(0, count, _AT_ONCE):
        bits = raw[4 + first // 4 : min(4 + (first + _AT_ONCE) // 4, begin)]
        codes = (bits[:, None] >> np.array([0, 2, 4, 6], np.uint8) & 3).ravel()[: count - first]
        ends = at + np.cumsum(_WIDTHS[codes], dtype=np.int64)
        for code, kind in ((1, "i1"), (2, "<i2"), (3, "<i4")):
            (which,) = np.nonzero(codes == code)
            width = int(_WIDTHS[code])
            pieces = raw[ends[which, None] + np.arange(-width, 0)]
            differences[first + which] = pieces.view(kind)[:, 0]
        at = int(ends[-1])
    return np.cumsum(differences, dtype=np.int32)


_WIDTHS = np.array([0, 1, 2, 4], np.uint8)
"""Bytes of a difference, by its two bits; none where it is the commonest."""


def _array_sizes(data: Any) -> Iterator[int]:
    version, sections = (data[8], data[9]), _sections(data)
    for rep in _reps(data, sections[b"FIELDS"], version) if b"FIELDS" in sections else ():
        yield from _of_rep(data, rep, version)


def _reps(data: Any, start: int, version: tuple[int, int]) -> Any:
    """What the fields of a file hold: one whole number each."""
    (fields,) = struct.unpack_from("<Q", data, start)
    if fields > _MOST_FIELDS:
        return []
    if version < (0, 4):
        return np.frombuffer(data, dtype="<u8", count=2 * fields, offset=start + 8)[1::2].tolist()
    (packed,) = struct.unpack_from("<Q", data, start + 8)
    at = start + 16 + packed
    (packed,) = struct.unpack_from("<Q", data, at)
    made = _unpacked(bytes(data[at + 8 : at + 8 + packed]), 8 * fields)
    return np.frombuffer(made[: len(made) // 8 * 8], dtype="<u8").tolist()


def _unpacked(packed: bytes, size: int) -> bytes:
    """One block of LZ4, or several behind a count and their sizes."""
    if packed[0] == 0:
        return bytes(imagecodecs.lz4_decode(packed[1:], header=False, out=size))
    made, at = b"", 1
    for _ in range(packed[0]):
        (length,) = struct.unpack_from("<i", packed, at)
        block = packed[at + 4 : at + 4 + length]
        made += bytes(imagecodecs.lz4_decode(block, header=False, out=min(size - len(made), 0x7E000000)))
        at += 4 + length
    return made


def _of_rep(data: Any, rep: int, version: tuple[int, int], *, nested: bool = False) -> Iterator[int]:
    is_array, is_inlined, is_packed = rep >> 63 & 1, rep >> 62 & 1, rep >> 61 & 1
    kind, place = rep >> 48 & 0xFF, rep & ((1 << 48) - 1)
    if not place or (is_inlined and not is_array):  # of arrays USD does not ask whether they are inlined
        return
    if is_array and is_packed:
        if version < (0, 5):
            place += 4  # the number of dimensions
        yield struct.unpack_from("<Q" if version >= (0, 7) else "<I", data, place)[0]
    elif kind == _TIME_SAMPLES and not nested:
        times = place + struct.unpack_from("<q", data, place)[0]
        values = times + 8 + struct.unpack_from("<q", data, times + 8)[0]
        (count,) = struct.unpack_from("<Q", data, values)
        for number in range(min(count, _MOST_SAMPLES)):
            (inner,) = struct.unpack_from("<Q", data, values + 8 + 8 * number)
            yield from _of_rep(data, inner, version, nested=True)


def _impossible_lengths(data: Any) -> Iterator[int]:
    version, sections = (data[8], data[9]), _sections(data)
    reps = _reps(data, sections[b"FIELDS"], version) if b"FIELDS" in sections else ()
    for rep in reps:
        if not (rep >> 63 or (rep >> 48 & 0xFF in _LONG and not rep >> 62 & 1)):
            continue
        with contextlib.suppress(struct.error):  # it lies beyond the file, as the library will tell
            for length, least in _lengths(data, rep, version):
                if length * least > len(data):
                    yield length


def _lengths(data: Any, rep: int, version: tuple[int, int], depth: int = 0) -> Iterator[tuple[int, int]]:
    """Length of each list or array of a value that is not packed, and the least bytes of an element."""
    is_array, is_inlined, is_packed = rep >> 63 & 1, rep >> 62 & 1, rep >> 61 & 1
    kind, place = rep >> 48 & 0xFF, rep & ((1 << 48) - 1)
    if not place or (is_inlined and not is_array) or depth > _DEEPEST:
        return
    if is_array:
        if not is_packed:
            at = place + 4 if version < (0, 5) else place  # after the number of dimensions
            yield struct.unpack_from("<Q" if version >= (0, 7) else "<I", data, at)[0], _OF_ARRAYS.get(kind, 1)
    elif kind in _OF_LISTS:
        yield struct.unpack_from("<Q", data, place)[0], _OF_LISTS[kind]
    elif kind in _OF_LIST_OPS:
        size, at = _OF_LIST_OPS[kind], place + 1
        for _ in range((data[place] >> 1).bit_count() if place < len(data) else 0):
            (length,) = struct.unpack_from("<Q", data, at)
            yield length, size or 4
            if size is None:
                return
            at += 8 + size * length
    elif kind == _DICTIONARY:
        (length,) = struct.unpack_from("<Q", data, place)
        yield length, _ENTRY
        at = place + 8
        for _ in range(min(length, len(data) // _ENTRY)):
            inner = at + 4 + struct.unpack_from("<q", data, at + 4)[0]
            if inner <= at:
                return
            yield from _lengths(data, struct.unpack_from("<Q", data, inner)[0], version, depth + 1)
            at = inner + 8
    elif kind == _TIME_SAMPLES:
        times = place + struct.unpack_from("<q", data, place)[0]
        yield from _lengths(data, struct.unpack_from("<Q", data, times)[0], version, depth + 1)
        values = times + 8 + struct.unpack_from("<q", data, times + 8)[0]
        (count,) = struct.unpack_from("<Q", data, values)
        yield count, 8
        for number in range(min(count, _MOST_SAMPLES)):
            (inner,) = struct.unpack_from("<Q", data, values + 8 + 8 * number)
            if inner >> 48 & 0xFF != _TIME_SAMPLES:
                yield from _lengths(data, inner, version, depth + 1)

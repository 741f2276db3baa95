"""Binary layers whose values have types that USD's own library does not write."""

import struct

import imagecodecs
import numpy as np

from synfog_usd.stage import crate

BOOL, INT, INT64, HALF, FLOAT, DOUBLE, STRING, TOKEN = 1, 3, 5, 7, 8, 9, 10, 11
"""Numbers of types in the file."""


def bits(number):
    """A float as it stands within a field; doubles that are none but floats stand there as such."""
    return struct.unpack("<I", struct.pack("<f", number))[0]


def inlined(path, kind):
    """What stands in the fields of a type, in the file's order."""
    return [rep & (1 << 48) - 1 for rep in _reps(path.read_bytes()) if rep >> 48 == 0x4000 | kind]


def retype(path, old, new):
    """Give the fields with a (type, what stands in them) another type and content, both (type, content)."""
    data = bytearray(path.read_bytes())
    reps = np.array(_reps(data), dtype=np.uint64)
    hit = reps == _rep(*old)
    assert hit.any(), f"{path}: no field {old}"
    reps[hit] = _rep(*new)
    start = crate._sections(data)[b"FIELDS"]
    (names,) = struct.unpack_from("<Q", data, start + 8)
    block = b"\0" + imagecodecs.lz4_encode(reps.tobytes(), header=False)
    table = bytes(data[start : start + 16 + names]) + struct.pack("<Q", len(block)) + block
    (contents,) = struct.unpack_from("<q", data, 16)
    struct.pack_into("<qq", data, data.index(b"FIELDS\0", contents) + 16, len(data), len(table))
    path.write_bytes(data + table)


def _reps(data):
    return crate._reps(data, crate._sections(data)[b"FIELDS"], (data[8], data[9]))


def _rep(kind, content):
    return (0x4000 | kind) << 48 | content

"""Binary layers with what USD's own library does not write: other types of values, counts that are wrong.

Source: layout of crate files as in OpenUSD's crateFile.h and crateDataTypes.h, version 0.8.
"""

import struct

import imagecodecs
import numpy as np

BOOL, INT, INT64, HALF, FLOAT, DOUBLE, STRING, TOKEN = 1, 3, 5, 7, 8, 9, 10, 11
"""Numbers of types in the file."""


def bits(number):
    """A float as it stands within a field; doubles that are none but floats stand there as such."""
    return struct.unpack("<I", struct.pack("<f", number))[0]


def inlined(path, kind):
    """What stands in the fields of a type, in the file's order."""
    _, _, reps = _fields(path.read_bytes())
    return [int(rep) & (1 << 48) - 1 for rep in reps if int(rep) >> 48 == 0x4000 | kind]


def retype(path, old, new):
    """Give the fields with a (type, what stands in them) another type and content, both (type, content)."""
    data = bytearray(path.read_bytes())
    start, end, reps = _fields(data)
    hit = reps == _rep(*old)
    assert hit.any(), f"{path}: no field {old}"
    reps[hit] = _rep(*new)
    block = b"\0" + imagecodecs.lz4_encode(reps.tobytes(), header=False)
    table = bytes(data[start:end]) + struct.pack("<Q", len(block)) + block
    struct.pack_into("<qq", data, _entry(data, "FIELDS") + 16, len(data), len(table))
    path.write_bytes(data + table)


def put(path, table, number):
    """Let a table say that it has so many rows."""
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, _begin(data, table), number)
    path.write_bytes(data)


def _entry(data, table):
    """Where the table of contents has a row of (name, begin, size)."""
    (contents,) = struct.unpack_from("<q", data, 16)
    return data.index(table.encode() + b"\0", contents)


def _begin(data, table):
    return struct.unpack_from("<q", data, _entry(data, table) + 16)[0]


def _fields(data):
    """(begin of the table, end of its names, what each field holds: its type in the high bits, as uint64)."""
    start = _begin(data, "FIELDS")
    count, names = struct.unpack_from("<QQ", data, start)
    end = start + 16 + names
    (packed,) = struct.unpack_from("<Q", data, end)
    block = bytes(data[end + 8 : end + 8 + packed])
    assert block[0] == 0, "one block of LZ4"
    return start, end, np.frombuffer(imagecodecs.lz4_decode(block[1:], header=False, out=8 * count), "<u8").copy()


def _rep(kind, content):
    return (0x4000 | kind) << 48 | content

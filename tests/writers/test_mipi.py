"""Packed RAW against bytes worked by hand, an unpacker by bits, and a parser of embedded data written from its tags."""

from __future__ import annotations

import numpy as np
import pytest

from synfog_usd.base import seeds
from synfog_usd.base.errors import ImageError, OutputError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers import write_output

LOW = {10: 2, 12: 4, 14: 6}
GROUP = {10: (4, 5), 12: (2, 3), 14: (4, 7)}
"""Pixels and bytes of a group."""


def mosaic(numbers, **provenance) -> Image:
    return Image(np.asarray(numbers, np.float32)[..., None], ("CFA",), Quantity.DN, provenance=provenance)


@pytest.mark.parametrize(
    ("bits", "numbers", "expected"),
    [
        (10, [0x3FF, 0x000, 0x155, 0x2AA], "ff 00 55 aa 93"),  # 11 | 00 << 2 | 01 << 4 | 10 << 6
        (10, [0x001, 0x002, 0x003, 0x004], "00 00 00 01 39"),
        (12, [0xABC, 0x123], "ab 12 3c"),
        (14, [0x3FFF, 0x0000, 0x0001, 0x2000], "ff 00 00 80 3f 10 00"),  # 63 | 0 << 6 | 1 << 12 | 0 << 18
    ],
)
def test_pixels_are_packed_as_worked_by_hand(tmp_path, bits, numbers, expected):
    path = write_output(f"a.raw{bits}", mosaic([numbers]), tmp_path)
    assert path.read_bytes().hex(" ") == expected


def unpacked(data: bytes, bits: int, width: int) -> np.ndarray:
    """(H, W) by Python's own long integers, a group at a time."""
    pixels, size = GROUP[bits]
    line = -(-width // pixels) * size
    rows = []
    for start in range(0, len(data), line):
        row = []
        for group in range(start, start + line, size):
            low = int.from_bytes(data[group + pixels : group + size], "little")
            row += [data[group + i] << LOW[bits] | low >> (LOW[bits] * i) & (1 << LOW[bits]) - 1 for i in range(pixels)]
        rows.append(row[:width])
    return np.array(rows)


@pytest.mark.parametrize("bits, shape", [(10, (5, 7)), (12, (1, 1)), (14, (6, 64))])
def test_every_number_comes_back(tmp_path, bits, shape):
    numbers = seeds.stream(1, "mipi", bits).integers(0, 2**bits, shape)
    path = write_output(f"a.raw{bits}", mosaic(numbers), tmp_path)
    np.testing.assert_array_equal(unpacked(path.read_bytes(), bits, shape[1]), numbers)


@pytest.mark.parametrize("bits", [10, 14])
def test_embedded_data_says_size_black_and_exposure(tmp_path, bits):
    """CCS: 0x0A begins a line; 0xAA and 0xA5 set the register, 0x5A gives its byte and steps on, 0x07 ends."""
    numbers = np.full((3, 200), 64)
    image = mosaic(numbers, black_level_dn=64, exposure_s=0.0123)
    data = write_output(f"a.raw{bits}", image, tmp_path, options={"embedded_lines": 2}).read_bytes()
    pixels, size = GROUP[bits]
    line = 200 // pixels * size
    assert len(data) == 5 * line
    np.testing.assert_array_equal(unpacked(data[2 * line :], bits, 200), numbers)
    seen = []
    for start in (0, line):
        here = [byte for place, byte in enumerate(data[start : start + line]) if place % size < pixels]
        padding = {byte for place, byte in enumerate(data[start : start + line]) if place % size >= pixels}
        assert padding == {0x55} and here[0] == 0x0A
        address, registers = 0, {}
        for tag, value in zip(here[1::2], here[2::2], strict=False):
            if tag == 0x07:
                break
            if tag == 0xAA:
                address = value << 8 | address & 0xFF
            elif tag == 0xA5:
                address = address & 0xFF00 | value
            else:
                assert tag == 0x5A
                registers[address] = value
                address += 1
        seen.append(registers)
    first, second = seen
    assert second == {}
    two = {address: first[address] << 8 | first[address + 1] for address in (0x0008, 0x0112, 0x0202, 0x034C, 0x034E)}
    assert two == {0x0008: 64, 0x0112: bits << 8 | bits, 0x0202: 1230, 0x034C: 200, 0x034E: 3}


@pytest.mark.parametrize(
    ("image", "name", "options", "error", "words"),
    [
        (mosaic([[1024.0]]), "a.raw10", {}, ImageError, "do not fit 10 bits, 0 to 1023; name the file a.raw12"),
        (mosaic([[np.nan]]), "a.raw12", {}, ImageError, "do not fit 12 bits"),
        (mosaic([[1.0]]), "a.raw12", {"embedded_lines": 1}, OutputError, "holds no embedded data"),
        (
            Image(np.zeros((2, 2, 3), np.float32), ("R", "G", "B"), Quantity.DISPLAY_RGB),
            "a.raw10",
            {},
            ImageError,
            "takes the DN of a mosaic; this image is display_rgb with R, G, B",
        ),
    ],
)
def test_what_does_not_fit_is_refused_and_leaves_no_file(tmp_path, image, name, options, error, words):
    with pytest.raises(error, match=words):
        write_output(name, image, tmp_path, options=options)
    assert not list(tmp_path.iterdir())

"""DNG files: the sensor's numbers, as any RAW program reads them.

Uncompressed 16-bit CFA, because every reader gets those numbers exactly.  All that
is not a pixel comes from the image's provenance, where `sensor.adc` put it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd import __version__
from synfog_usd.errors import ImageError
from synfog_usd.files import write_whole
from synfog_usd.image import Image, Quantity

FIXED_DATE = "2000:01:01 00:00:00"
"""A simulated picture was taken at no time; a clock's would change the bytes."""

NEEDED = (
    "black_level_dn",
    "white_level_dn",
    "xyz_to_camera",
    "as_shot_neutral",
    "noise_profile",
    "exposure_s",
    "f_number",
    "iso",
    "sensor_title",
    "cfa_pattern",
)

CROP_INSET_PX = 8
"""Border that demosaicing may spoil; readers crop it."""

_CFA = {"RGGB": (0, 1, 1, 2)}
_EXIF_IFD, _EXIF_PLACEHOLDER = 34665, 34664
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL, _DOUBLE = 1, 2, 3, 4, 5, 10, 12
_UNDEFINED = 7


def write_dng(path: Path, image: Image) -> None:
    """Write a mosaic of DN as DNG 1.4.

    Args:
        path: where to.
        image: DN, one channel, whole numbers from 0 to white level; its provenance
            has the keys in `NEEDED`.

    Raises:
        ImageError: another quantity, numbers that are not DN, or a fact missing.
        OutputError: it cannot be written.

    Source: Adobe, Digital Negative Specification 1.7.1; TIFF 6.0; CIPA DC-008 (Exif).
    """
    facts = image.provenance
    if image.quantity is not Quantity.DN or len(image.channels) != 1:
        raise ImageError(f"{path}: a DNG takes a DN mosaic of one channel; this image is {image.quantity.value} with {', '.join(image.channels)}")
    missing = [key for key in NEEDED if key not in facts]
    if missing:
        raise ImageError(f"{path}: a DNG needs {', '.join(missing)} in the image's provenance; sensor.adc puts it there")
    if facts["cfa_pattern"] not in _CFA:
        raise ImageError(f"{path}: colour filter pattern {facts['cfa_pattern']!r} cannot be written; it takes {', '.join(_CFA)}")
    numbers = image.pixels[..., 0]
    if not (np.isfinite(numbers).all() and numbers.min() >= 0.0 and numbers.max() <= facts["white_level_dn"] and (numbers == np.rint(numbers)).all()):
        raise ImageError(f"{path}: the pixels are not whole numbers from 0 to {facts['white_level_dn']}")
    raw = numbers.astype(np.uint16)
    write_whole(path, lambda temporary: _write(temporary, raw, facts))


def _write(temporary: Path, raw: np.ndarray, facts: Mapping[str, Any]) -> None:
    import tifffile

    height, width = raw.shape
    inset = CROP_INSET_PX if min(height, width) >= 4 * CROP_INSET_PX else 0
    title = _ascii(str(facts["sensor_title"]))
    black = int(facts["black_level_dn"])
    matrix = [value for row in facts["xyz_to_camera"] for value in row]
    tags = [
        (271, _ASCII, 0, "synfog-usd"),
        (272, _ASCII, 0, title),
        (274, _SHORT, 1, 1),
        (306, _ASCII, 0, FIXED_DATE),
        (33421, _SHORT, 2, (2, 2)),
        (33422, _BYTE, 4, bytes(_CFA[facts["cfa_pattern"]])),
        (_EXIF_PLACEHOLDER, _LONG, 1, 0),
        (50706, _BYTE, 4, bytes((1, 4, 0, 0))),
        (50707, _BYTE, 4, bytes((1, 3, 0, 0))),  # 1.3 is the first with NoiseProfile
        (50708, _ASCII, 0, f"synfog-usd {title}"),
        (50710, _BYTE, 3, bytes((0, 1, 2))),
        (50711, _SHORT, 1, 1),
        (50713, _SHORT, 2, (2, 2)),
        (50714, _RATIONAL, 4, (black, 1) * 4),
        (50717, _LONG, 1, int(facts["white_level_dn"])),
        (50718, _RATIONAL, 2, (1, 1, 1, 1)),
        (50719, _LONG, 2, (inset, inset)),
        (50720, _LONG, 2, (width - 2 * inset, height - 2 * inset)),
        (50721, _SRATIONAL, 9, _rationals(matrix, 10_000)),
        (50727, _RATIONAL, 3, (1, 1, 1, 1, 1, 1)),
        (50728, _RATIONAL, 3, _rationals(facts["as_shot_neutral"], 1_000_000)),
        (50730, _SRATIONAL, 1, (0, 1)),
        (50731, _RATIONAL, 1, (1, 1)),
        (50732, _RATIONAL, 1, (1, 1)),
        (50734, _RATIONAL, 1, (1, 1)),
        (50778, _SHORT, 1, 21),
        (50829, _LONG, 4, (0, 0, height, width)),
        (51041, _DOUBLE, 6, tuple(float(value) for value in facts["noise_profile"]) * 3),
    ]
    tifffile.imwrite(
        temporary,
        raw,
        byteorder="<",
        photometric="cfa",
        software=f"synfog-usd {__version__}",
        metadata=None,
        rowsperstrip=height,
        subfiletype=0,
        extratags=[(code, kind, count, value, True) for code, kind, count, value in tags],
    )
    _add_exif(temporary, _exif(facts))


def _exif(facts: Mapping[str, Any]) -> list[tuple[int, int, int, bytes]]:
    entries = [
        (33434, _RATIONAL, 1, struct.pack("<II", *_fraction(facts["exposure_s"]))),
        (33437, _RATIONAL, 1, struct.pack("<II", *_fraction(facts["f_number"]))),
        (34855, _SHORT, 1, struct.pack("<H", min(65535, round(facts["iso"])))),
        (36864, _UNDEFINED, 4, b"0231"),
        (36867, _ASCII, len(FIXED_DATE) + 1, FIXED_DATE.encode() + b"\0"),
    ]
    if "focal_length_mm" in facts:
        entries.append((37386, _RATIONAL, 1, struct.pack("<II", *_fraction(facts["focal_length_mm"]))))
    return entries


def _add_exif(path: Path, entries: list[tuple[int, int, int, bytes]]) -> None:
    """Append an Exif IFD and point the placeholder tag at it: tifffile writes no sub-IFD of its own."""
    data = bytearray(path.read_bytes())
    data += b"\0" * (len(data) % 2)
    start = len(data)
    table = struct.pack("<H", len(entries))
    tail, tail_start = b"", start + 2 + 12 * len(entries) + 4
    for code, kind, count, value in entries:
        if len(value) > 4:
            table += struct.pack("<HHII", code, kind, count, tail_start + len(tail))
            tail += value + b"\0" * (len(value) % 2)
        else:
            table += struct.pack("<HHI", code, kind, count) + value.ljust(4, b"\0")
    data += table + struct.pack("<I", 0) + tail
    (first_ifd,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, first_ifd)
    for index in range(count):
        place = first_ifd + 2 + 12 * index
        if struct.unpack_from("<H", data, place)[0] == _EXIF_PLACEHOLDER:
            struct.pack_into("<HHII", data, place, _EXIF_IFD, _LONG, 1, start)
            path.write_bytes(data)
            return
    raise AssertionError("the placeholder of the Exif IFD is not in the file")


def _rationals(values: Any, denominator: int) -> tuple[int, ...]:
    return tuple(number for value in values for number in (round(float(value) * denominator), denominator))


def _fraction(value: float) -> tuple[int, int]:
    """Numerator and denominator that fit 32 bits; short times come as 1/n where they are that."""
    fraction = Fraction(float(value)).limit_denominator(1_000_000)
    return fraction.numerator, fraction.denominator


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode("ascii")

"""DNG files: the sensor's numbers, as any RAW program reads them.

Takes a mosaic of DN behind any filter pattern; writes it as it is, 16 bits a pixel
or lossless JPEG.  All that is not a pixel comes from the image's provenance, where
`sensor.adc` (and, for HDR, `sensor.compand`) put it.  A number that its tag cannot hold (NaN, infinite, negative, too
large) is left out with its tag.  What programs do with the files stands in docs/camera.md.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.base.errors import ImageError
from synfog_usd.base.files import write_whole
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.version import __version__
from synfog_usd.camera.writers.opcodes import opcode_list

FIXED_DATE = "2000:01:01 00:00:00"
"""A simulated picture was taken at no time; a clock's would change the bytes."""

NEEDED = (
    "black_level_dn",
    "white_level_dn",
    "noise_profile",
    "exposure_s",
    "f_number",
    "iso",
    "sensor_title",
    "cfa_pattern",
)
"""What the provenance must say of every mosaic."""

NEEDED_OF_COLOUR = ("xyz_to_camera", "as_shot_neutral")
"""And of one behind three or four different filters."""

NEEDED_OF_HDR = ("linear_black_dn", "linear_white_dn")
"""And of companded numbers."""

PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR", "RCCB", "RCCC", "RGIB", "MONO")

CROP_INSET_PX = 8
"""Border that demosaicing may spoil; readers crop it."""

MAX_DN = 65535

MOST_FRAMES_PER_S = 2**31 / 1001
"""What a signed fraction of a denominator up to 1001 can hold."""

_CODES = {"R": 0, "G": 1, "B": 2, "C": 1, "I": 6}
"""Filter -> colour code of CFAPattern (TIFF/EP).

A clear filter is called green, for darktable crashes at white; its row of the
matrices says what it sees.  Infrared has no code: it is called white, no colour.
"""

_GREY = ("MONO", "RCCC")
"""Patterns without colour: written as LinearRaw of one sample, which readers show as grey."""

_PLANES = "RGCBI"
"""Order of the colour planes: a clear filter stands where readers expect green, so that they take RCCB for a Bayer
mosaic.
"""

_FILTERS = "RGBCI"
"""Order in which the provenance tells of filters."""

_LINEAR_RAW = 34892
_LOSSLESS_JPEG = 7
_EXIF_IFD, _EXIF_PLACEHOLDER, _PHOTOMETRIC = 34665, 34664, 262
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _UNDEFINED, _SRATIONAL, _DOUBLE = 1, 2, 3, 4, 5, 7, 10, 12

Tag = tuple[int, int, int, Any]
"""Number, type, count and value, as tifffile takes them."""


def write_dng(
    path: Path, image: Image, *, compression: Literal["none", "lossless"] = "none", corrections: bool = True
) -> None:
    """Write a mosaic of DN as DNG 1.4.

    Args:
        path: where to.
        image: DN, one channel, whole numbers from 0 to white level; its provenance
            has the keys in `NEEDED`, and `NEEDED_OF_COLOUR` where it has colour; `xyz_to_camera_a` (for illuminant A)
            and `lens_title` if known. With `companding` ([[linear_dn, code], ...]) the numbers are codes, and
            a LinearizationTable makes linear ones of them.
        compression: 'lossless' is lossless JPEG.
        corrections: say how readers may straighten the lens's lines and brighten its corners (OpcodeList3), as far
            as the provenance knows them.

    Raises:
        ImageError: another quantity, numbers that are not DN, a fact missing, or levels that are none.
        OutputError: it cannot be written.

    Source: Adobe, Digital Negative Specification 1.7.1; TIFF 6.0; CIPA DC-008 (Exif).
    """
    metadata = image.provenance
    if image.quantity is not Quantity.DN or len(image.channels) != 1:
        raise ImageError(
            f"{path}: a DNG takes a DN mosaic of one channel; this image is {image.quantity.value} with "
            f"{', '.join(image.channels)}"
        )
    _check_metadata(path, metadata)
    white = metadata["white_level_dn"]
    if white > MAX_DN:  # DNG has floats too, but dcraw and LibRaw 0.20 refuse them, and darktable 4.2 shows white
        raise ImageError(
            f"{path}: a DNG takes whole numbers of at most 16 bits; white_level_dn is {white}. Put sensor.compand "
            f"before it, or write an EXR"
        )
    numbers = image.pixels[..., 0]
    if not (
        np.isfinite(numbers).all()
        and numbers.min() >= 0.0
        and numbers.max() <= white
        and (numbers == np.rint(numbers)).all()
    ):
        raise ImageError(f"{path}: the pixels are not whole numbers from 0 to {white}")
    raw = numbers.astype(np.uint16)
    height, width = raw.shape
    opcodes = opcode_list(height, width, metadata) if corrections else b""
    write_whole(path, lambda temporary: _write(temporary, raw, metadata, opcodes, lossless=compression == "lossless"))


def _check_metadata(path: Path, metadata: Mapping[str, Any]) -> None:
    pattern = metadata.get("cfa_pattern")
    needed = [
        *NEEDED,
        *(NEEDED_OF_COLOUR if len(_planes(pattern)) > 2 else ()),
        *(NEEDED_OF_HDR if "companding" in metadata else ()),
    ]
    if missing := [key for key in needed if key not in metadata]:
        raise ImageError(
            f"{path}: a DNG needs {', '.join(missing)} in the image's provenance; sensor.adc puts it there"
        )
    levels = ("black_level_dn", "white_level_dn", *(NEEDED_OF_HDR if "companding" in metadata else ()))
    for key, value in (
        *((key, metadata[key]) for key in levels),
        ("dark_signal_dn", metadata.get("dark_signal_dn", 0)),
    ):
        if not math.isfinite(_number(value)):
            raise ImageError(f"{path}: {key} is {value}; a DNG takes a finite number of DN")
    black = _number(metadata["black_level_dn"]) + _number(metadata.get("dark_signal_dn", 0.0))
    white = _number(metadata["white_level_dn"])
    if not 0.0 <= round(black) < white:
        raise ImageError(f"{path}: black is {black:g} and white_level_dn {white:g}; a DNG takes 0 <= black < white")
    if pattern not in PATTERNS:
        raise ImageError(f"{path}: colour filter pattern {pattern!r} cannot be written; it takes {', '.join(PATTERNS)}")


def _planes(pattern: str | None) -> str:
    """The different filters of a pattern, in the order of the file's colour planes.

    >>> _planes("GRBG"), _planes("RCCB"), _planes("RGIB"), _planes("RCCC")
    ('RGB', 'RCB', 'RGBI', 'C')
    """
    return "C" if pattern in _GREY else "".join(letter for letter in _PLANES if letter in str(pattern))


def _write(
    temporary: Path, raw: npt.NDArray[np.uint16], metadata: Mapping[str, Any], opcodes: bytes, *, lossless: bool
) -> None:
    import tifffile

    grey = metadata["cfa_pattern"] in _GREY
    packed: dict[str, Any] = {}
    data: Any = raw
    if lossless:
        data = iter([_lossless_jpeg(raw, int(metadata["white_level_dn"]), pairs=not grey)])
        packed = {"shape": raw.shape, "dtype": raw.dtype, "compression": _LOSSLESS_JPEG, "bitspersample": 16}
    tags = [
        *_common_tags(raw.shape, metadata),
        *_level_tags(metadata),
        *([] if grey else _filter_tags(metadata["cfa_pattern"])),
        *_colour_tags(metadata),
        *([(51022, _UNDEFINED, len(opcodes), opcodes)] if opcodes else []),
    ]
    tifffile.imwrite(
        temporary,
        data,
        byteorder="<",
        photometric="minisblack" if grey else "cfa",
        software=f"synfog-usd {__version__}",
        metadata=None,
        rowsperstrip=raw.shape[0],
        subfiletype=0,
        extratags=[(code, kind, count, value, True) for code, kind, count, value in tags],
        **packed,
    )
    _finish(temporary, _exif(metadata), photometric=_LINEAR_RAW if grey else None)


def _lossless_jpeg(raw: npt.NDArray[np.uint16], white: int, *, pairs: bool) -> bytes:
    """The mosaic as one lossless JPEG.

    Neighbours in a row are two components where they are of two colours, so that
    each is predicted from its own; a row of odd length cannot be, and takes more room.
    """
    import imagecodecs

    height, width = raw.shape
    rows = raw.reshape(height, width // 2, 2) if pairs and width % 2 == 0 else raw
    return bytes(imagecodecs.jpeg_encode(rows, lossless=True, predictor=1, bitspersample=max(9, white.bit_length())))


def _common_tags(shape: tuple[int, int], metadata: Mapping[str, Any]) -> list[Tag]:
    height, width = shape
    inset = CROP_INSET_PX if min(height, width) >= 4 * CROP_INSET_PX else 0
    title = _ascii(metadata["sensor_title"])
    tags: list[Tag] = [
        (270, _ASCII, 0, f"colour filter array {metadata['cfa_pattern']}"),
        (271, _ASCII, 0, "synfog-usd"),
        (272, _ASCII, 0, title),
        (274, _SHORT, 1, 1),
        (306, _ASCII, 0, FIXED_DATE),
        (_EXIF_PLACEHOLDER, _LONG, 1, 0),
        (50706, _BYTE, 4, bytes((1, 4, 0, 0))),
        (50707, _BYTE, 4, bytes((1, 3, 0, 0))),  # 1.3 is the first with NoiseProfile
        (50708, _ASCII, 0, f"synfog-usd {title}"),
        (50718, _RATIONAL, 2, (1, 1, 1, 1)),
        (50719, _LONG, 2, (inset, inset)),
        (50720, _LONG, 2, (width - 2 * inset, height - 2 * inset)),
        *_fractions(50730, _SRATIONAL, [_log2(metadata.get("digital_gain", 1.0))], 10_000),  # BaselineExposure [EV]
        (50731, _RATIONAL, 1, (1, 1)),
        (50732, _RATIONAL, 1, (1, 1)),
        (50734, _RATIONAL, 1, (1, 1)),
        (50829, _LONG, 4, (0, 0, height, width)),
    ]
    if "frame_number" in metadata:
        tags += _clip_tags(_number(metadata["frame_number"]), _number(metadata.get("frames_per_s")))
    if "sensor_serial" in metadata:
        tags.append((50735, _ASCII, 0, _ascii(metadata["sensor_serial"])))
    return tags


def _clip_tags(number: float, per_s: float) -> list[Tag]:
    """CinemaDNG's FrameRate, and TimeCodes (SMPTE 12M, no frames dropped) up to its 40 frames a second."""
    if not 0.0 < per_s < MOST_FRAMES_PER_S:
        return []
    rate = Fraction(per_s).limit_denominator(1001)
    tags: list[Tag] = [(51044, _SRATIONAL, 1, (rate.numerator, rate.denominator))]
    whole = max(1, round(per_s))
    if whole < 40 and math.isfinite(number):
        seconds, frames = divmod(int(number), whole)
        address = (frames, seconds % 60, seconds // 60 % 60, seconds // 3600 % 24)
        tags.append((51043, _BYTE, 8, bytes([part // 10 << 4 | part % 10 for part in address]) + bytes(4)))
    return tags


def _level_tags(metadata: Mapping[str, Any]) -> list[Tag]:
    """Black and white; of companded numbers those behind the LinearizationTable, and the table."""
    black, white = (
        round(metadata["black_level_dn"] + metadata.get("dark_signal_dn", 0.0)),
        int(metadata["white_level_dn"]),
    )
    tags: list[Tag] = []
    if "companding" in metadata:
        table, black, white = linearisation(metadata)
        tags.append((50712, _SHORT, table.size, table))
    repeat = 1 if metadata["cfa_pattern"] in _GREY else 2
    return [
        *tags,
        (50713, _SHORT, 2, (repeat, repeat)),
        (50714, _RATIONAL, repeat**2, (black, 1) * repeat**2),
        (50717, _LONG, 1, white),
    ]


def linearisation(metadata: Mapping[str, Any]) -> tuple[npt.NDArray[np.uint16], int, int]:
    """How readers make linear numbers of companded ones.

    Args:
        metadata: provenance with companding, white_level_dn, linear_black_dn and
            linear_white_dn.

    Returns:
        The linear number of every code from 0 to white level, rounded; and black
        and white as linear numbers.  A linear white above 65535 is scaled to
        65535: the table has 16 bits.  Black stays a whole number, which readers
        take it for: the table is moved by what rounding it takes.  Below black the first piece goes on.
    """
    linear, codes = np.array(metadata["companding"], dtype=np.float64).T
    dark, bright = metadata["linear_black_dn"] + metadata.get("dark_signal_dn", 0.0), metadata["linear_white_dn"]
    black = round(dark * min(1.0, MAX_DN / bright))
    black = max(black, 1) if bright > MAX_DN and dark > 0.0 else black
    scale = min(1.0, (MAX_DN - black) / (bright - dark))
    every = np.arange(int(metadata["white_level_dn"]) + 1)
    table = np.interp(every, codes, linear)
    below = every < codes[0]
    table[below] = linear[0] + (every[below] - codes[0]) * (linear[1] - linear[0]) / (codes[1] - codes[0])
    whole = np.clip(np.rint((table - dark) * scale) + black, 0, MAX_DN).astype(np.uint16)
    return whole, black, black + round((bright - dark) * scale)


def _filter_tags(pattern: str) -> list[Tag]:
    planes = _planes(pattern)
    return [
        (33421, _SHORT, 2, (2, 2)),
        (33422, _BYTE, 4, bytes(_CODES[letter] for letter in pattern)),
        (50710, _BYTE, len(planes), bytes(_CODES[letter] for letter in planes)),
        (50711, _SHORT, 1, 1),
    ]


def _colour_tags(metadata: Mapping[str, Any]) -> list[Tag]:
    """Noise of every plane; matrices and neutral where there are planes enough for colour."""
    planes = _planes(metadata["cfa_pattern"])
    count = len(planes)
    noise = tuple(_number(value) for value in metadata["noise_profile"])
    tags: list[Tag] = (
        [(51041, _DOUBLE, 2 * count, noise * count)] if noise[0] > 0.0 and all(map(math.isfinite, noise)) else []
    )  # a slope of 0 is no legal profile
    if count < 3:
        return tags
    present = [letter for letter in _FILTERS if letter in planes]
    order = [present.index(letter) for letter in planes]

    matrices = []
    for key, illuminant in (("xyz_to_camera_a", 17), ("xyz_to_camera", 21)):
        values = [value for index in order for value in metadata[key][index]] if key in metadata else []
        matrices += [(matrix[1:], illuminant) for matrix in _fractions(50721, _SRATIONAL, values, 10_000) if values]
    for slot, (matrix, illuminant) in enumerate(matrices):  # dcraw takes the last, the others that for D65
        tags += [(50721 + slot, *matrix), (50778 + slot, _SHORT, 1, illuminant)]
    neutral = [metadata["as_shot_neutral"][index] for index in order]
    return [*tags, (50727, _RATIONAL, count, (1, 1) * count), *_fractions(50728, _RATIONAL, neutral, 1_000_000)]


def _exif(metadata: Mapping[str, Any]) -> list[tuple[int, int, int, bytes]]:
    entries = [
        *_fraction(33434, metadata["exposure_s"]),
        *_fraction(33437, metadata["f_number"]),
        *_short(34855, metadata["iso"]),
        (36864, _UNDEFINED, 4, b"0231"),
        (36867, *_text(FIXED_DATE)),
        *_signed_fraction(37380, metadata.get("exposure_bias_ev")),
        *_fraction(37386, metadata.get("focal_length_mm")),
    ]
    if "sensor_serial" in metadata:
        entries.append((42033, *_text(_ascii(metadata["sensor_serial"]))))
    if "lens_title" in metadata:
        entries.append((42036, *_text(_ascii(metadata["lens_title"]))))
    return entries


def _finish(path: Path, exif: Sequence[tuple[int, int, int, bytes]], *, photometric: int | None) -> None:
    """Append an Exif IFD and name it in IFD0, and set what tifffile would not: it writes no sub-IFD and no LinearRaw of
    one sample.
    """
    with path.open("r+b") as file:
        start = file.seek(0, 2)
        start += file.write(b"\0" * (start % 2))
        table = struct.pack("<H", len(exif))
        tail, tail_start = b"", start + 2 + 12 * len(exif) + 4
        for code, kind, count, value in exif:
            if len(value) > 4:
                table += struct.pack("<HHII", code, kind, count, tail_start + len(tail))
                tail += value + b"\0" * (len(value) % 2)
            else:
                table += struct.pack("<HHI", code, kind, count) + value.ljust(4, b"\0")
        file.write(table + struct.pack("<I", 0) + tail)
        changes = {_EXIF_PLACEHOLDER: struct.pack("<HHII", _EXIF_IFD, _LONG, 1, start)}
        if photometric is not None:
            changes[_PHOTOMETRIC] = struct.pack("<HHIHH", _PHOTOMETRIC, _SHORT, 1, photometric, 0)
        file.seek(4)
        (first_ifd,) = struct.unpack("<I", file.read(4))
        file.seek(first_ifd)
        (count,) = struct.unpack("<H", file.read(2))
        entries = file.read(12 * count)
        for index in range(count):
            (code,) = struct.unpack_from("<H", entries, 12 * index)
            if code in changes:
                file.seek(first_ifd + 2 + 12 * index)
                file.write(changes.pop(code))
        assert not changes, "a tag that is to be changed is not in the file"


def _number(value: float | str | None) -> float:
    """A number as float; NaN where it is none."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _log2(value: float) -> float:
    return math.log2(number) if (number := _number(value)) > 0.0 else math.nan


def _fractions(code: int, kind: int, values: Sequence[Any], denominator: int) -> list[Tag]:
    """A tag of fractions of one denominator; none where 32 bits cannot hold them all."""
    least, most = (-(2**31), 2**31 - 1) if kind == _SRATIONAL else (0, 2**32 - 1)
    scaled = [_number(value) * denominator for value in values]
    if not all(least - 0.5 < value < most + 0.5 for value in scaled):
        return []
    return [(code, kind, len(values), tuple(number for value in scaled for number in (round(value), denominator)))]


def _signed_fraction(code: int, value: float | None) -> list[tuple[int, int, int, bytes]]:
    """An Exif entry of a signed number in thousandths; none where 32 bits cannot hold it."""
    scaled = _number(value) * 1000.0
    return [(code, _SRATIONAL, 1, struct.pack("<ii", round(scaled), 1000))] if abs(scaled) < 2**31 - 1 else []


def _fraction(code: int, value: float | None) -> list[tuple[int, int, int, bytes]]:
    """An Exif entry of the fraction of 32 bits that is nearest; none where they cannot hold it.

    Short times come as 1/n where they are that.
    """
    number, most = _number(value), 2**32 - 1
    if not 0.0 <= number <= most or 0.0 < number < 1.0 / most:
        return []
    fraction = Fraction(number).limit_denominator(min(1_000_000, most // max(1, math.ceil(number))))
    if abs(fraction - number) > 1e-3 * number:  # a time below a millionth
        fraction = Fraction(1, round(1.0 / number))
    return [(code, _RATIONAL, 1, struct.pack("<II", fraction.numerator, fraction.denominator))]


def _short(code: int, value: float) -> list[tuple[int, int, int, bytes]]:
    """An Exif entry of a whole number of 16 bits; none where they cannot hold it."""
    number = _number(value)
    return [(code, _SHORT, 1, struct.pack("<H", round(number)))] if -0.5 < number < MAX_DN + 0.5 else []


def _text(text: str) -> tuple[int, int, bytes]:
    """Type, count and bytes of an ASCII entry."""
    return _ASCII, len(text) + 1, text.encode() + b"\0"


def _ascii(text: object) -> str:
    return str(text).encode("ascii", "replace").decode("ascii")

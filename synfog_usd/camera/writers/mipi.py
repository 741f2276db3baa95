"""RAW as it leaves the sensor: MIPI CSI-2's packed RAW10, RAW12 and RAW14, line by line, without a header.

Camera engineers feed such files to their drivers and ISPs.  Lines of embedded data stand before the picture and
say its size, black level and exposure in the words of MIPI's CCS.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.base.errors import ImageError, OutputError
from synfog_usd.base.files import write_whole
from synfog_usd.base.image import Image, Quantity

Bytes = npt.NDArray[np.uint8]

BITS = {".raw10": 10, ".raw12": 12, ".raw14": 14}
"""File suffix -> bits of a pixel."""

GROUP_PX = {10: 4, 12: 2, 14: 4}
"""Pixels that are packed together: a byte each of their upper bits, then all lower bits, the first pixel's first."""

LINE_START, LINE_END, REGISTER_HIGH, REGISTER_LOW, VALUE, SKIP = 0x0A, 0x07, 0xAA, 0xA5, 0x5A, 0x55
"""CCS: a line of embedded data begins with the first; then come pairs of a tag and a byte; the rest is filled with the
second."""

REGISTERS = {
    "data_pedestal": (0x0008, 2),
    "csi_data_format": (0x0112, 2),
    "coarse_integration_time": (0x0202, 2),
    "x_output_size": (0x034C, 2),
    "y_output_size": (0x034E, 2),
}
"""CCS's name -> address and number of bytes, the highest first."""

ROW_S = 1e-5
"""One unit of `coarse_integration_time` in files of ours, where no row time is known [s]."""


def write_mipi(path: Path, image: Image, *, embedded_lines: Literal[0, 1, 2] = 0) -> None:
    """Write a mosaic packed as CSI-2 packs it.

    A line has ceil(W / g) groups, each of g pixels; the last is filled with zeros.  The file is
    (embedded_lines + H) lines long and has nothing else.

    Args:
        path: where to; .raw10, .raw12 or .raw14, as many bits as the sensor's.
        image: DN (H, W, 1), whole numbers, as `sensor.adc` gives them.
        embedded_lines: lines of CCS data before the picture.

    Raises:
        ImageError: no mosaic of DN, or numbers that need more bits.
        OutputError: it cannot be written, or the option does not fit.

    Source: MIPI Alliance, CSI-2 (packed RAW10, RAW12 and RAW14), and CCS 1.1, section on embedded data lines.
    """
    bits = BITS[path.suffix.lower()]
    if image.quantity is not Quantity.DN or len(image.channels) != 1:
        raise ImageError(
            f"{path}: a packed RAW takes the DN of a mosaic; this image is {image.quantity.value} with "
            f"{', '.join(image.channels)}. Take the node behind sensor.adc"
        )
    pixels = image.pixels[..., 0]
    if not np.isfinite(pixels).all() or pixels.min() < 0.0 or pixels.max() > 2**bits - 1:
        fits = next((suffix for suffix, wide in BITS.items() if pixels.max() <= 2**wide - 1), "")
        hint = f"name the file {path.stem}{fits}" if fits else "put sensor.compand before it"
        raise ImageError(
            f"{path}: DN from {pixels.min():g} to {pixels.max():g} do not fit {bits} bits, 0 to {2**bits - 1}; {hint}"
        )
    lines = packed(np.rint(pixels).astype(np.uint16), bits)
    embedded_rows = [_registers(image, bits), {}][:embedded_lines]
    heads = [embedded(registers, lines.shape[1], bits) for registers in embedded_rows]

    def write(temporary: Path) -> None:
        temporary.write_bytes(b"".join([*heads, lines.tobytes()]))

    write_whole(path, write)


def packed(numbers: npt.NDArray[np.uint16], bits: int) -> Bytes:
    """(H, W) numbers as (H, bytes a line) bytes."""
    group = GROUP_PX[bits]
    height, width = numbers.shape
    low_bits = bits - 8
    groups = np.zeros((height, -(-width // group), group), dtype=np.uint32)
    groups.reshape(height, -1)[:, :width] = numbers
    low = np.zeros(groups.shape[:2], dtype=np.uint32)
    for place in range(group):
        low |= (groups[..., place] & (2**low_bits - 1)) << (low_bits * place)
    tails = [(low >> (8 * place)) & 0xFF for place in range(group * low_bits // 8)]
    return np.concatenate([groups >> low_bits, np.stack(tails, axis=-1)], axis=-1).astype(np.uint8).reshape(height, -1)


def embedded(registers: dict[str, int], line_bytes: int, bits: int) -> bytes:
    """One line of embedded data: after each group of `GROUP_PX` bytes come those that would hold the lower bits.

    Raises:
        OutputError: the line is too short.
    """
    codes = [LINE_START]
    for name, value in registers.items():
        address, size = REGISTERS[name]
        codes += [REGISTER_HIGH, address >> 8, REGISTER_LOW, address & 0xFF]
        for place in reversed(range(size)):
            codes += [VALUE, (value >> (8 * place)) & 0xFF]
    codes += [LINE_END, LINE_END]
    group = GROUP_PX[bits]
    padding = group * (bits - 8) // 8
    held = line_bytes // (group + padding) * group
    if len(codes) > held:
        raise OutputError(
            f"a line of {line_bytes} bytes holds no embedded data, which takes {len(codes)} of {held}; set "
            f"embedded_lines: 0"
        )
    rows = np.full((held // group, group + padding), SKIP, dtype=np.uint8)
    rows[:, :group] = np.array(codes + [LINE_END] * (held - len(codes)), dtype=np.uint8).reshape(-1, group)
    return rows.tobytes()


def _registers(image: Image, bits: int) -> dict[str, int]:
    """What the registers hold; what they cannot hold is left out."""
    values: dict[str, Any] = {
        "data_pedestal": image.provenance.get("black_level_dn", 0.0),
        "csi_data_format": bits << 8 | bits,
        "coarse_integration_time": image.provenance.get("exposure_s", 0.0) / ROW_S,
        "x_output_size": image.width_px,
        "y_output_size": image.height_px,
    }
    return {name: round(value) for name, value in values.items() if -0.5 < value < 0xFFFF + 0.5}

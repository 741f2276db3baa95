"""Photometric files: how a real luminaire spreads its light.

Takes the text of an IES file (ANSI/IES LM-63-1986 to 2019); gives candela by
direction.  Knows nothing of USD.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.base.errors import StageError

MAX_BYTES = 4 << 20
_MOST_ANGLES = 4096


@dataclass(frozen=True, eq=False)
class Photometry:
    """Luminous intensity by direction, type C: vertical angle 0 is straight down.

    Attributes:
        vertical_deg: (V,) rising, within 0 to 180.
        horizontal_deg: (H,) rising; 0 alone, or up to a quarter, half or whole turn, by symmetry.
        candela: (H, V) >= 0.
    """

    vertical_deg: Array
    horizontal_deg: Array
    candela: Array

    def at(self, vertical_deg: npt.ArrayLike, horizontal_deg: npt.ArrayLike) -> Array:
        """Candela in directions of any shape; 0 outside of the measured range of vertical angles."""
        v, h = np.broadcast_arrays(
            np.asarray(vertical_deg, dtype=np.float64), np.mod(np.asarray(horizontal_deg, dtype=np.float64), 360.0)
        )
        first, last = self.horizontal_deg[0], self.horizontal_deg[-1]
        if first == 90.0 and last == 270.0:
            h = np.where(h < 90.0, 180.0 - h, np.where(h > 270.0, 540.0 - h, h))
        elif last <= 180.0:
            h = np.where(h > 180.0, 360.0 - h, h)
            h = np.where(h > 90.0, 180.0 - h, h) if last <= 90.0 else h
        low_h, share_h = _place(self.horizontal_deg, h)
        low_v, share_v = _place(self.vertical_deg, v)
        high_h, high_v = (
            np.minimum(low_h + 1, len(self.horizontal_deg) - 1),
            np.minimum(low_v + 1, len(self.vertical_deg) - 1),
        )
        value = (1.0 - share_h) * ((1.0 - share_v) * self.candela[low_h, low_v] + share_v * self.candela[low_h, high_v])
        value = value + share_h * (
            (1.0 - share_v) * self.candela[high_h, low_v] + share_v * self.candela[high_h, high_v]
        )
        return np.where((v >= self.vertical_deg[0] - 1e-9) & (v <= self.vertical_deg[-1] + 1e-9), value, 0.0)

    def flux_lm(self) -> float:
        """Luminous flux: the integral of candela over the sphere, by quarters of a degree and two degrees."""
        vertical, horizontal = (np.arange(720) + 0.5) / 4.0, np.arange(180) * 2.0 + 1.0
        ring = np.cos(np.radians(vertical - 0.125)) - np.cos(np.radians(vertical + 0.125))
        return float((self.at(vertical[None], horizontal[:, None]) @ ring).mean() * 2.0 * np.pi)


@functools.lru_cache(maxsize=32)
def parse(data: bytes, name: str) -> Photometry:
    """An IES file.

    Args:
        data: its bytes.
        name: what errors call it.

    Raises:
        StageError: no such file, of a type other than C, or with numbers that do not fit.
    """
    if len(data) > MAX_BYTES:
        raise StageError(f"{name}: {len(data)} bytes; an IES file has at most {MAX_BYTES}")
    text = data.decode("latin-1")
    tilt = re.search(r"^TILT\s*=\s*(\S*)\s*$", text, flags=re.MULTILINE | re.IGNORECASE)
    if not tilt:
        raise StageError(f"{name}: no line 'TILT='; an IES file (LM-63) has one before its numbers")
    try:
        numbers = np.array(re.split(r"[\s,]+", text[tilt.end() :].strip()), dtype=np.float64)
    except ValueError as error:
        raise StageError(f"{name}: after 'TILT=' an IES file (LM-63) holds numbers only: {error}") from None
    if tilt[1].upper() == "INCLUDE" and len(numbers) > 1:
        numbers = numbers[2 + 2 * int(min(max(numbers[1], 0.0), _MOST_ANGLES)) :]
    if len(numbers) < 13 or not np.isfinite(numbers).all():
        raise StageError(f"{name}: {len(numbers)} numbers after 'TILT='; an IES file (LM-63) has 13 before its angles")
    factor, verticals, horizontals, kind = numbers[2], int(numbers[3]), int(numbers[4]), int(numbers[5])
    if kind != 1:
        raise StageError(f"{name}: photometry of type {kind}; only type C (1) is read")
    if (
        not (2 <= verticals <= _MOST_ANGLES and 1 <= horizontals <= _MOST_ANGLES)
        or len(numbers) < 13 + verticals + horizontals + verticals * horizontals
    ):
        raise StageError(f"{name}: {verticals} x {horizontals} angles do not fit its {len(numbers)} numbers")
    ballast = numbers[10] * (numbers[11] if numbers[11] > 0.0 else 1.0)
    angles = numbers[13:]
    vertical, horizontal = angles[:verticals], angles[verticals : verticals + horizontals]
    candela = angles[verticals + horizontals :][: verticals * horizontals].reshape(horizontals, verticals)
    if (
        (np.diff(vertical) <= 0.0).any()
        or (np.diff(horizontal) <= 0.0).any()
        or vertical[0] < 0.0
        or vertical[-1] > 180.0
        or horizontal[-1] > 360.0
    ):
        raise StageError(f"{name}: its angles do not rise within 0 to 180 and 0 to 360 degrees")
    return Photometry(vertical, horizontal, np.maximum(candela * (factor * ballast), 0.0))


def _place(nodes: Array, at: Array) -> tuple[Indices, Array]:
    """Index of the node below and the share of the one above, kept within."""
    if len(nodes) == 1:
        return np.zeros(at.shape, dtype=np.int64), np.zeros(at.shape)
    low = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    return low, np.clip((at - nodes[low]) / (nodes[low + 1] - nodes[low]), 0.0, 1.0)

"""Random streams with names, so that adding one moves no other.

Takes a user's seed and the names of what draws (shot, node, stage of the
sensor); gives a `numpy.random.Generator` or a 32-bit seed for Mitsuba.
"""

from __future__ import annotations

import hashlib

import numpy as np


def seed32(seed: int, *names: str | int) -> int:
    """A 32-bit seed for one named stream: the same names give the same seed for ever."""
    return int.from_bytes(_digest(seed, names)[:4], "little")


def frame_seed(seed: int, code: float) -> int:
    """Seed of one frame of a sequence, by its time code."""
    return seed32(seed, "frame", f"{code:.12g}")


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """An independent generator for one named stream (PCG64, 128 bits of SHA-256)."""
    return np.random.Generator(np.random.PCG64(int.from_bytes(_digest(seed, names)[:16], "little")))


def _digest(seed: int, names: tuple[str | int, ...]) -> bytes:
    text = "\x1f".join([str(int(seed)), *(str(name) for name in names)])
    return hashlib.sha256(text.encode()).digest()

"""Mosaics with a provenance as `sensor.adc` notes it, of a camera that is written out here.

Its XYZ to camera matrix is that of a real camera in D65 (Canon 5D Mark II, as in
the tables of dcraw), with a clear and an infrared row made up; so what a reader
should make of a colour can be worked out without this program.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from synfog_usd.base import seeds
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa

ORDER = "RGBCI"
D65_XYZ = np.array([0.95047, 1.0, 1.08883])

ROWS = {
    "R": (0.4716, 0.0603, -0.0830),
    "G": (-0.7798, 1.5474, 0.2480),
    "B": (-0.1496, 0.1937, 0.6651),
    "C": (-0.4000, 1.5000, 0.8000),
    "I": (0.1500, 0.0500, 0.1000),
}
"""XYZ (Y = 1) to the signal behind each filter."""

ROWS_A = {**ROWS, "R": (0.5200, 0.0100, -0.0700), "B": (-0.1300, 0.1700, 0.6100)}


def filters(pattern: str) -> str:
    return "C" if pattern == "MONO" else "".join(letter for letter in ORDER if letter in pattern)


def letters(pattern: str, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) filter of every pixel."""
    rows = [["C"]] if pattern == "MONO" else [list(pattern[:2]), list(pattern[2:])]
    tile = np.array(rows)
    return np.tile(tile, (shape[0] // tile.shape[0] + 1, shape[1] // tile.shape[1] + 1))[: shape[0], : shape[1]]


def neutral(pattern: str) -> np.ndarray:
    """Signal of a white surface behind each filter in D65, the largest being 1."""
    signal = np.array([np.dot(ROWS[letter], D65_XYZ) for letter in filters(pattern)])
    return signal / signal.max()


def metadata(pattern: str, *, bits: int = 12, black: int | None = None, **more: Any) -> dict[str, Any]:
    """Provenance of a frame of 1/60 s at f/2 and ISO 200."""
    black = 2 ** (bits - 6) if black is None else black
    found: dict[str, Any] = {
        "cfa_pattern": pattern,
        "bits": bits,
        "black_level_dn": black,
        "white_level_dn": 2**bits - 1,
    }
    found |= {"noise_profile": [2e-4, 3e-7], "total_dark_noise_dn": 2.0, "exposure_s": 1 / 60, "iso": 200.0}
    found |= {"f_number": 2.0, "focal_length_mm": 4.38, "sensor_title": "Test sensor", "sensor_serial": "SN-0042"}
    found["lens_title"] = "Test lens"
    if len(filters(pattern)) > 2:
        found["xyz_to_camera"] = [list(ROWS[letter]) for letter in filters(pattern)]
        found["xyz_to_camera_a"] = [list(ROWS_A[letter]) for letter in filters(pattern)]
        found["as_shot_neutral"] = [float(value) for value in neutral(pattern)]
    return found | more


def noise(pattern: str, *, bits: int = 12, shape: tuple[int, int] = (96, 128), white: int | None = None) -> Image:
    """Every number from 0 to white level, at random, the ends among them."""
    told = metadata(pattern, bits=bits)
    white = told["white_level_dn"] if white is None else white
    numbers = seeds.stream(0, "raw", pattern, bits).integers(0, white + 1, shape)
    numbers[0, :2] = 0, white
    return Image(numbers[..., None].astype(np.float32), ("CFA",), Quantity.DN, provenance=told)


def scene(pattern: str, level: np.ndarray, xyz: np.ndarray = D65_XYZ, **more: Any) -> Image:
    """A noise-free frame of surfaces of one colour.

    Args:
        pattern: of the filters.
        level: (H, W) brightness, 1 being where a white surface in D65 saturates.
        xyz: its colour; D65's own is a grey card.
        more: for `metadata`.
    """
    told = metadata(pattern, **more)
    top = max(np.dot(ROWS[letter], D65_XYZ) for letter in filters(pattern))
    signal = {letter: np.dot(ROWS[letter], xyz) / top for letter in filters(pattern)}
    black, white = told["black_level_dn"], told["white_level_dn"]
    numbers = np.zeros(level.shape)
    for letter, value in signal.items():
        numbers = np.where(letters(pattern, level.shape) == letter, level * value, numbers)
    dn = np.clip(np.rint(black + numbers * (white - black)), 0, white)
    return Image(dn[..., None].astype(np.float32), ("CFA",), Quantity.DN, provenance=told)


def mosaic_of(planes: np.ndarray, pattern: str) -> np.ndarray:
    """(H, W, 1) of (H, W, F) planes: each pixel from the plane of its own filter."""
    mosaic = np.empty((*planes.shape[:2], 1), dtype=planes.dtype)
    for where, number in cfa.sites(pattern):
        mosaic[(*where, 0)] = planes[(*where, number)]
    return mosaic

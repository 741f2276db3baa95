"""How a lens spreads a point of light, and a picture through it.

A `Blur` is a transfer function and the spot that goes with it.  A picture is multiplied by the
transfer, one channel at a time; lamps, which a transform of pixels would surround with
ripples, are added as copies of the exact spot.  Knows no op.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.arrays import Array, FloatArray

THREADS = 2

STRIP_ROWS = 16
"""Rows that are worked on at a time, so that they stay in the processor's cache."""

EDGE_PX = 64
"""How far a picture is mirrored beyond its edges before it is blurred; 0.3 % of a point's light goes further at q =
1.
"""

HIGHLIGHT = 8.0
"""Times the 95th percentile of a channel: from there on a pixel holds a point of light."""

SPOT_PX = 24
"""Half the side of the square in which the diffraction disc is integrated over pixels; beyond it has its mean tail.
Times q where q > 1.
"""

TAIL_PX = 8
"""From here on the tail is taken out of the spot: so smooth that a float32 transform keeps it free of noise."""

COPIES = 1 << 27
"""Pixels of spots that are added one by one (4,000 more for each spot); more are added by a transform."""

_V: Array = np.linspace(0.0, 1.0, 4097)


@dataclass(frozen=True)
class Blur:
    """What a lens makes of one channel.

    Attributes:
        transfer: radial frequency [cycles/pixel], any shape, to the part of the
            contrast that is left.
        spot: (2 R + 1, 2 R + 1) weights of a point's light around its pixel.
        tail: weight of the mean tail q / (pi^3 r^3) outside the spot; 0 for none.
        tail_scale: times `TAIL_PX` and `SPOT_PX`.
    """

    transfer: Callable[[FloatArray], Array]
    spot: FloatArray
    tail: float = 0.0
    tail_scale: int = 1


def highlight_limit(plane: FloatArray) -> np.float32:
    """From where on a channel (H, W) holds points of light; every fourth row and column is looked at."""
    return np.float32(HIGHLIGHT * np.percentile(plane[::4, ::4], 95.0))


def aperture_transfer(v: npt.ArrayLike) -> Array:
    """2/pi (acos v - v sqrt(1 - v^2)), 0 from v = 1 on."""
    v = np.minimum(np.asarray(v, dtype=np.float64), 1.0)
    return np.asarray((2.0 / math.pi) * (np.arccos(v) - v * np.sqrt(1.0 - v * v)))


_TRANSFER: Array = aperture_transfer(_V)


def read_transfer(v: npt.NDArray[np.floating]) -> Array:
    """`aperture_transfer` from a table, to 3e-7."""
    return np.interp(v, _V, _TRANSFER)


def blurred(pixels: FloatArray, blurs: Sequence[Blur]) -> FloatArray:
    """(H, W, C) through one blur per channel, >= 0."""
    from scipy import fft

    height, width, count = pixels.shape
    edge = max(EDGE_PX, *(blur.spot.shape[0] // 2 for blur in blurs))
    sizes = tuple(fft.next_fast_len(length + 2 * edge, real=True) for length in (height, width))
    pads = tuple((edge, size - length - edge) for length, size in zip((height, width), sizes, strict=True))
    frequency = np.hypot(np.fft.rfftfreq(sizes[0])[:, None], np.fft.rfftfreq(sizes[1])[None, :]).astype(np.float32)
    same = blurs[0].transfer(frequency).astype(np.float32) if all(blur is blurs[0] for blur in blurs) else None
    result = np.empty_like(pixels)
    together = 2 if count <= 4 else 4  # channels that are taken out of the frame, and put back, in one go over it

    def run(first: int) -> None:
        channels = range(first, min(first + together, count))
        planes = np.empty((len(channels), height, width), np.float32)
        for rows in strips(height):
            planes[:, rows] = pixels[rows, :, channels.start : channels.stop].transpose(2, 0, 1)
        for plane, channel in zip(planes, channels, strict=True):
            blur_plane(plane, blurs[channel])
        for rows in strips(height):
            result[rows, :, channels.start : channels.stop] = planes[:, rows].transpose(1, 2, 0)

    def blur_plane(plane: FloatArray, blur: Blur) -> None:
        transfer = blur.transfer(frequency).astype(np.float32) if same is None else same
        padded = np.pad(plane, pads, mode="symmetric")
        limit = highlight_limit(plane)
        points = None
        if float(plane.max()) > limit:
            points = padded - limit
            np.maximum(points, 0.0, out=points)
            np.minimum(padded, limit, out=padded)
        spectrum = fft.rfft2(padded, overwrite_x=True)
        _multiply(spectrum, transfer)
        if points is not None and blur.tail:
            tail = fft.rfft2(points)
            _multiply(tail, _tail(*sizes, blur.tail_scale) * np.float32(blur.tail))
            spectrum += tail
        blurred = fft.irfft2(spectrum, s=sizes, overwrite_x=True)
        if points is not None:
            add_spots(blurred, points, blur.spot)
        np.maximum(blurred[edge : edge + height, edge : edge + width], 0.0, out=plane)

    if any(blur.tail for blur in blurs):
        _tail(*sizes, blurs[0].tail_scale)  # before the threads, so that it is made once
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(run, range(0, count, together)))
    return result


def strips(height: int) -> Iterator[slice]:
    """Few rows at a time, which the processor's cache holds."""
    return (slice(top, top + STRIP_ROWS) for top in range(0, height, STRIP_ROWS))


def _multiply(spectrum: npt.NDArray[np.complex64], transfer: FloatArray) -> None:
    """In place, by a function that is the same at f and -f: `transfer` holds the rows of the frequencies >= 0."""
    rows, height = transfer.shape[0], spectrum.shape[0]
    spectrum[:rows] *= transfer
    spectrum[rows:] *= transfer[1 : height - rows + 1][::-1]


def add_spots(picture: FloatArray, points: FloatArray, spot: FloatArray) -> None:
    """Add, in place, a copy of `spot` around every point, times its light; what leaves the picture is lost."""
    from scipy import fft

    rows, columns = np.nonzero(points > 0.0)
    if rows.size * (spot.size + 4000) > COPIES:
        kernel = np.zeros(points.shape)
        reach = spot.shape[0] // 2
        kernel[: spot.shape[0], : spot.shape[1]] = spot
        spectrum = fft.rfft2(np.roll(kernel, (-reach, -reach), axis=(0, 1)))
        spectrum *= fft.rfft2(points.astype(np.float64))  # float32 would spread 1e-8 of a lamp along its row
        picture += fft.irfft2(spectrum, s=points.shape, overwrite_x=True)
        return
    height, width = points.shape
    reach = spot.shape[0] // 2
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        top, left = max(row - reach, 0), max(column - reach, 0)
        bottom, right = min(row + reach + 1, height), min(column + reach + 1, width)
        part = spot[top - row + reach : bottom - row + reach, left - column + reach : right - column + reach]
        picture[top:bottom, left:right] += points[row, column] * part


@functools.lru_cache(maxsize=64)
def aperture(q: float, scale: int) -> Blur:
    """A round aperture with q = lambda N / pitch.

    Near its centre the disc is integrated over square pixels: the inverse transform
    of sum_k OTF(f + k) sinc(f + k) on a small grid.  From there on it follows its mean
    tail, q / (pi^3 r^3).
    """
    from scipy import fft

    size = 128 * scale
    folded = np.zeros((size // 2 + 1, size // 2 + 1))
    f = np.arange(size // 2 + 1) / size
    aliases = range(-math.floor(1.0 / q + 0.5), math.floor(1.0 / q + 0.5) + 1)
    for row in aliases:
        for column in aliases:
            y, x = f[:, None] + row, f[None, :] + column
            folded += read_transfer(q * np.hypot(y, x)) * np.sinc(y) * np.sinc(x)
    weights = fft.dctn(folded, type=1) / size**2
    reach = SPOT_PX * scale
    quarter = np.maximum(weights[: reach + 1, : reach + 1], 0.0)
    radius = np.hypot(np.arange(reach + 1)[:, None], np.arange(reach + 1)[None, :])
    quarter = np.where(radius < reach, quarter - q * _tail_weights(radius, scale), 0.0)
    half = np.concatenate([quarter[:0:-1], quarter])
    spot = np.concatenate([half[:, :0:-1], half], axis=1)
    total = spot.sum() + q * _tail_sum(scale)
    return Blur(lambda frequency: read_transfer(q * frequency), (spot / total).astype(np.float32), q / total, scale)


def disc_weights(q: float, radius: Array) -> Array:
    """The diffraction disc of a round aperture integrated over pixels, at whole pixels around its centre.

    Args:
        q: lambda N / pitch.
        radius: (2 R + 1, 2 R + 1) distances from the middle pixel.
    """
    given = aperture(q, max(1, math.ceil(q)))
    weights = given.tail * _tail_weights(radius, given.tail_scale)
    reach, inner = radius.shape[0] // 2, given.spot.shape[0] // 2
    near = min(reach, inner)
    weights[reach - near : reach + near + 1, reach - near : reach + near + 1] += given.spot[
        inner - near : inner + near + 1, inner - near : inner + near + 1
    ]
    return np.asarray(weights)


def _tail_weights(radius: Array, scale: int) -> Array:
    """1 / (pi^3 r^3) beyond `SPOT_PX`, fading in from `TAIL_PX` on."""
    rise = np.clip((radius / scale - TAIL_PX) / (SPOT_PX - TAIL_PX), 0.0, 1.0)
    return np.asarray(rise * rise * (3.0 - 2.0 * rise) / (math.pi * np.maximum(radius, 1.0)) ** 3)


def _tail_sum(scale: int) -> float:
    """Sum of `_tail_weights` over the whole plane: as an integral up to 1,000 pixels, and in closed form beyond."""
    radius = np.arange(0.05, 1000.0 * scale, 0.1)
    return float(
        2.0 * math.pi * (_tail_weights(radius, scale) * radius).sum() * 0.1 + 2.0 / (math.pi**2 * 1000.0 * scale)
    )


@functools.lru_cache(maxsize=2)
def _tail(height: int, width: int, scale: int) -> FloatArray:
    """(H // 2 + 1, W // 2 + 1) transfer of the tail at q = 1 on the frequencies >= 0."""
    from scipy import fft

    row_px, column_px = np.fft.fftfreq(height) * height, np.fft.fftfreq(width) * width
    weights = _tail_weights(np.hypot(row_px[:, None], column_px[None, :]), scale)
    return np.ascontiguousarray(fft.rfft2(weights).real[: height // 2 + 1], dtype=np.float32)


def disc(diameter_px: float) -> FloatArray:
    """A disc of light integrated over pixels, sum 1."""
    radius = diameter_px / 2.0
    reach = math.ceil(radius - 0.5) if radius > 0.5 else 0
    finer = max(1, min(32, 1024 // (reach + 1)))
    inside = (np.arange(finer * (2 * reach + 1)) + 0.5) / finer - reach - 0.5
    fine = (inside[:, None] ** 2 + inside[None, :] ** 2 <= radius * radius).astype(np.float32)
    spot = fine.reshape(2 * reach + 1, finer, 2 * reach + 1, finer).sum(axis=(1, 3))
    return np.asarray(spot / spot.sum(), dtype=np.float32)

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

from synfog_usd.arrays import Array, FloatArray, strips

THREADS = 2

HIGHLIGHT = 8.0
"""Times the 95th percentile of a channel: from there on a pixel holds a point of light."""

SPOT_PX = 32
"""Half the side of the square in which the diffraction disc is integrated over pixels; beyond it has its mean tail.
Times q where q > 1.
"""

SOFT_PX = 8.0
"""Up to here the tail is rounded off, and the spot holds what that takes away.  Times q where q > 1."""

TAIL_CYCLES = 2.5
"""Frequency, times `SOFT_PX`, up to which the tail is made: what is left there is 1.5e-7 of it."""

FINE = 1 << 16
"""Frequencies at which a transfer is known where each channel has its own; the nearest counts, which moves the contrast
of an aperture by less than 7e-6 lambda N / pitch.
"""

COPIES = 1 << 27
"""Pixels of spots that are added one by one (4,000 more for each spot); more are added by a transform."""


Places = npt.NDArray[np.intp]
Points = tuple[Places, Places, FloatArray]
"""Rows, columns and light of points of light."""


@dataclass(frozen=True)
class Blur:
    """What a lens makes of one channel.

    Attributes:
        transfer: radial frequency [cycles/pixel], any shape, to the part of the
            contrast that is left.
        spot: (2 R + 1, 2 R + 1) weights of a point's light around its pixel.
        tail: weight of the mean tail 1 / (pi^3 r^3) outside the spot; 0 for none, in all channels of a picture.
        tail_scale: times `SOFT_PX` and `SPOT_PX`; one for all channels of a picture.
    """

    transfer: Callable[[FloatArray], Array]
    spot: FloatArray
    tail: float = 0.0
    tail_scale: int = 1


def highlight_limit(plane: FloatArray) -> np.float32:
    """From where on a channel (H, W) holds points of light; every fourth row and column is looked at."""
    return np.float32(HIGHLIGHT * np.percentile(plane[::4, ::4], 95.0))


def aperture_transfer(v: npt.NDArray[np.floating]) -> Array:
    """2/pi (acos v - v sqrt(1 - v^2)), 0 from v = 1 on; of the type of `v`."""
    v = np.minimum(v, 1.0)
    return np.asarray((2.0 / math.pi) * (np.arccos(v) - v * np.sqrt(1.0 - v * v)))


def spot_transfer(spot_px: float, frequency: npt.NDArray[np.floating]) -> Array:
    """Contrast that a Gaussian spot leaves at frequencies [cycles/pixel]: exp(-2 (pi s f)^2)."""
    return np.exp(-2.0 * np.square(math.pi * spot_px * frequency))


def blurred(pixels: FloatArray, blurs: Sequence[Blur]) -> FloatArray:
    """(H, W, C) through one blur per channel, >= 0; light from outside the picture is taken as its mirror image.

    The cosine transform has the mirror image in it, and multiplies as Fourier's does, since spots are symmetric.
    """
    height, width, count = pixels.shape
    result = np.empty_like(pixels)
    together = 2 if count <= 4 else 4  # channels that are taken out of the frame, and put back, in one go over it
    same = np.ones((height, width), np.float32) if all(blur is blurs[0] for blur in blurs) else None
    if same is not None:
        _multiply(same, blurs[0].transfer)

    def run(first: int) -> None:
        channels = range(first, min(first + together, count))
        planes = [np.empty((height, width), np.float32) for _ in channels]
        for rows in strips(height):
            for plane, channel in zip(planes, channels, strict=True):
                plane[rows] = pixels[rows, :, channel]
        planes = _blurred_planes(planes, [blurs[channel] for channel in channels], same)
        for rows in strips(height):
            for plane, channel in zip(planes, channels, strict=True):
                np.maximum(plane[rows], 0.0, out=result[rows, :, channel])

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(run, range(0, count, together)))
    return result


def _blurred_planes(planes: list[FloatArray], blurs: Sequence[Blur], known: FloatArray | None) -> list[FloatArray]:
    """Channels, which are overwritten; `known` is the transfer of all at the cosines' frequencies, where it is one."""
    from scipy import fft

    points = [taken_out(plane) for plane in planes]
    waves = [fft.dctn(plane, overwrite_x=True) for plane in planes]
    if known is None:
        _multiply_each(waves, [blur.transfer for blur in blurs])
    else:
        for plane in waves:
            plane *= known
    _add_tails(waves, blurs, points)
    found = [fft.idctn(plane, overwrite_x=True) for plane in waves]
    for plane, blur, (rows, columns, lights) in zip(found, blurs, points, strict=True):
        if rows.size:
            add_spots(plane, *mirrored(plane.shape, rows, columns, lights, blur.spot.shape[0] // 2), blur.spot)
    return found


def taken_out(plane: FloatArray) -> Points:
    """Rows, columns and light of the points of light of a channel (H, W), which is cut, in place, where they begin."""
    limit = highlight_limit(plane)
    rows = np.flatnonzero(plane.max(axis=1) > limit)
    line, columns = np.nonzero(plane[rows] > limit)
    rows = rows[line]
    lights = plane[rows, columns] - limit
    plane[rows, columns] = limit
    return rows, columns, lights


def _add_tails(waves: Sequence[FloatArray], blurs: Sequence[Blur], points: Sequence[Points]) -> None:
    """Add, in place, to cosine transforms of one size what lamps show outside their spots."""
    far = [(plane, blur, lamps) for plane, blur, lamps in zip(waves, blurs, points, strict=True) if lamps[0].size]
    if not far or not far[0][1].tail:
        return
    shape, scale = far[0][0].shape, far[0][1].tail_scale
    tails = [_low_waves(shape, *lamps, TAIL_CYCLES / (SOFT_PX * scale)) for _, _, lamps in far]
    for rows, frequency in _frequencies(tails[0].shape, shape):
        tail = tail_transfer(frequency, scale)
        for low, (plane, blur, _) in zip(tails, far, strict=True):
            low[rows] *= np.float32(blur.tail)
            low[rows] *= tail
            plane[: len(low), : low.shape[1]][rows] += low[rows]


def _multiply(waves: FloatArray, transfer: Callable[[FloatArray], Array]) -> None:
    """In place, the cosine transform of a picture by a transfer function."""
    for rows, frequency in _frequencies(waves.shape, waves.shape):
        waves[rows] *= transfer(frequency)


def _multiply_each(waves: Sequence[FloatArray], transfers: Sequence[Callable[[FloatArray], Array]]) -> None:
    """In place, cosine transforms of one size, each by its own transfer at the nearest of `FINE` frequencies."""
    step = math.sqrt(0.5) / FINE
    tables = [
        transfer(np.arange(FINE + 1, dtype=np.float32) * np.float32(step)).astype(np.float32) for transfer in transfers
    ]
    for rows, frequency in _frequencies(waves[0].shape, waves[0].shape):
        frequency *= np.float32(1.0 / step)
        frequency += np.float32(0.5)
        nearest = frequency.astype(np.intp)
        for plane, table in zip(waves, tables, strict=True):
            plane[rows] *= table.take(nearest, mode="clip", out=frequency)


def _frequencies(kept: tuple[int, ...], fine: tuple[int, ...]) -> Iterator[tuple[slice, FloatArray]]:
    """Rows of the lowest `kept` frequencies [cycles/pixel] of the cosine transform of a picture of the size `fine`."""
    down, across = (
        (0.5 * np.arange(most) / length).astype(np.float32) for most, length in zip(kept, fine, strict=True)
    )
    down, across = down * down, across * across
    for rows in strips(kept[0]):
        yield rows, np.sqrt(down[rows, None] + across)


def _low_waves(shape: tuple[int, ...], rows: Places, columns: Places, lights: FloatArray, highest: float) -> FloatArray:
    """Cosine transform of a picture of `shape` that is black but for a few pixels, up to a frequency [cycles/pixel]."""
    from scipy import fft

    high, wide = (min(length, math.ceil(2.0 * highest * length)) for length in shape)
    lines, line = np.unique(rows, return_inverse=True)
    lit = np.zeros((lines.size, shape[1]), np.float32)
    lit[line, columns] = lights
    waves = np.zeros((shape[0], wide), np.float32)
    waves[lines] = fft.dct(lit, axis=1)[:, :wide]
    return np.asarray(fft.dct(waves, axis=0, overwrite_x=True)[:high])


def mirrored(
    shape: tuple[int, ...], rows: Places, columns: Places, lights: FloatArray, reach: int
) -> tuple[Places, Places, FloatArray]:
    """Points and their mirror images beyond the edges, as far as a spot of so many pixels reaches into the picture."""
    for axis, length in enumerate(shape):
        along = (rows, columns)[axis]
        fold = 2 * length * np.arange(-(reach // (2 * length)) - 1, reach // (2 * length) + 2)
        places = np.concatenate([fold[:, None] + along, fold[:, None] - 1 - along])
        seen, point = np.nonzero((places > -1 - reach) & (places < length + reach))
        found = places[seen, point]
        rows, columns = (found, columns[point]) if axis == 0 else (rows[point], found)
        lights = lights[point]
    return rows, columns, lights


def add_spots(picture: FloatArray, rows: Places, columns: Places, lights: FloatArray, spot: FloatArray) -> None:
    """Add, in place, a copy of `spot` around every point, times its light; what leaves the picture is lost.

    A point may lie outside of the picture, as far as its spot reaches into it.
    """
    from scipy import fft

    height, width = picture.shape
    reach = spot.shape[0] // 2
    if rows.size * (spot.size + 4000) > COPIES:
        sizes = tuple(fft.next_fast_len(length + 2 * reach, real=True) for length in picture.shape)
        kernel, points = np.zeros(sizes), np.zeros(sizes)  # float32 would spread 1e-8 of a lamp along its row
        kernel[: spot.shape[0], : spot.shape[1]] = spot
        points[rows + reach, columns + reach] = lights
        spectrum = fft.rfft2(kernel)
        spectrum *= fft.rfft2(points)
        picture += fft.irfft2(spectrum, s=sizes, overwrite_x=True)[2 * reach :, 2 * reach :][:height, :width]
        return
    for row, column, light in zip(rows.tolist(), columns.tolist(), lights, strict=True):
        top, left = max(row - reach, 0), max(column - reach, 0)
        bottom, right = min(row + reach + 1, height), min(column + reach + 1, width)
        part = spot[top - row + reach : bottom - row + reach, left - column + reach : right - column + reach]
        picture[top:bottom, left:right] += light * part


@functools.lru_cache(maxsize=64)
def aperture(q: float, scale: int, spot_px: float = 0.0) -> Blur:
    """A round aperture with q = lambda N / pitch, and the lens's own spot, a Gaussian of standard deviation `spot_px`.

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
            radial = np.hypot(y, x)
            folded += aperture_transfer(q * radial) * spot_transfer(spot_px, radial) * np.sinc(y) * np.sinc(x)
    weights = fft.dctn(folded, type=1) / size**2
    reach = SPOT_PX * scale
    quarter = np.maximum(weights[: reach + 1, : reach + 1], 0.0)
    radius = np.hypot(np.arange(reach + 1)[:, None], np.arange(reach + 1)[None, :])
    quarter = np.where(radius < reach, quarter - q * tail_weights(radius, scale), 0.0)
    half = np.concatenate([quarter[:0:-1], quarter])
    spot = np.concatenate([half[:, :0:-1], half], axis=1)
    total = spot.sum() + q * float(tail_transfer(np.zeros(1), scale)[0])

    def transfer(frequency: FloatArray) -> Array:
        whole = aperture_transfer(q * frequency)
        return whole * spot_transfer(spot_px, frequency) if spot_px else whole

    return Blur(transfer, (spot / total).astype(np.float32), q / total, scale)


def disc_weights(q: float, radius: Array) -> Array:
    """The diffraction disc of a round aperture integrated over pixels, at whole pixels around its centre.

    Args:
        q: lambda N / pitch.
        radius: (2 R + 1, 2 R + 1) distances from the middle pixel.
    """
    given = aperture(q, max(1, math.ceil(q)))
    weights = given.tail * tail_weights(radius, given.tail_scale)
    reach, inner = radius.shape[0] // 2, given.spot.shape[0] // 2
    near = min(reach, inner)
    weights[reach - near : reach + near + 1, reach - near : reach + near + 1] += given.spot[
        inner - near : inner + near + 1, inner - near : inner + near + 1
    ]
    return np.asarray(weights)


def tail_weights(radius: Array, scale: int) -> Array:
    """1 / (pi^3 r^3), rounded off towards the middle: 2 s(b) - s(2 b) with s(b) = (r^2 + b)^-1.5 / pi^3, which is
    1 - 3.75 (b / r^2)^2 of it: 1.5 % less at `SPOT_PX`.
    """
    soft, r2 = (SOFT_PX * scale) ** 2, np.square(radius)
    return np.asarray((2.0 * (r2 + soft) ** -1.5 - (r2 + 2.0 * soft) ** -1.5) / math.pi**3)


def tail_transfer(frequency: npt.NDArray[np.floating], scale: int) -> Array:
    """Fourier transform of `tail_weights`: that of s(b) is 2 exp(-2 pi sqrt(b) f) / (pi^2 sqrt(b))."""
    soft = SOFT_PX * scale
    first, second = (np.exp(-2.0 * math.pi * width * frequency) for width in (soft, math.sqrt(2.0) * soft))
    return np.asarray((2.0 * first - second / math.sqrt(2.0)) * (2.0 / (math.pi**2 * soft)))


def disc(diameter_px: float) -> FloatArray:
    """A disc of light integrated over pixels, sum 1."""
    radius = diameter_px / 2.0
    reach = math.ceil(radius - 0.5) if radius > 0.5 else 0
    finer = max(1, min(32, 1024 // (reach + 1)))
    inside = (np.arange(finer * (2 * reach + 1)) + 0.5) / finer - reach - 0.5
    fine = (inside[:, None] ** 2 + inside[None, :] ** 2 <= radius * radius).astype(np.float32)
    spot = fine.reshape(2 * reach + 1, finer, 2 * reach + 1, finer).sum(axis=(1, 3))
    return np.asarray(spot / spot.sum(), dtype=np.float32)

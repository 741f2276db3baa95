"""How a lens spreads a point of light, and a picture through it.

A `Blur` is a transfer function and the spot that goes with it.  A picture is multiplied by the
transfer, one channel at a time; lamps, which a transform of pixels would surround with
ripples, are added as copies of the exact spot.  Knows no op.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, FloatArray, Pixels, at_least, at_most, planar, strips

THREADS = 2

HIGHLIGHT = 8.0
"""Times the 95th percentile of a channel: from there on a pixel holds a point of light."""

SPOT_PX = 32
"""Half the side of the square in which the diffraction disc is integrated over pixels; beyond it has its mean tail.
Times q where q > 1.
"""

SOFT_PX = 8.0
"""Up to here the tail is rounded off, and the spot holds what that takes away.  Times q where q > 1."""

TAIL_CYCLES = 2.0
"""Frequency, times `SOFT_PX`, up to which the tail is made: what is left there is 5.4e-6 of it."""

FINE = 1 << 16
"""Frequencies at which a transfer is known where each channel has its own; the nearest counts, which moves the contrast
of an aperture by less than 7e-6 lambda N / pitch.
"""

COPIES = 1 << 27
"""Pixels of spots that are added one by one (4,000 more for each spot); more are added by a transform."""


Places = npt.NDArray[np.intp]
Points = tuple[Places, Places, FloatArray]
"""Rows, columns and light of points of light."""


@dataclass(frozen=True, eq=False)
class Blur:
    """What a lens makes of one channel; equal to itself alone.

    Attributes:
        transfer: radial frequency [cycles/pixel], any shape, to the part of the
            contrast that is left.
        spot: weights of a point's light in the square around its pixel, of an odd side.
        tail: weight of the mean tail 1 / (pi^3 r^3) outside the spot; 0 for none, in all channels of a picture.
        tail_scale: times `SOFT_PX` and `SPOT_PX`; one for all channels of a picture.
    """

    transfer: Callable[[FloatArray], Array]
    spot: FloatArray
    tail: float = 0.0
    tail_scale: int = 1


def highlight_limit(plane: FloatArray) -> np.float32:
    """From where on a channel (H, W) holds points of light; every fourth row and column is looked at."""
    some = plane[::4, ::4].ravel()
    place = 0.95 * (some.size - 1)
    low = int(place)
    some = np.partition(some, low)  # np.percentile asks it for two places, which takes ten times as long
    step = float(some[low + 1 :].min(initial=np.inf) - some[low]) if low < place else 0.0
    return np.float32(HIGHLIGHT * (float(some[low]) + (place - low) * step))


def highlight_limits(pixels: FloatArray) -> list[np.float32]:
    """That of each channel of (H, W, C)."""
    return [highlight_limit(pixels[..., channel]) for channel in range(pixels.shape[2])]


def aperture_transfer(v: npt.NDArray[np.floating]) -> Array:
    """Contrast that a round aperture leaves at v, the frequency over that of its limit; of the type of `v`."""
    v = np.minimum(v, 1.0)
    return np.asarray((2.0 / math.pi) * (np.arccos(v) - v * np.sqrt(1.0 - v * v)))


def spot_transfer(spot_px: float, frequency: npt.NDArray[np.floating]) -> Array:
    """Contrast that a Gaussian spot leaves at frequencies [cycles/pixel]: exp(-2 (pi s f)^2)."""
    return np.exp(-2.0 * np.square(math.pi * spot_px * frequency))


def blurred(pixels: FloatArray, blurs: Sequence[Blur], limits: Sequence[np.float32]) -> FloatArray:
    """(H, W, C) through one blur per channel, >= 0; light from outside the picture is taken as its mirror image.

    What exceeds a channel's limit is spread as a point of light.  The cosine transform has the mirror image in it, and
    multiplies as Fourier's does, since spots are symmetric.
    """
    from scipy import fft

    height, width, count = pixels.shape
    result = planar(pixels.shape)
    planes = [result[..., channel] for channel in range(count)]
    transfers = _transfers(blurs, height, width)

    def forth(channel: int) -> tuple[Points, FloatArray]:
        plane = planes[channel]
        points = taken_out(pixels[..., channel], limits[channel], plane)
        _in_place(fft.dctn, plane)
        return points, _tail(points, blurs[channel], plane.shape)

    def multiply(rows: slice) -> None:
        factors, tail = transfers(rows)
        for plane, factor, (_, far) in zip(planes, factors, spectra, strict=True):
            plane[rows] *= factor
            if (low := far[rows]).size:
                plane[rows][: len(low), : low.shape[1]] += tail * low

    def back(channel: int) -> None:
        plane, spot, (points, _) = planes[channel], blurs[channel].spot, spectra[channel]
        _in_place(fft.idctn, plane)
        if points[0].size:
            add_spots(plane, *mirrored(plane.shape, *points, spot.shape[0] // 2), spot)
        for rows in strips(height):
            if plane[rows].min() < 0.0:
                at_least(plane[rows], 0.0, out=plane[rows])

    with ThreadPoolExecutor(THREADS) as pool:
        spectra = list(pool.map(forth, range(count)))
        list(pool.map(multiply, strips(height)))
        list(pool.map(back, range(count)))
    return result


def _in_place(transform: Callable[..., FloatArray], plane: FloatArray) -> None:
    """Transform a plane in its own memory."""
    spectrum = transform(plane, overwrite_x=True)
    if not np.may_share_memory(spectrum, plane):  # that it may be overwritten does not promise that it is
        plane[...] = spectrum


def _transfers(blurs: Sequence[Blur], height: int, width: int) -> Callable[[slice], tuple[Iterator[Array], Array]]:
    """From rows of a cosine transform to what is left there in each channel, and to the tail's transfer as far as it
    goes.
    """
    factors = _factors(blurs)
    down_2, across_2 = (np.square(0.5 * np.arange(size) / size).astype(np.float32) for size in (height, width))
    scale = blurs[0].tail_scale
    high, wide = _tail_size((height, width), scale) if blurs[0].tail > 0.0 else (0, 0)

    def of_rows(rows: slice) -> tuple[Iterator[Array], Array]:
        frequency = np.sqrt(down_2[rows, None] + across_2)
        return factors(frequency), tail_transfer(frequency[: max(0, high - rows.start), :wide], scale)

    return of_rows


def _factors(blurs: Sequence[Blur]) -> Callable[[FloatArray], Iterator[Array]]:
    """From frequencies [cycles/pixel] to what is left there in each channel; where channels differ, at the nearest of
    `FINE` frequencies.
    """
    if all(blur is blurs[0] for blur in blurs):
        return lambda frequency: itertools.repeat(blurs[0].transfer(frequency), len(blurs))
    step = np.float32(math.sqrt(0.5) / FINE)
    grid = np.arange(FINE + 1, dtype=np.float32) * step
    tables = [blur.transfer(grid).astype(np.float32) for blur in blurs]

    def factors(frequency: FloatArray) -> Iterator[Pixels]:
        nearest = (frequency * (1 / step) + np.float32(0.5)).astype(np.intp)
        return (table.take(nearest, mode="clip") for table in tables)

    return factors


def taken_out(plane: FloatArray, limit: np.float32, out: FloatArray) -> Points:
    """Rows, columns and light over the limit of the points of light of a channel (H, W); `out` gets the channel, cut
    there.
    """
    pieces = [(np.empty(0, np.intp), np.empty(0, np.intp), np.empty(0, np.float32))]
    for strip in strips(len(plane)):
        here = plane[strip]
        if here.max() > limit:
            row, column = np.nonzero(here > limit)
            pieces.append((row + strip.start, column, here[row, column] - limit))
        at_most(here, limit, out=out[strip])
    rows, columns, lights = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return rows, columns, lights


def _tail(points: Points, blur: Blur, shape: tuple[int, ...]) -> FloatArray:
    """Cosine transform of what points of light show outside their spots, before `tail_transfer`, as far as it goes."""
    from scipy import fft

    rows, columns, lights = points
    columns, column = np.unique(columns, return_inverse=True)
    lit = np.zeros((shape[0], columns.size), np.float32)
    lit[rows, column] = lights * np.float32(blur.tail)
    if not lit.any():
        return lit[:0]
    high, wide = _tail_size(shape, blur.tail_scale)
    waves = np.zeros((high, shape[1]), np.float32)
    waves[:, columns] = fft.dct(lit, axis=0)[:high]
    return np.asarray(fft.dct(waves, axis=1, overwrite_x=True)[:, :wide])


def _tail_size(shape: tuple[int, ...], scale: int) -> tuple[int, int]:
    """How many rows and columns of a cosine transform the tail has."""
    high, wide = (min(length, math.ceil(2.0 * TAIL_CYCLES / (SOFT_PX * scale) * length)) for length in shape)
    return high, wide


def mirrored(
    shape: tuple[int, ...], rows: Places, columns: Places, lights: FloatArray, reach: int
) -> tuple[Places, Places, FloatArray]:
    """Points and their mirror images beyond the edges, as far as a spot of so many pixels reaches into the picture."""
    for axis, length in enumerate(shape):
        along = (rows, columns)[axis]
        fold = 2 * length * np.arange(-(reach // (2 * length)) - 1, reach // (2 * length) + 2)
        places = np.concatenate([fold[:, None] + along, fold[:, None] - 1 - along])
        image_number, point = np.nonzero((places > -1 - reach) & (places < length + reach))
        inside = places[image_number, point]
        rows, columns = (inside, columns[point]) if axis == 0 else (rows[point], inside)
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
        top, column_px = max(row - reach, 0), max(column - reach, 0)
        bottom, right = min(row + reach + 1, height), min(column + reach + 1, width)
        part = spot[top - row + reach : bottom - row + reach, column_px - column + reach : right - column + reach]
        picture[top:bottom, column_px:right] += light * part


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
        radius: distances from the middle pixel of a square of an odd side [px].
    """
    measured = aperture(q, max(1, math.ceil(q)))
    weights = measured.tail * tail_weights(radius, measured.tail_scale)
    reach, inner = radius.shape[0] // 2, measured.spot.shape[0] // 2
    near = min(reach, inner)
    weights[reach - near : reach + near + 1, reach - near : reach + near + 1] += measured.spot[
        inner - near : inner + near + 1, inner - near : inner + near + 1
    ]
    return np.asarray(weights)


def tail_weights(radius: Array, scale: int) -> Array:
    """1 / (pi^3 r^3), rounded off towards the middle; 1.5 % less at `SPOT_PX`.

    Two softened tails (r^2 + b)^-1.5 / pi^3 are summed so that the first order in b cancels.
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

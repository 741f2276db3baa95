"""Ops for light that goes astray in the lens: veiling glare and starbursts.

Irradiance in, irradiance out; the sum of the light stays, but for what leaves the
picture.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
import numpy.typing as npt

from synfog_usd.base import photometry
from synfog_usd.base.arrays import STRIP_ROWS, FloatArray, planar, strips
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import blur, spread
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS

THREADS = 2

STAR_PX = 256
"""Longest spike, which fades over its outer half."""

PUPIL = 1024
"""Most samples across the aperture; they limit a spike to PUPIL / 2 * lambda N / pitch pixels."""

COLOURS = 5
"""Wavelengths of a channel, of equal weight."""


@OPS.op("optics.glare", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def glare(
    image: Image,
    *,
    fraction: Annotated[float, Range(0.0, 0.5), FromProfile("lens.glare_fraction")],
) -> Image:
    """Veiling glare: a part of the light is scattered over the picture.

    E' = (1 - f) E + f (E * h).  h(r) falls as 1 / (r^2 + r0^2): the slope of scatter
    by small roughness.  Computed on blocks of 1/480 of the width; r0 is one block.
    Light from outside the picture is taken as its mirror image, so that an even
    picture stays even.

    Args:
        image: irradiance (H, W, C).
        fraction: f [1].

    Source: Harvey and Shack, "Transfer characterization of scattered light in
    optical systems", Applied Optics 17 (1978); the slope of -2 is a usual one.
    """
    from scipy import fft

    if fraction == 0.0:
        return image
    block = max(1, round(image.width_px / 480))
    coarse = block_means(image.pixels, block)
    pixels = planar(image.pixels.shape)
    for channel in range(pixels.shape[2]):
        waves = fft.dctn(coarse[..., channel])  # cosines: the mirror image is in them
        waves *= _veil(*waves.shape)
        veil = np.float32(fraction) * np.maximum(fft.idctn(waves, overwrite_x=True), 0.0)
        plane = pixels[..., channel]
        for rows, more in enlarged(veil, block, *plane.shape):
            np.multiply(image.pixels[rows, :, channel], np.float32(1.0 - fraction), out=plane[rows])
            plane[rows] += more
    return image.with_pixels(pixels).with_metadata(glare_fraction=fraction)


@functools.lru_cache(maxsize=4)
def _veil(height: int, width: int) -> FloatArray:
    """(H, W) transfer of the veil at the frequencies of the cosine transform of so many blocks."""
    from scipy import fft

    y, x = (np.rint(np.fft.fftfreq(2 * length) * 2 * length) for length in (height, width))
    kernel = 1.0 / (y[:, None] ** 2 + x[None, :] ** 2 + 1.0)
    kernel[np.abs(y) > height // 2, :] = 0.0
    kernel[:, np.abs(x) > width // 2] = 0.0
    return fft.rfft2(kernel / kernel.sum()).real[:height, :width].astype(np.float32)


@OPS.op("optics.flare", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def flare(
    image: Image,
    *,
    blades: Annotated[int, Range(0, 32), FromProfile("lens.blades")] = 0,
    rotation_deg: Annotated[float, Range(-360.0, 360.0)] = 0.0,
    fraction: Annotated[float | None, Range(0.0, 0.5)] = None,
    threshold: Annotated[float, Range(1.0)] = spread.HIGHLIGHT,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
) -> Image:
    """Stars around lamps.

    An aperture of n straight blades diffracts light into n spikes, 2 n where n is odd, that fall as 1 / r^2.  That of a
    round one falls as 1 / r^3: the disc of `optics.diffraction`, which stands before this node.  The star is what
    |FFT(polygon)|^2 has more than the disc, over five wavelengths of the channel and integrated over pixels.  Only what
    exceeds the threshold is spread.

    Args:
        image: irradiance (H, W, C).
        blades: n; 0 for a round aperture, which makes no star.
        rotation_deg: of the star, anticlockwise from a spike to the right [degrees].
        fraction: part of a lamp's light that goes into its star [1]; empty: as much
            as diffraction gives.
        threshold: times the 95th percentile of the channel; what exceeds that is a lamp.
        f_number: N [1], of the round aperture of the same area.
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].
        sensor: weighs the wavelengths.

    Returns:
        Irradiance, >= 0.

    Raises:
        ImageError: one or two blades.

    Source: far-field diffraction, Goodman, "Introduction to Fourier Optics", chapter 4.
    """
    if blades in (1, 2):
        raise ImageError(f"{blades} blades; it is 0 (round) or from 3 on")
    per_nm = 1e-3 * f_number / pixel_pitch_um
    wavelengths_nm = _wavelengths_nm(blur.spectral_weights(sensor, image.channels))
    pixels, lights = image.pixels.copy(), []
    for channel in range(pixels.shape[2]):
        plane = image.pixels[..., channel]
        limit = np.float32(threshold / spread.HIGHLIGHT) * spread.highlight_limit(plane)
        lamps = np.maximum(plane - limit, 0.0)
        if not lamps.any():
            continue
        if blades and fraction != 0.0:
            star = _star(blades, rotation_deg, tuple(wavelengths_nm[channel] * per_nm))
            part = float(star.sum()) if fraction is None else fraction
            lights.append(float(f"{part:.4g}"))
            rows, columns = np.nonzero(lamps)
            stars = np.zeros_like(lamps)
            spread.add_spots(stars, rows, columns, lamps[rows, columns], star * np.float32(part / star.sum()))
            pixels[..., channel] += stars
            pixels[..., channel] -= np.float32(part) * lamps
    return image.with_pixels(np.maximum(pixels, 0.0, out=pixels)).with_metadata(flare_fractions=lights)


def _wavelengths_nm(weights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(C, COLOURS) middles of equal parts of each channel's electrons."""
    middles = (np.arange(COLOURS) + 0.5) / COLOURS
    return np.array([np.interp(middles, np.cumsum(row), photometry.WAVELENGTHS_NM) for row in weights])


@functools.lru_cache(maxsize=32)
def _star(blades: int, rotation_deg: float, qs: tuple[float, ...]) -> FloatArray:
    """What a polygon's pattern has more than a circle's, as parts of a point's light, in a square around its pixel.

    The mean over several lambda N / pitch.
    """
    samples = min(PUPIL, 2 * math.ceil(STAR_PX / min(qs)))
    reach = max(2, min(STAR_PX, int(samples * min(qs) / 2)))
    edges = np.arange(-reach, reach + 2) - 0.5
    radius = np.hypot(np.arange(-reach, reach + 1)[:, None], np.arange(-reach, reach + 1)[None, :])
    total = np.zeros(radius.shape)
    table = _summed_pattern(blades, rotation_deg, samples)
    for q in qs:
        place = np.clip(edges / (q / 2.0) + samples + 0.5, 0.0, 2.0 * samples)
        total += np.maximum(
            np.diff(np.diff(_between(_between(table, place).T, place).T, axis=0), axis=1)
            - spread.disc_weights(q, radius),
            0.0,
        )
    fade = np.clip(2.0 - 2.0 * radius / reach, 0.0, 1.0)
    return np.asarray(total / len(qs) * fade * fade * (3.0 - 2.0 * fade), dtype=np.float32)


def _between(table: npt.NDArray[np.float64], place: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rows of a table at places between its rows."""
    low = np.minimum(place.astype(int), table.shape[0] - 2)
    part = (place - low)[:, None]
    return np.asarray(table[low] * (1.0 - part) + table[low + 1] * part)


@functools.lru_cache(maxsize=2)
def _summed_pattern(blades: int, rotation_deg: float, samples: int) -> npt.NDArray[np.float64]:
    """Sums of a polygon's far field up to each edge between its samples, by rows and columns; 1 in all.

    There are twice as many samples each way as across the aperture, each lambda N / 2 wide.
    """
    from scipy import fft

    f = np.fft.fftfreq(2 * samples).astype(np.float32)
    edges = np.sinc(np.hypot(f[:, None], f[None, :]))  # what averaging the aperture's edges over a sample took away
    pattern = np.abs(fft.fft2(aperture(blades, rotation_deg, samples, 2 * samples), workers=THREADS) / edges) ** 2
    sums = np.zeros((2 * samples + 1, 2 * samples + 1))
    np.cumsum(
        np.cumsum(fft.fftshift(pattern / pattern.sum(dtype=np.float64)), axis=0, dtype=np.float64),
        axis=1,
        out=sums[1:, 1:],
    )
    return sums


def aperture(blades: int, rotation_deg: float, diameter: float, size: int) -> FloatArray:
    """(size, size) coverage, 0 to 1, of a regular polygon, or a circle where `blades` is 0, of the area of a circle of
    `diameter` samples.
    """
    middle = np.arange(size) - size // 2
    y, x = -middle[:, None], middle[None, :]
    if not blades:
        return np.clip(diameter / 2.0 - np.hypot(y, x) + 0.5, 0.0, 1.0).astype(np.float32)
    angles = math.radians(rotation_deg) + 2.0 * math.pi * np.arange(blades) / blades
    outside = functools.reduce(np.maximum, (math.cos(angle) * x + math.sin(angle) * y for angle in angles))
    inscribed = diameter / 2.0 * math.sqrt(math.pi / (blades * math.tan(math.pi / blades)))
    return np.clip(inscribed - outside + 0.5, 0.0, 1.0).astype(np.float32)


def block_means(pixels: FloatArray, block: int) -> FloatArray:
    """(ceil(H / block), ceil(W / block), C) means of square blocks; the last ones are smaller."""
    height, width, count = pixels.shape
    heights, widths = (np.diff(np.append(np.arange(0, size, block), size)) for size in (height, width))
    whole = height // block
    means = planar((heights.size, widths.size, count))
    lines = np.empty((heights.size, width), np.float32)
    for channel in range(count):
        plane = pixels[..., channel]
        np.sum(plane[: whole * block].reshape(whole, block, width), axis=1, out=lines[:whole])
        if whole < heights.size:
            np.sum(plane[whole * block :], axis=0, out=lines[-1])
        sums = lines[:, ::block].astype(np.float64)
        for step in range(1, block):
            more = lines[:, step::block]
            sums[:, : more.shape[1]] += more
        means[..., channel] = sums / np.outer(heights, widths)
    return means


def enlarged(coarse: FloatArray, block: int, height: int, width: int) -> Iterator[tuple[slice, FloatArray]]:
    """What blocks (h, w) hold, by straight lines between their centres: some rows of a picture, and these (R, W)."""
    padded = np.pad(coarse, 1, mode="edge")
    slope = np.diff(padded, axis=1)
    wide = np.empty((len(padded), width), dtype=np.float32)
    for first in range(block):  # columns that lie alike between two blocks
        columns = wide[:, first::block]
        between, part = _blocks_before(first, block, columns.shape[1])
        columns[...] = slope[:, between] * part + padded[:, between]
    for strip in strips(height, STRIP_ROWS * block):
        strip_of_result = np.empty((min(strip.stop, height) - strip.start, width), dtype=np.float32)
        coarse_rows = wide[strip.start // block :][: STRIP_ROWS + 2]
        slope = np.diff(coarse_rows, axis=0)
        for first in range(min(block, len(strip_of_result))):  # rows that do
            rows = strip_of_result[first::block]
            between, part = _blocks_before(first, block, len(rows))
            np.multiply(slope[between], part, out=rows)
            rows += coarse_rows[between]
        yield strip, strip_of_result


def _blocks_before(first: int, block: int, count: int) -> tuple[slice, np.float32]:
    """Of `count` pixels, every `block`-th from `first` on: the blocks before their centres, counted from one beyond the
    edge, and how far these are towards the next, 0 to 1.
    """
    place = (first + 0.5) / block + 0.5
    return slice(int(place), int(place) + count), np.float32(place % 1.0)

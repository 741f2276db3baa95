"""Ops for light that goes astray in the lens: veiling glare, starbursts and ghosts.

Irradiance in, irradiance out; the sum of the light stays, but for what leaves the
picture.
"""

from __future__ import annotations

import functools
import math
from typing import Annotated

import numpy as np
import numpy.typing as npt

from synfog_usd import photometry
from synfog_usd.arrays import Array, FloatArray
from synfog_usd.camera import blur, spread
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS
from synfog_usd.errors import ImageError
from synfog_usd.graph import Auto, FromProfile, Range
from synfog_usd.image import Image, Quantity

THREADS = 2

STAR_PX = 256
"""Longest spike, which fades over its outer half."""

PUPIL = 1024
"""Most samples across the aperture; they limit a spike to PUPIL / 2 * lambda N / pitch pixels."""

COLOURS = 5
"""Wavelengths of a channel, of equal weight."""

GHOSTS = ((-1.0, 0.05), (-0.45, 0.12), (0.35, 0.03), (-1.6, 0.2))
"""Where a ghost stands, times its lamp's offset from the axis, and its diameter in image widths.
Estimates: the true ones are in the lens's drawing."""


@OPS.op("optics.glare", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def glare(
    image: Image,
    *,
    fraction: Annotated[float, Range(0.0, 0.5), FromProfile("lens.glare_fraction")],
) -> Image:
    """Veiling glare: a part of the light is scattered over the picture.

    E' = (1 - f) E + f (E * h), h(r) ~ 1 / (r^2 + r0^2): the slope of scatter by
    small roughness.  Computed on blocks of 1/480 of the width; r0 is one block.
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
    height, width = coarse.shape[:2]
    reach_y, reach_x = height // 2, width // 2
    padded = np.pad(coarse.astype(np.float64), ((reach_y, reach_y), (reach_x, reach_x), (0, 0)), mode="symmetric")
    y = np.fft.fftfreq(padded.shape[0]) * padded.shape[0]
    x = np.fft.fftfreq(padded.shape[1]) * padded.shape[1]
    kernel = 1.0 / (y[:, None] ** 2 + x[None, :] ** 2 + 1.0)
    kernel[np.abs(y) > reach_y, :] = 0.0
    kernel[:, np.abs(x) > reach_x] = 0.0
    transfer = fft.rfft2(kernel / kernel.sum())[..., None]
    scattered = fft.irfft2(
        fft.rfft2(padded, axes=(0, 1), workers=THREADS) * transfer, s=padded.shape[:2], axes=(0, 1), workers=THREADS
    )
    scattered = np.maximum(scattered[reach_y : reach_y + height, reach_x : reach_x + width], 0.0).astype(np.float32)
    pixels = image.pixels * np.float32(1.0 - fraction)
    for channel in range(pixels.shape[2]):
        pixels[..., channel] += _enlarged(
            np.float32(fraction) * scattered[..., channel], image.height_px, image.width_px, block
        )
    return image.with_pixels(pixels).with_metadata(glare_fraction=fraction)


@OPS.op("optics.flare", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def flare(
    image: Image,
    *,
    blades: Annotated[int, Range(0, 32), FromProfile("lens.blades")] = 0,
    rotation_deg: Annotated[float, Range(-360.0, 360.0)] = 0.0,
    fraction: Annotated[float | None, Range(0.0, 0.5)] = None,
    ghosts: Annotated[tuple[float, ...] | None, Range(0.0, 0.05), FromProfile("lens.ghost_fractions")] = None,
    threshold: Annotated[float, Range(1.0)] = spread.HIGHLIGHT,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
    shift_x: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
    shift_y: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
) -> Image:
    """Stars around lamps, and ghosts: their mirror images through the axis.

    An aperture of n straight blades diffracts light into n spikes (2 n where n is
    odd) that fall as 1 / r^2, while that of a round one falls as 1 / r^3.  The star is
    what |FFT(polygon)|^2, over five wavelengths of the channel and integrated over
    pixels, has more than the disc of a round aperture; `optics.diffraction`, before
    this node, makes that disc.  A ghost is a defocused image of the aperture.  Only what
    exceeds the threshold is spread.

    Args:
        image: irradiance (H, W, C).
        blades: n; 0 for a round aperture, which makes no star.
        rotation_deg: of the star, anticlockwise from a spike to the right [degrees].
        fraction: part of a lamp's light that goes into its star [1]; empty: as much
            as diffraction gives.
        ghosts: part of a lamp's light that goes into each ghost, up to four [1];
            places and sizes are those of `GHOSTS`.
        threshold: times the 95th percentile of the channel; what exceeds that is a lamp.
        f_number: N [1], of the round aperture of the same area.
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].
        sensor: weighs the wavelengths.
        shift_x, shift_y: offset of the axis from the centre, in image widths and
            heights, right and up.

    Returns:
        Irradiance, >= 0.

    Raises:
        ImageError: one or two blades, or more than four ghosts.

    Source: far-field diffraction, Goodman, "Introduction to Fourier Optics", chapter 4.
    """
    ghosts = tuple(ghosts or ())
    if blades in (1, 2) or len(ghosts) > len(GHOSTS):
        raise ImageError(
            f"{blades} blades and {len(ghosts)} ghosts; blades is 0 (round) or from 3 on, and there are up to "
            f"{len(GHOSTS)} ghosts"
        )
    per_nm = 1e-3 * f_number / pixel_pitch_um
    wavelengths_nm = _wavelengths_nm(blur.spectral_weights(sensor, image.channels))
    pixels, given = image.pixels.copy(), []
    for channel in range(pixels.shape[2]):
        plane = image.pixels[..., channel]
        limit = np.float32(threshold / spread.HIGHLIGHT) * spread.highlight_limit(plane)
        lamps = np.maximum(plane - limit, 0.0)
        if not lamps.any():
            continue
        lost = sum(ghosts)
        if blades and fraction != 0.0:
            star = _star(blades, rotation_deg, tuple(wavelengths_nm[channel] * per_nm))
            part = float(star.sum()) if fraction is None else fraction
            lost += part
            given.append(float(f"{part:.4g}"))
            pixels[..., channel] += _starry(lamps, star * np.float32(part / star.sum()))
        if sum(ghosts):
            axis = (
                (image.height_px - 1) / 2 - shift_y * image.height_px,
                (image.width_px - 1) / 2 + shift_x * image.width_px,
            )
            pixels[..., channel] += _ghosts(lamps, ghosts, axis, blades, rotation_deg)
        pixels[..., channel] -= np.float32(lost) * lamps
    return image.with_pixels(np.maximum(pixels, 0.0, out=pixels)).with_metadata(
        flare_fractions=given, ghost_fractions=list(ghosts)
    )


def _wavelengths_nm(weights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(C, COLOURS) middles of equal parts of each channel's electrons."""
    middles = (np.arange(COLOURS) + 0.5) / COLOURS
    return np.array([np.interp(middles, np.cumsum(row), photometry.WAVELENGTHS_NM) for row in weights])


def _starry(lamps: FloatArray, star: FloatArray) -> FloatArray:
    """The light of the stars; what lies outside the picture has none."""
    from scipy import fft

    reach = star.shape[0] // 2
    sizes = [fft.next_fast_len(length + 2 * reach, real=True) for length in lamps.shape]
    padded = np.pad(lamps, [(reach, size - length - reach) for length, size in zip(lamps.shape, sizes, strict=True)])
    stars = np.zeros_like(padded)
    spread.add_spots(stars, padded, star)
    return stars[reach : reach + lamps.shape[0], reach : reach + lamps.shape[1]]


@functools.lru_cache(maxsize=32)
def _star(blades: int, rotation_deg: float, qs: tuple[float, ...]) -> FloatArray:
    """(2 R + 1, 2 R + 1) what a polygon's pattern has more than a circle's, as parts of a point's light; mean of
    several lambda N / pitch.
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
    """(2 S + 1, 2 S + 1) sums of a polygon's far field up to each edge between its samples, which are lambda N / 2
    wide; 1 in all.
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


def _ghosts(
    lamps: FloatArray, fractions: tuple[float, ...], axis: tuple[float, float], blades: int, rotation_deg: float
) -> FloatArray:
    """(H, W) light of the ghosts, on blocks of 1/480 of the width; `axis` is (row, column)."""
    from scipy import fft

    height, width = lamps.shape
    block = max(1, round(width / 480))
    light = (
        np.add.reduceat(
            np.add.reduceat(lamps, np.arange(0, height, block), axis=0, dtype=np.float64),
            np.arange(0, width, block),
            axis=1,
        )
        / block**2
    )
    rows, columns = np.nonzero(light)
    amounts = light[rows, columns]
    total = np.zeros(light.shape)
    for fraction, (place, diameter) in zip(fractions, GHOSTS, strict=False):
        disc_blocks = max(1.0, diameter * width / block)
        edge = math.ceil(disc_blocks) + 2
        spread = np.zeros(tuple(fft.next_fast_len(length + 2 * edge, real=True) for length in light.shape))
        at = [
            (index * block + (block - 1) / 2 - middle) * place + middle
            for index, middle in zip((rows, columns), axis, strict=True)
        ]
        row, column = ((value - (block - 1) / 2) / block + edge for value in at)
        low_row, low_column = np.floor(row).astype(int), np.floor(column).astype(int)
        for next_row in (0, 1):
            for next_column in (0, 1):
                to_row, to_column = low_row + next_row, low_column + next_column
                share = np.abs(1 - next_row - (row - low_row)) * np.abs(1 - next_column - (column - low_column))
                inside = (to_row >= 0) & (to_row < spread.shape[0]) & (to_column >= 0) & (to_column < spread.shape[1])
                np.add.at(spread, (to_row[inside], to_column[inside]), (amounts * share)[inside])
        size = 2 * edge + 1
        disc = np.zeros(spread.shape)
        disc[:size, :size] = aperture(blades, rotation_deg, disc_blocks, size)
        disc = np.roll(disc / disc.sum(), (-edge, -edge), axis=(0, 1))
        spread = fft.irfft2(fft.rfft2(spread) * fft.rfft2(disc), s=spread.shape)
        total += fraction * np.maximum(spread[edge : edge + light.shape[0], edge : edge + light.shape[1]], 0.0)
    return _enlarged(total.astype(np.float32), height, width, block)


def block_means(pixels: FloatArray, block: int) -> FloatArray:
    """(ceil(H / block), ceil(W / block), C) means of square blocks; the last ones are smaller."""
    rows, columns = np.arange(0, pixels.shape[0], block), np.arange(0, pixels.shape[1], block)
    sums = _added(_added(pixels.astype(np.float32, copy=False), block, axis=0), block, axis=1)
    heights, widths = np.diff(np.append(rows, pixels.shape[0])), np.diff(np.append(columns, pixels.shape[1]))
    return np.asarray(sums / (heights[:, None, None] * widths[None, :, None]), dtype=np.float32)


def _added(pixels: Array, block: int, axis: int) -> Array:
    """Sums of so many neighbours along rows or columns, in double precision; a pass over memory for each of them."""
    total = pixels[(slice(None),) * axis + (slice(None, None, block),)].astype(np.float64)
    for step in range(1, block):
        more = pixels[(slice(None),) * axis + (slice(step, None, block),)]
        total[(slice(None),) * axis + (slice(more.shape[axis]),)] += more
    return total


def _enlarged(coarse: FloatArray, height: int, width: int, block: int) -> FloatArray:
    """(height, width) by straight lines between the centres of blocks."""
    low, part = _between_blocks(height, coarse.shape[0], block)
    rows = coarse[low] + part[:, None] * (coarse[np.minimum(low + 1, coarse.shape[0] - 1)] - coarse[low])
    low, part = _between_blocks(width, coarse.shape[1], block)
    slope = np.diff(rows, axis=1, append=rows[:, -1:])
    fine = np.take(slope, low, axis=1)
    fine *= part
    fine += np.take(rows, low, axis=1)
    return np.asarray(fine)


def _between_blocks(fine: int, coarse: int, block: int) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """The block before each pixel's centre, and how far it is towards the next, 0 to 1."""
    place = np.clip((np.arange(fine) + 0.5) / block - 0.5, 0.0, coarse - 1.0)
    low = place.astype(np.intp)
    return low, (place - low).astype(np.float32)

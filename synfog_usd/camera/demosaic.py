"""Demosaicing: from one number per pixel to a plane for every colour filter.

Takes a white-balanced mosaic of any pattern; gives planes in the order of
`cfa.filters`, or the one plane Y of a sensor that sees no colour.  OpenImageIO is
imported on first use.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from synfog_usd.base.arrays import FloatArray, planar, strips
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image
from synfog_usd.camera import cfa
from synfog_usd.camera.graph import FromProfile
from synfog_usd.camera.isp import MOSAIC, PICTURE, SATURATED, pattern_of
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS

STRIP_ROWS = 48
"""Rows that are worked on at a time, so that they stay in the processor's cache; even, so that each strip begins with
the pattern's first row.
"""

HALO_PX = 6
"""How far beside a pixel others count; even, so that the pattern's phase stays."""

SPOILT_PX = 7
"""Side of the square in which a saturated pixel spoils what is interpolated."""


@OPS.op("isp.demosaic", takes=MOSAIC, gives=PICTURE)
def demosaic(
    image: Image,
    *,
    algorithm: Literal["directional", "linear", "mhc"] = "directional",
    sensor: Annotated[SensorProfile | None, FromProfile("sensor")] = None,
) -> Image:
    """The missing colours of each pixel from its neighbours.

    Bayer patterns become R, G, B.  RCCB and RGIB become a plane per filter, each
    interpolated linearly from its own pixels; `isp.colour_correct` makes R, G, B of
    them.  RCCC becomes Y: the clear pixels, and at red ones the mean of the clear
    pixels around.  MONO becomes Y unchanged.

    Args:
        image: white-balanced mosaic, at least 2 x 2.
        algorithm: of Bayer patterns.  directional follows edges, so that they get no colours that are not there, and
            averages where there are none.  linear is a linear filter, for measurements; mhc (Malvar, He and Cutler
            2004) is one too, and sharper.
        sensor: names the pattern where the image does not.

    Raises:
        ImageError: OpenImageIO failed, or the picture is smaller than 2 x 2.
    """
    if len(image.channels) != 1:
        raise ImageError(f"a mosaic has one channel; this image has {', '.join(image.channels)}")
    pattern = pattern_of(image, sensor)
    if pattern == "MONO":
        return image.with_pixels(image.pixels, channels=("Y",))
    if image.height_px < 2 or image.width_px < 2:
        raise ImageError(f"{image.width_px} x {image.height_px} pixels hold no full mosaic; the least is 2 x 2")
    if pattern == "RCCC":
        return image.with_pixels(_plane(image.pixels[..., 0], pattern, "C")[..., None], channels=("Y",))
    letters = cfa.filters(pattern)
    if pattern not in cfa.BAYER:
        return image.with_pixels(
            np.stack([_plane(image.pixels[..., 0], pattern, letter) for letter in letters], axis=-1), channels=letters
        )
    if algorithm == "directional":
        pixels = _directional(image.pixels[..., 0], pattern)
    else:
        pixels = _linear(image.pixels, pattern, {"linear": "linear", "mhc": "MHC"}[algorithm])
    return image.with_pixels(pixels, channels=letters).with_metadata(demosaic=algorithm)


def _linear(mosaic: FloatArray, pattern: str, algorithm: str) -> FloatArray:
    """(H, W, 3) of a Bayer mosaic (H, W, 1) by a filter of OpenImageIO, whose failed calls give empty buffers."""
    import OpenImageIO

    buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(mosaic))
    planes = OpenImageIO.ImageBufAlgo.demosaic(buffer, pattern="bayer", algorithm=algorithm, layout=pattern)
    if planes.has_error or not planes.initialized:
        raise ImageError(f"OpenImageIO could not demosaic: {planes.geterror()}")
    return np.asarray(planes.get_pixels(OpenImageIO.FLOAT), dtype=np.float32).reshape(*mosaic.shape[:2], 3)


def _directional(mosaic: FloatArray, pattern: str) -> FloatArray:
    """(H, W, 3) of a Bayer mosaic: colour differences along rows and along columns, the smoother of the two counting
    more.

    g(x) is the second-order interpolation of Hamilton and Adams along a row of red and green.  s (x - g(x)), with
    s = -1 at green sites, is red - green at every site of the row; columns alike.  d_h and d_v say how much these
    differences h and v change within 5 x 5 sites.  The difference at a red site is
    (d_v^2 h + d_h^2 v) / (d_v^2 + d_h^2).  Along an edge it is the one along it; where there is none it is the mean of
    both, with half the noise.  Between its sites it is interpolated linearly.

    Source: interpolation: Hamilton and Adams (1997), US patent 5629734.  Differences at all sites: Zhang and Wu (2005),
    "Color demosaicking via directional linear minimum mean square-error estimation".  Weights: Pekkucuksen and
    Altunbasak (2010), "Gradient based threshold free color filter array interpolation".
    """
    height, width = mosaic.shape
    signed = np.pad(mosaic, HALO_PX, mode="reflect")
    signs = cfa.factors(pattern, (1.0, -1.0, 1.0), STRIP_ROWS, signed.shape[1])
    for rows in strips(len(signed), STRIP_ROWS):
        signed[rows] *= signs[: len(signed[rows])]
    picture = planar((height, width, 3))
    for rows in strips(height, STRIP_ROWS):
        _directional_strip(mosaic[rows], signed[rows.start : rows.stop + 2 * HALO_PX], pattern, picture[rows])
    _bound_by_neighbours(picture, mosaic, pattern)
    return picture


def _bound_by_neighbours(picture: FloatArray, mosaic: FloatArray, pattern: str) -> None:
    """Around saturated pixels no colour leaves the range that its own filter has in the 3 x 3 pixels around, in place.

    A saturated pixel is too low, and so are differences to it: a lamp would get a rim of another colour or a black one.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    saturated = mosaic >= SATURATED
    if not saturated.any():
        return
    rims = maximum_filter(saturated, SPOILT_PX, mode="mirror") & ~minimum_filter(saturated, SPOILT_PX, mode="mirror")
    rows, columns = np.nonzero(rims)
    filters = cfa.factors(pattern, range(3), 2, 2).astype(int)
    around, place = np.pad(mosaic, 1, mode="reflect"), np.arange(rows.size)
    lowest = np.full((3, rows.size), np.inf, np.float32)
    highest = np.full((3, rows.size), -np.inf, np.float32)
    for down in range(3):
        for right in range(3):
            value = around[rows + down, columns + right]
            number = filters[(rows + down + 1) % 2, (columns + right + 1) % 2]
            lowest[number, place] = np.minimum(lowest[number, place], value)
            highest[number, place] = np.maximum(highest[number, place], value)
    picture[rows, columns] = np.clip(picture[rows, columns], lowest.T, highest.T)


def _directional_strip(mosaic: FloatArray, signed: FloatArray, pattern: str, out: FloatArray) -> None:
    """Rows (H, W) of a mosaic to planes (H, W, 3); `signed` has `HALO_PX` more on each side, green negative."""
    down = _differences(signed)
    green = out[..., 1]
    green[...] = mosaic
    rows, columns = mosaic.shape
    sites = [("RGB"[number], where[0].start, where[1].start) for where, number in cfa.sites(pattern)]
    for letter, row, column in sites:
        if letter != "G":
            native = green[row::2, column::2]
            native -= down[1:-1, 1:-1][row::2, column::2]
    for letter, row, column in sites:
        if letter != "G":
            lines, plane = np.empty((rows // 2 + 2, columns), np.float32), out[..., "RGB".index(letter)]
            measured = down[(row + 1) % 2 :: 2, (column + 1) % 2 :: 2]  # from one row and column outside on, where odd
            _between(measured.T, column, lines[: len(measured)].T)
            _between(lines, row, plane)
            plane += green
            plane[row::2, column::2] = mosaic[row::2, column::2]  # but for its rounding it is that already


def _differences(signed: FloatArray) -> FloatArray:
    """Colour differences of the rows and of one pixel around; `signed` has `HALO_PX` more on each side than the rows.

    All rows are taken as one line, in which the pixel below is a row's length further on: one long line is faster than
    many.
    """
    height, length = signed.shape
    result = np.empty((height - 10, length), np.float32)
    line = result.reshape(-1)[:-10]  # to one pixel behind the last
    across, weight = _along(signed[3:-3].reshape(-1), 1, length, slice(2 * length + 5, 2 * length + 5 + line.size))
    down, change = _along(signed.reshape(-1), length, 1, slice(5 * length + 5, 5 * length + 5 + line.size))
    change += np.float32(1e-16)
    weight += change
    np.divide(change, weight, out=weight)
    across -= down
    across *= weight
    down += across  # w h + (1 - w) v
    np.multiply(down, np.float32(1.0 / 16.0), out=line)
    return result[:, :-10]


def _along(line: FloatArray, step: int, other_step: int, places: slice) -> tuple[FloatArray, FloatArray]:
    """16 times the smoothed colour differences between pixels `step` apart, and 10,000 times the square of how much
    they change, at some places of a line; `other_step` is the way across.

    Filters are sums of sums of two neighbours.
    """
    pairs = line[:-step] + line[step:]
    fours = pairs[: -2 * step] + pairs[2 * step :]
    difference = fours[:-step] + fours[step:]  # from 2 steps on
    pairs = difference[:-step] + difference[step:]
    smooth = pairs[:-step] + pairs[step:]  # from 3 steps on
    change = difference[2 * step :] - difference[: -2 * step]
    np.abs(change, out=change)
    change = _sums_of_five(_sums_of_five(change, step), other_step)  # from 5 steps, and 2 across, on
    first, count = places.start, places.stop - places.start
    smooth, change = smooth[first - 3 * step :][:count], change[first - 5 * step - 2 * other_step :][:count]
    return smooth, np.multiply(change, change, out=change)


def _sums_of_five(line: FloatArray, step: int) -> FloatArray:
    pairs = line[:-step] + line[step:]
    sums = pairs[: -3 * step] + pairs[2 * step : -step]
    sums += line[4 * step :]
    return sums


def _between(values: FloatArray, first: int, out: FloatArray) -> None:
    """Rows known at 0, 2 ... or, where `first` is 1, at -1, 1 ..., and between them the means of two neighbours."""
    samples, gaps = out[first::2], out[1 - first :: 2]
    samples[...] = values[first:][: len(samples)]
    np.add(values[: len(gaps)], values[1 : len(gaps) + 1], out=gaps)
    gaps *= np.float32(0.5)


def _plane(mosaic: FloatArray, pattern: str, letter: str) -> FloatArray:
    """(H, W) plane of one filter: its own pixels, and between them their mean weighted by nearness.

    Normalised convolution with a tent: linear interpolation inside, and at borders the weights of the pixels that are
    there.

    Source: Knutsson and Westin, "Normalized and differential convolution" (1993).
    """
    from scipy.ndimage import convolve1d

    height, width = mosaic.shape
    sites = [where for where, number in cfa.sites(pattern) if cfa.filters(pattern)[number] == letter]
    tent = (1.0, 2.0, 1.0)
    plane, weights = np.zeros_like(mosaic), np.zeros_like(mosaic)
    for where in sites:
        plane[where] = mosaic[where]
        there = [np.zeros(size, dtype=np.float32) for size in (height, width)]
        for line, grid in zip(there, where, strict=True):
            line[grid] = 1.0
        weights += np.outer(*(convolve1d(line, tent, mode="constant") for line in there))
    for axis in (0, 1):
        plane = convolve1d(plane, tent, axis=axis, mode="constant")
    plane /= weights
    for where in sites:
        plane[where] = mosaic[where]
    return plane

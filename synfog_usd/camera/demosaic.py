"""Demosaicing: from one number per pixel to a plane for every colour filter.

Takes a white-balanced mosaic of any pattern; gives planes in the order of
`cfa.filters`, or the one plane Y of a sensor that sees no colour.  OpenImageIO and
colour-demosaicing are imported on first use.
"""

from __future__ import annotations

import warnings
from typing import Annotated, Any, Literal

import numpy as np

from synfog_usd.arrays import FloatArray
from synfog_usd.camera import cfa
from synfog_usd.camera.isp import MOSAIC, PICTURE, pattern_of
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS
from synfog_usd.errors import ImageError
from synfog_usd.graph import FromProfile
from synfog_usd.graph.buffers import checked, pixels_of, to_buf
from synfog_usd.image import Image
from synfog_usd.science import colour_science

STRIP_ROWS, HALO_ROWS = 64, 8
"""Rows that are worked on at a time, so that they stay in the processor's cache, and those beside them that count: six
of the filters and one between sites.  Even, so that each strip begins with the pattern's first row.
"""


@OPS.op("isp.demosaic", takes=MOSAIC, gives=PICTURE)
def demosaic(
    image: Image,
    *,
    algorithm: Literal["directional", "linear", "mhc", "menon"] = "directional",
    sensor: Annotated[SensorProfile | None, FromProfile("sensor")] = None,
) -> Image:
    """The missing colours of each pixel from its neighbours.

    Bayer patterns become R, G, B.  RCCB and RGIB become a plane per filter, each
    interpolated linearly from its own pixels; `isp.colour_correct` makes R, G, B of
    them.  RCCC becomes Y: the clear pixels, and at red ones the mean of the clear
    pixels around.  MONO becomes Y unchanged.

    Args:
        image: white-balanced mosaic, at least 2 x 2.
        algorithm: of Bayer patterns.  directional follows edges, so that they get no
            colours that are not there, and averages where there are none; linear is a linear
            filter, for measurements; mhc (Malvar, He and Cutler 2004) is one too, and sharper;
            menon (Menon, Andriani and Calvagno 2007) follows edges, is a little sharper than
            directional, noisier, and eight times slower.
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
    if algorithm == "menon":
        pixels = _colour_demosaicing().demosaicing_CFA_Bayer_Menon2007(image.pixels[..., 0], pattern)
    elif algorithm == "directional":
        pixels = _directional(image.pixels[..., 0], pattern)
    else:
        import OpenImageIO

        name = {"linear": "linear", "mhc": "MHC"}[algorithm]
        pixels = pixels_of(
            checked(
                OpenImageIO.ImageBufAlgo.demosaic(to_buf(image), pattern="bayer", algorithm=name, layout=pattern),
                "demosaic",
            )
        )
    return image.with_pixels(pixels, channels=letters).with_metadata(demosaic=algorithm)


def _directional(mosaic: FloatArray, pattern: str) -> FloatArray:
    """(H, W, 3) of a Bayer mosaic: colour differences along rows and along columns, the smoother of the two counting
    more.

    Along a row of red and green, s (x - g(x)) with g the second-order interpolation of
    Hamilton and Adams and s = -1 at green sites is red - green at every site; so along
    columns.  With d_h and d_v how much these change within 5 x 5 sites, the difference at a red site is
    (d_v^2 h + d_h^2 v) / (d_v^2 + d_h^2): along an edge where there is one, the mean of both, and so
    half the noise, where there is none.  Between its sites it is interpolated linearly, which leaves no colour of one
    pixel.

    Source: interpolation: Hamilton and Adams, US patent 5 629 734 (1997); differences at all sites: Zhang and
    Wu, "Color demosaicking via directional linear minimum mean square-error estimation" (2005);
    weights: Pekkucuksen and Altunbasak, "Gradient based threshold free color filter array interpolation" (2010).
    """
    height = len(mosaic)
    picture = np.empty((*mosaic.shape, 3), dtype=np.float32)
    for top in range(0, height, STRIP_ROWS):
        begin, end = max(0, top - HALO_ROWS), min(height, top + STRIP_ROWS + HALO_ROWS)
        part = _directional_strip(mosaic[begin:end], pattern)
        picture[top : top + STRIP_ROWS] = part[top - begin : top - begin + STRIP_ROWS]
    return picture


def _directional_strip(mosaic: FloatArray, pattern: str) -> FloatArray:
    sites = {letter: [where for where, number in cfa.sites(pattern) if "RGB"[number] == letter] for letter in "RGB"}
    differences, changes = [], []
    for axis in (1, 0):
        difference = _filtered(mosaic, (0.5, -0.5, 0.25), axis)
        for where in sites["G"]:
            np.negative(difference[where], out=difference[where])
        differences.append(_filtered(difference, (0.5, 0.25), axis))
        change = np.abs(_filtered(difference, (0.0, 1.0), axis, odd=True))
        change = _filtered(_filtered(change, (0.2, 0.2, 0.2), 0), (0.2, 0.2, 0.2), 1)
        changes.append(np.multiply(change, change, out=change))
    across, down = differences
    weight = changes[1] / (changes[0] + changes[1] + np.float32(1e-20))
    across -= down
    across *= weight
    down += across  # w h + (1 - w) v
    green = mosaic.copy()
    planes = [green, green, green]
    for letter, index in (("R", 0), ("B", 2)):
        (where,) = sites[letter]
        own = down[where]
        green[where] -= own
        for axis, length in enumerate(mosaic.shape):
            own = np.moveaxis(_between(np.moveaxis(own, axis, 0), where[axis].start or 0, length), 0, axis)
        planes[index] = own
    picture = np.empty((*mosaic.shape, 3), dtype=np.float32)
    np.copyto(picture[..., 1], green)
    for letter, index in (("R", 0), ("B", 2)):
        (where,) = sites[letter]
        np.add(green, planes[index], out=picture[..., index])
        picture[(*where, index)] = mosaic[where]  # but for its rounding it is that already
    return picture


def _filtered(values: FloatArray, taps: tuple[float, ...], axis: int, *, odd: bool = False) -> FloatArray:
    """Through an even filter, told from its middle outwards, or an odd one; mirrored at the edges.

    In single precision and by whole slices, which is three times as fast as scipy.ndimage.
    """
    reach, length = len(taps) - 1, values.shape[axis]
    pads = [(reach, reach) if line == axis else (0, 0) for line in range(2)]
    padded = np.pad(values, pads, mode="reflect")

    def shifted(by: int) -> FloatArray:
        return padded[reach + by : reach + by + length] if axis == 0 else padded[:, reach + by : reach + by + length]

    found = values * np.float32(taps[0])
    for by, tap in enumerate(taps[1:], 1):
        if tap:
            pair = (np.subtract if odd else np.add)(shifted(by), shifted(-by))
            pair *= np.float32(tap)
            found += pair
    return found


def _between(values: FloatArray, first: int, length: int) -> FloatArray:
    """Rows known at `first`, `first` + 2 ..., and those between: means of two neighbours, at an end the only one."""
    found = np.empty((length, *values.shape[1:]), dtype=values.dtype)
    found[first::2] = values
    gaps = found[first + 1 : first + 2 * len(values) - 1 : 2]
    np.add(values[:-1], values[1:], out=gaps)
    gaps *= np.float32(0.5)
    if first:
        found[0] = values[0]
    if (length - first) % 2 == 0:
        found[-1] = values[-1]
    return found


def _plane(mosaic: FloatArray, pattern: str, letter: str) -> FloatArray:
    """(H, W) plane of one filter: its own pixels, and between them their mean weighted by nearness.

    Normalised convolution with the tent (1 2 1)^2: linear interpolation inside, and
    at borders the weights of the pixels that are there.

    Source: Knutsson and Westin, "Normalized and differential convolution" (1993).
    """
    from scipy.ndimage import convolve1d

    height, width = mosaic.shape
    own = [where for where, number in cfa.sites(pattern) if cfa.filters(pattern)[number] == letter]
    tent = (1.0, 2.0, 1.0)
    plane, weights = np.zeros_like(mosaic), np.zeros_like(mosaic)
    for where in own:
        plane[where] = mosaic[where]
        there = [np.zeros(size, dtype=np.float32) for size in (height, width)]
        for line, grid in zip(there, where, strict=True):
            line[grid] = 1.0
        weights += np.outer(*(convolve1d(line, tent, mode="constant") for line in there))
    for axis in (0, 1):
        plane = convolve1d(plane, tent, axis=axis, mode="constant")
    plane /= weights
    for where in own:
        plane[where] = mosaic[where]
    return plane


def _colour_demosaicing() -> Any:
    """The module `colour_demosaicing`; imported on the first call, without SciPy's remark on how it imports."""
    colour_science()
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message=".*`scipy.ndimage.filters` namespace is deprecated", category=DeprecationWarning
        )
        import colour_demosaicing
    return colour_demosaicing

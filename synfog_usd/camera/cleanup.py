"""Optional ops of the image signal processor: noise, false colours, sharpness.

`isp.denoise` stands right behind `isp.black_level`, where the noise
is as the sensor made it; `isp.false_colour` stands behind `isp.demosaic`, `isp.sharpen` behind `isp.gamma`.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from synfog_usd.base.arrays import Flags, FloatArray, planar
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image
from synfog_usd.camera import cfa
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.isp import DISPLAY, PICTURE, SATURATED, SENSED, pattern_of
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS

REACH_PX = (1, 2)
"""How far off the neighbours are among which `isp.false_colour` takes medians, one after the other."""

LOST_PX, AROUND_PX = 3, 5
"""Sides of the squares in which a saturated pixel spoils the colour, and from whose other pixels it is taken."""

STRIP_PX = 96
"""Rows that `isp.false_colour` treats at a time, so that they stay in a cache."""

SPLINE = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)
"""Cubic B-spline: the smoothing step of the starlet transform."""


@OPS.op("isp.denoise", takes=SENSED, gives=SENSED)
def denoise(
    image: Image,
    *,
    strength: Annotated[float, Range(0.0, 10.0)] = 3.0,
    levels: Annotated[int, Range(1, 5)] = 3,
    sensor: Annotated[SensorProfile | None, FromProfile("sensor")] = None,
) -> Image:
    """Less noise by shrinking what stands out of it least, each colour filter by itself.

    The starlet transform splits the pixels of a filter into details of 1, 2, 4 ... pixels
    and a smooth rest.  With T = strength * (standard deviation of the noise in that
    detail), a detail w becomes w max(0, 1 - T^2 / w^2): what is below T goes, and what is
    large loses T^2 / w.  So contrast below the noise is lost with it, an edge of ten T
    keeps 99 % of its height, and the mean of a region stays.

    Args:
        image: mosaic behind `isp.black_level`, before any other gain.
        strength: threshold in standard deviations [1]; 0 changes nothing.
        levels: how many sizes of detail are treated.
        sensor: names the pattern where the image does not.

    Raises:
        ImageError: more than one channel, or no noise profile.

    Source: transform and noise per level: Starck and Murtagh, "Astronomical Image and
    Data Analysis" (2006), chapter 2; shrinkage: Gao, "Wavelet shrinkage denoising using
    the non-negative garrote" (1998).
    """
    shot, dark = _noise_profile(image)
    pixels = np.empty_like(image.pixels)
    for where, _ in cfa.sites(pattern_of(image, sensor)):
        smooth = image.pixels[(*where, 0)].copy()
        details = []
        for level in range(levels):
            rest = _smoothed(smooth, level)
            smooth -= rest
            details.append(smooth)
            smooth = rest
        variance = _variance(smooth, shot, dark)
        for detail, part in zip(details, starlet_noise(levels), strict=True):
            power = np.maximum(detail * detail, np.float32(1e-30))
            residual = variance * np.float32(-((strength * part) ** 2))
            residual /= power
            residual += np.float32(1.0)
            detail *= np.maximum(residual, 0.0, out=residual)
            smooth = smooth + detail
        pixels[(*where, 0)] = smooth
    return image.with_pixels(pixels).with_metadata(denoise=strength)


@OPS.op("isp.false_colour", takes=PICTURE, gives=PICTURE)
def false_colour(image: Image) -> Image:
    """Colours that stand in a pixel or two alone give way to those around: demosaicing makes them of fine detail.

    R - G and B - G become medians of three, along columns and rows, of next neighbours, then of those two pixels off.
    Green, which carries the detail, stays, and so does an edge between two colours, since a median keeps steps.
    Coloured things of one or two pixels lose their colour.

    At the rim of what saturates green, R - G and B - G are those of the pixels around: a far lamp is white whichever
    filter it falls on.  A lamp of several pixels keeps the colour of its middle.

    Args:
        image: picture behind `isp.demosaic`; one without R, G and B stays as it is.

    Source: Freeman, "Median filter for reconstructing missing color samples", US patent 4724395 (1988).
    """
    if image.channels != ("R", "G", "B"):
        return image
    pixels = planar(image.pixels.shape)
    rim = sum(REACH_PX) + (LOST_PX + AROUND_PX) // 2
    for top in range(0, image.height_px, STRIP_PX):
        first = max(top - rim, 0)
        rows = image.pixels[first : top + STRIP_PX + rim]
        inner = slice(top - first, top - first + STRIP_PX)
        green = rows[..., 1]
        pixels[top : top + STRIP_PX, :, 1] = green[inner]
        reliable = _reliable_colour(green) if (green >= SATURATED).any() else None
        for channel in (0, 2):
            difference = rows[..., channel] - green
            if reliable is not None:
                difference[~reliable] = _mean_of(difference, reliable)[~reliable]
            for reach in REACH_PX:
                _median_of_three(difference, reach)
                if (width := image.width_px) > 2 * reach:
                    rims = [*range(reach), *range(width - reach, width)]
                    centre = difference[:, rims]
                    _median_of_three(difference.reshape(-1), reach)  # one long line is faster than many
                    difference[:, rims] = centre
            np.add(green[inner], difference[inner], out=pixels[top : top + STRIP_PX, :, channel])
    return image.with_pixels(pixels)


@OPS.op("isp.sharpen", takes=DISPLAY, gives=DISPLAY)
def sharpen(
    image: Image,
    *,
    radius_px: Annotated[float, Range(0.2, 20.0)] = 1.0,
    amount: Annotated[float, Range(0.0, 5.0)] = 0.5,
    threshold: Annotated[float, Range(0.0, 1.0)] = 0.01,
) -> Image:
    """Unsharp mask on brightness: what a blur takes away is added once more; colours stay.

    With d = luma - (luma blurred), every channel gets amount * (d - threshold), towards 0
    where |d| is below the threshold.  Noise above the threshold is sharpened too.

    Args:
        image: coded picture, 0 to 1, R, G, B or Y.
        radius_px: standard deviation of the Gaussian blur [px].
        amount: how much of the detail is added [1].
        threshold: detail that is left alone, as noise [1]; 1 is the range from black to white.

    The result is cut to 0 to 1.
    """
    from scipy.ndimage import gaussian_filter

    luma = image.pixels[..., 0] if len(image.channels) == 1 else image.pixels @ LUMINANCE.astype(np.float32)
    detail = luma - gaussian_filter(luma, radius_px, mode="nearest", truncate=3.0)
    detail -= np.clip(detail, np.float32(-threshold), np.float32(threshold))
    detail *= np.float32(amount)
    pixels = image.pixels + detail[..., None]
    return image.with_pixels(np.clip(pixels, 0.0, 1.0, out=pixels))


def starlet_noise(levels: int) -> list[float]:
    """Standard deviation of each detail of the starlet transform of white noise of 1.

    A detail is the difference of two separable filters f f^T - g g^T, so its variance is
    |f|^4 + |g|^4 - 2 (f . g)^2.

    >>> [round(value, 3) for value in starlet_noise(3)]
    [0.891, 0.201, 0.086]
    """
    sigmas = []
    narrow = np.ones(1)
    for level in range(levels):
        wide = np.convolve(narrow, _dilated(level))
        padded = np.pad(narrow, (wide.size - narrow.size) // 2)
        sigmas.append(float(np.sqrt((padded @ padded) ** 2 + (wide @ wide) ** 2 - 2.0 * (padded @ wide) ** 2)))
        narrow = wide
    return sigmas


def _reliable_colour(green: FloatArray) -> Flags:
    """Where the pixel and those beside it are all saturated in green, or none is."""
    from scipy.ndimage import maximum_filter, minimum_filter

    saturated = green >= SATURATED
    some, all_of_them = (of(saturated, LOST_PX, mode="mirror") for of in (maximum_filter, minimum_filter))
    return np.asarray(all_of_them | ~some)


def _mean_of(plane: FloatArray, reliable: Flags) -> FloatArray:
    """Mean of the reliable pixels in the square around each; 0 where there are none."""
    from scipy.ndimage import uniform_filter

    share = uniform_filter(reliable.astype(np.float32), AROUND_PX, mode="mirror")
    total = uniform_filter(np.where(reliable, plane, np.float32(0.0)), AROUND_PX, mode="mirror")
    return np.where(share > 0.5 / AROUND_PX**2, total / np.maximum(share, np.float32(1e-6)), np.float32(0.0))


def _median_of_three(plane: FloatArray, reach: int) -> None:
    """Each row becomes the median of itself and the rows `reach` before and behind; those at the rims stay."""
    if len(plane) <= 2 * reach:
        return
    before, here, behind = plane[: -2 * reach], plane[reach:-reach], plane[2 * reach :]
    high, low = np.maximum(before, here), np.minimum(before, here)
    np.minimum(high, behind, out=high)
    np.maximum(high, low, out=here)


def _dilated(level: int) -> np.ndarray:
    """The B-spline with 2^level - 1 zeros between its numbers."""
    kernel = np.zeros(4 * 2**level + 1)
    kernel[:: 2**level] = SPLINE
    return kernel


def _smoothed(plane: FloatArray, level: int) -> FloatArray:
    from scipy.ndimage import convolve1d

    for axis in (0, 1):
        plane = convolve1d(plane, _dilated(level), axis=axis, mode="mirror")
    return plane


def _variance(level: FloatArray, shot: float, dark: float) -> FloatArray:
    """Variance of the noise at a level: shot * level + dark, at least dark."""
    variance = np.maximum(level, np.float32(0.0))
    variance *= np.float32(shot)
    variance += np.float32(dark)
    return variance


def _noise_profile(image: Image) -> tuple[float, float]:
    """S and O: variance = S x + O on the scale from black 0 to saturation 1."""
    if len(image.channels) != 1:
        raise ImageError(f"a mosaic has one channel; this image has {', '.join(image.channels)}")
    if "noise_profile" not in image.provenance:
        raise ImageError(
            "the image does not say its noise_profile; sensor.adc notes it. Put sensor.adc before this node, or add it "
            "to the image's provenance"
        )
    shot, dark = image.provenance["noise_profile"]
    return float(shot), float(dark)

"""Ops of the image signal processor: from DN to a picture for a screen.

In the order of the SynFog paper: black level, white balance, demosaic, colour
correction, gamma; a tone curve may stand before the gamma.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np

from synfog_usd.camera import response
from synfog_usd.camera.optics import falloff_map
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS
from synfog_usd.errors import ImageError
from synfog_usd.graph import Auto, FromProfile, Port, Range
from synfog_usd.graph.buffers import checked, pixels_of, to_buf
from synfog_usd.image import FloatArray, Image, Quantity

NUMBERS = Port(Quantity.DN, "mosaic")
MOSAIC = Port(Quantity.LINEAR_RGB, "mosaic")
LINEAR = Port(Quantity.LINEAR_RGB, "rgb")
DISPLAY = Port(Quantity.DISPLAY_RGB, "rgb")


@OPS.op("isp.black_level", takes=NUMBERS, gives=MOSAIC)
def black_level(
    image: Image,
    *,
    black_level_dn: Annotated[float, Range(0.0, 65535.0), FromProfile("sensor.black_level_dn")],
    white_level_dn: Annotated[float, Range(1.0, 65535.0), FromProfile("sensor.white_level_dn")],
) -> Image:
    """DN to a scale on which black is 0 and saturation is 1; noise below 0 is kept.

    Args:
        image: DN mosaic.
        black_level_dn, white_level_dn: what becomes 0 and 1 [DN].

    Raises:
        ImageError: more than one channel, or black not below white.
    """
    _mosaic(image)
    if not black_level_dn < white_level_dn:
        raise ImageError(f"black_level_dn {black_level_dn:g} is not below white_level_dn {white_level_dn:g}")
    scale = np.float32(1.0 / (white_level_dn - black_level_dn))
    return image.with_pixels((image.pixels - np.float32(black_level_dn)) * scale, quantity=Quantity.LINEAR_RGB)


@OPS.op("isp.lens_shading", takes=MOSAIC, gives=MOSAIC)
def lens_shading(
    image: Image,
    *,
    strength: Annotated[float, Range(0.0, 1.0)] = 1.0,
    fov_x_deg: Annotated[float, Range(0.0, 179.0, above=True), Auto()],
    shift_x: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
    shift_y: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
) -> Image:
    """Brightens the corners that the lens left dark, and their noise with them.

    Divides by (the falloff that `optics.irradiance` applied) ^ strength.

    Args:
        image: mosaic, black 0 and saturation 1; its provenance names the falloff.
        strength: 1 takes all of it away.
        fov_x_deg, shift_x, shift_y: see `optics.irradiance`.

    Raises:
        ImageError: the provenance names no falloff.
    """
    _mosaic(image)
    if "falloff" not in image.provenance:
        raise ImageError("the image does not say its falloff; optics.irradiance notes it")
    fade = falloff_map(
        image.height_px, image.width_px, kind=image.provenance["falloff"], f_number=image.provenance["f_number"], fov_x_deg=fov_x_deg, shift=(shift_x, shift_y)
    )
    return image.with_pixels(image.pixels / fade[..., None] ** np.float32(strength)).noted(lens_shading=strength)


@OPS.op("isp.white_balance", takes=MOSAIC, gives=MOSAIC)
def white_balance(
    image: Image,
    *,
    illuminant: Literal["d65", "a", "grey_world", "none"] = "d65",
    clip: bool = True,
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
) -> Image:
    """Gains of R, G, B that make white neutral, the smallest being 1.

    Args:
        image: mosaic, black 0 and saturation 1.
        illuminant: the light whose white becomes neutral.  A known one by default:
            grey_world takes the airlight's tint for a tint of the light.
        clip: cut at 1 afterwards, so that saturated pixels are white, not tinted.
        sensor: its neutral is used.

    Raises:
        ImageError: grey_world on a picture with a channel that is black.
    """
    _mosaic(image)
    if illuminant == "none":
        signal = np.ones(3)
    elif illuminant == "grey_world":
        sums, counts = np.zeros(3), np.zeros(3)
        for row, column, channel in _sites():
            site = image.pixels[row::2, column::2, 0]
            sums[channel] += site.sum(dtype=np.float64)
            counts[channel] += site.size
        signal = sums / np.maximum(counts, 1.0)
        if not (signal > 0.0).all():
            raise ImageError(f"grey_world cannot balance mean signals of {signal.tolist()}; set illuminant: d65")
    else:
        signal = np.array(response.neutral(sensor, illuminant.upper()))
    gains = signal.max() / signal
    pixels = image.pixels.copy()
    for row, column, channel in _sites():
        pixels[row::2, column::2] *= np.float32(gains[channel])
    if clip:
        np.minimum(pixels, 1.0, out=pixels)
    return image.with_pixels(pixels).noted(white_balance=illuminant, wb_gains=[float(value) for value in gains])


@OPS.op("isp.demosaic", takes=MOSAIC, gives=LINEAR)
def demosaic(image: Image, *, algorithm: Literal["linear", "mhc"] = "linear") -> Image:
    """The two missing colours of each pixel from its neighbours, by OpenImageIO.

    Args:
        image: white-balanced mosaic, R G over G B, at least 2 x 2.
        algorithm: linear is the best of the two in noise and fog; mhc (Malvar, He and
            Cutler 2004) is sharper in clear, clean pictures.

    Raises:
        ImageError: OpenImageIO failed, or the picture is smaller than 2 x 2.
    """
    import OpenImageIO

    _mosaic(image)
    if image.height_px < 2 or image.width_px < 2:
        raise ImageError(f"{image.width_px} x {image.height_px} pixels hold no full mosaic; the least is 2 x 2")
    algorithm_name = {"linear": "linear", "mhc": "MHC"}[algorithm]
    buf = OpenImageIO.ImageBufAlgo.demosaic(to_buf(image), pattern="bayer", algorithm=algorithm_name, layout="RGGB")
    return image.with_pixels(pixels_of(checked(buf, "demosaic")), channels=("R", "G", "B"))


@OPS.op("isp.colour_correct", takes=LINEAR, gives=LINEAR)
def colour_correct(
    image: Image,
    *,
    illuminant: Literal["d65", "a"] = "d65",
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
) -> Image:
    """Camera colours to linear Rec.709 by the 3x3 fitted for one light; white stays.

    Args:
        image: white-balanced camera colours (H, W, 3).
        illuminant: the light of the fit.
        sensor: whose colours.

    The error of the fit over a ColorChecker goes into the provenance (CIEDE2000).
    """
    matrix = response.colour_matrix(sensor, illuminant.upper())
    pixels = image.pixels @ np.array(matrix.rows, dtype=np.float32).T
    return image.with_pixels(pixels).noted(
        colour_matrix=[list(row) for row in matrix.rows], colour_matrix_mean_de00=matrix.mean_de00, colour_matrix_max_de00=matrix.max_de00
    )


@OPS.op("isp.tone", takes=LINEAR, gives=LINEAR)
def tone(
    image: Image,
    *,
    brighten_ev: Annotated[float, Range(0.0, 4.0)] = 1.0,
    shoulder: Annotated[float, Range(0.0, 0.95)] = 0.4,
) -> Image:
    """Brighter middle, highlights rolled off: f(0) = 0, f(1) = 1, straight below the shoulder.

    y = 2^ev x up to y = shoulder; above it y = s + (1 - s)(1 - (1 - u)^p), which
    meets the straight part with the same slope and reaches 1 flat.

    Args:
        image: linear Rec.709; what is above 1 becomes 1.
        brighten_ev: slope of the straight part [EV].
        shoulder: s [1].
    """
    gain = 2.0**brighten_ev
    power = (gain - shoulder) / (1.0 - shoulder)
    pixels = image.pixels * np.float32(gain)
    over = pixels > shoulder
    u = np.minimum((pixels[over] - np.float32(shoulder)) / np.float32(gain - shoulder), 1.0)
    pixels[over] = np.float32(shoulder) + np.float32(1.0 - shoulder) * (1.0 - (1.0 - u) ** np.float32(power))
    return image.with_pixels(pixels)


@OPS.op("isp.gamma", takes=LINEAR, gives=DISPLAY)
def gamma(image: Image) -> Image:
    """Linear Rec.709 to sRGB, cut to 0 to 1.

    Source: IEC 61966-2-1.
    """
    return image.with_pixels(encoded_srgb(image.pixels), quantity=Quantity.DISPLAY_RGB)


def encoded_srgb(linear: FloatArray) -> FloatArray:
    """sRGB of linear values of any shape, cut to 0 to 1, float32.

    In numpy: OpenImageIO's conversion is four times slower, depends on the
    environment variable OCIO, and is off by 1e-5.

    >>> [round(float(value), 4) for value in encoded_srgb(np.array([0.0, 0.18, 1.0, 7.0], dtype=np.float32))]
    [0.0, 0.4614, 1.0, 1.0]
    """
    clipped = np.clip(linear, 0.0, 1.0)
    encoded = np.power(clipped, np.float32(1.0 / 2.4))
    encoded *= np.float32(1.055)
    encoded -= np.float32(0.055)
    np.copyto(encoded, clipped * np.float32(12.92), where=clipped <= 0.0031308)
    return encoded


def _sites() -> tuple[tuple[int, int, int], ...]:
    return tuple((row, column, response.BAYER_RGGB[row][column]) for row in (0, 1) for column in (0, 1))


def _mosaic(image: Image) -> None:
    if len(image.channels) != 1:
        raise ImageError(f"a mosaic has one channel; this image has {', '.join(image.channels)}")

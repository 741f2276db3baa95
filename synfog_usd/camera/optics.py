"""Ops between the scene and the sensor: from radiance to irradiance on the pixels.

Radiance is R, G, B in cd m-2 or bands in W m-2 sr-1 nm-1; irradiance keeps the
channels, in lux or W m-2 nm-1.
"""

from __future__ import annotations

import functools
import math
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from scipy import fft

from synfog_usd.camera import response
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS
from synfog_usd.errors import ImageError
from synfog_usd.graph import Auto, FromProfile, Range
from synfog_usd.image import FloatArray, Image, Quantity

THREADS = 2
"""FFTs of one picture gain little from more."""

EDGE_PX = 64
"""How far a picture is mirrored beyond its edges before it is blurred; 0.3 % of a point's light goes further at q = 1."""

HIGHLIGHT = 8.0
"""Times the 95th percentile of a channel: from there on a pixel holds a point of light."""

DISC_PX = 32
"""Half the side of the square in which the diffraction disc is integrated exactly."""


@OPS.op("light.mix", takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)
def mix(*images: Image, weights: Annotated[tuple[float, ...], Range(0.0)]) -> Image:
    """Sum of pictures of the same view under several lights, each dimmed or brightened.

    Light is additive: L = sum of w_i L_i.

    Args:
        images: radiance of one size and with the same channels.
        weights: one per image [1], >= 0.

    Raises:
        ImageError: sizes, channels or counts differ.
    """
    first = images[0]
    if len(weights) != len(images):
        raise ImageError(f"{len(images)} images, but {len(weights)} weights")
    for image in images[1:]:
        if image.pixels.shape != first.pixels.shape or image.channels != first.channels:
            raise ImageError(
                f"an image of shape {image.pixels.shape} with {image.channels} cannot be added to one of {first.pixels.shape} with {first.channels}"
            )
    total = sum(np.float32(weight) * image.pixels for weight, image in zip(weights, images, strict=True))
    return first.with_pixels(np.asarray(total))


@OPS.op("optics.irradiance", takes=Quantity.RADIANCE, gives=Quantity.IRRADIANCE)
def irradiance(
    image: Image,
    *,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    transmission: Annotated[float, Range(0.0, 1.0, above=True), FromProfile("lens.transmission")],
    magnification: Annotated[float, Range(-1.0, 0.0)] = 0.0,
    falloff: Literal["cos4", "foote", "none"] = "cos4",
    fov_x_deg: Annotated[float | None, Range(0.0, 179.0, above=True), Auto()] = None,
    shift_x: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
    shift_y: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
    focal_length_mm: Annotated[float | None, Range(0.0, above=True), FromProfile("lens.focal_length_mm")] = None,
) -> Image:
    """Light that the lens puts on the sensor.

    E = tau * pi * L / (1 + 4 (N (1 + |m|))^2), times cos^4 of the field angle or
    Foote's exact formula for a disc.

    Args:
        image: radiance (H, W, C).
        f_number: N [1].
        transmission: tau [1].
        magnification: m [1], <= 0 (the picture is upside down); 0 for a far scene.
        falloff: how light fades towards the corners.
        fov_x_deg: horizontal angle of view [degrees]; needed unless falloff is none.
        shift_x, shift_y: offset of the axis from the centre, in image widths and
            heights, right and up.
        focal_length_mm: noted for the RAW file; the field of view is `fov_x_deg`.

    Raises:
        ImageError: falloff without an angle of view.

    Source: ISO 12232; Foote, "Illumination from a radiating disk", Scientific
    Papers of the Bureau of Standards 12 (1915).
    """
    cone = 1.0 / (1.0 + 4.0 * (f_number * (1.0 + abs(magnification))) ** 2)
    pixels = image.pixels * np.float32(transmission * math.pi * cone)
    if falloff != "none":
        if fov_x_deg is None:
            raise ImageError("falloff needs the angle of view: give fov_x_deg, or put 'fov_x_deg' into the image's provenance, or set falloff: none")
        fade = falloff_map(
            image.height_px, image.width_px, kind=falloff, f_number=f_number, fov_x_deg=fov_x_deg, shift=(shift_x, shift_y), magnification=magnification
        )
        pixels *= fade[..., None]
    facts = {"f_number": f_number, "falloff": falloff}
    if focal_length_mm is not None:
        facts["focal_length_mm"] = focal_length_mm
    return image.with_pixels(pixels, quantity=Quantity.IRRADIANCE).noted(**facts)


def falloff_map(
    height: int,
    width: int,
    *,
    kind: Literal["cos4", "foote", "none"],
    f_number: float,
    fov_x_deg: float,
    shift: tuple[float, float] = (0.0, 0.0),
    magnification: float = 0.0,
) -> FloatArray:
    """(H, W) light of a pixel relative to one on the axis, 0 to 1; arguments as in `optics.irradiance`."""
    if kind == "none":
        return np.ones((height, width), dtype=np.float32)
    tan2 = _tan2_of_field(height, width, fov_x_deg, *shift)
    if kind == "cos4":
        return np.asarray(1.0 / (1.0 + tan2) ** 2, dtype=np.float32)
    cone = 1.0 / (1.0 + 4.0 * (f_number * (1.0 + abs(magnification))) ** 2)
    return np.asarray(_foote(tan2, cone) / cone, dtype=np.float32)


def _tan2_of_field(height: int, width: int, fov_x_deg: float, shift_x: float, shift_y: float) -> npt.NDArray[np.float64]:
    """(H, W) squared tangent of the angle between each pixel's centre and the optical axis."""
    focal_px = width / 2 / math.tan(math.radians(fov_x_deg) / 2)
    x = (np.arange(width) + 0.5 - width / 2 - shift_x * width) / focal_px
    y = (np.arange(height) + 0.5 - height / 2 + shift_y * height) / focal_px
    return np.asarray(x[None, :] ** 2 + y[:, None] ** 2)


def _foote(tan2_field: npt.NDArray[np.float64], cone: float) -> npt.NDArray[np.float64]:
    """E / (pi L) of a disc that fills `cone` = sin^2 of its half angle, seen off its axis."""
    tan2_cone = cone / (1.0 - cone)
    root = np.sqrt(tan2_field**2 + 2.0 * tan2_field * (1.0 - tan2_cone) + (1.0 + tan2_cone) ** 2)
    return np.asarray(0.5 * (1.0 - (1.0 - tan2_cone + tan2_field) / root))


@OPS.op("optics.diffraction", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def diffraction(
    image: Image,
    *,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
) -> Image:
    """Blur of a perfect round aperture.

    OTF = 2/pi (acos v - v sqrt(1 - v^2)), v = frequency * lambda N / pitch, with
    one mean wavelength per channel.  Pixels are radiance averaged over their own
    area already, so nothing else is multiplied in.

    That OTF ends at the pixels' Nyquist frequency with a step, which would draw a
    cross around a lamp.  What exceeds `HIGHLIGHT` times the frame's 95th
    percentile is therefore taken for points of light, and each is spread as the
    diffraction disc integrated over pixels.

    Args:
        image: irradiance (H, W, C).
        f_number: N [1].
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].
        sensor: weighs the wavelengths.

    Returns:
        Irradiance, >= 0.

    Source: Goodman, "Introduction to Fourier Optics", eq. 6-31.  One wavelength per
    channel costs under 0.05 % of the contrast (3 um, f/2.8 to f/8).
    """
    wavelengths_um = response.mean_wavelengths_nm(sensor, image.channels) * 1e-3
    blurred = np.empty_like(image.pixels)
    for channel, wavelength_um in enumerate(wavelengths_um):
        blurred[..., channel] = _blurred(image.pixels[..., channel], float(wavelength_um * f_number / pixel_pitch_um))
    return image.with_pixels(np.maximum(blurred, 0.0, out=blurred)).noted(mean_wavelengths_nm=[round(float(um) * 1e3, 3) for um in wavelengths_um])


def _blurred(plane: FloatArray, q: float) -> FloatArray:
    """One channel through an aperture with q = lambda N / pitch."""
    pads, sizes = [], []
    for length in plane.shape:
        before = min(EDGE_PX, length)
        size = fft.next_fast_len(length + 2 * before, real=True)
        pads.append((before, size - length - before))
        sizes.append(size)
    padded = np.pad(plane, pads, mode="symmetric")
    limit = np.float32(HIGHLIGHT * np.percentile(plane[::4, ::4], 95.0))
    points = np.maximum(padded - limit, 0.0)
    spectrum = fft.rfft2(np.minimum(padded, limit), workers=THREADS)
    spectrum *= _otf(sizes[0], sizes[1], q)
    result = fft.irfft2(spectrum, s=sizes, workers=THREADS)
    if points.any():
        # double: a float32 transform spreads 1e-7 of a lamp over a dark street
        result += np.maximum(fft.irfft2(fft.rfft2(points.astype(np.float64), workers=THREADS) * _disc(sizes[0], sizes[1], q), s=sizes, workers=THREADS), 0.0)
    (top, _), (left, _) = pads
    return np.asarray(result[top : top + plane.shape[0], left : left + plane.shape[1]], dtype=np.float32)


@functools.lru_cache(maxsize=4)
def _otf(height: int, width: int, q: float) -> FloatArray:
    """(H, W // 2 + 1) transfer on the frequencies of a real transform."""
    return _transfer(q * np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])).astype(np.float32)


@functools.lru_cache(maxsize=4)
def _disc(height: int, width: int, q: float) -> FloatArray:
    """Transfer of the diffraction disc integrated over square pixels: all its weights are >= 0 and sum to 1.

    Its weights are the inverse transform of sum_k OTF(f + k) sinc(f + k) on a small
    grid; beyond `DISC_PX` they follow the disc's mean tail, q / (pi^3 r^3).
    """
    size = 4 * DISC_PX
    f = np.fft.fftfreq(size)
    aliases = range(-math.ceil(1.0 / q + 0.5), math.ceil(1.0 / q + 0.5) + 1)
    folded = np.zeros((size, size))
    for row in aliases:
        for column in aliases:
            y, x = f[:, None] + row, f[None, :] + column
            folded += _transfer(q * np.hypot(y, x)) * np.sinc(y) * np.sinc(x)
    near = np.fft.ifft2(folded).real
    row_px, column_px = np.fft.fftfreq(height) * height, np.fft.fftfreq(width) * width
    radius = np.hypot(row_px[:, None], column_px[None, :])
    weights = q / (math.pi**3 * np.maximum(radius, 1.0) ** 3)
    inner_rows, inner_columns = np.flatnonzero(np.abs(row_px) <= DISC_PX), np.flatnonzero(np.abs(column_px) <= DISC_PX)
    rows, columns = row_px[inner_rows].astype(int), column_px[inner_columns].astype(int)
    weights[np.ix_(inner_rows, inner_columns)] = np.maximum(near[np.ix_(rows, columns)], 0.0)
    return fft.rfft2(weights / weights.sum()).real.astype(np.float32)


def _transfer(v: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """2/pi (acos v - v sqrt(1 - v^2)), 0 from v = 1 on."""
    v = np.minimum(v, 1.0)
    return np.asarray((2.0 / math.pi) * (np.arccos(v) - v * np.sqrt(1.0 - v * v)))


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
    scattered = fft.irfft2(fft.rfft2(padded, axes=(0, 1), workers=THREADS) * transfer, s=padded.shape[:2], axes=(0, 1), workers=THREADS)
    scattered = np.maximum(scattered[reach_y : reach_y + height, reach_x : reach_x + width], 0.0).astype(np.float32)
    up_y, up_x = _interpolation(image.height_px, height, block), _interpolation(image.width_px, width, block)
    pixels = image.pixels * np.float32(1.0 - fraction)
    for channel in range(pixels.shape[2]):
        pixels[..., channel] += np.float32(fraction) * (up_y @ scattered[..., channel] @ up_x.T)
    return image.with_pixels(pixels).noted(glare_fraction=fraction)


def block_means(pixels: FloatArray, block: int) -> FloatArray:
    """(ceil(H / block), ceil(W / block), C) means of square blocks; the last ones are smaller."""
    rows, columns = np.arange(0, pixels.shape[0], block), np.arange(0, pixels.shape[1], block)
    sums = np.add.reduceat(np.add.reduceat(pixels, rows, axis=0, dtype=np.float64), columns, axis=1)
    heights, widths = np.diff(np.append(rows, pixels.shape[0])), np.diff(np.append(columns, pixels.shape[1]))
    return np.asarray(sums / (heights[:, None, None] * widths[None, :, None]), dtype=np.float32)


def _interpolation(fine: int, coarse: int, block: int) -> FloatArray:
    """(fine, coarse) matrix of linear interpolation between the centres of blocks."""
    place = np.clip((np.arange(fine) + 0.5) / block - 0.5, 0.0, coarse - 1.0)
    low = np.minimum(place.astype(int), max(coarse - 2, 0))
    part = (place - low).astype(np.float32)
    matrix = np.zeros((fine, coarse), dtype=np.float32)
    matrix[np.arange(fine), low] = 1.0 - part
    matrix[np.arange(fine), np.minimum(low + 1, coarse - 1)] += part
    return matrix

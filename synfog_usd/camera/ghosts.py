"""Ghosts of lamps: light that two faces of a lens reflect reaches the sensor out of focus.

Irradiance in, irradiance out; the sum of the light stays, but for what leaves the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from synfog_usd.base.arrays import Array, FloatArray
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import spread
from synfog_usd.camera.flare import aperture, enlarged
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.paraxial import Drawing, Ghost
from synfog_usd.camera.pinhole import Pinhole
from synfog_usd.camera.profiles import LensProfile
from synfog_usd.camera.registry import OPS

COATED = 0.0045
"""Share of the light that a face with a coating of several layers reflects: an estimate, 0.2 to 0.5 % are usual."""

BLOCKS = 480
"""Blocks across the picture on which ghosts are drawn: they have no detail but their edge."""


@OPS.op("optics.ghosts", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def ghosts(
    image: Image,
    *,
    lens: Annotated[LensProfile | None, FromProfile("lens")] = None,
    face_reflectance: Annotated[float, Range(0.0, 0.5)] = COATED,
    most: Annotated[int, Range(1, 64)] = 12,
    blades: Annotated[int, Range(0, 32), FromProfile("lens.blades")] = 0,
    rotation_deg: Annotated[float, Range(-360.0, 360.0)] = 0.0,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
) -> Image:
    """Ghosts of lamps, from the lens's drawing: each pair of faces makes a defocused image of the aperture.

    Rays near the axis say where each stands, how large it is and how much light it has; the brightest are drawn.
    Its colour is that of the lamp, since a coating's colours are not known.  A lamp is what exceeds 8 times the 95th
    percentile of the channel.

    Args:
        image: irradiance (H, W, C).
        lens: whose drawing; one without makes no ghosts.
        face_reflectance: of each face between glass and air [1]; by default an estimate for a coating of several
            layers.  Cemented faces reflect what Fresnel says.
        most: how many ghosts are drawn.
        blades: of the aperture; 0 for a round one.
        rotation_deg: of the aperture, anticlockwise [degrees].
        f_number: N [1].
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].

    Raises:
        ImageError: one or two blades.

    Source: Lee and Eisemann, "Practical Real-Time Lens-Flare Rendering", EGSR 2013.
    """
    if blades in (1, 2):
        raise ImageError(f"{blades} blades; it is 0 (round) or from 3 on")
    if lens is None or not lens.radius_mm:
        return image
    drawing = Drawing(lens.radius_mm, lens.thickness_mm, lens.index, lens.clear_mm)
    brightest = drawing.ghosts(f_number, face_reflectance)[:most]
    pixels = image.pixels.copy()
    column, row = Pinhole.of(image, 0.0).axis_px
    for channel in range(pixels.shape[2]):
        plane = image.pixels[..., channel]
        lamps = np.maximum(plane - spread.highlight_limit(plane), 0.0)
        if lamps.any():
            _draw(pixels[..., channel], lamps, brightest, (row, column), 1e3 / pixel_pitch_um, blades, rotation_deg)
            pixels[..., channel] -= np.float32(sum(ghost.fraction for ghost in brightest)) * lamps
    return image.with_pixels(np.maximum(pixels, 0.0, out=pixels)).with_metadata(
        ghost_fractions=[float(f"{ghost.fraction:.3g}") for ghost in brightest]
    )


def _draw(
    plane: FloatArray,
    lamps: FloatArray,
    brightest: Sequence[Ghost],
    axis: tuple[float, float],
    pixels_per_mm: float,
    blades: int,
    rotation_deg: float,
) -> None:
    """Add the light of the ghosts to a channel (H, W), on blocks; `axis` is (row, column)."""
    height, width = lamps.shape
    block = max(1, round(width / BLOCKS))
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
    for ghost in brightest:
        at = [
            ((index * block + (block - 1) / 2 - middle) * ghost.place + middle - (block - 1) / 2) / block
            for index, middle in zip((rows, columns), axis, strict=True)
        ]
        turned = rotation_deg + (180.0 if ghost.diameter_mm < 0.0 else 0.0)
        total += ghost.fraction * _discs(
            light.shape, at, amounts, abs(ghost.diameter_mm) * pixels_per_mm / block, blades, turned
        )
    for strip, strip_of_total in enlarged(total.astype(np.float32), block, height, width):
        plane[strip] += strip_of_total


def _discs(
    shape: tuple[int, ...],
    at: Sequence[Array],
    amounts: Array,
    diameter: float,
    blades: int,
    rotation_deg: float,
) -> Array:
    """Light of `amounts` in images of the aperture about places (row, column), all in blocks."""
    from scipy import fft

    diameter = max(1.0, diameter)
    edge = math.ceil(diameter) + 2
    spots = np.zeros(tuple(fft.next_fast_len(length + 2 * edge, real=True) for length in shape))
    row, column = (place + edge for place in at)
    low_row, low_column = np.floor(row).astype(int), np.floor(column).astype(int)
    for next_row in (0, 1):
        for next_column in (0, 1):
            to_row, to_column = low_row + next_row, low_column + next_column
            share = np.abs(1 - next_row - (row - low_row)) * np.abs(1 - next_column - (column - low_column))
            inside = (to_row >= 0) & (to_row < spots.shape[0]) & (to_column >= 0) & (to_column < spots.shape[1])
            np.add.at(spots, (to_row[inside], to_column[inside]), (amounts * share)[inside])
    size = 2 * edge + 1
    disc = np.zeros(spots.shape)
    disc[:size, :size] = aperture(blades, rotation_deg, diameter, size)
    disc = np.roll(disc / disc.sum(), (-edge, -edge), axis=(0, 1))
    convolved = fft.irfft2(fft.rfft2(spots) * fft.rfft2(disc), s=spots.shape)
    return np.maximum(convolved[edge : edge + shape[0], edge : edge + shape[1]], 0.0)

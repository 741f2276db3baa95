"""Op for a lens that is not the same everywhere in its picture, nor for every colour.

Irradiance in, irradiance out.  What a lens's design or measurement says of its spots by the angle to the axis becomes
a blur of its own for each part of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from synfog_usd.base import photometry
from synfog_usd.base.arrays import Array, FloatArray, Pixels
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.blur import spectral_weights
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.optics import field_angles_rad
from synfog_usd.camera.pinhole import Pinhole
from synfog_usd.camera.profiles import LensProfile, SensorProfile
from synfog_usd.camera.registry import FOV, OPS
from synfog_usd.camera.spread import THREADS, highlight_limit

TILES, LEAST_TILE_PX, MOST_TILE_PX = 16, 16, 128
"""Places along the longer side whose spots are computed, and their distance; the four nearest are mixed between."""

WIDEST_PX = 64.0
"""Largest standard deviation, and largest shift."""

COLOURS_NM = (450.0, 550.0, 650.0)

COLUMNS = ("tangential_um", "sagittal_um", "axial_450_um", "axial_650_um", "lateral_450_um", "lateral_650_um")
"""Of a lens's table: standard deviations along the radius and across it at 550 nm, what comes to them at two other
wavelengths, and how much further from the axis these go.
"""


@OPS.op("optics.aberrations", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def aberrations(
    image: Image,
    *,
    lens: Annotated[LensProfile | None, FromProfile("lens")] = None,
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
    fov_x_deg: Annotated[float | None, Range(0.0, 179.0, above=True), FOV] = None,
) -> Image:
    """Spots that change over the field and with the wavelength: soft corners and coloured edges.

    A point becomes a Gaussian spot whose standard deviations along the radius and across it stand in the lens's table
    by the angle to the axis.  At 450 and 650 nm it is wider, by the root of the sum of squares (axial colour), and
    further from the axis than at 550 nm (lateral colour).  A channel takes what lies between them at its mean
    wavelength.

    Contrast falls as the Gaussian's, exp(-2 (pi s f)^2), shifted by weights of two pixels whose variance is taken off.
    What exceeds 8 times the channel's 95th percentile gets Lindeberg's discrete Gaussian, of the same variances and
    never below 0, so that no lamp has dark rings.

    Spots are computed at sixteen places along the longer side, and every 128 pixels at least; what lies between is a
    mixture of the four nearest.

    Args:
        image: irradiance (H, W, C), as it lies on the sensor.
        lens: whose table; one without leaves the picture as it is.
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].
        sensor: weighs the wavelengths.
        fov_x_deg: see `optics.irradiance`.

    Raises:
        ImageError: spots wider than 64 pixels, no angle of view.

    Source: Lindeberg, "Scale-space for discrete signals", IEEE PAMI 12 (1990).
    """
    if lens is None or not lens.aberration_field_deg:
        return image
    field_deg = np.asarray(lens.aberration_field_deg)
    table = np.array([getattr(lens, name) for name in COLUMNS]) / pixel_pitch_um
    if np.abs(table).max() > WIDEST_PX:
        raise ImageError(f"an aberration of {np.abs(table).max():.0f} pixels; {WIDEST_PX:.0f} are the most")
    field = Field.of(image, fov_x_deg)
    nm = np.clip(spectral_weights(sensor, image.channels) @ photometry.WAVELENGTHS_NM, *COLOURS_NM[::2])
    result = np.empty_like(image.pixels)

    def run(channel: int) -> None:
        spots = _Spots(field_deg, _at(table, float(nm[channel])), field)
        result[..., channel] = spread_by_place(image.pixels[..., channel], spots.reach_px, spots.transfers)

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(run, range(len(image.channels))))
    return image.with_pixels(result).with_metadata(aberrations_px=[float(f"{part:.4g}") for part in table.max(axis=1)])


@dataclass(frozen=True)
class Field:
    """Where the places of a picture lie to the lens's axis.

    Attributes:
        angles: (H, W) of the picture's pixels [degrees].
        axis: column and row of the axis [px].
    """

    angles: Array
    axis: tuple[float, float]

    @classmethod
    def of(cls, image: Image, fov_x_deg: float | None) -> Field:
        """Of an image; see `field_angles_rad`."""
        return cls(np.degrees(field_angles_rad(image, fov_x_deg)), Pinhole.of(image, 0.0).axis_px)

    def at(self, row: float, column: float) -> tuple[float, float, float]:
        """Angle to the axis at a place [degrees], that of the nearest pixel; and columns and rows, as a unit vector,
        of the way that leads away from the axis.
        """
        x, y = column - self.axis[0], row - self.axis[1]
        if (radius := math.hypot(x, y)) < 0.5:
            return 0.0, 1.0, 0.0
        height, width = self.angles.shape
        place = min(max(round(row), 0), height - 1), min(max(round(column), 0), width - 1)
        return float(self.angles[place]), x / radius, y / radius


def _at(table: Array, nm: float) -> Array:
    """(3, F) variances along the radius and across it, and shift, at a wavelength [px^2, px]."""
    along, across, short, long, lower, upper = table

    def between(low: Array, high: Array) -> Array:
        part = (nm - COLOURS_NM[1]) / (COLOURS_NM[1] - COLOURS_NM[0])
        return -part * low if part < 0.0 else part * high

    wider = between(short**2, long**2)
    return np.stack([along**2 + wider, across**2 + wider, between(lower, upper)])


@dataclass(frozen=True)
class _Spots:
    """What a point becomes, by its place.

    Attributes:
        field_deg: (F,) of the columns of `table`.
        table: (3, F), see `_at`.
        field: of the picture.
    """

    field_deg: Array
    table: Array
    field: Field

    @property
    def reach_px(self) -> int:
        """Pixels from which on a spot has less than 1e-6 of its light."""
        return math.ceil(6.0 * math.sqrt(float(self.table[:2].max())) + float(np.abs(self.table[2]).max())) + 4

    def transfers(self, size: int) -> Callable[[float, float, bool], Array]:
        """See `spread_by_place`."""
        waves, steps = _Waves.of(size), _Waves.of(size, discrete=True)
        return lambda row, column, lamps: (steps if lamps else waves).transfer(*self.at(row, column))

    def at(self, row: float, column: float) -> tuple[float, float, float, float, float]:
        """Variances across columns and rows and their covariance [px^2], and shift to the right and down [px]."""
        angle, c, s = self.field.at(row, column)
        along, across, out = (float(np.interp(angle, self.field_deg, values)) for values in self.table)
        return (
            along * c * c + across * s * s,
            along * s * s + across * c * c,
            (along - across) * c * s,
            out * c,
            out * s,
        )


def spread_by_place(
    plane: FloatArray, reach: int, transfers: Callable[[int], Callable[[float, float, bool], Array]]
) -> FloatArray:
    """A channel (H, W) through the spots of its places, tile by tile, with weights that fall to 0 at the next.

    Args:
        plane: light, >= 0.
        reach: pixels from which on a spot has no light.
        transfers: side of a square -> what gives the real transform of a spot by its row and column in the picture;
            of a lamp's spot where its third argument is true.
    """
    from scipy import fft

    height, width = plane.shape
    step = min(max(math.ceil(max(height, width) / TILES), LEAST_TILE_PX), MOST_TILE_PX)
    step = max(step, reach // 2)  # spots as wide as the tiles would make them many
    edge = step + reach  # beyond the picture, where the first and the last weights are not whole
    even = np.minimum(plane, highlight_limit(plane))
    padded, lamps = (np.pad(part.astype(np.float64), edge, mode="symmetric") for part in (even, plane - even))
    size = fft.next_fast_len(2 * step + 2 * reach, real=True)
    weight = 1.0 - np.abs((np.arange(2 * step) + 0.5) / step - 1.0)
    transfer = transfers(size)
    tops, lefts = (range(0, length + 2 * reach + step, step) for length in (height, width))
    total = np.zeros((tops[-1] + size, lefts[-1] + size))  # begins `reach` before the padded picture
    for top in tops:
        for column_px in lefts:
            here = slice(top, top + 2 * step), slice(column_px, column_px + 2 * step)
            tile = padded[here]
            share = weight[: tile.shape[0], None] * weight[None, : tile.shape[1]]
            place = top - edge + step - 0.5, column_px - edge + step - 0.5
            spectrum = fft.rfft2(tile * share, s=(size, size))
            spectrum *= transfer(*place, False)
            if lamps[here].any():
                spectrum += fft.rfft2(lamps[here] * share, s=(size, size)) * transfer(*place, True)
            convolved = fft.irfft2(spectrum, s=(size, size))
            total[top : top + size, column_px : column_px + size] += np.roll(convolved, (reach, reach), axis=(0, 1))
    inner = total[edge + reach :, edge + reach :][:height, :width]
    return np.maximum(inner, 0.0).astype(np.float32)


@dataclass(frozen=True)
class _Waves:
    """What a variance of 1 makes of the logarithm of contrast, by frequency across columns, down rows and along both
    diagonals, and the frequencies [rad/px].
    """

    x: Array
    y: Array
    falling: Array
    rising: Array
    fx: Pixels
    fy: Pixels

    @classmethod
    def of(cls, size: int, *, discrete: bool = False) -> _Waves:
        """Of a real transform of size x size: a Gaussian's, or Lindeberg's discrete one's."""
        fx, fy = 2.0 * np.pi * np.fft.rfftfreq(size)[None, :], 2.0 * np.pi * np.fft.fftfreq(size)[:, None]
        x, y, falling, rising = (
            np.cos(wave) - 1.0 if discrete else -0.5 * wave * wave for wave in (fx, fy, fx + fy, fx - fy)
        )
        return cls(x, y, falling, rising, fx, fy)

    def transfer(self, xx: float, yy: float, xy: float, right: float, down: float) -> Array:
        """Of a Gaussian with these variances [px^2], shifted [px].

        What both axes share goes along a diagonal, and a shift between two pixels takes its own variance off.
        """
        shift: Any = 1.0 + 0.0j
        factors = []
        for way, frequency in ((right, self.fx), (down, self.fy)):
            whole = math.floor(way)
            part = way - whole
            factors.append(part * (1.0 - part))
            shift = shift * np.exp(-1j * frequency * whole) * (1.0 - part + part * np.exp(-1j * frequency))
        diagonal = self.falling if xy > 0.0 else self.rising
        width = max(xx - abs(xy) - factors[0], 0.0), max(yy - abs(xy) - factors[1], 0.0)
        return np.asarray(np.exp(width[0] * self.x + width[1] * self.y + abs(xy) * diagonal) * shift)

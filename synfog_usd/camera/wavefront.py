"""Op for a lens whose errors are known as a wavefront: Zernike coefficients by the angle to the axis.

Irradiance in, irradiance out.  Each place of the picture gets the spot that its pupil makes, diffraction with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from synfog_usd.base import photometry
from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.aberrations import Field, Numbers, filled, spread_by_place, table_fault
from synfog_usd.camera.blur import spectral_weights
from synfog_usd.camera.graph import Auto, FromProfile, Range
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import FOV, OPS
from synfog_usd.camera.spread import THREADS

LEAST_PX, MOST_PX = 64, 256
"""Side of the square in which a spot is computed; what lies outside is folded into it."""

MOST_SAMPLES = 2048
"""The same in samples of a spot: 33 MB."""

Nanometres = Range(-1e5, 1e5)


def wavefront_fault(
    field_deg: Numbers, z4_nm: Numbers, z6_nm: Numbers, z8_nm: Numbers, z10_nm: Numbers, z11_nm: Numbers
) -> str:
    """What is wrong with a lens's table, or ''."""
    fault = table_fault(field_deg, z4_nm, z6_nm, z8_nm, z10_nm, z11_nm)
    if fault or not field_deg or not any(column and column[0] for column in (z6_nm, z8_nm, z10_nm)):
        return fault
    return "z6_nm, z8_nm and z10_nm begin with 0: on the axis no direction is the one away from it"


@OPS.op("optics.wavefront", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE, fault=wavefront_fault)
def wavefront(
    image: Image,
    *,
    field_deg: Annotated[Numbers, Range(0.0, 180.0), FromProfile("lens.wavefront_field_deg")] = None,
    z4_nm: Annotated[Numbers, Nanometres, FromProfile("lens.z4_nm")] = None,
    z6_nm: Annotated[Numbers, Nanometres, FromProfile("lens.z6_nm")] = None,
    z8_nm: Annotated[Numbers, Nanometres, FromProfile("lens.z8_nm")] = None,
    z10_nm: Annotated[Numbers, Nanometres, FromProfile("lens.z10_nm")] = None,
    z11_nm: Annotated[Numbers, Nanometres, FromProfile("lens.z11_nm")] = None,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
    fov_x_deg: Annotated[float | None, Range(0.0, 179.0, above=True), FOV] = None,
    shift_x: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
    shift_y: Annotated[float, Range(-10.0, 10.0), Auto()] = 0.0,
) -> Image:
    """Spots of a measured or designed wavefront: diffraction, coma's tail and all, by the angle to the axis.

    W = z4 Z4 + z6 Z6 + z8 Z8 + z10 Z10 + z11 Z11 in Noll's numbers: focus, astigmatism, coma, trefoil and spherical
    aberration, which are those of a lens that is alike all round its axis.  The pupil's angle is counted from the
    direction away from the axis; with z8 > 0 the tail of coma points there.  The spot is the square of the Fourier
    transform of exp(2 pi i W / lambda) over a round pupil, at the mean wavelength of each channel: the path is the
    same at all wavelengths, so colour that a lens focuses elsewhere is the business of `optics.aberrations`.

    It takes the place of `optics.diffraction`.  Coefficients lie on straight lines between the angles; spots are
    computed at sixteen places along the longer side, and every 128 pixels at least, and mixed between.  Lamps (8 times
    the channel's 95th percentile) get the spot as pixels gather it, which is nowhere below 0.  A spot is computed in 64
    pixels, or in four times its geometric radius.  A lens without a table leaves the picture as it is.

    Args:
        image: irradiance (H, W, C), as it lies on the sensor.
        field_deg: angles to the axis [degrees], rising from 0; beyond the last the last holds.
        z4_nm, z6_nm, z8_nm, z10_nm, z11_nm: standard deviations of the path over the pupil [nm]; 0 if left out.
        f_number: N [1].
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].
        sensor: weighs the wavelengths.
        fov_x_deg, shift_x, shift_y: see `optics.irradiance`.

    Raises:
        ImageError: lists of unlike length, angles that do not rise from 0, z6, z8 or z10 on the axis, spots wider than
            128 pixels, pixels so large that the waves in them are too many, no angle of view, diffraction before it.

    Source: Noll, "Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66 (1976); Goodman, "Introduction
    to Fourier Optics", section 6.4.
    """
    if not field_deg:
        return image
    if image.provenance.get("diffraction_mode", "none") != "none":
        raise ImageError(
            "optics.diffraction has blurred the picture, and spots of a wavefront have it in them; leave it out"
        )
    columns = (z4_nm, z6_nm, z8_nm, z10_nm, z11_nm)
    if fault := wavefront_fault(field_deg, *columns):
        raise ImageError(fault)
    table = filled(field_deg, columns)
    slopes = np.abs(table).T @ np.abs(_derivatives()).max(axis=1)
    radius_px = 2e-3 * f_number * float(slopes.max()) / pixel_pitch_um
    window = max(LEAST_PX, 16 * math.ceil(radius_px / 4.0))
    if window > MOST_PX:
        raise ImageError(f"a spot of {2.0 * radius_px:.0f} pixels; {MOST_PX // 2} are the most")
    nm = spectral_weights(sensor, image.channels) @ photometry.WAVELENGTHS_NM
    pupils = [Pupil(float(wavelength), f_number, pixel_pitch_um, window) for wavelength in nm]
    if (samples := window * max(pupil.finer for pupil in pupils)) > MOST_SAMPLES:
        raise ImageError(
            f"spots of {window} pixels, as fine as light of {nm.min():.0f} nm through f/{f_number:g} makes them, take "
            f"{samples} samples each way; {MOST_SAMPLES} are the most: the pixels are too large for waves"
        )
    field = Field.of(image, fov_x_deg, (shift_x, shift_y))
    result = np.empty_like(image.pixels)

    def run(channel: int) -> None:
        def transfers(size: int) -> Callable[[float, float, bool], Array]:
            def at(row: float, column: float, lamps: bool) -> Array:
                angle, c, s = field.at(row, column)
                coefficients = np.array([np.interp(angle, field_deg, values) for values in table])
                return _padded(pupils[channel].weights(coefficients, math.atan2(s, c), pixels=lamps), size)

            return at

        result[..., channel] = spread_by_place(image.pixels[..., channel], window // 2, transfers)

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(run, range(len(image.channels))))
    return image.with_pixels(result).with_metadata(
        wavefront_nm=[float(f"{part:.4g}") for part in np.sqrt(np.square(table).sum(axis=0))]
    )


def _zernike(x: Array, y: Array) -> Array:
    """(5, ...) Noll's Z4, Z6, Z8, Z10 and Z11 at places of the unit disc, x along the direction they count from."""
    r2 = x * x + y * y
    return np.stack(
        [
            math.sqrt(3.0) * (2.0 * r2 - 1.0),
            math.sqrt(6.0) * (x * x - y * y),
            math.sqrt(8.0) * (3.0 * r2 - 2.0) * x,
            math.sqrt(8.0) * (x * x - 3.0 * y * y) * x,
            math.sqrt(5.0) * (6.0 * r2 * r2 - 6.0 * r2 + 1.0),
        ]
    )


def _derivatives() -> Array:
    """(5, K) slopes of the terms along the pupil's radii, and around it at its edge."""
    angle, radius = (part.ravel() for part in np.meshgrid(np.linspace(0.0, np.pi, 19), np.linspace(0.0, 1.0, 21)))
    x, y, step = radius * np.cos(angle), radius * np.sin(angle), 1e-4
    along = [(_zernike(x + dx, y + dy) - _zernike(x, y)) / step for dx, dy in ((step, 0.0), (0.0, step))]
    return np.hypot(*along)


@dataclass(frozen=True)
class Pupil:
    """A round pupil in light of one wavelength, and a square of pixels in which its spots lie.

    Attributes:
        wavelength_nm, f_number, pitch_um: of the light, the pupil and the pixels.
        window: side of the square [px].
    """

    wavelength_nm: float
    f_number: float
    pitch_um: float
    window: int

    @property
    def finer(self) -> int:
        """Samples of a spot to a pixel."""
        return max(1, math.ceil(2e3 * self.pitch_um / (self.wavelength_nm * self.f_number)))

    def transfer(self, coefficients_nm: Array, away_rad: float = 0.0) -> Array:
        """(n, n) complex transfer function, n = window * finer, 1 at [0, 0]; frequencies as `numpy.fft` orders them,
        `window` steps to a cycle per pixel.

        Args:
            coefficients_nm: (5,) of Z4, Z6, Z8, Z10 and Z11.
            away_rad: direction that the pupil's angle is counted from, from the columns' direction to the rows'.
        """
        from scipy import fft

        n = self.window * self.finer
        radius = 0.5 * self.window * 1e3 * self.pitch_um / (self.wavelength_nm * self.f_number)  # in samples
        places = np.arange(-math.floor(radius), math.floor(radius) + 1)
        v, u = places[:, None] / radius, places[None, :] / radius
        c, s = math.cos(away_rad), math.sin(away_rad)
        path = np.tensordot(coefficients_nm, _zernike(c * u + s * v, c * v - s * u), axes=1)
        pupil = np.zeros((n, n), dtype=np.complex64)
        pupil[np.ix_(places, places)] = (u * u + v * v <= 1.0) * np.exp(2j * np.pi / self.wavelength_nm * path)
        spectrum = fft.fft2(np.square(np.abs(fft.fft2(pupil))))
        return np.asarray(spectrum / spectrum[0, 0].real)

    def weights(self, coefficients_nm: Array, away_rad: float, *, pixels: bool) -> Array:
        """(window, window) weights of a point's light, its own pixel at [0, 0]; sum 1.

        Args:
            coefficients_nm, away_rad: see `transfer`.
            pixels: whether the pixels' area is in it, of a point of light; else they are of a picture that pixels have
                averaged already, up to their Nyquist frequency.
        """
        from scipy import fft

        whole = self.transfer(coefficients_nm, away_rad)
        if pixels:
            box = np.sinc(np.fft.fftfreq(len(whole), 1.0 / self.finer))
            spot = fft.ifft2(whole * box[:, None] * box[None, :]).real[:: self.finer, :: self.finer]
            return np.asarray(np.maximum(spot, 0.0) / np.maximum(spot, 0.0).sum())
        middle = np.r_[0 : self.window // 2, -self.window // 2 : 0]
        return np.asarray(fft.ifft2(whole[np.ix_(middle, middle)]).real)


def _padded(weights: Array, size: int) -> Array:
    """Real transform of a spot in a square of `size` pixels."""
    from scipy import fft

    half = len(weights) // 2
    room = np.zeros((size, size))
    room[: 2 * half, : 2 * half] = np.roll(weights, (half, half), axis=(0, 1))
    return np.asarray(fft.rfft2(np.roll(room, (-half, -half), axis=(0, 1))))

"""Ops that spread each point of the picture: diffraction, and focus elsewhere.

Irradiance in, irradiance out; `spread` does the work, and what is not worth doing is
left out here.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from synfog_usd.base import photometry
from synfog_usd.base.arrays import Array, FloatArray, Indices
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import response, spread
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS

DISC_MAX_PX = 2048.0
"""Widest disc of a lens out of focus."""

UNSEEN = 0.001
"""Change, as a part of the mean level or of a contrast, that is not worth computing."""

BROADBAND_ERROR = 0.0005
"""Part of the contrast up to which one wavelength may stand for all channels."""

CROP_PX = 256

BINS = 512.0
"""Frequencies in a cycle per pixel at which a crop is measured."""


@OPS.op("optics.diffraction", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def diffraction(
    image: Image,
    *,
    mode: Literal["auto", "band", "broadband", "none"] = "auto",
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
    sensor: Annotated[SensorProfile, FromProfile("sensor")],
    spot_um: Annotated[float, Range(0.0, 50.0), FromProfile("lens.spot_um")] = 0.0,
) -> Image:
    """Blur of a round aperture, and of the errors of the glass behind it.

    OTF = 2/pi (acos v - v sqrt(1 - v^2)), v = frequency * lambda N / pitch, times
    exp(-2 (pi spot frequency / pitch)^2).  Pixels are radiance averaged over their own
    area already, so nothing else is multiplied in.

    That OTF ends at the pixels' Nyquist frequency with a step, which would draw a
    cross around a lamp.  What exceeds `HIGHLIGHT` times the frame's 95th
    percentile is therefore taken for points of light, and each is spread as the
    diffraction disc integrated over pixels.

    The provenance gets `diffraction_mode`, and `diffraction_error`: the RMS
    difference to a blur by the whole spectrum of the channel, as a part of the mean
    level, in the 256 x 256 pixels around the highest contrast (lamps cut off),
    computed from their spectrum, the worst of the first, middle and last channel.

    Args:
        image: irradiance (H, W, C).
        mode: band takes one mean wavelength for each channel, broadband one for all,
            none leaves the picture as it is.  auto leaves out what does not show
            (RMS contrast * (0.134 * lambda N / pitch + 1.1 * (spot / pitch)^2) < 0.001, no
            point of light, and measured error < 0.001); else it takes broadband for more than three
            channels if its measured error is below 0.0005 of the contrast, else band.
        f_number: N [1].
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].
        sensor: weighs the wavelengths.
        spot_um: standard deviation of the Gaussian spot that a lens without diffraction would
            make, the same all over the picture [um]; 0 for a perfect one.  `optics.aberrations`
            has spots that change over the field.

    Returns:
        Irradiance, >= 0.

    Source: Goodman, "Introduction to Fourier Optics", eq. 6-31.  The rule of auto
    is a fit to blurred 1/f textures with edges, lambda N / pitch <= 1; one wavelength
    per channel costs under 0.05 % of the contrast (3 um, f/2.8 to f/8).
    """
    weights = spectral_weights(sensor, image.channels)
    wavelengths_nm = weights @ photometry.WAVELENGTHS_NM
    per_nm = 1e-3 * f_number / pixel_pitch_um
    spot_px = spot_um / pixel_pitch_um
    limits = spread.highlight_limits(image.pixels)
    measured = _Measured.of(image, limits, weights, per_nm, spot_px)
    chosen = _chosen(image, limits, mode, float(wavelengths_nm.max() * per_nm), spot_px, measured)
    if chosen == "broadband":
        wavelengths_nm = np.full_like(wavelengths_nm, wavelengths_nm.mean())
    metadata = {"diffraction_mode": chosen, "diffraction_error": float(f"{measured.error(chosen):.3g}")}
    if chosen == "none":
        return image.with_metadata(**metadata)
    scale = max(1, math.ceil(float(wavelengths_nm.max()) * per_nm))
    blurs = [spread.aperture(float(wavelength_nm * per_nm), scale, spot_px) for wavelength_nm in wavelengths_nm]
    return image.with_pixels(spread.blurred(image.pixels, blurs, limits)).with_metadata(
        mean_wavelengths_nm=[round(float(nm), 3) for nm in wavelengths_nm], **metadata
    )


@OPS.op("optics.defocus", takes=Quantity.IRRADIANCE, gives=Quantity.IRRADIANCE)
def defocus(
    image: Image,
    *,
    focus_m: Annotated[float, Range(0.01)],
    distance_m: Annotated[float | None, Range(0.01)] = None,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    focal_length_mm: Annotated[float, Range(0.1, 2000.0), FromProfile("lens.focal_length_mm")],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
) -> Image:
    """Blur of a lens that is focused nearer or farther than the scene.

    A point becomes a disc of diameter c = f^2 / (N (s - f)) * |d - s| / d on the
    sensor; OTF = 2 J1(x) / x, x = pi c frequency.  Lamps become discs integrated over
    pixels.

    One distance for the whole picture.  Rays, not waves: times the OTF of
    `optics.diffraction` it is not quite that of a defocused lens, which Hopkins'
    integral gives.  The largest difference at any frequency is 0.062 for a disc of
    0.8 lambda N (the product has too little contrast), 0.246 for 3.2, 0.130 for 8,
    0.047 for 32 and 0.029 for 64: exact only for discs far wider than the Airy disc.

    The provenance gets `defocus_px`, the diameter, and `defocus_change`: what the
    finest diagonal frequency of the pixels loses of its contrast [1].  Below 0.001
    the picture is left as it is.

    Args:
        image: irradiance (H, W, C).
        focus_m: distance s of the plane that is sharp [m], beyond the focal length.
        distance_m: distance d of the scene [m]; empty for a far one.
        f_number: N [1].
        focal_length_mm: f [mm].
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].

    Raises:
        ImageError: the lens cannot focus so near, or the disc is wider than 2048 pixels.

    Source: Goodman, "Introduction to Fourier Optics", section 6.4; Hopkins, "The
    frequency response of a defocused optical system", Proc. R. Soc. A 231 (1955).
    """
    from scipy.special import j1

    disc_px = blur_disc_um(focus_m, distance_m, f_number=f_number, focal_length_mm=focal_length_mm) / pixel_pitch_um

    def transfer(frequency: FloatArray) -> Array:
        x = np.maximum(math.pi * disc_px * np.asarray(frequency, dtype=np.float64), 1e-6)
        return np.asarray(2.0 * j1(x) / x)

    corner = np.array([math.sqrt(0.5)], dtype=np.float32)
    change = float(1.0 - transfer(corner)[0])
    metadata = {"defocus_px": float(f"{disc_px:.4g}"), "defocus_change": float(f"{change:.3g}")}
    if change < UNSEEN:
        return image.with_metadata(**metadata)
    if disc_px > DISC_MAX_PX:
        raise ImageError(
            f"the blur disc is {disc_px:.0f} pixels wide; the widest is {DISC_MAX_PX:.0f}: bring focus_m nearer to "
            f"distance_m, or raise f_number"
        )
    blurs = [spread.Blur(transfer, spread.disc(disc_px))] * len(image.channels)
    pixels = spread.blurred(image.pixels, blurs, spread.highlight_limits(image.pixels))
    return image.with_pixels(pixels).with_metadata(**metadata)


def blur_disc_um(focus_m: float, distance_m: float | None, *, f_number: float, focal_length_mm: float) -> float:
    """Diameter [um] of the disc that a point out of focus makes; arguments as in `optics.defocus`.

    >>> round(blur_disc_um(5.0, None, f_number=2.0, focal_length_mm=6.0), 3)
    3.604
    """
    f_m = focal_length_mm * 1e-3
    if focus_m <= f_m:
        raise ImageError(
            f"a lens of {focal_length_mm:g} mm cannot focus at focus_m {focus_m:g}; it takes a distance beyond the "
            f"focal length"
        )
    relative = 1.0 if distance_m is None else abs(distance_m - focus_m) / distance_m
    return f_m * f_m / (f_number * (focus_m - f_m)) * relative * 1e6


def spectral_weights(sensor: SensorProfile, channels: tuple[str, ...]) -> Array:
    """(C, 401) share of each wavelength of `photometry.WAVELENGTHS_NM` in the electrons of each channel, over all
    colour filters; rows sum to 1.

    A channel that makes none gets the photons of its own spectrum.
    """
    spectra = photometry.channel_spectra(channels) * photometry.WAVELENGTHS_NM
    weights = spectra * response.quantum_efficiency(sensor).mean(axis=0)
    weights = np.where(weights.sum(axis=1, keepdims=True) > 0.0, weights, spectra)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


@dataclass(frozen=True)
class _Measured:
    """Power of a crop by radial frequency, and how much of it each mode gets wrong.

    Attributes:
        frequency: (B,) cycles per pixel.
        power: (K, B) for K channels: variance of the crop in each bin, relative to its mean squared.
        truth: (K, B) transfer of the channel's whole spectrum; spot: (B,) that of the lens's own spot, a part of it.
        mean_q, all_q: (K,) lambda N / pitch of the channel's mean wavelength, and the mean over all channels.
    """

    frequency: Array
    power: Array
    truth: Array
    spot: Array
    mean_q: Array
    all_q: float

    @classmethod
    def of(cls, image: Image, limits: Sequence[np.float32], weights: Array, per_nm: float, spot_px: float) -> _Measured:
        """Measure the first, middle and last channel."""
        channels = sorted({0, image.pixels.shape[2] // 2, image.pixels.shape[2] - 1})
        middle = channels[len(channels) // 2]
        top, column = _busiest(np.minimum(image.pixels[::4, ::4, middle], limits[middle]), image.pixels.shape[:2])
        crop = image.pixels[top : top + CROP_PX, column : column + CROP_PX]
        frequency, power = _power([np.minimum(crop[..., channel], limits[channel]) for channel in channels])
        truth = weights[channels] @ _aperture_transfers(per_nm, frequency.size)
        spot = spread.spot_transfer(spot_px, frequency)
        q = weights @ photometry.WAVELENGTHS_NM * per_nm
        return cls(frequency, power, truth * spot, spot, q[channels], float(q.mean()))

    def error(self, mode: str) -> float:
        """RMS difference to the truth, as a part of the mean level; the worst channel."""
        if mode == "none":
            transfer = np.ones_like(self.truth)
        else:
            q = self.mean_q if mode == "band" else np.full_like(self.mean_q, self.all_q)
            transfer = spread.aperture_transfer(np.outer(q, self.frequency)) * self.spot
        return float(np.sqrt((self.power * (transfer - self.truth) ** 2).sum(axis=1)).max())

    @property
    def contrast(self) -> float:
        """RMS contrast of the crop [1], of the channel that has most."""
        return float(np.sqrt(self.power.sum(axis=1)).max())


@functools.lru_cache(maxsize=4)
def _aperture_transfers(per_nm: float, count: int) -> Array:
    """(401, count) transfer of each wavelength at the first frequencies of `_power`; read-only."""
    rows_of_transfer = spread.aperture_transfer(np.outer(photometry.WAVELENGTHS_NM * per_nm, np.arange(count) / BINS))
    rows_of_transfer.flags.writeable = False
    return rows_of_transfer


def _chosen(
    image: Image, limits: Sequence[np.float32], mode: str, q: float, spot_px: float, measured: _Measured
) -> str:
    if mode != "auto":
        return mode
    if (
        q <= 1.0
        and measured.error("none") < UNSEEN
        and _contrast(image) * (0.134 * q + 1.1 * spot_px**2) < UNSEEN
        and not (image.pixels.max(axis=(0, 1)) > limits).any()
    ):
        return "none"
    if len(image.channels) > 3 and measured.error("broadband") <= BROADBAND_ERROR * measured.contrast:
        return "broadband"
    return "band"


def _contrast(image: Image) -> float:
    """RMS contrast [1] of the channel that has most, from every fourth row and column."""
    some = image.pixels[::4, ::4].reshape(-1, image.pixels.shape[2]).astype(np.float64)
    return float((some.std(axis=0) / np.maximum(some.mean(axis=0), 1e-300)).max())


def _busiest(some: FloatArray, shape: tuple[int, ...]) -> tuple[int, int]:
    """Top left corner, in a picture of `shape`, of the crop around the block whose variance is highest.

    `some` is every fourth row and column of the picture; a block has 32 pixels of that each way.
    """
    rows, columns = max(1, some.shape[0] // 32), max(1, some.shape[1] // 32)
    row_px, column_px = some.shape[0] // rows, some.shape[1] // columns
    blocks = some[: rows * row_px, : columns * column_px].reshape(rows, row_px, columns, column_px)
    row, column = np.unravel_index(int(blocks.var(axis=(1, 3)).argmax()), (rows, columns))
    middle = (4 * int(row) * row_px + 2 * row_px, 4 * int(column) * column_px + 2 * column_px)
    top, x0 = (max(0, min(at - CROP_PX // 2, length - CROP_PX)) for at, length in zip(middle, shape, strict=True))
    return top, x0


def _power(crops: Sequence[FloatArray]) -> tuple[Array, Array]:
    """(B,) radial frequencies [cycles/pixel] and (K, B) variances of K crops of one size there over their mean squared.

    The cosine transform is the Fourier transform of the crop mirrored at its edges,
    so the variances sum to that of the crop.
    """
    from scipy import fft

    bins = _bins(*crops[0].shape)
    spectra = []
    for crop in crops:
        terms = np.square(fft.dctn(crop, norm="ortho"), dtype=np.float64).ravel()
        mean2, terms[0] = terms[0] / crop.size, 0.0
        spectra.append(np.bincount(bins, weights=terms, minlength=364) / (crop.size * max(mean2, 1e-300)))
    return np.arange(spectra[0].size) / BINS, np.array(spectra)


@functools.lru_cache(maxsize=2)
def _bins(height: int, width: int) -> Indices:
    """(H W,) which of the frequencies of `_power` each term of a crop's cosine transform has; read-only."""
    row, column = (0.5 * np.arange(length) / length for length in (height, width))
    bins = np.rint(np.hypot(row[:, None], column[None, :]) * BINS).astype(np.int64).ravel()
    bins.flags.writeable = False
    return bins

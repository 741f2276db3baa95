"""Op that spreads each point of the picture: diffraction.

Irradiance in, irradiance out; `spread` does the work, and what is not worth computing is left out here.
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
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import response, spread
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.camera.registry import OPS

UNSEEN = 0.001
"""Change, as a part of the mean level or of a contrast, that is not worth computing."""

BROADBAND_ERROR = 0.0005
"""Part of the contrast up to which one wavelength may stand for all channels."""

NONE_Q, NONE_SPOT = 0.134, 1.1
"""RMS change of a picture over its contrast, for each lambda N / pitch and for each (spot / pitch)^2."""

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

    OTF = 2/pi (acos v - v sqrt(1 - v^2)), v = frequency * lambda N / pitch.  The spot s of the glass multiplies it by
    exp(-2 (pi s f / pitch)^2).  Pixels are radiance averaged over their own area already.

    That OTF ends at the pixels' Nyquist frequency with a step, which would draw a cross around a lamp.  So what exceeds
    8 times the frame's 95th percentile is taken for points of light, each spread as the disc integrated over pixels.

    The provenance gets `diffraction_mode` and `diffraction_error`.  The error is the RMS difference to a blur by the
    whole spectrum of the channel, as a part of the mean level, the worst of three channels.  It is computed in the
    256 x 256 pixels around the highest contrast, lamps cut off.

    Args:
        image: irradiance (H, W, C).
        mode: band takes one mean wavelength for each channel, broadband one for all, none leaves the picture as it is.
            auto takes none where neither points of light nor an error of 0.001 show; else broadband for more than three
            channels where its error is below 0.0005 of the contrast; else band.
        f_number: N [1].
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].
        sensor: weighs the wavelengths.
        spot_um: standard deviation of the Gaussian spot that a lens without diffraction would make, the same all over
            the picture [um].  `optics.aberrations` has spots that change over the field.

    Returns:
        Irradiance, >= 0.

    Source: Goodman, "Introduction to Fourier Optics", eq. 6-31.
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
    """The mode that auto takes; `NONE_Q` and `NONE_SPOT` are a fit to blurred 1/f textures with edges, q <= 1."""
    if mode != "auto":
        return mode
    if (
        q <= 1.0
        and measured.error("none") < UNSEEN
        and _contrast(image) * (NONE_Q * q + NONE_SPOT * spot_px**2) < UNSEEN
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

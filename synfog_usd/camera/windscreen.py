"""The windscreen that a car's camera looks through: what it takes of the light, its tint, and the second image."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from synfog_usd.base import photometry
from synfog_usd.base.arrays import Array, FloatArray
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import Range
from synfog_usd.camera.pinhole import Pinhole
from synfog_usd.camera.registry import FOV, OPS

GREEN_NM = (380.0, 400.0, 420.0, 450.0, 500.0, 530.0, 560.0, 600.0, 650.0, 700.0, 780.0)
GREEN_T = (0.02, 0.48, 0.70, 0.745, 0.785, 0.79, 0.785, 0.755, 0.705, 0.66, 0.58)
"""Laminated green glass across its surface: an estimate of its shape, with 77 % for light of illuminant A."""


@OPS.op("optics.windscreen", takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)
def windscreen(
    image: Image,
    *,
    rake_deg: Annotated[float, Range(0.0, 85.0)] = 60.0,
    wedge_mrad: Annotated[float, Range(-5.0, 5.0)] = 0.1,
    index: Annotated[float, Range(1.0, 2.5, above=True)] = 1.52,
    wavelength_nm: Annotated[tuple[float, ...], Range(300.0, 1200.0)] = GREEN_NM,
    transmittance: Annotated[tuple[float, ...], Range(0.0, 1.0)] = GREEN_T,
    fov_x_deg: Annotated[float | None, Range(0.0, 179.0, above=True), FOV] = None,
) -> Image:
    """A view through a windscreen: dimmed, tinted, and with a second image of what is bright.

    Light goes straight through, (1 - R)^2 t, or is reflected by the outer and the inner face before, (R t)^2 of that.
    R is Fresnel's for unpolarised light, t what the glass itself lets pass on the slanted way.  Where the faces are not
    parallel the second image stands apart by 2 w sqrt(n^2 - sin^2) / cos of the rake.

    The rake holds for the whole picture.  R, G and B are each dimmed by the mean over their spectrum; bands say more.

    Args:
        image: radiance (H, W, C).
        rake_deg: between the camera's axis and the glass's normal, in the vertical plane [degrees]; cars have 55 to 65.
        wedge_mrad: w, the angle between the faces [mrad], thicker at the top where > 0: the second image stands lower.
            An estimate; UN Regulation 43 allows for second images 15 arc minutes away.
        index: n of the glass [1].
        wavelength_nm: where the transmittance is given, rising [nm].
        transmittance: of the pane across its surface, its faces' reflections included [1].  By default an estimate of
            green laminated glass; UN Regulation 43 asks for 0.70 and more of illuminant A.
        fov_x_deg: horizontal angle of view [degrees]; needed where the faces are not parallel.

    Raises:
        ImageError: a table that does not rise, or lets more pass than its faces do; no angle of view.

    Source: Born and Wolf, Principles of Optics, 1.5 (Fresnel); Snell's law for the second image.
    """
    straight, second = _shares(image.channels, rake_deg, index, wavelength_nm, transmittance)
    pixels = image.pixels * straight.astype(np.float32)
    apart = second_image_rad(rake_deg, wedge_mrad * 1e-3, index)
    ghost = image.pixels * (straight * second).astype(np.float32)
    if apart:
        if "fisheye_coefficients" in image.provenance:
            raise ImageError(
                "the second image is a pinhole's; before a fisheye set wedge_mrad: 0, rake_deg: 0 or no screen"
            )
        if fov_x_deg is None:
            raise ImageError(f"the second image needs the angle of view: {FOV.hint}, or set wedge_mrad: 0")
        ghost = _lowered(ghost, apart, Pinhole.of(image, fov_x_deg))
    return image.with_pixels(pixels + ghost).with_metadata(second_image_arcmin=math.degrees(apart) * 60.0)


def second_image_rad(rake_deg: float, wedge_rad: float, index: float) -> float:
    """Angle by which the second image stands below the first [rad], for a thin wedge.

    >>> round(math.degrees(second_image_rad(60.0, 1e-4, 1.52)) * 60.0, 2)  # arc minutes
    1.72
    """
    rake = math.radians(rake_deg)
    return 2.0 * wedge_rad * math.sqrt(index**2 - math.sin(rake) ** 2) / math.cos(rake)


def fresnel(angle_deg: float, index: float) -> float:
    """Share of unpolarised light that a face of glass reflects.

    >>> round(fresnel(0.0, 1.5), 6), round(fresnel(60.0, 1.5), 3)
    (0.04, 0.089)
    """
    outer = math.cos(math.radians(angle_deg))
    inner = math.sqrt(1.0 - (1.0 - outer**2) / index**2)
    across = (outer - index * inner) / (outer + index * inner)
    along = (index * outer - inner) / (index * outer + inner)
    return 0.5 * (across**2 + along**2)


def _shares(
    channels: tuple[str, ...],
    rake_deg: float,
    index: float,
    wavelength_nm: tuple[float, ...],
    transmittance: tuple[float, ...],
) -> tuple[Array, Array]:
    """(C,) share of the light that goes straight through, and (C,) of the second image beside it."""
    if len(wavelength_nm) != len(transmittance) or len(wavelength_nm) < 2 or (np.diff(wavelength_nm) <= 0.0).any():
        raise ImageError(
            f"a table of {len(wavelength_nm)} wavelength_nm and {len(transmittance)} transmittance: it takes two or "
            f"more of each, wavelength_nm rising"
        )
    faces = fresnel(0.0, index)
    clear = (1.0 - faces) / (1.0 + faces)
    if max(transmittance) > clear + 1e-9:
        raise ImageError(
            f"transmittance goes up to {max(transmittance):g}, but glass of index {index:g} that absorbs nothing lets "
            f"{clear:.4g} pass"
        )
    pane = np.interp(photometry.WAVELENGTHS_NM, wavelength_nm, transmittance)
    # The pane's T sums all reflections, a geometric series of (R t)^2; here solved for t
    once = 2.0 * pane / ((1.0 - faces) ** 2 + np.sqrt((1.0 - faces) ** 4 + 4.0 * (faces * pane) ** 2))
    slant = 1.0 / math.sqrt(1.0 - (math.sin(math.radians(rake_deg)) / index) ** 2)
    inside, reflected = once**slant, fresnel(rake_deg, index)
    straight = (1.0 - reflected) ** 2 * inside
    spectra = photometry.channel_spectra(channels)
    total = spectra.sum(axis=1)
    first = spectra @ straight / total
    return first, spectra @ (straight * (reflected * inside) ** 2) / total / np.maximum(first, 1e-30)


def _lowered(pixels: FloatArray, apart_rad: float, view: Pinhole) -> FloatArray:
    """A picture turned downwards by an angle; straight lines between rows, the border's row beyond them."""
    height, axis = view.height_px, view.axis_px[1]
    below = np.arctan((np.arange(height) - axis) / view.focal_px) - apart_rad
    row = np.clip(np.tan(below) * view.focal_px + axis, 0.0, height - 1.0)
    first = np.minimum(row.astype(np.int64), max(height - 2, 0))
    part = (row - first).astype(np.float32)[:, None, None]
    return np.asarray(pixels[first] * (1.0 - part) + pixels[np.minimum(first + 1, height - 1)] * part)

"""What a sensor makes of light: quantum efficiency, electrons, and colour.

Takes a `SensorProfile`; gives its quantum efficiency on `photometry.WAVELENGTHS_NM`,
electrons per unit of irradiance, its neutral and the matrix that turns its
colours into linear Rec.709.  colour-science is imported on first use.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd import photometry
from synfog_usd.camera.profiles import SensorProfile
from synfog_usd.constants import LIGHT_SPEED_M_S, PLANCK_J_S
from synfog_usd.science import colour_science

Array = npt.NDArray[np.float64]

BAYER_RGGB = ((0, 1), (1, 2))
"""Channel (0 R, 1 G, 2 B) at [row % 2][column % 2]."""


@functools.lru_cache(maxsize=16)
def quantum_efficiency(sensor: SensorProfile) -> Array:
    """(3, 401) quantum efficiency [1] of the channels R, G, B on `photometry.WAVELENGTHS_NM`.

    A sensitivity per watt divided by the wavelength is one per photon.  Outside
    the measured range it is 0.
    """
    if sensor.qe.table:
        table = np.array(sensor.qe.table)
        return np.array([np.interp(photometry.WAVELENGTHS_NM, table[:, 0], table[:, 1 + channel], left=0.0, right=0.0) for channel in range(3)])
    colour = colour_science()

    measured = colour.MSDS_CAMERA_SENSITIVITIES[sensor.qe.camera]
    per_photon = measured.values / measured.wavelengths[:, None]
    scaled = np.maximum(per_photon, 0.0) * (sensor.qe.peak / per_photon.max())
    return np.array([np.interp(photometry.WAVELENGTHS_NM, measured.wavelengths, scaled[:, channel], left=0.0, right=0.0) for channel in range(3)])


def electrons_per_second(sensor: SensorProfile, channels: tuple[str, ...], *, pixel_pitch_um: float, fill_factor: float) -> Array:
    """Electrons per second and unit of irradiance.

    N = A * integral of E(lambda) * QE(lambda) * lambda / (h c) d lambda.

    Args:
        sensor: whose quantum efficiency.
        channels: of the irradiance image; see `photometry.channel_spectra`.
        pixel_pitch_um: side of a pixel [um].
        fill_factor: light-sensitive part of its area [1].

    Returns:
        (3, C) float64: row R, G, B of the mosaic, column per image channel.

    Source: EMVA 1288 release 4.0, section 2.1.
    """
    photons_per_joule = photometry.WAVELENGTHS_NM * 1e-9 / (PLANCK_J_S * LIGHT_SPEED_M_S)
    area_m2 = (pixel_pitch_um * 1e-6) ** 2 * fill_factor
    return np.asarray((quantum_efficiency(sensor) * photons_per_joule) @ photometry.channel_spectra(channels).T * area_m2)


def mean_wavelengths_nm(sensor: SensorProfile, channels: tuple[str, ...]) -> Array:
    """(C,) mean wavelength [nm] of the electrons that each image channel makes, over all colour filters.

    A channel that makes none gets the mean of its own spectrum.
    """
    spectra = photometry.channel_spectra(channels) * photometry.WAVELENGTHS_NM
    weights = spectra * quantum_efficiency(sensor).mean(axis=0)
    weights = np.where(weights.sum(axis=1, keepdims=True) > 0.0, weights, spectra)
    return np.asarray(weights @ photometry.WAVELENGTHS_NM / weights.sum(axis=1))


@functools.lru_cache(maxsize=16)
def neutral(sensor: SensorProfile, illuminant: str) -> tuple[float, float, float]:
    """Signal of a white surface in the channels R, G, B under 'D65' or 'A', the largest being 1."""
    signal = quantum_efficiency(sensor) @ (photometry.illuminant(illuminant) * photometry.WAVELENGTHS_NM)
    red, green, blue = signal / signal.max()
    return float(red), float(green), float(blue)


@dataclass(frozen=True)
class ColourMatrix:
    """White-balanced camera colours to linear Rec.709.

    Attributes:
        rows: (3, 3), row sums 1, so that white stays white.
        mean_de00, max_de00: CIEDE2000 over the 24 patches of the ISO 17321-1 chart,
            which took no part in the fit.
    """

    rows: tuple[tuple[float, float, float], ...]
    mean_de00: float
    max_de00: float


@functools.lru_cache(maxsize=16)
def colour_matrix(sensor: SensorProfile, illuminant: str) -> ColourMatrix:
    """The 3x3 that brings a sensor's colours nearest to what an eye sees under one light.

    Least squares in CIE L*a*b* over the 190 reflectances of the RAW to ACES
    project, with white held; colours are adapted from the light to D65 (Bradford).

    Args:
        sensor: whose quantum efficiency.
        illuminant: 'D65' or 'A'.

    Source: training set and method: AMPAS S-2013-001 (as in `colour.matrix_idt`).
    """
    colour = colour_science()
    from scipy.optimize import least_squares

    training = colour.characterisation.read_training_data_rawtoaces_v1()
    camera, xyz = _patches(sensor, illuminant, np.asarray(training.wavelengths, np.float64), np.asarray(training.values.T, np.float64))
    to_rgb = colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB
    to_xyz = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
    white = to_xyz.sum(axis=1)
    white_xy = colour.XYZ_to_xy(white)
    target = colour.XYZ_to_Lab(xyz, white_xy)

    def rows(free: Array) -> Array:
        first_two = free.reshape(3, 2)
        return np.column_stack([first_two, 1.0 - first_two.sum(axis=1)])

    def misses(free: Array) -> Array:
        return np.ravel(colour.XYZ_to_Lab(camera @ rows(free).T @ to_xyz.T, white_xy) - target)

    wanted = xyz @ to_rgb.T
    differences = camera[:, :2] - camera[:, 2:]
    start = np.array([np.linalg.lstsq(differences, wanted[:, row] - camera[:, 2], rcond=None)[0] for row in range(3)])
    matrix = rows(least_squares(misses, start.ravel(), method="lm").x)

    chart = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    wavelengths = np.asarray(next(iter(chart.values())).wavelengths, np.float64)
    camera, xyz = _patches(sensor, illuminant, wavelengths, np.array([patch.values for patch in chart.values()]))
    found = colour.XYZ_to_Lab(camera @ matrix.T @ to_xyz.T, white_xy)
    difference = colour.delta_E(colour.XYZ_to_Lab(xyz, white_xy), found, method="CIE 2000")
    values = tuple((float(a), float(b), float(c)) for a, b, c in matrix)
    return ColourMatrix(values, float(difference.mean()), float(difference.max()))


def xyz_to_camera(sensor: SensorProfile) -> Array:
    """(3, 3) CIE XYZ (D65 white, Y = 1) to camera signal (neutral as in `neutral`): DNG's ColorMatrix1."""
    colour = colour_science()

    srgb_to_camera = np.linalg.inv(np.array(colour_matrix(sensor, "D65").rows))
    return np.asarray(np.diag(neutral(sensor, "D65")) @ srgb_to_camera @ np.linalg.inv(colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ))


def _patches(sensor: SensorProfile, illuminant: str, wavelengths_nm: Array, reflectances: Array) -> tuple[Array, Array]:
    """White-balanced camera signal (N, 3), and XYZ (N, 3) under D65, of (N, W) reflectances; white is 1 and Y = 1."""
    colour = colour_science()

    fine = np.array([np.interp(photometry.WAVELENGTHS_NM, wavelengths_nm, row) for row in reflectances])
    lit = fine * photometry.illuminant(illuminant)
    camera = (lit * photometry.WAVELENGTHS_NM) @ quantum_efficiency(sensor).T
    white = quantum_efficiency(sensor) @ (photometry.illuminant(illuminant) * photometry.WAVELENGTHS_NM)
    xyz = lit @ photometry.observer().T
    xyz_white = photometry.observer() @ photometry.illuminant(illuminant)
    d65 = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ.sum(axis=1)
    adapt = colour.adaptation.matrix_chromatic_adaptation_VonKries(xyz_white / xyz_white[1], d65, transform="Bradford")
    return camera / white, (xyz / xyz_white[1]) @ adapt.T

"""What a sensor makes of light: quantum efficiency, electrons, and colour.

Takes a `SensorProfile`; gives its quantum efficiency on `photometry.WAVELENGTHS_NM`,
electrons per unit of irradiance, its neutral and the matrix that turns its
colours into linear Rec.709.  F is the number of its colour filters, in the order of
`cfa.filters`.  colour-science is imported on first use.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from synfog_usd.base import photometry, tables
from synfog_usd.base.arrays import Array
from synfog_usd.base.constants import LIGHT_SPEED_M_S, PLANCK_J_S
from synfog_usd.base.errors import ImageError, ParameterError
from synfog_usd.base.science import colour_science
from synfog_usd.camera import cfa
from synfog_usd.camera.profiles import Curve, SensorProfile


@functools.lru_cache(maxsize=16)
def quantum_efficiency(sensor: SensorProfile) -> Array:
    """(F, 401) quantum efficiency [1] behind each filter on `photometry.WAVELENGTHS_NM`.

    A sensitivity per watt divided by the wavelength is one per photon.  Outside
    the measured range it is 0.

    Raises:
        ParameterError: a filter through which no light of 380 to 780 nm is seen.
    """
    efficiency = _efficiency(sensor)
    for letter, row in zip(cfa.filters(sensor.cfa), efficiency, strict=True):
        if not row.max() > 0.0:
            raise ParameterError(
                f"sensor {sensor.name!r}: its quantum efficiency behind filter {letter} is 0 from 380 to 780 nm; "
                f"nothing else is simulated"
            )
    return efficiency


def _efficiency(sensor: SensorProfile) -> Array:
    qe, nm = sensor.qe, photometry.WAVELENGTHS_NM
    if qe.table:
        wavelengths_nm, *columns = np.array(qe.table).T
        return np.array([np.interp(nm, wavelengths_nm, column, left=0.0, right=0.0) for column in columns])
    if qe.filters:
        shared = np.prod([_curve(curve) for curve in qe.common], axis=0)
        return np.array([shared * _curve(curve) for curve in qe.filters])
    if qe.observer:
        per_photon = photometry.observer() / nm
        return np.asarray(per_photon * (qe.peak / per_photon.max()))
    measured = tables.table(tables.CAMERAS[qe.camera])
    per_photon = np.array([measured[letter] / measured["wavelength_nm"] for letter in "RGB"])
    scaled = np.maximum(per_photon, 0.0) * (qe.peak / per_photon.max())
    return np.array([np.interp(nm, measured["wavelength_nm"], row, left=0.0, right=0.0) for row in scaled])


def _curve(curve: Curve) -> Array:
    """(401,) values of a curve on `photometry.WAVELENGTHS_NM`."""
    nm, numbers = photometry.WAVELENGTHS_NM, curve.numbers
    if curve.kind == "csv":
        return np.interp(nm, numbers[0::2], numbers[1::2], left=0.0, right=0.0)
    if curve.kind == "flat":
        return np.full_like(nm, numbers[0])
    if curve.kind == "gaussian":
        centre_nm, fwhm_nm, peak = numbers
        return np.asarray(peak * 0.5 ** ((nm - centre_nm) / (fwhm_nm / 2.0)) ** 2)
    edge_nm, width_nm = numbers
    rising = 0.5 * (
        1.0 + np.tanh((nm - edge_nm) * np.log(9.0) / width_nm)
    )  # the logistic: 10 % and 90 % lie width_nm apart
    return rising if curve.kind == "long_pass" else 1.0 - rising


def electrons_per_second(
    sensor: SensorProfile, channels: tuple[str, ...], *, pixel_pitch_um: float, fill_factor: float
) -> Array:
    """Electrons per second and unit of irradiance.

    N = A * integral of E(lambda) * QE(lambda) * lambda / (h c) d lambda.

    Args:
        sensor: whose quantum efficiency.
        channels: of the irradiance image; see `photometry.channel_spectra`.
        pixel_pitch_um: side of a pixel [um].
        fill_factor: light-sensitive part of its area [1].

    Returns:
        (F, C) float64: row per filter of the mosaic, column per image channel.

    Raises:
        ImageError: a band that lies outside 380 to 780 nm, where nothing is simulated:
            it would be taken for darkness.

    Source: EMVA 1288 release 4.0, section 2.1.
    """
    photons_per_joule = photometry.WAVELENGTHS_NM * 1e-9 / (PLANCK_J_S * LIGHT_SPEED_M_S)
    area_m2 = (pixel_pitch_um * 1e-6) ** 2 * fill_factor
    spectra = photometry.channel_spectra(channels)
    if unseen := [name for name, spectrum in zip(channels, spectra, strict=True) if not spectrum.any()]:
        low, high = photometry.WAVELENGTHS_NM[[0, -1]]
        named = ", ".join(unseen) if len(unseen) < 4 else f"{unseen[0]} to {unseen[-1]}, {len(unseen)} bands,"
        raise ImageError(
            f"{named} outside {low:g} to {high:g} nm, where no sensor is simulated, near infra-red included; "
            f"leave such bands out"
        )
    return np.asarray((quantum_efficiency(sensor) * photons_per_joule) @ spectra.T * area_m2)


@functools.lru_cache(maxsize=16)
def neutral(sensor: SensorProfile, illuminant: str) -> tuple[float, ...]:
    """(F,) signal of a white surface behind each filter under a light of `photometry.ILLUMINANTS`, the largest being
    1.
    """
    signal = quantum_efficiency(sensor) @ (photometry.illuminant(illuminant) * photometry.WAVELENGTHS_NM)
    return tuple(float(value) for value in signal / signal.max())


@dataclass(frozen=True)
class ColourMatrix:
    """White-balanced camera colours to linear Rec.709.

    Attributes:
        rows: (3, F), row sums 1, so that white stays white.
        mean_de00, max_de00: CIEDE2000 over the 24 patches of the ISO 17321-1 chart,
            which took no part in the fit.
    """

    rows: tuple[tuple[float, ...], ...]
    mean_de00: float
    max_de00: float


@functools.lru_cache(maxsize=32)
def colour_matrix(sensor: SensorProfile, illuminant: str) -> ColourMatrix:
    """The matrix that brings a sensor's colours nearest to what an eye sees under one light.

    Least squares in CIE L*a*b* over the 190 reflectances of the RAW to ACES
    project, with white held; colours are adapted from the light to D65 (Bradford).

    Args:
        sensor: whose quantum efficiency.
        illuminant: one of `photometry.ILLUMINANTS`.

    Raises:
        ParameterError: a sensor of fewer than three filters, which sees no colours.

    Source: training set and method: AMPAS S-2013-001 (as in `colour.matrix_idt`).
    """
    colour = colour_science()
    from scipy.optimize import least_squares

    if len(cfa.filters(sensor.cfa)) < 3:
        raise ParameterError(
            f"sensor {sensor.name!r} sees no colours: pattern {sensor.cfa} has the filters "
            f"{', '.join(cfa.filters(sensor.cfa))} only"
        )
    camera, xyz = _patches(sensor, illuminant, *_training())
    to_rgb = colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB
    to_xyz = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
    white = to_xyz.sum(axis=1)
    white_xy = colour.XYZ_to_xy(white)
    target = colour.XYZ_to_Lab(xyz, white_xy)

    def rows(free: Array) -> Array:
        all_but_last = free.reshape(3, -1)
        return np.column_stack([all_but_last, 1.0 - all_but_last.sum(axis=1)])

    def misses(free: Array) -> Array:
        return np.ravel(colour.XYZ_to_Lab(camera @ rows(free).T @ to_xyz.T, white_xy) - target)

    wished_xyz = xyz @ to_rgb.T
    differences = camera[:, :-1] - camera[:, -1:]
    start = np.array(
        [np.linalg.lstsq(differences, wished_xyz[:, row] - camera[:, -1], rcond=None)[0] for row in range(3)]
    )
    matrix = rows(least_squares(misses, start.ravel(), method="lm").x)

    chart = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    wavelengths = np.asarray(next(iter(chart.values())).wavelengths, np.float64)
    camera, xyz = _patches(sensor, illuminant, wavelengths, np.array([patch.values for patch in chart.values()]))
    lab = colour.XYZ_to_Lab(camera @ matrix.T @ to_xyz.T, white_xy)
    difference = colour.delta_E(colour.XYZ_to_Lab(xyz, white_xy), lab, method="CIE 2000")
    values = tuple(tuple(float(value) for value in row) for row in matrix)
    return ColourMatrix(values, float(difference.mean()), float(difference.max()))


@functools.lru_cache(maxsize=32)
def xyz_to_camera(sensor: SensorProfile, illuminant: str = "D65", *, as_daylight: bool = False) -> Array:
    """(F, 3) CIE XYZ as it is under one light (white has Y = 1) to camera signal (white as in `neutral`): DNG's
    ColorMatrix.

    The inverse of `colour_matrix` where there are three filters; else the least
    squares over the same reflectances, with white held.

    Args:
        sensor, illuminant: see `colour_matrix`.
        as_daylight: XYZ as an eye that is used to the light would have them under D65: for
            readers that know one matrix, and take it for daylight's.

    Raises:
        ParameterError: see `colour_matrix`.
    """
    colour = colour_science()

    matrix = np.array(colour_matrix(sensor, illuminant).rows)
    to_srgb = np.linalg.inv(colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ)
    if matrix.shape[1] == 3:
        from_xyz = np.linalg.solve(matrix, to_srgb)
    else:
        camera, xyz = _patches(sensor, illuminant, *_training())
        white = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ.sum(axis=1)
        free = np.linalg.lstsq(xyz[:, [0, 2]] - xyz[:, 1:2] * white[[0, 2]], camera - xyz[:, 1:2], rcond=None)[0]
        from_xyz = np.column_stack([free[0], 1.0 - white[[0, 2]] @ free, free[1]])
    adapted = np.eye(3) if as_daylight else _to_d65(illuminant)
    return np.asarray(np.diag(neutral(sensor, illuminant)) @ from_xyz @ adapted)


def _training() -> tuple[Array, Array]:
    """Wavelengths (W,) [nm] and reflectances (N, W) of the RAW to ACES project."""
    training = colour_science().characterisation.read_training_data_rawtoaces_v1()
    return np.asarray(training.wavelengths, np.float64), np.asarray(training.values.T, np.float64)


def _to_d65(illuminant: str) -> Array:
    """(3, 3) XYZ under a light to XYZ under D65, white to white (Bradford)."""
    colour = colour_science()

    white = photometry.observer() @ photometry.illuminant(illuminant)
    d65 = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ.sum(axis=1)
    return np.asarray(
        colour.adaptation.matrix_chromatic_adaptation_VonKries(white / white[1], d65, transform="Bradford")
    )


def _patches(sensor: SensorProfile, illuminant: str, wavelengths_nm: Array, reflectances: Array) -> tuple[Array, Array]:
    """White-balanced camera signal (N, F), and XYZ (N, 3) under D65, of (N, W) reflectances; white is 1 and Y = 1."""
    fine = np.array([np.interp(photometry.WAVELENGTHS_NM, wavelengths_nm, row) for row in reflectances])
    lit = fine * photometry.illuminant(illuminant)
    camera = (lit * photometry.WAVELENGTHS_NM) @ quantum_efficiency(sensor).T
    white = quantum_efficiency(sensor) @ (photometry.illuminant(illuminant) * photometry.WAVELENGTHS_NM)
    xyz = lit @ photometry.observer().T
    xyz_white = photometry.observer() @ photometry.illuminant(illuminant)
    return camera / white, (xyz / xyz_white[1]) @ _to_d65(illuminant).T

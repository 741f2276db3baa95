"""Channel spectra and electrons, against published colour data and integrals done by hand."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from synfog_usd.base import photometry
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import response
from synfog_usd.camera.profiles import load_sensor

RGB = ("R", "G", "B")
SENSOR = load_sensor("imx363")


def bands(*centres_nm: float) -> tuple[str, ...]:
    return tuple(photometry.band_name(centre) for centre in centres_nm)


def test_each_rgb_channel_has_the_colour_of_its_srgb_primary():
    """The spectra, seen by the CIE observer, give the matrix of IEC 61966-2-1 (4 digits there; the fit of 2019 is good
    to 0.0015).
    """
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(colour.SpectralShape(380, 780, 1))
    xyz = 683.002 * photometry.channel_spectra(RGB) @ observer.values
    np.testing.assert_allclose(xyz.T, colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ, atol=0.0015)


def test_white_has_one_nit_and_the_chromaticity_of_d65():
    image = Image(np.ones((1, 1, 3), np.float32), RGB, Quantity.RADIANCE)
    assert photometry.luminance(image)[0, 0] == pytest.approx(1.0, abs=1e-6)
    xyz = photometry.channel_spectra(RGB).sum(axis=0) @ photometry.observer().T
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), (0.3127, 0.3290), atol=1e-4)  # CIE 015, four digits


def test_bands_fill_the_spectrum_once():
    spectra = photometry.channel_spectra(bands(425, 475, 525, 575, 625, 675, 725))
    inside = (photometry.WAVELENGTHS_NM > 400.5) & (photometry.WAVELENGTHS_NM < 749.5)
    np.testing.assert_allclose(spectra.sum(axis=0)[inside], 1.0, rtol=1e-12)
    np.testing.assert_allclose(spectra.sum(axis=1), 50.0, rtol=1e-12)


@pytest.mark.parametrize(
    "channels", [("R", "G"), ("X", "Y", "Z"), bands(550), bands(600, 500), ("R", *bands(500, 600))]
)
def test_other_channels_are_refused(channels):
    with pytest.raises(ImageError, match=r"neither R, G, B nor two or more rising bands"):
        photometry.channel_spectra(channels)


def test_band_names_are_those_of_fichet_et_al():
    assert photometry.band_name(412.5) == "S0.412,500000nm"
    bands = {"S0.412,500000nm": 412.5, "S0.700nm": 700.0, "T.550nm": None, "R": None}
    assert {name: photometry.band_centre_nm(name) for name in bands} == bands


def test_electrons_of_one_wavelength_follow_the_emva_formula():
    """mu_p = 50.34 A[um2] t[ms] lambda[um] E[uW/cm2] (EMVA 1288 R4.0, eq. 3), times the quantum efficiency read off the
    measured curve.
    """
    measured = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    per_photon = measured.values / measured.wavelengths[:, None]
    qe_550 = 0.6 * per_photon[measured.wavelengths == 550.0][0] / per_photon.max()
    photons = 50.34 * 1.4**2 * 1000.0 * 0.550 * 100.0  # 1 s, 1 W m-2 = 100 uW cm-2 within the one nanometre of the band
    found = response.electrons_per_second(SENSOR, bands(549, 550, 551), pixel_pitch_um=1.4, fill_factor=1.0)[:, 1]
    np.testing.assert_allclose(found, photons * qe_550, rtol=2e-4)  # 50.34 has four digits


def test_electrons_of_white_light_follow_a_hand_integral():
    """One lux of D65, summed on colour-science's own 5 nm tables with its own luminous integral."""
    shape = colour.SpectralShape(380, 780, 5)
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    y_bar = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values[:, 1]
    wavelengths_m = shape.wavelengths * 1e-9
    watts = d65 / (683.002 * np.sum(d65 * y_bar) * 5.0)
    measured = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"].values / shape.wavelengths[:, None]
    qe = 0.6 * measured / measured.max()
    expected = (
        np.sum(watts[:, None] * qe * wavelengths_m[:, None] / (6.62607015e-34 * 299792458.0), axis=0)
        * 5.0
        * (2e-6) ** 2
        * 0.5
    )
    found = response.electrons_per_second(SENSOR, RGB, pixel_pitch_um=2.0, fill_factor=0.5).sum(axis=1)
    np.testing.assert_allclose(found, expected, rtol=2e-3)  # 5 nm steps against 1 nm


def test_white_balance_equals_that_of_the_raw_to_aces_project():
    """`colour.matrix_idt` gives the multipliers of the same curves under D65; only their ratios count."""
    with colour.utilities.suppress_warnings(
        colour_runtime_warnings=True
    ):  # it says that it interpolates its own tables
        _, multipliers = colour.matrix_idt(
            colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"], colour.SDS_ILLUMINANTS["D65"]
        )
    gains = 1.0 / np.array(response.neutral(SENSOR, "D65"))
    np.testing.assert_allclose(gains / gains[1], multipliers / multipliers[1], rtol=1e-3)  # 1 nm against 5 nm


def test_the_raw_matrix_sends_d65_to_the_neutral_and_undoes_the_colour_matrix():
    white = colour.xy_to_XYZ((0.3127, 0.3290))
    np.testing.assert_allclose(
        response.xyz_to_camera(SENSOR) @ white, response.neutral(SENSOR, "D65"), atol=1e-3
    )  # the sRGB matrix has four digits
    rows = np.array(response.colour_matrix(SENSOR, "D65").rows)
    np.testing.assert_allclose(rows.sum(axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("name", colour.MSDS_CAMERA_SENSITIVITIES)
def test_the_named_curves_are_those_that_colour_science_ships(name):
    from synfog_usd.camera.profiles import CAMERAS_MEASURED

    assert name in CAMERAS_MEASURED and len(CAMERAS_MEASURED) == len(colour.MSDS_CAMERA_SENSITIVITIES)

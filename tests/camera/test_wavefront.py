"""Spots of a wavefront: a round aperture, Hopkins' defocus, Marechal's Strehl ratio, and where coma's light goes."""

import math

import numpy as np
import pytest
from scipy import integrate

from synfog_usd.base import photometry
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.blur import diffraction
from synfog_usd.camera.profiles import load_sensor
from synfog_usd.camera.wavefront import Pupil, wavefront

PUPIL = Pupil(550.0, 4.0, 2.0, 64)
Q = 0.55 * 4.0 / 2.0
"""lambda N / pitch of it."""

NONE = np.zeros(5)


def irradiance(pixels: np.ndarray) -> Image:
    return Image(
        np.repeat(pixels[..., None], 2, axis=2).astype(np.float32),
        (photometry.band_name(550.0), photometry.band_name(552.0)),
        Quantity.IRRADIANCE,
        provenance={"fov_x_deg": 60.0},
    )


def run(image: Image, **more):
    options = {"f_number": 4.0, "pixel_pitch_um": 2.0, "sensor": load_sensor("imx363"), "fov_x_deg": 60.0}
    return wavefront(image, **{**options, **more})


def along(transfer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """v = lambda N f from 0 to 1, and the transfer function there."""
    v = np.arange(len(transfer) // 2) / PUPIL.window * Q
    return v[v < 1.0], transfer[0, : len(v)][v < 1.0]


def test_without_errors_contrast_is_that_of_a_round_aperture():
    """2 / pi (acos v - v sqrt(1 - v^2)), along rows and along a diagonal, and by the wavelength."""
    v, found = along(PUPIL.transfer(NONE))
    assert v.size > 50 and np.abs(found.imag).max() < 1e-6
    np.testing.assert_allclose(found.real, 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v * v)), atol=0.005)
    diagonal = np.diag(PUPIL.transfer(NONE)).real[:30]
    v = np.arange(30) * math.sqrt(2.0) / PUPIL.window * Q
    np.testing.assert_allclose(diagonal, 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v * v)), atol=0.005)
    v = np.arange(30) / 64 * 0.45 * 4.0 / 2.0
    blue = Pupil(450.0, 4.0, 2.0, 64).transfer(NONE)[0, :30].real
    np.testing.assert_allclose(blue, 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v * v)), atol=0.005)


@pytest.mark.parametrize("waves", [0.1, 0.7])
def test_defocus_is_hopkins_integral(waves):
    """W = w sqrt(3) (2 r^2 - 1) at u + v and u - v differs by 8 sqrt(3) w u v, over the lens that both pupils share."""
    v, found = along(PUPIL.transfer(np.array([waves * 550.0, 0, 0, 0, 0])))
    rate = 2.0 * np.pi * 8.0 * math.sqrt(3.0) * waves
    wanted = [
        2.0
        / np.pi
        * integrate.quad(
            lambda u, s=s: 2.0 * math.sqrt(max(1.0 - (u + s) ** 2, 0.0)) * math.cos(rate * u * s), 0.0, 1.0 - s
        )[0]
        for s in v[::4]
    ]
    np.testing.assert_allclose(found[::4].real, wanted, atol=0.005)
    assert waves < 0.3 or min(wanted) < -0.02, "contrast is reversed somewhere"


@pytest.mark.parametrize("term", [0, 2, 4])
def test_the_strehl_ratio_is_marechals(term):
    """exp(-(2 pi s)^2) for s up to 1/15 wavelength: the light on the axis of the spot, in its own direction's best
    place; coma and trefoil in Noll's form are balanced, so that it is at the centre.  All terms are normalised so.
    """
    sharp = PUPIL.transfer(NONE).real.sum()
    for waves in (0.03, 1 / 15):
        coefficients = np.zeros(5)
        coefficients[term] = waves * 550.0
        ratio = PUPIL.transfer(coefficients, 0.7).real.sum() / sharp
        assert ratio == pytest.approx(math.exp(-((2 * np.pi * waves) ** 2)), abs=0.01)


def test_coma_points_away_from_the_axis_in_the_picture():
    """A point up and to the right of the axis, at one of the places whose spots are computed; light is kept.  Of the
    way that it goes 6 % are the tail beyond the window.
    """
    pixels = np.full((128, 128), 1e-6)
    pixels[47, 80] = 1000.0
    found = run(irradiance(pixels), field_deg=(0.0, 1.0), z8_nm=(0.0, 100.0)).pixels[..., 0].astype(np.float64)
    assert found.sum() == pytest.approx(pixels.sum(), rel=0.01) and found.min() >= 0.0
    rows, columns = np.mgrid[:128, :128]
    right, up = ((found * part).sum() / found.sum() for part in (columns - 80.0, 47.0 - rows))
    wanted_px = 2.0 * 4.0 * math.sqrt(8.0) * 0.1 / 2.0 / math.sqrt(2.0)
    assert (right, up) == pytest.approx((wanted_px, wanted_px), rel=0.1)


def test_contrast_in_the_picture_is_that_of_the_place():
    """A wave of 0.25 cycles a pixel through a lens with defocus everywhere and spherical aberration."""
    wave = 1.0 + 0.1 * np.cos(2 * np.pi * 0.25 * np.arange(64))[None, :] + np.zeros((64, 1))
    found = run(irradiance(wave), field_deg=(0.0, 40.0), z4_nm=(60.0, 60.0), z11_nm=(40.0, 40.0))
    middle = found.pixels[20:44, 20:44, 0].astype(np.float64)
    terms = np.exp(2j * np.pi * 0.25 * np.arange(20, 44))
    contrast = abs((middle.mean(axis=0) * terms).mean()) * 2.0 / middle.mean() / 0.1
    nm, u, v = 550.0, np.linspace(-1.5, 1.5, 1501)[None, :], np.linspace(-1.0, 1.0, 1001)[:, None]
    shift = 0.25 * nm * 1e-3 * 4.0 / 2.0

    def field(x):
        r2 = x * x + v * v
        path = 60.0 * math.sqrt(3.0) * (2.0 * r2 - 1.0) + 40.0 * math.sqrt(5.0) * (6.0 * r2 * r2 - 6.0 * r2 + 1.0)
        return (r2 <= 1.0) * np.exp(2j * np.pi / nm * path)

    wanted = abs((field(u + shift) * np.conj(field(u - shift))).sum()) / (abs(field(u)) ** 2).sum()
    assert contrast == pytest.approx(wanted, abs=0.015)


def test_what_is_no_table_is_refused_and_none_changes_nothing():
    image = irradiance(np.ones((16, 16)))
    assert run(image) is image
    with pytest.raises(ImageError, match="they rise from 0"):
        run(image, field_deg=(0.0, 10.0), z4_nm=(1.0,))
    with pytest.raises(ImageError, match="128 are the most"):
        run(image, field_deg=(0.0, 10.0), z4_nm=(0.0, 90000.0))
    with pytest.raises(ImageError, match="begin with 0"):
        run(image, field_deg=(0.0, 10.0), z8_nm=(1.0, 1.0))
    with pytest.raises(ImageError, match="too large for waves"):
        run(image, field_deg=(0.0,), z4_nm=(1.0,), f_number=0.5, pixel_pitch_um=50.0)


def test_diffraction_counts_once():
    """With both ops the second stops, whichever it is."""
    image = irradiance(1.0 + 0.5 * np.eye(32))
    options = {"f_number": 4.0, "pixel_pitch_um": 2.0, "sensor": load_sensor("imx363")}
    table = {"field_deg": (0.0,), "z4_nm": (20.0,)}
    with pytest.raises(ImageError, match="leave it out"):
        run(diffraction(image, mode="band", **options), **table)
    with pytest.raises(ImageError, match="leave one of the two out"):
        diffraction(run(image, **table), mode="band", **options)

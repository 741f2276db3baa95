"""Levels, colour and tone: white stays white in every light, gamma is sRGB, and a ColorChecker comes out as the eye
sees it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import colour
import numpy as np
import pytest
from support import raws

from synfog_usd import camera
from synfog_usd.base import photometry, resources, seeds
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import cfa, isp
from synfog_usd.camera.profiles import load_sensor

SENSOR = load_sensor("imx363")
LIGHTS = {"d65": "D65", "a": "A", "hps": "HP1", "led": "LED-B3"}
"""Our name of a light -> colour-science's."""

LINEAR = """\
synfog: graph/1
inputs: [radiance]
sensor: imx363
lens: pixel4a
nodes:
  - {op: optics.irradiance, falloff: none}
  - {op: sensor.expose, exposure_s: EXPOSURE}
  - {op: sensor.gain, iso: 55, gain_dn_e: 10}
  - {op: sensor.adc, bits: 16, white_level_dn: 65535}
  - {op: isp.black_level}
  - {op: isp.white_balance}
  - {op: isp.demosaic, algorithm: ALGORITHM}
  - {op: isp.colour_correct}
outputs: {linear.exr: colour_correct}
"""


def mosaic(pixels, quantity=Quantity.LINEAR_RGB, pattern="RGGB", **metadata) -> Image:
    return Image(
        np.asarray(pixels, np.float32)[..., None], ("CFA",), quantity, provenance={"cfa_pattern": pattern, **metadata}
    )


def numbers(pixels, **metadata) -> Image:
    return mosaic(pixels, Quantity.DN, **metadata)


def grey(values) -> Image:
    return Image(np.asarray(values, np.float32).reshape(1, -1, 1), ("Y",), Quantity.LINEAR_RGB)


def picture(pixels) -> Image:
    return Image(np.asarray(pixels, np.float32), ("R", "G", "B"), Quantity.LINEAR_RGB)


@pytest.mark.parametrize("algorithm", ["directional", "mhc"])
def test_a_colorchecker_under_d65_comes_out_right(tmp_path, algorithm):
    """24 measured spectra go in as 80 bands of radiance; CIEDE2000 against colour-science's own XYZ of them.

    No noise, 16 bits, blocks of 24 x 24 pixels read in their middle.  The bound: 0.88 is the
    published mean for this camera's curves with a 3x3 that keeps white; 0.2 for the training set being another one.
    """
    chart = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    d65 = colour.SDS_ILLUMINANTS["D65"]
    centres = np.arange(382.5, 780.0, 5.0)
    lit = np.interp(centres, d65.wavelengths, d65.values) * 0.002
    reflectances = np.array([np.interp(centres, patch.wavelengths, patch.values) for patch in chart.values()])
    pixels = np.repeat(np.repeat((reflectances * lit).reshape(4, 6, -1), 24, axis=0), 24, axis=1).astype(np.float32)
    image = Image(pixels, tuple(photometry.band_name(centre) for centre in centres), Quantity.RADIANCE)
    path = tmp_path / "g.yaml"
    path.write_text(LINEAR.replace("EXPOSURE", "0.0002").replace("ALGORITHM", algorithm))
    out = camera.load_graph(path).run({"radiance": image}, seed=0)["colour_correct"]
    found = out.pixels[11::24, 11::24].reshape(24, 3).astype(np.float64)
    with colour.utilities.suppress_warnings(
        colour_runtime_warnings=True
    ):  # it says that it interpolates its own tables
        expected = np.array([colour.sd_to_XYZ(patch, illuminant=d65) for patch in chart.values()]) / 100
    srgb = colour.RGB_COLOURSPACES["sRGB"]
    found_xyz = found @ srgb.matrix_RGB_to_XYZ.T
    found_xyz *= expected[:, 1].sum() / found_xyz[:, 1].sum()
    difference = colour.delta_E(
        colour.XYZ_to_Lab(expected, srgb.whitepoint), colour.XYZ_to_Lab(found_xyz, srgb.whitepoint), method="CIE 2000"
    )
    assert difference.mean() < 1.08 and difference.max() < 3.5
    assert out.provenance["colour_matrix_mean_de00"] == pytest.approx(difference.mean(), abs=0.15)


def test_grey_is_neutral_through_the_whole_phone(level=300.0):
    """The mean of 120 x 120 noisy pixels of D65 grey: R = G = B to a 255th."""
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    even = Image(
        np.full((120, 120, 3), level, np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0}
    )
    means = camera.develop(graph, {"radiance": even}, seed=4)["srgb"].pixels.mean(axis=(0, 1), dtype=np.float64)
    assert 0.2 < means.mean() < 0.8
    assert np.ptp(means) < 1 / 255


# ---- levels


def test_levels_come_from_the_node_then_the_image_then_the_sensor():
    """What a node says goes before what the ADC noted, and that before the profile (64 and 1023)."""
    image = numbers([[100.0, 300.0]])
    noted = image.with_metadata(black_level_dn=100, white_level_dn=300)
    np.testing.assert_allclose(isp.black_level(image, sensor=SENSOR).pixels.ravel(), [36 / 959, 236 / 959], rtol=1e-6)
    np.testing.assert_array_equal(isp.black_level(noted, sensor=SENSOR).pixels.ravel(), [0.0, 1.0])
    np.testing.assert_allclose(
        isp.black_level(noted, black_level_dn=0.0, sensor=SENSOR).pixels.ravel(), [1 / 3, 1.0], rtol=1e-6
    )
    with pytest.raises(ImageError, match="does not say its black_level_dn"):
        isp.black_level(image)
    with pytest.raises(ImageError, match="300 is not below white_level_dn 300"):
        isp.black_level(noted, black_level_dn=300.0)


# ---- white balance


@pytest.mark.parametrize("light", LIGHTS)
def test_gains_are_those_of_colour_science(light):
    """Its white balance multipliers of the same curves, per watt on 5 nm; ours are per photon on 1 nm.

    1 %: lines of sodium and LED that 1 nm and 5 nm weigh differently.
    """
    with colour.utilities.suppress_warnings(colour_runtime_warnings=True):  # it says that it aligns its own tables
        expected = colour.characterisation.white_balance_multipliers(
            colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"].copy(), colour.SDS_ILLUMINANTS[LIGHTS[light]].copy()
        )
    gains = isp.white_balance(mosaic(np.ones((2, 2))), illuminant=light, sensor=SENSOR).provenance["wb_gains"]
    np.testing.assert_allclose(gains, expected, rtol=0.01)


@pytest.mark.parametrize("pattern", ["RGGB", "RCCB", "RGIB"])
def test_as_shot_makes_its_neutral_white_behind_every_pattern(pattern):
    """A surface that gives the neutral of the provenance, in odd sizes too: even everywhere, the strongest filter
    unchanged.
    """
    letters = cfa.filters(pattern)
    neutral = np.linspace(0.3, 1.0, len(letters))[::-1]
    planes = np.broadcast_to(0.5 * neutral, (5, 7, len(letters))).astype(np.float32)
    image = mosaic(raws.mosaic_of(planes, pattern)[..., 0], pattern=pattern, as_shot_neutral=neutral.tolist())
    out = isp.white_balance(image, illuminant="as_shot", sensor=SENSOR)
    np.testing.assert_allclose(out.pixels, 0.5, rtol=2e-7)
    with pytest.raises(ImageError, match="does not fit the filters"):
        isp.white_balance(image.with_metadata(as_shot_neutral=[1.0, 1.0]), illuminant="as_shot", sensor=SENSOR)


def test_saturated_pixels_are_white():
    """What fills every pixel comes out as (1, 1, 1), not tinted by the white balance."""
    image = isp.white_balance(mosaic(np.ones((4, 4))), sensor=SENSOR)
    np.testing.assert_array_equal(image.pixels, 1.0)
    assert isp.white_balance(mosaic(np.ones((4, 4))), sensor=SENSOR, clip=False).pixels.max() > 1.5


# ---- colour


def test_colour_correction_is_the_fitted_matrix_and_leaves_brightness_alone():
    pixels = seeds.stream(0, "colour").random((5, 7, 3), dtype=np.float32)
    out = isp.colour_correct(picture(pixels), illuminant="a", sensor=SENSOR)
    rows = np.array(out.provenance["colour_matrix"])
    np.testing.assert_allclose(out.pixels, np.einsum("ij,hwj->hwi", rows, pixels), atol=2e-6)
    np.testing.assert_allclose(rows.sum(axis=1), 1.0, atol=1e-9)
    assert out.channels == ("R", "G", "B") and 0.3 < out.provenance["colour_matrix_mean_de00"] < 2.0
    y = grey([0.1, 0.5])
    assert isp.colour_correct(y, sensor=SENSOR) is y
    with pytest.raises(ImageError, match="the picture has R, B, C; sensor imx363 has the filters R, G, B"):
        isp.colour_correct(replace(picture(pixels), channels=("R", "B", "C")), sensor=SENSOR)


# ---- tone


def test_gamma_is_that_of_srgb():
    """Against colour-science's own coding; float32 rounding of the power."""
    linear = np.linspace(-0.2, 1.5, 2001, dtype=np.float32)
    expected = colour.models.eotf_inverse_sRGB(np.clip(linear.astype(np.float64), 0, 1))
    for image in (picture(linear.reshape(1, -1, 1).repeat(3, axis=2)), grey(linear)):
        out = isp.gamma(image)
        np.testing.assert_allclose(out.pixels, np.broadcast_to(expected[None, :, None], out.pixels.shape), atol=3e-7)
        assert out.quantity is Quantity.DISPLAY_RGB and out.channels == image.channels


def test_the_curve_for_wide_ranges_is_the_logarithm_on_the_screen():
    """After the gamma, ln(1 + m Y) / ln(1 + m) in float64: doublings are even steps, 1 is white, and it never falls."""
    y = np.geomspace(1e-6, 1.0, 400)
    out = isp.gamma(isp.tone_hdr(grey(y), range_ev=12.0)).pixels.ravel()
    np.testing.assert_allclose(out, np.log1p(4096 * y) / np.log1p(4096), atol=1e-6)
    assert (np.diff(out) > 0).all()
    steps = np.diff(isp.gamma(isp.tone_hdr(grey([1 / 8, 1 / 4, 1 / 2, 1.0]), range_ev=12.0)).pixels.ravel())
    np.testing.assert_allclose(steps, 1 / 12, rtol=0.01)
    np.testing.assert_allclose(
        isp.tone_hdr(grey([7.0]), range_ev=12.0).pixels, 7.0, rtol=1e-6
    )  # above white it is for gamma to cut


# ---- lens shading


def test_lens_shading_undoes_the_falloff(tmp_path: Path):
    """An even scene, no noise: corners and middle agree where all of it is corrected, and do not where half is."""
    text = """\
synfog: graph/1
inputs: [radiance]
sensor: imx363
lens: pixel4a
nodes:
  - {op: optics.irradiance, falloff: cos4}
  - {op: sensor.expose, exposure_s: 0.001}
  - {op: sensor.gain, iso: 55, gain_dn_e: 10}
  - {op: sensor.adc, bits: 16, white_level_dn: 65535}
  - {op: isp.black_level}
  - {op: isp.lens_shading, strength: 1}
outputs: {a.exr: lens_shading}
"""
    (tmp_path / "g.yaml").write_text(text)
    graph = camera.load_graph(tmp_path / "g.yaml")
    even = Image(
        np.full((60, 80, 3), 1000.0, np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 80.0}
    )
    full = graph.run({"radiance": even}, seed=0)["lens_shading"].pixels[..., 0]
    half = graph.run({"radiance": even}, seed=0, overrides={"lens_shading.strength": 0.5})["lens_shading"].pixels[
        ..., 0
    ]
    assert full[0, 0] == pytest.approx(full[30, 40], rel=0.002)  # rounding to DN
    assert half[0, 0] < 0.7 * half[30, 40]


# ---- in a graph


def test_coring_makes_black_of_noise_and_leaves_light_alone():
    """Noise of 5 DN around black becomes 0 but for 1 pixel in a thousand; from half that on, light keeps every bit; so
    does a lamp of one pixel.
    """
    noise = seeds.stream(1, "coring").standard_normal((256, 256)).astype(np.float32) * 5
    metadata = {"black_level_dn": 64, "white_level_dn": 1023, "noise_profile": [0.0, (5 / 959) ** 2]}
    for level, kept in ((0.0, 1e-3), (4.0, 1.0)):
        raw = numbers(noise + 64 + level, **metadata)
        cored, whole = (isp.black_level(raw, coring=coring).pixels for coring in (4.0, 0.0))
        share = np.count_nonzero(cored == whole) / cored.size
        assert share == 1.0 if level else np.count_nonzero(cored) / cored.size <= kept
    raw.pixels[...] = 64.0
    raw.pixels[100, 100] = 64.0 + 30.0
    assert isp.black_level(raw).pixels[100, 100, 0] == pytest.approx(30 / 959)

"""Profiles: what ships loads, and faults are named with their place."""

from __future__ import annotations

import math

import numpy as np
import pytest

from synfog_usd.base import photometry, resources
from synfog_usd.base.errors import ParameterError
from synfog_usd.camera import response
from synfog_usd.camera.profiles import guessed, load_lens, load_sensor, shipped

IMX363 = (resources.folder("assets") / "sensors" / "imx363.yaml").read_text()


@pytest.mark.parametrize("name", shipped("sensors"))
def test_every_shipped_sensor_loads_with_a_source_for_each_value(name):
    sensor = load_sensor(name)
    assert sensor.name == name
    assert {key for key, _ in sensor.sources} >= {"qe", "full_well_e", "read_noise_e", "bits"} and all(
        len(text) > 5 for _, text in sensor.sources
    )


def test_the_phone_sensor_has_the_public_figures():
    """Gain from 76.5 uV/e- and 0.44875 mV/DN; the noise split adds up to 5 e-."""
    sensor = load_sensor("imx363")
    assert sensor.gain_dn_e == pytest.approx(76.5e-3 / 0.44875, rel=1e-3)
    assert math.hypot(sensor.read_noise_e, sensor.adc_noise_dn / sensor.gain_dn_e) == pytest.approx(5.0, rel=1e-3)
    assert sensor.saturation_e == pytest.approx(959 / 0.1705)


# (what is replaced; by what, ^ standing before the instance that is wrong; the message or its start)
FAULTS = [
    (
        "{value: 6000,   source: isetcam}",
        "{value: ^many, source: isetcam}",
        "full_well_e is 'many'; it takes a number from 100 to 1e+07",
    ),
    (
        "{value: 6000,   source: isetcam}",
        "^{value: 6000}",
        "full_well_e has no source; write {value: ..., source: ...}",
    ),
    ("full_well_e: ", "^ful_well_e: ", "a profile has no 'ful_well_e'; it takes synfog, name,"),
    (
        "camera: Nikon 5100 (NPL), peak: 0.6",
        "product: {sensor: {flat: 0.5}, filters: ^{R: {flat: 1}}}",
        "filters takes a curve for each of R, G, B",
    ),
    ("sensor/1", "^lens/1", "synfog is lens/1; this program reads 'sensor/1'"),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS, ids=[new[:40] for _, new, _ in FAULTS])
def test_a_fault_is_named_with_its_place(tmp_path, old, new, message):
    assert IMX363.count(old) == 1
    before, _, after = IMX363.replace(old, new).partition("^")
    path = tmp_path / "own.yaml"
    path.write_text(before + after)
    with pytest.raises(ParameterError) as caught:
        load_sensor("own.yaml", tmp_path)
    expected = f"{path}:{before.count(chr(10)) + 1}:{len(before.rpartition(chr(10))[2]) + 1}: {message}"
    assert expected in [line[: len(expected)] for line in str(caught.value).splitlines()]


def test_own_curves_are_read_and_interpolated(tmp_path):
    (tmp_path / "own.yaml").write_text(IMX363.replace("camera: Nikon 5100 (NPL), peak: 0.6", "csv: qe.csv"))
    (tmp_path / "qe.csv").write_text("wavelength_nm,R,G,B\n# a comment\n500,0.1,0.4,0.2\n600,0.5,0.2,0.0\n")
    qe = response.quantum_efficiency(load_sensor("own.yaml", tmp_path))
    at_550 = qe[:, 550 - 380]
    np.testing.assert_allclose(at_550, [0.3, 0.3, 0.1], rtol=1e-12)
    assert qe[:, 499 - 380].max() == 0.0 == qe[:, 601 - 380].max()


def test_a_product_is_sensor_times_infra_red_cut_times_filter(tmp_path):
    """At three wavelengths, by hand: a Gaussian halves at half its width, an edge is at 10 %, 50 % and 90 % over its
    width.
    """
    product = (
        "{sensor: {csv: silicon.csv}, ir_filter: {short_pass: [650, 40]}, filters: {R: {long_pass: [600, 50]}, G: "
        "{gaussian: [550, 100, 0.8]}, B: {flat: 0.5}}}"
    )
    (tmp_path / "own.yaml").write_text(IMX363.replace("camera: Nikon 5100 (NPL), peak: 0.6", f"product: {product}"))
    (tmp_path / "silicon.csv").write_text("400,0.6\n700,0.3\n")
    qe = response.quantum_efficiency(load_sensor("own.yaml", tmp_path))
    cut = {500: 1.0 / (1.0 + 9.0**-7.5), 600: 1.0 / (1.0 + 9.0**-2.5), 650: 0.5, 670: 0.1}
    np.testing.assert_allclose(qe[:, 500 - 380], 0.5 * cut[500] * np.array([1 / (1 + 9.0**4), 0.4, 0.5]), rtol=1e-9)
    np.testing.assert_allclose(qe[:, 600 - 380], 0.4 * cut[600] * np.array([0.5, 0.4, 0.5]), rtol=1e-9)
    np.testing.assert_allclose(qe[2, 650 - 380], 0.35 * cut[650] * 0.5, rtol=1e-9)
    np.testing.assert_allclose(qe[2, 670 - 380], 0.33 * cut[670] * 0.5, rtol=1e-9)
    assert qe[:, 399 - 380].max() == 0.0 == qe[:, 701 - 380].max()


def test_the_ideal_sensor_sees_the_colours_of_the_observer(light="D65"):
    """Its filters are the observer's functions, so a matrix makes every colour right, under every light; its RAW matrix
    is diagonal.
    """
    chip = load_sensor("ideal")
    assert response.colour_matrix(chip, light).max_de00 < 0.01
    matrix = response.xyz_to_camera(chip, light)
    np.testing.assert_allclose(
        matrix / np.abs(matrix).max(), np.diag(np.diag(matrix)) / np.abs(matrix).max(), atol=2e-3
    )


def test_lights_have_the_colours_that_the_cie_gives_them():
    """Chromaticities x, y of CIE 015:2018, tables 5 and 10.2; four digits, 5 nm tables."""
    for name, xy in {
        "D65": (0.3127, 0.3290),
        "A": (0.4476, 0.4075),
        "HPS": (0.533, 0.415),
        "LED": (0.3756, 0.3723),
    }.items():
        xyz = photometry.observer() @ photometry.illuminant(name)
        np.testing.assert_allclose(xyz[:2] / xyz.sum(), xy, atol=1e-3)
    with pytest.raises(ParameterError, match=r"illuminant 'HP' is not known; it can be D65, A, HPS, LED"):
        photometry.illuminant("HP")


@pytest.mark.parametrize("name", sorted(set(shipped("sensors")) - {"ideal"}))
def test_the_noise_of_a_shipped_sensor_can_be_measured(name):
    """EMVA 1288: at base gain at least half a DN of dark noise, or rounding hides it, and six of it below the black
    level, or it is cut.
    """
    chip = load_sensor(name)
    dark_dn = math.hypot(chip.read_noise_e * chip.gain_dn_e, chip.adc_noise_dn)
    assert dark_dn >= 0.5 and chip.black_level_dn >= 6 * dark_dn


def test_the_monochrome_sensor_has_the_responsivity_and_range_of_its_data_sheet():
    """4.8 V/(lux s) at 550 nm through 110 uV/e-; 55 dB between the well and the noise in the dark."""
    chip = load_sensor("mt9v024")
    photons_per_lux_s = 36e-12 / (683.0 * 0.995) / (6.62607015e-34 * 299792458.0 / 550e-9)
    qe = response.quantum_efficiency(chip)[0, 550 - 380] * chip.fill_factor
    assert photons_per_lux_s * qe * 110e-6 == pytest.approx(4.8, rel=0.01)
    dark_e = math.hypot(chip.read_noise_e, chip.adc_noise_dn / chip.gain_dn_e)
    assert 20 * math.log10(chip.full_well_e / dark_e) == pytest.approx(55.0, abs=0.05)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("500,0.1,0.4\n", r"qe\.csv:1: '500,0.1,0.4' is not wavelength_nm, R, G, B"),
        ("500,0.1,0.4,0.2\n400,0.1,0.4,0.2\n", r"qe\.csv:2: wavelength 400 nm .* does not rise"),
        ("500,0.1,0.4,1.2\n", r"qe\.csv:1: a quantum efficiency is outside 0 to 1"),
        ("500,0.1,nan,0.2\n", r"qe\.csv:1: a quantum efficiency is outside 0 to 1"),
    ],
)
def test_faulty_curves_are_refused_with_their_line(tmp_path, text, message):
    (tmp_path / "own.yaml").write_text(IMX363.replace("camera: Nikon 5100 (NPL), peak: 0.6", "csv: qe.csv"))
    (tmp_path / "qe.csv").write_text(text)
    with pytest.raises(ParameterError, match=message):
        load_sensor("own.yaml", tmp_path)


def test_the_content_hash_follows_the_values_only(tmp_path):
    first = load_sensor("imx363").content_hash
    for text, same in [
        (IMX363.replace("title: Sony", "title: The Sony"), True),
        (IMX363.replace("value: 6000", "value: 6001"), False),
        (IMX363.replace("0.6,", "0.61,"), False),
    ]:
        (tmp_path / "own.yaml").write_text(text)
        assert (load_sensor("own.yaml", tmp_path).content_hash == first) is same


def test_a_profile_that_is_mostly_estimates_says_so():
    """By the first word of each value's source: the Mi 10 Pro's sensor and lens, and not the Pixel's, whose figures
    were published but for a few; the ideal ones guess nothing.
    """
    chip = guessed(load_sensor("mi10pro"))
    assert chip.startswith("mi10pro: 15 of its 21 values are estimates: ") and "full_well_e" in chip and "qe" in chip
    assert "pixel_pitch_um" not in chip
    assert guessed(load_lens("mi10pro")) == (
        "mi10pro: 3 of its 4 values are estimates: focal_length_mm, transmission, glare_fraction"
    )
    for name, load in (("imx363", load_sensor), ("pixel4a", load_lens), ("ideal", load_sensor), ("ideal", load_lens)):
        assert guessed(load(name)) == "", name

"""Profiles: what ships loads, and faults are named with their place."""

from __future__ import annotations

import math

import numpy as np
import pytest

from synfog_usd import resources
from synfog_usd.camera import response
from synfog_usd.camera.profiles import load_lens, load_sensor, shipped
from synfog_usd.errors import ParameterError

IMX363 = (resources.folder("assets") / "sensors" / "imx363.yaml").read_text()


@pytest.mark.parametrize("name", shipped("sensors"))
def test_every_shipped_sensor_loads_with_a_source_for_each_value(name):
    sensor = load_sensor(name)
    assert sensor.name == name
    assert {key for key, _ in sensor.sources} >= {"qe", "full_well_e", "read_noise_e", "bits"} and all(len(text) > 5 for _, text in sensor.sources)


@pytest.mark.parametrize("name", shipped("lenses"))
def test_every_shipped_lens_loads(name):
    assert load_lens(name).name == name


def test_the_phone_sensor_has_the_public_figures():
    """Gain from 76.5 uV/e- and 0.44875 mV/DN; the noise split adds up to 5 e-."""
    sensor = load_sensor("imx363")
    assert sensor.gain_dn_e == pytest.approx(76.5e-3 / 0.44875, rel=1e-3)
    assert math.hypot(sensor.read_noise_e, sensor.adc_noise_dn / sensor.gain_dn_e) == pytest.approx(5.0, rel=1e-3)
    assert sensor.saturation_e == pytest.approx(959 / 0.1705)


# (what is replaced; by what, ^ standing before the thing that is wrong; the message or its start)
FAULTS = [
    ("{value: 6000,   source: isetcam}", "{value: ^many, source: isetcam}", "full_well_e is 'many'; it takes a number from 100 to 1e+07"),
    ("{value: 6000,   source: isetcam}", "{value: ^-5, source: isetcam}", "full_well_e is -5; it takes"),
    ("{value: 6000,   source: isetcam}", "{value: ^.nan, source: isetcam}", "full_well_e is nan; it takes"),
    ("{value: 6000,   source: isetcam}", "^6000", "full_well_e is 6000; it takes {value: ..., source: ...}"),
    ("{value: 6000,   source: isetcam}", "^{value: 6000}", "full_well_e has no source; write {value: ..., source: ...}"),
    (
        "{value: 6000,   source: isetcam}",
        "{value: 6000, source: ^isetcm}",
        "full_well_e has source 'isetcm', which is not under 'sources' "
        "(isetcam, isetcam_gain, noise_split, borrowed_qe, estimate_dark, phone_program). Did you mean 'isetcam'?",
    ),
    ("{value: 10,     source: isetcam}", "{value: ^10.5, source: isetcam}", "bits is 10.5; it takes a whole number from 8 to 16"),
    ("full_well_e: ", "^ful_well_e: ", "a profile has no 'ful_well_e'; it takes synfog, name,"),
    ("{value: 64,     source: isetcam}", "^{value: 1023, source: isetcam}", "black_level_dn 1023 is not below white_level_dn 1023"),
    ("{value: 1023,   source: isetcam}", "^{value: 1024, source: isetcam}", "white_level_dn 1024 is above 1023, the most of 10 bits"),
    (
        "camera: Nikon 5100 (NPL)",
        "camera: ^Nikon 5200",
        "camera 'Nikon 5200' is not known; it can be Nikon 5100 (NPL), Sigma SDMerill (NPL). Did you mean 'Nikon 5100 (NPL)'?",
    ),
    ("peak: 0.6", "peak: ^1.6", "peak is 1.6; it takes a number from 0.01 to 1"),
    ("sensor/1", "^lens/1", "synfog is lens/1; this program reads 'sensor/1'"),
    ("serial: imx363-0001", "serial: ^[1]", "serial is [1]; it takes a text"),
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
    assert str(caught.value)[: len(expected)] == expected


def test_a_value_that_is_missing_is_named(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text("\n".join(line for line in IMX363.splitlines() if not line.startswith("prnu")))
    with pytest.raises(ParameterError, match="the profile has no 'prnu_percent'"):
        load_sensor("own.yaml", tmp_path)


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(ParameterError, match=r"no such profile; there are ar0132at, imx363, .* Did you mean 'imx363'\?"):
        load_sensor("imx364")


def test_own_curves_are_read_and_interpolated(tmp_path):
    (tmp_path / "own.yaml").write_text(IMX363.replace("camera: Nikon 5100 (NPL), peak: 0.6", "csv: qe.csv"))
    (tmp_path / "qe.csv").write_text("wavelength_nm,R,G,B\n# a comment\n500,0.1,0.4,0.2\n600,0.5,0.2,0.0\n")
    qe = response.quantum_efficiency(load_sensor("own.yaml", tmp_path))
    at_550 = qe[:, 550 - 380]
    np.testing.assert_allclose(at_550, [0.3, 0.3, 0.1], rtol=1e-12)
    assert qe[:, 499 - 380].max() == 0.0 == qe[:, 601 - 380].max()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("500,0.1,0.4\n", r"qe\.csv:1: '500,0.1,0.4' is not wavelength_nm, R, G, B"),
        ("500,0.1,0.4,0.2\n400,0.1,0.4,0.2\n", r"qe\.csv:2: wavelength 400 nm .* does not rise"),
        ("500,0.1,0.4,1.2\n", r"qe\.csv:1: a quantum efficiency is outside 0 to 1"),
        ("500,0.1,nan,0.2\n", r"qe\.csv:1: a quantum efficiency is outside 0 to 1"),
        ("500,0.1,0.4,0.2\n", r"1 rows; a curve needs two or more"),
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

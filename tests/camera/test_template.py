"""Profiles to be filled in: they load as they are printed, and so do their forms that are commented out."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys

import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.camera.profiles import (
    LensProfile,
    SensorProfile,
    guessed,
    limits_of,
    load_lens,
    load_sensor,
)
from synfog_usd.camera.template import lens_template, meanings, sensor_template

KINDS = {
    "sensor": (sensor_template, load_sensor, SensorProfile, "imx363"),
    "lens": (lens_template, load_lens, LensProfile, "pixel4a"),
}


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


def loaded(kind, text, folder):
    (folder / "mine.yaml").write_text(text)
    return KINDS[kind][1]("mine.yaml", folder)


def test_a_printed_profile_loads_and_is_known_for_an_example(kind, tmp_path):
    """It has every number under a comment that tells its limits, the values of the Pixel's, and no other source."""
    write, load, record, named = KINDS[kind]
    profile, phone = loaded(kind, write(), tmp_path), load(named)
    for key, limits in limits_of(record).items():
        assert getattr(profile, key) == getattr(phone, key)
        (comment,) = re.findall(rf"^# ([A-Z][^\n]*(?:\n# [^\n]*)*)\n{key}: \{{value: ", write(), flags=re.MULTILINE)
        assert f"{limits.low:g} to {limits.high:g}" in comment.replace("\n# ", " ")
    told = len(limits_of(record)) + (kind == "sensor")
    assert guessed(profile).startswith(f"mine: {told} of its {told} values are estimates: ")


def test_every_attribute_has_a_meaning(kind):
    """The record's docstring tells of each field, in words of its own for each."""
    record = KINDS[kind][2]
    told = meanings(record)
    assert {field.name for field in dataclasses.fields(record)} <= set(told)
    assert all(told.values())


def test_each_form_that_is_commented_out_can_be_put_in(kind, tmp_path):
    """One at a time: the forms of a quantum efficiency, the tables of a lens."""
    text = KINDS[kind][0]()
    forms = re.findall(r"^# (\w+):((?: [\[{].*)?\n(?:#   .*\n)*)", text, flags=re.MULTILINE)
    wanted = (
        ["qe"] * 3
        if kind == "sensor"
        else [*("distortion", "fisheye", "relative_illumination", "aberrations", "wavefront", "drawing")]
    )
    assert [key for key, _ in forms] == wanted
    (tmp_path / "qe.csv").write_text("wavelength_nm,R,G,B\n400,0.1,0.2,0.3\n700,0.2,0.2,0.1\n")
    (tmp_path / "silicon.csv").write_text("wavelength_nm,value\n400,0.4\n700,0.6\n")
    plain = loaded(kind, text, tmp_path)
    for key, rest in forms:
        form = f"{key}:{rest}".replace("\n#", "\n")
        other = re.sub(rf"^{key}: .*\n", "", text, flags=re.MULTILINE).replace("sources:\n", f"{form}\nsources:\n")
        if key == "fisheye":
            other = other.replace("fisheye_fov_x_deg: {value: 0,", "fisheye_fov_x_deg: {value: 150,")
        if key == "drawing":  # a lens of BK7 with one bent face of 4.52 mm: f = R / (n - 1) = 8.75 mm
            other = other.replace("focal_length_mm: {value: 4.38,", "focal_length_mm: {value: 8.75,")
        assert loaded(kind, other, tmp_path).content_hash != plain.content_hash, key


def test_all_that_is_missing_is_told_at_once(kind, tmp_path):
    """A file with its first line alone lacks every key that has no default, in one line."""
    record = KINDS[kind][2]
    with pytest.raises(ParameterError) as caught:
        loaded(kind, f"synfog: {kind}/1\n", tmp_path)
    (line,) = str(caught.value).splitlines()
    needed = {key for key, limits in limits_of(record).items() if limits.default is None}
    needed |= {"name", "title", "sources", *(("serial", "cfa", "qe") if kind == "sensor" else ())}
    told = re.findall(r"'(\w+)'", line.partition("; ")[0])
    assert line.startswith(f"{tmp_path / 'mine.yaml'}:1:1: the profile has no ")
    assert len(told) == len(set(told)) and set(told) == needed
    assert line.endswith(f"'synfog-usd graph profile {kind}' prints one that has all")


def test_all_that_is_wrong_is_told_at_once_in_the_order_of_the_file(tmp_path):
    """Seven faults of different kinds, with two keys missing: eight lines behind the one that counts them."""
    text = sensor_template()
    for old, new in (
        ("title: My sensor", "title: 3"),
        ("full_well_e: {value: 6000, source: example}", "full_well_e: 6000"),
        ("read_noise_e: {value: 2.5, source: example}", "read_noise_e: {value: -1, source: example}"),
        ("adc_noise_dn: {value: 0.738, source: example}", "adc_noise_dn: {value: 0.7, source: lab}"),
        ("dsnu_e: {value: 0.5, source: example}", "dsnu_e: {value: 0.5}"),
        ("bits: {value: 10, source: example}", "bit: {value: 10, source: example}"),
        ("iso_max: {value: 7040, source: example}", "iso_max: {value: 50, source: example}"),
        ("prnu_percent: {value: 0.7, source: example}\n", ""),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    with pytest.raises(ParameterError) as caught:
        loaded("sensor", text, tmp_path)
    path = tmp_path / "mine.yaml"
    first, *lines = str(caught.value).splitlines()
    assert first == f"{path}: 8 errors"
    words = (
        "no 'prnu_percent', 'bits';",
        "title is 3; it takes a text",
        "full_well_e is 6000; it takes {value: ..., source: ...}",
        "read_noise_e is -1; it takes a number from 0 to 1000",
        "adc_noise_dn has source 'lab', which is not under 'sources' (example)",
        "dsnu_e has no source",
        "a profile has no 'bit'; it takes",
        "iso_base 55 is not below iso_max 50",
    )
    assert len(lines) == len(words)
    for line, word in zip(lines, words, strict=True):
        assert word in line
        number = int(line.removeprefix(f"{path}:").split(":")[0])
        assert number == 4 or text.splitlines()[number - 1].split(":")[0] in line


def test_the_command_prints_them(kind):
    done = subprocess.run(
        [sys.executable, "-m", "synfog_usd.cli.main", "graph", "profile", kind],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, KINDS[kind][0]())


def test_each_wrong_curve_is_told(tmp_path):
    """Of a sensor times filters, two filters and the silicon are wrong, each in its own way."""
    form = (
        "qe: {product: {sensor: {flut: 0.5}, filters: {R: {flat: 2}, G: {flat: 0.5}, B: {gaussian: [455, 80]}}}, "
        "source: example}"
    )
    with pytest.raises(ParameterError) as caught:
        loaded("sensor", re.sub(r"^qe: .*$", form, sensor_template(), flags=re.MULTILINE), tmp_path)
    first, *lines = str(caught.value).splitlines()
    assert first.endswith("mine.yaml: 3 errors")
    words = ("sensor is {'flut': 0.5}; it takes", "flat of R is 2; it takes", "B has 2 numbers for gaussian")
    assert all(word in line for word, line in zip(words, lines, strict=True))

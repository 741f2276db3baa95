"""Profiles to be filled in: they load as they are printed, and so do their forms that are commented out."""

from __future__ import annotations

import re

import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.camera.profiles import LensProfile, SensorProfile, guessed, limits_of, load_lens, load_sensor
from synfog_usd.camera.template import lens_template, sensor_template

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


def test_each_form_that_is_commented_out_can_be_put_in(kind, tmp_path):
    """One at a time: the forms of a quantum efficiency, the tables of a lens."""
    text = KINDS[kind][0]()
    forms = re.findall(r"^# (\w+):((?: [\[{].*)?\n(?:#   .*\n)*)", text, flags=re.MULTILINE)
    wanted = (
        ["qe"] * 3
        if kind == "sensor"
        else [*("distortion", "fisheye", "relative_illumination", "aberrations", "drawing")]
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

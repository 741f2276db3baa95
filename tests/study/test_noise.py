"""Noise against fog: known noise comes out, and a small bake gives tables, curves and a drawing."""

import json

import numpy as np
import pytest
from support import cli

from docs.studies.noise import (
    NUMBERS,
    immerkaer,
    study,
)
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.seeds import stream
from synfog_usd.camera.writers import write_exr

SIZE = (96, 128)


def bake(folder, size=SIZE):
    """Textured ground under a bright sky; fog of a transmittance of 0.4 in the lower half, 0.2 in the upper one."""
    noise = stream(0, "ground").random((*size, 1))
    clear = np.repeat(40.0 + 300.0 * noise, 3, axis=2)
    t = np.where(np.arange(size[0]) < size[0] // 2, 0.2, 0.4)[:, None, None]
    for fog, pixels in (("clear", clear), ("mor100", clear * t + 400.0 * (1.0 - t))):
        image = Image(pixels.astype(np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})
        write_exr(folder / "sky" / fog / "radiance.exr", image)
    target = {"sensor": {"electrons_per_cd_m2": 1.0, "dark_noise_e": 1.0}}
    shots = [
        {"lighting": "sky", "fog": fog, "mor_m": mor, "folder": f"sky/{fog}", "target": target}
        for fog, mor in (("clear", None), ("mor100", 100.0))
    ]
    (folder / "bake.json").write_text(json.dumps({"shots": shots}), encoding="utf-8")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bake")
    bake(folder)
    return study(folder, cameras=["synfog"])


def test_immerkaers_estimate_is_that_of_normal_noise_on_a_plane(sigma=1.0):
    """Three channels of 128 x 96 independent numbers on a slope: the mean of |N * I| over 3 x 11 844 places has a
    relative error of sqrt(pi / 2 - 1) / sqrt(n), times about 2.5 for the 25 places that share numbers; five of it.
    """
    x, y = np.meshgrid(np.linspace(0.2, 0.6, SIZE[1]), np.linspace(0.0, 0.2, SIZE[0]))
    picture = (x + y)[..., None] + sigma / 255.0 * stream(0, "immerkaer", sigma).standard_normal((*SIZE, 3))
    limit = 5 * 2.5 * np.sqrt(np.pi / 2 - 1) / np.sqrt(3 * (SIZE[0] - 2) * (SIZE[1] - 2))
    assert immerkaer(picture) == pytest.approx(sigma, rel=limit)


def test_raw_noise_is_that_of_photons_and_read_out(found):
    """8 frames of 12 288 pixels: a variance over all of them is known to sqrt(2 / 86 000), 0.5 %; five of it, and 1 %
    for the full well and rounding.  RAW pixels know nothing of each other, those of the picture do.
    """
    assert [row.fog for row in found.rows] == ["clear", "mor100"]
    for row in found.rows:
        assert row.raw_ratio == pytest.approx(1.0, abs=0.035)
        assert abs(row.neighbours_raw) < 0.03 and row.neighbours > 0.2


def test_defogging_lets_noise_grow_by_about_one_over_t(found):
    """t is found anew in each noisy frame, so 1 / t of the mean frame is not met to better than a third."""
    foggy = found.rows[1]
    assert foggy.expected > 1.2
    assert foggy.growth == pytest.approx(foggy.expected, rel=0.35)
    assert foggy.shown > foggy.shown_quiet


def test_the_command_writes_tables_and_a_drawing(tmp_path):
    bake(tmp_path / "bake")
    done = cli.study("noise", tmp_path / "bake", "-o", tmp_path / "out", "--cameras", "synfog")
    assert done.returncode == 0, done.stderr
    assert "**synfog.** RAW: variance within" in done.stdout
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "findings.md",
        "noise.csv",
        "transfer.csv",
        "noise.png",
    }
    head, *rows = (tmp_path / "out" / "noise.csv").read_text().splitlines()
    assert head == f"camera,shot,lighting,fog,{','.join(NUMBERS)}" and len(rows) == 2


def test_a_camera_without_raw_is_refused(tmp_path, cameras=("linear_exr",), told="needs a node of sensor.adc"):
    bake(tmp_path)
    with pytest.raises(Exception, match=told) as found:
        study(tmp_path, cameras=cameras)
    assert "\n" not in str(found.value)


def test_what_is_no_source_is_one_line(tmp_path):
    with pytest.raises(ParameterError, match="neither a set"):
        study(tmp_path)
    with pytest.raises(ParameterError, match="no such folder"):
        study(tmp_path / "none")
    (tmp_path / "set.json").write_text("{}", encoding="utf-8")
    with pytest.raises(ParameterError, match=r"this set is not finished .*; synfog-usd dataset retry .* goes on"):
        study(tmp_path)

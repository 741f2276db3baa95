"""Noise against fog: known noise comes out, and a small bake gives tables, curves and a drawing."""

import json
from pathlib import Path

import numpy as np
import pytest
from support import cli

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.seeds import stream
from synfog_usd.camera.writers import write_exr
from synfog_usd.lab.study.noise import (
    NUMBERS,
    BinnedMeans,
    NoiseStudy,
    ShotNoise,
    change,
    immerkaer,
    over_scenes,
    study,
    transfer_curve,
)

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


@pytest.mark.parametrize("sigma", [1.0, 8.0])
def test_immerkaers_estimate_is_that_of_normal_noise_on_a_plane(sigma):
    """Three channels of 128 x 96 independent numbers on a slope: the mean of |N * I| over 3 x 11 844 places has a
    relative error of sqrt(pi / 2 - 1) / sqrt(n), times about 2.5 for the 25 places that share numbers; five of it.
    """
    x, y = np.meshgrid(np.linspace(0.2, 0.6, SIZE[1]), np.linspace(0.0, 0.2, SIZE[0]))
    picture = (x + y)[..., None] + sigma / 255.0 * stream(0, "immerkaer", sigma).standard_normal((*SIZE, 3))
    limit = 5 * 2.5 * np.sqrt(np.pi / 2 - 1) / np.sqrt(3 * (SIZE[0] - 2) * (SIZE[1] - 2))
    assert immerkaer(picture) == pytest.approx(sigma, rel=limit)


def test_a_curve_holds_means_of_its_bins():
    curve = BinnedMeans(3)
    curve.add(np.array([0, 0, 2, -1, 3]), np.array([1.0, 3.0, 5.0, 9.0, 9.0]), np.array([2.0, 4.0, 6.0, 9.0, 9.0]))
    x, y = curve.means(fewest=1)
    np.testing.assert_allclose(x, [2.0, 5.0])
    np.testing.assert_allclose(y, [3.0, 6.0])
    assert len(curve.means(fewest=2)[0]) == 1


def scenes_of_ratio(ratio, scenes=40, pixels=2000):
    """Sums of the measured and the closed variance of scenes whose signals, sizes and own ratios differ."""
    rng = stream(0, "scenes", ratio)
    found = []
    for _ in range(scenes):
        signal = rng.uniform(1.0, 9.0, int(pixels * rng.uniform(0.5, 1.5)))
        sums = BinnedMeans(1), BinnedMeans(1)
        measured = signal * ratio * rng.normal(1.0, 0.05) * rng.chisquare(7, signal.size) / 7
        for one, variance in zip(sums, (measured, signal), strict=True):
            one.add(np.zeros(signal.size, dtype=int), signal, variance)
        found.append(sums)
    return found


@pytest.mark.parametrize("ratio", [1.0, 1.2])
def test_the_interval_of_a_ratio_is_that_of_its_linear_form(ratio):
    """Of R = sum y / sum x over S scenes: R +- 1.96 sqrt(S / (S - 1) sum (y - R x)^2) / sum x (Cochran 1977, 6.3).

    Ends of 2000 draws differ by chance by about 0.05 of a standard error, those of 40 scenes from a normal law's by
    as much again; 0.3 of it, and a bootstrap that drew pixels would be a tenth as wide.
    """
    sums = scenes_of_ratio(ratio)
    curve = transfer_curve(sums)
    y, x = (np.array([one[which].y[0] for one in sums]) for which in (0, 1))
    whole = y.sum() / x.sum()
    sigma = np.sqrt(len(sums) / (len(sums) - 1) * ((y - whole * x) ** 2).sum()) / x.sum()
    assert curve.ratio[0] == pytest.approx(whole, rel=1e-12)
    np.testing.assert_allclose([curve.low[0], curve.high[0]], whole + np.array([-1.96, 1.96]) * sigma, atol=0.3 * sigma)
    assert (curve.low[0] <= 1.0 <= curve.high[0]) == (ratio == 1.0)


def test_two_scenes_have_no_interval():
    curve = transfer_curve(scenes_of_ratio(1.0)[:2])
    assert np.isnan(curve.low).all() and np.isnan(curve.high).all() and curve.signal.size == 1


def shot(scene, fog, picture):
    """A row of which only the picture's noise is of interest."""
    numbers = dict.fromkeys(NUMBERS, float("nan")) | {"picture": picture}
    return ShotNoise("synfog", f"{scene}/{fog}", "sky", fog, scene, f"{scene}/clear", **numbers)


def test_what_fog_changes_is_told_view_by_view():
    """Twice the noise in every scene, though scenes differ tenfold: known exactly, where means over shots overlap."""
    fogs = {"clear": 1.0, "thick": 2.0}
    rows = [shot(str(scene), fog, 10.0**scene * times) for scene in range(4) for fog, times in fogs.items()]
    study_of = NoiseStudy(tuple(rows), {"synfog": ()}, {}, tuple(fogs), ())
    found = change(study_of, "synfog", "thick", "picture")
    assert (found.value, found.low, found.high) == pytest.approx((2.0, 2.0, 2.0)) and found.scenes == 4
    means = [over_scenes([row for row in rows if row.fog == fog], lambda row: row.picture) for fog in study_of.fogs]
    assert means[0].high > means[1].low
    assert np.isnan(change(study_of, "synfog", "thick", "defogged").value)


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
    done = cli.run("study", "noise", tmp_path / "bake", "-o", tmp_path / "out", "--cameras", "synfog")
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


@pytest.mark.parametrize(
    ("cameras", "told"), [(["linear_exr"], "needs a node of sensor.adc"), (["none_such"], "none_such")]
)
def test_a_camera_without_raw_is_refused(tmp_path, cameras, told):
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


def test_pictures_without_enough_pixels_are_one_line(tmp_path):
    """Two shots of 14 x 24 pixels have 672, in several bins of 500; with 40 x 60 a bin is full."""
    bake(tmp_path / "small", size=(14, 24))
    done = cli.run("study", "noise", tmp_path / "small", "-o", tmp_path / "out", "--cameras", "synfog")
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "its pictures are too small" in done.stderr and "--resolution 320x180" in done.stderr
    bake(tmp_path / "large", size=(40, 60))
    done = cli.run("study", "noise", tmp_path / "large", "-o", tmp_path / "out", "--cameras", "synfog")
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder in which nobody can write")
def test_a_folder_that_cannot_be_written_is_told_before_the_work(tmp_path):
    bake(tmp_path)
    done = cli.run("study", "noise", tmp_path, "-o", "/proc/out")
    assert done.returncode == 2 and "/proc cannot be written" in done.stderr and done.stderr.count("\n") == 1

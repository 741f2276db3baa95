"""High dynamic range: merged readings are linear, their noise is that of theory, and companding can be undone."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from support import cli

from synfog_usd import camera
from synfog_usd.base import resources, seeds
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import hdr, isp, sensor
from synfog_usd.camera.profiles import load_sensor
from synfog_usd.camera.writers import read_exr

CHIP = load_sensor("imx490_like")
HIGH, LOW = 1.0, 0.25
SIGMAS = 4.5
"""A right sensor misses by more than this in 7 of a million draws."""


def electrons(level, shape=(500, 500), gathered_um2_s=1.0) -> Image:
    pixels = np.broadcast_to(np.asarray(level, np.float32), shape)[..., None].copy()
    return Image(
        pixels,
        ("CFA",),
        Quantity.ELECTRONS,
        provenance={"exposure_s": 0.01, "gathered_um2_s": gathered_um2_s, "cfa_pattern": "RGGB"},
    )


def reading(counted: Image, factor: float, *, sigma_e=0.0, sigma_dn=0.0, seed=0) -> Image:
    image = sensor.read_noise(counted, rng=seeds.stream(seed, "read", str(factor)), sigma_e=sigma_e)
    image = sensor.gain(image, iso=100.0, iso_base=100.0, gain_dn_e=CHIP.gain_dn_e, factor=factor)
    image = sensor.adc_noise(image, rng=seeds.stream(seed, "adc", str(factor)), sigma_dn=sigma_dn)
    return sensor.adc(image, bits=12, black_level_dn=168, white_level_dn=4095, sensor=CHIP)


def variance_e2(frames: list[np.ndarray]) -> float:
    """Temporal variance of a pixel [e-^2], from two frames of the same light."""
    return float(np.var(frames[0] - frames[1], dtype=np.float64) / 2 / CHIP.gain_dn_e**2)


@pytest.mark.parametrize("level_e", [500.0, 15_000.0])
def test_two_conversion_gains_count_the_same_electrons_and_jump_only_in_read_noise(level_e):
    """variance = mu + s^2 + (s_adc^2 + 1/12) / K^2 of the reading that counts; shot noise knows no gain.

    A tall read noise of the low gain, 60 e-, makes the jump 2.6 times the noise there.
    The variance of a sample variance over N is 2 v^2 / N.
    """
    frames = []
    for frame in (1, 2):
        counted = sensor.shot_noise(electrons(level_e), rng=seeds.stream(frame, "shot", str(level_e)))
        readings = [
            reading(counted, HIGH, sigma_e=1.0, sigma_dn=0.5, seed=frame),
            reading(counted, LOW, sigma_e=60.0, sigma_dn=0.5, seed=frame + 10),
        ]
        frames.append(hdr.merge_hdr(*readings).pixels.astype(np.float64))
    high = level_e < 0.85 * 3927.0 / CHIP.gain_dn_e
    gain, sigma_e = (CHIP.gain_dn_e, 1.0) if high else (CHIP.gain_dn_e * LOW, 60.0)
    expected = level_e + sigma_e**2 + (0.25 + 1 / 12) / gain**2
    found = variance_e2(frames)
    assert found == pytest.approx(expected, rel=SIGMAS * math.sqrt(2 / frames[0].size))
    mean_e = (frames[0].mean() - 168.0) / CHIP.gain_dn_e
    assert mean_e == pytest.approx(level_e, abs=SIGMAS * math.sqrt(expected / frames[0].size) + 0.002 * level_e)


def test_readings_that_do_not_belong_together_are_refused():
    image = reading(electrons(10.0, (4, 4)), HIGH)
    with pytest.raises(ImageError, match="nothing to be merged with"):
        hdr.merge_hdr(image)
    with pytest.raises(ImageError, match=r"4 x 4 pixels behind RGGB and 6 x 4 pixels behind RGGB cannot be merged"):
        hdr.merge_hdr(image, reading(electrons(10.0, (4, 6)), LOW))
    with pytest.raises(ImageError, match="not above the one before"):
        hdr.merge_hdr(image, image)


def linear(values) -> Image:
    pixels = np.asarray(values, np.float32)[None, :, None]
    return Image(
        pixels,
        ("CFA",),
        Quantity.DN,
        provenance={"black_level_dn": 168, "white_level_dn": 57_700, "cfa_pattern": "RGGB"},
    )


KNEES = {"linear_dn": (1024.0, 4096.0, 16_384.0), "code_dn": (1024.0, 1792.0, 2560.0)}


def test_companding_is_undone_but_for_half_a_step():
    """Every number of 16 bits, those below black too: back to within half the DN that a code stands for, rounded."""
    values = np.arange(57_701)
    coded = hdr.compand(linear(values), bits=12, **KNEES)
    metadata = coded.provenance
    assert (
        metadata["black_level_dn"],
        metadata["white_level_dn"],
        metadata["linear_black_dn"],
        metadata["linear_white_dn"],
    ) == (168, 4095, 168, 57_700)
    assert metadata["companding"][0] == [168, 168] and metadata["companding"][-1] == [57_700.0, 4095.0]
    assert (
        (coded.pixels == np.rint(coded.pixels)).all()
        and (np.diff(coded.pixels[0, :, 0]) >= 0).all()
        and coded.pixels.max() == 4095
    )
    back = isp.decompand(coded)
    step = np.select(
        [values <= 1024, values <= 4096, values <= 16_384], [1.0, 4.0, 16.0], (57_700 - 16_384) / (4095 - 2560)
    )
    assert (np.abs(back.pixels[0, :, 0] - values) <= step / 2 + 0.01).all()
    assert (back.provenance["black_level_dn"], back.provenance["white_level_dn"]) == (168, 57_700)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"code_dn": (1024.0, 1792.0)}, "linear_dn has 3 numbers and code_dn 2"),
        ({"linear_dn": (1024.0, 900.0, 16_384.0)}, "do not rise"),
    ],
)
def test_knees_that_cannot_be_undone_are_refused(change, message):
    with pytest.raises(ImageError, match=message):
        hdr.compand(linear([200.0]), bits=12, **{**KNEES, **change})


def test_the_automotive_camera_is_linear_over_its_four_readings():
    """A staircase of light from dark to white through the shipped graph: the mean of each step, as linear DN, is in
    proportion.

    Steps of 60 x 60 pixels of one filter colour mix are compared with a noise-free
    sum of electrons; PRNU of 0.7 % averages out to 0.01 %.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "automotive_hdr.yaml").without(["diffraction", "glare"])
    levels = np.geomspace(20.0, 2300.0, 12)
    pixels = np.repeat(levels, 60)[None, :, None] * np.ones((60, 1, 3))
    scene = Image(pixels.astype(np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 1.0})
    run = graph.run({"radiance": scene}, seed=5, settings={"exposure_s": 0.01, "iso": 100.0}, until="decompand")
    gain, dark_e = run["merge"].provenance["system_gain_dn_e"], run["merge"].provenance["dark_e"]
    means = run["decompand"].pixels[..., 0].reshape(60, 12, 60).mean(axis=(0, 2), dtype=np.float64) - 168.0
    expected = (run["expose"].pixels[..., 0].reshape(60, 12, 60).mean(axis=(0, 2), dtype=np.float64) + dark_e) * gain
    assert means[0] < 0.2 * 3927 and means[-1] > 10.5 * 3927  # from the first reading to the fourth
    np.testing.assert_allclose(means, expected, rtol=0.006)
    ratios, knees = (run["merge"].provenance[name] for name in ("hdr_ratios", "hdr_knees_dn"))
    assert ratios == pytest.approx([1.0, 200 / 49, 10.0, 10.0 * 200 / 49], rel=2e-3) and len(knees) == 3
    for low, high in itertools.pairwise([0.0, *knees, 57_700.0]):  # every reading has a step of the staircase
        assert ((means + 168.0 > low) & (means + 168.0 < high)).any()
    merged = run["merge"].pixels
    assert (merged == np.rint(merged)).all() and merged.max() > 4095 and run["compand"].pixels.max() <= 4095
    white = scene.with_pixels(np.full_like(scene.pixels, 1e9))
    assert (
        graph.run({"radiance": white}, seed=5, settings={"exposure_s": 0.01, "iso": 100.0}, until="compand")[
            "compand"
        ].pixels
        >= 4090
    ).all()


def test_a_bar_that_moves_between_two_exposures_is_in_each_where_it_was():
    """A bright bar on grey, 8 pixels further on in the short exposure: where the long one is full the short one tells,
    so the merged bar is bright where it was in both, and grey where it was in one of them alone.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "staggered_hdr.yaml")
    rows, columns = 32, 64
    grey, bright = 100.0, 2e4
    frames = {}
    for name, left in (("exposure_0_94", 20), ("exposure_94_100", 28)):
        pixels = np.full((rows, columns, 3), grey, np.float32)
        pixels[:, left : left + 16] = bright
        frames[name] = Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 20.0})
    graph = graph.without(["glare", "glare_short", "diffraction", "diffraction_short"])
    at = camera.Exposure(2e-3, 100.0)
    run = graph.run(frames, seed=1, settings=at.settings, until="merge", keep=["adc", "adc_short", "merge"])
    green = run["merge"].pixels[0::2, 1::2, 0].mean(axis=0)  # of columns 1, 3, 5 ...
    left, both, right, floor = green[11:13].mean(), green[15:17].mean(), green[19:21].mean(), green[2:6].mean()
    top = run["adc"].provenance["white_level_dn"]
    assert run["adc"].pixels[:, 21:35].max() >= top and run["adc_short"].pixels.max() < top
    black = run["merge"].provenance["black_level_dn"]
    short = 16.0 * (run["adc_short"].pixels[0::2, 29:43:2, 0].mean() - black)
    assert both - black == pytest.approx(short, rel=0.02)
    assert left - black == pytest.approx(16.0 * (run["adc_short"].pixels[0::2, 23:27:2, 0].mean() - black), rel=0.02)
    assert right == pytest.approx(floor, rel=0.1), "the long exposure is not full there, and sees grey"


@pytest.mark.slow
def test_a_bake_draws_each_exposure_at_its_own_time(tmp_path):
    """A shining square that goes 2 m to the right, 10 m away, in the time that the shutter is open: the centres of the
    two exposures' light lie 0.94 / 2 + 0.06 / 2 of that way apart; radiance.exr has the mean of both.
    """
    (tmp_path / "stage.usda").write_text(
        """#usda 1.0
        (
            endTimeCode = 1
            metersPerUnit = 1
            startTimeCode = 0
            timeCodesPerSecond = 24
            upAxis = "Y"
        )
        def Camera "Eye" {
            float focalLength = 20.955
            float horizontalAperture = 20.955
            double shutter:open = 0
            double shutter:close = 1
        }
        def RectLight "Bar" {
            float inputs:intensity = 100
            float inputs:width = 1
            float inputs:height = 1
            double3 xformOp:rotateXYZ = (0, 180, 0)
            double3 xformOp:translate.timeSamples = {0: (-1, 0, -10), 1: (1, 0, -10)}
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
        }
        """
    )
    small = ("--resolution", "64x36", "--samples", "64", "--frames", "0")
    done = cli.run("bake", tmp_path / "stage.usda", "-o", tmp_path / "out", "--pipeline", "staggered_hdr", *small)
    assert done.returncode == 0, done.stderr
    (folder,) = {path.parent for path in (tmp_path / "out").rglob("radiance.exr")}
    centres, light = {}, {}
    for name in ("radiance", "exposure_0_94", "exposure_94_100"):
        image = read_exr(folder / f"{name}.exr")
        focal = image.width_px / 2 / math.tan(math.radians(image.provenance["fov_x_deg"]) / 2)
        plane = image.pixels[..., 1].astype(np.float64)
        across = (np.arange(image.width_px) + 0.5 - image.width_px / 2) / focal * 10.0
        centres[name], light[name] = (plane.sum(axis=0) * across).sum() / plane.sum(), plane.sum()
    assert centres["exposure_0_94"] == pytest.approx(-0.06, abs=0.03)
    assert centres["exposure_94_100"] == pytest.approx(0.94, abs=0.03)
    assert centres["radiance"] == pytest.approx(0.0, abs=0.03)
    assert light["exposure_94_100"] == pytest.approx(light["exposure_0_94"], rel=0.05)

"""What fog leaves of a thing: against Koschmieder's law, finer pictures, and drawn noise."""

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.dataset import visibility
from synfog_usd.fog import FogMedium
from synfog_usd.fog.volume import FogVolume
from synfog_usd.render.film import aovs
from synfog_usd.render.load import to_mitsuba
from synfog_usd.scene.testing import box, scene, wall

IDS = np.zeros((60, 80), dtype=np.int64)
IDS[20:40, 30:60] = 1


def of_one(luminance, transmittance=1.0, **more):
    return visibility.rows(IDS, np.full(IDS.shape, transmittance), luminance, **more)[1]


@pytest.mark.parametrize("transmittance", [0.3, 0.049])
def test_a_black_thing_before_the_horizon_keeps_a_contrast_of_minus_t(transmittance):
    """Koschmieder: against an endless background of the fog's own light, C = -T."""
    luminance = np.where(IDS == 1, 200.0 * (1.0 - transmittance), 200.0)
    row = of_one(luminance, transmittance, surface=np.zeros(IDS.shape))
    assert row["contrast"] == pytest.approx(-transmittance, rel=1e-3)
    assert row["contrast_rms"] == pytest.approx(transmittance, rel=1e-3)
    assert row["visibility"] == ("visible" if transmittance > 0.05 else "invisible")


def test_light_that_falls_off_behind_a_thing_is_no_contrast():
    """A slope of a fifth across the thing, which differs from it by 1 %: the plane takes it away."""
    slope = 100.0 + 0.6 * np.arange(80)[None, :] + 0.4 * np.arange(60)[:, None]
    row = of_one(np.where(IDS == 1, 1.01 * slope, slope))
    assert row["contrast"] == pytest.approx(0.01, rel=0.02)


def test_what_fog_hides_is_invisible_however_the_fog_is_lit():
    """A veil with a bright spot where the thing is: at T = 1e-6 no light of the veil is the thing's."""
    y, x = np.mgrid[:60, :80]
    veil = 100.0 + 80.0 * np.exp(-((x - 45) ** 2 + (y - 30) ** 2) / 150.0)
    noise = camera_noise()
    row = of_one(veil, 1e-6, surface=np.full(IDS.shape, 1e-4), noise=noise)
    assert row["visibility"] == "invisible" and abs(row["contrast"]) < 2e-6
    assert of_one(veil, 1.0, noise=noise)["visibility"] == "visible"  # without fog it is the thing that is bright


def camera_noise(electrons_per_cd_m2=20.0, dark_noise_e=5.0):
    return lambda light: camera.noise_floor(light, electrons_per_cd_m2=electrons_per_cd_m2, dark_noise_e=dark_noise_e)


def test_the_ratio_is_what_a_matched_filter_finds_in_drawn_noise(step=0.3):
    """Mean over scatter of the sum over the thing, in 4,000 drawn frames: within 4 %, three standard errors of that
    scatter.
    """
    truth = np.where(IDS == 1, 100.0 + step, 100.0)
    row = of_one(truth, noise=camera_noise())
    rng = np.random.default_rng(1)
    electrons = rng.poisson(20.0 * truth[IDS == 1], size=(4000, 600)) + rng.normal(0.0, 5.0, (4000, 600))
    sums = electrons.mean(axis=1) / 20.0 - 100.0
    assert row["cnr"] == pytest.approx(step / sums.std(), rel=0.04)


def test_the_three_words_are_those_of_the_thresholds():
    """Noise of the sensor made larger step by step, at a contrast of 10 %; then a contrast below 5 % without noise."""
    luminance = np.where(IDS == 1, 110.0, 100.0)
    found = [
        of_one(luminance, noise=lambda light, sigma=sigma: np.full(np.shape(light), sigma))["visibility"]
        for sigma in (1.0, 40.0, 60.0, 240.0, 260.0)
    ]
    assert found == ["visible", "visible", "faint", "faint", "invisible"]
    assert of_one(np.where(IDS == 1, 103.0, 100.0), noise=camera_noise())["visibility"] == "faint"


def test_nothing_is_said_where_there_is_nothing_to_compare():
    """A thing that fills the picture, and one in the dark."""
    whole = visibility.rows(np.ones((5, 5), dtype=np.int64), np.ones((5, 5)), np.ones((5, 5)))[1]
    dark = of_one(np.zeros(IDS.shape), noise=camera_noise())
    for row in (whole, dark):
        assert row["contrast"] is None and row["visibility"] is None and row["mean_transmittance"] == 1.0


def test_mean_transmittance_is_that_of_a_picture_eight_times_finer():
    """0.5 %, for slanted things of some hundred pixels in fog that thins with height."""
    fog = FogVolume("/Fog", box(300.0), FogMedium(0.03, profile="exponential", base_height_m=-2.0, scale_height_m=20.0))
    slanted = wall(40.0, 8.0)
    slanted["positions"] = slanted["positions"] + np.array([[0, -15, 0], [0, 20, 0], [0, 20, 0], [0, -15, 0]])
    world = {"shape_slanted": slanted, "shape_far": wall(90.0, 25.0)}
    means = []
    for times in (1, 8):
        source = scene(world, [fog], width_px=64 * times, height_px=36 * times, fov_x_deg=40.0)
        seen = aovs.measure(to_mitsuba(source, boundaries=False))
        rows = visibility.rows(seen.instance_id, seen.transmittance, np.ones(seen.instance_id.shape))
        means.append([rows[number]["mean_transmittance"] for number in (1, 2)])
    np.testing.assert_allclose(means[0], means[1], rtol=0.005)
    assert means[0][0] != pytest.approx(np.exp(-0.03 * 40.0), rel=0.02)  # one distance for all would not do

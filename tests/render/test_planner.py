"""Stops and choices: samples go where the error is, and no further than asked."""

import importlib.util

import numpy as np
import pytest

from synfog_usd.errors import ParameterError
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render import planner, shot
from synfog_usd.render.sampling import adaptive
from synfog_usd.render.shot import load, render
from synfog_usd.testing import black, box, scene, uniform_fog, wall

SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}}
FOGGY = scene({**SKY, "shape_wall": wall(50.0, 5.0, bsdf={"type": "diffuse"})}, [uniform_fog()], fov_x_deg=40.0)


def test_a_loose_target_takes_fewer_samples_than_a_tight_one_and_both_are_met():
    """The error that is asked for is the error that is stated, and a tenth of the error costs more."""
    loose, tight = (render(FOGGY, model="path", samples=8192, target_error=error, seed=1) for error in (0.2, 0.015))
    assert loose.met == 1.0 and tight.met > 0.95  # an edge takes more than all
    assert loose.samples < tight.samples < 8193  # the last round is in whole chunks
    assert tight.relative_error < 0.017


def test_samples_are_the_other_stop():
    """What cannot be met with the samples allowed is not met, and said to be."""
    done = render(FOGGY, model="path", samples=64, target_error=0.001, seed=1)
    assert done.met < 0.1 and done.samples <= 1.25 * 64


def test_an_adaptive_render_repeats_byte_for_byte():
    """Rounds depend on what was measured, not on the clock."""
    one, other = (
        render(FOGGY, model="path", samples=512, target_error=0.05, seed=3).radiance.pixels.tobytes() for _ in range(2)
    )
    assert one == other


def test_time_is_the_third_stop():
    """A limit that is over at once leaves the first round only."""
    assert render(FOGGY, model="path", samples=4096, time_limit_s=1e-6).samples == 32


def test_the_sensors_target_is_a_third_of_its_noise():
    """Two noises that come together grow by the square: 5 % more than the sensor's alone."""
    noise = adaptive.sensor_target(lambda luminance: 0.5 * np.sqrt(luminance))(np.array([4.0]))[0]
    assert np.hypot(noise, 1.0) == pytest.approx(1.054, abs=1e-3)


def test_biased_models_are_taken_only_where_their_error_was_seen_to_be_small():
    """In fog that scatters half of the light `asm` misses some of it; the pilot measures that and passes it over."""
    still = scene(
        {**SKY, "shape_wall": wall(50.0, 5.0, **black(1.0))},
        [FogVolume("/Fog", box(200.0), FogMedium(0.02, albedo=0.5))],
        fov_x_deg=40.0,
    )
    choice = planner.choose(load(still, boundaries=False), target=adaptive.Target(relative=0.1), seed=0)
    assert choice.best == "path" and choice.model in ("path", "field")
    assert choice.figures["asm"]["bias"] > 0.1


@pytest.mark.parametrize(
    "wrong, words",
    [
        ({"target_error": 0.0}, "--target-error"),
        ({"target_error": 2.0}, "--target-error"),
        ({"time_limit_s": 0.0}, "--time-limit"),
    ],
)
def test_a_target_out_of_range_is_refused(wrong, words):
    """With the option's name."""
    with pytest.raises(ParameterError, match=words):
        render(FOGGY, **wrong)


@pytest.mark.slow
def test_a_picture_of_a_few_rows_is_judged_too():
    """640 x 20: the pilot has two rows, fewer than a square over which a grid's error is measured is high."""
    wide = scene(
        {**SKY, "shape_wall": wall(50.0, 5.0, bsdf={"type": "diffuse"})},
        [uniform_fog()],
        width_px=640,
        height_px=20,
        fov_x_deg=40.0,
    )
    figures = planner.choose_by_pilots(
        load(wide, boundaries=False), target=adaptive.Target(relative=0.05), seed=0
    ).figures
    assert np.isfinite(figures["field"]["bias"])
    smoothed = planner.choose_by_pilots(
        load(wide, boundaries=False), target=adaptive.Target(relative=0.05), seed=0, denoised=True
    )
    assert smoothed.model == "path" and "field" not in smoothed.figures  # a denoiser does what the grid would


def square(corners):
    """A grey quadrangle."""
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return {
        "type": "mesh",
        "positions": np.array(corners, dtype=float),
        "faces": faces,
        "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}},
    }


@pytest.mark.slow
def test_an_open_view_takes_the_slab_and_a_closed_one_does_not():
    """Ground under the whole sky sees all of it, between high walls little: the share decides, without a pilot."""
    ground = square([(-150, -150, -1.5), (150, -150, -1.5), (150, 150, -1.5), (-150, 150, -1.5)])
    walls = {f"shape_wall_{x}": square([(x, -150, -1.5), (x, 150, -1.5), (x, 150, 30), (x, -150, 30)]) for x in (-6, 6)}
    plain = load(scene({**SKY, "shape_ground": ground}, [uniform_fog()], fov_x_deg=60.0), boundaries=False)
    street = load(scene({**SKY, "shape_ground": ground, **walls}, [uniform_fog()], fov_x_deg=60.0), boundaries=False)
    assert planner.open_to_sky(plain) == 1.0 and planner.open_to_sky(street) < 0.3
    for loaded, model in ((plain, "path+slab"), (street, "path")):
        choice = planner.choose(loaded, target=adaptive.Target(samples=4096), seed=0)
        assert choice.model == choice.best == model
        assert (
            planner.choose(loaded, target=adaptive.Target(samples=16), seed=0).model
            == {"path": "field", "path+slab": "field+slab"}[model]
        )
        assert (
            planner.choose(loaded, target=adaptive.Target(samples=16), seed=0, denoised=True).model == model
        )  # a denoiser does what a cache would


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("pyoidn") is None, reason="pyoidn has no wheel here")
def test_where_a_denoised_picture_is_good_enough_no_bias_is_tried():
    """10 % are asked for: the pilot without bias, denoised, errs by less, and nothing with a bias is rendered."""
    street = scene({**SKY, "shape_wall": wall(50.0, 5.0, **black(1.0))}, [uniform_fog()], fov_x_deg=40.0)
    choice = planner.choose(load(street, boundaries=False), target=adaptive.Target(relative=0.1), seed=0, denoised=True)
    assert choice.model == choice.best and choice.figures[choice.best]["denoised"] < 0.1
    assert set(choice.figures) <= {"path", "path+slab"} and "denoised it errs by" in choice.why


@pytest.mark.parametrize("model", ["path", "field"])
def test_the_samples_that_are_told_are_those_that_were_asked_for(model):
    """However many estimators a picture has, and whether the fog's light is sampled pixel by pixel."""
    assert render(FOGGY, model=model, samples=20).samples == 20


def test_choosing_bands_is_a_part_of_the_progress(monkeypatch):
    """What is tried small before the picture takes the first tenth; the whole never falls and ends at 1."""
    monkeypatch.setattr(shot, "WORTH_A_BANDS_PILOT", 0)
    told = []
    render(
        FOGGY,
        model="path",
        samples=16,
        bands=None,
        size=(16, 8),
        progress=lambda what, share: told.append((what, share)),
    )
    shares = [share for _, share in told]
    assert max(share for what, share in told if what == "trying bands") <= shot.CHOOSING[1]
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_estimators_that_are_waited_for_together_are_told_of_together():
    """Two estimators of a small picture: one report, at its end; else the second's time would be told as nothing."""
    told = []
    render(FOGGY, model="path", samples=4, size=(16, 8), progress=lambda what, share: told.append(share))
    assert set(told) <= {0.0, 1.0} and told[-1] == 1.0

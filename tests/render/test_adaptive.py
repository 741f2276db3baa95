"""Stops: samples go where the error is, and no further than asked."""

import numpy as np
import pytest

from synfog_usd.base.errors import ParameterError
from synfog_usd.render.sampling import adaptive
from synfog_usd.render.shot import render
from synfog_usd.scene.testing import scene, sky, uniform_fog, wall

FOGGY = scene({**sky(), "shape_wall": wall(50.0, 5.0, bsdf={"type": "diffuse"})}, [uniform_fog()], fov_x_deg=40.0)


def test_a_loose_target_takes_fewer_samples_than_a_tight_one_and_both_are_met():
    """The error that is asked for is the error that is stated, and a tenth of the error costs more."""
    loose, tight = (render(FOGGY, model="path", samples=8192, target_error=error, seed=1) for error in (0.2, 0.015))
    assert loose.under_target == 1.0 and tight.under_target > 0.95  # an edge takes more than all
    assert loose.samples < tight.samples < 8193  # the last round is in whole chunks
    assert tight.relative_error < 0.017


def test_samples_are_the_other_stop():
    """What cannot be met with the samples allowed is not met, and said to be."""
    done = render(FOGGY, model="path", samples=64, target_error=0.001, seed=1)
    assert done.under_target < 0.1 and done.samples <= 1.25 * 64


def test_the_sensors_target_is_a_third_of_its_noise():
    """Two noises that come together grow by the square: 5 % more than the sensor's alone."""
    noise = adaptive.sensor_target(lambda luminance: 0.5 * np.sqrt(luminance))(np.array([4.0]))[0]
    assert np.hypot(noise, 1.0) == pytest.approx(1.054, abs=1e-3)


def test_a_target_out_of_range_is_refused():
    """With the option's name."""
    with pytest.raises(ParameterError, match="--target-error"):
        render(FOGGY, target_error=2.0)

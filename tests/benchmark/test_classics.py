"""The classic methods: what their papers say must hold, on pictures made by the model of fog that they assume."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from synfog_usd.base import seeds
from synfog_usd.lab.benchmark import classics


def street(side: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """A view with something black in every patch, and its depth, which grows upwards as on a road."""
    rng = seeds.stream(9, "street")
    clear = ndimage.zoom(rng.random((side // 6, side // 6, 3)), (6, 6, 1), order=0)
    clear[::6] = 0.0
    clear[:, ::6] = 0.0
    return clear, np.linspace(2.0, 0.2, side)[:, None] * np.ones(side)


def foggy(clear: np.ndarray, depth: np.ndarray, airlight: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
    t = np.exp(-depth)
    return clear * t[..., None] + airlight * (1.0 - t[..., None]), t


def test_the_dark_channel_finds_the_transmittance_of_the_model():
    """With black in every patch, and all of the fog taken, the view comes back within 5 % where t > 0.3."""
    clear, depth = street()
    clear[:12, :12] = 0.9  # the airlight is there to see
    depth[:12, :12] = 9.0
    picture, t = foggy(clear, depth)
    found = classics.dark_channel(picture, keep=1.0, patch_px=13, radius_px=10, t_min=0.05)
    near = t > 0.3
    assert np.abs(found - clear)[near].mean() < 0.05
    assert np.abs(picture - clear)[near].mean() > 4 * np.abs(found - clear)[near].mean()


@pytest.mark.parametrize("name", ["dcp", "cap", "fvr"])
def test_fog_of_the_model_is_lifted_and_the_answer_is_a_picture(name):
    """Contrast (standard deviation) grows towards that of the clear view, and all numbers stay within 0 and 1."""
    clear, depth = street()
    picture, _ = foggy(clear, depth)
    found = classics.CLASSICS[name](picture)
    assert found.shape == picture.shape and found.min() >= 0.0 and found.max() <= 1.0
    assert picture[:60].std() * 1.1 < found[:60].std()


@pytest.mark.parametrize("name", list(classics.CLASSICS))
@pytest.mark.parametrize("level", [0.0, 0.5])
def test_an_even_picture_gives_no_nan(name, level):
    found = classics.CLASSICS[name](np.full((20, 31, 3), level))
    assert np.isfinite(found).all()


def test_the_colour_attenuation_depth_is_the_papers_line():
    """A grey wall of 0.6 (v 0.6, s 0) under an airlight of 1: d = 0.121779 + 0.95971 * 0.6, t = exp(-d)."""
    picture = np.full((40, 40, 3), 0.6)
    picture[0, 0] = 1.0
    found = classics.colour_attenuation(picture, patch_px=1, radius_px=3)
    t = np.exp(-(0.121779 + 0.959710 * 0.6))
    assert found[30, 30, 0] == pytest.approx((0.6 - 1.0) / t + 1.0, abs=1e-6)


def test_the_dark_channel_of_a_wall_is_worked_by_hand():
    """A wall of (0.4, 0.6, 0.5) under an airlight of 1, equations 12 and 22 of the paper: dark channel 0.4,
    t = 1 - 0.95 * 0.4 = 0.62, J = (I - 1) / 0.62 + 1.
    """
    picture = np.tile([0.4, 0.6, 0.5], (40, 40, 1))
    picture[:3, :3] = 1.0
    airlight, t = classics.dark_channel_fog(picture, patch_px=3, radius_px=5)
    np.testing.assert_array_equal(airlight, 1.0)
    assert t[30, 30] == pytest.approx(0.62, abs=1e-9)
    found = classics.dark_channel(picture, patch_px=3, radius_px=5)[30, 30]
    np.testing.assert_allclose(found, [0.02 / 0.62, 0.22 / 0.62, 0.12 / 0.62], atol=1e-9)

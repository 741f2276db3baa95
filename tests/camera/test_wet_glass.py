"""Drops on the windscreen against what they must show: the view upside down, and nothing behind the wiper."""

import math

import numpy as np
import pytest

from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.wet_glass import drops_on_glass

LENS = {"f_number": 2.0, "focal_length_mm": 4.0, "fov_x_deg": 60.0}


def radiance(pixels, time_s=0.0):
    image = Image(np.asarray(pixels, dtype=np.float32), ("R", "G", "B"), Quantity.RADIANCE)
    return image.with_metadata(frame_number=1, frames_per_s=1.0 / time_s) if time_s else image


def test_even_light_stays_even():
    """A drop before even light shows even light."""
    even = radiance(np.full((90, 160, 3), (1.0, 2.0, 3.0)))
    seen = drops_on_glass(even, **LENS)
    assert seen.provenance["drops_on_glass"] > 20
    np.testing.assert_allclose(seen.pixels, even.pixels, rtol=1e-4)


def test_a_drop_shows_the_view_upside_down():
    """Under a bright sky the lower half of the picture gets brighter by drops, and the upper half darker."""
    pixels = np.zeros((90, 160, 3))
    pixels[:45] = 1.0
    seen = drops_on_glass(radiance(pixels), density=2.0, **LENS).pixels
    assert seen[55:].max() > 0.1
    assert seen[:35].min() < 0.9


def test_as_many_drops_lie_there_as_have_landed():
    """At the share x of the way a place has waited for 1 - x / 2 of a period before the next pass, 3/4 in the mean."""
    width_m, height_m = (2 * math.tan(math.radians(30.0)) * 0.15 * part + 2 * 0.002 for part in (1.0, 9.0 / 16.0))
    count = sum(
        drops_on_glass(radiance(np.ones((90, 160, 3)), 3.0 * number - 1e-6), density=4.0, **LENS).provenance[
            "drops_on_glass"
        ]
        for number in range(1, 9)
    )
    wanted = 8 * 0.75 * 4e4 * width_m * height_m
    assert count == pytest.approx(wanted, abs=4.0 * math.sqrt(wanted))


def test_the_wiper_takes_drops_away_and_frames_have_the_same():
    """Just behind the blade there are none; a frame later most are where they were."""
    noise = radiance(np.random.default_rng(1).random((180, 320, 3)), 4.45)  # at 97 % of the way
    wiped = drops_on_glass(noise, density=4.0, **LENS).pixels - noise.pixels
    changed = np.abs(wiped).sum(axis=2) > 1e-3
    assert changed[:, 250:300].mean() < 0.15 < changed[:, :60].mean()
    counts = [
        drops_on_glass(noise.with_metadata(frame_number=number, frames_per_s=30.0), **LENS).provenance["drops_on_glass"]
        for number in range(50, 53)
    ]
    assert counts == sorted(counts)


def test_what_it_cannot_draw_is_refused():
    """No angle of view, a fisheye, and more drops than it draws."""
    even = radiance(np.ones((9, 16, 3)))
    with pytest.raises(ImageError, match="angle of view"):
        drops_on_glass(even, f_number=2.0, focal_length_mm=4.0)
    with pytest.raises(ImageError, match="lower density"):
        drops_on_glass(even, density=20.0, glass_m=3.0, **LENS)

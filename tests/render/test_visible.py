"""Lamps that the eye sees: faces cut to pixels carry exactly the light that their share of the pixels does, less what
hides and dims it; nothing counts twice.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.parts import glow, matte, squares

from synfog_usd.render.film.accumulator import DIRECT
from synfog_usd.render.shot import render
from synfog_usd.scene.testing import black, scene, uniform_fog, wall

pytestmark = pytest.mark.usefixtures("mi")

RADIANCE = 5000.0
SIZE, FOV_DEG, MOR_M = (24, 14), 20.0, 150.0


def face(x, z, distance, width, height):
    """A lit square across the +Y axis that faces the eye."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]) * (width, 1.0, height) + (x, distance, z)
    return squares(corners, emitter=glow(RADIANCE), bsdf={"type": "diffuse"})


def street(fog=True, **more):
    """Two lamps below a pixel, one of them over an edge of pixels, and a wall behind."""
    grey = matte(0.3)
    parts = {
        "shape_near": face(0.31, 0.17, 20.0, 0.08, 0.05),
        "shape_far": face(-2.0, -0.4, 45.0, 0.1, 0.1),
        "shape_wall": wall(60.0, 40.0, bsdf=grey),
        **more,
    }
    return scene(parts, (uniform_fog(200.0, visibility_m=MOR_M),) if fog else (), fov_x_deg=FOV_DEG)


def expected(lamps, fog=True):
    """Sum over the pixels of the light of squares (distance, width, height), seen at a right angle."""
    scale = SIZE[0] / (2.0 * np.tan(np.radians(FOV_DEG) / 2.0))
    sigma = -np.log(0.05) / MOR_M if fog else 0.0
    return sum(RADIANCE * w * h * (scale / d) ** 2 * np.exp(-sigma * d) for d, w, h in lamps)


def drawn(source, **settings):
    return render(source, samples=16, seed=3, size=SIZE, model="path", **settings)


@pytest.mark.parametrize("fog", [True, False], ids=["fog", "clear"])
def test_a_lamp_below_a_pixel_sends_what_its_area_does(fog):
    """Sixteen samples against area x transmittance, within 0.2 %: rays lean by 2 degrees at most, which lengthens the
    way through the fog.  By chance such a lamp would be off by 50 %."""
    found = drawn(street(fog)).components[DIRECT].sum(axis=(0, 1))
    np.testing.assert_allclose(found, expected([(20.0, 0.08, 0.05), (45.0, 0.1, 0.1)], fog), rtol=2e-3)


def test_lamps_of_one_mesh_that_are_pixels_apart_are_not_left_to_chance():
    """Two faces 3 m from each other, as the signals of a gantry may be, against their areas, within 0.2 %."""
    near, far = face(0.31, 0.17, 20.0, 0.08, 0.05), face(-2.5, -0.7, 22.0, 0.1, 0.1)
    both = near | {name: squares([near["positions"], far["positions"]])[name] for name in ("positions", "faces")}
    found = drawn(scene({"shape_both": both}, (), fov_x_deg=FOV_DEG)).components[DIRECT].sum(axis=(0, 1))
    np.testing.assert_allclose(found, expected([(20.0, 0.08, 0.05), (22.0, 0.1, 0.1)], fog=False), rtol=2e-3)


def test_components_are_the_picture_and_no_face_counts_twice():
    """Their sum is the radiance, and what the surfaces' paths have left at the lamps' pixels is the wall's light."""
    result = drawn(street())
    np.testing.assert_allclose(sum(result.components.values()), result.radiance.pixels, rtol=1e-4, atol=1e-4)
    lit = result.components[DIRECT].sum(axis=2) > 0.0
    assert 2 <= lit.sum() <= 8
    assert result.components["surface"][lit].max() < 1e-2 * result.components[DIRECT][lit].max()


def test_what_stands_before_a_lamp_hides_it():
    """A black board before the lower half of the near lamp leaves half of it: within 5 %, of 16 samples."""
    board = face(-1.0, -1.0, 10.0, 2.0, 1.0 + (0.17 + 0.025) / 2.0) | black()
    board.pop("emitter")
    found = drawn(street(shape_board=board)).components[DIRECT].sum(axis=(0, 1))
    np.testing.assert_allclose(found, expected([(20.0, 0.08, 0.025)]), rtol=0.05)


def test_a_lens_and_a_large_lamp_are_left_to_chance():
    """Neither has an estimator of its own; the light is there all the same."""
    lens = street()
    lens = replace(lens, camera=replace(lens.camera, f_number=2.8, focal_length_m=0.05, focus_m=20.0))
    assert DIRECT not in drawn(lens).components
    large = scene({"shape_lamp": face(-4.0, -3.0, 10.0, 8.0, 6.0)}, (), fov_x_deg=FOV_DEG)
    result = drawn(large)
    assert DIRECT not in result.components and result.components["surface"].mean() > 0.1 * RADIANCE

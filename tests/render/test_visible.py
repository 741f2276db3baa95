"""Lamps that the eye sees: faces cut to pixels carry exactly the light that their share of the pixels does, less what
hides and dims it; nothing counts twice.
"""

from dataclasses import replace

import numpy as np
import pytest

from synfog_usd.render import backend
from synfog_usd.render.film.accumulator import DIRECT
from synfog_usd.render.integrators import next_event
from synfog_usd.render.shot import render
from synfog_usd.scene.testing import black, scene, uniform_fog, wall

RADIANCE = 5000.0
SIZE, FOV_DEG, MOR_M = (24, 14), 20.0, 150.0


@pytest.fixture(autouse=True)
def _vectorised():
    backend.mitsuba()
    if backend.is_scalar():
        pytest.skip("vectorised tests")


def face(x, z, distance, width, height):
    """A lit square across the +Y axis that faces the eye."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]) * (width, 1.0, height) + (x, distance, z)
    colour = {"type": "rgb", "value": [RADIANCE] * 3}
    mesh = {"type": "mesh", "positions": corners, "faces": np.array([(0, 1, 2), (0, 2, 3)])}
    return {**mesh, "emitter": {"type": "area", "radiance": colour}, "bsdf": {"type": "diffuse"}}


def street(fog=True, **more):
    """Two lamps below a pixel, one of them over an edge of pixels, and a wall behind."""
    grey = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3] * 3}}}
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


@pytest.mark.slow
def test_the_split_leaves_the_mean(monkeypatch):
    """With and without the estimator, a lamp of five pixels: the same light in all of the picture, within five standard
    errors of 6 seeds, 5 % resolved; what it is for is seen beside it.
    """
    source = street(shape_near=face(0.31, 0.17, 20.0, 0.6, 0.5))

    def means():
        return np.array(
            [
                render(source, samples=64, seed=seed, size=SIZE, model="path").radiance.pixels.mean(dtype=np.float64)
                for seed in range(6)
            ]
        )

    ours = means()
    monkeypatch.setattr(next_event.VisibleFaces, "of", classmethod(lambda cls, loaded: None))
    chance = means()
    error = np.hypot(ours.std(ddof=1), chance.std(ddof=1)) / np.sqrt(6)
    assert 5 * error < 0.05 * ours.mean(), f"cannot see 5 %: error is {error / ours.mean():.2%}"
    assert abs(ours.mean() - chance.mean()) < 5 * error
    assert ours.std() < chance.std()


def test_a_lens_and_a_large_lamp_are_left_to_chance():
    """Neither has an estimator of its own; the light is there all the same."""
    lens = street()
    lens = replace(lens, camera=replace(lens.camera, f_number=2.8, focal_length_m=0.05, focus_m=20.0))
    assert DIRECT not in drawn(lens).components
    large = scene({"shape_lamp": face(-4.0, -3.0, 10.0, 8.0, 6.0)}, (), fov_x_deg=FOV_DEG)
    result = drawn(large)
    assert DIRECT not in result.components and result.components["surface"].mean() > 0.1 * RADIANCE

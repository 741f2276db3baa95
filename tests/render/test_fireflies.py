"""Fireflies of in-scattered light: none is lost, they take the shape of the other light, and only rare paths count."""

import numpy as np
import pytest
from support.parts import bulb, rgb, squares

from synfog_usd.render import denoise, models
from synfog_usd.render.film import accumulator, fireflies, launches
from synfog_usd.render.film.accumulator import HALVES, INSCATTERED_OF_LAMPS, LAMPS, MULTIPLE, SURFACE
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import scene, uniform_fog

SHAPE = (45, 80)


def test_light_that_is_spread_keeps_its_sum_and_takes_the_shape_of_the_other():
    """One bright pixel becomes a patch of some W/8 whose light over the other's is smooth; its sum stays."""
    light = np.zeros((*SHAPE, 3), dtype=np.float32)
    light[22, 40] = [3.0, 2.0, 1.0]
    like = np.where(np.arange(SHAPE[1]) % 20 < 10, 1.0, 3.0)[None].repeat(SHAPE[0], axis=0).astype(np.float32)
    wide = fireflies.spread_out(light.reshape(-1, 3), like.ravel(), SHAPE).reshape(light.shape)
    assert wide.sum(axis=(0, 1)) == pytest.approx(light.sum(axis=(0, 1)), rel=1e-5)
    assert wide.max() < 0.05 * light.max()
    # in the middle of two bands, equally far away, it differs as the other light does
    assert wide[22, 35, 0] / wide[22, 45, 0] == pytest.approx(3.0, rel=0.25)


def test_a_limit_lets_even_light_through_and_grows_as_the_root_of_the_paths():
    """A lane of 8 paths may bring its own mean and 20 more; 100 times as many paths allow ten times the excess."""
    assert fireflies.limit(2.0, 8, 0) == pytest.approx(2.0 * (8 + fireflies.TIMES))
    excess = [fireflies.limit(1.0, 0, paths) for paths in (16, 1600)]
    assert excess[1] / excess[0] == pytest.approx(10.0)
    random = np.random.default_rng(3)
    light = random.exponential(8.0, 4000)
    light[:4] = 1e5
    assert fireflies.mean_below(light, 8) == pytest.approx(1.0, rel=0.1)  # 12.5 with the four of them


def test_what_one_half_alone_has_of_a_surface_is_a_firefly():
    """A lamp's face, bright in both halves, stays as it is; a pixel that is bright in one is cut to 21 times the mean
    of all paths, and with 1600 paths, where that is a limit of 1 + 20 * 10 / 800, to 1.25 times.
    """
    halves = np.ones((2, *SHAPE, 3), dtype=np.float32)
    halves[:, 5:8, 5:8] = 1e4
    halves[1, 30, 50] = 1e4
    weights = [0.2126, 0.7152, 0.0722]
    few, many = (fireflies.confirmed(halves, weights, paths) for paths in (2, 1600))
    for kept, limit in ((few, 21.0), (many, 1.25)):
        changed = kept != halves
        assert changed[1, 30, 50].all()
        assert changed.sum() == 3
        assert kept[1, 30, 50] == pytest.approx(limit, rel=0.2)  # the mean holds a little of the lamp


def lamp_beside_a_ground():
    """A bulb a hand's breadth over a grey ground in fog, of which paths find the bright spot beneath it rarely."""
    grey = {"type": "diffuse", "reflectance": rgb(0.5)}
    ground = squares([[-30, -5, -2], [30, -5, -2], [30, 55, -2], [-30, 55, -2]], bsdf=grey)
    world = {"shape_ground": ground, "light_bulb": bulb([0.0, 15.0, -1.9], 50.0, 40.0, 30.0)}
    return scene(
        world, [uniform_fog(visibility_m=30.0, half_size=60.0)], fov_x_deg=60.0, width_px=SHAPE[1], height_px=SHAPE[0]
    )


@pytest.mark.usefixtures("mi")
def test_what_is_kept_apart_and_what_is_left_are_all_light_of_the_samples():
    """The same paths with fireflies apart and without: the sums agree to single precision, halves to their mean."""
    loaded = load(lamp_beside_a_ground(), boundaries=False, spectra=False)
    integrator, pixels = models.make("path", loaded), np.arange(SHAPE[0] * SHAPE[1])
    apart, whole = (
        accumulator.new_accumulator(integrator, len(pixels), denoised=denoised) for denoised in (True, False)
    )
    for picture in (apart, whole):
        launches.add_samples(picture, integrator, pixels, {LAMPS: 8, INSCATTERED_OF_LAMPS: 8}, 5)
    sums = apart.estimators[INSCATTERED_OF_LAMPS]
    assert sum(light.sum() for light in sums.fireflies.values()) > 0.0
    np.testing.assert_allclose(apart.aov(MULTIPLE), whole.aov(MULTIPLE), rtol=1e-4, atol=1e-6)
    (sampled, spread), (same, _) = apart.halves(MULTIPLE), whole.halves(MULTIPLE)
    assert spread.shape == (HALVES, *SHAPE, 3)
    np.testing.assert_allclose(sampled, same, rtol=1e-4, atol=1e-6)
    assert spread.mean() == pytest.approx(float(same.mean()), rel=0.02)
    assert spread.max() < same.max()


def test_only_what_both_halves_have_is_too_bright_to_be_denoised():
    """A pixel at 10^6 times the wall's light stays where both halves show it, and is gone where one does."""
    light = np.ones((2, *SHAPE, 3), dtype=np.float32)
    spread = light.copy()
    light[:, 20, 20] = spread[:, 20, 20] = 1e6
    light[0, 30, 60] = 1e6
    flat = np.ones((*SHAPE, 3), dtype=np.float32)
    guides = denoise.Guides(flat, 0.0 * flat, flat[..., 0])
    weights = [0.2126, 0.7152, 0.0722]
    picture = denoise.denoise_halves({SURFACE: lambda: (light, spread)}, guides, weights).components[SURFACE]
    assert picture[20, 20] == pytest.approx(1e6, rel=0.02)
    assert picture[30, 60].max() < 2.0

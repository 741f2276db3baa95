"""Airlight whose paths are those of squares of pixels: the same light as by pixels, and no halo at an edge."""

import importlib

import numpy as np
import pytest
from support.parts import rgb, squares

from synfog_usd.render import models
from synfog_usd.render.film.accumulator import (
    INSCATTERED,
    MULTIPLE,
    SHARE_PX,
    SINGLE,
    SURFACE,
    Squares,
    new_accumulator,
)
from synfog_usd.render.film.launches import add_samples
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import scene, sky, uniform_fog

denoising = importlib.import_module("synfog_usd.render.denoise")

WIDTH, HEIGHT = 31, 17


def test_each_turn_looks_through_another_pixel_of_the_square():
    """Of an odd picture too: all four turns stay in the square, and turns that are two apart face each other."""
    cut = Squares(WIDTH, HEIGHT)
    every = np.arange(np.prod(cut.shape))
    pixels = np.stack([cut.pixel(every, np.full_like(every, turn)) for turn in range(4)])
    np.testing.assert_array_equal(cut.of(pixels), np.tile(every, (4, 1)))
    whole = (pixels[0] % WIDTH < WIDTH - 1) & (pixels[0] // WIDTH < HEIGHT - 1)
    assert all(len(set(members)) == 4 for members in pixels.T[whole])
    assert (np.abs(pixels[2] - pixels[0])[whole] == WIDTH + 1).all()
    assert set(pixels.ravel()) == set(range(WIDTH * HEIGHT))


def in_fog(world):
    """Fog around a world under an even sky."""
    fog = uniform_fog(visibility_m=60.0, half_size=90.0)
    return scene({**world, **sky()}, [fog], fov_x_deg=60.0, width_px=WIDTH, height_px=HEIGHT)


def street():
    """A dark post close by on a road."""
    grey = {"type": "diffuse", "reflectance": rgb(0.3)}
    ground = squares([[-60, -5, -2], [60, -5, -2], [60, 95, -2], [-60, 95, -2]], bsdf=grey)
    post = squares([[-1, 4, -2], [1, 4, -2], [1, 4, 4], [-1, 4, 4]], bsdf=grey)
    return in_fog({"shape_ground": ground, "shape_post": post})


@pytest.mark.usefixtures("mi")
def test_light_by_squares_is_the_light_by_pixels():
    """Means of eight runs each: of the picture within 0.7 %, where noise is 0.2 %, and of the post within 4 %, where
    it is 1.3 %.
    """
    loaded = load(street(), boundaries=False, spectra=False)
    integrator, pixels = models.make("path", loaded), np.arange(WIDTH * HEIGHT)
    seen = 1.0 - denoising.guides(loaded).transmittance.ravel()

    def light(opacity):
        runs = []
        for seed in range(8):
            picture = new_accumulator(integrator, len(pixels), denoised=True, opacity=opacity)
            add_samples(picture, integrator, pixels, {INSCATTERED: 64}, seed)
            assert picture.estimators[INSCATTERED].counts.sum(axis=0).tolist() == [64] * len(pixels)
            runs.append((picture.aov(SINGLE) + picture.aov(MULTIPLE))[:, 1].reshape(HEIGHT, WIDTH))
        return np.mean(runs, axis=0)

    by_squares, by_pixels = light(seen), light(None)
    assert by_squares.mean() == pytest.approx(by_pixels.mean(), rel=0.007)
    near = np.zeros((HEIGHT, WIDTH), dtype=bool)
    near[: HEIGHT // 2, WIDTH // 2 - 2 : WIDTH // 2 + 3] = True
    assert by_squares[near].mean() == pytest.approx(by_pixels[near].mean(), rel=0.04)


@pytest.mark.usefixtures("mi")
def test_variance_that_squares_share_is_told_as_that_of_sums():
    """The variance of the picture's sum over 24 seeds is what `noise` tells, within the 60 % that so many
    resolve; a square counted as independent pixels would tell a quarter.  Nothing hides the fog: at an edge the halves,
    which look through different pixels, would differ by more than noise.
    """
    loaded = load(in_fog({}), boundaries=False, spectra=False)
    integrator, pixels = models.make("path", loaded), np.arange(WIDTH * HEIGHT)
    seen = 1.0 - denoising.guides(loaded).transmittance.ravel()
    sums, told = [], []
    for seed in range(24):
        picture = new_accumulator(integrator, len(pixels), denoised=True, opacity=seen)
        add_samples(picture, integrator, pixels, {SURFACE: 256, INSCATTERED: 4}, seed)
        sums.append(picture.luminance().sum())
        told.append(picture.noise()[0].sum())
    assert np.mean(told) / np.var(sums, ddof=1) == pytest.approx(1.0, abs=0.6)


def test_airlight_in_squares_keeps_the_edge_of_what_hides_it():
    """Even light in fog before a post and a wall comes back as even light over its opacity."""
    through = np.full((24, 32), 0.2, dtype=np.float32)
    through[:, 11:20] = 0.9
    light = np.repeat(3.0 * (1.0 - through)[..., None], 3, axis=2)
    flat = np.ones((24, 32, 3), dtype=np.float32)
    guides = denoising.Guides(flat, 0.0 * flat, through, in_squares=True)
    halves = {MULTIPLE: lambda: (np.stack([light, light]),) * 2}
    cleaned = denoising.denoise_halves(halves, guides, [0.2126, 0.7152, 0.0722]).components[MULTIPLE]
    np.testing.assert_allclose(cleaned, light, rtol=0.02)
    assert SHARE_PX == 2

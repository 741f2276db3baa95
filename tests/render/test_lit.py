"""Lamps' light on the first surface, an estimator of its own: images of lamps in a mirror are as large and as bright as
geometry says, and the picture's mean is that of paths which find them on their way.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.parts import bulb, rgb, squares
from support.stats import assert_agree, assert_mean

from synfog_usd.render import models
from synfog_usd.render.film.accumulator import LIT, SURFACE, SURFACE_OF_LAMPS, new_accumulator
from synfog_usd.render.film.launches import add_samples
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import black, scene, sky, uniform_fog, wall

pytestmark = pytest.mark.usefixtures("mi")

BALL_M, RADIUS_M = 4.0, 1.0
"""From the eye to the middle of a ball, and its radius."""

BEHIND_M, SIDE_M, APART_M, ROWS = 3.0, 1.6, 2.0, 4
"""A square of lit panels behind the eye: how far, how large each, from one to the next, and how many a side."""

FOV_DEG, SIDE_PX, MOR_M = 29.0, 12, 30.0
BLACK = rgb(0.0)
MIRROR = {"type": "preview_surface", "base_color": BLACK, "roughness": 0.0}
COATED = {**MIRROR, "clearcoat": 1.0, "clearcoat_roughness": 0.0}
PAINT = {**COATED, "base_color": rgb(0.05, 0.1, 0.3), "roughness": 0.4, "metallic": 0.4, "clearcoat_roughness": 0.2}


def panel(number):
    """(x, z) of its lower left corner, and its radiance."""
    row, column = divmod(number, ROWS)
    return (column - ROWS / 2) * APART_M + 0.2, (row - ROWS / 2) * APART_M + 0.2, 20.0 + 5.0 * number


def ball(bsdf, fog=(), extra=()):
    """A ball before the eye, and panels behind the eye that face it: seen in the ball alone."""
    place = np.diag([RADIUS_M, RADIUS_M, RADIUS_M, 1.0])
    place[1, 3] = BALL_M
    parts = {"shape_ball": {"type": "sphere", "to_world": place, "bsdf": bsdf}}
    for number in range(ROWS**2):
        x, z, radiance = panel(number)
        corners = np.array([(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)]) * SIDE_M + (x, -BEHIND_M, z)
        parts[f"shape_panel_{number}"] = squares(corners, **black(radiance))
    return scene({**parts, **dict(extra)}, fog, width_px=SIDE_PX, height_px=SIDE_PX, fov_x_deg=FOV_DEG)


def fresnel(cosine, eta=1.5):
    sine = np.sqrt(1.0 - cosine**2) / eta
    inside = np.sqrt(1.0 - sine**2)
    across = (cosine - eta * inside) / (cosine + eta * inside)
    along = (eta * cosine - inside) / (eta * cosine + inside)
    return 0.5 * (across**2 + along**2)


def mirrored(reflection, sigma_t, points=1000):
    """Mean of the picture: every point's ray is mirrored by the ball, and looks whether it meets a panel."""
    edge = np.tan(np.radians(FOV_DEG) / 2.0) * (2.0 * (np.arange(points) + 0.5) / points - 1.0)
    x, z = np.meshgrid(edge, edge)
    way = np.stack([x, np.ones_like(x), z], axis=-1)
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    along = way[..., 1] * BALL_M
    inside = along**2 - BALL_M**2 + RADIUS_M**2
    there = along - np.sqrt(np.maximum(inside, 0.0))
    normal = (there[..., None] * way - (0.0, BALL_M, 0.0)) / RADIUS_M
    cosine = -(way * normal).sum(axis=-1)
    back = way + 2.0 * cosine[..., None] * normal
    on = (there * way[..., 1] + BEHIND_M) / np.maximum(-back[..., 1], 1e-9)
    met = there[..., None] * way + on[..., None] * back
    light = np.zeros_like(x)
    for number in range(ROWS**2):
        left, low, radiance = panel(number)
        within = (np.abs(met[..., 0] - left - SIDE_M / 2) < SIDE_M / 2) & (
            np.abs(met[..., 2] - low - SIDE_M / 2) < SIDE_M / 2
        )
        light += radiance * within
    light *= (inside > 0.0) & (back[..., 1] < 0.0)
    return (light * reflection(np.clip(cosine, 0.0, 1.0)) * np.exp(-sigma_t * (there + on))).mean()


def drawn(integrator, names, samples, seed):
    """Sums of these estimators alone."""
    pixels = np.arange(SIDE_PX**2)
    accumulated = new_accumulator(integrator, pixels.size)
    add_samples(accumulated, integrator, pixels, dict.fromkeys(names, samples), seed)
    assert accumulated.lost == 0
    return [accumulated.estimators[name] for name in names]


@pytest.mark.parametrize(
    ("bsdf", "fog"),
    [
        pytest.param(MIRROR, True, marks=pytest.mark.slow, id="mirror in fog"),
        pytest.param(COATED, True, id="coat in fog"),
    ],
)
def test_lamps_in_a_ball_that_mirrors_are_as_large_and_as_bright_as_geometry_says(bsdf, fog):
    """Sixteen panels in a black ball of glass, and in one with a coat (F + (1 - F) F), against rays mirrored one by
    one; 5 % resolved.
    """
    sigma_t = -np.log(0.05) / MOR_M if fog else 0.0
    fogs = (uniform_fog(200.0, visibility_m=MOR_M),) if fog else ()
    integrator = models.make("path", load(ball(bsdf, fogs), boundaries=False))
    means = [drawn(integrator, [LIT], 64, seed)[0].mean().mean() for seed in range(16)]
    twice = bsdf is COATED
    truth = mirrored(lambda cosine: fresnel(cosine) * (2.0 - fresnel(cosine) if twice else 1.0), sigma_t)
    assert_mean(means, truth, resolves=0.05)


def test_a_long_mesh_of_many_panels_is_lamps_by_their_place():
    """The panels as a mesh each and as one of 7 m, all alike, beside faint points: as much light; 5 % resolved."""
    faint = {f"light_{number}": bulb([0.0, -50.0, number], 1e-3) for number in range(ROWS**2)}
    apart = ball(PAINT, extra=faint)
    alike = {key: {**part, **black(50.0)} for key, part in apart.world.items() if "panel" in key}
    one = {"shape_panels": squares([part["positions"] for part in alike.values()], **black(50.0))}
    means = []
    for panels, lamps in ((alike, ROWS**2), (one, 4)):
        rest = {key: part for key, part in apart.world.items() if key not in alike}
        source = replace(apart, world={**rest, **panels}, instance_of={})
        integrator = models.make("path", load(source, boundaries=False))
        assert integrator.lights.count == lamps + len(faint)
        means.append(np.array([drawn(integrator, [LIT], 256, seed)[0].mean().mean() for seed in range(16)]))
    assert_agree(*means, resolves=0.05)


def room(fog=()):
    """The ball with a coat on rough metal, a grey wall, a sky, and two light groups; some lamps are points."""
    grey = {"type": "diffuse", "reflectance": rgb(0.4, 0.3, 0.2)}
    points = {f"light_{side}": bulb([x, 1.0, 3.0], 40.0) for side, x in {"left": -2.0, "right": 2.0}.items()}
    source = ball(PAINT, fog, {**sky(2.0), **points, "shape_wall": wall(7.0, 6.0, bsdf=grey)})
    lamps = [key for key, part in source.world.items() if key.startswith("light_") or "emitter" in part]
    return replace(source, group_of={key: "one" if key < "shape_panel_4" else "other" for key in lamps})


def both(source, samples, seeds, **how):
    """(seeds, ...) surfaces of pictures with that estimator, and where paths find the same light on their way."""
    integrator = models.make("path", load(source, boundaries=False), **how)
    found = []
    for names in ((SURFACE, SURFACE_OF_LAMPS, LIT), (SURFACE, SURFACE_OF_LAMPS)):
        integrator.estimators = tuple(name for name in integrator.estimators if name != LIT or LIT in names)
        runs = [sum(part.mean() for part in drawn(integrator, names, samples, seed)) for seed in range(seeds)]
        found.append(np.array(runs).reshape(seeds, SIDE_PX, SIDE_PX, -1))
    return found


CASES = {
    "clear": ({}, {}, False),
    "bands in fog": ({}, {"bands": 8}, True),
    "camera that moves": ({"drift_m": (0.3, 0.0, 0.0), "rolling": 0.5}, {}, True),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_mean_is_that_of_paths_that_find_lamps_on_their_way(name):
    """A painted ball, a wall, a sky, panels and points: two estimators of the same picture; 4 % resolved."""
    camera, how, foggy = CASES[name]
    source = room((uniform_fog(200.0, visibility_m=5.0 * MOR_M),) if foggy else ())
    source = replace(source, camera=replace(source.camera, **camera))
    split, whole = both(source, 64, 8, **how)
    assert_agree(split, whole, resolves=0.04)


def test_light_groups_share_it_and_the_same_seed_gives_the_same_bytes():
    """Groups add up to the light of all lamps; it counts as light of surfaces."""
    integrator = models.make("path", load(room(), boundaries=False))
    one, again, other = (drawn(integrator, [LIT], 4, seed)[0] for seed in (7, 7, 8))
    assert set(one.aovs) == {SURFACE}
    np.testing.assert_array_equal(one.aovs[SURFACE], again.aovs[SURFACE])
    assert not np.array_equal(one.aovs[SURFACE], other.aovs[SURFACE])
    assert all(group.sum() > 0.0 for group in one.groups[:2])
    np.testing.assert_allclose(sum(one.groups), one.total(SURFACE), rtol=1e-4, atol=1e-4)

"""Things that move while the camera exposes: closed forms of blur, of a rolling shutter and of moving lamps."""

from dataclasses import replace

import numpy as np
import pytest
from support import renders
from support.parts import rgb, squares

from synfog_usd.render.shot import load, render
from synfog_usd.scene import PARALLEL_DEG
from synfog_usd.scene.testing import black, scene, wall

STEPS = 33
WIDTH_M = 8.0


def parallel(world, *, width_px=16, height_px=8, **more):
    """A scene seen by an orthographic camera at the origin, 8 m wide, which looks north."""
    made = scene(world, width_px=width_px, height_px=height_px)
    return replace(made, camera=replace(made.camera, fov_x_deg=PARALLEL_DEG, width_m=WIDTH_M, **more))


def going(way_m, *, turn_rad=0.0):
    """A thing that goes (x, y, z) [m] evenly in the exposure, and turns about the line of sight."""
    share = np.linspace(-0.5, 0.5, STEPS)
    found = np.tile(np.eye(4), (1, STEPS, 1, 1))
    found[0, :, :3, 3] = share[:, None] * np.asarray(way_m)
    cosine, sine = np.cos(share * turn_rad), np.sin(share * turn_rad)
    found[0, :, 0, 0], found[0, :, 2, 2], found[0, :, 0, 2], found[0, :, 2, 0] = cosine, cosine, sine, -sine
    return found


def edges_m(picture):
    """(H,) where a sharp edge would stand to leave as much light in each row."""
    return WIDTH_M / 2 - picture.sum(axis=1, dtype=np.float64) * (WIDTH_M / picture.shape[1])


def bar(left_m, right_m, distance_m=20.0):
    """A shining bar, 20 m high."""
    corners = [[left_m, -10], [right_m, -10], [right_m, 10], [left_m, 10]]
    return squares([[x, distance_m, z] for x, z in corners], **black(1.0))


def half_plane(edge_m):
    """A shining sheet from an edge on to the right."""
    return bar(edge_m, edge_m + 50.0)


def test_a_bar_that_moves_is_blurred_to_the_trapezium_of_its_way():
    """A bar 1 m wide that goes 2 m: light rises over 1 m to 1/2, stays for 1 m and falls over 1 m, by pixels of 1/8 m.

    Parts of the exposure are a pixel long at most, so each pixel errs by less than 1 / 16 / 4 of the slope's pixel.
    """
    world = parallel({"shape_bar": bar(-0.5, 0.5)}, width_px=64)
    world = replace(world, motion_of={"shape_bar": going((2.0, 0.0, 0.0))})
    runs = renders.by_seed(world, range(2), samples=64, model="path")
    seen = np.mean([run.radiance.pixels[:, :, 1].mean(axis=0, dtype=np.float64) for run in runs], axis=0)
    x = (np.arange(64)[:, None] - 32 + (np.arange(200) + 0.5) / 200) / 8.0
    wanted = np.clip((1.5 - np.abs(x)) / 2.0, 0.0, 0.5).mean(axis=1)
    np.testing.assert_allclose(seen, wanted, atol=0.02)
    assert seen.sum() / 8.0 == pytest.approx(1.0, rel=0.002), "all of the bar's light"
    assert np.abs(seen - np.clip(wanted * 1.03, 0, 0.5)).max() > 0.005, "the test sees three in a hundred"


@pytest.mark.parametrize("what", ["bar", "camera"])
def test_under_global_reset_rows_begin_together_and_the_lower_ones_are_blurred_longer(what):
    """An edge that goes 3 m to the left, or a camera that goes as far to the right; the top row exposes for a quarter
    of the time and the bottom row for all of it.  A row at v sees the first 1/4 + 3/4 v of the way, in the middle of
    which the edge stands, and light rises over the whole of it: slant -3/2 * 3/4 m, at v = 1/2 3/2 - 3/2 * 5/8 m.
    """
    drift = {"drift_m": (3.0, 0.0, 0.0)} if what == "camera" else {}
    world = parallel({"shape_sheet": half_plane(0.0)}, width_px=32, rolling=0.75, global_reset=True, **drift)
    if what == "bar":
        world = replace(world, motion_of={"shape_sheet": going((-3.0, 0.0, 0.0))})
    runs = renders.by_seed(world, range(4), samples=64, model="path")
    seen = np.mean([run.radiance.pixels[:, :, 1] for run in runs], axis=0, dtype=np.float64)
    down = (np.arange(8) + 0.5) / 8
    slant, middle = np.polyfit(down - 0.5, edges_m(seen), 1)
    assert slant == pytest.approx(-1.125, rel=0.02)
    assert middle == pytest.approx(1.5 - 1.5 * 0.625, abs=0.015)
    x, way = (np.arange(32)[:, None] - 16 + (np.arange(64) + 0.5) / 64) / 4.0, 3.0 * (0.25 + 0.75 * down)
    wanted = [np.clip(1.0 - (1.5 - x) / long, 0.0, 1.0).mean(axis=1) for long in way]
    np.testing.assert_allclose(seen, wanted, atol=0.08)


@pytest.mark.parametrize("model", ["path", pytest.param("volpath", marks=pytest.mark.slow)])
def test_a_moving_bar_leans_under_a_rolling_shutter_as_far_as_it_went(model):
    """An edge that goes 3 m to the left, three quarters of it between the rows' beginnings, leans by 2.25 m."""
    world = parallel({"shape_sheet": half_plane(0.0)}, width_px=32, rolling=0.75)
    world = replace(world, motion_of={"shape_sheet": going((-3.0, 0.0, 0.0))})
    seeds = 4
    runs = renders.by_seed(world, range(seeds), samples=128, model=model)
    edges = np.array([edges_m(run.radiance.pixels[:, :, 1]) for run in runs])
    down = (np.arange(8) + 0.5) / 8
    slant, middle = np.polyfit(down - 0.5, edges.mean(axis=0), 1)
    spread = np.polyfit(down - 0.5, edges.T, 1)[0].std(ddof=1) / np.sqrt(seeds)
    assert 5 * spread < 0.01 * 2.25, "the test must see one in a hundred"
    assert slant == pytest.approx(-2.25, rel=0.01)
    assert middle == pytest.approx(0.0, abs=0.02)


@pytest.mark.slow
def test_a_lamp_that_moves_lights_as_the_mean_of_its_places():
    """A point lamp of 100 cd that goes 6 m along a wall 4 m before it: I h / r^3 / pi, averaged over its way."""
    light = {"type": "point", "to_world": np.eye(4), "intensity": rgb(100.0)}
    light["to_world"][:3, 3] = (0.0, 6.0, 0.0)
    white = {"bsdf": {"type": "diffuse", "reflectance": rgb(1.0)}}
    world = scene(
        {"shape_wall": wall(10.0, 50.0, **white), "light_lamp": light}, width_px=16, height_px=8, fov_x_deg=60.0
    )
    world = replace(world, motion_of={"light_lamp": going((6.0, 0.0, 0.0))}, group_of={"light_lamp": "other"})
    seen = np.mean([run.radiance.pixels[:, :, 1] for run in renders.by_seed(world, range(4), samples=64)], axis=0)
    focal = 8.0 / np.tan(np.radians(30.0))
    u, v = np.meshgrid((np.arange(160) + 0.5) / 10 - 8.0, (np.arange(80) + 0.5) / 10 - 4.0)
    lamp_x = ((np.arange(200) + 0.5) / 200 - 0.5) * 6.0
    across = (u[..., None] / focal * 10.0 - lamp_x) ** 2 + (v[..., None] / focal * 10.0) ** 2
    wanted = (100.0 * 4.0 / (across + 16.0) ** 1.5 / np.pi).mean(axis=-1).reshape(8, 10, 16, 10).mean(axis=(1, 3))
    np.testing.assert_allclose(seen, wanted, rtol=0.01)
    still = np.abs(100.0 * 4.0 / ((u**2 + v**2) / focal**2 * 100.0 + 16.0) ** 1.5 / np.pi).max()
    assert abs(seen.max() / still - 1.0) > 0.1, "the test would see a lamp that stands"


def test_the_scene_stands_as_it_stood_once_it_is_drawn_and_turning_things_turn():
    """A sheet that turns by 90 degrees about the line of sight: half of the picture's centre line is lit at any moment
    whatever the angle; afterwards the scene that was loaded shows the moment of mid-exposure again.
    """
    world = parallel({"shape_sheet": half_plane(0.0)}, width_px=32)
    loaded = load(world, boundaries=False)
    before = render(world, samples=16, model="path", loaded=loaded).radiance.pixels
    moving = replace(world, motion_of={"shape_sheet": going((0.0, 0.0, 0.0), turn_rad=np.pi / 2)})
    other = replace(loaded, source=moving)
    turned = render(moving, samples=64, model="path", loaded=other).radiance.pixels[:, :, 1]
    x, z = np.meshgrid((np.arange(640) + 0.5) / 80 - 4.0, (np.arange(160) + 0.5) / 80 - 1.0)
    beyond = np.clip(np.degrees(np.arctan2(x, np.abs(z))) / 90.0 + 0.5, 0.0, 1.0)  # share of the time
    wanted = beyond.reshape(8, 20, 32, 20).mean(axis=(1, 3))
    np.testing.assert_allclose(turned, wanted, atol=0.08)  # 1 / 32 is a moment, and 0.05 noise of 64 samples
    assert np.abs(turned - wanted).mean() < 0.01
    np.testing.assert_array_equal(render(world, samples=16, model="path", loaded=loaded).radiance.pixels, before)

"""Drops in a picture against the medium that they are a part of, and against how they fall."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base.image import Image, Quantity
from synfog_usd.dataset.drop_light import Sightlines, falling_in, lamps_of, scattered, shade_of
from synfog_usd.dataset.drops import FallTime, reach_of, streaks_of, with_drops
from synfog_usd.dataset.objects import Projection
from synfog_usd.dataset.plan import Shot
from synfog_usd.dataset.shot import RenderedShot
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.fog.drops import extinction, rain_sizes
from synfog_usd.fog.falling import FAR_M, Cone, Drops, SizeClasses, falling
from synfog_usd.render.film.aovs import Aovs
from synfog_usd.render.load import to_mitsuba
from synfog_usd.render.picture import Rendered
from synfog_usd.scene import testing

RATE, WIDTH, HEIGHT = 100.0, 160, 90
GRAPH = camera.load_graph(Path("phone"))


LAMP = {"type": "point", "position": [1.0, 4.0, 0.6], "intensity": {"type": "rgb", "value": [4000.0, 3000.0, 1000.0]}}


def shot(medium, *, distance_m=8.0, wall=(1.0, 2.0, 3.0), air=(30.0, 20.0, 10.0), world=()):
    """A wall of one radiance in an even medium that sends another, without noise."""
    scene = testing.scene(
        dict(world), [FogVolume("/Fog", testing.box(200.0), medium)], width_px=WIDTH, height_px=HEIGHT, fov_x_deg=50.0
    )
    through = np.full((HEIGHT, WIDTH), math.exp(-medium.sigma_t_per_m * distance_m))
    surface = (through[:, :, None] * np.array(wall)).astype(np.float32)
    airlight = ((1.0 - through[:, :, None]) * np.array(air)).astype(np.float32)
    plane, ids = np.full((HEIGHT, WIDTH), distance_m), np.zeros((HEIGHT, WIDTH), int)
    rendered = Rendered(
        radiance=Image(surface + airlight, ("R", "G", "B"), Quantity.RADIANCE),
        aovs=Aovs(plane, plane, np.zeros((HEIGHT, WIDTH, 3)), ids, ids, through),
        relative_error=0.0,
        mottle=None,
        components={"surface": surface, "airlight_single": airlight},
        error=None,
        groups={},
        model="path",
        why="",
        warnings=(),
        samples=1.0,
        under_target=None,
    )
    return RenderedShot(Shot("sky", "rain", None, None), scene, None, None, rendered, None, {}, {})


def rain():
    return FogMedium(extinction("rain", rain_sizes(RATE), 1.0), falls=(("rain", rain_sizes(RATE)),))


def test_the_mean_over_drops_is_the_mediums_own_picture():
    """Near drops are taken out of the medium: the mean of many falls is the picture without them, to 1 % of what they
    change of it.
    """
    before = shot(rain())
    sizes, view = SizeClasses.of_rain(rain_sizes(RATE)), Projection.of(before.scene.camera)
    tau = float(sizes.optical_depth(reach_of(sizes, view), np.array(8.0)))
    assert tau > 0.005
    means = np.array(
        [
            with_drops(before, GRAPH, FallTime(0.0, seed)).rendered.radiance.pixels.mean(axis=(0, 1), dtype=float)
            for seed in range(24)
        ]
    )
    wanted = before.rendered.radiance.pixels.mean(axis=(0, 1), dtype=float)
    error = means.std(axis=0, ddof=1) / math.sqrt(len(means))
    most = tau * np.abs(np.array((30.0, 20.0, 10.0)) - (1.0, 2.0, 3.0))  # by which drops change the wall
    assert np.all(4.0 * error < 0.1 * most)
    assert np.all(np.abs(means.mean(axis=0) - wanted) < 0.01 * most + 4.0 * error)


def test_the_mean_light_of_drops_by_a_lamp_is_what_is_taken_out_of_the_medium():
    """Drops before a wall at 8 m, each lit by a lamp at 4 m: the mean over many falls of what they send is the integral
    along lines of sight, within 1 % and four standard errors, which resolve 3 %.
    """
    scene = shot(rain(), world={"lamp": LAMP}).scene
    ((sizes, medium, _),), lamps, view = falling_in(scene), lamps_of(scene), Projection.of(scene.camera)
    eye, reach = scene.camera.to_world[:3, 3], reach_of(sizes, view)
    lines = Sightlines.of(scene.camera, lamps, medium, FAR_M)
    wanted = lines.sum(sizes.optical_depth(reach, lines.ends_m), np.full((HEIGHT, WIDTH), 8.0)).sum(axis=(0, 1))
    sums = []
    for seed in range(120):
        cone = Cone(eye, -scene.camera.to_world[:3, 2], 0.5)
        drops = falling(sizes, reach, cone, time_s=0.0, wind_m_s=np.zeros(3), seed=seed)
        to_eye = -drops.place_m / np.linalg.norm(drops.place_m, axis=1)[:, None]
        light = scattered(lamps, drops.place_m + eye, to_eye, medium)
        streaks = streaks_of(drops, view, 0.01, 0.0, math.inf, light)
        inside = np.all((streaks.place_px > 0.0) & (streaks.place_px < (WIDTH, HEIGHT)), axis=1)
        seen = inside & (streaks.distance_m < 8.0)
        sums.append(streaks.area_px[seen] @ streaks.light[seen])
    error = np.std(sums, axis=0, ddof=1) / math.sqrt(len(sums))
    assert np.all(4.0 * error < 0.03 * wanted)
    assert np.all(np.abs(np.mean(sums, axis=0) - wanted) < 0.01 * wanted + 4.0 * error)


def test_what_stands_before_a_lamp_shades_the_drops_behind_it():
    """A lamp at 40 m, a square of 2 m before it at 20 m: at 8 m its shadow is 3.2 m wide.  Within, drops have no light;
    well beside it all that they have without the square.
    """
    lamp = LAMP | {"position": [0.0, 40.0, 0.0]}
    scene = shot(rain(), world={"lamp": lamp, "shape_square": testing.wall(20.0, 1.0)}).scene
    shade, lamps = shade_of(scene, to_mitsuba(scene, boundaries=False)), lamps_of(scene)
    ((_, medium, _),) = falling_in(scene)
    x = np.array([-3.0, -2.7, -0.4, 0.0, 0.4, 2.7, 3.0])
    places = np.stack([x, np.full(7, 8.0), np.zeros(7)], axis=1)
    to_eye = -places / np.linalg.norm(places, axis=1)[:, None]
    shaded, plain = (scattered(lamps, places, to_eye, medium, of)[:, 0] for of in (shade, None))
    np.testing.assert_allclose(shaded[2:5], 0.0)
    np.testing.assert_allclose(shaded[[0, 1, 5, 6]], plain[[0, 1, 5, 6]])
    assert shade_of(scene, to_mitsuba(scene)) is None  # rays would end at the fog's boundary


def test_drops_shine_near_a_lamp():
    """Of all pixels those before a lamp of 4 000 cd change the most: drops show its cone."""
    before = shot(rain(), air=(40.0, 30.0, 20.0), world={"lamp": LAMP})
    plain = before.rendered.radiance.pixels
    falls = [with_drops(before, GRAPH, FallTime(0.0, seed)).rendered.radiance.pixels - plain for seed in range(12)]
    change = np.mean(np.abs(falls), axis=0)[:, :, 0]
    row, column = np.unravel_index(np.argmax(change), change.shape)
    focal_px = WIDTH / 2 / math.tan(math.radians(25.0))
    right, ahead, up = np.array(LAMP["position"]) - before.scene.camera.to_world[:3, 3]
    assert math.hypot(column - WIDTH / 2 - focal_px * right / ahead, row - HEIGHT / 2 + focal_px * up / ahead) < 10


def test_the_light_of_a_lamp_along_a_line_of_sight_is_the_closed_form():
    """Scattered evenly by thin air, a lamp of I at distance h from a line sends sigma I / (4 pi h) times the angle
    under which it sees the line (Koschmieder's integral without extinction).
    """
    scene = shot(FogMedium(1e-6, g=0.0), world={"lamp": LAMP}).scene
    lamps, camera_ = lamps_of(scene), scene.camera
    medium = FogMedium(1e-6, g=0.0)
    lines = Sightlines.of(camera_, lamps, medium, 40.0)
    found = lines.sum(1e-6 * lines.ends_m, np.full((HEIGHT, WIDTH), 40.0))[44:46, 79:81, 0].mean(dtype=float)
    ahead = -camera_.to_world[:3, 2]
    away = np.array(LAMP["position"]) - camera_.to_world[:3, 3]
    along = away @ ahead
    h = math.sqrt(away @ away - along**2)
    angle = math.atan((40.0 - along) / h) - math.atan((lines.ends_m[0] - along) / h)
    assert found == pytest.approx(1e-6 * 4000.0 / (4.0 * math.pi * h) * angle, rel=0.01)


def test_drops_are_bright_before_what_is_dark_and_add_up_as_layers():
    """Before a wall darker than the air drops are lighter than the mean, never darker; layers are the picture."""
    before = shot(rain())
    after = with_drops(before, GRAPH, FallTime(0.0, 1)).rendered
    change = after.radiance.pixels - before.rendered.radiance.pixels
    assert change.max() > 4.0 * -change.min() > 0.0
    np.testing.assert_allclose(sum(after.components.values()), after.radiance.pixels, rtol=1e-5)


def test_a_frame_and_a_seed_decide_which_drops_there_are():
    """The same moment gives the same bytes; another moment, seed or wind others."""
    before = shot(rain())
    windy = replace(before.scene, fog=(replace(before.scene.fog[0], wind_m_s=(3.0, 0.0, 0.0)),))
    one, same, later, other, blown = (
        with_drops(replace(before, scene=scene), GRAPH, FallTime(*moment)).rendered.radiance.pixels.tobytes()
        for scene, *moment in (*((before.scene, *at) for at in ((1, 3), (1, 3), (1.04, 3), (1, 4))), (windy, 1, 3))
    )
    assert one == same
    assert len({one, later, other, blown}) == 4


def test_fog_alone_has_no_drops():
    """A medium in which nothing falls gives the very shot."""
    before = shot(FogMedium.from_visibility(150.0))
    assert with_drops(before, GRAPH, FallTime(0.0, 0)) is before


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (0.0, 10.0, 0.0)])
def test_a_streak_is_exposure_times_speed_before_the_lens(velocity):
    """2 mm at 5 m falls 6.49 m/s (Gunn and Kinzer): f v t / z pixels, and from a car runs away from where it goes."""
    scene = shot(rain()).scene
    view = Projection.of(replace(scene.camera, velocity_m_s=velocity))
    place = np.array([[0.5, 5.0, 0.0]])
    drops = Drops(place, np.array([[0.0, 0.0, -6.49]]), np.array([2e-3]), np.ones(1), np.zeros(1))
    streaks = streaks_of(drops, view, 0.01, 0.002, math.inf)
    focal_px = WIDTH / 2 / math.tan(math.radians(25.0))
    across, down = streaks.speed_px_s[0] * 0.01
    assert down == pytest.approx(focal_px * 6.49 * 0.01 / 5.0, rel=0.02)
    assert across == pytest.approx(focal_px * 0.5 * velocity[1] * 0.01 / 25.0, rel=0.02, abs=1e-9)
    assert streaks.blur_px[0] == pytest.approx(focal_px * 0.002 / 5.0, rel=0.02)
    assert streaks.area_px[0] == pytest.approx(math.pi / 4 * (focal_px * 2e-3 / 5.0) ** 2, rel=0.02)

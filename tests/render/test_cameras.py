"""Orthographic cameras and cameras that move: closed forms, in clear air and in fog."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support import renders
from support.parts import squares
from support.stats import assert_mean

from synfog_usd.base.errors import StageError
from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.render import backend
from synfog_usd.render.film.aovs import measure
from synfog_usd.render.motion import moved
from synfog_usd.render.shot import load, render
from synfog_usd.scene import PARALLEL_DEG
from synfog_usd.scene.testing import LOOK_NORTH, black, box, scene, uniform_fog, wall

WIDTH_M = 8.0


def parallel(world, fog=(), *, width_px=16, height_px=8, **more):
    """A scene seen by an orthographic camera at the origin, 8 m wide, which looks north."""
    made = scene(world, fog, width_px=width_px, height_px=height_px)
    return replace(made, camera=replace(made.camera, fov_x_deg=PARALLEL_DEG, width_m=WIDTH_M, **more))


def half_plane(edge_m, distance_m, radiance=1.0):
    """A black sheet that shines, at x above `edge_m`, 20 m high."""
    corners = [(edge_m, -10), (edge_m + 50, -10), (edge_m + 50, 10), (edge_m, 10)]
    return squares([(x, distance_m, z) for x, z in corners], **black(radiance))


@pytest.mark.parametrize(
    "model, distance_m", [("path", 5.0), ("path", 80.0), pytest.param("volpath", 80.0, marks=pytest.mark.slow)]
)
def test_size_does_not_fall_with_distance(model, distance_m):
    """A sheet from x = 0.75 m on: pixels of 0.5 m are dark up to column 9, half lit in it, lit from 10 on."""
    seen = render(parallel({"shape_sheet": half_plane(0.75, distance_m)}), samples=256, model=model).radiance.pixels[
        :, :, 1
    ]
    np.testing.assert_array_equal(seen[:, :9], 0.0)
    np.testing.assert_allclose(seen[:, 10:], 1.0, rtol=1e-5)
    np.testing.assert_allclose(seen[:, 9].mean(), 0.5, atol=5 * 0.5 / np.sqrt(256 * 8))


def test_every_ray_goes_equally_far_through_fog():
    """A wall of radiance 1 at 50 m behind absorbing fog of MOR 150: 0.05^(1/3), in each pixel alike.

    `path` has the transmittance in closed form, so few samples show as much.
    """
    world = parallel({"shape_wall": wall(50.0, 30.0, **black(1.0))}, [uniform_fog(albedo=0.0)])
    means = renders.means(world, 8, samples=64, model="path")
    assert_mean(means, 0.05 ** (50.0 / 150.0), resolves=0.03, truth_within=8e-5)


@pytest.mark.parametrize("boundaries", [False, True])
def test_labels_are_those_of_parallel_rays(boundaries):
    """A sheet that leans away: depth rises by 1 m a metre to the right; distance is depth, and fog dims by it from the
    lens on.
    """
    sheet = squares([[-9, 11, -9], [9, 29, -9], [9, 29, 9], [-9, 11, 9]], bsdf={"type": "diffuse"})
    found = measure(load(parallel({"shape_sheet": sheet}, [uniform_fog()]), boundaries=boundaries))
    wanted = np.broadcast_to(20.0 + (np.arange(16) - 7.5) * 0.5, (8, 16))
    np.testing.assert_allclose(found.depth_m, wanted, rtol=1e-5)
    np.testing.assert_allclose(found.distance_m, wanted, rtol=1e-5)
    np.testing.assert_allclose(found.transmittance, 0.05 ** (wanted / 150.0), rtol=1e-5)
    assert (found.instance_id == 1).all()


def test_a_lens_across_the_edge_of_fog_is_refused_by_what_cannot_tell():
    """Mitsuba's sensor stands in one medium; `path` knows where each ray begins: half the picture is dimmed."""
    fog = FogVolume("/Bank", box((100.0, 100.0, 100.0), (100.0, 0, 0)), FogMedium(0.02, albedo=0.0))
    world = parallel({"shape_wall": wall(50.0, 30.0, **black(1.0))}, [fog])
    with pytest.raises(StageError, match=r"/Camera: the orthographic camera's rays begin in different fogs"):
        render(world, samples=2, model="volpath")
    seen = render(world, samples=16, model="path").components["surface"][:, :, 1]
    np.testing.assert_allclose(seen[:, :8], 1.0, rtol=1e-5)
    np.testing.assert_allclose(seen[:, 8:], np.exp(-1.0), rtol=1e-4)


def test_a_camera_that_drifts_smears_an_edge_over_its_way():
    """2 m to the right in an exposure: each pixel is the mean of an edge seen from -1 to 1 m, a ramp four pixels
    wide.
    """
    world = parallel({"shape_sheet": half_plane(0.0, 20.0)}, drift_m=(2.0, 0.0, 0.0))
    means = np.array(
        [
            run.radiance.pixels[:, :, 1].mean(axis=0, dtype=np.float64)
            for run in renders.by_seed(world, range(8), samples=128, model="path")
        ]
    )
    left = (np.arange(16) - 8) * 0.5
    x = left[:, None] + (np.arange(1000) + 0.5) / 1000 * 0.5
    wanted = np.clip((x + 1.0) / 2.0, 0.0, 1.0).mean(
        axis=1
    )  # share of the exposure in which x + drift lies beyond the edge
    np.testing.assert_allclose(means.mean(axis=0), wanted, atol=5 * 0.5 / np.sqrt(8 * 8 * 128))
    assert render(replace(world, camera=replace(world.camera, drift_m=(0.0, 0.0, 0.0))), samples=16).radiance.pixels[
        0, 8, 1
    ] == pytest.approx(1.0)


def test_a_camera_that_turns_turns_its_rays_about_its_place():
    """At the end of the exposure origin and direction are turned by half of the rotation, as SciPy turns them, and half
    of the way gone.
    """
    backend.start("auto")
    mi = backend.mitsuba()
    draw = np.random.default_rng(2)
    turn, drift, eye = draw.normal(size=3) * 0.3, draw.normal(size=3), draw.normal(size=3)
    place = LOOK_NORTH.copy()
    place[:3, 3] = eye
    camera = replace(scene({}).camera, to_world=place, drift_m=tuple(drift.tolist()), turn_rad=tuple(turn.tolist()))
    o, d = draw.normal(size=(3, 5)), draw.normal(size=(3, 5))
    for share in (0.0, 0.5, 1.0):
        found = moved(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)), camera, mi.Float(0.3), mi.Float(share))
        half = Rotation.from_rotvec(turn * (share - 0.5))
        np.testing.assert_allclose(np.array(found.d), half.apply(d.T).T, atol=2e-6)
        np.testing.assert_allclose(
            np.array(found.o), half.apply((o - eye[:, None]).T).T + (eye + drift * (share - 0.5))[:, None], atol=2e-6
        )


@pytest.mark.parametrize("model", ["path", pytest.param("volpath", marks=pytest.mark.slow)])
def test_a_bar_leans_under_a_rolling_shutter_as_far_as_the_camera_went(model):
    """An edge seen by a camera that goes 3 m to the right, three quarters of which between the rows' beginnings.

    A row at the height v of the picture, 0 at the top, is exposed about the moment 0.75 v + 0.125: the edge lies at
    -3 (0.75 v + 0.125 - 0.5) m, so it leans by 2.25 m over the picture's height, and each row smears it over 0.75 m.
    """
    world = parallel({"shape_sheet": half_plane(0.0, 20.0)}, width_px=32, drift_m=(3.0, 0.0, 0.0), rolling=0.75)
    seeds = 8
    rows = np.array(
        [
            run.radiance.pixels[:, :, 1].sum(axis=1, dtype=np.float64)
            for run in renders.by_seed(world, range(seeds), samples=256, model=model)
        ]
    )
    edges_m = WIDTH_M / 2 - rows * (WIDTH_M / 32)  # where a sharp edge would stand to leave as much light in the row
    down = (np.arange(8) + 0.5) / 8
    slant, middle = np.polyfit(down - 0.5, edges_m.mean(axis=0), 1)
    spread = np.polyfit(down - 0.5, edges_m.T, 1)[0].std(ddof=1) / np.sqrt(seeds)
    assert 5 * spread < 0.01 * 2.25, "the test must see one in a hundred"
    assert slant == pytest.approx(-2.25, rel=0.01)
    assert middle == pytest.approx(0.0, abs=0.02)

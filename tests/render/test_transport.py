"""Volumetric path tracing against exact truths."""

from dataclasses import replace

import numpy as np
import pytest
from support import renders
from support.parts import bulb, glow, rgb, squares
from support.renders import by_seed
from support.stats import assert_agree, assert_mean

from synfog_usd.base.errors import ParameterError
from synfog_usd.fog import Boundary, Fog, FogMedium, FogVolume
from synfog_usd.render import models
from synfog_usd.render.integrators import tasks
from synfog_usd.render.shot import render
from synfog_usd.scene.testing import black, box, scene, sky, uniform_fog, wall
from synfog_usd.translate.space import scaled
from synfog_usd.world.shapes import shift

MODELS = ["path", "volpath"]

SKY = sky()


def pictures(world_scene, *, samples=128, seeds=8, model="auto"):
    """One picture per seed."""
    return renders.pictures(world_scene, seeds, samples=samples, model=model)


@pytest.mark.parametrize(
    "model, visibility_m, seeds, samples, resolves",
    [
        ("path", 150.0, 8, 64, 0.03),
        *(
            pytest.param(model, visibility_m, 16, 2048, resolves, marks=pytest.mark.slow)
            for model, visibility_m, resolves in (("volpath", 150.0, 0.01), ("path", 50.0, 0.03))
        ),
    ],
)
def test_a_wall_in_absorbing_fog_dims_by_beer_and_lambert(model, visibility_m, seeds, samples, resolves):
    """With nothing scattered, a wall of radiance 1 at 50 m reaches the camera as exp(-2.996 / MOR * 50).

    `path` has the transmittance in closed form, so few samples show as much.
    """
    fog = uniform_fog(visibility_m=visibility_m, albedo=0.0)
    world = scene({"shape_wall": wall(50.0, **black(1.0))}, [fog], fov_x_deg=1.0)
    assert_mean(
        pictures(world, samples=samples, seeds=seeds, model=model),
        0.05 ** (50.0 / visibility_m),
        resolves=resolves,
        truth_within=8e-5,
    )  # rays off the axis


@pytest.mark.parametrize(
    "model, samples, resolves", [("path", 128, 0.01), pytest.param("volpath", 512, 0.01, marks=pytest.mark.slow)]
)
def test_scattering_fog_in_a_uniform_sky_is_invisible(model, samples, resolves):
    """White furnace: albedo 1, radiance 1 from everywhere, MOR 50: every pixel is 1."""
    world = scene(SKY, [uniform_fog(visibility_m=50.0, half_size=60.0)], fov_x_deg=60.0)
    assert_mean(pictures(world, model=model, samples=samples), 1.0, resolves=resolves)


def lamps_in_fog(g, boundary):
    """A grey ground, a grey ball, a sky, and lamps of four kinds (spot, bulb, panel, bright ball), all in fog."""
    aim = np.array([[0, 0, -1.0, 6], [1, 0, 0, 15], [0, -1, 0, 2], [0, 0, 0, 1]])
    paint = {"type": "preview_surface", "base_color": rgb(0.4), "roughness": 0.4}
    grey = {"bsdf": {"type": "twosided", "bsdf": paint}}
    world = {
        **SKY,
        "shape_ground": squares([[-40, -5, -2], [40, -5, -2], [40, 75, -2], [-40, 75, -2]], **grey),
        "shape_ball": {"type": "sphere", "center": [-1.0, 15.0, 0.0], "radius": 2.0, **grey},
        "shape_lamp": {"type": "sphere", "center": [5.0, 25.0, 4.0], "radius": 1.0, "emitter": glow(20.0)},
        "shape_panel": squares([[-6, 22, 2], [-6, 24, 2], [-6, 24, 4], [-6, 22, 4]], **black(30.0)),
        "light_bulb": bulb([0.0, 30.0, 6.0], 25.0),
        "light_spot": {"type": "spot", "to_world": aim, "cutoff_angle": 40.0, "intensity": rgb(60.0)},
    }
    fog = FogVolume("/Fog", boundary, FogMedium(0.05, albedo=0.9, g=g))
    return scene(world, [fog], fov_x_deg=70.0)


def assert_models_agree(world, *, samples, resolves):
    """`path` and `volpath` have the same mean within five standard errors, and could be seen to differ by
    `resolves`.
    """
    ours, theirs = (renders.pictures(world, 6, samples=samples, model=model) for model in MODELS)
    assert_agree(ours, theirs, resolves=resolves)


BOX, BALL = box((30.0, 30.0, 12.0), (2, 20, 3)), Boundary("sphere", np.diag([40.0, 30.0, 20.0, 1.0]))


@pytest.mark.parametrize("samples, resolves", [(64, 0.17), pytest.param(400, 0.06, marks=pytest.mark.slow)])
def test_path_agrees_with_volpath_beside_lamps(samples, resolves):
    """Surfaces, sky and lamps in fog whose edge is in view.

    `volpath` finds the edge by tracing it and lamps by chance; `path` has a formula
    for the one and draws the others by what they send: they share no code.
    """
    assert_models_agree(lamps_in_fog(0.87, BOX), samples=samples, resolves=resolves)


@pytest.mark.physics
@pytest.mark.parametrize("g, boundary", [(0.87, BOX), (0.0, BALL), (-0.5, BOX)])
def test_path_agrees_with_volpath_beside_lamps_closely(g, boundary):
    """The same for three phase functions and two boundaries; 2 % is resolved."""
    assert_models_agree(lamps_in_fog(g, boundary), samples=4000, resolves=0.02)


def mesh_box():
    """A box of fog, told as a mesh that is no box: one corner is moved."""
    import trimesh

    hull = trimesh.creation.box(extents=(100.0, 100.0, 100.0))
    vertices = np.asarray(hull.vertices, dtype=np.float64)
    vertices[0] *= 1.3
    return Boundary("mesh", np.eye(4), vertices, np.asarray(hull.faces, dtype=np.int64))


def test_path_refuses_fog_that_it_does_not_know_and_auto_does_not():
    """A mesh boundary is named as the reason; auto takes volpath and says why."""
    fog = [FogVolume("/Hull", mesh_box(), FogMedium(0.1))]
    with pytest.raises(ParameterError, match="/Hull"):
        render(scene(SKY, fog), model="path", samples=2)
    model, why = models.choose(models.AUTO, scene(SKY, fog))
    assert model == "volpath" and "not path" in why


@pytest.mark.slow
@pytest.mark.parametrize("samples, resolves", [(400, 0.08), pytest.param(4000, 0.03, marks=pytest.mark.physics)])
def test_path_agrees_with_volpath_in_dust_within_fog_beside_lamps(samples, resolves):
    """Phase function and colour go by the place: a ball of dust, red by its albedo, in fog with snow and clear air."""
    kinds = {"mor60+snow5": BOX, "dust15": shift(3.0, 18.0, 1.0), "mor1000000": shift(3.0, 15.0, 1.0)}
    volumes = []
    for number, (name, place) in enumerate(kinds.items()):
        boundary = (
            place if isinstance(place, Boundary) else Boundary("sphere", place @ scaled(*[9.0 - 3.5 * number] * 3))
        )
        medium = Fog.named(name).over(FogMedium(1.0))
        volumes.append(FogVolume(name, boundary, medium, parent=number - 1 if number else None))
    world = replace(lamps_in_fog(0.0, BOX), fog=tuple(volumes))
    ours, theirs = (renders.pictures(world, 6, samples=samples, model=model) for model in MODELS)
    for channel in (0, 2):
        assert_agree(ours[..., channel], theirs[..., channel], resolves=resolves)


@pytest.mark.slow
def test_path_agrees_with_volpath_in_fog_that_thins_with_height():
    """Over a grey ground."""
    medium = FogMedium(0.03, profile="exponential", base_height_m=-20.0, scale_height_m=15.0)
    ground = squares([[-90, -90, -1.5], [90, -90, -1.5], [90, 90, -1.5], [-90, 90, -1.5]], bsdf={"type": "diffuse"})
    fog = [FogVolume("/Fog", box((200.0, 200.0, 60.0), (0, 0, 40)), medium)]
    world = scene({**SKY, "shape_ground": ground}, fog, fov_x_deg=50.0)
    assert_models_agree(world, samples=256, resolves=0.04)


def street():
    """A wide ground, a wall and a ball under a level slab of fog."""
    flat = np.array([[-800, -800, -1.5], [800, -800, -1.5], [800, 800, -1.5], [-800, 800, -1.5]])
    ground = squares(flat, bsdf={"type": "diffuse", "reflectance": rgb(0.15)})
    paint = {"type": "preview_surface", "base_color": rgb(0.5, 0.3, 0.1), "roughness": 0.3}
    grey = {"type": "twosided", "bsdf": paint}
    world = {
        **SKY,
        "shape_ground": ground,
        "shape_wall": wall(30.0, 3.0, bsdf=grey),
        "shape_ball": {"type": "sphere", "center": [3.0, 12.0, 0.0], "radius": 1.5, "bsdf": grey},
    }
    slab = FogVolume("/Fog", box((800.0, 800.0, 31.0), (0, 0, 29.0)), FogMedium(0.02))
    return scene(world, [slab], fov_x_deg=60.0, width_px=32, height_px=18)


def test_the_aovs_add_up_and_the_surface_is_dimmed_by_the_transmittance():
    """surface + airlight_single + airlight_multiple is the radiance; before a black wall surface is T times its
    glow.
    """
    done = render(street(), samples=64, model="path")
    np.testing.assert_allclose(sum(done.components.values()), done.radiance.pixels, rtol=1e-4)
    world = scene({**SKY, "shape_wall": wall(50.0, **black(1.0))}, [uniform_fog()], fov_x_deg=1.0)
    seen = render(world, samples=64, model="path").components["surface"]
    np.testing.assert_allclose(seen, 0.05 ** (50.0 / 150.0), rtol=2e-3)  # the pixels' rays are up to 0.02 % longer


def test_a_bank_inside_fog_dims_with_both(samples=512, resolves=0.06):
    """0.3 per metre inside 0.03 per metre: without the outer fog behind the bank the wall would be 29 % too bright."""
    outer = FogVolume("/Outer", box(200.0), FogMedium(0.03, albedo=0.0))
    bank = FogVolume("/Bank", box((50, 2.5, 50), (0, 10, 0)), FogMedium(0.3, albedo=0.0), priority=1, parent=0)
    world = scene({"shape_wall": wall(20.0, **black(1.0))}, [outer, bank], fov_x_deg=1.0)
    assert_mean(pictures(world, samples=samples), np.exp(-(0.03 * 15 + 0.3 * 5)), resolves=resolves)


@pytest.mark.parametrize("model", ["path", pytest.param("volpath", marks=pytest.mark.slow)])
def test_the_same_seed_gives_the_same_bytes(model):
    """And another seed does not."""
    world = scene({**SKY, "shape_wall": wall(50.0, bsdf={"type": "diffuse"})}, [uniform_fog()])
    first, again, other = by_seed(world, (1, 1, 2), samples=32, model=model)
    assert first.radiance.pixels.tobytes() == again.radiance.pixels.tobytes()
    assert first.radiance.variance.tobytes() == again.radiance.variance.tobytes()
    assert first.radiance.pixels.tobytes() != other.radiance.pixels.tobytes()


@pytest.mark.parametrize("few", [7, pytest.param(1, marks=pytest.mark.slow)])
def test_bytes_do_not_depend_on_how_many_pixels_a_lane_takes(monkeypatch, few):
    """A lane for each, or seven that share them unevenly, or one for all: the same bytes."""
    world = lamps_in_fog(0.87, BOX)
    pictures = []
    for paths, lanes in ((1, 1), (1 << 20, few)):
        monkeypatch.setattr(tasks, "PATHS", paths)
        monkeypatch.setattr(tasks, "LEAST_LANES", lanes)
        pictures.append(render(world, samples=2, model="path"))
    one, other = (done.radiance for done in pictures)
    assert other.pixels.tobytes() == one.pixels.tobytes()
    assert other.variance.tobytes() == one.variance.tobytes()


def test_the_variance_is_that_of_the_mean(model="path"):
    """The stated variance equals the scatter over seeds: ratio 1 within 5 sigma of a chi-squared of 24 renders x 144
    pixels.
    """
    world = scene({**SKY, "shape_wall": wall(50.0)}, [uniform_fog()])
    runs = [run.radiance for run in by_seed(world, range(24), samples=32, model=model)]
    scatter = np.var([run.pixels[:, :, 0] for run in runs], axis=0, ddof=1, dtype=np.float64).mean()
    stated = np.mean([run.variance[:, :, 0] for run in runs], dtype=np.float64)
    assert (
        abs(scatter / stated - 1.0) < 5 * np.sqrt(2 / (23 * 144)) * 1.5
    )  # 1.5: the tails of path tracing are heavier than a normal's


@pytest.mark.parametrize("samples", [1, 1 << 21])
def test_a_number_of_samples_out_of_range_is_refused(samples):
    """One sample has no variance; two million are a slip of the keyboard."""
    with pytest.raises(ParameterError, match="--samples"):
        render(scene(SKY), samples=samples)

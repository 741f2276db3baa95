"""Volumetric path tracing against exact truths."""

from dataclasses import replace

import numpy as np
import pytest
from support import renders
from support.renders import by_seed
from support.stats import assert_agree, assert_mean

from synfog_usd.base.errors import ParameterError
from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.render import backend, models
from synfog_usd.render.film import accumulator
from synfog_usd.render.integrators import next_event, tasks
from synfog_usd.render.shot import Settings, load, picture_bytes, render
from synfog_usd.scene.testing import black, box, scene, uniform_fog, wall

MODELS = ["path", "volpath"]

SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}}


def pictures(world_scene, *, samples=128, seeds=8, model="auto"):
    """One picture per seed."""
    return renders.pictures(world_scene, seeds, samples=samples, model=model)


@pytest.mark.parametrize(
    "model, visibility_m, seeds, samples, resolves",
    [
        ("path", 150.0, 8, 64, 0.03),
        *(
            pytest.param(model, visibility_m, 16, 2048, resolves, marks=pytest.mark.slow)
            for model in MODELS
            for visibility_m, resolves in ((600.0, 0.01), (150.0, 0.01), (50.0, 0.03))
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
    "model, samples, resolves",
    [("path", 128, 0.01), pytest.param("volpath", 512, 0.01, marks=pytest.mark.slow)],
)
def test_scattering_fog_in_a_uniform_sky_is_invisible(model, samples, resolves):
    """White furnace: albedo 1, radiance 1 from everywhere, MOR 50: every pixel is 1."""
    world = scene(SKY, [uniform_fog(visibility_m=50.0, half_size=60.0)], fov_x_deg=60.0)
    assert_mean(pictures(world, model=model, samples=samples), 1.0, resolves=resolves)


def lamps_in_fog(g, boundary):
    """A grey ground, a grey ball, a sky, and lamps of four kinds (spot, bulb, panel, bright ball), all in fog."""
    aim = np.array([[0, 0, -1.0, 6], [1, 0, 0, 15], [0, -1, 0, 2], [0, 0, 0, 1]])
    grey = {
        "bsdf": {
            "type": "twosided",
            "bsdf": {
                "type": "preview_surface",
                "base_color": {"type": "rgb", "value": [0.4, 0.4, 0.4]},
                "roughness": 0.4,
            },
        }
    }
    ground = {
        "type": "mesh",
        "positions": np.array([[-40, -5, -2], [40, -5, -2], [40, 75, -2], [-40, 75, -2.0]]),
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        **grey,
    }
    world = {
        **SKY,
        "shape_ground": ground,
        "shape_ball": {"type": "sphere", "center": [-1.0, 15.0, 0.0], "radius": 2.0, **grey},
        "shape_lamp": {
            "type": "sphere",
            "center": [5.0, 25.0, 4.0],
            "radius": 1.0,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [20.0] * 3}},
        },
        "shape_panel": {
            "type": "mesh",
            "positions": np.array([[-6.0, 22, 2], [-6, 24, 2], [-6, 24, 4], [-6, 22, 4]]),
            "faces": np.array([[0, 1, 2], [0, 2, 3]]),
            **black(30.0),
        },
        "light_bulb": {
            "type": "point",
            "position": [0.0, 30.0, 6.0],
            "intensity": {"type": "rgb", "value": [25.0] * 3},
        },
        "light_spot": {
            "type": "spot",
            "to_world": aim,
            "cutoff_angle": 40.0,
            "intensity": {"type": "rgb", "value": [60.0] * 3},
        },
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
@pytest.mark.parametrize("g", [0.87, 0.0, -0.5])
@pytest.mark.parametrize("boundary", [BOX, BALL], ids=["box", "ball"])
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


@pytest.mark.parametrize(
    "fog, words",
    [
        ([FogVolume("/Hull", mesh_box(), FogMedium(0.1))], "/Hull"),
        ([uniform_fog(), FogVolume("/Bank", box(5.0), FogMedium(0.1, g=0.5), priority=1, parent=0)], "/Bank"),
    ],
)
def test_path_refuses_fog_that_it_does_not_know_and_auto_does_not(fog, words):
    """Mesh boundaries and mixed phase functions are named as the reason; auto takes volpath and says why."""
    with pytest.raises(ParameterError, match=words):
        render(scene(SKY, fog), model="path", samples=2)
    model, why = models.choose(models.AUTO, scene(SKY, fog))
    assert model == "volpath" and "not path" in why


NESTED = [uniform_fog(), FogVolume("/Bank", box((30, 6, 30), (0, 15, 0)), FogMedium(0.1), priority=1, parent=0)]
THINNING = [
    FogVolume(
        "/Fog",
        box((200.0, 200.0, 60.0), (0, 0, 40)),
        FogMedium(0.03, profile="exponential", base_height_m=-20.0, scale_height_m=15.0),
    )
]


@pytest.mark.slow
@pytest.mark.parametrize("samples, resolves", [(256, 0.04)])
@pytest.mark.parametrize("fog", [NESTED, THINNING], ids=["nested", "exponential"])
def test_path_agrees_with_volpath_in_fog_that_is_not_even(fog, samples, resolves):
    """A bank in fog, and fog that thins with height, over a grey ground."""
    flat = np.array([[-90, -90, -1.5], [90, -90, -1.5], [90, 90, -1.5], [-90, 90, -1.5]])
    ground = {"type": "mesh", "positions": flat, "faces": np.array([[0, 1, 2], [0, 2, 3]]), "bsdf": {"type": "diffuse"}}
    assert_models_agree(scene({**SKY, "shape_ground": ground}, fog, fov_x_deg=50.0), samples=samples, resolves=resolves)


def street(sky=SKY):
    """A wide ground, a wall and a ball under a level slab of fog."""
    flat = np.array([[-800, -800, -1.5], [800, -800, -1.5], [800, 800, -1.5], [-800, 800, -1.5]])
    ground = {
        "type": "mesh",
        "positions": flat,
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.15] * 3}},
    }
    grey = {
        "type": "twosided",
        "bsdf": {"type": "preview_surface", "base_color": {"type": "rgb", "value": [0.5, 0.3, 0.1]}, "roughness": 0.3},
    }
    world = {
        **sky,
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


def test_fog_of_no_density_is_clear_air():
    """sigma_t 0 gives the numbers of the scene without fog, within rounding."""
    world = {**SKY, "shape_ground": wall(30.0, 5.0, bsdf={"type": "diffuse"})}
    clear, empty = (
        render(scene(world), samples=64),
        render(scene(world, [FogVolume("/Fog", box(100.0), FogMedium(0.0))]), samples=64),
    )
    sigma = np.sqrt(
        clear.radiance.variance.mean() / clear.radiance.pixels.size
        + empty.radiance.variance.mean() / empty.radiance.pixels.size
    )
    assert abs(clear.radiance.pixels.mean() - empty.radiance.pixels.mean()) < 5 * sigma + 1e-6


@pytest.mark.parametrize("samples, resolves", [(512, 0.06), pytest.param(2048, 0.03, marks=pytest.mark.slow)])
def test_a_bank_inside_fog_dims_with_both(samples, resolves):
    """0.3 per metre inside 0.03 per metre: without the outer fog behind the bank the wall would be 29 % too bright."""
    outer = FogVolume("/Outer", box(200.0), FogMedium(0.03, albedo=0.0))
    bank = FogVolume("/Bank", box((50, 2.5, 50), (0, 10, 0)), FogMedium(0.3, albedo=0.0), priority=1, parent=0)
    world = scene({"shape_wall": wall(20.0, **black(1.0))}, [outer, bank], fov_x_deg=1.0)
    assert_mean(pictures(world, samples=samples), np.exp(-(0.03 * 15 + 0.3 * 5)), resolves=resolves)


@pytest.mark.parametrize("model", MODELS)
def test_the_same_seed_gives_the_same_bytes(model):
    """And another seed does not."""
    world = scene({**SKY, "shape_wall": wall(50.0, bsdf={"type": "diffuse"})}, [uniform_fog()])
    first, again, other = by_seed(world, (1, 1, 2), samples=32, model=model)
    assert first.radiance.pixels.tobytes() == again.radiance.pixels.tobytes()
    assert first.radiance.variance.tobytes() == again.radiance.variance.tobytes()
    assert first.radiance.pixels.tobytes() != other.radiance.pixels.tobytes()


def test_bytes_do_not_depend_on_how_much_is_in_flight(monkeypatch):
    """Lanes for 1000 chunks at once, or for 100: the same bytes."""
    world = lamps_in_fog(0.87, BOX)
    first = render(world, samples=64, model="path")
    monkeypatch.setattr(accumulator, "CHUNKED_LANES", 100)
    again = render(world, samples=64, model="path")
    assert first.radiance.pixels.tobytes() == again.radiance.pixels.tobytes()
    assert first.radiance.variance.tobytes() == again.radiance.variance.tobytes()


def test_bytes_do_not_depend_on_how_many_pixels_a_lane_takes(monkeypatch):
    """A lane for each, one lane for all, or seven that share them unevenly: the same bytes."""
    world = lamps_in_fog(0.87, BOX)
    pictures = []
    for paths, lanes in ((1, 1), (1 << 20, 1), (1 << 20, 7)):
        monkeypatch.setattr(tasks, "PATHS", paths)
        monkeypatch.setattr(tasks, "LEAST_LANES", lanes)
        pictures.append(render(world, samples=2, model="path"))
    for other in pictures[1:]:
        assert other.radiance.pixels.tobytes() == pictures[0].radiance.pixels.tobytes()
        assert other.radiance.variance.tobytes() == pictures[0].radiance.variance.tobytes()


@pytest.mark.parametrize(
    ("pdf", "other", "weight"),
    [(3.0, 4.0, 9 / 25), (0.0, 1.0, 0.0), (1.0, 0.0, 1.0), (np.inf, 1.0, 1.0), (1.0, np.inf, 0.0), (1e25, 1e25, 0.5)],
)
def test_the_power_heuristic_is_a_number_for_every_density(pdf, other, weight):
    """p^2 / (p^2 + q^2), of densities whose squares float32 does not hold too."""
    mi = backend.mitsuba()
    assert next_event.mis_weight(mi.Float(pdf), mi.Float(other))[0] == pytest.approx(weight, rel=1e-6)


def test_samples_that_are_added_in_parts_are_those_of_all_at_once():
    """8, then 20, then 36 more give what 64 give, up to rounding, and no lane lies in two runs of Sobol's points: where
    it does, the lanes are others and with them the variance.
    """
    world = lamps_in_fog(0.87, BOX)
    integrator = models.make("path", load(world, boundaries=False))
    pixels = world.camera.width_px * world.camera.height_px
    parted, whole = (accumulator.new_accumulator(integrator, pixels) for _ in range(2))
    for count in (8, 20, 36):
        accumulator.add_samples(parted, integrator, np.arange(pixels), parted.even(count), 5)
    accumulator.add_samples(whole, integrator, np.arange(pixels), whole.even(64), 5)
    np.testing.assert_allclose(parted.mean(), whole.mean(), rtol=1e-4, atol=1e-6 * whole.mean().mean())
    for estimator in parted.estimators.values():
        assert (estimator.counts == 32).all() and (estimator.lanes == 2 * 4).all()  # a half: 4, 10, 2, then 16


def test_lamps_cost_all_other_light_nothing():
    """The sky's estimators are the same numbers with a lamp that casts no shadow and without, however bright it is."""
    lit = lamps_in_fog(0.87, BOX)
    unlit = {**SKY, **{name: lit.world[name] for name in ("shape_ground", "shape_ball")}}
    point = {"type": "point", "position": [2.0, 12.0, 3.0], "intensity": {"type": "rgb", "value": [1e4] * 3}}
    found = []
    for world in (unlit, {**unlit, "light_point": point}):
        integrator = models.make("path", load(replace(lit, world=world, instance_of={}, group_of={}), boundaries=False))
        pixels = np.arange(lit.camera.width_px * lit.camera.height_px)
        picture = accumulator.new_accumulator(integrator, len(pixels))
        names = accumulator.SURFACE, accumulator.INSCATTERED
        accumulator.add_samples(picture, integrator, pixels, dict.fromkeys(names, 8), 5)
        found.append(np.array([picture.estimators[name].mean() for name in names]))
    assert accumulator.INSCATTERED_OF_LAMPS in integrator.estimators
    np.testing.assert_allclose(found[1], found[0], rtol=1e-5, atol=1e-6)


def test_samples_go_where_variance_over_cost_is():
    """n ~ sqrt(variance / cost) at the cost that was asked for: of two estimators alike but for nine times the variance
    one gets three times the samples, and what is there already counts.
    """
    world = lamps_in_fog(0.87, BOX)
    integrator = models.make("path", load(world, boundaries=False))
    pixels = world.camera.width_px * world.camera.height_px
    picture = accumulator.new_accumulator(integrator, pixels)
    accumulator.add_samples(picture, integrator, np.arange(pixels), picture.even(16), 5)
    weight = {name: 1.0 for name in picture.estimators} | {accumulator.SURFACE: 3.0}
    share = accumulator._filled(weight, dict.fromkeys(weight, 0), 100.0)
    assert share[accumulator.SURFACE] == pytest.approx(3.0 * share[accumulator.LAMPS])
    assert sum(accumulator.ESTIMATOR_COST[name] * count for name, count in share.items()) == pytest.approx(100.0)
    more = accumulator.allocation(picture, 64)
    spent = sum(accumulator.ESTIMATOR_COST[name] * (16 + count) for name, count in more.items())
    asked = 64 * sum(accumulator.ESTIMATOR_COST[name] for name in more)
    assert spent == pytest.approx(asked, rel=0.2) and all(count % accumulator.CHUNK == 0 for count in more.values())


def test_light_groups_of_what_will_be_denoised_are_kept_in_squares_of_two_pixels():
    """They are the means of the pixels' own light by the same samples, at a border of one odd row and column too; what
    the eye sees of lamps stays pixel by pixel.
    """
    world = lamps_in_fog(0.87, BOX)
    width, height = 15, 9
    shining = [key for key, part in world.world.items() if key.startswith("light_") or "emitter" in part]
    world = replace(world, group_of=dict(zip(shining, "abc" * len(shining), strict=False)))
    integrator = models.make("path", load(world, size=(width, height), boundaries=False))
    pixels = np.arange(width * height)
    whole, cut = (accumulator.new_accumulator(integrator, len(pixels), denoised=denoised) for denoised in (False, True))
    for picture in (whole, cut):
        accumulator.add_samples(picture, integrator, pixels, picture.even(4), 5)
    for _ in range(integrator.groups):
        fine, coarse = whole.take_group(), cut.take_group(accumulator.Squares(width, height))
        np.testing.assert_allclose(coarse[accumulator.DIRECT], fine[accumulator.DIRECT], rtol=1e-6)
        for name in (accumulator.SURFACE, accumulator.LAMPS):
            light = fine[name].reshape(height, width, 3)
            wanted = [
                light[row : row + 2, column : column + 2].mean(axis=(0, 1), dtype=np.float64)
                for row in range(0, height, 2)
                for column in range(0, width, 2)
            ]
            np.testing.assert_allclose(coarse[name], wanted, rtol=1e-5, atol=1e-7)
    assert not whole.estimators[accumulator.SURFACE].groups and not cut.estimators[accumulator.SURFACE].groups


@pytest.mark.parametrize("lit", [False, True])
def test_what_memory_a_picture_is_said_to_take_is_more_than_what_is_kept_of_its_samples(lit):
    """Counted in the arrays themselves, with three light groups and without; denoising and writing take as much again,
    and not ten times as much.
    """
    world = lamps_in_fog(0.87, BOX) if lit else scene({**SKY, "shape_wall": wall(50.0)}, [uniform_fog()])
    if lit:
        shining = [key for key, part in world.world.items() if key.startswith("light_") or "emitter" in part]
        world = replace(world, group_of=dict(zip(shining, "abc" * len(shining), strict=False)))
    pixels = world.camera.width_px * world.camera.height_px
    kept = accumulator.new_accumulator(models.make("path", load(world, boundaries=False)), pixels, denoised=True)
    held = sum(
        array.nbytes
        for part in kept.estimators.values()
        for array in (*part.aovs.values(), part.squares, *part.groups, part.counts, part.lanes)
    )
    said = picture_bytes(world, Settings(denoise=True))
    assert held < said < 10 * held


@pytest.mark.parametrize("model", ["path", pytest.param("volpath", marks=pytest.mark.slow)])
def test_the_variance_is_that_of_the_mean(model):
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


def test_an_unknown_model_is_refused_with_the_known_ones():
    """The message names what exists."""
    with pytest.raises(ParameterError, match="volpath"):
        render(scene(SKY), model="volpth")


@pytest.mark.parametrize("samples", [0, 1, -5, 1 << 21])
def test_a_number_of_samples_out_of_range_is_refused(samples):
    """One sample has no variance; two million are a slip of the keyboard."""
    with pytest.raises(ParameterError, match="--samples"):
        render(scene(SKY), samples=samples)

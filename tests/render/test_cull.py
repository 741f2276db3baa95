"""What fog hides is simplified or left out, and no pixel of a sensor shows it."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from synfog_usd import camera, cull
from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load
from synfog_usd.scene import Instance
from synfog_usd.testing import scene

SIGMA = 0.06
NOISE = functools.partial(camera.noise_floor, electrons_per_cd_m2=1.0, dark_noise_e=5.0)
CLEAR = np.full((9, 16), 1000.0)
"""1000 electrons: sigma is 3.2 % of the light, and edges go at T = 0.05 x 0.032 = 0.0016, 107 m."""

FOG = FogVolume("/Fog", Boundary("box", np.diag([500.0, 500.0, 100.0, 1.0])), FogMedium(SIGMA))
SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1000.0] * 3}}}

SUN = {"light_sun": {"type": "directional", "irradiance": {"type": "rgb", "value": [9e4] * 3}, "to_world": np.eye(4)}}


def ball(distance_m, *, radius_m=2.0, subdivisions=4, **more):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_m).apply_translation((0, distance_m, 0))
    return {
        "type": "mesh",
        "positions": np.asarray(mesh.vertices),
        "faces": np.asarray(mesh.faces),
        "bsdf": {"type": "ref", "id": "mat_a"},
        **more,
    }


def avenue(*distances_m, light=SKY, fog=(FOG,), **more):
    """Balls straight ahead, each with an id, and one in an instance beside the last."""
    balls = {f"shape_{distance:g}": ball(distance) for distance in distances_m}
    far = np.eye(4)
    far[:3, 3] = 10.0, distances_m[-1], 0.0
    world = {
        "mat_a": {"type": "twosided", "bsdf": {"type": "diffuse"}},
        "mat_far": {"type": "diffuse"},
        **balls,
        "group_ball": {"type": "shapegroup", "skin": {**ball(0.0), "bsdf": {"type": "ref", "id": "mat_far"}}},
        "instance_0": {"type": "instance", "group": {"type": "ref", "id": "group_ball"}, "to_world": far},
        **light,
        **more,
    }
    instance_of = {(key,): number for number, key in enumerate(balls, 1)} | {("instance_0", "skin"): len(balls) + 1}
    instances = tuple(Instance(number, f"/World/{key[0]}", "car") for key, number in instance_of.items())
    return replace(
        scene(world, list(fog), width_px=16, height_px=9, fov_x_deg=40.0), instances=instances, instance_of=instance_of
    )


def hide(source, clear=CLEAR):
    return cull.hide(source, NOISE, clear, worth=1000)


def test_transmittance_is_of_the_nearest_point_of_a_box():
    """T = exp(-sigma d): a ball of radius 2 m at 50 m begins at 48 m."""
    hidden = hide(avenue(50.0, 200.0))
    assert hidden.transmittance["shape_50"] == pytest.approx(np.exp(-SIGMA * 48.0), rel=1e-6)
    assert hidden.transmittance["shape_200"] == pytest.approx(np.exp(-SIGMA * 198.0), rel=1e-6)


def test_transmittance_finds_the_thinnest_way_to_a_tower_that_rises_out_of_the_fog():
    """Of a mast that stands 200 m off in fog 10 m deep, the top is seen through 10 m / sin of it: as steep as it is
    high.
    """
    shallow = replace(
        FOG, boundary=Boundary("box", np.array([[500, 0, 0, 0], [0, 500, 0, 0], [0, 0, 10, 0], [0, 0, 0, 1.0]]))
    )
    mast = ball(200.0)
    mast["positions"] = np.array([[0, 200, 0], [1, 200, 0], [0, 200, 400], [1, 200, 400.0]])
    mast["faces"] = np.array([[0, 1, 2], [1, 3, 2]])
    hidden = hide(avenue(50.0, fog=(shallow,), shape_mast=mast))
    assert hidden.transmittance["shape_mast"] == pytest.approx(
        np.exp(-SIGMA * 10.0 * np.hypot(200, 400) / 400.0), rel=1e-6
    )


def test_a_grid_of_density_hides_as_much_as_even_fog_does():
    """A density of 1 everywhere is even fog."""
    grid = replace(FOG, medium=FogMedium(SIGMA, profile="grid", grid=DensityGrid(np.ones((2, 2, 2)))))
    even, dense = hide(avenue(100.0, 115.0)), hide(avenue(100.0, 115.0, fog=(grid,)))
    assert even.transmittance == pytest.approx(dense.transmittance) and even.simplified == dense.simplified


def test_what_is_hidden_is_what_the_sensor_s_noise_says():
    """The limit is a twentieth of sigma / L; a quieter sensor sees farther."""
    source = avenue(100.0, 115.0, 200.0)
    hidden = hide(source)
    assert hidden.limit == pytest.approx(0.05 * np.sqrt(1000.0 + 25.0) / 1000.0, rel=1e-6)
    assert hidden.simplified | hidden.left_out == {"shape_115", "shape_200", "instance_0"}
    quiet = cull.hide(source, lambda luminance: 0.1 * NOISE(luminance), CLEAR, worth=1000)
    assert quiet.simplified | quiet.left_out == {"shape_200", "instance_0"}


def test_only_what_is_small_and_far_is_left_out():
    """Behind the same fog a small ball goes and a wide one, which darkens the fog before it, is simplified."""
    near, far, wide = ball(130.0, radius_m=0.2), ball(350.0), ball(160.0, radius_m=40.0)
    hidden = hide(avenue(20.0, shape_small=near, shape_far=far, shape_wide=wide))
    assert {"shape_small", "shape_far"} <= hidden.left_out
    assert "shape_wide" in hidden.simplified


@pytest.mark.parametrize(
    "light",
    [
        SUN,
        {
            "light_sky": {
                "type": "envmap",
                "bitmap": np.where(np.arange(512).reshape(16, 32, 1) == 100, 1e6, 1e3) * np.ones(3),
                "to_world": np.eye(4),
            }
        },
    ],
)
def test_under_a_sun_nothing_is_left_out_wholly(light):
    """A shadow in fog is as sharp as the sun, so what throws it stays, simplified."""
    hidden = hide(avenue(200.0, 350.0, light={**SKY, **light}))
    assert hidden.simplified == {"shape_200", "shape_350", "instance_0"} and not hidden.left_out


def lamp(distance_m, intensity, x=0.0):
    return {
        "light_lamp": {
            "type": "point",
            "position": [x, distance_m, 0.0],
            "intensity": {"type": "rgb", "value": [intensity] * 3},
        }
    }


def test_what_a_lamp_lights_up_is_not_hidden():
    """A ball 2 m from 10^7 cd sends 10^6 cd m-2, of which a thousandth is seen; the same lamp far away changes
    nothing.
    """
    source = avenue(115.0, 120.0, 200.0)
    lit = replace(source, world={**source.world, **lamp(118.0, 1e7, x=-6.0)})
    assert hide(lit).simplified == {"shape_200", "instance_0"}
    away = replace(source, world={**source.world, **lamp(118.0, 1e7, x=-300.0)})
    assert hide(away).simplified == {"shape_115", "shape_120", "shape_200", "instance_0"}


def test_what_stands_before_a_lamp_that_would_be_seen_stays():
    """10^11 cd at 300 m are 8 cd m-2 in a pixel, of which 3 are seen: balls before them stay, the one beside does
    not.
    """
    source = avenue(120.0, 125.0, 200.0)
    hidden = hide(replace(source, world={**source.world, **lamp(300.0, 1e11)}))
    assert "shape_120" not in hidden.simplified and "instance_0" in hidden.simplified


def test_what_shines_itself_stays():
    """A lit face is no part of what may go, however thick the fog."""
    lit = ball(250.0, emitter={"type": "area", "radiance": {"type": "rgb", "value": [1.0] * 3}})
    hidden = hide(avenue(200.0, shape_lit=lit))
    assert "shape_lit" not in hidden.simplified | hidden.left_out and "shape_200" in hidden.simplified


@pytest.mark.parametrize(("fog", "why"), [((), "there is no fog"), ("mesh", "no closed form"), ("thin", "too little")])
def test_where_nothing_is_hidden_it_says_why(fog, why):
    """Clear air, a free boundary, and fog too thin to hide anything."""
    if fog == "mesh":
        shell = trimesh.creation.box(extents=(900, 900, 90))
        fog = (replace(FOG, boundary=Boundary("mesh", np.eye(4), np.asarray(shell.vertices), np.asarray(shell.faces))),)
    elif fog == "thin":
        fog = (replace(FOG, medium=FogMedium(0.005)),)
    hidden = hide(avenue(50.0, 200.0, fog=fog))
    assert why in hidden.why and not hidden.simplified | hidden.left_out and hidden.sentence(avenue(50.0)) == ""


def test_a_simplified_mesh_keeps_its_area_with_a_tenth_of_its_faces():
    """Area is kept on average: over 20 draws to 1 %, with 2048 of 20 480 even faces, whose sum scatters by 2 % a
    draw.
    """
    whole = ball(0.0, subdivisions=5)
    areas, counts = [], []
    for draw in range(20):
        thin = cull.simplified(whole, f"draw {draw}")
        areas.append(trimesh.Trimesh(thin["positions"], thin["faces"], process=False).area)
        counts.append(len(thin["faces"]))
    assert np.mean(counts) == pytest.approx(2048, rel=0.02)
    assert np.mean(areas) == pytest.approx(trimesh.Trimesh(whole["positions"], whole["faces"]).area, rel=0.01)


def test_thinning_keeps_a_wall_and_thins_its_ivy():
    """Faces far larger than the rest are certain to stay, and as they are."""
    wall = trimesh.Trimesh([[-5, 0, 0], [5, 0, 0], [5, 0, 8], [-5, 0, 8]], [[0, 1, 2], [0, 2, 3]])
    ivy = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    both = trimesh.util.concatenate([wall, ivy])
    thin = cull.simplified({"type": "mesh", "positions": both.vertices, "faces": both.faces}, "wall")
    np.testing.assert_allclose(
        np.sort(trimesh.Trimesh(thin["positions"], thin["faces"], process=False).area_faces)[-2:], 40.0
    )
    assert len(thin["faces"]) == pytest.approx(512, rel=0.15)


def test_corners_keep_their_texture_and_normals():
    """Each kept face has the texture coordinates and normals of its own corners, and its middle where it was."""
    mesh = ball(0.0)
    mesh["texcoords"], mesh["normals"] = mesh["positions"][:, :2] * 0.1, mesh["positions"] / 2.0
    thin = cull.simplified(mesh, "skin")
    corners, normals = thin["positions"][thin["faces"]], thin["normals"][thin["faces"]]
    free = np.all(np.abs(corners) < 1.999, axis=(1, 2))  # not cut by the ball's box
    assert free.mean() > 0.9
    np.testing.assert_allclose(corners.mean(axis=1)[free], 2.0 * normals.mean(axis=1)[free], atol=1e-9)
    np.testing.assert_allclose(thin["texcoords"][thin["faces"]], 0.2 * normals[..., :2], atol=1e-9)


def test_the_reduced_scene_has_what_its_record_says_and_nothing_unused():
    """Triangles, materials and instances agree with the record; the renderer takes it; each instance is still
    listed.
    """
    source = avenue(20.0, 350.0, shape_wide=ball(160.0, radius_m=40.0))
    source = replace(
        source,
        instance_of={**source.instance_of, ("shape_wide",): 4},
        instances=(*source.instances, Instance(4, "/World/Wide", "car")),
    )
    hidden = hide(source)
    small = cull.reduced(source, hidden)
    assert hidden.left_out == {"shape_350", "instance_0"} and hidden.simplified == {"shape_wide"}
    assert set(small.world) == {"type", "mat_a", "shape_20", "shape_wide", "light_sky"}
    faces = sum(len(small.world[key]["faces"]) for key in ("shape_20", "shape_wide"))
    assert faces == pytest.approx(hidden.of_triangles - hidden.triangles, abs=60)  # drawn at random, 512 on average
    assert load(small, boundaries=False).shapes
    found = hidden.instances(source)
    assert [state for _, state in found.values()] == ["whole", "left out", "left out", "simplified"]
    assert found[2][0] == pytest.approx(np.exp(-SIGMA * 348.0)) and hidden.sentence(source).startswith(
        "3 of 4 instances lie behind fog (T < 0.0016)"
    )
    assert small.instances == source.instances


def test_instances_of_one_prototype_share_their_simplified_one():
    """A near instance keeps the whole prototype, far ones take another, made once."""
    source = avenue(120.0, light={**SKY, **SUN})
    near, beside = np.eye(4), np.eye(4)
    near[:3, 3], beside[:3, 3] = (5.0, 20.0, 0.0), (-10.0, 125.0, 0.0)
    more = {
        f"instance_{name}": {**source.world["instance_0"], "to_world": matrix}
        for name, matrix in (("near", near), ("beside", beside))
    }
    source = replace(source, world={**source.world, **more})
    small = cull.reduced(source, hide(source))
    refers = {key: small.world[key]["group"]["id"] for key in ("instance_0", "instance_near", "instance_beside")}
    assert refers == {
        "instance_0": "group_ball_simplified",
        "instance_near": "group_ball",
        "instance_beside": "group_ball_simplified",
    }
    assert len(small.world["group_ball_simplified"]["skin"]["faces"]) < 0.2 * len(
        small.world["group_ball"]["skin"]["faces"]
    )


def test_the_transmittance_aov_is_that_of_the_whole_scene():
    """What was left out still stands in the AOV: it equals that of a scene with everything in it."""
    source = avenue(20.0, 130.0, 140.0)
    hidden = hide(source)
    assert hidden.simplified | hidden.left_out
    clear = aovs.measure(load(replace(source, fog=()), boundaries=False))
    whole = aovs.measure(load(source, boundaries=False))
    seen = aovs.seen_through(load(cull.reduced(source, hidden), boundaries=False), clear)
    np.testing.assert_array_equal(seen.transmittance, whole.transmittance)
    np.testing.assert_array_equal(seen.instance_id, whole.instance_id)

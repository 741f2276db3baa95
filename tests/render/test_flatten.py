"""Joined meshes are the meshes that they were joined from, and so are prototypes that are traced where they stand."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from support.parts import glow, rgb

from synfog_usd.render import flatten, surface
from synfog_usd.render.film import aovs
from synfog_usd.render.placed import PlacedScene
from synfog_usd.render.shot import load, render
from synfog_usd.scene.testing import scene, sky


def part(mesh, material, **more):
    return {
        "type": "mesh",
        "positions": np.asarray(mesh.vertices),
        "faces": np.asarray(mesh.faces),
        "bsdf": {"type": "ref", "id": material},
        **more,
    }


def village():
    """Instances that are turned, mirrored and stretched, and loose meshes, of two materials; some smooth."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    world = {f"mat_{name}": {"type": "twosided", "bsdf": {"type": "diffuse"}} for name in "ab"}
    world["group_house"] = {
        "type": "shapegroup",
        "walls": part(trimesh.creation.box(extents=(2, 2, 2)), "mat_a"),
        "dome": part(ball.copy().apply_translation((0, 0, 1)), "mat_b", normals=np.asarray(ball.vertex_normals)),
    }
    turn = trimesh.transformations.rotation_matrix
    places = [
        turn(0.4, (0, 0, 1)) @ np.diag([1, 1, 1, 1.0]),
        np.diag([-1, 1, 1, 1.0]) @ turn(0.9, (1, 1, 0)),
        np.diag([0.5, 1.5, 2.0, 1]),
    ]
    instance_of = {}
    for index, matrix in enumerate(places):
        matrix = matrix.copy()
        matrix[:3, 3] = (-6 + 6 * index, 30, 0)
        world[f"instance_{index}"] = {
            "type": "instance",
            "group": {"type": "ref", "id": "group_house"},
            "to_world": matrix,
        }
        instance_of |= {(f"instance_{index}", "walls"): 10 + index, (f"instance_{index}", "dome"): 20 + index}
    world["shape_loose"] = part(trimesh.creation.box(extents=(40, 1, 1)).apply_translation((0, 40, -2)), "mat_a")
    instance_of[("shape_loose",)] = 7
    return replace(scene(world, width_px=160, height_px=90, fov_x_deg=40.0), instance_of=instance_of)


def test_joined_instances_look_like_the_renderer_s_own(monkeypatch):
    """Depth, normals and label ids of joined meshes equal those of Mitsuba's instances, but for rounding at edges."""
    joined = aovs.measure(load(village()))
    monkeypatch.setattr(flatten, "MAX_TRIANGLES", 0)
    own = aovs.measure(load(village()))
    assert set(np.unique(own.instance_id)) == {0, 7, 10, 11, 12, 20, 21, 22}
    same = joined.instance_id == own.instance_id
    assert np.count_nonzero(~same) <= 3  # of 14 400 pixels
    seen = same & np.isfinite(own.depth_m)
    np.testing.assert_allclose(joined.depth_m[seen], own.depth_m[seen], rtol=2e-5)
    np.testing.assert_allclose(joined.normal[seen], own.normal[seen], atol=2e-4)


def painted():
    """Four boxes: three of plain colours, the last of which has a spectrum of its own, and one with a picture."""

    def paint(colour):
        return {"type": "twosided", "bsdf": {"type": surface.TYPE, "base_color": colour, "roughness": 0.5}}

    colours = {name: rgb(0.2 * n, 0.5, 0.5) for n, name in enumerate(("red", "grey", "car"))}
    picture = {"type": "bitmap", "bitmap": np.zeros((2, 2, 3), dtype=np.float32)}
    world = {f"mat_{name}": paint(colour) for name, colour in (colours | {"wall": picture}).items()}
    for n, name in enumerate(("grey", "wall", "red", "car")):
        world[f"shape_{n}"] = part(trimesh.creation.box(), f"mat_{name}")
    return replace(scene(world), reflectance_of={"mat_car": np.full(401, 0.5)})


def test_plain_surfaces_are_joined_and_each_face_knows_its_own():
    """Red and grey are one mesh whose faces tell their colours; the car's spectrum and the wall's picture keep theirs
    apart, and without spectra the car's is joined too.
    """
    source = painted()
    for bare, wanted in ((source, ["grey", "red"]), (replace(source, reflectance_of={}), ["grey", "red", "car"])):
        flat, _, _ = flatten.flatten(bare)
        (one,) = (value for value in flat.world.values() if isinstance(value, dict) and "rows" in value.get("bsdf", ()))
        colours = one["bsdf"]["rows"][one["bsdf"]["row_of_face"], :3]
        own = [source.world[f"mat_{name}"]["bsdf"]["base_color"]["value"] for name in wanted]
        np.testing.assert_array_equal(colours, np.repeat(np.array(own, dtype=np.float32), 12, axis=0))
        left = {key for key in flat.world if key.startswith("mat_")}
        assert left == {"mat_wall", "mat_car"} - {f"mat_{name}" for name in wanted}
    assert "mat_car" in load(source).source.world and "mat_car" not in load(source, spectra=False).source.world


def lit_village():
    """Houses turned, mirrored and stretched, a loose mesh, a ball of the renderer's own, a lamp with a face, a sky."""
    source = village()
    lamp = {
        **part(trimesh.creation.box(extents=(1, 1, 0.2)).apply_translation((0, 24, 3)), "mat_a"),
        "emitter": glow(40.0, 20.0, 10.0),
    }
    ball = {"type": "sphere", "center": [2.0, 25.0, -1.0], "radius": 0.7, "bsdf": {"type": "ref", "id": "mat_a"}}
    return replace(source, world={**source.world, "shape_lamp": lamp, "shape_ball": ball, **sky(1.0)})


@pytest.fixture
def placing(monkeypatch):
    """Of the houses at 30.6, 30 and 30.6 m, the one in the middle is near."""
    monkeypatch.setattr(flatten, "WORTH_A_PROTOTYPE", 1)
    monkeypatch.setattr(flatten, "FAR_M", 30.3)


def test_labels_are_those_of_mitsuba_s_instances(placing, monkeypatch):
    """Depth, normals and label ids, but for rounding at edges; two of three houses are in the meshes once."""
    loaded = load(lit_village(), boundaries=False)
    assert isinstance(loaded.tree, PlacedScene)
    assert sum(map(len, loaded.face_instances.values())) == 12 + 2 * (12 + 320)  # the loose box, walls and domes
    placed = aovs.measure(loaded)
    monkeypatch.setattr(flatten, "MAX_TRIANGLES", 0)
    own = aovs.measure(load(lit_village()))
    assert set(np.unique(own.instance_id)) == {0, 7, 10, 11, 12, 20, 21, 22}
    same = placed.instance_id == own.instance_id
    assert np.count_nonzero(~same) <= 3  # of 14 400 pixels
    seen = same & np.isfinite(own.depth_m)
    np.testing.assert_allclose(placed.depth_m[seen], own.depth_m[seen], rtol=2e-5)
    np.testing.assert_allclose(placed.normal[seen], own.normal[seen], atol=2e-4)


def test_light_is_that_of_meshes_that_are_written_out(placing, monkeypatch):
    """With the same seed the same paths, but where rounding takes one past an edge."""
    source = lit_village()
    loaded = load(source, boundaries=False)
    placed = render(source, loaded=loaded, model="path", samples=4, seed=3).radiance.pixels
    again = render(source, loaded=load(source, boundaries=False), model="path", samples=4, seed=3).radiance.pixels
    np.testing.assert_array_equal(placed, again)
    monkeypatch.setattr(flatten, "WORTH_A_PROTOTYPE", 1 << 40)
    whole = load(source, boundaries=False)
    assert whole.tree is whole.scene and isinstance(loaded.tree, PlacedScene)
    written = render(source, loaded=whole, model="path", samples=4, seed=3).radiance.pixels
    assert np.mean(np.abs(placed - written).max(axis=2) > 1e-3 * written.max(axis=2)) < 0.01
    np.testing.assert_allclose(placed.mean(), written.mean(), rtol=2e-3)


def test_what_moves_and_what_cannot_be_joined_is_not_placed(placing):
    """Moving things have their vertices moved, and instances with a ball in them stay Mitsuba's own."""
    source = village()
    way = np.broadcast_to(np.eye(4), (1, 2, 4, 4))
    moving = load(replace(source, motion_of={"shape_loose": way}), boundaries=False)
    ball = {"type": "sphere", "bsdf": {"type": "ref", "id": "mat_a"}}
    at = {"type": "instance", "group": {"type": "ref", "id": "group_ball"}, "to_world": np.eye(4)}
    world = {**source.world, "group_ball": {"type": "shapegroup", "ball": ball}, "instance_ball": at}
    mixed = load(replace(source, world=world), boundaries=False)
    for loaded in (moving, mixed):
        assert loaded.tree is loaded.scene
    assert "instance_ball" in mixed.source.world

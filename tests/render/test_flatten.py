"""Joined meshes are the meshes that they were joined from, and so are prototypes that are traced where they stand."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from cycles_scene import export, simplified
from support.calls import calls

from synfog_usd.render import flatten, surface
from synfog_usd.render.film import aovs
from synfog_usd.render.placed import PlacedScene
from synfog_usd.render.shot import load, render
from synfog_usd.scene.testing import scene, sky
from synfog_usd.scene.transmittance import boxes_of


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


def test_what_does_not_fit_stays_instances_of_the_largest_prototypes(monkeypatch):
    """Of three houses of 332 triangles and five posts of 12 beside a mesh of 12, 700 triangles hold all posts and one
    house.

    All instances stayed what they are as soon as one was too many, and each costs a kernel's time.
    """
    source = village()
    post = {"type": "shapegroup", "post": part(trimesh.creation.box(), "mat_a")}
    more = {
        f"instance_p{n}": {"type": "instance", "group": {"type": "ref", "id": "group_post"}, "to_world": np.eye(4)}
        for n in range(5)
    }
    source = replace(source, world={**source.world, "group_post": post, **more})
    monkeypatch.setattr(flatten, "MAX_TRIANGLES", 12 + 5 * 12 + 332 + 100)
    flat, instances, _ = flatten.flatten(source)
    assert [key for key in flat.world if key.startswith("instance_")] == ["instance_1", "instance_2"]
    assert "group_house" in flat.world and "group_post" not in flat.world
    assert sum(len(ids) for ids in instances.values()) == 12 + 5 * 12 + 332


def pairs(count):
    """Instances of a prototype of two meshes of one material, beside each other, every third mirrored; and the same
    meshes, each by itself where it stands.
    """
    sphere = trimesh.creation.icosphere(subdivisions=1)
    two = {"foot": trimesh.creation.box(extents=(1, 1, 2)), "head": sphere}
    world = {"mat_a": {"type": "twosided", "bsdf": {"type": "diffuse"}}}
    loose = dict(world)
    world["group_pair"] = {"type": "shapegroup", **{name: part(mesh, "mat_a") for name, mesh in two.items()}}
    label_of, loose_label_of = {}, {}
    for n in range(count):
        matrix = np.diag([-1.0 if n % 3 == 0 else 1.0, 1.0, 2.0, 1.0])
        matrix[:3, 3] = (3 * n, 30, 0)
        world[f"instance_{n}"] = {
            "type": "instance",
            "group": {"type": "ref", "id": "group_pair"},
            "to_world": matrix,
        }
        for k, (name, mesh) in enumerate(two.items()):
            there = mesh.copy().apply_transform(matrix)  # which turns faces over where it mirrors
            loose[f"shape_{n}_{name}"] = part(there, "mat_a")
            label_of[f"instance_{n}", name] = loose_label_of[(f"shape_{n}_{name}",)] = 2 * n + k + 1
    return (
        replace(scene(world), instance_of=label_of),
        replace(scene(loose), instance_of=loose_label_of),
    )


def test_prototypes_of_several_meshes_are_written_out_place_by_place():
    """As if each mesh of each place had been joined by itself: in one order, with the same labels, none inside out."""
    (together, labels, _), (alone, labels_alone, _) = map(flatten.flatten, pairs(7))
    one, other = (flat.world["shape_joined_0"] for flat in (together, alone))
    np.testing.assert_allclose(one["positions"], other["positions"], atol=1e-5)
    np.testing.assert_array_equal(labels["shape_joined_0"], labels_alone["shape_joined_0"])
    assert list(dict.fromkeys(labels["shape_joined_0"].tolist())) == list(range(1, 15))
    corners = [mesh["positions"][mesh["faces"]] for mesh in (one, other)]
    normals = [np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]) for c in corners]
    np.testing.assert_allclose(*normals, atol=1e-4)


@pytest.mark.parametrize("work, most", [(flatten.flatten, 40), (lambda source: boxes_of(source.world), 22)])
def test_a_further_instance_takes_few_calls(work, most):
    """Of a prototype of two meshes; it was 148 to join it and 32 to find its box, which 750 000 instances made 10 s."""
    few, many = pairs(20)[0], pairs(220)[0]
    work(few)
    assert calls(work, many) - calls(work, few) < 200 * most


def test_what_goes_to_cycles_has_every_face_where_it_stands(tmp_path):
    """Files for Blender hold the village's 4 boxes and 3 balls, as large as it is, of one grey without a lamp."""
    flat, *_ = flatten.flatten(village())
    export(simplified(village()), tmp_path / "village")
    sent = np.load(tmp_path / "village.npz")
    assert len(sent["faces"]) == len(sent["material"]) == 4 * 12 + 3 * 320
    points = np.concatenate([mesh["positions"] for key, mesh in flat.world.items() if key.startswith("shape_")])
    met = sent["positions"][sent["faces"]].reshape(-1, 3)
    np.testing.assert_allclose([met.min(axis=0), met.max(axis=0)], [points.min(axis=0), points.max(axis=0)], atol=1e-5)
    told = json.loads((tmp_path / "village.json").read_text(encoding="utf-8"))
    assert told["lamps"] == [] and told["fog"] is None and len(told["materials"]) == 1


def test_joining_leaves_one_mesh_a_material_and_keeps_every_face():
    """Two materials, one of them smooth: two meshes; faces and their instances are all there."""
    flat, instances, _ = flatten.flatten(village())
    meshes = {key: value for key, value in flat.world.items() if key.startswith("shape_")}
    assert len(meshes) == 2 and not [key for key in flat.world if key.startswith(("instance_", "group_"))]
    assert {key: len(value["faces"]) for key, value in meshes.items()} == {
        key: len(ids) for key, ids in instances.items()
    }
    assert sum(len(ids) for ids in instances.values()) == 4 * 12 + 3 * 320
    counts = np.unique(np.concatenate(list(instances.values())), return_counts=True)
    assert dict(zip(*(column.tolist() for column in counts), strict=True)) == {
        7: 12,
        10: 12,
        11: 12,
        12: 12,
        20: 320,
        21: 320,
        22: 320,
    }


def test_what_cannot_be_joined_stays():
    """A ball of the renderer's own, a lamp, and a mesh with a material of its own are left as they are."""
    lamp = {
        **part(trimesh.creation.box(), "mat_a"),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
    }
    own = {**part(trimesh.creation.box(), "mat_a"), "bsdf": {"type": "diffuse"}}
    world = {
        "mat_a": {"type": "diffuse"},
        "shape_ball": {"type": "sphere", "bsdf": {"type": "ref", "id": "mat_a"}},
        "shape_lamp": lamp,
        "shape_own": own,
    }
    flat, instances, _ = flatten.flatten(scene(world))
    assert flat.world == {"type": "scene", **world} and not instances


def painted():
    """Four boxes: three of plain colours, the last of which has a spectrum of its own, and one with a picture."""

    def paint(colour):
        return {"type": "twosided", "bsdf": {"type": surface.TYPE, "base_color": colour, "roughness": 0.5}}

    colours = {name: {"type": "rgb", "value": [0.2 * n, 0.5, 0.5]} for n, name in enumerate(("red", "grey", "car"))}
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
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [40.0, 20.0, 10.0]}},
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


def test_small_prototypes_are_written_out(placing, monkeypatch):
    """A place costs more than few triangles do: a house has 12 and 320."""
    monkeypatch.setattr(flatten, "LEAST_TRIANGLES", 332)
    assert isinstance(load(lit_village(), boundaries=False).tree, PlacedScene)
    monkeypatch.setattr(flatten, "LEAST_TRIANGLES", 333)
    loaded = load(lit_village(), boundaries=False)
    assert loaded.tree is loaded.scene
    assert sum(map(len, loaded.face_instances.values())) == 12 + 3 * (12 + 320)


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

"""How much of each instance the fog lets through: closed forms, and what a bake lists."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from support.stages import street

from synfog_usd.dataset.job import bake
from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.fog.grid import DensityGrid
from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load
from synfog_usd.scene import Instance
from synfog_usd.scene.testing import scene
from synfog_usd.scene.transmittance import of_instances

SIGMA = 0.06
FOG = FogVolume("/Fog", Boundary("box", np.diag([500.0, 500.0, 100.0, 1.0])), FogMedium(SIGMA))


def ball(distance_m):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=2.0).apply_translation((0, distance_m, 0))
    return {
        "type": "mesh",
        "positions": np.asarray(mesh.vertices),
        "faces": np.asarray(mesh.faces),
        "bsdf": {"type": "ref", "id": "mat_a"},
    }


def avenue(*distances_m, fog=(FOG,), **more):
    """Balls straight ahead, each with an id, and one in an instance 10 m beside the last; `more` are further shapes."""
    shapes = {f"shape_{distance:g}": ball(distance) for distance in distances_m} | more
    far = np.eye(4)
    far[:3, 3] = 10.0, distances_m[-1], 0.0
    world = {
        "mat_a": {"type": "twosided", "bsdf": {"type": "diffuse"}},
        **shapes,
        "group_ball": {"type": "shapegroup", "skin": ball(0.0)},
        "instance_0": {"type": "instance", "group": {"type": "ref", "id": "group_ball"}, "to_world": far},
        "light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1000.0] * 3}},
    }
    instance_of = {(key,): number for number, key in enumerate(shapes, 1)} | {("instance_0", "skin"): len(shapes) + 1}
    instances = tuple(Instance(number, f"/World/{key[0]}", "car") for key, number in instance_of.items())
    return replace(
        scene(world, list(fog), width_px=16, height_px=9, fov_x_deg=40.0), instances=instances, instance_of=instance_of
    )


def test_transmittance_is_of_the_nearest_point_of_a_box():
    """T = exp(-sigma d): a ball of radius 2 m at 50 m begins at 48 m, and one 10 m aside at (8, 198) m."""
    found = of_instances(avenue(50.0, 200.0))
    assert found == pytest.approx(
        {1: np.exp(-SIGMA * 48.0), 2: np.exp(-SIGMA * 198.0), 3: np.exp(-SIGMA * np.hypot(8.0, 198.0))}, rel=1e-6
    )


def test_an_instance_of_several_parts_has_the_largest_of_theirs():
    """What is seen of it is seen there."""
    source = avenue(50.0, 200.0)
    one = dict.fromkeys(source.instance_of, 1)
    assert of_instances(replace(source, instance_of=one)) == pytest.approx({1: np.exp(-SIGMA * 48.0)}, rel=1e-6)


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
    found = of_instances(avenue(50.0, fog=(shallow,), shape_mast=mast))
    assert found[2] == pytest.approx(np.exp(-SIGMA * 10.0 * np.hypot(200, 400) / 400.0), rel=1e-6)


def test_a_grid_of_density_hides_as_much_as_even_fog_does():
    """A density of 1 everywhere is even fog."""
    grid = replace(FOG, medium=FogMedium(SIGMA, profile="grid", grid=DensityGrid(np.ones((2, 2, 2)))))
    assert of_instances(avenue(100.0, 115.0)) == pytest.approx(of_instances(avenue(100.0, 115.0, fog=(grid,))))


def test_without_fog_it_is_one_and_within_a_free_boundary_it_is_not_known():
    """Clear air; a mesh, whose transmittance has no closed form; parallel rays."""
    assert set(of_instances(avenue(50.0, 200.0, fog=())).values()) == {1.0}
    shell = trimesh.creation.box(extents=(900, 900, 90))
    mesh = Boundary("mesh", np.eye(4), np.asarray(shell.vertices), np.asarray(shell.faces))
    assert of_instances(avenue(50.0, fog=(replace(FOG, boundary=mesh),))) == {}
    wide = avenue(50.0)
    assert of_instances(replace(wide, camera=replace(wide.camera, width_m=30.0))) == {}


def test_the_transmittance_of_a_view_that_was_looked_at_in_clear_air_is_its_own():
    """As if the foggy scene had been looked at: the same pixels see the same instances."""
    source = avenue(20.0, 130.0, 140.0)
    clear = aovs.measure(load(replace(source, fog=()), boundaries=False))
    foggy = load(source, boundaries=False)
    whole, seen = aovs.measure(foggy), aovs.seen_through(foggy, clear)
    assert 0.0 < whole.transmittance.min() < 1.0
    np.testing.assert_array_equal(seen.transmittance, whole.transmittance)
    np.testing.assert_array_equal(seen.instance_id, whole.instance_id)


def test_a_bake_lists_things_with_the_transmittance_before_them(tmp_path):
    """exp(-3) before a wall at 50 m in fog of MOR 50, by the WMO's threshold of 5 %; 1 in clear air."""
    (tmp_path / "street.usda").write_text(street())
    small = {"resolution": "32x18", "samples": 2, "model": "single"}
    bake(tmp_path / "street.usda", tmp_path / "out", lighting="sky", fog="clear,mor50", **small)
    for fog, wanted in (("clear", 1.0), ("mor50", 0.05)):
        listed = json.loads((tmp_path / "out" / "sky" / fog / "instances.json").read_text())["instances"]
        assert {row["path"]: row["transmittance"] for row in listed}["/World/Wall"] == pytest.approx(wanted, rel=1e-3)

"""What the pixel-centre ray measures, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from synfog_usd.fog import Boundary, FogMedium, FogVolume
from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import box, scene, uniform_fog, wall

FLOAT32 = 4e-6
"""Relative error of a distance that Mitsuba holds in float32, with its ray offsets; measured 8e-7."""


@pytest.fixture(params=[True, False], ids=["traced", "closed form"])
def measured(request):
    """AOVs with the fog's boundaries traced, or known in closed form."""

    def measure(world, fog=(), **more):
        closed = all(volume.boundary.kind != "mesh" for volume in fog)
        return aovs.measure(load(scene(world, fog, **more), boundaries=request.param or not closed))

    return measure


def rays(width=16, height=9, fov_x_deg=10.0):
    """Directions of the pixel centres, from the definition of the angle of view."""
    half = np.tan(np.radians(fov_x_deg) / 2)
    x = ((np.arange(width) + 0.5) / width * 2 - 1) * half
    z = (1 - (np.arange(height) + 0.5) / height * 2) * half * height / width
    directions = np.stack(np.broadcast_arrays(x[None, :], 1.0, z[:, None]), axis=-1)
    return directions / np.linalg.norm(directions, axis=2, keepdims=True)


def test_depth_is_planar_and_distance_is_along_the_ray(measured):
    """A wall across the view is at one depth; its distance grows with 1 / cos."""
    seen = measured({"shape_wall": wall(50.0)}, fov_x_deg=70.0)
    np.testing.assert_allclose(seen.depth_m, 50.0, rtol=FLOAT32)
    np.testing.assert_allclose(seen.distance_m, 50.0 / rays(fov_x_deg=70.0)[:, :, 1], rtol=FLOAT32)
    np.testing.assert_allclose(seen.normal, np.broadcast_to([0.0, -1.0, 0.0], seen.normal.shape), atol=1e-6)
    assert (seen.instance_id == 1).all()


def test_fog_counts_only_between_the_camera_and_the_surface(measured):
    """Behind the wall there is more fog, and before a far box there is none."""
    ahead = FogVolume("/Fog", box((200, 10, 200), (0, 30, 0)), FogMedium(0.05))
    seen = measured({"shape_wall": wall(100.0)}, [ahead])
    np.testing.assert_allclose(seen.transmittance, np.exp(-0.05 * 20.0 / rays()[:, :, 1]), rtol=2 * FLOAT32)


def test_a_dense_bank_inside_thin_fog_adds_up_by_parts(measured):
    """Thin fog, bank, thin fog again: the optical depths of the parts."""
    thin = FogVolume("/Thin", box(200.0), FogMedium(0.01))
    bank = FogVolume("/Bank", box((50, 5, 50), (0, 20, 0)), FogMedium(0.3), priority=1, parent=0)
    seen = measured({"shape_wall": wall(60.0)}, [thin, bank], fov_x_deg=2.0)
    np.testing.assert_allclose(
        seen.transmittance, np.exp(-(0.01 * 50 + 0.3 * 10) / rays(fov_x_deg=2.0)[:, :, 1]), rtol=8 * FLOAT32
    )


@pytest.mark.parametrize("kind", ["sphere", "mesh"])
def test_round_boundaries_end_the_fog_at_their_surface(kind, measured):
    """From the centre of a ball of fog, every ray to the sky passes one radius."""
    if kind == "sphere":
        boundary, radius, rtol = Boundary("sphere", np.diag([80.0, 80.0, 80.0, 1.0])), 80.0, FLOAT32
    else:
        ball = trimesh.creation.icosphere(subdivisions=5, radius=80.0)
        boundary, radius, rtol = (
            Boundary("mesh", np.eye(4), ball.vertices, ball.faces),
            80.0,
            1e-3,
        )  # chords of an icosphere: sagitta 0.05 %
    seen = measured({}, [FogVolume("/Fog", boundary, FogMedium(0.02))])
    assert (seen.instance_id == 0).all() and np.isinf(seen.depth_m).all()
    np.testing.assert_allclose(seen.transmittance, np.exp(-0.02 * radius), rtol=rtol)


def test_exponential_fog_thins_with_height(measured):
    """Looking up out of an exponential slab, tau is the closed-form column over cos."""
    up = np.eye(4)
    up[:3, :3] = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    fog = FogVolume(
        "/Fog", box(100.0), FogMedium(0.05, profile="exponential", base_height_m=-100.0, scale_height_m=40.0)
    )
    seen = measured({}, [fog], to_world=up, width_px=9, height_px=9)
    column = 0.05 * 40.0 * (np.exp(-100.0 / 40.0) - np.exp(-200.0 / 40.0))
    half = np.tan(np.radians(5.0))
    offsets = ((np.arange(9) + 0.5) / 9 * 2 - 1) * half
    slope = np.sqrt(1 + offsets[:, None] ** 2 + offsets[None, :] ** 2)
    np.testing.assert_allclose(seen.transmittance, np.exp(-column * slope), rtol=FLOAT32)


def test_cut_out_materials_are_looked_through(measured):
    """A card with opacity 0 hides nothing; with opacity 1 it does."""
    for opacity, instance in ((0.0, 2), (1.0, 1)):
        card = {"type": "mask", "opacity": opacity, "nested": {"type": "diffuse"}}
        seen = measured({"shape_card": wall(10.0, bsdf=card), "shape_wall": wall(50.0)})
        assert (seen.instance_id == instance).all()


def test_what_stands_before_the_near_plane_is_cut_only_if_it_was_meant_to():
    """A near plane in clear air changes nothing; one that cuts a bonnet off shows what is behind it."""
    world = {"shape_bonnet": wall(0.5, 0.2), "shape_wall": wall(50.0)}
    whole = scene(world, [uniform_fog()])
    near = replace(whole, camera=replace(whole.camera, near_m=0.2))
    assert (aovs.measure(load(near)).instance_id == 1).all()
    cut = replace(whole, camera=replace(whole.camera, near_m=1.0))
    seen = aovs.measure(load(cut))
    assert (seen.instance_id == 2).all()
    np.testing.assert_allclose(seen.transmittance, np.exp(np.log(0.05) / 150 * 50.0 / rays()[:, :, 1]), rtol=FLOAT32)


def test_instances_of_one_prototype_are_different_things():
    """Two instances of one ball carry their own ids."""
    ball = {"type": "sphere", "bsdf": {"type": "diffuse"}}
    places = [np.array([[1, 0, 0, x], [0, 1, 0, 20], [0, 0, 1, 0], [0, 0, 0, 1.0]]) for x in (-2.0, 2.0)]
    world = {"group_ball": {"type": "shapegroup", "ball": ball}}
    world |= {
        f"instance_{i}": {"type": "instance", "group": {"type": "ref", "id": "group_ball"}, "to_world": place}
        for i, place in enumerate(places)
    }
    whole = scene(world, fov_x_deg=30.0)
    seen = aovs.measure(load(replace(whole, instance_of={("instance_0", "ball"): 5, ("instance_1", "ball"): 6})))
    assert set(np.unique(seen.instance_id)) == {0, 5, 6}
    assert seen.instance_id[4, :8].max() == 5 and seen.instance_id[4, 8:].max() == 6


@pytest.mark.parametrize("f_number", [0.0, 2.8])
def test_a_shifted_camera_sees_to_the_side_it_is_shifted_to(f_number):
    """An axis shifted by (0.25, 0.1) of the picture puts the point straight ahead that far left of and below the
    centre.
    """
    whole = scene({"shape_dot": wall(50.0, 0.5)}, width_px=80, height_px=40, fov_x_deg=40.0)
    camera = replace(whole.camera, shift=(0.25, 0.1), f_number=f_number, focal_length_m=0.035, focus_m=50.0)
    y, x = np.nonzero(aovs.measure(load(replace(whole, camera=camera))).instance_id)
    np.testing.assert_allclose([x.mean() + 0.5, y.mean() + 0.5], [80 * (0.5 - 0.25), 40 * (0.5 + 0.1)], atol=0.5)

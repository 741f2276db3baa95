"""Amodal masks, boxes in the picture and in space, poses: against each object alone, closed forms and OpenCV."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from synfog_usd.dataset import masks, objects, scenes
from synfog_usd.render.film import aovs
from synfog_usd.render.load import to_mitsuba
from synfog_usd.scene import Instance, SceneDict
from synfog_usd.scene.testing import black, scene, tilted, uniform_fog, wall

SIZE = {"width_px": 160, "height_px": 90, "fov_x_deg": 60.0}


def mesh(made, matrix=None, **parts):
    if matrix is not None:
        made.apply_transform(matrix)
    return {"type": "mesh", "positions": np.array(made.vertices), "faces": np.array(made.faces), **(parts or black())}


def placed(x, y, z, turn_deg=0.0):
    matrix = trimesh.transformations.rotation_matrix(np.radians(turn_deg), [0.3, 0.2, 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


@pytest.fixture(scope="module")
def crowd():
    """Twenty things one behind the other, some of them instances of a prototype, one with holes, two beyond the border,
    one around the camera's near plane.
    """
    rng = np.random.default_rng(9)
    world = {
        "shape_ground": mesh(trimesh.creation.box((200.0, 200.0, 0.1)), placed(0.0, 60.0, -1.5)),
        "shape_beside": mesh(trimesh.creation.box((4.0, 9.0, 1.0)), placed(2.4, 3.0, -0.6)),
        "shape_border": mesh(trimesh.creation.icosphere(subdivisions=3, radius=3.0), placed(-9.0, 15.0, 0.0)),
    }
    for number in range(12):
        place = placed(*rng.uniform([-6, 8, -1], [6, 40, 3]), rng.uniform(0, 360))
        made = [trimesh.creation.box, trimesh.creation.icosphere, trimesh.creation.cylinder][number % 3]
        size = [{"extents": rng.uniform(1, 4, 3)}, {"radius": 1.2}, {"radius": 0.7, "height": 3.0}][number % 3]
        world[f"shape_{number}"] = mesh(made(**size), place)
    card = {"type": "mask", "opacity": 0.0, "nested": {"type": "diffuse"}}
    world["shape_pane"] = mesh(trimesh.creation.box((3.0, 0.1, 3.0)), placed(0.0, 7.0, 0.0), bsdf=card)
    source = scene(world, **SIZE)
    group = {"type": "shapegroup", "shape_0": mesh(trimesh.creation.cone(radius=1.0, height=2.0))}
    more = {"group_0": group}
    instances, instance_of = list(source.instances), dict(source.instance_of)
    for number in range(4):
        key = f"instance_{number}"
        matrix = placed(*rng.uniform([-5, 6, -1], [5, 30, 2]), 40.0 * number)
        more[key] = {"type": "instance", "to_world": matrix, "shapegroup": {"type": "ref", "id": "group_0"}}
        instances.append(Instance(len(instances) + 1, f"/{key}", "car", matrix))
        instance_of[key, "shape_0"] = len(instances)
    return replace(source, world={**source.world, **more}, instances=tuple(instances), instance_of=instance_of)


def alone(source: SceneDict, number):
    """The scene with one instance in it."""
    kept = {key for key, instance in source.instance_of.items() if instance == number}
    names = {key[0] for key in kept}
    world = {
        key: part for key, part in source.world.items() if not key.startswith(("shape_", "instance_")) or key in names
    }
    return replace(source, world=world, instance_of={key: number for key in kept})


def test_amodal_masks_are_those_of_each_object_alone(crowd, every=5):
    """IoU 0.99 and boxes within a pixel, of all twenty in one pass; and what stands behind really has more pixels than
    are seen.  Each that is looked at is loaded alone, so that is every fifth.
    """
    loaded = to_mitsuba(crowd, boundaries=False)
    rows = objects.rows(crowd, aovs.pierced(loaded), objects.Projection.of(crowd.camera))
    seen = aovs.measure(loaded).instance_id
    hidden = 0
    for instance in crowd.instances[::every]:
        row = rows[instance.id]
        brute = aovs.measure(to_mitsuba(alone(crowd, instance.id), boundaries=False)).instance_id == instance.id
        assert row["amodal_pixels"] == (masks.decode(row["amodal_rle"], 90, 160).sum() if brute.any() else 0)
        if not brute.any():
            assert instance.path == "/shape_pane"  # all of it is a hole
            continue
        mine = masks.decode(row["amodal_rle"], 90, 160)
        assert (mine & brute).sum() / (mine | brute).sum() >= 0.99, instance.path
        y, x = np.nonzero(brute)
        box = [x.min(), y.min(), x.max() - x.min() + 1, y.max() - y.min() + 1]
        np.testing.assert_allclose(row["amodal_box_px"], box, atol=1)
        assert not (~mine & (seen == instance.id)).any()
        hidden += row["amodal_pixels"] > 1.2 * (seen == instance.id).sum()
    assert hidden >= 8 // every


def test_fog_boundaries_are_no_objects(crowd):
    """With the boundary of a fog in the scene the same instances are met."""
    foggy = replace(crowd, fog=(uniform_fog(),))
    for one, other in zip(
        aovs.pierced(to_mitsuba(foggy)), aovs.pierced(to_mitsuba(crowd, boundaries=False)), strict=True
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    "change", [{"shift": (0.2, -0.1)}, {"width_m": 14.0, "shift": (0.1, 0.2)}], ids=["shifted", "orthographic, shifted"]
)
def test_the_projected_box_is_that_of_the_mask_within_a_pixel(crowd, change):
    """The hull's projection, cut by the border, against pixels; also where a thing begins behind the near plane."""
    source = replace(crowd, camera=replace(crowd.camera, **change))
    view = objects.Projection.of(source.camera)
    rows = objects.rows(source, aovs.pierced(to_mitsuba(source, boundaries=False)), view)
    compared = 0
    for row in rows.values():
        if row["amodal_pixels"] < 20 or (row["truncation"] > 0.0 and row["amodal_box_px"][2] < 160):
            continue  # a thing that the border cuts has another box within than its own box has
        left, top, right, bottom = np.clip(row["projected_box_px"], 0.0, [160, 90, 160, 90])
        x, y, width, height = row["amodal_box_px"]
        np.testing.assert_allclose([left, top, right, bottom], [x, y, x + width, y + height], atol=1.0)
        compared += 1
    assert compared >= 6


def test_the_axis_is_where_all_parts_of_the_camera_say_it_is(shift=(0.2, -0.1)):
    """A small thing on the axis: the renderer, the boxes, and the pinhole that lens and labels are told."""
    source = scene({"shape_square": wall(50.0, 0.5)}, **SIZE)
    source = replace(source, camera=replace(source.camera, shift=shift))
    y, x = np.nonzero(aovs.measure(to_mitsuba(source)).instance_id)
    middle = x.mean(), y.mean()
    np.testing.assert_allclose(objects.Projection.of(source.camera).axis_px, np.add(middle, 0.5), atol=0.51)
    pinhole = scenes.pinhole_of(source.camera)
    np.testing.assert_allclose(pinhole.axis_px, middle, atol=0.51)
    again = replace(source.camera, **scenes.size_of(pinhole))
    assert again == source.camera


def test_truncation_is_the_part_of_the_box_beyond_the_border():
    """A square of which a quarter of the width is outside."""
    half = np.tan(np.radians(30.0)) * 20.0  # half of the view at 20 m
    square = {"type": "mesh", "faces": np.array([[0, 1, 2], [0, 2, 3]]), **black()}
    x = half - 3.0
    corners = np.array([[x, 20.0, 0.0], [x + 4.0, 20.0, 0.0], [x + 4.0, 20.0, 4.0], [x, 20.0, 4.0]])
    source = scene({"shape_square": {**square, "positions": corners}}, **SIZE)
    row = objects.rows(source, aovs.pierced(to_mitsuba(source)), objects.Projection.of(source.camera))[1]
    assert row["truncation"] == pytest.approx(0.25, abs=1e-3)


def test_a_camera_tells_when_its_rows_expose():
    """10 ms for a row, and 20 ms from the first to the last of 40 rows."""
    camera = replace(scene({}, width_px=60, height_px=40).camera, shutter_s=0.03, rolling=2 / 3)
    told = objects.Projection.of(camera).metadata((0.0, 0.0, 0.0))["shutter"]
    assert told == {"first_row_s": 0.01, "row_time_s": 0.0005, "rows": "begin one after the other"}
    told = objects.Projection.of(replace(camera, global_reset=True)).metadata((0.0, 0.0, 0.0))["shutter"]
    assert told == {"first_row_s": 0.01, "row_time_s": 0.0005, "rows": "end one after the other"}


def test_the_box_in_space_and_the_camera_are_what_opencv_takes():
    """Corners of the 3D box, by the pose and the camera's matrix through cv2.projectPoints, fall on the corners of the
    object itself; sizes are along the prim's own axes.
    """
    frame = placed(1.0, 12.0, 0.5, 33.0)
    size = np.array([1.9, 4.4, 1.5])
    source = scene({"shape_car": mesh(trimesh.creation.box(size), frame.copy())}, **SIZE, to_world=tilted(80.0))
    source = replace(source, instances=(Instance(1, "/shape_car", "car", frame),), origin_m=(1000.0, 2000.0, 30.0))
    view = objects.Projection.of(source.camera)
    row = objects.rows(source, aovs.pierced(to_mitsuba(source)), view)[1]
    told = view.metadata(source.origin_m)
    np.testing.assert_allclose(row["box_3d"]["size_m"], size, atol=1e-3)
    np.testing.assert_allclose(row["pose"]["world_m"], frame[:3, 3] + source.origin_m, atol=1e-3)
    w, x, y, z = row["pose"]["world_wxyz"]
    turned = trimesh.transformations.quaternion_matrix([w, x, y, z])[:3, :3]
    np.testing.assert_allclose(turned, frame[:3, :3], atol=1e-5)

    local = np.array([[a, b, c] for a in (-0.5, 0.5) for b in (-0.5, 0.5) for c in (-0.5, 0.5)]) * size
    camera_turn = trimesh.transformations.quaternion_matrix(row["pose"]["camera_wxyz"])[:3, :3]
    seen = local @ camera_turn.T + row["box_3d"]["centre_camera_m"]
    world = local @ turned.T + row["box_3d"]["centre_world_m"]
    inverse = np.linalg.inv(np.array(told["camera_to_world"]))
    np.testing.assert_allclose(world @ inverse[:3, :3].T + inverse[:3, 3], seen, atol=1e-3)
    points, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), np.array(told["camera_matrix_px"]), None)
    points = points[:, 0] + 0.5  # from centres of pixels to their corners
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(row["projected_box_px"], [*low, *high], atol=0.02)


def test_a_mirrored_prim_has_a_rotation_all_the_same():
    frame = placed(0.0, 12.0, 0.0) @ np.diag([-2.0, 2.0, 2.0, 1.0])
    source = scene({"shape_car": mesh(trimesh.creation.box((1, 2, 3)), placed(0.0, 12.0, 0.0))}, **SIZE)
    source = replace(source, instances=(Instance(1, "/shape_car", "car", frame),))
    row = objects.rows(source, aovs.pierced(to_mitsuba(source)), objects.Projection.of(source.camera))[1]
    np.testing.assert_allclose(row["box_3d"]["size_m"], [1, 2, 3], atol=1e-3)
    assert np.isclose(np.linalg.norm(row["pose"]["world_wxyz"]), 1.0, atol=1e-5)


def test_behind_the_camera_there_is_no_box():
    source = scene({"shape_car": mesh(trimesh.creation.box((1, 2, 3)), placed(0.0, -12.0, 0.0))}, **SIZE)
    row = objects.rows(source, aovs.pierced(to_mitsuba(source)), objects.Projection.of(source.camera))[1]
    assert row["amodal_pixels"] == 0 and "truncation" not in row and "amodal_box_px" not in row
    assert row["box_3d"]["centre_camera_m"][2] == pytest.approx(-12.0)


def test_speed_is_told_where_it_is_known():
    source = scene({"shape_car": mesh(trimesh.creation.box((1, 2, 3)), placed(0.0, 12.0, 0.0))}, **SIZE)
    car = Instance(1, "/shape_car", "car", velocity_m_s=(3.0, -4.0, 0.0))
    pierced, view = aovs.pierced(to_mitsuba(source)), objects.Projection.of(source.camera)
    assert "speed_m_s" not in objects.rows(source, pierced, view)[1]
    row = objects.rows(replace(source, instances=(car,)), pierced, view)[1]
    assert (row["speed_m_s"], row["velocity_m_s"]) == (5.0, [3.0, -4.0, 0.0])
    assert json.loads(json.dumps(row, allow_nan=False)) == row

"""Lanes in the picture: against the ground's plane met by each ray in closed form, and OpenCV's lens."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from synfog_usd.camera.distortion import warp_of
from synfog_usd.camera.pinhole import Pinhole
from synfog_usd.dataset import lanes, masks
from synfog_usd.render.film import aovs
from synfog_usd.render.load import to_mitsuba
from synfog_usd.scene import Lanelet
from synfog_usd.scene.testing import black, pixel_rays, scene

EYE_M = 2.0
SIZE = {"width_px": 96, "height_px": 54, "fov_x_deg": 70.0}


def level(x0, x1, y0, y1, z, **parts):
    corners = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    return {"type": "mesh", "positions": corners, "faces": np.array([[0, 1, 2], [0, 2, 3]]), **(parts or black())}


def strip(path, kind, x0, x1, z=-EYE_M, y=(-50.0, 300.0)):
    """A lane along +Y: its left edge at x0."""
    left, right = (np.array([[x, at, z] for at in y]) for x in (x0, x1))
    return Lanelet(path, kind, left, right)


@pytest.fixture(scope="module")
def street():
    """A road with two lanes, a pavement beside it at the same height, a bridge over it, a lorry in the right lane."""
    world = {
        "shape_road": level(-6.0, 6.1, -100.0, 400.0, -EYE_M),
        "shape_pavement": level(6.1, 30.0, -100.0, 400.0, -EYE_M),
        "shape_bridge": level(-30.0, 30.0, 40.0, 44.0, 6.0),
        "shape_lorry": level(0.5, 3.0, 12.0, 20.0, -0.9),
    }
    source = scene(world, **SIZE)
    kinds = {"/shape_road": "road", "/shape_pavement": "sidewalk", "/shape_bridge": "road", "/shape_lorry": "truck"}
    named = tuple(replace(one, label=kinds[one.path]) for one in source.instances)
    found = (
        strip("/Left", "driving", -3.5, 0.0),
        strip("/Right", "bus", 0.0, 3.5),
        strip("/Beside", "biking", 5.0, 8.0),
        strip("/Over", "driving", -30.0, 30.0, z=6.0, y=(20.0, 60.0)),
    )
    return replace(source, instances=named, lanes=found)


def test_each_pixel_of_the_road_has_its_lane(street):
    """By where its ray meets the plane of the ground; what hides the ground, what is no road and what lies at another
    height have none.
    """
    seen = aovs.measure(to_mitsuba(street, boundaries=False))
    found = lanes.ids(seen, street)
    rays = pixel_rays(street, nodes=1)[0][:, :, 0]
    with np.errstate(divide="ignore"):
        times = np.where(rays[..., 2] < 0.0, -EYE_M / rays[..., 2], np.inf)
    place = np.where(np.isfinite(times), times, 0.0)[..., None] * rays
    x, y = place[..., 0], place[..., 1]
    wanted = np.zeros(found.shape, dtype=int)
    for number, (low, high) in enumerate(((-3.5, 0.0), (0.0, 3.5), (5.0, 6.1)), 1):
        wanted[(x > low) & (x < high) & (y > 0.0) & (y < 300.0)] = number
    wanted[seen.instance_id == 4] = 0
    assert (seen.instance_id == 4).any() and (seen.instance_id == 3).any()
    over = found == 4
    assert over.any() and (seen.instance_id[over] == 3).all()
    assert (found[~over] == wanted[~over]).all()
    assert {*np.unique(found)} == {0, 1, 2, 3, 4}
    for row in lanes.rows(found, street):
        np.testing.assert_array_equal(masks.decode(row["rle"], *found.shape), found == row["id"])
        assert row["pixels"] == (found == row["id"]).sum()


def test_edges_are_where_a_pinhole_has_them(street):
    """x = f X / Z + c; cut at the picture's border; behind the lorry too.  The lane below the camera is its own."""
    rows = lanes.rows(np.zeros((54, 96), dtype=int), replace(street, origin_m=(100.0, 0.0, 0.0)))
    focal = 48.0 / np.tan(np.radians(35.0))
    (edge,) = rows[1]["right_px"]
    (x0, y0), (x1, y1) = edge[0], edge[-1]
    for x, y in edge:
        depth = focal * EYE_M / (y - 27.0)
        assert x == pytest.approx(48.0 + focal * 3.5 / depth, abs=0.05)
    assert max(y0, x0 * 54 / 96) == pytest.approx(54.0, abs=0.01)
    assert (x1, y1) == pytest.approx((48.0 + focal * 3.5 / 300.0, 27.0 + focal * EYE_M / 300.0), abs=0.02)
    assert rows[1]["right_world_m"][0] == pytest.approx([103.5, -50.0, -EYE_M])
    assert [row["drivable"] for row in rows] == [True, True, False, True]
    assert not any(row["ego"] for row in rows)  # it stands between two
    place = street.camera.to_world.copy()
    place[0, 3] = 1.0
    moved = replace(street, camera=replace(street.camera, to_world=place))
    rows = lanes.rows(np.zeros((54, 96), dtype=int), moved)
    assert [row["ego"] for row in rows[:3]] == [False, True, False]


def test_edges_bend_as_opencv_bends_them(street):
    coefficients = (-0.2, 0.05, 0.002, -0.001, 0.01)
    rendered = Pinhole(54, 96, 70.0, (0.0, 0.0))
    warp = warp_of(rendered, coefficients, "inside")
    matrix = np.array(warp.camera_matrix())
    rows = lanes.rows(np.zeros((54, 96), dtype=int), street, lambda places: warp.bent(rendered, places))
    edge = np.concatenate(rows[0]["left_px"])
    y = 1.0 / np.linspace(1 / 300.0, 1 / 2.0, 4000)
    points = np.c_[np.full(len(y), -3.5), np.full(len(y), EYE_M), y]  # of OpenCV: x right, y down, z forward
    wanted = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(coefficients))[0][:, 0] + 0.5
    away = [np.hypot(*(wanted - place).T).min() for place in edge]
    assert len(edge) > 10 and max(away) < 0.06

"""Flow and tracks of a sequence: against closed forms, and against the next frame as it is rendered."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation
from support.cli import run

from synfog_usd.base.image import Quantity
from synfog_usd.camera import writers
from synfog_usd.dataset import flow

F, SIZE = 100.0, (40, 60)
NO_PARTS = np.zeros(SIZE, dtype=np.int64)
MATRIX = np.array([[F, 0.0, 29.5], [0.0, F, 19.5], [0.0, 0.0, 1.0]])


def row(number, x=0.0, yaw=0.0, label="car"):
    w, z = math.cos(yaw / 2), math.sin(yaw / 2)
    return {
        "id": number, "path": f"/World/Car_{number}", "label": label, "pixels": 5,
        "pose": {"world_m": [x, 0.0, 0.0], "world_wxyz": [w, 0.0, 0.0, z]},
    }  # fmt: skip


def view(depth=10.0, number=1, at=(0.0, 0.0, 0.0), turned=0.0, **more):
    """A plane across the axis of a camera that looks along the world's z, x to the right."""
    to_world = np.eye(4)
    to_world[:3, :3] = Rotation.from_euler("y", turned, degrees=True).as_matrix()
    to_world[:3, 3] = at
    rows = {number: row(number, **more)} if number else {}
    return flow.Labelled(np.full(SIZE, number), NO_PARTS, np.full(SIZE, depth), MATRIX, to_world, rows, {})


def test_a_camera_that_goes_aside_sees_the_disparity_of_what_stands():
    """X = -f B / Z, and nothing upwards; what leaves the picture is told."""
    found = flow.flow(view(), view(at=(0.5, 0.0, 0.0)))
    np.testing.assert_allclose(found[..., 0], -F * 0.5 / 10.0, atol=1e-9)
    np.testing.assert_allclose(found[..., 1], 0.0, atol=1e-9)
    assert (found[:, :5, 2] == flow.OUTSIDE).all()
    assert (found[:, 5:, 2] == flow.SEEN).all()


def test_what_moves_takes_its_pixels_along():
    """A body 0.4 m farther to the right, and turned by 3 degrees about an axis through its origin along z."""
    turn = math.radians(3.0)
    found = flow.flow(view(), view(x=0.4, yaw=turn))
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    x, y = (u - 29.5) / F * 10.0, (v - 19.5) / F * 10.0
    np.testing.assert_allclose(found[..., 0], F / 10.0 * (x * math.cos(turn) - y * math.sin(turn) + 0.4 - x), atol=1e-5)
    np.testing.assert_allclose(found[..., 1], F / 10.0 * (x * math.sin(turn) + y * math.cos(turn) - y), atol=1e-5)


def test_the_sky_turns_with_the_camera_and_stands_otherwise():
    """At the axis X = -f tan(2 degrees), wherever the camera is."""
    found = flow.flow(view(np.inf, 0), view(np.inf, 0, at=(3.0, 1.0, 9.0), turned=2.0))
    middle = found[19:21, 29:31, 0].mean()
    assert middle == pytest.approx(-F * math.tan(math.radians(2.0)), rel=1e-4)
    assert found[20, 30, 2] == flow.SEEN


def test_what_something_stands_before_is_hidden():
    """A nearer body stands in the right half of the next frame."""
    one, other = view(), view()
    depth, number = other.depth_m.copy(), other.instance.copy()
    depth[:, 30:], number[:, 30:] = 4.0, 2
    covered = flow.Labelled(number, NO_PARTS, depth, MATRIX, other.to_world, {1: row(1), 2: row(2)}, {})
    found = flow.flow(one, covered)
    assert (found[:, :29, 2] == flow.SEEN).all()
    assert (found[:, 32:, 2] == flow.HIDDEN).all()


def test_tracks_tell_turns_and_keep_their_number():
    """5 degrees a frame at 10 frames a second are 50 a second, over the cut at 180 degrees too; a tree has no track."""
    listed = [{k + 1: row(k + 1, yaw=math.radians(170.0 + 5.0 * k)), 9: row(9, label="vegetation")} for k in range(4)]
    for k, rows in enumerate(listed):  # one car, whose id is another in each frame
        rows[k + 1]["path"] = "/World/Car"
    (track,) = flow.tracks(listed, 10.0)
    assert (track["track"], track["path"]) == (1, "/World/Car")
    assert [frame["id"] for frame in track["frames"]] == [1, 2, 3, 4]
    assert [frame["yaw_rate_deg_s"] for frame in track["frames"]] == pytest.approx([50.0] * 4, abs=1e-6)


STAGE = """#usda 1.0
(
    upAxis = "Z"
    metersPerUnit = 1
    startTimeCode = 0
    endTimeCode = 2
    timeCodesPerSecond = 10
)
def Xform "World"
{
    double3 xformOp:translate = (500000, 5000000, 100)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Camera "Eye"
    {
        float focalLength = 0.36
        float horizontalAperture = 0.36
        float verticalAperture = 0.24
        double3 xformOp:translate.timeSamples = { 0: (0, 0, 1.5), 2: (0.2, 1, 1.5) }
        float3 xformOp:rotateXYZ.timeSamples = { 0: (90, 0, 0), 2: (90, 0, 1) }
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    }
    def Mesh "Ground"
    {
        point3f[] points = [(-50, -50, 0), (50, -50, 0), (50, 200, 0), (-50, 200, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        token subdivisionScheme = "none"
    }
    def Cube "Car" (prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"])
    {
        token[] semantics:labels:cityscapes = ["car"]
        double size = 2
        double3 xformOp:translate.timeSamples = { 0: (-1, 9, 1), 2: (1, 10, 1) }
        float xformOp:rotateZ.timeSamples = { 0: 20, 2: 40 }
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    }
    def Xform "Walker" (prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"])
    {
        token[] semantics:labels:cityscapes = ["person"]
        double3 xformOp:translate.timeSamples = { 0: (1.0, 4.5, 0), 2: (0.8, 4.7, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Cube "Body"
        {
            double size = 0.5
            double3 xformOp:translate = (0, 0, 1.2)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }
        def Xform "Leg"
        {
            double3 xformOp:translate = (0, 0, 1)
            float xformOp:rotateY.timeSamples = { 0: -40, 2: 30 }
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]
            def Cube "Thigh"
            {
                double size = 1
                double3 xformOp:translate = (0, 0, -0.4)
                float3 xformOp:scale = (0.2, 0.2, 0.8)
                uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
            }
        }
    }
    def DomeLight "Sky"
    {
        float inputs:intensity = 1000
    }
}
"""


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Three frames before a camera that goes and turns, far from the stage's origin: the folders of the frames."""
    folder = tmp_path_factory.mktemp("flow")
    (folder / "street.usda").write_text(STAGE)
    done = run(
        "bake", folder / "street.usda", "-o", folder / "out", "--frames", "0:2", "--resolution", "120x80",
        "--samples", "2", "--quality", "reference", "--fog", "clear",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [folder / "out" / f"{number:06d}" for number in range(3)]


def rebuilt(folder):
    """(H, W, 3) places [m] in the stage by camera.json and depth alone, and (H, W, 4) depth, instance, class, part."""
    told = json.loads((folder / "camera.json").read_text())
    image = writers.read_exr(folder / "labels.exr", quantity=Quantity.DATA)
    planes = image.pixels[:, :, [image.channels.index(f"{name}") for name in
             ("depth.Z", "instance.ID", "semantic.ID", "part.ID")]].astype(float)  # fmt: skip
    v, u = np.mgrid[: planes.shape[0], : planes.shape[1]]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(told["camera_matrix_px"]).T
    pose = np.array(told["camera_to_world"])
    with np.errstate(invalid="ignore"):
        return (rays * planes[..., :1]) @ pose[:3, :3].T + pose[:3, 3], planes


def place_of(folder, path, frame):
    """(4, 4) of a prim to the stage as USD gives it, columns."""
    stage = Usd.Stage.Open(str(folder.parent.parent / "street.usda"))
    return np.array(UsdGeom.XformCache(frame).GetLocalToWorldTransform(stage.GetPrimAtPath(path))).T


CLASS = {"car": 26, "person": 24}


@pytest.mark.slow
def test_a_stranger_rebuilds_the_world_from_each_frames_camera_file(clip):
    """5000 km from the origin: within 1 mm the ground is at its height and the car's sides are where USD has them, in
    both frames; the time is that of the frame.
    """
    for number, folder in enumerate(clip):
        told = json.loads((folder / "camera.json").read_text())
        assert (told["frame"], told["time_s"]) == (number, number / 10.0)
        assert told["shutter"]["first_row_s"] == 0.0 and told["distortion_coefficients"] == []
        places, planes = rebuilt(folder)
        ids = {row["path"]: row["id"] for row in json.loads((folder / "labels.json").read_text())["instances"]}
        ground = (planes[..., 1] == ids["/World/Ground"]) & (planes[..., 0] < 60.0)
        assert ground.sum() > 1000
        np.testing.assert_allclose(places[ground][:, 2], 100.0, atol=1e-3)
        car = planes[..., 2] == CLASS["car"]
        local = np.c_[places[car], np.ones(car.sum())] @ np.linalg.inv(place_of(folder, "/World/Car", number)).T
        assert car.sum() > 300
        np.testing.assert_allclose(np.abs(local[:, :3]).max(axis=1), 1.0, atol=1e-3)


@pytest.mark.slow
def test_a_leg_flows_as_it_swings(clip):
    """By USD's own matrices of the leg at both frames: its way in the world within 1 mm, its pixels' within 0.1 px;
    the body's are another's.
    """
    places, planes = rebuilt(clip[0])
    image = writers.read_exr(clip[0] / "flow.exr", quantity=Quantity.DATA)
    leg = planes[..., 3] > 0
    assert leg.sum() > 100 and (planes[leg][:, 2] == CLASS["person"]).all()
    ways = {}
    for path, mine in (("Leg", leg), ("", (planes[..., 2] == CLASS["person"]) & ~leg)):
        one, two = (place_of(clip[0], f"/World/Walker/{path}".rstrip("/"), frame) for frame in (0, 1))
        moved = (np.c_[places[mine], np.ones(mine.sum())] @ (two @ np.linalg.inv(one)).T)[:, :3]
        ways[path] = moved - places[mine]
        np.testing.assert_allclose(image.pixels[mine][:, 3:6], ways[path], atol=1e-3)
        told = json.loads((clip[1] / "camera.json").read_text())
        pose = np.array(told["camera_to_world"])
        local = (moved - pose[:3, 3]) @ pose[:3, :3] @ np.array(told["camera_matrix_px"]).T
        v, u = np.nonzero(mine)
        wanted = local[:, :2] / local[:, 2:] - np.stack([u, v], axis=-1)
        np.testing.assert_allclose(image.pixels[mine][:, :2], wanted, atol=0.1)
    assert np.linalg.norm(ways["Leg"] - ways[""].mean(axis=0), axis=1).max() > 0.2


@pytest.mark.slow
def test_ids_of_a_frames_picture_are_those_of_its_list(clip):
    for folder in clip:
        _, planes = rebuilt(folder)
        listed = json.loads((folder / "labels.json").read_text())
        shown = {int(n): int(c) for n, c in zip(*np.unique(planes[..., 1], return_counts=True), strict=True) if n}
        assert shown == {row["id"]: row["pixels"] for row in listed["instances"] if row["pixels"]}
        parts = {row["id"]: row for row in listed["parts"]}
        (leg,) = set(np.unique(planes[..., 3])) - {0}
        assert parts[int(leg)]["path"] == "/World/Walker/Leg"


@pytest.mark.slow
def test_flow_lands_where_the_next_frame_shows_the_same_point(clip):
    """A car that goes and turns before a camera that does: carried on by its flow, a pixel's point has the depth that
    the next frame, rendered for itself, has there; and flow forth and back is none.
    """
    views = [flow.read(folder) for folder in clip]
    car = next(number for number, told in views[0].rows.items() if told["label"] == "car")
    planes = [writers.read_exr(folder / "flow.exr", quantity=Quantity.DATA) for folder in clip]
    assert planes[0].channels == tuple(f"forward.{channel}" for channel in flow.CHANNELS)
    assert len(planes[1].channels) == 12
    forth, back = planes[0].pixels[:, :, :3], planes[1].pixels[:, :, 6:9]
    height, width = forth.shape[:2]
    v, u = np.mgrid[:height, :width]
    at = np.rint(np.stack([v + forth[..., 1], u + forth[..., 0]])).astype(int)
    seen = (forth[..., 2] == flow.SEEN) & (at[0] >= 0) & (at[0] < height) & (at[1] >= 0) & (at[1] < width)
    row_at, column_at = at[0][seen], at[1][seen]
    mine = views[0].instance[seen] == car
    assert mine.sum() > 300
    assert (views[1].instance[row_at, column_at][mine] == car).mean() > 0.95  # the rest lies on its outline
    sum_ = forth[seen][:, :2] + back[row_at, column_at, :2]
    inner = (views[1].instance[row_at, column_at] == views[0].instance[seen]) & (back[row_at, column_at, 2] == 1.0)
    assert np.median(np.hypot(*sum_[inner & mine].T)) < 0.1
    track, walker = json.loads((clip[0].parent / "tracks.json").read_text())["tracks"]
    assert track["frames"][1]["yaw_rate_deg_s"] == pytest.approx(100.0, abs=0.1)
    np.testing.assert_allclose(track["frames"][1]["velocity_m_s"], [10.0, 5.0, 0.0], atol=1e-3)
    assert walker["label"] == "person"

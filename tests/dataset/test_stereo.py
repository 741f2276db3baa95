"""Disparity of a rectified pair: f B / Z, what the right eye sees of the left one's points, and exports of both."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Picture
from support.stages import rig_stage

from synfog_usd import stage
from synfog_usd.base.image import Quantity
from synfog_usd.camera import writers
from synfog_usd.dataset import stereo
from synfog_usd.dataset.exports import cityscapes, kitti, vkitti2
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import pictures
from synfog_usd.dataset.exports.record import Boxed
from synfog_usd.dataset.plan import BakePlan, Sampling
from synfog_usd.dataset.rig import bake_cameras
from synfog_usd.translate import Exchange, StageView

WIDTH, BASELINE_M, FOV_DEG = 160, 0.5, 40.0
FOCAL_PX = WIDTH / 2 / math.tan(math.radians(FOV_DEG) / 2)
BOX = """
    def Cube "Box" {
        double size = 2
        double3 xformOp:translate = (-0.6, 10, 0.2)
        float3 xformOp:rotateXYZ = (0, 0, 20)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    }
"""


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Folder of a bake of two eyes that look at a wall 50 m away and at a turned box before it."""
    folder = tmp_path_factory.mktemp("stereo")
    path = rig_stage(folder, right=(BASELINE_M, 0.0, 0.0))
    text = path.read_text()
    path.write_text(text.replace('    def Mesh "Wall"', f'{BOX}    def Mesh "Wall"', 1))
    plan = dict(
        pipeline=Path("noise_free"),
        lighting=("sky",),
        fog=("clear",),
        size=(WIDTH, 90),
        sampling=Sampling(samples=2, quality="reference", bands=3),
    )
    bake_cameras(BakePlan(path, folder / "out", **plan), ["/World"])
    return folder / "out"


def planes(folder, *names):
    return np.moveaxis(writers.read_exr(folder / "labels.exr", quantity=Quantity.DATA, channels=names).pixels, 2, 0)


@pytest.mark.slow
def test_disparity_is_focal_length_times_baseline_over_depth(pair):
    """On the wall, 50 m away by the stage, within 1e-3 px; everywhere of the depth beside it.  labels.json has f and B
    as authored, and the right eye tells of no pair.
    """
    disparity, depth = planes(pair / "Ego", "disparity.X", "depth.Z")
    wall = (depth > 40.0) & np.isfinite(depth)
    assert wall.any() and (depth < 12.0).any()
    np.testing.assert_allclose(disparity[wall], FOCAL_PX * BASELINE_M / 50.0, atol=1e-3)
    np.testing.assert_allclose(disparity, FOCAL_PX * BASELINE_M / depth, atol=1e-3)
    told = json.loads((pair / "Ego" / "labels.json").read_text())["stereo"]
    assert told["right"] == "/World/Rig/Right"
    assert told["baseline_m"] == pytest.approx(BASELINE_M, abs=1e-6)
    assert told["focal_px"] == pytest.approx(FOCAL_PX, abs=1e-3)
    assert "stereo" not in json.loads((pair / "Right" / "labels.json").read_text())


@pytest.mark.slow
def test_the_left_picture_moved_by_its_disparity_lands_on_the_rights_depth(pair):
    """Each point that both see lies, in the right picture, between the depths of the two pixels beside its place; what
    is hidden lies behind one of them; outside is what lies left of the picture.
    """
    disparity, seen, depth = planes(pair / "Ego", "disparity.X", "disparity.seen", "depth.Z")
    (right,) = planes(pair / "Right", "depth.Z")
    rows, columns = np.indices(depth.shape)
    place = columns - disparity  # of pixel centres
    np.testing.assert_array_equal(seen == stereo.OUTSIDE, place + 0.5 < 0.0)
    inside = place >= 0.0
    low = np.clip(np.floor(place).astype(int), 0, WIDTH - 1)
    beside = np.stack([right[rows, np.clip(low + k, 0, WIDTH - 1)] for k in (0, 1)])
    both, hidden = inside & (seen == stereo.SEEN), inside & (seen == stereo.HIDDEN)
    off = (depth < beside.min(axis=0) * (1 - 1e-3)) | (depth > beside.max(axis=0) * (1 + 1e-3))
    right = np.minimum(right, 1e6)
    edge = np.abs(np.diff(right, axis=1, prepend=right[:, :1])) > 0.5
    assert both.mean() > 0.8 and hidden.sum() > 50
    flat = both & ~edge[rows, low] & ~edge[rows, np.clip(low + 1, 0, WIDTH - 1)]
    assert (off & flat).sum() <= 0.001 * flat.sum()  # ends of the box's slanted sides
    assert (beside.min(axis=0)[hidden] < depth[hidden] - 1.0).all()


def test_a_pair_looks_the_same_way_from_one_row(tmp_path):
    """The nearest right eye of several; none that is turned, before the other, or to the left of it."""
    for number, (right, turn, found) in enumerate(
        (
            ((0.5, 0.0, 0.0), 0.0, 0.5),
            ((0.5, 0.0, 0.0), 1.0, None),
            ((0.5, 0.2, 0.0), 0.0, None),
            ((-0.5, 0.0, 0.0), 0.0, None),
        )
    ):
        opened = stage.open_stage(rig_stage(tmp_path, right=right, turn_deg=turn, name=f"rig{number}"))
        made = Exchange(opened, StageView(camera="/World/Ego"), rig=["/World/Rig/Right"])
        pair = stereo.pair_of(made.scene)
        assert pair is None if found is None else pair.baseline_m == pytest.approx(found)
    back = made.within(opened, camera="/World/Rig/Right")
    assert stereo.pair_of(back).right.path == "/World/Ego"


@pytest.mark.slow
def test_exports_have_the_right_eye_beside_the_left(pair, tmp_path):
    """One frame of two eyes.  KITTI: 256 steps a pixel, P3 moved by -f B, noc without what the right eye misses;
    Cityscapes: (value - 1) / 256; Virtual KITTI 2: Camera_1 with a row of its own.
    """
    wanted = FOCAL_PX * BASELINE_M / 50.0
    seen, depth = planes(pair / "Ego", "disparity.seen", "depth.Z")
    wall = (depth > 40.0) & np.isfinite(depth)

    def image(path):
        return np.asarray(Picture.open(path)).astype(float)

    for one in (kitti, cityscapes, vkitti2):
        one.write(lambda: pictures(pair), ExportFolder(tmp_path / one.__name__), Boxed())
    at = tmp_path / kitti.__name__ / "all"
    assert [path.name for path in (at / "image_2").iterdir()] == ["000000.png"]
    assert (at / "image_3/000000.png").read_bytes() == (pair / "Right/sky/clear/srgb.png").read_bytes()
    np.testing.assert_allclose(image(at / "disp_occ_0/000000.png")[wall] / 256.0, wanted, atol=0.5 / 256 + 1e-3)
    np.testing.assert_array_equal(image(at / "disp_noc_0/000000.png") > 0, (seen == stereo.SEEN) & np.isfinite(depth))
    lines = dict(line.split(": ") for line in (at / "calib/000000.txt").read_text().splitlines())
    left, right = (np.array(lines[name].split(), float).reshape(3, 4) for name in ("P2", "P3"))
    np.testing.assert_allclose(right - left, [[0, 0, 0, -FOCAL_PX * BASELINE_M], [0] * 4, [0] * 4], atol=1e-3)
    at = tmp_path / cityscapes.__name__
    (rights,), (lefts,) = (list(at.glob(f"{name}/**/*.png")) for name in ("rightImg8bit", "leftImg8bit"))
    assert rights.read_bytes() == (pair / "Right/sky/clear/srgb.png").read_bytes()
    assert lefts.name.replace("left", "right") == rights.name
    (found,) = at.glob("disparity/**/*.png")
    np.testing.assert_allclose((image(found)[wall] - 1) / 256.0, wanted, atol=0.5 / 256 + 1e-3)
    (told,) = at.glob("camera/**/*.json")
    assert json.loads(told.read_text())["extrinsic"]["baseline"] == pytest.approx(BASELINE_M)
    (tree,) = (tmp_path / vkitti2.__name__ / "Scene00").iterdir()
    for number in (0, 1):
        assert (tree / f"frames/rgb/Camera_{number}/rgb_00000.jpg").is_file()
    rows = [line.split() for line in (tree / "extrinsic.txt").read_text().splitlines()[1:]]
    assert [row[:2] for row in rows] == [["0", "0"], ["0", "1"]]
    assert float(rows[1][5]) - float(rows[0][5]) == pytest.approx(-BASELINE_M, abs=1e-6)

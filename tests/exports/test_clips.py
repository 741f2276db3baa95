"""Exports of clips, read back by the libraries that people use for them: tracks, flow, tables and messages are ours."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image as Picture
from support.browser import Tab, chromium
from support.cli import run

from synfog_usd.base import files
from synfog_usd.base.errors import ParameterError
from synfog_usd.dataset import flow
from synfog_usd.dataset.exports import gallery, nuscenes
from synfog_usd.dataset.exports.frames import pictures
from synfog_usd.dataset.exports.record import EXPORTERS, exporter
from synfog_usd.dataset.exports.run import export
from synfog_usd.scene import Instance
from synfog_usd.scene.testing import black, scene

pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning"
)  # of other people's libraries

FRAMES, PER_S, SIZE = 3, 10.0, (108, 192)
SOLIDS = {  # name -> label, place [m], size [m], metres a frame to the right
    "ground": ("road", (0.0, 100.0, -1.6), (400.0, 260.0, 0.2), 0.0),
    "car_0": ("car", (-5.0, 20.0, -0.75), (4.4, 1.8, 1.5), 0.5),
    "car_1": ("car", (6.0, 30.0, -0.75), (1.8, 4.4, 1.5), 0.0),
    "person_0": ("person", (2.0, 14.0, -0.65), (0.5, 0.4, 1.7), 0.15),
    "rider_0": ("rider", (-2.0, 12.0, -0.6), (0.6, 1.8, 1.8), 0.4),
}
MOVING = ("car_0", "person_0", "rider_0")


def library(name):
    return pytest.importorskip(name, reason=f"{name} is not installed")


def moment(number):
    """The street at a frame, with what moves moved, seen by a camera that stands."""
    world = {"mat_black": black()["bsdf"]}
    for name, (_, (x, y, z), size, step) in SOLIDS.items():
        box = trimesh.creation.box(size)
        box.apply_translation((x + step * number, y, z))
        paint = {"type": "ref", "id": "mat_black"}
        world[f"shape_{name}"] = {
            "type": "mesh", "positions": np.array(box.vertices), "faces": np.array(box.faces), "bsdf": paint
        }  # fmt: skip
    made = scene(world, width_px=SIZE[1], height_px=SIZE[0], fov_x_deg=70.0)
    instances = []
    for one, (label, (x, y, z), _, step) in zip(made.instances, SOLIDS.values(), strict=True):
        frame = np.eye(4)
        frame[:3, 3] = x + step * number, y, z
        instances.append(Instance(one.id, one.path, label, frame, (step * PER_S, 0.0, 0.0)))
    return replace(made, instances=tuple(instances))


@pytest.fixture(scope="module")
def clip(trace, tmp_path_factory):
    """The folder of a clip of three frames in three fogs."""
    out = tmp_path_factory.mktemp("clip")
    folders = [f"{number:06d}" for number in range(FRAMES)]
    for number, folder in enumerate(folders):
        trace(out / folder, moment(number))
    flow.write(out, folders, PER_S, print)
    rows = [{"number": number, "time_code": number, "folder": folder} for number, folder in enumerate(folders)]
    files.write_json(out / "sequence.json", {"frames_per_s": PER_S, "frames": rows, "clips": []})
    return out


@pytest.fixture(scope="module")
def exported(clip, tmp_path_factory):
    made = {}

    def get(name):
        if name not in made:
            made[name] = tmp_path_factory.mktemp("exports") / name
            export(clip, exporter(name), made[name])
        return made[name]

    return get


def ids_of(clip, number):
    """(H, W) instance ids of a frame, and path -> id."""
    view = flow.read(clip / f"{number:06d}")
    return view.instance, {row["path"]: number for number, row in view.rows.items()}


def tracks_of(clip):
    return {row["path"]: row["track"] for row in json.loads((clip / "tracks.json").read_text())["tracks"]}


def test_a_clip_is_its_frames_in_each_fog(clip):
    found = list(pictures(clip))
    assert [(one.moment.frame, one.fog) for one in found] == [
        (number, fog) for number in range(FRAMES) for fog in ("clear", "mor150", "mor50")
    ]
    assert len({one.name for one in found}) == 9 and len({one.sequence for one in found}) == 3
    assert [one.moment.time_s for one in found[::3]] == [0.0, 0.1, 0.2]
    assert found[0].flow("backward") is None and found[0].flow("forward").shape == (*SIZE, 3)


@pytest.mark.parametrize("name", [name for name, one in EXPORTERS.items() if one.clips])
def test_what_is_of_clips_refuses_a_picture_by_itself(name, baked, tmp_path):
    if name == "mcap":
        library("foxglove")
    with pytest.raises(ParameterError, match="bake with --frames"):
        export(baked.folder, exporter(name), tmp_path / "out")


@pytest.mark.parametrize("name", ["kitti-tracking", "nuscenes"])
def test_a_clip_without_tracks_is_refused(name, clip, trace, tmp_path):
    trace(tmp_path / "clip" / "000000", moment(0))
    row = {"number": 0, "time_code": 0, "folder": "000000"}
    files.write_json(tmp_path / "clip" / "sequence.json", {"frames_per_s": PER_S, "frames": [row], "clips": []})
    done = run("dataset", "export", tmp_path / "clip", "--as", name, "--to", tmp_path / "out")
    assert done.returncode == 2 and "no tracks.json; bake it with --quality standard" in done.stderr


def test_tracking_labels_have_the_devkits_17_columns(clip, exported):
    """Frame, track and type of each thing; sizes and places are those of the boxes; sequences are listed."""
    out, tracks = exported("kitti-tracking"), tracks_of(clip)
    names = dict(line.split() for line in (out / "sequences.txt").read_text().splitlines())
    listed = [line.split() for line in (out / "evaluate_tracking.seqmap.training").read_text().splitlines()]
    assert listed == [[sequence, "empty", "000000", "000003"] for sequence in names] and len(names) == 3
    (clear,) = [sequence for sequence, name in names.items() if "-clear-" in name]
    lines = [line.split() for line in (out / "training" / "label_02" / f"{clear}.txt").read_text().splitlines()]
    assert all(len(line) == 17 for line in lines)
    kinds = {"car_0": "Car", "car_1": "Car", "person_0": "Pedestrian", "rider_0": "Cyclist"}
    for name, kind in kinds.items():
        (x, y, z), size, step = SOLIDS[name][1:]
        own = [line for line in lines if int(line[1]) == tracks[f"/shape_{name}"]]
        assert [int(line[0]) for line in own] == [0, 1, 2] and {line[2] for line in own} == {kind}
        for line in own:
            height = float(line[10])
            assert sorted(map(float, line[10:13])) == pytest.approx(sorted(size), abs=0.006)
            centre = np.array(line[13:16], dtype=float) - [0.0, height / 2, 0.0]
            assert centre == pytest.approx([x + step * int(line[0]), -z, y], abs=0.011)


def test_masks_of_mots_are_read_by_coco(clip, exported):
    """Each line of instances_txt, decoded by pycocotools, is the pixels of its id in the picture beside, and ours."""
    mask = library("pycocotools.mask")
    out, tracks = exported("kitti-tracking"), tracks_of(clip)
    names = dict(line.split() for line in (out / "sequences.txt").read_text().splitlines())
    (clear,) = [sequence for sequence, name in names.items() if "-clear-" in name]
    lines = [line.split() for line in (out / "training" / "instances_txt" / f"{clear}.txt").read_text().splitlines()]
    assert len(lines) == 4 * FRAMES
    for frame, number, kind, height, width, text in lines:
        found = mask.decode({"size": [int(height), int(width)], "counts": text.encode()}).astype(bool)
        coded = np.array(Picture.open(out / "training" / "instances" / clear / f"{int(frame):06}.png"))
        np.testing.assert_array_equal(found, coded == int(number))
        ids, by_path = ids_of(clip, int(frame))
        wanted = {
            1000 * k + tracks[f"/shape_{name}"]: [name] for name, k in (("car_0", 1), ("car_1", 1), ("person_0", 2))
        }
        wanted[10000] = ["rider_0"]
        assert int(kind) == int(number) // 1000
        mine = [by_path[f"/shape_{name}"] for name in wanted[int(number)]]
        np.testing.assert_array_equal(found, np.isin(ids, mine))


@pytest.mark.parametrize(
    ("kind", "labels", "score"), [("Kitti2DBox", "label_02", " 1"), ("KittiMOTS", "instances_txt", "")]
)
def test_trackeval_gives_the_truth_as_results_full_marks(exported, tmp_path, kind, labels, score):
    evaluation, out = library("trackeval"), exported("kitti-tracking")
    shutil.copytree(out / "training" / labels, tmp_path / "label_02")
    seqmap = shutil.copy(out / "evaluate_tracking.seqmap.training", tmp_path)
    (results := tmp_path / "all" / "ours" / "data").mkdir(parents=True)
    for path in (tmp_path / "label_02").iterdir():
        rows = [row for row in path.read_text().splitlines() if row.split()[2] in ("Car", "Pedestrian", "1", "2")]
        (results / path.name).write_text("".join(f"{row}{score}\n" for row in rows))
    places = {"GT_FOLDER": str(tmp_path), "TRACKERS_FOLDER": str(tmp_path / "all"), "SPLIT_TO_EVAL": "training"}
    dataset = getattr(evaluation.datasets, kind)({**places, "SEQMAP_FILE": seqmap})
    found = evaluation.Evaluator({"PLOT_CURVES": False}).evaluate([dataset], [evaluation.metrics.HOTA()])[0]
    assert all(found[kind]["ours"]["COMBINED_SEQ"][name]["HOTA"]["HOTA"].min() == 1 for name in ("car", "pedestrian"))


def test_flow_of_virtual_kitti_is_decoded_as_its_authors_do(clip, exported):
    """2 v / 65535 - 1 of the width and height less one, by OpenCV; 0 where the third colour is 0: ours to a step."""
    cv2 = library("cv2")
    tree = exported("vkitti2") / "Scene00" / "sky-clear" / "frames"
    for way, numbers in (("forward", (0, 1)), ("backward", (1, 2))):
        folder = tree / f"{way}Flow" / "Camera_0"
        flat, deep = {"forward": ("flow", "sceneFlow"), "backward": ("backwardFlow", "backwardSceneFlow")}[way]
        assert sorted(path.name for path in folder.iterdir()) == [f"{flat}_{number:05}.png" for number in numbers]
        for number in numbers:
            coded = cv2.imread(str(folder / f"{flat}_{number:05}.png"), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
            assert coded.dtype == np.uint16 and coded.shape == (*SIZE, 3)
            assert (coded[..., 0] == 65535).all()  # OpenCV has blue first
            found = (2.0 / 65535.0 * coded[..., 2:0:-1].astype(float) - 1.0) * [SIZE[1] - 1, SIZE[0] - 1]
            truth = next(one for one in pictures(clip) if one.moment.frame == number).flow(way)
            np.testing.assert_allclose(found, truth[..., :2], atol=(SIZE[1] - 1) / 65535.0 + 1e-6)
            ids, by_path = ids_of(clip, number)
            mine = ids == by_path["/shape_car_0"]
            assert mine.any() and (np.sign(found[mine][:, 0]) == (1.0 if way == "forward" else -1.0)).all()
            place = tree / f"{way}SceneFlow" / "Camera_0" / f"{deep}_{number:05}.png"
            coded = cv2.imread(str(place), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
            ways = (coded[..., ::-1] * 2.0 / 65535.0 - 1.0) * 10.0
            sign = 1.0 if way == "forward" else -1.0
            for name in ("ground", "car_0", "car_1", "person_0"):
                wanted = sign * SOLIDS[name][3], 0.0, 0.0
                mine = ids == by_path[f"/shape_{name}"]
                np.testing.assert_allclose(ways[mine], np.tile(wanted, (mine.sum(), 1)), atol=1e-3)


def test_a_rig_of_six_has_a_camera_each(clip, tmp_path):
    """No camera's frames take the place of another's; nuScenes has a channel for each in every sample."""
    rows = [{"camera": f"/Rig/Eye_{number}", "folder": f"Eye_{number}"} for number in range(6)]
    for row in rows:
        shutil.copytree(clip, tmp_path / "rig" / row["folder"])
    files.write_json(tmp_path / "rig" / "rig.json", {"cameras": rows})
    for name in ("vkitti2", "nuscenes"):
        export(tmp_path / "rig", exporter(name), tmp_path / name)
    tree = tmp_path / "vkitti2" / "Scene00" / "sky-clear" / "frames" / "rgb"
    assert {path.name: len(list(path.iterdir())) for path in tree.iterdir()} == {
        f"Camera_{n}": FRAMES for n in range(6)
    }
    tables = tmp_path / "nuscenes" / nuscenes.VERSION
    channels = {row["token"]: row["channel"] for row in json.loads((tables / "sensor.json").read_text())}
    assert sorted(channels.values()) == [f"CAM_EYE_{number}" for number in range(6)]
    assert len(json.loads((tables / "sample_data.json").read_text())) == 6 * 3 * FRAMES


def test_coco_has_videos_and_tracks(clip, exported):
    """As loaders of YouTube-VIS and TAO read them: each picture has its video and frame, each box its track."""
    coco = library("pycocotools.coco").COCO(str(exported("coco") / "annotations" / "instances_all.json"))
    assert len(coco.dataset["videos"]) == 3
    tracks = {(row["path"], row["track"]) for row in json.loads((clip / "tracks.json").read_text())["tracks"]}
    found = {(one["synfog"]["path"], one["track_id"]) for one in coco.dataset["annotations"]}
    assert found == tracks
    for image in coco.loadImgs(coco.getImgIds()):
        assert f"-f{image['frame_id']:06}-" in image["file_name"]
    videos = [image["video_id"] for image in coco.dataset["images"]]
    assert [videos.count(video["id"]) for video in coco.dataset["videos"]] == [FRAMES] * 3


def test_nuscenes_tables_are_whole(clip, exported):
    """Each token that a row names is there, rows follow one another from first to last, and velocity is ours."""
    out = exported("nuscenes") / nuscenes.VERSION
    tables = {table: json.loads((out / f"{table}.json").read_text()) for table in nuscenes.TABLES}
    tokens = {table: {row["token"]: row for row in rows} for table, rows in tables.items()}
    for table, rows in tables.items():
        assert len(tokens[table]) == len(rows)
        for row in rows:
            for name, value in row.items():
                other = name.removesuffix("_token")
                if name.endswith("_token") and other in tokens:
                    assert value in tokens[other], (table, name)
            if row.get("next"):
                assert tokens[table][row["next"]]["prev"] == row["token"]
    assert len(tables["scene"]) == 3 and len(tables["sample"]) == 9
    for instance in tables["instance"]:
        rows = [tokens["sample_annotation"][instance["first_annotation_token"]]]
        while rows[-1]["next"]:
            rows.append(tokens["sample_annotation"][rows[-1]["next"]])
        assert len(rows) == instance["nbr_annotations"]
        assert rows[-1]["token"] == instance["last_annotation_token"]


def test_nuscenes_own_devkit_loads_it_and_finds_the_boxes(clip, exported):
    """Its boxes in the camera, projected by its intrinsics, are the amodal boxes; its velocity is that of the clip."""
    kit = library("nuscenes.nuscenes")
    geometry = library("nuscenes.utils.geometry_utils")
    found = kit.NuScenes(version=nuscenes.VERSION, dataroot=str(exported("nuscenes")), verbose=False)
    (scene_,) = [one for one in found.scene if "-clear-" in one["name"]]
    sample = found.get("sample", scene_["first_sample_token"])
    sample = found.get("sample", sample["next"])  # velocity needs a frame before and after
    path, boxes, matrix = found.get_sample_data(sample["data"]["CAM_FRONT"])
    assert len(boxes) == 4 and Picture.open(path).size == (SIZE[1], SIZE[0])
    rows = {row["path"]: row for row in flow.read(clip / "000001").rows.values()}
    names = {nuscenes.token("instance", scene_["name"], f"/shape_{name}"): name for name in SOLIDS}
    for box in boxes:
        name = names[found.get("sample_annotation", box.token)["instance_token"]]
        corners = geometry.view_points(box.corners(), matrix, normalize=True)[:2]
        x, y, width, height = rows[f"/shape_{name}"]["amodal_box_px"]
        around = [*corners.min(axis=1), *corners.max(axis=1)]
        np.testing.assert_allclose(around, [x, y, x + width - 1, y + height - 1], atol=1.1)
        speed = found.box_velocity(box.token)
        np.testing.assert_allclose(speed, [SOLIDS[name][3] * PER_S, 0.0, 0.0], atol=2e-3)


def test_mcap_is_read_by_its_own_library(clip, exported):
    """Four topics in Foxglove's schemas; pictures are the files, K and the camera's place are those of labels.json, and
    a track's box goes as its thing does.
    """
    library("foxglove")
    reading, decoding = library("mcap.reader"), library("mcap_protobuf.decoder")
    (path,) = [path for path in exported("mcap").glob("*.mcap") if "-clear-" in path.name]
    messages = {}
    with path.open("rb") as handle:
        for schema, channel, message, decoded in reading.make_reader(
            handle, decoder_factories=[decoding.DecoderFactory()]
        ).iter_decoded_messages():
            messages.setdefault((channel.topic, schema.name), []).append((message.log_time, decoded))
    assert set(messages) == {
        ("/camera/image", "foxglove.CompressedImage"),
        ("/camera/calibration", "foxglove.CameraCalibration"),
        ("/tf", "foxglove.FrameTransform"),
        ("/scene", "foxglove.SceneUpdate"),
    }
    assert all([time for time, _ in rows] == [0, 100_000_000, 200_000_000] for rows in messages.values())
    shown = [one for one in pictures(clip) if one.fog == "clear"]
    for (_, told), one in zip(messages["/camera/image", "foxglove.CompressedImage"], shown, strict=True):
        assert told.data == one.screen.read_bytes() and told.format == "png" and told.frame_id == "camera"
    told = messages["/camera/calibration", "foxglove.CameraCalibration"][0][1]
    assert told.K[0] == pytest.approx(96.0 / math.tan(math.radians(35.0))) and (told.width, told.height) == (192, 108)
    tracks = tracks_of(clip)
    for number, (_, update) in enumerate(messages["/scene", "foxglove.SceneUpdate"]):
        boxes = {int(entity.id): entity.cubes[0] for entity in update.entities}
        assert boxes.keys() == set(tracks.values())
        for name in MOVING:
            (x, y, z), size, step = SOLIDS[name][1:]
            cube = boxes[tracks[f"/shape_{name}"]]
            place = cube.pose.position
            assert [place.x, place.y, place.z] == pytest.approx([x + step * number, y, z], abs=1e-3)
            assert [cube.size.x, cube.size.y, cube.size.z] == pytest.approx(size, abs=1e-3)
    colours = [
        {int(entity.id): (entity.cubes[0].color.r, entity.cubes[0].color.g) for entity in update.entities}
        for _, update in messages["/scene", "foxglove.SceneUpdate"]
    ]
    assert colours[0] == colours[1] == colours[2] and len(set(colours[0].values())) == len(tracks)


@pytest.mark.slow
def test_the_gallery_plays_a_clip_and_a_box_keeps_its_colour(clip, tmp_path):
    """Play goes on from frame to frame; the moving car's box has one hue in all of them; flow is an overlay."""
    gallery.build(clip, tmp_path / "gallery")
    names = [one.name for one in pictures(clip) if one.fog == "clear"]
    with chromium() as browser, Tab(browser, tmp_path / "gallery" / "index.html", fragment=f"#shot={names[0]}") as page:
        page.wait_for_selector(f"body[data-ready='{names[0]}']")
        hues = []
        for number, name in enumerate(names):
            row = next(row for row in flow.read(clip / f"{number:06d}").rows.values() if row["path"] == "/shape_car_0")
            page.evaluate("name => { location.hash = '#shot=' + name }", name)
            page.wait_for_selector(f"body[data-ready='{name}']")
            hues.append(page.evaluate(EDGE, row["box_px"]))
        np.testing.assert_allclose(hues, [hues[0]] * 3, atol=4)  # what is half covered is rounded
        page.check("#overlay-flow")
        painted = page.evaluate(
            "(() => { const c = document.getElementById('plane');"
            " return [...c.getContext('2d').getImageData(0, 0, c.width, c.height).data].some((v) => v) })()"
        )
        assert painted
        page.click("#play")
        page.wait_for_selector(f"body[data-ready='{names[0]}']", timeout=5000)
        page.wait_for_selector(f"body[data-ready='{names[1]}']", timeout=5000)
        page.click("#play")
        assert page.locator("#play").inner_text() == "Play"


EDGE = """(box) => {
  const canvas = document.getElementById('marks'), scale = canvas.width / 192, context = canvas.getContext('2d');
  const y = Math.round((box[1] + box[3] / 2) * scale), x = Math.round(box[0] * scale);
  const line = context.getImageData(x - 2, y, 5, 1).data;
  const covered = [0, 1, 2, 3, 4].map((n) => line[4 * n + 3]), n = covered.indexOf(Math.max(...covered));
  return covered[n] > 100 ? [line[4 * n], line[4 * n + 1], line[4 * n + 2]] : null;
}"""
"""The colour of the left edge of a box in its middle."""


def test_scenes_of_nuscenes_begin_at_times_of_their_own(exported):
    """The devkit's `list_scenes` sorts them by their first timestamp, and cannot tell two that begin together."""
    out = exported("nuscenes") / nuscenes.VERSION
    scenes, samples = (json.loads((out / f"{table}.json").read_text()) for table in ("scene", "sample"))
    begins = {row["token"]: row["timestamp"] for row in samples}
    assert sorted(begins[row["first_sample_token"]] for row in scenes) == [0, 3_600_000_000, 7_200_000_000]

"""Each export, read back by the library that people use for it, has our numbers."""

import csv
import io
import json
import math
import os
import re
import subprocess
import sys
import tarfile

import numpy as np
import pytest
import trimesh
from PIL import Image as Picture
from support import cli

from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.dataset import masks
from synfog_usd.dataset.exports import folder as folders
from synfog_usd.dataset.exports import taxonomy
from synfog_usd.dataset.exports.frames import pictures
from synfog_usd.dataset.exports.record import EXPORTERS, Boxed, exporter
from synfog_usd.dataset.exports.run import export

pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning",
    "ignore::PendingDeprecationWarning",
    "ignore::ResourceWarning",
    "ignore::FutureWarning",
)  # of other people's libraries


def library(name):
    return pytest.importorskip(name, reason=f"{name} is not installed")


def kept(baked, fog, drop=("invisible",)):
    """The things of a shot that get a box: (row of labels.json, row of instances.json)."""
    left = {row["id"]: row for row in baked.left[fog]["instances"]}
    return [
        (row, left[row["id"]])
        for row in baked.listed["instances"]
        if row["pixels"] and row["label"] in taxonomy.NAMES and left[row["id"]].get("visibility") not in drop
    ]


def test_the_street_can_tell_ids_beyond_255_and_fog_that_hides(baked):
    """Or the tests below would show little."""
    assert baked.seen.instance_id.max() > 255
    assert 0 < len(kept(baked, "mor50")) < len(kept(baked, "clear"))


def test_coco_reads_boxes_masks_and_what_fog_leaves(baked, exported):
    """pycocotools: bbox, area and mask of every thing that is kept, exact; ids beyond 255; amodal masks."""
    coco = library("pycocotools.coco")
    out = exported("coco")
    found = coco.COCO(str(out / "annotations" / "instances_all.json"))
    by_fog = {image["synfog"]["fog"]: image for image in found.loadImgs(found.getImgIds())}
    assert set(by_fog) == {"clear", "mor150", "mor50"}
    for fog, image in by_fog.items():
        assert (out / "images" / "all" / image["file_name"]).is_file()
        annotations = {a["synfog"]["instance_id"]: a for a in found.loadAnns(found.getAnnIds(image["id"]))}
        expected = kept(baked, fog)
        assert annotations.keys() == {row["id"] for row, _ in expected}
        for row, left in expected:
            one = annotations[row["id"]]
            mask = baked.seen.instance_id == row["id"]
            np.testing.assert_array_equal(found.annToMask(one).astype(bool), mask)
            assert one["bbox"] == row["box_px"] and one["area"] == mask.sum()
            assert found.loadCats(one["category_id"])[0]["name"] == row["label"]
            assert one["synfog"]["mean_transmittance"] == left["mean_transmittance"]
            assert one["synfog"]["visibility"] == left["visibility"]
            whole = found.annToMask({**one, "segmentation": one["synfog"]["amodal_segmentation"]})
            np.testing.assert_array_equal(whole.astype(bool), masks.decode(row["amodal_rle"], 108, 192))


def test_coco_can_be_evaluated(baked, exported):
    """COCOeval with the annotations themselves as detections: average precision 1 for boxes and masks."""
    coco, evaluation = library("pycocotools.coco"), library("pycocotools.cocoeval")
    truth = coco.COCO(str(exported("coco") / "annotations" / "instances_all.json"))
    detections = truth.loadRes(
        [
            {name: a[name] for name in ("image_id", "category_id", "bbox", "segmentation")} | {"score": 1.0}
            for a in truth.dataset["annotations"]
        ]
    )
    for kind in ("bbox", "segm"):
        one = evaluation.COCOeval(truth, detections, kind)
        one.params.maxDets = [1, 10, 400]
        one.evaluate()
        one.accumulate()
        precision = one.eval["precision"][..., 0, -1]
        assert precision[precision > -1].min() == pytest.approx(1.0)


CARS = Boxed(("invisible",), ("car", "bus"))


def chosen(baked, fog, drop=("invisible",)):
    return [row for row, _ in kept(baked, fog, drop) if row["label"] in CARS.classes]


@pytest.mark.parametrize("form", [name for name, one in EXPORTERS.items() if one.boxes and not one.clips])
def test_only_the_classes_that_are_asked_for_have_boxes(form, baked, exported):
    """Counts of each format's own rows are those of labels.json; the pictures and their depth are all there."""
    out = exported(form, chosen=CARS)
    counts = {fog: len(chosen(baked, fog)) for fog in baked.left}
    assert 0 < sum(counts.values()) < sum(len(kept(baked, fog)) for fog in baked.left)
    told = dict.fromkeys(counts, 0)
    for row in csv.DictReader((out / "pictures.csv").read_text().splitlines()):
        told[row["fog"]] = int(row["things"])
    assert told == counts
    assert "Boxes are of car, bus alone" in (out / "README.md").read_text()
    total = sum(counts.values())
    if form == "coco":
        found = json.loads((out / "annotations" / "instances_all.json").read_text())
        assert len(found["annotations"]) == total
        assert [(kind["id"], kind["name"]) for kind in found["categories"]] == [(26, "car"), (28, "bus")]
    elif form == "yolo":
        rows = [line.split()[0] for path in (out / "labels").rglob("*.txt") for line in path.read_text().splitlines()]
        assert len(rows) == total and set(rows) <= {"0", "1"}
        assert "names:\n  0: car\n  1: bus\n" in (out / "data.yaml").read_text()
    elif form == "kitti":
        rows = [line.split()[0] for path in out.rglob("label_2/*.txt") for line in path.read_text().splitlines()]
        assert set(rows) <= {"Car", "Misc", "DontCare"} and len(rows) == sum(
            len(chosen(baked, fog, ())) for fog in baked.left
        )
    elif form == "vkitti2":
        assert sum(len(path.read_text().splitlines()) - 1 for path in out.rglob("bbox.txt")) == total
    elif form == "huggingface":
        rows = [json.loads(line) for path in out.rglob("metadata.jsonl") for line in path.read_text().splitlines()]
        assert sum(len(row["objects"]["id"]) for row in rows) == total
    else:
        with tarfile.open(out / "all-00000.tar") as tar:
            rows = [json.load(tar.extractfile(name)) for name in tar.getnames() if name.endswith(".json")]
        assert sum(len(row["instances"]) for row in rows) == total


@pytest.mark.parametrize(
    ("form", "classes", "words"),
    [
        ("coco", "car,trcuk", r"--classes: 'trcuk' is no class of Cityscapes; it takes .* Did you mean 'truck'\?"),
        ("cityscapes", "car", "--classes: cityscapes labels every pixel and has no boxes to choose; coco, kitti, yolo"),
    ],
)
def test_classes_that_cannot_be_chosen_are_one_line(form, classes, words, baked, tmp_path):
    done = cli.run("dataset", "export", baked.folder, "--as", form, "--to", tmp_path / "out", "--classes", classes)
    assert done.returncode == 2 and re.search(words, done.stderr) and done.stderr.count("\n") == 1


def test_kitti_has_the_devkits_columns(baked, exported):
    """15 columns; boxes, sizes and places are ours; the eight corners by P2 lie around the 2D box; depth to 1/256 m."""
    out = exported("kitti") / "all"
    names = dict(line.split() for line in (out / "names.txt").read_text().splitlines())
    for stem, name in names.items():
        fog = next(fog for fog in baked.left if f"-{fog}-" in name)
        lines = [line.split() for line in (out / "label_2" / f"{stem}.txt").read_text().splitlines()]
        assert all(len(line) == 15 for line in lines)
        expected = {tuple(map(float, taxonomy.corners(row["amodal_box_px"]))): row for row, _ in kept(baked, fog)}
        told = {tuple(map(float, line[4:8])): line for line in lines if line[0] != "DontCare"}
        assert told.keys() == expected.keys()
        assert len(lines) == len(kept(baked, fog, ()))  # what is dropped is DontCare
        matrix = calibration(out / "calib" / f"{stem}.txt")["P2"].reshape(3, 4)
        for box, line in told.items():
            row = expected[box]
            assert line[0] == {"car": "Car", "person": "Pedestrian", "bus": "Misc"}[row["label"]]
            height, width, length = map(float, line[8:11])
            np.testing.assert_allclose([width, length, height], row["box_3d"]["size_m"], atol=0.006)
            place, turn = np.array(line[11:14], dtype=float), float(line[14])
            centre = place - [0.0, height / 2, 0.0]
            np.testing.assert_allclose(centre, row["box_3d"]["centre_camera_m"], atol=0.011)
            assert turn == pytest.approx(-math.pi / 2, abs=0.006)  # away from the camera
            corners = np.array([[x, y, z] for x in (-1, 1) for y in (0, -2) for z in (-1, 1)])
            local = (
                corners
                * [length / 2, height / 2, width / 2]
                @ np.array([[math.cos(turn), 0, -math.sin(turn)], [0, 1, 0], [math.sin(turn), 0, math.cos(turn)]])
            )
            seen = np.c_[local + place, np.ones(8)] @ matrix.T
            pixels = seen[:, :2] / seen[:, 2:]
            if row["truncation"] == 0.0:
                np.testing.assert_allclose([*pixels.min(axis=0), *pixels.max(axis=0)], np.array(box) - 0.5, atol=1.2)
        depth = np.array(Picture.open(out / "depth_2" / f"{stem}.png"))
        finite = np.isfinite(baked.seen.depth_m)
        assert depth.dtype == np.uint16 and not depth[~finite].any()
        np.testing.assert_allclose(depth[finite] / 256.0, baked.seen.depth_m[finite], atol=0.5 / 256 + 1e-3)


def calibration(path):
    return {
        line.partition(":")[0]: np.array(line.partition(":")[2].split(), dtype=float)
        for line in path.read_text().splitlines()
    }


def test_yolo_is_laid_out_as_ultralytics_documents_it(baked, exported):
    """images/ and labels/ with the same stems; five numbers a line, in shares of the picture; names in data.yaml."""
    import yaml

    out = exported("yolo")
    data = yaml.safe_load((out / "data.yaml").read_text())
    assert data["train"] == data["val"] == "images/all" and sorted(data["names"]) == list(range(len(data["names"])))
    shown = sorted(path.stem for path in (out / "images" / "all").iterdir())
    assert shown == sorted(path.stem for path in (out / "labels" / "all").iterdir()) and len(shown) == 3
    for fog in baked.left:
        (path,) = [path for path in (out / "labels" / "all").iterdir() if f"-{fog}-" in path.name]
        rows = np.loadtxt(path, ndmin=2)
        expected = kept(baked, fog)
        assert len(rows) == len(expected) and ((rows[:, 1:] >= 0) & (rows[:, 1:] <= 1)).all()
        for (kind, x, y, width, height), (row, _) in zip(rows, expected, strict=True):
            assert data["names"][int(kind)] == row["label"]
            left, top = (x - width / 2) * 192, (y - height / 2) * 108
            np.testing.assert_allclose([left, top, width * 192, height * 108], row["box_px"], atol=1e-3)


def test_cityscapes_own_scripts_evaluate_it(baked, exported, monkeypatch):
    """evalPixelLevelSemanticLabeling with the ground truth as prediction: IoU 1 for each class that is there."""
    helpers = library("cityscapesscripts.helpers.csHelpers")
    out = exported("cityscapes")
    truth = sorted(str(path) for path in (out / "gtFine").rglob("*_labelIds.png"))
    pictures = sorted((out / "leftImg8bit").rglob("*.png"))
    assert len(truth) == len(pictures) == 3
    info = helpers.getCsFileInfo(truth[0])
    assert (info.type, info.type2) == ("gtFine", "labelIds") and info.sequenceNb == "000000"
    assert [helpers.getCoreImageFileName(str(path)) for path in pictures] == [
        helpers.getCoreImageFileName(path) for path in truth
    ]
    monkeypatch.setattr(sys, "argv", ["eval"])
    code = (
        "import sys, numpy; numpy.in1d = numpy.isin  # gone from NumPy since\n"
        "import cityscapesscripts.evaluation.evalPixelLevelSemanticLabeling as e;"
        "e.args.evalInstLevelScore = True; e.args.quiet = True; e.args.JSONOutput = False; t = sys.argv[1:];"
        "r = e.evaluateImgLists(t, t, e.args); c = {k: v for k, v in r['classScores'].items() if v == v};"
        "assert c and min(c.values()) == 1.0, c; print(sorted(c))"
    )
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code, *truth], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "['building', 'bus', 'car', 'person', 'road', 'sky']"


def test_cityscapes_instances_are_ours(baked, exported):
    """label id * 1000 + number, one for each of the cars; what is not counted has its label id; sky is 23."""
    out = exported("cityscapes")
    (path, *_) = sorted((out / "gtFine").rglob("*_instanceIds.png"))
    ids = np.array(Picture.open(path)).astype(int)
    ours = baked.seen.instance_id
    assert (ids[~np.isfinite(baked.seen.depth_m)] == 23).all()
    for row in baked.listed["instances"]:
        if not row["pixels"]:
            continue
        (number,) = set(ids[ours == row["id"]])
        counted = row["label"] in ("car", "person", "bus")
        assert number // 1000 == row["semantic_id"] if counted else number == row["semantic_id"]
    cars = {number for number in np.unique(ids) if number // 1000 == 26}
    assert len(cars) == sum(row["label"] == "car" and row["pixels"] > 0 for row in baked.listed["instances"]) > 20
    camera = json.loads(next((out / "camera").rglob("*.json")).read_text())
    assert camera["intrinsic"]["fx"] == pytest.approx(96 / math.tan(math.radians(35)))
    assert camera["extrinsic"]["yaw"] == pytest.approx(math.pi / 2) and camera["extrinsic"]["pitch"] == pytest.approx(0)


def test_cityscapes_own_scripts_paint_the_polygons(exported):
    """json2labelImg makes labelIds of them, pixel by pixel; things by their instance are those of instanceIds."""
    paint = library("cityscapesscripts.preparation.json2labelImg").createLabelImage
    annotation = library("cityscapesscripts.helpers.annotation").Annotation
    out = exported("cityscapes")
    for path in sorted((out / "gtFine").rglob("*_polygons.json")):
        found = annotation()
        found.fromJsonFile(str(path))
        wanted = np.array(Picture.open(str(path).replace("_polygons.json", "_labelIds.png")))
        np.testing.assert_array_equal(np.array(paint(found, "ids")), wanted)
        ids = np.array(Picture.open(str(path).replace("_polygons.json", "_instanceIds.png"))).astype(int)
        told = {(row["label"], row["instance"]) for row in json.loads(path.read_text())["objects"] if "instance" in row}
        assert {kind for kind, _ in told} == {"car", "person", "bus"} and len(told) == (np.unique(ids) > 999).sum()


def test_disparity_and_baseline_give_the_depth(baked, exported):
    """As Cityscapes' README reads it: d = (p - 1) / 256 where p > 0, and depth = baseline fx / d; none at the sky."""
    out = exported("cityscapes")
    seen = np.isfinite(baked.seen.depth_m)
    for path in sorted((out / "disparity").rglob("*.png")):
        camera = json.loads(next((out / "camera").rglob(path.name.replace("disparity.png", "camera.json"))).read_text())
        p = np.array(Picture.open(path)).astype(float)
        assert (p > 0.0).all() and (p[~seen] == 1.0).all()
        product = camera["extrinsic"]["baseline"] * camera["intrinsic"]["fx"]
        np.testing.assert_allclose((p[seen] - 1.0) / 256.0, product / baked.seen.depth_m[seen], atol=0.5 / 256 + 1e-4)


def test_foggy_cityscapes_pairs_go_by_their_extinction(baked, exported):
    """One clear picture, two foggy ones with beta = -ln(0.05) / MOR, transmittance exp(-beta distance) to 1/255."""
    out = exported("foggy-cityscapes")
    assert len(list((out / "leftImg8bit").rglob("*.png"))) == 1
    foggy = sorted(path.name.rpartition("_beta_")[2] for path in (out / "leftImg8bit_foggy").rglob("*.png"))
    assert foggy == ["0.01997.png", "0.05991.png"]
    for path in (out / "leftImg8bit_transmittance").rglob("*.png"):
        beta = float(path.stem.rpartition("_beta_")[2])
        seen = np.array(Picture.open(path)) / 255.0
        hit = np.isfinite(baked.seen.distance_m)
        np.testing.assert_allclose(seen[hit], np.exp(-beta * baked.seen.distance_m[hit]), atol=0.5 / 255 + 2e-4)


def test_vkitti2_has_depth_in_centimetres_and_ids_plus_one(baked, exported):
    """As its loaders read them: depth / 100, instancegt - 1 is the track, text tables with a head."""
    out = exported("vkitti2") / "Scene00"
    assert sorted(path.name for path in out.iterdir()) == ["sky-clear", "sky-mor150", "sky-mor50"]
    tree = out / "sky-clear"
    frames = tree / "frames"
    depth = np.array(Picture.open(frames / "depth" / "Camera_0" / "depth_00000.png"))
    near = np.isfinite(baked.seen.depth_m)
    np.testing.assert_allclose(depth[near] / 100.0, baked.seen.depth_m[near], atol=0.0051)
    ids = np.array(Picture.open(frames / "instanceSegmentation" / "Camera_0" / "instancegt_00000.png"))
    np.testing.assert_array_equal(ids, baked.seen.instance_id)
    boxes = list(csv.DictReader((tree / "bbox.txt").read_text().splitlines(), delimiter=" "))
    rows = {row["id"] - 1: row for row, _ in kept(baked, "clear")}
    assert {int(line["trackID"]) for line in boxes} == rows.keys()
    for line in boxes:
        x, y, right, bottom = taxonomy.corners(rows[int(line["trackID"])]["box_px"])
        assert [int(line[name]) for name in ("left", "right", "top", "bottom")] == [x, right - 1, y, bottom - 1]
    poses = np.array([line.split() for line in (tree / "pose.txt").read_text().splitlines()[1:]], dtype=float)
    matrix = np.array((tree / "extrinsic.txt").read_text().splitlines()[1].split()[2:], dtype=float).reshape(4, 4)
    np.testing.assert_allclose(np.c_[poses[:, 7:10], np.ones(len(poses))] @ matrix.T[:, :3], poses[:, 13:16], atol=1e-3)
    assert (frames / "rgb" / "Camera_0" / "rgb_00000.jpg").is_file()


def test_reside_names_are_id_k_and_beta(baked, exported):
    out = exported("reside") / "all"
    assert [path.name for path in (out / "clear").iterdir()] == ["1.png"]
    assert sorted(path.name for path in (out / "hazy").iterdir()) == ["1_1_0.01997.png", "1_2_0.05991.png"]
    assert sorted(path.name for path in (out / "trans").iterdir()) == ["1_1.png", "1_2.png"]
    hit = np.isfinite(baked.seen.distance_m)
    for name, mor_m in (("1_1.png", 150.0), ("1_2.png", 50.0)):
        seen = np.array(Picture.open(out / "trans" / name)) / 255.0
        t = np.exp(math.log(0.05) / mor_m * baked.seen.distance_m)
        np.testing.assert_allclose(seen[hit], t[hit], atol=0.5 / 255 + 2e-4)


def test_webdataset_reads_its_shards(baked, exported):
    """webdataset.WebDataset, decoded: pictures, labels and depth of each sample under one key."""
    wds = library("webdataset")
    out = exported("webdataset")
    samples = list(wds.WebDataset(str(out / "all-00000.tar"), shardshuffle=False))
    assert [sample["__key__"] for sample in samples] == [picture.name for picture in pictures(baked.folder)]
    for sample, picture in zip(samples, pictures(baked.folder), strict=True):
        assert sample["png"] == picture.screen.read_bytes()
        told = json.loads(sample["json"])
        assert [row["id"] for row in told["instances"]] == [row["id"] for row, _ in kept(baked, picture.fog)]
        ids = np.array(Picture.open(io.BytesIO(sample["id.png"])))
        np.testing.assert_array_equal(ids, baked.seen.instance_id)


def test_shards_go_to_a_url_of_fsspec_and_repeat(baked, exported, tmp_path):
    """To memory://, with the bytes of the folder's."""
    fsspec = library("fsspec")
    export(baked.folder, exporter("webdataset"), tmp_path / "beside", url="memory://shards")
    with fsspec.open("memory://shards/all-00000.tar", "rb") as handle:
        data = handle.read()
    with tarfile.open(fileobj=io.BytesIO(data)) as one, tarfile.open(exported("webdataset") / "all-00000.tar") as other:
        assert [entry.name for entry in one] == [entry.name for entry in other]
        assert all(one.extractfile(a).read() == other.extractfile(b).read() for a, b in zip(one, other, strict=True))


@pytest.mark.slow
def test_hugging_face_loads_the_image_folder(baked, exported, tmp_path, monkeypatch):
    """datasets.load_dataset("imagefolder"): pictures with their boxes and what fog leaves."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = library("datasets")
    out = exported("huggingface")
    found = datasets.load_dataset("imagefolder", data_dir=str(out / "data" / "all"), cache_dir=str(tmp_path / "cache"))
    (split,) = found.values()
    assert len(split) == 3
    for row in split:
        expected = kept(baked, row["fog"])
        assert row["objects"]["id"] == [one["id"] for one, _ in expected]
        assert row["objects"]["bbox"] == [one["box_px"] for one, _ in expected]
        np.testing.assert_allclose(
            row["objects"]["mean_transmittance"], [left["mean_transmittance"] for _, left in expected]
        )
        assert row["image"].size == (192, 108)


@pytest.mark.parametrize("name", [name for name, one in EXPORTERS.items() if not one.clips])
def test_every_export_has_a_card_a_table_and_a_valid_croissant(baked, exported, name):
    """mlcroissant accepts the record and reads the table through it; the card has the counts."""
    out = exported(name, licence="https://creativecommons.org/licenses/by/4.0/")
    rows = list(csv.DictReader((out / "pictures.csv").read_text().splitlines()))
    boxes = sum(len(kept(baked, fog)) for fog in baked.left)
    assert len(rows) == 3 and sum(int(row["things"]) for row in rows) == boxes
    card = (out / "README.md").read_text()
    assert f"| boxes | {boxes} (" in card and "| licence | https://creativecommons.org" in card
    assert EXPORTERS[name].depth in card
    mlc = library("mlcroissant")
    dataset = mlc.Dataset(jsonld=out / "croissant.json")
    assert not dataset.metadata.ctx.issues.errors
    records = list(dataset.records("pictures"))
    assert [record["pictures/name"].decode() for record in records] == [row["name"] for row in rows]


def test_where_nothing_can_be_linked_it_is_copied(baked, tmp_path, monkeypatch):
    def refused(*_):
        raise OSError("no links here")

    monkeypatch.setattr(os, "link", refused)
    made = folders.ExportFolder(tmp_path)
    source = baked.folder / "sky" / "clear" / "srgb.png"
    made.place(source, "a/b.png")
    assert (tmp_path / "a" / "b.png").read_bytes() == source.read_bytes() and (made.linked, made.copied) == (0, 1)


def test_an_export_repeats_byte_for_byte(baked, exported, tmp_path):
    export(baked.folder, exporter("coco"), tmp_path / "coco")
    one, other = exported("coco"), tmp_path / "coco"
    names = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(other) for path in other.rglob("*") if path.is_file())
    assert all((one / name).read_bytes() == (other / name).read_bytes() for name in names)


def test_wrong_folders_are_told_in_one_line(baked, tmp_path):
    with pytest.raises(ParameterError, match=r"--as cocoa: one of .* Did you mean 'coco'"):
        exporter("cocoa")
    with pytest.raises(ParameterError, match="holds the set itself"):
        export(baked.folder, exporter("coco"), baked.folder)
    with pytest.raises(ParameterError, match="only --as webdataset writes to a URL"):
        export(baked.folder, exporter("coco"), tmp_path, url="memory://x")
    (tmp_path / "bake.json").write_text('{"shots": 3}')
    with pytest.raises(OutputError, match="no manifest of a bake"):
        export(tmp_path, exporter("coco"), tmp_path / "there")


def test_labels_of_an_older_version_are_refused(baked, tmp_path):
    import shutil

    shutil.copytree(baked.folder, tmp_path / "old")
    listed = json.loads((tmp_path / "old" / "labels.json").read_text())
    (tmp_path / "old" / "labels.json").write_text(json.dumps({**listed, "version": 1}))
    with pytest.raises(OutputError, match="labels of an older version"):
        export(tmp_path / "old", exporter("coco"), tmp_path / "there")


def test_a_box_turned_by_an_angle_has_that_rotation_y():
    """A car of KITTI's: 0 faces the camera's right, pi / 2 the camera."""
    from synfog_usd.dataset.exports.kitti import upright

    for turn in (0.0, 0.7, math.pi / 2, -2.0):
        heading = math.atan2(math.cos(turn), -math.sin(turn)) * -1.0  # of +Y, about Z, in a world of x right, y ahead
        matrix = trimesh.transformations.rotation_matrix(heading, [0, 0, 1])
        to_camera = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
        camera = np.eye(4)
        camera[:3, :3] = to_camera @ matrix[:3, :3]
        forward = camera[:3, :3] @ [0.0, 1.0, 0.0]
        np.testing.assert_allclose(forward, [math.cos(turn), 0.0, -math.sin(turn)], atol=1e-12)
        row = {
            "label": "car",
            "box_3d": {"size_m": [1.8, 4.4, 1.5], "centre_camera_m": [0.0, 1.0, 20.0]},
            "pose": {
                "world_wxyz": trimesh.transformations.quaternion_from_matrix(matrix),
                "camera_wxyz": trimesh.transformations.quaternion_from_matrix(camera),
            },
        }
        size, place, found = upright(row)
        assert found == pytest.approx(turn) and size == pytest.approx((1.5, 1.8, 4.4))
        np.testing.assert_allclose(place, [0.0, 1.75, 20.0], atol=1e-12)

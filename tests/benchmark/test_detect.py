"""Detectors from their outputs to the tables: layouts with known boxes, COCO's numbers by hand and by pycocotools."""

from __future__ import annotations

import json
import shutil
import sys
import textwrap
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from PIL import Image
from support import cli

from synfog_usd.base import files, seeds
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image as Layers
from synfog_usd.base.image import Quantity
from synfog_usd.camera import writers
from synfog_usd.lab.benchmark import coco, decode, detect, detectors
from synfog_usd.lab.benchmark.coco import EVERYTHING, FoundBox, TrueBox

WIDE, HIGH = 64, 48
THINGS = (
    # id, label, box, distance; a far car and a far person that fog hides
    (1, "car", [4, 20, 20, 12], 15.0),
    (2, "car", [40, 22, 8, 5], 120.0),
    (3, "person", [30, 18, 6, 16], 20.0),
    (4, "person", [52, 22, 3, 6], 110.0),
    (5, "road", [0, 30, 64, 18], 5.0),
)
HIDDEN = (2, 4)
CLASSES = "{person: 0, car: 2, caravan: 2}"


def shot(folder: Path, fog: str, mor_m: float | None) -> dict:
    """A shot of the view: a picture, and what fog leaves of its things."""
    place = folder / "sky" / fog
    place.mkdir(parents=True)
    rng = seeds.stream(1, fog)
    Image.fromarray(rng.integers(0, 256, (HIGH, WIDE, 3)).astype(np.uint8)).save(place / "srgb.png")
    state = {i: "invisible" if mor_m and i in HIDDEN else "faint" if mor_m and i == 3 else "visible" for i in range(6)}
    files.write_json(place / "instances.json", {"instances": [{"id": i, "visibility": state[i]} for i in range(1, 6)]})
    names = ["instances.json", "srgb.png"]
    return {"lighting": "sky", "fog": fog, "folder": f"sky/{fog}", "mor_m": mor_m, "files": dict.fromkeys(names, "")}


@pytest.fixture
def baked(tmp_path) -> Path:
    """A bake of one view in clear air and in two fogs, in which two of its four things cannot be seen."""
    folder = tmp_path / "bake"
    shots = [shot(folder, fog, mor) for fog, mor in (("clear", None), ("mor300", 300.0), ("mor60", 60.0))]
    planes = np.zeros((HIGH, WIDE, 4), dtype=np.float32)
    planes[:, :, 2:] = 500.0
    rows = []
    for number, label, (x, y, w, h), distance in THINGS:
        planes[y : y + h, x : x + w, 0], planes[y : y + h, x : x + w, 3] = number, distance
        rows.append({"id": number, "label": label, "box_px": [x, y, w, h], "pixels": w * h, "distance_m": distance})
    names = ("instance.ID", "semantic.ID", "depth.Z", "distance.Z")
    writers.write_exr(folder / "labels.exr", Layers(planes, names, Quantity.DATA))
    files.write_json(folder / "labels.json", {"version": 2, "camera": {}, "instances": rows})
    manifest = {"stage": {"name": "s.usda"}, "pipeline": {"name": "phone.yaml"}, "plan": {"seed": 1}, "shots": shots}
    files.write_json(folder / "bake.json", manifest)
    return folder


def network(path: Path, *, size=(HIGH, WIDE), kind=TensorProto.FLOAT, channels=3, **outputs: np.ndarray) -> Path:
    """An ONNX network that takes a picture and gives constants."""
    nodes, told = [], []
    for name, value in outputs.items():
        nodes.append(helper.make_node("Constant", [], [name], value=numpy_helper.from_array(value)))
        told.append(helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(value.dtype), value.shape))
    picture = helper.make_tensor_value_info("picture", kind, [1, channels, *size])
    graph = helper.make_graph(nodes, "g", [picture], told)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def declared(folder: Path, text: str) -> Path:
    path = folder / "detectors.yaml"
    text = textwrap.indent(textwrap.dedent(text), "  ")
    path.write_text(f"synfog: benchmark/1\ndetectors:\n{text}", encoding="utf-8")
    return path


class Session:
    """What `decode` asks of onnxruntime, with known answers; keeps what it was fed."""

    def __init__(self, shape=(1, 3, None, None), kind="tensor(float)", more=(), **answers):
        node = type("Node", (), {})
        self.inputs, self.answers = [], answers
        for name, size, dtype in [("picture", shape, kind), *((name, (1, 2), "tensor(int64)") for name in more)]:
            one = node()
            one.name, one.shape, one.type = name, size, dtype
            self.inputs.append(one)

    def get_inputs(self):
        return self.inputs

    def get_outputs(self):
        made = [type("Node", (), {})() for _ in self.answers]
        for one, name in zip(made, self.answers, strict=True):
            one.name = name
        return made

    def run(self, names, feed):
        self.fed = feed
        return [self.answers[name] for name in names]


def detector(**more) -> detectors.Detector:
    classes = more.pop("classes", ((0, ("person",)), (2, ("car",))))
    return detectors.Detector("d", "onnx", classes=classes, **more)


CENTRES = np.array([[20.0, 30.0, 10.0, 20.0], [60.0, 40.0, 20.0, 10.0]])
"""Two boxes in the network's pixels: a person at (15, 20) of 10 x 20, and a car at (50, 35) of 20 x 10."""

PLAIN = [[15.0, 20.0, 10.0, 20.0, 0.9, 0], [50.0, 35.0, 20.0, 10.0, 0.8, 2]]
CORNERS = np.array([[15.0, 20.0, 25.0, 40.0], [50.0, 35.0, 70.0, 45.0]])
SIDES = np.array([96.0, 64.0])


@pytest.mark.parametrize(
    ("flags", "answers"),
    [
        ("", {"labels": np.array([0, 2]), "boxes": CORNERS, "scores": np.array([0.9, 0.8])}),
        ("", {"out": np.c_[CORNERS, [0.9, 0.8], [0.0, 2.0]][None]}),
        ("centred relative", {"out": np.c_[CENTRES / np.tile(SIDES, 2), [0.9, 0.8], [0.0, 2.0]][None]}),
    ],
)
def test_a_network_gives_the_boxes_that_it_holds(flags, answers):
    """The same two boxes, written in three ways, come out in the picture's own pixels."""
    session = Session(**answers)
    asked = detector(letterbox=False, **dict.fromkeys(flags.split(), True))
    found = decode.detector(asked, session)(np.zeros((64, 96, 3), np.uint8))
    np.testing.assert_allclose(np.array(found), PLAIN, rtol=1e-5)


def test_boxes_of_a_letterbox_and_of_a_stretched_picture_come_back_to_the_pictures_pixels():
    """A picture of 100 x 50 in 200 x 200: twice as large and 50 px down, or stretched by 2 and 4."""
    given = np.array([[40.0, 90.0, 80.0, 110.0]])
    for letterbox, expected in ((True, [20.0, 20.0, 20.0, 10.0]), (False, [20.0, 22.5, 20.0, 5.0])):
        session = Session(boxes=given, scores=np.array([0.5]), labels=np.array([2]))
        find = decode.detector(detector(letterbox=letterbox, size=(200, 200)), session)
        (box,) = find(np.zeros((50, 100, 3), np.uint8))
        np.testing.assert_allclose(box, [*expected, 0.5, 2])


def test_a_picture_is_given_as_the_file_says():
    """(value / 255 - mean) / std of a flat colour, its channels turned round for BGR, grey beside it, its size told."""
    session = Session(
        (1, 3, 64, 64), more=("sizes",), boxes=np.zeros((0, 4)), scores=np.zeros(0), labels=np.zeros(0, int)
    )
    find = decode.detector(detector(order="bgr", mean=(0.5, 0.4, 0.3), std=(0.1, 0.2, 0.4)), session)
    assert find(np.full((32, 64, 3), (255, 102, 0), np.uint8)) == []
    fed = session.fed["picture"]
    assert fed.shape == (1, 3, 64, 64) and fed.dtype == np.float32
    np.testing.assert_allclose(fed[0, :, 32, 32], [-0.75, 0.0, 5.0], atol=1e-6)  # blue, green, red
    np.testing.assert_allclose(fed[0, 2, 0, 0], (114 / 255 - 0.5) / 0.1, rtol=1e-5)
    assert session.fed["sizes"].tolist() == [[64, 64]]


# -- scores


def scored(true, found, pictures=1, ranges=(EVERYTHING,)):
    pytest.importorskip("pycocotools")
    return coco.match(pictures, true, found, ranges)


def test_average_precision_is_that_worked_by_hand():
    """Three things, boxes right, wrong, right by score: precision 1 up to recall 1/3, 2/3 up to 2/3, then none.

    So 34 of 101 recalls have 1 and 33 have 2/3; recall is 2/3.
    """
    true = [TrueBox(0, 0, (20.0 * n, 0, 10, 10), 1.0) for n in range(3)]
    found = [FoundBox(0, 0, (x, 0, 10, 10), score, 1.0) for x, score in ((0, 0.9), (200, 0.8), (20, 0.7))]
    (group,) = scored(true, found)
    np.testing.assert_allclose(coco.precision(group, np.ones((1, 1))), (34 + 33 * 2 / 3) / 101)
    np.testing.assert_allclose(coco.recall(group, np.ones((1, 1))), 2 / 3)


def some(pictures, seed):
    """Things and boxes by chance: some right, some beside, some of another class."""
    rng = seeds.stream(seed, "boxes")
    true, found = [], []
    for picture in range(pictures):
        for _ in range(rng.integers(0, 7)):
            x, y, w, h = rng.uniform(0, 80), rng.uniform(0, 80), *rng.uniform(5, 60, 2)
            kind = int(rng.integers(0, 3))
            true.append(TrueBox(picture, kind, (x, y, w, h), w * h, bool(rng.random() < 0.2)))
            if rng.random() < 0.8:
                near = (x + rng.normal(0, 2), y + rng.normal(0, 2), w, h)
                found.append(FoundBox(picture, kind, near, float(rng.random()), w * h))
        for _ in range(rng.integers(0, 4)):
            found.append(
                FoundBox(picture, int(rng.integers(0, 3)), tuple(rng.uniform(5, 60, 4)), float(rng.random()), 500.0)
            )
    return true, found


def by_pycocotools(true, found, pictures, ranges):
    """Its own accumulation: precision (T, R, K, A, M) and recall (T, K, A, M)."""
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    def dataset(rows):
        made = COCO()
        images, kinds = [{"id": n} for n in range(pictures)], [{"id": n} for n in range(3)]
        made.dataset = {"images": images, "categories": kinds, "annotations": rows}
        made.createIndex()
        return made

    def row(n, one):
        return {
            "id": n + 1,
            "image_id": one.picture,
            "category_id": one.kind,
            "bbox": list(one.box),
            "area": one.number,
        }

    gt = dataset([{**row(n, one), "iscrowd": int(one.ignored)} for n, one in enumerate(true)])
    dt = dataset([{**row(n, one), "iscrowd": 0, "score": one.score} for n, one in enumerate(found)])
    theirs = COCOeval(gt, dt, "bbox")
    theirs.params.areaRng, theirs.params.areaRngLbl = [list(one) for one in ranges], [str(one) for one in ranges]
    theirs.evaluate()
    theirs.accumulate()
    return theirs.eval


def mean(values):
    return values[values > -1].mean() if (values > -1).any() else np.nan


def test_a_picture_that_counts_twice_is_a_picture_that_is_there_twice(capfd):
    """Weights of 0, 1 and 2 against pycocotools on a set in which pictures are left out and repeated."""
    true, found = some(12, 3)
    weights = np.array([2, 0, 1, 1, 2, 0, 2, 1, 0, 1, 1, 3])
    places = np.repeat(np.arange(12), weights)
    again = [
        [
            type(one)(**{**vars(one), "picture": new})
            for new, old in enumerate(places)
            for one in rows
            if one.picture == old
        ]
        for rows in (true, found)
    ]
    (group,) = scored(true, found, 12)
    theirs = by_pycocotools(*again, len(places), [EVERYTHING])
    np.testing.assert_allclose(
        coco.precision(group, weights[None])[0].mean(), mean(theirs["precision"][..., 0, -1]), rtol=1e-9
    )


# -- the bench


def everything(*, missing=()):
    """(4, 6) corners, score and class of the things of the view, sure by 0.9 but for those that are missing."""
    table = np.zeros((4, 6), dtype=np.float32)
    for place, (number, label, (x, y, w, h), _) in enumerate(THINGS[:4]):
        if number not in missing:
            table[place] = x, y, x + w, y + h, 0.9, 2 if label == "car" else 0
    return table


def one(found, counts, metric, by="", group=""):
    return found.score(counts, metric, by, group).value


def test_what_no_camera_can_see_is_no_miss_and_no_false_alarm(baked, tmp_path):
    """A detector finds what a camera can see: in fog the near car and the near person of two each, and a box on the far
    car that is hidden.

    Per class in clear air recall 1, AP 1.  In fog, all things: the car's AP is 1 with the hidden one found, the
    person's 51/101 with one of two.  What fog leaves: 1 and 1; the box on the hidden car counts for nothing.
    """
    pytest.importorskip("pycocotools")
    views = detect.find(baked)
    assert [view.fog for view in views] == ["clear", "MOR 200 to 400 m", "MOR 50 to 100 m"]
    method = detectors.Detector("d", "onnx", classes=((0, ("person",)), (2, ("car",))), version="v")
    run = detect.DetectorRun(method)
    boxes = {
        thing.id: [*thing.box, 0.9, 2 if thing.label == "car" else 0, thing.distance_m] for thing in views[0].things
    }
    bench = detect.Bench(views, [run])
    for view in views:
        seen = [row for number, row in boxes.items() if view.source.clear or number != 4]
        bench.rows["v", view.name] = {"boxes": seen}
    found = detect.scores(bench, run)
    assert one(found, detect.ALL, "AP", "fog", "clear") == pytest.approx(1.0)
    for fog in ("MOR 200 to 400 m", "MOR 50 to 100 m"):
        assert one(found, detect.ALL, "AP", "fog", fog) == pytest.approx((1 + 51 / 101) / 2)
        assert one(found, detect.LEFT, "AP", "fog", fog) == pytest.approx(1.0)
    assert [one(found, detect.ALL, "AR", "visibility", state) for state in detect.STATES] == pytest.approx([1, 1, 0.5])
    assert one(found, detect.ALL, "AR") == pytest.approx((1 + 4 / 6) / 2)
    assert one(found, detect.ALL, "AP", "distance", "over 100 m") == pytest.approx((1 + 34 / 101) / 2)
    assert found.score(detect.ALL, "AP").low is None  # one scene


def test_the_command_scores_and_goes_on_and_gives_the_same_numbers(baked, tmp_path):
    """One detector that finds all and one that misses the far ones; nothing is asked twice."""
    pytest.importorskip("pycocotools")
    network(tmp_path / "all.onnx", out=everything())
    network(tmp_path / "near.onnx", out=everything(missing=HIDDEN))
    own = declared(
        tmp_path,
        f"""
        - {{name: everything, onnx: all.onnx, classes: {CLASSES}}}
        - {{name: near, onnx: near.onnx, classes: {CLASSES}}}
        """,
    )
    out = tmp_path / "out"
    done = cli.run("benchmark", "detect", baked, "-o", out, "--model", own, "--json", "--quiet")
    assert done.returncode == 0, done.stderr
    told = {(row["detector"], row["counts"], row["by"], row["metric"]): row for row in json.loads(done.stdout)}
    assert told["everything", detect.ALL, "", "AP"]["value"] == pytest.approx(1.0)
    assert told["near", detect.ALL, "", "AR"]["value"] == pytest.approx(0.5)
    assert told["near", detect.ALL, "", "AP"]["value"] == pytest.approx(51 / 101)
    # one of two in clear air, and each of the two that fog leaves in two pictures: 3 of 4 of each class
    assert told["near", detect.LEFT, "", "AR"]["value"] == pytest.approx(3 / 4)
    names = ("table.md", "table.csv", "results.json")
    tables = {name: (out / name).read_bytes() for name in names}
    again = cli.run("benchmark", "detect", baked, "-o", out, "--model", own, "--quiet")
    assert again.returncode == 0 and {name: (out / name).read_bytes() for name in names} == tables
    bench = detect.run(detect.find(baked), [detect.DetectorRun(one) for one in detectors.chosen([str(own)])], out)
    assert bench.fresh == 0 and not bench.failures(bench.methods[0])
    table = tables["table.md"].decode()
    assert "| 1 | near | what fog leaves |" in table and "3 of 3" in table and "MOR 50 to 100 m" in table
    with Image.open(out / "pictures.png") as sheet:
        assert sheet.width > 3 * 300


@pytest.mark.slow
def test_bad_detectors_end_in_a_line_each_and_the_rest_goes_on(baked, tmp_path):
    """One dies, one hangs, one tells NaN, one writes no boxes, one takes another input, one has another layout."""
    pytest.importorskip("pycocotools")
    bad = everything()
    bad[0, 0] = np.nan
    network(tmp_path / "good.onnx", out=everything())
    network(tmp_path / "nan.onnx", out=bad)
    network(tmp_path / "grey.onnx", channels=1, out=everything())
    network(tmp_path / "raw.onnx", out=np.zeros((1, 84, 80), dtype=np.float32))
    dies = json.dumps([sys.executable, "-c", "import os; os.kill(os.getpid(), 9)", "{in}", "{out}"])
    hangs = json.dumps([sys.executable, "-c", "import time; time.sleep(60)", "{in}", "{out}"])
    lies = json.dumps([sys.executable, "-c", "import sys; open(sys.argv[2], 'w').write('[[1, 2]]')", "{in}", "{out}"])
    own = declared(
        tmp_path,
        f"""
        - {{name: dies, command: {dies}, classes: {CLASSES}}}
        - {{name: hangs, command: {hangs}, timeout_s: 1, classes: {CLASSES}}}
        - {{name: lies, command: {lies}, classes: {CLASSES}}}
        - {{name: nan, onnx: nan.onnx, classes: {CLASSES}}}
        - {{name: grey, onnx: grey.onnx, classes: {CLASSES}}}
        - {{name: raw, onnx: raw.onnx, classes: {CLASSES}}}
        - {{name: good, onnx: good.onnx, classes: {CLASSES}}}
        """,
    )
    done = cli.run("benchmark", "detect", baked, "-o", tmp_path / "out", "--model", own, "--limit", "1", "--quiet")
    assert done.returncode == 1 and "dies, hangs, lies, nan, grey, raw gave no answer at all" in done.stderr
    table = (tmp_path / "out" / "table.md").read_text(encoding="utf-8")
    assert "| 1 | good | all things | 1.000" in table
    for words in (
        "ended with -9",
        "gave no answer within 1 s",
        "a box is [x, y, width, height, score, class number], and this is [1, 2]",
        "the answer holds NaN or infinity",
        "it must take a picture (1, 3, H, W)",
        "the network gave out (1, 84, 80); it must give (N, 6)",
    ):
        assert words in table, words
    assert "Traceback" not in done.stderr + table


def test_a_source_without_pictures_or_things_is_refused(baked, tmp_path):
    network(tmp_path / "all.onnx", out=everything())
    own = declared(tmp_path, f"- {{name: a, onnx: all.onnx, classes: {CLASSES}}}\n")
    (tmp_path / "empty").mkdir()
    done = cli.run("benchmark", "detect", tmp_path / "empty", "-o", tmp_path / "out", "--model", own)
    assert done.returncode == 2 and "no index of a set" in done.stderr and not (tmp_path / "out").exists()
    with pytest.raises(ParameterError, match=r"no picture other.png; it takes a set or a bake"):
        detect.find(baked, picture="other.png")
    bare = tmp_path / "bare"
    shutil.copytree(baked, bare)
    rows = json.loads((bare / "labels.json").read_text())
    files.write_json(bare / "labels.json", {**rows, "instances": rows["instances"][-1:]})
    with pytest.raises(ParameterError, match="nothing that could be found is seen in any of 3 pictures"):
        detect.find(bare)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- yolo\n", "a detector is a mapping"),
        ("- {name: a, onnx: a.onnx, order: gbr, classes: coco80}\n", "order is 'gbr'; it is one of rgb, bgr"),
        ("- {name: a, onnx: a.onnx, classes: [persn]}\n", "'persn' is no label of Cityscapes. Did you mean"),
        ("- {name: a, onnx: a.onnx, classes: [car], size: 640}\n", "size is 640; it takes 2 numbers"),
        ("- {name: a, onnx: a.onnx, classes: [car]}\n", "a.onnx: no such file"),
    ],
)
def test_faults_of_a_file_of_detectors_are_one_line_with_its_place(tmp_path, text, words):
    with pytest.raises(ParameterError) as found:
        detectors.chosen([str(declared(tmp_path, text))])
    assert words in str(found.value) and "\n" not in str(found.value) and "detectors.yaml:" in str(found.value)

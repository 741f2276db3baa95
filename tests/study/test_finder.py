"""The small detector: what it is taught, by hand; the same twice; it finds painted boxes, through the bench's child."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from PIL import Image as Picture

from synfog_usd.base import files, seeds
from synfog_usd.base.errors import ParameterError
from synfog_usd.lab.benchmark import coco, decode, detectors, methods
from synfog_usd.lab.benchmark.detect import FoggedView, LabelledThing
from synfog_usd.lab.study import finder, networks, training

CLASSES = ("car", "person")


def thing(box, label="car", visibility="visible"):
    return LabelledThing(1, label, tuple(map(float, box)), int(box[2] * box[3]), 20.0, visibility)


def painted(folder, number, count=1):
    """Grey noise with red boxes, which are cars, and tall blue ones, which are persons; sides are 64 and 48 pixels."""
    rng = seeds.stream(number, "boxes")
    pixels = rng.normal(110.0, 12.0, (48, 64, 3))
    things = []
    for label, colour, (wide, high) in (("car", (210, 60, 50), (20, 12)), ("person", (50, 70, 210), (7, 17))):
        side = round(wide * rng.uniform(0.8, 1.2)), round(high * rng.uniform(0.8, 1.2))
        x = int(rng.integers(0, 30 - side[0])) + 32 * (label == "person")
        y = int(rng.integers(0, 48 - side[1]))
        pixels[y : y + side[1], x : x + side[0]] = colour
        things.append(thing((x, y, *side), label))
    path = folder / f"{number}.png"
    Picture.fromarray(np.clip(pixels, 0, 255).astype(np.uint8)).save(path)
    return FoggedView(None, path, tuple(things))


@pytest.fixture
def small(monkeypatch):
    torch = pytest.importorskip("torch", reason="torch is not installed")
    monkeypatch.setattr(finder, "SIDE_PX", 64)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield torch
    torch.set_num_threads(before)


def test_a_thing_is_taught_in_the_cells_about_its_middle():
    """A box of 20 x 12 px at (4, 8): its middle (14, 14) lies in cell (7, 7).  By hand: spread 0.9 and 0.54 cells."""
    heat, sides, weight = finder.targets([(1, True, 4, 8, 20, 12)], 2, 12)
    assert heat[1, 7, 7] == 1.0 and not heat[0].any()
    assert heat[1, 7, 8] == pytest.approx(np.exp(-0.5 / 0.9**2), rel=1e-6)
    assert heat[1, 8, 7] == pytest.approx(np.exp(-0.5 / 0.54**2), rel=1e-6)
    near = np.argwhere(weight > 0).tolist()
    assert near == [[7, 6], [7, 7], [7, 8]] and weight.sum() == pytest.approx(1.0)
    assert all(sides[:, y, x].tolist() == [4, 8, 24, 20] for y, x in near)


def test_what_no_camera_sees_is_neither_thing_nor_background():
    heat, _, weight = finder.targets([(0, False, 4, 8, 20, 12), (1, True, 0, 0, 4, 4)], 2, 12)
    region = np.zeros((12, 12), dtype=bool)
    region[4:10, 2:12] = True
    assert np.array_equal(heat[0] == -1.0, region) and heat[1].min() == 0.0 and heat[1, 1, 1] == 1.0
    assert weight.sum() == pytest.approx(1.0)  # only the other thing's
    assert not finder.taught(thing((0, 0, 9, 9), visibility="invisible")) and not finder.taught(thing((0, 0, 3, 3)))
    assert finder.taught(thing((0, 0, 4, 3), visibility="faint"))


def test_a_middle_in_another_square_is_not_taught():
    heat, _, weight = finder.targets([(0, True, 40, 0, 40, 8)], 1, 12)
    assert not heat.any() and not weight.any()


def test_a_square_is_the_picture_enlarged_and_its_boxes_go_with_it(small, tmp_path, monkeypatch):
    """Boxes stay on their colour, whatever the square: inside a red box's middle half red is far above blue."""
    monkeypatch.setattr(finder, "ZOOM", (0.7, 2.0))
    seen, rng = [], seeds.stream(0, "squares")
    for number in range(40):
        square, heat, sides, weight = finder._square(painted(tmp_path, number), CLASSES, rng)
        assert square.shape == (3, 64, 64) and square.min() >= 0.0 and square.max() <= 1.0
        for kind, y, x in np.argwhere(heat == 1.0):
            left, top, right, bottom = sides[:, y, x]
            assert weight[y, x] > 0.0
            low, high = ((3 * a + b) / 4 for a, b in ((left, right), (top, bottom)))
            wide, tall = (right - left) / 2, (bottom - top) / 2
            part = square[:, max(0, int(high)) : int(high + tall) + 1, max(0, int(low)) : int(low + wide) + 1]
            redder = part[0].mean() - part[2].mean()
            assert redder > 0.2 if kind == 0 else redder < -0.2
            seen.append((right - left) / (20 if kind == 0 else 7))
    assert len(seen) > 30 and min(seen) < 0.8 and max(seen) > 1.6


def test_what_is_taught_reads_back_as_the_boxes(small, tmp_path):
    """A network that says just what it was taught gets every box of a street, rows of small ones among them: AP 1.0
    through the bench's decoding, and 1 box a thing."""
    pytest.importorskip("pycocotools")
    rng, true, found = seeds.stream(0, "street"), [], []
    classes = (0, ("car",)), (1, ("person",))
    detector = detectors.Detector(name="taught", kind="onnx", version="", layout="yolov8", classes=classes)
    for picture in range(12):
        rows, taken = [], np.zeros((96, 160), dtype=bool)
        for _ in range(60):
            kind, wide = int(rng.integers(2)), float(np.exp(rng.uniform(np.log(4), np.log(70))))
            high = wide * (0.6 if kind == 0 else 1.4)
            left, top = rng.uniform(0, max(1.0, 160 - wide)), rng.uniform(0, max(1.0, 96 - high))
            area = taken[int(top) : int(top + high) + 4, int(left) : int(left + wide) + 4]
            if not area.any() and top + high < 96 and left + wide < 160:
                area[:] = True
                rows.append((kind, True, left, top, wide, high))
        heat, sides, _ = (small.from_numpy(part) for part in finder.targets(rows, 2, 80))
        x, y = finder.middles_px(small, heat[None])
        edges = small.stack([x - sides[0], y - sides[1], sides[2] - x, sides[3] - y])[None] / finder.CELL_PX
        answer = finder.told(small, small.logit(heat[None], 1e-6), edges).numpy()

        class Session:
            def get_inputs(self):
                return [SimpleNamespace(name="picture", shape=[1, 3, None, None], type="tensor(float)")]

            def get_outputs(self):
                return [SimpleNamespace(name="found")]

            def run(self, outputs, feed, answer=answer):
                return [answer]

        boxes = decode.detector(detector, Session())(np.zeros((160, 160, 3), dtype=np.uint8))
        assert len([row for row in boxes if row[4] > 0.999]) == len(rows) > 8
        true += [coco.TrueBox(picture, row[0], row[2:], 0.0) for row in rows]
        found += [coco.FoundBox(picture, row[5], row[:4], row[4], 0.0) for row in boxes]
    (whole,) = coco.match(12, true, found, [coco.EVERYTHING]).groups
    assert coco.precision(whole, np.ones((1, 12))).mean() == pytest.approx(1.0, abs=1e-3)


def test_several_labels_are_one_class(small, tmp_path, monkeypatch):
    """car+person is taught as one class, and the bench scores both labels by it."""
    monkeypatch.setattr(networks, "write_onnx", lambda path, *more: files.write_bytes(path, b""))
    rng, seen = seeds.stream(0, "squares"), 0
    for number in range(6):
        heat = finder._square(painted(tmp_path, number), ("car+person", "rider"), rng)[1]
        seen += (heat[0] == 1.0).sum()
        assert not heat[1].any()
    assert seen > 6
    finder.write(finder.TrainedFinder(None, ("car+person", "rider"), (1.0,)), tmp_path / "merged")
    assert detectors.chosen([str(tmp_path / "merged" / "detectors.yaml")])[0].classes == (
        (0, ("car", "person")),
        (1, ("rider",)),
    )


def test_overlap_of_boxes_by_hand(small):
    """Squares of 2 with a corner in common: 1 of 7, in a hull of 9; apart by 1: 0 of 8, in a hull of 10."""
    one = small.tensor([[0.0, 0, 2, 2]])
    for other, wanted in (((1, 1, 3, 3), 1 / 7 - 2 / 9), ((3, 0, 5, 2), -2 / 10), ((0, 0, 2, 2), 1.0)):
        assert float(finder.giou(small, one, small.tensor([[*map(float, other)]]))) == pytest.approx(wanted, abs=1e-6)


def test_the_same_seed_gives_the_same_weights(small, tmp_path):
    """Bit for bit, and another seed gives others; the network has less than a million weights."""
    found = [painted(tmp_path, number) for number in range(2)]
    first, again, other = (finder.train(found, CLASSES, steps=2, seed=seed) for seed in (0, 0, 1))
    states = [[value.numpy() for value in one.model.state_dict().values()] for one in (first, again, other)]
    assert all(np.array_equal(a, b) for a, b in zip(states[0], states[1], strict=True))
    assert not np.array_equal(states[0][0], states[2][0])
    assert sum(value.size for value in states[0]) < 1_000_000


@pytest.mark.slow
def test_painted_boxes_are_found_through_the_bench(small, tmp_path):
    """Trained on forty pictures it finds both boxes of others that it never saw, three quarters of each box right."""
    pytest.importorskip("onnxscript")
    from synfog_usd.lab.benchmark.detectors import chosen
    from synfog_usd.lab.benchmark.worker import MethodWorker

    trained = finder.train([painted(tmp_path, number) for number in range(40)], CLASSES, steps=250)
    finder.write(trained, tmp_path / "out")
    assert len((tmp_path / "out" / "losses.csv").read_text().splitlines()) == 251
    detector = chosen([str(tmp_path / "out" / "detectors.yaml")])[0]
    assert detector.name == "out"
    worker = MethodWorker(detector, tmp_path)
    try:
        for number in range(100, 104):
            view = painted(tmp_path, number)
            boxes = json.loads(worker.ask(view.picture).read_text())
            for place, true in enumerate(view.things):
                best = max((row for row in boxes if row[5] == place), key=lambda row: row[4])
                sure = [row for row in boxes if row[5] == place and row[4] > 0.3]
                assert len(sure) == 1 and sure[0] == best
                assert overlap(best[:4], true.box) > 0.75
    finally:
        worker.close()


def overlap(one, other):
    low = np.maximum(one[:2], other[:2])
    high = np.minimum(np.add(one[:2], one[2:]), np.add(other[:2], other[2:]))
    both = np.prod(np.clip(high - low, 0, None))
    return both / (one[2] * one[3] + other[2] * other[3] - both)


@pytest.mark.parametrize("name", ["clear", "fog: {all}", "Nebel-größer"])
def test_a_network_is_called_as_its_folder(tmp_path, name):
    """So that two of them stand in one bench; a name stays one word of YAML, whatever is in it."""
    assert yaml.safe_load(f"{{name: {networks.name_of(tmp_path / name)}, onnx: a.onnx}}")["name"] == name


def test_two_trainings_stand_in_one_bench(tmp_path, monkeypatch):
    """As the page has it, `--model finder/detectors.yaml --model clear/detectors.yaml`, and defoggers likewise; two
    folders of one name are told."""
    monkeypatch.setattr(networks, "write_onnx", lambda path, *more: files.write_bytes(path, path.parent.name.encode()))
    monkeypatch.setattr(training, "as_bytes", lambda found: b"")
    folders = [tmp_path / name for name in ("finder", "clear", "again/clear")]
    for out in folders:
        finder.write(finder.TrainedFinder(None, CLASSES, (1.0, 0.5)), out)
        training.write(training.TrainedDefogger(None, False, (1.0, 0.5)), out)
    for chosen, name in ((detectors.chosen, "detectors.yaml"), (methods.chosen, "methods.yaml")):
        paths = [str(out / name) for out in folders]
        first, second = chosen(paths[:2])
        assert (first.name, second.name) == ("finder", "clear") and first.version != second.version
        with pytest.raises(ParameterError, match="'clear'; give one another name"):
            chosen(paths)


def test_classes_without_boxes_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="'road' is no class of things"):
        finder.views(tmp_path, ("car", "road"))
    with pytest.raises(ParameterError, match=r"'persn' is no class of things.*person"):
        finder.views(tmp_path, ("persn",))
    with pytest.raises(ParameterError, match="'bus' stands in two classes"):
        finder.views(tmp_path, ("car+bus", "truck+bus"))

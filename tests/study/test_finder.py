"""The small detector: what it is taught, by hand; the same twice; it finds painted boxes, through the bench's child."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image as Picture

from docs.studies import finder
from synfog_usd.base import seeds
from synfog_usd.base.errors import ParameterError
from synfog_usd.lab.benchmark import coco, decode, detectors
from synfog_usd.lab.benchmark.detect import FoggedView, LabelledThing

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


def test_classes_without_boxes_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="'road' is no class of things"):
        finder.views(tmp_path, ("car", "road"))
    with pytest.raises(ParameterError, match=r"'persn' is no class of things.*person"):
        finder.views(tmp_path, ("persn",))
    with pytest.raises(ParameterError, match="'bus' stands in two classes"):
        finder.views(tmp_path, ("car+bus", "truck+bus"))

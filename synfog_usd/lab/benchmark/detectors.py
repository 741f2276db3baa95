"""Which detectors are compared: ONNX networks and others' own commands, declared in YAML.

    synfog: benchmark/1
    detectors:
      - name: yolo
        onnx: yolo.onnx
        size: [640, 640]              # width and height that it is given [px]; its own if it has a fixed one
        letterbox: true               # keep the picture's proportions and pad; false stretches
        mean: [0, 0, 0]               # (R, G, B of 0 to 1 - mean) / std
        std: [1, 1, 1]
        classes: coco80               # or coco91, or what its classes are in the set

`classes` is a list of Cityscapes' labels by class number, with null for what the set has not, or a mapping from labels
to numbers, `{person: 0, rider: 0, car: 2}`, of which one class may cover several.  A command reads the picture {in} and
writes JSON to {out}: a list of [x, y, width, height, score, class number] in the picture's pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from synfog_usd.base.cityscapes import LABELS
from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.base.yamlio import Located, switch
from synfog_usd.lab.benchmark.methods import OF_ALL, Method, declared, is_file, listed, mapping, number, refuse_twins

OUTPUTS = ("boxes", "scores", "labels")
OF_DETECTORS = ("classes", "size", "letterbox", "mean", "std", "order", "score", "centred", "relative", "outputs")
FIELDS = (*OF_ALL, *OF_DETECTORS)

Classes = tuple[tuple[int, tuple[str, ...]], ...]
"""Class number, and the labels that it covers."""

_COCO80 = {0: "person", 1: "bicycle", 2: "car", 3: "motorcycle", 5: "bus", 6: "train", 7: "truck", 9: "traffic light"}
_COVERS = {"person": ("person", "rider")}
"""COCO has no riders: they are persons on something."""

COCO: dict[str, Classes] = {
    "coco80": tuple((number, _COVERS.get(name, (name,))) for number, name in _COCO80.items()),
    "coco91": tuple((number + 1, _COVERS.get(name, (name,))) for number, name in _COCO80.items()),
}
"""COCO's road users and traffic lights, by their place among the 80 that are used, and by their official numbers."""


@dataclass(frozen=True)
class Detector(Method):
    """One way to find things; its answer is a list of boxes.

    Attributes:
        classes: which of its classes are measured, and what they cover.
        size: width and height of its input [px], or ().
        letterbox: whether the picture keeps its proportions in it.
        mean, std: of R, G and B, 0 to 1.
        order: 'rgb' or 'bgr'.
        score: boxes below it are left out.
        centred, relative: its boxes are centre, width and height, not corners; are shares of the sides, not pixels.
        outputs: names of the network's outputs by what they hold, where their shapes do not distinguish them.
    """

    suffix: ClassVar[str] = ".json"

    classes: Classes = ()
    size: tuple[int, ...] = ()
    letterbox: bool = True
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    order: str = "rgb"
    score: float = 0.001
    centred: bool = False
    relative: bool = False
    outputs: tuple[tuple[str, str], ...] = ()


def chosen(paths: Sequence[str]) -> tuple[Detector, ...]:
    """The detectors of YAML files.

    Raises:
        ParameterError: a fault in a file, with its place.
    """
    result = []
    for path in paths:
        if not is_file(path):
            raise ParameterError(f"{path}: a detector is declared in a YAML file; see docs/benchmark.md")
        result += [_detector(entry, Path(path).parent) for entry in listed(Path(path), "detectors")]
    refuse_twins(result)
    return tuple(result)


def _detector(entry: Located, folder: Path) -> Detector:
    fields = mapping(entry, "a detector", FIELDS)
    if "classes" not in fields:
        raise ParameterError(f"{entry.place}: a detector needs classes: {', '.join(COCO)}, a list or a mapping")
    more: dict[str, Any] = {}
    more["classes"] = _classes(fields["classes"])
    flags = dict.fromkeys(("letterbox", "centred", "relative"), (True, False))
    for key, allowed in {"order": ("rgb", "bgr"), **flags}.items():
        if key in fields:
            value = switch(fields[key].plain()) if key in flags else fields[key].plain()
            if not any(value is option or (isinstance(option, str) and value == option) for option in allowed):
                words = ", ".join(str(word).lower() for word in allowed)
                raise ParameterError(f"{fields[key].place}: {key} is {value!r}; it is one of {words}")
            more[key] = value
    if "size" in fields:
        more["size"] = tuple(int(side) for side in _numbers(fields["size"], "size", 2, 8, 16384))
    for key, low in (("mean", -1000.0), ("std", 1e-6)):
        if key in fields:
            more[key] = _numbers(fields[key], key, 3, low, 1000.0)
    if "score" in fields:
        more["score"] = float(number(fields["score"], "score", 0.0, 1.0))
    if "outputs" in fields:
        named = mapping(fields["outputs"], "outputs", OUTPUTS)
        more["outputs"] = tuple((key, str(node.plain())) for key, node in named.items())
    return Detector(**declared(entry, fields, folder, more), **more)


def _numbers(node: Located, key: str, count: int, low: float, high: float) -> tuple[float, ...]:
    if not isinstance(node.value, list) or len(node.value) != count:
        raise ParameterError(f"{node.place}: {key} is {node.plain()!r}; it takes {count} numbers, {low:g} to {high:g}")
    return tuple(float(number(entry, key, low, high)) for entry in node.value)


def _classes(node: Located) -> Classes:
    """What each class covers."""
    if isinstance(node.value, str):
        if node.value not in COCO:
            raise ParameterError(
                f"{node.place}: classes is {node.value!r}; it is {', '.join(COCO)}, a list or a mapping"
            )
        return COCO[node.value]
    if isinstance(node.value, list):
        covered = [(entry, place) for place, entry in enumerate(node.value) if entry.value is not None]
    elif isinstance(node.value, dict):
        covered = [
            (Located(label, entry.key_place or entry.place), _place(entry)) for label, entry in node.value.items()
        ]
    else:
        raise ParameterError(f"{node.place}: classes is {', '.join(COCO)}, a list or a mapping")
    label_names = {label.name for label in LABELS.values()}
    result: dict[int, list[str]] = {}
    for label, place in covered:
        if label.value not in label_names:
            near = did_you_mean(str(label.value), sorted(label_names))
            raise ParameterError(f"{label.place}: {label.value!r} is no label of Cityscapes.{near}")
        if any(label.value in labels for labels in result.values()):
            raise ParameterError(f"{label.place}: {label.value!r} is covered by two classes; give it to one")
        result.setdefault(place, []).append(label.value)
    if not result:
        raise ParameterError(f"{node.place}: classes names no label of the set")
    return tuple((place, tuple(result[place])) for place in sorted(result))


def _place(node: Located) -> int:
    if not isinstance(node.value, int) or isinstance(node.value, bool) or node.value < 0:
        raise ParameterError(f"{node.place}: {node.plain()!r} is no number of a class, which begin at 0")
    return node.value


def as_boxes(answer: object, detector: Detector) -> list[list[float]]:
    """A detector's answer, once it is known to be one.

    Returns:
        [x, y, width, height, score, class number], of the classes that are measured, in its order.

    Raises:
        ValueError: it is something else.
    """
    if not isinstance(answer, list):
        raise ValueError("the answer is no list of boxes")
    measured = {place for place, _ in detector.classes}
    for box in answer:
        if not isinstance(box, list) or len(box) != 6 or not all(type(part) in (int, float) for part in box):
            raise ValueError(f"a box is [x, y, width, height, score, class number], and this is {str(box)[:80]}")
        if not all(math.isfinite(part) for part in box):
            raise ValueError("the answer holds NaN or infinity")
    return [box for box in answer if box[5] in measured and box[2] > 0.0 and box[3] > 0.0]

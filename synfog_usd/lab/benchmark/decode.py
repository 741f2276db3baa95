"""From a picture to a detector's input, and from its outputs to boxes, for the layouts that networks are exported with.

| layout | outputs |
|---|---|
| yolov5 | (1, N, 5 + C): centre, width and height [px], how sure it is of a thing, and the classes (v5, v7) |
| yolov8 | (1, 4 + C, N): centre, width and height [px], and the classes (v8, v9, v11, v12) |
| detr | logits (1, N, C + 1), the last for nothing, and boxes (1, N, 4): centre, width, height by the sides |
| rtdetr | logits or scores (1, N, C) of classes that do not exclude each other, and such boxes (also DINO) |
| boxes | decoded: boxes (N, 4), scores (N,), class numbers (N,); or all in one, (N, 6) (torchvision, YOLOv10) |

Pixels are those of what the network was given.  YOLO's boxes that lie on each other are thinned here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array, Pixels
from synfog_usd.lab.benchmark.detectors import Detector

GREY = 114
"""What YOLO's letterboxes are filled with."""

STRIDE_PX = 32
MOST = 100
"""Boxes of a class in a picture; COCO counts at most as many."""

CANDIDATES = 3000
"""Boxes of a class that are looked at, the best first."""

Boxes = tuple[Array, Array, Pixels]
"""(N, 4) corners [px], (N,) scores and (N,) class numbers."""


def detector(method: Detector, session: Any) -> Callable[[np.ndarray], list[list[float]]]:
    """What finds things in a picture (H, W, 3) uint8.

    Args:
        method: how the network is to be used.
        session: of onnxruntime, or its like.

    Raises:
        ValueError: the network takes no picture.  What it returns raises it where outputs are not of the layout, or not
            finite.
    """
    inputs, outputs = session.get_inputs(), [output.name for output in session.get_outputs()]
    shape = list(inputs[0].shape)
    if len(shape) not in (3, 4) or (isinstance(shape[-3], int) and shape[-3] != 3):
        raise ValueError(
            f"the network takes {', '.join(f'{i.name} {i.shape}' for i in inputs)}; it must take a picture (1, 3, H, W)"
        )
    sides = [side if isinstance(side, int) else 0 for side in shape[-2:]]
    fixed = (sides[1], sides[0]) if all(sides) else ()
    if fixed and method.size and fixed != tuple(method.size):
        raise ValueError(
            f"the network takes {fixed[0]} x {fixed[1]}, and size says {' x '.join(map(str, method.size))}"
        )
    kind = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}.get(inputs[0].type)
    if kind is None:
        raise ValueError(f"the network takes {inputs[0].type}; float, float16 and uint8 are known")

    def find(picture: np.ndarray) -> list[list[float]]:
        tensor, scale, offset = fitted(picture, fixed or tuple(method.size), letterbox=method.letterbox)
        pixels = tensor if kind == np.uint8 else (tensor / 255.0 - method.mean) / method.std
        if method.order == "bgr":
            pixels = pixels[..., ::-1]
        batch = np.ascontiguousarray(pixels.transpose(2, 0, 1).astype(kind))
        feed = {inputs[0].name: batch if len(shape) == 3 else batch[None]}
        height, width = tensor.shape[:2]
        for more in inputs[1:]:  # RT-DETR asks for the size in whose pixels it is to answer
            feed[more.name] = np.array([[width, height]], dtype=np.int64)
        answers = dict(zip(outputs, map(np.asarray, session.run(outputs, feed)), strict=True))
        boxes, scores, labels = LAYOUTS[method.layout](method, answers, (width, height))
        if not (np.isfinite(boxes).all() and np.isfinite(scores).all()):
            raise ValueError("the answer holds NaN or infinity")
        boxes = (boxes - np.tile(offset, 2)) / np.tile(scale, 2)
        limit = np.tile([picture.shape[1], picture.shape[0]], 2)
        boxes = np.clip(boxes, 0.0, limit)
        boxes[:, 2:] -= boxes[:, :2]
        best = _best(boxes, scores, labels, method)
        return [
            [*(round(float(part), 2) for part in boxes[n]), float(f"{scores[n]:.6g}"), int(labels[n])] for n in best
        ]

    return find


def fitted(picture: np.ndarray, size: tuple[int, ...], *, letterbox: bool) -> tuple[Pixels, Array, Array]:
    """A picture as the network is given it.

    Args:
        picture: (H, W, 3) uint8.
        size: width and height [px]; () leaves the picture as it is, padded to multiples of 32 with `letterbox`.
        letterbox: keep the proportions, and fill with grey.

    Returns:
        (h, w, 3) pixels; factor in x and y, and offset [px], from the picture's pixels to those.
    """
    from PIL import Image

    high, wide = picture.shape[:2]
    if not size and not letterbox:
        return picture, np.ones(2), np.zeros(2)
    if not size:
        inner = (wide, high)
        size = (-(-wide // STRIDE_PX) * STRIDE_PX, -(-high // STRIDE_PX) * STRIDE_PX)
    elif letterbox:
        share = min(size[0] / wide, size[1] / high)
        inner = (max(1, round(share * wide)), max(1, round(share * high)))
    else:
        inner = (size[0], size[1])
    if inner != (wide, high):
        picture = np.asarray(Image.fromarray(picture).resize(inner, Image.Resampling.BILINEAR))
    left_px, top = (size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2
    whole = np.full((size[1], size[0], 3), GREY, dtype=np.uint8)
    whole[top : top + inner[1], left_px : left_px + inner[0]] = picture
    return whole, np.array([inner[0] / wide, inner[1] / high]), np.array([left_px, top], dtype=np.float64)


def _yolov5(method: Detector, answers: dict[str, np.ndarray], size: tuple[int, int]) -> Boxes:
    answer = _only(method, answers)
    if answer.ndim != 3 or answer.shape[2] < 6:
        raise _unlike(method, answers, "(1, N, 5 + classes)")
    table = answer[0].astype(np.float64)
    return _thinned(method, _corners(table[:, :4]), table[:, 5:] * table[:, 4:5], answers)


def _yolov8(method: Detector, answers: dict[str, np.ndarray], size: tuple[int, int]) -> Boxes:
    answer = _only(method, answers)
    if answer.ndim != 3 or answer.shape[1] < 5:
        raise _unlike(method, answers, "(1, 4 + classes, N)")
    table = answer[0].T.astype(np.float64)
    return _thinned(method, _corners(table[:, :4]), table[:, 4:], answers)


def _detr(method: Detector, answers: dict[str, np.ndarray], size: tuple[int, int]) -> Boxes:
    boxes, logits = _boxes_and(method, answers, size)
    shares = np.exp(logits - logits.max(axis=1, keepdims=True))
    shares = (shares / shares.sum(axis=1, keepdims=True))[:, :-1]
    _check_classes(method, shares.shape[1], answers)
    labels = shares.argmax(axis=1)
    return boxes, shares[np.arange(len(shares)), labels], labels


def _rtdetr(method: Detector, answers: dict[str, np.ndarray], size: tuple[int, int]) -> Boxes:
    boxes, logits = _boxes_and(method, answers, size)
    scores = logits if logits.min() >= 0.0 and logits.max() <= 1.0 else 1.0 / (1.0 + np.exp(-logits))
    _check_classes(method, scores.shape[1], answers)
    query, labels = np.nonzero(scores >= method.score)
    return boxes[query], scores[query, labels], labels


def _decoded(method: Detector, answers: dict[str, np.ndarray], size: tuple[int, int]) -> Boxes:
    boxes, scores, labels = _listed(method, answers)
    if method.centred:
        boxes = _corners(boxes)
    return boxes * np.tile(size, 2) if method.relative else boxes, scores, labels


def _listed(method: Detector, answers: dict[str, np.ndarray]) -> Boxes:
    """Of one output or three, as they are."""
    if len(answers) == 1:
        table = _flat(_only(method, answers), 2).astype(np.float64)
        if table.ndim != 2 or table.shape[1] != 6:
            raise _unlike(method, answers, "(N, 6): corners, score and class")
        return table[:, :4], table[:, 4], np.rint(table[:, 5]).astype(np.int64)
    named = dict(method.outputs)
    unnamed = {name: answer for name, answer in answers.items() if name not in named.values()}
    for what, wished in (
        ("boxes", lambda one: one.ndim >= 2 and one.shape[-1] == 4),
        ("labels", lambda one: np.issubdtype(one.dtype, np.integer)),
        ("scores", lambda one: one.dtype.kind == "f"),
    ):
        if what not in named:
            name = next((name for name, answer in unnamed.items() if wished(answer)), None)
            if name is None:
                raise _unlike(method, answers, "boxes (N, 4), scores (N,) and labels (N,)")
            named[what] = name
            del unnamed[name]
    if missing := next((name for name in named.values() if name not in answers), None):
        raise ValueError(f"the network has no output {missing!r}; it has {', '.join(answers)}")
    boxes, scores, labels = _flat(answers[named["boxes"]], 2), answers[named["scores"]], answers[named["labels"]]
    if boxes.ndim != 2 or boxes.shape[1] != 4 or not len(boxes) == scores.size == labels.size:
        raise _unlike(method, answers, "boxes (N, 4), scores (N,) and labels (N,)")
    return boxes.astype(np.float64), scores.ravel().astype(np.float64), np.rint(labels.ravel()).astype(np.int64)


LAYOUTS: dict[str, Callable[[Detector, dict[str, np.ndarray], tuple[int, int]], Boxes]] = {
    "yolov5": _yolov5,
    "yolov8": _yolov8,
    "detr": _detr,
    "rtdetr": _rtdetr,
    "boxes": _decoded,
}


def _only(method: Detector, answers: dict[str, np.ndarray]) -> np.ndarray:
    """The output that is named, else the first."""
    name = dict(method.outputs).get("boxes", next(iter(answers)))
    if name not in answers:
        raise ValueError(f"the network has no output {name!r}; it has {', '.join(answers)}")
    return answers[name]


def _flat(answer: np.ndarray, axes: int) -> np.ndarray:
    """Without a batch of one."""
    return answer[0] if answer.ndim == axes + 1 and answer.shape[0] == 1 else answer


def _boxes_and(method: Detector, answers: dict[str, np.ndarray], size: tuple[int, int]) -> tuple[Array, Array]:
    """(N, 4) corners [px] and (N, C) numbers of classes, from shares of the sides."""
    named = dict(method.outputs)
    if len(answers) == 1:  # both in one, as Ultralytics exports RT-DETR
        both = _flat(_only(method, answers), 2)
        answers, named = {"boxes": both[..., :4], "scores": both[..., 4:]}, {}
    likely = sorted(answers, key=lambda name: "box" not in name.lower())
    boxes = named.get("boxes") or next((name for name in likely if answers[name].shape[-1] == 4), "")
    scores = named.get("scores") or next((name for name in answers if name != boxes), "")
    if boxes not in answers or scores not in answers:
        raise _unlike(method, answers, "logits (1, N, classes) and boxes (1, N, 4)")
    corners, logits = _flat(answers[boxes], 2), _flat(answers[scores], 2)
    if corners.ndim != 2 or logits.ndim != 2 or corners.shape[1] != 4 or len(corners) != len(logits):
        raise _unlike(method, answers, "logits (1, N, classes) and boxes (1, N, 4)")
    if not (np.isfinite(corners).all() and np.isfinite(logits).all()):
        raise ValueError("the answer holds NaN or infinity")
    return _corners(corners.astype(np.float64)) * np.tile(size, 2), logits.astype(np.float64)


def _corners(boxes: Array) -> Array:
    """Left, top, right and bottom of centre, width and height."""
    half = boxes[:, 2:] / 2.0
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def _check_classes(method: Detector, count: int, answers: dict[str, np.ndarray]) -> None:
    highest = max(place for place, _ in method.classes)
    if method.count and count != method.count:
        raise _unlike(method, answers, f"{method.count} classes, as classes says; {count} were found")
    if highest >= count:
        raise _unlike(method, answers, f"a class {highest}, which classes names; {count} were found")


def _unlike(method: Detector, answers: dict[str, np.ndarray], expected: str) -> ValueError:
    shapes = ", ".join(f"{name} {answer.shape}" for name, answer in answers.items())
    return ValueError(f"the network gave {shapes}; the layout {method.layout} has {expected}")


def _thinned(method: Detector, boxes: Array, scores: Array, answers: dict[str, np.ndarray]) -> Boxes:
    """Of boxes of a class that lie on each other the best.

    Args:
        boxes: (N, 4) corners.
        scores: (N, C).
    """
    _check_classes(method, scores.shape[1], answers)
    if not (np.isfinite(boxes).all() and np.isfinite(scores).all()):
        raise ValueError("the answer holds NaN or infinity")
    chosen_rows: list[tuple[np.ndarray, int]] = []
    for place, _ in method.classes:
        above = np.flatnonzero(scores[:, place] >= method.score)
        above = above[np.argsort(-scores[above, place], kind="stable")][:CANDIDATES]
        chosen_rows.append((above[suppressed(boxes[above], method.nms)], place))
    rows = np.concatenate([above for above, _ in chosen_rows])
    labels = np.concatenate([np.full(len(above), place) for above, place in chosen_rows])
    return boxes[rows], scores[rows, labels], labels


def suppressed(boxes: Array, most: float) -> np.ndarray:
    """Places of the boxes that stay, of (N, 4) corners with the best first: greedy non-maximum suppression.

    A box goes where its intersection over union with a better one that stayed is over `most`.
    """
    area = np.prod(np.maximum(boxes[:, 2:] - boxes[:, :2], 0.0), axis=1)
    waiting = np.arange(len(boxes))
    survivors: list[int] = []
    while waiting.size and len(survivors) < MOST:
        best, waiting = waiting[0], waiting[1:]
        survivors.append(best)
        corner = np.minimum(boxes[waiting, 2:], boxes[best, 2:]) - np.maximum(boxes[waiting, :2], boxes[best, :2])
        both = np.prod(np.maximum(corner, 0.0), axis=1)
        waiting = waiting[both <= most * np.maximum(area[waiting] + area[best] - both, 1e-12)]
    return np.array(survivors, dtype=np.int64)


def _best(boxes: Array, scores: Array, labels: Array, method: Detector) -> list[int]:
    """Places of the boxes that are told: those of measured classes, sure enough and not empty, the best first."""
    rows: list[int] = []
    for place, _ in method.classes:
        good = (labels == place) & (scores >= method.score) & (boxes[:, 2:] > 0.0).all(axis=1)
        above = np.flatnonzero(good)
        rows += above[np.argsort(-scores[above], kind="stable")][:MOST].tolist()
    return sorted(rows, key=lambda n: (-scores[n], n))

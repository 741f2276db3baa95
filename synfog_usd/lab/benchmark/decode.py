"""From a picture to a detector's input, and from its outputs to boxes.

A network gives decoded boxes: boxes (N, 4), scores (N,) and class numbers (N,), or one table (N, 6) of them.  So do
torchvision, YOLOv10, and Ultralytics with `nms=True`.  Pixels are those of what the network was given.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Pixels
from synfog_usd.lab.benchmark.detectors import Detector

GREY = 114
"""What YOLO's letterboxes are filled with."""

STRIDE_PX = 32
MOST = 100
"""Boxes of a class in a picture; COCO counts at most as many."""

Boxes = tuple[Array, Array, Pixels]
"""(N, 4) corners [px], (N,) scores and (N,) class numbers."""


class OnnxNode(Protocol):
    """An input or output of a network."""

    name: str
    shape: list[int | str | None]
    type: str


class OnnxSession(Protocol):
    """A network, as onnxruntime loads it."""

    def get_inputs(self) -> list[OnnxNode]:
        """What it takes."""

    def get_outputs(self) -> list[OnnxNode]:
        """What it gives."""

    def run(self, names: list[str], feed: dict[str, npt.NDArray[np.generic]]) -> list[npt.NDArray[np.generic]]:
        """Outputs of some names."""


def detector(method: Detector, session: OnnxSession) -> Callable[[np.ndarray], list[list[float]]]:
    """What finds things in a picture (H, W, 3) uint8.

    Args:
        method: how the network is to be used.
        session: the network.

    Raises:
        ValueError: the network takes no picture.  What it returns raises it where its outputs are no boxes, or
            not finite.
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
        boxes, scores, labels = _decoded(method, answers, (width, height))
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
            raise _unlike(answers, "(N, 6): corners, score and class")
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
                raise _unlike(answers, "boxes (N, 4), scores (N,) and labels (N,)")
            named[what] = name
            del unnamed[name]
    if missing := next((name for name in named.values() if name not in answers), None):
        raise ValueError(f"the network has no output {missing!r}; it has {', '.join(answers)}")
    boxes, scores, labels = _flat(answers[named["boxes"]], 2), answers[named["scores"]], answers[named["labels"]]
    if boxes.ndim != 2 or boxes.shape[1] != 4 or not len(boxes) == scores.size == labels.size:
        raise _unlike(answers, "boxes (N, 4), scores (N,) and labels (N,)")
    return boxes.astype(np.float64), scores.ravel().astype(np.float64), np.rint(labels.ravel()).astype(np.int64)


def _only(method: Detector, answers: dict[str, np.ndarray]) -> np.ndarray:
    """The output that is named, else the first."""
    name = dict(method.outputs).get("boxes", next(iter(answers)))
    if name not in answers:
        raise ValueError(f"the network has no output {name!r}; it has {', '.join(answers)}")
    return answers[name]


def _flat(answer: np.ndarray, axes: int) -> np.ndarray:
    """Without a batch of one."""
    return answer[0] if answer.ndim == axes + 1 and answer.shape[0] == 1 else answer


def _corners(boxes: Array) -> Array:
    """Left, top, right and bottom of centre, width and height."""
    half = boxes[:, 2:] / 2.0
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def _unlike(answers: dict[str, np.ndarray], expected: str) -> ValueError:
    shapes = ", ".join(f"{name} {answer.shape}" for name, answer in answers.items())
    return ValueError(f"the network gave {shapes}; it must give {expected}")


def _best(boxes: Array, scores: Array, labels: Array, method: Detector) -> list[int]:
    """Places of the boxes of measured classes that are sure enough and not empty, the best first."""
    rows: list[int] = []
    for place, _ in method.classes:
        good = (labels == place) & (scores >= method.score) & (boxes[:, 2:] > 0.0).all(axis=1)
        above = np.flatnonzero(good)
        rows += above[np.argsort(-scores[above], kind="stable")][:MOST].tolist()
    return sorted(rows, key=lambda n: (-scores[n], n))

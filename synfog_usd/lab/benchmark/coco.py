"""COCO's scores of boxes, by groups of things and with intervals.

pycocotools matches boxes with things; what it matched is counted here with a weight for each picture, so that scenes
can be drawn again.  With weights of 1 the numbers are pycocotools' own.

A group is a range of some number of things: their pixels, their distance.  Things outside of it are ignored, as COCO
ignores large things where small ones count; so are boxes that match nothing and are outside themselves.

Source: Lin et al., Microsoft COCO (2014), and its published evaluation.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.base.errors import ParameterError

OVERLAPS = np.linspace(0.5, 0.95, 10)
"""Intersections over union from which on a box is right."""

RECALLS = np.linspace(0.0, 1.0, 101)
MOST = 100
"""Boxes of a class that count in a picture."""

Range = tuple[float, float]
EVERYTHING: Range = (-np.inf, np.inf)


@dataclass(frozen=True)
class TrueBox:
    """What a picture shows.

    Attributes:
        picture: number of the picture.
        kind: of the class.
        box: left, top, width, height [px].
        number: by which groups are made.
        ignored: whether it is a region in which boxes are neither right nor wrong.
    """

    picture: int
    kind: int
    box: Sequence[float]
    number: float
    ignored: bool = False


@dataclass(frozen=True)
class FoundBox:
    """What a detector says.

    Attributes:
        picture, kind, box, number: as `TrueBox` has them.
        score: how sure it is.
    """

    picture: int
    kind: int
    box: Sequence[float]
    score: float
    number: float


@dataclass(frozen=True)
class MatchedKind:
    """A class of a group.

    Attributes:
        picture: (D,) of each box, the surest first.
        right, wrong: (T, D) by overlap; a box that is neither is ignored.
        things: (P,) how many count in each picture.
    """

    picture: npt.NDArray[np.int64]
    right: Flags
    wrong: Flags
    things: npt.NDArray[np.int64]


def match(
    pictures: int, true: Sequence[TrueBox], guesses: Sequence[FoundBox], ranges: Sequence[Range]
) -> list[list[MatchedKind]]:
    """Match boxes with things, class by class.

    Args:
        pictures: how many there are.
        true, guesses: in any order.
        ranges: of `number`, ends included.

    Returns:
        by range, then class.

    Raises:
        ParameterError: pycocotools is not installed.
    """
    try:
        from pycocotools.coco import COCO
        from pycocotools.cocoeval import COCOeval
    except ImportError as error:
        raise ParameterError("detectors are measured by pycocotools: pip install pycocotools") from error
    kinds = sorted({box.kind for box in true} | {box.kind for box in guesses})

    def dataset(rows: list[dict[str, Any]]) -> Any:
        coco = COCO()
        coco.dataset = {
            "images": [{"id": number} for number in range(pictures)],
            "categories": [{"id": kind} for kind in kinds],
            "annotations": rows,
        }
        coco.createIndex()
        return coco

    counts = [
        {**_annotation(n, box), "iscrowd": int(box.ignored)}
        for n, box in enumerate(true, start=1)  # pycocotools takes 0 for no match
    ]
    boxes = [{**_annotation(n, box), "iscrowd": 0, "score": box.score} for n, box in enumerate(guesses, start=1)]
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = COCOeval(dataset(counts), dataset(boxes), "bbox")
        evaluation.params.imgIds, evaluation.params.catIds = list(range(pictures)), kinds
        evaluation.params.iouThrs, evaluation.params.maxDets = OVERLAPS, [MOST]
        evaluation.params.areaRng = [list(box) for box in ranges]
        evaluation.params.areaRngLbl = [str(n) for n in range(len(ranges))]
        evaluation.evaluate()
    rows = iter(evaluation.evalImgs)
    groups: list[list[MatchedKind]] = [[] for _ in ranges]
    for _ in kinds:
        for place in range(len(ranges)):
            groups[place].append(_of_kind([next(rows) for _ in range(pictures)]))
    return groups


def _annotation(number: int, source: TrueBox | FoundBox) -> dict[str, Any]:
    box = [float(part) for part in source.box]
    return {"id": number, "image_id": source.picture, "category_id": source.kind, "bbox": box, "area": source.number}


def _of_kind(rows: Sequence[Any]) -> MatchedKind:
    """The rows of a class, one for each picture."""
    none = np.zeros((len(OVERLAPS), 0), dtype=bool)
    scores = [np.zeros(0) if row is None else np.asarray(row["dtScores"], dtype=np.float64) for row in rows]
    hits = [none if row is None else np.asarray(row["dtMatches"]) > 0 for row in rows]
    ignored = [none if row is None else np.asarray(row["dtIgnore"], dtype=bool) for row in rows]
    counts = [0 if row is None else int((np.asarray(row["gtIgnore"]) == 0).sum()) for row in rows]
    picture = np.repeat(np.arange(len(rows)), [len(scores_of_picture) for scores_of_picture in scores])
    order = np.argsort(-np.concatenate(scores), kind="mergesort")
    hit, out = np.concatenate(hits, axis=1)[:, order], np.concatenate(ignored, axis=1)[:, order]
    return MatchedKind(picture[order], hit & ~out, ~hit & ~out, np.array(counts))


def precision(group: Sequence[MatchedKind], weights: Array) -> Array:
    """Average precision, the mean over classes of which something is there.

    Args:
        group: classes.
        weights: (R, P) how often each picture counts.

    Returns:
        (R, T) by overlap; nan where nothing is there.
    """
    return mean_over_kinds([_precision(matched, weights) for matched in group] or [_nothing(weights)])


def recall(group: Sequence[MatchedKind], weights: Array) -> Array:
    """(R, T) share of things that is found, the mean over classes; see `precision`."""
    shares = []
    for matched in group:
        counts = weights @ matched.things
        with np.errstate(invalid="ignore", divide="ignore"):
            shares.append((weights[:, matched.picture] @ matched.right.T.astype(np.float64)) / counts[:, None])
    return mean_over_kinds(shares or [_nothing(weights)])


def mean_over_kinds(values: Sequence[Array] | Array) -> Array:
    """Mean over the first axis of what is defined; nan where nothing is."""
    whole = np.array(values)
    there = np.isfinite(whole)
    with np.errstate(invalid="ignore"):
        return np.where(there, whole, 0.0).sum(axis=0) / there.sum(axis=0)


def _nothing(weights: Array) -> Array:
    return np.full((len(weights), len(OVERLAPS)), np.nan)


def _precision(matched: MatchedKind, weights: Array) -> Array:
    """(R, T), by 101 recalls as COCO has it."""
    curve = _nothing(weights)
    counts = weights @ matched.things
    draws = np.flatnonzero(counts > 0.0)
    boxes = np.flatnonzero(np.any(weights, axis=0)[matched.picture])
    often = weights[draws][:, matched.picture[boxes]]
    apart = 2.0 * np.arange(len(draws))[:, None]  # draws one behind the other, so that one search serves all
    for overlap in range(len(OVERLAPS)):
        right = np.cumsum(often * matched.right[overlap, boxes], axis=1)
        wrong = np.cumsum(often * matched.wrong[overlap, boxes], axis=1)
        share = right / np.maximum(right + wrong, 1e-12)
        highest = np.maximum.accumulate(share[:, ::-1], axis=1)[:, ::-1]
        reached = (right / counts[draws, None] + apart).ravel()
        place = np.searchsorted(reached, (RECALLS + apart).ravel()).reshape(len(draws), len(RECALLS))
        place -= boxes.size * np.arange(len(draws))[:, None]
        padded = np.pad(highest, ((0, 0), (0, 1)))
        curve[draws, overlap] = np.take_along_axis(padded, place, axis=1).mean(axis=1)
    return curve

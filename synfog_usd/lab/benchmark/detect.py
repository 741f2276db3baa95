"""The detection bench: what detectors find in foggy pictures, scored with and without what no camera can see.

Things are the instances of a set with boxes of their visible pixels, as the COCO export has them.  What fog leaves of
each stands in `instances.json` (`dataset.visibility`).  Two scores stand side by side: all things count; and things
that are `invisible` in a picture are regions in which boxes are neither right nor wrong, as COCO's crowds are.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from synfog_usd.base.arrays import Array, Pixels
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.dataset.exports import frames, taxonomy
from synfog_usd.dataset.exports.frames import LabelledPicture
from synfog_usd.lab.benchmark import bench, coco, statistics
from synfog_usd.lab.benchmark.bench import Bench, Question, Row
from synfog_usd.lab.benchmark.child import picture
from synfog_usd.lab.benchmark.coco import EVERYTHING, FoundBox, MatchedKind, TrueBox
from synfog_usd.lab.benchmark.detectors import Detector, as_boxes
from synfog_usd.lab.benchmark.methods import PNG, Defogger
from synfog_usd.lab.benchmark.statistics import FEWEST_SCENES
from synfog_usd.lab.benchmark.worker import MethodError, MethodWorker

ALL, LEFT = "all things", "what fog leaves"
"""The two scores."""

STATES = ("visible", "faint", "invisible")
DISTANCES_M = (0.0, 25.0, 50.0, 100.0, math.inf)
VISIBILITIES_M = (0.0, 50.0, 100.0, 200.0, 400.0, math.inf)
DRAWS = 400
"""Of scenes, for intervals of average precision; 400 tell their ends to some 5 % of their width."""

FARTHEST_M = 1e6
"""Distance that stands for boxes of sky alone."""


@dataclass(frozen=True)
class LabelledThing:
    """A thing that a picture shows.

    Attributes:
        id: of the instance, the same in all fogs of a view.
        label: of Cityscapes.
        box: left, top, width and height of its visible pixels [px].
        pixels: visible ones.
        distance_m: along the ray.
        visibility: one of `STATES`, or '' where the shot does not tell.
    """

    id: int
    label: str
    box: tuple[float, ...]
    pixels: int
    distance_m: float
    visibility: str


@dataclass(frozen=True)
class FoggedView:
    """A picture that detectors are asked about.

    Attributes:
        source: of the set.
        picture: its file.
        things: in it.
    """

    source: LabelledPicture
    picture: Path
    things: tuple[LabelledThing, ...]

    @property
    def name(self) -> str:
        """Unlike any other's."""
        return self.source.name

    @property
    def scene(self) -> str:
        """Intervals are over scenes."""
        return f"{self.source.scene:06d}"

    @property
    def fog(self) -> str:
        """By visibility, for tables."""
        if self.source.clear:
            return "clear"
        return _between(VISIBILITIES_M, float(self.source.mor_m or 0.0), "MOR")


@dataclass(frozen=True)
class DetectorRun:
    """A detector, alone or after a defogger.

    Attributes:
        detector: what is measured.
        before: what it looks through, or None.
    """

    detector: Detector
    before: Defogger | None = None

    @property
    def name(self) -> str:
        """For tables."""
        return self.detector.name if self.before is None else f"{self.detector.name} after {self.before.name}"

    @property
    def version(self) -> str:
        """Hash of all that decides its answers."""
        if self.before is None:
            return self.detector.version
        both = f"{self.before.version} {self.detector.version}"
        return hashlib.sha256(both.encode()).hexdigest()[:16]

    @property
    def at_once(self) -> int:
        """Pictures that both may work on in parallel; 0 for as many as there are cores."""
        steps = (self.detector,) if self.before is None else (self.detector, self.before)
        return min((step.at_once for step in steps if step.at_once), default=0)

    @property
    def takes(self) -> str:
        """The file that it begins with."""
        return (self.before or self.detector).takes


class DetectorRunWorker:
    """The children of a run."""

    def __init__(self, run: DetectorRun, folder: Path) -> None:
        steps = [step for step in (run.before, run.detector) if step is not None]
        self.workers = [MethodWorker(step, folder) for step in steps]

    def ask(self, picture: Path) -> Path:
        """The file with its boxes.

        Raises:
            MethodError: one of the two gave no answer.
        """
        picture_in = picture
        for worker in self.workers:
            answer = worker.ask(picture)
            if picture is not picture_in:
                picture.unlink()
            picture = answer
        return picture

    def close(self) -> None:
        """End them."""
        for worker in self.workers:
            worker.close()


def find(source: Path, *, picture: str = PNG, split: str = "") -> list[FoggedView]:
    """The pictures of a set or a bake, with their things.

    Args:
        source: folder.
        picture: which output is looked at.
        split: of a set; all if left out.

    Raises:
        ParameterError: no such folder, or no picture or no thing in it.
        OutputError: damaged labels.
    """
    if not source.is_dir():
        raise ParameterError(f"{source}: no such folder")
    views = []
    for entry in frames.pictures(source):
        if picture in entry.files and split in ("", entry.split):
            views.append(FoggedView(entry, entry.files[picture], tuple(_things(entry))))
    if not views:
        raise ParameterError(
            f"{source}: no picture {picture}{f' in the split {split!r}' if split else ''}; it takes a set or a bake"
        )
    if not any(entry.things for entry in views):
        raise ParameterError(f"{source}: nothing that could be found is seen in any of {len(views)} pictures")
    return views


def _things(picture: LabelledPicture) -> Iterator[LabelledThing]:
    for row in taxonomy.objects(picture):
        yield LabelledThing(
            row["id"],
            row["label"],
            tuple(float(part) for part in row["box_px"]),
            row["pixels"],
            float(row["distance_m"]),
            row.get("visibility") or "",
        )


def run(
    views: Sequence[FoggedView],
    runs: Sequence[DetectorRun],
    out: Path,
    *,
    retry: bool = False,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
) -> Bench:
    """Ask detectors about pictures; what `out` has already of the same pictures and detectors is kept.

    Args:
        views: from `find`.
        runs: detectors, alone and after defoggers.
        out, retry, progress, log: as `bench.run` has them.

    Returns:
        rows of 'boxes': [x, y, width, height, score, class number, distance in metres of what is there].

    Raises:
        OutputError: the folder cannot be written, or `results.json` there is none of ours.
    """
    question = Question(lambda view, run: bench.digest(_input(view, run) or view.picture), DetectorRunWorker, _asked)
    return bench.run(views, runs, out, question, retry=retry, progress=progress, log=log)


def _input(view: FoggedView, run: DetectorRun) -> Path | None:
    return view.picture if run.takes == PNG else view.source.files.get(run.takes)


def _asked(view: FoggedView, run: DetectorRun, worker: DetectorRunWorker) -> Row:
    file = _input(view, run)
    if file is None:
        return {"error": f"the picture has no {run.takes}"}
    try:
        shape, labels = picture(view.picture).shape, view.source.labels
        if shape[:2] != labels.distance_m.shape:
            size = f"{labels.size_px[0]} x {labels.size_px[1]}"
            return {"error": f"the picture has {shape[1]} x {shape[0]} pixels, and its labels {size}"}
        boxes = worker.ask(file)
        answer = as_boxes(json.loads(boxes.read_text(encoding="utf-8")), run.detector)
        boxes.unlink()
    except (MethodError, ParameterError, ValueError, OSError) as error:
        return {"error": " ".join(str(error).split())[:300]}
    return {"boxes": [[*box, _distance(box, labels.distance_m)] for box in answer]}


def _distance(box: Sequence[float], distance_m: Array) -> float:
    """Median distance of what is seen in a box [m]."""
    left_px, top = (max(0, int(part)) for part in box[:2])
    inside = distance_m[top : math.ceil(box[1] + box[3]), left_px : math.ceil(box[0] + box[2])]
    return round(min(float(np.median(inside)), FARTHEST_M), 2) if inside.size else FARTHEST_M


@dataclass(frozen=True)
class DetectionScore:
    """A number of a table.

    Attributes:
        counts: `ALL` or `LEFT`.
        by, group: by what pictures or things are grouped, and which group; '' for all.
        metric: 'AP', 'AP50', 'AP75' or 'AR'.
        value: 0 to 1; nan where there is nothing.
        low, high: interval at 95 % over scenes; None where things are in fewer than three.
        things: how many count.
    """

    counts: str
    by: str
    group: str
    metric: str
    value: float
    low: float | None
    high: float | None
    things: int


@dataclass
class DetectionScores:
    """What a detector is worth.

    Attributes:
        rows: all numbers.
        pictures: how many it answered.
    """

    rows: list[DetectionScore] = field(default_factory=list)
    pictures: int = 0

    def score(self, counts: str, metric: str, by: str = "", group: str = "") -> DetectionScore | None:
        """A number, or None."""
        key = (counts, by, group, metric)
        return next((row for row in self.rows if (row.counts, row.by, row.group, row.metric) == key), None)


@dataclass(frozen=True)
class _Answers:
    """A detector's answers, ready to be counted: the views that it answered, their truths and its boxes."""

    views: list[FoggedView]
    true: list[tuple[int, int, LabelledThing]]
    boxes: list[tuple[int, list[float]]]

    def matched(
        self,
        ranges: Sequence[coco.Range],
        number: Callable[[LabelledThing], float],
        box_number: Callable[[list[float]], float],
        ignored: Callable[[LabelledThing], bool],
    ) -> list[list[MatchedKind]]:
        """By range, then class."""
        true = [TrueBox(n, kind, labelled.box, number(labelled), ignored(labelled)) for n, kind, labelled in self.true]
        guesses = [FoundBox(n, int(row[5]), row[:4], row[4], box_number(row)) for n, row in self.boxes]
        return coco.match(len(self.views), true, guesses, ranges)


def _answers(bench_run: Bench, detector_run: DetectorRun, names: set[str] | None = None) -> _Answers:
    kinds = {label: place for place, labels in detector_run.detector.classes for label in labels}
    views = [
        view
        for view in bench_run.items
        if "boxes" in bench_run.row(detector_run, view) and (names is None or view.name in names)
    ]
    true = [(n, kinds[item.label], item) for n, view in enumerate(views) for item in view.things if item.label in kinds]
    boxes = [(n, row) for n, view in enumerate(views) for row in bench_run.row(detector_run, view)["boxes"]]
    return _Answers(views, true, boxes)


def scores(bench_run: Bench, detector_run: DetectorRun, *, least_px: int = 0) -> DetectionScores:
    """All numbers of a detector.

    Args:
        bench_run: from `run`.
        detector_run: of its methods.
        least_px: things of fewer visible pixels are ignored.

    Raises:
        ParameterError: pycocotools is not installed.
    """
    answers = _answers(bench_run, detector_run)
    result = DetectionScores(pictures=len(answers.views))
    if not answers.views:
        return result
    weights = _weights(answers.views)

    def add(counts: str, by: str, group: str, metric: str, draws: Array, numbers: Pixels) -> None:
        enough = len({view.scene for view, n in zip(answers.views, numbers, strict=True) if n}) >= FEWEST_SCENES
        result.rows.append(DetectionScore(counts, by, group, metric, *_told(draws, enough), int(numbers.sum())))

    def small(item: LabelledThing) -> bool:
        return item.pixels < least_px

    def hidden(item: LabelledThing) -> bool:
        return small(item) or item.visibility == "invisible"

    steps = list(zip(DISTANCES_M[:-1], (float(np.nextafter(end, 0)) for end in DISTANCES_M[1:]), strict=True))
    for counts, ignored in ((ALL, small), (LEFT, hidden)):
        whole = answers.matched([EVERYTHING], lambda thing: 0.0, lambda row: 0.0, ignored)[0]
        draws, numbers = coco.precision(whole, weights), _count(whole)
        for metric, part in (("AP", draws.mean(axis=1)), ("AP50", draws[:, 0]), ("AP75", draws[:, 5])):
            add(counts, "", "", metric, part, numbers)
        add(counts, "", "", "AR", coco.recall(whole, weights).mean(axis=1), numbers)
        for fog in fogs(answers.views):
            inside = np.array([view.fog == fog for view in answers.views])
            in_fog = coco.precision(whole, weights * inside)
            add(counts, "fog", fog, "AP", in_fog.mean(axis=1), _count(whole) * inside)
        by_distance = answers.matched(steps, lambda thing: thing.distance_m, lambda row: row[6], ignored)
        for low, group in zip(DISTANCES_M, by_distance, strict=False):
            name = _between(DISTANCES_M, low, "")
            add(counts, "distance", name, "AP", coco.precision(group, weights).mean(axis=1), _count(group))
    # what matches nothing belongs to no state: so only recall is given
    states = answers.matched(
        [(float(n), float(n)) for n in range(len(STATES))],
        lambda thing: float(STATES.index(thing.visibility)) if thing.visibility in STATES else -1.0,
        lambda row: -1.0,
        small,
    )
    for name, group in zip(STATES, states, strict=True):
        add(ALL, "visibility", name, "AR", coco.recall(group, weights).mean(axis=1), _count(group))
    return result


def ranks(bench_run: Bench, runs: Sequence[DetectorRun], *, least_px: int = 0) -> dict[str, int]:
    """Rank of each detector: one more than the number of detectors that are better beyond chance.

    Two are compared by the average precision of all things on the pictures that both answered; one is better where the
    interval of the difference over scenes does not hold 0.
    """
    better = dict.fromkeys((run.name for run in runs), 0)
    for n, run in enumerate(runs):
        for rival in runs[n + 1 :]:
            views, groups = _both(bench_run, run, rival, lambda thing: thing.pixels < least_px)
            if views:
                draws = [coco.precision(group, _weights(views)).mean(axis=1) for group in groups]
                _, low, high = _told(draws[1] - draws[0])
                better[run.name] += low is not None and low > 0.0
                better[rival.name] += high is not None and high < 0.0
    return {name: 1 + count for name, count in better.items()}


def _both(
    bench_run: Bench, first_run: DetectorRun, second_run: DetectorRun, ignored: Callable[[LabelledThing], bool]
) -> tuple[list[FoggedView], list[list[MatchedKind]]]:
    """The views that both answered, and what each found there."""
    shared = {
        v.name for v in bench_run.items if all("boxes" in bench_run.row(both, v) for both in (first_run, second_run))
    }
    answers = [_answers(bench_run, both, shared) for both in (first_run, second_run)] if shared else []
    groups = [each.matched([EVERYTHING], lambda thing: 0.0, lambda row: 0.0, ignored)[0] for each in answers]
    return answers[0].views if answers else [], groups


def fogs(views: Sequence[FoggedView]) -> list[str]:
    """Ranges of visibility that there are, clear air first, then the thinner fog before the thicker."""
    visibilities = {view.fog: math.inf if view.source.clear else float(view.source.mor_m or 0.0) for view in views}
    return sorted(visibilities, key=lambda fog: -visibilities[fog])


def _weights(views: Sequence[FoggedView]) -> Array:
    """(1 + draws, P) how often each picture counts: once, and then as scenes are drawn; one row of too few scenes."""
    names, place = np.unique([view.scene for view in views], return_inverse=True)
    once = np.ones((1, len(views)))
    if names.size < FEWEST_SCENES:
        return once
    return np.concatenate([once, statistics.draws(names.size)[:DRAWS, place]])


def _told(draws: Array, enough: bool = True) -> tuple[float, float | None, float | None]:
    """Value and interval of numbers by draw, of which the first is of all scenes once; none where things are in too few
    scenes to tell.
    """
    if len(draws) == 1 or not enough or not np.isfinite(draws[1:]).any():
        return float(draws[0]), None, None
    return float(draws[0]), *statistics.interval(draws[1:])


def _count(group: Sequence[MatchedKind]) -> Array:
    """(P,) things that count in each picture."""
    return np.sum([matched.things for matched in group], axis=0)


@functools.cache
def _between(edges: tuple[float, ...], value: float, what: str) -> str:
    """The name of the range of `edges` in which a length lies.

    >>> _between((0.0, 50.0, 100.0), 50.0, "MOR"), _between((0.0, 50.0, float("inf")), 60.0, "")
    ('MOR 50 to 100 m', 'over 50 m')
    """
    place = max(n for n, edge in enumerate(edges[:-1]) if value >= edge or n == 0)
    low, high = edges[place], edges[place + 1]
    text = f"over {low:g} m" if math.isinf(high) else f"under {high:g} m" if low == 0.0 else f"{low:g} to {high:g} m"
    return f"{what} {text}".strip()

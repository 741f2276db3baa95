"""What a set costs, before it is made: scenes, shots and files by counting, hours and bytes from small probes.

A probe is one unit of the set, with fewer pixels where it has many.  In the first lighting and in the last, a scene
with hardly any pixels tells what a unit takes whatever its size (drawing, loading, metering), and some scenes with
more tell what pixels take, by which scenes may differ by a factor of ten.  They come from recipes in turn, and from
others for the other lighting.  What the first of a lighting took longer when it was made the first time went into
kernels, which are compiled once.
"""

from __future__ import annotations

import itertools
import math
import queue
import tempfile
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from statistics import mean, stdev
from typing import TYPE_CHECKING, Any

from synfog_usd.base.errors import SetError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.dataset.plan import CLEAR
from synfog_usd.dataset.sets import cluster, identity, journal, offers
from synfog_usd.dataset.sets.definition import SetDefinition
from synfog_usd.dataset.sets.journal import Tally
from synfog_usd.dataset.sets.layout import Unit
from synfog_usd.dataset.sets.load import define_set
from synfog_usd.dataset.sets.scenes import PlannedScene, scenes
from synfog_usd.dataset.sets.work import Child, Job, do, ending_children

if TYPE_CHECKING:
    from synfog_usd.render.backend import Backend

UNKNOWN_S = 3600.0
"""Limit of a unit of `UNKNOWN_PX` pixels while nothing is known of its cost."""
UNKNOWN_PX = 4 * 1280 * 720
PATIENCE = 10.0
"""A unit may take this many times what was expected of it."""
LEAST_LIMIT_S = 600.0

FEW_PX = (32, 18)
"""Size of the picture that tells what a unit takes without pixels."""
WIDTH_PX = 320
"""Of the other probes, or a quarter of the picture's where that is more; smaller pictures stop later, since a denoiser
has fewer pixels to go by.
"""
SCENES = 10
"""That are probed for all lightings, at most; of a small set two thirds."""
MEMORY_GROWTH = 0.6
"""Power of its pixels by which a picture's memory grows, since its paths are taken in passes: 5 % too much at 640 x 360
and 4 % too little at 1280 x 720 by a street's two lightings at 320 x 180.
"""
LOOKED = 200
"""Scenes in a row that may be without a lighting, for one that has it."""
OF_VIEW, OF_SHOT = ("bake.json", "labels.exr", "labels.json", "unit.json"), 3
PICTURES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Cost:
    """What units were seen to take on the machine at hand.

    Attributes:
        seconds: the most of a unit, by lighting, and under '' the mean of an earlier run.
        unknown_s: limit where there is none.
    """

    seconds: Mapping[str, float] = field(default_factory=dict)
    unknown_s: float = UNKNOWN_S

    @classmethod
    def known(cls, found: SetDefinition, tally: Tally) -> Cost:
        """From what was made already."""
        width, height = found.size or (1280, 720)
        unknown = UNKNOWN_S * max(1.0, len(found.fogs) * width * height / UNKNOWN_PX)
        return cls({"": tally.seconds / tally.units} if tally.units else {}, unknown)

    def seen(self, lighting: str, seconds: float) -> Cost:
        """With one unit more."""
        return replace(self, seconds={**self.seconds, lighting: max(seconds, self.seconds.get(lighting, 0.0))})

    def limit_s(self, lighting: str) -> float:
        """Seconds after which a unit is taken to hang."""
        expected = max(self.seconds.get(lighting, 0.0), self.seconds.get("", 0.0))
        return max(LEAST_LIMIT_S, PATIENCE * expected) if expected else self.unknown_s


@dataclass(frozen=True)
class Count:
    """How much a set holds.

    Attributes:
        scenes, shots, files: in all; pictures: those that pipelines make of them.
        units: by lighting; splits: scenes by split; sources: scenes by recipe or glob.
    """

    scenes: int
    shots: int
    pictures: int
    files: int
    units: Mapping[str, int]
    splits: Mapping[str, int]
    sources: Mapping[str, int]


@dataclass(frozen=True)
class Estimate:
    """What a set takes on this machine.

    Attributes:
        cpu_h: processor time [h]; hours: wall time with `workers` units at a time.
        gigabytes: on disk; peak_mb: memory of one unit.
        workers: units at a time.
        unsure: standard error of the processor time, over it: by how much scenes differ, of which few are probed.
        probes: what they were of and took.
    """

    cpu_h: float
    hours: float
    gigabytes: float
    peak_mb: float
    workers: int
    unsure: float
    probes: tuple[Mapping[str, Any], ...]


def count(found: SetDefinition) -> Count:
    """Count a set, scene by scene; memory does not grow with it."""
    from synfog_usd import camera

    found = offers.known(found)
    outputs = [camera.load_graph(path).outputs for path in found.pipelines]
    a_view = len(OF_VIEW) + any(name.endswith(PICTURES) for name in outputs[0])
    a_shot = OF_SHOT + sum(map(len, outputs))
    guessed = [len(own) for path, own in zip(found.pipelines, outputs, strict=True) if path.stem in found.asm_estimated]
    shots = files = pictures = 0
    units: dict[str, int] = {}
    splits = {split.name: 0 for split in found.splits}
    sources = {source.name: 0 for source in found.sources}
    for one in scenes(found):
        splits[one.split.name] += 1
        sources[one.source.name] += 1
        shots += one.shots
        foggy = len(one.units) * sum(fog != CLEAR for fog in one.fogs)
        pictures += one.shots * len(found.pipelines) + foggy * len(guessed)
        files += one.shots * a_shot + foggy * sum(guessed) + len(one.units) * a_view
        for lighting in one.lightings:
            units[lighting] = units.get(lighting, 0) + len(one.cameras)
    return Count(found.scenes, shots, pictures, files, units, splits, sources)


def estimate(
    found: SetDefinition,
    counted: Count,
    child: Child,
    *,
    workers: int | None = None,
    variant: str = "auto",
    progress: Progress = silent,
) -> Estimate:
    """What a set takes, from probes.

    Args:
        found: the set.
        counted: from `count`.
        child: how a unit's process is begun.
        workers: units at a time; as many as memory allows where None.
        variant: of the renderer.
        progress: told the fraction of the probes that is begun.

    Raises:
        SetError: a probe fails.
    """
    from synfog_usd.render import backend

    chosen = backend.choose(variant)  # type: ignore[arg-type]
    many = workers or cluster.fitting(None)
    share = max(1, cluster.cores() // many)
    todo = _chosen(found, list(counted.units))
    first = {unit.lighting: index for index, (_, unit, _) in reversed(list(enumerate(todo)))}
    number, begun, telling = len(todo) + len(first), itertools.count(1), threading.Lock()
    free = queue.SimpleQueue[int]()
    for place in range(many):
        free.put(place)

    def probe(index: int) -> dict[str, Any]:
        planned, unit, size = todo[index]
        about = {"scene": planned.number, "lighting": unit.lighting, "size_px": size}
        here = free.get()
        with telling:
            now = next(begun)
            progress(f"probe {now} of {number}: scene {planned.number}, {unit.lighting}", (now - 1) / number)
        try:
            return about | _probe(found, planned, unit, size, child, chosen, share, here)
        finally:
            free.put(here)

    # kernels are compiled by one unit of a lighting alone; all others are made as many at a time as they will be
    cold = {lighting: probe(index) for lighting, index in first.items()}
    warm = {index: probe(index) for index in first.values()}
    rest = [index for index in range(len(todo)) if index not in warm]
    with ending_children(executor := ThreadPoolExecutor(many)):
        probes = [warm[index] for index in sorted(warm)] + list(executor.map(probe, rest))
    progress("done", 1.0)
    total = sum(counted.units.values())
    peak_mb = max(peak for lighting in counted.units for peak in _full(probes, found, "peak_mb", lighting))
    many = workers or cluster.fitting(peak_mb)

    def whole(what: str) -> float:
        """Of all units: each lighting as its own probes have it, others as the mean."""
        return sum(number * mean(_full(probes, found, what, lighting)) for lighting, number in counted.units.items())

    def once(what: str) -> float:
        """Of the kernels of all lightings."""
        return len(counted.units) * mean(max(0.0, cold[name][what] - warm[first[name]][what]) for name in first)

    return Estimate(
        cpu_h=(whole("cpu_s") + once("cpu_s")) / 3600.0,
        hours=(whole("seconds") / min(many, total) + once("seconds")) / 3600.0,
        gigabytes=whole("bytes") / 1e9,
        peak_mb=peak_mb,
        workers=many,
        unsure=_error(probes, found, counted.units) / whole("cpu_s"),
        probes=tuple(probes),
    )


def _chosen(found: SetDefinition, lightings: Sequence[str]) -> list[tuple[PlannedScene, Unit, tuple[int, int] | None]]:
    """For the first lighting and the last a scene with few pixels, then this and others with more; from sources in
    turn, so that few stand for many.
    """
    size = found.size
    if size is not None:
        width = max(size[0] // 4, min(size[0], WIDTH_PX))
        size = (width, max(1, size[1] * width // size[0]))
    probed = list(dict.fromkeys((lightings[0], lightings[-1])))
    each = max(1, min(SCENES, math.ceil(found.scenes * 2 / 3)) // len(probed))
    chosen: list[tuple[PlannedScene, Unit, tuple[int, int] | None]] = []
    for index, lighting in enumerate(probed):
        for turn in range(each):
            place = Fraction(2 * (turn * len(probed) + index) + 1, 2 * each * len(probed))
            if planned := _typical(found, lighting, place, [unit for _, unit, _ in chosen]):
                unit = next(unit for unit in planned.units if unit.lighting == lighting)
                first = size is not None and all(other.lighting != lighting for _, other, _ in chosen)
                chosen += [(planned, unit, FEW_PX)] if first else []
                chosen.append((planned, unit, size))
    return chosen


def _typical(found: SetDefinition, lighting: str, place: Fraction, taken: Sequence[Unit]) -> PlannedScene | None:
    """From a place of the set on, 0 to 1, the first scene that has a lighting, is not taken in it, is best not taken at
    all and comes best from the source at that place of all shares laid end to end.
    """
    share = place * sum(source.share for source in found.sources)
    for source in found.sources:
        if share < source.share:
            break
        share -= source.share
    here, known = {unit.number for unit in taken if unit.lighting == lighting}, {unit.number for unit in taken}
    best, best_missed = None, (True, True)
    start, most = int(found.scenes * place), min(found.scenes, LOOKED)
    for planned in scenes(found, ((start + step) % found.scenes for step in range(most))):
        missed = (planned.number in known, planned.source != source)
        if lighting in planned.lightings and planned.number not in here and (best is None or missed < best_missed):
            best, best_missed = planned, missed
            if not any(missed):
                break
    return best


def _probe(
    found: SetDefinition,
    planned: PlannedScene,
    unit: Unit,
    size: tuple[int, int] | None,
    child: Child,
    chosen: Backend,
    cores: int,
    place: int,
) -> dict[str, Any]:
    words = {**found.words, **({"size": list(size)} if size else {})}
    small = replace(define_set(found.name, folder=found.folder, **words), offers=found.offers)
    with tempfile.TemporaryDirectory(prefix="synfog-probe-") as folder:
        out = Path(folder)
        identity.write(out, small, identity.identity(small, chosen.variant))
        journal.keep_definition(out, small)
        made = do(Job(out, unit, UNKNOWN_S, chosen.name, cores=cores, place=place), child)
    if not made["ok"]:
        raise SetError(f"{found.name}: the probe of scene {planned.number}, {unit.lighting} fails: {made['error']}")
    return {name: made[name] for name in ("seconds", "cpu_s", "bytes", "peak_mb")}


def _full(probes: Sequence[Mapping[str, Any]], found: SetDefinition, what: str, lighting: str) -> list[float]:
    """What a lighting's probes would have taken at full size: what its picture of few pixels took stays, and all else
    grows with the pixels, memory slower.  Of a lighting without probes the means of the others.
    """
    own = [probe for probe in probes if probe["lighting"] == lighting]
    if not own:
        return [mean(_full(probes, found, what, other)) for other in {probe["lighting"] for probe in probes}]
    if found.size is None:
        return [float(probe[what]) for probe in own]
    few, scenes = own[0], own[1:]
    pixels, more, full = (_pixels(size) for size in (few["size_px"], scenes[0]["size_px"], found.size))
    growth = (full - more) / (more - pixels) if more > pixels else 0.0
    if what == "peak_mb":
        growth = (full / more) ** MEMORY_GROWTH - 1.0
    return [probe[what] + growth * max(0.0, probe[what] - few[what]) for probe in scenes]


def _error(probes: Sequence[Mapping[str, Any]], found: SetDefinition, units: Mapping[str, int]) -> float:
    """Standard error [s] of all units' processor time, from how much the probes of each lighting differ."""
    seen = {lighting: _full(probes, found, "cpu_s", lighting) for lighting in units}
    return math.hypot(
        *(units[name] * stdev(each) / math.sqrt(len(each)) for name, each in seen.items() if len(each) > 1)
    )


def _pixels(size: tuple[int, int]) -> int:
    return size[0] * size[1]

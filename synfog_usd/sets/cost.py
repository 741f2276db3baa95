"""What a set costs, before it is made: scenes, shots and files by counting, hours and bytes from four small probes.

A probe is one unit of the set with fewer pixels.  The same scene at two sizes tells what a unit takes whatever its
size (drawing, loading, metering) and what its pixels take; another scene, in another lighting where there is one,
tells how much that differs.  The first is made twice: what it took longer at first went into kernels, which are
compiled once.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synfog_usd.errors import SetError
from synfog_usd.progress import Progress, silent
from synfog_usd.sets import cluster, identity, journal
from synfog_usd.sets.definition import CLEAR, SetDefinition, make_set
from synfog_usd.sets.journal import Tally
from synfog_usd.sets.layout import Unit
from synfog_usd.sets.scenes import PlannedScene, scene, scenes
from synfog_usd.sets.work import Child, Job, do

if TYPE_CHECKING:
    from synfog_usd.render.backend import Backend

UNKNOWN_S = 3600.0
"""Limit of a unit of `UNKNOWN_PX` pixels while nothing is known of its cost."""
UNKNOWN_PX = 4 * 1280 * 720
PATIENCE = 10.0
"""A unit may take this many times what was expected of it."""
LEAST_LIMIT_S = 600.0

SMALL_PX = 120 * 68
"""Of a picture that is not made smaller for a probe."""
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
        probes: what they were of and took.
    """

    cpu_h: float
    hours: float
    gigabytes: float
    peak_mb: float
    workers: int
    probes: tuple[Mapping[str, Any], ...]


def count(found: SetDefinition) -> Count:
    """Count a set, scene by scene; memory does not grow with it."""
    from synfog_usd import camera

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
    """What a set takes, from four probes.

    Args:
        found: the set.
        counted: from `count`.
        child: how a unit's process is begun.
        workers: units at a time; as many as memory allows where None.
        variant: of the renderer.
        progress: told the fraction of the probes that is made.

    Raises:
        SetError: a probe fails.
    """
    from synfog_usd.render import backend

    chosen = backend.choose(variant)  # type: ignore[arg-type]
    share = max(1, cluster.cores() // (workers or cluster.fitting(None)))
    made = []
    todo = _chosen(found)
    for index, (planned, unit, size) in enumerate([todo[0], *todo]):
        progress(f"probe {index + 1} of 4: scene {planned.number}, {unit.lighting}", index / 4)
        made.append(
            {"scene": planned.number, "lighting": unit.lighting, "size_px": size}
            | _probe(found, planned, unit, size, child, chosen, share)
        )
    progress("done", 1.0)
    cold, *probes = made
    total = sum(counted.units.values())
    peak_mb = _at(probes, found, "peak_mb", max)
    many = workers or cluster.fitting(peak_mb)

    def whole(what: str) -> float:
        """Of all units: each lighting as its own probes have it, others as the mean."""
        return sum(number * _of(probes, found, what, lighting) for lighting, number in counted.units.items())

    def once(what: str) -> float:
        """Of the kernels of all lightings."""
        return len(counted.units) * max(0.0, cold[what] - probes[0][what])

    return Estimate(
        cpu_h=(whole("cpu_s") + once("cpu_s")) / 3600.0,
        hours=(whole("seconds") / min(many, total) + once("seconds")) / 3600.0,
        gigabytes=whole("bytes") / 1e9,
        peak_mb=peak_mb,
        workers=many,
        probes=tuple(probes),
    )


def _chosen(found: SetDefinition) -> list[tuple[PlannedScene, Unit, tuple[int, int] | None]]:
    """The first scene at a quarter and half of the width, and one from the middle of the set at half, in its last
    lighting.
    """
    first, other = scene(found, 0), scene(found, found.scenes // 2)
    if found.size is None or found.size[0] * found.size[1] <= SMALL_PX:
        third = scene(found, found.scenes - 1)
        return [
            (first, first.units[0], found.size),
            (other, other.units[-1], found.size),
            (third, third.units[0], found.size),
        ]
    width, height = found.size
    quarter, half = ((max(16, width // part), max(16, height // part)) for part in (4, 2))
    return [(first, first.units[0], quarter), (first, first.units[0], half), (other, other.units[-1], half)]


def _probe(
    found: SetDefinition,
    planned: PlannedScene,
    unit: Unit,
    size: tuple[int, int] | None,
    child: Child,
    chosen: Backend,
    cores: int,
) -> dict[str, Any]:
    words = {**found.words, **({"size": list(size)} if size else {})}
    small = make_set(found.name, folder=found.folder, **words)
    with tempfile.TemporaryDirectory(prefix="synfog-probe-") as folder:
        out = Path(folder)
        identity.write(out, small, identity.identity(small, chosen.variant))
        journal.keep_definition(out, small)
        made = do(Job(out, unit, UNKNOWN_S, chosen.name, cores=cores), child)
    if not made["ok"]:
        raise SetError(f"{found.name}: the probe of scene {planned.number}, {unit.lighting} fails: {made['error']}")
    return {name: made[name] for name in ("seconds", "cpu_s", "bytes", "peak_mb")}


def _of(probes: Sequence[Mapping[str, Any]], found: SetDefinition, what: str, lighting: str) -> float:
    alike = [probe for probe in probes if probe["lighting"] == lighting] or list(probes)
    return _at(alike, found, what, lambda values: sum(values) / len(values), probes)


def _at(
    probes: Sequence[Mapping[str, Any]],
    found: SetDefinition,
    what: str,
    join: Callable[[list[float]], float],
    every: Sequence[Mapping[str, Any]] | None = None,
) -> float:
    """What probes would have taken at full size: the largest of each scene, times what the first scene's two sizes say
    of growing.
    """
    every = every or probes
    if found.size is None or every[0]["size_px"] == every[1]["size_px"] or every[0]["size_px"] == found.size:
        return join([float(probe[what]) for probe in probes])
    small, large, full = (_pixels(size) for size in (every[0]["size_px"], every[1]["size_px"], found.size))
    slope = max(0.0, (every[1][what] - every[0][what]) / (large - small))
    growth = (every[1][what] + slope * (full - large)) / every[1][what]
    return join([float(probe[what]) * growth for probe in probes if probe["size_px"] == every[1]["size_px"]])


def _pixels(size: tuple[int, int]) -> int:
    return size[0] * size[1]

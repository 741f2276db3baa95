"""Making a set: units go to Dask's workers, a bounded number at a time, and what comes back is written down.

The client alone writes the journal, the index and `set.json`; workers write the folder of their unit.  So whatever is
killed, the same call goes on, and ends with the same bytes.
"""

from __future__ import annotations

import contextlib
import os
import queue
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synfog_usd.base import files
from synfog_usd.base.errors import OutputError, ParameterError, SetError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.values import check_words, count, number, path_of, switch, word
from synfog_usd.dataset.job import LOG
from synfog_usd.dataset.sets import cluster, identity, index, journal, layout, offers
from synfog_usd.dataset.sets.cost import Cost
from synfog_usd.dataset.sets.definition import SetDefinition
from synfog_usd.dataset.sets.layout import Unit
from synfog_usd.dataset.sets.load import define_set, load_set
from synfog_usd.dataset.sets.scenes import PlannedScene, scenes
from synfog_usd.dataset.sets.unit import record, rows
from synfog_usd.dataset.sets.work import CHILD, Child, Job, do

if TYPE_CHECKING:
    from distributed import Future

TRIES = 3
LOOK_S = 1.0
"""How often it is looked whether the scheduler is still there."""
SPARE_BYTES = 200 * 2**20


@dataclass(frozen=True)
class RunPlan:
    """How a set is made.

    Attributes:
        out: folder of the set.
        child: how a unit's process is begun.
        workers: of this machine; one a GPU, or by its memory, where None.
        scheduler: address of a running one, or None.
        only: numbers of scenes, or None for all.
        budget_gb: size beyond which no unit is begun, or None.
        repair: whether finished units are looked at, and made again where a file was changed.
        retry: whether units that were set aside are taken up.
        limit_s: seconds a unit may take; from the cost that is known where None.
        variant: of the renderer.
    """

    out: Path
    child: Child = CHILD
    workers: int | None = None
    scheduler: str | None = None
    only: tuple[int, ...] | None = None
    budget_gb: float | None = None
    repair: bool = False
    retry: bool = False
    limit_s: float | None = None
    variant: str = "auto"


@dataclass
class Outcome:
    """What a run left.

    Attributes:
        made, kept: units that were made now, and that were there.
        aside: unit -> what it failed of.
        stopped: why it ended before all was made, or ''.
        seconds: wall time.
        own_cpu_s: processor time of client, scheduler and workers; cpu_s: of the units.
    """

    made: int = 0
    kept: int = 0
    aside: dict[str, dict[str, Any]] = field(default_factory=dict)
    stopped: str = ""
    seconds: float = 0.0
    own_cpu_s: float = 0.0
    cpu_s: float = 0.0


def numbers_of(text: str, count: int) -> tuple[int, ...]:
    """Scenes from text such as '17,40-60'.

    Args:
        text: numbers and ranges, both ends included.
        count: of the set's scenes.

    Raises:
        ParameterError: it is none, or beyond the set.

    >>> numbers_of("3,5-7", 10)
    (3, 5, 6, 7)
    """
    numbers: dict[int, None] = {}
    for part in text.split(","):
        low, dash, high = part.strip().partition("-")
        if not low.isdecimal() or (dash and not high.isdecimal()) or (dash and int(high) < int(low)):
            raise ParameterError(f"--only {text}: {part.strip()!r} is no number or range, as in 17,40-60")
        if int(high or low) >= count:
            raise ParameterError(f"--only {text}: the set has scenes 0 to {count - 1}")
        numbers |= dict.fromkeys(range(int(low), int(high or low) + 1))
    return tuple(numbers)


OPTIONS: dict[str, Callable[[Any, str], Any]] = {
    "workers": count,
    "scheduler": word,
    "budget_gb": number,
    "repair": switch,
    "retry": switch,
    "limit_s": number,
    "variant": word,
}
"""Attribute of `RunPlan` -> what reads it."""


def make_set(
    what: str | os.PathLike[str] | Mapping[str, Any] | None,
    out: str | os.PathLike[str],
    *,
    only: str | None = None,
    progress: Progress = silent,
    log: Callable[[str], None] = LOG.info,
    **options: Any,
) -> Outcome:
    """Make a data set, or go on with it: what is finished is kept.

    The same work as `synfog-usd dataset run`, to the same bytes; each unit (a scene in a lighting) in a child process
    with limits.

    Args:
        what: name of a set that ships ('mini'), a YAML file, or its sections as a mapping ({'scenes': 20, 'recipes':
            ['rural'], ...}); None goes on with the set that lies in `out`.
        out: folder of the set.
        only: scenes by number, as '17,40-60'.
        progress: called with how far it is and the fraction that is done.
        log: called with lines that tell what goes on.
        options: workers (units at a time); scheduler (address of a Dask scheduler); budget_gb (size beyond which
            nothing is begun); repair (look at every file, make changed ones again); retry (take up what was set aside);
            limit_s (seconds of a unit); variant (of the renderer).

    Returns:
        `made`, `kept` (numbers of units), `aside` (units that failed three times), `stopped` (why it ended before all
        was made, or ''), `seconds`.

    Raises:
        SynfogError: with place and fix; finished units stay.
    """
    check_words(options, OPTIONS)
    options = {word: OPTIONS[word](value, word) for word, value in options.items() if value is not None}
    folder = path_of(out, "--out")
    if what is None:
        definition = journal.kept_definition(folder)
    elif isinstance(what, Mapping):
        definition = define_set(**what)
    else:
        definition = load_set(path_of(what, "set"))
    definition = offers.with_offers(definition, offers.ask_child)
    numbers = numbers_of(only, definition.scenes) if only is not None else None
    return run(definition, RunPlan(folder, only=numbers, **options), progress=progress, log=log)


def run(
    definition: SetDefinition,
    plan: RunPlan,
    *,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
) -> Outcome:
    """Make what of a set is not there yet.

    Args:
        definition: the set.
        plan: how.
        progress: called with the fraction of the units that is done.
        log: given one line for whatever a user wants to know on the way.

    Raises:
        SetError: the folder holds another set, or became one on the way; another run works there, or the scheduler
            went away.
        OutputError: the folder cannot be written, or the disk is full.
        KeyboardInterrupt: after all is ended and the index is written.
    """
    from synfog_usd.render import backend

    cluster.need_libraries()
    out, began, definition = plan.out, time.monotonic(), offers.with_offers(definition)
    with journal.held(out):
        _sweep(out)
        variant = backend.choose(plan.variant).variant  # type: ignore[arg-type]
        made_of = identity.identity(definition, variant)
        if (out / layout.SET).exists():
            identity.check(out, made_of)
        identity.write(out, definition, made_of)
        journal.keep_definition(out, definition)
        if plan.retry:
            journal.write(out, {"retry": True})
        chosen = backend.choose(plan.variant)  # type: ignore[arg-type]
        maker = _Maker(definition, plan, chosen.name, progress, log)
        cpu_began_s = time.process_time()
        try:
            try:
                maker.make()
            except BaseException:
                with contextlib.suppress(OutputError):  # report what ended the run, not what follows from it
                    _write_index(out, definition, log)
                raise
            _write_index(out, definition, log)
        except OutputError as error:
            raise OutputError(f"{error}. Finished units are kept; the same command goes on from there") from error
        maker.outcome.seconds = time.monotonic() - began
        maker.outcome.own_cpu_s += time.process_time() - cpu_began_s
    return maker.outcome


class _Maker:
    """One run: what is waiting, under way and done."""

    def __init__(
        self, definition: SetDefinition, plan: RunPlan, variant: str, progress: Progress, log: Callable[[str], None]
    ) -> None:
        self.found, self.plan, self.variant, self.progress, self.log = definition, plan, variant, progress, log
        self.tally = journal.tally(plan.out)
        self.cost = Cost.of_tally(definition, self.tally)
        self.outcome = Outcome()
        self.tries: dict[str, int] = {}
        self.ended: queue.SimpleQueue[tuple[Unit, Any]] = queue.SimpleQueue()
        self.under_way: dict[str, Any] = {}
        self.used_bytes = self.tally.bytes
        self.total = self.done = 0
        self.gpus: tuple[str, ...] = ()

    def make(self) -> None:
        todo = self.todo()
        first = next(todo, None)
        if first is None:
            return
        with self.workers() as workers:
            self.total = sum(1 for _ in self.todo(quiet=True))
            self.log(f"{self.total} units of one scene in one lighting to make, {workers.count} at a time")
            self.feed(workers, _chain(first, todo))

    def todo(self, quiet: bool = False) -> Iterator[Unit]:
        """Units that are not there, in order; what is there or set aside is counted, once."""
        for planned in scenes(self.found, self.plan.only):
            for unit in planned.units:
                if unit.name in self.tally.aside and not self.plan.retry:
                    if not quiet:
                        self.outcome.aside[unit.name] = self.tally.aside[unit.name]
                elif not self.plan.repair and (self.plan.out / unit.folder / layout.UNIT).exists():
                    self.outcome.kept += not quiet
                else:
                    yield unit

    @contextlib.contextmanager
    def workers(self) -> Iterator[cluster.Workers]:
        plan = self.plan
        if plan.scheduler is not None:
            with cluster.joined(plan.scheduler) as client:
                yield client
        else:
            self.gpus = cluster.gpus() if self.variant == "cuda" else ()
            with cluster.local(plan.workers or len(self.gpus) or cluster.fitting(self.tally.peak_mb or None)) as client:
                yield client

    def feed(self, workers: cluster.Workers, todo: Iterator[Unit]) -> None:
        """Keep the workers busy until nothing is left."""
        waiting = list[Unit]()
        try:
            while True:
                while len(self.under_way) < workers.count and not self.outcome.stopped:
                    unit = waiting.pop() if waiting else next(todo, None)
                    if unit is None or self.too_much():
                        break
                    self.submit(workers, unit)
                if not self.under_way:
                    return
                try:
                    unit, future = self.ended.get(timeout=LOOK_S)
                except queue.Empty:
                    if workers.client.status != "running":
                        raise self.gone() from None
                    continue
                self.under_way.pop(unit.name)
                if again := self.take(unit, future, workers.here):
                    waiting.append(again)
                else:
                    self.tell()
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone; what is under way ends with the workers
                workers.client.cancel(list(self.under_way.values()), force=True)

    def submit(self, workers: cluster.Workers, unit: Unit) -> None:
        layout.part_path(self.plan.out, unit.number // layout.A_FOLDER).unlink(missing_ok=True)
        job = Job(
            self.plan.out.resolve(),
            unit,
            self.plan.limit_s or self.cost.limit_s(unit.lighting),
            self.variant,
            self.plan.repair,
            shared_cores(workers.cores, workers.count, self.total - self.done - len(self.under_way)),
            self.gpus,
        )
        try:
            future = workers.client.submit(
                do, job, self.plan.child, key=f"{unit.name}-{self.tries.get(unit.name, 0)}", pure=False
            )
        except Exception as error:
            raise self.gone() from error
        self.under_way[unit.name] = future
        future.add_done_callback(lambda ended: self.ended.put((unit, ended)))

    def take(self, unit: Unit, future: Future[Any], here: bool) -> Unit | None:
        """Write down how a unit ended; the unit itself where it is to be tried again."""
        result = self.result(future)
        if not here:  # else its worker's time is this process's
            self.outcome.own_cpu_s += result.get("own_cpu_s", 0.0)
        number = self.tries[unit.name] = self.tries.pop(unit.name, 0) + 1
        line = {"unit": unit.name, "try": number, **result}
        if result["ok"]:
            del self.tries[unit.name]
            journal.write(self.plan.out, line)
            self.tally.add(line)
            if not result["made"]:
                self.outcome.kept += 1
                return None
            self.outcome.made += 1
            self.outcome.cpu_s += result["cpu_s"]
            self.used_bytes += result["bytes"]
            self.cost = self.cost.with_unit(unit.lighting, result["seconds"])
            return None
        for place in (OutputError, identity.MismatchError):  # no fault of the unit: all others would fail too
            if result["kind"] == place.__name__:
                raise place(result["error"])
        if number < TRIES:
            journal.write(self.plan.out, line)
            self.log(f"{unit.name}: {result['error']}; it is tried again")
            return unit
        del self.tries[unit.name]
        line |= {"aside": True, "seed": self.planned(unit).seed}
        journal.write(self.plan.out, line)
        self.outcome.aside[unit.name] = line
        self.log(f"{unit.name} (seed {line['seed']}) is set aside after {TRIES} tries: {result['error']}")
        return None

    def result(self, future: Future[Any]) -> dict[str, Any]:
        """What a worker says, or what became of it."""
        from distributed.scheduler import KilledWorker

        if future.status == "finished":
            return dict(future.result())
        if future.status in ("cancelled", "lost"):
            raise self.gone()
        try:
            error = future.exception()  # type: ignore[no-untyped-call]
        except Exception as problem:
            raise self.gone() from problem
        if isinstance(error, KilledWorker):
            return {"ok": False, "kind": "killed", "error": "its worker died"}
        if isinstance(error, OSError):
            raise OutputError(f"a worker cannot work: {error}")
        raise error

    def gone(self) -> SetError:
        return SetError(
            f"the scheduler went away. {self.outcome.made} units were made, and are kept; the same command goes on "
            f"from there"
        )

    def planned(self, unit: Unit) -> PlannedScene:
        return next(scenes(self.found, [unit.number]))

    def too_much(self) -> bool:
        """Whether another unit would go beyond the budget, or the disk is about to be full."""
        each = self.used_bytes / max(1, self.tally.units) if self.tally.units else 0
        coming = each * (len(self.under_way) + 1)
        if self.plan.budget_gb is not None and self.used_bytes + coming > self.plan.budget_gb * 1e9:
            self.outcome.stopped = (
                f"the budget of {self.plan.budget_gb:g} GB is used up: {self.used_bytes / 1e9:.3g} GB are made; "
                f"the same command with a larger one goes on"
            )
        free = shutil.disk_usage(self.plan.out).free
        if free < SPARE_BYTES + coming:
            raise OutputError(
                f"{self.plan.out}: {free / 1e9:.2g} GB are free on this disk, too few for another unit; free some"
            )
        return bool(self.outcome.stopped)

    def tell(self) -> None:
        self.done += 1
        parts = [f"{self.done} of {self.total} units", f"{self.used_bytes / 1e9:.2f} GB"]
        if self.outcome.aside:
            parts.append(f"{len(self.outcome.aside)} set aside")
        self.progress(", ".join(parts), self.done / max(1, self.total))


def shared_cores(cores: int, workers: int, units_left: int) -> int:
    """On how many cores a unit may run: the last ones take those of the workers that have nothing more to do.

    Args:
        cores: of each worker; 0 is all of its machine's.
        workers: how many.
        units_left: units that are not begun, with this one.

    >>> [shared_cores(2, 4, left) for left in (5, 4, 3, 2, 1)]
    [2, 2, 2, 4, 8]
    """
    return cores * workers // units_left if 0 < units_left < workers else cores


def _chain(first: Unit, rest: Iterable[Unit]) -> Iterator[Unit]:
    yield first
    yield from rest


def _sweep(out: Path) -> None:
    """What a killed client left half-written."""
    for folder in (out, out / layout.INDEX, out / layout.RUN):
        for leftover in folder.glob(files.TEMPORARY_PREFIX + "*"):
            leftover.unlink(missing_ok=True)


def _write_index(out: Path, definition: SetDefinition, log: Callable[[str], None]) -> None:
    """Write the parts of the index that are not there, of the units that are finished."""
    for part in range(-(-definition.scenes // layout.A_FOLDER)):
        if layout.part_path(out, part).exists():
            continue
        low = part * layout.A_FOLDER
        index.write_part(
            out, part, _rows(out, definition, range(low, min(low + layout.A_FOLDER, definition.scenes)), log)
        )


def _rows(
    out: Path, definition: SetDefinition, numbers: Iterable[int], log: Callable[[str], None]
) -> Iterator[dict[str, Any]]:
    for planned in scenes(definition, numbers):
        stages = set[str]()
        for unit in planned.units:
            if (unit_record := record(out, unit)) is not None:
                stages.add(unit_record["stage_sha256"])
                yield from rows(unit_record, unit)
        if len(stages) > 1:
            log(f"scene {planned.number}: its stage or what it refers to was changed between its lightings")

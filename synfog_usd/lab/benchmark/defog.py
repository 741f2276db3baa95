"""The defogging bench: what methods make of foggy pictures, against the same views in clear air."""

from __future__ import annotations

import contextlib
import json
import queue
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.lab.benchmark import bench, metrics
from synfog_usd.lab.benchmark.bench import Bench, Question, Row
from synfog_usd.lab.benchmark.methods import PNG, Defogger, Measurer
from synfog_usd.lab.benchmark.pairs import Pair
from synfog_usd.lab.benchmark.worker import MethodError, MethodWorker

MEASURER = Measurer("metrics", "metrics", timeout_s=3600.0, memory_gb=4096.0, at_once=0)
"""Ours, so it has all the memory that there is, and time for large pictures."""


def run(
    pairs: Sequence[Pair],
    methods: Sequence[Defogger],
    out: Path,
    *,
    retry: bool = False,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
) -> Bench:
    """Measure methods on pairs; what `out` has already of the same pictures and methods is kept.

    Args:
        pairs: from `pairs.find`.
        methods: from `methods.chosen`.
        out, retry, progress, log: as `bench.run` has them.

    Returns:
        rows of numbers by metric.

    Raises:
        OutputError: the folder cannot be written, or `results.json` there is none of ours.
    """
    with _measuring() as measure:
        question = Question(_of_files, MethodWorker, _asked, measure)
        return bench.run(pairs, methods, out, question, retry=retry, progress=progress, log=log)


def values(bench_run: Bench, method: Defogger, metric: str, fog: str | None = None) -> dict[str, float]:
    """Pair -> number, of the pairs that the method answered."""
    rows = {pair.name: bench_run.row(method, pair) for pair in bench_run.items if fog is None or pair.fog == fog}
    return {name: float(row[metric]) for name, row in rows.items() if metric in row}


def _asked(pair: Pair, method: Defogger, worker: MethodWorker) -> Row:
    """{'answer', 'truth'}, files, or {'error'}."""
    source = pair.foggy if method.takes == PNG else pair.files.get(method.takes)
    if source is None:
        return {"error": f"the pair has no {method.takes}"}
    try:
        if bench.shape(pair.clear) != bench.shape(pair.foggy):
            return {"error": "the foggy and the clear picture differ in size"}
        return {"answer": worker.ask(source), "truth": pair.clear}
    except (MethodError, ParameterError) as error:
        return {"error": str(error)}


@contextlib.contextmanager
def _measuring() -> Iterator[Callable[[Row], Row]]:
    """What makes numbers of an answer, in as many children as threads call it."""
    with tempfile.TemporaryDirectory(prefix="synfog-usd-") as folder:
        workers: list[MethodWorker] = []
        free: queue.SimpleQueue[MethodWorker] = queue.SimpleQueue()

        def measure(row: Row) -> Row:
            try:
                worker = free.get_nowait()
            except queue.Empty:
                worker = MethodWorker(MEASURER, Path(tempfile.mkdtemp(dir=folder)))
                workers.append(worker)
            try:
                answer_file = worker.ask(row["answer"], truth=row["truth"])
                numbers: Row = json.loads(answer_file.read_text(encoding="utf-8"))
                answer_file.unlink()
                return numbers
            except MethodError as error:  # where the answer lay is of no use afterwards, and differs from run to run
                return {"error": str(error).replace(str(row["answer"]), "the answer")}
            finally:
                row["answer"].unlink()
                free.put(worker)

        try:
            yield measure
        finally:
            for worker in workers:
                worker.close()


def _of_files(pair: Pair, method: Defogger) -> str:
    source = pair.foggy if method.takes == PNG else pair.files.get(method.takes, pair.foggy)
    return f"{bench.digest(source)} {bench.digest(pair.clear)} {' '.join(metrics.usable())}"


def fogs(pairs: Sequence[Pair]) -> list[str]:
    """Names of the fogs, in the order in which pairs have them; [] where none says."""
    by_fog: dict[str, int] = defaultdict(int)
    for pair in pairs:
        by_fog[pair.fog] += 1
    return [fog for fog in by_fog if fog]

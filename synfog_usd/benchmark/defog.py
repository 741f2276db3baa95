"""The defogging bench: what methods make of foggy pictures, against the same views in clear air."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path

from synfog_usd.benchmark import bench, metrics
from synfog_usd.benchmark.bench import Bench, Row
from synfog_usd.benchmark.methods import PNG, Defogger
from synfog_usd.benchmark.pairs import Pair
from synfog_usd.benchmark.worker import MethodError, MethodWorker
from synfog_usd.errors import ParameterError
from synfog_usd.progress import Progress, silent


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
        rows of numbers by metric, and 'seconds'.

    Raises:
        OutputError: the folder cannot be written, or `results.json` there is none of ours.
    """
    return bench.run(
        pairs,
        methods,
        out,
        key=_of_files,
        opened=MethodWorker,
        ask=_asked,
        measure=_measured,
        retry=retry,
        progress=progress,
        log=log,
    )


def values(found: Bench, method: Defogger, metric: str, fog: str | None = None) -> dict[str, float]:
    """Pair -> number, of the pairs that the method answered."""
    rows = {pair.name: found.row(method, pair) for pair in found.items if fog is None or pair.fog == fog}
    return {name: float(row[metric]) for name, row in rows.items() if metric in row}


def _asked(pair: Pair, method: Defogger, worker: MethodWorker) -> Row:
    """{'answer', 'truth', 'seconds'}, or {'error'}."""
    taken = pair.foggy if method.takes == PNG else pair.files.get(method.takes)
    if taken is None:
        return {"error": f"the pair has no {method.takes}"}
    try:
        truth = bench.picture(pair.clear)
        if bench.picture(pair.foggy).shape != truth.shape:
            return {"error": "the foggy and the clear picture differ in size"}
        began = time.monotonic()
        answer = bench.picture(worker.ask(taken))
        return {"answer": answer, "truth": truth, "seconds": round(time.monotonic() - began, 3)}
    except (MethodError, ParameterError) as error:
        return {"error": str(error)}


def _measured(row: Row) -> Row:
    try:
        return {**metrics.measure(row["answer"], row["truth"]), "seconds": row["seconds"]}
    except ParameterError as error:
        return {"error": str(error)}


def _of_files(pair: Pair, method: Defogger) -> str:
    taken = pair.foggy if method.takes == PNG else pair.files.get(method.takes, pair.foggy)
    return f"{bench.digest(taken)} {bench.digest(pair.clear)} {' '.join(metrics.usable())}"


def fogs(pairs: Sequence[Pair]) -> list[str]:
    """Names of the fogs, in the order in which pairs have them; [] where none says."""
    by_fog: dict[str, int] = defaultdict(int)
    for pair in pairs:
        by_fog[pair.fog] += 1
    return [fog for fog in by_fog if fog]

"""The defogging bench: every method on every pair, measured, and kept as it goes."""

from __future__ import annotations

import functools
import json
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd import files
from synfog_usd.benchmark import metrics
from synfog_usd.benchmark.child import read
from synfog_usd.benchmark.methods import PNG, Defogger
from synfog_usd.benchmark.pairs import Pair
from synfog_usd.benchmark.worker import MethodError, MethodWorker
from synfog_usd.errors import OutputError, ParameterError
from synfog_usd.progress import Progress, silent

RESULTS = "results.json"
KEEP_EVERY_S = 5.0

GIVE_UP = 3
"""Failures in a row, from the first picture on, after which a method is asked no more."""


@dataclass
class DefogBench:
    """What came of a run.

    Attributes:
        pairs: in order.
        methods: in order.
        rows: (method's version, pair's name) -> numbers by metric, and 'seconds'; or {'error': line}.
        made: how many of them are of this run.
    """

    pairs: Sequence[Pair]
    methods: Sequence[Defogger]
    rows: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    made: int = 0

    def values(self, method: Defogger, metric: str, fog: str | None = None) -> dict[str, float]:
        """Pair -> number, of the pairs that the method answered."""
        found = {}
        for pair in self.pairs:
            row = self.rows.get((method.version, pair.name), {})
            if metric in row and (fog is None or pair.fog == fog):
                found[pair.name] = float(row[metric])
        return found

    def failures(self, method: Defogger) -> dict[str, str]:
        """Pair -> why it has no answer."""
        rows = {pair.name: self.rows.get((method.version, pair.name), {}) for pair in self.pairs}
        return {name: row["error"] for name, row in rows.items() if "error" in row}


def run(
    pairs: Sequence[Pair],
    methods: Sequence[Defogger],
    out: Path,
    *,
    retry: bool = False,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
) -> DefogBench:
    """Measure methods on pairs; what `out` has already of the same pictures and methods is kept.

    Args:
        pairs: from `pairs.find`.
        methods: from `methods.chosen`.
        out: folder; `results.json` is written as it goes, whole each time.
        retry: take up what failed, too.
        progress, log: whom to tell.

    Raises:
        OutputError: the folder cannot be written.
        ParameterError: `results.json` there is none of ours.
    """
    bench = DefogBench(pairs, methods)
    known = _kept(out / RESULTS)
    total, done, kept_at = len(pairs) * len(methods), 0, time.monotonic()
    with ThreadPoolExecutor(1) as pool, tempfile.TemporaryDirectory(prefix="synfog-usd-") as folder:
        try:
            for method in methods:
                worker, failed = MethodWorker(method, Path(folder)), 0
                waiting: dict[str, Future[dict[str, Any]]] = {}  # one picture is measured while the next is worked on
                try:
                    for number, pair in enumerate(pairs):
                        progress(f"{method.name}: {pair.name}", done / total)
                        done += 1
                        key = f"{method.version} {_of_files(pair, method)}"
                        if key in known and not (retry and "error" in known[key]):
                            continue
                        if failed == number == GIVE_UP:
                            log(f"{method.name}: failed on the first {GIVE_UP} pictures; it is asked no more")
                        if failed >= GIVE_UP and failed == number:
                            row: dict[str, Any] = {"error": f"not asked: it failed on the first {GIVE_UP} pictures"}
                        else:
                            row = _asked(pair, method, worker)
                        if "error" in row:
                            failed += failed == number
                            known[key] = row
                            log(f"{method.name}: {pair.name}: {row['error']}")
                        else:
                            waiting[key] = pool.submit(_measured, row)
                        bench.made += 1
                        if time.monotonic() - kept_at > KEEP_EVERY_S:
                            _take(waiting, known)
                            files.write_json(out / RESULTS, known)
                            kept_at = time.monotonic()
                finally:
                    worker.close()
                    _take(waiting, known)
                for pair in pairs:
                    bench.rows[method.version, pair.name] = known[f"{method.version} {_of_files(pair, method)}"]
        finally:
            files.write_json(out / RESULTS, known)
    return bench


def _take(waiting: dict[str, Future[dict[str, Any]]], known: dict[str, dict[str, Any]]) -> None:
    for key in list(waiting):
        known[key] = waiting.pop(key).result()


def _asked(pair: Pair, method: Defogger, worker: MethodWorker) -> dict[str, Any]:
    """{'answer', 'truth', 'seconds'}, or {'error'}."""
    taken = pair.foggy if method.takes == PNG else pair.files.get(method.takes)
    if taken is None:
        return {"error": f"the pair has no {method.takes}"}
    try:
        truth = _read(pair.clear)
        if _read(pair.foggy).shape != truth.shape:
            return {"error": "the foggy and the clear picture differ in size"}
        began = time.monotonic()
        answer = _read(worker.restore(taken))
        return {"answer": answer, "truth": truth, "seconds": round(time.monotonic() - began, 3)}
    except (MethodError, ParameterError) as error:
        return {"error": str(error)}


def _measured(row: dict[str, Any]) -> dict[str, Any]:
    try:
        return {**metrics.measure(row["answer"], row["truth"]), "seconds": row["seconds"]}
    except ParameterError as error:
        return {"error": str(error)}


def _read(path: Path) -> np.ndarray:
    from PIL import Image

    try:
        return read(path)
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise ParameterError(f"{path}: cannot be read as a picture ({error})") from error


@functools.lru_cache(maxsize=100_000)
def _digest(path: Path) -> str:
    try:
        return files.sha256_of(path)[:16]
    except OSError as error:
        return f"missing: {error.strerror}"


def _of_files(pair: Pair, method: Defogger) -> str:
    taken = pair.foggy if method.takes == PNG else pair.files.get(method.takes, pair.foggy)
    return f"{_digest(taken)} {_digest(pair.clear)}"


def _kept(path: Path) -> dict[str, dict[str, Any]]:
    if not path.exists():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, dict) or not all(isinstance(row, dict) for row in found.values()):
            raise ValueError("it is no table of results")
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be gone on with ({error}); choose another folder or take it away") from error
    return found


def fogs(pairs: Sequence[Pair]) -> list[str]:
    """Names of the fogs, in the order in which pairs have them; [] where none says."""
    by_fog: dict[str, int] = defaultdict(int)
    for pair in pairs:
        by_fog[pair.fog] += 1
    return [fog for fog in by_fog if fog]

"""A bench: every method asked about every item, in children, and what came of it kept as it goes."""

from __future__ import annotations

import functools
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from synfog_usd import files
from synfog_usd.benchmark.child import read
from synfog_usd.errors import OutputError, ParameterError
from synfog_usd.progress import Progress, silent

RESULTS = "results.json"
KEEP_EVERY_S = 5.0

GIVE_UP = 3
"""Failures in a row, from the first picture on, after which a method is asked no more."""

Row = dict[str, Any]
"""What is kept of one answer; {'error': line} where there is none."""


class Named(Protocol):
    """What is asked about."""

    @property
    def name(self) -> str: ...  # noqa: D102


class Versioned(Protocol):
    """What is asked."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def version(self) -> str: ...  # noqa: D102


class Closing(Protocol):
    """Its child, or children."""

    def close(self) -> None: ...  # noqa: D102


T = TypeVar("T", bound=Named)
M = TypeVar("M", bound=Versioned)
W = TypeVar("W", bound=Closing)


@dataclass
class Bench:
    """What came of a run.

    Attributes:
        items: in order.
        methods: in order.
        rows: (method's version, item's name) -> what is kept of its answer, or {'error': line}.
        made: how many of them are of this run.
    """

    items: Sequence[Any]
    methods: Sequence[Any]
    rows: dict[tuple[str, str], Row] = field(default_factory=dict)
    made: int = 0

    def row(self, method: Versioned, item: Named) -> Row:
        """What is kept; {} where it was not asked."""
        return self.rows.get((method.version, item.name), {})

    def failures(self, method: Versioned) -> dict[str, str]:
        """Item -> why it has no answer."""
        rows = {item.name: self.row(method, item) for item in self.items}
        return {name: row["error"] for name, row in rows.items() if "error" in row}


def run(
    items: Sequence[T],
    methods: Sequence[M],
    out: Path,
    *,
    key: Callable[[T, M], str],
    opened: Callable[[M, Path], W],
    ask: Callable[[T, M, W], Row],
    measure: Callable[[Row], Row] = lambda row: row,
    retry: bool = False,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
) -> Bench:
    """Ask methods about items; what `out` has already of the same pictures and methods is kept.

    Args:
        items, methods: in order.
        out: folder; `results.json` is written as it goes, whole each time.
        key: what the answer depends on besides the method's version.
        opened: a method's child, which puts files into the folder that it is given.
        ask: the answer, or {'error': line}.
        measure: what is kept of an answer; done while the next one is awaited.
        retry: take up what failed, too.
        progress, log: whom to tell.

    Raises:
        OutputError: the folder cannot be written, or `results.json` there is none of ours.
    """
    bench = Bench(items, methods)
    known = kept(out / RESULTS)
    _keep(out / RESULTS, known)  # a folder that cannot be written is told before the first answer
    total, done, kept_at = len(items) * len(methods), 0, time.monotonic()
    with ThreadPoolExecutor(1) as pool, tempfile.TemporaryDirectory(prefix="synfog-usd-") as folder:
        try:
            for method in methods:
                worker, failed = opened(method, Path(folder)), 0
                waiting: dict[str, Future[Row]] = {}
                try:
                    for number, item in enumerate(items):
                        progress(f"{method.name}: {item.name}", done / total)
                        done += 1
                        place = f"{method.version} {key(item, method)}"
                        if place in known and not (retry and "error" in known[place]):
                            continue
                        if failed == number == GIVE_UP:
                            log(f"{method.name}: failed on the first {GIVE_UP} pictures; it is asked no more")
                        if failed >= GIVE_UP and failed == number:
                            row: Row = {"error": f"not asked: it failed on the first {GIVE_UP} pictures"}
                        else:
                            row = ask(item, method, worker)
                        if "error" in row:
                            failed += failed == number
                            known[place] = row
                            log(f"{method.name}: {item.name}: {row['error']}")
                        else:
                            waiting[place] = pool.submit(measure, row)
                        bench.made += 1
                        if time.monotonic() - kept_at > KEEP_EVERY_S:
                            _take(waiting, known)
                            _keep(out / RESULTS, known)
                            kept_at = time.monotonic()
                finally:
                    worker.close()
                    _take(waiting, known)
                for item in items:
                    bench.rows[method.version, item.name] = known[f"{method.version} {key(item, method)}"]
        finally:
            _keep(out / RESULTS, known)
    return bench


def _take(waiting: dict[str, Future[Row]], known: dict[str, Row]) -> None:
    for key in list(waiting):
        known[key] = waiting.pop(key).result()


def _keep(path: Path, known: dict[str, Row]) -> None:
    """A line for each answer."""
    lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(row, allow_nan=False)}" for key, row in known.items())
    files.write_bytes(path, f"{{\n{lines}\n}}\n".encode())


def picture(path: Path) -> np.ndarray:
    """(H, W, 3) uint8.

    Raises:
        ParameterError: it cannot be read.
    """
    from PIL import Image

    try:
        return read(path)
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise ParameterError(f"{path}: cannot be read as a picture ({error})") from error


@functools.lru_cache(maxsize=100_000)
def digest(path: Path) -> str:
    """Of a file's bytes, for keys."""
    try:
        return files.sha256_of(path)[:16]
    except OSError as error:
        return f"missing: {error.strerror}"


def kept(path: Path) -> dict[str, Row]:
    """What an earlier run left; {} where there was none.

    Raises:
        OutputError: it is none of ours.
    """
    if not path.exists():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, dict) or not all(isinstance(row, dict) for row in found.values()):
            raise ValueError("it is no table of results")
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be gone on with ({error}); choose another folder or take it away") from error
    return found

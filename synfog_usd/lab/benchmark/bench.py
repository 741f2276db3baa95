"""A bench: every method asked about every item, in children, and what came of it kept as it goes."""

from __future__ import annotations

import contextlib
import functools
import json
import queue
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from synfog_usd.base import files
from synfog_usd.base.errors import OutputError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.dataset.sets.cluster import cores
from synfog_usd.lab.benchmark.child import picture

RESULTS = "results.json"
KEEP_EVERY_S = 5.0

GIVE_UP = 3
"""Failures in a row, from the first picture on, after which a method is not asked again."""

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
    @property
    def at_once(self) -> int: ...  # noqa: D102


class Closing(Protocol):
    """Its child, or children."""

    def close(self) -> None: ...  # noqa: D102


T = TypeVar("T", bound=Named)
M = TypeVar("M", bound=Versioned)
W = TypeVar("W", bound=Closing)

Borrowed = Callable[[], contextlib.AbstractContextManager[W]]
"""Lends one of a method's children."""


@dataclass
class Bench:
    """What came of a run.

    Attributes:
        items: in order.
        methods: in order.
        rows: (method's version, item's name) -> what is kept of its answer, or {'error': line}.
        fresh: how many of them are of this run.
    """

    items: Sequence[Any]
    methods: Sequence[Any]
    rows: dict[tuple[str, str], Row] = field(default_factory=dict)
    fresh: int = 0

    def row(self, method: Versioned, item: Named) -> Row:
        """What is kept; {} where it was not asked."""
        return self.rows.get((method.version, item.name), {})

    def failures(self, method: Versioned) -> dict[str, str]:
        """Item -> why it has no answer."""
        rows = {item.name: self.row(method, item) for item in self.items}
        return {name: row["error"] for name, row in rows.items() if "error" in row}


@dataclass(frozen=True)
class Question(Generic[T, M, W]):
    """What a bench asks its methods.

    Attributes:
        key: what the answer depends on besides the method's version.
        opened: a child of a method, which puts files into the folder that it is given.
        ask: the answer, or {'error': line}; called from several threads, with a child for each.
        measure: what is kept of an answer; called from several threads while the child goes on.
    """

    key: Callable[[T, M], str]
    opened: Callable[[M, Path], W]
    ask: Callable[[T, M, W], Row]
    measure: Callable[[Row], Row] = lambda row: row

    def answer(self, item: T, method: M, borrowed: Borrowed[W]) -> Row:
        """What is kept of the answer of one of the method's children."""
        with borrowed() as child:
            row = self.ask(item, method, child)
        return row if "error" in row else self.measure(row)


def run(
    items: Sequence[T],
    methods: Sequence[M],
    out: Path,
    question: Question[T, M, W],
    *,
    retry: bool = False,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
) -> Bench:
    """Ask methods about items; what `out` has already of the same pictures and methods is kept.

    Methods follow each other.  The items of one go side by side, as many as there are cores; of its children there are
    as many as it may work on in parallel.

    Args:
        items, methods: in order.
        out: folder; `results.json` is written as it goes, whole each time, in the order of methods and items.
        question: what is asked.
        retry: take up what failed, too.
        progress, log: whom to tell.

    Raises:
        OutputError: the folder cannot be written, or `results.json` there is none of ours.
    """
    bench, lanes = Bench(items, methods), cores()
    keys = [[f"{method.version} {question.key(item, method)}" for item in items] for method in methods]
    answers = _KeptAnswers(out / RESULTS, [key for row in keys for key in row], progress)
    with ThreadPoolExecutor(lanes) as pool, tempfile.TemporaryDirectory(prefix="synfog-usd-") as folder:
        try:
            for method, row in zip(methods, keys, strict=True):
                missing: dict[str, T] = {}
                for key, item in zip(row, items, strict=True):
                    if answers.lacks(key, retry):
                        missing.setdefault(key, item)
                answers.done += len(items) - len(missing)
                children = [
                    question.opened(method, Path(tempfile.mkdtemp(dir=folder)))
                    for _ in range(min(method.at_once or lanes, lanes))
                ]
                with _children(children) as borrowed:
                    work = functools.partial(question.answer, method=method, borrowed=borrowed)
                    bench.fresh += _ask(pool, work, method.name, row, missing, answers, log)
                for key, item in zip(row, items, strict=True):
                    bench.rows[method.version, item.name] = answers.rows[key]
        finally:
            answers.write()
    return bench


class _KeptAnswers:
    """Answers by key, kept in a file while they come.

    Args:
        path: the file; what an earlier run left in it is read.
        order: keys of this run, in which they are written.
        progress: called for each answer.
    """

    def __init__(self, path: Path, order: Sequence[str], progress: Progress) -> None:
        self.path, self.order, self.progress = path, order, progress
        self.rows, self.done = read_results(path), 0
        _keep(path, self.rows)  # a folder that cannot be written is refused before the first answer
        self._written_at = time.monotonic()

    def lacks(self, key: str, retry: bool) -> bool:
        """Whether there is no answer, or under `retry` an error."""
        return key not in self.rows or (retry and "error" in self.rows[key])

    def add(self, key: str, row: Row, what: str) -> None:
        """Take an answer; the file is written now and then."""
        self.rows[key] = row
        self.done += 1
        self.progress(what, self.done / len(self.order))
        if time.monotonic() - self._written_at > KEEP_EVERY_S:
            self.write()
            self._written_at = time.monotonic()

    def write(self) -> None:
        """Write the file."""
        _keep(self.path, self.rows, self.order)


def _ask(
    pool: ThreadPoolExecutor,
    work: Callable[[T], Row],
    name: str,
    row: Sequence[str],
    missing: Mapping[str, T],
    answers: _KeptAnswers,
    log: Callable[[str], None],
) -> int:
    """Ask one method for the answers that are missing, its first pictures before the others; how many there were."""
    first = {key: item for key, item in missing.items() if key in row[:GIVE_UP]}
    for batch in (first, {key: item for key, item in missing.items() if key not in first}):
        hopeless = batch is not first and bool(batch) and _hopeless(row, answers.rows)
        if hopeless:
            log(f"{name}: failed on the first {GIVE_UP} pictures; it is not asked again")
        why = {"error": f"not asked: it failed on the first {GIVE_UP} pictures"}
        results = ((key, why) for key in batch) if hopeless else _side_by_side(pool, work, batch)
        for key, answer in results:
            answers.add(key, answer, f"{name}: {batch[key].name}")
            if "error" in answer and not hopeless:
                log(f"{name}: {batch[key].name}: {answer['error']}")
    return len(missing)


def _hopeless(row: Sequence[str], rows: dict[str, Row]) -> bool:
    """Whether a method failed on the first pictures, and answered none."""
    return all(place in rows for place in row[:GIVE_UP]) and all(
        "error" in rows[place] for place in row if place in rows
    )


@contextlib.contextmanager
def _children(children: Sequence[W]) -> Iterator[Borrowed[W]]:
    """A way to borrow one of a method's children, for which a thread waits its turn; they end with the context."""
    free: queue.LifoQueue[W] = queue.LifoQueue()
    for child in children:
        free.put(child)
    over = threading.Event()

    @contextlib.contextmanager
    def borrowed() -> Iterator[W]:
        child = free.get()
        try:
            if over.is_set():  # after Ctrl-C nobody begins anything
                raise RuntimeError("the bench has ended")
            yield child
        finally:
            free.put(child)

    try:
        yield borrowed
    finally:
        over.set()
        for child in children:
            child.close()


def _side_by_side(
    pool: ThreadPoolExecutor, work: Callable[[T], Row], items: Mapping[str, T]
) -> Iterator[tuple[str, Row]]:
    """What came of each item, as it comes; what was not begun when nobody asks any more is not begun."""
    going = {pool.submit(work, item): place for place, item in items.items()}
    try:
        for future in as_completed(going):
            yield going[future], future.result()
    finally:
        for future in going:
            future.cancel()


def _keep(path: Path, rows: dict[str, Row], order: Sequence[str] = ()) -> None:
    """A line for each answer: those of other runs, then those of this one in order."""
    mine = set(order)
    places = [place for place in rows if place not in mine] + [place for place in dict.fromkeys(order) if place in rows]
    lines = ",\n".join(f"{json.dumps(place)}: {json.dumps(rows[place], allow_nan=False)}" for place in places)
    files.write_bytes(path, f"{{\n{lines}\n}}\n".encode())


@functools.lru_cache(maxsize=100_000)
def shape(path: Path) -> tuple[int, ...]:
    """Of `picture`, which raises what this does."""
    return picture(path).shape


@functools.lru_cache(maxsize=100_000)
def digest(path: Path) -> str:
    """Of a file's bytes, for keys."""
    try:
        return files.sha256_of(path)[:16]
    except OSError as error:
        return f"missing: {error.strerror}"


def read_results(path: Path) -> dict[str, Row]:
    """What an earlier run left; {} where there was none.

    Raises:
        OutputError: it is none of ours.
    """
    if not path.exists():
        return {}
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(rows, dict) or not all(isinstance(row, dict) for row in rows.values()):
            raise ValueError("it is no table of results")
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be gone on with ({error}); choose another folder or take it away") from error
    return rows

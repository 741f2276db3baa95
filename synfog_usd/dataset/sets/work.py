"""What a worker does: one unit in a child process with a time limit.

The child is the command line itself, so that what kills it (memory, a damaged stage, a kernel) kills nothing else.  It
dies with the worker, and the worker tells how it ended.  A worker of this machine is a thread of the client, which only
waits; one of a cluster is a process of its own.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synfog_usd.base import isolated, system
from synfog_usd.dataset.sets.layout import Unit

TOLD = 2000
"""Characters of a child's last words that are kept."""

_told_cpu_s = 0.0
_children: set[subprocess.Popen[bytes]] = set()
_closing = False
_beginning = threading.Lock()


@dataclass(frozen=True)
class Child:
    """How a child is begun.

    Attributes:
        words: the module that it runs, and words of its command line before what to make.
        mark: environment variable that tells it its parent.
    """

    words: tuple[str, ...]
    mark: str


CHILD = Child(("synfog_usd.cli.main", "dataset", "unit"), isolated.MARK)
"""What makes one unit."""


@dataclass(frozen=True)
class Job:
    """A unit to be made.

    Attributes:
        out: folder of the set.
        unit: which.
        limit_s: seconds after which it is ended.
        variant: of the renderer.
        repair: whether the files of a finished unit are looked at.
        cores: on which its worker's child may run at a time; 0 is all.
        gpus: of the machine, which its workers share out; () is all.
        place: number of its worker among those of the machine; Dask's worker knows where None.
    """

    out: Path
    unit: Unit
    limit_s: float
    variant: str
    repair: bool = False
    cores: int = 0
    gpus: tuple[str, ...] = ()
    place: int | None = None


def do(job: Job, child: Child) -> dict[str, Any]:
    """Make a unit in a child and wait for it.

    Returns:
        `ok`; where it is true what the child told (`made`, `bytes`, `peak_mb`, `cpu_s`), else `error` and `kind`, the
        class of the exception or 'killed', 'limit', 'crash'.  Either way `seconds`, and `own_cpu_s`, what the worker
        itself took of the processor since its last report.
    """
    global _told_cpu_s
    began = time.monotonic()
    result = _made(job, child)
    before, _told_cpu_s = _told_cpu_s, time.process_time()
    return {**result, "seconds": round(time.monotonic() - began, 3), "own_cpu_s": round(_told_cpu_s - before, 3)}


def _made(job: Job, child: Child) -> dict[str, Any]:
    words = [*child.words, str(job.out), str(job.unit.number), job.unit.lighting, "--variant", job.variant]
    words += ["--camera", job.unit.camera] if job.unit.camera else []
    words += ["--repair"] if job.repair else []
    environment = isolated.environment()
    place = _place() if job.place is None else job.place
    if job.gpus:
        environment["CUDA_VISIBLE_DEVICES"] = job.gpus[place % len(job.gpus)]
    with tempfile.TemporaryFile() as answer_file, tempfile.TemporaryFile() as wrong:
        with _beginning:
            if _closing:
                return _failed("killed", "the run ends")
            process = subprocess.Popen(
                isolated.command(*words),
                env={**environment, child.mark: str(os.getpid())},
                stdin=subprocess.DEVNULL,
                stdout=answer_file,
                stderr=wrong,
                **system.apart(),
            )
            _children.add(process)
        try:
            _pin(process.pid, job.cores, place)
            code = system.died(process.wait(timeout=job.limit_s))
        except subprocess.TimeoutExpired:
            return _failed("limit", f"took longer than its limit of {job.limit_s:.0f} s")
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            with _beginning:
                _children.discard(process)
        answer_file.seek(0)
        wrong.seek(max(0, wrong.seek(0, os.SEEK_END) - TOLD))
        last_words = wrong.read().decode(errors="replace").strip()
        with contextlib.suppress(ValueError):
            return dict(json.loads(answer_file.read().decode(errors="replace").strip().rpartition("\n")[2]))
    if code < 0:
        return _failed("killed", "its process died of {}: {}".format(*system.cause(code)))
    if last_words.startswith("Traceback") or "\n  File " in last_words:
        last_words = last_words.splitlines()[-1]
    return _failed("crash", last_words or f"its process ended with exit code {code}")


@contextlib.contextmanager
def ending_children(workers: contextlib.AbstractContextManager[Any]) -> Iterator[None]:
    """Threads of this process as workers; when the block ends, however it does, their children do, and none begins."""
    global _closing
    try:
        with workers:
            try:
                yield
            finally:
                with _beginning:
                    _closing = True
                    for process in _children:
                        process.kill()
    finally:
        _closing = False


def outcome_of(work: Callable[[], tuple[dict[str, Any], bool]]) -> tuple[dict[str, Any], int]:
    """In the child: what to print of a unit, and the exit code."""
    from synfog_usd.base.errors import OutputError, SynfogError

    try:
        result, fresh = work()
    except OSError as error:  # of the place, not of the unit: a disk that is read-only, a file in the way
        place = f"{error.filename}: cannot be used ({error.strerror})"
        return {"ok": False, "error": place, "kind": OutputError.__name__}, OutputError.exit_code
    except SynfogError as error:
        return {"ok": False, "error": str(error), "kind": type(error).__name__}, error.exit_code
    cpu_s, peak_mb = system.used()
    return {
        "ok": True,
        "made": fresh,
        "bytes": sum(size for size, _ in result["files"].values()),
        "shots": len(result["shots"]),
        "peak_mb": round(peak_mb),
        "cpu_s": round(cpu_s, 2),
    }, 0


def _failed(kind: str, error: str) -> dict[str, Any]:
    return {"ok": False, "kind": kind, "error": error}


def _place() -> int:
    """Number of this worker among those of its machine, 0 outside of any."""
    if "distributed" in sys.modules:
        with contextlib.suppress(TypeError, ValueError):
            return int(sys.modules["distributed"].get_worker().name)
    return 0


def _pin(process: int, cores: int, place: int) -> None:
    """Keep the child of a local worker to its share of the cores; libraries then begin as many threads."""
    if not cores or not hasattr(os, "sched_setaffinity"):
        return
    mine = sorted(os.sched_getaffinity(0))
    first = place * cores % len(mine)
    with contextlib.suppress(OSError):
        os.sched_setaffinity(process, (mine + mine)[first : first + cores])

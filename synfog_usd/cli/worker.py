"""A verb's work in a child process, so that stopping is quick and a crash is one line.

A renderer's kernel cannot be interrupted from Python, and a malformed stage can
take the USD library down with it.  The parent therefore only waits: on Ctrl-C it
ends the child immediately, and it turns a child's death by signal into a message.
"""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from synfog_usd.base import isolated, system
from synfog_usd.base.isolated import MARK

INTERRUPTED = 130

TUNED = {"OPENBLAS_NUM_THREADS": "1", "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}
"""NumPy multiplies small matrices: more threads of it wait busily for the next product, beside the renderer's.  And
glibc asks Linux for large pages, which spares a bake of the crossing two million page faults and 3 % of its time.
"""


def is_worker() -> bool:
    """Whether this process is the child."""
    return MARK in os.environ


def follow_parent() -> None:
    """In the child: end when the parent ends, however it ends; and speak by a descriptor of its own, so that libraries
    can be silenced.
    """
    system.follow(int(os.environ[MARK]), INTERRUPTED)
    old = sys.stderr
    sys.stderr = os.fdopen(os.dup(2), "w", buffering=1, encoding=old.encoding, errors=old.errors)


def end_with(work: Callable[[], Any]) -> None:
    """Do it and end this process by its exit code; the child immediately, without what libraries print or
    undo at the end: a third of a second, and, as was seen beside PyTorch, twenty lines about OpenImageIO's types.
    """
    code: Any = 0
    try:
        work()
    except SystemExit as end:
        code = end.code
    if not is_worker() or isinstance(code, str):
        sys.exit(code)
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.flush()
    os._exit(code or 0)


class _UnprintedError(OSError):
    """What was to be printed could not be written."""


class _Printer:
    """A stream whose failures can be distinguished from those of other files."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with _unprinted():
            return self._stream.write(text)

    def flush(self) -> None:
        if not self._stream.closed:
            with _unprinted():
                self._stream.flush()


@contextlib.contextmanager
def _unprinted() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _UnprintedError(error.errno, error.strerror) from error


@contextlib.contextmanager
def printed() -> Iterator[None]:
    """What is printed within it is written when it ends.  Where that fails, a line says so, and the exit code is 2 if
    it was to be 0.
    """
    out, end = sys.stdout, None
    if out is None:  # it was closed before we began
        yield
        return
    printer = sys.stdout = _Printer(out)
    try:
        try:
            yield
        except SystemExit as ended:
            end = ended
        except BaseException:  # which says more
            with contextlib.suppress(OSError):
                printer.flush()
            raise
        printer.flush()
    except _UnprintedError as error:
        with contextlib.suppress(OSError, ValueError):  # else Python tries again at its end, and complains itself
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, out.fileno())
            os.close(nowhere)
        if error.errno != errno.EPIPE:  # else nobody reads any more
            print(f"synfog-usd: what was to be printed could not be written: {error}", file=sys.stderr)
        sys.exit((end and end.code) or 2)
    finally:
        sys.stdout = out
    if end is not None:
        raise end


def _libraries_unheard() -> contextlib.AbstractContextManager[None]:
    """`unheard` in the child.  USD prints five lines when it is killed; the parent prints one."""
    return unheard() if is_worker() else contextlib.nullcontext()


@contextlib.contextmanager
def unheard() -> Iterator[None]:
    """What libraries write to the standard error is lost meanwhile."""
    try:
        descriptor = os.dup(2)
    except OSError:  # it is closed: nobody hears anyway
        yield
        return
    nowhere, hook = os.open(os.devnull, os.O_WRONLY), sys.excepthook
    os.dup2(nowhere, 2)
    sys.excepthook = lambda *error: None  # USD prints an error of Python's by it, and goes on
    try:
        yield
    finally:
        sys.excepthook = hook
        os.dup2(descriptor, 2)
        os.close(descriptor)
        os.close(nowhere)


@contextlib.contextmanager
def reading_limits() -> Iterator[None]:
    """In the child, while a stage is read or translated: bounded memory and time; as before afterwards, because
    rendering may take long.

    Beyond them the process dies or raises MemoryError, and the parent says so.
    """
    limits = system.limits(cpu_s=system.READ_CPU_S, wall_s=system.READ_WALL_S)
    with limits, _libraries_unheard(), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # numbers that overflow in numpy: their results become notes
        yield


def crash_line(code: int, stage: Path, verb: str) -> str:
    """Why a child died, in one line for the user.

    Args:
        code: negative, of `run`.
        stage: what it worked on.
        verb: what it did with it, as 'read it'.
    """
    signal_name, reason = system.cause(code)
    return f"synfog-usd: {stage}: the process that {verb} died of {signal_name}: {reason}"


def run(arguments: Sequence[str]) -> int:
    """Run this command line again in a child process.

    Returns:
        its exit code, INTERRUPTED after Ctrl-C or SIGTERM, or what is negative where it died, see `system.died`.
    """
    child = subprocess.Popen(
        isolated.command("synfog_usd.cli.main", *arguments),
        env={**TUNED, **isolated.environment(), MARK: str(os.getpid())},
        **system.apart(),
    )

    try:
        with stopped_by_sigterm():
            while True:  # on Windows Ctrl-C is not heard during a wait without an end
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return system.died(child.wait(timeout=None if sys.platform != "win32" else 0.2))
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()


@contextlib.contextmanager
def stopped_by_sigterm() -> Iterator[None]:
    """Meanwhile SIGTERM is heard as Ctrl-C is, so that what is temporary is cleared away."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)

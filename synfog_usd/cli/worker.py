"""A verb's work in a child process, so that stopping is quick and a crash is one line.

A renderer's kernel cannot be interrupted from Python, and a malformed stage can
take the USD library down with it.  The parent therefore only waits: on Ctrl-C it
ends the child at once, and it turns a child's death by signal into a message.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

MARK = "SYNFOG_USD_WORKER"
INTERRUPTED = 130
PR_SET_PDEATHSIG = 1

READ_CPU_S = 600
"""Processor time for reading and translating a stage; 2 million prims, the most that are composed, take 40 s to
open.
"""

READ_WALL_S = 3600
"""Wall time for the same, against a file system that does not answer."""

FOREIGN = ("PXR_PLUGINPATH_NAME", "PXR_AR_DEFAULT_SEARCH_PATH")
"""Variables by which USD would load other people's plugins and look for files elsewhere; the child does not see
them.
"""


def is_worker() -> bool:
    """Whether this process is the child."""
    return MARK in os.environ


def follow_parent() -> None:
    """In the child: end when the parent ends, however it ends (Linux; elsewhere the output lock tells)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != int(os.environ[MARK]):
            os._exit(INTERRUPTED)


@contextlib.contextmanager
def reading_limits() -> Iterator[None]:
    """In the child, while a stage is read or translated: memory of this machine, and bounded time; as before
    afterwards, because rendering may take long.

    Beyond them the process dies of a signal or raises MemoryError, and the parent says so.
    """
    spent = resource.getrusage(resource.RUSAGE_SELF)
    cpu_s = int(spent.ru_utime + spent.ru_stime) + READ_CPU_S
    page = resource.getpagesize()
    memory = os.sysconf("SC_PHYS_PAGES") * page
    with contextlib.suppress(
        OSError
    ):  # address space that is only reserved counts too: some 1.5 GB for libraries and threads' stacks
        memory += int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * page
    before = {}
    for kind, wanted in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, cpu_s), (resource.RLIMIT_CORE, 0)):
        soft, hard = before[kind] = resource.getrlimit(kind)
        lower = [limit for limit in (wanted, soft, hard) if limit != resource.RLIM_INFINITY]
        resource.setrlimit(kind, (min(lower), hard))
    signal.alarm(READ_WALL_S)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", RuntimeWarning
            )  # numbers that overflow in numpy: what comes of them is told as notes
            yield
    finally:
        signal.alarm(0)
        for kind, limits in before.items():
            resource.setrlimit(kind, limits)


def cause(code: int) -> str:
    """Why a child died, from minus its signal, in words for the user."""
    words = {
        signal.SIGKILL: "it was killed, most often because memory ran out",
        signal.SIGSEGV: "the USD library could not cope with the file: it is damaged, or too deep",
        signal.SIGABRT: "it ran out of memory, or a library gave up",
        signal.SIGBUS: "a file became shorter while it was read",
        signal.SIGXCPU: f"reading took more than {READ_CPU_S} s of processor time",
        signal.SIGALRM: f"reading took more than {READ_WALL_S} s",
    }
    return words.get(signal.Signals(-code), "it was ended from outside")


def run(arguments: Sequence[str]) -> int:
    """Run this command line again in a child process.

    Returns:
        its exit code, INTERRUPTED after Ctrl-C or SIGTERM, or minus the signal that it died of.
    """
    child = subprocess.Popen(
        [sys.executable, "-m", "synfog_usd.cli.main", *arguments],
        env={**{name: value for name, value in os.environ.items() if name not in FOREIGN}, MARK: str(os.getpid())},
        start_new_session=True,  # Ctrl-C reaches the parent alone
    )

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        return child.wait()
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        signal.signal(signal.SIGTERM, before)
        if child.poll() is None:
            child.kill()
            child.wait()

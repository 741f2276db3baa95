"""What differs between Linux, macOS and Windows: locks, limits, and a child that ends with its parent.

Takes folders, numbers and codes of processes; nothing else of the package asks which system it runs on to
do one of these.  What only one system has is imported where it is used.  Linux is what this is tested
on; macOS and Windows were written by their documentation.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from synfog_usd.base.errors import OutputError

LOCK = ".synfog-lock"
"""File that is locked where a folder cannot be."""

FAR_BYTE = 1 << 30

PR_SET_PDEATHSIG = 1

SYNCHRONIZE, INFINITE = 0x00100000, 0xFFFFFFFF
"""Rights to wait for a process, and how long (Windows, winnt.h and winbase.h)."""

LOOK_EVERY_S = 1.0
"""Between two looks of a watcher at what no signal tells."""

READ_CPU_S = 600
"""Processor time for reading and translating a stage; 2 million prims, the most that are composed, take 40 s to
open.
"""

READ_WALL_S = 3600
"""Wall time for the same, against a file system that does not answer."""

READ_BYTES = 2_700_000_000
"""Memory for the same, beside what is granted for the sizes of files, see `allow`: a damaged file of 2 kB may ask for
any amount.
"""

PER_BYTE = 32
"""Memory that is granted for each byte of a layer or model."""

OVER_CPU, OVER_WALL = -0x1FFFFFFF, -0x1FFFFFFE
"""Codes with which a watcher ends its process: NTSTATUS of severity error, made by a customer."""


def lock(handle: int, *, wait: bool = False) -> None:
    """Hold an open file for this process until it is closed; a killed process leaves no lock behind.

    By flock, else by msvcrt on a byte far beyond the end, since Windows keeps others from reading what is locked.

    Args:
        handle: descriptor, open for writing; on Linux and macOS a folder's will do.
        wait: until nobody else holds it.

    Raises:
        OSError: another holds it, and `wait` is off.
    """
    try:
        import fcntl
    except ImportError:
        import msvcrt

        mode = msvcrt.LK_NBLCK  # type: ignore[attr-defined]
        while True:
            try:
                os.lseek(handle, FAR_BYTE, os.SEEK_SET)
                msvcrt.locking(handle, mode, 1)  # type: ignore[attr-defined]
                return
            except OSError:
                if not wait:
                    raise
                time.sleep(LOOK_EVERY_S)
    fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


@contextlib.contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Hold a folder for this process.

    Raises:
        OutputError: it cannot be made, or another process holds it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if hasattr(os, "O_DIRECTORY"):
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        else:
            handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be used as output folder ({error.strerror})") from error
    try:
        try:
            lock(handle)
        except OSError as error:
            raise OutputError(
                f"{folder}: another bake is writing here; wait for it or choose another folder"
            ) from error
        yield
    finally:
        os.close(handle)
        with contextlib.suppress(OSError):
            (folder / LOCK).unlink(missing_ok=True)


def used() -> tuple[float, float]:
    """(processor time [s], most memory [MB]) of this process up to now; the memory is 0 where nobody tells it."""
    try:
        import resource
    except ImportError:
        return time.process_time(), 0.0
    spent = resource.getrusage(resource.RUSAGE_SELF)
    return spent.ru_utime + spent.ru_stime, spent.ru_maxrss / (1024 if sys.platform == "linux" else 2**20)


def follow(parent: int, code: int) -> None:
    """End this process with a code when its parent ends, however that ends.

    Linux sends a signal; elsewhere a thread waits for the parent (Windows) or looks who it is (macOS).

    Args:
        parent: its process's number.
        code: exit code.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(code)
        return
    gone = _waits_for if sys.platform == "win32" else _looks_for

    def watch() -> None:
        gone(parent)
        os._exit(code)

    threading.Thread(target=watch, daemon=True).start()


def _waits_for(parent: int) -> None:
    """Until a process has ended (Windows)."""
    system = ctypes.WinDLL("kernel32")  # type: ignore[attr-defined]
    system.OpenProcess.restype = ctypes.c_void_p
    handle = ctypes.c_void_p(system.OpenProcess(SYNCHRONIZE, False, parent))
    if handle.value:
        system.WaitForSingleObject(handle, INFINITE)


def _looks_for(parent: int) -> None:
    """Until another process is this one's parent."""
    while os.getppid() == parent:
        time.sleep(LOOK_EVERY_S)


class _Memory:
    """Writable memory that this process may come to while it reads (Linux); what is only reserved does not count."""

    def __init__(self) -> None:
        self.granted = 0
        self.held: int | None = None

    @contextlib.contextmanager
    def bounded(self) -> Iterator[None]:
        import resource

        if sys.platform != "linux":
            yield
            return
        before = resource.getrlimit(resource.RLIMIT_DATA)
        self.held = resource.getpagesize() * int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5])
        try:
            self.grant(0)
            yield
        finally:
            self.held = None
            resource.setrlimit(resource.RLIMIT_DATA, before)

    def grant(self, size: int) -> None:
        self.granted += size
        if self.held is None:
            return
        import resource

        machine = os.sysconf("SC_PHYS_PAGES") * resource.getpagesize()
        most = self.held + min(machine, READ_BYTES + self.granted)
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


_MEMORY = _Memory()


def allow(size: int) -> None:
    """Grant this process so many bytes more within `limits`, for what a file of known size honestly takes."""
    _MEMORY.grant(size)


@contextlib.contextmanager
def limits(*, cpu_s: float, wall_s: float) -> Iterator[None]:
    """Within it this process has bounded memory and time; afterwards as before.

    Memory is what it had, `READ_BYTES` and what `allow` grants, within that of this machine.  Beyond the limits it
    dies, of a signal or of OVER_CPU or OVER_WALL, or raises MemoryError.  Windows and macOS have no bound for memory
    but that of the system.

    Args:
        cpu_s: processor time from now [s].
        wall_s: wall time from now [s].
    """
    try:
        import resource
    except ImportError:
        with _watched(cpu_s, wall_s):
            yield
        return
    spent = resource.getrusage(resource.RUSAGE_SELF)
    pairs = [
        (resource.RLIMIT_CPU, int(spent.ru_utime + spent.ru_stime + cpu_s)),
        (resource.RLIMIT_CORE, 0),
    ]
    before = {}
    for kind, most in pairs:
        soft, hard = before[kind] = resource.getrlimit(kind)
        lower = [limit for limit in (most, soft, hard) if limit != resource.RLIM_INFINITY]
        with contextlib.suppress(ValueError, OSError):  # macOS refuses less than is in use
            resource.setrlimit(kind, (min(lower), hard))
    signal.alarm(int(wall_s))
    try:
        with _MEMORY.bounded():
            yield
    finally:
        signal.alarm(0)
        for kind, numbers in before.items():
            resource.setrlimit(kind, numbers)


@contextlib.contextmanager
def as_urgent_as_before() -> Iterator[None]:
    """What a library changes within it of how this thread is scheduled is undone: SVT-AV1 tries whether it may have
    Linux's real-time class, as root it may, and keeps it.  Threads that wait for each other, as those of BLAS do, then
    hardly go on.
    """
    if not hasattr(os, "sched_getscheduler"):
        yield
        return
    kind, urgency = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, kind, urgency)


def give_back() -> None:
    """Return freed memory to the system where the C library keeps it: glibc keeps pieces of up to 32 MB."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def free_memory() -> int:
    """Bytes that this machine has free or can free, within the limits of a container; 0 where nobody tells."""
    amounts = []
    with contextlib.suppress(OSError, ValueError, IndexError):
        rows = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines())
        amounts.append(1024 * int(rows.get("MemAvailable", "").split()[0]))
    with contextlib.suppress(OSError, ValueError):
        amounts.append(_free_in_container(Path("/sys/fs/cgroup")))
    if not amounts:
        with contextlib.suppress(ImportError):
            import psutil

            amounts.append(int(psutil.virtual_memory().available))
    return min(amounts, default=0)


def _free_in_container(folder: Path) -> int:
    """Bytes that a control group has left; what it keeps of files counts as free, since it gives that back.

    Raises:
        OSError, ValueError: there is no limit.
    """
    most, used = (int((folder / f"memory.{what}").read_text(encoding="ascii")) for what in ("max", "current"))
    rows = dict(line.split() for line in (folder / "memory.stat").read_text(encoding="ascii").splitlines())
    return max(most - used + sum(int(rows.get(name, 0)) for name in ("active_file", "inactive_file")), 0)


@contextlib.contextmanager
def _watched(cpu_s: float, wall_s: float) -> Iterator[None]:
    """The same limits on time by a thread that looks."""
    done = threading.Event()
    cpu_end, wall_end = time.process_time() + cpu_s, time.monotonic() + wall_s

    def watch() -> None:
        while not done.wait(min(LOOK_EVERY_S, cpu_s, wall_s)):
            if time.process_time() > cpu_end:
                os._exit(OVER_CPU)
            if time.monotonic() > wall_end:
                os._exit(OVER_WALL)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def apart() -> dict[str, Any]:
    """What to tell `subprocess.Popen` so that Ctrl-C reaches the parent alone."""
    if sys.platform == "win32":
        import subprocess

        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def died(code: int) -> int:
    """An exit code as it is; negative where a process did not end by itself: minus the signal, or Windows' NTSTATUS.

    127 is the dynamic loader's where it finds no memory to resolve a symbol.
    """
    if code == 127:
        return -signal.SIGABRT
    return code - (1 << 32) if code >= 1 << 31 else code


def cause(code: int) -> tuple[str, str]:
    """(of what, why) a process died, in words for the user.

    Args:
        code: negative, see `died`.
    """
    killed = "it was killed, most often because memory ran out"
    damaged = "the USD library could not cope with the file: it is damaged, or too deep"
    gave_up = "it ran out of memory, or a library gave up"
    slow = f"reading took more than {READ_WALL_S} s"
    signals = {
        "SIGKILL": killed,
        "SIGSEGV": damaged,
        "SIGABRT": gave_up,
        "SIGBUS": "a file became shorter while it was read",
        "SIGXCPU": f"it took more processor time than it may: {READ_CPU_S} s to read, or what the system allows",
        "SIGALRM": slow,
    }
    statuses = {
        0xC0000005: damaged,  # access violation
        0xC00000FD: damaged,  # stack overflow
        0xC0000017: gave_up,  # no memory
        0xC0000409: gave_up,  # abort() of the C runtime
        0xC0000006: signals["SIGBUS"],  # in-page error
        OVER_CPU & 0xFFFFFFFF: signals["SIGXCPU"],
        OVER_WALL & 0xFFFFFFFF: slow,
    }
    outside = "it was ended from outside"
    if code < -255:
        return f"status 0x{code & 0xFFFFFFFF:08X}", statuses.get(code & 0xFFFFFFFF, outside)
    names = {number: name for name in signals if (number := getattr(signal, name, None)) is not None}
    return f"signal {-code}", signals.get(names.get(-code, ""), outside)

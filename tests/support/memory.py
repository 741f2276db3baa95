"""What a call adds to this process's memory at its peak, whatever ran before it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from synfog_usd.base import system

T = TypeVar("T")


def at_peak(work: Callable[[], T]) -> tuple[T, int]:
    """(what `work` gives, KiB above the memory before it).

    `ru_maxrss` cannot say it: a test that ran before may have used more.  Linux takes the high-water mark back to
    the present where 5 is written to clear_refs (proc_pid_clear_refs(5)).  What the C library keeps of freed memory
    goes back first: `work` would take its own from there, and nothing would be seen.
    """
    system.give_back()
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    before = _high_water_kib()
    done = work()
    return done, _high_water_kib() - before


def _high_water_kib() -> int:
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text(encoding="ascii"))
    assert found
    return int(found[1])

"""A verb's work in a child process, so that stopping is quick and a crash is one line.

A renderer's kernel cannot be interrupted from Python, and a malformed stage can
take the USD library down with it.  The parent therefore only waits: on Ctrl-C it
ends the child at once, and it turns a child's death by signal into a message.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from types import FrameType

MARK = "SYNFOG_USD_WORKER"
INTERRUPTED = 130
PR_SET_PDEATHSIG = 1


def is_worker() -> bool:
    """Whether this process is the child."""
    return MARK in os.environ


def follow_parent() -> None:
    """In the child: end when the parent ends, however it ends (Linux; elsewhere the output lock tells)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != int(os.environ[MARK]):
            os._exit(INTERRUPTED)


def run(arguments: Sequence[str]) -> int:
    """Run this command line again in a child process.

    Returns:
        its exit code, INTERRUPTED after Ctrl-C or SIGTERM, or minus the signal that it died of.
    """
    child = subprocess.Popen(
        [sys.executable, "-m", "synfog_usd.cli.main", *arguments],
        env={**os.environ, MARK: str(os.getpid())},
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

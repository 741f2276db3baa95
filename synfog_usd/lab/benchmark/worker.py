"""A method's child, with limits: what crashes, hangs or answers nonsense costs one picture, not the run."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import queue
import signal
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import IO, Any

from synfog_usd.base import isolated
from synfog_usd.base.errors import SynfogError
from synfog_usd.lab.benchmark.child import as_line, threads
from synfog_usd.lab.benchmark.methods import Method


class MethodError(SynfogError):
    """One picture got no answer; the message says why."""


class MethodWorker:
    """Asks a child for one picture after the other, and starts another child when it dies.

    Args:
        method: what it does.
        folder: for answers, and no other worker's; a temporary one.
    """

    def __init__(self, method: Method, folder: Path) -> None:
        self.method, self.folder = method, folder
        self._child: subprocess.Popen[str] | None = None
        self._told: Any = None
        self._answers: queue.Queue[str] = queue.Queue()
        self._numbers = itertools.count()

    def ask(self, picture: Path, **others: Path) -> Path:
        """The file with the method's answer to a picture; whoever asked takes it away.

        Args:
            picture: its file.
            others: further words for the child.

        Raises:
            MethodError: it died, took too long, or answered nothing that can be used.
        """
        answer = self.folder / f"{self.method.version}-{next(self._numbers)}{self.method.suffix}"
        task = {"in": str(picture.resolve()), "out": str(answer), **{word: str(path) for word, path in others.items()}}
        child = self._started()
        assert child.stdin is not None
        try:
            child.stdin.write(json.dumps(task) + "\n")
            child.stdin.flush()
        except OSError:
            raise MethodError(self._death(child)) from None
        try:
            line = self._answers.get(timeout=self.method.timeout_s)
        except queue.Empty:
            self.close()
            raise MethodError(f"gave no answer within {self.method.timeout_s:g} s") from None
        if not line:
            raise MethodError(self._death(child))
        reply = json.loads(line)
        if "error" in reply:
            raise MethodError(reply["error"])
        return answer

    def close(self) -> None:
        """End the child, and whatever it started."""
        child, self._child = self._child, None
        if child is not None and child.stdin is not None:
            with contextlib.suppress(OSError):
                if hasattr(os, "killpg"):
                    os.killpg(child.pid, signal.SIGKILL)
                child.kill()
            child.wait()
            with contextlib.suppress(OSError):
                child.stdin.close()
            self._told.close()

    def _started(self) -> subprocess.Popen[str]:
        if self._child is None or self._child.poll() is not None:
            self.close()
            self._told = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115  (closed with the child)
            self._child = subprocess.Popen(
                isolated.command("synfog_usd.lab.benchmark.child"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._told,
                text=True,
                start_new_session=True,
                env={"OMP_NUM_THREADS": str(threads(self.method)), **isolated.environment()},
            )
            assert self._child.stdin is not None and self._child.stdout is not None
            self._answers = queue.Queue()
            threading.Thread(target=_follow, args=(self._child.stdout, self._answers), daemon=True).start()
            self._child.stdin.write(as_line(self.method))
        return self._child

    def _death(self, child: subprocess.Popen[str]) -> str:
        code = child.wait()
        self._told.seek(0)
        lines = self._told.read().strip().splitlines()
        self.close()
        how = f"died of signal {-code}" if code < 0 else f"ended with {code}"
        return f"{how}{': ' + lines[-1][:200] if lines else ''}"


def _follow(stream: IO[str], answers: queue.Queue[str]) -> None:
    """Hand on a child's lines, and '' at their end."""
    with stream:
        for line in stream:
            answers.put(line)
    answers.put("")

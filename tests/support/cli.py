"""The command line in this process, and in one of its own.

A process of its own costs a second of imports before it does anything.  So what a verb says and writes is asked
here, of the code that runs in the child that reads and renders; that a parent waits for the child, passes its exit
code on and ends it is asked of real processes, by `process`.
"""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from synfog_usd.cli import worker
from synfog_usd.cli.main import main


def command(*arguments: object) -> list[str]:
    """The words that start the command line in a process of its own."""
    return [sys.executable, "-m", "synfog_usd.cli.main", *map(str, arguments)]


def process(*arguments: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own, to its end; `more` is for `subprocess.run`."""
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=300, **more)


def study(name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """`python -m docs.studies.<name>` in the project's folder, to its end."""
    words = [sys.executable, "-m", f"docs.studies.{name}", *map(str, arguments)]
    root = Path(__file__).resolve().parents[2]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, cwd=root)


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command line in this process, as in the child that does the work: exit code, standard output and error.

    What libraries write to the file descriptors themselves is in it too.
    """
    words = list(map(str, arguments))
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        patch.setenv(worker.MARK, str(os.getppid()))
        patch.setattr(worker, "follow_parent", lambda: None)
        patch.setattr(sys, "argv", ["synfog-usd", *words])
        if cwd is not None:
            patch.chdir(cwd)
        with _sent_to("stdout", 1, out), _sent_to("stderr", 2, err):
            try:
                main(words)
                code: Any = 0
            except SystemExit as end:
                code = end.code or 0
        told = [file.seek(0) or file.read().decode() for file in (out, err)]
    return subprocess.CompletedProcess(words, code, *told)


@contextlib.contextmanager
def _sent_to(name: str, descriptor: int, file: BinaryIO) -> Iterator[None]:
    """Python's stream of this name, and the descriptor that libraries write to, go to `file`."""
    before, kept = getattr(sys, name), os.dup(descriptor)
    before.flush()
    os.dup2(file.fileno(), descriptor)
    stream = io.TextIOWrapper(os.fdopen(os.dup(descriptor), "wb", buffering=0), encoding="utf-8", write_through=True)
    setattr(sys, name, stream)
    try:
        yield
    finally:
        setattr(sys, name, before)
        stream.close()
        os.dup2(kept, descriptor)
        os.close(kept)

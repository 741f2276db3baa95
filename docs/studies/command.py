"""How a study is called from a shell: its function's parameters are its options, an error is one line."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from synfog_usd.base.errors import OutputError, SynfogError

Out = Annotated[Path, typer.Option("--out", "-o", help="Folder for what is written.")]


def run(verb: Callable[..., Any]) -> None:
    """Call `verb` with what the command line gives; exit code 2 after an error."""
    try:
        typer.run(verb)
    except SynfogError as error:
        print(f"studies: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


def writable(out: Path) -> None:
    """Refuse a path that cannot become a folder, before minutes of work.

    Raises:
        OutputError: a file stands there, or nothing can be written there.
    """
    existing = next((path for path in (out, *out.absolute().parents) if path.exists()), out)
    if not existing.is_dir():
        raise OutputError(f"--out {out}: {existing} is a file; give a folder")
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise OutputError(
            f"--out {out}: {existing} cannot be written ({error.strerror}); choose another folder"
        ) from None

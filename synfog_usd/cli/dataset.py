"""`synfog-usd dataset`: sets of shots, as verbs.  Parses; each verb's work is in a module that it imports itself."""

from __future__ import annotations

import typer

app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Sets of shots: planned, made, checked and exported."
)

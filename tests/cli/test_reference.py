"""The page of the command line: fresh, and with every option that the program takes."""

from __future__ import annotations

from pathlib import Path

import typer

from synfog_usd.cli import api, reference
from synfog_usd.cli.main import app

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_is_fresh():
    """Made again by `python -m synfog_usd.cli.reference > docs/reference/cli.md`."""
    written = (ROOT / "docs/reference/cli.md").read_text(encoding="utf-8")
    assert written == reference.page(), "run: python -m synfog_usd.cli.reference > docs/reference/cli.md"


def test_the_page_of_python_is_fresh():
    """Made again by `python -m synfog_usd.cli.api > docs/reference/api.md`."""
    written = (ROOT / "docs/reference/api.md").read_text(encoding="utf-8")
    assert written == api.page(), "run: python -m synfog_usd.cli.api > docs/reference/api.md"
    for word in ("radiance", "sf.load(", "sf.SynfogError", "kept", "cd m-2"):
        assert word in written


def test_every_option_says_what_it_means():
    """An option without a line of help is a hole in the page."""
    mute = []
    for name, command in reference._commands(typer.main.get_group(app), "synfog-usd"):
        mute += [
            f"{name} {parameter.name}"
            for parameter in command.params
            if parameter.name != "help" and not parameter.help
        ]
        assert command.help, name
    assert not mute

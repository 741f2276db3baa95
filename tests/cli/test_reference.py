"""Pages and schemas that are made from the program: fresh, and with every option that it takes."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer

from docs import pages
from docs.pages import commands
from synfog_usd.cli.main import app

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name, text", pages.every().items(), ids=pages.every())
def test_a_page_is_fresh(name, text):
    """Made again by `python -m docs.pages`."""
    assert (ROOT / name).read_text(encoding="utf-8") == text, "run: python -m docs.pages"


def test_every_option_says_what_it_means():
    """An option without a line of help is a hole in the page."""
    mute = []
    for name, command in commands._commands(typer.main.get_group(app), "synfog-usd"):
        mute += [f"{name} {one.name}" for one in command.params if one.name != "help" and not one.help]
        assert command.help, name
    assert not mute

"""Sheets of previews: seeds are read, recipes go round, and the picture holds what was asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support import cli

from synfog_usd.base.errors import ParameterError
from synfog_usd.dataset import sheet

RECIPES = Path(__file__).resolve().parents[2] / "stages" / "recipes"


def test_seeds_are_numbers_and_ranges():
    """Both ends of a range are in it, and order is kept."""
    assert sheet.seeds_of("0-15") == tuple(range(16))
    assert sheet.seeds_of("7, 3,9-11") == (7, 3, 9, 10, 11)


@pytest.mark.parametrize("text", ["", "a", "3-", "-3", "9-3", "0-64", "1,,2", "0-9999999999"])
def test_other_seeds_are_refused(text):
    """In one line that shows the form; a range of a thousand million ends at once too."""
    with pytest.raises(ParameterError, match="--seeds"):
        sheet.seeds_of(text)


@pytest.mark.parametrize("options, words", [
    (["--seeds", "x"], "--seeds x"),
    (["-o", "sheet.jpg"], ".png"),
    (["--lighting", "night"], "sky and active"),
    (["--change", "a=1"], "SECTION.KEY=VALUE"),
])  # fmt: skip
def test_the_command_refuses_in_one_line(tmp_path, options, words):
    """Exit code 2, and nothing written."""
    asked = options if "-o" in options else [*options, "-o", str(tmp_path / "sheet.png")]
    done = cli.run("contact", RECIPES / "tunnel.yaml", *asked, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr and len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.physics
def test_fog_takes_contrast_from_a_preview(tmp_path):
    """One seed, clear and in dense fog, side by side at the asked size: the foggy half has less contrast."""
    out = tmp_path / "sheet.png"
    small = ["--resolution", "96x54", "--samples", "4", "--quiet"]
    done = cli.run("contact", RECIPES / "tunnel.yaml", "-o", out, "--seeds", "2", "--fog", "clear,mor50", *small)
    assert done.returncode == 0, done.stderr
    with Image.open(out) as picture:
        assert picture.size == (2 * sheet.GAP_PX + 192, 54 + sheet.CAPTION_PX + 2 * sheet.GAP_PX)
        pixels = np.asarray(picture.convert("L"), dtype=np.float64)[
            sheet.GAP_PX : sheet.GAP_PX + 54, sheet.GAP_PX : sheet.GAP_PX + 192
        ]
    assert pixels[:, 96:].std() < 0.8 * pixels[:, :96].std()

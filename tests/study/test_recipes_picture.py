"""The sheet of recipes side by side."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from synfog_usd.base.errors import ParameterError
from synfog_usd.lab.study.pages import recipes


def test_the_sheet_shows_all_pictures_by_name_in_rows_of_two(tmp_path):
    """Three greys: the third stands alone in the second row."""
    for name, grey in (("c", 200), ("a", 40), ("b", 120)):
        Image.new("RGB", (320, 180), (grey, grey, grey)).save(tmp_path / f"{name}.png")
    recipes.sheet(tmp_path / "sheet.jpg", tmp_path)
    drawn = np.asarray(Image.open(tmp_path / "sheet.jpg"), dtype=float)
    assert drawn.shape == (2 * (450 + 18), 2 * 800 + 4, 3)
    assert drawn[20:430, 20:780].mean() == pytest.approx(40, abs=2)
    assert drawn[20:430, 824:1584].mean() == pytest.approx(120, abs=2)
    assert drawn[488:898, 20:780].mean() == pytest.approx(200, abs=2)
    assert drawn[488:898, 824:1584].mean() == pytest.approx(25, abs=2)
    (tmp_path / "none").mkdir()
    with pytest.raises(ParameterError, match="no picture"):
        recipes.sheet(tmp_path / "none.jpg", tmp_path / "none")

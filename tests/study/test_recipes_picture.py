"""The sheet of recipes before and after a change."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from synfog_usd.errors import ParameterError
from synfog_usd.study.pages import recipes


def test_the_sheet_pairs_pictures_by_name(tmp_path):
    """What lies in one folder only is left out; the left half shows `before`, the right half `after`."""
    for folder, names, grey in (("before", ("a", "b"), 40), ("after", ("b", "c", "d"), 200)):
        (tmp_path / folder).mkdir()
        for name in names:
            Image.new("RGB", (320, 180), (grey, grey, grey)).save(tmp_path / folder / f"{name}.png")
    recipes.sheet(tmp_path / "sheet.jpg", tmp_path / "before", tmp_path / "after")
    drawn = np.asarray(Image.open(tmp_path / "sheet.jpg"), dtype=float)
    assert drawn.shape == (360 + 18, 2 * 640 + 4, 3)
    assert drawn[20:340, 20:620].mean() == pytest.approx(40, abs=2)
    assert drawn[20:340, 664:1264].mean() == pytest.approx(200, abs=2)
    with pytest.raises(ParameterError, match="no picture of one name"):
        recipes.sheet(tmp_path / "none.jpg", tmp_path / "before", tmp_path)

"""The cards of the picture of spectra."""

import numpy as np
import pytest

from synfog_usd.lab.study.pages import spectra


def test_daylight_shows_the_cards_alike_in_r_g_and_b_and_in_bands_and_sodium_does_not():
    """Within 1 % of white under D65; red paint under HP1 is more than half too bright in R, G and B."""
    daylight, sodium = ([spectra.cards(lamp, count) for count in (3, 31)] for lamp in ("D65", "HP1"))
    np.testing.assert_allclose(daylight[0], daylight[1], atol=0.01)
    np.testing.assert_allclose(daylight[0], [rgb for _, rgb in spectra.CARDS.values()], atol=0.01)
    red = list(spectra.CARDS).index("red paint")
    assert sodium[0][red, 0] > 1.5 * sodium[1][red, 0]


@pytest.mark.physics
def test_the_picture_is_drawn_the_same_each_time(tmp_path):
    for name in ("one.png", "two.png"):
        spectra.draw(tmp_path / name)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()

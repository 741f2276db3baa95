"""An airlight that is guessed from a picture, on pictures whose answer is seen at once."""

import numpy as np

from synfog_usd.fog.airlight import PATCH_PX, dark_channel, estimated_airlight


def test_the_estimated_airlight_is_a_sky_that_is_seen_and_never_a_lamp():
    """Of a flat sky its colour; a white pixel in it has a dark square around it and is passed over."""
    clear = np.full((60, 80, 3), 0.1)
    clear[:30] = [0.5, 0.8, 1.2]
    clear[50, 40] = 100.0
    t = np.full((60, 80, 1), 0.4)
    t[:30] = 0.0
    np.testing.assert_allclose(estimated_airlight(clear, t), [0.5, 0.8, 1.2], rtol=1e-12)


def test_the_dark_channel_is_the_least_of_a_square():
    """One dark pixel in one channel darkens the 15 x 15 pixels around it, fewer at the border."""
    clear = np.ones((40, 40, 3))
    clear[20, 3, 1] = 0.25
    dark = dark_channel(clear)
    assert (dark == 0.25).sum() == PATCH_PX * (3 + 1 + PATCH_PX // 2)
    assert set(np.unique(dark)) == {0.25, 1.0}

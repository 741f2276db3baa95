"""Polygons of regions, painted again by Pillow and filled by SciPy."""

import numpy as np
import pytest
from PIL import Image, ImageDraw
from scipy import ndimage

from synfog_usd.dataset.exports.outlines import outlines

RNG = np.random.default_rng(5)


def painted(shape, found):
    picture = Image.new("I", shape[::-1], -1)
    for one in found:
        points = [tuple(point) for point in one.points.tolist()]
        ImageDraw.Draw(picture).polygon(points + [points[-1]] * (3 - len(points)), fill=one.value)
    return np.array(picture)


@pytest.mark.parametrize("shape", [(1, 9), (40, 60)])
@pytest.mark.parametrize("smooth_px", [0.0, 4.0])
def test_painted_in_their_order_they_give_the_picture(shape, smooth_px):
    """Noise of single pixels, and blotches with holes and arms."""
    values = np.digitize(ndimage.gaussian_filter(RNG.normal(size=shape), smooth_px, mode="wrap"), [-0.1, 0.0, 0.05])
    found = outlines(values)
    np.testing.assert_array_equal(painted(shape, found), values)
    count = sum(ndimage.label(values == value)[1] for value in np.unique(values))
    assert len(found) == count

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


def test_the_area_is_that_with_holes_filled():
    """A ring without a corner, by which it encloses nothing; a whole ring, and what lies in it."""
    values = np.zeros((12, 14), dtype=int)
    values[1:11, 2:12], values[2:10, 3:11] = 1, 2
    values[4:8, 5:9], values[5:7, 6:8] = 1, 3
    values[1, 2] = 0
    areas = sorted((one.value, one.area) for one in outlines(values))
    assert areas == [(0, 12 * 14), (1, 16), (1, 35), (2, 64), (3, 4)]

"""How arrays are gone through, against what numpy makes of them."""

import numpy as np
import pytest

from synfog_usd.base.arrays import at_least, at_most, distinct, extent


@pytest.mark.parametrize("shape", [(0,), (1,), (5000,), (70, 3)])
def test_distinct_numbers_are_those_of_numpy(shape):
    """None, one and many, with doubles; of any shape."""
    numbers = np.random.default_rng(0).integers(-400, 400, size=shape)
    np.testing.assert_array_equal(distinct(numbers), np.unique(numbers))


def test_limits_are_those_of_numpy():
    """Infinities and a zero among them."""
    values = np.array([-np.inf, -1.0, 0.0, 0.5, np.inf], dtype=np.float32)
    np.testing.assert_array_equal(at_least(values, 0.25), np.maximum(values, np.float32(0.25)))
    np.testing.assert_array_equal(at_most(values, 0.25), np.minimum(values, np.float32(0.25)))


def test_the_extent_of_clouds_is_that_of_all_their_points():
    """One cloud and several, of one type and of two, a single point among them."""
    random = np.random.default_rng(0)
    clouds = [random.normal(size=(1000, 3)), random.normal(3.0, size=(50, 3)).astype(np.float32), np.full((1, 3), -9.0)]
    for some in (clouds[:1], clouds):
        low, high = extent(*some)
        points = np.concatenate(some)
        np.testing.assert_array_equal(low, points.min(axis=0))
        np.testing.assert_array_equal(high, points.max(axis=0))

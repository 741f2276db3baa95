"""How arrays are gone through, against what numpy makes of them."""

import numpy as np
import pytest

from synfog_usd.arrays import at_least, at_most, distinct


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

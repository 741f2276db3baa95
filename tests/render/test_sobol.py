"""Sobol's points by hash: even where theory says so, uniform to a chi-square, and scramblings that know nothing of each
other.
"""

import drjit as dr
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from synfog_usd.render.sampling.sobol import RUN, Sobol, point, second

ALPHA = 1e-4


def points(mi, count, key, first=0):
    """(count, 2) of one key's sequence."""
    return np.array(point(dr.arange(mi.UInt32, count) + first, mi.UInt32(key)), dtype=np.float64).T


def boxes(x, rows, columns):
    """(rows * columns,) points in each of equal boxes."""
    return np.bincount(
        (x[:, 0] * rows).astype(int) * columns + (x[:, 1] * columns).astype(int), minlength=rows * columns
    )


def test_unscrambled_points_are_those_of_scipy(mi):
    """The first two dimensions of Sobol's sequence; scipy's order is Gray's, which keeps the first 2^m points
    together.
    """
    index = dr.arange(mi.UInt32, 256)
    ours = np.stack([np.array(dr.brev(index)), np.array(second(index))], axis=1) / 2.0**32
    theirs = qmc.Sobol(2, scramble=False, bits=30).random(256)
    for count in (2, 16, 256):
        np.testing.assert_array_equal(
            np.sort(ours[:count].view("f8,f8").ravel()), np.sort(theirs[:count].view("f8,f8").ravel())
        )


@pytest.mark.parametrize("power", [1, 4, 8])
def test_every_run_of_a_power_of_two_fills_every_box_once(mi, power, key=0xDEADBEEF):
    """A (0, m, 2)-net in base 2: 2^m samples from a multiple of 2^m on, in 2^m boxes of every shape."""
    count = 2**power
    for first in (0, count, 37 * count):
        x = points(mi, count, key, first)
        for rows in (2**k for k in range(power + 1)):
            assert (boxes(x, rows, count // rows) == 1).all(), f"{first}, {rows} x {count // rows}"


def points_over_keys(mi, count, number, dimension=1):
    """(count, 2): the point that sample `number` of each of `count` pixels draws as its `dimension`-th."""
    sampler = Sobol(7, dr.arange(mi.UInt32, count), mi.UInt32(number))
    for _ in range(dimension - 1):
        sampler.next_2d()
    return np.array(sampler.next_2d(), dtype=np.float64).T


@pytest.mark.parametrize("pair", ["dimensions", "runs", "pixels", "seeds"])
def test_what_should_be_independent_is(mi, pair):
    """Pairs of coordinates in 24 x 24 boxes over 2^18 pixels against independence; it sees a correlation of 0.01 (z =
    5).
    """
    count = 1 << 18
    pixel = dr.arange(mi.UInt32, count)
    one = np.array(Sobol(7, pixel, mi.UInt32(3)).next_2d(), dtype=np.float64).T
    if pair == "dimensions":
        other = points_over_keys(mi, count, 3, 2)
    elif pair == "runs":
        other = np.array(Sobol(7, pixel, mi.UInt32(3 + RUN)).next_2d(), dtype=np.float64).T
    elif pair == "pixels":
        other = np.array(Sobol(7, pixel + 1, mi.UInt32(3)).next_2d(), dtype=np.float64).T
    else:
        other = np.array(Sobol(8, pixel, mi.UInt32(3)).next_2d(), dtype=np.float64).T
    for a in range(2):
        for b in range(2):
            table = boxes(np.stack([one[:, a], other[:, b]], axis=1), 24, 24).reshape(24, 24)
            assert stats.chi2_contingency(table).pvalue > ALPHA, f"{a}, {b}"
            assert abs(np.corrcoef(one[:, a], other[:, b])[0, 1]) < 4.0 / np.sqrt(count)

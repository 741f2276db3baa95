"""Drops in the air against the distributions and fall speeds that they are drawn from."""

import math

import numpy as np
import pytest
from scipy.special import gammainc

from synfog_usd.fog.drops import PICTURE, extinction, rain_sizes, snow_sizes
from synfog_usd.fog.falling import NEAR_M, Cone, SizeClasses, falling

ALL_ROUND = Cone(np.array([3.0, -5.0, 1.5]), np.array([0.0, 1.0, 0.0]), math.pi)
STILL = np.zeros(3)


def around(sizes, view=ALL_ROUND, reach_m=4.0, time_s=0.0, seed=1):
    return falling(sizes, np.full(len(sizes.per_m3), reach_m), view, time_s=time_s, wind_m_s=STILL, seed=seed)


def test_counts_by_size_are_the_distribution():
    """Between D and D' there are N0 (exp(-L D) - exp(-L D')) / L drops in a cubic metre (Marshall and Palmer 1948)."""
    rate, volume = 10.0, 4.0 / 3.0 * math.pi * (4.0**3 - NEAR_M**3)
    slope = 4.1 * rate**-0.21
    diameters = 1e3 * np.concatenate(
        [around(SizeClasses.of_rain(rain_sizes(rate)), seed=seed).diameter_m for seed in range(4)]
    )
    for low, high in ((0.1, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 6.0)):
        wanted = 4 * volume * 8000.0 / slope * (math.exp(-slope * low) - math.exp(-slope * high))
        count = ((diameters > low) & (diameters < high)).sum()
        assert abs(count / wanted - 1.0) < 0.02 / 4 + 4.0 / math.sqrt(wanted)  # 0.5 % of edges within classes


BELOW_10_MM = gammainc(4.0, 2.29 * 2.0**-0.45 * (0.17 * 10.0**2) ** (1.0 / 3.0))


@pytest.mark.parametrize(
    ("sizes", "extinction"),
    [
        (SizeClasses.of_rain(rain_sizes(10.0)), extinction("rain", rain_sizes(10.0), PICTURE)),
        (SizeClasses.of_snow(snow_sizes(2.0)), BELOW_10_MM * extinction("snow", snow_sizes(2.0), PICTURE)),
    ],
)
def test_what_drops_cover_is_the_mediums_extinction(sizes, extinction):
    """Number times cross-section of all classes is the closed form, but for drops below 0.1 and above 6 mm; of flakes
    up to 10 mm it has the share of Sekhon and Srivastava's exponential, an incomplete gamma function.
    """
    assert float(sizes.per_m3 @ sizes.area_m2) == pytest.approx(extinction, rel=0.01)
    deep = sizes.optical_depth(np.full(len(sizes.per_m3), 5.0), np.array([0.1, 3.0, np.inf]))
    np.testing.assert_allclose(deep, extinction * np.array([0.0, 3.0 - NEAR_M, 5.0 - NEAR_M]), rtol=0.01)


def test_drops_fall_as_gunn_and_kinzer_measured():
    """4.03, 6.49, 8.06 and 9.09 m/s for 1, 2, 3 and 5 mm (Gunn and Kinzer 1949), from one moment to the next."""
    sizes, step_s = SizeClasses.of_rain(rain_sizes(100.0)), 0.02
    before, after = around(sizes), around(sizes, time_s=step_s)
    same, left, right = np.intersect1d(before.diameter_m, after.diameter_m, return_indices=True)
    way = after.place_m[right] - before.place_m[left]
    inside = np.abs(way[:, 2]) < 1.0  # not from the lower face of its cube to the upper one
    fallen = -way[inside, 2] / step_s
    np.testing.assert_allclose(way[inside, :2], 0.0, atol=1e-9)
    assert inside.sum() > 1e5  # of 1.2 million
    for diameter_mm, speed in ((1.0, 4.03), (2.0, 6.49), (3.0, 8.06), (5.0, 9.09)):
        near = np.abs(1e3 * same[inside] - diameter_mm) < 0.05
        assert fallen[near].mean() == pytest.approx(speed, rel=0.02)


def test_two_cameras_and_two_moments_see_the_same_drops():
    """What both of a pair see, they see in the same place on the stage; and flakes go on along their ways."""
    sizes = SizeClasses.of_snow(snow_sizes(2.0))
    left = Cone(np.array([0.0, 0.0, 1.5]), np.array([0.0, 1.0, 0.0]), 0.6)
    right = Cone(np.array([0.3, 0.0, 1.5]), np.array([0.0, 1.0, 0.0]), 0.6)
    one, other = around(sizes, left), around(sizes, right)
    _, first, second = np.intersect1d(one.diameter_m, other.diameter_m, return_indices=True)
    assert len(first) > 0.7 * len(one.diameter_m)
    apart = one.place_m[first] + left.eye_m - other.place_m[second] - right.eye_m
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)
    later = around(sizes, left, time_s=1e-4)
    _, first, second = np.intersect1d(one.diameter_m, later.diameter_m, return_indices=True)
    way = later.place_m[second] - one.place_m[first]
    stays = np.abs(way).max(axis=1) < 0.1
    np.testing.assert_allclose(way[stays], 1e-4 * one.velocity_m_s[first][stays], atol=1e-7)


def test_a_view_holds_all_that_it_sees():
    """What a narrow view has of drops is what a camera that sees all around has there, in number."""
    sizes = SizeClasses.of_rain(rain_sizes(100.0))
    view = Cone(np.zeros(3), np.array([0.6, 0.8, 0.0]), 0.5)
    place = around(sizes, view).place_m
    inside = place @ view.axis > math.cos(0.5) * np.linalg.norm(place, axis=1)
    wanted = sizes.per_m3.sum() * 2.0 / 3.0 * math.pi * (1.0 - math.cos(0.5)) * (4.0**3 - NEAR_M**3)
    assert inside.sum() == pytest.approx(wanted, abs=4.0 * math.sqrt(wanted))
    assert inside.sum() < len(inside)

"""Streaks of drops against what a drop covers, moment by moment and row by row."""

import math

import numpy as np
import pytest

from synfog_usd.camera.streaks import Shutter, Streaks, depth_of

SKY = np.full((120, 80), np.inf, np.float32)


def one(place=(40.0, 60.0), speed=(0.0, 0.0), width=0.5, blur=0.0, distance=5.0, flat=1.0, turn=0.0):
    area = flat * math.pi / 4 * width**2
    values = (np.array([value], dtype=float) for value in (place, speed, area, width, turn, blur, distance))
    return Streaks(*values, np.zeros((1, 0)))


def cover(streaks, shutter, distance=SKY):
    return 1.0 - np.exp(-depth_of(streaks, shutter, distance)[:, :, 0].astype(float))


def test_a_streak_is_as_long_as_exposure_times_speed():
    """A drop of 0.5 px that goes 40 px in the exposure covers its area spread over 40 rows, whatever its slant."""
    for speed in ((0.0, 2000.0), (800.0, 1833.0303)):
        covered = cover(one(speed=speed), Shutter(0.02))
        assert covered.sum() == pytest.approx(math.pi / 16, rel=0.005)
        rows = np.arange(120) + 0.5
        weight = covered.sum(axis=1) / covered.sum()
        spread = math.sqrt(weight @ (rows - 60.0) ** 2 * 12)
        assert spread == pytest.approx(speed[1] * 0.02, rel=0.02)  # of an even streak
        assert weight @ rows == pytest.approx(60.0, abs=0.1)


def test_an_opaque_flake_hides_what_is_behind_it_and_a_blur_lets_it_through():
    """A still disc of 16 px covers all of its middle; out of focus over 32 px it covers a quarter around the middle,
    falls off from 8 px to 24 px, and half of it is left where a straight edge of the wide disc would be, about.
    """
    sharp = cover(one(width=16.0), Shutter(0.01))
    assert sharp[56:64, 36:44].min() > 0.9
    blurred = cover(one(width=16.0, blur=32.0), Shutter(0.01))
    assert blurred.sum() == pytest.approx(math.pi / 4 * 16.0**2, rel=0.01)
    rows, columns = np.mgrid[:120, :80] + 0.5
    away = np.hypot(columns - 40.0, rows - 60.0)
    fine = (np.arange(-8, 8, 0.05) + 0.025)[:, None] * 1j + np.arange(-8, 8, 0.05) + 0.025
    fine = fine[np.abs(fine) < 8.0]
    for low, high in ((0, 6), (10, 14), (15, 17), (20, 23), (25, 40)):
        here = (away > low) & (away < high)
        wanted = np.mean([(np.abs(fine - far) < 16.0).mean() / 4.0 for far in away[here]])
        assert blurred[here].mean() == pytest.approx(wanted, abs=0.008)


def test_a_flake_that_turned_its_edge_is_an_ellipse():
    """Of 24 by 12 px, its longer axis 30 degrees from the rows down: variances a^2 / 16 along its axes, within 2 %."""
    covered = cover(one(width=24.0, flat=0.5, turn=math.pi / 6), Shutter(0.01))
    assert covered.sum() == pytest.approx(math.pi / 4 * 24.0 * 12.0, rel=0.01)
    rows, columns = np.mgrid[:120, :80] + 0.5
    along = np.exp(-1j * math.pi / 6) * (columns - 40.0 + 1j * (rows - 60.0))
    for axis, wide in ((along.real, 24.0), (along.imag, 12.0)):
        variance = (covered * axis**2).sum() / covered.sum() - 1.0 / 6.0  # of a point that four pixels share
        assert variance == pytest.approx(wide**2 / 16.0, rel=0.02)


def test_what_is_nearer_hides_a_drop():
    """Behind a wall at 4 m that fills the left half, a drop at 5 m is not seen; before one at 6 m it is."""
    wall = SKY.copy()
    wall[:, :40] = 4.0
    covered = cover(one(width=8.0), Shutter(0.01), wall)
    assert covered[:, :40].max() == 0.0
    assert covered[:, 40:].sum() == pytest.approx(math.pi / 8 * 64, rel=0.03)
    wall[:, :40] = 6.0
    assert cover(one(width=8.0), Shutter(0.01), wall).sum() == pytest.approx(math.pi / 4 * 64, rel=0.01)


def test_rows_that_are_read_later_see_the_drop_later():
    """Row by row: a row exposes from its own begin on, and is covered while the drop crosses it."""
    shutter, speed, place = Shutter(0.01, readout_s=0.008), 3000.0, 30.0
    covered = cover(one(place=(40.0, place), speed=(0.0, speed), width=0.3), shutter).sum(axis=1)
    wanted = np.zeros(120)
    for row in range(120):
        begin = shutter.readout_s * ((row + 0.5) / 120 - 0.5) - 0.5 * shutter.exposure_s
        times = begin + shutter.exposure_s * (np.arange(4000) + 0.5) / 4000
        wanted[row] = (np.floor(place + speed * times) == row).mean()
    wanted *= math.pi / 4 * 0.3**2
    assert covered.sum() == pytest.approx(wanted.sum(), rel=0.02)
    rows = np.arange(120)
    assert rows @ covered / covered.sum() == pytest.approx(rows @ wanted / wanted.sum(), abs=0.3)


def test_parts_of_an_exposure_make_up_the_whole():
    """What is covered in the first 30 % and in the rest, by their lengths, is what is covered in all."""
    drop = one(speed=(100.0, 2000.0))
    whole = cover(drop, Shutter(0.02)).sum(axis=1)
    early, late = (cover(drop, Shutter(0.02, part=part)).sum(axis=1) for part in ((0.0, 0.3), (0.3, 1.0)))
    np.testing.assert_allclose(0.3 * early + 0.7 * late, whole, atol=0.05 * whole.max())
    assert early[60:].sum() == 0.0


@pytest.mark.parametrize(
    ("width", "blur", "depth", "seeds"), [(0.2, 0.0, 0.02, 4), (3.0, 0.0, 0.05, 24), (1.0, 4.0, 0.02, 4)]
)
def test_many_drops_leave_the_exponential_of_what_they_cover(width, blur, depth, seeds):
    """Poisson's process: the mean of what is free is exp(-number x area), with streaks that begin outside too."""
    area, free = math.pi / 4 * width**2, []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        count = rng.poisson(depth / area * 180 * 220)
        place = rng.random((count, 2)) * (180, 220) - 50
        speed = np.column_stack([rng.normal(0.0, 100.0, count), rng.normal(1000.0, 150.0, count)])
        same = np.ones(count)
        values = (value * same for value in (area, width, 0.0, blur, 5.0))
        streaks = Streaks(place, speed, *values, np.zeros((len(same), 0)))
        free.append(np.exp(-depth_of(streaks, Shutter(0.02, readout_s=0.01), SKY)[:, :, 0]).mean(dtype=float))
    error = np.std(free, ddof=1) / math.sqrt(len(free))
    assert 4 * error < 0.01
    assert np.mean(free) == pytest.approx(math.exp(-depth), abs=0.01 * depth + 4 * error)

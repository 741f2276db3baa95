"""Changes of lane: who gains goes over, in safety and smoothly, with the indicator on."""

from __future__ import annotations

import numpy as np
import pytest

from synfog_usd.world.traffic import changing, idm
from synfog_usd.world.traffic.follow import LOOK_S, STEP_S, Street, Vehicle, drive
from synfog_usd.world.traffic.paths import Path, Route, rounded

G = 9.81
DRIVER = idm.Driver()
LANE_M = 3.75
SECONDS = 20.0


def road(seconds, vehicles):
    """A straight road of two lanes, number 0 to the left of number 1."""
    lanes = [Path(rounded(np.array([(x, 0.0), (x, 1500.0)]), 0.0), LANE_M) for x in (0.0, LANE_M)]
    steps = round((seconds + LOOK_S) / STEP_S) + 5
    nothing = (np.zeros(0), np.zeros(0))
    return Street(
        [Route(lanes[0], right=1), Route(lanes[1], left=0)],
        vehicles, np.zeros((steps, 0, 2)), {0: nothing, 1: nothing}, DRIVER, np.zeros((steps, 1), dtype=bool),
    )  # fmt: skip


def car(lane, s, v, v0=30.0):
    return Vehicle(lane, s, 0.0, 0.0, 2.2, 2.2, 1.8, v, v0, takes=4.0)


def trips(vehicles):
    """How everybody goes on the road, at 20 frames a second."""
    street = road(SECONDS, vehicles)
    run, t = drive(street, SECONDS), np.arange(0.0, SECONDS, 0.05)
    return [street.trip(run, number, t) for number in range(len(vehicles))]


def test_a_car_overtakes_a_lorry_and_goes_back():
    """It goes to the left before it has to brake, 1 s after its first blink, in 4 s at 0.2 g, and back later."""
    fast, slow = trips([car(1, 50.0, 28.0), car(1, 110.0, 20.0, 20.0)])
    assert fast.x.min() < 0.05
    assert abs(fast.x[-1] - LANE_M) < 0.05
    assert abs(slow.x - LANE_M).max() < 1e-9
    assert fast.y[-1] > slow.y[-1] + 20.0
    first = int(np.argmax(fast.blinks != 0))
    assert fast.blinks[first] == 1
    assert set(fast.blinks.tolist()) == {-1, 0, 1}
    leaves = int(np.argmax(fast.x < LANE_M - 0.01))
    assert 0.95 <= (leaves - first) * 0.05 <= 1.6
    there = int(np.argmax(fast.x < 0.01))
    assert 3.0 <= (there - leaves) * 0.05 <= 4.2
    sideways = np.diff(fast.x, 2) / 0.05**2
    assert np.abs(sideways).max() < 0.2 * G
    np.testing.assert_allclose(np.abs(sideways).max(), 10.0 / 3**0.5 * LANE_M / 4.0**2, rtol=0.05)
    turned = np.arctan2(-np.gradient(fast.x), np.gradient(fast.y))
    np.testing.assert_allclose(fast.heading, turned, atol=0.01)


def test_nobody_cuts_in():
    """Beside a fast car that comes from behind nobody goes over, though their own lane is slow."""
    slow, *_ = trips([car(1, 100.0, 18.0), car(1, 125.0, 18.0, 18.0), car(0, 80.0, 30.0), car(0, 40.0, 30.0)])
    beside = slow.y < 180.0
    assert np.abs(slow.x[beside] - LANE_M).max() < 0.05


@pytest.mark.parametrize(("left", "least"), [(True, 0.5), (False, -0.1)])
def test_the_threshold_is_the_papers(left, least):
    """Equations 2 and 3 of the paper: gain and polite share over the threshold, with a bias to the right."""
    number, free = 3, np.array([0.0, 200.0, -200.0])
    v = np.array([25.0, 20.0, 25.0])
    here = changing.Neighbours(
        free, v, np.full(number, 30.0), np.full(number, 2.2), np.full(number, 2.2), np.array([True, True, False])
    )
    there = changing.Neighbours(
        free, v, np.full(number, 30.0), np.full(number, 2.2), np.full(number, 2.2), np.array([False, False, True])
    )
    gap = 200.0 - 4.4
    mine = idm.acceleration(DRIVER, 25.0, 30.0, np.inf, 0.0) - idm.acceleration(DRIVER, 25.0, 30.0, gap, 20.0)
    others = idm.acceleration(DRIVER, 25.0, 30.0, gap, 25.0) - idm.acceleration(DRIVER, 25.0, 30.0, np.inf, 0.0)
    wanted = float(mine + changing.POLITE * others) - least
    assert changing.gain(DRIVER, 0, here, there, leftwards=left) == pytest.approx(wanted, abs=1e-12)


def test_a_stop_in_mid_change_does_not_slide():
    """Who brakes to a stand while going over stands still sideways too."""
    (fast, _) = trips([car(1, 50.0, 12.0), car(1, 75.0, 9.0, 9.0)])
    sideways, along = np.abs(np.gradient(fast.x, 0.05)), np.gradient(fast.y, 0.05)
    assert (sideways < 0.25 * np.maximum(along, 0.5)).all()

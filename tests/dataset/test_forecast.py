"""Progress of a bake, on a clock of the test's own."""

from __future__ import annotations

import pytest

from synfog_usd.dataset.forecast import SET_UP, Forecast, kinds

CROSSING = [
    (lighting, fog != "clear") for lighting in ("sky", "active") for fog in ("clear", "mor600", "mor300", "mor150")
]

SECONDS = {
    "cold": [
        (12, 2),
        (11, 5),
        (1, 5),
        (1, 6),
        (11, 3),
        (13, 7),
        (1, 7),
        (1, 7),
    ],  # kernels compiled for each lighting; dusk costs more
    "warm": [(6, 2), (2, 5), (1, 5), (1, 6), (5, 3), (2, 8), (1, 7), (1, 8)],
    "long": [
        (14, 50),
        (12, 150),
        (1, 155),
        (1, 160),
        (11, 65),
        (14, 190),
        (1, 195),
        (1, 200),
    ],  # samples are what counts
}
"""Seconds of setting up and of rendering each shot."""


@pytest.mark.parametrize("case", SECONDS)
def test_the_time_left_is_right_within_a_third_from_a_quarter_on(case):
    """Eight shots of two lightings; progress never falls and ends at 1."""
    clock, seconds = [0.0], SECONDS[case]
    forecast, total = Forecast(kinds(CROSSING), now=lambda: clock[0]), sum(map(sum, seconds))
    shown = began = 0.0
    for index, (set_up, render) in enumerate(seconds):
        for step in range(41):
            clock[0] = began + (set_up + render) * step / 40
            fraction = max(0.0, SET_UP + (1.0 - SET_UP) * (clock[0] - began - set_up) / render)
            now = forecast.at(index, min(fraction, 1.0))
            assert shown <= now <= 1.0
            shown, left, right = now, clock[0] / now - clock[0] if now else 0.0, total - clock[0]
            if clock[0] >= 0.25 * total:
                assert abs(left - right) <= max(right / 3, 0.03 * total), (case, index, step, left, right)
        began += set_up + render
    assert shown == pytest.approx(1.0)


def test_shots_of_a_kind_are_alike():
    """The first of a lighting, its first in fog, and the rest of its fogs; the same in each lighting."""
    found = kinds(CROSSING)
    assert found[:4] == found[4:] and len(set(found)) == 3 and found[2] == found[3]

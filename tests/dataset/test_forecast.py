"""Progress of bakes that were recorded: what it said was done, and how long they then took."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from synfog_usd.dataset.forecast import LAST, Forecast, Kind, kinds

RECORDS = sorted((Path(__file__).parent / "data").glob("forecast_*.json"))
"""Each: the shots in the order in which they were made, their most samples, and paths in the air for each of the
surfaces; seconds until the last file; rows of seconds since the start and what the bake then told its forecast: 'at',
number of the shot, fraction of it; 'ended'; 'made', how long a picture took; 'spent', number of the shot, its samples.
"""


@pytest.mark.parametrize("path", RECORDS or ["none was found"], ids=str)
def test_the_time_left_is_right_from_a_quarter_on(path):
    """Within a third of the time left as the command tells it, or where that is less, of a tenth of the whole; progress
    never falls.

    The demo's own bake, 640x360, with no kernel compiled before and with all; and bakes whose shots stop by themselves,
    320x180, to which the weights were fitted.  Wrong by 32 and 32, and by 22, 25 and 13 % at most: the crossing, an
    arterial and a residential road.
    """
    record = json.loads(path.read_text())
    clock, total, shown = [0.0], record["seconds"], 0.0
    shots = kinds([tuple(shot) for shot in record["shots"]], record["samples"], record["air"])
    forecast, wrong = Forecast(shots, now=lambda: clock[0], began=0.0, most=record["samples"]), []
    for clock[0], name, *arguments in record["calls"]:
        now = getattr(forecast, name)(*arguments)
        if name != "at":
            continue
        assert shown <= now <= 1.0
        seconds, shown = clock[0], now
        left, right = seconds / now - seconds if now else 0.0, total - seconds
        if seconds >= 0.25 * total and abs(left - right) > max(right, 0.1 * total) / 3:
            wrong.append((*arguments, seconds, round(left, 1), round(right, 1)))
    assert not wrong
    assert shown > 0.9


def test_shots_of_a_kind_are_alike():
    """The first of a lighting, its first in fog, and the rest of its fogs; the same in each lighting but for lamps."""
    names = [(lighting, fog != "clear") for lighting in ("a", "b") for fog in ("clear", "mor600", "mor300", "mor150")]
    found = kinds([(lighting, foggy, False) for lighting, foggy in names])
    assert found[:4] == found[4:] and len(set(found)) == 3 and found[2] == found[3]
    lit = kinds([(lighting, foggy, lighting == "b") for lighting, foggy in names])
    assert lit[:4] == found[:4] and not set(lit[:4]) & set(lit[4:])


def test_what_is_done_between_shots_counts_for_neither():
    """Ten seconds a shot, and ninety for labels after the first: as the second begins, two and the last picture are
    left.
    """
    clock = [0.0]
    forecast = Forecast([Kind(False, False, False)] * 3, now=lambda: clock[0])
    for second, fraction in ((0.0, 0.0), (0.0, 0.03), (10.0, 1.0)):
        clock[0] = second
        forecast.at(0, fraction)
    forecast.ended()
    clock[0] = 100.0
    assert 100.0 / forecast.at(1, 0.0) - 100.0 == pytest.approx(2 * 10.0 + LAST * 10.0, rel=0.01)


def test_fewer_paths_in_the_air_are_less_to_wait_for():
    """Half of them take half of what the air takes: 5.8 of 11.6 samples before lamps, 1.2 of 2.4 under a sky."""
    for lamps, whole, half in ((False, 2.4, 1.8), (True, 11.6, 8.7)):
        rest = Kind(False, True, False, lamps, 0).weights[1]
        shots = [Kind(False, True, False, lamps, 8, air) for air in (1.0, 0.5)]
        assert [shot.weights[1] - rest for shot in shots] == pytest.approx([8 * whole, 8 * half])


def test_a_shot_that_runs_ahead_of_its_time_is_known_the_second_time():
    """Shots that say half after a tenth of their time, and then nothing for long: at half of the third shot its rest is
    nine tenths of what the others took, within a tenth.
    """
    clock = [0.0]
    forecast = Forecast([Kind(False, False, False)] * 3, now=lambda: clock[0], most=4)
    for index in range(3):
        for second, fraction in ((0.0, 0.04), (5.0, 0.28), (10.0, 0.515), (100.0, 1.0)):
            clock[0] = 100.0 * index + second
            done = forecast.at(index, fraction)
            if index == 2 and second == 10.0:
                assert clock[0] / done - clock[0] == pytest.approx(
                    90.0 + LAST * 100.0, rel=0.1
                )  # and to make the last picture

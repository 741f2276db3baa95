"""What a set is told to cost, before it is made."""

import json
import signal
import tempfile
import time
import tracemalloc
from collections import Counter
from pathlib import Path
from statistics import mean

import pytest
from support.cli import process, run

from synfog_usd.dataset.sets import cost
from synfog_usd.dataset.sets.cost import Cost, count
from synfog_usd.dataset.sets.journal import Tally
from synfog_usd.dataset.sets.load import define_set, load_set


def test_the_set_of_the_paper_is_counted():
    """500 scenes x 2 x 4 shots through 2 cameras, the foggy ones by a third; 3 files of a shot, 2 of each camera, 5 of
    a scene in a lighting.
    """
    found = count(load_set(Path("synfog")))
    assert (found.scenes, found.shots, found.pictures) == (500, 4000, 11_000)
    assert found.units == {"sky": 500, "active": 500} and found.splits == {"train": 450, "test": 50}
    assert found.files == 4000 * (3 + 2 * 2) + 3000 * 2 + 1000 * 5
    assert sum(found.sources.values()) == 500


def test_a_million_shots_are_counted_without_memory_for_them():
    """Ten thousand scenes more need not a megabyte more."""
    words = {"recipes": ["tunnel"], "fogs": ["clear", {"integer": [50, 900]}], "lightings": ["sky"]}

    def peak(scenes):
        tracemalloc.start()
        shots = count(define_set(scenes=scenes, **words)).shots
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert shots == 2 * scenes
        return used

    peak(100)
    assert peak(2_000) < peak(200) + 200_000


@pytest.mark.slow
def test_the_plan_of_a_million_shots_is_quick_and_small():
    """In processor time 60 s at most, and below 1 GB, both of a process of its own; measured 6 s and 0.25 GB."""
    code = (
        "import time; from synfog_usd.dataset.sets.cost import count; "
        "from synfog_usd.dataset.sets.load import define_set\n"
        "words = dict(recipes=['rural', 'tunnel'], splits={'train': 9, 'test': 1})\n"
        "fogs = ['clear', {'integer': [300, 900]}, {'integer': [100, 300]}, 50]\n"
        "found = count(define_set(scenes=125_000, fogs=fogs, **words))\n"
        "lines = open('/proc/self/status').read().splitlines()\n"  # maxrss has the parent's, too
        "peak = next(int(line.split()[1]) for line in lines if line.startswith('VmHWM'))\n"
        "print(found.shots, time.process_time(), peak / 1024)"
    )
    import subprocess
    import sys

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    shots, cpu_s, peak_mb = map(float, done.stdout.split())
    assert shots > 999_000 and cpu_s < 60 and peak_mb < 1000


def probe(size, seconds, lighting="sky"):
    return {"lighting": lighting, "size_px": size, "seconds": seconds}


def test_pixels_and_all_else_are_told_apart_by_two_sizes():
    """20 s a unit and 3 s a thousand pixels in one lighting, 40 and 2 in the other: at full size what the lines say.  A
    scene whose pixels take twice as long takes as long without them.  What is less than without pixels does not grow.
    """
    found = define_set(scenes=9, recipes=["tunnel"], size=[400, 200])
    seen = [probe((20, 10), 20.6), probe((200, 100), 80.0), probe((200, 100), 140.0), probe((200, 100), 15.0)]
    seen += [probe((20, 10), 40.4, "active"), probe((200, 100), 80.0, "active")]
    growth = (80_000 - 20_000) / (20_000 - 200)
    assert cost._full(seen, found, "seconds", "sky") == pytest.approx([260.0, 140 + growth * (140 - 20.6), 15.0])
    assert cost._full(seen, found, "seconds", "active") == pytest.approx([40 + 2 * 80])
    both = [mean(cost._full(seen, found, "seconds", lighting)) for lighting in ("active", "sky")]
    assert sorted(cost._full(seen, found, "seconds", "dusk")) == pytest.approx(sorted(both))


def test_memory_grows_slower_than_pixels():
    """What a street with lamps took at 320 x 180 and at 32 x 18, and what came at 1280 x 720 [MB], within a tenth."""
    found = define_set(scenes=9, recipes=["motorway"], size=[1280, 720])
    seen = [{"lighting": "active", "size_px": (32, 18), "peak_mb": 1035}]
    seen += [{"lighting": "active", "size_px": (320, 180), "peak_mb": 1308}]
    assert cost._full(seen, found, "peak_mb", "active") == pytest.approx([2618], rel=0.1)


def test_few_scenes_that_differ_leave_the_time_unsure():
    """Three scenes of 10, 20 and 30 s: the standard error of their mean is 10 s / sqrt(3)."""
    found = define_set(scenes=90, recipes=["tunnel"], size=[100, 50])
    seen = [{"lighting": "sky", "size_px": (32, 18), "cpu_s": 8.0}]
    seen += [{"lighting": "sky", "size_px": (100, 50), "cpu_s": cpu_s} for cpu_s in (10.0, 20.0, 30.0)]
    assert cost._error(seen, found, {"sky": 90}) == pytest.approx(90 * 10 / 3**0.5)
    seen += [{"lighting": "active", "size_px": (32, 18), "cpu_s": 3.0}]
    seen += [{"lighting": "active", "size_px": (100, 50), "cpu_s": cpu_s} for cpu_s in (5.0, 5.0)]
    assert cost._error(seen, found, {"sky": 90, "active": 90}) == pytest.approx(90 * 10 / 3**0.5)


def test_scenes_all_over_the_set_are_probed():
    """In each of two lightings that scenes draw: five scenes in fifths of the set, the first also with few pixels, and
    no scene in both lightings.
    """
    words = {"recipes": ["tunnel"], "lightings": [{"choice": {"sky": 1, "active": 1}}]}
    chosen = cost._chosen(define_set(scenes=100, size=[1280, 720], **words), ["sky", "active"])
    for lighting in ("sky", "active"):
        own = [(planned.number, size) for planned, unit, size in chosen if unit.lighting == lighting]
        assert [size for _, size in own] == [(32, 18), *[(320, 180)] * 5] and own[0][0] == own[1][0]
        assert [number // 20 for number, _ in own[1:]] == list(range(5))
    assert all(unit.lighting in planned.lightings for planned, unit, _ in chosen)
    assert len({planned.number for planned, _, _ in chosen}) == 10
    one = define_set(scenes=1, size=[200, 100], **(words | {"lightings": ["sky"]}))
    assert [size for _, _, size in cost._chosen(one, ["sky"])] == [(32, 18), (200, 100)]


def test_a_lighting_that_few_scenes_have_is_probed_with_few_pixels_first(monkeypatch):
    """Where scenes near the first places have it not, those of a later place begin with the small picture."""
    words = {"recipes": ["tunnel"], "lightings": [{"choice": {"sky": 30, "active": 1}}], "size": [640, 360]}
    monkeypatch.setattr(cost, "LOOKED", 4)
    late = 0
    for seed in range(20):
        found = define_set(scenes=400, **words, seed=seed)
        own = [(one.number, size) for one, unit, size in cost._chosen(found, ["active"]) if unit.lighting == "active"]
        assert [size for _, size in own] == [(32, 18), *[(320, 180)] * (len(own) - 1)] or not own
        late += bool(own) and own[0][0] >= 60  # the first place is scene 20, the second scene 60
    assert late > 0


def test_what_is_probed_comes_from_many_recipes():
    """Recipes of unequal shares: ten probes come from eight of nine, and from none more often than from those with most
    shares.  Of a set of six scenes four are probed.
    """
    shares = dict(residential=3, arterial=3, crossroads=2, roundabout=2, rural=2, motorway=2, car_park=1, bridge=1)
    words = {"recipes": shares | {"tunnel": 1}, "lightings": ["sky", "active"], "size": [1280, 720]}
    for scenes, most in ((500, 10), (6, 4)):
        chosen = cost._chosen(define_set(scenes=scenes, **words), ["sky", "active"])
        seen = {planned.number: planned.source.name for planned, _, _ in chosen}
        assert len(seen) == most
        if scenes > 6:
            found = Counter(seen.values())
            assert len(found) == 8 and all(abs(found[name] - 10 / 17 * share) < 1.0 for name, share in shares.items())


def test_kernels_that_are_compiled_first_are_not_taken_for_pixels(monkeypatch):
    """A machine that takes 20 s and 0.5 ms a pixel, twice that by lamps, and 15 s of a lighting's kernels the first
    time: the same hours.
    """
    known = set()

    def probe(found, planned, unit, size, *_):
        first = 0.0 if unit.lighting in known else 15.0
        known.add(unit.lighting)
        seconds = (1 + (unit.lighting == "active")) * (20.0 + 5e-4 * size[0] * size[1]) + first
        return {"seconds": seconds, "cpu_s": 1.5 * seconds, "bytes": 100 * size[0] * size[1], "peak_mb": 2000}

    monkeypatch.setattr(cost, "_probe", probe)
    words = {"recipes": ["tunnel"], "fogs": ["clear", 150], "lightings": ["sky", "active"]}
    found = define_set(scenes=50, size=[640, 360], **words)
    told = cost.estimate(found, count(found), None, workers=1)
    real = 50 * 3 * (20.0 + 5e-4 * 640 * 360) + 2 * 15.0
    assert told.hours * 3600.0 == pytest.approx(real, rel=1e-6) and told.cpu_h == pytest.approx(1.5 * told.hours)
    assert told.gigabytes == pytest.approx(100 * 100 * 640 * 360 / 1e9, rel=1e-6)


def test_probes_share_the_machine_as_units_will(monkeypatch):
    """Two at a time, each in a place of its own; but those that compile kernels, and their like without, alone."""
    there, seen, told = [], [], []

    def probe(found, planned, unit, size, child, chosen, cores, place):
        there.append(place)
        time.sleep(0.05)
        seen.append((tuple(size), tuple(sorted(there))))
        there.remove(place)
        return {"seconds": 1.0, "cpu_s": 1.0, "bytes": 1, "peak_mb": 1}

    monkeypatch.setattr(cost, "_probe", probe)
    found = define_set(scenes=50, size=[640, 360], recipes=["tunnel"], lightings=["sky", "active"])
    cost.estimate(found, count(found), None, workers=2, progress=lambda text, done: told.append(done))
    assert [len(places) for size, places in seen if size == (32, 18)] == [1] * 4
    assert Counter(places for size, places in seen if size != (32, 18))[0, 1] >= 8
    assert told == sorted(told) and len(told) == 4 + 10 + 1


def test_a_units_limit_follows_what_others_took():
    """Ten times the longest, at least ten minutes; by pixels while nothing is known."""
    found = define_set(scenes=2, recipes=["tunnel"], size=[320, 180])
    nothing = Cost.known(found, Tally())
    assert nothing.limit_s("sky") == 3600.0
    large = define_set(scenes=2, recipes=["tunnel"], size=[2560, 1440])
    assert Cost.known(large, Tally()).limit_s("sky") == 4 * 3600.0
    seen = nothing.seen("sky", 100.0).seen("sky", 50.0)
    assert seen.limit_s("sky") == 1000.0 and seen.seen("sky", 3.0).limit_s("sky") == 1000.0
    assert nothing.seen("sky", 3.0).limit_s("sky") == 600.0
    assert Cost.known(found, Tally(units=2, seconds=400.0)).limit_s("active") == 2000.0


def test_the_verb_counts_without_probes():
    done = run("dataset", "plan", "mini", "--no-probe", "--json")
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout)
    assert (printed["scenes"], printed["shots"]) == (6, 48) and "estimate" not in printed
    told = run("dataset", "plan", "mini", "--no-probe").stdout
    assert "48, as 48 pictures in 300 files" in told


def test_a_plan_that_is_ended_leaves_no_probe_behind(monkeypatch, tmp_path):
    """SIGTERM while the first probe is made, in a folder of the temporary folder."""
    seen = []

    def ended(job, child):
        seen.extend(path.name for path in tmp_path.iterdir())
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(cost, "do", ended)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    before = signal.getsignal(signal.SIGTERM)
    done = run("dataset", "plan", "mini")
    assert "48, as 48 pictures in 300 files" in done.stdout  # counts are there before any probe is
    assert "--no-probe leaves it out" in done.stderr
    assert done.returncode == 130 and any(name.startswith("synfog-probe-") for name in seen)
    assert not list(tmp_path.iterdir()) and signal.getsignal(signal.SIGTERM) is before


def test_a_set_that_does_not_ship_is_told():
    done = process("dataset", "plan", "minni")
    assert done.returncode == 2 and "minni" in done.stderr and "Did you mean 'mini'?" in done.stderr

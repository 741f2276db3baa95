"""Sets as users make them: begun, killed, gone on with, refused, repaired; always to the same bytes."""

import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter

import pytest
from support.cli import command, process, run
from support.stages import street

from synfog_usd.dataset.sets import index

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

SET = """\
synfog: set/1
about: Two tiny streets.
scenes: 2
stages: ["*.usda"]
fogs: [clear, {integer: [80, 300]}]
pipelines: [synfog, noise_free]
asm_estimated: [noise_free]
size: [24, 14]
quality: {word: reference, samples: 2, model: single}
"""
OUTPUTS = {"raw.dng", "srgb.png"}


def written(folder, text=SET, stages=2):
    for number in range(stages):
        (folder / f"{number}.usda").write_text(street(lamp=True, sky=1.0 + number))
    path = folder / "tiny.yaml"
    path.write_text(text)
    return path


def made(file, out, *more):
    return process("dataset", "run", file, "-o", out, "--workers", "2", *more)


def hashes(out):
    """Every file of a set; `.run` is no part of it."""
    return {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.relative_to(out).parts[0] != ".run"
    }


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return written(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="module")
def whole(tiny, tmp_path_factory):
    """The set from start to finish: (folder, hashes, what was printed)."""
    out = tmp_path_factory.mktemp("whole") / "out"
    done = made(tiny, out, "--json")
    assert done.returncode == 0, done.stderr
    return out, hashes(out), json.loads(done.stdout)


@pytest.mark.slow
def test_every_picture_is_in_the_index_and_every_file_in_a_unit(whole):
    """Two scenes, two lightings, two fogs, two pipelines and a guessed fog: 20 pictures, nothing else in the folder."""
    out, found, printed = whole
    assert printed["made"] == 4 and printed["kept"] == 0 and printed["aside"] == {}
    pictures = list(index.pictures(out))
    assert len(pictures) == 20
    assert Counter(one.pipeline for one in pictures) == {"synfog": 8, "noise_free": 8, "asm_estimated.noise_free": 4}
    notes = [note["text"] for note in json.loads((pictures[0].bake / "bake.json").read_text())["notes"]]
    assert [note.split(":")[0] for note in notes if "estimates" in note] == ["sensor mi10pro", "lens mi10pro"]
    assert {one.fog for one in pictures} > {"clear"} and len({one.seed for one in pictures}) == 2
    for one in pictures:
        assert set(one.files) >= OUTPUTS and all(path.is_file() for path in one.files.values())
    exposures = {}
    for folder in {one.bake for one in pictures}:
        for shot in json.loads((folder / "unit.json").read_text())["shots"]:
            for name, picture in shot["pictures"].items():
                exposures.setdefault((folder, name), set()).add(tuple(picture["exposure"].values()))
    assert len(exposures) == 4 * 3 and all(len(found) == 1 for found in exposures.values())  # fogs share it
    listed = {"set.json", "index/part-00000.parquet"}
    for folder in {one.bake for one in pictures}:
        inside = folder.relative_to(out).as_posix()
        for name, (size, digest) in json.loads((folder / "unit.json").read_text())["files"].items():
            assert found[f"{inside}/{name}"] == digest and (folder / name).stat().st_size == size
            listed.add(f"{inside}/{name}")
        listed.add(f"{inside}/unit.json")
    assert listed == set(found)


@pytest.mark.slow
def test_nothing_is_made_twice_and_a_set_in_parts_is_the_same(whole, tiny, tmp_path):
    """The same command again makes nothing; scenes made in goes by one worker, one of which a budget ends, have the
    bytes of one go by two.
    """
    found = whole[1]
    again = made(tiny, whole[0], "--json")
    assert json.loads(again.stdout)["made"] == 0 and json.loads(again.stdout)["kept"] == 4
    assert hashes(whole[0]) == found
    out = tmp_path / "out"
    done = process("dataset", "run", tiny, "-o", out, "--workers", "1", "--budget-gb", "0.0002", "--json")
    printed = json.loads(done.stdout)
    assert done.returncode == 1 and 0 < printed["made"] < 4 and "budget of 0.0002 GB" in printed["stopped"]
    for only in ("1", "0-1"):
        assert process("dataset", "run", tiny, "-o", out, "--workers", "1", "--only", only).returncode == 0
    assert hashes(out) == found


@pytest.mark.slow
def test_the_pictures_of_a_further_pipeline_are_what_it_makes_of_the_radiance(whole, tmp_path):
    """`graph run` on the radiance, metered on the clear frame, gives the same bytes but for seeds: none in a pipeline
    without noise.
    """
    out, _, _ = whole
    foggy, clear = (
        next(
            one
            for one in index.pictures(out)
            if one.pipeline == "noise_free" and (one.fog == "clear") == is_clear and one.lighting == "sky"
        )
        for is_clear in (False, True)
    )
    done = run(
        *("graph", "run", "pipeline/noise_free.yaml", "--in", foggy.files["radiance.exr"], "-o", tmp_path),
        *("--meter", clear.files["radiance.exr"]),
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "srgb.png").read_bytes() == foggy.files["srgb.png"].read_bytes()


@pytest.mark.slow
def test_the_guessed_fog_is_the_models_formula(whole, tmp_path):
    """J t + A (1 - t) of the clear frame and the exact transmittance, worked out here: developed, the same picture."""
    import numpy as np

    from synfog_usd.base.image import Quantity
    from synfog_usd.camera import writers
    from synfog_usd.fog.airlight import estimated_airlight

    out, _, _ = whole
    guessed = next(one for one in index.pictures(out) if one.pipeline == "asm_estimated.noise_free")
    clear = next(
        one for one in index.pictures(out) if (one.scene, one.fog, one.lighting) == (guessed.scene, "clear", "sky")
    )
    J = writers.read_exr(clear.files["radiance.exr"])
    layers = writers.read_exr(guessed.files["layers.exr"], quantity=Quantity.DATA)
    t = layers.pixels[:, :, [layers.channels.index("transmittance.Y")]]
    A = estimated_airlight(J.pixels, t)
    fogged = J.with_pixels(np.float32(A + (np.float64(J.pixels) - A) * t))
    writers.write_exr(tmp_path / "fogged.exr", fogged)
    done = run(
        *("graph", "run", "pipeline/noise_free.yaml", "--in", tmp_path / "fogged.exr", "-o", tmp_path),
        *("--meter", clear.files["radiance.exr"]),
    )
    assert done.returncode == 0, done.stderr
    from PIL import Image

    ours, theirs = (np.asarray(Image.open(path), int) for path in (tmp_path / "srgb.png", guessed.files["srgb.png"]))
    assert np.abs(ours - theirs).max() <= 1  # of 255: the order of the sum rounds otherwise
    assert float(t.min()) < 0.9 and np.abs(ours - np.asarray(Image.open(clear.files["srgb.png"]), int)).max() > 5


@pytest.mark.slow
def test_verify_finds_what_was_changed_and_repair_makes_it_again(whole, tiny, tmp_path):
    """A byte more, a file less, a file too many, an index of something else: each is told, then mended."""
    out, found, _ = whole
    copy = tmp_path / "out"
    shutil.copytree(out, copy)
    told = run("dataset", "verify", copy)
    assert told.returncode == 0 and "nothing wrong" in told.stdout
    paths = [path for path in found if path.endswith(("srgb.png", "labels.json"))]
    (copy / paths[0]).write_bytes(b"damaged")
    (copy / paths[-1]).unlink()
    (copy / "scenes/000/000001/sky/more.txt").write_text("more")
    (copy / "index/part-00000.parquet").write_bytes(b"PAR1")
    told = run("dataset", "verify", copy, "--json")
    findings = json.loads(told.stdout)
    assert told.returncode == 1
    assert {(one["unit"], one["text"].split(":")[0]) for one in findings if one["unit"]} == {
        (unit_of(paths[0]), paths[0].split("/", 4)[4]),
        (unit_of(paths[-1]), paths[-1].split("/", 4)[4]),
        ("000001/sky", "more.txt"),
    }
    assert any("part-00000.parquet" in one["text"] for one in findings)
    (copy / "scenes/000/000001/sky/more.txt").unlink()
    mended = made(tiny, copy, "--repair", "--json")
    assert mended.returncode == 0, mended.stderr
    assert hashes(copy) == found


def unit_of(path):
    return "/".join(path.split("/")[2:4])


@pytest.mark.slow
def test_another_program_or_another_asset_does_not_go_on_with_a_set(whole, tiny, tmp_path):
    """It says in what they differ, and touches nothing."""
    out, _, _ = whole
    copy = tmp_path / "out"
    shutil.copytree(out, copy)
    said = json.loads((copy / "set.json").read_text())
    said["made_of"]["versions"]["synfog-usd"] = "0.0.9"
    (copy / "set.json").write_text(json.dumps(said))
    before = hashes(copy)
    done = made(tiny, copy)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "another folder" in done.stderr and 'versions.synfog-usd (there "0.0.9", here' in done.stderr
    assert hashes(copy) == before
    other = written(tmp_path, SET.replace("samples: 2", "samples: 4"))
    done = made(other, out)
    assert done.returncode == 2 and "definition.quality.samples (there 2, here 4)" in done.stderr


@pytest.mark.slow
def test_what_changes_under_a_run_ends_it(tmp_path):
    """A stage is edited while its set is made: the next unit is refused, and what differs is told."""
    file, out = written(tmp_path), tmp_path / "out"
    child = begun(file, out)
    wait_for(lambda: list(out.glob("scenes/000/*/*/labels.json")), child)
    (tmp_path / "1.usda").write_text(street(lamp=True, sky=9.0))
    _, told = child.communicate(timeout=300)
    assert child.returncode == 2 and "It differs in stages." in told and "tried again" not in told
    assert "Traceback" not in told
    done = made(file, out)
    assert done.returncode == 2 and "It differs in stages." in done.stderr


@pytest.mark.slow
def test_a_unit_that_fails_three_times_is_set_aside_and_taken_up_again(tiny, whole, tmp_path):
    """Both of a scene take longer than a second: they are ended, set aside with their seeds, left alone by another run,
    and made by retry.
    """
    out = half(whole, tmp_path)
    done = made(tiny, out, "--limit", "1", "--json")
    assert done.returncode == 1
    aside = json.loads(done.stdout)["aside"]
    assert set(aside) == {"000001/sky", "000001/active"}
    assert all(line["kind"] == "limit" and line["try"] == 3 and line["seed"] > 0 for line in aside.values())
    assert done.stderr.count("is tried again") == 4 and f"dataset retry {out}" in done.stderr
    done = made(tiny, out, "--json")
    assert done.returncode == 1
    assert json.loads(done.stdout)["made"] == 0 and set(json.loads(done.stdout)["aside"]) == set(aside)
    told = json.loads(run("dataset", "status", out, "--json").stdout)
    assert (told["units"], told["made"], set(told["aside"])) == (4, 2, set(aside)) and not told["running"]
    assert process("dataset", "retry", out, "--workers", "2").returncode == 0
    assert hashes(out) == whole[1]


def half(whole, tmp_path):
    """A copy of the set that lacks the units of its second scene."""
    out = tmp_path / "out"
    shutil.copytree(whole[0], out)
    shutil.rmtree(out / "scenes/000/000001")
    return out


def begun(file, out, *more, scheduler=None, **options):
    """A run in a process group of its own, as in a terminal."""
    workers = ["--scheduler", scheduler] if scheduler else ["--workers", "2"]
    words = command("dataset", "run", file, "-o", out, *workers, *more)
    return subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True, **options)


def units_of(*pids):
    """Processes below others that make a unit."""
    import psutil

    found = []
    for pid in pids:
        with contextlib.suppress(psutil.NoSuchProcess):
            for one in psutil.Process(pid).children(recursive=True):
                with contextlib.suppress(psutil.NoSuchProcess, psutil.ZombieProcess):
                    if "unit" in one.cmdline():
                        found.append(one.pid)
    return found


@contextlib.contextmanager
def cluster(place, workers=2):
    """A scheduler and workers of one thread, as a user starts them: (its address, the scheduler's process, theirs).

    Args:
        place: where the scheduler writes its address.
    """
    dask, options = [sys.executable, "-m", "dask"], ["--scheduler-file", str(place), "--no-dashboard"]
    started = [subprocess.Popen([*dask, "scheduler", *options, "--port", "0"], stderr=subprocess.DEVNULL)]
    words = [*dask, "worker", *options, "--nthreads", "1", "--no-nanny"]
    started += [subprocess.Popen(words, stderr=subprocess.DEVNULL) for _ in range(workers)]
    try:
        from distributed import Client

        while not place.exists():
            assert started[0].poll() is None
            time.sleep(0.05)
        with Client(scheduler_file=str(place)) as client:
            client.wait_for_workers(workers, timeout=60)
            address = client.scheduler.address
        yield address, started[0], started[1:]
    finally:
        for one in started:
            one.kill()
            one.wait()


def wait_for(condition, child, timeout_s=120.0):
    ends = time.monotonic() + timeout_s
    while time.monotonic() < ends:
        if condition():
            return
        assert child.poll() is None, child.stderr.read()
        time.sleep(0.02)
    raise AssertionError("it did not come in time")


def gone(pids, timeout_s=30.0):
    """Whether processes end by themselves."""
    import psutil

    ends = time.monotonic() + timeout_s
    while time.monotonic() < ends:
        if not any(psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE for pid in pids):
            return True
        time.sleep(0.05)
    return False


def obeying_ctrl_c():
    """A shell starts background jobs with SIGINT ignored, and children inherit that; a user's terminal does not."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_ctrl_c_ends_everything_and_says_how_to_go_on(tiny, whole, tmp_path):
    """Exit code 130, one line, no process left; what is finished is in the index."""
    out = half(whole, tmp_path)
    child = begun(tiny, out, preexec_fn=obeying_ctrl_c)
    wait_for(lambda: len(units_of(child.pid)) == 2, child)
    units = units_of(child.pid)
    os.killpg(child.pid, signal.SIGINT)  # as the terminal does: the whole group
    _, told = child.communicate(timeout=60)
    assert child.returncode == 130
    assert f"dataset run {tiny} -o {out} goes on from there" in told and "Traceback" not in told
    assert gone(units)
    assert made(tiny, out).returncode == 0
    assert hashes(out) == whole[1]


@pytest.mark.slow
def test_a_second_run_on_a_folder_is_told(tiny, whole, tmp_path):
    """Which process has it; the first, which is held meanwhile, goes on."""
    out = half(whole, tmp_path)
    child = begun(tiny, out)
    try:
        wait_for(lambda: units_of(child.pid), child)
        os.kill(child.pid, signal.SIGSTOP)
        watching = subprocess.Popen(command("dataset", "status", out, "--watch"), stdout=subprocess.PIPE, text=True)
        second = made(tiny, out)
        assert second.returncode == 2
        assert f"another run works here (process {child.pid} on" in second.stderr and second.stderr.count("\n") == 1
        assert json.loads(run("dataset", "status", out, "--json").stdout)["running"]
    finally:
        os.kill(child.pid, signal.SIGCONT)
        _, told = child.communicate(timeout=300)
    assert child.returncode == 0, told
    watched = watching.communicate(timeout=60)[0].splitlines()
    assert "a run works on it" in watched[0] and "4 of 4 units" in watched[-1] and "complete" in watched[-1]


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_nothing_and_a_unit_costs_a_try(tiny, whole, tmp_path):
    """kill -9 of a worker: the scheduler gives its unit to the other; then of that one's unit: it is tried again."""
    out = tmp_path / "out"
    with cluster(tmp_path / "scheduler.json") as (address, _, workers):
        child = begun(tiny, out, scheduler=address)
        wait_for(lambda: units_of(workers[0].pid) and units_of(workers[1].pid), child)
        lost = units_of(workers[0].pid)
        workers[0].kill()
        assert gone(lost)
        wait_for(lambda: units_of(workers[1].pid), child)
        os.kill(units_of(workers[1].pid)[0], signal.SIGKILL)
        _, told = child.communicate(timeout=300)
    assert child.returncode == 0, told
    assert told.count("it is tried again") == 1 and "died of signal 9" in told
    assert hashes(out) == whole[1]


@pytest.mark.slow
def test_a_unit_that_runs_twice_is_made_once(tiny, whole, tmp_path):
    """Two workers that were both given a unit: the second waits for the first, and finds it made."""
    out = tmp_path / "out"
    shutil.copytree(whole[0], out)
    shutil.rmtree(out / "scenes/000/000000/sky")
    words = command("dataset", "unit", out, "0", "sky", "--variant", "auto")
    both = [subprocess.Popen(words, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    results = [json.loads(one.communicate(timeout=300)[0]) for one in both]
    assert sorted(result["made"] for result in results) == [False, True]
    assert hashes(out) == whole[1]


def killed_at_random(tiny, folder, whole, seed):
    """A run whose client, scheduler, worker, unit or all of them is killed at a random moment, then the same command.

    A moment at which there was nothing to kill is no kill: another run is begun, and another moment drawn.
    """
    rng = random.Random(seed)
    for attempt in range(10):
        out = folder / f"out{attempt}"
        if killed := kill_once(tiny, out, rng, 0.7 * whole[2]["seconds"]):
            break
    assert killed, seed
    done = made(tiny, out)
    assert done.returncode == 0, (seed, killed, done.stderr)
    assert hashes(out) == whole[1], (seed, killed)


def kill_once(tiny, out, rng, within_s):
    """What was killed, and after how many of the 4 units; '' where the run ended before."""
    what = rng.choice(["all", "client", "scheduler", "unit", "worker"])
    with contextlib.ExitStack() as stack:
        # on one machine client, scheduler and workers are one process; where they are killed apart they are begun apart
        address, scheduler, workers = None, None, []
        if what in ("scheduler", "worker"):
            address, scheduler, workers = stack.enter_context(cluster(out.with_suffix(".json")))
        child = begun(tiny, out, scheduler=address, stdout=subprocess.DEVNULL)
        above = [child.pid, *(one.pid for one in workers)]
        if rng.random() < 0.8:  # else while it begins
            wait_for(lambda: units_of(*above) or child.poll() is not None, child)
        time.sleep(rng.uniform(0.2, within_s))
        units, running = units_of(*above), child.poll() is None
        client = [child.pid] * running
        choice = {
            "all": client + units,
            "client": client,
            "scheduler": [scheduler.pid] * running if scheduler else [],
            "unit": units[:1],
            "worker": [one.pid for one in workers[:1]] * running,
        }[what]
        finished = len(list(out.glob("scenes/*/*/*/unit.json")))
        for pid in choice:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        child.communicate(timeout=600)
    assert gone(units), what
    told = f"{what} after {finished} units" if choice else ""
    print(told or f"nothing to kill: {what}")
    return told


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_what_is_killed_at_any_moment_goes_on_to_the_same_bytes(tiny, whole, tmp_path, seed):
    killed_at_random(tiny, tmp_path, whole, seed)


@pytest.mark.physics
@pytest.mark.parametrize("seed", range(100, 150))
def test_fifty_kills_end_with_the_same_bytes(tiny, whole, tmp_path, seed):
    killed_at_random(tiny, tmp_path, whole, seed)

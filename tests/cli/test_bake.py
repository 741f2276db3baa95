"""`synfog-usd bake` as a user runs it: from start to finish, interrupted, and refused."""

import hashlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.cli import command, process, run
from support.stages import street

from synfog_usd.dataset.bake import StrictError
from synfog_usd.dataset.job import bake

SHOTS = [f"{lighting}/{fog}" for lighting in ("sky", "active") for fog in ("clear", "mor600", "mor150")]
OUTPUTS = {"radiance.exr", "layers.exr", "instances.json", "raw.dng", "srgb.png"}


def hashes(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def arguments(stage, out):
    """Six shots of half a second and more each."""
    return ["bake", stage, "-o", out, "--resolution", "64x36", "--samples", "128", "--seed", "3"]


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    path = tmp_path_factory.mktemp("stage") / "street.usda"
    path.write_text(street(lamp=True))
    return path


@pytest.fixture(scope="module")
def unbroken(stage, tmp_path_factory):
    """One bake from start to finish: the folder."""
    out = tmp_path_factory.mktemp("bake") / "out"
    done = run(*arguments(stage, out))
    assert done.returncode == 0, done.stderr
    return out


def test_every_lighting_and_fog_has_its_files(unbroken):
    """Six shots with five files each, labels and a contact sheet; the manifest lists them with their hashes and nothing
    else is there.
    """
    out = unbroken
    manifest = json.loads((out / "bake.json").read_text())
    assert {f"{row['lighting']}/{row['fog']}" for row in manifest["shots"]} == set(SHOTS)
    found = hashes(out)
    listed = {"bake.json": found["bake.json"], **manifest["labels"], **manifest["contact"]}
    for row in manifest["shots"]:
        assert set(row["files"]) == OUTPUTS
        listed |= {f"{row['lighting']}/{row['fog']}/{name}": digest for name, digest in row["files"].items()}
    assert listed == found


def test_exposure_is_locked_to_the_clear_frame(unbroken):
    """All fogs of a lighting share one exposure; the dim lighting has a longer or more sensitive one."""
    out = unbroken
    rows = json.loads((out / "bake.json").read_text())["shots"]
    light = {
        name: {row["exposure"]["exposure_s"] * row["exposure"]["iso"] for row in rows if row["lighting"] == name}
        for name in ("sky", "active")
    }
    assert len(light["sky"]) == len(light["active"]) == 1
    assert min(light["active"]) > 4 * max(light["sky"])


def test_exposure_does_not_depend_on_what_else_is_baked(unbroken, stage, tmp_path):
    """The foggy shot alone has the same bytes as among the others: clear air is metered without being asked for."""
    out = unbroken
    done = run(*arguments(stage, tmp_path / "out"), "--fog", "mor150", "--lighting", "sky")
    assert done.returncode == 0, done.stderr
    alone = hashes(tmp_path / "out" / "sky" / "mor150")
    assert alone == hashes(out / "sky" / "mor150") and set(alone) == OUTPUTS


def wait_for_shots(out, count, child, timeout_s=120.0):
    """Wait until the manifest lists `count` shots."""
    ends = time.monotonic() + timeout_s
    while time.monotonic() < ends:
        assert child.poll() is None, "the bake ended before it could be interrupted"
        try:
            if len(json.loads((out / "bake.json").read_text())["shots"]) >= count:
                return
        except (OSError, ValueError):
            pass
        time.sleep(0.005)
    raise AssertionError("no shot was finished in time")


@pytest.mark.slow
def test_a_bake_that_was_killed_goes_on_and_ends_with_the_same_bytes(unbroken, stage, tmp_path, finished=1):
    """kill -9 in the middle, then the same command: finished shots are kept, and every file equals that of an unbroken
    run.  What a kill leaves is cheaply made by hand in the test below.
    """
    out = tmp_path / "out"
    child = subprocess.Popen(command(*arguments(stage, out)), stderr=subprocess.DEVNULL)
    wait_for_shots(out, finished, child)
    time.sleep(0.2)
    child.kill()
    child.wait()
    time.sleep(0.2)
    kept = len(json.loads((out / "bake.json").read_text())["shots"])
    assert finished <= kept < len(SHOTS)
    done = run(*arguments(stage, out))
    assert done.returncode == 0 and f"{kept} of {len(SHOTS)} shots are finished already" in done.stderr
    assert hashes(out) == hashes(unbroken)


def test_a_finished_bake_is_not_rendered_again_and_damaged_or_missing_shots_are(unbroken, stage):
    """The same command a second time renders nothing; a file that was changed brings its shot back, and so does a shot
    that the manifest does not list, of which a part was written; labels that are missing come back, too.
    """
    out = unbroken
    before = hashes(out)
    asked = {"resolution": (64, 36), "samples": 128, "seed": 3}
    again = bake(stage, out, **asked)
    assert again.seconds == {} and len(again.kept) == len(SHOTS)
    (out / "sky" / "mor600" / "raw.dng").write_bytes(b"damaged")
    (out / "sky" / "mor150" / "srgb.png").unlink()
    (out / "labels.json").unlink()
    manifest = json.loads((out / "bake.json").read_text())
    manifest["shots"] = [row for row in manifest["shots"] if row["folder"] != "sky/mor150"]
    (out / "bake.json").write_text(json.dumps(manifest))
    assert list(bake(stage, out, **asked).seconds) == ["sky/mor600", "sky/mor150"]
    assert hashes(out) == before


def obeying_ctrl_c():
    """A shell starts background jobs with SIGINT ignored, and children inherit that; a user's terminal does not."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def interrupted(stage, out):
    """A bake that gets SIGINT while it renders its second shot: (exit code, what it told, seconds to its end)."""
    many = (*arguments(stage, out)[:-4], "--samples", "2048", "--quality", "reference")
    child = subprocess.Popen(command(*many), stderr=subprocess.PIPE, text=True, preexec_fn=obeying_ctrl_c)
    wait_for_shots(out, 1, child)
    time.sleep(0.3)
    began = time.monotonic()
    child.send_signal(signal.SIGINT)
    _, told = child.communicate(timeout=300)
    return child.returncode, told, time.monotonic() - began


@pytest.mark.slow
def test_ctrl_c_ends_a_shot_that_is_rendered_and_keeps_finished_ones(stage, tmp_path):
    """The shot is not waited for: exit code 130, no temporary file, finished shots stay."""
    code, told, _ = interrupted(stage, tmp_path / "out")
    assert code == 130
    assert "1 finished shots are kept" in told and "Traceback" not in told
    rows = json.loads((tmp_path / "out" / "bake.json").read_text())["shots"]
    assert [row["fog"] for row in rows] == ["clear"]
    assert not [path for path in tmp_path.rglob(".synfog-part-*")]


@pytest.mark.bench
def test_ctrl_c_ends_within_two_seconds(stage, tmp_path):
    assert interrupted(stage, tmp_path / "out")[2] < 2.0


def refused(done, *words, code=2):
    """One clear line, no trace, and the exit code."""
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    line = done.stderr.strip().splitlines()[-1]
    for word in words:
        assert word in line, line


def test_a_missing_stage_is_refused(tmp_path):
    """In a process of its own: parent and child tell one line."""
    refused(process("bake", tmp_path / "none.usda", "-o", tmp_path / "out"), "none.usda", "no such file")
    assert not (tmp_path / "out").exists()


BLIND = b'#usda 1.0\n(\n    defaultPrim = "World"\n)\ndef Xform "World"\n{\n    def Cube "Box"\n    {\n    }\n}\n'


@pytest.mark.parametrize("name, content, word", [
    ("broken.usda", b'#usda 1.0\ndef Xform "World" {', ""),
    ("broken.usdc", b"PXR-USDC" + bytes(200), ""),
    ("blind.usda", BLIND, "camera"),
])  # fmt: skip
def test_a_stage_that_cannot_be_drawn_is_refused(tmp_path, name, content, word):
    (tmp_path / name).write_bytes(content)
    refused(run("bake", tmp_path / name, "-o", tmp_path / "out"), name, word)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", ["--camera /World/Egg /World/Ego", "--fog mor15O mor150", "--lighting aktive active"])
def test_a_name_that_does_not_exist_is_refused_with_the_one_that_was_meant(stage, tmp_path, words):
    option, name, meant = words.split()
    refused(run("bake", stage, "-o", tmp_path / "out", option, name), name, meant)


def test_a_stage_without_fog_bakes_clear_air_and_says_so(tmp_path):
    """And a bake that is not told where to writes to out/ and the stage's name."""
    path = tmp_path / "clear.usda"
    text = street()
    path.write_text(
        text.replace('prepend apiSchemas = ["SynFogMediumAPI"]', "").replace(
            'uniform token purpose = "guide"\n        double size', "double size"
        )
    )
    text = path.read_text()
    path.write_text(
        text.replace("float synfog:fog:albedo = 1.0", 'token visibility = "invisible"').replace(
            "float synfog:fog:mor", "float unrelated"
        )
    )
    done = run(
        *("bake", path, "--resolution", "32x18", "--samples", "2", "--quality", "reference"),
        *("--lighting", "sky", "--fog", "mor600"),
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert "--fog mor200 adds fog" in done.stderr  # 150 m is what the stage calls a variant of its own, without fog
    assert {entry.name for entry in tmp_path.iterdir()} == {"clear.usda", "out"}
    assert json.loads((tmp_path / "out" / "clear" / "bake.json").read_text())["shots"][0]["mor_m"] is None


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("op: isp.gamma", "op: isp.gama", ["isp.gama", "isp.gamma"]),
        ("temperature_c: 35", "temprature_c: 35", ["temprature_c", "temperature_c"]),
        ("synfog: graph/1", "synfog: [graph", [".yaml"]),
    ],
)
def test_a_bad_graph_is_refused_with_its_place(stage, tmp_path, old, new, words):
    """Unknown node, unknown parameter, and not YAML at all."""
    text = (Path(__file__).resolve().parents[2] / "pipeline" / "phone.yaml").read_text()
    assert old in text
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace(old, new, 1))
    done = run("bake", stage, "-o", tmp_path / "out", "--pipeline", path)
    refused(done, *words)
    assert f"{path}:" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_graph_that_reads_more_than_radiance_is_refused_before_anything_is_rendered(stage, tmp_path):
    (tmp_path / "deep.yaml").write_text(
        "synfog: graph/1\nextends: phone\ninputs: {radiance: radiance, depth: data}\nnodes:\n"
        "  - {name: focus, op: optics.depth_of_field, in: [irradiance, depth], focus_m: 3, after: irradiance}\n"
    )
    done = run("bake", stage, "-o", tmp_path / "out", "--pipeline", tmp_path / "deep.yaml")
    refused(done, "'depth' is data", "graph run", "fStop")
    assert not (tmp_path / "out" / "bake.json").exists()


def test_a_bake_of_another_quality_is_another_one(stage, tmp_path):
    """What was made of the first is made anew; the reference is not denoised."""
    short = "-o", tmp_path, "--resolution", "32x18", "--samples", "4", "--fog", "mor150", "--lighting", "active"
    for more in ((), ("--quality", "reference")):
        done = run("bake", stage, *short, *more)
        assert done.returncode == 0 and "finished already" not in done.stderr, done.stderr
    manifest = json.loads((tmp_path / "bake.json").read_text())
    assert manifest["plan"]["quality"] == "reference" and not manifest["shots"][0]["denoised"]


def test_an_output_that_cannot_be_written_is_refused(stage, tmp_path):
    (tmp_path / "file").write_text("in the way")
    refused(run("bake", stage, "-o", tmp_path / "file" / "out", "--resolution", "32x18"), str(tmp_path / "file"))


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_leaves_no_half_file(stage, tmp_path):
    """A limit on file size stands in for a full disk: writing fails in the middle of a file."""
    out = tmp_path / "out"
    limit = 20_000
    few = ("--lighting", "sky", "--fog", "clear", "--samples", "2", "--quality", "reference")
    done = process(
        *arguments(stage, out)[:6], *few, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    )
    refused(done, str(out))
    for path in out.rglob("*"):
        assert not path.name.startswith(".synfog-part-")
        assert path.is_dir() or path.stat().st_size < limit


def test_strict_stops_at_what_is_not_understood(tmp_path):
    """A prim that cannot be drawn is a warning; `strict=True` of Python stops at it."""
    path = tmp_path / "odd.usda"
    path.write_text(street().replace('def Camera "Ego"', 'def Volume "Smoke"\n    {\n    }\n    def Camera "Ego"'))
    how = ("--fog", "clear", "--lighting", "sky", "--resolution", "32x18", "--samples", "2", "--quality", "reference")
    loose = run("bake", path, "-o", tmp_path / "a", *how)
    assert loose.returncode == 0 and "/World/Smoke" in loose.stderr
    assert "none was asked for" not in loose.stderr  # clear air is what was asked for
    with pytest.raises(StrictError, match="/World/Smoke"):
        bake(path, tmp_path / "b", strict=True)
    assert not (tmp_path / "b").exists()


def test_a_picture_that_memory_does_not_hold_is_refused_before_it_is_begun(stage, tmp_path, monkeypatch):
    """It is told what it would take: 10 to 16 GB, by what a picture of a sixteenth of the pixels was seen to take."""
    from synfog_usd.base import system

    monkeypatch.setattr(system, "free_memory", lambda: 5_000_000_000)
    large = ["bake", stage, "-o", tmp_path / "out", "--resolution", "8192x4096", "--lighting", "sky", "--fog", "clear"]
    done = run(*large)
    refused(done, "8192 x 4096", "5 GB", "--resolution")
    assert 10 <= int(re.search(r"takes about (\d+) GB", done.stderr)[1]) <= 16
    assert not any((tmp_path / "out").iterdir())


def test_two_bakes_do_not_write_into_one_folder(unbroken, stage):
    """The second is refused while the first holds the folder."""
    import fcntl

    out = unbroken
    handle = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        refused(run(*arguments(stage, out)), str(out), "another bake")
    finally:
        os.close(handle)


@pytest.mark.parametrize(
    "option, value, words",
    [
        ("--samples", "0", "--samples 0: outside 2 to 1048576"),
        ("--frames", "nan", "--frames nan: it takes one time code"),
        ("--light-scale", "0", "--light-scale 0: outside 0 to"),
        ("--fog", "mor0.01", "--fog mor0.01: a visibility below 0.03 m"),
        ("--resolution", "1000000000x2", "--resolution 1000000000x2"),
        ("-o", "", "--out '': no name of a folder"),
    ],
)
def test_numbers_are_refused_in_the_words_that_were_typed_and_before_anything_is_done(tmp_path, option, value, words):
    """The stage, which does not even exist, is not asked for, and nothing is written."""
    done = run("bake", "none.usda", "-o", "out", option, value, cwd=tmp_path)
    refused(done, words)
    assert not list(tmp_path.iterdir())


def test_what_is_refused_at_once_loads_no_library():
    """The command line begins no second process for it, and imports neither USD nor a renderer nor numpy."""
    script = (
        "import sys\nfrom synfog_usd.cli import main\n"
        "try:\n    main.main(['bake', 'none.usda', '--samples', '0'])\n"
        "except SystemExit as end:\n    print(end.code, [name for name in ('numpy', 'pxr', 'mitsuba') if name in "
        "sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout == "2 []\n" and done.stderr.startswith("synfog-usd: --samples 0: ")


def test_a_bake_is_exposed_as_a_photographer_says(stage, tmp_path):
    """Time and ISO stand in the RAW's Exif, as LibRaw reads them, and in bake.json; a stop less is half of the light;
    and what a sensor cannot do is refused before anything is written.
    """
    import rawpy

    common = ("bake", stage, "--lighting", "sky", "--fog", "clear", "--resolution", "64x36", "--samples", "2")
    common += ("--quality", "reference")

    def baked(name, *more):
        done = run(*common, "-o", tmp_path / name, *more)
        assert done.returncode == 0, done.stderr
        row = json.loads((tmp_path / name / "bake.json").read_text())["shots"][0]
        with rawpy.imread(str(tmp_path / name / "sky/clear/raw.dng")) as raw:
            light = raw.raw_image_visible.astype(float).mean() - raw.black_level_per_channel[0]
            return row["exposure"], light, (raw.other.shutter_speed, raw.other.iso_speed)

    exposure, light, exif = baked("free")
    fixed, _, exif = baked("fixed", "--exposure", "1/2000", "--iso", "200")
    assert fixed == {"exposure_s": 1 / 2000, "iso": 200.0} and exif == (pytest.approx(1 / 2000, rel=1e-6), 200.0)
    darker, less, _ = baked("darker", "--ev", "-1")
    assert darker["ev"] == -1.0
    assert darker["exposure_s"] * darker["iso"] == pytest.approx(exposure["exposure_s"] * exposure["iso"] / 2)
    assert less == pytest.approx(light / 2, rel=0.03)  # shot noise of 2304 pixels, and rounding to whole numbers
    again = baked("darker", "--ev", "-1")
    assert again[0] == darker
    for more, told in (
        (("--exposure", "1"), "--exposure 1 s: the sensor"),
        (("--exposure", "1/0"), "--exposure 1/0: it takes seconds"),
        (("--ev", "20"), "--ev 20: outside -10 to 10 stops"),
    ):
        done = run(*common, "-o", tmp_path / "none", *more)
        assert done.returncode == 2 and told in done.stderr and not (tmp_path / "none").exists()

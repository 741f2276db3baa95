"""Frames one after the other: noise that is new, patterns that stay, exposure that follows, clips that other programs
read.
"""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest
import tifffile
from support.cli import command, run
from support.stages import street

import synfog_usd as sf
from synfog_usd import camera
from synfog_usd import stage as usd
from synfog_usd.base import files, resources
from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.base.image import Quantity
from synfog_usd.base.seeds import frame_seed, seed32
from synfog_usd.camera import writers
from synfog_usd.camera.writers import video
from synfog_usd.dataset.exports.frames import pictures
from synfog_usd.dataset.job import job_of
from synfog_usd.dataset.plan import frame_codes
from synfog_usd.render import models
from synfog_usd.render.dualbuffer import Error
from synfog_usd.render.sampling import adaptive
from synfog_usd.render.sampling.adaptive import Target
from synfog_usd.render.shot import load
from synfog_usd.scene.testing import scene, sky, uniform_fog, wall

OPTIONS = (
    *("--frames", "0:4", "--fog", "clear", "--lighting", "sky", "--resolution", "48x28"),
    *("--samples", "4", "--quality", "reference"),
)
STEP = "float inputs:intensity.timeSamples = { 1: 4000, 2: 32000 }"


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Five frames of a street whose sky is eight times as bright from the third on: the folder."""
    folder = tmp_path_factory.mktemp("sequence")
    text = street(sky=123.0).replace("float inputs:intensity = 123.0", STEP)
    assert STEP in text
    text = text.replace('    upAxis = "', '    startTimeCode = 0\n    timeCodesPerSecond = 10\n    upAxis = "', 1)
    (folder / "street.usda").write_text(text)
    done = run("bake", folder / "street.usda", "-o", folder / "out", *OPTIONS)
    assert done.returncode == 0, done.stderr
    return folder / "out", json.loads((folder / "out" / "sequence.json").read_text())


def exposures(found):
    return np.array([np.prod(row["exposures"]["sky"]) for row in found["frames"]])


@pytest.mark.slow
def test_the_exposure_follows_with_its_time_constant(clip):
    """Light rises by 3 EV before frame 2; frames of 0.1 s, a time constant of 0.3 s: frames 0 and 3 are metered, from
    there on what is left of the way falls by exp(-1/3) from frame to frame.
    """
    _, found = clip
    assert found["frames_per_s"] == 10.0
    ev = np.log2(exposures(found))
    wanted = ev[0] - 3.0 * (1.0 - np.exp([0.0, 0.0, 0.0, -1.0 / 3.0, -2.0 / 3.0]))
    np.testing.assert_allclose(ev, wanted, atol=0.02)  # EV; a frame is metered on 64 samples of its own


@pytest.mark.slow
def test_each_frame_is_a_bake_and_a_frame_of_cinemadng(clip):
    """NAME_NNNNNN.dng in a folder of its own; FrameRate and TimeCodes as tifffile reads them: 00:00:00:03 for the
    fourth; the same file as the frame's raw.dng.
    """
    out, found = clip
    assert "clips/sky_clear/raw" in found["clips"]
    raws = sorted((out / "clips" / "sky_clear" / "raw").iterdir())
    assert [path.name for path in raws] == [f"raw_{number:06d}.dng" for number in range(5)]
    for number, path in enumerate(raws):
        assert path.samefile(out / f"{number:06d}" / "sky" / "clear" / "raw.dng")
        with tifffile.TiffFile(path) as file:
            tags = file.pages[0].tags
            assert tags[51044].value == (10, 1)
            assert bytes(tags[51043].value) == bytes([number, 0, 0, 0, 0, 0, 0, 0])


@pytest.mark.slow
def test_noise_is_new_in_each_frame(clip):
    """Steps between pixels of a colour in even sky, in two frames of one light, less what all rows have: noise of their
    own, and of the sensor's pattern (0.7 % beside shot noise of 2 %) an eighth in common.
    """
    out, found = clip
    assert len({row["seed"] for row in found["frames"]}) == 5
    frames = [tifffile.imread(out / f"{n:06d}" / "sky" / "clear" / "raw.dng").astype(float) for n in (0, 1)]
    steps = [
        [np.diff(frame[y::2, x:8:2], axis=1) for y, x in ((0, 0), (0, 1), (1, 0), (1, 1))]  # of the Bayer pattern
        for frame in frames
    ]
    steps = [np.concatenate([(part - part.mean(axis=0)).ravel() for part in one]) for one in steps]
    assert min(step.std() for step in steps) > 1.0
    assert abs(np.corrcoef(*steps)[0, 1]) < 0.5  # 168 pairs: 0.08 by chance


@pytest.mark.slow
def test_it_goes_on_where_it_stopped(clip):
    """With its last frame lost, the same command makes that one and keeps the others, and the bytes are the same."""
    out, found = clip
    lost = out / "000004" / "sky" / "clear" / "raw.dng"
    before, kept = lost.read_bytes(), (out / "000001" / "sky" / "clear" / "raw.dng").stat().st_mtime_ns
    lost.unlink()
    done = run("bake", out.parent / "street.usda", "-o", out, *OPTIONS)
    assert done.returncode == 0, done.stderr
    assert json.loads((out / "sequence.json").read_text()) == found
    assert lost.read_bytes() == before
    assert (out / "000001" / "sky" / "clear" / "raw.dng").stat().st_mtime_ns == kept


def test_adaptation_is_an_exponential_of_the_logarithm():
    """Half of the way in stops after tau ln 2, none at once, all where there is no constant; a fixed ISO stays."""
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    metered = camera.Exposure(0.001, 100.0, 50.0)
    tau = 0.4
    half = camera.adapted(metered, (0.004, 400.0), graph, elapsed_s=tau * np.log(2.0), constant_s=tau)
    assert half.exposure_s * half.iso == pytest.approx(np.sqrt(0.001 * 100.0 * 0.004 * 400.0))
    assert camera.adapted(metered, (0.004, 400.0), graph, elapsed_s=0.1, constant_s=0.0) == metered
    fixed = graph.with_overrides({"gain.iso": 200.0})
    kept = camera.adapted(camera.Exposure(0.001, 200.0, 50.0), (0.004, 200.0), fixed, elapsed_s=tau, constant_s=tau)
    assert kept.iso == 200.0
    assert np.log2(kept.exposure_s / 0.001) == pytest.approx(2.0 / np.e)


def test_a_frames_noise_goes_by_its_time_code():
    """Two runs over other frames of one stage share no noise; of frames counted from 0 it is that of their numbers."""
    first, second = ([frame_seed(7, code) for code in frame_codes(text)] for text in ("0:4", "10:14x0.5"))
    assert first == [seed32(7, "frame", number) for number in range(5)]
    assert len({*first, *second}) == len(first) + len(second)


@pytest.mark.parametrize("text", ["three", "0:5x0", "0:99999999", "a:b"])
def test_frames_that_make_no_sense_are_refused(text):
    with pytest.raises(ParameterError, match="--frames"):
        frame_codes(text)


def test_frames_beside_a_frame_are_refused_and_one_code_is_no_sequence():
    with pytest.raises(ParameterError, match="either one time code or several"):
        job_of("no.usda", frame=1, frames="0:2")
    job = job_of("no.usda", frames="12")
    assert job.codes is None and job.plan.frame == 12.0


@pytest.mark.slow
@pytest.mark.skipif(bool(video.available()), reason=video.available())
def test_a_clip_is_read_by_another_decoder(clip, tmp_path):
    """dav1d, which is not the encoder's, finds five frames at 10 a second; and colours of a clip within 6 of 255 of
    what went in.
    """
    import av

    def decoded(path):
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
            assert stream.codec_context.codec.name == "libdav1d"
            return float(stream.average_rate), pictures

    out, found = clip
    assert "clips/sky_clear/srgb.mp4" in found["clips"]
    rate, pictures = decoded(out / "clips" / "sky_clear" / "srgb.mp4")
    assert rate == 10.0
    assert [picture.shape for picture in pictures] == [(28, 48, 3)] * 5
    flat = np.zeros((64, 96, 3), dtype=np.uint8)
    flat[:, :32], flat[:, 32:64], flat[:, 64:] = (200, 60, 40), (40, 180, 70), (50, 60, 210)
    video.write_clip(tmp_path / "flat.mp4", [flat] * 3, per_s=30000 / 1001)
    rate, pictures = decoded(tmp_path / "flat.mp4")
    assert rate == pytest.approx(30000 / 1001)
    for middle in (16, 48, 80):
        np.testing.assert_allclose(pictures[1][32, middle].astype(int), flat[32, middle].astype(int), atol=6)


MOVES = "double3 xformOp:translate.timeSamples = {0: (0, 0, 0), 4: (0, 1, 0), 8: (0, 1, 0)}"


@pytest.mark.parametrize(
    "samples, codes, still",
    [
        (MOVES, (0.0, 1.0), False),
        (MOVES, (4.0, 6.0, 8.0), True),  # it stands from 4 on
        (MOVES.replace("(0, 1, 0)}", "(0, 0, 0)}"), (0.0, 4.0, 8.0), False),  # there and back
    ],
)
@pytest.mark.parametrize("place", ["prim", "variant", "instance"])
def test_a_stage_stands_still_where_no_value_changes_at_its_frames(tmp_path, samples, codes, still, place):
    """Time samples that are not reached, or are all alike, move nothing; a chosen variant and an instance count."""
    order = 'uniform token[] xformOpOrder = ["xformOp:translate"]'
    inside = f'def Cube "Car"\n{{\n{samples}\n{order}\n}}\n'
    text = {
        "prim": inside,
        "variant": 'def Xform "World" (\nvariants = {\nstring look = "b"\n}\nprepend variantSets = ["look"]\n)\n{\n'
        + 'variantSet "look" = {\n"a" {\n}\n"b" {\n'
        + inside
        + "}\n}\n}\n",
        "instance": f'class "Kit"\n{{\n{inside}}}\ndef Xform "One" (\ninstanceable = true\n'
        + "prepend references = </Kit>\n)\n{\n}\n",
    }[place]
    (tmp_path / "a.usda").write_text("#usda 1.0\n" + text)
    assert usd.stands_still(usd.open_stage(tmp_path / "a.usda"), codes) is still


MOVING = """#usda 1.0
(
    upAxis = "Z"
    metersPerUnit = 1
    startTimeCode = 0
    endTimeCode = 3
    timeCodesPerSecond = 10
)
def Xform "World"
{
    def Xform "Rig"
    {
        double3 xformOp:translate.timeSamples = { 0: (0, 0, 1.5), 3: (0, 1, 1.5) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
        def Camera "Left"
        {
            float3 xformOp:rotateXYZ = (90, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
        }
        def Camera "Right"
        {
            double3 xformOp:translate = (0.5, 0, 0)
            float3 xformOp:rotateXYZ = (90, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
        }
    }
    def Cube "Block"
    {
        double size = 1
        double3 xformOp:translate = (2, 12, 0.5)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Cube "Car"
    {
        double size = 2
        double3 xformOp:translate.timeSamples = { 0: (-2, 9, 1), 3: (1, 10, 1) }
        float xformOp:rotateZ.timeSamples = { 0: 20, 3: 40 }
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    }
    def Mesh "Ground"
    {
        point3f[] points = [(-50, -50, 0), (50, -50, 0), (50, 200, 0), (-50, 200, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        token subdivisionScheme = "none"
    }
    def DomeLight "Sky"
    {
        float inputs:intensity = 1000
    }
}
"""
SMALL = dict(resolution=(48, 28), samples=2, quality="reference", fog="clear", adaptation=0)


def stage_of(tmp_path, text=MOVING):
    (tmp_path / "a.usda").write_text(text)
    return tmp_path / "a.usda"


def as_alone(path, tmp_path, frames):
    """That frame 2 of a clip has all of the light, noise and labels of a bake of it alone; the clip's folder."""
    sf.bake(path, tmp_path / "clip", frames=frames, **SMALL)
    sf.bake(path, tmp_path / "alone", frame=2, **{key: value for key, value in SMALL.items() if key != "adaptation"})
    one, other = tmp_path / "clip" / "000002", tmp_path / "alone"
    np.testing.assert_array_equal(*(tifffile.imread(next(folder.rglob("raw.dng"))) for folder in (one, other)))
    for name in ("labels.exr", "labels.json", "sky/clear/radiance.exr", "sky/clear/instances.json"):
        name = name.replace("sky", next(path.parent.parent.name for path in one.rglob("radiance.exr")))
        if name.endswith(".json"):
            assert json.loads((one / name).read_text()) == json.loads((other / name).read_text())
            continue
        mine, theirs = (writers.read_exr(folder / name) for folder in (one, other))
        np.testing.assert_array_equal(mine.pixels, theirs.pixels)
    return one.parent


@pytest.mark.slow
def test_a_frame_of_a_clip_is_the_frame_alone(tmp_path):
    """Though in the clip it was begun from the frame before."""
    as_alone(stage_of(tmp_path), tmp_path, "0:3")


@pytest.mark.slow
def test_cuts_teleports_and_what_comes_and_goes_are_as_the_stage_has_them(tmp_path):
    """The camera is 5 km away in frame 2, beyond which a scene has another origin; the car jumps by 20 m, and the block
    is to be seen in frame 0 alone.
    """
    text = (
        MOVING.replace("{ 0: (0, 0, 1.5), 3: (0, 1, 1.5) }", "{ 0: (0, 0, 1.5), 1: (0, 0, 1.5), 2: (5000, 3, 1.5) }")
        .replace("{ 0: (-2, 9, 1), 3: (1, 10, 1) }", "{ 0: (-2, 9, 1), 1: (3, 28, 1), 2: (5001, 14, 1) }")
        .replace(
            "double size = 1\n", 'double size = 1\ntoken visibility.timeSamples = { 0: "inherited", 1: "invisible" }\n'
        )
    )
    clip = as_alone(stage_of(tmp_path, text), tmp_path, "0:2")
    cut, jump = json.loads((clip / "sequence.json").read_text())["warnings"]
    assert cut.startswith("/World/Rig/Left cuts at the time code 2:")
    assert jump.startswith("/World/Car jumps 19.6 m to the time code 1,")
    shown, numbers = [], dict[str, int]()
    for number in range(3):
        rows = json.loads((clip / f"{number:06d}" / "labels.json").read_text())["instances"]
        assert all(numbers.setdefault(row["path"], row["id"]) == row["id"] for row in rows)
        shown.append({row["path"]: row["distance_m"] for row in rows if row["pixels"]})
    assert [("/World/Block" in paths, "/World/Car" in paths) for paths in shown] == [
        (True, True),
        (False, True),
        (False, True),
    ]
    assert [round(paths["/World/Car"]) for paths in shown] == [8, 27, 10]
    ids = {row["path"]: row["id"] for row in rows}
    paths = clip / "000001" / "flow.exr", clip / "000001" / "labels.exr"
    planes, labels = (writers.read_exr(path, quantity=Quantity.DATA) for path in paths)
    ground = labels.pixels[..., labels.channels.index("instance.ID")] == ids["/World/Ground"]
    assert ground.any() and np.isfinite(planes.pixels).all()
    assert (planes.pixels[ground][:, planes.channels.index("forward.seen")] < 1.0).all()


@pytest.mark.slow
def test_a_clip_of_a_rig_is_a_clip_for_each_camera(tmp_path):
    """`rig.json` lists them, and exports find all their pictures."""
    manifests = sf.bake(stage_of(tmp_path), tmp_path / "out", frames="0:1", camera="/World/Rig", **SMALL).manifest
    assert [len(one["frames"]) for one in manifests] == [2, 2]
    listed = json.loads((tmp_path / "out" / "rig.json").read_text())["cameras"]
    assert [row["folder"] for row in listed] == ["Left", "Right"]
    found = [(one.camera, one.moment.frame) for one in pictures(tmp_path / "out")]
    assert found == [(f"/World/Rig/{eye}", number) for eye in ("Left", "Right") for number in (0, 1)]
    for number in (0, 1):
        image = writers.read_exr(tmp_path / "out" / "Left" / f"{number:06d}" / "labels.exr", quantity=Quantity.DATA)
        depth, disparity = (image.pixels[..., image.channels.index(name)] for name in ("depth.Z", "disparity.X"))
        told = json.loads((tmp_path / "out" / "Left" / f"{number:06d}" / "camera.json").read_text())
        np.testing.assert_allclose(disparity, told["camera_matrix_px"][0][0] * 0.5 / depth, rtol=1e-5)


@pytest.mark.slow
def test_a_clip_of_one_frame_has_no_flow_and_a_rate(tmp_path):
    manifest = sf.bake(stage_of(tmp_path), tmp_path / "out", frames="2:2", **SMALL).manifest
    assert [row["time_code"] for row in manifest["frames"]] == [2.0] and manifest["frames_per_s"] == 10.0
    assert not list((tmp_path / "out").rglob("flow.exr"))
    assert json.loads((tmp_path / "out" / "tracks.json").read_text())["tracks"] == []


@pytest.mark.slow
def test_frames_outside_of_the_stage_are_told(tmp_path):
    manifest = sf.bake(stage_of(tmp_path), tmp_path / "out", frames="3:4", **SMALL).manifest
    assert [text for text in manifest["warnings"] if "outside" in text] == [
        "1 of 2 frames lie outside of the stage's time codes 0 to 3, beyond which nothing moves"
    ]


def test_a_stage_without_a_rate_makes_no_clip(tmp_path):
    path = stage_of(tmp_path, MOVING.replace("timeCodesPerSecond = 10", "timeCodesPerSecond = 0"))
    done = run("bake", path, "-o", tmp_path / "out", "--frames", "0:3")
    assert done.returncode == 2 and "timeCodesPerSecond is 0, so that its frames have no time" in done.stderr


def test_a_clip_too_large_for_its_disk_is_refused_before_its_first_frame(tmp_path, monkeypatch, caplog):
    """Hours and gigabytes come first, and nothing is rendered."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9 - 10**6, 10**6))
    caplog.set_level("INFO", "synfog_usd")
    with pytest.raises(OutputError, match=r"10000 frames take about 1.9 GB more, and 0.001 GB are free"):
        sf.bake(stage_of(tmp_path), tmp_path / "out", frames="0:9999", **SMALL)
    assert re.search(r"10000 frames take \S+ h to \S+ h on \d+ cores, and about 1.9 GB", caplog.text)
    assert not list((tmp_path / "out").rglob("*.exr"))


@pytest.mark.parametrize("codes", [(), (0.0, 0.0), (0.0, 1.0, 3.0), (0.0, float("nan")), (float("inf"),)])
def test_time_codes_that_make_no_video_are_refused(codes):
    with pytest.raises(ParameterError, match="--frames"):
        job_of("no.usda", frames=codes)


def test_frames_keep_the_samples_of_the_first_until_they_need_twice_as_many():
    """Of a view through fog, told that a picture needs 1.9 and 2.1 times its samples; 6 of 7 are all that there are."""
    fog = scene({**sky(), "shape_wall": wall(50.0, 5.0, bsdf={"type": "diffuse"})}, [uniform_fog()])
    integrator = models.make("path", load(fog, boundaries=False))
    few = [{name: 2 for name in integrator.estimators}, {name: 4 for name in integrator.estimators}]
    for needs, limit, more in ((1.9, 16, False), (2.1, 16, True), (2.1, 7, False)):
        error = Error(np.ones((9, 16)), np.ones((9, 16)), needs**0.5)
        found = adaptive.accumulate_denoised(
            integrator, target=Target(mottle=1.0, samples=limit), seed=1, kept=few,
            denoised=lambda made, error=error: (made.luminance().reshape(9, 16), error),
        )  # fmt: skip
        assert found.rounds[:2] == few and (len(found.rounds) > 2) is more, needs


@pytest.mark.slow
def test_a_still_view_in_fog_keeps_its_light_and_fog_that_lifts_is_another(tmp_path):
    """Two frames of standing things in fog differ in the sensor's noise alone; a third has its own fog."""
    text = MOVING.replace("3: (0, 1, 1.5)", "3: (0, 0, 1.5)").replace("3: (1, 10, 1)", "3: (-2, 9, 1)")
    fog = (
        'def Cube "Fog" (\nprepend apiSchemas = ["SynFogMediumAPI"]\n)\n{\ndouble size = 300\n'
        "float synfog:fog:mor.timeSamples = { 0: 60, 1: 60, 2: 120 }\n}\n"
    )
    text = text.replace("3: 40", "3: 20").replace('    def Cube "Block"', fog + '    def Cube "Block"')
    options = SMALL | {"fog": "authored", "quality": "draft", "samples": 8}
    found = sf.bake(stage_of(tmp_path, text), tmp_path / "clip", frames="0:2", **options).manifest
    rows = [
        json.loads((tmp_path / "clip" / frame["folder"] / "bake.json").read_text())["shots"][0]
        for frame in found["frames"]
    ]
    light = [writers.read_exr(path).pixels for path in sorted((tmp_path / "clip").rglob("radiance.exr"))]
    assert rows[0]["rounds"] == rows[1]["rounds"] and [row["mor_m"] for row in rows] == [60.0, 60.0, 120.0]
    np.testing.assert_array_equal(light[0], light[1])
    assert (light[1] != light[2]).mean() > 0.9
    raws = [tifffile.imread(path) for path in sorted((tmp_path / "clip").glob("0*/**/raw.dng"))]
    assert (raws[0] != raws[1]).mean() > 0.5


KILLED = ("--frames", "0:2", "--fog", "clear", "--resolution", "48x28", "--samples", "2", "--quality", "reference")


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """Three frames made in one go: the stage, and the hash of every file."""
    folder = tmp_path_factory.mktemp("unbroken")
    done = run("bake", stage_of(folder), "-o", folder / "out", *KILLED)
    assert done.returncode == 0, done.stderr
    return folder / "a.usda", hashes(folder / "out")


def hashes(out):
    return {str(path.relative_to(out)): files.sha256_of(path) for path in out.rglob("*") if path.is_file()}


def killed_at_random(unbroken, out, seed):
    """kill -9 of the command, or of it and the child that does the work, once a number of files is there and a moment
    has passed; then the same command again.
    """
    stage, truth = unbroken
    rng = random.Random(seed)
    files_then, moment_s, together = rng.randrange(len(truth)), rng.uniform(0.0, 0.1), rng.random() < 0.5
    words = command("bake", stage, "-o", out, *KILLED)
    child = subprocess.Popen(words, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True)
    while child.poll() is None and sum(path.is_file() for path in out.rglob("*")) < files_then:
        time.sleep(0.002)
    time.sleep(moment_s)
    killed = child.poll() is None
    if killed:
        (os.killpg if together else os.kill)(child.pid, signal.SIGKILL)
    child.wait()
    time.sleep(0.3)  # its child sees that it is gone
    left = sum(path.is_file() for path in out.rglob("*"))
    done = run("bake", stage, "-o", out, *KILLED)
    assert done.returncode == 0, (seed, done.stderr)
    assert hashes(out) == truth, (seed, killed, left)
    print(f"killed with {left} of {len(truth)} files" if killed else "ended before it was killed")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_clip_that_is_killed_at_any_moment_goes_on_to_the_same_bytes(unbroken, tmp_path, seed):
    killed_at_random(unbroken, tmp_path / "out", seed)


@pytest.mark.physics
@pytest.mark.parametrize("seed", range(100, 120))
def test_twenty_kills_of_a_clip_end_with_the_same_bytes(unbroken, tmp_path, seed):
    killed_at_random(unbroken, tmp_path / "out", seed)

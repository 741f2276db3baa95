"""Frames one after the other: noise that is new, patterns that stay, exposure that follows, clips that other programs
read.
"""

import json
import os

import numpy as np
import pytest
import tifffile
from support.cli import run
from support.stages import street

from synfog_usd import camera
from synfog_usd import stage as usd
from synfog_usd.base import resources
from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.base.seeds import frame_seed, seed32
from synfog_usd.camera.writers import video
from synfog_usd.dataset.plan import BakePlan, frame_codes
from synfog_usd.dataset.sequence import bake_sequence

STEP = "float inputs:intensity.timeSamples = { 1: 4000, 2: 32000 }"


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """Four frames of a street whose sky is eight times as bright from the third on: the folder."""
    folder = tmp_path_factory.mktemp("sequence")
    text = street(sky=123.0).replace("float inputs:intensity = 123.0", STEP)
    assert STEP in text
    text = text.replace('    upAxis = "', '    startTimeCode = 0\n    timeCodesPerSecond = 10\n    upAxis = "', 1)
    (folder / "street.usda").write_text(text)
    done = run(
        *["bake", folder / "street.usda", "-o", folder / "out", "--frames", "0:3", "--adaptation", "0.2"],
        *[
            "--fog",
            "clear",
            "--lighting",
            "sky",
            "--resolution",
            "48x28",
            "--samples",
            "4",
            "--quality",
            "reference",
            "--json",
        ],
    )
    assert done.returncode == 0, done.stderr
    return folder / "out", json.loads(done.stdout)


def exposures(found):
    return np.array([np.prod(row["exposures"]["sky"]) for row in found["frames"]])


@pytest.mark.slow
def test_the_exposure_follows_with_its_time_constant(clip):
    """Light rises by 3 EV before the third frame; frames of 0.1 s, a time constant of 0.2 s: what is left of the way
    falls by exp(-1/2) from frame to frame.
    """
    _, found = clip
    assert found["frames_per_s"] == 10.0
    ev = np.log2(exposures(found))
    wanted = ev[0] - 3.0 * (1.0 - np.exp([0.0, 0.0, -0.5, -1.0]))
    np.testing.assert_allclose(ev, wanted, atol=0.02)  # EV; each frame is metered on 64 samples of its own


@pytest.mark.slow
def test_each_frame_is_a_bake_and_a_frame_of_cinemadng(clip):
    """NAME_NNNNNN.dng in a folder of its own; FrameRate and TimeCodes as tifffile reads them: 00:00:00:03 for the
    fourth; the same file as the frame's raw.dng.
    """
    out, found = clip
    assert "clips/sky_clear/raw" in found["clips"]
    raws = sorted((out / "clips" / "sky_clear" / "raw").iterdir())
    assert [path.name for path in raws] == [f"raw_{number:06d}.dng" for number in range(4)]
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
    assert len({row["seed"] for row in found["frames"]}) == 4
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
    """With its third frame lost, the same command makes that one and keeps the others, and the bytes are the same."""
    out, found = clip
    lost = out / "000002" / "sky" / "clear" / "raw.dng"
    before, kept = lost.read_bytes(), (out / "000001" / "sky" / "clear" / "raw.dng").stat().st_mtime_ns
    lost.unlink()
    done = run(
        *["bake", out.parent / "street.usda", "-o", out, "--frames", "0:3", "--adaptation", "0.2"],
        *[
            "--fog",
            "clear",
            "--lighting",
            "sky",
            "--resolution",
            "48x28",
            "--samples",
            "4",
            "--quality",
            "reference",
            "--json",
        ],
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == found
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


@pytest.mark.parametrize("text", ["", "3", "0:", "0:5x0", "5:0x1", "0:1e9", "0:99999999", "a:b"])
def test_frames_that_make_no_sense_are_refused(text):
    with pytest.raises(ParameterError, match="--frames"):
        frame_codes(text)


def test_frames_beside_a_frame_are_refused(tmp_path):
    done = run("bake", tmp_path / "no.usda", "--frame", "1", "--frames", "0:2")
    assert done.returncode == 2
    assert "either one time code or several" in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(bool(video.available()), reason=video.available())
def test_a_clip_is_read_by_another_decoder(clip, tmp_path):
    """dav1d, which is not the encoder's, finds four frames at 10 a second; and colours of a clip within 6 of 255 of
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
    assert [picture.shape for picture in pictures] == [(28, 48, 3)] * 4
    flat = np.zeros((64, 96, 3), dtype=np.uint8)
    flat[:, :32], flat[:, 32:64], flat[:, 64:] = (200, 60, 40), (40, 180, 70), (50, 60, 210)
    video.write_clip(tmp_path / "flat.mp4", [flat] * 3, per_s=30000 / 1001)
    rate, pictures = decoded(tmp_path / "flat.mp4")
    assert rate == pytest.approx(30000 / 1001)
    for middle in (16, 48, 80):
        np.testing.assert_allclose(pictures[1][32, middle].astype(int), flat[32, middle].astype(int), atol=6)


@pytest.mark.skipif(bool(video.available()), reason=video.available())
@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="the system has no such classes")
def test_a_clip_leaves_the_process_no_more_urgent_than_it_was(tmp_path):
    """The encoder takes the real-time class where it may, as root."""
    before = os.sched_getscheduler(0)
    video.write_clip(tmp_path / "grey.mp4", [np.full((32, 48, 3), 90, dtype=np.uint8)] * 2, per_s=10)
    assert os.sched_getscheduler(0) == before


@pytest.mark.skipif(bool(video.available()), reason=video.available())
def test_pictures_of_two_sizes_make_no_clip(tmp_path):
    pictures = [np.zeros((32, 32, 3), dtype=np.uint8), np.zeros((32, 48, 3), dtype=np.uint8)]
    with pytest.raises(OutputError, match="pictures of 48 x 32 and 32 x 32 in one clip"):
        video.write_clip(tmp_path / "two.mp4", pictures, per_s=24.0)
    assert not list(tmp_path.iterdir())


MOVES = "double3 xformOp:translate.timeSamples = {0: (0, 0, 0), 4: (0, 1, 0), 8: (0, 1, 0)}"


@pytest.mark.parametrize(
    "samples, codes, still",
    [
        ("", (0.0, 1.0, 2.0), True),
        (MOVES, (0.0, 1.0), False),
        (MOVES, (4.0, 6.0, 8.0), True),  # it stands from 4 on
        (MOVES, (20.0, 30.0), True),  # beyond the last sample
        (MOVES, (2.0,), True),
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


def test_a_video_of_a_still_is_told(tmp_path):
    """In a line, and in sequence.json; not where a lighting that is baked changes."""
    stage = tmp_path / "street.usda"
    stage.write_text(street())
    plan = BakePlan(stage, tmp_path / "out", lighting=("sky",), fog=("clear",), size=(32, 18), samples=2)
    told = []
    found, _ = bake_sequence(plan, (0.0, 1.0), log=told.append)
    assert found["warnings"] == ["nothing changes between the time codes 0 and 1: the video is a still"]
    assert len([line for line in told if "the video is a still; animate it" in line]) == 1
    stage.write_text(
        street().replace("float inputs:exposure = -5", "float inputs:exposure.timeSamples = {0: -5, 2: -4}")
    )
    for lighting, warned in (("sky", 1), ("active", 0)):
        plan = BakePlan(stage, tmp_path / lighting, lighting=(lighting,), fog=("clear",), size=(32, 18), samples=2)
        assert len(bake_sequence(plan, (0.0, 1.0))[0]["warnings"]) == warned


@pytest.mark.skipif(bool(video.available()), reason="clips need PyAV")
def test_a_clip_is_written_without_its_encoders_words(tmp_path, capfd):
    video.write_clip(tmp_path / "a.mp4", [np.zeros((32, 32, 3), np.uint8)] * 2, per_s=24.0)
    assert capfd.readouterr() == ("", "")


def test_fewer_frames_leave_no_old_ones_in_the_clips(tmp_path):
    """What an earlier run has beyond is set aside with a line; frames' own folders stay. How light it is is said once,
    and again where it changes.
    """
    stage, out, told = tmp_path / "street.usda", tmp_path / "out", []
    text = street(sky=123.0).replace("float inputs:intensity = 123.0", STEP.replace("1: 4000, 2", "1: 4000, 1.5"))
    stage.write_text(text)
    plan = BakePlan(stage, out, lighting=("sky",), fog=("clear",), size=(32, 18), samples=2)
    bake_sequence(plan, (0.0, 1.0, 2.0), log=told.append)
    light = [line for line in told if "on open ground" in line]
    assert [line.partition(":")[0] for line in light] == ["frame 0", "frame 2"]
    assert len([line for line in told if "this view has" in line]) == 1
    raws = out / "clips/sky_clear/raw"
    third = (raws / "raw_000002.dng").read_bytes()
    (raws / "notes.txt").write_text("of a user")
    told.clear()
    found, _ = bake_sequence(plan, (0.0, 1.0), log=told.append)
    assert sorted(path.name for path in raws.iterdir()) == ["notes.txt", "raw_000000.dng", "raw_000001.dng"]
    assert (out / "earlier-1/clips/sky_clear/raw/raw_000002.dng").read_bytes() == third
    assert (out / "000002/sky/clear/raw.dng").is_file() and len(found["frames"]) == 2
    (line,) = [line for line in told if "earlier" in line]
    assert line == f"{out}: 1 file of an earlier bake of other frames moved from clips to {out / 'earlier-1/clips'}"
    told.clear()
    bake_sequence(plan, (0.0, 1.0), log=told.append)
    assert not [line for line in told if "earlier" in line]

"""`synfog-usd preview`: what it leaves, and that it draws again on each save."""

import json
import signal
import subprocess

import pytest
from PIL import Image
from support.cli import command, run
from support.stages import street


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    path = tmp_path_factory.mktemp("stage") / "street.usda"
    path.write_text(street(lamp=True), encoding="utf-8")
    return path


def small(stage, out, *more):
    """One shot, tiny."""
    arguments = ("--resolution", "32x18", "--samples", "2", "--lighting", "sky", "--fog", "mor150")
    return ["preview", stage, "-o", out, *arguments, *more]


def test_a_preview_is_a_small_denoised_bake(stage, tmp_path):
    """The picture has the size that was asked for, it is denoised, and has no labels."""
    done = run(*small(stage, tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    row = json.loads((tmp_path / "out" / "bake.json").read_text())["shots"][0]
    with Image.open(tmp_path / "out" / "sky" / "mor150" / "srgb.png") as picture:
        assert picture.size == (32, 18) and row["denoised"]
    assert "1 pictures in" in done.stdout and (tmp_path / "out" / "contact.png").is_file()
    assert not list((tmp_path / "out").glob("labels*"))


@pytest.mark.slow
def test_each_save_of_any_layer_is_drawn_and_errors_are_shown(tmp_path):
    """A sublayer changes, breaks and is mended: two pictures differ, the fault is one line, and the third is as the
    first; Ctrl-C ends it.
    """
    (tmp_path / "base.usda").write_text(street(lamp=True), encoding="utf-8")
    (tmp_path / "top.usda").write_text(
        '#usda 1.0\n(\n    defaultPrim = "World"\n    metersPerUnit = 1\n    upAxis = "Z"\n'
        "    subLayers = [@./over.usda@, @./base.usda@]\n)\n"
    )
    over, good = tmp_path / "over.usda", "#usda 1.0\n"
    over.write_text(good)
    out = tmp_path / "out"
    child = subprocess.Popen(
        command(*small(tmp_path / "top.usda", out, "--watch")),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    told: list[str] = []

    def until(word):
        for line in child.stdout:
            told.append(line)
            if word in line:
                return (out / "sky" / "mor150" / "srgb.png").read_bytes()
        raise AssertionError("".join(told))

    try:
        pictures = [until("1 pictures in")]
        over.write_text(
            '#usda 1.0\nover "World"\n{\n    over "Wall"\n    {\n        token visibility = "invisible"\n    }\n}\n'
        )
        pictures.append(until("1 pictures in"))
        assert "over.usda saved\n" in told
        (tmp_path / "top.usda").rename(tmp_path / "away")
        until("synfog-usd: ")
        (tmp_path / "away").rename(tmp_path / "top.usda")
        over.write_text(good)
        pictures.append(until("1 pictures in"))
        assert pictures[0] == pictures[2] != pictures[1]
        assert "Traceback" not in "".join(told)
        child.send_signal(signal.SIGINT)
        assert child.wait(20) == 130
    finally:
        child.kill()
        child.wait()
        child.stdout.close()

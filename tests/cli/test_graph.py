"""`synfog-usd graph` as a camera engineer runs it."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from synfog_usd import writers
from synfog_usd.image import Image, Quantity

PIPELINE = Path(__file__).resolve().parents[2] / "pipeline" / "phone.yaml"


def run(*arguments):
    return subprocess.run([sys.executable, "-m", "synfog_usd.cli.main", "graph", *map(str, arguments)], capture_output=True, text=True, timeout=120)


@pytest.fixture
def radiance(tmp_path):
    """A ramp of 100 to 2000 nits, as the bake writes it."""
    pixels = np.repeat(np.linspace(100, 2000, 64, dtype=np.float32)[None, :, None], 36, axis=0).repeat(3, axis=2)
    writers.write_exr(tmp_path / "in.exr", Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 50.0}))
    return tmp_path / "in.exr"


def test_a_graph_runs_on_a_picture_of_one_s_own(radiance, tmp_path):
    """The graph's outputs are written, the nodes' times are told, and a second run gives the same bytes."""
    for name in ("a", "b"):
        done = run("run", PIPELINE, "--in", f"radiance={radiance}", "-o", tmp_path / name, "--seed", "5")
        assert done.returncode == 0, done.stderr
        assert "isp.demosaic" in done.stderr
    for name in ("raw.dng", "srgb.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_until_writes_that_node_and_set_changes_it(radiance, tmp_path):
    """Twice the exposure time gives twice the electrons, within the noise of 2304 pixels."""
    means = []
    for name, time_s in (("a", "0.001"), ("b", "0.002")):
        done = run("run", PIPELINE, "--in", radiance, "-o", tmp_path / name, "--until", "shot_noise", "--set", f"expose.exposure_s={time_s}")
        assert done.returncode == 0, done.stderr
        means.append(writers.read_exr(tmp_path / name / "shot_noise.exr").pixels.mean())
    assert abs(means[1] / means[0] - 2.0) < 0.02


@pytest.mark.parametrize(
    "more, word",
    [
        (["--in", "none.exr"], "none.exr"),
        (["--in", "light=in.exr"], "radiance"),
        (["--in", "{radiance}", "--set", "adc.bit=12"], "'bits'"),
        (["--in", "{radiance}", "--set", "adc"], "NODE.PARAMETER=VALUE"),
        (["--in", "{radiance}", "--until", "shotnoise"], "shot_noise"),
    ],
)
def test_what_cannot_be_run_is_one_line(radiance, tmp_path, more, word):
    """Missing file, unknown input, unknown parameter, no value, unknown node."""
    done = run("run", PIPELINE, "-o", tmp_path / "out", *(text.format(radiance=radiance) for text in more))
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    assert word in done.stderr and not (tmp_path / "out").exists()


def test_show_and_check_tell_the_nodes():
    """As a table, as Mermaid text, and in one line."""
    assert "sensor.shot_noise" in run("show", PIPELINE).stdout
    assert run("show", PIPELINE, "--mermaid").stdout.startswith(("flowchart", "graph"))
    assert "raw.dng" in run("check", PIPELINE).stdout

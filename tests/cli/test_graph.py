"""`synfog-usd graph` as a camera engineer runs it."""

import re
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import tifffile
from support import cli

from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers

PIPELINE = Path(__file__).resolve().parents[2] / "pipeline" / "phone.yaml"


def run(*arguments):
    return cli.run("graph", *arguments)


@pytest.fixture
def radiance(tmp_path):
    """A ramp of 100 to 2000 nits, as the bake writes it."""
    pixels = np.repeat(np.linspace(100, 2000, 64, dtype=np.float32)[None, :, None], 36, axis=0).repeat(3, axis=2)
    writers.write_exr(
        tmp_path / "in.exr", Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 50.0})
    )
    return tmp_path / "in.exr"


def test_a_graph_runs_on_a_picture_of_one_s_own(radiance, tmp_path):
    """The graph's outputs are written, the nodes' times are told, and a second run gives the same bytes."""
    for name in ("a", "b"):
        done = run("run", PIPELINE, "--in", f"radiance={radiance}", "-o", tmp_path / name, "--seed", "5")
        assert done.returncode == 0, done.stderr
        assert "isp.demosaic" in done.stderr
    for name in ("raw.dng", "srgb.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def foreign(path, pixels, *planes) -> Path:
    """An EXR of another program, without any attribute of ours; a further plane is called Z."""
    buffer = OpenImageIO.ImageBuf(np.ascontiguousarray(np.dstack([pixels, *planes]), dtype=np.float32))
    buffer.specmod().channelnames = ("R", "G", "B", "Z")[: 3 + len(planes)]
    assert buffer.write(str(path))
    return path


def test_a_foreign_picture_needs_no_more_than_the_command_says(tmp_path):
    """Without a field of view it is that of lens and pixels, and the RAW file's focal length the lens's; with --fov the
    one that such a view needs.
    """
    picture = foreign(tmp_path / "shot.exr", np.full((64, 96, 3), 300.0))
    own = 2 * np.degrees(np.arctan(96 * 1.4e-3 / 2 / 4.38))
    for name, more, focal_mm, told in (
        ("own", (), 4.38, f"{own:.4g} degrees, of 96 pixels"),
        ("fov", ("--fov", "60"), 96 * 1.4e-3 / 2 / np.tan(np.pi / 6), "60 degrees"),
    ):
        done = run("run", PIPELINE, "--in", picture, "-o", tmp_path / name, *more)
        assert done.returncode == 0 and told in done.stderr, done.stderr
        with tifffile.TiffFile(tmp_path / name / "raw.dng") as file:
            above, below = file.pages[0].tags[34665].value["FocalLength"]
        assert above / below == pytest.approx(focal_mm, rel=1e-4)
    done = run("run", PIPELINE, "--in", picture, "-o", tmp_path / "no", "--fov", "200")
    assert done.returncode == 2 and "a field of view of 200 degrees is not above 0" in done.stderr


def test_depth_is_found_in_a_bake_and_in_the_picture_itself(radiance, tmp_path):
    """A near post and sky, focused on the post by the phone's lens: what lies behind it loses contrast, it does not.
    Metering leaves the blur out.  Depth of another size, and none, are refused in a line.
    """
    graph = tmp_path / "deep.yaml"
    graph.write_text(
        "synfog: graph/1\nextends: phone\ninputs: {radiance: radiance, depth: data}\nnodes:\n"
        "  - {name: focus, op: optics.depth_of_field, in: [irradiance, depth], focus_m: 0.3, after: irradiance}\n"
    )
    pixels = np.full((36, 64), 500.0, np.float32)
    pixels[:, ::2] = 1000.0
    depth = np.full((36, 64), np.inf, np.float32)
    depth[:, :20] = 0.3
    folder = tmp_path / "bake" / "sky" / "clear"
    folder.mkdir(parents=True)
    rgb = Image(pixels[..., None].repeat(3, axis=2), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 50.0})
    writers.write_exr(folder / "radiance.exr", rgb)
    plane = Image(depth[..., None], ("depth.Z",), Quantity.DATA)
    arguments = "run", graph, "--in", folder / "radiance.exr", "--until", "focus", "-o"
    none = run(*arguments, tmp_path / "none")
    assert none.returncode == 2 and "give --in depth=FILE.exr" in none.stderr and "labels.exr" in none.stderr
    writers.write_exr(tmp_path / "bake" / "labels.exr", plane)
    found = run(*arguments, tmp_path / "a")
    assert found.returncode == 0 and "depth: depth.Z of" in found.stderr and "labels.exr" in found.stderr, found.stderr
    assert run(*arguments, tmp_path / "b", "--in", f"depth={tmp_path / 'bake' / 'labels.exr'}").returncode == 0
    assert (tmp_path / "a" / "focus.exr").read_bytes() == (tmp_path / "b" / "focus.exr").read_bytes()
    light = writers.read_exr(tmp_path / "a" / "focus.exr").pixels[18, :, 1]
    assert abs(light[5] / light[4] - 2.0) < 0.05 or abs(light[4] / light[5] - 2.0) < 0.05
    assert abs(light[45] / light[44] - 1.0) < 0.2
    own = foreign(tmp_path / "own.exr", rgb.pixels, depth)
    assert "depth: Z of" in run("run", graph, "--in", own, "--fov", "50", "-o", tmp_path / "c").stderr
    other = run(*arguments, tmp_path / "d", "--in", f"depth={radiance}")
    assert other.returncode == 2 and "no channel depth.Z or Z tells the depth" in other.stderr


def test_light_that_cannot_be_is_refused_or_mended(radiance, tmp_path):
    """One line with the pixel, nothing written; with --repair the run goes on and says what it mended."""
    pixels = writers.read_exr(radiance).pixels.copy()
    pixels[7, 9, 1] = np.nan
    writers.write_exr(
        tmp_path / "bad.exr",
        Image(pixels, ("R", "G", "B"), Quantity.DATA, provenance={"fov_x_deg": 50.0}),
        attributes={"synfog:quantity": "radiance"},
    )
    arguments = ("run", PIPELINE, "--in", tmp_path / "bad.exr", "-o", tmp_path / "out", "--until", "irradiance")
    done = run(*arguments)
    assert (
        done.returncode == 2
        and "x=9, y=7, channel 'G' is not a number" in done.stderr
        and "--repair" in done.stderr
        and not (tmp_path / "out").exists()
    )
    done = run(*arguments, "--repair")
    assert done.returncode == 0 and "1 values that light cannot have were mended" in done.stderr
    assert np.isfinite(writers.read_exr(tmp_path / "out" / "irradiance.exr").pixels).all()


@pytest.mark.parametrize(
    "more, word",
    [
        (["--in", "none.exr"], "none.exr"),
        (["--in", "{radiance}", "--set", "adc.bit=12"], "'bits'"),
        (["--in", "{radiance}", "--until", "shotnoise"], "shot_noise"),
    ],
)
def test_what_cannot_be_run_is_one_line(radiance, tmp_path, more, word):
    """Missing file, unknown parameter, unknown node."""
    done = run("run", PIPELINE, "-o", tmp_path / "out", *(text.format(radiance=radiance) for text in more))
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    assert word in done.stderr and not (tmp_path / "out").exists()


def test_show_and_check_tell_the_nodes():
    """As a table, as Mermaid text, and in one line."""
    assert "sensor.shot_noise" in run("show", PIPELINE).stdout
    assert run("show", PIPELINE, "--mermaid").stdout.startswith(("flowchart", "graph"))
    assert "raw.dng" in run("check", PIPELINE).stdout


def test_until_takes_an_output_and_set_the_words_of_the_camera(radiance, tmp_path, monkeypatch):
    """`--until raw` writes raw.dng, here, and nothing behind it runs; ISO 400 is in its tags (DNG: 34855)."""
    import tifffile

    monkeypatch.chdir(tmp_path)
    done = run("run", PIPELINE, "--in", f"radiance={radiance}", "--set", "sensor.iso=400", "--until", "raw")
    assert done.returncode == 0 and done.stdout.strip() == "raw.dng" and "iso=400" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.exr", "raw.dng"]
    with tifffile.TiffFile("raw.dng") as raw:
        assert raw.pages[0].tags["ExifTag"].value["ISOSpeedRatings"] == 400


def test_explain_prints_a_page_or_a_list():
    assert "| `iso` | a number from 1 to 1e+07 or auto | auto | ISO speed. |" in run("explain", "sensor.gain").stdout
    assert re.search(r"^isp\.tone +Brighter middle", run("explain").stdout, flags=re.MULTILINE)
    done = run("explain", "sensor.gian")
    assert done.returncode == 2 and "Did you mean 'sensor.gain'?" in done.stderr and "Traceback" not in done.stderr

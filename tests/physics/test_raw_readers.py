"""Our RAW files in the programs that photographers and engineers use.

Rationale: a DNG is right when programs that know nothing of us read the numbers
exactly and make the colour of them that our tags promise.  The pictures are those of
`support.raws`: a grey wall, a bright patch at the top left, and as much noise as
makes a lossless file larger than 100 kB, below which RawTherapee takes nothing for
RAW.  A grey must have channels that are equal to 0.5 % of it: rounding of the
matrices and of the 12-bit numbers of a grey of 0.18 gives up to 0.2 %.

Programs that are not there are skipped.  Debian 12: exiftool, dcraw, libraw-bin,
darktable, rawtherapee, exiv2.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
from support import raws

from synfog_usd import camera
from synfog_usd.base import resources, seeds
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers import dng, write_dng, write_output

pytestmark = pytest.mark.physics

PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR", "RCCB", "RCCC", "RGIB", "MONO")
COMPRESSIONS = ("none", "lossless")
KNEES = [[240, 240], [1264, 1264], [17648, 2288], [1048575, 4095]]
HDR = {"companding": KNEES, "black_level_dn": 240, "linear_black_dn": 240, "linear_white_dn": 1048575}
FILES = [f"{pattern}-{compression}" for pattern in (*PATTERNS, "HDR", "ODD") for compression in COMPRESSIONS]
GREY_TOLERANCE = 0.005


def wall(height=480, width=720) -> np.ndarray:
    """(H, W) brightness: 0.18 with noise of 5 DN of 4095, and a bright corner at the top left."""
    level = 0.18 + seeds.stream(0, "wall").normal(0.0, 5 / 4095, (height, width))
    level[:72, :108] = 0.8
    return level


def hdr() -> Image:
    """The wall in 20 bits, companded to 12."""
    level = wall()
    linear = raws.scene("RGGB", level, bits=20, black=240).pixels[..., 0]
    codes = np.rint(np.interp(linear, *np.array(KNEES, dtype=float).T))
    return Image(codes[..., None].astype(np.float32), ("CFA",), Quantity.DN, provenance=raws.metadata("RGGB", **HDR))


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, tuple[Path, Image]]:
    """Name -> file and what it was made of."""
    folder = tmp_path_factory.mktemp("raws")
    images = {pattern: raws.scene(pattern, wall()) for pattern in PATTERNS} | {
        "HDR": hdr(),
        "ODD": raws.scene("GBRG", wall(481, 721)),
    }
    made = {}
    for name in FILES:
        kind, compression = name.split("-")
        made[name] = folder / f"{name}.dng", images[kind]
        write_dng(*made[name], compression=compression)
        assert made[name][0].stat().st_size > 100_000
    return made


def run(program: str, *arguments, cwd: Path, home: Path | None = None) -> subprocess.CompletedProcess:
    """Run a program that must be there, in a folder of its own."""
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(home or cwd), "LC_ALL": "C"}
    return subprocess.run([program, *map(str, arguments)], cwd=cwd, env=environment, capture_output=True, timeout=300)


def numbers(image: Image) -> np.ndarray:
    """What a reader should have after the LinearizationTable; worked out from the knees."""
    raw = image.pixels[..., 0]
    if "companding" not in image.provenance:
        return raw
    linear, codes = np.array(KNEES, dtype=float).T
    return np.rint(np.interp(raw, codes, linear) * 65535 / 1048575)


def assert_wall(picture: np.ndarray, *, grey: bool = True) -> None:
    """Upright, neither mirrored nor turned, and neutral."""
    picture = picture.astype(float).reshape(*picture.shape[:2], -1)
    height, width = picture.shape[:2]
    assert abs(height - 480) <= 32 and abs(width - 720) <= 32, "turned or cropped too much"
    corners = [
        picture[row, column].mean()
        for row in (slice(20, 50), slice(-50, -20))
        for column in (slice(20, 80), slice(-80, -20))
    ]
    assert corners[0] > 1.5 * max(corners[1:]), f"the bright corner is not at the top left: {corners}"
    channels = picture[150:-50, 150:-50].mean(axis=(0, 1))
    assert not grey or np.ptp(channels) < GREY_TOLERANCE * channels.mean(), f"grey came out as {channels}"


def pnm(data: bytes) -> np.ndarray:
    """(H, W) of a binary PGM."""
    head = re.match(rb"P5\s+(\d+)\s+(\d+)\s+(\d+)\s", data)
    width, height, top = (int(value) for value in head.groups())
    return np.frombuffer(data, ">u2" if top > 255 else "u1", offset=head.end()).reshape(height, width)


@pytest.mark.parametrize("name", FILES)
def test_exiftool_finds_nothing_to_complain_of(files, tmp_path, name):
    done = run("exiftool", "-validate", "-warning", "-error", "-a", files[name][0], cwd=tmp_path)
    assert re.fullmatch(r"Validate\s*: OK\s*", done.stdout.decode()) and not done.stderr, (
        done.stdout.decode() + done.stderr.decode()
    )


@pytest.mark.parametrize("name", FILES)
def test_exiv2_reads_the_tags(files, tmp_path, name):
    done = run("exiv2", "-pa", files[name][0], cwd=tmp_path)
    assert (
        done.returncode == 0
        and not done.stderr
        and b"Exif.Photo.ExposureTime                      Rational    1  1/60 s" in done.stdout
    )


@pytest.mark.parametrize("name", FILES)
def test_dcraw_reads_the_exact_numbers(files, tmp_path, name):
    path, image = files[name]
    done = run("dcraw", "-D", "-4", "-c", path, cwd=tmp_path)
    assert done.returncode == 0 and not done.stderr, done.stderr.decode()
    np.testing.assert_array_equal(pnm(done.stdout), numbers(image))


@pytest.mark.parametrize("name", FILES)
def test_dcraw_renders_it_upright_and_neutral(files, tmp_path, name):
    """It warns of grey sensors that there is no white balance; that is so."""
    done = run("dcraw", "-w", "-4", "-T", "-c", files[name][0], cwd=tmp_path)
    assert done.returncode == 0
    grey_sensor = name.startswith(("MONO", "RCCC"))
    assert done.stderr.decode().endswith("Cannot use camera white balance.\n") if grey_sensor else not done.stderr
    (tmp_path / "a.tif").write_bytes(done.stdout)
    assert_wall(tifffile.imread(tmp_path / "a.tif"))


@pytest.mark.parametrize("name", FILES)
def test_rawpy_reads_the_exact_numbers_and_renders_them(files, name):
    path, image = files[name]
    with rawpy.imread(str(path)) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, numbers(image))
        assert_wall(raw.postprocess(gamma=(1, 1), no_auto_bright=True, use_camera_wb=True, output_bps=16))


GRAPHS = [
    path
    for path in sorted(resources.folder("pipeline").glob("*.yaml"))
    if any(name.endswith(".dng") for name in camera.load_graph(path).outputs)
]


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("path", GRAPHS, ids=lambda path: path.stem)
def test_the_raw_file_of_every_shipped_graph_is_exact_and_clean(tmp_path, path, compression):
    """A street-like picture of 320 x 240 from the graph; rawpy has the numbers, exiftool no complaint, and a grey is
    grey.

    Without aberrations: a red image that is half a pixel smaller is 0.7 % brighter where there are so few pixels.
    """
    graph = camera.load_graph(path)
    graph = graph.without([node.name for node in graph.nodes_with("optics.aberrations")])
    pixels = np.full((240, 320, 3), 400.0, np.float32)
    pixels[:60, :80] = 1500.0
    pixels[:, 300:] *= seeds.stream(0, "street").random((240, 20, 3), dtype=np.float32)
    view = {} if graph.nodes_with("optics.fisheye") else {"fov_x_deg": 5.0}
    radiance = Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance=view)
    (name,) = (name for name in graph.outputs if name.endswith(".dng"))
    image = camera.develop(graph, dict.fromkeys(graph.inputs, radiance), seed=3, until=name)[graph.outputs[name]]
    write_output(name, image, tmp_path, options={"compression": compression})
    table = dng.linearisation(image.provenance)[0] if "companding" in image.provenance else np.arange(65536)
    with rawpy.imread(str(tmp_path / name)) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, table[image.pixels[..., 0].astype(int)])
        picture = raw.postprocess(gamma=(1, 1), no_auto_bright=True, use_camera_wb=True, output_bps=16).astype(float)
    channels = picture[100:220, 40:260].mean(axis=(0, 1))
    spread = picture[100:220, 40:260].std(axis=(0, 1)).max() / np.sqrt(
        120 * 220 / 4
    )  # of a mean over the pixels of one colour
    metadata = image.provenance
    if not graph.nodes_with(
        "sensor.shot_noise"
    ):  # every pixel of a colour is rounded alike, by up to half a DN before white balance
        spread = (
            0.2
            * 65535
            / (metadata["white_level_dn"] - metadata["black_level_dn"])
            / min(metadata.get("as_shot_neutral", [1.0]))
        )
    assert (
        picture[10:40, 10:60].mean() > 1.5 * channels.mean()
        and np.ptp(channels) < GREY_TOLERANCE * channels.mean() + 5 * spread
    )
    if shutil.which("exiftool"):
        test = run("exiftool", "-validate", "-warning", "-error", "-a", tmp_path / name, cwd=tmp_path)
        assert re.fullmatch(r"Validate\s*: OK\s*", test.stdout.decode()), test.stdout.decode()

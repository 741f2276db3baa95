"""RAW files go in as they came out, and through the second half of the camera to the same picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rawpy
from support import cli, raws

from synfog_usd import camera
from synfog_usd.base import seeds
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import writers


@pytest.fixture(scope="module")
def shot():
    """RAW numbers and picture of the shipped phone: smooth colours, 96 x 128."""
    from scipy.ndimage import gaussian_filter

    pixels = gaussian_filter(seeds.stream(0, "raw").random((96, 128, 3), dtype=np.float32), (4, 4, 0)) * np.float32(900)
    radiance = Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})
    graph = camera.load_graph(Path("phone"))
    return graph.run(
        {"radiance": radiance},
        seed=1,
        settings=camera.meter(radiance, graph).settings,
        overrides={"lens_shading.strength": 0, "denoise.strength": 0},
    )


@pytest.mark.parametrize("compression", ["none", "lossless"])
def test_a_dng_comes_back_as_it_was(shot, tmp_path, compression):
    adc = shot["adc"]
    writers.write_output("a.dng", adc, tmp_path, options={"compression": compression})
    read = writers.read_raw(tmp_path / "a.dng")
    np.testing.assert_array_equal(read.pixels, adc.pixels)
    metadata, ours = read.provenance, adc.provenance
    assert (metadata["cfa_pattern"], metadata["black_level_dn"], metadata["white_level_dn"]) == ("RGGB", 64.0, 1023.0)
    np.testing.assert_allclose(metadata["as_shot_neutral"], ours["as_shot_neutral"], rtol=1e-5)
    np.testing.assert_allclose(metadata["noise_profile"], ours["noise_profile"], rtol=1e-9)
    np.testing.assert_allclose(metadata["camera_to_rec709"], shot["colour"].provenance["colour_matrix"], atol=5e-4)
    assert metadata["exposure_s"] == pytest.approx(ours["exposure_s"], rel=1e-4) and metadata["iso"] == 55


def test_the_second_half_alone_makes_the_same_picture(shot, tmp_path):
    """By the command line, from the DNG: within one of 255 of the picture that the whole camera made (its matrix has
    four digits in the file).
    """
    writers.write_output("a.dng", shot["adc"], tmp_path)
    done = cli.run("graph", "run", "raw", "--in", tmp_path / "a.dng", "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    linear = writers.read_exr(tmp_path / "linear.exr")
    assert linear.quantity is Quantity.LINEAR_RGB
    np.testing.assert_allclose(linear.pixels, shot["colour"].pixels, atol=1 / 255)


def test_a_dng_of_jpeg_xl_is_the_one_it_was_made_of(shot, tmp_path):
    """Packed as Adobe's converter packs a mosaic: lossless here, in tiles, rows and columns of a colour together.  One
    that is cut off, or whose last tile declares another size, is one line.
    """
    import imagecodecs
    import tifffile

    writers.write_output("a.dng", shot["adc"], tmp_path)
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        page = next(page for first in file.pages for page in (first, *(first.pages or ())) if page.photometric == 32803)
        stored = page.asarray()
        tags = {tag.code: tag for page in (file.pages[0], page) for tag in page.tags.values()}
        kept = [(tag.code, int(tag.dtype), tag.count, tag.value, True) for tag in tags.values() if tag.code > 33000]
        kept = [tag for tag in kept if tag[0] not in (34665, 50706, 50707)]
    fields = np.vstack([np.hstack([stored[down::2, right::2] for right in (0, 1)]) for down in (0, 1)])
    packed = tmp_path / "packed.dng"
    with tifffile.TiffWriter(packed) as file:
        more = [(50706, 1, 4, bytes((1, 7, 0, 0)), True), (50975, 3, 1, 2, True), (52547, 3, 1, 2, True)]
        file.write(
            fields, photometric=32803, compression=52546, tile=(64, 64), metadata=None, extratags=sorted([*kept, *more])
        )
    with rawpy.imread(str(packed)) as raw, pytest.raises(rawpy.LibRawError):
        raw.unpack()
    found, plain = writers.read_raw(packed), writers.read_raw(tmp_path / "a.dng")
    np.testing.assert_array_equal(found.pixels, plain.pixels)
    for key in ("cfa_pattern", "black_level_dn", "white_level_dn", "as_shot_neutral", "camera_to_rec709"):
        assert found.provenance[key] == plain.provenance[key]
    whole = packed.read_bytes()
    with tifffile.TiffFile(packed) as file:
        offset, length = file.pages[0].dataoffsets[-1], file.pages[0].databytecounts[-1]
    bomb = imagecodecs.jpegxl_encode(np.zeros((4000, 4000), np.uint16), lossless=True, effort=1)
    assert len(bomb) < length + len(whole) - offset
    packed.write_bytes(whole[:offset] + bomb.ljust(len(whole) - offset, b"\0"))
    with pytest.raises(ImageError, match=r"packed\.dng: its JPEG XL .* shape=\(4000, 4000\)"):
        writers.read_raw(packed)
    packed.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ImageError, match=r"packed\.dng: "):
        writers.read_raw(packed)


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG"])
def test_patterns_and_blacks_of_each_filter_are_read(pattern, tmp_path):
    path = tmp_path / "a.dng"
    writers.write_dng(
        path, Image(np.full((32, 40, 1), 100.0, np.float32), ("CFA",), Quantity.DN, provenance=raws.metadata(pattern))
    )
    read = writers.read_raw(path)
    with rawpy.imread(str(path)) as raw:
        assert read.provenance["black_level_dn"] == raw.black_level_per_channel[0]
    assert read.provenance["cfa_pattern"] == pattern and read.pixels.shape == (32, 40, 1)


def test_what_is_no_mosaic_is_refused_in_one_line(tmp_path):
    (tmp_path / "no.dng").write_bytes(b"II*\0 this is none")
    with pytest.raises(ImageError, match=r"no\.dng: cannot be read as RAW"):
        writers.read_raw(tmp_path / "no.dng")
    with pytest.raises(ImageError, match="no such file"):
        writers.read_raw(tmp_path / "none.nef")
    grey = Image(np.full((32, 40, 1), 100.0, np.float32), ("CFA",), Quantity.DN, provenance=raws.metadata("MONO"))
    writers.write_dng(tmp_path / "grey.dng", grey)
    with pytest.raises(ImageError, match=r"grey\.dng: "):
        writers.read_raw(tmp_path / "grey.dng")


def test_a_raw_file_is_no_light(tmp_path):
    """A graph that begins with radiance says so, and the one for RAW files needs no sensor but the file."""
    writers.write_dng(
        tmp_path / "a.dng",
        Image(np.full((32, 40, 1), 100.0, np.float32), ("CFA",), Quantity.DN, provenance=raws.metadata("RGGB")),
    )
    done = cli.run("graph", "run", "phone", "--in", tmp_path / "a.dng", "-o", tmp_path / "out")
    assert (
        done.returncode == 2 and "input 'radiance' of graph 'phone' takes radiance; the image holds dn" in done.stderr
    )
    done = cli.run(
        "graph", "run", "raw", "--in", tmp_path / "a.dng", "-o", tmp_path / "out", "--set", "colour.illuminant=a"
    )
    assert done.returncode == 2 and "name one at the top with 'sensor: ...', or set illuminant: as_shot" in done.stderr

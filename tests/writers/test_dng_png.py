"""DNG and PNG as other programs read them: LibRaw (rawpy), tifffile, OpenImageIO."""

from __future__ import annotations

import struct

import numpy as np
import OpenImageIO
import pytest
import rawpy
import tifffile

from synfog_usd import camera, resources, seeds
from synfog_usd.errors import ImageError, OutputError
from synfog_usd.image import Image, Quantity
from synfog_usd.writers import write_dng, write_output, write_png


@pytest.fixture(scope="module")
def mosaic() -> Image:
    """A coloured test picture from the shipped phone: 96 x 128 DN."""
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    pixels = seeds.stream(0, "dng").random((96, 128, 3), dtype=np.float32) * np.float32(1500)
    radiance = Image(pixels, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})
    return graph.run({"radiance": radiance}, seed=1, settings={"exposure_s": 1 / 800, "iso": 110}, until="adc")["adc"]


def exif_of(path) -> dict[int, tuple]:
    """Exif tags by number, read from the bytes with the TIFF 6.0 layout, not with the writer."""
    data = path.read_bytes()
    assert data[:4] == b"II*\0"

    def ifd(start):
        (count,) = struct.unpack_from("<H", data, start)
        return {entry[0]: entry[1:] for entry in (struct.unpack_from("<HHI4s", data, start + 2 + 12 * index) for index in range(count))}

    first = ifd(struct.unpack_from("<I", data, 4)[0])
    assert list(first) == sorted(first), "TIFF wants tags in rising order"
    found = {}
    for code, (kind, count, raw) in ifd(struct.unpack("<I", first[34665][2])[0]).items():
        (place,) = struct.unpack("<I", raw)
        found[code] = (
            struct.unpack_from("<II", data, place)
            if kind == 5
            else struct.unpack("<HH", raw)[:1]
            if kind == 3
            else (data[place : place + count] if count > 4 else raw)
        )
    return found


def test_libraw_reads_the_exact_numbers_and_what_they_mean(mosaic, tmp_path):
    write_dng(tmp_path / "a.dng", mosaic)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, mosaic.pixels[..., 0].astype(np.uint16))
        assert raw.black_level_per_channel == [64, 64, 64, 64] and raw.white_level == 1023
        np.testing.assert_array_equal(raw.raw_pattern, [[0, 1], [3, 2]])  # LibRaw calls the second green 3
        assert raw.color_desc == b"RGBG"
        balance = np.array(raw.camera_whitebalance[:3])
        np.testing.assert_allclose(balance / balance[1], mosaic.provenance["as_shot_neutral"][1] / np.array(mosaic.provenance["as_shot_neutral"]), rtol=1e-5)


def test_libraw_renders_grey_neutral_and_colours_as_our_own_processor(tmp_path):
    """An even grey and an even red field: LibRaw's linear rendering with our tags against our white balance and matrix."""
    graph = camera.load_graph(resources.folder("pipeline") / "linear_exr.yaml")
    for rgb in ([900.0, 900.0, 900.0], [900.0, 300.0, 200.0], [200.0, 400.0, 900.0]):
        radiance = Image(np.broadcast_to(np.array(rgb, np.float32), (128, 128, 3)).copy(), ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 5.0})
        run = graph.run({"radiance": radiance}, seed=1, settings={"exposure_s": 1 / 500, "iso": 55})
        write_dng(tmp_path / "a.dng", run["adc"])
        with rawpy.imread(str(tmp_path / "a.dng")) as raw:
            out = raw.postprocess(gamma=(1, 1), no_auto_bright=True, use_camera_wb=True, output_bps=16)
        theirs = out[16:-16, 16:-16].mean(axis=(0, 1)) / 65535
        ours = run["colour"].pixels[16:-16, 16:-16].mean(axis=(0, 1), dtype=np.float64)
        np.testing.assert_allclose(theirs / theirs.sum(), ours / ours.sum(), atol=0.004)  # 0.07 CIEDE2000 is usual between them
        if rgb[0] == rgb[2]:
            assert np.ptp(theirs) < 0.004 * theirs.mean() + 1e-3


def test_every_tag_that_readers_need_is_there(mosaic, tmp_path):
    write_dng(tmp_path / "a.dng", mosaic)
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        page = file.pages[0]
        np.testing.assert_array_equal(page.asarray(), mosaic.pixels[..., 0])
        tags = {tag.code: tag.value for tag in page.tags}
    assert (tags[254], tags[258], tags[259], tags[262], tags[277]) == (0, 16, 1, 32803, 1)
    assert tags[33421] == (2, 2) and bytes(tags[33422]) == b"\0\1\1\2"
    assert bytes(tags[50706]) == b"\1\4\0\0" and tags[50713] == (2, 2) and tags[50714] == (64, 1) * 4 and tags[50717] == 1023
    assert tags[50829] == (0, 0, 96, 128) and tags[50719] == (8, 8) and tags[50720] == (112, 80)
    assert tags[50778] == 21
    matrix = np.array(tags[50721]).reshape(9, 2)
    np.testing.assert_allclose((matrix[:, 0] / matrix[:, 1]).reshape(3, 3), mosaic.provenance["xyz_to_camera"], atol=1e-4)
    np.testing.assert_allclose(tags[51041], mosaic.provenance["noise_profile"] * 3, rtol=1e-12)


def test_exif_says_how_it_was_taken(mosaic, tmp_path):
    write_dng(tmp_path / "a.dng", mosaic)
    exif = exif_of(tmp_path / "a.dng")
    assert (exif[33434], exif[33437], exif[34855], exif[37386]) == ((1, 800), (173, 100), (110,), (219, 50))
    assert exif[36864] == b"0231"


def test_the_same_image_gives_the_same_bytes(mosaic, tmp_path):
    for name in ("a.dng", "b.dng"):
        write_dng(tmp_path / name, mosaic)
    assert (tmp_path / "a.dng").read_bytes() == (tmp_path / "b.dng").read_bytes()


@pytest.mark.parametrize("shape", [(2, 2), (5, 7), (31, 33), (32, 34)])
def test_small_and_odd_pictures_are_written_whole(mosaic, tmp_path, shape):
    small = mosaic.with_pixels(mosaic.pixels[: shape[0], : shape[1]])
    write_dng(tmp_path / "a.dng", small)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.dng"), small.pixels[..., 0])


def test_what_is_no_raw_picture_is_refused(mosaic, tmp_path):
    path = tmp_path / "a.dng"
    with pytest.raises(ImageError, match=r"a DNG needs black_level_dn, .* in the image's provenance"):
        write_dng(path, Image(mosaic.pixels, ("CFA",), Quantity.DN))
    with pytest.raises(ImageError, match="takes a DN mosaic of one channel; this image is electrons"):
        write_dng(path, Image(mosaic.pixels, ("CFA",), Quantity.ELECTRONS, provenance=mosaic.provenance))
    for value in (0.5, -1.0, 1024.0, np.nan):
        pixels = mosaic.pixels.copy()
        pixels[3, 3] = value
        with pytest.raises(ImageError, match="are not whole numbers from 0 to 1023"):
            write_dng(path, mosaic.with_pixels(pixels))
    assert not list(tmp_path.iterdir())


def test_a_png_holds_the_rounded_values(tmp_path):
    """0 to 1 becomes 0 to 255; halves are rounded to the even number."""
    values = np.array([0.0, 1.0, 0.5, 0.499, 2.0, -1.0, 100.4 / 255, 100.6 / 255], np.float32)
    image = Image(np.repeat(values.reshape(2, 4, 1), 3, axis=2), ("R", "G", "B"), Quantity.DISPLAY_RGB)
    write_png(tmp_path / "a.png", image)
    buf = OpenImageIO.ImageBuf(str(tmp_path / "a.png"))
    assert buf.spec().format == OpenImageIO.UINT8
    np.testing.assert_array_equal(np.asarray(buf.get_pixels(OpenImageIO.UINT8))[..., 1].ravel(), [0, 255, 128, 127, 255, 0, 100, 101])
    write_png(tmp_path / "b.png", image)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_png_takes_only_pictures_for_a_screen(tmp_path):
    with pytest.raises(ImageError, match="takes display_rgb; this image is linear_rgb"):
        write_png(tmp_path / "a.png", Image(np.zeros((2, 2, 3), np.float32), ("R", "G", "B"), Quantity.LINEAR_RGB))
    with pytest.raises(ImageError, match="1 or 3 channels"):
        write_png(tmp_path / "a.png", Image(np.zeros((2, 2, 2), np.float32), ("R", "G"), Quantity.DISPLAY_RGB))
    with pytest.raises(ImageError, match="holds NaN"):
        write_png(tmp_path / "a.png", Image(np.full((2, 2, 1), np.nan, np.float32), ("Y",), Quantity.DISPLAY_RGB))


@pytest.mark.parametrize("name", ["../a.png", "/tmp/a.png", "a/b.png", "..", "", "a\\b.png", "a.jpg", "a"])
def test_outputs_have_plain_names_and_known_formats(tmp_path, name):
    with pytest.raises(OutputError, match="output"):
        write_output(name, Image(np.zeros((2, 2, 3), np.float32), ("R", "G", "B"), Quantity.DISPLAY_RGB), tmp_path)
    assert not list(tmp_path.iterdir())


def test_write_output_picks_the_format_and_makes_the_folder(mosaic, tmp_path):
    for name in ("raw.dng", "RAW2.DNG", "electrons.exr"):
        path = write_output(name, mosaic, tmp_path / "new" / "folder")
        assert path == tmp_path / "new" / "folder" / name and path.stat().st_size > 1000

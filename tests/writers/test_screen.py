"""PNG, TIFF and JPEG XL as other programs read them: OpenImageIO, tifffile, imagecodecs, pillow; and what writes any
file.
"""

from __future__ import annotations

import json
import time

import imagecodecs
import numpy as np
import OpenImageIO
import pytest
import tifffile
from PIL import Image as Pillow
from support import raws

from synfog_usd.base import seeds
from synfog_usd.base.errors import ImageError, OutputError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers import read_exr, write_jxl, write_output, write_png, write_tiff


def picture(channels=("R", "G", "B"), quantity=Quantity.DISPLAY_RGB, shape=(37, 53), scale=1.0) -> Image:
    pixels = seeds.stream(0, "screen").random((*shape, len(channels)), dtype=np.float32) * np.float32(scale)
    return Image(pixels, channels, quantity, provenance={"exposure_s": 0.01, "sensor": "grün"})


def whole(image: Image, bits: int) -> np.ndarray:
    """Rounded in double precision; a float32 may lie so near a half that it is rounded the other way, so compare within
    1 of 65535.
    """
    return np.floor(image.pixels.astype(np.float64) * (2**bits - 1) + 0.5)


def test_a_png_holds_the_rounded_values(tmp_path):
    """0 to 1 becomes 0 to 255; halves are rounded to the even number."""
    values = np.array([0.0, 1.0, 0.5, 0.499, 2.0, -1.0, 100.4 / 255, 100.6 / 255], np.float32)
    image = Image(np.repeat(values.reshape(2, 4, 1), 3, axis=2), ("R", "G", "B"), Quantity.DISPLAY_RGB)
    write_png(tmp_path / "a.png", image)
    buf = OpenImageIO.ImageBuf(str(tmp_path / "a.png"))
    assert buf.spec().format == OpenImageIO.UINT8
    np.testing.assert_array_equal(
        np.asarray(buf.get_pixels(OpenImageIO.UINT8))[..., 1].ravel(), [0, 255, 128, 127, 255, 0, 100, 101]
    )
    write_png(tmp_path / "b.png", image)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("channels, bits, kind", [(("R", "G", "B"), 8, np.uint8), (("Y",), 16, np.uint16)])
def test_a_tiff_for_a_screen_holds_the_rounded_values(tmp_path, bits, kind, channels):
    write_tiff(tmp_path / "a.tif", picture(channels), bits=bits)
    read = tifffile.imread(tmp_path / "a.tif")
    assert read.dtype == kind and read.shape == ((37, 53, 3) if len(channels) == 3 else (37, 53))
    np.testing.assert_allclose(read.reshape(37, 53, -1), whole(picture(channels), bits), atol=1)
    if bits == 8:
        np.testing.assert_array_equal(np.asarray(Pillow.open(tmp_path / "a.tif")), read)


@pytest.mark.parametrize(
    ("channels", "quantity"),
    [
        (("R", "G", "B"), Quantity.LINEAR_RGB),
        (("a", "b", "c", "d", "e"), Quantity.RADIANCE),
    ],
)
def test_a_tiff_of_floats_is_exact_and_says_what_it_holds(tmp_path, channels, quantity):
    image = picture(channels, quantity, scale=1e5)
    write_tiff(tmp_path / "a.tif", image, bits=32)
    read = tifffile.imread(tmp_path / "a.tif")
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read.reshape(37, 53, -1), image.pixels)
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        page = file.pages[0]
        assert page.tags[306].value == "2000:01:01 00:00:00" and page.compression == tifffile.COMPRESSION.ADOBE_DEFLATE
        told = json.loads(page.description)
    assert told == {
        "quantity": quantity.value,
        "channels": list(channels),
        "provenance": {"exposure_s": 0.01, "sensor": "grün"},
    }


def test_a_tiff_is_16_bits_for_a_screen_and_floats_else_unless_it_is_told(tmp_path):
    write_tiff(tmp_path / "a.tif", picture())
    write_tiff(tmp_path / "b.tif", picture(quantity=Quantity.LINEAR_RGB))
    assert [tifffile.imread(tmp_path / name).dtype for name in ("a.tif", "b.tif")] == [np.uint16, np.float32]


@pytest.mark.parametrize("bits", [8, 16])
def test_a_lossless_jpeg_xl_is_exact(tmp_path, bits):
    """Read by libjxl through another binding than that which wrote it."""
    write_jxl(tmp_path / "a.jxl", picture(), bits=bits)
    read = imagecodecs.jpegxl_decode((tmp_path / "a.jxl").read_bytes())
    assert read.dtype == (np.uint8 if bits == 8 else np.uint16) and read.shape == (37, 53, 3)
    np.testing.assert_allclose(read, whole(picture(), bits), atol=1)
    assert (read == whole(picture(), bits)).mean() > 0.99


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.tif", {"bits": 16}),
        ("a.jxl", {"lossless": False}),
        ("a.jpg", {"quality": 75}),
        ("a.png", {"bits": 16}),
    ],
)
def test_the_same_picture_gives_the_same_bytes_whenever_it_is_written(tmp_path, name, options):
    """OpenImageIO would write the second of the clock into a TIFF."""
    image = picture(shape=(300, 400))
    first = write_output(name, image, tmp_path / "one", options=options).read_bytes()
    if name == "a.tif":
        time.sleep(1.1)
    assert write_output(name, image, tmp_path / "two", options=options).read_bytes() == first


@pytest.mark.parametrize("name", ["a.tif", "a.png", "a.exr", "a.dng"])
def test_what_does_not_fit_leaves_no_file(tmp_path, name):
    bad = picture()
    bad.pixels[3, 4, 1] = np.nan
    for image in (bad, picture(quantity=Quantity.IRRADIANCE).with_pixels(bad.pixels)):
        with pytest.raises(ImageError):
            write_output(name, image, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "quantity", "options", "error", "words"),
    [
        (
            "a.tif",
            Quantity.LINEAR_RGB,
            {"bits": 16},
            ImageError,
            "a TIFF of 16 bits takes display_rgb; this image is linear_rgb. Write 32 bits, or put isp.gamma",
        ),
        ("a.png", Quantity.DISPLAY_RGB, {"bits": 32}, OutputError, "bits is 32; a PNG takes 8 or 16"),
        (
            "a.png",
            Quantity.DISPLAY_RGB,
            {"bit": 8},
            OutputError,
            "output 'a.png' has no 'bit'; it takes bits. Did you mean 'bits'?",
        ),
    ],
)
def test_options_that_a_format_does_not_have_are_refused(tmp_path, name, quantity, options, error, words):
    with pytest.raises(error) as caught:
        write_output(name, picture(quantity=quantity), tmp_path, options=options)
    assert words in str(caught.value) and not list(tmp_path.iterdir())


def test_an_exr_of_the_mosaic_stands_beside_the_raw_file(tmp_path):
    """Electrons and DN as they are: float32 holds every whole number of 24 bits, and half those to 2048."""
    dn = raws.noise("RGGB", bits=16)
    for name, image in (
        ("mosaic.exr", dn),
        ("electrons.exr", dn.with_pixels(dn.pixels * np.float32(1.37), quantity=Quantity.ELECTRONS)),
    ):
        read = read_exr(write_output(name, image, tmp_path))
        np.testing.assert_array_equal(read.pixels, image.pixels)
        assert (read.quantity, read.channels, read.provenance["cfa_pattern"]) == (image.quantity, ("CFA",), "RGGB")
    small = raws.noise("RGGB", bits=11)
    write_output("half.exr", small, tmp_path, options={"half": True, "compression": "piz"})
    np.testing.assert_array_equal(read_exr(tmp_path / "half.exr").pixels, small.pixels)


@pytest.mark.parametrize("name", ["../a.png", "/tmp/a.png", "", "a\\b.png", "a.gif"])
def test_outputs_have_plain_names_and_known_formats(tmp_path, name):
    with pytest.raises(OutputError, match="output"):
        write_output(name, Image(np.zeros((2, 2, 3), np.float32), ("R", "G", "B"), Quantity.DISPLAY_RGB), tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_jpeg_is_close_and_loses_more_at_a_lower_quality(tmp_path):
    """Smooth colours, read by Pillow: at 95 within 3 of 255 RMS, at 30 worse and smaller; grey stays one channel."""
    down, right = np.mgrid[0:64, 0:96] / 96
    smooth = picture().with_pixels(np.stack([down, right, 1.0 - down], axis=-1).astype(np.float32))
    errors, sizes = [], []
    for quality in (30, 95):
        path = write_output("a.jpg", smooth, tmp_path, options={"quality": quality, "subsampling": "4:4:4"})
        with Pillow.open(path) as file:
            read = np.asarray(file.convert("RGB")).astype(float)
        errors.append(np.sqrt(np.mean((read - 255.0 * smooth.pixels) ** 2)))
        sizes.append(path.stat().st_size)
    assert errors[1] < 3.0 and errors[0] > 1.5 * errors[1] and sizes[0] < sizes[1]
    with Pillow.open(write_output("grey.jpg", picture(("Y",)), tmp_path)) as file:
        assert file.mode == "L"

"""PNG and JPEG as other programs read them: OpenImageIO, pillow; and what writes any file."""

from __future__ import annotations

import numpy as np
import OpenImageIO
import pytest
from PIL import Image as Pillow
from support import raws

from synfog_usd.base import seeds
from synfog_usd.base.errors import ImageError, OutputError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers import read_exr, write_output, write_png


def picture(channels=("R", "G", "B"), quantity=Quantity.DISPLAY_RGB, shape=(37, 53)) -> Image:
    pixels = seeds.stream(0, "screen").random((*shape, len(channels)), dtype=np.float32)
    return Image(pixels, channels, quantity, provenance={"exposure_s": 0.01, "sensor": "grün"})


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
    write_png(tmp_path / "deep.png", image, bits=16)
    deep = np.asarray(OpenImageIO.ImageBuf(str(tmp_path / "deep.png")).get_pixels(OpenImageIO.UINT16))[..., 1]
    np.testing.assert_allclose(deep.ravel(), np.clip(values, 0.0, 1.0) * 65535.0, atol=0.51)


@pytest.mark.parametrize(("name", "options"), [("a.jpg", {"quality": 75}), ("a.png", {"bits": 16})])
def test_the_same_picture_gives_the_same_bytes_whenever_it_is_written(tmp_path, name, options):
    image = picture(shape=(300, 400))
    first = write_output(name, image, tmp_path / "one", options=options).read_bytes()
    assert write_output(name, image, tmp_path / "two", options=options).read_bytes() == first


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.exr", "a.dng"])
def test_what_does_not_fit_leaves_no_file(tmp_path, name):
    bad = picture()
    bad.pixels[3, 4, 1] = np.nan
    for image in (bad, picture(quantity=Quantity.IRRADIANCE).with_pixels(bad.pixels)):
        with pytest.raises(ImageError):
            write_output(name, image, tmp_path)
    assert not list(tmp_path.iterdir())


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

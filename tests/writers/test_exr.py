"""EXR: round trips, equal bytes, and refusals that name the pixel."""

from __future__ import annotations

import time

import numpy as np
import OpenImageIO
import pytest

from synfog_usd.base import seeds
from synfog_usd.base.errors import ImageError, OutputError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers import read_exr, write_exr


def image(channels=("R", "G", "B"), quantity=Quantity.RADIANCE, shape=(11, 17), **provenance) -> Image:
    pixels = seeds.stream(0, "exr", *channels).random((*shape, len(channels)), dtype=np.float32) * np.float32(1e5)
    return Image(pixels, channels, quantity, provenance=provenance)


def foreign(path, pixels, channels, *, data_window=None, **attributes) -> None:
    """A file that another program wrote: no attributes of ours.

    data_window: x and y of the pixels, and width and height of the display window.
    """
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], OpenImageIO.FLOAT)
    spec.channelnames = channels
    if data_window:
        spec.x, spec.y, spec.full_width, spec.full_height = data_window
    for name, value in attributes.items():
        kinds = {2: OpenImageIO.TypeDesc(OpenImageIO.FLOAT, OpenImageIO.VEC2), 8: OpenImageIO.TypeDesc("float[8]")}
        spec.attribute(name, kinds[len(value)], value) if isinstance(value, tuple) else spec.attribute(name, value)
    out = OpenImageIO.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(pixels.astype(np.float32)) and out.close()


@pytest.mark.parametrize(
    ("channels", "quantity"),
    [
        (("R", "G", "B"), Quantity.RADIANCE),
        (("S0.450,000000nm", "S0.550,000000nm", "S0.1000,000000nm"), Quantity.RADIANCE),
        (("CFA",), Quantity.ELECTRONS),
        (("depth.Z", "N.X", "N.Y", "N.Z", "A"), Quantity.DATA),
    ],
)
def test_what_is_written_is_read_back_exactly(tmp_path, channels, quantity):
    written = image(channels, quantity, exposure_s=0.01, shot="a b ü", matrix=[[1.5, 2.0]])
    write_exr(tmp_path / "a.exr", written)
    read = read_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(read.pixels, written.pixels)
    assert (read.channels, read.quantity, read.provenance) == (channels, quantity, written.provenance)


def test_the_same_image_gives_the_same_bytes_whenever_it_is_written(tmp_path):
    """OpenImageIO would write the second of the clock."""
    write_exr(tmp_path / "a.exr", image())
    time.sleep(1.1)
    write_exr(tmp_path / "b.exr", image())
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_other_programs_find_the_standard_attributes(tmp_path):
    write_exr(tmp_path / "a.exr", image(exposure_s=0.02, iso=100.0), attributes={"synfog:mor_m": 150.0})
    source = OpenImageIO.ImageInput.open(str(tmp_path / "a.exr"))
    metadata = {item.name: item.value for item in source.spec().extra_attribs}
    source.close()
    assert metadata["whiteLuminance"] == 1.0 and metadata["synfog:mor_m"] == 150.0 and metadata["isoSpeed"] == 100.0
    assert metadata["chromaticities"][:2] == pytest.approx((0.64, 0.33))
    write_exr(tmp_path / "b.exr", image(("S0.450,000000nm", "S0.550,000000nm")))
    source = OpenImageIO.ImageInput.open(str(tmp_path / "b.exr"))
    assert source.spec().getattribute("emissiveUnits") == "W.m^-2.sr^-1.nm^-1"
    source.close()


def test_several_images_share_a_file_and_can_be_asked_for(tmp_path):
    surface, airlight = (
        image(tuple(f"{layer}.{c}" for c in "RGB"), Quantity.RADIANCE) for layer in ("surface", "airlight")
    )
    write_exr(tmp_path / "layers.exr", [surface, airlight])
    read = read_exr(tmp_path / "layers.exr", channels=airlight.channels)
    np.testing.assert_array_equal(read.pixels, airlight.pixels)
    with pytest.raises(ImageError, match=r"channels surface.B, surface.G, surface.R stand in several images"):
        write_exr(tmp_path / "x.exr", [surface, surface])
    with pytest.raises(ImageError, match="several sizes"):
        write_exr(tmp_path / "x.exr", [surface, image(("Y",), shape=(3, 3))])
    with pytest.raises(ImageError, match="no image"):
        write_exr(tmp_path / "x.exr", [])


def test_half_floats_are_written_on_demand_and_refused_where_they_overflow(tmp_path):
    small = image().with_pixels(image().pixels * np.float32(1e-3))
    write_exr(tmp_path / "half.exr", small, half=True)
    np.testing.assert_array_equal(
        read_exr(tmp_path / "half.exr").pixels, small.pixels.astype(np.float16).astype(np.float32)
    )
    with pytest.raises(ImageError, match="does not fit 16-bit floats"):
        write_exr(tmp_path / "x.exr", image(), half=True)


def test_radiance_from_elsewhere_is_read_by_its_channels(tmp_path):
    """R, G, B out of A, B, G, R and depth; bands in rising order; nothing else."""
    pixels = np.arange(2 * 3 * 5, dtype=np.float32).reshape(2, 3, 5)
    foreign(tmp_path / "rgba.exr", pixels, ("R", "G", "B", "A", "Z"))
    read = read_exr(tmp_path / "rgba.exr")
    np.testing.assert_array_equal(read.pixels, pixels[..., :3])
    assert (read.channels, read.quantity, dict(read.provenance)) == (("R", "G", "B"), Quantity.RADIANCE, {})
    foreign(tmp_path / "bands.exr", pixels[..., :3], ("S0.1000,0nm", "S0.450,0nm", "S0.550,0nm"))
    assert read_exr(tmp_path / "bands.exr").channels == ("S0.450,0nm", "S0.550,0nm", "S0.1000,0nm")
    foreign(tmp_path / "data.exr", pixels[..., :1], ("Z",))
    with pytest.raises(ImageError, match=r"data\.exr: neither R, G, B nor bands .*; it has Z"):
        read_exr(tmp_path / "data.exr")
    assert read_exr(tmp_path / "data.exr", quantity=Quantity.DATA).channels == ("Z",)
    with pytest.raises(ImageError, match="no channel Q; it has Z"):
        read_exr(tmp_path / "data.exr", channels=["Q"])


@pytest.mark.parametrize(
    ("value", "words"), [(np.nan, "not a number"), (np.inf, "infinite"), (-0.5, r"negative \(-0.5\)")]
)
def test_light_that_cannot_be_is_refused_with_its_pixel(tmp_path, value, words):
    pixels = np.ones((4, 6, 3), np.float32)
    pixels[3, 5, 2] = pixels[2, 4, 1] = value
    foreign(tmp_path / "bad.exr", pixels, ("R", "G", "B"))
    with pytest.raises(ImageError, match=rf"bad\.exr: radiance at x=4, y=2, channel 'G' is {words}; 2 values are"):
        read_exr(tmp_path / "bad.exr")


def test_light_that_cannot_be_is_mended_where_that_is_asked_for(tmp_path):
    """A pixel in the corner takes the median of its three neighbours, one without neighbours 0; what is right stays as
    it is.
    """
    pixels = np.ones((4, 6, 3), np.float32)
    pixels[0, 0, 0], pixels[0, 1, 0], pixels[1, 0, 0], pixels[1, 1, 0] = np.nan, 4.0, 5.0, 9.0
    pixels[2, 4, 1] = -3.0
    foreign(tmp_path / "bad.exr", pixels, ("R", "G", "B"))
    wanted = pixels.copy()
    wanted[0, 0, 0], wanted[2, 4, 1] = 5.0, 0.0
    read = read_exr(tmp_path / "bad.exr", repair=True)
    np.testing.assert_array_equal(read.pixels, wanted)
    assert read.provenance["repaired_values"] == 2
    foreign(tmp_path / "one.exr", np.full((1, 1, 3), np.inf), ("R", "G", "B"))
    np.testing.assert_array_equal(read_exr(tmp_path / "one.exr", repair=True).pixels, 0.0)
    foreign(tmp_path / "good.exr", wanted, ("R", "G", "B"))
    assert "repaired_values" not in read_exr(tmp_path / "good.exr", repair=True).provenance


def test_broken_files_are_refused_whatever_their_break(tmp_path):
    write_exr(tmp_path / "whole.exr", image(shape=(64, 64)))
    data = (tmp_path / "whole.exr").read_bytes()
    for size in (0, 3, 40, len(data) // 2, len(data) - 10):
        (tmp_path / "cut.exr").write_bytes(data[:size])
        with pytest.raises(ImageError, match=r"cut\.exr: cannot be read"):
            read_exr(tmp_path / "cut.exr")
    with pytest.raises(ImageError, match=r"none\.exr: no such file"):
        read_exr(tmp_path / "none.exr")
    with pytest.raises(ImageError, match="no such file"):
        read_exr(tmp_path)
    foreign(tmp_path / "picture.png", np.ones((2, 2, 3)), ("R", "G", "B"))
    with pytest.raises(ImageError, match="is a png file; an EXR is needed"):
        read_exr(tmp_path / "picture.png")


def test_a_place_that_cannot_be_written_is_an_error_of_ours(tmp_path):
    (tmp_path / "a.exr").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        write_exr(tmp_path / "a.exr", image())
    assert list(tmp_path.iterdir()) == [tmp_path / "a.exr"]


def test_light_that_is_no_number_is_not_written(tmp_path):
    """DATA may hold it: the depth of the sky."""
    for value in (np.nan, np.inf):
        bad = image(quantity=Quantity.ELECTRONS)
        bad.pixels[5, 7, 1] = value
        with pytest.raises(
            ImageError, match=rf"a\.exr: electrons at x=7, y=5, channel 'G' is {value}; it must be finite"
        ):
            write_exr(tmp_path / "a.exr", [image(("Y",)), bad])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("compression", ["zips", "piz", "none"])
def test_every_compression_is_lossless(tmp_path, compression):
    write_exr(tmp_path / "a.exr", image(), compression=compression)
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr").pixels, image().pixels)
    source = OpenImageIO.ImageInput.open(str(tmp_path / "a.exr"))
    assert source.spec().getattribute("compression") == compression
    source.close()


def test_other_primaries_become_rec709(tmp_path):
    """ACEScg as colour-science converts it (Bradford); white stays; what is out of the gamut is cut at 0, and
    counted.
    """
    import colour

    ap1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    pixels = np.array([[[1.0, 1.0, 1.0], [0.5, 0.4, 0.3], [0.0, 1.0, 0.0]]], np.float32)
    foreign(tmp_path / "ap1.exr", pixels, ("R", "G", "B"), chromaticities=ap1)
    read = read_exr(tmp_path / "ap1.exr")
    expected = colour.RGB_to_RGB(pixels[0, :2], "ACEScg", "sRGB", chromatic_adaptation_transform="Bradford")
    np.testing.assert_allclose(read.pixels[0, :2], expected, atol=2e-4)
    np.testing.assert_allclose(read.pixels[0, 0], 1.0, atol=1e-5)
    assert read.pixels[0, 2].min() == 0.0 and read.provenance["out_of_gamut_values"] == 2
    foreign(
        tmp_path / "709.exr",
        pixels,
        ("R", "G", "B"),
        chromaticities=(0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290),
    )
    np.testing.assert_array_equal(read_exr(tmp_path / "709.exr").pixels, pixels)


def test_the_data_window_stands_where_it_stood(tmp_path):
    """A crop lies in its place with black around; overscan is cut off; a window outside the display is refused."""
    pixels = np.arange(4 * 5 * 3, dtype=np.float32).reshape(4, 5, 3) + 1
    foreign(tmp_path / "crop.exr", pixels, ("R", "G", "B"), data_window=(2, 1, 10, 8))
    read = read_exr(tmp_path / "crop.exr").pixels
    np.testing.assert_array_equal(read[1:5, 2:7], pixels)
    assert read.shape == (8, 10, 3) and read.sum() == pixels.sum()
    foreign(tmp_path / "over.exr", pixels, ("R", "G", "B"), data_window=(-1, -1, 3, 2))
    np.testing.assert_array_equal(read_exr(tmp_path / "over.exr").pixels, pixels[1:3, 1:4])
    foreign(tmp_path / "out.exr", pixels, ("R", "G", "B"), data_window=(20, 1, 10, 8))
    with pytest.raises(ImageError, match=r"out\.exr: its data window lies outside"):
        read_exr(tmp_path / "out.exr")

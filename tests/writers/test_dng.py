"""DNG as other programs read it: LibRaw (rawpy) and tifffile.  More programs: tests/physics/test_raw_readers.py."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import rawpy
import tifffile
from support import raws

from synfog_usd import camera
from synfog_usd.base import resources, seeds
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.writers import write_dng

D65, A = 21, 17
"""Calibration illuminants, by their Exif LightSource numbers."""


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
        return {
            entry[0]: entry[1:]
            for entry in (struct.unpack_from("<HHI4s", data, start + 2 + 12 * index) for index in range(count))
        }

    first = ifd(struct.unpack_from("<I", data, 4)[0])
    assert list(first) == sorted(first), "TIFF wants tags in rising order"
    found = {}
    for code, (kind, count, raw) in ifd(struct.unpack("<I", first[34665][2])[0]).items():
        (place,) = struct.unpack("<I", raw)
        found[code] = (
            struct.unpack_from("<II", data, place)
            if kind == 5
            else struct.unpack_from("<ii", data, place)
            if kind == 10
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
        np.testing.assert_allclose(
            balance / balance[1],
            mosaic.provenance["as_shot_neutral"][1] / np.array(mosaic.provenance["as_shot_neutral"]),
            rtol=1e-5,
        )


def test_libraw_renders_grey_neutral_and_colours_as_our_own_processor(tmp_path):
    """An even grey and an even red field: LibRaw's linear rendering with our tags against our white balance and
    matrix.
    """
    graph = camera.load_graph(resources.folder("pipeline") / "linear_exr.yaml")
    for rgb in ([900.0, 900.0, 900.0], [900.0, 300.0, 200.0], [200.0, 400.0, 900.0]):
        radiance = Image(
            np.broadcast_to(np.array(rgb, np.float32), (128, 128, 3)).copy(),
            ("R", "G", "B"),
            Quantity.RADIANCE,
            provenance={"fov_x_deg": 5.0},
        )
        run = graph.run({"radiance": radiance}, seed=1, settings={"exposure_s": 1 / 500, "iso": 55})
        write_dng(tmp_path / "a.dng", run["adc"])
        with rawpy.imread(str(tmp_path / "a.dng")) as raw:
            out = raw.postprocess(gamma=(1, 1), no_auto_bright=True, use_camera_wb=True, output_bps=16)
        theirs = out[16:-16, 16:-16].mean(axis=(0, 1)) / 65535
        ours = run["colour"].pixels[16:-16, 16:-16].mean(axis=(0, 1), dtype=np.float64)
        np.testing.assert_allclose(
            theirs / theirs.sum(), ours / ours.sum(), atol=0.004
        )  # 0.07 CIEDE2000 is usual between them
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
    assert (
        bytes(tags[50706]) == b"\1\4\0\0"
        and tags[50713] == (2, 2)
        and tags[50714] == (64, 1) * 4
        and tags[50717] == 1023
    )
    assert tags[50829] == (0, 0, 96, 128) and tags[50719] == (8, 8) and tags[50720] == (112, 80)
    assert (tags[50778], tags[50779]) == (A, D65)
    matrix = np.array(tags[50722]).reshape(9, 2)
    np.testing.assert_allclose(
        (matrix[:, 0] / matrix[:, 1]).reshape(3, 3), mosaic.provenance["xyz_to_camera"], atol=1e-4
    )
    np.testing.assert_allclose(tags[51041], mosaic.provenance["noise_profile"] * 3, rtol=1e-12)


def test_exif_says_how_it_was_taken(mosaic, tmp_path):
    write_dng(tmp_path / "a.dng", mosaic)
    exif = exif_of(tmp_path / "a.dng")
    assert (exif[33434], exif[33437], exif[34855]) == ((1, 800), (173, 100), (110,))
    fits_mm = (
        mosaic.width_px * 1.4e-3 / 2 / np.tan(np.radians(mosaic.provenance["fov_x_deg"]) / 2)
    )  # the view on so many pixels of 1.4 um
    assert exif[37386][0] / exif[37386][1] == pytest.approx(fits_mm, rel=1e-6)
    assert exif[36864] == b"0231" and 37380 not in exif
    write_dng(tmp_path / "b.dng", mosaic.with_metadata(exposure_bias_ev=-1.5))
    assert exif_of(tmp_path / "b.dng")[37380] == (-1500, 1000)


@pytest.mark.parametrize("compression", ["none", "lossless"])
def test_the_same_image_gives_the_same_bytes(mosaic, tmp_path, compression):
    for name in ("a.dng", "b.dng"):
        write_dng(tmp_path / name, mosaic, compression=compression)
    assert (tmp_path / "a.dng").read_bytes() == (tmp_path / "b.dng").read_bytes()


PATTERNS = ("RGGB", "GRBG", "GBRG", "BGGR", "RCCB", "RCCC", "RGIB", "MONO")


@pytest.mark.parametrize(
    "pattern, compression, more",
    [
        *((name, "lossless", {}) for name in PATTERNS),
        ("RGGB", "none", {"shape": (22, 22)}),  # LibRaw opens nothing smaller
        ("MONO", "none", {}),
        *(("GBRG", "lossless", {"bits": bits, "shape": (33, 35)}) for bits in (8, 11, 16)),
    ],
)
def test_libraw_and_tifffile_read_the_exact_numbers(tmp_path, pattern, compression, more):
    """Of every pattern, of any bits and of odd sizes."""
    image = raws.noise(pattern, **more)
    write_dng(tmp_path / "a.dng", image, compression=compression)
    numbers = image.pixels[..., 0]
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.dng").reshape(numbers.shape), numbers)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, numbers)
        black, white = (image.provenance[f"{level}_level_dn"] for level in ("black", "white"))
        assert raw.black_level_per_channel == [black] * 4 and raw.white_level == white


def tags_of(path) -> dict:
    with tifffile.TiffFile(path) as file:
        return {tag.code: tag.value for tag in file.pages[0].tags}


def ratios(values) -> np.ndarray:
    return np.array(values[::2]) / np.array(values[1::2])


@pytest.mark.parametrize(
    ("pattern", "codes", "planes", "rows"),
    [
        ("GRBG", (1, 0, 2, 1), (0, 1, 2), "RGB"),
        ("RCCB", (0, 1, 1, 2), (0, 1, 2), "RCB"),
        ("RGIB", (0, 1, 6, 2), (0, 1, 2, 6), "RGBI"),
    ],
)
def test_colour_planes_and_their_matrices_stand_in_one_order(tmp_path, pattern, codes, planes, rows):
    """CFAPlaneColor says which filter a row of the matrices and a number of the neutral belong to; D65 stands last,
    where dcraw looks.
    """
    write_dng(tmp_path / "a.dng", raws.noise(pattern))
    tags = tags_of(tmp_path / "a.dng")
    assert (tuple(tags[33422]), tuple(tags[50710]), tags[50711], tags[33421]) == (codes, planes, 1, (2, 2))
    for number, illuminant, light, table in ((50721, 50778, A, raws.ROWS_A), (50722, 50779, D65, raws.ROWS)):
        assert tags[illuminant] == light
        np.testing.assert_allclose(ratios(tags[number]).reshape(-1, 3), [table[letter] for letter in rows], atol=1e-4)
    told = raws.filters(pattern)
    np.testing.assert_allclose(
        ratios(tags[50728]), [raws.neutral(pattern)[told.index(letter)] for letter in rows], atol=1e-6
    )
    assert tags[51041] == (2e-4, 3e-7) * len(rows)


@pytest.mark.parametrize("pattern, compression", [("MONO", "none"), ("RCCC", "lossless")])
def test_what_has_no_colour_is_linear_raw_of_one_sample_and_names_its_pattern(tmp_path, pattern, compression):
    write_dng(tmp_path / "a.dng", raws.noise(pattern), compression=compression)
    tags = tags_of(tmp_path / "a.dng")
    assert (tags[262], tags[277], tags[50713], tags[50714], tags[270]) == (
        34892,
        1,
        (1, 1),
        (64, 1),
        f"colour filter array {pattern}",
    )
    assert not {33421, 33422, 50710, 50721, 50728} & set(tags) and tags[51041] == (2e-4, 3e-7)


def test_the_date_is_fixed_and_the_camera_is_named(tmp_path):
    write_dng(tmp_path / "a.dng", raws.noise("RGGB"))
    tags, exif = tags_of(tmp_path / "a.dng"), exif_of(tmp_path / "a.dng")
    assert tags[306] == "2000:01:01 00:00:00" and exif[36867] == b"2000:01:01 00:00:00\0"
    assert (tags[50708], tags[50735], tags[272]) == ("synfog-usd Test sensor", "SN-0042", "Test sensor")
    assert (exif[42033], exif[42036]) == (b"SN-0042\0", b"Test lens\0") and tags[274] == 1


KNEES = [[240, 240], [1264, 1264], [17648, 2288], [1048575, 4095]]
"""20 bits in 12: slopes 1, 1/16 and 1/570."""


def companded(numbers: np.ndarray) -> Image:
    metadata = raws.metadata("RGGB", companding=KNEES, black_level_dn=240, linear_black_dn=240, linear_white_dn=1048575)
    return Image(numbers[..., None].astype(np.float32), ("CFA",), Quantity.DN, provenance=metadata)


@pytest.mark.parametrize("compression", ["none", "lossless"])
def test_companded_codes_are_kept_and_a_reader_makes_linear_numbers_of_them(tmp_path, compression):
    """The file holds the codes; LibRaw shows what the table makes of them: the linear numbers over 16, to half a
    number.
    """
    codes = np.arange(4096).reshape(64, 64)
    write_dng(tmp_path / "a.dng", companded(codes), compression=compression)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.dng").reshape(64, 64), codes)
    linear = np.concatenate(
        [np.arange(1265), 1264 + 16 * np.arange(1, 1025), 17648 + np.arange(1, 1808) * (1048575 - 17648) / 1807]
    )
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_allclose(raw.raw_image_visible.ravel(), linear * 65535 / 1048575, atol=0.501)
        assert raw.white_level == 65535 and raw.black_level_per_channel == [15] * 4


def test_hdr_numbers_that_are_not_companded_are_refused_with_advice(tmp_path):
    image = Image(
        np.full((32, 32, 1), 1e6, np.float32),
        ("CFA",),
        Quantity.DN,
        provenance=raws.metadata("RGGB", bits=20, black=240),
    )
    with pytest.raises(
        ImageError, match=r"at most 16 bits; white_level_dn is 1048575\. Put sensor\.compand before it, or write an EXR"
    ):
        write_dng(tmp_path / "a.dng", image)
    assert not list(tmp_path.iterdir())


def test_facts_that_are_missing_or_wrong_are_named(tmp_path):
    numbers = np.full((32, 32, 1), 70.0, np.float32)
    for pattern, change, words in [
        ("RGIB", {"xyz_to_camera": None}, "needs xyz_to_camera in the image's provenance"),
        ("RGGB", {"cfa_pattern": "XTRANS"}, "pattern 'XTRANS' cannot be written; it takes RGGB,"),
        ("RGGB", {"companding": KNEES}, "needs linear_black_dn, linear_white_dn in"),
    ]:
        metadata = {key: value for key, value in (raws.metadata(pattern) | change).items() if value is not None}
        with pytest.raises(ImageError, match=words):
            write_dng(tmp_path / "a.dng", Image(numbers, ("CFA",), Quantity.DN, provenance=metadata))
    assert not list(tmp_path.iterdir())


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


def test_a_camera_without_noise_has_no_noise_profile(mosaic, tmp_path):
    """DNG wants a slope above 0."""
    write_dng(tmp_path / "a.dng", mosaic.with_metadata(noise_profile=[0.0, 1e-6]))
    with tifffile.TiffFile(tmp_path / "a.dng") as file:
        assert 51041 not in file.pages[0].tags


HUGE = 1e30
NO_NUMBERS = [np.nan, -1.0, HUGE]
"""What no tag of an exposure, a speed or a length can hold."""


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_what_a_tag_cannot_hold_is_left_out(value, mosaic, tmp_path):
    """The file is whole but for that tag: TIFF's fractions have 32 bits without sign, its SHORT 16."""
    path = tmp_path / "a.dng"
    write_dng(path, mosaic)
    whole, exif = set(tags_of(path)), set(exif_of(path))
    for key, code in (("exposure_s", 33434), ("f_number", 33437), ("iso", 34855), ("focal_length_mm", 37386)):
        write_dng(path, mosaic.with_metadata(**{key: value}))
        assert exif - set(exif_of(path)) == {code} and set(tags_of(path)) == whole
        np.testing.assert_array_equal(tifffile.imread(path), mosaic.pixels[..., 0])
    matrix = [[1.0, 0.0, 0.0], [0.0, value if value != -1.0 else -HUGE, 0.0], [0.0, 0.0, 1.0]]
    for changes, gone in (
        ({"as_shot_neutral": [0.5, 1.0, value]}, {50728}),
        ({"xyz_to_camera_a": matrix}, {50722, 50779}),  # that of daylight alone is left, as the first
        ({"digital_gain": 0.0 if value == HUGE else value}, {50730}),
        ({"noise_profile": [1e-4, value if value != -1.0 else np.nan]} if value != HUGE else {}, {51041}),
    ):
        write_dng(path, mosaic.with_metadata(**changes))
        assert whole - set(tags_of(path)) == (gone if changes else set()), changes
    write_dng(path, mosaic.with_metadata(distortion_coefficients=[value] * 5, camera_matrix_px=[[value, 0, 60]] * 2))
    with rawpy.imread(str(path)) as raw:
        np.testing.assert_array_equal(raw.raw_image, mosaic.pixels[..., 0])


def test_a_parallel_projection_has_no_focal_length(tmp_path):
    """Rays that do not meet, through the shipped phone: a file without the tag, whose picture is whole."""
    from synfog_usd.scene import PARALLEL_DEG

    radiance = Image(np.full((96, 128, 3), 100.0, np.float32), ("R", "G", "B"), Quantity.RADIANCE)
    radiance = radiance.with_metadata(fov_x_deg=PARALLEL_DEG)
    graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
    run = graph.run({"radiance": radiance}, seed=1, settings={"exposure_s": 1 / 500, "iso": 55}, until="adc")
    write_dng(tmp_path / "a.dng", run["adc"])
    assert 37386 not in exif_of(tmp_path / "a.dng")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.dng"), run["adc"].pixels[..., 0])

"""Black, white and active area of DNGs of other hands, and damaged ones.

The files are made here by tifffile: an even grey of a quarter of the scale behind R, G, G, B whose white surface has
0.5, 1 and 0.625.  What is stored follows from DNG 1.7.1, chapter 5, turned round: black at each pixel, plus a quarter
of white less the greatest black.
"""

from __future__ import annotations

import random
import struct

import numpy as np
import pytest
import tifffile
from support import cli

from synfog_usd.base.errors import ImageError
from synfog_usd.camera import writers

NEUTRAL = np.array([0.5, 1.0, 0.625])
PATTERN = np.array([[0, 1], [1, 2]])
GREY, WHITE = 0.25, 16383
SHORT, LONG, RATIONAL, SRATIONAL = 3, 4, 5, 10
HEIGHT, WIDTH = 40, 48


def fractions(values, denominator=256):
    return [int(part) for value in np.ravel(values) for part in (round(float(value) * denominator), denominator)]


def stored(black, *, height=HEIGHT, width=WIDTH, white=WHITE):
    """(height, width) numbers of the grey above a black of any shape that broadcasts."""
    black = np.broadcast_to(np.asarray(black, np.float64), (height, width))
    filters = np.tile(PATTERN, (height // 2 + 1, width // 2 + 1))[:height, :width]
    return np.rint(black + (white - black.max()) * GREY * NEUTRAL[filters]).astype(np.uint16)


def write(path, pixels, tags=(), *, white=WHITE, byteorder="<", pages=()):
    """A DNG of one mosaic; `pages` are other images that stand before it."""
    told = [
        (33421, SHORT, 2, (2, 2), True),
        (33422, 1, 4, PATTERN.astype(np.uint8).tobytes(), True),
        (50717, LONG, 1, white, True),
        (50721, SRATIONAL, 9, fractions([0.9, -0.3, -0.1, -0.4, 1.2, 0.2, 0.0, 0.2, 0.7]), True),
        (50728, RATIONAL, 3, fractions(NEUTRAL), True),
        (50778, SHORT, 1, 21, True),
        *((code, kind, count, value, True) for code, kind, count, value in tags),
    ]
    version = [(50706, 1, 4, bytes((1, 4, 0, 0)), True)]
    with tifffile.TiffWriter(path, byteorder=byteorder) as file:
        for page in pages:
            file.write(page, photometric="rgb", subfiletype=1, metadata=None, extratags=version)
        file.write(pixels, photometric=32803, subfiletype=0, metadata=None, extratags=sorted(version + told))
    return path


def greys(path):
    """(H, W): each pixel between black and white, less the white surface's colour."""
    image = writers.read_raw(path)
    told = image.provenance
    assert told["cfa_pattern"] == "RGGB"
    height, width = image.pixels.shape[:2]
    filters = np.tile(PATTERN, (height // 2 + 1, width // 2 + 1))[:height, :width]
    linear = (image.pixels[..., 0].astype(np.float64) - told["black_level_dn"]) / (
        told["white_level_dn"] - told["black_level_dn"]
    )
    np.testing.assert_allclose(told["as_shot_neutral"], NEUTRAL, rtol=1e-6)
    return linear / NEUTRAL[filters]


def tiled(pattern):
    rows, columns = pattern.shape
    return np.tile(pattern, (HEIGHT // rows + 1, WIDTH // columns + 1))[:HEIGHT, :WIDTH]


def repeated(pattern, kind=SHORT):
    """Tags of a black that repeats."""
    pattern = np.asarray(pattern)
    values = fractions(pattern) if kind == RATIONAL else tuple(int(value) for value in pattern.ravel())
    return [(50713, SHORT, 2, pattern.shape), (50714, kind, pattern.size, values)]


SIXTEEN = np.arange(16).reshape(4, 4) * 64 + 800
SIX = np.arange(36).reshape(6, 6) * 20 + 400
ROW, COLUMN = np.linspace(0, 960, WIDTH).round(), np.linspace(-64, 640, HEIGHT).round()
H, V = (50715, SRATIONAL, WIDTH, fractions(ROW)), (50716, SRATIONAL, HEIGHT, fractions(COLUMN))
BLACKS = {
    "none": (0, []),
    "long": (1024, [(50714, LONG, 1, 1024)]),
    "fraction": (64.75, [(50714, RATIONAL, 1, (16576, 256))]),
    "1x2": (tiled(np.array([[960, 1440]])), repeated([[960, 1440]])),
    "2x2 of fractions": (
        tiled(np.array([[960.5, 1024], [1088, 1280.25]])),
        repeated([[960.5, 1024], [1088, 1280.25]], 5),
    ),
    "4x4": (tiled(SIXTEEN), repeated(SIXTEEN)),
    "6x6": (tiled(SIX), repeated(SIX, RATIONAL)),
    "one for 2x2": (1024, [(50713, SHORT, 2, (2, 2)), (50714, SHORT, 1, 1024)]),
    "rows alone": (COLUMN[:, None] + 64, [(50716, SRATIONAL, HEIGHT, fractions(COLUMN + 64))]),
    "4x4, rows and columns": (tiled(SIXTEEN) + ROW + COLUMN[:, None], [*repeated(SIXTEEN), H, V]),
}


@pytest.mark.parametrize("name, byteorder", [*((name, "<") for name in BLACKS), ("4x4, rows and columns", ">")])
def test_black_is_the_files_at_every_pixel(name, byteorder, tmp_path):
    """A quarter at every pixel, within the rounding of the stored number."""
    black, tags = BLACKS[name]
    path = write(tmp_path / "a.dng", stored(black), tags, byteorder=byteorder)
    step = 0.5 / (WHITE - np.max(black)) / NEUTRAL.min()
    np.testing.assert_allclose(greys(path), GREY, rtol=0, atol=1.01 * step)


def test_floats_keep_their_scale(tmp_path, white=40):
    """LibRaw makes at most 14 bits of them: a quarter to half a step of the darkest filter."""
    filters = np.tile(PATTERN, (HEIGHT // 2, WIDTH // 2))
    path = write(tmp_path / "a.dng", (white * GREY * NEUTRAL[filters]).astype(np.float32), white=white)
    np.testing.assert_allclose(greys(path), GREY, rtol=0, atol=1.0 / 16383 / NEUTRAL.min())


@pytest.mark.parametrize("corner", [(3, 5), (2, 3)])
def test_patterns_of_filters_and_black_begin_at_the_active_area(corner, tmp_path):
    """Whatever side of it is odd, no row or column is lost, and 4 x 4 blacks lie where they belong."""
    (top, left), black = corner, tiled(SIXTEEN)[:33, :37]
    frame = np.full((top + 33 + 4, left + 37 + 1), 7, np.uint16)  # behind masks
    frame[top : top + 33, left : left + 37] = stored(black, height=33, width=37)
    tags = [*repeated(SIXTEEN), (50829, LONG, 4, (top, left, top + 33, left + 37))]
    found = greys(write(tmp_path / "a.dng", frame, tags))
    assert found.shape == (33, 37)
    np.testing.assert_allclose(found, GREY, rtol=0, atol=1e-4)


def test_the_table_comes_before_black(tmp_path):
    """Codes that are looked up in a LinearizationTable, whose black differs by row."""
    table = (np.arange(1024) ** 2 / 1023 * 16).round().astype(int)
    wanted = stored(1024 + COLUMN[:, None])
    codes = np.abs(table[None, None] - wanted[..., None].astype(int)).argmin(axis=2)
    tags = [(50712, SHORT, 1024, tuple(int(value) for value in table)), (50714, SHORT, 1, 1024), V]
    path = write(tmp_path / "a.dng", codes.astype(np.uint16), tags, white=int(table[-1]))
    off = (table[codes] - wanted.astype(float)) / (WHITE - 1024 - COLUMN.max()) / NEUTRAL[np.tile(PATTERN, (20, 24))]
    np.testing.assert_allclose(greys(path) - off, GREY * (WHITE / table[-1]), rtol=0, atol=2e-4)


def test_the_command_line_develops_it_to_a_quarter(tmp_path):
    """Through `graph run raw`: demosaicing and the matrix keep an even grey."""
    path = write(tmp_path / "a.dng", stored(BLACKS["4x4"][0]), BLACKS["4x4"][1])
    done = cli.run("graph", "run", "raw", "--in", path, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    linear = writers.read_exr(tmp_path / "linear.exr")
    np.testing.assert_allclose(linear.pixels, GREY, rtol=0, atol=5e-4)


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        (
            [(50713, SHORT, 2, (2, 2)), (50714, SHORT, 3, (1, 2, 3))],
            r"BlackLevel \(tag 50714\) has 3 numbers; 4 are needed",
        ),
        ([(50714, RATIONAL, 1, (64, 0))], r"BlackLevel \(tag 50714\) has a number that is not finite"),
        ([(50714, LONG, 1, 20000)], "its black goes up to 20000 and its WhiteLevel is 16383"),
        ([(50829, LONG, 4, (8, 0, 8, WIDTH))], "its ActiveArea goes from row 8, column 0 to row 8"),
    ],
)
def test_levels_that_cannot_be_are_one_line(tags, words, tmp_path):
    path = write(tmp_path / "a.dng", stored(64), tags)
    with pytest.raises(ImageError, match=words) as error:
        writers.read_raw(path)
    assert "\n" not in str(error.value)


def directories(data):
    """Offsets of the directories of a little-endian TIFF, in their chain."""
    found, offset = [], struct.unpack_from("<I", data, 4)[0]
    while offset:
        found.append(offset)
        offset = struct.unpack_from("<I", data, offset + 2 + 12 * struct.unpack_from("<H", data, offset)[0])[0]
    return found


@pytest.fixture
def two_pages(tmp_path):
    """A DNG whose mosaic is the second of two images."""
    preview = np.zeros((16, 16, 3), np.uint8)
    return write(tmp_path / "a.dng", stored(1024), [(50714, SHORT, 1, 1024)], pages=[preview])


@pytest.mark.parametrize("link", [0x7FFFFFFF, "the first", "the middle of the pixels"])
def test_what_comes_behind_the_mosaic_may_be_damaged(link, two_pages):
    """A chain of images that goes on to nowhere, or round in a circle, does not matter to the mosaic in it."""
    data = bytearray(two_pages.read_bytes())
    first, second = directories(data)
    place = second + 2 + 12 * struct.unpack_from("<H", data, second)[0]
    where = {"the first": first, "the middle of the pixels": len(data) - 1001}.get(link, link)
    struct.pack_into("<I", data, place, where)
    two_pages.write_bytes(data)
    np.testing.assert_allclose(greys(two_pages), GREY, rtol=0, atol=1e-4)


def damaged(data, random_):
    """Bytes of a DNG with an entry of a directory, some bytes or the end replaced."""
    data = bytearray(data)
    for _ in range(random_.choice((1, 1, 2, 4))):
        how = random_.randrange(4)
        if how == 0:
            del data[random_.randrange(8, len(data)) :]
        elif how == 1:
            place, length = random_.randrange(len(data)), random_.randrange(1, 32)
            data[place : place + length] = random_.randbytes(length)
        else:
            offset = struct.unpack_from("<I", data, 4)[0]
            try:
                entry = offset + 2 + 12 * random_.randrange(struct.unpack_from("<H", data, offset)[0])
                field, form = random_.choice(((0, "<H"), (2, "<H"), (4, "<I"), (8, "<I")))
                most = 1 << (8 * struct.calcsize(form))
                value = random_.choice((0, 1, 2, 4, 8, 50714, most - 1, most // 2, random_.randrange(most)))
                struct.pack_into(form, data, entry + field, value % most)
            except (struct.error, ValueError):  # its directory is gone already
                continue
    return bytes(data)


def test_any_damage_ends_in_a_picture_or_one_line(tmp_path, capfd):
    """200 small DNGs, damaged by one seed: finite numbers and levels that make sense, or an ImageError of one line."""
    tags = [*repeated(SIXTEEN), H, V, (50829, LONG, 4, (0, 0, HEIGHT, WIDTH))]
    whole = write(tmp_path / "a.dng", stored(BLACKS["4x4, rows and columns"][0]), tags).read_bytes()
    random_, pictures, path = random.Random(1), 0, tmp_path / "b.dng"
    for _ in range(200):
        path.write_bytes(damaged(whole, random_))
        try:
            image = writers.read_raw(path)
        except ImageError as error:
            assert "\n" not in str(error) and str(error).startswith(f"{path}: ")
            continue
        told = image.provenance
        assert np.isfinite(image.pixels).all() and 0.0 <= told["black_level_dn"] < told["white_level_dn"]
        assert np.isfinite(told["as_shot_neutral"]).all() and np.isfinite(told.get("camera_to_rec709", 0.0)).all()
        pictures += 1
    assert 30 < pictures < 170
    assert "Traceback" not in capfd.readouterr().err

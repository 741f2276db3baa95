"""OpcodeList3 read by its specification, and what it does to places against OpenCV and the lens's own falloff."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest
import tifffile

from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.optics import FalloffShape, cone_of, falloff_map
from synfog_usd.camera.pinhole import Pinhole
from synfog_usd.camera.writers import write_output
from synfog_usd.camera.writers.opcodes import opcode_list

HEIGHT, WIDTH = 480, 640
MATRIX = [[500.0, 0.0, 330.0], [0.0, 500.0, 230.0], [0.0, 0.0, 1.0]]


def read(data: bytes) -> dict[int, tuple[float, ...]]:
    """Number of opcode -> its parameters as doubles; a leading count of planes is taken off."""
    (count,) = struct.unpack_from(">I", data)
    found, place = {}, 4
    for _ in range(count):
        number, since, flags, size = struct.unpack_from(">4I", data, place)
        assert since == 0x01030000 and flags == 1
        body = data[place + 16 : place + 16 + size]
        if number == 1:
            assert struct.unpack_from(">I", body) == (1,)
            body = body[4:]
        found[number] = struct.unpack(f">{len(body) // 8}d", body)
        place += 16 + size
    assert place == len(data)
    return found


@pytest.mark.parametrize(
    ("coefficients", "within_px"),
    [
        ((-0.3, 0.1, 0.0, 0.0), 1e-6),
        ((-0.28, 0.07, 0.001, -0.002, -0.01), 1e-6),
        ((0.5, 0.1, 0.001, 0.0, 0.02, 0.8, 0.2, 0.03), 0.3),
    ],
)
def test_the_warp_sends_straight_places_where_opencv_does(coefficients, within_px):
    """The specification: dx' = f dx + kt0 2 dx dy + kt1 (r^2 + 2 dx^2), lengths in parts of the farthest corner's."""
    numbers = read(
        opcode_list(HEIGHT, WIDTH, {"distortion_coefficients": list(coefficients), "camera_matrix_px": MATRIX})
    )[1]
    *radial, kt0, kt1, cx, cy = numbers
    axis = np.array([cx * (WIDTH - 1), cy * (HEIGHT - 1)])
    np.testing.assert_allclose(axis, [330.0, 230.0], atol=1e-9)
    corners = np.array([(x, y) for x in (0, WIDTH - 1) for y in (0, HEIGHT - 1)])
    reach = np.linalg.norm(corners - axis, axis=1).max()
    places = np.stack(np.meshgrid(np.linspace(0, WIDTH - 1, 9), np.linspace(0, HEIGHT - 1, 7)), axis=-1).reshape(-1, 2)
    dx, dy = ((places - axis) / reach).T
    r2 = dx**2 + dy**2
    f = sum(k * r2**power for power, k in enumerate(radial))
    found = np.stack(
        [f * dx + kt0 * 2 * dx * dy + kt1 * (r2 + 2 * dx**2), f * dy + kt1 * 2 * dx * dy + kt0 * (r2 + 2 * dy**2)],
        axis=1,
    )
    rays = np.concatenate([(places - [330.0, 230.0]) / 500.0, np.ones((len(places), 1))], axis=1)
    wanted, _ = cv2.projectPoints(
        rays, np.zeros(3), np.zeros(3), np.array(MATRIX), np.array(coefficients, dtype=np.float64)
    )
    np.testing.assert_allclose(axis + found * reach, wanted[:, 0], atol=within_px)


@pytest.mark.parametrize(("falloff", "within"), [("cos4", 1e-3), ("table", 1e-2)])
def test_the_vignette_opcode_undoes_the_lens(falloff, within):
    """Gain times falloff is 1 at every pixel; the table's kinks are what a polynomial misses, 0.7 % at worst."""
    table = ((0.0, 10.0, 20.0, 30.0, 40.0), (1.0, 0.97, 0.89, 0.76, 0.6))
    metadata = {"falloff": falloff, "fov_x_deg": 60.0, "f_number": 2.8, "shift_x": 0.05, "shift_y": -0.02}
    if falloff == "table":
        metadata["relative_illumination"] = [list(column) for column in table]
    *gains, cx, cy = read(opcode_list(HEIGHT, WIDTH, metadata))[3]
    shape = FalloffShape(falloff, cone_of(2.8), table if falloff == "table" else ((), ()))
    shade = falloff_map(Pinhole(HEIGHT, WIDTH, 60.0, (0.05, -0.02)), None, shape)
    axis = np.array([cx * (WIDTH - 1), cy * (HEIGHT - 1)])
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    away = np.hypot(columns - axis[0], rows - axis[1])
    r2 = (away / away[[0, 0, -1, -1], [0, -1, 0, -1]].max()) ** 2
    gain = 1.0 + sum(k * r2 ** (power + 1) for power, k in enumerate(gains))
    np.testing.assert_allclose(gain * shade, 1.0, atol=within)


def test_a_dng_has_them_unless_told_otherwise_and_none_without_a_lens(tmp_path):
    facts = {
        "black_level_dn": 64,
        "white_level_dn": 1023,
        "noise_profile": [1e-4, 1e-6],
        "exposure_s": 0.01,
        "f_number": 2.0,
        "iso": 100.0,
        "sensor_title": "test",
        "cfa_pattern": "MONO",
    }
    lens = {"falloff": "cos4", "fov_x_deg": 60.0}

    def tags(name: str, metadata: dict, **options: bool) -> bool:
        image = Image(np.full((32, 48, 1), 100.0, np.float32), ("CFA",), Quantity.DN, provenance=metadata)
        with tifffile.TiffFile(write_output(name, image, tmp_path, options=options)) as file:
            return 51022 in file.pages[0].tags

    assert tags("a.dng", facts | lens)
    assert not tags("b.dng", facts | lens, corrections=False)
    assert not tags("c.dng", facts)

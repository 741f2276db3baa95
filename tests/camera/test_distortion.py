"""Distortion against OpenCV, and labels that follow it."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from synfog_usd import camera
from synfog_usd.base.errors import GraphError, ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import distortion

BARREL = (-0.3, 0.1, 0.001, -0.002, -0.02)
PINCUSHION = (0.2, -0.05, 0.0, 0.001)
RATIONAL = (0.9, 0.2, 0.0005, -0.0003, 0.01, 1.2, 0.35, 0.02)
SIZE = (240, 321)
FOV, SHIFT = 62.0, (0.03, -0.05)


def light(planes, shift=SHIFT) -> Image:
    offset = {"shift_x": shift[0], "shift_y": shift[1]}
    return Image(np.asarray(planes, np.float32), ("R", "G", "B"), Quantity.IRRADIANCE, provenance=offset)


def pinhole(height=SIZE[0], width=SIZE[1]):
    """Focal length and centre, OpenCV's (the first pixel is 0): right and up are positive shifts."""
    focal = width / 2 / math.tan(math.radians(FOV) / 2)
    return focal, (width - 1) / 2 + SHIFT[0] * width, (height - 1) / 2 - SHIFT[1] * height


def warp(coefficients, fit="inside", size=SIZE):
    return distortion.warp_of(distortion.Pinhole(*size, FOV, SHIFT), coefficients, fit)


def projected(rows, columns, found, coefficients):
    """Where OpenCV puts the directions of pixels of the pinhole picture: (N, 2) columns and rows."""
    focal, cx, cy = pinhole()
    points = np.stack([(columns - cx) / focal, (rows - cy) / focal, np.ones(rows.shape)], axis=-1).reshape(-1, 3)
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.array(found.camera_matrix()), np.array(coefficients))[
        0
    ][:, 0]


@pytest.mark.parametrize("coefficients", [BARREL, PINCUSHION, RATIONAL])
def test_every_pixel_looks_where_opencv_says(coefficients):
    """What a pixel shows is projected back onto it, to 0.01 pixels."""
    found = warp(coefficients)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    back = projected(found.row.astype(float), found.column.astype(float), found, coefficients)
    np.testing.assert_allclose(back, np.stack([columns, rows], axis=-1).reshape(-1, 2), atol=0.01)
    assert np.hypot(found.row - rows, found.column - columns).max() > 3.0
    room = min(found.row.min(), found.column.min(), SIZE[0] - 1 - found.row.max(), SIZE[1] - 1 - found.column.max())
    assert 0.0 <= room < 0.05, "none looks outside the rendered picture, and one nearly does"


def test_keep_keeps_the_focal_length_and_refuses_to_look_outside():
    assert warp(PINCUSHION, "keep").focal_px == pytest.approx(pinhole()[0], rel=1e-12)
    with pytest.raises(ImageError, match=r"\d+\.\d% of the pixels look outside the rendered picture; set fit: inside"):
        warp(BARREL, "keep")


def test_a_smooth_picture_is_read_between_its_pixels():
    """Waves of 8 pixels: the picture is the wave at the directions that OpenCV's own inverse gives; a cubic spline
    misses 0.2 % of them.
    """
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)

    def wave(row, column):
        return 10.0 + 3.0 * np.cos(2 * math.pi * column / 8.0) + 3.0 * np.sin(2 * math.pi * row / 8.0)

    out = distortion.distortion(
        light(np.repeat(wave(rows, columns)[..., None], 3, axis=2)), coefficients=BARREL, fov_x_deg=FOV
    )
    matrix = np.array(out.provenance["camera_matrix_px"])
    points = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    focal, cx, cy = pinhole()
    old = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    seen = cv2.undistortPoints(
        points, matrix, np.array(out.provenance["distortion_coefficients"]), None, old, None, criteria
    )[:, 0].reshape(*SIZE, 2)
    expected = wave(seen[..., 1], seen[..., 0])
    np.testing.assert_allclose(out.pixels[8:-8, 8:-8, 1], expected[8:-8, 8:-8], atol=0.03)


def test_a_lamp_gets_no_ring_and_keeps_its_radiance():
    """One pixel of 1e6 over 1: a tenth of what is there is all that its neighbours gain or lose, and the sum grows with
    the area of a pixel there.
    """
    plane = np.ones((*SIZE, 3))
    plane[60, 200] += 1e6
    out = distortion.distortion(light(plane), coefficients=BARREL, fov_x_deg=FOV).pixels[..., 1].astype(float)
    found = warp(BARREL)
    away = np.hypot(found.row - 60, found.column - 200)
    np.testing.assert_allclose(out[away > 2.0], 1.0, atol=0.1)
    np.testing.assert_allclose(out[away > 6.0], 1.0, atol=0.003)
    assert out.min() >= 0.9 * (1 - 1e-6)
    row, column = (int(axis[0]) for axis in np.nonzero(np.hypot(found.row - 60, found.column - 200) < 0.8))
    by_row, by_column = np.gradient(found.row.astype(float)), np.gradient(found.column.astype(float))
    area = by_row[0] * by_column[1] - by_row[1] * by_column[0]  # pixels of the pinhole picture in one of ours
    assert (out - 1.0).sum() / 1e6 == pytest.approx(1.0 / area[row, column], rel=0.02)


def test_a_lens_without_distortion_changes_nothing():
    image = light(np.ones((3, 5, 3)))
    assert (
        distortion.distortion(image, coefficients=None, fov_x_deg=FOV) is image
        and distortion.distortion(image, coefficients=(), fov_x_deg=FOV) is image
    )
    np.testing.assert_allclose(
        distortion.distortion(image, coefficients=(0.0, 0.0, 0.0, 0.0), fov_x_deg=FOV).pixels, 1.0, rtol=1e-6
    )


@pytest.mark.parametrize(
    ("coefficients", "fov_x_deg", "shift", "message"),
    [
        ((0.1, 0.2), FOV, SHIFT, "2 distortion coefficients; it takes"),
        (BARREL, FOV, ("left", 0.0), "shift_x and shift_y are 'left' and 0.0; each is from -10 to 10"),
        ((-0.6, 0.0, 0.0, 0.0), 100.0, SHIFT, r"fold the picture over from \d+ degrees off the axis on"),
        (BARREL, FOV, (0.7, -0.05), "the axis is at column 385, row 132, outside the picture of 321 x 240"),
    ],
)
def test_what_cannot_be_warped_is_refused(coefficients, fov_x_deg, shift, message):
    with pytest.raises(ImageError, match=message):
        distortion.distortion(light(np.ones((*SIZE, 3)), shift), coefficients=coefficients, fov_x_deg=fov_x_deg)


GRAPH = """synfog: graph/1
inputs: [radiance]
sensor: imx363
lens: automotive_6mm
nodes:
  - {op: optics.irradiance}
  - {op: optics.distortion, name: bend%s}
outputs: {a.exr: bend}
"""


def graph(tmp_path, text):
    (tmp_path / "g.yaml").write_text(text)
    return camera.load_graph(tmp_path / "g.yaml")


def test_labels_follow_the_very_map_of_the_picture(tmp_path):
    """A picture whose pixels are their own number, without highlights and wide enough that rounding tells: `of_graph`
    names the pixel that each shows.
    """
    loaded = graph(tmp_path, GRAPH % "")
    rows, columns = np.mgrid[:48, :64]
    numbers = np.stack([rows, columns, rows + columns], axis=2).astype(np.float32) + 100.0
    ramp = Image(numbers, ("R", "G", "B"), Quantity.RADIANCE, provenance={"fov_x_deg": 60.0})
    out = loaded.run({"radiance": ramp}, seed=0, overrides={"irradiance.falloff": "none"})["bend"]
    name, found = distortion.of_graph(loaded, distortion.Pinhole(48, 64, 60.0, (0.0, 0.0)))
    scale = math.pi * 0.9 / 17.0  # f/2
    near_row, near_column = found.nearest()
    assert name == "bend" and out.provenance["camera_matrix_px"] == found.camera_matrix()
    assert np.abs(out.pixels[2:-2, 2:-2, 0] / scale - 100.0 - near_row[2:-2, 2:-2]).max() < 0.51
    assert np.abs(out.pixels[2:-2, 2:-2, 1] / scale - 100.0 - near_column[2:-2, 2:-2]).max() < 0.51
    assert (near_row != rows).mean() > 0.2


def test_graphs_without_distortion_have_no_map_and_with_two_none_either(tmp_path):
    size = distortion.Pinhole(48, 64, 60.0, (0.0, 0.0))
    assert distortion.of_graph(graph(tmp_path, GRAPH.replace("automotive_6mm", "pixel4a") % ""), size) is None
    assert distortion.of_graph(graph(tmp_path, GRAPH.replace("optics.distortion", "optics.glare") % ""), size) is None
    with pytest.raises(
        GraphError, match=r"g\.yaml:8:\d+: graph 'g' has 2 optics.distortion nodes; labels can follow one"
    ):
        distortion.of_graph(graph(tmp_path, GRAPH % "}\n  - {op: optics.distortion, name: again"), size)


def bent_wave(rendered, taken, cycles, down) -> np.ndarray:
    """(H, W) of a wave of so many cycles per pixel of the taken picture, across or down it, as each pixel of the
    rendered one averages it (8 x 8 places).
    """
    fine = 8
    columns, rows = (
        (np.arange(length * fine) + 0.5) / fine - 0.5 for length in (rendered.width_px, rendered.height_px)
    )
    x, y = np.meshgrid(
        (columns - rendered.axis_px[0]) / rendered.focal_px, (rows - rendered.axis_px[1]) / rendered.focal_px
    )
    k1, k2 = BENT[:2]
    radial = 1.0 + k1 * (x * x + y * y) + k2 * (x * x + y * y) ** 2
    place = (y if down else x) * radial * taken.focal_px + taken.axis_px[1 if down else 0]
    wave = 1.0 + 0.1 * np.cos(2 * np.pi * cycles * place)
    return wave.reshape(rendered.height_px, fine, rendered.width_px, fine).mean(axis=(1, 3)).astype(np.float32)


BENT = (-0.35, 0.15, 0.0, 0.0)
"""Coefficients of the one shipped lens that distorts, automotive_6mm."""


def test_a_picture_rendered_for_the_lens_is_as_sharp_as_its_pixels(tmp_path, fov_x_deg=50.0, frequencies=(0.25, 0.5)):
    """Contrast of waves up to 0.5 cycles a pixel at centre, half field and corner, across and down: sinc(f) within
    0.01.

    Waves of 10 %, which the guard against dark lines at edges leaves alone.
    """
    shown = graph(tmp_path, GRAPH % "")
    taken = distortion.Pinhole(96, 128, fov_x_deg, (0.0, 0.0))
    rendered = distortion.to_render(shown, taken)
    assert shown.profiles["lens"].distortion == BENT
    view = (taken.height_px, taken.width_px, taken.fov_x_deg, *taken.shift)
    patches = {"centre": (48, 64), "half field": (24, 32), "corner": (12, 12)}
    for cycles in frequencies:
        for down in (False, True):
            wave = np.repeat(bent_wave(rendered, taken, cycles, down)[..., None], 3, axis=2)
            out = distortion.distortion(
                light(wave, rendered.shift), coefficients=BENT, fov_x_deg=rendered.fov_x_deg, view=view
            )
            assert out.pixels.shape == (96, 128, 3) and out.provenance["fov_x_deg"] == fov_x_deg
            for where, (row, column) in patches.items():
                patch = out.pixels[row - 10 : row + 10, column - 10 : column + 10, 1].astype(np.float64)
                phase = (
                    2
                    * np.pi
                    * cycles
                    * (np.arange(row - 10, row + 10)[:, None] if down else np.arange(column - 10, column + 10)[None, :])
                )
                waves = np.stack(
                    [
                        np.broadcast_to(one, patch.shape).ravel()
                        for one in (np.ones_like(phase), np.cos(phase), *([np.sin(phase)] if cycles < 0.5 else []))
                    ],
                    axis=1,
                )
                mean, *parts = np.linalg.lstsq(waves, patch.ravel(), rcond=None)[0]
                contrast = np.hypot(*parts) if len(parts) > 1 else abs(parts[0])
                assert contrast / 0.1 == pytest.approx(np.sinc(cycles), abs=0.01), (where, cycles, down)
                assert mean == pytest.approx(1.0, abs=0.01)

"""Depth of field from a pinhole's picture and its depth: discs, edges, ramps, and two planes through a sampled lens."""

from __future__ import annotations

import math

import numpy as np
import pytest

from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.focus import blur_disc_um, depth_of_field

LENS = {"f_number": 2.0, "focal_length_mm": 20.0, "pixel_pitch_um": 4.0}
FOCUS_M = 5.0

FAR_PX = 20e-3**2 / (2.0 * (5.0 - 20e-3)) / 4e-6
"""Disc of what is infinitely far: 10.04 pixels."""


def of_disc_px(signed: float) -> float:
    """Depth [m] at which a point's disc has that diameter, below 0 before the focus."""
    return FOCUS_M / (1.0 - signed / FAR_PX)


def run(plane, depth_m, focus_m=FOCUS_M) -> np.ndarray:
    light = Image(np.asarray(plane, np.float32)[..., None], ("Y",), Quantity.IRRADIANCE)
    depth = np.broadcast_to(np.asarray(depth_m, np.float32), light.pixels.shape[:2])
    image = depth_of_field(light, Image(depth[..., None], ("Z",), Quantity.DATA), focus_m=focus_m, **LENS)
    return image.pixels[..., 0].astype(np.float64)


def step_response(x, radius):
    """Part of a disc that lies at one side of an edge `x` from its middle."""
    x = np.clip(x / radius, -1.0, 1.0)
    return 0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / math.pi


@pytest.mark.parametrize("disc_px", [-12.0, 6.5])
def test_a_lamp_becomes_the_disc_of_the_closed_form_and_keeps_its_light(disc_px):
    """Its variance along an axis is c^2 / 16, and 1/12 of a pixel's width; what lies between two layers is both."""
    plane = np.full((65, 65), 1e-6)
    plane[32, 32] = 1000.0
    depth_m = of_disc_px(disc_px)
    c_px = 20e-3**2 / (2.0 * (5.0 - 20e-3)) * abs(depth_m - 5.0) / depth_m / 4e-6
    assert c_px == pytest.approx(abs(disc_px))
    found = run(plane, depth_m)
    assert found.sum() == pytest.approx(plane.sum(), rel=1e-4)
    offsets = np.arange(65) - 32.0
    assert (found.sum(axis=0) * offsets**2).sum() / found.sum() == pytest.approx(c_px**2 / 16 + 1 / 12, abs=0.12)


@pytest.mark.parametrize("disc_px", [-8.0, 4.2])
def test_a_plane_is_that_of_one_distance(disc_px):
    """A wave of 0.2 cycles a pixel keeps 2 J1(x) / x."""
    from scipy.special import j1

    wave = np.tile(1.0 + 0.3 * np.cos(2 * np.pi * 0.2 * np.arange(100)), (60, 1))
    found = run(wave, of_disc_px(disc_px))
    x = math.pi * abs(disc_px) * 0.2
    contrast = 2.0 * abs((found[30, 25:75] * np.exp(2j * np.pi * 0.2 * np.arange(50))).mean()) / found.mean() / 0.3
    assert contrast == pytest.approx(abs(2.0 * j1(x) / x), abs=0.006)


@pytest.mark.parametrize(("focus_m", "distance_m"), [(5.0, None), (0.5, 2.0), (3.0, 0.4)])
def test_the_blur_disc_is_the_cone_cut_by_the_sensor(focus_m, distance_m):
    """Thin lens: rays through the rim of the pupil, 3 mm wide, cross at the image of the scene and are cut where that
    of the focus is.
    """
    f, pupil = 6e-3, 3e-3
    sensor = 1 / (1 / f - 1 / focus_m)
    image = f if distance_m is None else 1 / (1 / f - 1 / distance_m)
    expected = pupil * abs(sensor - image) / image
    disc_um = blur_disc_um(focus_m, distance_m, f_number=2.0, focal_length_mm=6.0)
    assert disc_um == pytest.approx(expected * 1e6, rel=1e-9)


def test_an_even_picture_stays_even_whatever_its_depth():
    """Boards at random depths before one another, before and behind the focus, and sky."""
    rng = np.random.default_rng(5)
    depth = np.full((80, 100), np.inf)
    for distance in sorted(rng.uniform(1.0, 60.0, 12), reverse=True):
        top, left = rng.integers(0, 60), rng.integers(0, 80)
        depth[top : top + 25, left : left + 20] = distance
    np.testing.assert_allclose(run(np.full((80, 100), 3.0), depth), 3.0, rtol=2e-4)


def test_a_sharp_thing_does_not_leak_into_what_is_blurred_behind_it():
    """A board in focus, 50 times as bright, before an even sky: the picture stays as it is, to the pixel."""
    plane = np.ones((48, 64))
    plane[10:40, 20:40] = 50.0
    depth = np.where(plane > 1.0, FOCUS_M, np.inf)
    np.testing.assert_allclose(run(plane, depth), plane, rtol=1e-4)


@pytest.mark.parametrize("far", [FOCUS_M, np.inf])
def test_a_blurred_edge_is_soft_at_both_sides_whatever_is_behind(far):
    """A near half-plane before an even one, in focus or not: 1 + 7 times the part of its disc that is on it."""
    plane = np.tile(np.where(np.arange(96) < 48, 8.0, 1.0), (40, 1))
    depth = np.where(plane > 1.0, of_disc_px(-12.0), far)
    found = run(plane, depth)[20]
    np.testing.assert_allclose(found, 1.0 + 7.0 * step_response(47.5 - np.arange(96), 6.0), atol=0.12)


def test_a_road_that_goes_away_is_whole():
    """Depth that changes from pixel to pixel is one surface: a lamp on it keeps its light, and each row the contrast of
    its own disc.
    """
    rows = np.arange(120)[:, None]
    depth = np.broadcast_to(1.6 * 200.0 / (rows + 12.0), (120, 80))  # 1.6 m above it, 200 pixels of focal length
    lamp = np.full((120, 80), 1e-6)
    lamp[40, 40] = 500.0
    assert run(lamp, depth).sum() == pytest.approx(lamp.sum(), rel=0.02)
    wave = np.tile(1.0 + 0.3 * np.cos(2 * np.pi * 0.1 * np.arange(80)), (120, 1))
    found = run(wave, depth)[:, 20:60]
    contrast = 2.0 * np.abs((found * np.exp(2j * np.pi * 0.1 * np.arange(40))).mean(axis=1)) / found.mean(axis=1) / 0.3
    from scipy.special import j1

    x = math.pi * np.abs(FAR_PX * (1.0 - FOCUS_M / depth[:, 0])) * 0.1
    wanted = 2.0 * j1(np.maximum(x, 1e-9)) / np.maximum(x, 1e-9)
    np.testing.assert_allclose(contrast[15:-25], wanted[15:-25], atol=0.02)


@pytest.mark.parametrize(("near_px", "far_px"), [(-8.0, 6.0), (0.0, FAR_PX)])
def test_two_planes_are_what_a_sampled_lens_sees_of_them(near_px, far_px):
    """Textures that go on behind the edge: through each of 150 places of the lens a plane is shifted by its disc's
    radius.  What a pinhole cannot see of the far one is a guess, so that edges of 4 : 1 are 0.03 to 0.065 off, which
    are 0.14 to 1 off in the pinhole's own picture.
    """
    from scipy import ndimage

    size, rim = 64, 16
    rng = np.random.default_rng(3)
    near, far = (ndimage.gaussian_filter(rng.normal(size=(size + 2 * rim,) * 2), 1.5) for _ in range(2))
    near, far = 4.0 + near / near.std(), 1.0 + 0.25 * far / far.std()
    rows, columns = np.mgrid[: size + 2 * rim, : size + 2 * rim]
    edge = ((columns + 0.3 * rows < 60.0) | (np.hypot(columns - 60, rows - 40) < 8.0)).astype(float)

    def seen(plane, disc_px, u, v):
        return ndimage.shift(plane, (-0.5 * v * disc_px, -0.5 * u * disc_px), order=1)[rim:-rim, rim:-rim]

    places = (np.arange(14) + 0.5) / 7.0 - 1.0
    lens = [(u, v) for u in places for v in places if u * u + v * v < 1.0]
    wanted = np.zeros((size, size))
    for place in lens:
        front = seen(edge, near_px, *place)
        wanted += (front * seen(near, near_px, *place) + (1.0 - front) * seen(far, far_px, *place)) / len(lens)
    front = edge[rim:-rim, rim:-rim] > 0.5
    pinhole = np.where(front, near[rim:-rim, rim:-rim], far[rim:-rim, rim:-rim]).clip(0.0)
    found = run(pinhole, np.where(front, of_disc_px(near_px), of_disc_px(min(far_px, FAR_PX * (1.0 - 1e-9)))))
    band = ndimage.binary_dilation(front, iterations=5) & ~ndimage.binary_erosion(front, iterations=5)
    band[:10] = band[-10:] = band[:, :10] = band[:, -10:] = False

    def error(picture):
        return math.sqrt(np.square(picture - wanted)[band].mean())

    assert error(found) < 0.08 and error(found) < 0.3 * error(pinhole)


def test_what_tells_no_depth_is_refused():
    """A word for each; the channel is found among others."""
    light = Image(np.ones((8, 9, 1), np.float32), ("Y",), Quantity.IRRADIANCE)

    def depth(value, *channels, shape=(8, 9)) -> Image:
        planes = np.full((*shape, len(channels)), value, np.float32)
        return Image(planes, channels, Quantity.DATA)

    named = depth(np.inf, "N.X", "depth.Z")
    named.pixels[..., 0] = -1.0
    assert depth_of_field(light, named, focus_m=5.0, **LENS).provenance["depth_of_field_px"] == [10.04, 10.04]
    for wrong, words in (
        (depth(1.0, "N.X", "N.Y"), "no channel depth.Z or Z tells the depth; there are N.X, N.Y"),
        (depth(1.0, "Z", shape=(4, 9)), "depth of 9 x 4 for a picture of 9 x 8"),
        (depth(0.0, "Z"), "depth at x=0, y=0 is 0; it is above 0"),
        (depth(1e-3, "Z"), "begins at 0.001 m, or raise f_number"),
    ):
        with pytest.raises(ImageError, match=words):
            depth_of_field(light, wrong, focus_m=5.0, **LENS)
    baked = light.with_metadata(sharp_at_m=7.0)
    with pytest.raises(ImageError, match="rendered through a thin lens, focused at 7 m"):
        depth_of_field(baked, depth(1.0, "Z"), focus_m=5.0, **LENS)
    with pytest.raises(ImageError, match="cannot focus at focus_m"):
        depth_of_field(light, depth(1.0, "Z"), focus_m=0.01, **LENS)

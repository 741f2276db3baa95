"""Light astray in the lens: sums, places, and the spikes of a polygon."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import sici

from synfog_usd.base import photometry, seeds
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import flare
from synfog_usd.camera.profiles import load_sensor

SENSOR = load_sensor("imx363")
GREEN = tuple(photometry.band_name(centre) for centre in (549.0, 550.0, 551.0))
LENS = {"f_number": 4.0, "pixel_pitch_um": 3.0, "sensor": SENSOR}


def lamp(size=(401, 401), at=(200, 200), *, light=1e6, channels=GREEN) -> Image:
    plane = np.full(size, 1.0, dtype=np.float32)
    plane[at] += light
    return Image(np.repeat(plane[..., None], len(channels), axis=2), channels, Quantity.IRRADIANCE)


def test_glare_is_the_sum_over_the_mirrored_picture(height=9, width=12):
    """Pixel by pixel with the picture's mirror images, weights 1 / (r^2 + 1) up to half the picture away."""
    pixels = seeds.stream(0, "test", "glare").random((height, width, 1), dtype=np.float32)
    reach_y, reach_x = height // 2, width // 2
    mirrored = np.pad(pixels[..., 0], ((reach_y, reach_y), (reach_x, reach_x)), mode="symmetric")
    y, x = np.mgrid[-reach_y : reach_y + 1, -reach_x : reach_x + 1]
    weights = 1.0 / (y**2 + x**2 + 1.0)
    truth = [
        [
            (mirrored[row : row + 2 * reach_y + 1, column : column + 2 * reach_x + 1] * weights).sum() / weights.sum()
            for column in range(width)
        ]
        for row in range(height)
    ]
    found = flare.glare(Image(pixels, ("Y",), Quantity.IRRADIANCE), fraction=0.25).pixels
    np.testing.assert_allclose(found[..., 0], 0.75 * pixels[..., 0] + 0.25 * np.array(truth), rtol=1e-6)


def test_glare_keeps_an_even_picture_and_all_of_the_light():
    even = Image(np.full((90, 160, 3), 5.0, np.float32), ("R", "G", "B"), Quantity.IRRADIANCE)
    np.testing.assert_allclose(flare.glare(even, fraction=0.1).pixels, 5.0, rtol=1e-5)
    lamp = even.pixels * 0
    lamp[40:44, 80:84] = 1000.0
    out = flare.glare(even.with_pixels(lamp), fraction=0.1).pixels
    np.testing.assert_allclose(out.sum(axis=(0, 1)), lamp.sum(axis=(0, 1)), rtol=1e-3)
    np.testing.assert_allclose(out[41, 81], 900.0, rtol=0.05)
    assert 0 < out[10, 10, 0] < out[40, 60, 0] < out[40, 75, 0]


def added(image: Image, **params) -> np.ndarray:
    """What the node adds to the green channel, per unit of the lamp's light, away from the lamp."""
    out = flare.flare(image, **LENS, **params).pixels[..., 1].astype(np.float64) - 1.0
    return out / (image.pixels[..., 1].max() - 1.0)


@pytest.mark.parametrize(("blades", "spikes"), [(5, 10), (6, 6)])
def test_a_polygon_makes_its_spikes(blades, spikes):
    """As many as blades where that is even, twice as many where it is odd; counted around a circle of 70 pixels."""
    angle = np.radians(np.arange(0.0, 360.0, 0.5))
    star = added(lamp(), blades=blades, rotation_deg=10.0)
    ring = np.mean(
        [
            star[np.rint(200 - r * np.sin(angle)).astype(int), np.rint(200 + r * np.cos(angle)).astype(int)]
            for r in range(60, 80)
        ],
        axis=0,
    )
    high = ring > 0.25 * ring.max()
    assert np.count_nonzero(high & ~np.roll(high, 1)) == spikes
    assert (
        abs(math.degrees(angle[: 720 // spikes][ring[: 720 // spikes].argmax()]) - 10.0) <= 1.0
    )  # anticlockwise from the right


def test_a_spike_falls_as_the_square_of_the_distance():
    """Far from the lamp a pair of edges of length L sends L q D / (2 pi^2 A r^2) of the light into each pixel of its
    spike, A the aperture's area.

    From |integral over the polygon|^2 near the normal of an edge, its fringes averaged.
    A regular hexagon of the area of a
    circle of diameter D has L / D = 0.550 and L D / A = 0.700.  Across, it is sinc^2(y L / (q D)), of which three rows
    hold
    2/pi (Si(2 x) - sin^2(x) / x), x = 1.5 pi L / (q D); what a round aperture sends there, q / (pi^3 r^3), is not the
    star's.
    5 %: fringes along the spike do not quite average out in a pixel.
    """
    q = 0.550 * 4.0 / 3.0
    star = added(lamp(), blades=6)
    r = np.arange(30, 110)
    blocks = (star[199:202, 200 + r].sum(axis=0) * r**2).reshape(8, 10).mean(axis=1)
    x = 1.5 * math.pi * 0.550 / q
    share = 2 / math.pi * (sici(2 * x)[0] - math.sin(x) ** 2 / x)
    expected = share * 0.700 * q / (2 * math.pi**2) - 3 * q / (math.pi**3 * r).reshape(8, 10).mean(axis=1)
    np.testing.assert_allclose(blocks, expected, rtol=0.05)


def test_no_light_is_made_or_lost():
    """The lamp stands near the middle, so that its star lies inside; float32 sums to 1e-4."""
    image = lamp(at=(190, 210))
    out = flare.flare(image, **LENS, blades=6).pixels.astype(np.float64)
    np.testing.assert_allclose(out.sum(axis=(0, 1)), image.pixels.sum(axis=(0, 1), dtype=np.float64), rtol=1e-4)
    assert out.min() >= 0.0
    moved = 1.0 - (out[190, 210, 1] - 1.0) / 1e6
    assert moved > 0.009

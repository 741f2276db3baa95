"""ISO 12233: a slanted edge through optics and pixels keeps the contrast that diffraction and the pixel's area leave.

The edge is drawn as the light on square pixels (12 x 12 samples each, which is the
pixel's part), blurred by `optics.diffraction`, and read as the standard does: the
edge's place by row, all pixels by their distance to it in bins of a quarter pixel,
the derivative, a window, its Fourier transform.

Two bounds.  0.01 against theory that is read through the same bins and window: an
edge spread function computed by quadrature of its transfer function at every pixel's
distance.  And 0.003 + 0.012 q, q = lambda N / pitch, against the bare product of the
two transfer functions: 2 q / (pi^2 r) of the light, 0.007 q, lies outside the window's
r = 30 pixels, and some inside is dimmed by it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from synfog_usd.base import photometry
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import blur
from synfog_usd.camera.profiles import load_sensor

pytestmark = pytest.mark.physics

TILT = math.radians(5.0)
HEIGHT, WIDTH = 200, 150
REACH_PX, BINS = 30, 4
GREEN = tuple(photometry.band_name(centre) for centre in (549.0, 550.0, 551.0))


def distance(row, column):
    """From the edge, along its normal [px]."""
    return (column - (WIDTH - 1) / 2) * math.cos(TILT) + (row - (HEIGHT - 1) / 2) * math.sin(TILT)


def drawn() -> np.ndarray:
    """1 to 3 across the edge, averaged over each pixel."""
    fine = (np.arange(12) + 0.5) / 12 - 0.5
    row, column = np.arange(HEIGHT)[:, None, None, None], np.arange(WIDTH)[None, :, None, None]
    return 1.0 + 2.0 * (distance(row + fine[:, None], column + fine[None, :]) > 0.0).mean(axis=(2, 3))


def transfer(f, q):
    """Of disc and pixel at f cycles per pixel along the edge's normal."""
    v = np.minimum(f * q, 1.0)
    disc = 2 / math.pi * (np.arccos(v) - v * np.sqrt(1 - v * v))
    return disc * np.sinc(f * math.cos(TILT)) * np.sinc(f * math.sin(TILT))


def theory(q) -> np.ndarray:
    """2 + 2 / pi integral of transfer(f) sin(2 pi f x) / f at every pixel's distance x, by Gauss and Legendre in 40
    pieces up to 1 / q, or to 8.
    """
    top = min(1.0 / q, 8.0)
    node, weight = np.polynomial.legendre.leggauss(32)
    pieces = np.linspace(0.0, top, 41)
    f = ((pieces[1:] + pieces[:-1])[:, None] / 2 + (pieces[1:] - pieces[:-1])[:, None] / 2 * node).ravel()
    w = ((pieces[1:] - pieces[:-1])[:, None] / 2 * weight).ravel()
    x = np.linspace(-100.0, 100.0, 20_001)
    spread = 2.0 + 2.0 / math.pi * np.array([np.sum(w * transfer(f, q) * np.sin(2 * math.pi * f * at) / f) for at in x])
    return np.interp(distance(np.arange(HEIGHT)[:, None], np.arange(WIDTH)[None, :]), x, spread)


def read(picture) -> tuple[np.ndarray, np.ndarray]:
    """Frequency [cycles/pixel] and contrast, as ISO 12233 finds them, the derivative's own loss and the bins' put
    right.
    """
    slope = np.diff(picture, axis=1) * np.hanning(WIDTH + 1)[1:-1]
    centres = (slope * (np.arange(WIDTH - 1) + 0.5)).sum(axis=1) / slope.sum(axis=1)
    b, a = np.polyfit(np.arange(HEIGHT), centres, 1)
    x = (np.arange(WIDTH)[None, :] - a - b * np.arange(HEIGHT)[:, None]) * math.cos(math.atan(b))
    bins = np.floor(x * BINS).astype(int) + REACH_PX * BINS
    used = (bins >= 0) & (bins < 2 * REACH_PX * BINS)
    counts = np.bincount(bins[used], minlength=2 * REACH_PX * BINS)
    assert counts.min() > 0
    edge = np.bincount(bins[used], weights=picture[used], minlength=2 * REACH_PX * BINS) / counts
    line = (edge[2:] - edge[:-2]) * np.hamming(edge.size - 2)
    f = np.fft.rfftfreq(line.size, 1 / BINS)
    found = np.abs(np.fft.rfft(line))
    return f, found / found[0] / np.sinc(2 * f / BINS) / np.sinc(f / BINS)


@pytest.mark.parametrize("f_number, pitch_um", [(1.8, 1.4), (4.0, 3.0), (8.0, 3.0)])
def test_a_slanted_edge_has_the_contrast_of_disc_and_pixel(f_number, pitch_um):
    q = 0.550 * f_number / pitch_um
    light = Image(np.repeat(drawn()[..., None].astype(np.float32), 3, axis=2), GREEN, Quantity.IRRADIANCE)
    out = blur.diffraction(light, mode="band", f_number=f_number, pixel_pitch_um=pitch_um, sensor=load_sensor("imx363"))
    f, found = read(out.pixels[..., 1].astype(np.float64))
    _, expected = read(theory(q))
    wanted = f <= 0.5
    worst = np.abs(found - expected)[wanted].max()
    assert worst < 0.01, f"f/{f_number:g}, {pitch_um:g} um: off by {worst:.4f}"
    bare = np.abs(found - transfer(f, q))[wanted].max()
    assert bare < 0.003 + 0.012 * q, f"f/{f_number:g}, {pitch_um:g} um: {bare:.4f} off the bare product"


def test_a_wrong_f_number_would_be_seen():
    """f/5.6 for f/4 at 3 um moves the contrast by 0.1."""
    _, right = read(theory(0.550 * 4.0 / 3.0))
    f, wrong = read(theory(0.550 * 5.6 / 3.0))
    assert np.abs(right - wrong)[f <= 0.5].max() > 0.08

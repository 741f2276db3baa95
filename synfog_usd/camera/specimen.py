"""Ops for the pixels of one specimen that differ from the rest: crosstalk, hot, dead and flickering pixels, and a
converter that is not quite straight.

All are optional.  Which pixels are concerned follows from the sensor's serial, the same in every frame; what a
flickering pixel shows comes from the node's own stream.  `isp.defects` is what mends them.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.registry import OPS
from synfog_usd.camera.sensor import (
    AMPLIFIED,
    ELECTRONS,
    HELD_ELECTRONS,
    MEAN_ELECTRONS,
    READ_ELECTRONS,
    pattern_of,
    row_times,
)

PPM = 1e-6

Ppm = Annotated[float, Range(0.0, 1e5)]


@OPS.op("sensor.crosstalk", takes=MEAN_ELECTRONS, gives=MEAN_ELECTRONS)
def crosstalk(image: Image, *, crosstalk_percent: Annotated[float, Range(0.0, 80.0)] = 2.0) -> Image:
    """Charge that wanders into the four next pixels, whatever their filter, before it is collected.

    A pixel keeps 1 - c of its electrons and gets c / 4 of each neighbour's.  Its contrast at f
    cycles a pixel along a row is then 1 - c / 2 (1 - cos 2 pi f), and colours grow paler.  At
    the edges of the picture the charge comes back: none is lost.

    Args:
        image: mean electrons, right behind `sensor.expose`.
        crosstalk_percent: c [%], to all four together.
    """
    part = np.float32(crosstalk_percent / 100.0)
    electrons = image.pixels[..., 0]
    around = np.pad(electrons, 1, mode="edge")
    shared = around[:-2, 1:-1] + around[2:, 1:-1]
    shared += around[1:-1, :-2]
    shared += around[1:-1, 2:]
    shared *= part / np.float32(4.0)
    shared += (np.float32(1.0) - part) * electrons
    return image.with_pixels(shared[..., None])


@OPS.op("sensor.dark_nonuniformity", takes=MEAN_ELECTRONS, gives=MEAN_ELECTRONS)
def dark_nonuniformity(
    image: Image,
    *,
    spread_percent: Annotated[float, Range(0.0, 300.0)] = 20.0,
    hot_ppm: Ppm = 100.0,
    hot_times: Annotated[float, Range(1.0, 1e6)] = 200.0,
    serial: Annotated[str, FromProfile("sensor.serial")],
) -> Image:
    """Dark current that differs from pixel to pixel, and the few that have far more of it.

    The common dark current is multiplied by a log-normal number of mean 1; a hot pixel gets
    `hot_times` E of it besides, E exponential of mean 1.  Both follow time and temperature as
    the dark current does, and both are the same pixels in every frame.

    Args:
        image: mean electrons behind `sensor.dark_current`.
        spread_percent: standard deviation of the ordinary pixels' dark current [%].
        hot_ppm: hot pixels in a million [1].
        hot_times: their mean dark current over the common one [1].
        serial: which specimen.

    Raises:
        ImageError: no dark current was added before.

    The numbers are estimates: give those of your data sheet.

    Source: EMVA 1288 release 4.0, sections on dark current and its nonuniformity.
    """
    if "dark_e" not in image.provenance:
        raise ImageError("the image says of no dark current; put sensor.dark_current before this node")
    dark_e = np.float32(image.provenance["dark_e"]) * row_times(image.provenance, image.height_px)
    sigma = np.float32(np.sqrt(np.log1p((spread_percent / 100.0) ** 2)))
    times = np.exp(sigma * pattern_of(image, serial, "dark spread") - sigma * sigma / np.float32(2.0))
    hot, excess = _chosen(pattern_of(image, serial, "hot"), hot_ppm)
    times[hot] += np.float32(hot_times) * excess
    return image.with_pixels(image.pixels + dark_e * (times - np.float32(1.0)))


@OPS.op("sensor.dead_pixels", takes=HELD_ELECTRONS, gives=ELECTRONS)
def dead_pixels(
    image: Image,
    *,
    dead_ppm: Ppm = 20.0,
    stuck_ppm: Ppm = 20.0,
    full_well_e: Annotated[float, Range(1.0, 1e9), FromProfile("sensor.full_well_e")],
    serial: Annotated[str, FromProfile("sensor.serial")],
) -> Image:
    """Pixels that show no light at all, and pixels that are always full.

    Args:
        image: electrons, with shot noise or before it.
        dead_ppm, stuck_ppm: of a million pixels, those without answer, and those at full well [1].
        full_well_e: what a pixel holds [e-].
        serial: which specimen.
    """
    pixels = image.pixels.copy()
    for kind, ppm, held_e in (("dead", dead_ppm, 0.0), ("stuck", stuck_ppm, full_well_e)):
        concerned, _ = _chosen(pattern_of(image, serial, kind), ppm)
        pixels[concerned] = held_e
    return image.with_pixels(pixels)


@OPS.op("sensor.telegraph_noise", takes=ELECTRONS, gives=READ_ELECTRONS)
def telegraph_noise(
    image: Image,
    *,
    rng: np.random.Generator,
    telegraph_ppm: Ppm = 1000.0,
    telegraph_e: Annotated[float, Range(0.0, 1e4)] = 10.0,
    serial: Annotated[str, FromProfile("sensor.serial")],
) -> Image:
    """Pixels whose amplifier has a trap that catches and frees one electron: their value blinks.

    A pixel is read twice and the difference counts (correlated double sampling).  The trap is full half of the time.
    So a quarter of the frames shows the step A, a quarter -A, and half of them nothing.  The pixel's variance is
    A^2 / 2.  A is a pixel's own, exponential over the pixels.

    Args:
        image: electrons.
        rng: the node's stream.
        telegraph_ppm: such pixels in a million [1].
        telegraph_e: mean of A [e-].
        serial: which specimen.

    Source: Wang, Rao, Mierop and Theuwissen, "Random telegraph signal in CMOS image sensor pixels", IEDM 2006.
    """
    blinking, excess = _chosen(pattern_of(image, serial, "telegraph"), telegraph_ppm)
    state = rng.integers(0, 4, excess.shape, dtype=np.int8)
    step = (state == 0).astype(np.float32) - (state == 1).astype(np.float32)
    pixels = image.pixels.copy()
    pixels[blinking] += np.float32(telegraph_e) * excess * step
    return image.with_pixels(pixels)


@OPS.op("sensor.nonlinearity", takes=AMPLIFIED, gives=AMPLIFIED)
def nonlinearity(
    image: Image,
    *,
    inl_dn: Annotated[float, Range(-1000.0, 1000.0)] = 1.0,
    black_level_dn: Annotated[int, Range(0, 65535), FromProfile("sensor.black_level_dn")],
    white_level_dn: Annotated[int, Range(1, 65535), FromProfile("sensor.white_level_dn")],
) -> Image:
    """An integral nonlinearity: the converter's answer leaves the straight line by at most `inl_dn`.

    y = x + inl sin(2 pi x / span): above the line in the lower half and below it in the upper one, or the other way
    round, and straight beyond both ends.

    Args:
        image: amplified signal [DN], black at 0.
        inl_dn: largest deviation from the line through the ends [DN].
        black_level_dn, white_level_dn: their difference is the span [DN].

    Raises:
        ImageError: so large that more light would give fewer DN.
    """
    span = float(white_level_dn - black_level_dn)
    if span <= 0.0 or abs(inl_dn) * 2.0 * np.pi >= span:
        raise ImageError(f"inl_dn {inl_dn:g} over a span of {span:g} DN would give fewer DN for more light")
    inside = np.clip(image.pixels, 0.0, np.float32(span))
    return image.with_pixels(image.pixels + np.float32(inl_dn) * np.sin(np.float32(2.0 * np.pi / span) * inside))


def _chosen(normal: FloatArray, ppm: float) -> tuple[np.ndarray, FloatArray]:
    """Mask (H, W, 1) of the pixels above the quantile that leaves `ppm` of a million.  Each has an exponential
    number of mean 1, which follows from how far above it lies.
    """
    from scipy.special import ndtr, ndtri  # a third of a second, for graphs that have such pixels only

    if ppm <= 0.0:
        return np.zeros(normal.shape, dtype=bool), np.empty(0, dtype=np.float32)
    part = ppm * PPM
    mask = normal > np.float32(-ndtri(part))
    tail = ndtr(-normal[mask].astype(np.float64)) / part
    return mask, (-np.log(np.clip(tail, 1e-12, 1.0))).astype(np.float32)

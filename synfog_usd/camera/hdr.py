"""Ops of a high dynamic range: several readings of a pixel become one number.

Readings are DN mosaics of `sensor.adc`: of one exposure through a high and a low
conversion gain, of a long and a short exposure, or of a large and a small diode.
Knows neither light nor noise; what a reading is worth it finds in the provenance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image
from synfog_usd.camera.graph import Range
from synfog_usd.camera.registry import OPS
from synfog_usd.camera.sensor import NUMBERS

MAX_BITS = 24
"""float32 holds whole numbers of so many bits exactly."""


@OPS.op("sensor.merge_hdr", takes=NUMBERS, gives=NUMBERS)
def merge_hdr(
    *images: Image,
    threshold: Annotated[float, Range(0.05, 1.0)] = 0.9,
    blend: Annotated[float, Range(0.0, 0.5)] = 0.05,
) -> Image:
    """One linear number of several readings: that of the most sensitive one that is not full.

    Up to `threshold` of its range a reading counts alone; over the last `blend` of it
    the next less sensitive one takes over in a straight line.  The numbers are DN of
    the most sensitive reading, rounded.  Where one reading hands over to the next, the
    noise jumps to that of the next.

    Args:
        images: two or more readings, in any order; sensitivity is gain x light gathered.
        threshold: part of a reading's range up to which it is trusted [1].  The range
            ends at the white level or the full well, whichever comes first.
        blend: part of the range below that, over which it fades [1].

    Raises:
        ImageError: one image, unlike sizes or colour filters, readings that do not reach further
            than a more sensitive one, or a range above 24 bits.

    The provenance is that of the most sensitive reading; the noise profile holds below the first hand-over.
    """
    if len(images) < 2:
        raise ImageError("one reading has nothing to be merged with; name two or more in 'in'")
    readings = sorted(images, key=_dn_per_light, reverse=True)
    first = readings[0]
    ratios = [_dn_per_light(first) / _dn_per_light(reading) for reading in readings]
    tops = [_top_dn(reading) for reading in readings]
    _check_readings(readings, ratios, tops)
    merged = _signal(readings[-1]) * np.float32(ratios[-1])
    for reading, ratio, top in list(zip(readings, ratios, tops, strict=True))[-2::-1]:
        signal = _signal(reading)
        trust = np.clip((np.float32(threshold * top) - signal) * np.float32(1.0 / max(blend * top, 1e-3)), 0.0, 1.0)
        signal *= np.float32(ratio)
        signal -= merged
        signal *= trust
        merged += signal
    metadata = first.provenance
    black = int(metadata["black_level_dn"])
    white = black + round(tops[-1] * ratios[-1])
    if white.bit_length() > MAX_BITS:
        raise ImageError(
            f"the merged range ends at {white} DN, which needs {white.bit_length()} bits; {MAX_BITS} is the most"
        )
    merged += np.float32(black)
    np.clip(np.rint(merged, out=merged), 0.0, np.float32(white), out=merged)
    shrunk = (float(metadata["white_level_dn"]) - black) / (white - black)
    slope, offset = metadata["noise_profile"]
    return first.with_pixels(merged).with_metadata(
        bits=white.bit_length(),
        white_level_dn=white,
        dark_signal_dn=0.0,
        noise_profile=[slope * shrunk, offset * shrunk**2],
        hdr_ratios=ratios,
        hdr_knees_dn=[black + threshold * top * ratio for top, ratio in zip(tops[:-1], ratios[:-1], strict=True)],
    )


def _check_readings(readings: Sequence[Image], ratios: Sequence[float], tops: Sequence[float]) -> None:
    first = readings[0]
    for reading in readings[1:]:
        if reading.pixels.shape != first.pixels.shape or reading.provenance.get("cfa_pattern") != first.provenance.get(
            "cfa_pattern"
        ):
            raise ImageError(f"readings of {_what(first)} and {_what(reading)} cannot be merged")
    for index in range(1, len(readings)):
        if not tops[index] * ratios[index] > tops[index - 1] * ratios[index - 1]:
            raise ImageError(
                f"reading {index + 1} by sensitivity ends at {tops[index] * ratios[index]:.0f} DN of the first, not "
                f"above the one before "
                f"({tops[index - 1] * ratios[index - 1]:.0f}); lower its factor, exposure_ratio or fill_factor"
            )


@OPS.op("sensor.compand", takes=NUMBERS, gives=NUMBERS)
def compand(
    image: Image,
    *,
    bits: Annotated[int, Range(10, 16)] = 12,
    linear_dn: Annotated[tuple[float, ...], Range(1.0, 2.0**MAX_BITS)],
    code_dn: Annotated[tuple[float, ...], Range(1.0, 65535.0)],
) -> Image:
    """Wide numbers through a narrow interface: straight pieces that get flatter with the light.

    The first piece goes from 0 to the first knee, the last from the last knee to
    white, which becomes 2^bits - 1.  `isp.decompand` takes it back, but for the rounding.

    Args:
        image: linear DN.
        bits: of the codes.
        linear_dn, code_dn: knee points, both rising: DN that come in, and codes that
            go out [DN].

    Raises:
        ImageError: lists of unlike length, points that do not rise, a piece steeper
            than 1, companded numbers, or a black level whose code is no whole number.
    """
    metadata = image.provenance
    if "companding" in metadata:
        raise ImageError("the numbers are companded already")
    black, white, highest = int(metadata["black_level_dn"]), int(metadata["white_level_dn"]), 2**bits - 1
    if len(linear_dn) != len(code_dn):
        raise ImageError(
            f"linear_dn has {len(linear_dn)} numbers and code_dn {len(code_dn)}; a knee point is one of each"
        )
    linear, codes = np.array([0.0, *linear_dn, white]), np.array([0.0, *code_dn, highest])
    slopes = np.diff(codes) / np.diff(linear) if (np.diff(linear) > 0.0).all() else np.array([-1.0])
    if not ((slopes > 0.0) & (slopes <= 1.0)).all():
        points = ", ".join(f"{x:g} -> {y:g}" for x, y in zip(linear, codes, strict=True))
        raise ImageError(
            f"the points {points} do not rise by more than 0 and at most 1 code per DN; the last is white at {bits} "
            f"bits"
        )
    black_code = black * float(slopes[0])
    if black_code != int(black_code) or not black < linear[1]:
        raise ImageError(
            f"black level {black} becomes code {black_code:g}; it has to be whole and below the first knee, such as "
            f"{4 * black} -> {4 * black}"
        )
    numbers = np.interp(image.pixels, linear, codes).astype(np.float32)
    knees = [[black, int(black_code)], *([float(x), float(y)] for x, y in zip(linear[1:], codes[1:], strict=True))]
    return image.with_pixels(np.rint(numbers, out=numbers)).with_metadata(
        bits=bits,
        black_level_dn=int(black_code),
        white_level_dn=highest,
        linear_black_dn=black,
        linear_white_dn=white,
        companding=knees,
    )


def _dn_per_light(image: Image) -> float:
    """DN for a given light, to a scale that the readings of one frame share."""
    for key, op in (
        ("system_gain_dn_e", "sensor.gain"),
        ("gathered_um2_s", "sensor.expose"),
        ("black_level_dn", "sensor.adc"),
    ):
        if key not in image.provenance:
            raise ImageError(f"a reading does not say its {key}; {op} notes it")
    return float(image.provenance["system_gain_dn_e"]) * float(image.provenance["gathered_um2_s"])


def _top_dn(image: Image) -> float:
    """Signal above black at which a reading is full [DN]."""
    metadata = image.provenance
    span = float(metadata["white_level_dn"]) - float(metadata["black_level_dn"])
    return min(span, float(metadata.get("full_well_e", np.inf)) * float(metadata["system_gain_dn_e"]))


def _signal(image: Image) -> np.ndarray:
    metadata = image.provenance
    return image.pixels - np.float32(metadata["black_level_dn"] + metadata.get("dark_signal_dn", 0.0))


def _what(image: Image) -> str:
    return (
        f"{image.width_px} x {image.height_px} pixels behind {image.provenance.get('cfa_pattern', 'unknown filters')}"
    )

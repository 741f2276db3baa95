"""Lamps that blink faster than the eye sees: LEDs dimmed by pulse width, and lamps on alternating current.

A camera with a short exposure catches them lit, dark or, under a rolling shutter, in bands.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera.graph import Auto, Range
from synfog_usd.camera.registry import OPS


@OPS.op("light.flicker", takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)
def flicker(
    *images: Image,
    frequency_hz: Annotated[tuple[float, ...], Range(0.0, 1e6)],
    duty: Annotated[tuple[float, ...], Range(0.0, 1.0, above=True)],
    phase: Annotated[tuple[float, ...], Range(0.0, 1.0)] = (),
    exposure_s: Annotated[float, Range(0.0, 3600.0, above=True), Auto()],
    readout_s: Annotated[float, Range(0.0, 10.0)] = 0.0,
    shutter: Literal["rolling", "global_reset"] = "rolling",
) -> Image:
    """A view in which some of the light comes from lamps that are pulsed.

    L(row) = L + sum of (s_i(row) - 1) L_i.  s is the share of the row's exposure in which the lamp is on over its
    duty, 1 on average: what a stage authors is a lamp's mean.  A row at the height v of the picture, 0 to 1 from the
    top, begins at v * readout_s; under global reset all begin together, and it lasts v * readout_s longer.

    Args:
        images: the radiance of the whole view, then that of each group of lamps alone; `layers.exr` has them, and a
            bake gives them to inputs of the same name, such as `lightgroup_street_lamps`.
        frequency_hz: f, one per group [Hz]; 0 for steady light.  Mains lamps have 100 or 120, signals and headlights
            of LEDs 90 to some 1000.
        duty: d, one per group: the part of a period in which it is on [1].
        phase: one per group: the part of its period that is gone when the top row begins, 0 where it comes on [1];
            0 if left out.
        exposure_s: of each row [s]; under global reset of the top row.
        readout_s: from the top row's beginning to the bottom row's [s]; 0 for a global shutter.
        shutter: whether rows begin one after the other, or together; as `sensor.expose` has it.

    Raises:
        ImageError: sizes, channels or counts differ.

    Source: the integral of a square wave; frequencies and duties: Deegan, "LED flicker: root cause, impact and
    measurement for automotive imaging applications", Electronic Imaging 2018.
    """
    whole, groups = images[0], images[1:]
    phases = phase or (0.0,) * len(groups)
    if not len(groups) == len(frequency_hz) == len(duty) == len(phases):
        raise ImageError(
            f"{len(groups)} groups of lamps, but {len(frequency_hz)} frequencies, {len(duty)} duties and "
            f"{len(phases)} phases"
        )
    later_s = (np.arange(whole.height_px) + 0.5) / whole.height_px * readout_s
    begin_s, lasts_s = (0.0 * later_s, exposure_s + later_s) if shutter == "global_reset" else (later_s, exposure_s)
    pixels = whole.pixels.copy()
    for group, hertz, part, gone in zip(groups, frequency_hz, duty, phases, strict=True):
        if group.pixels.shape != whole.pixels.shape or group.channels != whole.channels:
            raise ImageError(
                f"light of shape {group.pixels.shape} with {group.channels} is no part of one of "
                f"{whole.pixels.shape} with {whole.channels}"
            )
        if hertz > 0.0:
            lit = lit_share(begin_s, lasts_s, hertz, part, gone) / part
            pixels += (lit - 1.0).astype(np.float32)[:, None, None] * group.pixels
    return whole.with_pixels(np.maximum(pixels, 0.0, out=pixels))


def lit_share(
    begin_s: npt.NDArray[np.float64],
    exposure_s: float | npt.NDArray[np.float64],
    frequency_hz: float,
    duty: float,
    phase: float,
) -> npt.NDArray[np.float64]:
    """Share of exposures in which a pulsed lamp is on, in closed form.

    Args:
        begin_s: when each begins [s], any shape.
        exposure_s: how long each lasts [s], above 0; one for all, or one for each.
        frequency_hz, duty, phase: see `flicker`; the frequency is above 0.

    Returns:
        0 to 1, shape of `begin_s`.
    """
    first = begin_s * frequency_hz + phase
    last = first + exposure_s * frequency_hz

    def lit(periods: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        whole = np.floor(periods)
        return np.asarray(whole * duty + np.minimum(periods - whole, duty))

    return np.clip((lit(last) - lit(first)) / (exposure_s * frequency_hz), 0.0, 1.0)

"""Op for drops that lie on the windscreen: each shows the view upside down, out of focus, until the wiper comes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from synfog_usd.base.arrays import Array, FloatArray
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.seeds import stream
from synfog_usd.camera import spread
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.pinhole import Pinhole
from synfog_usd.camera.registry import FOV, OPS
from synfog_usd.camera.streaks import GOLDEN_RAD

SEEN_RAD = math.radians(82.5)
"""Angle to its axis up to which a drop shows what is before it: Garg and Nayar (2007) have 165 degrees in all."""

SWEEP = 0.5
"""Part of a wiper's period for which its blade is on its way over the picture."""

SPREAD = 1.5
"""Geometric standard deviation of the drops' diameters: an estimate."""

PER_PX2, MOST_POINTS, MOST_DROPS = 4.0, 1 << 15, 20_000


@dataclass(frozen=True)
class _Lying:
    """Drops on the glass.

    Attributes:
        place_m: (N, 2) right of and below the camera's axis [m].
        diameter_m: (N,) [m].
    """

    place_m: Array
    diameter_m: Array


@OPS.op("optics.drops_on_glass", takes=Quantity.RADIANCE, gives=Quantity.RADIANCE)
def drops_on_glass(
    image: Image,
    *,
    density: Annotated[float, Range(0.0, 20.0)] = 1.0,
    diameter_mm: Annotated[float, Range(0.1, 10.0)] = 2.5,
    glass_m: Annotated[float, Range(0.02, 3.0)] = 0.15,
    wiper_s: Annotated[float, Range(0.1, 600.0)] = 3.0,
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    focal_length_mm: Annotated[float, Range(0.1, 2000.0), FromProfile("lens.focal_length_mm")],
    fov_x_deg: Annotated[float | None, Range(0.0, 170.0, above=True), FOV] = None,
) -> Image:
    """A view through a windscreen with drops on it, which a wiper takes away from the left to the right.

    Drops land by a Poisson process and stay until the wiper's next pass.  Each shows the picture upside down, up to
    82.5 degrees from its middle, and beyond the picture's border what is on the border.  Lens and glass are apart by
    much less than the focus is far, so each point of a drop is a disc f / N d [rad] wide.

    Frames of a clip, which say `frame_number` and `frames_per_s`, show the same drops; all cameras have the same.  In
    the first frame the wiper begins a pass.

    Args:
        image: radiance (H, W, C) of a pinhole.
        density: drops that have landed when the wiper comes again [1/cm2].
        diameter_mm: median diameter of what a drop wets [mm].
        glass_m: d, from the lens to the glass, across the axis [m].
        wiper_s: from one pass to the next [s]; half of it goes by while the blade is before the picture.
        f_number: N [1].
        focal_length_mm: f [mm].
        fov_x_deg: horizontal angle of view [degrees].

    Raises:
        ImageError: no angle of view, a fisheye's picture, or more than 20 000 drops.
    """
    if fov_x_deg is None or "fisheye_coefficients" in image.provenance:
        raise ImageError(f"drops on glass need a pinhole's angle of view: {FOV.hint}")
    view = Pinhole.of(image, fov_x_deg)
    scale_px = view.focal_px / glass_m  # a metre on the glass
    now_s = float(image.provenance.get("frame_number", 0)) / float(image.provenance.get("frames_per_s", 1.0))
    blur_m = 1e-3 * focal_length_mm / f_number
    corners = np.array([(0, 0), (image.width_px, image.height_px)]) - view.axis_px
    area = corners[0] / scale_px - blur_m, corners[1] / scale_px + blur_m
    lying = _lying(area, 1e4 * density, 1e-3 * diameter_mm, wiper_s, now_s)
    light, cover = _seen(image.pixels, view, lying, scale_px, blur_m * scale_px)
    whole = np.minimum(cover, 1.0)
    shown = light / np.maximum(cover, 1e-9)[:, :, None]
    pixels = image.pixels * (1.0 - whole)[:, :, None] + shown * whole[:, :, None]
    return image.with_pixels(pixels.astype(np.float32)).with_metadata(drops_on_glass=len(lying.diameter_m))


def _lying(area: tuple[Array, Array], density_per_m2: float, median_m: float, period_s: float, now_s: float) -> _Lying:
    """The drops in a rectangle of the glass at a moment: of each pass of the wiper, those that came since and before
    the next.
    """
    low, high = area
    places, sizes = [np.zeros((0, 2))], [np.zeros(0)]
    mean = density_per_m2 * float(np.prod(high - low))
    if mean > MOST_DROPS:
        raise ImageError(f"{mean:.0f} drops on the glass; lower density: {MOST_DROPS} are the most")
    last = math.floor(now_s / period_s)
    for number in (last - 1, last):
        rng = stream(number, "drops on glass")
        count = int(rng.poisson(mean))
        share = rng.random((count, 2))
        landed = rng.random(count)
        diameter = median_m * np.exp(rng.normal(0.0, math.log(SPREAD), count))
        wiped = number + SWEEP * share[:, 0]
        stay = (wiped + landed <= now_s / period_s) & (now_s / period_s < wiped + 1.0)
        places.append((low + share * (high - low))[stay])
        sizes.append(diameter[stay])
    return _Lying(np.concatenate(places), np.concatenate(sizes))


def _seen(pixels: FloatArray, view: Pinhole, lying: _Lying, scale_px: float, blur_px: float) -> tuple[Array, Array]:
    """(H, W, C) light of the drops times what they cover, and (H, W) what they cover of each pixel."""
    from scipy.signal import fftconvolve

    height, width = pixels.shape[:2]
    radius = 0.5 * scale_px * lying.diameter_m
    middle = lying.place_m * scale_px + np.array(view.axis_px)
    count = np.clip(PER_PX2 * (2.0 * radius + 1.0) ** 2, 8.0, MOST_POINTS).astype(np.int64)
    drop = np.repeat(np.arange(len(count)), count)
    point = np.arange(len(drop)) - np.repeat(np.cumsum(count) - count, count)
    off, turn = np.sqrt((point + 0.5) / count[drop]), GOLDEN_RAD * point
    way = np.column_stack([np.cos(turn), np.sin(turn)])
    bent_px = view.focal_px * np.tan(off * SEEN_RAD)
    source = np.clip(np.rint(middle[drop] - way * bent_px[:, None]), 0, (width - 1, height - 1)).astype(np.int64)
    margin = math.ceil(0.5 * blur_px) + 1
    shape = height + 2 * margin, width + 2 * margin
    target = np.rint(middle[drop] + way * (off * radius[drop])[:, None]).astype(np.int64) + margin
    inside = np.all((target >= 0) & (target < shape[::-1]), axis=1)
    index, source = target[inside] @ (1, shape[1]), source[inside]
    weight = (math.pi * radius**2 / count)[drop][inside]
    colours = pixels[source[:, 1], source[:, 0]]
    weights = [np.ones_like(weight), *colours.T]
    spot = spread.disc(blur_px) if blur_px > 1.0 else np.ones((1, 1), np.float32)
    planes = [np.bincount(index, weight * colour, shape[0] * shape[1]).reshape(shape) for colour in weights]
    cover, *light = (fftconvolve(plane, spot, "same")[margin:-margin, margin:-margin] for plane in planes)
    return np.maximum(np.stack(light, axis=2), 0.0), np.maximum(cover, 0.0)

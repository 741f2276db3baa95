"""Op for a picture that a pinhole took, as a lens of finite opening would show it: sharp at one distance alone.

Irradiance and depth in, irradiance out.  The picture is cut into layers by the size of their discs, each is blurred by
its own, and the nearer ones cover what lies behind them.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ImageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.camera import spread
from synfog_usd.camera.graph import FromProfile, Range
from synfog_usd.camera.registry import OPS

DEPTHS = ("depth.Z", "Z")
"""What a channel of depth is called: by a bake, and by OpenEXR's manual."""

DISC_MAX_PX = 2048.0
"""Widest disc of a lens out of focus."""

FINE_PX, WIDENING = 0.5, 1.1
"""Discs of the layers: each is wider by the first, and from 5 pixels on by the second times."""

SEEN = 0.03
"""Part of a disc that must have been seen for what is behind nearer things to be estimated from it alone."""


@OPS.op("optics.depth_of_field", takes=(Quantity.IRRADIANCE, Quantity.DATA), gives=Quantity.IRRADIANCE)
def depth_of_field(
    image: Image,
    depth: Image,
    *,
    focus_m: Annotated[float, Range(0.01)],
    f_number: Annotated[float, Range(0.5, 64.0), FromProfile("lens.f_number")],
    focal_length_mm: Annotated[float, Range(0.1, 2000.0), FromProfile("lens.focal_length_mm")],
    pixel_pitch_um: Annotated[float, Range(0.3, 50.0), FromProfile("sensor.pixel_pitch_um")],
) -> Image:
    """Blur by depth: each surface of a pinhole's picture out of focus by its own distance.

    A point at depth d becomes a disc of diameter c = f^2 / (N (s - f)) |d - s| / d on the sensor; OTF = 2 J1(x) / x,
    x = pi c frequency; lamps (8 times the channel's 95th percentile) become discs integrated over pixels.

    Layers lie at diameters half a pixel apart up to 5 pixels, and each 1.1 times the last from there.  A pixel belongs
    to the two next to it, in the ratio of the squares.  A nearer layer covers what is behind by the part of its disc
    that lies on it.  Of a layer that nearer pixels hide in part, the rest is taken to be like the part that is seen;
    where none is within the disc, like what is seen around, by a Gaussian.  So nothing sharp leaks into what is blurred
    behind it, and an even picture stays even whatever its depth.  What a lens sees behind an edge, and a pinhole does
    not, is a guess.

    All light of a pixel is blurred as its surface is, what fog scattered on the way to it too: pictures do not tell
    from where along the ray that came.  A mirror image, and what is seen through glass, are as sharp as the glass.
    Depth is of the middle of a pixel, so that edges keep the pinhole's pixels at one side.

    Args:
        image: irradiance (H, W, C) of a pinhole's picture.  One that was baked with an fStop is refused.
        depth: (H, W, ...) with a channel `depth.Z` or `Z`, or one alone [m]: along the axis, not along the ray;
            infinite where there is nothing.
        focus_m: depth s of the plane that is sharp [m], beyond the focal length.
        f_number: N [1].
        focal_length_mm: f [mm].
        pixel_pitch_um: distance of the picture's pixels on the sensor [um].

    Raises:
        ImageError: no depth, one of another size, or one that is not above 0; the lens cannot focus so near, or a disc
            is wider than 2048 pixels.

    Source: Goodman, "Introduction to Fourier Optics", section 6.4; layers: Kraus and Strengert, "Depth-of-field
    rendering by pyramidal image processing", Computer Graphics Forum 26 (2007), with other rules for what is hidden.
    """
    if (sharp_m := image.provenance.get("sharp_at_m")) is not None:
        raise ImageError(
            f"the picture was rendered through a thin lens, focused at {sharp_m:g} m, and is blurred already; set the "
            f"stage's fStop to 0"
        )
    far_px = blur_disc_um(focus_m, None, f_number=f_number, focal_length_mm=focal_length_mm) / pixel_pitch_um
    with np.errstate(over="ignore"):
        discs_px = (far_px * (1.0 - focus_m / _plane_of(depth, image).astype(np.float64))).astype(np.float32)
    nearest, farthest = float(discs_px.min()), float(discs_px.max())
    if max(-nearest, farthest) > DISC_MAX_PX:
        raise ImageError(
            f"a blur disc of {max(-nearest, farthest):.0f} pixels; the widest is {DISC_MAX_PX:.0f}: bring focus_m "
            f"nearer to the depth, which begins at {far_px * focus_m / (far_px - nearest):.3g} m, or raise f_number"
        )
    return image.with_pixels(_focused(image.pixels, discs_px)).with_metadata(
        depth_of_field_px=[float(f"{part:.4g}") for part in (nearest, farthest)]
    )


def blur_disc_um(focus_m: float, distance_m: float | None, *, f_number: float, focal_length_mm: float) -> float:
    """Diameter [um] of the disc that a point out of focus makes; `distance_m` None is far away.

    Raises:
        ImageError: a lens that cannot focus so near.


    >>> round(blur_disc_um(5.0, None, f_number=2.0, focal_length_mm=6.0), 3)
    3.604
    """
    f_m = focal_length_mm * 1e-3
    if focus_m <= f_m:
        raise ImageError(
            f"a lens of {focal_length_mm:g} mm cannot focus at focus_m {focus_m:g}; it takes a distance beyond the "
            f"focal length"
        )
    relative = 1.0 if distance_m is None else abs(distance_m - focus_m) / distance_m
    return f_m * f_m / (f_number * (focus_m - f_m)) * relative * 1e6


def _plane_of(depth: Image, image: Image) -> FloatArray:
    """(H, W) depth [m]."""
    named = [name for name in DEPTHS if name in depth.channels] or list(depth.channels[: len(depth.channels) == 1])
    if not named:
        raise ImageError(f"no channel {' or '.join(DEPTHS)} tells the depth; there are {', '.join(depth.channels)}")
    plane = depth.pixels[..., depth.channels.index(named[0])]
    if plane.shape != image.pixels.shape[:2]:
        raise ImageError(
            f"depth of {depth.width_px} x {depth.height_px} for a picture of {image.width_px} x {image.height_px}; "
            f"labels.exr is what the sensor sees, so behind a lens that distorts it goes with the picture after "
            f"optics.distortion"
        )
    if (bad := ~(plane > 0.0)).any():
        row, column = (int(index[0]) for index in np.nonzero(bad))
        raise ImageError(
            f"depth at x={column}, y={row} is {plane[row, column]:g}; it is above 0, and infinite where there is "
            f"nothing"
        )
    return plane


def _layers(nearest: float, farthest: float) -> list[float]:
    """Diameters [px] of the layers from the nearest to the farthest, below 0 before the focus; they enclose both."""
    widths = [0.0, FINE_PX]
    while widths[-1] < max(-nearest, farthest):
        widths.append(max(WIDENING * widths[-1], widths[-1] + FINE_PX))
    signed = [-width for width in widths[:0:-1]] + widths
    first = max(index for index, width in enumerate(signed) if width <= min(nearest, 0.0))
    last = min(index for index, width in enumerate(signed) if width >= max(farthest, 0.0))
    return signed[first : last + 1]


def _focused(pixels: FloatArray, discs_px: FloatArray) -> FloatArray:
    """(H, W, C) with each pixel in its disc, the nearest in front."""
    height, width, count = pixels.shape
    widths = _layers(float(discs_px.min()), float(discs_px.max()))
    place = np.interp(discs_px * np.abs(discs_px), [part * abs(part) for part in widths], np.arange(len(widths)))
    down, across = (0.5 * np.arange(length) / length for length in (height, width))
    frequency = np.hypot(down[:, None], across).astype(np.float32)
    planes = [np.empty((height, width), np.float32) for _ in range(count)]
    points = [
        spread.taken_out(pixels[..., channel], spread.highlight_limit(pixels[..., channel]), plane)
        for channel, plane in enumerate(planes)
    ]
    total = np.zeros((count, height, width), np.float32)
    nearer = np.zeros((height, width), np.float32)  # share of each pixel in the layers so far
    passing = np.ones((height, width), np.float32)  # what they let through
    widest_px = 0.0  # of their discs
    last = int(np.ceil(place.max()))
    for index, disc_px in enumerate(widths):
        mask = np.maximum(1.0 - np.abs(place - index), 0.0).astype(np.float32)
        if not mask.any():
            continue
        disc = _disc(frequency, abs(disc_px))
        visible = 1.0 - _blurred(nearer, disc)
        hidden = (visible < SEEN) & (passing > 1e-4)
        share = passing / np.maximum(visible, SEEN)
        if index < last:
            share = 1.0 + (share - 1.0) * np.clip((np.abs(share - 1.0) - 0.05) / 0.15, 0.0, 1.0)
        opaque = share * _blurred(mask, disc)
        if hidden.any():
            around = np.exp(-2.0 * np.square(math.pi * max(widest_px / 4.0, 1.0) * frequency))
            share_around = passing / np.maximum(1.0 - _blurred(nearer, around), 1e-3)
            np.copyto(opaque, share_around * _blurred(mask, around), where=hidden)
        for plane, (rows, columns, lights), whole in zip(planes, points, total, strict=True):
            blurred_part = share * _blurred(plane * mask, disc)
            if hidden.any():
                np.copyto(blurred_part, share_around * _blurred(plane * mask, around), where=hidden)
            whole += blurred_part
            if (lamps := lights * mask[rows, columns]).any():
                blurred_part = np.zeros_like(plane)
                spot = spread.disc(abs(disc_px)) if disc_px else np.ones((1, 1), np.float32)
                spread.add_spots(
                    blurred_part, *spread.mirrored(plane.shape, rows, columns, lamps, len(spot) // 2), spot
                )
                whole += blurred_part * np.where(visible < SEEN, passing, np.clip(share, 0.0, 1.0))
        passing -= opaque
        nearer += mask
        widest_px = max(widest_px, abs(disc_px))
    total /= np.maximum(1.0 - passing, 0.5)  # what no layer covered, or two did
    return np.maximum(np.moveaxis(total, 0, 2), 0.0)


def _disc(frequency: FloatArray, disc_px: float) -> FloatArray | None:
    """Contrast that a disc leaves at frequencies [cycles/pixel]; None for one without width."""
    from scipy.special import j1

    if not disc_px:
        return None
    x = np.maximum(np.float32(math.pi * disc_px) * frequency, np.float32(1e-6))
    return np.asarray(2.0 * j1(x) / x)


def _blurred(plane: FloatArray, transfer: FloatArray | None) -> FloatArray:
    """A plane through a transfer at the frequencies of its cosine transform; mirrored at its edges."""
    from scipy import fft

    if transfer is None:
        return plane
    waves = fft.dctn(plane, workers=spread.THREADS)
    waves *= transfer
    return np.asarray(fft.idctn(waves, overwrite_x=True, workers=spread.THREADS))

"""Drops and flakes as a camera sees them: streaks of an exposure, out of focus, row by row, behind what is nearer.

Takes where drops are in the picture, how fast they cross it and how much of it they cover; gives what share of each
pixel they cover, and by what light.  Knows nothing of rain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, FloatArray, Indices

PER_PX2, MOST_POINTS = 6.0, 1 << 16
"""Points by which a pixel's area of a wide streak is drawn, and most of one drop; thin ones have one by pixel."""

GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))
"""From one point of a disc to the next, as sunflowers have their seeds."""

BATCH = 1 << 20
"""Points that are drawn at a time."""

FAINT = 0.03
"""Part of a pixel up to which a drop's points are taken for drops of their own: it errs by half of its square."""

SLOWEST = 0.2
"""Drops that outrun the reading of the rows are drawn as if they went down with it at 0.8 of its speed."""


@dataclass(frozen=True)
class Streaks:
    """Drops before a camera, at the moment at which the middle row is half exposed.

    Attributes:
        place_px: (N, 2) column and row from the picture's corner [px].
        speed_px_s: (N, 2) across the picture [px/s].
        area_px: (N,) that each drop covers [px^2].
        width_px: (N,) diameter of the drop [px]; of an ellipse, whose area is less than the disc's, the longer one.
        turn_rad: (N,) angle from the rows to that one [rad].
        blur_px: (N,) diameter of the disc of what is out of focus [px].
        distance_m: (N,) from the camera [m].
        light: (N, C) radiance of each drop beside what all of them send, or (N, 0).
    """

    place_px: Array
    speed_px_s: Array
    area_px: Array
    width_px: Array
    turn_rad: Array
    blur_px: Array
    distance_m: Array
    light: Array


@dataclass(frozen=True)
class Shutter:
    """When the rows of a picture are exposed.

    Attributes:
        exposure_s: of each row [s].
        readout_s: from the beginning of the top row to that of the bottom row [s]; 0 for a global shutter.
        part: begin and end of the part of the exposure that counts, 0 to 1.
    """

    exposure_s: float
    readout_s: float = 0.0
    part: tuple[float, float] = (0.0, 1.0)


def depth_of(streaks: Streaks, shutter: Shutter, distance_m: FloatArray) -> FloatArray:
    """Optical depth (H, W, 1 + C) of opaque drops in each pixel and its exposure, of which exp(-depth) stays free; and
    the same times the light of each drop.

    A drop covers of a pixel the part of the exposure for which it is before it, times the part of the pixel.  Several
    drops leave the product of what each leaves, whose mean over places of Poisson's process is exp(-mean cover).
    Each is drawn by points that are even in time and in its disc, each shared by the four pixels around it.

    Args:
        streaks: the drops.
        shutter: when rows are exposed.
        distance_m: (H, W) from the camera to what each pixel shows [m], infinite at the sky; it hides what is farther.

    Source: Garg and Nayar, "Vision and rain", International Journal of Computer Vision 75 (2007), section 3.
    """
    height, width = distance_m.shape
    factors = np.concatenate([np.ones((len(streaks.light), 1)), streaks.light], axis=1)
    depth = np.zeros((factors.shape[1], height * width))
    begin, end = shutter.part
    lasts_s = (end - begin) * shutter.exposure_s
    lag_s = shutter.readout_s / height
    behind = 1.0 - lag_s * streaks.speed_px_s[:, 1]
    stretched = 1.0 / np.maximum(behind, SLOWEST)
    middle_s = (0.5 * (begin + end) - 0.5) * shutter.exposure_s
    when_s = (lag_s * (streaks.place_px[:, 1] - 0.5 * height) + middle_s) * stretched
    middle = streaks.place_px + streaks.speed_px_s * when_s[:, None]
    way = streaks.speed_px_s * (lasts_s * stretched)[:, None]
    long = np.sqrt(np.einsum("ij,ij->i", way, way))
    wide = streaks.width_px + streaks.blur_px
    reach = 0.5 * (np.abs(way) + wide[:, None]) + 1.0
    meets = np.all((middle + reach > 0.0) & (middle - reach < (width, height)), axis=1)
    middle, way, wide, far = middle[meets], way[meets], wide[meets], streaks.distance_m[meets]
    discs = np.stack([streaks.width_px, streaks.blur_px], axis=1)[meets]
    flat = (streaks.area_px / (math.pi / 4.0 * streaks.width_px**2))[meets]
    turn = np.exp(1j * streaks.turn_rad[meets])
    factors = factors[meets]
    cover, area = (streaks.area_px * stretched)[meets], (long[meets] + wide + 1.0) * np.maximum(wide, 1.0)
    count = np.where(wide > 1.0, PER_PX2 * area, area)
    count = np.clip(count, 2.0, MOST_POINTS).astype(np.int64)
    faint = cover < FAINT * area
    order = np.argsort(~faint, kind="stable")
    for batch in _batches(count[order], int(faint.sum())):
        some = order[batch]
        drop, point = _points(count[some])
        these = some[drop]
        step, thick = (point + 0.5) / count[these], wide[these] > 1.0
        along = np.where(thick, point * math.sqrt(2.0) % 1.0, step) - 0.5
        drops, blur = _in_discs(discs[these], step, point).T
        aside = np.where(thick, (drops.real + 1j * flat[these] * drops.imag) * turn[these] + blur, 0.0)
        x = middle[these, 0] + way[these, 0] * along + aside.real - 0.5
        y = middle[these, 1] + way[these, 1] * along + aside.imag - 0.5
        together = not faint[some[0]]
        _cover(depth, (x, y), (cover / count)[these], far[these], (these, factors, together), distance_m)
    return np.moveaxis(depth.reshape(-1, height, width), 0, 2).astype(np.float32)


def _in_discs(diameters: Array, step: Array, point: Indices) -> npt.NDArray[np.complex128]:
    """(N, 2) points of two discs around 0, whose sums are even in a drop that is out of focus."""
    radii = 0.5 * diameters * np.sqrt(np.stack([step, point * math.sqrt(3.0) % 1.0], axis=1))
    turns = np.stack([GOLDEN_RAD * point, 2.0 * math.pi * math.sqrt(7.0) * point], axis=1)
    return np.asarray(radii * np.exp(1j * turns))


def _batches(count: Indices, apart: int) -> Iterator[slice]:
    """Drops of about `BATCH` points each time, the first so many apart from the others."""
    ends = np.cumsum(count)
    first = 0
    while first < len(count):
        last = int(np.searchsorted(ends, (ends[first - 1] if first else 0) + BATCH, side="right"))
        last = max(last, first + 1)
        if first < apart < last:
            last = apart
        yield slice(first, last)
        first = last


def _points(count: Indices) -> tuple[Indices, Indices]:
    """(P,) of each point the drop, and which of its points it is."""
    drop = np.repeat(np.arange(len(count)), count)
    return drop, np.arange(len(drop)) - np.repeat(np.cumsum(count) - count, count)


def _cover(
    depth: Array,
    places: tuple[Array, Array],
    cover: Array,
    far_m: Array,
    drops: tuple[Indices, Array, bool],
    distance_m: FloatArray,
) -> None:
    """Add to the depth (1 + C, H W) what points cover of the four pixels around each.

    `drops` says the drop of each point, factors (N, 1 + C) of each drop, and whether its points cover a pixel together.
    """
    drop, factors, together = drops
    height, width = distance_m.shape
    column, row = (np.floor(place).astype(np.int64) for place in places)
    right, below = places[0] - column, places[1] - row
    keys, parts = [], []
    for down in (0, 1):
        for across in (0, 1):
            here, line = column + across, row + down
            inside = (here >= 0) & (here < width) & (line >= 0) & (line < height)
            pixel = np.where(inside, line * width + here, 0)
            shows = inside & (far_m < distance_m.ravel()[pixel])
            weight = cover * (right if across else 1.0 - right) * (below if down else 1.0 - below)
            keys.append((drop * (height * width) + pixel)[shows])
            parts.append(weight[shows])
    key, share = np.concatenate(keys), np.concatenate(parts)
    if together:
        order = np.argsort(key, kind="stable")
        key, share = key[order], share[order]
        first = np.flatnonzero(np.diff(key, prepend=-1))
        share = np.add.reduceat(share, first) if len(first) else share
        key = key[first]
    stopped = -np.log1p(-np.minimum(share, 1.0 - 1e-6))
    drop, pixel = np.divmod(key, height * width)
    for plane, factor in zip(depth, factors.T, strict=True):
        plane += np.bincount(pixel, stopped * factor[drop], minlength=height * width)

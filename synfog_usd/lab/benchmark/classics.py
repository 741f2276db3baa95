"""Classic ways to see through fog, written from their papers.

Take and give pictures (H, W, 3) float, 0 to 1, coded as sRGB, as the papers do: none of them knows linear light.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import ndimage

from synfog_usd.base.arrays import Array


def none(picture: Array) -> Array:
    """The foggy picture itself: what a method must beat."""
    return picture


def dark_channel(picture: Array, **options: Any) -> Array:
    """Dark channel prior: in haze-free patches some channel of some pixel is nearly black.

    t = 1 - keep * min over the patch and channels of I / A; A is the brightest pixel among the 0.1 % with the
    brightest dark channel; t is refined by a guided filter; J = (I - A) / max(t, t_min) + A.

    Source: He, Sun and Tang, "Single image haze removal using dark channel prior", TPAMI 2011; the filter: He, Sun and
    Tang, "Guided image filtering", TPAMI 2013, with the picture's grey as guide.  Options: of `dark_channel_fog`.
    """
    airlight, t = dark_channel_fog(picture, **options)
    return _recovered(picture, airlight, t)


def dark_channel_fog(
    picture: Array,
    patch_px: int = 15,
    keep: float = 0.95,
    t_min: float = 0.1,
    radius_px: int = 60,
    smooth: float = 1e-3,
) -> tuple[Array, Array]:
    """(3,) A and (H, W) t, `t_min` to 1, that `dark_channel` sees in a picture."""
    airlight = _airlight(picture, _dark(picture, patch_px))
    rough = 1.0 - keep * _dark(picture / airlight, patch_px)
    return airlight, np.clip(guided(picture.mean(axis=2), rough, radius_px, smooth), t_min, 1.0)


def colour_attenuation(
    picture: Array, *, patch_px: int = 15, beta: float = 1.0, radius_px: int = 60, smooth: float = 1e-3
) -> Array:
    """Colour attenuation prior: depth grows with brightness and falls with saturation.

    d = 0.121779 + 0.959710 v - 0.780245 s, smallest over the patch, refined by a guided filter; t = exp(-beta d), held
    between 0.1 and 0.9; A is the brightest pixel among the 0.1 % with the largest depth.

    Source: Zhu, Mai and Shao, "A fast single image haze removal algorithm using color attenuation prior", TIP 2015.
    """
    value = picture.max(axis=2)
    saturation = 1.0 - picture.min(axis=2) / np.maximum(value, 1e-6)
    depth = ndimage.minimum_filter(0.121779 + 0.959710 * value - 0.780245 * saturation, patch_px, mode="nearest")
    t = np.exp(-beta * guided(value, depth, radius_px, smooth))
    return _recovered(picture, _airlight(picture, depth), np.clip(t, 0.1, 0.9))


def fast_visibility(picture: Array, *, keep: float = 0.95, window_px: int = 21) -> Array:
    """Fast visibility restoration: the veil is the smallest channel less its local spread, made for roads.

    The white-balanced W = min over channels; M = median of W; veil = clip(keep * (M - median of |W - M|), 0, W);
    J = (I - veil) / (1 - veil).

    Source: Tarel and Hautiere, "Fast visibility restoration from a single color or gray level image", ICCV 2009,
    without its tone mapping.
    """
    airlight = _airlight(picture, picture.min(axis=2))
    balanced = picture / airlight
    white = np.minimum(balanced.min(axis=2), 1.0)
    middle = _median(white, window_px)
    spread = _median(np.abs(white - middle), window_px)
    veil = np.clip(keep * (middle - spread), 0.0, white)[..., None]
    return np.clip((balanced - veil) / np.maximum(1.0 - veil, 1e-3) * airlight, 0.0, 1.0)


CLASSICS: dict[str, Callable[[Array], Array]] = {
    "none": none,
    "dcp": dark_channel,
    "cap": colour_attenuation,
    "fvr": fast_visibility,
}
"""Name -> method."""


def guided(guide: Array, picture: Array, radius_px: int, smooth: float) -> Array:
    """Guided filter of one channel by one channel: local lines a I + b through `picture`, averaged.

    Source: He, Sun and Tang 2013, algorithm 1.
    """
    radius_px = min(radius_px, (min(guide.shape) - 1) // 2)

    def mean(values: Array) -> Array:
        return ndimage.uniform_filter(values, 2 * radius_px + 1, mode="nearest")

    middle, level = mean(guide), mean(picture)
    slope = (mean(guide * picture) - middle * level) / (mean(guide * guide) - middle * middle + smooth)
    return mean(slope) * guide + mean(level - slope * middle)


def _median(values: Array, window_px: int) -> Array:
    """Median over a square of an odd side, edges repeated: `ndimage.median_filter`'s values.

    Medians know order alone, so they are taken of places among the values that occur.  A picture of 8 bits has few of
    those, and numpy partitions short integers with vector instructions.
    """
    levels, place = np.unique(values, return_inverse=True)
    short = np.uint16 if levels.size <= 2**16 else np.uint32
    padded = np.pad(place.reshape(values.shape).astype(short), window_px // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (window_px, window_px))
    half = window_px**2 // 2
    lines = [np.partition(line.reshape(-1, window_px**2), half, axis=1)[:, half] for line in windows]
    return np.asarray(levels[np.stack(lines)])


def _dark(picture: Array, patch_px: int) -> Array:
    return ndimage.minimum_filter(picture.min(axis=2), patch_px, mode="nearest")


def _airlight(picture: Array, haze: Array) -> Array:
    """(3,) the brightest pixel among the 0.1 % where `haze` is largest, at least a thousandth."""
    most = max(1, haze.size // 1000)
    places = np.argpartition(haze.ravel(), -most)[-most:]
    candidates = picture.reshape(-1, 3)[places]
    return np.maximum(candidates[candidates.sum(axis=1).argmax()], 1e-3)


def _recovered(picture: Array, airlight: Array, t: Array) -> Array:
    return np.clip((picture - airlight) / t[..., None] + airlight, 0.0, 1.0)

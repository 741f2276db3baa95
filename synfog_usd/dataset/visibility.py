"""What fog leaves of each thing: transmittance, contrast against its surroundings, and whether a sensor can tell it.

Takes one shot's radiance, the ids of its pixels and the sensor's noise; gives a row for each instance that is seen.
Of the pinhole picture that was rendered, before any lens.

The surroundings of an instance are the pixels beside it that are not of it.  A plane through their luminance says what
would be there without it: fog is brighter towards one side, and that is no contrast.  What is left, d, is the
instance's.  An instance behind fog of transmittance T replaces T times the light behind it by T times its own, so d is
at most the larger of the two; what exceeds that is of the surroundings' curvature, and is cut.

d is averaged within 3 x 3 cells of the instance's box, so that a car half dark and half bright counts, and the
render's own noise hardly does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from synfog_usd.base.arrays import Array, Flags, Indices, Pixels

WMO_CONTRAST = 0.05
"""Contrast that an observer needs to tell a thing.  Source: WMO-No. 8, volume I, section 9.1.1."""

ROSE = 5.0
"""Signal over noise, over the whole thing, from which on it is recognised reliably.  Source: Rose (1948), The
sensitivity performance of the human eye on an absolute scale, J. Opt. Soc. Am. 38, 196.
"""

FAINTEST = 1.0
"""The same, below which the noise is as large as the thing."""

CELLS = 3
"""Cells each way."""

RING = 0.15
"""Width of the surroundings, in terms of the square root of the instance's pixels; 2 px at least."""

Visibility = Literal["visible", "faint", "invisible"]


def thresholds() -> dict[str, Any]:
    """What `instances.json` says of how it judges."""
    return {
        "visible": f"contrast_rms >= {WMO_CONTRAST} (WMO-No. 8) and cnr >= {ROSE} (Rose 1948)",
        "faint": f"cnr >= {FAINTEST}, not visible",
        "invisible": f"cnr < {FAINTEST}",
    }


def rows(
    ids: Indices,
    transmittance: Pixels,
    luminance: Pixels,
    surface: Pixels | None = None,
    noise: Callable[[Array], Array] | None = None,
) -> dict[int, dict[str, Any]]:
    """What is left of each instance that has pixels, by label id.

    Args:
        ids: (H, W) label ids, 0 for none.
        transmittance: (H, W) of the fog before the surface [1].
        luminance: (H, W) [cd m-2].
        surface: (H, W) the part of it that comes from surfaces unscattered, or None.
        noise: luminance [cd m-2] -> standard deviation of what a pixel of this picture reads [cd m-2]; None where there
            is no sensor.

    Returns:
        `mean_transmittance` [1]; `contrast`, Weber's, the mean of d over the surroundings' luminance; `contrast_rms`,
        the root mean square of the cells' d over it; `cnr`, that of a matched filter over all its pixels,
        sqrt(sum of (d / sigma)^2), null without a sensor; `visibility`, by contrast alone without a sensor.  Contrasts
        are null where nothing surrounds the instance, or only darkness.
    """
    from scipy.ndimage import find_objects

    result = {}
    for number, window in enumerate(find_objects(ids), start=1):
        if window is None:
            continue
        mask = ids[window] == number
        row: dict[str, Any] = {"mean_transmittance": _digits(float(transmittance[window][mask].mean(dtype=np.float64)))}
        width = max(2, round(RING * float(np.sqrt(mask.sum()))))
        wide = tuple(slice(max(0, s.start - width), s.stop + width) for s in window)
        mask = ids[wide] == number
        behind = _behind(mask, luminance[wide], width)
        row |= _judged(
            mask, behind, luminance[wide], transmittance[wide], None if surface is None else surface[wide], noise
        )
        result[number] = row
    return result


def _behind(mask: Flags, luminance: Array, width: int) -> Array | None:
    """The plane through the luminance of the surroundings, at the instance's pixels; None where there are none."""
    from scipy.ndimage import distance_transform_edt

    around = ~mask & (distance_transform_edt(~mask) <= width)
    if not around.any():
        return None
    y, x = np.nonzero(around)
    light = luminance[around].astype(np.float64)
    middle = np.array([y.mean(), x.mean()])
    if len(light) < 12:
        return np.full(int(mask.sum()), light.mean())
    terms = np.c_[np.ones(len(light)), y - middle[0], x - middle[1]]
    plane = np.linalg.lstsq(terms, light, rcond=1e-6)[0]
    y, x = np.nonzero(mask)
    values = np.c_[np.ones(len(y)), y - middle[0], x - middle[1]] @ plane
    return np.asarray(np.clip(values, light.min(), light.max()))


def _judged(
    mask: Flags,
    behind: Array | None,
    luminance: Array,
    transmittance: Array,
    surface: Array | None,
    noise: Callable[[Array], Array] | None,
) -> dict[str, Any]:
    if behind is None or not behind.mean() > 0.0:
        return {"contrast": None, "contrast_rms": None, "cnr": None, "visibility": None}
    y, x = np.nonzero(mask)
    cell = (y - y.min()) * CELLS // (np.ptp(y) + 1) * CELLS + (x - x.min()) * CELLS // (np.ptp(x) + 1)
    count = np.bincount(cell, minlength=CELLS**2)

    def mean(values: Array) -> Array:
        return np.bincount(cell, values, minlength=CELLS**2) / np.maximum(count, 1)

    light = luminance[mask].astype(np.float64)
    level = mean(behind)
    unscattered = mean(light if surface is None else np.maximum(surface[mask].astype(np.float64), 0.0))
    most = np.maximum(unscattered, mean(transmittance[mask]) * level)
    signal = np.clip(mean(light) - level, -most, most)
    rms = float(np.sqrt((count * signal**2).sum() / count.sum()) / behind.mean())
    cnr = None
    if noise is not None:
        sigma = np.maximum(noise(level), 1e-9 * behind.mean())  # the least noise that a ratio is taken to
        cnr = float(np.sqrt((count * (signal / sigma) ** 2).sum()))
    return {
        "contrast": _digits(float((count * signal).sum() / count.sum() / behind.mean())),
        "contrast_rms": _digits(rms),
        "cnr": None if cnr is None else _digits(cnr),
        "visibility": judge(rms, cnr),
    }


def judge(contrast: float, cnr: float | None) -> Visibility:
    """Whether a thing of that contrast and that ratio of signal to noise can be distinguished from what surrounds it.

    >>> judge(0.3, 40.0), judge(0.02, 40.0), judge(0.3, 0.5), judge(0.02, None)
    ('visible', 'faint', 'invisible', 'invisible')
    """
    if cnr is None:
        return "visible" if abs(contrast) >= WMO_CONTRAST else "invisible"
    if cnr < FAINTEST:
        return "invisible"
    return "visible" if cnr >= ROSE and abs(contrast) >= WMO_CONTRAST else "faint"


def _digits(value: float) -> float:
    return float(f"{value:.4g}")

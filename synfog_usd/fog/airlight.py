"""The airlight A of the atmospheric scattering model L = J t + A (1 - t), guessed from a picture.

The guess is that of He, Sun and Tang (2009, section 4.4): the mean of the pixels whose dark channel is brightest.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array

PATCH_PX = 15
"""Side of the square over which the dark channel is the minimum; He, Sun and Tang's."""

BRIGHTEST = 1e-3
"""Share of the dark channel's brightest pixels; theirs."""


def estimated_airlight(clear: npt.ArrayLike, transmittance: npt.ArrayLike) -> Array:
    """Airlight guessed from a picture by its dark channel.

    Args:
        clear: (H, W, C) J.
        transmittance: (H, W, 1) t.

    Returns:
        (C,): the mean of I = J t + A0 (1 - t) over the 0.1 % of its pixels, one at least, whose dark channel is
        brightest.  The dark channel is the least of all channels in a square of 15 pixels.  A0 is the same mean of J
        itself, as of a clear photograph (Sakaridis, Dai and Van Gool 2018).
    """
    J, t = np.asarray(clear, dtype=np.float64), np.asarray(transmittance, dtype=np.float64)
    first = _brightest(J)
    return _brightest(J * t + first * (1.0 - t))


def _brightest(picture: Array) -> Array:
    dark = dark_channel(picture).ravel()
    count = max(1, round(BRIGHTEST * dark.size))
    pixels = picture.reshape(dark.size, -1)
    # among equals the brighter pixel, so that a flat sky is not read off at its border
    luminance = pixels.mean(axis=1)
    return pixels[np.lexsort((-luminance, -dark))[:count]].mean(axis=0)


def dark_channel(picture: Array) -> Array:
    """(H, W) least of all channels in the square around each pixel; at the border, of the part that is inside."""
    from scipy.ndimage import minimum_filter

    return np.asarray(minimum_filter(picture.min(axis=2), PATCH_PX, mode="constant", cval=np.inf))

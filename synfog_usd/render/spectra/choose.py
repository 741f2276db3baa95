"""How many wavelength bands: no more than a scene's colours need.

Takes a loaded scene and a target; gives a number of bands.  A small picture is rendered in a few numbers of bands and
compared with the finest.  What decides is counted, and the same seed gives the same choice on any machine.
"""

from __future__ import annotations

import numpy as np

from synfog_usd.arrays import Array
from synfog_usd.progress import Progress, silent
from synfog_usd.render import models
from synfog_usd.render.film.accumulator import Accumulator
from synfog_usd.render.load import MitsubaScene, resized
from synfog_usd.render.sampling.adaptive import Target
from synfog_usd.render.spectra import bands
from synfog_usd.seeds import seed32

WIDTH_PX = 64
"""Of the small picture."""

SAMPLES = 64
"""Its paths per pixel."""

FINEST = 16
"""Wavelength bands that are taken for right; 31 differ from them by less than 0.2 % in the bench stages."""

COLOUR_ERROR = 0.01
"""Error of colours that is good enough where no target is named: what an eye just sees side by side."""


def choose_bands(
    loaded: MitsubaScene, model: str, *, target: Target, seed: int, progress: Progress = silent
) -> tuple[int, str, dict[str, float]]:
    """The fewest wavelength bands whose colours are right to the target.

    Right is what FINEST bands give along the same paths.  An eye's R, G and B of both are
    compared, twice with seeds of their own; of the two differences the product is taken,
    in which noise cancels.

    Args:
        loaded: a scene without boundaries of fog.
        model: one that carries bands.

    Returns:
        number of bands, why, and the figures: RMS over the pixels of the colours' error over their luminance, by number
            of bands.
    """
    small = _small(loaded)
    if any(volume.medium.profile == "grid" for volume in small.source.fog):
        return bands.RGB, "a grid takes R, G and B", {}
    counts = (bands.RGB, *(count for count in bands.CENTRES_NM if count < FINEST))

    def picture(count: int, half: int) -> tuple[Array, Accumulator]:
        integrator = models.make(model, small, bands=count)
        accumulated = integrator.accumulate(samples=SAMPLES // 2, seed=seed32(seed, "bands", half))
        return bands.to_rgb(accumulated.mean(), count), accumulated

    progress("trying bands", 0.0)
    right = [picture(FINEST, half) for half in (0, 1)]
    level = np.mean([accumulated.luminance() for _, accumulated in right], axis=0)
    scale = np.maximum(level, 0.05 * level.mean() + 1e-30)[:, None]
    wanted = target.relative if target.relative is not None else _relative(target, right[0][1])
    wanted = COLOUR_ERROR if wanted is None else wanted
    figures: dict[str, float] = {}
    for index, count in enumerate(counts):
        progress("trying bands", (index + 1) / (len(counts) + 1))
        first, second = ((picture(count, half)[0] - right[half][0]) / scale for half in (0, 1))
        figures[str(count)] = error = float(np.sqrt(max(float((first * second).mean()), 0.0)))
        if error < wanted:
            return count, f"colours err by {error:.2%} against {FINEST} bands, under {wanted:.2%}", figures
    return FINEST, f"fewer err by {figures[str(counts[-1])]:.2%}, above {wanted:.2%}", figures


def _small(loaded: MitsubaScene) -> MitsubaScene:
    camera = loaded.source.camera
    return resized(loaded, (WIDTH_PX, max(1, round(WIDTH_PX * camera.height_px / camera.width_px))))


def _relative(target: Target, accumulated: Accumulator) -> float | None:
    if target.sigma is None:
        return None
    luminance = accumulated.luminance()
    level = np.maximum(luminance, 0.01 * luminance.mean() + 1e-30)
    return float(np.median(target.sigma(level) / level))

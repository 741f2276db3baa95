"""Two halves of a picture, denoised apart: what denoising left of its error, and the way from there to the truth.

A and B are means over two halves of the samples, which know nothing of each other; a and b what a denoiser made of
each one alone.  The picture is f = (a + b) / 2.  With x = (A + B) / 2, h = (A - B) / 2 and k = (a - b) / 2

    E[h^2] = Var(x),    E[k^2] = Var(f),    E[h k] = Cov(x, f),    so
    E[(x - f)^2] - E[h^2] + 2 E[h k] = E[(f - truth)^2],

since x has no bias: what is on the left is measured, and the denoiser may be any.  The same moments say how far to go
back to the samples: f + w (x - f) errs least with w = 1 - E[h (h - k)] / E[(x - f)^2].  Here
that is done for what is left under blurs from wide to none.  So light that the denoiser took for outliers comes back
where it belongs as nearly as noise allows.  With more samples every w goes to 1 and the picture to the truth.

Takes arrays; knows nothing of a denoiser, models or files.
Source: two buffers: Rousselle, Knaus and Zwicker 2012; mixing by estimated errors until it converges: Firmino et al.
2022, "Progressive denoising of Monte Carlo rendered images".  Theirs needs the denoiser's derivatives; this needs it
twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Indices, total
from synfog_usd.base.arrays import Pixels as Array

SCALES_PX = (64, 16, 4, 0)
"""Standard deviations [px] of the blurs, wide to none; then, of glints alone, `NEARBY_PX`, and the whole picture."""

NEARBY_PX = 8
"""Standard deviation [px] of the blur under which glints have the light of their samples in the end, as far as
`MOST_GIVEN` allows: images of lamps in paint and glass, each a pixel or two wide, which a denoiser takes for outliers.

For all other light it adds more mottle than it takes bias away.
"""

MOST_GIVEN = 1.25
"""Times that light may be more or less for it, since one bright sample of few makes a blot."""

WINDOW = 3.0
"""Moments are means under a blur this much wider than the one that is corrected, and of WINDOW_PX at least."""

WINDOW_PX = 8.0

MOMENT_PX = 4
"""Squares in which moments under WINDOW_PX are kept: smooth enough, and a quarter of the time."""

CAUTION = 3.0
"""Standard deviations of a moment by which noise is taken for larger than it was measured."""

DECISIVE = 0.05
"""Share of a window's sum from which on a single pixel is left out of it: where two rare bright samples meet in one
pixel, both halves agree, and only its neighbours know that it is noise.
"""

AGREED = 2.0
"""Times the smaller of both halves' differences that a pixel may go back at most."""

ERROR_BLUR_PX = 1.0
"""Standard deviation [px] of the blur of the scatter; a wider one takes noise for that of quiet neighbours."""

NEAR = 1.5
"""Times by which a pixel's level, blurred against noise, may differ from its own light.

Without this limit a lamp's light, and with it an error as large, counts for the dark pixels beside it.
"""

USUAL_RATIO = 3.0
"""Squared error over squared scatter that is expected where too few pixels tell."""

DOUBT = 2.0
"""Standard errors of a measured ratio at which it counts half."""

BLOCK_PX = 8

MOTTLE_WIDTHS, LEAST_MOTTLE_PX = 40, 4
"""Width of a picture over the standard deviation of the blur under which its error counts as mottle, and the least such
standard deviation [px]."""


@dataclass(frozen=True)
class Error:
    """What is left in a denoised picture.

    Attributes:
        rms: (H, W) expected RMS error of each pixel, in the picture's unit.
        scatter: (H, W) the part of it in which two pictures with seeds of their own differ: the standard deviation of
            each.
        mottle: the same of what is coarse, relative, over the whole picture; see `mottle`.
    """

    rms: Array
    scatter: Array
    mottle: float


def towards_truth(
    noisy: Array,
    denoised: Array,
    weights: npt.ArrayLike,
    *,
    nearby: bool = True,
) -> Array:
    """Give a denoised picture back what the samples know better.

    Args:
        noisy: (2, H, W, C) means of two independent halves of the samples.
        denoised: (2, H, W, C) each half denoised alone.
        weights: (C,) of the channels in luminance, by which all are judged together.
        nearby: whether glints are to be given back as well, see `NEARBY_PX`.

    Returns:
        (2, H, W, C) two halves whose mean is the picture; 0 at least.
    """
    weights = np.asarray(weights, dtype=np.float32)
    done = np.array(denoised, dtype=np.float32)
    floor = _floor(noisy)
    for scale in SCALES_PX:
        _correct(noisy, done, weights, floor, scale)
    return given_back(noisy, done, weights, nearby=nearby)


def given_back(
    noisy: Array,
    denoised: Array,
    weights: npt.ArrayLike,
    *,
    nearby: bool = True,
) -> Array:
    """Give denoised pictures the light back that their samples have on the whole, and nearby where that is asked for.

    Args:
        noisy, denoised: (N, H, W, C) pictures and what became of each; the second is written over.
        weights, nearby: as in `towards_truth`.

    Returns:
        (N, H, W, C), 0 at least.
    """
    weights = np.asarray(weights, dtype=np.float32)
    floor = float(_floor(noisy) @ weights)
    for light, done in zip(noisy, denoised, strict=True) if nearby else ():
        done *= _given(light @ weights, done @ weights, floor)
    before, after = _mean(noisy), _mean(denoised)
    denoised *= np.where(after > 0.0, np.clip(before / np.maximum(after, 1e-30), 0.5, 2.0), 1.0).astype(np.float32)
    return np.maximum(denoised, 0.0)


def _floor(noisy: Array) -> Array:
    """(C,) light below which nothing is left to scale."""
    return 1e-3 * np.maximum(np.abs(_mean(noisy)), 1e-30).astype(np.float32)


def _given(noisy: Array, done: Array, floor: float) -> Array:
    """(H, W, 1) by what each pixel's light (H, W) is multiplied to have that of the samples nearby."""
    step = NEARBY_PX // 2
    sampled, cleaned = (_blurred(binned(light[..., None], step), NEARBY_PX / step) + floor for light in (noisy, done))
    gain = np.clip(sampled / np.maximum(cleaned, 1e-30), 1.0 / MOST_GIVEN, MOST_GIVEN)
    return spread(gain, step, done.shape)


def _correct(noisy: Array, done: Array, weights: Array, floor: Array, scale: int) -> None:
    """Change `done` by what is left of the difference to `noisy` under one blur, as far as noise lets it be known."""
    step = max(1, scale // 2)
    wide, fine = (
        [_blurred(binned(picture, step), scale / step) for picture in noisy],
        [_blurred(binned(picture, step), scale / step) for picture in done],
    )
    level = np.maximum(0.5 * (fine[0] + fine[1]) @ weights, float(floor @ weights))
    change = 0.5 * ((wide[0] + wide[1]) - (fine[0] + fine[1])) @ weights / level
    noise = 0.5 * (wide[0] - wide[1]) @ weights / level
    scatter = 0.5 * (fine[0] - fine[1]) @ weights / level
    window = max(WINDOW * scale, WINDOW_PX)
    pixels = 4.0 * np.pi * window**2 / max(1.0, 4.0 * np.pi * scale**2)  # independent ones under the window
    caution = 1.0 + CAUTION / np.sqrt(pixels)
    square, unknown = change * change, noise * (noise - scatter)
    if scale > 0:
        share = _share(_blurred(unknown, window / step), _blurred(square, window / step), caution)
    else:
        some = _spread(_moment(square, window), done.shape[1:3])
        counted = square < DECISIVE * (2.0 * np.pi * window**2) * some
        noisy_part, whole = (
            _moment(np.where(counted, values, np.float32(0.0)), window) for values in (unknown, square)
        )
        share = _spread(_share(noisy_part, whole, caution), done.shape[1:3])
        share *= _agreed(change + noise - scatter, change - noise + scatter)
    for half in range(2):
        more = wide[half] - fine[half]
        more *= share[..., None]
        if scale > 0:
            more /= np.maximum(fine[half] + floor, 1e-30)
            more = spread(more, step, done.shape[1:3])
            more *= done[half] + floor
        done[half] += more
    np.maximum(done, 0.0, out=done)  # noise may be below 0, light is not


def _share(unknown: Array, square: Array, caution: float) -> Array:
    """How far to go back, by what of the squared difference is noise."""
    return np.clip(1.0 - np.float32(caution) * unknown / np.maximum(square, 1e-30), 0.0, 1.0)


def _moment(values: Array, window: float) -> Array:
    """(h, w) means of (H, W) under a blur of `window` px, on squares of MOMENT_PX."""
    return _blurred(binned(values[..., None], MOMENT_PX), window / MOMENT_PX)[..., 0]


def _spread(coarse: Array, shape: tuple[int, int]) -> Array:
    """(H, W) of a moment."""
    return spread(coarse[..., None], MOMENT_PX, shape)[..., 0]


def _agreed(first: Array, second: Array) -> Array:
    """Share of the mean of two differences that both have: 1 where they are alike, 0 where one alone has it, as a rare
    bright sample does.
    """
    mean = 0.5 * (first + second)
    both = np.where(first * second > 0.0, AGREED * np.minimum(np.abs(first), np.abs(second)), 0.0)
    return np.minimum(both / np.maximum(np.abs(mean), 1e-30), 1.0)


def error_of(noisy: Array, done: Array) -> Error:
    """What is left in a picture of two halves.

    The scatter of a pixel is known well from its neighbourhood, its bias is not: the ratio of the two
    is measured over the whole picture, in units of each pixel's light.

    Args:
        noisy, done: (2, H, W) luminance of the halves before and after.

    `tests/render/test_denoise.py` compares it with the true error of bench stages.
    """
    picture = done.mean(axis=0)
    mean = float(np.abs(picture).mean(dtype=np.float64))
    if mean == 0.0:
        return Error(np.zeros_like(picture), np.zeros_like(picture), 0.0)
    level = np.maximum(np.clip(_blurred(picture, 1.0), picture / NEAR, picture * NEAR), 0.05 * mean)
    change, noise, scatter = noisy.mean(axis=0) - picture, 0.5 * (noisy[0] - noisy[1]), 0.5 * (done[0] - done[1])
    square = (change * change - noise * noise + 2.0 * noise * scatter) / level**2
    scatter = (scatter / level) ** 2
    ratio = _ratio(square, scatter)
    scatter = level * np.sqrt(_blurred(scatter, ERROR_BLUR_PX))
    return Error(np.sqrt(ratio) * scatter, scatter, mottle(done))


def mottle(halves: Array, level: Array | None = None) -> float:
    """How much of a picture's error the eye takes for clouds: its relative standard deviation at low frequencies.

    The RMS over the picture of (a - b) / 2 over (a + b) / 2, both after a Gaussian blur of 1/MOTTLE_WIDTHS of the
    width; the brightest hundredth is capped, so that a lamp's own noise does not count for the street.  1 % is hardly
    seen, 2 % is seen in skies and fog.

    Args:
        halves: (2, H, W) luminance a and b of two independent halves of the samples, denoised or not.
        level: (H, W) luminance of the whole picture of which they are a part; theirs where None.
    """
    whole = halves.max(axis=0) if level is None else level
    cap = np.float32(np.percentile(whole, 99.0))
    a, b = (_coarse(np.minimum(half, cap)) for half in halves)
    level = 0.5 * (a + b) if level is None else _coarse(np.minimum(level, cap))
    return _relative(np.square(0.5 * (a - b)), level)


def mottle_of_noise(luminance: Array, variance: Array, wide: Array | float = 0.0) -> float:
    """What `mottle` of the samples is expected to be, by the variance of each pixel's mean.  Denoising leaves it: noise
    as wide as this looks like light.

    Two halves are compared once and scatter by a seventh to a third; this scatters by a twentieth.

    Args:
        luminance, variance: (H, W), before denoising; each pixel has noise of its own.
        wide: (H, W) noise that is as coarse as mottle, such as half of what two halves differ in.
    """
    cap = np.percentile(luminance, 99.0)
    noise, wide = (np.where(luminance > cap, 0.0, values).astype(np.float32) for values in (variance, wide))
    sigma = _mottle_px(luminance.shape[1])
    # The square of a Gaussian is one of 1 / sqrt(2) the width, over 4 pi sigma^2.
    squares = _coarse(noise, math.sqrt(0.5)) / np.float32(4.0 * np.pi * sigma**2) + np.square(_coarse(wide))
    return _relative(squares, _coarse(np.minimum(luminance, cap).astype(np.float32)))


def joined_mottle(halves: float, noise: float) -> float:
    """Mottle of a denoised picture by its halves and by `mottle_of_noise`, which counts twice since it is steadier."""
    return math.sqrt((halves**2 + 2.0 * noise**2) / 3.0)


def _relative(squares: Array, level: Array) -> float:
    """Root of the mean of squares over those of a level, both (h, w) and blurred."""
    floor = max(1e-3 * float(np.abs(level).mean(dtype=np.float64)), 1e-30)
    return float(np.sqrt(np.mean((np.sqrt(squares) / np.maximum(level, floor)) ** 2, dtype=np.float64)))


def _mottle_px(width: int) -> float:
    """Standard deviation [px] of the blur that leaves mottle alone."""
    return max(width / MOTTLE_WIDTHS, LEAST_MOTTLE_PX)


def _coarse(picture: Array, part: float = 1.0) -> Array:
    """(h, w) of (H, W) under the blur that leaves mottle alone, or one of a part of its width."""
    from scipy import ndimage

    sigma = _mottle_px(picture.shape[1])
    step = max(1, int(sigma / 4))
    fine = binned(picture[..., None], step)[..., 0]
    return np.asarray(ndimage.gaussian_filter(fine, part * sigma / step, truncate=3.0))


def _ratio(square: Array, scatter: Array) -> np.float32:
    """Squared error over squared scatter of a whole picture, 1 at least; the usual one where its own is not known
    better.
    """
    whole = float(scatter.mean(dtype=np.float64))
    if whole == 0.0:
        return np.float32(USUAL_RATIO)
    blocks = binned(square[..., None], BLOCK_PX).astype(np.float64).ravel() / whole
    ratio = max(float(square.mean(dtype=np.float64)) / whole, 0.0)
    spread = blocks.std() / np.sqrt(len(blocks)) if len(blocks) > 1 else np.inf
    trust = ratio**2 / (ratio**2 + (DOUBT * spread) ** 2) if ratio > 0.0 else 0.0
    return np.float32(max(USUAL_RATIO + trust * (ratio - USUAL_RATIO), 1.0))


def binned(image: Array, step: int) -> Array:
    """(h, w, C) means over squares of `step` pixels; the border is repeated."""
    if step == 1:
        return image
    height, width = (-(-length // step) * step for length in image.shape[:2])
    if (height, width) != image.shape[:2]:
        image = np.pad(image, ((0, height - image.shape[0]), (0, width - image.shape[1]), (0, 0)), mode="edge")
    rows = total(image[first::step] for first in range(step))  # twice as fast as a mean over axes
    return np.asarray(total(rows[:, first::step] for first in range(step)) * np.float32(step**-2.0), dtype=np.float32)


def spread(coarse: Array, step: int, shape: tuple[int, ...]) -> Array:
    """(H, W, C) of what was binned, linear between the squares' centres, and even beyond the last of them."""
    if step == 1:
        return coarse
    height, width, channels = *shape[:2], coarse.shape[2]
    before, after, share = _between(coarse.shape[1], step, width)
    low, high = ((at[:, None] * channels + np.arange(channels)).ravel() for at in (before, after))
    narrow = coarse.reshape(len(coarse), -1)  # all of a row together: numpy is slow over axes as short as the channels
    rows = narrow[:, low]
    rows += (narrow[:, high] - rows) * np.repeat(share, channels)
    before, after, share = _between(len(coarse), step, height)
    fine = np.empty((height, width * channels), dtype=coarse.dtype)
    for row, above, below, part in zip(fine, before, after, share, strict=True):
        np.subtract(rows[below], rows[above], out=row)
        row *= part
        row += rows[above]
    return fine.reshape(height, width, channels)


def _between(count: int, step: int, length: int) -> tuple[Indices, Indices, Array]:
    """For each of `length` pixels the squares before and after it, and how far it is between their centres, 0 to 1."""
    place = np.clip((np.arange(length) + 0.5) / step - 0.5, 0.0, count - 1.0)
    before = place.astype(np.intp)
    return before, np.minimum(before + 1, count - 1), (place - before).astype(np.float32)


def _mean(pictures: Array) -> npt.NDArray[np.float64]:
    """(C,) of (N, H, W, C)."""
    rows = pictures.reshape(-1, pictures.shape[2] * pictures.shape[3])  # see `spread`
    sums = rows.sum(axis=0, dtype=np.float64).reshape(pictures.shape[2:]).sum(axis=0)
    return np.asarray(sums * (pictures.shape[3] / pictures.size))


def _blurred(image: Array, sigma: float) -> Array:
    from scipy import ndimage

    return (
        image
        if sigma == 0.0
        else ndimage.gaussian_filter(image, (sigma, sigma, *(0.0,) * (image.ndim - 2)), mode="nearest", truncate=3.0)
    )

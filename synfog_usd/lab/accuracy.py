"""How far renders are from a reference: noise and bias apart, and what an eye sees of both.

Takes pictures from independent seeds and a reference made of independent parts;
gives relative errors with the reference's own variance taken off.  Knows nothing
of models, stages or files, and takes mottle as the renderer tells it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.render import dualbuffer

FLOOR = 0.01
"""Luminance that counts as dark, over the mean: a pixel's error is relative to hypot(its luminance, FLOOR x mean)."""
BLOCK_PX = 8
"""Side of the blocks whose scatter gives standard errors: what a denoiser or an interpolation ties together lies mostly
within one.
"""
MIDDLE_GREY = 0.18


@dataclass(frozen=True)
class Reference:
    """The converged picture.

    Attributes:
        luminance: (H, W) mean [cd m-2].
        variance: (H, W) variance of that mean.
        model, samples: how it was made.
        rgb: (H, W, 3) linear Rec.709 [cd m-2], where colours were kept.
        flip: mean FLIP between its two halves, which is more than its own distance from the truth; NaN where it was not
            made.
    """

    luminance: Array
    variance: Array
    model: str
    samples: int
    rgb: Array | None = None
    flip: float = math.nan

    @property
    def scale(self) -> Array:
        """(H, W) luminance that errors are relative to."""
        return np.hypot(self.luminance, FLOOR * self.luminance.mean())

    @property
    def rms(self) -> float:
        """Its own relative standard error, root mean square over the pixels."""
        return float(np.sqrt((self.variance / self.scale**2).mean()))


@dataclass(frozen=True)
class Errors:
    """How far a render is from the reference, relative and in luminance.

    Mean squares add up: `mse` = `noise_mse` + `bias_mse`.  Each is an unbiased
    estimate and can come out below zero where there is nothing to find.

    Attributes:
        mse: mean square of the difference over the pixels, without the reference's own variance.
        noise_mse: what differs from seed to seed.
        bias_mse: what stays when seeds are averaged, pixel by pixel.
        bias_mse_error: standard error of `bias_mse`.
        p95: 95th percentile over the pixels of the absolute difference; the reference's noise is in it.
        bias: difference of the means over the mean of the reference.
        bias_error: standard error of `bias`, with the reference's noise in it.
        mottle: what of the noise the eye takes for clouds, see `mottle`.
    """

    mse: float
    noise_mse: float
    bias_mse: float
    bias_mse_error: float
    p95: float
    bias: float
    bias_error: float
    mottle: float

    @property
    def rms(self) -> float:
        """Root of `mse`, 0 where it is all the reference's."""
        return math.sqrt(max(self.mse, 0.0))

    @property
    def noise_rms(self) -> float:
        """Root of `noise_mse`."""
        return math.sqrt(max(self.noise_mse, 0.0))

    @property
    def bias_rms(self) -> float:
        """Root of `bias_mse`, 0 where none was found."""
        return math.sqrt(max(self.bias_mse, 0.0))

    @property
    def bias_limit(self) -> float:
        """Bias of a pixel, RMS, that two standard errors leave room for."""
        return math.sqrt(max(self.bias_mse, 0.0) + 2.0 * self.bias_mse_error)


def luminance(rgb: Array) -> Array:
    """(..., 3) linear Rec.709 -> (...) in the same unit."""
    return np.asarray(rgb, dtype=np.float64) @ LUMINANCE


def combine(parts: Sequence[Array], samples: Sequence[int], model: str) -> Reference:
    """The mean of independent renders, and its variance by their scatter.

    Args:
        parts: K >= 2 pictures, (H, W) luminance or (H, W, 3) linear Rec.709.
        samples: paths per pixel of each; unequal ones are weighted by it.

    The weighted scatter is unbiased: with weights w that sum to 1 and a variance
    of s / n for each part, E[sum w (x - mean)^2] is (K - 1) times the mean's.
    """
    weights = np.asarray(samples, dtype=np.float64)[:, None, None] / sum(samples)
    pictures = np.stack(parts).astype(np.float64)
    colours, distance = None, math.nan
    if pictures.ndim == 4:
        colours = (weights[..., None] * pictures).sum(axis=0)
        halves = [np.average(pictures[start::2], axis=0, weights=samples[start::2]) for start in (0, 1)]
        distance = flip(halves[0], halves[1], exposure_of=colours)
        pictures = luminance(pictures)
    mean = (weights * pictures).sum(axis=0)
    variance = (weights * (pictures - mean) ** 2).sum(axis=0) / (len(parts) - 1)
    return Reference(mean, variance, model, sum(samples), colours, distance)


def compare(pictures: Sequence[Array], reference: Reference) -> Errors:
    """Errors of one render, estimated from K >= 2 with seeds of their own.

    Args:
        pictures: luminance (H, W) each.

    Let x_k = truth + bias + noise_k, and s^2 the scatter of the x_k about their mean m.  Then
    noise^2 = E[s^2] and bias^2 = E[(m - reference)^2 - s^2 / K - reference's variance],
    pixel by pixel; their sum is the mean of (x_k - reference)^2 less the reference's
    variance.  Its noise stays in what errors are relative to: with a relative error o of
    its own, `rms` is too large by a share of about 1.5 o^2 + 3 o^4 / rms^2.

    Standard errors are by blocks of BLOCK_PX: of `bias` by how much a block's mean
    differs from run to run, of `bias_mse` by how much it differs from block to block;
    a bias that differs between places makes the latter too large, never too small.
    """
    stack = np.stack(pictures).astype(np.float64)
    runs, level = len(stack), float(reference.luminance.mean())
    square = reference.scale**2
    mean, scatter = stack.mean(axis=0), stack.var(axis=0, ddof=1)
    lasting = ((mean - reference.luminance) ** 2 - scatter / runs - reference.variance) / square
    noise, bias = float((scatter / square).mean()), float(lasting.mean())
    pixels = lasting.size
    sums = np.stack([_block_sums(picture) for picture in stack])
    variance_of_mean = sums.var(axis=0, ddof=1).sum() / runs / pixels**2 + reference.variance.sum() / pixels**2
    return Errors(
        mse=noise + bias,
        noise_mse=noise,
        bias_mse=bias,
        bias_mse_error=_standard_error(lasting),
        p95=float(np.percentile(np.abs(stack - reference.luminance) / reference.scale, 95)),
        bias=float((mean - reference.luminance).mean() / level),
        bias_error=float(math.sqrt(variance_of_mean) / level),
        mottle=mottle(pictures),
    )


def mottle(pictures: Sequence[Array]) -> float:
    """Clouds in one render, estimated from K >= 2 with seeds of their own: RMS over the pairs, relative.

    Args:
        pictures: luminance (H, W) each.

    `dualbuffer.mottle` is that of the mean of two; that of one is sqrt 2 times as large.
    """
    pairs = [dualbuffer.mottle(np.stack(pair)) for pair in itertools.combinations(pictures, 2)]
    return math.sqrt(2.0 * float(np.mean(np.square(pairs))))


def flip(reference: Array, test: Array, *, exposure_of: Array | None = None) -> float:
    """Mean HDR-FLIP [0 to 1]: what an eye sees change when it flips between the two.

    OpenImageIO's `FLIP_diff` in its HDR mode with the ACES curve at 67 pixels a degree:
    the largest LDR-FLIP of several exposures, from the one that shows the median
    luminance to the one that shows the brightest.  Both pictures are scaled so that
    the reference's median luminance is middle grey.

    Args:
        reference, test: (H, W, 3) linear Rec.709.
        exposure_of: picture that sets the exposures; `reference` if left out.

    Returns:
        the mean over the pixels; NaN if this OpenImageIO has no FLIP (before 3.2).

    Source: Andersson et al., FLIP, HPG 2020; Visualizing Errors in Rendered High Dynamic Range Images, EG 2021.
    """
    import OpenImageIO

    if not hasattr(OpenImageIO.ImageBufAlgo, "FLIP_diff"):
        return math.nan
    bright = luminance(reference if exposure_of is None else exposure_of)
    median = float(np.median(np.hypot(bright, FLOOR * bright.mean())))
    if median <= 0.0:
        return 0.0 if np.array_equal(reference, test) else math.nan
    gain = MIDDLE_GREY / median
    true, tried = (
        OpenImageIO.ImageBuf(np.ascontiguousarray(picture * gain, dtype=np.float32)) for picture in (reference, test)
    )
    most = max(float(bright.max()) * gain, 2.0 * MIDDLE_GREY)
    result = OpenImageIO.ImageBufAlgo.FLIP_diff(true, tried, hdr=1, maxluminance=most, medianluminance=MIDDLE_GREY)
    return float(np.asarray(result.get_pixels(OpenImageIO.FLOAT), dtype=np.float64).mean())


def _block_sums(picture: Array) -> Array:
    rows, columns = (np.arange(0, size, BLOCK_PX) for size in picture.shape)
    return np.add.reduceat(np.add.reduceat(picture, rows, axis=0), columns, axis=1)


def _standard_error(picture: Array) -> float:
    """Of the mean over the pixels, by the scatter of blocks."""
    sums, counts = _block_sums(picture), _block_sums(np.ones_like(picture))
    if sums.size < 2:
        return float(picture.std(ddof=1) / math.sqrt(picture.size))
    spread = ((sums - picture.mean() * counts) ** 2).sum() * sums.size / (sums.size - 1)
    return float(math.sqrt(spread) / picture.size)

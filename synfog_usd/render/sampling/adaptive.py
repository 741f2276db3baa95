"""When to stop: samples where the error still is, until the target is met or they are used up.

Takes an integrator and a `Target`; gives an `Accumulator`.  What decides is counted in paths and their fixed costs,
never in seconds, so that the same seed gives the same bytes on any machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from synfog_usd.base.arrays import FloatArray, Pixels
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.render.dualbuffer import Error, mottle_of_noise
from synfog_usd.render.film.accumulator import (
    CHUNK,
    Accumulator,
    Integrator,
    Traces,
    new_accumulator,
)
from synfog_usd.render.film.allocation import accumulate_by_estimator, more_samples, rounds
from synfog_usd.render.film.launches import add_samples

DENOISER_GAIN = 20.0
"""Raw noise over the target from which on denoising is not even tried; of 2 samples it leaves a 17th."""

FIRST = 2
"""Samples of the first round of a picture that is to be denoised: one in each half."""

FALL = 0.4
"""A denoised picture's error falls as this power of its samples, about."""

LEAST_STRIDE = 1.25
"""Times the samples that it has which a picture gets in another round at least."""

LONGEST_STRIDE = 4.0
"""Times the samples that it has which a picture gets in another round at most: few samples tell their noise roughly."""

LAST = 0.9
"""Part of what is left to do that a round is taken for at most, unless it is the last allowed: another may follow."""

KEPT = 2.0
"""Times its samples that a frame of a clip must need until it gets more than the frame before: large areas change by
1 % where the numbers of samples do."""

SENSOR_SHARE = 1.0 / 3.0
"""Part of the sensor's own noise that may be left of a render: together they are 5 % noisier than the sensor alone."""


@dataclass(frozen=True)
class Target:
    """What is good enough.

    Attributes:
        relative: standard error of a pixel's luminance over it, or None.
        sigma: luminance (P,) [cd m-2] -> standard error [cd m-2] that is good enough, or None; the sensor's noise.
        mottle: what may be left of clouds in a denoised picture, see `dualbuffer.mottle`; or None.
        samples: most paths per pixel, on average over the image.
    """

    relative: float | None = None
    sigma: Callable[[Pixels], Pixels] | None = None
    samples: int = 64
    mottle: float | None = None

    @property
    def open(self) -> bool:
        """Whether the number of samples is the only thing that counts."""
        return self.relative is None and self.sigma is None and self.mottle is None

    def allowed(self, luminance: Pixels) -> Pixels:
        """Standard error [cd m-2] that is good enough for each pixel."""
        level = np.maximum(luminance, 0.01 * max(float(luminance.mean()), 1e-30))
        limits = np.full(level.shape, np.inf)
        if self.relative is not None:
            limits = np.minimum(limits, self.relative * level)
        if self.sigma is not None:
            limits = np.minimum(limits, self.sigma(level))
        return limits

    def allowed_in_all(self, luminance: Pixels) -> Pixels:
        """RMS error [cd m-2], bias and all, that is good enough for each pixel of a denoised picture: the relative one,
        or all of the sensor's noise.
        """
        return self.allowed(luminance) / (SENSOR_SHARE if self.sigma is not None else 1.0)

    def excess(self, luminance: Pixels, error: Error) -> float:
        """Error of a denoised picture's median pixel over what is allowed, 1 where it is just good enough: of its whole
        error, or, for a sensor, of what differs from seed to seed where that is more.
        """
        whole = float(np.median(error.rms / self.allowed_in_all(luminance)))
        return whole if self.sigma is None else max(whole, float(np.median(error.scatter / self.allowed(luminance))))

    def times_needed(self, luminance: Pixels, error: Error) -> float:
        """How many times its samples a denoised picture needs, about; 1 or less where it is good enough."""
        whole = 1.0 if self.relative is None and self.sigma is None else times_needed(self.excess(luminance, error))
        return whole if self.mottle is None else max(whole, (error.mottle / self.mottle) ** 2)


def sensor_target(noise: Callable[[Pixels], Pixels]) -> Callable[[Pixels], Pixels]:
    """Luminance -> the part of the sensor's noise that a render may add [cd m-2].

    Args:
        noise: luminance [cd m-2] -> standard deviation of what a pixel reads [cd m-2], such as `camera.noise_floor`.
    """
    return lambda luminance: SENSOR_SHARE * noise(luminance)


def accumulate_to_target(
    integrator: Integrator, *, target: Target, seed: int, progress: Progress = silent
) -> Accumulator:
    """Sample until the target is met or the samples are used up; more where the error still is.

    A pixel's variance is judged with its neighbours': by itself it would stop at the
    moments when it happens to look small, and those are the dark ones.

    Args:
        integrator: one that `Traces`; others are sampled evenly, to `target.samples`, whatever the target.
    """
    if not isinstance(integrator, Traces) or target.open:
        return integrator.accumulate(samples=target.samples, seed=seed, progress=progress)
    camera = integrator.loaded.source.camera
    pixels = camera.width_px * camera.height_px
    accumulated, everywhere = new_accumulator(integrator, pixels), np.arange(pixels)
    spent: float = min(2 * CHUNK, max(2, target.samples))
    first = more_samples(accumulated, int(spent))
    add_samples(accumulated, integrator, everywhere, first, seed, within(progress, 0.0, spent / target.samples))
    while spent < target.samples and spent >= 2 * CHUNK:
        need = _needed(
            accumulated.luminance(), accumulated.luminance_variance(), target, (camera.height_px, camera.width_px)
        )
        short = need > 1.0
        if not short.any():
            break
        rows = everywhere[short]
        have = accumulated.samples_of(rows)
        count = int(min(have, (target.samples - spent) * pixels / len(rows)))  # a round doubles what a pixel has
        if count < CHUNK:
            break
        more = more_samples(accumulated, int(have) + count, pixels=rows)
        after = spent + count * len(rows) / pixels
        add_samples(
            accumulated, integrator, rows, more, seed, within(progress, spent / target.samples, after / target.samples)
        )
        spent = after
    progress("rendering", 1.0)
    return accumulated


def accumulate_denoised(
    integrator: Integrator,
    *,
    target: Target,
    seed: int,
    denoised: Callable[[Accumulator], tuple[Pixels, Error] | None],
    kept: Sequence[Mapping[str, int]] = (),
    opacity: Callable[[], FloatArray] | None = None,
    progress: Progress = silent,
) -> Accumulator:
    """Sample all pixels alike, until the denoised picture meets the target or the samples are used up.

    Args:
        integrator: as `accumulate_to_target` takes it.
        denoised: what the samples so far give: luminance and its error, both (H, W); None where that fails.
        kept: `Accumulator.rounds` of the frame before, which are made again where there are the same estimators; more
            follow only where the picture needs `KEPT` times as many.
        opacity: gives that of the fog in each pixel, see `Estimator`, for paths in squares; None for paths in pixels.
    """
    if not isinstance(integrator, Traces):
        return integrator.accumulate(samples=target.samples, seed=seed, progress=progress)
    again = [dict(more) for more in kept if more.keys() == set(integrator.estimators)]
    if target.open and not again:
        return accumulate_by_estimator(integrator, samples=target.samples, seed=seed, denoised=True, progress=progress)
    camera = integrator.loaded.source.camera
    pixels = camera.width_px * camera.height_px
    accumulated = new_accumulator(integrator, pixels, denoised=True, opacity=opacity() if opacity else None)
    everywhere = np.arange(pixels)
    spent, share = 0.0, 0.0  # samples, and the part of the work that they are, as far as is known
    after, enough = float(min(FIRST, target.samples)), KEPT if again else 1.0
    least = LEAST_STRIDE if again else 1.0  # what the frame before had may be a little less than the limit
    reach = 1.0 if target.open else after / target.samples
    while True:
        for more in again:
            add_samples(accumulated, integrator, everywhere, more, seed, within(progress, share, reach))
        for number in () if again else rounds(int(after), denoised=True) if spent == 0 else (after,):
            more = more_samples(accumulated, number, denoised=True)
            add_samples(accumulated, integrator, everywhere, more, seed, within(progress, share, reach))
        spent, share, again = accumulated.samples_per_pixel if again else after, reach, []
        if target.open or spent * least >= target.samples:
            break
        needed = _times_before_denoising(accumulated, target)
        if needed <= enough and (picture := denoised(accumulated)) is not None:
            needed = target.times_needed(*picture)
            if needed <= enough:
                break
        stride = min(max(needed, LEAST_STRIDE), LONGEST_STRIDE)
        after = min(spent * stride, float(target.samples))
        part = LAST if after < target.samples else 1.0
        reach = share + (1.0 - share) * part
    progress("rendering", 1.0)
    return accumulated


def _times_before_denoising(accumulated: Accumulator, target: Target) -> float:
    """How many times its samples a picture needs until denoising it is worth a try, by the noise of its samples."""
    noise = np.median(np.sqrt(accumulated.luminance_variance()) / target.allowed(accumulated.luminance()))
    needed = float(noise / DENOISER_GAIN) ** 2
    if target.mottle is not None:
        coarse = mottle_of_noise(accumulated.luminance().reshape(accumulated.shape), *accumulated.noise())
        needed = max(needed, (coarse / target.mottle) ** 2)
    return needed


def times_needed(excess: float) -> float:
    """How many times its samples a denoised picture needs, about, 1 or more; see `Target.excess`."""
    return excess ** (1.0 / FALL) if excess > 1.0 else 1.0


def reached(luminance: Pixels, variance: Pixels, target: Target, shape: tuple[int, int]) -> float:
    """Share of the pixels (P,) whose standard error is under the target."""
    return float((_needed(luminance, variance, target, shape) <= 1.0).mean())


def _needed(luminance: Pixels, variance: Pixels, target: Target, shape: tuple[int, int]) -> Pixels:
    """How many times the samples it has each pixel needs."""
    from scipy import ndimage

    smooth, noise = (
        ndimage.uniform_filter(values.reshape(shape), 5, mode="nearest").ravel()
        for values in (luminance, np.minimum(variance, 1e30))
    )
    return np.asarray(noise / np.maximum(target.allowed(smooth), 1e-30) ** 2)

"""Samples spent and counted: the mean of each pixel and how well it is known.

Rays are made here, one contiguous run of lanes per pixel, and summed in that
order.  Mitsuba's own film adds samples with atomics, whose order changes from run
to run; this sum does not, so the same seed gives the same bytes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.progress import Progress, silent
from synfog_usd.render import backend
from synfog_usd.render.load import Loaded, make_sensor
from synfog_usd.seeds import seed32

LANES_PER_PASS = 1 << 21
"""Paths in flight at once; about 1 GiB in `volpath`, and a progress report every few seconds."""

SCALAR_PASSES = 8

Array = npt.NDArray[np.float64]


def expose(loaded: Loaded, integrator: Any, *, samples: int, seed: int, progress: Progress = silent) -> tuple[Array, Array, int]:
    """Average `samples` paths through every pixel, with a box filter one pixel wide.

    Args:
        loaded: scene and sensor.
        integrator: a Mitsuba `SamplingIntegrator`.
        samples: paths per pixel, >= 2 (one has no variance).
        seed: of this image; the same gives the same numbers in the same variant.
        progress: told after each pass.

    Returns:
        mean radiance (H, W, 3), variance of that mean (H, W, 3), and the number of
        samples that were not finite and count as zero.
    """
    if backend.is_scalar():
        return _expose_scalar(loaded, integrator, samples, seed, progress)
    mi = backend.mitsuba()
    import drjit as dr

    width, height = loaded.source.camera.width_px, loaded.source.camera.height_px
    pixels = width * height
    total, squares, broken, done = np.zeros((pixels, 3)), np.zeros((pixels, 3)), 0, 0
    while done < samples:
        count = min(samples - done, max(1, LANES_PER_PASS // pixels))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(dr.opaque(mi.UInt32, seed32(seed, "pass", done)), pixels * count)  # opaque: a literal would compile a kernel per seed
        index = dr.arange(mi.UInt32, pixels * count) // dr.opaque(mi.UInt32, count)
        corner = mi.Point2f(mi.Float(index % width), mi.Float(index // width))
        place = (corner + mi.Point2f(sampler.next_2d())) / mi.Point2f(width, height) + mi.Point2f(*loaded.offset)
        ray, weight = loaded.sensor.sample_ray_differential(0.0, 0.5, place, mi.Point2f(sampler.next_2d()))
        radiance, _, _ = integrator.sample(loaded.scene, sampler, ray, loaded.camera_medium, True)
        radiance = mi.Color3f(radiance * weight)
        finite = dr.all(dr.isfinite(radiance))
        radiance = dr.select(finite, radiance, 0.0)
        summed = [dr.block_sum(channel, count) for channel in radiance]
        squared = [dr.block_sum(channel * channel, count) for channel in radiance]
        lost = dr.count(~finite)
        dr.eval(summed, squared, lost)
        total += np.stack([np.asarray(channel, dtype=np.float64) for channel in summed], axis=1)
        squares += np.stack([np.asarray(channel, dtype=np.float64) for channel in squared], axis=1)
        broken += int(lost[0])
        done += count
        progress("rendering", done / samples)
    mean = total / samples
    variance = np.maximum(squares / samples - mean**2, 0.0) / (samples - 1)
    return mean.reshape(height, width, 3), variance.reshape(height, width, 3), broken


def _expose_scalar(loaded: Loaded, integrator: Any, samples: int, seed: int, progress: Progress) -> tuple[Array, Array, int]:
    """Whole renders with seeds of their own; their scatter gives the variance.

    A thin lens off its axis is drawn as a pinhole: here Mitsuba makes the rays.
    """
    sensor = loaded.sensor if loaded.offset == (0.0, 0.0) else make_sensor(loaded.source.camera, loaded.camera_medium, pinhole=True)
    passes = min(SCALAR_PASSES, samples)
    counts = [samples // passes + (index < samples % passes) for index in range(passes)]
    images, broken = [], 0
    for index, count in enumerate(counts):
        image = np.array(integrator.render(loaded.scene, sensor, seed32(seed, "pass", index), count), dtype=np.float64)[:, :, :3]
        broken += int(np.count_nonzero(~np.isfinite(image).all(axis=2)))
        images.append(np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0))
        progress("rendering", (index + 1) / passes)
    weights = np.array(counts, dtype=np.float64)[:, None, None, None] / samples
    stack = np.stack(images)
    mean = (weights * stack).sum(axis=0)
    variance = (weights * (stack - mean) ** 2).sum(axis=0) / (passes - 1)
    return mean, variance, broken

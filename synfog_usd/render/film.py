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
from synfog_usd.render.fogpath import FogPath
from synfog_usd.render.load import Loaded, make_sensor
from synfog_usd.seeds import seed32

LANES_PER_PASS = 1 << 21
"""Paths in flight at once; measured 0.2 GB above the scene in `volpath`."""

PATHS_PER_PASS = 1 << 22
"""Paths between two progress reports where lanes are used again; memory is by the pixel."""

SCALAR_PASSES = 8

Array = npt.NDArray[np.float64]


def expose(loaded: Loaded, integrator: Any, *, samples: int, seed: int, progress: Progress = silent) -> tuple[Array, Array, int]:
    """Average `samples` paths through every pixel, with a box filter one pixel wide.

    Args:
        loaded: scene and sensor.
        integrator: a Mitsuba `SamplingIntegrator`, or a `FogPath`.
        samples: paths per pixel, >= 2 (one has no variance).
        seed: of this image; the same gives the same numbers in the same variant.
        progress: told after each pass.

    Returns:
        mean radiance (H, W, 3), variance of that mean (H, W, 3), and the number of
        samples that were not finite and count as zero.
    """
    if backend.is_scalar():
        return _expose_scalar(loaded, integrator, samples, seed, progress)
    pixels = loaded.source.camera.width_px * loaded.source.camera.height_px
    total, squares, broken, done = np.zeros((pixels, 3)), np.zeros((pixels, 3)), 0, 0
    regenerates = isinstance(integrator, FogPath)
    step = max(1, (PATHS_PER_PASS if regenerates else LANES_PER_PASS) // pixels)
    while done < samples:
        count = min(samples - done, step)
        summed, squared, lost = (_regenerated if regenerates else _side_by_side)(loaded, integrator, count, seed32(seed, "pass", done))
        total, squares, broken, done = total + summed, squares + squared, broken + lost, done + count
        progress("rendering", done / samples)
    mean = total / samples
    variance = np.maximum(squares / samples - mean**2, 0.0) / (samples - 1)
    shape = (loaded.source.camera.height_px, loaded.source.camera.width_px, 3)
    return mean.reshape(shape), variance.reshape(shape), broken


def _sampler(lanes: int, seed: int) -> Any:
    mi = backend.mitsuba()
    import drjit as dr

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), lanes)  # opaque: a literal would compile a kernel per seed
    return sampler


def _corners(loaded: Loaded, index: Any) -> Any:
    mi = backend.mitsuba()
    width = loaded.source.camera.width_px
    return mi.Point2f(mi.Float(index % width), mi.Float(index // width))


def _regenerated(loaded: Loaded, integrator: FogPath, count: int, seed: int) -> tuple[Array, Array, int]:
    """One lane a pixel, which traces its paths one after the other."""
    mi = backend.mitsuba()
    import drjit as dr

    pixels = loaded.source.camera.width_px * loaded.source.camera.height_px
    total, squares, lost = integrator.accumulate(loaded, _sampler(pixels, seed), _corners(loaded, dr.arange(mi.UInt32, pixels)), count)
    dr.eval(total, squares, lost)
    return np.array(total, dtype=np.float64).T, np.array(squares, dtype=np.float64).T, int(np.array(lost).sum())


def _side_by_side(loaded: Loaded, integrator: Any, count: int, seed: int) -> tuple[Array, Array, int]:
    """One lane a path, a contiguous run of them a pixel."""
    mi = backend.mitsuba()
    import drjit as dr

    camera = loaded.source.camera
    lanes = camera.width_px * camera.height_px * count
    sampler = _sampler(lanes, seed)
    corner = _corners(loaded, dr.arange(mi.UInt32, lanes) // dr.opaque(mi.UInt32, count))
    place = (corner + mi.Point2f(sampler.next_2d())) / mi.Point2f(camera.width_px, camera.height_px) + mi.Point2f(*loaded.offset)
    ray, weight = loaded.sensor.sample_ray_differential(0.0, 0.5, place, mi.Point2f(sampler.next_2d()))
    radiance, _, _ = integrator.sample(loaded.scene, sampler, ray, loaded.camera_medium, True)
    radiance = mi.Color3f(radiance * weight)
    finite = dr.all(dr.isfinite(radiance))
    radiance = dr.select(finite, radiance, 0.0)
    summed = [dr.block_sum(channel, count) for channel in radiance]
    squared = [dr.block_sum(channel * channel, count) for channel in radiance]
    lost = dr.count(~finite)
    dr.eval(summed, squared, lost)
    return np.array(summed, dtype=np.float64).T, np.array(squared, dtype=np.float64).T, int(lost[0])


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

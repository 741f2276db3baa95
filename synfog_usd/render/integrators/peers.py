"""Mitsuba's own volumetric path tracers: the peers that ours are measured against, and what holds where ours do not.

Rays are made here and summed in a fixed order: Mitsuba's film adds with atomics, in an order that changes from run to
run.
Source: Mitsuba 3, src/integrators/volpath.cpp and volpathmis.cpp.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.seeds import seed32
from synfog_usd.render import backend
from synfog_usd.render.film.accumulator import Accumulator, undivided
from synfog_usd.render.film.raster import Raster
from synfog_usd.render.integrators.path import RR_DEPTH
from synfog_usd.render.load import MitsubaScene, make_sensor
from synfog_usd.render.motion import moved

if TYPE_CHECKING:
    from mitsuba import SamplingIntegrator

LANES_PER_PASS = 1 << 21
"""Paths in flight together; measured 0.2 GB above the scene in `volpath`."""

SCALAR_PASSES = 8


class Peer:
    """One of Mitsuba's `SamplingIntegrator`s for a loaded scene.

    Args:
        loaded: the scene, with the fog as null-material shapes.
        integrator: Mitsuba's.
    """

    def __init__(self, loaded: MitsubaScene, integrator: SamplingIntegrator) -> None:
        self.loaded, self.integrator = loaded, integrator

    def accumulate(self, *, samples: int, seed: int, progress: Progress = silent) -> Accumulator:
        """An image, see `Integrator`; every pixel has as many samples."""
        if backend.is_scalar():
            return _accumulate_scalar(self.loaded, self.integrator, samples, seed, progress)
        pixels = self.loaded.source.camera.width_px * self.loaded.source.camera.height_px
        total, squares, lost, done = np.zeros((pixels, 3)), np.zeros((pixels, 3)), 0, 0
        while done < samples:
            count = min(samples - done, max(1, LANES_PER_PASS // pixels))
            summed, squared, broken = _side_by_side(self.loaded, self.integrator, count, seed32(seed, "pass", done))
            total, squares, lost, done = total + summed, squares + squared, lost + broken, done + count
            progress("rendering", done / samples)
        return undivided(total, squares, samples, lost)


def make_peer(loaded: MitsubaScene, *, plugin: str) -> Peer:
    """Mitsuba's integrator of a name.

    Paths are not cut at any depth: with an albedo of 1 a fixed depth darkens dense
    fog.  Russian roulette ends them, after RR_DEPTH events and never with a
    probability above 5 % while nothing was absorbed.
    """
    return Peer(loaded, backend.mitsuba().load_dict({"type": plugin, "max_depth": -1, "rr_depth": RR_DEPTH}))


def _side_by_side(
    loaded: MitsubaScene, integrator: SamplingIntegrator, count: int, seed: int
) -> tuple[Array, Array, int]:
    """One lane a path, a contiguous run of them a pixel."""
    mi = backend.mitsuba()
    camera = loaded.source.camera
    lanes = camera.width_px * camera.height_px * count
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), lanes)  # opaque: a literal would compile a kernel per seed
    index = dr.arange(mi.UInt32, lanes) // dr.opaque(mi.UInt32, count)
    raster = Raster(camera)
    place = (raster.corner(index) + mi.Point2f(sampler.next_2d())) / raster.size
    ray, weight = loaded.sensor.sample_ray_differential(
        0.0, 0.5, place + mi.Point2f(*loaded.offset), mi.Point2f(sampler.next_2d())
    )
    if camera.moves:
        ray = moved(ray, camera, place.y, sampler.next_1d())
    radiance, _, _ = integrator.sample(loaded.scene, sampler, ray, loaded.camera_medium, mi.Bool(True))
    radiance = mi.Color3f(radiance * weight)
    finite = dr.all(dr.isfinite(radiance))
    radiance = dr.select(finite, radiance, 0.0)
    summed = [dr.block_sum(channel, count) for channel in radiance]
    squared = [dr.block_sum(channel * channel, count) for channel in radiance]
    lost = dr.count(~finite)
    dr.eval(summed, squared, lost)
    return np.array(summed, dtype=np.float64).T, np.array(squared, dtype=np.float64).T, int(np.array(lost)[0])


def _accumulate_scalar(
    loaded: MitsubaScene, integrator: SamplingIntegrator, samples: int, seed: int, progress: Progress
) -> Accumulator:
    """Whole renders with seeds of their own; their scatter gives the variance.

    A thin lens off its axis is drawn as a pinhole: here Mitsuba makes the rays.

    Raises:
        ParameterError: a fisheye, of whose rays Mitsuba knows nothing.
    """
    if loaded.source.camera.fisheye is not None:
        raise ParameterError(
            f"{loaded.source.camera.path}: Mitsuba's own models draw no fisheye with its scalar backend; "
            f"use --model path"
        )
    sensor: Any = (
        loaded.sensor
        if loaded.offset == (0.0, 0.0)
        else make_sensor(loaded.source.camera, loaded.camera_medium, pinhole=True)
    )
    passes = min(SCALAR_PASSES, samples)
    counts = [samples // passes + (index < samples % passes) for index in range(passes)]
    images, broken = [], 0
    for index, count in enumerate(counts):
        pass_seed = backend.mitsuba().UInt32(seed32(seed, "pass", index))
        image = np.array(integrator.render(loaded.scene, sensor, pass_seed, count), dtype=np.float64)[:, :, :3]
        broken += int(np.count_nonzero(~np.isfinite(image).all(axis=2)))
        images.append(np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0).reshape(-1, 3))
        progress("rendering", (index + 1) / passes)
    weights = np.array(counts, dtype=np.float64)[:, None, None] / samples
    stack = np.stack(images)
    mean = (weights * stack).sum(axis=0)
    variance = (weights * (stack - mean) ** 2).sum(axis=0) / (passes - 1)
    return undivided(mean * samples, (variance * (samples - 1) + mean**2) * samples, samples, broken)

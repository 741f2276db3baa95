"""The eye: rays through points and pixels of a view, and what a split first segment carries, in traced code."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from synfog_usd.render import backend
from synfog_usd.render.film.raster import Raster
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.motion import moved

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float
    from mitsuba import Color3f, Point2f, Ray3f

    from synfog_usd.render.sampling.sobol import Sobol
    from synfog_usd.render.spectra.bands import SampledSpectrum

LENS_M = 1e-3
"""Near plane [m] up to which a ray is begun at the lens itself."""


class Eye:
    """A loaded scene's camera.

    Attributes:
        loaded: the scene.
        raster: its picture's pixels.
    """

    def __init__(self, loaded: MitsubaScene) -> None:
        mi, camera = backend.mitsuba(), loaded.source.camera
        self.loaded, self.raster = loaded, Raster(camera)
        self._near = dr.opaque(mi.Float, camera.near_m)
        self._ahead = mi.Vector3f(*(-camera.to_world[:3, 2]).tolist())
        dr.make_opaque(self._ahead)

    def ray(self, sampler: Sobol, corner: Point2f, active: Bool) -> tuple[Ray3f, Color3f]:
        """A ray through a random point of the pixel, and its weight."""
        place = (corner + backend.mitsuba().Point2f(sampler.next_2d(active))) / self.raster.size
        return self.ray_through(place, sampler, active)

    def ray_through(self, place: Point2f, sampler: Sobol, active: Bool) -> tuple[Ray3f, Color3f]:
        """A ray through a point (u, v) of the picture, 0 to 1 from the top left, and its weight."""
        mi = backend.mitsuba()
        camera = self.loaded.source.camera
        ray, weight = self.loaded.sensor.sample_ray(
            0.0, 0.5, place + mi.Point2f(*self.loaded.offset), mi.Point2f(sampler.next_2d(active)), active
        )
        if (
            camera.near_m <= LENS_M
        ):  # nothing stands before the near plane: begin at the lens, so that no fog is left out
            ray.o = ray.o - ray.d * (self._near if camera.fisheye else self._near / dr.dot(ray.d, self._ahead))
        if camera.moves:
            ray = moved(ray, camera, place.y, sampler.next_1d(active))
        return ray, weight


def split_camera_segment(
    share: Float, throughput: SampledSpectrum, scale: Float, sampler: Sobol, at_eye: Bool
) -> tuple[SampledSpectrum, Float]:
    """Throughput of the side of the camera's segment that is followed, whose `share` is T or 1 - T. A faint
    one faces Russian roulette, and its weight is the new scale.
    """
    chance = dr.minimum(4.0 * share, 1.0)
    share = dr.select(sampler.next_1d(at_eye) < chance, share / dr.maximum(chance, 1e-30), 0.0)
    return dr.select(at_eye, throughput * share, throughput), dr.select(at_eye, dr.maximum(share, 1e-30), scale)

"""A path tracer that knows its fog: one uniform volume, without boundaries to trace.

Mitsuba's `volpath` finds the fog's edge by tracing a null-material box, on every
path and every shadow ray.  The edge of a box or a ball is known in closed form, so
here a path costs one ray a segment and one a shadow test, and a segment that ends
in the fog is traced no further than its end.

The estimator is the usual one (Kajiya and Von Herzen 1984; Pauly et al. 2000): free
flight sampled in proportion to transmittance, Henyey-Greenstein and BSDF sampling
combined with emitter sampling by the power heuristic (Veach and Guibas 1995),
Russian roulette.  It is unbiased.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import drjit as dr

from synfog_usd.fog import FogVolume
from synfog_usd.render import backend
from synfog_usd.render.lamps import Lamps
from synfog_usd.render.load import Loaded

RR_DEPTH = 8
"""Events before Russian roulette, as in `volpath`."""

FAINT = 0.5
"""Throughput below which a path is played for at once."""


class FogPath:
    """One scene's integrator.

    Args:
        fog: the volume, or None in clear air.  Its boundary is a box or a sphere.
        lamps: the lights that are sampled by where they matter; their weight in the
            scene's own choice must be 0.
        others: how many other lights there are but the environment.  Where there are
            none, a scattering in the fog sends them no shadow ray: the phase function's
            own sample finds a sky better.
        sky: whether there is an environment.
    """

    def __init__(self, fog: FogVolume | None, *, lamps: Lamps, others: int, sky: bool) -> None:
        mi = backend.mitsuba()
        self.lamps, self.lit_fog, self.chosen = lamps, others > 0, others > 0 or sky
        self.foggy = fog is not None and fog.medium.sigma_t_per_m > 0.0
        if fog is not None and self.foggy:
            self.sigma_t = dr.opaque(mi.Float, fog.medium.sigma_t_per_m)
            self.albedo = dr.opaque(mi.Float, fog.medium.albedo)
            self.g = dr.opaque(mi.Float, fog.medium.g)
            self.to_local = mi.Transform4f(mi.ScalarTransform4f(fog.boundary.to_world).inverse())
            self.ball = fog.boundary.kind == "sphere"

    def interval(self, origin: Any, direction: Any) -> tuple[Any, Any]:
        """Where a ray enters and leaves the fog, as distances; equal where it misses."""
        mi = backend.mitsuba()
        o, d = self.to_local @ mi.Point3f(origin), self.to_local @ mi.Vector3f(direction)
        if self.ball:
            a, b, c = dr.dot(d, d), dr.dot(o, d), dr.dot(o, o) - 1.0
            square = b * b - a * c
            root = dr.sqrt(dr.maximum(square, 0.0))
            near, far = (-b - root) / a, (-b + root) / a
        else:
            safe = mi.Vector3f([dr.select(dr.abs(x) < 1e-12, dr.copysign(mi.Float(1e-12), x), x) for x in d])
            one, other = (-1.0 - mi.Vector3f(o)) / safe, (1.0 - mi.Vector3f(o)) / safe
            near, far = dr.max(dr.minimum(one, other)), dr.min(dr.maximum(one, other))
        near = dr.maximum(near, 0.0)
        return near, dr.maximum(far, near)

    @dr.syntax
    def accumulate(self, loaded: Loaded, sampler: Any, corner: Any, count: int) -> tuple[Any, Any, Any]:
        """Trace `count` paths through each pixel, one lane a pixel.

        A lane whose path has ended begins its next one at once: vector units work on
        16 lanes in step, and would otherwise wait for the longest path of the 16.

        Args:
            loaded: a scene without fog boundaries.
            sampler: seeded for as many lanes as there are pixels.
            corner: (u, v) of each pixel's top left corner in pixels.
            count: paths a pixel.

        Returns:
            sum and sum of squares of radiance over the paths (Color3f each), and how
            many of them were not finite and count as zero.
        """
        mi = backend.mitsuba()
        scene, context = loaded.scene, mi.BSDFContext()
        shoot = partial(self.camera_ray, loaded)
        total, squares, lost = mi.Color3f(0.0), mi.Color3f(0.0), mi.UInt32(0)
        begun, wanted = mi.UInt32(1), dr.opaque(mi.UInt32, count)
        active = mi.Bool(True)
        ray, camera_weight = shoot(sampler, corner, active)
        radiance, throughput = mi.Color3f(0.0), mi.Color3f(camera_weight)
        depth = mi.UInt32(0)
        last_p, last_pdf, last_exact, last_alone = mi.Point3f(ray.o), mi.Float(1.0), mi.Bool(True), mi.Bool(False)
        while active:
            # Free flight: where the fog would turn the path, if nothing stands before.
            flight = mi.Float(dr.inf)
            if dr.hint(self.foggy, mode="scalar"):
                near, far = self.interval(ray.o, ray.d)
                reach = near - dr.log(1.0 - sampler.next_1d(active)) / self.sigma_t
                flight = dr.select(reach < far, reach, dr.inf)
            segment = mi.Ray3f(ray)
            segment.maxt = dr.minimum(flight, segment.maxt)
            si = scene.ray_intersect(segment, mi.RayFlags.All, True, active)
            met = active & si.is_valid()
            turned = active & ~met & dr.isfinite(flight)
            ended = active & ~turned

            # What the end of the segment sends out itself, weighed against the shadow ray of the vertex before.
            before = dr.zeros(mi.Interaction3f)
            before.p = last_p
            towards = mi.DirectionSample3f(scene, si, before)
            light_pdf = mi.Float(0.0)
            if dr.hint(self.chosen, mode="scalar"):
                light_pdf = scene.pdf_emitter_direction(before, towards, ended & ~last_exact)
            weight = dr.select(last_alone & (light_pdf > 0.0), 1.0, dr.select(light_pdf > 0.0, _share(last_pdf, light_pdf), 0.0))
            weight = dr.select(last_exact, 1.0, weight)  # a lamp's face counts here only for the eye and for mirrors
            radiance += dr.select(ended, throughput * weight * si.emitter(scene, ended).eval(si, ended), 0.0)

            # Lamps, scattered once on the way.
            if dr.hint(self.foggy and self.lamps.count > 0, mode="scalar"):
                until = dr.minimum(far, dr.select(met, si.t, flight))
                stretch = active & (until > near)
                place, lamp, colour = self.lamps.along(ray.o, ray.d, near, until, self.phase, self.sigma_t, sampler, stretch)
                free, reach_lamp = self.clear_to(scene, place, mi.Normal3f(0.0), lamp, stretch & (dr.max(colour) > 0.0))
                radiance += dr.select(free, throughput * colour * (self.sigma_t * self.albedo * reach_lamp), 0.0)

            # The vertex: in the fog or on a surface.
            vertex = dr.zeros(mi.Interaction3f)
            vertex.p = dr.select(turned, ray(flight), si.p)
            vertex.n = dr.select(turned, mi.Normal3f(0.0), si.n)
            vertex.t = dr.select(turned, flight, si.t)
            if dr.hint(self.foggy, mode="scalar"):
                throughput = dr.select(turned, throughput * self.albedo, throughput)
            bsdf = si.bsdf()
            alive = met | turned

            # Shadow rays: to the sky and whatever is left to chance, and to a lamp.
            smooth = met & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            lit = mi.Bool(smooth)
            if dr.hint(self.lit_fog, mode="scalar"):
                lit |= turned
            light, power = dr.zeros(mi.DirectionSample3f), mi.Color3f(0.0)
            if dr.hint(self.chosen, mode="scalar"):
                light, power = scene.sample_emitter_direction(vertex, sampler.next_2d(lit), False, lit)
            lit &= light.pdf > 0.0
            value, pdf, bounce, gain = bsdf.eval_pdf_sample(context, si, si.to_local(light.d), sampler.next_1d(met), sampler.next_2d(met), met)
            if dr.hint(self.foggy, mode="scalar"):
                scattered = self.phase(dr.dot(ray.d, light.d))
                value = dr.select(turned, mi.Color3f(scattered), value)
                pdf = dr.select(turned, scattered, pdf)
            if dr.hint(self.chosen, mode="scalar"):
                free, reach_light = self.clear_to(scene, vertex.p, vertex.n, light.p, lit)
                weight = dr.select(light.delta, 1.0, _share(light.pdf, pdf))
                radiance += dr.select(free, throughput * value * power * (weight * reach_light), 0.0)
            if dr.hint(self.lamps.count > 0, mode="scalar"):
                lamp, colour = self.lamps.at(si.p, si.n, sampler, smooth)
                free, reach_lamp = self.clear_to(scene, si.p, si.n, lamp, smooth & (dr.max(colour) > 0.0))
                reflected = bsdf.eval(context, si, si.to_local(dr.normalize(lamp - si.p)), free)
                radiance += dr.select(free, throughput * reflected * colour * reach_lamp, 0.0)

            # Onward.
            direction, last_pdf = si.to_world(bounce.wo), bounce.pdf
            last_exact = met & mi.has_flag(bounce.sampled_type, mi.BSDFFlags.Delta)
            throughput = dr.select(met, throughput * gain, throughput)
            if dr.hint(self.foggy, mode="scalar"):
                turn, turn_pdf = self.sample_phase(ray.d, sampler.next_2d(turned))
                direction, last_pdf = dr.select(turned, turn, direction), dr.select(turned, turn_pdf, last_pdf)
                last_alone = turned & mi.Bool(not self.lit_fog)
            last_p = vertex.p
            ray = vertex.spawn_ray(direction)
            depth += 1
            largest = dr.max(throughput)
            survive = dr.select(depth > RR_DEPTH, 0.95, 1.0) * dr.minimum(largest / FAINT, 1.0)
            alive &= (largest > 0.0) & (sampler.next_1d(alive) < survive)
            throughput /= dr.maximum(survive, 1e-8)

            # The next path of this pixel where this one has ended.
            over = active & ~alive
            finite = dr.all(dr.isfinite(radiance))
            kept = dr.select(over & finite, radiance, 0.0)
            total, squares = total + kept, squares + kept * kept
            lost += dr.select(over & ~finite, mi.UInt32(1), mi.UInt32(0))
            again = over & (begun < wanted)
            fresh, fresh_weight = shoot(sampler, corner, again)
            begun += dr.select(again, mi.UInt32(1), mi.UInt32(0))
            ray = dr.select(again, fresh, ray)
            throughput = dr.select(again, mi.Color3f(fresh_weight), throughput)
            radiance = dr.select(over, 0.0, radiance)
            depth = dr.select(again, mi.UInt32(0), depth)
            last_exact |= again
            active = alive | again
        return total, squares, lost

    def clear_to(self, scene: Any, place: Any, normal: Any, light: Any, active: Any) -> tuple[Any, Any]:
        """(whether nothing stands between a point and a light, transmittance of the fog between)."""
        mi = backend.mitsuba()
        start = dr.zeros(mi.Interaction3f)
        start.p, start.n = place, normal
        shadow = start.spawn_ray_to(light)
        free = active & ~scene.ray_test(shadow, active)
        through = mi.Float(1.0)
        if self.foggy:
            towards = light - place
            length = dr.norm(towards)
            begin, end = self.interval(place, towards / dr.maximum(length, 1e-12))
            through = dr.exp(-self.sigma_t * dr.maximum(dr.minimum(end, length) - begin, 0.0))
        return free, through

    def camera_ray(self, loaded: Loaded, sampler: Any, corner: Any, active: Any) -> tuple[Any, Any]:
        """A ray through a random point of the pixel, and its weight."""
        mi = backend.mitsuba()
        camera = loaded.source.camera
        place = (corner + mi.Point2f(sampler.next_2d(active))) / mi.Point2f(camera.width_px, camera.height_px) + mi.Point2f(*loaded.offset)
        return loaded.sensor.sample_ray(0.0, 0.5, place, mi.Point2f(sampler.next_2d(active)), active)

    def phase(self, cosine: Any) -> Any:
        """Henyey-Greenstein [1/sr] at the cosine between the directions of travel."""
        base = 1.0 + self.g * self.g - 2.0 * self.g * cosine
        return (1.0 - self.g * self.g) / (4.0 * dr.pi * base * dr.sqrt(base))

    def sample_phase(self, forward: Any, u: Any) -> tuple[Any, Any]:
        """A direction of travel after scattering, and its density [1/sr]."""
        mi = backend.mitsuba()
        ratio = (1.0 - self.g * self.g) / (1.0 - self.g + 2.0 * self.g * u.x)
        cosine = dr.select(dr.abs(self.g) < 1e-3, 1.0 - 2.0 * u.x, (1.0 + self.g * self.g - ratio * ratio) / (2.0 * self.g))
        cosine = dr.clip(cosine, -1.0, 1.0)
        sine = dr.safe_sqrt(1.0 - cosine * cosine)
        sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * u.y)
        direction = mi.Frame3f(forward).to_world(mi.Vector3f(sine * cos_phi, sine * sin_phi, cosine))
        return direction, self.phase(cosine)


def _share(pdf: Any, other: Any) -> Any:
    """Weight of a sample by the power heuristic, 0 where its density is 0."""
    square = pdf * pdf
    return dr.select(pdf > 0.0, square / (square + other * other), 0.0)

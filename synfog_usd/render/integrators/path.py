"""A path tracer with fog in closed form and a split camera segment.

**Fog in closed form.**  Mitsuba's `volpath` finds the fog's edge by tracing a
null-material box, on every path and every shadow ray.  Here the fog is a formula
(`Medium`): a path costs one ray a segment and one a shadow test.

**The eye's segment is split.**  A camera ray does not choose between meeting the
surface and being scattered: one sub-path is scattered for certain, with weight 1 - T,
the other meets the surface, with weight T.  So the AOVs surface, airlight_single
and airlight_multiple come out by themselves.

The estimator below is the usual one (Kajiya and Von Herzen 1984; Pauly et al. 2000):
flights in proportion to transmittance, phase function and BSDF sampling combined with
emitter sampling by the power heuristic (Veach and Guibas 1995), lamps by resampling
(`lights.sampler`), Russian roulette.

**Lamps apart.**  Light of lamps and all other light (sky, sun, pictures that shine) are estimators of their own, with
paths of their own.  Paths for the sky need no loop over the lamps, paths for lamps no look at the sky, and each gets as
many samples as its own noise asks for.

**Regularization.**  On paths to lamps, mirror lobes are widened after a rough or foggy vertex (Kaplanyan and
Dachsbacher 2013), so that small lamps leave no fireflies.  The bias falls as n^(-1/6) with the number n of a pixel's
path (`surface.blur`).  A lamp that is a point is mirrored as its glass (`surface.lit_from`).

`eye` has the camera's rays, `next_event` the lights that are asked, `lamps` the
estimators that end at the first vertex, `light_groups` the sums.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from synfog_usd.base.progress import Progress, silent
from synfog_usd.render import backend
from synfog_usd.render.film.accumulator import (
    AOVS,
    DIRECT,
    HALF_STRIDE,
    INSCATTERED,
    INSCATTERED_OF_LAMPS,
    LAMPS,
    LIT,
    SURFACE,
    SURFACE_OF_LAMPS,
    Accumulator,
    Moments,
)
from synfog_usd.render.film.allocation import accumulate_by_estimator
from synfog_usd.render.integrators import lamps
from synfog_usd.render.integrators.eye import Eye, split_camera_segment
from synfog_usd.render.integrators.light_groups import LightGroups
from synfog_usd.render.integrators.next_event import NextEvent, Previous, lamp_faces, mis_weight
from synfog_usd.render.integrators.tasks import Tasks
from synfog_usd.render.lights.importance import Gloss
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.medium import Medium
from synfog_usd.render.sampling.sobol import Sobol
from synfog_usd.render.spectra.bands import is_finite
from synfog_usd.render.surface import MOST_SPREAD, blur, lit_from, seen_from

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Ray3f

    from synfog_usd.render.spectra.bands import SampledSpectrum

RR_DEPTH = 8
"""Events before Russian roulette, as in Mitsuba; 5 and 16 are as good."""

FAINT = 0.5
"""Share of a path's throughput after the first vertex below which it faces Russian roulette from the first event on."""

FAINT_OF_LAMPS = 2.0
"""The same of paths from a surface to lamps: half of them end there. Each costs twice what one to the sky does, and
light that lamps send to a surface by way of others is smooth."""

UNLIMITED = 1 << 20


@dataclass(frozen=True)
class Truncation:
    """Where a `FogPath` cuts its paths; nowhere by default.

    Attributes:
        scatterings: how often the fog may scatter a path; what would be scattered more often is lost.
        bounces: how many surfaces a path may meet; further ones count as black.
    """

    scatterings: int = UNLIMITED
    bounces: int = UNLIMITED


class FogPath:
    """One scene's integrator.

    Args:
        medium: the fog.
        lights: those that are sampled by where they matter; their weight in the
            scene's own choice must be 0.
        other_lights: how many other lights there are but the environment.  Where there are
            none, a scattering in the fog sends them no shadow ray: the phase function's
            own sample finds a sky better.
        light_groups: of all lights; knows what a path carries.
        truncation: where paths are cut.
        regularize: see `surface.blur`; without it there is no bias at all.
    """

    def __init__(
        self,
        loaded: MitsubaScene,
        medium: Medium,
        *,
        lights: LightSampler,
        other_lights: int,
        light_groups: LightGroups,
        truncation: Truncation,
        regularize: bool = True,
    ) -> None:
        self.bands, self.light_groups, self.group_names = light_groups.bands, light_groups, light_groups.names
        self.loaded, self.medium, self.lights = loaded, medium, lights
        self.truncation, self.foggy = truncation, medium.foggy
        self.eye = Eye(loaded)
        self.of_lamps, self.of_others = self._next_event(other_lights)
        self.rr_prob = dr.opaque(backend.mitsuba().Float, _rr_prob(medium))
        self.most_spread = dr.opaque(backend.mitsuba().Float, MOST_SPREAD if regularize else 0.0)
        self.limited = self.truncation.scatterings < UNLIMITED
        self.estimators = tuple(self._estimators())

    def _next_event(self, other_lights: int) -> tuple[NextEvent | None, NextEvent | None]:
        """Next-event estimation of lamps, and of all other light; each only where the scene has it."""
        lit, sky = self.lights.count > 0, self.loaded.scene.environment() is not None
        both = lit and (sky or other_lights > 0)
        make = functools.partial(
            NextEvent,
            self.loaded,
            self.medium,
            groups=self.light_groups,
            lamp_faces=lamp_faces(self.loaded) if both else None,
        )
        of_lamps = make(self.lights, other_lights=0) if lit else None
        return of_lamps, make(LightSampler({}, {}), other_lights=other_lights) if both or not lit else None

    def _estimators(self) -> Iterator[str]:
        """Names of the estimators that this scene needs."""
        scatters = self.foggy and self.truncation.scatterings > 0
        if self.of_others is not None:
            yield SURFACE
            if scatters:
                yield INSCATTERED
        if self.of_lamps is None:
            return
        yield SURFACE_OF_LAMPS
        if self.of_lamps.importance is not None:
            yield LIT
        if scatters:
            yield LAMPS
            yield INSCATTERED_OF_LAMPS
        if self.of_lamps.visible is not None and self.of_lamps.visible.count:
            yield DIRECT

    def accumulate(self, *, samples: int, seed: int, progress: Progress = silent) -> Accumulator:
        """An image, see `Integrator`."""
        return accumulate_by_estimator(self, samples=samples, seed=seed, progress=progress)

    def trace(self, estimator: str, pixel: UInt32, first: UInt32, count: int, seed: int) -> Moments:
        """Trace `count` paths of an estimator in each lane.

        Args:
            estimator: one of `estimators`.
            pixel: (N,) number of each lane's pixel, row by row from the top left.
            first: (N,) number of each lane's first path; the random numbers of a path depend on pixel and number alone.
            count: paths a lane.
            seed: of the image and the estimator.
        """
        asks = self.of_others if estimator in (SURFACE, INSCATTERED) else self.of_lamps
        assert asks is not None
        first_segment = {LAMPS: lamps.trace_lamps, DIRECT: lamps.trace_direct, LIT: lamps.trace_lit}
        if estimator in first_segment:
            return first_segment[estimator](self.eye, asks, pixel, first, count, seed)
        inscattered = estimator in (INSCATTERED, INSCATTERED_OF_LAMPS)
        return self.trace_paths(asks, inscattered, pixel, first, count, seed)

    @dr.syntax
    def trace_paths(
        self, asks: NextEvent, inscattered: bool, pixel: UInt32, first: UInt32, count: int, seed: int
    ) -> Moments:
        """Paths whose first segment meets a surface, or (`inscattered`) is scattered, to the light that `asks` counts;
        other arguments as in `trace`.

        A lane whose path has ended begins its next one, and goes on with another pixel where one has all its
        paths: vector units work on 16 lanes in step, and would otherwise wait for the longest path of the 16.
        """
        mi = backend.mitsuba()
        context, medium, bands, black = mi.BSDFContext(), self.medium, self.bands, self.bands.black()
        paths, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
        lit_apart = LIT in self.estimators and not inscattered
        faint = FAINT_OF_LAMPS if asks.lights.count and not inscattered else FAINT

        # ---- Tasks: each is some paths of one pixel, and a lane does one after the other
        parts = len(AOVS[INSCATTERED if inscattered else SURFACE])
        sums = self.light_groups.empty()  # over the paths of a task: light by light group
        tasks = Tasks(pixel, first, count, bands.count * (parts + len(sums)), 1)
        task = tasks.first_tasks()
        pixel, first = tasks.of(task, mi.Bool(True))

        # ---- Its other sums
        aovs = [bands.black() for _ in range(parts)]  # light by AOV
        lost = mi.UInt32(0)  # paths that were not finite
        number = mi.UInt32(0)  # of the path that is under way, in its task

        # ---- State of the path that is under way
        sampler = Sobol(image_seed, pixel, first)  # its random numbers
        # The segment that comes next
        ray, view_weight = self.eye.ray(sampler, self.eye.raster.corner(pixel), mi.Bool(True))
        throughput = bands.even(view_weight)  # beta: what its light counts
        scale = mi.Float(
            1.0
        )  # after the first vertex; until then what the camera segment left; roulette measures against it
        path = bands.black()  # the whole path's light
        depth = mi.UInt32(0)  # vertices so far; 0 on the camera's segment
        scattered, bounces = mi.UInt32(0), mi.UInt32(0)  # of them in the fog, and on surfaces
        prev_p, prev_pdf = (
            mi.Point3f(ray.o),
            mi.Float(1.0),
        )  # the last vertex, and the density [1/sr] with which it chose its direction
        prev_delta = mi.Bool(True)  # it could choose no other: the eye, a mirror
        prev_without_nee = mi.Bool(False)  # it sent no shadow ray
        prev_first = mi.Bool(False)  # it is the first that the eye sees, or the eye that looks through panes
        prev_row = mi.UInt32(0)  # of the sky's table
        spread2 = mi.Float(0.0)  # square of the roughness of a lobe that would spread directions as all vertices did
        prev_gloss, prev_weighed = (
            Gloss(),
            mi.Float(0.0),
        )  # how it answers lamps, and the sum of all their weights there; 0 where none was drawn
        active = mi.Bool(True)  # this lane still has paths

        while active:
            at_eye = active & (depth == 0)

            # ==== 1. Free flight: where the fog would scatter the path, if nothing stands before
            may_scatter = active & ~at_eye
            if dr.hint(self.limited, mode="scalar"):
                may_scatter &= scattered < self.truncation.scatterings
            u_flight = sampler.next_1d(active)
            near, far, flight = self.sample_flight(ray, u_flight, sampler, may_scatter)

            # ==== 2. What the segment meets
            segment = mi.Ray3f(ray)
            if dr.hint(asks.lights.count == 0, mode="scalar"):  # lamps are asked all along the ray
                segment.maxt = dr.minimum(flight, segment.maxt)
            si = self.loaded.tree.ray_intersect(segment, active=active)
            stop = dr.minimum(dr.select(si.is_valid(), si.t, dr.inf), far)  # where the fog before the surface ends
            medium_scattered = active & dr.isfinite(flight) & (flight < dr.select(si.is_valid(), si.t, dr.inf))
            surface_hit = active & si.is_valid() & ~medium_scattered
            end = dr.select(surface_hit, si.t, dr.inf)

            # ==== 3. First segment: it is split, and this estimator follows one side of it
            if dr.hint(self.foggy, mode="scalar"):
                fog_end, share, place = dr.maximum(dr.minimum(end, far), near), mi.Float(1.0), mi.Float(dr.inf)
                if dr.hint(self.limited, mode="scalar"):
                    lost_way = active & ~at_eye & ~may_scatter
                    through = medium.transmittance_inside(ray.o, ray.d, near, fog_end, sampler, lost_way)
                    throughput = dr.select(lost_way, throughput * through, throughput)
                if dr.hint(inscattered, mode="scalar"):
                    share, place = medium.sample_inside(ray.o, ray.d, near, fog_end, u_flight, sampler, at_eye)
                    some = at_eye & (share > 0.0)
                    surface_hit &= ~at_eye
                    flight = dr.select(some, place, flight)
                    medium_scattered |= some
                else:
                    share = medium.transmittance_inside(ray.o, ray.d, near, fog_end, sampler, at_eye)
                throughput, scale = split_camera_segment(share, throughput, scale, sampler, at_eye)
            carries = dr.max(throughput) > 0.0  # Russian roulette of the camera's segment ends the others here
            surface_hit, medium_scattered = surface_hit & carries, medium_scattered & carries

            # ==== 4. Next-event estimation along the segment: lamps, scattered once; the camera segment's are the
            # estimator LAMPS
            if dr.hint(self.foggy and asks.lights.count > 0 and self.truncation.scatterings > 0, mode="scalar"):
                lit = active & ~at_eye & (stop > near)
                if dr.hint(self.limited, mode="scalar"):
                    lit &= scattered < self.truncation.scatterings
                light, group = asks.along(
                    ray, near, stop, throughput, sampler, lit, asks.picks_along(ray, near, stop, sampler, lit)
                )
                path, aovs, sums = self.light_groups.add_to_path(path, aovs, sums, light, scattered + 1, group)

            # ==== 5. What the clearest band, in which flights are drawn, keeps and the others lose
            if dr.hint(bands.coloured, mode="scalar"):
                tau_to_end = medium.optical_depth_inside(
                    ray.o, ray.d, near, dr.maximum(dr.minimum(dr.minimum(flight, end), far), near)
                )
                throughput *= bands.fade(tau_to_end)
                scatters = bands.scattered(medium, ray(flight))
                throughput = dr.select(medium_scattered, throughput * scatters, throughput)
            unscattered = active & ~medium_scattered
            if dr.hint(inscattered, mode="scalar"):
                unscattered &= ~at_eye

            # ==== 6. Emission at the segment's end, weighed against the shadow ray of the vertex before
            light, group = asks.emitted(
                si,
                unscattered,
                surface_hit,
                throughput,
                Previous(prev_p, prev_pdf, prev_delta, prev_without_nee, prev_row, prev_gloss, prev_weighed),
                at_eye,
                prev_first & mi.Bool(lit_apart),
            )
            path, aovs, sums = self.light_groups.add_to_path(path, aovs, sums, light, scattered, group)

            # ==== 7. The vertex: in the fog or on a surface
            vertex = dr.zeros(mi.Interaction3f)
            vertex.p = dr.select(medium_scattered, ray(flight), si.p)
            vertex.n = dr.select(medium_scattered, mi.Normal3f(0.0), si.n)
            vertex.t = dr.select(medium_scattered, flight, si.t)
            if dr.hint(self.foggy, mode="scalar"):
                throughput = dr.select(medium_scattered, throughput * medium.albedo(vertex.p), throughput)
            bsdf, reading = bands.surface(si.bsdf(), surface_hit)
            scattered += dr.select(medium_scattered, mi.UInt32(1), mi.UInt32(0))
            bounces += dr.select(surface_hit, mi.UInt32(1), mi.UInt32(0))
            alive = surface_hit | medium_scattered
            smooth = surface_hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)

            # ==== 8. Next-event estimation at the vertex: the scene's own choice of lights, or a lamp of many (one call
            # gives the BSDF's value and its next direction)
            row = asks.sky_row(si)
            chosen = asks.scene_choice(vertex, row, smooth, medium_scattered, sampler)
            asked_about = si.to_local(chosen.direction)
            if dr.hint(asks.importance is not None, mode="scalar"):
                asked_about = mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z)  # the mirror's, for its gloss
            blurred, spread = si, mi.Float(0.0)
            if dr.hint(asks.lights.count > 0, mode="scalar"):
                spread = blur(dr.sqrt(spread2), (first + number) & (HALF_STRIDE - 1), self.most_spread)
                blurred = seen_from(si, spread)
            reflected, pdf, bounce, onward = bsdf.eval_pdf_sample(
                context, blurred, asked_about, sampler.next_1d(surface_hit), sampler.next_2d(surface_hit), surface_hit
            )
            gloss, picks = Gloss(), None
            if dr.hint(asks.importance is not None, mode="scalar"):
                lit = smooth & ~at_eye if lit_apart else smooth
                gloss = Gloss.of(si, reflected, pdf, lit)
                picks = asks.picks_at(si.p, gloss, sampler, lit)
                chosen = asks.choose(vertex, chosen, gloss, picks, lit, sampler)
                answering = lit_from(si, chosen.place, chosen.alone, spread)
                reflected, pdf = bsdf.eval_pdf(
                    context, answering, si.to_local(chosen.direction), chosen.exists & smooth
                )
            value, gain = bands.reflectance(reflected, reading), bands.reflectance(onward, reading)
            if dr.hint(self.foggy, mode="scalar"):
                phase_value = medium.phase_value(vertex.p, dr.dot(ray.d, chosen.direction))
                value = dr.select(medium_scattered, bands.even(mi.Color3f(phase_value)), value)
                pdf = dr.select(medium_scattered, phase_value, pdf)
            if dr.hint(asks.at_surfaces or asks.importance is not None, mode="scalar"):
                weight = dr.select(chosen.alone, 1.0, mis_weight(chosen.pdf, pdf))
                light = throughput * value * self.light_groups.light(chosen.power, chosen.group)
                shines = chosen.exists & dr.any(light != 0.0)  # a light behind the surface is worth no ray
                free, reach_light = asks.shadow_transmittance(vertex.p, vertex.n, chosen.place, sampler, shines)
                light = dr.select(free, light * (weight * reach_light), black)
                path, aovs, sums = self.light_groups.add_to_path(path, aovs, sums, light, scattered, chosen.group)

            # ==== 9. Next-event estimation at a surface: one lamp of few, or of very many
            if dr.hint(asks.lights.count > 0 and asks.importance is None, mode="scalar"):
                light, group = asks.at_surface(si, bsdf, reading, throughput, sampler, smooth, spread)
                path, aovs, sums = self.light_groups.add_to_path(path, aovs, sums, light, scattered, group)

            # ==== 10. The next direction: from the BSDF, or from the phase function
            direction, next_pdf = si.to_world(bounce.wo), bounce.pdf
            next_delta = surface_hit & mi.has_flag(bounce.sampled_type, mi.BSDFFlags.Delta)
            throughput = dr.select(surface_hit, throughput * gain, throughput)
            passed = mi.Bool(False)  # a pane, as shadow rays do: the vertex before it chose the direction
            if dr.hint(asks.panes is not None, mode="scalar"):
                assert asks.panes is not None
                straight = surface_hit & mi.has_flag(bounce.sampled_type, mi.BSDFFlags.Null)
                passed = asks.panes.share(si.shape, straight) > 0.0
            if dr.hint(asks.lit_faces is not None, mode="scalar"):
                assert picks is not None
                prev_gloss = prev_gloss.where(passed, gloss)
                prev_weighed = dr.select(passed, prev_weighed, dr.select(lit, picks.total, 0.0))
            next_without_nee = mi.Bool(False)
            if dr.hint(self.foggy, mode="scalar"):
                wo, phase_pdf = medium.phase_sample(vertex.p, ray.d, sampler.next_2d(medium_scattered))
                direction, next_pdf = (
                    dr.select(medium_scattered, wo, direction),
                    dr.select(medium_scattered, phase_pdf, next_pdf),
                )
                next_without_nee = medium_scattered & mi.Bool(not asks.in_fog)
            prev_p, prev_pdf = dr.select(passed, prev_p, vertex.p), dr.select(passed, prev_pdf, next_pdf)
            prev_row, prev_delta = dr.select(passed, prev_row, row), dr.select(passed, prev_delta, next_delta)
            prev_without_nee = dr.select(passed, prev_without_nee, next_without_nee)
            prev_first = dr.select(passed, prev_first, False) | (at_eye & surface_hit)
            bounces -= dr.select(passed, mi.UInt32(1), mi.UInt32(0))
            spread2 += dr.select(next_delta, 0.0, dr.rcp(dr.maximum(4.0 * dr.pi * next_pdf, 1e-3)))
            ray = vertex.spawn_ray(direction)
            depth += 1

            # ==== 11. Roulette
            scale = dr.select(depth == 1, dr.maximum(dr.max(throughput), 1e-30), scale)
            rr_prob = self.roulette(throughput, scale, depth, faint)
            alive &= (dr.max(throughput) > 0.0) & (sampler.next_1d(alive) < rr_prob)
            alive &= medium_scattered | (bounces < self.truncation.bounces)
            throughput /= dr.maximum(rr_prob, 1e-8)

            # ==== 12. The lane's next path where this one has ended, of its next task where this one has all of them
            over = active & ~alive
            finite = is_finite(path)
            lost += dr.select(over & ~finite, mi.UInt32(1), mi.UInt32(0))
            number += dr.select(over, mi.UInt32(1), mi.UInt32(0))
            done = over & (number >= paths)
            tasks.deliver(task, done, [part for light in (*aovs, *sums) for part in light], [lost])
            aovs, sums = ([dr.select(done, black, total) for total in totals] for totals in (aovs, sums))
            lost = dr.select(done, mi.UInt32(0), lost)
            number = dr.select(done, mi.UInt32(0), number)
            task = dr.select(done, tasks.after(task), task)
            again = over & tasks.there(task)
            next_pixel, next_first = tasks.of(task, done & again)
            pixel, first = dr.select(done, next_pixel, pixel), dr.select(done, next_first, first)
            sampler = sampler.restarted(again, Sobol(image_seed, pixel, first + number))
            view, view_weight = self.eye.ray(sampler, self.eye.raster.corner(pixel), again)
            ray = dr.select(again, view, ray)
            throughput, scale = dr.select(again, bands.even(view_weight), throughput), dr.select(again, 1.0, scale)
            path = dr.select(over, black, path)
            depth, spread2 = dr.select(again, mi.UInt32(0), depth), dr.select(again, 0.0, spread2)
            scattered, bounces = dr.select(again, mi.UInt32(0), scattered), dr.select(again, mi.UInt32(0), bounces)
            prev_p, prev_first = dr.select(again, view.o, prev_p), prev_first & ~again
            prev_delta, prev_without_nee = prev_delta | again, prev_without_nee & ~again
            active = alive | again
        colours = [bands.of(tasks.floats[low : low + bands.count]) for low in range(0, len(tasks.floats), bands.count)]
        return Moments(tuple(colours[:parts]), tuple(colours[parts:]), *tasks.counts)

    # The steps of `trace_paths`, by its numbers: traced functions, in which `if` is Python's own.

    def sample_flight(self, ray: Ray3f, u: Float, sampler: Sobol, may_scatter: Bool) -> tuple[Float, Float, Float]:
        """(1) Where the ray is in fog, from and to [m], and where the fog scatters it, infinite where it does not."""
        mi = backend.mitsuba()
        if not self.foggy:
            return mi.Float(0.0), mi.Float(0.0), mi.Float(dr.inf)
        near, far = self.medium.intersect(ray.o, ray.d)
        return near, far, self.medium.sample_flight(ray.o, ray.d, near, far, u, sampler, may_scatter)

    def roulette(self, throughput: SampledSpectrum, scale: Float, depth: UInt32, faint: float) -> Float:
        """(11) Chance of a path to go on: rr_prob after RR_DEPTH vertices, less where it carries little."""
        return dr.select(depth > RR_DEPTH, self.rr_prob, 1.0) * dr.minimum(dr.max(throughput) / (faint * scale), 1.0)


def _rr_prob(medium: Medium) -> float:
    """Chance of a path to outlive each event after RR_DEPTH.

    A path that diffuses out of fog of optical depth t across is scattered about
    (1 - g) t^2 times.  A fixed 0.95 weighs the longest of t = 20 by 0.95^-60, which
    no number of samples ever sees: it looks dark.
    """
    thickest = 0.0
    for volume in medium.volumes:
        across = 2.0 * np.linalg.norm(volume.boundary.to_world[:3, :3], axis=0).min()
        thickest = max(thickest, volume.medium.mean_sigma_t_per_m * across)
    g = min((volume.medium.phase_function.mean_cosine for volume in medium.volumes), default=0.0)
    return 1.0 - 0.5 / (10.0 + (1.0 - g) * thickest**2)

"""A path tracer with fog in closed form, a split camera segment and a control variate.

**Fog in closed form.**  Mitsuba's `volpath` finds the fog's edge by tracing a
null-material box, on every path and every shadow ray.  Here the fog is a formula
(`Medium`): a path costs one ray a segment and one a shadow test.

**The eye's segment is split.**  A camera ray does not choose between meeting the
surface and being scattered: one sub-path is scattered for certain, with weight 1 - T,
the other meets the surface, with weight T.  So the AOVs surface, airlight_single
and airlight_multiple come out by themselves.

**Control variate.**  With a `ControlVariate` S, only the difference e = L - S is sampled:
S is added where a path begins, and where it meets a surface, or leaves or enters the
slab, the jump is added instead of the light (see `media.control_variate`).  It is unbiased
as far as S fulfils the equation of transfer.

The estimator below is the usual one (Kajiya and Von Herzen 1984; Pauly et al. 2000):
flights in proportion to transmittance, phase function and BSDF sampling combined with
emitter sampling by the power heuristic (Veach and Guibas 1995), lamps by resampling
(`lights.sampler`), Russian roulette.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import numpy as np

from synfog_usd.progress import Progress, silent
from synfog_usd.render import backend
from synfog_usd.render.film.accumulator import (
    AOVS,
    DIRECT,
    INSCATTERED,
    LAMPS,
    LIT,
    SURFACE,
    Accumulator,
    Moments,
    accumulate_by_estimator,
    idle,
)
from synfog_usd.render.film.raster import Raster
from synfog_usd.render.integrators.tasks import Tasks
from synfog_usd.render.lights.grid import TILES, LightGrid
from synfog_usd.render.lights.guiding import GUIDE_PROBABILITY, MOST_GUIDED, LightGuide
from synfog_usd.render.lights.importance import PICKS, Gloss, Importance, LitFaces, Picks
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.lights.visible import VisibleFaces
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.control_variate import ControlVariate
from synfog_usd.render.media.medium import Medium, transmittance
from synfog_usd.render.motion import moved
from synfog_usd.render.sampling.sobol import Sobol
from synfog_usd.render.spectra.bands import Bands
from synfog_usd.render.surface import for_lamps, lit_from

RR_DEPTH = 8
"""Events before Russian roulette, Mitsuba's too.  Measured in MOR 150 under a uniform sky, 1 / (variance x time): 5, 8
and 16 alike,
2 and 40 up to a quarter worse."""

FAINT = 0.5
"""Share of its throughput after the first vertex below which a path is played for at once: what is seen of a dark
surface is as noisy as of a bright one.
"""

GROWN, GUIDE_DIRECTIONS, GUIDE_DIRECTIONS_GROWN = 1.5, 0.3, 0.15
"""Growth of the throughput from the first vertex on beyond which a path is guided less, and shares of directions that
are drawn towards lamps before and after: what guiding misses weighs up to 1.4 times as much at every scattering.
Variance of the air at dusk without the worst hundredth: 1.6 with 0.5 and 0.15, 1.2 with these, 1.0 with 0.15 alone,
which leaves more fireflies.
"""

DIFFERENCE_RR_PROB = 0.8
"""Chance of a path to live on after each scattering but the first, where only a difference is sampled."""

UNLIMITED = 1 << 20

MOST_WEIGHED = 160
"""Lamps that are all weighed for each stretch and point; of more, those are asked that matter in the place's cell."""

LEAST_CHANCE = 0.15
"""Of a lamp and of the scene's own choice to be asked, where both shine: what a surface makes of them is known in short
only."""

LEAST_SHARP = 2.0
"""Density [1/sr] of a first surface's direction below which no lamp is looked for along it: shadow rays find those as
well.
"""

LENS_M = 1e-3
"""Near plane [m] up to which a ray is begun at the lens itself."""


@dataclass(frozen=True)
class Truncation:
    """Where a `FogPath` cuts its paths; nowhere by default.

    Attributes:
        scatterings: how often the fog may scatter a path; what would be scattered more often is lost.
        bounces: how many surfaces a path may meet; further ones count as black, or as lit by the slab alone.
    """

    scatterings: int = UNLIMITED
    bounces: int = UNLIMITED


@dataclass
class Chosen:
    """A light that a vertex asks.

    Attributes:
        asked: whether there is one.
        place, direction: where it is, and the unit direction towards it.
        power: its radiance over the density of the choice.
        group: number of its light group.
        pdf: the density [1/sr] with which its direction is weighed against one that the surface draws.
        alone: no other way finds it.
    """

    asked: Any
    place: Any
    direction: Any
    power: Any
    group: Any
    pdf: Any
    alone: Any

    def where(self, mask: Any, other: Chosen) -> Chosen:
        """This one where `mask`, else another."""
        pairs = ((getattr(self, field.name), getattr(other, field.name)) for field in fields(self))
        return Chosen(*(dr.select(mask, one, two) for one, two in pairs))


@dataclass(frozen=True)
class FroxelGrid:
    """A camera's view cut into columns of pixels and, by what the fog leaves of them, slices.

    Attributes:
        columns, rows: of the picture; they need not be whole pixels.
        slices: each holds the same share of what a ray scatters in all fog, were it endless.
    """

    columns: int
    rows: int
    slices: int

    @property
    def count(self) -> int:
        """Of all cells."""
        return self.columns * self.rows * self.slices


class FogPath:
    """One scene's integrator.

    Args:
        medium: the fog.
        lights: those that are sampled by where they matter; their weight in the
            scene's own choice must be 0.
        others: how many other lights there are but the environment.  Where there are
            none, a scattering in the fog sends them no shadow ray: the phase function's
            own sample finds a sky better.
        control: light of the slab that is known already, or None.
        truncation: where paths are cut.
        groups: names of the light groups; `group_of_emitter` (E,) tells the number of the scene's own emitters by their
            index, `lamps` of the
            others: that of the group times `bands.kinds`, plus the kind of light.
        bands: what a path carries; R, G and B unless told otherwise.
    """

    def __init__(
        self,
        loaded: MitsubaScene,
        medium: Medium,
        *,
        lights: LightSampler,
        others: int,
        control: ControlVariate | None = None,
        truncation: Truncation | None = None,
        groups: tuple[str, ...] = ("other",),
        group_of_emitter: Any = None,
        bands: Bands | None = None,
    ) -> None:
        self.bands = bands or Bands()
        mi, camera = backend.mitsuba(), loaded.source.camera
        self.raster, self.near = Raster(camera), dr.opaque(mi.Float, camera.near_m)
        self.ahead = mi.Vector3f(*(-camera.to_world[:3, 2]).tolist())
        dr.make_opaque(self.ahead)
        self.loaded, self.medium, self.lights, self.control, self.truncation = (
            loaded,
            medium,
            lights,
            control,
            truncation or Truncation(),
        )
        sky = loaded.scene.environment() is not None
        self.foggy, self.use_nee_medium = medium.foggy, others > 0
        self.use_nee = others > 0 or (sky and control is None)
        self.group_names, self.groups, self.group_of_emitter = groups, len(groups), group_of_emitter
        self.sky_group = groups.index("sky") if "sky" in groups else 0
        eye = loaded.source.camera.to_world[:3, 3].copy()
        self.importance = (
            Importance(lights, medium) if lights.count and lights.many and lights.count <= MOST_WEIGHED else None
        )
        self.guide = (
            LightGuide(Importance(lights, medium, MOST_GUIDED, eye), medium) if lights.count and medium.foggy else None
        )
        self.lit_faces = LitFaces.of(loaded, lights) if self.importance is not None else None
        self.visible = VisibleFaces.of(loaded) if lights.count else None
        self.light_grid, self.view_lights = None, None
        if lights.count and lights.many and lights.photometric:
            sigma_t = medium.volumes[0].medium.sigma_t_per_m if medium.foggy else 0.0
            self.light_grid = LightGrid(lights, sigma_t, eye, near=self.importance is None)
            self.view_lights = self.light_grid.seen(self, medium) if medium.foggy else None
        self.meanwhile = idle
        self.rr_prob = dr.opaque(backend.mitsuba().Float, _rr_prob(medium))
        self.limited = self.truncation.scatterings < UNLIMITED
        self.estimators = (
            SURFACE,
            *((LIT,) if self.importance is not None else ()),
            *((LAMPS,) if medium.foggy and lights.count and self.truncation.scatterings > 0 else ()),
            *((INSCATTERED,) if self._has_inscattering() else ()),
            *((DIRECT,) if self.visible is not None and self.visible.count else ()),
        )

    def _has_inscattering(self) -> bool:
        return self.foggy and (self.truncation.scatterings > 0 or self.control is not None)

    def accumulate(self, *, samples: int, seed: int, progress: Progress = silent) -> Accumulator:
        """An image, see `Integrator`."""
        return accumulate_by_estimator(self, samples=samples, seed=seed, progress=progress)

    def radiance_cache(self) -> Any:
        """The cache from which the estimator INSCATTERED is looked up; None, since it is sampled pixel by pixel."""
        return None

    def trace(self, estimator: str, pixel: Any, first: Any, count: int, seed: int) -> Moments:
        """Trace `count` paths of an estimator in each lane.

        Args:
            estimator: one of `estimators`.
            pixel: (N,) number of each lane's pixel, row by row from the top left.
            first: (N,) number of each lane's first path; the random numbers of a path depend on pixel and number alone.
            count: paths a lane.
            seed: of the image and the estimator.
        """
        if estimator == LAMPS:
            return self.trace_lamps(pixel, first, count, seed)
        if estimator == DIRECT:
            return self.trace_direct(pixel, first, count, seed)
        if estimator == LIT:
            return self.trace_lit(pixel, first, count, seed)
        return self.trace_paths(estimator == INSCATTERED, pixel, first, count, seed)

    def trace_froxels(self, cells: FroxelGrid, cell: Any, first: Any, count: int, seed: int) -> Moments:
        """Light that the fog in each cell scatters towards the camera, per share of the ray; but lamps' that it
        scatters once.

        Args:
            cells: how the view is cut.
            cell: (N,) number of each lane's cell: slice by slice from the camera on, each row by row from the top left.
            first, count, seed: as in `trace`.

        Returns:
            sums over the paths that `seen` counts: those whose place in the cell nothing hides.  With a
            `ControlVariate` they are of the difference to its light.
        """
        return self.trace_paths(True, cell, first, count, seed, cells)

    @dr.syntax
    def trace_lamps(self, pixel: Any, first: Any, count: int, seed: int) -> Moments:
        """Lamps, scattered once into the eye's segment; arguments as in `trace`."""
        mi = backend.mitsuba()
        wanted, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
        corner, bands = self.raster.corner(pixel), self.bands
        single, lost = bands.black(), mi.UInt32(0)
        sums = [bands.black() for _ in range(self.groups)] if self.groups > 1 else []
        known = None if self.view_lights is None else (self.view_lights, self.tile(pixel))
        begun = mi.UInt32(0)
        while begun < wanted:
            sampler = Sobol(image_seed, pixel, first + begun)
            ray, weight = self.camera_ray(sampler, corner, mi.Bool(True))
            si = self.loaded.tree.ray_intersect_preliminary(ray, False)
            near, far = self.medium.intersect(ray.o, ray.d)
            stop = dr.minimum(dr.select(si.is_valid(), si.t, dr.inf), far)
            light, group = self.nee_along(ray, near, stop, bands.even(weight), sampler, stop > near, known)
            finite = dr.all(dr.isfinite(light))
            light = dr.select(finite, light, 0.0)
            single += light
            sums = _to_group(sums, light, self.numbered(group))
            lost += dr.select(finite, mi.UInt32(0), mi.UInt32(1))
            begun += 1
        return Moments((single,), tuple(sums), lost)

    @dr.syntax
    def trace_direct(self, pixel: Any, first: Any, count: int, seed: int) -> Moments:
        """Lamps' faces that the eye sees, piece by piece; arguments as in `trace`."""
        mi, bands, scene = backend.mitsuba(), self.bands, self.loaded.scene
        wanted, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
        total, lost = bands.black(), mi.UInt32(0)
        sums = [bands.black() for _ in range(self.groups)] if self.groups > 1 else []
        begin, end = self.visible.pieces(pixel)
        begun = dr.select(begin < end, mi.UInt32(0), wanted)
        sampler, piece = Sobol(image_seed, pixel, first), mi.UInt32(begin)
        while begun < wanted:
            place, area, owner, face = self.visible.point(piece, sampler.next_2d())
            ray, weight = self.ray_through(place / self.raster.size, sampler, mi.Bool(True))
            si = self.loaded.tree.ray_intersect(ray)
            emitter = si.emitter(scene)
            met = si.is_valid() & (dr.reinterpret_array(mi.UInt32, emitter) == owner) & (si.prim_index == face)
            group = self.group(emitter, met)
            seen = bands.even(weight) * self.light(emitter.eval(si, met), group) * area
            if dr.hint(self.foggy, mode="scalar"):
                tau = self.medium.optical_depth(ray.o, ray.d, 0.0, si.t)
                seen *= transmittance(tau)[0]
                if dr.hint(bands.coloured, mode="scalar"):
                    seen *= bands.fade(tau)
            seen = dr.select(met, seen, bands.black())
            finite = dr.all(dr.isfinite(seen))
            seen = dr.select(finite, seen, bands.black())
            lost += dr.select(finite, mi.UInt32(0), mi.UInt32(1))
            total += seen
            sums = _to_group(sums, seen, self.numbered(group))
            piece += 1
            over = piece >= end
            piece = dr.select(over, begin, piece)
            begun += dr.select(over, mi.UInt32(1), mi.UInt32(0))
            sampler = sampler.restarted(over, Sobol(image_seed, pixel, first + begun))
        return Moments((total,), tuple(sums), lost)

    @dr.syntax
    def trace_lit(self, pixel: Any, first: Any, count: int, seed: int) -> Moments:
        """Lamps' light on the first surface that the eye sees, and no further; arguments as in `trace`.

        A lamp is drawn as at any surface, and a direction by the surface's lobes alone; they share what both find by
        the power heuristic.
        """
        mi, bands, tree, context = backend.mitsuba(), self.bands, self.loaded.tree, backend.mitsuba().BSDFContext()
        wanted, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
        corner, black, once = self.raster.corner(pixel), bands.black(), mi.UInt32(0)
        aovs, lost, begun = [bands.black()], mi.UInt32(0), mi.UInt32(0)
        sums = [bands.black() for _ in range(self.groups)] if self.groups > 1 else []
        while begun < wanted:
            sampler, path = Sobol(image_seed, pixel, first + begun), bands.black()
            ray, view_weight = self.camera_ray(sampler, corner, mi.Bool(True))
            si = tree.ray_intersect(ray, mi.RayFlags.All, True, mi.Bool(True))
            hit, throughput = si.is_valid(), bands.even(view_weight)
            if dr.hint(self.foggy, mode="scalar"):
                tau = self.medium.optical_depth(ray.o, ray.d, 0.0, dr.select(hit, si.t, 0.0))
                throughput, _ = self.split_camera_segment(False, tau, throughput, mi.Float(1.0), sampler, hit)
                if dr.hint(bands.coloured, mode="scalar"):
                    throughput *= bands.fade(tau)
            hit &= dr.max(throughput) > 0.0
            bsdf, reading = bands.surface(si.bsdf(), hit)
            smooth = hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)

            # ---- A lamp that matters
            si = for_lamps(si)
            mirror = mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z)
            reflected, pdf, bounce, kept = bsdf.eval_pdf_sample(
                context, si, mirror, sampler.next_1d(hit), sampler.next_2d(hit), hit
            )
            gloss = Gloss.of(si, reflected, pdf, smooth)
            picks = self.known_at(si.p, gloss, sampler, smooth)
            lamp, colour, group, lamp_pdf = self.lights.at(si.p, gloss, sampler, smooth, picks)
            towards, asked = dr.normalize(lamp - si.p), smooth & (dr.max(colour) > 0.0)
            alone = (lamp_pdf <= 0.0) | mi.Bool(self.lit_faces is None)
            reflected, pdf = bsdf.eval_pdf(
                context, lit_from(si, lamp, alone, mi.Float(0.0)), si.to_local(towards), asked
            )
            weight = dr.select(alone | (pdf < LEAST_SHARP), 1.0, mis_weight(lamp_pdf, pdf))
            light = throughput * bands.reflectance(reflected, reading) * self.light(colour, group)
            free, reach_lamp = self.shadow_transmittance(si.p, si.n, lamp, asked & dr.any(light != 0.0))
            light = dr.select(free, light * (weight * reach_lamp), black)
            path, aovs, sums = self.add_light(path, aovs, sums, light, once, group)

            # ---- A lit face that a lobe's direction meets
            if dr.hint(self.lit_faces is not None, mode="scalar"):
                onward = throughput * bands.reflectance(kept, reading)
                no_choice = ~smooth | mi.has_flag(bounce.sampled_type, mi.BSDFFlags.Delta)
                way = si.spawn_ray(si.to_world(bounce.wo))
                going = hit & (dr.max(onward) > 0.0) & (no_choice | (bounce.pdf >= LEAST_SHARP))
                met = tree.ray_intersect_preliminary(way, False, going)
                emitter = met.shape.emitter()
                area_pdf, number = self.lit_faces.of_emitter(emitter, going & met.is_valid())
                found = area_pdf > 0.0
                end = met.compute_surface_interaction(way, mi.RayFlags.All, found)
                lamp_pdf = self.face_pdf(number, area_pdf, end, si.p, gloss, picks.total)
                weight = dr.select(no_choice, 1.0, mis_weight(bounce.pdf, lamp_pdf))
                group = self.group(emitter, found)
                light = onward * weight * self.light(emitter.eval(end, found), group)
                if dr.hint(self.foggy, mode="scalar"):
                    tau = self.medium.optical_depth(way.o, way.d, 0.0, dr.select(found, met.t, 0.0))
                    light *= transmittance(tau)[0]
                    if dr.hint(bands.coloured, mode="scalar"):
                        light *= bands.fade(tau)
                light = dr.select(found, light, black)
                path, aovs, sums = self.add_light(path, aovs, sums, light, once, group)
            lost += dr.select(dr.all(dr.isfinite(path)), mi.UInt32(0), mi.UInt32(1))
            begun += 1
        return Moments(tuple(aovs), tuple(sums), lost)

    def face_pdf(self, lamp: Any, area_pdf: Any, end: Any, place: Any, gloss: Gloss, weighed: Any) -> Any:
        """Density [1/sr] with which a surface at `place` draws a point of a lamp's face as one of `PICKS`.

        Args:
            lamp, area_pdf: number of the lamp, and one over the area of its faces [1/m2].
            end: the point.
            gloss, weighed: how the surface answers lamps, and the sum of all their weights there.
        """
        chance = PICKS * self.importance.at(lamp, place, gloss) / dr.maximum(weighed, 1e-30)
        cosine = dr.abs(dr.dot(end.n, end.to_world(end.wi)))
        return chance * area_pdf * dr.squared_norm(end.p - place) / dr.maximum(cosine, 1e-6)

    def known_along(self, ray: Any, near: Any, stop: Any, sampler: Any, active: Any) -> Any:
        """Which lamps to ask about a segment, where there are too many to ask them all."""
        if self.importance is not None:
            return self.importance.draw(
                lambda index: self.importance.along(index, ray.o, ray.d, near, stop), sampler, active
            )
        if self.light_grid is None:
            return None
        tau = dr.minimum(-dr.log(1.0 - sampler.next_1d(active)), 3.0)
        return self.known_near(ray(self.medium.sample_distance(ray.o, ray.d, tau, near, stop)))

    def known_at(self, place: Any, gloss: Gloss, sampler: Any, active: Any) -> Picks:
        """Which lamps to ask about a point of a surface."""
        return self.importance.draw(lambda index: self.importance.at(index, place, gloss), sampler, active)

    def known_near(self, place: Any) -> Any:
        """Chances of the lamps at points, from their cells."""
        return None if self.light_grid is None else (self.light_grid.near, self.light_grid.cell(place))

    def tile(self, pixel: Any) -> Any:
        """Number of the tile of the view in which pixels lie."""
        raster = self.raster
        return pixel % raster.width * TILES[0] // raster.width + TILES[0] * (
            pixel // raster.width * TILES[1] // raster.height
        )

    def froxel(self, cell: Any, cells: FroxelGrid) -> tuple[Any, Any, Any]:
        """(u, v) of the top left corners of cells, in pixels; the width and height of one, in pixels; the slices that
        they are in.
        """
        mi = backend.mitsuba()
        columns, column_count = dr.opaque(mi.UInt32, cells.columns), dr.opaque(mi.UInt32, cells.columns * cells.rows)
        size = self.raster.size / mi.Point2f(dr.opaque(mi.Float, cells.columns), dr.opaque(mi.Float, cells.rows))
        column = cell % column_count
        return (
            mi.Point2f(mi.Float(column % columns), mi.Float(column // columns)) * size,
            size,
            mi.Float(cell // column_count),
        )

    def region(self, cells: FroxelGrid | None, pixel: Any) -> tuple[Any, Any, Any]:
        """Top left corner of pixels, or of cells, and the size of one, both in pixels; and the slices of the cells."""
        mi = backend.mitsuba()
        if cells is not None:
            return self.froxel(pixel, cells)
        return self.raster.corner(pixel), mi.Point2f(1.0), mi.Float(0.0)

    @dr.syntax
    def trace_paths(
        self, inscattered: bool, pixel: Any, first: Any, count: int, seed: int, cells: FroxelGrid | None = None
    ) -> Moments:
        """Paths whose first segment meets a surface, or (`inscattered`) is scattered, anywhere or within `cells`; other
        arguments as in `trace`.

        A lane whose path has ended begins its next one at once, and goes on with another pixel where one has all its
        paths: vector units work on 16 lanes in step, and would otherwise wait for the longest path of the 16.
        """
        mi = backend.mitsuba()
        context, medium, bands, black = mi.BSDFContext(), self.medium, self.bands, self.bands.black()
        wanted, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
        in_froxels, lit_apart = cells is not None, LIT in self.estimators and not inscattered
        slices = float(cells.slices if in_froxels else 1)

        # ---- Tasks: each is some paths of one pixel, and a lane does one after the other
        parts = len(AOVS[INSCATTERED if inscattered else SURFACE])
        lit_groups = self.groups if self.groups > 1 else 0
        squared = int(in_froxels)
        tasks = Tasks(pixel, first, count, bands.count * (parts + squared + lit_groups), 2)
        task, region = tasks.begun(), functools.partial(self.region, cells)
        pixel, first = tasks.of(task, mi.Bool(True))
        corner, size, nearest = region(pixel)

        # ---- Sums over the paths of a task
        aovs = [bands.black() for _ in range(parts)]  # light by AOV
        sums = [bands.black() for _ in range(lit_groups)]  # light by light group
        squares = [bands.black() for _ in range(squared)]  # of each path's light
        lost = mi.UInt32(0)  # paths that were not finite
        seen = mi.UInt32(0)  # paths of a froxel that nothing hid
        begun = mi.UInt32(0)  # paths of the task that have ended

        # ---- State of the path that is under way
        sampler = Sobol(image_seed, pixel, first)  # its random numbers
        ray, view_weight = self.camera_ray(sampler, corner, mi.Bool(True), size)  # the segment that comes next
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
        spread2 = mi.Float(0.0)  # square of the roughness of a lobe that would spread directions as all vertices did
        prev_gloss, prev_weighed = (
            Gloss(),
            mi.Float(0.0),
        )  # how it answers lamps, and the sum of all their weights there; 0 where none was drawn
        active = mi.Bool(True)  # this lane still has paths

        while active:
            at_eye = active & (depth == 0)
            corner, size, nearest = region(pixel)

            # ==== 1. Free flight: where the fog would scatter the path, if nothing stands before
            may_scatter = active & ~at_eye
            if dr.hint(self.limited, mode="scalar"):
                may_scatter &= scattered < self.truncation.scatterings
            u_flight = sampler.next_1d(active)
            near, far, flight = self.sample_flight(ray, u_flight, may_scatter)

            # ==== 2. What the segment meets
            segment = mi.Ray3f(ray)
            if dr.hint(self.lights.count == 0, mode="scalar"):  # lamps are asked all along the ray
                segment.maxt = dr.minimum(flight, segment.maxt)
            si = self.loaded.tree.ray_intersect(segment, active=active)
            stop = dr.minimum(dr.select(si.is_valid(), si.t, dr.inf), far)  # where the fog before the surface ends
            medium_scattered = active & dr.isfinite(flight) & (flight < dr.select(si.is_valid(), si.t, dr.inf))
            surface_hit = active & si.is_valid() & ~medium_scattered
            end = dr.select(surface_hit, si.t, dr.inf)

            # ==== 3. Control variate: at the eye the airlight between two ends, later a jump wherever its domain is
            # entered or left
            if dr.hint(self.control is not None, mode="scalar"):
                jump = throughput * self.control_jump(ray, flight, end, active, at_eye, surface_hit, may_scatter)
                if dr.hint(not inscattered or in_froxels, mode="scalar"):
                    jump = dr.select(at_eye, black, jump)
                path, aovs, sums = self.add_light(path, aovs, sums, jump, mi.UInt32(2), mi.UInt32(0))

            # ==== 4. First segment: it is split, and this estimator follows one side of it
            tau = mi.Float(0.0)  # of the segment as far as its end
            if dr.hint(self.foggy, mode="scalar"):
                tau = medium.optical_depth_inside(ray.o, ray.d, near, dr.maximum(dr.minimum(end, far), near))
                if dr.hint(self.limited, mode="scalar"):
                    throughput = dr.select(
                        active & ~at_eye & ~may_scatter, throughput * transmittance(tau)[0], throughput
                    )
                if dr.hint(not in_froxels, mode="scalar"):
                    throughput, scale = self.split_camera_segment(inscattered, tau, throughput, scale, sampler, at_eye)
            if dr.hint(inscattered, mode="scalar"):
                surface_hit &= ~at_eye
                if dr.hint(in_froxels, mode="scalar"):
                    some, place = self.sample_froxel(nearest, slices, ray, near, stop, tau, u_flight, at_eye)
                    seen += dr.select(some, mi.UInt32(1), mi.UInt32(0))
                else:
                    some, place, throughput = self.sample_camera_segment(
                        ray, near, stop, tau, u_flight, throughput, sampler, at_eye
                    )
                flight = dr.select(some, place, flight)
                medium_scattered |= some
            carries = dr.max(throughput) > 0.0  # what lost the play for the camera's segment ends here
            surface_hit, medium_scattered = surface_hit & carries, medium_scattered & carries

            # ==== 5. Next-event estimation along the segment: lamps, scattered once; the camera segment's are the
            # estimator LAMPS
            if dr.hint(self.foggy and self.lights.count > 0 and self.truncation.scatterings > 0, mode="scalar"):
                lit = active & ~at_eye & (stop > near)
                if dr.hint(self.limited, mode="scalar"):
                    lit &= scattered < self.truncation.scatterings
                light, group = self.nee_along(
                    ray, near, stop, throughput, sampler, lit, self.known_along(ray, near, stop, sampler, lit)
                )
                path, aovs, sums = self.add_light(path, aovs, sums, light, scattered + 1, group)

            # ==== 6. What the clearest band, in which flights are drawn, keeps and the others lose
            if dr.hint(bands.coloured, mode="scalar"):
                tau_to_end = medium.optical_depth_inside(
                    ray.o, ray.d, near, dr.maximum(dr.minimum(dr.minimum(flight, end), far), near)
                )
                throughput *= bands.fade(tau_to_end)
                throughput = dr.select(medium_scattered, throughput * bands.scattered(), throughput)
            ended = active & ~medium_scattered
            if dr.hint(inscattered, mode="scalar"):
                ended &= ~at_eye

            # ==== 7. Emission at the segment's end, weighed against the shadow ray of the vertex before
            light, group = self.emitted(
                si,
                ended,
                surface_hit,
                throughput,
                prev_p,
                prev_pdf,
                prev_delta,
                prev_without_nee,
                prev_gloss,
                prev_weighed,
                at_eye,
                (depth == 1) & (bounces == 1) & mi.Bool(lit_apart),
            )
            path, aovs, sums = self.add_light(path, aovs, sums, light, scattered, group)

            # ==== 8. The vertex: in the fog or on a surface
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

            # ==== 9. Next-event estimation at the vertex: the scene's own choice of lights, or a lamp of many (one call
            # gives the BSDF's value and its next direction)
            chosen = self.sample_emitter(vertex, smooth, medium_scattered, sampler)
            asked_about = si.to_local(chosen.direction)
            if dr.hint(self.importance is not None, mode="scalar"):
                asked_about = mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z)  # the mirror's, for its gloss
            reflected, pdf, bounce, kept = bsdf.eval_pdf_sample(
                context, si, asked_about, sampler.next_1d(surface_hit), sampler.next_2d(surface_hit), surface_hit
            )
            gloss, picks = Gloss(), None
            if dr.hint(self.importance is not None, mode="scalar"):
                lit = smooth & ~at_eye if lit_apart else smooth
                gloss = Gloss.of(si, reflected, pdf, lit)
                picks = self.known_at(si.p, gloss, sampler, lit)
                chosen = self.choose_light(vertex, chosen, gloss, picks, lit, sampler)
                answering = lit_from(si, chosen.place, chosen.alone, dr.sqrt(spread2))
                reflected, pdf = bsdf.eval_pdf(context, answering, si.to_local(chosen.direction), chosen.asked & smooth)
            value, gain = bands.reflectance(reflected, reading), bands.reflectance(kept, reading)
            if dr.hint(self.foggy, mode="scalar"):
                phase_value = medium.phase.value(dr.dot(ray.d, chosen.direction))
                value = dr.select(medium_scattered, bands.even(mi.Color3f(phase_value)), value)
                pdf = dr.select(medium_scattered, phase_value, pdf)
            if dr.hint(self.use_nee or self.importance is not None, mode="scalar"):
                weight = dr.select(chosen.alone, 1.0, mis_weight(chosen.pdf, pdf))
                light = throughput * value * self.light(chosen.power, chosen.group)
                asked = chosen.asked & dr.any(light != 0.0)  # a light behind the surface is worth no ray
                free, reach_light = self.shadow_transmittance(vertex.p, vertex.n, chosen.place, asked)
                light = dr.select(free, light * (weight * reach_light), black)
                path, aovs, sums = self.add_light(path, aovs, sums, light, scattered, chosen.group)

            # ==== 10. Next-event estimation at a surface: one lamp of few, or of very many
            if dr.hint(self.lights.count > 0 and self.importance is None, mode="scalar"):
                light, group = self.nee_surface(si, bsdf, reading, throughput, sampler, smooth, dr.sqrt(spread2))
                path, aovs, sums = self.add_light(path, aovs, sums, light, scattered, group)

            # ==== 11. The next direction: from the BSDF, or from the phase function and light guiding
            direction, next_pdf = si.to_world(bounce.wo), bounce.pdf
            next_delta = surface_hit & mi.has_flag(bounce.sampled_type, mi.BSDFFlags.Delta)
            onward = dr.select(surface_hit, throughput * gain, throughput)
            if dr.hint(self.control is not None, mode="scalar"):
                light = self.control_reflected(
                    si, bsdf, reading, bounce, vertex, direction, throughput, onward, surface_hit, smooth, next_delta
                )
                path, aovs, sums = self.add_light(path, aovs, sums, light, mi.UInt32(2), mi.UInt32(0))
            throughput = onward
            if dr.hint(self.lit_faces is not None, mode="scalar"):
                prev_gloss, prev_weighed = gloss, dr.select(lit, picks.total, 0.0)
            prev_p, prev_pdf, prev_delta, prev_without_nee = (
                mi.Point3f(vertex.p),
                mi.Float(next_pdf),
                mi.Bool(next_delta),
                mi.Bool(False),
            )
            if dr.hint(self.foggy, mode="scalar"):
                wo, phase_pdf, throughput = self.sample_phase(
                    ray.d, vertex.p, throughput, scale, sampler, medium_scattered
                )
                direction, prev_pdf = (
                    dr.select(medium_scattered, wo, direction),
                    dr.select(medium_scattered, phase_pdf, prev_pdf),
                )
                prev_without_nee = medium_scattered & mi.Bool(not self.use_nee_medium)
            spread2 += dr.select(prev_delta, 0.0, dr.rcp(dr.maximum(4.0 * dr.pi * prev_pdf, 1e-3)))
            ray = vertex.spawn_ray(direction)
            depth += 1

            # ==== 12. Roulette
            scale = dr.select(depth == 1, dr.maximum(dr.max(throughput), 1e-30), scale)
            rr_prob = self.roulette(throughput, scale, depth, scattered, medium_scattered)
            alive &= (dr.max(throughput) > 0.0) & (sampler.next_1d(alive) < rr_prob)
            alive &= medium_scattered | (bounces < self.truncation.bounces)
            throughput /= dr.maximum(rr_prob, 1e-8)

            # ==== 13. The lane's next path where this one has ended, of its next task where this one has all of them
            over = active & ~alive
            finite = dr.all(dr.isfinite(path))
            squares = [square + dr.select(over & finite, path * path, black) for square in squares]
            lost += dr.select(over & ~finite, mi.UInt32(1), mi.UInt32(0))
            begun += dr.select(over, mi.UInt32(1), mi.UInt32(0))
            done = over & (begun >= wanted)
            tasks.deliver(task, done, [part for light in (*aovs, *squares, *sums) for part in light], [lost, seen])
            aovs, squares, sums = (
                [dr.select(done, black, total) for total in totals] for totals in (aovs, squares, sums)
            )
            lost = dr.select(done, mi.UInt32(0), lost)
            seen, begun = dr.select(done, mi.UInt32(0), seen), dr.select(done, mi.UInt32(0), begun)
            task = dr.select(done, tasks.after(task), task)
            again = over & tasks.there(task)
            next_pixel, next_first = tasks.of(task, done & again)
            pixel, first = dr.select(done, next_pixel, pixel), dr.select(done, next_first, first)
            sampler = sampler.restarted(again, Sobol(image_seed, pixel, first + begun))
            corner, size, nearest = region(pixel)
            view, view_weight = self.camera_ray(sampler, corner, again, size)
            ray = dr.select(again, view, ray)
            throughput, scale = dr.select(again, bands.even(view_weight), throughput), dr.select(again, 1.0, scale)
            path = dr.select(over, black, path)
            depth, spread2 = dr.select(again, mi.UInt32(0), depth), dr.select(again, 0.0, spread2)
            scattered, bounces = dr.select(again, mi.UInt32(0), scattered), dr.select(again, mi.UInt32(0), bounces)
            prev_p, prev_delta, prev_without_nee = (
                dr.select(again, view.o, prev_p),
                prev_delta | again,
                prev_without_nee & ~again,
            )
            active = alive | again
        colours = [bands.of(tasks.floats[low : low + bands.count]) for low in range(0, len(tasks.floats), bands.count)]
        aovs, squares, sums = colours[:parts], colours[parts : parts + squared], colours[parts + squared :]
        return Moments(tuple(aovs), tuple(sums), *tasks.counts, *squares)

    # The steps of `trace_paths`, by its numbers: traced functions, in which `if` is Python's own.

    def sample_flight(self, ray: Any, u: Any, may_scatter: Any) -> tuple[Any, Any, Any]:
        """(1) Where the ray is in fog, from and to [m], and where the fog scatters it, infinite where it does not:
        density in proportion to transmittance.
        """
        mi = backend.mitsuba()
        if not self.foggy:
            return mi.Float(0.0), mi.Float(0.0), mi.Float(dr.inf)
        near, far = self.medium.intersect(ray.o, ray.d)
        distance = self.medium.sample_distance(ray.o, ray.d, -dr.log(1.0 - u), near, far)
        return near, far, dr.select(may_scatter & (distance < far), distance, dr.inf)

    def control_jump(
        self, ray: Any, flight: Any, end: Any, active: Any, at_eye: Any, surface_hit: Any, may_scatter: Any
    ) -> Any:
        """(3) The control variate's radiance where a segment enters its domain, less that where it leaves it or meets a
        surface.
        """
        control, black = self.control, self.bands.black()
        begin_in, end_in = control.intersect(ray.o, ray.d)
        inside = active & (end_in > begin_in) & (begin_in < dr.minimum(end, flight))
        leaves = dr.minimum(end, flight) > end_in
        until = dr.select(leaves, end_in, end)  # a flight ends inside: nothing to add
        counted = inside & dr.isfinite(until) & (leaves | surface_hit)
        here = control.radiance(ray(until), ray.d, counted)
        into = inside & ((begin_in > 0.0) | at_eye)
        there = control.radiance(ray(begin_in), ray.d, into)
        dimmed = at_eye | ~may_scatter if self.limited else at_eye  # no flight was drawn that thins the paths
        dim_there = dr.select(dimmed, transmittance(self.medium.optical_depth(ray.o, ray.d, 0.0, begin_in))[0], 1.0)
        dim_here = dr.select(dimmed, transmittance(self.medium.optical_depth(ray.o, ray.d, 0.0, until))[0], 1.0)
        return dr.select(into, there * dim_there, black) - dr.select(counted, here * dim_here, black)

    def split_camera_segment(
        self, inscattered: bool, tau: Any, throughput: Any, scale: Any, sampler: Any, at_eye: Any
    ) -> tuple[Any, Any]:
        """(4) Throughput of the side of the camera's segment that is followed, T or 1 - T; a faint one is played for,
        and its weight is the new scale.
        """
        through, opaque = transmittance(tau)
        share = opaque if inscattered else through
        chance = dr.minimum(4.0 * share, 1.0)
        share = dr.select(sampler.next_1d(at_eye) < chance, share / dr.maximum(chance, 1e-30), 0.0)
        return dr.select(at_eye, throughput * share, throughput), dr.select(at_eye, dr.maximum(share, 1e-30), scale)

    def sample_froxel(
        self, nearest: Any, slices: float, ray: Any, near: Any, stop: Any, tau: Any, u: Any, at_eye: Any
    ) -> tuple[Any, Any]:
        """(4) Whether a path begins in its froxel, unhidden, and the distance [m] at which it does: even in the share
        of the ray that is scattered.
        """
        share = (nearest + u) / slices
        return at_eye & (share < transmittance(tau)[1]), self.medium.sample_distance(
            ray.o, ray.d, -dr.log(1.0 - share), near, stop
        )

    def sample_camera_segment(
        self, ray: Any, near: Any, stop: Any, tau: Any, u: Any, throughput: Any, sampler: Any, at_eye: Any
    ) -> tuple[Any, Any, Any]:
        """(4) Where the fog scatters the camera's segment, which it does for certain: in proportion to transmittance x
        extinction, or guided to a lamp.
        """
        medium, opaque = self.medium, transmittance(tau)[1]
        some = at_eye & (opaque > 0.0)
        if self.truncation.scatterings == 0:
            some &= False
        place = medium.sample_distance(ray.o, ray.d, -dr.log(1.0 - u * opaque), near, stop)
        if self.guide is not None:
            guided = self.guide.distance(ray.o, ray.d, near, stop, sampler.next_1d(some), sampler.next_1d(some))
            place = dr.select(sampler.next_1d(some) < GUIDE_PROBABILITY, guided, place)
            plain = (
                dr.exp(-medium.optical_depth_inside(ray.o, ray.d, near, place)) * medium.extinction(ray(place)) / opaque
            )
            mixed = (
                GUIDE_PROBABILITY * self.guide.distance_density(ray.o, ray.d, near, stop, place)
                + (1.0 - GUIDE_PROBABILITY) * plain
            )
            throughput = dr.select(some, throughput * plain / dr.maximum(mixed, 1e-30), throughput)
        return some, place, throughput

    def nee_along(
        self, ray: Any, near: Any, stop: Any, throughput: Any, sampler: Any, active: Any, known: Any
    ) -> tuple[Any, Any]:
        """(5) A lamp's light that the fog scatters once into a segment, and the lamp's group."""
        where, lamp, colour, group = self.lights.along(ray.o, ray.d, near, stop, self.medium, sampler, active, known)
        free, reach_lamp = self.shadow_transmittance(
            where, backend.mitsuba().Normal3f(0.0), lamp, active & (dr.max(colour) > 0.0)
        )
        light = dr.select(free, throughput * self.light(colour, group) * reach_lamp, self.bands.black())
        if self.bands.coloured:
            light *= self.bands.scattered() * self.bands.fade(
                self.medium.optical_depth(ray.o, ray.d, 0.0, dr.norm(where - ray.o))
            )
        return light, group

    def emitted(
        self,
        si: Any,
        ended: Any,
        surface_hit: Any,
        throughput: Any,
        prev_p: Any,
        prev_pdf: Any,
        prev_delta: Any,
        prev_without_nee: Any,
        prev_gloss: Any,
        prev_weighed: Any,
        at_eye: Any,
        lit_apart: Any,
    ) -> tuple[Any, Any]:
        """(7) What the end of a segment sends out itself, by the power heuristic, and its group; not what other
        estimators have, DIRECT of what the eye sees, and LIT where `lit_apart`.
        """
        mi, scene = backend.mitsuba(), self.loaded.scene
        previous = dr.zeros(mi.Interaction3f)
        previous.p = prev_p
        light_pdf = mi.Float(0.0)
        if self.use_nee:
            light_pdf = scene.pdf_emitter_direction(
                previous, mi.DirectionSample3f(scene, si, previous), ended & ~prev_delta
            )
        weight = dr.select(
            prev_without_nee & (light_pdf > 0.0), 1.0, dr.select(light_pdf > 0.0, mis_weight(prev_pdf, light_pdf), 0.0)
        )
        if self.control is not None:  # no shadow ray looks for the sky
            weight = dr.select(surface_hit, weight, 1.0)
        emitter = si.emitter(scene, ended)
        if self.lit_faces is not None:
            area_pdf, lamp = self.lit_faces.of_emitter(emitter, ended & surface_hit)
            lamp_pdf = self.face_pdf(lamp, area_pdf, si, prev_p, prev_gloss, prev_weighed)
            weight = dr.select((area_pdf > 0.0) & (prev_weighed > 0.0), mis_weight(prev_pdf, lamp_pdf), weight)
        weight = dr.select(prev_delta, 1.0, weight)  # else a lamp's face counts here only for the eye and for mirrors
        if self.lit_faces is not None:
            weight = dr.select(lit_apart & (area_pdf > 0.0), 0.0, weight)
        if self.visible is not None:  # the estimator DIRECT has them
            weight = dr.select(self.visible.holds(emitter, ended & surface_hit & at_eye), 0.0, weight)
        group = self.group(emitter, ended)
        return dr.select(
            ended, throughput * weight * self.light(emitter.eval(si, ended), group), self.bands.black()
        ), group

    def sample_emitter(self, vertex: Any, smooth: Any, medium_scattered: Any, sampler: Any) -> Chosen:
        """(9) A light by the scene's own choice."""
        mi = backend.mitsuba()
        lit = smooth | medium_scattered if self.use_nee_medium else mi.Bool(smooth)
        sent, power, group = dr.zeros(mi.DirectionSample3f), mi.Color3f(0.0), mi.UInt32(0)
        if self.use_nee:
            sent, power = self.loaded.scene.sample_emitter_direction(vertex, sampler.next_2d(lit), False, lit)
            if self.control is not None:
                lit &= sent.emitter != mi.EmitterPtr(self.loaded.scene.environment())
            group = self.group(sent.emitter, lit)
        return Chosen(lit & (sent.pdf > 0.0), sent.p, sent.d, power, group, sent.pdf, sent.delta)

    def choose_light(self, vertex: Any, own: Chosen, gloss: Gloss, picks: Picks, smooth: Any, sampler: Any) -> Chosen:
        """(9) That one, or one of the lamps that matter to a surface, by what it would make of them."""
        mi = backend.mitsuba()
        lamp, colour, group, pdf = self.lights.at(vertex.p, gloss, sampler, smooth, picks)
        towards = dr.normalize(lamp - vertex.p)
        from_lamp = dr.select(smooth, mi.luminance(colour) * gloss(towards), 0.0)
        from_own = dr.select(own.asked, mi.luminance(own.power) * gloss(own.direction), 0.0)
        share = dr.select(from_own > 0.0, from_own / dr.maximum(from_own + from_lamp, 1e-30), 0.0)
        share = dr.select((from_own > 0.0) & (from_lamp > 0.0), dr.clip(share, LEAST_CHANCE, 1.0 - LEAST_CHANCE), share)
        own.power = own.power / dr.maximum(share, 1e-30)
        colour = colour / dr.maximum(1.0 - share, 1e-30)
        alone = (pdf <= 0.0) | mi.Bool(self.lit_faces is None)
        lamps = Chosen(from_lamp > 0.0, lamp, towards, colour, group, pdf, alone)
        return own.where(sampler.next_1d(own.asked | smooth) < share, lamps)

    def nee_surface(
        self, si: Any, bsdf: Any, reading: Any, throughput: Any, sampler: Any, smooth: Any, spread: Any
    ) -> tuple[Any, Any]:
        """(10) A lamp's light on a surface as it is reflected, and the lamp's group."""
        context, black = backend.mitsuba().BSDFContext(), self.bands.black()
        lamp, colour, group, pdf = self.lights.at(
            si.p, lambda way: dr.abs(dr.dot(si.n, way)) + 1e-3, sampler, smooth, self.known_near(si.p)
        )
        free, reach_lamp = self.shadow_transmittance(si.p, si.n, lamp, smooth & (dr.max(colour) > 0.0))
        answering = lit_from(si, lamp, pdf <= 0.0, spread)
        reflected = bsdf.eval(context, answering, si.to_local(dr.normalize(lamp - si.p)), free)
        light = throughput * self.bands.reflectance(reflected, reading) * self.light(colour, group) * reach_lamp
        return dr.select(free, light, black), group

    def control_reflected(
        self,
        si: Any,
        bsdf: Any,
        reading: Any,
        bounce: Any,
        vertex: Any,
        direction: Any,
        throughput: Any,
        onward: Any,
        surface_hit: Any,
        smooth: Any,
        next_delta: Any,
    ) -> Any:
        """(11) The control variate's light that a surface reflects: a matte part of it in closed form, the rest along
        the direction that is taken.

        It is counted where the next ray begins in the control's domain, a little above the surface: what a surface
        lacks here that lies under the domain's floor by less than that, no jump of the ray would make up for.
        """
        control, black = self.control, self.bands.black()
        seen = surface_hit & control.holds(vertex.spawn_ray(si.to_world(si.wi)).o)
        along = surface_hit & control.holds(vertex.spawn_ray(direction).o) & (bounce.pdf > 0.0)
        matte, normal = self.matte(si, bsdf, reading, seen & smooth)
        irradiance = throughput * matte * control.irradiance(vertex.p, normal, seen) * dr.inv_pi
        cosine = dr.dot(direction, normal)
        expected = dr.select(next_delta | (cosine <= 0.0), 0.0, cosine * dr.inv_pi / dr.maximum(bounce.pdf, 1e-20))
        rest = onward - throughput * matte * expected
        return dr.select(seen, irradiance, black) + dr.select(
            along, rest * control.radiance(vertex.p, direction, along), black
        )

    def sample_phase(
        self, forward: Any, place: Any, throughput: Any, scale: Any, sampler: Any, medium_scattered: Any
    ) -> tuple[Any, Any, Any]:
        """(11) A direction after a scattering, from the phase function or guided to a lamp, and the phase function's
        density of it [1/sr].
        """
        medium = self.medium
        wo, phase_pdf = medium.phase.sample(forward, sampler.next_2d(medium_scattered))
        if self.guide is not None:
            guiding = dr.select(dr.max(throughput) < GROWN * scale, GUIDE_DIRECTIONS, GUIDE_DIRECTIONS_GROWN)
            guided = self.guide.direction(place, sampler.next_1d(medium_scattered), sampler.next_2d(medium_scattered))
            wo = dr.select(sampler.next_1d(medium_scattered) < guiding, guided, wo)
            phase_pdf = medium.phase.value(
                dr.dot(forward, wo)
            )  # also what it is weighed by against shadow rays, on both sides
            mixed = guiding * self.guide.direction_density(place, wo) + (1.0 - guiding) * phase_pdf
            throughput = dr.select(medium_scattered, throughput * phase_pdf / dr.maximum(mixed, 1e-30), throughput)
        return wo, phase_pdf, throughput

    def roulette(self, throughput: Any, scale: Any, depth: Any, scattered: Any, medium_scattered: Any) -> Any:
        """(12) Chance of a path to go on: rr_prob after RR_DEPTH vertices, less where it carries little or only a
        difference.
        """
        rr_prob = dr.select(depth > RR_DEPTH, self.rr_prob, 1.0) * dr.minimum(dr.max(throughput) / (FAINT * scale), 1.0)
        if self.control is not None:
            rr_prob *= dr.select(medium_scattered & (scattered > 1), DIFFERENCE_RR_PROB, 1.0)
        return rr_prob

    def add_light(self, path: Any, aovs: list[Any], sums: list[Any], light: Any, scattered: Any, group: Any) -> Any:
        """Add light to the path, its AOV and its group; light that is not finite is left out of both and spoils the
        path, which counts it.
        """
        finite = dr.all(dr.isfinite(light))
        clean = dr.select(finite, light, 0.0)
        path = path + dr.select(finite, light, dr.nan)
        if len(aovs) == 1:
            aovs = [aovs[0] + clean]
        else:
            once = scattered <= 1
            aovs = [aovs[0] + dr.select(once, clean, 0.0), aovs[1] + dr.select(once, 0.0, clean)]
        return path, aovs, _to_group(sums, clean, self.numbered(group))

    def numbered(self, group: Any) -> Any:
        """Light group of a lamp's number."""
        return group // self.bands.kinds if self.bands.kinds > 1 else group

    def light(self, colour: Any, group: Any) -> Any:
        """A lamp's light in all bands."""
        return self.bands.light(colour, group % self.bands.kinds if self.bands.kinds > 1 else None)

    def group(self, emitter: Any, active: Any) -> Any:
        """Number of the scene's own emitters: light group x kinds of light + kind."""
        mi = backend.mitsuba()
        if self.groups < 2 and self.bands.kinds < 2:
            return mi.UInt32(0)
        return dr.gather(mi.UInt32, self.group_of_emitter, dr.reinterpret_array(mi.UInt32, emitter), active)

    def matte(self, si: Any, bsdf: Any, reading: Any, active: Any) -> tuple[Any, Any]:
        """A diffuse reflectance that stands for a BSDF in the slab's light, and the normal of the side that is seen.

        Any value leaves the mean as it is, if the BSDF's own sampling covers the
        hemisphere: so it is asked, far from the mirror's direction, for value and density.
        """
        mi = backend.mitsuba()
        facing = dr.select(si.wi.z < 0.0, -1.0, 1.0)
        flat = dr.maximum(dr.hypot(si.wi.x, si.wi.y), 1e-6)
        back = mi.Vector3f(si.wi.x / flat * 0.8660254, si.wi.y / flat * 0.8660254, 0.5 * facing)
        value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, back, active)
        fits = active & (pdf > 0.1 * dr.inv_pi)  # a fifth of the cosine's density at 60 degrees
        return self.bands.reflectance(
            dr.select(fits, dr.minimum(value * (2.0 * dr.pi), 1.0), 0.0), reading
        ), mi.Vector3f(si.sh_frame.n) * facing

    def shadow_transmittance(self, place: Any, normal: Any, light: Any, active: Any) -> tuple[Any, Any]:
        """(whether nothing stands between a point and a light, transmittance of the fog between: one for all bands, or
        one each).
        """
        mi = backend.mitsuba()
        start = dr.zeros(mi.Interaction3f)
        start.p, start.n = place, normal
        shadow = start.spawn_ray_to(light)
        free = active & ~self.loaded.tree.ray_test(shadow, active)
        through = mi.Float(1.0)
        if self.foggy:
            towards = light - place
            length = dr.norm(towards)
            tau = self.medium.optical_depth(place, towards / dr.maximum(length, 1e-12), 0.0, length)
            through = dr.exp(-tau)
            if self.bands.coloured:
                through = through * self.bands.fade(tau)
        return free, through

    def camera_ray(self, sampler: Any, corner: Any, active: Any, size: Any = 1.0) -> tuple[Any, Any]:
        """A ray through a random point of the pixel, or of a cell `size` pixels wide, and its weight."""
        place = (corner + backend.mitsuba().Point2f(sampler.next_2d(active)) * size) / self.raster.size
        return self.ray_through(place, sampler, active)

    def ray_through(self, place: Any, sampler: Any, active: Any) -> tuple[Any, Any]:
        """A ray through a point (u, v) of the picture, 0 to 1 from the top left, and its weight."""
        mi = backend.mitsuba()
        camera = self.loaded.source.camera
        ray, weight = self.loaded.sensor.sample_ray(
            0.0, 0.5, place + mi.Point2f(*self.loaded.offset), mi.Point2f(sampler.next_2d(active)), active
        )
        if (
            camera.near_m <= LENS_M
        ):  # nothing stands before the near plane: begin at the lens, so that no fog is left out
            ray.o = ray.o - ray.d * (self.near if camera.fisheye else self.near / dr.dot(ray.d, self.ahead))
        if camera.moves:
            ray = moved(ray, camera, place.y, sampler.next_1d(active))
        return ray, weight


def _rr_prob(medium: Medium) -> float:
    """Chance of a path to outlive each event after RR_DEPTH.

    A path that diffuses out of fog of optical depth t across is scattered about
    (1 - g) t^2 times.  A fixed 0.95 weighs the longest of t = 20 by 0.95^-60, which
    no number of samples ever sees: it looks dark.
    """
    thickest = 0.0
    for volume in medium.volumes:
        across = 2.0 * np.linalg.norm(volume.boundary.to_world[:3, :3], axis=0).min()
        thickest = max(thickest, volume.medium.sigma_t_per_m * across)
    g = medium.volumes[0].medium.phase_function.mean_cosine if medium.volumes else 0.0
    return 1.0 - 0.5 / (10.0 + (1.0 - g) * thickest**2)


def _to_group(sums: list[Any], light: Any, group: Any) -> list[Any]:
    return [total + dr.select(group == index, light, 0.0) for index, total in enumerate(sums)]


def mis_weight(pdf: Any, other: Any) -> Any:
    """Weight of a sample by the power heuristic, 0 where its density is 0; a number for every density, since a lamp's
    face that is seen edge-on has an infinite one.
    """
    ratio = other / pdf
    return dr.select((pdf > 0.0) & ~dr.isnan(ratio), dr.rcp(1.0 + ratio * ratio), 0.0)

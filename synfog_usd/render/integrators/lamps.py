"""Estimators of lamps alone, on the eye's own segment: what the fog scatters of them once, their faces that the eye
sees, and their light on the first surface.  Traced code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from synfog_usd.render import backend
from synfog_usd.render.film.accumulator import Moments
from synfog_usd.render.integrators.next_event import mis_weight
from synfog_usd.render.lights.importance import Gloss
from synfog_usd.render.media.medium import transmittance
from synfog_usd.render.sampling.sobol import Sobol
from synfog_usd.render.surface import for_lamps, lit_from

if TYPE_CHECKING:
    from synfog_usd.render.integrators.path import FogPath

LEAST_SHARP = 2.0
"""Density [1/sr] of a first surface's direction below which no lamp is looked for along it: shadow rays find those as
well.
"""


@dr.syntax
def trace_lamps(of: FogPath, pixel: Any, first: Any, count: int, seed: int) -> Moments:
    """Lamps, scattered once into the eye's segment; arguments as in `FogPath.trace`."""
    mi = backend.mitsuba()
    wanted, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
    corner, bands = of.eye.raster.corner(pixel), of.bands
    single, lost = bands.black(), mi.UInt32(0)
    sums = of.light_groups.begun()
    begun = mi.UInt32(0)
    while begun < wanted:
        sampler = Sobol(image_seed, pixel, first + begun)
        ray, weight = of.eye.ray(sampler, corner, mi.Bool(True))
        si = of.loaded.tree.ray_intersect_preliminary(ray, False)
        near, far = of.medium.intersect(ray.o, ray.d)
        stop = dr.minimum(dr.select(si.is_valid(), si.t, dr.inf), far)
        lit = stop > near
        known = of.of_lamps.known_along(ray, near, stop, sampler, lit)
        light, group = of.of_lamps.along(ray, near, stop, bands.even(weight), sampler, lit, known)
        finite = dr.all(dr.isfinite(light))
        light = dr.select(finite, light, 0.0)
        single += light
        sums = of.light_groups.add(sums, light, group)
        lost += dr.select(finite, mi.UInt32(0), mi.UInt32(1))
        begun += 1
    return Moments((single,), tuple(sums), lost)


@dr.syntax
def trace_direct(of: FogPath, pixel: Any, first: Any, count: int, seed: int) -> Moments:
    """Lamps' faces that the eye sees, piece by piece; arguments as in `FogPath.trace`."""
    mi, bands, scene = backend.mitsuba(), of.bands, of.loaded.scene
    wanted, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
    total, lost = bands.black(), mi.UInt32(0)
    sums = of.light_groups.begun()
    begin, end = of.of_lamps.visible.pieces(pixel)
    begun = dr.select(begin < end, mi.UInt32(0), wanted)
    sampler, piece = Sobol(image_seed, pixel, first), mi.UInt32(begin)
    while begun < wanted:
        place, area, owner, face = of.of_lamps.visible.point(piece, sampler.next_2d())
        ray, weight = of.eye.ray_through(place / of.eye.raster.size, sampler, mi.Bool(True))
        si = of.loaded.tree.ray_intersect(ray)
        emitter = si.emitter(scene)
        met = si.is_valid() & (dr.reinterpret_array(mi.UInt32, emitter) == owner) & (si.prim_index == face)
        group = of.light_groups.of(emitter, met)
        seen = bands.even(weight) * of.light_groups.light(emitter.eval(si, met), group) * area
        if dr.hint(of.foggy, mode="scalar"):
            tau = of.medium.optical_depth(ray.o, ray.d, 0.0, si.t)
            seen *= transmittance(tau)[0]
            if dr.hint(bands.coloured, mode="scalar"):
                seen *= bands.fade(tau)
        seen = dr.select(met, seen, bands.black())
        finite = dr.all(dr.isfinite(seen))
        seen = dr.select(finite, seen, bands.black())
        lost += dr.select(finite, mi.UInt32(0), mi.UInt32(1))
        total += seen
        sums = of.light_groups.add(sums, seen, group)
        piece += 1
        over = piece >= end
        piece = dr.select(over, begin, piece)
        begun += dr.select(over, mi.UInt32(1), mi.UInt32(0))
        sampler = sampler.restarted(over, Sobol(image_seed, pixel, first + begun))
    return Moments((total,), tuple(sums), lost)


@dr.syntax
def trace_lit(of: FogPath, pixel: Any, first: Any, count: int, seed: int) -> Moments:
    """Lamps' light on the first surface that the eye sees, and no further; arguments as in `FogPath.trace`.

    A lamp is drawn as at any surface, and a direction by the surface's lobes alone; they share what both find by
    the power heuristic.
    """
    mi, bands, tree, context = backend.mitsuba(), of.bands, of.loaded.tree, backend.mitsuba().BSDFContext()
    wanted, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
    corner, black, once = of.eye.raster.corner(pixel), bands.black(), mi.UInt32(0)
    aovs, lost, begun = [bands.black()], mi.UInt32(0), mi.UInt32(0)
    sums = of.light_groups.begun()
    while begun < wanted:
        sampler, path = Sobol(image_seed, pixel, first + begun), bands.black()
        ray, view_weight = of.eye.ray(sampler, corner, mi.Bool(True))
        si = tree.ray_intersect(ray, mi.RayFlags.All, True, mi.Bool(True))
        hit, throughput = si.is_valid(), bands.even(view_weight)
        if dr.hint(of.foggy, mode="scalar"):
            tau = of.medium.optical_depth(ray.o, ray.d, 0.0, dr.select(hit, si.t, 0.0))
            throughput, _ = of.split_camera_segment(False, tau, throughput, mi.Float(1.0), sampler, hit)
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
        picks = of.of_lamps.known_at(si.p, gloss, sampler, smooth)
        lamp, colour, group, lamp_pdf = of.of_lamps.lights.at(si.p, gloss, sampler, smooth, picks)
        towards, asked = dr.normalize(lamp - si.p), smooth & (dr.max(colour) > 0.0)
        alone = (lamp_pdf <= 0.0) | mi.Bool(of.of_lamps.lit_faces is None)
        reflected, pdf = bsdf.eval_pdf(context, lit_from(si, lamp, alone, mi.Float(0.0)), si.to_local(towards), asked)
        weight = dr.select(alone | (pdf < LEAST_SHARP), 1.0, mis_weight(lamp_pdf, pdf))
        light = throughput * bands.reflectance(reflected, reading) * of.light_groups.light(colour, group)
        free, reach_lamp = of.of_lamps.shadow_transmittance(si.p, si.n, lamp, asked & dr.any(light != 0.0))
        light = dr.select(free, light * (weight * reach_lamp), black)
        path, aovs, sums = of.light_groups.add_to_path(path, aovs, sums, light, once, group)

        # ---- A lit face that a lobe's direction meets
        if dr.hint(of.of_lamps.lit_faces is not None, mode="scalar"):
            onward = throughput * bands.reflectance(kept, reading)
            no_choice = ~smooth | mi.has_flag(bounce.sampled_type, mi.BSDFFlags.Delta)
            way = si.spawn_ray(si.to_world(bounce.wo))
            going = hit & (dr.max(onward) > 0.0) & (no_choice | (bounce.pdf >= LEAST_SHARP))
            last, through = way, mi.Float(1.0)
            if dr.hint(of.of_lamps.panes is not None, mode="scalar"):
                found, met, last, through = of.of_lamps.panes.beyond(tree, way, going)
            else:
                met = tree.ray_intersect_preliminary(way, False, going)
                found = going & met.is_valid()
            emitter = met.shape.emitter()
            area_pdf, number = of.of_lamps.lit_faces.of_emitter(emitter, found)
            found = area_pdf > 0.0
            end = met.compute_surface_interaction(last, mi.RayFlags.All, found)
            lamp_pdf = of.of_lamps.face_pdf(number, area_pdf, end, si.p, gloss, picks.total)
            weight = dr.select(no_choice, 1.0, mis_weight(bounce.pdf, lamp_pdf))
            group = of.light_groups.of(emitter, found)
            light = onward * (weight * through) * of.light_groups.light(emitter.eval(end, found), group)
            if dr.hint(of.foggy, mode="scalar"):
                tau = of.medium.optical_depth(way.o, way.d, 0.0, dr.select(found, dr.norm(end.p - way.o), 0.0))
                light *= transmittance(tau)[0]
                if dr.hint(bands.coloured, mode="scalar"):
                    light *= bands.fade(tau)
            light = dr.select(found, light, black)
            path, aovs, sums = of.light_groups.add_to_path(path, aovs, sums, light, once, group)
        lost += dr.select(dr.all(dr.isfinite(path)), mi.UInt32(0), mi.UInt32(1))
        begun += 1
    return Moments(tuple(aovs), tuple(sums), lost)

"""Estimators of lamps alone, on the eye's own segment: what the fog scatters of them once, their faces that the eye
sees, and their light on the first surface.  Traced code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from synfog_usd.render import backend
from synfog_usd.render.film.accumulator import Moments
from synfog_usd.render.integrators.eye import Eye, split_camera_segment
from synfog_usd.render.integrators.next_event import LEAST_SHARP, NextEvent, mis_weight
from synfog_usd.render.lights.importance import Gloss
from synfog_usd.render.sampling.sobol import Sobol
from synfog_usd.render.spectra.bands import is_finite
from synfog_usd.render.surface import for_lamps, lit_from

if TYPE_CHECKING:
    from drjit.auto.ad import UInt32


@dr.syntax
def trace_lamps(eye: Eye, asks: NextEvent, pixel: UInt32, first: UInt32, count: int, seed: int) -> Moments:
    """Lamps, scattered once into the eye's segment; arguments as in `FogPath.trace`."""
    mi = backend.mitsuba()
    paths, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
    corner, bands = eye.raster.corner(pixel), asks.bands
    single, lost = bands.black(), mi.UInt32(0)
    sums = asks.groups.empty()
    number = mi.UInt32(0)
    while number < paths:
        sampler = Sobol(image_seed, pixel, first + number)
        ray, weight = eye.ray(sampler, corner, mi.Bool(True))
        si = asks.loaded.tree.ray_intersect_preliminary(ray, mi.Bool(False))
        near, far = asks.medium.intersect(ray.o, ray.d)
        stop = dr.minimum(dr.select(si.is_valid(), si.t, dr.inf), far)
        lit = stop > near
        picks = asks.picks_along(ray, near, stop, sampler, lit)
        light, group = asks.along(ray, near, stop, bands.even(weight), sampler, lit, picks)
        finite = is_finite(light)
        light = dr.select(finite, light, 0.0)
        single += light
        sums = asks.groups.add(sums, light, group)
        lost += dr.select(finite, mi.UInt32(0), mi.UInt32(1))
        number += 1
    return Moments((single,), tuple(sums), lost)


@dr.syntax
def trace_direct(eye: Eye, asks: NextEvent, pixel: UInt32, first: UInt32, count: int, seed: int) -> Moments:
    """Lamps' faces that the eye sees, piece by piece; arguments as in `FogPath.trace`."""
    mi, bands, scene = backend.mitsuba(), asks.bands, asks.loaded.scene
    paths, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
    total, lost = bands.black(), mi.UInt32(0)
    sums = asks.groups.empty()
    assert asks.visible is not None
    begin, end = asks.visible.pieces(pixel)
    number = dr.select(begin < end, mi.UInt32(0), paths)
    sampler, piece = Sobol(image_seed, pixel, first), mi.UInt32(begin)
    while number < paths:
        place, area, owner, face = asks.visible.point(piece, sampler.next_2d())
        ray, weight = eye.ray_through(place / eye.raster.size, sampler, mi.Bool(True))
        si = asks.loaded.tree.ray_intersect(ray)
        emitter = si.emitter(scene)
        hit = si.is_valid() & (backend.indices_of(emitter) == owner) & (si.prim_index == face)
        group = asks.groups.of(emitter, hit)
        light = bands.even(weight) * asks.groups.light(emitter.eval(si, hit), group) * area
        if dr.hint(asks.foggy, mode="scalar"):
            through, tau = asks.medium.transmittance(ray.o, ray.d, 0.0, si.t, sampler, hit)
            light *= through
            if dr.hint(bands.coloured, mode="scalar"):
                light *= bands.fade(tau)
        light = dr.select(hit, light, bands.black())
        finite = is_finite(light)
        light = dr.select(finite, light, bands.black())
        lost += dr.select(finite, mi.UInt32(0), mi.UInt32(1))
        total += light
        sums = asks.groups.add(sums, light, group)
        piece += 1
        over = piece >= end
        piece = dr.select(over, begin, piece)
        number += dr.select(over, mi.UInt32(1), mi.UInt32(0))
        sampler = sampler.restarted(over, Sobol(image_seed, pixel, first + number))
    return Moments((total,), tuple(sums), lost)


@dr.syntax
def trace_lit(eye: Eye, asks: NextEvent, pixel: UInt32, first: UInt32, count: int, seed: int) -> Moments:
    """Lamps' light on the first surface that the eye sees, and no further; arguments as in `FogPath.trace`.

    A lamp is drawn as at any surface, and a direction by the surface's lobes alone; they share what both find by
    the power heuristic.
    """
    mi, bands, tree, context = backend.mitsuba(), asks.bands, asks.loaded.tree, backend.mitsuba().BSDFContext()
    paths, image_seed = dr.opaque(mi.UInt32, count), dr.opaque(mi.UInt32, seed)
    corner, black, once = eye.raster.corner(pixel), bands.black(), mi.UInt32(0)
    aovs, lost, number = [bands.black()], mi.UInt32(0), mi.UInt32(0)
    sums = asks.groups.empty()
    while number < paths:
        sampler, path = Sobol(image_seed, pixel, first + number), bands.black()
        ray, view_weight = eye.ray(sampler, corner, mi.Bool(True))
        si = tree.ray_intersect(ray, mi.RayFlags.All, mi.Bool(True), mi.Bool(True))
        hit, throughput = si.is_valid(), bands.even(view_weight)
        if dr.hint(asks.foggy, mode="scalar"):
            length = dr.select(hit, si.t, 0.0)
            through, tau = asks.medium.transmittance(ray.o, ray.d, 0.0, length, sampler, hit)
            throughput, _ = split_camera_segment(through, throughput, mi.Float(1.0), sampler, hit)
            if dr.hint(bands.coloured, mode="scalar"):
                throughput *= bands.fade(tau)
        hit &= dr.max(throughput) > 0.0
        bsdf, reading = bands.surface(si.bsdf(), hit)
        smooth = hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)

        # ---- A lamp that matters
        si = for_lamps(si)
        mirror = mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z)
        reflected, pdf, bounce, gain = bsdf.eval_pdf_sample(
            context, si, mirror, sampler.next_1d(hit), sampler.next_2d(hit), hit
        )
        gloss = Gloss.of(si, reflected, pdf, smooth)
        picks = asks.picks_at(si.p, gloss, sampler, smooth)
        lamp, colour, group, lamp_pdf = asks.lights.at(si.p, gloss, sampler, smooth, picks)
        towards, shines = mi.Vector3f(dr.normalize(lamp - si.p)), smooth & (dr.max(colour) > 0.0)
        alone = (lamp_pdf <= 0.0) | mi.Bool(asks.lit_faces is None)
        reflected, pdf = bsdf.eval_pdf(context, lit_from(si, lamp, alone, mi.Float(0.0)), si.to_local(towards), shines)
        weight = dr.select(alone | (pdf < LEAST_SHARP), 1.0, mis_weight(lamp_pdf, pdf))
        light = throughput * bands.reflectance(reflected, reading) * asks.groups.light(colour, group)
        free, reach_lamp = asks.shadow_transmittance(si.p, si.n, lamp, sampler, shines & dr.any(light != 0.0))
        light = dr.select(free, light * (weight * reach_lamp), black)
        path, aovs, sums = asks.groups.add_to_path(path, aovs, sums, light, once, group)

        # ---- A lit face that a lobe's direction meets
        if dr.hint(asks.lit_faces is not None, mode="scalar"):
            onward = throughput * bands.reflectance(gain, reading)
            light, group = asks.face_on_lobe(si, bounce, onward, smooth, hit, gloss, picks.total, sampler)
            path, aovs, sums = asks.groups.add_to_path(path, aovs, sums, light, once, group)
        lost += dr.select(is_finite(path), mi.UInt32(0), mi.UInt32(1))
        number += 1
    return Moments(tuple(aovs), tuple(sums), lost)

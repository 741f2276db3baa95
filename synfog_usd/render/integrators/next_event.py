"""Next-event estimation: which light a vertex or a segment asks, and how it is weighed against a direction that meets
the light by itself, in traced code.

The scene's own choice asks sky, sun and few lamps; lamps that are drawn by what they matter to a place
(`render.lights`) are asked along segments in fog and at surfaces.  Both share by the power heuristic what a direction
finds (Veach and Guibas 1995), where a lamp has a face that a ray can meet.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import numpy as np

from synfog_usd.render import backend
from synfog_usd.render.integrators.light_groups import LightGroups
from synfog_usd.render.lights.importance import PICKS, Gloss, Importance, LitFaces, Picks, emitter_index
from synfog_usd.render.lights.panes import Panes
from synfog_usd.render.lights.rows import is_sampled_light
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.lights.sky import SkyTable
from synfog_usd.render.lights.visible import VisibleFaces
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.medium import Medium
from synfog_usd.render.surface import lit_from

MOST_WEIGHED = 240
"""Lamps that are all weighed for each stretch and point; of more, some are drawn by flux and peak."""

LEAST_CHANCE = 0.15
"""Of a lamp and of the scene's own choice to be asked, where both shine: what a surface makes of them is known in short
only."""

SKY_M = 1e6
"""How far away the sky is where a shadow ray asks for it: beyond all that a scene holds."""


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


class NextEvent:
    """The lights of one scene, as its vertices and segments ask them.

    Args:
        loaded, medium: the scene and its fog.
        lights: those that are sampled by where they matter.
            With none of them it is the scene's own choice that is asked, for all other light.
        others: how many other lights there are but the environment.  Where there are none, a scattering in the fog
            sends them no shadow ray: the phase function's own sample finds a sky better.
        groups: the lights' groups and kinds.
        lamp_faces: see `lamp_faces`; None where all light counts.

    Attributes:
        at_surfaces, in_fog: whether vertices there ask the scene's own choice of lights.
        importance: of all lamps to a place; None where they are too few, or more than `MOST_WEIGHED`.
        lit_faces: of lamps that are asked so, which a ray can meet; None without.
        sky: how surfaces choose directions to it; None where the scene's own choice does.
        visible: faces of lamps that the eye sees; None without.
        panes: what shadow rays pass; None without, or without lamps: paths find a sky behind them as well.
    """

    def __init__(
        self,
        loaded: MitsubaScene,
        medium: Medium,
        lights: LightSampler,
        *,
        others: int,
        groups: LightGroups,
        lamp_faces: Any = None,
    ) -> None:
        self.loaded, self.medium, self.lights, self.groups, self.bands = loaded, medium, lights, groups, groups.bands
        self.foggy, self.lamp_faces = medium.foggy, lamp_faces
        sky = loaded.scene.environment() is not None and not lights.count
        self.in_fog = others > 0
        self.at_surfaces = others > 0 or sky
        self.sky = SkyTable.of(loaded) if self.at_surfaces and others == 0 else None
        if self.sky is not None:
            self.sky_group = groups.of(backend.mitsuba().EmitterPtr(self.sky.environment), True)
            dr.make_opaque(self.sky_group)
        weighed = lights.count and lights.many and lights.count <= MOST_WEIGHED
        self.importance = Importance(lights, medium) if weighed else None
        self.lit_faces = LitFaces.of(loaded, lights) if self.importance is not None else None
        self.visible = VisibleFaces.of(loaded) if lights.count else None
        self.panes = Panes.of(loaded) if lights.count else None

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
        """Which lamps to ask about a segment; None where all are asked, or too many to be weighed."""
        if self.importance is None:
            return None
        return self.importance.draw(
            lambda index: self.importance.along(index, ray.o, ray.d, near, stop), sampler, active
        )

    def known_at(self, place: Any, gloss: Gloss, sampler: Any, active: Any) -> Picks:
        """Which lamps to ask about a point of a surface."""
        return self.importance.draw(lambda index: self.importance.at(index, place, gloss), sampler, active)

    def along(
        self, ray: Any, near: Any, stop: Any, throughput: Any, sampler: Any, active: Any, known: Any
    ) -> tuple[Any, Any]:
        """A lamp's light that the fog scatters once into a segment, and the lamp's group."""
        where, lamp, colour, group = self.lights.along(ray.o, ray.d, near, stop, self.medium, sampler, active, known)
        free, reach_lamp = self.shadow_transmittance(
            where, backend.mitsuba().Normal3f(0.0), lamp, active & (dr.max(colour) > 0.0)
        )
        light = dr.select(free, throughput * self.groups.light(colour, group) * reach_lamp, self.bands.black())
        if self.bands.coloured:
            light *= self.bands.scattered() * self.bands.fade(
                self.medium.optical_depth(ray.o, ray.d, 0.0, dr.norm(where - ray.o))
            )
        return light, group

    def sky_row(self, si: Any) -> Any:
        """Row of the sky's table for the side of a surface that is seen; 0 without a table."""
        mi = backend.mitsuba()
        if self.sky is None:
            return mi.UInt32(0)
        return self.sky.row(si.sh_frame.n * dr.select(si.wi.z < 0.0, -1.0, 1.0))

    def own(self, vertex: Any, row: Any, smooth: Any, medium_scattered: Any, sampler: Any) -> Chosen:
        """The sky where it has a table, of which this is the `row`; else a light by the scene's own choice."""
        mi = backend.mitsuba()
        lit = smooth | medium_scattered if self.in_fog else mi.Bool(smooth)
        if self.sky is not None:
            direction, pdf = self.sky.draw(row, sampler.next_2d(lit))
            power = self.sky.radiance(direction, lit) / dr.maximum(pdf, 1e-30)
            place = vertex.p + direction * SKY_M
            return Chosen(lit & (pdf > 0.0), place, direction, power, self.sky_group, pdf, mi.Bool(False))
        sent, power, group = dr.zeros(mi.DirectionSample3f), mi.Color3f(0.0), mi.UInt32(0)
        if self.at_surfaces:
            sent, power = self.loaded.scene.sample_emitter_direction(vertex, sampler.next_2d(lit), False, lit)
            group = self.groups.of(sent.emitter, lit)
        return Chosen(lit & (sent.pdf > 0.0), sent.p, sent.d, power, group, sent.pdf, sent.delta)

    def choose(self, vertex: Any, own: Chosen, gloss: Gloss, picks: Picks, smooth: Any, sampler: Any) -> Chosen:
        """`own`, or one of the lamps that matter to a surface, by what it would make of them."""
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

    def at_surface(
        self, si: Any, bsdf: Any, reading: Any, throughput: Any, sampler: Any, smooth: Any, spread: Any
    ) -> tuple[Any, Any]:
        """A lamp's light on a surface as it is reflected, and the lamp's group."""
        context, black = backend.mitsuba().BSDFContext(), self.bands.black()
        lamp, colour, group, pdf = self.lights.at(si.p, lambda way: dr.abs(dr.dot(si.n, way)) + 1e-3, sampler, smooth)
        free, reach_lamp = self.shadow_transmittance(si.p, si.n, lamp, smooth & (dr.max(colour) > 0.0))
        answering = lit_from(si, lamp, pdf <= 0.0, spread)
        reflected = bsdf.eval(context, answering, si.to_local(dr.normalize(lamp - si.p)), free)
        light = throughput * self.bands.reflectance(reflected, reading) * self.groups.light(colour, group) * reach_lamp
        return dr.select(free, light, black), group

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
        prev_row: Any,
        prev_gloss: Any,
        prev_weighed: Any,
        at_eye: Any,
        lit_apart: Any,
    ) -> tuple[Any, Any]:
        """What the end of a segment sends out itself, by the power heuristic, and its group; not what other
        estimators have, DIRECT of what the eye sees, and LIT where `lit_apart`.
        """
        mi, scene = backend.mitsuba(), self.loaded.scene
        previous = dr.zeros(mi.Interaction3f)
        previous.p = prev_p
        light_pdf = mi.Float(0.0)
        if self.sky is not None:
            light_pdf = dr.select(ended & ~surface_hit, self.sky.density(prev_row, -si.wi), 0.0)
        elif self.at_surfaces:
            light_pdf = scene.pdf_emitter_direction(
                previous, mi.DirectionSample3f(scene, si, previous), ended & ~prev_delta
            )
        weight = dr.select(
            prev_without_nee & (light_pdf > 0.0), 1.0, dr.select(light_pdf > 0.0, mis_weight(prev_pdf, light_pdf), 0.0)
        )
        emitter = si.emitter(scene, ended)
        if self.lit_faces is not None:
            area_pdf, lamp = self.lit_faces.of_emitter(emitter, ended & surface_hit)
            lamp_pdf = self.face_pdf(lamp, area_pdf, si, prev_p, prev_gloss, prev_weighed)
            weight = dr.select((area_pdf > 0.0) & (prev_weighed > 0.0), mis_weight(prev_pdf, lamp_pdf), weight)
        if self.lamp_faces is not None:
            is_lamp = dr.gather(mi.UInt32, self.lamp_faces, dr.reinterpret_array(mi.UInt32, emitter), ended) > 0
            ended &= is_lamp == mi.Bool(self.lights.count > 0)
        weight = dr.select(prev_delta, 1.0, weight)  # else a lamp's face counts here only for the eye and for mirrors
        if self.lit_faces is not None:
            weight = dr.select(lit_apart & (area_pdf > 0.0), 0.0, weight)
        if self.visible is not None:  # the estimator DIRECT has them
            weight = dr.select(self.visible.holds(emitter, ended & surface_hit & at_eye), 0.0, weight)
        group = self.groups.of(emitter, ended)
        return dr.select(
            ended, throughput * weight * self.groups.light(emitter.eval(si, ended), group), self.bands.black()
        ), group

    def shadow_transmittance(self, place: Any, normal: Any, light: Any, active: Any) -> tuple[Any, Any]:
        """(whether nothing but panes stands between a point and a light, transmittance of these and of the fog between:
        one for all bands, or one each).
        """
        mi = backend.mitsuba()
        start = dr.zeros(mi.Interaction3f)
        start.p, start.n = place, normal
        shadow = start.spawn_ray_to(light)
        if self.panes is None:
            free, through = active & ~self.loaded.tree.ray_test(shadow, active), mi.Float(1.0)
        else:
            blocked, _, _, through = self.panes.beyond(self.loaded.tree, shadow, active)
            free = active & ~blocked & (through > 0.0)
        if self.foggy:
            towards = light - place
            length = dr.norm(towards)
            tau = self.medium.optical_depth(place, towards / dr.maximum(length, 1e-12), 0.0, length)
            through *= dr.exp(-tau)
            if self.bands.coloured:
                through = through * self.bands.fade(tau)
        return free, through


def lamp_faces(loaded: MitsubaScene) -> Any:
    """(E,) 1 for each of the scene's own emitters that is the face of a lamp, else 0; by the renderer's index."""
    world = loaded.source.world
    lamps = [
        emitter_index(loaded.shapes[(key,)].emitter())
        for key, part in world.items()
        if is_sampled_light(part) and part["type"] == "mesh" and (key,) in loaded.shapes
    ]
    flags = np.zeros(max([emitter_index(emitter) for emitter in loaded.scene.emitters()], default=0) + 1, np.uint32)
    flags[lamps] = 1
    return backend.numbers(flags)


def mis_weight(pdf: Any, other: Any) -> Any:
    """Weight of a sample by the power heuristic, 0 where its density is 0; a number for every density, since a lamp's
    face that is seen edge-on has an infinite one.
    """
    ratio = other / pdf
    return dr.select((pdf > 0.0) & ~dr.isnan(ratio), dr.rcp(1.0 + ratio * ratio), 0.0)

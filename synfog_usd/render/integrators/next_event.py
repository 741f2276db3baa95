"""Next-event estimation: which light a vertex or a segment asks, and how it is weighed against a direction that meets
the light by itself, in traced code.

The scene's own choice asks sky, sun and few lamps; lamps that are drawn by what they matter to a place
(`render.lights`) are asked along segments in fog and at surfaces.  Both share by the power heuristic what a direction
finds (Veach and Guibas 1995), where a lamp has a face that a ray can meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from synfog_usd.render import backend
from synfog_usd.render.integrators.light_groups import LightGroups
from synfog_usd.render.lights.importance import Gloss, Importance, LitFaces, emitter_index
from synfog_usd.render.lights.panes import Panes
from synfog_usd.render.lights.rows import is_sampled_light
from synfog_usd.render.lights.sampler import MOST_WEIGHED, LightSampler
from synfog_usd.render.lights.sky import SkyTable
from synfog_usd.render.lights.visible import VisibleFaces
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.medium import Medium
from synfog_usd.render.sampling.reservoir import PICKS, Picks
from synfog_usd.render.surface import lit_from

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import (
        BSDFPtr,
        BSDFSample3f,
        Color3f,
        Interaction3f,
        Normal3f,
        Point3f,
        Ray3f,
        Spectrum,
        SurfaceInteraction3f,
        Vector3f,
    )

    from synfog_usd.render.sampling.sobol import Sobol
    from synfog_usd.render.spectra.bands import SampledSpectrum

LEAST_CHANCE = 0.15
"""Of a lamp and of the scene's own choice to be asked, where both shine: what a surface makes of them is known in short
only."""

SKY_M = 1e6
"""How far away the sky is where a shadow ray asks for it: beyond all that a scene holds."""


LEAST_SHARP = 2.0
"""Density [1/sr] of a first surface's direction below which no lamp is looked for along it: shadow rays find those as
well.
"""


@dataclass
class Chosen:
    """A light that a vertex asks.

    Attributes:
        exists: whether there is one.
        place, direction: where it is, and the unit direction towards it.
        power: its radiance over the density of the choice.
        group: number of its light group.
        pdf: the density [1/sr] with which its direction is weighed against one that the surface draws.
        alone: no other way finds it.
    """

    exists: Bool
    place: Point3f
    direction: Vector3f
    power: Color3f | Spectrum
    group: UInt32
    pdf: Float
    alone: Bool

    def where(self, mask: Bool, instead: Chosen) -> Chosen:
        """This one where `mask`, else another."""
        pairs = ((getattr(self, field.name), getattr(instead, field.name)) for field in fields(self))
        return Chosen(*(dr.select(mask, *pair) for pair in pairs))


@dataclass
class Previous:
    """The vertex before a segment, and how it chose the segment's direction.

    Attributes:
        p: where it is.
        pdf: density [1/sr] of the direction.
        delta: it could choose no other: the eye, a mirror.
        without_nee: it sent no shadow ray.
        row: of the sky's table.
        gloss, weighed: how it answers lamps, and the sum of all their weights there; 0 where none was drawn.
    """

    p: Point3f
    pdf: Float
    delta: Bool
    without_nee: Bool
    row: UInt32
    gloss: Gloss
    weighed: Float


class NextEvent:
    """The lights of one scene, as its vertices and segments ask them.

    Args:
        loaded, medium: the scene and its fog.
        lights: those that are sampled by where they matter.
            With none of them it is the scene's own choice that is asked, for all other light.
        other_lights: how many other lights there are but the environment.  Where there are none, a scattering in the
            fog sends them no shadow ray: the phase function's own sample finds a sky better.
        groups: the lights' groups and kinds.
        lamp_faces: see `lamp_faces`; None where all light counts.

    Attributes:
        at_surfaces, in_fog: whether vertices there ask the scene's own choice of lights.
        importance: of all lamps to a place; None where they are too few, or more than `MOST_WEIGHED`.
        faces: of lamps, which a ray can meet; None without.
        lit_faces: the same where their lamps are asked by importance; else None.
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
        other_lights: int,
        groups: LightGroups,
        lamp_faces: UInt32 | None = None,
    ) -> None:
        self.loaded, self.medium, self.lights, self.groups, self.bands = loaded, medium, lights, groups, groups.bands
        self.foggy, self.lamp_faces = medium.foggy, lamp_faces
        sky = loaded.scene.environment() is not None and not lights.count
        self.in_fog = other_lights > 0
        self.at_surfaces = other_lights > 0 or sky
        self.sky = SkyTable.of(loaded) if self.at_surfaces and other_lights == 0 else None
        if self.sky is not None:
            self.sky_group = groups.of(backend.mitsuba().EmitterPtr(self.sky.environment), True)
            dr.make_opaque(self.sky_group)
        weighed = lights.count and lights.many and lights.count <= MOST_WEIGHED
        self.importance = Importance(lights, medium) if weighed else None
        self.faces = LitFaces.of(loaded, lights) if lights.count else None
        self.lit_faces = self.faces if self.importance is not None else None
        self.visible = VisibleFaces.of(loaded, lights) if lights.count else None
        self.panes = Panes.of(loaded) if lights.count else None

    def face_pdf(
        self, lamp: UInt32, area_pdf: Float, end: SurfaceInteraction3f, place: Point3f, gloss: Gloss, weighed: Float
    ) -> Float:
        """Density [1/sr] with which a surface at `place` draws a point of a lamp's face as one of `PICKS`.

        Args:
            lamp, area_pdf: number of the lamp, and one over the area of its faces [1/m2].
            end: the point.
            gloss, weighed: how the surface answers lamps, and the sum of all their weights there.
        """
        assert self.importance is not None
        chance = PICKS * self.importance.at(lamp, place, gloss) / dr.maximum(weighed, 1e-30)
        cosine = dr.abs(dr.dot(backend.mitsuba().Vector3f(end.n), end.to_world(end.wi)))
        return chance * area_pdf * dr.squared_norm(end.p - place) / dr.maximum(cosine, 1e-6)

    def picks_along(self, ray: Ray3f, near: Float, stop: Float, sampler: Sobol, active: Bool) -> Picks | None:
        """Which lamps to ask about a segment; None where all are asked, or too many to be weighed."""
        if self.importance is None:
            return None
        along = self.importance.along
        return self.importance.draw(lambda index: along(index, ray.o, ray.d, near, stop), sampler, active)

    def picks_at(self, place: Point3f, gloss: Gloss, sampler: Sobol, active: Bool) -> Picks:
        """Which lamps to ask about a point of a surface."""
        assert self.importance is not None
        at = self.importance.at
        return self.importance.draw(lambda index: at(index, place, gloss), sampler, active)

    def along(
        self,
        ray: Ray3f,
        near: Float,
        stop: Float,
        throughput: SampledSpectrum,
        sampler: Sobol,
        active: Bool,
        picks: Picks | None,
    ) -> tuple[SampledSpectrum, UInt32]:
        """A lamp's light that the fog scatters once into a segment, and the lamp's group."""
        where, lamp, colour, group = self.lights.along(ray.o, ray.d, near, stop, self.medium, sampler, active, picks)
        free, reach_lamp = self.shadow_transmittance(
            where, backend.mitsuba().Normal3f(0.0), lamp, sampler, active & (dr.max(colour) > 0.0)
        )
        if self.medium.grids:
            reach_lamp *= self.medium.gap(ray.o, ray.d, near, dr.norm(where - ray.o), sampler, free)
        light = dr.select(free, throughput * self.groups.light(colour, group) * reach_lamp, self.bands.black())
        if self.bands.coloured:
            light *= self.bands.scattered(self.medium, where) * self.bands.fade(
                self.medium.optical_depth(ray.o, ray.d, 0.0, dr.norm(where - ray.o))
            )
        return light, group

    def sky_row(self, si: SurfaceInteraction3f) -> UInt32:
        """Row of the sky's table for the side of a surface that is seen; 0 without a table."""
        mi = backend.mitsuba()
        if self.sky is None:
            return mi.UInt32(0)
        return self.sky.row(si.sh_frame.n * dr.select(si.wi.z < 0.0, -1.0, 1.0))

    def scene_choice(
        self, vertex: Interaction3f, row: UInt32, smooth: Bool, medium_scattered: Bool, sampler: Sobol
    ) -> Chosen:
        """The sky where it has a table, of which this is the `row`; else a light by the scene's own choice."""
        mi = backend.mitsuba()
        lit = smooth | medium_scattered if self.in_fog else mi.Bool(smooth)
        power: Color3f | Spectrum = mi.Color3f(0.0)
        if self.sky is not None:
            direction, pdf = self.sky.draw(row, sampler.next_2d(lit))
            power = self.sky.radiance(direction, lit) / dr.maximum(pdf, 1e-30)
            place = mi.Point3f(vertex.p) + direction * SKY_M
            return Chosen(lit & (pdf > 0.0), place, direction, power, self.sky_group, pdf, mi.Bool(False))
        sent, group = dr.zeros(mi.DirectionSample3f), mi.UInt32(0)
        if self.at_surfaces:
            sent, power = self.loaded.scene.sample_emitter_direction(vertex, sampler.next_2d(lit), False, lit)
            group = self.groups.of(sent.emitter, lit)
        return Chosen(lit & (sent.pdf > 0.0), sent.p, sent.d, power, group, sent.pdf, sent.delta)

    def choose(
        self, vertex: Interaction3f, choice: Chosen, gloss: Gloss, picks: Picks, smooth: Bool, sampler: Sobol
    ) -> Chosen:
        """`choice`, or one of the lamps that matter to a surface, by what it would make of them."""
        mi = backend.mitsuba()
        lamp, colour, group, pdf = self.lights.at(vertex.p, gloss, sampler, smooth, picks)
        towards = mi.Vector3f(dr.normalize(lamp - vertex.p))
        from_lamp = dr.select(smooth, mi.luminance(colour) * gloss(towards), 0.0)
        from_scene = dr.select(choice.exists, mi.luminance(choice.power) * gloss(choice.direction), 0.0)
        share = dr.select(from_scene > 0.0, from_scene / dr.maximum(from_scene + from_lamp, 1e-30), 0.0)
        share = dr.select(
            (from_scene > 0.0) & (from_lamp > 0.0), dr.clip(share, LEAST_CHANCE, 1.0 - LEAST_CHANCE), share
        )
        choice.power = choice.power / dr.maximum(share, 1e-30)
        colour = colour / dr.maximum(1.0 - share, 1e-30)
        alone = (pdf <= 0.0) | mi.Bool(self.lit_faces is None)
        lamps = Chosen(from_lamp > 0.0, lamp, towards, colour, group, pdf, alone)
        return choice.where(sampler.next_1d(choice.exists | smooth) < share, lamps)

    def at_surface(
        self,
        si: SurfaceInteraction3f,
        bsdf: BSDFPtr,
        reading: Sequence[Float] | None,
        throughput: SampledSpectrum,
        sampler: Sobol,
        smooth: Bool,
        spread: Float,
    ) -> tuple[SampledSpectrum, UInt32]:
        """A lamp's light on a surface as it is reflected, and the lamp's group."""
        mi, black = backend.mitsuba(), self.bands.black()
        normal = mi.Vector3f(si.n)
        lamp, colour, group, pdf = self.lights.at(si.p, lambda way: dr.abs(dr.dot(normal, way)) + 1e-3, sampler, smooth)
        free, reach_lamp = self.shadow_transmittance(si.p, si.n, lamp, sampler, smooth & (dr.max(colour) > 0.0))
        answering = lit_from(si, lamp, pdf <= 0.0, spread)
        reflected = bsdf.eval(mi.BSDFContext(), answering, si.to_local(mi.Vector3f(dr.normalize(lamp - si.p))), free)
        light = throughput * self.bands.reflectance(reflected, reading) * self.groups.light(colour, group) * reach_lamp
        return dr.select(free, light, black), group

    def emitted(
        self,
        si: SurfaceInteraction3f,
        unscattered: Bool,
        surface_hit: Bool,
        throughput: SampledSpectrum,
        previous: Previous,
        at_eye: Bool,
        lit_apart: Bool,
    ) -> tuple[SampledSpectrum, UInt32]:
        """What the end of a segment sends out itself, by the power heuristic, and its group; not what other
        estimators have, DIRECT of what the eye sees, and LIT where `lit_apart`.
        """
        mi, scene = backend.mitsuba(), self.loaded.scene
        vertex = dr.zeros(mi.Interaction3f)
        vertex.p = previous.p
        light_pdf = mi.Float(0.0)
        if self.sky is not None:
            light_pdf = dr.select(unscattered & ~surface_hit, self.sky.density(previous.row, -si.wi), 0.0)
        elif self.at_surfaces:
            light_pdf = scene.pdf_emitter_direction(
                vertex, mi.DirectionSample3f(scene, si, vertex), unscattered & ~previous.delta
            )
        shared = dr.select(light_pdf > 0.0, mis_weight(previous.pdf, light_pdf), 0.0)
        weight = dr.select(previous.without_nee & (light_pdf > 0.0), 1.0, shared)
        emitter = si.emitter(scene, unscattered)
        if self.faces is not None:
            area_pdf, lamp = self.faces.of_face(emitter, si.prim_index, unscattered & surface_hit)
        if self.lit_faces is not None:
            lamp_pdf = self.face_pdf(lamp, area_pdf, si, previous.p, previous.gloss, previous.weighed)
            weight = dr.select((area_pdf > 0.0) & (previous.weighed > 0.0), mis_weight(previous.pdf, lamp_pdf), weight)
        if self.lamp_faces is not None:
            is_lamp = dr.gather(mi.UInt32, self.lamp_faces, backend.indices_of(emitter), unscattered) > 0
            unscattered &= is_lamp == mi.Bool(self.lights.count > 0)
        weight = dr.select(
            previous.delta, 1.0, weight
        )  # else a lamp's face counts here only for the eye and for mirrors
        if self.lit_faces is not None:
            weight = dr.select(lit_apart & (area_pdf > 0.0), 0.0, weight)
        if self.visible is not None:  # the estimator DIRECT has them
            weight = dr.select(self.visible.holds(lamp, (area_pdf > 0.0) & at_eye), 0.0, weight)
        group = self.groups.of(emitter, unscattered)
        return dr.select(
            unscattered,
            throughput * weight * self.groups.light(emitter.eval(si, unscattered), group),
            self.bands.black(),
        ), group

    def face_on_lobe(
        self,
        si: SurfaceInteraction3f,
        bounce: BSDFSample3f,
        onward: SampledSpectrum,
        smooth: Bool,
        hit: Bool,
        gloss: Gloss,
        weighed: Float,
        sampler: Sobol,
    ) -> tuple[SampledSpectrum, UInt32]:
        """Light of a lit face that a lobe's direction meets, by the power heuristic, and its group.

        Args:
            si, bounce: the surface, and the direction that its lobes draw.
            onward: what the path leaves of light from there.
            smooth, hit: whether it has other parts than mirrors, and whether it is there.
            gloss, weighed: as in `face_pdf`.
        """
        mi, tree = backend.mitsuba(), self.loaded.tree
        assert self.lit_faces is not None
        no_choice = ~smooth | mi.has_flag(bounce.sampled_type, mi.BSDFFlags.Delta)
        way = si.spawn_ray(si.to_world(bounce.wo))
        going = hit & (dr.max(onward) > 0.0) & (no_choice | (bounce.pdf >= LEAST_SHARP))
        last, through = way, mi.Float(1.0)
        if self.panes is not None:
            stopped, surface, last, through = self.panes.beyond(tree, way, going)
        else:
            surface = tree.ray_intersect_preliminary(way, mi.Bool(False), going)
            stopped = going & surface.is_valid()
        emitter = surface.shape.emitter()
        area_pdf, of_lamp = self.lit_faces.of_face(emitter, surface.prim_index, stopped)
        on_lamp = area_pdf > 0.0
        end = surface.compute_surface_interaction(last, mi.RayFlags.All, on_lamp)
        lamp_pdf = self.face_pdf(of_lamp, area_pdf, end, si.p, gloss, weighed)
        weight = dr.select(no_choice, 1.0, mis_weight(bounce.pdf, lamp_pdf))
        group = self.groups.of(emitter, on_lamp)
        light = onward * (weight * through) * self.groups.light(emitter.eval(end, on_lamp), group)
        if self.foggy:
            length = dr.select(on_lamp, dr.norm(end.p - way.o), 0.0)
            clear, tau = self.medium.transmittance(way.o, way.d, 0.0, length, sampler, on_lamp)
            light *= clear
            if self.bands.coloured:
                light *= self.bands.fade(tau)
        return dr.select(on_lamp, light, self.bands.black()), group

    def shadow_transmittance(
        self, place: Point3f, normal: Normal3f, light: Point3f, sampler: Sobol, active: Bool
    ) -> tuple[Bool, Float | SampledSpectrum]:
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
            towards = mi.Vector3f(light - place)
            length = dr.norm(towards)
            way = towards / dr.maximum(length, 1e-12)
            clear, tau = self.medium.transmittance(place, way, 0.0, length, sampler, free)
            through *= clear
            if self.bands.coloured:
                through = through * self.bands.fade(tau)
        return free, through


def lamp_faces(loaded: MitsubaScene) -> UInt32:
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


def mis_weight(pdf: Float, alternative: Float) -> Float:
    """Weight of a sample by the power heuristic, 0 where its density is 0; a number for every density, since a lamp's
    face that is seen edge-on has an infinite one.
    """
    ratio = alternative / pdf
    return dr.select((pdf > 0.0) & ~dr.isnan(ratio), dr.rcp(1.0 + ratio * ratio), 0.0)

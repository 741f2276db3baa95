"""How much each of many lights matters to a stretch of a ray or to a point, in short, and a draw of a few by it.

A light is a place, a peak and an octahedral table of what it sends where, or of what the fog scatters out of its
brightest parts, whichever is more.  To a stretch of a ray in fog it matters as the phase function's peak over the
angles by which its light must turn, over its distance from the ray; to a point as the inverse square, times what a
surface there makes of it.  All lights are asked in one loop, two gathers and an exponential each, and `PICKS` of them
are drawn (weighted reservoirs, Chao 1982).  Shadows are not known to it, and no weight is 0, so what it has wrong is
noise and no bias.

All of the stretch counts.  If lights were drawn by what matters to one random point of it, a light near another part
would have hardly any chance.  At dusk in fog that was most of all variance.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.render import backend
from synfog_usd.render.lights.rows import summaries
from synfog_usd.render.media.medium import Medium
from synfog_usd.render.sampling.reservoir import Picks

if TYPE_CHECKING:
    import numpy.typing as npt
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Emitter, EmitterPtr, Point3f, Spectrum, SurfaceInteraction3f, Vector3f

    from synfog_usd.render.lights.sampler import LightSampler
    from synfog_usd.render.load import MitsubaScene
    from synfog_usd.render.sampling.sobol import Sobol

SIDE = 32
"""Texels along each side of a light's octahedral table (Cigolle et al. 2014); 5 degrees."""

FLOOR = 0.004
"""Least share of its peak that a light is taken to send anywhere."""

FLOOR_M = 2.0
"""Nearer than this the floor stays: else a light would take every draw beside its own housing."""

ABREAST = 2
"""Lights that are weighed beside each other: one alone leaves a processor waiting for its roots and quotients.

More than two gain little.
"""

NEAR_M = 0.1
"""Lights are taken to be this far at least from a point."""

SCATTERED = 0.5
"""Of what the fog scatters out of a light's brightest parts, the share that counts."""

ALWAYS = 1e-6
"""What is added to the share of the peak, so that rounding leaves no light out."""

MATTE, LEAST = 0.1, 0.005
"""Reflectance over pi of a surface's matte share, and what it sends anywhere, in short."""

ROW = 16
"""Numbers of a light: place, peak, axis, begin of its table, the table's +X."""


class Importance:
    """All lights of a scene, a row each.

    Args:
        lights: the scene's.
        medium: the fog.
    """

    def __init__(self, lights: LightSampler, medium: Medium) -> None:
        mi = backend.mitsuba()
        rows = summaries(lights.rows)
        angle = np.linspace(0.0, np.pi, 721)
        value = np.full_like(angle, 1.0 / (4.0 * np.pi))
        if medium.foggy:
            cosine = mi.Float(np.cos(angle).astype(np.float32))
            value = np.mean([np.array(phase.value(cosine), dtype=np.float64) for phase in medium.phases], axis=0)
        beyond = np.r_[np.cumsum((0.5 * (value[1:] + value[:-1]) * np.diff(angle))[::-1])[::-1], 0.0]
        scattered = np.maximum(beyond, 1e-3 * beyond[0]) / np.interp(0.05, angle, beyond)
        kinds: dict[tuple[Any, ...], int] = {}
        sent: list[Array] = []
        for row in rows:
            if (kind := _kind(row)) not in kinds:
                kinds[kind] = len(sent)
                sent.append(_sent(row, lights.tables))
        axis = rows["axis"] / np.linalg.norm(rows["axis"], axis=1, keepdims=True)
        begin = np.array([kinds[_kind(row)] * SIDE**2 for row in rows], dtype=np.float64)
        packed = np.zeros((len(rows), ROW))
        packed[:, 0:3], packed[:, 3], packed[:, 4:7], packed[:, 7] = rows["position"], rows["peak"], axis, begin
        packed[:, 8:11] = [_across(of_light, x) for of_light, x in zip(axis, rows["table_x"], strict=True)]
        self.data = backend.floats(packed.ravel())
        spread = _scattered_by_fog(sent, angle, scattered)
        self.tables = backend.floats(np.concatenate([table.ravel() for table in (*sent, *spread)]))
        self.spread = dr.opaque(mi.UInt32, SIDE**2 * len(sent))
        self.count = dr.opaque(mi.UInt32, len(rows))
        self.sigma_t = medium.media[0].mean_sigma_t if medium.foggy else dr.opaque(mi.Float, 0.0)
        self.width = lights.width

    def along(self, index: UInt32, origin: Point3f, direction: Vector3f, begin: Float, end: Float) -> Float:
        """Weight of a light for a stretch of a ray, begin to end [m]."""
        light, peak, axis, table, x = self._row(index)
        nearest = dr.dot(backend.mitsuba().Vector3f(light - origin), direction)
        foot = origin + direction * nearest - light
        square = dr.maximum(dr.squared_norm(foot), 1e-6)
        inverse = dr.rsqrt(square)
        # light must turn by angles whose versine 1 - cos grows along the ray; the peak's share of them in closed form
        low, high = begin - nearest, end - nearest
        low2 = dr.maximum(2.0 + 2.0 * low * dr.rsqrt(square + low * low), 0.0)
        high2 = dr.maximum(2.0 + 2.0 * high * dr.rsqrt(square + high * high), 0.0)
        width2 = self.width * self.width
        a, b = dr.sqrt(low2 / (width2 + low2)), dr.sqrt(high2 / (width2 + high2))
        middle = dr.square(0.5 * (a + b))
        chord2 = dr.clip(width2 * middle / dr.maximum(1.0 - middle, 1e-6), 1e-8, 3.9999)
        cosine, sine = 1.0 - 0.5 * chord2, dr.sqrt(chord2 * (1.0 - 0.25 * chord2))
        towards = foot * (inverse * sine) - direction * cosine
        away = 1.0 / (inverse * dr.maximum(sine, 1e-5))
        along = dr.maximum(nearest - cosine * away - begin, 0.0)
        share = dr.maximum(b - a, 0.0) + 0.05 * dr.maximum(dr.sqrt(high2) - dr.sqrt(low2), 0.0) + ALWAYS
        dimmed = dr.exp(-self.sigma_t * dr.minimum(away + along, 1e4))
        return peak * inverse * share * (self._sent(axis, x, table + self.spread, towards) + FLOOR) * dimmed

    def at(self, index: UInt32, place: Point3f, response: Callable[[Vector3f], Float]) -> Float:
        """Weight of a light for a point; `response` tells what a surface there makes of light from a direction towards
        it.
        """
        light, peak, axis, table, x = self._row(index)
        between = backend.mitsuba().Vector3f(place - light)
        true = dr.maximum(dr.squared_norm(between), 1e-8)
        square, floored = dr.maximum(true, NEAR_M**2), dr.maximum(true, FLOOR_M**2)
        away = between * dr.rsqrt(true)
        sent = self._sent(axis, x, table, away)
        return peak * dr.exp(-self.sigma_t * dr.sqrt(square)) * (sent / square + FLOOR / floored) * response(-away)

    @dr.syntax
    def draw(self, weigh: Callable[[UInt32], Float], sampler: Sobol, active: Bool) -> Picks:
        """`PICKS` lights, independently, each in proportion to its weight `weigh(index)` >= 0."""
        mi = backend.mitsuba()
        picks, index = Picks(), mi.UInt32(0)
        picks.u = mi.Vector4f(
            sampler.next_1d(active), sampler.next_1d(active), sampler.next_1d(active), sampler.next_1d(active)
        )
        while active & (index < self.count):
            for number, there in self.abreast(index):
                picks = picks.update(number, mi.Float(dr.select(there, dr.maximum(weigh(number), 0.0), 0.0)))
            index += ABREAST
        return picks

    def abreast(self, index: UInt32) -> list[tuple[UInt32, Bool]]:
        """Numbers of `ABREAST` lights from `index` on, and whether there are so many."""
        numbers = [index + step for step in range(ABREAST)]
        return [(dr.minimum(number, self.count - 1), number < self.count) for number in numbers]

    def _row(self, index: UInt32) -> tuple[Point3f, Float, Vector3f, UInt32, Vector3f]:
        mi = backend.mitsuba()
        first, second, third = (dr.gather(mi.Vector4f, self.data, index * (ROW // 4) + part) for part in range(3))
        return (
            mi.Point3f(first[0], first[1], first[2]),
            first[3],
            mi.Vector3f(second[0], second[1], second[2]),
            mi.UInt32(second[3]),
            mi.Vector3f(third[0], third[1], third[2]),
        )

    def _sent(self, axis: Vector3f, x: Vector3f, begin: UInt32, direction: Vector3f) -> Float:
        """Share of its peak that a light sends in a direction, from its texel of the octahedron."""
        mi = backend.mitsuba()
        z = dr.dot(axis, direction)
        u, v = dr.dot(x, direction), dr.dot(dr.cross(axis, x), direction)
        scale = dr.rcp(dr.abs(u) + dr.abs(v) + dr.abs(z))
        u, v = u * scale, v * scale
        folded_u, folded_v = dr.copysign(1.0 - dr.abs(v), u), dr.copysign(1.0 - dr.abs(u), v)
        u, v = mi.Float(dr.select(z < 0.0, folded_u, u)), mi.Float(dr.select(z < 0.0, folded_v, v))
        column, row = (dr.clip(mi.UInt32(dr.maximum((w * 0.5 + 0.5) * SIDE, 0.0)), 0, SIDE - 1) for w in (u, v))
        return dr.gather(mi.Float, self.tables, begin + row * SIDE + column)


class Gloss:
    """What a surface makes of light, in short: a matte share, and a GGX lobe as high as the BSDF is in the mirror's
    direction.

    Attributes:
        normal: of the surface.
        wi: unit direction towards whoever looks.
        peak: BSDF x cosine [1/sr] in the mirror's direction.
        alpha2: square of the roughness that a lobe of the BSDF's density there has.
    """

    DRJIT_STRUCT: ClassVar[dict[str, type]] = {}

    def __init__(self) -> None:
        mi = backend.mitsuba()
        type(self).DRJIT_STRUCT = {"normal": mi.Normal3f, "wi": mi.Vector3f, "peak": mi.Float, "alpha2": mi.Float}
        self.normal, self.wi, self.peak, self.alpha2 = mi.Normal3f(0.0), mi.Vector3f(0.0), mi.Float(0.0), mi.Float(1.0)

    @classmethod
    def of(cls, si: SurfaceInteraction3f, value: Spectrum, pdf: Float, active: Bool) -> Gloss:
        """A surface's, from value x cosine and density [1/sr] of its BSDF in the mirror's direction; where not `active`
        it answers all light alike.
        """
        mi = backend.mitsuba()
        gloss = cls()
        gloss.normal = dr.select(active, mi.Normal3f(si.sh_frame.n), mi.Normal3f(0.0))
        gloss.wi = dr.select(active, si.to_world(si.wi), mi.Vector3f(0.0))
        gloss.peak = dr.select(active, mi.luminance(value), 0.0)
        gloss.alpha2 = dr.select(active, 1.0 / dr.maximum(4.0 * dr.pi * pdf * dr.abs(si.wi.z), 1.0), 1.0)
        return gloss

    def __call__(self, way: Vector3f) -> Float:
        """Of light from a unit direction towards it; above 0 everywhere."""
        half = dr.normalize(self.wi + way)
        cosine2 = dr.maximum(dr.square(dr.dot(half, self.normal)), 1e-6)
        out, into = dr.dot(self.normal, way), dr.dot(self.normal, self.wi)
        lobe = self.peak / dr.square(1.0 + (1.0 - cosine2) / (cosine2 * self.alpha2))
        return MATTE * dr.abs(out) + LEAST + dr.select(out * into > 0.0, lobe, 0.0)

    def where(self, mask: Bool, instead: Gloss) -> Gloss:
        """This one where `mask`, else another."""
        after = Gloss()
        for name in self.DRJIT_STRUCT:
            setattr(after, name, dr.select(mask, getattr(self, name), getattr(instead, name)))
        return after


class LitFaces:
    """Which of the scene's emitters are lit faces that `LightSampler` holds, for what meets one by chance.

    Args:
        first: emitter's index -> number of its first face here.
        lamp: (F,) number of each face's lamp.
        per_area: (F,) one over the area of that lamp's faces [1/m2]; 0 of what is no such face.
    """

    def __init__(self, first: npt.ArrayLike, lamp: Indices, per_area: Array) -> None:
        self.first, self.lamp, self.per_area = backend.numbers(first), backend.numbers(lamp), backend.floats(per_area)

    @classmethod
    def of(cls, loaded: MitsubaScene, lights: LightSampler) -> LitFaces | None:
        """A scene's; None where it has none."""
        first: dict[int, int] = {}
        lamp, per_area = [np.zeros(1, dtype=np.int64)], [np.zeros(1)]
        begin = 1  # face 0 is that of all other emitters
        for number, (key, rows, faces) in enumerate(zip(lights.keys, lights.rows, lights.row_numbers, strict=True)):
            emitter = loaded.shapes[(key,)].emitter() if (key,) in loaded.shapes else None
            if emitter is None:
                continue
            index = emitter_index(emitter)
            if index not in first:
                first[index], count = begin, len(loaded.source.world[key]["faces"])
                lamp.append(np.zeros(count, dtype=np.int64))
                per_area.append(np.zeros(count))
                begin += count
            lamp[-1][faces] = number
            per_area[-1][faces] = 2.0 / np.linalg.norm(np.cross(rows["edge_u"], rows["edge_v"]), axis=1).sum()
        if not first:
            return None
        begins = np.zeros(max([*first, *map(emitter_index, loaded.scene.emitters())]) + 1, dtype=np.uint32)
        begins[list(first)] = list(first.values())
        return cls(begins, np.concatenate(lamp), np.concatenate(per_area))

    def of_face(self, emitter: EmitterPtr, face: UInt32, active: Bool) -> tuple[Float, UInt32]:
        """(one over the area of the lamp that has a face [1/m2], 0 where there is none; that lamp's number)."""
        mi = backend.mitsuba()
        first = dr.gather(mi.UInt32, self.first, backend.indices_of(emitter), active)
        at = dr.select(first > 0, first + face, 0)
        return dr.select(active, dr.gather(mi.Float, self.per_area, at, active), 0.0), dr.gather(
            mi.UInt32, self.lamp, at, active
        )


def emitter_index(emitter: Emitter) -> int:
    """The number by which kernels know an emitter."""
    return backend.index_of(backend.mitsuba().EmitterPtr(emitter))


def _kind(row: np.void) -> tuple[Any, ...]:
    """What lights that share a table of directions have in common."""
    if row["table"] >= 0.0:
        return "table", int(row["table"])
    return "beam" if row["is_beam"] > 0.5 else "cosine", round(row["cutoff"], 4), round(row["slope"], 3)


def _across(axis: Array, x: Array) -> Array:
    """A unit vector across the axis, nearest to `x` where that is one."""
    if np.linalg.norm(x) < 0.5:
        x = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    x = x - axis * (x @ axis)
    return np.asarray(x / np.linalg.norm(x))


def _directions() -> Array:
    """(SIDE, SIDE, 16, 3) directions within the texels of the octahedron, rows along its second coordinate."""
    sub = 4
    at = (np.arange(SIDE * sub) + 0.5) / (SIDE * sub) * 2.0 - 1.0
    v, u = np.meshgrid(at, at, indexing="ij")
    z = 1.0 - np.abs(u) - np.abs(v)
    folded_u, folded_v = np.copysign(1.0 - np.abs(v), u), np.copysign(1.0 - np.abs(u), v)
    ways = np.stack([np.where(z < 0.0, folded_u, u), np.where(z < 0.0, folded_v, v), z], axis=-1)
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    return ways.reshape(SIDE, sub, SIDE, sub, 3).transpose(0, 2, 1, 3, 4).reshape(SIDE, SIDE, sub * sub, 3)


def _sent(row: np.void, tables: list[Array]) -> Array:
    """(SIDE, SIDE) mean share of its peak that a light sends through each texel of its own frame."""
    ways = _directions()
    polar = np.arccos(np.clip(ways[..., 2], -1.0, 1.0))
    if row["table"] >= 0.0:
        table = tables[int(row["table"])]
        around = np.arctan2(ways[..., 1], ways[..., 0]) / (2.0 * np.pi) % 1.0 * table.shape[1]
        share = table[
            np.round(polar / np.pi * (table.shape[0] - 1)).astype(int), np.round(around).astype(int) % table.shape[1]
        ]
    elif row["is_beam"] > 0.5:
        share = np.clip((row["cutoff"] - polar) * row["slope"], 0.0, 1.0)
    else:
        share = np.maximum(np.cos(polar), 0.0)
    return np.asarray(share.mean(axis=-1))


def _scattered_by_fog(sent: list[Array], angle: Array, scattered: Array) -> list[Array]:
    """The same tables, or `scattered` at `angle` [rad] of their brightest parts, whichever is more."""
    apart, which = _apart()
    share = np.interp(apart, angle, scattered)[which]
    return [
        np.maximum(table, SCATTERED * (table.ravel()[None] * share).max(axis=1).reshape(table.shape)) for table in sent
    ]


@functools.lru_cache(maxsize=1)
def _apart() -> tuple[Array, Array]:
    """Angles between the middles of texels [rad], each once, and (N, N) which of them lies between two texels."""
    centre = _directions().mean(axis=2).reshape(-1, 3)
    centre /= np.linalg.norm(centre, axis=1, keepdims=True)
    angles = np.clip(np.arccos(np.clip(centre @ centre.T, -1.0, 1.0)), 0.05, np.pi)
    apart, which = np.unique(angles, return_inverse=True)
    return apart, which.reshape(angles.shape).astype(np.int32)

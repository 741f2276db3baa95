"""Lamps in uniform fog, with what they scatter more than once from a table.

Takes a loaded scene; gives the integrator of the model `glow`.  A camera ray sees
the light that the fog scatters between the eye and the surface: what all of the
fog would show at the eye, less what it would show at the surface in the same
direction, dimmed by the fog between (`fog.glow`, Narasimhan and Nayar 2003).

    surface             paths of `path` that the fog scatters once at most, and lamps' light
                        that the fog scattered more often, on diffuse surfaces without shadows
    airlight_single     the same paths, with beams and shadows as they are
    airlight_multiple   from the table: no shadows, and as if the fog had no end

The table is of an isotropic lamp.  Another one counts with its intensity towards
the eye (and towards the surface), blurred by the phase function twice, as its light
is on the least way that the table is for: P_l of the intensity times chi_l^2.
Measured for spots of 20 and 60 degrees at tau 0.5, 2 and 5, g = 0.87: in sum over a view
of 120 degrees the light that was scattered more than once is right to a factor of 1.6 up to
100 degrees off the axis (blurred once: 3), and a quarter to two thirds of it behind the lamp.
It is spread too evenly: the median pixel is 2 to 7 times too bright, beside a narrow beam 20 times.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import drjit as dr
import numpy as np

from synfog_usd.arrays import Array
from synfog_usd.colour import LUMINANCE
from synfog_usd.errors import ParameterError
from synfog_usd.fog.glow import NORMAL_COLUMNS, TAU, TAU_ROWS, THETA_COLUMNS, glow_table
from synfog_usd.progress import Progress, silent
from synfog_usd.render import backend
from synfog_usd.render.film.accumulator import CHUNKED_LANES, MULTIPLE, SINGLE, SURFACE, Accumulator, Estimator
from synfog_usd.render.integrators.path import FogPath, Truncation
from synfog_usd.render.lights import photometric
from synfog_usd.render.lights.rows import is_sampled_light, lamp_rows
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.load import LIGHTS, MitsubaScene
from synfog_usd.render.media.medium import Medium
from synfog_usd.render.sampling.sobol import Sobol
from synfog_usd.scene import SceneDict
from synfog_usd.seeds import seed32

Single = Literal["traced", "table"]

PART = "glow"

RAYS = 16
"""Most rays a pixel through which the table is read; it is smooth, and only edges and lamps need more than one."""

SKY_SHARE = 0.05
"""Most light of a sky, as a share of the lamps' mean radiance at the eye: what a sky adds to the airlight is left
out.
"""

SKIES = ("constant", "envmap")
SOLIDS = ("sphere", "rectangle", "disk")

BEAM_ORDERS = 64
BEAM_ANGLES = 129
"""Nodes of a lamp's blurred intensity, even in the angle off its axis."""

SHARPEST = 1e-3
"""Half the least angle [sin] under which light scattered once is seen beside a lamp; nearer, it is the lamp itself that
one sees.
"""

_HEADER = 10
"""Numbers of a lamp before its blurred intensity: position, axis, colour, whether its light scattered once is from the
table.
"""

_STRIDE = _HEADER + BEAM_ANGLES


def glow_refuses(scene: SceneDict) -> str:
    """Why a scene is outside of the model's domain, or ''."""
    if backend.is_scalar():
        return "it needs LLVM or CUDA"
    fog = [volume for volume in scene.fog if volume.medium.sigma_t_per_m > 0.0]
    if len(fog) != 1 or len(scene.fog) != 1:
        return f"it takes one fog volume, and there are {len(scene.fog)}"
    if fog[0].boundary.kind == "mesh":
        return f"the boundary {fog[0].path} is a mesh, not a box or a sphere"
    if fog[0].medium.profile != "uniform":
        return f"the fog {fog[0].path} is not uniform"
    if not fog[0].boundary.contains(scene.camera.to_world[:3, 3])[0]:
        return "the camera is outside of the fog"
    lamps = []
    for key, part in scene.world.items():
        if (
            isinstance(part, Mapping)
            and ("emitter" in part or part.get("type") in LIGHTS)
            and part.get("type") not in SKIES
        ):
            if not _is_lamp(part):
                return f"the light {key} ({part.get('type')}) is no lamp that it knows"
            lamps.append(_AxialLight(part, 1))
    if not lamps:
        return "there is no lamp"
    sky = sum(_sky_luminance(part) for part in scene.world.values())
    if sky > 0.0:
        medium, eye = fog[0].medium, scene.camera.to_world[:3, 3]
        share = sky / max(sum(_mean_radiance(lamp, eye, medium) for lamp in lamps), 1e-300)
        if share > SKY_SHARE:
            return (
                f"the sky gives {share:.2g} of the lamps' light, and more than {SKY_SHARE:g} of it is too much to "
                f"leave out of the airlight"
            )
    return ""


def make_glow(loaded: MitsubaScene, *, single: Single = "traced") -> Glow:
    """The integrator.

    Args:
        single: light that the fog scattered once: 'traced' with shadows and beams as they are,
            or from the 'table', which has no noise and knows neither.

    Raises:
        ParameterError: a scene that `glow_refuses`, or a phase function too peaked for a table.
    """
    if problem := glow_refuses(loaded.source):
        raise ParameterError(f"the glow of lamps cannot be used here: {problem}")
    return Glow(loaded, single)


class Glow:
    """One scene's integrator.

    Valid for lamps alone in uniform fog without large obstacles, far from its edge.  Measured
    against `path` in the bench stages by night at MOR 150 and 600 m, 64 x 36 pixels: the median
    pixel is off by 4 to 9 %, 3 to 6 % of which are the reference's noise; `single` by 7 to 22 %, and
    this one with light scattered once from the table by 12 to 37 %.
    """

    def __init__(self, loaded: MitsubaScene, single: Single = "traced") -> None:
        mi = backend.mitsuba()
        world, medium = loaded.source.world, loaded.source.fog[0].medium
        self.loaded, self.sigma_t, self.traced = loaded, medium.sigma_t_per_m, single == "traced"
        lights = LightSampler(world, {})
        sky = loaded.scene.environment() is not None
        others = len(loaded.scene.emitters()) - sky - sum(is_sampled_light(part) for part in world.values())
        self.path = FogPath(
            loaded,
            Medium(loaded.source.fog),
            lights=lights,
            others=others,
            truncation=Truncation(scatterings=1 if self.traced else 0),
        )
        table = glow_table(medium.phase_function, medium.albedo)
        chi = medium.phase_function.moments(BEAM_ORDERS)
        found = [_AxialLight(part, BEAM_ORDERS) for part in world.values() if _is_lamp(part)]
        rows = [
            np.r_[lamp.position, lamp.axis, lamp.colour, float(not self.traced), lamp.blurred(chi)] for lamp in found
        ]
        self.count = len(rows)
        self.lamps = backend.floats(np.concatenate(rows))
        self.once = backend.floats(np.log(np.maximum(table.single * max(medium.albedo, 1e-30), 1e-30)).ravel())
        self.more = backend.floats(np.log(np.maximum(table.multiple, 1e-30)).ravel())
        lit = table.more if self.traced else table.once + table.more
        self.lit = backend.floats(np.maximum(lit, 0.0).ravel())
        self.sigma = dr.opaque(mi.Float, self.sigma_t)
        self.number = dr.opaque(mi.UInt32, self.count)
        dr.make_opaque(self.lamps, self.once, self.more, self.lit)

    def accumulate(self, *, samples: int, seed: int, progress: Progress = silent) -> Accumulator:
        """An image; see `Integrator`."""
        accumulated = self.path.accumulate(samples=samples, seed=seed, progress=progress)
        camera, rays = self.loaded.source.camera, min(samples, RAYS)
        pixels = camera.width_px * camera.height_px
        sums = [np.zeros((pixels, 3)) for _ in range(4)]
        for low in range(0, pixels, CHUNKED_LANES):
            index = np.arange(low, min(low + CHUNKED_LANES, pixels), dtype=np.uint32)
            light = self._trace(backend.numbers(index), rays, seed32(seed, PART))
            for total, part in zip(sums, light, strict=True):
                total[index] = np.array(part, dtype=np.float64).T
        components = {name: total[None] for name, total in zip((SURFACE, SINGLE, MULTIPLE), sums, strict=False)}
        accumulated.estimators[PART] = Estimator(components, sums[3], [], np.full((1, pixels), rays, dtype=np.int64))
        return accumulated

    @dr.syntax
    def _trace(self, pixel: Any, rays: int, seed: int) -> tuple[Any, Any, Any, Any]:
        """Sums over `rays` rays of the lamps' scattered light: on surfaces, once and more often in the air, and the
        squares of all.
        """
        mi, path = backend.mitsuba(), self.path
        wanted, image_seed = dr.opaque(mi.UInt32, rays), dr.opaque(mi.UInt32, seed)
        corner = path.eye.raster.corner(pixel)
        surface, single, multiple, squares = mi.Color3f(0.0), mi.Color3f(0.0), mi.Color3f(0.0), mi.Color3f(0.0)
        begun = mi.UInt32(0)
        while begun < wanted:
            sampler = Sobol(image_seed, pixel, begun)
            ray, weight = path.eye.ray(sampler, corner, mi.Bool(True))
            si = self.loaded.tree.ray_intersect(ray)
            near, far = path.medium.intersect(ray.o, ray.d)
            lit = si.is_valid() & (si.t <= far)
            stop = dr.maximum(dr.select(lit, si.t, far), near)
            through = dr.exp(-self.sigma * (stop - near))
            begin, end = ray(near), ray(stop)
            bsdf, reading = path.bands.surface(si.bsdf(), lit)
            matte, normal = path.matte(si, bsdf, reading, lit)
            light, once, more = mi.Color3f(0.0), mi.Color3f(0.0), mi.Color3f(0.0)
            index = mi.UInt32(0)
            while index < self.number:
                row = [dr.gather(mi.Float, self.lamps, index * _STRIDE + item) for item in range(_HEADER)]
                colour = mi.Color3f(*row[6:9])
                here, there = self._at(row, index, begin), self._at(row, index, end)
                once += colour * (
                    row[9] * dr.maximum(self._once(here, ray.d) - through * self._once(there, ray.d), 0.0)
                )
                more += colour * dr.maximum(self._more(here, ray.d) - through * self._more(there, ray.d), 0.0)
                light += colour * self._irradiance(there, normal)
                index += 1
            square = self.sigma * self.sigma
            light = dr.select(lit, weight * light * matte * (through * square * dr.inv_pi), mi.Color3f(0.0))
            once, more = weight * once * square, weight * more * square
            whole = light + once + more
            surface, single, multiple, squares = (
                surface + light,
                single + once,
                multiple + more,
                squares + whole * whole,
            )
            begun += 1
        return surface, single, multiple, squares

    def _at(self, row: list[Any], index: Any, place: Any) -> tuple[Any, Any, Any]:
        """A lamp from a place: direction to it, optical distance, and the intensity that counts."""
        mi = backend.mitsuba()
        between = mi.Point3f(*row[0:3]) - place
        away = dr.maximum(dr.norm(between), 1e-4)
        towards, tau = between / away, self.sigma * away
        angle = dr.acos(dr.clip(-dr.dot(mi.Vector3f(*row[3:6]), towards), -1.0, 1.0))
        column = angle * ((BEAM_ANGLES - 1) / math.pi)
        left = dr.clip(mi.Int32(column), 0, BEAM_ANGLES - 2)
        at = index * _STRIDE + _HEADER + mi.UInt32(left)
        strength = dr.lerp(dr.gather(mi.Float, self.lamps, at), dr.gather(mi.Float, self.lamps, at + 1), column - left)
        return towards, tau, strength

    def _once(self, seen: tuple[Any, Any, Any], direction: Any) -> Any:
        """Radiance of a lamp's light scattered once."""
        towards, tau, strength = seen
        theta = _angle(towards, direction)
        value = dr.exp(_bilinear(self.once, _row(tau), _column(theta), TAU_ROWS, THETA_COLUMNS) - tau)
        return strength * value / (tau * dr.maximum(dr.sin(0.5 * theta), SHARPEST))

    def _more(self, seen: tuple[Any, Any, Any], direction: Any) -> Any:
        """Radiance of a lamp's light scattered more often."""
        towards, tau, strength = seen
        value = dr.exp(_bilinear(self.more, _row(tau), _column(_angle(towards, direction)), TAU_ROWS, THETA_COLUMNS))
        return strength * value * dr.minimum(TAU[1] / tau, 1.0)

    def _irradiance(self, seen: tuple[Any, Any, Any], normal: Any) -> Any:
        """Irradiance of a surface by a lamp's scattered light."""
        towards, tau, strength = seen
        column = 0.5 * (dr.clip(dr.dot(normal, towards), -1.0, 1.0) + 1.0) * (NORMAL_COLUMNS - 1)
        return strength * _bilinear(self.lit, _row(tau), column, TAU_ROWS, NORMAL_COLUMNS) / tau


class _AxialLight:
    """A light as a point with light around an axis: position (3,), axis (3,), colour (3,) and Legendre moments of the
    intensity (L,).
    """

    def __init__(self, part: Mapping[str, Any], orders: int) -> None:
        if is_sampled_light(part):
            rows = lamp_rows(part)
            weight = rows["colour"] @ LUMINANCE
            total = max(float(weight.sum()), 1e-30)
            share = weight / total
            self.position = share @ (rows["position"] + (rows["edge_u"] + rows["edge_v"]) / 3.0)
            self.colour = rows["colour"].sum(axis=0)
            mean = share @ rows["axis"]
            self.axis = mean / np.linalg.norm(mean) if np.linalg.norm(mean) > 1e-3 else np.array([0.0, 0.0, 1.0])
            if part["type"] == photometric.TYPE:
                self.moments = _tabled(part, orders)
            elif part["type"] == "mesh":
                self.moments = _clamped_cosine(orders) * (
                    share @ np.polynomial.legendre.legvander(np.clip(rows["axis"] @ self.axis, -1.0, 1.0), orders - 1)
                )
            else:
                self.moments = _beam(rows["cutoff"][0], rows["slope"][0], orders)
            return
        radiance = np.asarray(part["emitter"]["radiance"]["value"], dtype=np.float64)
        matrix = np.asarray(part.get("to_world", np.eye(4)), dtype=np.float64)
        self.axis = np.array([0.0, 0.0, 1.0])
        if part["type"] == "sphere":
            self.position = (
                matrix[:3, :3] @ np.asarray(part.get("center", (0.0, 0.0, 0.0)), dtype=np.float64) + matrix[:3, 3]
            )
            radius = float(part.get("radius", 1.0)) * abs(np.linalg.det(matrix[:3, :3])) ** (1.0 / 3.0)
            self.colour, self.moments = radiance * math.pi * radius**2, np.r_[4.0 * math.pi, np.zeros(orders - 1)]
            return
        normal = np.cross(matrix[:3, 0], matrix[:3, 1])
        self.position, self.axis = matrix[:3, 3], normal / np.linalg.norm(normal)
        self.colour = radiance * np.linalg.norm(normal) * (4.0 if part["type"] == "rectangle" else math.pi)
        self.moments = _clamped_cosine(orders)

    def blurred(self, chi: Array) -> Array:
        """(A,) intensity that counts, by the angle off the axis."""
        orders = len(self.moments)
        kept = chi[:orders] ** 2 * self.moments * (2.0 * np.arange(orders) + 1.0) / (4.0 * math.pi)
        cosines = np.cos(np.linspace(0.0, math.pi, BEAM_ANGLES))
        return np.maximum(np.polynomial.legendre.legval(cosines, kept), 0.0)


def _is_lamp(part: Any) -> bool:
    if is_sampled_light(part):
        return True
    if not isinstance(part, Mapping) or part.get("type") not in SOLIDS or not isinstance(part.get("emitter"), Mapping):
        return False
    return part["emitter"].get("radiance", {}).get("type") == "rgb"


def _clamped_cosine(orders: int) -> Array:
    """(L,) 2 pi times the integral of mu P_l over mu from 0 to 1."""
    node, weight = np.polynomial.legendre.leggauss(orders // 2 + 2)
    mu = (node + 1.0) / 2.0
    return math.pi * (mu * weight) @ np.polynomial.legendre.legvander(mu, orders - 1)


def _beam(cutoff: float, slope: float, orders: int) -> Array:
    """(L,) moments of a spot that is 1 on its axis and falls to 0 at its cutoff [rad] by `slope` [1/rad]."""
    cutoff = min(cutoff, math.pi)
    node, weight = np.polynomial.legendre.leggauss(512)
    angle = (node + 1.0) / 2.0 * cutoff
    value = np.clip((cutoff - angle) * slope, 0.0, 1.0) if slope < 1e8 and cutoff < math.pi else np.ones_like(angle)
    return (
        math.pi
        * cutoff
        * (value * np.sin(angle) * weight)
        @ np.polynomial.legendre.legvander(np.cos(angle), orders - 1)
    )


def _tabled(light: Mapping[str, Any], orders: int) -> Array:
    """(L,) moments of a lamp's table, by luminance, as a share of the peaks that its rows have for colour."""
    table = photometric.table_of(light)
    weight = np.asarray(light["intensity"]["value"]) * LUMINANCE
    rings = (table @ weight if table.shape[2] == 3 else table[:, :, 0] * weight.sum()).mean(axis=1)
    peak = float(table.max(axis=(0, 1)) @ weight if table.shape[2] == 3 else table.max() * weight.sum())
    cosines = np.cos(np.linspace(0.0, math.pi, len(table)))
    return np.asarray(
        (rings * photometric.ring_weights(len(table)))
        @ np.polynomial.legendre.legvander(cosines, orders - 1)
        / max(peak, 1e-30)
    )


def _mean_radiance(lamp: _AxialLight, eye: Array, medium: Any) -> float:
    """Mean luminance over the sphere at the eye: the lamp's own light and the diffusion limit, added."""
    tau = medium.sigma_t_per_m * max(float(np.linalg.norm(lamp.position - eye)), 0.1)
    absorbed = math.sqrt(3.0 * (1.0 - medium.albedo) * (1.0 - medium.albedo * medium.g))
    scalar = math.exp(-tau) / tau**2 + medium.albedo * 3.0 * (1.0 - medium.albedo * medium.g) / tau * math.exp(
        -absorbed * tau
    )
    return float(LUMINANCE @ lamp.colour) * lamp.moments[0] / (4.0 * math.pi) ** 2 * medium.sigma_t_per_m**2 * scalar


def _sky_luminance(part: Any) -> float:
    """Mean luminance of a sky over the sphere; 0 for what is none."""
    if not isinstance(part, Mapping) or part.get("type") not in SKIES:
        return 0.0
    if part["type"] == "constant":
        return float(LUMINANCE @ np.broadcast_to(part["radiance"]["value"], 3))
    pixels = np.asarray(part["bitmap"], dtype=np.float64)[:, :, :3]
    rows = np.sin((np.arange(len(pixels)) + 0.5) * np.pi / len(pixels))
    return float(rows @ (pixels @ LUMINANCE).mean(axis=1) / rows.sum()) * float(part.get("scale", 1.0))


def _angle(one: Any, other: Any) -> Any:
    return dr.atan2(dr.norm(dr.cross(one, other)), dr.dot(one, other))


def _row(tau: Any) -> Any:
    return dr.log(dr.clip(tau, *TAU) / TAU[0]) * ((TAU_ROWS - 1) / math.log(TAU[1] / TAU[0]))


def _column(theta: Any) -> Any:
    return dr.sqrt(dr.clip(theta / dr.pi, 0.0, 1.0)) * (THETA_COLUMNS - 1)


def _bilinear(table: Any, row: Any, column: Any, rows: int, columns: int) -> Any:
    """Linear between the nodes of a table."""
    mi = backend.mitsuba()
    i, j = dr.clip(mi.Int32(row), 0, rows - 2), dr.clip(mi.Int32(column), 0, columns - 2)
    y, x = row - i, column - j
    at = mi.UInt32(i) * columns + mi.UInt32(j)
    low = dr.lerp(dr.gather(mi.Float, table, at), dr.gather(mi.Float, table, at + 1), x)
    high = dr.lerp(dr.gather(mi.Float, table, at + columns), dr.gather(mi.Float, table, at + columns + 1), x)
    return dr.lerp(low, high, y)

"""The plane-parallel solution in a kernel: what would be seen if the scene were an empty slab.

A scene's light is L = S + e with S the light of a slab of the same fog over a
Lambertian ground under the mean of the sky.  S is known, and in the fog e obeys the same
equation of transfer as L, without a source: only where a path meets what the
slab does not know is there anything to add.  The domain of S is the part of the
fog's box above the ground; outside of it S is 0, and a path that crosses its edge
counts the jump.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from synfog_usd.arrays import Array, FloatArray
from synfog_usd.fog import FogMedium
from synfog_usd.fog.slab import Slab, solve
from synfog_usd.render import backend
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.medium import Domain, Medium
from synfog_usd.render.spectra.bands import Bands

PROBES = 64
PROBE_REACH_M = 80.0
"""The ground is looked for on a grid of PROBES^2 points this far around the camera."""

ROWS, COLUMNS = 256, 512
"""Of the table: within 2e-4 of the solution but for the last metre under the top, within 1.6e-4 even near the
horizon.
"""

BIN_M = 0.05
MARGIN_M = 0.01
"""The slab's ground lies this far under the scene's, so that a ray that meets the scene's is inside."""

SKY_RINGS, SKY_SECTORS = 96, 128
STEEP = 1e-3
"""Elevation [sin] of the lowest ring of sky."""


@dataclass(frozen=True)
class Ground:
    """The surface that most of the surroundings are made of.

    Attributes:
        height_m: of it.
        albedo: (3,) mean diffuse reflectance.
        share: of the probes that met it.
    """

    height_m: float
    albedo: Array
    share: float


def find_ground(loaded: MitsubaScene, top_m: float) -> Ground | None:
    """Look straight down around the camera; None where nothing is met."""
    mi = backend.mitsuba()
    eye = loaded.source.camera.to_world[:3, 3]
    step = (np.arange(PROBES) + 0.5) / PROBES * 2.0 - 1.0
    step = np.sign(step) * np.abs(step) ** 2 * PROBE_REACH_M  # denser near the camera
    x, y = (axis.ravel() for axis in np.meshgrid(eye[0] + step, eye[1] + step))
    start = np.full(x.shape, top_m)
    ray = mi.Ray3f(mi.Point3f(backend.floats(x), backend.floats(y), backend.floats(start)), mi.Vector3f(0.0, 0.0, -1.0))
    si = loaded.tree.ray_intersect(ray)
    albedo = si.bsdf().eval_diffuse_reflectance(si, si.is_valid())
    surface_hit = np.array(si.is_valid())
    if not surface_hit.any():
        return None
    height, colour = np.array(si.p.z, dtype=np.float64), np.array(albedo, dtype=np.float64).T
    bins = np.round(height / BIN_M)
    found, count = np.unique(bins[surface_hit], return_counts=True)
    usual = found[np.argmax(count)]
    here = surface_hit & (np.abs(bins - usual) <= 1)
    return Ground(
        float(np.median(height[here])), np.clip(np.nan_to_num(colour[here]).mean(axis=0), 0.0, 1.0), float(here.mean())
    )


def mean_sky(loaded: MitsubaScene) -> tuple[Array, Array, float]:
    """The sky's mean over the azimuth.

    Returns:
        up (K,) ascending sines of elevation, radiance (K, 3), and how much the sky
        differs from it: RMS of the difference over the mean, by solid angle.
    """
    mi = backend.mitsuba()
    environment = loaded.scene.environment()
    up = STEEP + (1.0 - STEEP) * ((np.arange(SKY_RINGS) + 0.5) / SKY_RINGS) ** 1.5
    if environment is None:
        return up, np.zeros((SKY_RINGS, 3)), 0.0
    turn = (np.arange(SKY_SECTORS) + 0.5) / SKY_SECTORS * 2.0 * np.pi
    z, phi = (axis.ravel() for axis in np.meshgrid(up, turn, indexing="ij"))
    flat = np.sqrt(1.0 - z * z)
    si = dr.zeros(mi.SurfaceInteraction3f, len(z))
    si.wi = -mi.Vector3f(*(backend.floats(axis) for axis in (flat * np.cos(phi), flat * np.sin(phi), z)))
    radiance = np.array(environment.eval(si) + mi.Color3f(dr.zeros(mi.Float, len(z))), dtype=np.float64).T.reshape(
        SKY_RINGS, SKY_SECTORS, 3
    )
    mean = radiance.mean(axis=1)
    weight = np.gradient(up)
    level = float((weight[:, None] * mean).sum())
    off = float((weight[:, None, None] * (radiance - mean[:, None]) ** 2).sum() / SKY_SECTORS / 3.0)
    return up, mean, np.sqrt(off) / max(level / 3.0, 1e-30)


class ControlVariate:
    """One scene's slab.

    Args:
        slab: the solution.
        medium: the fog that it is a slab of: one box with a level top.
        bands: the slab's channels.
        floor_m: height [m] of the domain's lower face.  Where the ground lies on the fog's own floor or under it,
            the domain still reaches below the ground; the air between is clear, and S is there what it is at the floor.
    """

    def __init__(self, slab: Slab, medium: Medium, floor_m: float, bands: Bands) -> None:
        mi = backend.mitsuba()
        self.bands = bands
        self.slab, self.medium = slab, medium.media[0]
        matrix = medium.volumes[0].boundary.to_world.copy()
        matrix[2, :3] *= (slab.top_m - floor_m) / (2.0 * abs(matrix[2, 2]))
        matrix[2, 3] = 0.5 * (slab.top_m + floor_m)
        self.domain = Domain(matrix)
        self.bottom, self.top = dr.opaque(mi.Float, slab.bottom_m), dr.opaque(mi.Float, slab.top_m)
        table, lit = _tables(slab)
        self.rows, self.columns = table.shape[1:3]
        self.table = backend.floats(np.ravel(table))
        self.lit_rows, self.lit_columns = lit.shape[:2]
        self.lit = backend.floats(np.ravel(lit))
        self.exponential = medium.media[0].exponential
        if self.exponential:
            self.through = dr.opaque(mi.Float, 1.0 / max(slab.optical_depth, 1e-30))
        dr.make_opaque(self.table, self.lit)

    def intersect(self, origin: Any, direction: Any) -> tuple[Any, Any]:
        """Where a ray is in the domain, as distances >= 0; equal where it misses."""
        return self.domain.intersect(origin, direction)

    def holds(self, place: Any) -> Any:
        """Whether points are in the domain."""
        return self.domain.contains(place)

    def radiance(self, place: Any, direction: Any, active: Any) -> Any:
        """What is seen from points of the domain in a direction (C,)."""
        side = dr.select(direction.z >= 0.0, backend.mitsuba().UInt32(0), self.rows * self.columns)
        column = dr.sqrt(dr.minimum(dr.abs(direction.z), 1.0)) * (self.columns - 1)
        return self._bilinear(
            self.table, self._row(place) * (self.rows - 1), column, self.rows, self.columns, side, active
        )

    def airlight(self, ray: Any, end: Any, medium: Medium, active: Any) -> Any:
        """What the slab sends towards a ray's origin from before a distance `end`, infinite where nothing is met
        (C,).
        """
        begin, leave = self.intersect(ray.o, ray.d)
        inside = active & (leave > begin) & (begin < end)
        until = dr.minimum(end, leave)
        there = self.radiance(ray(begin), ray.d, inside) * dr.exp(-medium.optical_depth(ray.o, ray.d, 0.0, begin))
        here = self.radiance(ray(until), ray.d, inside) * dr.exp(-medium.optical_depth(ray.o, ray.d, 0.0, until))
        return dr.select(inside, there - here, self.bands.black())

    def irradiance(self, place: Any, normal: Any, active: Any) -> Any:
        """Light on points of the domain with a normal (C,)."""
        column = 0.5 * (dr.clip(normal.z, -1.0, 1.0) + 1.0) * (self.lit_columns - 1)
        return self._bilinear(
            self.lit,
            self._row(place) * (self.lit_rows - 1),
            column,
            self.lit_rows,
            self.lit_columns,
            backend.mitsuba().UInt32(0),
            active,
        )

    def _row(self, place: Any) -> Any:
        """The table's row coordinate, 0 at the ground and 1 at the top; see `Slab.table`."""
        if self.exponential:
            height = place.z - self.bottom
            share = (
                self.medium.optical_depth(
                    backend.mitsuba().Point3f(0.0, 0.0, self.bottom),
                    backend.mitsuba().Vector3f(0.0, 0.0, 1.0),
                    0.0,
                    height,
                )
                * self.through
            )
        else:
            share = (place.z - self.bottom) / (self.top - self.bottom)
        return (2.0 / dr.pi) * dr.asin(dr.sqrt(dr.clip(share, 0.0, 1.0)))

    def _bilinear(self, table: Any, row: Any, column: Any, rows: int, columns: int, first: Any, active: Any) -> Any:
        mi = backend.mitsuba()
        i, j = dr.clip(mi.Int32(row), 0, rows - 2), dr.clip(mi.Int32(column), 0, columns - 2)
        y, x = row - i, column - j
        at = first + mi.UInt32(i) * columns + mi.UInt32(j)
        low = dr.lerp(self.bands.gather(table, at, active), self.bands.gather(table, at + 1, active), x)
        high = dr.lerp(
            self.bands.gather(table, at + columns, active), self.bands.gather(table, at + columns + 1, active), x
        )
        return dr.lerp(low, high, y)


def make_control_variate(
    loaded: MitsubaScene, medium: Medium, bands: Bands | None = None, sky_kind: int = 0
) -> tuple[ControlVariate | None, str]:
    """The slab that is most like a scene under a sky of this kind of light; else None and why there is none."""
    bands = bands or Bands()
    found, why = find_slab(loaded, medium, bands, sky_kind)
    return (ControlVariate(found[0], medium, found[1], bands), "") if found else (None, why)


def find_slab(
    loaded: MitsubaScene, medium: Medium, bands: Bands | None = None, sky_kind: int = 0
) -> tuple[tuple[Slab, float] | None, str]:
    """The solution of that slab, and the height [m] of the domain's floor; else None and why there is none."""
    bands = bands or Bands()
    if bands.coloured:
        return None, "the slab is solved for fog that is grey, and this one has an Angstrom exponent"
    if not medium.foggy or len(medium.volumes) != 1:
        return None, "the slab is solved for one fog volume"
    volume = medium.volumes[0]
    matrix = volume.boundary.to_world
    if (
        volume.boundary.kind != "box"
        or np.abs(matrix[2, :2]).max() + np.abs(matrix[:2, 2]).max() > 1e-5 * np.abs(matrix[:3, :3]).max()
    ):
        return None, f"the fog {volume.path} is no box with a level top"
    if loaded.scene.environment() is None:
        return None, "there is no sky"
    top, bottom = float(matrix[2, 3] + abs(matrix[2, 2])), float(matrix[2, 3] - abs(matrix[2, 2]))
    ground = find_ground(loaded, top)
    if ground is None:
        return None, "there is no ground under the camera"
    floor, albedo = ground.height_m - MARGIN_M, ground.albedo
    height = max(floor, bottom)
    if not height < top - 1e-3:
        return None, "the fog ends under the ground"
    up, sky, _ = mean_sky(loaded)
    if not bands.is_rgb:
        albedo, sky = np.clip(albedo @ bands.reflectance_of, 0.0, 1.0), np.maximum(bands.light_in(sky, sky_kind), 0.0)
    rings = np.asarray(sky, dtype=np.float64).tobytes()
    slab = _solved(volume.medium, height, top, tuple(albedo.tolist()), up.tobytes(), rings)
    return (slab, floor), ""


@functools.lru_cache(maxsize=4)  # a picture's pilots and the picture ask for one and the same
def _solved(medium: FogMedium, bottom_m: float, top_m: float, ground: tuple[float, ...], up: bytes, sky: bytes) -> Slab:
    """`solve`, of arrays of float64 as bytes."""
    rings = np.frombuffer(sky).reshape(-1, len(ground))
    return solve(medium, bottom_m=bottom_m, top_m=top_m, ground=ground, sky_up=np.frombuffer(up), sky=rings)


@functools.lru_cache(maxsize=4)  # 3 MB each in R, G and B
def _tables(slab: Slab) -> tuple[FloatArray, FloatArray]:
    """Its radiance and irradiance."""
    return slab.table(ROWS, COLUMNS), slab.irradiance_table()

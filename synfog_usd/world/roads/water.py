"""Rain on a road: how deep the water is, how the asphalt looks below it, and where it stands.

Takes a rate of rain and a road; gives materials, and parts of the level plane.  Knows nothing of USD.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import stream
from synfog_usd.fog.drops import rain_sizes
from synfog_usd.fog.falling import SizeClasses
from synfog_usd.world.materials import Material
from synfog_usd.world.roads.asphalt import INTO_TUNNEL_M, PUDDLE_M, TRACK_M, Asphalt, looks
from synfog_usd.world.roads.lane_section import DRIVEN, PAVED
from synfog_usd.world.roads.network import Road
from synfog_usd.world.shapes import Part

TEXTURE_MM = {"new": 0.7, "worn": 0.5, "old": 0.9, "chip_seal": 1.8}
"""Mean texture depth by kind of asphalt, by the sand patch: typical values."""
LENGTH_M, CROSSFALL = 4.0, 0.025
"""From the crown to the middle of the way of the water, and the fall, of a road that says none."""
COAT = 0.51
"""Weight of a clear coat of index 1.5 that reflects along the normal as water does."""
COAT_ROUGHNESS = 0.16
"""Of the film: it hangs between the stones.  An estimate by eye."""
STEP_S_M, STEP_T_M = 0.4, 0.1
FIELD_M = (0.9, 0.16)
"""Deviation of the Gaussian that makes the field of hollows smooth, along and across the road."""
LEVELS = (0.0, 0.1, 0.4, 0.8, 1.5), (4.0, 3.2, 2.4, 1.9, 1.4)
"""Depth of the water over the bottom of the texture [mm], and the level of the field above which it stands."""
DEEPER = {"new": -0.9, "worn": 0.0, "old": 0.4, "chip_seal": -0.9}
"""How much deeper ruts and hollows are than those of a worn road, in deviations of the field: estimates."""
RUT, GUTTER, WIDE_M = 1.1, 1.9, 0.2
"""Depth of ruts and gutters in deviations of the field, and their half width: estimates."""


RINGS, RING_RAD_M = 0.01, 200.0
"""Share of a drop's energy that its rings have, and their wave number [rad/m]."""
DENSITY, SURFACE_TENSION, VISCOSITY = 1000.0, 0.0728, 1.0e-6
"""Of water at 20 degrees: [kg/m3], [N/m], kinematic [m2/s]."""


def film_depth_mm(rate_mm_h: float, length_m: float, slope: float, texture_mm: float) -> float:
    """Depth of the water over the tops of a road's texture [mm]; below 0 the tops stand out of it.

    Args:
        rate_mm_h: of rain [mm/h].
        length_m: that the water has run [m].
        slope: along its way [1], above 0.
        texture_mm: mean texture depth [mm].

    Source: Gallaway et al., FHWA-RD-79-31 (1979), its fit to measurements on several surfaces.
    """
    flow = 0.01485 * texture_mm**0.11 * length_m**0.43 * rate_mm_h**0.59 / slope**0.42
    return float(flow - texture_mm)


def depth_of(asphalt: Asphalt, rate_mm_h: float, road: Road | None = None) -> float:
    """`film_depth_mm` half way from the crown to the gutter of a road."""
    length, fall = LENGTH_M, CROSSFALL
    if road is not None and road.crossfall > 0.0:
        fall = road.crossfall
        length = max(
            0.5 * float(road.lane_section.from_crown([road.lane_section.low, road.lane_section.high]).max()), 1.0
        )
    return film_depth_mm(rate_mm_h, length, fall, TEXTURE_MM[asphalt.kind])


def covered(asphalt: Asphalt, rate_mm_h: float, road: Road | None = None) -> float:
    """Share of a road's texture that water fills [1]."""
    return float(np.clip(1.0 + depth_of(asphalt, rate_mm_h, road) / TEXTURE_MM[asphalt.kind], 0.0, 1.0))


def ripples(rate_mm_h: float) -> float:
    """Mean square slope of standing water in rain [1].

    Of what falling drops bring, one part in a hundred becomes rings of 0.2 rad/mm, which water's viscosity damps.

    Source: ring waves of single drops, IEEE J. Oceanic Eng. 24, 323 (1999); energy and decay of capillary and gravity
    waves, Lamb, Hydrodynamics, sections 267 and 348.
    """
    rain = SizeClasses.of_rain(rain_sizes(rate_mm_h))
    middle, speed = (0.5 * (ends[1:] + ends[:-1]) for ends in (rain.edges_m, rain.speed_m_s))
    watts_m2 = float(rain.per_m3 @ (math.pi / 12.0 * DENSITY * middle**3 * speed**3))
    stiffness = DENSITY * 9.81 + SURFACE_TENSION * RING_RAD_M**2
    return RINGS * watts_m2 / (4.0 * VISCOSITY * stiffness)


def film_m(asphalt: Asphalt, rate_mm_h: float, road: Road | None = None) -> float:
    """Depth of the water over the bottom of a road's texture [m]; 0 where it is dry."""
    return 1e-3 * max(depth_of(asphalt, rate_mm_h, road) + TEXTURE_MM[asphalt.kind], 0.0)


def rained_on(
    asphalt: Asphalt, rate_mm_h: float, materials: Mapping[str, Material], road: Road | None = None
) -> dict[str, Material]:
    """What a road's materials are in rain, by name.

    Its pores are full, so that it is as dark as a wet road; the film is smooth where it covers the texture, and shines
    as a coat.  Ripples make puddles rough, as microfacets of their slopes.
    """
    share = covered(asphalt, rate_mm_h, road)
    wet = looks(replace(asphalt, wet="wet"), materials, smooth=share)
    return {
        name: replace(look, roughness=round((look.roughness**4 + ripples(rate_mm_h)) ** 0.25, 3))
        if name == "puddle"
        else replace(look, clearcoat=round(COAT * share, 3), clearcoat_roughness=COAT_ROUGHNESS)
        for name, look in wet.items()
    }


def standing(road: Road, asphalt: Asphalt, rate_mm_h: float, *, seed: int, low: float = 2.0) -> list[Part]:
    """Standing water in ruts, hollows and gutters, in the level plane: the deeper the film, the more of them it fills.

    A seeded field says where the surface is low, more so in wheel tracks and at kerbs; water stands where the field is
    above a level.

    Args:
        low: station where it begins [m].
    """
    end = road.reference_line.length if road.land.hill is None else road.land.hill[0] + INTO_TUNNEL_M
    level = float(np.interp(1e3 * film_m(asphalt, rate_mm_h, road), *LEVELS))
    parts = []
    for number, lane in enumerate(road.lane_section.lanes):
        if lane.kind not in PAVED:
            continue
        s = np.arange(low, end, STEP_S_M)
        t = np.linspace(lane.low, lane.high, max(3, round(lane.width / STEP_T_M) + 1))
        field = stream(seed, "road", "hollows", number).normal(size=(len(s), len(t)))
        field = gaussian_filter(field, (FIELD_M[0] / STEP_S_M, FIELD_M[1] / STEP_T_M), mode="nearest")
        field /= field.std()
        places = [lane.middle - TRACK_M, lane.middle + TRACK_M] if lane.kind in DRIVEN else []
        field += RUT * _near(t, places) + GUTTER * _near(t, [at for at, _ in road.lane_section.kerbs()])
        part = _above(s, t, field - level + DEEPER[asphalt.kind])
        if part is not None:
            parts.append(part)
    return parts


def _near(t: Array, places: list[float]) -> Array:
    """1 at any of some offsets, 0 far from them."""
    return np.asarray(np.exp(-0.5 * (np.subtract.outer(t, [*places, 1e6]) / WIDE_M) ** 2).max(axis=1))


def _above(s: Array, t: Array, field: Array) -> Part | None:
    """Where a field over stations and offsets is above 0, with its edge straight within a triangle."""
    from trimesh.intersections import slice_faces_plane

    corners = np.stack([*np.meshgrid(t, s), field], axis=-1).reshape(-1, 3)
    first = np.arange(len(corners)).reshape(field.shape)
    a, b, c, d = (
        first[rows, columns].ravel()
        for rows in (slice(None, -1), slice(1, None))
        for columns in (slice(None, -1), slice(1, None))
    )
    faces = np.concatenate([np.c_[a, b, d], np.c_[a, d, c]])
    faces = faces[(corners[faces, 2] > 0.0).any(axis=1)]
    if not len(faces):
        return None
    up = np.array([0.0, 0.0, 1.0])
    points, faces, _ = slice_faces_plane(corners, faces, up, np.zeros(3))  # type: ignore[no-untyped-call]
    flat: npt.NDArray[np.float64] = np.c_[points[:, :2], np.full(len(points), PUDDLE_M)]
    return Part(flat, np.asarray(faces), "puddle", uv=points[:, :2].copy())

"""The road as triangles: carriageway, kerbs, pavements, verges, repairs, grass.

Parts are made on a level plane, x to the right of the line and y along it, and
`bend` lays them on the road.  Textured in metres along and across, so that wheel
tracks follow the lanes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import stream
from synfog_usd.world.materials import LANE_TEXTURE_HALF_M, LANE_TEXTURE_LANE_M, LANE_TEXTURE_LENGTH_M
from synfog_usd.world.roads.asphalt import REPAIRS, Asphalt, puddles
from synfog_usd.world.roads.lane_section import KERB_M, RAISED, Lane
from synfog_usd.world.roads.network import Road
from synfog_usd.world.shapes import Part, disc, rectangle, strip, textured_from_above

WORN = Asphalt()
FINE_M, COARSE_M = 1.0, 4.0
TIGHT_M = 120.0
PAVING_TILE_M, GRASS_TILE_M, ASPHALT_TILE_M = 4.0, 4.0, 6.0


def bend(part: Part, road: Road) -> Part:
    """A part of the level plane on the road: x is the offset, y the station, z the height over a road level across."""
    t, s, h = part.points.T
    x, y = road.reference_line.place(s, t)
    return replace(part, points=np.c_[x, y, road.reference_line.height(s) + road.over_line(t, h)], normals=None)


def stations(road: Road, low: float = 0.0, high: float | None = None) -> Array:
    """Stations that follow the line within millimetres: closer in bends and over crests."""
    high = road.reference_line.length if high is None else high
    curved = any(k for _, k in road.reference_line.curvature) or len(road.reference_line.slope) > 1
    step = FINE_M if road.reference_line.tightest < TIGHT_M else 2.0 if curved else COARSE_M
    return np.linspace(low, high, max(2, int(np.ceil((high - low) / step)) + 1))


def sweep(
    road: Road, profile: npt.ArrayLike, material: str, *, tile_m: float, low: float = 0.0, high: float | None = None
) -> Part:
    """A profile of (t, h) [m] from left to right, drawn along the road; it faces up, or outwards of what it goes
    round.
    """
    s = stations(road, low, high)
    p = np.asarray(profile, dtype=np.float64)
    across = np.r_[0.0, np.cumsum(np.hypot(*np.diff(p, axis=0).T))]
    loops = [np.c_[p[:, 0], np.full(len(p), at), p[:, 1]] for at in s]
    uv = [np.c_[across / tile_m, np.full(len(p), at / tile_m)] for at in s]
    return bend(strip(loops, material, uv=uv), road)


def surface(road: Road, *, seed: int, asphalt: Asphalt = WORN) -> dict[str, list[Part]]:
    """Cityscapes label -> parts of everything between the road's two edges, markings apart."""
    rng = stream(seed, "road", "asphalt")
    angle, begin, flipped = rng.uniform(0, 2 * np.pi), rng.uniform(0, 1, 2), bool(rng.random() < 0.5)
    parts: dict[str, list[Part]] = {"road": [], "sidewalk": [], "terrain": []}
    for index, lane in enumerate(road.lane_section.lanes):
        kind = lane.kind
        if kind in ("lane", "bus"):
            if asphalt.lane == "asphalt_lane":
                parts["road"].append(_lane(road, lane, index, float(begin[0]), flipped))
            else:
                parts["road"].append(_turned(road, lane, asphalt.lane, float(angle), begin + 0.31 * index))
        elif kind in ("parking", "shoulder", "cycle"):
            parts["road"].append(_turned(road, lane, "asphalt", float(angle), begin + 0.31 * index))
        elif kind in ("pavement", "island"):
            parts["sidewalk"].append(_flat(road, lane, "paving", PAVING_TILE_M))
        else:
            parts["terrain"].append(_flat(road, lane, "grass", GRASS_TILE_M, shift=0.37 * index))
    parts["sidewalk"] += [_kerb(road, t, side) for t, side in road.lane_section.kerbs()]
    parts["road"] += [
        bend(part, road) for part in (*_repairs(road, seed, REPAIRS[asphalt.kind]), *puddles(road, asphalt, seed=seed))
    ]
    return {label: of_label for label, of_label in parts.items() if of_label}


def _turned(road: Road, lane: Lane, material: str, angle: float, begin: Array) -> Part:
    """A strip of asphalt without a direction, its texture turned by an angle [rad] and begun elsewhere."""
    part = _flat(road, lane, material, ASPHALT_TILE_M)
    assert part.uv is not None
    c, s = np.cos(angle), np.sin(angle)
    return replace(part, uv=part.uv @ np.array([[c, s], [-s, c]]) + begin)


def _lane(road: Road, lane: Lane, index: int, begin: float, flipped: bool) -> Part:
    """A lane with its wheel tracks; lanes begin at different places of the texture, and roads run through it either
    way.
    """
    s = stations(road)
    way = -1.0 if flipped else 1.0
    u0, u1 = 0.5, (LANE_TEXTURE_HALF_M + LANE_TEXTURE_LANE_M) / (2 * LANE_TEXTURE_HALF_M)
    if lane.way < 0:
        u0, u1 = u1, u0
    along = [way * at / LANE_TEXTURE_LENGTH_M + 0.41 * index + begin for at in s]
    uv = [np.array([(u0, v), (u1, v)]) for v in along]
    return bend(strip([np.array([(lane.low, at, 0.0), (lane.high, at, 0.0)]) for at in s], "asphalt_lane", uv=uv), road)


def _flat(road: Road, lane: Lane, material: str, tile_m: float, *, shift: float = 0.0) -> Part:
    """A strip between its edges, from behind the kerb stone where it has one."""
    low, high = lane.low, lane.high
    a, b = road.lane_section.ends(lane)
    for t, side in road.lane_section.kerbs():
        if lane.kind in RAISED:
            low = low + 0.15 if t == lane.low and side > 0 else low
            high = high - 0.15 if t == lane.high and side < 0 else high
    columns = np.linspace(low, high, 2 if a == b else 4)
    h = np.interp(columns, (low, high), (a, b))
    s = stations(road)
    loops = [np.c_[columns, np.full(len(columns), at), h] for at in s]
    uv = [np.c_[columns / tile_m + shift, np.full(len(columns), at / tile_m)] for at in s]
    return bend(strip(loops, material, uv=uv), road)


def _kerb(road: Road, t: float, side: int) -> Part:
    """A granite kerb with a rounded edge."""
    profile = np.array([(0.0, -0.02), (0.0, KERB_M - 0.02), (0.006, KERB_M - 0.006), (0.02, KERB_M), (0.152, KERB_M)])
    profile[:, 0] = t + side * profile[:, 0]
    return sweep(road, profile if side > 0 else profile[::-1], "kerb", tile_m=1.0)


def ribbon(points: Array, width: float, z: float, material: str) -> Part:
    """A band of a width [m] along (K, 2) points of the level plane."""
    d = np.gradient(points, axis=0)
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
    side = np.c_[-d[:, 1], d[:, 0]] * width / 2
    flat = np.full(len(points), z)
    return strip([np.c_[points + side, flat], np.c_[points - side, flat]][::-1], material)


def _repairs(road: Road, seed: int, often: float = 1.0) -> list[Part]:
    """Patches, sealed cracks, covers and gullies, as years of digging leave them."""
    rng = stream(seed, "road", "repairs")
    parts: list[Part] = []
    length = road.reference_line.length
    driven = list(road.lane_section.of("lane", "bus"))
    urban = any(lane.kind == "pavement" for lane in road.lane_section.lanes)
    for _ in range(int(often * length / (28 if urban else 60))):
        lane = driven[int(rng.integers(len(driven)))]
        width, long, s = rng.uniform(0.6, 1.6), rng.uniform(1.5, 14.0), rng.uniform(0, length - 20)
        t = rng.uniform(lane.low + 0.1, lane.high - 0.1 - width)
        parts += _patch(t, s, width, long, "asphalt_patch" if rng.random() < 0.7 else "asphalt_old")
    for _ in range(int(often * length / 9)):
        lane = driven[int(rng.integers(len(driven)))]
        t, s = rng.uniform(lane.low, lane.high), rng.uniform(5, length - 10)
        heading = rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.25)
        points = [(t, s)]
        for _ in range(int(rng.integers(6, 26))):
            heading += rng.normal(0, 0.22)
            t = float(np.clip(t + 0.22 * np.cos(heading), driven[0].low, driven[-1].high))
            s += 0.22 * np.sin(heading)
            points.append((t, s))
        path = np.array(points)
        if not any(road.lane_section.at(float(p)).kind in RAISED for p in path[:, 0]):  # type: ignore[union-attr]
            parts.append(ribbon(path, float(rng.uniform(0.012, 0.035)), 0.0018, "tar"))
    if urban:
        for s in np.arange(rng.uniform(5, 20), length - 5, 27.0):
            lane = driven[int(rng.integers(len(driven)))]
            t, at = lane.middle + rng.uniform(-0.9, 0.9), s + rng.uniform(-6, 6)
            parts += cover(t, at)
        for t, side in road.lane_section.kerbs():
            parts += [gully(t - side * 0.22, s) for s in np.arange(rng.uniform(4, 18), length, 24.0)]
    return parts


def cover(t: float, s: float) -> list[Part]:
    """A manhole's cover in its patch of asphalt."""
    return [disc((t, s, 0.0022), 0.43, "asphalt_patch", sides=24), disc((t, s, 0.0026), 0.33, "iron", sides=24)]


def gully(t: float, s: float) -> Part:
    """A gully's grate."""
    grate = rectangle((t - 0.18, s - 0.25), (t + 0.18, s + 0.25), 0.0026, "iron")
    return replace(grate, uv=np.array([(0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75)]))


def _patch(t: float, s: float, width: float, long: float, material: str) -> list[Part]:
    """A mended trench, and the tar along its seams; cut every metre, so that it follows a bend."""
    at = np.linspace(s, s + long, max(2, int(long) + 1))
    patch = strip([np.array([(t, y, 0.0012), (t + width, y, 0.0012)]) for y in at], material)
    sides = [np.c_[np.full(len(at), x), at] for x in (t, t + width)]
    ends = [np.array([(t, y), (t + width, y)]) for y in (s, s + long)]
    return [
        textured_from_above(patch, ASPHALT_TILE_M),
        *(ribbon(edge, 0.035, 0.0016, "tar") for edge in (*sides, *ends)),
    ]

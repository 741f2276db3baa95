"""A roundabout as triangles: asphalt, kerbs, pavements, islands, and the land between and beyond the arms.

The asphalt is one sheet at z = 0 that goes on a hand's breadth below the pavements;
kerbs, pavements and islands stand on it, and the land begins at the very points
where the pavements end.  So nothing gapes and no two faces lie in one plane.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy import spatial

from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import seed32, stream
from synfog_usd.world.materials import LANE_TEXTURE_HALF_M, LANE_TEXTURE_LANE_M, LANE_TEXTURE_LENGTH_M, Material
from synfog_usd.world.roads import land
from synfog_usd.world.roads.asphalt import Asphalt, puddles
from synfog_usd.world.roads.horizon import LAND_M as FAR_M
from synfog_usd.world.roads.horizon import Horizon, Scatter, mixture
from synfog_usd.world.roads.lane_section import KERB_M
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.roundabout import (
    APRON_LIP_M,
    APRON_TOP_M,
    BEHIND_KERB_M,
    FINE_M,
    HOLD_M,
    LAND_M,
    NEAR_M,
    RAMP_M,
    TAPER_M,
    ZEBRA_HALF_M,
    Roundabout,
)
from synfog_usd.world.roads.surface import ASPHALT_TILE_M, GRASS_TILE_M, PAVING_TILE_M, WORN, bend
from synfog_usd.world.roads.water import standing
from synfog_usd.world.shapes import Part, strip, textured_from_above

LOOKS = {"setts": Material((0.52, 0.49, 0.47), texture="paving.jpg", roughness=0.75)}
"""Materials that only roundabouts have: the apron's setts, the slabs' texture at a quarter of its size."""
SETTS_TILE_M = 1.0
UNDER_M = 0.1
"""By which the asphalt goes on below the pavement."""
TACTILE_M = 0.8
OUT_M = (2.2, 4.5, 7.0, 9.5, 12.0, 15.0, 19.0, 24.0, 31.0, 39.0, 48.0, 58.0)
GRID_M, GRID_FROM_M = 18.0, 60.0


def surface(junction: Roundabout, asphalt: Asphalt = WORN, *, seed: int = 0) -> dict[str, list[Part]]:
    """Cityscapes label -> parts of everything between the pavements' outer edges, markings apart."""
    parts: dict[str, list[Part]] = {
        "road": [_disc(junction, asphalt), *_water(junction, asphalt, seed)],
        "sidewalk": [],
        "terrain": [],
    }
    for arm in range(len(junction.arms)):
        parts["road"] += _arm(junction, arm, asphalt)
        for low, high in junction.islands(arm):
            parts["sidewalk"] += _splitter(junction, arm, low, high)
    for corner in range(len(junction.arms)):
        parts["sidewalk"] += _corner(junction, corner)
    apron, kerb, mound = _middle(junction)
    parts["road"] += apron
    parts["sidewalk"].append(kerb)
    parts["terrain"].append(mound)
    return parts


def swept(
    points: Array, normals: Array, across: npt.ArrayLike, heights: npt.ArrayLike, material: str, *, tile_m: float
) -> Part:
    """A profile drawn along a line of the plane: (N, 2) points and unit normals to the right; (K,) offsets to the
    right, (N, K) or (K,) heights.
    """
    u = np.asarray(across, dtype=np.float64)
    h = np.broadcast_to(np.asarray(heights, dtype=np.float64), (len(points), len(u)))
    along = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))] / tile_m
    wide = np.r_[0.0, np.cumsum(np.hypot(np.diff(u), np.diff(h[0])))] / tile_m
    loops = np.concatenate([points[:, None] + u[:, None] * normals[:, None], h[..., None]], axis=-1)
    uv = np.stack(np.broadcast_arrays(wide, along[:, None]), axis=-1)
    return strip([*loops], material, uv=[*uv])


def _kerb(points: Array, normals: Array, height: npt.ArrayLike, base: float = 0.0) -> Part:
    """A granite kerb with a rounded edge, (N,) or one height over its base [m]."""
    h = np.broadcast_to(np.asarray(height, dtype=np.float64), len(points))[:, None]
    heights = base + np.concatenate([np.full_like(h, -0.02), h - 0.02, h - 0.006, h, h], axis=1)
    return swept(points, normals, (0.0, 0.0, 0.006, 0.02, BEHIND_KERB_M), heights, "kerb", tile_m=1.0)


def _whole(part: Part) -> Part:
    """Without triangles of no area."""
    a, b, c = (part.points[part.faces[:, i]] for i in range(3))
    return Part(part.points, part.faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-7], part.material, part.uv)


# -- asphalt


def _columns(junction: Roundabout, s: npt.ArrayLike) -> Array:
    """(..., 6) offsets of an arm's seams at stations: edge, lane's inner edge, line, and the same on the right."""
    spread = junction.spread(s)
    edge = spread + junction.lane_width + UNDER_M
    return np.stack([-edge, -spread, np.zeros_like(spread), spread, edge], axis=-1)


def _disc(junction: Roundabout, asphalt: Asphalt) -> Part:
    """Asphalt from the inner edge of the ring to where the arms begin, less what pavements cover."""
    far = junction.radius + HOLD_M
    seams = np.arcsin(_columns(junction, far) / far)
    angle = np.linspace(0.0, 2 * np.pi, round(2 * np.pi * far), endpoint=False)
    for arm in junction.arms:
        angle = np.r_[angle, (np.radians(arm.reference_line.origin[2]) + np.pi / 2 - seams) % (2 * np.pi)]
    angle = np.unique(np.round(angle, 9))
    angle = angle[np.r_[True, np.diff(angle) > 1e-7]]
    radius = np.r_[
        np.linspace(junction.inner, junction.radius, 6), np.linspace(junction.radius, far, round(HOLD_M) + 1)[1:]
    ]
    loops = [np.c_[np.cos(angle) * r, np.sin(angle) * r, np.zeros(len(angle))] for r in radius]
    sheet = strip(loops[::-1], asphalt.lane if asphalt.lane != "asphalt_lane" else "asphalt", closed=True)
    u, _ = junction.across(sheet.points[:, 0], sheet.points[:, 1])
    return textured_from_above(
        Part(sheet.points, sheet.faces[(u[sheet.faces] < 3 * UNDER_M).any(axis=1)], sheet.material), ASPHALT_TILE_M
    )


def _stations(junction: Roundabout, road: Road) -> Array:
    """Of an arm's rows, after the disc."""
    near = np.linspace(junction.radius + HOLD_M + 1.0, junction.radius + HOLD_M + TAPER_M, 22)
    return np.r_[
        near,
        np.linspace(near[-1], road.reference_line.length, int((road.reference_line.length - near[-1]) / 2.0) + 2)[1:],
    ]


def _arm(junction: Roundabout, arm: int, asphalt: Asphalt) -> list[Part]:
    """An arm's two lanes with their wheel tracks, and what lies between them before its island."""
    road, far = junction.arms[arm], junction.radius + HOLD_M
    first = _columns(junction, far)
    s = np.concatenate([np.sqrt(far**2 - first**2)[None], np.repeat(_stations(junction, road)[:, None], 5, axis=1)])
    t = np.concatenate([first[None], _columns(junction, s[1:, 0])])
    x, y = road.reference_line.place(s, t)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    u0, u1 = 0.5, 0.5 + LANE_TEXTURE_LANE_M / (2 * LANE_TEXTURE_HALF_M)
    lanes = []
    for pair, ends in (((0, 1), (u1, u0)), ((3, 4), (u0, u1))):
        uv = [np.c_[ends, row[list(pair)] / LANE_TEXTURE_LENGTH_M + 0.41 * pair[0] + 0.17 * arm] for row in s]
        lane = _whole(strip([row[list(pair)] for row in points], asphalt.lane, uv=uv))
        lanes.append(lane if asphalt.lane == "asphalt_lane" else textured_from_above(lane, ASPHALT_TILE_M))
    return [*lanes, textured_from_above(_whole(strip([row[1:4] for row in points], "asphalt")), ASPHALT_TILE_M)]


def _water(junction: Roundabout, asphalt: Asphalt, seed: int) -> list[Part]:
    """Puddles round the ring and on the arms, where their lanes have come together."""
    parts = [
        bend(part, junction.ring) for part in puddles(junction.ring, asphalt, seed=seed32(seed, "roundabout", "ring"))
    ]
    for number, road in enumerate(junction.arms):
        for part in puddles(road, asphalt, seed=seed32(seed, "roundabout", "arm", number)):
            t, s, h = part.points.T
            if s.min() > junction.radius + HOLD_M:
                parts.append(bend(replace(part, points=np.c_[t + np.sign(t) * junction.spread(s), s, h]), road))
    return parts


def water(junction: Roundabout, asphalt: Asphalt, rate_mm_h: float, seed: int) -> list[Part]:
    """What stands in rain, where the puddles of a wet roundabout are."""
    ring = standing(junction.ring, asphalt, rate_mm_h, seed=seed32(seed, "roundabout", "ring"))
    parts = [bend(part, junction.ring) for part in ring]
    for number, road in enumerate(junction.arms):
        far = junction.radius + HOLD_M
        for part in standing(road, asphalt, rate_mm_h, seed=seed32(seed, "roundabout", "arm", number), low=far):
            t, s, h = part.points.T
            parts.append(bend(replace(part, points=np.c_[t + np.sign(t) * junction.spread(s), s, h]), road))
    return parts


# -- kerbs, pavements, islands


def _corner(junction: Roundabout, corner: int) -> list[Part]:
    """Kerb and pavement between two arms, lowered where people cross."""
    line, span = junction.outline, junction.outline.span(corner)
    points, normals, kerb = line.points[span], line.normals[span], line.kerb[span][:, None]
    wide = junction.pavement
    full = np.full_like(kerb, KERB_M)
    u = (BEHIND_KERB_M, BEHIND_KERB_M + RAMP_M, wide, wide)
    top = swept(
        points, normals, u, np.concatenate([kerb, full, full, full - 0.08], axis=1), "paving", tile_m=PAVING_TILE_M
    )
    return [_kerb(points, normals, kerb[:, 0]), top, *_tactile(junction, span)]


def _tactile(junction: Roundabout, span: slice) -> list[Part]:
    """Slabs with studs behind the lowered kerbs, 2 mm over the pavement."""
    line, parts = junction.outline, []
    for arm, road in enumerate(junction.arms):
        at = np.flatnonzero((line.arm[span] == arm) & (np.abs(line.station[span] - road.zebras[0]) < ZEBRA_HALF_M))
        if len(at) < 2:
            continue
        points, normals = line.points[span][at], line.normals[span][at]
        u = np.array([BEHIND_KERB_M + 0.02, BEHIND_KERB_M + 0.02 + TACTILE_M])
        kerb = line.kerb[span][at][:, None]
        heights = kerb + (KERB_M - kerb) * (u - BEHIND_KERB_M) / RAMP_M + 0.002
        parts.append(swept(points, normals, u, heights, "tactile", tile_m=TACTILE_M))
    return parts


def _closed_normals(points: Array) -> Array:
    """Unit normals to the right of a closed line whose last point is its first."""
    d = np.diff(points, axis=0)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    along = d + np.roll(d, 1, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    along = np.r_[along, along[:1]]
    return np.c_[along[:, 1], -along[:, 0]]


def _splitter(junction: Roundabout, arm: int, low: float, high: float) -> list[Part]:
    """One part of a splitter island: kerb all round, slabs on top."""
    ends = np.linspace(0.0, 1.0, 9) ** 2 * 1.2
    s = np.r_[low + ends, np.arange(low + 1.6, high - 1.5, 0.5), high - ends[::-1]]
    half = junction.half_width(low, high, s)
    t = np.r_[-half, half[::-1], -half[:1]]
    points = np.stack(junction.arms[arm].reference_line.place(np.r_[s, s[::-1], s[:1]], t), axis=1)
    normals = _closed_normals(points)
    inner = points + BEHIND_KERB_M * normals
    n = len(s)
    west, east = inner[:n], inner[n : 2 * n][::-1]
    rows = [np.c_[[a, b], [KERB_M, KERB_M]] for a, b in zip(west, east, strict=True)]
    return [_kerb(points, normals, KERB_M), textured_from_above(strip(rows, "paving"), PAVING_TILE_M)]


def _middle(junction: Roundabout) -> tuple[list[Part], Part, Part]:
    """Apron with its lip, kerb, and the island's grass."""
    angle = np.linspace(
        2 * np.pi, 0.0, round(2 * np.pi * junction.inner / FINE_M) + 1
    )  # clockwise: the island lies to the right
    round_ = np.c_[np.cos(angle), np.sin(angle)]
    apron = []
    if junction.apron:
        across = (0.0, 0.0, 0.03, junction.apron + 0.05)
        heights = (-0.02, APRON_LIP_M - 0.01, APRON_LIP_M, APRON_TOP_M)
        apron.append(
            textured_from_above(
                swept(junction.inner * round_, -round_, across, heights, "setts", tile_m=1.0), SETTS_TILE_M
            )
        )
    kerb = _kerb(junction.island * round_, -round_, KERB_M, junction.island_base)
    radius = np.linspace(junction.island - BEHIND_KERB_M, 0.02, max(6, round(junction.island / 0.6)))
    height = junction.middle(np.minimum(radius, junction.island - 1e-9))
    loops = [np.c_[r * round_, np.full(len(angle), h)] for r, h in zip(radius, height, strict=True)]
    return apron, kerb, textured_from_above(strip(loops[::-1], "grass"), GRASS_TILE_M)


# -- land


def _behind(junction: Roundabout, out: float, step: float) -> Array:
    """(N, 2) places `out` [m] behind every pavement about `step` [m] from each other; those that another kerb is nearer
    to are left out.
    """
    line, rows = junction.outline, []
    for corner in range(len(junction.arms)):
        span = line.span(corner)
        p = line.points[span] + (junction.pavement + out) * line.normals[span]
        at = np.r_[0.0, np.cumsum(np.hypot(*np.diff(p, axis=0).T))]
        n = max(2, round(at[-1] / step) + 1)
        rows.append(np.stack([np.interp(np.linspace(0, at[-1], n), at, p[:, k]) for k in (0, 1)], axis=1))
    points = np.concatenate(rows)
    u, _ = junction.across(points[:, 0], points[:, 1])
    return points[u > junction.pavement + 0.93 * out]


def ground(junction: Roundabout, horizon: Horizon) -> list[Part]:
    """Grass from the pavements to the horizon: triangles between points that lie closer together near the road."""
    line = junction.outline
    seam = []
    for corner in range(len(junction.arms)):
        span = line.span(corner)
        near = np.hypot(*line.points[span].T) < junction.radius + NEAR_M + 6.0
        keep = near & (np.arange(len(near)) % 2 == 0) | ~near
        keep[[0, -1]] = True
        seam.append((line.points[span] + junction.pavement * line.normals[span])[keep])
    ends = []
    for road in junction.arms:
        t = np.linspace(road.lane_section.low, road.lane_section.high, 8)[1:-1]
        ends.append(np.stack(road.reference_line.place(road.reference_line.length + 0.02, t), axis=1))
    rows = [_behind(junction, out, min(max(2.0, 0.5 * out), 7.0)) for out in OUT_M]
    reach = max(float(np.hypot(*junction.outline.points.T).max()), 150.0) + GRID_FROM_M
    axis = np.arange(-reach, reach + GRID_M, GRID_M)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    grid = (
        grid + np.random.Generator(np.random.PCG64(0)).uniform(-0.3, 0.3, grid.shape) * GRID_M
    )  # no rows that an eye would find
    u, _ = junction.across(grid[:, 0], grid[:, 1])
    grid = grid[u > junction.pavement + GRID_FROM_M]
    far = []
    radius = 1.45 * reach
    while radius < FAR_M * 1.1:
        angle = np.linspace(0, 2 * np.pi, 80, endpoint=False) + radius
        far.append(radius * np.c_[np.cos(angle), np.sin(angle)])
        radius *= 1.15
    points = np.concatenate([*seam, *ends, *rows, grid, *far])
    fixed = sum(len(p) for p in seam)
    faces = spatial.Delaunay(points).simplices.astype(np.int64)
    a, b, c = (points[faces[:, i]] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    faces = np.where(area[:, None] < 0, faces[:, ::-1], faces)
    middle = (a + b + c) / 3
    u, _ = junction.across(middle[:, 0], middle[:, 1])
    faces = faces[(u > junction.pavement) & (np.abs(area) > 1e-6)]
    u, _ = junction.across(points[:, 0], points[:, 1])
    z = junction.open_land(points[:, 0], points[:, 1], u) + horizon.relief(points[:, 0], points[:, 1], u)
    z[:fixed] = LAND_M
    return horizon.sown(textured_from_above(Part(np.c_[points, z], faces, "grass"), GRASS_TILE_M))


# -- plants that are sown


def sown(
    junction: Roundabout,
    *,
    seed: int,
    trees: int,
    trees_from_m: float,
    shrubs: int,
    tufts_per_m2: float,
    within_m: float,
) -> list[Scatter]:
    """Woods far from the road, shrubs on the middle island, tall grass on the land near the circle and on the
    island.
    """
    wood, bushes = _wood(junction, seed, trees, trees_from_m), _shrubs(junction, seed, shrubs)
    return [scatter for scatter in (wood, bushes, _tufts(junction, seed, tufts_per_m2, within_m)) if scatter]


def _wood(junction: Roundabout, seed: int, count: int, nearest_m: float) -> Scatter | None:
    rng = stream(seed, "roundabout", "wood")
    reach = float(np.hypot(*junction.outline.points.T).max()) + 60.0
    groups: list[Array] = []
    for _ in range(80):
        if sum(len(p) for p in groups) >= count:
            break
        n = int(rng.integers(4, 15))
        p = rng.uniform(-reach, reach, 2) + rng.normal(0, 14, (n, 2))
        u, _ = junction.across(p[:, 0], p[:, 1])
        groups.append(p[u > junction.pavement + nearest_m])
    points = np.concatenate(groups)[:count] if groups else np.zeros((0, 2))
    if not len(points):
        return None
    z = junction.height(points[:, 0], points[:, 1]) - 0.25
    models = mixture(seed)
    return Scatter(
        "Wood",
        "vegetation",
        (),
        np.c_[points, z],
        rng.uniform(0, 360, len(points)),
        rng.uniform(0.6, 1.15, len(points)),
        models,
        rng.integers(len(models), size=len(points)),
    )


def _shrubs(junction: Roundabout, seed: int, count: int) -> Scatter | None:
    """Low shrubs in beds round the middle of the island."""
    rng = stream(seed, "roundabout", "shrubs")
    room = 0.72 * junction.island
    if not count or room < 1.5:
        return None
    r, a = room * np.sqrt(rng.uniform(0.12, 1.0, count)), rng.uniform(0, 2 * np.pi, count)
    points = np.c_[r * np.cos(a), r * np.sin(a), junction.middle(r)]
    return Scatter(
        "Shrubs", "vegetation", land.shrub(), points, rng.uniform(0, 360, count), rng.uniform(0.8, 1.5, count)
    )


def _tufts(junction: Roundabout, seed: int, per_m2: float, within_m: float) -> Scatter | None:
    if not per_m2:
        return None
    rng = stream(seed, "roundabout", "tufts")
    far = junction.radius + within_m
    p = rng.uniform(-far, far, (int(per_m2 * 4 * far**2), 2))
    u, _ = junction.across(p[:, 0], p[:, 1])
    behind = np.clip((u - junction.pavement - 0.25) / 12.0, 0.0, 1.0)
    outside = (u > junction.pavement + 0.25) & (rng.random(len(p)) < 1.0 - behind)
    r = np.hypot(*p.T)
    keep = outside | ((r < junction.island - 0.4) & (rng.random(len(p)) < 0.4))
    p = p[keep & (r < far)]
    if not len(p):
        return None
    z = junction.height(p[:, 0], p[:, 1]) - 0.01
    return Scatter(
        "Grass", "terrain", land.tuft(), np.c_[p, z], rng.uniform(0, 360, len(p)), rng.uniform(0.5, 1.2, len(p))
    )

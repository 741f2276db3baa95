"""The land on both sides of a road: a strip that is swept along it, open land to the horizon, woods and grass.

Heights are `Road.ground`'s; meshes meet the road's edges exactly and sink under
each other where they overlap.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import stream
from synfog_usd.world.roads.horizon import LAND_M, Horizon, Scatter, mixture
from synfog_usd.world.roads.network import BEHIND_WALL_M, CUTTING_M, RIVER, Road
from synfog_usd.world.roads.surface import GRASS_TILE_M, stations
from synfog_usd.world.shapes import Part, quads, strip

NEAR_M = 60.0
OUT_M = (0.0, 0.4, 0.7, 1.6, 2.2, 4.2, 7.0, 12.0, 20.0, 32.0, 45.0, 60.0)
SUNK_M = 0.6
RIVER_M, WATER_M = 420.0, 0.3
MOWN_M = 1.6
"""Of the land beside a road, which is mown; beyond it is meadow.  One of `OUT_M`."""
MEADOW_M, MEADOW_PER_M2 = 36.0, 1.5
"""Clumps of tall grass grow so far beside a road, and so many of them there."""
GROWTH = 1.12
"""Of the open land's cells, one to the next."""


def reach(road: Road) -> float:
    """How far the swept strip goes [m] beyond the edges: it must not fold inside a bend."""
    return min(NEAR_M, 0.75 * road.reference_line.tightest - max(road.lane_section.high, -road.lane_section.low))


def land(road: Road, horizon: Horizon) -> list[Part]:
    """Strips on both sides, and the open land."""
    return [*_beside(road), *_open(road, horizon)]


def away(road: Road, x: Array, y: Array) -> Array:
    """How far places are from the road's edges, or beyond its ends [m]."""
    _, t = road.reference_line.nearest(x, y)
    return np.maximum(t - road.lane_section.high, road.lane_section.low - t)


def _along(road: Road) -> Array:
    s = stations(road)
    s = s[:: max(1, round(4.0 / (s[1] - s[0])))]
    extra = []
    if road.land.hill:
        extra += [road.land.hill[0] + BEHIND_WALL_M - 0.01, road.land.hill[0] + BEHIND_WALL_M + 0.01]
    return np.unique(np.concatenate([s, [road.reference_line.length], extra]))


def _beside(road: Road) -> list[Part]:
    s, far = _along(road), reach(road)
    bends = {*OUT_M, CUTTING_M} if road.land.hill else OUT_M
    out = np.array([o for o in sorted(bends) if o < far] + [far])
    parts = []
    mown, meadow = out[out <= MOWN_M], out[out >= MOWN_M]
    for t, material in (
        (road.lane_section.low - meadow[::-1], "meadow"),
        (road.lane_section.low - mown[::-1], "grass"),
        (road.lane_section.high + mown, "grass"),
        (road.lane_section.high + meadow, "meadow"),
    ):
        grid_s, grid_t = np.meshgrid(s, t, indexing="ij")
        x, y = road.reference_line.place(grid_s, grid_t)
        z = road.ground(grid_s, grid_t)
        points = np.stack([x, y, z], axis=-1)
        uv = points[..., :2] / GRASS_TILE_M
        parts.append(strip(list(points), material, uv=list(uv)))
    if road.land.hill:
        inside = s[s > road.land.hill[0] + BEHIND_WALL_M]
        t = np.array([road.lane_section.low, 0.0, road.lane_section.high])
        grid_s, grid_t = np.meshgrid(inside, t, indexing="ij")
        x, y = road.reference_line.place(grid_s, grid_t)
        z = np.repeat(road.ground(inside, road.lane_section.high + 1e-6)[:, None], 3, axis=1)
        points = np.stack([x, y, z], axis=-1)
        parts.append(strip(list(points), "meadow", uv=list(points[..., :2] / GRASS_TILE_M)))
    return parts


def _open(road: Road, horizon: Horizon) -> list[Part]:
    """A net that is finer near the road; without the cells that the strips cover."""
    s = np.linspace(0, road.reference_line.length, 200)
    x, y = road.reference_line.place(s, 0.0)
    axes = []
    for number, values in enumerate((x, y)):
        low, high = float(values.min()) - 90.0, float(values.max()) + 90.0
        middle = np.linspace(low, high, int((high - low) / 15.0) + 2)
        steps = np.cumsum(18.0 * GROWTH ** np.arange(60))
        steps = steps[steps < LAND_M]
        axes.append(horizon.snapped(np.concatenate([low - steps[::-1], middle, high + steps]), number))
    gx, gy = np.meshgrid(*axes)
    at, t = road.reference_line.nearest(gx, gy)
    in_length = (at > 0.5) & (at < road.reference_line.length - 0.5)
    out = np.maximum(t - road.lane_section.high, road.lane_section.low - t)
    z = road.ground(at, t) + horizon.relief(gx, gy, out)
    z = z - SUNK_M * np.clip((reach(road) + 30.0 - out) / 30.0, 0.0, 1.0)
    covered = in_length & (out < reach(road) - 1.0)
    points = np.stack([gx, gy, z], axis=-1)
    part = strip(list(points), "meadow", uv=list(points[..., :2] / GRASS_TILE_M))
    along, across = np.gradient(z, axes[1], axes[0])
    normals = np.stack([-across, -along, np.ones_like(z)], axis=-1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return horizon.sown(part, normals, np.asarray(~covered.ravel()[part.faces].all(axis=1)))


def river(road: Road, horizon: Horizon) -> Part:
    """The water at the bottom of the valley, as far as one sees along it."""
    assert road.land.valley is not None
    a, b, _ = road.land.valley
    t = np.linspace(-RIVER_M, RIVER_M, 41)
    middle = 0.06 * (b - a) * np.sin(t / 55.0)
    half = 0.5 * RIVER * (b - a) * (1 + 0.12 * np.sin(t / 17.0))
    x0, y0 = road.reference_line.place((a + b) / 2, 0.0)
    heading = road.reference_line.heading((a + b) / 2)
    loops = []
    for side in (-1, 1):
        along = middle + side * half
        x = x0 + t * np.cos(heading) - along * np.sin(heading)
        y = y0 + t * np.sin(heading) + along * np.cos(heading)
        z = road.valley_floor + WATER_M + horizon.relief(x, y, away(road, x, y))
        loops.append(np.c_[x, y, z])
    part = strip(loops, "water")
    up = np.cross(*(part.points[part.faces[0, 1:]] - part.points[part.faces[0, 0]]))[2] > 0
    return part if up else replace(part, faces=part.faces[:, ::-1])


def wood(road: Road, *, seed: int, count: int, nearest_m: float) -> Scatter:
    """Trees in the distance, in groups of mostly one kind."""
    rng = stream(seed, "land", "wood")
    points: list[tuple[float, float, float]] = []
    sizes: list[float] = []
    which: list[int] = []
    models = mixture(seed)
    for _ in range(60):
        if len(points) >= count:
            break
        s, side = rng.uniform(-60, road.reference_line.length + 160), rng.choice((-1, 1))
        out = nearest_m + 160.0 * rng.random() ** 1.6
        n = int(rng.integers(4, 15))
        base = road.lane_section.high if side > 0 else road.lane_section.low
        cx, cy = road.reference_line.place(s, base + side * out)
        dx, dy = rng.normal(0, 14, n), rng.normal(0, 14, n)
        at, t = road.reference_line.nearest(cx + dx, cy + dy)
        clear = np.maximum(t - road.lane_section.high, road.lane_section.low - t) > nearest_m * 0.8
        clear &= ~road.flooded(cx + dx, cy + dy)
        height = road.ground(at, t)
        big = rng.uniform(0.6, 1.15, n)
        kind = np.where(rng.random(n) < 0.6, rng.integers(len(models)), rng.integers(len(models), size=n))
        for i in np.flatnonzero(clear):
            points.append((float(cx + dx[i]), float(cy + dy[i]), float(height[i]) - 0.1))
            sizes.append(float(big[i]))
            which.append(int(kind[i]))
    return Scatter(
        "Wood",
        "vegetation",
        (),
        np.array(points).reshape(-1, 3),
        rng.uniform(0, 360, len(points)),
        np.array(sizes),
        models,
        np.array(which, dtype=np.int64),
    )


def shrub() -> tuple[Part, ...]:
    """A shrub 0.9 m high and 1.2 m wide: a dark core, and leaves in two tones on boughs that hide it to the ground."""
    rng = stream(0, "land", "shrub")
    columns, boughs, leaves = 9, 54, 24
    core = []
    for radius, height in ((0.26, 0.0), (0.32, 0.18), (0.30, 0.38), (0.19, 0.54), (0.0, 0.60)):
        b = np.linspace(0, 2 * np.pi, columns, endpoint=False)
        r = radius * (1 + 0.15 * rng.standard_normal(columns))
        core.append(np.c_[r * np.cos(b), r * np.sin(b), np.full(columns, height)])
    parts = [strip(core, "hedge", closed=True)]
    turn, lift = rng.uniform(0, 2 * np.pi, boughs), np.arcsin(rng.uniform(-0.62, 1.0, boughs))
    ways = np.c_[np.cos(turn) * np.cos(lift), np.sin(turn) * np.cos(lift), np.sin(lift)]
    tips = ways * rng.uniform(0.36, 0.60, (boughs, 1)) * (1, 1, 0.85) + (0, 0, 0.36)
    places = (tips[:, None] + rng.normal(0, 0.085, (boughs, leaves, 3))).reshape(-1, 3)
    places[:, 2] = np.maximum(places[:, 2], 0.03)
    along = np.repeat(ways, leaves, axis=0) + 0.8 * rng.standard_normal((len(places), 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.standard_normal(along.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    half = 0.5 * rng.uniform(0.06, 0.11, (len(places), 1))
    corners = np.stack(
        [places - half * along, places + 0.55 * half * across, places + half * along, places - 0.55 * half * across],
        axis=1,
    )
    tone = np.repeat(rng.random(boughs) < 0.6, leaves) ^ (rng.random(len(places)) < 0.2)
    return (*parts, quads(corners[tone], "leaf_green"), quads(corners[~tone], "leaf_olive"))


def tufts(road: Road, *, seed: int, low: float, high: float, per_m2: float = 1.2) -> Scatter | None:
    """Tall grass on verges and beside the road, where the camera is near enough to see blades."""
    rng = stream(seed, "land", "tufts")
    points: list[Array] = []
    strips = [(lane.low, lane.high) for lane in road.lane_section.of("verge", "reserve")]
    if road.lane_section.lanes[0].kind == "verge":
        strips.append((road.lane_section.low - 5.0, road.lane_section.low))
    if road.lane_section.lanes[-1].kind == "verge":
        strips.append((road.lane_section.high, road.lane_section.high + 5.0))
    for a, b in strips:
        n = int(per_m2 * (b - a) * (high - low))
        s = low + (high - low) * rng.random(n) ** 1.7
        t = rng.uniform(a + 0.12, b - 0.02, n)
        keep = (s > 0) & (s < road.reference_line.length)
        if road.land.valley:
            keep &= (s < road.land.valley[0]) | (s > road.land.valley[1])
        if road.land.hill:
            keep &= s < road.land.hill[0] - 1.0
        s, t = s[keep], t[keep]
        x, y = road.reference_line.place(s, t)
        points.append(np.c_[x, y, road.ground(s, t) - 0.01])
    if not points:
        return None
    every = np.concatenate(points)
    return Scatter(
        "Grass", "terrain", tuft(), every, rng.uniform(0, 360, len(every)), rng.uniform(0.5, 1.25, len(every))
    )


def meadow(road: Road, *, seed: int, low: float, high: float, houses: Array) -> Scatter | None:
    """Clumps of tall grass on the land beside the road, thick in some places and thin in others.

    Args:
        road: beside which they grow, beyond what is mown.
        seed: of the draw.
        low, high: stations between which they grow [m].
        houses: (N, 3) x, y and radius [m] of where they do not.
    """
    rng = stream(seed, "land", "meadow")
    far = min(MEADOW_M, reach(road))
    n = int(MEADOW_PER_M2 * 2 * (far - MOWN_M) * (high - low))
    s = low + (high - low) * rng.random(n) ** 1.5
    out = MOWN_M + (far - MOWN_M) * rng.random(n) ** 1.4
    on_left = rng.random(n) < 0.5
    t = np.where(on_left, road.lane_section.low - out, road.lane_section.high + out)
    phase = rng.uniform(0, 2 * np.pi, 4)
    thick = np.sin(0.41 * s + 0.23 * t + phase[0]) + np.sin(0.13 * s - 0.37 * t + phase[1])
    thick += np.sin(0.9 * t + phase[2]) * np.sin(0.7 * s + phase[3])
    keep = (rng.random(n) < np.clip(0.55 + 0.35 * thick, 0.08, 1.0)) & (s > 0) & (s < road.reference_line.length)
    if road.land.hill:
        keep &= s < road.land.hill[0] - 0.5
    s, t = s[keep], t[keep]
    x, y = road.reference_line.place(s, t)
    dry = ~road.flooded(x, y)
    for hx, hy, radius in houses:
        dry &= np.hypot(x - hx, y - hy) > radius
    points = np.c_[x, y, road.ground(s, t) - 0.02][dry]
    if not len(points):
        return None
    turns, sizes = rng.uniform(0, 360, len(points)), rng.uniform(0.6, 1.5, len(points))
    return Scatter("Meadow", "terrain", tuft(46, 0.26, (0.08, 0.40)), points, turns, sizes)


def tuft(blades: int = 23, spread: float = 0.11, high: tuple[float, float] = (0.10, 0.30)) -> tuple[Part, ...]:
    """Blades of grass in three colours, so many, so far from the middle and so high [m]."""
    rng = stream(0, "land", "tuft")
    parts = []
    for material, n in (
        ("leaf_olive", 9 * blades // 23),
        ("leaf_green", 9 * blades // 23),
        ("straw", 5 * blades // 23),
    ):
        points, faces = [], []
        for k in range(n):
            x, y, angle = rng.normal(0, spread), rng.normal(0, spread), rng.uniform(0, np.pi)
            dx, dy, w, h = rng.normal(0, 0.07), rng.normal(0, 0.07), rng.uniform(0.004, 0.009), rng.uniform(*high)
            points += [
                (x - w * np.cos(angle), y - w * np.sin(angle), 0.0),
                (x + w * np.cos(angle), y + w * np.sin(angle), 0.0),
                (x + dx, y + dy, h),
            ]
            faces.append((3 * k, 3 * k + 1, 3 * k + 2))
        parts.append(Part(np.array(points), np.array(faces), material))
    return tuple(parts)

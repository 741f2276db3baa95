"""The land on both sides of a road: a strip that is swept along it, open land to the horizon, woods and grass.

Heights are `Road.ground`'s; meshes meet the road's edges exactly and sink under
each other where they overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synfog_usd.seeds import stream
from synfog_usd.world.roads.network import BEHIND_WALL_M, Road
from synfog_usd.world.roads.surface import GRASS_TILE_M, stations
from synfog_usd.world.shapes import Array, Part, by_material, shift, strip, tube
from synfog_usd.world.shapes import scale as scaled

FAR_M = 1600.0
NEAR_M = 60.0
OUT_M = (0.0, 0.7, 1.6, 3.5, 7.0, 12.0, 20.0, 32.0, 45.0, 60.0)
SUNK_M = 0.6


@dataclass(frozen=True)
class Scatter:
    """Many of the same: one prototype, and where it stands.

    Attributes:
        name, label: of the prim.
        parts: of the prototype.
        points: (N, 3) [m]; turns: (N,) degrees; sizes: (N,) scale.
    """

    name: str
    label: str
    parts: tuple[Part, ...]
    points: Array
    turns: Array
    sizes: Array


def reach(road: Road) -> float:
    """How far the swept strip goes [m] beyond the edges: it must not fold inside a bend."""
    return min(NEAR_M, 0.75 * road.reference_line.tightest - max(road.lane_section.high, -road.lane_section.low))


def land(road: Road) -> list[Part]:
    """Strips on both sides, and the open land."""
    return [*_beside(road), _open(road)]


def _along(road: Road) -> Array:
    s = stations(road)
    s = s[:: max(1, round(4.0 / (s[1] - s[0])))]
    extra = []
    if road.land.hill:
        extra += [road.land.hill[0] + BEHIND_WALL_M - 0.01, road.land.hill[0] + BEHIND_WALL_M + 0.01]
    return np.unique(np.concatenate([s, [road.reference_line.length], extra]))


def _beside(road: Road) -> list[Part]:
    s, far = _along(road), reach(road)
    out = np.array([o for o in OUT_M if o < far] + [far])
    parts = []
    for t in (road.lane_section.low - out[::-1], road.lane_section.high + out):
        grid_s, grid_t = np.meshgrid(s, t, indexing="ij")
        x, y = road.reference_line.place(grid_s, grid_t)
        z = road.ground(grid_s, grid_t)
        points = np.stack([x, y, z], axis=-1)
        uv = points[..., :2] / GRASS_TILE_M
        parts.append(strip(list(points), "grass", uv=list(uv)))
    if road.land.hill:
        inside = s[s > road.land.hill[0] + BEHIND_WALL_M]
        t = np.array([road.lane_section.low, 0.0, road.lane_section.high])
        grid_s, grid_t = np.meshgrid(inside, t, indexing="ij")
        x, y = road.reference_line.place(grid_s, grid_t)
        z = np.repeat(road.ground(inside, road.lane_section.high + 1e-6)[:, None], 3, axis=1)
        points = np.stack([x, y, z], axis=-1)
        parts.append(strip(list(points), "grass", uv=list(points[..., :2] / GRASS_TILE_M)))
    return parts


def _open(road: Road) -> Part:
    """A net that is finer near the road; without the cells that the strips cover."""
    s = np.linspace(0, road.reference_line.length, 200)
    x, y = road.reference_line.place(s, 0.0)
    axes = []
    for values in (x, y):
        low, high = float(values.min()) - 90.0, float(values.max()) + 90.0
        middle = np.linspace(low, high, int((high - low) / 15.0) + 2)
        steps = np.cumsum(18.0 * 1.35 ** np.arange(24))
        steps = steps[steps < FAR_M]
        axes.append(np.concatenate([low - steps[::-1], middle, high + steps]))
    gx, gy = np.meshgrid(*axes)
    at, t = road.reference_line.nearest(gx, gy)
    z = road.ground(at, t)
    beside = (at > 0.5) & (at < road.reference_line.length - 0.5)
    away = np.maximum(t - road.lane_section.high, road.lane_section.low - t)
    z = z - SUNK_M * np.clip((reach(road) + 30.0 - away) / 30.0, 0.0, 1.0)
    covered = beside & (away < reach(road) - 1.0)
    points = np.stack([gx, gy, z], axis=-1)
    part = strip(list(points), "grass", uv=list(points[..., :2] / GRASS_TILE_M))
    keep = ~covered.ravel()[part.faces].all(axis=1)
    used, faces = np.unique(part.faces[keep], return_inverse=True)
    assert part.uv is not None
    return Part(part.points[used], faces.reshape(-1, 3), "grass", part.uv[used])


def wood(road: Road, *, seed: int, count: int, nearest_m: float) -> Scatter:
    """Trees in the distance, in groups: crowns of lumps, seen from beyond 60 m."""
    rng = stream(seed, "land", "wood")
    points: list[tuple[float, float, float]] = []
    sizes: list[float] = []
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
        height = road.ground(at, t)
        big = rng.uniform(0.75, 1.35, n)
        for i in np.flatnonzero(clear):
            points.append((float(cx + dx[i]), float(cy + dy[i]), float(height[i]) - 0.1))
            sizes.append(float(big[i]))
    return Scatter(
        "Wood",
        "vegetation",
        distant_tree(),
        np.array(points).reshape(-1, 3),
        rng.uniform(0, 360, len(points)),
        np.array(sizes),
    )


def distant_tree() -> tuple[Part, ...]:
    """A trunk and lumps of leaves in three greens, about 800 triangles."""
    rng = stream(0, "land", "tree")
    parts: list[Part] = [tube([(0, 0, -0.3), (0.1, 0, 2.5), (0, 0.1, 6.0)], [0.28, 0.22, 0.1], "bark", sides=6)]
    for k in range(11):
        angle, high = rng.uniform(0, 2 * np.pi), rng.uniform(3.6, 9.0)
        away = rng.uniform(0.3, 2.3) * (1.0 - abs(high - 5.6) / 6.5)
        size = rng.uniform(1.3, 2.1) * (1.0 if high < 7.5 else 0.75)
        leaves = lump(rng, ("leaf_green", "hedge", "leaf_olive")[k % 3])
        parts.append(
            leaves.moved(shift(away * np.cos(angle), away * np.sin(angle), high) @ scaled(size, size, 0.8 * size))
        )
    return tuple(by_material(parts).values())


def lump(rng: np.random.Generator, material: str) -> Part:
    """A ball of 96 triangles with a rough skin."""
    rows, columns = 7, 8
    loops = []
    for i in range(rows):
        a = -np.pi / 2 + np.pi * i / (rows - 1)
        r = np.cos(a) * (1 + 0.28 * rng.standard_normal(columns)).clip(0.55, 1.5)
        b = np.linspace(0, 2 * np.pi, columns, endpoint=False) + rng.normal(0, 0.15, columns)
        loops.append(
            np.c_[r * np.cos(b), r * np.sin(b), np.sin(a) + 0.12 * rng.standard_normal(columns) * (0 < i < rows - 1)]
        )
    return strip(loops, material, closed=True)


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


def tuft() -> tuple[Part, ...]:
    """Blades of grass in three colours, 10 to 30 cm high."""
    rng = stream(0, "land", "tuft")
    parts = []
    for material, n in (("leaf_olive", 9), ("leaf_green", 9), ("straw", 5)):
        points, faces = [], []
        for k in range(n):
            x, y, angle = rng.normal(0, 0.11), rng.normal(0, 0.11), rng.uniform(0, np.pi)
            dx, dy, w, h = rng.normal(0, 0.07), rng.normal(0, 0.07), rng.uniform(0.004, 0.009), rng.uniform(0.10, 0.30)
            points += [
                (x - w * np.cos(angle), y - w * np.sin(angle), 0.0),
                (x + w * np.cos(angle), y + w * np.sin(angle), 0.0),
                (x + dx, y + dy, h),
            ]
            faces.append((3 * k, 3 * k + 1, 3 * k + 2))
        parts.append(Part(np.array(points), np.array(faces), material))
    return tuple(parts)

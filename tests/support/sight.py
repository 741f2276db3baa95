"""Who is seen from a camera, by another way than the composer's: plan views in shapely, heights along them.

Shares nothing with `synfog_usd.world.roads.rules`: sizes and labels are read from the models' stages, a line of sight
is cut with footprints in the plane (GEOS), and what is left of it is compared with heights.  Silhouettes are sampled by
64 points where the composer takes six.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
import shapely
from pxr import Usd, UsdGeom
from shapely import affinity

ROOT = Path(__file__).resolve().parents[2]
USERS = {"person", "rider", "car", "truck", "bus", "motorcycle", "bicycle"}
OPAQUE = USERS | {"building", "wall"}
SIDE = 8
SEEN = 0.1
"""The composer promises 30 % by six rays, three of which end at nine tenths of the height: of a car whose roof alone
shows that is half, in truth an eighth.
"""
NARROW_M = 0.3
"""Half of what somebody on foot is taken to hide: arms and legs leave gaps."""


@functools.cache
def model(asset: str) -> tuple[np.ndarray, np.ndarray, str]:
    """Low and high corner [m] and Cityscapes class of a model, from its stage."""
    stage = Usd.Stage.Open(str(ROOT / "assets" / "models" / asset / f"{asset}.usda"))
    prim = stage.GetDefaultPrim()
    bound = (
        UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"]).ComputeWorldBound(prim).ComputeAlignedRange()
    )
    return (
        np.array(bound.GetMin()),
        np.array(bound.GetMax()),
        next(iter(prim.GetAttribute("semantics:labels:cityscapes").Get())),
    )


def on_the_ground(p) -> shapely.Polygon:
    """Footprint of a placement [m]."""
    low, high, label = model(p.asset)
    if label == "person" and high[1] - low[1] < 1.05:
        low, high = np.full(3, -NARROW_M), np.array([NARROW_M, NARROW_M, high[2]])
    flat = affinity.scale(shapely.box(low[0], low[1], high[0], high[1]), p.size, p.size, origin=(0, 0))
    return affinity.translate(affinity.rotate(flat, p.heading, origin=(0, 0)), p.x, p.y)


def shares(world, *, within_m: float, enough: int | None = None) -> dict[str, float]:
    """Share of each road user in the picture that opaque things and the ground leave free, by name; ends when `enough`
    are SEEN, the nearest first.
    """
    eye = np.array([world.view.x, world.view.y, world.view.z])
    half_view = math.atan(0.36 / 2 / world.view.focal_length)
    near = [
        p
        for p in world.placed
        if math.hypot(p.x - eye[0], p.y - eye[1]) < within_m + 60.0 and model(p.asset)[2] in OPAQUE
    ]
    prints = [on_the_ground(p) for p in near]
    tree = shapely.STRtree(prints)
    found = {}
    for p, outline in sorted(
        zip(near, prints, strict=True), key=lambda pair: math.hypot(pair[0].x - eye[0], pair[0].y - eye[1])
    ):
        dx, dy = p.x - eye[0], p.y - eye[1]
        away, bearing = math.hypot(dx, dy), math.atan2(-dx, dy)  # counter-clockwise from +Y
        off = (bearing - math.radians(world.view.heading) + math.pi) % (2 * math.pi) - math.pi
        if model(p.asset)[2] not in USERS or away > within_m or abs(off) >= half_view or away * math.cos(off) <= 2.0:
            continue
        across = np.array([-dy, dx]) / away
        reach = np.abs((np.array(outline.exterior.coords) - (p.x, p.y)) @ across).max()
        steps = (np.arange(SIDE) + 0.5) / SIDE
        ends = np.array([p.x, p.y]) + ((2 * steps - 1) * reach)[:, None] * across
        tops = p.z + steps * model(p.asset)[1][2] * p.size
        free = np.ones((SIDE, SIDE), dtype=bool)  # column, height
        for column, end in enumerate(ends):
            line = shapely.LineString([eye[:2], end])
            for index in tree.query(line, predicate="intersects"):
                other = near[index]
                if math.hypot(other.x - p.x, other.y - p.y) < 1e-6:
                    continue  # itself, or who rides it
                cut = line.intersection(prints[index])
                if cut.is_empty or cut.length < 1e-6:
                    continue
                at = np.array([line.project(shapely.Point(c)) for c in cut.coords]) / line.length
                z = eye[2] + at[:, None] * (tops - eye[2])
                free[column] &= (z.max(axis=0) < other.z) | (
                    z.min(axis=0) > other.z + model(other.asset)[1][2] * other.size
                )
        path = np.linspace(0.03, 0.95, 40)
        x, y = (eye[k] + path[:, None] * (ends[:, k] - eye[k]) for k in (0, 1))
        ground = np.asarray(world.road.height(x, y))  # (along, column)
        free &= (eye[2] + path[:, None, None] * (tops - eye[2]) > ground[:, :, None] - 0.03).all(axis=0)
        found[p.name] = float(free.mean())
        if sum(share >= SEEN for share in found.values()) == enough:
            break
    return found

"""Lanes in a camera's view: which lane each pixel of the ground lies in, and where the edges run in the picture.

Of the ray through a pixel's centre, as all labels.  The ground is what is labelled road, parking or ground and lies at
the height of a lane.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from synfog_usd.base.arrays import Array, Flags, Indices
from synfog_usd.dataset import masks
from synfog_usd.dataset.objects import Projection
from synfog_usd.render.film.aovs import Aovs
from synfog_usd.scene import Lanelet, SceneDict

GROUND = ("road", "parking", "ground")
DRIVABLE = ("driving", "bus")
"""Types of lanes that are the drivable area."""
OFF_M = 0.3
"""Height over a lane within which ground counts as its own; a bridge over it is farther."""
STEP_M = 1.0
"""Between points of an edge that are bent by a lens, or asked for their height."""

Bend = Callable[[Array], Array]
"""(N, 2) places in the rendered picture -> places in the picture, both from its corner [px]."""


def ids(aov: Aovs, scene: SceneDict) -> Indices:
    """(H, W) number of the lane that a pixel lies in, 1 for the first of `scene.lanes`; 0 for none.  Where lanes cross,
    the first has it.

    Args:
        aov: through the scene's own camera.
        scene: with lanes.
    """
    lane_ids = np.zeros(aov.instance_id.shape, dtype=np.int64)
    ground = np.array([False, *(instance.label in GROUND for instance in scene.instances)])[aov.instance_id]
    ground &= np.isfinite(aov.depth_m)
    places, of = _places(aov, scene, ground), np.zeros(int(ground.sum()), dtype=np.int64)
    for number, lane in enumerate(scene.lanes, 1):
        free = np.flatnonzero(of == 0)
        inside = free[shapely.contains_xy(_area(lane), *places[free, :2].T)]
        if len(inside):
            edges = np.concatenate([_fine(lane.left), _fine(lane.right)])
            near = edges[cKDTree(edges[:, :2]).query(places[inside, :2])[1], 2]
            of[inside[np.abs(places[inside, 2] - near) < OFF_M]] = number
    lane_ids[ground] = of
    return lane_ids


def rows(plane: Indices, scene: SceneDict, bend: Bend | None = None) -> list[dict[str, Any]]:
    """What labels.json says of each lane: edges in the stage [m] and in the picture [px], pixels of it that are seen.

    Args:
        plane: of `ids`, in the picture's own pixels.
        scene: with lanes.
        bend: from the scene's own picture to that one, where a lens distorts.
    """
    view = Projection.of(scene.camera)
    eye, origin = shapely.Point(scene.camera.to_world[:2, 3]), np.asarray(scene.origin_m)
    lines = []
    for number, lane in enumerate(scene.lanes, 1):
        row: dict[str, Any] = {"id": number, "path": lane.path, "type": lane.type, "drivable": lane.type in DRIVABLE}
        row["ego"] = bool(_area(lane).contains(eye))
        pixels = np.flatnonzero(plane == number)
        row["pixels"] = len(pixels)
        if len(pixels):
            row["rle"] = masks.encode(pixels, *plane.shape)
        for side, points in (("left", lane.left), ("right", lane.right)):
            row[f"{side}_world_m"] = np.round(points + origin, 3).tolist()
            row[f"{side}_px"] = [np.round(piece, 2).tolist() for piece in _drawn(points, view, plane.shape[::-1], bend)]
        lines.append(row)
    return lines


def _area(lane: Lanelet) -> shapely.Polygon:
    area = shapely.Polygon(np.concatenate([lane.left, lane.right[::-1]])[:, :2])
    return area if area.is_valid else area.buffer(0.0)


def _places(aov: Aovs, scene: SceneDict, where: Flags) -> Array:
    """(N, 3) what some pixels see, in the scene [m]."""
    view = Projection.of(scene.camera)
    row, column = np.nonzero(where)
    if scene.camera.fisheye is not None:
        size = np.array([view.width_px, view.height_px])
        ways = scene.camera.directions((np.c_[column, row] + 0.5) / size)
        return np.asarray(ways * aov.distance_m[where][:, None] + scene.camera.to_world[:3, 3])
    depth = aov.depth_m[where].astype(np.float64)
    across = (np.c_[column, row] + 0.5 - np.array(view.axis_px)) / view.scale_px
    if not scene.camera.width_m:
        across = across * depth[:, None]
    return np.asarray(np.c_[across, depth] @ view.rotation + scene.camera.to_world[:3, 3])


def _drawn(points: Array, view: Projection, size_px: tuple[int, ...], bend: Bend | None) -> list[Array]:
    """Pieces of an edge within the picture, each (N, 2)."""
    straight = bend is None and view.camera.fisheye is None
    projected = _projected(points if straight else _fine(points), view)
    pieces = [piece for line in projected for piece in _clipped(line, (view.width_px, view.height_px))]
    if bend is None:
        return pieces
    return [piece for line in pieces for piece in _clipped(bend(line), size_px)]


def _projected(points: Array, view: Projection) -> list[Array]:
    """Lines of a polyline that lie before the camera, each (N, 2) [px]."""
    local, near = view.local(points), max(view.camera.near_m, 0.05)
    if view.camera.fisheye is not None:
        shown = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2]) <= view.camera.fisheye.reach_rad
        runs = np.split(np.arange(len(local)), np.flatnonzero(np.diff(shown)) + 1)
        return [view.places_px(local[run]) for run in runs if shown[run[0]] and len(run) > 1]
    lines: list[list[Array]] = [[]]
    for start, stop in itertools.pairwise(local):
        if max(start[2], stop[2]) <= near:
            continue
        begin, end = start, stop
        if min(start[2], stop[2]) < near:
            cut = start + (near - start[2]) / (stop[2] - start[2]) * (stop - start)
            begin, end = (cut, stop) if start[2] < near else (start, cut)
        if not lines[-1] or not np.array_equal(lines[-1][-1], begin):
            lines.append([begin])
        lines[-1].append(end)
    pieces = [np.array(line) for line in lines if line]
    return [view.places_px(line) for line in pieces]


def _clipped(line: Array, size_px: tuple[int, ...]) -> list[Array]:
    cut = shapely.intersection(shapely.LineString(line), shapely.box(0.0, 0.0, *size_px))
    parts = shapely.get_parts(cut)
    return [shapely.get_coordinates(part) for part in parts if part.geom_type == "LineString" and not part.is_empty]


def _fine(points: Array) -> Array:
    """A polyline with points every STEP_M and at its corners."""
    at = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    s = np.union1d(at, np.arange(0.0, at[-1], STEP_M))
    return np.stack([np.interp(s, at, axis) for axis in points.T], axis=1)

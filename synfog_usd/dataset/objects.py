"""What is known of each instance besides its visible pixels: its whole outline, its box in space, its pose.

Takes a scene and what the rays through its pixels' centres pierce; gives rows for `labels.json`.  The camera's axes are
OpenCV's here: x right, y down, z forward.  The centre of a picture's first pixel is at
(0.5, 0.5); a camera matrix has it at (0, 0), as OpenCV does.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from synfog_usd.base.arrays import Array, Indices, extent
from synfog_usd.dataset import masks
from synfog_usd.dataset.labels import shown_of
from synfog_usd.scene import Camera, SceneDict, prototype_of

TO_OPENCV = np.diag([1.0, -1.0, -1.0])
"""USD's camera looks down its -Z with +Y up."""


EDGE_STEP_RAD, EDGE_STEPS = 0.02, 32
"""Edges that a fisheye sees under a larger angle are followed in so many steps."""


@dataclass(frozen=True)
class Solid:
    """Points whose convex hull is that of an instance's geometry, and the edges between them.

    Attributes:
        points: (N, 3) in the scene [m].
        edges: (M, 2) rows of `points`.
    """

    points: Array
    edges: Indices


def solids(scene: SceneDict, chosen: Collection[int] | None = None) -> dict[int, Solid]:
    """The geometry of each instance, by label id; of meshes and spheres.

    Args:
        scene: that they stand in.
        chosen: label ids that are asked for; all without.
    """
    prototypes: dict[tuple[str, str], Solid] = {}
    by_id: dict[int, list[Solid]] = {}
    for (key, *inner), instance in scene.instance_of.items():
        part = scene.world.get(key)
        if part is None or (chosen is not None and instance not in chosen):
            continue
        if not inner:
            solid = _solid(part)
        else:
            group = prototype_of(part)
            prototype = prototypes.get((group, inner[0]))
            if prototype is None:
                prototype = prototypes[group, inner[0]] = _hull(_solid(scene.world[group][inner[0]]))
            matrix = np.asarray(part["to_world"], dtype=np.float64)
            solid = Solid(prototype.points @ matrix[:3, :3].T + matrix[:3, 3], prototype.edges)
        if len(solid.points):
            by_id.setdefault(instance, []).append(solid)
    return {instance: _together(parts) for instance, parts in by_id.items()}


def _solid(shape: Mapping[str, Any]) -> Solid:
    if shape["type"] == "mesh":
        faces = np.asarray(shape["faces"], dtype=np.int64)
        used, renumbered = np.unique(faces, return_inverse=True)  # points of no face are not drawn
        faces = renumbered.reshape(-1, 3)
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        return Solid(np.asarray(shape["positions"], dtype=np.float64)[used], edges)
    if shape["type"] == "sphere":
        import trimesh

        ball = trimesh.creation.icosphere(subdivisions=4)  # 0.1 % of its radius within
        matrix = np.asarray(shape.get("to_world", np.eye(4)), dtype=np.float64)
        local = np.asarray(shape.get("center", (0.0, 0.0, 0.0))) + float(shape.get("radius", 1.0)) * ball.vertices
        return Solid(local @ matrix[:3, :3].T + matrix[:3, 3], np.asarray(ball.edges_unique, dtype=np.int64))
    return Solid(np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64))


def _hull(solid: Solid) -> Solid:
    """The corners of its convex hull; the solid itself where it is flat, or small."""
    from scipy.spatial import ConvexHull, QhullError

    if len(solid.points) < 64:
        return solid
    try:
        hull = ConvexHull(solid.points)
    except QhullError:
        return solid
    number = np.zeros(len(solid.points), dtype=np.int64)
    number[hull.vertices] = np.arange(len(hull.vertices))
    faces = number[hull.simplices]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return Solid(solid.points[hull.vertices], edges)


def _together(parts: list[Solid]) -> Solid:
    starts = np.cumsum([0, *(len(part.points) for part in parts[:-1])])
    return Solid(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.edges + start for part, start in zip(parts, starts, strict=True)]),
    )


@dataclass(frozen=True)
class Projection:
    """Where a camera without distortion, or a fisheye, puts points.

    Attributes:
        camera: whose place and kind count.
        width_px, height_px: of the picture.
        scale_px: focal length [px]; of an orthographic camera pixels a metre, of a fisheye pixels a radian at its axis.
        axis_px: column and row at which the axis meets the picture, from its corner [px].
    """

    camera: Camera
    width_px: int
    height_px: int
    scale_px: float
    axis_px: tuple[float, float]

    @classmethod
    def of(cls, camera: Camera) -> Projection:
        """The view of a camera in its own picture."""
        width, height, (right, up) = camera.width_px, camera.height_px, camera.axis_shift
        axis_px = (0.5 + right) * width, (0.5 - up) * height
        if camera.width_m > 0.0:
            return cls(camera, width, height, width / camera.width_m, axis_px)
        return cls(camera, width, height, 1.0 / camera.pixel_rad, axis_px)

    @property
    def rotation(self) -> Array:
        """(3, 3) from the scene's axes to the camera's."""
        return np.asarray(TO_OPENCV @ self.camera.to_world[:3, :3].T)

    def local(self, points: Array) -> Array:
        """(N, 3) points of the scene in the camera's axes [m]."""
        return np.asarray((points - self.camera.to_world[:3, 3]) @ self.rotation.T)

    def places_px(self, local: Array) -> Array:
        """(N, 2) places [px] from the picture's corner of points (N, 3) in the camera's axes, before it unless it is a
        fisheye.
        """
        if self.camera.fisheye is not None:
            return np.asarray(self.camera.fisheye.places(local) * self.width_px + np.array(self.axis_px))
        depth = 1.0 if self.camera.width_m > 0.0 else local[:, 2:]
        return np.asarray(self.scale_px * local[:, :2] / depth + np.array(self.axis_px))

    def box_px(self, solid: Solid) -> tuple[float, float, float, float] | None:
        """Left, top, right and bottom [px] of all that lies before the camera, beyond the picture's border too; None
        where nothing does.
        """
        points, near = self.local(solid.points), max(self.camera.near_m, 1e-3)
        if self.camera.fisheye is not None:
            return self._curved_box_px(points, solid.edges)
        before = points[:, 2] >= near
        if not before.all():
            starts, ends = points[solid.edges[:, 0]], points[solid.edges[:, 1]]
            cut = before[solid.edges[:, 0]] != before[solid.edges[:, 1]]
            starts, ends = starts[cut], ends[cut]
            share = (near - starts[:, 2]) / (ends[:, 2] - starts[:, 2])
            points = np.concatenate([points[before], starts + share[:, None] * (ends - starts)])
        if not len(points):
            return None
        if not self.camera.width_m > 0.0:
            points[:, 2] = np.maximum(points[:, 2], near)
        x, y = self.places_px(points).T
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    def _curved_box_px(self, points: Array, edges: Indices) -> tuple[float, float, float, float] | None:
        """As `box_px`, for a fisheye: straight edges are curves in its picture, and are followed in small steps."""
        assert self.camera.fisheye is not None
        ways = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12)
        apart = np.linalg.norm(ways[edges[:, 0]] - ways[edges[:, 1]], axis=1)
        long = edges[apart > EDGE_STEP_RAD]
        share = np.linspace(0.0, 1.0, EDGE_STEPS + 1)[1:-1, None, None]
        between = points[long[:, 0]] * (1.0 - share) + points[long[:, 1]] * share
        points = np.concatenate([points, between.reshape(-1, 3)])
        angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        points = points[angle <= self.camera.fisheye.reach_rad]
        if not len(points):
            return None
        x, y = self.places_px(points).T
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    def truncation(self, box: tuple[float, float, float, float]) -> float:
        """Share of a box that lies outside of the picture [1]."""
        low, top, right, bottom = box
        inside = max(0.0, min(right, self.width_px) - max(low, 0.0)) * max(
            0.0, min(bottom, self.height_px) - max(top, 0.0)
        )
        area = (right - low) * (bottom - top)
        return float(1.0 - inside / area) if area > 0.0 else 0.0

    def metadata(self, origin_m: tuple[float, float, float]) -> dict[str, Any]:
        """What `labels.json` tells of the camera."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotation.T
        pose[:3, 3] = self.camera.to_world[:3, 3] + np.asarray(origin_m)
        centre = [self.axis_px[0] - 0.5, self.axis_px[1] - 0.5]
        model, entries = "pinhole", dict[str, Any]({"camera_matrix_px": _matrix(self.scale_px, centre)})
        if self.camera.width_m > 0.0:
            model, entries = "orthographic", {"px_per_m": round(self.scale_px, 6), "axis_px": _rounded(centre, 6)}
        elif self.camera.fisheye is not None:
            polynomial = self.camera.fisheye.polynomial(self.width_px)
            model, entries = "fisheye", {"radius_px": _rounded(polynomial, 6), "axis_px": _rounded(centre, 6)}
        return {
            "path": self.camera.path,
            "model": model,
            "size_px": [self.width_px, self.height_px],
            **entries,
            "distortion_coefficients": [],
            "camera_to_world": [_rounded(row, 9) for row in pose.tolist()],
            "axes": "camera: x right, y down, z forward; world: the stage in metres, Z up; pixels: the first one's "
            "centre is (0, 0)",
            "moves": self.camera.moves,
            "shutter": self._shutter(),
        }

    def _shutter(self) -> dict[str, Any]:
        """When the rows expose [s]; the frame is of the middle of the whole."""
        whole, rolling = self.camera.shutter_s, self.camera.rolling
        return {
            "first_row_s": round((1.0 - rolling) * whole, 9),
            "row_time_s": round(rolling * whole / self.height_px, 12),
            "rows": "end one after the other" if self.camera.global_reset else "begin one after the other",
        }


def _matrix(focal_px: float, centre: list[float]) -> list[list[float]]:
    return [
        [round(focal_px, 6), 0.0, round(centre[0], 6)],
        [0.0, round(focal_px, 6), round(centre[1], 6)],
        [0.0, 0.0, 1.0],
    ]


def rows(
    scene: SceneDict,
    pierced: tuple[Indices, Indices],
    view: Projection,
    nearest: tuple[Indices, Indices] | None = None,
) -> dict[int, dict[str, Any]]:
    """What is known of each instance (see `labels.shown_of`) besides what can be seen of it, by label id.

    Args:
        scene: what was looked at.
        pierced: ids and pixels of `render.film.aovs.pierced`, of the scene's own camera.
        view: the camera without distortion, or the fisheye, in whose picture truncation is measured.
        nearest: (H, W) row and column of the scene's picture that each pixel shows, where the lens distorts.
    """
    ids, pixels = pierced
    shape = (scene.camera.height_px, scene.camera.width_px)
    instances, visible = shown_of(scene.instances, ids), {}
    place = solids(scene, {shown.id for shown in instances})
    turns = _turns([instance.frame for instance in instances])
    axes = map(_Axes, (shown.frame for shown in instances), turns, _wxyz(turns), _wxyz(view.rotation @ turns))
    for instance, of_prim in zip(instances, axes, strict=True):
        first, last = np.searchsorted(ids, [instance.id, instance.id + 1])
        row = _outline(pixels[first:last], shape, nearest)
        solid = place.get(instance.id)
        if solid is not None:
            row |= _in_space(solid, of_prim, view, scene.origin_m)
            box = view.box_px(solid)
            if box is not None and row["amodal_pixels"]:
                row["truncation"] = round(view.truncation(box), 4)
                row["projected_box_px"] = _rounded(box, 2)
        if instance.velocity_m_s is not None:
            row["velocity_m_s"] = _rounded(instance.velocity_m_s, 4)
            row["speed_m_s"] = round(float(np.linalg.norm(instance.velocity_m_s)), 4)
        visible[instance.id] = row
    return visible


def _outline(pixels: Indices, shape: tuple[int, int], nearest: tuple[Indices, Indices] | None) -> dict[str, Any]:
    """The amodal mask of an instance within the picture."""
    if nearest is not None and len(pixels):
        plane = np.zeros(shape, dtype=bool)
        plane.ravel()[pixels] = True
        shown = plane[nearest]
        pixels, shape = np.flatnonzero(shown), shown.shape
    if not len(pixels):
        return {"amodal_pixels": 0}
    y, x = np.divmod(pixels, shape[1])
    return {
        "amodal_pixels": len(pixels),
        "amodal_box_px": [int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1],
        "amodal_rle": masks.encode(pixels, *shape),
    }


class _Axes(NamedTuple):
    """A prim's frame (4, 4), the rotation in it, and that as quaternions in the world and from the camera."""

    frame: Array
    turn: Array
    world_wxyz: list[float]
    camera_wxyz: list[float]


def _in_space(solid: Solid, axes: _Axes, view: Projection, origin_m: tuple[float, float, float]) -> dict[str, Any]:
    """Pose of an instance, and the box around it along the axes of its prim."""
    frame, turn = axes.frame, axes.turn
    local = (solid.points - frame[:3, 3]) @ turn
    low, high = extent(local)
    places = np.stack([frame[:3, 3], frame[:3, 3] + turn @ ((low + high) / 2.0)])
    from_eye, world = view.local(places), places + np.asarray(origin_m)
    return {
        "pose": {
            "world_m": _rounded(world[0], 4),
            "world_wxyz": axes.world_wxyz,
            "camera_m": _rounded(from_eye[0], 4),
            "camera_wxyz": axes.camera_wxyz,
        },
        "box_3d": {
            "size_m": _rounded(high - low, 4),
            "centre_world_m": _rounded(world[1], 4),
            "centre_camera_m": _rounded(from_eye[1], 4),
        },
    }


def moving_parts(scene: SceneDict) -> list[dict[str, Any]]:
    """What `labels.json` tells of the parts of instances that move by themselves: id, prim path, instance and pose."""
    rows = []
    for part, wxyz in zip(scene.parts, _wxyz(_turns([part.frame for part in scene.parts])), strict=True):
        place = part.frame[:3, 3] + np.asarray(scene.origin_m)
        pose = {"world_m": _rounded(place, 4), "world_wxyz": wxyz}
        rows.append({"id": part.id, "path": part.path, "instance": part.instance, "pose": pose})
    return rows


def _turns(frames: Sequence[Array]) -> Array:
    """(N, 3, 3) rotations nearest to the axes of prims."""
    u, _, right = np.linalg.svd(np.reshape(frames, (-1, 4, 4))[:, :3, :3])
    turns = np.asarray(u @ right)
    turns[np.linalg.det(turns) < 0.0, :, 0] *= -1.0  # a mirrored prim: what was left is right
    return turns


def _wxyz(turns: Array) -> list[list[float]]:
    """Unit quaternions of rotations (N, 3, 3)."""
    from scipy.spatial.transform import Rotation

    rows = Rotation.from_matrix(turns).as_quat(canonical=True, scalar_first=True) if len(turns) else turns
    return [_rounded(row, 6) for row in rows]


def _rounded(values: Array | Sequence[float], digits: int) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]

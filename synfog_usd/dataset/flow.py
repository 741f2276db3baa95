"""Optical flow, scene flow and tracks of a sequence, from the labels of its frames.

Every instance, and every part that moves by itself within one, is a rigid body: what a pixel shows is carried on by its
pose in the next frame, or in the one before, and seen by that frame's camera.  Takes labels.exr and labels.json of each
frame; gives flow.exr beside them, and tracks.json of the sequence.  Knows nothing of stages or renderers.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from synfog_usd.base import cityscapes, files
from synfog_usd.base.arrays import Array, Indices
from synfog_usd.base.image import Image, Quantity

FLOW, TRACKS = "flow.exr", "tracks.json"
SEEN, HIDDEN, OUTSIDE = 1.0, 0.0, -1.0
"""What `seen` says: the other frame shows the point, something stands before it, its picture ends before."""
NEAR = 0.01
"""Share of the depth by which the other frame's may differ where it shows the same point, beside the slope there."""
CHANNELS = ("X", "Y", "seen", "motion.X", "motion.Y", "motion.Z")
COMMENT = (
    "X: column, Y: row in the other frame less those in this one [px], of one ray through each pixel's centre; "
    "seen 1: the other frame shows the point; 0: something stands before it; -1: outside of its picture. "
    "motion: place of the point at the other frame's time less that at this one's [m], in the stage's axes, Z up; "
    "0 of what stands. forward: the next frame, backward: the one before. What moves is rigid, each wheel and limb by "
    "itself"
)


@dataclass(frozen=True)
class Labelled:
    """The labels of one frame.

    Attributes:
        instance: (H, W) ids; part: (H, W) ids of what moves by itself in it, 0 for none.
        depth_m: (H, W) planar, inf at the sky.
        matrix: (3, 3) of the camera [px], its pixel centres at whole numbers.
        to_world: (4, 4) from the camera, x right, y down, z ahead [m].
        rows: of the instances, by id; parts: of what moves by itself in them.
    """

    instance: Indices
    part: Indices
    depth_m: Array
    matrix: Array
    to_world: Array
    rows: Mapping[int, Mapping[str, Any]]
    parts: Mapping[int, Mapping[str, Any]]


def read(folder: Path) -> Labelled | str:
    """The labels of a frame's folder, or why there is no flow of them."""
    from synfog_usd.camera import writers

    if not (folder / "labels.json").is_file():
        return "no labels are made"
    content = json.loads((folder / "labels.json").read_bytes())
    camera = content.get("camera", {})
    if camera.get("model") != "pinhole":
        return f"the camera is {camera.get('model', 'unknown')}; flow is told of a pinhole"
    names = ["depth.Z", "instance.ID", *(["part.ID"] if "parts" in content else [])]
    planes = writers.read_exr(folder / "labels.exr", quantity=Quantity.DATA, channels=names).pixels.astype(np.float64)
    ids = np.rint(planes[:, :, 1:]).astype(np.int64)
    rows, parts = ({int(row["id"]): row for row in content.get(kind, ())} for kind in ("instances", "parts"))
    return Labelled(
        ids[:, :, 0],
        ids[:, :, 1] if "parts" in content else np.zeros(ids.shape[:2], dtype=np.int64),
        planes[:, :, 0],
        np.array(camera["camera_matrix_px"]),
        np.array(camera["camera_to_world"]),
        rows,
        parts,
    )


def flow(frame: Labelled, neighbour: Labelled) -> Array:
    """(H, W, 6) `CHANNELS` from one frame to another: X and Y [px], `seen`, and the way [m] of what a pixel shows.

    The sky is infinitely far: it moves as the camera turns.
    """
    height, width = frame.depth_m.shape
    v, u = np.mgrid[:height, :width].astype(np.float64)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(frame.matrix).T
    sky = ~np.isfinite(frame.depth_m)
    points = rays * np.where(sky, 1.0, frame.depth_m)[..., None]
    world = points @ frame.to_world[:3, :3].T + np.where(sky[..., None], 0.0, frame.to_world[:3, 3])
    start = world.copy()
    twins = {row["path"]: number for number, row in neighbour.rows.items()}
    twin = np.zeros(max([0, *frame.rows]) + 1, dtype=np.int64)
    for number in np.unique(frame.instance[frame.instance > 0]):
        twin[number] = twins.get(frame.rows[number]["path"], 0)
    whole = np.where(frame.part > 0, 0, frame.instance)
    for ids, rows, rows_there in ((whole, frame.rows, neighbour.rows), (frame.part, frame.parts, neighbour.parts)):
        by_path = {row["path"]: row for row in rows_there.values()}
        for number in np.unique(ids[ids > 0]):
            way = _way(rows[number], by_path.get(rows[number]["path"]))
            if way is not None:
                mine = ids == number
                world[mine] = world[mine] @ way[:3, :3].T + way[:3, 3]
    local = (world - np.where(sky[..., None], 0.0, neighbour.to_world[:3, 3])) @ neighbour.to_world[:3, :3]
    ahead = local[..., 2] > 1e-6
    position = local @ neighbour.matrix.T / np.where(ahead, local[..., 2], 1.0)[..., None]
    moved = np.where(ahead[..., None], position[..., :2] - np.stack([u, v], axis=-1), 0.0)
    x, y = (np.where(ahead, position[..., axis], -9.0) for axis in (0, 1))
    inside = (x > -0.5) & (x < width - 0.5) & (y > -0.5) & (y < height - 0.5)
    row, column = (np.clip(np.rint(a).astype(np.int64), 0, n - 1) for a, n in ((y, height), (x, width)))
    shown = _shows(neighbour, row, column, local[..., 2], np.where(sky, 0, twin[frame.instance]), sky)
    visibility = np.where(inside, np.where(shown, SEEN, HIDDEN), OUTSIDE)
    return np.concatenate([moved, visibility[..., None], world - start], axis=-1)


def _shows(frame: Labelled, row: Indices, column: Indices, depth: Array, number: Indices, sky: Array) -> Array:
    """Whether a frame shows points of an instance at a depth [m] where they fall, or in a pixel beside."""
    far = np.where(np.isfinite(frame.depth_m), frame.depth_m, 1e9)
    low, high = (filtered(far, size=3)[row, column] for filtered in (ndimage.minimum_filter, ndimage.maximum_filter))
    same = np.zeros(row.shape, dtype=bool)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            y = np.clip(row + dy, 0, far.shape[0] - 1)
            x = np.clip(column + dx, 0, far.shape[1] - 1)
            same |= (frame.instance[y, x] == number) & (sky == (far[y, x] >= 1e9))
    return np.asarray(same & (sky | ((depth > low * (1 - NEAR)) & (depth < high * (1 + NEAR)))))


def _way(row: Mapping[str, Any], row_there: Mapping[str, Any] | None) -> Array | None:
    """(4, 4) from an instance's place in one frame to that in another; None where it stands, or its pose is unknown."""
    if row_there is None or "pose" not in row or "pose" not in row_there or row["pose"] == row_there["pose"]:
        return None
    here, there = _matrix(row["pose"]), _matrix(row_there["pose"])
    if np.array_equal(here, there):
        return None
    return np.asarray(there @ np.linalg.inv(here))


def _matrix(pose: Mapping[str, Any]) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(pose["world_wxyz"], scalar_first=True).as_matrix()
    matrix[:3, 3] = pose["world_m"]
    return matrix


# -- tracks


def tracks(listed: Sequence[Mapping[int, Mapping[str, Any]]], per_s: float) -> list[dict[str, Any]]:
    """Everybody and every vehicle that a frame shows, frame by frame.

    Args:
        listed: of each frame the rows of its instances, by id.
        per_s: frames a second.

    Returns:
        for each its number, path and label, and of each frame its id there and `pixels`.  Where the labels have them
        there are `box_px`, `velocity_m_s`, the place [m], `yaw_deg` counter-clockwise from +Y, and `yaw_rate_deg_s`.
    """
    rows = [{row["path"]: row for row in frame.values()} for frame in listed]
    tracked: list[dict[str, Any]] = []
    for path in dict.fromkeys(path for frame in rows for path in frame):
        label = next(frame[path]["label"] for frame in rows if path in frame)
        if not cityscapes.label(label).has_instances or not any(frame.get(path, {}).get("pixels") for frame in rows):
            continue
        every = [frame.get(path) for frame in rows]
        yaw = np.array([np.nan if row is None or "pose" not in row else _yaw(row["pose"]) for row in every])
        frames = []
        for number, row in enumerate(every):
            if row is None:
                continue
            content = {"frame": number, "id": row["id"], "pixels": row["pixels"]}
            content |= {key: row[key] for key in ("box_px", "velocity_m_s") if key in row}
            if "pose" in row:
                content |= {"world_m": row["pose"]["world_m"], "yaw_deg": round(float(yaw[number]), 3)}
                content["yaw_rate_deg_s"] = round(_rate(yaw, number) * per_s, 3)
            frames.append(content)
        tracked.append({"track": len(tracked) + 1, "path": path, "label": label, "frames": frames})
    return tracked


def _yaw(pose: Mapping[str, Any]) -> float:
    """Degrees from +Y to where an instance's own Y axis looks, counter-clockwise."""
    ahead = _matrix(pose)[:3, 1]
    return math.degrees(math.atan2(-ahead[0], ahead[1]))


def _rate(yaw: Array, number: int) -> float:
    """Degrees a frame by which somebody turns about a frame, from the frames around it; 0 where there are none."""
    around = [k for k in (number - 1, number + 1) if 0 <= k < len(yaw) and np.isfinite(yaw[k])]
    low, high = min([number, *around]), max([number, *around])
    turned = (yaw[high] - yaw[low] + 180.0) % 360.0 - 180.0
    return float(turned / max(high - low, 1))


def _image(name: str, view: Labelled, neighbour: Labelled) -> Image:
    channels = tuple(f"{name}.{channel}" for channel in CHANNELS)
    return Image(flow(view, neighbour).astype(np.float32), channels, Quantity.DATA, provenance={"comment": COMMENT})


def write(out: Path, folders: Sequence[str], per_s: float, log: Callable[[str], None]) -> None:
    """Write flow.exr in the folder of each frame, and tracks.json.

    Args:
        out: folder of a sequence; folders: of its frames, in it.
        per_s: frames a second.
        log: told why there is no flow.

    Raises:
        OutputError: a file cannot be read or written.
    """
    from synfog_usd.camera import writers

    rows: list[Mapping[int, Mapping[str, Any]]] = []
    before: Labelled | None = None
    view: Labelled | str | None = read(out / folders[0])
    for number, folder in enumerate(folders):
        following = read(out / folders[number + 1]) if number + 1 < len(folders) else None
        for frame in (view, following):
            if isinstance(frame, str):
                log(f"{out}: no flow and no tracks: {frame}")
                return
        assert isinstance(view, Labelled)
        around = {"forward": following, "backward": before}
        images = [
            _image(name, view, neighbour) for name, neighbour in around.items() if isinstance(neighbour, Labelled)
        ]
        if images:
            writers.write_exr(out / folder / FLOW, images)
        rows.append(view.rows)
        before, view = view, following
    files.write_json(
        out / TRACKS,
        {"schema": "synfog-usd/tracks", "version": 1, "frames_per_s": per_s, "tracks": tracks(rows, per_s)},
    )

"""Cityscapes: labels of every picture as ids and as polygons, as cityscapesscripts reads and evaluates them.

A city is a source in one lighting and fog; the sequence is the scene, the frame the camera and pipeline.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from synfog_usd.base.cityscapes import LABELS
from synfog_usd.dataset.exports.folder import ExportFolder, quantised
from synfog_usd.dataset.exports.frames import LabelledPicture, Labels, plain, with_right
from synfog_usd.dataset.exports.outlines import outlines
from synfog_usd.dataset.exports.record import Boxed

BY_ID = {kind.id: kind for kind in LABELS.values()}
MOST = 1000
"""Instances of a class in a picture: ids are label id * 1000 + number."""

STEPS_PER_M = 256.0
BASELINE_M = 0.209313
"""Of the stereo cameras of Cityscapes, by its camera files."""


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `leftImg8bit`, `gtFine`, `depth`, `disparity` and `camera`; of a pair also `rightImg8bit`."""
    names = Names()
    for picture, right in with_right(pictures()):
        city = f"{plain(picture.source)}-{plain(picture.lighting)}-{plain(picture.fog)}".replace("_", "")
        stem = names.stem(picture, city)
        folder.place(picture.screen, f"leftImg8bit/{stem}_leftImg8bit{picture.screen.suffix}")
        if right is not None:
            folder.place(right.screen, f"rightImg8bit/{stem}_rightImg8bit{right.screen.suffix}")
        write_ground_truth(folder, stem, picture.labels)
    return TOLD


TOLD = [
    "gtFine has labelIds, instanceIds, color and polygons.  Instances beyond the 1000th of a class have their class "
    "alone.  Polygons are traced from the ids: painted in their order they give labelIds again.  Each part of a thing "
    "that is seen in parts is an object with the same `instance`, its number in instanceIds.",
    "depth is planar, uint16 / 256 m; 0 is the sky, and what lies beyond 255.99 m is 65535.",
    "disparity is uint16, (value - 1) / 256 px, 0 where there is none: baseline fx / depth, of the right eye whose "
    "picture is in rightImg8bit, or of Cityscapes' own where none was rendered; 65535 is 255.99 px and more.",
    "camera has intrinsics in pixels, and extrinsics x, y, z of the camera in the stage [m] with yaw, pitch and roll "
    "[rad]; baseline is that of the disparity, as Cityscapes has it [m].",
]


class Names:
    """File names `split/city/city_sequence_frame`, each once."""

    def __init__(self) -> None:
        self._frames: dict[tuple[str, str], int] = {}

    def stem(self, picture: LabelledPicture, city: str, frame_of: tuple[str, str] | None = None) -> str:
        """The name of a picture; pictures of the same camera and pipeline have the same frame."""
        key = frame_of or (picture.camera, picture.pipeline)
        frame = self._frames.setdefault(key, len(self._frames))
        return f"{picture.split}/{city}/{city}_{picture.scene:06}_{frame:06}"


def write_ground_truth(folder: ExportFolder, stem: str, labels: Labels) -> None:
    """The ids, polygons, depth, disparity and camera of a picture."""
    labels.refuse_fisheye("Cityscapes")
    semantic = labels.semantic
    folder.png(f"gtFine/{stem}_gtFine_labelIds.png", semantic.astype(np.uint8))
    ids = instance_ids(labels)
    folder.png(f"gtFine/{stem}_gtFine_instanceIds.png", ids)
    folder.json(f"gtFine/{stem}_gtFine_polygons.json", _polygons(ids))
    colours = np.zeros((256, 3), dtype=np.uint8)
    for kind in LABELS.values():
        if kind.id >= 0:
            colours[kind.id] = kind.colour
    folder.png(f"gtFine/{stem}_gtFine_color.png", colours[semantic])
    folder.png(f"depth/{stem}_depth.png", quantised(labels.depth_m, STEPS_PER_M))
    camera = _camera(labels.camera, labels.metadata.get("stereo", {}).get("baseline_m", BASELINE_M))
    intrinsic, extrinsic = camera["intrinsic"], camera["extrinsic"]
    folder.png(f"disparity/{stem}_disparity.png", disparity(labels.depth_m, intrinsic["fx"], extrinsic["baseline"]))
    folder.json(f"camera/{stem}_camera.json", camera)


def instance_ids(labels: Labels) -> np.ndarray:
    """(H, W) uint16: label id * 1000 + number for what is counted, else the label id."""
    ids = labels.semantic.copy()
    counts: dict[int, int] = {}
    for row in labels.instances:
        kind = BY_ID[row["semantic_id"]]
        number = counts.get(kind.id, 0)
        if not kind.has_instances or not row["pixels"] or number >= MOST:
            continue
        ids[labels.mask(row["id"])] = kind.id * 1000 + number
        counts[kind.id] = number + 1
    return ids.astype(np.uint16)


def _polygons(ids: np.ndarray) -> dict[str, Any]:
    """What `gtFine/*_polygons.json` holds, of `instance_ids`."""
    objects = []
    for outline in outlines(ids.astype(np.int64)):
        counted = outline.value >= MOST
        kind = BY_ID[outline.value // 1000 if counted else outline.value]
        points = outline.points.tolist()
        points += [points[-1]] * (3 - len(points))
        label = kind.name if counted or not kind.has_instances else f"{kind.name}group"  # of several instances
        objects.append({"label": label, "polygon": points, **({"instance": outline.value % 1000} if counted else {})})
    return {"imgHeight": ids.shape[0], "imgWidth": ids.shape[1], "objects": objects}


def disparity(depth_m: np.ndarray, fx_px: float, baseline_m: float) -> np.ndarray:
    """(H, W) uint16 of a planar depth, infinite at the sky; 0 where it is not above 0, or the camera has no `fx_px`."""
    valid = (depth_m > 0.0) & (fx_px > 0.0)
    steps = 256.0 * baseline_m * fx_px / np.where(valid, depth_m, 1.0) + 1.0
    return np.where(valid, np.clip(np.rint(steps), 1.0, 65535.0), 0.0).astype(np.uint16)


def _camera(camera: Mapping[str, Any], baseline_m: float) -> dict[str, Any]:
    matrix = camera.get("camera_matrix_px", [[0.0] * 3] * 3)
    pose = np.array(camera["camera_to_world"])
    right, _, forward = pose[:3, 0], pose[:3, 1], pose[:3, 2]
    yaw = math.atan2(forward[1], forward[0])
    pitch = -math.asin(max(-1.0, min(1.0, forward[2])))
    level = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    roll = math.atan2(float(right @ np.cross(forward, level)), float(right @ level))
    return {
        "extrinsic": {
            "baseline": baseline_m,
            "pitch": pitch,
            "roll": roll,
            "x": pose[0, 3],
            "y": pose[1, 3],
            "yaw": yaw,
            "z": pose[2, 3],
        },
        "intrinsic": {"fx": matrix[0][0], "fy": matrix[1][1], "u0": matrix[0][2], "v0": matrix[1][2]},
    }

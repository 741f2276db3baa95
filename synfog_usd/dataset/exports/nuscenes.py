"""nuScenes: thirteen tables, pictures by camera, boxes in the world; cameras alone, without a lidar.

A scene is a clip in one lighting and fog; its samples are the frames.  Global coordinates are the stage's, in metres
with Z up.  The ego frame stands in the first camera, x ahead, y to the left, z up.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from synfog_usd.base.arrays import Array
from synfog_usd.dataset.exports import kitti, taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture, clips, plain
from synfog_usd.dataset.exports.record import Boxed

Row: TypeAlias = dict[str, Any]

VERSION = "v1.0-synfog"
"""Folder of the tables; what a loader calls the version."""

TABLES = (
    *("category", "attribute", "visibility", "instance", "sensor", "calibrated_sensor", "ego_pose", "log"),
    *("scene", "sample", "sample_data", "sample_annotation", "map"),
)
CATEGORIES = {
    "car": "vehicle.car",
    "truck": "vehicle.truck",
    "bus": "vehicle.bus.rigid",
    "train": "vehicle.bus.bendy",
    "caravan": "vehicle.trailer",
    "trailer": "vehicle.trailer",
    "motorcycle": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "rider": "vehicle.bicycle",
    "person": "human.pedestrian.adult",
}
"""Cityscapes' class -> category; a rider is a bicycle with its rider."""

VISIBILITIES = (("v0-40", 0.4), ("v40-60", 0.6), ("v60-80", 0.8), ("v80-100", math.inf))
"""Level -> the share of a thing's pixels below which it holds."""

ATTRIBUTES = ("vehicle.moving", "vehicle.stopped", "cycle.with_rider", "pedestrian.moving", "pedestrian.standing")
STANDS_M_S = 0.1
APART_US = 3_600_000_000
"""From where one scene begins to the next: the devkit cannot list two that begin together."""
AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]).T
"""From a camera, x right, y down, z ahead, to the ego frame."""


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `v1.0-synfog/*.json`, `samples/<camera>/*` and a map that shows nothing."""
    tables = _Tables()
    together: dict[str, dict[str, list[LabelledPicture]]] = {}
    for name, frames in clips(pictures(), "nuScenes").items():
        first = frames[0]
        scene = "-".join(plain(word) for word in (first.source, first.lighting, first.fog, first.pipeline))
        together.setdefault(scene, {})[name] = frames
    for number, (name, cameras) in enumerate(together.items()):
        _add_scene(tables, folder, (name, number * APART_US), list(cameras.values()), chosen)
    tables.add("map", "none", log_tokens=[token("log", "synfog")], category="semantic_prior", filename="maps/none.png")
    folder.png("maps/none.png", np.zeros((1, 1), dtype=np.uint8))
    for table in TABLES:
        folder.json(f"{VERSION}/{table}.json", list(tables.rows[table].values()))
    return [
        f"NuScenes(version={VERSION!r}, dataroot=...) loads it. There is no lidar: num_lidar_pts is 0, and the map is "
        "empty.",
        "The ego frame stands in the first camera. A box is of the whole thing, and has a row in each frame that shows "
        "a pixel of it.",
    ]


def token(*names: str | int) -> str:
    """32 hexadecimal digits of what these names name."""
    return hashlib.sha256("\x1f".join(map(str, names)).encode()).hexdigest()[:32]


class _Tables:
    """Rows of all tables, each once.

    Attributes:
        rows: table -> token -> row.
    """

    def __init__(self) -> None:
        self.rows: dict[str, dict[str, Row]] = {table: {} for table in TABLES}
        for index, name in enumerate(sorted(set(CATEGORIES.values()))):
            self.add("category", name, name=name, description="", index=index)
        for name in ATTRIBUTES:
            self.add("attribute", name, name=name, description="")
        for number, (level, _) in enumerate(VISIBILITIES, 1):
            self.rows["visibility"][str(number)] = {"token": str(number), "level": level, "description": ""}
        self.add("log", "synfog", logfile="", vehicle="synfog", date_captured="1970-01-01", location="synfog")

    def add(self, table: str, *names: str | int, **values: Any) -> str:
        """Add a row, or leave the one that is there; its token."""
        key = token(table, *names)
        self.rows[table].setdefault(key, {"token": key, **values})
        return key

    def link(self, table: str, tokens: Sequence[str]) -> None:
        """Tell rows which is before and after them."""
        for key, before, after in zip(tokens, ("", *tokens[:-1]), (*tokens[1:], ""), strict=True):
            self.rows[table][key] |= {"prev": before, "next": after}


def _add_scene(
    tables: _Tables,
    folder: ExportFolder,
    scene: tuple[str, int],
    cameras: Sequence[Sequence[LabelledPicture]],
    chosen: Boxed,
) -> None:
    """A scene, its name and when it begins [us], of one clip for each camera."""
    name, begins_us = scene
    samples: list[str] = []
    for picture in cameras[0]:
        assert picture.moment is not None
        time_us = begins_us + round(picture.moment.time_s * 1e6)
        samples.append(
            tables.add("sample", name, picture.moment.frame, timestamp=time_us, scene_token=token("scene", name))
        )
    tables.link("sample", samples)
    tables.add(
        "scene",
        name,
        log_token=token("log", "synfog"),
        nbr_samples=len(samples),
        first_sample_token=samples[0],
        last_sample_token=samples[-1],
        name=name,
        description=f"{cameras[0][0].lighting}, {cameras[0][0].fog}",
    )
    base = _pose(cameras[0][0])
    for frames in cameras:
        calibrated = _turned(np.linalg.inv(base) @ _pose(frames[0]))
        _add_pictures(tables, folder, samples, frames, calibrated)
    _add_boxes(tables, name, samples, cameras, chosen)


def _pose(picture: LabelledPicture) -> Array:
    """(4, 4) from the camera to the world."""
    return np.array(picture.labels.camera["camera_to_world"], dtype=np.float64)


def _turned(matrix: Array) -> Array:
    """(4, 4) from a camera to the ego frame, of one to the first camera."""
    turn = np.eye(4)
    turn[:3, :3] = AHEAD
    return np.asarray(turn @ matrix)


def _wxyz(turn: Array) -> list[float]:
    return [float(value) for value in Rotation.from_matrix(turn).as_quat(scalar_first=True)]


def _add_pictures(
    tables: _Tables, folder: ExportFolder, samples: Sequence[str], frames: Sequence[LabelledPicture], calibrated: Array
) -> None:
    """The pictures of a camera, with its calibration and the ego's places."""
    first = frames[0]
    first.labels.refuse_fisheye("nuScenes")
    channel = f"CAM_{plain(first.camera.rpartition('/')[2]).upper()}" if first.camera else "CAM_FRONT"
    sensor = tables.add("sensor", channel, channel=channel, modality="camera")
    calibration = tables.add(
        "calibrated_sensor",
        first.sequence,
        sensor_token=sensor,
        translation=calibrated[:3, 3].tolist(),
        rotation=_wxyz(calibrated[:3, :3]),
        camera_intrinsic=first.labels.camera["camera_matrix_px"],
    )
    keys = []
    for sample, picture in zip(samples, frames, strict=True):
        ego, time_us = _pose(picture) @ np.linalg.inv(calibrated), tables.rows["sample"][sample]["timestamp"]
        pose = tables.add(
            "ego_pose", picture.name, timestamp=time_us, translation=ego[:3, 3].tolist(), rotation=_wxyz(ego[:3, :3])
        )
        name = f"samples/{channel}/{picture.name}{picture.screen.suffix}"
        folder.place(picture.screen, name)
        width, height = picture.labels.size_px
        keys.append(
            tables.add(
                "sample_data",
                picture.name,
                sample_token=sample,
                ego_pose_token=pose,
                calibrated_sensor_token=calibration,
                timestamp=time_us,
                fileformat=picture.screen.suffix[1:],
                is_key_frame=True,
                height=height,
                width=width,
                filename=name,
            )
        )
    tables.link("sample_data", keys)


def _add_boxes(
    tables: _Tables,
    name: str,
    samples: Sequence[str],
    cameras: Sequence[Sequence[LabelledPicture]],
    chosen: Boxed,
) -> None:
    """Boxes of what a camera of a sample shows, and the instances that they are of."""
    by_path: dict[str, list[str]] = {}
    for frame, sample in enumerate(samples):
        shown: dict[str, Row] = {}
        for frames in cameras:
            for row in taxonomy.objects(frames[frame], chosen):
                if row["label"] in CATEGORIES and "box_3d" in row:
                    shown.setdefault(row["path"], box_of(row))
        for path, values in shown.items():
            category = token("category", CATEGORIES[values.pop("label")])
            instance = tables.add("instance", name, path, category_token=category)
            key = tables.add(
                "sample_annotation", name, path, frame, sample_token=sample, instance_token=instance, **values
            )
            by_path.setdefault(path, []).append(key)
    for path, keys in by_path.items():
        tables.link("sample_annotation", keys)
        tables.rows["instance"][token("instance", name, path)] |= {
            "nbr_annotations": len(keys),
            "first_annotation_token": keys[0],
            "last_annotation_token": keys[-1],
        }


def box_of(row: Mapping[str, Any]) -> Row:
    """What `sample_annotation` tells of a thing, and its label."""
    world, size = kitti.matrix_of(row["pose"]["world_wxyz"]), row["box_3d"]["size_m"]
    up, side, ahead = kitti.axes_of(dict(row))
    forward = world[:, ahead]
    share = row.get("visible_share", 1.0)
    return {
        "label": row["label"],
        "translation": row["box_3d"]["centre_world_m"],
        "size": [float(size[side]), float(size[ahead]), float(size[up])],
        "rotation": _wxyz(Rotation.from_euler("z", math.atan2(forward[1], forward[0])).as_matrix()),
        "visibility_token": str(next(n for n, (_, below) in enumerate(VISIBILITIES, 1) if share < below)),
        "attribute_tokens": [token("attribute", _attribute(row))],
        "num_lidar_pts": 0,
        "num_radar_pts": 0,
    }


def _attribute(row: Mapping[str, Any]) -> str:
    moves = row.get("speed_m_s", 0.0) > STANDS_M_S
    if row["label"] == "person":
        return "pedestrian.moving" if moves else "pedestrian.standing"
    if row["label"] == "rider":
        return "cycle.with_rider"
    return "vehicle.moving" if moves else "vehicle.stopped"

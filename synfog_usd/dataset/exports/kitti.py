"""KITTI's object benchmark: pictures, labels of 15 columns, calibration, and depth.

Types are those of the devkit; what a class has no type for is `Misc`.  Boxes are of the whole thing within the picture,
as the benchmark's annotators drew them.  What is dropped because fog hides it is `DontCare`, which neither counts nor
is missed.  `occluded` follows from the visible share of a thing's pixels, with steps at 80 % and 40 %.  P0 and P2 are
the left camera, P1 and P3 its right eye, or the same where there is none; a lidar is taken to stand in the left one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from synfog_usd.dataset.exports import taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder, quantised
from synfog_usd.dataset.exports.frames import LabelledPicture, with_right
from synfog_usd.dataset.exports.record import Boxed

TYPES = {"car": "Car", "truck": "Truck", "person": "Pedestrian", "rider": "Cyclist", "train": "Tram"}
MISC = "Misc"
UPRIGHT = ("person", "rider")
"""Classes that are wider than they are deep."""

STEPS_PER_M = 256.0
"""Depth is uint16, 1/256 m; 0 is the sky."""

STEPS_PER_PX = 256.0
"""Likewise of disparity, as stereo 2015 has it."""

LIDAR_TO_CAMERA = ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
"""x forward, y left, z up, to x right, y down, z forward."""


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `<split>/{image_2,label_2,calib,depth_2}/000000.*` and `<split>/names.txt`; of a pair also `image_3`,
    `disp_occ_0` and `disp_noc_0`.
    """
    names: dict[str, list[str]] = {}
    for picture, right in with_right(pictures()):
        listed = names.setdefault(picture.split, [])
        stem = f"{len(listed):06}"
        listed.append(f"{stem} {picture.name}\n")
        labels = picture.labels
        labels.refuse_fisheye("KITTI")
        folder.place(picture.screen, f"{picture.split}/image_2/{stem}{picture.screen.suffix}")
        rows = [
            row_of(row, MISC if row.get("visibility") not in chosen.drop else "DontCare")
            for row in taxonomy.objects(picture, Boxed(classes=chosen.classes))
        ]
        folder.text(f"{picture.split}/label_2/{stem}.txt", "".join(rows))
        baseline_m = labels.metadata["stereo"]["baseline_m"] if right else 0.0
        folder.text(f"{picture.split}/calib/{stem}.txt", calibration(labels.camera, baseline_m))
        if right is not None and labels.disparity_px is not None and labels.shared is not None:
            folder.place(right.screen, f"{picture.split}/image_3/{stem}{right.screen.suffix}")
            both = np.where(labels.shared, labels.disparity_px, np.nan)
            for name, disparity in (("disp_occ_0", labels.disparity_px), ("disp_noc_0", both)):
                folder.png(f"{picture.split}/{name}/{stem}.png", quantised(disparity, STEPS_PER_PX))
        folder.png(f"{picture.split}/depth_2/{stem}.png", quantised(labels.depth_m, STEPS_PER_M))
    for split, lines in names.items():
        folder.text(f"{split}/names.txt", "".join(lines))
    return [
        "depth_2 is planar depth, uint16 / 256 m; 0 is the sky, and what lies beyond 255.99 m is 65535.",
        "disp_occ_0 and disp_noc_0 are of pairs: left column less right column, uint16 / 256 px; 0 is the sky; "
        "noc leaves out what the right camera does not see. Right eyes are image_3 of their left ones.",
        "Boxes are amodal, within the picture; names.txt says which picture a number is.",
        "A lens's distortion is not in KITTI's calibration: use a pipeline whose lens has none.",
    ]


def row_of(row: dict[str, Any], rest: str) -> str:
    """The line of a thing; `rest` is the type of classes that the devkit does not know, or 'DontCare'."""
    x, y, right, bottom = taxonomy.corners(row.get("amodal_box_px") or row["box_px"])
    box = f"{x:.2f} {y:.2f} {right:.2f} {bottom:.2f}"
    kind = rest if rest == "DontCare" else TYPES.get(row["label"], rest)
    if kind == "DontCare" or "box_3d" not in row:
        return f"DontCare -1 -1 -10 {box} -1 -1 -1 -1000 -1000 -1000 -10\n"
    (height, width, length), place, turn = upright(row)
    share = row.get("visible_share", 1.0)
    occluded = 0 if share >= 0.8 else 1 if share >= 0.4 else 2
    alpha = _wrapped(turn - math.atan2(place[0], place[2]))
    size = f"{height:.2f} {width:.2f} {length:.2f}"
    where = " ".join(f"{part:.2f}" for part in place)
    return f"{kind} {row.get('truncation', 0.0):.2f} {occluded} {alpha:.2f} {box} {size} {where} {turn:.2f}\n"


def upright(row: dict[str, Any]) -> tuple[tuple[float, float, float], np.ndarray, float]:
    """A 3D box as KITTI has it.

    Returns:
        height, width and length [m]; the middle of its floor in the camera's axes [m]; and rotation_y [rad], 0 where it
        faces the camera's right.  A model faces +Y of its own axes, or +X where that is its longer side by a fifth and
        it is no person.
    """
    size = np.array(row["box_3d"]["size_m"])
    world, camera = (matrix_of(row["pose"][name]) for name in ("world_wxyz", "camera_wxyz"))
    up, side, ahead = axes_of(row)
    down = -camera[:, up] * np.sign(world[2, up])
    place = np.array(row["box_3d"]["centre_camera_m"]) + down * size[up] / 2.0
    forward = camera[:, ahead]
    return (size[up], size[side], size[ahead]), place, math.atan2(-forward[2], forward[0])


def axes_of(row: dict[str, Any]) -> tuple[int, int, int]:
    """Which of a model's own axes goes up, which aside, and which ahead, see `upright`."""
    size, world = row["box_3d"]["size_m"], matrix_of(row["pose"]["world_wxyz"])
    up = int(np.argmax(np.abs(world[2])))
    across = [axis for axis in range(3) if axis != up]
    sideways = row["label"] not in UPRIGHT and size[min(across)] > 1.2 * size[max(across)]
    ahead = min(across) if sideways else max(across)
    return up, next(axis for axis in across if axis != ahead), ahead


def matrix_of(wxyz: list[float]) -> np.ndarray:
    """(3, 3) of a quaternion."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(wxyz, scalar_first=True).as_matrix())


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def calibration(camera: Mapping[str, Any], baseline_m: float = 0.0) -> str:
    """A file of `calib`; the right eye stands a baseline beside the left."""
    matrix = np.array(camera.get("camera_matrix_px", np.eye(3)))
    places = [[0.0, 0.0, 0.0], [-baseline_m, 0.0, 0.0]]
    eyes = [" ".join(f"{value:.12e}" for value in np.c_[matrix, matrix @ np.array(place)].ravel()) for place in places]
    lidar = " ".join(f"{value:.12e}" for value in np.c_[np.array(LIDAR_TO_CAMERA), np.zeros(3)].ravel())
    same = " ".join(f"{value:.12e}" for value in np.eye(3).ravel())
    imu = " ".join(f"{value:.12e}" for value in np.eye(3, 4).ravel())
    lines = [f"P{number}: {eyes[number % 2]}" for number in range(4)]
    return "\n".join([*lines, f"R0_rect: {same}", f"Tr_velo_to_cam: {lidar}", f"Tr_imu_to_velo: {imu}", ""])

"""Virtual KITTI 2: a tree for each scene and variant, with text files of cameras, boxes and poses.

A variant is a lighting and fog.  Frames are those of a clip, or else count a scene's cameras and pipelines.  Depth is
planar, in centimetres.  Instance pictures hold trackID + 1, in 16 bits, since a street has more than 255; `trackID` is
our instance id - 1, which a clip has in common.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from synfog_usd.base.cityscapes import LABELS
from synfog_usd.dataset.exports import kitti, taxonomy
from synfog_usd.dataset.exports.cityscapes import Names
from synfog_usd.dataset.exports.folder import ExportFolder, quantised
from synfog_usd.dataset.exports.frames import LabelledPicture, plain, with_right
from synfog_usd.dataset.exports.record import Boxed

STEPS_PER_M = 100.0
REACH_M = 10.0
"""Of scene flow, to each side."""
FLOWS = {"forward": ("flow", "sceneFlow"), "backward": ("backwardFlow", "backwardSceneFlow")}
"""Way -> how files of optical flow and of scene flow begin."""
HEADS = {
    "intrinsic": "frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]",
    "extrinsic": "frame cameraID r1,1 r1,2 r1,3 t1 r2,1 r2,2 r2,3 t2 r3,1 r3,2 r3,3 t3 0 0 0 1",
    "bbox": "frame cameraID trackID left right top bottom number_pixels truncation_ratio occupancy_ratio isMoving",
    "pose": "frame cameraID trackID alpha width height length world_space_X world_space_Y world_space_Z "
    "rotation_world_space_y rotation_world_space_x rotation_world_space_z camera_space_X camera_space_Y camera_space_Z "
    "rotation_camera_space_y rotation_camera_space_x rotation_camera_space_z",
    "info": "trackID label model color",
}


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `SceneXX/<variant>/frames/...` and the text files of each variant; all frames of one follow each other."""
    names = Names()
    texts: dict[str, dict[str, list[str]]] = {}
    scene, cameras = None, dict[str, int]()
    colours = "Category r g b\n" + "".join(
        f"{kind.name.replace(' ', '')} {kind.colour[0]} {kind.colour[1]} {kind.colour[2]}\n" for kind in LABELS.values()
    )
    palette = np.zeros((256, 3), dtype=np.uint8)
    for kind in LABELS.values():
        if kind.id >= 0:
            palette[kind.id] = kind.colour

    def flush() -> None:
        for tree, parts in texts.items():
            for name, lines in parts.items():
                folder.text(f"{tree}/{name}.txt", f"{HEADS[name]}\n" + "".join(dict.fromkeys(lines)))
            folder.text(f"{tree}/colors.txt", colours)
        texts.clear()
        cameras.clear()

    for picture, right in with_right(pictures()):
        if scene is not None and picture.scene != scene:
            flush()
        scene = picture.scene
        tree = f"Scene{picture.scene:02}/{plain(picture.lighting)}-{plain(picture.fog)}"
        frame = picture.moment.frame if picture.moment else int(names.stem(picture, "").rpartition("_")[2])
        base = f"{tree}/frames"
        for place, eye in enumerate([picture, *([right] if right else [])]):
            number = cameras.setdefault(eye.camera, len(cameras)) if eye.moment else place
            labels, which = eye.labels, f"Camera_{number}"
            labels.refuse_fisheye("Virtual KITTI 2")
            folder.jpeg(f"{base}/rgb/{which}/rgb_{frame:05}.jpg", eye.screen)
            folder.png(f"{base}/depth/{which}/depth_{frame:05}.png", quantised(labels.depth_m, STEPS_PER_M))
            folder.png(f"{base}/classSegmentation/{which}/classgt_{frame:05}.png", palette[labels.semantic])
            ids = labels.instance.astype(np.uint16)
            folder.png(f"{base}/instanceSegmentation/{which}/instancegt_{frame:05}.png", ids)
            for way, (flat, deep) in FLOWS.items():
                if (flow := eye.flow(way)) is not None:
                    folder.png(f"{base}/{way}Flow/{which}/{flat}_{frame:05}.png", coded_flow(flow[:, :, :2]))
                if (flow := eye.scene_flow(way)) is not None:
                    steps = np.rint((np.clip(flow / REACH_M, -1.0, 1.0) + 1.0) * 0.5 * 65535.0).astype(np.uint16)
                    folder.png(f"{base}/{way}SceneFlow/{which}/{deep}_{frame:05}.png", steps)
            parts = texts.setdefault(tree, {name: [] for name in HEADS})
            _write_rows(parts, frame, number, eye, chosen)
    flush()
    return [
        "Depth is planar, uint16 in cm: what lies beyond 655.34 m is 65535, where the original has the sky too; ours "
        "is 0.",
        "Classes and colours are Cityscapes'. Camera_1 is the right eye of a pair, or the next camera of a rig's clip.",
        "Optical flow is of clips alone, also where the other frame does not show the point, and of the sky.",
        "Scene flow is from camera to camera, x right, y down, z ahead, within 10 m; 0 of the sky.",
        "World space is the stage's, in metres with Y down: x, -z, y of ours.",
    ]


def coded_flow(flow: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint16 of a flow (H, W, 2) [px] to the right and down: both as shares of the picture, and whether it is
    known.

    Virtual KITTI 2 spreads the greatest shift to either side over all codes of the first colour, columns there and
    rows on the second.  The third is 0 where there is none.
    """
    height, width = flow.shape[:2]
    share = flow / (np.array([width, height]) - 1.0)
    valid: np.ndarray = np.all(np.abs(share) <= 1.0, axis=-1)
    steps = np.rint((np.where(valid[..., None], share, 0.0) + 1.0) * 0.5 * 65535.0)
    return np.concatenate([steps, 65535.0 * valid[..., None]], axis=-1).astype(np.uint16)


def _write_rows(parts: dict[str, list[str]], frame: int, number: int, picture: LabelledPicture, chosen: Boxed) -> None:
    camera = picture.labels.camera
    matrix = camera.get("camera_matrix_px", [[0.0] * 3] * 3)
    parts["intrinsic"].append(f"{frame} {number} {matrix[0][0]:g} {matrix[1][1]:g} {matrix[0][2]:g} {matrix[1][2]:g}\n")
    y_down = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    to_camera = np.linalg.inv(y_down @ np.array(camera["camera_to_world"]))
    parts["extrinsic"].append(f"{frame} {number} " + " ".join(f"{value:.9g}" for value in to_camera.ravel()) + "\n")
    for row in taxonomy.objects(picture, chosen):
        x, y, right, bottom = taxonomy.corners(row["box_px"])
        track, moves = row["id"] - 1, row.get("speed_m_s", 0.0) > 0.0
        cut, share = row.get("truncation", 0.0), row.get("visible_share", 1.0)
        parts["bbox"].append(
            f"{frame} {number} {track} {x} {right - 1} {y} {bottom - 1} {row['pixels']} {cut:g} {share:g} {moves}\n"
        )
        name = row["label"].replace(" ", "")
        parts["info"].append(f"{track} {name} {plain(row['path'].rpartition('/')[2])} unknown\n")
        if "box_3d" not in row:
            continue
        (height, width, length), place, turn = kitti.upright(row)
        world = y_down @ np.array(camera["camera_to_world"]) @ np.array([*place, 1.0])
        heading = (y_down @ np.array(camera["camera_to_world"]))[:3, :3] @ np.array([np.cos(turn), 0.0, -np.sin(turn)])
        alpha = (turn - np.arctan2(place[0], place[2]) + np.pi) % (2 * np.pi) - np.pi
        numbers = [alpha, width, height, length, *world[:3], np.arctan2(-heading[2], heading[0]), 0.0, 0.0]
        numbers += [*place, turn, 0.0, 0.0]
        parts["pose"].append(f"{frame} {number} {track} " + " ".join(f"{value:.6g}" for value in numbers) + "\n")

"""MCAP: one file for each clip, in Foxglove's schemas: pictures, calibration, the camera's place, and boxes in space.

Topics are /camera/image, /camera/calibration, /tf and /scene; time is that of the clip.  The frame `world` is the
stage's, in metres with Z up; `camera` has x right, y down, z ahead.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from synfog_usd.base import files
from synfog_usd.base.errors import ParameterError
from synfog_usd.dataset.exports import kitti, taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture, clips
from synfog_usd.dataset.exports.record import Boxed

GOLDEN = 0.6180339887
"""Steps of a hue between tracks; neighbours differ most."""

SOLID = 0.5
"""Opacity of boxes."""


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `<clip>.mcap`.

    Raises:
        ParameterError: foxglove-sdk is not installed.
    """
    try:
        import foxglove  # noqa: F401
    except ImportError as error:
        raise ParameterError("--as mcap needs Foxglove's writer: pip install foxglove-sdk") from error
    for name, frames in clips(pictures(), "MCAP").items():
        frames[0].labels.refuse_fisheye("MCAP")
        files.write_whole(folder.root / f"{name}.mcap", functools.partial(_write_clip, frames=frames, chosen=chosen))
    return ["Boxes are of things with a track, in a colour each; a box is taken away in frames that do not show it."]


def track_colour(track: int) -> tuple[float, float, float]:
    """Colour of a track, 0 to 1, coded as sRGB; the same in all frames."""
    import colorsys

    return colorsys.hsv_to_rgb(track * GOLDEN % 1.0, 0.75, 0.95)


def _write_clip(path: Path, frames: Sequence[LabelledPicture], chosen: Boxed) -> None:
    import foxglove
    from foxglove import channels

    context = foxglove.Context()
    with foxglove.open_mcap(path, allow_overwrite=True, context=context):
        image = channels.CompressedImageChannel("/camera/image", context=context)
        calibration = channels.CameraCalibrationChannel("/camera/calibration", context=context)
        places = channels.FrameTransformChannel("/tf", context=context)
        boxes = channels.SceneUpdateChannel("/scene", context=context)
        for picture in frames:
            assert picture.moment is not None
            when = round(picture.moment.time_s * 1e9)
            image.log(_image(picture, when), log_time=when)
            calibration.log(_calibration(picture, when), log_time=when)
            places.log(_transform(picture, when), log_time=when)
            boxes.log(_scene(picture, when, chosen), log_time=when)


def _stamp(when: int) -> Any:
    from foxglove.messages import Timestamp

    return Timestamp(when // 1_000_000_000, when % 1_000_000_000)


def _image(picture: LabelledPicture, when: int) -> Any:
    from foxglove.messages import CompressedImage

    coding = {".jpg": "jpeg", ".png": "png"}[picture.screen.suffix]
    data = picture.screen.read_bytes()
    return CompressedImage(timestamp=_stamp(when), frame_id="camera", data=data, format=coding)


def _calibration(picture: LabelledPicture, when: int) -> Any:
    from foxglove.messages import CameraCalibration

    (width, height), matrix = picture.labels.size_px, np.array(picture.labels.camera["camera_matrix_px"], dtype=float)
    distortion = [float(value) for value in picture.labels.metadata.get("distortion_coefficients", ())]
    return CameraCalibration(
        timestamp=_stamp(when),
        frame_id="camera",
        width=width,
        height=height,
        distortion_model="plumb_bob" if distortion else "",
        D=distortion,
        K=matrix.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.c_[matrix, np.zeros(3)].ravel().tolist(),
    )


def _placed(turn: np.ndarray, place: np.ndarray) -> tuple[Any, Any]:
    """A place and a rotation in Foxglove's words."""
    from foxglove.messages import Quaternion, Vector3

    x, y, z, w = (float(value) for value in Rotation.from_matrix(turn).as_quat())
    return Vector3(x=float(place[0]), y=float(place[1]), z=float(place[2])), Quaternion(x=x, y=y, z=z, w=w)


def _transform(picture: LabelledPicture, when: int) -> Any:
    from foxglove.messages import FrameTransform

    matrix = np.array(picture.labels.camera["camera_to_world"], dtype=float)
    place, turn = _placed(matrix[:3, :3], matrix[:3, 3])
    return FrameTransform(
        timestamp=_stamp(when), parent_frame_id="world", child_frame_id="camera", translation=place, rotation=turn
    )


def _scene(picture: LabelledPicture, when: int, chosen: Boxed) -> Any:
    from foxglove.messages import SceneEntityDeletion, SceneEntityDeletionType, SceneUpdate

    tracks = picture.tracks()
    rows = [row for row in taxonomy.objects(picture, chosen) if row["path"] in tracks and "box_3d" in row]
    entities = [_box(row, tracks[row["path"]], when) for row in rows]
    gone = SceneEntityDeletion(timestamp=_stamp(when), type=SceneEntityDeletionType.All)
    return SceneUpdate(deletions=[gone], entities=entities)


def _box(row: Mapping[str, Any], track: int, when: int) -> Any:
    from foxglove.messages import Color, CubePrimitive, KeyValuePair, Pose, SceneEntity, Vector3

    place, turn = _placed(kitti.matrix_of(row["pose"]["world_wxyz"]), np.array(row["box_3d"]["centre_world_m"]))
    red, green, blue = track_colour(track)
    x, y, z = (float(side) for side in row["box_3d"]["size_m"])
    cube = CubePrimitive(
        pose=Pose(position=place, orientation=turn),
        size=Vector3(x=x, y=y, z=z),
        color=Color(r=red, g=green, b=blue, a=SOLID),
    )
    words = {"label": row["label"], "path": row["path"]}
    return SceneEntity(
        timestamp=_stamp(when),
        frame_id="world",
        id=str(track),
        metadata=[KeyValuePair(key=key, value=value) for key, value in words.items()],
        cubes=[cube],
    )

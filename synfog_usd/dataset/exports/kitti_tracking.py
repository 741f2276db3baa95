"""KITTI's tracking benchmark and MOTS: clips with labels of 17 columns, masks as run lengths and as pictures.

A sequence is a clip in one lighting and fog.  MOTS knows cars and pedestrians; riders, and those of both classes that
fog hides, are its ignored region, 10000.  Coordinates are those of the object benchmark, see `kitti`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from synfog_usd.base.errors import ParameterError
from synfog_usd.dataset import masks
from synfog_usd.dataset.exports import kitti, taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture, clips
from synfog_usd.dataset.exports.record import Boxed

MOTS = {"car": 1, "person": 2}
"""Class numbers of MOTS."""

IGNORED_CLASSES = ("rider",)
"""Classes that are neither counted as pedestrians nor as anything else."""

IGNORED = 10
A_CLASS = 1000
"""An id of MOTS is its class times this, and the number of its track."""

CUT = (0.15, 0.5)
"""Shares of a thing that lie outside of the picture, from which on `truncated` is 1 and 2."""


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `training/{image_02,instances}/0000/000000.png`, `training/{label_02,instances_txt,calib}/0000.txt`, and
    the list of sequences that the devkit reads.
    """
    listed: list[str] = []
    names: list[str] = []
    for number, (name, frames) in enumerate(clips(pictures(), "KITTI's tracking benchmark").items()):
        sequence = f"{number:04}"
        _write_sequence(folder, sequence, frames, chosen)
        listed.append(f"{sequence} empty {0:06} {len(frames):06}\n")
        names.append(f"{sequence} {name}\n")
    folder.text("evaluate_tracking.seqmap.training", "".join(listed))
    folder.text("sequences.txt", "".join(names))
    return [
        "Boxes of label_02 are amodal, within the picture; a thing that is hidden in a frame has no line there.",
        "truncated is 0 below 15 % of a thing outside of the picture, 1 below 50 %, 2 above.",
        "Masks of MOTS are of the visible pixels; sequences.txt says which clip a number is.",
    ]


def _write_sequence(folder: ExportFolder, sequence: str, frames: Sequence[LabelledPicture], chosen: Boxed) -> None:
    lines: list[str] = []
    runs: list[str] = []
    for frame, picture in enumerate(frames):
        labels, tracks = picture.labels, picture.tracks()
        labels.refuse_fisheye("KITTI")
        folder.place(picture.screen, f"training/image_02/{sequence}/{frame:06}{picture.screen.suffix}")
        objects = [row for row in taxonomy.objects(picture, Boxed(classes=chosen.classes)) if row["path"] in tracks]
        for row in objects:
            dropped = row.get("visibility") in chosen.drop
            lines.append(f"{frame} {_line(row, -1 if dropped else tracks[row['path']], dropped=dropped)}")
        ids = mots_ids(labels.instance, objects, tracks, chosen)
        folder.png(f"training/instances/{sequence}/{frame:06}.png", ids)
        height, width = ids.shape
        for value in np.unique(ids[ids > 0]).tolist():
            text = masks.encode(np.flatnonzero(ids == value), height, width)
            runs.append(f"{frame} {value} {value // A_CLASS} {height} {width} {text}\n")
    folder.text(f"training/label_02/{sequence}.txt", "".join(lines))
    folder.text(f"training/instances_txt/{sequence}.txt", "".join(runs))
    folder.text(f"training/calib/{sequence}.txt", kitti.calibration(frames[0].labels.camera))


def _line(row: dict[str, Any], track: int, *, dropped: bool) -> str:
    """A line of the object benchmark with the number of the track before it, and `truncated` as a level."""
    kind, cut, *rest = kitti.row_of(row, "DontCare" if dropped else kitti.MISC).split()
    level = -1 if kind == "DontCare" else sum(float(cut) >= limit for limit in CUT)
    return " ".join([str(-1 if kind == "DontCare" else track), kind, str(level), *rest]) + "\n"


def mots_ids(instance: np.ndarray, objects: Sequence[dict[str, Any]], tracks: Any, chosen: Boxed) -> np.ndarray:
    """(H, W) uint16 of MOTS: class * 1000 + track, 10000 for what does not count, 0 for all else.

    Raises:
        ParameterError: more tracks than an id has digits for.
    """
    ids = np.zeros(instance.shape, dtype=np.uint16)
    for row in objects:
        kind, track = MOTS.get(row["label"]), tracks[row["path"]]
        if track >= A_CLASS:
            raise ParameterError(
                f"MOTS numbers {A_CLASS - 1} tracks of a clip, and this has more; export fewer --classes"
            )
        if row["label"] in IGNORED_CLASSES or (kind is not None and row.get("visibility") in chosen.drop):
            ids[instance == row["id"]] = IGNORED * A_CLASS
        elif kind is not None:
            ids[instance == row["id"]] = kind * A_CLASS + track
    return ids

"""COCO: boxes and masks of things, one file of annotations for each split.

Masks are run lengths, exact, also where `iscrowd` is 0: pycocotools and what builds on it read them.  Ids of categories
are Cityscapes' label ids.  `bbox` and `area` are of visible pixels; what is amodal stands under `synfog`.  Of a clip
each picture has its `video_id` and `frame_id`, and each annotation its `track_id`.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base.files import write_whole
from synfog_usd.dataset import masks
from synfog_usd.dataset.exports import taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture
from synfog_usd.dataset.exports.record import Boxed

EXTRAS = (
    "path",
    "distance_m",
    "visible_share",
    "amodal_box_px",
    "truncation",
    "pose",
    "box_3d",
    "velocity_m_s",
    "speed_m_s",
    "mean_transmittance",
    "contrast",
    "contrast_rms",
    "cnr",
    "visibility",
)


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `images/<split>/*` and `annotations/instances_<split>.json`."""
    splits = list(dict.fromkeys(picture.split for picture in pictures()))
    for split in splits:
        write_whole(
            folder.root / "annotations" / f"instances_{split}.json",
            functools.partial(_write_split, pictures, folder, chosen, split),
        )
    return [
        "bbox is x, y, width, height of the visible pixels; segmentation is run lengths, also where iscrowd is 0.",
        "synfog.amodal_box_px and synfog.amodal_segmentation are of the whole thing within the picture.",
    ]


def _write_split(
    pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed, split: str, path: Path
) -> None:
    """The annotations as they come, then the shorter list of pictures; memory does not grow with the annotations."""
    images: list[dict[str, Any]] = []
    videos: dict[str, int] = {}
    number = 0
    with path.open("w") as handle:
        handle.write('{"annotations": [')
        for picture in pictures():
            if picture.split != split:
                continue
            labels = picture.labels
            name = f"{picture.name}{picture.screen.suffix}"
            folder.place(picture.screen, f"images/{split}/{name}")
            images.append(
                {
                    "id": len(images) + 1,
                    "file_name": name,
                    "width": labels.size_px[0],
                    "height": labels.size_px[1],
                    "synfog": {**picture.metadata(), "camera": dict(labels.camera), "lanes": labels.lanes},
                }
            )
            if picture.moment is not None:
                video = videos.setdefault(picture.sequence, len(videos) + 1)
                images[-1] |= {"video_id": video, "frame_id": picture.moment.frame}
            tracks = picture.tracks()
            for row in taxonomy.objects(picture, chosen):
                number += 1
                annotation = _annotation(number, len(images), row, labels.mask(row["id"]))
                annotation |= {"track_id": tracks[row["path"]]} if row["path"] in tracks else {}
                text = json.dumps(annotation, allow_nan=False)
                handle.write((",\n" if number > 1 else "\n") + text)
        categories = [{"id": kind.id, "name": kind.name, "supercategory": "thing"} for kind in taxonomy.kinds(chosen)]
        rest = {
            "images": images,
            "categories": categories,
            "info": {"description": "made by synfog-usd"},
            "licenses": [],
            **({"videos": [{"id": id_, "name": name} for name, id_ in videos.items()]} if videos else {}),
        }
        handle.write("\n], " + json.dumps(rest, allow_nan=False)[1:] + "\n")


def _annotation(number: int, image: int, row: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    size = list(mask.shape)
    return {
        "id": number,
        "image_id": image,
        "category_id": row["semantic_id"],
        "bbox": [float(part) for part in row["box_px"]],
        "area": float(row["pixels"]),
        "iscrowd": 0,
        "segmentation": {"size": size, "counts": masks.encode(np.flatnonzero(mask), *mask.shape)},
        "synfog": {
            "instance_id": row["id"],
            **{name: row.get(name) for name in EXTRAS},
            "amodal_segmentation": {"size": size, "counts": row["amodal_rle"]} if "amodal_rle" in row else None,
        },
    }

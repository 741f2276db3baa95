"""Hugging Face: an image folder, which `datasets.load_dataset("imagefolder", data_dir=...)` reads.

Beside the pictures of a split lies `metadata.jsonl`: what each is of, its camera, and lists of boxes, classes and what
fog leaves, one entry for each thing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base.files import write_whole
from synfog_usd.dataset.exports import taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder, jsonl, quantised
from synfog_usd.dataset.exports.frames import LabelledPicture
from synfog_usd.dataset.exports.record import Boxed

STEPS_PER_M = 256.0
OF_FLOAT = ("distance_m", "visible_share", "truncation", "mean_transmittance", "contrast", "cnr")


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `data/<split>/*`, `data/<split>/metadata.jsonl` and `labels/<split>/*_{depth,id,class}.png`."""

    def rows(split: str) -> Iterator[dict[str, Any]]:
        for picture in pictures():
            if picture.split != split:
                continue
            labels = picture.labels
            name = f"{picture.name}{picture.screen.suffix}"
            folder.place(picture.screen, f"data/{split}/{name}")
            stem = f"labels/{split}/{picture.name}"
            folder.png(f"{stem}_depth.png", quantised(labels.depth_m, STEPS_PER_M))
            folder.png(f"{stem}_id.png", np.where(labels.instance < 65536, labels.instance, 0).astype(np.uint16))
            folder.png(f"{stem}_class.png", labels.semantic.astype(np.uint8))
            boxed = list(taxonomy.objects(picture, chosen))
            camera = labels.camera
            yield {
                "file_name": name,
                **{key: value for key, value in picture.metadata().items() if key != "mor_m"},
                "mor_m": -1.0 if picture.clear else float(picture.mor_m),  # type: ignore[arg-type]
                "camera_matrix_px": camera.get("camera_matrix_px", []),
                "camera_to_world": camera["camera_to_world"],
                "objects": {
                    "id": [row["id"] for row in boxed],
                    "bbox": [[float(part) for part in row["box_px"]] for row in boxed],
                    "category": [row["label"] for row in boxed],
                    "visibility": [row.get("visibility") or "" for row in boxed],
                    **{name: [_number(row.get(name)) for row in boxed] for name in OF_FLOAT},
                },
            }

    for split in dict.fromkeys(picture.split for picture in pictures()):

        def fill(temporary: Path, split: str = split) -> None:
            with temporary.open("w", encoding="utf-8") as handle:
                for row in rows(split):
                    handle.write(jsonl([row]))

        write_whole(folder.root / "data" / split / "metadata.jsonl", fill)
    return [
        "bbox is x, y, width, height of the visible pixels; mor_m is -1 in clear air, and so is what is not known.",
        "labels/ has planar depth (uint16 / 256 m, 0 is the sky), ids of instances (uint16) and Cityscapes label ids.",
    ]


def _number(value: float | None) -> float:
    return -1.0 if value is None else float(value)

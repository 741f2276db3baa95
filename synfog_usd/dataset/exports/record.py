"""What an export is: one record for each format, which the command line, the pages and the tests read."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from synfog_usd.base.errors import ParameterError, did_you_mean
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture


@dataclass(frozen=True)
class Boxed:
    """Which instances get a box.

    Attributes:
        drop: words of `visibility` whose instances get none.
        classes: Cityscapes' names of things that get boxes, in the order of YOLO's numbers; all
            things if empty.
    """

    drop: tuple[str, ...] = ()
    classes: tuple[str, ...] = ()


EVERY = Boxed()


@dataclass(frozen=True)
class Exporter:
    """One format.

    Attributes:
        name: as `--as` takes it.
        what: what is written, in a sentence.
        reader: the library or program that reads it.
        depth: what its depth means, or ''.
        boxes: whether it tells of single things; else labels are of pixels.
        clips: whether it is of clips alone.
    """

    name: str
    what: str
    reader: str
    depth: str
    boxes: bool = True
    clips: bool = False

    @property
    def module(self) -> str:
        """Of its `write`."""
        return f"synfog_usd.dataset.exports.{self.name.replace('-', '_')}"

    def write(
        self, pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed
    ) -> list[str]:
        """Write all pictures.

        Args:
            pictures: begins anew at each call.
            folder: to be filled.
            chosen: instances that get a box.

        Returns:
            what a reader of the data card must know besides, in sentences.
        """
        return list(importlib.import_module(self.module).write(pictures, folder, chosen))


EXPORTERS = {
    form.name: form
    for form in (
        Exporter(
            "coco",
            "Boxes and masks of things, with amodal ones and what fog leaves of them under the key `synfog`.",
            "pycocotools",
            "",
        ),
        Exporter(
            "kitti", "Object labels, calibration and depth in the columns of the devkit.", "KITTI's devkit", "planar"
        ),
        Exporter("yolo", "Boxes as text beside the pictures.", "ultralytics", ""),
        Exporter("cityscapes", "Label and instance ids of every picture.", "cityscapesscripts", "planar", boxes=False),
        Exporter(
            "foggy-cityscapes",
            "Clear pictures, foggy ones by their extinction (`_beta_`), transmittance, label and instance ids.",
            "cityscapesscripts",
            "planar; transmittance is along the ray",
            boxes=False,
        ),
        Exporter(
            "vkitti2",
            "Virtual KITTI 2's tree: pictures, depth, classes, instances, poses, boxes; of clips also optical flow.",
            "its published loaders",
            "planar",
        ),
        Exporter(
            "reside",
            "Clear and hazy pairs with transmittance (ITS).",
            "loaders of RESIDE",
            "along the ray",
            boxes=False,
        ),
        Exporter("webdataset", "Tar shards, to a folder or any URL of fsspec.", "webdataset", "planar"),
        Exporter("huggingface", "An image folder with metadata.jsonl.", "datasets", "planar"),
        Exporter(
            "kitti-tracking",
            "Clips with tracks in the columns of the tracking devkit, and masks of MOTS.",
            "KITTI's tracking devkit",
            "",
            clips=True,
        ),
        Exporter("nuscenes", "Clips as nuScenes' tables, cameras alone.", "nuscenes-devkit", "", clips=True),
        Exporter(
            "mcap",
            "Clips in Foxglove's schemas: pictures, calibration, places, boxes in space.",
            "mcap",
            "",
            clips=True,
        ),
    )
}


def exporter(name: str) -> Exporter:
    """The format of that name.

    Raises:
        ParameterError: there is none.
    """
    if name not in EXPORTERS:
        raise ParameterError(f"--as {name}: one of {', '.join(EXPORTERS)}.{did_you_mean(name, EXPORTERS)}")
    return EXPORTERS[name]

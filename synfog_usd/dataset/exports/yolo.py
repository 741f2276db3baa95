"""YOLO as ultralytics reads it: a text beside each picture, `class x y width height`, in shares of the picture."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from synfog_usd.dataset.exports import taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture
from synfog_usd.dataset.exports.record import Boxed


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `images/<split>/*`, `labels/<split>/*.txt` and `data.yaml`."""
    number = {kind.name: index for index, kind in enumerate(taxonomy.kinds(chosen))}
    splits: dict[str, None] = {}
    for picture in pictures():
        splits[picture.split] = None
        width, height = picture.labels.size_px
        folder.place(picture.screen, f"images/{picture.split}/{picture.name}{picture.screen.suffix}")
        lines = []
        for row in taxonomy.objects(picture, chosen):
            x, y, right, bottom = taxonomy.corners(row["box_px"])
            middle = f"{(x + right) / 2 / width:.6f} {(y + bottom) / 2 / height:.6f}"
            lines.append(f"{number[row['label']]} {middle} {(right - x) / width:.6f} {(bottom - y) / height:.6f}\n")
        folder.text(f"labels/{picture.split}/{picture.name}.txt", "".join(lines))
    split_names = list(splits)
    train = "train" if "train" in splits else split_names[0] if split_names else "train"
    val = next((name for name in ("val", "test") if name in splits), train)
    names = "".join(f"  {index}: {kind.name}\n" for index, kind in enumerate(taxonomy.kinds(chosen)))
    test = "test: images/test\n" if "test" in splits else ""
    # without a path, ultralytics starts from the folder of data.yaml; from ., it starts where it was called
    folder.text("data.yaml", f"train: images/{train}\nval: images/{val}\n{test}names:\n{names}")
    notes = ["Boxes are of the visible pixels."]
    return (
        notes if val != train else [*notes, f"There is one split: data.yaml names {train} for training and validation."]
    )

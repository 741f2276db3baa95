"""Exports a set: the format's own files, and beside them a table, a Croissant record and a data card."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.version import __version__
from synfog_usd.dataset.exports import croissant, taxonomy, webdataset
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture, pictures
from synfog_usd.dataset.exports.record import EXPORTERS, Boxed, Exporter

UNSTATED = "not stated"

STANDARD = Boxed(drop=("invisible",))
"""Boxes of all that a camera can see."""


@dataclass
class Census:
    """What an export holds, counted while its table is written.

    Attributes:
        pictures, scenes, boxes, dropped: counts.
        splits, fogs, lightings, sources, classes, visibilities: name -> how many pictures, or things.
    """

    pictures: int = 0
    boxes: int = 0
    dropped: int = 0

    def __post_init__(self) -> None:
        self.splits, self.fogs, self.lightings, self.sources = (Counter[str]() for _ in range(4))
        self.classes, self.visibilities = Counter[str](), Counter[str]()
        self.scenes: dict[str, set[int]] = {}

    def count(self, picture: LabelledPicture, chosen: Boxed) -> int:
        """Add a picture; gives its things that have boxes."""
        self.pictures += 1
        self.splits[picture.split] += 1
        self.fogs[picture.fog] += 1
        self.lightings[picture.lighting] += 1
        self.sources[picture.source] += 1
        self.scenes.setdefault(picture.split, set()).add(picture.scene)
        boxed = 0
        for row in taxonomy.objects(picture, Boxed(classes=chosen.classes)):
            self.visibilities[row.get("visibility") or "unknown"] += 1
            if row.get("visibility") in chosen.drop:
                self.dropped += 1
            else:
                self.classes[row["label"]] += 1
                boxed += 1
        self.boxes += boxed
        return boxed


def export(
    out: Path,
    exporter: Exporter,
    target: Path,
    *,
    chosen: Boxed = STANDARD,
    licence: str = UNSTATED,
    url: str | None = None,
    progress: Progress = silent,
) -> Census:
    """Write a set, or a single bake, in another format.

    Args:
        out: folder of the set or of the bake.
        exporter: the format.
        target: folder to be filled.
        chosen: things that get a box.
        licence: of the pictures, a URL or an SPDX name.
        url: where tar shards go, instead of the folder; of fsspec.
        progress: called with the fraction that is done.

    Raises:
        SynfogError: no set, damaged labels, a folder that cannot be written; classes for a format without boxes.
    """
    _check(out, exporter, target, chosen, url)
    total = sum(1 for _ in pictures(out))
    if not total:
        raise ParameterError(f"{out}: no picture is finished; make some first")
    folder, census, done = ExportFolder(target), Census(), itertools.count(1)

    def counted() -> Iterator[LabelledPicture]:
        for picture in pictures(out):
            yield picture
            progress(f"{exporter.name}: {picture.name}", min(0.99, 0.8 * next(done) / total))

    notes = (
        webdataset.write(counted, folder, chosen, url) if url is not None else exporter.write(counted, folder, chosen)
    )

    rows = ({**picture.metadata(), "things": census.count(picture, chosen)} for picture in pictures(out))
    folder.table("pictures.csv", rows)
    first = next(iter(pictures(out)))
    columns = [*first.metadata(), "things"]
    name = f"{out.resolve().name}-{exporter.name}"
    folder.json(
        "croissant.json",
        croissant.record(
            target, name=name, what=exporter.what, licence=licence, columns=columns, pictures=census.pictures
        ),
    )
    folder.text("README.md", card(name, exporter, census, notes, folder, chosen=chosen, licence=licence))
    progress("done", 1.0)
    return census


def _check(out: Path, exporter: Exporter, target: Path, chosen: Boxed, url: str | None) -> None:
    if target.resolve() == out.resolve() or target.resolve() in out.resolve().parents:
        raise ParameterError(f"--to {target}: that holds the set itself; choose a folder of its own")
    if url is not None and exporter.name != "webdataset":
        raise ParameterError(f"--to {url}: only --as webdataset writes to a URL; choose a folder")
    if chosen.classes and not exporter.boxes:
        boxed = ", ".join(name for name, candidate in EXPORTERS.items() if candidate.boxes)
        raise ParameterError(f"--classes: {exporter.name} labels every pixel and has no boxes to choose; {boxed} have")


def card(
    name: str,
    exporter: Exporter,
    census: Census,
    notes: Iterable[str],
    folder: ExportFolder,
    *,
    chosen: Boxed,
    licence: str,
) -> str:
    """The data card, from the numbers alone."""
    scenes = ", ".join(f"{split} {len(numbers)}" for split, numbers in census.scenes.items())
    gone = ", ".join(chosen.drop) or "none"
    classes = [f"- Boxes are of {', '.join(chosen.classes)} alone; other things have none."] if chosen.classes else []
    lines = [
        *(["---", f"pretty_name: {name}", "---", ""] if exporter.name == "huggingface" else []),
        f"# {name}",
        "",
        f"{exporter.what} Made by synfog-usd {__version__}; read it with {exporter.reader}.",
        "",
        "| | |",
        "|---|---|",
        f"| pictures | {census.pictures} ({_counts(census.splits)}) |",
        f"| scenes | {scenes}; splits are by scene |",
        f"| sources | {_counts(census.sources)} |",
        f"| lightings | {_counts(census.lightings)} |",
        f"| fogs | {_counts(census.fogs)} |",
        f"| boxes | {census.boxes} ({_counts(census.classes)}) |",
        f"| what fog and noise leave of things | {_counts(census.visibilities)} |",
        f"| without a box | {census.dropped} things ({gone}) |",
        f"| depth | {exporter.depth or 'none'} |",
        f"| licence | {licence} |",
        "",
        "## What to know",
        *(f"- {note}" for note in notes),
        *classes,
        "- Labels are of clear air, from the ray through each pixel's centre. A thing is `visible` from a contrast of "
        "5 % (WMO-No. 8) and a contrast-to-noise ratio of 5 (Rose 1948) on, `invisible` below a ratio of 1.",
        "- RAW pairs of one scene and lighting share geometry, exposure, white balance and the sensor's fixed "
        "patterns; temporal noise is drawn anew, unless the set says same_noise.",
        "- Everything is rendered: no person, number plate or place is real.",
        f"- {folder.linked} files are links to the set's own and {folder.copied} copies.",
        "",
        "`pictures.csv` has a row for each picture; `croissant.json` describes it to programs.",
        "",
    ]
    return "\n".join(lines)


def _counts(counter: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counter.items())) or "none"


def is_url(text: str) -> bool:
    """Whether a target is one of fsspec's URLs."""
    return "://" in text

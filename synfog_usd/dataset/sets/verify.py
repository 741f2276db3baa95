"""Whether a set is what it was when it was made, and whether labels and pictures agree.

Hashes tell that a file is the one that was written; labels against pictures, that what was written makes sense.
"""

from __future__ import annotations

import concurrent.futures
import json
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base import image
from synfog_usd.base.errors import SynfogError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.system import cores
from synfog_usd.camera import writers
from synfog_usd.dataset.sets import identity, index, journal, layout
from synfog_usd.dataset.sets.layout import Unit
from synfog_usd.dataset.sets.scenes import scenes
from synfog_usd.dataset.sets.unit import changed, record, rows

AHEAD = 4


@dataclass(frozen=True)
class Fault:
    """One thing of a set that is not as it should be.

    Attributes:
        unit: name, or '' for the set itself.
        text: what.
        missing: whether it is only not made yet.
    """

    unit: str
    text: str
    missing: bool = False


def verify(out: Path, *, progress: Progress = silent) -> Iterator[Fault]:
    """Look at every file of a set.

    Args:
        out: its folder.
        progress: called with the fraction of units that were looked at.

    Raises:
        SetError: no set lies there.
    """
    identity.read(out)
    definition = journal.kept_definition(out)
    waiting = deque[tuple[Unit, concurrent.futures.Future[list[Fault]]]]()
    rows_of: dict[int, list[dict[str, Any]]] = {}

    def next_result() -> list[Fault]:
        unit, future = waiting.popleft()
        faults = future.result()
        progress(unit.name, unit.number / definition.scenes)
        return faults

    with concurrent.futures.ThreadPoolExecutor(cores()) as pool:
        for planned in scenes(definition):
            part = planned.number // layout.A_FOLDER
            if planned.number % layout.A_FOLDER == 0:
                yield from _index(out, part - 1, rows_of.pop(part - 1, []))
            for unit in planned.units:
                if not (out / unit.folder / layout.UNIT).exists():
                    yield Fault(unit.name, "is not made", missing=True)
                    continue
                unit_record = _made(out, unit)
                rows_of.setdefault(part, []).extend(rows(unit_record, unit) if unit_record else ())
                waiting.append((unit, pool.submit(_of_unit, out, unit)))
                if len(waiting) > AHEAD * cores():
                    yield from next_result()
        while waiting:
            yield from next_result()
    for part, expected in rows_of.items():
        yield from _index(out, part, expected)
    progress("done", 1.0)


def _made(out: Path, unit: Unit) -> dict[str, Any] | None:
    try:
        return record(out, unit)
    except SynfogError:
        return None  # reported with its files


def _index(out: Path, part: int, expected: list[dict[str, Any]]) -> Iterator[Fault]:
    if part < 0:
        return
    path = layout.part_path(out, part)
    try:
        there = list(index.rows_of_part(path)) if path.exists() else []
    except SynfogError as error:
        yield Fault("", str(error))
        return
    if there != expected:
        yield Fault("", f"{path}: {len(there)} rows, which are not the {len(expected)} of what is made; run writes it")


def _of_unit(out: Path, unit: Unit) -> list[Fault]:
    folder = out / unit.folder
    wrong = [Fault(unit.name, text) for text in changed(folder)]
    return wrong or [Fault(unit.name, text) for text in disagreements(folder)]


def disagreements(folder: Path) -> Iterator[str]:
    """In which points labels and pictures of a unit do not fit each other, in words.

    `labels.json` is counted again from `labels.exr`; pictures have the size of their records; radiance is finite,
    and transmittance between 0 and 1.
    """
    try:
        unit_record = json.loads((folder / layout.UNIT).read_bytes())
        listed = json.loads((folder / "labels.json").read_bytes())["instances"]
        image_of_labels = writers.read_exr(folder / "labels.exr", quantity=image.Quantity.DATA)
        ids = image_of_labels.pixels[:, :, image_of_labels.channels.index("instance.ID")].astype(np.int64)
        yield from _labels(ids, listed)
        for shot in unit_record["shots"]:
            yield from _shot(folder / shot["folder"], shot, ids.shape)
            for name, picture in shot["pictures"].items():
                yield from _pictures(folder / picture["folder"], name, picture["outputs"], shot["size_px"])
    except (SynfogError, OSError, ValueError, KeyError, TypeError) as error:
        yield f"cannot be read: {error}"


def _labels(ids: np.ndarray, listed: list[Mapping[str, Any]]) -> Iterator[str]:
    counted = dict(zip(*(part.tolist() for part in np.unique(ids[ids > 0], return_counts=True)), strict=True))
    by_id = {row["id"]: row for row in listed}
    if unknown := sorted(set(counted) - set(by_id)):
        yield f"labels.exr shows instances that labels.json does not list: {unknown[:5]}"
    for number, row in by_id.items():
        if row["pixels"] != counted.get(number, 0):
            yield f"labels.json gives instance {number} {row['pixels']} pixels, labels.exr {counted.get(number, 0)}"
        elif row["pixels"]:
            y, x = np.nonzero(ids == number)
            box = [int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1]
            if row["box_px"] != box:
                yield f"labels.json gives instance {number} the box {row['box_px']}, labels.exr {box}"


def _shot(folder: Path, shot: Mapping[str, Any], shape: tuple[int, ...]) -> Iterator[str]:
    width, height = shot["size_px"]
    if shape != (height, width):
        yield f"labels.exr is {shape[1]} x {shape[0]}, the picture of {shot['folder']} {width} x {height}"
    writers.read_exr(folder / "radiance.exr")  # refuses what light cannot be
    layers = writers.read_exr(folder / "layers.exr", quantity=image.Quantity.DATA, channels=["transmittance.Y"])
    if not ((layers.pixels >= 0.0) & (layers.pixels <= 1.0)).all():
        yield f"{shot['folder']}/layers.exr: a transmittance outside 0 to 1"


def _pictures(folder: Path, name: str, outputs: list[str], size: list[int]) -> Iterator[str]:
    from PIL import Image

    for output in outputs:
        if output.endswith((".png", ".jpg")):
            with Image.open(folder / output) as picture:
                if list(picture.size) != size:
                    yield f"{folder.name}/{output} of {name} is {picture.size}, not {size}"

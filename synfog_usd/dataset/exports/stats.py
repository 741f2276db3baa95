"""Figures of a set: what is in it, how far, how hidden, how bright, how large; pixels beside those of Cityscapes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base import cityscapes, photometry
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.dataset.exports import taxonomy
from synfog_usd.dataset.exports.frames import LabelledPicture, pictures, read_labels

HUMANS = ("person", "rider")
VEHICLES = ("car", "truck", "bus", "caravan", "trailer", "train", "motorcycle", "bicycle")
DISTANCES_M = (10, 20, 40, 80, 160, 320)
SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)
NAMES = {kind.id: kind.name for kind in cityscapes.LABELS.values()}
STATES = ("visible", "faint", "invisible", "not told")

CITYSCAPES_PIXELS = {
    "road": 32.7, "sidewalk": 5.3, "building": 20.1, "wall": 0.59, "fence": 0.77, "pole": 1.12, "traffic light": 0.18,
    "traffic sign": 0.50, "vegetation": 14.3, "terrain": 0.98, "sky": 3.5, "person": 1.1, "rider": 0.13, "car": 6.0,
    "truck": 0.24, "bus": 0.23, "train": 0.19, "motorcycle": 0.085, "bicycle": 0.40,
}  # fmt: skip
"""Share of the pixels of the fine training pictures [%].

Source: Birke, automotive-segmentation-datasets (github.com/m-birke), cityscapes.md, who counted the published label
pictures.  Inverse class weights that others train with say the same within 6 %.
"""


@dataclass
class Figures:
    """What is counted.

    Attributes:
        pictures, scenes: how many.
        objects: class -> (state of visibility -> how many), over all pictures.
        distances, shares: upper end [m], or of the visible share -> (state -> how many).
        fogs: name -> (state -> how many).
        fog_m: name of a fog -> its MOR [m], None in clear air.
        pixels: class -> pixels, of each view once.
        luminance: (lighting, fog) -> geometric mean, median, 1st and 99th percentile of each picture [cd m-2].
        bytes: name of a file -> bytes on disk.
    """

    pictures: int = 0
    scenes: set[int] = field(default_factory=set)
    splits: Counter[str] = field(default_factory=Counter)
    objects: dict[str, Counter[str]] = field(default_factory=dict)
    distances: dict[str, Counter[str]] = field(default_factory=dict)
    shares: dict[str, Counter[str]] = field(default_factory=dict)
    fogs: dict[str, Counter[str]] = field(default_factory=dict)
    fog_m: dict[str, float | None] = field(default_factory=dict)
    pixels: Counter[str] = field(default_factory=Counter)
    luminance: dict[tuple[str, str], list[tuple[float, ...]]] = field(default_factory=dict)
    bytes: Counter[str] = field(default_factory=Counter)

    def a_picture(self, classes: Sequence[str], states: Iterable[str] = STATES) -> float:
        """Mean count of some classes in a picture."""
        total = sum(self.objects.get(name, Counter())[state] for name in classes for state in states)
        return total / max(self.pictures, 1)

    def share(self, name: str) -> float:
        """Part of the pixels of evaluated classes that have a class [%]."""
        return 100.0 * self.pixels[name] / max(sum(self.pixels[label] for label in CITYSCAPES_PIXELS), 1)

    def metadata(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {
            "pictures": self.pictures,
            "scenes": len(self.scenes),
            "splits": dict(self.splits),
            "humans_a_picture": round(self.a_picture(HUMANS), 4),
            "vehicles_a_picture": round(self.a_picture(VEHICLES), 4),
            "things": {name: dict(states) for name, states in sorted(self.objects.items())},
            "distances_m": {name: dict(states) for name, states in self.distances.items()},
            "visible_shares": {name: dict(states) for name, states in self.shares.items()},
            "fogs": {name: {"mor_m": self.fog_m[name], **states} for name, states in self.fogs.items()},
            "pixels_percent": {name: round(self.share(name), 3) for name in CITYSCAPES_PIXELS},
            "luminance_cd_m2": {
                f"{lighting}/{fog}": dict(
                    zip(("geometric_mean", "median", "p1", "p99"), np.median(rows, axis=0).tolist(), strict=True)
                )
                for (lighting, fog), rows in self.luminance.items()
            },
            "bytes": dict(self.bytes),
        }


def gather(out: Path, *, progress: Progress = silent) -> Figures:
    """Count a set, or a single bake; memory grows with the categories, not with the set.

    Raises:
        SynfogError: no set, or damaged labels.
    """
    total = sum(1 for _ in pictures(out))
    if not total:
        raise ParameterError(f"{out}: no picture is finished; make some first")
    figures = Figures()
    for name in (*(f"to {end} m" for end in DISTANCES_M), f"beyond {DISTANCES_M[-1]} m"):
        figures.distances[name] = Counter()
    for end in SHARES:
        figures.shares[f"to {end:.0%}"] = Counter()
    before: frozenset[Path] = frozenset()
    shot = view = None
    for number, picture in enumerate(pictures(out)):
        progress(f"stats: {picture.name}", min(0.99, number / total))
        _count(figures, picture)
        if shot != picture.files["radiance.exr"]:  # pipelines share it
            shot = picture.files["radiance.exr"]
            figures.luminance.setdefault((picture.lighting, picture.fog), []).append(_light(picture))
        if view != picture.files["labels.exr"]:  # fogs share it
            view = picture.files["labels.exr"]
            ids, counts = np.unique(read_labels(view, picture.files["labels.json"]).semantic, return_counts=True)
            for index, count in zip(ids.tolist(), counts.tolist(), strict=True):
                figures.pixels[NAMES[index]] += count
        now = frozenset(picture.files.values())
        for name, path in picture.files.items():
            if path not in before and path.is_file():
                figures.bytes[name] += path.stat().st_size
        before = now
    progress("done", 1.0)
    return figures


def _count(figures: Figures, picture: LabelledPicture) -> None:
    figures.pictures += 1
    figures.scenes.add(picture.scene)
    figures.splits[picture.split] += 1
    figures.fog_m[picture.fog] = None if picture.clear else picture.mor_m
    of_fog = figures.fogs.setdefault(picture.fog, Counter())
    for row in taxonomy.objects(picture):
        state = row.get("visibility") or "not told"
        figures.objects.setdefault(row["label"], Counter())[state] += 1
        end = next((f"to {end} m" for end in DISTANCES_M if row["distance_m"] <= end), f"beyond {DISTANCES_M[-1]} m")
        figures.distances[end][state] += 1
        share = next(f"to {end:.0%}" for end in SHARES if row.get("visible_share", 1.0) <= end)
        figures.shares[share][state] += 1
        of_fog[state] += 1


def _light(picture: LabelledPicture) -> tuple[float, float, float, float]:
    from synfog_usd.camera import writers

    light = photometry.luminance(writers.read_exr(picture.files["radiance.exr"])).astype(np.float64)
    low, middle, high = np.percentile(light, [1.0, 50.0, 99.0])
    positive = light[light > 0.0]
    mean = math.exp(float(np.log(positive).mean())) if positive.size else 0.0
    return mean, float(middle), float(low), float(high)


def text(figures: Figures) -> str:
    """The figures as tables of Markdown."""
    groups = {
        "class": figures.objects,
        "fog": figures.fogs,
        "distance of the nearest pixel": figures.distances,
        "share of pixels that nothing hides": figures.shares,
    }
    total = 100.0 / sum(CITYSCAPES_PIXELS.values())
    tables = [
        _table(
            ["class", "pixels here, %", "Cityscapes, %"],
            [[name, f"{figures.share(name):.2f}", f"{share * total:.2f}"] for name, share in CITYSCAPES_PIXELS.items()],
        ),
        *(
            _table(
                [f"things by {kind}", *STATES], [[name, *(str(row[state]) for state in STATES)] for name, row in group]
            )
            for kind, group in ((kind, rows.items()) for kind, rows in groups.items())
        ),
        _table(
            ["luminance [cd/m2], median over shots", "shots", "geometric mean", "median", "1 %", "99 %"],
            [
                [f"{lighting}, {fog}", str(len(rows)), *(f"{value:.3g}" for value in np.median(rows, axis=0))]
                for (lighting, fog), rows in sorted(figures.luminance.items())
            ],
        ),
        _table(
            ["file", "on disk", "a picture"],
            [[name, _size(size), _size(size / figures.pictures)] for name, size in figures.bytes.most_common()],
        ),
    ]
    return "\n\n".join(tables)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} TB"

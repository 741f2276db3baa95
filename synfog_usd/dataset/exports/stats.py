"""One page of figures of a set: what is in it, how far, how hidden, how bright, how large; beside published ones."""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from synfog_usd.base import cityscapes, files, photometry
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

CORDTS = "Cordts et al. (2016), The Cityscapes Dataset, CVPR, table 2 (training and validation)"
PUBLISHED: tuple[tuple[str, dict[str, str], str], ...] = (
    (
        "Cityscapes (fine)",
        {"pictures": "5000", "fogs": "none", "humans a picture": "7.0", "vehicles a picture": "11.8"},
        f"{CORDTS}; 2975, 500 and 1525 pictures for training, validation and testing",
    ),
    (
        "KITTI (objects)",
        {"pictures": "7481 + 7518", "fogs": "none", "humans a picture": "0.8", "vehicles a picture": "4.1"},
        f"{CORDTS}; pictures: readme of the object benchmark's devkit",
    ),
    (
        "SynFog",
        {
            "pictures": "500 scenes x 2 lightings x 4",
            "fogs": "clear, MOR 600, 300 and 150 m",
            "humans a picture": "not published",
            "vehicles a picture": "not published",
        },
        "Xie et al. (2024), SynFog, CVPR",
    ),
)

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
        things: class -> (state of visibility -> how many), over all pictures.
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
    things: dict[str, Counter[str]] = field(default_factory=dict)
    distances: dict[str, Counter[str]] = field(default_factory=dict)
    shares: dict[str, Counter[str]] = field(default_factory=dict)
    fogs: dict[str, Counter[str]] = field(default_factory=dict)
    fog_m: dict[str, float | None] = field(default_factory=dict)
    pixels: Counter[str] = field(default_factory=Counter)
    luminance: dict[tuple[str, str], list[tuple[float, ...]]] = field(default_factory=dict)
    bytes: Counter[str] = field(default_factory=Counter)

    def a_picture(self, classes: Sequence[str], states: Iterable[str] = STATES) -> float:
        """Mean count of some classes in a picture."""
        total = sum(self.things.get(name, Counter())[state] for name in classes for state in states)
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
            "things": {name: dict(states) for name, states in sorted(self.things.items())},
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
    for row in taxonomy.things(picture):
        state = row.get("visibility") or "not told"
        figures.things.setdefault(row["label"], Counter())[state] += 1
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


def write(figures: Figures, path: Path, *, title: str) -> None:
    """Write the page: HTML without scripts or other files."""
    files.write_bytes(path, page(figures, title).encode())


def page(figures: Figures, title: str) -> str:
    """The page's text."""
    total = sum(sum(states.values()) for states in figures.things.values())
    parts = [
        "<!DOCTYPE html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<style>{STYLE}</style></head><body>",
        f"<h1>{html.escape(title)}</h1>",
        f"<p>{figures.pictures} pictures of {len(figures.scenes)} scene{'' if len(figures.scenes) == 1 else 's'} "
        f"({', '.join(f'{html.escape(name)} {n}' for name, n in figures.splits.items())}); {total} things in them, "
        f"counted in every picture; {_size(sum(figures.bytes.values()))} on disk.</p>",
        "<h2>Beside published sets</h2>",
        _beside_published(figures, title),
        "<p>Annotators leave out what is small or far; a renderer does not. So counts here are higher for the same "
        "street.</p>",
        "<h2>Pixels by class</h2>",
        _table(
            ["class", "here, %", "Cityscapes, %"],
            [
                [name, f"{figures.share(name):.2f}", f"{100.0 * share / sum(CITYSCAPES_PIXELS.values()):.2f}"]
                for name, share in CITYSCAPES_PIXELS.items()
            ],
        ),
        "<p>Of what belongs to a class that is evaluated. Cityscapes: the fine training pictures, 2:1, which see less "
        "sky than 16:9; counted by Birke (github.com/m-birke/automotive-segmentation-datasets).</p>",
        f"<p class=legend>{' '.join(f'<span class={_slug(state)}>{state}</span>' for state in STATES)}</p>",
        _bars("Things by class", figures.things),
        _bars("Things by fog", figures.fogs),
        _bars("Things by distance of their nearest pixel", figures.distances),
        _bars("Things by share of their pixels that nothing stands before", figures.shares),
        "<h2>Luminance</h2>",
        _table(
            ["lighting", "fog", "shots", "geometric mean", "median", "1st percentile", "99th percentile"],
            [
                [lighting, fog, str(len(rows)), *(f"{value:.3g}" for value in np.median(rows, axis=0))]
                for (lighting, fog), rows in sorted(figures.luminance.items())
            ],
        ),
        "<p>cd/m2, of each shot's radiance; the median over the shots.</p>",
        "<h2>Size on disk</h2>",
        _table(
            ["file", "size", "a picture"],
            [
                [name, _size(size), _size(size / figures.pictures)]
                for name, size in sorted(figures.bytes.items(), key=lambda row: -row[1])
            ],
        ),
        "</body></html>\n",
    ]
    return "\n".join(parts)


def _beside_published(figures: Figures, title: str) -> str:
    count, states = figures.a_picture, ("visible", "faint", "not told")
    fogs = (name if mor is None else f"{name} ({mor:g} m)" for name, mor in sorted(figures.fog_m.items()))
    row = [
        title,
        str(figures.pictures),
        ", ".join(fogs),
        f"{count(HUMANS):.1f} ({count(HUMANS, states):.1f} without invisible ones)",
        f"{count(VEHICLES):.1f} ({count(VEHICLES, states):.1f} without invisible ones)",
        "counted here: every thing with a pixel",
    ]
    heads = ["set", "pictures", "fogs", "humans a picture", "vehicles a picture", "source"]
    return _table(heads, [row, *([name, *numbers.values(), source] for name, numbers, source in PUBLISHED)])


def _bars(title: str, groups: dict[str, Counter[str]]) -> str:
    most = max((sum(states.values()) for states in groups.values()), default=0) or 1
    rows = []
    for name, states in groups.items():
        bars = "".join(
            f'<i class="{_slug(state)}" style="width:{100.0 * states[state] / most:.2f}%"></i>'
            for state in STATES
            if states[state]
        )
        words = ", ".join(f"{states[state]} {state}" for state in STATES if states[state])
        rows.append(f"<tr><th>{html.escape(name)}</th><td class=bar>{bars}</td><td>{words or '0'}</td></tr>")
    return f"<h2>{html.escape(title)}</h2><table class=bars>{''.join(rows)}</table>"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["".join(f"<td>{html.escape(cell)}</td>" for cell in row) for row in rows]
    top = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
    return f"<div class=wide><table><tr>{top}</tr>{''.join(f'<tr>{line}</tr>' for line in lines)}</table></div>"


def _slug(state: str) -> str:
    return state.replace(" ", "-")


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.3g} TB"


STYLE = """
:root { color-scheme: light dark }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 1.5rem auto; padding: 0 1rem }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
td, th { padding: .2rem .7rem .2rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid #8884 }
.wide { overflow-x: auto }
.bars { width: 100% } .bars th { font-weight: 400; white-space: nowrap } .bar { width: 60% }
.bar i { display: inline-block; height: .9em }
i.visible { background: #2f9e6e } i.faint { background: #e5a00d } i.invisible { background: #d6404a }
i.not-told { background: #999 }
.legend span { padding: .1rem .5rem; margin-right: .4rem; color: #fff; border-radius: 4px }
.legend .visible { background: #24805a } .legend .faint { background: #94680a }
.legend .invisible { background: #c22f3a }
.legend .not-told { background: #666 }
"""

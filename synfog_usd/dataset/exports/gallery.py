"""A folder of static pages that shows a set: it opens from disk, offline, without a server.

    GALLERY/index.html app.js style.css     the page
    GALLERY/data/index.js                   one row for each picture, as numbers
    GALLERY/data/views/000/12.js            of one view (scene, frame, lighting, camera): things, planes, RAW
    GALLERY/thumbs/000/345.jpg              one for each picture

A browser lets a page from disk read no file, but run scripts and show pictures.  So data are scripts, and what
the pointer reads lies in them as lossless PNG.  Planes and RAW are thinned to `WIDEST` pixels, without averaging.  The
pictures themselves stay where the set has them, and the page links to them.  A clip plays, with a colour for each
track.
"""

from __future__ import annotations

import base64
import itertools
import json
import math
import os
import urllib.parse
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from synfog_usd.base import files
from synfog_usd.base.cityscapes import LABELS
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.dataset.exports import taxonomy
from synfog_usd.dataset.exports.folder import ExportFolder, png_bytes, quantised
from synfog_usd.dataset.exports.frames import LabelledPicture, Labels, pictures

PAGE = ("index.html", "app.js", "style.css")
THUMB_PX = 240
WIDEST = 640
A_FOLDER = 1000
STEPS_PER_M = 64.0
"""Depth in the page's planes: up to 1,023 m."""

FASTEST = 0.05
"""Flow, as a share of the picture's width, from which on its colour is full."""

BINS = 64
OF_TEXT = ("split", "source", "lighting", "fog", "pipeline", "camera")
"""What pictures are filtered by; each is a number in a row, of a list of words."""

TOLD = (
    "id",
    "label",
    "path",
    "box_px",
    "amodal_box_px",
    "distance_m",
    "visible_share",
    "truncation",
    "speed_m_s",
)
LEFT = ("mean_transmittance", "contrast", "cnr", "visibility")


def build(out: Path, target: Path, *, progress: Progress = silent) -> int:
    """Write the gallery of a set, or of a single bake.

    Returns:
        how many pictures it shows.

    Raises:
        SynfogError: no set, damaged labels, a folder that cannot be written.
    """
    total = sum(1 for _ in pictures(out))
    if not total:
        raise ParameterError(f"{out}: no picture is finished; make some first")
    folder = ExportFolder(target)
    done = itertools.count(1)

    def rows() -> Iterator[dict[str, Any]]:
        number = itertools.count()
        for view, (_, group) in enumerate(itertools.groupby(pictures(out), key=_view_of)):
            shown = list(group)
            _write_view(folder, view, shown)
            for picture in shown:
                _write_thumb(folder, next(number), picture.screen)
                progress(f"gallery: {picture.name}", min(0.99, next(done) / total))
                yield row_of(picture, view)

    write_index(folder, rows(), title=out.resolve().name)
    for name in PAGE:
        folder.text(name, Path(__file__).with_name("page").joinpath(name).read_text(encoding="utf-8"))
    progress("done", 1.0)
    return total


def row_of(picture: LabelledPicture, view: int) -> dict[str, Any]:
    """What the index knows of a picture."""
    classes = sorted({row["label"] for row in taxonomy.objects(picture)})
    values = {name: getattr(picture, name) for name in OF_TEXT}
    mor = None if picture.clear else picture.mor_m
    row = {"name": picture.name, "scene": picture.scene, **values, "mor_m": mor, "classes": classes, "view": view}
    if picture.moment is not None:
        row |= {"clip": picture.sequence, "frame": picture.moment.frame, "per_s": picture.moment.per_s}
    return row


def write_index(folder: ExportFolder, rows: Iterable[dict[str, Any]], *, title: str) -> None:
    """Write `data/index.js`: words once, and for each picture a short row of numbers."""
    words: dict[str, dict[str, int]] = {name: {} for name in OF_TEXT}
    classes: dict[str, int] = {}
    clips: dict[tuple[str, float], int] = {}
    shards = []
    for row in rows:
        bits = sum(1 << classes.setdefault(name, len(classes)) for name in row["classes"])
        numbers = [words[name].setdefault(row[name], len(words[name])) for name in OF_TEXT]
        moment = []
        if "clip" in row:
            moment = [clips.setdefault((row["clip"], row["per_s"]), len(clips)), row["frame"]]
        shards.append([row["name"], row["scene"], row["view"], row["mor_m"], bits, *numbers, *moment])
    data = {
        "title": title,
        "words": {name: list(values) for name, values in words.items()},
        "classes": list(classes),
        "per_s": [per_s for _, per_s in clips],
        "colours": {kind.name: list(kind.colour) for kind in LABELS.values()},
        "rows": shards,
    }
    folder.text("data/index.js", f"window.SYNFOG_INDEX = {_script(data)};\n")


def _view_of(picture: LabelledPicture) -> tuple[Any, ...]:
    return picture.scene, picture.moment, picture.lighting, picture.camera


def _write_thumb(folder: ExportFolder, number: int, source: Path) -> None:
    import io

    from PIL import Image

    data = io.BytesIO()
    with Image.open(source) as picture:
        picture.draft("RGB", (THUMB_PX, THUMB_PX))
        shown = picture.convert("RGB")
        shown.thumbnail((THUMB_PX, THUMB_PX))
        shown.save(data, "JPEG", quality=82)
    files.write_bytes(folder.root / "thumbs" / f"{number // A_FOLDER:03}" / f"{number}.jpg", data.getvalue())


def _write_view(folder: ExportFolder, number: int, shown: Sequence[LabelledPicture]) -> None:
    """All that the page knows of a view."""
    labels = shown[0].labels
    step = max(1, math.ceil(labels.size_px[0] / WIDEST))
    place = folder.root.resolve()
    fogs: dict[str, Any] = {}
    views = []
    boxed = [row for row in labels.instances if row["pixels"] and row["label"] in taxonomy.NAMES]
    tracks = shown[0].tracks()
    for picture in shown:
        if picture.fog not in fogs:
            fogs[picture.fog] = _of_fog(picture, step)
        links = {name: _link(path, place) for name, path in sorted(picture.files.items()) if path.is_file()}
        views.append(
            {
                "name": picture.name,
                "fog": picture.fog,
                "pipeline": picture.pipeline,
                "mor_m": None if picture.clear else picture.mor_m,
                "screen": _link(picture.screen, place),
                "files": links,
                "histogram": _histogram(picture.screen),
                "raw": _raw(picture),
            }
        )
    data = {
        "size": list(labels.size_px),
        "step": step,
        "things": [
            {name: row[name] for name in TOLD if name in row}
            | ({"track": tracks[row["path"]]} if row["path"] in tracks else {})
            for row in boxed
        ],
        "planes": _planes(labels, step) | _flow(shown[0], step),
        "fogs": fogs,
        "pictures": views,
    }
    text = f"window.SYNFOG_VIEW && window.SYNFOG_VIEW({number}, {_script(data)});\n"
    folder.text(f"data/views/{number // A_FOLDER:03}/{number}.js", text)


def _of_fog(picture: LabelledPicture, step: int) -> dict[str, Any]:
    clear = np.clip(picture.transmittance(), 0.0, 1.0)[::step, ::step]
    by_name = {
        row["id"]: [row.get(name) for name in LEFT] for row in picture.instances() if row["label"] in taxonomy.NAMES
    }
    return {"left": by_name, "transmittance": _uri(_pair(np.rint(clear * 65535.0)))}


def _planes(labels: Labels, step: int) -> dict[str, str]:
    ids = labels.instance[::step, ::step]
    return {
        "id": _uri(np.stack([ids & 255, (ids >> 8) & 255, (ids >> 16) & 255], axis=2).astype(np.uint8)),
        "semantic": _uri(labels.semantic[::step, ::step].astype(np.uint8)),
        "depth": _uri(_pair(quantised(labels.depth_m[::step, ::step], STEPS_PER_M))),
    }


def _flow(picture: LabelledPicture, step: int) -> dict[str, str]:
    """Flow to the next frame as colours, the hue its direction and the strength its length; the last frame has what led
    to it.
    """
    ahead, back = picture.flow("forward"), picture.flow("backward")
    if ahead is None and back is None:
        return {}
    way = ahead[::step, ::step, :2] if ahead is not None else -back[::step, ::step, :2]  # type: ignore[index]
    hue = np.arctan2(way[..., 1], way[..., 0]) / (2.0 * np.pi) % 1.0
    strength = np.minimum(np.hypot(way[..., 0], way[..., 1]) / (FASTEST * picture.labels.size_px[0]), 1.0)
    pure = np.clip(np.abs((hue[..., None] + [1.0, 2.0 / 3.0, 1.0 / 3.0]) % 1.0 * 6.0 - 3.0) - 1.0, 0.0, 1.0)
    colours = 1.0 + strength[..., None] * (pure - 1.0)
    return {"flow": _uri(np.rint(255.0 * colours).astype(np.uint8))}


def _raw(picture: LabelledPicture) -> dict[str, Any] | None:
    """Blocks of 2 x 2 of the RAW, each number as it was read less the black level, rounded."""
    from synfog_usd.camera import writers

    path = next((path for name, path in sorted(picture.files.items()) if path.suffix == ".dng"), None)
    if path is None:
        return None
    raw = writers.read_raw(path)
    pixels = np.clip(np.rint(raw.pixels[..., 0]), -32768, 32767).astype(np.int64) + 32768
    height, width = (side // 2 * 2 for side in pixels.shape)
    step = max(1, math.ceil(width / 2 / (WIDEST // 2)))
    blocks = [pixels[y:height:2, x:width:2][::step, ::step] for y in (0, 1) for x in (0, 1)]
    wide = np.concatenate(blocks, axis=1)
    return {"uri": _uri(_pair(wide)), "step": 2 * step, "pattern": str(raw.provenance.get("cfa_pattern", ""))}


def _pair(numbers: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """(H, W) numbers of 16 bits as two colours."""
    whole = np.asarray(numbers).astype(np.int64)
    return np.stack([whole >> 8, whole & 255, np.zeros_like(whole)], axis=2).astype(np.uint8)


def _histogram(path: Path) -> list[list[int]]:
    from PIL import Image

    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    return [np.bincount(pixels[..., channel].ravel() // (256 // BINS), minlength=BINS).tolist() for channel in range(3)]


def _uri(pixels: npt.NDArray[np.uint8]) -> str:
    return "data:image/png;base64," + base64.b64encode(png_bytes(pixels)).decode("ascii")


def _link(path: Path, place: Path) -> str:
    return urllib.parse.quote(Path(os.path.relpath(path.resolve(), place)).as_posix())


def _script(data: object) -> str:
    """JSON that may stand in a script."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("</", "<\\/")

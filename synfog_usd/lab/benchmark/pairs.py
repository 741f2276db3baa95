"""Pairs of a foggy picture and the same view in clear air: from sets, bakes, and folders of other data sets."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from synfog_usd.base.errors import ParameterError
from synfog_usd.dataset.rig import RIG
from synfog_usd.dataset.sequence import SEQUENCE
from synfog_usd.dataset.sets import index

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")

FOGGY_FOLDERS, CLEAR_FOLDERS = ("hazy", "haze", "foggy", "input"), ("gt", "clear", "GT", "target")
"""How the folders of RESIDE (hazy, clear or gt), O-HAZE (hazy, GT) and their like are called."""


@dataclass(frozen=True)
class Pair:
    """A view with and without fog.

    Attributes:
        name: unlike any other's, for tables and results.
        scene: pairs of one scene are not independent; intervals are over scenes.
        fog: name of the fog, or '' where the source does not say.
        clear, foggy: pictures.
        files: of the foggy shot, by name, for methods that take another than the picture.
    """

    name: str
    scene: str
    fog: str
    clear: Path
    foggy: Path
    files: dict[str, Path] = field(default_factory=dict)


def find(source: Path, *, picture: str = "srgb.png", clear: str = "clear", split: str = "") -> list[Pair]:
    """All pairs of a source, in an order that depends on its names alone.

    Args:
        source: folder of a set, of a bake, also of a rig or of frames, or with one folder of foggy and one of clear
            pictures.
        picture: which output of a set or bake is compared.
        clear: the fog that counts as none.
        split: of a set; all if left out.

    Raises:
        ParameterError: no such folder, or no pair in it.
    """
    if not source.is_dir():
        raise ParameterError(f"{source}: no such folder")
    if index.is_set(source):
        result = list(_of_set(source, picture, clear, split))
    else:
        bakes = list(_bakes_in(source))
        result = [pair for words, folder in bakes for pair in _of_bake(folder, picture, clear, words)]
        result = result if bakes else list(_of_folders(source))
    if not result:
        raise ParameterError(
            f"{source}: no pair of a foggy picture and the same view in clear air. It takes a set or bake with "
            f"{picture} under {clear!r} and another fog{f', split {split!r},' if split else ''} or a folder with one "
            f"of {', '.join(FOGGY_FOLDERS)} beside one of {', '.join(CLEAR_FOLDERS)}"
        )
    return sorted(result, key=lambda pair: pair.name)


def truth_of(shot: Path, *, picture: str = "srgb.png", clear: str = "clear") -> Path:
    """The picture of a shot's view without fog, as `find` pairs it.

    Args:
        shot: folder of a foggy or clear shot in a set or bake, as out/sky/mor150; or a picture, which is the truth
            itself.
        picture: which output of a set or bake is compared.
        clear: the fog that counts as none.

    Raises:
        ParameterError: no such shot, or no clear one of its view.
    """
    if shot.is_file():
        return shot
    here = shot.resolve()
    for source in (here, *here.parents):
        if not (index.is_set(source) or (source / "bake.json").is_file()):
            continue
        pairs = _of_set(source, picture, clear, "") if index.is_set(source) else _of_bake(source, picture, clear)
        for pair in pairs:
            if here in (pair.foggy.parent.resolve(), pair.clear.parent.resolve()):
                return pair.clear
    what = "no shot of a set or bake" if shot.is_dir() else "no such folder or picture"
    raise ParameterError(
        f"{shot}: {what} with {picture} and the same view under {clear!r}; it takes a folder as out/<lighting>/<fog>, "
        "or a picture to compare with"
    )


def _of_set(source: Path, picture: str, clear: str, split: str) -> Iterator[Pair]:
    views: dict[tuple[int, str, str, str], Path] = {}
    foggy = []
    for entry in index.pictures(source):
        if (split and entry.split != split) or picture not in entry.files:
            continue
        view = (entry.scene, entry.lighting, entry.camera, entry.pipeline)
        if entry.fog == clear:
            views[view] = entry.files[picture]
        else:
            foggy.append((view, entry))
    for view, entry in foggy:
        if view in views:
            words = [
                f"{entry.scene:06d}",
                entry.lighting,
                entry.camera.strip("/").replace("/", "_"),
                entry.pipeline,
                entry.fog,
            ]
            yield Pair(
                "_".join(word for word in words if word),
                f"{entry.scene:06d}",
                entry.fog,
                views[view],
                entry.files[picture],
                dict(entry.files),
            )


def _bakes_in(source: Path, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Path]]:
    """Bakes of one camera and moment in what a bake left, with the folders on the way to each."""
    if (source / "bake.json").is_file():
        yield words, source
    for manifest, views in ((source / RIG, "cameras"), (source / SEQUENCE, "frames")):
        if manifest.is_file():
            for row in _rows(manifest, views, ("folder",)):
                yield from _bakes_in(source / row["folder"], (*words, row["folder"]))


def _rows(manifest: Path, table: str, keys: Sequence[str]) -> list[dict[str, Any]]:
    """The rows of a table of a manifest.

    Raises:
        ParameterError: it is damaged, or a row lacks a key.
    """
    try:
        rows = json.loads(manifest.read_text(encoding="utf-8"))[table]
        return [{key: row[key] for key in keys} for row in rows]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ParameterError(f"{manifest}: is no manifest of a bake ({error})") from error


def _of_bake(source: Path, picture: str, clear: str, words: tuple[str, ...] = ()) -> Iterator[Pair]:
    """Pairs of one bake; cameras and frames are of one scene, as fogs are."""
    shots = _rows(source / "bake.json", "shots", ("lighting", "fog", "folder", "files"))
    of_clear = {row["lighting"]: source / row["folder"] / picture for row in shots if row["fog"] == clear}
    for row in shots:
        lighting, fog, folder = row["lighting"], row["fog"], source / row["folder"]
        if fog != clear and picture in row["files"] and lighting in of_clear and of_clear[lighting].is_file():
            files = {name: folder / name for name in sorted(row["files"])}
            yield Pair("_".join((*words, lighting, fog)), lighting, fog, of_clear[lighting], folder / picture, files)


def _of_folders(source: Path) -> Iterator[Pair]:
    foggy, clear = (
        next((source / name for name in names if (source / name).is_dir()), None)
        for names in (FOGGY_FOLDERS, CLEAR_FOLDERS)
    )
    if foggy is None or clear is None:
        return
    by_scene = {scene_of(path): path for path in sorted(clear.iterdir()) if path.suffix.lower() in SUFFIXES}
    for path in sorted(foggy.iterdir()):
        scene = scene_of(path)
        if path.suffix.lower() in SUFFIXES and scene in by_scene:
            yield Pair(path.stem, scene, "", by_scene[scene], path, {path.name: path})


def scene_of(path: Path) -> str:
    """What foggy and clear pictures of one view have in common.

    RESIDE: 0001_0.85_0.04.png and 0001.png; O-HAZE: 01_outdoor_hazy.jpg and 01_outdoor_GT.jpg.

    >>> scene_of(Path("0001_0.85_0.04.png")), scene_of(Path("01_outdoor_hazy.jpg")), scene_of(Path("12_GT.png"))
    ('0001', '01_outdoor', '12')
    """
    stem = re.sub(r"[_-](hazy|haze|foggy|gt|clear)$", "", path.stem, flags=re.IGNORECASE)
    return re.sub(r"(_\d+(\.\d+)?)+$", "", stem)

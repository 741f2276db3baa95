"""RESIDE's indoor set (ITS): clear pictures, hazy ones named `{id}_{k}_{beta}`, and their transmittance.

An id is a clear picture: a scene, lighting, camera and pipeline.  k counts its fogs from 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture
from synfog_usd.dataset.exports.record import Boxed


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `<split>/{clear,hazy,trans}/*` and `<split>/ids.csv`."""
    number: dict[tuple[object, ...], int] = {}
    fogs: dict[tuple[object, ...], int] = {}
    rows: dict[str, list[dict[str, object]]] = {}
    hazy: set[int] = set()
    clear: set[int] = set()
    for picture in pictures():
        key = picture.scene, picture.lighting, picture.camera, picture.pipeline
        scene_number = number.setdefault(key, len(number) + 1)
        suffix = picture.screen.suffix
        if picture.clear:
            folder.place(picture.screen, f"{picture.split}/clear/{scene_number}{suffix}")
            clear.add(scene_number)
        else:
            count = fogs[key] = fogs.get(key, 0) + 1
            folder.place(picture.screen, f"{picture.split}/hazy/{scene_number}_{count}_{picture.beta:.5f}{suffix}")
            codes = np.rint(255.0 * np.clip(picture.transmittance(), 0.0, 1.0)).astype(np.uint8)
            folder.png(f"{picture.split}/trans/{scene_number}_{count}.png", codes)
            hazy.add(scene_number)
        rows.setdefault(picture.split, []).append(
            {"id": scene_number, "file": picture.name, "beta": f"{picture.beta:.6g}"}
        )
    for split, entries in rows.items():
        folder.table(f"{split}/ids.csv", entries)
    notes = [
        "beta is the fog's extinction -ln(0.05) / MOR [1/m]; transmittance is along the ray, uint8 / 255.  There is no "
        "airlight A: it differs from pixel to pixel (layers.exr of the set has it).",
    ]
    if lonely := len(hazy - clear):
        notes.append(f"{lonely} ids have hazy pictures and no clear one: the set has no clear air there.")
    return notes

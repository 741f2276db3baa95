"""Foggy Cityscapes: the same clear picture in several fogs, named by their extinction beta [1/m], and transmittance.

The transmittance is 8 bit, 255 being 1, along the ray from the camera.  A scene without a picture in clear air has its
foggy pictures and labels all the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from synfog_usd.dataset.exports.cityscapes import TOLD, Names, write_ground_truth
from synfog_usd.dataset.exports.folder import ExportFolder
from synfog_usd.dataset.exports.frames import LabelledPicture, plain
from synfog_usd.dataset.exports.record import Boxed


def write(pictures: Callable[[], Iterable[LabelledPicture]], folder: ExportFolder, chosen: Boxed) -> list[str]:
    """Write `leftImg8bit`, `leftImg8bit_foggy`, `leftImg8bit_transmittance`, `gtFine`, `depth` and `camera`."""
    names = Names()
    labelled: set[str] = set()
    for picture in pictures():
        city = f"{plain(picture.source)}-{plain(picture.lighting)}".replace("_", "")
        stem = names.stem(picture, city)
        suffix = picture.screen.suffix
        if stem not in labelled:
            write_ground_truth(folder, stem, picture.labels)
            labelled.add(stem)
        if picture.clear:
            folder.place(picture.screen, f"leftImg8bit/{stem}_leftImg8bit{suffix}")
            continue
        beta = f"{picture.beta:.4g}"
        folder.place(picture.screen, f"leftImg8bit_foggy/{stem}_leftImg8bit_foggy_beta_{beta}{suffix}")
        codes = np.rint(255.0 * np.clip(picture.transmittance(), 0.0, 1.0)).astype(np.uint8)
        folder.png(f"leftImg8bit_transmittance/{stem}_leftImg8bit_transmittance_beta_{beta}.png", codes)
    return [
        "beta is the fog's extinction -ln(0.05) / MOR [1/m]: 0.01997 is MOR 150 m.  Transmittance is along the ray, "
        "uint8 / 255.",
        *TOLD,
    ]

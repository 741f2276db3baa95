"""Where the files of a set lie: at most a thousand entries a folder.

    OUT/set.json                          what the set is, and what it was made by
    OUT/index/part-00000.parquet          a row for each picture; a part for a thousand scenes
    OUT/scenes/000/000017/sky/            one scene in one lighting: a folder as `bake` leaves it
        bake.json  labels.exr  labels.json  contact.png  mor600/radiance.exr ...
        mor600/<pipeline>/srgb.png    what further cameras made of the same radiance
        unit.json                         its scene and lighting, with the hash of every file; written last
    OUT/.run/                             how the set was made: journal, lock, errors; no part of it

With a camera of a rig the folder is called `sky-Left`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

SET = "set.json"
UNIT = "unit.json"
INDEX = "index"
RUN = ".run"
A_FOLDER = 1000
"""Scenes in one folder, and in one part of the index."""


def unit_folder(number: int, lighting: str, camera: str = "") -> str:
    """Folder of one scene in one lighting, seen by one camera, relative to the set's; '' is the stage's own camera."""
    view = f"{lighting}-{camera.rsplit('/', 1)[-1]}" if camera else lighting
    return f"scenes/{number // A_FOLDER:03}/{number:06}/{view}"


@dataclass(frozen=True)
class Unit:
    """One scene in one lighting through one camera: what is made at a time.

    Attributes:
        number: of the scene.
        lighting: name; camera: prim path, or '' for the stage's own.
    """

    number: int
    lighting: str
    camera: str = ""

    @property
    def folder(self) -> str:
        """Relative to the set's."""
        return unit_folder(self.number, self.lighting, self.camera)

    @property
    def name(self) -> str:
        """As errors and journals have it, '000017/sky'."""
        return "/".join(self.folder.split("/")[-2:])


def part_path(out: Path, part: int) -> Path:
    """File of the index that lists scenes `part` * A_FOLDER and the A_FOLDER - 1 after it."""
    return out / INDEX / f"part-{part:05}.parquet"

"""Several cameras of a stage in one run: a bake in a folder for each, on one translation and one load of the scene.

What the cameras are to each other stands in `rig.json`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from synfog_usd.base import files, system
from synfog_usd.base.errors import OutputError, ParameterError
from synfog_usd.base.progress import Progress, named, silent, within
from synfog_usd.dataset.bake import Baked, bake
from synfog_usd.dataset.ledger import MANIFEST
from synfog_usd.dataset.plan import BakePlan, shots
from synfog_usd.dataset.session import Reading, begin

RIG = "rig.json"


def bake_cameras(
    plan: BakePlan,
    names: Sequence[str],
    *,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
    reading: Reading = contextlib.nullcontext,
) -> tuple[dict[str, Any] | None, Baked]:
    """Bake cameras of a stage; goes on where it stopped, as each bake does.

    Args:
        plan: of all of them; its `camera` and `rig` are not used.
        names: of the cameras: paths, names, or a prim above them.
        progress, log, reading: as `bake` takes them.

    Returns:
        what `rig.json` holds, and what the first camera's bake left behind; for one camera None, and its bake in
        `plan.out` itself.

    Raises:
        SynfogError: with place and fix; finished shots stay.
    """
    from synfog_usd import stage as usd

    session = begin(replace(plan, camera=None, rig=()), names, reading)
    cameras = [str(camera) for camera in session.cameras]
    if len(cameras) == 1:
        single = replace(plan, camera=cameras[0])
        return None, bake(single, progress=progress, log=log, reading=reading, session=session)
    folders = folders_of(cameras)
    if (plan.out / MANIFEST).is_file():
        raise OutputError(
            f"{plan.out / MANIFEST}: a bake of one camera lies here, and {len(cameras)} cameras need a folder of their "
            f"own; choose another with --out"
        )
    with reading():
        lightings = dict.fromkeys(shot.lighting for shot in shots(plan, usd.variants(session.stage)))
    goes = [(lighting, camera) for lighting in lightings for camera in cameras]
    first: Baked | None = None
    with system.only_writer(plan.out):
        for number, (lighting, camera) in enumerate(goes):
            folder = folders[camera]
            part = named(within(progress, number / len(goes), (number + 1) / len(goes)), folder)
            baked = bake(
                replace(plan, camera=camera, out=plan.out / folder),
                progress=part,
                log=lambda text, folder=folder: log(f"{folder}: {text}"),  # type: ignore[misc]
                reading=reading,
                session=session,
                lighting=lighting,
            )
            first = baked if camera == cameras[0] else first
        assert first is not None
        manifest = write_rig(plan, {camera: folders[camera] for camera in cameras})
    progress("done", 1.0)
    return manifest, first


def write_rig(plan: BakePlan, folders: Mapping[str, str]) -> dict[str, Any]:
    """Write `rig.json`, and give what it says.

    Args:
        plan: of all cameras.
        folders: path of each camera -> its folder.
    """
    rows = [{"camera": camera, "folder": folder} for camera, folder in folders.items()]
    manifest = {
        "schema": "synfog-usd/rig",
        "version": 1,
        "stage": plan.stage.name,
        "meter": plan.exposes.meter,
        "cameras": rows,
    }
    files.write_json(plan.out / RIG, manifest)
    return manifest


def apart(plan: BakePlan, names: Sequence[str], *, reading: Reading = contextlib.nullcontext) -> list[BakePlan]:
    """A plan for each camera of these names, for bakes that share nothing but how they are exposed."""
    cameras = [str(camera) for camera in begin(replace(plan, camera=None, rig=()), names, reading).cameras]
    if len(cameras) == 1:
        return [replace(plan, camera=cameras[0])]
    folders = folders_of(cameras)
    return [replace(plan, camera=path, rig=tuple(cameras), out=plan.out / folders[path]) for path in cameras]


def folders_of(cameras: Sequence[str]) -> Mapping[str, str]:
    """Folder of each camera: its name, or its path where two have one name.

    Raises:
        ParameterError: two that would lie in one folder.

    >>> folders_of(["/Rig/Left", "/Rig/Right"])["/Rig/Right"], folders_of(["/A/Eye", "/B/Eye"])["/B/Eye"]
    ('Right', 'B_Eye')
    """
    short = [camera.rpartition("/")[2] for camera in cameras]
    alone = len({name.casefold() for name in short}) == len(short)
    folders = {
        camera: name if alone else camera.strip("/").replace("/", "_")
        for camera, name in zip(cameras, short, strict=True)
    }
    if len({folder.casefold() for folder in folders.values()}) < len(folders):
        raise ParameterError(f"--camera {','.join(cameras)}: two would lie in one folder; bake them apart")
    return folders

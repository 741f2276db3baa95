"""What a clip will take: hours and gigabytes, before its first frame by usual figures, and after the second by that.

Takes a plan and how large its pictures are; tells it, and refuses what its disk has no room for.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from synfog_usd.base import system
from synfog_usd.base.errors import OutputError
from synfog_usd.base.progress import duration
from synfog_usd.dataset.plan import BakePlan, shots

if TYPE_CHECKING:
    from synfog_usd.dataset.session import Session

FRAME_S, SAMPLE_S = (5.0, 15.0), (1e-5, 5e-5)
"""Processor seconds of a frame before it is sampled, and of a sample of a pixel: by day in clear air, and of a crossing
at dusk in fog."""

TARGETED = (4, 24)
"""Samples of a picture that ends where its error is small enough."""

FRAME_B, SHOT_B = 47, 93
"""Bytes of a pixel: of labels and flow, and of all files of a shot."""

ROOM = 0.5
"""Part of the usual gigabytes that a disk must have for a clip to begin."""


def tell_before(plan: BakePlan, session: Session, count: int, log: Callable[[str], None]) -> None:
    """Tell what `count` frames take, about; the stage is read, and nothing is rendered.

    Raises:
        OutputError: there is no room for them.
    """
    from synfog_usd import stage as usd

    every = shots(plan, usd.variants(session.stage))
    camera = session.scenes(plan.camera).of(every[0]).camera
    pixels, quality, samples = camera.width_px * camera.height_px, plan.sampling.promise, plan.sampling.samples
    assert samples is not None  # a plan that was made is whole
    targeted = plan.sampling.target_error is not None or quality.mottle is not None or quality.sensor
    low, high = (
        count * (frame_s + len(every) * pixels * sample_s * (min(usual, samples) if targeted else samples))
        for frame_s, sample_s, usual in zip(FRAME_S, SAMPLE_S, TARGETED, strict=True)
    )
    size = count * pixels * (FRAME_B + len(every) * SHOT_B)
    frames, cores = f"{count} frame{'s take' if count > 1 else ' takes'}", system.cores()
    log(
        f"{plan.out}: {frames} {duration(low / cores)} to {duration(high / cores)} on {cores} cores, and about "
        f"{size / 1e9:.2g} GB"
    )
    _check_room(plan.out, count, size, ROOM * size)


def tell_by(frame: Path, seconds: float, count: int, log: Callable[[str], None]) -> None:
    """Tell what the frames after the second of `count` take, by the seconds and the folder of that.

    Raises:
        OutputError: there is no room for them.
    """
    size = sum(path.stat().st_size for path in frame.rglob("*") if path.is_file())
    frames_to_come = count - 2
    if frames_to_come:
        log(
            f"{frame.parent}: {count} frames, about {seconds:.2g} s and {size / 1e6:.2g} MB each: "
            f"{duration(frames_to_come * seconds)} and {frames_to_come * size / 1e9:.2g} GB more"
        )
    _check_room(frame.parent, count, frames_to_come * size, frames_to_come * size)


def _check_room(out: Path, count: int, size: float, least: float) -> None:
    free = shutil.disk_usage(next(folder for folder in (out, *out.absolute().parents) if folder.is_dir())).free
    if least > free:
        raise OutputError(
            f"{out}: {count} frames take about {size / 1e9:.2g} GB more, and {free / 1e9:.2g} GB are free; choose "
            f"another output folder, fewer --frames or a smaller --resolution"
        )

"""A bake as it is asked for: of one view, of several cameras, of a sequence, or of both.

The command line and Python begin here.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from synfog_usd.base import numbers
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.values import names, number
from synfog_usd.dataset.asked import plan_of
from synfog_usd.dataset.plan import BakePlan, frame_codes

if TYPE_CHECKING:
    from synfog_usd.dataset.asked import FogLike
    from synfog_usd.dataset.bake import Baked

ADAPTATION_S = 0.3
LOG = logging.getLogger("synfog_usd")
"""Where Python's functions tell what the command line prints on the way."""


@dataclass(frozen=True)
class BakeJob:
    """What is to be baked.

    Attributes:
        plan: of all cameras and frames.
        cameras: paths or names; None for the stage's own.
        codes: time codes of a sequence, or None.
        adaptation_s: time constant of its automatic exposure [s].
    """

    plan: BakePlan
    cameras: tuple[str, ...] | None = None
    codes: tuple[float, ...] | None = None
    adaptation_s: float = ADAPTATION_S


def job_of(
    stage: object,
    out: object = None,
    *,
    camera: object = None,
    frames: str | Iterable[float] | None = None,
    adaptation: object = None,
    **asked: Any,
) -> BakeJob:
    """A job from options of `synfog-usd bake`; see `plan_of`.

    Raises:
        ParameterError: a value that makes no sense; nothing is opened or written before.
    """
    codes = None
    if frames is not None:
        codes = frame_codes(frames) if isinstance(frames, str) else tuple(number(code, "--frames") for code in frames)
        numbers.check_frames(codes)
        if asked.get("frame") is not None:
            raise ParameterError("frame and frames: either one time code or several; leave one out")
        if isinstance(frames, str) and ":" not in frames:
            (asked["frame"],), codes = codes, None
    plan = plan_of(stage, out, **asked)
    seconds = ADAPTATION_S if adaptation is None else number(adaptation, "--adaptation")
    if not 0.0 <= seconds < math.inf:
        raise ParameterError(f"--adaptation {seconds:g}: it takes seconds, 0 and more")
    return BakeJob(plan, None if camera is None else names(camera, "--camera"), codes, seconds)


def run(
    job: BakeJob,
    *,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
    reading: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext,
) -> Baked:
    """Make what of a job is not there yet; arguments as `bake.bake` takes them.

    Returns:
        of one view its bake; of several cameras the first one's, with what `rig.json` says as manifest; of a sequence
        the first frame's, with what `sequence.json` says, in a list where there are several cameras.

    Raises:
        SynfogError: with place and fix; what was finished stays.
    """
    from synfog_usd.dataset import bake as one
    from synfog_usd.dataset.rig import apart, bake_cameras, write_rig
    from synfog_usd.dataset.sequence import bake_sequence

    more: dict[str, Any] = {"progress": progress, "log": log, "reading": reading}
    if job.codes is not None:
        plans = [job.plan] if job.cameras is None else apart(job.plan, job.cameras, reading=reading)
        results = [bake_sequence(plan, job.codes, adaptation_s=job.adaptation_s, **more) for plan in plans]
        if len(plans) > 1:
            write_rig(job.plan, {str(plan.camera): plan.out.name for plan in plans})
        sequences = [sequence for sequence, _ in results]
        return replace(results[0][1], manifest=sequences[0] if len(sequences) == 1 else sequences)
    if job.cameras is None:
        return one.bake(job.plan, **more)
    rig, baked = bake_cameras(job.plan, job.cameras, **more)
    return baked if rig is None else replace(baked, manifest=rig)


def bake(
    stage: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    lighting: str | Sequence[str] | None = None,
    fog: FogLike | Sequence[FogLike] | None = None,
    camera: str | Sequence[str] | None = None,
    pipeline: str | os.PathLike[str] | None = None,
    quality: str = "standard",
    seed: int = 0,
    progress: Progress = silent,
    **options: Any,
) -> Baked:
    """Bake a stage: every lighting in every fog, to radiance, RAW, sRGB and labels in a folder.

    The same job as `synfog-usd bake`, to the same bytes: it goes on where it was stopped.

    Args:
        stage: USD file, or the name of a stage that ships, as crossroads.
        out: folder for everything; out/<name of the stage> if left out.
        lighting: names; all that the stage has if left out.
        fog: variants of the stage, 'clear', visibilities [m] or `Fog`s, one or several; all that the stage has if left
            out.
        camera: prim paths or names, or a prim above them; of several each has a folder.
        pipeline: the simulated camera: a name of `cameras`, or a YAML file; the phone if left out.
        quality: 'draft', 'standard', 'sensor' or 'reference'.
        seed: the same gives the same bytes.
        progress: called with what is done and the fraction of all that is done.
        options: all others of `synfog-usd bake`, with _ for -: resolution=(640, 360), samples=16, ... And these, which
            Python has alone: `model` ('path', 'single', 'volpath', 'volpathmis'); `strict` (stop at a warning);
            `same_noise` (all fogs of a lighting have the temporal noise of its clear frame); `meter` ('each' camera of
            several by itself); `adaptation` (of the exposure of `frames` [s], 0.3); `shutter` (time for which it is
            open [s]); `lights` (how intensities are meant: 'usd', 'blender', 'rtx-legacy', 'metric');
            `meters_per_unit` and `up` (instead of the stage's own).

    Returns:
        `manifest` (what bake.json says, or rig.json, or sequence.json), `notes` of the translation, `kept` (shots that
        were there) and `seconds`.

    Raises:
        SynfogError: with place and fix; what was finished stays.
    """
    from synfog_usd import stage as usd

    named: dict[str, Any] = {"lighting": lighting, "fog": fog, "camera": camera, "pipeline": pipeline}
    job = job_of(stage, out, **named, quality=quality, seed=seed, **options)
    usd.reread()
    return run(job, progress=progress, log=LOG.info, reading=reading_here)


@contextlib.contextmanager
def reading_here() -> Iterator[None]:
    """While a stage is read in a user's own process: numbers that overflow in numpy are no warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield

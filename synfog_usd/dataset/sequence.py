"""Frames of a stage one after the other, as a video camera takes them.

Each frame is a bake of its own in a folder of its own, with new noise; the sensor's fixed patterns stay, and the
automatic exposure follows what it meters with a time constant.  Then the frames are gathered as clips: RAW under
CinemaDNG's names, and a video to look at.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from synfog_usd.base import files, system
from synfog_usd.base.errors import OutputError, StageError
from synfog_usd.base.progress import Progress, named, silent, within
from synfog_usd.base.seeds import frame_seed
from synfog_usd.dataset import flow, price
from synfog_usd.dataset.bake import Baked, bake
from synfog_usd.dataset.ledger import EARLIER
from synfog_usd.dataset.plan import BakePlan, ClipFrame, shots
from synfog_usd.dataset.session import Reading, Session, begin, one_camera

if TYPE_CHECKING:
    from synfog_usd.stage import Stage

SEQUENCE = "sequence.json"
CAMERA = "camera.json"
CLIPS = "clips"

SHOWN = (".png", ".jpg")
"""Outputs that a video is made of."""


def bake_sequence(
    plan: BakePlan,
    codes: Sequence[float],
    *,
    adaptation_s: float = 0.0,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
    reading: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext,
) -> tuple[dict[str, Any], Baked]:
    """Bake frames of a stage and gather them; goes on where it stopped, as each bake does.

    Args:
        plan: of the frames; its `frame` is not used, and its `seed` gives each frame one.
        codes: time codes of the frames, at even steps.
        adaptation_s: time constant of the automatic exposure [s]; 0 follows without delay.
        progress, log, reading: as `bake` takes them.

    Returns:
        what `sequence.json` holds, and what the first frame left behind.

    Raises:
        SynfogError: with place and fix; finished frames stay.
    """
    session = begin(replace(plan, frame=codes[0]), None if plan.camera is None else [plan.camera], reading)
    plan = replace(plan, camera=one_camera(session))
    with reading():
        rate, cuts, warnings, lightings = _read(session.stage, plan, codes)
    for text in warnings:
        log(f"warning: {plan.stage}: {text}")
    per_s = rate / abs(codes[1] - codes[0]) if len(codes) > 1 else rate
    once = _FrameLog(log, tuple(f"{name}: " for name in (str(plan.stage), *lightings)))
    with system.only_writer(plan.out):
        files.remove_leftovers(plan.out)
        frames = _Frames(session, plan, codes, cuts, ClipFrame(0, per_s, adaptation_s, {}, {}, {}))
        frames.make(progress, once, reading)
        manifest: dict[str, Any] = {
            "schema": "synfog-usd/sequence",
            "version": 1,
            "stage": plan.stage.name,
            "frames_per_s": per_s,
        }
        manifest |= {"sampling_seed": plan.seed, "adaptation_s": adaptation_s, "warnings": warnings}
        manifest["frames"] = frames.rows
        _write_clip(plan.out, manifest, frames.bakes[0].manifest, log)
    progress("done", 1.0)
    return manifest, frames.bakes[0]


class _Frames:
    """The frames of a clip, one after the other.

    Args:
        session: of the first frame.
        plan, codes: see `bake_sequence`.
        cuts: those of the codes at which the camera cuts.
        clip: its first frame.

    Attributes:
        rows: of `sequence.json`; bakes: of the frames that are made.
    """

    def __init__(
        self, session: Session, plan: BakePlan, codes: Sequence[float], cuts: Collection[float], clip: ClipFrame
    ) -> None:
        self.rows: list[dict[str, Any]] = []
        self.bakes: list[Baked] = []
        self._session, self._plan, self._codes, self._cuts, self._clip = session, plan, codes, cuts, clip

    def make(self, progress: Progress, log: _FrameLog, reading: Reading) -> None:
        """Make them; arguments as `bake` takes them."""
        count, every = len(self._codes), max(1, round(self._clip.adaptation_s * self._clip.per_s))
        for number, code in enumerate(self._codes):
            folder, seed = f"{number:06d}", frame_seed(self._plan.seed, code)
            log.code = code
            clip = replace(self._clip, number=number)
            if number % every == 0 or code in self._cuts or self._plan.exposes.meter_for:
                clip = replace(clip, metered={})
            frame = replace(self._plan, frame=code, seed=seed, sampling_seed=self._plan.seed, clip=clip)
            frame = replace(frame, out=self._plan.out / folder)
            self._session = self._session.at(frame)
            if not number:
                with reading():
                    price.tell_before(self._plan, self._session, count, log.log)
            part = named(within(progress, number / count, (number + 1) / count), f"frame {number + 1} of {count}")
            baked = bake(frame, progress=part, log=log, reading=reading, session=self._session)
            self.bakes.append(baked)
            if number == 1 and baked.seconds:
                price.tell_by(frame.out, sum(baked.seconds.values()), count, log.log)
            exposures = _exposures(baked.manifest)
            kept = {row["folder"]: row["rounds"] for row in baked.manifest["shots"] if "rounds" in row}
            metered = {
                row["lighting"]: row["exposure"]["metered"] for row in baked.manifest["shots"] if row["exposure"]
            }
            before = {**self._clip.before, **exposures}
            self._clip = replace(self._clip, before=before, metered=metered, kept={**self._clip.kept, **kept})
            row = {"number": number, "time_code": code, "folder": folder, "seed": seed, "exposures": exposures}
            self.rows.append(row)


def _write_clip(out: Path, manifest: dict[str, Any], first: Mapping[str, Any], log: Callable[[str], None]) -> None:
    """Write what frames have in common.

    Args:
        out: of the sequence.
        manifest: what `sequence.json` is to hold; `clips` is added to it.
        first: what `bake.json` of the first frame holds.
        log: given a line for what a user wants to know.
    """
    earlier, rows, per_s = _clip_files(out), manifest["frames"], manifest["frames_per_s"]
    manifest["clips"] = _gather(out, rows, first, per_s, log)
    for row in rows:
        _write_camera(out / row["folder"], row, per_s)
    flow.write(out, [row["folder"] for row in rows], per_s, log)
    files.write_json(out / SEQUENCE, manifest)
    if moved := _set_aside(out, earlier - _clip_files(out)):
        log(f"{out}: {moved}")


def _write_camera(folder: Path, row: Mapping[str, Any], per_s: float) -> None:
    """What labels.json tells of a frame's camera as a file of its own, with the frame's time."""
    labels = folder / "labels.json"
    if labels.is_file():
        moment = {"frame": row["number"], "time_code": row["time_code"], "time_s": round(row["number"] / per_s, 9)}
        camera = json.loads(labels.read_bytes()).get("camera", {})
        files.write_json(folder / CAMERA, {"schema": "synfog-usd/camera", "version": 1, **moment, **camera})


def _exposures(manifest: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Lighting -> exposure time [s] and ISO, where a bake has them."""
    rows = [row for row in manifest["shots"] if row["exposure"]]
    return {row["lighting"]: (row["exposure"]["exposure_s"], row["exposure"]["iso"]) for row in rows}


class _FrameLog:
    """Passes lines on with the frame's time code; lines on the stage or a lighting once for all frames.

    Args:
        log: takes a line.
        shared: how lines begin that hold for all frames.
    """

    def __init__(self, log: Callable[[str], None], shared: tuple[str, ...]) -> None:
        self.log, self.shared, self.code = log, shared, 0.0
        self.passed_on: set[str] = set()

    def __call__(self, text: str) -> None:
        if text not in self.passed_on:
            self.log(f"frame {self.code:g}: {text}")
        if text.startswith(self.shared):
            self.passed_on.add(text)


def _read(stage: Stage, plan: BakePlan, codes: Sequence[float]) -> tuple[float, list[float], list[str], list[str]]:
    """Time codes a second of the stage, those at which its camera cuts, what a user should know, and its lightings.

    Raises:
        StageError: the stage has no rate.
    """
    from synfog_usd import stage as usd
    from synfog_usd.translate import own_camera

    rate, warnings = float(stage.GetTimeCodesPerSecond()), []
    if not 0.0 < rate < math.inf:
        raise StageError(
            f"{plan.stage}: timeCodesPerSecond is {rate:g}, so that its frames have no time; give it a number above 0, "
            f"or bake one --frame"
        )
    path = plan.camera or own_camera(stage)
    cuts = usd.cuts(stage.GetPrimAtPath(path), np.asarray(codes)) if path else []
    for code in cuts:
        warnings.append(
            f"{path} cuts at the time code {code:g}: the clip, its flow and its exposure go on over it; bake the "
            f"frames before and after it by themselves"
        )
    for prim, (code, way_m) in usd.jumps(stage, np.asarray(codes)).items():
        warnings.append(
            f"{prim} jumps {way_m:.3g} m to the time code {code:g}, and its flow goes on over it; smooth its time "
            f"samples, or make it invisible at the frame before"
        )
    if len(codes) > 1 and _stands_still(stage, plan, codes):
        warnings.append(
            f"nothing changes between the time codes {codes[0]:g} and {codes[-1]:g}: the video is a still; animate it "
            f"by time samples, or bake one --frame"
        )
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    outside = [code for code in codes if not first <= code <= last]
    if outside and stage.HasAuthoredTimeCodeRange():
        warnings.append(
            f"{len(outside)} of {len(codes)} frames lie outside of the stage's time codes {first:g} to {last:g}, "
            f"beyond which nothing moves"
        )
    return rate, cuts, warnings, list(dict.fromkeys(shot.lighting for shot in shots(plan, usd.variants(stage))))


def _stands_still(stage: Stage, plan: BakePlan, codes: Sequence[float]) -> bool:
    """Whether no lighting and fog of a plan shows anything that changes."""
    from synfog_usd import stage as usd

    for shot in shots(plan, usd.variants(stage)):
        usd.select(stage, lighting=shot.lighting_variant, fog=shot.fog_variant)
        if not usd.stands_still(stage, codes):
            return False
    return True


def _clip_files(out: Path) -> set[Path]:
    """Files of clips, in the folder of a sequence, that its `sequence.json` tells of; none where there is none."""
    try:
        manifest = json.loads((out / SEQUENCE).read_bytes())
        clips = [out / clip for clip in manifest["clips"]]
        numbers = [int(row["number"]) for row in manifest["frames"]]
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    inside = (out / CLIPS).resolve()
    named = [
        path
        for clip in clips
        for path in ([clip] if clip.suffix else [clip / f"{clip.name}_{number:06d}.dng" for number in numbers])
    ]
    return {path for path in named if path.is_file() and path.resolve().is_relative_to(inside)}


def _set_aside(out: Path, paths: Collection[Path]) -> str:
    """Move clips' files of an earlier bake of other frames to where they are mixed with no others; what was moved, in
    words.

    Raises:
        OutputError: a file cannot be moved.
    """
    if not paths:
        return ""
    target = next(
        folder for number in itertools.count(1) if not (folder := out / f"{EARLIER}-{number}" / CLIPS).exists()
    )
    try:
        for path in sorted(paths):
            place = target / path.relative_to(out / CLIPS)
            place.parent.mkdir(parents=True, exist_ok=True)
            path.replace(place)
            with contextlib.suppress(OSError):  # something else lies there
                path.parent.rmdir()
                path.parent.parent.rmdir()
    except OSError as error:
        raise OutputError(f"{target}: cannot be written ({error.strerror}); choose another output folder") from error
    count = f"{len(paths)} file{'s' * (len(paths) > 1)}"
    return f"{count} of an earlier bake of other frames moved from {CLIPS} to {target}"


def _gather(
    out: Path, rows: Sequence[Mapping[str, Any]], first: Mapping[str, Any], per_s: float, log: Callable[[str], None]
) -> list[str]:
    """RAW files as links under CinemaDNG's names, NAME_000000.dng in a folder of their own, and videos: where."""
    from synfog_usd.camera.writers import video

    clips: list[str] = []
    problem = video.available()
    for shot in first["shots"]:
        folders = [out / row["folder"] / shot["folder"] for row in rows]
        clip = Path(CLIPS) / shot["folder"].replace("/", "_")
        for name in sorted(shot["files"]):
            stem, suffix = Path(name).stem, Path(name).suffix.lower()
            if suffix == ".dng":
                for row, folder in zip(rows, folders, strict=True):
                    files.place_file(folder / name, out / clip / stem / f"{stem}_{row['number']:06d}.dng")
                clips.append((clip / stem).as_posix())
            elif suffix in SHOWN and not problem:
                video.write_clip(
                    out / clip / f"{stem}.mp4", video.pictures(folder / name for folder in folders), per_s=per_s
                )
                clips.append((clip / f"{stem}.mp4").as_posix())
    if problem:
        log(f"no video is made: {problem}")
    return clips

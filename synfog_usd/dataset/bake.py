"""Bake a stage: every lighting in every fog, from USD to radiance, RAW and sRGB.

A shot is finished when `bake.json` lists it with the hashes of its files; a bake
that was stopped at any moment goes on with the shots that are not.  Nothing that
is written depends on when, where or in how many goes it was made.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from synfog_usd.base import files, system
from synfog_usd.base.errors import StageError
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.dataset import contact
from synfog_usd.dataset.ledger import Ledger, metadata_of
from synfog_usd.dataset.plan import CLEAR, BakePlan, Shot, shots
from synfog_usd.dataset.session import Reading, Session, begin, one_camera
from synfog_usd.dataset.shot import (
    MeteredView,
    RenderedShot,
    clear_scenes,
    is_metered,
    meter_view,
    sample_shot,
    settings_of,
)
from synfog_usd.dataset.shot_files import OF_SHOT, write_further, write_labels, write_shot

if TYPE_CHECKING:
    from synfog_usd.base.notes import Note

METERED, SET_UP = 0.01, 0.03
"""Parts of a shot that are done when metering begins, and when sampling does."""

ALONE_PX = 1 << 20
"""Pixels of a picture beyond which memory comes before time: it is made without the scene, which is loaded anew for the
next, and written before that is sampled.  The crossing's scene has 0.8 GB.
"""


@dataclass(frozen=True)
class Baked:
    """What a bake leaves behind and how long it took.

    Attributes:
        manifest: what `bake.json` holds; of several cameras `rig.json`, of frames `sequence.json`.
        seconds: wall time of each shot that was rendered now, by folder.
        kept: folders of shots that were finished already.
        notes: what the translation left out or made simpler.
    """

    manifest: Any
    seconds: dict[str, float] = field(default_factory=dict)
    kept: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()


class StrictError(StageError):
    """Under `strict`, the translation had something to report."""

    exit_code = 1


def bake(
    plan: BakePlan,
    *,
    progress: Progress = silent,
    log: Callable[[str], None] = lambda text: None,
    reading: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext,
    session: Session | None = None,
    lighting: str | None = None,
) -> Baked:
    """Make every shot of a plan that is not there yet.

    Args:
        plan: what to make.
        progress: called with the fraction of all shots that is done.
        log: given one line for whatever a user wants to know on the way.
        reading: makes a context that is held whenever the stage is read or translated, as limits on time and memory.
        session: that this plan shares with those of other cameras; its own if left out.
        lighting: the only one whose shots are made now; what is of all shots is written once all are there.

    Raises:
        SynfogError: with place and fix; what was finished stays.
    """
    from synfog_usd import stage as usd
    from synfog_usd.render import backend

    if session is None:
        session = begin(plan, None if plan.camera is None else [plan.camera], reading)
        plan = replace(plan, camera=one_camera(session))
    whole = replace(plan, rig=session.plan.rig)
    scenes = session.scenes(plan.camera)
    with reading():
        every = shots(whole, usd.variants(session.stage))
        plan = replace(session.of(plan.camera), out=plan.out)
        todo = tuple(shot for shot in every if lighting in (None, shot.lighting))
        scenes.survey(every if plan.strict else [shot for shot in todo if shot.lighting == todo[0].lighting])
    if plan.strict:
        _refuse_warnings(plan, scenes.notes(every))
    if all(shot.fog_override is None for shot in todo) and not scenes.foggy and plan.fog != (CLEAR,):
        log(_no_fog(plan, usd.variants(session.stage).get("fog", ())))
    chosen = backend.start(plan.sampling.variant)  # type: ignore[arg-type]
    metadata = metadata_of(whole, session.stage_hash, session.graph.hash, chosen.variant)
    with system.only_writer(plan.out):
        files.remove_leftovers(plan.out)
        ledger = Ledger(plan.out, metadata, scenes.notes(todo))
        ledger.light = scenes.light
        unfinished = [shot for shot in todo if not ledger.done(shot)]
        finished = tuple(shot.folder for shot in todo if shot not in unfinished)
        if finished:
            log(f"{len(finished)} of {len(todo)} shots are finished already: {', '.join(finished)}")
        work = _Work(plan, session, ledger, every, unfinished, progress, log, reading)
        work.do()
        with reading():
            scenes.survey(todo)
        notes = ledger.notes = scenes.notes(todo)
        if all(ledger.done(shot) for shot in every):
            notes = ledger.notes = scenes.notes(every)
            missing = [f"{note.path}: {note.text}" for note in notes if usd.MISSING in note.text]
            ledger.finish(every, contact.write(plan.out, every, ledger.rows, missing=missing))
    progress("done", 1.0)
    return Baked(ledger.manifest(todo), work.seconds, finished, notes)


def _refuse_warnings(plan: BakePlan, notes: Sequence[Note]) -> None:
    """Under `strict`, the end.

    Raises:
        StrictError: the translation warned of something.
    """
    if lines := [f"{note.path or plan.stage}: {note.text}" for note in notes if note.severity == "warning"]:
        raise StrictError("\n".join(lines))


def _no_fog(plan: BakePlan, variants: Sequence[str]) -> str:
    free = next(name for name in ("mor150", "mor200", "mor250") if name not in variants)
    return (
        f"{plan.stage}: no fog in it, and none was asked for: baking clear air. --fog {free} adds fog; a closed prim "
        f"with SynFogMediumAPI says where it is (see docs/artists.md)."
    )


class _Work:
    """The shots of a bake that are to be made, one after the other.

    Args:
        plan: what to make.
        every: all shots; the first one's world is what labels are of.
        unfinished: those to make.
        ledger, session, progress, log, reading: see `bake`.

    Attributes:
        seconds: wall time of each shot that was made, by folder.
    """

    def __init__(
        self,
        plan: BakePlan,
        session: Session,
        ledger: Ledger,
        every: Sequence[Shot],
        unfinished: Sequence[Shot],
        progress: Progress,
        log: Callable[[str], None],
        reading: Reading,
    ) -> None:
        from synfog_usd.dataset.drops import FallTime

        self.seconds: dict[str, float] = {}
        self._plan, self._session, self._ledger = plan, session, ledger
        self._every, self._unfinished = every, unfinished
        self._progress, self._log, self._reading = progress, log, reading
        self._scenes, self._specimen = session.scenes(plan.camera), session.specimen(plan.camera)
        self._metered = is_metered(session.graph, plan)
        self._views: dict[str, MeteredView] = {}  # by lighting
        self._lit = set[str]()  # lightings whose brightness was logged
        with reading():
            self._first = self._scenes.of(every[0])
        self._alone = self._first.camera.width_px * self._first.camera.height_px > ALONE_PX
        self._settings = settings_of(plan, None, 1.0)
        self._moment = FallTime.of(session)

    def do(self) -> None:
        """Make them."""
        from synfog_usd.camera.exposure import moments_of
        from synfog_usd.render.shot import check_memory

        graph = self._session.graph
        ledger, plan = self._ledger, self._plan
        for shot in self._unfinished:
            if shot in self._scenes.known:
                check_memory(self._scenes.known[shot], self._settings)
        written = {*OF_SHOT, *(f"{name}.exr" for name in moments_of(graph)), *graph.outputs}
        if moved := ledger.set_aside(self._every, written):
            self._log(f"{plan.out}: {moved}")
        if self._alone or self._every[0] not in self._unfinished:
            self._label(-1)
        with _Background() as behind:  # a shot is denoised, developed and written while the next is sampled
            for index, shot in enumerate(self._unfinished):
                self._make(index, shot, behind)
                if shot == self._every[0]:  # the scene is there, whole
                    self._label(index)

    def _make(self, index: int, shot: Shot, behind: _Background) -> None:
        from synfog_usd.camera.exposure import moments_of
        from synfog_usd.render.shot import sampling_share

        began = time.perf_counter()

        def step(what: str, fraction: float) -> None:
            self._progress(f"{shot.folder}: {what}", self._done(index, fraction))

        step("translating", 0.0)
        with self._reading():
            scene = self._scenes.of(shot)
        if shot.lighting not in self._lit:
            self._lit.add(shot.lighting)
            self._log(f"{shot.lighting}: {self._scenes.light[shot.lighting]}")
        if self._metered and shot.lighting not in self._views:
            step("metering", METERED)
            self._look(shot, behind)
        sampled = SET_UP + (1.0 - SET_UP) * (sampling_share(self._settings) if self._alone else 1.0)
        step("rendering", SET_UP)
        if self._alone:
            behind.wait()
        picture = sample_shot(
            shot,
            scene,
            self._session.renderer,
            self._views.get(shot.lighting),
            self._plan,
            self._scenes.sensor,
            moments_of(self._session.graph),
            within(step, SET_UP, sampled),
        )
        finish = functools.partial(self._finish, shot, began)
        if self._alone:
            self._session.renderer.free()
            result = picture(within(step, sampled, 1.0))
            behind.do(lambda: finish(result))
        else:
            behind.do(lambda: finish(picture(silent)))

    def _look(self, shot: Shot, behind: _Background) -> None:
        """Meter a lighting."""
        with self._reading():
            clear = clear_scenes(shot, self._session, self._plan.camera)
        view = meter_view(shot.lighting, clear, self._session, self._plan, behind.wait)
        self._views[shot.lighting] = view
        mean = f"{view.mean_cd_m2:.3g} cd/m2 in clear air"
        exposed = f", exposed {view.exposure}" if view.exposure else ""
        if self._plan.clip is None or not self._plan.clip.number:  # sequence.json has the exposures of all frames
            self._log(f"{shot.lighting}: this view has {mean}{exposed}")

    def _label(self, index: int) -> None:
        """After the shot of this number, and before the next; -1 before all."""
        from synfog_usd.render.film import aovs

        done = self._done(index, 1.0)
        if self._plan.sampling.draft or self._ledger.labels_done():
            return

        def report(what: str, part: float) -> None:
            self._progress(f"labels: {what} {part:.0%}", done)

        self._progress("labels", done)
        first, pinhole = self._first, self._scenes.sensor
        loaded = self._session.renderer.within(replace(first, fog=()))
        pierced, view = aovs.pierced(loaded, progress=report), self._views.get(self._every[0].lighting)
        visible = view.visible if view and view.world is first.world else aovs.measure(loaded, progress=report)
        self._ledger.add_labels(write_labels(visible, first, self._plan, self._session.graph, pinhole, pierced, loaded))

    def _finish(self, shot: Shot, began: float, result: RenderedShot) -> None:
        from synfog_usd.dataset.drop_light import falling_in
        from synfog_usd.dataset.drops import with_drops

        further = write_further(result, self._plan, self._specimen, self._moment) if falling_in(result.scene) else {}
        result = with_drops(result, self._session.graph, self._moment)
        row = write_shot(result, self._session.graph, self._plan, self._specimen)
        row["files"] |= further
        self._ledger.add(shot, row)
        self.seconds[shot.folder] = time.perf_counter() - began
        for line in row["warnings"]:
            self._log(f"{shot.folder}: {line}")

    def _done(self, index: int, fraction: float) -> float:
        """Part of the shots that is done."""
        return (index + fraction) / max(len(self._unfinished), 1)


class _Background:
    """One task at a time, in a thread of its own; what it raises is raised at the next."""

    def __init__(self) -> None:
        self._thread = concurrent.futures.ThreadPoolExecutor(max_workers=1)
        self._task: concurrent.futures.Future[None] | None = None

    def __enter__(self) -> _Background:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._thread.shutdown()
        if kind is None:
            self.wait()

    def do(self, task: Callable[[], None]) -> None:
        """Begin a task once the one before has ended."""
        self.wait()
        self._task = self._thread.submit(task)

    def wait(self) -> None:
        """Until nothing is done any more."""
        task, self._task = self._task, None
        if task is not None:
            task.result()

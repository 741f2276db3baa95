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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from synfog_usd.base import files, system
from synfog_usd.base.errors import StageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.base.seeds import seed32
from synfog_usd.dataset import contact, labels, lanes, objects, stereo, visibility
from synfog_usd.dataset.ledger import Ledger, metadata_of
from synfog_usd.dataset.plan import CLEAR, TOGETHER, BakePlan, Shot, noise_seed, shots
from synfog_usd.dataset.scenes import cleared, pinhole_of, size_of
from synfog_usd.dataset.session import METER_WIDTH_PX, Reading, Renderer, Session, begin, one_camera

if TYPE_CHECKING:
    import numpy as np

    from synfog_usd.base.notes import Note
    from synfog_usd.camera.distortion import Pinhole
    from synfog_usd.camera.graph import NodeGraph
    from synfog_usd.render.film.aovs import Aovs
    from synfog_usd.render.load import MitsubaScene
    from synfog_usd.render.picture import Rendered
    from synfog_usd.render.shot import Settings
    from synfog_usd.scene import SceneDict
    from synfog_usd.scene.transmittance import PartBoxes

OF_SHOT = ("radiance.exr", "layers.exr", "instances.json")
"""Files of a shot beside what its graph makes."""

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
    if all(shot.asked is None for shot in todo) and not scenes.foggy and plan.fog != (CLEAR,):
        log(_no_fog(plan, usd.variants(session.stage).get("fog", ())))
    chosen = backend.start(plan.variant)  # type: ignore[arg-type]
    metadata = metadata_of(whole, usd.stage_hash(session.stage), session.graph.hash, chosen.variant)
    with system.only_writer(plan.out):
        files.remove_leftovers(plan.out)
        ledger = Ledger(plan.out, metadata, scenes.notes(todo))
        ledger.light = scenes.light
        unfinished = [shot for shot in todo if not ledger.done(shot)]
        finished = tuple(shot.folder for shot in todo if shot not in unfinished)
        if finished:
            log(f"{len(finished)} of {len(todo)} shots are finished already: {', '.join(finished)}")
        work = _Work(whole.camera, plan, session, ledger, every, unfinished, progress, log, reading)
        work.do()
        with reading():
            scenes.survey(todo)
        notes = ledger.notes = scenes.notes(todo)
        if all(ledger.done(shot) for shot in every):
            notes = ledger.notes = scenes.notes(every)
            missing = [f"{note.path}: {note.text}" for note in notes if usd.MISSING in note.text]
            ledger.finish(every, contact.write(plan.out, every, ledger.rows, told=missing))
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
        eye: camera, as the session knows it.
        plan: what to make.
        every: all shots; the first one's world is what labels are of.
        unfinished: those to make.
        ledger, session, progress, log, reading: see `bake`.

    Attributes:
        seconds: wall time of each shot that was made, by folder.
    """

    def __init__(
        self,
        eye: str | None,
        plan: BakePlan,
        session: Session,
        ledger: Ledger,
        every: Sequence[Shot],
        unfinished: Sequence[Shot],
        progress: Progress,
        log: Callable[[str], None],
        reading: Reading,
    ) -> None:
        self.seconds: dict[str, float] = {}
        self._eye, self._plan, self._session, self._ledger = eye, plan, session, ledger
        self._every, self._unfinished = every, unfinished
        self._progress, self._log, self._reading = progress, log, reading
        self._scenes, self._specimen = session.scenes(eye), session.specimen(eye)
        self._metered = is_metered(session.graph, plan)
        self._views: dict[str, _View] = {}  # by lighting
        self._lit = set[str]()  # lightings whose brightness was logged
        with reading():
            self._first = self._scenes.of(every[0])
        self._alone = self._first.camera.width_px * self._first.camera.height_px > ALONE_PX
        self._settings = _settings(plan, None, 1.0)

    def do(self) -> None:
        """Make them."""
        from synfog_usd.camera.exposure import moments_of
        from synfog_usd.render.shot import check_memory

        graph, ledger, plan = self._session.graph, self._ledger, self._plan
        for shot in self._unfinished:
            if shot in self._scenes.known:
                check_memory(self._scenes.known[shot], self._settings)
        written = {*OF_SHOT, *(f"{name}.exr" for name in moments_of(graph)), *graph.outputs}
        if moved := ledger.set_aside(self._every, written):
            self._log(f"{plan.out}: {moved}")
        if self._alone or self._every[0] not in self._unfinished:
            self._label(-1)
        with _Behind() as behind:  # a shot is denoised, developed and written while the next is sampled
            for index, shot in enumerate(self._unfinished):
                if shot == self._every[0] and shot.fog != CLEAR:
                    self._label(index - 1)
                self._make(index, shot, behind)
                if shot == self._every[0] and shot.fog == CLEAR:  # the scene is there, whole
                    self._label(index)

    def _make(self, index: int, shot: Shot, behind: _Behind) -> None:
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
            self._scenes.taken,
            moments_of(self._session.graph),
            within(step, SET_UP, sampled),
        )
        if self._alone:
            self._session.renderer.free()
            picture = functools.partial(_same, picture(within(step, sampled, 1.0)))
        behind.do(functools.partial(self._finish, shot, picture, began))

    def _look(self, shot: Shot, behind: _Behind) -> None:
        """Meter a lighting."""
        with self._reading():
            clear = clear_scenes(shot, self._session, self._eye)
        view = meter_view(shot.lighting, clear, self._session, self._plan, behind.wait)
        self._views[shot.lighting] = view
        mean = f"{float(view.luminance.mean()):.3g} cd/m2 in clear air"
        exposed = f", exposed {view.exposure}" if view.exposure else ""
        if self._plan.clip is None or not self._plan.clip.number:  # sequence.json has the exposures of all frames
            self._log(f"{shot.lighting}: this view has {mean}{exposed}")

    def _label(self, index: int) -> None:
        """After the shot of this number, and before the next; -1 before all."""
        from synfog_usd.render.film import aovs

        done = self._done(index, 1.0)
        if self._plan.draft or self._ledger.labels_done():
            return

        def told(what: str, part: float) -> None:
            self._progress(f"labels: {what} {part:.0%}", done)

        self._progress("labels", done)
        first, pinhole = self._first, self._scenes.taken
        loaded = self._session.renderer.within(replace(first, fog=()))
        pierced, view = aovs.pierced(loaded, progress=told), self._views.get(self._every[0].lighting)
        visible = view.seen if view and view.world is first.world else aovs.measure(loaded, progress=told)
        self._ledger.add_labels(
            _write_labels(visible, first, self._plan, self._session.graph, pinhole, pierced, loaded)
        )

    def _finish(self, shot: Shot, picture: _Picture, began: float) -> None:
        row = _finish(picture(silent), self._session.graph, self._plan, self._specimen)
        self._ledger.add(shot, row)
        self.seconds[shot.folder] = time.perf_counter() - began
        for line in row["warnings"]:
            self._log(f"{shot.folder}: {line}")

    def _done(self, index: int, fraction: float) -> float:
        """Part of the shots that is done."""
        return (index + fraction) / max(len(self._unfinished), 1)


@dataclass(frozen=True)
class _View:
    """A lighting in clear air: how it is exposed, for all fog levels alike, and what is there.

    Attributes:
        exposure: see `camera.meter`; None where the graph says it.
        pixel: what a pixel makes of light, see `camera.sensitivity`, or None.
        luminance: of the small frame that was metered [cd m-2].
        seen: what the ray through each pixel's centre meets.
        world: of the scene that was looked at.
        parts: of that world, see `transmittance.boxes_of`.
        others: name of a further graph -> how it exposes, see `BakePlan.meter_for`.
    """

    exposure: Any
    pixel: tuple[float, float] | None
    luminance: np.ndarray
    seen: Aovs
    world: Mapping[str, Any]
    parts: PartBoxes
    others: Mapping[str, Any]

    @property
    def noise(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """Luminance -> standard deviation of what a pixel reads [cd m-2]."""
        return _noise(self.pixel) if self.pixel else None


def is_metered(graph: NodeGraph, plan: BakePlan) -> bool:
    """Whether a lighting is looked at in clear air, to find out how it is exposed."""
    from synfog_usd import camera

    return bool(camera.exposure_left_open(graph) or plan.meter_for) or (plan.exposure_s, plan.iso) != (None, None)


def clear_scenes(shot: Shot, session: Session, camera: str | None) -> dict[str | None, SceneDict]:
    """What is metered for a shot, without fog, by camera: what its own sees, and the others that are exposed alike."""
    plan = session.plan
    partners = [name for name in plan.rig if name != camera] if plan.meter == TOGETHER else []
    clear = cleared(session.stage, shot)
    return {name: replace(session.scenes(name).of(clear), fog=()) for name in (camera, *partners)}


def _groups_for(graph: NodeGraph, rendered: Rendered) -> dict[str, Image]:
    """The light of groups of lamps alone, for inputs that ask for it by name; 0 where no such lamp is lit."""
    import numpy as np

    from synfog_usd.camera.exposure import LIGHTGROUP

    radiance = rendered.radiance
    return {
        name: radiance.with_pixels(
            rendered.groups.get(name.removeprefix(LIGHTGROUP), np.zeros_like(radiance.pixels)).astype(np.float32)
        )
        for name in graph.inputs
        if name.startswith(LIGHTGROUP)
    }


def meter_view(
    lighting: str,
    clear: Mapping[str | None, SceneDict],
    session: Session,
    plan: BakePlan,
    ready: Callable[[], None],
) -> _View:
    """Scenes without fog, the camera's own first, metered on small frames; the graph runs after `ready`."""
    from synfog_usd import camera
    from synfog_usd.base import photometry
    from synfog_usd.render import models
    from synfog_usd.render.film import aovs
    from synfog_usd.scene import transmittance

    graph = session.graph
    frame, *side_frames = [session.frame(lighting, eye, scene) for eye, scene in clear.items()]
    scene = next(iter(clear.values()))
    loaded = session.renderer.loaded_for(scene, models.AUTO)
    ready()
    needed = camera.exposure_left_open(graph) or (plan.exposure_s, plan.iso) != (None, None)
    exposure = camera.meter(frame, graph, side_frames=side_frames, compensation_ev=plan.ev) if needed else None
    if exposure and plan.clip and (before := plan.clip.before.get(lighting)):
        exposure = camera.adapted(
            exposure, before, graph, elapsed_s=1.0 / plan.clip.per_s, constant_s=plan.clip.adaptation_s
        )
    fixed = {"exposure_s": plan.exposure_s, "iso": plan.iso}
    graphs = {path.stem: camera.exposed(camera.load_graph(path), **fixed) for path in plan.meter_for}
    further = {
        name: camera.meter(frame, other_graph, side_frames=side_frames, compensation_ev=plan.ev)
        for name, other_graph in graphs.items()
        if camera.exposure_left_open(other_graph)
    }
    pixel = camera.sensitivity(frame, graph, exposure) if exposure else None
    return _View(
        exposure,
        pixel,
        photometry.luminance(frame),
        aovs.measure(loaded),
        scene.world,
        transmittance.boxes_of(scene.world),
        further,
    )


@dataclass(frozen=True)
class ShotMade:
    """A shot that is rendered.

    Attributes:
        shot, scene, view, taken, rendered: its subject, its exposure, what the sensor takes of it, and what
            came of it.
        noise: luminance -> standard deviation of what a pixel of it reads [cd m-2], or None.
        clear: label id -> transmittance of the fog before an instance.
        exposures: inputs of the graph that see a part of the exposure -> their radiance.
    """

    shot: Shot
    scene: SceneDict
    view: _View | None
    taken: Pinhole | None
    rendered: Rendered
    noise: Callable[[np.ndarray], np.ndarray] | None
    clear: Mapping[int, float]
    exposures: Mapping[str, Image]

    @property
    def mor_m(self) -> float | None:
        """Visibility [m] of the outermost fog, or None."""
        return next((volume.medium.visibility_m for volume in self.scene.fog if volume.parent is None), None)


_Picture = Callable[[Progress], ShotMade]
"""Makes the picture of a shot that was sampled."""


def _same(result: ShotMade, progress: Progress) -> ShotMade:
    """A picture that is made."""
    return result


class _Behind:
    """One task at a time, in a thread of its own; what it raises is raised at the next."""

    def __init__(self) -> None:
        self._thread = concurrent.futures.ThreadPoolExecutor(max_workers=1)
        self._task: concurrent.futures.Future[None] | None = None

    def __enter__(self) -> _Behind:
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


def sample_shot(
    shot: Shot,
    scene: SceneDict,
    renderer: Renderer,
    view: _View | None,
    plan: BakePlan,
    pinhole: Pinhole | None,
    exposures: Mapping[str, tuple[float, float]],
    progress: Progress,
) -> _Picture:
    """Sample one shot, and once more for each part of its exposure that is asked for by itself where things move; what
    makes its pictures.
    """
    from synfog_usd.render.shot import sample
    from synfog_usd.scene import transmittance

    density = _density(scene, pinhole)
    floor = _shared(view.noise, density) if view and view.noise else None
    looked_at = view if view and view.world is scene.world else None
    through = transmittance.of_instances(scene, looked_at.parts if looked_at else None)
    loaded = renderer.loaded_for(scene, plan.model)
    moving = exposures if scene.camera.moves or scene.motion_of else {}
    settings = _settings(plan, floor, density, seed32(plan.seed, shot.lighting, shot.fog))
    clear = looked_at.seen if looked_at and not loaded.boundaries and not scene.camera.width_m else None
    share = 1.0 / (1 + len(moving))
    part_progress = within(progress, 0.0, share)
    rendered = sample(scene, settings, loaded=loaded, clear=clear, progress=part_progress)
    parts = {}
    for number, (name, part) in enumerate(moving.items(), 1):
        eye = replace(scene.camera, exposes=part)
        source = loaded.source
        parts[name] = sample(
            replace(scene, camera=eye),
            replace(settings, seed=seed32(settings.seed, name)),
            loaded=replace(loaded, source=replace(source, camera=replace(source.camera, exposes=part))),
            clear=clear,
            progress=within(progress, number * share, (number + 1) * share),
        )

    def picture(progress: Progress) -> ShotMade:
        whole = rendered.picture(within(progress, 0.0, share))
        visible = {
            name: part.picture(within(progress, number * share, (number + 1) * share)).radiance
            for number, (name, part) in enumerate(parts.items(), 1)
        }
        visible = visible or dict.fromkeys(exposures, whole.radiance)
        return ShotMade(shot, scene, view, pinhole, whole, floor, through, visible)

    return picture


def _density(scene: SceneDict, pinhole: Pinhole | None) -> float:
    """Rendered pixels side by side for one of the sensor."""
    return pinhole_of(scene.camera).focal_px / pinhole.focal_px if pinhole else 1.0


def _settings(
    plan: BakePlan, floor: Callable[[np.ndarray], np.ndarray] | None, density: float, seed: int = 0
) -> Settings:
    """How a shot is rendered, whose pixels may have the noise `floor`."""
    from synfog_usd.render.sampling.adaptive import sensor_target
    from synfog_usd.render.shot import Settings

    assert plan.samples is not None  # a plan that was made is whole
    quality, by_quality = plan.promise, plan.target_error is None
    error = quality.error if by_quality else plan.target_error
    return Settings(
        model=plan.model,
        samples=max(2, round(plan.samples / density**2)),
        seed=seed,
        target_error=min(1.0, error * density) if error is not None else None,
        target_mottle=quality.mottle if by_quality else None,
        sensor_sigma=sensor_target(floor) if floor and by_quality and quality.sensor else None,
        bands=plan.bands,
        denoise=quality.clean,
        draft=plan.draft,
        regularize=quality.clean,
    )


def taken_with(result: ShotMade, plan: BakePlan, specimen: str | None) -> dict[str, Any]:
    """What a camera notes of a shot beside its light: what its graph reads from the image's provenance."""
    from synfog_usd.render.load import is_thin_lens

    more: dict[str, Any] = {}
    if result.taken is not None:
        more["view"] = [*result.taken[:3], *result.taken.shift]
    if is_thin_lens(result.scene.camera):
        more["sharp_at_m"] = result.scene.camera.focus_m
    if specimen is not None:
        more["specimen"] = specimen
    if plan.ev:
        more["exposure_bias_ev"] = plan.ev
    if plan.clip is not None:
        more |= {"frame_number": plan.clip.number, "frames_per_s": plan.clip.per_s}
    return more


def inputs_of(
    graph: NodeGraph, rendered: Rendered, radiance: Image, exposures: Mapping[str, Image]
) -> dict[str, Image]:
    """What a graph is given of a shot: its light, and that of parts of the exposure and of groups of lamps."""
    whole = {} if exposures and "radiance" not in graph.inputs else {"radiance": radiance}
    return {**whole, **exposures, **_groups_for(graph, rendered)}


def _finish(result: ShotMade, graph: NodeGraph, plan: BakePlan, specimen: str | None) -> dict[str, Any]:
    """Develop a shot, write its files, and give its row of the manifest."""
    from synfog_usd import camera
    from synfog_usd.camera import writers

    shot, rendered, folder = result.shot, result.rendered, plan.out / result.shot.folder
    marks: dict[str, str | int | float] = {
        "synfog:lighting": shot.lighting,
        "synfog:fog": shot.fog,
        "synfog:mor_m": result.mor_m or 0.0,
        "synfog:model": rendered.model,
    }
    more = taken_with(result, plan, specimen)
    radiance = rendered.radiance.with_metadata(**more)
    exposures = {name: part.with_metadata(**more) for name, part in result.exposures.items()}
    writers.write_exr(folder / "radiance.exr", radiance, attributes=marks)
    writers.write_exr(folder / "layers.exr", _layers(rendered), attributes=marks)
    files.write_json(folder / "instances.json", labels.instance_list(result.clear, result.scene, _left(result, graph)))
    for name, part in exposures.items():
        writers.write_exr(folder / f"{name}.exr", part, attributes=marks)
    results = camera.develop(
        graph,
        inputs_of(graph, rendered, radiance, exposures),
        seed=noise_seed(plan.seed, shot.lighting, shot.fog, same_noise=plan.same_noise),
        exposure=result.view.exposure if result.view else None,
        keep=list(graph.outputs.values()),
    )
    for name, node in graph.outputs.items():
        writers.write_output(name, results[node], folder, options=graph.options_of(name))
    names = sorted([*OF_SHOT, *(f"{name}.exr" for name in exposures), *graph.outputs])
    return _row(result, plan) | {"files": {name: files.sha256_of(folder / name) for name in names}}


def _layers(rendered: Rendered) -> list[Image]:
    """What layers.exr holds."""
    variance = rendered.radiance.variance
    assert variance is not None
    named = {
        **rendered.components,
        "variance": variance,
        **{f"lightgroup_{name}": pixels for name, pixels in rendered.groups.items()},
    }
    channels = rendered.radiance.channels
    images = [rendered.aovs.transmittance_image()]
    images += [
        Image(pixels, tuple(f"{name}.{channel}" for channel in channels), Quantity.DATA)
        for name, pixels in named.items()
    ]
    if rendered.error is not None:
        images.append(Image(rendered.error[:, :, None], ("error.Y",), Quantity.DATA))
    return images


def _row(result: ShotMade, plan: BakePlan) -> dict[str, Any]:
    """What the manifest says of a shot, but for its files."""
    shot, scene, view, pinhole, rendered = result.shot, result.scene, result.view, result.taken, result.rendered
    size = [scene.camera.width_px, scene.camera.height_px]
    row: dict[str, Any] = {
        "lighting": shot.lighting,
        "fog": shot.fog,
        "folder": shot.folder,
        "mor_m": None if result.mor_m is None else round(result.mor_m, 6),
        "camera": scene.camera.path,
        "size_px": [pinhole.width_px, pinhole.height_px] if pinhole else size,
    }
    if pinhole:
        row["rendered_px"] = size
    row |= {
        "model": {"name": rendered.model, "bands": len(rendered.radiance.channels), "why": rendered.why},
        "samples": float(f"{rendered.samples:.5g}"),
        "denoised": bool(rendered.radiance.provenance.get("denoised", False)),
        "target": _target(plan, view.pixel if view else None, rendered),
        "relative_error": float(f"{rendered.relative_error:.4g}"),
        "mottle": None if rendered.mottle is None else float(f"{rendered.mottle:.4g}"),
        "exposure": _exposure(view.exposure, plan) if view and view.exposure else None,
    }
    if view and view.others:
        row["further_exposures"] = {
            name: {"exposure_s": exposure.exposure_s, "iso": exposure.iso} for name, exposure in view.others.items()
        }
    black = _why_black(rendered.radiance, scene)
    return row | {"warnings": [*rendered.warnings, *([black] if black else [])]}


def _exposure(exposure: Any, plan: BakePlan) -> dict[str, Any]:
    row = {"exposure_s": exposure.exposure_s, "iso": exposure.iso}
    if None in (plan.exposure_s, plan.iso):
        row |= _metered_on(plan)
    return row | ({"ev": plan.ev} if plan.ev else {})


def _metered_on(plan: BakePlan) -> dict[str, str]:
    together = f", of {len(plan.rig)} cameras together" if len(plan.rig) > 1 and plan.meter == TOGETHER else ""
    return {"metered_on": f"the clear frame, {METER_WIDTH_PX} px wide{together}"}


def _left(result: ShotMade, graph: NodeGraph) -> dict[int, dict[str, Any]]:
    """What the fog leaves of each instance that is seen, by label id."""
    from synfog_usd import camera
    from synfog_usd.base import photometry

    radiance, visible, noise = result.rendered.radiance, result.rendered.aovs, result.noise
    luminance = photometry.luminance(radiance)
    if (
        noise is None and not (result.view and result.view.exposure) and (luminance > 0.0).any()
    ):  # the graph says itself how it exposes
        exposure = camera.Exposure(1.0, 1.0, float(luminance.mean()))
        pixel = camera.sensitivity(radiance, graph, exposure)
        if pixel:
            noise = _shared(_noise(pixel), _density(result.scene, result.taken))
    surface = result.rendered.components.get("surface")
    unscattered = None if surface is None else photometry.luminance(radiance.with_pixels(surface))
    return visibility.rows(visible.instance_id, visible.transmittance, luminance, unscattered, noise)


def _noise(pixel: tuple[float, float]) -> Callable[[np.ndarray], np.ndarray]:
    """Luminance -> standard deviation of what a pixel reads [cd m-2], by what `camera.sensitivity` gives."""
    from synfog_usd import camera

    return functools.partial(camera.noise_floor, electrons_per_cd_m2=pixel[0], dark_noise_e=pixel[1])


def _shared(noise: Callable[[np.ndarray], np.ndarray], density: float) -> Callable[[np.ndarray], np.ndarray]:
    """Noise that a rendered pixel may have where density^2 of them are averaged for one of the sensor."""
    return lambda luminance: density * noise(luminance)


def _why_black(radiance: Image, scene: SceneDict) -> str | None:
    from synfog_usd.translate import why_black

    return (
        None
        if (radiance.pixels > 0.0).any()
        else why_black(scene) or "the picture is black: no light reaches the camera"
    )


def _target(plan: BakePlan, pixel: tuple[float, float] | None, rendered: Rendered) -> dict[str, Any]:
    """What the render was to reach, the share of its pixels that did, and the sensor's noise where it is known.

    For the quality `sensor`: the shares of its noise under which what differs from seed to seed and the whole error are
    to stay.
    """
    quality = plan.promise
    target: dict[str, Any] = {}
    if plan.target_error is not None:
        target = {"relative_error": plan.target_error}
    elif quality.error is not None:
        target = {"relative_error": quality.error, "mottle": quality.mottle}
    elif not quality.sensor or pixel is None:
        target = {"samples": plan.samples}
    if pixel is not None:
        target["sensor"] = {
            "electrons_per_cd_m2": float(f"{pixel[0]:.4g}"),
            "dark_noise_e": float(f"{pixel[1]:.4g}"),
        }
        if quality.sensor and plan.target_error is None:
            whole = 1.0 if rendered.radiance.provenance.get("denoised") else 1 / 3
            target["sensor"] |= {"share": 1 / 3, "whole_share": whole}
    return target | ({} if rendered.under_target is None else {"pixels_under_it": round(rendered.under_target, 4)})


def _write_labels(
    visible: Aovs,
    scene: SceneDict,
    plan: BakePlan,
    graph: NodeGraph | None = None,
    pinhole: Pinhole | None = None,
    pierced: tuple[np.ndarray, np.ndarray] | None = None,
    loaded: MitsubaScene | None = None,
) -> dict[str, str]:
    """Write what is seen where in clear air, bent as the graph's lens bends the picture; radiance.exr and layers.exr
    stay those of a pinhole.

    `pierced` tells what stands behind, see `aovs.pierced`; `loaded`, what the right eye of a rig sees of it.
    """
    from synfog_usd.camera import distortion, writers

    metadata: dict[str, Any] = {}
    nearest = None
    bent = graph and distortion.of_graph(graph, pinhole_of(scene.camera), pinhole)
    pair, disparity = stereo.pair_of(scene), None
    if pair and loaded and not bent:
        disparity = stereo.planes(visible, pair, loaded)
    area, bend = (lanes.ids(visible, scene) if scene.lanes else None), None
    if bent:
        node, warp = bent
        nearest, bend = warp.nearest(), functools.partial(warp.bent, pinhole_of(scene.camera))
        area = None if area is None else area[nearest]
        visible = labels.warped(visible, nearest)
        metadata = {
            "warped": f"distortion of node {node!r}; radiance.exr and layers.exr are not",
            "camera_matrix_px": warp.camera_matrix(),
            "distortion_coefficients": list(warp.coefficients),
        }
    image = labels.label_image(visible, scene.instances, area, disparity)
    header = {
        name: str(value) for name, value in image.provenance.items() if name.startswith("cryptomatte/")
    }  # where Cryptomatte's readers look
    writers.write_exr(plan.out / "labels.exr", image.with_metadata(**metadata), attributes=header)
    more = {}
    if pierced is not None:
        view = objects.Projection.of(scene.camera if pinhole is None else replace(scene.camera, **size_of(pinhole)))
        more = objects.rows(scene, pierced, view, nearest)
        eye = view.metadata(scene.origin_m)
        if bent:
            eye |= {
                "model": "opencv",
                "camera_matrix_px": metadata["camera_matrix_px"],
                "distortion_coefficients": metadata["distortion_coefficients"],
            }
        metadata = {"camera": eye} | metadata
    if pair and disparity is not None:
        metadata |= {"stereo": pair.metadata()}
    elif pair:
        metadata |= {"stereo": {"right": pair.right.path, "no_disparity": "the lens distorts: rows do not match"}}
    if area is not None:
        metadata |= {"lanes": lanes.rows(area, scene, bend)}
    files.write_json(plan.out / "labels.json", labels.label_list(visible, scene.instances, more) | metadata)
    return {name: files.sha256_of(plan.out / name) for name in ("labels.exr", "labels.json")}

"""An opened stage, and the renderer with a scene of it: what the bakes of a rig's cameras have in common.

A lighting is translated once and loaded once; another camera or another fog is exchanged in it.  Takes a plan; gives
the scenes of each camera, and the small frames that are metered.
"""

from __future__ import annotations

import contextlib
import functools
import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synfog_usd.base.errors import GraphError, StageError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.numbers import RGB
from synfog_usd.base.seeds import frame_seed, seed32
from synfog_usd.dataset.plan import BakePlan, Shot
from synfog_usd.dataset.scenes import Scenes

if TYPE_CHECKING:
    from synfog_usd.camera.graph import NodeGraph
    from synfog_usd.render.load import MitsubaScene
    from synfog_usd.scene import SceneDict
    from synfog_usd.stage import Stage

Reading = Callable[[], contextlib.AbstractContextManager[None]]

METER_WIDTH_PX = 160
METER_SAMPLES, METER_SAMPLES_RAW, DRAFT_METER_SAMPLES = 4, 64, 8
"""Of a pixel of the frame that is metered: where it can be denoised, else, and of a draft, whose frame is not.  Four
leave 0.02 to 0.05 EV of noise in the exposure."""


@dataclass
class Session:
    """What the bakes of several cameras share, which differ in `camera` and `out` alone; or those of a clip's frames.

    Attributes:
        plan: of all of them.
        graph: the node graph.
        stage: opened, as the plan reads it.
        cameras: prim paths of the requested ones; None for the stage's own choice.
        renderer: with the scene that was asked for last.
        frames: (lighting, camera) -> what was metered.
    """

    plan: BakePlan
    graph: NodeGraph
    stage: Stage
    cameras: tuple[str | None, ...]
    renderer: Renderer
    frames: dict[tuple[str, str | None], Image] = field(default_factory=dict)
    _scenes: dict[str | None, Scenes] = field(default_factory=dict)
    _lightings: dict[str, Any] = field(default_factory=dict)
    _before: dict[str, Any] = field(default_factory=dict)
    _same_but_fog: set[tuple[Shot, str | None]] = field(default_factory=set)

    @functools.cached_property
    def stage_hash(self) -> str:
        """Of all that the stage is made of."""
        from synfog_usd import stage as usd

        return usd.stage_hash(self.stage)

    def at(self, plan: BakePlan) -> Session:
        """The same stage, of another frame: what stands is taken over from this one's."""
        rig, authored = self.plan.rig, self.scenes(plan.camera).authored
        before = self._lightings or self._before
        moment = replace(self, plan=replace(plan, rig=rig), frames={}, _scenes={}, _lightings={}, _before=before)
        moment.__dict__["stage_hash"] = self.stage_hash
        for camera in (*self.cameras, *rig):
            moment.scenes(camera).authored = authored
        moment.renderer.serve(plan)
        return moment

    def of(self, camera: str | None) -> BakePlan:
        """The plan of one of the cameras, with the seeds of its own."""
        specimen, plan = self.specimen(camera), replace(self.plan, camera=camera)
        paths = plan.paths if specimen is None else seed32(plan.paths, "camera", specimen)
        return replace(plan, seed=own_seed(plan, self.stage, specimen), sampling_seed=paths)

    def scenes(self, camera: str | None) -> Scenes:
        """What a camera sees."""
        if camera not in self._scenes:
            self._scenes[camera] = Scenes(
                self.stage,
                replace(self.plan, camera=camera),
                self.graph,
                lightings=self._lightings,
                before=self._before,
            )
        return self._scenes[camera]

    def without_fog(self, camera: str | None, shot: Shot, clear: Shot) -> SceneDict:
        """What a camera sees of a shot in its clear air; a clip reads that for its first frame alone, where the two
        differ in fog only.
        """
        scenes, key = self.scenes(camera), (shot, camera)
        foggy = scenes.known.get(shot)
        scene = foggy if foggy and key in self._same_but_fog else scenes.of(clear)
        if foggy and scene.world is foggy.world:
            self._same_but_fog.add(key)
        return replace(scene, fog=())

    def specimen(self, camera: str | None) -> str | None:
        """Which of a rig's cameras it is: its path, or None for the one that the stage itself would choose."""
        from synfog_usd.translate import own_camera

        return camera if camera is not None and camera != own_camera(self.stage) else None

    def frame(self, lighting: str, camera: str | None, clear: SceneDict) -> Image:
        """The small frame of a camera, in clear air, that its exposure is metered on."""
        from synfog_usd.render import backend, denoise, models
        from synfog_usd.render.load import resized
        from synfog_usd.render.shot import render

        if (lighting, camera) not in self.frames:
            draft = self.plan.sampling.draft
            clean = not draft and not backend.is_scalar() and not denoise.available()
            size = METER_WIDTH_PX, max(1, round(METER_WIDTH_PX * clear.camera.height_px / clear.camera.width_px))
            self.frames[lighting, camera] = render(
                clear,
                samples=DRAFT_METER_SAMPLES if draft else METER_SAMPLES if clean else METER_SAMPLES_RAW,
                seed=seed32(self.of(camera).paths, "meter"),
                size=size,
                denoise=clean,
                loaded=resized(self.renderer.loaded_for(clear, models.AUTO), size),
            ).radiance
        return self.frames[lighting, camera]


def begin(plan: BakePlan, names: Sequence[str] | None, reading: Reading) -> Session:
    """Open a plan's stage for the cameras of these names, see `stage.named_cameras`; None for the stage's own.

    Raises:
        SynfogError: with place and fix.
    """
    from synfog_usd import camera
    from synfog_usd import stage as usd
    from synfog_usd.render import backend, models
    from synfog_usd.translate import own_camera

    models.check_name(plan.sampling.model)
    backend.begin(plan.sampling.variant)  # type: ignore[arg-type]
    graph = camera.load_graph(plan.pipeline or Path("phone"))
    for name, port in graph.inputs.items():
        if port.quantity is not Quantity.RADIANCE:
            raise GraphError(
                f"graph {graph.name!r}: its input {name!r} is {port}, and a bake has radiance alone for it. Run it "
                f"with 'synfog-usd graph run' on radiance.exr; depth of field is drawn where the stage's camera has "
                f"fStop and focusDistance"
            )
    graph = camera.exposed(graph, exposure_s=plan.exposes.exposure_s, iso=plan.exposes.iso)
    check_compensation(graph, plan.exposes.ev)
    with reading():
        stage = usd.open_stage(plan.stage, allow=plan.reads.allow)
        reads = plan.reads
        if reads.choices or (reads.metres_per_unit, reads.up, reads.shutter_s) != (None, None, None):
            usd.override(
                stage,
                choices=reads.choices,
                metres_per_unit=reads.metres_per_unit,
                up=reads.up,
                shutter_s=reads.shutter_s,
            )
        own_path = own_camera(stage)
        cameras: tuple[str | None, ...] = (None,) if names is None else usd.named_cameras(stage, names)
        rig = usd.named_cameras(stage, [name or own_path or "" for name in plan.rig])
        if rig and names is None:
            cameras = (own_path,)
        plan = replace(plan, rig=rig or (tuple(value for value in cameras if value) if len(cameras) > 1 else ()))
    session = Session(plan, graph, stage, cameras, Renderer(plan))
    for value in (*cameras, *plan.rig):
        session.scenes(value)  # before a shot chooses variants
    return session


def check_compensation(graph: NodeGraph, ev: float) -> None:
    """Refuse a change of what nobody meters.

    Raises:
        GraphError: the graph itself says exposure time and ISO.
    """
    from synfog_usd import camera

    if ev and not camera.exposure_left_open(graph):
        raise GraphError(
            f"--ev {ev:g}: graph {graph.name!r} itself says exposure time and ISO, so nothing is metered; change "
            f"exposure_s or iso there"
        )


def own_seed(plan: BakePlan, stage: Stage, specimen: str | None) -> int:
    """Seed of one view: its own for every frame but the stage's first, and every camera but the stage's own."""
    from synfog_usd.translate import own_frame

    seed = plan.seed
    if plan.clip is None and plan.frame is not None and plan.frame != own_frame(stage):
        seed = frame_seed(seed, plan.frame)
    return seed if specimen is None else seed32(seed, "camera", specimen)


def one_camera(session: Session) -> str | None:
    """The camera of a session for one.

    Raises:
        StageError: its name means several.
    """
    if len(session.cameras) > 1:
        raise StageError(
            f"{session.plan.stage}: {session.plan.camera} means {len(session.cameras)} cameras, and one is wanted "
            f"here; a set names each of them, as in cameras: [{', '.join(map(str, session.cameras))}]"
        )
    return session.cameras[0]


class Renderer:
    """The renderer's side of one scene at a time; one that differs in fog or camera alone needs no loading."""

    def __init__(self, plan: BakePlan) -> None:
        self.plan = plan
        self.world: Any = None
        self.loaded: Any = None
        self.views: dict[str, MitsubaScene] = {}

    def serve(self, plan: BakePlan) -> None:
        """Render for another plan from now on; what is loaded stays where it is what that wants."""
        if (plan.sampling.bands == RGB) != (self.plan.sampling.bands == RGB):
            self.free()
        self.plan = plan

    def within(self, scene: SceneDict) -> MitsubaScene:
        """The scene in the renderer, without boundaries of fog."""
        from synfog_usd.render.load import in_fog
        from synfog_usd.render.shot import load, look

        if self.world is not scene.world:
            known = self.loaded.known if self.loaded and scene.moving else None
            self.free()
            spectra = self.plan.sampling.bands != RGB
            self.loaded, self.world = load(scene, boundaries=False, spectra=spectra, known=known), scene.world
            self.views[scene.camera.path] = self.loaded
        if scene.camera.path not in self.views:
            self.views[scene.camera.path] = look(self.loaded, scene.camera)
        return in_fog(self.views[scene.camera.path], scene.fog)

    def loaded_for(self, scene: SceneDict, model: str) -> MitsubaScene:
        """The scene in the renderer as a model wants it."""
        from synfog_usd.render import models
        from synfog_usd.render.shot import load

        if not models.MODELS[models.choose(model, scene)[0]].boundaries:
            return self.within(scene)
        self.free()
        return load(scene)

    def free(self) -> None:
        """Let the scene go, before another is loaded: two take twice the memory, and make the renderer's tables
        and kernels larger.
        """
        from synfog_usd.render import backend

        self.world = self.loaded = None
        self.views = {}
        gc.collect()
        backend.let_go()

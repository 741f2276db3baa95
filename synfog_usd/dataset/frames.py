"""One view of a stage, rendered: numpy arrays of its light and its labels.

Takes a USD file; gives a `Scene`, and `Frame`s of it by the steps that a bake makes a shot of, so that the numbers are
those of its files.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import FloatArray
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.values import check_words, names, path_of
from synfog_usd.camera.writers import write_exr
from synfog_usd.dataset import drops
from synfog_usd.dataset.asked import fog_names, plan_of
from synfog_usd.dataset.job import reading_here
from synfog_usd.dataset.labels import label_image
from synfog_usd.dataset.plan import AS_AUTHORED, BakePlan, Shot, noise_seed, shots
from synfog_usd.dataset.session import Session, begin, one_camera
from synfog_usd.dataset.shot import RenderedShot, clear_scenes, is_metered, meter_view, sample_shot
from synfog_usd.dataset.shot_files import provenance_of

if TYPE_CHECKING:
    from synfog_usd.base.notes import Note
    from synfog_usd.dataset.asked import FogLike
    from synfog_usd.scene import Instance, SceneDict

OF_SCENE = (
    *("frame", "lights", "light_scale", "choose", "meters_per_unit", "up", "shutter", "allow"),
    *("exposure", "iso", "ev", "variant"),
)
"""Options of a bake that `load` takes too."""

OF_RENDER = ("samples", "target_error", "model", "bands")
"""Options of a bake that `render` takes too."""


class Scene:
    """One lighting, fog and camera of a stage, ready to render; `load` makes it.

    Attributes:
        stage: its file.
        lighting, fog: names, 'authored' for what the stage has without a choice.
        camera: prim path.
        width_px, height_px: of the picture.
        notes: what the translation simplified or left out, by prim path.
    """

    def __init__(self, session: Session, shot: Shot, options: Mapping[str, Any]) -> None:
        self._session, self._shot, self._asked = session, shot, dict(options)
        self._metered: dict[int, dict[tuple[str, str | None], Image]] = {}  # by seed
        self._eye = session.plan.camera
        with reading_here():
            scene = self._scene()
        self.stage, self.lighting, self.fog = session.plan.stage, shot.lighting, shot.fog
        self.camera = scene.camera.path
        self.notes: tuple[Note, ...] = tuple(scene.notes)
        self.width_px, self.height_px = scene.camera.width_px, scene.camera.height_px

    def __repr__(self) -> str:
        view = f"{self.camera}, {self.width_px} x {self.height_px}"
        return f"<Scene {self.stage.name}: lighting {self.lighting}, fog {self.fog}, camera {view}>"

    def in_fog(self, fog: FogLike | None) -> Scene:
        """The same scene in another fog, without opening or translating the stage again.

        Args:
            fog: as `load` takes it.

        Raises:
            SynfogError: as `load` raises it.
        """
        plan = replace(self._session.plan, fog=_one_fog(fog), lighting=(self.lighting,))
        foggy = Scene(self._session, _only_shot(plan, self._session), self._asked)
        foggy._metered = self._metered
        return foggy

    def _scene(self) -> SceneDict:
        return self._session.scenes(self._eye).of(self._shot)

    def _for(self, plan: BakePlan) -> tuple[Session, BakePlan]:
        """What renders it as a plan wants it, and the plan of its own camera."""
        self._session.renderer.serve(plan)
        session = replace(self._session, plan=plan, frames={})
        eye_plan = session.of(self._eye)
        return replace(session, frames=self._metered.setdefault(eye_plan.seed, {})), eye_plan


@dataclass(frozen=True, eq=False)
class Frame:
    """What a scene looks like before any lens or sensor, and what is seen where; `render` makes it.

    Labels are of the ray through a pixel's centre, in clear air. Where the scene's pipeline has a lens that distorts,
    the picture is wider and denser than the sensor's, and labels are those of this picture.

    Attributes:
        radiance: (H, W, 3) float32, linear Rec.709 [cd m-2]; with wavelength bands (H, W, B) [W m-2 sr-1 nm-1].
        depth_m: (H, W) float32 along the optical axis, infinite at the sky.
        distance_m: (H, W) float32 along the ray, infinite at the sky.
        normal: (H, W, 3) float32, world axes with Z up, turned to the camera; 0 at the sky.
        instance_id: (H, W) int32, `id` of `instances`, 0 for none.
        class_id: (H, W) int32, Cityscapes label ids.
        transmittance: (H, W) float32 of the fog from the camera to the surface, 0 to 1.
        error: (H, W) float32, expected RMS error of the luminance [cd m-2]; None where nothing was denoised.
        variance: shape of `radiance`, float32, of the mean of a pixel's samples.
        layers: name -> shape of `radiance`: 'surface', 'airlight_single', 'airlight_multiple', 'lamps_direct' and
            'drops', what rain or snow near the camera changes, which add up to it; and 'lightgroup_<name>', which do so
            without drops.
        instances: what ids stand for: `id`, `path`, `label` (Cityscapes).
        warnings: what went wrong on the way, in words.
    """

    radiance: FloatArray
    depth_m: FloatArray
    distance_m: FloatArray
    normal: FloatArray
    instance_id: npt.NDArray[np.int32]
    class_id: npt.NDArray[np.int32]
    transmittance: FloatArray
    error: FloatArray | None
    variance: FloatArray
    layers: Mapping[str, FloatArray]
    instances: tuple[Instance, ...]
    warnings: tuple[str, ...]
    _taken: Captured

    def __repr__(self) -> str:
        height, width, channels = self.radiance.shape
        return f"<Frame {width} x {height}, {channels} channels, {len(self.instances)} instances>"

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the radiance as OpenEXR, as a bake's radiance.exr.

        Raises:
            SynfogError: no .exr by its name, or it cannot be written.
        """
        path = path_of(path, "save")
        if path.suffix.lower() != ".exr":
            raise ParameterError(f"{path}: radiance is written as .exr; what `develop` gives has .dng and .png too")
        write_exr(path, self._taken.image)
        return path


@dataclass(frozen=True)
class Captured:
    """What a camera needs of a frame.

    Attributes:
        image: its radiance, with what is known of how it was seen.
        shot: what was rendered.
        clear: the small clear frame that exposures are metered on.
        graph: of the scene's pipeline.
        seed: of the camera's temporal noise.
        ev: by how many stops it is exposed brighter than the meter says.
    """

    image: Image
    shot: RenderedShot
    clear: Image
    graph: Any
    seed: int
    ev: float


def load(
    stage: str | os.PathLike[str],
    *,
    lighting: str | None = None,
    fog: FogLike | None = None,
    camera: str | None = None,
    pipeline: str | os.PathLike[str] | None = None,
    resolution: tuple[int, int] | str | None = None,
    **options: Any,
) -> Scene:
    """One lighting, fog and camera of a stage, ready to render.

    The stage is read in this process, within the fence of its folder and the limits on its size. Limits on memory and
    time are the command line's, whose child process reads it.

    Args:
        stage: USD file, or the name of a stage that ships, as crossroads.
        lighting: a name of its variant set `lighting`; as the stage is authored if left out.
        fog: a variant of the stage, 'clear', a visibility [m], 'mor150' or a `Fog`; as it is authored if left out.
        camera: prim path or name; the render settings' camera or the first if left out.
        pipeline: the simulated camera that is going to take the picture: a name of `cameras`, or a YAML file; the phone
            if left out. A fisheye's or a distorting lens changes what is rendered.
        resolution: (width, height) [px]; the stage's own if left out.
        options: of `synfog-usd bake`, with _ for -: frame, lights, light_scale, choose, meters_per_unit, up,
            shutter, allow, exposure, iso, ev, variant.

    Raises:
        SynfogError: with place and fix.
    """
    from synfog_usd import stage as usd
    from synfog_usd.render import backend

    check_words(options, dict.fromkeys(OF_SCENE))
    words = {**options, "pipeline": pipeline, "resolution": resolution}
    plan = plan_of(stage, **words, lighting=AS_AUTHORED if lighting is None else _one(lighting, "--lighting"))
    plan = replace(plan, fog=_one_fog(fog))
    usd.reread()
    with reading_here():
        session = begin(plan, None if camera is None else [_one(camera, "--camera")], reading_here)
        session = replace(session, plan=replace(session.plan, camera=one_camera(session)))
        shot = _only_shot(plan, session)
    backend.start(plan.sampling.variant)  # type: ignore[arg-type]
    return Scene(session, shot, {"stage": stage, **words})


def render(
    scene: Scene, *, quality: str = "standard", seed: int = 0, progress: Progress = silent, **options: Any
) -> Frame:
    """Transport light through a scene.

    Args:
        scene: of `load`.
        quality: 'draft', 'standard', 'sensor' or 'reference'; they say when sampling stops.
        seed: the same gives the same numbers.
        progress: called with what is done and the fraction that is done.
        options: of `synfog-usd bake`, with _ for -: samples, target_error, model, bands.

    Raises:
        SynfogError: with place and fix.
    """
    from synfog_usd.camera.exposure import moments_of
    from synfog_usd.render import backend
    from synfog_usd.render.film import aovs

    if not isinstance(scene, Scene):
        raise ParameterError(f"render {scene!r:.80}: it takes a scene of load, as in render(load('street.usda'))")
    check_words(options, dict.fromkeys(OF_RENDER))
    plan = plan_of(**scene._asked, quality=quality, seed=seed, **options)
    backend.start(plan.sampling.variant)  # type: ignore[arg-type]
    session, plan = scene._for(plan)
    shot, scenes, renderer = scene._shot, session.scenes(scene._eye), session.renderer
    with reading_here():
        world = scenes.of(shot)
        clear = clear_scenes(shot, session, scene._eye)
    view = None
    if is_metered(session.graph, plan):
        view = meter_view(shot.lighting, clear, session, plan, lambda: None)
    metered = session.frame(shot.lighting, scene._eye, clear[scene._eye])
    visible = view.visible if view and view.world is world.world else None
    moments = moments_of(session.graph)
    picture = sample_shot(shot, world, renderer, view, plan, scenes.sensor, moments, progress)
    result = drops.with_drops(picture(silent), session.graph, drops.FallTime.of(session))
    if visible is None:
        visible = aovs.measure(renderer.within(replace(world, fog=())))
    image = result.rendered.radiance.with_metadata(**provenance_of(result, plan, session.specimen(scene._eye)))
    noise = noise_seed(plan.seed, shot.lighting, shot.fog)
    progress("done", 1.0)
    return _frame(
        label_image(visible, world.instances), Captured(image, result, metered, session.graph, noise, plan.exposes.ev)
    )


def _frame(labels: Image, captured: Captured) -> Frame:
    planes = dict(zip(labels.channels, np.moveaxis(labels.pixels, 2, 0), strict=True))
    rendered = captured.shot.rendered
    groups = {f"lightgroup_{name}": pixels for name, pixels in rendered.groups.items()}
    assert rendered.radiance.variance is not None
    return Frame(
        radiance=rendered.radiance.pixels,
        depth_m=planes["depth.Z"],
        distance_m=planes["distance.Z"],
        normal=np.stack([planes["N.X"], planes["N.Y"], planes["N.Z"]], axis=2),
        instance_id=planes["instance.ID"].astype(np.int32),
        class_id=planes["semantic.ID"].astype(np.int32),
        transmittance=rendered.aovs.transmittance.astype(np.float32),
        error=None if rendered.error is None else rendered.error.astype(np.float32),
        variance=rendered.radiance.variance,
        layers={**rendered.components, **groups},
        instances=captured.shot.scene.instances,
        warnings=rendered.warnings,
        _taken=captured,
    )


def _one(value: object, option: str) -> str:
    several = names(value, option)
    if len(several) != 1:
        raise ParameterError(f"{option} {value!r}: load takes one; bake takes several")
    return several[0]


def _one_fog(fog: object) -> tuple[str, ...]:
    several = (AS_AUTHORED,) if fog is None else fog_names(fog)
    if len(several) != 1:
        raise ParameterError(f"--fog {fog!r}: a scene is in one fog; bake takes several")
    return several


def _only_shot(plan: BakePlan, session: Session) -> Shot:
    from synfog_usd import stage as usd

    (shot,) = shots(plan, usd.variants(session.stage))
    return shot

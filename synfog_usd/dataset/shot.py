"""One shot: metered in clear air, sampled, and made a picture.

Takes a scene, a plan and a session's renderer; gives the shot's exposure and its light, before any file is written.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.progress import Progress, within
from synfog_usd.base.seeds import seed32
from synfog_usd.dataset.plan import CLEAR, TOGETHER, BakePlan, Metered, Shot
from synfog_usd.dataset.scenes import cleared, pinhole_of
from synfog_usd.dataset.session import Renderer, Session

if TYPE_CHECKING:
    from synfog_usd.camera.exposure import Exposure
    from synfog_usd.camera.graph import NodeGraph
    from synfog_usd.camera.pinhole import Pinhole
    from synfog_usd.dataset.drop_light import Shade
    from synfog_usd.render.film.aovs import Aovs
    from synfog_usd.render.picture import Rendered
    from synfog_usd.render.shot import Settings
    from synfog_usd.scene import Camera, SceneDict
    from synfog_usd.scene.transmittance import PartBoxes


@dataclass(frozen=True)
class MeteredView:
    """A lighting in clear air: how it is exposed, for all fog levels alike, and what is there.

    Attributes:
        exposure: see `camera.meter`; None where the graph says it.
        pixel: what a pixel makes of light, see `camera.sensitivity`, or None.
        mean_cd_m2: mean luminance of the small frame that was metered; 0 where none was.
        visible: what the ray through each pixel's centre meets.
        world: of the scene that was looked at.
        parts: of that world, see `transmittance.boxes_of`.
        further: name of a further graph -> how it exposes, see `BakePlan.meter_for`.
        metered: of a frame of a clip, or None.
    """

    exposure: Exposure | None
    pixel: tuple[float, float] | None
    mean_cd_m2: float
    visible: Aovs
    world: Mapping[str, Any]
    parts: PartBoxes
    further: Mapping[str, Exposure]
    metered: Metered | None

    @property
    def noise(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """Luminance -> standard deviation of what a pixel reads [cd m-2]."""
        return sensor_noise(self.pixel) if self.pixel else None


def is_metered(graph: NodeGraph, plan: BakePlan) -> bool:
    """Whether a lighting is looked at in clear air, to find out how it is exposed."""
    from synfog_usd import camera

    return bool(camera.exposure_left_open(graph) or plan.exposes.meter_for or plan.exposes.is_said)


def clear_scenes(shot: Shot, session: Session, camera: str | None) -> dict[str | None, SceneDict]:
    """What is metered for a shot, without fog, by camera: what its own sees, and the others that are exposed alike."""
    plan = session.plan
    partners = [name for name in plan.rig if name != camera] if plan.exposes.meter == TOGETHER else []
    clear = cleared(session.stage, shot)
    return {name: session.without_fog(name, shot, clear) for name in (camera, *partners)}


def meter_view(
    lighting: str,
    clear: Mapping[str | None, SceneDict],
    session: Session,
    plan: BakePlan,
    ready: Callable[[], None],
) -> MeteredView:
    """Scenes without fog, the camera's own first, metered on small frames, or as a clip's frame was before; the graph
    runs after `ready`.
    """
    from synfog_usd import camera
    from synfog_usd.base import photometry
    from synfog_usd.render import models
    from synfog_usd.render.film import aovs
    from synfog_usd.scene import transmittance

    graph, scene = session.graph, next(iter(clear.values()))
    metered = plan.clip.metered.get(lighting) if plan.clip else None
    frame, *side_frames = (
        [unlit(scene.camera)] if metered else [session.frame(lighting, eye, seen) for eye, seen in clear.items()]
    )
    loaded = session.renderer.loaded_for(scene, models.AUTO)
    ready()
    exposure = None
    if metered:
        exposure = camera.Exposure(metered["exposure_s"], metered["iso"], metered["mean_cd_m2"], metered["limit"])
    elif camera.exposure_left_open(graph) or plan.exposes.is_said:
        exposure = camera.meter(frame, graph, side_frames=side_frames, compensation_ev=plan.exposes.ev)
        metered = metered_on(plan.clip.number, exposure) if plan.clip else None
    if exposure and plan.clip and (before := plan.clip.before.get(lighting)):
        exposure = camera.adapted(
            exposure, before, graph, elapsed_s=1.0 / plan.clip.per_s, constant_s=plan.clip.adaptation_s
        )
    fixed = {"exposure_s": plan.exposes.exposure_s, "iso": plan.exposes.iso}
    graphs = {path.stem: camera.exposed(camera.load_graph(path), **fixed) for path in plan.exposes.meter_for}
    further = {
        name: camera.meter(frame, other_graph, side_frames=side_frames, compensation_ev=plan.exposes.ev)
        for name, other_graph in graphs.items()
        if camera.exposure_left_open(other_graph)
    }
    pixel = camera.sensitivity(frame, graph, exposure) if exposure else None
    return MeteredView(
        exposure,
        pixel,
        float(photometry.luminance(frame).mean()),
        aovs.measure(loaded),
        scene.world,
        transmittance.boxes_of(scene.world),
        further,
        metered,
    )


def metered_on(frame: int, exposure: Exposure) -> Metered:
    """What was metered on a frame of a clip."""
    return Metered(
        frame=frame,
        exposure_s=exposure.exposure_s,
        iso=exposure.iso,
        mean_cd_m2=exposure.mean_cd_m2,
        limit=exposure.limit,
    )


def unlit(eye: Camera) -> Image:
    """A frame that tells of its camera alone."""
    from synfog_usd.render.picture import view_of

    return Image(np.zeros((1, 1, 3), dtype=np.float32), ("R", "G", "B"), Quantity.RADIANCE, provenance=view_of(eye))


@dataclass(frozen=True)
class RenderedShot:
    """A shot that is rendered.

    Attributes:
        shot, scene, view, pinhole, rendered: its subject, its exposure, what the sensor takes of it, and what
            came of it.
        noise: luminance -> standard deviation of what a pixel of it reads [cd m-2], or None.
        clear: label id -> transmittance of the fog before an instance.
        exposures: inputs of the graph that see a part of the exposure -> their radiance.
        shade: what is in the way of lamps that light near drops, or None.
    """

    shot: Shot
    scene: SceneDict
    view: MeteredView | None
    pinhole: Pinhole | None
    rendered: Rendered
    noise: Callable[[np.ndarray], np.ndarray] | None
    clear: Mapping[int, float]
    exposures: Mapping[str, Image]
    shade: Shade | None = None

    @property
    def mor_m(self) -> float | None:
        """Visibility [m] of the outermost fog; None in clear air, whatever plume is in it."""
        if self.shot.fog == CLEAR:
            return None
        return next((volume.medium.visibility_m for volume in self.scene.fog if volume.parent is None), None)


Picture = Callable[[Progress], RenderedShot]
"""Makes the picture of a shot that was sampled."""


def sample_shot(
    shot: Shot,
    scene: SceneDict,
    renderer: Renderer,
    view: MeteredView | None,
    plan: BakePlan,
    pinhole: Pinhole | None,
    exposures: Mapping[str, tuple[float, float]],
    progress: Progress,
) -> Picture:
    """Sample one shot, and once more for each part of its exposure that is asked for by itself where things move; what
    makes its pictures.
    """
    from synfog_usd.dataset.drop_light import shade_of
    from synfog_usd.render.media.medium import measured_depth
    from synfog_usd.render.shot import sample
    from synfog_usd.scene import transmittance

    density = density_of(scene, pinhole)
    floor = pixel_noise(view.noise, density) if view and view.noise else None
    looked_at = view if view and view.world is scene.world else None
    through = transmittance.of_instances(scene, looked_at.parts if looked_at else None, measured_depth)
    loaded = renderer.loaded_for(scene, plan.sampling.model)
    shade = shade_of(scene, loaded)
    moving = exposures if scene.camera.moves or scene.motion_of else {}
    kept = tuple(plan.clip.kept.get(shot.folder, ())) if plan.clip else ()
    settings = replace(settings_of(plan, floor, density, seed32(plan.paths, shot.lighting, shot.fog)), kept=kept)
    clear = looked_at.visible if looked_at and not loaded.boundaries and not scene.camera.width_m else None
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

    def picture(progress: Progress) -> RenderedShot:
        whole = rendered.picture(within(progress, 0.0, share))
        visible = {
            name: part.picture(within(progress, number * share, (number + 1) * share)).radiance
            for number, (name, part) in enumerate(parts.items(), 1)
        }
        visible = visible or dict.fromkeys(exposures, whole.radiance)
        return RenderedShot(shot, scene, view, pinhole, whole, floor, through, visible, shade)

    return picture


def density_of(scene: SceneDict, pinhole: Pinhole | None) -> float:
    """Rendered pixels side by side for one of the sensor."""
    return pinhole_of(scene.camera).focal_px / pinhole.focal_px if pinhole else 1.0


def settings_of(
    plan: BakePlan, floor: Callable[[np.ndarray], np.ndarray] | None, density: float, seed: int = 0
) -> Settings:
    """How a shot is rendered, whose pixels may have the noise `floor`."""
    from synfog_usd.render.sampling.adaptive import sensor_target
    from synfog_usd.render.shot import Settings

    sampling = plan.sampling
    assert sampling.samples is not None  # a plan that was made is whole
    quality, by_quality = sampling.promise, sampling.target_error is None
    error = quality.error if by_quality else sampling.target_error
    return Settings(
        model=sampling.model,
        samples=max(2, round(sampling.samples / density**2)),
        seed=seed,
        target_error=min(1.0, error * density) if error is not None else None,
        target_mottle=quality.mottle if by_quality else None,
        sensor_sigma=sensor_target(floor) if floor and by_quality and quality.sensor else None,
        bands=sampling.bands,
        denoise=quality.clean,
        draft=sampling.draft,
        regularize=quality.clean,
    )


def sensor_noise(pixel: tuple[float, float]) -> Callable[[np.ndarray], np.ndarray]:
    """Luminance -> standard deviation of what a pixel reads [cd m-2], by what `camera.sensitivity` gives."""
    from synfog_usd import camera

    return functools.partial(camera.noise_floor, electrons_per_cd_m2=pixel[0], dark_noise_e=pixel[1])


def pixel_noise(noise: Callable[[np.ndarray], np.ndarray], density: float) -> Callable[[np.ndarray], np.ndarray]:
    """Noise that a rendered pixel may have where density^2 of them are averaged for one of the sensor."""
    return lambda luminance: density * noise(luminance)

"""One shot: what a render is to be, and its samples; `picture` makes the picture of them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synfog_usd.base import numbers, system
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.render import backend, models, moments
from synfog_usd.render import denoise as denoising
from synfog_usd.render.film import aovs
from synfog_usd.render.film.accumulator import (
    AOVS,
    DIRECT,
    HALVES,
    INSCATTERED,
    INSCATTERED_OF_LAMPS,
    LAMPS,
    LIT,
    SHARE_PX,
    SURFACE,
    SURFACE_OF_LAMPS,
    WITH_FIREFLIES,
    Accumulator,
    Integrator,
    Traces,
)
from synfog_usd.render.integrators.eye import LENS_M
from synfog_usd.render.lights.rows import is_sampled_light
from synfog_usd.render.load import Earlier, MitsubaScene, seen_by, to_mitsuba
from synfog_usd.render.picture import About, Cleaning, Rendered, Sampled
from synfog_usd.render.sampling.adaptive import Target, accumulate_denoised, accumulate_to_target
from synfog_usd.scene import Camera, SceneDict

PROBE_PX = (64, 36)

DENOISING = 5.0
"""Samples of a pixel that take as long as to denoise it, about: 2 before lamps, 8 by day on the crossing."""

SEEN_FLOATS, CLEANING_FLOATS = 14, 36
"""What `Aovs`, and guides, luminances and the denoiser's own pictures take of a pixel, in units of 4 B."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a render is to be.

    Attributes:
        model: a name of `models.MODELS`, or 'auto'.
        samples: paths per pixel, 2 to 2^20; with a target, the most there may be on average.
        seed: the same gives the same bytes in the same variant.
        size: (width, height) in pixels instead of the camera's own.
        target_error: relative standard error of a pixel at which sampling stops, or None.
        target_mottle: clouds that may be left in a denoised picture, relative, see `dualbuffer.mottle`; or None.
        sensor_sigma: luminance -> standard error [cd m-2] at which it stops, see `sampling.adaptive.sensor_target`, or
            None.
        scatterings, bounces: limits of `path`: how often the fog, and how often surfaces, may scatter a
            path; None is no limit.
        bands: of wavelength that each path carries, see `spectra.bands.CENTRES_NM`; 3 are R, G and B.
        denoise: clean the components apart (see `denoise`), where the model tells them apart; the variance stays that
            of the samples. What cannot be denoised is given as it is, and a warning says so.
        draft: denoise for a look alone, see `denoise.denoise_draft`.
        kept: rounds of samples of the frame before, see `sampling.adaptive.accumulate_denoised`.
        regularize: blur mirrors before lamps where paths are spread, less the more samples there are, see
            `surface.blur`; without it `path` has no bias at any number of samples, and more rare bright ones.

    Raises:
        ParameterError: a model that is unknown, a number out of range, or settings that do not go together.
    """

    model: str = models.AUTO
    samples: int = 64
    seed: int = 0
    size: tuple[int, int] | None = None
    target_error: float | None = None
    target_mottle: float | None = None
    sensor_sigma: Callable[[np.ndarray], np.ndarray] | None = None
    scatterings: int | None = None
    bounces: int | None = None
    bands: int = numbers.RGB
    denoise: bool = False
    draft: bool = False
    kept: tuple[Mapping[str, int], ...] = ()
    regularize: bool = True

    def __post_init__(self) -> None:
        models.check_name(self.model)
        numbers.check_range("--samples", self.samples)
        numbers.check_range("--target-error", self.target_error)
        numbers.check_bands(self.bands)

    @property
    def target(self) -> Target:
        """What is good enough."""
        return Target(self.target_error, self.sensor_sigma, self.samples, self.target_mottle)


def picture_bytes(scene: SceneDict, settings: Settings) -> int:
    """Memory that a picture takes, beside its scene: what is kept of each pixel while it is sampled and made.

    Measured on the crossing at noon in clear air, 960x540 to 1920x1080: 0.37 kB a pixel, and 0.37 by this.
    """
    channels, foggy = settings.bands, bool(scene.fog)
    lamps = any(is_sampled_light(part) for part in scene.world.values())
    estimators = [SURFACE, *([INSCATTERED] if foggy else [])]
    estimators += ([LAMPS, INSCATTERED_OF_LAMPS] if foggy else []) * lamps
    estimators += [SURFACE_OF_LAMPS, DIRECT, LIT] * lamps
    parts = sum(len(AOVS[name]) for name in estimators)
    parts += sum(len(AOVS[name]) for name in estimators if settings.denoise and name in WITH_FIREFLIES)
    groups = len(set(scene.group_of.values()))
    groups = groups if groups > 1 else 0
    sums: float = HALVES * channels * parts + 3 * len(estimators)
    in_squares = len(estimators) - (DIRECT in estimators) if settings.denoise else 0
    lit = channels * groups * (len(estimators) - in_squares + in_squares / SHARE_PX**2)
    sums += channels * len(estimators) + lit
    picture = SEEN_FLOATS + channels * (1 + parts + groups)
    if settings.denoise:
        picture += CLEANING_FLOATS + 4 * HALVES * channels
    width, height = settings.size or (scene.camera.width_px, scene.camera.height_px)
    return round(4 * width * height * (sums + picture))


def check_memory(scene: SceneDict, settings: Settings) -> None:
    """Refuse a picture that this machine has not the memory for, before it dies of it.

    Raises:
        ParameterError: says how much it would take.
    """
    need, free = picture_bytes(scene, settings), system.free_memory()
    if 0 < free < need:
        width, height = settings.size or (scene.camera.width_px, scene.camera.height_px)
        raise ParameterError(
            f"{scene.camera.path or 'camera'}: a picture of {width} x {height} takes about {need / 1e9:.2g} GB beside "
            f"its scene, and {free / 1e9:.2g} GB are free; ask for fewer pixels (--resolution), or free some"
        )


def render(
    scene: SceneDict,
    settings: Settings | None = None,
    *,
    loaded: MitsubaScene | None = None,
    clear: aovs.Aovs | None = None,
    progress: Progress = silent,
    **changes: Any,
) -> Rendered:
    """Transport light through one scene.

    Args:
        scene: what `translate` made.
        settings: `Settings()` if left out.
        loaded: the scene as `load` gave it for this model and size, to render it again; None loads it.
        clear: what the pixel-centre rays meet in clear air, where that is known; None measures it.
        progress: told after each pass.
        changes: attributes of `settings` by name, as in `render(scene, model="path", samples=16)`.

    Raises:
        ParameterError: settings that do not go together, or a model that does not hold here.
        StageError: the renderer refuses a part of the scene.
    """
    settings = replace(settings or Settings(), **changes)
    share = sampling_share(settings)
    sampled = sample(scene, settings, loaded=loaded, clear=clear, progress=within(progress, 0.0, share))
    return sampled.picture(within(progress, share, 1.0))


def sampling_share(settings: Settings) -> float:
    """The part of the progress of a render that is sampling, about; the rest makes the picture."""
    return settings.samples / (settings.samples + DENOISING) if settings.denoise else 1.0


def sample(
    scene: SceneDict,
    settings: Settings | None = None,
    *,
    loaded: MitsubaScene | None = None,
    clear: aovs.Aovs | None = None,
    progress: Progress = silent,
    **changes: Any,
) -> Sampled:
    """The part of `render` that asks the renderer; arguments as there."""
    settings = replace(settings or Settings(), **changes)
    check_memory(scene, settings)
    warnings = list[str]()
    if settings.denoise and (problem := denoising.available()):
        warnings.append(f"not denoised, so it takes many more samples: {problem}")
        settings = replace(settings, denoise=False)
    model, why = models.choose(settings.model, scene)
    if loaded is None:
        boundaries, spectra = models.MODELS[model].boundaries, settings.bands != numbers.RGB
        loaded = load(scene, size=settings.size, boundaries=boundaries, spectra=spectra)
    make = functools.partial(
        models.make,
        model,
        scatterings=settings.scatterings,
        bounces=settings.bounces,
        bands=settings.bands,
        regularize=settings.regularize,
    )
    parts = moments.cut(loaded.source, settings.samples)
    if parts:
        why += f"; {len(parts.parts)} moments of the exposure, {parts.samples} samples in each"
        warnings += parts.warnings()
    integrator = make(loaded)
    if parts:
        accumulated, cleaning = _moving(loaded, parts, make, settings, progress)
    else:
        accumulated, cleaning = _still(loaded, integrator, settings, progress)
    names = integrator.group_names if isinstance(integrator, Traces) else ()
    backend.let_go()
    if cleaning:
        cleaning.see(accumulated)
    centres = aovs.measure(loaded) if clear is None else aovs.seen_through(loaded, clear)
    backend.let_go()
    about = About(model, settings.seed, settings.samples, settings.bands, loaded.source.camera, settings.target)
    return Sampled(about, accumulated, cleaning, centres, names if len(names) > 1 else (), why, warnings)


def _moving(
    loaded: MitsubaScene,
    parts: moments.Intervals,
    make: Callable[..., Integrator],
    settings: Settings,
    progress: Progress,
) -> tuple[Accumulator, Cleaning | None]:
    """Samples of an exposure in which something moves, and what cleans them."""
    rays = _guide_rays(loaded.source.camera) if settings.denoise else 0
    movables = moments.Movables(loaded)
    accumulated, guides = moments.accumulate(movables, parts, make, seed=settings.seed, rays=rays, progress=progress)
    return accumulated, Cleaning(lambda: guides, draft=settings.draft) if settings.denoise else None


def _still(
    loaded: MitsubaScene, integrator: Integrator, settings: Settings, progress: Progress
) -> tuple[Accumulator, Cleaning | None]:
    """Samples of what stands still, and what cleans them."""
    seed, target = settings.seed, settings.target
    if not settings.denoise:
        return accumulate_to_target(integrator, target=target, seed=seed, progress=progress), None
    rays = _guide_rays(loaded.source.camera)
    if isinstance(integrator, Traces):  # the processor looks while the first kernel of the samples is made ready
        look = denoising.GuideRays(loaded, rays=rays).guides
    else:
        look = functools.partial(denoising.guides, loaded, rays=rays)
    cleaning = Cleaning(look, draft=settings.draft)
    accumulated = accumulate_denoised(
        integrator,
        target=target,
        seed=seed,
        denoised=cleaning.judged,
        kept=settings.kept,
        opacity=cleaning.opacity if _in_squares(loaded.source, settings) else None,
        progress=progress,
    )
    return accumulated, cleaning


def _in_squares(scene: SceneDict, settings: Settings) -> bool:
    """Whether airlight is sampled by squares of pixels: in even fog, where the eye is the judge."""
    even = all(volume.medium.grid is None for volume in scene.fog)
    return bool(scene.fog) and even and settings.target_mottle is not None and settings.sensor_sigma is None


def _guide_rays(camera: Camera) -> int:
    """Rays of a pixel for the guides of a camera's picture: the more pixels, the fewer."""
    return int(np.clip(denoising.PICTURE_RAYS // (camera.width_px * camera.height_px), *denoising.GUIDE_RAYS))


def load(
    scene: SceneDict,
    *,
    size: tuple[int, int] | None = None,
    boundaries: bool = True,
    spectra: bool = True,
    known: Earlier | None = None,
) -> MitsubaScene:
    """The scene in Mitsuba, with the near plane moved to the lens where it hides nothing; without `spectra` of
    materials, which R, G and B never ask for, more of these are drawn together.

    Mitsuba starts a camera ray at the near plane and forgets the fog before it;
    0.1 m of MOR 150 are 0.2 %.  An authored near plane is kept only where something
    stands before it (a camera inside a car body).
    """
    scene = scene if spectra else replace(scene, reflectance_of={})
    loaded = to_mitsuba(replace(scene, camera=_close(scene.camera)), size=size, boundaries=boundaries, known=known)
    return _clipped(loaded, scene.camera.near_m)


def look(loaded: MitsubaScene, camera: Camera) -> MitsubaScene:
    """A scene that `load` gave, without boundaries, from another camera of its rig."""
    return _clipped(seen_by(loaded, _close(camera)), camera.near_m)


def _close(camera: Camera) -> Camera:
    """The camera with its near plane at the lens."""
    return replace(camera, near_m=min(camera.near_m, LENS_M))


def _clipped(loaded: MitsubaScene, near_m: float) -> MitsubaScene:
    """A scene from a camera whose near plane is at the lens, with the authored one where something stands before it."""
    camera = loaded.source.camera
    if near_m <= camera.near_m:
        return loaded
    probe = replace(
        loaded, source=replace(loaded.source, camera=replace(camera, width_px=PROBE_PX[0], height_px=PROBE_PX[1]))
    )
    centres = aovs.measure(probe)
    if not np.any((centres.distance_m if camera.fisheye else centres.depth_m) < near_m):
        return loaded
    return seen_by(loaded, replace(camera, near_m=near_m))

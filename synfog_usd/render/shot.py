"""One shot: radiance with its variance, and the AOVs that need no samples."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synfog_usd.base import numbers, system
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.render import backend, dualbuffer, models, moments
from synfog_usd.render import denoise as denoising
from synfog_usd.render.film import aovs
from synfog_usd.render.film.accumulator import (
    AOVS,
    COMPONENTS,
    DIRECT,
    HALVES,
    INSCATTERED,
    LAMPS,
    LIT,
    SHARE_PX,
    SURFACE,
    Accumulator,
    Squares,
)
from synfog_usd.render.integrators.eye import LENS_M
from synfog_usd.render.integrators.path import FogPath
from synfog_usd.render.lights.rows import is_sampled_light
from synfog_usd.render.load import MitsubaScene, seen_by, to_mitsuba
from synfog_usd.render.sampling.adaptive import Target, accumulate_denoised, accumulate_to_target, reached
from synfog_usd.render.spectra import bands as banding
from synfog_usd.scene import Camera, SceneDict

PROBE_PX = (64, 36)

LARGE_ERROR = 0.25
"""Error of the median pixel after denoising from which on a warning is given."""


DENOISING = 5.0
"""Samples of a pixel that take as long as to denoise it, about: 2 before lamps, 8 by day on the crossing."""

SEEN_FLOATS, CLEANING_FLOATS = 14, 36
"""What `Aovs`, and guides, luminances and the denoiser's own pictures take of a pixel, in units of 4 B."""


@dataclass(frozen=True)
class Rendered:
    """What one shot gives.

    Attributes:
        radiance: (H, W, C) with the variance of its mean; linear Rec.709 in cd m-2, or bands in W m-2 sr-1 nm-1.
        aovs: what the pixel-centre rays met.
        components: 'surface', 'airlight_single', 'airlight_multiple', and 'lamps_direct' where lamps are seen -> (H, W,
            C) float32 radiance, which add up to all of it and may be below 0 by noise, but where they were denoised;
            empty where the model tells none apart.
        error: (H, W) expected RMS error of each pixel's luminance [cd m-2] after denoising; None where nothing was
            denoised, and of a draft.
        groups: light group -> (H, W, C) float32 radiance; empty where there is only one. They add up to the radiance
            where that was denoised.
        model, why: which model it was, and why that one.
        mottle: what is left of clouds in a denoised picture, relative, see `dualbuffer.mottle`; None where nothing was
            denoised, and of a draft.
        relative_error: median over the pixels of `error`, or else of the standard error of the samples, over luminance.
        warnings: what went wrong on the way, in words.
        samples: paths per pixel on average, as `Settings` means them.
        met: share of the pixels whose `error`, or else standard error, is under the target; None where there was no
            target.
    """

    radiance: Image
    aovs: aovs.Aovs
    relative_error: float
    mottle: float | None
    components: Mapping[str, np.ndarray]
    error: np.ndarray | None
    groups: Mapping[str, np.ndarray]
    model: str
    why: str
    warnings: tuple[str, ...]
    samples: float
    met: float | None


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a render is to be.

    Attributes:
        model: a name of `models.MODELS`, or 'auto'.
        samples: paths per pixel, 2 to 1 048 576; with a target, the most there may be on average.
        seed: the same gives the same bytes in the same variant.
        size: (width, height) in pixels instead of the camera's own.
        target_error: relative standard error of a pixel at which sampling stops, or None.
        target_mottle: clouds that may be left in a denoised picture, relative, see `dualbuffer.mottle`; or None.
        sensor_sigma: luminance -> standard error [cd m-2] at which it stops, see `sampling.adaptive.sensor_target`, or
            None.
        scatterings, bounces: limits of `path`: how often the fog, and how often surfaces, may scatter a
            path; None is no limit.
        bands: light that each path carries: 3 for R, G and B, or 8, 16 or 31 wavelength bands.
        denoise: clean the components apart (see `denoise`), where the model tells them apart; the variance stays that
            of the samples. What cannot be denoised is given as it is, and a warning says so.
        draft: denoise for a look alone, see `denoise.denoise_draft`.
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
    regularize: bool = True

    def __post_init__(self) -> None:
        models.check_name(self.model)
        numbers.check_samples(self.samples)
        numbers.check_target(self.target_error)
        numbers.check_bands(self.bands)

    @property
    def target(self) -> Target:
        """What is good enough."""
        return Target(self.target_error, self.sensor_sigma, self.samples, self.target_mottle)


def picture_bytes(scene: SceneDict, settings: Settings) -> int:
    """Memory that a picture takes, beside its scene: what is kept of each pixel while it is sampled and made.

    Measured on the crossing at noon, from 960x540 to 1920x1080: 0.37 kB a pixel, and 0.36 by this; at dusk at MOR 150,
    less what light groups take since: 0.52 and 0.62; `LIT` adds 0.06 to both.
    """
    channels, foggy = settings.bands, bool(scene.fog)
    lamps = any(is_sampled_light(part) for part in scene.world.values())
    estimators = [SURFACE, *([INSCATTERED] if foggy else [])]
    estimators += ([LAMPS, DIRECT, LIT] if foggy else [DIRECT, LIT]) * lamps
    parts, groups = sum(len(AOVS[name]) for name in estimators), len(set(scene.group_of.values()))
    groups = groups if groups > 1 else 0
    kept = HALVES * channels * parts + 3 * len(estimators)
    in_squares = len(estimators) - (DIRECT in estimators) if settings.denoise else 0
    lit = channels * groups * (len(estimators) - in_squares + in_squares / SHARE_PX**2)
    sampled = kept + channels * len(estimators) + lit
    made = kept + SEEN_FLOATS + channels * (1 + parts + groups) + lit
    if settings.denoise:
        made += CLEANING_FLOATS + 4 * HALVES * channels
    width, height = settings.size or (scene.camera.width_px, scene.camera.height_px)
    return round(4 * width * height * max(sampled, made))


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
        settings: what it is to be; `Settings()` if left out.
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


@dataclass(frozen=True)
class Sampled:
    """A picture that was sampled and is not made yet.

    Attributes:
        samples: paths of a pixel, see `Rendered`.
        picture: makes it, once, and is told about on the way; it holds nothing of the renderer, so that another thread
            may do it while the next scene is sampled.
    """

    samples: float
    picture: Callable[[Progress], Rendered]


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
    model, samples, seed, size, bands, denoise = (
        settings.model,
        settings.samples,
        settings.seed,
        settings.size,
        settings.bands,
        settings.denoise,
    )
    check_memory(scene, settings)
    target = settings.target
    warnings = list[str]()
    if denoise and (problem := denoising.available()):
        warnings.append(f"not denoised, so it takes many more samples: {problem}")
        denoise = False
    model, why = models.choose(model, scene)
    loaded = loaded or load(scene, size=size, boundaries=models.MODELS[model].boundaries, spectra=bands != numbers.RGB)
    make = functools.partial(
        models.make,
        model,
        scatterings=settings.scatterings,
        bounces=settings.bounces,
        bands=bands,
        regularize=settings.regularize,
    )
    integrator = make(loaded)
    camera = loaded.source.camera
    shape = (camera.height_px, camera.width_px, -1)

    cleaning: _Cleaning | None = None
    if parts := moments.cut(loaded.source, samples):
        why += f"; {len(parts.parts)} moments of the exposure, {parts.samples} samples in each"
        warnings += [said] if (said := parts.said()) else []
        movables = moments.Movables(loaded)
        rays = _guide_rays(samples) if denoise else 0
        accumulated, known = moments.accumulate(movables, parts, make, seed=seed, rays=rays, progress=progress)
        if denoise:
            cleaning = _Cleaning(lambda: known, shape[:2], few=samples < denoising.FEW, draft=settings.draft)
    elif denoise:
        rays = _guide_rays(samples)
        if isinstance(integrator, FogPath):  # the processor looks while the first kernel of the samples is made ready
            look = denoising.begun_guides(loaded, rays=rays)
        else:
            look = functools.partial(denoising.guides, loaded, rays=rays)
        cleaning = _Cleaning(look, shape[:2], few=samples < denoising.FEW, draft=settings.draft)
        accumulated = accumulate_denoised(
            integrator, target=target, seed=seed, denoised=cleaning.judged, progress=progress
        )
    else:
        accumulated = accumulate_to_target(integrator, target=target, seed=seed, progress=progress)
    names = tuple(getattr(integrator, "group_names", ()))
    names = names if len(names) > 1 else ()
    shares = list[tuple[str, dict[str, np.ndarray]]]()
    if cleaning and accumulated.component_halves(*shape[:2]):
        cut = Squares(camera.width_px, camera.height_px)
        for name in names:
            lights = accumulated.take_group(cut)
            for of, light in lights.items():
                lights[of] = light.reshape(*(shape[:2] if of == DIRECT else cut.shape), -1)
            shares.append((name, lights))
    backend.let_go()
    if cleaning:
        cleaning.see(accumulated)
    seen = aovs.measure(loaded) if clear is None else aovs.seen_through(loaded, clear)
    number, spent = accumulated.samples, accumulated.samples_per_pixel
    backend.let_go()

    def picture(progress: Progress = silent) -> Rendered:
        nonlocal why
        spread = accumulated.variance()
        noise = np.asarray(spread @ accumulated.weights * accumulated.weights.sum())  # of its luminance
        variance = spread.reshape(shape).astype(np.float32, copy=False)
        del spread
        for estimator in accumulated.estimators.values():  # a large frame fills memory: a sum is let go once it is read
            estimator.squares = np.zeros((0, 0), dtype=estimator.squares.dtype)
        denoised = None
        if cleaning:
            denoised, problem = cleaning.picture(accumulated, number, progress), cleaning.problem
            warnings.extend([problem] if problem else [])
            why += "" if denoised or problem else "; not denoised, since it tells no components apart"
        rms = denoised.error.rms if denoised and denoised.error else None
        if denoised and rms is not None:
            luminance, error = denoised.luminance(accumulated.weights).ravel(), rms.ravel()
            met = None if target.open else float((error <= target.allowed_in_all(luminance)).mean())
        else:
            luminance, error = accumulated.luminance(), np.sqrt(noise)
            met = None if target.open or denoised else reached(luminance, noise, target, shape[:2])
        lit = luminance > 0.0
        relative_error = float(np.median(error[lit] / luminance[lit])) if lit.any() else 0.0
        if rms is not None and relative_error > LARGE_ERROR:
            much = f"{relative_error:.0%}" if relative_error < 1.0 else "more than its own light"
            warnings.append(f"after denoising the median pixel still errs by {much}; more samples mend it")
        del luminance, error, noise
        if accumulated.lost:
            warnings.append(f"{accumulated.lost} of {number} samples were not finite and count as black")
        if denoised:
            components = dict(denoised.components)
            mean = np.asarray(sum(components.values()))
            for estimator in accumulated.estimators.values():
                estimator.aovs.clear()
        else:
            mean = accumulated.mean().reshape(shape).astype(np.float32)
            components = {
                name: aov.reshape(shape).astype(np.float32)
                for name in COMPONENTS
                if (aov := accumulated.take_aov(name)) is not None
            }
        if mean.min() < 0.0:
            below = int((mean < 0.0).any(axis=2).sum())
            warnings.append(
                f"{below} pixels came out below 0, noise of a difference, and count as black; more samples mend it"
            )
            mean = np.maximum(mean, 0.0)
        radiance = Image(
            mean,
            banding.names(bands),
            Quantity.RADIANCE,
            variance=variance,
            provenance={
                **(
                    {"fisheye_coefficients": list(camera.fisheye.coefficients), "fisheye_fov_x_deg": camera.fov_x_deg}
                    if camera.fisheye
                    else {"fov_x_deg": camera.fov_x_deg}
                ),
                "shift_x": camera.axis_shift[0],
                "shift_y": camera.axis_shift[1],
                "model": model,
                "samples": samples,
                "seed": seed,
            }
            | ({"denoised": True} if denoised else {}),
        )
        groups = dict[str, np.ndarray]()
        if shares:
            divided = cleaning.divided(denoised, shares) if cleaning and denoised else None
            if cleaning and denoised and divided is None:
                warnings.append(f"light groups are {cleaning.problem}")
            groups = divided or {name: denoising.fine(lights, mean.shape) for name, lights in shares}
        else:
            for name in names:
                groups[name] = sum(accumulated.take_group().values()).reshape(shape).astype(np.float32)
        return Rendered(
            radiance,
            seen,
            relative_error,
            denoised.error.mottle if denoised and denoised.error else None,
            components,
            rms,
            groups,
            model,
            why,
            tuple(warnings),
            spent,
            met,
        )

    return Sampled(spent, picture)


def _not_denoised(error: Exception) -> str:
    return f"not denoised, so it takes many more samples: {str(error) or 'not enough memory'}"


def _guide_rays(samples: int) -> int:
    """Rays of a pixel for the guides of a picture of so many samples."""
    return denoising.FEW_RAYS if samples < denoising.FEW else denoising.GUIDE_RAYS


class _Cleaning:
    """Makes pictures without noise of samples.

    Args:
        look: gives the guides.
        shape: (H, W).
        few: whether there are but few samples of a pixel.
        draft: whether it is for a look alone.

    Attributes:
        problem: what went wrong with the last one, or ''.
    """

    def __init__(
        self, look: Callable[[], denoising.Guides | None], shape: tuple[int, int], *, few: bool, draft: bool
    ) -> None:
        self.problem = ""
        self._look: Callable[[], denoising.Guides | None] | None = look
        self._shape, self._few, self._draft = shape, few, draft
        self._guides: denoising.Guides | None = None
        self._done: dict[int, denoising.Denoised | None] = {}  # by the number of samples, the last one only

    def picture(self, accumulated: Accumulator, number: int, progress: Progress = silent) -> denoising.Denoised | None:
        """Of so many samples; None where no components are told apart, or something goes wrong."""
        if number not in self._done and (halves := accumulated.component_halves(*self._shape)):
            self._done.clear()
            self.problem = ""
            try:
                progress("denoising", 0.0)
                clean = functools.partial(denoising.denoise_halves, quick=self._few)
                self._done[number] = (denoising.denoise_draft if self._draft else clean)(
                    halves, self._seen(), accumulated.weights, progress=within(progress, 0.3, 1.0)
                )
            except (denoising.DenoiserError, MemoryError) as error:
                self._done[number] = None
                self.problem = _not_denoised(error)
        return self._done.get(number)

    def divided(
        self, denoised: denoising.Denoised, groups: Iterable[tuple[str, Mapping[str, np.ndarray]]]
    ) -> dict[str, np.ndarray] | None:
        """The picture by light group, see `denoise.divide`; None where something goes wrong."""
        try:
            return denoising.divide(denoised.components, groups, self._seen(), quick=self._few, draft=self._draft)
        except (denoising.DenoiserError, MemoryError) as error:
            self.problem = _not_denoised(error)
            return None

    def judged(self, accumulated: Accumulator) -> tuple[np.ndarray, dualbuffer.Error] | None:
        """What the samples so far give."""
        found = self.picture(accumulated, accumulated.samples)
        if found is None or found.error is None:
            return None
        return found.luminance(accumulated.weights), found.error

    def see(self, accumulated: Accumulator) -> None:
        """Look at the scene, where pictures will be made of these samples, and let it go."""
        if accumulated.component_halves(*self._shape):
            with contextlib.suppress(MemoryError):  # told when the picture is made
                self._seen()
        self._look = None

    def _seen(self) -> denoising.Guides:
        if self._guides is None and self._look is not None:
            self._guides = self._look()
        if self._guides is None:
            raise MemoryError
        return self._guides


def load(
    scene: SceneDict, *, size: tuple[int, int] | None = None, boundaries: bool = True, spectra: bool = True
) -> MitsubaScene:
    """The scene in Mitsuba, with the near plane moved to the lens where it hides nothing; without `spectra` of
    materials, which R, G and B never ask for, more of these are drawn together.

    Mitsuba starts a camera ray at the near plane and forgets the fog before it;
    0.1 m of MOR 150 are 0.2 %.  An authored near plane is kept only where something
    stands before it (a camera inside a car body).
    """
    scene = scene if spectra else replace(scene, reflectance_of={})
    loaded = to_mitsuba(replace(scene, camera=_close(scene.camera)), size=size, boundaries=boundaries)
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
    seen = aovs.measure(probe)
    if not np.any((seen.distance_m if camera.fisheye else seen.depth_m) < near_m):
        return loaded
    return seen_by(loaded, replace(camera, near_m=near_m))

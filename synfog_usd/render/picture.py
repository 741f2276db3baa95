"""The picture of a shot that was sampled: denoised, with what error is left, its components and its light groups.

Takes the sums of the samples; gives `Rendered`.  Asks nothing of the renderer, so that a thread of its own may do it.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Pixels, total
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.render import denoise as denoising
from synfog_usd.render import dualbuffer
from synfog_usd.render.film.accumulator import COMPONENTS, Accumulator
from synfog_usd.render.film.aovs import Aovs
from synfog_usd.render.sampling.adaptive import Target, reached
from synfog_usd.render.spectra import bands as banding
from synfog_usd.scene import Camera

LARGE_ERROR = 0.25
"""Error of the median pixel after denoising from which on a warning is given."""


@dataclass(frozen=True)
class Rendered:
    """What one shot gives.

    Attributes:
        radiance: (H, W, C) with the variance of its mean, in cd m-2; of bands in W m-2 sr-1 nm-1.
        aovs: what the pixel-centre rays met.
        components: name -> (H, W, C) float32 radiance, of 'surface', 'airlight_single', 'airlight_multiple', and of
            'lamps_direct' where lamps are seen.  They add up to the radiance.  Noise takes them below 0 where they
            were not denoised.  Empty where the model separates none.
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
        under_target: share of the pixels whose `error`, or else standard error, is under the target; None without
            one.
        rounds: see `Accumulator`.
    """

    radiance: Image
    aovs: Aovs
    relative_error: float
    mottle: float | None
    components: Mapping[str, Pixels]
    error: Pixels | None
    groups: Mapping[str, Pixels]
    model: str
    why: str
    warnings: tuple[str, ...]
    samples: float
    under_target: float | None
    rounds: tuple[Mapping[str, int], ...] = ()


@dataclass(frozen=True)
class About:
    """How a picture was sampled.

    Attributes:
        model: its name.
        seed, samples, bands, target: see `shot.Settings`.
        camera: of the scene, in pixels of the picture.
    """

    model: str
    seed: int
    samples: int
    bands: int
    camera: Camera
    target: Target

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.camera.height_px, self.camera.width_px

    def provenance(self) -> dict[str, Any]:
        """What a file of the picture says of it."""
        return {**view_of(self.camera), "model": self.model, "samples": self.samples, "seed": self.seed}


def view_of(camera: Camera) -> dict[str, Any]:
    """What a picture's provenance says of its camera."""
    view: dict[str, Any] = {"fov_x_deg": camera.fov_x_deg}
    if camera.fisheye:
        view = {"fisheye_coefficients": list(camera.fisheye.coefficients), "fisheye_fov_x_deg": camera.fov_x_deg}
    shift_x, shift_y = camera.axis_shift
    return {**view, "shift_x": shift_x, "shift_y": shift_y}


@dataclass(frozen=True)
class Sampled:
    """A picture that was sampled and is not made yet; it holds nothing of the renderer.

    Attributes:
        about: how it was sampled.
        accumulated: its sums.
        cleaning: what denoises it, or None.
        centres: what the pixel-centre rays met.
        group_names: light groups, where there are several.
        why: why the model was taken.
        warnings: what went wrong on the way.
    """

    about: About
    accumulated: Accumulator
    cleaning: Cleaning | None
    centres: Aovs
    group_names: Sequence[str]
    why: str
    warnings: Sequence[str]

    def picture(self, progress: Progress = silent) -> Rendered:
        """Make it."""
        accumulated, why, warnings = self.accumulated, self.why, list(self.warnings)
        denoised = self.cleaning.picture(accumulated, progress) if self.cleaning else None
        if self.cleaning and self.cleaning.problem:
            warnings.append(self.cleaning.problem)
        elif self.cleaning and denoised is None:
            why += "; not denoised, since it tells no components apart"
        error = denoised.error if denoised else None
        variance, weights = accumulated.variance(), accumulated.weights
        relative_error, under_target = self._error(denoised, variance @ weights * weights.sum())
        if error and relative_error > LARGE_ERROR:
            much = f"{relative_error:.0%}" if relative_error < 1.0 else "more than its own light"
            warnings.append(f"after denoising the median pixel still errs by {much}; more samples mend it")
        if accumulated.lost:
            warnings.append(f"{accumulated.lost} of {accumulated.samples} samples were not finite and count as black")
        mean, components = self._light(denoised)
        if mean.min() < 0.0:
            below = int((mean < 0.0).any(axis=2).sum())
            warnings.append(
                f"{below} pixels came out below 0, noise of a difference, and count as black; more samples mend it"
            )
            mean = np.maximum(mean, 0.0)
        groups = self._divided(denoised, warnings) or {
            name: self._picture_of(accumulated.group(index)) for index, name in enumerate(self.group_names)
        }
        radiance = Image(
            mean,
            banding.names(self.about.bands),
            Quantity.RADIANCE,
            variance=self._picture_of(variance),
            provenance=self.about.provenance() | ({"denoised": True} if denoised else {}),
        )
        return Rendered(
            radiance=radiance,
            aovs=self.centres,
            relative_error=relative_error,
            mottle=error.mottle if error else None,
            components=components,
            error=error.rms if error else None,
            groups=groups,
            model=self.about.model,
            why=why,
            warnings=tuple(warnings),
            samples=accumulated.samples_per_pixel,
            under_target=under_target,
            rounds=tuple(accumulated.rounds),
        )

    def _error(self, denoised: denoising.Denoised | None, noise: Pixels) -> tuple[float, float | None]:
        """The median pixel's relative error, and the share of pixels under the target; for (P,) variances."""
        target, share = self.about.target, None
        if denoised and denoised.error:
            luminance, error = denoised.luminance(self.accumulated.weights).ravel(), denoised.error.rms.ravel()
            if not target.open:
                share = float((error <= target.allowed_in_all(luminance)).mean())
        else:
            luminance, error = self.accumulated.luminance(), np.sqrt(noise)
            if not target.open and denoised is None:
                share = reached(luminance, noise, target, self.about.shape)
        lit = luminance > 0.0
        return float(np.median(error[lit] / luminance[lit])) if lit.any() else 0.0, share

    def _light(self, denoised: denoising.Denoised | None) -> tuple[Pixels, dict[str, Pixels]]:
        """(H, W, C) of the picture, and of its components."""
        if denoised:
            return total(denoised.components.values()), dict(denoised.components)
        means = {name: self.accumulated.aov(name) for name in COMPONENTS}
        components = {name: self._picture_of(mean) for name, mean in means.items() if mean is not None}
        return self._picture_of(self.accumulated.mean()), components

    def _divided(self, denoised: denoising.Denoised | None, warnings: list[str]) -> dict[str, Pixels]:
        """The light groups where halves are kept apart to be denoised; none elsewhere."""
        if self.cleaning is None or not self.accumulated.component_names:
            return {}
        if denoised and (divided := self.cleaning.divided(denoised, self._shares())) is not None:
            return divided
        if denoised:
            warnings.append(f"light groups are {self.cleaning.problem}")
        return {name: denoising.fine(lights, self.about.shape) for name, lights in self._shares()}

    def _shares(self) -> Iterator[tuple[str, dict[str, Pixels]]]:
        """Each light group's part of each component in squares, as `denoise.divide` takes it, one after the other."""
        return ((name, self.accumulated.group_in_squares(index)) for index, name in enumerate(self.group_names))

    def _picture_of(self, pixels: Pixels) -> Pixels:
        return pixels.reshape(*self.about.shape, -1).astype(np.float32, copy=False)


class Cleaning:
    """Makes pictures without noise of samples.

    Args:
        look: gives the guides.
        draft: whether it is for a look alone.

    Attributes:
        problem: what went wrong with the last one, or ''.
    """

    def __init__(self, look: Callable[[], denoising.Guides | None], *, draft: bool) -> None:
        self.problem = ""
        self._look: Callable[[], denoising.Guides | None] | None = look
        self._draft = draft
        self._guides: denoising.Guides | None = None
        self._done: dict[int, denoising.Denoised | None] = {}  # by the number of samples, the last one only

    def picture(self, accumulated: Accumulator, progress: Progress = silent) -> denoising.Denoised | None:
        """Of the samples so far; None where the model separates no components, or something goes wrong."""
        number, names = accumulated.samples, accumulated.component_names
        if number not in self._done and names:
            self._done.clear()
            self.problem = ""
            try:
                progress("denoising", 0.0)
                quick = accumulated.samples_per_pixel < denoising.FEW
                clean = functools.partial(denoising.denoise_halves, quick=quick)
                halves = {name: functools.partial(accumulated.halves, name) for name in names}
                done = (denoising.denoise_draft if self._draft else clean)(
                    halves, self._guides_of_scene(), accumulated.weights, progress=within(progress, 0.3, 1.0)
                )
                self._done[number] = _with_mottle(done, accumulated)
            except (denoising.DenoiserError, MemoryError) as error:
                self._done[number] = None
                self.problem = _not_denoised(error)
        return self._done.get(number)

    def divided(
        self, denoised: denoising.Denoised, groups: Iterable[tuple[str, Mapping[str, Pixels]]]
    ) -> dict[str, Pixels] | None:
        """The picture by light group, see `denoise.divide`; None where something goes wrong."""
        try:
            return denoising.divide(denoised, groups, self._guides_of_scene(), draft=self._draft)
        except (denoising.DenoiserError, MemoryError) as error:
            self.problem = _not_denoised(error)
            return None

    def judged(self, accumulated: Accumulator) -> tuple[Pixels, dualbuffer.Error] | None:
        """What the samples so far give."""
        denoised = self.picture(accumulated)
        if denoised is None or denoised.error is None:
            return None
        return denoised.luminance(accumulated.weights), denoised.error

    def opacity(self) -> Pixels:
        """(P,) of the fog before what each pixel shows, for paths in squares."""
        self._guides = replace(self._guides_of_scene(), in_squares=True)
        return 1.0 - self._guides.transmittance.ravel()

    def see(self, accumulated: Accumulator) -> None:
        """Look at the scene, where pictures will be made of these samples, and let it go."""
        if accumulated.component_names:
            with contextlib.suppress(MemoryError):  # `picture` says it
                self._guides_of_scene()
        self._look = None

    def _guides_of_scene(self) -> denoising.Guides:
        if self._guides is None and self._look is not None:
            self._guides = self._look()
        if self._guides is None:
            raise MemoryError
        return self._guides


def _with_mottle(denoised: denoising.Denoised, accumulated: Accumulator) -> denoising.Denoised:
    """A picture whose mottle is judged by the noise of its samples as well as by its halves."""
    if denoised.error is None:
        return denoised
    noise = dualbuffer.mottle_of_noise(accumulated.luminance().reshape(accumulated.shape), *accumulated.noise())
    mottle = dualbuffer.joined_mottle(denoised.error.mottle, noise)
    return replace(denoised, error=replace(denoised.error, mottle=mottle))


def _not_denoised(error: Exception) -> str:
    return f"not denoised, so it takes many more samples: {str(error) or 'not enough memory'}"

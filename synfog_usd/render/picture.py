"""The picture of a shot that was sampled: denoised, with what error is left, its components and its light groups.

Takes the sums of the samples; gives `Rendered`.  Asks nothing of the renderer, so that a thread of its own may do it.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.image import Image, Quantity
from synfog_usd.base.progress import Progress, silent, within
from synfog_usd.render import denoise as denoising
from synfog_usd.render import dualbuffer
from synfog_usd.render.film import aovs
from synfog_usd.render.film.accumulator import COMPONENTS, Accumulator
from synfog_usd.render.sampling.adaptive import Target, reached
from synfog_usd.render.spectra import bands as banding
from synfog_usd.scene import Camera

LARGE_ERROR = 0.25
"""Error of the median pixel after denoising from which on a warning is given."""


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
        camera = self.camera
        view: dict[str, Any] = {"fov_x_deg": camera.fov_x_deg}
        if camera.fisheye:
            view = {"fisheye_coefficients": list(camera.fisheye.coefficients), "fisheye_fov_x_deg": camera.fov_x_deg}
        shift_x, shift_y = camera.axis_shift
        made = {"model": self.model, "samples": self.samples, "seed": self.seed}
        return {**view, "shift_x": shift_x, "shift_y": shift_y, **made}


class Sampled:
    """A picture that was sampled and is not made yet; it holds nothing of the renderer.

    Args:
        about: how it was sampled.
        accumulated: its sums.
        cleaning: what denoises it, or None.
        seen: what the pixel-centre rays met.
        names: light groups, where there are several.
        shares: their parts of the components, where it is denoised, see `denoise.divide`.
        why: why the model was taken.
        warnings: what went wrong on the way.

    Attributes:
        samples: paths of a pixel, see `Rendered`.
    """

    def __init__(
        self,
        about: About,
        accumulated: Accumulator,
        cleaning: Cleaning | None,
        seen: aovs.Aovs,
        names: Sequence[str],
        shares: Sequence[tuple[str, Mapping[str, np.ndarray]]],
        why: str,
        warnings: list[str],
    ) -> None:
        self._about, self._accumulated, self._cleaning, self._seen = about, accumulated, cleaning, seen
        self._names, self._shares, self._why, self._warnings = names, shares, why, warnings
        self.samples = accumulated.samples_per_pixel

    def picture(self, progress: Progress = silent) -> Rendered:
        """Make it, once: a large frame fills memory, so that each sum is let go once it is read."""
        variance, noise = self._variance()
        denoised = self._denoised(progress)
        rms = denoised.error.rms if denoised and denoised.error else None
        relative_error, met = self._error(denoised, noise)
        del noise
        if self._accumulated.lost:
            lost, number = self._accumulated.lost, self._accumulated.samples
            self._warnings.append(f"{lost} of {number} samples were not finite and count as black")
        mean, components = self._light(denoised)
        radiance = Image(
            mean,
            banding.names(self._about.bands),
            Quantity.RADIANCE,
            variance=variance,
            provenance=self._about.provenance() | ({"denoised": True} if denoised else {}),
        )
        return Rendered(
            radiance=radiance,
            aovs=self._seen,
            relative_error=relative_error,
            mottle=denoised.error.mottle if denoised and denoised.error else None,
            components=components,
            error=rms,
            groups=self._groups(denoised, mean.shape),
            model=self._about.model,
            why=self._why,
            warnings=tuple(self._warnings),
            samples=self.samples,
            met=met,
        )

    def _variance(self) -> tuple[np.ndarray, Array]:
        """(H, W, C) of the samples' mean, and (P,) of its luminance."""
        spread, weights = self._accumulated.variance(), self._accumulated.weights
        noise = np.asarray(spread @ weights * weights.sum())
        for estimator in self._accumulated.estimators.values():
            estimator.squares = np.zeros((0, 0), dtype=estimator.squares.dtype)
        return spread.reshape(*self._about.shape, -1).astype(np.float32, copy=False), noise

    def _denoised(self, progress: Progress) -> denoising.Denoised | None:
        if self._cleaning is None:
            return None
        denoised = self._cleaning.picture(self._accumulated, self._accumulated.samples, progress)
        if self._cleaning.problem:
            self._warnings.append(self._cleaning.problem)
        elif denoised is None:
            self._why += "; not denoised, since it tells no components apart"
        return denoised

    def _error(self, denoised: denoising.Denoised | None, noise: Array) -> tuple[float, float | None]:
        """The median pixel's relative error, and the share of pixels under the target."""
        target, met = self._about.target, None
        luminance: np.ndarray
        error: np.ndarray
        if denoised and denoised.error:
            luminance, error = denoised.luminance(self._accumulated.weights).ravel(), denoised.error.rms.ravel()
            if not target.open:
                met = float((error <= target.allowed_in_all(luminance)).mean())
        else:
            luminance, error = self._accumulated.luminance(), np.sqrt(noise)
            if not target.open and denoised is None:
                met = reached(luminance, noise, target, self._about.shape)
        lit = luminance > 0.0
        relative = float(np.median(error[lit] / luminance[lit])) if lit.any() else 0.0
        if denoised and denoised.error and relative > LARGE_ERROR:
            much = f"{relative:.0%}" if relative < 1.0 else "more than its own light"
            self._warnings.append(f"after denoising the median pixel still errs by {much}; more samples mend it")
        return relative, met

    def _light(self, denoised: denoising.Denoised | None) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """(H, W, C) of the picture, and of its components."""
        if denoised:
            components = dict(denoised.components)
            mean = np.asarray(sum(components.values()))
            for estimator in self._accumulated.estimators.values():
                estimator.aovs.clear()
        else:
            mean = self._picture_of(self._accumulated.mean())
            components = {
                name: self._picture_of(aov)
                for name in COMPONENTS
                if (aov := self._accumulated.take_aov(name)) is not None
            }
        if mean.min() < 0.0:
            below = int((mean < 0.0).any(axis=2).sum())
            self._warnings.append(
                f"{below} pixels came out below 0, noise of a difference, and count as black; more samples mend it"
            )
            mean = np.maximum(mean, 0.0)
        return mean, components

    def _groups(self, denoised: denoising.Denoised | None, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
        if not self._shares:
            return {name: self._picture_of(sum(self._accumulated.take_group().values())) for name in self._names}
        divided = self._cleaning.divided(denoised, self._shares) if self._cleaning and denoised else None
        if self._cleaning and denoised and divided is None:
            self._warnings.append(f"light groups are {self._cleaning.problem}")
        return divided or {name: denoising.fine(lights, shape) for name, lights in self._shares}

    def _picture_of(self, pixels: Any) -> np.ndarray:
        return np.asarray(pixels.reshape(*self._about.shape, -1).astype(np.float32))


class Cleaning:
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


def _not_denoised(error: Exception) -> str:
    return f"not denoised, so it takes many more samples: {str(error) or 'not enough memory'}"

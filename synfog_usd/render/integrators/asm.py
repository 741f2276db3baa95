"""The atmospheric scattering model: clear air dimmed, and one airlight for all of it.

Takes a loaded scene; gives the integrator of the models `asm` and `asm_estimated`,

    L = J t + A (1 - t),

in linear radiance: J what `path` renders without the fog, t the exact transmittance
along the ray through each pixel's centre (its length, not planar depth), A one colour.

    asm             A is the radiance that the plane-parallel slab of `fog.slab` gives
                    towards the horizon at the eye's height; where no slab fits, the mean of the sky
    asm_estimated   A is guessed from the picture, as one does for real ones: of a first picture,
                    made with the brightest sky of J, the mean of the pixels whose dark channel is
                    among the brightest 0.1 % (He, Sun and Tang 2009, section 4.4)

Valid far from lamps, under an even sky, with t near 0 or 1.  It knows no light that
the fog takes from surfaces or gives to them, and no lamp's glow.  Measured against
`path` in the bench stages at MOR 150 m, 64 x 36 pixels: by overcast day the median pixel is
off by 20 % (estimated: 49 %, all too bright); by night `asm` shows 1 % of the
median pixel's light, and `asm_estimated` has its mean wrong by half.
Source: Koschmieder (1924); Narasimhan and Nayar, IJCV 48, 233 (2002).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from synfog_usd.arrays import Array
from synfog_usd.errors import ParameterError
from synfog_usd.progress import Progress, silent
from synfog_usd.render import backend
from synfog_usd.render.film import aovs
from synfog_usd.render.film.accumulator import MULTIPLE, Accumulator
from synfog_usd.render.integrators.path import FogPath
from synfog_usd.render.lights.rows import is_sampled_light
from synfog_usd.render.lights.sampler import LightSampler
from synfog_usd.render.load import MitsubaScene
from synfog_usd.render.media.control_variate import find_slab, mean_sky
from synfog_usd.render.media.medium import Medium, unsupported_fog
from synfog_usd.scene import SceneDict

Airlight = Literal["physical", "estimated"]

PATCH_PX = 15
"""Side of the square over which the dark channel is the minimum; He, Sun and Tang's."""

BRIGHTEST = 1e-3
"""Share of the dark channel's brightest pixels; theirs."""


def asm_refuses(scene: SceneDict) -> str:
    """Why a scene is outside of the model's domain, or ''.

    Lamps are not refused: what the model makes of them is what it is there to show.
    """
    if backend.is_scalar():
        return "it needs LLVM or CUDA"
    for volume in scene.fog:
        if volume.boundary.kind == "mesh":
            return f"the boundary {volume.path} is a mesh, not a box or a sphere"
    return ""


def make_asm(loaded: MitsubaScene, airlight: Airlight = "physical") -> Asm:
    """The integrator.

    Args:
        loaded: a scene without boundaries.
        airlight: 'physical' from the slab or the sky, or 'estimated' from the picture.

    Raises:
        ParameterError: a scene that `asm_refuses`, or an airlight that is neither.
    """
    if problem := asm_refuses(loaded.source):
        raise ParameterError(f"the atmospheric scattering model cannot be used here: {problem}")
    if airlight not in ("physical", "estimated"):
        raise ParameterError(f"airlight {airlight!r} is not known; it takes 'physical' or 'estimated'")
    return Asm(loaded, airlight)


class Asm:
    """One scene's integrator."""

    def __init__(self, loaded: MitsubaScene, airlight: Airlight) -> None:
        self.loaded, self.airlight = loaded, airlight
        self.clear = replace(loaded, source=replace(loaded.source, fog=()))
        self.path = _clear_path(self.clear)
        self.transmittance = aovs.measure(loaded).transmittance.reshape(-1, 1)

    def accumulate(self, *, samples: int, seed: int, progress: Progress = silent) -> Accumulator:
        """An image; see `Integrator`.  Its variance is that of J; what noise A has is left out."""
        accumulated = self.path.accumulate(samples=samples, seed=seed, progress=progress)
        t = self.transmittance
        glow = (1.0 - t) * self._airlight(accumulated.mean())
        for index, estimator in enumerate(accumulated.estimators.values()):
            count = estimator.counts[:, :, None]
            added = glow if index == 0 else 0.0  # to every sample of the first part
            whole = t * sum(estimator.total(name) for name in estimator.aovs)
            more = 2.0 * added * whole + count.sum(axis=0) * added**2
            estimator.squares = t * t * estimator.squares + more
            estimator.groups = [t * group for group in estimator.groups]
            estimator.aovs = {name: t * aov for name, aov in estimator.aovs.items()}
            if index == 0:
                estimator.aovs[MULTIPLE] = estimator.aovs.get(MULTIPLE, 0.0) + count * added
        return accumulated

    def _airlight(self, clear: Array) -> Array:
        """(C,) A."""
        if self.airlight == "estimated":
            camera = self.loaded.source.camera
            shape = (camera.height_px, camera.width_px, -1)
            return estimated_airlight(clear.reshape(shape), self.transmittance.reshape(shape))
        return physical_airlight(self.loaded)


def physical_airlight(loaded: MitsubaScene) -> Array:
    """(3,) radiance towards the horizon at the eye's height; of the slab, or where none fits the mean of the sky's
    upper half.
    """
    eye = loaded.source.camera.to_world[:3, 3]
    if not unsupported_fog(loaded.source.fog):
        found, _ = find_slab(loaded, Medium(loaded.source.fog))
        if found is not None:
            return found[0].radiance([eye[2]], [0.0])[0]
    up, sky, _ = mean_sky(loaded)
    edges = np.r_[0.0, (up[1:] + up[:-1]) / 2.0, 1.0]
    return np.diff(edges) @ sky


def estimated_airlight(clear: npt.ArrayLike, transmittance: npt.ArrayLike) -> Array:
    """Airlight guessed from a picture by its dark channel.

    Args:
        clear: (H, W, C) J.
        transmittance: (H, W, 1) t.

    Returns:
        (C,): the mean of I = J t + A0 (1 - t) over the 0.1 % of its pixels (one at least) whose
        dark channel, the least of all channels in a square of 15 pixels, is brightest.  A0 is
        the same mean of J itself, as of a clear photograph (Sakaridis, Dai and Van Gool 2018, section 3.1).
    """
    J, t = np.asarray(clear, dtype=np.float64), np.asarray(transmittance, dtype=np.float64)
    first = _brightest(J)
    return _brightest(J * t + first * (1.0 - t))


def _brightest(picture: Array) -> Array:
    dark = dark_channel(picture).ravel()
    count = max(1, round(BRIGHTEST * dark.size))
    pixels = picture.reshape(dark.size, -1)
    # among equals the brighter pixel, so that a flat sky is not read off at its border
    luminance = pixels.mean(axis=1)
    return pixels[np.lexsort((-luminance, -dark))[:count]].mean(axis=0)


def dark_channel(picture: Array) -> Array:
    """(H, W) least of all channels in the square around each pixel; at the border, of the part that is inside."""
    least, reach = picture.min(axis=2), PATCH_PX // 2
    for axis in (0, 1):
        padded = np.pad(least, [(reach, reach) if axis == a else (0, 0) for a in (0, 1)], constant_values=np.inf)
        least = np.lib.stride_tricks.sliding_window_view(padded, PATCH_PX, axis=axis).min(axis=-1)
    return least


def _clear_path(clear: MitsubaScene) -> FogPath:
    """`path` in clear air."""
    world = clear.source.world
    sky = clear.scene.environment() is not None
    others = len(clear.scene.emitters()) - sky - sum(is_sampled_light(part) for part in world.values())
    return FogPath(clear, Medium(()), lights=LightSampler(world, {}), others=others)

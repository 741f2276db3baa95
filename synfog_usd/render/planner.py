"""Which model, and how many bands: no more than a scene needs.

Takes a loaded scene and a target.  As a rule it looks how much of the sky the surfaces
of the view see, which costs a few rays: a pilot of each candidate would want kernels of
its own, and to compile them takes longer than most pictures.  Where an error is asked
for that models with a bias may meet, it runs each candidate small, compares it with the
unbiased estimate, and takes the cheapest whose error is under the target.  What
decides is counted in paths and their fixed costs, never in seconds, so that the
same seed gives the same choice on any machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synfog_usd.arrays import Array
from synfog_usd.errors import ParameterError
from synfog_usd.progress import Progress, silent
from synfog_usd.render import backend, denoise, models
from synfog_usd.render.film import aovs
from synfog_usd.render.film.accumulator import Accumulator
from synfog_usd.render.load import MitsubaScene, resized
from synfog_usd.render.sampling.adaptive import Target
from synfog_usd.render.spectra import bands
from synfog_usd.scene import SceneDict
from synfog_usd.seeds import seed32

PILOT_WIDTH_PX = 64
PILOT_SAMPLES = 64

OPEN = 0.5
"""Share of the sky over visible surfaces from which on most light is a plane-parallel slab's.

At MOR 150, open share and standard deviation of a sample by `path` and by `path+slab`: the bench's overcast street
0.76, 1.0 and 0.45; the crossing 0.27, 1.9 and 2.5; the canyon 0.23, 1.8 and 2.4; under the bridge 0.08, 3.7 and 21.
"""

SKY_RAYS = 16
"""Rays to the sky from each surface point."""

NEAR_M = 50.0
"""Distance over which a surface comes to count a third as much; the mean free path of MOR 150."""

NUDGE_M = 0.01
"""How far before a surface they begin."""

GOLDEN = 0.6180339887498949
"""Their turns are spread by the golden ratio."""

USUAL_NOISE = 1.5
"""Standard deviation of a sample over a pixel's light in streets, about: 0.5 to 4 in the bench stages."""

CACHE_ERROR = 0.03
"""Error of a radiance cache where it is largest in the bench stages, before street lamps."""

FINEST = 16
"""Wavelength bands that the planner takes for right; 31 differ from them by less than 0.2 % in the bench stages, and
are there to be asked for.
"""

COLOUR_ERROR = 0.01
"""Error of colours that is good enough where no target is named: what an eye just sees side by side."""

WORTH_TRYING = 0.1
"""Target from which on biased models are tried: each costs a kernel, and in the bench stages the best of them, `slab`
in the overcast street, errs by 12 %.
"""

WORTH_A_GRID = 0.01
"""Target from which on the sibling with a radiance cache is tried; a pilot knows its error to about that.  In the bench
stages the squared error of the sibling, the worst hundredth of the pixels left out, is 1.2 to 8 times smaller for the
same seconds.
"""

BLOCK_PX = 8
"""Side of the squares over which a grid's error is measured: it is smooth, and noise is less in them."""

FIREFLIES = 0.06
"""Share of such squares, the noisiest ones, that tell nothing of an error."""

CORRELATED = 9.0
"""Independent pixels in such a square of a grid's picture: its cells are two or three pixels of the pilot wide."""


@dataclass(frozen=True)
class Choice:
    """A model and the figures that decided.

    Attributes:
        model: its name.
        why: in words, with the figures.
        figures: model -> {'bias': RMS over the pixels of its relative error, where it is biased; 'noise': relative
            standard deviation of one sample}.
        best: the model without bias that costs least, as good as `model` and slower.
    """

    model: str
    why: str
    figures: dict[str, dict[str, float]]
    best: str


def candidates(scene: SceneDict) -> list[str]:
    """Unbiased models of ours that hold; empty where there is nothing to choose."""
    return [name for name in models.ours_unbiased() if not models.MODELS[name].refuses(scene)] if scene.fog else []


def choose(
    loaded: MitsubaScene, *, target: Target, seed: int, denoised: bool = False, progress: Progress = silent
) -> Choice:
    """The model that is to be expected to need the fewest seconds; with pilots where the target allows of a bias, see
    `choose_by_pilots`.

    Arguments as there.
    """
    if target.relative is not None and target.relative >= WORTH_TRYING:
        return choose_by_pilots(loaded, target=target, seed=seed, denoised=denoised, progress=progress)
    progress("choosing a model", 0.0)
    share = open_to_sky(loaded)
    best = (
        "path+slab"
        if share >= OPEN and "path+slab" in candidates(loaded.source) and _can_be_made("path+slab", loaded)
        else "path"
    )
    why = f"surfaces see {share:.0%} of the sky, {'over' if share >= OPEN else 'under'} {OPEN:.0%}"
    figures = {best: {"open_to_sky": share}}
    left, cache = USUAL_NOISE / np.sqrt(target.samples), models.MODELS[best].froxels
    if denoised or not cache or left < CACHE_ERROR or (target.relative is not None and target.relative < CACHE_ERROR):
        return Choice(best, why, figures, best)
    return Choice(
        cache,
        f"{why}; {target.samples} samples leave more noise than the {CACHE_ERROR:.0%} by which a radiance cache errs "
        f"at most",
        figures,
        best,
    )


def open_to_sky(loaded: MitsubaScene) -> float:
    """Share of the upper half of the sky that the surfaces of a view see; near ones count more, the same in every fog;
    1 where there are none.
    """
    small = _small(loaded)
    size = small.source.camera.width_px, small.source.camera.height_px
    if size not in loaded.open_to_sky:
        loaded.open_to_sky[size] = _open_to_sky(small)
    return loaded.open_to_sky[size]


def _open_to_sky(small: MitsubaScene) -> float:
    mi = backend.mitsuba()
    seen = aovs.measure(small)
    origin, direction = aovs.centre_rays(small)
    distance = seen.distance_m.ravel()
    surface_hit = np.isfinite(distance)
    if not surface_hit.any():
        return 1.0
    normal = seen.normal.reshape(-1, 3)[surface_hit]
    place = np.repeat((origin + direction * distance[:, None])[surface_hit] + NUDGE_M * normal, SKY_RAYS, axis=0)
    number = np.arange(len(place)) + 0.5
    up, turn = (number / SKY_RAYS) % 1.0, 2.0 * np.pi * (number * GOLDEN % 1.0)
    flat = np.sqrt(1.0 - up * up)
    way = np.stack([flat * np.cos(turn), flat * np.sin(turn), up], axis=1)
    ray = mi.Ray3f(backend.points(place), mi.Vector3f(backend.points(way)))
    free = ~np.array(small.tree.ray_test(ray), dtype=bool)
    return float(
        np.average(free.reshape(-1, SKY_RAYS).mean(axis=1), weights=np.exp(-distance[surface_hit] / NEAR_M) + 1e-9)
    )


def _can_be_made(name: str, loaded: MitsubaScene) -> bool:
    """Whether a model, on a closer look, holds."""
    try:
        models.MODELS[name].make(_small(loaded))
    except ParameterError:
        return False
    return True


def choose_by_pilots(
    loaded: MitsubaScene, *, target: Target, seed: int, denoised: bool = False, progress: Progress = silent
) -> Choice:
    """The cheapest model whose measured error is under the target.

    How often a path may be scattered is left open: in every bench stage a cut that errs by under
    10 % costs as much as none, since roulette ends paths where they carry little.

    Args:
        loaded: a scene with `candidates`, without boundaries and at any size; the pilot is PILOT_WIDTH_PX wide.
        target: biased models are tried only where it names an error.
        seed: of the pilot.
        denoised: the picture will be denoised; then the pilot without bias is, too, and taken where it errs less than
            is asked for.  No grid is tried: denoised `path` errs less than denoised `field` in the same time: 0.47
                against 0.80 % of relative MSE after 2 s in the bench's canyon,
            and alike before headlights.
        progress: told after each candidate.
    """
    scene, small = loaded.source, _small(loaded)
    holding, biased = candidates(scene), models.having("worth_a_pilot")
    figures: dict[str, dict[str, float]] = {}
    pilots: dict[str, Accumulator] = {}
    for index, name in enumerate(holding):
        progress("trying models", index / (len(holding) + len(biased)))
        if (picture := _pilot(small, name, seed)) is not None:
            pilots[name], figures[name] = picture, {"noise": _noise(picture)}
    best = min(pilots, key=lambda name: figures[name]["noise"] ** 2 * models.MODELS[name].cost)
    others = [f"{name} {figures[name]['noise']:.3g}" for name in pilots if name != best]
    why = f"standard deviation of a sample {figures[best]['noise']:.3g} of a pixel's light" + (
        f", {', '.join(others)}" if others else ""
    )
    wanted = target.relative if target.relative is not None else _relative(target, pilots[best])
    if wanted is None or wanted < WORTH_A_GRID:
        return Choice(best, why, figures, best)
    if denoised and target.samples >= PILOT_SAMPLES:
        figures[best]["denoised"] = left = _denoised_error(small, pilots[best])
        if left < wanted:
            return Choice(
                best,
                f"denoised it errs by {left:.1%} after {PILOT_SAMPLES} samples, under the {wanted:.1%} that is asked "
                f"for",
                figures,
                best,
            )
    tried = []
    for index, name in enumerate(biased):
        if wanted < WORTH_TRYING or models.MODELS[name].refuses(scene):
            continue
        progress("trying models", (len(holding) + index) / (len(holding) + len(biased)))
        if (picture := _pilot(small, name, seed)) is None:
            continue
        bias, least = _bias(picture, pilots[best])
        figures[name] = {"bias": bias, "noise": _noise(picture)}
        if (
            bias + least < wanted
            and models.MODELS[name].cost * figures[name]["noise"] ** 2
            < models.MODELS[best].cost * figures[best]["noise"] ** 2
        ):
            return Choice(
                name,
                f"its error of {bias:.2%} (known to {least:.2%}) is under the {wanted:.2%} that is asked for",
                figures,
                best,
            )
        tried.append(f"{name} errs by {bias:.1%}")
    if denoised:
        return Choice(best, why + (f"; {', '.join(tried)}, above {wanted:.2%}" if tried else ""), figures, best)
    name = models.MODELS[best].froxels
    progress("trying models", 1.0)
    if (picture := _pilot(small, name, seed)) is not None:
        shape = (small.source.camera.height_px, small.source.camera.width_px)
        bias, least = _bias(picture, pilots[best], shape)
        figures[name] = {"bias": bias, "noise": _noise(picture)}
        left = figures[best]["noise"] / np.sqrt(target.samples)
        if bias + least < max(wanted, left):
            than = (
                f"the {wanted:.2%} that is asked for"
                if wanted > left
                else f"the noise of {left:.2%} that {best} would leave"
            )
            return Choice(name, f"its error of {bias:.2%} (known to {least:.2%}) is under {than}", figures, best)
        tried.append(f"{name} errs by {bias:.2%} (known to {least:.2%})")
    return Choice(best, why + (f"; {', '.join(tried)}, above {wanted:.2%}" if tried else ""), figures, best)


def choose_bands(
    loaded: MitsubaScene, model: str, *, target: Target, seed: int, progress: Progress = silent
) -> tuple[int, str, dict[str, float]]:
    """The fewest wavelength bands whose colours are right to the target.

    Right is what FINEST bands give along the same paths.  An eye's R, G and B of both are
    compared, twice with seeds of their own; of the two differences the product is taken,
    in which noise cancels.

    Args:
        loaded: as `choose` takes it.
        model: one that carries bands.

    Returns:
        number of bands, why, and the figures: RMS over the pixels of the colours' error over their luminance, by number
            of bands.
    """
    small = _small(loaded)
    if any(volume.medium.profile == "grid" for volume in small.source.fog):
        return bands.RGB, "a grid takes R, G and B", {}
    counts = (bands.RGB, *(count for count in bands.CENTRES_NM if count < FINEST))

    def picture(count: int, half: int) -> tuple[Array, Accumulator]:
        integrator = models.make(model, small, bands=count)
        accumulated = integrator.accumulate(samples=PILOT_SAMPLES // 2, seed=seed32(seed, "bands", half))
        return bands.to_rgb(accumulated.mean(), count), accumulated

    progress("trying bands", 0.0)
    right = [picture(FINEST, half) for half in (0, 1)]
    level = np.mean([accumulated.luminance() for _, accumulated in right], axis=0)
    scale = np.maximum(level, 0.05 * level.mean() + 1e-30)[:, None]
    wanted = target.relative if target.relative is not None else _relative(target, right[0][1])
    wanted = COLOUR_ERROR if wanted is None else wanted
    figures: dict[str, float] = {}
    for index, count in enumerate(counts):
        progress("trying bands", (index + 1) / (len(counts) + 1))
        first, second = ((picture(count, half)[0] - right[half][0]) / scale for half in (0, 1))
        figures[str(count)] = error = float(np.sqrt(max(float((first * second).mean()), 0.0)))
        if error < wanted:
            return count, f"colours err by {error:.2%} against {FINEST} bands, under {wanted:.2%}", figures
    return FINEST, f"fewer err by {figures[str(counts[-1])]:.2%}, above {wanted:.2%}", figures


def _small(loaded: MitsubaScene) -> MitsubaScene:
    camera = loaded.source.camera
    return resized(loaded, (PILOT_WIDTH_PX, max(1, round(PILOT_WIDTH_PX * camera.height_px / camera.width_px))))


def _pilot(small: Any, name: str, seed: int) -> Accumulator | None:
    """A small picture by a model, or None where it finds on a closer look that it does not hold."""
    try:
        integrator = models.MODELS[name].make(small)
    except ParameterError:
        return None
    return integrator.accumulate(samples=PILOT_SAMPLES, seed=seed32(seed, "pilot", name))


def _noise(accumulated: Accumulator) -> float:
    """Relative standard deviation of a sample: root of the mean over the pixels, the noisiest hundredth left out."""
    level = accumulated.luminance()
    scale = np.maximum(level, 0.05 * level.mean() + 1e-30)
    relative = np.sort(accumulated.luminance_variance() / scale**2)
    return float(np.sqrt(relative[: max(1, int(0.99 * len(relative)))].mean() * PILOT_SAMPLES))


def _denoised_error(small: MitsubaScene, pilot: Accumulator) -> float:
    """Relative error of a pilot's median pixel after denoising; infinite where it cannot be denoised."""
    halves = pilot.component_halves(small.source.camera.height_px, small.source.camera.width_px)
    try:
        picture = denoise.denoise_halves(halves, denoise.guides(small), pilot.weights)
    except (denoise.DenoiserError, MemoryError):
        return np.inf
    assert picture.error is not None
    luminance = picture.luminance(pilot.weights)
    return float(np.median(picture.error.rms / np.maximum(luminance, 0.05 * luminance.mean() + 1e-30)))


def _bias(picture: Accumulator, reference: Accumulator, shape: tuple[int, int] | None = None) -> tuple[float, float]:
    """RMS over the pixels of the relative error that is not noise, and how well it is known.

    Both variances are taken off the squared difference.  With the `shape` (H, W) of the picture, over
    squares of BLOCK_PX instead, with the noise that is seen: that of neighbours may be one.
    """
    one, other = picture.luminance(), reference.luminance()
    if shape is not None:
        return _bias_of_squares(one, other, picture.luminance_variance(), reference.luminance_variance(), shape)
    scale = np.maximum(other, 0.05 * other.mean() + 1e-30)
    square = ((one - other) / scale) ** 2
    noise = (picture.luminance_variance() + reference.luminance_variance()) / scale**2
    excess = square - noise
    known = float(np.sqrt(2.0 * np.std(excess) / np.sqrt(len(excess))))
    return float(np.sqrt(max(float(excess.mean()), 0.0))), known


def _bias_of_squares(
    one: Array, other: Array, noise: Array, other_noise: Array, shape: tuple[int, int]
) -> tuple[float, float]:
    side = min(BLOCK_PX, *shape)
    height, width = (length // side * side for length in shape)

    def squares(values: Array) -> Array:
        cut = values.reshape(shape)[:height, :width]
        return np.asarray(cut.reshape(height // side, side, width // side, side).mean(axis=(1, 3)).ravel())

    level = squares(other)
    scale = np.maximum(level, 0.05 * level.mean() + 1e-30)
    own = squares(noise) / min(CORRELATED, side**2) + squares(other_noise) / side**2
    excess = (squares(one - other) ** 2 - own) / scale**2
    excess = excess[np.argsort(own / scale**2, kind="stable")[: max(1, int((1.0 - FIREFLIES) * len(excess)))]]
    known = float(np.sqrt(2.0 * np.std(excess) / np.sqrt(len(excess))))
    return float(np.sqrt(max(float(excess.mean()), 0.0))), known


def _relative(target: Target, accumulated: Accumulator) -> float | None:
    if target.sigma is None:
        return None
    luminance = accumulated.luminance()
    level = np.maximum(luminance, 0.01 * luminance.mean() + 1e-30)
    return float(np.median(target.sigma(level) / level))

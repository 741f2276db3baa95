"""Ours against Mitsuba's own, on one machine in one run: 1 / (variance x time).

Every ratio is ours over the better of `volpath` and `volpathmis` in the same
variant.  Errors are squared differences from a reference of many more samples,
relative to its luminance (not below a thousandth of the mean), the reference's own
variance taken off; time is that of sampling, kernels made before.  A ratio is good
to about a fifth on a machine that does nothing else.  Figures are printed with -s.
"""

import time
from pathlib import Path

import numpy as np
import pytest

from synfog_usd import stage as usd
from synfog_usd.render import denoise as denoising
from synfog_usd.render import models, shot
from synfog_usd.render.film.accumulator import COMPONENTS
from synfog_usd.translate import translate

pytestmark = pytest.mark.bench

STAGES = Path(__file__).parents[2] / "stages" / "bench"
SIZE = (96, 54)
PEERS = {"volpath": 32, "volpathmis": 32}
RUNS = 4


def scene(name):
    return translate(usd.open_stage(STAGES / f"{name}.usda"), resolution=SIZE)


class Renderer:
    """A model ready to sample one scene."""

    def __init__(self, world, model):
        self.loaded = shot.load(world, boundaries=models.MODELS[model].boundaries)
        self.integrator = models.make(model, self.loaded)
        self.render(64, 99)  # all kernels made

    def render(self, samples, seed):
        return self.integrator.accumulate(samples=samples, seed=seed)


def luminance(exposure):
    return exposure.mean().mean(axis=1)


def reference(world, model, samples):
    """(P,) luminance, its variance."""
    done = Renderer(world, model).render(samples, 1000)
    return luminance(done), done.variance().mean(axis=1)


def errors(world, model, samples, truth):
    """(P,) relative squared error of a render, and its seconds."""
    renderer, mean, own = Renderer(world, model), truth[0], truth[1]
    scale = np.maximum(mean, 1e-3 * mean.mean()) ** 2
    square, seconds = [], []
    for seed in range(RUNS):
        began = time.perf_counter()
        done = renderer.render(samples, seed)
        seconds.append(time.perf_counter() - began)
        square.append(((luminance(done) - mean) ** 2 - own) / scale)
    return np.mean(square, axis=0), min(seconds)


def trimmed(square):
    """Mean without the hundredth of the pixels that is worst."""
    return np.sort(square)[: int(0.99 * len(square))].mean()


def ratio(name, samples, *, reduce, truth_samples):
    """Efficiency of `path` over that of the better peer."""
    world = scene(name)
    truth = reference(world, "path", truth_samples)
    found = {}
    for model, count in {"path": samples, **PEERS}.items():
        square, seconds = errors(world, model, count, truth)
        found[model] = 1.0 / (reduce(square) * seconds)
    best = max(found[peer] for peer in PEERS)
    print(f"\n{name}, {reduce.__name__}: {found['path'] / best:.1f} x", found)
    return found["path"] / best


def test_canyon():
    """Between houses, over all pixels."""
    assert ratio("canyon", 256, reduce=np.mean, truth_samples=8192) >= 6.0


@pytest.mark.parametrize("name, wanted", [("street_lamps", 4.0), ("headlights", 8.0)])
def test_night(name, wanted):
    """By night, the worst hundredth of the pixels left out."""
    assert ratio(name, 256, reduce=trimmed, truth_samples=16384) >= wanted


@pytest.mark.parametrize("name", ["canyon", "street_lamps", "headlights"])
def test_denoised(name):
    """Time to the same error, denoised against denoised: `path` at 128 samples with its guides, `volpath` with and
    without.

    `volpath` gets as many samples as give that error, between two counts on logarithms.

    All pixels but the worst hundredth count.  `volpath`'s guides and its second denoising are not timed.
    """
    world = scene(name)
    mean, own = reference(world, "path", 16384)
    scale, shape = np.maximum(mean, 1e-3 * mean.mean()) ** 2, (SIZE[1], SIZE[0], 3)
    ours, theirs = Renderer(world, "path"), Renderer(world, "volpath")

    def error(picture):
        return trimmed(((picture.reshape(-1, 3).mean(axis=1) - mean) ** 2 - own) / scale)

    def clean(samples):
        done, seen = ours.render(samples, 1), denoising.guides(ours.loaded)
        parts = {
            part: np.maximum(light, 0.0).reshape(shape).astype(np.float32)
            for part in COMPONENTS
            if (light := done.aov(part)) is not None
        }
        parts["airlight"] = parts.pop("airlight_single") + parts.pop("airlight_multiple")
        return sum(denoising.denoise(parts, seen).values())

    clean(16)  # kernels made and the network loaded
    guides = denoising.guides(ours.loaded, clear=True)
    began = time.perf_counter()
    picture = clean(128)
    seconds, reached = time.perf_counter() - began, error(picture)
    found, samples = [], 16
    while len(found) < 2 or (found[-1][0] > reached and found[-1][1] < 30.0 * seconds):
        samples *= 2
        began = time.perf_counter()
        picture = theirs.render(samples, 2).mean().reshape(shape).astype(np.float32)
        plain = denoising.denoise_plain(picture)
        spent = time.perf_counter() - began
        found.append((min(error(plain), error(denoising.denoise_plain(picture, guides.albedo, guides.normal))), spent))
    (worse, less), (better, more) = found[-2:]
    same = (
        more
        if better > reached
        else np.exp(np.interp(-np.log(reached), -np.log([worse, better]), np.log([less, more])))
    )
    print(
        f"\n{name}, denoised: ours {reached:.4g} in {seconds:.2f} s, volpath {better:.4g} in {more:.2f} s with "
        f"{samples} samples: {same / seconds:.1f} x"
    )
    assert same >= 10.0 * seconds


def test_memory_of_a_large_frame():
    """1920x1080 with all AOVs, four light groups and 16 bands: under 4 GiB at its peak, in a process of its own."""
    import subprocess
    import sys

    code = (
        "import resource; from dataclasses import replace; from pathlib import Path;"
        "from synfog_usd import stage as usd; from synfog_usd.translate import translate;"
        "from synfog_usd.render.shot import render;"
        f"world = translate(usd.open_stage(Path({str(STAGES / 'headlights.usda')!r})), resolution=(1920, 1080));"
        "lit = [key for key, part in world.world.items() if isinstance(part, dict) and ('emitter' in part or "
        "key.startswith('light_'))];"
        "names = ('sky', 'headlights', 'street_lamps', 'other');"
        "world = replace(world, group_of={key: names[index % 4] for index, key in enumerate(lit)});"
        "done = render(world, model='path', samples=4, bands=16);"
        "assert len(done.components) == 3 and len(done.groups) == 4 and done.radiance.pixels.shape == (1080, 1920, 16);"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)"
    )
    peak = float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)
    print(f"\n1920x1080, 16 bands, 4 groups: {peak:.2f} GiB")
    assert peak < 4.0

"""The same picture by several seeds.

Dr.Jit compiles its kernels for a scene that is loaded, half a second each time; so the scene is loaded once.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from synfog_usd.render import models
from synfog_usd.render.shot import Rendered, load, render
from synfog_usd.scene import SceneDict


def by_seed(scene: SceneDict, seeds: Iterable[int], *, model: str = models.AUTO, **how: Any) -> list[Rendered]:
    """One render for each seed; `how` is for `render`."""
    model, _ = models.choose(model, scene)
    loaded = load(scene, boundaries=models.MODELS[model].boundaries)
    return [render(scene, model=model, seed=seed, loaded=loaded, **how) for seed in seeds]


def pictures(scene: SceneDict, seeds: int, **how: Any) -> np.ndarray:
    """(seeds, H, W, C) radiance of each, as `assert_mean` takes it: it keeps them where it fails."""
    return np.array([run.radiance.pixels for run in by_seed(scene, range(seeds), **how)], dtype=np.float64)


def means(scene: SceneDict, seeds: int, **how: Any) -> np.ndarray:
    """(seeds,) the mean over pixels and channels of each."""
    return pictures(scene, seeds, **how).mean(axis=(1, 2, 3))

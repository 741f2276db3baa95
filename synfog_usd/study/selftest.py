"""Known answers, measured on this machine with the variant in force.

Each case compares Monte Carlo with a closed form and passes within five standard
errors; it says how large a bias it could have seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from synfog_usd.fog import FogMedium, FogVolume
from synfog_usd.progress import Progress, silent
from synfog_usd.render import layers
from synfog_usd.render.shot import load, render
from synfog_usd.scene import SceneDict
from synfog_usd.study.truths import black, box, scene, uniform_fog, wall

SEEDS = 8
LIMIT = 5.0
"""Standard errors; with 8 seeds a t-statistic beyond it is one run in 600."""

SKY = {"light_sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}}


@dataclass(frozen=True)
class Result:
    """One case.

    Attributes:
        name: the claim.
        truth: the closed form's value.
        measured: the mean over the seeds.
        resolves: relative bias that the case could have seen.
        passed: whether the two agree.
    """

    name: str
    truth: float
    measured: float
    resolves: float
    passed: bool


def run(*, samples: int = 256, progress: Progress = silent) -> Iterator[Result]:
    """Measure every case, one after the other."""
    cases: list[tuple[str, float, Callable[[], tuple[float, float]]]] = [
        *(
            (
                f"a wall at 50 m in absorbing fog, MOR {visibility:g} m, dims by Beer and Lambert",
                0.05 ** (50.0 / visibility),
                _pooled(
                    scene({"shape_wall": wall(50.0, **black(1.0))}, [uniform_fog(visibility_m=visibility, albedo=0.0)], fov_x_deg=1.0), 8 * samples, progress
                ),
            )
            for visibility in (600.0, 300.0, 150.0)
        ),
        ("white furnace: scattering fog, MOR 50 m, in a uniform sky is invisible", 1.0, _pooled(_furnace(), samples, progress)),
        ("a bank of 0.3/m inside fog of 0.03/m dims with both", float(np.exp(-1.95)), _pooled(_bank(), 8 * samples, progress)),
        ("the transmittance layer of that wall, MOR 150 m", 0.05 ** (50.0 / 150.0), _layer),
    ]
    for name, truth, measure in cases:
        mean, error = measure()
        error = max(error, 2e-6 * truth)  # float32
        yield Result(name, truth, mean, 2 * LIMIT * error / truth, abs(mean - truth) <= LIMIT * error)


def _furnace() -> SceneDict:
    return scene(SKY, [uniform_fog(60.0, visibility_m=50.0)], fov_x_deg=60.0)


def _bank() -> SceneDict:
    outer = FogVolume("/Outer", box(200.0), FogMedium(0.03, albedo=0.0))
    bank = FogVolume("/Bank", box((50, 2.5, 50), (0, 10, 0)), FogMedium(0.3, albedo=0.0), priority=1, parent=0)
    return scene({"shape_wall": wall(20.0, **black(1.0))}, [outer, bank], fov_x_deg=0.1)


def _pooled(world: SceneDict, samples: int, progress: Progress) -> Callable[[], tuple[float, float]]:
    def measure() -> tuple[float, float]:
        means = []
        for seed in range(SEEDS):
            means.append(render(world, samples=samples, seed=seed).radiance.pixels.mean(dtype=np.float64))
            progress("measuring", (seed + 1) / SEEDS)
        return float(np.mean(means)), float(np.std(means, ddof=1) / np.sqrt(SEEDS))

    return measure


def _layer() -> tuple[float, float]:
    world = scene({"shape_wall": wall(50.0)}, [uniform_fog()], fov_x_deg=0.1, width_px=9)
    return float(layers.measure(load(world)).transmittance.mean()), 0.0

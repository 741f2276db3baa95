"""Known answers, measured with every model on this machine, with the variant in force.

Takes the `cases` and the models of `render.models`; gives one `Result` for each pair.
A mean agrees with its truth within five standard errors, or within the case's
tolerance where that is more; each says how large a bias it could have seen.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import SynfogError
from synfog_usd.lab.cases import Case, Known, every
from synfog_usd.render import models
from synfog_usd.render.film import aovs
from synfog_usd.render.shot import load
from synfog_usd.scene import SceneDict

SEEDS = 4
LIMIT = 5.0
"""Standard errors."""

ROUNDING = 2e-6
"""Least relative standard error: float32."""

MET, MISSED, NOISY, FINITE = "met", "missed", "noisy", "finite"
NOT_FINITE, NEGATIVE, REFUSED, CRASHED, SKIPPED = "not finite", "negative", "refused", "crashed", "skipped"


@dataclass(frozen=True)
class Result:
    """One model in one case.

    Attributes:
        case, model: their names.
        verdict: 'met', 'missed', 'noisy' (it could not have seen what it should), 'finite' (no truth was asked for),
            'not finite', 'negative', 'refused', 'crashed' or 'skipped'.
        counted: whether the case is in the model's stated domain and the model one of ours.
        failed: whether it makes the run fail.
        error: relative error of the mean, of the worst band of rows; nan where there is none.
        resolves: relative bias that could have been seen; nan where there is none.
        count: paths or pixels that were not finite, or pixels that were negative.
        why: what a model said that refused or crashed.
        seconds: that it took, kernels included.
    """

    case: str
    model: str
    verdict: str
    counted: bool
    failed: bool = False
    error: float = float("nan")
    resolves: float = float("nan")
    count: int = 0
    why: str = ""
    seconds: float = 0.0

    def cell(self) -> str:
        """For the table: error/resolves in percent, or how it failed."""
        if self.verdict in (REFUSED, CRASHED, FINITE):
            text = self.verdict
        elif self.verdict == SKIPPED:
            return "-"
        elif self.verdict == NOT_FINITE:
            text = f"NaN {self.count}"
        elif self.verdict == NEGATIVE:
            text = f"neg. {self.count} px"
        else:
            text = f"{_short(100 * self.error, sign=True)}/{_short(100 * self.resolves)}"
        return (
            f"!{text}"
            if self.failed
            else text
            if self.counted or models.MODELS[self.model].peer or self.verdict == REFUSED
            else f"({text})"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON, with None where there is no number."""
        return {
            key: None if isinstance(value, float) and not np.isfinite(value) else value
            for key, value in asdict(self).items()
        }


def run(cases: Iterable[Case] | None = None, *, quick: bool = False) -> Iterator[list[Result]]:
    """Measure every case with every model, one case after the other.

    Args:
        cases: those of `cases` if left out.
        quick: only those that are marked so.
    """
    for case in select(quick) if cases is None else cases:
        world = case.build()
        row = []
        for name in models.MODELS:
            start = time.monotonic()
            row.append(replace(measure(case, world, name), seconds=time.monotonic() - start))
        yield row


def select(quick: bool = False) -> list[Case]:
    """The cases of a run."""
    return [case for case in every() if case.quick or not quick]


def measure(case: Case, world: Known, model: str) -> Result:
    """One model in one case."""
    ours = not models.MODELS[model].peer
    counted = ours and model in case.holds
    if model in case.skip or (case.aov and not counted):
        return Result(case.name, model, SKIPPED, counted)
    if case.aov:
        assert world.truth is not None
        transmittance = aovs.measure(load(world.scene)).transmittance.astype(np.float64)
        return _judge(
            case,
            model,
            counted,
            np.full(SEEDS, transmittance.mean())[:, None],
            np.zeros(1),
            np.atleast_1d(np.mean(world.truth)),
            np.zeros(1),
        )
    samples = case.samples if ours else case.peer_samples
    try:
        if problem := models.MODELS[model].refuses(world.scene):
            return Result(case.name, model, REFUSED, counted, why=problem)
        first = _render(world.scene, model, samples, case.bands, 0)
        second = None
        if world.twin is not None:
            second = _render(world.twin, model, samples, case.bands, SEEDS)
    except SynfogError as error:
        return Result(case.name, model, REFUSED, counted, why=str(error))
    except Exception as error:  # whatever a model of a later day may raise belongs in the table
        return Result(case.name, model, CRASHED, counted, failed=ours, why=f"{type(error).__name__}: {error}")
    if broken := first.broken + (second.broken if second else 0):
        return Result(case.name, model, NOT_FINITE, counted, failed=ours, count=broken)
    if below := first.below + (second.below if second else 0):
        return Result(case.name, model, NEGATIVE, counted, failed=ours, count=below)
    if second is not None:
        return _judge(case, model, counted, first.means, first.error, second.means.mean(axis=0), second.error)
    if world.truth is None:
        return Result(case.name, model, FINITE, counted)
    camera = world.scene.camera
    truth = _bands(np.broadcast_to(world.truth, (camera.height_px, camera.width_px)), case.bands)
    return _judge(case, model, counted, first.means, first.error, truth, np.zeros(len(truth)))


def table(results: Iterable[Iterable[Result]]) -> str:
    """Rows are cases, columns models."""
    rows = [list(row) for row in results]
    names = [result.model for result in rows[0]] if rows else []
    cells = [[result.cell() for result in row] for row in rows]
    wide = [max(len(text) for text in (name, *(row[at] for row in cells))) for at, name in enumerate(names)]
    first = max([len("error/resolves [%]"), *(len(row[0].case) for row in rows)])
    lines = [
        "  ".join(
            ["error/resolves [%]".ljust(first), *(name.rjust(width) for name, width in zip(names, wide, strict=True))]
        )
    ]
    for row, texts in zip(rows, cells, strict=True):
        lines.append(
            "  ".join(
                [row[0].case.ljust(first), *(text.rjust(width) for text, width in zip(texts, wide, strict=True))]
            ).rstrip()
        )
    return "\n".join(lines)


def summary(results: Iterable[Iterable[Result]]) -> str:
    """How many, and what failed and why."""
    rows = [list(row) for row in results]
    flat = [result for row in rows for result in row]
    failed = [result for result in flat if result.failed]
    judged = sum(result.counted and result.verdict not in (REFUSED, SKIPPED) for result in flat)
    lines = [f"MISSED  {result.model}: {result.case}: {describe(result)}" for result in failed]
    verdict = f"{len(failed)} MISSED" if failed else "all met" if judged else "none could run here"
    lines.append(f"{len(rows)} cases, {judged} answers of our models counted: {verdict}")
    return "\n".join(lines)


def describe(result: Result) -> str:
    """What a result says, in words."""
    if result.verdict == NOT_FINITE:
        return f"{result.count} paths or pixels were not finite"
    if result.verdict == NEGATIVE:
        return f"{result.count} pixels are below 0 by more than {LIMIT:g} standard errors"
    if result.why:
        return f"{result.verdict}: {result.why}"
    return f"off by {result.error:+.3%}, with {result.resolves:.3%} resolved" + (
        ", which is too noisy to tell" if result.verdict == NOISY else ""
    )


@dataclass(frozen=True)
class _Seen:
    """Means of bands of rows by seed (SEEDS, B), the standard error (B,) of their mean, and what was wrong."""

    means: Array
    error: Array
    broken: int
    below: int


def _render(world: SceneDict, model: str, samples: int, bands: int, seed: int) -> _Seen:
    loaded = load(world, boundaries=models.MODELS[model].boundaries)
    integrator = models.make(model, loaded)
    shape = (world.camera.height_px, world.camera.width_px)
    images, variances, broken = [], [], 0
    for index in range(seed, seed + SEEDS):
        accumulated = integrator.accumulate(samples=samples, seed=index)
        image = np.asarray(accumulated.mean(), dtype=np.float64).mean(axis=1).reshape(shape)
        broken += accumulated.lost + int(np.count_nonzero(~np.isfinite(image)))
        images.append(image)
        variances.append(
            np.asarray(accumulated.variance(), dtype=np.float64).mean(axis=1).reshape(shape)
        )  # grey worlds: the channels are one
    pooled, variance = np.mean(images, axis=0), np.mean(variances, axis=0) / SEEDS
    means = np.array([_bands(image, bands) for image in images])
    count = np.array([part.size for part in np.array_split(variance, bands)])
    stated = np.sqrt(_bands(variance, bands) / count)
    below = pooled < -LIMIT * np.sqrt(variance) - ROUNDING * np.abs(pooled).mean()
    return _Seen(
        means, np.maximum(stated, means.std(axis=0, ddof=1) / np.sqrt(SEEDS)), broken, int(np.count_nonzero(below))
    )


def _bands(image: Array, bands: int) -> Array:
    return np.array([part.mean() for part in np.array_split(image, bands)])


def _judge(
    case: Case, model: str, counted: bool, means: Array, error: Array, truth: Array, truth_error: Array
) -> Result:
    size = np.abs(truth)
    noise = np.maximum(np.hypot(error, truth_error), ROUNDING * size) / size
    off = means.mean(axis=0) / truth - 1.0
    allowed = np.maximum(LIMIT * noise, case.tolerance)
    worst = int(np.argmax(np.abs(off) / allowed))
    resolves = float(2 * LIMIT * noise.max())
    verdict = MISSED if abs(off[worst]) > allowed[worst] else NOISY if resolves > case.resolves else MET
    return Result(case.name, model, verdict, counted, counted and verdict != MET, float(off[worst]), resolves)


def _short(percent: float, *, sign: bool = False) -> str:
    """Three digits at most."""
    digits = 0 if abs(percent) >= 99.5 else 1 if abs(percent) >= 9.95 else 2
    return f"{percent:{'+' if sign else ''}.{digits}f}"

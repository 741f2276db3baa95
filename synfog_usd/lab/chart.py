"""Speed against accuracy: what a model's error costs in seconds, on one shot.

Every model is run at several numbers of samples, and the model of a bake at each word of
quality, three times with different seeds.  The reference has many more samples, from other
random streams.  Leaves `chart.csv`, `chart.svg`, `chart.png` and
`notes.txt`, which says what does not hold.  Time is what this study
measures, so its files differ from run to run; the pictures behind them do not.
"""

from __future__ import annotations

import functools
import math
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from synfog_usd.base import files
from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError
from synfog_usd.base.numbers import QUALITIES, check_quality
from synfog_usd.base.progress import Progress, silent
from synfog_usd.base.seeds import seed32
from synfog_usd.dataset.plan import AS_AUTHORED, BakePlan, shots
from synfog_usd.lab import accuracy
from synfog_usd.lab.accuracy import Reference
from synfog_usd.lab.points import Point, front, line_name, table

if TYPE_CHECKING:
    from synfog_usd.render.load import MitsubaScene
    from synfog_usd.render.shot import Settings
    from synfog_usd.scene import SceneDict

NAMES = ("chart.csv", "chart.svg", "chart.png", "notes.txt")
SAMPLES, PEER_SAMPLES = (8, 32, 128, 512), (8, 32, 128)
RUNS = 3
"""Renders a point; the first of a line may have to wait for a kernel and is timed apart, all of them count for the
error.
"""
PARTS = 8
"""Independent renders that the reference is made of; their scatter is its variance."""
REFERENCE_FACTOR = 16
"""Reference samples over the largest number in the sweep: its own error is then a quarter of the smallest one of its
model.
"""
REFERENCE_SHARE = 0.45
"""Of a time limit, what is kept for the reference."""
METER_SAMPLES = 32
"""Of the clear frame by which the sensor is exposed."""
LIMIT_S = 90.0
"""Time limit where neither it nor the samples are given."""
PROBE_SAMPLES = 16
"""Samples of a probe that tells the cost of a reference, where its model is not in the sweep."""


@dataclass(frozen=True)
class ChartPlan:
    """What to sweep.

    Attributes:
        stage: the USD file.
        out: folder that receives the files.
        fog, lighting: one name each as a bake takes it; None is what the stage selects itself.
        camera: prim path; None is the stage's own choice.
        size: (width, height) in pixels.
        samples: paths per pixel, >= 2 each; None is SAMPLES, and PEER_SAMPLES for peers.
        models: names of `render.models.MODELS`; None is all that hold for the shot.
        quality: words of `numbers.QUALITIES` to show, of the model that a bake takes.
        reference_samples: of the reference; None is REFERENCE_FACTOR times the most of its model's, as far as
            time_limit goes.
        time_limit: seconds of rendering for a stage, beyond the first point of each line and without the making of
            kernels; None is LIMIT_S, or without end where samples are given.
        target: total error; the fewest samples of `auto` that reach it are marked.
        seed: the same gives the same errors.
        variant: Mitsuba backend, see `render.backend.choose`.
        allow: folders outside the stage's own in which its files may lie.
    """

    stage: Path
    out: Path
    fog: str | None = None
    lighting: str | None = None
    camera: str | None = None
    size: tuple[int, int] = (160, 90)
    samples: tuple[int, ...] | None = None
    models: tuple[str, ...] | None = None
    quality: tuple[str, ...] = tuple(QUALITIES)
    reference_samples: int | None = None
    time_limit: float | None = None
    target: float = 0.03
    seed: int = 0
    variant: str = "auto"
    allow: tuple[Path, ...] = ()


@dataclass
class Chart:
    """What one shot gave.

    Attributes:
        title: stage, lighting, fog and size.
        points: one for each line and number of samples, in that order.
        reference: the converged picture.
        notes: what was left out and why.
    """

    title: str
    points: list[Point]
    reference: Reference
    notes: list[str]


@dataclass
class _Line:
    """One model, as it is or by words of quality, as far as it has been rendered: `runs`, `seconds` and `spent`, paths
    of a pixel, by level, which are the most samples; `words` those that levels stand for.
    """

    model: str
    levels: list[int]
    runs: dict[int, list[Array]] = field(default_factory=dict)
    seconds: dict[int, list[float]] = field(default_factory=dict)
    spent: dict[int, float] = field(default_factory=dict)
    words: Mapping[int, str] = field(default_factory=dict)
    first_call_s: float = math.nan

    @property
    def name(self) -> str:
        return line_name(self.model, quality=bool(self.words))

    def estimate(self) -> float:
        """Seconds that the next level will take; 0 for the first, and half of one level for what does not grow with
        samples.
        """
        least = {samples: min(seconds) for samples, seconds in sorted(self.seconds.items())}
        if not least:
            return 0.0
        most, *before = sorted(least, reverse=True)
        slope = (least[most] - least[before[0]]) / (most - before[0]) if before else 0.5 * least[most] / most
        return RUNS * (least[most] + max(slope, 0.1 * least[most] / most) * (self.levels[0] - most))


def chart(plan: ChartPlan, *, progress: Progress = silent) -> Chart:
    """Measure the sweep of one shot and write its table, its drawings and its page.

    Args:
        plan: what to sweep.
        progress: called with what is being rendered and about how much is done.

    Raises:
        SynfogError: with place and fix, before anything is rendered.
    """
    from synfog_usd.render import backend, models

    check(plan)
    scene, shot = _scene(plan)
    backend_used = backend.start(plan.variant)  # type: ignore[arg-type]
    began = time.perf_counter()
    holding = [name for name, model in models.MODELS.items() if not model.refuses(scene)]
    notes: list[str] = []
    auto = models.choose(models.AUTO, scene)[0]
    names = dict.fromkeys(models.choose(name, scene)[0] for name in plan.models or holding)
    sweep = _lines(plan, list(names), auto, notes)
    work = _Sweep(plan, _Renders(scene, plan.size), sweep, notes, progress)
    work.render()
    reference = work.reference(next((name for name in models.ours_unbiased() if name in holding), "volpath"))
    points = _points(work.lines, reference, plan.size, backend_used.variant, auto, plan.target)
    title = f"{plan.stage.name}, {shot}, {plan.size[0]} x {plan.size[1]}"
    result = Chart(title, points, reference, notes)
    _write(result, plan.out)
    progress(f"done after {time.perf_counter() - began:.0f} s", 1.0)
    return result


class _Sweep:
    """Renders the lines of a chart from the cheapest level on, and then their reference.

    Args:
        plan: what was asked for.
        renders: the shot.
        lines: levels that are left to render; after `render` those that gave a picture.
        notes: what is left out, and why, is added.
        progress: called with what is being rendered and about how much is done.
    """

    def __init__(
        self, plan: ChartPlan, renders: _Renders, lines: list[_Line], notes: list[str], progress: Progress
    ) -> None:
        self.plan, self.renders, self.lines, self.notes, self.progress = plan, renders, lines, notes, progress
        self.limit_s = plan.time_limit or (math.inf if plan.samples else LIMIT_S)
        self.spent_s = 0.0
        self.paths, self.paths_done = RUNS * sum(sum(line.levels) for line in lines), 0

    def render(self) -> None:
        """All levels, as far as the time limit goes; a model that fails keeps what it has.

        Raises:
            ParameterError: no line gave a picture.
            RuntimeError, ValueError: what was asked for by name failed.
        """
        lines = self.lines
        while waiting := [line for line in lines if line.levels]:
            line = min(waiting, key=_Line.estimate)
            if line.runs and self.spent_s + line.estimate() > (1.0 - REFERENCE_SHARE) * self.limit_s:
                skipped = ", ".join(line.words.get(level, f"{level} samples") for level in line.levels)
                self.notes.append(f"{line.name}: {skipped} left out for time")
                line.levels = []
                continue
            samples = line.levels.pop(0)
            try:
                self._render_level(line, samples)
            except (RuntimeError, ValueError, ParameterError) as error:  # the others' chart goes on
                if self.plan.models or not lines[1:]:
                    raise
                why = str(error).splitlines()[0] if str(error) else type(error).__name__
                self.notes.append(f"{line.name}: failed at {samples} samples: {why}")
                line.levels = []
        self.lines = [line for line in lines if line.runs]
        if not self.lines:
            raise ParameterError(f"{self.plan.stage}: no model gave a picture: {'; '.join(self.notes)}")

    def _render_level(self, line: _Line, samples: int) -> None:
        word = line.words.get(samples, "")
        what = f"{line.name}, {word or f'{samples} samples'}"
        results = [self._picture(line.model, samples, run, what, self._fraction, word) for run in range(RUNS)]
        # negative estimates are cut as `render` does; the reference keeps them
        line.runs[samples] = [np.maximum(rgb, 0.0) for rgb, *_ in results]
        line.seconds[samples] = [elapsed for _, elapsed, _ in results[1:]]
        line.spent[samples] = results[0][2]
        if math.isnan(line.first_call_s):
            line.first_call_s = results[0][1]
        self.spent_s += min(line.seconds[samples]) * RUNS if len(line.runs) > 1 else 0.0
        if all(np.array_equal(rgb, line.runs[samples][0]) for rgb in line.runs[samples]):
            line.levels = []  # no seed in it: more samples are the same picture

    def _picture(
        self,
        model: str,
        samples: int,
        stream: str | int,
        what: str,
        fraction: Callable[[float], float],
        word: str = "",
    ) -> tuple[Array, float, float]:
        seed = seed32(self.plan.seed, "chart", line_name(model, quality=bool(word)), samples, stream)
        settings = self.renders.settings(model, samples, seed, word)
        result = self.renders.render(settings, lambda _, part: self.progress(what, fraction(part * samples)))
        self.paths_done += samples
        return result

    def _fraction(self, samples: float) -> float:
        """By paths, or by the time limit where that will end the sweep first."""
        by_time = self.spent_s / ((1.0 - REFERENCE_SHARE) * self.limit_s)
        return (1.0 - REFERENCE_SHARE) * min(max(by_time, (self.paths_done + samples) / self.paths), 1.0)

    def reference(self, model: str) -> Reference:
        """The converged picture by `model`."""
        count = self._reference_samples(model)
        shares = [count // PARTS + (index < count % PARTS) for index in range(PARTS)]

        def fraction(index: int) -> Callable[[float], float]:
            return lambda samples: 1.0 - REFERENCE_SHARE * (1.0 - (sum(shares[:index]) + samples) / count)

        parts = [
            self._picture(model, share, f"reference {index}", f"reference, {model}", fraction(index))[0]
            for index, share in enumerate(shares)
        ]
        return accuracy.combine(parts, shares, model)

    def _reference_samples(self, model: str) -> int:
        same = [line for line in self.lines if line.model == model]
        most = max(max(line.runs) for line in same or self.lines)
        if self.plan.reference_samples is not None:
            return self.plan.reference_samples
        if not math.isfinite(self.limit_s):
            return REFERENCE_FACTOR * most
        plain = next((line for line in same if not line.words), None)
        if plain:
            each_s = min(plain.seconds[max(plain.runs)]) / max(plain.runs)
        else:
            probes = [
                self._picture(model, PROBE_SAMPLES, run, f"probe of {model}", self._fraction)[1] for run in range(2)
            ]
            each_s = probes[-1] / PROBE_SAMPLES
        affordable = int(max(self.limit_s - self.spent_s, REFERENCE_SHARE * self.limit_s) / each_s)
        return max(min(affordable, 64 * most), 2 * most, 2 * PARTS)


def check(plan: ChartPlan) -> None:
    """Refuse numbers out of range.

    Raises:
        ParameterError: with the option, what was found and what is allowed.
    """
    from synfog_usd.base.numbers import SAMPLES
    from synfog_usd.render import models

    for name in plan.models or ():
        models.check_name(name)
    for option, value in [
        *(("--samples", value) for value in plan.samples or ()),
        ("--reference", plan.reference_samples),
    ]:
        least = 2 * PARTS if option == "--reference" else SAMPLES[0]
        if value is not None and not least <= value <= SAMPLES[1]:
            raise ParameterError(
                f"{option} {value}: outside {least} to {SAMPLES[1]}; 64 is a draft, 1024 is clean in dense fog"
            )
    for word in plan.quality:
        check_quality(word)
    if not 0.0 < plan.target <= 1.0:
        raise ParameterError(f"--target {plan.target:g}: outside 0 to 1; 0.03 is 3 %")
    if plan.time_limit is not None and not 1.0 <= plan.time_limit <= 1e6:
        raise ParameterError(f"--time-limit {plan.time_limit:g}: outside 1 to 1e6 seconds; 60 gives a draft")


def machine() -> str:
    """Processor, and how many of its cores this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return f"{platform.machine()}, {cores} core{'s' if cores > 1 else ''}"


def enough(points: Sequence[Point], line: str, target: float) -> int | None:
    """Which point of a line has the fewest samples that reach a total error; None where none does."""
    reached = [index for index, point in enumerate(points) if point.line == line and point.relative_rms <= target]
    return min(reached, key=lambda index: points[index].samples, default=None)


class _Renders:
    """Renders one scene with any model, loaded once."""

    def __init__(self, scene: SceneDict, size: tuple[int, int]) -> None:
        self.scene, self.size, self.loadings = scene, size, {}  # type: ignore[var-annotated]

    def settings(self, model: str, samples: int, seed: int, word: str) -> Settings:
        """How a point is rendered; at a word of quality as a bake does, with the phone's sensor."""
        from synfog_usd.render.sampling.adaptive import sensor_target
        from synfog_usd.render.shot import Settings

        plain = Settings(model=model, samples=samples, seed=seed, size=self.size)
        if not word:
            return plain
        quality = QUALITIES[word]
        return replace(
            plain,
            target_error=quality.error,
            target_mottle=quality.mottle,
            sensor_sigma=sensor_target(self._noise) if quality.sensor else None,
            denoise=quality.clean,
            regularize=quality.clean,
        )

    def render(self, settings: Settings, progress: Progress) -> tuple[Array, float, float]:
        """(H, W, 3) radiance as an eye's R, G and B; seconds on the loaded scene, with what the model prepares for
        itself; and the paths of a pixel that were spent.
        """
        from synfog_usd.render import models, shot
        from synfog_usd.render.spectra import bands

        loaded = self._loaded(models.MODELS[settings.model].boundaries)
        began = time.perf_counter()
        rendered = shot.render(self.scene, settings, progress=progress, loaded=loaded)
        elapsed = max(time.perf_counter() - began, 1e-3)
        rgb = bands.to_rgb(rendered.radiance.pixels, len(rendered.radiance.channels))  # type: ignore[arg-type]
        return rgb, elapsed, rendered.samples

    @functools.cached_property
    def _noise(self) -> Callable[[Array], Array]:
        """Luminance -> standard deviation of what a pixel of the phone reads [cd m-2], exposed for clear air."""
        from synfog_usd import camera
        from synfog_usd.base import resources
        from synfog_usd.render import shot

        graph = camera.load_graph(resources.folder("pipeline") / "phone.yaml")
        clear = shot.render(replace(self.scene, fog=()), samples=METER_SAMPLES, seed=1, size=self.size).radiance
        pixel = camera.sensitivity(clear, graph, camera.meter(clear, graph))
        assert pixel is not None
        return functools.partial(camera.noise_floor, electrons_per_cd_m2=pixel[0], dark_noise_e=pixel[1])

    def _loaded(self, boundaries: bool) -> MitsubaScene:
        from synfog_usd.render import shot
        from synfog_usd.render.film import aovs

        if boundaries not in self.loadings:
            self.loadings[boundaries] = shot.load(self.scene, size=self.size, boundaries=boundaries)
            aovs.measure(self.loadings[boundaries])  # makes its kernels
        return self.loadings[boundaries]


def _lines(plan: ChartPlan, names: Sequence[str], auto: str, notes: list[str]) -> list[_Line]:
    """The sweep: each model as it is, and `auto`, the model that a bake takes, also by words of quality."""
    from synfog_usd.render import denoise, models

    result = []
    for model in names:
        levels = sorted({*(plan.samples or (PEER_SAMPLES if models.MODELS[model].peer else SAMPLES))})
        result.append(_Line(model, levels))
        if plan.quality and model == auto:
            words = {QUALITIES[word].samples: word for word in plan.quality}
            line = _Line(model, sorted(words), words=words)
            if lacking := denoise.available():
                notes.append(f"{line.name}: left out, {lacking}")
            else:
                result.append(line)
    return result


def _points(
    sweep: Sequence[_Line], reference: Reference, size: tuple[int, int], variant: str, auto: str, target: float
) -> list[Point]:
    from synfog_usd.render.models import MODELS

    points = []
    assert reference.rgb is not None
    for line in sweep:
        for samples, runs in line.runs.items():
            bright = [accuracy.luminance(rgb) for rgb in runs]
            errors = accuracy.compare(bright, reference)
            points.append(
                Point(
                    line=line.name,
                    model=line.model,
                    quality=line.words.get(samples, ""),
                    unbiased=MODELS[line.model].unbiased and not line.words,
                    samples=round(line.spent[samples]),
                    seconds=min(line.seconds[samples]),
                    first_call_s=line.first_call_s,
                    relative_mse=errors.mse,
                    relative_rms=errors.rms,
                    noise_rms=errors.noise_rms,
                    bias_rms=errors.bias_rms,
                    bias_limit=errors.bias_limit,
                    bias_is_seen=errors.bias_mse > 3.0 * errors.bias_mse_error,
                    p95=errors.p95,
                    mottle=errors.mottle,
                    flip=float(np.mean([accuracy.flip(reference.rgb, rgb) for rgb in runs])),
                    bias=errors.bias,
                    bias_error=errors.bias_error,
                    mean_nits=float(np.mean(bright)),
                    on_front=False,
                    enough=False,
                    reference_rms=reference.rms,
                    reference_flip=reference.flip,
                    reference_model=reference.model,
                    reference_samples=reference.samples,
                    width=size[0],
                    height=size[1],
                    variant=variant,
                    machine=machine(),
                )
            )
    on_front = set(front([(point.seconds, max(point.relative_rms, reference.rms)) for point in points]))
    ringed = enough(points, auto, target)
    return [replace(point, on_front=index in on_front, enough=index == ringed) for index, point in enumerate(points)]


def _write(result: Chart, out: Path) -> None:
    from synfog_usd.lab import drawing

    svg, png = drawing.draw_chart(result.points, title=result.title)
    notes = "".join(f"{note}\n" for note in result.notes)
    for name, data in zip(NAMES, (table(result.points).encode(), svg, png, notes.encode()), strict=True):
        files.write_bytes(out / name, data)


def _scene(plan: ChartPlan) -> tuple[SceneDict, str]:
    """The one shot, translated, and its name."""
    from synfog_usd import stage as usd
    from synfog_usd.translate import translate

    stage = usd.open_stage(plan.stage, allow=plan.allow)
    bake_plan = BakePlan(
        plan.stage,
        plan.out,
        lighting=(plan.lighting,) if plan.lighting else None,
        fog=(plan.fog,) if plan.fog else None,
    )
    shot = shots(bake_plan, usd.variants(stage))[0]
    if plan.fog is None:
        shot = replace(shot, fog=AS_AUTHORED, fog_variant=None, fog_override=None)
    if plan.lighting is None:
        shot = replace(shot, lighting=AS_AUTHORED, lighting_variant=None)
    usd.select(stage, fog=shot.fog_variant, lighting=shot.lighting_variant)
    named = ", ".join(name for name in (shot.lighting, shot.fog) if name != AS_AUTHORED)
    scene = translate(stage, camera=plan.camera, resolution=plan.size, fog=shot.fog_override)
    return scene, named or "as authored"

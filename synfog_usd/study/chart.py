"""Speed against accuracy: what a model's error costs in seconds, on one shot.

Every model is run at several numbers of samples and compared with a reference of
many more, from other random streams.  Leaves `chart.csv`, `chart.svg` and
`chart.png`.  Time is what this study measures, so its files differ from run to
run; the pictures behind them do not.
"""

from __future__ import annotations

import csv
import io
import math
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from synfog_usd import files
from synfog_usd.constants import LUMINANCE_WEIGHTS_REC709
from synfog_usd.dataset.plan import AS_AUTHORED, BakePlan, shots
from synfog_usd.errors import ParameterError
from synfog_usd.progress import Progress, silent
from synfog_usd.seeds import seed32

if TYPE_CHECKING:
    from synfog_usd.render.load import Loaded
    from synfog_usd.scene import SceneDict

Array = npt.NDArray[np.float64]

NAMES = ("chart.csv", "chart.svg", "chart.png")
RUNS = 3
"""Renders a point; the first may have to wait for a kernel and is timed apart, all of them count for the error."""
PARTS = 8
"""Independent renders that the reference is made of; their scatter is its variance."""
REFERENCE_FACTOR = 16
"""Reference samples over the largest number in the sweep: its own error is then a quarter of the smallest one of its model."""
FLOOR = 0.01
"""Luminance that counts as dark, over the mean: a pixel's error is relative to hypot(its luminance, FLOOR x mean)."""


@dataclass(frozen=True)
class ChartPlan:
    """What to sweep.

    Attributes:
        stage: the USD file.
        out: folder that receives the three files.
        fog, lighting: one name each as a bake takes it; None is what the stage selects itself.
        camera: prim path; None is the stage's own choice.
        size: (width, height) in pixels.
        samples: paths per pixel, >= 2 each.
        models: names of `render.models.MODELS`; None is all that hold for the shot.
        reference_samples: of the reference; None is REFERENCE_FACTOR times the largest of `samples`.
        seed: the same gives the same errors.
        variant: Mitsuba backend, see `render.backend.choose`.
    """

    stage: Path
    out: Path
    fog: str | None = None
    lighting: str | None = None
    camera: str | None = None
    size: tuple[int, int] = (160, 90)
    samples: tuple[int, ...] = (4, 16, 64)
    models: tuple[str, ...] | None = None
    reference_samples: int | None = None
    seed: int = 0
    variant: str = "auto"


@dataclass(frozen=True)
class Errors:
    """How far one render is from the reference, relative and in luminance.

    Attributes:
        rms: root mean square over the pixels, without the reference's own variance; 0 where that is all there is.
        p95: 95th percentile over the pixels of the absolute difference; the reference's noise is in it.
        bias: difference of the means over the mean of the reference.
        bias_error: standard error of `bias`, with the reference's noise in it.
    """

    rms: float
    p95: float
    bias: float
    bias_error: float


@dataclass(frozen=True)
class Reference:
    """The converged picture.

    Attributes:
        luminance: (H, W) mean [cd m-2].
        variance: (H, W) variance of that mean.
        model, samples: how it was made.
    """

    luminance: Array
    variance: Array
    model: str
    samples: int

    @property
    def scale(self) -> Array:
        """(H, W) luminance that errors are relative to."""
        return np.hypot(self.luminance, FLOOR * self.luminance.mean())

    @property
    def rms(self) -> float:
        """Its own relative standard error, root mean square over the pixels."""
        return float(np.sqrt((self.variance / self.scale**2).mean()))


@dataclass(frozen=True)
class Point:
    """One model at one number of samples: a row of `chart.csv`.

    Attributes:
        model, samples: what was run.
        seconds: wall time of a render whose kernel is there already: the least of RUNS - 1, since other work on the machine only adds to it.
        first_call_s: wall time of the first render; what it has over `seconds` is the making of the kernel, or reading it from Dr.Jit's
            cache on disk, and comes once for each model.
        relative_rms, p95, bias, bias_error: see `Errors`.
        mean_nits: mean luminance of the renders.
        reference_rms, reference_model, reference_samples: see `Reference`.
        variant, machine: where it ran.
    """

    model: str
    samples: int
    seconds: float
    first_call_s: float
    relative_rms: float
    p95: float
    bias: float
    bias_error: float
    mean_nits: float
    reference_rms: float
    reference_model: str
    reference_samples: int
    variant: str
    machine: str


def chart(plan: ChartPlan, *, progress: Progress = silent) -> list[Point]:
    """Measure the sweep and write its table and its two drawings.

    Args:
        plan: what to sweep.
        progress: told the fraction of all paths that is done.

    Returns:
        one point for each model and number of samples, in that order.

    Raises:
        SynfogError: with place and fix, before anything is rendered.
    """
    from synfog_usd.render import backend, models

    for name in plan.models or ():
        models.check_name(name)
    _check_samples(plan)
    scene, shot = _scene(plan)
    chosen = backend.start(plan.variant)  # type: ignore[arg-type]
    holding = [name for name, model in models.MODELS.items() if not model.refuses(scene)]
    names = list(dict.fromkeys(models.choose(name, scene)[0] for name in plan.models or holding))
    best, _ = models.choose(models.AUTO, scene)
    reference_samples = plan.reference_samples or REFERENCE_FACTOR * max(plan.samples)
    total, done = reference_samples + RUNS * len(names) * sum(set(plan.samples)), 0
    exposures = {name: _exposure(scene, name, plan.size) for name in {best: None, **dict.fromkeys(names)}}

    def picture(name: str, samples: int, stream: str | int, what: str) -> tuple[Array, float]:
        nonlocal done
        seed = seed32(plan.seed, "chart", name, samples, stream)
        began = time.perf_counter()
        luminance = exposures[name](samples, seed, lambda _, fraction: progress(what, (done + fraction * samples) / total))
        done += samples
        return luminance, time.perf_counter() - began

    sweep = {
        (name, samples): [picture(name, samples, run, f"{name}, {samples} samples") for run in range(RUNS)]
        for name in names
        for samples in sorted(set(plan.samples))
    }
    shares = _shares(reference_samples, PARTS)  # last, so that no model finds its kernel made by it
    reference = combine([picture(best, share, f"reference {index}", "reference")[0] for index, share in enumerate(shares)], shares, best)
    points = []
    for (name, samples), renders in sweep.items():
        errors = compare([luminance for luminance, _ in renders], reference)
        seconds = [elapsed for _, elapsed in renders]
        points.append(
            Point(
                model=name,
                samples=samples,
                seconds=min(seconds[1:]),
                first_call_s=seconds[0],
                relative_rms=errors.rms,
                p95=errors.p95,
                bias=errors.bias,
                bias_error=errors.bias_error,
                mean_nits=float(np.mean([luminance.mean() for luminance, _ in renders])),
                reference_rms=reference.rms,
                reference_model=best,
                reference_samples=reference_samples,
                variant=chosen.variant,
                machine=machine(),
            )
        )
    title = f"{plan.stage.name}, {shot}, {plan.size[0]} x {plan.size[1]}"
    files.write_bytes(plan.out / NAMES[0], table(points).encode())
    for name, data in zip(NAMES[1:], draw(points, title=title), strict=True):
        files.write_bytes(plan.out / name, data)
    progress("done", 1.0)
    return points


def combine(parts: Sequence[Array], samples: Sequence[int], model: str) -> Reference:
    """The mean of independent renders, and its variance by their scatter.

    Args:
        parts: K >= 2 pictures (H, W).
        samples: paths per pixel of each; unequal ones are weighted by it.

    The weighted scatter is unbiased: with weights w that sum to 1 and a variance
    of s / n for each part, E[sum w (x - mean)^2] is (K - 1) times the mean's.
    """
    weights = np.asarray(samples, dtype=np.float64)[:, None, None] / sum(samples)
    stack = np.stack(parts).astype(np.float64)
    mean = (weights * stack).sum(axis=0)
    variance = (weights * (stack - mean) ** 2).sum(axis=0) / (len(parts) - 1)
    return Reference(mean, variance, model, sum(samples))


def compare(pictures: Sequence[Array], reference: Reference) -> Errors:
    """Errors of one render, averaged over independent ones.

    Args:
        pictures: luminance (H, W) of renders with seeds of their own.

    The squared difference from the reference holds both variances, so the
    reference's is taken off.  Its noise stays in what errors are relative to: with
    a relative error o of its own, `rms` is too large by a share of about
    1.5 o^2 + 3 o^4 / rms^2, 1.5 % for o = 0.1 and an `rms` above 0.5.  Pixels are independent: the scatter of their
    differences gives the standard error of the mean difference.  It takes the
    scatter between pixels for noise; a bias that differs between pixels makes it
    too large, never too small.
    """
    difference = np.stack(pictures).astype(np.float64) - reference.luminance
    relative = difference / reference.scale
    square = (relative**2).mean() - (reference.variance / reference.scale**2).mean()
    shift, level = difference.mean(axis=0), reference.luminance.mean()
    return Errors(
        rms=math.sqrt(max(float(square), 0.0)),
        p95=float(np.percentile(np.abs(relative), 95)),
        bias=float(shift.mean() / level),
        bias_error=float(shift.std(ddof=1) / math.sqrt(shift.size) / level),
    )


def table(points: Sequence[Point]) -> str:
    """The points as CSV with a header; numbers have five digits."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(Point)], lineterminator="\n")
    writer.writeheader()
    for point in points:
        writer.writerow({name: f"{value:.5g}" if isinstance(value, float) else value for name, value in asdict(point).items()})
    return text.getvalue()


def machine() -> str:
    """Processor, and how many of its cores this process may use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return f"{platform.machine()}, {cores} core{'s' if cores > 1 else ''}"


def draw(points: Sequence[Point], *, title: str) -> tuple[bytes, bytes]:
    """Seconds against relative error, both logarithmic, one line a model: (SVG, PNG)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    style = {"font.family": "DejaVu Sans", "font.size": 10, "svg.fonttype": "none", "svg.hashsalt": "synfog-usd", "axes.edgecolor": INK, "text.color": INK}
    with pyplot.rc_context({**style, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK}):
        figure, axes = pyplot.subplots(figsize=(7.2, 4.6), layout="constrained")
        first = points[0]
        shown = [point for point in points if point.relative_rms > 0.0]
        for index, name in enumerate(dict.fromkeys(point.model for point in shown)):
            line = [point for point in shown if point.model == name]
            colour = COLOURS[index % len(COLOURS)]
            axes.plot([p.seconds for p in line], [p.relative_rms for p in line], "o-", color=colour, lw=1.8, ms=6, mec="white", mew=1.0, label=name, zorder=3)
            for point in line:
                axes.annotate(f"{point.samples}", (point.seconds, point.relative_rms), (6, 5), textcoords="offset points", color=colour, fontsize=9)
        axes.set(xscale="log", yscale="log", xlabel="seconds for one render, kernel made before", ylabel="relative RMS error of a pixel's luminance")
        errors, times = [p.relative_rms for p in shown] + [first.reference_rms], [p.seconds for p in points]
        axes.set_ylim(min(errors) / 1.6, max(errors) * 1.6)
        axes.set_xlim(min(times) / 1.4, max(times) * 1.5)
        axes.axhspan(axes.get_ylim()[0], first.reference_rms, color="0.5", alpha=0.16, lw=0, zorder=0, label="the reference's own error")
        axes.grid(which="major", color="0.86", lw=0.7)
        for axis, text in ((axes.xaxis, lambda value, _: f"{value:g}"), (axes.yaxis, lambda value, _: f"{100 * value:g} %")):
            axis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0), numticks=20))
            axis.set_major_formatter(FuncFormatter(text))
            axis.set_minor_formatter(NullFormatter())
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_title(title, loc="left", fontsize=11)
        below = f"labels: paths per pixel   reference: {first.reference_model}, {first.reference_samples} paths per pixel   {first.variant}, {first.machine}"
        figure.supxlabel(below, fontsize=8, color="0.4")
        axes.legend(frameon=False)
        drawn = _saved(figure, "svg", metadata={"Date": None}), _saved(figure, "png", dpi=150)
        pyplot.close(figure)
    return drawn


INK = "#22262a"
COLOURS = ("#0b6e99", "#c4501b", "#5a7d2a", "#7a4fa3")


def _saved(figure: Any, kind: str, **more: Any) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, format=kind, **more)
    return data.getvalue()


def _check_samples(plan: ChartPlan) -> None:
    for option, value in [*(("--samples", value) for value in plan.samples), ("--reference", plan.reference_samples)]:
        least = 2 * PARTS if option == "--reference" else 2
        if value is not None and not least <= value <= 1 << 20:
            raise ParameterError(f"{option} {value}: outside {least} to {1 << 20}; 64 is a draft, 1024 is clean in dense fog")


def _scene(plan: ChartPlan) -> tuple[SceneDict, str]:
    """The one shot, translated, and what it is called."""
    from synfog_usd import stage as usd
    from synfog_usd.translate import translate

    stage = usd.open_stage(plan.stage)
    asked = BakePlan(plan.stage, plan.out, lighting=(plan.lighting,) if plan.lighting else None, fog=(plan.fog,) if plan.fog else None)
    shot = shots(asked, usd.variants(stage))[0]
    if plan.fog is None:
        shot = replace(shot, fog=AS_AUTHORED, fog_variant=None, mor_m=None)
    if plan.lighting is None:
        shot = replace(shot, lighting=AS_AUTHORED, lighting_variant=None)
    usd.select(stage, fog=shot.fog_variant, lighting=shot.lighting_variant)
    return translate(stage, camera=plan.camera, resolution=plan.size, fog_mor_m=shot.mor_m), shot.folder


def _exposure(scene: SceneDict, name: str, size: tuple[int, int]) -> Callable[[int, int, Progress], Array]:
    """A function of samples and seed that renders with one model and waits for the picture; loading is done once, here."""
    from synfog_usd.render import film, models
    from synfog_usd.render.shot import load

    loaded: Loaded = load(scene, size=size, boundaries=models.MODELS[name].boundaries)
    integrator = models.MODELS[name].make(loaded)

    def expose(samples: int, seed: int, progress: Progress) -> Array:
        mean, _, _ = film.expose(loaded, integrator, samples=samples, seed=seed, progress=progress)
        return mean @ np.array(LUMINANCE_WEIGHTS_REC709)

    return expose


def _shares(total: int, parts: int) -> list[int]:
    return [total // parts + (index < total % parts) for index in range(parts)]

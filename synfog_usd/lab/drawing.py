"""Charts of seconds against error.

Takes the points of `points`; gives SVG and PNG bytes, the same each time.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import TYPE_CHECKING

from synfog_usd.lab.points import ERROR, MOTTLE, Point, front, lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, FAINT, GRID, PAPER = "#22262a", "#666b70", "#dcdfe2", "#ffffff"
LOOKS = {
    "path": ("#0b5fa5", "o"),
    "volpath": ("#c1440e", "^"),
    "volpathmis": ("#c98100", "v"),
    "single": ("#7d8a00", "P"),
}
"""Model -> colour and marker: blue what is unbiased, orange the peers, others what leaves something out."""
OTHER = (("#5f6870", "*"), ("#3d4a99", "<"), ("#99693d", ">"))
AXES = {
    ERROR: "total relative error of a pixel's luminance, RMS",
    MOTTLE: "mottle: noise, blurred by 1/40 of the width",
}
SECONDS = "seconds for one render, scene loaded, kernel made before"
STYLE = {"font.family": "DejaVu Sans", "font.size": 10, "svg.fonttype": "none", "svg.hashsalt": "synfog-usd"}
COLOUR_KEYS = ("axes.edgecolor", "text.color", "axes.labelcolor", "xtick.color", "ytick.color")


def look(model: str) -> tuple[str, str]:
    """Colour and marker of a model, the same in each chart."""
    return LOOKS.get(model) or OTHER[sum(model.encode()) % len(OTHER)]


def draw_chart(points: Sequence[Point], *, title: str) -> tuple[bytes, bytes]:
    """Seconds against total error, beside it noise and bias of each line at its most samples, and below it seconds
    against mottle: (SVG, PNG).
    """
    pyplot = _pyplot()
    by_line = _drawable(points, ERROR)
    first = points[0]
    with pyplot.rc_context({**STYLE, **dict.fromkeys(COLOUR_KEYS, INK)}):
        width = 7.0 + max(2.7, 0.36 * len(by_line) + 0.5)
        figure = pyplot.figure(figsize=(width, 9.6), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(7.0, width - 7.0), height_ratios=(5.6, 4.0), wspace=0.03)
        axes = figure.add_subplot(grid[0, 0])
        aside = figure.add_subplot(grid[0, 1], sharey=axes)
        clouds = figure.add_subplot(grid[1, 0], sharex=axes)
        for each, measure in ((axes, ERROR), (clouds, MOTTLE)):
            _panel(each, points, measure)
        clouds.set_xlabel(SECONDS)
        axes.set_title(title, loc="left", fontsize=11.5, fontweight="bold", pad=22)
        aside.tick_params(labelleft=False)
        _aside(aside, by_line, first)
        below = (
            f"numbers at the marks: paths per pixel; reference: {first.reference_model}, {first.reference_samples}; "
            f"{first.variant}, {first.machine}"
        )
        axes.annotate(
            below,
            (0.0, 1.0),
            (0.0, 8.0),
            xycoords="axes fraction",
            textcoords="offset points",
            fontsize=8.5,
            color=FAINT,
        )
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower left", ncols=4, frameon=False, fontsize=8.5)
        return _both(pyplot, figure)


def _drawable(points: Sequence[Point], measure: str) -> dict[str, list[Point]]:
    """Points by line that have a place on an axis of logarithms."""
    by_line = {name: [point for point in line if point.amount(measure) > 0.0] for name, line in lines(points).items()}
    return {name: line for name, line in by_line.items() if line}


def _panel(axes: Axes, points: Sequence[Point], measure: str) -> None:
    """Seconds against a measure; beside each mark its number of samples, or its word."""
    by_line = _drawable(points, measure)
    _scales(axes, [point for line in by_line.values() for point in line] or points, points[0], measure)
    _front(axes, points, measure)
    for name, line in by_line.items():
        colour, marker = look(line[0].model)
        dash, face, edge = ("--", PAPER, colour) if "," in name else ("-", colour, PAPER)
        x, y = [point.seconds for point in line], [point.amount(measure) for point in line]
        axes.plot(x, y, dash + marker, color=colour, lw=1.7, ms=8.5, mfc=face, mec=edge, zorder=3, label=name)
        for point in line:
            at = (point.seconds, point.amount(measure))
            axes.annotate(point.mark, at, (5, 5), textcoords="offset points", fontsize=8.0, color=colour)
    ringed = [point for point in points if point.enough and measure == ERROR]
    if ringed:
        x, y = [point.seconds for point in ringed], [point.relative_rms for point in ringed]
        axes.plot(x, y, "o", ms=17, mfc="none", mec=INK, mew=1.5, zorder=6, label="enough for the error asked for")
    axes.set_ylabel(AXES[measure])


def _pyplot() -> ModuleType:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def _scales(axes: Axes, shown: Sequence[Point], first: Point, measure: str) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log")
    errors, times = [p.amount(measure) for p in shown], [p.seconds for p in shown]
    smallest, bottom = min(errors), min(errors) / 1.7
    if measure == ERROR:
        smallest = min([smallest, *(p.bias_rms for p in shown if p.bias_is_seen)])
        bottom = max(min(smallest, first.reference_rms), min(smallest, 1.0) / 8.0) / 1.7
    axes.set_ylim(bottom, max(errors) * 1.7)
    axes.set_xlim(min(times) / 1.6, max(times) * 2.4)
    if measure == ERROR:
        error, name = first.reference_rms, "reference's own error"
        axes.axhspan(bottom / 100, error, color="#8a9096", alpha=0.22, lw=0, zorder=0, label=name)
    axes.grid(which="major", color=GRID, lw=0.7)
    spread_x, spread_y = math.log10(max(times) / min(times) * 2), math.log10(max(errors) / bottom)
    for axis, spread, text in (
        (axes.xaxis, spread_x, lambda value, _: f"{value:g}"),
        (axes.yaxis, spread_y, lambda value, _: f"{100 * value:g} %"),
    ):
        subs = (1.0, 2.0, 5.0) if spread < 2.4 else (1.0, 3.0)
        axis.set_major_locator(LogLocator(base=10, subs=subs, numticks=20))
        axis.set_major_formatter(FuncFormatter(text))
        axis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()
    axes.spines[["top", "right"]].set_visible(False)


def _front(axes: Axes, points: Sequence[Point], measure: str) -> None:
    """The steps from one point that nothing beats to the next."""
    least = points[0].reference_rms if measure == ERROR else 0.0
    shown = [point for point in points if point.amount(measure) > 0.0 and point.counts(measure)]
    best = [shown[index] for index in front([(point.seconds, max(point.amount(measure), least)) for point in shown])]
    if not best:
        return
    heights = [axes.get_ylim()[1], *(max(point.amount(measure), least) for point in best)]
    ends = [*(point.seconds for point in best[1:]), axes.get_xlim()[1]]
    corners = [(best[0].seconds, heights[0])]
    for point, height, end in zip(best, heights[1:], ends, strict=True):
        corners += [(point.seconds, height), (end, height)]
    label = "Pareto front: nothing is faster and closer"
    axes.plot(*zip(*corners, strict=True), color=INK, lw=1.0, alpha=0.8, zorder=2, label=label)


def _aside(axes: Axes, by_line: Mapping[str, Sequence[Point]], first: Point) -> None:
    """Noise and bias of each line at its most samples, on the error axis."""
    axes.set_xlim(-0.7, max(len(by_line) - 0.3, 1.7))
    axes.axhspan(axes.get_ylim()[0] / 100, first.reference_rms, color="#8a9096", alpha=0.22, lw=0, zorder=0)
    axes.grid(axis="y", which="major", color=GRID, lw=0.7)
    low = axes.get_ylim()[0]
    for index, line in enumerate(by_line.values()):
        point = line[-1]
        colour, _ = look(point.model)
        bias = max(point.bias_rms if point.bias_is_seen else point.bias_limit, low * 1.08)
        noise = max(point.noise_rms, low * 1.08)
        axes.plot([index, index], [bias, noise], color=colour, lw=1.2, alpha=0.5, zorder=2)
        axes.plot([index], [noise], "o", ms=7, mfc=PAPER, mec=colour, mew=1.6, zorder=3)
        if point.bias_is_seen:
            axes.plot([index], [bias], "D", ms=7, color=colour, mec=PAPER, mew=0.8, zorder=4)
        else:
            axes.plot([index], [bias], marker="$↓$", ms=9, color=colour, ls="", zorder=4)
    axes.set_xticks(range(len(by_line)), list(by_line), rotation=48, ha="right", rotation_mode="anchor", fontsize=8.5)
    for tick, line in zip(axes.get_xticklabels(), by_line.values(), strict=True):
        tick.set_color(look(line[0].model)[0])
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.set_title("At the most samples\n○ noise   ◆ bias   ↓ bias below", loc="left", fontsize=9.5)


def _both(pyplot: ModuleType, figure: Figure) -> tuple[bytes, bytes]:
    result = []
    for kind, more in (("svg", {"metadata": {"Date": None}}), ("png", {"dpi": 150, "metadata": {"Software": None}})):
        data = io.BytesIO()
        figure.savefig(data, format=kind, facecolor=PAPER if kind == "png" else "none", **more)
        result.append(data.getvalue())
    pyplot.close(figure)
    return result[0], result[1]

"""Charts of seconds against error, drawn so that no label lies on another.

Takes the points of `points`; gives SVG and PNG bytes, the same each time.
"""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from synfog_usd.lab.study.points import ERROR, MOTTLE, Point, front, lines

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
DARK = {
    INK: "#e6e8ea",
    FAINT: "#9aa0a6",
    GRID: "#3a3f44",
    PAPER: "#16191c",
    "#0b5fa5": "#5aa9ec",
    "#c1440e": "#ff8a5c",
    "#c98100": "#f2b33d",
    "#7d8a00": "#c3d04a",
}
"""What each colour becomes on a dark page."""
OTHER = (("#5f6870", "*"), ("#3d4a99", "<"), ("#99693d", ">"))
DIRECTIONS = tuple(
    (dx / 2, dy / 2) for dx in (2, 1, 0, -1, -2) for dy in (0, 1, -1, 2, -2) if max(abs(dx), abs(dy)) == 2
)
"""Where a label may stand beside its mark, to the right of it first."""
DASHES = ("-", "--", ":", "-.")
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
        steps = {measure: _panel(each, points, measure) for each, measure in ((axes, ERROR), (clouds, MOTTLE))}
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
        figure.canvas.draw()
        figure.set_layout_engine("none")
        _label(axes, points, steps[ERROR], ERROR)
        _label(clouds, points, steps[MOTTLE], MOTTLE)
        return _both(pyplot, figure)


def _drawable(points: Sequence[Point], measure: str) -> dict[str, list[Point]]:
    """Points by line that have a place on an axis of logarithms."""
    by_line = {name: [point for point in line if point.amount(measure) > 0.0] for name, line in lines(points).items()}
    return {name: line for name, line in by_line.items() if line}


def _panel(axes: Axes, points: Sequence[Point], measure: str) -> list[tuple[float, float]]:
    """Draw seconds against a measure; gives the corners of the front."""
    by_line, names = _drawable(points, measure), list(lines(points))
    _scales(axes, [point for line in by_line.values() for point in line] or points, points[0], measure)
    steps = _front(axes, points, measure)
    for name, line in by_line.items():
        colour, marker = look(line[0].model)
        dash = _dash(name, names)
        axes.plot([p.seconds for p in line], [p.amount(measure) for p in line], dash, color=colour, lw=1.7, zorder=3)
        for point in line:
            _marker(axes, point, measure, colour, marker, hollow=dash != "-")
    chosen = [point for point in points if point.enough and measure == ERROR]
    if chosen:
        axes.plot(
            [p.seconds for p in chosen],
            [p.relative_rms for p in chosen],
            "o",
            ms=17,
            mfc="none",
            mec=INK,
            mew=1.6,
            zorder=6,
            label="enough for the error asked for",
        )
    axes.set_ylabel(AXES[measure])
    return steps


def draw_suite(stages: Mapping[str, Sequence[Point]], measure: str = ERROR) -> tuple[bytes, bytes]:
    """One small chart a stage on common axes, colours named once: (SVG, PNG)."""
    pyplot = _pyplot()
    columns = min(3, len(stages))
    rows = math.ceil(len(stages) / columns)
    with pyplot.rc_context({**STYLE, **dict.fromkeys(COLOUR_KEYS, INK), "font.size": 9}):
        figure, grid = pyplot.subplots(
            rows,
            columns,
            figsize=(3.5 * columns + 0.4, 2.9 * rows + 0.7),
            layout="constrained",
            sharex=True,
            sharey=True,
            squeeze=False,
        )
        for axes in grid.flat[len(stages) :]:
            axes.set_visible(False)
        for index, (axes, name) in enumerate(zip(grid.flat, stages, strict=False)):
            _small_panel(axes, stages, name, measure)
            axes.tick_params(labelbottom=index + columns >= len(stages))
        figure.supxlabel(SECONDS, fontsize=9.5)
        figure.supylabel(AXES[measure], fontsize=9.5)
        handles = _handles([point for points in stages.values() for point in points], measure)
        figure.legend(
            handles=handles,
            loc="outside upper center",
            ncols=min(len(handles), max(3, 2 * columns)),
            frameon=False,
            fontsize=9,
        )
        return _both(pyplot, figure)


def _small_panel(axes: Axes, stages: Mapping[str, Sequence[Point]], name: str, measure: str) -> None:
    """One stage of a suite."""
    everything, points = [point for each in stages.values() for point in each], stages[name]
    _scales(
        axes,
        [p for p in everything if p.amount(measure) > 0.0] or everything,
        points[0],
        measure,
        lowest=min(p.reference_rms for p in everything),
        dense=False,
    )
    _front(axes, points, measure)
    by_line = lines(points)
    for line_name, line in by_line.items():
        colour, marker = look(line[0].model)
        shown = [p for p in line if p.amount(measure) > 0.0]
        dash = _dash(line_name, by_line)
        axes.plot(
            [p.seconds for p in shown],
            [p.amount(measure) for p in shown],
            dash + marker,
            color=colour,
            lw=1.3,
            ms=4.5,
            mfc=colour if dash == "-" else PAPER,
            zorder=3,
        )
    ringed = [p for p in points if p.enough and measure == ERROR]
    ring: dict[str, Any] = {"ms": 12, "mfc": "none", "mec": INK, "mew": 1.3, "zorder": 6}
    axes.plot([p.seconds for p in ringed], [p.relative_rms for p in ringed], "o", **ring)
    axes.set_title(name, loc="left", fontsize=10, fontweight="bold")


def _handles(points: Sequence[Point], measure: str) -> list[Any]:
    """What the legend of a suite names: each line, and what else is drawn."""
    from matplotlib.lines import Line2D

    handles, names = [], list(lines(points))
    for name in names:
        colour, marker = look(next(p for p in points if p.line == name).model)
        dash = _dash(name, names)
        fill = colour if dash == "-" else PAPER
        handles.append(Line2D([], [], color=colour, marker=marker, ls=dash, ms=5, lw=1.4, mfc=fill, label=name))
    handles.append(Line2D([], [], color=INK, lw=1.0, label="Pareto front"))
    if measure == ERROR:
        handles.append(Line2D([], [], color="#bfc3c7", lw=6, label="reference's own error"))
    if measure == ERROR and any(point.enough for point in points):
        ring: dict[str, Any] = {"marker": "o", "ms": 10, "mfc": "none", "ls": ""}
        handles.append(Line2D([], [], color=INK, label="enough for the error asked for", **ring))
    return handles


def themed(svg: str) -> str:
    """An SVG for the inside of a page: its colours become the page's variables, its header and metadata go."""
    body = svg[svg.index("<svg") :]
    if "<metadata>" in body:
        body = body[: body.index("<metadata>")] + body[body.index("</metadata>") + len("</metadata>") :]
    for colour in DARK:
        body = body.replace(colour, f"var(--{colour[1:]})")
    return body


def theme() -> str:
    """The CSS variables that `themed` names, on light and dark."""
    light = "".join(f"--{colour[1:]}:{colour};" for colour in DARK)
    dark = "".join(f"--{colour[1:]}:{dark_colour};" for colour, dark_colour in DARK.items())
    return f":root{{color-scheme:light dark;{light}}}@media(prefers-color-scheme:dark){{:root{{{dark}}}}}"


def point_id(point: Point, measure: str) -> str:
    """The name of a point's marker in the SVG."""
    return f"{measure}-" + "".join(c if c.isalnum() else "-" for c in point.line) + f"-{point.mark}"


def percent(value: float) -> str:
    """Three digits: '0.52 %', '12.3 %', '2440 %'."""
    return f"{100 * value:.0f} %" if abs(value) >= 1.0 else f"{100 * value:.3g} %"


def duration(value: float) -> str:
    """Two or three digits in the unit that fits: '0.43 s', '12 s', '7.5 min', '40 h'."""
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if value >= 2.0 * size:
            return f"{value / size:,.0f} {unit}" if value >= 10.0 * size else f"{value / size:.1f} {unit}"
    return f"{value:.0f} s" if value >= 9.95 else f"{value:.2g} s"


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def _dash(name: str, names: Iterable[str]) -> str:
    """Solid for a model as it is; its settings in turn."""
    model = name.partition(",")[0]
    if name == model:
        return DASHES[0]
    return DASHES[1 + [sibling for sibling in names if sibling.startswith(model + ",")].index(name) % (len(DASHES) - 1)]


def _scales(
    axes: Axes, shown: Sequence[Point], first: Point, measure: str, *, lowest: float | None = None, dense: bool = True
) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log")
    errors, times = [p.amount(measure) for p in shown], [p.seconds for p in shown]
    smallest, bottom = min(errors), min(errors) / 1.7
    if measure == ERROR:
        smallest = min([smallest, *([p.bias_rms for p in shown if p.bias_is_seen] if dense else [])])
        bottom = max(min(smallest, lowest or first.reference_rms), min(smallest, 1.0) / 8.0) / 1.7
    axes.set_ylim(bottom, max(errors) * 1.7)
    axes.set_xlim(min(times) / 1.6, max(times) * (2.4 if dense else 1.5))
    if measure == ERROR:
        error, name = first.reference_rms, "reference's own error"
        axes.axhspan(bottom / 100, error, color="#8a9096", alpha=0.22, lw=0, zorder=0, label=name)
    axes.grid(which="major", color=GRID, lw=0.7)
    spread_x, spread_y = math.log10(max(times) / min(times) * 2), math.log10(max(errors) / bottom)
    for axis, spread, text in (
        (axes.xaxis, spread_x, lambda value, _: f"{value:g}"),
        (axes.yaxis, spread_y, lambda value, _: f"{100 * value:g} %"),
    ):
        axis.set_major_locator(
            LogLocator(
                base=10,
                subs=(1.0, 2.0, 5.0) if spread < (2.4 if dense else 1.6) else (1.0, 3.0) if dense else (1.0,),
                numticks=20,
            )
        )
        axis.set_major_formatter(FuncFormatter(text))
        axis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()
    axes.spines[["top", "right"]].set_visible(False)


def _front(axes: Axes, points: Sequence[Point], measure: str) -> list[tuple[float, float]]:
    """Draw the steps from one point that nothing beats to the next; gives their corners."""
    least = points[0].reference_rms if measure == ERROR else 0.0
    shown = [point for point in points if point.amount(measure) > 0.0 and point.counts(measure)]
    best = [shown[index] for index in front([(point.seconds, max(point.amount(measure), least)) for point in shown])]
    if not best:
        return []
    heights = [axes.get_ylim()[1], *(max(point.amount(measure), least) for point in best)]
    ends = [*(point.seconds for point in best[1:]), axes.get_xlim()[1]]
    corners = [(best[0].seconds, heights[0])]
    for point, height, end in zip(best, heights[1:], ends, strict=True):
        corners += [(point.seconds, height), (end, height)]
    axes.plot(
        *zip(*corners, strict=True),
        color=INK,
        lw=1.0,
        alpha=0.8,
        zorder=2,
        label="Pareto front: nothing is faster and closer",
    )
    return corners


def _marker(axes: Axes, point: Point, measure: str, colour: str, marker: str, *, hollow: bool) -> None:
    face, edge = (PAPER, colour) if hollow else (colour, PAPER)
    size = 7.5 if marker in "sD" else 8.5
    axes.plot(
        [point.seconds],
        [point.amount(measure)],
        marker,
        color=colour,
        ms=size - hollow,
        mfc=face,
        mec=edge,
        mew=1.3 if hollow else 0.9,
        zorder=4,
        gid=point_id(point, measure),
    )


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


def _label(axes: Axes, points: Sequence[Point], steps: Sequence[tuple[float, float]], measure: str) -> None:
    """Names at the ends of lines, then words and numbers of samples where there is room for them."""
    labels = _Labels(axes, _drawable(points, measure), steps, measure)
    for name, line in sorted(labels.by_line.items(), key=lambda item: -item[1][-1].seconds):
        labels.put(line[-1], name, required=True, fontsize=10.0, fontweight="bold")
    for line in labels.by_line.values():
        for point in dict.fromkeys((line[-1], line[0], *line[1:-1])):
            labels.put(point, point.mark, required=False, fontsize=8.0, fontweight="normal")


class _Labels:
    """Labels beside marks, each where it covers no mark, no other label, and as little as possible of the lines.

    Args:
        axes: whose scales are final.
        by_line: marks.
        steps: corners of the front [data].
        measure: of the axis.
    """

    def __init__(
        self, axes: Axes, by_line: dict[str, list[Point]], steps: Sequence[tuple[float, float]], measure: str
    ) -> None:
        self.axes, self.by_line, self.measure = axes, by_line, measure
        canvas: Any = axes.figure.canvas
        self.renderer, self.unit = canvas.get_renderer(), axes.figure.dpi / 72.0  # pixels of a point
        to_pixels = axes.transData.transform
        self.marks: dict[int, Any] = {
            id(point): to_pixels((point.seconds, point.amount(measure))) for line in by_line.values() for point in line
        }
        self.boxes: list[tuple[float, float, float, float]] = []
        for point in (point for line in by_line.values() for point in line):
            reach = (10.0 if point.enough else 5.0) * self.unit
            x, y = self.marks[id(point)]
            self.boxes.append((x - reach, y - reach, x + reach, y + reach))
        self.strokes: list[tuple[float, float]] = []
        paths = [[self.marks[id(point)] for point in line] for line in by_line.values()]
        for path in [*paths, [to_pixels(corner) for corner in steps]]:
            for (x0, y0), (x1, y1) in itertools.pairwise(path):
                count = max(2, int(math.hypot(x1 - x0, y1 - y0) / (3 * self.unit)))
                self.strokes += [(x0 + (x1 - x0) * i / count, y0 + (y1 - y0) * i / count) for i in range(count + 1)]
        frame, margin = axes.get_window_extent(self.renderer), 2 * self.unit
        self.frame = (frame.x0 + margin, frame.y0 + margin, frame.x1 - margin, frame.y1 - margin)

    def put(self, point: Point, text: str, *, required: bool, **font: Any) -> None:
        """Write beside a mark; where there is no room, not at all unless `required`."""
        colour = look(point.model)[0]
        at = (point.seconds, point.amount(self.measure))
        label = self.axes.annotate(text, at, (0, 0), textcoords="offset points", color=colour, zorder=7, **font)
        extent = label.get_window_extent(self.renderer)
        best = min(self._candidates(point, extent.width, extent.height, required), default=None, key=lambda one: one[0])
        if best is None or (best[0] >= 1.2 and not required):
            label.remove()
            return
        _, box, distance = best
        self.boxes.append(box)
        label.set_position(((box[0] + self.unit - extent.x0) / self.unit, (box[1] - extent.y0) / self.unit))
        if distance > 20.0:
            end = self.axes.transData.inverted().transform(_nearest(box, self.marks[id(point)]))
            self.axes.plot([at[0], end[0]], [at[1], end[1]], color=colour, lw=0.7, alpha=0.7, zorder=2)

    def _candidates(
        self, point: Point, width: float, height: float, required: bool
    ) -> Iterator[tuple[float, tuple[float, float, float, float], float]]:
        """(cost, box [px], distance [points]) within the frame."""
        x, y = self.marks[id(point)]
        mine = {id(mark) for mark in self.by_line[point.line]}
        foreign = [place for key, place in self.marks.items() if key not in mine]
        for distance in (7.0, 10.0, 15.0, 22.0, 32.0, 44.0, 60.0) if required else (6.5, 9.0):
            for dx, dy in DIRECTIONS:
                reach = distance * self.unit / math.hypot(dx, dy)
                x0 = x + dx * reach - width * (0.5 - 0.5 * dx)
                low = y + dy * reach - height * (0.5 - 0.5 * dy)
                box = (x0 - self.unit, low, x0 + width + self.unit, low + height)
                inside = self.frame
                if box[0] < inside[0] or box[1] < inside[1] or box[2] > inside[2] or box[3] > inside[3]:
                    continue
                covered = sum(_overlap(box, label_box) for label_box in self.boxes)
                cost = 10.0 * covered + 0.2 * sum(_holds(box, place) for place in self.strokes) + distance / 20.0
                to_foreign = min((math.dist(_nearest(box, place), place) for place in foreign), default=math.inf)
                if math.dist(_nearest(box, (x, y)), (x, y)) > to_foreign:
                    cost += 3.0  # it would be read as another line's
                yield cost, box, distance


def _overlap(a: Sequence[float], b: Sequence[float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _holds(box: Sequence[float], place: Sequence[float]) -> bool:
    return box[0] < place[0] < box[2] and box[1] < place[1] < box[3]


def _nearest(box: Sequence[float], place: Sequence[float]) -> tuple[float, float]:
    return min(max(place[0], box[0]), box[2]), min(max(place[1], box[1]), box[3])


def _both(pyplot: Any, figure: Figure) -> tuple[bytes, bytes]:
    result = []
    for kind, more in (("svg", {"metadata": {"Date": None}}), ("png", {"dpi": 150, "metadata": {"Software": None}})):
        data = io.BytesIO()
        figure.savefig(data, format=kind, facecolor=PAPER if kind == "png" else "none", **more)
        result.append(data.getvalue())
    pyplot.close(figure)
    return result[0], result[1]

"""Noise against fog: of RAW, of developed pictures and after defogging, from the radiance of real shots.

Takes the shots of a set or a bake; develops each several times, with temporal noise of its own, by several cameras.
Temporal noise is what differs between frames of one scene: the spread over `FRAMES` of them, pixel by pixel.  What one
picture shows is told beside it by Immerkaer's estimate, with the sensor's noise and without (as in SynFog-alpha): it
cannot tell texture from noise, and neither can who trains on such pictures.

The defogger is the dark channel prior: J = (I - A) / t + A, so noise should grow by 1/t of its own t.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from scipy import ndimage

from docs.studies import command
from docs.studies.sensor_bench import readings
from synfog_usd import camera
from synfog_usd.base import files
from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import ParameterError, SynfogError
from synfog_usd.base.image import Image
from synfog_usd.base.progress import Progress, silent
from synfog_usd.camera.graph import NodeGraph
from synfog_usd.camera.writers import read_exr
from synfog_usd.cli.progress import shown
from synfog_usd.lab.benchmark import statistics
from synfog_usd.lab.benchmark.classics import dark_channel_fog
from synfog_usd.lab.benchmark.statistics import Mean
from synfog_usd.lab.study.scattering_model import FogPair, pairs, some

FRAMES = 8
FEWEST = 500
"""Pixels of which a bin's mean is worth telling."""

CAMERAS = ("synfog", "phone", "dashcam")
TEMPORAL = ("sensor.shot_noise", "sensor.read_noise", "sensor.adc_noise", "sensor.black_clamp")
"""Ops that differ from frame to frame."""

SIGNAL_DN = np.geomspace(1.0, 4096.0, 25)
"""Edges of the bins of the RAW signal above black."""

GROWTH = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.01)
"""Edges of the bins of 1 / t."""

CLEAR = "clear"
UNCLIPPED = 0.02, 0.98
"""Of a picture, 0 to 1: pixels nearer to its ends lose noise there and are left out."""


@dataclass
class BinnedMeans:
    """Sums by bin.

    Attributes:
        x, y, number: sums of what is on the axis and of the variance, and how many.
    """

    bins: int
    x: Array = field(init=False)
    y: Array = field(init=False)
    number: Array = field(init=False)

    def __post_init__(self) -> None:
        self.x, self.y, self.number = (np.zeros(self.bins) for _ in range(3))

    def add(self, where: Array, x: Array, y: Array) -> None:
        """Count pixels into bins; those outside of all are left out."""
        inside = (where >= 0) & (where < self.bins)
        for sums, values in ((self.x, x), (self.y, y), (self.number, np.ones_like(x))):
            sums += np.bincount(where[inside], values[inside], self.bins)

    def means(self, fewest: int = FEWEST) -> tuple[Array, Array]:
        """Mean x and y of the bins that have at least so many pixels."""
        kept = self.number >= fewest
        return self.x[kept] / self.number[kept], self.y[kept] / self.number[kept]


@dataclass(frozen=True)
class TransferCurve:
    """RAW variance by signal, in bins.

    Attributes:
        signal: means above black [DN].
        measured, closed: variances [DN^2], in frames and by photons, read-out and rounding.
        low, high: interval of their ratio at 95 %, by bootstrap over scenes; nan where fewer than three scenes have
            such a signal.
    """

    signal: Array
    measured: Array
    closed: Array
    low: Array
    high: Array

    @property
    def ratio(self) -> Array:
        """Measured over closed."""
        return self.measured / self.closed

    def farthest(self) -> int:
        """The bin whose ratio is farthest from 1."""
        return int(np.abs(self.ratio - 1.0).argmax())


def transfer_curve(of_scenes: Sequence[tuple[BinnedMeans, BinnedMeans]], fewest: int = FEWEST) -> TransferCurve:
    """The curve of all scenes together.

    Args:
        of_scenes: sums of the measured and the closed variance of each scene, over the same pixels.
        fewest: pixels of a bin that is told.
    """
    x, number, measured, closed = (
        np.array([getattr(one[which], name) for one in of_scenes])
        for which, name in ((0, "x"), (0, "number"), (0, "y"), (1, "y"))
    )
    kept = number.sum(axis=0) >= fewest
    count = number.sum(axis=0)[kept]
    low, high = np.full((2, int(kept.sum())), np.nan)
    for place, column in enumerate(np.flatnonzero(kept)):
        some = number[:, column] > 0
        if some.sum() >= statistics.FEWEST_SCENES:
            drawn = statistics.draws(int(some.sum()))
            ratios = (drawn @ measured[some, column]) / (drawn @ closed[some, column])
            low[place], high[place] = statistics.interval(ratios)
    sums = (one.sum(axis=0)[kept] / count for one in (x, measured, closed))
    return TransferCurve(*sums, low, high)


@dataclass(frozen=True)
class ShotNoise:
    """One shot by one camera.

    Attributes:
        camera, name, lighting, fog: which.
        scene, view: shots of one scene are not independent; all fogs of a view show the same.
        raw_dn: temporal noise of RAW [DN], RMS over pixels.
        raw_ratio: its variance over that of photons, read-out and rounding.
        neighbours_raw, neighbours: correlation of the noise of a pixel with that of the next one of its colour in RAW,
            and with the next one in the green of the picture.
        picture: temporal noise of the picture [8-bit numbers], RMS over pixels and channels.
        defogged: the same after the dark channel prior.
        growth, expected: `defogged` over `picture` where nothing is clipped, and the RMS of 1 / t there.
        shown, shown_quiet: Immerkaer's estimate of one picture [8-bit numbers] with and without the sensor's noise.
        shown_defogged, shown_defogged_quiet: the same after defogging.
    """

    camera: str
    name: str
    lighting: str
    fog: str
    scene: str
    view: str
    raw_dn: float
    raw_ratio: float
    neighbours_raw: float
    neighbours: float
    picture: float
    defogged: float
    growth: float
    expected: float
    shown: float
    shown_quiet: float
    shown_defogged: float
    shown_defogged_quiet: float


NUMBERS = tuple(ShotNoise.__dataclass_fields__)[6:]


@dataclass(frozen=True)
class NoiseStudy:
    """What came of it.

    Attributes:
        rows: by shot and camera.
        transfer: camera -> RAW variance by signal.
        growth: camera -> growth by 1 / t.
        fogs: names, clear first, as the shots have them.
        left_out: lines on shots that could not be used.
    """

    rows: tuple[ShotNoise, ...]
    transfer: dict[str, TransferCurve]
    growth: dict[str, tuple[Array, Array]]
    fogs: tuple[str, ...]
    left_out: tuple[str, ...]


def study(
    source: Path, *, cameras: Sequence[str] = CAMERAS, limit: int | None = None, progress: Progress = silent
) -> NoiseStudy:
    """Measure the shots of a set or a bake.

    Args:
        source: folder.
        cameras: shipped graphs or YAML files with a RAW mosaic (`sensor.adc`) and a node 'srgb'.
        limit: at most so many foggy shots, drawn from all; clear frames come with theirs.
        progress: whom to tell.

    Raises:
        ParameterError: nothing in it that can be measured.
        GraphError: a camera that is none.
    """
    graphs = {name: _camera(name) for name in cameras}
    found = list(pairs(source))
    left_out = [one for one in found if isinstance(one, str)]
    usable = some([one for one in found if isinstance(one, FogPair)], limit)
    shots: dict[Path, tuple[FogPair, str]] = {}
    for pair in usable:
        shots.setdefault(pair.clear, (pair, CLEAR))
        shots[pair.foggy] = (pair, pair.fog)
    signals: dict[str, dict[str, tuple[BinnedMeans, BinnedMeans]]] = {name: {} for name in graphs}
    grown = {name: BinnedMeans(len(GROWTH) - 1) for name in graphs}
    before = {name: BinnedMeans(len(GROWTH) - 1) for name in graphs}
    rows = []
    for number, (folder, (pair, fog)) in enumerate(shots.items()):
        progress(f"{pair.name.rpartition('/')[0]}/{fog}", number / len(shots))
        try:
            clear, radiance = read_exr(pair.clear / "radiance.exr"), read_exr(folder / "radiance.exr")
            for name, graph in graphs.items():
                both = BinnedMeans(len(SIGNAL_DN) - 1), BinnedMeans(len(SIGNAL_DN) - 1)
                sums = *signals[name].setdefault(pair.scene, both), grown[name], before[name]
                rows.append(_shot(name, graph, clear, radiance, pair, fog, sums))
        except SynfogError as error:
            left_out.append(f"{pair.name}: {error}")
    if not rows:
        raise ParameterError(
            f"{source}: no foggy shot with a clear frame that can be developed; "
            f"{left_out[0] if left_out else 'it is empty'}"
        )
    curves = {name: transfer_curve(list(signals[name].values())) for name in graphs}
    if not any(curve.signal.size for curve in curves.values()):
        raise ParameterError(
            f"{source}: its pictures are too small: no signal is seen by {FEWEST} pixels of all shots together. "
            f"Bake larger ones, as with --resolution 320x180, or more shots"
        )
    growth = {
        name: (grown[name].means()[0], np.sqrt(grown[name].means()[1] / before[name].means()[1])) for name in graphs
    }
    fogs = dict.fromkeys([CLEAR, *sorted({pair.fog for pair in usable}, key=_thinnest(usable))])
    return NoiseStudy(tuple(rows), curves, growth, tuple(fogs), tuple(left_out))


def _thinnest(usable: Sequence[FogPair]) -> Any:
    """Key that sorts fogs by visibility, thin ones first."""
    seen = {pair.fog: pair.mor_m for pair in usable}
    return lambda fog: (-seen[fog], fog)


def _camera(name: str) -> NodeGraph:
    graph = camera.load_graph(Path(name))
    if not graph.nodes_with("sensor.adc") or "srgb" not in graph.nodes:
        raise ParameterError(f"camera {name}: needs a node of sensor.adc and one named 'srgb'")
    if getattr(graph.profiles.get("sensor"), "name", "") not in readings():
        raise ParameterError(f"camera {name}: its sensor is none of those that ship: {', '.join(readings())}")
    return graph


def _shot(
    name: str,
    graph: NodeGraph,
    clear: Image,
    radiance: Image,
    pair: FogPair,
    fog: str,
    sums: tuple[BinnedMeans, BinnedMeans, BinnedMeans, BinnedMeans],
) -> ShotNoise:
    exposure = camera.meter(camera.field_of_view(clear, graph), graph)
    adc = graph.nodes_with("sensor.adc")[0].name

    def developed(graph: NodeGraph, seed: int) -> tuple[Array, Array]:
        run = camera.develop(
            graph, {"radiance": radiance}, seed=seed, exposure=exposure, until="srgb", keep=[adc, "srgb"]
        )
        return run[adc].pixels[..., 0].astype(np.float64), np.rint(255.0 * run["srgb"].pixels.astype(np.float64)) / 255

    quiet = graph.without([node.name for node in graph.nodes.values() if node.op.name in TEMPORAL])
    frames = [developed(graph, seed) for seed in range(FRAMES)]
    still = developed(quiet, 0)[1]
    raw, pictures = np.array([one[0] for one in frames]), np.array([one[1] for one in frames])

    chip: Any = graph.profiles["sensor"]
    reading = readings()[chip.name].at(exposure.iso)
    signal, variance = raw.mean(axis=0) - chip.black_level_dn, raw.var(axis=0, ddof=1)
    gain = reading.gain_dn_e
    closed = gain * np.maximum(signal, 0.0) + (gain * reading.dark_noise_e) ** 2 + 1.0 / 12.0
    good = (raw.max(axis=0) < 0.95 * chip.white_level_dn) & (raw.min(axis=0) > 0)
    where = np.digitize(signal[good], SIGNAL_DN) - 1
    sums[0].add(where, signal[good], variance[good])
    sums[1].add(where, signal[good], closed[good])

    _, t = dark_channel_fog(pictures.mean(axis=0))
    seen = np.array([_through(picture) for picture in pictures])
    before, after = pictures.var(axis=0, ddof=1).mean(axis=-1), seen.var(axis=0, ddof=1).mean(axis=-1)
    low, high = UNCLIPPED
    whole = np.all((pictures > low) & (pictures < high) & (seen > low) & (seen < high), axis=(0, 3)) & (before > 0)
    sums[2].add(np.digitize(1.0 / t[whole], GROWTH) - 1, 1.0 / t[whole], after[whole])
    sums[3].add(np.digitize(1.0 / t[whole], GROWTH) - 1, 1.0 / t[whole], before[whole])
    kept = before[whole].sum()
    return ShotNoise(
        name,
        pair.name,
        pair.lighting,
        fog,
        pair.scene,
        pair.clear.as_posix(),
        float(np.sqrt(variance[good].mean())),
        float(variance[good].mean() / closed[good].mean()),
        _beside(raw, 2),
        _beside(pictures[..., 1], 1),
        255.0 * float(np.sqrt(before.mean())),
        255.0 * float(np.sqrt(after.mean())),
        float(np.sqrt(after[whole].sum() / kept)) if kept > 0 else math.nan,
        float(np.sqrt((before[whole] / t[whole] ** 2).sum() / kept)) if kept > 0 else math.nan,
        immerkaer(pictures[0]),
        immerkaer(still),
        immerkaer(seen[0]),
        immerkaer(_through(still)),
    )


def _through(picture: Array) -> Array:
    airlight, t = dark_channel_fog(picture)
    return np.clip((picture - airlight) / t[..., None] + airlight, 0.0, 1.0)


def _beside(frames: Array, step: int) -> float:
    """Correlation of the temporal noise of pixels `step` apart, along rows and columns."""
    rest = frames - frames.mean(axis=0)
    across, down = (rest[:, :, step:] * rest[:, :, :-step]).mean(), (rest[:, step:] * rest[:, :-step]).mean()
    return float((across + down) / 2.0 / max((rest**2).mean(), 1e-30))


def immerkaer(picture: Array) -> float:
    """Noise that a single picture (H, W, 3), 0 to 1, seems to have [8-bit numbers], mean of its channels.

    sqrt(pi / 2) times the mean |N * I| / 6, with N = (1 -2 1; -2 4 -2; 1 -2 1), which sees no plane and no parabola.
    Right for independent normal noise; noise that demosaicing smoothed it takes for less, and texture for noise.

    Source: Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding 64 (1996).
    """
    mask = np.outer((1.0, -2.0, 1.0), (1.0, -2.0, 1.0))[..., None]
    seen = np.abs(ndimage.convolve(np.asarray(picture, dtype=np.float64), mask))[1:-1, 1:-1]
    return 255.0 * math.sqrt(math.pi / 2.0) / 6.0 * float(seen.mean())


# -- page


def over_scenes(rows: Sequence[ShotNoise], number: Callable[[ShotNoise], float]) -> Mean:
    """Mean of a number over shots, with its interval over scenes; nan where no shot has it."""
    known = [(value, row.scene) for row in rows if math.isfinite(value := number(row))]
    if not known:
        return Mean(math.nan, None, None, 0, 0)
    return statistics.mean([value for value, _ in known], [scene for _, scene in known])


def change(found: NoiseStudy, name: str, fog: str, what: str) -> Mean:
    """How many times a view has in clear air what it has in a fog: geometric mean over views, interval over scenes."""
    rows = [row for row in found.rows if row.camera == name]
    clear = {row.view: float(getattr(row, what)) for row in rows if row.fog == CLEAR}

    def log_ratio(row: ShotNoise) -> float:
        before, after = clear.get(row.view, 0.0), float(getattr(row, what))
        return math.log(after / before) if before > 0.0 and after > 0.0 else math.nan

    of_logs = over_scenes([row for row in rows if row.fog == fog], log_ratio)
    low, high = (None if end is None else math.exp(end) for end in (of_logs.low, of_logs.high))
    return replace(of_logs, value=math.exp(of_logs.value), low=low, high=high)


def _of(found: NoiseStudy, name: str, fog: str, what: str) -> Mean:
    rows = [row for row in found.rows if row.camera == name and row.fog == fog]
    return over_scenes(rows, lambda row: float(getattr(row, what)))


def _told(mean: Mean, form: str = ".2f") -> str:
    ends = "" if mean.low is None else f" ({mean.low:{form}} to {mean.high:{form}})"
    return f"{mean.value:{form}}{ends}"


def _told_ratios(curve: TransferCurve) -> str:
    """The bin that is farthest off, and how many of the intervals have 1 in them."""
    place = curve.farthest()
    some = np.isfinite(curve.low)
    ends = f" ({curve.low[place]:.3f} to {curve.high[place]:.3f})" if some[place] else ""
    told = f"farthest {curve.ratio[place]:.3f} times{ends} at {curve.signal[place]:.2g} DN."
    if some.any():
        holds = (curve.low <= 1.0) & (curve.high >= 1.0)
        told += f" {holds[some].sum()} of {some.sum()} signals have 1 in the ratio's interval."
    return told


def markdown(found: NoiseStudy) -> str:
    """Findings and tables."""
    shots = len(found.rows) // max(len(found.transfer), 1)
    scenes = len({row.scene for row in found.rows})
    lines = [
        "# Noise and fog",
        "",
        f"{shots} shots of {scenes} scenes, {FRAMES} frames each. Means over shots; in brackets the interval at 95 % "
        "over scenes. Pictures in 8-bit numbers.",
        "",
    ]
    for name, curve in found.transfer.items():
        if not curve.signal.size:
            continue
        some = [row for row in found.rows if row.camera == name and math.isfinite(row.growth)]
        growth = over_scenes(some, lambda row: row.growth / row.expected)
        rows = [row for row in found.rows if row.camera == name]
        in_raw, beside = (
            over_scenes(rows, lambda row: row.neighbours_raw),
            over_scenes(rows, lambda row: row.neighbours),
        )
        lines.append(
            f"- **{name}.** RAW: variance within {np.abs(curve.ratio - 1.0).max():.1%} of photons, read-out and "
            f"rounding at every signal; {_told_ratios(curve)} "
            f"Neighbours in RAW correlate by {_told(in_raw, '+.4f')}, after demosaicing by {_told(beside, '+.3f')}. "
            f"The dark channel prior lets noise grow by {_told(growth)} times its own 1/t. Where fog comes up to "
            f"{found.fogs[-1]}, the noise of a view is {_told(change(found, name, found.fogs[-1], 'picture'))} times "
            f"that in clear air, after the prior {_told(change(found, name, found.fogs[-1], 'defogged'))} times."
        )
    for name in found.transfer:
        lines += [
            "",
            f"## {name}",
            "",
            "| fog | RAW [DN] | picture | defogged | growth | 1/t | one picture shows | without noise | defogged | "
            "without noise |",
            "|---|---|---|---|---|---|---|---|---|---|",
        ]
        for fog in found.fogs:
            cells = [
                _told(_of(found, name, fog, what))
                for what in (
                    "raw_dn",
                    "picture",
                    "defogged",
                    "growth",
                    "expected",
                    "shown",
                    "shown_quiet",
                    "shown_defogged",
                    "shown_defogged_quiet",
                )
            ]
            lines.append(f"| {fog} | {' | '.join(cells)} |")
    for line in found.left_out[:5]:
        lines += ["", f"Left out: {line}"]
    return "\n".join([*lines, ""])


def write(found: NoiseStudy, out: Path) -> None:
    """Write findings.md, noise.csv, transfer.csv and noise.png.

    Raises:
        OutputError: the folder cannot be written.
    """
    files.write_bytes(out / "findings.md", markdown(found).encode())
    rows = [f"camera,shot,lighting,fog,{','.join(NUMBERS)}"]
    for row in found.rows:
        numbers = ",".join(f"{getattr(row, name):.5g}" for name in NUMBERS)
        rows.append(f"{row.camera},{row.name},{row.lighting},{row.fog},{numbers}")
    files.write_bytes(out / "noise.csv", "\n".join([*rows, ""]).encode())
    rows = ["camera,signal_dn,variance_dn2,closed_form_dn2,ratio,ratio_low,ratio_high"]
    for name, curve in found.transfer.items():
        columns = curve.signal, curve.measured, curve.closed, curve.ratio, curve.low, curve.high
        rows += [f"{name}," + ",".join(f"{value:.6g}" for value in row) for row in zip(*columns, strict=True)]
    files.write_bytes(out / "transfer.csv", "\n".join([*rows, ""]).encode())
    files.write_bytes(out / "noise.png", _drawn(found))


def _drawn(found: NoiseStudy) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15.0, 4.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    transfer, fogs, growth = figure.subplots(1, 3)
    for name, colour in zip(found.transfer, ("#0b5fa5", "#c1440e", "#12805c", "#7a4fa3", "#8a6d00"), strict=False):
        curve = found.transfer[name]
        transfer.plot(curve.signal, curve.measured, "o", ms=4, color=colour, label=name)
        transfer.plot(curve.signal, curve.closed, "-", lw=1.0, color=colour)
        places = np.arange(len(found.fogs))
        for what, style in (("picture", "o-"), ("defogged", "s--")):
            means = [_of(found, name, fog, what) for fog in found.fogs]
            middle = np.array([mean.value for mean in means])
            ends = np.array([(mean.low or mean.value, mean.high or mean.value) for mean in means]).T
            text = f"{name}, {'developed' if what == 'picture' else 'defogged'}"
            fogs.errorbar(places, middle, abs(ends - middle), fmt=style, ms=4, color=colour, capsize=2, label=text)
        growth.plot(*found.growth[name], "o", ms=5, color=colour, label=name)
    transfer.plot([], [], "-", lw=1.0, color="#22262a", label="photons, read-out, rounding")
    transfer.set(xscale="log", yscale="log", title="RAW, each shot at its own ISO speed")
    transfer.set(xlabel="RAW above black [DN]", ylabel="temporal variance [DN^2]")
    fogs.set_xticks(np.arange(len(found.fogs)), found.fogs)
    fogs.set(ylabel="temporal noise [8-bit numbers]", title="Pictures")
    fogs.set_ylim(0.0, 1.4 * fogs.get_ylim()[1])
    growth.plot([1, 10], [1, 10], "-", lw=1.0, color="#22262a", label="1 / t")
    growth.set(
        xscale="log",
        yscale="log",
        xlabel="1 / t of the dark channel prior",
        ylabel="noise defogged / developed",
        title="What defogging makes of it",
    )
    for axes, columns in ((transfer, 1), (fogs, 2), (growth, 1)):
        axes.legend(frameon=False, fontsize=8, ncols=columns)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def main(
    source: command.Source,
    out: command.Out,
    cameras: Annotated[str, typer.Option(help="Shipped graphs or YAML files, comma-separated.")] = ",".join(CAMERAS),
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many foggy shots, drawn from all.")] = None,
) -> None:
    """Measure noise against fog: of RAW, of developed pictures, and after defogging."""
    command.writable(out)
    names = [name.strip() for name in cameras.split(",") if name.strip()]
    with shown(quiet=False) as (progress, _):
        found = study(source, cameras=names or CAMERAS, limit=limit, progress=progress)
    write(found, out)
    print(markdown(found))


if __name__ == "__main__":
    command.run(main)

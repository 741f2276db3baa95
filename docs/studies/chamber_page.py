"""What a fog chamber showed, on a page: findings in words, tables, drawings.

Takes a `ChamberStudy`; writes findings.md, laser.csv, apertures.csv, patches.csv, laser.png and patches.png.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from docs.studies.chamber import MODELS, ChamberStudy, LaserRow, departures
from synfog_usd.base import files

COLOURS = ("#0b5fa5", "#c1440e", "#12805c", "#7a4fa3")
NAMES = {
    "single": "scattered once",
    "asm_true": "ASM, true airlight",
    "asm_dark_channel": "ASM, dark channel's airlight",
}
READ_OFF = 1e-5
"""Half of an interval of the extinction, relative, below which no light was drawn by chance: it is rounding."""

SEEN = 0.05
"""Relative error from which on a model is said to leave the truth."""


def write(found: ChamberStudy, out: Path) -> None:
    """Write everything.

    Raises:
        OutputError: the folder cannot be written.
    """
    for name, text in (
        ("findings.md", markdown(found)),
        ("laser.csv", _laser_csv(found)),
        ("apertures.csv", _apertures_csv(found)),
        ("patches.csv", _patches_csv(found)),
    ):
        files.write_bytes(out / name, text.encode())
    files.write_bytes(out / "laser.png", _drawn_laser(found))
    files.write_bytes(out / "patches.png", _drawn_patches(found))


def law_error(found: ChamberStudy, row: LaserRow) -> tuple[float, float]:
    """Relative error of the extinction by unscattered light, and half of its interval."""
    measured, half = row.law.extinction(found.way_m)
    return measured / row.sigma_per_m - 1.0, half / row.sigma_per_m


def markdown(found: ChamberStudy) -> str:
    """Findings and tables."""
    errors = [law_error(found, row) for row in found.laser]
    drawn = [(off, half) for off, half in errors if half > READ_OFF]
    beyond = sum(abs(off) > half for off, half in drawn)
    by_chance = int(stats.binom.isf(0.01, len(drawn), 0.05)) if drawn else 0
    least = min(row.law.power for row in found.laser)
    widest = max(half for _, half in errors)
    lines = [
        f"# A fog chamber: {found.stage}",
        "",
        f"Laser and meter are {found.way_m:g} m apart; the meter's opening is {2000 * found.radius_m:.3g} mm wide and "
        "takes light from any side. Intervals are of 95 %.",
        "",
        f"- **The law.** Light that was not turned aside gives ln(P0/P)/u within {max(abs(e) for e, _ in errors):.3%} "
        f"of the authored extinction down to P/P0 = {least:.2g}; the widest interval is {widest:.3%}. Light is "
        f"drawn by chance in {len(drawn)} fogs, and in {beyond} of them the error lies beyond its interval; more than "
        f"{by_chance} would refute the law (chance: below 1 %).",
    ]
    walls = list(found.laser[0].meters)
    for wall in walls:
        low = [row.meters[wall].extinction(found.way_m)[0] / row.sigma_per_m - 1.0 for row in found.laser]
        lines.append(
            f"- **The meter, walls {wall}.** Light that fog scatters into the opening makes the extinction "
            f"{-low[0]:.2%} too low in the thinnest fog and {-low[-1]:.2%} in the densest."
        )
    if found.apertures:
        thin = [row for row in found.apertures if row.fog == found.apertures[0].fog]
        dense = [row for row in found.apertures if row.fog == found.apertures[-1].fog]
        for title, some in (("thinnest", thin), ("densest", dense)):
            gaps = [_low(row.reading.power, row.sigma_per_m, found.way_m) for row in some]
            closed = [_low(row.single, row.sigma_per_m, found.way_m) for row in some]
            lines.append(
                f"- **The opening, {title} fog** (P/P0 {math.exp(-some[0].sigma_per_m * found.way_m):.2g}). "
                f"From {some[0].half_angle_deg:.2g} to {some[-1].half_angle_deg:.2g} degrees the extinction is "
                f"{-gaps[0]:.2%} to {-gaps[-1]:.2%} too low; light scattered once explains {-closed[0]:.2%} to "
                f"{-closed[-1]:.2%}."
            )
    for wall in walls:
        rows = [row for row in found.patches if row.walls == wall and row.fog != "clear"]
        if not rows:
            continue
        converged = max(float(np.max(row.error / np.maximum(row.truth, 1e-30))) for row in rows)
        parts = []
        for model in MODELS:
            fogs = departures(found.patches, wall, model)
            over = [fog.tau for fog in fogs if fog.low > SEEN]
            where = f"from optical depth {over[0]:.2g} on" if over else "nowhere"
            most = max(fogs, key=lambda fog: fog.median)
            parts.append(f"{NAMES[model]} {where} (at most {most.median:.1%}, {most.low:.1%} to {most.high:.1%})")
        lines.append(
            f"- **The chart, walls {wall}.** The median patch is off by more than {SEEN:.0%}, and so is its "
            f"interval: {'; '.join(parts)}. The truth's worst patch is known to {converged:.2%}."
        )
    lines += ["", "## Laser", "", _laser_table(found), "", "## Chart", ""]
    for wall in walls:
        lines += [_chart_table(found, wall), ""]
    lines += ["All 24 patches, R, G and B, stand in patches.csv; the meter's openings in apertures.csv.", ""]
    return "\n".join(lines)


def _low(power: float, sigma_per_m: float, way_m: float) -> float:
    return -math.log(power) / way_m / sigma_per_m - 1.0


def _laser_table(found: ChamberStudy) -> str:
    walls = list(found.laser[0].meters)
    lines = [
        f"| fog | authored [1/m] | P/P0 | measured [1/m] | error | {' | '.join(f'meter, {w} walls' for w in walls)} |",
        f"|---|---|---|---|---|{'---|' * len(walls)}",
    ]
    for row in found.laser:
        measured, _ = row.law.extinction(found.way_m)
        error, half = law_error(found, row)
        cells = []
        for wall in walls:
            seen, wide = row.meters[wall].extinction(found.way_m)
            cells.append(f"{seen / row.sigma_per_m - 1.0:+.2%} ± {wide / row.sigma_per_m:.2%}")
        lines.append(
            f"| {row.fog} | {row.sigma_per_m:.5g} | {row.law.power:.4g} | {measured:.5g} | {error:+.3%} ± {half:.3%} | "
            f"{' | '.join(cells)} |"
        )
    return "\n".join(lines)


def _chart_table(found: ChamberStudy, wall: str) -> str:
    columns = [departures(found.patches, wall, model) for model in MODELS]
    lines = [
        f"Walls {wall}: relative error over patches and three channels: median, in brackets its interval over patches, "
        "and the largest.",
        "",
        f"| optical depth | {' | '.join(NAMES[model] for model in MODELS)} |",
        f"|---|{'---|' * len(MODELS)}",
    ]
    for fogs in zip(*columns, strict=True):
        cells = [f"{fog.median:.1%} ({fog.low:.1%} to {fog.high:.1%}), {fog.worst:.0%}" for fog in fogs]
        lines.append(f"| {fogs[0].tau:.3g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _csv(head: str, rows: Iterable[Iterable[Any]]) -> str:
    cells = [",".join(f"{c:.7g}" if isinstance(c, float) else str(c) for c in row) for row in rows]
    return "\n".join([head, *cells, ""])


def _laser_csv(found: ChamberStudy) -> str:
    rows = []
    for row in found.laser:
        seen: list[Any] = [row.fog, row.sigma_per_m, row.law.power, row.law.error, *law_error(found, row)]
        for reading in row.meters.values():
            seen += [reading.power, reading.error, reading.once, reading.often]
        rows.append(seen)
    walls = ",".join(f"{w}_power,{w}_power_95,{w}_once,{w}_often".replace(" ", "_") for w in found.laser[0].meters)
    return _csv(f"fog,sigma_per_m,power,power_95,extinction_error,extinction_95,{walls}", rows)


def _apertures_csv(found: ChamberStudy) -> str:
    return _csv(
        "fog,sigma_per_m,half_angle_deg,power,power_95,once,often,closed_form_with_single",
        (
            (
                row.fog,
                row.sigma_per_m,
                row.half_angle_deg,
                row.reading.power,
                row.reading.error,
                row.reading.once,
                row.reading.often,
                row.single,
            )
            for row in found.apertures
        ),
    )


def _patches_csv(found: ChamberStudy) -> str:
    head = ",".join(f"{name}_{c}" for name in ("path", "path_95", *MODELS) for c in "RGB")
    rows = []
    for row in found.patches:
        triples = (row.truth, row.error, *(row.models[model] for model in MODELS))
        rows.append([row.walls, row.fog, row.tau, row.patch, *(float(v) for triple in triples for v in triple)])
    return _csv(f"walls,fog,optical_depth,patch,{head}", rows)


def _drawn_laser(found: ChamberStudy) -> bytes:
    figure, (left, right) = _figure(2)
    taus = [row.sigma_per_m * found.way_m for row in found.laser]
    errors = np.array([law_error(found, row) for row in found.laser]) * 100.0
    left.axhspan(-0.1, 0.1, color="#8a9096", alpha=0.2, lw=0, label="0.1 %")
    left.errorbar(taus, errors[:, 0], errors[:, 1], fmt="o", color=COLOURS[0], capsize=3, label="not turned aside")
    for wall, colour in zip(found.laser[0].meters, COLOURS[1:], strict=False):
        low = [100.0 * (row.meters[wall].extinction(found.way_m)[0] / row.sigma_per_m - 1.0) for row in found.laser]
        left.plot(taus, low, "s-", color=colour, ms=4, label=f"all light, {2000 * found.radius_m:.3g} mm, {wall} walls")
    left.set(
        xlabel="optical depth from laser to meter", ylabel="extinction: measured against authored [%]", title="The law"
    )
    left.set_yscale("symlog", linthresh=0.2)
    left.set_yticks([-10, -3, -1, -0.3, -0.1, 0, 0.1, 0.3], ["-10", "-3", "-1", "-0.3", "-0.1", "0", "0.1", "0.3"])
    left.legend(frameon=False, fontsize=8)
    for fog, colour in zip(dict.fromkeys(row.fog for row in found.apertures), COLOURS, strict=False):
        some = [row for row in found.apertures if row.fog == fog]
        angles = [row.half_angle_deg for row in some]
        seen = [100.0 * _low(row.reading.power, row.sigma_per_m, found.way_m) for row in some]
        closed = [100.0 * _low(row.single, row.sigma_per_m, found.way_m) for row in some]
        wide = [100.0 * row.reading.extinction(found.way_m)[1] / row.sigma_per_m for row in some]
        text = f"P/P0 {math.exp(-some[0].sigma_per_m * found.way_m):.2g}"
        right.errorbar(angles, seen, wide, fmt="o", color=colour, capsize=3, label=text)
        right.plot(angles, closed, "-", color=colour, lw=1.2)
    right.plot([], [], "-", color="#22262a", lw=1.2, label="scattered once, closed form")
    right.set_xscale("log")
    right.set(
        xlabel="half angle of the meter's opening from the laser [degrees]",
        ylabel="extinction: measured against authored [%]",
        title="Light scattered forward into the meter",
    )
    right.legend(frameon=False, fontsize=8)
    return _png(figure)


def _drawn_patches(found: ChamberStudy) -> bytes:
    walls = list(found.laser[0].meters)
    figure, axes = _figure(2, rows=len(walls))
    axes = np.reshape(axes, (len(walls), 2))
    for (trend, error), wall in zip(axes, walls, strict=True):
        rows = [row for row in found.patches if row.walls == wall]
        names = sorted({row.patch for row in rows})
        chosen = [names[k] for k in (14, 13, 12, 18, 21, 23) if k < len(names)] or names[:6]
        colours = ("#c02020", "#2d8a2d", "#2040b0", "#b0b4b8", "#6a6e72", "#101214")
        for name, colour in zip(chosen, colours, strict=False):
            some = [row for row in rows if row.patch == name]
            taus = [row.tau for row in some]
            channel = {"#c02020": 0, "#2040b0": 2}.get(colour, 1)
            label = f"{name.partition('_')[2].partition('_')[2] or name}, {'RGB'[channel]}"
            trend.plot(taus, [row.truth[channel] for row in some], "o-", ms=3, color=colour, label=label)
            trend.plot(taus, [row.models["asm_dark_channel"][channel] for row in some], ":", color=colour)
            trend.plot(taus, [row.models["single"][channel] for row in some], "--", lw=0.8, color=colour)
        trend.set_xscale("symlog", linthresh=0.1)
        trend.set_yscale("log")
        trend.set(
            xlabel="optical depth from camera to chart",
            ylabel="radiance [cd/m2]",
            title=f"{wall} walls: transport (full), once (dashed), ASM by dark channel (dotted)",
        )
        trend.title.set_fontsize(9)
        trend.legend(frameon=False, fontsize=7)
        for model, colour in zip(MODELS, COLOURS, strict=False):
            fogs = departures(found.patches, wall, model)
            taus_of, medians, worst = np.array([(fog.tau, 100 * fog.median, 100 * fog.worst) for fog in fogs]).T
            ends = np.array([(fog.median - fog.low, fog.high - fog.median) for fog in fogs]).T
            error.errorbar(taus_of, medians, 100 * ends, fmt="o-", ms=4, capsize=2, color=colour, label=NAMES[model])
            error.fill_between(taus_of, medians, worst, color=colour, alpha=0.12, lw=0)
        known = max(float(np.max(row.error / np.maximum(row.truth, 1e-30))) for row in rows)
        error.axhspan(0.1, 100 * known, color="#8a9096", alpha=0.2, lw=0, label="truth's own error, worst patch")
        error.set_xscale("log")
        error.set_yscale("log")
        error.set_ylim(0.1, None)
        error.set(
            xlabel="optical depth from camera to chart",
            ylabel="relative error of patches [%]",
            title=f"{wall} walls: median patch, and up to the worst",
        )
        error.title.set_fontsize(9)
        error.legend(frameon=False, fontsize=8)
    return _png(figure)


def _figure(columns: int, rows: int = 1) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.6 * columns, 4.2 * rows), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns)


def _png(figure: Any) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()

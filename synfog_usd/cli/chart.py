"""`synfog-usd chart`: speed against accuracy on one shot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from synfog_usd.cli.progress import shown

if TYPE_CHECKING:
    from synfog_usd.lab.chart import Chart


def run(plan: dict[str, Any], *, quiet: bool) -> None:
    """Sweep as the command line asked for, print the table, and say where the drawings are."""
    from synfog_usd.lab import chart as charts
    from synfog_usd.lab import verdicts

    sweep = charts.ChartPlan(**plan)
    with shown(quiet) as (progress, _):
        chart = charts.chart(sweep, progress=progress)
    if quiet:
        return
    for note in chart.notes:
        print(f"{sweep.stage.name}: {note}")
    _table(chart)
    for line in verdicts.verdicts(chart.points):
        print(line)
    print(f"look at {sweep.out / 'chart.png'}")


def _table(chart: Chart) -> None:
    points = chart.points
    first, width = points[0], max(len(point.line) for point in points) + 1
    head = "samples,seconds,total,noise,bias,95th pct.,FLIP,mean bias,std. err."
    print(f"{'model':<{width}}" + "".join(f"{name:>11}" for name in head.split(",")))
    for point in points:
        bias = f"{point.bias_rms:.2%}" if point.bias_is_seen else f"< {point.bias_limit:.2%}"
        print(
            f"{point.line:<{width}}{point.samples:>11}{point.seconds:>9.2f} "
            f"s{point.relative_rms:>11.2%}{point.noise_rms:>11.2%}{bias:>11}"
            f"{point.p95:>11.2%}{point.flip:>11.4f}{point.bias:>+11.3%}{point.bias_error:>11.3%}"
            + (" <- enough" if point.enough else "")
        )
    print(
        f"reference: {first.reference_model}, {first.reference_samples} samples, itself known to "
        f"{first.reference_rms:.2%}; {first.variant}, {first.machine}"
    )

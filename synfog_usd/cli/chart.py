"""`synfog-usd chart`: speed against accuracy on one shot."""

from __future__ import annotations

from typing import Any

from synfog_usd.cli.progress import shown


def run(plan: dict[str, Any], *, quiet: bool) -> None:
    """Sweep as the command line asked for, print the table, and say where the drawings are."""
    from synfog_usd.study import chart as study

    with shown(quiet) as (progress, _):
        points = study.chart(study.ChartPlan(**plan), progress=progress)
    if quiet:
        return
    first = points[0]
    print(f"{'model':<9}{'samples':>8}{'seconds':>10}{'first call':>12}{'RMS error':>11}{'95th pct.':>11}{'bias':>10}{'std. err.':>11}")
    for point in points:
        print(
            f"{point.model:<9}{point.samples:>8}{point.seconds:>8.2f} s{point.first_call_s:>10.2f} s"
            f"{point.relative_rms:>11.2%}{point.p95:>11.2%}{point.bias:>+10.3%}{point.bias_error:>11.3%}"
        )
    print(f"reference: {first.reference_model}, {first.reference_samples} samples, itself known to {first.reference_rms:.2%}; {first.variant}, {first.machine}")
    print(f"look at {plan['out'] / study.NAMES[-1]}")

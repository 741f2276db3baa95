"""Charts as pages: one file that opens offline, in light and dark, and asks nobody for anything."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import srgb_encode
from synfog_usd.lab.study import drawing
from synfog_usd.lab.study.accuracy import FLOOR, MIDDLE_GREY, Reference, luminance
from synfog_usd.lab.study.drawing import duration, percent
from synfog_usd.lab.study.points import ERROR, MOTTLE, TARGETS, Point, summary

LEAST_WIDTH = 320
"""Pixels of a thumbnail; smaller pictures are shown with each pixel repeated."""
ERROR_SHOWN = 0.5
"""Relative error at which the map's colour is full."""
BELOW, ABOVE, NONE = np.array([33.0, 102.0, 172.0]), np.array([178.0, 88.0, 6.0]), np.array([247.0, 247.0, 247.0])

CSS = """
body{font:15px/1.5 system-ui,"DejaVu Sans",sans-serif;margin:0 auto;max-width:1120px;padding:1.2rem;background:var(--ffffff);color:var(--22262a)}
h1{font-size:1.35rem;margin:.2rem 0}h2{font-size:1.05rem;margin:1.6rem 0 .4rem}p{max-width:75ch}small,.faint{color:var(--666b70)}
svg{width:100%;height:auto}svg text{font-family:"DejaVu Sans",system-ui,sans-serif}
.wide{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.87rem}
th,td{padding:.2rem .7rem;text-align:right;border-bottom:1px solid var(--dcdfe2);white-space:nowrap}th:first-child,td:first-child{text-align:left}
tr.front td:first-child{font-weight:700}.key{display:inline-block;width:.7em;height:.7em;border-radius:50%;margin-right:.45em}
.grid{display:grid;grid-template-columns:repeat(auto-fill,minmax(250px,1fr));gap:1rem}figure{margin:0}figcaption{font-size:.85rem}
img{width:100%;height:auto;image-rendering:pixelated;display:block;border-radius:3px}.chart img{image-rendering:auto;background:#fff}a{color:var(--0b5fa5)}
"""  # noqa: E501


def page(
    title: str,
    svg: str,
    by_line: Mapping[str, Sequence[Point]],
    reference: Reference,
    pictures: Mapping[str, tuple[int, Array]],
    notes: Sequence[str] = (),
) -> str:
    """One shot: the drawing, what it says, the numbers, and what each model's error looks like.

    Args:
        title: stage, lighting, fog and size.
        svg: as `drawing.draw_chart` gives it.
        by_line: points of each line.
        reference: with its colours.
        pictures: line -> (samples, (H, W, 3)) of one run at its most samples.
        notes: what was left out and why.
    """
    points = [point for line in by_line.values() for point in line]
    body = drawing.themed(svg)
    for point in points:
        for measure in (ERROR, MOTTLE):
            group = f'<g id="{drawing.point_id(point, measure)}">'
            body = body.replace(group, f"{group}<title>{html.escape(_tip(point))}</title>")
    first = points[0]
    items = "".join(f"<li>{html.escape(line)}</li>" for line in verdicts("", points))
    left_out = "".join(f"<li>{html.escape(note)}</li>" for note in notes)
    return _document(
        title,
        f"<h1>{html.escape(title)}</h1><ul>{items}</ul>{body}"
        "<p class=faint>Down and to the left is better. Hold the pointer over a mark for its numbers. "
        f"The reference, {html.escape(first.reference_model)} with {first.reference_samples} paths per pixel, is "
        f"itself known to "
        f"{percent(first.reference_rms)}. {html.escape(first.variant)}, {html.escape(first.machine)}.</p>"
        f"<h2>What the errors look like</h2>{_thumbnails(by_line, reference, pictures)}"
        f"<h2>Numbers</h2><div class=wide>{_numbers(points)}</div>"
        + (f"<h2>Left out</h2><ul>{left_out}</ul>" if left_out else ""),
    )


def index(stages: Mapping[str, Sequence[Point]], rows: Sequence[Mapping[str, Any]]) -> str:
    """All stages of a suite: seconds to each target, and the charts, which lie beside it."""
    cells = "".join(
        f'<figure class=chart><a href="{html.escape(name)}/chart.html"><img src="{html.escape(name)}/chart.png" '
        f'alt="{html.escape(_alt(points))}"></a>'
        f'<figcaption><a href="{html.escape(name)}/chart.html">{html.escape(name)}</a> '
        f"{html.escape(' '.join(verdicts('', points)[1:2]))}</figcaption></figure>"
        for name, points in stages.items()
    )
    return _document(
        "Speed against accuracy",
        "<h1>Speed against accuracy</h1><p>Seconds to a total error and to a mottle, for the fastest of our models and "
        "for the best of Mitsuba's own; "
        "<em>~</em> is extrapolated from fewer samples by the square root.</p>"
        f'<div class=wide>{html_table(rows)}</div><p><a href="summary.csv">summary.csv</a></p>'
        '<figure class=chart><img src="suite.png" alt="Error on all stages"></figure>'
        '<figure class=chart><img src="mottle.png" alt="Mottle on all stages"></figure>'
        f'<div class=grid style="grid-template-columns:repeat(auto-fill,minmax(440px,1fr))">{cells}</div>',
    )


def verdicts(stage: str, points: Sequence[Point]) -> list[str]:
    """A sentence a target: what gets there first, and how much sooner than the best peer."""
    return [sentence(row) for row in summary(stage, points)]


def sentence(row: Mapping[str, Any]) -> str:
    """A row of the summary in words."""
    target = target_words(row["measure"], float(row["target"]))
    if not row["best"]:
        return f"{target}: none of our models." + (
            f" {row['peer']} takes {seconds(row, 'peer')}." if row["peer"] else ""
        )
    text = f"{target}: {row['best']} in {seconds(row, 'best')}"
    if row["unbiased"] and row["unbiased"] != row["best"]:
        text += f", without bias {row['unbiased']} in {seconds(row, 'unbiased')}"
    if row["peer"]:
        text += f"; {row['peer']} takes {seconds(row, 'peer')}, {times(row, 'best')}"
    return text + "."


def target_words(measure: str, target: float) -> str:
    """'1 % error', '1 % mottle'."""
    return f"{100 * target:g} % {measure}"


def seconds(row: Mapping[str, Any], who: str) -> str:
    """'1.2 s', '~1.2 s' where it is extrapolated, '' where there is none."""
    if row[f"{who}_seconds"] == "":
        return ""
    value, beyond = float(row[f"{who}_seconds"]), float(row[f"{who}_beyond"])
    return f"~{duration(value)}" if beyond > 1.0 else duration(value)


def times(row: Mapping[str, Any], who: str) -> str:
    """'12 times as long', of the best peer over one of ours; '' where one of them is missing."""
    return f"{ratio(row, who)[:-1]} times as long" if row[f"{who}_speedup"] != "" else ""


def html_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The summary as a table: a row a stage, columns by target."""
    head = "".join(f"<th colspan=4>{target_words(*target)}</th>" for target in TARGETS)
    below = "<th>fastest</th><th>s</th><th>best peer</th><th>ratio</th>" * len(TARGETS)
    body = ""
    for name in dict.fromkeys(row["stage"] for row in rows):
        cells = "".join(
            f"<td>{html.escape(str(row['best']))}</td><td>{seconds(row, 'best')}</td>"
            f"<td>{html.escape(str(row['peer']))} {seconds(row, 'peer')}</td><td>{ratio(row)}</td>"
            for row in rows
            if row["stage"] == name
        )
        body += f"<tr><td>{html.escape(name)}</td>{cells}</tr>"
    return f"<table><thead><tr><th></th>{head}</tr><tr><th>stage</th>{below}</tr></thead><tbody>{body}</tbody></table>"


def ratio(row: Mapping[str, Any], who: str = "best") -> str:
    """'12x', '' where there is no ratio."""
    if row[f"{who}_speedup"] == "":
        return ""
    value = float(row[f"{who}_speedup"])
    return f"{value:.0f}x" if value >= 9.95 else f"{value:.1f}x"


def png(pixels: Array) -> bytes:
    """(H, W, 3) 0 to 255 as PNG."""
    from PIL import Image

    data = io.BytesIO()
    Image.fromarray(np.clip(np.rint(pixels), 0, 255).astype(np.uint8), "RGB").save(data, "PNG", optimize=True)
    return data.getvalue()


def toned(rgb: Array, gain: float) -> Array:
    """(H, W, 3) linear -> 0 to 255 in sRGB, brightest parts rolled off."""
    linear = np.maximum(np.asarray(rgb, dtype=np.float64) * gain, 0.0)
    linear = np.where(linear > 0.6, 1.0 - 0.4 * np.exp(-(linear - 0.6) / 0.4), linear)
    return np.asarray(255.0 * srgb_encode(linear), dtype=np.float64)


def error_map(picture: Array, reference: Reference) -> Array:
    """(H, W, 3) 0 to 255: blue where the picture is too dark, brown where it is too bright, full at ERROR_SHOWN."""
    relative = np.clip((luminance(picture) - reference.luminance) / reference.scale / ERROR_SHOWN, -1.0, 1.0)[..., None]
    return NONE + np.where(relative < 0.0, -relative * (BELOW - NONE), relative * (ABOVE - NONE))


def _thumbnails(
    by_line: Mapping[str, Sequence[Point]], reference: Reference, pictures: Mapping[str, tuple[int, Array]]
) -> str:
    assert reference.rgb is not None
    median = float(np.median(np.hypot(reference.luminance, FLOOR * reference.luminance.mean())))
    gain = MIDDLE_GREY / median if median > 0.0 else 1.0
    cells = _figure(
        toned(reference.rgb, gain),
        f"<b>reference</b>, {html.escape(reference.model)}, {reference.samples} paths per pixel",
        "reference",
    )
    for name, (samples, picture) in pictures.items():
        point = by_line[name][-1]
        bias = percent(point.bias_rms) if point.bias_is_seen else f"below {percent(point.bias_limit)}"
        words = (
            f"{_key(point)}<b>{html.escape(name)}</b>, {samples}: noise {percent(point.noise_rms)}, bias {bias}, "
            f"{_time(point.seconds)}"
        )
        cells += _figure(error_map(picture, reference), words, f"error of {name}")
    text = (
        f"Error of one render at the most samples: blue is too dark, brown too bright, full colour at "
        f"{percent(ERROR_SHOWN)}. Grain is noise, a tint is bias."
    )
    return f"<p class=faint>{text}</p><div class=grid>{cells}</div>"


def _figure(pixels: Array, caption: str, alt: str) -> str:
    again = max(1, math.ceil(LEAST_WIDTH / pixels.shape[1])) if pixels.shape[1] < LEAST_WIDTH / 4 else 1
    data = base64.b64encode(png(pixels.repeat(again, axis=0).repeat(again, axis=1))).decode()
    return (
        f'<figure><img src="data:image/png;base64,{data}" '
        f'alt="{html.escape(alt)}"><figcaption>{caption}</figcaption></figure>'
    )


def _numbers(points: Sequence[Point]) -> str:
    names = (
        "model",
        "samples",
        "time",
        "first call",
        "total",
        "noise",
        "bias of a pixel",
        "mottle",
        "95th pct.",
        "FLIP",
        "bias of the mean",
        "std. err.",
    )
    body = "".join(
        f"<tr{' class=front' if p.on_front else ''}><td>{_key(p)}{html.escape(p.line)}{' (enough)' if p.enough else ''}</td>"  # noqa: E501
        f"<td>{_amount(p)}</td><td>{_time(p.seconds)}</td><td>{_time(p.first_call_s)}</td><td>{percent(p.relative_rms)}</td><td>{percent(p.noise_rms)}</td>"
        f"<td>{percent(p.bias_rms) if p.bias_is_seen else '&lt; ' + percent(p.bias_limit)}</td><td>{percent(p.mottle)}</td><td>{percent(p.p95)}</td>"  # noqa: E501
        f"<td>{'' if math.isnan(p.flip) else f'{p.flip:.3f}'}</td><td>{100 * p.bias:+.2g} "
        f"%</td><td>{percent(p.bias_error)}</td></tr>"
        for p in points
    )
    first = points[0]
    values = (
        ""
        if math.isnan(first.reference_flip)
        else f" FLIP between the two halves of the reference: {first.reference_flip:.3f}."
    )
    head = "".join(f"<th>{name}</th>" for name in names)
    return (
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table><small>Bold: on the Pareto "
        f"front.{values}</small>"
    )


def _tip(point: Point) -> str:
    bias = percent(point.bias_rms) if point.bias_is_seen else f"< {percent(point.bias_limit)}"
    return (
        f"{point.line}, {_amount(point)} samples: {_time(point.seconds)}, total {percent(point.relative_rms)}, noise "
        f"{percent(point.noise_rms)}, bias {bias}, mottle {percent(point.mottle)}"
    )


def _amount(point: Point) -> str:
    """'16', 'draft, 4'."""
    return f"{point.quality}, {point.samples}" if point.quality else str(point.samples)


def _alt(points: Sequence[Point]) -> str:
    return " ".join(verdicts("", points))


def _key(point: Point) -> str:
    return f'<span class=key style="background:var(--{drawing.look(point.model)[0][1:]},{drawing.look(point.model)[0]})"></span>'  # noqa: E501


def _time(value: float) -> str:
    return f"{value:.0f} s" if value >= 99.5 else f"{value:.3g} s"


def _document(title: str, body: str) -> str:
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width,initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{drawing.theme()}{CSS}</style></head>\n<body>{body}</body></html>\n"
    )

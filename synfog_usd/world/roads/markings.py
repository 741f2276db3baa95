"""Lines, arrows, zebras and letters on the road, in the level plane of `surface`.

Lines are 12 cm wide in towns and on roads, 15 cm on motorways; worn where wheels
cross them by the texture of the paint.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from synfog_usd.world.lettering import strokes
from synfog_usd.world.roads.lane_section import PAVED, Lane
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.surface import bend, ribbon
from synfog_usd.world.shapes import Part, fan, rectangle, strip, textured_from_above

THICK_M = 0.003
TILE_M = 3.0
ZEBRA_DEPTH_M = 3.2
BAY_M = 5.8
BAY_ACROSS_M = 2.5
DEEP_M = 4.4
"""Bays along the road are BAY_M long; in parking deeper than DEEP_M cars stand across it, in bays BAY_ACROSS_M wide."""


def markings(road: Road) -> list[Part]:
    """Every marking of a road, laid on it."""
    parts = [*_lines(road), *_bays(road), *_arrows(road)]
    for s in road.zebras:
        parts += _zebra(road, s)
    return [bend(part, road) for part in parts]


def zebra_span(road: Road) -> tuple[float, float]:
    """Offsets [m] between which people cross."""
    paved = [lane for lane in road.lane_section.lanes if lane.kind in PAVED]
    return paved[0].low, paved[-1].high


def bays(road: Road) -> list[tuple[Lane, float]]:
    """(parking strip, station of the middle) of every bay."""
    middles = []
    for lane in road.lane_section.of("parking"):
        step = bay_length(lane)
        for low, high in _free(road):
            middles += [(lane, float(s) + step / 2 + 0.05) for s in np.arange(low + 5.0, high - 5.0 - step, step)]
    return middles


def bay_length(lane: Lane) -> float:
    """How much of the road one bay takes [m]."""
    return BAY_ACROSS_M if lane.width > DEEP_M else BAY_M


def painted_line(
    t: float, low: float, high: float, width: float, dash: tuple[float, float] | None = None
) -> list[Part]:
    """A line along the road, dashed or not."""
    pieces = [(low, high)] if dash is None else [(s, min(s + dash[0], high)) for s in np.arange(low, high, sum(dash))]
    parts = []
    for a, b in pieces:
        at = np.linspace(a, b, max(2, int(np.ceil((b - a) / 2.0)) + 1))
        loops = [np.array([(t - width / 2, s, THICK_M), (t + width / 2, s, THICK_M)]) for s in at]
        parts.append(strip(loops, "marking", uv=[loop[:, :2] / TILE_M for loop in loops]))
    return parts


def bar(across: tuple[float, float], along: tuple[float, float]) -> Part:
    """A painted rectangle from offset to offset and from station to station [m]."""
    (t0, t1), (s0, s1) = across, along
    return rectangle((t0, s0), (t1, s1), THICK_M, "marking", tile_m=TILE_M)


def _free(road: Road) -> list[tuple[float, float]]:
    """Stretches between zebras, where lines run."""
    cuts = [
        0.0,
        *(s + sign * (ZEBRA_DEPTH_M / 2 + 0.6) for s in sorted(road.zebras) for sign in (-1, 1)),
        road.reference_line.length,
    ]
    return list(zip(cuts[::2], cuts[1::2], strict=True))


def _lines(road: Road) -> list[Part]:
    parts: list[Part] = []
    strips = road.lane_section.lanes
    fast = any(lane.kind == "reserve" for lane in strips)
    wide = 0.15 if fast else 0.12
    urban = any(lane.kind == "pavement" for lane in strips)
    for low, high in _free(road):
        for before, lane in itertools.pairwise(strips):
            kinds = {before.kind, lane.kind}
            t = lane.low
            if kinds == {"lane"} and before.way != lane.way:
                if road.centre == "double":
                    parts += painted_line(t - 0.1, low, high, wide) + painted_line(t + 0.1, low, high, wide)
                elif road.centre != "none":
                    parts += painted_line(t, low, high, wide, road.dash if road.centre == "dashed" else None)
            elif kinds == {"lane"}:
                parts += painted_line(t, low, high, wide, road.dash)
            elif kinds == {"lane", "bus"}:
                parts += painted_line(t, low, high, 0.25)
            elif "cycle" in kinds and kinds & {"lane", "bus"}:
                parts += painted_line(t, low, high, 0.12, (1.0, 1.0))
            elif kinds & {"lane", "bus"} and kinds & {"shoulder"}:
                parts += painted_line(t, low, high, 2 * wide if fast else wide)
            elif kinds & {"lane", "bus"} and kinds & {"verge", "reserve", "island"} and not urban:
                inward = -1 if before.kind in ("lane", "bus") else 1
                parts += painted_line(t + 0.22 * inward, low, high, wide)
    return parts


def _bays(road: Road) -> list[Part]:
    """Ends of the parking bays, one every BAY_M, and their line to the lane."""
    parts: list[Part] = []
    for lane in road.lane_section.of("parking"):
        inner, outer = (lane.low, lane.high) if lane.middle > 0 else (lane.high, lane.low)
        for low, high in _free(road):
            for s in np.arange(low + 5.0, high - 5.0, bay_length(lane)):
                a, b = sorted((inner, inner + 0.8 * (outer - inner)))
                parts.append(bar((a, b), (s, s + 0.1)))
                if bay_length(lane) == BAY_M:
                    parts += painted_line(inner, s, s + 1.0, 0.1)
    return parts


def _arrows(road: Road) -> list[Part]:
    """Arrows where lanes of one way lie side by side, letters on bus lanes."""
    parts: list[Part] = []
    lanes = road.driving_lanes
    fast = any(lane.kind == "reserve" for lane in road.lane_section.lanes)
    for lane in lanes:
        same_way = [neighbour for neighbour in lanes if neighbour.way == lane.way]
        for s in np.arange(30.0, road.reference_line.length - 15.0, 85.0):
            if any(abs(s - zebra) < 9.0 for zebra in road.zebras):
                continue
            if lane.kind == "bus":
                parts += _letters(lane, s)
            elif len(same_way) > 1 and not fast:
                parts += arrow(lane, s)
    return parts


def arrow(lane: Lane, s: float) -> list[Part]:
    """An arrow 5 m long from station s on, the way that a lane goes."""
    outlines: Sequence[Sequence[tuple[float, float]]] = (
        [(-0.08, 0), (0.08, 0), (0.08, 3.2), (-0.08, 3.2)],
        [(-0.38, 3.2), (0.38, 3.2), (0, 5.0)],
    )
    return [
        fan([(lane.middle + lane.way * u, s + lane.way * v, THICK_M) for u, v in outline], "marking", tile_m=TILE_M)
        for outline in outlines
    ]


def _letters(lane: Lane, s: float) -> list[Part]:
    """BUS, drawn out along the road to be read from a car."""
    parts = []
    for place, letter in enumerate("BUS"):
        begin = lane.middle + lane.way * (-1.15 + 0.85 * place)
        for grid in strokes(letter):
            points = np.c_[begin + lane.way * grid[:, 0] * 0.15, s + lane.way * grid[:, 1] * 0.42]
            parts.append(textured_from_above(ribbon(points, 0.13, THICK_M, "marking"), TILE_M))
    return parts


def _zebra(road: Road, s: float) -> list[Part]:
    """Stripes of half a metre across the carriageway, and a stop line before them in each lane."""
    low, high = zebra_span(road)
    islands: list[Lane] = [lane for lane in road.lane_section.lanes if lane.kind not in PAVED]
    parts = []
    for t in np.arange(low + 0.3, high - 0.5, 1.0):
        if any(lane.low - 0.1 < t + 0.25 < lane.high + 0.1 for lane in islands):
            continue
        a, b = s - ZEBRA_DEPTH_M / 2, s + ZEBRA_DEPTH_M / 2
        edges = [t, *(lane.low for lane in road.lane_section.lanes if t < lane.low < t + 0.5), t + 0.5]
        # a stripe over the crown bends with it
        parts += [bar(ends, (a, b)) for ends in itertools.pairwise(edges)]
    for lane in road.driving_lanes:
        at = s - lane.way * (ZEBRA_DEPTH_M / 2 + 1.2)
        t0, t1 = lane.middle - lane.width / 2 + 0.1, lane.middle + lane.width / 2 - 0.1
        y0, y1 = sorted((at, at - lane.way * 0.4))
        parts.append(bar((t0, t1), (y0, y1)))
    return parts

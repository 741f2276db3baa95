"""Lanes as a stage tells them: two edges along the way that is driven, after Lanelet2; types are OpenDRIVE's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.world.roads import surface
from synfog_usd.world.roads.network import Road

TYPES = {"lane": "driving", "bus": "bus", "parking": "parking", "shoulder": "shoulder", "cycle": "biking"}
"""Paved kinds of a lane section -> types of OpenDRIVE."""


@dataclass(frozen=True)
class EdgedLane:
    """One lane.

    Attributes:
        type: of OpenDRIVE, one of TYPES' values.
        left, right: (N, 3) and (M, 3) edges [m], in the order and from the seat of who drives there.
    """

    type: str
    left: Array
    right: Array


def of_road(road: Road) -> list[EdgedLane]:
    """Every paved strip of a road, from left to right; what nobody drives along goes the way of its side."""
    s = surface.stations(road)
    edged = []
    for lane in road.lane_section.of(*TYPES):
        way = lane.way or (1 if lane.middle > 0 else -1)
        low, high = (edge(road, s, np.full(len(s), t)) for t in (lane.low, lane.high))
        edged.append(EdgedLane(TYPES[lane.kind], *((low, high) if way > 0 else (high[::-1], low[::-1]))))
    return edged


def edge(road: Road, s: Array, t: Array) -> Array:
    """(N, 3) points of a road [m] at stations and offsets, on its surface."""
    x, y = road.reference_line.place(s, t)
    return np.c_[x, y, road.reference_line.height(s) + road.over_line(t, road.lane_section.height(t))]

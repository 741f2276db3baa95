"""Drawn roads and junctions as OpenDRIVE 1.8: what a road, a crossing and a roundabout are in its terms.

Takes the record of a road or junction; writes a file.  Knows nothing of USD.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from synfog_usd.base.errors import RecipeError
from synfog_usd.world.roads import crossing
from synfog_usd.world.roads.crossing import Crossing
from synfog_usd.world.roads.crossing_actors import STOP, STOP_SIDE
from synfog_usd.world.roads.lane_section import KERB_M, Lane
from synfog_usd.world.roads.markings import zebra_span
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.reference_line import ReferenceLine
from synfog_usd.world.roads.roundabout import HOLD_M, TAPER_M, ZEBRA_HALF_M, Roundabout
from synfog_usd.world.spec import Site
from synfog_usd.world.traffic.xodr import (
    LEAST_M,
    Cubic,
    Junction,
    LinePiece,
    Network,
    OpenRoad,
    Pose,
    Strip,
    bend,
    write_network,
)  # fmt: skip

TYPES = {
    "lane": "driving", "bus": "driving", "parking": "parking", "shoulder": "shoulder", "cycle": "biking",
    "pavement": "walking", "garden": "none", "island": "median", "verge": "none", "reserve": "median",
}  # fmt: skip
"""Kind of a strip -> type of a lane."""
SHORTEST_M = 0.2
"""Of a piece of the ring."""
EVEN_M = 2.0
"""Of pieces of the ring: SUMO takes points 2 m apart and one at the end, and calls a short rest a sharp turn."""
CENTRE = {"dashed": "broken", "solid": "solid", "double": "solid solid", "none": "none"}


def write(path: Path, site: Site, name: str) -> None:
    """Write a road or junction as OpenDRIVE.

    Args:
        path: .xodr.
        site: one of NETWORKS' kinds.
        name: of what was drawn.

    Raises:
        OutputError: it cannot be written.
    """
    write_network(path, NETWORKS[type(site)](site), name)


# -- a road


def _of_road(road: Road) -> Network:
    line, section = road.reference_line, road.lane_section
    axis = _axis(section.lanes)
    strips = []
    for side in (1, -1):  # left, right
        lanes = [lane for lane in section.lanes if (lane.middle < axis) == (side > 0)]
        lanes = lanes[::-1] if side > 0 else lanes
        for number, lane in enumerate(lanes, 1):
            low, high = section.ends(lane)
            after = lanes[number] if number < len(lanes) else None
            marked = after is not None and {lane.kind, after.kind} <= {"lane", "bus"}
            strips.append(
                Strip(
                    side * number, TYPES[lane.kind], [(0.0, lane.width, 0.0, 0.0, 0.0)],
                    (high, low) if side > 0 else (low, high), mark="broken" if marked else "none",
                    buses=lane.kind == "bus", against=lane.way != 0 and lane.way == side,
                )
            )  # fmt: skip
    zebras = []
    for s in road.zebras:
        low, high = zebra_span(road)
        zebras.append((s, 2.0 * ZEBRA_HALF_M, high - low))
    offset = [(0.0, -axis, 0.0, 0.0, 0.0)] if axis else []
    drawn = OpenRoad(1, "road", _pieces(line), strips, _heights(line), offset, CENTRE[road.centre], zebras=zebras)
    return Network([replace(drawn, shape=_crossfall(road))])


def _axis(lanes: Sequence[Lane]) -> float:
    """Offset to the right of the reference line at which the side of a road changes [m]: the edge nearest to it."""
    edges = [lanes[0].low, *(lane.high for lane in lanes)]
    return min(edges, key=abs)


def _pieces(line: ReferenceLine) -> list[LinePiece]:
    """Straights, arcs and clothoids between the knots of a line's curvature."""
    knots = [(s, k) for s, k in line.curvature if s < line.length]
    last = float(np.interp(line.length, *np.array(line.curvature).T))
    result = []
    for (s, k), (end, then) in zip(knots, [*knots[1:], (line.length, last)], strict=True):
        if end - s < LEAST_M:
            continue
        x, y = line.place(s, 0.0)
        result.append(LinePiece(float(x), float(y), float(line.heading(s)) + math.pi / 2.0, end - s, k, then))
    return result


def _heights(line: ReferenceLine) -> list[Cubic]:
    """Parabolas between the knots of a line's slope."""
    knots = [(s, slope) for s, slope in line.slope if s < line.length]
    last = float(np.interp(line.length, *np.array(line.slope).T))
    return [
        (s, float(line.height(s)), slope, (then - slope) / (2.0 * (end - s)), 0.0)
        for (s, slope), (end, then) in zip(knots, [*knots[1:], (line.length, last)], strict=True)
        if end - s > LEAST_M
    ]


def _crossfall(road: Road) -> list[Cubic]:
    """Straight lines between the edges, gutters and crown of a road, from its right edge to the left."""
    section = road.lane_section
    t = np.unique([-section.low, -section.high, *(-offset for offset in section.falling)])
    heights = road.over_line(-t)
    rows = zip(t[:-1], heights[:-1], np.diff(heights) / np.diff(t), strict=True)
    return [(float(at), float(height), float(slope), 0.0, 0.0) for at, height, slope in rows] if road.crossfall else []


# -- junctions


def _through(
    network: Network,
    junction: int,
    begin: tuple[int, int, str],
    end: tuple[int, int, str],
    pieces: Sequence[LinePiece],
    widths: tuple[float, float],
) -> tuple[int, int, int, int]:
    """Add a road of one lane through a junction, its reference line in the lane's middle; gives its way.

    Args:
        network: to which it is added.
        junction: its number.
        begin, end: number of a road, of its lane, and which of its ends.
        pieces: of the line.
        widths: of the lane where it begins and ends [m].
    """
    number = len(network.roads) + 1
    length = sum(piece.length for piece in pieces)
    grows = (widths[1] - widths[0]) / length
    lane = Strip(-1, "driving", [(0.0, widths[0], grows, 0.0, 0.0)], before=begin[1], after=end[1])
    offset = [(0.0, widths[0] / 2.0, grows / 2.0, 0.0, 0.0)]
    ends = ("road", begin[0], begin[2]), ("road", end[0], end[2])
    network.roads.append(OpenRoad(number, "way", pieces, [lane], offset=offset, junction=junction, ends=ends))
    return begin[0], number, begin[1], -1


def _of_crossing(site: Crossing) -> Network:
    """Four arms from the lines at which traffic waits outwards, and every way from one to another."""
    network = Network()
    lane, half = crossing.LANE_M, crossing.SIDE_HALF
    (south_far, south_near), north = crossing.BAYS_Y
    kerb, bay_m = crossing.MAIN_HALF - lane, crossing.BAY_M
    for degrees, begin, end, width, rows in (
        (90.0, STOP, crossing.NORTH, lane, [north]),
        (180.0, STOP_SIDE, crossing.SIDE, half, []),
        (270.0, STOP, crossing.SOUTH, lane, [(-south_near, -south_far)]),
        (0.0, STOP_SIDE, crossing.SIDE, half, []),
    ):
        h = math.radians(degrees)
        beside = (("shoulder", kerb),) if rows else ()  # SUMO takes type parking for a lane that has to go on
        strips = [
            Strip(side * number, kind, [(0.0, size, 0.0, 0.0, 0.0)])
            for side in (1, -1)
            for number, (kind, size) in enumerate((("driving", width), *beside), 1)
        ]
        bays = [
            (low - begin + bay_m / 2.0, round((high - low) / bay_m), bay_m, side * (lane + kerb / 2.0), kerb)
            for low, high in rows
            for side in (1, -1)
        ]
        piece = LinePiece(begin * math.cos(h), begin * math.sin(h), h, end - begin)
        ends = ("junction", 1, ""), None
        network.roads.append(
            OpenRoad(len(network.roads) + 1, "arm", [piece], strips, centre="broken", ends=ends, bays=bays)
        )
    arms = network.roads[:4]
    ways = []
    for arm, goal in itertools.permutations(arms, 2):
        near, far = _mouth(arm, 1), _mouth(goal, -1)
        widths = arm.strips[0].widths[0][1], goal.strips[0].widths[0][1]
        ways.append(_through(network, 1, (arm.number, 1, "start"), (goal.number, -1, "start"), bend(near, far), widths))
    network.junctions.append(Junction(1, "crossing", ways))
    return network


def _mouth(arm: OpenRoad, lane: int) -> Pose:
    """Middle of a lane of an arm that begins at a junction: of the one that comes in (1) or goes out (-1)."""
    piece = arm.pieces[0]
    width = next(strip.widths[0][1] for strip in arm.strips if strip.number == lane)
    t = lane * width / 2.0
    heading = piece.hdg + (math.pi if lane > 0 else 0.0)
    return piece.x - t * math.sin(piece.hdg), piece.y + t * math.cos(piece.hdg), heading


def _of_roundabout(site: Roundabout) -> Network:
    """Arms, the ring in pieces between them, and at each arm a junction of three ways: in, out, and round."""
    network = Network()
    count, width = len(site.arms), site.lane_width
    middle, ring_width = (site.radius + site.inner) / 2.0, site.radius - site.inner
    mouths = [_arm_of(site, number, network) for number in range(count)]
    for number in range(count):  # from where one arm's way in meets the ring to where the next one's way out leaves it
        piece = _along_ring(mouths[number].merges, mouths[(number + 1) % count].leaves, middle)
        if not SHORTEST_M < piece.length < 1.9 * math.pi * middle:
            raise RecipeError(
                f"--opendrive: arms {number + 1} and {(number + 1) % count + 1} of the roundabout are too near "
                "to have a piece of the ring between them; take another seed, or fewer arms"
            )
        lane = Strip(-1, "driving", [(0.0, ring_width, 0.0, 0.0, 0.0)])
        ends = ("junction", number + 1, ""), ("junction", (number + 1) % count + 1, "")
        offset = [(0.0, ring_width / 2.0, 0.0, 0.0, 0.0)]
        network.roads.append(OpenRoad(len(network.roads) + 1, "ring", _even(piece), [lane], offset=offset, ends=ends))
    for number, mouth in enumerate(mouths):
        here, before = count + number + 1, count + (number - 1) % count + 1
        arm, junction = number + 1, number + 1
        round_ = _along_ring(mouth.leaves, mouth.merges, middle)
        ways = [
            _through(network, junction, (arm, 2, "start"), (here, -1, "start"), mouth.inwards, (width, ring_width)),
            _through(network, junction, (before, -1, "end"), (arm, -2, "start"), mouth.outwards, (ring_width, width)),
            _through(network, junction, (before, -1, "end"), (here, -1, "start"), [round_], (ring_width, ring_width)),
        ]
        network.junctions.append(Junction(junction, f"arm {arm}", ways))
    return network


def _along_ring(begin: float, end: float, radius: float) -> LinePiece:
    """A piece of a circle round the origin, counter-clockwise between two angles from +X [rad]."""
    turn = (end - begin) % (2.0 * math.pi)
    x, y = radius * math.cos(begin), radius * math.sin(begin)
    return LinePiece(x, y, begin + math.pi / 2.0, turn * radius, 1.0 / radius, 1.0 / radius)


def _even(arc: LinePiece) -> list[LinePiece]:
    """An arc in even pieces of at most EVEN_M."""
    count = math.ceil(arc.length / EVEN_M)
    cut = [replace(arc, length=number * arc.length / count).after() for number in range(count)]
    return [replace(arc, x=x, y=y, hdg=h, length=arc.length / count) for x, y, h in cut]


@dataclass(frozen=True)
class _Mouth:
    """Where an arm meets the ring: angles from +X at which its way in comes to the ring and its way out leaves it
    [rad], and these ways.
    """

    merges: float
    leaves: float
    inwards: Sequence[LinePiece]
    outwards: Sequence[LinePiece]


def _arm_of(site: Roundabout, number: int, network: Network) -> _Mouth:
    """Add an arm, which begins where its arcs to the ring do; gives how it meets the ring."""
    road, width, middle = site.arms[number], site.lane_width, (site.radius + site.inner) / 2.0
    line, e = road.reference_line, site.half_island + width / 2.0
    radii = [site.corners[number] + width / 2.0, site.corners[number - 1] + width / 2.0]  # in, out
    feet = [math.sqrt((middle + r) ** 2 - (e + r) ** 2) for r in radii]
    first = max(feet)
    x, y = (float(v) for v in line.place(first, 0.0))
    h = float(line.heading(first)) + math.pi / 2.0
    taper = site.radius + HOLD_M + TAPER_M
    full = taper - TAPER_M  # as far as here the island has its full width
    half = site.half_island
    narrows = [(0.0, half, 0.0, 0.0, 0.0), (full - first, half, 0.0, -3.0 * half / TAPER_M**2, 2.0 * half / TAPER_M**3),
               (taper - first, 0.0, 0.0, 0.0, 0.0)]  # fmt: skip
    strips = [
        Strip(side * place, kind, widths, raised)
        for side in (1, -1)
        for place, (kind, widths, raised) in enumerate(
            (
                ("median", narrows, (0.0, 0.0)),
                ("driving", [(0.0, width, 0.0, 0.0, 0.0)], (0.0, 0.0)),
                ("walking", [(0.0, site.pavement, 0.0, 0.0, 0.0)], (KERB_M, KERB_M)),
            ),
            1,
        )
    ]
    pieces = _cut(_pieces(line), first)
    zebra = road.zebras[0] - first
    zebras = [(zebra, 2.0 * ZEBRA_HALF_M, 2.0 * (half + width))] if zebra > 0.0 else []
    network.roads.append(
        OpenRoad(
            number + 1, f"arm {number + 1}", pieces, strips, ends=(("junction", number + 1, ""), None), zebras=zebras
        )
    )
    ways: list[list[LinePiece]] = []
    angles = []
    for way, r, foot in zip((1.0, -1.0), radii, feet, strict=True):  # the lane in lies to the left of the arm's line
        angle = math.atan2(foot, e + r)
        begin = x - way * e * math.sin(h), y + way * e * math.cos(h), h + math.pi
        straight = LinePiece(*begin, first - foot)
        lead = [straight] if straight.length > LEAST_M else []
        arc = LinePiece(*(straight.after() if lead else begin), r * angle, -way / r, -way / r)
        end = arc.after()
        angles.append(math.atan2(end[1], end[0]))
        inwards = [*lead, arc]
        ways.append(inwards if way > 0.0 else _reversed(inwards))
    return _Mouth(angles[0], angles[1], ways[0], ways[1])


def _reversed(pieces: Sequence[LinePiece]) -> list[LinePiece]:
    """The same line from its end to its beginning."""
    result = []
    for piece in reversed(pieces):
        x, y, h = piece.after()
        result.append(LinePiece(x, y, h + math.pi, piece.length, -piece.end, -piece.begin))
    return result


def _cut(pieces: Sequence[LinePiece], s: float) -> list[LinePiece]:
    """A line from a station on; the piece there is no clothoid."""
    result, at = [], 0.0
    for piece in pieces:
        if at + piece.length > s + LEAST_M:
            gone = max(s - at, 0.0)
            x, y, h = replace(piece, length=gone).after() if gone else (piece.x, piece.y, piece.hdg)
            result.append(replace(piece, x=x, y=y, hdg=h, length=piece.length - gone))
        at += piece.length
    return result


NETWORKS: Mapping[type, Callable[..., Network]] = {
    Road: _of_road,
    Crossing: _of_crossing,
    Roundabout: _of_roundabout,
}

"""Roads and junctions in OpenDRIVE's terms, and how they are written.

Lanes to the right of a reference line have negative numbers, t is positive to its left, and headings count from +X.
Source: ASAM OpenDRIVE 1.8.1, asam.net/standards/detail/opendrive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from synfog_usd.base.files import write_bytes

Cubic = tuple[float, float, float, float, float]
"""s from where it holds [m], and a, b, c, d of a + b ds + c ds^2 + d ds^3."""
Pose = tuple[float, float, float]
"""x, y [m] and heading from +X [rad]."""
LEAST_M = 1e-6
"""Of any piece of a line."""
WIDEST_M = 12.0
"""Radius of a turn through a junction, at most: a wider one would cut into the lane that comes towards it."""


@dataclass(frozen=True)
class LinePiece:
    """A piece of a reference line: where it begins [m, rad], its length [m] and curvature from and to [1/m]."""

    x: float
    y: float
    hdg: float
    length: float
    begin: float = 0.0
    end: float = 0.0

    def after(self) -> Pose:
        """Where a line or an arc ends."""
        turn = self.begin * self.length
        chord = self.length if not self.begin else 2.0 * math.sin(turn / 2.0) / self.begin
        way = self.hdg + turn / 2.0
        return self.x + chord * math.cos(way), self.y + chord * math.sin(way), self.hdg + turn


def bend(begin: Pose, end: Pose) -> list[LinePiece]:
    """Straight, arc and straight from one pose to another, the arc as wide as fits, up to WIDEST_M."""
    (x, y, h), (to_x, to_y, to_h) = begin, end
    turn = math.remainder(to_h - h, 2.0 * math.pi)
    along, aside = (
        (to_x - x) * math.cos(h) + (to_y - y) * math.sin(h),
        (to_y - y) * math.cos(h) - (to_x - x) * math.sin(h),
    )
    if abs(turn) < 1e-9:
        return [LinePiece(x, y, h, along)]
    second = aside / math.sin(turn)  # from the corner where the two straights meet
    first = along - second * math.cos(turn)
    reach = min(first, second, WIDEST_M * math.tan(abs(turn) / 2.0))
    radius = reach / math.tan(abs(turn) / 2.0)
    pieces = [LinePiece(x, y, h, first - reach)] if first - reach > LEAST_M else []
    arc = LinePiece(
        *(pieces[0].after() if pieces else begin), radius * abs(turn), *(math.copysign(1.0 / radius, turn),) * 2
    )
    pieces.append(arc)
    if second - reach > LEAST_M:
        pieces.append(LinePiece(*arc.after(), second - reach))
    return pieces


@dataclass(frozen=True)
class Strip:
    """A lane.

    Attributes:
        number: positive to the left of the reference line, negative to the right.
        type: of OpenDRIVE.
        widths: [m].
        raised: heights of its inner and outer edge over the carriageway [m].
        before, after: numbers of the lanes that it continues and that continue it.
        mark: at its outer edge.
        buses: whether only they may use it; against: whether it is driven the other way than its side.
    """

    number: int
    type: str
    widths: Sequence[Cubic]
    raised: tuple[float, float] = (0.0, 0.0)
    before: int | None = None
    after: int | None = None
    mark: str = "none"
    buses: bool = False
    against: bool = False


@dataclass(frozen=True)
class OpenRoad:
    """A road of the file.

    Attributes:
        number: its id; name: for people.
        pieces: of the reference line.
        strips: lanes.
        elevation, offset: heights of the line, and where the lanes' middle is to the left of it [m].
        centre: mark in the middle.
        junction: number of the junction that it is a way through, or -1.
        ends: what is before and after it: ('road' or 'junction', number, 'start', 'end' or '').
        zebras: (station, length along the road, width across) of crosswalks [m].
        shape: heights of the surface over the line, by t instead of s [m].
        bays: (station of the first bay's middle, number, length along the road, t of its middle, width) of rows of
            parking bays [m].
    """

    number: int
    name: str
    pieces: Sequence[LinePiece]
    strips: Sequence[Strip]
    elevation: Sequence[Cubic] = ((0.0, 0.0, 0.0, 0.0, 0.0),)
    offset: Sequence[Cubic] = ()
    centre: str = "none"
    junction: int = -1
    ends: tuple[tuple[str, int, str] | None, tuple[str, int, str] | None] = (None, None)
    zebras: Sequence[tuple[float, float, float]] = ()
    shape: Sequence[Cubic] = ()
    bays: Sequence[tuple[float, int, float, float, float]] = ()

    @property
    def length(self) -> float:
        """[m]."""
        return sum(piece.length for piece in self.pieces)


@dataclass(frozen=True)
class Junction:
    """A junction: (incoming road, connecting road, from lane, to lane) of each way through it."""

    number: int
    name: str
    ways: Sequence[tuple[int, int, int, int]]


@dataclass
class Network:
    """Roads and junctions of a file."""

    roads: list[OpenRoad] = field(default_factory=list)
    junctions: list[Junction] = field(default_factory=list)


def write_network(path: Path, network: Network, name: str) -> None:
    """Write roads and junctions to a file.

    Raises:
        OutputError: it cannot be written.
    """
    root = ElementTree.Element("OpenDRIVE")
    points = [(piece.x, piece.y) for road in network.roads for piece in road.pieces]
    (west, south), (east, north) = np.min(points, axis=0), np.max(points, axis=0)
    ElementTree.SubElement(
        root, "header", revMajor="1", revMinor="8", name=name, version="1.00",
        north=_number(north), south=_number(south), east=_number(east), west=_number(west), vendor="synfog-usd",
    )  # fmt: skip
    for road in network.roads:
        _write_road(root, road)
    for junction in network.junctions:
        _write_junction(root, junction)
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n")


# -- elements


def _number(value: float) -> str:
    return f"{value:.12g}" if abs(value) > 1e-13 else "0"


def _put(parent: ElementTree.Element, tag: str, **values: str | float) -> ElementTree.Element:
    """An element with numbers and texts."""
    texts = {key: value if isinstance(value, str) else _number(value) for key, value in values.items()}
    return ElementTree.SubElement(parent, tag, texts)


def _cubics(parent: ElementTree.Element, tag: str, rows: Sequence[Cubic], at: str = "s", **more: float) -> None:
    for row in rows:
        _put(parent, tag, **more, **dict(zip((at, "a", "b", "c", "d"), row, strict=True)))


def _write_road(root: ElementTree.Element, road: OpenRoad) -> None:
    element = _put(
        root, "road", name=road.name, length=road.length, id=str(road.number), junction=str(road.junction), rule="RHT"
    )
    link = _put(element, "link")
    for tag, end in zip(("predecessor", "successor"), road.ends, strict=True):
        if end:
            contact = {"contactPoint": end[2]} if end[2] else {}
            _put(link, tag, elementType=end[0], elementId=str(end[1]), **contact)
    plan, s = _put(element, "planView"), 0.0
    for piece in road.pieces:
        geometry = _put(plan, "geometry", s=s, x=piece.x, y=piece.y, hdg=piece.hdg, length=piece.length)
        if piece.begin != piece.end:
            _put(geometry, "spiral", curvStart=piece.begin, curvEnd=piece.end)
        elif piece.begin:
            _put(geometry, "arc", curvature=piece.begin)
        else:
            _put(geometry, "line")
        s += piece.length
    _cubics(_put(element, "elevationProfile"), "elevation", road.elevation)
    if road.shape:
        _cubics(_put(element, "lateralProfile"), "shape", road.shape, "t", s=0.0)
    lanes = _put(element, "lanes")
    _cubics(lanes, "laneOffset", road.offset)
    section = _put(lanes, "laneSection", s=0.0)
    leftwards = sorted((strip for strip in road.strips if strip.number > 0), key=lambda strip: -strip.number)
    right = sorted((strip for strip in road.strips if strip.number < 0), key=lambda strip: -strip.number)
    if leftwards:
        group = _put(section, "left")
        for strip in leftwards:
            _write_lane(group, strip)
    middle = _put(_put(section, "center"), "lane", id="0", type="none", level="false")
    _put(middle, "roadMark", sOffset=0.0, type=road.centre, color="white", width=0.12)
    if right:
        group = _put(section, "right")
        for strip in right:
            _write_lane(group, strip)
    if road.zebras or road.bays:
        _write_objects(_put(element, "objects"), road)


def _write_objects(objects: ElementTree.Element, road: OpenRoad) -> None:
    flat: dict[str, str | float] = {
        "zOffset": 0.0,
        "hdg": 0.0,
        "pitch": 0.0,
        "roll": 0.0,
        "orientation": "none",
        "height": 0.01,
    }
    for number, (s, along, across) in enumerate(road.zebras):
        _put(objects, "object", id=str(1000 * road.number + number), name="zebra", type="crosswalk", s=s, t=0.0,
             length=along, width=across, **flat)  # fmt: skip
    for number, (s, count, along, t, across) in enumerate(road.bays, len(road.zebras)):
        row = _put(objects, "object", id=str(1000 * road.number + number), name="bay", type="parkingSpace", s=s, t=t,
                   length=along, width=across, **flat)  # fmt: skip
        _put(row, "repeat", s=s, length=(count - 1) * along, distance=along, tStart=t, tEnd=t,
             heightStart=0.01, heightEnd=0.01, zOffsetStart=0.0, zOffsetEnd=0.0)  # fmt: skip
        _put(row, "parkingSpace", access="car")


def _write_lane(group: ElementTree.Element, strip: Strip) -> None:
    reversed_ = {"direction": "reversed"} if strip.against else {}
    lane = _put(group, "lane", id=str(strip.number), type=strip.type, level="false", **reversed_)
    if strip.before is not None or strip.after is not None:
        link = _put(lane, "link")
        for tag, number in (("predecessor", strip.before), ("successor", strip.after)):
            if number is not None:
                _put(link, tag, id=str(number))
    _cubics(lane, "width", strip.widths, "sOffset")
    _put(lane, "roadMark", sOffset=0.0, type=strip.mark, color="white", width=0.12)
    if strip.buses:
        _put(lane, "access", sOffset=0.0, rule="allow", restriction="bus")
    if any(strip.raised):
        _put(lane, "height", sOffset=0.0, inner=strip.raised[0], outer=strip.raised[1])


def _write_junction(root: ElementTree.Element, junction: Junction) -> None:
    element = _put(root, "junction", name=junction.name, id=str(junction.number), type="default")
    for number, (incoming, connecting, begin, end) in enumerate(junction.ways):
        way = _put(element, "connection", id=str(number), incomingRoad=str(incoming),
                   connectingRoad=str(connecting), contactPoint="start")  # fmt: skip
        _put(way, "laneLink", **{"from": str(begin), "to": str(end)})

"""Where one drives and walks: lines with a heading and a bend at each station, for every road and junction.

Takes the record of a road or junction; gives its lanes as routes and its pavements as paths.  Knows nothing of who is
on them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import ndimage, spatial

from synfog_usd.base.arrays import Array
from synfog_usd.world.roads import crossing
from synfog_usd.world.roads.crossing import Crossing
from synfog_usd.world.roads.crossing_actors import STOP, STOP_SIDE
from synfog_usd.world.roads.lane_section import EDGE_M, Lane
from synfog_usd.world.roads.network import Road
from synfog_usd.world.roads.roundabout import ZEBRA_HALF_M, Roundabout
from synfog_usd.world.spec import Site
from synfog_usd.world.traffic.signals import MAIN, SIDE
from synfog_usd.world.traffic.xodr import bend

STEP_M = 0.5
FAR_M = 15.0
"""From a path; what is farther away is not beside it."""
SIDEWAYS = 2.9
"""Acceleration at which drivers take bends [m/s2]: 0.3 g."""
EASING = 1.1
"""Deceleration before bends [m/s2]."""
ROUNDED_M = 4.0
"""Over which a driver turns the wheel where a straight meets an arc."""
AT_LINE_M = 0.5
"""Between a bumper and the line that it waits at."""
ZEBRA_LINE_M = 2.9
"""From the middle of a zebra to where bumpers wait."""
HOLDS_M = 2.0
"""From where a turn to the left begins to where bumpers wait for those who come towards it."""
TURN_S, TURN = 6.0, 0.3
"""Time for which a turn to the left needs the road, and share of those who turn to a side."""
INDICATES_M = 30.0
"""Before a junction."""
FOOTWAY_X, FOOTWAY_Y = 8.3, 6.6
"""Middles of the pavements of the crossing's main and side street [m]."""
ZEBRA_X, ZEBRA_Y = crossing.ZEBRA_SIDE + crossing.ZEBRA_DEPTH / 2, crossing.ZEBRA + crossing.ZEBRA_DEPTH / 2
"""Middles of the zebras over the side and the main street, from the middle of the crossing [m]."""


@dataclass(frozen=True)
class Path:
    """A line in the plane.

    Attributes:
        points: (N, 2) [m], about STEP_M apart.
        width: of the strip around it that is free [m].
    """

    points: Array
    width: float

    @cached_property
    def s(self) -> Array:
        """(N,) stations [m]."""
        return np.r_[0.0, np.cumsum(np.hypot(*np.diff(self.points, axis=0).T))]

    @cached_property
    def heading(self) -> Array:
        """(N,) direction [rad], counter-clockwise from +Y, without jumps of a turn."""
        d = np.gradient(self.points, self.s, axis=0)
        return np.unwrap(np.arctan2(-d[:, 0], d[:, 1]))

    @cached_property
    def curvature(self) -> Array:
        """(N,) turn per length [1/m], positive to the left."""
        return np.gradient(self.heading, self.s)

    @cached_property
    def limit(self) -> Array:
        """(N,) speed [m/s] at which the bends here and ahead can be taken at SIDEWAYS, braking at EASING."""
        square = SIDEWAYS / np.maximum(np.abs(self.curvature), 1e-6)
        ahead = square + 2.0 * EASING * self.s  # the least from here on, seen from here
        return np.sqrt(np.minimum.accumulate(ahead[::-1])[::-1] - 2.0 * EASING * self.s)

    @cached_property
    def _tree(self) -> spatial.cKDTree:
        return spatial.cKDTree(self.points)

    @property
    def length(self) -> float:
        """[m]."""
        return float(self.s[-1])

    def at(self, s: npt.ArrayLike, aside: npt.ArrayLike = 0.0) -> tuple[Array, Array, Array]:
        """x, y [m] and heading [rad] at stations, `aside` [m] to the right; straight on beyond the ends."""
        s = np.asarray(s, dtype=np.float64)
        inside = np.clip(s, 0.0, self.length)
        x, y = (np.interp(inside, self.s, column) for column in self.points.T)
        h, over = np.interp(inside, self.s, self.heading), s - inside
        return (
            x - over * np.sin(h) + aside * np.cos(h),
            y + over * np.cos(h) + aside * np.sin(h),
            h,
        )

    def nearest(self, xy: Array) -> tuple[Array, Array]:
        """Station and offset to the right [m] of (..., 2) places; the offset is inf beyond the ends and FAR_M away."""
        away, k = self._tree.query(xy, distance_upper_bound=FAR_M)
        k = np.where(np.isfinite(away), k, 0)
        d, h = xy - self.points[k], self.heading[k]
        along = d[..., 1] * np.cos(h) - d[..., 0] * np.sin(h)
        aside = d[..., 0] * np.cos(h) + d[..., 1] * np.sin(h)
        return self.s[k] + along, np.where((np.abs(along) > 1.5 * STEP_M) | (away > FAR_M), np.inf, aside)


@dataclass(frozen=True)
class GiveWay:
    """A line that waits for those who are in a junction already.

    Attributes:
        s: of the line, along the route [m].
        meet: x, y where the route meets theirs [m].
        free_s: who comes there within this time is waited for [s].
    """

    s: float
    meet: tuple[float, float]
    free_s: float = 3.5


@dataclass(frozen=True)
class StopLine:
    """A line before a signal.

    Attributes:
        s: of the line, along the route [m].
        street: whose signal it is, MAIN or SIDE.
    """

    s: float
    street: int


@dataclass(frozen=True)
class Crosswalk:
    """A way for people over a street that has signals.

    Attributes:
        begin, end: x, y at its two kerbs [m].
        street: which it crosses, MAIN or SIDE.
    """

    begin: tuple[float, float]
    end: tuple[float, float]
    street: int


@dataclass(frozen=True)
class Route:
    """A lane as it is driven, from one end of the drawn road to another.

    Attributes:
        path: its middle.
        signals: lines before signals.
        zebras: stations of the middles of zebra crossings [m].
        gives_way: lines before other traffic.
        turns: (from, to) [m] and side, 1 for left and -1 for right, where an indicator blinks.
        left, right: numbers of the lanes beside it that go the same way, -1 for none.
        holds: where one waits for what would stop one before the second of these stations [m].
        kind: of the lane; share: of those who come to its beginning, over that of others from there.
        begins: station at which the drawn road begins [m].
    """

    path: Path
    signals: tuple[StopLine, ...] = ()
    zebras: tuple[float, ...] = ()
    gives_way: tuple[GiveWay, ...] = ()
    turns: tuple[tuple[float, float, int], ...] = field(default=())
    left: int = -1
    right: int = -1
    holds: tuple[float, float] | None = None
    kind: str = "lane"
    share: float = 1.0
    begins: float = 0.0

    @cached_property
    def tight(self) -> float:
        """Radius of its tightest bend [m]."""
        return 1.0 / max(float(np.abs(self.path.curvature).max()), 1e-6)

    def led(self, way_m: float) -> Route:
        """The same with a straight way to its beginning, outside of the drawn road."""
        count = math.ceil(way_m / STEP_M)
        h, by = float(self.path.heading[0]), count * STEP_M
        steps = np.arange(-count, 0)[:, None] * STEP_M
        lead = self.path.points[0] + steps * (-math.sin(h), math.cos(h))
        return replace(
            self,
            path=Path(np.concatenate([lead, self.path.points]), self.path.width),
            signals=tuple(replace(line, s=line.s + by) for line in self.signals),
            zebras=tuple(s + by for s in self.zebras),
            gives_way=tuple(replace(line, s=line.s + by) for line in self.gives_way),
            turns=tuple((begin + by, end + by, way) for begin, end, way in self.turns),
            holds=None if self.holds is None else (self.holds[0] + by, self.holds[1] + by),
            begins=self.begins + by,
        )


def routes(site: Site) -> list[Route]:
    """All lanes of a road or junction, one of ROUTES' kinds."""
    return list(ROUTES[type(site)](site))


def footways(site: Site) -> list[Path]:
    """The pavements of a road or junction, each one way; who walks there goes both."""
    return list(FOOTWAYS[type(site)](site))


def crosswalks(site: Site) -> list[Crosswalk]:
    """Zebras with signals."""
    if not isinstance(site, Crossing):
        return []
    main, side = crossing.MAIN_HALF, crossing.SIDE_HALF
    ends = [Crosswalk((-main, sign * ZEBRA_Y), (main, sign * ZEBRA_Y), MAIN) for sign in (-1, 1)]
    return ends + [Crosswalk((sign * ZEBRA_X, -side), (sign * ZEBRA_X, side), SIDE) for sign in (-1, 1)]


def rounded(points: Array, over_m: float = ROUNDED_M) -> Array:
    """(N, 2) points at even steps of STEP_M along a line [m], its corners rounded over a length."""
    length = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    keep = np.r_[True, np.diff(length) > 1e-9]
    even = np.linspace(0.0, length[-1], max(3, round(length[-1] / STEP_M) + 1))
    xy = np.stack([np.interp(even, length[keep], column[keep]) for column in points.T], axis=1)
    size = 2 * round(over_m / STEP_M / 2) + 1
    if over_m <= 0.0 or len(xy) <= size:
        return xy
    ends = [2 * xy[0] - xy[size:0:-1], xy, 2 * xy[-1] - xy[-2 : -size - 2 : -1]]  # straight on, so that ends stay
    return np.asarray(ndimage.uniform_filter1d(np.concatenate(ends), size, axis=0)[size:-size])


# -- a road


def _of_road(road: Road) -> Iterator[Route]:
    line = road.reference_line
    s = np.linspace(0.0, line.length, round(line.length / STEP_M) + 1)
    lanes = list(road.lane_section.of("lane", "bus", "cycle"))
    for lane in lanes:
        way = lane.way or (1 if lane.middle > 0 else -1)
        path = Path(np.stack(line.place(s, lane.middle), axis=1)[::way], lane.width)
        at = sorted(float(path.nearest(np.stack(line.place(zebra, lane.middle)))[0]) for zebra in road.zebras)
        low, high = (_beside(lanes, lane, edge) for edge in (lane.low, lane.high))
        low, high = (low, high) if way > 0 else (high, low)
        yield Route(path, zebras=tuple(at), left=low, right=high, kind=lane.kind)


def _beside(lanes: Sequence[Lane], lane: Lane, edge: float) -> int:
    """Number of the lane that meets another at an edge, for cars and the same way; -1 for none."""
    for number, candidate in enumerate(lanes):
        same = candidate is not lane and candidate.kind == lane.kind == "lane" and candidate.way == lane.way
        if same and min(abs(candidate.low - edge), abs(candidate.high - edge)) < EDGE_M:
            return number
    return -1


def _pavements(road: Road) -> Iterator[Path]:
    line = road.reference_line
    s = np.linspace(0.0, line.length, round(line.length / STEP_M) + 1)
    for lane in road.lane_section.of("pavement"):
        yield Path(np.stack(line.place(s, lane.middle), axis=1), lane.width)


# -- the crossing


@dataclass(frozen=True)
class _Lane:
    """A lane over the crossing, along which one goes straight on.

    Attributes:
        begin, end: x, y [m].
        line: from the middle of the crossing to its line before the signal, and to the middle of its zebra [m].
        zebra: the same for the zebra behind the crossing.
        width: [m].
        street: MAIN or SIDE.
    """

    begin: tuple[float, float]
    end: tuple[float, float]
    line: float
    zebra: float
    width: float
    street: int

    @property
    def ahead(self) -> Array:
        """(2,) where it goes."""
        way = np.subtract(self.end, self.begin)
        return np.asarray(way / np.hypot(*way))

    @property
    def middle(self) -> Array:
        """(2,) its point nearest to the middle of the crossing [m]."""
        return np.asarray(self.begin - self.ahead * (self.ahead @ self.begin))

    def place(self, along: float) -> tuple[float, float]:
        """x, y [m] at a distance behind the middle of the crossing."""
        x, y = self.middle + along * self.ahead
        return float(x), float(y)

    def pose(self, along: float) -> tuple[float, float, float]:
        """The same, and the heading from +X [rad]."""
        return *self.place(along), math.atan2(self.ahead[1], self.ahead[0])


def _of_crossing(site: Crossing) -> Iterator[Route]:
    """Straight on, then to the right and to the left of each lane."""
    lanes = [
        _Lane((1.76, -crossing.SOUTH), (1.76, crossing.NORTH), STOP, ZEBRA_Y, crossing.LANE_M, MAIN),
        _Lane((-1.8, crossing.NORTH), (-1.8, -crossing.SOUTH), STOP, ZEBRA_Y, crossing.LANE_M, MAIN),
        _Lane((-crossing.SIDE, -2.08), (crossing.SIDE, -2.08), STOP_SIDE, ZEBRA_X, crossing.SIDE_HALF, SIDE),
        _Lane((crossing.SIDE, 2.12), (-crossing.SIDE, 2.12), STOP_SIDE, ZEBRA_X, crossing.SIDE_HALF, SIDE),
    ]
    straight = [
        Route(
            Path(rounded(np.array([lane.begin, lane.end]), 0.0), lane.width),
            signals=(
                StopLine(float(np.hypot(*np.subtract(lane.place(-lane.line), lane.begin))) + AT_LINE_M, lane.street),
            ),
            share=1.0 - 2.0 * TURN,
        )
        for lane in lanes
    ]
    yield from straight
    for lane, on in zip(lanes, straight, strict=True):
        oncoming = next(route for goal, route in zip(lanes, straight, strict=True) if goal.ahead @ lane.ahead < -0.5)
        for goal in lanes:
            if goal.street != lane.street:
                yield _turning(lane, goal, on, oncoming)


def _turning(lane: _Lane, goal: _Lane, on: Route, oncoming: Route) -> Route:
    """From one lane of the crossing into another; to the left one gives way to those who come towards it."""
    pieces = bend(lane.pose(-lane.line), goal.pose(goal.line))
    through = [[replace(piece, length=s).after()[:2] for s in np.arange(0.0, piece.length, STEP_M)] for piece in pieces]
    corners = [lane.begin, *itertools.chain.from_iterable(through), goal.place(goal.line), goal.end]
    path = Path(rounded(np.array(corners)), lane.width)
    side = 1 if lane.ahead[0] * goal.ahead[1] - lane.ahead[1] * goal.ahead[0] > 0.0 else -1
    arc = next(piece for piece in pieces if piece.begin)
    begins, leaves, zebra = (
        float(path.nearest(np.array(place))[0]) for place in ((arc.x, arc.y), arc.after()[:2], goal.place(goal.zebra))
    )
    route = Route(
        path, on.signals, (zebra,), turns=((on.signals[0].s - INDICATES_M, leaves, side),), share=TURN
    )  # fmt: skip
    if side < 0:
        return route
    line = begins + HOLDS_M
    aside = np.where(path.s > line, np.abs(oncoming.path.nearest(path.points)[1]), np.inf)
    meets = path.points[int(np.argmin(aside))], np.array(goal.place(goal.zebra - 4.0))
    gates = tuple(GiveWay(line, (float(x), float(y)), TURN_S) for x, y in meets)
    return replace(route, gives_way=gates, holds=(line, zebra + ZEBRA_LINE_M))


def _of_crossing_pavements(site: Crossing) -> Iterator[Path]:
    """Along the main street they go over the zebras of the side street."""
    for x in (-FOOTWAY_X, FOOTWAY_X):
        zebra = math.copysign(ZEBRA_X, x)
        corners = [(x, -FOOTWAY_Y), (zebra, -FOOTWAY_Y), (zebra, FOOTWAY_Y), (x, FOOTWAY_Y)]
        yield Path(rounded(np.array([(x, -crossing.SOUTH), *corners, (x, crossing.NORTH)]), 3.0), 3.0)
        for y in (-FOOTWAY_Y, FOOTWAY_Y):
            yield Path(rounded(np.array([(x, y), (math.copysign(crossing.SIDE, x), y)]), 0.0), 2.0)


# -- a roundabout


def _of_roundabout(site: Roundabout) -> Iterator[Route]:
    """From every arm to every other one."""
    n = len(site.arms)
    for i in range(n):
        entry, merge = _arm(site, i, -1)
        for j in ((i + k) % n for k in range(1, n)):
            leaving, part = _arm(site, j, 1)
            leaving = leaving[::-1]
            turn = (part - merge + math.pi / 2) % (2 * math.pi) - math.pi / 2
            arc = merge + np.linspace(0.0, max(turn, 0.0), max(2, round(max(turn, 0.0) * _middle(site) / STEP_M)))
            ring = _middle(site) * np.stack([np.cos(arc), np.sin(arc)], axis=1)
            path = Path(rounded(np.concatenate([entry, ring, leaving])), min(site.lane_width, site.radius - site.inner))
            r = np.hypot(*path.points.T)
            enters = float(path.s[np.argmax(r < site.radius + AT_LINE_M / 2)])
            leaves = float(path.s[len(r) - 1 - np.argmax(r[::-1] < site.radius)])
            zebras = [
                float(path.s[np.argmin(np.where(half, np.abs(r - site.arms[arm].zebras[0]), np.inf))])
                for arm, half in ((i, path.s < enters), (j, path.s > leaves))
            ]
            meet = _middle(site) * math.cos(merge), _middle(site) * math.sin(merge)
            blinks = (leaves - _middle(site) * 2 * math.pi / n * 0.8, leaves + ZEBRA_HALF_M, -1)
            yield Route(path, zebras=tuple(zebras), gives_way=(GiveWay(enters, meet),), turns=(blinks,))


def _middle(site: Roundabout) -> float:
    """Radius of the middle of the lane that goes round [m]."""
    return (site.radius + site.inner) / 2


def _arm(site: Roundabout, arm: int, way: int) -> tuple[Array, float]:
    """(N, 2) points of an arm's lane from its end to the circle [m], inwards (-1) or outwards (1), and where it meets
    the ring.

    That is an angle of the middle of the lane that goes round [rad, counter-clockwise from +X].
    """
    road, r = site.arms[arm], site.corners[arm if way < 0 else arm - 1] + site.lane_width / 2
    line, e = road.reference_line, site.half_island + site.lane_width / 2
    foot = math.sqrt((_middle(site) + r) ** 2 - (e + r) ** 2)
    s = np.arange(line.length, foot, -STEP_M)
    lane = np.stack(line.place(s, way * (site.spread(s) + site.lane_width / 2)), axis=1)
    turn = np.linspace(0.0, math.atan2(foot, e + r), 30)  # round the arc's centre, from the lane to the circle
    t, along = way * (e + r - r * np.cos(turn)), foot - r * np.sin(turn)
    arc = np.stack(line.place(along, t), axis=1)
    return np.concatenate([lane, arc]), math.atan2(arc[-1, 1], arc[-1, 0])


def _of_roundabout_pavements(site: Roundabout) -> Iterator[Path]:
    outline = site.outline
    for corner in range(len(site.arms)):
        span = outline.span(corner)
        middle = outline.points[span] + site.pavement / 2 * outline.normals[span]
        yield Path(rounded(middle, 1.0), site.pavement)


ROUTES: Mapping[type, Callable[..., Iterator[Route]]] = {
    Road: _of_road,
    Crossing: _of_crossing,
    Roundabout: _of_roundabout,
}
FOOTWAYS: Mapping[type, Callable[..., Iterator[Path]]] = {
    Road: _pavements,
    Crossing: _of_crossing_pavements,
    Roundabout: _of_roundabout_pavements,
}

"""A roundabout as one record: arms, ring, splitter islands, kerbs, and the ground's height at any place.

The circle's middle is the origin and z = 0.  Traffic keeps to the right and goes
round counter-clockwise.  Each arm is a `Road` whose stations begin at the middle,
the ring a `Road` whose line is the inner edge of the lane that goes round.  Near the
circle an arm's lanes stand apart for its splitter island.  Arm edges meet the circle
in arcs, so that every kerb between two arms is one smooth line.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import spatial

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import RecipeError
from synfog_usd.world.roads.lane_section import KERB_M, LaneSection
from synfog_usd.world.roads.network import BLEND_M, Land, Road
from synfog_usd.world.roads.reference_line import ReferenceLine

HOLD_M = 16.0
"""Beyond the circle, within which an arm keeps its full width; every entry arc of up to RADIUS_M ends before it."""
TAPER_M = 22.0
RADIUS_M = (7.0, 25.0)
"""Entry and exit arcs: the least that a lorry can follow with its neighbour arm beside it, and the greatest that still
slows cars.
"""
STRAIGHT_M = 62.0
NEAR_M = 48.0
FINE_M, COARSE_M = 0.5, 2.0
APRON_LIP_M, APRON_TOP_M = 0.03, 0.06
BEHIND_KERB_M = 0.152
RAMP_M = 1.2
DROPPED_M = 0.025
ISLAND_EDGE_M = 0.3
"""Between a splitter island and the lanes."""
NOSE_M = 1.1
"""Between the circle and the islands' noses."""
TIP_M = 0.5
"""Half the width of an island where it ends, the corners' rounding apart."""
ZEBRA_HALF_M = 1.6
LAND_M = KERB_M - 0.02
"""Height of the grass behind the pavements."""


@dataclass(frozen=True)
class Outline:
    """The kerb lines between neighbouring arms, one after the other, sampled.

    Attributes:
        points, normals: (N, 2) [m] and unit vectors towards the raised side.
        ends: first sample of each line, and N.
        arm: (N,) arm beside which the sample lies, -1 at the circle; station: along that arm [m], nan there.
        kerb: (N,) height of the kerb [m], low where people cross.
    """

    points: Array
    normals: Array
    ends: tuple[int, ...]
    arm: npt.NDArray[np.int64]
    station: Array
    kerb: Array

    def span(self, corner: int) -> slice:
        """Samples of one line."""
        return slice(self.ends[corner], self.ends[corner + 1])


@dataclass(frozen=True)
class Pieces:
    """The straight pieces of all kerb lines, (M,) each; piece i begins at sample i.

    Attributes:
        around: (2, N) pieces before and after each of N samples.
        x, y, dx, dy: where they begin, and from there to their ends [m].
        square: of their lengths [m2].
        kerb, rise: height of the kerb where they begin, and what it gains to their ends [m].
        first, last: whether a kerb line begins with it, or ends.
    """

    around: npt.NDArray[np.int64]
    x: Array
    y: Array
    dx: Array
    dy: Array
    square: Array
    kerb: Array
    rise: Array
    first: npt.NDArray[np.bool_]
    last: npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Roundabout(Road):
    """A roundabout; as a `Road` it is the arm that the camera is on.

    Attributes:
        arms: counter-clockwise; the first is the camera's.  Straight for STRAIGHT_M from the middle.
        ring: closed, its offsets from 0 to its one lane's width.
        radius: of the inscribed circle [m].
        apron: width of the truck apron, 0 for none.
        mound: height of the middle island's grass over its kerb [m].
        half_island: by which the inner edge of a lane stands off the arm's line [m].
        corners: radius of the entry and exit arcs between arm i and i + 1 [m].
    """

    arms: tuple[Road, ...]
    ring: Road
    radius: float
    apron: float
    mound: float
    half_island: float
    corners: tuple[float, ...]

    # -- across an arm

    @property
    def lane_width(self) -> float:
        """Width of an arm's lane [m]."""
        return self.driving_lanes[0].width

    @property
    def pavement(self) -> float:
        """Width of the pavements [m]."""
        return self.lane_section.high - self.lane_width

    @property
    def inner(self) -> float:
        """Radius of the inner edge of the lane that goes round [m]."""
        return self.radius - self.ring.driving_lanes[0].width

    @property
    def island(self) -> float:
        """Radius of the middle island [m]."""
        return self.inner - self.apron

    def spread(self, s: npt.ArrayLike) -> Array:
        """By how much the lanes stand off the arm's line [m] at stations."""
        u = np.clip((self.radius + HOLD_M + TAPER_M - np.asarray(s, dtype=np.float64)) / TAPER_M, 0.0, 1.0)
        return self.half_island * u * u * (3 - 2 * u)

    def lane_pose(self, arm: int, s: float, way: int, aside: float = 0.0) -> tuple[float, float, float, float]:
        """x, y, z [m] and heading [degrees] of what drives in an arm's lane, outwards (1) or inwards (-1), `aside` [m]
        to the right of its middle.
        """
        road = self.arms[arm]
        e = 0.05
        a, b = (way * (self.spread(s + d) + self.lane_width / 2 + aside) for d in (-e, e))
        t = way * (float(self.spread(s)) + self.lane_width / 2 + aside)
        x, y, z = self.stand(*road.reference_line.place(s, t))
        turned = (
            math.degrees(float(road.reference_line.heading(s)))
            - math.degrees(math.atan2(float(b - a), 2 * e))
            + (180.0 if way < 0 else 0.0)
        )
        return x, y, z, round((turned + 180.0) % 360.0 - 180.0, 3)

    def lane_edges(self, arm: int, way: int) -> tuple[Array, Array]:
        """Left and right edge [m], (N, 3) each, of an arm's lane as it is driven; `way` is 1 outwards, else -1.

        On the circle the right one begins where the arc of the kerb does.
        """
        road, r = self.arms[arm], self.corners[arm if way < 0 else arm - 1]
        e, foot = self.half_island + self.lane_width, self.tangent(r)
        begins = math.sqrt(self.radius**2 - self.half_island**2), foot - r * math.sin(math.atan2(foot, e + r))
        near, length = self.radius + HOLD_M + TAPER_M, road.reference_line.length
        offsets: tuple[Callable[[Array], Array], ...] = (self.spread, functools.partial(self.edge, arm, way))
        edges = []
        for begin, offset in zip(begins, offsets, strict=True):
            s = np.r_[np.arange(begin, near, COARSE_M / 2), np.arange(near, length, COARSE_M), length]
            x, y = road.reference_line.place(s, way * offset(s))
            edges.append(np.c_[x, y, np.zeros(len(s))][::way])
        return edges[0], edges[1]

    def ring_edges(self) -> tuple[Array, Array]:
        """(N, 3) left and right edge [m] of the lane that goes round; the last point is the first."""
        turn = np.linspace(0.0, 2.0 * math.pi, max(24, int(2.0 * math.pi * self.radius / COARSE_M)) + 1)
        unit = np.c_[np.cos(turn), np.sin(turn), np.zeros(len(turn))]
        return self.inner * unit, self.radius * unit

    def ring_pose(self, s: float, t: float) -> tuple[float, float, float, float]:
        """x, y, z [m] and heading [degrees] of what goes round, at a station and offset of the ring."""
        x, y = self.ring.reference_line.place(s % self.ring.reference_line.length, t)
        heading = math.degrees(float(self.ring.reference_line.heading(s % self.ring.reference_line.length)))
        return *self.stand(x, y), round((heading + 180.0) % 360.0 - 180.0, 3)

    def stand(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[float, float, float]:
        """A place with the ground's height there, rounded as stages have it."""
        x, y = round(float(np.asarray(x)), 3) + 0.0, round(float(np.asarray(y)), 3) + 0.0  # no -0.0
        return x, y, round(float(self.height(x, y)), 4)

    def edge(self, arm: int, side: int, s: npt.ArrayLike) -> Array:
        """Distance of the kerb from an arm's line [m] at stations, right (1) or left (-1) of it; it widens in the
        arcs.
        """
        s = np.asarray(s, dtype=np.float64)
        r = self.corners[arm if side < 0 else arm - 1]
        over = np.clip(self.tangent(r) - s, 0.0, r)
        return self.spread(s) + self.lane_width + r - np.sqrt(r * r - over * over)

    def tangent(self, r: float) -> float:
        """Station at which an arc of radius r leaves an arm's edge [m]."""
        e = self.half_island + self.lane_width
        return math.sqrt((self.radius + r) ** 2 - (e + r) ** 2)

    def islands(self, arm: int) -> tuple[tuple[float, float], ...]:
        """Stations (from, to) of an arm's splitter island, cut where the zebra passes through."""
        s = np.arange(self.radius + HOLD_M, self.radius + HOLD_M + TAPER_M, 0.05)
        tip = float(s[np.searchsorted(-(self.spread(s) - ISLAND_EDGE_M), -TIP_M)])
        low, zebra = self.radius + NOSE_M, self.arms[arm].zebras[0]
        return (low, zebra - ZEBRA_HALF_M - 0.1), (zebra + ZEBRA_HALF_M + 0.1, tip)

    # -- kerbs

    @cached_property
    def outline(self) -> Outline:
        """Every kerb line: in along an arm, round the circle, out along the next."""
        points, arms, stations, ends = [], [], [], [0]
        n = len(self.arms)
        for i in range(n):
            j = (i + 1) % n
            p, arm, station = self._corner(i, j)
            points.append(p)
            arms.append(arm)
            stations.append(station)
            ends.append(ends[-1] + len(p))
        normals = []
        for p in points:
            d = np.gradient(p, np.r_[0.0, np.cumsum(np.hypot(*np.diff(p, axis=0).T))], axis=0)
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            normals.append(np.c_[d[:, 1], -d[:, 0]])
        arm, station = np.concatenate(arms), np.concatenate(stations)
        zebra = np.array([road.zebras[0] for road in self.arms])[arm]
        away = np.where(np.isnan(station), np.inf, np.abs(station - zebra))
        kerb = DROPPED_M + (KERB_M - DROPPED_M) * np.clip(away - ZEBRA_HALF_M - 0.1, 0.0, 1.0)
        return Outline(np.concatenate(points), np.concatenate(normals), tuple(ends), arm, station, kerb)

    def _corner(self, i: int, j: int) -> tuple[Array, npt.NDArray[np.int64], Array]:
        r, a, b = self.corners[i], self.arms[i], self.arms[j]
        foot, e = self.tangent(r), self.half_island + self.lane_width

        def along(road: Road, side: int) -> tuple[Array, Array]:
            """From the arc outwards."""
            near = np.linspace(foot, self.radius + NEAR_M, int((self.radius + NEAR_M - foot) / FINE_M) + 1)
            far = np.linspace(
                near[-1],
                road.reference_line.length,
                max(2, int((road.reference_line.length - near[-1]) / COARSE_M)) + 1,
            )
            s = np.r_[near, far[1:]]
            return np.stack(road.reference_line.place(s, side * (self.spread(s) + self.lane_width)), axis=1), s

        angle = math.atan2(foot, e + r)
        turn = np.linspace(0.0, angle, max(4, int(angle * r / FINE_M)) + 1)
        t, s = -(e + r) + r * np.cos(turn), foot - r * np.sin(turn)
        into, out = (
            np.stack(a.reference_line.place(s, t), axis=1),
            np.stack(b.reference_line.place(s, -t), axis=1)[::-1],
        )
        begin, end = math.atan2(into[-1, 1], into[-1, 0]), math.atan2(out[0, 1], out[0, 0])
        end = begin + (end - begin) % (2 * math.pi)
        arc = np.linspace(begin, end, max(2, int(self.radius * (end - begin) / FINE_M)) + 1)
        circle = self.radius * np.c_[np.cos(arc), np.sin(arc)]
        (pa, sa), (pb, sb) = along(a, -1), along(b, 1)
        pieces = [
            (pa[:0:-1], i, sa[:0:-1]),
            (into, i, s),
            (circle[1:-1], -1, None),
            (out, j, s[::-1]),
            (pb[1:], j, sb[1:]),
        ]
        points = np.concatenate([p for p, _, _ in pieces])
        arm = np.concatenate([np.full(len(p), k) for p, k, _ in pieces])
        station = np.concatenate([np.full(len(p), np.nan) if at is None else at for p, _, at in pieces])
        return points, arm, station

    @cached_property
    def _tree(self) -> spatial.cKDTree:
        return spatial.cKDTree(self.outline.points)

    @cached_property
    def _pieces(self) -> Pieces:
        line = self.outline
        number = np.arange(len(line.points))
        first, last = np.isin(number, line.ends[:-1]), np.isin(number + 1, line.ends[1:])
        d = np.diff(line.points, axis=0)
        around = np.stack([np.where(first, number, number - 1), np.where(last, number - 1, number)])
        (x, y), (dx, dy) = line.points[:-1].T, d.T
        square, rise = (d * d).sum(axis=-1), np.diff(line.kerb)
        around = np.clip(around, 0, len(d) - 1)
        return Pieces(around, x, y, dx, dy, square, line.kerb[:-1], rise, first[:-1], last[1:])

    @cached_property
    def _islands(self) -> tuple[tuple[tuple[float, float], ...], ...]:
        return tuple(self.islands(arm) for arm in range(len(self.arms)))

    def across(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Array, Array]:
        """Where places lie to the kerbs.

        Args:
            x, y: [m], equal shapes.

        Returns:
            Distance to the nearest kerb line [m], below 0 on the carriageway, and the height of the kerb there.  Beyond
            the arms' ends the distance is to the end, with the pavement's width added: land.
        """
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        of = self._pieces
        a = of.around[:, self._tree.query(np.stack([x, y], axis=-1))[1]]  # before and after the nearest sample
        px, py, dx, dy = of.x[a], of.y[a], of.dx[a], of.dy[a]
        free = ((x - px) * dx + (y - py) * dy) / of.square[a]
        share = np.minimum(np.maximum(free, 0.0), 1.0)
        ax, ay = x - px - share * dx, y - py - share * dy
        distance = np.hypot(ax, ay)
        signed = np.where(dy * ax - dx * ay >= 0, distance, -distance)
        heights = of.kerb[a] + share * of.rise[a]
        ends = ((free < -1e-9) & of.first[a]) | ((free > 1 + 1e-9) & of.last[a])
        after = distance[1] < distance[0] - 1e-9
        best, kerb, over = (np.where(after, two[1], two[0]) for two in (signed, heights, ends))
        return np.where(over, np.abs(best) + self.pavement + 0.01, best), kerb

    # -- ground

    def height(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Height of the ground [m] at places: carriageway, apron, islands, pavements and land."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        u, kerb = self.across(x, y)
        r = np.hypot(x, y)
        raised = kerb + (KERB_M - kerb) * np.clip((u - BEHIND_KERB_M) / RAMP_M, 0.0, 1.0)
        result = np.where(u > 0.0, raised, 0.0)
        if (beyond := u > self.pavement).any():
            result = np.where(beyond, self.open_land(x, y, u), result)
        if (inside := r < self.inner).any():
            result = np.where(inside, self.middle(r), result)
        near = (r > self.radius) & (r < self.radius + NEAR_M) & (u < 0.0)
        if near.any():
            for arm in range(len(self.arms)):
                result = np.where(near & self.on_island(arm, x, y), KERB_M, result)
        return result

    def ground(self, s: npt.ArrayLike, t: npt.ArrayLike) -> Array:
        """Height of the ground [m] at stations and offsets of the camera's arm."""
        return self.height(*self.reference_line.place(s, t))

    def middle(self, r: npt.ArrayLike) -> Array:
        """Height of apron and middle island [m] at distances from the middle."""
        r = np.asarray(r, dtype=np.float64)
        apron = APRON_LIP_M + (APRON_TOP_M - APRON_LIP_M) * np.clip((self.inner - r) / max(self.apron, 1e-9), 0.0, 1.0)
        u = np.clip((self.island - 1.0 - r) / (0.8 * self.island), 0.0, 1.0)
        return np.where(
            r < self.island, self.island_base + KERB_M + self.mound * u * u * (3 - 2 * u), apron if self.apron else 0.0
        )

    @property
    def island_base(self) -> float:
        """Height [m] on which the kerb of the middle island stands."""
        return APRON_TOP_M if self.apron else 0.0

    def half_width(self, low: float, high: float, s: npt.ArrayLike) -> Array:
        """Half the width of a splitter island [m] from station `low` to `high`: rounded at its ends, -1 beyond them."""
        s = np.asarray(s, dtype=np.float64)
        broad = self.spread(s) - ISLAND_EDGE_M
        inside = (s >= low - 1e-9) & (s <= high + 1e-9)
        end = np.minimum(s - low, high - s)
        corner = 0.6 * (self.spread(np.where(s - low < high - s, low, high)) - ISLAND_EDGE_M)
        cut = corner - np.sqrt(np.maximum(corner**2 - np.maximum(corner - end, 0.0) ** 2, 0.0))
        return np.where(inside, np.maximum(broad - cut, 0.02), -1.0)

    def on_island(self, arm: int, x: npt.ArrayLike, y: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Whether places are on an arm's splitter island."""
        h = math.radians(self.arms[arm].reference_line.origin[2])
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        s, t = -x * math.sin(h) + y * math.cos(h), x * math.cos(h) + y * math.sin(h)
        return np.logical_or.reduce([np.abs(t) <= self.half_width(low, high, s) for low, high in self._islands[arm]])

    def open_land(self, x: Array, y: Array, u: Array) -> Array:
        """Height of the land [m] at places `u` [m] from the kerb: level behind the pavement, hills far away."""
        share = np.clip((u - self.pavement) / BLEND_M, 0.0, 1.0)
        share = share * share * (3 - 2 * share)
        if not np.any(share):
            return np.full(np.shape(share), LAND_M)
        return LAND_M + share * (self.hills(x, y) - LAND_M)


@dataclass(frozen=True, kw_only=True)
class Circle:
    """Sizes of a circle [m].

    Attributes:
        radius: of the inscribed circle.
        ring, apron: widths of the lane that goes round, and of the truck apron.
        mound: height of the middle island's grass.
        corner: wished radius of entry and exit arcs.
    """

    radius: float
    ring: float
    apron: float
    mound: float
    corner: float


@dataclass(frozen=True, kw_only=True)
class Arm:
    """Sizes of an arm [m]: a lane's width, half a splitter island's, a pavement's, and from the circle to the middle of
    the zebra.
    """

    lane: float
    half_island: float
    pavement: float
    zebra: float


def roundabout(lines: Sequence[ReferenceLine], circle: Circle, arm: Arm, land: Land) -> Roundabout:
    """A roundabout from its sizes.

    Args:
        lines: of the arms, from the origin, counter-clockwise by the heading of their beginning.
        circle: whose arcs become smaller where two arms stand close.
        arm: the same for all.
        land: around it.

    Raises:
        RecipeError: islands or arcs find no room; says what would help.
    """
    inner = circle.radius - circle.ring
    if inner - circle.apron < 3.0:
        raise RecipeError(
            f"circle.diameter_m {2 * circle.radius:.3g} leaves no middle island of 3 m radius inside a ring of "
            f"{circle.ring:.3g} m and an apron of {circle.apron:.3g} m; "
            "draw a larger circle.diameter_m, or a narrower circle.ring_m or circle.apron_m"
        )
    following = [*lines[1:], lines[0]]
    sectors = [(after.origin[2] - line.origin[2]) % 360.0 for line, after in zip(lines, following, strict=True)]
    pavement = ("pavement", arm.pavement, 0)
    across = LaneSection.from_widths([pavement, ("lane", arm.lane, -1), ("lane", arm.lane, 1), pavement])
    arms = tuple(Road(line, across, land, (round(circle.radius + arm.zebra, 3),)) for line in lines)
    ring = Road(
        ReferenceLine(round(2 * math.pi * inner, 6), ((0.0, 1.0 / inner),), origin=(inner, 0.0, 0.0)),
        LaneSection.from_widths([("lane", circle.ring, 1)]),
    )
    return Roundabout(
        arms[0].reference_line,
        across,
        land,
        arms[0].zebras,
        arms=arms,
        ring=ring,
        radius=circle.radius,
        apron=circle.apron,
        mound=circle.mound,
        half_island=arm.half_island,
        corners=tuple(_arc(sector, circle, arm) for sector in sectors),
    )


def _arc(sector_deg: float, circle: Circle, arm: Arm) -> float:
    """Radius [m] of the arc between two arms so far apart.

    Raises:
        RecipeError: it would be too small to follow.
    """
    sector = math.radians(sector_deg)
    sine = math.sin(min(sector / 2 - 0.02, math.pi / 2))
    # the largest arc touches circle and edge within its half of the sector
    edge = arm.half_island + arm.lane
    most = math.inf if sine > 1 - 1e-9 else (circle.radius * sine - edge) / (1 - sine)
    least = max(RADIUS_M[0], arm.pavement + 1.0)
    if most < least:
        raise RecipeError(
            f"arms.apart_deg: two arms {math.degrees(sector):.3g} degrees apart leave no arc of {least:.3g} m between "
            "them; draw a larger circle.diameter_m, fewer arms.count or a larger arms.apart_deg"
        )
    return round(min(circle.corner, most), 3)

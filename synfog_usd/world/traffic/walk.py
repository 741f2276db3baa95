"""People on foot: along the pavement, or over the zebra and on along the pavement behind it.

Everyone's way is planned after those of who is before them, and anew where it was stuck.  It passes what stands and
who walks: somewhat to the side, or slower, or not at all.  Takes who walks and the pavements; gives places at even
steps of time.  Knows nothing of models or stages.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import shapely

from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import stream
from synfog_usd.world.traffic.paths import Path, rounded

SPEED_M_S = {
    "man_walking": 1.4, "woman_walking": 1.35, "student": 1.45, "child": 1.2, "schoolgirl": 1.25, "old_man": 0.9,
    "jogger": 2.7, "woman_pram": 1.2, "wheelchair_user": 1.0,
}  # fmt: skip
"""Who walks by themselves, on level ground: 1.4 m/s is the mean of adults (Bohannon 1997), less for children and the
old.
"""
SPREAD = 0.08
"""Share by which speeds differ."""
TOGETHER_M, TOGETHER = 1.4, 0.35
"""Who are so near each other and look the same way to so much [rad] go at one speed."""
SIDES_M = (0.0, 0.25, -0.25, 0.5, -0.5, 0.8, -0.8, 1.1, -1.1)
SLOWER = (1.0, 0.8, 0.55)
ASIDE_OVER_M = 2.0
ROOM_M = 0.06
"""Kept free around everyone who walks."""
EDGE_M = 0.35
"""Kept from the edges of a pavement."""
CROSSES_M = 16.0
"""Longest way over a road that is looked for."""
BEYOND_M = 25.0
CROSSING_M, CORNER_M = 0.85, 2.5
"""By which people go aside on their way over a road, and over which they turn into the pavement behind it."""
KERB_M = 0.35
"""Between who waits and the kerb."""
PAUSES_S = (2.0, 4.0, 8.0, np.inf)
"""How long somebody stands still who can go no other way."""
NEAR_M = 4.0
"""Between middles of those whose outlines may meet."""
AGAIN, FAR = 2, 0.6
"""Rounds in which those look for a way anew, once all others have one, who came less far than this share of theirs."""
EVERY = 2
"""Room is asked for at each step with a number divisible by it."""


@dataclass(frozen=True)
class Walker:
    """One who walks.

    Attributes:
        name: of a stream of numbers.
        x, y: [m]; heading: [rad].
        box: low x, low y, high x, high y of what it takes up, in its own axes [m].
        speed: [m/s].
    """

    name: str
    x: float
    y: float
    heading: float
    box: tuple[float, float, float, float]
    speed: float


@dataclass(frozen=True)
class Opening:
    """A way over a road, and when it is open.

    Attributes:
        begin, end: x, y at its two kerbs [m].
        times: from when to when people may set out [s], in their order.
    """

    begin: tuple[float, float]
    end: tuple[float, float]
    times: Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Way:
    """A walker's path, and where on it they are at first.

    Attributes:
        path: as it is walked.
        s, aside: of the walker [m]; turn: heading beyond the path's [rad].
        least, most: offsets between which it may be walked [m].
        kerbs: stations [m] with the times at which one may go on from there [s], in their order.
    """

    path: Path
    s: float
    aside: float
    turn: float
    least: float
    most: float
    kerbs: Sequence[tuple[float, Sequence[tuple[float, float]]]] = ()

    def walked(self, shift: float) -> Array:
        """(N,) way [m] from the walker to the path's points, gone over to a side by `shift` [m]: round the outside of a
        bend it is longer.
        """
        factor = np.maximum(1.0 + (self.aside + shift) * self.path.curvature, 0.2)
        way = np.r_[0.0, np.cumsum(np.diff(self.path.s) * (factor[1:] + factor[:-1]) / 2.0)]
        return np.asarray(way - np.interp(self.s, self.path.s, way))

    def travel(self, speed: float, times: Array, shift: float = 0.0) -> Array:
        """(K,) how far one is at times [s] at a speed [m/s] who waits at kerbs until the way is open."""
        t, gone, walked = [0.0], [0.0], self.walked(shift)
        for kerb, opens in self.kerbs:
            way = float(np.interp(kerb, self.path.s, walked))
            arrives = t[-1] + (way - gone[-1]) / speed
            t.append(arrives)
            gone.append(way)
            begins = next((begin for begin, end in opens if arrives < end), math.inf)
            if begins > arrives:
                t.append(min(begins, float(times[-1]) + arrives + 1.0))
                gone.append(gone[-1])
            if begins == math.inf:
                break
        else:
            t.append(t[-1] + float(times[-1]) + 1.0)
            gone.append(gone[-1] + speed * (t[-1] - t[-2]))
        limit = max(float(walked[-1]) - 0.5, 0.0)
        return np.minimum(np.interp(times, t, gone), limit)

    def position(self, travel: Array, shift: float) -> Array:
        """(K, 3) x, y [m] and heading [rad] after so much of the way [m], gone over to a side by `shift` [m]."""
        u = np.clip(travel / ASIDE_OVER_M, 0.0, 1.0)
        offset = self.aside + shift * u * u * (3.0 - 2.0 * u)
        x, y, h = self.path.at(np.interp(travel, self.walked(shift), self.path.s), offset)
        lean = np.arctan2(shift * 6.0 * u * (1.0 - u) / ASIDE_OVER_M, 1.0)
        return np.stack([x, y, h - lean + self.turn * np.exp(-travel / 1.5)], axis=-1)


@dataclass(frozen=True)
class Crowd:
    """Everyone else near somebody: (M, K, 2) middles [m] and (M, K) outlines at every step that is looked at."""

    middles: Array
    outlines: npt.NDArray[np.object_]


def plan(
    walkers: Sequence[Walker],
    ways: Sequence[Path],
    fixed: Sequence[Array],
    times: Array,
    seed: int,
    openings: Sequence[Opening] = (),
) -> Array:
    """Where everyone is at even steps of time.

    Args:
        walkers: at the beginning.
        ways: pavements; openings: where they lead over roads with signals.
        fixed: (4, 2) outlines of what stands [m].
        times: (K,) [s], from 0.
        seed: of speeds and turns.

    Returns:
        (K, M, 4) x, y [m], heading [rad] and the way that was walked [m].
    """
    walkers = _paced(walkers, seed)
    routes = [
        _stopped(_way(walker, ways, stream(seed, "traffic", "walker", walker.name)), walker, openings)
        for walker in walkers
    ]
    result = np.zeros((len(times), len(walkers), 4))
    for number, walker in enumerate(walkers):
        result[:, number, :3] = walker.x, walker.y, walker.heading
    stands = shapely.STRtree([shapely.Polygon(corners) for corners in fixed])
    order = sorted(range(len(walkers)), key=lambda k: -routes[k].s)
    for number in itertools.chain(order, *[order] * AGAIN):
        walker, way = walkers[number], routes[number]
        if result[-1, number, 3] >= FAR * way.travel(walker.speed, times)[-1] > 0.0:
            continue  # has come far enough in the round before
        away = np.hypot(*(result[..., :2] - (walker.x, walker.y)).T).min(axis=1)
        near = [k for k in np.flatnonzero(away < walker.speed * times[-1] + 3.0) if k != number]
        boxes = np.zeros((len(near), len(result[::EVERY]), 4, 2))
        for row, k in enumerate(near):
            boxes[row] = outlines(result[::EVERY, k, :3], walkers[k].box)
        result[:, number] = _chosen(walker, way, times, stands, Crowd(boxes.mean(axis=2), shapely.polygons(boxes)))
    return result


def outlines(places: Array, box: tuple[float, float, float, float], room: float = 0.0) -> Array:
    """(K, 4, 2) corners [m] of what somebody takes up at (K, 3) places."""
    low_x, low_y, high_x, high_y = box[0] - room, box[1] - room, box[2] + room, box[3] + room
    corners = np.array([(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)])
    c, s = np.cos(places[:, 2])[:, None], np.sin(places[:, 2])[:, None]
    x, y = corners[None, :, 0], corners[None, :, 1]
    return np.stack([places[:, :1] + x * c - y * s, places[:, 1:2] + x * s + y * c], axis=-1)


def _chosen(walker: Walker, way: Way, times: Array, stands: shapely.STRtree, crowd: Crowd) -> Array:
    """(K, 4) the first of the ways to go that is free all the time; else as far as the straight one is."""
    farthest = 0
    for slower in SLOWER:
        for shift in SIDES_M:
            if shift and not way.least <= way.aside + shift <= way.most:
                continue
            travel = way.travel(walker.speed * slower, times, shift)
            free = _free_until(way.position(travel, shift), walker, stands, crowd)
            if free == len(times):
                return np.c_[way.position(travel, shift), travel]
            farthest = max(farthest, free)
    usual = way.travel(walker.speed, times)
    for stop in range(farthest - EVERY, 0, -EVERY):  # stand still before what is in the way, and go on if it is gone
        for pause in PAUSES_S:
            travel = np.where(times < times[stop], usual, np.interp(times - pause, times, usual, usual[0]))
            travel = np.maximum.accumulate(
                np.where(times < times[stop] + pause, np.minimum(travel, usual[stop]), travel)
            )
            if _free_until(way.position(travel, 0.0), walker, stands, crowd) == len(times):
                return np.c_[way.position(travel, 0.0), travel]
    travel = np.zeros(len(times))
    return np.c_[np.tile((walker.x, walker.y, walker.heading), (len(times), 1)), travel]


def _free_until(places: Array, walker: Walker, stands: shapely.STRtree, crowd: Crowd) -> int:
    """Number of the step at which somebody runs into something; the number of steps where nobody does."""
    looked = places[::EVERY]
    mine = shapely.polygons(outlines(looked, walker.box, ROOM_M))
    who, at = np.nonzero(((crowd.middles - looked[:, :2]) ** 2).sum(axis=-1) < NEAR_M**2)
    meets = shapely.intersects(mine[at], crowd.outlines[who, at])
    every = np.concatenate([stands.query(mine, predicate="intersects")[0], at[meets]])
    every = every[every > 0]  # as they were drawn they stand
    return int(every.min()) * EVERY if len(every) else len(places)


def _paced(walkers: Sequence[Walker], seed: int) -> list[Walker]:
    """With a speed for everyone, the same for those who go together."""
    paced = [
        replace(
            walker, speed=walker.speed * stream(seed, "traffic", "pace", walker.name).uniform(1 - SPREAD, 1 + SPREAD)
        )
        for walker in walkers
    ]
    for _ in range(3):
        for i, walker in enumerate(paced):
            together = [
                friend.speed for friend in paced
                if math.hypot(friend.x - walker.x, friend.y - walker.y) < TOGETHER_M
                and abs(math.remainder(friend.heading - walker.heading, 2 * math.pi)) < TOGETHER
            ]  # fmt: skip
            paced[i] = replace(walker, speed=min(together))
    return paced


def _way(walker: Walker, ways: Sequence[Path], rng: np.random.Generator) -> Way:
    """Along the pavement that somebody is on, or over the road to the next and along it."""
    position = np.array([walker.x, walker.y])
    for path in ways:
        s, aside = path.nearest(position)
        half = path.width / 2
        if abs(float(aside)) < half:
            back = math.cos(float(path.at(s)[2]) - walker.heading) < 0.0
            if abs(math.sin(float(path.at(s)[2]) - walker.heading)) < 0.8:
                return _along(_turned(path, back), walker, half - EDGE_M)
    ahead = position + np.arange(0.0, CROSSES_M, 0.1)[:, None] * (-math.sin(walker.heading), math.cos(walker.heading))
    for k in range(5, len(ahead)):
        for path in ways:
            s, aside = path.nearest(ahead[k])
            if abs(float(aside)) < 0.1 + 0.2 * rng.random():
                path = _turned(path, rng.random() < 0.5)
                at = float(path.nearest(ahead[k])[0])
                behind = path.points[(path.s > at + 0.6) & (path.s < at + BEYOND_M)]
                start = position - 2.0 * (ahead[1] - ahead[0]) / 0.1
                return _along(
                    Path(rounded(np.r_[start[None], ahead[k : k + 1], behind], CORNER_M), path.width),
                    walker,
                    CROSSING_M,
                )
    straight = np.stack([ahead[0] - 2.0 * (ahead[1] - ahead[0]) / 0.1, ahead[20]])
    return _along(Path(rounded(straight, 0.0), 2.0), walker, 0.0)


def _stopped(way: Way, walker: Walker, openings: Sequence[Opening]) -> Way:
    """A way with the kerbs that it leaves ahead of who walks it."""
    kerbs = []
    for opening in openings:
        s, aside = way.path.nearest(np.array([opening.begin, opening.end]))
        station = float(s.min()) - KERB_M - walker.box[3]
        if (np.abs(aside) < way.path.width / 2).all() and station >= way.s:
            kerbs.append((station, opening.times))
    return replace(way, kerbs=sorted(kerbs, key=lambda kerb: kerb[0]))


def _turned(path: Path, back: bool) -> Path:
    return Path(path.points[::-1], path.width) if back else path


def _along(path: Path, walker: Walker, most: float) -> Way:
    s, aside = (float(v) for v in path.nearest(np.array([walker.x, walker.y])))
    turn = math.remainder(walker.heading - float(path.at(s)[2]), 2 * math.pi)
    return Way(path, s, aside, turn, min(-most, aside), max(most, aside))

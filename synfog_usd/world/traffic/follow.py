"""Vehicles that follow their routes: who is ahead of whom, what gives way, and how fast each goes.

Takes routes, who drives on them and where people walk; gives stations, speeds and accelerations at even steps of
time.  Knows nothing of models or stages.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from synfog_usd.base.arrays import Array, Flags, Indices
from synfog_usd.world.traffic.changing import INDICATES_S, SLOWEST, Neighbours, gain, over
from synfog_usd.world.traffic.idm import Driver, acceleration, safe_speed
from synfog_usd.world.traffic.paths import AT_LINE_M, ZEBRA_LINE_M, GiveWay, Path, Route

STEP_S = 0.1
LOOK_S = 6.0
"""How far ahead drivers foresee where people walk."""
BESIDE_M, PERSON_M = 0.2, 0.7
"""Free width beside a vehicle on each side, and beside the middle of a person."""
BEFORE_PERSON_M = 1.0
ZEBRA_HALF_M = 3.0
"""People so near the middle of a zebra are on it, along the road."""
FREE_M = 9.0
"""Whoever gives way waits for others who are so near."""
SLOW = 2.0
"""Who goes slower may be about to stand [m/s]."""
LATEST = 3.0
"""Who would have to brake harder than this [m/s2] for a line goes on over it."""
OVER_LINE_M = 1.2
"""So far over a line one still waits."""
MEETS_M = 2.0
"""Routes whose middles are so near each other meet."""
EASES_OVER_M = 12.0
"""Along which a vehicle goes from its offset in the lane to another."""
MOVES_UP_M = 1.0
"""More gap than at rest, at which one who stands in a queue starts."""
INITIAL_ROUNDS = 40
CLOSER = 1.7
"""At the beginning nobody is nearer to another than the gap wished for at that speed over this."""
POINTS = 9
"""Of a vehicle, by which others see it."""
CONSIDERS, SETTLES_S, CLEAR_M = 5, 2.0, 120.0
"""Every so many steps somebody thinks of another lane, so long after the last change at the earliest, and goes there if
nothing stands on it so far ahead.
"""


@dataclass(frozen=True)
class Vehicle:
    """One who drives, at the beginning.

    Attributes:
        route: number of its route.
        s: station of its origin [m]; aside: of its origin from the route's middle, positive to the right [m].
        turn: its heading beyond the route's [rad].
        ahead, behind, width: from its origin to its bumpers, and across [m].
        v: speed [m/s]; v0: that it wishes for [m/s].
        until: offset that it drifts to [m].
        takes: how long it goes over to another lane [s].
    """

    route: int
    s: float
    aside: float
    turn: float
    ahead: float
    behind: float
    width: float
    v: float
    v0: float
    until: float = 0.0
    takes: float = 4.0


@dataclass(frozen=True)
class State:
    """How everybody drives at a step: (N,) each.

    Attributes:
        route: numbers of routes; s: stations on them [m]; v: speeds [m/s].
        jump: offset from the new lane at which the last change of lane began [m]; clock: since then [s].
    """

    route: Indices
    s: Array
    v: Array
    jump: Array
    clock: Array


@dataclass(frozen=True)
class Places:
    """Where everybody is: (N,) each.

    Attributes:
        x, y: [m]; heading: [rad].
        side: offset from the middle of the route [m]; goal: the same when a change of lane is over.
    """

    x: Array
    y: Array
    heading: Array
    side: Array
    goal: Array


@dataclass(frozen=True)
class Run:
    """How a street went: states by steps of STEP_S, and (K, N) accelerations over the step that begins then [m/s2]."""

    states: Sequence[State]
    a: Array

    @property
    def s(self) -> Array:
        """(K, N) stations [m]."""
        return np.stack([state.s for state in self.states])

    @property
    def v(self) -> Array:
        """(K, N) speeds [m/s]."""
        return np.stack([state.v for state in self.states])


@dataclass(frozen=True)
class Trip:
    """How one vehicle goes: (F,) by frames.

    Attributes:
        x, y: [m]; heading: [rad]; v: speed [m/s]; a: acceleration [m/s2].
        bend: of its path [1/m], positive to the left.
        blinks: 1 while the left indicator is on, -1 the right one, 0 neither.
        inside: whether all of it is on the drawn road.
    """

    x: Array
    y: Array
    heading: Array
    v: Array
    a: Array
    bend: Array
    blinks: Indices
    inside: Flags


@dataclass(frozen=True)
class Street:
    """What vehicles drive in.

    Attributes:
        routes: of the road or junction.
        vehicles: who drives.
        people: (K, M, 2) where people are [m] at each step, longer than the run by LOOK_S.
        still: for each route that may be driven, stations and offsets of what stands near it [m].
        driver: how all of them drive.
        stops: (K, streets) whether signals say so at each step.
    """

    routes: Sequence[Route]
    vehicles: Sequence[Vehicle]
    people: Array
    still: Mapping[int, tuple[Array, Array]]
    driver: Driver
    stops: Flags

    @cached_property
    def nose(self) -> Array:
        """(N,) from origins to front bumpers [m]."""
        return np.array([vehicle.ahead for vehicle in self.vehicles])

    @cached_property
    def half(self) -> Array:
        """(N,) half the widths [m]."""
        return np.array([vehicle.width / 2 for vehicle in self.vehicles])

    @cached_property
    def wishes(self) -> Array:
        """(N,) speeds that drivers wish for [m/s]."""
        return np.array([vehicle.v0 for vehicle in self.vehicles])

    @cached_property
    def around(self) -> Array:
        """(N, POINTS, 2) outline of each vehicle in its own axes, right and ahead [m]."""
        ends = np.array([(-car.behind, (car.ahead - car.behind) / 2, car.ahead) for car in self.vehicles])
        across = self.half[:, None, None] * np.array([-1.0, 0.0, 1.0])
        return np.stack(np.broadcast_arrays(across, ends[:, :, None]), axis=-1).reshape(-1, POINTS, 2)

    @cached_property
    def _first(self) -> Array:
        """(4, N) stations, offsets, offsets that are drifted to [m] and turns [rad] at the beginning."""
        return np.array([(car.s, car.aside, car.until, car.turn) for car in self.vehicles]).T

    @cached_property
    def _takes(self) -> Array:
        return np.array([vehicle.takes for vehicle in self.vehicles])

    @cached_property
    def meets(self) -> dict[tuple[float, float], list[tuple[int, float]]]:
        """For the place at which a line before a junction lets in: routes, and where each comes by [m]."""
        result: dict[tuple[float, float], list[tuple[int, float]]] = {}
        numbers = dict.fromkeys(vehicle.route for vehicle in self.vehicles)
        for line in (line for number in numbers for line in self.routes[number].gives_way):
            places = [(number, *self.routes[number].path.nearest(np.array(line.meet))) for number in numbers]
            result[line.meet] = [(number, float(at)) for number, at, aside in places if abs(float(aside)) < MEETS_M]
        return result

    def begin(self) -> State:
        """Everybody at the beginning."""
        route = np.array([vehicle.route for vehicle in self.vehicles])
        none = np.zeros(len(route))
        v = np.array([vehicle.v for vehicle in self.vehicles])
        return State(route, self._first[0].copy(), v, none, np.full(len(route), np.inf))

    def limits(self, state: State, times: float = 1.0) -> Array:
        """(N,) speeds [m/s] that the bends allow, at `times` the usual."""
        result = np.full(len(state.s), np.inf)
        for number, who in _by_route(state.route):
            path = self.routes[number].path
            result[who] = times * np.interp(state.s[who], path.s, path.limit)
        return result

    def places(self, state: State, who: Indices | None = None) -> Places:
        """Where everybody is; with `who`, each row of the state is of the vehicle with that number."""
        who = np.arange(len(state.s)) if who is None else who
        s0, aside, until, turn = self._first[:, who]
        undone, rate = over(state.clock, self._takes[who])
        ahead = [np.clip((state.s + d - s0) / EASES_OVER_M, 0.0, 1.0) for d in (0.0, -0.25, 0.25)]
        goal, before, after = (aside + (until - aside) * u * u * (3.0 - 2.0 * u) for u in ahead)
        side = goal + state.jump * undone
        slope = (after - before) / 0.5 + state.jump * rate * np.minimum(state.v, SLOWEST) / SLOWEST / np.maximum(
            state.v, 1.0
        )
        x, y, h = np.zeros(len(side)), np.zeros(len(side)), np.zeros(len(side))
        for number, on in _by_route(state.route):
            x[on], y[on], h[on] = self.routes[number].path.at(state.s[on], side[on])
        h = h - np.arctan(slope) + turn * np.exp(-np.maximum(state.s - s0, 0.0) / 4.0)
        return Places(x, y, h, side, goal)

    def ahead(self, state: State, step: int) -> tuple[Array, Array]:
        """(N,) gaps [m] to what each has to brake for, and its speed [m/s]; inf for nothing."""
        now = self.places(state)
        c, n = np.cos(now.heading)[:, None], np.sin(now.heading)[:, None]
        across, along = self.around[..., 0], self.around[..., 1]
        where = np.stack([now.x, now.y], axis=-1)
        outlines = where[:, None] + np.stack([across * c - along * n, across * n + along * c], axis=-1)
        steps = np.clip(step + np.arange(0, round(LOOK_S / STEP_S) + 1, 5), 0, max(len(self.people) - 1, 0))
        people = self.people[steps].reshape(-1, 2)
        gap, speed = np.full(len(state.s), np.inf), np.zeros(len(state.s))
        points = np.concatenate([outlines.reshape(-1, 2), people])
        mine = np.arange(POINTS * len(state.s)) // POINTS
        for number, who in _by_route(state.route):
            route = self.routes[number]
            front = state.s[who] + self.nose[who]
            low, high = (
                limit(now.side[who], now.goal[who])[:, None] + sign * self.half[who][:, None]
                for limit, sign in ((np.minimum, -1.0), (np.maximum, 1.0))
            )
            every_at, every_aside = route.path.nearest(points)
            at, aside = every_at[: len(mine)], every_aside[: len(mine)]
            turned = now.heading - np.interp(at[::POINTS], route.path.s, route.path.heading)
            along_it = np.maximum(state.v * np.cos(turned), 0.0)
            free = at[None] - front[:, None]
            room = np.where(along_it > 0.0, BESIDE_M, 0.0)[mine]  # who comes towards one keeps to a lane of their own
            blocks = _between(aside, low, high, room) & (free > -0.3) & (mine[None] != who[:, None])
            free = np.where(along_it[mine] < SLOW, self._held(route, free, at, front, state.v[who]), free)
            _nearest(gap, speed, who, np.where(blocks, free, np.inf), along_it[mine])
            at, aside = every_at[len(mine) :], every_aside[len(mine) :]
            free = at[None] - front[:, None] - BEFORE_PERSON_M
            blocks = _between(aside, low, high, PERSON_M) & (free > -BEFORE_PERSON_M - 0.3)
            for zebra in route.zebras:
                line = zebra - ZEBRA_LINE_M - front[:, None] + self.driver.standstill_m - AT_LINE_M
                on = (np.abs(at[None] - zebra) < ZEBRA_HALF_M) & (line > 0.0)
                free = np.where(on, np.minimum(free, line), free)
            free = self._held(route, free, at, front, state.v[who])
            _nearest(gap, speed, who, np.where(blocks, free, np.inf), None)
            fixed, aside = self.still[number]
            blocks = _between(aside, low, high, 0.05) & (fixed[None] > front[:, None])
            _nearest(gap, speed, who, np.where(blocks, fixed[None] - front[:, None], np.inf), None)
            signals = (line.s for line in route.signals if self.stops[step, line.street])
            for stop in (*signals, *(gate.s for gate in route.gives_way if self._taken(gate, state, step))):
                _nearest(gap, speed, who, self._to_line(stop, front, state.v[who]), None)
        return np.maximum(gap, 0.05), speed

    def _to_line(self, line: float, front: Array, v: Array) -> Array:
        """(n, 1) gaps [m] of bumpers at stations to what lets them stop at a line; inf for who cannot any more."""
        to_line = (line - front)[:, None]
        stops = (to_line > -OVER_LINE_M) & (v[:, None] ** 2 < 2.0 * LATEST * np.maximum(to_line, AT_LINE_M))
        return np.where(stops, to_line + self.driver.standstill_m - AT_LINE_M, np.inf)

    def _held(self, route: Route, free: Array, at: Array, front: Array, v: Array) -> Array:
        """(n, P) gaps [m] to obstacles at stations; who would have to wait in a junction waits at its line instead."""
        if route.holds is None:
            return free
        line, leaves = route.holds
        return np.where((at > line) & (at < leaves), np.minimum(free, self._to_line(line, front, v)), free)

    def _taken(self, line: GiveWay, state: State, step: int) -> bool:
        """Whether somebody who is in the junction already is about to come where a route from a line meets theirs."""
        for number, meet in self.meets[line.meet]:
            who, route = np.flatnonzero(state.route == number), self.routes[number]
            to_meet = meet - state.s[who]
            lines = [gate.s + OVER_LINE_M for gate in route.gives_way]
            lines += [signal.s for signal in route.signals if self.stops[step, signal.street]]
            inside = state.s[who] + self.nose[who] > max(lines, default=-np.inf)
            if (
                inside & (to_meet > -self.nose[who]) & (to_meet < np.maximum(FREE_M, state.v[who] * line.free_s))
            ).any():
                return True
        return False

    def lane(self, number: int, state: State, now: Places) -> Neighbours:
        """Everybody as a lane has them."""
        path = self.routes[number].path
        s, aside = path.nearest(np.stack([now.x, now.y], axis=-1))
        on = np.isfinite(aside) & ((np.abs(aside) < path.width / 2) | (state.route == number))
        tail = np.array([vehicle.behind for vehicle in self.vehicles])
        return Neighbours(s, state.v, self.wishes, self.nose, tail, on)

    def changed(self, state: State, step: int) -> State:
        """With those in other lanes who begin to change to them now."""
        able = (state.v > SLOWEST) & (state.clock > self._takes + INDICATES_S + SETTLES_S)
        able &= state.s > self._first[0] + EASES_OVER_M
        for who in np.flatnonzero(able & ((np.arange(len(able)) + step) % CONSIDERS == 0)).tolist():
            route = self.routes[int(state.route[who])]
            choices = [(number, side) for number, side in ((route.left, True), (route.right, False)) if number >= 0]
            if not choices:
                continue
            now = self.places(state)
            here = self.lane(int(state.route[who]), state, now)
            lanes = [(self.lane(number, state, now), number, side) for number, side in choices]
            gains = [
                gain(self.driver, who, here, there, leftwards=side)
                if self._clear(number, there.s[who], who)
                else -np.inf
                for there, number, side in lanes
            ]
            best = int(np.argmax(gains))
            if gains[best] > 0.0:
                state = self._moved(state, now, who, lanes[best][1])
        return state

    def _clear(self, number: int, s: float, who: int) -> bool:
        """Whether nothing stands on a lane as far as one looks, and the lane does not end."""
        fixed, aside = self.still[number]
        path = self.routes[number].path
        near = (fixed > s - 10.0) & (fixed < s + CLEAR_M)
        return not (near & (np.abs(aside) < path.width / 2)).any() and s + CLEAR_M / 2 < path.length

    def _moved(self, state: State, now: Places, who: int, number: int) -> State:
        s, aside = (float(v) for v in self.routes[number].path.nearest(np.array([now.x[who], now.y[who]])))
        moved = replace(
            state, route=state.route.copy(), s=state.s.copy(), jump=state.jump.copy(), clock=state.clock.copy()
        )
        moved.route[who], moved.s[who], moved.jump[who], moved.clock[who] = number, s, aside - now.goal[who], 0.0
        return moved

    def trip(self, run: Run, number: int, t: Array) -> Trip:
        """How one vehicle goes at times [s]; before the beginning at the first speed."""
        k = np.clip(np.floor(t / STEP_S + 1e-9).astype(int), 0, len(run.states) - 1)
        rest = t - k * STEP_S
        rows = [run.states[step] for step in k]
        route, s, v, jump, clock = (
            np.array([getattr(row, name)[number] for row in rows]) for name in ("route", "s", "v", "jump", "clock")
        )
        a = np.where(t < 0.0, 0.0, run.a[k, number])
        state = State(
            route,
            s + v * rest + a * rest**2 / 2.0,
            np.maximum(v + a * rest, 0.0),
            jump,
            clock + rest * np.minimum(v, SLOWEST) / SLOWEST,
        )
        now = self.places(state, np.full(len(t), number))
        bend, blinks, inside = np.zeros(len(t)), np.zeros(len(t), dtype=np.int64), np.ones(len(t), dtype=bool)
        me = self.vehicles[number]
        for which, on in _by_route(route):
            path = self.routes[which].path
            bend[on] = np.interp(state.s[on], path.s, path.curvature)
            inside[on] = path.length - state.s[on] - me.ahead > 0.5
            if me.s < self.routes[which].begins:  # who was drawn there is there from the beginning
                inside[on] &= state.s[on] - me.behind > self.routes[which].begins
            for begin, end, way in self.routes[which].turns:
                blinks[on] = np.where((state.s[on] > begin) & (state.s[on] < end), way, blinks[on])
        changes = state.clock < self._takes[number] + INDICATES_S
        blinks = np.where(changes, np.sign(jump).astype(np.int64), blinks)
        return Trip(now.x, now.y, now.heading, state.v, a, bend, blinks, inside)


def near_routes(routes: Sequence[Route], used: Collection[int], fixed: Array) -> dict[int, tuple[Array, Array]]:
    """Stations and offsets [m] along routes of those of (P, 2) places on the drawn road that are near them."""
    result = {}
    for number in used:
        s, aside = routes[number].path.nearest(fixed.reshape(-1, 2))
        near = (np.abs(aside) < routes[number].path.width) & (s > routes[number].begins)
        result[number] = s[near], aside[near]
    return result


def drive(street: Street, seconds: float) -> Run:
    """Let all vehicles drive for a time [s]; they begin at speeds at which nobody brakes hard."""
    state = street.begin()
    state = replace(state, v=np.minimum(state.v, street.limits(state, np.sqrt(1.5))))
    for _ in range(INITIAL_ROUNDS):
        gap, ahead = street.ahead(state, 0)
        slower = np.minimum(state.v, safe_speed(gap - 0.5 * street.driver.standstill_m, ahead, street.driver.braking))
        room = (CLOSER * gap - street.driver.standstill_m) / street.driver.headway_s
        slower = np.minimum(slower, np.maximum(room, 0.0))
        if np.allclose(slower, state.v):
            break
        state = replace(state, v=slower)
    states, accelerations = [], []
    for step in range(round(np.ceil(seconds / STEP_S)) + 1):
        gap, ahead = street.ahead(state, step)
        s, v = state.s, state.v
        a = acceleration(street.driver, v, np.minimum(street.wishes, street.limits(state)), gap, ahead)
        a = np.where((v < 0.05) & (gap < street.driver.standstill_m + MOVES_UP_M), -v / STEP_S, a)
        a = np.maximum(a, -v / STEP_S)
        states.append(state)
        accelerations.append(a)
        clock = state.clock + STEP_S * np.minimum(v, SLOWEST) / SLOWEST
        s, v = s + v * STEP_S + a * STEP_S**2 / 2.0, np.maximum(v + a * STEP_S, 0.0)
        state = street.changed(replace(state, s=s, v=v, clock=clock), step)
    return Run(states, np.stack(accelerations))


def _by_route(route: Indices) -> Iterator[tuple[int, Indices]]:
    """Each route with somebody on it, and who."""
    for number in dict.fromkeys(route.tolist()):
        yield number, np.flatnonzero(route == number)


def _between(aside: Array, low: Array, high: Array, room: float | Array) -> Flags:
    """(n, P) which of (P,) offsets are within (n, 1) others, or `room` beside them [m]."""
    return np.asarray((aside[None] > low - room) & (aside[None] < high + room))


def _nearest(gap: Array, speed: Array, who: Indices, free: Array, velocity: Array | None) -> None:
    """Take the nearest of (n, P) obstacles for those who, where it is nearer than what is in `gap`."""
    if not free.size:
        return
    k = np.argmin(free, axis=1)
    least = free[np.arange(len(who)), k]
    nearer = least < gap[who]
    gap[who] = np.where(nearer, least, gap[who])
    speed[who] = np.where(nearer, 0.0 if velocity is None else velocity[k], speed[who])


def eased(path: Path, vehicle: Vehicle, still: tuple[Array, Array], reach_m: float) -> float:
    """Offset [m] to which a vehicle drifts so that it passes what stands beside its lane, as near as can be to its own.

    Args:
        path: of its route.
        vehicle: as it begins.
        still: stations and offsets of what stands near the route [m].
        reach_m: how far it may go.
    """
    most = max(0.0, path.width / 2 - vehicle.width / 2 - 0.1)
    usual = float(np.clip(vehicle.aside, -most, most))
    s, aside = still
    obstacles = aside[(s > vehicle.s - vehicle.behind) & (s < vehicle.s + reach_m)]
    if not len(obstacles):
        return usual
    tried = usual + np.array([0.0, *(sign * 0.05 * k for k in range(1, 13) for sign in (-1, 1))])
    clear = np.abs(obstacles[None] - tried[:, None]).min(axis=1) - vehicle.width / 2
    enough = np.flatnonzero(clear > 0.2)
    return float(tried[enough[0]] if len(enough) else tried[np.argmax(clear)])

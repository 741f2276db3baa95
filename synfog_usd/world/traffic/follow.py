"""Vehicles that follow their routes: who is ahead of whom, what gives way, and how fast each goes.

Takes routes, who drives on them and where people walk; gives stations, speeds and accelerations at even steps of
time.  Knows nothing of models or stages.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from synfog_usd.base.arrays import Array, Flags, Indices
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
FREE_S, FREE_M = 3.5, 9.0
"""Whoever gives way waits for others who are so near, by time or by length."""
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

    def offset(self, s: Array) -> Array:
        """Its offset from the route's middle [m] at stations."""
        u = np.clip((s - self.s) / EASES_OVER_M, 0.0, 1.0)
        return np.asarray(self.aside + (self.until - self.aside) * u * u * (3.0 - 2.0 * u))

    def pose(self, path: Path, s: Array) -> tuple[Array, Array, Array]:
        """x, y [m] and heading [rad] at stations."""
        offset = self.offset(s)
        x, y, h = path.at(s, offset)
        drift = np.arctan((self.offset(s + 0.25) - self.offset(s - 0.25)) / 0.5)
        return x, y, h - drift + self.turn * np.exp(-np.maximum(s - self.s, 0.0) / 4.0)


@dataclass(frozen=True)
class Run:
    """How a street went: (K, N) by steps of STEP_S and vehicles.

    Attributes:
        s: stations [m]; v: speeds [m/s]; a: accelerations over the step that begins here [m/s2].
    """

    s: Array
    v: Array
    a: Array

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Stations, speeds and accelerations (T, N) at times [s]; before the beginning at the first speed."""
        k = np.clip(np.floor(t / STEP_S + 1e-9).astype(int), 0, len(self.s) - 1)
        rest = (t - k * STEP_S)[:, None]
        a = np.where(t[:, None] < 0.0, 0.0, self.a[k])
        return self.s[k] + self.v[k] * rest + a * rest**2 / 2.0, np.maximum(self.v[k] + a * rest, 0.0), a


@dataclass(frozen=True)
class Street:
    """What vehicles drive in.

    Attributes:
        routes: of the road or junction.
        vehicles: who drives.
        people: (K, M, 2) where people are [m] at each step, longer than the run by LOOK_S.
        still: for each route with a vehicle, stations and offsets of what stands near it [m].
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
    def used(self) -> dict[int, Indices]:
        """Routes with somebody on them, each with who."""
        result = np.array([vehicle.route for vehicle in self.vehicles])
        return {number: np.flatnonzero(result == number) for number in dict.fromkeys(result.tolist())}

    @cached_property
    def nose(self) -> Array:
        """(N,) from origins to front bumpers [m]."""
        return np.array([vehicle.ahead for vehicle in self.vehicles])

    @cached_property
    def half(self) -> Array:
        """(N,) half the widths [m]."""
        return np.array([vehicle.width / 2 for vehicle in self.vehicles])

    @cached_property
    def around(self) -> Array:
        """(N, POINTS, 2) outline of each vehicle in its own axes, right and ahead [m]."""
        ends = np.array([(-car.behind, (car.ahead - car.behind) / 2, car.ahead) for car in self.vehicles])
        across = self.half[:, None, None] * np.array([-1.0, 0.0, 1.0])
        return np.stack(np.broadcast_arrays(across, ends[:, :, None]), axis=-1).reshape(-1, POINTS, 2)

    @cached_property
    def meets(self) -> dict[tuple[float, float], list[tuple[int, float]]]:
        """For the place at which a line before a junction lets in: used routes, and where each comes by [m]."""
        result: dict[tuple[float, float], list[tuple[int, float]]] = {}
        for line in (line for number in self.used for line in self.routes[number].gives_way):
            places = [(number, *self.routes[number].path.nearest(np.array(line.meet))) for number in self.used]
            result[line.meet] = [(number, float(at)) for number, at, aside in places if abs(float(aside)) < MEETS_M]
        return result

    def limits(self, s: Array, times: float = 1.0) -> Array:
        """(N,) speeds [m/s] that the bends allow, at `times` the usual."""
        result = np.full(len(s), np.inf)
        for number, who in self.used.items():
            path = self.routes[number].path
            result[who] = times * np.interp(s[who], path.s, path.limit)
        return result

    def ahead(self, s: Array, v: Array, step: int) -> tuple[Array, Array]:
        """(N,) gaps [m] to what each has to brake for, and its speed [m/s]; inf for nothing."""
        where = np.zeros((len(s), 2))
        heading = np.zeros(len(s))
        offset = np.zeros(len(s))
        for i, vehicle in enumerate(self.vehicles):
            x, y, h = vehicle.pose(self.routes[vehicle.route].path, s[i : i + 1])
            where[i], heading[i], offset[i] = (x[0], y[0]), h[0], vehicle.offset(s[i : i + 1])[0]
        c, n = np.cos(heading)[:, None], np.sin(heading)[:, None]
        across, along = self.around[..., 0], self.around[..., 1]
        outlines = where[:, None] + np.stack([across * c - along * n, across * n + along * c], axis=-1)
        steps = np.clip(step + np.arange(0, round(LOOK_S / STEP_S) + 1, 5), 0, max(len(self.people) - 1, 0))
        people = self.people[steps].reshape(-1, 2)
        gap, speed = np.full(len(s), np.inf), np.zeros(len(s))
        points = np.concatenate([outlines.reshape(-1, 2), people])
        mine = np.arange(POINTS * len(s)) // POINTS
        for number, who in self.used.items():
            route = self.routes[number]
            front = s[who] + self.nose[who]
            side, half = offset[who][:, None], self.half[who][:, None]
            every_at, every_aside = route.path.nearest(points)
            at, aside = every_at[: len(mine)], every_aside[: len(mine)]
            along = np.maximum(v * np.cos(heading - np.interp(at[::POINTS], route.path.s, route.path.heading)), 0.0)
            free = at[None] - front[:, None]
            room = np.where(along > 0.0, BESIDE_M, 0.0)[mine]  # who comes towards one keeps to a lane of their own
            blocks = (np.abs(aside[None] - side) < half + room) & (free > -0.3) & (mine[None] != who[:, None])
            _nearest(gap, speed, who, np.where(blocks, free, np.inf), along[mine])
            at, aside = every_at[len(mine) :], every_aside[len(mine) :]
            free = at[None] - front[:, None] - BEFORE_PERSON_M
            blocks = (np.abs(aside[None] - side) < half + PERSON_M) & (free > -BEFORE_PERSON_M - 0.3)
            for zebra in route.zebras:
                line = zebra - ZEBRA_LINE_M - front[:, None] + self.driver.standstill_m - AT_LINE_M
                on = (np.abs(at[None] - zebra) < ZEBRA_HALF_M) & (line > 0.0)
                free = np.where(on, np.minimum(free, line), free)
            _nearest(gap, speed, who, np.where(blocks, free, np.inf), None)
            fixed, aside = self.still[number]
            blocks = (np.abs(aside[None] - side) < half + 0.05) & (fixed[None] > front[:, None])
            _nearest(gap, speed, who, np.where(blocks, fixed[None] - front[:, None], np.inf), None)
            signals = (line.s for line in route.signals if self.stops[step, line.street])
            lines = [*signals, *(gate.s for gate in route.gives_way if self._taken(gate, s, v))]
            for line in lines:
                left = (line - front)[:, None]
                stops = (left > -OVER_LINE_M) & (v[who, None] ** 2 < 2.0 * LATEST * np.maximum(left, AT_LINE_M))
                _nearest(gap, speed, who, np.where(stops, left + self.driver.standstill_m - AT_LINE_M, np.inf), None)
        return np.maximum(gap, 0.05), speed

    def _taken(self, line: GiveWay, s: Array, v: Array) -> bool:
        """Whether somebody who is in the junction already is about to come where a route from a line meets theirs."""
        for number, meet in self.meets[line.meet]:
            who, route = self.used[number], self.routes[number]
            left = meet - s[who]
            inside = s[who] + self.nose[who] > max((gate.s for gate in route.gives_way), default=-np.inf)
            if (inside & (left > -self.nose[who]) & (left < np.maximum(FREE_M, v[who] * FREE_S))).any():
                return True
        return False


def beside(routes: Sequence[Route], used: Collection[int], fixed: Array) -> dict[int, tuple[Array, Array]]:
    """Stations and offsets [m] along routes of those of (P, 2) places that are near them."""
    result = {}
    for number in used:
        s, aside = routes[number].path.nearest(fixed.reshape(-1, 2))
        near = np.abs(aside) < routes[number].path.width
        result[number] = s[near], aside[near]
    return result


def drive(street: Street, seconds: float) -> Run:
    """Let all vehicles drive for a time [s]; they begin at speeds at which nobody brakes hard."""
    s, v, v0 = np.array([(vehicle.s, vehicle.v, vehicle.v0) for vehicle in street.vehicles]).T
    v = np.minimum(v, street.limits(s, np.sqrt(1.5)))
    for _ in range(INITIAL_ROUNDS):
        gap, ahead = street.ahead(s, v, 0)
        slower = np.minimum(v, safe_speed(gap - 0.5 * street.driver.standstill_m, ahead, street.driver.braking))
        room = (CLOSER * gap - street.driver.standstill_m) / street.driver.headway_s
        slower = np.minimum(slower, np.maximum(room, 0.0))
        if np.allclose(slower, v):
            break
        v = slower
    steps = round(np.ceil(seconds / STEP_S)) + 1
    rows = []
    for step in range(steps):
        gap, ahead = street.ahead(s, v, step)
        wish = np.minimum(v0, street.limits(s))
        a = acceleration(street.driver, v, wish, gap, ahead)
        a = np.where((v < 0.05) & (gap < street.driver.standstill_m + MOVES_UP_M), -v / STEP_S, a)
        a = np.maximum(a, -v / STEP_S)
        rows.append((s, v, a))
        s, v = s + v * STEP_S + a * STEP_S**2 / 2.0, np.maximum(v + a * STEP_S, 0.0)
    return Run(*(np.stack(column) for column in zip(*rows, strict=True)))


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
    wanted = float(np.clip(vehicle.aside, -most, most))
    s, aside = still
    beside = aside[(s > vehicle.s - vehicle.behind) & (s < vehicle.s + reach_m)]
    if not len(beside):
        return wanted
    tried = wanted + np.array([0.0, *(sign * 0.05 * k for k in range(1, 13) for sign in (-1, 1))])
    clear = np.abs(beside[None] - tried[:, None]).min(axis=1) - vehicle.width / 2
    enough = np.flatnonzero(clear > 0.2)
    return float(tried[enough[0]] if len(enough) else tried[np.argmax(clear)])

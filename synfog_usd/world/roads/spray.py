"""Spray behind wheels on a wet road: how much water the tyres throw up, and the clouds of it behind vehicles.

Takes speeds, a depth of water and placements; gives ellipsoids of drops.  Knows nothing of stages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.base.numbers import LEAST_MOR_M
from synfog_usd.fog import Fog
from synfog_usd.world.library import nominal
from synfog_usd.world.shapes import shift, turn
from synfog_usd.world.spec import Placement, View

MOST = 6
"""Clouds of a stage, those nearest to the camera: each makes a path through fog dearer."""
TYRES_M = {"bus": 0.56, "lorry": 0.56, "van": 0.22}
"""Width of a tyre, of twin ones together, by model; typical values."""
TYRE_M = 0.2
SIZES_M = {"bus": (2.55, 3.0), "lorry": (2.5, 3.0), "van": (2.0, 2.4)}
"""Width and height of the widest and highest vehicles."""
SIZE_M = 1.8, 1.5
LANDS, FILM_M, WATER_KG_M3 = 0.75, 1e-4, 997.0
"""Share of a tyre's width that is no groove; film that stays on it; density of water."""
DROP_M, DROP_AT_M_S = 8e-4, 6.0
"""Mean diameter of drops at a speed; it goes as one over the speed, which is the root of Weber's number."""
FALL_S, SHORTEST_M, LONGEST_M, ASIDE_M = 0.5, 2.0, 15.0, 0.7
"""Time for which drops stay up, how far behind a vehicle its cloud reaches, and to each side: estimates by eye."""
SLOWEST_M_S = 5.0
DENSEST = np.e / (1.0 - 1.0 / np.e)
"""Density at a cloud's lowest point over the mean from the ground to where it has fallen by e."""
ROOM_M = 2.5
"""Half side of the square about a camera that no cloud may reach: rays begin in one medium."""

PATH = "/World/Fog/Spray_{:02d}"

MPH = 0.44704


def water_kg_m3(speed_m_s: npt.ArrayLike, depth_m: float, tyre_m: float) -> Array:
    """Water in the air behind a tyre [kg/m3], shape of the speeds.

    A tyre takes along a film that sticks to it and what fills its grooves, and pushes the rest before it and to its
    sides; each becomes spray by a share that is linear in the speed.

    Args:
        speed_m_s: V [m/s]; the shares were fitted to 45 to 75 mph, and are 0 where they would be less.
        depth_m: of the water [m], over the bottom of the texture.
        tyre_m: width [m].

    Source: Flintsch et al., Splash and Spray Assessment Tool (FHWA, DTFH61-08-C-00030, 2014), after Weir et al. (1978).
    """
    speed = np.asarray(speed_m_s, dtype=np.float64)
    film, grooves = LANDS * min(FILM_M, depth_m), (1.0 - LANDS) * depth_m
    pushed = 0.5 * max(depth_m - film - grooves, 0.0)
    mph, total = speed / MPH, np.zeros_like(speed)
    for depth, slope, level in (
        (film, -2.69e-5, 2.43e-3),
        (grooves, 1.16e-5, -5.25e-5),
        (pushed, 2.67e-5, -4.71e-4),
        (pushed, 1.65e-5, -3.99e-4),
    ):
        total += np.maximum(slope * mph + level, 0.0) * speed * tyre_m * depth * WATER_KG_M3
    return total


def extinction(speed_m_s: npt.ArrayLike, depth_m: float, tyre_m: float) -> Array:
    """Extinction [1/m] of spray as a picture shows it, shape of the speeds: drops stop what meets them.  What they bend
    beside themselves stays within a pixel.

    Source of their size: Browand, Plocher and Radovich, at the University of Southern California (2010).
    """
    speed = np.asarray(speed_m_s, dtype=np.float64)
    drop_m = DROP_M * DROP_AT_M_S / np.maximum(speed, SLOWEST_M_S)
    moves = speed >= SLOWEST_M_S
    return np.where(moves, 1.5 * water_kg_m3(speed, depth_m, tyre_m) / (WATER_KG_M3 * drop_m), 0.0)


@dataclass(frozen=True)
class Cloud:
    """The spray of a vehicle: an ellipsoid about a place on the ground, and the density falls with height.

    Attributes:
        vehicle: number of its placement.
        behind_m: from the vehicle's origin to the middle.
        half_m: (3,) half axes across, along and up [m]; over the last of them density falls by e.
        tyre_m: width of its tyres [m].
    """

    vehicle: int
    behind_m: float
    half_m: tuple[float, float, float]
    tyre_m: float

    def to_world(self, x: float, y: float, z: float, heading: float, pitch: float) -> Array:
        """(4, 4) from the ball of radius 1, where its vehicle has a place [m] and angles [degrees]."""
        place = shift(x, y, z) @ turn(heading) @ turn(pitch, "x") @ shift(0.0, -self.behind_m, 0.0)
        return np.asarray(place @ np.diag([*self.half_m, 1.0]))

    def densest(self, speed_m_s: npt.ArrayLike, depth_m: float) -> Array:
        """Extinction [1/m] at its lowest point, below the ground; the mean over its height is that of the spray."""
        return DENSEST * extinction(speed_m_s, depth_m, self.tyre_m)


def also(fog: Fog) -> str:
    """What is in the air beside rain and snow, as it thins with spray's height to the same mean: a medium's `also`."""
    visible_m = {part: part.mor_m for part in (fog, *fog.also) if part.mor_m is not None}
    mean_kept = {part: max(round(m / DENSEST, 2), LEAST_MOR_M) for part, m in visible_m.items()}
    return "+".join(replace(part, mor_m=m, also=()).name for part, m in mean_kept.items())


def clouds(placed: Sequence[Placement], view: View, fog: Fog) -> list[Cloud]:
    """Of the vehicles that go in rain, those nearest before a camera first; none meets another or the camera."""
    result: list[Cloud] = []
    if "rain" not in fog.rates:
        return result
    areas = [around(np.array([view.x]), np.array([view.y]))]
    moving = [
        number
        for number, p in enumerate(placed)
        if p.group == "Vehicles" and p.asset in nominal() and (p.speed_m_s or 0.0) >= SLOWEST_M_S
    ]
    for number in sorted(moving, key=lambda number: _rank(placed[number], view)):
        p = placed[number]
        reach = float(np.clip(FALL_S * (p.speed_m_s or 0.0), SHORTEST_M, LONGEST_M))
        for cloud in (_behind(number, p, share * reach) for share in (1.0, 0.5)):
            here = corners(np.array([p.x]), np.array([p.y]), np.array([p.heading]), cloud.behind_m, cloud.half_m)
            if not any(meet(here, area).any() for area in areas):
                areas.append(here)
                result.append(cloud)
                break
        if len(result) == MOST:
            break
    return result


def _behind(number: int, p: Placement, reach_m: float) -> Cloud:
    """From the middle of a vehicle to so far behind it."""
    long, (wide, high) = nominal()[p.asset]["length_m"] * p.size, SIZES_M.get(p.asset, SIZE_M)
    half = (0.5 * wide + ASIDE_M, 0.5 * (0.5 * long + reach_m), high)
    return Cloud(number, 0.5 * reach_m + 0.25 * long, half, TYRES_M.get(p.asset, TYRE_M))


def _rank(p: Placement, view: View) -> float:
    """Distance from a camera [m]; what is behind it comes later, as if it were three times as far."""
    x, y, angle = p.x - view.x, p.y - view.y, np.radians(view.heading)
    return float(np.hypot(x, y) * (1.0 if y * np.cos(angle) > x * np.sin(angle) else 3.0))


def around(x: Array, y: Array) -> Array:
    """(F, 4, 2) corners of the square about a camera that is left free."""
    return corners(x, y, np.zeros_like(x), 0.0, (ROOM_M, ROOM_M))


def corners(x: Array, y: Array, heading: Array, behind_m: float, half_m: Sequence[float]) -> Array:
    """(F, 4, 2) corners of a rectangle about a place behind another, by frames."""
    angle = np.radians(heading)
    ahead, right = (
        np.stack([a, b], axis=-1) for a, b in ((-np.sin(angle), np.cos(angle)), (np.cos(angle), np.sin(angle)))
    )
    middle = np.stack([x, y], axis=-1) - behind_m * ahead
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return np.stack(
        [middle + across * half_m[0] * right + along * half_m[1] * ahead for across, along in signs], axis=1
    )


def meet(here: Array, area: Array) -> Flags:
    """(F,) whether two rectangles have a point in common, frame by frame: no side of either parts them."""
    apart = np.zeros(len(here), dtype=bool)
    for first, second in ((here, area), (area, here)):
        for side in (first[:, 1] - first[:, 0], first[:, 2] - first[:, 1]):
            a, b = (np.einsum("fij,fj->fi", shape, side) for shape in (first, second))
            apart |= (a.max(axis=1) < b.min(axis=1)) | (b.max(axis=1) < a.min(axis=1))
    return ~apart

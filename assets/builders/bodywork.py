"""The shape of a car's skin: a lower body with a shoulder, and a cabin that leans inward above it.

A body is a signed distance.  Its flanks follow the outline from above and a section
with sill, hollow door, sharp shoulder line and flared arches; side and cabin outlines
cut it off.  Lengths in metres; the front looks along +Y, the wheels stand on z = 0.
Sums, products and roots alone, which all processors round alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from assets.builders.solids import Field, filleted, outline_distance, soft_max, soft_min
from synfog_usd.world.shapes import Array

ARCH_GAP_M = 0.045
"""Between a tyre and its arch."""
SHOULDER_M = 0.085
"""Of the shoulder line, below the belt."""


@dataclass(frozen=True)
class Body:
    """Shape of a car.  Silhouettes are corners of outlines that are rounded later.

    Attributes:
        length, width, height: outer size without mirrors [m].
        side: (y, z) of the lower body; cabin: (y, z) of the cabin from the belt up.
        windows: convex (y, z) outlines of the side glass.
        screen: (y, z) foot and head of the windscreen, and of the rear window.
        axles: y of the rear and front axle; wheel: outer radius of the tyre.
        roof_half: half width of the roof; belt: height where the cabin begins [m].
        outer: half its width with mirrors, rear, front and height [m], to which the model is stretched at last: seeds
            place cars by them.
        pillar: how far ahead of the rear window's foot and head [m] its dark border goes round the corners, if it does.
        seams: (y, z0, z1) of the gaps between doors.
        spokes: number of spokes of the rims; plate: row of the picture of plates.
        tail: lowest and highest z of the tail lamps; tail_inner: their inner edge as a share of the half width.
        rear_plate_z: height of the plate at the back, by the tail lamps if left out.
        upright: a flat front and doors at the back; rails: on the roof; cladding: dark wheel arches.
        triangles: of the painted skin before anything is cut out of it.
        beam: name of its dipped beam in `lamps.LAMPS`.
    """

    name: str
    about: str
    length: float
    width: float
    height: float
    side: Sequence[tuple[float, float]]
    cabin: Sequence[tuple[float, float]]
    windows: Sequence[Sequence[tuple[float, float]]]
    screen: tuple[tuple[float, float], tuple[float, float]]
    rear: tuple[tuple[float, float], tuple[float, float]]
    axles: tuple[float, float]
    wheel: float
    roof_half: float
    belt: float
    outer: tuple[float, float, float, float]
    seams: Sequence[tuple[float, float, float]]
    lamps_z: float = 0.68
    tail: tuple[float, float] = (0.72, 0.95)
    spokes: int = 5
    plate: int = 0
    paints: Sequence[str] = field(default=("white", "silver", "grey", "black", "blue", "red", "green", "sand"))
    cladding: bool = False
    plan_corner: float = 0.5
    tail_inner: float = 0.72
    rear_plate_z: float | None = None
    pillar: tuple[float, float] | None = None
    upright: bool = False
    rails: bool = False
    triangles: int = 2500
    beam: str = "low_beam_led"


def car_field(body: Body) -> Field:
    """Signed distance [m] to the painted skin of a body, about 1 in slope, negative inside."""
    half, y0, y1 = body.width / 2, -body.length / 2, body.length / 2
    sill, belt, head = min(z for _, z in body.side), body.belt, body.height
    side = filleted(body.side, 0.16)
    cabin = filleted(body.cabin, 0.22)
    c = body.plan_corner
    right = [
        (half * 0.62, y0),
        (half * 0.86, y0 + 0.05),
        (half * 0.975, y0 + c * 0.8),
        (half, -0.25),
        (half, 0.45),
        (half * 0.97, y1 - c * 1.1),
        (half * 0.82, y1 - 0.16),
        (half * 0.50, y1 - 0.02),
        (0.12, y1 + 0.01),
    ]
    plan = filleted([*right, *((-x, y) for x, y in reversed(right))], 0.14)
    shoulder = belt - SHOULDER_M
    section = _curve(
        [
            (sill - 0.30, 0.240),
            (sill - 0.02, 0.085),
            (sill + 0.11, 0.022),
            (sill + 0.22, 0.014),
            (sill + 0.30, 0.036),
            (shoulder - 0.10, 0.010),
            (shoulder, 0.000),
            (shoulder + 0.035, 0.014),
            (belt, 0.052),
            (belt + 0.14, 0.170),
            (belt + 0.60, 0.70),
        ],
        0.022,
    )
    fall = max(shoulder - (body.lamps_z + 0.05), 0.0)  # of the shoulder line, from the doors to the headlamps
    wall = 0.955 if body.upright else 0.90
    lean = _curve(
        [
            (belt - 0.60, half * (wall + 0.02)),
            (belt, half * wall),
            (0.5 * (belt + head), 0.5 * half * wall + 0.5 * body.roof_half + 0.030),
            (head - 0.07, body.roof_half + 0.012),
            (head + 0.03, body.roof_half - 0.11),
            (head + 0.40, body.roof_half - 0.60),
        ],
        0.10,
    )
    above = [(half * 0.60, y0 + 0.02), (half * 0.93, y0 + 0.75), (half * 0.96, 0.1), (half * 0.78, y1 - 0.55)]
    cabin_plan = plan if body.upright else filleted([*above, *((-x, y) for x, y in reversed(above))], 0.30)
    arch = body.wheel + ARCH_GAP_M
    bumper = body.tail[0] - 0.05

    def signed(x: Array, y: Array, z: Array) -> Array:
        out = np.abs(x) / half
        forward = np.clip((y - 0.35) / (y1 - 0.35), 0, 1)
        tied = np.clip((z - sill - 0.30) / (shoulder - sill - 0.30), 0, 1)
        flank = outline_distance(plan, x, y) + section(z + fall * forward * forward * tied)
        for axle in body.axles:
            ring = np.sqrt((y - axle) ** 2 + (z - body.wheel) ** 2) - arch
            flank = flank - 0.016 * _bump(ring / 0.11) * _ramp((shoulder - z) / 0.10)
        ledge = 0.028 * _ramp((bumper - z) / 0.05) * _ramp((y0 + 0.55 - y) / 0.15) if not body.upright else 0.0
        crown = 0.030 * out * out
        dome = 0.010 * _ramp((0.66 - out) / 0.10) * _ramp((y - body.axles[1] + 0.55) / 0.4) * _ramp((z - 0.55) / 0.2)
        lower = soft_max(outline_distance(side, y, z) + crown - dome - ledge, flank - ledge, 0.055)
        bow = y + 0.11 * out * out * np.clip(y / 0.6, -0.7, 1)
        upper = soft_max(outline_distance(cabin, bow, z) + 0.6 * crown, 0.96 * (np.abs(x) - lean(z)), 0.055)
        upper = soft_max(upper, outline_distance(cabin_plan, x, y), 0.08)
        return soft_min(lower, upper, 0.03)

    return signed


def _curve(corners: Sequence[tuple[float, float]], setback: float):
    """A function of its first coordinate along straight lines with rounded corners."""
    at, value = filleted(corners, setback, closed=False).T
    return lambda q: np.interp(q, at, value)


def _ramp(t: Array) -> Array:
    """0 below 0, 1 above 1, smooth between."""
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _bump(t: Array) -> Array:
    """1 at 0, 0 beyond -1 and 1."""
    t = np.clip(1 - t * t, 0, 1)
    return t * t

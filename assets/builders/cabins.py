"""What one sees through the glass of a vehicle: lining, seats, dashboard, steering wheel and a driver.

Simple bodies that are told apart at some metres.  Lengths in metres; the front
looks along +Y, the driver sits on the left (-X), as where one drives on the right.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from assets.builders.coachwork import cut_out
from assets.builders.solids import Field, carve, prism, split, surface
from synfog_usd.world.components import Look
from synfog_usd.world.shapes import Array, Part, ball, box, join, quad, shift, soft_box, tube, turn

Point = tuple[float, float, float]
Outline = Sequence[tuple[float, float]]

LINING_M = 0.035
"""Between the skin and what lines it."""
WHEEL_AHEAD, WHEEL_ABOVE = 0.40, 0.26
"""Of the steering wheel's centre, from the hip of the driver [m]."""
DRIVER = ("driver_skin", "driver_hair", "driver_coat")

DRIVERS = {"none": Look(without=DRIVER), "on": Look()}
"""Variants of a vehicle that holds a `driver`."""


def lining(field: Field, low: Point, high: Point, *, step: float, triangles: int, roof_z: float) -> tuple[Part, Part]:
    """The inside of a body given by its distance, dark up to `roof_z` and light above; windows are cut out of both
    later.
    """
    whole = surface(
        lambda x, y, z: field(x, y, z) + LINING_M, low, high, step=step, triangles=triangles, material="cabin_dark"
    )
    walls, roof = split(whole, whole.points[:, 2] - roof_z)
    return walls, roof.painted("cabin_grey")


def lined(
    field: Field,
    low: Point,
    high: Point,
    *,
    roof_z: float,
    sides: Sequence[tuple[Outline, int]],
    front: Outline,
    back: Outline | None = None,
    axles: Sequence[float] = (),
    step: float = 0.09,
    triangles: int = 500,
) -> list[Part]:
    """A `lining` with openings: (y, z) outlines at a side (1 right, -1 left), (x, z) ones in front and behind, and
    where the wheels of `axles` are.
    """
    panels: list[Part] = []
    holes: list[Part] = []  # what is cut out is thrown away
    for panel in lining(field, low, high, step=step, triangles=triangles, roof_z=roof_z):
        for outline, sign in sides:
            panel = cut_out(panel, holes, "hole", (1, 2), outline, 0, sign, 0.4)
        for y in axles:
            house = prism([(y - 0.62, 0.0), (y + 0.62, 0.0), (y + 0.62, 1.14), (y - 0.62, 1.14)], (1, 2))
            panel = carve(panel, [*house, lambda q: 0.72 - np.abs(q[:, 0])])[1]
        panel = cut_out(panel, holes, "hole", (0, 2), front, 1, 1, 0.2)
        panels.append(panel if back is None else cut_out(panel, holes, "hole", (0, 2), back, 1, -1, 0.4))
    return panels


def rows(
    ys: Sequence[float] | Array, xs: Sequence[float], z: float, *, half: float = 0.44, tall: float = 0.78
) -> list[Part]:
    """Backs of double seats, as one sees them above a sill; they stand at `z`."""
    lean = turn(12, "x")
    return [
        box((-half, -0.05, 0.0), (half, 0.05, tall), "seat_cloth").moved(shift(x, y, z) @ lean) for y in ys for x in xs
    ]


def seat(
    x: float, y: float, z: float, *, half: float = 0.24, heads: Sequence[float] = (0.0,), tall: float = 0.60
) -> list[Part]:
    """A seat for somebody whose hip is at (x, y, z); `heads` are its headrests [m] from its middle."""
    lean = shift(x, y - 0.10, z - 0.06) @ turn(18, "x")
    parts = [
        soft_box((x - half, y - 0.12, z - 0.22), (x + half, y + 0.40, z - 0.06), "seat_cloth", radius=0.05, sides=2),
        soft_box((-half, -0.13, -0.08), (half, 0.0, tall), "seat_cloth", radius=0.05, sides=2).moved(lean),
    ]
    return parts + [
        soft_box(
            (h - 0.12, -0.115, tall + 0.03), (h + 0.12, -0.025, tall + 0.21), "seat_cloth", radius=0.04, sides=2
        ).moved(lean)
        for h in heads
    ]


def dashboard(half: float, y0: float, y1: float, z: float) -> Part:
    """A dashboard between two planes across the car, its top at `z`."""
    return soft_box((-half, y0, z - 0.30), (half, y1, z), "cabin_dark", radius=0.08, sides=2)


def steering_wheel(hip: Point, *, radius: float = 0.185, tilt_deg: float = 65.0) -> list[Part]:
    """Rim, spoke and column in front of the driver's hip; `tilt_deg` of its plane from level."""
    a = np.linspace(0, 2 * np.pi, 15)
    rim = tube(np.c_[radius * np.cos(a), radius * np.sin(a), 0 * a], 0.014, "black_plastic", sides=5, capped=False)
    spoke = box((-radius, -0.03, -0.02), (radius, 0.03, 0.0), "black_plastic")
    column = tube([(0, 0, -0.02), (0, 0, -0.28)], 0.035, "black_plastic", sides=6, capped=False)
    place = shift(hip[0], hip[1] + WHEEL_AHEAD, hip[2] + WHEEL_ABOVE) @ turn(tilt_deg, "x")
    return [p.moved(place) for p in (rim, spoke, column)]


def driver(hip: Point) -> list[Part]:
    """Somebody from the hip up, hands on the steering wheel of `steering_wheel`."""
    back = turn(16, "x")[:3, :3]

    def at(x: float, y: float, z: float) -> Array:
        return np.asarray(hip) + back @ np.array([x, y, z])

    trunk = tube(
        [at(0, 0.02, -0.02), at(0, 0.02, 0.18), at(0, 0, 0.38), at(0, 0, 0.50), at(0, 0.01, 0.56)],
        [0.14, 0.15, 0.16, 0.12, 0.06],
        "driver_coat",
        sides=10,
    )
    shoulders = tube(
        [at(-0.19, 0, 0.43), at(0, 0, 0.47), at(0.19, 0, 0.43)], [0.065, 0.085, 0.065], "driver_coat", sides=8
    )
    head = np.asarray(hip) + back @ np.array([0, 0.0, 0.56]) + [0, 0.035, 0.13]
    parts = [trunk, shoulders]
    skin = [
        tube([at(0, 0.01, 0.52), head - [0, 0.015, 0.03]], 0.055, "driver_skin", sides=8),
        ball(head, (0.076, 0.098, 0.118), "driver_skin", sides=10),
    ]
    skin.append(ball(head + [0, 0.10, -0.01], (0.013, 0.018, 0.024), "driver_skin", sides=6))
    for s in (-1, 1):
        hand = np.asarray(hip) + [s * 0.165, WHEEL_AHEAD - 0.03, WHEEL_ABOVE + 0.06]
        elbow = np.asarray(hip) + [s * 0.27, 0.10, 0.17]
        parts.append(
            tube([at(s * 0.19, 0, 0.43), elbow, hand - [0, 0.05, 0.01]], [0.062, 0.052, 0.036], "driver_coat", sides=7)
        )
        skin.append(ball(hand, (0.034, 0.05, 0.04), "driver_skin", sides=6))
    hair = ball(tuple(head + [0, -0.022, 0.036]), (0.083, 0.100, 0.103), "driver_hair", sides=10)
    return [join(parts), join(skin), hair]


def bulkhead(half: float, y: float, z0: float, z1: float) -> Part:
    """A wall across the vehicle."""
    return quad([(-half, y, z0), (half, y, z0), (half, y, z1), (-half, y, z1)], "cabin_grey")

"""Cars, a van, a bus and a lorry, with glass, lamps, wheels and number plates.

A body is the meeting of three silhouettes (side, plan, front) with rounded
edges, joined to a cabin made the same way; windows, seams and wheel arches are
cut out of its skin.  Lengths in metres; the front looks along +Y, the wheels
stand on z = 0.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from assets.builders.bodywork import ARCH_GAP_M, SHOULDER_M, Body, car_field
from assets.builders.cabins import DRIVERS, bulkhead, dashboard, driver, lined, lining, rows, seat, steering_wheel
from assets.builders.coachwork import HEADLIGHT_CD as HEADLIGHT_CD
from assets.builders.coachwork import HEADLIGHT_TINT as HEADLIGHT_TINT
from assets.builders.coachwork import (
    arches,
    bowl,
    convex,
    covered,
    cut_out,
    dusted,
    front_at,
    gap,
    grown,
    headlights,
    lamp_states,
    lens_disc,
    mirror,
    on_side,
    painted,
    picture,
    plate,
    rect,
    screen,
    seam_line,
    side_picture,
    top_at,
    wheels,
)
from assets.builders.faces import Lens, Opening, centre_lamp, front, lamp_units, lens_patch, opened, tail_lamps, wipers
from assets.builders.solids import Field, carve, outline_distance, prism, rounded, soft_max, surface
from synfog_usd.world.components import Component
from synfog_usd.world.lod import cleaned
from synfog_usd.world.shapes import (
    Array,
    Part,
    box,
    disc,
    quad,
    scale,
    shift,
    smooth_normals,
    soft_box,
    strip,
    tube,
    turn,
)

ARCH_WALL = 0.62
"""Where the inner walls of wheel arches stand, as part of half the width."""

HANDLE = ((-0.019, 0.002), (-0.016, 0.022), (0.010, 0.026), (0.018, 0.002))
"""Section of the handle of a boot or hatch: height and depth [m]."""
CARS = (
    Body(
        "hatchback",
        "A compact five-door hatchback, 4.05 m long.",
        4.05,
        1.76,
        1.47,
        side=[
            (-1.98, 0.20), (1.90, 0.18), (2.03, 0.30), (2.02, 0.56), (1.93, 0.73), (1.55, 0.87), (0.98, 0.965),
            (-1.2, 1.00), (-1.88, 1.00), (-2.0, 0.80), (-2.02, 0.40),
        ],
        cabin=[
            (1.22, 0.80), (0.98, 0.965), (0.28, 1.38), (-0.25, 1.475), (-1.05, 1.445), (-1.66, 1.35), (-1.93, 0.98),
            (-1.9, 0.75),
        ],
        windows=[
            [(0.02, 0.985), (0.74, 0.985), (0.30, 1.285), (0.10, 1.375), (0.02, 1.39)],
            [(-0.86, 1.01), (-0.06, 0.985), (-0.06, 1.39), (-0.80, 1.375)],
            [(-1.58, 1.07), (-0.93, 1.015), (-0.87, 1.365), (-1.38, 1.325)],
        ],
        screen=((1.02, 0.98), (0.30, 1.40)),
        rear=((-1.93, 1.03), (-1.66, 1.36)),
        axles=(-1.27, 1.25),
        wheel=0.315,
        roof_half=0.57,
        belt=0.95,
        outer=(0.99566, -1.99047, 2.00649, 1.4488),
        seams=[(0.80, 0.32, 0.97), (-0.02, 0.32, 0.98), (-0.90, 0.48, 1.0)],
        tail=(0.74, 1.06),
        plate=1,
        rear_plate_z=0.62,
        pillar=(0.16, 0.12),
    ),
    Body(
        "saloon",
        "A four-door saloon, 4.65 m long.",
        4.65,
        1.83,
        1.44,
        side=[
            (-2.28, 0.22), (2.18, 0.19), (2.32, 0.32), (2.31, 0.55), (2.20, 0.71), (1.75, 0.83), (1.05, 0.94),
            (-1.3, 1.00), (-2.10, 1.01), (-2.31, 0.96), (-2.33, 0.45),
        ],
        cabin=[
            (1.25, 0.78), (1.02, 0.94), (0.20, 1.36), (-0.35, 1.44), (-0.95, 1.405), (-1.72, 1.03), (-1.85, 0.9),
            (-1.6, 0.78),
        ],
        windows=[
            [(0.0, 0.97), (0.75, 0.97), (0.26, 1.255), (0.08, 1.335), (0.0, 1.35)],
            [(-0.88, 0.99), (-0.08, 0.97), (-0.08, 1.355), (-0.70, 1.345)],
            [(-1.34, 1.03), (-0.95, 1.00), (-0.78, 1.335), (-0.98, 1.27)],
        ],
        screen=((1.06, 0.96), (0.22, 1.37)),
        rear=((-1.70, 1.045), (-0.98, 1.40)),
        axles=(-1.38, 1.42),
        wheel=0.33,
        roof_half=0.58,
        belt=0.94,
        outer=(1.02633, -2.29485, 2.29886, 1.41585),
        seams=[(0.82, 0.34, 0.96), (-0.04, 0.34, 0.97), (-0.98, 0.50, 1.0)],
        lamps_z=0.66,
        tail=(0.76, 0.94),
        spokes=10,
        plate=2,
        tail_inner=0.58,
    ),
    Body(
        "estate",
        "A station wagon, 4.70 m long, with roof rails.",
        4.70,
        1.83,
        1.47,
        side=[
            (-2.30, 0.23), (2.20, 0.20), (2.34, 0.33), (2.33, 0.56), (2.22, 0.73), (1.78, 0.85), (1.10, 0.955),
            (-1.3, 1.00), (-2.2, 1.02), (-2.33, 0.85), (-2.35, 0.45),
        ],
        cabin=[
            (1.30, 0.80), (1.06, 0.955), (0.28, 1.37), (-0.30, 1.465), (-1.40, 1.445), (-2.02, 1.385), (-2.27, 1.0),
            (-2.2, 0.78),
        ],
        windows=[
            [(0.02, 0.985), (0.80, 0.985), (0.33, 1.275), (0.12, 1.365), (0.02, 1.38)],
            [(-0.88, 1.005), (-0.06, 0.985), (-0.06, 1.385), (-0.88, 1.385)],
            [(-1.99, 1.08), (-0.96, 1.01), (-0.96, 1.385), (-1.77, 1.35)],
        ],
        screen=((1.10, 0.975), (0.30, 1.385)),
        rear=((-2.25, 1.05), (-2.0, 1.385)),
        axles=(-1.36, 1.44),
        wheel=0.335,
        roof_half=0.60,
        belt=0.95,
        outer=(1.02499, -2.31488, 2.32289, 1.4732),
        seams=[(0.86, 0.34, 0.97), (-0.02, 0.34, 0.98), (-0.92, 0.50, 1.0)],
        lamps_z=0.68,
        tail=(0.78, 1.06),
        spokes=5,
        plate=3,
        rails=True,
        pillar=(0.16, 0.13),
    ),
    Body(
        "offroader",
        "A compact sport utility vehicle, 4.45 m long.",
        4.45,
        1.86,
        1.66,
        side=[
            (-2.15, 0.30), (2.10, 0.27), (2.21, 0.42), (2.20, 0.74), (2.08, 0.90), (1.60, 1.01), (1.02, 1.08),
            (-1.3, 1.13), (-2.06, 1.13), (-2.19, 0.95), (-2.21, 0.50),
        ],
        cabin=[
            (1.22, 0.92), (1.00, 1.08), (0.38, 1.54), (-0.20, 1.66), (-1.25, 1.635), (-1.88, 1.55), (-2.10, 1.12),
            (-2.05, 0.9),
        ],
        windows=[
            [(0.04, 1.12), (0.80, 1.12), (0.40, 1.43), (0.18, 1.54), (0.04, 1.56)],
            [(-0.86, 1.15), (-0.06, 1.12), (-0.06, 1.565), (-0.84, 1.555)],
            [(-1.62, 1.21), (-0.94, 1.155), (-0.92, 1.555), (-1.42, 1.50)],
        ],
        screen=((1.04, 1.10), (0.40, 1.555)),
        rear=((-2.08, 1.17), (-1.88, 1.56)),
        axles=(-1.34, 1.34),
        wheel=0.36,
        roof_half=0.62,
        belt=1.08,
        outer=(1.04128, -2.18271, 2.19473, 1.6362),
        seams=[(0.84, 0.42, 1.10), (-0.01, 0.42, 1.11), (-0.92, 0.58, 1.13)],
        lamps_z=0.84,
        tail=(0.86, 1.16),
        spokes=5,
        plate=4,
        cladding=True,
        triangles=2400,
    ),
    Body(
        "van",
        "A panel van, 5.3 m long and 2.3 m high.",
        5.30,
        1.98,
        2.30,
        side=[
            (-2.62, 0.30), (2.45, 0.24), (2.62, 0.36), (2.61, 0.80), (2.48, 1.02), (1.95, 1.22), (1.75, 1.30),
            (-2.60, 1.30), (-2.64, 0.5),
        ],
        cabin=[
            (2.02, 1.05), (1.86, 1.26), (1.14, 2.08), (0.75, 2.28), (-0.2, 2.31), (-2.50, 2.29), (-2.62, 2.2),
            (-2.64, 1.0),
        ],
        windows=[[(0.42, 1.24), (1.62, 1.24), (1.66, 1.30), (1.10, 1.86), (0.42, 1.92)]],
        screen=((1.88, 1.30), (1.16, 2.06)),
        rear=((-2.64, 1.42), (-2.62, 2.0)),
        axles=(-1.72, 1.62),
        wheel=0.35,
        roof_half=0.82,
        belt=1.24,
        outer=(1.14362, -2.61532, 2.61125, 2.283),
        seams=[(1.52, 0.42, 1.24), (0.34, 0.36, 2.05), (-0.95, 0.40, 2.05)],
        lamps_z=0.92,
        tail=(0.80, 1.45),
        spokes=6,
        plate=5,
        paints=("white", "silver", "blue"),
        plan_corner=0.38,
        upright=True,
    ),
)  # fmt: skip


def build_cars() -> list[Component]:
    """The five bodies of `CARS` as components with paint and lamps to choose."""
    return [build_car(body) for body in CARS]


def build_bus() -> Component:
    """A city bus of 12 m with three doors; it is one colour below and glass above."""

    def field_(x: Array, y: Array, z: Array) -> Array:
        side = outline_distance(
            rounded(
                [
                    (-5.95, 0.30), (5.9, 0.30), (6.0, 0.7), (5.98, 1.4), (5.80, 2.95), (5.6, 3.05), (-5.85, 3.05),
                    (-6.0, 2.6), (-6.0, 0.5),
                ],
                2,
                0.12,
            ),
            y,
            z,
        )  # fmt: skip
        plan = outline_distance(
            rounded([(-1.275, -6.0), (1.275, -6.0), (1.275, 5.85), (0.9, 6.0), (-0.9, 6.0), (-1.275, 5.85)], 2, 0.08),
            x,
            y,
        )
        front = outline_distance(
            rounded(
                [
                    (-1.2, 0.3), (1.2, 0.3), (1.275, 0.7), (1.265, 2.3), (1.2, 2.95), (0.9, 3.05), (-0.9, 3.05),
                    (-1.2, 2.95), (-1.265, 2.3), (-1.275, 0.7),
                ],
                2,
                0.15,
            ),
            x,
            z,
        )  # fmt: skip
        return soft_max(soft_max(side, plan, 0.12), front, 0.10)

    skin = surface(field_, (-1.5, -6.2, 0.1), (1.5, 6.2, 3.3), step=0.09, triangles=3600, material="paint")
    parts: list[Part] = []
    openings = []
    doors = [(-5.05, -3.75), (-0.1, 1.3), (4.05, 5.42)]
    left = [(-5.6, -3.9), (-3.8, -2.1), (-2.0, -0.3), (-0.2, 1.5), (1.6, 3.3), (3.4, 5.45)]
    right = [(-5.65, -5.15), (-3.65, -1.98), (-1.88, -0.2), (1.4, 2.62), (2.72, 3.95)]
    for sign, panes in ((-1, left), (1, right)):
        for y0, y1 in panes:
            openings.append((rect(y0, y1, 1.25 if y1 > 5 else 1.35, 2.62), sign))
    openings += [(rect(y0, y1, 0.42, 2.58), 1) for y0, y1 in doors]
    for outline, sign in openings:
        skin = cut_out(skin, parts, "glass_clear", (1, 2), outline, 0, sign, 0.75)
    for y0, y1 in doors:  # the frames of their leaves
        for y in (y0, (y0 + y1) / 2 - 0.03, (y0 + y1) / 2 + 0.03, y1):
            parts.append(box((1.25, y - 0.022, 0.42), (1.284, y + 0.022, 2.60), "gloss_black"))
        for z in (0.44, 2.58):
            parts.append(box((1.25, y0 + 0.03, z - 0.022), (1.281, y1 - 0.03, z + 0.03), "gloss_black"))
    for sign in (-1, 1):
        skin = cut_out(skin, parts, "gloss_black", (1, 2), rect(-5.75, 5.6, 1.28, 2.72), 0, sign, 0.75)
        for y in (-4.6, -2.05, 0.35, 1.35, 2.45) if sign < 0 else (-3.7, -2.05, -0.15, 1.36, 2.45):
            parts += seam_line(field_, [(y, 1.24), (y, 0.34)], flank=sign)
        parts += seam_line(field_, [(-5.7, 0.56), (3.8, 0.56)], flank=sign)
    screen, rear = rect(-1.12, 1.12, 1.12, 2.45), rect(-1.0, 1.0, 1.75, 2.6)
    hip = (-0.72, 4.62, 1.10)
    parts += lined(
        field_,
        (-1.5, -6.2, 0.1),
        (1.5, 6.2, 3.3),
        roof_z=2.58,
        sides=openings,
        front=screen,
        back=rear,
        axles=(-3.0, 3.2),
        step=0.12,
        triangles=600,
    )
    parts += [
        *seat(*hip),
        dashboard(1.0, 5.30, 5.70, 1.14),
        *steering_wheel(hip, radius=0.23, tilt_deg=30),
        *driver(hip),
    ]
    parts += rows((-4.6, -3.75, -1.2, 0.3, 2.0, 2.85), (-0.70,), 0.85) + rows((-4.6, -1.2, 2.0, 2.85), (0.70,), 0.85)
    parts += [
        tube([(x, y, 0.5), (x, y, 2.75)], 0.018, "amber", sides=5, capped=False)
        for x in (-0.22, 0.22)
        for y in (-4.2, -1.9, 0.6, 1.7)
    ]
    skin = cut_out(skin, parts, "glass_clear", (0, 2), screen, 1, 1, 0.6)
    skin = cut_out(skin, parts, "gloss_black", (0, 2), rect(-1.16, 1.16, 1.05, 2.95), 1, 1, 0.6)
    skin = cut_out(skin, parts, "glass_clear", (0, 2), rear, 1, -1, 0.6)
    skin, shine = lamp_units(
        skin,
        parts,
        field_,
        [(0.60, 0.68), (0.68, 0.60), (1.21, 0.63), (1.23, 0.90), (1.02, 0.89)],
        [(0.86, 0.74, 0.062), (1.05, 0.78, 0.045), (0.71, 0.67, 0.030)],
        5.6,
    )
    for opening, outline in (
        (Opening((), 2, "black_plastic"), rect(-0.42, 0.42, 0.70, 0.80)),
        (Opening((), 2, "black_plastic"), rect(-0.70, 0.70, 0.33, 0.44)),
    ):
        skin = opened(skin, parts, field_, opening, outline)
    parts += seam_line(field_, [(-0.93, 0.98), (0.93, 0.98)])
    parts += seam_line(field_, [(-0.93, 0.555), (0.93, 0.555)])
    parts.append(lens_disc((0, front_at(field_, 0.0, 0.90, 1) + 0.012, 0.90), 0.065, "chrome"))
    parts += wipers(field_, [((-0.10, 1.15), (-0.98, 1.24)), ((0.92, 1.15), (0.06, 1.24))])
    for x0, x1 in ((-0.7, -0.02), (0.02, 0.7)):  # the engine's air behind
        for z in (1.06, 1.14, 1.22, 1.30):
            skin = cut_out(skin, parts, "seam", (0, 2), rect(x0, x1, z, z + 0.045), 1, -1, 0.6)
    parts += seam_line(field_, [(-0.80, 1.62), (-0.80, 0.58), (0.80, 0.58), (0.80, 1.62)], end=-1)
    for sign in (-1, 1):
        for material, z in (("lamp_lens_white", 0.80), ("amber", 1.34)):
            area = rect(*sorted((sign * 0.89, sign * 1.04)), z, z + 0.14)
            skin = cut_out(skin, parts, material, (0, 2), area, 1, -1, 0.3)
        skin = cut_out(
            skin, parts, "tail_lamp", (0, 2), rect(*sorted((sign * 0.87, sign * 1.06)), 0.78, 1.5), 1, -1, 0.3
        )
        parts += [
            lens_patch(field_, (sign * 0.965, 1.14), Lens((0.0, 0.0), (0.060, 0.085), 0.5), "tail_lens", -1),
            soft_box(
                (sign * 1.385 - 0.095, 5.94, 1.96), (sign * 1.385 + 0.095, 6.07, 2.46), "black_plastic", radius=0.05
            ),
            tube(
                [(sign * 1.12, 5.80, 2.78), (sign * 1.30, 5.96, 2.74), (sign * 1.385, 6.00, 2.44)],
                0.03,
                "black_plastic",
                sides=6,
            ),
        ]
    for y0, y1, z in ((-4.4, -1.5, 3.24), (0.6, 2.6, 3.20)):  # cooling and batteries on the roof
        parts.append(soft_box((-0.86, y0, 2.95), (0.86, y1, z), "frame_white", radius=0.12))
        parts += [
            box((-0.5, y, 3.0), (0.5, y + 0.28, z + 0.012), "black_plastic") for y in np.arange(y0 + 0.4, y1 - 0.5, 0.7)
        ]
    skin = arches(skin, parts, (-3.0, 3.2), 0.54, 0.95)
    skin = dusted(skin, parts, 0.30, (-3.0, 3.2))
    parts += [skin, *wheels((-3.0, 3.2), 0.48, 1.12, 0.28, 8)]
    parts.append(
        picture(
            [(-0.85, 6.0, 2.56), (0.85, 6.0, 2.56), (0.85, 5.93, 2.80), (-0.85, 5.93, 2.80)],
            "banner",
            3,
            4,
            turned=True,
            lift=(0, 0.03, 0),
        )
    )
    for sign in (-1, 1):
        parts.append(side_picture(sign, 1.30, -2.35, -0.2 if sign > 0 else 0.95, 0.76, 1.02 if sign > 0 else 1.14, 0))
    parts.append(plate((0, 6.03, 0.50), 6, front=True))
    parts.append(plate((0, -6.04, 0.7), 6, front=False))
    lamps = headlights(shine, "low_beam_halogen")
    variants = {
        "paint": {"red": painted("bus_red"), "yellow": painted("yellow")},
        "lamps": lamp_states(lamps),
        "driver": DRIVERS,
    }
    return Component("bus", "bus", cleaned(parts), "A city bus, 12 m long.", variants)


def build_lorry() -> Component:
    """A box lorry of 7.2 m: a cab like a small house and a white box behind it."""

    def cab(x: Array, y: Array, z: Array) -> Array:
        side = outline_distance(
            rounded(
                [
                    (1.75, 0.45), (3.5, 0.42), (3.6, 0.6), (3.58, 1.3), (3.30, 2.3), (3.1, 2.45), (1.85, 2.45),
                    (1.75, 2.2),
                ],
                2,
                0.15,
            ),
            y,
            z,
        )  # fmt: skip
        front = outline_distance(
            rounded([(-1.08, 0.42), (1.08, 0.42), (1.1, 1.3), (0.98, 2.45), (-0.98, 2.45), (-1.1, 1.3)], 2, 0.12), x, z
        )
        plan = outline_distance(
            rounded([(-1.1, 1.75), (1.1, 1.75), (1.1, 3.45), (0.85, 3.6), (-0.85, 3.6), (-1.1, 3.45)], 2, 0.15), x, y
        )
        return soft_max(soft_max(side, front, 0.10), plan, 0.08)

    skin = surface(cab, (-1.3, 1.6, 0.3), (1.3, 3.8, 2.65), step=0.05, triangles=2400, material="paint")
    parts: list[Part] = []
    side, screen = (
        [(2.1, 1.42), (3.25, 1.36), (3.05, 2.18), (2.1, 2.22)],
        [(-0.98, 1.38), (0.98, 1.38), (0.88, 2.2), (-0.88, 2.2)],
    )
    hip = (-0.52, 2.46, 1.34)
    parts += lined(
        cab, (-1.3, 1.6, 0.3), (1.3, 3.8, 2.65), roof_z=2.2, sides=[(side, -1), (side, 1)], front=screen, axles=(2.65,)
    )
    parts += [
        *seat(*hip),
        *seat(-hip[0], *hip[1:]),
        dashboard(0.88, 3.02, 3.34, 1.36),
        *steering_wheel(hip, radius=0.22, tilt_deg=35),
        *driver(hip),
    ]
    for sign in (-1, 1):
        skin = cut_out(skin, parts, "glass_clear", (1, 2), side, 0, sign, 0.5)
        skin = cut_out(skin, parts, "seam", (1, 2), rect(2.0, 2.012, 0.7, 2.3), 0, sign, 0.5)
        lamp = [(sign * 0.58, 0.70), (sign * 0.66, 0.64), (sign * 1.03, 0.68), (sign * 1.03, 0.92), (sign * 0.94, 0.94)]
        skin = covered(skin, parts, convex(lamp), 3.0, 0.03)
        parts += [
            bowl(cab, sign * x, z, r) for x, z, r in ((0.80, 0.77, 0.066), (0.66, 0.72, 0.035), (0.94, 0.85, 0.04))
        ]
        parts.append(lens_disc((sign * 0.80, 3.615, 0.77), 0.056, "headlamp_lens"))
        parts += [
            box((sign * 1.22 - 0.1, 3.32, 1.5), (sign * 1.22 + 0.1, 3.42, 2.05), "black_plastic"),
            box((sign * 1.12 - 0.1, 3.3, 1.95), (sign * 1.12 + 0.1, 3.34, 1.99), "black_plastic"),
        ]
        parts.append(lens_disc((sign * 1.0, -3.62, 0.95), 0.07, "tail_lens", back=True))
        parts.append(box((sign * 1.0 - 0.148, -3.612, 0.85), (sign * 1.0 + 0.148, -3.54, 1.05), "tail_lamp"))
    skin = cut_out(skin, parts, "glass_clear", (0, 2), screen, 1, 1, 0.35)
    mask = [(-1.02, 1.28), (1.02, 1.28), (0.90, 2.32), (-0.90, 2.32)]
    skin = cut_out(skin, parts, "gloss_black", (0, 2), mask, 1, 1, 0.3)
    for z, half, tall in ((1.16, 0.80, 0.055), (1.04, 0.76, 0.055), (0.90, 0.46, 0.09), (0.72, 0.46, 0.09)):
        slot = convex(
            [(x, z + dz) for x in (-half, half) for dz in (-tall / 2, tall / 2)] + [(-half - 0.03, z), (half + 0.03, z)]
        )
        skin = cut_out(skin, parts, "seam", (0, 2), slot, 1, 1, 0.35)
    skin = gap(skin, parts, (0, 2), [(-1.2, 0.97), (1.2, 0.97)], 1, 1, 0.3, width=0.012)
    skin = cut_out(skin, parts, "plastic_dusty", (0, 2), rect(-2, 2, 0.3, 0.6), 1, 1, -2)
    parts.append(lens_disc((0, front_at(cab, 0.0, 1.10, 1) + 0.01, 1.10), 0.06, "chrome"))
    for x, lean in ((-0.62, 0.46), (0.05, 0.46)):  # wipers at rest
        feet = [(x + u * lean, front_at(cab, x + u * lean, z, 1) + 0.015, z) for u, z in ((0, 1.37), (1, 1.45))]
        parts.append(tube(feet, 0.011, "black_plastic", sides=4))
    deflector = [
        np.array([(-half, y, z), (half, y, z)])
        for half, y, z in ((0.88, 2.75, 2.45), (0.94, 2.30, 2.78), (0.98, 1.95, 3.02))
    ]
    parts.append(smooth_normals(strip(deflector, "paint"), 60))
    for x in (-1, 1):
        ends = [[line[(x + 1) // 2], [*line[(x + 1) // 2][:2], 2.43]] for line in deflector]
        parts.append(strip([np.array(end) for end in ends], "paint"))
    skin = arches(skin, parts, (2.65,), 0.47, 0.75)
    skin = dusted(skin, parts, 0.60, (2.65,))
    parts += [skin, *wheels((-1.9, 2.65), 0.44, 0.98, 0.27, 8)]
    parts += [
        soft_box((-1.15, -3.6, 0.952), (1.15, 1.65, 3.147), "frame_white", radius=0.05),
        box((-0.45, -3.5, 0.55), (0.45, 2.0, 0.95), "black_plastic"),
        soft_box((-1.152, -3.602, 0.945), (1.152, 1.652, 1.01), "galvanised", radius=0.03, sides=2),
        soft_box((-1.152, -3.602, 3.09), (1.152, 1.652, 3.15), "galvanised", radius=0.03, sides=2),
        box((-0.006, -3.604, 0.98), (0.006, -3.59, 3.1), "seam"),
    ]
    parts += [
        tube([(x, -3.605, 1.0), (x, -3.605, 3.1)], 0.012, "galvanised", sides=5) for x in (-0.62, -0.16, 0.16, 0.62)
    ]
    parts += [
        box((sign * 1.14 - 0.022, y, 0.98), (sign * 1.14 + 0.022, y + 0.05, 3.12), "galvanised")
        for sign in (-1, 1)
        for y in (-3.60, 1.60)
    ]
    parts += [box((-1.1, -3.55, 0.5), (1.1, -3.45, 0.65), "black_plastic")]
    for sign in (-1, 1):
        parts.append(side_picture(sign, 1.155, -3.1, 1.2, 1.75, 2.3, 1))
        parts += [box((sign * 1.05 - 0.03, -0.8, 0.5), (sign * 1.05 + 0.03, 1.9, 0.85), "black_plastic")]
    parts += [plate((0, 3.63, 0.55), 7, front=True), plate((0, -3.61, 0.72), 7, front=False)]
    lamps = headlights([(-0.80, 3.66, 0.77), (0.80, 3.66, 0.77)], "low_beam_halogen")
    variants = {
        "paint": {name: painted(name) for name in ("white", "blue")},
        "lamps": lamp_states(lamps),
        "driver": DRIVERS,
    }
    return Component("lorry", "truck", cleaned(parts), "A box lorry, 7.2 m long.", variants)


def build_car(body: Body) -> Component:
    """A body as a component with glass, wheels, lamps and plates, and paint and lamps to choose."""
    half, y0, y1 = body.width / 2, -body.length / 2, body.length / 2
    sill, head = min(z for _, z in body.side), body.height
    field_ = car_field(body)
    margin = 0.12
    skin = surface(
        field_,
        (-half - margin, y0 - margin, sill - 0.2),
        (half + margin, y1 + margin, head + margin),
        step=0.024,
        triangles=body.triangles,
        material="paint",
        coarse=4,
    )
    floor = rect(-half * 0.58, half * 0.58, y0 + 0.35, y1 - 0.35)  # of the belly, which nobody sees, two triangles
    skin = carve(skin, [*prism(floor, (0, 1)), lambda q: q[:, 2] - sill - 0.08])[1]
    parts: list[Part] = [quad([(x, y, sill) for x, y in floor], "black_plastic")]
    skin = arches(
        skin, parts, body.axles, body.wheel + ARCH_GAP_M, half * ARCH_WALL, lip="black_plastic" if body.cladding else ""
    )
    for sign in (-1, 1):
        skin = _flank(skin, parts, body, field_, sign)
    (_fy, fz), (_hy, hz) = body.screen
    skin = screen(skin, parts, fz + 0.005, hz - 0.03, half * 0.80, body.roof_half * 0.93, 1, body.upright)
    (ry, rz), (sy, sz) = body.rear
    if not body.upright:
        to = None if body.pillar is None else (ry + body.pillar[0], sy + body.pillar[1])
        skin = screen(skin, parts, rz + 0.02, sz - 0.03, half * 0.66, body.roof_half * 0.82, -1, False, round_to=to)
    else:
        for x0, x1 in ((-0.72, -0.06), (0.06, 0.72)):
            skin = cut_out(skin, parts, "glass_car", (0, 2), rect(x0, x1, rz, sz), 1, -1, 0.5)
        skin = cut_out(skin, parts, "seam", (0, 2), rect(-0.006, 0.006, 0.45, 2.15), 1, -1, 0.5)
    skin = _shut_lines(skin, parts, body)
    skin, lens = front(skin, parts, body, field_)
    skin = tail_lamps(skin, parts, body, field_)
    if not body.upright:
        for sign in (-1, 1):
            area = convex([(sign * half * x, sill + z) for x in (0.60, 0.80) for z in (0.245, 0.275)])
            skin = cut_out(skin, parts, "tail_lamp", (0, 2), area, 1, -1, 0.25)
    valance = [
        (x, sill + z) for x, z in ((-half * 0.90, 0), (half * 0.90, 0), (half * 0.60, 0.19), (-half * 0.60, 0.19))
    ]
    skin = cut_out(skin, parts, "plastic_dusty", (0, 2), valance, 1, -1, 0.3)
    skin = cut_out(
        skin,
        parts,
        "plastic_dusty",
        (1, 2),
        rect(y0 - 1, y1 + 1, 0, sill + (0.14 if body.cladding else 0.055)),
        0,
        0,
        -9,
    )
    rear_plate = body.tail[0] - 0.02 if body.rear_plate_z is None else body.rear_plate_z
    parts.append(plate((0, front_at(field_, 0.0, rear_plate, -1) - 0.012, rear_plate), body.plate, front=False))
    z_badge = body.tail[0] + 0.1
    parts.append(lens_disc((0, front_at(field_, 0.0, z_badge, -1) - 0.008, z_badge), 0.042, "chrome", back=True))
    if body.rails:
        for sign in (-1, 1):
            ys = np.linspace(-1.75, 0.05, 9)
            zs = [top_at(field_, sign * 0.53, y) for y in ys]
            rail = np.c_[np.full(9, sign * 0.53), ys, np.array(zs) + 0.035]
            rail[0, 2] -= 0.03
            rail[-1, 2] -= 0.03
            parts.append(
                smooth_normals(
                    strip(
                        [
                            rail + [dx, 0, dz]
                            for dx, dz in ((-0.015, 0), (-0.012, 0.02), (0.012, 0.02), (0.015, 0), (-0.015, 0))
                        ],
                        "chrome",
                    ),
                    50,
                )
            )
    parts += centre_lamp(field_, sz)
    if not body.upright:
        parts += _stern(body, field_)
    skin = dusted(skin, parts, sill, body.axles)
    parts += _cabin(body, field_)
    parts += [skin, *wheels(body.axles, body.wheel, half - 0.065, 0.205, body.spokes)]
    found = cleaned(parts)
    place = _drawn_to(found, body.outer)
    variants = {
        "paint": {name: painted(name) for name in body.paints},
        "lamps": lamp_states(headlights([tuple((place @ [*at, 1.0])[:3]) for at in lens], body.beam), centre=True),
        "driver": DRIVERS,
    }
    return Component(body.name, "car", tuple(part.moved(place) for part in found), body.about, variants)


def _drawn_to(parts: Sequence[Part], outer: tuple[float, float, float, float]) -> Array:
    """(4, 4) matrix that stretches the parts, which stand on the ground, to `Body.outer`."""
    points = np.concatenate([part.points for part in parts])
    low, high = points.min(axis=0), points.max(axis=0)
    half, rear, front, height = outer
    along = (front - rear) / (high[1] - low[1])
    return shift(0.0, rear - along * low[1], 0.0) @ scale(half / high[0], along, height / high[2])


def _flank(skin: Part, parts: list[Part], body: Body, field_: Field, sign: int) -> Part:
    """Windows in one dark band, doors with their handles, and a mirror of one side; gives the rest of the skin."""
    belt = body.belt
    for window in body.windows:
        skin = cut_out(skin, parts, "glass_clear", (1, 2), grown(window, -0.012), 0, sign, 0.35)
    bands = body.windows if body.upright else [convex([p for window in body.windows for p in window])]
    for band in bands:
        skin = cut_out(skin, parts, "gloss_black", (1, 2), grown(band, 0.014), 0, sign, 0.35)
    shoulder = belt - SHOULDER_M
    for k, (y, z0, z1) in enumerate(body.seams):
        line = [(y, z1), (y + (0.03 if k == 0 else 0.0), 0.5 * (z0 + z1)), (y, z0)]
        if k == 2 and not body.upright:  # round the arch
            line = [(y, z1), (y, z0 + 0.18), (y + 0.16, z0 - 0.04), (y + 0.30, body.seams[0][1])]
        skin = gap(skin, parts, (1, 2), line, 0, sign, 0.4)
    first, last = body.seams[0], body.seams[-1]
    end = last[0] + (0.30 if len(body.seams) == 3 and not body.upright else 0.0)
    skin = gap(skin, parts, (1, 2), [(end, first[1]), (first[0], first[1])], 0, sign, 0.4)
    if not body.upright:
        arch, y1 = body.wheel + ARCH_GAP_M, body.length / 2
        z = body.lamps_z - 0.06
        skin = gap(skin, parts, (1, 2), [(body.axles[1] + 0.7 * arch, z - 0.06), (y1 - 0.30, z)], 0, sign, 0.3)
        bumper = body.tail[0] - 0.03
        skin = gap(
            skin, parts, (1, 2), [(-y1 + 0.10, bumper), (body.axles[0] - 0.8 * arch, bumper - 0.08)], 0, sign, 0.3
        )
    if sign > 0:
        y, z = body.axles[0] - 0.04, max(shoulder - 0.11, body.wheel * 2 + ARCH_GAP_M + 0.06)
        flap = [
            (y - 0.07, z - 0.06),
            (y + 0.07, z - 0.06),
            (y + 0.07, z + 0.06),
            (y - 0.07, z + 0.06),
            (y - 0.07, z - 0.06),
        ]
        skin = gap(skin, parts, (1, 2), flap, 0, sign, 0.4, width=0.006)
    for y, _, _ in body.seams[1:]:
        z = shoulder - 0.045
        grip = rect(y + 0.075, y + 0.245, z - 0.020, z + 0.024)
        skin = cut_out(skin, parts, "seam", (1, 2), convex([*grip, (y + 0.055, z), (y + 0.265, z)]), 0, sign, 0.4)
        bar = soft_box((0, 0, 0), (0.215, 0.020, 0.026), "chrome" if body.cladding else "paint", radius=0.009, sides=2)
        parts.append(bar.moved(on_side(field_, sign, y + 0.152, z) @ shift(0.0, -0.006 - 0.014 * (sign > 0), -0.010)))
    at = on_side(field_, sign, body.screen[0][0] - 0.32, belt + 0.02)[:3, 3]
    parts += [p.moved(shift(at[0] - sign * 0.005, at[1], belt + 0.03)) for p in mirror(sign)]
    return skin


def _stern(body: Body, field: Field) -> list[Part]:
    """What stands on the back of a car: a handle over the plate or the lid's edge, exhaust, and a wiper on a hatch."""
    half = body.width / 2
    sill = min(z for _, z in body.side)

    def behind(x: float, z: float, out: float) -> tuple[float, float, float]:
        return (x, front_at(field, x, z, -1) - out, z)

    over = body.tail[0] + (0.055 if body.rear_plate_z is None else 0.012)
    edge = [np.array([behind(x, over + dz, out) for x in np.linspace(-0.30, 0.30, 7)]) for dz, out in HANDLE]
    parts = [smooth_normals(strip(edge, "chrome" if body.cladding else "gloss_black"), 40)]
    x = half * 0.52
    y = front_at(field, x, sill + 0.10, -1)
    parts.append(
        tube([(x, y + 0.25, sill + 0.035), (x, y + 0.012, sill + 0.035)], 0.031, "brake", sides=9, capped=False)
    )
    parts.append(disc((0, 0, 0), 0.030, "seam", sides=9).moved(shift(x, y + 0.05, sill + 0.035) @ turn(90, "x")))
    (ry, rz), (_, sz) = body.rear
    if ry < -body.length / 2 + 0.35:  # not on a boot's lid
        arm = [behind(u * 0.34 - 0.02, rz + 0.035 + v * (sz - rz), 0.014) for u, v in ((0, 0), (0.45, 0.06), (1, 0.14))]
        parts += [
            tube(arm, 0.009, "black_plastic", sides=4),
            lens_disc(behind(-0.02, rz + 0.03, 0.012), 0.024, "black_plastic", back=True),
        ]
    return parts


def _shut_lines(skin: Part, parts: list[Part], body: Body) -> Part:
    """The gaps round bonnet and boot, as they are seen from above, ahead and behind; gives the rest of the skin."""
    half, y0, y1 = body.width / 2, -body.length / 2, body.length / 2
    (fy, _), _ = body.screen
    (ry, _), _ = body.rear
    nose = y1 - 0.24
    bonnet = [(-half * 0.80, fy + 0.02), (-half * 0.70, nose), (half * 0.70, nose), (half * 0.80, fy + 0.02)]
    skin = gap(skin, parts, (0, 1), bonnet, 2, 1, 0.3, beyond=body.lamps_z)
    if body.upright:
        return skin
    top, deep = body.tail[1] - 0.02, 0.45
    if body.pillar is not None:
        top, deep = min(top, body.rear[0][1] - 0.06), 0.22
    if ry > y0 + 0.35:  # a boot lid
        lid = [(-half * 0.68, ry), (-half * 0.74, y0 + 0.02)]
        for sign in (-1, 1):
            skin = gap(skin, parts, (0, 1), [(sign * x, y) for x, y in lid], 2, 1, 0.5, beyond=body.lamps_z)
        top = body.tail[1] + 0.06
    low = body.tail[0] - 0.03
    for sign in (-1, 1):  # between wing and bumper, under the lamps
        under = [(sign * half * 0.70, low), (sign * half * 0.97, low)]
        skin = gap(skin, parts, (0, 2), under, 1, -1, 0.35, beyond=-y0 - 0.5)
    hatch = [(-half * 0.74, top), (-half * 0.70, low), (half * 0.70, low), (half * 0.74, top)]
    return gap(skin, parts, (0, 2), hatch, 1, -1, 0.25, beyond=-y0 - deep)


def _cabin(body: Body, field_: Field) -> list[Part]:
    """Lining, seats, dashboard, wheel and driver of a car; a van has a wall behind the front seats."""
    half, belt = body.width / 2, body.belt
    (fy, fz), (_hy, hz) = body.screen
    (ry, rz), (_sy, sz) = body.rear
    low, high = (
        (-half - 0.1, -body.length / 2 - 0.1, min(z for _, z in body.side) - 0.1),
        (half + 0.1, fy + 0.12, body.height + 0.1),
    )
    panels = list(lining(field_, low, high, step=0.07, triangles=420, roof_z=hz - 0.02))
    inner: list[Part] = []  # what is cut out of the lining is thrown away
    top = 2 * body.wheel + ARCH_GAP_M
    for k, panel in enumerate(panels):
        for y in body.axles:  # where the wheels are
            house = prism(rect(y - 0.42, y + 0.42, 0.0, top), (1, 2))
            panel = carve(panel, [*house, lambda q: 0.58 * half - np.abs(q[:, 0])])[1]
        for sign in (-1, 1):
            for window in body.windows:
                panel = cut_out(panel, inner, "hole", (1, 2), grown(window, 0.004), 0, sign, 0.3)
        panel = screen(panel, inner, fz - 0.02, hz, half * 0.80, body.roof_half * 0.93, 1, body.upright)
        panels[k] = (
            screen(panel, inner, rz, sz, half * 0.66, body.roof_half * 0.82, -1, body.upright)
            if not body.upright
            else panel
        )
    behind = min(y for y, _ in body.windows[0])  # the pillar behind the driver
    hip = belt - 0.42
    x = 0.42 * half
    at = (-x, behind + 0.27, hip)
    parts = [
        *panels,
        *seat(*at),
        *seat(x, at[1], hip),
        dashboard(half * 0.80, at[1] + 0.44, fy - 0.02, belt - 0.03),
        *steering_wheel(at),
        *driver(at),
    ]
    if len(body.windows) == 1:
        return [*parts, bulkhead(half * 0.86, behind - 0.16, hip - 0.3, hz)]
    if body.upright:
        for window in body.windows[1:]:
            y = min(y for y, _ in window) + 0.30
            parts += [*seat(-x, y, hip, half=0.42, heads=(-0.2, 0.2)), *seat(x * 1.2, y, hip, half=0.24)]
        return parts
    bench = at[1] - 0.84
    beside_arch = bench - 0.12 < body.axles[0] + body.wheel + ARCH_GAP_M
    wide = half * ARCH_WALL - (0.006 if beside_arch else 0.0)  # else its sides lie in the walls of the arches
    parts += seat(0.0, bench, hip + 0.02, half=wide, heads=(-x, x), tall=0.52)
    shelf = at[1] - 1.22
    return (
        [*parts, box((-half * 0.66, ry + 0.07, rz - 0.045), (half * 0.66, shelf, rz - 0.03), "cabin_dark")]
        if ry + 0.2 < shelf
        else parts
    )

"""A large box truck, a coach and a minibus.

Their skins are the meeting of three rounded silhouettes, as those of `vehicles`;
lengths in metres, front along +Y.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from assets.builders.bodywork import Body
from assets.builders.cabins import DRIVERS, Point, dashboard, driver, lined, rows, seat, steering_wheel
from assets.builders.coachwork import (
    arches,
    convex,
    cut_out,
    dusted,
    front_at,
    grown,
    headlights,
    lamp_states,
    lens_disc,
    painted,
    plate,
    rect,
    seam_line,
    wheels,
)
from assets.builders.faces import Lens, Opening, lamp_units, lens_patch, opened, wipers
from assets.builders.solids import Field, outline_distance, rounded, soft_max, surface
from assets.builders.vehicles import build_car
from synfog_usd.world.components import Component, Look
from synfog_usd.world.lod import cleaned
from synfog_usd.world.shapes import Array, Part, box, smooth_normals, soft_box, strip, tube

Outline = Sequence[tuple[float, float]]
Box = tuple[Point, Point]


def build_trucks() -> list[Component]:
    """Everything in this module."""
    return [_box_truck(), _coach(), _minibus()]


def _hull(
    side: Outline, front: Outline, plan: Outline, *, step: float, triangles: int, soft: float = 0.10
) -> tuple[Part, Field, Box]:
    """The skin inside three silhouettes: (y, z), (x, z) and (x, y); corners rounded.  With it its distance and a box
    round it.
    """
    outlines = [rounded(o, 2, 0.14) for o in (side, front, plan)]

    def field(x: Array, y: Array, z: Array) -> Array:
        a, b, c = (outline_distance(o, u, v) for o, (u, v) in zip(outlines, ((y, z), (x, z), (x, y)), strict=True))
        return soft_max(soft_max(a, b, soft), c, soft)

    low: Point = (min(x for x, _ in plan) - 0.2, min(y for _, y in plan) - 0.2, min(z for _, z in side) - 0.2)
    high: Point = (max(x for x, _ in plan) + 0.2, max(y for _, y in plan) + 0.2, max(z for _, z in side) + 0.2)
    return surface(field, low, high, step=step, triangles=triangles, material="paint"), field, (low, high)


def _looks(paints: Sequence[str], lamps: Sequence[tuple[float, float, float]]) -> dict[str, dict[str, Look]]:
    paint = {name: painted(name) for name in paints}
    return {"paint": paint, "lamps": lamp_states(headlights(lamps, "low_beam_halogen")), "driver": DRIVERS}


def _box_truck() -> Component:
    """A cab over the engine, a box with a chilling unit, three axles."""
    skin, field, around = _hull(
        [
            (2.55, 0.55), (4.50, 0.50), (4.62, 0.75), (4.60, 1.45), (4.38, 2.75), (4.05, 3.10), (2.75, 3.12),
            (2.55, 2.95),
        ],
        [(-1.18, 0.50), (1.18, 0.50), (1.23, 1.4), (1.16, 2.8), (1.0, 3.12), (-1.0, 3.12), (-1.16, 2.8), (-1.23, 1.4)],
        [(-1.24, 2.55), (1.24, 2.55), (1.24, 4.42), (0.92, 4.62), (-0.92, 4.62), (-1.24, 4.42)],
        step=0.06,
        triangles=2400,
    )  # fmt: skip
    parts: list[Part] = []
    side, screen = (
        [(3.05, 1.62), (4.22, 1.52), (4.05, 2.42), (3.05, 2.46)],
        [(-1.08, 1.60), (1.08, 1.60), (1.0, 2.52), (-1.0, 2.52)],
    )
    hip = (-0.62, 3.36, 1.56)
    parts += lined(field, *around, roof_z=2.5, sides=[(side, -1), (side, 1)], front=screen, axles=(3.62,))
    parts += [
        *seat(*hip),
        *seat(-hip[0], *hip[1:]),
        dashboard(0.98, 4.02, 4.36, 1.58),
        *steering_wheel(hip, radius=0.23, tilt_deg=35),
        *driver(hip),
    ]
    for sign in (-1, 1):
        skin = cut_out(skin, parts, "glass_clear", (1, 2), side, 0, sign, 0.5)
        skin = cut_out(skin, parts, "gloss_black", (1, 2), grown(convex(side), 0.035), 0, sign, 0.5)
        door = [(2.93, 2.70), (2.93, 1.06), (4.30, 1.06), (4.30, 1.48), (4.10, 2.70)]
        parts += seam_line(field, door, flank=sign)
        for z in (0.66, 0.92):  # steps before the wheel
            skin = cut_out(skin, parts, "seam", (1, 2), rect(4.21, 4.47, z, z + 0.17), 0, sign, 0.3)
            parts.append(
                box((sign * 1.16 - 0.045, 4.21, z - 0.012), (sign * 1.16 + 0.045, 4.46, z + 0.012), "galvanised")
            )
        parts += [
            soft_box((sign * 1.40 - 0.11, 4.32, 1.75), (sign * 1.40 + 0.11, 4.44, 2.35), "black_plastic", radius=0.04),
            soft_box((sign * 1.38 - 0.10, 4.32, 1.44), (sign * 1.38 + 0.10, 4.42, 1.70), "black_plastic", radius=0.04),
            tube([(sign * 1.18, 4.25, 2.38), (sign * 1.40, 4.38, 2.38)], 0.022, "black_plastic", sides=6),
            tube([(sign * 1.20, 4.25, 1.725), (sign * 1.40, 4.38, 1.725)], 0.022, "black_plastic", sides=6),
            box((sign * 1.24 - 0.03, 3.0, 1.28), (sign * 1.24 + 0.03, 3.22, 1.33), "black_plastic"),
            box((sign * 1.05 - 0.12, 2.95, 0.42), (sign * 1.05 + 0.12, 3.95, 0.52), "black_plastic"),
        ]
    skin = cut_out(skin, parts, "glass_clear", (0, 2), screen, 1, 1, 0.3)
    mask = [(-1.13, 1.50), (1.13, 1.50), (1.02, 2.62), (-1.02, 2.62)]
    skin = cut_out(skin, parts, "gloss_black", (0, 2), mask, 1, 1, 0.3)
    skin, shine = lamp_units(
        skin,
        parts,
        field,
        [(0.62, 0.74), (0.70, 0.67), (1.15, 0.70), (1.18, 1.00), (1.02, 1.01)],
        [(0.88, 0.82, 0.066), (1.04, 0.89, 0.046), (0.73, 0.76, 0.032)],
        4.2,
    )
    for opening, outline in (
        (Opening((), 5, "black_plastic", rim="galvanised", deep=0.05), rect(-0.80, 0.80, 1.06, 1.44)),
        (Opening((), 2, "black_plastic"), rect(-0.56, 0.56, 0.72, 0.92)),
        (Opening((), fog=0.05), rect(0.66, 0.90, 0.55, 0.65)),
        (Opening((), fog=0.05), rect(-0.90, -0.66, 0.55, 0.65)),
    ):
        skin = opened(skin, parts, field, opening, outline)
    parts += seam_line(field, [(-0.93, 1.02), (0.93, 1.02)])
    for sign in (-1, 1):
        parts += seam_line(field, [(sign * 1.0, 1.49), (sign * 0.93, 1.03)])
    skin = cut_out(skin, parts, "plastic_dusty", (0, 2), rect(-2, 2, 0.4, 0.66), 1, 1, -2)
    parts.append(lens_disc((0, front_at(field, 0.0, 1.475, 1) + 0.012, 1.475), 0.05, "chrome"))
    parts += wipers(field, [((-0.92, 1.58), (-0.16, 1.66)), ((-0.04, 1.58), (0.78, 1.66))])
    visor = [
        np.array([(x, front_at(field, 0.9 * x, 2.80, 1) + ahead, z) for x in (-1.02, -0.4, 0.4, 1.02)])
        for ahead, z in ((0.0, 2.80), (0.13, 2.72), (0.22, 2.56))
    ]
    parts.append(smooth_normals(strip(visor, "gloss_black"), 60))
    skin = arches(skin, parts, (3.62,), 0.55, 0.78)
    axles = (-2.75, -1.45, 3.62)
    skin = dusted(skin, parts, 0.70, (3.62,))
    parts += [skin, *wheels(axles, 0.50, 1.12, 0.30, 10)]
    parts += [
        soft_box((-1.25, -4.60, 1.12), (1.25, 2.42, 3.72), "frame_white", radius=0.06),
        box((-0.42, -4.50, 0.62), (0.42, 3.0, 1.12), "black_plastic"),
        soft_box((-0.95, 2.40, 2.75), (0.95, 2.85, 3.60), "sign_white", radius=0.10),
        box((-0.8, 2.84, 2.9), (0.8, 2.86, 3.4), "black_plastic"),
    ]
    for sign in (-1, 1):
        parts += [
            box((sign * 1.225 - 0.035, y, 1.10), (sign * 1.225 + 0.035, y + 0.07, 3.66), "galvanised")
            for y in (-4.61, 2.36)
        ]
        parts.append(box((sign * 1.24 - 0.02, -4.6, 1.08), (sign * 1.24 + 0.02, 2.42, 1.2), "galvanised"))
        parts += [
            box((sign * 1.16 - 0.02, -0.75, z), (sign * 1.16 + 0.02, 2.75, z + 0.14), "galvanised")
            for z in (0.50, 0.82)
        ]
        parts.append(strip(_mudguard(sign, axles[:2]), "black_plastic"))
        side = [(sign * 1.262, y, z) for y, z in ((-2.9, 1.85), (0.8, 2.25), (0.8, 2.85), (-2.9, 2.45))]
        parts.append(Part(np.array(side), np.array([(0, 1, 2), (0, 2, 3)])[:, :: int(sign)], "livery"))
        parts += [
            box((sign * 1.05 - 0.17, -4.64, 0.86), (sign * 1.05 + 0.17, -4.56, 1.04), "tail_lamp"),
            box((sign * 0.80 - 0.07, -4.638, 0.87), (sign * 0.80 + 0.07, -4.56, 1.03), "amber"),
            *(
                box((sign * 1.256 - 0.008, y, 1.23), (sign * 1.256 + 0.008, y + 0.09, 1.28), "amber")
                for y in (-3.9, -1.2, 1.6)
            ),
            box((sign * 1.22 - 0.02, -4.63, 3.4), (sign * 1.22 + 0.02, -4.6, 3.6), "tail_lamp"),
        ]
        parts.append(lens_disc((sign * 1.05, -4.645, 0.95), 0.075, "tail_lens", back=True))
    parts += [
        box((-0.006, -4.612, 1.2), (0.006, -4.598, 3.62), "seam"),
        *(tube([(x, -4.625, 1.2), (x, -4.625, 3.6)], 0.018, "galvanised", sides=6) for x in (-0.75, -0.2, 0.2, 0.75)),
        box((-1.1, -4.55, 0.48), (1.1, -4.43, 0.64), "black_plastic"),
        plate((0, 4.66, 0.58), 7, front=True),
        plate((0, -4.65, 0.80), 7, front=False),
    ]
    return Component(
        "box_truck",
        "truck",
        cleaned(parts),
        "A three-axled box truck, 9.3 m long.",
        _looks(("white", "orange", "green"), shine),
    )


def _mudguard(sign: int, axles: Sequence[float]) -> list[Array]:
    """Two loops along a plate bent over the rear wheels."""
    first, last = axles[0], axles[-1]
    a, b = np.linspace(np.pi * 0.95, np.pi / 2, 6), np.linspace(np.pi / 2, np.pi * 0.05, 6)
    y = np.r_[first + 0.58 * np.cos(a), last + 0.58 * np.cos(b)]
    z = np.r_[0.5 + 0.56 * np.sin(a), 0.5 + 0.56 * np.sin(b)]
    return [np.c_[np.full(12, sign * x), y, z] for x in (0.78, 1.16)]


def _coach() -> Component:
    """A touring coach, 12.2 m long: a high floor, luggage below, one band of dark glass."""
    skin, field, around = _hull(
        [
            (-6.05, 0.32), (6.0, 0.28), (6.12, 0.70), (6.08, 1.60), (5.72, 3.30), (5.35, 3.60), (-5.75, 3.62),
            (-6.05, 3.35), (-6.12, 1.2),
        ],
        [
            (-1.2, 0.28), (1.2, 0.28), (1.275, 0.8), (1.27, 2.6), (1.14, 3.45), (0.9, 3.62), (-0.9, 3.62),
            (-1.14, 3.45), (-1.27, 2.6), (-1.275, 0.8),
        ],
        [(-1.275, -6.1), (1.275, -6.1), (1.275, 5.75), (0.95, 6.12), (-0.95, 6.12), (-1.275, 5.75)],
        step=0.09,
        triangles=3000,
        soft=0.16,
    )  # fmt: skip
    parts: list[Part] = []
    sides: list[Outline] = [
        rect(y0, min(y0 + 1.58, 4.55), 1.72, 3.08) for y0 in np.arange(-5.55, 4.3, 1.62).tolist()
    ] + [[(4.62, 1.42), (5.62, 1.30), (5.45, 2.75), (4.62, 3.02)]]
    screen, rear = [(-1.16, 1.24), (1.16, 1.24), (1.06, 3.02), (-1.06, 3.02)], rect(-0.95, 0.95, 2.10, 3.05)
    hip = (-0.70, 4.86, 1.32)
    openings = [(one, sign) for one in sides for sign in (-1, 1)]
    parts += lined(
        field,
        *around,
        roof_z=3.02,
        sides=openings,
        front=screen,
        back=rear,
        axles=(-3.35, 3.55),
        step=0.12,
        triangles=600,
    )
    parts += [
        *seat(*hip),
        dashboard(1.0, 5.42, 5.80, 1.24),
        *steering_wheel(hip, radius=0.23, tilt_deg=30),
        *driver(hip),
    ]
    parts += rows(np.arange(-4.24, 4.0, 0.86), (-0.68, 0.68), 1.50)
    for sign in (-1, 1):
        for window in sides:
            skin = cut_out(skin, parts, "glass_clear", (1, 2), window, 0, sign, 0.6)
        skin = cut_out(skin, parts, "gloss_black", (1, 2), rect(-5.65, 5.5, 1.66, 3.16), 0, sign, 0.6)
        for y in (-1.6, -0.2, 1.2, 2.6):
            skin = cut_out(skin, parts, "seam", (1, 2), rect(y, y + 0.012, 0.5, 1.45), 0, sign, 0.6)
        skin = cut_out(skin, parts, "seam", (1, 2), rect(-1.6, 2.6, 1.45, 1.462), 0, sign, 0.6)
        skin = cut_out(skin, parts, "livery", (1, 2), rect(-5.3, 2.7, 1.10, 1.22), 0, sign, 0.6)
        if sign > 0:
            skin = cut_out(skin, parts, "glass_car", (1, 2), rect(4.70, 5.55, 0.45, 1.50), 0, sign, 0.6)
            parts += seam_line(field, [(4.64, 1.5), (4.64, 0.40), (5.60, 0.40), (5.60, 1.5)], flank=sign)
            parts += seam_line(field, [(-0.9, 1.60), (-0.9, 0.40), (-0.1, 0.40), (-0.1, 1.60)], flank=sign)
        else:
            parts += seam_line(field, [(4.60, 1.60), (4.60, 0.60), (5.62, 0.60), (5.62, 1.28)], flank=sign)
        parts += seam_line(field, [(-5.9, 0.62), (-4.0, 0.62)], flank=sign)
        for material, z in (("lamp_lens_white", 0.88), ("amber", 1.38)):
            area = rect(*sorted((sign * 0.84, sign * 1.00)), z, z + 0.14)
            skin = cut_out(skin, parts, material, (0, 2), area, 1, -1, 0.15)
        skin = cut_out(
            skin, parts, "tail_lamp", (0, 2), rect(*sorted((sign * 0.82, sign * 1.02)), 0.85, 1.55), 1, -1, 0.15
        )
        parts.append(lens_patch(field, (sign * 0.92, 1.20), Lens((0.0, 0.0), (0.060, 0.085), 0.5), "tail_lens", -1))
        parts += [
            soft_box((sign * 1.38 - 0.10, 6.02, 2.10), (sign * 1.38 + 0.10, 6.14, 2.62), "black_plastic", radius=0.04),
            tube(
                [(sign * 1.05, 5.62, 3.28), (sign * 1.36, 5.98, 3.10), (sign * 1.38, 6.08, 2.60)],
                0.032,
                "black_plastic",
                sides=7,
            ),
        ]
    skin = cut_out(skin, parts, "glass_clear", (0, 2), screen, 1, 1, 0.35)
    skin = cut_out(
        skin, parts, "gloss_black", (0, 2), [(-1.2, 1.14), (1.2, 1.14), (1.05, 3.32), (-1.05, 3.32)], 1, 1, 0.3
    )
    skin, shine = lamp_units(
        skin,
        parts,
        field,
        [(0.60, 0.80), (0.72, 0.66), (1.20, 0.68), (1.24, 1.02), (1.10, 1.00)],
        [(0.90, 0.79, 0.066), (1.08, 0.87, 0.046), (0.74, 0.75, 0.034)],
        5.6,
    )
    for opening, outline in (
        (Opening((), 3, "chrome"), [(-0.44, 0.86), (0.44, 0.86), (0.52, 1.02), (-0.52, 1.02)]),
        (Opening((), 2, "black_plastic"), [(-0.62, 0.36), (0.62, 0.36), (0.56, 0.46), (-0.56, 0.46)]),
        (Opening((), fog=0.045, corner=0.02), rect(0.74, 0.98, 0.40, 0.50)),
        (Opening((), fog=0.045, corner=0.02), rect(-0.98, -0.74, 0.40, 0.50)),
    ):
        skin = opened(skin, parts, field, opening, outline)
    parts += seam_line(field, [(-0.93, 1.09), (0.93, 1.09)])
    parts += seam_line(field, [(-0.93, 0.59), (0.93, 0.59)])
    parts.append(lens_disc((0, front_at(field, 0.0, 0.94, 1) + 0.014, 0.94), 0.075, "chrome"))
    parts += wipers(field, [((-0.10, 1.26), (-1.00, 1.36)), ((0.96, 1.26), (0.06, 1.36))])
    skin = cut_out(skin, parts, "glass_clear", (0, 2), rear, 1, -1, 0.5)
    for z in (0.80, 0.90, 1.00, 1.10, 1.20):  # the engine's air
        skin = cut_out(skin, parts, "seam", (0, 2), rect(-0.66, 0.66, z, z + 0.06), 1, -1, 0.5)
    hatch = [(-0.76, 1.95), (-0.76, 0.70), (0.76, 0.70), (0.76, 1.95)]
    parts += seam_line(field, hatch, end=-1)
    skin = arches(skin, parts, (-3.35, 3.55), 0.55, 0.92)
    skin = dusted(skin, parts, 0.32, (-3.35, 3.55))
    parts += [skin, *wheels((-3.35, 3.55), 0.51, 1.14, 0.30, 10)]
    parts += [
        soft_box((-0.85, -2.6, 3.50), (0.85, 0.2, 3.76), "frame_white", radius=0.12),
        *(box((-0.5, y, 3.60), (0.5, y + 0.5, 3.764), "black_plastic") for y in (-2.2, -0.9)),
        soft_box((-0.40, 2.4, 3.50), (0.40, 3.2, 3.68), "frame_white", radius=0.08),
        plate((0, 6.15, 0.50), 6, front=True),
        plate((0, -6.14, 0.66), 6, front=False),
    ]
    return Component(
        "coach", "bus", cleaned(parts), "A touring coach, 12.3 m long.", _looks(("white", "silver", "blue"), shine)
    )


MINIBUS = Body(
    "minibus",
    "A minibus with windows all round, 5.9 m long.",
    5.90,
    2.02,
    2.62,
    side=[
        (-2.92, 0.30), (2.75, 0.24), (2.92, 0.36), (2.91, 0.82), (2.78, 1.04), (2.28, 1.24), (2.08, 1.32),
        (-2.90, 1.32), (-2.94, 0.5),
    ],
    cabin=[
        (2.34, 1.07), (2.18, 1.28), (1.45, 2.22), (1.0, 2.58), (-0.2, 2.63), (-2.80, 2.61), (-2.92, 2.5),
        (-2.94, 1.0),
    ],
    windows=[
        [(0.80, 1.26), (1.94, 1.26), (1.98, 1.32), (1.42, 1.96), (0.80, 2.06)],
        [(-0.42, 1.34), (0.66, 1.34), (0.66, 2.06), (-0.42, 2.06)],
        [(-1.58, 1.34), (-0.50, 1.34), (-0.50, 2.06), (-1.58, 2.06)],
        [(-2.66, 1.34), (-1.66, 1.34), (-1.66, 2.06), (-2.66, 2.06)],
    ],
    screen=((2.20, 1.32), (1.47, 2.20)),
    rear=((-2.94, 1.46), (-2.92, 2.15)),
    axles=(-1.85, 1.90),
    wheel=0.36,
    roof_half=0.82,
    belt=1.26,
    outer=(1.15857, -2.91542, 2.91162, 2.60273),
    seams=[(1.84, 0.44, 1.26), (0.72, 0.38, 2.12), (-0.46, 0.42, 2.12)],
    lamps_z=0.94,
    tail=(0.82, 1.5),
    spokes=6,
    plate=3,
    paints=("white", "silver", "red"),
    plan_corner=0.38,
    upright=True,
    triangles=3000,
)  # fmt: skip


def _minibus() -> Component:
    body = build_car(MINIBUS)
    return Component(body.name, "bus", body.parts, body.about, body.variants)

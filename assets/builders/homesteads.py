"""Buildings outside the town: a terrace house, a farmhouse, an office block, a warehouse and a filling station.

They stand as those of `buildings` do: on z = 0, the middle of the front at the
origin, front along +Y, the building behind it.  Lengths in metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from assets.builders.buildings import House, bar, cell_uv, flat, front_of, house_parts, place_corners, roof_of
from assets.builders.textures import ATLAS
from synfog_usd.base.seeds import stream
from synfog_usd.world.components import Component
from synfog_usd.world.lettering import letters
from synfog_usd.world.shapes import Part, box, lathe, quad, quads, shift, soft_box, strip, turn

TERRACE = House(
    "terrace_house",
    "A narrow brick house of a terrace, two storeys.",
    5.8,
    1,
    "brick_red",
    "brick_red",
    "trim_white",
    "frame_white",
    bay=2.3,
    window=(1.2, 1.45, 0.85),
    ground_height=2.95,
    floor_height=2.75,
    depth=9.0,
    roofing="slate",
    door="door_blue",
    surround=0.10,
)
FARM = House(
    "farmhouse",
    "A farmhouse with windows on every side, 12 m wide.",
    12.0,
    1,
    "plaster_white",
    "plaster_white",
    "trim",
    "frame_green",
    bay=2.5,
    window=(1.05, 1.35, 0.85),
    ground_height=2.9,
    floor_height=2.7,
    depth=9.5,
    roofing="roof_tile",
    door="door_green",
    surround=0.12,
)
OFFICE = House(
    "office_block",
    "An office block of five storeys with windows on every side.",
    26.0,
    4,
    "concrete",
    "stone_dark",
    "concrete",
    "frame_dark",
    bay=3.1,
    window=(2.5, 1.75, 0.85),
    ground_height=3.9,
    floor_height=3.3,
    depth=15.0,
    roof="flat",
    surround=0.0,
    door="door_blue",
)


def build_homesteads() -> list[Component]:
    """Everything in this module."""
    terrace = Component(TERRACE.name, "building", tuple(house_parts(TERRACE)[0]), TERRACE.about)
    return [terrace, _detached(FARM), _detached(OFFICE), _warehouse(), _filling_station()]


def _detached(house: House) -> Component:
    """A house with a facade on each of its four sides."""
    rng = stream(0, "house", house.name)
    x, d = house.width / 2, house.depth
    places = [np.eye(4), shift(x, -d / 2) @ turn(-90), shift(0, -d) @ turn(180), shift(-x, -d / 2) @ turn(90)]
    parts: list[Part] = []
    panes, cells = [], []
    for side, place in enumerate(places):
        front = front_of(house, house.width if side % 2 == 0 else d, (), rng, side)
        parts += [p.moved(place) for p in front.parts]
        panes.append(place_corners(np.array(front.panes), place))
        cells += front.cells
    parts.append(quads(np.concatenate(panes), "window", cell_uv(np.array(cells), ATLAS, ATLAS)))
    parts += roof_of(house, house.ground_height + house.floors * house.floor_height, rng)
    return Component(house.name, "building", tuple(parts), house.about)


def _sheet(width: float, z0: float, z1: float, material: str, pitch: float = 0.333, deep: float = 0.04) -> Part:
    """A wall of trapezoid steel sheet that faces +Y, middle at x = 0."""
    count = round(width / pitch)
    step = width / count
    at = (
        np.concatenate(
            [step * k + step * np.array([0.0, 0.32, 0.45, 0.87]) for k in range(count)] + [np.array([width])]
        )
        - width / 2
    )
    out = np.concatenate([np.tile([deep, deep, 0.0, 0.0], count), [deep]])
    return strip([np.c_[at, out, np.full(len(at), z)][::-1] for z in (z0, z1)], material)


def _warehouse() -> Component:
    width, depth, height = 32.0, 22.0, 7.8
    parts: list[Part] = []
    sides: Sequence[tuple[float, float, float, float]] = (
        (0, 0, 0, width),
        (width / 2, -depth / 2, -90, depth),
        (0, -depth, 180, width),
        (-width / 2, -depth / 2, 90, depth),
    )
    for x, y, spin, length in sides:
        place = shift(x, y) @ turn(spin)
        wall = [
            bar((-length / 2, length / 2, 0, 1.1), -0.2, 0.05, "concrete"),
            _sheet(length, 1.1, 6.3, "sheet_grey"),
            _sheet(length, 6.3, height, "sheet_blue"),
            bar((-length / 2 - 0.06, length / 2 + 0.06, height, height + 0.18), -0.35, 0.10, "zinc"),
        ]
        parts += [p.moved(place) for p in wall]
        for end in (-0.5, 0.5):
            parts.append(
                box((end * length - 0.08, -0.06, 1.1), (end * length + 0.08, 0.08, height), "zinc").moved(place)
            )
    for k in range(4):  # loading docks
        c = -9.5 + 5.0 * k
        parts += [
            bar((c - 1.55, c + 1.55, 1.15, 4.55), 0.0, 0.06, "black_plastic"),
            *(
                bar((c - 1.35, c + 1.35, 1.2 + 0.32 * i, 1.2 + 0.32 * i + 0.29), 0.02, 0.085, "frame_white")
                for i in range(10)
            ),
            bar((c - 1.95, c - 1.50, 0.9, 4.9), 0.0, 0.55, "black_plastic"),
            bar((c + 1.50, c + 1.95, 0.9, 4.9), 0.0, 0.55, "black_plastic"),
            bar((c - 1.95, c + 1.95, 4.5, 5.1), 0.0, 0.55, "black_plastic"),
            *(bar((c + s * 1.2 - 0.12, c + s * 1.2 + 0.12, 0.55, 1.05), 0.0, 0.16, "tyre") for s in (-1, 1)),
        ]
    cells = iter(range(ATLAS**2))
    for k in range(3):  # offices
        for z in (1.4, 4.1):
            u = 9.6 + 1.9 * k
            rect = (u - 0.75, u + 0.75, z, z + 1.35)
            parts.append(flat(rect, 0.07, "window", cell_uv(np.array([next(cells)]), ATLAS, ATLAS)[0]))
            parts += [
                bar((rect[0] - 0.06, rect[1] + 0.06, zz - 0.05, zz + 0.05), 0.0, 0.11, "frame_dark")
                for zz in (rect[2], rect[3])
            ]
            parts += [
                bar((uu - 0.04, uu + 0.04, rect[2], rect[3]), 0.0, 0.10, "frame_dark") for uu in (rect[0], u, rect[1])
            ]
    parts += [bar((7.2, 8.3, 0.0, 2.3), 0.0, 0.07, "door_blue"), bar((6.9, 8.6, 2.5, 2.62), 0.0, 1.2, "zinc")]
    parts += [p.moved(shift(1.0, 0.10, 6.62)) for p in letters("SPEDITION NORD", 0.85, "sign_white")]
    parts.append(quad([(-16, -22, 7.75), (16, -22, 7.75), (16, 0, 7.75), (-16, 0, 7.75)], "roof_flat"))
    parts += [
        soft_box((x - 0.8, y - 0.8, 7.7), (x + 0.8, y + 0.8, 8.35), "shelter_glass", radius=0.2)
        for x in (-10, 0, 10)
        for y in (-6, -15)
    ]
    return Component(
        "warehouse",
        "building",
        tuple(parts),
        "A warehouse of steel sheet with four loading docks and an office, 32 m wide.",
    )


def _filling_station() -> Component:
    """A canopy over two islands with pumps, a shop behind and a price mast."""
    parts: list[Part] = [
        soft_box((-9.0, -8.0, 5.0), (9.0, 0.0, 5.9), "frame_white", radius=0.25),
        box((-9.02, -8.02, 5.25), (9.02, 0.02, 5.50), "sign_red"),
        quad([(-8.8, -7.8, 4.995), (-8.8, -0.2, 4.995), (8.8, -0.2, 4.995), (8.8, -7.8, 4.995)], "frame_white"),
    ]
    parts += [p.moved(shift(-5.5, 0.03, 5.54)) for p in letters("TANK", 0.26, "sign_red")]
    for x in (-4.5, 4.5):
        parts.append(soft_box((x - 0.6, -6.6, 0.0), (x + 0.6, -1.4, 0.16), "kerb", radius=0.4))
        for y in (-6.0, -2.0):
            parts.append(soft_box((x - 0.17, y - 0.17, 0.1), (x + 0.17, y + 0.17, 5.05), "frame_white", radius=0.05))
        for y in (-5.0, -3.2):
            parts += [
                soft_box((x - 0.28, y - 0.5, 0.16), (x + 0.28, y + 0.5, 1.75), "sign_red", radius=0.06),
                soft_box((x - 0.30, y - 0.42, 0.45), (x + 0.30, y + 0.42, 1.10), "frame_white", radius=0.03),
                box((x - 0.29, y - 0.3, 1.25), (x + 0.29, y + 0.3, 1.6), "gloss_black"),
                lathe([(0.05, 0), (0.05, 0.30), (0.001, 0.31)], "black_plastic", sides=8).moved(
                    shift(x + 0.34, y + 0.46, 0.7)
                ),
                lathe([(0.05, 0), (0.05, 0.30), (0.001, 0.31)], "black_plastic", sides=8).moved(
                    shift(x - 0.34, y + 0.46, 0.7)
                ),
            ]
    parts += [
        box((-7.0, -19.0, 0.0), (7.0, -12.0, 3.4), "plaster_white", tile_m=6),
        box((-7.2, -19.2, 3.4), (7.2, -11.4, 3.85), "frame_white"),
        box((-7.21, -19.21, 3.5), (7.21, -11.39, 3.65), "sign_red"),
    ]
    for k in range(4):
        rect = (-6.4 + 3.2 * k, -6.4 + 3.2 * k + 3.0, 0.35, 2.7)
        parts.append(flat(rect, -11.97, "shop_glass", cell_uv(np.array([k]), 4, 1)[0]))
        parts += [
            bar((u - 0.05, u + 0.05, 0.2, 2.8), -12.0, -11.92, "frame_dark") for u in (rect[0] - 0.1, rect[1] + 0.1)
        ]
    parts += [bar((-6.6, 6.6, z, z + 0.12), -12.0, -11.91, "frame_dark") for z in (0.2, 2.72)]
    return Component(
        "filling_station",
        "building",
        tuple(parts),
        "A filling station: canopy, four pumps, shop; cars drive through along X.",
    )

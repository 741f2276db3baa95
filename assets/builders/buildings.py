"""Town houses: facades with recessed windows, shops, doors, cornices and roofs.

A house stands on z = 0 with the middle of its street front at the origin; the
front looks along +Y and the house lies behind it.  Corner houses have a second
front along +X.  Lengths in metres.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from assets.builders.textures import ATLAS, FASCIA_COLUMNS, FASCIA_ROWS, SHOPS
from synfog_usd.base.seeds import stream
from synfog_usd.world.components import Component, Look
from synfog_usd.world.shapes import Array, Part, box, join, lathe, quad, quads, shift, strip, tube, turn

Rect = tuple[float, float, float, float]


@dataclass(frozen=True)
class House:
    """One house.

    Attributes:
        width: of the street front [m]; depth [m]; floors above the ground floor.
        wall, base, trim, frame: materials of walls, ground floor, cornices and window frames.
        bay: distance between windows; window: (width, height, sill above the floor) [m].
        roof: 'gable' (eaves to the street), 'mansard' or 'flat'; roofing: its material.
        shops: rows of the upper half of the fascia atlas, one shop each; none makes a ground floor of windows.
        balconies: floors (1 = first above the ground floor) that have balconies.
        surround: width of the frame of stone round each window [m], 0 for none.
        corner: a second front along +X, as long as `depth`.
    """

    name: str
    about: str
    width: float
    floors: int
    wall: str
    base: str
    trim: str
    frame: str
    bay: float = 2.6
    window: tuple[float, float, float] = (1.15, 1.75, 0.75)
    ground_height: float = 4.2
    floor_height: float = 3.25
    depth: float = 13.0
    roof: str = "gable"
    roofing: str = "roof_tile"
    shops: tuple[int, ...] = ()
    awnings: tuple[str, ...] = ()
    balconies: tuple[int, ...] = ()
    surround: float = 0.14
    corner: bool = False
    door: str = "door_green"


HOUSES = (
    House(
        "house_brick",
        "A brick house of four storeys with two shops.",
        15.6,
        3,
        "brick_red",
        "stone_dark",
        "trim_white",
        "frame_white",
        shops=(3, 1),
        awnings=("awning_green", ""),
        roofing="slate",
        roof="mansard",
        corner=False,
    ),
    House(
        "house_cream",
        "A rendered house of five storeys with balconies and a bakery.",
        13.0,
        4,
        "plaster_cream",
        "stone",
        "trim_white",
        "frame_brown",
        shops=(0,),
        awnings=("awning_red",),
        balconies=(1, 3),
        roof="mansard",
        roofing="slate",
        window=(1.2, 2.05, 0.45),
    ),
    House(
        "house_grey",
        "A sober rendered house of four storeys.",
        12.0,
        3,
        "plaster_grey",
        "plaster_grey",
        "concrete",
        "frame_dark",
        surround=0.0,
        bay=2.4,
        window=(1.45, 1.5, 0.95),
        ground_height=3.4,
        floor_height=2.95,
        roof="flat",
        door="door_blue",
    ),
    House(
        "house_ochre",
        "A narrow ochre house of three storeys with a book shop.",
        9.4,
        2,
        "plaster_ochre",
        "plaster_ochre",
        "trim",
        "frame_green",
        shops=(4,),
        awnings=("awning_cream",),
        bay=2.35,
    ),
    House(
        "house_stone",
        "A stone house of five storeys, with shops.",
        17.6,
        4,
        "stone",
        "stone_dark",
        "stone",
        "frame_dark",
        shops=(5, 2, 7),
        bay=2.95,
        window=(1.3, 2.0, 0.6),
        balconies=(1,),
        roof="mansard",
        roofing="zinc",
        floor_height=3.4,
    ),
    House(
        "house_rose",
        "A rose-coloured house of four storeys.",
        11.4,
        3,
        "plaster_rose",
        "stone",
        "trim_white",
        "frame_white",
        bay=2.75,
        ground_height=3.6,
        door="door_brown",
    ),
    House(
        "house_white",
        "A white house of the twentieth century, with strips of balconies.",
        16.0,
        4,
        "plaster_white",
        "concrete",
        "concrete",
        "frame_dark",
        surround=0.0,
        bay=3.1,
        window=(1.9, 1.55, 0.9),
        floor_height=2.9,
        ground_height=3.6,
        shops=(6,),
        balconies=(1, 2, 3, 4),
        roof="flat",
    ),
    House(
        "house_buff",
        "A house of buff brick with three storeys.",
        12.4,
        2,
        "brick_buff",
        "brick_buff",
        "trim",
        "frame_white",
        bay=2.45,
        ground_height=3.5,
        door="door_blue",
    ),
    House(
        "corner_cream",
        "A corner house of five storeys with a café and shops to both streets.",
        17.0,
        4,
        "plaster_cream",
        "stone_dark",
        "trim_white",
        "frame_white",
        depth=17.0,
        shops=(1, 2, 0),
        awnings=("awning_red", "", "awning_red"),
        roof="mansard",
        roofing="slate",
        balconies=(2,),
        corner=True,
        window=(1.2, 1.95, 0.55),
    ),
    House(
        "corner_brick",
        "A corner house of brick, four storeys, with shops to both streets.",
        16.4,
        3,
        "brick_brown",
        "stone",
        "stone",
        "frame_dark",
        depth=16.4,
        shops=(3, 5),
        awnings=("", "awning_green"),
        roof="mansard",
        roofing="zinc",
        corner=True,
    ),
    House(
        "corner_green",
        "A rendered corner house of four storeys.",
        16.0,
        3,
        "plaster_green",
        "stone",
        "trim_white",
        "frame_white",
        depth=16.0,
        shops=(6, 4, 7),
        awnings=("awning_cream", "", ""),
        roof="mansard",
        roofing="roof_tile",
        corner=True,
    ),
)


@dataclass
class _Front:
    """What one facade gathers while it is built, in its own frame: u along, n outward, z up."""

    parts: list[Part] = field(default_factory=list)
    panes: list[Array] = field(default_factory=list)  # (4, 3) corners, window atlas
    cells: list[int] = field(default_factory=list)
    displays: list[Array] = field(default_factory=list)  # (4, 3) corners, shop atlas
    rows: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class Glazing:
    """Panes of a house that can be lit: (K, 4, 3) corners and (K, 4, 2) uv of windows, and of shop windows."""

    windows: Array
    window_uv: Array
    shops: Array
    shop_uv: Array


NAMES = {
    f"s{k:02d}": Look(shifts={"fascia": (k % FASCIA_COLUMNS / FASCIA_COLUMNS, -0.5 * (k // FASCIA_COLUMNS))})
    for k in range(2 * FASCIA_COLUMNS)
}
"""Each column of the atlas, then each with its lower half: two of these share no name."""


def build_houses() -> list[Component]:
    """All of `HOUSES`; those with shops have a variant set `shops` of other names over them."""
    return [
        Component(h.name, "building", tuple(house_parts(h)[0]), h.about, variants={"shops": NAMES} if h.shops else {})
        for h in HOUSES
    ]


def glazing(house: House) -> Glazing:
    """Where the panes of a house are."""
    return house_parts(house)[1]


def build_church() -> Component:
    """A church with a spire, 46 m high, that closes a street."""
    parts = [
        box((-4, -4, 0), (4, 4, 24), "stone_dark", tile_m=3.0),
        box((-4.4, -4.4, 23.4), (4.4, 4.4, 24.2), "stone", tile_m=3.0),
    ]
    tip = (0, 0, 46.0)
    base = [(-4, -4, 24.2), (4, -4, 24.2), (4, 4, 24.2), (-4, 4, 24.2)]
    for i in range(4):
        parts.append(Part(np.array([base[i], base[(i + 1) % 4], tip]), np.array([[0, 1, 2]]), "zinc"))
    parts += [box((-8, -32, 0), (8, -4, 11), "stone_dark", tile_m=3.0)]
    parts += [
        quad(
            [(-8.5, -32, 10.8), (-8.5, -4, 10.8), (0, -4, 20), (0, -32, 20)][::-1],
            "slate",
            [(0, 0), (7, 0), (7, 3), (0, 3)],
        ),
        quad(
            [(8.5, -4, 10.8), (8.5, -32, 10.8), (0, -32, 20), (0, -4, 20)][::-1],
            "slate",
            [(0, 0), (7, 0), (7, 3), (0, 3)],
        ),
    ]
    parts += [
        Part(
            np.array([(-8, y, 11), (8, y, 11), (0, y, 20.0)]),
            np.array([[0, 1, 2]]),
            "stone_dark",
            np.array([(0, 0), (5, 0), (2.5, 3)]),
        )
        for y in (-4.02, -31.9)
    ]
    for s in (0, 90, 180, 270):
        for z in (17.5, 20.5):
            parts.append(flat((-0.9, 0.9, z, z + 2.2), 4.03, "gloss_black").moved(turn(s)))
        parts.append(
            lathe([(1.5, 0), (1.5, 0.1), (0.001, 0.1)], "frame_white", sides=20).moved(
                turn(s) @ shift(0, 4.0, 14.5) @ turn(-90, "x")
            )
        )
    parts.append(flat((-1.4, 1.4, 0, 3.6), 4.03, "door_brown"))
    return Component("church", "building", tuple(parts), "A church with a spire.")


def house_parts(house: House) -> tuple[list[Part], Glazing]:
    """The triangles of a house and its glazing."""
    rng = stream(0, "house", house.name)
    fronts = [(front_of(house, house.width, house.shops if not house.corner else house.shops[:2], rng, 0), np.eye(4))]
    if house.corner:
        place = shift(house.width / 2, -house.depth / 2, 0) @ turn(-90)
        fronts.append((front_of(house, house.depth, house.shops[1:], rng, 1), place))
    parts = [p.moved(m) for front, m in fronts for p in front.parts]
    top = house.ground_height + house.floors * house.floor_height
    x, d = house.width / 2, house.depth
    plain = [
        [(-x, 0, 0), (-x, -d, 0), (-x, -d, top), (-x, 0, top)],
        [(-x, -d, 0), (x, -d, 0), (x, -d, top), (-x, -d, top)],
    ]
    if not house.corner:
        plain.append([(x, -d, 0), (x, 0, 0), (x, 0, top), (x, -d, top)])
    tile = tile_of(house.wall)
    for corners in plain:
        length = float(np.linalg.norm(np.subtract(corners[1], corners[0])))
        parts.append(
            quad(corners, house.wall, [(0, 0), (length / tile, 0), (length / tile, top / tile), (0, top / tile)])
        )
    parts += roof_of(house, top, rng)
    corners_w = np.concatenate([place_corners(np.array(f.panes).reshape(-1, 4, 3), m) for f, m in fronts])
    cells = np.concatenate([np.array(f.cells, dtype=int) for f, m in fronts])
    corners_s = np.concatenate([place_corners(np.array(f.displays).reshape(-1, 4, 3), m) for f, m in fronts])
    rows = np.concatenate([np.array(f.rows, dtype=int) for f, m in fronts])
    glass = Glazing(corners_w, cell_uv(cells, ATLAS, ATLAS), corners_s, cell_uv(rows, SHOPS, 1))
    if len(corners_w):
        parts.append(quads(glass.windows, "window", glass.window_uv))
    if len(corners_s):
        parts.append(quads(glass.shops, "shop_glass", glass.shop_uv))
    return parts, glass


def front_of(house: House, width: float, shops: Sequence[int], rng: np.random.Generator, side: int) -> _Front:
    """One facade with its storeys; `side` 0 has the entrance."""
    front = _Front()
    half = width / 2
    w, h, sill = house.window
    bays = max(2, round((width - 1.0) / house.bay))
    step = (width - 1.0) / bays
    centres = [-half + 0.5 + step * (i + 0.5) for i in range(bays)]
    _ground_floor(house, front, half, centres, shops, rng, side)
    z0 = house.ground_height
    for floor in range(1, house.floors + 1):
        base = z0 + (floor - 1) * house.floor_height
        shrink = 1.0 if floor < house.floors or house.floors < 3 else 0.86
        balcony = floor in house.balconies
        openings = []
        for i, c in enumerate(centres):
            french = balcony and (i % 2 == 0 or house.surround == 0)
            openings.append((c - w / 2, c + w / 2, base + (0.12 if french else sill), base + sill + h * shrink))
        _wall(front, house.wall, half, base, base + house.floor_height, openings)
        for i, opening in enumerate(openings):
            _window(house, front, opening, rng)
            if house.surround:
                _surround(house, front, opening, floor)
            else:
                front.parts.append(
                    bar((opening[0] - 0.05, opening[1] + 0.05, opening[2] - 0.06, opening[2]), 0.0, 0.09, "zinc")
                )
            if balcony and (i % 2 == 0 or house.surround == 0):
                _balcony(house, front, opening, base)
        if floor in (1, house.floors) and house.surround:
            front.parts.append(
                bar((-half, half, base - 0.12, base + 0.06), 0.0, 0.11 if floor == 1 else 0.06, house.trim)
            )
    top = z0 + house.floors * house.floor_height
    if house.roof != "flat":
        for low, high, out in ((-0.55, -0.32, 0.08), (-0.32, -0.14, 0.22), (-0.14, 0.0, 0.38)):
            front.parts.append(bar((-half, half, top + low, top + high), 0.0, out, house.trim))
        if house.surround:
            for c in np.arange(-half + 0.3, half - 0.2, 0.6):
                front.parts.append(bar((c - 0.08, c + 0.08, top - 0.5, top - 0.32), 0.08, 0.2, house.trim))
        front.parts.append(
            tube([(0.03 - half, 0.42, top + 0.02), (half - 0.03, 0.42, top + 0.02)], 0.07, "downpipe", sides=6)
        )
    pipe = half - 0.22
    front.parts.append(
        tube(
            [(pipe, 0.40, top - 0.05), (pipe, 0.10, top - 0.6), (pipe, 0.10, 0.1)],
            0.05,
            "downpipe",
            sides=6,
            capped=False,
        )
    )
    return front


def _ground_floor(
    house: House,
    front: _Front,
    half: float,
    centres: list[float],
    shops: Sequence[int],
    rng: np.random.Generator,
    side: int,
) -> None:
    height = house.ground_height
    openings: list[Rect] = []
    framed: list[Rect] = []
    door_at = None
    if shops:
        entrance = 1.5 if side == 0 else 0.0
        room = (2 * half - 0.9 - entrance - 0.5) / len(shops)
        at = -half + 0.45
        for k, row in enumerate(shops):
            u0, u1 = at + 0.25, at + room - 0.25
            openings.append((u0, u1, 0.0, 3.05))
            framed.append(openings[-1])
            _shop(
                front,
                (u0, u1, 0.0, 3.05),
                row,
                house.frame if house.frame != "frame_white" else "frame_dark",
                rng,
                house.awnings[k] if k < len(house.awnings) else "",
            )
            at += room
        if entrance:
            door_at = half - 0.5 - entrance / 2 - 0.2
            openings.append((door_at - 0.6, door_at + 0.6, 0.0, 2.75))
    else:
        w, h, _sill = house.window
        door_index = len(centres) // 2
        for i, c in enumerate(centres):
            if i == door_index and side == 0:
                door_at = c
                openings.append((c - 0.65, c + 0.65, 0.0, 2.7))
            else:
                openings.append((c - w / 2, c + w / 2, 1.05, min(1.05 + h, height - 0.5)))
                _window(house, front, openings[-1], rng)
                front.parts.append(bar((c - w / 2 - 0.08, c + w / 2 + 0.08, 0.95, 1.05), 0.0, 0.1, house.trim))
    openings.sort()
    _wall(front, house.base, half, 0.0, height, openings, framed)
    trimmed = [
        (u0 - 0.14, u1 + 0.14, low, high) if door_at is not None and u0 < door_at < u1 else (u0, u1, low, high)
        for u0, u1, low, high in openings
    ]
    front.parts.append(_plinth(half, trimmed, house.base))
    if door_at is not None:
        u0, u1, z1 = (door_at - 0.6, door_at + 0.6, 2.75) if shops else (door_at - 0.65, door_at + 0.65, 2.7)
        front.parts += [
            flat((u0, u1, 0.14, z1 - 0.55), -0.30, house.door),
            flat((u0, u1, z1 - 0.5, z1), -0.30, "gloss_black"),
            bar((u0, u1, z1 - 0.55, z1 - 0.5), -0.3, -0.24, house.door),
            bar((u0, u1, 0, 0.14), -0.3, 0.05, "kerb"),
        ]
        for u in (u0 + 0.12, (u0 + u1) / 2 + 0.04):
            for z in (0.32, 1.15):
                front.parts.append(bar((u, u + 0.42, z, z + 0.68), -0.3, -0.275, house.door))
        front.parts.append(
            tube([((u0 + u1) / 2 - 0.06, -0.23, 1.0), ((u0 + u1) / 2 - 0.06, -0.23, 1.35)], 0.015, "chrome", sides=6)
        )
        front.parts += [
            bar((u0 - 0.14, u0, 0, z1 + 0.14), 0.0, 0.06, house.trim),
            bar((u1, u1 + 0.14, 0, z1 + 0.14), 0.0, 0.06, house.trim),
            bar((u0, u1, z1, z1 + 0.14), 0.0, 0.06, house.trim),
        ]


def _shop(front: _Front, opening: Rect, row: int, frame: str, rng: np.random.Generator, awning: str) -> None:
    u0, u1, _, z1 = opening
    deep = -0.22
    front.parts.append(bar((u0, u1, 0.0, 0.45), deep - 0.05, -0.10, frame))
    door_u = u0 + (u1 - u0) * (0.5 if u1 - u0 > 5 else 0.8)
    for a, b in ((u0, door_u - 0.5), (door_u + 0.5, u1)):
        if b - a < 0.4:
            continue
        front.displays.append(corners_of((a, b, 0.45, z1), deep))
        front.rows.append(int(rng.integers(0, SHOPS)))
        for u in (a, b - 0.07):
            front.parts.append(bar((u, u + 0.07, 0.45, z1), deep, deep + 0.07, frame))
        for u in np.linspace(a, b, 2 + int((b - a) / 2.4))[1:-1]:
            front.parts.append(bar((u - 0.025, u + 0.025, 0.45, z1), deep, deep + 0.06, frame))
        front.parts.append(bar((a, b, 2.35, 2.42), deep, deep + 0.06, frame))
    front.displays.append(corners_of((door_u - 0.45, door_u + 0.45, 0.1, 2.35), deep - 0.03))
    front.rows.append(int(rng.integers(0, SHOPS)))
    for u in (door_u - 0.5, door_u + 0.42):
        front.parts.append(bar((u, u + 0.08, 0.0, z1), deep - 0.03, deep + 0.08, frame))
    front.parts += [
        bar((door_u - 0.5, door_u + 0.5, 2.32, 2.42), deep - 0.03, deep + 0.08, frame),
        bar((door_u - 0.42, door_u + 0.42, 0.0, 0.22), deep - 0.03, deep + 0.03, frame),
    ]
    front.parts.append(
        tube([(door_u + 0.34, deep + 0.07, 0.9), (door_u + 0.34, deep + 0.07, 1.5)], 0.016, "chrome", sides=6)
    )
    _reveal(front, opening, deep, frame)
    board = (u0 - 0.05, u1 + 0.05, z1 + 0.02, z1 + 0.58)
    front.parts.append(bar(board, 0.0, 0.10, frame))
    low, high = 1 - (row + 1) / FASCIA_ROWS, 1 - row / FASCIA_ROWS
    middle, reach = (u0 + u1) / 2, min(2.4, (u1 - u0) / 2)
    front.parts.append(
        flat(
            (middle - reach, middle + reach, z1 + 0.04, z1 + 0.56),
            0.105,
            "fascia",
            [(0, low), (1, low), (1, high), (0, high)],
        )
    )
    if awning:
        a, b, c = (
            np.array([u0 - 0.1, 0.12, z1 + 0.04]),
            np.array([u0 - 0.1, 1.25, z1 - 0.55]),
            np.array([u0 - 0.1, 1.25, z1 - 0.80]),
        )
        across = np.array([u1 - u0 + 0.2, 0, 0])
        n = max(4, int((u1 - u0) / 0.45))
        for k in range(n):
            s, e = across * k / n, across * (k + 1) / n
            cloth = awning if k % 2 == 0 else "awning_cream" if awning != "awning_cream" else "awning_green"
            front.parts += [
                quad([b + s, b + e, a + e, a + s][::-1], cloth),
                quad([c + s, c + e, b + e, b + s][::-1], cloth),
            ]


def _wall(
    front: _Front,
    material: str,
    half: float,
    z0: float,
    z1: float,
    openings: Sequence[Rect],
    framed: Sequence[Rect] = (),
) -> None:
    """The wall of one storey round its openings, with the reveals of those that are not `framed` already."""
    cells: list[Rect] = []
    at = -half
    for u0, u1, low, high in sorted(openings):
        cells += [(at, u0, z0, z1), (u0, u1, z0, low), (u0, u1, high, z1)]
        at = u1
        if (u0, u1, low, high) not in framed:
            _reveal(front, (u0, u1, low, high), -0.22, material)
    cells.append((at, half, z0, z1))
    tile = tile_of(material)
    kept = [c for c in cells if c[1] - c[0] > 1e-6 and c[3] - c[2] > 1e-6]
    uv = [
        [(u1 / tile, a / tile), (u0 / tile, a / tile), (u0 / tile, b / tile), (u1 / tile, b / tile)]
        for u0, u1, a, b in kept
    ]
    front.parts.append(quads([corners_of(c, 0.0) for c in kept], material, uv))


def corners_of(rect: Rect, n: float) -> Array:
    """Corners of an upright rectangle that faces +Y, counter-clockwise from outside."""
    u0, u1, z0, z1 = rect
    return np.array([(u1, n, z0), (u0, n, z0), (u0, n, z1), (u1, n, z1)])


def flat(rect: Rect, n: float, material: str, uv: Sequence[tuple[float, float]] | None = None) -> Part:
    """An upright rectangle that faces +Y at y = `n`."""
    u0, u1, z0, z1 = rect
    return quad(
        corners_of(rect, n),
        material,
        uv if uv is not None else [(u1 / 6, z0 / 6), (u0 / 6, z0 / 6), (u0 / 6, z1 / 6), (u1 / 6, z1 / 6)],
    )


def bar(rect: Rect, back: float, out: float, material: str) -> Part:
    """A bar from y = `back` to `out` over an upright rectangle (x0, x1, z0, z1); one that sits on or in the wall has no
    back.
    """
    u0, u1, z0, z1 = rect
    return box((u0, back, z0), (u1, out, z1), material, tile_m=tile_of(material), back=back > 0.0)


def _reveal(front: _Front, rect: Rect, deep: float, material: str) -> None:
    u0, u1, z0, z1 = rect
    begin = 0 if z0 > 0.0 else 1  # an opening down to the ground has the ground for a sill
    loops = [np.array([(u0, n, z0), (u1, n, z0), (u1, n, z1), (u0, n, z1), (u0, n, z0)])[begin:] for n in (deep, 0.0)]
    t = tile_of(material)
    around = np.cumsum([0, u1 - u0, z1 - z0, u1 - u0, z1 - z0])[begin:] / t
    front.parts.append(strip(loops, material, uv=[np.c_[np.full(len(around), v), around] for v in (deep / t, 0.0)]))


def _window(house: House, front: _Front, opening: Rect, rng: np.random.Generator) -> None:
    u0, u1, z0, z1 = opening
    deep, bar = -0.17, 0.065
    front.panes.append(corners_of(opening, deep - 0.03))
    front.cells.append(int(rng.integers(0, ATLAS**2)))
    frame = house.frame
    rects = [
        (u0, u0 + bar, z0, z1),
        (u1 - bar, u1, z0, z1),
        (u0 + bar, u1 - bar, z0, z0 + bar),
        (u0 + bar, u1 - bar, z1 - bar, z1),
    ]
    middle = (u0 + u1) / 2
    rects.append((middle - 0.045, middle + 0.045, z0 + bar, z1 - bar))
    if house.surround:
        cross = z0 + 0.70 * (z1 - z0)
        rects += [
            (u0 + bar, middle - 0.045, cross - 0.03, cross + 0.03),
            (middle + 0.045, u1 - bar, cross - 0.03, cross + 0.03),
        ]
    corners, depth = [], 0.045
    for a, b, c, d in rects:
        corners.append(corners_of((a, b, c, d), deep + 0.015))
        if d - c > b - a:  # what lies on the wall is nobody's to see
            if a > u0:
                corners.append(
                    np.array([(a, deep - 0.03, c), (a, deep + 0.015, c), (a, deep + 0.015, d), (a, deep - 0.03, d)])
                )
            if b < u1:
                corners.append(
                    np.array(
                        [
                            (b, deep + 0.015, c),
                            (b, deep + 0.015 - depth, c),
                            (b, deep + 0.015 - depth, d),
                            (b, deep + 0.015, d),
                        ]
                    )
                )
        elif d < z1:
            corners.append(
                np.array(
                    [
                        (b, deep + 0.015 - depth, d),
                        (a, deep + 0.015 - depth, d),
                        (a, deep + 0.015, d),
                        (b, deep + 0.015, d),
                    ][::-1]
                )
            )
    front.parts.append(quads(corners, frame))


def _surround(house: House, front: _Front, opening: Rect, floor: int) -> None:
    u0, u1, z0, z1 = opening
    s = house.surround
    front.parts += [
        bar((u0 - s, u0, z0, z1), 0.0, 0.05, house.trim),
        bar((u1, u1 + s, z0, z1), 0.0, 0.05, house.trim),
        bar((u0 - s, u1 + s, z1, z1 + s * 1.3), 0.0, 0.07, house.trim),
    ]
    front.parts.append(bar((u0 - s - 0.05, u1 + s + 0.05, z0 - 0.10, z0), 0.0, 0.14, house.trim))
    if floor == 1:
        front.parts.append(
            bar((u0 - s - 0.08, u1 + s + 0.08, z1 + s * 1.3 + 0.10, z1 + s * 1.3 + 0.20), 0.0, 0.20, house.trim)
        )


def _balcony(house: House, front: _Front, opening: Rect, base: float) -> None:
    u0, u1 = opening[0] - 0.35, opening[1] + 0.35
    out = 0.85 if house.surround else 1.25
    front.parts.append(bar((u0, u1, base - 0.05, base + 0.10), 0.0, out, house.trim))
    if not house.surround:
        front.parts.append(bar((u0, u1, base + 0.10, base + 1.0), out - 0.06, out, house.wall))
        front.parts.append(tube([(u0, out - 0.03, base + 1.1), (u1, out - 0.03, base + 1.1)], 0.02, "railing", sides=5))
        return
    rail = [
        (u0, 0.0, base + 1.05),
        (u0, out - 0.05, base + 1.05),
        (u1, out - 0.05, base + 1.05),
        (u1, 0.0, base + 1.05),
    ]
    for dz in (0.0, -0.88):
        front.parts += [
            tube([np.add(a, (0, 0, dz)), np.add(b, (0, 0, dz))], 0.018, "railing", sides=4, capped=False, smooth=False)
            for a, b in itertools.pairwise(rail)
        ]
    for u in np.linspace(u0, u1, max(6, int((u1 - u0) / 0.13))):
        front.parts.append(
            tube(
                [(u, out - 0.05, base + 0.17), (u, out - 0.05, base + 1.05)],
                0.009,
                "railing",
                sides=3,
                capped=False,
                smooth=False,
            )
        )
    for n in np.linspace(0.12, out - 0.17, 5):
        for u in (u0, u1):
            front.parts.append(
                tube([(u, n, base + 0.17), (u, n, base + 1.05)], 0.009, "railing", sides=3, capped=False, smooth=False)
            )
    for u in (u0 + 0.2, u1 - 0.2):
        front.parts.append(bar((u - 0.08, u + 0.08, base - 0.38, base - 0.05), 0.0, 0.4, house.trim))


def _plinth(half: float, openings: Sequence[Rect], material: str) -> Part:
    bars = []
    at = -half
    for u0, u1, low, _ in sorted(openings):
        if low < 0.5:
            bars.append(bar((at, u0, 0.0, 0.5), 0.0, 0.05, material))
            at = u1
    bars.append(bar((at, half, 0.0, 0.5), 0.0, 0.05, material))
    return join([b for b in bars if np.ptp(b.points[:, 0]) > 0.05])


def roof_of(house: House, top: float, rng: np.random.Generator) -> list[Part]:
    """The roof of a house above `top` [m], with dormers and chimneys."""
    x, d = house.width / 2, house.depth
    parts: list[Part] = []
    if house.roof == "flat":
        parts.append(quad([(-x, -d, top), (x, -d, top), (x, 0, top), (-x, 0, top)], "roof_flat"))
        for low, high in (
            ((-x, -0.25, top), (x, 0.06, top + 0.45)),
            ((-x, -d, top), (-x + 0.25, 0, top + 0.45)),
            ((x - 0.25, -d, top), (x, 0, top + 0.45)),
            ((-x, -d, top), (x, -d + 0.25, top + 0.45)),
        ):
            parts.append(box(low, high, house.trim, tile_m=6))
        parts.append(box((-2, -d / 2 - 2, top), (2, -d / 2 + 2, top + 2.2), house.wall, tile_m=6))
        parts.append(tube([(1.2, -d / 2, top + 2.2), (1.2, -d / 2, top + 5.0)], 0.03, "galvanised", sides=5))
        return parts
    if house.roof == "gable":
        ridge = top + 0.38 * d
        slope = float(np.hypot(d / 2 + 0.4, ridge - top))
        uv = [(0, 0), (2 * x / 3.8, 0), (2 * x / 3.8, slope / 3.8), (0, slope / 3.8)]
        parts += [
            quad([(x, 0.40, top), (-x, 0.40, top), (-x, -d / 2, ridge), (x, -d / 2, ridge)], house.roofing, uv),
            quad([(-x, -d - 0.4, top), (x, -d - 0.4, top), (x, -d / 2, ridge), (-x, -d / 2, ridge)], house.roofing, uv),
        ]
        for s in (-x, x):
            end = np.array([(s, 0, top), (s, -d, top), (s, -d / 2, ridge)])
            parts.append(
                Part(end, np.array([[0, 1, 2] if s < 0 else [0, 2, 1]]), house.wall, end[:, 1:] / tile_of(house.wall))
            )
        rise = (ridge - top) / (d / 2 + 0.4)
        for u in np.linspace(-x, x, 2 + max(1, int(house.width / 4.2)))[1:-1]:
            parts += _dormer(house, u, -1.6, top + 0.85 * rise * 2.0, -1.6 - 2.6)
        chimney_z = ridge
    else:
        steep, ridge = top + 2.7, top + 4.1
        inset = 0.9
        shape = [(x, 0.30, top), (-x, 0.30, top), (-x, -d, top), (x, -d, top)]
        x1 = x - inset if house.corner else x
        upper = [(x1, 0.30 - inset, steep), (-x, 0.30 - inset, steep), (-x, -d + inset, steep), (x1, -d + inset, steep)]
        peak_x = x - 5.0 if house.corner else x
        peak = [(peak_x, -d / 2, ridge), (-x, -d / 2, ridge)]
        high = 2.85 / 3.8
        for i in (0, 2) if not house.corner else (0, 2, 3):
            a, b, c, e = shape[i], shape[(i + 1) % 4], upper[(i + 1) % 4], upper[i]
            length = float(np.linalg.norm(np.subtract(a, b))) / 3.8
            parts.append(quad([a, b, c, e], house.roofing, [(0, 0), (length, 0), (length, high), (0, high)]))
        parts += [
            quad([upper[0], upper[1], peak[1], peak[0]], "zinc"),
            quad([upper[2], upper[3], peak[0], peak[1]], "zinc"),
        ]
        if house.corner:
            parts.append(Part(np.array([upper[3], upper[0], peak[0]]), np.array([[0, 1, 2]]), "zinc"))
        for s in (-x,) if house.corner else (-x, x):
            end = np.array(
                [(s, 0.3, top), (s, 0.3 - inset, steep), (s, -d / 2, ridge), (s, -d + inset, steep), (s, -d, top)]
            )
            faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
            parts.append(Part(end, faces if s > 0 else faces[:, ::-1], house.wall, end[:, 1:] / tile_of(house.wall)))
        bays = max(2, round((house.width - 1.0) / house.bay))
        step = (house.width - 1.0) / bays
        for i in range(bays):
            if bays < 5 or i % 2 == 0:
                parts += _dormer(house, -x + 0.5 + step * (i + 0.5), 0.02, top + 0.55, -1.4)
        if house.corner:
            for v in np.linspace(-d + 2.0, -2.0, 3):
                parts += [p.moved(shift(x, v, 0) @ turn(-90)) for p in _dormer(house, 0.0, 0.02, top + 0.55, -1.4)]
        chimney_z = ridge
    for s, y in ((-x + 0.5, -d * 0.42), (x - (3.2 if house.corner else 0.5), -d * 0.60)):
        w, tall = 0.45, rng.uniform(1.2, 1.9)
        parts.append(
            box((s - w, y - 0.8, chimney_z - 2.5), (s + w, y + 0.8, chimney_z + tall - 0.1), "brick_brown", tile_m=2.4)
        )
        parts.append(
            box(
                (s - w - 0.06, y - 0.86, chimney_z + tall - 0.2),
                (s + w + 0.06, y + 0.86, chimney_z + tall),
                "concrete",
                tile_m=6,
            )
        )
        for k in (-0.5, 0.0, 0.5):
            parts.append(
                lathe([(0.13, 0), (0.11, 0.5), (0.001, 0.5)], "pot", sides=8).moved(shift(s, y + k, chimney_z + tall))
            )
    return parts


def _dormer(house: House, u: float, n: float, z: float, back: float) -> list[Part]:
    w, h = 0.62, 1.55
    parts = [
        flat(
            (u - w + 0.12, u + w - 0.12, z + 0.12, z + h - 0.1),
            n + 0.01,
            "window",
            [(0.25, 0.5), (0, 0.5), (0, 0.75), (0.25, 0.75)],
        )
    ]
    parts += [
        bar((u - w, u - w + 0.12, z, z + h), back, n + 0.05, house.frame),
        bar((u + w - 0.12, u + w, z, z + h), back, n + 0.05, house.frame),
        bar((u - w, u + w, z + h - 0.12, z + h), back, n + 0.05, house.frame),
        bar((u - w, u + w, z, z + 0.12), back, n + 0.09, house.frame),
        bar((u - 0.03, u + 0.03, z, z + h), n, n + 0.04, house.frame),
    ]
    parts.append(box((u - w - 0.12, back - 0.4, z + h), (u + w + 0.12, n + 0.2, z + h + 0.1), "zinc"))
    return parts


def tile_of(material: str) -> float:
    """Metres that one repeat of a texture covers."""
    return 2.4 if material.startswith("brick") else 3.0 if material.startswith("stone") else 6.0


def place_corners(corners: Array, matrix: Array) -> Array:
    """(..., 3) points under a (4, 4) matrix."""
    return corners @ matrix[:3, :3].T + matrix[:3, 3]


def cell_uv(cells: Array, rows: int, columns: int) -> Array:
    """(K, 4, 2) uv of atlas cells for corners in the order of `_corners`."""
    i, j = np.divmod(np.asarray(cells, dtype=int), columns)
    u0, u1 = j / columns, (j + 1) / columns
    v0, v1 = 1 - (i + 1) / rows, 1 - i / rows
    return np.stack([np.c_[u1, v0], np.c_[u0, v0], np.c_[u0, v1], np.c_[u1, v1]], axis=1).reshape(-1, 4, 2)

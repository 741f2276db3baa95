"""What stands at the crossing whatever is drawn: ground, houses, lamps and signs, trees, bicycles at the walls."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from synfog_usd.base.seeds import stream
from synfog_usd.world import library
from synfog_usd.world.roads.crossing import NORTH, TREE_X, WALL_X, WALL_Y, ground_height
from synfog_usd.world.spec import Placement, View

BUILT = {"headlights": "low_beam_led"}
VIEW = View(1.55, -37.0, 1.45, tilt=91.2, heading=1.2, focal_length=0.345, yaw=1.2, dip=1.2)
BASE_M, PARK_M = 0.115, -0.04
"""Heights on which houses stand, and the park with its church."""

# By sign of x and y: corner houses, and from each of them up the main street and along the side street.
CORNERS = {(1, 1): "corner_cream", (-1, 1): "corner_brick", (1, -1): "corner_brick", (-1, -1): "corner_green"}
MAIN_STREET = {
    (1, 1): "ochre brick rose stone buff grey cream ochre white rose brick buff cream grey stone ochre rose",
    (-1, 1): "white buff cream grey rose brick ochre stone buff cream rose white brick grey ochre buff stone",
    (1, -1): "buff cream rose stone grey",
    (-1, -1): "rose brick ochre white cream",
}
SIDE_STREET = {
    (1, 1): "grey stone rose brick",
    (-1, 1): "cream ochre brick white",
    (1, -1): "white ochre cream buff",
    (-1, -1): "buff stone grey rose",
}
BICYCLES = (
    (9.2, -26.0, 85, "red"),
    (9.15, -25.15, 84, "black"),
    (-9.1, 14.0, -95, "teal"),
    (-9.2, 14.9, -91, "red"),
    (9.1, 39.6, 92, "black"),
)
"""x, y [m], heading [degrees] and colour."""
LAMPS = (
    (1, -47.0), (-1, -33.0), (1, -19.0), (-1, -17.6), (1, 17.6), (-1, 19.0), (1, 44.0), (-1, 46.5), (1, 72.0),
    (-1, 74.0), (1, 101.0), (-1, 103.0), (1, 131.0), (-1, 162.0),
)  # fmt: skip
"""Side of the main street, and y [m]."""
LIT_Y = 80.0
"""Lamps and vehicles beyond glow only [m]."""
SIGNALS = (
    ("traffic_light_mast", 6.15, -16.2, 180, "red"),
    ("traffic_light", -6.1, 15.9, 0, "red"),
    ("traffic_light", 16.9, 4.95, -90, "green"),
    ("traffic_light", -16.9, -4.95, 90, "green"),
    ("traffic_light", -6.1, -16.0, 180, "red"),
)
FURNITURE = (
    ("sign_crossing", 6.1, -14.9, 180), ("sign_limit", 6.05, -33.2, 180), ("sign_no_stopping", 6.05, -20.4, 180),
    ("sign_priority", 6.05, -27.3, 180), ("sign_street", 7.1, -9.0, 0), ("sign_street", -7.2, 9.1, 0),
    ("sign_crossing", -6.1, 14.9, 0), ("sign_parking", -6.05, -20.8, 0), ("sign_no_entry", 6.1, 16.2, 180),
    ("sign_parking", 6.05, 20.4, 180), ("sign_limit", -6.05, 41.5, 0), ("sign_ahead", 6.05, 59.0, 180),
    ("sign_no_stopping", 6.05, 86.0, 180), ("litter_bin", 6.5, -18.0, 0), ("litter_bin", -6.5, -15.2, 0),
    ("litter_bin", 6.6, 16.8, 0), ("litter_bin", -6.6, 28.5, 0), ("bench", 6.75, -22.6, -90),
    ("bench", -6.8, 24.5, 90), ("bench", 6.8, 54.0, -90), ("cabinet", 9.45, -17.8, 90), ("cabinet", -9.45, 27.4, -90),
    ("advertising_column", -8.0, -15.5, 30),
)  # fmt: skip
STREET_TREES = {
    1: (
        -53.0, -39.0, -25.2, 25.5, 37.0, 50.5, 64.0, 80.0, 93.0, 110.0, 124.0, 140.0, 156.0, 174.0, 192.0, 212.0, 235.0,
    ),
    -1: (
        -55.0, -41.0, -28.5, 31.5, 39.0, 55.0, 66.0, 83.0, 95.0, 111.0, 126.0, 143.0, 158.0, 178.0, 196.0, 215.0, 240.0,
    ),
}  # fmt: skip
"""Side of the main street -> y of its pits [m]."""
KINDS = ("lime_tree", "maple_tree", "lime_tree", "bare_tree")


def standing(
    group: str, name: str, asset: str, place: tuple[float, float, float],
    variants: Mapping[str, str] | None = None, lit: Mapping[str, str] | None = None, *, size: float = 1.0,
) -> Placement:  # fmt: skip
    """A thing on the ground of the streets, at x, y [m] and a heading [degrees]."""
    x, y, heading = place
    return Placement(group, name, asset, x, y, heading, variants or {}, lit or {}, z=ground_height(x, y), size=size)


def ground() -> list[Placement]:
    """Road, pavements, land."""
    return [Placement("Ground", name.title(), f"street_{name}", 0, 0, z=0.0) for name in ("road", "pavement", "land")]


def houses() -> list[Placement]:
    """Both sides of both streets, corner houses first, and the church at the end."""
    sizes = library.nominal()
    width = {name: size["width_m"] for name, size in sizes.items() if "width_m" in size}
    placed: list[Placement] = []

    def put(asset: str, x: float, y: float, heading: float) -> None:
        name = f"House_{len(placed) + 1:02d}"
        placed.append(Placement("Buildings", name, asset, round(x, 3), round(y, 3), heading, z=BASE_M))

    for (sx, sy), corner in CORNERS.items():
        half = width[corner] / 2
        if sx == sy:  # its front is on the side street
            put(corner, sx * (WALL_X + half), sy * WALL_Y, 180 if sy > 0 else 0)
        else:
            put(corner, sx * WALL_X, sy * (WALL_Y + half), 90 * sx)
    for (sx, sy), names in MAIN_STREET.items():
        corner = CORNERS[sx, sy]
        y = WALL_Y + sizes[corner]["depth_m" if sx == sy else "width_m"]
        for house in (f"house_{name}" for name in names.split()):
            if y + width[house] > NORTH - 2:
                break
            put(house, sx * WALL_X, sy * (y + width[house] / 2), 90 * sx)
            y += width[house]
    for (sx, sy), names in SIDE_STREET.items():
        corner = CORNERS[sx, sy]
        x = WALL_X + sizes[corner]["width_m" if sx == sy else "depth_m"]
        for house in (f"house_{name}" for name in names.split()):
            put(house, sx * (x + width[house] / 2), sy * WALL_Y, 180 if sy > 0 else 0)
            x += width[house]
    placed.append(Placement("Buildings", "Church", "church", 6.5, NORTH + 58, 180, z=PARK_M))
    return placed


def parked_bicycles() -> list[Placement]:
    """At the walls of the houses."""
    return [
        standing("Vehicles", f"Parked_Bicycle_{i}", "bicycle", (x, y, heading), {"colour": colour})
        for i, (x, y, heading, colour) in enumerate(BICYCLES, 1)
    ]


def furniture() -> list[Placement]:
    """Lamps, lights, signs, bins, benches."""
    lamps = [
        standing(
            "Furniture",
            f"Lamp_{i:02d}",
            "street_lamp",
            (side * 6.05, y, 90 * side),
            lit={"lamps": "on" if y < LIT_Y else "glow"},
        )
        for i, (side, y) in enumerate(LAMPS, 1)
    ]
    signals = [
        standing("Furniture", f"Signal_{i}", asset, (x, y, heading), {"signal": state}, {"lamps": "on"})
        for i, (asset, x, y, heading, state) in enumerate(SIGNALS, 1)
    ]
    return [
        *lamps,
        *signals,
        *(standing("Furniture", f"{row[0].title()}_{i:02d}", row[0], row[1:]) for i, row in enumerate(FURNITURE, 1)),
    ]


def trees() -> list[Placement]:
    """Street trees in their pits, and the park at the end of the street."""
    rng, individuals = stream(0, "crossroads", "trees"), stream(0, "crossroads", "individuals")
    placed: list[Placement] = []

    def put(asset: str, x: float, y: float, z: float) -> None:
        size = round(float(rng.uniform(0.88, 1.12)), 3)
        which = {"individual": "abc"[int(individuals.integers(3))]}
        heading, name = round(float(rng.uniform(0, 360)), 1), f"Tree_{len(placed) + 1:02d}"
        placed.append(Placement("Plants", name, asset, x, y, heading, which, z=z, size=size))

    for side, ys in STREET_TREES.items():
        for y in ys:
            put(KINDS[int(rng.integers(0, 4))], side * TREE_X, y, ground_height(side * TREE_X, y))
    for k in range(26):
        x = float(np.linspace(-75, 75, 26)[k] + rng.normal(0, 1.5))
        y = NORTH + 14 + float(rng.uniform(0, 30)) + (8 if abs(x) < 14 else 0)
        if abs(x - 6.5) >= 8:
            put("park_tree", round(x, 2), round(y, 2), PARK_M)
    for k, x in enumerate((-118, -128, -140, 118, 127, 141)):
        put("park_tree", float(x), (14.0, -13.0, 18.0)[k % 3], PARK_M)
    for k, x in enumerate(np.arange(-28, 29, 8.0)):
        placed.append(Placement("Plants", f"Hedge_{k + 1}", "hedge", float(x), NORTH + 6.2, 0.0, z=PARK_M))
    return placed

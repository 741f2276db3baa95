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


def stood(
    group: str, name: str, asset: str, x: float, y: float, heading: float = 0.0,
    variants: Mapping[str, str] | None = None, lit: Mapping[str, str] | None = None,
    *, size: float = 1.0,
) -> Placement:  # fmt: skip
    """A thing on the ground of the streets."""
    return Placement(group, name, asset, x, y, heading, variants or {}, lit or {}, z=ground_height(x, y), size=size)


def ground() -> list[Placement]:
    """Road, pavements, land."""
    return [Placement("Ground", name.title(), f"street_{name}", 0, 0, z=0.0) for name in ("road", "pavement", "land")]


def houses() -> list[Placement]:
    """Both sides of both streets, corner houses first, and the church at the end."""
    width = {name: sizes["width_m"] for name, sizes in library.nominal().items() if "width_m" in sizes}
    depth = {name: sizes["depth_m"] for name, sizes in library.nominal().items() if "depth_m" in sizes}
    base = 0.115
    placed: list[Placement] = []

    def put(asset: str, x: float, y: float, heading: float) -> None:
        placed.append(
            Placement("Buildings", f"House_{len(placed) + 1:02d}", asset, round(x, 3), round(y, 3), heading, z=base)
        )

    ne, nw, se, sw = "corner_cream", "corner_brick", "corner_brick", "corner_green"
    put(ne, WALL_X + width[ne] / 2, WALL_Y, 180)
    put(nw, -WALL_X, WALL_Y + width[nw] / 2, -90)
    put(se, WALL_X, -WALL_Y - width[se] / 2, 90)
    put(sw, -WALL_X - width[sw] / 2, -WALL_Y, 0)
    rows = {
        (1, 1): [
            "house_ochre",
            "house_brick",
            "house_rose",
            "house_stone",
            "house_buff",
            "house_grey",
            "house_cream",
            "house_ochre",
            "house_white",
            "house_rose",
            "house_brick",
            "house_buff",
            "house_cream",
            "house_grey",
            "house_stone",
            "house_ochre",
            "house_rose",
        ],
        (-1, 1): [
            "house_white",
            "house_buff",
            "house_cream",
            "house_grey",
            "house_rose",
            "house_brick",
            "house_ochre",
            "house_stone",
            "house_buff",
            "house_cream",
            "house_rose",
            "house_white",
            "house_brick",
            "house_grey",
            "house_ochre",
            "house_buff",
            "house_stone",
        ],
        (1, -1): ["house_buff", "house_cream", "house_rose", "house_stone", "house_grey"],
        (-1, -1): ["house_rose", "house_brick", "house_ochre", "house_white", "house_cream"],
    }
    first = {(1, 1): depth[ne], (-1, 1): width[nw], (1, -1): width[se], (-1, -1): depth[sw]}
    for (sx, sy), names in rows.items():
        y = WALL_Y + first[sx, sy]
        for name in names:
            if y + width[name] > NORTH - 2:
                break
            put(name, sx * WALL_X, sy * (y + width[name] / 2), 90 * sx)
            y += width[name]
    side = {
        (1, 1): ["house_grey", "house_stone", "house_rose", "house_brick"],
        (-1, 1): ["house_cream", "house_ochre", "house_brick", "house_white"],
        (1, -1): ["house_white", "house_ochre", "house_cream", "house_buff"],
        (-1, -1): ["house_buff", "house_stone", "house_grey", "house_rose"],
    }
    first = {(1, 1): width[ne], (-1, 1): depth[nw], (1, -1): depth[se], (-1, -1): width[sw]}
    for (sx, sy), names in side.items():
        x = WALL_X + first[sx, sy]
        for name in names:
            put(name, sx * (x + width[name] / 2), sy * WALL_Y, 180 if sy > 0 else 0)
            x += width[name]
    placed.append(Placement("Buildings", "Church", "church", 6.5, NORTH + 58, 180, z=-0.04))
    return placed


def parked_bicycles() -> list[Placement]:
    """At the walls of the houses."""
    places = [
        (9.2, -26.0, 85, "red"),
        (9.15, -25.15, 84, "black"),
        (-9.1, 14.0, -95, "teal"),
        (-9.2, 14.9, -91, "red"),
        (9.1, 39.6, 92, "black"),
    ]
    return [
        stood("Vehicles", f"Parked_Bicycle_{i + 1}", "bicycle", x, y, heading, {"colour": colour})
        for i, (x, y, heading, colour) in enumerate(places)
    ]


def furniture() -> list[Placement]:
    """Lamps, lights, signs, bins, benches."""
    placed: list[Placement] = []
    lamps = [
        (1, -47.0),
        (-1, -33.0),
        (1, -19.0),
        (-1, -17.6),
        (1, 17.6),
        (-1, 19.0),
        (1, 44.0),
        (-1, 46.5),
        (1, 72.0),
        (-1, 74.0),
        (1, 101.0),
        (-1, 103.0),
        (1, 131.0),
        (-1, 162.0),
    ]
    for i, (s, y) in enumerate(lamps):
        placed.append(
            stood(
                "Furniture",
                f"Lamp_{i + 1:02d}",
                "street_lamp",
                s * 6.05,
                y,
                90 * s,
                {},
                {"lamps": "on" if y < 80 else "glow"},
            )
        )
    signals = [
        ("traffic_light_mast", 6.15, -16.2, 180, "red"),
        ("traffic_light", -6.1, 15.9, 0, "red"),
        ("traffic_light", 16.9, 4.95, -90, "green"),
        ("traffic_light", -16.9, -4.95, 90, "green"),
        ("traffic_light", -6.1, -16.0, 180, "red"),
    ]
    for i, (asset, x, y, heading, state) in enumerate(signals):
        placed.append(stood("Furniture", f"Signal_{i + 1}", asset, x, y, heading, {"signal": state}, {"lamps": "on"}))
    others = [
        ("sign_crossing", 6.1, -14.9, 180),
        ("sign_limit", 6.05, -33.2, 180),
        ("sign_no_stopping", 6.05, -20.4, 180),
        ("sign_priority", 6.05, -27.3, 180),
        ("sign_street", 7.1, -9.0, 0),
        ("sign_street", -7.2, 9.1, 0),
        ("sign_crossing", -6.1, 14.9, 0),
        ("sign_parking", -6.05, -20.8, 0),
        ("sign_no_entry", 6.1, 16.2, 180),
        ("sign_parking", 6.05, 20.4, 180),
        ("sign_limit", -6.05, 41.5, 0),
        ("sign_ahead", 6.05, 59.0, 180),
        ("sign_no_stopping", 6.05, 86.0, 180),
        ("litter_bin", 6.5, -18.0, 0),
        ("litter_bin", -6.5, -15.2, 0),
        ("litter_bin", 6.6, 16.8, 0),
        ("litter_bin", -6.6, 28.5, 0),
        ("bench", 6.75, -22.6, -90),
        ("bench", -6.8, 24.5, 90),
        ("bench", 6.8, 54.0, -90),
        ("cabinet", 9.45, -17.8, 90),
        ("cabinet", -9.45, 27.4, -90),
        ("advertising_column", -8.0, -15.5, 30),
    ]
    placed += [
        stood("Furniture", f"{asset.title()}_{i + 1:02d}", asset, x, y, heading)
        for i, (asset, x, y, heading) in enumerate(others)
    ]
    return placed


def trees() -> list[Placement]:
    """Street trees in their pits, and the park at the end of the street."""
    rng, individuals = stream(0, "crossroads", "trees"), stream(0, "crossroads", "individuals")
    placed: list[Placement] = []
    kinds = ("lime_tree", "maple_tree", "lime_tree", "bare_tree")

    def put(asset: str, x: float, y: float, z: float | None = None) -> None:
        size = round(float(rng.uniform(0.88, 1.12)), 3)
        which = {"individual": "abc"[int(individuals.integers(3))]}
        heading, name = round(float(rng.uniform(0, 360)), 1), f"Tree_{len(placed) + 1:02d}"
        if z is None:
            placed.append(stood("Plants", name, asset, x, y, heading, which, size=size))
        else:
            placed.append(Placement("Plants", name, asset, x, y, heading, which, z=z, size=size))

    for s, ys in (
        (
            1,
            [
                -53.0,
                -39.0,
                -25.2,
                25.5,
                37.0,
                50.5,
                64.0,
                80.0,
                93.0,
                110.0,
                124.0,
                140.0,
                156.0,
                174.0,
                192.0,
                212.0,
                235.0,
            ],
        ),
        (
            -1,
            [
                -55.0,
                -41.0,
                -28.5,
                31.5,
                39.0,
                55.0,
                66.0,
                83.0,
                95.0,
                111.0,
                126.0,
                143.0,
                158.0,
                178.0,
                196.0,
                215.0,
                240.0,
            ],
        ),
    ):
        for y in ys:
            put(kinds[int(rng.integers(0, 4))], s * TREE_X, y)
    for k in range(26):
        x = float(np.linspace(-75, 75, 26)[k] + rng.normal(0, 1.5))
        y = NORTH + 14 + float(rng.uniform(0, 30)) + (8 if abs(x) < 14 else 0)
        if abs(x - 6.5) < 8:
            continue
        put("park_tree", round(x, 2), round(y, 2), -0.04)
    for k, x in enumerate((-118, -128, -140, 118, 127, 141)):
        put("park_tree", float(x), (14.0, -13.0, 18.0)[k % 3], -0.04)
    for k, x in enumerate(np.arange(-28, 29, 8.0)):
        placed.append(Placement("Plants", f"Hedge_{k + 1}", "hedge", float(x), NORTH + 6.2, 0.0, z=-0.04))
    return placed

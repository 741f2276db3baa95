"""Lamps, traffic lights, signs, bins, bollards and benches.

Everything stands on z = 0 at the origin; what faces someone faces +Y.  Lengths
in metres, light in candela and nits.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

import numpy as np

from synfog_usd.world.components import Component, Look, MountedLamp
from synfog_usd.world.shapes import Part, box, disc, lathe, quad, shift, soft_box, strip, tube, turn

LAMP_CD = 1900.0  # 7 800 lm into a cone of 70 degrees
LAMP_TINT = (1.24, 0.96, 0.58)
LAMP_LENS_NITS = (26000.0, 20000.0, 12000.0)
SIGNAL_NITS = {"signal_red": (9000.0, 14.0, 4.0), "signal_green": (8.0, 3400.0, 1700.0)}
SIGNS = {
    "no_entry": 0,
    "limit": 1,
    "give_way": 2,
    "priority": 3,
    "crossing": 4,
    "no_stopping": 5,
    "ahead": 6,
    "parking": 7,
}


def build_furniture() -> list[Component]:
    """Everything in this module."""
    return [
        _street_lamp(),
        _traffic_light(mast=False),
        _traffic_light(mast=True),
        *(_sign(name, cell) for name, cell in SIGNS.items()),
        _street_name(),
        _bin(),
        _bollard(),
        _bench(),
        _cabinet(),
        _column(),
    ]


def _street_lamp() -> Component:
    bend = np.linspace(0, np.pi / 2, 7)
    path = [(0, 0, 0.0), (0, 0, 1.0), (0, 0, 4.0), *((0, 1.6 - 1.6 * np.cos(a), 7.0 + 0.9 * np.sin(a)) for a in bend)]
    parts = [
        tube(path, [0.085, 0.08, 0.062, *np.linspace(0.052, 0.035, 7)], "pole", sides=10),
        lathe([(0.15, 0), (0.15, 0.04), (0.11, 0.10), (0.11, 0.9), (0.08, 1.0)], "pole", sides=12),
    ]
    parts.append(soft_box((-0.15, 1.45, 7.86), (0.15, 2.15, 7.98), "pole", radius=0.06))
    parts.append(
        quad([(-0.11, 1.55, 7.855), (-0.11, 2.08, 7.855), (0.11, 2.08, 7.855), (0.11, 1.55, 7.855)], "lamp_lens")
    )
    parts.append(box((-0.06, -0.086, 0.45), (0.06, -0.07, 0.85), "galvanised"))
    glow = {"lamp_lens": {"emissiveColor": LAMP_LENS_NITS}}
    lamp = MountedLamp("Light", shift(0, 1.82, 7.80), LAMP_CD, 0.15, 70.0, 0.5, LAMP_TINT)
    variants = {"lamps": {"off": Look(), "glow": Look(materials=glow), "on": Look(materials=glow, lamps=(lamp,))}}
    return Component(
        "street_lamp",
        "pole",
        tuple(parts),
        "A street lamp of 8 m whose arm reaches forward; 'glow' shows its lens only.",
        variants,
    )


def _traffic_light(*, mast: bool) -> Component:
    height = 5.9 if mast else 3.45
    parts = [
        tube([(0, 0, 0), (0, 0, height)], [0.085, 0.07] if mast else 0.055, "pole", sides=10),
        lathe([(0.14, 0), (0.14, 0.03), (0.09, 0.05)], "pole", sides=10),
    ]
    heads = [(0.0, 2.35)]
    if mast:
        parts.append(tube([(0, 0, 5.5), (2.2, 0, 5.75), (4.6, 0, 5.8)], [0.06, 0.05, 0.04], "pole", sides=8))
        heads.append((4.3, 5.15))
    for x, z in heads:
        parts += _head(x, z)
    parts += [soft_box((-0.07, -0.12, 0.95), (0.07, 0.13, 1.2), "amber", radius=0.03)]
    dark = {"lens_top": "signal_dark", "lens_middle": "signal_dark", "lens_bottom": "signal_dark"}
    signal = {
        "red": Look(bindings={**dark, "lens_top": "signal_red"}),
        "green": Look(bindings={**dark, "lens_bottom": "signal_green"}),
    }
    lamps = {"off": Look(), "on": Look(materials={name: {"emissiveColor": nits} for name, nits in SIGNAL_NITS.items()})}
    name = "traffic_light_mast" if mast else "traffic_light"
    about = "Traffic lights on a pole" + (
        " and on an arm over the lane to the right of who looks out." if mast else "."
    )
    return Component(
        name, "traffic light", tuple(parts), about, {"signal": signal, "lamps": lamps}, labels={"pole": "pole"}
    )


def _head(x: float, z: float) -> list[Part]:
    parts = [
        soft_box((x - 0.15, 0.06, z), (x + 0.15, 0.26, z + 0.95), "signal_case", radius=0.03),
        box((x - 0.25, 0.13, z - 0.1), (x + 0.25, 0.14, z + 1.05), "signal_case"),
    ]
    parts += [
        box((x - 0.02, 0.0, z + 0.15), (x + 0.02, 0.1, z + 0.2), "signal_case"),
        box((x - 0.02, 0.0, z + 0.75), (x + 0.02, 0.1, z + 0.8), "signal_case"),
    ]
    for k, lens in enumerate(("lens_bottom", "lens_middle", "lens_top")):
        c = z + 0.175 + 0.3 * k
        parts.append(disc((0, 0, 0), 0.10, lens, sides=14).moved(shift(x, 0.268, c) @ turn(-90, "x")))
        arc = np.linspace(np.deg2rad(-20), np.deg2rad(200), 12)
        rim = np.c_[x + 0.115 * np.cos(arc), 0 * arc, c + 0.115 * np.sin(arc)]
        parts.append(strip([rim + [0, 0.26, 0], rim + [0, 0.42, -0.02]], "signal_case"))
    return parts


def _sign(name: str, cell: int) -> Component:
    i, j = divmod(cell, 3)
    u0, u1, v0, v1 = j / 3, (j + 1) / 3, 1 - (i + 1) / 3, 1 - i / 3
    r, z = 0.31, 2.55
    if name in ("no_entry", "limit", "no_stopping", "ahead"):
        a = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        outline = np.c_[np.cos(a), np.sin(a)]
    elif name == "priority":
        outline = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)], dtype=float)
    elif name == "give_way":
        outline = np.array([(0, -0.97), (0.98, 0.85), (-0.98, 0.85)], dtype=float)
    else:
        outline = np.array([(1, -1), (1, 1), (-1, 1), (-1, -1)], dtype=float)
    # seen from +Y the picture's right is -X
    face = np.c_[-r * outline[:, 0], np.full(len(outline), 0.062), z + r * outline[:, 1]]
    uv = np.c_[u0 + (outline[:, 0] * 0.985 + 1) / 2 * (u1 - u0), v0 + (outline[:, 1] * 0.985 + 1) / 2 * (v1 - v0)]
    index = np.array([(0, k, k + 1) for k in range(1, len(outline) - 1)])
    front = Part(face, index, "sign", uv)
    back = Part(face - [0, 0.012, 0], index[:, ::-1], "sign_back")
    parts = [
        front,
        back,
        tube([(0, 0, 0), (0, 0, z + 0.32)], 0.03, "galvanised", sides=8),
        box((-0.04, 0.0, z - 0.16), (0.04, 0.05, z - 0.12), "galvanised"),
        box((-0.04, 0.0, z + 0.12), (0.04, 0.05, z + 0.16), "galvanised"),
    ]
    return Component(
        f"sign_{name}",
        "traffic sign",
        tuple(parts),
        f"A traffic sign: {name.replace('_', ' ')}.",
        labels={"galvanised": "pole"},
    )


def _street_name() -> Component:
    parts = [tube([(0, 0, 0), (0, 0, 2.9)], 0.03, "galvanised", sides=8)]
    for (v0, v1), z, spin in (((1 / 3 - 1 / 12, 1 / 3), 2.72, 0.0), ((1 / 3 - 2 / 12, 1 / 3 - 1 / 12), 2.52, 90.0)):
        for flip in (0.0, 180.0):
            plate = quad(
                [
                    (0.42, 0.036, z - 0.085),
                    (-0.42, 0.036, z - 0.085),
                    (-0.42, 0.036, z + 0.085),
                    (0.42, 0.036, z + 0.085),
                ],
                "sign",
                [(2 / 3 + 0.004, v0), (1, v0), (1, v1), (2 / 3 + 0.004, v1)],
            )
            parts.append(plate.moved(turn(spin + flip)))
    return Component(
        "sign_street", "traffic sign", tuple(parts), "Street names on a pole.", labels={"galvanised": "pole"}
    )


def _bin() -> Component:
    parts = [
        lathe(
            [(0.19, 0.06), (0.21, 0.12), (0.23, 0.80), (0.20, 0.84), (0.19, 0.80), (0.17, 0.3), (0.001, 0.3)],
            "bin",
            sides=18,
        ),
        lathe([(0.001, 1.02), (0.2, 0.98), (0.24, 0.93), (0.23, 0.92)][::-1], "bin", sides=18),
    ]
    parts += [
        tube([(0.2 * np.cos(a), 0.2 * np.sin(a), 0.8), (0.2 * np.cos(a), 0.2 * np.sin(a), 0.95)], 0.012, "bin", sides=5)
        for a in (0.5, 2.6, 4.7)
    ]
    parts += [
        lathe([(0.12, 0.0), (0.1, 0.06)], "bin", sides=12),
        lathe([(0.232, 0.62), (0.236, 0.66), (0.233, 0.70)], "galvanised", sides=18),
    ]
    return Component("litter_bin", "dynamic", tuple(parts), "A litter bin.")


def _bollard() -> Component:
    parts = [
        lathe(
            [
                (0.085, 0), (0.085, 0.05), (0.06, 0.08), (0.05, 0.72), (0.062, 0.74), (0.062, 0.78), (0.05, 0.80),
                (0.055, 0.86), (0.03, 0.93), (0.001, 0.95),
            ],
            "bollard",
            sides=12,
        ),
        lathe([(0.0535, 0.60), (0.0525, 0.68)], "reflective", sides=12),
    ]  # fmt: skip
    return Component("bollard", "pole", tuple(parts), "A cast iron bollard.")


def _bench() -> Component:
    parts: list[Part] = []
    for x in (-0.75, 0.75):
        parts += [
            tube([(x, -0.28, 0.0), (x, -0.22, 0.42), (x, -0.36, 0.88)], 0.022, "green_iron", sides=6),
            tube([(x, 0.24, 0.0), (x, 0.20, 0.40), (x, -0.23, 0.40)], 0.022, "green_iron", sides=6),
        ]
        parts.append(
            tube([(x, -0.28, 0.64), (x, 0.05, 0.66), (x, 0.20, 0.62), (x, 0.20, 0.40)], 0.016, "green_iron", sides=6)
        )
    for k in range(5):
        y = -0.20 + 0.095 * k
        parts.append(box((-0.9, y, 0.425), (0.9, y + 0.075, 0.455), "timber"))
    for k in range(3):
        z = 0.54 + 0.12 * k
        y = -0.255 - 0.036 * k
        parts.append(box((-0.9, y - 0.015, z), (0.9, y + 0.015, z + 0.085), "timber"))
    return Component("bench", "static", tuple(parts), "A park bench of iron and timber.")


def _cabinet() -> Component:
    parts = [
        soft_box((-0.45, -0.18, 0.08), (0.45, 0.18, 1.15), "sign_back", radius=0.03),
        box((-0.46, -0.19, 0.0), (0.46, 0.19, 0.09), "concrete", tile_m=6),
        box((-0.004, 0.178, 0.12), (0.004, 0.184, 1.08), "seam"),
        box((-0.48, -0.21, 1.12), (0.48, 0.21, 1.18), "sign_back"),
    ]
    return Component("cabinet", "static", tuple(parts), "A cabinet of the telephone network.")


def _column() -> Component:
    parts = [
        lathe(
            [
                (0.72, 0), (0.72, 0.35), (0.66, 0.38), (0.66, 2.75), (0.78, 2.78), (0.78, 2.88), (0.55, 3.02),
                (0.30, 3.28), (0.08, 3.36), (0.001, 3.5),
            ],
            "green_iron",
            sides=28,
            crease_deg=30,
        )
    ]  # fmt: skip
    rows = [0, 3, 2, 1]
    for k in range(4):
        a = np.deg2rad(np.linspace(90 * k + 8, 90 * k + 82, 9))
        low, high = 1 - (rows[k] + 1) / 4, 1 - rows[k] / 4
        for n, (z0, z1) in enumerate(((0.55, 1.5), (1.6, 2.6))):
            loops = [np.c_[0.668 * np.cos(a), 0.668 * np.sin(a), np.full(9, z)] for z in (z0, z1)]
            material = ("shop_glass", "fascia")[(k + n) % 2]
            shown = (low, high) if material == "shop_glass" else (0.5 + low / 2, 0.5 + high / 2)
            parts.append(strip(loops, material, uv=[np.c_[np.linspace(0.1, 0.5, 9), np.full(9, v)] for v in shown]))
    return Component("advertising_column", "static", tuple(parts), "A column with posters.")

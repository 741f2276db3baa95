"""What stands beside roads: lamp masts, guard rails, fences, walls, shelters and large signs.

Everything stands on z = 0 at the origin; what faces someone faces +Y.  Pieces of
a row (guard rail, fence, wall) lie along X, middle at the origin, and join end to
end.  Lengths in metres, light in candela and nits.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

import numpy as np
import numpy.typing as npt

from synfog_usd.world.components import Component, Look, MountedLamp
from synfog_usd.world.lettering import letters
from synfog_usd.world.shapes import Part, box, disc, lathe, quad, shift, smooth_normals, soft_box, strip, tube, turn

MAST_CD = 3200.0  # 13 000 lm a head into a cone of 70 degrees
MAST_TINT = (1.05, 0.99, 0.87)  # light-emitting diodes of 4 000 K
POST_CD = 640.0  # 2 600 lm
POST_TINT = (1.13, 0.97, 0.72)  # 3 000 K
LED_LENS_NITS = (42000.0, 40000.0, 35000.0)
POST_LENS_NITS = (9000.0, 7800.0, 5800.0)
RAIL = (
    (0.055, 0.750), (0.072, 0.747), (0.083, 0.728), (0.083, 0.692), (0.070, 0.674), (0.010, 0.640), (0.002, 0.620),
    (0.002, 0.595),
)  # fmt: skip
"""Upper half of a rail of profile A, (towards the traffic, height) [m]: 310 mm high, 81 mm deep, top at 750 mm (EN 1317
systems of type ESP).
"""


def build_roadside() -> list[Component]:
    """Everything in this module."""
    return [_mast(), _post_top(), _guard_rail(), _fence(), _noise_wall(), _shelter(), _gantry(), _warning(), _chevron()]


def _lit(lens: str, nits: tuple[float, float, float], lamps: tuple[MountedLamp, ...]) -> dict[str, Look]:
    glow = {lens: {"emissiveColor": nits}}
    return {"off": Look(), "glow": Look(materials=glow), "on": Look(materials=glow, lamps=lamps)}


def _mast() -> Component:
    parts = [
        lathe([(0.20, 0), (0.20, 0.03), (0.125, 0.05)], "galvanised", sides=12),
        tube([(0, 0, 0.0), (0, 0, 1.2), (0, 0, 9.6)], [0.12, 0.115, 0.055], "galvanised", sides=12),
        box((-0.075, 0.105, 0.6), (0.075, 0.126, 1.1), "galvanised"),
        lathe([(0.075, 9.55), (0.075, 9.75), (0.03, 9.80), (0.001, 9.80)], "galvanised", sides=12),
    ]
    lamps = []
    for sign, name in ((-1, "Back"), (1, "Front")):
        parts.append(
            tube(
                [(0, 0, 9.68), (0, sign * 0.8, 9.86), (0, sign * 1.6, 9.95)], [0.04, 0.036, 0.03], "galvanised", sides=8
            )
        )
        y0, y1 = sorted((sign * 1.5, sign * 2.25))
        parts.append(soft_box((-0.16, y0, 9.92), (0.16, y1, 10.02), "pole", radius=0.05))
        parts.append(
            quad(
                [
                    (-0.12, y0 + 0.08, 9.915),
                    (-0.12, y1 - 0.04, 9.915),
                    (0.12, y1 - 0.04, 9.915),
                    (0.12, y0 + 0.08, 9.915),
                ],
                "lamp_lens_white",
            )
        )
        lamps.append(MountedLamp(name, shift(0, sign * 1.9, 9.86), MAST_CD, 0.15, 70.0, 0.5, MAST_TINT))
    variants = {"lamps": _lit("lamp_lens_white", LED_LENS_NITS, tuple(lamps))}
    return Component(
        "lamp_mast_double",
        "pole",
        tuple(parts),
        "A lamp mast of 10 m for the middle of a wide road, with an arm to each side.",
        variants,
    )


def _post_top() -> Component:
    parts = [
        lathe([(0.13, 0), (0.13, 0.02), (0.08, 0.04), (0.075, 0.95), (0.06, 1.0)], "pole", sides=12),
        tube([(0, 0, 0.9), (0, 0, 4.0)], [0.052, 0.036], "pole", sides=10),
        lathe([(0.036, 3.98), (0.11, 4.03), (0.13, 4.06), (0.11, 4.07)], "pole", sides=16),
        lathe([(0.125, 4.07), (0.20, 4.44), (0.19, 4.45)], "lamp_lens_white", sides=16),
        lathe(
            [(0.19, 4.43), (0.30, 4.45), (0.31, 4.48), (0.20, 4.55), (0.04, 4.60), (0.03, 4.66), (0.001, 4.68)],
            "pole",
            sides=20,
        ),
    ]
    parts += [
        tube([(0.135 * c, 0.135 * s, 4.05), (0.215 * c, 0.215 * s, 4.46)], 0.010, "pole", sides=5)
        for c, s in _around(4)
    ]
    # two lamps beside the post, which would shade one below the lantern
    lamps = tuple(
        MountedLamp(name, shift(0, y, 4.0), POST_CD / 2, 0.08, 78.0, 0.5, POST_TINT)
        for name, y in (("Front", 0.22), ("Back", -0.22))
    )
    variants = {"lamps": _lit("lamp_lens_white", POST_LENS_NITS, lamps)}
    return Component(
        "lamp_post_top", "pole", tuple(parts), "A lantern on a post of 4.7 m, for streets where people live.", variants
    )


def _around(count: int) -> list[tuple[float, float]]:
    return [(float(np.cos(a)), float(np.sin(a))) for a in 2 * np.pi * (np.arange(count) + 0.5) / count]


def _guard_rail() -> Component:
    half = np.array(RAIL)
    profile = np.vstack([half, (half * [1, -1] + [0, 2 * half[-1, 1]])[-2::-1]])
    loops = [np.c_[np.full(len(profile), x), profile[:, 0], profile[:, 1]] for x in (2.0, -2.0)]
    parts = [smooth_normals(strip(loops, "galvanised"), 60)]
    for x in (-1.0, 1.0):
        open_post = [(-0.05, -0.02), (-0.05, -0.145), (0.05, -0.145), (0.05, -0.02)]
        ends = [np.c_[np.array(open_post) + [x, 0], np.full(4, z)] for z in (0.0, 0.72)]
        parts.append(strip(ends, "galvanised"))
        parts += [
            box((x - 0.045, -0.055, 0.52), (x + 0.045, 0.004, 0.67), "galvanised"),
            box((x - 0.05, 0.0, 0.57), (x + 0.05, 0.009, 0.62), "galvanised"),
        ]
        parts.append(disc((0, 0, 0), 0.016, "pole", sides=8).moved(shift(x, 0.011, 0.595) @ turn(-90, "x")))
    for x in (-2.0, 2.0):  # bolts of the joint
        parts += [
            disc((0, 0, 0), 0.012, "pole", sides=6).moved(shift(x * 0.97, 0.086, z) @ turn(-90, "x"))
            for z in (0.71, 0.48)
        ]
    parts.append(box((-0.05, 0.085, 0.69), (0.05, 0.10, 0.74), "reflective"))
    about = (
        "Four metres of steel guard rail along X, whose traffic drives on the side of +Y; posts at 1 m from either end."
    )
    return Component("guard_rail", "guard rail", tuple(parts), about)


def _fence() -> Component:
    parts: list[Part] = [
        tube([(-1.25, 0, z), (1.25, 0, z)], 0.016, "green_iron", sides=6, capped=False) for z in (0.2, 1.1)
    ]
    parts.append(box((-1.28, -0.03, 0), (-1.22, 0.03, 1.32), "green_iron"))
    for x in np.arange(-1.25 + 0.125, 1.25, 0.125):
        parts.append(tube([(x, 0, 0.08), (x, 0, 1.22)], 0.009, "green_iron", sides=5, capped=False))
        parts.append(lathe([(0.009, 0), (0.017, 0.02), (0.001, 0.07)], "green_iron", sides=5).moved(shift(x, 0, 1.22)))
    parts.append(
        lathe([(0.03, 0), (0.045, 0.03), (0.03, 0.07), (0.001, 0.09)], "green_iron", sides=8).moved(
            shift(-1.25, 0, 1.32)
        )
    )
    return Component(
        "fence", "fence", tuple(parts), "Two and a half metres of iron fence along X, with its post at the end of -X."
    )


def _noise_wall() -> Component:
    parts: list[Part] = []
    for x in (-2.0, 2.0):  # half a steel post at either end
        parts += [box((x - 0.04, y - 0.006, 0), (x + 0.04, y + 0.006, 3.02), "galvanised") for y in (-0.09, 0.09)]
    parts.append(box((-1.99, -0.07, 0.0), (1.99, 0.07, 0.55), "concrete", tile_m=6))
    z, wave = np.linspace(0.55, 3.0, 50), np.arange(50) % 5
    depth = np.where((wave == 1) | (wave == 2), 0.085, 0.055)
    for sign in (-1, 1):
        loops = [np.c_[np.full(50, x), sign * depth, z] for x in (1.99 * sign, -1.99 * sign)]
        t = np.r_[0, np.cumsum(np.hypot(np.diff(depth), np.diff(z)))] / 6
        parts.append(strip(loops, "plaster_green", uv=[np.c_[np.full(50, u), t] for u in (0.0, 0.66)]))
    parts.append(box((-2.0, -0.10, 3.0), (2.0, 0.10, 3.05), "zinc"))
    return Component(
        "noise_wall",
        "wall",
        tuple(parts),
        "Four metres of noise barrier along X, 3 m high: grooved panels on a concrete plinth.",
    )


def _shelter() -> Component:
    parts: list[Part] = []
    roof = np.linspace(0, 1, 9)
    loops = [
        np.c_[np.full(9, x), -0.95 + 1.9 * roof, 2.42 + 0.16 * np.sin(np.pi * roof) + lift]
        for lift in (0.0, 0.06)
        for x in (2.1, -2.1)
    ]
    parts += [strip(loops[:2][::-1], "frame_dark"), strip(loops[2:], "frame_dark")]
    for a, b in ((loops[0], loops[2]), (loops[3], loops[1])):
        parts.append(strip([a, b], "frame_dark"))
    for y in (-0.95, 0.95):
        parts.append(box((-2.1, y - 0.05, 2.38), (2.1, y + 0.05, 2.50), "frame_dark"))
    for x in (-1.95, 0.0, 1.95):
        parts.append(box((x - 0.035, -0.885, 0.0), (x + 0.035, -0.815, 2.46), "frame_dark"))
    for x0, x1 in ((-1.91, -0.04), (0.04, 1.91)):
        parts.append(box((x0, -0.856, 0.25), (x1, -0.844, 2.25), "shelter_glass"))
        parts += [box((x0, -0.87, z), (x1, -0.83, z + 0.04), "frame_dark") for z in (0.21, 2.25)]
    for x in (-1.95, 1.95):
        parts.append(box((x - 0.035, 0.415, 0.0), (x + 0.035, 0.485, 2.46), "frame_dark"))
    parts.append(box((-1.956, -0.81, 0.25), (-1.944, 0.41, 2.25), "shelter_glass"))
    parts.append(soft_box((1.86, -0.80, 0.25), (2.04, 0.41, 2.25), "frame_dark", radius=0.03))
    for sign in (-1, 1):
        x = 1.95 + sign * 0.093
        y0, y1 = (-0.70, 0.31) if sign > 0 else (0.31, -0.70)
        parts.append(
            quad(
                [(x, y0, 0.40), (x, y1, 0.40), (x, y1, 2.10), (x, y0, 2.10)],
                "shop_glass",
                [(0.1, 0.0), (0.35, 0.0), (0.35, 0.25), (0.1, 0.25)],
            )
        )
    for x in (-1.5, 0.4):
        parts.append(box((x, -0.78, 0.0), (x + 0.05, -0.45, 0.44), "galvanised"))
    parts += [box((-1.65, y, 0.44), (0.6, y + 0.085, 0.47), "timber") for y in (-0.78, -0.68, -0.58, -0.48)]
    parts.append(box((-0.9, -0.843, 1.15), (-0.4, -0.83, 1.85), "sign_white"))
    parts.append(tube([(-2.45, 0.6, 0), (-2.45, 0.6, 2.95)], 0.035, "galvanised", sides=8))
    parts.append(box((-2.68, 0.585, 2.42), (-2.22, 0.615, 2.90), "door_green"))
    parts += [p.moved(shift(-2.45, 0.618, 2.53)) for p in letters("H", 0.26, "cloth_yellow")]
    labels = {"galvanised": "pole", "cloth_yellow": "traffic sign", "door_green": "traffic sign"}
    return Component(
        "bus_shelter",
        "building",
        tuple(parts),
        "A bus shelter of 4.2 m, open to +Y, with its stop sign beside it.",
        labels=labels,
    )


def _gantry() -> Component:
    parts: list[Part] = []
    for x in (-2.2, 2.2):
        parts += [
            tube([(x, -0.12, 0), (x, -0.12, 6.9)], 0.11, "galvanised", sides=10),
            lathe([(0.22, 0), (0.22, 0.04), (0.12, 0.08)], "galvanised", sides=10).moved(shift(x, -0.12, 0)),
        ]
    parts += [box((-2.7, -0.06, z), (2.7, -0.01, z + 0.08), "galvanised") for z in (4.15, 5.3, 6.5)]
    face = _plate(-2.8, 2.8, 3.9, 6.8)
    parts += [
        _panel(face, 0.0, "sign_white"),
        _panel(face, -0.012, "sign_back", back=True),
        _panel(_plate(-2.73, 2.73, 3.97, 6.73), 0.004, "sign_blue"),
    ]
    for row, (word, km) in enumerate((("NORDTAL", "12"), ("LUMENAU", "38"), ("HAFEN", "74"))):
        z = 5.95 - 0.68 * row
        left = letters(word, 0.36, "sign_white", align="left")
        parts += [p.moved(shift(2.35, 0.008, z)) for p in left]
        parts += [p.moved(shift(-1.75, 0.008, z)) for p in letters(km, 0.36, "sign_white", align="left")]
    parts += [p.moved(shift(-2.35, 0.008, 4.22)) for p in _arrow(0.75)]
    return Component(
        "sign_direction",
        "traffic sign",
        tuple(parts),
        "A direction sign of a motorway, 5.6 m wide, on two posts.",
        labels={"galvanised": "pole"},
    )


def _plate(x0: float, x1: float, z0: float, z1: float, r: float = 0.12) -> npt.NDArray[np.float64]:
    """(K, 2) outline of a plate with rounded corners, counter-clockwise as (x, z)."""
    a = np.linspace(0, np.pi / 2, 5)
    corners = [(x1 - r, z1 - r, 0.0), (x0 + r, z1 - r, 0.5), (x0 + r, z0 + r, 1.0), (x1 - r, z0 + r, 1.5)]
    return np.concatenate([np.c_[x + r * np.cos(a + s * np.pi), z + r * np.sin(a + s * np.pi)] for x, z, s in corners])


def _panel(outline: npt.ArrayLike, y: float, material: str, *, back: bool = False) -> Part:
    """A convex (K, 2) outline in (x, z) as a plate at `y` that faces +Y, or -Y with `back`."""
    p = np.asarray(outline, dtype=np.float64)
    faces = np.array([(0, k + 1, k) for k in range(1, len(p) - 1)])
    return Part(np.c_[p[:, 0], np.full(len(p), y), p[:, 1]], faces[:, ::-1] if back else faces, material)


def _arrow(size: float) -> list[Part]:
    shaft = [(-0.07, 0.0), (0.07, 0.0), (0.07, 0.62), (-0.07, 0.62)]
    head = [(-0.26, 0.55), (0.26, 0.55), (0.0, 1.0)]
    return [_panel(size * np.array(p), 0.0, "sign_white") for p in (shaft, head)]


def _warning() -> Component:
    def triangle(r: float) -> npt.NDArray[np.float64]:
        return np.array([(r * np.cos(a), 2.45 + r * np.sin(a)) for a in np.deg2rad([90, 210, 330])])

    parts = [
        _panel(triangle(0.52), 0.060, "sign_red"),
        _panel(triangle(0.52), 0.048, "sign_back", back=True),
        _panel(triangle(0.36), 0.063, "sign_white"),
    ]
    parts += [_panel([(-0.028, 2.40), (0.028, 2.40), (0.040, 2.64), (-0.040, 2.64)], 0.066, "sign_black")]
    parts += [_panel([(0.033 * c, 2.345 + 0.033 * s) for c, s in _around(10)], 0.066, "sign_black")]
    parts += [
        tube([(0, 0, 0), (0, 0, 2.85)], 0.03, "galvanised", sides=8),
        box((-0.04, 0.0, 2.3), (0.04, 0.05, 2.34), "galvanised"),
    ]
    return Component(
        "sign_warning", "traffic sign", tuple(parts), "A warning sign: danger ahead.", labels={"galvanised": "pole"}
    )


def _chevron() -> Component:
    parts = [
        _panel(_plate(-0.75, 0.75, 0.75, 1.25, 0.03), 0.03, "sign_white"),
        _panel(_plate(-0.75, 0.75, 0.75, 1.25, 0.03), 0.02, "sign_back", back=True),
    ]
    for x in (-0.5, 0.0, 0.5):  # seen from +Y they point to its right, which is -X
        upper = [(x + 0.10, 1.22), (x - 0.12, 1.0), (x + 0.04, 1.0), (x + 0.24, 1.22)]
        parts += [
            _panel(upper[::-1], 0.033, "sign_red", back=True),
            _panel([(u, 2.0 - z) for u, z in upper], 0.033, "sign_red", back=True),
        ]
    parts += [tube([(x, 0, 0), (x, 0, 1.3)], 0.028, "galvanised", sides=8) for x in (-0.55, 0.55)]
    return Component(
        "sign_chevron",
        "traffic sign",
        tuple(parts),
        "A chevron board at the outside of a bend to the right.",
        labels={"galvanised": "pole"},
    )

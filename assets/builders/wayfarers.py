"""More people: in a wheelchair, with a pram, at work, running, on the way to school; and riders with what they ride.

Bodies are made as those of `people`; what they push or sit in is built of tubes.
They face +Y and stand on z = 0; lengths in metres.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from assets.builders.coachwork import lamp_states
from assets.builders.hands import hands
from assets.builders.people import (
    build_bicycle,
    cut_by_role,
    dressed,
    face,
    fields_of,
    peopled,
    person_parts,
    soled,
)
from assets.builders.person import BAR, Person
from assets.builders.solids import split
from synfog_usd.world.components import Component, Look, MountedLamp
from synfog_usd.world.materials import PAINTS, PALETTE, Material
from synfog_usd.world.shapes import (
    Part,
    ball,
    box,
    disc,
    lathe,
    scale,
    shift,
    smooth_normals,
    soft_box,
    strip,
    tube,
    turn,
)

Joints = dict[str, object]

WALKERS = (
    Person(
        "woman_pram",
        "A woman who pushes a pram.",
        1.67,
        thighs=(18, -17),
        knees=(6, 14),
        arms=(26, 26),
        elbows=(52, 52),
        splay=6,
        lean=6,
        coat=0.30,
        hair="bun",
        build=0.90,
        wears={"hair": "hair_brown", "shoes": "leather_brown"},
        stride=0.9,
        holds=True,
        grips=(1.0, 1.0),
        palms=BAR,
        outfits=(
            ("cloth_teal", "denim"),
            ("cloth_beige", "cloth_black"),
            ("cloth_slate", "denim_worn", "skin_tan", "hair_dark"),
            ("cloth_black", "cloth_slate", "skin_brown", "hair_dark"),
        ),
    ),
    Person(
        "worker",
        "A road worker in high-visibility clothing.",
        1.82,
        thighs=(6, -7),
        knees=(3, 10),
        arms=(34, 20),
        elbows=(52, 74),
        splay=8,
        lean=5,
        coat=0.14,
        hair="hard hat",
        build=1.10,
        wears={"hair": "helmet_yellow", "shoes": "leather_brown"},
        carries="shovel",
        grips=(1.0, 1.0),
        others=(
            {
                "height": 1.74,
                "build": 1.2,
                "thighs": (38, 6),
                "knees": (48, 30),
                "arms": (52, 30),
                "elbows": (14, 40),
                "lean": 42,
                "turn_head": 4,
            },
            {
                "height": 1.88,
                "build": 1.02,
                "thighs": (22, -16),
                "knees": (8, 20),
                "arms": (12, 26),
                "elbows": (26, 62),
                "lean": 7,
                "turn_head": -22,
            },
            {
                "height": 1.78,
                "build": 1.12,
                "thighs": (30, -10),
                "knees": (34, 12),
                "arms": (44, 24),
                "elbows": (26, 58),
                "lean": 24,
                "turn_head": 18,
            },
        ),
        outfits=(
            ("hi_vis_orange", "hi_vis_orange"),
            ("hi_vis_yellow", "cloth_navy"),
            ("hi_vis_orange", "cloth_slate", "skin_tan", "helmet"),
            ("hi_vis_yellow", "hi_vis_yellow", "skin_brown", "helmet_yellow"),
            ("hi_vis_orange", "cloth_navy", "skin_pale", "helmet"),
        ),
    ),
    Person(
        "jogger",
        "A man who runs.",
        1.79,
        grips=(0.8, 0.8),
        thighs=(48, -26),
        knees=(62, 58),
        arms=(-38, 34),
        elbows=(88, 84),
        splay=14,
        lean=10,
        coat=0.02,
        build=0.94,
        wears={"skin": "skin_brown", "shoes": "shoe_white"},
        others=(
            {
                "height": 1.72,
                "build": 0.9,
                "thighs": (-28, 44),
                "knees": (50, 34),
                "arms": (30, -36),
                "elbows": (84, 90),
                "turn_head": 12,
            },
            {
                "height": 1.86,
                "build": 1.02,
                "thighs": (16, 12),
                "knees": (22, 96),
                "arms": (-8, 6),
                "elbows": (88, 88),
                "turn_head": -8,
            },
        ),
        outfits=(
            ("cloth_red", "cloth_black"),
            ("cloth_yellow", "cloth_navy"),
            ("cloth_slate", "cloth_black", "skin_pale", "hair_brown"),
            ("cloth_teal", "cloth_slate", "skin_tan", "hair_dark"),
        ),
    ),
    Person(
        "schoolgirl",
        "A girl of eleven on her way to school, with a satchel.",
        1.45,
        thighs=(-16, 19),
        knees=(12, 5),
        arms=(12, -14),
        elbows=(20, 12),
        lean=3,
        coat=0.18,
        hair="long",
        carries="backpack",
        build=0.86,
        wears={"hair": "hair_blond", "shoes": "shoe_white", "bag": "cloth_red"},
        stride=0.95,
        outfits=(
            ("cloth_mustard", "denim"),
            ("cloth_white", "cloth_navy"),
            ("cloth_wine", "denim_worn", "skin_brown", "hair_dark"),
            ("cloth_slate", "cloth_black", "skin_tan", "hair_dark"),
        ),
    ),
)


def build_wayfarers() -> list[Component]:
    """Everyone in this module."""
    return [*(peopled(p, _walker) for p in WALKERS), _wheelchair_user(), _cyclist(), _motorcyclist()]


def _walker(person: Person) -> list[Part]:
    parts = person_parts(person)
    if person.name == "woman_pram":
        parts += _pram(0.50)
    if person.name == "worker":
        parts = _banded(parts)
    return parts


def _banded(parts: Sequence[Part]) -> list[Part]:
    """Reflective bands of 6 cm round trunk and legs."""
    result = []
    for part in parts:
        heights = {"coat": (1.02, 1.22), "trousers": (0.34, 0.50)}.get(part.material, ())
        for z in heights:
            below, rest = split(part, part.points[:, 2] - z)
            band, above = split(rest, rest.points[:, 2] - z - 0.06)
            result.append(band.painted("reflective"))
            part = _both(below, above)
        result.append(part)
    return [p for p in result if len(p.faces)]


def _both(a: Part, b: Part) -> Part:
    if a.normals is None or b.normals is None:
        raise ValueError("both parts need normals")
    return Part(
        np.vstack([a.points, b.points]),
        np.vstack([a.faces, b.faces + len(a.points)]),
        a.material,
        None,
        np.vstack([a.normals, b.normals]),
    )


def _ring(y: float, z: float, radius: float, thick: float, material: str, x: float = 0.0, sides: int = 6) -> Part:
    """A tyre or rim that rolls along Y."""
    a = np.linspace(0, 2 * np.pi, 29)
    return tube(
        np.c_[x + 0 * a, y + radius * np.cos(a), z + radius * np.sin(a)], thick, material, sides=sides, capped=False
    )


def _spokes(x: float, y: float, z: float, radius: float, count: int) -> list[Part]:
    angles = 2 * np.pi * np.arange(count) / count
    return [
        tube(
            [(x + 0.015 * (-1) ** k, y, z), (x, y + radius * np.cos(a), z + radius * np.sin(a))],
            0.0025,
            "chrome",
            sides=3,
            capped=False,
        )
        for k, a in enumerate(angles)
    ]


def _pram(gap: float) -> list[Part]:
    """A pram whose handle is `gap` [m] before the one who pushes it."""
    parts: list[Part] = []
    for x in (-0.25, 0.25):
        for y, r in ((0.16, 0.15), (0.80, 0.125)):
            parts += [
                _ring(gap + y, r + 0.018, r, 0.018, "tyre", x),
                disc((0, 0, 0), r * 0.9, "sign_back", sides=12).moved(shift(x, gap + y, r + 0.018) @ turn(90, "y")),
            ]
        parts.append(
            tube(
                [(x, gap - 0.05, 1.00), (x, gap + 0.02, 0.98), (x, gap + 0.32, 0.58), (x, gap + 0.80, 0.14)],
                0.012,
                "chrome",
                sides=6,
            )
        )
        parts.append(tube([(x, gap + 0.62, 0.60), (x, gap + 0.16, 0.17)], 0.012, "chrome", sides=6))
    parts.append(tube([(-0.25, gap - 0.05, 1.00), (0.25, gap - 0.05, 1.00)], 0.016, "black_plastic", sides=7))
    loops, angle = [], np.linspace(0, 2 * np.pi, 17)[:-1]
    for z, half_x, half_y in ((0.52, 0.13, 0.30), (0.55, 0.19, 0.38), (0.66, 0.215, 0.42), (0.80, 0.22, 0.43)):
        loops.append(
            np.c_[
                half_x * np.cos(angle),
                gap + 0.46 + half_y * np.sign(np.sin(angle)) * np.abs(np.sin(angle)) ** 0.7,
                np.full(16, z),
            ]
        )
    parts.append(smooth_normals(strip(loops, "pram", closed=True), 50))
    parts.append(soft_box((-0.19, gap + 0.06, 0.70), (0.19, gap + 0.60, 0.82), "cloth_white", radius=0.07))
    rise = np.linspace(0, np.pi * 0.62, 9)
    hood = [
        np.c_[
            0.22 * np.cos(np.linspace(0, np.pi, 11)),
            gap + 0.60 + 0.30 * np.cos(a) * np.sin(np.linspace(0, np.pi, 11)),
            0.78 + 0.34 * np.sin(a) * np.sin(np.linspace(0, np.pi, 11)),
        ]
        for a in rise
    ]
    parts.append(smooth_normals(strip(hood, "pram"), 60))
    return parts


def _wheelchair_user() -> Component:
    joints: Joints = {
        "hips": (0.0, -0.12, 0.60), "chest": (0.0, -0.14, 0.99), "neck": (0.0, -0.11, 1.15), "head": (0.0, -0.07, 1.29),
        "shoulders": [(s * 0.178, -0.13, 1.06) for s in (-1, 1)], "elbows": [(s * 0.285, -0.24, 0.82) for s in (-1, 1)],
        "hands": [(s * 0.315, 0.0, 0.66) for s in (-1, 1)], "thighs": [(s * 0.085, -0.10, 0.575) for s in (-1, 1)],
        "knees": [(s * 0.10, 0.34, 0.585) for s in (-1, 1)], "ankles": [(s * 0.095, 0.44, 0.20) for s in (-1, 1)],
        "toes": [(s * 0.10, 0.60, 0.165) for s in (-1, 1)],
    }  # fmt: skip
    person = Person("wheelchair_user", "", 1.76, coat=0.06, hair="short", build=1.02)
    fields = fields_of(joints, person)
    parts = cut_by_role(fields, joints, (-0.50, -0.55, 0.05), (0.50, 0.85, 1.60), 7500)
    parts = [*soled(parts, joints), *face(fields, joints)]
    parts += hands(joints, (0.7, 0.7))
    for s in (-1, 1):
        x = s * 0.295
        parts += [
            _ring(-0.16, 0.305, 0.288, 0.017, "tyre", x),
            _ring(-0.16, 0.305, 0.255, 0.010, "chrome", s * 0.335, 5),
            *_spokes(x, -0.16, 0.305, 0.28, 12),
        ]
        parts += [
            disc((0, 0, 0), 0.035, "black_plastic", sides=10).moved(shift(s * 0.32, -0.16, 0.305) @ turn(90 * s, "y"))
        ]
        parts += [
            _ring(0.33, 0.085, 0.070, 0.015, "tyre", s * 0.22),
            tube([(s * 0.22, 0.33, 0.085), (s * 0.22, 0.30, 0.22), (s * 0.20, 0.28, 0.46)], 0.012, "frame", sides=6),
        ]
        rail = [
            (s * 0.22, -0.42, 0.96),
            (s * 0.22, -0.33, 0.93),
            (s * 0.22, -0.30, 0.47),
            (s * 0.22, 0.26, 0.49),
            (s * 0.20, 0.38, 0.40),
            (s * 0.13, 0.46, 0.12),
        ]
        parts.append(tube(rail, 0.013, "frame", sides=7))
        parts.append(
            tube([(s * 0.22, -0.30, 0.47), (s * 0.24, -0.16, 0.305), (s * 0.22, 0.26, 0.49)], 0.011, "frame", sides=6)
        )
        parts.append(box((s * 0.255 - 0.02, -0.26, 0.70), (s * 0.255 + 0.02, 0.02, 0.725), "black_plastic"))
        parts.append(box((s * 0.245 - 0.004, -0.28, 0.47), (s * 0.245 + 0.004, 0.10, 0.70), "seat"))
        parts.append(box((s * 0.095 - 0.055, 0.40, 0.105), (s * 0.095 + 0.055, 0.62, 0.118), "black_plastic"))
    parts += [
        soft_box((-0.21, -0.30, 0.45), (0.21, 0.26, 0.51), "seat", radius=0.03),
        soft_box((-0.21, -0.335, 0.52), (0.21, -0.29, 0.92), "seat", radius=0.01),
    ]
    wears = {"hair": "hair_dark", "shoes": "shoe_white"}
    about = "A man who drives himself in a wheelchair."
    return dressed(
        "wheelchair_user",
        "person",
        about,
        parts,
        wears,
        (("cloth_navy", "denim"), ("cloth_green", "cloth_grey")),
        {"frame": Material((0.03, 0.03, 0.035), 0.3, clearcoat=0.7), "seat": PALETTE["cloth_black"]},
    )


CYCLIST: Joints = {
    "hips": (0.0, -0.24, 0.99),
    "chest": (0.0, 0.12, 1.28),
    "neck": (0.0, 0.23, 1.40),
    "head": (0.0, 0.31, 1.53),
    "shoulders": [(s * 0.165, 0.15, 1.31) for s in (-1, 1)],
    "elbows": [(s * 0.235, 0.27, 1.14) for s in (-1, 1)],
    "hands": [(s * 0.235, 0.38, 1.045) for s in (-1, 1)],
    "thighs": [(s * 0.085, -0.23, 0.96) for s in (-1, 1)],
    "knees": [(-0.10, 0.20, 0.86), (0.10, 0.12, 0.68)],
    "ankles": [(-0.11, -0.10, 0.50), (0.11, -0.12, 0.22)],
    "toes": [(-0.11, 0.06, 0.45), (0.11, 0.04, 0.145)],
}
"""Joints of who rides the sporty bicycle [m]."""


def _cyclist() -> Component:
    """Somebody on a sporty bicycle, bent forward; rider and bicycle in one."""
    machine = build_bicycle()
    joints = CYCLIST
    mirror = scale(-1, 1, 1)  # so that the left pedal is up
    fields = fields_of(joints, Person("cyclist", "", 1.70, coat=0.02, hair="helmet", build=0.88))
    parts = [
        *soled(cut_by_role(fields, joints, (-0.45, -0.6, 0.0), (0.45, 0.75, 1.85), 7500), joints),
        *face(fields, joints),
        *hands(joints, (1.0, 1.0), BAR),
        *(p.moved(mirror) for p in machine.parts),
    ]
    wears = {"hair": "helmet", "shoes": "shoe_white"}
    looks = (("cloth_teal", "cloth_black"), ("cloth_red", "cloth_navy"))
    component = dressed(
        "cyclist",
        "rider",
        "A woman on a bicycle, both in one.",
        parts,
        wears,
        looks,
        {"frame": Material((0.30, 0.02, 0.02), 0.3, clearcoat=0.7)},
    )
    names = ("frame", "chrome", "black_plastic", "tyre", "tail_lamp")
    return replace(component, labels=dict.fromkeys(names, "bicycle"))


def _motorcyclist() -> Component:
    """Somebody on a motorcycle; rider and machine in one, with lamps to choose."""
    joints: Joints = {
        "hips": (0.0, -0.28, 0.90),
        "chest": (0.0, -0.06, 1.24),
        "neck": (0.0, 0.02, 1.38),
        "head": (0.0, 0.09, 1.52),
        "shoulders": [(s * 0.185, -0.03, 1.29) for s in (-1, 1)],
        "elbows": [(s * 0.315, 0.15, 1.10) for s in (-1, 1)],
        "hands": [(s * 0.31, 0.39, 1.00) for s in (-1, 1)],
        "thighs": [(s * 0.10, -0.26, 0.86) for s in (-1, 1)],
        "knees": [(s * 0.205, 0.13, 0.76) for s in (-1, 1)],
        "ankles": [(s * 0.18, -0.16, 0.42) for s in (-1, 1)],
        "toes": [(s * 0.19, 0.02, 0.36) for s in (-1, 1)],
    }
    fields = fields_of(joints, Person("motorcyclist", "", 1.80, coat=0.06, hair="helmet", build=1.12))
    parts = cut_by_role(fields, joints, (-0.50, -0.65, 0.20), (0.50, 0.65, 1.85), 7500)
    parts += [glove.painted("shoes") for glove in hands(joints, (1.0, 1.0), BAR)]
    head = np.asarray(joints["head"], dtype=np.float64)
    parts.append(ball(head + [0, 0.0, 0.02], (0.128, 0.155, 0.150), "hair", sides=18))
    visor = [
        np.c_[0.131 * np.sin(a), head[1] + 0.158 * np.cos(a), np.full(9, z)]
        for z in (head[2] - 0.015, head[2] + 0.065)
        for a in (np.linspace(-1.15, 1.15, 9),)
    ]
    parts.append(smooth_normals(strip(visor, "gloss_black"), 60))
    parts += _motorcycle()
    lens = (0.0, 0.735, 0.84)
    lamp = MountedLamp("Head", shift(lens[0], lens[1] + 0.05, lens[2]) @ turn(90, "x"), beam="low_beam_halogen")
    wears = {"hair": "helmet", "shoes": "leather_black"}
    component = dressed(
        "motorcyclist",
        "rider",
        "Somebody on a motorcycle, both in one.",
        parts,
        wears,
        (("cloth_black", "leather_black"), ("cloth_grey", "cloth_black"), ("cloth_red", "cloth_black")),
    )
    paint = {name: Look(materials={"paint": {"diffuseColor": PAINTS[name]}}) for name in ("red", "black", "blue")}
    machine = (
        "paint", "tyre", "rim", "chrome", "black_plastic", "engine", "brake", "headlamp", "headlamp_lens",
        "tail_lamp", "tail_lens", "plate_blank",
    )  # fmt: skip
    return replace(
        component,
        variants={**component.variants, "paint": paint, "lamps": lamp_states((lamp,))},
        labels=dict.fromkeys(machine, "motorcycle"),
    )


def _motorcycle() -> list[Part]:
    rear, front, r = -0.72, 0.72, 0.31
    parts: list[Part] = []
    for y, wide in ((rear, 0.075), (front, 0.058)):
        parts.append(_ring(y, r, r - wide, wide, "tyre", sides=9))
        parts.append(_ring(y, r, 0.20, 0.016, "rim"))
        parts += [
            tube([(0, y, r), (0, y + 0.2 * np.cos(a), r + 0.2 * np.sin(a))], 0.013, "rim", sides=5)
            for a in 2 * np.pi * np.arange(5) / 5 + 0.3
        ]
        parts += [disc((0, 0, 0), 0.14, "brake", sides=20).moved(shift(0.055, y, r) @ turn(90, "y"))]
        guard = np.linspace(0.35, np.pi - 0.45, 9) if y > 0 else np.linspace(0.75, np.pi - 0.15, 9)
        loops = [
            np.c_[np.full(9, x), y + (r + 0.03) * np.cos(guard), r + (r + 0.03) * np.sin(guard) - (0.02 if x else 0)]
            for x in (-0.075, 0.0, 0.075)
        ]
        parts.append(smooth_normals(strip(loops, "paint" if y > 0 else "black_plastic"), 60))
    for s in (-1, 1):
        parts += [
            tube(
                [(s * 0.095, front, r), (s * 0.095, front - 0.13, 0.62), (s * 0.095, front - 0.24, 0.92)],
                [0.027, 0.027, 0.022],
                "chrome",
                sides=8,
            )
        ]
        parts += [tube([(s * 0.10, -0.18, 0.36), (s * 0.10, rear, r)], 0.026, "black_plastic", sides=6)]
        parts += [tube([(s * 0.11, -0.62, 0.36), (s * 0.10, -0.50, 0.76)], 0.026, "chrome", sides=7)]
        parts += [
            tube(
                [(0, 0.46, 0.955), (s * 0.15, 0.46, 1.00), (s * 0.30, 0.41, 1.00), (s * 0.40, 0.37, 0.99)],
                0.014,
                "black_plastic",
                sides=6,
            )
        ]
        parts += [
            tube([(s * 0.24, 0.44, 1.00), (s * 0.29, 0.45, 1.15)], 0.007, "black_plastic", sides=5),
            soft_box((s * 0.29 - 0.07, 0.43, 1.13), (s * 0.29 + 0.07, 0.455, 1.21), "black_plastic", radius=0.02),
        ]
        parts += [box((s * 0.20 - 0.06, -0.10, 0.325), (s * 0.20 + 0.06, -0.06, 0.35), "black_plastic")]
    parts += [
        ball((0, 0.10, 0.80), (0.155, 0.30, 0.135), "paint", sides=18),
        soft_box((-0.14, -0.62, 0.755), (0.14, -0.10, 0.825), "black_plastic", radius=0.06),
        ball((0, -0.72, 0.79), (0.10, 0.24, 0.065), "paint", sides=14),
        soft_box((-0.15, -0.16, 0.28), (0.15, 0.26, 0.56), "engine", radius=0.05),
        lathe(
            [
                (0.075, 0), (0.085, 0.02), (0.075, 0.04), (0.085, 0.06), (0.075, 0.08), (0.085, 0.10), (0.075, 0.12),
                (0.07, 0.20),
            ],
            "engine",
            sides=14,
        ).moved(shift(0, 0.14, 0.52) @ turn(-18, "x")),
        tube(
            [(0.10, 0.24, 0.50), (0.13, 0.30, 0.36), (0.13, 0.15, 0.24), (0.14, -0.35, 0.26)], 0.022, "chrome", sides=7
        ),
        tube([(0.15, -0.30, 0.27), (0.16, -0.90, 0.40)], [0.04, 0.05], "chrome", sides=9),
        tube([(0, 0.45, 0.90), (0, 0.05, 0.62), (0, -0.18, 0.40)], 0.035, "black_plastic", sides=7),
        tube([(0, 0.10, 0.72), (0, -0.45, 0.74), (0, -0.85, 0.76)], 0.03, "black_plastic", sides=6),
        ball((0, 0.62, 0.84), (0.115, 0.115, 0.115), "black_plastic", sides=16),
        lathe([(0.098, 0), (0.10, 0.012), (0.001, 0.03)], "headlamp", sides=16).moved(
            shift(0, 0.70, 0.84) @ turn(-90, "x")
        ),
        disc((0, 0, 0), 0.056, "headlamp_lens", sides=14).moved(shift(0, 0.735, 0.84) @ turn(-90, "x")),
        soft_box((-0.07, -0.96, 0.735), (0.07, -0.90, 0.845), "tail_lamp", radius=0.02),
        disc((0, 0, 0), 0.05, "tail_lens", sides=10).moved(shift(0, -0.965, 0.79) @ turn(90, "x")),
        box((-0.10, -0.99, 0.50), (0.10, -0.985, 0.66), "plate_blank"),
        tube([(0, -0.86, 0.74), (0, -0.98, 0.62)], 0.02, "black_plastic", sides=5),
    ]  # fmt: skip
    return parts

"""People on foot, and a cyclist with a bicycle.

A person is limbs and blobs that blend where they touch; what is skin, hair,
coat, trousers or shoe is cut along the line where one lies nearer than the
others.  They face +Y and stand on z = 0; lengths in metres.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from assets.builders import clothes
from assets.builders.hands import hands
from assets.builders.person import BAR, Person, Point, kind_of, pose
from assets.builders.solids import blob_distance, limb_distance, soft_max, soft_min, split, surface
from synfog_usd.world.components import Component, Look
from synfog_usd.world.materials import PALETTE, Material
from synfog_usd.world.shapes import (
    Array,
    Part,
    box,
    join,
    lathe,
    scale,
    shift,
    smooth_normals,
    soft_box,
    strip,
    tube,
    turn,
)

PEOPLE = (
    Person(
        "man_walking",
        "A man who walks, in a short coat.",
        1.80,
        thighs=(24, -20),
        knees=(6, 14),
        arms=(-20, 22),
        elbows=(14, 24),
        lean=3,
        open=True,
        coat=0.26,
        wears={"hair": "hair_brown", "shoes": "leather_brown"},
        stride=1.0,
        outfits=(
            ("cloth_navy", "denim"),
            ("cloth_grey", "cloth_black", "skin", "hair_dark", "leather_black"),
            ("cloth_green", "cloth_khaki"),
            ("cloth_black", "cloth_slate", "skin_brown", "hair_dark", "shoe_white"),
            ("cloth_camel", "cloth_navy", "skin_pale", "hair_grey"),
            ("cloth_slate", "denim_worn", "skin_tan", "hair_dark", "shoe_white"),
        ),
    ),
    Person(
        "woman_walking",
        "A woman who walks, in a long coat, with a handbag.",
        1.68,
        thighs=(-17, 21),
        knees=(16, 5),
        arms=(16, -14),
        elbows=(20, 10),
        lean=2,
        open=True,
        coat=0.42,
        hair="long",
        carries="handbag",
        grips=(0.1, 1.0),
        build=0.88,
        wears={"hair": "hair_blond", "shoes": "leather_black", "bag": "leather_brown"},
        stride=0.95,
        outfits=(
            ("cloth_beige", "cloth_black"),
            ("cloth_wine", "cloth_black", "skin", "hair_dark"),
            ("cloth_grey", "denim", "skin_pale", "hair_brown"),
            ("cloth_black", "denim_worn", "skin_brown", "hair_dark"),
            ("cloth_camel", "cloth_slate", "skin_tan", "hair_dark"),
            ("cloth_navy", "cloth_black", "skin_pale", "hair_grey"),
        ),
    ),
    Person(
        "man_waiting",
        "A man who waits.",
        1.77,
        thighs=(2, -3),
        knees=(2, 6),
        arms=(-9, -9),
        elbows=(38, 38),
        splay=15,
        turn_head=25,
        coat=0.10,
        grips=(0.35, 0.5),
        wears={"hair": "hair_dark", "shoes": "shoe_white"},
        others=(
            {"height": 1.84, "build": 0.94, "thighs": (-4, 7), "knees": (2, 15), "turn_head": -35, "elbows": (38, 22)},
            {
                "height": 1.71,
                "build": 1.14,
                "thighs": (5, 0),
                "knees": (4, 2),
                "turn_head": 5,
                "arms": (24, 24),
                "elbows": (92, 96),
                "splay": 6,
            },
        ),
        outfits=(
            ("cloth_teal", "denim"),
            ("cloth_black", "cloth_grey"),
            ("cloth_slate", "cloth_khaki", "skin_pale", "hair_brown"),
            ("cloth_wine", "denim_worn", "skin_brown", "hair_dark"),
            ("cloth_navy", "cloth_black", "skin_tan", "hair_dark", "leather_black"),
        ),
    ),
    Person(
        "woman_phone",
        "A woman who stands and looks at her telephone.",
        1.66,
        thighs=(1, -2),
        knees=(3, 8),
        arms=(18, 2),
        elbows=(105, 14),
        turn_head=-8,
        coat=0.14,
        hair="bun",
        carries="phone",
        grips=(0.6, 0.1),
        build=0.88,
        wears={"hair": "hair_dark", "shoes": "shoe_white"},
        others=(
            {"height": 1.72, "build": 0.84, "thighs": (-3, 6), "knees": (2, 14), "turn_head": 4, "elbows": (112, 30)},
            {
                "height": 1.60,
                "build": 0.97,
                "thighs": (3, 1),
                "knees": (5, 3),
                "turn_head": -20,
                "arms": (24, -6),
                "elbows": (98, 20),
            },
        ),
        outfits=(
            ("cloth_red", "denim"),
            ("cloth_mustard", "cloth_black"),
            ("cloth_slate", "denim_worn", "skin_pale", "hair_blond"),
            ("cloth_black", "cloth_black", "skin_brown", "hair_dark"),
            ("cloth_green", "cloth_khaki", "skin_tan", "hair_brown"),
        ),
    ),
    Person(
        "student",
        "A student who walks with a backpack.",
        1.78,
        thighs=(-22, 25),
        knees=(12, 7),
        arms=(18, -18),
        elbows=(22, 18),
        lean=5,
        coat=0.10,
        carries="backpack",
        wears={"skin": "skin_brown", "hair": "hair_dark", "shoes": "shoe_white", "bag": "cloth_navy"},
        stride=1.05,
        outfits=(
            ("cloth_mustard", "denim"),
            ("cloth_white", "cloth_black"),
            ("cloth_slate", "denim_worn", "skin", "hair_brown"),
            ("cloth_black", "cloth_khaki", "skin_tan", "hair_dark"),
            ("cloth_wine", "cloth_navy", "skin_pale", "hair_blond"),
        ),
    ),
    Person(
        "child",
        "A child of eight who walks.",
        1.28,
        thighs=(20, -18),
        knees=(6, 20),
        arms=(-24, 20),
        elbows=(18, 26),
        lean=3,
        coat=0.10,
        hair="cap",
        build=0.98,
        wears={"hair": "cloth_red", "shoes": "shoe_white"},
        stride=0.95,
        outfits=(
            ("cloth_teal", "cloth_grey"),
            ("cloth_yellow", "denim"),
            ("cloth_red", "denim_worn", "skin_brown", "cloth_navy"),
            ("cloth_green", "cloth_khaki", "skin_tan", "cloth_mustard"),
        ),
    ),
    Person(
        "old_man",
        "An old man who walks slowly with an umbrella.",
        1.70,
        thighs=(13, -12),
        knees=(8, 12),
        arms=(-8, 12),
        elbows=(14, 26),
        lean=8,
        open=True,
        coat=0.40,
        hair="cap",
        carries="umbrella",
        grips=(0.15, 1.0),
        build=1.1,
        wears={"hair": "cloth_grey", "shoes": "leather_black", "bag": "cloth_black"},
        stride=0.6,
        outfits=(
            ("cloth_green", "cloth_grey"),
            ("cloth_beige", "cloth_black"),
            ("cloth_slate", "cloth_khaki", "skin_pale", "cloth_navy"),
            ("cloth_camel", "cloth_slate", "skin_brown", "cloth_black"),
        ),
    ),
)

ROLES = {
    "skin": "skin",
    "hair": "hair_dark",
    "coat": "cloth_black",
    "trousers": "denim",
    "shoes": "leather_black",
    "bag": "leather_black",
    "strap": "cloth_black",
    "shirt": "cloth_white",
    "line": "seam",
    "sole": "shoe_sole",
}


HEAD_TRIANGLES = 2200
"""Of a person's head and neck, without the eyes."""
SHADE = 0.3
"""How bright a seam is beside its coat: what lies between two edges of cloth sees little of the sky."""
WORN = ("coat", "trousers", "skin", "hair", "shoes")
"""What an outfit names, in this order."""


def build_people() -> list[Component]:
    """Everyone in `PEOPLE`, each with outfits to choose, and others of the kind."""
    return [peopled(person, person_parts) for person in PEOPLE]


def peopled(person: Person, parts: Callable[[Person], list[Part]]) -> Component:
    """A component of somebody in several outfits, with others of the kind as its individuals."""
    made = [dressed(person.name, "person", one.about, parts(one), one.wears, one.outfits) for one in kind_of(person)]
    return replace(made[0], individuals=dict(zip("bcdefg", made[1:], strict=False)))


RIDER = {
    "hips": (0.0, -0.22, 0.99),
    "chest": (0.0, 0.08, 1.38),
    "neck": (0.0, 0.15, 1.52),
    "head": (0.0, 0.21, 1.665),
    "shoulders": [(s * 0.18, 0.10, 1.43) for s in (-1, 1)],
    "elbows": [(s * 0.27, 0.24, 1.20) for s in (-1, 1)],
    "hands": [(s * 0.24, 0.40, 1.05) for s in (-1, 1)],
    "thighs": [(s * 0.085, -0.22, 0.96) for s in (-1, 1)],
    "knees": [(-0.10, 0.12, 0.68), (0.10, 0.20, 0.86)],
    "ankles": [(-0.11, -0.12, 0.22), (0.11, -0.10, 0.50)],
    "toes": [(-0.11, 0.04, 0.145), (0.11, 0.06, 0.45)],
}
"""Joints of who rides the bicycle [m]."""


def build_rider() -> Component:
    """Who rides the bicycle of `build_bicycle`: place both at the same point."""
    joints = RIDER
    fields = fields_of(joints, Person("rider", "", 1.78, coat=0.06, hair="helmet"))
    parts = cut_by_role(fields, joints, (-0.45, -0.6, 0.0), (0.45, 0.65, 1.95), 8000)
    parts = [*soled(parts, joints), *face(fields, joints)]
    parts += hands(joints, (1.0, 1.0), BAR)
    wears = {"hair": "helmet", "shoes": "shoe_white"}
    return dressed(
        "rider",
        "rider",
        "Who rides the bicycle.",
        parts,
        wears,
        (("cloth_yellow", "cloth_black"), ("cloth_red", "denim")),
    )


def build_bicycle() -> Component:
    """A city bicycle, without its rider."""
    rear, front, crank, seat, head = (
        (0, -0.50, 0.345),
        (0, 0.56, 0.345),
        (0, -0.06, 0.29),
        (0, -0.21, 0.80),
        (0, 0.36, 0.78),
    )
    low_head = (0, 0.395, 0.66)
    bars = [
        (crank, seat, 0.016),
        (seat, head, 0.016),
        (crank, low_head, 0.019),
        (low_head, (0, 0.34, 0.86), 0.019),
        (low_head, front, 0.013),
    ]
    parts: list[Part] = [tube([a, b], r, "frame", sides=8) for a, b, r in bars]
    for s in (-1, 1):
        parts += [
            tube([(0.02 * s, *crank[1:]), (0.055 * s, *rear[1:])], 0.009, "frame", sides=6),
            tube([(0.02 * s, *seat[1:]), (0.055 * s, *rear[1:])], 0.008, "frame", sides=6),
        ]
        pedal_z = 0.29 - s * -0.155
        parts += [
            tube([(0.06 * s, -0.06, 0.29), (0.07 * s, -0.07, pedal_z)], 0.01, "chrome", sides=6),
            box(
                (0.11 * s - 0.045, -0.11, pedal_z - 0.012), (0.11 * s + 0.045, -0.02, pedal_z + 0.012), "black_plastic"
            ),
        ]
        parts.append(
            tube(
                [(0, 0.335, 1.0), (s * 0.12, 0.35, 1.02), (s * 0.24, 0.39, 1.02), (s * 0.28, 0.33, 1.015)],
                0.012,
                "black_plastic",
                sides=6,
            )
        )
    parts += [
        tube([(0, 0.345, 0.85), (0, 0.335, 1.0)], 0.013, "chrome", sides=6),
        tube([seat, (0, -0.235, 0.92)], 0.013, "chrome", sides=6),
    ]
    parts += [soft_box((-0.075, -0.37, 0.90), (0.075, -0.12, 0.955), "black_plastic", radius=0.03)]
    for y in (rear[1], front[1]):
        ring = np.linspace(0, 2 * np.pi, 33)
        parts.append(
            tube(
                np.c_[0 * ring, y + 0.323 * np.cos(ring), 0.345 + 0.323 * np.sin(ring)],
                0.022,
                "tyre",
                sides=6,
                capped=False,
            )
        )
        parts.append(
            tube(
                np.c_[0 * ring, y + 0.298 * np.cos(ring), 0.345 + 0.298 * np.sin(ring)],
                0.011,
                "chrome",
                sides=5,
                capped=False,
            )
        )
        for k in range(14):
            a = 2 * np.pi * k / 14
            parts.append(
                tube(
                    [(0.02 * (-1) ** k, y, 0.345), (0, y + 0.3 * np.cos(a), 0.345 + 0.3 * np.sin(a))],
                    0.0022,
                    "chrome",
                    sides=3,
                    capped=False,
                )
            )
        guard = np.linspace(0.2, np.pi - 0.3, 12)
        parts.append(
            tube(
                np.c_[0 * guard, y + 0.36 * np.cos(guard), 0.345 + 0.36 * np.sin(guard)],
                0.014,
                "black_plastic",
                sides=5,
            )
        )
    parts += [
        box((-0.06, -0.80, 0.745), (0.06, -0.36, 0.757), "black_plastic"),
        box((-0.03, -0.86, 0.70), (0.03, -0.84, 0.75), "tail_lamp"),
    ]
    parts += [
        lathe([(0.001, 0), (0.035, 0.005), (0.03, 0.05)], "chrome", sides=10).moved(shift(0, 0.43, 0.9) @ turn(90, "x"))
    ]
    parts = [p.moved(shift(0, 0, -_lowest(parts))) for p in parts]
    looks = {
        name: Look(materials={"frame": {"diffuseColor": PALETTE[cloth].colour}})
        for name, cloth in (("teal", "cloth_teal"), ("black", "cloth_black"), ("red", "cloth_red"))
    }
    return Component(
        "bicycle",
        "bicycle",
        tuple(parts),
        "A city bicycle.",
        {"colour": looks},
        {"frame": Material(roughness=0.3, clearcoat=0.7)},
    )


def dressed(
    name: str,
    label: str,
    about: str,
    parts: list[Part],
    wears: Mapping[str, str],
    outfits: tuple[tuple[str, ...], ...],
    own: Mapping[str, Material] | None = None,
) -> Component:
    """A component of somebody in several outfits, each of coat and trousers, and perhaps skin, hair and shoes (`WORN`);
    `own` are materials beside the roles.
    """
    roles = {**ROLES, **wears}
    looks = {
        "abcdefgh"[i]: Look(
            materials={
                role: {"diffuseColor": PALETTE[cloth].colour}
                for role, cloth in zip(WORN, (*outfit, *(roles[role] for role in WORN[len(outfit) :])), strict=True)
            }
            | {"line": {"diffuseColor": tuple(round(SHADE * c, 4) for c in PALETTE[outfit[0]].colour)}}
        )
        for i, outfit in enumerate(outfits)
    }
    materials = {role: PALETTE[cloth] for role, cloth in roles.items()} | dict(own or {})
    return Component(name, label, tuple(parts), about, {"outfit": looks}, materials)


def person_parts(person: Person) -> list[Part]:
    """The triangles of somebody, feet on the ground, one part for each role."""
    joints = pose(person)
    fields = fields_of(joints, person)
    parts = cut_by_role(fields, joints, (-0.62, -0.75, -0.15), (0.62, 0.95, 1.95), 11000)
    parts = [
        *soled(clothes.opened(parts, joints, person), joints),
        *clothes.sewn(joints, person),
        *face(fields, joints),
    ]
    parts += hands(joints, person.grips, person.palms)
    if person.carries == "backpack":
        parts += clothes.backpack(joints, person)
    if person.carries == "phone":
        parts.append(
            box((-0.04, -0.004, -0.075), (0.04, 0.006, 0.075), "bag").moved(
                shift(joints["hands"][0][0], joints["hands"][0][1] + 0.05, joints["hands"][0][2] + 0.07)
                @ turn(-25, "x")
            )
        )
    if person.carries == "handbag":
        hand = joints["hands"][1]
        parts.append(
            soft_box((-0.05, -0.15, -0.52), (0.05, 0.15, -0.26), "bag", radius=0.03).moved(
                shift(hand[0] + 0.04, hand[1], hand[2] + 0.08)
            )
        )
        parts.append(
            tube(
                [
                    (hand[0] + 0.04, hand[1] - 0.11, hand[2] - 0.18),
                    (hand[0] + 0.02, hand[1], hand[2]),
                    (hand[0] + 0.04, hand[1] + 0.11, hand[2] - 0.18),
                ],
                0.008,
                "bag",
                sides=5,
            )
        )
    if person.carries == "umbrella":
        hand = joints["hands"][1]
        parts.append(
            tube(
                [(hand[0], hand[1], hand[2] + 0.06), (hand[0] + 0.01, hand[1] + 0.04, 0.02)],
                [0.03, 0.012],
                "bag",
                sides=7,
            )
        )
    if person.carries == "shovel":
        parts += _shovel(
            *(np.asarray(hand) for hand in joints["hands"]), low=min(a[2] for a in joints["ankles"]) - 0.05
        )
    low, high = _lowest(parts), max(float(p.points[:, 2].max()) for p in parts)
    factor = person.height / (high - low)
    return [p.moved(scale(factor, factor, factor) @ shift(0, 0, -low)) for p in parts]


def _shovel(front: Array, back: Array, *, low: float) -> list[Part]:
    """A shovel of 1.2 m held in two hands; its blade is no lower than the soles."""
    along = (front - back) / np.linalg.norm(front - back)
    along = along + [0.0, 0.05, -1.3]
    along /= np.linalg.norm(along)
    end = back - 0.12 * along
    length = min(1.15, max((end[2] - low - 0.02) / max(-along[2], 1e-3) - 0.27, 0.5))
    tip = end + length * along
    side = np.cross(along, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    hollow = np.outer([0.0, -0.012, -0.018, -0.012, 0.0], np.cross(side, along))
    loops = [
        tip + 0.27 * share * along + np.outer(np.linspace(-half, half, 5), side) + hollow
        for share, half in ((0.0, 0.10), (0.6, 0.11), (1.0, 0.04))
    ]
    return [
        tube([end, tip + 0.05 * along], 0.016, "bag", sides=7),
        tube([end - 0.06 * side, end + 0.06 * side], 0.015, "bag", sides=6),
        smooth_normals(strip(loops, "bag"), 60),
    ]


def fields_of(joints: Mapping, person: Person) -> dict[str, Callable[[Array, Array, Array], Array]]:
    """Signed distances of somebody in a pose, by role."""
    hips, chest, neck, head = (np.asarray(joints[k]) for k in ("hips", "chest", "neck", "head"))
    up = (chest - hips) / np.linalg.norm(chest - hips)
    facing = turn(joints.get("turn", 0.0))[:3, :3] @ np.array([0.0, 1.0, 0.0])
    across = np.array([facing[1], -facing[0], 0.0])
    slim = 0.9 if person.build < 0.95 else 1.0  # jaw and neck

    def skin(x: Array, y: Array, z: Array) -> Array:
        def at(ahead: float, aside: float, high: float) -> Array:
            return head + ahead * facing + aside * across + [0, 0, high]

        d = blob_distance(x, y, z, at(0, 0, 0.005), (0.073, 0.092, 0.108))
        d = soft_min(d, blob_distance(x, y, z, at(0.055, 0, -0.06), (0.042 * slim, 0.046, 0.050)), 0.05)
        for side in (-1, 1):  # brows, cheekbones, jaw and ears
            brow = limb_distance(x, y, z, at(0.084, 0.012 * side, 0.031), at(0.066, 0.050 * side, 0.028), 0.010, 0.009)
            d = soft_min(d, brow, 0.016)
            d = soft_min(d, blob_distance(x, y, z, at(0.048, 0.041 * side, -0.022), (0.028,) * 3), 0.03)
            jaw = at(0.008, 0.050 * slim * side, -0.050)
            d = soft_min(d, limb_distance(x, y, z, jaw, at(0.074, 0.010 * side, -0.102), 0.014, 0.014), 0.028)
            socket = blob_distance(x, y, z, at(0.098, 0.032 * side, 0.012), (0.019, 0.019, 0.013))
            d = soft_max(d, -socket, 0.012)
        d = soft_min(d, limb_distance(x, y, z, at(0.084, 0, 0.018), at(0.106, 0, -0.022), 0.008, 0.0105), 0.012)
        for side in (-1, 1):
            d = soft_min(d, blob_distance(x, y, z, at(0.094, 0.012 * side, -0.026), (0.009, 0.010, 0.008)), 0.008)
            ear = limb_distance(
                x, y, z, at(-0.018, 0.078 * side, 0.016), at(-0.010, 0.073 * side, -0.022), 0.0125, 0.008
            )
            d = soft_min(d, ear, 0.008)
        for high, deep in ((-0.053, 0.0075), (-0.066, 0.0085)):  # lips
            lip = limb_distance(x, y, z, at(0.090, -0.014, high), at(0.090, 0.014, high), deep, deep)
            d = soft_min(d, lip, 0.010)
        d = soft_min(d, blob_distance(x, y, z, at(0.082, 0, -0.100), (0.019, 0.015, 0.015)), 0.020)
        d = soft_min(
            d, limb_distance(x, y, z, neck - 0.06 * up, head - [0, 0.01, 0.05], 0.054 * slim, 0.050 * slim), 0.03
        )
        for hand, elbow in zip(joints["hands"], joints["elbows"], strict=True):  # as far as `hands` begin
            along = (np.asarray(hand) - elbow) / np.linalg.norm(np.asarray(hand) - elbow)
            d = np.minimum(d, limb_distance(x, y, z, hand, np.asarray(hand) + 0.035 * along, 0.027, 0.025))
        return d

    def hair(x: Array, y: Array, z: Array) -> Array:
        back = -facing
        if person.hair == "hard hat":
            d = blob_distance(x, y, z, head + 0.012 * back + [0, 0, 0.03], (0.099, 0.118, 0.108))
            d = np.maximum(d, -(z - head[2] - 0.03))
            brim = blob_distance(x, y, z, head + 0.012 * facing + [0, 0, 0.036], (0.114, 0.146, 0.011))
            return soft_min(d, brim, 0.012)
        if person.hair == "helmet":
            d = blob_distance(x, y, z, head + 0.02 * back + [0, 0, 0.06], (0.102, 0.135, 0.088))
            return np.maximum(d, -(z - head[2] - 0.02))
        d = blob_distance(x, y, z, head + 0.024 * back + [0, 0, 0.034], (0.085, 0.098, 0.099))
        aside = (x - head[0]) * across[0] + (y - head[1]) * across[
            1
        ]  # locks, from the crown to the front and the sides
        ahead = (x - head[0]) * facing[0] + (y - head[1]) * facing[1]
        d = d + 0.0030 * np.sin(210 * aside + 70 * ahead + 2 * np.sin(60 * (z - head[2])))
        d = d + 0.0022 * np.sin(330 * aside - 120 * ahead + 90 * (z - head[2]))
        if person.hair == "long":
            d = soft_min(
                d, limb_distance(x, y, z, head + 0.05 * back, head + 0.075 * back - [0, 0, 0.20], 0.075, 0.06), 0.05
            )
        if person.hair == "bun":
            d = soft_min(d, blob_distance(x, y, z, head + 0.105 * back + [0, 0, 0.07], (0.045, 0.04, 0.042)), 0.02)
        if person.hair == "cap":
            d = np.maximum(blob_distance(x, y, z, head + [0, 0, 0.035], (0.088, 0.105, 0.096)), -(z - head[2] - 0.025))
            d = soft_min(d, blob_distance(x, y, z, head + 0.1 * facing + [0, 0, 0.035], (0.06, 0.05, 0.012)), 0.015)
        return d

    def shoes(x: Array, y: Array, z: Array) -> Array:
        d = np.full(np.shape(x), 1e3)
        for a, t in zip(joints["ankles"], joints["toes"], strict=True):
            heel, sole = _sole(a, t)
            foot = soft_min(
                limb_distance(x, y, z, heel, t, 0.042, 0.038),
                limb_distance(x, y, z, a, np.asarray(a) - [0, 0, 0.04], 0.042, 0.042),
                0.03,
            )
            below = (heel[0] - x) * sole[0] + (heel[1] - y) * sole[1] + (heel[2] - z) * sole[2] - 0.032
            d = np.minimum(d, soft_max(foot, below, 0.012))
        return d

    return {
        "skin": skin,
        "hair": hair,
        "coat": clothes.coat(joints, person),
        "trousers": clothes.trousers(joints, person),
        "shoes": shoes,
    }


def _sole(ankle: npt.ArrayLike, toe: npt.ArrayLike) -> tuple[Array, Array]:
    """The middle of a heel, and which way is up from its sole."""
    a, t = np.asarray(ankle, dtype=np.float64), np.asarray(toe, dtype=np.float64)
    heel = a + 0.25 * (a - t) * [1, 1, 0] - [0, 0, 0.035]
    up = np.cross([1.0, 0.0, 0.0], t - heel)
    return heel, up / np.linalg.norm(up)


def soled(parts: list[Part], joints: Mapping) -> list[Part]:
    """The parts, with soles of 2 cm below the shoes."""
    made = []
    for part in parts:
        if part.material != "shoes":
            made.append(part)
            continue
        height = np.full(len(part.points), np.inf)
        nearest = height.copy()
        for a, t in zip(joints["ankles"], joints["toes"], strict=True):
            heel, up = _sole(a, t)
            away = np.linalg.norm(part.points - 0.5 * (heel + t), axis=1)
            height = np.where(away < nearest, (part.points - heel) @ up + 0.014, height)
            nearest = np.minimum(away, nearest)
        below, above = split(part, height)
        made += [below.painted("sole"), above]
    return made


def cut_by_role(
    fields: Mapping[str, Callable[[Array, Array, Array], Array]],
    joints: Mapping,
    low: Point,
    high: Point,
    triangles: int,
) -> list[Part]:
    """The surface round all roles within a box, cut where one lies nearer than the others; HEAD_TRIANGLES of it are the
    head, which has a finer grid.
    """

    def whole(x: Array, y: Array, z: Array) -> Array:
        d = None
        for f in fields.values():
            d = f(x, y, z) if d is None else soft_min(d, f(x, y, z), 0.012)
        assert d is not None
        return d

    head = np.asarray(joints["head"], dtype=np.float64)
    neck_z = float(head[2]) - 0.125
    body = surface(
        whole,
        low,
        (high[0], high[1], neck_z + 0.04),
        step=0.010,
        triangles=triangles - HEAD_TRIANGLES,
        material="coat",
        coarse=4,
    )
    top = surface(
        whole,
        (head[0] - 0.17, head[1] - 0.21, neck_z - 0.02),
        (head[0] + 0.17, head[1] + 0.21, high[2]),
        step=0.006,
        triangles=HEAD_TRIANGLES,
        material="coat",
        coarse=4,
    )
    rest = join([split(body, body.points[:, 2] - neck_z)[0], split(top, top.points[:, 2] - neck_z)[1]])
    parts = []
    roles = list(fields)
    for i, role in enumerate(roles[:-1]):
        others = [fields[r] for r in roles[i + 1 :]]
        p = rest.points.T
        mine, rest = split(rest, fields[role](*p) - np.minimum.reduce([f(*p) for f in others]))
        parts.append(mine.painted(role))
    parts.append(rest.painted(roles[-1]))
    return [p for p in parts if len(p.faces)]


def face(fields: Mapping[str, Callable[[Array, Array, Array], Array]], joints: Mapping) -> list[Part]:
    """Eyes, brows and mouth, which lie on the skin."""
    to_face = turn(joints.get("turn", 0.0))[:3, :3]
    head = np.asarray(joints["head"], dtype=np.float64)
    reach = np.linspace(0.03, 0.16, 400)

    def on_skin(across: float, up: float, lift: float) -> Array:
        start = head + to_face @ np.array([across, 0.0, up])
        ray = start + reach[:, None] * (to_face @ np.array([0.0, 1.0, 0.0]))
        outside = np.nonzero(np.minimum(fields["skin"](*ray.T), fields["hair"](*ray.T)) > 0)[0]
        return np.asarray(start + (reach[outside[0]] + lift) * (to_face @ np.array([0.0, 1.0, 0.0])))

    def oval(across: float, up: float, half: tuple[float, float], lift: float, material: str) -> Part:
        angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
        rim = np.array([on_skin(across + half[0] * np.cos(a), up + half[1] * np.sin(a), lift) for a in angle])
        return Part(
            np.vstack([rim, on_skin(across, up, lift)]), np.array([((i + 1) % 8, i, 8) for i in range(8)]), material
        )

    def band(points: list[tuple[float, float]], thick: float, material: str, lift: float = 0.0015) -> Part:
        taper = [0.35, *[1.0] * (len(points) - 2), 0.35]
        loops = [
            np.array([on_skin(x, z + side * k * thick, lift) for (x, z), k in zip(points, taper, strict=True)])
            for side in (-0.5, 0.5)
        ]
        return strip(loops, material)

    parts = [band([(-0.024, -0.0585), (-0.009, -0.0590), (0.009, -0.0590), (0.024, -0.0585)], 0.013, "lips")]
    parts.append(band([(-0.024, -0.0590), (0.0, -0.0585), (0.024, -0.0590)], 0.0022, "eye_dark", 0.0025))
    for s in (-1, 1):
        parts.append(oval(s * 0.0315, 0.011, (0.0125, 0.0044), 0.0015, "eye_white"))
        parts.append(oval(s * 0.0315, 0.0115, (0.0052, 0.0048), 0.0030, "eye_dark"))
        lid = [(s * 0.0450, 0.0120), (s * 0.0315, 0.0160), (s * 0.0185, 0.0130)][::s]
        parts.append(band(lid, 0.0022, "eye_dark", 0.0025))
        brow = [(s * 0.050, 0.0305), (s * 0.034, 0.0375), (s * 0.014, 0.0335)][::s]
        parts.append(band(brow, 0.0070, "eye_dark", 0.0025))
    return parts


def _lowest(parts: list[Part]) -> float:
    return min(float(p.points[:, 2].min()) for p in parts)

"""Limbs of people as meshes of their own, cut out of the meshes of their model's materials.

Where two limbs meet, both have the cloth around the joint, so that none gapes when they turn.  Takes a layer of meshes
and the joints; gives each limb with its joint, and what is left.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.world.shapes import Part
from synfog_usd.world.traffic.cutting import read_part, subset
from synfog_usd.world.traffic.gait import LEG_M, SIDES, Skeleton, skeleton

COAT, LEGS, FEET, HANDS = ("coat", "line"), ("trousers",), ("shoes", "sole"), ("skin",)
"""Materials of which limbs have parts."""
ROUND_M = 0.055
"""Cloth that both limbs have, to each side of a joint."""
SLEEVE_M, HAND_M = 0.085, 0.09
"""Within which a sleeve is around the bones of its arm, and a hand around theirs."""
HAND_LENGTH_M = 0.16
ABOVE_M, MIDDLE_M = 0.06, 0.04
"""By which the two halves of a coat below the hips reach above them, and over the middle."""
SEAT_M = 0.09
"""By which a thigh reaches above the hip, and the seat below it."""


@dataclass(frozen=True)
class Limb:
    """A limb of a model.

    Attributes:
        name: of its prim, as 'Thigh_Left'.
        above: name of the limb that it hangs on, '' for the trunk.
        joint: about which it turns, in the model's axes [m].
        parts: by material, in the model's axes.
    """

    name: str
    above: str
    joint: tuple[float, float, float]
    parts: Mapping[str, Part]


@dataclass(frozen=True)
class Limbs:
    """All limbs of a model that move, the upper ones first; `rest` as of `Wheels`."""

    limbs: tuple[Limb, ...]
    rest: Mapping[str, Part | None]


@functools.cache
def limbs_of(geometry: Path, asset: str, individual: str) -> Limbs | None:
    """The limbs in a layer of meshes; None where the model's joints are not known or the file is not there."""
    bones = skeleton(asset, individual)
    layer = Sdf.Layer.FindOrOpen(str(geometry)) if bones and geometry.exists() else None
    if bones is None or layer is None:
        return None
    result: dict[str, dict[str, Part]] = {}
    rest: dict[str, Part | None] = {}
    for name in (*COAT, *LEGS, *FEET, *HANDS):
        part = read_part(layer, name)
        if part is None:
            continue
        owners = _owners(name, part, bones)
        for limb, faces in owners.items():
            if limb and faces.any():
                result.setdefault(limb, {})[name] = subset(part, faces)
        rest[name] = subset(part, owners[""]) if owners[""].any() else None
    joints = {"Thigh": bones.hips, "Shin": bones.knees, "Foot": bones.ankles, "Arm": bones.shoulders,
              "Forearm": bones.elbows, "Skirt": bones.hips}  # fmt: skip
    limbs = []
    for side, suffix in enumerate(SIDES):
        for limb, above in (
            ("Thigh", ""),
            ("Shin", "Thigh"),
            ("Foot", "Shin"),
            ("Arm", ""),
            ("Forearm", "Arm"),
            ("Skirt", ""),
        ):
            x, y, z = (round(float(v), 5) for v in joints[limb][side])
            if bones.swings[side] or "rm" not in limb:
                upper = f"{above}_{suffix}" if above else ""
                limbs.append(Limb(f"{limb}_{suffix}", upper, (x, y, z), result.get(f"{limb}_{suffix}", {})))
    return Limbs(tuple(limbs), rest)


def _owners(material: str, part: Part, bones: Skeleton) -> dict[str, Flags]:
    """Which faces each limb has, '' for the trunk."""
    centres = part.points[part.faces].mean(axis=1)
    normals = part.normals[part.faces].mean(axis=1) if part.normals is not None else np.zeros_like(centres)
    if material in FEET:
        return _of_feet(centres, bones)
    if material in LEGS:
        return _of_legs(centres, bones)
    owners = _of_arms(centres, normals, bones, hands=material in HANDS)
    if material in COAT:
        rest = owners[""]
        above = ABOVE_M * _size(bones)
        hip = float(bones.hips[:, 2].mean())
        skirt = rest & (centres[:, 2] < hip + above)
        middle = MIDDLE_M * _size(bones)
        owners["Skirt_Left"], owners["Skirt_Right"] = (skirt & (centres[:, 0] * sign < middle) for sign in (1.0, -1.0))
        owners[""] = rest & (centres[:, 2] > hip - ROUND_M * _size(bones))
    return owners


def _size(bones: Skeleton) -> float:
    """Size over that of an adult of 1.73 m."""
    lengths = np.linalg.norm(bones.knees - bones.hips, axis=1) + np.linalg.norm(bones.ankles - bones.knees, axis=1)
    return float(lengths.mean()) / LEG_M


def _away(points: Array, begin: Array, end: Array) -> tuple[Array, Array]:
    """From the nearest place of a bone to (N, 3) points [m]: their distance, and the way there."""
    along = end - begin
    share = np.clip((points - begin) @ along / (along @ along), 0.0, 1.0)
    way = points - begin - share[:, None] * along
    return np.linalg.norm(way, axis=1), way


def _of_feet(centres: Array, bones: Skeleton) -> dict[str, Flags]:
    """All of a shoe goes with its foot."""
    away = [_away(centres, bones.ankles[side], bones.toes[side])[0] for side in (0, 1)]
    near = away[0] <= away[1]
    return {"": np.zeros(len(centres), dtype=bool), "Foot_Left": near, "Foot_Right": ~near}


def _of_legs(centres: Array, bones: Skeleton) -> dict[str, Flags]:
    size = _size(bones)
    distance = [
        np.minimum(
            _away(centres, bones.hips[side], bones.knees[side])[0],
            _away(centres, bones.knees[side], bones.ankles[side])[0],
        )
        for side in (0, 1)
    ]
    mine = distance[0] <= distance[1]
    owners: dict[str, Flags] = {"": np.zeros(len(centres), dtype=bool)}
    for side, suffix in enumerate(SIDES):
        hip, knee, ankle = bones.hips[side], bones.knees[side], bones.ankles[side]
        on_side = mine if side == 0 else ~mine
        thigh, shin = (knee - hip) / np.linalg.norm(knee - hip), (ankle - knee) / np.linalg.norm(ankle - knee)
        from_hip = (centres - hip) @ thigh
        from_knee = (centres - knee) @ (thigh + shin) / np.linalg.norm(thigh + shin)
        owners[f"Thigh_{suffix}"] = on_side & (from_hip > -SEAT_M * size) & (from_knee < ROUND_M * size)
        owners[f"Shin_{suffix}"] = on_side & (from_knee > -ROUND_M * size)
        owners[""] |= on_side & (from_hip < SEAT_M * size)
    return owners


def _of_arms(centres: Array, normals: Array, bones: Skeleton, *, hands: bool) -> dict[str, Flags]:
    """Sleeves look away from the bones of their arm; what does not belongs to the trunk."""
    size = _size(bones)
    sleeves = np.zeros(len(centres), dtype=bool)
    shoulder_too = np.zeros(len(centres), dtype=bool)
    owners: dict[str, Flags] = {}
    for side, suffix in enumerate(SIDES):
        if not bones.swings[side]:
            continue
        shoulder, elbow, hand = bones.shoulders[side], bones.elbows[side], bones.hands[side]
        fore = (hand - elbow) / np.linalg.norm(hand - elbow)
        upper = (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
        from_elbow = (centres - elbow) @ (upper + fore) / np.linalg.norm(upper + fore)
        if hands:
            near = _away(centres, hand, hand + HAND_LENGTH_M * size * fore)[0] < HAND_M * size
            near &= np.linalg.norm(centres - shoulder, axis=1) > 0.22 * size
            owners[f"Forearm_{suffix}"] = near
            sleeves |= near
            continue
        lower_away, lower = _away(centres, elbow, hand + 0.03 * size * fore)
        upper_away, high = _away(centres, shoulder, elbow)
        outward = np.where((upper_away < lower_away)[:, None], high, lower)
        away = np.minimum(upper_away, lower_away)
        looks = (outward * normals).sum(axis=1) > 0.3 * away
        around = np.linalg.norm(centres - shoulder, axis=1) < SLEEVE_M * size
        on_arm = (away < SLEEVE_M * size) & (looks | (lower_away < 0.6 * SLEEVE_M * size))
        owners[f"Arm_{suffix}"] = (on_arm | around) & (from_elbow < ROUND_M * size)
        owners[f"Forearm_{suffix}"] = on_arm & (from_elbow > -ROUND_M * size)
        sleeves |= on_arm & ~around
        shoulder_too |= around
    owners[""] = ~sleeves | shoulder_too
    return owners

"""What a person is to the builders: size, pose, gait and clothes by name; others of the kind; where its joints are.

They face +Y and stand on z = 0; lengths in metres.
"""

# ruff: noqa: RUF005 -- offsets are added to arrays, which only look like lists
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from synfog_usd.world.shapes import Array, turn

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Person:
    """One person.  Angles in degrees, forward positive.

    Attributes:
        height: [m].
        thighs, knees: angle of each thigh and bend of each knee (left, right).
        arms, elbows: angle of each upper arm and bend of each elbow.
        splay: how far the arms stand off the body.
        lean: of the trunk; turn_head: to the left.
        coat: length of the coat below the hip [m]; open: whether it shows the shirt at the neck;
        hair: 'short', 'long', 'bun', 'cap', 'helmet', 'hard hat'.
        carries: 'backpack', 'handbag', 'phone', 'umbrella', 'shovel' or ''.
        wears: material by role; outfits: names of cloths for coat and trousers, one pair per variant.
        build: breadth of the trunk relative to average.
        stride: length of the steps of who walks relative to average, 0 for who does not; others of the kind are at
            other moments of the step (`GAIT`).
        holds: whether the arms keep still while walking.
        grips: how far each hand is closed, from 0 to 1 (a fist).
        palms: where both palms look; None for towards the body.
        others: what differs in each other of the kind that does not walk.
    """

    name: str
    about: str
    height: float
    thighs: tuple[float, float] = (0, 0)
    knees: tuple[float, float] = (3, 3)
    arms: tuple[float, float] = (2, 2)
    elbows: tuple[float, float] = (12, 12)
    splay: float = 9
    lean: float = 0
    turn_head: float = 0
    coat: float = 0.08
    open: bool = False
    hair: str = "short"
    carries: str = ""
    build: float = 1.0
    stride: float = 0.0
    holds: bool = False
    grips: tuple[float, float] = (0.05, 0.2)
    palms: Point | None = None
    others: tuple[Mapping[str, object], ...] = ()
    wears: Mapping[str, str] = field(default_factory=dict)
    outfits: tuple[tuple[str, ...], ...] = (("cloth_black", "denim"),)


GAIT = (
    (0.0, 28, 4), (0.1, 25, 15), (0.2, 17, 14), (0.3, 7, 8), (0.4, -3, 5), (0.5, -11, 9), (0.6, -8, 36),
    (0.7, 9, 59), (0.8, 24, 52), (0.9, 31, 20), (1.0, 28, 4),
)  # fmt: skip
"""Share of a stride from where the heel strikes, angle of the thigh and bend of the knee [degrees]: a free walk,
rounded from Perry, Gait Analysis (1992).
"""
OTHERS = ((0.12, 1.03, 0.92, 9.0), (0.31, 0.97, 1.09, -16.0), (0.72, 1.0, 1.0, 24.0))
"""Who else walks of a kind: where in the stride, height and breadth over the first's, turn of the head."""
BAR = (0.0, -0.3, -1.0)
"""Where palms look that hold a bar across."""
SWING, HANG = 0.75, -3.0
"""Of an arm over the thigh of the other side, and its middle [degrees]."""


def kind_of(person: Person) -> list[Person]:
    """Somebody, and others of the same kind: who walk at other moments of the step, or do what `others` says."""
    if person.stride:
        return [person, *(_walking(person, *other) for other in OTHERS)]
    return [person, *(replace(person, **other) for other in person.others)]  # type: ignore[arg-type]


def _walking(person: Person, phase: float, taller: float, broader: float, turned: float) -> Person:
    """Somebody of the kind whose left heel struck so long ago."""
    at, thigh, knee = np.array(GAIT).T
    moments = (phase, (phase + 0.5) % 1.0)
    thighs = [person.stride * float(np.interp(m, at, thigh)) for m in moments]
    knees = [4 + person.stride * (float(np.interp(m, at, knee)) - 4) for m in moments]
    arms = [HANG + SWING * (other - 9.0 * person.stride) for other in reversed(thighs)]
    elbows = [14 + 0.8 * max(arm, 0.0) for arm in arms]
    moved = replace(
        person,
        height=person.height * taller,
        build=person.build * broader,
        turn_head=turned,
        thighs=(thighs[0], thighs[1]),
        knees=(knees[0], knees[1]),
    )
    return moved if person.holds else replace(moved, arms=(arms[0], arms[1]), elbows=(elbows[0], elbows[1]))


def pose(person: Person) -> dict:
    """Places of the joints, before the person is scaled [m]."""
    hips = np.array([0.0, 0.0, 0.93])
    lean = turn(-person.lean, "x")[:3, :3]

    def trunk(x: float, y: float, z: float) -> Array:
        return hips + lean @ np.array([x, y, z])

    joints: dict = {
        "hips": hips,
        "chest": trunk(0, 0, 0.40),
        "neck": trunk(0, 0.0, 0.56),
        "head": trunk(0, 0.03, 0.70),
        "turn": person.turn_head,
    }
    for key in ("shoulders", "elbows", "hands", "thighs", "knees", "ankles", "toes"):
        joints[key] = []
    for i, s in enumerate((-1, 1)):
        thigh, knee = np.deg2rad(person.thighs[i]), np.deg2rad(person.knees[i])
        hip = hips + [s * 0.088, 0, -0.02]
        k = hip + 0.43 * np.array([0.03 * s, np.sin(thigh), -np.cos(thigh)])
        shin = thigh - knee
        a = k + 0.41 * np.array([0.0, np.sin(shin), -np.cos(shin)])
        foot = min(0.0, shin) * 0.9 if shin < 0 else 0.35 * shin
        t = a + 0.15 * np.array([0.08 * s, np.cos(foot), np.sin(foot)]) - [0, 0, 0.045]
        joints["thighs"].append(hip), joints["knees"].append(k), joints["ankles"].append(a), joints["toes"].append(t)
        arm, bend, off = np.deg2rad(person.arms[i]), np.deg2rad(person.elbows[i]), np.deg2rad(person.splay)
        shoulder = trunk(s * 0.172 * person.build, 0, 0.458)
        e = shoulder + 0.29 * np.array([s * np.sin(off), np.sin(arm) * np.cos(off), -np.cos(arm) * np.cos(off)])
        fore = arm + bend
        inward = -0.25 * np.sin(bend)
        h = e + 0.25 * np.array([s * (0.4 * np.sin(off) + inward), np.sin(fore), -np.cos(fore)])
        joints["shoulders"].append(shoulder), joints["elbows"].append(e), joints["hands"].append(h)
    return joints

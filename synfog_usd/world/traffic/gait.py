"""How people walk: how legs and arms turn along their way, so that a foot that stands keeps its place.

Feet are led and legs follow (two bones, the law of cosines); arms swing against the legs.  Everybody begins in the
pose of their model, at the moment of the stride that is most like it.  Takes joints and the way that was gone; gives
turns of limbs.  Knows nothing of meshes or USD.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import interpolate

from synfog_usd.base.arrays import Array
from synfog_usd.world.library import nominal

SIDES = ("Left", "Right")
WALK_RATIO_M_S = 0.39
"""Length of a step squared over the speed, of adults: 0.0065 m for each step a minute (Sekiya and Nagasaki 1998)."""
STIFF = 0.9
"""Share of such a step that legs make whose pelvis does not turn with them."""
LEG_M = 0.84
"""Thigh and shin of an adult of 1.73 m, of whose size the lengths are that follow."""
HEEL_M, SOLE_M = 0.035, 0.032
"""From an ankle down to the line from heel to toe, and from there to the sole."""
RUNS_M_S, STANDS_M_S = 2.0, 0.05
FADES_M = 0.35
"""Way over which heights and angles of the model's own pose fade; its foot keeps its place until it is lifted."""
BENT = 0.985
"""Longest that a leg is which carries the body, over its length when it is straight."""
STRAIGHT = 0.9975
"""Longest that a leg gets, over its length; that of the model's pose, where it is longer."""
FIT = 48
"""Moments of the stride that are compared with the pose of the model."""
HANG_DEG, SWING = -3.0, 0.75
"""Of an arm: its middle, and its angle over that of the thigh of the other side."""
CLOSES_S, CLOSE_LIFT_M = 0.8, 0.04
"""How long somebody takes who stands still to bring their feet together, or to part them, and how high they lift them.
"""
SKIRT = 0.5
"""Turn of a coat below the hip over that of the thigh."""


@dataclass(frozen=True)
class Style:
    """A way to go.

    Attributes:
        stands: share of the stride for which a foot stands.
        under: share at which its ankle is below the hip.
        pitch: (share, angle [degrees]) of the foot from where it comes down, toes up positive.
        lift: height of the foot in its swing, over the length of the leg.
        rise: of the hips within a step, over the same; negative where they are highest between two steps.
    """

    stands: float
    under: float
    pitch: Sequence[tuple[float, float]]
    lift: float
    rise: float

    @functools.cached_property
    def pitches(self) -> interpolate.PchipInterpolator:
        """Angle of the foot by the share of the stride [degrees]."""
        return interpolate.PchipInterpolator(*np.array(self.pitch).T)


WALKS = Style(0.6, 0.235, ((0.0, 16), (0.09, 0), (0.36, 0), (0.6, -50), (0.74, -30), (0.9, 10), (1.0, 16)), 0.05, 0.05)
RUNS = Style(0.36, 0.13, ((0.0, 6), (0.05, 0), (0.17, 0), (0.36, -46), (0.55, -70), (0.85, 0), (1.0, 6)), 0.16, -0.03)


@dataclass(frozen=True)
class Skeleton:
    """Joints of somebody in the pose of the model, of the left side and the right one: (2, 3) each [m].

    Attributes:
        hips, knees, ankles, toes: of the legs; shoulders, elbows, hands: of the arms.
        swings: which arm swings.
    """

    hips: Array
    knees: Array
    ankles: Array
    toes: Array
    shoulders: Array
    elbows: Array
    hands: Array
    swings: tuple[bool, bool]


@functools.cache
def skeleton(asset: str, individual: str) -> Skeleton | None:
    """The joints of a model of somebody who walks; None where none are known."""
    rows = nominal().get(asset, {}).get("joints", {}).get(individual)
    if rows is None:
        return None
    swings = rows["swings"]
    places = {name: np.array(row) for name, row in rows.items() if name != "swings"}
    return Skeleton(**places, swings=(bool(swings[0]), bool(swings[1])))


@dataclass(frozen=True)
class Gait:
    """How somebody's limbs turn, frame by frame.

    Attributes:
        turns: (F,) of each limb by name, as 'Thigh_Left', about the axis to the right, from the pose of the model and
            from the limb that it hangs on [degrees].
        rise: (F,) of the hips [m].
    """

    turns: Mapping[str, Array]
    rise: Array


def standing(t: Array, travel: Array) -> Array:
    """How far somebody's feet have come together, 0 in the stride to 1, who stands where `travel` [m] does not grow.

    Args:
        t: (F,) even times; at time 0 they are as their model has them [s].
        travel: (F,) way that was gone [m].
    """
    goes = np.abs(np.gradient(travel, t)) > STANDS_M_S
    share, step = np.zeros(len(t)), float(t[1] - t[0]) / CLOSES_S
    for frame in range(1, len(t)):
        change = -2.0 * step if goes[frame] else step
        share[frame] = min(max(share[frame - 1] + change, 0.0), 1.0) if t[frame] > 0.0 else 0.0
    return share


def gait(bones: Skeleton, travel: Array, speed: float, stands: Array | float = 0.0) -> Gait:
    """Turns of limbs along a way.

    Args:
        bones: in the pose of the model, which is that of travel 0.
        travel: (F,) way that was gone [m].
        speed: usual [m/s], > 0; it makes the length of the stride.
        stands: (F,) of `standing`.
    """
    legs = [Leg.of(bones, side) for side in (0, 1)]
    length = legs[0].thigh + legs[0].shin
    step = STIFF * math.sqrt(WALK_RATIO_M_S * speed * length / LEG_M)
    stride = _Stride(RUNS if speed > RUNS_M_S else WALKS, 2.0 * step, length)
    begin = stride.begin(legs)
    phases = [begin + 0.5 * side + travel / stride.length for side in (0, 1)]
    fade = 1.0 - _smooth(travel / FADES_M)
    hip = stride.hip(phases[0], legs[0])
    rest = [float(stride.hip(np.array([begin]), legs[0])[0])]
    hip = hip + (legs[0].hip_z - rest[0]) * fade
    turns: dict[str, Array] = {}
    thighs = []
    feet = [
        stride.foot(leg, phase, begin + 0.5 * k, fade) for k, (leg, phase) in enumerate(zip(legs, phases, strict=True))
    ]
    behind = feet[0][0] < feet[1][0]
    closes = _smooth(2.0 * np.asarray(stands)), _smooth(2.0 * np.asarray(stands) - 1.0)  # of the foot behind, and ahead
    hip = hip + (legs[0].heel[1] + STRAIGHT * length - hip) * closes[1]
    for side, leg in enumerate(legs):
        y, z, pitch = leg.closed(feet[side], np.where(behind == (side == 0), *closes))
        thigh, shin = leg.bend(y, z - hip)
        thighs.append(thigh)
        forward, bent = thigh - leg.thigh_turn, shin - leg.shin_turn
        turned = {"Thigh": forward, "Shin": bent - forward, "Foot": pitch - leg.pitch - bent, "Skirt": SKIRT * forward}
        turns |= {f"{limb}_{SIDES[side]}": np.degrees(angle) for limb, angle in turned.items()}
    for side in (0, 1):
        if bones.swings[side]:
            arm, elbow = _arm(bones, side, np.degrees(thighs[1 - side]), travel, closes[1])
            turns[f"Arm_{SIDES[side]}"], turns[f"Forearm_{SIDES[side]}"] = arm, elbow
    return Gait(turns, hip - legs[0].hip_z)


# -- legs


@dataclass(frozen=True)
class Leg:
    """A leg in the plane in which it swings: lengths [m] and angles [rad], 0 straight down, forward positive.

    Attributes:
        hip_z: height of the hip; thigh, shin: lengths; thigh_turn, shin_turn: in the pose of the model.
        ankle: (y, z) from the hip to it in that pose, z from the ground; pitch: of the foot then.
        heel: (y, z) from where a flat foot's heel touches the ground to its ankle; sole: from there to its toes.
    """

    hip_z: float
    thigh: float
    shin: float
    thigh_turn: float
    shin_turn: float
    ankle: tuple[float, float]
    pitch: float
    heel: tuple[float, float]
    sole: float

    @classmethod
    def of(cls, bones: Skeleton, side: int) -> Leg:
        """The left leg (0) or the right one (1)."""
        hip, knee, ankle, toe = (row[side, 1:] for row in (bones.hips, bones.knees, bones.ankles, bones.toes))
        upper, lower = knee - hip, ankle - knee
        thigh, shin = float(np.hypot(*upper)), float(np.hypot(*lower))
        size = (thigh + shin) / LEG_M
        heel = ankle + np.array([0.25 * (ankle[0] - toe[0]), -HEEL_M * size])
        along = toe - heel
        sole = float(np.hypot(*along))
        along = along / sole
        to_ankle = ankle - heel
        height = float(along[0] * to_ankle[1] - along[1] * to_ankle[0]) + SOLE_M * size
        return cls(
            float(hip[1]), thigh, shin, math.atan2(upper[0], -upper[1]), math.atan2(lower[0], -lower[1]),
            (float(ankle[0] - hip[0]), float(ankle[1])), math.atan2(along[1], along[0]),
            (float(to_ankle @ along), height), sole,
        )  # fmt: skip

    def ankle_at(self, heel: Array, pitch: Array) -> tuple[Array, Array]:
        """y, z of the ankle of a foot that touches the ground, whose heel is at `heel` when it is flat [m]."""
        pivot = np.where(pitch < 0.0, self.sole, 0.0)
        y, z = self.heel[0] - pivot, self.heel[1]
        return heel + pivot + y * np.cos(pitch) - z * np.sin(pitch), y * np.sin(pitch) + z * np.cos(pitch)

    def closed(self, foot: tuple[Array, Array, Array], share: Array) -> tuple[Array, Array, Array]:
        """Ankle ahead of the hip, over the ground [m] and pitch of a foot that comes to a share below the hip."""
        y, z, pitch = foot
        lift = CLOSE_LIFT_M * np.sin(math.pi * share) ** 2
        return y * (1.0 - share), z + (self.heel[1] - z) * share + lift, pitch * (1.0 - share)

    def bend(self, y: Array, z: Array) -> tuple[Array, Array]:
        """Angles of thigh and shin that bring the ankle to a place, seen from the hip [m]."""
        straight = self.thigh + self.shin
        rest = math.hypot(self.ankle[0], self.hip_z - self.ankle[1])
        away = np.clip(np.hypot(y, z), 0.3 * self.thigh, max(STRAIGHT * straight, min(rest, straight)))
        inner = (self.thigh**2 + away**2 - self.shin**2) / (2.0 * self.thigh * away)
        thigh = np.arctan2(y, -z) + np.arccos(np.clip(inner, -1.0, 1.0))
        inner = (self.thigh**2 + self.shin**2 - away**2) / (2.0 * self.thigh * self.shin)
        return thigh, thigh - (math.pi - np.arccos(np.clip(inner, -1.0, 1.0)))


@dataclass(frozen=True)
class _Stride:
    """Two steps: where feet are at each share of them since one came down.

    Attributes:
        style: of going; length: of both steps [m]; leg: length of the leg [m].
    """

    style: Style
    length: float
    leg: float

    def _heel(self, leg: Leg, phase: Array) -> tuple[Array, Array, Array]:
        """Heel of the flat foot ahead of the hip [m], pitch [rad] and height over the ground [m]."""
        u, style = phase % 1.0, self.style
        first = style.under * self.length - leg.heel[0]
        w = np.clip((u - style.stands) / (1.0 - style.stands), 0.0, 1.0)
        swung = self.length * (3.0 - 2.0 * w) * w * w  # over the ground, at rest at both ends
        pitch = np.radians(style.pitches(u))
        return first - self.length * u + swung, pitch, style.lift * self.leg * np.sin(math.pi * w) ** 2

    def hip(self, phase: Array, leg: Leg) -> Array:
        """Height of the hips [m]: as high as the leg allows that comes down, and a rise between two steps."""
        y, z = leg.ankle_at(*self._heel(leg, np.zeros(1))[:2])
        reach = math.sqrt(max((0.995 * self.leg) ** 2 - float(y[0]) ** 2, (0.8 * self.leg) ** 2))
        low = float(z[0]) + min(reach, BENT * self.leg)
        rise = min(max(leg.heel[1] + BENT * self.leg - low, 0.0), abs(self.style.rise) * self.leg)
        wave = np.cos(4.0 * math.pi * (phase - self.style.stands / 2.0))
        return low + 0.5 * rise * (1.0 + math.copysign(1.0, self.style.rise) * wave)

    def begin(self, legs: Sequence[Leg]) -> float:
        """The left foot's moment of the stride that is most like the pose of the model."""
        phase = np.arange(FIT) / FIT
        error = np.zeros(FIT)
        for side, leg in enumerate(legs):
            heel, pitch, up = self._heel(leg, phase + 0.5 * side)
            y, z = leg.ankle_at(heel, pitch)
            error += (y - leg.ankle[0]) ** 2 + (z + up - leg.ankle[1]) ** 2 + 0.02 * (pitch - leg.pitch) ** 2
        return float(phase[np.argmin(error)])

    def foot(self, leg: Leg, phase: Array, first: float, fade: Array) -> tuple[Array, Array, Array]:
        """Ankle ahead of the hip and over the ground [m], and pitch [rad], from the pose of the model on."""
        heel, pitch, up = self._heel(leg, np.array([first]))
        turned = leg.pitch - float(pitch[0])
        y, z = leg.ankle_at(heel, pitch + turned)
        ahead, high = leg.ankle[0] - float(y[0]), leg.ankle[1] - float(z[0] + up[0])
        lifted = max(self.style.stands, first % 1.0) + math.floor(first)
        keeps = 1.0 - _smooth((phase - lifted) / (1.0 + math.floor(first) - lifted))
        heel, pitch, up = self._heel(leg, phase)
        pitch = pitch + turned * fade
        y, z = leg.ankle_at(heel, pitch)
        return y + ahead * keeps, z + up + high * fade, pitch


def _arm(bones: Skeleton, side: int, thigh: Array, travel: Array, hangs: Array) -> tuple[Array, Array]:
    """Turns of upper arm and forearm [degrees] against the thigh of the other side, or straight down to a share."""
    upper = bones.elbows[side, 1:] - bones.shoulders[side, 1:]
    rest = math.degrees(math.atan2(upper[0], -upper[1]))
    arm = HANG_DEG + SWING * (thigh - 9.0)
    still = arm[np.argmax(travel >= -1e-9)]
    arm = arm + (rest - still) * (1.0 - _smooth(travel / (3.0 * FADES_M)))
    arm = arm + (HANG_DEG - arm) * hangs
    return arm - rest, 0.8 * (np.maximum(arm, 0.0) - max(rest, 0.0))


def _smooth(share: Array) -> Array:
    """From 0 to 1, level at both ends."""
    u = np.clip(share, 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))

"""How cyclists pedal: cranks by the way that is gone, feet that stay on the pedals, legs that follow them.

Takes joints, and meshes without wheels; gives turns of limbs, and cranks as meshes of their own.  Knows nothing of
stages.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.world.shapes import Part
from synfog_usd.world.traffic.cutting import subset
from synfog_usd.world.traffic.gait import SIDES, Gait, Leg, Skeleton

BICYCLES, PEDALLERS = ("bicycle", "cyclist"), ("rider", "cyclist")
"""Models with cranks, and of those who pedal."""
CENTRE = (0.0, -0.06, 0.29)
"""Of the cranks of these models [m]."""
CRANK_M, AHEAD_M = 0.155, -0.005
"""From there to the middles of the pedals, one above and one below, and ahead."""
REACH_M, OUT_M = 0.19, 0.05
"""Cranks and pedals are within the first of their centre, along the bicycle, and beyond the second from its middle."""
DEVELOPMENT_M = 4.6
"""Way [m] for a turn of the cranks: 46 teeth drive 21, on a wheel whose circumference is 2.1 m."""


@dataclass(frozen=True)
class Cranks:
    """Cranks of a model, in its axes.

    Attributes:
        arms: both arms.
        pedals: side -> pedal, and its middle [m].
        rest: by material what of its mesh is no crank.
    """

    arms: Part
    pedals: Mapping[str, tuple[Part, Array]]
    rest: Mapping[str, Part]


def cranks_of(chrome: Part, plastic: Part) -> Cranks:
    """The cranks of a bicycle: arms cut out of chrome, of which wheels are cut out already, and pedals of plastic."""
    arms, pedals = _near(chrome), _near(plastic)
    x = plastic.points[plastic.faces, 0].mean(axis=1)
    of_side = {side: subset(plastic, pedals & (x * sign > 0.0)) for side, sign in zip(SIDES, (-1, 1), strict=True)}
    return Cranks(
        subset(chrome, arms),
        {side: (part, (part.points.min(axis=0) + part.points.max(axis=0)) / 2.0) for side, part in of_side.items()},
        {"chrome": subset(chrome, ~arms), "black_plastic": subset(plastic, ~pedals)},
    )


def _near(part: Part) -> Flags:
    """(M,) which faces belong to the cranks."""
    away = np.abs(part.points[part.faces].mean(axis=1) - CENTRE)
    return np.asarray((away[:, 0] > OUT_M) & (away[:, 1] < OUT_M + 0.01) & (away[:, 2] < REACH_M))


def crank_turn(travel: Array) -> Array:
    """Turn of the cranks after a way [m], about the axis to the right [degrees]."""
    return -360.0 * travel / DEVELOPMENT_M


def pedalling(bones: Skeleton, travel: Array) -> Gait:
    """Turns of legs along a way.

    Args:
        bones: in the pose of the model, which is that of travel 0: one foot above, the other one below.
        travel: (F,) way that was gone [m].
    """
    turn = np.radians(crank_turn(travel))
    turns: dict[str, Array] = {}
    for side, suffix in enumerate(SIDES):
        leg, ankle, hip = Leg.of(bones, side), bones.ankles[side], bones.hips[side]
        high = math.copysign(CRANK_M, ankle[2] - bones.ankles[1 - side, 2])
        y = ankle[1] - AHEAD_M + AHEAD_M * np.cos(turn) - high * np.sin(turn)
        z = ankle[2] - high + AHEAD_M * np.sin(turn) + high * np.cos(turn)
        thigh, shin = leg.bend(y - hip[1], z - hip[2])
        forward, bent = thigh - leg.thigh_turn, shin - leg.shin_turn
        for limb, angle in (("Thigh", forward), ("Shin", bent - forward), ("Foot", -bent)):
            turns[f"{limb}_{suffix}"] = np.degrees(angle)
    return Gait(turns, np.zeros(len(travel)))

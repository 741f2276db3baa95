"""Hands: a palm, four fingers that bend and a thumb, from hanging loosely to a fist.

In a hand's own axes x is where the palm looks, y where the thumb is, z where the fingers point; the wrist is
the origin.  Lengths in metres.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from assets.builders.solids import blob_distance, limb_distance, soft_min, surface
from synfog_usd.world.shapes import Array, Part

FINGERS = ((0.0305, 0.074, 0.9), (0.0103, 0.083, 1.0), (-0.0100, 0.077, 1.08), (-0.0292, 0.060, 1.15))
"""From the index to the little finger: where across the palm, length, and how far it bends beside the others."""
HANGING, FIST = (14.0, 28.0), (72.0, 112.0)
"""Bend of a finger at the knuckle and, further, at its middle joint [degrees]."""
TRIANGLES = 520


def hands(joints: Mapping, grips: tuple[float, float], palms: npt.ArrayLike | None = None) -> list[Part]:
    """Both hands of somebody whose `joints` have 'hands' (wrists) and 'elbows', left one first.

    Args:
        joints: places by name.
        grips: how far each is closed, from 0 (it hangs) to 1 (a fist, whose middle is then 4 cm from the joint).
        palms: where both palms look; None for towards the other hand.
    """
    made = []
    for side, wrist, elbow, grip in zip((-1, 1), joints["hands"], joints["elbows"], grips, strict=True):
        along = np.asarray(wrist, dtype=np.float64) - elbow
        along /= np.linalg.norm(along)
        palm = np.asarray((-side, 0.0, 0.0) if palms is None else palms, dtype=np.float64)
        palm = palm - (palm @ along) * along
        palm /= np.linalg.norm(palm)
        matrix = np.eye(4)
        matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = palm, side * np.cross(along, palm), along
        matrix[:3, 3] = np.asarray(wrist) + (0.015 - 0.06 * grip) * along
        made.append(_hand(round(grip, 2)).moved(matrix))
    return made


@functools.cache
def _hand(grip: float) -> Part:
    """One hand in its own axes."""
    knuckle, middle = (a + grip * (b - a) for a, b in zip(HANGING, FIST, strict=True))

    def field(x: Array, y: Array, z: Array) -> Array:
        d = limb_distance(x, y, z, (0.0, 0.0, -0.005), (0.0, 0.0, 0.03), 0.024, 0.020)
        d = soft_min(d, blob_distance(x, y, z, (0.0, 0.002, 0.056), (0.0165, 0.043, 0.052)), 0.02)
        ball = limb_distance(x, y, z, (0.006, 0.022, 0.025), (0.012, 0.036, 0.052), 0.014, 0.012)
        d = soft_min(d, ball, 0.012)
        for across, length, more in FINGERS:
            bend = np.deg2rad([more * knuckle, min(more * (knuckle + middle), 195.0)])
            at = np.array([-0.002, across, 0.092 - 5.0 * across * across])
            finger = np.full(np.shape(x), 1e3)
            for angle, share, thick in ((bend[0], 0.46, 0.0092), (bend[1], 0.54, 0.0084)):
                end = at + share * length * np.array(
                    [np.sin(angle), 0.10 * (1 - grip) * np.sign(across), np.cos(angle)]
                )
                finger = np.minimum(finger, limb_distance(x, y, z, at, end, thick, thick - 0.001))
                at = end
            d = soft_min(d, finger, 0.006)
        tip = np.array([0.016, 0.060, 0.078]) + grip * np.array([0.020, -0.028, 0.006])
        last = tip + np.array([0.004, -0.004, 0.028]) + grip * np.array([0.006, -0.022, -0.018])
        for start, end, wide in (((0.010, 0.034, 0.045), tip, 0.0115), (tip, last, 0.0100)):
            d = soft_min(d, limb_distance(x, y, z, start, end, wide, wide - 0.0012), 0.006)
        return d

    return surface(
        field, (-0.045, -0.065, -0.035), (0.11, 0.085, 0.205), step=0.004, triangles=TRIANGLES, material="skin"
    )

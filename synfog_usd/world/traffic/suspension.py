"""How a car's body pitches and rolls on its springs: an answer of second order to what accelerates it.

Takes accelerations over time; gives angles.  Knows nothing of roads.
Source of the gradients: Milliken, Race Car Vehicle Dynamics (1995), chapters 16 and 18: passenger cars.
"""

from __future__ import annotations

import cmath
import itertools
import math

import numpy as np

from synfog_usd.base.arrays import Array

PITCH_DEG, ROLL_DEG = 0.22, 0.45
"""Of a body that settled, for each m/s2 ahead (nose up) and to the left (right side down): 2.2 and 4.4 at 1 g."""
FREQUENCY_HZ, DAMPING = 1.4, 0.35
"""Of a body on its springs: natural frequency, and share of the critical damping."""


def lean(t: Array, along: Array, across: Array) -> tuple[Array, Array]:
    """Pitch and roll [degrees] of a body that is level and still at first.

    Args:
        t: (K,) even times from 0 [s].
        along, across: (K,) accelerations ahead and to the left [m/s2].

    Returns:
        (K,) each: nose up, and right side down.
    """
    w, dt = 2.0 * math.pi * FREQUENCY_HZ, float(t[1] - t[0])
    mode = w * complex(-DAMPING, math.sqrt(1.0 - DAMPING**2))  # the angle is the imaginary part of w^2 / Im(mode) times
    decay = cmath.exp(mode * dt)  # the integral of a(s) exp(mode (t - s)), with a on straight lines between times
    level = (decay - 1.0) / mode
    rise = (level - dt) / (mode * dt)
    angles = []
    for gain, a in ((PITCH_DEG, along), (ROLL_DEG, across)):
        added = (level * a[:-1] + rise * np.diff(a)).tolist()
        swings = itertools.accumulate(added, lambda swing, more: decay * swing + more, initial=0j)
        angles.append(gain * w * w / mode.imag * np.array(list(swings)).imag)
    return angles[0], angles[1]

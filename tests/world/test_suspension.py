"""A car's body on its springs."""

from __future__ import annotations

import math

import numpy as np

from synfog_usd.world.traffic import suspension


def test_a_body_answers_a_step_as_an_oscillator_does():
    """It settles at the gradient, and overshoots by exp(-pi z / sqrt(1 - z^2)) after half a damped period."""
    t = np.arange(0.0, 6.0, 0.002)
    pitch, roll = suspension.lean(t, np.full(len(t), -5.0), np.full(len(t), 2.0))
    z, w = suspension.DAMPING, 2.0 * math.pi * suspension.FREQUENCY_HZ
    over = 1.0 + math.exp(-math.pi * z / math.sqrt(1.0 - z * z))
    for angle, settled in ((pitch, -5.0 * suspension.PITCH_DEG), (roll, 2.0 * suspension.ROLL_DEG)):
        assert angle[0] == 0.0
        np.testing.assert_allclose(angle[-1], settled, rtol=1e-3)
        peak = int(np.argmax(np.abs(angle)))
        np.testing.assert_allclose(angle[peak] / settled, over, rtol=1e-3)
        np.testing.assert_allclose(t[peak], math.pi / (w * math.sqrt(1.0 - z * z)), atol=0.003)

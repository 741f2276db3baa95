"""Noise that tiles, from named random streams, for pictures of surfaces and clouds."""

from __future__ import annotations

import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.seeds import stream


def noise(
    shape: tuple[int, int], beta: float, *names: str | int, low: float = 0.0, high: float = 1e9, aspect: float = 1.0
) -> Array:
    """Noise that tiles: spectrum f^-beta between two frequencies [cycles per picture], mean 0, deviation 1."""
    rng = stream(0, "texture", *names)
    fy = np.fft.fftfreq(shape[0])[:, None] * shape[0] / aspect
    fx = np.fft.rfftfreq(shape[1])[None, :] * shape[1]
    f = np.hypot(fx, fy)
    amplitude = np.where((f > max(low, 0.5)) & (f < high), np.maximum(f, 0.5) ** (-beta / 2), 0)
    spectrum = amplitude * (rng.standard_normal(f.shape) + 1j * rng.standard_normal(f.shape))
    field = np.fft.irfft2(spectrum, s=shape)
    return (field - field.mean()) / field.std()

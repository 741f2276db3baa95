"""A fisheye lens: how far from the axis of the picture it puts what it sees under an angle.

Kannala and Brandt's polynomial, and with even powers too the one of NVIDIA's f-theta lenses and of WoodScape's
calibrations.  Knows directions and places in a picture, and neither rays nor light.

Directions are in OpenCV's axes of a camera: x right, y down, z ahead.  Places are in widths of the picture from its
axis, right and down.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from synfog_usd.base.arrays import Array

MOST = 16
"""Coefficients."""

ROWS = 1 << 16
"""Steps of the table from radius to angle: straight lines between them err by less than 1e-9 rad."""

NEWTON = 8
"""Steps from the table to the angle itself, where double precision counts; each squares the error."""


@dataclass(frozen=True)
class Fisheye:
    """A lens given by one polynomial, r = c1 t + c2 t^2 + ..., of the angle t to its axis.

    Attributes:
        coefficients: c1, c2 ... of the angle in radians, to any common scale.  OpenCV's k1 to k4 are c3, c5, c7 and
            c9, with c1 = 1 and the rest 0; an f-theta lens that keeps to its name is 1 alone.
        fov_x_deg: what a picture sees from its left to its right edge, through the axis [degrees], up to 360.  It says
            how long c1 is.

    Raises:
        ValueError: more than 16 coefficients, or such under which something within that angle is nearer to the axis
            than what is seen under a smaller one.

    Source: Kannala and Brandt, "A generic camera model and calibration method for conventional, wide-angle, and
    fish-eye lenses" (2006), equation 6.
    """

    coefficients: tuple[float, ...]
    fov_x_deg: float

    def __post_init__(self) -> None:
        if not 0.0 < self.fov_x_deg <= 360.0 or not self.coefficients:
            raise ValueError(f"an angle of view of {self.fov_x_deg:g} degrees is not above 0 and at most 360")
        if len(self.coefficients) > MOST:
            raise ValueError(f"{len(self.coefficients)} coefficients; {MOST} are the most")
        if not self.reach_rad >= math.radians(self.fov_x_deg) / 2.0:
            raise ValueError(
                f"the radius falls from {math.degrees(self.reach_rad):.1f} degrees to the axis on, within the angle of "
                f"view of {self.fov_x_deg:g} degrees"
            )

    @functools.cached_property
    def reach_rad(self) -> float:
        """Largest angle up to which the radius rises [rad]; pi where it always does."""
        powers = np.arange(1, len(self.coefficients) + 1)
        slopes = np.polynomial.Polynomial(np.array(self.coefficients) * powers)
        if slopes(0.0) <= 0.0:
            return 0.0
        roots = slopes.roots().tolist() if len(self.coefficients) > 1 else []
        turns = [root.real for root in map(complex, roots) if abs(root.imag) < 1e-9 and 0.0 < root.real < math.pi]
        return min([*turns, math.pi])

    @functools.cached_property
    def _scaled(self) -> np.polynomial.Polynomial:
        """The polynomial in widths of the picture."""
        plain = np.polynomial.Polynomial([0.0, *self.coefficients])
        return plain * (0.5 / float(plain(math.radians(self.fov_x_deg) / 2.0)))

    def polynomial(self, width_px: int) -> list[float]:
        """c1, c2 ... [px] of a picture so wide."""
        return [float(part) * width_px for part in self._scaled.coef[1:]]

    def radius(self, angle_rad: Array) -> Array:
        """Distance from the axis [widths] of what is seen under an angle; that of the largest one beyond it."""
        return np.asarray(self._scaled(np.minimum(angle_rad, self.reach_rad)))

    def slope(self, angle_rad: Array) -> Array:
        """Widths a radian by which that distance grows."""
        return np.asarray(self._scaled.deriv()(angle_rad))

    @functools.cached_property
    def table(self) -> tuple[Array, float]:
        """Angles [rad] at `ROWS` + 1 even radii, and the largest of these [widths]."""
        most = float(self.radius(np.array(self.reach_rad)))
        radii = np.linspace(0.0, most, ROWS + 1)
        rough = np.linspace(0.0, self.reach_rad, 4097)
        return self._newton(radii, np.interp(radii, self.radius(rough), rough)), most

    def angle(self, radius: Array) -> Array:
        """Angle to the axis [rad] of what is seen at a distance from it [widths]; nan beyond what the lens shows."""
        angles, most = self.table
        theta = self._newton(radius, np.interp(radius, np.linspace(0.0, most, ROWS + 1), angles))
        return np.where(radius <= most * (1.0 + 1e-12), theta, np.nan)

    def _newton(self, radius: Array, angle: Array) -> Array:
        slope = self._scaled.deriv()
        for _ in range(NEWTON):
            step = (self._scaled(angle) - radius) / np.maximum(slope(angle), 1e-9)
            angle = np.clip(angle - step, 0.0, self.reach_rad)
        return np.asarray(angle)

    def places(self, directions: Array) -> Array:
        """(..., 2) places [widths] of directions (..., 3), of any length."""
        across = np.hypot(directions[..., 0], directions[..., 1])
        radius = self.radius(np.arctan2(across, directions[..., 2]))
        scale = radius / np.maximum(across, 1e-300)
        return np.asarray(directions[..., :2] * scale[..., None])

    def directions(self, places: Array) -> Array:
        """(..., 3) unit directions of places (..., 2) [widths]; nan beyond what the lens shows."""
        radius = np.hypot(places[..., 0], places[..., 1])
        angle = self.angle(radius)
        scale = np.where(radius > 0.0, np.sin(angle) / np.maximum(radius, 1e-300), 0.0)
        return np.concatenate([places * scale[..., None], np.cos(angle)[..., None]], axis=-1)

    def solid_angle(self, angle_rad: Array) -> Array:
        """Steradians that a square of the picture sees, over those of one on the axis [1]: sin t dt / (r dr)."""
        near = angle_rad < 1e-6
        t = np.where(near, 1.0, angle_rad)
        solid = np.sin(t) / np.maximum(self.radius(t) * self.slope(t), 1e-300) * float(self._scaled.coef[1]) ** 2
        return np.where(near, 1.0, solid)

    def finest_rad(self, corner: float) -> float:
        """Smallest angle that a width of the picture spans, along the radius or across it, out to a distance [widths]
        from the axis [rad].
        """
        angles = np.linspace(1e-3, float(self.angle(np.minimum(corner, self.table[1]))), 257)
        return float(np.minimum(1.0 / self.slope(angles), np.sin(angles) / self.radius(angles)).min())

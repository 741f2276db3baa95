"""Phase functions on Mitsuba's side, for its own integrators and for ours.

Takes a record of `fog.phase`; gives `value` and `sample`, and the same thing as a
Mitsuba plugin.  Henyey-Greenstein is in closed form, everything else its table,
whose linear pieces are drawn exactly by the inverse of their sum.

Both count from the peak: `away` is 1 - cosine.  In single precision a cosine near 1 is
rounded by 6e-8.  A sharp peak, of the width (1 - g)^2 / 2, is not much wider; 1 - cosine
is exact wherever the cosine itself is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from synfog_usd.fog.phase import HenyeyGreenstein, Phase
from synfog_usd.render import backend

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float
    from mitsuba import MediumInteraction3f, PhaseFunction, PhaseFunctionContext, Point2f, Spectrum, Vector3f


class ClosedForm:
    """Henyey-Greenstein, for every g of (-1, 1) alike; another g compiles nothing anew."""

    def __init__(self, record: HenyeyGreenstein) -> None:
        mi = backend.mitsuba()
        self.g = dr.opaque(mi.Float, abs(record.g))
        self.side = dr.opaque(mi.Float, 1.0 if record.g >= 0.0 else -1.0)

    def value(self, cosine: Float) -> Float:
        """Density [1/sr] at the cosine between the directions of travel."""
        return self._at(1.0 - self.side * cosine)

    def sample(self, forward: Vector3f, u: Point2f) -> tuple[Vector3f, Float]:
        """A direction of travel after scattering, and its density [1/sr]."""
        g = self.g
        spread = 1.0 - g + 2.0 * g * u.x
        away = (
            (1.0 - g) * (1.0 - u.x) * ((1.0 - g * g) / spread + 1.0 - g) / spread
        )  # the usual inverse less 1, without its 0 / 0 for isotropic scattering
        return _turned(forward, away, self.side, u.y), self._at(away)

    def _at(self, away: Float) -> Float:
        base = (1.0 - self.g) * (1.0 - self.g) + 2.0 * self.g * away
        return (1.0 - self.g * self.g) / (4.0 * dr.pi * base * dr.sqrt(base))


class Table:
    """Any phase function, as its table; another one of as many rows compiles nothing anew."""

    def __init__(self, record: Phase) -> None:
        mi = backend.mitsuba()
        cosines, values = record.table()
        away, rows = np.unique((1.0 - cosines).astype(np.float32), return_index=True)
        self.pieces = mi.IrregularContinuousDistribution(away.tolist(), values[rows].tolist())

    def value(self, cosine: Float) -> Float:
        """Density [1/sr] at the cosine between the directions of travel."""
        return self.pieces.eval_pdf_normalized(dr.clip(1.0 - cosine, 0.0, 2.0)) / (2.0 * dr.pi)

    def sample(self, forward: Vector3f, u: Point2f) -> tuple[Vector3f, Float]:
        """A direction of travel after scattering, and its density [1/sr]."""
        away, density = self.pieces.sample_pdf(u.x)
        return _turned(forward, dr.clip(away, 0.0, 2.0), 1.0, u.y), density / (2.0 * dr.pi)


def kernel_phase(record: Phase) -> ClosedForm | Table:
    """A phase function to be used in a kernel of the variant in force, or from Python in the scalar one."""
    return ClosedForm(record) if isinstance(record, HenyeyGreenstein) else Table(record)


def plugin(record: Phase) -> PhaseFunction:
    """The same as a `mi.PhaseFunction`, to be put into a medium's dictionary."""
    mi = backend.mitsuba()
    phase: PhaseFunction = backend.derived(mi.PhaseFunction, _PhasePlugin)(kernel_phase(record))
    return phase


class _PhasePlugin:
    """A record of `fog.phase`; Mitsuba's `wi` points back to where the light comes from."""

    def __init__(self, kernel: ClosedForm | Table) -> None:
        mi = backend.mitsuba()
        mi.PhaseFunction.__init__(self, mi.Properties())
        self.kernel = kernel
        self.m_flags = mi.PhaseFunctionFlags.Anisotropic

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mei: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Vector3f, Spectrum, Float]:
        direction, density = self.kernel.sample(-mei.wi, sample2)
        return direction, backend.mitsuba().Spectrum(1.0), density

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mei: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Spectrum, Float]:
        density = self.kernel.value(-dr.dot(wo, mei.wi))
        return backend.mitsuba().Spectrum(density), density

    def to_string(self) -> str:
        return f"PhasePlugin[{type(self.kernel).__name__}]"


def _turned(forward: Vector3f, away: Float, side: Float | float, u: Float) -> Vector3f:
    """The direction at cosine side * (1 - away) from `forward`, turned about it by u."""
    mi = backend.mitsuba()
    sine = dr.safe_sqrt(away * (2.0 - away))
    sin_phi, cos_phi = dr.sincos(2.0 * dr.pi * u)
    return mi.Frame3f(forward).to_world(mi.Vector3f(sine * cos_phi, sine * sin_phi, side * (1.0 - away)))

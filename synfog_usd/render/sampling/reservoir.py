"""Weighted candidates, of which one or a few are kept as they come (weighted reservoirs, Chao 1982).

`Reservoir` does resampled importance sampling (Talbot, Cline and Egbert 2005, section 3): each candidate has a target,
what it would matter, and the density that it was drawn with; one is kept in proportion to target / density.
`Picks` keeps the numbers of several lights, each drawn in proportion to its weight.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

import drjit as dr

from synfog_usd.render import backend

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Color3f, Point3f

    from synfog_usd.render.sampling.sobol import Sobol

PICKS = 4
"""Of many lights, this many are drawn for each stretch and point; each costs as much as half a ray."""


@dataclass
class Candidate:
    """Light of a lamp, for each lane.

    Attributes:
        place: where the light arrives [m].
        lamp: where it comes from [m].
        value: what is estimated.
        group: its light group.
        target: how much it would matter.
        pdf: kept beside it.
    """

    place: Point3f
    lamp: Point3f
    value: Color3f
    group: Float
    target: Float
    pdf: Float | float = 0.0


class Reservoir:
    """The candidate that is kept so far, for each lane; all of it is 0 while there is none.

    Attributes:
        place, lamp, value, group, target, pdf: of the candidate.
        sum: of the weights of all candidates so far.
    """

    DRJIT_STRUCT: ClassVar[dict[str, type]] = {}

    def __init__(self) -> None:
        mi = backend.mitsuba()
        type(self).DRJIT_STRUCT = {
            "place": mi.Point3f,
            "lamp": mi.Point3f,
            "value": mi.Color3f,
            "group": mi.Float,
            "target": mi.Float,
            "sum": mi.Float,
            "pdf": mi.Float,
        }
        self.place, self.lamp, self.value = mi.Point3f(0.0), mi.Point3f(0.0), mi.Color3f(0.0)
        self.target, self.sum, self.group, self.pdf = mi.Float(0.0), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)

    def update(self, candidate: Candidate, density: Float, sampler: Sobol, active: Bool) -> Reservoir:
        """The reservoir after one more candidate, which was drawn with `density`."""
        target = candidate.target
        weight = dr.select(active & (density > 0.0) & (target > 0.0), target / density, 0.0)
        after = Reservoir()
        after.sum = self.sum + weight
        replaces = sampler.next_1d(active) * after.sum < weight
        for field in fields(candidate):
            setattr(after, field.name, dr.select(replaces, getattr(candidate, field.name), getattr(self, field.name)))
        return after

    def estimate(self) -> Color3f:
        """Unbiased estimate of the sum of all candidates' values: value x sum of the weights / target."""
        return dr.select(self.target > 0.0, self.value * (self.sum / self.target), 0.0)


class Picks:
    """The lights that are drawn so far, for each lane.

    Attributes:
        number: of each.
        weight: of each.
        total: of all weights so far.
        u: random numbers, used again and again as what is left of them.
    """

    DRJIT_STRUCT: ClassVar[dict[str, type]] = {}

    def __init__(self) -> None:
        mi = backend.mitsuba()
        type(self).DRJIT_STRUCT = {"u": mi.Vector4f, "weight": mi.Vector4f, "number": mi.Vector4u, "total": mi.Float}
        self.u, self.weight, self.number, self.total = mi.Vector4f(0.0), mi.Vector4f(0.0), mi.Vector4u(0), mi.Float(0.0)

    def update(self, index: UInt32, weight: Float) -> Picks:
        """After one more light."""
        mi = backend.mitsuba()
        after = Picks()
        after.total = self.total + weight
        share = weight / dr.maximum(after.total, 1e-30)
        replaces = self.u < share
        after.u = dr.clip(
            dr.select(replaces, self.u / dr.maximum(share, 1e-30), (self.u - share) / dr.maximum(1.0 - share, 1e-30)),
            0.0,
            0.9999999,
        )
        after.number = dr.select(replaces, mi.Vector4u(index), self.number)
        after.weight = dr.select(replaces, mi.Vector4f(weight), self.weight)
        return after

    def at(self, which: UInt32) -> tuple[UInt32, Float]:
        """(number of the light drawn as the `which`-th, its probability)."""

        number, weight = self.number[3], self.weight[3]
        for place in (2, 1, 0):
            number = dr.select(which == place, self.number[place], number)
            weight = dr.select(which == place, self.weight[place], weight)
        return number, weight / dr.maximum(self.total, 1e-30)

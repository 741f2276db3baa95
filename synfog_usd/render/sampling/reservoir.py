"""One of several weighted candidates, kept as they come (resampled importance sampling).

Each candidate has a target, what it would matter, and the density that it was drawn with; one is kept
in proportion to target / density.  Source: Talbot, Cline and Egbert (2005), section 3; weighted
reservoir: Chao (1982).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

import drjit as dr

from synfog_usd.render import backend

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float
    from mitsuba import Color3f, Point3f

    from synfog_usd.render.sampling.sobol import Sobol


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

"""Panes: what lets a share of light through straight, so that a shadow ray can pass it.

A path meets a window's glass, a `mask` in Mitsuba's words, and goes on as if nothing was there, or is reflected.  A
shadow ray that ended there would leave the light behind it to chance: a street lamp that shines into a car, found by
one path of 8 million, was the brightest stray pixel of the crossing at dusk.  Leaves and other pictures of opacity stop
shadow rays: paths find what is behind them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from synfog_usd.render import backend
from synfog_usd.render.load import MitsubaScene

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float
    from mitsuba import PreliminaryIntersection3f, Ray3f, Scene, ShapePtr

    from synfog_usd.render.placed import PlacedScene

MOST_PASSED = 8
"""Panes that a shadow ray passes, both sides of a car's windows and more; behind so many it is dark."""

PAST = 1e-4
"""How far behind a pane a ray goes on, over its distance from the origin [m], which is 1 at least."""


class Panes:
    """The panes of one scene.

    Args:
        through: (N,) share of light that each shape lets through, by its number in the renderer.
    """

    def __init__(self, through: np.ndarray) -> None:
        self._through = backend.floats(np.pad(through, (0, max(4 - len(through), 0))))
        self._count = dr.opaque(backend.mitsuba().UInt32, len(through))
        dr.make_opaque(self._through)

    @classmethod
    def of(cls, loaded: MitsubaScene) -> Panes | None:
        """A scene's; None where it has none."""
        world, through = loaded.source.world, {}
        for key, shape in loaded.shapes.items():
            part = world[key[0]] if len(key) == 1 else world[key[0]][key[1]]
            share = _share(world, part.get("bsdf"))
            if share and "emitter" not in part:  # what shines is met for its light
                through[backend.index_of(backend.mitsuba().ShapePtr(shape))] = share
        if not through:
            return None
        table = np.zeros(max(through) + 1, dtype=np.float32)
        table[list(through)] = list(through.values())
        return cls(table)

    def share(self, shape: ShapePtr, active: Bool) -> Float:
        """What a shape lets through straight; 0 of what is no pane."""
        mi = backend.mitsuba()
        number = backend.indices_of(shape)
        tabled = active & (number < self._count)
        return dr.select(tabled, dr.gather(mi.Float, self._through, number, tabled), 0.0)

    @dr.syntax
    def beyond(
        self, tree: Scene | PlacedScene, ray: Ray3f, active: Bool
    ) -> tuple[Bool, PreliminaryIntersection3f, Ray3f, Float]:
        """The first that a ray meets and is no pane.

        Args:
            tree: what is asked, a `mi.Scene` or a `PlacedScene`.
            ray: which; it ends at its `maxt`.

        Returns:
            whether there is anything; the surface; the ray from the last pane on; and the share of light that the
            panes before let through, 0 where they are too many.
        """
        mi = backend.mitsuba()
        onward, through = mi.Ray3f(ray), dr.select(active, mi.Float(1.0), 0.0)
        hit, passed = dr.zeros(mi.PreliminaryIntersection3f), mi.UInt32(0)
        blocked, going = mi.Bool(False), mi.Bool(active)
        while going:
            hit = tree.ray_intersect_preliminary(onward, mi.Bool(False), going)
            valid = going & hit.is_valid()
            share = self.share(hit.shape, valid)
            blocked, pane = valid & (share == 0.0), share > 0.0
            passed += 1
            through = dr.select(pane, dr.select(passed > MOST_PASSED, 0.0, through * share), through)
            step = hit.t + PAST * dr.maximum(dr.max(dr.abs(onward.o)), 1.0)
            onward.o = dr.select(pane, onward.o + onward.d * step, onward.o)
            onward.maxt = dr.select(pane, onward.maxt - step, onward.maxt)
            going = pane & (onward.maxt > 0.0) & (through > 0.0)
        return blocked, hit, onward, through


def _share(world: Mapping[str, Any], bsdf: Mapping[str, Any] | None) -> float:
    if isinstance(bsdf, Mapping) and bsdf.get("type") == "ref":
        bsdf = world[bsdf["id"]]
    if not isinstance(bsdf, Mapping) or bsdf["type"] != "mask":
        return 0.0
    opacity = bsdf["opacity"]
    return 0.0 if isinstance(opacity, Mapping) else max(1.0 - float(opacity), 0.0)

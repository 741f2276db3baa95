"""Lanes of a stage: guide curves with a type of lane, read into the scene's space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Usd, UsdGeom

from synfog_usd.base.arrays import Array
from synfog_usd.scene import Lanelet
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.space import Space, apply

TYPE = "synfog:lane:type"
"""A token on a linear BasisCurves of two curves: the left and the right edge of a lane, along the way it is driven."""


def lanes(
    prims: Sequence[tuple[Usd.Prim, Array]], space: Space, time: Usd.TimeCode, notes: Diagnostics
) -> tuple[Lanelet, ...]:
    """The lanes of curves with a type; curves that are no lane get a note.

    Args:
        prims: curves, each with its matrix to stage coordinates.
    """
    lanelets = []
    for prim, matrix in prims:
        curves = UsdGeom.BasisCurves(prim)
        counts = curves.GetCurveVertexCountsAttr().Get(time)
        points = np.asarray(curves.GetPointsAttr().Get(time) or (), dtype=np.float64).reshape(-1, 3)
        if (
            curves.GetTypeAttr().Get() != UsdGeom.Tokens.linear
            or counts is None
            or len(counts) != 2
            or min(counts) < 2
            or sum(counts) != len(points)
            or not np.isfinite(points).all()
        ):
            notes.warn(prim.GetPath(), f"{TYPE} is left out: a lane is a linear BasisCurves of two curves, its edges")
            continue
        edges = np.split(apply(space.matrix @ matrix, points), [int(counts[0])])
        lanelets.append(Lanelet(str(prim.GetPath()), str(prim.GetAttribute(TYPE).Get(time)), *edges))
    return tuple(lanelets)

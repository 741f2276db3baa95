"""From a stage's units and up axis to metres, Z up.

Matrices here are (4, 4) float64 for column vectors; USD's own are for row vectors
and are transposed by `columns`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pxr import Gf, Usd, UsdGeom

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import StageError
from synfog_usd.base.numbers import UNITS_M
from synfog_usd.stage.open import up_axis
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import determinant

Y_TO_Z = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""(x, y, z) -> (x, -z, y)."""

FAR = 1e10
"""Largest number of a placement [stage units]: 10 000 km in millimetres.  An instance's, its shape's and `FAR_POINT`
together stay within float32.
"""

FAR_POINT = 1e12
"""Largest coordinate of a mesh's point [stage units]."""


@dataclass(frozen=True)
class Space:
    """How stage coordinates become the scene's.

    Attributes:
        metres_per_unit: length [m] of one stage unit.
        axes: (4, 4) rotation of the stage's up axis to Z.
        origin_m: point [m, Z up] that becomes the scene's origin.
    """

    metres_per_unit: float
    axes: Array
    origin_m: Array

    @property
    def matrix(self) -> Array:
        """Stage coordinates to scene coordinates."""
        result = self.axes.copy()
        result[:3, :3] *= self.metres_per_unit
        result[:3, 3] = -self.origin_m
        return result


X_TO_Z = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""(x, y, z) -> (y, z, x)."""


def stage_space(stage: Usd.Stage, notes: Diagnostics) -> Space:
    """Units and axes of a stage, with the origin where the stage has it.

    Raises:
        StageError: metersPerUnit is not within `UNITS_M`.
    """
    metres = UsdGeom.GetStageMetersPerUnit(stage)
    if not UNITS_M[0] <= metres <= UNITS_M[1]:
        allowed = f"from {UNITS_M[0]:g} to {UNITS_M[1]:g}"
        raise StageError(
            f"{stage.GetRootLayer().identifier}: metersPerUnit = {metres:g} is not {allowed}; 1 is metres, 0.01 "
            f"centimetres, 0.0254 inches"
        )
    axes = {"X": X_TO_Z, "Y": Y_TO_Z, "Z": np.eye(4)}[up_axis(stage)]
    authored = str(UsdGeom.GetStageUpAxis(stage))
    if authored not in ("Y", "Z"):
        how = (
            "drawn with X up"
            if authored == "X"
            else "Y is taken, which is what USD falls back to; write Y or Z into the stage or a layer over it"
        )
        notes.warn("", f"upAxis is {authored!r}, and USD knows Y and Z alone; {how}")
    return Space(float(metres), axes, np.zeros(3))


def columns(matrix: Gf.Matrix4d) -> Array:
    """A USD matrix for column vectors."""
    return np.array(matrix, dtype=np.float64).T


def apply(matrix: Array, points: npt.ArrayLike) -> Array:
    """(N, 3) points under an affine matrix, in float64."""
    return np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def scaled(x: float, y: float, z: float) -> Array:
    """A matrix that stretches along the axes."""
    return np.diag([x, y, z, 1.0])


def rotation_of(matrix: Array) -> Array:
    """(4, 4) rotation nearest to a matrix: no scale, shear, mirror or translation."""
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    rotation = u @ vt
    if np.linalg.det(rotation) < 0.0:
        rotation[:, 0] *= -1.0
    result = np.eye(4)
    result[:3, :3] = rotation
    return result


def is_similarity(matrix: Array, *, tolerance: float = 1e-4) -> bool:
    """Whether a matrix stretches all directions alike: the geometric mean of the squares of its three factors is their
    arithmetic mean, up to what factors that differ by the tolerance make of it.
    """
    squares = float(np.vdot(matrix[:3, :3], matrix[:3, :3])) / 3.0
    return squares - abs(determinant(matrix)) ** (2.0 / 3.0) <= 4.0 / 9.0 * tolerance**2 * squares

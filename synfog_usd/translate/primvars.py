"""Primvars of a mesh, by corner.

Takes a mesh prim; gives normals, texture coordinates and colours as `Attribute`s.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from synfog_usd.arrays import Array, Indices
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.geometry import Attribute

ORIENTATIONS = ("rightHanded", "leftHanded")
"""UsdGeom's tokens for the side of a face that is its front."""

_INTERPOLATIONS = ("constant", "uniform", "varying", "vertex", "faceVarying", "instance")


class PrimvarReader:
    """Primvars of one mesh.

    Args:
        prim: the mesh.
        time: of the frame.
        notes: where what does not fit is told.
        indices: (C,) point of each corner.
        corner_face: (C,) face of each corner.
        point_count: N.
    """

    def __init__(
        self,
        prim: Usd.Prim,
        time: Usd.TimeCode,
        notes: Diagnostics,
        indices: Indices,
        corner_face: Indices,
        point_count: int,
    ) -> None:
        self.prim, self.time, self.notes = prim, time, notes
        self.indices, self.corner_face, self.point_count = indices, corner_face, point_count
        self.api = UsdGeom.PrimvarsAPI(prim)

    def normals(self) -> Attribute | None:
        """Normals, unit or (0, 0, 0) where the author's has no length: primvars:normals before normals; None where
        there are none of use.
        """
        found = self.primvar("normals", 3)
        if found is None:
            attribute = self.prim.GetAttribute("normals")
            values = value_at(attribute, self.time) if attribute.HasAuthoredValue() else None
            if values is not None and len(values):
                found = self.spread("normals", values, UsdGeom.PointBased(self.prim).GetNormalsInterpolation(), None, 3)
        if found is None:
            return None
        lengths = np.linalg.norm(found.values, axis=1, keepdims=True)
        good = np.isfinite(lengths) & (lengths > 1e-12)
        if not good.any():
            self.notes.warn(self.prim.GetPath(), "normals without length, or that are no finite numbers, are not used")
            return None
        return Attribute(
            found.values / lengths if good.all() else np.where(good, found.values, 0.0) / np.where(good, lengths, 1.0),
            found.corner,
        )

    def primvar(self, name: str, width: int) -> Attribute | None:
        """A primvar of `width` numbers each, or None with a note where it does not fit."""
        if not self.prim.HasAttribute(f"primvars:{name}"):
            return None
        primvar = self.api.GetPrimvar(name)
        if not primvar.HasAuthoredValue():
            return None
        values = value_at(primvar.GetAttr(), self.time)
        if values is None or not len(values):
            return None
        indices = primvar.GetIndices(self.time) if primvar.IsIndexed() else None
        return self.spread(name, values, primvar.GetInterpolation(), indices, width)

    def spread(self, name: str, values: Any, interpolation: str, indices: Any, width: int) -> Attribute | None:
        """Values by corner or by point, as their interpolation says."""
        array = _columns(values, width)
        if array is None:
            self.notes.warn(self.prim.GetPath(), f"primvar {name} does not hold {width} numbers each; it is not used")
            return None
        interpolation = self.notes.token(
            self.prim.GetPath(), f"interpolation of primvar {name}", interpolation, _INTERPOLATIONS, "constant"
        )
        corner: Indices | None
        if (
            interpolation in (UsdGeom.Tokens.uniform, UsdGeom.Tokens.faceVarying)
            and self.prim.GetTypeName() == "TetMesh"
        ):
            self.notes.warn(
                self.prim.GetPath(),
                f"primvar {name} goes with tetrahedra, of which only the outside is drawn; it is not used: make it "
                f"'vertex'",
            )
            return None
        if interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
            corner, wanted = None, self.point_count
        elif interpolation == UsdGeom.Tokens.faceVarying:
            corner, wanted = np.arange(len(self.indices)), len(self.indices)
        elif interpolation == UsdGeom.Tokens.uniform:
            corner, wanted = self.corner_face, int(self.corner_face[-1]) + 1
        else:
            corner, wanted = np.zeros(len(self.indices), dtype=np.int64), 1
        if indices is not None:
            numbers = np.asarray(indices, dtype=np.int64)
            fits = len(numbers) >= wanted and (not len(numbers) or (numbers.min() >= 0 and numbers.max() < len(array)))
            corner = numbers[self.indices if corner is None else corner] if fits else corner
        else:
            fits = len(array) >= wanted
        if not fits:
            self.notes.warn(
                self.prim.GetPath(),
                f"primvar {name} has too few values for its interpolation {interpolation!r}; it is not used",
            )
            return None
        return Attribute(array[:wanted] if corner is None else array, corner, interpolation == UsdGeom.Tokens.varying)


def _columns(values: Any, width: int) -> Array | None:
    """(K, width) of an array of tuples that are at least as wide, or of plain numbers in groups of `width`; else
    None.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError):
        return None
    if array.ndim == 2 and array.shape[1] >= width:
        return array[:, :width]
    if array.ndim == 1 and array.size % width == 0:
        return array.reshape(-1, width)
    return None


def value_at(attribute: Usd.Attribute, time: Usd.TimeCode) -> Any:
    """A value at a time; where only time samples exist and none is asked for, the first."""
    value = attribute.Get(time)
    return attribute.Get(Usd.TimeCode.EarliestTime()) if value is None and attribute.GetNumTimeSamples() else value


def array_at(prim: Usd.Prim, name: str, time: Usd.TimeCode, width: int) -> Array | None:
    """(K, width) of an attribute's numbers; None where there are none, or they do not go into rows of this width."""
    attribute = prim.GetAttribute(name)
    value = value_at(attribute, time) if attribute else None
    if value is None or not len(value):
        return None
    try:
        return np.asarray(value, dtype=np.float64).reshape(-1, width)
    except (ValueError, TypeError):
        return None

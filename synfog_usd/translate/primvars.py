"""Primvars of a mesh, by corner.

Takes a mesh prim; gives normals, texture coordinates and colours as `Attribute`s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, Vt

from synfog_usd.base.arrays import Array, Indices
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
        notes: for what does not fit.
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
        normals = self.primvar("normals", 3)
        if normals is None:
            attribute = self.prim.GetAttribute("normals")
            values = value_at(attribute, self.time) if attribute.HasAuthoredValue() else None
            if values is not None and len(values):
                interpolation = UsdGeom.PointBased(self.prim).GetNormalsInterpolation()
                normals = self._spread("normals", values, interpolation, None, 3)
        if normals is None:
            return None
        lengths = np.linalg.norm(normals.values, axis=1, keepdims=True)
        good = np.isfinite(lengths) & (lengths > 1e-12)
        if not good.any():
            self.notes.warn(self.prim.GetPath(), "normals without length, or that are no finite numbers, are not used")
            return None
        if good.all():
            return Attribute(normals.values / lengths, normals.corner)
        return Attribute(np.where(good, normals.values, 0.0) / np.where(good, lengths, 1.0), normals.corner)

    def primvar(self, name: str, width: int) -> Attribute | None:
        """A primvar of `width` numbers each, or None with a note where it does not fit."""
        if not self.prim.HasAttribute(f"primvars:{name}"):
            return None
        primvar = self.api.GetPrimvar(name)
        values = elements(primvar, self.time)
        if values is None:
            return None
        indices = value_at(primvar.GetIndicesAttr(), self.time) if primvar.IsIndexed() else None
        return self._spread(name, values, primvar.GetInterpolation(), indices, width)

    def _spread(
        self, name: str, values: Vt.Vec3fArray | Array | str, interpolation: str, indices: Vt.IntArray, width: int
    ) -> Attribute | None:
        """Values by corner or by point, as their interpolation says."""
        interpolation = self.notes.token(
            self.prim.GetPath(), f"interpolation of primvar {name}", interpolation, _INTERPOLATIONS, "constant"
        )
        corner: Indices | None
        if interpolation in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
            corner, least = None, self.point_count
        elif interpolation == UsdGeom.Tokens.faceVarying:
            corner, least = np.arange(len(self.indices)), len(self.indices)
        elif interpolation == UsdGeom.Tokens.uniform:
            corner, least = self.corner_face, int(self.corner_face[-1]) + 1
        else:
            corner, least = np.zeros(len(self.indices), dtype=np.int64), 1
        array = None if isinstance(values, str) else columns_of(values, width, least)
        if array is None:
            self.notes.warn(self.prim.GetPath(), f"primvar {name} does not hold {width} numbers each; it is not used")
            return None
        if indices is not None:
            numbers = np.asarray(indices, dtype=np.int64)
            fits = len(numbers) >= least and (not len(numbers) or (numbers.min() >= 0 and numbers.max() < len(array)))
            corner = numbers[self.indices if corner is None else corner] if fits else corner
        else:
            fits = len(array) >= least
        if not fits:
            self.notes.warn(
                self.prim.GetPath(),
                f"primvar {name} has too few values for its interpolation {interpolation!r}; it is not used",
            )
            return None
        return Attribute(array[:least] if corner is None else array, corner, interpolation == UsdGeom.Tokens.varying)


def elements(primvar: UsdGeom.Primvar, time: Usd.TimeCode) -> Array | str | None:
    """(K, C) of a primvar's K elements without its indices; a scalar is one, and an element size counts.

    Returns:
        the name of its type where that holds no numbers, or no colours and vectors (quaternions); None where it has no
        value.
    """
    value = value_at(primvar.GetAttr(), time) if primvar.HasAuthoredValue() else None
    if value is None:
        return None
    kind = type(value).__name__  # an attribute claims its schema's type, whatever stands there
    if kind.startswith("Quat"):
        return kind.lower()
    try:
        array = np.asarray(value, dtype=np.float64)
    except (ValueError, TypeError):
        return kind.lower()
    if not array.size:
        return None
    if not kind.endswith("Array"):
        return array.reshape(1, -1)
    array, size = array.reshape(len(array), -1), primvar.GetElementSize()
    return array.reshape(-1, size * array.shape[1]) if size > 1 and len(array) % size == 0 else array


def flattened(primvar: UsdGeom.Primvar, time: Usd.TimeCode) -> Array | str | None:
    """`elements` at their indices; 'indices outside of its values' where some are."""
    values = elements(primvar, time)
    if values is None or isinstance(values, str) or not primvar.IsIndexed():
        return values
    authored = value_at(primvar.GetIndicesAttr(), time)
    indices = np.asarray([] if authored is None else authored, dtype=np.int64)
    if not len(indices):
        return values
    if not 0 <= indices.min() <= indices.max() < len(values):
        return "indices outside of its values"
    return values[indices]


@dataclass(frozen=True)
class PrimvarValue:
    """Value of a primvar on a shape.

    Attributes:
        value: its numbers, in the mean where it varies; or the name of a type that holds no numbers.
        varies: whether it goes with the points, corners or faces of the shape.
    """

    value: tuple[float, ...] | str
    varies: bool = False

    @property
    def fault(self) -> str:
        """Why it is neither number nor colour, '' where it is."""
        if isinstance(self.value, str):
            return f"holds {self.value}"
        return "" if np.isfinite(self.value).all() else "holds no finite numbers"

    @property
    def what(self) -> str:
        """What it holds, in a note."""
        return self.fault or f"has {len(self.value)} numbers each"

    @property
    def number(self) -> float | None:
        """The number that it is, the mean of a colour's; None where it is none."""
        colour = self.colour
        return None if colour is None else sum(colour) / 3.0 if len(self.value) > 1 else colour[0]

    @property
    def colour(self) -> tuple[float, float, float] | None:
        """The colour that it is, grey of a number; None where it is none."""
        if isinstance(self.value, str) or self.fault or len(self.value) not in (1, 3, 4):
            return None
        r, g, b = (self.value * 3)[:3] if len(self.value) == 1 else self.value[:3]
        return float(r), float(g), float(b)


def constant(primvar: UsdGeom.Primvar, time: Usd.TimeCode) -> PrimvarValue | None:
    """Value of a constant primvar, None where it has none."""
    values = flattened(primvar, time)
    if values is None or isinstance(values, str):
        return None if values is None else PrimvarValue(values)
    if values.shape == (3, 1):  # plain numbers instead of a colour
        values = values.reshape(1, 3)
    return PrimvarValue(tuple(values[0].tolist()))


def columns_of(values: Vt.Vec3fArray | Array, width: int, count: int) -> Array | None:
    """(K, width) of elements that are at least as wide, or of plain numbers: `count` greys of a colour, or groups of
    `width`; else None.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError):
        return None
    array = array.reshape(len(array), -1)
    if width <= array.shape[1] <= _WIDEST:
        return array[:, :width]
    if array.shape[1] != 1:
        return None
    if len(array) % width == 0 and (width != 3 or len(array) == count * width):
        return array.reshape(-1, width)
    return np.repeat(array, 3, axis=1) if width == 3 else None


_WIDEST = 4
"""Numbers of the widest vector; what has more is a matrix."""


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

"""Primvars of instances: values that a leaf inherits from the instances around it.

Takes instances of a walk; gives values by name, and the kinds of instances that differ in them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.primvars import PrimvarValue, constant, flattened, value_at
from synfog_usd.translate.walk import GroupInstance

MOST_KINDS = 4096
"""Most kinds of instances of one prototype, which differ in what their materials read."""

MOST_TRIANGLES = 4_000_000
"""Triangles that the kinds of one prototype may have together; each kind has its own."""

FEWEST_KINDS = 16
"""Kinds that any prototype may have, however large."""


@dataclass(frozen=True)
class Around:
    """Primvars that a leaf inherits from the instances around it.

    Attributes:
        root: path of the prototype.
        value: from the name of a primvar to its value, or None.
    """

    root: Sdf.Path
    value: Callable[[str], PrimvarValue | None]


class Inherited:
    """Constant primvars on prims and above them; each is looked up once."""

    def __init__(self, time: Usd.TimeCode) -> None:
        self.time = time
        self._values: dict[tuple[Sdf.Path, str], tuple[PrimvarValue, Sdf.Path] | None] = {}

    def at(self, prim: Usd.Prim, name: str) -> tuple[PrimvarValue, Sdf.Path] | None:
        """A primvar that a prim has or inherits, and where it stands; None where there is none.

        Values that are not constant are not inherited, and hide what is above them.
        Source: UsdGeomPrimvarsAPI, FindPrimvarWithInheritance.
        """
        if not prim or prim.IsPseudoRoot():
            return None
        key = prim.GetPath(), name
        if key not in self._values:
            primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
            if not (primvar and primvar.HasAuthoredValue()):
                self._values[key] = self.at(prim.GetParent(), name)
            else:
                is_constant = primvar.GetInterpolation() == UsdGeom.Tokens.constant
                value = constant(primvar, self.time) if is_constant else None
                self._values[key] = None if value is None else (value, key[0])
        return self._values[key]


class InstancePrimvars:
    """Primvars of instances: those of a point instancer by point, and constant ones."""

    def __init__(self, time: Usd.TimeCode, notes: Diagnostics, inherited: Inherited) -> None:
        self.time, self.notes, self.inherited = time, notes, inherited
        self._values: dict[tuple[Sdf.Path, str], Array | PrimvarValue | None] = {}

    def value(self, place: GroupInstance, name: str) -> PrimvarValue | None:
        """Value of a primvar on an instance, or on the one that it stands in."""
        instance: GroupInstance | None = place
        while instance is not None:
            value = self._of(instance.source, name)
            if isinstance(value, PrimvarValue):
                return value
            if value is not None:
                return PrimvarValue(tuple(value[instance.number].tolist()))
            instance = instance.outer
        return None

    def _of(self, prim: Usd.Prim, name: str) -> Array | PrimvarValue | None:
        key = prim.GetPath(), name
        if key not in self._values:
            by_point = self._by_point(prim, name) if prim.GetTypeName() == "PointInstancer" else None
            if by_point is None:
                above = self.inherited.at(prim, name)
                by_point = above[0] if above is not None else None
            self._values[key] = by_point
        return self._values[key]

    def _by_point(self, prim: Usd.Prim, name: str) -> Array | PrimvarValue | None:
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
        if not (primvar and primvar.HasAuthoredValue()) or primvar.GetInterpolation() == UsdGeom.Tokens.constant:
            return None
        values = flattened(primvar, self.time)
        if values is None or isinstance(values, str):
            return None if values is None else PrimvarValue(values)
        which = value_at(UsdGeom.PointInstancer(prim).GetProtoIndicesAttr(), self.time)
        count = 0 if which is None else len(which)
        if primvar.GetInterpolation() == UsdGeom.Tokens.uniform and len(values) != count:
            return PrimvarValue(tuple(values[0].tolist()))
        if len(values) == 3 * count and values.shape[1] == 1:  # plain numbers instead of colours
            values = values.reshape(-1, 3)
        if len(values) != count:
            self.notes.warn(
                prim.GetPath(), f"primvar {name} has {len(values)} values for {count} points; it is not used"
            )
            return None
        return values

    def kinds(
        self, places: Sequence[GroupInstance], names: Collection[str], most: int
    ) -> list[tuple[dict[str, PrimvarValue | None], Indices]]:
        """Kinds of instances of one prototype: their values by name, and the numbers of the instances.

        Args:
            places: N instances of one prototype.
            names: what its materials read.
            most: kinds.  Of more, the values are rounded.
        """
        values = self._same(places, names)
        if values is None:
            values = [tuple([self.value(place, name) for name in names]) for place in places]
        number = {kind: row for row, kind in enumerate(dict.fromkeys(values))}
        kind_of = np.array([number[kind] for kind in values], dtype=np.int64)
        kinds = list(number)
        if len(kinds) > most:
            digits, rounded = _rounded(kinds, most)
            number = {kind: row for row, kind in enumerate(dict.fromkeys(rounded))}
            self.notes.warn(
                places[0].source.GetPath(),
                f"its instances have {len(kinds)} values of {', '.join(names)}; they are drawn in {len(number)}, of "
                f"{digits} decimals",
            )
            kinds, kind_of = list(number), np.array([number[kind] for kind in rounded])[kind_of]
        order = np.argsort(kind_of, kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(kind_of, minlength=len(kinds)))[:-1])
        return [(dict(zip(names, kind, strict=True)), rows) for kind, rows in zip(kinds, parts, strict=True)]

    def _same(
        self, places: Sequence[GroupInstance], names: Collection[str]
    ) -> list[tuple[PrimvarValue | None, ...]] | None:
        """Values of instances, where all of one source have the same and none stands in another; else None."""
        if [place for place in places if place.outer is not None]:
            return None
        of_source: dict[Usd.Prim, tuple[PrimvarValue | None, ...]] = {}
        for source in {place.source for place in places}:
            values = [self._of(source, name) for name in names]
            if any(isinstance(value, np.ndarray) for value in values):
                return None
            of_source[source] = tuple(value for value in values if value is None or isinstance(value, PrimvarValue))
        return [of_source[place.source] for place in places]


def _rounded(
    kinds: list[tuple[PrimvarValue | None, ...]], most: int
) -> tuple[int, list[tuple[PrimvarValue | None, ...]]]:
    """Kinds whose numbers are rounded so that at most so many differ, and the decimals that are left."""

    def rounded(value: PrimvarValue | None, digits: int) -> PrimvarValue | None:
        if value is None or isinstance(value.value, str):
            return value
        return PrimvarValue(tuple(round(x, digits) if math.isfinite(x) else 0.0 for x in value.value))

    coarse: list[tuple[PrimvarValue | None, ...]] = []
    for digits in (3, 2, 1, 0, -2, -4, -400):  # by the last all numbers are 0
        coarse = [tuple([rounded(value, digits) for value in kind]) for kind in kinds]
        if len(set(coarse)) <= most:
            break
    return digits, coarse

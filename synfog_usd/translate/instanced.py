"""Primvars of instances: what those around a leaf give it, one value an instance.

Takes instances of a walk; gives values by name, and the kinds of instances that differ in them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from synfog_usd.base.arrays import Array, Indices
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.primvars import Given, constant, flattened, value_at
from synfog_usd.translate.walk import GroupInstance

MOST_KINDS = 4096
"""Kinds of instances of one prototype that differ in what their materials read."""

MOST_TRIANGLES = 4_000_000
"""Triangles that the kinds of one prototype may have together: where instances are not written out, each kind has its
own.
"""

FEWEST_KINDS = 16
"""Kinds that any prototype may have."""


@dataclass(frozen=True)
class Around:
    """What the instances around a leaf give it.

    Attributes:
        root: path of the prototype.
        value: from the name of a primvar to its value, or None.
    """

    root: Sdf.Path
    value: Callable[[str], Given | None]


class Inherited:
    """Constant primvars on prims and above them; each is looked up once."""

    def __init__(self, time: Usd.TimeCode) -> None:
        self.time = time
        self._known: dict[tuple[Sdf.Path, str], tuple[Given, Sdf.Path] | None] = {}

    def at(self, prim: Usd.Prim, name: str) -> tuple[Given, Sdf.Path] | None:
        """A primvar that a prim has or inherits, and where it stands; None where there is none.

        Values that are not constant are not inherited, and hide what is above them.
        Source: UsdGeomPrimvarsAPI, FindPrimvarWithInheritance.
        """
        if not prim or prim.IsPseudoRoot():
            return None
        key = prim.GetPath(), name
        if key not in self._known:
            primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
            if not (primvar and primvar.HasAuthoredValue()):
                self._known[key] = self.at(prim.GetParent(), name)
            else:
                is_constant = primvar.GetInterpolation() == UsdGeom.Tokens.constant
                given = constant(primvar, self.time) if is_constant else None
                self._known[key] = None if given is None else (given, key[0])
        return self._known[key]


class InstancePrimvars:
    """Primvars of instances: those of a point instancer by point, and constant ones."""

    def __init__(self, time: Usd.TimeCode, notes: Diagnostics, inherited: Inherited) -> None:
        self.time, self.notes, self.inherited = time, notes, inherited
        self._known: dict[tuple[Sdf.Path, str], Array | Given | None] = {}

    def value(self, place: GroupInstance, name: str) -> Given | None:
        """What an instance gives, or the one that it stands in."""
        one: GroupInstance | None = place
        while one is not None:
            found = self._of(one.source, name)
            if isinstance(found, Given):
                return found
            if found is not None:
                return Given(tuple(found[one.number].tolist()))
            one = one.outer
        return None

    def _of(self, prim: Usd.Prim, name: str) -> Array | Given | None:
        key = prim.GetPath(), name
        if key not in self._known:
            by_point = self._by_point(prim, name) if prim.GetTypeName() == "PointInstancer" else None
            if by_point is None:
                above = self.inherited.at(prim, name)
                by_point = above[0] if above is not None else None
            self._known[key] = by_point
        return self._known[key]

    def _by_point(self, prim: Usd.Prim, name: str) -> Array | Given | None:
        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
        if not (primvar and primvar.HasAuthoredValue()) or primvar.GetInterpolation() == UsdGeom.Tokens.constant:
            return None
        values = flattened(primvar, self.time)
        if values is None or isinstance(values, str):
            return None if values is None else Given(values)
        which = value_at(UsdGeom.PointInstancer(prim).GetProtoIndicesAttr(), self.time)
        count = 0 if which is None else len(which)
        if primvar.GetInterpolation() == UsdGeom.Tokens.uniform and len(values) != count:
            return Given(tuple(values[0].tolist()))
        if len(values) == 3 * count and values.shape[1] == 1:  # plain numbers in the place of colours
            values = values.reshape(-1, 3)
        if len(values) != count:
            self.notes.warn(
                prim.GetPath(), f"primvar {name} has {len(values)} values for {count} points; it is not used"
            )
            return None
        return values

    def kinds(
        self, places: Sequence[GroupInstance], names: Collection[str], most: int
    ) -> list[tuple[dict[str, Given | None], Indices]]:
        """What the instances of one prototype give by name, and the numbers of those that give the same.

        Args:
            places: N instances of one prototype.
            names: what its materials read.
            most: kinds up to which they are told apart.  Of more, those that differ least are drawn in their mean.
        """
        given = self._same(places, names)
        if given is None:
            given = [tuple([self.value(place, name) for name in names]) for place in places]
        number = {one: row for row, one in enumerate(dict.fromkeys(given))}
        kind_of = np.array([number[one] for one in given], dtype=np.int64)
        kinds = list(number)
        if len(kinds) > most:
            kinds, kind_of = self._merged(kinds, kind_of, places[0], names, most)
        order = np.argsort(kind_of, kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(kind_of, minlength=len(kinds)))[:-1])
        return [(dict(zip(names, one, strict=True)), rows) for one, rows in zip(kinds, parts, strict=True)]

    def _same(self, places: Sequence[GroupInstance], names: Collection[str]) -> list[tuple[Given | None, ...]] | None:
        """What instances give, where all of one source give the same and none stands in another; else None."""
        if [place for place in places if place.outer is not None]:
            return None
        found: dict[Usd.Prim, tuple[Given | None, ...]] = {}
        for source in {place.source for place in places}:
            values = [self._of(source, name) for name in names]
            if any(isinstance(value, np.ndarray) for value in values):
                return None
            found[source] = tuple(value for value in values if value is None or isinstance(value, Given))
        return [found[place.source] for place in places]

    def _merged(
        self,
        kinds: list[tuple[Given | None, ...]],
        kind_of: Indices,
        place: GroupInstance,
        names: Collection[str],
        most: int,
    ) -> tuple[list[tuple[Given | None, ...]], Indices]:
        """At most so many kinds: those whose values lie in one cell of a grid are their mean."""
        sorts: dict[tuple[object, ...], list[int]] = {}
        for row, kind in enumerate(kinds):
            sorts.setdefault(
                tuple(one if one is None or isinstance(one.value, str) else len(one.value) for one in kind), []
            ).append(row)
        numbers = [np.array([_flat(kinds[row]) for row in rows]) for rows in sorts.values()]
        steps = 256
        while True:
            cells = [np.unique(_cells(some, steps), axis=0, return_inverse=True) for some in numbers]
            if steps == 1 or sum(len(found) for found, _ in cells) <= most:
                break
            steps = steps * 3 // 4
        merged: list[tuple[Given | None, ...]] = []
        onto, off = np.empty(len(kinds), dtype=np.int64), 0.0
        for rows, some, (found, cell) in zip(sorts.values(), numbers, cells, strict=True):
            cell = cell.reshape(-1)
            count = np.bincount(cell, minlength=len(found))
            means = np.stack([np.bincount(cell, some[:, k]) / count for k in range(some.shape[1])], axis=1)
            off = max(off, float(np.abs(means[cell] - some).max(initial=0.0)))
            onto[rows] = len(merged) + cell
            merged += [_like(kinds[rows[0]], mean.tolist()) for mean in means]
        self.notes.warn(
            place.source.GetPath(),
            f"its instances have {len(kinds)} values of {', '.join(names)}; they are drawn in {len(merged)}, which are "
            f"off by {off:.2g} at most",
        )
        return merged, onto[kind_of]


def _flat(kind: tuple[Given | None, ...]) -> list[float]:
    return [number for one in kind if one is not None and not isinstance(one.value, str) for number in one.value]


def _like(kind: tuple[Given | None, ...], numbers: list[float]) -> tuple[Given | None, ...]:
    """A kind with other numbers."""
    found: list[Given | None] = []
    for one in kind:
        if one is None or isinstance(one.value, str):
            found.append(one)
            continue
        found.append(Given(tuple(numbers[: len(one.value)])))
        numbers = numbers[len(one.value) :]
    return tuple(found)


def _cells(values: Array, steps: int) -> Indices:
    """(N, C) which of so many steps from the least to the greatest each value lies in."""
    values = np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
    low, high = values.min(axis=0), values.max(axis=0)
    share = (values - low) / np.where(high > low, high - low, 1.0)
    return np.asarray(np.minimum(share * steps, steps - 1).astype(np.int64))

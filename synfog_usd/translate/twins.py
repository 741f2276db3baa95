"""Shapes that lie exactly on others.

A search tree cannot tell faces in one place apart, so that a ray meets all of them: thousands would cost minutes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from synfog_usd.base.arrays import Array, Flags
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.walk import GroupInstance

MOST = 16
"""Shapes that are drawn in one place."""

_ODD = np.uint64(0x9E3779B97F4A7C15) ** np.arange(1, 17, dtype=np.uint64)
"""By which the 16 numbers of a place make one, modulo 2^64: places that differ seldom make the same."""


class Twins:
    """How many shapes, or instances, lie exactly on one another."""

    def __init__(self, notes: Diagnostics) -> None:
        self.notes = notes
        self.first: dict[tuple[Any, ...], Mapping[str, Any] | None] = {}
        self.count: dict[bytes, int] = {}
        self.hidden: list[str] = []

    def hides(self, shape: Mapping[str, Any], path: str) -> bool:
        """Whether `MOST` shapes, whatever their looks, lie where `shape` does, so that it is not drawn."""
        if not any(isinstance(value, np.ndarray) for value in shape.values()):
            place = repr([part for part in shape.items() if part[0] != "bsdf"])  # those of one kind in one order
            return self._full(place.encode(), path)
        sketch = _sketch(shape)
        if sketch not in self.first:  # most lie alone, and are not read through
            self.first[sketch] = shape
            return False
        if (first := self.first[sketch]) is not None:
            self.count[_digest(first)], self.first[sketch] = 1, None
        return self._full(_digest(shape), path)

    def hide_instances(self, matrices: Array, places: Sequence[GroupInstance]) -> Flags:
        """(N,) the same of the instances of one group, which stand at (N, 4, 4)."""
        found = np.zeros(len(matrices), dtype=bool)
        if len(matrices) <= MOST:
            return found
        numbers = np.ascontiguousarray(matrices).reshape(len(matrices), 16).view(np.uint64)
        _, kind, count = np.unique(numbers @ _ODD, return_inverse=True, return_counts=True)
        for row in np.flatnonzero(count[kind] > MOST):  # most lie alone
            found[row] = self._full(matrices[row].tobytes(), places[row].path)
        return found

    def tell(self) -> None:
        """What is not drawn, by its first prim."""
        if self.hidden:
            self.notes.warn(
                self.hidden[0],
                f"{len(self.hidden)} prims lie exactly on {MOST} others of their shape; they are not drawn: move them "
                f"apart, or take them away",
            )

    def _full(self, place: bytes, path: str) -> bool:
        self.count[place] = self.count.get(place, 0) + 1
        if self.count[place] <= MOST:
            return False
        self.hidden.append(path)
        return True


def _place(shape: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return sorted((name, value) for name, value in shape.items() if name != "bsdf")


def _sketch(shape: Mapping[str, Any]) -> tuple[Any, ...]:
    """What shapes in one place have in common, of few numbers."""
    found = []
    for name, value in _place(shape):
        if isinstance(value, np.ndarray):
            flat = value.reshape(-1)
            found.append((name, value.shape, flat[:3].tobytes(), flat[-3:].tobytes()))
        else:
            found.append((name, repr(value)))
    return tuple(found)


def _digest(shape: Mapping[str, Any]) -> bytes:
    told = hashlib.blake2b(digest_size=16)
    for name, value in _place(shape):
        told.update(name.encode())
        told.update(np.ascontiguousarray(value).data if isinstance(value, np.ndarray) else repr(value).encode())
    return told.digest()

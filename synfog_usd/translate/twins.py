"""Shapes that lie exactly on others.

A search tree cannot tell faces in one place apart, so that a ray meets all of them: thousands would cost minutes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from synfog_usd.arrays import Array
from synfog_usd.translate.diagnostics import Diagnostics

MOST = 16
"""Shapes that are drawn in one place."""


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

    def hides_instance(self, matrix: Array, path: str) -> bool:
        """The same of the instances of one group."""
        return self._full(matrix.tobytes(), path)

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

"""A lamp at a point that sends what a table says, in all directions.

Mitsuba has no such emitter: its spot shows a picture, which reaches 90 degrees at
most and is coarse at its edge.  In a `SceneDict` it is

    {'type': 'photometric', 'intensity': {'type': 'rgb', 'value': (3,) [cd]}, 'bitmap': (V, H) or (V, H, 3) float32
    factors,
     'to_world': (4, 4) rigid}

Row i stands for the angle pi i / (V - 1) off the lamp's +Z, column j for 2 pi j / H
around it from +X to +Y; between them the table is linear.  H may be 1.
Knows nothing of files; see `translate.ies`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.render import backend

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import (
        Color3f,
        DirectionSample3f,
        Interaction3f,
        Point2f,
        Properties,
        ScalarBoundingBox3f,
        SurfaceInteraction3f,
        Vector3f,
    )

TYPE = "photometric"

_known: set[str] = set()


def register() -> None:
    """Tell Mitsuba about the emitter, once for each variant."""
    mi = backend.mitsuba()
    if mi.variant() not in _known:
        _known.add(mi.variant())
        emitter = backend.derived(mi.Emitter, _Photometric)
        mi.register_emitter(backend.plugin_name(TYPE), lambda properties: emitter(properties))


def table_of(part: Mapping[str, Any]) -> Array:
    """(V, H, C) factors of a lamp, C = 1 or 3, all >= 0."""
    table = np.asarray(part["bitmap"], dtype=np.float64)
    return np.maximum(table if table.ndim == 3 else table[:, :, None], 0.0)


def ring_weights(rows: int) -> Array:
    """(V,) solid angle [sr] of each row, all around: the integral of the piecewise linear hat of the row times 2 pi
    sin.
    """
    step = np.pi / (rows - 1)
    angle = np.arange(rows) * step
    inner = 2.0 * np.sin(angle) * (1.0 - np.cos(step)) / step
    inner[[0, -1]] = 1.0 - np.sin(step) / step
    return np.asarray(2.0 * np.pi * inner)


class Tables:
    """The tables of several lamps in one piece of memory.

    Args:
        tables: (V, H) each.
    """

    def __init__(self, tables: list[Array]) -> None:
        closed = [np.concatenate([table, table[:, :1]], axis=1) for table in tables]
        begin = np.cumsum([0, *(table.size for table in closed)])[:-1]
        self.values = backend.floats(np.concatenate([table.ravel() for table in closed]))
        self.begin = backend.numbers(begin)
        self.rows = backend.numbers([table.shape[0] for table in tables])
        self.columns = backend.numbers([table.shape[1] for table in tables])
        dr.make_opaque(self.values, self.begin, self.rows, self.columns)

    def at(self, which: UInt32, local: Vector3f, active: Bool | bool = True) -> Float:
        """The factor of table `which` in a direction of the lamp's own frame."""
        mi = backend.mitsuba()
        begin, rows, columns = (
            dr.gather(mi.UInt32, item, which, active) for item in (self.begin, self.rows, self.columns)
        )
        row, column, y, x = _cell(local, rows, columns)
        at = begin + row * (columns + 1) + column
        low = dr.lerp(dr.gather(mi.Float, self.values, at, active), dr.gather(mi.Float, self.values, at + 1, active), x)
        high = dr.lerp(
            dr.gather(mi.Float, self.values, at + columns + 1, active),
            dr.gather(mi.Float, self.values, at + columns + 2, active),
            x,
        )
        return dr.lerp(low, high, y)


def _cell(local: Vector3f, rows: UInt32 | int, columns: UInt32 | int) -> tuple[UInt32, UInt32, Float, Float]:
    """Row, column and shares of the next ones, for a direction."""
    mi = backend.mitsuba()
    polar = dr.atan2(dr.sqrt(local.x * local.x + local.y * local.y), local.z) * dr.inv_pi
    around = dr.atan2(local.y, local.x) * (0.5 * dr.inv_pi)
    around = dr.select(around < 0.0, around + 1.0, around)
    v, h = polar * mi.Float(rows - 1), around * mi.Float(columns)
    row, column = dr.minimum(mi.UInt32(v), rows - 2), dr.minimum(mi.UInt32(h), columns - 1)
    return row, column, v - mi.Float(row), h - mi.Float(column)


class _Photometric:
    """Mitsuba's side of the lamp; `register` derives it from the variant's emitter."""

    def __init__(self, properties: Properties) -> None:
        mi = backend.mitsuba()
        mi.Emitter.__init__(self, properties)
        table = np.array(properties["bitmap"], dtype=np.float64)
        table = table if table.ndim == 3 else table[:, :, None]
        colour = np.array(properties["intensity"], dtype=np.float64).ravel()
        self.colour = mi.Color3f(np.broadcast_to(colour, 3).tolist())
        self.scalar = backend.is_scalar()
        self.tables = [np.concatenate([table[:, :, c], table[:, :1, c]], axis=1) for c in range(table.shape[2])]
        self.kernel = None if self.scalar else Tables([table[:, :, c] for c in range(table.shape[2])])
        self.channels, self.shape = table.shape[2], table.shape[:2]
        if not self.scalar:
            dr.make_opaque(self.colour)
        to_world: Any = properties["to_world"]
        self.stand(np.array(to_world.matrix, dtype=np.float64).reshape(4, 4))
        self.m_flags = mi.EmitterFlags.DeltaPosition
        self.m_needs_sample_2 = False

    def stand(self, matrix: Array) -> None:
        mi = backend.mitsuba()
        self.place = mi.Point3f(matrix[:3, 3].tolist())
        self.axes = [mi.Vector3f((matrix[:3, k] / np.linalg.norm(matrix[:3, k])).tolist()) for k in range(3)]
        if not self.scalar:
            dr.make_opaque(self.place, self.axes)

    def factor(self, direction: Vector3f, active: Bool | bool) -> Color3f:
        mi = backend.mitsuba()
        local = mi.Vector3f(*(dr.dot(axis, direction) for axis in self.axes))
        if self.kernel is not None:
            factors: list[Float] | list[float] = [
                self.kernel.at(mi.UInt32(c), local, active) for c in range(self.channels)
            ]
        else:
            row, column, y, x = _cell(local, self.shape[0], self.shape[1])
            weights = np.outer([1.0 - y, y], [1.0 - x, x])
            factors = [float((table[row : row + 2, column : column + 2] * weights).sum()) for table in self.tables]
        return mi.Color3f(*factors) if self.channels == 3 else mi.Color3f(factors[0])

    def sample_direction(
        self, it: Interaction3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:  # Mitsuba's own signature
        mi = backend.mitsuba()
        sent = mi.DirectionSample3f() if self.scalar else dr.zeros(mi.DirectionSample3f)
        sent.p = self.place
        between = self.place - it.p
        square = dr.maximum(dr.squared_norm(between), 1e-12)
        sent.dist = dr.sqrt(square)
        sent.d = between / sent.dist
        sent.n = -sent.d
        sent.time, sent.pdf, sent.delta = it.time, 1.0, True
        sent.emitter = self if self.scalar else mi.EmitterPtr(self)
        return sent, self.colour * self.factor(-sent.d, active) / square

    def eval_direction(self, it: Interaction3f, sent: DirectionSample3f, active: Bool | bool = True) -> Color3f:
        square = dr.maximum(dr.squared_norm(self.place - it.p), 1e-12)
        return self.colour * self.factor(-sent.d, active) / square

    def pdf_direction(self, it: Interaction3f, sent: DirectionSample3f, active: Bool | bool = True) -> Float:
        return backend.mitsuba().Float(0.0)

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return backend.mitsuba().Color3f(0.0)

    def bbox(self) -> ScalarBoundingBox3f:
        return backend.mitsuba().ScalarBoundingBox3f()

    def to_string(self) -> str:
        return "Photometric[]"

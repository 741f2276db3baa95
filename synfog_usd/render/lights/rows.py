"""Lamps as rows of numbers: spots, points, lamps with a table of their light, and the faces of lit meshes.

Takes parts of a `SceneDict`; gives records of `LAMP`, a `SUMMARY` of each lamp's, and `Columns` of both in a kernel's
memory.  Knows nothing of sampling.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import drjit as dr
import numpy as np

from synfog_usd.base.arrays import Array
from synfog_usd.base.colour import LUMINANCE
from synfog_usd.render import backend
from synfog_usd.render.lights import photometric

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, UInt32
    from mitsuba import Color3f, Point3f, Vector3f

LAMP = np.dtype(
    [
        ("position", "f8", 3),  # of the lamp, or of a face's first corner [m]
        ("edge_u", "f8", 3),  # of a face [m]; 0 of a point
        ("edge_v", "f8", 3),
        ("axis", "f8", 3),  # of the beam, or a face's normal
        ("colour", "f8", 3),  # peak intensity [cd]; of a face radiance x area
        ("cutoff", "f8"),  # angle off the axis at which a beam ends [rad]
        ("slope", "f8"),  # 1 / the angle over which it falls to 0 there [1/rad]
        ("is_beam", "f8"),  # 1 for a beam or a table, 0 for a face, which shines by its cosine
        ("solid_angle", "f8"),  # flux over peak intensity [sr]
        ("group", "f8"),  # number of its light group and kind of light
        ("table", "f8"),  # number of its table, or -1
        ("table_x", "f8", 3),  # the table's +X
    ]
)
"""One row of a lamp."""

SUMMARY = np.dtype(
    [
        ("position", "f8", 3),  # of the lamp, or the middle of its faces [m]
        ("axis", "f8", 3),  # of its beam, or the mean normal of its faces
        ("peak", "f8"),  # luminous, of all rows together [cd]
        ("cutoff", "f8"),  # these five as in `LAMP`, of its brightest row
        ("slope", "f8"),
        ("is_beam", "f8"),
        ("table", "f8"),
        ("table_x", "f8", 3),
    ]
)
"""A whole lamp in short: one row for all of its own."""

TABLE_FIELDS = ("table", "table_x")
"""What a kernel needs only where there are tables."""

EVERYWHERE = (1e9, 1.0)
"""Cutoff and slope of what shines to all sides."""

SPOT_BEAM = 0.75
"""Mitsuba's share of the cutoff within which a spot is even, where none is given."""


def is_sampled_light(part: Mapping[str, Any] | str) -> bool:
    """Whether a shape or light of a scene is one that `LightSampler` holds."""
    if not isinstance(part, Mapping):
        return False
    if part.get("type") in ("spot", "point", photometric.TYPE):
        return "texture" not in part
    emitter = part.get("emitter")
    return (
        part.get("type") == "mesh" and isinstance(emitter, Mapping) and emitter.get("radiance", {}).get("type") == "rgb"
    )


def lamp_rows(part: Mapping[str, Any]) -> np.ndarray:
    """(N,) of `LAMP`: a row for a spot or point, one for each face of a mesh, one for each channel of a table."""
    if part["type"] == photometric.TYPE:
        return _photometric(part)
    return _faces(part) if part["type"] == "mesh" else _beam(part)


def middles(rows: np.ndarray) -> Array:
    """(N, 3) middle of each row's face, or the place of a point [m]."""
    return np.asarray(rows["position"] + (rows["edge_u"] + rows["edge_v"]) / 3.0)


def luminous_peak(rows: np.ndarray) -> Array:
    """(N,) luminous peak of each row [cd]."""
    return np.maximum(rows["colour"] @ LUMINANCE, 0.0)


def summaries(lamps: Sequence[np.ndarray]) -> np.ndarray:
    """(N,) of `SUMMARY`, one for each lamp's rows (M,) of `LAMP`."""
    summary = np.zeros(len(lamps), dtype=SUMMARY)
    summary["table"] = -1.0
    for number, rows in enumerate(lamps):
        _summarize(summary[number : number + 1], rows)
    return summary


def _summarize(summary: np.ndarray, rows: np.ndarray) -> None:
    """Fill in the summary (1,) of one lamp."""
    light = luminous_peak(rows)
    summary["peak"] = light.sum()
    if rows["is_beam"][0] > 0.5:  # of a lamp with three tables the brightest stands for all
        brightest = rows[int(np.argmax(light))]
        for name in ("position", "axis", "cutoff", "slope", "is_beam", "table", "table_x"):
            summary[name] = brightest[name]
        return
    weights = light + 1e-30
    summary["position"] = np.average(middles(rows), axis=0, weights=weights)
    axis = np.average(rows["axis"], axis=0, weights=weights)
    lean = np.linalg.norm(axis)
    if lean < 0.5:  # it shines all around
        summary["axis"], summary["peak"], summary["is_beam"] = (0.0, 0.0, 1.0), light.sum() / 4.0, 1.0
        summary["cutoff"], summary["slope"] = EVERYWHERE
    else:
        summary["axis"], summary["slope"] = axis / lean, 1.0


@dataclass
class LampRow:
    """One row of each lane, in a kernel; fields as in `LAMP`."""

    position: Point3f
    edge_u: Vector3f
    edge_v: Vector3f
    axis: Vector3f
    colour: Color3f
    cutoff: Float
    slope: Float
    is_beam: Float
    group: Float
    table: Float | None = None
    table_x: Vector3f | None = None


@dataclass
class SummaryRow:
    """One lamp in short of each lane, in a kernel; fields as in `SUMMARY`."""

    position: Point3f
    axis: Vector3f
    peak: Float
    cutoff: Float
    slope: Float
    is_beam: Float
    table: Float | None = None
    table_x: Vector3f | None = None


Row = TypeVar("Row", LampRow, SummaryRow)


class Columns(Generic[Row]):
    """Rows in a kernel's memory: the fields that `row` has, and those of tables only where there are any.

    Args:
        rows: (N,) of `LAMP` or `SUMMARY`.
        row: what `at` gives: `LampRow` or `SummaryRow`.
        tabled: whether there are tables.
    """

    def __init__(self, rows: np.ndarray, row: type[Row], *, tabled: bool) -> None:
        self.row: type[Row] = row
        names = [field.name for field in fields(row) if tabled or field.name not in TABLE_FIELDS]
        self.columns = {name: [backend.floats(column) for column in np.atleast_2d(rows[name].T)] for name in names}
        dr.make_opaque(self.columns)

    def at(self, index: UInt32, active: Bool | bool = True) -> Row:
        """The rows of some numbers."""
        mi = backend.mitsuba()
        values_of = {
            name: [dr.gather(mi.Float, column, index, active) for column in columns]
            for name, columns in self.columns.items()
        }
        kinds = {"position": mi.Point3f, "colour": mi.Color3f}
        return self.row(
            **{
                name: values[0] if len(values) == 1 else kinds.get(name, mi.Vector3f)(*values)
                for name, values in values_of.items()
            }
        )


def _blank(count: int) -> np.ndarray:
    rows = np.zeros(count, dtype=LAMP)
    rows["table"] = -1.0
    return rows


def _faces(mesh: Mapping[str, Any]) -> np.ndarray:
    corners = np.asarray(mesh["positions"], dtype=np.float64)[np.asarray(mesh["faces"], dtype=np.int64)]
    edge_u, edge_v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(edge_u, edge_v)
    double_area = np.linalg.norm(normal, axis=1)
    rows = _blank(len(corners))
    rows["position"], rows["edge_u"], rows["edge_v"] = corners[:, 0], edge_u, edge_v
    rows["axis"] = normal / np.maximum(double_area, 1e-30)[:, None]
    rows["colour"] = 0.5 * double_area[:, None] * np.asarray(mesh["emitter"]["radiance"]["value"], dtype=np.float64)
    rows["solid_angle"] = np.pi
    return rows


def _beam(light: Mapping[str, Any]) -> np.ndarray:
    row = _blank(1)
    matrix = np.asarray(light.get("to_world", np.eye(4)), dtype=np.float64)
    row["position"] = light["position"] if "position" in light else matrix[:3, 3]
    row["axis"] = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    row["colour"] = light["intensity"]["value"]
    if light["type"] == "spot":
        cutoff = np.radians(light.get("cutoff_angle", 20.0))
        beam = np.radians(light["beam_width"]) if "beam_width" in light else SPOT_BEAM * cutoff
        row["cutoff"], row["slope"] = cutoff, 1.0 / max(cutoff - beam, 1e-6)
        row["solid_angle"] = 2.0 * np.pi * (1.0 - np.cos(0.5 * (cutoff + beam)))
    else:
        row["cutoff"], row["slope"], row["solid_angle"] = *EVERYWHERE, 4.0 * np.pi
    row["is_beam"] = 1.0
    return row


def channels(light: Mapping[str, Any]) -> list[np.ndarray]:
    """A table (V, H) of largest value 1 for each channel of a lamp's own, or zeros."""
    table = photometric.table_of(light)
    peaks = np.maximum(table.max(axis=(0, 1)), 1e-30)
    return [np.ascontiguousarray((table[:, :, c] / peaks[c]).astype(np.float32)) for c in range(table.shape[2])]


def _photometric(light: Mapping[str, Any]) -> np.ndarray:
    """A row for all channels alike, or one for each."""
    table = photometric.table_of(light)
    peaks, colour = (
        table.max(axis=(0, 1)),
        np.broadcast_to(np.asarray(light["intensity"]["value"], dtype=np.float64), 3),
    )
    rows = _blank(len(peaks))
    matrix = np.asarray(light["to_world"], dtype=np.float64)
    rows["position"] = matrix[:3, 3]
    rows["axis"], rows["table_x"] = (matrix[:3, column] / np.linalg.norm(matrix[:3, column]) for column in (2, 0))
    rows["colour"] = peaks[:, None] * (np.diag(colour) if len(peaks) == 3 else colour[None])
    flux = photometric.ring_weights(len(table)) @ table.mean(axis=1)
    rows["cutoff"], rows["slope"] = EVERYWHERE
    rows["is_beam"], rows["solid_angle"] = 1.0, flux / np.maximum(peaks, 1e-30)
    return rows

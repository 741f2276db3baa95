"""A user's model becomes a component of the library: metres, Z up, front along +Y, on the ground, labelled.

Takes a glTF, OBJ, PLY or USD file and a Cityscapes class.  Unit, up axis and front
are taken from the file where it says them, guessed from the sizes that things of
that class have where it does not, and told with the reason; each can be given.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Tf

from synfog_usd.base.errors import OutputError, ParameterError, StageError, did_you_mean
from synfog_usd.base.files import write_whole
from synfog_usd.world.components import Component, write_component
from synfog_usd.world.library import SIZES, LibraryModel
from synfog_usd.world.library import read as read_model
from synfog_usd.world.lod import with_low
from synfog_usd.world.meshfiles import MOST_TEXTURE_PX, Found, read
from synfog_usd.world.shapes import Array, Part, by_material

UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048, "dm": 0.1}
AXES: dict[str, tuple[int, int]] = {
    sign + axis: (k, -1 if sign == "-" else 1) for k, axis in enumerate("XYZ") for sign in "+-"
}
CABIN_SHARE = 0.62
"""Of the height: what lies above is the cabin of a car."""
CABIN_OFFSET = 0.025
"""Share of the length by which a cabin must lie behind the middle to tell the front."""
ROLLS = ("car", "truck", "bus", "caravan", "trailer", "motorcycle", "bicycle", "rider")
"""Classes that are longer than wide."""


@dataclass(frozen=True)
class Imported:
    """What was written, and how the file was understood.

    Attributes:
        model: as the library reads it.
        notes: one line each: unit, up, front, cleaning, what was left out.
        triangles: of the full and of the low level (0: not worth one).
    """

    model: LibraryModel
    notes: tuple[str, ...]
    triangles: tuple[int, int]


def import_asset(
    file: Path,
    label: str,
    *,
    out: Path,
    name: str | None = None,
    length_m: float | None = None,
    unit: str | None = None,
    up: str | None = None,
    front: str | None = None,
) -> Imported:
    """Write the model of a file as `out/<name>/<name>.usda`.

    Args:
        file: .glb, .gltf, .obj, .ply, .usd, .usda, .usdc or .usdz.
        label: Cityscapes class.
        out: a library folder, new or not; it holds no model of that name.
        name: of folder and prim; from the file's name if left out.
        length_m: extent along the way it looks [m], > 0; scales to it and needs no unit.
        unit: one of `UNITS`.
        up, front: axes of the file, as '+Z', '-Y'.

    Raises:
        ParameterError: an unknown class, unit or axis, or a size that no such thing has.
        StageError: the file cannot be read, is empty or too large.
        OutputError: the place is taken or cannot be written.
    """
    _check(label, unit, up, front, length_m)
    name = name or Tf.MakeValidIdentifier(file.stem.lower())
    if not Tf.IsValidIdentifier(name):
        raise ParameterError(
            f"--name {name}: not a prim name; use letters, digits and underscores, and begin with a letter"
        )
    folder = out / name
    if folder.exists():
        raise OutputError(f"{folder}: there is a model of this name already; choose another --name or remove it")
    found = read(file)
    notes = list(found.notes)
    parts = [
        p
        for p in (_cleaned(p, p.material in _textured(found)) for p in by_material(found.parts).values())
        if len(p.faces)
    ]
    before, after = sum(len(p.faces) for p in found.parts), sum(len(p.faces) for p in parts)
    if not parts:
        raise StageError(f"{file}: all its triangles are without area; export the model as a mesh")
    if after < before:
        notes.append(f"cleaned: {before - after} of {before} triangles were double or without area")
    points = np.concatenate([p.points for p in parts])
    matrix = _placed(points, label, found, notes, unit=unit, up=up, front=front, length_m=length_m)
    parts = [p.moved(matrix) for p in parts]
    for picture, image in found.pictures.items():
        write_whole(folder / "textures" / picture, lambda path, image=image: _save(image, path))
    origin = {"source": f"imported from {file.name}", "licence": "not stated; that of the file it came from"}
    about, looks = f"Imported from {file.name}.", found.materials
    component = with_low(
        Component(
            name, label, tuple(parts), about, materials=looks, textures="./textures/", origin=origin, thumbnail=False
        )
    )
    model = read_model(write_component(component, out))
    return Imported(model, tuple(notes), (component.triangles(), sum(len(p.faces) for p in component.low)))


def _check(label: str, unit: str | None, up: str | None, front: str | None, length_m: float | None) -> None:
    if label not in SIZES:
        raise ParameterError(
            f"--class {label}: not a class of things that can be imported; allowed are "
            f"{', '.join(SIZES)}.{did_you_mean(label, SIZES)}"
        )
    if unit is not None and unit not in UNITS:
        raise ParameterError(f"--unit {unit}: not a unit; allowed are {', '.join(UNITS)}")
    for option, axis in (("--up", up), ("--front", front)):
        if axis is not None and axis not in AXES:
            raise ParameterError(f"{option} {axis}: not an axis; allowed are {', '.join(sorted(AXES))}")
    if up and front and AXES[up][0] == AXES[front][0]:
        raise ParameterError(f"--up {up} and --front {front} lie along the same axis")
    if length_m is not None and not (math.isfinite(length_m) and length_m > 0):
        raise ParameterError(f"--length {length_m}: not a length in metres above 0")
    if length_m is not None and unit is not None:
        raise ParameterError("--length and --unit: give one of them; the length says the scale already")


def _textured(found: Found) -> set[str]:
    return {name for name, look in found.materials.items() if look.texture}


def _cleaned(part: Part, textured: bool) -> Part:
    """The part without triangles that are double or have no area; smooth where edges are not sharp."""
    import pymeshlab

    if textured:  # vertices that differ only in their texture coordinates must stay two
        a, b, c = (part.points[part.faces[:, i]] for i in range(3))
        solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0
        return replace(part, faces=part.faces[solid], normals=None)
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(part.points, part.faces.astype(np.int32)))
    for step in (
        "remove_duplicate_vertices",
        "remove_duplicate_faces",
        "remove_null_faces",
        "remove_unreferenced_vertices",
    ):
        getattr(meshes, f"meshing_{step}")()
    mesh = meshes.current_mesh()
    return Part(
        np.array(mesh.vertex_matrix()).reshape(-1, 3),
        np.array(mesh.face_matrix(), dtype=np.int64).reshape(-1, 3),
        part.material,
    )


def _placed(
    points: Array,
    label: str,
    found: Found,
    notes: list[str],
    *,
    unit: str | None,
    up: str | None,
    front: str | None,
    length_m: float | None,
) -> Array:
    """(4, 4) matrix from the file's axes and unit to the component's."""
    size = np.ptp(points, axis=0)
    if not size.max() > 0:
        raise StageError("all its points are the same; export the model as a mesh")
    says = found.metres_per_unit
    factors = (
        {f"given as {unit}": UNITS[unit]}
        if unit
        else {"length given": 0.0}
        if length_m
        else ({"as the file says": says} if says else {})
    )
    ups = (
        [up]
        if up
        else [found.up]
        if found.up
        else ["+Y", "+Z"]
        if front is None
        else [a for a in ("+Y", "+Z") if AXES[a][0] != AXES[front][0]]
    )
    guesses = {f"guessed: {u}": s for u, s in UNITS.items()}
    best = _best(size, label, ups, front, factors or guesses, length_m)
    if says and not unit and not length_m and best[0] > 0:  # the file says a unit that gives no such thing
        other = _best(size, label, ups, front, guesses, None)
        best = other if other[0] == 0 else best
    if (
        found.up and not up and best[0] > 0 and not front
    ):  # nor does its up axis; it would not be the first file to be wrong
        other = _best(size, label, ["+Y", "+Z"], front, factors or guesses, length_m)
        best = other if other[0] == 0 else best
    miss, up_axis, ahead, why, factor = best
    if miss > 0 and length_m is None and unit is None:
        seen = " x ".join(f"{v:.4g}" for v in size)
        raise ParameterError(
            f"a {label} of {seen} (x, y, z in the file) fits no unit of {', '.join(UNITS)}; say its --length in "
            f"metres, or another --class"
        )
    notes.append(f"unit: {factor:.5g} m, {why}")
    says_so = "given" if up else "as the file says" if found.up == up_axis else "guessed: so its sizes fit best"
    notes.append(f"up: {up_axis}, {says_so}")
    axis, reason = (front, "given") if front else _front(points, label, up_axis, ahead, found)
    notes.append(f"front: {axis}, {reason}")
    matrix = _frame(up_axis, axis)
    turned = points @ matrix[:3, :3].T * factor
    low, high = turned.min(axis=0), turned.max(axis=0)
    matrix[:3, :3] *= factor
    matrix[:3, 3] = -(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]
    extent = (high - low)[[1, 0, 2]]
    if miss > 0:
        allowed = ", ".join(f"{a:g} to {b:g}" for a, b in SIZES[label])
        notes.append(
            f"warning: {' x '.join(f'{v:.2f}' for v in extent)} m is no usual size of a {label} (length, width, height "
            f"{allowed} m)"
        )
    return matrix


def _best(
    size: Array, label: str, ups: list[str], front: str | None, factors: dict[str, float], length_m: float | None
) -> tuple[float, str, int, str, float]:
    """The reading whose sizes miss those of the class least: (miss, up, index of the axis of length, why, metres per
    unit).
    """
    readings = []
    for order, up in enumerate(ups):
        flat = [k for k in range(3) if k != AXES[up][0]]
        if front:
            aheads = [AXES[front][0]]
        elif label in ROLLS:
            aheads = [max(flat, key=lambda k: size[k])]
        else:
            aheads = flat[::-1]
        for ahead, (why, factor) in itertools.product(aheads, factors.items()):
            across = next(k for k in flat if k != ahead)
            metres = length_m / size[ahead] if length_m and size[ahead] > 0 else factor
            extent = metres * size[[ahead, across, AXES[up][0]]]
            readings.append((_miss(extent, label), round(_off_middle(extent, label), 6), order, up, ahead, why, metres))
    miss, _, _, up, ahead, why, metres = min(readings)
    return miss, up, ahead, why, float(metres)


def _miss(extent: Array, label: str) -> float:
    """How far sizes lie outside those of a class, as the sum of logarithms; 0 where all fit."""
    logs = np.log(np.maximum(extent, 1e-9))
    return float(sum(max(math.log(a) - v, v - math.log(b), 0.0) for v, (a, b) in zip(logs, SIZES[label], strict=True)))


def _off_middle(extent: Array, label: str) -> float:
    """Distance from the middle of the ranges, in half ranges of logarithms, squared and summed."""
    logs = np.log(np.maximum(extent, 1e-9))
    return float(
        sum(
            ((v - math.log(a * b) / 2) / (math.log(b / a) / 2)) ** 2
            for v, (a, b) in zip(logs, SIZES[label], strict=True)
        )
    )


def _front(points: Array, label: str, up: str, ahead: int, found: Found) -> tuple[str, str]:
    """Which way it looks, and why."""
    custom = found.front or ("+Z" if up == "+Y" else "-Y")
    if label not in ROLLS:
        return (
            custom,
            "as its format has it" if found.front else "by custom of its up axis; give --front if it looks elsewhere",
        )
    axis = "XYZ"[ahead]
    if label == "car":
        height = points[:, AXES[up][0]] * AXES[up][1]
        cabin = points[height > height.min() + CABIN_SHARE * np.ptp(height), ahead]
        along = points[:, ahead]
        offset = ((cabin.min() + cabin.max()) / 2 - (along.min() + along.max()) / 2) / np.ptp(along)
        if abs(offset) > CABIN_OFFSET:
            return (
                "-" if offset > 0 else "+"
            ) + axis, f"guessed: its cabin lies {abs(offset):.0%} of the length behind the middle"
    if custom[1] == axis:
        return (
            custom,
            "as its format has it" if found.front else "by custom of its up axis; give --front if it looks backward",
        )
    return "+" + axis, "guessed: its longer side; give --front if it looks backward"


def _frame(up: str, front: str) -> Array:
    """(4, 4) rotation that takes the file's up to +Z and its front to +Y."""
    z, y = np.zeros(3), np.zeros(3)
    z[AXES[up][0]], y[AXES[front][0]] = AXES[up][1], AXES[front][1]
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([np.cross(y, z), y, z])
    return matrix


def _save(image: object, path: Path) -> None:
    from PIL import Image

    assert isinstance(image, Image.Image)
    picture = image.convert("RGB")
    picture.thumbnail((MOST_TEXTURE_PX, MOST_TEXTURE_PX))
    picture.save(path, format="PNG")

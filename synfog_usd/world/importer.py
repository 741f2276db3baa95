"""A user's model becomes a component of the library: metres, Z up, front along +Y, on the ground, labelled.

Takes a glTF, OBJ, PLY or USD file and a Cityscapes class.  Unit, up axis and front
are taken from the file where it says them, and guessed from the sizes of such things
where it does not; notes give the reason.  Each can be hints.
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
from synfog_usd.world.meshfiles import MOST_TEXTURE_PX, MeshFile, read
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


@dataclass(frozen=True)
class Hints:
    """What the user says of a file: its unit, one of `UNITS`; its axes; its extent along the way it looks [m]."""

    unit: str | None = None
    up: str | None = None
    front: str | None = None
    length_m: float | None = None

    def check(self, label: str) -> None:
        """Refuse what cannot be.

        Raises:
            ParameterError: an unknown class, unit or axis, or two words that do not go together.
        """
        if label not in SIZES:
            raise ParameterError(
                f"--class {label}: not a class of things that can be imported; allowed are "
                f"{', '.join(SIZES)}.{did_you_mean(label, SIZES)}"
            )
        if self.unit is not None and self.unit not in UNITS:
            raise ParameterError(f"--unit {self.unit}: not a unit; allowed are {', '.join(UNITS)}")
        for option, axis in (("--up", self.up), ("--front", self.front)):
            if axis is not None and axis not in AXES:
                raise ParameterError(f"{option} {axis}: not an axis; allowed are {', '.join(sorted(AXES))}")
        if self.up and self.front and AXES[self.up][0] == AXES[self.front][0]:
            raise ParameterError(f"--up {self.up} and --front {self.front} lie along the same axis")
        if self.length_m is not None and not (math.isfinite(self.length_m) and self.length_m > 0):
            raise ParameterError(f"--length {self.length_m}: not a length in metres above 0")
        if self.length_m is not None and self.unit is not None:
            raise ParameterError("--length and --unit: give one of them; the length says the scale already")


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
    hints = Hints(unit, up, front, length_m)
    hints.check(label)
    name = name or Tf.MakeValidIdentifier(file.stem.lower())
    if not Tf.IsValidIdentifier(name):
        raise ParameterError(
            f"--name {name}: not a prim name; use letters, digits and underscores, and begin with a letter"
        )
    folder = out / name
    if folder.exists():
        raise OutputError(f"{folder}: there is a model of this name already; choose another --name or remove it")
    source = read(file)
    parts, notes = _clean_parts(file, source)
    matrix, how = _placed(np.concatenate([p.points for p in parts]), label, source, hints)
    for picture, image in source.pictures.items():
        write_whole(folder / "textures" / picture, lambda path, image=image: _save(image, path))
    component = with_low(
        Component(
            name,
            label,
            tuple(p.moved(matrix) for p in parts),
            f"Imported from {file.name}.",
            materials=source.materials,
            textures="./textures/",
            origin={"source": f"imported from {file.name}", "licence": "not stated; that of the file it came from"},
            thumbnail=False,
        )
    )
    written = read_model(write_component(component, out))
    triangles = component.triangles(), sum(len(p.faces) for p in component.low)
    return Imported(written, (*source.notes, *notes, *how), triangles)


def _clean_parts(file: Path, source: MeshFile) -> tuple[list[Part], list[str]]:
    """The parts of a file, one for each material, without useless triangles; and a note on those.

    Raises:
        StageError: nothing is left.
    """
    textured = {name for name, look in source.materials.items() if look.texture}
    cleaned = (_cleaned(p, p.material in textured) for p in by_material(source.parts).values())
    parts = [p for p in cleaned if len(p.faces)]
    before, after = sum(len(p.faces) for p in source.parts), sum(len(p.faces) for p in parts)
    if not parts:
        raise StageError(f"{file}: all its triangles are without area; export the model as a mesh")
    lost = [f"cleaned: {before - after} of {before} triangles were double or without area"] if after < before else []
    return parts, lost


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


def _placed(points: Array, label: str, source: MeshFile, hints: Hints) -> tuple[Array, list[str]]:
    """(4, 4) matrix from the file's axes and unit to the component's, and notes on how it was found.

    Raises:
        StageError: the model has no size.
        ParameterError: no unit makes it a thing of its class.
    """
    size = np.ptp(points, axis=0)
    if not size.max() > 0:
        raise StageError("all its points are the same; export the model as a mesh")
    miss, up_axis, ahead, why, factor = _reading(size, label, source, hints)
    if miss > 0 and hints.length_m is None and hints.unit is None:
        measures = " x ".join(f"{v:.4g}" for v in size)
        raise ParameterError(
            f"a {label} of {measures} (x, y, z in the file) fits no unit of {', '.join(UNITS)}; say its --length in "
            f"metres, or another --class"
        )
    reason_up = (
        "given" if hints.up else "as the file says" if source.up == up_axis else "guessed: so its sizes fit best"
    )
    axis, reason = (hints.front, "given") if hints.front else _front(points, label, up_axis, ahead, source)
    notes = [f"unit: {factor:.5g} m, {why}", f"up: {up_axis}, {reason_up}", f"front: {axis}, {reason}"]
    matrix = _frame(up_axis, axis)
    turned = points @ matrix[:3, :3].T * factor
    low, high = turned.min(axis=0), turned.max(axis=0)
    matrix[:3, :3] *= factor
    matrix[:3, 3] = -(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]
    if miss > 0:
        measures = " x ".join(f"{v:.2f}" for v in (high - low)[[1, 0, 2]])
        allowed = ", ".join(f"{a:g} to {b:g}" for a, b in SIZES[label])
        notes.append(f"warning: {measures} m is no usual size of a {label} (length, width, height {allowed} m)")
    return matrix, notes


Reading = tuple[float, str, int, str, float]
"""By how much sizes miss the class, up axis, index of the axis of length, why, metres per unit."""


def _reading(size: Array, label: str, source: MeshFile, hints: Hints) -> Reading:
    """The likeliest unit and axes of a file whose points span `size` (3,).

    What is given holds; then what the file says, unless sizes say otherwise: it would not be the first to be wrong.
    """
    guesses = {f"guessed: {unit}": metres for unit, metres in UNITS.items()}
    factors = guesses
    if hints.unit:
        factors = {f"given as {hints.unit}": UNITS[hints.unit]}
    elif hints.length_m:
        factors = {"length given": 0.0}
    elif source.metres_per_unit:
        factors = {"as the file says": source.metres_per_unit}
    upright = [up for up in ("+Y", "+Z") if hints.front is None or AXES[up][0] != AXES[hints.front][0]]
    known_up = hints.up or source.up
    best = _best(size, label, [known_up] if known_up else upright, hints, factors)
    if source.metres_per_unit and not hints.unit and not hints.length_m and best[0] > 0:
        guess = _best(size, label, [known_up] if known_up else upright, hints, guesses)
        best = guess if guess[0] == 0 else best
    if source.up and not hints.up and best[0] > 0 and not hints.front:
        guess = _best(size, label, ["+Y", "+Z"], hints, factors)
        best = guess if guess[0] == 0 else best
    return best


def _best(size: Array, label: str, ups: list[str], hints: Hints, factors: dict[str, float]) -> Reading:
    """The reading whose sizes miss those of the class least."""
    readings = []
    for order, up in enumerate(ups):
        flat = [k for k in range(3) if k != AXES[up][0]]
        if hints.front:
            aheads = [AXES[hints.front][0]]
        elif label in ROLLS:
            aheads = [max(flat, key=lambda k: size[k])]
        else:
            aheads = flat[::-1]
        for ahead, (why, factor) in itertools.product(aheads, factors.items()):
            across = next(k for k in flat if k != ahead)
            metres = hints.length_m / size[ahead] if hints.length_m and size[ahead] > 0 else factor
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


def _front(points: Array, label: str, up: str, ahead: int, model: MeshFile) -> tuple[str, str]:
    """Which way it looks, and why."""
    custom = model.front or ("+Z" if up == "+Y" else "-Y")
    if label not in ROLLS:
        return (
            custom,
            "as its format has it" if model.front else "by custom of its up axis; give --front if it looks elsewhere",
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
            "as its format has it" if model.front else "by custom of its up axis; give --front if it looks backward",
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

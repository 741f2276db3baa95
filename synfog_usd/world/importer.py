"""A user's model becomes a component of the library: metres, Z up, front along +Y, on the ground, labelled.

Takes a glTF, OBJ, PLY or USD file and a Cityscapes class.  Unit, up axis and front are
those that the user gives, else those of the file, else metres and the custom of such files.
A size that no such thing has is refused with the option that mends it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pxr import Tf

from synfog_usd.base.arrays import Array
from synfog_usd.base.errors import OutputError, ParameterError, StageError, did_you_mean
from synfog_usd.base.files import write_whole
from synfog_usd.world.components import Component, write_component
from synfog_usd.world.library import SIZES, LibraryModel
from synfog_usd.world.library import read as read_model
from synfog_usd.world.lod import with_low
from synfog_usd.world.meshfiles import MOST_TEXTURE_PX, MeshFile, read
from synfog_usd.world.shapes import Part, by_material

UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048, "dm": 0.1}
AXES: dict[str, tuple[int, int]] = {
    sign + axis: (k, -1 if sign == "-" else 1) for k, axis in enumerate("XYZ") for sign in "+-"
}


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
        write_whole(folder / "textures" / picture, functools.partial(_save, image))
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
    """(4, 4) matrix from the file's axes and unit to the component's, and notes on how they were chosen.

    Raises:
        StageError: the model has no size.
        ParameterError: no thing of its class has its size, and the user gave no scale.
    """
    if not np.ptp(points, axis=0).max() > 0:
        raise StageError("all its points are the same; export the model as a mesh")
    up, front, notes = _axes(source, hints)
    matrix = _frame(up, front)
    turned = points @ matrix[:3, :3].T
    length, width, height = np.ptp(turned, axis=0)[[1, 0, 2]]
    if hints.length_m:
        factor, why = hints.length_m / max(length, 1e-12), "length given"
    elif hints.unit:
        factor, why = UNITS[hints.unit], f"given as {hints.unit}"
    elif source.metres_per_unit:
        factor, why = source.metres_per_unit, "as the file says"
    else:
        factor, why = 1.0, "metres, as nothing says another"
    low, high = turned.min(axis=0) * factor, turned.max(axis=0) * factor
    matrix[:3, :3] *= factor
    matrix[:3, 3] = -(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]
    notes = [f"unit: {factor:.5g} m, {why}", *notes]
    extent = [factor * side for side in (length, width, height)]
    if not all(least <= side <= most for side, (least, most) in zip(extent, SIZES[label], strict=True)):
        measures = " x ".join(f"{side:.4g}" for side in extent)
        allowed = ", ".join(f"{least:g} to {most:g}" for least, most in SIZES[label])
        words = f"{measures} m is no usual size of a {label} (length, width, height {allowed} m)"
        if hints.length_m is None and hints.unit is None:
            raise ParameterError(
                f"{words}; it was read with {factor:g} m a unit, {up} up and {front} ahead. Give --unit, one of "
                f"{', '.join(UNITS)}, or --length, --up or --front, or another --class"
            )
        notes.append(f"warning: {words}")
    return matrix, notes


def _axes(source: MeshFile, hints: Hints) -> tuple[str, str, list[str]]:
    """Up axis and front of a file, and a note on each."""
    up, why_up = hints.up or source.up, "given" if hints.up else "as the file says"
    if up is None:
        lies_along_y = hints.front is not None and hints.front[1] == "Y"
        up, why_up = "+Z" if lies_along_y else "+Y", "by custom; give --up if it is another"
    front, why_front = hints.front, "given"
    if front is None and source.front and source.front[1] != up[1]:
        front, why_front = source.front, "as its format has it"
    if front is None:
        front = "+Z" if up[1] == "Y" else "-Y"
        why_front = "by custom of its up axis; give --front if it looks elsewhere"
    return up, front, [f"up: {up}, {why_up}", f"front: {front}, {why_front}"]


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

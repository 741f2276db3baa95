"""A composed stage as a root layer and one layer for each department, beside it.

`street.usda` holds what the scene is called and the choice of its variants; its sublayers `street.layout.usda`,
`.traffic`, `.lights`, `.fog` and `.cameras` hold the rest.  Each can be muted, edited or replaced alone.  They are
all local opinions of one layer stack, so it makes no difference to what the stage holds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pxr import Sdf, Tf

from synfog_usd.base.errors import OutputError
from synfog_usd.base.files import write_whole

WORLD = Sdf.Path("/World")
METADATA = ("defaultPrim", "metersPerUnit", "upAxis")
TIMES = ("startTimeCode", "endTimeCode", "timeCodesPerSecond", "framesPerSecond")
"""Of a clip; layers whose time codes last differently would be stretched."""


@dataclass(frozen=True)
class Department:
    """What stands in one layer.

    Attributes:
        name: of the layer.
        below: children of /World; empty for all that no other department has.
        roots: prims beside /World.
        variants: variant set of /World, or ''.
    """

    name: str
    below: tuple[str, ...] = ()
    roots: tuple[str, ...] = ()
    variants: str = ""


DEPARTMENTS = (
    Department("cameras", ("Ego", "Rig"), ("Render",)),
    Department("fog", ("Fog",), variants="fog"),
    Department("lights", ("Lights", "Sky"), variants="lighting"),
    Department("traffic", ("Vehicles", "People")),
    Department("layout"),
)
"""From the strongest layer to the weakest."""


def write_layers(path: Path, author: Callable[[Path], Sdf.Layer]) -> list[Path]:
    """Write a stage as layers: none takes its place before all are written, and the root layer does so last.

    Args:
        path: of the root layer; the others are beside it, so that relative paths mean the same in each.
        author: makes the stage as one layer, not yet saved, at a path in that folder.

    Returns:
        All files, the root layer first.

    Raises:
        OutputError: they cannot be written.
    """
    files = [path, *(file_of(path, department) for department in DEPARTMENTS)]

    def root(temporary: Path) -> None:
        layer = author(temporary)
        parts = [(file_of(path, department), part) for department, part in _split(layer)]
        layer.subLayerPaths = [f"./{file.name}" for file, _ in parts]
        layer.Save()
        _put(parts)

    try:
        write_whole(path, root)
    except Tf.ErrorException as error:
        raise OutputError(
            f"{path}: cannot be written ({str(error).split(' : ')[-1].strip()}); choose another output folder or free "
            f"some space"
        ) from error
    return files


def file_of(path: Path, department: Department) -> Path:
    """The layer of a department beside the root layer `path`."""
    return path.with_name(f"{path.stem}.{department.name}{path.suffix}")


def _put(parts: Sequence[tuple[Path, Sdf.Layer]]) -> None:
    """Write layers within each other, so that a disk that fills up at the last leaves the files of before."""
    if not parts:
        return
    (path, layer), *rest = parts

    def write(temporary: Path) -> None:
        layer.Export(str(temporary))
        _put(rest)

    write_whole(path, write)


def _split(layer: Sdf.Layer) -> Iterator[tuple[Department, Sdf.Layer]]:
    """Move each department's prims and variants out of `layer` into one of their own."""
    for department in DEPARTMENTS:
        part = Sdf.Layer.CreateAnonymous(f"{department.name}.usda")
        for key in METADATA:
            part.pseudoRoot.SetInfo(key, layer.pseudoRoot.GetInfo(key))
        for key in filter(layer.pseudoRoot.HasInfo, TIMES):
            part.pseudoRoot.SetInfo(key, layer.pseudoRoot.GetInfo(key))
        part.documentation = f"{department.name.capitalize()}: {layer.documentation}"
        world = Sdf.CreatePrimInLayer(part, WORLD)
        there = [child.name for child in layer.GetPrimAtPath(WORLD).nameChildren]
        names = [name for name in there if name in department.below or not department.below]
        for path in (
            *(WORLD.AppendChild(name) for name in names),
            *(Sdf.Path(f"/{name}") for name in department.roots),
        ):
            _move(layer, path, part)
        if department.variants:
            _move_variants(layer, department.variants, world)
        yield department, part


def _move(layer: Sdf.Layer, path: Sdf.Path, part: Sdf.Layer) -> None:
    Sdf.CopySpec(layer, path, part, path)
    parent = (
        layer.GetPrimAtPath(path.GetParentPath())
        if path.GetParentPath() != Sdf.Path.absoluteRootPath
        else layer.pseudoRoot
    )
    del parent.nameChildren[path.name]


def _move_variants(layer: Sdf.Layer, name: str, world: Sdf.PrimSpec) -> None:
    """The root layer keeps the set's name and the choice."""
    source = layer.GetPrimAtPath(WORLD)
    world.variantSetNameList.Prepend(name)
    target = Sdf.VariantSetSpec(world, name)
    for variant in source.variantSets[name].variantList:
        place = WORLD.AppendVariantSelection(name, variant.name)
        Sdf.VariantSpec(target, variant.name)
        Sdf.CopySpec(layer, place, world.layer, place)
    del source.variantSets[name]

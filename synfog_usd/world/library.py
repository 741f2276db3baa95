"""The models that worlds are composed of: what each is, how large, and in which variants it comes.

Reads a folder of components (`<name>/<name>.usda`) and nothing else, so that a
model of the user's own joins by lying in such a folder.  Lengths in metres.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pxr import Sdf, Usd, UsdGeom

from synfog_usd.base import resources
from synfog_usd.base.errors import StageError, did_you_mean

Range = tuple[float, float]

SIZES: Mapping[str, tuple[Range, Range, Range]] = MappingProxyType(
    {
        "car": ((2.4, 6.5), (1.4, 2.4), (1.1, 2.8)),
        "truck": ((4.5, 18.75), (1.9, 3.1), (2.0, 4.1)),
        "bus": ((5.5, 18.75), (1.9, 3.1), (2.2, 4.5)),
        "caravan": ((3.5, 9.0), (1.8, 2.7), (1.8, 3.5)),
        "trailer": ((1.5, 14.0), (1.0, 2.7), (0.4, 4.1)),
        "motorcycle": ((1.5, 2.7), (0.5, 1.2), (0.8, 1.7)),
        "bicycle": ((1.1, 2.1), (0.35, 0.9), (0.7, 1.3)),
        "rider": ((0.4, 2.7), (0.35, 1.2), (1.0, 2.2)),
        "person": ((0.15, 2.0), (0.25, 1.2), (0.6, 2.15)),
        "traffic light": ((0.1, 1.5), (0.1, 9.0), (0.8, 8.0)),
        "traffic sign": ((0.02, 1.5), (0.2, 12.0), (0.8, 8.5)),
        "pole": ((0.05, 6.0), (0.05, 3.0), (0.4, 16.0)),
        "guard rail": ((0.05, 1.5), (1.0, 8.0), (0.4, 1.6)),
        "fence": ((0.02, 0.6), (0.8, 8.0), (0.5, 4.0)),
        "wall": ((0.05, 2.0), (0.8, 12.0), (0.4, 8.0)),
        "vegetation": ((0.05, 30.0), (0.05, 30.0), (0.01, 45.0)),
        "building": ((1.2, 120.0), (1.2, 120.0), (2.0, 200.0)),
        "static": ((0.1, 6.0), (0.1, 6.0), (0.2, 8.0)),
        "dynamic": ((0.1, 4.0), (0.1, 4.0), (0.2, 4.0)),
    }
)
"""Class -> least and greatest length (Y), width (X), height (Z) [m].

Road vehicles: greatest sizes of EU directive 96/53/EC (a mirror may stand out by
0.25 m a side), least ones of small production models; people from a toddler to
the tallest percentile with what they carry; the rest as streets have it.
"""

GROUPS: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("car", "truck", "bus", "caravan", "trailer", "motorcycle", "bicycle"), "vehicle"),
        "person": "person",
        "rider": "rider",
        "traffic sign": "sign",
        "traffic light": "sign",
        "vegetation": "plant",
        "building": "building",
        **dict.fromkeys(("road", "sidewalk", "terrain", "ground"), "ground"),
    }
)
"""Class -> group; what is not here is furniture, or a lamp where it can be lit."""


@dataclass(frozen=True)
class LibraryModel:
    """One component.

    Attributes:
        name: of its folder, file and prim.
        label: Cityscapes class.
        group: 'vehicle', 'person', 'rider', 'lamp', 'sign', 'furniture', 'plant', 'building' or 'ground'.
        low, high: (x, y, z) corners of its box [m]; it looks along +Y.
        variants: set -> names.
        path: the file to reference.
        about: one sentence.
    """

    name: str
    label: str
    group: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    variants: Mapping[str, tuple[str, ...]]
    path: Path
    about: str = ""

    @property
    def length(self) -> float:
        """Extent along Y, the way it looks [m]."""
        return self.high[1] - self.low[1]

    @property
    def width(self) -> float:
        """Extent along X [m]; of a piece of a row (rail, fence, wall) what it adds to the row."""
        return self.high[0] - self.low[0]

    @property
    def height(self) -> float:
        """Extent above the ground [m]."""
        return self.high[2]


def _models(folder: Path | None) -> Path:
    return folder or resources.folder("assets") / "models"


@functools.cache
def names(folder: Path | None = None) -> tuple[str, ...]:
    """Every component below `folder` (the shipped models if left out)."""
    return tuple(sorted(path.stem for path in _models(folder).glob("*/*.usda") if path.stem == path.parent.name))


def library(folder: Path | None = None) -> Mapping[str, LibraryModel]:
    """Every component below `folder` (the shipped models if left out), by name.

    Raises:
        StageError: a component that cannot be read, or lacks class or size.
    """
    return MappingProxyType({name: model(name, folder) for name in names(folder)})


@functools.cache
def model(name: str, folder: Path | None = None) -> LibraryModel:
    """One component by name.

    Raises:
        StageError: no such model; names the nearest.
    """
    if name not in names(folder):
        raise StageError(f"{folder or 'assets/models'}: no model {name!r}.{did_you_mean(name, names(folder))}")
    return read(_models(folder) / name / f"{name}.usda")


@functools.cache
def nominal(folder: Path | None = None) -> Mapping[str, Mapping[str, Any]]:
    """Sizes that meshes do not show, from `nominal.json` of the folder: model -> quantity -> value.

    `length_m` of a vehicle as its maker states it; `width_m` and `depth_m` of a house between its walls, without
    eaves and oriels; `facade_windows`, how many of its window panes, the last ones, are not in its roof; `shops`, the
    rows of the names over its shops, in that column of their picture which a variant of its set `shops` shows.
    """
    sizes: dict[str, dict[str, Any]] = json.loads(
        ((folder or resources.folder("assets") / "models") / "nominal.json").read_text(encoding="utf-8")
    )
    return MappingProxyType(sizes)


def read(path: Path) -> LibraryModel:
    """What a component says of itself.

    Raises:
        StageError: it cannot be opened, or lacks a default prim, class or geometry.
    """
    layer = Sdf.Layer.FindOrOpen(str(path))
    stage = Usd.Stage.Open(layer) if layer else None
    prim = stage.GetDefaultPrim() if stage else None
    if not prim:
        raise StageError(f"{path}: not a component; it needs a default prim that holds the model")
    names = prim.GetAttribute("semantics:labels:cityscapes").Get() or []
    if len(names) != 1:
        raise StageError(
            f"{path}: {len(names)} Cityscapes labels on {prim.GetPath()}; a model has one, as synfog-usd asset import "
            f"writes it"
        )
    purposes = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render]
    bound = (
        UsdGeom.BBoxCache(Usd.TimeCode.Default(), purposes, useExtentsHint=False)
        .ComputeUntransformedBound(prim)
        .ComputeAlignedRange()
    )
    if bound.IsEmpty():
        raise StageError(f"{path}: no geometry below {prim.GetPath()}")
    sets = prim.GetVariantSets()
    variants = {name: tuple(sets.GetVariantSet(name).GetVariantNames()) for name in sets.GetNames()}
    label = str(names[0])
    group = "lamp" if label == "pole" and "lamps" in variants else GROUPS.get(label, "furniture")
    low, high = ((float(x), float(y), float(z)) for x, y, z in (bound.GetMin(), bound.GetMax()))
    about = prim.GetDocumentation()
    return LibraryModel(prim.GetName(), label, group, low, high, MappingProxyType(variants), path, about)

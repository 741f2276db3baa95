"""What each shape wears: materials, the shape's own colours, and subsets of its faces.

Takes the leaves of a walk; gives finishes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdShade

from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.material import DISPLAY, Finish, Materials
from synfog_usd.translate.shading import GREY
from synfog_usd.translate.walk import ALSO_OVERS, MESHES, Leaf

_SEEN = Usd.TraverseInstanceProxies(ALSO_OVERS)


class Bindings:
    """The materials of all leaves of a stage.

    Attributes:
        bound: path of a prim -> its material.
        sheer: whether any prim has a displayOpacity.
    """

    def __init__(self, stage: Usd.Stage, time: Usd.TimeCode, notes: Diagnostics, materials: Materials) -> None:
        self.stage, self.time, self.notes, self.materials = stage, time, notes, materials
        self.bound: dict[str, Any] = {}
        self.sheer = False
        self._previewed: dict[str, Any] = {}
        self._below: dict[str, list[Usd.Prim]] = {}

    def look_up(self, leaves: list[Leaf]) -> None:
        """Look up the materials of all prims and subsets at once."""
        prims = {leaf.path: leaf.prim for leaf in leaves}
        for leaf in leaves:
            if leaf.kind in MESHES and leaf.path not in self._below:
                self._below[leaf.path] = [
                    child for child in leaf.prim.GetFilteredChildren(_SEEN) if child.GetTypeName() == "GeomSubset"
                ]
        prims |= {str(child.GetPath()): child for children in self._below.values() for child in children}
        if prims:
            materials = UsdShade.MaterialBindingAPI.ComputeBoundMaterials(list(prims.values()), UsdShade.Tokens.full)[0]
            self.bound = {path: material for path, material in zip(prims, materials, strict=True) if material}
            bare = [path for path in prims if path not in self.bound]
            if bare:
                shown = UsdShade.MaterialBindingAPI.ComputeBoundMaterials(
                    [prims[path] for path in bare], UsdShade.Tokens.preview
                )[0]
                self._previewed = {path: material for path, material in zip(bare, shown, strict=True) if material}

    def finish_of(self, leaf: Leaf, path: str, *, varying_color: bool) -> Finish:
        """The finish of a leaf, or of a subset of it, at `path`."""
        material = self.bound.get(path)
        if leaf.material is not None and (material is None or leaf.stronger):
            material = UsdShade.Material(self.stage.GetPrimAtPath(leaf.material))
        if material is None and path in self._previewed:
            material = self._previewed[path]
            self.notes.info(path, "its material is bound for purpose 'preview' alone, and is drawn")
        if material:
            finish = self.materials.finish(material)
            if not finish.empty:
                return finish
            self.notes.warn(
                leaf.path, f"its material {material.GetPath()} has no surface; displayColor or grey is used"
            )
        opacity = self.opacity_of(leaf.prim) if self.sheer else 1.0
        if varying_color:
            return self.materials.vertex_colored(opacity)
        return self.materials.colored(leaf.color or GREY, opacity)

    def opacity_of(self, prim: Usd.Prim) -> float:
        """Mean displayOpacity of a shape without a material, also from above it."""
        primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayOpacity")
        values = primvar.Get(self.time) if primvar and primvar.HasAuthoredValue() else None
        if values is None or not len(values):
            return 1.0
        mean = float(np.mean(values))
        if min(values) != max(values) and math.isfinite(mean):
            self.notes.warn(prim.GetPath(), "displayOpacity that varies is drawn as its mean")
        taken = min(max(mean, 0.0), 1.0) if math.isfinite(mean) else 1.0
        if mean != taken:
            self.notes.warn(prim.GetPath(), f"displayOpacity is {mean:g}, which is no opacity; {taken:g} is taken")
        return taken

    def is_bare(self, leaf: Leaf) -> bool:
        """Whether a shape has no material, so that its own colours count."""
        return leaf.path not in self.bound and leaf.path not in self._previewed and leaf.material is None

    def plain_color(self, leaf: Leaf, finish: Finish) -> tuple[float, float, float]:
        """The colour of a shape whose material reads one that does not vary over it."""
        if finish.reads == DISPLAY:
            return leaf.color or finish.fallback or GREY
        primvar = UsdGeom.PrimvarsAPI(leaf.prim).FindPrimvarWithInheritance(finish.reads)
        values = primvar.ComputeFlattened(self.time) if primvar and primvar.HasAuthoredValue() else None
        first = np.asarray(
            values[0] if values is not None and len(values) else finish.fallback or (0.0, 0.0, 0.0), dtype=np.float64
        ).reshape(-1)
        return (float(first[0]), float(first[1]), float(first[2])) if len(first) >= 3 else (float(first[0]),) * 3

    def subsets(self, leaf: Leaf) -> list[tuple[np.ndarray, Finish]]:
        """Faces with a material of their own: of family 'materialBind', or bound directly."""
        found = []
        for child in self._below.get(leaf.path, ()):
            subset = UsdGeom.Subset(child)
            direct = bool(UsdShade.MaterialBindingAPI(child).GetDirectBinding().GetMaterialPath())
            if not direct and subset.GetFamilyNameAttr().Get() != UsdShade.Tokens.materialBind:
                continue
            if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
                self.notes.warn(child.GetPath(), "a material on a subset that is not of faces is not drawn")
                continue
            indices = subset.GetIndicesAttr().Get(self.time)
            if indices is None or not len(indices):
                continue
            found.append(
                (
                    np.asarray(indices, dtype=np.int64),
                    self.finish_of(leaf, str(child.GetPath()), varying_color=varies(leaf)),
                )
            )
        return found


def varies(leaf: Leaf) -> bool:
    """Whether a mesh has a displayColor that is not one constant."""
    if "primvars:displayColor" not in leaf.authored:
        return False
    primvar = UsdGeom.PrimvarsAPI(leaf.prim).GetPrimvar("displayColor")
    return bool(primvar.HasAuthoredValue()) and primvar.GetInterpolation() != UsdGeom.Tokens.constant

"""Materials of shapes, the shapes' own colours, and subsets of faces.

Takes the leaves of a walk; gives finishes.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from pxr import Usd, UsdGeom, UsdShade

from synfog_usd.base.arrays import Indices
from synfog_usd.translate.diagnostics import Diagnostics
from synfog_usd.translate.finite import reflected
from synfog_usd.translate.inputs import DISPLAY
from synfog_usd.translate.instanced import Around, Inherited
from synfog_usd.translate.material import Finish, Materials
from synfog_usd.translate.primvars import PrimvarValue, constant, flattened
from synfog_usd.translate.shading import GREY
from synfog_usd.translate.walk import ALSO_OVERS, Leaf

_WITH_OVERS = Usd.TraverseInstanceProxies(ALSO_OVERS)


class Bindings:
    """The materials of all leaves of a stage.

    Attributes:
        bound: path of a prim -> its material.
        sheer: whether any prim has a displayOpacity.
    """

    def __init__(self, stage: Usd.Stage, time: Usd.TimeCode, notes: Diagnostics, materials: Materials) -> None:
        self.stage, self.time, self.notes, self.materials = stage, time, notes, materials
        self.bound: dict[str, UsdShade.Material] = {}
        self.sheer = False
        self._previewed: dict[str, UsdShade.Material] = {}
        self._below: dict[str, list[Usd.Prim]] = {}
        self.inherited = Inherited(time)

    def look_up(self, leaves: list[Leaf]) -> None:
        """Look up the materials of all prims and subsets together."""
        prims = {leaf.path: leaf.prim for leaf in leaves}
        for leaf in leaves:
            if leaf.kind == "Mesh" and leaf.path not in self._below:
                self._below[leaf.path] = [
                    child for child in leaf.prim.GetFilteredChildren(_WITH_OVERS) if child.GetTypeName() == "GeomSubset"
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

    def finish_of(self, leaf: Leaf, path: str, around: Around | None = None) -> Finish:
        """The finish of a leaf, or of a subset of it, at `path`, within an instance or not."""
        lookup = functools.partial(self.primvar, leaf, around)
        material = self.bound.get(path)
        if leaf.material is not None and (material is None or leaf.stronger):
            material = UsdShade.Material(self.stage.GetPrimAtPath(leaf.material))
        if material is None and path in self._previewed:
            material = self._previewed[path]
            self.notes.info(path, "its material is bound for purpose 'preview' alone, and is drawn")
        if material:
            finish = self.materials.finish(material, lookup, leaf.path)
            if not (finish.empty or finish.unknown):
                return finish
            if finish.empty:
                self.notes.warn(
                    leaf.path, f"its material {material.GetPath()} has no surface; displayColor or grey is used"
                )
        opacity = self._opacity(leaf, lookup("displayOpacity")) if self.sheer else 1.0
        shown = lookup(DISPLAY)
        if shown is not None and shown.varies:
            return self.materials.vertex_colored(opacity)
        color = shown.colour if shown is not None else GREY
        if shown is not None and color is None:
            self.notes.warn(leaf.path, f"primvar displayColor {shown.what}, and is no colour; grey is drawn")
        elif shown is not None and color is not None:
            color = tuple(reflected(np.array([color]), leaf.path, self.notes)[0].tolist())
        return self.materials.colored(color or GREY, opacity)

    def _opacity(self, leaf: Leaf, primvar: PrimvarValue | None) -> float:
        """Mean displayOpacity of a shape without a material."""
        if primvar is None:
            return 1.0
        if isinstance(primvar.value, str) or len(primvar.value) != 1:
            self.notes.warn(leaf.path, f"primvar displayOpacity {primvar.what}, and is no number; 1 is taken")
            return 1.0
        mean = primvar.value[0]
        if primvar.varies and math.isfinite(mean):
            self.notes.warn(leaf.path, "displayOpacity that varies is drawn as its mean")
        opacity = min(max(mean, 0.0), 1.0) if math.isfinite(mean) else 1.0
        if mean != opacity:
            self.notes.warn(leaf.path, f"displayOpacity is {mean:g}, which is no opacity; {opacity:g} is taken")
        return opacity

    def primvar(self, leaf: Leaf, around: Around | None, name: str) -> PrimvarValue | None:
        """The primvar `name` of a leaf: its own, else a constant one from above it within the prototype, from the
        instances around, or from above the prototype.
        """
        primvar = UsdGeom.PrimvarsAPI(leaf.prim).GetPrimvar(name) if f"primvars:{name}" in leaf.authored else None
        if primvar and primvar.HasAuthoredValue():
            return self._own(primvar, leaf)
        above = self.inherited.at(leaf.prim.GetParent(), name)
        if around is None:
            return above[0] if above else None
        if above is not None and above[1].HasPrefix(around.root):
            return above[0]
        return around.value(name) or (above[0] if above else None)

    def _own(self, primvar: UsdGeom.Primvar, leaf: Leaf) -> PrimvarValue | None:
        if primvar.GetInterpolation() == UsdGeom.Tokens.constant:
            return constant(primvar, self.time)
        values = flattened(primvar, self.time)
        if values is None or isinstance(values, str):
            return None if values is None else PrimvarValue(values)
        mean = tuple(values.mean(axis=0).tolist())
        if leaf.kind in ("Mesh", "BasisCurves", "Points"):
            return PrimvarValue(mean, varies=True)
        if (values != values[0]).any():
            self.notes.warn(
                leaf.path, f"primvar {primvar.GetPrimvarName()} varies over a {leaf.kind}, and is drawn as its mean"
            )
        return PrimvarValue(mean)

    def subsets(self, leaf: Leaf, around: Around | None = None) -> list[tuple[Indices, Finish]]:
        """Faces with a material of their own: of family 'materialBind', or bound directly."""
        subsets = []
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
            subsets.append((np.asarray(indices, dtype=np.int64), self.finish_of(leaf, str(child.GetPath()), around)))
        return subsets

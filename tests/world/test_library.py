"""The model library: every model opens, stands on the ground, has the size of what it is, and looks as its variants
say.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdUtils, UsdValidation

from synfog_usd.base import cityscapes
from synfog_usd.base.errors import StageError
from synfog_usd.world.library import SIZES, library, model, read
from synfog_usd.world.shapes import Part

NAMES = [name for name, m in library().items() if m.group != "ground"]
ROOTED = {"bare_tree", "lime_tree", "maple_tree", "park_tree"}
"""Trees of the crossing whose trunks begin up to 9 cm below the ground."""
NOT_ON_GROUND = {"rider"}
"""Sits on the model `bicycle`, at the same place."""
FIRST = sorted({m.group: m.name for m in reversed(library().values())}.values())
"""One model of each group; one writer wrote all of them."""


def meshes(stage: Usd.Stage) -> dict[str, Part]:
    """Triangles by name of the mesh."""
    found = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get(), dtype=np.float64)
            found[prim.GetName()] = Part(
                points, np.array(mesh.GetFaceVertexIndicesAttr().Get(), dtype=np.int64).reshape(-1, 3), prim.GetName()
            )
    return found


@pytest.mark.parametrize("name", NAMES)
def test_model_stands_on_the_ground_and_has_the_size_of_its_class(name):
    """Least z within 2 cm of 0, the origin inside the footprint, extents within the limits of the class."""
    m = library()[name]
    stage = Usd.Stage.Open(str(m.path))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert m.label in cityscapes.LABELS
    if name not in NOT_ON_GROUND:
        assert abs(m.low[2]) <= (0.09 if name in ROOTED else 0.02)
    assert m.low[0] <= 0 <= m.high[0]
    assert m.low[1] <= 0 <= m.high[1]
    for extent, (least, most) in zip((m.length, m.width, m.height), SIZES[m.label], strict=True):
        assert least <= extent <= most
    stated = re.search(r"([\d.]+) m long", m.about)
    if stated:  # 3 %: rounded corners take a few centimetres, mirrors and plates give some
        assert m.length == pytest.approx(float(stated[1]), rel=0.03)


@pytest.mark.parametrize("name", FIRST)
def test_every_validator_of_usd_is_content_with_a_model(name):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    stage = Usd.Stage.Open(str(library()[name].path))
    assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []


def kinds_in(layer: Sdf.Layer) -> set[str]:
    """Types of the prims that a layer defines, within variants too."""
    found = set()

    def visit(path: Sdf.Path) -> None:
        if path.IsPrimPath() or path.IsPrimVariantSelectionPath():
            spec = layer.GetPrimAtPath(path)
            found.update({spec.typeName} if spec and spec.specifier == Sdf.SpecifierDef else ())

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return found - {""}


@pytest.mark.parametrize("name", FIRST)
def test_a_model_is_divided_as_the_working_group_advises(name):
    """Meshes in payloads, materials in a layer of their own, neither in the interface."""
    path = library()[name].path
    interface, materials = Sdf.Layer.FindOrOpen(str(path)), Sdf.Layer.FindOrOpen(str(path.with_suffix(".mtl.usda")))
    assert kinds_in(interface).isdisjoint({"Mesh", "Material", "Shader"})
    assert kinds_in(materials) == {"Xform", "Scope", "Material", "Shader"}
    payloads = sorted(path.parent.glob("*.geo.usdc"))
    assert payloads
    for file in payloads:
        assert kinds_in(Sdf.Layer.FindOrOpen(str(file))) == {"Scope", "Mesh"}
    assert {f.name for f in path.parent.glob("*.usd*")} == {path.name, f"{name}.mtl.usda", *(f.name for f in payloads)}
    layers, _, missing = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(str(path)))
    assert {Path(layer.realPath) for layer in layers} == set(path.parent.glob("*.usd*"))  # every file is reached
    assert missing == []
    unloaded = Usd.Stage.Open(str(path), Usd.Stage.LoadNone)
    sets = unloaded.GetDefaultPrim().GetVariantSets()
    assert {key: tuple(sets.GetVariantSet(key).GetVariantNames()) for key in sets.GetNames()} == library()[
        name
    ].variants
    assert not meshes(unloaded)
    unloaded.Load()
    assert meshes(unloaded)


def test_unknown_models_and_files_that_are_none_are_told(tmp_path):
    with pytest.raises(StageError, match=r"no model 'taksi'\. Did you mean 'taxi'"):
        model("taksi")
    for text, said in (
        ("#usda 1.0\n", "default prim"),
        ('#usda 1.0\n(defaultPrim = "A")\ndef Xform "A" {}\n', "0 Cityscapes labels"),
    ):
        path = tmp_path / f"{len(text)}.usda"
        path.write_text(text)
        with pytest.raises(StageError, match=said):
            read(path)
    empty = tmp_path / "empty.usda"
    layer = Sdf.Layer.CreateNew(str(empty))
    stage = Usd.Stage.Open(layer)
    prim = UsdGeom.Xform.Define(stage, "/A").GetPrim()
    stage.SetDefaultPrim(prim)
    prim.CreateAttribute("semantics:labels:cityscapes", Sdf.ValueTypeNames.TokenArray).Set(["car"])
    layer.Save()
    with pytest.raises(StageError, match="no geometry"):
        read(empty)

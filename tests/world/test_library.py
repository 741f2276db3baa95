"""The model library: every model opens, stands on the ground, has the size of what it is, and looks as its variants
say.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade, UsdUtils, UsdValidation

from synfog_usd.base import cityscapes
from synfog_usd.base.errors import StageError
from synfog_usd.world.library import SIZES, library, model, of_group, read
from synfog_usd.world.shapes import Part

NAMES = [name for name, m in library().items() if m.group != "ground"]
ROOTED = {"bare_tree", "lime_tree", "maple_tree", "park_tree"}
"""Trees of the crossing whose trunks begin up to 9 cm below the ground."""
NOT_ON_GROUND = {"rider"}
"""Sits on the model `bicycle`, at the same place."""
FIRST = sorted({m.group: m.name for m in reversed(library().values())}.values())
"""One model of each group; one writer wrote all of them."""


def shown(name: str, **variants: str) -> Usd.Stage:
    """A stage that refers to the model, with variants chosen."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    prim = UsdGeom.Xform.Define(stage, "/Model").GetPrim()
    prim.GetReferences().AddReference(str(library()[name].path))
    for set_name, choice in variants.items():
        assert prim.GetVariantSets().GetVariantSet(set_name).SetVariantSelection(choice)
    return stage


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


def test_library_has_what_streets_and_roads_need():
    """Twelve vehicles over seven body types, twelve people, riders, three lamps, several plants and buildings."""
    powered = [m for m in of_group("vehicle") if m.label in ("car", "truck", "bus")]
    assert len(powered) >= 12
    assert len({m.label for m in powered}) == 3
    assert len(of_group("person")) >= 12
    assert len(of_group("rider")) >= 3
    assert {m.name for m in of_group("lamp")} == {"street_lamp", "lamp_mast_double", "lamp_post_top"}
    assert len(of_group("plant")) >= 7
    assert len(of_group("building")) >= 15


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


@pytest.mark.parametrize("name", NAMES)
def test_every_variant_composes_and_every_mesh_wears_a_material(name):
    for set_name, choices in library()[name].variants.items():
        seen = set()
        for choice in choices:
            stage = shown(name, **{set_name: choice})
            assert stage.GetCompositionErrors() == []
            worn = []
            for prim in stage.Traverse():
                if prim.IsA(UsdGeom.Mesh):
                    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
                    assert material, f"{prim.GetPath()} wears nothing"
                    faces = len(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get())
                    worn.append((prim.GetName(), material.GetPrim().GetName(), faces))
                if prim.IsA(UsdShade.Shader):
                    worn += [
                        (str(prim.GetPath()), i.GetBaseName(), str(i.Get())) for i in UsdShade.Shader(prim).GetInputs()
                    ]
                if prim.HasAPI(UsdLux.LightAPI):
                    worn.append((prim.GetName(), "light", 0))
            assert worn
            seen.add(tuple(worn))
        assert len(seen) == len(choices), f"{set_name}: two of {choices} look the same"


def test_riders_and_what_they_ride_have_their_own_labels():
    stage = shown("motorcyclist")
    labels = {
        p.GetName(): p.GetAttribute("semantics:labels:cityscapes").Get()
        for p in stage.Traverse()
        if p.IsA(UsdGeom.Mesh)
    }
    assert list(labels["tyre"]) == list(labels["paint"]) == ["motorcycle"]
    assert labels["coat"] is None  # of the model: rider
    assert library()["motorcyclist"].label == "rider"


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

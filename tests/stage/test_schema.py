"""The schema that is shipped, the one in Python, and what `check` finds."""

from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom, UsdLux

from synfog_usd.stage import check, open_stage, register
from synfog_usd.stage.schema import API_NAME, DEFAULTS, PLUGIN_FOLDER, PREFIX, read_fog

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "usd"


def test_the_plugin_is_known_and_its_fallbacks_are_those_in_python():
    """Two places say what holds where nothing is authored; they say the same."""
    register()
    definition = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition(API_NAME)
    names = {name.removeprefix(PREFIX) for name in definition.GetPropertyNames()}
    assert names == set(DEFAULTS)
    for name, value in DEFAULTS.items():
        fallback = definition.GetAttributeFallbackValue(PREFIX + name)
        assert fallback == (pytest.approx(value) if isinstance(value, float) else value), name


def test_the_source_and_the_generated_schema_agree():
    """`python -m pxr.Usd.usdGenSchema schema.usda .` in the plugin's folder remakes the generated one."""
    source, generated = (
        Sdf.Layer.OpenAsAnonymous(str(PLUGIN_FOLDER / name)) for name in ("schema.usda", "generatedSchema.usda")
    )
    specs = [
        {p.name: (p.default, p.typeName, p.variability) for p in layer.GetPrimAtPath(f"/{API_NAME}").properties}
        for layer in (source, generated)
    ]
    assert specs[0] == specs[1]


def test_an_applied_schema_shows_its_fallbacks():
    stage = Usd.Stage.CreateInMemory()
    prim = UsdGeom.Cube.Define(stage, "/Fog").GetPrim()
    assert read_fog(prim, Usd.TimeCode.Default()) is None
    assert prim.ApplyAPI(API_NAME)
    assert prim.GetAttribute(PREFIX + "g").Get() == pytest.approx(0.87)
    found = read_fog(prim, Usd.TimeCode.Default())
    assert dict(found.values) == dict(DEFAULTS) and dict(found.attribute_of) == {}


def test_values_are_as_they_were_typed():
    """A float of 0.87 is 0.87, not the nearest binary fraction of 24 bits."""
    stage = Usd.Stage.CreateInMemory()
    prim = UsdGeom.Cube.Define(stage, "/Fog").GetPrim()
    prim.CreateAttribute(PREFIX + "g", Sdf.ValueTypeNames.Float).Set(0.87)
    assert read_fog(prim, Usd.TimeCode.Default()).values["g"] == 0.87


def findings(stage):
    return {(note.path, note.text.split(";")[0].split(":")[0]) for note in check(stage)}


def test_check_finds_what_a_render_would_miss():
    """No camera, no fog, a label that Cityscapes does not have, and shapes without one."""
    stage = Usd.Stage.CreateInMemory()
    stage.SetDefaultPrim(stage.DefinePrim("/World", "Xform"))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.Cube.Define(stage, "/World/A")
    UsdGeom.Cube.Define(stage, "/World/B").GetPrim().CreateAttribute(
        "userProperties:cityscapes", Sdf.ValueTypeNames.String
    ).Set("ufo")
    assert findings(stage) == {
        ("", "the stage has no camera"),
        ("", "the stage has no fog"),
        ("", "the stage has no light and no emissive material"),
        ("/World/B", "label 'ufo' is not a Cityscapes name"),
        ("/World/A", "1 prims have no label (semantics"),
    }


def test_check_finds_a_camera_outside_of_its_fog():
    stage = Usd.Stage.CreateInMemory()
    stage.SetDefaultPrim(stage.DefinePrim("/World", "Xform"))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    fog = UsdGeom.Cube.Define(stage, "/World/Fog")
    fog.CreatePurposeAttr("guide")
    fog.GetPrim().ApplyAPI(API_NAME)
    UsdLux.SphereLight.Define(stage, "/World/Lamp")
    UsdGeom.Camera.Define(stage, "/World/In")
    assert findings(stage) == set()
    UsdGeom.Camera.Define(stage, "/World/Out").AddTranslateOp().Set((5, 0, 0))
    assert findings(stage) == {("/World/Out", "stands outside of every fog boundary")}


def test_check_passes_on_what_usd_itself_finds():
    """A stage without metersPerUnit and upAxis is legal, and a trap."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.Camera.Define(stage, "/Camera")
    texts = [note.text for note in check(stage) if note.text.startswith("usd: ")]
    assert any("metersPerUnit" in text for text in texts) and any("upAxis" in text for text in texts)


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the real files beside the project")
def test_check_finds_the_missing_volume_of_the_example():
    assert any("fogbank.vdb" in note.text for note in check(open_stage(SHARED / "example_street.usda")))

"""The schema that is shipped, the one in Python, and what `check` finds."""

from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom

from synfog_usd.stage import check, open_stage, register
from synfog_usd.stage.schema import API_NAME, DEFAULTS, PLUGIN_FOLDER, PREFIX, full_name_of, read_fog

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "usd"


def test_the_plugin_is_known_and_its_fallbacks_are_those_in_python():
    """Two places say what holds where nothing is authored; they say the same."""
    register()
    definition = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition(API_NAME)
    assert set(definition.GetPropertyNames()) == set(map(full_name_of, DEFAULTS))
    for name, value in DEFAULTS.items():
        fallback = definition.GetAttributeFallbackValue(full_name_of(name))
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


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the real files beside the project")
def test_check_finds_the_missing_volume_of_the_example():
    assert any("fogbank.vdb" in note.text for note in check(open_stage(SHARED / "example_street.usda")))

"""No single opinion of a material refuses a stage: any input, any type, any connection."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, UsdGeom, UsdShade
from support.looks import SQUARE, TYPES, fill, shade

from synfog_usd.translate import translate

NAMES = (
    *("Bool", "Int", "Float", "Double", "Half2", "Float3", "Color4f", "String", "Token", "Asset", "Matrix4d", "Quatf"),
    *("TimeCode", "IntArray", "FloatArray", "Color3fArray", "StringArray", "TokenArray", "AssetArray", "Matrix3dArray"),
)
ALL_TYPES = [getattr(TYPES, name) for name in NAMES]
"""One of each kind of value: numbers, tuples of them, words, paths and arrays."""

INPUTS = {
    "Surface": "diffuseColor emissiveColor useSpecularWorkflow specularColor metallic roughness clearcoat"
    " clearcoatRoughness opacity opacityMode opacityThreshold ior normal displacement occlusion",
    "Picture": "file st wrapS wrapT fallback scale bias sourceColorSpace",
    "Turn": "in rotation scale translation",
    "Reader": "varname fallback",
    "Tint": "varname fallback",
    "Rough": "varname fallback",
}


@pytest.fixture
def painted(empty, tmp_path):
    """A stage on which each square of some number has a material of its own, with a picture and readers."""

    def make(count):
        stage = empty()
        for k in range(count):
            mesh = UsdGeom.Mesh.Define(stage, f"/Mesh{k}")
            fill(mesh, points=[(x + 2.0 * k, y, z) for x, y, z in SQUARE], faceVertexCounts=[4])
            fill(mesh, faceVertexIndices=[0, 1, 2, 3], subdivisionScheme="none")
            api = UsdGeom.PrimvarsAPI(mesh)
            api.CreatePrimvar("st", TYPES.TexCoord2fArray, "vertex").Set([(0, 0), (1, 0), (1, 1), (0, 1)])
            api.CreatePrimvar("tint", TYPES.Color3f).Set((0.5, 0.25, 0.125))
            material = UsdShade.Material.Define(stage, f"/M{k}")
            UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
            at = f"/M{k}/"
            reader = shade(stage, at + "Reader", "UsdPrimvarReader_float2", "result", TYPES.Float2, varname="st")
            turn = shade(stage, at + "Turn", "UsdTransform2d", "result", TYPES.Float2, **{"in": reader})
            color = {"file": Path("gone.png"), "st": turn}
            inputs = {
                "diffuseColor": shade(stage, at + "Picture", "UsdUVTexture", "rgb", TYPES.Float3, **color),
                "specularColor": shade(
                    stage, at + "Tint", "UsdPrimvarReader_float3", "result", TYPES.Float3, varname="tint"
                ),
                "clearcoat": shade(
                    stage, at + "Rough", "UsdPrimvarReader_float", "result", TYPES.Float, varname="none"
                ),
            }
            surface = shade(stage, at + "Surface", "UsdPreviewSurface", "surface", **inputs)
            material.CreateSurfaceOutput().ConnectToSource(surface)
        return stage

    return make


def write(stage, prim, name, kind, *, value=None, connection=None):
    """An input of a type of its own, in the place of what stands there."""
    spec = stage.GetRootLayer().GetPrimAtPath(prim)
    if f"inputs:{name}" in spec.properties:
        del spec.properties[f"inputs:{name}"]
    made = Sdf.AttributeSpec(spec, f"inputs:{name}", kind)
    if value is not None:
        made.default = value
    if connection is not None:
        made.connectionPathList.explicitItems = [Sdf.Path(connection)]


def values_of(kind):
    """A few values of a type."""
    one = kind.scalarType.defaultValue
    if isinstance(one, str):
        one = "word"
    elif isinstance(one, (bool, int, float)):
        one = type(one)(1)
    elif isinstance(one, Sdf.AssetPath):
        one = Sdf.AssetPath("other.png")
    if not kind.isArray:
        return [one]
    array = type(kind.defaultValue)
    return [array([]), array([one] * 3)]


def drawn_all(stage, count):
    """The scene of a stage of which every mesh is drawn by its own material."""
    scene = translate(stage)
    assert len([key for key in scene.world if key.startswith("shape_")]) == count
    assert not [note for note in scene.notes if "cannot be read" in note.text]
    for key, shape in scene.world.items():
        if key.startswith("shape_"):
            assert np.isfinite(shape["positions"]).all() and shape["bsdf"]["id"] in scene.world
    return scene


@pytest.mark.parametrize("shader", INPUTS)
def test_an_input_of_any_type_is_drawn(painted, shader):
    names = INPUTS[shader].split()
    cases = [(name, kind, value) for name in names for kind in ALL_TYPES for value in values_of(kind)]
    stage = painted(len(cases))
    for k, (name, kind, value) in enumerate(cases):
        write(stage, f"/M{k}/{shader}", name, kind, value=value)
    drawn_all(stage, len(cases))


CONNECTIONS = {
    "a prim that is missing": "/Gone.outputs:out", "an output that is missing": "{m}/Picture.outputs:gone",
    "an output of another kind": "{m}/Surface.outputs:surface", "a shader of another kind": "{m}/Reader.outputs:result",
    "a picture's alpha": "{m}/Picture.outputs:a", "its own output": "{m}/{s}.outputs:result",
    "its own input": "{m}/{s}.inputs:{n}", "another input": "{m}/Picture.inputs:scale",
    "an attribute of a mesh": "/Mesh0.points", "a prim": "{m}/Picture",
    "another material's shader": "/M0/Tint.outputs:result", "an interface without a value": "{m}.inputs:knob",
    "an interface in a circle": "{m}.inputs:circle",
}  # fmt: skip


@pytest.mark.parametrize("shader", INPUTS)
def test_an_input_of_any_connection_is_drawn(painted, shader):
    cases = [(name, target) for name in INPUTS[shader].split() for target in CONNECTIONS.values()]
    stage = painted(len(cases))
    for k, (name, target) in enumerate(cases):
        write(stage, f"/M{k}", "knob", TYPES.Float3)
        write(stage, f"/M{k}", "circle", TYPES.Float3, connection=f"/M{k}.inputs:circle")
        connection = target.format(m=f"/M{k}", s=shader, n=name)
        write(stage, f"/M{k}/{shader}", name, TYPES.Float3, value=Gf.Vec3f(0.5), connection=connection)
    drawn_all(stage, len(cases))


@pytest.mark.parametrize("shader, name, kind, value, path, wanted", [
    ("Picture", "fallback", TYPES.Float3, Gf.Vec3f(0.75, 0.5, 0.25), "base_color", [0.75, 0.5, 0.25]),
    ("Surface", "diffuseColor", TYPES.Float, 0.25, "base_color", [0.25] * 3),
    ("Surface", "diffuseColor", TYPES.Color4f, Gf.Vec4f(0.75, 0.5, 0.25, 1), "base_color", [0.75, 0.5, 0.25]),
    ("Surface", "roughness", TYPES.Token, "rough", "roughness", 0.5),
    ("Surface", "ior", TYPES.Int, 2, "eta", 2.0),
])  # fmt: skip
def test_what_fits_of_a_value_is_taken(painted, shader, name, kind, value, path, wanted):
    stage = painted(1)
    write(stage, f"/M0/{shader}", name, kind, value=value)
    scene = drawn_all(stage, 1)
    bsdf = scene.world[scene.world["shape_0"]["bsdf"]["id"]]["bsdf"]
    found = bsdf[path]["value"] if path == "base_color" else bsdf[path]
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


@pytest.mark.parametrize("name, kind, value, path, wanted", [
    ("ior", TYPES.Float, 0.0, "type", "diffuse"),
    ("ior", TYPES.Float, 50.0, "eta", 50.0),
    ("roughness", TYPES.Float, 1.5, "roughness", 1.0),
    ("diffuseColor", TYPES.Color3f, Gf.Vec3f(2, 0.5, -1), "base_color", [1.0, 0.5, 0.0]),
    ("opacityMode", TYPES.Token, "glassy", None, None),
])  # fmt: skip
def test_a_value_that_no_surface_has_is_told_and_the_nearest_one_drawn(painted, name, kind, value, path, wanted):
    stage = painted(1)
    write(stage, "/M0/Surface", name, kind, value=value)
    scene = drawn_all(stage, 1)
    bsdf = scene.world[scene.world["shape_0"]["bsdf"]["id"]]["bsdf"]
    if path == "type":
        assert bsdf["type"] == wanted
    elif path is not None:
        np.testing.assert_allclose(bsdf[path]["value"] if path == "base_color" else bsdf[path], wanted)
    (note,) = [note for note in scene.notes if note.path == "/M0/Surface" and note.text.startswith(name)]
    assert note.severity == "warning"


def test_a_picture_that_reflects_more_than_it_gets_is_told(painted, tmp_path):
    """A picture from 0 to 1 by a scale of 2: its bright half is white."""
    stage = painted(1)
    pixels = np.repeat(np.array([[[0, 0, 0], [102, 102, 102], [204, 204, 204], [255, 255, 255]]], np.uint8), 4, axis=0)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    write(stage, "/M0/Picture", "file", TYPES.Asset, value=Sdf.AssetPath(str(tmp_path / "a.png")))
    write(stage, "/M0/Picture", "sourceColorSpace", TYPES.Token, value="raw")
    write(stage, "/M0/Picture", "scale", TYPES.Float4, value=Gf.Vec4f(2, 2, 2, 1))
    write(stage, "/M0/Surface", "diffuseColor", TYPES.Float3, connection="/M0/Picture.outputs:rgb")
    scene = drawn_all(stage, 1)
    colour = scene.world[scene.world["shape_0"]["bsdf"]["id"]]["bsdf"]["base_color"]["bitmap"]
    np.testing.assert_allclose(np.unique(colour), [0.0, 0.8, 1.0], atol=1e-6)
    (note,) = [note for note in scene.notes if note.path == "/M0/Surface" and "picture" in note.text]
    assert note.text.startswith("the picture of diffuseColor has values from 0 to 2, and 0 to 1 can be drawn")

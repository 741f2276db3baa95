"""Words and sizes that make no sense: each is told with its prim and what is taken instead."""

import re

import numpy as np
import pytest
from support.looks import write

from synfog_usd.base.errors import StageError
from synfog_usd.stage import open_stage
from synfog_usd.translate import translate

HEAD = '#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n)\n'
PLATE = """def Mesh "Plate"
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, -5), (1, 0, -5), (1, 1, -5), (0, 1, -5)]
    uniform token subdivisionScheme = "catmullClark"
"""


CUBE = 'def Cube "Box"\n{\n    double size = 2\n}\n'
CURVE = """def BasisCurves "Line"
{
    int[] curveVertexCounts = [4]
    point3f[] points = [(0, 0, -5), (1, 1, -5), (2, 0, -5), (3, 1, -5)]
    float[] widths = [0.1] (interpolation = "constant")
    uniform token type = "cubic"
    uniform token basis = "catmullRom"
    uniform token wrap = "pinned"
}
"""
DOME = """def DomeLight_1 "Sky"
{
    asset inputs:texture:file = @sky.png@
    token poleAxis = "Z"
}
"""
PICTURE = """def Mesh "Plate" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, -5), (1, 0, -5), (1, 1, -5), (0, 1, -5)]
    texCoord2f[] primvars:st = [(0, 0), (2, 0), (2, 2), (0, 2)] (interpolation = "vertex")
    uniform token subdivisionScheme = "none"
    rel material:binding = </Look>
}
def Material "Look" {
    token outputs:surface.connect = </Look/Surface.outputs:surface>
    def Shader "Surface" {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </Look/Picture.outputs:rgb>
        token outputs:surface
    }
    def Shader "Picture" {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @sky.png@
        float2 inputs:st.connect = </Look/Reader.outputs:result>
        token inputs:wrapS = "repeat"
        token inputs:wrapT = "repeat"
        token inputs:sourceColorSpace = "sRGB"
        float3 outputs:rgb
    }
    def Shader "Reader" {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
"""


@pytest.mark.parametrize("prims, path, line, taken", [
    (PLATE + '    token visibility = "invisible"\n}\n', "/Plate", "visibility", "inherited"),
    (PLATE + "}\n", "/Plate", "subdivisionScheme", "none"),
    (PLATE + '    uniform token orientation = "leftHanded"\n}\n', "/Plate", "orientation", "rightHanded"),
    (PLATE + '    token interpolateBoundary = "edgeOnly"\n}\n', "/Plate", "interpolateBoundary", "edgeAndCorner"),
    (CURVE, "/Line", "wrap", "nonperiodic"),
    (DOME, "/Sky", "poleAxis", "scene"),
    (PICTURE, "/Look/Picture", "inputs:wrapS", "useMetadata"),
    (PICTURE, "/Look/Picture", "inputs:sourceColorSpace", "raw"),
])  # fmt: skip
def test_a_token_that_usd_does_not_know_is_told_and_another_one_drawn(tmp_path, prims, path, line, taken):
    """The note names prim, attribute, what stands there and what is taken; the scene is that of what is taken."""
    write(tmp_path / "sky.png", np.arange(2 * 4 * 3, dtype=np.uint8).reshape(2, 4, 3) * 10)

    def scene(value):
        text, found = re.subn(rf'(token {line} = )"\w+"', rf'\1"{value}"', prims)
        assert found == 1
        (tmp_path / "a.usda").write_text(HEAD + 'def Camera "Ego" {}\n' + text + CUBE.replace("Box", "Else"))
        return translate(open_stage(tmp_path / "a.usda"))

    odd, plain = scene("smooothed"), scene(taken)
    np.testing.assert_equal(dict(odd.world), dict(plain.world))
    (note,) = [one for one in odd.notes if "smooothed" in one.text]
    assert (note.severity, note.path) == ("warning", path)
    assert f"{line.removeprefix('inputs:')} is 'smooothed'" in note.text and note.text.endswith(f"; {taken!r} is taken")


@pytest.mark.parametrize("op", ["float xformOp:translate", "double3 xformOp:moveIt"])
def test_a_transform_that_is_none_is_refused_with_its_prim(tmp_path, op):
    """Of a prim above what is drawn, whose place nobody knows."""
    moved = (
        f'{{\n    {op} = {5 if "float" in op else (5, 0, 0)}\n    uniform token[] xformOpOrder = ["{op.split()[1]}"]\n'
    )
    (tmp_path / "a.usda").write_text(
        HEAD + f'def Camera "Ego" {{}}\ndef Xform "Up"\n{moved}    def Cube "C" {{}}\n}}\n'
    )
    with pytest.raises(StageError, match=r"^/Up/C: an xformOp of this prim, or of one above it"):
        translate(open_stage(tmp_path / "a.usda"))


@pytest.mark.parametrize("kind, name", [("SphereLight", "radius"), ("RectLight", "width"), ("DistantLight", "angle")])
def test_a_light_of_a_size_below_zero_is_told_and_of_that_amount(tmp_path, kind, name):
    """A rectangle of negative width would shine the other way."""

    def scene(value):
        light = f'def {kind} "L"\n{{\n    float inputs:{name} = {value}\n}}\n'
        (tmp_path / "a.usda").write_text(HEAD + 'def Camera "Ego" {}\n' + light + CUBE)
        return translate(open_stage(tmp_path / "a.usda"))

    odd, plain = scene(-0.25), scene(0.25)
    np.testing.assert_equal(dict(odd.world), dict(plain.world))
    added = [(one.path, one.text) for one in odd.notes if one not in plain.notes]
    assert added == [("/L", f"inputs:{name} is -0.25, which is no size; 0.25 is taken")]

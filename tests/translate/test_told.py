"""Numbers that make no sense: each is told with its prim and what is taken instead."""

import re

import numpy as np
import OpenImageIO
import pytest

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


@pytest.mark.parametrize(
    "camera, prims, path, told",
    [
        ("float fStop = nan", "", "/Ego", "fStop is nan, which is no f-number; the lens is drawn as a pinhole"),
        ("float fStop = -2", "", "/Ego", "fStop is -2, which is no f-number"),
        (
            "float fStop = 2\n    float focalLength = 0.5\n    float focusDistance = nan",
            "",
            "/Ego",
            "focusDistance is nan, which is no distance; the lens is drawn as a pinhole",
        ),
        (
            "float2 clippingRange = (nan, 100)",
            "",
            "/Ego",
            "clippingRange begins at nan, which is no distance; 0.01 m is taken",
        ),
        (
            "",
            'def SphereLight "L" (\n    prepend apiSchemas = ["ShapingAPI"]\n)\n{\n    float '
            "inputs:shaping:cone:angle = nan\n}\n",
            "/L",
            "shaping:cone:angle is nan, which is no number; 90 is taken",
        ),
        (
            "",
            'def SphereLight "L"\n{\n    float inputs:shaping:cone:angle = 30\n    float inputs:shaping:cone:softness = 7\n}\n',  # noqa: E501
            "/L",
            "shaping:cone:softness is 7, which is out of range; 1 is taken",
        ),
        (
            "",
            'def SphereLight "L"\n{\n    float inputs:shaping:focus = -3\n}\n',
            "/L",
            "shaping:focus is -3, which is out of range; 0 is taken",
        ),
        (
            "",
            'def Cube "C"\n{\n    double3 xformOp:translate = (0, 0, -5)\n}\n',
            "/C",
            "has xformOps and no xformOpOrder, without which USD moves nothing",
        ),
        (
            "",
            'def Cube "C"\n{\n    double3 xformOp:translate = (0, 0, -5)\n    uniform token[] xformOpOrder = '
            '["!resetXformStack!", "xformOp:translate", "!invert!xformOp:translate:pivot"]\n}\n',
            "/C",
            "xformOpOrder names '!invert!xformOp:translate:pivot', which is not there; the prim stands without it",
        ),
        ("", 'def SphereLight "L"\n{\n    float inputs:intensity = -5\n}\n', "/L", "negative light is not drawn"),
        (
            "",
            'def DomeLight "L"\n{\n    color3f inputs:color = (1, -1, 1)\n}\n',
            "/L",
            "negative light is not drawn; it is taken as 0 in that channel",
        ),
        (
            "",
            'def DomeLight "L"\n{\n    asset inputs:texture:file = @./sky.tex@\n}\n',
            "/L",
            "texture ./sky.tex cannot be read; the light is of one colour",
        ),
        (
            "",
            PLATE
            + "    int[] creaseIndices = [0, 99]\n    int[] creaseLengths = [2]\n    float[] creaseSharpnesses = [2]\n}\n",  # noqa: E501
            "/Plate",
            "1 edges of its creases name points outside of its 4; they are left out",
        ),
        (
            "",
            PLATE
            + "    int[] creaseIndices = [0, 1]\n    int[] creaseLengths = [5]\n    float[] creaseSharpnesses = [2]\n}\n",  # noqa: E501
            "/Plate",
            "its creases' indices, lengths and sharpnesses do not fit each other; no crease is drawn",
        ),
        (
            "",
            PLATE + "    int[] cornerIndices = [0, -3]\n    float[] cornerSharpnesses = [2, 2]\n}\n",
            "/Plate",
            "1 of its 2 sharp corners name no point",
        ),
        (
            "",
            PLATE
            + "    int[] creaseIndices = [1, 0, 2]\n    int[] creaseLengths = [3]\n    float[] creaseSharpnesses = [2]\n}\n",  # noqa: E501
            "/Plate",
            "1 edges of its creases are no edges of its faces; they are left out",
        ),
        ("", PLATE + "    int[] holeIndices = [-1, 7]\n}\n", "/Plate", "2 of its 2 holes name no face of its 1"),
    ],
)
def test_what_makes_no_sense_is_told_with_what_is_taken(tmp_path, camera, prims, path, told):
    (tmp_path / "sky.tex").write_bytes(b"no picture")
    (tmp_path / "a.usda").write_text(HEAD + f'def Camera "Ego"\n{{\n    {camera}\n}}\n' + prims)
    scene = translate(open_stage(tmp_path / "a.usda"))
    assert [
        note.text.startswith(told) for note in scene.notes if note.path == path and note.severity == "warning"
    ].count(True) == 1
    assert scene.camera.near_m > 0.0 and scene.camera.f_number == 0.0


CUBE = 'def Cube "Box"\n{\n    double size = 2\n}\n'
HOUSE = """def Xform "House" (
    kind = "component"
    prepend apiSchemas = ["GeomModelAPI"]
)
{
    uniform token model:drawMode = "cards"
    uniform token model:cardGeometry = "box"
    def Cube "Body" {}
}
"""
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
PATCH = """def NurbsPatch "Patch"
{
    int uVertexCount = 2
    int vVertexCount = 2
    int uOrder = 2
    int vOrder = 2
    double[] uKnots = [0, 0, 1, 1]
    double[] vKnots = [0, 0, 1, 1]
    point3f[] points = [(0, 0, -5), (1, 0, -5), (0, 1, -5), (1, 1, -5)]
    uniform token orientation = "leftHanded"
}
"""
DOME = """def DomeLight_1 "Sky"
{
    asset inputs:texture:file = @sky.png@
    token poleAxis = "Z"
}
"""
PICTURE = """def Mesh "Plate" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, -5), (1, 0, -5), (1, 1, -5), (0, 1, -5)]
    texCoord2f[] primvars:st = [(0, 0), (2, 0), (2, 2), (0, 2)] (interpolation = "vertex")
    uniform token subdivisionScheme = "none"
    rel material:binding = </Look>
}
def Material "Look"
{
    token outputs:surface.connect = </Look/Surface.outputs:surface>
    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </Look/Picture.outputs:rgb>
        token outputs:surface
    }
    def Shader "Picture"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @sky.png@
        float2 inputs:st.connect = </Look/Reader.outputs:result>
        token inputs:wrapS = "repeat"
        token inputs:wrapT = "repeat"
        token inputs:sourceColorSpace = "sRGB"
        float3 outputs:rgb
    }
    def Shader "Reader"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
"""
MATERIALX = (
    PICTURE.replace('"UsdUVTexture"', '"ND_image_color3"')
    .replace("outputs:rgb", "outputs:out")
    .replace("inputs:st.connect", "inputs:texcoord.connect")
    .replace('wrapS = "repeat"', 'uaddressmode = "clamp"')
    .replace("UsdPrimvarReader_float2", "ND_geompropvalue_vector2")
    .replace("@sky.png@", '@sky.png@ (colorSpace = "srgb_texture")')
)


@pytest.mark.parametrize(
    "prims, path, line, name, taken",
    [
        (PLATE + '    token visibility = "invisible"\n}\n', "/Plate", "visibility", "visibility", "inherited"),
        (PLATE + '    uniform token purpose = "render"\n}\n', "/Plate", "purpose", "purpose", "guide"),
        (PLATE + "}\n", "/Plate", "subdivisionScheme", "subdivisionScheme", "none"),
        (PLATE + '    uniform token orientation = "leftHanded"\n}\n', "/Plate", "orientation", "", "rightHanded"),
        (
            PLATE + '    token interpolateBoundary = "edgeOnly"\n}\n',
            "/Plate",
            "interpolateBoundary",
            "",
            "edgeAndCorner",
        ),
        (
            PLATE + '    token triangleSubdivisionRule = "smooth"\n}\n',
            "/Plate",
            "triangleSubdivisionRule",
            "",
            "catmullClark",
        ),
        (
            PLATE + '    token faceVaryingLinearInterpolation = "all"\n}\n',
            "/Plate",
            "faceVaryingLinearInterpolation",
            "",
            "cornersPlus1",
        ),
        (CUBE.replace("Cube", "Cone").replace("double size = 2", 'uniform token axis = "X"'), "/Box", "axis", "", "Z"),
        (HOUSE, "/House", "model:drawMode", "", "default"),
        (HOUSE, "/House", "model:cardGeometry", "", "cross"),
        (CURVE, "/Line", "type", "", "cubic"),
        (CURVE, "/Line", "wrap", "", "nonperiodic"),
        (PATCH, "/Patch", "orientation", "", "rightHanded"),
        (DOME, "/Sky", "poleAxis", "", "scene"),
        (PICTURE, "/Look/Picture", "inputs:wrapS", "wrapS", "useMetadata"),
        (PICTURE, "/Look/Picture", "inputs:sourceColorSpace", "sourceColorSpace", "raw"),
        (MATERIALX, "/Look/Picture", "inputs:uaddressmode", "uaddressmode", "periodic"),
    ],
)
def test_a_token_that_usd_does_not_know_is_told_and_another_one_drawn(tmp_path, prims, path, line, name, taken):
    """The note names prim, attribute, what stands there and what is taken; the scene is that of what is taken."""
    picture = np.arange(2 * 4 * 3, dtype=np.uint8).reshape(2, 4, 3) * 10
    out = OpenImageIO.ImageOutput.create(str(tmp_path / "sky.png"))
    out.open(str(tmp_path / "sky.png"), OpenImageIO.ImageSpec(4, 2, 3, "uint8"))
    out.write_image(picture)
    out.close()

    def scene(value):
        text, found = re.subn(rf'(token {line} = )"\w+"', rf'\1"{value}"', prims)
        assert found == 1
        (tmp_path / "a.usda").write_text(HEAD + 'def Camera "Ego" {}\n' + text + CUBE.replace("Box", "Else"))
        return translate(open_stage(tmp_path / "a.usda"))

    odd, plain = scene("smooothed"), scene(taken)
    np.testing.assert_equal(dict(odd.world), dict(plain.world))
    (note,) = [one for one in odd.notes if "smooothed" in one.text]
    assert (note.severity, note.path) == ("warning", path)
    assert note.text.startswith(f"{name or line} is 'smooothed', which is none of ")
    assert note.text.endswith(f"; {taken!r} is taken")
    assert not [one for one in plain.notes if "none of" in one.text]


@pytest.mark.parametrize(
    "sharp, name",
    [
        ("int[] cornerIndices = [0, 1]\n    float[] cornerSharpnesses = [2, {}]", "cornerSharpnesses"),
        (
            "int[] creaseIndices = [0, 1, 2]\n    int[] creaseLengths = [3]\n    float[] creaseSharpnesses = [2, {}]",
            "creaseSharpnesses",
        ),
    ],
)
@pytest.mark.parametrize("value", ["-3", "nan"])
def test_a_sharpness_below_zero_is_told_and_smooth(tmp_path, sharp, name, value):
    def scene(number):
        plate = f'{PLATE}    token interpolateBoundary = "edgeOnly"\n    {sharp.format(number)}\n}}\n'
        (tmp_path / "a.usda").write_text(HEAD + 'def Camera "Ego" {}\n' + plate)
        return translate(open_stage(tmp_path / "a.usda"))

    odd, smooth = scene(value), scene("0")
    np.testing.assert_equal(dict(odd.world), dict(smooth.world))
    assert [(one.path, one.text) for one in odd.notes if one.severity == "warning"] == [
        ("/Plate", f"1 of its {name} are no sharpness, {value} first; 0 is taken")
    ]
    assert not [one for one in smooth.notes if one.severity == "warning"]


def test_a_colour_space_that_is_not_known_is_told(tmp_path):
    (tmp_path / "a.usda").write_text(
        HEAD + 'def Camera "Ego" {}\n' + MATERIALX.replace("srgb_texture", "acescg"), encoding="utf-8"
    )
    scene = translate(open_stage(tmp_path / "a.usda"))
    assert ("/Look/Picture", "a picture in colour space 'acescg' is read as linear Rec.709") in [
        (one.path, one.text) for one in scene.notes
    ]


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


@pytest.mark.parametrize(
    "kind, name",
    [
        ("SphereLight", "radius"),
        ("DiskLight", "radius"),
        ("RectLight", "width"),
        ("RectLight", "height"),
        ("CylinderLight", "length"),
        ("DistantLight", "angle"),
    ],
)
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


@pytest.mark.parametrize("value, taken", [(7, 1), (-1, 0), ("nan", 1)])
def test_an_opacity_that_is_none_is_told(tmp_path, value, taken):
    box = CUBE.replace("double size = 2", f"float[] primvars:displayOpacity = [{value}]")
    (tmp_path / "a.usda").write_text(HEAD + 'def Camera "Ego" {}\n' + box)
    scene = translate(open_stage(tmp_path / "a.usda"))
    told = [(one.path, one.text) for one in scene.notes if one.severity == "warning"]
    assert told == [("/Box", f"displayOpacity is {value}, which is no opacity; {taken} is taken")]

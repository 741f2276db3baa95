"""Numbers that make no sense: each is told with its prim and what is taken instead."""

import pytest

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
        (
            "",
            PLATE + "    int[] holeIndices = [-1, 7]\n}\n",
            "/Plate",
            "2 of its 2 holes name no face of its 1",
        ),
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

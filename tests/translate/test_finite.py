"""NaN and infinity anywhere on a stage: told by prim path, never in the scene; what a bake refuses, `check` refuses."""

import math

import numpy as np
import pytest
from support.cli import run
from support.looks import write as save

from synfog_usd.base.errors import StageError
from synfog_usd.camera.writers import read_exr
from synfog_usd.dataset.check import look
from synfog_usd.stage import open_stage
from synfog_usd.translate import translate

HEAD = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Z"
)
def Camera "Cam" {
    float2 clippingRange = (CLIP)
    float focalLength = FOCAL
    float horizontalAperture = 40
    float verticalAperture = 20
    LENS
    float3 xformOp:rotateXYZ = (90, 0, 0)
    double3 xformOp:translate = (PLACE, -1000, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
}
def DomeLight "Sky" {
    float inputs:intensity = 1000
}
"""
PLAIN = {"CLIP": "1, 100000", "FOCAL": "50", "LENS": "", "PLACE": "0"}
MESH = """def Mesh "C" (
    prepend apiSchemas = ["MaterialBindingAPI"]
)
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-150, 0, -150), (150, 0, -150), (150, 0, 150), (-150, 0, 150)]
    uniform token subdivisionScheme = "SCHEME"
    %s
}
"""
PAINT = """def Material "M" {
    token outputs:surface.connect = </M/S.outputs:surface>
    def Shader "S" {
        uniform token info:id = "UsdPreviewSurface"
        %s
        token outputs:surface
    }
    def Shader "T" {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @t.png@
        float2 inputs:st.connect = </M/X.outputs:result>
        %s
        float3 outputs:rgb
    }
    def Shader "X" {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </M/R.outputs:result>
        %s
        float2 outputs:result
    }
    def Shader "R" {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }
}
"""
BOUND = "rel material:binding = </M>\n"
PICTURE = "color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>"
ST = 'texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")\n'
MOVED = 'uniform token[] xformOpOrder = ["xformOp:{op}"]'


def mesh(line, *, scheme="none", more=""):
    return MESH.replace("SCHEME", scheme) % line + more


def painted(surface="", picture="", turn="", *, line=ST):
    return mesh(BOUND + line, more=PAINT % (surface, picture, turn))


def varying(name, kind, first, interpolation, rest="(0.5, 0.5, 0.5)"):
    count = {"vertex": 4, "varying": 4, "faceVarying": 4, "uniform": 1, "constant": 1}[interpolation]
    return f'{kind}[] {name} = [{", ".join([first, *[rest] * (count - 1)])}] (interpolation = "{interpolation}")'


def shapes(bad):
    """(text, path of the prim that is told) of each number that stands on shapes."""
    colour = f"({bad}, 0.5, 0.5)"
    yield mesh("").replace("(-150, 0, -150)", f"({bad}, 0, -150)"), "/C"
    lines = [varying("normals", "normal3f", f"({bad}, -1, 0)", "vertex", "(0, -1, 0)")]
    lines += [varying("primvars:displayOpacity", "float", bad, "vertex", "1")]
    lines += [varying("primvars:displayColor", "color3f", colour, how) for how in ("uniform", "constant")]
    moves = {"double3 xformOp:translate": f"(0, {bad}, 0)", "float3 xformOp:scale": f"(1, {bad}, 1)"}
    moves |= {"float3 xformOp:rotateXYZ": f"(0, {bad}, 0)", "quatf xformOp:orient": f"({bad}, 0, 0, 0)"}
    moves["matrix4d xformOp:transform"] = f"(({bad},0,0,0),(0,1,0,0),(0,0,1,0),(0,0,0,1))"
    lines += [f"{op} = {value}\n{MOVED.format(op=op.partition(':')[2])}" for op, value in moves.items()]
    yield from ((mesh(line), "/C") for line in lines)
    for scheme in ("none", "catmullClark"):
        for how in ("vertex", "faceVarying", "varying"):
            yield mesh(varying("primvars:displayColor", "color3f", colour, how), scheme=scheme), "/C"
        line = BOUND + varying("primvars:st", "texCoord2f", f"({bad}, 0)", "faceVarying", "(1, 1)")
        yield mesh(line, scheme=scheme, more=PAINT % (PICTURE, "", "")), "/C"
    sizes = "Sphere radius, Cube size, Cylinder height, Cone radius, Capsule radius, Plane width"
    for kind, size in map(str.split, sizes.split(", ")):
        yield f'def {kind} "G"\n{{\n    double {size} = {bad}\n}}\n', "/G"
    yield f'def Cone "G"\n{{\n    color3f[] primvars:displayColor = [{colour}]\n}}\n', "/G"
    tint = f'color3f[] primvars:displayColor = [({bad}, 1, 1), (1, 1, 1)] (interpolation = "vertex")'
    facing = f'normal3f[] normals = [({bad}, 1, 0), (0, 1, 0)] (interpolation = "vertex")'
    two = "    point3f[] points = [({0}, 0, 0), (100, 0, 0)]\n    float[] widths = [{1}, 9]%s\n    {2}\n}}\n"
    line = 'def BasisCurves "G"\n{{\n    uniform token type = "linear"\n    int[] curveVertexCounts = [2]\n'
    for given in ((bad, 9, ""), (0, bad, ""), (0, 9, tint), (0, 9, facing)):
        yield (line + two % ' (interpolation = "vertex")').format(*given), "/G"
    for given in ((bad, 9, ""), (0, bad, ""), (0, 9, tint)):
        yield ('def Points "G"\n{{\n' + two % "").format(*given), "/G"
    scattered = (
        'def PointInstancer "G"\n{{\n    point3f[] positions = [({0}, 0, 0), (100, 0, 0)]\n'
        '    int[] protoIndices = [0, 0]\n    {1}\n    rel prototypes = </G/P>\n    def Cube "P"\n    {{\n    }}\n}}\n'
    )
    yield scattered.format(bad, ""), "/G[0]"
    yield scattered.format(0, f"float3[] scales = [({bad}, 1, 1), (1, 1, 1)]"), "/G[0]"


def materials(bad):
    for name in ("diffuseColor", "emissiveColor", "specularColor"):
        workflow = "int inputs:useSpecularWorkflow = 1\n" if name == "specularColor" else ""
        yield painted(f"{workflow}color3f inputs:{name} = ({bad}, 0.5, 0.5)"), "/M/S"
    for name in ["roughness", "metallic", "ior", "opacity", "opacityThreshold", "clearcoat", "clearcoatRoughness"]:
        yield painted(f"float inputs:{name} = {bad}"), "/M/S"
    for name in ("scale", "bias", "fallback"):
        yield painted(PICTURE, f"float4 inputs:{name} = ({bad}, 1, 1, 1)"), "/M/T"
    yield painted(PICTURE, "", f"float inputs:rotation = {bad}"), "/M/X"
    yield painted(PICTURE, "", f"float2 inputs:scale = ({bad}, 1)"), "/M/X"


def lights(bad):
    every = "SphereLight radius exposure, RectLight width height, DiskLight radius, CylinderLight length radius"
    for kind, *names in map(str.split, f"{every}, DistantLight angle, DomeLight exposure".split(", ")):
        lines = [f"float inputs:{name} = {bad}" for name in ("intensity", *names)]
        lines += [
            f"color3f inputs:color = ({bad}, 1, 1)",
            f"bool inputs:enableColorTemperature = 1\n    float inputs:colorTemperature = {bad}",
            f"double3 xformOp:translate = ({bad}, 0, 0)\n    {MOVED.format(op='translate')}",
        ]
        yield from ((f'def {kind} "L"\n{{\n    {line}\n}}\n', "/L") for line in lines)
    glowing = mesh(f"float inputs:intensity = {bad}").replace('API"]', 'API", "MeshLightAPI"]', 1)
    yield glowing, "/C"


CAMERAS = [
    ({"CLIP": "{bad}, 1000"}, False),
    ({"LENS": "float fStop = 2\n    float focusDistance = {bad}"}, False),
    ({"FOCAL": "{bad}"}, True),
    ({"LENS": "float horizontalApertureOffset = {bad}"}, True),
    ({"PLACE": "{bad}"}, True),
]


@pytest.fixture
def written(tmp_path):
    """Write a stage, with a picture beside it."""

    def write(body, **changes):
        text = HEAD
        for word, given in {**PLAIN, **changes}.items():
            text = text.replace(word, given)
        save(tmp_path / "t.png", np.arange(48, dtype=np.uint8).reshape(4, 4, 3) * 5)
        (tmp_path / "a.usda").write_text(text + body, encoding="utf-8")
        return tmp_path / "a.usda"

    return write


def unsound(part, at=""):
    """Where numbers of a scene are not finite."""
    if isinstance(part, dict):
        return [place for name, value in part.items() for place in unsound(value, f"{at}/{name}")]
    if isinstance(part, (list, tuple)):
        return [place for number, value in enumerate(part) for place in unsound(value, f"{at}/{number}")]
    if isinstance(part, np.ndarray):
        return [at] if part.dtype.kind == "f" and not np.isfinite(part).all() else []
    return [at] if isinstance(part, float) and not math.isfinite(part) else []


def numbered(n, text, path):
    """A case whose prims have a number in their names: (text, path)."""
    for name in "CGLM":
        text = (
            text.replace(f'"{name}"', f'"{name}{n}"')
            .replace(f"</{name}/", f"</{name}{n}/")
            .replace(f"</{name}>", f"</{name}{n}>")
        )
    root, *below = path[1:].split("/")
    instance = root.partition("[")[1] + root.partition("[")[2]
    return text, "/".join(["", f"{root[0]}{n}{instance}", *below])


@pytest.mark.parametrize("bad", ["nan", pytest.param("inf", marks=pytest.mark.slow), "-inf"])
def test_a_number_that_is_none_is_told_of_its_prim_and_reaches_no_renderer(written, tmp_path, bad):
    """In every place of shapes, materials and lights; a bake of what check lets through ends well."""
    cases = [numbered(n, text, path) for n, (text, path) in enumerate((*shapes(bad), *materials(bad)))]
    lit = [numbered(n, text, path) for n, (text, path) in enumerate(lights(bad), start=1000)]
    for some in (cases, *(lit[k : k + 7] for k in range(0, len(lit), 7))):  # many alike are one note
        file = written("".join(text for text, _ in some))
        scene = translate(open_stage(file), resolution=(16, 8))
        assert not unsound(scene.world)
        assert np.isfinite(scene.bounds_m).all()
        assert {path for _, path in some} - {note.path for note in scene.notes} == set()
        found, notes, _ = look(file)
        assert not any(one.severity == "error" for one in found)
        assert {path for _, path in some} - {one.path for one in (*found, *notes)} == set()
    if bad != "-inf":
        file = written("".join(text for text, _ in cases))
        assert run("check", file).returncode == 0
        baked = run("bake", file, "-o", tmp_path / "out", "--resolution", "32x16", "--samples", "4")
        assert baked.returncode == 0, baked.stderr
        pixels = read_exr(tmp_path / "out" / "authored" / "authored" / "radiance.exr").pixels
        assert np.isfinite(pixels).all() and pixels.max() > 0.0


@pytest.mark.parametrize("bad", ["nan", "inf"])
@pytest.mark.parametrize("change, refused", CAMERAS, ids=[str(change) for change, _ in CAMERAS])
def test_a_camera_that_cannot_be_drawn_is_refused_by_check_too(written, change, refused, bad):
    file = written(mesh(""), **{word: given.format(bad=bad) for word, given in change.items()})
    found, notes, _ = look(file)
    errors = [one for one in found if one.severity == "error"]
    if not refused:
        assert not errors
        assert any(note.path == "/Cam" for note in notes)
        return
    with pytest.raises(StageError, match=r"^/Cam: ") as problem:
        translate(open_stage(file))
    assert [one.text for one in errors] == [str(problem.value)]
    baked = run("bake", file, "-o", file.parent / "out")
    assert baked.returncode == 2 and str(problem.value) in baked.stderr
    assert run("check", file).returncode == 2


def test_a_velocity_that_is_no_number_is_told_and_moves_nothing(written, bad="nan"):
    """While the shutter is open; the other point of the instancer goes on."""
    scattered = (
        'def PointInstancer "G"\n{\n    int[] protoIndices = [0, 0]\n'
        "    point3f[] positions.timeSamples = {1: [(-100, 0, 0), (100, 0, 0)]}\n"
        f"    vector3f[] velocities.timeSamples = {{1: [({bad}, 0, 0), (240, 0, 0)]}}\n"
        '    rel prototypes = </G/P>\n    def Cube "P"\n    {\n    }\n}\n'
    )
    file = written(
        mesh(f"vector3f physics:velocity = ({bad}, 0, 0)") + scattered,
        LENS="double shutter:open = -0.5\n    double shutter:close = 0.5",
    )
    scene = translate(open_stage(file), frame=1)
    told = {note.path: note.text for note in scene.notes if note.severity == "warning"}
    assert "physics:velocity" in told["/C"] and "velocities" in told["/G"]
    (way,) = scene.motion_of.values()  # 240 cm a second at 24 frames: 10 cm
    np.testing.assert_allclose(way[0, -1, :3, 3] - way[0, 0, :3, 3], [0.1, 0, 0], atol=1e-9)

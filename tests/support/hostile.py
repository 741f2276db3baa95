"""A stage with one of everything, and what a hostile author may write into it.

`TEXT` is sound; the fuzzers damage it.  `read` does with a text what `check` and `bake` do before they
render.
"""

import re
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np

from support.stages import street
from synfog_usd.base.errors import SynfogError
from synfog_usd.stage import check, open_stage, select, stage_hash, variants
from synfog_usd.translate import translate

EXTRA = """
def Xform "More" (prepend apiSchemas = ["GeomModelAPI"]) {
    def Mesh "Quad" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, 9, -1), (1, 9, -1), (1, 9, 1), (-1, 9, 1)]
        float3[] extent = [(-1, 9, -1), (1, 9, 1)]
        normal3f[] primvars:normals = [(0, -1, 0)] (interpolation = "constant")
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        int[] primvars:st:indices = [0, 1, 2, 3]
        color3f[] primvars:displayColor = [(0.5, 0.2, 0.1)]
        float[] primvars:displayOpacity = [1]
        int[] holeIndices = []
        int[] cornerIndices = [0]
        float[] cornerSharpnesses = [2]
        int[] creaseIndices = [0, 1]
        int[] creaseLengths = [2]
        float[] creaseSharpnesses = [3]
        uniform token subdivisionScheme = "catmullClark"
        uniform token interpolateBoundary = "edgeOnly"
        uniform token orientation = "leftHanded"
        uniform bool doubleSided = 1
        token visibility = "inherited"
        rel material:binding = </More/Tiles>
        def GeomSubset "Part" {
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [0]
            rel material:binding = </World/Paint>
        }
    }
    def BasisCurves "Wire" {
        int[] curveVertexCounts = [4]
        point3f[] points = [(0, 5, 0), (1, 5, 0), (1, 6, 0), (2, 6, 0)]
        float[] widths = [0.1]
        uniform token type = "cubic"
        uniform token basis = "bspline"
        uniform token wrap = "nonperiodic"
    }
    def Points "Dust" {
        point3f[] points = [(0, 7, 0)]
        float[] widths = [0.2]
    }
    def PointInstancer "Many" {
        rel prototypes = </More/Many/Ball>
        int[] protoIndices = [0, 0]
        int64[] ids = [1, 2]
        point3f[] positions = [(0, 8, 0), (1, 8, 0)]
        quath[] orientations = [(1, 0, 0, 0), (0, 1, 0, 0)]
        float3[] scales = [(1, 1, 1), (2, 2, 2)]
        vector3f[] velocities = [(0, 0, 0), (0, 0, 1)]
        int64[] invisibleIds = [1]
        def Sphere "Ball" {
            double radius = 0.3
        }
    }
    def Xform "Twin" (
        instanceable = true
        prepend references = </More/Many/Ball>
    ) {
        double3 xformOp:translate = (0, 3, 1)
        float3 xformOp:rotateXYZ = (0, 20, 0)
        float3 xformOp:scale = (1, 2, 1)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
    }
    def RectLight "Panel" {
        float inputs:intensity = 100
        float inputs:exposure = 1
        color3f inputs:color = (1, 0.9, 0.8)
        bool inputs:enableColorTemperature = 1
        float inputs:colorTemperature = 4000
        bool inputs:normalize = 1
        float inputs:width = 1
        float inputs:height = 2
        float inputs:shaping:cone:angle = 50
        float inputs:shaping:cone:softness = 0.2
        float inputs:shaping:focus = 0
        asset inputs:texture:file = @./none.png@
    }
    def DistantLight "Sun" {
        float inputs:intensity = 1000
        float inputs:angle = 0.53
    }
    def SphereLight "Bulb" {
        float inputs:intensity = 10
        float inputs:radius = 0.05
        bool treatAsPoint = 1
        asset inputs:shaping:ies:file = @./none.ies@
        float inputs:shaping:ies:angleScale = 0
        bool inputs:shaping:ies:normalize = 0
        double3 xformOp:translate = (0, 6, 4)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def CylinderLight "Tube" {
        float inputs:length = 1
        float inputs:radius = 0.02
        float inputs:intensity = 50
    }
    def DiskLight "Disk" {
        float inputs:radius = 0.2
        float inputs:diffuse = 1
        float inputs:specular = 1
    }
    def DomeLight_1 "Map" {
        float inputs:intensity = 2
        asset inputs:texture:file = @./picture.png@
        token inputs:texture:format = "latlong"
        uniform token poleAxis = "scene"
    }
    def Volume "Cloud" {
        float3[] extent = [(-1, -1, -1), (1, 1, 1)]
        custom double userProperties:synfog_mor = 100
        token synfog:fog:phase = "droplets"
        float synfog:fog:dropletDiameter = 8
        float synfog:fog:sigma_t = 0.02
        float synfog:fog:contrast = 0.05
        float synfog:fog:g = 0.8
        float synfog:fog:angstrom = 0.1
        bool synfog:fog:enabled = 1
        token synfog:fog:profile = "exponential"
        float synfog:fog:scaleHeight = 10
        int synfog:fog:priority = 1
    }
    def Cube "Bank" {
        uniform token purpose = "guide"
        token synfog:fog:profile = "grid"
        asset synfog:fog:densityGrid = @./grid.npz@
        float synfog:fog:mor = 60
        double3 xformOp:translate = (0, 40, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Cylinder "Post" (prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"]) {
        token[] semantics:labels:cityscapes = ["pole"]
        double height = 2
        double radius = 0.1
        token axis = "Z"
        matrix4d xformOp:transform = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 12, 0, 1))
        uniform token[] xformOpOrder = ["xformOp:transform"]
    }
    def Cone "Pylon" {
        custom string userProperties:cityscapes = "traffic sign"
        double height = 0.7
        double radius = 0.2
    }
    def Capsule "Bin" {
        double height = 0.7
        double radius = 0.2
        token axis = "X"
    }
    def Camera "Second" {
        float fStop = 2.8
        float focusDistance = 12
        float focalLength = 0.5
        float horizontalAperture = 0.36
        float verticalAperture = 0.24
        float horizontalApertureOffset = 0.01
        float verticalApertureOffset = 0
        float2 clippingRange = (0.1, 500)
        float4[] clippingPlanes = []
        token projection = "perspective"
        double shutter:open = 0
        double shutter:close = 0.5
        float exposure = 0
        float exposure:iso = 100
        float exposure:time = 0.01
    }
    def Material "Tiles" {
        token outputs:surface.connect = </More/Tiles/Surface.outputs:surface>
        def Shader "Surface" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </More/Tiles/Picture.outputs:rgb>
            float inputs:roughness = 0.4
            float inputs:metallic = 0.1
            float inputs:opacity = 0.9
            float inputs:opacityThreshold = 0
            float inputs:ior = 1.5
            float inputs:clearcoat = 0.1
            float inputs:clearcoatRoughness = 0.1
            int inputs:useSpecularWorkflow = 0
            color3f inputs:specularColor = (0, 0, 0)
            normal3f inputs:normal = (0, 0, 1)
            float inputs:displacement = 0
            token outputs:surface
        }
        def Shader "Picture" {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./picture.png@
            token inputs:sourceColorSpace = "sRGB"
            token inputs:wrapS = "repeat"
            token inputs:wrapT = "mirror"
            float4 inputs:scale = (1, 1, 1, 1)
            float4 inputs:bias = (0, 0, 0, 0)
            float4 inputs:fallback = (0, 0, 0, 1)
            float2 inputs:st.connect = </More/Tiles/Place.outputs:result>
            float3 outputs:rgb
        }
        def Shader "Place" {
            uniform token info:id = "UsdTransform2d"
            float2 inputs:in.connect = </More/Tiles/Reader.outputs:result>
            float inputs:rotation = 10
            float2 inputs:scale = (2, 2)
            float2 inputs:translation = (0.5, 0)
            float2 outputs:result
        }
        def Shader "Reader" {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 inputs:fallback = (0, 0)
            float2 outputs:result
        }
    }
    def Cube "Glazed" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        double size = 0.3
        rel material:binding = </More/Glaze>
    }
    def Material "Glaze" {
        token outputs:mtlx:surface.connect = </More/Glaze/Surface.outputs:out>
        def Shader "Surface" {
            uniform token info:id = "ND_gltf_pbr_surfaceshader"
            color3f inputs:base_color.connect = </More/Glaze/Picture.outputs:outcolor>
            float inputs:alpha.connect = </More/Glaze/Picture.outputs:outa>
            int inputs:alpha_mode = 1
            float inputs:alpha_cutoff = 0.3
            float inputs:specular = 0.7
            color3f inputs:specular_color = (1, 0.9, 0.8)
            float inputs:transmission = 0.5
            float inputs:thickness = 0.1
            color3f inputs:emissive = (0.1, 0, 0)
            float inputs:emissive_strength = 2
            color3f inputs:sheen_color = (0, 0, 0)
            token outputs:out
        }
        def Shader "Picture" {
            uniform token info:id = "ND_gltf_colorimage"
            asset inputs:file = @./picture.png@
            color4f inputs:color = (1, 1, 1, 0.5)
            float2 inputs:scale = (2, 2)
            float2 inputs:offset = (0.5, 0)
            float2 inputs:pivot = (0, 1)
            float inputs:rotate = 10
            string inputs:uaddressmode = "mirror"
            color3f outputs:outcolor
            float outputs:outa
        }
    }
    def Cube "Painted" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        double size = 0.3
        rel material:binding = </More/Paint>
    }
    def Material "Paint" {
        token outputs:mtlx:surface.connect = </More/Paint/Surface.outputs:out>
        def Shader "Surface" {
            uniform token info:id = "ND_gltf_pbr_surfaceshader"
            color3f inputs:baseColor = (0.5, 0.2, 0.1)
            float inputs:clearcoat = 0.5
            float inputs:clearcoatGloss = 0.9
            float inputs:specTrans = 0.1
            float inputs:subsurface = 0.2
            token outputs:out
        }
    }
    def Cube "Cast" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        double size = 0.3
        rel material:binding = </More/Metal>
    }
    def Material "Metal" {
        token outputs:mdl:surface.connect = </More/Metal/Surface.outputs:out>
        def Shader "Surface" {
            uniform token info:implementationSource = "sourceAsset"
            uniform token info:mdl:sourceAsset:subIdentifier = "OmniPBR"
            color3f inputs:diffuse_reflection_color = (0.5, 0.2, 0.1)
            float inputs:diffuse_reflection_weight = 0.7
            float inputs:metalness = 0.5
            int inputs:specular_reflection_ior_preset = 3
            int inputs:emission_mode = 0
            float inputs:emission_weight = 0.1
            bool inputs:enable_opacity = 1
            float inputs:geometry_opacity = 0.5
            float3 inputs:geometry_normal = (0, 0, 0)
            token outputs:out
        }
    }
    def SkelRoot "Man" {
        def Skeleton "Bones" (prepend apiSchemas = ["SkelBindingAPI"]) {
            uniform token[] joints = ["a", "a/b"]
        uniform matrix4d[] bindTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)), ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 1, 1))]
        uniform matrix4d[] restTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)), ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 1, 1))]
            rel skel:animationSource = </More/Man/Walk>
        }
        def SkelAnimation "Walk" {
            uniform token[] joints = ["a", "a/b"]
            float3[] translations = [(0, 0, 0), (0, 0, 1)]
            quatf[] rotations = [(1, 0, 0, 0), (0.9, 0.1, 0, 0)]
            half3[] scales = [(1, 1, 1), (1, 1, 1)]
            uniform token[] blendShapes = ["smile"]
            float[] blendShapeWeights = [0.5]
        }
        def Mesh "Body" (prepend apiSchemas = ["SkelBindingAPI"]) {
            int[] faceVertexCounts = [3]
            int[] faceVertexIndices = [0, 1, 2]
            point3f[] points = [(0, 15, 0), (1, 15, 0), (0, 15, 1)]
            uniform token subdivisionScheme = "none"
            matrix4d primvars:skel:geomBindTransform = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
            int[] primvars:skel:jointIndices = [0, 0, 1] (
                elementSize = 1
                interpolation = "vertex"
            )
            float[] primvars:skel:jointWeights = [1, 1, 1] (
                elementSize = 1
                interpolation = "vertex"
            )
            rel skel:skeleton = </More/Man/Bones>
            uniform token[] skel:blendShapes = ["smile"]
            rel skel:blendShapeTargets = </More/Man/Body/Smile>
            def BlendShape "Smile" {
                uniform vector3f[] offsets = [(0, 0, 0.1)]
                uniform int[] pointIndices = [2]
            }
        }
    }
}
"""  # noqa: E501
TEXT = street(lamp=True) + EXTRA
VALUE = re.compile(r"^(\s*(?:uniform |custom )?[\w\[\]]+ [\w:]+) = (.*)$", re.MULTILINE)
VALUES = list(VALUE.finditer(TEXT))
WORDS = sorted(set(re.findall(r'[A-Za-z_:]+|[0-9.]+|[(){}\[\]=@<>",#]|\s+', TEXT)))
"""Tokens of the text, for damage that still looks like USD."""

_TYPES = "int float double3 string token[] asset bool color3f[] matrix4d int[] quatf timecode nothing opaque"
TYPES = _TYPES.split()
ONE_OF_TYPE = {
    "string": '"x"', "token[]": '["x"]', "asset": "@x@", "bool": "1", "double3": "(1, 2, 3)",
    "color3f[]": "[(1, 2, 3)]", "int[]": "[1, 2]",
    "matrix4d": "((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))", "quatf": "(1, 0, 0, 0)",
}  # fmt: skip
"""A value of each of `TYPES`; '1' where none stands here."""

NUMBERS = ("0", "-1", "1", "1e-45", "1e38", "-1e38", "1e308", "inf", "-inf", "nan", "0.5", "1e9", "100000")
WHOLE = ("0", "-1", "1", "2", "7", "2147483647", "-2147483648")
STRINGS = ('""', '"inherited"', '"invisible"', '"X"', '"none"', '"bilinear"', '"\u00e9\\n"', '"a b"', '"./x"')
_FILES = "./gone.png /etc/hostname . ./stage.usda <UDIM>.png ./picture.png ./grid.npz ./lamp.ies"
ASSETS = ("@@", *(f"@{name}@" for name in _FILES.split()))
_BY_TYPE = {
    "string": STRINGS, "token": STRINGS, "asset": ASSETS, "bool": ("0", "1"), "int": WHOLE, "int64": WHOLE,
    "rel": ("</World>", "</Nowhere>", "None"),
}  # fmt: skip


def parts_of(kind):
    """What a value of a USD type is made of: (one word of it is one of these, sizes of the tuples around it from the
    outside).

    >>> parts_of("color3f")[1], parts_of("matrix4d")[1], parts_of("token")[1]
    ((3,), (4, 4), ())
    """
    base = re.fullmatch(r"([a-zA-Z]+?)(\d?)([dfhi]?)", kind)
    if kind.startswith("matrix"):
        return NUMBERS, (4, 4)
    if kind.startswith("quat"):
        return NUMBERS, (4,)
    if kind != "int64" and base and base[2]:
        return (WHOLE if base[3] == "i" or base[1] == "int" else NUMBERS), (int(base[2]),)
    return _BY_TYPE.get(kind, NUMBERS), ()


def type_of(number):
    """The type of the attribute that stands at `VALUES[number]`."""
    return VALUES[number][1].split()[-2]


def replaced(changes):
    """The text with other values: `changes` maps the number of an attribute to its value."""
    text = TEXT
    for number in sorted(changes, reverse=True):
        begin, end = VALUES[number].span(2)
        text = text[:begin] + changes[number] + text[end:]
    return text


def retyped(number, kind):
    """The text with one attribute of another type."""
    match = VALUES[number]
    name = match[1].split()[-1]
    value = "" if kind in ("nothing", "opaque") else f" = {ONE_OF_TYPE.get(kind, '1')}"
    return TEXT[: match.start()] + f"    custom {kind} {name}{value}" + TEXT[match.end() :]


def png(width, height, data=None, *, bits=8, packed=None):
    """A PNG whose header says what it likes; its data may be packed already."""

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    if packed is None:
        packed = zlib.compress((b"\0" + bytes(3 * width * bits // 8)) * height if data is None else data)
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


IES = """IESNA:LM-63-2002
TILT=NONE
1 1000 1 3 1 1 2 0.1 0.1 0
1 1 50
0 45 90
0
100 50 0
"""


def furnish(folder):
    """Write the files that `TEXT` names."""
    (folder / "picture.png").write_bytes(png(2, 2))
    (folder / "lamp.ies").write_text(IES, encoding="ascii")
    np.savez(folder / "grid.npz", density=np.full((2, 2, 2), 0.5, np.float32))


def arrays(part):
    """Every array of numbers of a scene."""
    if isinstance(part, dict):
        for inner in part.values():
            yield from arrays(inner)
    elif isinstance(part, np.ndarray) and part.dtype.kind == "f":
        yield part


def read(text):
    """What a bake and `check` do with a file of this text; True where it is a scene, which is then of finite numbers.

    Numbers beyond what a computer holds overflow on the way; numpy's remarks on that are no failure.

    Args:
        text: the file's text, or its bytes.

    Raises:
        AssertionError: a scene of numbers that are none, or an error of more than one line.
    """
    with tempfile.TemporaryDirectory() as folder:
        furnish(Path(folder))
        path = Path(folder) / "stage.usda"
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
        return read_file(path)


def read_file(path):
    """The same for a file."""
    with np.errstate(all="ignore"):
        try:
            stage = open_stage(path)
            stage_hash(stage)
            check(stage)
            for fog in variants(stage).get("fog", [None])[:2]:
                select(stage, fog=fog)
                scene = translate(stage)
                assert all(np.isfinite(array).all() for array in arrays(scene.world)), "not finite"
        except SynfogError as error:
            assert "\n" not in str(error), f"more than one line: {error}"
            assert len(str(error)) < 2000, f"a very long line: {error}"
            return False
        return True

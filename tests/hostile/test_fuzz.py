"""Stages that nobody would write: whatever is in them, reading ends in a scene or in a SynfogError of one line.

Hypothesis draws the damage; the same draws every time, so that a failure can be looked at.  Run with
SYNFOG_FUZZ=5000 for a long search.
"""

import os
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from support.stages import street

from synfog_usd.errors import SynfogError
from synfog_usd.stage import check, open_stage, select, stage_hash, variants
from synfog_usd.translate import translate

EXAMPLES = int(os.environ.get("SYNFOG_FUZZ", "0"))


def fuzzed(examples):
    """Few examples that are the same each time; many new ones where SYNFOG_FUZZ asks for them."""
    return settings(
        max_examples=EXAMPLES or examples,
        derandomize=not EXAMPLES,
        database=None,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


EXTRA = """
def Xform "More" (
    prepend apiSchemas = ["GeomModelAPI"]
)
{
    def Mesh "Quad"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, 9, -1), (1, 9, -1), (1, 9, 1), (-1, 9, 1)]
        normal3f[] primvars:normals = [(0, -1, 0)] (
            interpolation = "constant"
        )
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
            interpolation = "vertex"
        )
        color3f[] primvars:displayColor = [(0.5, 0.2, 0.1)]
        int[] holeIndices = []
        int[] cornerIndices = [0]
        float[] cornerSharpnesses = [2]
        int[] creaseIndices = [0, 1]
        int[] creaseLengths = [2]
        float[] creaseSharpnesses = [3]
        uniform token orientation = "leftHanded"
        def GeomSubset "Part"
        {
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [0]
            rel material:binding = </World/Paint>
        }
    }
    def BasisCurves "Wire"
    {
        int[] curveVertexCounts = [4]
        point3f[] points = [(0, 5, 0), (1, 5, 0), (1, 6, 0), (2, 6, 0)]
        float[] widths = [0.1]
        uniform token type = "cubic"
        uniform token basis = "bspline"
    }
    def Points "Dust"
    {
        point3f[] points = [(0, 7, 0)]
        float[] widths = [0.2]
    }
    def PointInstancer "Many"
    {
        rel prototypes = </More/Many/Ball>
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 8, 0), (1, 8, 0)]
        quath[] orientations = [(1, 0, 0, 0), (0, 1, 0, 0)]
        float3[] scales = [(1, 1, 1), (2, 2, 2)]
        int64[] invisibleIds = [1]
        def Sphere "Ball"
        {
            double radius = 0.3
        }
    }
    def RectLight "Panel"
    {
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
        asset inputs:texture:file = @./none.png@
    }
    def DistantLight "Sun"
    {
        float inputs:intensity = 1000
        float inputs:angle = 0.53
    }
    def Volume "Cloud"
    {
        float3[] extent = [(-1, -1, -1), (1, 1, 1)]
        custom double userProperties:synfog_mor = 100
        token synfog:fog:phase = "droplets"
        float synfog:fog:dropletDiameter = 8
        token synfog:fog:profile = "exponential"
        float synfog:fog:scaleHeight = 10
        int synfog:fog:priority = 1
    }
    def Cylinder "Post" (
        prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"]
    )
    {
        token[] semantics:labels:cityscapes = ["pole"]
        double height = 2
        double radius = 0.1
        token axis = "Z"
        matrix4d xformOp:transform = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 12, 0, 1))
        uniform token[] xformOpOrder = ["xformOp:transform"]
    }
}
"""
TEXT = street(lamp=True) + EXTRA
VALUE = re.compile(r"^(\s*(?:uniform |custom )?[\w\[\]]+ [\w:]+) = (.*)$", re.MULTILINE)
TYPES = ("int", "float", "double3", "string", "token[]", "asset", "bool", "color3f[]", "matrix4d", "int[]", "quatf", "timecode", "nothing", "opaque")
VALUES = list(VALUE.finditer(TEXT))
HOW = ("cut", "twice", "word", "swap", "noise")
WORDS = sorted(set(re.findall(r'[A-Za-z_:]+|[0-9.]+|[(){}\[\]=@<>",#]|\s+', TEXT)))

NUMBERS = ("0", "-1", "1", "1e-45", "1e38", "-1e38", "1e308", "inf", "-inf", "nan", "0.5", "1e9", "100000")
WHOLE = ("0", "-1", "1", "2", "7", "2147483647", "-2147483648")
STRINGS = ('""', '"inherited"', '"invisible"', '"X"', '"none"', '"bilinear"', '"\u00e9\\n"', '"a b"', '"./x"')
ASSETS = ("@@", "@./gone.png@", "@/etc/hostname@", "@.@", "@./stage.usda@", "@<UDIM>.png@")


def fitting(kind):
    """Values that USD's parser takes for an attribute of this type, none of which need make sense."""
    if kind.endswith("[]"):
        return st.lists(fitting(kind[:-2]), max_size=6).map(lambda parts: f"[{', '.join(parts)}]")
    base = re.fullmatch(r"([a-zA-Z]+?)(\d?)([dfhi]?)", kind)
    if kind.startswith("matrix"):
        return vectors(4, vectors(4))
    if kind.startswith("quat"):
        return vectors(4)
    if base and base[2]:
        return vectors(int(base[2]), st.sampled_from(WHOLE if base[3] == "i" or base[1] == "int" else NUMBERS))
    words = {"string": STRINGS, "token": STRINGS, "asset": ASSETS, "bool": ("0", "1"), "int": WHOLE, "int64": WHOLE, "rel": ("</World>", "</Nowhere>", "None")}
    return st.sampled_from(words.get(kind, NUMBERS))


ANY = st.sampled_from(NUMBERS)


def vectors(count, parts=ANY):
    return st.lists(parts, min_size=count, max_size=count).map(lambda found: f"({', '.join(found)})")


@st.composite
def changes(draw):
    """(number of an attribute in the text, another value for it)."""
    number = draw(st.integers(0, len(VALUES) - 1))
    kind = VALUES[number][1].split()[-2]
    return number, draw(fitting("int64" if kind == "int64" else kind))


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
    """
    with np.errstate(all="ignore"), tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stage.usda"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        try:
            stage = open_stage(path)
            stage_hash(stage)
            check(stage)
            for fog in variants(stage).get("fog", [None])[:2]:
                select(stage, fog=fog)
                scene = translate(stage)
                assert all(np.isfinite(array).all() for array in arrays(scene.world)), "not finite"
        except SynfogError as error:
            assert "\n" not in str(error) and len(str(error)) < 2000
            return False
        return True


def test_the_stage_that_is_damaged_is_sound():
    assert read(TEXT)


@fuzzed(100)
@given(st.lists(changes(), min_size=1, max_size=3))
def test_any_value_of_any_attribute_ends_in_a_scene_or_an_error(found):
    text, chosen = TEXT, dict(found)
    for number in sorted(chosen, reverse=True):
        begin, end = VALUES[number].span(2)
        text = text[:begin] + chosen[number] + text[end:]
    read(text)


@fuzzed(80)
@given(
    st.integers(0, len(VALUES) - 1),
    st.sampled_from(TYPES),
)
def test_any_type_of_any_attribute_ends_in_a_scene_or_an_error(number, kind):
    """`points` that are a string, an intensity that is a matrix: USD reads all of it."""
    match = VALUES[number]
    name = match[1].split()[-1]
    value = {"string": '"x"', "token[]": '["x"]', "asset": "@x@", "bool": "1", "double3": "(1, 2, 3)", "color3f[]": "[(1, 2, 3)]", "int[]": "[1, 2]",
             "matrix4d": "((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))", "quatf": "(1, 0, 0, 0)"}.get(kind, "1")  # fmt: skip
    read(TEXT[: match.start()] + f"    custom {kind} {name}" + ("" if kind in ("nothing", "opaque") else f" = {value}") + TEXT[match.end() :])


@fuzzed(80)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["cut", "twice", "word", "swap", "noise"]),
            st.integers(0, len(TEXT) - 1),
            st.integers(1, 200),
            st.sampled_from(WORDS),
            st.text(max_size=6),
        ),
        min_size=1,
        max_size=4,
    )
)
@example([("cut", 0, 200, "", "")])
def test_any_damaged_text_ends_in_a_scene_or_an_error(damage):
    text = TEXT
    for what, at, length, word, noise in damage:
        at %= max(len(text), 1)
        piece = text[at : at + length]
        put = {"cut": "", "twice": piece + piece, "word": word, "swap": piece[::-1], "noise": noise}[what]
        text = text[:at] + put + text[at + length :]
    read(text)


@pytest.mark.parametrize("name", ["points", "faceVertexCounts", "faceVertexIndices", "positions", "protoIndices", "curveVertexCounts", "widths"])
def test_topology_that_makes_no_sense_is_left_out_or_refused(name):
    """Indices beyond the points, negative counts, numbers that are none, in each array of topology."""
    for value in ("[-1]", "[2147483647, -5]", "[]", "[nan]", "[(nan, inf, 0)]", "[(0, 0, 0)]", "[3, 3]"):
        text = re.sub(rf"(\w+\[\] {name}) = \[.*\]", rf"\1 = {value}", TEXT)
        assert text != TEXT
        read(text)


@pytest.mark.parametrize("old, new", [
    ("float inputs:colorTemperature = 4000", "float inputs:colorTemperature = nan"),  # UsdLux.BlackbodyTemperatureAsRgb(nan) ends the process
    ("float inputs:width = 1", "nothing inputs:width"),  # and so does a type that USD does not know, when asked for its default
    ("float inputs:exposure = 1", "float inputs:exposure = 1e9"),
    ("float inputs:angle = 0.53", "float inputs:angle = inf"),
    ("double size = 2", "double size = 1e308"),
    ('token[] semantics:labels:cityscapes = ["pole"]', "custom nothing semantics:labels:cityscapes"),
])  # fmt: skip
def test_what_was_found(old, new):
    """Damage that once took the process down or ended in a trace."""
    assert old in TEXT
    read(TEXT.replace(old, new))

"""Stages that nobody would write: whatever is in them, reading ends in a scene or in a SynfogError of one line.

Hypothesis draws the damage; the same draws every time, so that a failure can be looked at.  For a long search of
new draws, in which no case may take more than 20 s of a processor, or the process more than 3 GB,

    SYNFOG_FUZZ=2000 python -m pytest -m "" --hypothesis-show-statistics tests/hostile/test_fuzz.py
"""

import contextlib
import functools
import os
import re
import resource
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pxr import Sdf, Tf, Usd
from support import cli
from support.hostile import TEXT, TYPES, VALUES, WORDS, furnish, parts_of, read, read_file, replaced, retyped, type_of

from synfog_usd.base.errors import SynfogError
from synfog_usd.camera import load_graph
from synfog_usd.stage import open_stage
from synfog_usd.stage.open import override, plain_errors, select

TESTS = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join((str(TESTS), str(TESTS.parent)))}
EXAMPLES = int(os.environ.get("SYNFOG_FUZZ", "0"))
MOST_S, MOST_KIB = 20, 3_000_000
pytestmark = [pytest.mark.timeout(0)] if EXAMPLES else []


@pytest.fixture(autouse=True, scope="module")
def _within_memory():
    """The most that this process and any child held, told and bounded after a long search."""
    yield
    if EXAMPLES:
        most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
        print(f"\nat most {most / 1024:.0f} MiB")
        assert most < MOST_KIB


def fuzzed(examples):
    """Few examples that are the same each time; many new ones where SYNFOG_FUZZ asks for them."""
    return settings(
        max_examples=EXAMPLES or examples,
        derandomize=not EXAMPLES,
        database=None,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


def bounded(test):
    """In a long search: a case that took too much of the processor is a failure."""

    @functools.wraps(test)
    def timed(*words, **named):
        begin = time.process_time()
        test(*words, **named)
        assert not EXAMPLES or time.process_time() - begin < MOST_S

    return timed


HOW = ("cut", "twice", "word", "swap", "noise")


def fitting(kind):
    """Values that USD's parser takes for an attribute of this type, none of which need make sense."""
    if kind.endswith("[]"):
        return st.lists(fitting(kind[:-2]), max_size=6).map(lambda parts: f"[{', '.join(parts)}]")
    words, sizes = parts_of(kind)
    value = st.sampled_from(words)
    for size in reversed(sizes):
        value = st.lists(value, min_size=size, max_size=size).map(lambda found: f"({', '.join(found)})")
    return value


@st.composite
def changes(draw):
    """(number of an attribute in the text, another value for it)."""
    number = draw(st.integers(0, len(VALUES) - 1))
    return number, draw(fitting(type_of(number)))


def test_the_stage_that_is_damaged_is_sound():
    assert read(TEXT)


@pytest.mark.parametrize("height", ["1e308", "-1e13", "nan", "inf"])
def test_a_shape_of_a_size_beyond_all_bounds_is_left_out(height):
    assert "double height = 2" in TEXT
    read(TEXT.replace("double height = 2", f"double height = {height}"))


@pytest.mark.slow
@fuzzed(30)
@given(st.lists(changes(), min_size=1, max_size=3))
@bounded
def test_any_value_of_any_attribute_ends_in_a_scene_or_an_error(found):
    read(replaced(dict(found)))


@fuzzed(30)
@given(st.integers(0, len(VALUES) - 1), st.sampled_from(TYPES))
@bounded
def test_any_type_of_any_attribute_ends_in_a_scene_or_an_error(number, kind):
    """`points` that are a string, an intensity that is a matrix: USD reads all of it."""
    read(retyped(number, kind))


@fuzzed(30)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(HOW),
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
@bounded
def test_any_damaged_text_ends_in_a_scene_or_an_error(damage):
    text = TEXT
    for what, at, length, word, noise in damage:
        at %= max(len(text), 1)
        piece = text[at : at + length]
        put = {"cut": "", "twice": piece + piece, "word": word, "swap": piece[::-1], "noise": noise}[what]
        text = text[:at] + put + text[at + length :]
    read(text)


@pytest.mark.parametrize(
    "name",
    ["points", "faceVertexCounts", "faceVertexIndices", "positions", "protoIndices", "curveVertexCounts", "widths"],
)
def test_topology_that_makes_no_sense_is_left_out_or_refused(name):
    """Indices beyond the points, negative counts, numbers that are none, in each array of topology."""
    for value in ("[-1]", "[2147483647, -5]", "[]", "[nan]", "[(nan, inf, 0)]", "[(0, 0, 0)]", "[3, 3]"):
        text = re.sub(rf"(\w+\[\] {name}) = \[.*\]", rf"\1 = {value}", TEXT)
        assert text != TEXT
        read(text)


@pytest.mark.parametrize(
    "old, new",
    [
        (
            "float inputs:colorTemperature = 4000",
            "float inputs:colorTemperature = nan",
        ),  # UsdLux.BlackbodyTemperatureAsRgb(nan) ends the process
        (
            "float inputs:width = 1",
            "nothing inputs:width",
        ),  # and so does a type that USD does not know, when asked for its default
        ("float inputs:exposure = 1", "float inputs:exposure = 1e9"),
        ("float inputs:angle = 0.53", "float inputs:angle = inf"),
        (
            "float inputs:angle = 0.53",
            "float inputs:angle = </Nowhere>",
        ),  # the parser takes a path for a value of any type
        ("float inputs:length = 1", "float inputs:length = inf"),
        ("float inputs:radius = 0.02", "float inputs:radius = 1e308"),
        ("float inputs:length = 1", "float inputs:length = nan"),
        ("double size = 2", "double size = 1e308"),
        ('token[] semantics:labels:cityscapes = ["pole"]', "custom nothing semantics:labels:cityscapes"),
    ],
)
def test_what_was_found(old, new):
    """Damage that once took the process down or ended in a trace."""
    assert old in TEXT
    read(TEXT.replace(old, new))


CRATE = """
import sys
from pathlib import Path
from pxr import Sdf, Tf, Usd
from support.hostile import TEXT, furnish
furnish(Path(sys.argv[1]))
layer = Sdf.Layer.CreateAnonymous(".usda")
layer.ImportFromString(TEXT)
layer.Export(sys.argv[1] + "/whole.usdc")
"""

READER = """
import resource, sys, time
from support.hostile import read_file
_, most = resource.getrlimit(resource.RLIMIT_CPU)
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
for line in sys.stdin:
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time()) + 60, most))
    print(read_file(line.rstrip()), flush=True)
"""


class Reader:
    """A child that reads one file after another, and the next child where one took it down."""

    def __init__(self):
        self.child, self.told, self.read, self.died = None, None, 0, 0

    def lives(self, path):
        """Whether the child outlives the file, within a minute of the processor."""
        if self.child is None:
            self.told = tempfile.TemporaryFile(mode="w+")  # noqa: SIM115 - as long as the child
            self.child = subprocess.Popen(
                [sys.executable, "-c", READER],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self.told,
                text=True,
                env=ENVIRONMENT,
            )
        self.read += 1
        with contextlib.suppress(BrokenPipeError):
            self.child.stdin.write(f"{path}\n")
            self.child.stdin.flush()
        if self.child.stdout.readline() in ("True\n", "False\n"):
            return True
        with contextlib.suppress(BrokenPipeError):
            self.child.communicate()
        code, self.child = self.child.returncode, None
        with self.told as told:
            told.seek(0)
            assert code < 0, told.read()
        self.died += 1
        return False

    def end(self):
        if self.child is not None:
            self.child.communicate()
            self.told.close()


@pytest.fixture(scope="module")
def reader():
    found = Reader()
    yield found
    found.end()
    if EXAMPLES:
        print(f"\n{found.read} binary files, of which {found.died} took their reader down")


@pytest.fixture(scope="module")
def crate(tmp_path_factory):
    """A folder with the sound stage as a binary file."""
    folder = tmp_path_factory.mktemp("crate")
    subprocess.run([sys.executable, "-c", CRATE, str(folder)], check=True, env=ENVIRONMENT, timeout=60)
    return folder


def test_a_name_that_is_not_utf_8_is_one_line(tmp_path):
    """In a binary file, where names are bytes: a schema's name, which the test below found."""
    path = tmp_path / "broken.usdc"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString('#usda 1.0\ndef Xform "W" (\n    prepend apiSchemas = ["QuickFoxAPI"]\n)\n{\n}\n')
    layer.Export(str(path))
    whole = path.read_bytes()
    assert whole.count(b"QuickFox") == 1
    path.write_bytes(whole.replace(b"QuickFox", b"Quick\x80ox"))
    with pytest.raises(SynfogError, match="a name in it is not UTF-8"):
        open_stage(path)


def test_a_prim_whose_name_is_not_utf_8_is_told_by_us_alone(tmp_path, capfd):
    """In a binary file: the USD library would warn of it on the terminal, byte by byte, which the test below found."""
    path = tmp_path / "broken.usdc"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString('#usda 1.0\ndef Xform "QuickFox"\n{\n    def Cube "Box"\n    {\n    }\n}\n')
    layer.Export(str(path))
    whole = path.read_bytes()
    assert whole.count(b"QuickFox") == 1
    path.write_bytes(whole.replace(b"QuickFox", b"Quick\xdcox"))
    with pytest.raises(SynfogError, match="cannot be read as USD"):
        open_stage(path)
    assert capfd.readouterr() == ("", "")


def test_a_variant_set_that_is_named_and_not_there_is_told(tmp_path):
    """In a binary file: USD's own list of the stage's files ends the process, which the test below found."""
    path = tmp_path / "broken.usdc"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(
        '#usda 1.0\ndef "W" (\n    variantSets = "Fox"\n)\n{\n    variantSet "Fox" = {\n        "a" {}\n    }\n}\n'
    )
    layer.Export(str(path))
    whole = path.read_bytes()
    assert whole.count(b"\0Fox\0") == 1
    path.write_bytes(whole.replace(b"\0Fox\0", b"\0Box\0"))
    with pytest.raises(SynfogError, match="named and not there; the file is damaged"):
        open_stage(path)


@pytest.mark.parametrize("how", ["lighting", "set"])
def test_a_variant_whose_name_can_not_be_chosen_is_told(tmp_path, how):
    """In a binary file, whose names USD takes as they come, but not in a choice, which the test below found."""
    path = tmp_path / "broken.usdc"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(
        '#usda 1.0\ndef "W" (\n    variantSets = "lighting"\n)\n{\n    variantSet "lighting" = {\n'
        '        "Quick" {}\n    }\n}\n'
    )
    layer.Export(str(path))
    whole = path.read_bytes()
    assert whole.count(b"Quick") == 2  # the name, and the path
    path.write_bytes(whole.replace(b"Quick", b"Qu~ck"))
    stage = open_stage(path)
    with pytest.raises(SynfogError, match="is not a valid variant name"):
        select(stage, lighting="Qu~ck") if how == "lighting" else override(stage, choices=["/W:lighting=Qu~ck"])


def test_applied_schemas_that_are_no_list_are_told(tmp_path):
    """In a binary file, where a truth value stands under their name, which the test below found."""
    path = tmp_path / "broken.usdc"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString('#usda 1.0\ndef Xform "W" (\n    noLoadHint = true\n)\n{\n}\n')
    layer.Export(str(path))
    whole = path.read_bytes()
    assert whole.count(b"noLoadHint") == 1
    path.write_bytes(whole.replace(b"noLoadHint", b"apiSchemas"))
    with pytest.raises(SynfogError, match="the apiSchemas of /W are no list; the file is damaged"):
        open_stage(path)


def test_a_value_of_no_type_is_told(tmp_path):
    """In a binary file: a number's type in custom data, which USD reads first to list the stage's files; the test below
    found it.
    """
    path = tmp_path / "broken.usdc"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString('#usda 1.0\ndef Xform "W" (\n    customData = {\n        double a = 0.1\n    }\n)\n{\n}\n')
    layer.Export(str(path))
    whole = bytearray(path.read_bytes())
    number = struct.pack("<d", 0.1)
    assert whole.count(number) == 1
    kind = whole.index(number) + 8 + 6  # of the eight bytes that say what lies where
    assert whole[kind] == 9  # crateDataTypes.h: double
    whole[kind] = 0
    path.write_bytes(whole)
    with pytest.raises(SynfogError, match="unsupported type enum value 0"):
        open_stage(path)


def test_a_long_list_of_faults_is_a_short_line():
    """USD tells every damaged spec of a layer in one sentence."""

    @plain_errors
    def read(stage):
        Tf.RaiseRuntimeError("ignoring invalid specs: " + "spec at index 14 has empty path, " * 300)

    with pytest.raises(SynfogError, match="ignoring invalid specs: spec at index 14") as told:
        read(Usd.Stage.CreateInMemory())
    assert len(str(told.value)) < 500


@pytest.mark.slow
@fuzzed(2)
@given(
    st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 255)), min_size=30, max_size=30),
    st.integers(1, 3),
)
def test_any_bytes_of_a_binary_file_end_in_a_scene_or_an_error_or_one_line(crate, reader, changes, many):
    """Some bytes of a .usdc changed, in ten files at a time.  What takes the library down, or a minute, the command
    line tells in a line; none ends in a trace.
    """
    whole = (crate / "whole.usdc").read_bytes()
    for number in range(0, len(changes), 3):
        data = bytearray(whole)
        for where, value in changes[number : number + 3][:many]:
            data[int(where * len(data))] = value
        path = crate / f"{reader.read}.usdc"  # another each time: the child may still hold the last one
        path.write_bytes(data)
        if not reader.lives(path):
            check = cli.process("check", path)
            assert check.returncode in (0, 1, 2) and check.stderr.count("\n") <= 1, check.stderr
            assert "Traceback" not in check.stderr
        path.unlink()


MTLX = """<?xml version="1.0"?>
<materialx version="1.38" colorspace="acescg" fileprefix="./">
  <nodegraph name="NG">
    <input name="tint" type="color3" value="1, 0.5, 0.2"/>
    <image name="picture" type="color3">
      <input name="file" type="filename" value="picture.png" colorspace="srgb_texture"/>
      <input name="texcoord" type="vector2" nodename="place"/>
    </image>
    <place2d name="place" type="vector2">
      <input name="scale" type="vector2" value="2, 3"/>
      <input name="rotate" type="float" value="30"/>
    </place2d>
    <multiply name="tinted" type="color3">
      <input name="in1" type="color3" nodename="picture"/>
      <input name="in2" type="color3" interfacename="tint"/>
    </multiply>
    <noise3d name="noise" type="float"><input name="amplitude" type="float" value="0.2"/></noise3d>
    <range name="rough" type="float">
      <input name="in" type="float" nodename="noise"/>
      <input name="gamma" type="float" value="2"/>
    </range>
    <separate3 name="apart" type="multioutput"><input name="in" type="color3" nodename="picture"/></separate3>
    <output name="color" type="color3" nodename="tinted"/>
    <output name="rough" type="float" nodename="rough"/>
    <output name="metal" type="float" nodename="apart" output="outg"/>
  </nodegraph>
  <standard_surface name="shine" type="surfaceshader">
    <input name="base_color" type="color3" nodegraph="NG" output="color"/>
    <input name="specular_roughness" type="float" nodegraph="NG" output="rough"/>
    <input name="metalness" type="float" nodegraph="NG" output="metal"/>
    <input name="transmission" type="float" value="0.5"/>
    <input name="thin_walled" type="boolean" value="true"/>
  </standard_surface>
  <surfacematerial name="Car" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="shine"/>
  </surfacematerial>
</materialx>
"""
MTLX_WORDS = (
    *("nan", "inf", "-1", "1e38", "", "place", "NG", "shine", "color4", "vector2", "float", "<", "/>", "&amp;", "&#0;"),
    *("../../etc/passwd", "<UDIM>", "output", "nodename", "interfacename", "multiply", "mix", "surfacematerial", "1,2"),
)


@pytest.mark.slow
@fuzzed(30)
@given(
    st.lists(
        st.tuples(st.sampled_from(HOW), st.integers(0, len(MTLX) - 1), st.integers(1, 60), st.sampled_from(MTLX_WORDS)),
        min_size=1,
        max_size=4,
    )
)
@example([])
@bounded
def test_any_damaged_materialx_ends_in_a_scene_or_an_error(tmp_path_factory, damage):
    """Its text cut, doubled, turned about and with words put in."""
    text = MTLX
    for what, at, length, word in damage:
        at %= max(len(text), 1)
        piece = text[at : at + length]
        put = {"cut": "", "twice": piece + piece, "word": word, "swap": piece[::-1], "noise": word * 3}[what]
        text = text[:at] + put + text[at + length :]
    folder = tmp_path_factory.mktemp("look")
    furnish(folder)
    (folder / "car.mtlx").write_text(text, encoding="utf-8")
    look = 'def Material "Look" (references = @./car.mtlx@</MaterialX/Materials/Car>) {}'
    stage = TEXT.replace('def Xform "More" (', f'{look}\ndef Xform "More" (', 1)
    stage = stage.replace("rel material:binding = </More/Tiles>", "rel material:binding = </Look>")
    assert stage.count("Look") == 2
    (folder / "a.usda").write_text(stage, encoding="utf-8")
    assert read_file(folder / "a.usda") or damage


GRAPH = (TESTS.parent / "pipeline/phone.yaml").read_text(encoding="utf-8")
GRAPH_WORDS = (
    *(
        "nan",
        ".inf",
        "-1",
        "1e308",
        "0",
        "''",
        "[]",
        "{}",
        "null",
        "auto",
        "*a",
        "&a",
        "? ",
        ": ",
        "- ",
        "\t",
        "\u0000",
    ),
    *("op:", "in:", "nodes:", "extends: ./a.yaml", "sensor.expose", "radiance", "../../etc/passwd", "1/0", "true"),
)


@pytest.mark.slow
@fuzzed(30)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(HOW), st.integers(0, len(GRAPH) - 1), st.integers(1, 60), st.sampled_from(GRAPH_WORDS)
        ),
        min_size=1,
        max_size=4,
    )
)
@example([])
@bounded
def test_any_damaged_graph_is_loaded_or_told(tmp_path_factory, damage):
    """Its text cut, doubled, turned about and with words put in: a graph, or an error that names the file."""
    text = GRAPH
    for what, at, length, word in damage:
        at %= max(len(text), 1)
        piece = text[at : at + length]
        put = {"cut": "", "twice": piece + piece, "word": word, "swap": piece[::-1], "noise": word * 3}[what]
        text = text[:at] + put + text[at + length :]
    path = tmp_path_factory.getbasetemp() / "graph.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        assert load_graph(path).outputs or damage
    except SynfogError as error:
        assert damage and "graph.yaml" in str(error)


OPTIONS = (
    *("--resolution", "--samples", "--target-error", "--bands", "--frame", "--fog", "--lighting"),
    *(
        "--camera",
        "--choose",
        "--sun-lux",
        "--light-scale",
        "--meters-per-unit",
        "--up",
        "--max-distance",
        "--mask",
        "-o",
    ),
    *("--model", "--seed", "--variant", "--lights", "--pipeline", "--allow", "--no-such", "--", "-q"),
)
ODD = (
    "",
    " ",
    "0",
    "-1",
    "nan",
    "inf",
    "1e999",
    "10x10",
    "1000000000x1",
    "a,b",
    ",",
    "/",
    "..",
    "\u00e9",
    "\n",
    "mor0",
)


@pytest.mark.slow
@fuzzed(30)
@given(
    st.sampled_from(("bake", "preview", "check")),
    st.lists(st.tuples(st.sampled_from(OPTIONS), st.sampled_from(ODD)), max_size=4),
)
@bounded
def test_any_command_line_of_a_stage_that_is_missing_is_told(tmp_path_factory, verb, words):
    """Exit code 2 and no trace, whatever the options; nothing is written."""
    folder = tmp_path_factory.mktemp("empty")
    done = cli.run(verb, "missing.usda", *(word for pair in words for word in pair), cwd=folder)
    assert done.returncode == 2 and "Traceback" not in done.stdout + done.stderr
    assert not list(folder.iterdir())

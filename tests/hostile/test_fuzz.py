"""Stages that nobody would write: whatever is in them, reading ends in a scene or in a SynfogError of one line.

Hypothesis draws the damage; the same draws every time, so that a failure can be looked at.  For a long search of
new draws, in which no case may take more than 20 s of a processor, or the process more than 3 GB,

    SYNFOG_FUZZ=2000 python -m pytest -m "" --hypothesis-show-statistics tests/hostile/test_fuzz.py
"""

import functools
import os
import re
import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from support import cli
from support.hostile import TEXT, TYPES, VALUES, WORDS, furnish, parts_of, read, read_file, replaced, retyped, type_of

from synfog_usd.base.errors import SynfogError
from synfog_usd.camera import load_graph

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


def damages(text, words, *, longest=60):
    """Up to four times: what is done, where, to how many letters, and what is put in."""
    piece = st.tuples(st.sampled_from(HOW), st.integers(0, len(text) - 1), st.integers(1, longest), words)
    return st.lists(piece, min_size=1, max_size=4)


def damaged(text, damage):
    """Its text cut, doubled, turned about and with words put in."""
    for what, at, length, word in damage:
        at %= max(len(text), 1)
        piece = text[at : at + length]
        put = {"cut": "", "twice": piece + piece, "word": word, "swap": piece[::-1], "noise": word * 3}[what]
        text = text[:at] + put + text[at + length :]
    return text


@fuzzed(30)
@given(damages(TEXT, st.sampled_from(WORDS) | st.text(max_size=6), longest=200))
@example([("cut", 0, 200, "")])
@bounded
def test_any_damaged_text_ends_in_a_scene_or_an_error(damage):
    read(damaged(TEXT, damage))


@pytest.mark.parametrize(
    "name", ["points", "faceVertexCounts", "faceVertexIndices", "protoIndices", "curveVertexCounts"]
)
def test_topology_that_makes_no_sense_is_left_out_or_refused(name):
    """Indices beyond the points, negative counts, numbers that are none, in each array of topology."""
    for value in ("[-1]", "[2147483647, -5]", "[]", "[nan]", "[(nan, inf, 0)]", "[(0, 0, 0)]", "[3, 3]"):
        text = re.sub(rf"(\w+\[\] {name}) = \[.*\]", rf"\1 = {value}", TEXT)
        assert text != TEXT
        read(text)


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


@pytest.fixture(scope="module")
def crate(tmp_path_factory):
    """A folder with the sound stage as a binary file."""
    folder = tmp_path_factory.mktemp("crate")
    subprocess.run([sys.executable, "-c", CRATE, str(folder)], check=True, env=ENVIRONMENT, timeout=60)
    return folder


@pytest.mark.slow
@fuzzed(8)
@given(st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=3))
def test_any_bytes_of_a_binary_file_are_read_or_one_line(crate, changes):
    """Some bytes of a .usdc changed, read by the command line: whatever the library does, none ends in a trace."""
    data = bytearray((crate / "whole.usdc").read_bytes())
    for where, value in changes:
        data[int(where * len(data))] = value
    path = crate / "changed.usdc"
    path.write_bytes(data)
    check = cli.process("check", path)
    assert check.returncode in (0, 1, 2) and check.stderr.count("\n") <= 1, check.stderr
    assert "Traceback" not in check.stderr


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
@given(damages(MTLX, st.sampled_from(MTLX_WORDS)))
@example([])
@bounded
def test_any_damaged_materialx_ends_in_a_scene_or_an_error(tmp_path_factory, damage):
    folder = tmp_path_factory.mktemp("look")
    furnish(folder)
    (folder / "car.mtlx").write_text(damaged(MTLX, damage), encoding="utf-8")
    look = 'def Material "Look" (references = @./car.mtlx@</MaterialX/Materials/Car>) {}'
    stage = TEXT.replace('def Xform "More" (', f'{look}\ndef Xform "More" (', 1)
    stage = stage.replace("rel material:binding = </More/Tiles>", "rel material:binding = </Look>")
    assert stage.count("Look") == 2
    (folder / "a.usda").write_text(stage, encoding="utf-8")
    assert read_file(folder / "a.usda") or damage


GRAPH = (TESTS.parent / "pipeline/phone.yaml").read_text(encoding="utf-8")
GRAPH_KEYS = "op: in: nodes: sensor.expose radiance ../../etc/passwd"
GRAPH_VALUES = "nan .inf -1 1e308 0 1/0 [] {} '' null auto true *a &a"
GRAPH_WORDS = ["? ", ": ", "- ", "\t", "\u0000", "extends: ./a.yaml", *GRAPH_KEYS.split(), *GRAPH_VALUES.split()]


@pytest.mark.slow
@fuzzed(30)
@given(damages(GRAPH, st.sampled_from(GRAPH_WORDS)))
@example([])
@bounded
def test_any_damaged_graph_is_loaded_or_told(tmp_path_factory, damage):
    """A graph, or an error that names the file."""
    path = tmp_path_factory.getbasetemp() / "graph.yaml"
    path.write_bytes(damaged(GRAPH, damage).encode("utf-8", "surrogatepass"))
    try:
        assert load_graph(path).outputs or damage
    except SynfogError as error:
        assert damage and "graph.yaml" in str(error)


OPTIONS = """--resolution --samples --frames --fog --lighting --camera --choose
    --light-scale -o --seed
    --variant --pipeline --allow --no-such -- -q"""
NUMBERS = "0 -1 nan inf 1e999 10x10 1000000000x1 a,b , / .. mor0"
ODD = ["", " ", "\u00e9", "\n", *NUMBERS.split()]


@pytest.mark.slow
@fuzzed(30)
@given(
    st.sampled_from(("bake", "preview", "check")),
    st.lists(st.tuples(st.sampled_from(OPTIONS.split()), st.sampled_from(ODD)), max_size=4),
)
@bounded
def test_any_command_line_of_a_stage_that_is_missing_is_told(tmp_path_factory, verb, words):
    """Exit code 2 and no trace, whatever the options; nothing is written."""
    folder = tmp_path_factory.mktemp("empty")
    done = cli.run(verb, "missing.usda", *(word for pair in words for word in pair), cwd=folder)
    assert done.returncode == 2 and "Traceback" not in done.stdout + done.stderr
    assert not list(folder.iterdir())

"""Stages that would fill the memory, run for ever, read other people's files or take the USD library down.

What a user runs is the command line, so the gravest go through it; each must end in one
line and exit code 2, uncomposed and with little memory.
"""

import json
import os
import re
import resource
import struct
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, Vt
from support import cli, crates
from support.hostile import png
from support.looks import fill, painted, picture_of, with_st
from support.memory import at_peak

from synfog_usd.base import system
from synfog_usd.base.errors import StageError
from synfog_usd.dataset.check import look
from synfog_usd.stage import budget, open_stage
from synfog_usd.translate import translate

HEAD = '#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n)\n'
CAMERA = 'def Camera "Ego"\n{\n}\n'


def written(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def bomb(levels, *, instanceable, arc="references"):
    """2^levels prims from a few lines."""
    text = HEAD + CAMERA + 'def Xform "L0"\n{\n    def Cube "Leaf"\n    {\n    }\n}\n'
    for level in range(1, levels + 1):
        text += f'def Xform "L{level}"\n{{\n'
        for name in "ab":
            text += (
                f'    def Xform "{name}" (\n        instanceable = {str(instanceable).lower()}\n        {arc} = '
                f"</L{level - 1}>\n    )\n    {{\n    }}\n"
            )
        text += "}\n"
    return text


def usd(body="", *, head="", name="R"):
    """A layer whose default prim has this name."""
    return f'#usda 1.0\n(\n    defaultPrim = "{name}"\n{head})\n{body}'


def prim(arcs, inner="", name="A"):
    return f'def "{name}" (\n    {arcs}\n)\n{{\n{inner}}}\n'


def pairs(level):
    """Two prims that refer to the layer below."""
    return "".join(prim(f"references = @./l{level - 1}.usda@", name=name) for name in "ab")


def stacked(levels, *names):
    """Layers of levels, each with all of the next level below it."""
    for level in range(levels):
        below = ", ".join(f"@./{name}{level + 1}.usda@" for name in names) if level < levels - 1 else ""
        for name in names:
            yield f"{name}{level}.usda", f"#usda 1.0\n(\n    subLayers = [{below}]\n)\n"


CHAIN = "".join(prim(f"references = </A{n + 1}>", name=f"A{n}") for n in range(3000)) + prim("", name="A3000")
DOUBLED = (prim(f"references = [</a{n + 1}>, </b{n + 1}>]", name=f"{name}{n}") for n in range(30) for name in "ab")
BOMBS = {
    **{arc: {"a0.usda": bomb(30, instanceable=False, arc=arc)} for arc in ("references", "payload", "specializes")},
    "many files": {f"l{n}.usda": usd(f'def Xform "R"\n{{\n{pairs(n)}}}\n') for n in range(1, 31)}
    | {"l0.usda": usd('def Cube "R"\n{\n}\n'), "a0.usda": usd(prim("references = @./l30.usda@", name="R"))},
    "no children": {"a0.usda": HEAD + "".join(DOUBLED)},
    "sublayers": dict(stacked(21, "a", "b")),
    "layers twice": dict(stacked(12, "a", "a")),
    "a chain": {"a0.usda": HEAD + CHAIN},
    "a tower": {"a0.usda": "#usda 1.0\n" + 'def Xform "d" {\n' * 5000 + "}\n" * 5000},
}
WORDS = {
    "sublayers": "its sublayers unfold to",
    "layers twice": "its sublayers unfold to 4 095 layers; at most 2000 are composed: list each once",
    "a chain": "follow one another more than 200 deep",
    "a tower": "nested deeper than 256",
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_counted_and_not_composed(tmp_path, monkeypatch, name):
    """2^30 prims, references or layers from 3 kB: refused in one line; whoever composes one is an error here."""
    if name != "a tower":
        monkeypatch.setattr(Usd.Stage, "Open", None)
    for file, text in BOMBS[name].items():
        written(tmp_path / file, text)
    unfolds = r"a0.usda: unfolds to \d+( \d\d\d)+ prims .*; at most 100000 .*SYNFOG_USD_LARGE=1"
    with pytest.raises(StageError, match=WORDS.get(name, unfolds)) as caught:
        open_stage(tmp_path / "a0.usda")
    assert "\n" not in str(caught.value)


def test_who_trusts_a_stage_may_compose_more_up_to_an_end(tmp_path, monkeypatch):
    """Sixteen prims and their references are within two million and beyond ten."""
    monkeypatch.setattr(budget, "MAX_PRIMS", 10)
    path = written(tmp_path / "small.usda", bomb(3, instanceable=False))
    for trust in ("", "0"):
        monkeypatch.setenv(budget.TRUSTED, trust)
        with pytest.raises(
            StageError, match=r"at most 10 are .* set SYNFOG_USD_LARGE=1 if .* \(at most 2000000 then\)"
        ):
            open_stage(path)
    monkeypatch.setenv(budget.TRUSTED, "1")
    assert budget.check_stage(open_stage(path)).shapes == 1 + 2 + 4 + 8
    monkeypatch.setattr(budget, "MAX_PRIMS_TRUSTED", 10)
    with pytest.raises(StageError, match=r"at most 10 are composed: refer to fewer things, make .* instanceable$"):
        open_stage(path)


def test_an_asset_that_makes_itself_an_instance_counts_once(tmp_path):
    """4 000 references to a tree of 600 prims that says it is instanceable are 4 601 prims, not 2.4 million."""
    twigs = "".join(f'    def Xform "t{n}"\n    {{\n    }}\n' for n in range(600))
    written(
        tmp_path / "tree.usda",
        f'#usda 1.0\n(\n    defaultPrim = "Tree"\n)\ndef Xform "Tree" (\n    instanceable = true\n)\n{{\n{twigs}}}\n',
    )
    trees = "".join(
        f'    def "t{n}" (\n        references = @./tree.usda@\n    )\n    {{\n    }}\n' for n in range(4000)
    )
    stage = open_stage(written(tmp_path / "forest.usda", HEAD + f'def Xform "Forest"\n{{\n{trees}}}\n'))
    assert len(stage.GetPrototypes()) == 1


@pytest.mark.parametrize("levels, refused", [(40, True), (18, False)])
def test_proxies_of_instances_are_counted_and_not_visited(tmp_path, levels, refused):
    """Two instances at each of 40 levels are 2^41 shapes in 80 prims: visiting them would take for ever."""
    path = written(tmp_path / "proxies.usda", bomb(levels, instanceable=True))
    if refused:
        done = cli.run("check", path)
        told = done.stderr
        assert done.returncode == 2 and told.count("\n") == 1
        assert re.search(f"/L{levels}/a.*unfold to.*at most 800000", told)
    else:
        size = budget.check_stage(open_stage(path))
        assert size.shapes == sum(2**level for level in range(levels + 1))  # each /Ln is drawn itself too
        assert size.prims < 10 * levels


def test_point_instancers_within_point_instancers_are_counted(tmp_path):
    """300 points of 300 points of 300 points."""
    stage = Usd.Stage.CreateInMemory()
    target = UsdGeom.Cube.Define(stage, "/Leaf").GetPath()
    for level in range(3):
        instancer = UsdGeom.PointInstancer.Define(stage, f"/P{level}")
        instancer.CreatePrototypesRel().AddTarget(target)
        fill(instancer, protoIndices=[0] * 300, positions=[(0, 0, 0)] * 300)
        target = instancer.GetPath()
    with pytest.raises(StageError, match=r"/P2: its instances unfold to 27 000 000 shapes"):
        budget.check_stage(stage)


def test_triangles_are_counted_before_they_are_made(monkeypatch):
    """A quad is two triangles, a hexagon four; a prototype counts once."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.Mesh.Define(stage, "/Kit/Mesh").CreateFaceVertexCountsAttr([4, 6, 3, -7])
    for name in "abc":
        prim = stage.DefinePrim(f"/{name}", "Xform")
        prim.GetReferences().AddInternalReference("/Kit")
        prim.SetInstanceable(True)
    assert budget.check_stage(stage).triangles == 2 * (2 + 4 + 1)  # /Kit itself and the one prototype
    monkeypatch.setattr(budget, "MAX_TRIANGLES", 13)
    with pytest.raises(StageError, match=r"Mesh: 7 triangles, 14 with the rest of the stage; at most 13"):
        budget.check_stage(stage)


MANY = json.dumps([f"CollectionAPI:c{n}" for n in range(1001)])


@pytest.mark.parametrize("text, words", [
    (prim("references = </A>"), "/A.*Cycle"),
    (prim("payload = </B>") + prim("payload = </A>", name="B"), "/A.*Cycle"),
    (prim("inherits = </A/B>", prim("inherits = </A>", name="B")), "/A.*Cycle"),
    (prim("references = @./gone.usda@"), "/A.*gone.usda"),
    (prim("references = @./there.obj@"), "/A.*there.obj.*not USD by its name"),
    (prim("references = @./there.usda@</Nothing>"), "/A.*Nothing"),
    (prim("references = @././../../../../../../../../etc/hostname@"), "/A: /etc/hostname lies outside of the stage's"),
    ('def "A"\n{\n    asset f = @/etc/hostname@\n}\n', "/A.f: /etc/hostname lies outside of the stage's folder"),
    (prim("references = @http://example.com/a.usda@"), "/A: its reference .* is missing"),
    (prim("references = @./a.usdz[../x.usda]@"), "/A: its reference .* is missing"),
    (prim(f"prepend apiSchemas = {MANY}"), "/A: 1001 applied schemas; at most 1000"),
])  # fmt: skip
def test_what_leads_nowhere_or_elsewhere_is_one_line(tmp_path, text, words):
    written(tmp_path / "there.usda", HEAD + CAMERA)
    written(tmp_path / "there.obj", "v 0 0 0\n")
    with pytest.raises(StageError, match=words) as caught:
        open_stage(written(tmp_path / "stage.usda", HEAD + CAMERA + text), whole=True)
    assert "\n" not in str(caught.value)


def test_sublayers_that_hold_each_other_are_one_line(tmp_path):
    for name, other in (("a", "b"), ("b", "a")):
        written(
            tmp_path / f"{name}.usda", f'#usda 1.0\n(\n    subLayers = [@./{other}.usda@]\n)\ndef "{name}"\n{{\n}}\n'
        )
    with pytest.raises(StageError, match="ycle"):
        open_stage(tmp_path / "a.usda", whole=True)


# -- the fence


@pytest.fixture
def two_folders(tmp_path):
    """A stage's folder, and beside it one with a car and a picture."""
    (tmp_path / "stage").mkdir()
    (tmp_path / "kit").mkdir()
    body = '    def Cube "Body"\n    {\n    }\n'
    written(tmp_path / "kit" / "car.usda", usd(f'def Xform "Car"\n{{\n{body}}}\n', name="Car"))
    (tmp_path / "kit" / "sky.png").write_bytes(png(2, 2))
    return tmp_path / "stage", tmp_path / "kit"


def dome(path):
    return f'def DomeLight "Sky"\n{{\n    asset inputs:texture:file{path}\n}}\n'


CHOICES = 'variants = {\n        string v = "a"\n    }\n    prepend variantSets = "v"'
WAYS = {
    "reference": prim("references = @../kit/car.usda@"),
    "texture": dome(" = @../kit/sky.png@"),
    "link": prim("references = @./link.usda@"),
    "linked texture": dome(" = @./link.png@"),
    "variant": prim(
        CHOICES, 'variantSet "v" = {\n"a" {\n}\n"b" {\n' + prim("references = @../kit/car.usda@") + "}\n}\n"
    ),
    "samples": dome(".timeSamples = {\n        0: @../kit/sky.png@,\n    }"),
}


@pytest.mark.parametrize("way", WAYS)
def test_files_elsewhere_are_read_only_where_that_is_allowed(two_folders, way):
    """By reference, payload, texture, link, in a variant that is not chosen, and at a frame that is not drawn."""
    folder, kit = two_folders
    (folder / "link.usda").symlink_to(kit / "car.usda")
    (folder / "link.png").symlink_to(kit / "sky.png")
    path = written(folder / "stage.usda", HEAD + CAMERA + WAYS[way])
    with pytest.raises(StageError, match=r"lies outside of the stage's folder .*--allow ") as caught:
        open_stage(path)
    assert str(kit) in str(caught.value) or "link" in way
    open_stage(path, allow=[kit])


def test_the_command_line_allows_folders(two_folders):
    folder, kit = two_folders
    path = written(folder / "stage.usda", HEAD + CAMERA + WAYS["reference"])
    refused = cli.run("check", path)
    assert refused.returncode == 2 and "lies outside" in refused.stderr and refused.stderr.count("\n") == 1
    assert cli.run("check", path, "--allow", kit).returncode == 0


def test_sublayers_elsewhere_folders_that_are_not_there_and_pipes_are_refused(two_folders):
    """Nobody writes into the pipe: reading it would wait for ever."""
    folder, _ = two_folders
    with pytest.raises(StageError, match=r"car.usda lies outside"):
        open_stage(written(folder / "a.usda", "#usda 1.0\n(\n    subLayers = [@../kit/car.usda@]\n)\n"))
    with pytest.raises(StageError, match=r"--allow .*no such folder"):
        open_stage(written(folder / "b.usda", HEAD), allow=["nowhere"])
    os.mkfifo(folder / "sky.png")
    with pytest.raises(StageError, match=r"/Sky.*sky\.png is no regular file"):
        open_stage(written(folder / "c.usda", HEAD + CAMERA + dome(" = @./sky.png@")))
    os.mkfifo(folder / "graph.yaml")
    done = cli.run("graph", "check", folder / "graph.yaml")
    assert done.returncode == 2 and "graph.yaml: cannot be read (it is no regular file)" in done.stderr


# -- pictures, packages and damaged files


@pytest.fixture
def card(tmp_path):
    """Translate a stage with a card that wears a picture."""

    def make(name):
        stage = Usd.Stage.CreateNew(str(tmp_path / "card.usda"))
        UsdGeom.SetStageUpAxis(stage, "Z")
        UsdGeom.Camera.Define(stage, "/Camera")
        mesh = UsdGeom.Mesh.Define(stage, "/Card")
        fill(mesh, points=[(-1, 5, -1), (1, 5, -1), (1, 5, 1), (-1, 5, 1)], faceVertexCounts=[4])
        fill(mesh, faceVertexIndices=[0, 1, 2, 3])
        color = picture_of(stage, Path(name), fallback=(0.25, 0.5, 0.75, 1))
        painted(with_st(mesh).GetPrim(), diffuseColor=color)
        stage.Save()
        return translate(open_stage(tmp_path / "card.usda"))

    return make


def jpeg(width, height):
    """The headers of a JPEG."""
    frame = struct.pack(">HBHHB", 17, 8, height, width, 3) + b"\1\x11\0\2\x11\0\3\x11\0"
    return b"\xff\xd8\xff\xc0" + frame + b"\xff\xda\0\x0c\3\1\0\2\x11\3\x11\0\x3f\0\xff\xd9"


def openexr(width, height, channels):
    """The header of an OpenEXR file."""

    def attribute(name, kind, data):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(data)) + data

    listed = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", 2, 0, 1, 1) for name in channels) + b"\0"
    box, one = struct.pack("<iiii", 0, 0, width - 1, height - 1), struct.pack("<f", 1)
    parts = (("channels", "chlist", listed), ("compression", "compression", b"\0"), ("dataWindow", "box2i", box))
    parts += (("displayWindow", "box2i", box), ("lineOrder", "lineOrder", b"\0"), ("pixelAspectRatio", "float", one))
    parts += (("screenWindowCenter", "v2f", bytes(8)), ("screenWindowWidth", "float", one))
    return b"\x76\x2f\x31\x01" + struct.pack("<I", 2) + b"".join(attribute(*part) for part in parts) + b"\0"


@pytest.mark.parametrize("name, content, words", [
    ("big.png", png(10_000, 10_000, b""), "10000 x 10000 pixels is too large"),
    ("wide.png", png(2**31 - 1, 1, b""), None),
    ("text.png", b"hello", "cannot be read"),
    ("cut.png", png(64, 64)[:60], None),
    ("notes.txt", b"hello", "no picture by its name"),
    ("big.jpg", jpeg(60_000, 60_000), None),
    ("big.exr", openexr(60_000, 60_000, "BGR"), None),
    ("many.exr", openexr(8_000, 8_000, [f"c{n:04}" for n in range(1000)]), None),
    ("big.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n", None),
])  # fmt: skip
def test_a_picture_that_is_none_or_too_large_is_not_decoded(tmp_path, card, name, content, words):
    """The fallback is drawn instead, and a note says so; a header that claims 100 megapixels is enough."""
    (tmp_path / name).write_bytes(content)
    scene, grown_kib = at_peak(lambda: card(f"./{name}"))
    assert grown_kib < 200_000
    told = [note.text for note in scene.notes if note.severity == "warning" and name in note.text]
    assert told and (words is None or words in told[0])


def test_textures_together_have_a_budget(tmp_path, card, monkeypatch):
    from synfog_usd.translate import texture

    (tmp_path / "sky.png").write_bytes(png(512, 1024))
    monkeypatch.setattr(texture, "MAX_BYTES", (3 << 19) - 1)
    with pytest.raises(StageError, match=r"/Material/Picture: with texture .*sky.png all textures take 1 MiB decoded"):
        card("./sky.png")


LIBRARY = """
import sys
from synfog_usd.base.errors import SynfogError
from synfog_usd.stage import check, open_stage
from synfog_usd.translate import translate
for path in sys.argv[1:]:
    try:
        stage = open_stage(path, whole=True)
        check(stage)
        translate(stage)
        print(path, "opened", flush=True)
    except SynfogError as error:
        assert "\\n" not in str(error), error
        print(path, "refused", error, flush=True)
"""


def library(files):
    """What becomes of each file when it is opened, checked and translated: {name: 'opened', 'refused ...' or
    'crashed'}.

    In children: one that a file takes down is followed by one that goes on behind that file, after the command line has
    shown its line.
    """
    left, became = [str(file) for file in files], {}
    while left:
        child = subprocess.run([sys.executable, "-c", LIBRARY, *left], capture_output=True, text=True, timeout=120)
        told = child.stdout.splitlines()
        became |= {Path(path).name: line.removeprefix(f"{path} ") for path, line in zip(left, told, strict=False)}
        if child.returncode >= 0:
            assert child.returncode == 0, child.stderr
            break
        crashed = left[len(told)]
        done = cli.process("check", crashed)
        words = done.stderr
        assert (
            done.returncode == 2
            and f"{crashed}: the process that read it died of signal" in words
            and "Traceback" not in words
        )
        became[Path(crashed).name] = "crashed"
        left = left[len(told) + 1 :]
    return became


def test_packages_with_odd_members(tmp_path):
    """A .usdz opens where its first member is a good layer and nothing is compressed."""
    outside = 'def "A" (\n    references = @../outside.usda@\n)\n{\n}\n'
    written(tmp_path / "outside.usda", HEAD)
    (tmp_path / "in").mkdir()

    def package(name, first, *, packed=False):
        with zipfile.ZipFile(
            tmp_path / "in" / name, "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED
        ) as archive:
            archive.writestr(*first)
            archive.writestr("../../escape.usda", HEAD)
            archive.writestr("run.py", "raise SystemExit")
            archive.writestr("b.usdz", b"PK\x03\x04")
        return tmp_path / "in" / name

    files = [
        package("odd.usdz", ("scene.usda", HEAD + CAMERA)),
        package("packed.usdz", ("scene.usda", HEAD + CAMERA), packed=True),
        package("outside.usdz", ("scene.usda", HEAD + CAMERA + outside)),
        package("nolayer.usdz", ("run.txt", "hello")),
        package("cut.usdz", ("scene.usda", HEAD + CAMERA)),
    ]
    files[-1].write_bytes(files[-1].read_bytes()[:100])
    whole = files[0].read_bytes()
    for name, changes in {
        "secret.usdz": [(b"PK\3\4", 6, 1), (b"PK\1\2", 8, 1)],
        "sizes.usdz": [(b"PK\3\4", 18, 255), (b"PK\1\2", 20, 255)],
    }.items():
        changed = bytearray(whole)  # encrypted by its flags; of a size that it does not have
        for mark, at, value in changes:
            changed[changed.index(mark) + at] = value
        files.append(tmp_path / "in" / name)
        files[-1].write_bytes(changed)
    for name, inner in {"nested.usdz": "b.usdz", "climbs.usdz": "../../escape.usda", "self.usdz": "scene.usda"}.items():
        files.append(
            package(name, ("scene.usda", HEAD + CAMERA + f'def "A" (\n    references = @{inner}@\n)\n{{\n}}\n'))
        )
    became = library(files)
    assert became.pop("odd.usdz") == "opened", became
    assert set(became) == {file.name for file in files[1:]} and all(
        line.startswith("refused") for line in became.values()
    ), became
    assert not list(tmp_path.parent.rglob("escape.usda"))


PARENT = """
import sys
from synfog_usd.base import isolated
from synfog_usd.cli.main import main
first = sys.argv.pop(1)
isolated.command = lambda *words: [sys.executable, "-c", first, *words]
main()
"""
CHILD = """
import os, runpy, sys
sys.argv = sys.argv[1:]
{}
runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""


def process_after(code, *arguments, **more):
    """The command line in a process of its own, whose child runs `code` before all else."""
    words = [sys.executable, "-c", PARENT, CHILD.format(code), *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=300, **more)


@pytest.mark.parametrize("dies", [pytest.param(False, marks=pytest.mark.slow), True])
def test_what_usd_writes_while_a_stage_is_read_is_not_heard(tmp_path, dies):
    """By its own descriptor, as its library does in C++: where it ends the process, five lines.  Ours is heard."""
    noisy = (
        "from pxr import Sdf, Tf\n"
        "before = Sdf.Layer.FindOrOpen\n"
        "def heard(*words):\n"
        "    os.write(2, b'a library speaks\\n')\n"
        f"    {'Tf.Fatal(str(words))' if dies else ''}\n"
        "    return before(*words)\n"
        "Sdf.Layer.FindOrOpen = staticmethod(heard)"
    )
    written(tmp_path / "a.txt", "")
    stage = written(tmp_path / "street.usda", HEAD + 'def "A" (references = @./a.txt@) {}\n')
    where = {**os.environ, "TMPDIR": str(tmp_path)}  # where it writes its report
    done = process_after(noisy, "check", stage, env=where)
    told = done.stderr.splitlines()
    assert done.returncode == 2 and len(told) == 1, done.stderr
    assert ("died of" if dies else "a.txt, which is not USD by its name") in told[0]


def test_memory_beyond_the_limit_is_one_line(tmp_path):
    """2^23 equal numbers pack into a small file and unfold to 32 MiB; on a machine of 24 MiB that is a line."""
    layer = Sdf.Layer.CreateNew(str(tmp_path / "big.usdc"))
    spec = Sdf.CreatePrimInLayer(layer, "/Mesh")
    spec.specifier, spec.typeName = Sdf.SpecifierDef, "Mesh"
    counts = Sdf.AttributeSpec(spec, "faceVertexCounts", Sdf.ValueTypeNames.IntArray)
    counts.default = Vt.IntArray.FromNumpy(np.full(1 << 23, 3, np.int32))
    layer.Save()
    del layer, counts, spec
    assert (tmp_path / "big.usdc").stat().st_size < 1 << 20
    pages = (24 << 20) // resource.getpagesize()
    shrunk = f"before = os.sysconf\nos.sysconf = lambda name: {pages} if name == 'SC_PHYS_PAGES' else before(name)"
    done = process_after(shrunk, "check", tmp_path / "big.usdc")
    assert done.returncode == 2 and "memory" in done.stderr and "Traceback" not in done.stderr


def test_a_crash_of_the_library_is_one_line(tmp_path):
    """USD's parser calls itself for each brace and runs out of stack; the parent says it in a line."""
    path = written(tmp_path / "deep.usda", "#usda 1.0\n" + 'def Xform "d" {\n' * 200_000 + "}\n" * 200_000)
    done = cli.process("check", path)
    told = done.stderr
    assert (
        done.returncode == 2 and told.count("\n") == 1 and "died of signal 11: the USD library could not cope" in told
    )


def test_the_limits_of_reading_end_with_it():
    """What is allowed while a stage is read is less than before, and as before afterwards."""
    from synfog_usd.cli import worker

    kinds = (resource.RLIMIT_DATA, resource.RLIMIT_CPU, resource.RLIMIT_CORE)
    before = [resource.getrlimit(kind) for kind in kinds]
    with worker.reading_limits():
        inside = [resource.getrlimit(kind)[0] for kind in kinds]
        assert 0 < inside[0] < 8e9
        system.allow(1 << 20)
        assert resource.getrlimit(resource.RLIMIT_DATA)[0] == inside[0] + (1 << 20)
        assert system.READ_CPU_S <= inside[1] < system.READ_CPU_S + 3600 and inside[2] == 0
    assert [resource.getrlimit(kind) for kind in kinds] == before


def test_a_stage_that_takes_too_long_to_read_ends_in_one_line(tmp_path):
    """With a second of processor time instead of ten minutes."""
    path = written(tmp_path / "slow.usda", bomb(15, instanceable=False))
    limit = "from synfog_usd.base import system\nsystem.READ_CPU_S = 1"
    done = process_after(limit, "check", path, env={**os.environ, budget.TRUSTED: "1"})
    told = done.stderr
    assert done.returncode == 2 and told.count("\n") == 1 and "more processor time than it may: 600 s to read" in told


# -- value clips, expressions, and sizes that no stage has


def clips(words):
    """A prim whose values come from a row of files."""
    return prim(f'clips = {{\n dictionary default = {{\n{words}\n string primPath = "/A"\n }}\n    }}')


def clip(template, begin, end, stride, *, manifest="./manifest.usda"):
    times = f"double templateStartTime = {begin}\n double templateEndTime = {end}\n double templateStride = {stride}"
    return clips(f'string templateAssetPath = "{template}"\n {times}\n asset manifestAssetPath = @{manifest}@')


TIMES = "double2[] active = [(0, 0)]\n double2[] times = [(-1e308, inf)]"


@pytest.mark.parametrize("text, words", [
    (clip("./c.###.usda", 0, "1e9", "1e-3"), r"/A: its clips from 0 to 1e\+09 by 0.001 are 1e\+12 files; at most"),
    (clip("./c.###.usda", 0, 5, 0), r"/A: its clips .* are inf files"),
    (clip("../kit/c.###.usda", 0, 5, 1), "/A: value clip .* lies outside of the stage's folder"),
    (clip("./l.###.usda", 0, 5, 1), r"/A: value clip .*l\.001\.usda \(a link to .* lies outside"),
    (clip("./c.###.usda", 0, 5, 1, manifest="../kit/car.usda"), "/A: value clip .* lies outside"),
    (clips(f"asset[] assetPaths = [@../kit/car.usda@]\n {TIMES}"), "/A: value clip .*car.usda lies outside"),
])  # fmt: skip
def test_value_clips_are_few_and_lie_within_the_fence(two_folders, text, words):
    """USD lists the files of a template when it opens a stage: 10^12 of them for ever.  None is opened to say so."""
    folder, kit = two_folders
    (folder / "l.001.usda").symlink_to(kit / "car.usda")
    with pytest.raises(StageError, match=words) as caught:
        open_stage(written(folder / "stage.usda", HEAD + CAMERA + text))
    assert "\n" not in str(caught.value)


def test_sound_value_clips_are_read(tmp_path):
    """x is 7 in the clip at frame 1."""
    written(tmp_path / "manifest.usda", '#usda 1.0\ndef Xform "A"\n{\n    double x\n}\n')
    written(
        tmp_path / "c.001.usda", '#usda 1.0\ndef Xform "A"\n{\n    double x.timeSamples = {\n        1: 7,\n    }\n}\n'
    )
    stage = open_stage(written(tmp_path / "stage.usda", HEAD + CAMERA + clip("./c.###.usda", 1, 3, 1)))
    assert stage.GetPrimAtPath("/A").GetAttribute("x").Get(1.0) == 7.0


def expressed(levels):
    """The bomb of references, each by way of an expression."""
    text = '#usda 1.0\n(\n    expressionVariables = {\n        string FILE = "stage"\n    }\n)\n' + bomb(
        levels, instanceable=False
    ).removeprefix(HEAD)
    return text.replace("references = <", 'references = @`"./${FILE}.usda"`@<')


def test_expressions_are_evaluated_before_what_they_lead_to_is_counted(two_folders):
    """A bomb whose references are expressions, a file elsewhere, and a variable of the layer itself."""
    folder, kit = two_folders
    with pytest.raises(StageError, match="unfolds to"):
        open_stage(written(folder / "stage.usda", expressed(30)))
    size = budget.check_stage(open_stage(written(folder / "small.usda", expressed(3).replace('"stage"', '"small"'))))
    assert size.shapes == 1 + 2 + 4 + 8
    variables = '(\n    expressionVariables = {{\n        string F = "{}"\n    }}\n    defaultPrim = "R"\n)\n'
    refers = 'def "R" (\n    references = @`"./${F}.usda"`@\n)\n{\n}\n'
    outside = "#usda 1.0\n" + variables.format("../kit/car") + refers
    with pytest.raises(StageError, match=r"/R: .*car.usda lies outside"):
        open_stage(written(folder / "away.usda", outside))
    assert open_stage(folder / "away.usda", allow=[kit]).GetPrimAtPath("/R/Body")
    for name, target in (("one", "leaf"), ("leaf", "")):
        text = "#usda 1.0\n" + variables.format(target) + (refers if target else 'def Cube "R"\n{\n}\n')
        written(folder / f"{name}.usda", text.replace('string F = ""', ""))
    both = 'def "A" (\n    references = @./one.usda@\n)\n{\n}\n'
    assert str(open_stage(written(folder / "both.usda", HEAD + both)).GetPrimAtPath("/A").GetTypeName()) == "Cube"


def test_a_variable_set_above_leads_no_texture_out_of_the_fence(two_folders):
    """Its own layer says a file beside it; the layer that refers to it, and what is drawn, one elsewhere."""
    folder, kit = two_folders
    (folder / "sky.png").write_bytes(png(2, 2))
    for name, target, body in (
        ("leaf", "./sky.png", 'def DomeLight "R"\n{\n    asset inputs:texture:file = @`"${F}"`@\n}\n'),
        ("above", "../kit/sky.png", CAMERA + 'def "R" (\n    references = @./leaf.usda@\n)\n{\n}\n'),
        ("tiles", "../kit/sky.<UDIM>.png", CAMERA + 'def "R" (\n    references = @./leaf.usda@\n)\n{\n}\n'),
        ("well", "sky.png", CAMERA + 'def "R" (\n    references = @./leaf.usda@\n)\n{\n}\n'),
    ):
        written(
            folder / f"{name}.usda",
            f'#usda 1.0\n(\n    expressionVariables = {{\n        string F = "{target}"\n    }}\n    defaultPrim = '
            f'"R"\n)\n{body}',
        )
    open_stage(folder / "well.usda")
    for name in ("above", "tiles"):
        with pytest.raises(StageError, match=r"/R\.inputs:texture:file: .* lies outside"):
            open_stage(folder / f"{name}.usda")
    open_stage(folder / "above.usda", allow=[kit])


def promised(*words):
    """Run a command line: it ends with at most one line of error and within 3 GB; that line.

    How long it takes is the machine's, and stands in docs/measurements/stages.md.
    """
    with tempfile.TemporaryFile("w+") as told:
        child = subprocess.Popen(cli.command(*words), stdout=subprocess.DEVNULL, stderr=told)
        _, status, spent = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        told.seek(0)
        said = told.read()
    assert child.returncode == 2 and said.count("\n") <= 1 and "Traceback" not in said, said
    assert spent.ru_maxrss < 3_000_000, spent
    return said


def test_values_nested_without_end_are_one_line(tmp_path):
    """USD's parser keeps what it is within, and takes 20 GB for 100 000 brackets where it may."""
    text = f'def "A"\n{{\n    float[] x = {"[" * 100_000}{"]" * 100_000}\n}}\n'
    promised("check", written(tmp_path / "deep.usda", HEAD + CAMERA + text))


@pytest.mark.parametrize("table, rows", [pytest.param("SPECS", 1 << 27, marks=pytest.mark.slow), ("TOKENS", 1 << 40)])
def test_a_table_of_a_damaged_file_that_says_it_is_long_is_one_line(tmp_path, table, rows):
    """USD makes room for as many rows or letters as a file of 2 kB says it has."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usdc"))
    UsdGeom.Camera.Define(stage, "/Ego")
    stage.Save()
    crates.put(tmp_path / "a.usdc", table, rows)
    assert "cannot be read as USD" in promised("check", tmp_path / "a.usdc")


BOMB = """
import sys
import numpy as np
from pxr import Usd, UsdGeom, Vt
stage = Usd.Stage.CreateNew(sys.argv[1])
UsdGeom.Camera.Define(stage, "/Ego")
mesh = UsdGeom.Mesh.Define(stage, "/M")
mesh.CreatePointsAttr([(0, 5, 0), (1, 5, 0), (0, 5, 1)])
mesh.CreateFaceVertexCountsAttr([3])
mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
mesh.GetPrim().GetAttribute("faceVertexIndices").Set(Vt.IntArray.FromNumpy(np.zeros(400_000_000, np.int32)))
stage.Save()
"""


@pytest.mark.slow
def test_a_small_file_that_unpacks_to_gigabytes_is_one_line(tmp_path):
    """400 million equal numbers in 0.4 MB; made in a child, since what is started shows its parent's memory."""
    path = tmp_path / "a.usdc"
    subprocess.run([sys.executable, "-c", BOMB, path], check=True)
    promised("bake", path, "-o", tmp_path / "out", "--resolution", "16x9", "--samples", "2")


MESH = """def Mesh "Quad"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 5, 0), (1, 5, 0), (0, 5, 1)]
    uniform token subdivisionScheme = "none"
}
"""
POINTS = "point3f[] points = [(0, 5, 0), (1, 5, 0), (0, 5, 1)]"


def placed(matrix):
    return (
        f'matrix4d xformOp:transform = {matrix}\n    uniform token[] xformOpOrder = ["xformOp:transform"]\n    {POINTS}'
    )


@pytest.mark.parametrize("new, words", [
    (placed("((1e38, 0, 0, 0), (0, 1e38, 0, 0), (0, 0, 1e38, 0), (1e38, 1e38, 1e38, 1))"), "more than 10 digits"),
    (placed("((1, 0, 0, 0), (0, nan, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))"), "more than 10 digits"),
    (placed("((0, 0, 0, 0), (0, 0, 0, 0), (0, 0, 0, 0), (0, 0, 0, 1))"), "scaled to nothing"),
    ("point3f[] points = [(0, 5, 0), (1e38, 5, 0), (0, 5, 1)]", "more than 12 digits"),
    ("point3f[] points = [(0, 5, 0), (inf, 5, 0), (0, 5, 1)]", "more than 12 digits"),
    (POINTS, None),
])  # fmt: skip
def test_a_shape_beyond_every_street_is_left_out_with_a_note(tmp_path, new, words):
    scene = translate(open_stage(written(tmp_path / "stage.usda", HEAD + CAMERA + MESH.replace(POINTS, new))))
    told = [note.text for note in scene.notes if note.path == "/Quad" and note.severity == "warning"]
    assert len(told) == (0 if words is None else 1) and all(words in text for text in told)
    assert sum(key.startswith("shape_") for key in scene.world) == (words is None)


@pytest.mark.parametrize(
    "unit, fits", [("1e300", False), ("-1", False), ("nan", False), ("1e-9", False), ("1000", True)]
)
def test_a_unit_that_no_stage_is_in_is_refused(tmp_path, unit, fits):
    head = HEAD.replace("metersPerUnit = 1", f"metersPerUnit = {unit}")
    stage = open_stage(written(tmp_path / "stage.usda", head + CAMERA))
    if fits:
        translate(stage)
    else:
        with pytest.raises(StageError, match=r"metersPerUnit = .* is not from 1e-06 to 1000"):
            translate(stage)


WALL = (
    'def Cube "Wall"\n{\n    double3 xformOp:translate = (0, 0, -9)\n    uniform token[] xformOpOrder = '
    '["xformOp:translate"]\n}\n'
)


@pytest.mark.parametrize("camera, light, told", [
    ("", 'SphereLight "L"\n{\n    float inputs:intensity = 1e30\n', "/L: gives 1e.30 .*at most 1e.16 can be counted"),
    ("", 'SphereLight "L"\n{\n    float inputs:exposure = 1000\n', "/L: gives .*lower its intensity or exposure"),
    ("", 'DomeLight "L"\n{\n    float inputs:intensity = 1e30\n', "/L: gives 1e.30"),
    ("", 'DistantLight "L"\n{\n    float inputs:intensity = 1e30\n', "/L: gives 6.72e.25"),
    ("float horizontalAperture = 1e30", 'DomeLight "L"\n{\n', "/Ego: an aperture of 1e.30 .*angle of view of 180"),
    ("float focalLength = 1e30", 'DomeLight "L"\n{\n', "/Ego: .*angle of view of 1.2e-27 degrees"),
    ("float horizontalApertureOffset = 1e30", 'DomeLight "L"\n{\n', "/Ego: its aperture offset is .* times the"),
])  # fmt: skip
def test_numbers_that_no_renderer_can_count_are_refused_by_check_and_by_translation(tmp_path, camera, light, told):
    """They ended in a renderer's traceback, or as infinity in bake.json, after `check` had found nothing."""
    path = written(tmp_path / "a.usda", HEAD + f'def Camera "Ego"\n{{\n    {camera}\n}}\ndef {light}}}\n' + WALL)
    with pytest.raises(StageError, match=told):
        translate(open_stage(path))
    found, *_ = look(path)
    assert [one.severity for one in found if re.search(told, one.text)] == ["error"]


def test_of_equal_shapes_in_one_place_a_few_are_drawn(tmp_path):
    """A ray would test each of them; what stands elsewhere, and what has other points, is drawn."""
    alike = "".join(f'def Cube "C{n}"\n{{\n}}\n' for n in range(3 * budget.MAX_ALIKE))
    others = MESH + MESH.replace("Quad", "Other").replace("(1, 5, 0)", "(2, 5, 0)")
    points = f"""def PointInstancer "Many"
{{
    rel prototypes = </Many/Box>
    int[] protoIndices = {[0] * (budget.MAX_ALIKE + 9)}
    point3f[] positions = {[(0, 9, 0)] * (budget.MAX_ALIKE + 8) + [(5, 9, 0)]}
    def Cube "Box"
    {{
    }}
}}
"""
    scene = translate(open_stage(written(tmp_path / "a.usda", HEAD + CAMERA + alike + others + points)))
    assert sum(key.startswith("shape_") for key in scene.world) == 2 * budget.MAX_ALIKE + 2
    assert sum(key.startswith("instance_") for key in scene.world) == budget.MAX_ALIKE + 1
    (note,) = [note for note in scene.notes if "equal ones stand in one place" in note.text]
    assert note.severity == "warning" and note.text.startswith(f"{budget.MAX_ALIKE + 8} shapes")


def test_a_texture_that_links_to_itself_is_one_that_is_not_there(tmp_path):
    (tmp_path / "loop.png").symlink_to("loop.png")
    light = 'def DomeLight "Sky"\n{\n    asset inputs:texture:file = @./loop.png@\n}\n'
    scene = translate(open_stage(written(tmp_path / "a.usda", HEAD + CAMERA + light)))
    assert "loop.png" in " ".join(note.text for note in scene.notes)


def test_a_line_break_in_the_stages_name_is_told_in_one_line(tmp_path):
    path = written(tmp_path / "new\nline.usda", HEAD + CAMERA)
    with pytest.raises(StageError, match="control character; rename it") as caught:
        open_stage(path)
    assert "\n" not in str(caught.value)


def lamps(folder, many, kind="SphereLight", inputs="", prototype=False):
    """A stage of lamps in a row; of one lamp in as many places where it is a prototype."""
    body = "".join(
        f'def {kind} "L{n}"\n{{\n{inputs.format(n=n)}    double3 xformOp:translate = ({n}, 9, 0)\n'
        '    uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
        for n in range(1 if prototype else many)
    )
    if prototype:
        body = (
            f'def PointInstancer "Many"\n{{\n    rel prototypes = </Many/P>\n    int[] protoIndices = {[0] * many}\n'
            f"    point3f[] positions = {[(n, 0, 0) for n in range(many)]}\n"
            f'    def Xform "P"\n    {{\n{body}    }}\n}}\n'
        )
    return written(folder / "lamps.usda", HEAD + CAMERA + body)


@pytest.mark.parametrize("kind, prototype", [("SphereLight", False), ("RectLight", True)])
def test_lamps_beyond_the_limit_are_refused_by_their_number(tmp_path, kind, prototype, monkeypatch):
    assert budget.MAX_LAMPS == 5000
    monkeypatch.setattr(budget, "MAX_LAMPS", 1000)
    stage = open_stage(lamps(tmp_path, 1001, kind, prototype=prototype))
    with pytest.raises(StageError, match=r"^/.*: one more than the 1 000 lamps .*SYNFOG_USD_LARGE=1"):
        translate(stage)
    monkeypatch.setenv(budget.TRUSTED, "1")
    monkeypatch.setattr(budget, "MAX_LAMPS_TRUSTED", 10)
    with pytest.raises(StageError, match=r"one more than the 10 lamps and lit surfaces .* does not see$"):
        translate(stage)


def test_kinds_of_lit_surfaces_and_their_triangles_are_refused_by_their_number(tmp_path, monkeypatch):
    """A thousand intensities are drawn, one more is not, nor are stretched balls of more triangles than can shine."""
    each = "    float inputs:intensity = 1{n}\n"
    translate(open_stage(lamps(tmp_path, budget.MAX_LIT_KINDS, inputs=each)))
    many = budget.MAX_LIT_KINDS + 1
    with pytest.raises(StageError, match=r"^1 001 lit surfaces of 1 001 kinds; at most 1 000 are drawn: give"):
        translate(open_stage(lamps(tmp_path, many, inputs=each)))
    translate(open_stage(lamps(tmp_path, many)))
    monkeypatch.setattr(budget, "MAX_LIT_TRIANGLES", 10)
    with pytest.raises(StageError, match=r"^1 lit surfaces of \d+ triangles; at most 10 can shine"):
        translate(open_stage(lamps(tmp_path, 1, "CylinderLight")))

"""Opening, variants and what a stage is made of."""

import re
import shutil

import pytest
from pxr import Usd

from synfog_usd.base.errors import StageError
from synfog_usd.cli.main import app
from synfog_usd.stage import composition_notes, dependencies, open_stage, override, select, stage_hash, variants
from synfog_usd.stage.open import unit_notes
from synfog_usd.stage.types import mistyped
from synfog_usd.translate import translate

STREET = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "World" (
    variants = { string fog = "mor300" }
    prepend variantSets = ["fog", "lighting"]
    references = @./car.usda@
) {
    variantSet "fog" = {
        "clear" {
            over "Fog" (active = false) {}
        }
        "mor300" {
            over "Fog" {
                float synfog:fog:mor = 300
            }
        }
        "mor150" {
            over "Fog" {
                float synfog:fog:mor = 150
            }
        }
    }
    variantSet "lighting" = {
        "sky" { }
        "active" { }
    }
    def Cube "Fog" ( prepend apiSchemas = ["SynFogMediumAPI"] ) { }
    def Camera "Ego" { }
}
"""
CAR = '#usda 1.0\n(\n    defaultPrim = "Car"\n)\ndef Xform "Car" {\n    def Cube "Body" { }\n}\n'


@pytest.fixture
def street(tmp_path):
    (tmp_path / "car.usda").write_text(CAR, encoding="utf-8")
    (tmp_path / "street.usda").write_text(STREET, encoding="utf-8")
    return tmp_path / "street.usda"


def test_choosing_a_variant_writes_nothing_to_the_input(street):
    """The choice stands on the session layer; the files and the root layer stay as they are."""
    stage = open_stage(street)
    assert variants(stage) == {"fog": ["clear", "mor150", "mor300"], "lighting": ["active", "sky"]}
    before = {path: path.read_bytes() for path in street.parent.iterdir()}
    root = stage.GetRootLayer().ExportToString()
    select(stage, fog="mor150", lighting="active")
    prim = stage.GetPrimAtPath("/World/Fog")
    assert prim.GetAttribute("synfog:fog:mor").Get() == 150.0
    assert stage.GetPrimAtPath("/World").GetVariantSet("lighting").GetVariantSelection() == "active"
    select(stage, fog="clear")
    assert not stage.GetPrimAtPath("/World/Fog").IsActive()
    assert stage.GetRootLayer().ExportToString() == root and not stage.GetRootLayer().dirty
    assert {path: path.read_bytes() for path in street.parent.iterdir()} == before


def test_unknown_variants_are_refused_with_what_there_is(street):
    stage = open_stage(street)
    with pytest.raises(
        StageError,
        match=r"/World: variant set 'fog' has no 'mor15'; it has clear, mor150, mor300. Did you mean 'mor150'",
    ):
        select(stage, fog="mor15")
    plain = Usd.Stage.CreateInMemory()
    assert variants(plain) == {}
    with pytest.raises(StageError, match="no root prim has a variant set 'lighting'"):
        select(plain, lighting="sky")


def test_the_hash_is_of_the_content_and_not_of_the_place(street, tmp_path_factory):
    """Moved files hash the same, a chosen variant does not count, an edited reference does."""
    first = stage_hash(open_stage(street))
    moved = tmp_path_factory.mktemp("elsewhere") / "here"
    shutil.copytree(street.parent, moved)
    stage = open_stage(moved / "street.usda")
    assert stage_hash(stage) == first
    select(stage, fog="clear")
    assert stage_hash(stage) == first
    assert [path.name for path in dependencies(stage)] == ["car.usda", "street.usda"]
    del stage
    (moved / "car.usda").write_text(CAR.replace("Cube", "Sphere"), encoding="utf-8")
    assert stage_hash(open_stage(moved / "street.usda")) != first


def test_textures_belong_to_the_stage(street):
    picture = street.parent / "sky.exr"
    picture.write_bytes(b"one")
    street.write_text(STREET + 'def DomeLight "Sky" {\n asset inputs:texture:file = @./sky.exr@\n}\n', encoding="utf-8")
    stage = open_stage(street)
    assert picture in dependencies(stage)
    first = stage_hash(stage)
    picture.write_bytes(b"two")
    assert stage_hash(stage) != first


@pytest.mark.parametrize("name, text, message", [
    ("gone.usda", None, "no such file"),
    ("picture.png", "x", "not a USD file by its name"),
    ("broken.usda", "hello", "cannot be read as USD"),
    ("broken.usdc", "hello", "cannot be read as USD"),
    ("broken.usdz", "hello", "cannot be read as USD"),
    ("empty.usda", "", "cannot be read as USD"),
])  # fmt: skip
def test_what_cannot_be_opened_says_why_in_one_line(tmp_path, name, text, message):
    path = tmp_path / name
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(StageError, match=message) as caught:
        open_stage(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


WITHOUT = '#usda 1.0\n(\n    subLayers = [@./light.usda@]\n)\ndef Camera "Ego" { }\ndef Cube "Wall" { }\n'


@pytest.mark.parametrize("text, path, told", [
    ('def "A" (references = @./props/gone.usda@</A>) { }', "/A",
     "its reference ./props/gone.usda is missing; drawn without it"),
    ('def "A" (payload = @./gone.usdc@) { }', "/A", "its payload ./gone.usdc is missing; drawn without it"),
    ("", "/", "its sublayer ./light.usda is missing; drawn without it"),
    ('def "A" (references = </A>) { }', "/A", "Cycle detected"),
    ('def "A" (references = </B>) { }', "/A", "Unresolved"),
])  # fmt: skip
def test_a_stage_is_drawn_without_what_is_missing(tmp_path, text, path, told):
    """The rest is drawn, each missing file is told with the prim that wanted it, and `whole` refuses."""
    if text:
        (tmp_path / "light.usda").write_text("#usda 1.0\n")
    (tmp_path / "a.usda").write_text(WITHOUT + text)
    stage = open_stage(tmp_path / "a.usda")
    (note,) = composition_notes(stage)
    assert (note.severity, note.path) == ("warning", path) and note.text.startswith(told)
    scene = translate(stage)
    assert note in scene.notes and any(key.startswith("shape_") for key in scene.world)
    with pytest.raises(StageError, match="put the missing file in its place") as caught:
        open_stage(tmp_path / "a.usda", whole=True)
    assert "\n" not in str(caught.value)


def test_a_camera_in_a_missing_sublayer_is_refused_by_that_layers_name(tmp_path):
    (tmp_path / "a.usda").write_text('#usda 1.0\n(\n    subLayers = [@./shot.usda@]\n)\ndef Cube "Wall" { }\n')
    with pytest.raises(
        StageError, match=r"no camera; /: its sublayer ./shot.usda is missing; put that file in its place"
    ):
        translate(open_stage(tmp_path / "a.usda"))


@pytest.mark.parametrize(
    "asset, scale, warned",
    [(0.01, 1.0, True), (0.01, 0.01, False), (1.0, 1.0, False), (0.01, 0.02, False), (None, 1.0, False)],
)
def test_a_reference_in_other_units_wants_a_scale(tmp_path, asset, scale, warned):
    """USD converts nothing: a car in centimetres is drawn 450 m long, unless the reference is scaled by 0.01."""
    units = f"    metersPerUnit = {asset}\n" if asset else ""
    (tmp_path / "car.usda").write_text(f'#usda 1.0\n(\n    defaultPrim = "Car"\n{units})\ndef Cube "Car" {{ }}\n')
    placed = (
        f"    double3 xformOp:scale = ({scale}, {scale}, {scale})\n    uniform token[] xformOpOrder = "
        f'["xformOp:scale"]\n'
    )
    text = (
        f'def Camera "Ego" {{ }}\ndef Xform "World"\n{{\n{placed}    def "Car" (\n        references = @./car.usda@\n '
        f"   )\n    {{\n    }}\n}}\n"
    )
    (tmp_path / "a.usda").write_text("#usda 1.0\n(\n    metersPerUnit = 1\n)\n" + text)
    notes = unit_notes(open_stage(tmp_path / "a.usda"))
    assert [note.path for note in notes] == (["/World/Car"] if warned else [])
    assert all(
        "car.usda, in units of 0.01 m where the stage has 1 m" in note.text and "scale it by 0.01" in note.text
        for note in notes
    )


PAINTED = """#usda 1.0
def Camera "Ego" { }
def Xform "Car" (
    variantSets = "paint"
    variants = { string paint = "blue" }
) {
    variantSet "paint" = {
        "blue" {
            def Cube "Blue" { }
        }
        "red" {
            def Cube "Red" { }
        }
    }
}
"""


def test_any_variant_is_chosen_by_its_prim_and_set(tmp_path):
    (tmp_path / "a.usda").write_text(PAINTED)
    stage = open_stage(tmp_path / "a.usda")
    override(stage, choices=["/Car:paint=red"])
    assert stage.GetPrimAtPath("/Car/Red") and not stage.GetPrimAtPath("/Car/Blue")
    assert (
        stage.GetRootLayer().ExportToString()
        == Usd.Stage.Open(str(tmp_path / "a.usda")).GetRootLayer().ExportToString()
    )


@pytest.mark.parametrize("choice, told", [
    ("/Cra:paint=red", r"no prim /Cra; variants are on /Car. Did you mean '/Car'"),
    ("/Car:pain=red", r"/Car has paint. Did you mean 'paint'"),
    ("/Car:paint=rad", r"has blue, red. Did you mean 'red'"),
    ("/Car=red", "not PRIM:SET=VARIANT"),
    ("Car:paint=red", "not PRIM:SET=VARIANT"),
])  # fmt: skip
def test_variants_that_are_not_there_are_refused_with_those_that_are(tmp_path, choice, told):
    (tmp_path / "a.usda").write_text(PAINTED)
    with pytest.raises(StageError, match=told):
        override(open_stage(tmp_path / "a.usda"), choices=[choice])


def test_a_shell_completes_variants_from_the_stage(tmp_path, monkeypatch, capsys):
    """As zsh asks for them: all, those that begin so, and none of a stage that cannot be read."""
    (tmp_path / "a.usda").write_text(PAINTED)

    def asked(file, begun):
        monkeypatch.setenv("_SYNFOG_USD_COMPLETE", "complete_zsh")
        monkeypatch.setenv("_TYPER_COMPLETE_ARGS", f"synfog-usd bake {tmp_path / file} --choose {begun}")
        with pytest.raises(SystemExit):
            app(prog_name="synfog-usd")
        return re.findall(r"/[\w/]+:\w+=\w+", capsys.readouterr().out.replace("\\", ""))

    found = asked("a.usda", "")
    assert found
    for choice in found:
        override(open_stage(tmp_path / "a.usda"), choices=[choice])
    assert asked("a.usda", found[-1][:-1]) == [choice for choice in found if choice.startswith(found[-1][:-1])]
    assert asked("none.usda", "") == []


def test_a_type_that_usd_does_not_know_is_told_though_it_has_a_value():
    """`uble height = 0.7`, of which a letter was lost: asked for its type's default, the library died."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString('#usda 1.0\ndef Cone "A"\n{\n    uble height = 0.7\n}\n')
    (text,) = mistyped(stage)
    assert text.startswith("/A.height is of a type that USD does not know")

"""`check --fix`: what a layer over a stage mends, and what it leaves to its author."""

import hashlib
import json

import pytest
from pxr import Usd, UsdGeom
from support.cli import run

from synfog_usd.base.errors import OutputError
from synfog_usd.dataset import check as verb

HEAD = '#usda 1.0\n(\n    metersPerUnit = {metres}\n    upAxis = "Z"\n    documentation = "a street"\n)\n'
EGO = """    def Camera "Ego" {
        float2 clippingRange = (0.1, 100000)
        float xformOp:rotateX = 90
        uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }
    def DomeLight "Sky" {
        float inputs:intensity = 3000
    }
"""


MOVED = """        double3 xformOp:translate = (0, {at}, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
"""
LABELLED = """ (
        prepend apiSchemas = ["SemanticsLabelsAPI:cityscapes"]
    )"""


def body(name, length, at=1000, label=None):
    """A cube of an edge, some way ahead."""
    said = f'        token[] semantics:labels:cityscapes = ["{label}"]\n' if label else ""
    head = f'    def Cube "{name}"{LABELLED if label else ""}\n    {{\n{said}'
    return f"{head}        double size = {length}\n{MOVED.format(at=at)}    }}\n"


@pytest.fixture
def written(tmp_path):
    """Write a stage of bodies; gives its path."""

    def write(*bodies, metres=1, name="street.usda"):
        path = tmp_path / name
        path.write_text(HEAD.format(metres=metres) + f'def Xform "World"\n{{\n{EGO}{"".join(bodies)}}}\n')
        return path

    return write


def mended(path, out=None):
    """(lines, findings by rule before, and after; the stage that was written)."""
    out = out or path.with_name("mended.usda")
    found, *_ = verb.look(path)
    lines = verb.mended(path, out)
    after, notes, _ = verb.look(out)
    return lines, found, [*after, *notes], Usd.Stage.Open(str(out))


FOG = """    def Cube "Fog" (
        prepend apiSchemas = ["SynFogMediumAPI"]
    )
    {
        double size = 5000
    }
"""
DARK = """    def SphereLight "Lamp"
    {
        float inputs:intensity = 1e38
        float inputs:exposure = 2000
    }
"""


def test_labels_purposes_lamps_and_the_default_prim_are_mended(written):
    """A car by its name, a label that is a synonym, a solid fog, a lamp of no number: each told, mended and not found
    again; the stage's bytes are as before.
    """
    path = written(body("Car_01", 4.5), body("Thing", 1.8, label="pedestrian"), FOG, DARK)
    before = hashlib.sha256(path.read_bytes()).hexdigest()
    lines, found, after, stage = mended(path)
    assert {one.rule for one in found} >= {"road-user-unlabelled", "label-unknown", "fog-solid", "light-bright"}
    rules = {getattr(one, "rule", "note") for one in after}
    assert rules.isdisjoint(
        {"road-user-unlabelled", "label-unknown", "fog-solid", "light-bright", "usd:MissingDefaultPrim"}
    )
    assert {line.split(":")[0] for line in lines} == {"/", "/World/Car_01", "/World/Thing", "/World/Fog", "/World/Lamp"}
    label = {
        name: list(stage.GetPrimAtPath(f"/World/{name}").GetAttribute("semantics:labels:cityscapes").Get())
        for name in ("Car_01", "Thing")
    }
    assert label == {"Car_01": ["car"], "Thing": ["person"]}
    assert UsdGeom.Imageable(stage.GetPrimAtPath("/World/Fog")).ComputePurpose() == "guide"
    assert stage.GetDefaultPrim().GetName() == "World"
    assert stage.GetMetadata("documentation") == "a street"  # by which lights of Blender are known
    assert hashlib.sha256(path.read_bytes()).hexdigest() == before


def test_what_is_a_choice_is_left(written):
    """A label that is nothing, a lamp that is too bright, a fog that the camera is not in: found before and after."""
    apart = f'        double size = 2\n        uniform token purpose = "guide"\n{MOVED.format(at=900)}'
    far = FOG.replace("        double size = 5000\n", apart)
    bright = DARK.replace("exposure = 2000", "exposure = 0").replace("1e38", "1e12")
    path = written(body("Thing", 1.8, label="spaceship"), far, bright)
    _, found, after, _ = mended(path)
    kept = {"label-unknown", "camera-outside-fog", "light-bright"}
    assert kept <= {one.rule for one in found} and kept <= {getattr(one, "rule", "") for one in after}


@pytest.mark.parametrize("lengths, metres, unit", [
    ({"Car_1": 450, "Person_1": 175}, 1, 0.01),
    ({"Car_1": 4.5, "Person_1": 1.75}, 0.01, 1.0),
    ({"Car_1": 177, "Person_1": 69}, 1, 0.0254),
    ({"Car_1": 4.5, "Person_1": 1.75}, 1, 1),  # as it should be
    ({"Car_1": 450, "Person_1": 1.75}, 1, 1),  # one of them is wrong, and which cannot be told from the unit
    ({"Car_1": 200}, 1, 1),  # 2 m of centimetres, or 5 m of inches
])  # fmt: skip
def test_a_unit_is_mended_where_it_alone_fits_all(written, lengths, metres, unit):
    """Of centimetres, inches, feet and the like exactly one gives every road user its size."""
    lines, _, after, stage = mended(written(*(body(*one) for one in lengths.items()), metres=metres))
    assert UsdGeom.GetStageMetersPerUnit(stage) == pytest.approx(unit, rel=1e-6)
    assert any("metersPerUnit" in line for line in lines) == (unit != metres)
    if unit != metres:
        assert not [one for one in after if getattr(one, "rule", "") == "units" or "nothing is scaled" in one.text]


@pytest.mark.parametrize("inner", [False, True])
def test_a_reference_in_other_units_is_scaled_in_its_place(written, tmp_path, inner):
    """A car in centimetres, moved by the stage in metres or by its own file in centimetres, ends 4.5 m long at 20 m."""
    own, place = (MOVED.format(at=2000), "") if inner else ("", MOVED.format(at=20))
    head = HEAD.format(metres=0.01).replace("(\n", '(\n    defaultPrim = "Car"\n', 1)
    (tmp_path / "car.usda").write_text(f'{head}def Cube "Car"\n{{\n        double size = 450\n{own}}}\n')
    placed = f'    def "Car" (\n        references = @./car.usda@\n    )\n    {{\n{place}    }}\n'
    lines, _, after, stage = mended(written(placed))
    box = (
        UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"])
        .ComputeWorldBound(stage.GetPrimAtPath("/World/Car"))
        .ComputeAlignedRange()
    )
    assert list(box.GetSize()) == pytest.approx([4.5] * 3) and list(box.GetMidpoint()) == pytest.approx([0, 20, 0])
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1 and any("scaled by 0.01" in line for line in lines)
    assert not [one for one in after if "nothing is scaled" in one.text or getattr(one, "rule", "") == "units"]


@pytest.mark.parametrize("out", ["street.usda", "mended.txt", "below/mended.usda", "link.usda"])
def test_the_stage_itself_and_places_that_cannot_serve_are_refused(written, tmp_path, out):
    """The stage, a link to it, no USD name, and a folder above which the stage lies: one line, nothing is written."""
    path = written(body("Car", 4.5))
    (tmp_path / "below").mkdir()
    (tmp_path / "link.usda").symlink_to(path)
    before = path.read_bytes()
    with pytest.raises(OutputError):
        verb.mended(path, tmp_path / out)
    assert path.read_bytes() == before and not list((tmp_path / "below").iterdir())


def test_the_command_tells_what_it_mended(written):
    """Lines beginning with 'mended', then the check of the layer; JSON has them as 'fixes'."""
    path = written(body("Car", 4.5))
    done = run("check", path, "--fix", path.with_name("out.usda"))
    assert done.returncode == 0, done.stderr
    assert "mended: /World/Car: label car\n" in done.stdout and "road-user-unlabelled" not in done.stdout
    told = json.loads(run("check", path, "--fix", path.with_name("out.usdc"), "--json").stdout)
    assert "/World/Car: label car" in told["fixes"] and told["stage"].endswith("out.usdc")

"""Metadata of a layer in types that USD's schema does not have, as exporters have stored them."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdUtils
from support.crates import BOOL, DOUBLE, FLOAT, HALF, INT, INT64, STRING, TOKEN, bits, inlined, retype

from synfog_usd.stage import cameras, check, composition_notes, open_stage
from synfog_usd.translate import translate

NUMBERS = {
    "metersPerUnit": UsdGeom.GetStageMetersPerUnit,
    "startTimeCode": Usd.Stage.GetStartTimeCode,
    "endTimeCode": Usd.Stage.GetEndTimeCode,
    "timeCodesPerSecond": Usd.Stage.GetTimeCodesPerSecond,
    "framesPerSecond": Usd.Stage.GetFramesPerSecond,
    "kilogramsPerUnit": lambda stage: stage.GetMetadata("kilogramsPerUnit"),
}
MARK = 0.0625


def written(path, **metadata):
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.Camera.Define(stage, "/Cam")
    UsdGeom.Cube.Define(stage, "/Box").AddTranslateOp().Set((0, 0, -5))
    stage.DefinePrim("/Sky", "DomeLight")
    for name, value in metadata.items():
        stage.SetMetadata(name, value)
    stage.Save()
    return path


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize(
    "kind, content, number",
    [
        (FLOAT, bits(MARK), MARK),
        (HALF, int(np.float16(MARK).view(np.uint16)), MARK),
        (INT, 2, 2.0),
        (INT64, 2, 2.0),
        (BOOL, 1, 1.0),
    ],
    ids=["float", "half", "int", "int64", "bool"],
)
def test_numbers_of_a_stage_may_be_stored_in_any_type(tmp_path, name, kind, content, number):
    """Blender 2.83 stored metersPerUnit as float where USD wants a double."""
    path = written(tmp_path / "a.usdc", **{name: MARK})
    before = path.read_bytes()
    retype(path, (DOUBLE, bits(MARK)), (kind, content))
    assert path.read_bytes() != before
    stage = open_stage(path)
    assert NUMBERS[name](stage) == number
    assert not composition_notes(stage)
    assert not any(one.severity == "error" for one in check(stage))
    translate(stage, resolution=(8, 8))
    assert not stage.GetRootLayer().permissionToSave, "what was mended in memory may not reach the file"


@pytest.mark.parametrize("name, word", [("upAxis", "Z"), ("defaultPrim", "Box")])
def test_words_of_a_stage_may_be_stored_as_strings(tmp_path, name, word):
    """Of a stage that says the word as a token and, as its documentation, as a string."""
    path = written(tmp_path / "a.usdc", **{name: word}, documentation=word)
    whole, (string, *_), found = path.read_bytes(), inlined(path, STRING), set()
    for token in inlined(path, TOKEN):
        path.write_bytes(whole)
        retype(path, (TOKEN, token), (STRING, string))
        stage = open_stage(path)
        found.add((stage.GetMetadata(name), UsdGeom.GetStageUpAxis(stage), str(stage.GetDefaultPrim().GetPath())))
        path = path.with_name(f"{path.stem}a.usdc")
    assert len(found) == 1


def test_what_cannot_be_a_number_is_told_and_usds_own_is_taken(tmp_path):
    path = written(tmp_path / "a.usdc", metersPerUnit=MARK)
    retype(path, (DOUBLE, bits(MARK)), (TOKEN, inlined(path, TOKEN)[0]))
    stage = open_stage(path)
    (note,) = composition_notes(stage)
    assert "metersPerUnit of a.usdc is" in note.text and note.text.endswith("left out")
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01  # UsdGeom's fallback


def test_layers_below_and_packages_may_have_them_too(tmp_path):
    """A sublayer at 12 time codes a second under one of 24: its samples come at twice their times."""
    below = tmp_path / "below.usdc"
    stage = Usd.Stage.CreateNew(str(below))
    ball = UsdGeom.Sphere.Define(stage, "/Ball")
    for time in (0.0, 12.0):
        ball.CreateRadiusAttr().Set(1.0 + time, time)
    stage.SetMetadata("timeCodesPerSecond", 0.5)
    stage.Save()
    del stage, ball
    retype(below, (DOUBLE, bits(0.5)), (INT, 12))
    (tmp_path / "top.usda").write_text("#usda 1.0\n(\n    timeCodesPerSecond = 24\n    subLayers = [@below.usdc@]\n)\n")
    assert open_stage(tmp_path / "top.usda").GetPrimAtPath("/Ball").GetAttribute("radius").GetTimeSamples() == [0, 24]

    path = written(tmp_path / "a.usdc", metersPerUnit=MARK)
    retype(path, (DOUBLE, bits(MARK)), (FLOAT, bits(MARK)))
    assert UsdUtils.CreateNewUsdzPackage(str(path), str(tmp_path / "a.usdz"))
    packed = open_stage(tmp_path / "a.usdz")
    assert UsdGeom.GetStageMetersPerUnit(packed) == MARK and cameras(packed) == ["/Cam"]

"""What is far from the camera is left unloaded; everything else stays as it is."""

import pytest
from pxr import Usd, UsdGeom, UsdLux
from support.looks import fill

from synfog_usd.base.errors import StageError
from synfog_usd.stage import keep_near, open_stage, select
from synfog_usd.translate import summary, translate


@pytest.fixture
def town(tmp_path):
    """Houses by payload, 10 m apart along +Y in centimetres, a sun that is a component, and points 10 m apart."""
    house = Usd.Stage.CreateNew(str(tmp_path / "house.usda"))
    house.SetDefaultPrim(UsdGeom.Xform.Define(house, "/House").GetPrim())
    UsdGeom.Cube.Define(house, "/House/Body").CreateSizeAttr(200.0)
    house.Save()
    stage = Usd.Stage.CreateNew(str(tmp_path / "town.usda"))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    camera = UsdGeom.Camera.Define(stage, "/Camera")
    UsdGeom.XformCommonAPI(camera).SetRotate((90, 0, 0))
    for number in range(10):
        prim = UsdGeom.Xform.Define(stage, f"/House{number}").GetPrim()
        UsdGeom.XformCommonAPI(prim).SetTranslate((0, 1000.0 * (number + 1), 0))
        prim.GetPayloads().AddPayload("./house.usda")
    sun = UsdGeom.Xform.Define(stage, "/Far")
    UsdGeom.XformCommonAPI(sun).SetTranslate((0, 1e6, 0))
    Usd.ModelAPI(sun.GetPrim()).SetKind("component")
    UsdLux.DistantLight.Define(stage, "/Far/Sun")
    many = UsdGeom.PointInstancer.Define(stage, "/Many")
    UsdGeom.Sphere.Define(stage, "/Many/Ball")
    many.CreatePrototypesRel().SetTargets(["/Many/Ball"])
    fill(many, protoIndices=[0] * 10, positions=[(500.0, 1000.0 * (number + 1), 0.0) for number in range(10)])
    stage.Save()
    del stage, house
    return open_stage(tmp_path / "town.usda")


def test_models_whose_box_is_beyond_the_distance_are_not_loaded(town):
    """The near face of house n stands at 10 n - 1 m: of 45 m four are left, and of the points those of 10 to 40 m."""
    before = summary(translate(town))
    assert (before["shapes"], before["instances"]) == (10 + 10, 0)  # ten houses, ten balls that stand as themselves
    assert keep_near(town, 45.0) == 6 + 6
    after = summary(translate(town))
    assert (after["shapes"], after["instances"]) == (4 + 4, 0)
    assert not town.GetPrimAtPath("/House9").IsActive() and not town.GetPrimAtPath("/House9/Body")
    assert town.GetPrimAtPath("/Far/Sun") and after["lights"] == before["lights"]
    assert town.GetRootLayer().dirty is False


def test_a_stage_without_a_camera_is_refused(town):
    with pytest.raises(StageError, match="no camera /House0"):
        keep_near(town, 10.0, cameras=["/House0"])


def test_a_mask_reads_nothing_but_its_prims_and_what_lights_them(town):
    """Two houses of ten, by their payloads; the sun, which no one named, shines on."""
    path = town.GetRootLayer().realPath
    masked = open_stage(path, mask=["/House2", "/House7/Body"])
    after = summary(translate(masked))
    assert (after["shapes"], after["instances"]) == (2, 0) and after["lights"] == summary(translate(town))["lights"]
    assert [str(prim.GetPath()) for prim in masked.Traverse() if prim.IsA(UsdGeom.Cube)] == [
        "/House2/Body",
        "/House7/Body",
    ]
    assert masked.GetPrimAtPath("/Camera") and masked.GetPrimAtPath("/Far/Sun") and not masked.GetPrimAtPath("/House3")


def test_a_mask_keeps_materials_and_fog_of_every_variant(tmp_path):
    """A material elsewhere that a masked prim is bound to, and a bank that is there in one variant only."""
    (tmp_path / "a.usda").write_text(
        """#usda 1.0
(
    defaultPrim = "World"
)
def Xform "World" (
    prepend variantSets = "fog"
    variants = {
        string fog = "clear"
    }
) {
    def Camera "Ego" {}
    def Cube "A" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        rel material:binding = </Looks/Red>
    }
    def Cube "B" {}
    variantSet "fog" = {
        "clear" {}
        "bank" {
            def Cube "Bank" (prepend apiSchemas = ["SynFogMediumAPI"]) {
                float synfog:fog:mor = 100
            }
        }
    }
}
def Material "Looks" {
    def Material "Red" {}
}
"""
    )
    masked = open_stage(tmp_path / "a.usda", mask=["/World/A"])
    select(masked, fog="bank")
    found = {str(prim.GetPath()) for prim in masked.Traverse()}
    assert {"/World/A", "/World/Bank", "/World/Ego", "/Looks/Red"} <= found and "/World/B" not in found


@pytest.mark.parametrize("name, words", [("/House11", "there is no such prim"), ("House1", "not the path of a prim")])
def test_a_mask_of_nothing_is_refused(town, name, words):
    with pytest.raises(StageError, match=f"--mask {name}: {words}"):
        open_stage(town.GetRootLayer().realPath, mask=[name])

"""The rules of `check`: each finds its fault at the prim that has it, and is silent on the same stage without it."""

import math

import pytest
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade, UsdVol
from support.looks import fill

from synfog_usd.stage import check
from synfog_usd.stage.rules import SIZES_M

TYPES = Sdf.ValueTypeNames


@pytest.fixture
def sound():
    """A stage with nothing to say against it: camera and car in fog under a sky, everything labelled."""

    def make(metres_per_unit=1.0):
        k = 1.0 / metres_per_unit
        stage = Usd.Stage.CreateInMemory()
        stage.SetDefaultPrim(stage.DefinePrim("/World", "Xform"))
        UsdGeom.SetStageUpAxis(stage, "Z")
        UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
        UsdGeom.Camera.Define(stage, "/World/Ego")
        UsdLux.DomeLight.Define(stage, "/World/Sky").CreateIntensityAttr(3000.0)
        fog = fill(UsdGeom.Cube.Define(stage, "/World/Fog"), purpose="guide")
        fog.GetSizeAttr().Set(200.0 * k)
        fog.GetPrim().AddAppliedSchema("SynFogMediumAPI")
        car = UsdGeom.Cube.Define(stage, "/World/Car")
        car.GetSizeAttr().Set(4.2 * k)
        car.AddTranslateOp().Set((0, 20 * k, 0))
        label(car, "car")
        return stage

    return make


def label(prim, name):
    prim.GetPrim().CreateAttribute("userProperties:cityscapes", TYPES.String).Set(name)


def found(stage):
    return {(one.rule, one.path) for one in check(stage)}


def test_a_sound_stage_has_no_findings(sound):
    assert found(sound()) == set()
    assert found(sound(0.01)) == set()


@pytest.mark.parametrize("wrong, factor", [(1.0, 100.0), (0.001, 0.1)])
def test_a_car_of_another_unit_is_found(sound, wrong, factor):
    """4.2 m authored in centimetres, read in metres: 420 m; the finding says which factor mends it."""
    stage = sound(0.01)
    UsdGeom.SetStageMetersPerUnit(stage, wrong)
    (one,) = [one for one in check(stage) if one.rule == "units"]
    assert (
        one.path == "/World/Car"
        and f"is {4.2 * factor:.3g} m long" in one.text
        and f"a car {SIZES_M['car'][0]:g} to {SIZES_M['car'][1]:g} m" in one.text
    )
    assert ("times 0.01 it would be 4.2 m" in one.text) == (wrong == 1.0)


def test_a_scale_counts_as_much_as_a_unit(sound):
    stage = sound()
    UsdGeom.Xformable(stage.GetPrimAtPath("/World/Car")).AddScaleOp().Set((1, 0.02, 1))
    assert found(stage) == set()  # the longest edge is as it was
    stage.GetPrimAtPath("/World/Car").GetAttribute("xformOp:scale").Set((0.01, 0.01, 0.01))
    assert found(stage) == {("units", "/World/Car")}


@pytest.mark.parametrize("name, size, rule", [
    ("Sedan_03", 4.2, "road-user-unlabelled"),
    ("redCar", 4.2, "road-user-unlabelled"),
    ("CarPark", 40.0, None),
    ("Carpet", 3.0, None),
    ("Sedan", 420.0, "units"),
    ("pedestrian", 1.8, "road-user-unlabelled"),
    ("Cars", 40.0, None),
    ("House", 9.0, None),
])  # fmt: skip
def test_road_users_without_a_label_are_found_by_name_and_size(sound, name, size, rule):
    stage = sound()
    UsdGeom.Cube.Define(stage, f"/World/{name}").GetSizeAttr().Set(size)
    told = {one for one in found(stage) if one[0] != "unlabelled"}
    assert told == ({(rule, f"/World/{name}")} if rule else set())


def test_what_is_never_drawn_needs_no_label(sound):
    """A helper's shape, whose purpose is that of the prim above; the same shape counts where it is drawn."""
    stage = sound()
    helpers = UsdGeom.Xform.Define(stage, "/World/Helpers")
    UsdGeom.Cube.Define(stage, "/World/Helpers/Box")
    assert found(stage) == {("unlabelled", "/World/Helpers/Box")}
    helpers.CreatePurposeAttr("guide")
    assert found(stage) == set()


def test_road_users_in_instances_are_measured_where_they_stand(sound):
    """A prototype is of no size by itself; its instance is scaled."""
    stage = sound()
    stage.CreateClassPrim("/Kit")
    UsdGeom.Cube.Define(stage, "/Kit/Body").GetSizeAttr().Set(1.0)
    for name, scale in (("A", 4.0), ("B", 400.0)):
        prim = UsdGeom.Xform.Define(stage, f"/World/{name}")
        prim.AddScaleOp().Set((scale,) * 3)
        prim.GetPrim().GetReferences().AddInternalReference("/Kit")
        prim.GetPrim().SetInstanceable(True)
        label(prim, "car")
    assert found(stage) == {("units", "/World/B")}


def test_what_is_missing_is_found(sound):
    stage = sound()
    for name in ("Ego", "Sky", "Fog"):
        stage.GetPrimAtPath(f"/World/{name}").SetActive(False)
    assert found(stage) == {("no-camera", ""), ("no-light", ""), ("no-fog", "")}
    shader = fill(UsdShade.Shader.Define(stage, "/World/Glow"), id="UsdPreviewSurface")
    shader.CreateInput("emissiveColor", TYPES.Color3f).Set((0, 5, 0))
    assert found(stage) == {("no-camera", ""), ("no-fog", "")}
    UsdVol.Volume.Define(stage, "/World/Bank")
    assert found(stage) == {("no-camera", ""), ("unlabelled", "/World/Bank")}


def test_a_camera_outside_of_its_fog_and_a_solid_boundary_are_found(sound):
    stage = sound()
    UsdGeom.Camera.Define(stage, "/World/Far").AddTranslateOp().Set((0, 0, 150))
    UsdGeom.Imageable(stage.GetPrimAtPath("/World/Fog")).GetPurposeAttr().Set("default")
    assert found(stage) == {("camera-outside-fog", "/World/Far"), ("fog-solid", "/World/Fog")}


LIGHTS = [
    # kind, attributes, flux or level by the specification; the limits are 1e8 lm, 1e6 nits and 1e6 lux
    ("SphereLight", {"radius": 0.1, "intensity": 1e9 / (math.pi * 4 * math.pi * 0.01)}, True),
    ("SphereLight", {"radius": 0.1, "intensity": 1e7 / (math.pi * 4 * math.pi * 0.01)}, False),
    ("SphereLight", {"radius": 0.1, "intensity": 1e9 / math.pi, "normalize": True}, True),
    ("SphereLight", {"radius": 0.1, "intensity": 1e7 / math.pi, "normalize": True}, False),
    ("RectLight", {"width": 2.0, "height": 0.5, "intensity": 1.0, "exposure": 26.0}, True),  # pi 2^26 = 2.1e8 lm
    ("RectLight", {"width": 2.0, "height": 0.5, "intensity": 1.0, "exposure": 24.0}, False),  # 5.3e7 lm
    ("DiskLight", {"radius": 1.0, "intensity": 1.1e8 / math.pi**2}, True),
    ("CylinderLight", {"radius": 0.5, "length": 1.0, "intensity": 0.9e8 / math.pi**2}, False),
    ("DomeLight", {"intensity": 1e7}, True),
    ("DomeLight", {"intensity": 1e4}, False),
    ("DistantLight", {"intensity": 1.3e5, "normalize": True}, False),
    ("DistantLight", {"intensity": 2e6, "normalize": True}, True),
    ("DistantLight", {"intensity": 2e6, "angle": 0.53}, False),  # 134 lux
    ("DistantLight", {"intensity": math.inf, "angle": 0.53}, True),
]


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
@pytest.mark.parametrize("kind, values, bright", LIGHTS)
def test_lamps_that_no_lamp_is_are_found(sound, kind, values, bright, metres_per_unit):
    """Flux, luminance or illuminance from the closed form of each light, in whatever unit the stage is."""
    stage = sound(metres_per_unit)
    prim = stage.DefinePrim("/World/Lamp", kind)
    for name, value in values.items():
        in_units = value / metres_per_unit if name in ("radius", "width", "height", "length") else value
        in_units = (
            in_units / metres_per_unit**2
            if name == "intensity" and values.get("normalize") and kind == "SphereLight"
            else in_units
        )
        prim.GetAttribute(f"inputs:{name}").Set(in_units)
    assert found(stage) == ({("light-bright", "/World/Lamp")} if bright else set())


@pytest.mark.parametrize("scale, bright", [(3.0, True), (2.0, False)])
def test_a_scaled_lamp_has_the_square_of_its_scale_in_light(sound, scale, bright):
    """pi L x 4 pi r^2 = 2e7 lm, times four and nine."""
    stage = sound()
    lamp = fill(UsdLux.SphereLight.Define(stage, "/World/Lamp"), radius=1.0, intensity=2e7 / (4 * math.pi**2))
    lamp.AddScaleOp().Set((scale,) * 3)
    assert found(stage) == ({("light-bright", "/World/Lamp")} if bright else set())

"""Lights: photometry in closed form, written down from the UsdLux specification."""

import math

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdLux, Vt
from support.looks import fill, write

from synfog_usd.base.errors import ParameterError
from synfog_usd.translate import translate

TINT_4300 = (1.34255, 0.93791, 0.60611)
"""colour-science 0.4: sd_to_XYZ(sd_blackbody(4300, 360-780 nm)) / Y in linear Rec.709."""


def lamp_of(scene):
    """The one local emitter, and the shape it sits on or None."""
    shapes = [part for key, part in scene.world.items() if key.startswith("shape_") and "emitter" in part]
    lights = [part for key, part in scene.world.items() if key.startswith("light_")]
    assert len(shapes) + len(lights) == 1
    return (shapes[0]["emitter"], shapes[0]) if shapes else (lights[0], None)


def strength(emitter, name="radiance"):
    return np.array(emitter[name]["value"])


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
@pytest.mark.parametrize("kind, size, units2", [
    ("SphereLight", {"radius": 0.2}, 4 * math.pi * 0.2**2),
    ("DiskLight", {"radius": 0.2}, math.pi * 0.2**2),
    ("RectLight", {"width": 0.3, "height": 2.0}, 0.3 * 2.0),
    ("CylinderLight", {"radius": 0.1, "length": 1.5}, 2 * math.pi * 0.1 * 1.5),
])  # fmt: skip
def test_normalize_divides_by_the_area_in_stage_units(empty, kind, size, units2, metres_per_unit):
    """L = intensity 2^exposure color / area; without 'normalize' the area does not count."""
    stage = empty(metres_per_unit=metres_per_unit)
    prim = stage.DefinePrim("/Lamp", kind)
    light = UsdLux.LightAPI(prim)
    fill(light, intensity=30.0, exposure=2.0, color=(1.0, 0.5, 0.25))
    for name, value in size.items():
        prim.GetAttribute(f"inputs:{name}").Set(value)
    UsdGeom.Xformable(prim).AddScaleOp().Set((2.0, 2.0, 2.0))
    emitter, _ = lamp_of(translate(stage))
    np.testing.assert_allclose(strength(emitter), [120.0, 60.0, 30.0], rtol=1e-6)
    light.CreateNormalizeAttr(True)
    emitter, _ = lamp_of(translate(stage))
    np.testing.assert_allclose(strength(emitter), np.array([120.0, 60.0, 30.0]) / (4 * units2), rtol=1e-6)


def test_a_stretched_sphere_has_the_area_of_an_ellipsoid(empty):
    """Prolate spheroid, closed form with a = 1, c = 3: 2 pi a^2 (1 + c / (a e) asin e)."""
    stage = empty()
    light = fill(UsdLux.SphereLight.Define(stage, "/Lamp"), radius=1.0, normalize=True)
    light.AddScaleOp().Set((1.0, 1.0, 3.0))
    emitter, _ = lamp_of(translate(stage))
    e = math.sqrt(1 - 1 / 9)
    np.testing.assert_allclose(
        strength(emitter), 1 / (2 * math.pi * (1 + 3 / e * math.asin(e))), rtol=0.01
    )  # a mesh of 48 x 24 quads


@pytest.mark.parametrize("normalize", [False, True])
def test_distant_light_gives_irradiance(empty, normalize):
    """E = L pi sin^2(angle / 2), or the intensity itself where normalized."""
    stage = empty()
    fill(UsdLux.DistantLight.Define(stage, "/Sun"), intensity=90_000.0, angle=0.53, normalize=normalize)
    emitter, _ = lamp_of(translate(stage))
    wanted = 90_000.0 * (1.0 if normalize else math.pi * math.sin(math.radians(0.53) / 2) ** 2)
    np.testing.assert_allclose(strength(emitter, "irradiance"), wanted, rtol=1e-6)
    np.testing.assert_allclose(
        emitter["to_world"][:3, 2], [0, 0, -1], atol=1e-12
    )  # Mitsuba shines along +Z, USD along -Z


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
def test_a_point_light_keeps_the_intensity_of_its_sphere(empty, metres_per_unit):
    """I = L pi r^2 in candela; normalized: intensity / 4 of a square unit."""
    stage = empty(metres_per_unit=metres_per_unit)
    light = fill(UsdLux.SphereLight.Define(stage, "/Lamp"), radius=0.5, intensity=80.0, treatAsPoint=True)
    emitter, shape = lamp_of(translate(stage))
    assert shape is None and emitter["type"] == "point"
    np.testing.assert_allclose(strength(emitter, "intensity"), 80.0 * math.pi * (0.5 * metres_per_unit) ** 2, rtol=1e-6)
    light.CreateNormalizeAttr(True)
    np.testing.assert_allclose(
        strength(lamp_of(translate(stage))[0], "intensity"), 20.0 * metres_per_unit**2, rtol=1e-6
    )


def test_a_headlight_shines_along_its_minus_z(empty):
    """Candela on the axis: normalized intensity / (4 pi r^2) times pi r^2."""
    stage = empty()
    light = fill(UsdLux.SphereLight.Define(stage, "/Lamp"), radius=0.05, intensity=20_000.0, normalize=True)
    light.AddTranslateOp().Set((0.7, 2, 0.7))
    light.AddRotateXOp().Set(90.0)
    light.AddScaleOp().Set((1, 1, 1))
    shaping = UsdLux.ShapingAPI.Apply(light.GetPrim())
    fill(shaping, shapingConeAngle=25.0, shapingConeSoftness=0.3)
    emitter, shape = lamp_of(translate(stage))
    assert shape is None and emitter["type"] == "photometric"
    np.testing.assert_allclose(strength(emitter, "intensity"), 5_000.0, rtol=1e-6)
    table = emitter["bitmap"][:, 0]  # 0.25 degrees a row
    np.testing.assert_allclose(table[[0, 69]], 1.0, rtol=1e-6)
    np.testing.assert_allclose(table[85], 0.5, rtol=1e-3)
    assert (table[101:] == 0.0).all()
    np.testing.assert_allclose(emitter["to_world"][:3, 2], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(emitter["to_world"][:3, 3], [0.7, 2, 0.7], atol=1e-7)
    np.testing.assert_allclose(np.linalg.det(emitter["to_world"][:3, :3]), 1.0)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["RectLight", "DiskLight"])
def test_flat_lights_shine_along_minus_z(empty, kind, mirror):
    """The normal of Mitsuba's rectangle and disk is the inverse transpose of +Z."""
    stage = empty()
    prim = stage.DefinePrim("/Lamp", kind)
    xform = UsdGeom.Xformable(prim)
    xform.AddRotateXOp().Set(30.0)
    xform.AddScaleOp().Set((2.0 * mirror, 1.0, 1.0))
    _, shape = lamp_of(translate(stage))
    normal = np.linalg.inv(shape["to_world"][:3, :3]).T @ [0, 0, 1]
    np.testing.assert_allclose(
        normal / np.linalg.norm(normal), [0, math.sin(math.radians(30)), -math.cos(math.radians(30))], atol=1e-9
    )


def test_colour_temperature_tints_without_changing_luminance(empty):
    stage = empty()
    fill(UsdLux.SphereLight.Define(stage, "/Lamp"), enableColorTemperature=True, colorTemperature=4300.0)
    emitter, _ = lamp_of(translate(stage))
    np.testing.assert_allclose(strength(emitter), TINT_4300, rtol=1e-3)
    np.testing.assert_allclose(strength(emitter) @ [0.2126, 0.7152, 0.0722], 1.0, rtol=1e-3)


def test_inputs_without_prefix_count(empty):
    """Files before 21.02 write 'intensity' where later ones write 'inputs:intensity'."""
    stage = empty()
    prim = UsdLux.SphereLight.Define(stage, "/Lamp").GetPrim()
    prim.CreateAttribute("intensity", prim.GetAttribute("inputs:intensity").GetTypeName()).Set(12.0)
    np.testing.assert_allclose(strength(lamp_of(translate(stage))[0]), 12.0)


@pytest.mark.parametrize("up, kind, pole, wanted", [
    ("Y", "DomeLight", None, (0, 0, 1)),
    ("Z", "DomeLight", None, (0, 1, 0)),
    ("Z", "DomeLight_1", "scene", (0, 0, 1)),
    ("Y", "DomeLight_1", "scene", (0, 0, 1)),
    ("Z", "DomeLight_1", "Y", (0, 1, 0)),
    ("Z", "DomeLight_1", "Z", (0, 0, 1)),
    ("Y", "DomeLight_1", "Z", (0, -1, 0)),
])  # fmt: skip
def test_the_top_of_a_dome_map_is_its_pole(empty, tmp_path, up, kind, pole, wanted):
    """Mitsuba's map has its top at local +Y; a Y-up stage's Z axis lies along the scene's -Y."""
    stage = empty(up=up)
    pixels = np.random.default_rng(1).uniform(0, 1, (4, 8, 3)).astype(np.float32)
    write(tmp_path / "sky.exr", pixels)
    light = getattr(UsdLux, kind).Define(stage, "/Sky")
    fill(light, textureFile=str(tmp_path / "sky.exr"), intensity=3.0, color=(1.0, 0.5, 2.0))
    if pole:
        light.CreatePoleAxisAttr(pole)
    sky = translate(stage).world["light_sky"]
    assert sky["type"] == "envmap"
    np.testing.assert_allclose(sky["to_world"][:3, 1], wanted, atol=1e-12)
    np.testing.assert_allclose(sky["bitmap"], pixels * [3.0, 1.5, 6.0], rtol=1e-5)


def test_flux_goes_with_intensity_and_the_sky_has_no_end(empty):
    """Spheres of 1 : 9 in intensity are 1 : 9 in flux; what shines from all around has none that could be told."""
    stage = empty()
    for number, intensity in enumerate((10.0, 90.0)):
        fill(UsdLux.SphereLight.Define(stage, f"/Lamp{number}"), intensity=intensity)
    UsdLux.DomeLight.Define(stage, "/Sky")
    scene = translate(stage)
    flux = [scene.flux_of[key] for key in scene.world if key.startswith("shape_")]
    np.testing.assert_allclose(
        flux, 4.0 * np.pi**2 * 0.25 * np.array([10.0, 90.0]), rtol=2e-7
    )  # of a Lambertian sphere, pi L A; the radius is 0.5, and the weights of luminance add up to 1.0000001
    assert scene.flux_of["light_sky"] == np.inf


SPHERE_M2, CUBE_M2, CYLINDER_M2 = 4.0 * np.pi, 24.0, 6.0 * np.pi + 2.0 * np.pi
CONE_M2, CAPSULE_M2 = np.pi * (1.0 + np.sqrt(5.0)), 2.0 * np.pi * 0.5 * 1.0 + 4.0 * np.pi * 0.25


@pytest.mark.parametrize("kind, numbers, surface_m2", [
    ("Sphere", {"radius": 1.0}, SPHERE_M2),
    ("Cube", {"size": 2.0}, CUBE_M2),
    ("Cylinder", {"radius": 1.0, "height": 3.0}, CYLINDER_M2),
    ("Cone", {"radius": 1.0, "height": 2.0}, CONE_M2),
    ("Capsule", {"radius": 0.5, "height": 1.0}, CAPSULE_M2),
    ("Plane", {"width": 2.0, "length": 3.0}, 6.0),
])  # fmt: skip
def test_any_shape_with_mesh_light_api_shines_as_a_mesh_does(empty, kind, numbers, surface_m2):
    """Its flux is pi L A of the surface in closed form; tessellated round ones are a little smaller."""
    stage = empty()
    prim = stage.DefinePrim("/Lamp", kind)
    for name, number in numbers.items():
        prim.GetAttribute(name).Set(number)
    UsdGeom.Xformable(prim).AddTranslateOp().Set((0.0, 10.0, 0.0))
    UsdLux.MeshLightAPI.Apply(prim)
    UsdLux.LightAPI(prim).CreateIntensityAttr(100.0)
    scene = translate(stage)
    assert ["front alone" in note.text for note in scene.notes] == [True] * (kind == "Plane")
    emitter, _ = lamp_of(scene)
    (flux,) = scene.flux_of.values()
    tessellated = kind not in ("Sphere", "Cube", "Plane")
    np.testing.assert_allclose(flux, 100.0 * np.pi * surface_m2, rtol=0.03 if tessellated else 1e-6)
    np.testing.assert_allclose(strength(emitter), 100.0, rtol=1e-6)
    UsdLux.LightAPI(prim).CreateNormalizeAttr(True)
    (flux,) = translate(stage).flux_of.values()
    np.testing.assert_allclose(flux, 100.0 * np.pi, rtol=1e-6)


@pytest.mark.parametrize("kind", ["native", "points"])
def test_lights_in_prototypes_shine_once_per_instance(empty, kind):
    """A renderer forbids emitters in shared geometry, so each instance gets lamps of its own."""
    stage = empty()
    places = [(1, 5, 0), (2, 6, 1), (3, 7, 2)]
    root = "/Proto" if kind == "native" else "/Points/Proto"
    instancer = UsdGeom.PointInstancer.Define(stage, "/Points") if kind == "points" else None
    if kind == "native":
        stage.CreateClassPrim(root)
    else:
        stage.DefinePrim(root, "Xform")
    UsdLux.SphereLight.Define(stage, f"{root}/Lamp").CreateRadiusAttr(0.1)
    UsdGeom.Cube.Define(stage, f"{root}/Pole")
    if instancer:
        instancer.CreatePrototypesRel().AddTarget(root)
        fill(instancer, protoIndices=[0, 0, 0], positions=Vt.Vec3fArray([Gf.Vec3f(*p) for p in places]))
    else:
        for number, place in enumerate(places):
            prim = stage.DefinePrim(f"/Copy{number}", "Xform")
            prim.GetReferences().AddInternalReference(root)
            prim.SetInstanceable(True)
            UsdGeom.Xformable(prim).AddTranslateOp().Set(place)
    world = translate(stage).world
    lamps = [part for key, part in world.items() if key.startswith("shape_")]
    np.testing.assert_allclose([part["center"] for part in lamps], places)
    assert all("emitter" in part for part in lamps)
    assert sum(key.startswith("instance_") for key in world) == 3
    group = next(part for key, part in world.items() if key.startswith("group_"))
    assert [part["type"] for name, part in group.items() if name != "type"] == ["mesh"]


@pytest.mark.parametrize("metres_per_unit", [1.0, 0.01])
def test_blenders_watts_and_suns_are_read_as_it_means_them(empty, metres_per_unit):
    """A lamp of P watts shines with P / (pi x its area in m2), a sun of strength E with E: the exporter writes P / pi,
    whatever the units, and E / 4.
    """
    stage = empty(metres_per_unit=metres_per_unit)
    stage.GetRootLayer().documentation = "Blender v5.0.1"
    light = UsdLux.SphereLight.Define(stage, "/Lamp")
    fill(light, intensity=100.0 / math.pi, radius=0.25 / metres_per_unit, normalize=True, enableColorTemperature=True)
    fill(light, colorTemperature=6500.0)
    scene = translate(stage)
    np.testing.assert_allclose(strength(lamp_of(scene)[0]), 100.0 / (math.pi * 4 * math.pi * 0.25**2), rtol=1e-5)
    assert any("'blender'" in note.text for note in scene.notes)
    stage.RemovePrim("/Lamp")
    fill(UsdLux.DistantLight.Define(stage, "/Sun"), intensity=3.0 / 4.0, normalize=True)
    np.testing.assert_allclose(strength(lamp_of(translate(stage))[0], "irradiance"), 3.0, rtol=1e-6)
    np.testing.assert_allclose(strength(lamp_of(translate(stage, lights="usd"))[0], "irradiance"), 0.75, rtol=1e-6)


def test_a_blender_asset_keeps_its_convention_on_another_stage(empty, tmp_path):
    """The layer in which an intensity stands decides, light by light."""
    asset = Usd.Stage.CreateNew(str(tmp_path / "asset.usda"))
    asset.GetRootLayer().documentation = "Blender v4.5.3 LTS"
    sun = fill(UsdLux.DistantLight.Define(asset, "/Sun"), intensity=0.5, normalize=True)
    asset.SetDefaultPrim(sun.GetPrim())
    asset.Save()
    stage = empty()
    stage.DefinePrim("/Theirs").GetReferences().AddReference(str(tmp_path / "asset.usda"))
    fill(UsdLux.DistantLight.Define(stage, "/Ours"), intensity=0.5, normalize=True)
    world = translate(stage).world
    assert sorted(strength(part, "irradiance")[0] for key, part in world.items() if key.startswith("light_")) == [
        0.5,
        2.0,
    ]


@pytest.mark.parametrize("data, lux", [
    ({}, 3000 * math.pi * math.sin(math.radians(0.5)) ** 2),
    ({"renderSettings": {"rtx:fog:enabled": True}}, 3000),
    ({"renderSettings": {"rtx:fog:enabled": True, "omni:rtx:usdluxVersion": 2505}},
     3000 * math.pi * math.sin(math.radians(0.5)) ** 2),
])  # fmt: skip
def test_omniverse_suns_are_irradiance_before_2505(empty, data, lux):
    """A light of 3000, angle 1 and no 'normalize': 0.718 lx by the specification, 3000 lx in Omniverse until it
    followed it.
    """
    stage = empty()
    stage.GetRootLayer().customLayerData = data
    fill(UsdLux.DistantLight.Define(stage, "/Sun"), intensity=3000.0, angle=1.0)
    np.testing.assert_allclose(strength(lamp_of(translate(stage))[0], "irradiance"), lux, rtol=1e-6)


def test_metric_divides_by_square_metres(empty):
    """The same lamp in centimetres and metres shines alike; by the specification it is 1e4 dimmer in centimetres."""
    found = []
    for metres_per_unit in (1.0, 0.01):
        stage = empty(metres_per_unit=metres_per_unit)
        light = UsdLux.DiskLight.Define(stage, "/Lamp")
        fill(light, radius=0.5 / metres_per_unit, intensity=10.0, normalize=True)
        found.append([strength(lamp_of(translate(stage, lights=name))[0])[0] for name in ("metric", "usd")])
    np.testing.assert_allclose(found, 10 / (math.pi * 0.25) * np.array([[1, 1], [1, 1e-4]]), rtol=1e-6)


def test_an_unknown_convention_is_refused(empty):
    with pytest.raises(ParameterError, match=r"--lights blendr.*rtx-legacy.*Did you mean 'blender'"):
        translate(empty(), lights="blendr")

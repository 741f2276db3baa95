"""Which material, colour and frame a shape takes, by USD's own rules."""

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade

from synfog_usd.translate import translate

TYPES = Sdf.ValueTypeNames
RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def paint(stage, path, color):
    material = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("diffuseColor", TYPES.Color3f).Set(color)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
    return material


def bind(prim, material, **more):
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, **more)


def color_of(scene, shape):
    bsdf = scene.world[shape["bsdf"]["id"]]["bsdf"]
    return tuple((bsdf.get("base_color") or bsdf["reflectance"])["value"])


@pytest.fixture
def square(empty, polygon_mesh):
    """Define a square mesh on a stage."""

    def define(stage, path):
        return polygon_mesh(stage, path, [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)], [4], [0, 1, 2, 3]).GetPrim()

    return define


@pytest.mark.parametrize("bound, wanted", [
    ({"": GREEN}, GREEN),
    ({"": GREEN, "full": RED, "preview": BLUE}, RED),
    ({"": GREEN, "preview": BLUE}, GREEN),
    ({"preview": BLUE}, BLUE),
])  # fmt: skip
def test_purposes_of_a_binding(empty, square, only_shape, bound, wanted):
    """'full' before all-purpose; 'preview' only where there is nothing else, with a note."""
    stage = empty()
    prim = square(stage, "/Mesh")
    for purpose, color in bound.items():
        bind(prim, paint(stage, f"/Paint{purpose}", color), materialPurpose=purpose)
    scene = translate(stage)
    assert color_of(scene, only_shape(scene)) == wanted
    assert any("preview" in note.text for note in scene.notes) == (list(bound) == ["preview"])


@pytest.mark.parametrize("instanceable", [False, True])
@pytest.mark.parametrize(
    "strength, wanted", [("weakerThanDescendants", (GREEN, RED)), ("strongerThanDescendants", (RED, RED))]
)
def test_strength_of_a_binding_above(empty, square, instanceable, strength, wanted):
    """A binding above wins over what is bound below where it says so, within instances too; what is bare takes it
    always.
    """
    stage = empty()
    stage.CreateClassPrim("/Car")
    bind(square(stage, "/Car/Body"), paint(stage, "/Car/Green", GREEN))
    square(stage, "/Car/Roof")
    placed = stage.DefinePrim("/Placed", "Xform")
    placed.GetReferences().AddInternalReference("/Car")
    placed.SetInstanceable(instanceable)
    bind(placed, paint(stage, "/Red", RED), bindingStrength=strength)
    scene = translate(stage)
    assert tuple(color_of(scene, scene.world[f"shape_{n}"]) for n in range(2)) == wanted


@pytest.mark.parametrize("strength", ["weakerThanDescendants", "strongerThanDescendants"])
def test_a_binding_reaches_instances_within_instances(empty, square, strength):
    """The material bound to the outer instance is that of a bare shape two prototypes below."""
    stage = empty()
    for path in ("/Wheel", "/Car"):
        stage.CreateClassPrim(path)
    square(stage, "/Wheel/Rim")
    for path, source in (("/Car/Front", "/Wheel"), ("/Placed", "/Car")):
        prim = stage.DefinePrim(path, "Xform")
        prim.GetReferences().AddInternalReference(source)
        prim.SetInstanceable(True)
    bind(stage.GetPrimAtPath("/Placed"), paint(stage, "/Red", RED), bindingStrength=strength)
    scene = translate(stage)
    assert color_of(scene, scene.world["shape_0"]) == RED


def test_a_collection_paints_its_members(empty, square):
    stage = empty()
    stage.DefinePrim("/Street", "Xform")
    for name in "AB":
        square(stage, f"/Street/{name}")
    street = stage.GetPrimAtPath("/Street")
    chosen = Usd.CollectionAPI.Apply(street, "chosen")
    chosen.IncludePath("/Street/B")
    UsdShade.MaterialBindingAPI.Apply(street).Bind(chosen, paint(stage, "/Blue", BLUE), "chosen")
    scene = translate(stage)
    assert [color_of(scene, scene.world[f"shape_{n}"]) for n in range(2)] == [(0.18,) * 3, BLUE]


def reading(stage, reader_id, varname, **inputs):
    """A material whose colour comes from a primvar reader."""
    material = UsdShade.Material.Define(stage, "/Reading")
    surface = UsdShade.Shader.Define(stage, "/Reading/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    reader = UsdShade.Shader.Define(stage, "/Reading/Reader")
    reader.CreateIdAttr(reader_id)
    reader.CreateInput("varname", TYPES.String).Set(varname)
    for name, value in inputs.items():
        reader.CreateInput(name, TYPES.Float3).Set(value)
    surface.CreateInput("diffuseColor", TYPES.Color3f).ConnectToSource(reader.CreateOutput("result", TYPES.Float3))
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
    return material


@pytest.mark.parametrize("interpolation, values, wanted", [
    ("vertex", [RED, GREEN, BLUE, RED], [RED, GREEN, BLUE, RED]),
    ("constant", [BLUE], [BLUE] * 4),
    ("", None, [(0.25, 0.5, 0.75)] * 4),
])  # fmt: skip
def test_a_reader_takes_the_primvar_that_it_names(empty, square, only_shape, interpolation, values, wanted):
    """By point, or one for all; its fallback where the mesh has none.  displayColor, which it does not name, stays
    out.
    """
    stage = empty()
    prim = square(stage, "/Mesh")
    UsdGeom.Mesh(prim).CreateDisplayColorPrimvar("vertex").Set([(0.5, 0.5, 0.5)] * 4)
    if values:
        UsdGeom.PrimvarsAPI(prim).CreatePrimvar("tint", TYPES.Color3fArray, interpolation).Set(values)
    bind(prim, reading(stage, "UsdPrimvarReader_float3", "tint", fallback=(0.25, 0.5, 0.75)))
    shape = only_shape(translate(stage))
    order = np.lexsort((shape["positions"][:, 2], shape["positions"][:, 0]))
    np.testing.assert_allclose(shape["vertex_color"][order], np.array(wanted)[[0, 3, 1, 2]], atol=1e-6)


def test_a_constant_colour_is_read_from_above(empty, square, only_shape):
    stage = empty()
    UsdGeom.PrimvarsAPI(stage.DefinePrim("/Car", "Xform")).CreatePrimvar("tint", TYPES.Color3fArray, "constant").Set(
        [GREEN]
    )
    bind(square(stage, "/Car/Body"), reading(stage, "UsdPrimvarReader_float3", "tint"))
    np.testing.assert_allclose(only_shape(translate(stage))["vertex_color"], [GREEN] * 4)


def test_a_number_by_primvar_takes_the_readers_fallback_and_a_warning(empty, square, only_shape):
    stage = empty()
    material = reading(stage, "UsdPrimvarReader_float3", "tint")
    reader = UsdShade.Shader.Define(stage, "/Reading/Rough")
    reader.CreateIdAttr("UsdPrimvarReader_float")
    reader.CreateInput("varname", TYPES.String).Set("rough")
    reader.CreateInput("fallback", TYPES.Float).Set(0.875)
    surface = UsdShade.Shader(stage.GetPrimAtPath("/Reading/Surface"))
    surface.CreateInput("roughness", TYPES.Float).ConnectToSource(reader.CreateOutput("result", TYPES.Float))
    bind(square(stage, "/Mesh"), material)
    scene = translate(stage)
    assert scene.world[only_shape(scene)["bsdf"]["id"]]["bsdf"]["roughness"] == 0.875
    assert any(note.severity == "warning" and "'rough'" in note.text for note in scene.notes)


def instancer(stage, square, colors):
    made = UsdGeom.PointInstancer.Define(stage, "/Points")
    square(stage, "/Points/Proto")
    made.CreatePrototypesRel().AddTarget("/Points/Proto")
    made.CreateProtoIndicesAttr([0] * len(colors))
    made.CreatePositionsAttr([(3.0 * n, 0, 0) for n in range(len(colors))])
    UsdGeom.PrimvarsAPI(made).CreatePrimvar("displayColor", TYPES.Color3fArray, "vertex").Set(colors)


def test_points_of_an_instancer_take_their_colours(empty, square):
    """Four points of two colours are two groups of two instances."""
    stage = empty()
    instancer(stage, square, [RED, GREEN, RED, GREEN])
    scene = translate(stage)
    found = {}
    for part in scene.world.values():
        if isinstance(part, dict) and part["type"] == "instance":
            shape = scene.world[part["shapegroup"]["id"]]["shape_0"]
            found[round(float(part["to_world"][0, 3]))] = color_of(scene, shape)
    assert found == {0: RED, 3: GREEN, 6: RED, 9: GREEN}


def test_many_colours_of_an_instancer_are_their_mean_with_a_warning(empty, square):
    stage = empty()
    instancer(stage, square, [(n / 20, 0.5, 0.0) for n in range(20)])
    scene = translate(stage)
    np.testing.assert_allclose(color_of(scene, scene.world["group_0"]["shape_0"]), (9.5 / 20, 0.5, 0.0), rtol=1e-6)
    assert any(note.severity == "warning" and "20 displayColors" in note.text for note in scene.notes)


@pytest.mark.parametrize("frame, place", [(None, 10.0), (7, 15.0), (9, 20.0)])
def test_a_stage_without_a_first_frame_is_drawn_at_its_first_sample(empty, square, only_shape, frame, place):
    """Samples at 5 and 9 and no default: the place is the first's, not the origin; points and visibility are those of
    the same frame.
    """
    stage = empty()
    above = UsdGeom.Xform.Define(stage, "/Above")
    move = above.AddTranslateOp()
    move.Set((10, 0, 0), 5)
    move.Set((20, 0, 0), 9)
    prim = square(stage, "/Above/Mesh")
    points = prim.GetAttribute("points")
    values = np.array(points.Get())
    points.Clear()
    for time, lift in ((5, 1.0), (9, 3.0)):
        points.Set((values + np.array([0, 0, lift])).tolist(), time)
    shape = only_shape(translate(stage, frame=frame))
    assert shape["positions"][:, 0].min() == pytest.approx(place)
    assert shape["positions"][:, 2].min() == pytest.approx(1.0 + (place - 10.0) / 5.0)


def test_visibility_and_purpose_at_the_frame(empty, square):
    """Proxies are not drawn, what is for rendering below them is; samples of visibility count at the frame."""
    stage = empty()
    UsdGeom.Xform.Define(stage, "/Proxy").CreatePurposeAttr("proxy")
    for path, purpose in (("/Proxy/A", None), ("/Proxy/B", "render"), ("/C", "guide"), ("/D", None), ("/E", None)):
        shape = UsdGeom.Imageable(square(stage, path))
        if purpose:
            shape.CreatePurposeAttr(purpose)
        if path in ("/D", "/E"):
            shape.CreateVisibilityAttr().Set("invisible" if path == "/D" else "inherited", 1)
            shape.CreateVisibilityAttr().Set("inherited" if path == "/D" else "invisible", 5)
    assert [instance.path for instance in translate(stage, frame=1).instances] == ["/Proxy/B", "/E"]
    assert [instance.path for instance in translate(stage, frame=5).instances] == ["/Proxy/B", "/D"]


def test_a_reset_of_transforms_within_an_instance_is_told(empty, square):
    stage = empty()
    stage.CreateClassPrim("/Car")
    UsdGeom.Xform.Define(stage, "/Car/Free").SetResetXformStack(True)
    square(stage, "/Car/Free/Body")
    placed = stage.DefinePrim("/Placed", "Xform")
    placed.GetReferences().AddInternalReference("/Car")
    placed.SetInstanceable(True)
    assert any("resetXformStack" in note.text for note in translate(stage).notes)

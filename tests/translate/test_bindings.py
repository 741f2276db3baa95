"""Which material, colour and frame a shape takes, by USD's own rules."""

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade
from support.looks import SQUARE, TYPES, fill, put, shade

from synfog_usd.translate import translate
from synfog_usd.translate.instanced import _rounded
from synfog_usd.translate.primvars import PrimvarValue

RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def paint(stage, path, color):
    material = UsdShade.Material.Define(stage, path)
    surface = shade(stage, f"{path}/Surface", "UsdPreviewSurface", "surface", diffuseColor=color)
    material.CreateSurfaceOutput().ConnectToSource(surface)
    return material


def bind(prim, material, **more):
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, **more)


def color_of(scene, shape):
    bsdf = scene.world[shape["bsdf"]["id"]]["bsdf"]
    return tuple((bsdf.get("base_color") or bsdf["reflectance"])["value"])


@pytest.fixture
def square(empty, polygon_mesh):
    """Define a square mesh on a stage; the further ones stand beside the first."""

    def define(stage, path, number=0):
        points = [(x + 2 * number, y, z) for x, y, z in SQUARE]
        return polygon_mesh(stage, path, points, [4], [0, 1, 2, 3]).GetPrim()

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
    """A binding above wins over what is bound below where it says so, within instances too."""
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
    color = shade(stage, "/Reading/Reader", reader_id, "result", TYPES.Float3, varname=varname, **inputs)
    return paint(stage, "/Reading", color)


def reads_too(stage, name, value):
    """Another input of that material's surface."""
    put(UsdShade.Shader(stage.GetPrimAtPath("/Reading/Surface")), name, value)


@pytest.mark.parametrize("interpolation, values, wanted", [
    ("vertex", [RED, GREEN, BLUE, RED], [RED, GREEN, BLUE, RED]),
    ("constant", [BLUE], [BLUE] * 4),
    ("", None, [(0.25, 0.5, 0.75)] * 4),
])  # fmt: skip
def test_a_reader_takes_the_primvar_that_it_names(empty, square, only_shape, interpolation, values, wanted):
    """By point, or one for all; its fallback where the mesh has none."""
    stage = empty()
    prim = square(stage, "/Mesh")
    UsdGeom.Mesh(prim).CreateDisplayColorPrimvar("vertex").Set([(0.5, 0.5, 0.5)] * 4)
    if values:
        UsdGeom.PrimvarsAPI(prim).CreatePrimvar("tint", TYPES.Color3fArray, interpolation).Set(values)
    bind(prim, reading(stage, "UsdPrimvarReader_float3", "tint", fallback=(0.25, 0.5, 0.75)))
    scene = translate(stage)
    shape = only_shape(scene)
    order = np.lexsort((shape["positions"][:, 2], shape["positions"][:, 0]))
    found = shape["vertex_color"][order] if "vertex_color" in shape else [color_of(scene, shape)] * 4
    np.testing.assert_allclose(found, np.array(wanted)[[0, 3, 1, 2]], atol=1e-6)


@pytest.mark.parametrize("interpolation, values, wanted, told", [
    ("constant", [0.25], 0.25, ""),
    ("vertex", [0.0, 0.25, 0.5, 0.25], 0.25, "'rough' varies over it; roughness, which reads that, is drawn as its"),
    ("", None, 0.875, ""),
])  # fmt: skip
def test_a_number_by_primvar(empty, square, only_shape, interpolation, values, wanted, told):
    """Its constant; its mean where it varies, with a note; the reader's fallback where the mesh has none."""
    stage = empty()
    material = reading(stage, "UsdPrimvarReader_float3", "tint", fallback=RED)
    rough = {"varname": "rough", "fallback": 0.875}
    reads_too(
        stage, "roughness", shade(stage, "/Reading/Rough", "UsdPrimvarReader_float", "result", TYPES.Float, **rough)
    )
    prim = square(stage, "/Mesh")
    bind(prim, material)
    if values:
        UsdGeom.PrimvarsAPI(prim).CreatePrimvar("rough", TYPES.FloatArray, interpolation).Set(values)
    scene = translate(stage)
    assert scene.world[only_shape(scene)["bsdf"]["id"]]["bsdf"]["roughness"] == wanted
    notes = [note for note in scene.notes if note.severity == "warning"]
    assert [note.path for note in notes] == (["/Mesh"] if told else []) and all(told in note.text for note in notes)


def write(stage, path, name, kind, value):
    """An attribute of a type of its own, also where a schema wants another: as files have it."""
    spec = Sdf.AttributeSpec(Sdf.CreatePrimInLayer(stage.GetRootLayer(), path), name, kind, declaresCustom=True)
    spec.default = kind.type.pythonClass(value) if kind.isArray else type(kind.defaultValue)(value)


TINTS = [
    (TYPES.Color3f, (0.1, 0.8, 0.4), (0.1, 0.8, 0.4)), (TYPES.Half3, (0.125, 0.75, 0.5), (0.125, 0.75, 0.5)),
    (TYPES.Double3, (0.1, 0.8, 0.4), (0.1, 0.8, 0.4)), (TYPES.Vector3f, (0.1, 0.8, 0.4), (0.1, 0.8, 0.4)),
    (TYPES.Color4f, (0.1, 0.8, 0.4, 0.9), (0.1, 0.8, 0.4)), (TYPES.Int3, Gf.Vec3i(0, 1, 0), (0.0, 1.0, 0.0)),
    (TYPES.Int, 1, (1.0, 1.0, 1.0)), (TYPES.UChar, 1, (1.0, 1.0, 1.0)), (TYPES.Int64, 0, (0.0, 0.0, 0.0)),
    (TYPES.Bool, True, (1.0, 1.0, 1.0)), (TYPES.Half, 0.25, (0.25, 0.25, 0.25)),
    (TYPES.Double, 0.25, (0.25, 0.25, 0.25)), (TYPES.FloatArray, [0.25], (0.25, 0.25, 0.25)),
    (TYPES.FloatArray, [0.1, 0.8, 0.4], (0.1, 0.8, 0.4)),
    (TYPES.Color3hArray, [(0.125, 0.75, 0.5)], (0.125, 0.75, 0.5)), (TYPES.IntArray, [1], (1.0, 1.0, 1.0)),
]  # fmt: skip
NO_COLOURS = [
    (TYPES.Float2, (0.5, 0.5)), (TYPES.Matrix3d, Gf.Matrix3d(0.5)), (TYPES.Quatf, Gf.Quatf(0.5)), (TYPES.String, "red"),
    (TYPES.TokenArray, ["red"]), (TYPES.Asset, "red.png"), (TYPES.Color3f, (float("nan"), 0.5, 0.5)),
]  # fmt: skip


@pytest.mark.parametrize("at", ["/A{}/B/Mesh", "/A{}/B", "/A{}"])
@pytest.mark.parametrize("name", ["tint", "displayColor"])
def test_a_constant_of_any_numeric_type_is_a_colour(empty, square, at, name):
    """A scalar or an array of one, on the shape or above it: UsdGeomPrimvar's rules."""
    stage = empty()
    material = reading(stage, "UsdPrimvarReader_float3", name)
    for k, (kind, value, _) in enumerate(TINTS):
        UsdGeom.Xform.Define(stage, f"/A{k}/B")
        prim = square(stage, f"/A{k}/B/Mesh", k)
        write(stage, at.format(k), f"primvars:{name}", kind, value)
        if name == "tint":
            bind(prim, material)
    scene = translate(stage)
    for k, (kind, _, wanted) in enumerate(TINTS):
        found = color_of(scene, scene.world[f"shape_{k}"])
        np.testing.assert_allclose(found, wanted, rtol=1e-6, err_msg=str(kind))
    assert not [note for note in scene.notes if note.severity == "warning"]


@pytest.mark.parametrize("at", ["/A{}/Mesh", "/A{}"])
@pytest.mark.parametrize("name", ["tint", "displayColor"])
def test_a_constant_that_is_no_colour_is_told(empty, square, at, name):
    stage = empty()
    material = reading(stage, "UsdPrimvarReader_float3", name, fallback=(0.25, 0.5, 0.75))
    for k, (kind, value) in enumerate(NO_COLOURS):
        UsdGeom.Xform.Define(stage, f"/A{k}")
        prim = square(stage, f"/A{k}/Mesh", k)
        write(stage, at.format(k), f"primvars:{name}", kind, value)
        if name == "tint":
            bind(prim, material)
    scene = translate(stage)
    wanted = (0.25, 0.5, 0.75) if name == "tint" else (0.18,) * 3
    for k in range(len(NO_COLOURS)):
        np.testing.assert_allclose(color_of(scene, scene.world[f"shape_{k}"]), wanted)
    told = [note.path for note in scene.notes if name in note.text]
    assert sorted(told) == [f"/A{k}/Mesh" for k in range(len(NO_COLOURS))]


@pytest.mark.parametrize("interpolation, count", [("vertex", 4), ("varying", 4), ("uniform", 1), ("faceVarying", 4)])
@pytest.mark.parametrize("kind, width", [(TYPES.FloatArray, 1), (TYPES.IntArray, 1), (TYPES.Color4fArray, 4)])
def test_values_that_vary_have_any_numeric_type(empty, square, only_shape, interpolation, count, kind, width):
    """Numbers are greys, and of four the first three count; indexed, as they would be in the order of the points."""
    stage = empty()
    prim = square(stage, "/Mesh")
    primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar("tint", kind, interpolation)
    primvar.Set([1, 0] if width == 1 else [(one,) * width for one in (1, 0)])
    greys = [1, 0, 1, 0][:count]
    primvar.SetIndices([1 - grey for grey in greys])
    bind(prim, reading(stage, "UsdPrimvarReader_float3", "tint"))
    shape = only_shape(translate(stage))
    wanted = {(x, z): [greys[k % count]] * 3 for k, (x, _, z) in enumerate(SQUARE)}
    colors = zip(shape["positions"][:, [0, 2]].tolist(), shape["vertex_color"].tolist(), strict=True)
    assert {tuple(place): color for place, color in colors} == wanted


@pytest.mark.parametrize("name, kind, value, key, wanted", [
    ("roughness", TYPES.Int, 1, "roughness", 1.0),
    ("clearcoat", TYPES.HalfArray, [0.5], "clearcoat", 0.5),
    ("ior", TYPES.Float, 1.25, "eta", 1.25),
])  # fmt: skip
def test_a_constant_is_read_into_any_input(empty, square, name, kind, value, key, wanted):
    """Two shapes with one material each take their own."""
    stage = empty()
    material = reading(stage, "UsdPrimvarReader_float", "x")
    reads_too(stage, name, UsdShade.Shader(stage.GetPrimAtPath("/Reading/Reader")).GetOutput("result"))
    prims = [square(stage, f"/Mesh{k}") for k in range(2)]
    prims[0].CreateAttribute("primvars:x", kind, custom=True).Set(value)
    for prim in prims:
        bind(prim, material)
    scene = translate(stage)
    assert scene.world[scene.world["shape_0"]["bsdf"]["id"]]["bsdf"][key] == wanted
    assert scene.world[scene.world["shape_1"]["bsdf"]["id"]]["bsdf"].get(key) != wanted


def test_a_constant_that_moves_is_that_of_the_frame(empty, square, only_shape):
    stage = empty()
    above = UsdGeom.Xform.Define(stage, "/A").GetPrim()
    tint = above.CreateAttribute("primvars:tint", TYPES.Color3f, custom=True)
    tint.Set(RED, 1)
    tint.Set(BLUE, 3)
    bind(square(stage, "/A/Mesh"), reading(stage, "UsdPrimvarReader_float3", "tint"))
    for frame, wanted in ((1, RED), (2, (0.5, 0.0, 0.5)), (3, BLUE)):
        scene = translate(stage, frame=frame)
        assert color_of(scene, only_shape(scene)) == wanted


@pytest.mark.parametrize("at", ["/Placed", "/Above", "/Car", "/Car/Body"])
def test_instances_inherit_from_above(empty, square, at, name="tint"):
    """A constant on an instance, above it, on its model or within it reaches the shapes of its prototype."""
    stage = empty()
    stage.CreateClassPrim("/Car")
    body = square(stage, "/Car/Body")
    bind(body, reading(stage, "UsdPrimvarReader_float3", name, fallback=RED))
    UsdGeom.Xform.Define(stage, "/Above")
    for path in ("/Above/One", "/Above/Two", "/Placed"):
        placed = stage.DefinePrim(path, "Xform")
        placed.GetReferences().AddInternalReference("/Car")
        placed.SetInstanceable(True)
    write(stage, at, f"primvars:{name}", TYPES.Color3f, GREEN)
    paths = {"/Above": ["/Above/One", "/Above/Two"], "/Placed": ["/Placed"]}.get(at, ["/Placed", "/Above/One"])
    found = colors_by_instance(translate(stage))
    assert all(found[path] == GREEN for path in paths)
    assert len({*found.values()}) == (1 if at.startswith("/Car") else 2)


def colors_by_instance(scene):
    """Path of each instance -> its colour."""
    path_of = {instance.id: instance.path for instance in scene.instances}
    found = {}
    for (key, *inner), number in scene.instance_of.items():
        part = scene.world[key]
        shape = scene.world[part["shapegroup"]["id"]][inner[0]] if inner else part
        color = color_of(scene, shape)
        found[path_of[number]] = tuple(round(c, 6) for c in color)
    return found


def instancer(stage, square, values, name="displayColor", interpolation="vertex", kind=TYPES.Color3fArray, count=None):
    made = UsdGeom.PointInstancer.Define(stage, "/Points")
    proto = square(stage, "/Points/Proto")
    count = len(values) if count is None else count
    made.CreatePrototypesRel().AddTarget("/Points/Proto")
    fill(made, protoIndices=[0] * count, positions=[(3.0 * n, 0, 0) for n in range(count)])
    primvar = UsdGeom.PrimvarsAPI(made).CreatePrimvar(name, kind, interpolation)
    primvar.Set(values)
    if name != "displayColor":
        bind(proto, reading(stage, "UsdPrimvarReader_float3", name))
    return primvar


@pytest.mark.parametrize("name", ["displayColor", "tint"])
def test_points_of_an_instancer_take_their_colours(empty, square, name, interpolation="varying"):
    """Four points of two colours are two groups of two instances."""
    stage = empty()
    instancer(stage, square, [RED, GREEN, RED, GREEN], name, interpolation)
    scene = translate(stage)
    assert list(colors_by_instance(scene).values()) == [RED, RED, GREEN, GREEN]
    assert {f"/Points[{n}]": (RED, GREEN)[n % 2] for n in range(4)} == colors_by_instance(scene)
    assert len([key for key in scene.world if key.startswith("group_")]) == 2


def test_an_instancer_gives_one_value_to_all_and_values_by_index(empty, square):
    stage = empty()
    instancer(stage, square, [GREEN], "tint", "constant", count=3)
    assert set(colors_by_instance(translate(stage)).values()) == {GREEN}
    stage = empty()
    instancer(stage, square, [RED, BLUE], "tint", count=4).SetIndices([1, 0, 0, 1])
    found = colors_by_instance(translate(stage))
    assert found == {f"/Points[{n}]": color for n, color in enumerate([BLUE, RED, RED, BLUE])}


@pytest.mark.parametrize("frame, place", [(None, 10.0), (7, 15.0), (9, 20.0)])
def test_a_stage_without_a_first_frame_is_drawn_at_its_first_sample(empty, square, only_shape, frame, place):
    """Samples at 5 and 9 and no default: the place is the first's, not the origin."""
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


@pytest.mark.parametrize("colors", [[BLUE], [RED, BLUE, RED, BLUE]])
def test_unknown_materials_leave_a_shape_its_own_colours(empty, square, only_shape, colors):
    """As the note says."""
    context, shader, interpolation = "ri", "PxrSurface", "constant" if len(colors) == 1 else "vertex"
    stage = empty()
    material = UsdShade.Material.Define(stage, "/M")
    surface = fill(UsdShade.Shader.Define(stage, "/M/S"), id=shader)
    material.CreateSurfaceOutput(context).ConnectToSource(surface.CreateOutput("out", TYPES.Token))
    prim = square(stage, "/Mesh")
    UsdGeom.Mesh(prim).CreateDisplayColorPrimvar(interpolation).Set(colors)
    bind(prim, material)
    scene = translate(stage)
    shape = only_shape(scene)
    if len(colors) == 1:
        assert color_of(scene, shape) == BLUE
    else:
        assert {tuple(color) for color in shape["vertex_color"].tolist()} == {RED, BLUE}
    assert ["displayColor" in note.text for note in scene.notes if note.path == "/M"] == [True]


SHEET = [(0, 5, 0), (2, 5, 0), (2, 5, 2), (0, 5, 2)]
CORNERS = [(x, 5 + y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
SIDES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]


@pytest.mark.parametrize(
    "points, indices, double, fluxes",
    [(SHEET, [0, 1, 2, 3], False, 1), (SHEET, [0, 1, 2, 3], True, 2), (CORNERS, SIDES, True, 1)],
)
def test_what_is_double_sided_shines_from_both(empty, polygon_mesh, points, indices, double, fluxes):
    """An open mesh shines from its back too, and twice as much; nobody sees the backs of a closed one."""
    stage = empty()
    mesh = polygon_mesh(stage, "/Mesh", points, [4] * (len(indices) // 4), indices)
    mesh.CreateDoubleSidedAttr(double)
    material = paint(stage, "/Lit", RED)
    UsdShade.Shader(stage.GetPrimAtPath("/Lit/Surface")).CreateInput("emissiveColor", TYPES.Color3f).Set((10, 10, 10))
    bind(mesh.GetPrim(), material)
    scene = translate(stage)
    lit = [part for key, part in scene.world.items() if key.startswith("shape_")]
    area = 4.0 if points is SHEET else 6.0
    assert sum(scene.flux_of.values()) == pytest.approx(fluxes * np.pi * 10 * area, rel=1e-6)
    assert len(lit) == fluxes and {instance for instance in scene.instance_of.values()} == {1}
    if fluxes == 2:
        ways = []
        for shape in lit:
            a, b, c = (shape["positions"][shape["faces"][:, k]].astype(float) for k in range(3))
            ways.append(np.cross(b - a, c - a).sum(axis=0) / 2)
        np.testing.assert_allclose(ways, [[0, -4, 0], [0, 4, 0]], atol=1e-6)
        assert lit[1]["positions"][:, 1].min() > lit[0]["positions"][:, 1].max()


def test_values_of_more_instances_than_are_drawn_apart_are_rounded():
    """5000 colours, one of them without a number: by two decimals they still differ, by one at most 11^3 do."""
    colours = np.random.default_rng(1).random((5000, 3))
    kinds = [(PrimvarValue(tuple(colour)), None) for colour in colours.tolist()]
    kinds[7] = (PrimvarValue((float("nan"), 0.0, 0.0)), None)
    digits, rounded = _rounded(kinds, 4096)
    assert digits == 1 and 0 < len(set(rounded)) <= 11**3
    drawn = np.array([value.value for value, _ in rounded])
    assert np.abs(np.delete(drawn - colours, 7, axis=0)).max() <= 0.05 + 1e-12 and drawn[7].tolist() == [0.0] * 3

"""What is drawn and whose it is: visibility, instances, labels, and files that mean harm."""

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdRender, UsdSemantics
from support.looks import fill

from synfog_usd.translate import translate


def label(prim, *words):
    UsdSemantics.LabelsAPI.Apply(prim, "cityscapes").CreateLabelsAttr(list(words))


def named(scene):
    """{(shape, ...): (path, label)} and a check of the ids."""
    assert [instance.id for instance in scene.instances] == list(range(1, len(scene.instances) + 1))
    by_id = {instance.id: (instance.path, instance.label) for instance in scene.instances}
    return {key: by_id[number] for key, number in scene.instance_of.items()}


def test_only_what_can_be_seen_is_drawn(empty):
    """Invisible, inactive, guide and proxy prims are left out; purpose is inherited, and may be set back."""
    stage = empty()
    for name in ("Seen", "Invisible", "Inactive", "Guide", "Proxy", "Render"):
        UsdGeom.Cube.Define(stage, f"/{name}/Cube")
    UsdGeom.Imageable(stage.DefinePrim("/Invisible", "Xform")).MakeInvisible()
    stage.GetPrimAtPath("/Inactive").SetActive(False)
    for name in ("Guide", "Proxy", "Render"):
        UsdGeom.Imageable(stage.DefinePrim(f"/{name}", "Xform")).CreatePurposeAttr(name.lower())
    UsdGeom.Cube.Define(stage, "/Guide/Back").CreatePurposeAttr("default")
    stage.CreateClassPrim("/Class")
    UsdGeom.Cube.Define(stage, "/Class/Cube")
    assert {instance.path for instance in translate(stage).instances} == {"/Seen/Cube", "/Render/Cube", "/Guide/Back"}


def drawn(stage):
    return {instance.path for instance in translate(stage).instances}


def test_visibility_by_purpose_is_usds_own(empty):
    """UsdGeomVisibilityAPI hides a purpose below a prim, and shows it again further down, as
    UsdGeom.Imageable.ComputeEffectiveVisibility says of each prim; instances are no exception.
    """
    stage = empty()
    paths = []
    for outer in ("inherited", "invisible", "visible", None):
        for inner in ("inherited", "invisible", "visible", None):
            for purpose in ("default", "render"):
                path = f"/{outer}_{inner}_{purpose}"
                for prim, said in ((path, outer), (f"{path}/In", inner)):
                    made = UsdGeom.Xform.Define(stage, prim).GetPrim()
                    if said is not None:
                        UsdGeom.VisibilityAPI.Apply(made).CreateRenderVisibilityAttr(said)
                cube = fill(UsdGeom.Cube.Define(stage, f"{path}/In/Cube"), purpose=purpose)
                cube.AddTranslateOp().Set((0.0, 5.0 * len(paths), 0.0))
                paths.append(f"{path}/In/Cube")

    def seen(path):
        shape = UsdGeom.Imageable.Get(stage, path)
        return shape.ComputeEffectiveVisibility(shape.ComputePurpose()) != UsdGeom.Tokens.invisible

    wanted = {path for path in paths if seen(path)}
    assert 16 < len(wanted) < 32
    assert drawn(stage) == wanted

    hidden = UsdGeom.VisibilityAPI.Apply(UsdGeom.Xform.Define(stage, "/Hidden").GetPrim())
    hidden.CreateRenderVisibilityAttr("invisible")
    for where in ("/Hidden/Copy", "/Copy"):
        copy = stage.DefinePrim(where, "Xform")
        copy.GetReferences().AddInternalReference("/None_None_render")
        copy.SetInstanceable(True)
    assert drawn(stage) == wanted | {"/Copy"}


@pytest.mark.parametrize("purposes, wanted", [
    (None, {"/default", "/render"}),
    (["default", "render"], {"/default", "/render"}),
    (["default", "proxy"], {"/default", "/proxy"}),
    (["default", "render", "proxy", "guide"], {"/default", "/render", "/proxy", "/guide"}),
    (["render"], {"/render"}),
])  # fmt: skip
def test_the_render_settings_say_which_purposes_are_drawn(empty, purposes, wanted):
    stage = empty()
    for purpose in ("default", "render", "proxy", "guide"):
        UsdGeom.Cube.Define(stage, f"/{purpose}").CreatePurposeAttr(purpose)
    settings = UsdRender.Settings.Define(stage, "/Render")
    stage.SetMetadata("renderSettingsPrimPath", "/Render")
    if purposes is not None:
        settings.CreateIncludedPurposesAttr(purposes)
    assert drawn(stage) == wanted


def test_the_nearest_label_names_a_thing(empty):
    """A car with a plate: two instances, not a union; what stands unlabelled goes by its component or by itself."""
    stage = empty()
    label(UsdGeom.Xform.Define(stage, "/Car").GetPrim(), "car")
    UsdGeom.Cube.Define(stage, "/Car/Body")
    UsdGeom.Cube.Define(stage, "/Car/Parts/Wheel")
    label(UsdGeom.Cube.Define(stage, "/Car/Plate").GetPrim(), "license_plate")
    Usd.ModelAPI(UsdGeom.Xform.Define(stage, "/Bench").GetPrim()).SetKind("component")
    UsdGeom.Cube.Define(stage, "/Bench/Seat")
    UsdGeom.Cube.Define(stage, "/Bench/Leg")
    UsdGeom.Cube.Define(stage, "/Stone")
    assert list(named(translate(stage)).values()) == [
        ("/Car", "car"), ("/Car", "car"), ("/Car/Plate", "license plate"), ("/Bench", "unlabeled"),
        ("/Bench", "unlabeled"), ("/Stone", "unlabeled"),
    ]  # fmt: skip


@pytest.mark.parametrize("name, kind, value", [
    ("semantic:class:params:semanticData", "String", "person"),
    ("userProperties:cityscapes", "String", "person"),
    ("userProperties:semantic", "String", "Person"),
])  # fmt: skip
def test_older_labels_count(empty, name, kind, value):
    stage = empty()
    UsdGeom.Cube.Define(stage, "/P").GetPrim().CreateAttribute(name, getattr(Sdf.ValueTypeNames, kind)).Set(value)
    assert named(translate(stage)) == {("shape_0",): ("/P", "person")}


def test_an_unknown_label_is_unlabeled_and_noted(empty):
    stage = empty()
    label(UsdGeom.Cube.Define(stage, "/Ship").GetPrim(), "spaceship")
    scene = translate(stage)
    assert named(scene) == {("shape_0",): ("/Ship", "unlabeled")}
    assert any(note.path == "/Ship" and "'spaceship'" in note.text for note in scene.notes)


def copies(stage, root, count, parent=""):
    for number in range(count):
        prim = stage.DefinePrim(f"{parent}/Copy{number}", "Xform")
        prim.GetReferences().AddInternalReference(root)
        prim.SetInstanceable(True)
        UsdGeom.Xformable(prim).AddTranslateOp().Set((2.0 * number, 5.0, 0.0))


def world_points(scene):
    """(N, 3) all vertices as drawn, instances placed."""
    points = [
        part["positions"] for key, part in scene.world.items() if key.startswith("shape_") and "positions" in part
    ]
    for part in (part for key, part in scene.world.items() if key.startswith("instance_")):
        for name, shape in scene.world[part["shapegroup"]["id"]].items():
            if name != "type":
                points.append(
                    (part["to_world"] @ np.c_[shape["positions"], np.ones(len(shape["positions"]))].T).T[:, :3]
                )
    return np.concatenate(points)


def flat_points(stage, scene):
    """The same from USD itself, instances opened."""
    points = []
    cache = UsdGeom.XformCache()
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        if prim.GetTypeName() == "Mesh":
            matrix = cache.GetLocalToWorldTransform(prim)
            points += [np.array(matrix.Transform(Gf.Vec3d(p))) for p in UsdGeom.Mesh(prim).GetPointsAttr().Get()]
    return np.array(points) - scene.origin_m


def kinds(scene):
    """How many groups, instances and shapes stand in a scene itself."""
    names = [key.split("_")[0] for key in scene.world if key != "type"]
    return {name: names.count(name) for name in ("group", "instance", "shape") if name in names}


def in_order(points):
    return points[np.lexsort(np.round(points, 4).T)]


def test_instances_share_their_prototype_and_have_ids_of_their_own(empty, polygon_mesh):
    """Three copies of two meshes: one group of two shapes, three instances, each with an id."""
    stage = empty()
    stage.CreateClassPrim("/Proto")
    label(stage.GetPrimAtPath("/Proto"), "car")
    for name, z in (("Body", 0.0), ("Roof", 1.0)):
        mesh = polygon_mesh(stage, f"/Proto/{name}", [(0, 0, 0), (1, 0, 0), (1, 1, 0)], [3], [0, 1, 2])
        mesh.AddTranslateOp().Set((0, 0, z))
        mesh.AddRotateXOp().Set(30.0)
    copies(stage, "/Proto", 3)
    scene = translate(stage)
    assert kinds(scene) == {"group": 1, "instance": 3}
    assert named(scene) == {(f"instance_{i}", f"shape_{s}"): (f"/Copy{i}", "car") for i in range(3) for s in range(2)}
    np.testing.assert_allclose(in_order(world_points(scene)), in_order(flat_points(stage, scene)), atol=1e-5)


def test_labels_inside_a_prototype_split_the_instance(empty, polygon_mesh):
    stage = empty()
    stage.CreateClassPrim("/Proto")
    polygon_mesh(stage, "/Proto/Body", [(0, 0, 0), (1, 0, 0), (1, 1, 0)], [3], [0, 1, 2])
    rider = polygon_mesh(stage, "/Proto/Rider", [(0, 0, 0), (1, 0, 0), (1, 1, 0)], [3], [0, 1, 2])
    label(rider.GetPrim(), "rider")
    copies(stage, "/Proto", 2)
    label(stage.GetPrimAtPath("/Copy1"), "bicycle")
    assert named(translate(stage)) == {
        ("instance_0", "shape_0"): ("/Copy0", "unlabeled"), ("instance_0", "shape_1"): ("/Copy0/Rider", "rider"),
        ("instance_1", "shape_0"): ("/Copy1", "bicycle"), ("instance_1", "shape_1"): ("/Copy1/Rider", "rider"),
    }  # fmt: skip


def test_instances_under_a_labelled_thing_are_part_of_it_under_a_labelled_scope_they_are_things(empty, polygon_mesh):
    """Wheels belong to their car; trees in a scope are trees."""
    stage = empty()
    stage.CreateClassPrim("/Proto")
    polygon_mesh(stage, "/Proto/Mesh", [(0, 0, 0), (1, 0, 0), (1, 1, 0)], [3], [0, 1, 2])
    label(UsdGeom.Xform.Define(stage, "/Car").GetPrim(), "car")
    label(UsdGeom.Scope.Define(stage, "/Trees").GetPrim(), "vegetation")
    copies(stage, "/Proto", 2, "/Car")
    copies(stage, "/Proto", 2, "/Trees")
    assert sorted(named(translate(stage)).values()) == [
        ("/Car", "car"), ("/Car", "car"), ("/Trees/Copy0", "vegetation"), ("/Trees/Copy1", "vegetation"),
    ]  # fmt: skip


def test_point_instances_are_things_with_their_numbers(empty, polygon_mesh):
    """Two prototypes, one masked point; the prototypes themselves are not drawn."""
    stage = empty()
    points = UsdGeom.PointInstancer.Define(stage, "/Trees")
    points.AddTranslateOp().Set((0, 10, 0))
    label(points.GetPrim(), "vegetation")
    for name in ("Oak", "Elm"):
        polygon_mesh(stage, f"/Trees/{name}", [(0, 0, 0), (1, 0, 0), (1, 1, 0)], [3], [0, 1, 2]).AddScaleOp().Set(
            (2, 2, 2)
        )
        points.CreatePrototypesRel().AddTarget(f"/Trees/{name}")
    fill(points, protoIndices=[0, 1, 0, 1], positions=[(0, 0, 0), (5, 0, 0), (10, 0, 0), (15, 0, 0)])
    points.DeactivateId(2)
    scene = translate(stage)
    assert sorted(named(scene).values()) == [
        ("/Trees[0]", "vegetation"),
        ("/Trees[1]", "vegetation"),
        ("/Trees[3]", "vegetation"),
    ]
    shift = np.array([[0, 10, 0], [5, 10, 0], [15, 10, 0]])
    wanted = np.concatenate([np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0)]) + s for s in shift])
    np.testing.assert_allclose(in_order(world_points(scene)), in_order(wanted), atol=1e-6)


def test_nested_instances_stay_instances(empty, polygon_mesh):
    """A row of two wheels, itself instanced three times: one mesh, six instances, each wheel where USD puts it."""
    stage = empty()
    stage.CreateClassPrim("/Wheel")
    polygon_mesh(stage, "/Wheel/Mesh", [(0, 0, 0), (1, 0, 0), (1, 1, 0)], [3], [0, 1, 2])
    stage.CreateClassPrim("/Row")
    copies(stage, "/Wheel", 2, "/Row")
    for number in range(3):
        prim = stage.DefinePrim(f"/Place{number}", "Xform")
        prim.GetReferences().AddInternalReference("/Row")
        prim.SetInstanceable(True)
        xform = UsdGeom.Xformable(prim)
        xform.AddTranslateOp().Set((0.0, 0.0, 7.0 * number))
        xform.AddRotateZOp().Set(25.0 * number)
    scene = translate(stage)
    parts = [part for group in scene.world.values() if group != "scene" for part in group.values()]
    assert not any(isinstance(part, dict) and part["type"] == "instance" for part in parts)
    assert kinds(scene) == {"group": 1, "instance": 6}
    np.testing.assert_allclose(in_order(world_points(scene)), in_order(flat_points(stage, scene)), atol=1e-5)
    assert {path for path, _ in named(scene).values()} == {"/Place0", "/Place1", "/Place2"}


def test_prototypes_under_an_over_are_drawn_and_masked(empty, polygon_mesh):
    """An `over` hides prototypes from everything but their instancer; ids 11 and 13 are masked, one for good and one
    for now.
    """
    stage = empty()
    mesh = polygon_mesh(stage, "/Hidden/Leaf", [(0, 5, 0), (1, 5, 0), (1, 5, 1), (0, 5, 1)], [4], [0, 1, 2, 3])
    stage.GetPrimAtPath("/Hidden").SetSpecifier(Sdf.SpecifierOver)
    instancer = UsdGeom.PointInstancer.Define(stage, "/Points")
    instancer.CreatePrototypesRel().AddTarget(mesh.GetPath())
    fill(instancer, protoIndices=[0] * 4, positions=[(float(x), 0.0, 0.0) for x in range(4)], ids=[10, 11, 12, 13])
    fill(instancer, invisibleIds=[11])
    instancer.DeactivateId(13)
    world = translate(stage).world
    found = [part["to_world"][0, 3] for key, part in world.items() if key.startswith("instance_")]
    np.testing.assert_allclose(found, [0.0, 2.0])
    assert len(world["group_0"]["shape_0"]["faces"]) == 2


def test_display_opacity_counts_without_a_material(empty):
    """Also from a parent; it lets the rest straight through."""
    stage = empty()
    UsdGeom.Cube.Define(stage, "/Group/Box")
    UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Group")).CreatePrimvar(
        "displayOpacity", Sdf.ValueTypeNames.FloatArray, "constant"
    ).Set([0.25])
    world = translate(stage).world
    bsdf = world[world["shape_0"]["bsdf"]["id"]]
    assert (bsdf["type"], bsdf["opacity"], bsdf["bsdf"]["type"]) == ("mask", 0.25, "twosided")


def test_a_note_on_an_instance_names_what_somebody_authored(empty):
    """Prototypes are numbered anew each time a stage is opened: their names would make two bakes of one stage
    differ.
    """
    stage = empty()
    stage.CreateClassPrim("/Kind")
    UsdGeom.Mesh.Define(stage, "/Kind/Torn").CreateFaceVertexCountsAttr([3])
    for name in ("/B", "/A"):
        prim = UsdGeom.Xform.Define(stage, name).GetPrim()
        prim.GetInherits().AddInherit("/Kind")
        prim.SetInstanceable(True)
    UsdGeom.Cube.Define(stage, "/Whole")
    paths = [note.path for note in translate(stage).notes]
    assert "/A/Torn" in paths
    assert not any("Prototype" in path for path in paths)

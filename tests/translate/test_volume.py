"""Fog: what is authored is what is drawn, and what makes no sense is refused by name."""

import math
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade

from synfog_usd.errors import StageError
from synfog_usd.translate import translate

TYPES = Sdf.ValueTypeNames
SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "usd"
QUADS = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
BOX = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]


def fog_box(stage, path, centre=(0, 0, 0), half=10.0, **attributes):
    cube = UsdGeom.Cube.Define(stage, path)
    cube.CreatePurposeAttr("guide")
    cube.AddTranslateOp().Set(tuple(float(c) for c in centre))
    cube.AddScaleOp().Set((half, half, half))
    cube.GetPrim().AddAppliedSchema("SynFogMediumAPI")
    for name, value in attributes.items():
        kind = TYPES.Token if isinstance(value, str) else TYPES.Bool if isinstance(value, bool) else TYPES.Double
        cube.GetPrim().CreateAttribute(f"synfog:fog:{name}", kind).Set(value)
    return cube


def test_the_schema_is_read_whole(empty):
    """Visibility, contrast and profile in metres; the base is the lowest point of the boundary."""
    stage = empty(metres_per_unit=0.01)
    fog_box(stage, "/Fog", (0, 0, 500), 1000.0, mor=80.0, contrast=0.02, albedo=0.99, g=0.8, profile="exponential", scaleHeight=25.0, priority=3.0)
    (volume,) = translate(stage).fog
    np.testing.assert_allclose(volume.medium.sigma_t_per_m, 3.912023 / 80.0, rtol=1e-6)  # -ln 0.02
    assert (volume.medium.albedo, volume.medium.g, volume.medium.profile, volume.medium.scale_height_m, volume.priority) == (0.99, 0.8, "exponential", 25.0, 3)
    np.testing.assert_allclose(volume.medium.base_height_m, -5.0)
    np.testing.assert_allclose(volume.boundary.to_world, [[10, 0, 0, 0], [0, 10, 0, 0], [0, 0, 10, 5], [0, 0, 0, 1]])


def test_extinction_wins_over_visibility_and_defaults_hold(empty):
    stage = empty()
    fog_box(stage, "/A", (0, 50, 0), mor=80.0, sigma_t=0.5)
    fog_box(stage, "/B", (0, 100, 0))
    scene = translate(stage)
    np.testing.assert_allclose([v.medium.sigma_t_per_m for v in scene.fog], [0.5, 2.9957323 / 300.0], rtol=1e-6)
    assert any(note.path == "/B" and "300 m" in note.text for note in scene.notes)


@pytest.mark.parametrize("kind", ["Half", "Float", "Double", "Int", "UChar", "Int64"])
def test_any_numeric_type_will_do(empty, kind):
    stage = empty()
    prim = fog_box(stage, "/Fog").GetPrim()
    prim.CreateAttribute("synfog:fog:mor", getattr(TYPES, kind)).Set(200)
    np.testing.assert_allclose(translate(stage).fog[0].medium.visibility_m, 200.0)


@pytest.mark.parametrize("name", ["synfog:fog:mor", "userProperties:synfog_fog_mor", "userProperties:synfog_mor", "userProperties:synfog:fog:mor"])
@pytest.mark.parametrize("on_parent", [False, True])
def test_custom_properties_count_also_on_the_parent(empty, polygon_mesh, name, on_parent):
    """Blender puts custom properties on the object's Xform, not on its mesh, and applies no schema."""
    stage = empty()
    parent = UsdGeom.Xform.Define(stage, "/Box")
    parent.AddScaleOp().Set((40.0, 40.0, 20.0))
    mesh = polygon_mesh(stage, "/Box/Mesh", BOX, [4] * 6, QUADS)
    (parent if on_parent else mesh).GetPrim().CreateAttribute(name, TYPES.Double, custom=True).Set(75.0)
    scene = translate(stage)
    assert [v.boundary.kind for v in scene.fog] == ["box"]
    np.testing.assert_allclose(scene.fog[0].medium.visibility_m, 75.0)
    np.testing.assert_allclose(np.abs(scene.fog[0].boundary.surface_points()).max(axis=0), [20, 20, 10])
    assert not any(key.startswith("shape_") for key in scene.world)


@pytest.mark.parametrize("how", ["enabled", "invisible", "inactive", "parent"])
def test_fog_can_be_switched_off(empty, how):
    stage = empty()
    UsdGeom.Scope.Define(stage, "/Weather")
    cube = fog_box(stage, "/Weather/Fog", **({"enabled": False} if how == "enabled" else {}))
    if how == "invisible":
        cube.MakeInvisible()
    if how == "inactive":
        cube.GetPrim().SetActive(False)
    if how == "parent":
        UsdGeom.Imageable(stage.GetPrimAtPath("/Weather")).MakeInvisible()
    scene = translate(stage)
    assert scene.fog == () and not any(key.startswith("shape_") for key in scene.world)


@pytest.mark.parametrize("name, value", [
    ("mor", 0.0), ("mor", -5.0), ("mor", math.nan), ("mor", 1e-4), ("sigma_t", -0.1), ("contrast", 1.0), ("albedo", 1.5), ("g", 1.0),
    ("scaleHeight", 0.0), ("phase", "mie"), ("profile", "grid"), ("morr", 100.0),
])  # fmt: skip
def test_bad_values_are_refused_with_prim_and_attribute(empty, name, value):
    stage = empty()
    fog_box(stage, "/World_Fog", **{name: value})
    with pytest.raises(StageError, match=rf"/World_Fog.*synfog:fog:{name}"):
        translate(stage)


def test_a_word_in_place_of_a_number_is_refused(empty):
    stage = empty()
    fog_box(stage, "/Fog").GetPrim().CreateAttribute("userProperties:synfog_mor", TYPES.String).Set("thick")
    with pytest.raises(StageError, match=r"/Fog: userProperties:synfog_mor = 'thick' is not a finite number"):
        translate(stage)


def test_an_open_mesh_cannot_hold_fog(empty, polygon_mesh):
    stage = empty()
    mesh = polygon_mesh(stage, "/Bowl", BOX, [4] * 5, QUADS[:20])
    mesh.GetPrim().AddAppliedSchema("SynFogMediumAPI")
    with pytest.raises(StageError, match=r"/Bowl: .* 4 open .*close the mesh"):
        translate(stage)


@pytest.mark.parametrize("kind, radius, height, volume", [("Cylinder", 3.0, 4.0, 36 * math.pi), ("Cone", 3.0, 4.0, 12 * math.pi)])
def test_round_boundaries_become_closed_meshes(empty, kind, radius, height, volume):
    stage = empty()
    prim = stage.DefinePrim("/Fog", kind)
    prim.GetAttribute("radius").Set(radius)
    prim.GetAttribute("height").Set(height)
    prim.AddAppliedSchema("SynFogMediumAPI")
    (found,) = translate(stage).fog
    p, f = found.boundary.vertices, found.boundary.faces
    signed = np.einsum("ij,ij->", p[f[:, 0]], np.cross(p[f[:, 1]], p[f[:, 2]])) / 6
    np.testing.assert_allclose(signed, volume, rtol=3e-3)  # 48 segments: 0.29 %


def test_nested_fog_knows_what_surrounds_it(empty):
    """Three shells and one apart; the parent is the next one out, in whatever order they stand."""
    stage = empty()
    for name, half in (("Middle", 20.0), ("Inner", 5.0), ("Outer", 40.0)):
        fog_box(stage, f"/{name}", half=half)
    fog_box(stage, "/Apart", (200, 0, 0))
    fog = translate(stage).fog
    parents = {v.path: None if v.parent is None else fog[v.parent].path for v in fog}
    assert parents == {"/Middle": "/Outer", "/Inner": "/Middle", "/Outer": None, "/Apart": None}


def test_a_bank_that_stands_on_the_floor_of_the_layer_is_nested(empty):
    """Faces in one plane do not count as crossing."""
    stage = empty()
    fog_box(stage, "/Layer", (0, 0, 10), 10.0)
    fog_box(stage, "/Bank", (0, 0, 2), 2.0)
    fog_box(stage, "/Beside", (20, 0, 10), 10.0)
    fog = translate(stage).fog
    assert [(v.path, v.parent) for v in fog] == [("/Layer", None), ("/Bank", 0), ("/Beside", None)]


def test_the_same_place_twice_goes_by_priority(empty):
    stage = empty()
    fog_box(stage, "/High", priority=2.0)
    fog_box(stage, "/Low", priority=1.0)
    assert [v.parent for v in translate(stage).fog] == [1, None]


def test_crossing_fog_is_refused_with_both_names(empty):
    stage = empty()
    fog_box(stage, "/One")
    fog_box(stage, "/Two", (10, 0, 0))
    with pytest.raises(StageError, match=r"/One and /Two: .*inside the other, or move them apart"):
        translate(stage)


@pytest.mark.parametrize("mor_m, wanted", [(150.0, [150.0, 60.0]), (math.inf, []), (0.0, []), (None, [300.0, 60.0])])
def test_another_visibility_goes_to_the_outermost_fog(empty, mor_m, wanted):
    stage = empty()
    fog_box(stage, "/Layer", half=50.0, mor=300.0)
    fog_box(stage, "/Bank", half=5.0, mor=60.0)
    np.testing.assert_allclose([v.medium.visibility_m for v in translate(stage, fog_mor_m=mor_m).fog], wanted)


def test_a_stage_without_fog_gets_a_layer_when_asked(empty):
    stage = empty()
    UsdGeom.Cube.Define(stage, "/House").AddTranslateOp().Set((0, 3000.0, 0))
    assert translate(stage).fog == ()
    scene = translate(stage, fog_mor_m=150.0)
    (layer,) = scene.fog
    np.testing.assert_allclose(layer.medium.visibility_m, 150.0)
    assert layer.boundary.contains([scene.camera.to_world[:3, 3], (0, 3000, 0), (-1500, 0, 50)]).all()
    assert any("no fog" in note.text for note in scene.notes)


@pytest.mark.parametrize("doc, name, is_fog", [("Blender v5.0.1", "Box", True), ("", "FogBox", True), ("", "Car", False)])
def test_a_box_with_an_empty_material_is_fog_only_where_that_is_meant(empty, polygon_mesh, doc, name, is_fog):
    """Blender writes a volume material without outputs; elsewhere a lost material must not become fog."""
    stage = empty()
    stage.GetRootLayer().documentation = doc
    mesh = polygon_mesh(stage, f"/{name}", BOX, [4] * 6, QUADS)
    mesh.AddScaleOp().Set((40.0, 40.0, 20.0))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(UsdShade.Material.Define(stage, "/Empty"))
    scene = translate(stage)
    assert len(scene.fog) == is_fog
    assert sum(key.startswith("shape_") for key in scene.world) == (not is_fog)
    assert any(note.path == f"/{name}" and note.severity == "warning" for note in scene.notes)
    if is_fog:
        np.testing.assert_allclose(scene.fog[0].medium.visibility_m, 300.0)


def test_fog_is_read_without_the_plugin(tmp_path):
    """A process in which USD never learns of the schema reads the same numbers, defaults included."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "fog.usda"))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.Camera.Define(stage, "/Camera")
    fog_box(stage, "/Fog", mor=120.0)
    fog_box(stage, "/Far", (100, 0, 0))
    stage.Save()
    script = f"""
        from pxr import Plug
        Plug.Registry.RegisterPlugins = lambda self, path: []
        from pxr import Usd
        from synfog_usd.translate import translate
        stage = Usd.Stage.Open({str(tmp_path / "fog.usda")!r})
        prim = stage.GetPrimAtPath("/Fog")
        assert prim.GetAppliedSchemas() == [] and not prim.GetAttribute("synfog:fog:g").IsValid()
        print([(v.path, round(v.medium.visibility_m, 6), v.medium.g) for v in translate(stage).fog])
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[('/Fog', 120.0, 0.87), ('/Far', 300.0, 0.87)]", done.stderr


@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the real files beside the project")
def test_the_exported_fog_box_is_fog():
    scene = translate(Usd.Stage.Open(str(SHARED / "blender501" / "street_zup.usda")))
    (volume,) = scene.fog
    np.testing.assert_allclose(volume.medium.visibility_m, 300.0)
    np.testing.assert_allclose(np.ptp(volume.boundary.surface_points(), axis=0), [40, 140, 20], rtol=1e-6)
    assert volume.boundary.contains(scene.camera.to_world[:3, 3])[0]
    kinds = sorted(part["emitter"]["type"] if "emitter" in part else part["type"] for key, part in scene.world.items() if key.startswith(("shape_", "light_")))
    assert kinds == ["area"] * 4 + ["constant", "directional"] + ["mesh"] * 5 + ["spot"]


def test_a_mesh_that_is_a_box_becomes_one():
    """Turned, stretched and moved boxes are told from their eight corners, with their volume; a bent one is not mistaken for one."""
    import trimesh

    from synfog_usd.translate.volume import _mesh_boundary

    draw = np.random.default_rng(3)
    for _ in range(50):
        edges = draw.uniform(0.5, 40.0, 3)
        solid = trimesh.creation.box(extents=edges, transform=trimesh.transformations.random_rotation_matrix(draw.random(3)))
        solid.apply_translation(draw.uniform(-50, 50, 3))
        found = _mesh_boundary(np.asarray(solid.vertices), np.asarray(solid.faces), "/Fog")
        assert found.kind == "box"
        np.testing.assert_allclose(8 * abs(np.linalg.det(found.to_world[:3, :3])), edges.prod(), rtol=1e-9)
        inside = solid.vertices.mean(axis=0) + 0.98 * (solid.vertices - solid.vertices.mean(axis=0))
        outside = solid.vertices.mean(axis=0) + 1.02 * (solid.vertices - solid.vertices.mean(axis=0))
        assert found.contains(inside).all() and not found.contains(outside).any()
    bent = trimesh.creation.box()
    corners = np.asarray(bent.vertices).copy()
    corners[0] *= 1.5
    assert _mesh_boundary(corners, np.asarray(bent.faces), "/Fog").kind == "mesh"

"""Fog: what is authored is what is drawn, and what makes no sense is refused by name."""

import importlib.util
import io
import math
import os
import subprocess
import sys
import textwrap
import zipfile
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdVol
from support.looks import fill

from synfog_usd.base.errors import StageError
from synfog_usd.fog import Fog, FogMedium, FogVolume, extinction_from_visibility
from synfog_usd.fog.drops import PICTURE, extinction, gunn_marshall_sizes, rain_sizes
from synfog_usd.fog.volume import optical_depth
from synfog_usd.scene.testing import box
from synfog_usd.stage import budget
from synfog_usd.stage.open import dependencies, open_stage
from synfog_usd.stage.schema import full_name_of
from synfog_usd.translate import medium, translate, volume

TYPES = Sdf.ValueTypeNames
SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "usd"
QUADS = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
BOX = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]


def fog_box(stage, path, centre=(0, 0, 0), half=10.0, **attributes):
    cube = fill(UsdGeom.Cube.Define(stage, path), purpose="guide")
    cube.AddTranslateOp().Set(tuple(float(c) for c in centre))
    cube.AddScaleOp().Set((half, half, half))
    cube.GetPrim().AddAppliedSchema("SynFogMediumAPI")
    for name, value in attributes.items():
        kind = TYPES.Token if isinstance(value, str) else TYPES.Bool if isinstance(value, bool) else TYPES.Double
        cube.GetPrim().CreateAttribute(full_name_of(name), kind).Set(value)
    return cube


def test_the_schema_is_read_whole(empty):
    """Visibility, contrast and profile in metres; the base is the lowest point of the boundary."""
    stage = empty(metres_per_unit=0.01)
    fog_box(
        stage, "/Fog", (0, 0, 500), 1000.0, mor=80.0, contrast=0.02, albedo=0.99, g=0.8, profile="exponential",
        scaleHeight=25.0, priority=3.0,
    )  # fmt: skip
    (volume,) = translate(stage).fog
    np.testing.assert_allclose(volume.medium.sigma_t_per_m, 3.912023 / 80.0, rtol=1e-6)  # -ln 0.02
    np.testing.assert_allclose(volume.medium.visibility_m, 80.0)
    medium = volume.medium
    assert (medium.albedo, medium.g, medium.profile, medium.scale_height_m) == (0.99, 0.8, "exponential", 25.0)
    assert volume.priority == 3
    np.testing.assert_allclose(volume.medium.base_height_m, -5.0)
    np.testing.assert_allclose(volume.boundary.to_world, [[10, 0, 0, 0], [0, 10, 0, 0], [0, 0, 10, 5], [0, 0, 0, 1]])


def test_extinction_wins_over_visibility_and_defaults_hold(empty):
    stage = empty()
    fog_box(stage, "/A", (0, 50, 0), mor=80.0, sigma_t=0.5)
    fog_box(stage, "/B", (0, 100, 0))
    scene = translate(stage)
    np.testing.assert_allclose([v.medium.sigma_t_per_m for v in scene.fog], [0.5, 2.9957323 / 300.0], rtol=1e-6)
    assert any(note.path == "/B" and "300 m" in note.text for note in scene.notes)


@pytest.mark.parametrize("name", ["synfog:fog:mor", "userProperties:synfog_mor", "userProperties:synfog:fog:mor"])
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


BAD = {"mor": [0.0, -5.0, math.nan, math.inf, 1e-4], "sigma_t": [-0.1, math.nan, 1e4], "contrast": [0.0, 1.0]}
BAD |= {"albedo": [-0.1, 1.5, math.nan], "g": [1.0, -1.0, math.nan], "scaleHeight": [0.0, -1.0]}
BAD |= {"rate": [0.0, -1.0, 1e9, 5.0, math.nan], "kind": ["hail"], "also": ["hail3", "clear", "rain0", "rain5000"]}
BAD |= {"outerScale": [0.0, 1e9], "deviation": [-0.1, 3.0], "seed": [-1.0]}
BAD |= {"angstrom": [9.0, math.nan], "phase": ["rayleigh"], "profile": ["linear"], "morr": [100.0]}


@pytest.mark.parametrize("name", BAD)
def test_bad_values_are_refused_with_prim_and_attribute(empty, name):
    for value in BAD[name]:
        stage = empty()
        fog_box(stage, "/World_Fog", **{name: value})
        with pytest.raises(StageError, match=rf"/World_Fog.*{full_name_of(name)}"):
            translate(stage)


def test_a_kind_and_a_rate_are_read(empty):
    """Rain of 10 mm/h with haze of 2 km in it: extinctions add, and the albedo is the haze's and the rain's, 1."""
    stage = empty()
    fog_box(stage, "/Fog", kind="rain", rate=10.0, also="haze2000")
    scene = translate(stage)
    (volume,) = scene.fog
    sigma_t = extinction("rain", rain_sizes(10.0), PICTURE) + float(extinction_from_visibility(2000.0))
    assert volume.medium.sigma_t_per_m == pytest.approx(sigma_t)
    assert volume.medium.albedo == pytest.approx(1.0, abs=1e-3)
    assert not [note for note in scene.notes if "visibility" in note.text or "measured" in note.text]


def test_a_kind_takes_a_visibility_too(empty):
    """Dust in which one sees 500 m, by height."""
    stage = empty()
    fog_box(stage, "/Fog", kind="dust", mor=500.0, profile="exponential", scaleHeight=9.0)
    (volume,) = translate(stage).fog
    assert volume.medium.visibility_m == pytest.approx(500.0)
    assert volume.medium.scale_height_m == 9.0 and volume.medium.phase.source.startswith("transported mineral")


@pytest.mark.parametrize("how", [{"kind": "rain", "rate": 300.0}, {"also": "snow30"}], ids=str)
def test_a_rate_that_nobody_measured_is_noted(empty, how):
    stage = empty()
    fog_box(stage, "/Fog", **how)
    assert any("were measured up to" in note.text and note.path == "/Fog" for note in translate(stage).notes)
    over = translate(stage, fog=Fog(kind="rain", rate_mm_h=200.0)).notes
    assert any("rain of 200 mm/h" in note.text and note.path == "" for note in over)


def test_sizes_by_name_are_read(empty):
    """Gunn and Marshall's snow stops other light than Sekhon and Srivastava's; its flakes are of the same sizes."""
    stage = empty()
    fog_box(stage, "/Fog", kind="snow", rate=2.0, sizes="gunn-marshall")
    (volume,) = translate(stage).fog
    flakes = gunn_marshall_sizes(2.0)
    assert volume.medium.sigma_t_per_m == pytest.approx(extinction("snow", flakes, PICTURE))
    assert volume.medium.falls == (("snow", flakes),)


def test_sizes_by_their_numbers_are_as_many_as_they_say(empty):
    """Rain of 1000 drops a m3 whose radius is lognormal about 0.5 mm: pi/4 d^2 exp(2 ln^2 s) times the number."""
    stage = empty()
    fog_box(stage, "/Fog", kind="rain", sizes="lognormal", number=1e-3, median=500.0, spread=1.5)
    (volume,) = translate(stage).fog
    per_m = 1000.0 * math.pi / 4.0 * 1e-3**2 * math.exp(2.0 * math.log(1.5) ** 2)
    assert volume.medium.sigma_t_per_m == pytest.approx(per_m, rel=1e-5)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"kind": "rain", "sizes": "marshal-palmer"}, "Did you mean 'marshall-palmer'"),
        ({"kind": "snow", "rate": 2.0, "sizes": "marshall-palmer"}, "are those of rain"),
        ({"kind": "rain", "sizes": "marshall-palmer"}, "of a rate"),
        ({"kind": "smoke", "sizes": "strong-spray"}, "are of droplets, and smoke has none"),
        ({"kind": "rain", "sizes": "gamma", "number": 1.0}, "take number, alpha, power, mode; see alpha, mode, power"),
        ({"kind": "dust", "sizes": "lognormal", "number": 1.0, "median": 0.5, "spread": 1.0}, "no finite integral"),
        (
            {"kind": "rain", "sizes": "gamma", "number": 1.0, "alpha": -2.0, "power": 1.0, "mode": 5.0},
            "all are above 0",
        ),
        ({"kind": "mist", "sizes": "gamma", "number": 1.0, "alpha": 2.0, "power": 1.0, "mode": 500.0}, "up to 100 um"),
        ({"kind": "dust", "median": 1.0}, "which is not authored"),
    ],
    ids=str,
)
def test_sizes_without_a_meaning_are_refused(empty, how, words):
    stage = empty()
    fog_box(stage, "/Fog", **how)
    with pytest.raises(StageError, match=rf"^/Fog: synfog:medium:\w+ = .*{words}") as problem:
        translate(stage)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(
    ("name", "dark"), [("smoke100", True), ("smoke100_scale10", False), ("dust200", False), ("mor10", False)]
)
def test_a_layer_that_absorbs_nearly_all_daylight_is_noted(empty, name, dark):
    """100 m of soot above the camera; soot that lies on the ground, dust and fog let daylight through."""
    notes = [note.text for note in translate(empty(), fog=Fog.named(name)).notes]
    assert any("daylight down to the camera" in text for text in notes) == dark


def test_a_camera_in_a_black_plume_is_noted_with_the_plume(empty):
    stage = empty()
    fog_box(stage, "/Fog", mor=300.0)
    fog_box(stage, "/Plume", half=2.0, mor=0.2, kind="smoke")
    assert [note.path for note in translate(stage).notes if "daylight down to the camera" in note.text] == ["/Plume"]


def test_dust_says_what_its_spheres_get_wrong(empty):
    stage = empty()
    fog_box(stage, "/Fog", also="dust500")
    assert any("drawn as spheres" in note.text and note.path == "/Fog" for note in translate(stage).notes)


@pytest.mark.parametrize("phase, diameter", [("droplets", 5.0), ("droplets", None), ("mie", 1e4)])
def test_droplets_of_no_size_are_refused(empty, phase, diameter):
    """A phase function that is made from the diameter needs one, within the range of its fit or series."""
    stage = empty()
    fog_box(stage, "/Fog", phase=phase, **({} if diameter is None else {"dropletDiameter": diameter}))
    with pytest.raises(StageError, match=r"/Fog: synfog:fog:dropletDiameter = .*(5|6|0.1)"):
        translate(stage)


@pytest.mark.skipif(importlib.util.find_spec("miepython") is None, reason="needs miepython")
def test_mie_is_read(empty):
    stage = empty()
    fog_box(stage, "/Fog", phase="mie", dropletDiameter=8.0)
    (volume,) = translate(stage).fog
    assert "8 um" in volume.medium.phase.source


def test_mie_without_miepython_says_what_to_install(empty, monkeypatch):
    monkeypatch.setitem(sys.modules, "miepython", None)
    stage = empty()
    fog_box(stage, "/Fog", phase="mie", dropletDiameter=8.0)
    with pytest.raises(StageError, match=r"/Fog: .*pip install miepython"):
        translate(stage)


@pytest.fixture
def saved(tmp_path):
    """A stage in a folder of its own, with a grid's path on its one fog."""

    def make(asset):
        folder = tmp_path / "stage"
        folder.mkdir()
        stage = Usd.Stage.CreateNew(str(folder / "fog.usda"))
        UsdGeom.SetStageUpAxis(stage, "Z")
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdGeom.Camera.Define(stage, "/Camera")
        prim = fog_box(stage, "/Fog", half=20.0, profile="grid", sigma_t=0.1).GetPrim()
        if asset is not None:
            prim.CreateAttribute("synfog:fog:densityGrid", TYPES.Asset).Set(asset)
        return stage, folder

    return make


@pytest.mark.parametrize("name", ["grid.npz", "deep/grid.npy"])
def test_a_grid_beside_the_stage_is_read(saved, name):
    values = np.random.default_rng(0).random((2, 3, 4)).astype(np.float32)
    stage, folder = saved("./" + name)
    (folder / "deep").mkdir()
    (np.savez_compressed if name.endswith("z") else np.save)(folder / name, values)
    (volume,) = translate(stage).fog
    np.testing.assert_array_equal(volume.medium.grid.values, values)
    assert (volume.medium.profile, volume.medium.sigma_t_per_m) == ("grid", 0.1)
    stage.Save()
    assert (folder / name).resolve() in dependencies(stage)  # and so in the stage's hash


def test_patchy_fog_drifts_by_the_time_samples_of_its_prim(empty):
    """Centimetres, 2 m/s of wind: the same field at both frames, 5 m further; another visibility keeps it."""
    stage = empty(metres_per_unit=0.01)
    cube = fog_box(stage, "/Fog", half=9000.0, mor=150.0, profile="patchy", outerScale=12.0, deviation=0.4, seed=3.0)
    drift = cube.GetOrderedXformOps()[0]
    for frame, x in ((0.0, 0.0), (60.0, 500.0)):
        drift.Set((x, 0.0, 0.0), frame)
    (before,), (after,) = (translate(stage, frame=frame).fog for frame in (0.0, 60.0))
    assert before.medium.grid is after.medium.grid  # made once
    np.testing.assert_allclose(np.subtract(after.origin_m, before.origin_m), (5.0, 0.0, 0.0), atol=1e-6)
    assert (before.medium.grid.period_m, before.medium.visibility_m) == (12.0 * 16, pytest.approx(150.0))
    np.testing.assert_allclose(before.medium.grid.values.std(), 0.4, rtol=1e-3)
    (denser,) = translate(stage, frame=60.0, fog=Fog(50.0)).fog
    assert (denser.medium.grid is after.medium.grid, denser.origin_m) == (True, after.origin_m)
    assert denser.medium.visibility_m == pytest.approx(50.0)


GRIDS = {
    "nan.npy": lambda path: np.save(path, np.full((2, 2, 2), np.nan)),
    "negative.npy": lambda path: np.save(path, np.full((2, 2, 2), -0.1)),
    "flat.npy": lambda path: np.save(path, np.ones((2, 2))),
    "objects.npy": lambda path: np.save(path, np.array([[[{}]]]), allow_pickle=True),
    "two.npz": lambda path: np.savez(path, a=np.ones((1, 1, 1)), b=np.ones((1, 1, 1))),
    "objects.npz": lambda path: np.savez(path, np.array([[[{}]]])),
    "text.npy": lambda path: path.write_text("0.5"),
    "text.npz": lambda path: path.write_text("0.5"),
    "claims.npy": lambda path: path.write_bytes(_header((1 << 13,) * 3)),
    "claims.npz": lambda path: _zipped(path, _header((1 << 13,) * 3)),
    "bomb.npz": lambda path: _zipped(path, _header((1 << 7, 1 << 7, 1 << 7)) + bytes(1 << 23) + bytes(1 << 13)),
}


def _header(shape):
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": "<f4", "fortran_order": False, "shape": shape})
    return out.getvalue()


def _zipped(path, content):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("grid.npy", content)


@pytest.mark.parametrize("name", GRIDS)
def test_a_grid_that_makes_no_sense_is_refused_with_prim_and_attribute(saved, name, monkeypatch):
    """Bad values, other shapes and formats, pickled objects, and headers that claim more than there is or than we
    take, which here is 8 MiB.
    """
    monkeypatch.setattr(medium, "_MAX_BYTES", (1 << 23) + 4096)
    stage, folder = saved("./" + name)
    GRIDS[name](folder / name)
    with pytest.raises(StageError, match=rf"/Fog: synfog:fog:densityGrid = './{name}'; "):
        translate(stage)


@pytest.mark.parametrize("how", ["none", "missing", "outside", "link", "memory"])
def test_a_grid_lies_below_the_stage(saved, empty, tmp_path, how):
    """No file, a file elsewhere, a link to elsewhere, and a stage that lies nowhere."""
    np.save(tmp_path / "grid.npy", np.ones((1, 1, 1)))
    stage, folder = saved(
        {"none": None, "missing": "./grid.npy", "outside": "../grid.npy", "link": "./link.npy", "memory": None}[how]
    )
    (folder / "link.npy").symlink_to(tmp_path / "grid.npy")
    if how == "memory":
        stage = empty()
        fog_box(stage, "/Fog", profile="grid").GetPrim().CreateAttribute("synfog:fog:densityGrid", TYPES.Asset).Set(
            str(tmp_path / "grid.npy")
        )
    with pytest.raises(StageError, match="/Fog: synfog:fog:densityGrid"):
        translate(stage)


@pytest.mark.parametrize("near, x, y, refused", [
    (0.1, 0, 10.05, r"boundary.* /Camera .* 0.1 m"), (0.1, 0, -9.95, r"boundary.* /Camera .* 0.1 m"),
    (0.01, 0, 10.05, None), (0.1, 0, -10.05, None), (0.2, 9.97, 0, "near plane"), (0.2, 9.5, 0, None),
])  # fmt: skip
def test_fog_that_the_near_plane_cuts_is_refused(empty, near, x, y, refused):
    """A camera that looks along +Y: a box that begins or ends 5 cm ahead, or whose wall is beside the camera, where one
    corner of the near plane, which is 0.08 m wide, is outside.
    """
    stage = empty()
    UsdGeom.Camera(stage.GetPrimAtPath("/Camera")).CreateClippingRangeAttr().Set((near, 1000.0))
    fog_box(stage, "/Bank", (x, y, 0))
    if refused is None:
        assert len(translate(stage).fog) == 1
        return
    with pytest.raises(StageError, match=f"/Bank: .*{refused}"):
        translate(stage)


@pytest.mark.parametrize("scale", [(0.0, 0.0, 0.0), (10.0, 10.0, 1e-5)])
def test_a_boundary_without_volume_is_refused(empty, scale):
    stage = empty()
    cube = fog_box(stage, "/Flat")
    cube.GetPrim().GetAttribute("xformOp:scale").Set(scale)
    with pytest.raises(StageError, match=r"/Flat: .*thick holds no fog"):
        translate(stage)


def test_an_open_mesh_cannot_hold_fog(empty, polygon_mesh):
    stage = empty()
    mesh = polygon_mesh(stage, "/Bowl", BOX, [4] * 5, QUADS[:20])
    mesh.GetPrim().AddAppliedSchema("SynFogMediumAPI")
    with pytest.raises(StageError, match=r"/Bowl: .* 4 open .*close the mesh"):
        translate(stage)


@pytest.mark.parametrize(
    "kind, radius, height, volume", [("Cylinder", 3.0, 4.0, 36 * math.pi), ("Cone", 3.0, 4.0, 12 * math.pi)]
)
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
    fog_box(stage, "/Layer", (0, 0, 9), 10.0)
    fog_box(stage, "/Bank", (0, 0, 1), 2.0)
    fog_box(stage, "/Beside", (20, 0, 9), 10.0)
    fog = translate(stage).fog
    assert [(v.path, v.parent) for v in fog] == [("/Layer", None), ("/Bank", 0), ("/Beside", None)]


def test_the_same_place_twice_goes_by_priority(empty):
    stage = empty()
    fog_box(stage, "/High", priority=2.0)
    fog_box(stage, "/Low", priority=1.0)
    assert [v.parent for v in translate(stage).fog] == [1, None]


def test_ten_media_in_one_place_are_the_highest_one(empty):
    """Each is in the one below it, and a ray meets the tenth alone."""
    stage = empty()
    for number in range(10):
        fog_box(stage, f"/Medium{number}", priority=float(number), kind="dust", mor=100.0 + number)
    volumes = translate(stage).fog
    assert [volume.parent for volume in volumes] == [None, *range(9)]
    depth = optical_depth(volumes, np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]]), np.array([4.0]))
    np.testing.assert_allclose(depth, 4.0 * float(extinction_from_visibility(109.0)), rtol=1e-6)


def test_crossing_fog_is_refused_with_both_names(empty):
    stage = empty()
    fog_box(stage, "/One")
    fog_box(stage, "/Two", (10, 0, 0))
    with pytest.raises(StageError, match=r"/One and /Two: .*inside the other, or move them apart"):
        translate(stage)


@pytest.mark.parametrize("mor_m, wanted", [(150.0, [150.0, 60.0]), (math.inf, []), (None, [300.0, 60.0])])
def test_another_visibility_goes_to_the_outermost_fog(empty, mor_m, wanted):
    stage = empty()
    fog_box(stage, "/Layer", half=50.0, mor=300.0)
    fog_box(stage, "/Bank", half=5.0, mor=60.0)
    np.testing.assert_allclose([v.medium.visibility_m for v in translate(stage, fog=mor_m and Fog(mor_m)).fog], wanted)


def test_a_stage_without_fog_gets_a_layer_when_asked(empty):
    stage = empty()
    UsdGeom.Cube.Define(stage, "/House").AddTranslateOp().Set((0, 3000.0, 0))
    assert translate(stage).fog == ()
    scene = translate(stage, fog=Fog(150.0))
    (layer,) = scene.fog
    np.testing.assert_allclose(layer.medium.visibility_m, 150.0)
    assert layer.boundary.contains([scene.camera.to_world[:3, 3], (0, 3000, 0), (-1500, 0, 50)]).all()
    assert any("no fog" in note.text for note in scene.notes)


@pytest.mark.parametrize(
    "doc, name, is_fog", [("Blender v5.0.1", "Box", True), ("", "FogBox", True), ("", "Car", False)]
)
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


@pytest.mark.parametrize("closed", [True, False])
def test_a_volume_material_makes_fog_and_never_a_solid(empty, polygon_mesh, closed):
    """A material with an output for volumes and none for surfaces, whatever the mesh is called."""
    stage = empty()
    mesh = polygon_mesh(stage, "/Room", BOX, [4] * (6 if closed else 5), QUADS[: 24 if closed else 20])
    mesh.AddScaleOp().Set((40.0, 40.0, 20.0))
    material = UsdShade.Material.Define(stage, "/Air")
    shader = fill(UsdShade.Shader.Define(stage, "/Air/Volume"), id="kma_volume")
    material.CreateVolumeOutput().ConnectToSource(shader.CreateOutput("out", TYPES.Token))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    scene = translate(stage)
    assert not any(key.startswith("shape_") for key in scene.world)
    assert len(scene.fog) == closed
    assert any(
        ("taken as fog" if closed else "left out: close it") in note.text
        for note in scene.notes
        if note.severity == "warning"
    )


OMNIVERSE = {"rtx:fog:enabled": True, "rtx:fog:fogStartDist": 0.0, "rtx:fog:fogEndDist": 25000.0}


@pytest.mark.parametrize("where", ["layer", "prim"])
@pytest.mark.parametrize("enabled", [True, False])
def test_omniverses_fog_is_refused_with_a_visibility_to_try(empty, where, enabled):
    """25 000 cm are 250 m; a fog that is switched off is no matter."""
    stage = empty(metres_per_unit=0.01)
    values = {**OMNIVERSE, "rtx:fog:enabled": enabled}
    if where == "layer":
        stage.GetRootLayer().customLayerData = {"renderSettings": values}
    else:
        prim = stage.DefinePrim("/Render/Settings", "RenderSettings")
        for name, value in values.items():
            prim.CreateAttribute(f"omni:{name}", TYPES.Bool if isinstance(value, bool) else TYPES.Float).Set(value)
    scene = translate(stage)
    told = [note for note in scene.notes if "rtx:fog" in note.text]
    assert scene.fog == () and len(told) == enabled
    if enabled:
        assert (
            told[0].severity == "warning"
            and "--fog mor250," in told[0].text
            and told[0].path == ("" if where == "layer" else "/Render/Settings")
        )


def vdb_stage(folder, **arrays):
    """A Volume with an OpenVDB file, in centimetres and moved, and the .npz of the given arrays beside that file."""
    (folder / "volumes").mkdir(parents=True)
    (folder / "volumes" / "bank.vdb").write_bytes(b" BDV")
    if arrays:
        np.savez_compressed(folder / "volumes" / "bank.npz", **arrays)
    stage = Usd.Stage.CreateNew(str(folder / "vdb.usda"))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.Camera.Define(stage, "/Camera")
    volume = UsdVol.Volume.Define(stage, "/Bank")
    volume.AddTranslateOp().Set((0, 5000, 0))
    asset = fill(UsdVol.OpenVDBAsset.Define(stage, "/Bank/density"), filePath="./volumes/bank.vdb", fieldName="density")
    volume.CreateFieldRelationship("density", asset.GetPath())
    stage.Save()
    return open_stage(folder / "vdb.usda")


def vdb_arrays():
    density = np.zeros((2, 3, 4), np.float32)
    density[1, 2, 3] = 1.0
    low, high = np.array([-100.0, -200.0, 0.0]), np.array([300.0, 100.0, 400.0])
    return {"density": density, "low": low, "high": high, "largest": np.float64(2.5)}


def test_an_openvdb_volume_is_fog_where_its_npz_stands_beside_it(tmp_path):
    """Box and densities from the file, moved with the prim."""
    stage = vdb_stage(tmp_path / "a", **vdb_arrays())
    (found,) = translate(stage).fog
    np.testing.assert_allclose(found.boundary.to_world, [[2, 0, 0, 1], [0, 1.5, 0, 49.5], [0, 0, 2, 2], [0, 0, 0, 1]])
    assert found.medium.grid.values[1, 2, 3] == 1.0 and found.medium.grid.values.sum() == 1.0
    np.testing.assert_allclose(found.medium.sigma_t_per_m, 2.5 * 2.9957323 / 300.0, rtol=1e-6)
    stage.GetPrimAtPath("/Bank").CreateAttribute("synfog:fog:sigma_t", TYPES.Double).Set(0.2)
    (found,) = translate(stage).fog
    np.testing.assert_allclose(found.medium.sigma_t_per_m, 0.5)
    assert (tmp_path / "a" / "volumes" / "bank.npz") in dependencies(stage)


@pytest.mark.parametrize(
    "change",
    [
        {"density": np.full((1, 1, 1), 2.0)},
        {"density": np.full((1, 1, 1), -0.5)},
        {"density": np.array([[[0.0, np.nan]]])},
        {"high": np.full(3, -1e9)},
        {"largest": None},
        {"largest": np.float64(np.nan)},
    ],
)
def test_a_damaged_npz_of_a_volume_is_refused(tmp_path, change):
    arrays = {name: value for name, value in (vdb_arrays() | change).items() if value is not None}
    with pytest.raises(StageError, match=r"/Bank: bank.npz: .*make it again with vdb2npz.py"):
        translate(vdb_stage(tmp_path / "a", **arrays))


def test_a_npz_of_a_volume_that_claims_more_than_is_read_is_refused(tmp_path):
    """2 TiB, by its header alone."""
    stage = vdb_stage(tmp_path / "a", **vdb_arrays())
    file = tmp_path / "a" / "volumes" / "bank.npz"
    with zipfile.ZipFile(file) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()} | {"density.npy": _header((1 << 13,) * 3)}
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    with pytest.raises(StageError, match=r"/Bank: bank.npz: the file claims an array"):
        translate(stage)


def test_a_npz_that_is_a_link_elsewhere_is_refused(tmp_path):
    stage = vdb_stage(tmp_path / "a", **vdb_arrays())
    file = tmp_path / "a" / "volumes" / "bank.npz"
    file.rename(tmp_path / "elsewhere.npz")
    file.symlink_to(tmp_path / "elsewhere.npz")
    with pytest.raises(StageError, match=r"/Bank: .*lies outside of the stage's folder"):
        translate(stage)


def test_a_grid_in_an_allowed_folder_is_read(tmp_path):
    (tmp_path / "stage").mkdir()
    (tmp_path / "clouds").mkdir()
    np.save(tmp_path / "clouds" / "grid.npy", np.ones((1, 1, 1), np.float32))
    stage = Usd.Stage.CreateNew(str(tmp_path / "stage" / "fog.usda"))
    UsdGeom.Camera.Define(stage, "/Camera")
    fog_box(stage, "/Fog", profile="grid").GetPrim().CreateAttribute("synfog:fog:densityGrid", TYPES.Asset).Set(
        "../clouds/grid.npy"
    )
    stage.Save()
    del stage
    assert len(translate(open_stage(tmp_path / "stage" / "fog.usda", allow=[tmp_path / "clouds"])).fog) == 1


BPY = os.environ.get("SYNFOG_BPY", "")


@pytest.mark.skipif(not BPY, reason="SYNFOG_BPY names no Python that has bpy")
@pytest.mark.skipif(not SHARED.is_dir(), reason="needs the real files beside the project")
def test_vdb2npz_reads_blenders_volume(tmp_path):
    """The file that Blender wrote: its box is the extent that Blender authored; the densities, a ball's, stay within 0
    to 1.
    """
    (tmp_path / "fogbank.vdb").write_bytes((SHARED / "blender501" / "volumes" / "fogbank.vdb").read_bytes())
    tool = Path(__file__).resolve().parents[2] / "integrations" / "vdb2npz.py"
    subprocess.run([BPY, str(tool), str(tmp_path / "fogbank.vdb")], check=True, capture_output=True)
    with np.load(tmp_path / "fogbank.npz") as made:
        np.testing.assert_allclose([made["low"], made["high"]], [[-0.25] * 3, [15.75] * 3])
        assert made["density"].shape == (32, 32, 32) and made["density"].max() == 1.0 and made["density"].min() == 0.0
    subprocess.run(
        [BPY, str(tool), str(tmp_path / "fogbank.vdb"), "--max-voxels", "10"], check=True, capture_output=True
    )
    with np.load(tmp_path / "fogbank.npz") as small:
        assert small["density"].shape == (8, 8, 8)
        np.testing.assert_allclose([small["low"], small["high"]], [[-0.25] * 3, [15.75] * 3])


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


def test_more_pairs_of_fogs_than_can_be_looked_at_are_refused(monkeypatch):
    monkeypatch.setattr(volume, "MAX_PAIRS", 100)
    with pytest.raises(volume.FogError, match="more than 100 pairs of fog boundaries may touch"):
        volume.nested([FogVolume(f"/F{n}", box(10.0 + n), FogMedium(0.01)) for n in range(30)])


def test_more_fogs_than_a_kernel_can_look_at_are_refused(monkeypatch):
    """As many as the limit are drawn, one more are not; whoever trusts the stage may have more."""
    banks = [FogVolume(f"/F{n}", box(1.0, (4.0 * n, 0, 0)), FogMedium(0.01)) for n in range(budget.MAX_FOGS + 1)]
    volume.refuse_many(banks[1:])
    with pytest.raises(StageError, match="201 fog volumes, the first of them /F0; a picture is drawn of at most 200"):
        volume.refuse_many(banks)
    monkeypatch.setenv(budget.TRUSTED, "1")
    volume.refuse_many(banks)

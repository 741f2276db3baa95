"""The model library: every model opens, stands on the ground, has the size of what it is, and looks as its variants say."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade, UsdValidation

from synfog_usd import cityscapes
from synfog_usd.errors import StageError
from synfog_usd.world import homesteads, lod, roadside, sheet, stock
from synfog_usd.world.components import Component, write_component
from synfog_usd.world.library import SIZES, library, model, of_group, read
from synfog_usd.world.shapes import Part, ball, box

ROOT = Path(__file__).resolve().parents[2]
NAMES = [name for name, m in library().items() if m.group != "ground"]
ROOTED = {"bare_tree", "lime_tree", "maple_tree", "park_tree"}
"""Trees of the crossing whose trunks begin up to 9 cm below the ground."""
NOT_ON_GROUND = {"rider"}
"""Sits on the model `bicycle`, at the same place."""
NEW = [
    "city_car",
    "taxi",
    "crossover",
    "box_truck",
    "coach",
    "minibus",
    "wheelchair_user",
    "woman_pram",
    "worker",
    "jogger",
    "schoolgirl",
    "motorcyclist",
    "cyclist",
    "lamp_mast_double",
    "lamp_post_top",
    "bus_shelter",
    "guard_rail",
    "fence",
    "noise_wall",
    "sign_direction",
    "sign_warning",
    "sign_chevron",
    "birch_tree",
    "conifer",
    "terrace_house",
    "farmhouse",
    "office_block",
    "warehouse",
    "filling_station",
]


def shown(name: str, **variants: str) -> Usd.Stage:
    """A stage that refers to the model, with variants chosen."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    prim = UsdGeom.Xform.Define(stage, "/Model").GetPrim()
    prim.GetReferences().AddReference(str(library()[name].path))
    for set_name, choice in variants.items():
        assert prim.GetVariantSets().GetVariantSet(set_name).SetVariantSelection(choice)
    return stage


def meshes(stage: Usd.Stage) -> dict[str, Part]:
    """Triangles by name of the mesh."""
    found = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get(), dtype=np.float64)
            found[prim.GetName()] = Part(points, np.array(mesh.GetFaceVertexIndicesAttr().Get(), dtype=np.int64).reshape(-1, 3), prim.GetName())
    return found


def first_hit(origin: np.ndarray, direction: np.ndarray, triangles: np.ndarray) -> float:
    """Distance along a ray to the nearest of (N, 3, 3) triangles, inf for none (Moller and Trumbore 1997)."""
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(direction, v)
    det = np.einsum("ij,ij->i", u, p)
    ok = np.abs(det) > 1e-12
    inv = 1 / np.where(ok, det, 1.0)
    s = origin - a
    q = np.cross(s, u)
    b, c, t = np.einsum("ij,ij->i", s, p) * inv, q @ direction * inv, np.einsum("ij,ij->i", v, q) * inv
    hit = ok & (b >= 0) & (c >= 0) & (b + c <= 1) & (t > 1e-6)
    return float(t[hit].min(initial=np.inf))


def test_library_has_what_streets_and_roads_need():
    """Twelve vehicles over seven body types, twelve people, riders, three lamps, several plants and buildings."""
    assert set(NEW) <= set(library())
    powered = [m for m in of_group("vehicle") if m.label in ("car", "truck", "bus")]
    assert len(powered) >= 12
    assert len({m.label for m in powered}) == 3
    assert len(of_group("person")) >= 12
    assert len(of_group("rider")) >= 3
    assert {m.name for m in of_group("lamp")} == {"street_lamp", "lamp_mast_double", "lamp_post_top"}
    assert len(of_group("plant")) >= 7
    assert len(of_group("building")) >= 15


@pytest.mark.parametrize("name", NAMES)
def test_model_stands_on_the_ground_and_has_the_size_of_its_class(name):
    """Least z within 2 cm of 0, the origin inside the footprint, extents within the limits of the class."""
    m = library()[name]
    stage = Usd.Stage.Open(str(m.path))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert m.label in cityscapes.LABELS
    if name not in NOT_ON_GROUND:
        assert abs(m.low[2]) <= (0.09 if name in ROOTED else 0.02)
    assert m.low[0] <= 0 <= m.high[0]
    assert m.low[1] <= 0 <= m.high[1]
    for extent, (least, most) in zip((m.length, m.width, m.height), SIZES[m.label], strict=True):
        assert least <= extent <= most
    stated = re.search(r"([\d.]+) m long", m.about)
    if stated:  # 3 %: rounded corners take a few centimetres, mirrors and plates give some
        assert m.length == pytest.approx(float(stated[1]), rel=0.03)


@pytest.mark.parametrize("name", NEW)
def test_every_validator_of_usd_is_content_with_a_model(name):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    stage = Usd.Stage.Open(str(library()[name].path))
    assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []


@pytest.mark.parametrize("name", NAMES)
def test_every_variant_composes_and_every_mesh_wears_a_material(name):
    for set_name, choices in library()[name].variants.items():
        seen = set()
        for choice in choices:
            stage = shown(name, **{set_name: choice})
            assert stage.GetCompositionErrors() == []
            worn = []
            for prim in stage.Traverse():
                if prim.IsA(UsdGeom.Mesh):
                    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
                    assert material, f"{prim.GetPath()} wears nothing"
                    worn.append((prim.GetName(), material.GetPrim().GetName(), len(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr().Get())))
                if prim.IsA(UsdShade.Shader):
                    worn += [(str(prim.GetPath()), i.GetBaseName(), str(i.Get())) for i in UsdShade.Shader(prim).GetInputs()]
                if prim.IsA(UsdLux.DiskLight):
                    worn.append((prim.GetName(), "light", 0))
            assert worn
            seen.add(tuple(worn))
        assert len(seen) == len(choices), f"{set_name}: two of {choices} look the same"


@pytest.mark.parametrize("name", [n for n in NEW if "lod" in library()[n].variants])
def test_low_level_has_fewer_triangles_and_the_same_silhouette(name):
    """No point of a solid mesh moves by more than 2 cm; leaves keep the area that they cover within 5 %."""
    full, low = meshes(shown(name, lod="full")), meshes(shown(name, lod="low"))
    assert set(full) == set(low)
    assert sum(len(p.faces) for p in low.values()) < 0.75 * sum(len(p.faces) for p in full.values())
    for key in full:
        if key.startswith(lod.LEAVES):
            area = [0.5 * np.linalg.norm(np.cross(*np.diff(p.points[p.faces], axis=1).swapaxes(0, 1)), axis=1).sum() for p in (full[key], low[key])]
            assert area[1] == pytest.approx(area[0], rel=0.05)
        else:
            assert lod.distance(full[key], low[key], samples=2000) <= lod.LIMIT_M + 1e-4  # files keep five decimals


def test_distance_between_surfaces_is_that_of_two_balls():
    """Balls of radius 1.00 and 1.03 about one point are 3 cm apart; the same two bodies the other way round too."""
    one, other = (ball((0, 0, 0), (r, r, r), "m", sides=96) for r in (1.0, 1.03))
    assert lod.distance(one, other) == pytest.approx(0.03, abs=1.5e-3)  # facets of 96 sides sag by 0.5 mm
    assert lod.distance(other, one) == lod.distance(one, other)


def test_a_model_without_triangles_to_spare_has_one_level():
    assert lod.with_low(Component("crate", "static", (box((0, 0, 0), (1, 1, 1), "timber"),), "A crate.")).low == ()


@pytest.mark.parametrize("name", [m.name for m in library().values() if "lamps" in m.variants and "on" in m.variants["lamps"]])
def test_lamps_shine_out_of_their_model(name):
    """From each light along its axis nothing of the model stands in the way; no lamp lies inside a mesh."""
    stage = shown(name, lamps="on")
    parts = meshes(stage).values()
    triangles = np.concatenate([p.points[p.faces] for p in parts])
    lights = [prim for prim in stage.Traverse() if prim.IsA(UsdLux.DiskLight)]
    assert lights or "traffic_light" in name
    for light in lights:
        matrix = np.array(UsdGeom.Xformable(light).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
        assert first_hit(matrix[3, :3], -matrix[2, :3], triangles) == np.inf, f"{light.GetPath()} shines on its own model"
        assert not UsdLux.DiskLight(light).GetIntensityAttr().Get() <= 0


@pytest.mark.parametrize("name", ["city_car", "taxi", "crossover", "box_truck", "coach", "minibus"])
def test_tail_lamps_brighten_when_braking(name):
    def nits(choice: str) -> float:
        stage = shown(name, lamps=choice)
        shader = UsdShade.Shader(stage.GetPrimAtPath("/Model/Materials/tail_lens/Surface"))
        value = shader.GetInput("emissiveColor").Get()
        return float(value[0]) if value else 0.0

    assert nits("off") == 0 < nits("on") < 0.5 * nits("brake")


def test_riders_and_what_they_ride_have_their_own_labels():
    stage = shown("motorcyclist")
    labels = {p.GetName(): p.GetAttribute("semantics:labels:cityscapes").Get() for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)}
    assert list(labels["tyre"]) == list(labels["paint"]) == ["motorcycle"]
    assert labels["coat"] is None  # of the model: rider
    assert library()["motorcyclist"].label == "rider"


def test_stock_is_the_same_bytes_each_time(tmp_path):
    """The shipped files are what the code writes."""
    made = [c for c in roadside.build_roadside() if c.name in ("guard_rail", "lamp_post_top", "sign_direction")]
    made += [c for c in homesteads.build_homesteads() if c.name == "warehouse"]
    for component in made:
        path = write_component(lod.with_low(component), tmp_path)
        for file in path.parent.iterdir():
            assert file.read_bytes() == (ROOT / "assets" / "models" / component.name / file.name).read_bytes(), file.name
    assert len(made) == 4
    assert stock.BUILDERS


def test_pieces_of_a_row_join_end_to_end():
    """A guard rail is 4 m along X with its rail towards +Y and its posts behind."""
    m = model("guard_rail")
    assert m.width == pytest.approx(4.0, abs=1e-6)
    assert m.height == pytest.approx(0.75, abs=0.005)  # top of the rail, ESP systems
    stage = shown("guard_rail")
    points = np.concatenate([p.points for p in meshes(stage).values()])
    assert points[points[:, 2] < 0.3][:, 1].max() < 0.0 < points[points[:, 2] > 0.45][:, 1].max()


def test_unknown_models_and_files_that_are_none_are_told(tmp_path):
    with pytest.raises(StageError, match=r"no model 'taksi'\. Did you mean 'taxi'"):
        model("taksi")
    for text, said in (("#usda 1.0\n", "default prim"), ('#usda 1.0\n(defaultPrim = "A")\ndef Xform "A" {}\n', "0 Cityscapes labels")):
        path = tmp_path / f"{len(text)}.usda"
        path.write_text(text)
        with pytest.raises(StageError, match=said):
            read(path)
    empty = tmp_path / "empty.usda"
    layer = Sdf.Layer.CreateNew(str(empty))
    stage = Usd.Stage.Open(layer)
    prim = UsdGeom.Xform.Define(stage, "/A").GetPrim()
    stage.SetDefaultPrim(prim)
    prim.CreateAttribute("semantics:labels:cityscapes", Sdf.ValueTypeNames.TokenArray).Set(["car"])
    layer.Save()
    with pytest.raises(StageError, match="no geometry"):
        read(empty)


def test_on_the_sheet_every_view_of_a_model_lies_in_its_own_cell(tmp_path):
    """Points of the meshes, seen by the sheet's camera: no view leaves its cell, and each fills at least a third of its height or width."""
    models = sheet.ordered([model(name) for name in ("bus", "jogger", "lamp_mast_double", "warehouse", "guard_rail", "taxi")])
    width, height = sheet.write_stage(tmp_path / "sheet.usda", models, columns=2)
    stage = Usd.Stage.Open(str(tmp_path / "sheet.usda"))
    frustum = UsdGeom.Camera(stage.GetPrimAtPath("/World/Camera")).GetCamera().frustum
    project = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
    for k, m in enumerate(models):
        row, column = divmod(k, 2)
        for view in range(len(sheet.VIEWS_DEG)):
            place = np.array(UsdGeom.Xformable(stage.GetPrimAtPath(f"/World/{m.name}_{view}")).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
            points = np.concatenate([p.points for p in meshes(shown(m.name)).values()])
            clip = np.c_[points, np.ones(len(points))] @ place @ project
            x, y = (clip[:, 0] / clip[:, 3] + 1) / 2 * width, (1 - clip[:, 1] / clip[:, 3]) / 2 * height
            left, top = (3 * column + view) * sheet.CELL_PX[0], row * sheet.CELL_PX[1]
            # 5 px: the camera is not endlessly far, and nearer rows look 1 % larger
            assert left - 5 <= x.min() < x.max() <= left + sheet.CELL_PX[0] + 5
            assert top - 5 <= y.min() < y.max() <= top + sheet.CELL_PX[1] + 5
            assert np.ptp(y) > sheet.CELL_PX[1] / 3 or np.ptp(x) > sheet.CELL_PX[0] / 3
